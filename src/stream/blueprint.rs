//! The layout (blueprint) that the viewer opens with, sent along with every recording.
//!
//! The SDK's own builder supports neither cameras nor axes, so this module logs the blueprint's archetypes itself: a
//! tree of containers and views, each an entity of the blueprint store with its own id.

use glam::DVec3;

use super::{
    chunks::{Chunks, blueprint_time},
    contract::{
        ABOUT, ACCURACY, ARROWS, BODY, BODY_FORCE, BODY_SCALAR, BODY_SURFACE, COMPARED_DISTANCE, COMPARED_EVENTS,
        DEFORMING, DIAGNOSTIC, DRAWN, EVENTS, Entity, FORCE, GROUP_LINE, INFLUENCE, LAG, LARGEST, LEGEND,
        LOG_DIFFERENCE, MAP, MARKS_AT_Q, MARKS_ON_AXIS, MEASURE, MERGED, MERGED_SURFACE, NAMES, PAIR_CONTACT,
        PAIR_DISTANCE, PAIR_GAP, PAIR_LEVEL, PAIR_NECK, PAIR_OVERLAP, PAIR_PHASE, PAIR_SCALAR, PLANE, RECENT_NAMES,
        RECENT_PAIR, RECENT_SPHERES, RESTING, SIM_TIME, SLICE, SPEED, STAGE, STAGES, STEP, TRAILS, VOLUME, WORLD,
    },
    focus::Focus,
    legends::Plot,
    light, palette,
    parts::{
        body_forces, heat, net_forces, numbers,
        pairs::{self, MEASURES, Told},
        recent, trails,
    },
    settings::{Detail, Entities, Frames, Settings},
};
use crate::{
    colors,
    observe::{Frame, Schema, Simulation, schema::TermSchema},
    sdk::{
        self, AsComponents, BlueprintActivationCommand, LogMsg, Mesh3D, Points3D, SeriesLines, StoreId, StoreKind,
        TimePoint,
        blueprint::{
            archetypes::{
                ActiveVisualizers, Background, ContainerBlueprint, EntityBehavior, EyeControls3D, LineGrid3D,
                PanelBlueprint, PlotLegend, ScalarAxis, TextLogColumns, TimeAxis, TimePanelBlueprint, ViewBlueprint,
                ViewContents, ViewportBlueprint, VisibleTimeRanges, VisualBounds2D, VisualizerInstruction,
            },
            components::{
                AbsoluteTimeRange, BackgroundKind, ContainerKind, Corner2D, Eye3DKind, LinkAxis, LoopMode, PanelState,
                PlayState, TimelineColumn, VisibleTimeRange, VisualizerInstructionId,
            },
            datatypes::{ComponentSourceKind, TextLogColumn, TextLogColumnKind, VisualizerComponentMapping},
        },
        components::{Plane3D, Position3D, Range1D, Vector3D},
        datatypes::{self, TimeRange, TimeRangeBoundary, Uuid},
    },
    text::{self, counted, significant},
};

/// The recording for which a layout is made.
pub struct Subject<'a> {
    /// The recorded simulation.
    pub simulation: &'a dyn Simulation,
    /// The schema of the simulation.
    pub schema: &'a Schema,
    /// The settings of the recording.
    pub settings: &'a Settings,
}

/// The vertices of a mesh as points.
const VERTICES: Mapping = Mapping { target: "Points3D:positions", source: "Mesh3D:vertex_positions" };

/// A line of a view's contents: an entity.
fn including(entity: &str) -> String {
    format!("+ {entity}")
}

/// A line of a view's contents: all entities of a family, and what is below them.
fn family(entity: &Entity) -> String {
    format!("+ {}/**", entity.family())
}

/// The messages that create the layout for `recording` and activate it.
pub fn messages(subject: &Subject<'_>, tab: Tab, recording: &StoreId) -> Vec<LogMsg> {
    let mut layout = Layout::of(recording);
    let root = layout.root(subject, tab);
    layout.finish(root)
}

/// Data of a run that is known only at its end.
#[derive(Clone, Debug, Default)]
pub struct Measured<'a> {
    /// Duration of the run [s].
    pub duration: f64,
    /// Stages and the medians of their durations [ms].
    pub medians: Vec<(&'static str, f64)>,
    /// Typical total duration of a step and of its recording [ms]: the upper ends of the timing plots.
    pub typical: [f64; 2],
    /// The same of the longest.
    pub longest: [f64; 2],
    /// The largest speed [steps per second]; 0 if there is none.
    pub fastest: f64,
    /// Smallest and largest plotted q [–], if any.
    pub distances: Option<[f64; 2]>,
    /// The entities of all lines of plots, with some of their points: steps and values.
    pub lines: Vec<(&'a str, &'a [(u64, f64)])>,
    /// Smallest and largest plotted value of each scalar of the schema.
    pub scalars: Vec<Option<[f64; 2]>>,
    /// The pairs that have plots.
    pub pairs: Told,
    /// The initial focus of the viewer.
    pub focus: Option<&'a Focus>,
    /// The times between which a flight recorder has frames [s], if there is one and it has some.
    pub kept: Option<[f64; 2]>,
    /// Whether each force term has acted on any body; empty if forces were not recorded.
    pub have_acted: &'a [bool],
}

