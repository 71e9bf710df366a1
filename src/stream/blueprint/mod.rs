//! The layout (blueprint) that the viewer opens with, sent along with every recording.
//!
//! The SDK's own builder supports neither cameras nor axes, so this module logs the blueprint's archetypes itself.
//!
//! | contents | module |
//! | --- | --- |
//! | containers, views and what is overridden in them | `layout` |
//! | the tabs of a run, one function each | `tabs` |
//! | what is known only at the end of a run | `measured` |
//! | texts of panels | `panels` |
//! | cameras | `camera` |
//! | ranges and legends of plots | `plots` |

pub(super) mod camera;
mod layout;
mod measured;
mod panels;
mod plots;
mod tabs;

use glam::DVec3;

use self::{
    camera::WIDE,
    layout::{Layout, Part, family, including},
    tabs::{capitalized, scene_title},
};
pub use self::{
    layout::Mapping,
    measured::{Measured, measured},
    panels::{about, arrows, stages},
    tabs::surfaces,
};
use crate::{
    observe::{Schema, Simulation},
    sdk::{
        AsComponents, LogMsg, StoreId,
        blueprint::{
            archetypes::{TimePanelBlueprint, VisualBounds2D},
            components::{ContainerKind, Corner2D, PlayState},
        },
        datatypes,
    },
    stream::{
        contract::{
            ABOUT, COMPARED_DISTANCE, COMPARED_EVENTS, COMPARED_LEVEL, EVENTS, LOG_DIFFERENCE, MAP, MEASURE, SLICE,
            STEP, WORLD,
        },
        settings::{Detail, Settings},
    },
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

/// The messages that create the layout for `recording` and activate it.
pub fn messages(subject: &Subject<'_>, tab: Tab, recording: &StoreId) -> Vec<LogMsg> {
    let mut layout = Layout::of(recording);
    let root = layout.root(subject, tab);
    layout.finish(root)
}

/// The layout for a page that has its own controls of time, curves and list of events: what is in space alone, paused.
pub fn beside_controls(subject: &Subject<'_>, recording: &StoreId) -> Vec<LogMsg> {
    let Subject { simulation, schema, settings } = *subject;
    let (framing, close) = (simulation.framing(false), simulation.framing(true));
    let mut layout = Layout::of(recording);
    layout.timeline = STEP;
    layout.set_arrangement(schema, &framing);
    let mut tabs = vec![layout.scene_view((&framing, WIDE), schema, scene_title(schema), settings)];
    if schema.bodies.len() > 1 {
        tabs.push(layout.surface_view((&close, WIDE), "One surface per group", schema, settings));
    }
    if settings.detail != Detail::Surface {
        tabs.push(layout.forces_tab(&close, schema, settings));
        tabs.push(layout.displacement_view(&close, schema, settings));
    }
    let root = layout.container(ContainerKind::Tabs, "meldscope", tabs, &[]);
    layout.log("time_panel", &TimePanelBlueprint::update_fields().with_play_state(PlayState::Paused));
    layout.finish(root)
}

/// The layout of a comparison of two runs: surfaces and error arrows, differences over time, events.
///
/// `second` are the surfaces of the second run, which are not drawn; `sides`: the two runs in the names of entities; `pairs`: those of which q is compared; the viewer opens at `first` [s], if there is one.
pub fn of_comparison(
    schema: &Schema,
    spheres: &[(DVec3, f64)],
    second: &[String],
    (sides, pairs): ([&str; 2], &[String]),
    first: Option<f64>,
    recording: &StoreId,
) -> Vec<LogMsg> {
    /// What is repeated around that instant [s].
    const BEFORE: f64 = 0.2;
    const AFTER: f64 = 1.0;

    let mut layout = Layout::of(recording);
    layout.set_arrangement(schema, spheres);
    let surfaces =
        layout.space((spheres, WIDE), "The first run, coloured by how much the second differs", &[family(&WORLD)]);
    second.iter().for_each(|surface| layout.visualize(&surfaces.path, surface, &[]));
    let about = layout.view("TextDocument", "Legend", ABOUT.path, &[including(ABOUT.path)], &[]);
    let left = layout.container(ContainerKind::Vertical, "Surfaces", vec![surfaces, about], &[2.6, 1.0]);
    let title = "log10 of the largest difference [radii]";
    // runs that differ do so more and more: lines rise from the left, where the viewer opens
    let plot = layout.time_series(title, "/", &[family(&LOG_DIFFERENCE)], Corner2D::RightBottom);
    let events = layout.lines("Events", EVENTS.path);
    let (mut parts, mut shares) = (vec![plot, events], vec![1.5, 1.0]);
    if !pairs.is_empty() {
        let mut plot = |pair: &String| {
            let mut lines: Vec<String> = Vec::new();
            for side in sides {
                lines.extend([&COMPARED_DISTANCE, &COMPARED_EVENTS].map(|of| including(&of.of(&[side, pair]))));
                let levels = schema.thresholds.iter().map(|of| COMPARED_LEVEL.of(&[side, pair, of.name]));
                lines.extend(levels.map(|level| including(&level)));
            }
            let plot = layout.time_series(&format!("q of {pair}"), "/", &lines, Corner2D::RightBottom);
            // it would cover a third of the lines, whose colours are those of the surfaces
            layout.hide_legend(&plot);
            plot
        };
        let plots = pairs.iter().map(&mut plot).collect();
        parts.insert(1, layout.container(ContainerKind::Tabs, "q in both runs", plots, &[]));
        shares.insert(1, 1.0);
    }
    let right = layout.container(ContainerKind::Vertical, "Differences", parts, &shares);
    let root = layout.container(ContainerKind::Horizontal, "meldscope", vec![left, right], &[1.6, 1.0]);
    if let Some(first) = first {
        layout.open_at([(first - BEFORE).max(0.0), first + AFTER]);
    }
    layout.finish(root)
}

/// The layout of the map of a sweep: the map, its legend, and measures along a line, one at a time. `picture` is the size
/// of the map and of the diagrams [px].
pub fn of_map(measures: &[&str], recording: &StoreId, picture: [f64; 2]) -> Vec<LogMsg> {
    let mut layout = Layout::of(recording);
    layout.timeline = SLICE;
    let [x, y] = picture;
    // from the numbers on the left to those at the ends of lines; above are the names of vertical axes, of up to three lines
    let bounds = |right: f64, top: f64| {
        VisualBounds2D::new(datatypes::Range2D {
            x_range: [-0.12 * x, right * x].into(),
            y_range: [-top * y, 1.16 * y].into(),
        })
    };
    let [of_map, of_measures] = [bounds(1.05, 0.14), bounds(1.12, 0.26)];
    let bounds: [(&str, &dyn AsComponents); 1] = [("VisualBounds2D", &of_map)];
    let map = layout.view("2D", "Map", MAP.family(), &[family(&MAP)], &bounds);
    let about = layout.view("TextDocument", "Legend", ABOUT.path, &[including(ABOUT.path)], &[]);
    let bounds: [(&str, &dyn AsComponents); 1] = [("VisualBounds2D", &of_measures)];
    let plots = measures.iter().map(|measure| {
        let entity = format!("{}/{measure}", MEASURE.family());
        layout.view("2D", &capitalized(&measure.replace('_', " ")), &entity, &[format!("+ {entity}/**")], &bounds)
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

named! {
    /// A tab of the layout.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum Tab {
        /// An overview of everything.
        Scene = "scene",
        /// The surfaces of groups, and geometric measures of pairs beside their phases.
        Surface = "surface",
        /// One 3D view per force term.
        Forces = "forces",
        /// Surfaces coloured by displacement, with selectable vertices.
        Displacement = "displacement",
        /// Distances, phases and events of pairs.
        Pairs = "pairs",
        /// Durations of stages.
        Timings = "timings",
        /// Energy and other scalars of the state.
        Energy = "energy",
        /// The stages inside steps.
        Stages = "stages",
    }
}
