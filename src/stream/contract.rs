//! The contract of a recording: every entity, component and property, once. Writers, the layout, readers, the flight
//! recorder and comparisons take them from here, and so does `meldscope reference recording`.

use crate::sdk::ComponentDescriptor;

/// An entity, or a family of entities whose paths differ in names.
#[derive(Debug)]
pub struct Entity {
    /// Its path. A part without small letters, such as `NAME` or `A~B`, stands for a name.
    pub path: &'static str,
    /// What it holds: archetypes of the SDK, and components of this crate.
    pub holds: &'static str,
    /// What it shows.
    pub about: &'static str,
}

/// A component that is not part of an archetype of the SDK.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Component(pub &'static str);

impl Component {
    /// The descriptor under which it is logged.
    pub fn descriptor(self) -> ComponentDescriptor {
        ComponentDescriptor::partial(self.0)
    }
}

fn is_placeholder(part: &str) -> bool {
    !part.contains(|c: char| c.is_ascii_lowercase()) && part.contains(|c: char| c.is_ascii_uppercase())
}

impl Entity {
    /// The path with these names, in the order of their placeholders.
    pub fn of(&self, names: &[&str]) -> String {
        let mut names = names.iter();
        let mut path = String::with_capacity(self.path.len() + 16);
        for part in self.path.split('/').skip(1) {
            path.push('/');
            path.push_str(if is_placeholder(part) { names.next().copied().unwrap_or(part) } else { part });
        }
        path
    }

    /// The entity below which all of this family are: the path up to its first name, or the entity itself.
    pub fn family(&self) -> &'static str {
        let end =
            self.path.split('/').take_while(|part| !is_placeholder(part)).map(|part| part.len() + 1).sum::<usize>();
        &self.path[..end - 1]
    }

    /// The names in a path of this family; `None` if it is another entity. The path of a chunk is escaped: see
    /// [`path_of`].
    pub fn names<'p>(&self, path: &'p str) -> Option<Vec<&'p str>> {
        let (mut names, mut parts) = (Vec::new(), path.split('/'));
        for expected in self.path.split('/') {
            let part = parts.next()?;
            if is_placeholder(expected) {
                names.push(part);
            } else if part != expected {
                return None;
            }
        }
        parts.next().is_none().then_some(names)
    }

    /// Whether a path is of this family.
    pub fn is(&self, path: &str) -> bool {
        self.names(path).is_some()
    }
}

/// The path of a chunk's entity as it was logged: the SDK escapes some characters of names.
pub fn path_of(chunk: &crate::sdk::Chunk) -> String {
    plain(chunk.entity_path())
}

/// A path without the SDK's escapes.
pub fn plain(entity: &crate::sdk::EntityPath) -> String {
    entity.to_string().replace('\\', "")
}