/// The changes to [`messages`] at the end of a run. The axes of timing plots exclude rare outliers. The viewer opens
/// at the first event: playing it in a loop is the only way in which a layout can move the time cursor.
pub fn measured(subject: &Subject<'_>, tab: Tab, recording: &StoreId, measured: &Measured<'_>) -> Vec<LogMsg> {
    /// Ratio of a plot's upper end to the typical value.
    const HEADROOM: f64 = 1.3;

    let mut layout = Layout::of(recording);
    let root = layout.root(subject, tab);
    layout.finish(root); // already sent; the new ids continue after its own
    for (plot, stages, title) in std::mem::take(&mut layout.timings) {
        let is_recording = stages.iter().any(|stage| numbers::RECORDING.contains(stage));
        let [typical, longest] = [measured.typical, measured.longest].map(|of| of[usize::from(is_recording)]);
        if typical > 0.0 {
            let [low, high] = readable([0.0, HEADROOM * typical]);
            if longest > high {
                let title = format!("{title}; at most {}", significant(longest));
                layout.log(&plot.path, &ViewBlueprint::update_fields().with_display_name(title));
            }
            layout.set_range(&plot.path, [low, high]);
        }
        for (stage, median) in measured.medians.iter().filter(|(stage, _)| stages.contains(stage)) {
            let median = if *median < 1e-3 { "below 0.001".to_owned() } else { significant(*median) };
            let name = format!("{stage}, median {median} ms");
            let entity = numbers::stacked(subject.schema, stage);
            let style = SeriesLines::update_fields().with_names([name]);
            layout.visualize(&plot.path, &entity, &[("SeriesLines", &[], &style)]);
        }
    }
    if let Some(speeds) = layout.speeds.take().filter(|_| measured.fastest > 0.0) {
        layout.set_range(&speeds, readable([0.0, measured.fastest]));
    }
    if let Some([low, high]) = measured.distances {
        // an automatic axis would begin at 0
        let margin = 0.05 * (high - low);
        for plot in layout.distances.clone() {
            layout.set_range(&plot, [low - margin, high + margin]);
        }
    }
    let owned = || subject.schema.body_scalars.iter().chain(&subject.schema.pair_scalars);
    let ranges = || subject.schema.scalars.iter().zip(&measured.scalars);
    let is_energy = |plot: &str| plot.starts_with(ENERGY);
    let energies = ranges().filter(|(scalar, _)| is_energy(scalar.plot)).filter_map(|(_, range)| *range);
    let exchanged = energies.map(|[low, high]| high - low).fold(0.0, f64::max);
    for (plot, name) in std::mem::take(&mut layout.scalars) {
        if measured.duration == 0.0 || owned().any(|scalar| scalar.plot == name) {
            continue; // their ranges are not known
        }
        let ([mut low, mut high], mut least, mut lines) = ([0.0_f64; 2], 0.0, 0); // events are marked at 0
        for (scalar, range) in ranges().filter(|(scalar, _)| scalar.plot == name) {
            let of = range.unwrap_or_default();
            (low, high) = (low.min(of[0]), high.max(of[1]));
            (least, lines) = (scalar.least_range.max(least), lines + 1);
        }
        let range = if high - low < least { [-0.5 * least, 0.5 * least] } else { readable([low, high]) };
        if range[0] < range[1] {
            layout.set_range(&plot, range);
        }
        let largest = high.max(-low);
        if lines == 1 && largest > 0.0 {
            let share = match is_energy(name) && exchanged > 0.0 {
                true => format!(", {:.0e} of the largest exchange", largest / exchanged),
                false => String::new(),
            };
            let largest = if largest < 1e-3 { format!("{largest:.1e}") } else { significant(largest) };
            let title = format!("{name}: at most {largest}{share}");
            layout.log(&plot, &ViewBlueprint::update_fields().with_display_name(title));
        }
    }
    for (view, has_acted) in std::mem::take(&mut layout.forces).into_iter().zip(measured.have_acted) {
        if !has_acted
            && measured.duration > 0.0
            && let Some((view, name)) = view
        {
            layout.log(&view, &ViewBlueprint::update_fields().with_display_name(format!("{name} (none)")));
        }
    }
    if let Some(kept) = measured.kept {
        layout.open_at(kept);
    }
    if let Some(focus) = measured.focus {
        if tab != Tab::Stages {
            layout.open_at(focus.interval(measured.duration));
        }
        let spaces = std::mem::take(&mut layout.spaces);
        for aspect in [WIDE, NARROW] {
            let camera = camera_past(&focus.spheres, &focus.pair, &focus.others, aspect);
            for (view, _) in spaces.iter().filter(|(_, of)| *of == aspect) {
                layout.log(&format!("{view}/EyeControls3D"), &camera);
            }
        }
    }
    let Told { alike, changed, met, all } = &measured.pairs;
    let is_shorter = alike.len() < *all || changed.len() < *all || met.len() < *all;
    if is_shorter || (!pairs::has_named_pairs(subject.schema) && *all > 0) {
        // the pairs that have plots, and what they plot, are known only now
        let mut lines = vec![family(&MARKS_AT_Q)];
        for alike in alike {
            let Some(pair) = alike.first() else { continue };
            lines.push(including(&PAIR_DISTANCE.of(&[pair])));
            let levels = subject.schema.thresholds.iter().map(|threshold| PAIR_LEVEL.of(&[pair, threshold.name]));
            lines.extend(levels.map(|level| including(&level)));
            if alike.len() > 1 {
                let others = counted(alike.len() as u64 - 1, "other pair");
                let style = SeriesLines::update_fields().with_names([format!("q {pair}, and {others} like it")]);
                for plot in layout.distances.clone() {
                    layout.visualize(&plot, &PAIR_DISTANCE.of(&[pair]), &[("SeriesLines", &[], &style)]);
                }
            }
        }
        let lanes = |of: &Entity, pairs: &[String]| pairs.iter().map(|pair| including(&of.of(&[pair]))).collect();
        let views = [
            (std::mem::take(&mut layout.distances), lines),
            (std::mem::take(&mut layout.phases), lanes(&PAIR_PHASE, changed)),
            (std::mem::take(&mut layout.contacts), lanes(&PAIR_CONTACT, met)),
        ];
        for (paths, lines) in views {
            for path in paths {
                if let Some(plot) = layout.plots.iter_mut().find(|plot| plot.path == path) {
                    plot.contents.clone_from(&lines);
                }
                layout.log(&format!("{path}/ViewContents"), &ViewContents::new(lines.iter().map(String::as_str)));
            }
        }
    }
    for plot in std::mem::take(&mut layout.plots) {
        let corner = plot.emptiest_corner(&measured.lines);
        if corner != plot.corner {
            layout.log(&format!("{}/PlotLegend", plot.path), &PlotLegend::update_fields().with_corner(corner));
        }
    }
    let messages = layout.chunks.take();
    if messages.is_empty() { messages } else { layout.activate(messages) }
}

/// The title of the view of everything.
fn scene_title(schema: &Schema) -> &'static str {
    match schema.bodies.iter().all(|body| body.reach == 0.0) && schema.points.is_empty() {
        _ if recent::is_drawn_alone(schema) => "Bodies, and the pair of the last event",
        true => "Bodies, forces",
        false => "Bodies, influence spheres, forces",
    }
}

/// The range of an axis that has numbers: the viewer labels the multiples of a power of ten, unless they are dense. Some
/// more is shown where that lets it label the next power.
fn readable([low, high]: [f64; 2]) -> [f64; 2] {
    /// Multiples that have labels in a plot of usual height.
    const LABELLED: f64 = 6.0;
    const MARGIN: f64 = 0.04;

    let decade = 10f64.powf(high.max(-low).log10().floor());
    let ten = if high - low > LABELLED * decade { 10.0 * decade } else { 0.0 };
    let [low, high] = if high >= -low { [low, high.max(ten)] } else { [low.min(-ten), high] };
    let margin = MARGIN * (high - low);
    [low - margin, high + margin]
}

/// The layout for a page that has its own controls of time, curves and list of events: what is in space alone, paused.
pub fn beside_controls(subject: &Subject<'_>, recording: &StoreId) -> Vec<LogMsg> {
    let Subject { simulation, schema, settings } = *subject;
    let (framing, close) = (simulation.framing(false), simulation.framing(true));
    let mut layout = Layout::of(recording);
    layout.timeline = STEP;
    layout.ground = Ground::under(&framing).filter(|_| schema.planes.is_empty());
    let mut tabs = vec![layout.scene_view((&framing, WIDE), schema, scene_title(schema), settings)];
    if schema.bodies.len() > 1 {
        tabs.push(layout.surface_view((&close, WIDE), schema, settings));
    }
    if settings.detail != Detail::Surface {
        tabs.push(layout.forces_tab(&close, schema, settings));
        tabs.push(layout.displacement_tab(&close, schema, settings));
    }
    let root = layout.container(ContainerKind::Tabs, "meldscope", tabs, &[]);
    layout.log("time_panel", &TimePanelBlueprint::update_fields().with_play_state(PlayState::Paused));
    layout.finish(root)
}

/// The layout of a comparison of two runs: surfaces and error arrows, differences over time, events.
///
/// `second` are the surfaces of the second run, drawn as dots of the colour `rgb`; `has_pairs`: whether q is compared; the
/// viewer opens at `first` [s], if there is one.
pub fn of_comparison(
    spheres: &[(DVec3, f64)],
    (second, rgb): (&[String], palette::Rgb),
    has_pairs: bool,
    first: Option<f64>,
    recording: &StoreId,
) -> Vec<LogMsg> {
    /// What is repeated around that instant [s].
    const BEFORE: f64 = 0.2;
    const AFTER: f64 = 1.0;

    let mut layout = Layout::of(recording);
    layout.ground = Ground::under(spheres);
    let surfaces = layout.space((spheres, WIDE), "Both surfaces, and arrows between them", &[&family(&WORLD)]);
    let dots =
        Points3D::update_fields().with_radii([sdk::Radius::new_ui_points(2.0)]).with_colors([palette::color(rgb)]);
    for surface in second {
        layout.visualize(&surfaces.path, surface, &[("Points3D", &[VERTICES], &dots)]);
    }
    let about = layout.view("TextDocument", "What is what", ABOUT.path, &[&including(ABOUT.path)], &[]);
    let left = layout.container(ContainerKind::Vertical, "Surfaces", vec![surfaces, about], &[3.4, 1.0]);
    let title = "Largest difference [radii], as its decimal logarithm";
    let plot = layout.time_series(title, "/", &[&family(&LOG_DIFFERENCE)], Corner2D::RightBottom);
    let events = layout.lines("Events", EVENTS.path);
    let (mut parts, mut shares) = (vec![plot, events], vec![1.5, 1.0]);
    if has_pairs {
        let distances = "Pair distances q in both runs";
        let contents = [&COMPARED_DISTANCE, &COMPARED_EVENTS].map(family);
        let contents = contents.each_ref().map(String::as_str);
        parts.insert(1, layout.time_series(distances, "/", &contents, Corner2D::RightBottom));
        shares.insert(1, 1.0);
    }
    let right = layout.container(ContainerKind::Vertical, "Differences", parts, &shares);
    let root = layout.container(ContainerKind::Horizontal, "meldscope", vec![left, right], &[1.6, 1.0]);
    if let Some(first) = first {
        layout.open_at([(first - BEFORE).max(0.0), first + AFTER]);
    }
    layout.finish(root)
}

