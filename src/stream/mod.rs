//! Recording of a simulation as Rerun data, for a file or a live viewer.
//!
//! | contents | module |
//! | --- | --- |
//! | recording of a whole run | [`mod@record`] |
//! | a recording from its first message to its last | [`recorder`] |
//! | recording on a separate thread | [`pipeline`] |
//! | the entities of a frame, and what is logged to each | [`parts`] |
//! | the data of a step to be recorded | [`step`] |
//! | states as meshes and arrows, in the precision of the viewer | [`extract`] |
//! | the settings that determine a recording | [`settings`] |
//! | prediction of the size of a recording | [`size`] |
//! | every entity, component and property | [`contract`] |
//! | plot lines | [`series`] |
//! | a hash of the state for every step | [`checksums`] |
//! | the last frames, kept until a trigger fires | `flight` |
//! | the machine on which a recording was made | [`machine`] |
//! | time points of rows | [`instant`] |
//! | batching of rows into chunks and messages | [`chunks`]; [`columns`] for what is logged every frame |
//! | the layout that the viewer opens with | [`blueprint`] |
//! | colours and their meaning | [`palette`] |
//! | the light on surfaces | [`light`] |
//! | destinations of messages: files, viewers, servers | [`sinks`] |
//!
//! Nothing here depends on a particular simulation: see [`observe`](crate::observe).
//!
//! # Contents of a recording
//! A recording has two timelines, `step` and `sim_time`, and the entities below. Unchanged values are not logged again.
//! Equal runs give equal recordings except for `/timings`, the axis ranges of their plots in the layout, and the name
//! of the machine.
//!
//! | entity | holds | shows |
//! | --- | --- | --- |
//! | `/world` | ViewCoordinates | Axes: right-handed, z up. |
//! | `/world/bodies/NAME` | Transform3D | Transform to the centre of a body, and of a free one its rotation. |
//! | `/world/bodies/NAME/surface` | Mesh3D, drawn_triangles, lit_colors, unlit_normals, heat_…; with forces body, vertex, displacement_in_radii, net_force, reach | Mesh in the axes of the body. A body in a group keeps its own surface, but draws one degenerate triangle of it. |
//! | `/world/resting/SHAPE` | Mesh3D, InstancePoses3D, body | With more than 64 bodies: the undeformed ones, as instances of their shape. |
//! | `/world/deforming/surface` | as the surface of a body | With more than 64 bodies: the deformed ones, as one mesh in world coordinates. |
//! | `/world/merged` | AnnotationContext | Names of the bodies, as classes of the vertices of merged surfaces. |
//! | `/world/merged/surface` | Mesh3D, vertex, lit_colors, unlit_normals | The surfaces of all groups (two or more bodies connected by joined pairs), as one mesh in world coordinates. |
//! | `/world/merged/seams` | LineStrips3D | The lines along which bodies meet. |
//! | `/world/influence` | Ellipsoids3D | All influence spheres, coloured by the deepest phase of their body. |
//! | `/world/pairs` | LineStrips3D; with more than 64 bodies Ellipsoids3D | Lines between the centres of the closest pairs within reach, up to three labelled with the pair and q; with many bodies also the influence spheres that reach another body. |
//! | `/world/recent` | LineStrips3D, Points3D | The pairs that had the events of the last step with any, up to four, labelled with the event and q, for 24 frames; with more than 8 bodies that of the last event, until the next. The labels are above all bodies, on lines that lead to the pairs. |
//! | `/recent/pair` | Mesh3D, lit_colors, unlit_normals | With more than 8 bodies: the two of the last event alone, about the point midway between them [radii of the larger]. |
//! | `/recent/spheres` | Ellipsoids3D | Their influence spheres. |
//! | `/recent/names` | Points3D | Their names. |
//! | `/world/names` | Points3D | The names of bodies for which there is room, in a scene of at most 32; with several models side by side, of those of the first, and the names of the models. |
//! | `/world/forces` | AnnotationContext | Names of the pairs of bodies between which forces act, as classes of arrows. |
//! | `/world/forces/CAUSE` | Arrows3D | Accelerations of vertices and of points of contact by one cause, times the arrow scale given in the panel; those of uniform forces, net_force and torque: one arrow per free body, at its centre. |
//! | `/forces/NAME/CAUSE` | Scalars | Net force on a body by one cause over its mass: the length of the mean acceleration of its vertices, by mass if it is free, and of that by forces at points [scene unit/s²]; with at most 16 bodies, from the first frame in which it acts. |
//! | `/world/resultants` | Arrows3D | The mean acceleration of the vertices of each body by each cause, by mass if it is free, and by forces at points, as arrows at its centre, the net force beside it; all of an instant on the largest scale on which none is longer than 1.5 times the geometric mean of the radius of its body and the largest radius. |
//! | `/world/resultants/labels` | Points3D | Of the five bodies with the largest net forces, the names, these forces and their strongest causes [scene unit/s²], and the names of others, of at most 32, where there is room. |
//! | `/strongest/CAUSE` | Scalars | With more than 3 bodies: the largest of the net forces on bodies by one cause, or by all together, over their masses [scene unit/s²]; from the first frame in which it acts. |
//! | `/ranking/forces` | Points2D, LineStrips2D | Rows with labels and bars: the strongest forces on bodies as wholes at an instant; with more than 3 bodies, those with the largest net forces, each with a dot at each cause. |
//! | `/ranking/displacements` | Points2D, LineStrips2D | With more than 3 bodies: rows with labels and bars, for those with the largest displacements at an instant. |
//! | `/ranking/groups` | Points2D, LineStrips2D | With more than 3 bodies: rows with labels and bars, for the largest groups at an instant: their pieces and volumes [scene unit³], and with at most 64 bodies how these differ from the volumes of their bodies one by one. |
//! | `/ranking/pairs` | Points2D, LineStrips2D | With more than 3 bodies: rows with labels, q and thresholds, for the pairs that change phase next. |
//! | `/world/not_recorded` | Points3D | Labels: while a flight recorder kept no frames, when a Clear ends all else that shows a state; and where a run failed, at the body with the largest displacement. |
//! | `/world/points` | Ellipsoids3D, Points3D | The influence spheres of force points, while they act, and above them their names. |
//! | `/world/springs/NAME` | LineStrips3D | The springs of a body, blue where they are shorter than at rest, red-orange where longer; with forces, and of at most 64 cells. |
//! | `/world/trails` | LineStrips3D | The path of the centre of each free body, one segment per frame; not with more than 64 bodies. |
//! | `/world/planes/N` | Mesh3D | A plane. |
//! | `/world/planes/N/grid` | LineStrips3D | Its grid. |
//! | `/pairs/A~B/distance` | Scalars | q, for the first 16 pairs within reach, or 5 with more than 64 bodies (--plots), and up to as many that have events, throughout the run. |
//! | `/pairs/A~B/LEVEL` | Scalars | A threshold of q, for the same pairs: merge_at, split_at, core_at. |
//! | `/pairs/A~B/phase` | StateChange, StateConfiguration | The phase, for the same pairs. |
//! | `/pairs/A~B/gap` | Scalars | Smallest distance of the surfaces, or minus the depth of their overlap, the largest at vertices and in the middles of edges and triangles [radii of the smaller body]. |
//! | `/pairs/A~B/overlap` | Scalars | Volume of the intersection [its radius³]. |
//! | `/pairs/A~B/neck` | Scalars | Radius of the seam [radii of the smaller body]. |
//! | `/pairs/A~B/contact` | StateChange, StateConfiguration | Whether the bodies are joined by their phase, and whether their surfaces touch. |
//! | `/touching/MODEL` | StateChange, StateConfiguration | With several models side by side: the pairs of bodies whose surfaces touch, of those with plots. |
//! | `/between/SCALAR/A~B` | Scalars | A scalar of a pair that the simulation names, for the same pairs. |
//! | `/bodies/SCALAR/NAME` | Scalars | A scalar of a body that the simulation names, for the first 64 bodies. |
//! | `/groups/A` | bodies | The names of the bodies of the group whose first body is A; none once it has dissolved. |
//! | `/groups/A/QUANTITY` | Scalars | Volume, area, genus, components, Euler characteristic and number of bodies of the group, of its sharp union. |
//! | `/events` | TextLog, bodies, phases, time, q, rate, energy | One line per change of a phase; a thin recording has all events here. |
//! | `/events/accuracy` | TextLog | One line when the error of a body begins to exceed the tolerance, and when it has doubled since: which body, and by how much. |
//! | `/events/scheduled` | TextLog | One line per edit of the scene, and when a push or a force point begins or ceases to act. |
//! | `/events/failure` | TextLog | Why the run ended before its last step. |
//! | `/events/surfaces` | TextLog, bodies, phases, time, q | One line when surfaces touch or part; phases are empty. |
//! | `/events/bodies` | TextLog | One line per event of a single body, with its position. |
//! | `/marks/axis/KIND` | Scalars, SeriesPoints | Events, and what the scene changes, as markers on the axis of plots. |
//! | `/marks/q/KIND` | Scalars, SeriesPoints | Events and near misses as markers in plots of q, and the ends of the run. |
//! | `/marks/drawn/KIND` | Scalars, SeriesPoints | The same for the pairs whose q the layout draws, if it leaves some out. |
//! | `/timings/STAGE` | Scalars | What a stage of the step or of the recording costs [ms per step]. |
//! | `/timings/stacked/N_STAGE` | Scalars | The same, with the stages before it on the same thread; numbered from the top of the stack. |
//! | `/ranking/energies/N` | Points2D, LineStrips2D | Rows with labels and bars: the scalars in a plot of energies at an instant, those that have not been 0 in all frames; those in a plot of one line follow those of the plot before it, and the first has its value at the start beside it. |
//! | `/timings/ranking` | Points2D, LineStrips2D | Rows with labels and bars: the share and the peak of each stage in the whole run, and the slowest frame. |
//! | `/timings/speed` | Scalars | Steps per second. |
//! | `/timings/lag` | Scalars | How far a run in real time is behind [ms]. |
//! | `/diagnostics/SCALAR` | Scalars | Energy, error, counts. |
//! | `/volume/OF` | Scalars | The volume that all surfaces enclose, of each group that of its sharp union, and the sum of the volumes of the bodies one by one [scene unit³]; with at most 64 bodies. With several models side by side, the volume of the surfaces of each. |
//! | `/diagnostics/overlapping_groups` | Scalars | Groups that could not be united in time and are drawn as overlapping meshes. |
//! | `/legend/PART` | Image; Points2D | The colour scale of displacements, and its numbers at the instant. |
//! | `/largest` | Points3D, LineStrips3D | The vertex with the largest displacement of those that lie in no other body, and above it its label, also with the largest of all. |
//! | `/displacement/NAME` | Scalars | With at most 16 bodies: the largest displacement of a vertex of each [radii]. |
//! | `/largest/bodies` | Points3D | Of the five bodies with the largest displacements, the names and these [radii], and the names of others, of at most 32, where there is room. |
//! | `/stages` | TextLog | One line per stage of the steps recorded in detail, with the largest displacement and how far vertices moved since the stage before, on the timeline stage, which the entities under /world have too, and on that of steps. |
//! | `/stages/moves` | Arrows3D | On the timeline stage: how vertices moved since the stage before, from where they are now; the longest arrow of a step is half as long as the largest radius. |
//! | `/stages/furthest` | Points3D, LineStrips3D | The vertex that moved furthest, and above it a label with how far [radii]. |
//! | `/checksum` | checksum | A hash of the exact state after every step; a thin recording has several steps per row, at the time of the last one. |
//! | `/about` | TextDocument | The text of the panel. |
//! | `/about/stages` | TextDocument | The text beside stages inside steps. |
//! | `/about/arrows` | TextDocument | The text beside forces: their colours, and what the lengths of arrows mean. |
//! | `/__properties` | RecordingInfo | The name of the recording. |
//! | `/__properties/meldscope` | the properties below | What a replay needs, and how the recording was made. |
//! | `/golden/vertices` | bodies, hashes | In a golden recording: a hash of two bytes for every vertex of every body that is free or not at rest, at every step. |
//! | `/golden/states` | bodies, displacements, frames | In a golden recording: displacements of these bodies every 20 steps, and the centres and rotations of the free ones. |
//! | `/golden/surfaces` | names, values | In a golden recording: the quantities of pairs and groups every 20 steps, by the entity that plots them. |
//! | `/world/SIDE/NAME` | Mesh3D | In a comparison: the surface of a body in the first or the second run. |
//! | `/world/error` | Arrows3D | In a comparison: arrows from the vertices of the first run towards those of the second; the longest of an instant has a length of at least 0.3 radii. |
//! | `/world/worst` | Points3D, LineStrips3D | In a comparison: the vertex that differs most, and a line to its label. |
//! | `/q/SIDE/A~B` | Scalars | In a comparison: q in the first or the second run, of the first 4 pairs whose events differ. |
//! | `/q/events/SIDE/A~B` | Scalars, SeriesPoints | In a comparison: the events of these pairs that differ, as markers at q. |
//! | `/difference/NAME` | Scalars | In a comparison: the largest difference of a body [radii], and the tolerance. |
//! | `/log10/difference/NAME` | Scalars | In a comparison: the decimal logarithms of these, where they are not 0. |
//! | `/map/LAYER` | Image, LineStrips2D, Points2D | In the map of a sweep: its regions, their boundaries and names, every run as a point, thresholds that were bisected, and ticks; on the timeline slice, which counts maps. |
//! | `/along/COLUMN/LINE` | LineStrips2D, Points2D | In the map of a sweep: a measure along the first axis, for three values of the second, and ticks. |

pub mod blueprint;
pub mod checksums;
pub mod chunks;
pub mod columns;
pub mod contract;
pub mod extract;
mod flight;
mod focus;
pub mod instant;
pub mod light;
pub mod machine;
pub mod palette;
pub mod parts;
pub mod pipeline;
pub mod record;
pub mod recorder;
pub mod series;
pub mod settings;
pub mod sinks;
pub mod size;
pub mod step;

pub use pipeline::Pipeline;
pub use record::{RecordError, record, record_all};
pub use recorder::Recorder;
pub use settings::Settings;