macro_rules! entities {
    ($($(#[$of:meta])* $NAME:ident = $path:literal [$holds:literal] $about:literal;)*) => {
        $(#[doc = concat!("`", $path, "`: ", $about)]
        pub static $NAME: Entity = Entity { path: $path, holds: $holds, about: $about };)*

        /// All entities, in the order in which they are listed to users.
        pub static ENTITIES: &[&Entity] = &[$(&$NAME),*];
    };
}

entities! {
    WORLD = "/world" ["ViewCoordinates"]
        "Axes: right-handed, z up.";
    BODY = "/world/bodies/NAME" ["Transform3D"]
        "Transform to the centre of a body, and of a free one its rotation.";
    BODY_SURFACE = "/world/bodies/NAME/surface" ["Mesh3D, drawn_triangles, lit_colors, unlit_normals, heat_…; with forces body, vertex, displacement_in_radii, net_force, reach"]
        "Mesh in the axes of the body. A body in a group keeps its own surface, but draws one degenerate triangle of it.";
    RESTING = "/world/resting/SHAPE" ["Mesh3D, InstancePoses3D, body"]
        "With more than 64 bodies: the undeformed ones, as instances of their shape.";
    DEFORMING = "/world/deforming/surface" ["as the surface of a body"]
        "With more than 64 bodies: the deformed ones, as one mesh in world coordinates.";
    MERGED = "/world/merged" ["AnnotationContext"]
        "Names of the bodies, as classes of the vertices of merged surfaces.";
    MERGED_SURFACE = "/world/merged/surface" ["Mesh3D, vertex, lit_colors, unlit_normals"]
        "The surfaces of all groups (two or more bodies connected by joined pairs), as one mesh in world coordinates.";
    MERGED_SEAMS = "/world/merged/seams" ["LineStrips3D"]
        "The lines along which bodies meet.";
    INFLUENCE = "/world/influence" ["Ellipsoids3D"]
        "All influence spheres, coloured by the deepest phase of their body.";
    PAIR_LINES = "/world/pairs" ["LineStrips3D; with more than 64 bodies Ellipsoids3D"]
        "Lines between the centres of the closest pairs within reach, up to three labelled with the pair and q; with many bodies also the influence spheres that reach another body.";
    RECENT = "/world/recent" ["LineStrips3D, Points3D"]
        "The pairs that had the events of the last step with any, up to four, labelled with the event and q, for 24 frames; with more than 8 bodies that of the last event, until the next. The labels are above all bodies, on lines that lead to the pairs.";
    RECENT_PAIR = "/recent/pair" ["Mesh3D, lit_colors, unlit_normals"]
        "With more than 8 bodies: the two of the last event alone, about the point midway between them [radii of the larger].";
    RECENT_SPHERES = "/recent/spheres" ["Ellipsoids3D"]
        "Their influence spheres.";
    RECENT_NAMES = "/recent/names" ["Points3D"]
        "Their names.";
    NAMES = "/world/names" ["Points3D"]
        "The names of bodies for which there is room, in a scene of at most 32; with several models side by side, of those of the first, and the names of the models.";
    FORCES = "/world/forces" ["AnnotationContext"]
        "Names of the pairs of bodies between which forces act, as classes of arrows.";
    FORCE = "/world/forces/CAUSE" ["Arrows3D"]
        "Accelerations of vertices and of points of contact by one cause, times the arrow scale given in the panel; those of uniform forces, net_force and torque: one arrow per free body, at its centre.";
    BODY_FORCE = "/forces/NAME/CAUSE" ["Scalars"]
        "Net force on a body by one cause over its mass: the length of the mean acceleration of its vertices, by mass if it is free, and of that by forces at points [scene unit/s²]; with at most 16 bodies, from the first frame in which it acts.";
    RESULTANTS = "/world/resultants" ["Arrows3D"]
        "The mean acceleration of the vertices of each body by each cause, by mass if it is free, and by forces at points, as arrows at its centre, the net force beside it; all of an instant on the scale on which the longest is 1.5 times, with more than 8 bodies 3 times, the geometric mean of the radius of its body and the largest radius; without those that are at most a tenth as long.";
    RESULTANT_LABELS = "/world/resultants/labels" ["Points3D"]
        "Of the five bodies with the largest net forces, the names, these forces and their strongest causes [scene unit/s²], and the names of others, of at most 32, where there is room.";
    STRONGEST = "/strongest/CAUSE" ["Scalars"]
        "With more than 3 bodies: the largest of the net forces on bodies by one cause, or by all together, over their masses [scene unit/s²]; from the first frame in which it acts.";
    RANKED_FORCES = "/ranking/forces" ["Points2D, LineStrips2D"]
        "Rows with labels and bars: the strongest forces on bodies as wholes at an instant; with more than 3 bodies, those with the largest net forces, each with a dot at each cause.";
    RANKED_DISPLACEMENTS = "/ranking/displacements" ["Points2D, LineStrips2D"]
        "With more than 3 bodies: rows with labels and bars, for those with the largest displacements at an instant.";
    RANKED_GROUPS = "/ranking/groups" ["Points2D, LineStrips2D"]
        "With more than 3 bodies: rows with labels and bars, for the largest groups at an instant: their pieces and volumes [scene unit³], and with at most 64 bodies how these differ from the volumes of their bodies one by one.";
    RANKED_PAIRS = "/ranking/pairs" ["Points2D, LineStrips2D"]
        "With more than 3 bodies: rows with labels, q and thresholds, for the pairs that change phase next.";
    NOT_RECORDED = "/world/not_recorded" ["Points3D"]
        "Labels: while a flight recorder kept no frames, when a Clear ends all else that shows a state; and where a run failed, at the body with the largest displacement.";
    POINTS = "/world/points" ["Ellipsoids3D, Points3D"]
        "The influence spheres of force points, while they act, and above them their names.";
    SPRINGS = "/world/springs/NAME" ["LineStrips3D"]
        "The springs of a body, blue where they are shorter than at rest, red-orange where longer; with forces, and of at most 64 cells.";
    TRAILS = "/world/trails" ["LineStrips3D"]
        "The path of the centre of each free body, one segment per frame; not with more than 64 bodies.";
    PLANE = "/world/planes/N" ["Mesh3D"]
        "A plane.";
    PLANE_GRID = "/world/planes/N/grid" ["LineStrips3D"]
        "Its grid.";
    PAIR_DISTANCE = "/pairs/A~B/distance" ["Scalars"]
        "q, for the first 16 pairs within reach, or 5 with more than 64 bodies (--plots), and up to as many that have events, throughout the run.";
    PAIR_LEVEL = "/pairs/A~B/LEVEL" ["Scalars"]
        "A threshold of q, for the same pairs: merge_at, split_at, core_at.";
    PAIR_PHASE = "/pairs/A~B/phase" ["StateChange, StateConfiguration"]
        "The phase, for the same pairs.";
    PAIR_GAP = "/pairs/A~B/gap" ["Scalars"]
        "Smallest distance of the surfaces, or minus the depth of their overlap, how deep a point of one surface lies in the other [radii of the smaller body].";
    PAIR_OVERLAP = "/pairs/A~B/overlap" ["Scalars"]
        "Volume of the intersection [its radius³].";
    PAIR_NECK = "/pairs/A~B/neck" ["Scalars"]
        "Radius of the seam [radii of the smaller body].";
    PAIR_CONTACT = "/pairs/A~B/contact" ["StateChange, StateConfiguration"]
        "Whether the bodies are joined by their phase, and whether their surfaces touch; \"not measured\" before a pair that has entities because of an event got them.";
    TOUCHING = "/touching/MODEL" ["StateChange, StateConfiguration"]
        "With several models side by side: the pairs of bodies whose surfaces touch, of those with plots.";
    PAIR_SCALAR = "/between/SCALAR/A~B" ["Scalars"]
        "A scalar of a pair that the simulation names, for the same pairs.";
    BODY_SCALAR = "/bodies/SCALAR/NAME" ["Scalars"]
        "A scalar of a body that the simulation names, for the first 64 bodies.";
    GROUP = "/groups/A" ["bodies"]
        "The names of the bodies of the group whose first body is A; none once it has dissolved.";
    GROUP_LINE = "/groups/A/QUANTITY" ["Scalars"]
        "Volume, area, genus, components, Euler characteristic and number of bodies of the group, of its sharp union.";
    EVENTS = "/events" ["TextLog, bodies, phases, time, q, rate, energy"]
        "One line per change of a phase; a thin recording has all events here.";
    ACCURACY = "/events/accuracy" ["TextLog"]
        "One line when the error of a body begins to exceed the tolerance, and when it has doubled since: which body, and by how much.";
    SCHEDULED = "/events/scheduled" ["TextLog"]
        "One line per edit of the scene, and when a push or a force point begins or ceases to act.";
    FAILED = "/events/failure" ["TextLog"]
        "Why the run ended before its last step.";
    SURFACE_EVENTS = "/events/surfaces" ["TextLog, bodies, phases, time, q"]
        "One line when surfaces touch or part; phases are empty.";
    BODY_EVENTS = "/events/bodies" ["TextLog"]
        "One line per event of a single body, with its position.";
    MARKS_ON_AXIS = "/marks/axis/KIND" ["Scalars, SeriesPoints"]
        "Events, and what the scene changes, as markers on the axis of plots.";
    MARKS_AT_Q = "/marks/q/KIND" ["Scalars, SeriesPoints"]
        "Events and near misses as markers in plots of q, and the ends of the run.";
    MARKS_OF_DRAWN = "/marks/drawn/KIND" ["Scalars, SeriesPoints"]
        "The same for the pairs whose q the layout draws, if it leaves some out.";
    TIMING = "/timings/STAGE" ["Scalars"]
        "What a stage of the step or of the recording costs [ms per step].";
    STACKED = "/timings/stacked/N_STAGE" ["Scalars"]
        "The same, with the stages before it on the same thread; numbered from the top of the stack.";
    RANKED_ENERGIES = "/ranking/energies/N" ["Points2D, LineStrips2D"]
        "Rows with labels and bars: the scalars in a plot of energies at an instant, those that have not been 0 in all frames; those in a plot of one line follow those of the plot before it, and the first has its value at the start beside it.";
    RANKED_STAGES = "/timings/ranking" ["Points2D, LineStrips2D"]
        "Rows with labels and bars: the share and the peak of each stage in the whole run, and the slowest frame.";
    SPEED = "/timings/speed" ["Scalars"]
        "Steps per second.";
    LAG = "/timings/lag" ["Scalars"]
        "How far a run in real time is behind [ms].";
    DIAGNOSTIC = "/diagnostics/SCALAR" ["Scalars"]
        "Energy, error, counts.";
    VOLUME = "/volume/OF" ["Scalars"]
        "The volume that all surfaces enclose, of each group that of its sharp union, and the sum of the volumes of the bodies one by one [scene unit³]; with at most 64 bodies. With several models side by side, the volume of the surfaces of each.";
    OVERLAPPING = "/diagnostics/overlapping_groups" ["Scalars"]
        "Groups that could not be united in time and are drawn as overlapping meshes.";
    LEGEND = "/legend/PART" ["Image; Points2D"]
        "The colour scale of displacements, and its numbers at the instant.";
    LARGEST = "/largest" ["Points3D, LineStrips3D"]
        "The vertex with the largest displacement of those that lie in no other body, and above it its label, also with the largest of all.";
    BODY_DISPLACEMENT = "/displacement/NAME" ["Scalars"]
        "With at most 16 bodies: the largest displacement of a vertex of each [radii].";
    LARGEST_OF_BODIES = "/largest/bodies" ["Points3D"]
        "Of the five bodies with the largest displacements, the names and these [radii], and the names of others, of at most 32, where there is room.";
    STAGES = "/stages" ["TextLog"]
        "One line per stage of the steps recorded in detail, with the largest displacement and how far vertices moved since the stage before, on the timeline stage, which the entities under /world have too, and on that of steps.";
    MOVES = "/stages/moves" ["Arrows3D"]
        "On the timeline stage: how vertices moved since the stage before, from where they are now; the longest arrow of a step is half as long as the largest radius.";
    FURTHEST = "/stages/furthest" ["Points3D, LineStrips3D"]
        "The vertex that moved furthest, and above it a label with how far [radii].";
    CHECKSUM = "/checksum" ["checksum"]
        "A hash of the exact state after every step; a thin recording has several steps per row, at the time of the last one.";
    ABOUT = "/about" ["TextDocument"]
        "The text of the panel.";
    ABOUT_STAGES = "/about/stages" ["TextDocument"]
        "The text beside stages inside steps.";
    ARROWS = "/about/arrows" ["TextDocument"]
        "The text beside forces: their colours, and what the lengths of arrows mean.";
    RECORDING_INFO = "/__properties" ["RecordingInfo"]
        "The name of the recording.";
    PROPERTIES = "/__properties/meldscope" ["the properties below"]
        "What a replay needs, and how the recording was made.";
    GOLDEN_VERTICES = "/golden/vertices" ["bodies, hashes"]
        "In a golden recording: a hash of two bytes for every vertex of every body that is free or not at rest, at every step.";
    GOLDEN_STATES = "/golden/states" ["bodies, displacements, frames"]
        "In a golden recording: displacements of these bodies every 20 steps, and the centres and rotations of the free ones.";
    GOLDEN_SURFACES = "/golden/surfaces" ["names, values"]
        "In a golden recording: the quantities of pairs and groups every 20 steps, by the entity that plots them.";
    COMPARED_SURFACE = "/world/SIDE/NAME" ["Mesh3D"]
        "In a comparison: the surface of a body in the first or the second run.";
    COMPARED_ERROR = "/world/error" ["Arrows3D, Points3D"]
        "In a comparison: arrows from the vertices of the first run towards those of the second, and points at these, where they differ by more than a tenth of the largest difference of the instant; the longest of an instant has a length of at least 0.3 radii.";
    COMPARED_WORST = "/world/worst" ["Points3D, LineStrips3D"]
        "In a comparison: the vertex that differs most, and a line to its label.";
    COMPARED_DISTANCE = "/q/SIDE/A~B" ["Scalars"]
        "In a comparison: q in the first or the second run, of the first 4 pairs whose events differ.";
    COMPARED_EVENTS = "/q/events/SIDE/A~B" ["Scalars, SeriesPoints"]
        "In a comparison: the events of these pairs that differ, as markers at q.";
    COMPARED_LEVEL = "/q/levels/SIDE/A~B/THRESHOLD" ["Scalars"]
        "In a comparison: the thresholds of these pairs that differ.";
    DIFFERENCE = "/difference/NAME" ["Scalars"]
        "In a comparison: the largest difference of a body [radii], and the tolerance.";
    LOG_DIFFERENCE = "/log10/difference/NAME" ["Scalars"]
        "In a comparison: the decimal logarithms of these, where they are not 0.";
    MAP = "/map/LAYER" ["Image, LineStrips2D, Points2D"]
        "In the map of a sweep: its regions, their boundaries and names, every run as a point, thresholds that were bisected, and ticks; on the timeline slice, which counts maps.";
    MEASURE = "/along/COLUMN/LINE" ["LineStrips2D, Points2D"]
        "In the map of a sweep: a measure along the first axis, for three values of the second, and ticks.";
}

macro_rules! components {
    ($(#[$of:meta])* $ALL:ident: $($NAME:ident = $name:literal $about:literal;)*) => {
        $(#[doc = $about]
        pub const $NAME: Component = Component($name);)*

        $(#[$of])*
        pub static $ALL: &[(Component, &str)] = &[$(($NAME, $about)),*];
    };
}

components! {
    /// All components that are not part of an archetype of the SDK, each with what it holds.
    COMPONENTS:
    CHECKSUMS = "checksum" "Hashes of the exact state.";
    DRAWN = "drawn_triangles" "Triangles of a body's own surface that are drawn beside merged surfaces.";
    LIT = "lit_colors" "Colours of vertices with baked lighting.";
    UNLIT = "unlit_normals" "The normal that receives no light.";
    HEAT_PLACES = "heat_texcoords" "Displacements, as coordinates in the texture of colours.";
    HEAT_TEXTURE = "heat_texture" "The texture of colours.";
    HEAT_FORMAT = "heat_format" "Its format.";
    VERTEX_BODY = "body" "Name of the body of a vertex or an instance.";
    VERTEX = "vertex" "Index of a vertex in its body.";
    DISPLACEMENT = "displacement_in_radii" "Displacement of a vertex from rest [radii].";
    VERTEX_NET_FORCE = "net_force" "Acceleration of a vertex [scene unit/s²].";
    REACH = "reach" "What acts on a vertex.";
    BODIES = "bodies" "Names or indices of bodies.";
    PHASES = "phases" "The phases of a pair before and after an event.";
    TIME = "time" "Exact time of an event [s].";
    Q = "q" "Centre distance over the sum of the radii at an event.";
    RATE = "rate" "Rate of change of q at an event [1/s].";
    ENERGY = "energy" "Energy that free bodies gained by an event [mass · scene unit²/s²].";
    HASHES = "hashes" "Hashes of vertices.";
    DISPLACEMENTS = "displacements" "Displacements of vertices [scene unit].";
    FRAMES = "frames" "Centres and rotations of free bodies.";
    QUANTITIES = "names" "Entities that plot quantities.";
    VALUES = "values" "Values of these quantities.";
}

components! {
    /// The components of [`PROPERTIES`], each with what it holds.
    ALL_PROPERTIES:
    SCENE = "scene" "Text of the scene, with its meshes.";
    SETTINGS = "settings" "Resolved settings of the run and of the recording.";
    OVERRIDES = "overrides" "What the run overrides of the scene.";
    VERSION = "version" "Version of the program.";
    FORMAT = "format" "Version of the format of recordings.";
    MACHINE = "machine" "Machine that made the recording.";
    INTEGRATOR = "integrator" "Name of the integrator.";
    MODEL = "model" "Name of the model, unless it is the default one.";
    STEPS = "steps" "Number of steps.";
    DIGEST = "digest" "Hash of all checksums.";
    FAILURE = "failure" "Why the run ended before its last step.";
    BLESSED = "blessed" "Reason of a golden recording.";
    COUNTS = "counts" "Vertices and triangles of a golden recording.";
}

/// Name of the timeline of steps.
pub const STEP: &str = "step";
/// Name of the timeline of simulated time.
pub const SIM_TIME: &str = "sim_time";
/// Name of the timeline of stages inside steps.
pub const STAGE: &str = "stage";
/// Name of the timeline of maps in the map of a sweep.
pub const SLICE: &str = "slice";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_made_and_recognised() {
        assert_eq!(BODY_SURFACE.of(&["a"]), "/world/bodies/a/surface");
        assert_eq!(PAIR_LEVEL.of(&["a~b", "grip_at"]), "/pairs/a~b/grip_at");
        assert_eq!([BODY_SURFACE.family(), EVENTS.family()], ["/world/bodies", "/events"]);
        assert_eq!(PAIR_PHASE.names("/pairs/a~b/phase"), Some(vec!["a~b"]));
        for other in ["/pairs/a~b", "/pairs/a~b/phase/more", "/groups/a~b/phase"] {
            assert!(!PAIR_PHASE.is(other), "{other}");
        }
        assert!(EVENTS.is("/events") && !EVENTS.is("/events/bodies"));
    }
}