/// The layout of the map of a sweep: the map, its legend, and measures along a line, one at a time. What is selected is
/// shown beside it. `picture` is the size of the map and of the diagrams [px].
pub fn of_map(measures: &[&str], recording: &StoreId, picture: [f64; 2]) -> Vec<LogMsg> {
    let mut layout = Layout::of(recording);
    (layout.timeline, layout.selection) = (SLICE, PanelState::Expanded);
    let [x, y] = picture;
    let bounds = VisualBounds2D::new(datatypes::Range2D {
        x_range: [-0.11 * x, 1.05 * x].into(),
        y_range: [-0.14 * y, 1.12 * y].into(),
    });
    let bounds: [(&str, &dyn AsComponents); 1] = [("VisualBounds2D", &bounds)];
    let map = layout.view("2D", "Map", MAP.family(), &[&family(&MAP)], &bounds);
    let about = layout.view("TextDocument", "What is what", ABOUT.path, &[&including(ABOUT.path)], &[]);
    let plots = measures.iter().map(|measure| {
        let entity = format!("{}/{measure}", MEASURE.family());
        layout.view("2D", &capitalized(&measure.replace('_', " ")), &entity, &[&format!("+ {entity}/**")], &bounds)
    });
    let plots: Vec<Part> = plots.collect();
    let left = layout.container(ContainerKind::Vertical, "Map", vec![map, about], &[3.2, 1.0]);
    let mut parts = vec![left];
    if !plots.is_empty() {
        parts.push(layout.container(ContainerKind::Tabs, "Along the first axis", plots, &[]));
    }
    let root = layout.container(ContainerKind::Horizontal, "meldscope", parts, &[1.4, 1.0]);
    layout.finish(root)
}

/// How the names of plots of energies begin: they are shown large, beside the others.
const ENERGY: &str = "Energy";

/// Upper limit on the number of bodies that are drawn transparent in views of forces.
const MAX_SHEER: usize = 16;

/// A container or a view that has been logged.
struct Part {
    id: Uuid,
    path: String,
}

/// A tab of the layout.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tab {
    /// An overview of everything.
    Scene,
    /// One 3D view per force term.
    Forces,
    /// Surfaces coloured by displacement, with selectable vertices.
    Displacement,
    /// The surfaces of groups, and geometric measures of pairs beside their phases.
    Surface,
    /// Distances, phases and events of pairs.
    Pairs,
    /// Durations of stages.
    Timings,
    /// Energy and other scalars of the state.
    Energy,
    /// The stages inside steps.
    Stages,
}

impl Tab {
    /// All tabs, in the order of the viewer.
    pub const ALL: [Tab; 8] =
        [Tab::Scene, Tab::Surface, Tab::Forces, Tab::Displacement, Tab::Pairs, Tab::Timings, Tab::Energy, Tab::Stages];

    /// The name of the tab on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Tab::Scene => "scene",
            Tab::Forces => "forces",
            Tab::Displacement => "displacement",
            Tab::Surface => "surface",
            Tab::Pairs => "pairs",
            Tab::Timings => "timings",
            Tab::Energy => "energy",
            Tab::Stages => "stages",
        }
    }
}

/// Source of a component of a visualizer.
#[derive(Clone, Copy, Debug)]
pub struct Mapping {
    /// The component of the visualizer.
    pub target: &'static str,
    /// The component of the entity that supplies it.
    pub source: &'static str,
}

struct Layout {
    chunks: Chunks,
    next_id: u64,
    /// The plots of timings, with their stages.
    timings: Vec<(Part, Vec<&'static str>, String)>,
    /// The plot of speed.
    speeds: Option<String>,
    /// All plots over time.
    plots: Vec<Plot>,
    /// The plots of q.
    distances: Vec<String>,
    /// The plots of scalars, with their names.
    scalars: Vec<(String, &'static str)>,
    /// The lanes of phases.
    phases: Vec<String>,
    /// Views of whether surfaces touch.
    contacts: Vec<String>,
    /// The view of each force term, with its name; none for terms that cannot act.
    forces: Vec<Option<(String, String)>>,
    /// The views in 3D, with their aspect ratios.
    spaces: Vec<(String, f64)>,
    /// The grid below everything visible, if there is one.
    ground: Option<Ground>,
    /// The timeline that the viewer opens with.
    timeline: &'static str,
    /// The state of the panel that shows what is selected.
    selection: PanelState,
}

/// A horizontal grid below everything visible.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Ground {
    /// Height [scene unit].
    height: f64,
    /// Distance between its lines [scene unit].
    spacing: f64,
}

impl Ground {
    fn under(spheres: &[(DVec3, f64)]) -> Option<Ground> {
        let height = spheres.iter().map(|&(centre, radius)| centre.z - radius).fold(f64::INFINITY, f64::min);
        let largest = spheres.iter().map(|&(_, radius)| radius).fold(0.0, f64::max);
        let decade = 10f64.powf(largest.log10().floor());
        let steps = [1.0, 2.0, 5.0].map(|step| step * decade);
        let spacing = steps.into_iter().rfind(|&step| step <= largest).unwrap_or(decade);
        (height.is_finite() && spacing.is_finite() && spacing > 0.0).then_some(Ground { height, spacing })
    }
}

impl Layout {
    /// An empty layout for a recording.
    fn of(recording: &StoreId) -> Layout {
        let id = format!("blueprint-{}", recording.recording_id().as_str());
        let store = StoreId::new(StoreKind::Blueprint, recording.application_id().clone(), id);
        Layout {
            chunks: Chunks::new(store),
            next_id: 0,
            timings: Vec::new(),
            speeds: None,
            plots: Vec::new(),
            distances: Vec::new(),
            scalars: Vec::new(),
            phases: Vec::new(),
            contacts: Vec::new(),
            forces: Vec::new(),
            spaces: Vec::new(),
            ground: None,
            timeline: SIM_TIME,
            selection: PanelState::Collapsed,
        }
    }

    /// Opens the viewer in this interval of time [s], which it repeats: there is no other way to set its time cursor.
    fn open_at(&mut self, interval: [f64; 2]) {
        let [min, max] = interval.map(|time| ((1e9 * time) as i64).into());
        let time_panel = TimePanelBlueprint::update_fields()
            .with_time_selection(AbsoluteTimeRange::from(datatypes::AbsoluteTimeRange { min, max }))
            .with_loop_mode(LoopMode::Selection)
            .with_play_state(PlayState::Playing);
        self.log("time_panel", &time_panel);
    }

    /// Makes `root` the content of the whole window.
    fn finish(&mut self, root: Part) -> Vec<LogMsg> {
        self.log(
            "viewport",
            &ViewportBlueprint::new().with_root_container(root.id).with_auto_layout(false).with_auto_views(false),
        );
        for (panel, state) in [("blueprint_panel", PanelState::Collapsed), ("selection_panel", self.selection)] {
            self.log(panel, &PanelBlueprint::new().with_state(state));
        }
        self.log(
            "time_panel",
            &TimePanelBlueprint::new().with_state(PanelState::Collapsed).with_timeline(self.timeline),
        );

        let messages = self.chunks.take();
        self.activate(messages)
    }

    fn activate(&self, mut messages: Vec<LogMsg>) -> Vec<LogMsg> {
        let blueprint_id = self.chunks.store().clone();
        let activate = BlueprintActivationCommand { blueprint_id, make_active: true, make_default: true };
        messages.push(LogMsg::BlueprintActivationCommand(activate));
        messages
    }

    fn root(&mut self, subject: &Subject<'_>, front: Tab) -> Part {
        let Subject { simulation, schema, settings } = *subject;
        let framing = simulation.framing(false);
        let close = simulation.framing(true);
        // planes have their own grids
        self.ground = Ground::under(&framing).filter(|_| schema.planes.is_empty());
        if front == Tab::Stages {
            self.timeline = STAGE;
        }
        let mut tabs = vec![(Tab::Scene, self.scene_tab(&framing, schema, settings))];
        if schema.bodies.len() > 1 {
            tabs.push((Tab::Surface, self.surface_tab(&close, schema, settings)));
        }
        if settings.detail != Detail::Surface {
            tabs.push((Tab::Forces, self.forces_tab(&close, schema, settings)));
            tabs.push((Tab::Displacement, self.displacement_tab(&close, schema, settings)));
        }
        if schema.bodies.len() > 1 {
            let parts = self.pair_views(schema);
            tabs.push((Tab::Pairs, self.container(ContainerKind::Vertical, "Pairs", parts, &[2.0, 1.0, 0.8])));
        }
        tabs.push((Tab::Timings, self.timings_tab(schema)));
        tabs.push((Tab::Energy, self.energy_tab(schema)));
        if matches!(settings.detail, Detail::Stages { .. }) {
            tabs.push((Tab::Stages, self.stages_tab(&framing, schema, settings)));
        }
        let active = tabs.iter().find(|(tab, _)| *tab == front).map(|(_, part)| part.path.clone());
        let root =
            self.container(ContainerKind::Tabs, "meldscope", tabs.into_iter().map(|(_, part)| part).collect(), &[]);
        if let Some(active) = active {
            self.log(&root.path, &ContainerBlueprint::update_fields().with_active_tab(active.as_str()));
        }
        root
    }

    /// Energies, what changed them, and the events that made them jump; the other scalars one at a time.
    fn energy_tab(&mut self, schema: &Schema) -> Part {
        let (energies, others): (Vec<_>, Vec<_>) =
            self.diagnostics(schema, usize::MAX).into_iter().partition(|(name, _)| name.starts_with(ENERGY));
        // a model without energies shows its other scalars there
        let (large, small) = if energies.is_empty() { (others, energies) } else { (energies, others) };
        let [large, small]: [Vec<Part>; 2] =
            [large, small].map(|plots| plots.into_iter().map(|(_, plot)| plot).collect());
        let shares = vec![1.0; large.len()];
        let left = self.container(ContainerKind::Vertical, "Energies", large, &shares);
        let mut right = vec![self.lines("Events, and steps beyond the tolerance", EVENTS.path)];
        if !small.is_empty() {
            right.insert(0, self.container(ContainerKind::Tabs, "Others", small, &[]));
        }
        let shares = vec![1.0; right.len()];
        let right = self.container(ContainerKind::Vertical, "Beside them", right, &shares);
        self.container(ContainerKind::Horizontal, "Energy", vec![left, right], &[1.2, 1.0])
    }

    /// The stages inside steps, on the timeline `stage`.
    fn stages_tab(&mut self, framing: &[(DVec3, f64)], schema: &Schema, settings: &Settings) -> Part {
        let view = self.scene_view((framing, NARROW), schema, "Inside of a step (timeline: stage)", settings);
        let lines = self.lines("Stages", STAGES.path);
        self.container(ContainerKind::Horizontal, "Stages", vec![view, lines], &[1.3, 1.0])
    }

    /// The events of pairs and bodies. Steps beyond the tolerance, which may be all of them, are listed beside the error.
    fn events(&mut self) -> Part {
        let contents = [format!("+ {}/**", EVENTS.path), format!("- {}", ACCURACY.path)];
        self.listed("Events", EVENTS.path, &contents.each_ref().map(String::as_str))
    }

    fn lines(&mut self, name: &str, entity: &str) -> Part {
        self.listed(name, entity, &[&format!("+ {entity}/**")])
    }

    fn listed(&mut self, name: &str, entity: &str, contents: &[&str]) -> Part {
        let columns = TextLogColumns::new()
            .with_timeline_columns(Vec::<TimelineColumn>::new())
            .with_text_log_columns([TextLogColumn { kind: TextLogColumnKind::Body, visible: true.into() }]);
        self.view("TextLog", name, entity, contents, &[("TextLogColumns", &columns)])
    }

    /// An overview of everything.
    fn scene_tab(&mut self, framing: &[(DVec3, f64)], schema: &Schema, settings: &Settings) -> Part {
        let scene_view = self.scene_view((framing, WIDE), schema, scene_title(schema), settings);
        let about = self.view("TextDocument", "What is what", ABOUT.path, &[&including(ABOUT.path)], &[]);
        let left = self.container(ContainerKind::Vertical, "Space", vec![scene_view, about], &[2.6, 1.0]);
        let right = if schema.bodies.len() > 1 {
            // a lane for each pair, as far as there is room
            let mut parts = self.pair_views(schema);
            if recent::is_drawn_alone(schema) {
                // as many names would cover half of a small plot
                self.log(&format!("{}/PlotLegend", parts[0].path), &PlotLegend::new().with_visible(false));
            }
            let shares = match schema.bodies.len() {
                2 => [1.5, 0.5, 0.9, 1.0],
                _ if recent::is_drawn_alone(schema) => [1.2, 0.9, 0.8, 1.4],
                _ => [1.4, 1.1, 0.8, 0.9],
            };
            parts.push(match recent::is_drawn_alone(schema) {
                true => self.recent_pair(),
                false => self.small_timings(schema),
            });
            self.container(ContainerKind::Vertical, "Time", parts, &shares)
        } else {
            // a single body: show its motion and its timings
            let mut parts: Vec<Part> = self.diagnostics(schema, 2).into_iter().map(|(_, plot)| plot).collect();
            parts.push(self.small_timings(schema));
            let shares = vec![1.0; parts.len()];
            self.container(ContainerKind::Vertical, "Time", parts, &shares)
        };
        self.container(ContainerKind::Horizontal, "Scene", vec![left, right], &[1.6, 1.0])
    }

    /// The surfaces of groups, and the gap and overlap of pairs above their phases.
    fn surface_tab(&mut self, framing: &[(DVec3, f64)], schema: &Schema, settings: &Settings) -> Part {
        let view = self.surface_view((framing, NARROW), schema, settings);
        let mut parts = Vec::new();
        if pairs::has_named_pairs(schema) {
            let measures: [(&str, &[&Entity]); 2] = [
                ("Gap and neck (thin) [R of the smaller]", &[&PAIR_GAP, &PAIR_NECK]),
                ("Overlap [R³ of the smaller]", &[&PAIR_OVERLAP]),
            ];
            let plots = measures.map(|(title, measures)| {
                let lines = measures.iter().flat_map(|measure| pairs::named(schema, measure));
                let contents: Vec<String> = lines.map(|line| including(&line)).collect();
                let contents: Vec<&str> = contents.iter().map(String::as_str).collect();
                self.plot(title, "/", &contents, Corner2D::RightTop)
            });
            parts.push(self.container(ContainerKind::Tabs, "Pairs", plots.into(), &[]));
        }
        let title = "Do surfaces touch? (red: joined, not touching; yellow: touching, not joined)";
        let mut contents: Vec<String> = pairs::named(schema, &PAIR_PHASE).map(|lane| format!("- {lane}")).collect();
        contents.push(family(&PAIR_PHASE));
        let contents: Vec<&str> = contents.iter().map(String::as_str).collect();
        let contacts = self.view("StateTimeline", title, PAIR_PHASE.family(), &contents, &[]);
        self.contacts.push(contacts.path.clone());
        parts.push(contacts);
        if pairs::has_named_pairs(schema) {
            // no marks of events, which are at 0: a change of a hundredth is visible
            let title = "Volume [unit³]: what merging loses lies between the lines";
            parts.push(self.time_series(title, "/", &[&family(&VOLUME)], Corner2D::LeftBottom));
        } else {
            parts.push(self.plot("Groups: volume, bodies, genus", "/", &[&family(&GROUP_LINE)], Corner2D::RightTop));
        }
        parts.push(self.events());
        let shares = vec![1.0; parts.len()];
        let right = self.container(ContainerKind::Vertical, "Measures", parts, &shares);
        self.container(ContainerKind::Horizontal, "Surface", vec![view, right], &[1.6, 1.0])
    }

    /// One surface for each group of bodies.
    fn surface_view(&mut self, framing: Framing<'_>, schema: &Schema, settings: &Settings) -> Part {
        // a seam lies inside the smooth surface and would show through in places
        let merged = if schema.blend > 0.0 { including(MERGED_SURFACE.path) } else { family(&MERGED) };
        let contents = [&BODY, &DEFORMING, &RESTING, &PLANE, &NAMES].map(family);
        let contents: Vec<&str> = contents.iter().chain([&merged]).map(String::as_str).collect();
        let view = self.space(framing, "One surface per group", &contents);
        for (index, surface) in surfaces(schema, settings).into_iter().enumerate() {
            // a batch has a colour per vertex
            let rgb = if settings.entities == Entities::Batch { [0xFF; 3] } else { palette::of_body(schema, index) };
            self.draw_unmerged(&view, &surface, &Mesh3D::update_fields().with_albedo_factor(palette::opaque(rgb)));
        }
        let opaque = Mesh3D::update_fields().with_albedo_factor(sdk::Rgba32::WHITE);
        self.draw_lit(&view, MERGED_SURFACE.path, &opaque);
        self.draw_resting(&view, schema, settings);
        view
    }

    /// A view of all forces and one for each that can act in the scene, of which one is in front, and the net force on each
    /// body over time. All views have the same initial camera; Rerun 0.36 cannot link two of them.
    fn forces_tab(&mut self, framing: &[(DVec3, f64)], schema: &Schema, settings: &Settings) -> Part {
        /// Plots upon one another, of more bodies, would have no room for numbers: they are tabs.
        const MOST_STACKED: usize = 3;

        let sums = schema.terms.iter().filter(|term| term.is_sum).map(|sum| sum.name);
        let sums = sums.chain(net_forces::KINDS.map(|(name, ..)| name));
        let mut arrows: Vec<String> = sums.map(|name| format!("- {}", FORCE.of(&[name]))).collect();
        arrows.push(family(&FORCE));
        let mut views = vec![self.forces_view(framing, "All", &arrows, schema, settings)];
        for term in &schema.terms {
            if !term.can_act {
                self.forces.push(None);
                continue;
            }
            let name = capitalized(term.name);
            let view = self.forces_view(framing, &name, &[including(&FORCE.of(&[term.name]))], schema, settings);
            self.forces.push(Some((view.path.clone(), name)));
            views.push(view);
        }
        let causes = self.container(ContainerKind::Tabs, "Causes", views, &[]);
        let scale = including(ARROWS.path);
        let scale = self.view("TextDocument", "What arrows and lines mean", ARROWS.path, &[&scale], &[]);
        let causes = self.container(ContainerKind::Vertical, "Forces", vec![causes, scale], &[4.2, 1.0]);
        if schema.bodies.len() > body_forces::MOST_BODIES {
            return causes;
        }
        let is_stacked = schema.bodies.len() <= MOST_STACKED;
        let plots = schema.bodies.iter().map(|body| {
            let title = match is_stacked {
                true => format!("Net force on {} by cause, over its mass [unit/s²]", body.name),
                false => format!("On {} [unit/s²]", body.name),
            };
            let contents = format!("+ {}/{}/**", BODY_FORCE.family(), body.name);
            let plot = self.plot(&title, "/", &[&contents], Corner2D::RightTop);
            if is_stacked {
                // the lines have the colours of the arrows; a legend would cover half of a small plot
                self.log(&format!("{}/PlotLegend", plot.path), &PlotLegend::new().with_visible(false));
            }
            plot
        });
        let plots: Vec<Part> = plots.collect();
        let shares = vec![1.0; plots.len()];
        let kind = if is_stacked { ContainerKind::Vertical } else { ContainerKind::Tabs };
        let plots = self.container(kind, "Net forces", plots, &shares);
        self.container(ContainerKind::Horizontal, "Forces", vec![causes, plots], &[1.6, 1.0])
    }

    /// Arrows on translucent bodies.
    fn forces_view(
        &mut self,
        framing: &[(DVec3, f64)],
        name: &str,
        arrows: &[String],
        schema: &Schema,
        settings: &Settings,
    ) -> Part {
        const WHITE: palette::Rgb = [0xFF; 3];
        let bodies = [&BODY, &DEFORMING, &PLANE, &NAMES].map(family);
        let contents: Vec<&str> = bodies.iter().chain(arrows).map(String::as_str).collect();
        let view = self.space((framing, WIDE), name, &contents);
        if schema.bodies.len() <= MAX_SHEER || settings.entities == Entities::Batch {
            for (index, surface) in surfaces(schema, settings).into_iter().enumerate() {
                // a batch has a colour per vertex
                let rgb = if settings.entities == Entities::Batch { WHITE } else { palette::of_body(schema, index) };
                let sheer = Mesh3D::update_fields().with_albedo_factor(palette::sheer(rgb));
                self.draw_lit(&view, &surface, &sheer);
            }
        }
        view
    }

    /// Surfaces coloured by displacement, with selectable vertices, above the colour scale.
    fn displacement_tab(&mut self, framing: &[(DVec3, f64)], schema: &Schema, settings: &Settings) -> Part {
        let contents = [&BODY, &DEFORMING, &PLANE, &LARGEST, &NAMES].map(family);
        let contents = contents.each_ref().map(String::as_str);
        let title = "Displacement from rest; select a vertex to see its numbers";
        let view = self.space((framing, WIDE), title, &contents);
        let white = sdk::Rgba32::WHITE;
        let opaque = Mesh3D::update_fields().with_albedo_factor(white).with_vertex_colors([white]);
        let dots = Points3D::update_fields()
            .with_radii([sdk::Radius::new_ui_points(2.5)])
            .with_colors([palette::color(palette::DOT)]);
        for surface in surfaces(schema, settings) {
            self.visualize(
                &view.path,
                &surface,
                &[("Mesh3D", &heat::MAPPINGS, &opaque), ("Points3D", &[VERTICES], &dots)],
            );
        }
        let scale = self.view(
            "2D",
            "Displacement [radii]: at this instant, at most a tenth of the surface has more than the colours show",
            LEGEND.family(),
            &[&family(&LEGEND)],
            &[],
        );
        self.container(ContainerKind::Vertical, "Displacement", vec![view, scale], &[6.0, 1.0])
    }

    /// Views of pair distances, phases and events.
    fn pair_views(&mut self, schema: &Schema) -> Vec<Part> {
        // a pattern cannot have its wildcard in the middle
        let without = |parts: &[&Entity]| -> Vec<String> {
            let left_out = parts.iter().flat_map(|part| pairs::named(schema, part)).map(|line| format!("- {line}"));
            std::iter::once(family(&PAIR_DISTANCE)).chain(left_out).collect()
        };
        let mut contents = without(&MEASURES.map(|(measure, ..)| measure));
        contents.push(family(&MARKS_AT_Q));
        let contents: Vec<&str> = contents.iter().map(String::as_str).collect();
        let title = "Pair distances q and their thresholds";
        let distances = self.time_series(title, "/", &contents, Corner2D::RightBottom);
        self.distances.push(distances.path.clone());
        let contents = without(&[&PAIR_CONTACT]);
        let contents: Vec<&str> = contents.iter().map(String::as_str).collect();
        let phases = self.view("StateTimeline", "Pair phases", PAIR_PHASE.family(), &contents, &[]);
        self.phases.push(phases.path.clone());
        let events = self.events();
        vec![distances, phases, events]
    }

    /// The cost of a step and of its recording, each as stacked stages, and the resulting speed.
    fn timings_tab(&mut self, schema: &Schema) -> Part {
        let recording = self.stacked("Recording on its own thread, ms per step", schema, true);
        let parts = vec![self.timings(schema), recording, self.speed()];
        self.container(ContainerKind::Vertical, "Timings", parts, &[1.6, 1.0, 1.0])
    }

    fn timings(&mut self, schema: &Schema) -> Part {
        self.stacked("Timings, ms per step: each stage upon those below it", schema, false)
    }

    /// Without a legend, which would hide the lines of a small plot.
    fn small_timings(&mut self, schema: &Schema) -> Part {
        let plot = self.timings(schema);
        self.log(&format!("{}/PlotLegend", plot.path), &PlotLegend::new().with_visible(false));
        plot
    }

    /// The stages of a step, or of its recording.
    fn stacked(&mut self, title: &str, schema: &Schema, is_recording: bool) -> Part {
        let stages = numbers::timings(schema).filter(|stage| numbers::is_work(stage));
        let stages: Vec<_> = stages.filter(|stage| numbers::RECORDING.contains(stage) == is_recording).collect();
        let contents: Vec<String> = stages.iter().map(|stage| including(&numbers::stacked(schema, stage))).collect();
        let contents: Vec<&str> = contents.iter().map(String::as_str).collect();
        let plot = self.plot(title, "/", &contents, Corner2D::LeftTop);
        self.timings.push((Part { id: plot.id, path: plot.path.clone() }, stages, title.to_owned()));
        plot
    }

    fn speed(&mut self) -> Part {
        let contents = [&SPEED, &LAG].map(|line| including(line.path));
        let contents = [contents[0].as_str(), contents[1].as_str()];
        let plot = self.plot("Steps per second, and milliseconds behind real time", "/", &contents, Corner2D::LeftTop);
        self.speeds = Some(plot.path.clone());
        plot
    }

    /// Plots of the schema's scalars, with their names.
    fn diagnostics(&mut self, schema: &Schema, most: usize) -> Vec<(&'static str, Part)> {
        let mut plots: Vec<(&'static str, Vec<String>)> = Vec::new();
        let lines = schema.scalars.iter().map(|scalar| (scalar.plot, including(&DIAGNOSTIC.of(&[scalar.name]))));
        let owned = [(&BODY_SCALAR, &schema.body_scalars), (&PAIR_SCALAR, &schema.pair_scalars)];
        let owned = owned.into_iter().flat_map(|(of, scalars)| {
            scalars.iter().map(|scalar| (scalar.plot, format!("+ {}/{}/**", of.family(), scalar.name)))
        });
        for (name, line) in lines.chain(owned) {
            match plots.iter_mut().find(|(plot, _)| *plot == name) {
                Some((_, lines)) => lines.push(line),
                None => plots.push((name, vec![line])),
            }
        }
        let mut plot = |(name, lines): (&'static str, Vec<String>)| {
            let contents: Vec<&str> = lines.iter().map(String::as_str).collect();
            let plot = self.plot(name, "/", &contents, Corner2D::RightTop);
            self.scalars.push((plot.path.clone(), name));
            (name, plot)
        };
        plots.into_iter().take(most).map(&mut plot).collect()
    }

    /// A plot over time, with the events as markers on its axis.
    fn plot(&mut self, name: &str, origin: &str, contents: &[&str], corner: Corner2D) -> Part {
        let marks = family(&MARKS_ON_AXIS);
        let contents: Vec<&str> = contents.iter().copied().chain([marks.as_str()]).collect();
        self.time_series(name, origin, &contents, corner)
    }

    /// A plot over time. All plots share one time range.
    fn time_series(&mut self, name: &str, origin: &str, contents: &[&str], corner: Corner2D) -> Part {
        let legend = PlotLegend::new().with_corner(corner);
        let axis = TimeAxis::new().with_link(LinkAxis::LinkToGlobal);
        let view = self.view("TimeSeries", name, origin, contents, &[("PlotLegend", &legend), ("TimeAxis", &axis)]);
        let contents = contents.iter().map(|rule| (*rule).to_owned()).collect();
        self.plots.push(Plot { path: view.path.clone(), contents, corner, range: None });
        view
    }

    /// Sets the ends of the axis of values of a plot.
    fn set_range(&mut self, plot: &str, [low, high]: [f64; 2]) {
        self.log(&format!("{plot}/ScalarAxis"), &ScalarAxis::new().with_range(Range1D::new(low, high)));
        if let Some(plot) = self.plots.iter_mut().find(|known| known.path == plot) {
            plot.range = Some([low, high]);
        }
    }

    /// A 3D view of everything, with the forces that make bodies merge and split.
    fn scene_view(&mut self, framing: Framing<'_>, schema: &Schema, name: &str, settings: &Settings) -> Part {
        let view = self.space(framing, name, &[&family(&WORLD)]);
        for (index, surface) in surfaces(schema, settings).into_iter().enumerate() {
            let mut of = Mesh3D::update_fields();
            if draws_springs(schema, settings) && settings.entities == Entities::Body {
                of = of.with_albedo_factor(palette::sheer(palette::of_body(schema, index)));
            }
            self.draw_unmerged(&view, &surface, &of);
        }
        if schema.bodies.len() > 1 {
            self.draw_lit(&view, MERGED_SURFACE.path, &Mesh3D::update_fields());
        }
        self.draw_resting(&view, schema, settings);
        let mut hide = |entity: &str| {
            let path = format!("{}/ViewContents/overrides{entity}/visualizers", view.path);
            self.log(&path, &EntityBehavior::new().with_visible(false));
        };
        // what is hidden can be enabled in the view's entity list: among many bodies, one would see nothing else
        let is_crowd = recent::is_drawn_alone(schema);
        if is_crowd {
            hide(INFLUENCE.path);
            hide(TRAILS.path);
            net_forces::KINDS.iter().for_each(|(name, ..)| hide(&FORCE.of(&[name])));
        }
        if settings.detail != Detail::Surface {
            for term in schema.terms.iter().filter(|term| is_crowd || !term.is_shown) {
                hide(&FORCE.of(&[term.name]));
            }
        }
        if settings.entities == Entities::Body && schema.bodies.iter().any(|body| body.is_free) {
            let seconds = (-trails::SECONDS * 1e9) as i64;
            let ranges = [(SIM_TIME, seconds), (STEP, (-trails::SECONDS / schema.dt) as i64)].map(|(line, start)| {
                VisibleTimeRange(datatypes::VisibleTimeRange {
                    timeline: line.into(),
                    range: TimeRange {
                        start: TimeRangeBoundary::CursorRelative(start.into()),
                        end: TimeRangeBoundary::CursorRelative(0.into()),
                    },
                })
            });
            let path = format!("{}/ViewContents/overrides{}", view.path, TRAILS.path);
            self.log(&path, &VisibleTimeRanges::new(ranges.clone()));
            self.log(&format!("{path}/visualizers"), &VisibleTimeRanges::new(ranges));
        }
        view
    }

    /// A 3D view.
    fn space(&mut self, (spheres, aspect): Framing<'_>, name: &str, contents: &[&str]) -> Part {
        let grid = match self.ground {
            None => LineGrid3D::new().with_visible(false),
            Some(Ground { height, spacing }) => LineGrid3D::new()
                .with_visible(true)
                .with_plane(Plane3D::new(glam::Vec3::Z, height as f32))
                .with_spacing(spacing as f32)
                .with_stroke_width(1.0)
                .with_color(palette::color(palette::GROUND)),
        };
        let background = Background::new(BackgroundKind::SolidColor).with_color(palette::color(palette::BACKGROUND));
        let camera = camera_past(spheres, &[], &[], aspect);
        let properties: [(&str, &dyn AsComponents); 3] =
            [("EyeControls3D", &camera), ("LineGrid3D", &grid), ("Background", &background)];
        let view = self.view("3D", name, WORLD.path, contents, &properties);
        self.spaces.push((view.path.clone(), aspect));
        view
    }

    /// The pair of the last event, cut out of everything that may hide it.
    fn recent_pair(&mut self) -> Part {
        let contents = [&RECENT_PAIR, &RECENT_SPHERES, &RECENT_NAMES].map(|of| including(of.path));
        let contents = contents.each_ref().map(String::as_str);
        let ground = self.ground.take();
        let framing: Framing<'_> = (&[(DVec3::ZERO, 2.6)], WIDE);
        let view = self.space(framing, "The pair of the last event, alone", &contents);
        self.ground = ground;
        self.spaces.pop(); // its camera stays
        self.draw_lit(&view, RECENT_PAIR.path, &Mesh3D::update_fields());
        view
    }

    /// Draws the own surface of a body only while it is not part of a merged one.
    fn draw_unmerged(&mut self, view: &Part, surface: &str, overrides: &dyn AsComponents) {
        let drawn = Mapping { target: "Mesh3D:triangle_indices", source: DRAWN.0 };
        self.visualize(&view.path, surface, &[("Mesh3D", &[drawn, light::COLORS, light::NO_LIGHT], overrides)]);
    }

    /// Draws a surface with its baked lighting.
    fn draw_lit(&mut self, view: &Part, surface: &str, overrides: &dyn AsComponents) {
        let mappings = [light::COLORS, light::NO_LIGHT];
        self.visualize(&view.path, surface, &[("Mesh3D", &mappings, overrides)]);
    }

    /// Draws the undeformed bodies of a batched scene with baked lighting.
    fn draw_resting(&mut self, view: &Part, schema: &Schema, settings: &Settings) {
        if settings.entities == Entities::Batch {
            for shape in schema.shapes().keys() {
                self.draw_lit(view, &RESTING.of(&[shape]), &Mesh3D::update_fields());
            }
        }
    }

    /// Replaces the default visualizers of an entity in a view.
    fn visualize(&mut self, view: &str, entity: &str, visualizers: &[(&str, &[Mapping], &dyn AsComponents)]) {
        let base = format!("{view}/ViewContents/overrides{entity}/visualizers");
        let mut ids = Vec::new();
        for (class, mapping, overrides) in visualizers {
            let (id, text) = self.id();
            let path = format!("{base}/{text}");
            let mapping = mapping.iter().map(|mapping| VisualizerComponentMapping {
                target: mapping.target.into(),
                source_kind: ComponentSourceKind::SourceComponent,
                source_component: Some(mapping.source.into()),
                selector: None,
            });
            self.log(&path, &VisualizerInstruction::new(*class).with_component_map(mapping));
            self.log(&path, *overrides);
            ids.push(VisualizerInstructionId(id));
        }
        self.log(&base, &ActiveVisualizers::new(ids));
    }

    fn id(&mut self) -> (Uuid, String) {
        self.next_id += 1;
        // A version 8 UUID of RFC 9562, whose bits are free to choose: here a counter.
        let value = 0x6d65_6c64_0000_8000_8000_0000_0000_0000_u128 | u128::from(self.next_id);
        let digits = format!("{value:032x}");
        let text =
            format!("{}-{}-{}-{}-{}", &digits[..8], &digits[8..12], &digits[12..16], &digits[16..20], &digits[20..]);
        (Uuid { bytes: value.to_be_bytes() }, text)
    }

    fn log(&mut self, entity: &str, components: &dyn AsComponents) {
        let time: TimePoint = blueprint_time();
        self.chunks.row(entity, time, components);
    }

    fn view(
        &mut self,
        class: &str,
        name: &str,
        origin: &str,
        contents: &[&str],
        properties: &[(&str, &dyn AsComponents)],
    ) -> Part {
        let (id, text) = self.id();
        let path = format!("view/{text}");
        let contents = ViewContents::new(contents.iter().copied());
        self.log(&format!("{path}/ViewContents"), &contents);
        self.log(&path, &ViewBlueprint::new(class).with_display_name(name).with_space_origin(origin));
        for (property, components) in properties {
            self.log(&format!("{path}/{property}"), *components);
        }
        Part { id, path }
    }

    fn container(&mut self, kind: ContainerKind, name: &str, parts: Vec<Part>, shares: &[f32]) -> Part {
        let (id, text) = self.id();
        let path = format!("container/{text}");
        let mut container = ContainerBlueprint::new(kind)
            .with_display_name(name)
            .with_contents(parts.iter().map(|part| part.path.as_str()));
        container = match kind {
            ContainerKind::Horizontal => container.with_col_shares(shares.iter().copied()),
            ContainerKind::Vertical => container.with_row_shares(shares.iter().copied()),
            _ => container,
        };
        self.log(&path, &container);
        Part { id, path }
    }
}

/// A name as a title.
fn capitalized(name: &str) -> String {
    let mut letters = name.chars();
    letters.next().into_iter().flat_map(char::to_uppercase).chain(letters).collect()
}

/// Whether springs are recorded.
fn draws_springs(schema: &Schema, settings: &Settings) -> bool {
    settings.detail != Detail::Surface && schema.bodies.iter().any(|body| body.has_springs)
}

/// The entities of deformable surfaces.
pub(super) fn surfaces(schema: &Schema, settings: &Settings) -> Vec<String> {
    match settings.entities {
        Entities::Body => schema.bodies.iter().map(|body| BODY_SURFACE.of(&[&body.name])).collect(),
        Entities::Batch => vec![DEFORMING.path.to_owned()],
    }
}

/// Spheres (centre and radius) to keep in view, and the aspect ratio of the view.
type Framing<'a> = (&'a [(DVec3, f64)], f64);

/// Minimum aspect ratios of views in a 16:9 window.
const WIDE: f64 = 1.45;
const NARROW: f64 = 1.2;

/// A camera in front of the spheres (centre and radius), slightly to one side and above, with all of them in view.
/// Flat arrangements are viewed from higher up. Where possible, no sphere of `others` hides one of `wanted`.
fn camera_past(
    spheres: &[(DVec3, f64)],
    wanted: &[(DVec3, f64)],
    others: &[(DVec3, f64)],
    aspect: f64,
) -> EyeControls3D {
    let low = spheres.iter().fold(DVec3::INFINITY, |low, &(centre, radius)| low.min(centre - radius));
    let high = spheres.iter().fold(DVec3::NEG_INFINITY, |high, &(centre, radius)| high.max(centre + radius));
    let (middle, extent) = (0.5 * (low + high), high - low);
    let is_flat = extent.z < 0.2 * f64::min(extent.x, extent.y);
    let first = DVec3::new(-0.2, -1.0, if is_flat { 1.0 } else { 0.4 }).normalize(); // towards the eye
    let mut best = (eye(spheres, middle, first, aspect), hidden(eye(spheres, middle, first, aspect), wanted, others));
    // a smaller gain does not justify turning away from the default direction
    const WORTH: f64 = 0.02;
    for height in [0.4, 0.9, 1.6, -0.3] {
        for twelfth in [0, 1, 11, 2, 10, 3, 9, 4, 8, 5, 7, 6] {
            if best.1 <= WORTH {
                break;
            }
            let angle = std::f64::consts::TAU * f64::from(twelfth) / 12.0 - 0.2;
            let back = DVec3::new(angle.sin(), -angle.cos(), height).normalize();
            let from = eye(spheres, middle, back, aspect);
            let hidden = hidden(from, wanted, others);
            if hidden + WORTH < best.1 {
                best = (from, hidden);
            }
        }
    }
    EyeControls3D::new()
        .with_kind(Eye3DKind::Orbital)
        .with_position(Position3D::from(best.0.as_vec3()))
        .with_look_target(Position3D::from(middle.as_vec3()))
        .with_eye_up(Vector3D::from(glam::Vec3::Z))
}

/// The nearest eye position in direction `back` from the middle that has all spheres in view.
fn eye(spheres: &[(DVec3, f64)], middle: DVec3, back: DVec3, aspect: f64) -> DVec3 {
    /// Half the viewer's vertical field of view, 55°.
    const HALF_HEIGHT: f64 = 0.5205;
    /// Free margin on either side [half heights of the view].
    const MARGIN: f64 = 0.02;

    let half_width = (aspect - MARGIN) * HALF_HEIGHT;
    let right = DVec3::Z.cross(back).normalize();
    let up = back.cross(right);
    // The distance at which a sphere at `centre` just fits between the planes of the view frustum.
    let distance = |centre: DVec3, radius: f64| {
        let offset = centre - middle;
        let fits = |sideways: f64, half: f64| (sideways.abs() + radius * half.hypot(1.0)) / half;
        offset.dot(back) + f64::max(fits(offset.dot(right), half_width), fits(offset.dot(up), HALF_HEIGHT))
    };
    middle + back * spheres.iter().map(|&(centre, radius)| distance(centre, radius)).fold(0.0, f64::max)
}

/// How much `others` hide the spheres `wanted` from an eye; 0 if not at all. Each other sphere counts by its overlap as
/// a fraction of the smaller one's width.
fn hidden(eye: DVec3, wanted: &[(DVec3, f64)], others: &[(DVec3, f64)]) -> f64 {
    let mut sum = 0.0;
    for &(centre, radius) in wanted {
        let distance = eye.distance(centre);
        let towards = (centre - eye) / distance;
        for &(other, other_radius) in others {
            let depth = (other - eye).dot(towards);
            if depth <= -other_radius || depth >= distance {
                continue;
            }
            // apparent half width of the wanted sphere at the depth of the other
            let width = radius * (depth / distance).max(0.0);
            let apart = (other - eye - depth * towards).length();
            sum += ((other_radius + width - apart) / (2.0 * f64::min(other_radius, width))).clamp(0.0, 1.0);
        }
    }
    sum
}

/// A force term with its colour.
fn called(term: &TermSchema) -> String {
    format!("{} {}", colors::name(term.color), term.name)
}

/// The accelerations at which arrows are as long as the largest radius, with the terms of which this is true.
fn lengths(schema: &Schema, is_listed: impl Fn(&TermSchema) -> bool) -> String {
    let radius = schema.largest_radius();
    let mut lengths: Vec<(f64, Vec<String>)> = Vec::new();
    for term in schema.terms.iter().filter(|term| term.can_act && is_listed(term)) {
        let scale = schema.arrow_scale_of(term);
        match lengths.iter_mut().find(|(of, _)| *of == scale) {
            Some((_, terms)) => terms.push(called(term)),
            None => lengths.push((scale, vec![called(term)])),
        }
    }
    let lengths =
        lengths.iter().map(|(scale, terms)| format!("{} = {} unit/s²", terms.join(", "), short(radius / scale)));
    lengths.collect::<Vec<_>>().join("; ")
}

/// A number with three digits at most.
fn short(x: f64) -> String {
    let text = significant(x);
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

/// The text about the arrows at the centres of free bodies.
fn at_centres(schema: &Schema) -> String {
    let radius = schema.largest_radius();
    let of = net_forces::KINDS.map(|(name, rgb, _)| format!("{} {}", colors::name(rgb), name.replace('_', " ")));
    format!(
        "- **At the centres** of free bodies: {} (over M, and over M R), 1 R long if {} unit/s², at most {} R\n",
        of.join(", "),
        short(radius / schema.net_force_scale),
        net_forces::LONGEST,
    )
}

/// The text of the panel beside arrows and plots of forces: their colours, and what their lengths mean.
pub fn arrows(schema: &Schema) -> String {
    let radius = schema.largest_radius();
    let is_uniform = schema.terms.iter().any(|term| term.can_act && term.is_uniform);
    if !schema.terms.iter().any(|term| term.can_act) {
        return "No force can act in this scene.\n".to_owned();
    }
    format!(
        "An arrow is **1 R = {} unit long** if: {}.\n\nArrows begin at vertices{}.{}\n",
        short(radius),
        lengths(schema, |_| true),
        if is_uniform { "; those that act on all alike, at the centre" } else { "" },
        match schema.bodies.len() > body_forces::MOST_BODIES {
            true => format!(" The net forces of up to {} bodies are plotted.", body_forces::MOST_BODIES),
            false => " Lines beside them: the same colours, means over a body.".to_owned(),
        },
    )
}

/// The text of the panel: what the colours mean, the scene, integrator, step and settings. The recording begins with
/// step `first`; `frame` is one of its states.
pub fn about(schema: &Schema, settings: &Settings, first: u64, frame: &Frame) -> String {
    let program = text::program();
    let frames = match (&settings.frames, settings.every) {
        (Frames::Thin, _) => "no frames".to_owned(),
        (Frames::All, 1) => "a frame every step".to_owned(),
        (Frames::All, every) => format!("a frame every {every} steps"),
        (Frames::Last { most: 1, on, .. }, _) if on.is_empty() => "the last frame".to_owned(),
        (Frames::Last { most, on, .. }, _) if on.is_empty() => format!("the last {most} frames"),
        (Frames::Last { most, on, after }, _) => {
            let on: Vec<&str> = on.iter().map(|trigger| trigger.name()).collect();
            let frames = if *most == 1 { "frame".to_owned() } else { format!("{most} frames") };
            let after = if *after > 0 { format!(" and {} after it", counted(*after, "frame")) } else { String::new() };
            format!("the last {frames} before each {}{after}", on.join(", "))
        }
    };
    let steps = match settings.steps {
        None => "until stopped".to_owned(),
        Some(last) if first > 0 => format!("steps {first} to {last}"),
        Some(1) => "1 step".to_owned(),
        Some(steps) => format!("{steps} steps"),
    };
    let integrator = if schema.integrator.is_empty() { String::new() } else { format!("`{}`, ", schema.integrator) };
    let head = format!(
        "**{}**: {} {}, {} vertices{}. {integrator}Δt = {:.6} s, {steps}, {frames}.\n\n{}\n\n",
        schema.name,
        schema.bodies.len(),
        if schema.bodies.len() == 1 { "body" } else { "bodies" },
        schema.vertex_count(),
        schema.non_default_model().map(|model| format!(", model **{model}**")).unwrap_or_default(),
        schema.dt,
        schema.law,
    );
    let warnings = schema.warnings.iter().map(|warning| format!("\n**Warning**: {warning}.\n"));
    let warnings = warnings.collect::<String>();
    if settings.frames == Frames::Thin {
        return format!(
            "**This recording is thin**: what was simulated, its events, and a checksum of every step. It has no frames; make \
             them:\n\n\
             - `{program} replay F.rrd --save full.rrd`: all frames, to be opened here\n\
             - `… --from STEP --to STEP`: those of some steps\n\
             - `{program} replay F.rrd`: verifies every step\n\
             - `{program} explain F.rrd --step N`: forces and phases in numbers\n\n{head}{warnings}"
        );
    }
    let phases = schema.phases.iter().map(|phase| format!("{} {}", colors::name(phase.color), phase.name));
    let phases = phases.collect::<Vec<_>>().join(", ");
    let is_crowd = recent::is_drawn_alone(schema);
    let spheres = match settings.entities {
        _ if schema.bodies.iter().all(|body| body.reach == 0.0) => format!("- **Lines, lanes**: {phases}\n"),
        Entities::Body if is_crowd => {
            format!("- **Lines, lanes**, and the spheres of the last event's pair: {phases}\n")
        }
        Entities::Body => format!("- **Spheres, lines, lanes**: {phases}; grey reaches no body\n"),
        Entities::Batch => {
            format!("- **Spheres** (only of bodies that reach another), **lines, lanes**: {phases}\n")
        }
    };
    let arrows = match settings.detail {
        Detail::Surface => "- Force arrows were not recorded (`--detail forces`)\n".to_owned(),
        Detail::Forces | Detail::Stages { .. } => {
            let shown = lengths(schema, |term| term.is_shown || is_crowd);
            let hidden = |term: &&TermSchema| term.can_act && !term.is_shown && !is_crowd;
            let hidden: Vec<String> = schema.terms.iter().filter(hidden).map(called).collect();
            let hidden = (!hidden.is_empty()).then(|| format!("hidden at first: {}", hidden.join(", ")));
            let shown = (!shown.is_empty()).then(|| format!("1 R long if: {shown}"));
            let parts: Vec<String> = shown.into_iter().chain(hidden).collect();
            let place = if is_crowd { " (in Forces; here hidden at first)" } else { "" };
            if parts.is_empty() { String::new() } else { format!("- **Arrows**{place}, {}\n", parts.join("; ")) }
        }
    };
    let bound = if !settings.only.is_empty() {
        format!("- Only {} has plots, lanes and lines (`--pair`); events list all pairs\n", settings.only.join(", "))
    } else if schema.bodies.len() * schema.bodies.len().saturating_sub(1) / 2 > settings.pairs {
        let max = settings.pairs;
        format!(
            "- The first {max} pairs within reach, and the first with events, have plots and lanes, the closest {max} lines \
             (`--plots`, `--pair a~b`); events list them all\n"
        )
    } else {
        String::new()
    };
    let joined: Vec<String> =
        schema.phases.iter().filter(|phase| phase.is_joined).map(|phase| phase.name.to_owned()).collect();
    // a surface of its own is part of the law
    let merged = if schema.surfaces.get().is_none() && schema.bodies.len() > 1 && !joined.is_empty() {
        let smooth = match schema.blend {
            0.0 => "sharp where they meet".to_owned(),
            blend => format!("smooth within {blend} R of where they meet"),
        };
        format!("- **Surface**: bodies that are {} share one, {smooth}; white lines show where\n", joined.join(" or "))
    } else {
        String::new()
    };
    let has_net = frame.bodies.iter().any(|now| now.net_force.is_some());
    let net_forces =
        if settings.detail != Detail::Surface && has_net && !is_crowd { at_centres(schema) } else { String::new() };
    let is_free = schema.bodies.iter().any(|body| body.is_free);
    let trails = if is_free && !is_crowd && settings.entities == Entities::Body {
        format!("- **Trails**: the centres of free bodies in the last {} s\n", trails::SECONDS)
    } else {
        String::new()
    };
    let springs = match draws_springs(schema, settings) {
        true => format!(
            "- **Springs**: blue shorter, white as long, orange longer than at rest (full colour: {} %)\n",
            100.0 * palette::MAX_STRAIN
        ),
        false => String::new(),
    };
    let credit = if schema.credit.is_empty() { String::new() } else { format!("\nAfter {}.\n", schema.credit) };
    head + &spheres + &springs + &merged + &arrows + &net_forces + &trails + &bound + &warnings + &credit
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_have_a_labelled_number_beside_zero() {
        for (range, expected) in [
            ([0.0, 3.0], [0.0, 3.0]),
            ([0.0, 0.819], [0.0, 1.0]),
            ([-4.4e4, 8.6e4], [-4.4e4, 1e5]),
            ([-7.0, 1.0], [-10.0, 1.0]),
            ([0.0, 4.8e-7], [0.0, 4.8e-7]),
        ] {
            let [low, high] = readable(range);
            let margin = 0.04 * (expected[1] - expected[0]);
            let error = f64::max((low + margin - expected[0]).abs(), (high - margin - expected[1]).abs());
            assert!(error <= 1e-12 * margin.max(1e-3), "{range:?}: {low} {high}");
        }
        let empty = readable([0.0, 0.0]);
        assert!(empty[0].partial_cmp(&empty[1]) != Some(std::cmp::Ordering::Less), "no range: {empty:?}");
    }
}
