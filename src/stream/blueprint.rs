//! The layout that the viewer opens with, sent by code beside every recording.
//!
//! The SDK's own builder knows neither cameras nor axes, so this logs the blueprint's archetypes itself: a tree of
//! containers and views, each an entity of the blueprint store with an id of its own.

use glam::DVec3;
use rerun::{
    AsComponents, Mesh3D, Points3D, StoreId, StoreKind, TimePoint,
    external::{
        re_log_types::{BlueprintActivationCommand, LogMsg},
        re_sdk_types::{
            blueprint::{
                archetypes::{
                    ActiveVisualizers, Background, ContainerBlueprint, EntityBehavior, EyeControls3D, LineGrid3D,
                    PanelBlueprint, PlotLegend, ScalarAxis, TextLogColumns, TimePanelBlueprint, ViewBlueprint,
                    ViewContents, ViewportBlueprint, VisualizerInstruction,
                },
                components::{
                    BackgroundKind, ContainerKind, Corner2D, Eye3DKind, PanelState, TimelineColumn,
                    VisualizerInstructionId,
                },
                datatypes::{ComponentSourceKind, TextLogColumn, TextLogColumnKind, VisualizerComponentMapping},
            },
            components::{Position3D, Range1D, Vector3D},
            datatypes::Uuid,
        },
    },
};

use super::{
    chunks::{Chunks, blueprint_time},
    palette,
    parts::{
        forces,
        numbers::{LAG, SPEED, TIMINGS, Typical},
        vertices::HOTTEST,
    },
    settings::{Detail, Entities, Frames, Settings, arrow_scale},
};
use crate::{
    model::phase::Phase,
    scene::Scene,
    sim::{Cause, World},
};

/// The messages that bring the layout for `recording` and make it the active one.
pub fn messages(world: &World, settings: &Settings, tab: Tab, recording: &StoreId) -> Vec<LogMsg> {
    let mut layout = Layout::of(recording);
    let root = layout.root(world.scene(), settings, tab);
    layout.finish(root)
}

/// What changes of those messages when it is known what stages usually take: plots of times leave out what is rare.
pub fn ranges(world: &World, settings: &Settings, tab: Tab, recording: &StoreId, typical: &Typical) -> Vec<LogMsg> {
    /// So much higher than what is typical is a plot.
    const HEADROOM: f64 = 1.3;

    let mut layout = Layout::of(recording);
    let root = layout.root(world.scene(), settings, tab);
    layout.finish(root); // sent before; what follows is numbered after it
    for (plot, stages) in std::mem::take(&mut layout.timings) {
        let shown = TIMINGS.iter().zip(typical).filter(|(stage, _)| stages.contains(*stage));
        let highest = shown.filter_map(|(_, typical)| *typical).fold(0.0, f64::max);
        if highest > 0.0 {
            let axis = ScalarAxis::new().with_range(Range1D::new(-0.02 * highest, HEADROOM * highest));
            layout.log(&format!("{plot}/ScalarAxis"), &axis);
        }
    }
    let messages = layout.chunks.take();
    if messages.is_empty() { messages } else { layout.activate(messages) }
}

/// The same for a recording of two runs side by side: surfaces and error arrows, differences over time, what happened.
pub fn of_comparison(scene: &Scene, recording: &StoreId) -> Vec<LogMsg> {
    let mut layout = Layout::of(recording);
    let (camera, grid) = (camera(scene), LineGrid3D::new().with_visible(false));
    let background = Background::new(BackgroundKind::SolidColor).with_color(palette::color(palette::BACKGROUND));
    let properties: [(&str, &dyn AsComponents); 3] =
        [("EyeControls3D", &camera), ("LineGrid3D", &grid), ("Background", &background)];
    let surfaces = layout.view("3D", "Both surfaces, and arrows between them", "/world", &["+ /world/**"], &properties);
    let about = layout.view("TextDocument", "What is what", "/about", &["+ /about"], &[]);
    let left = layout.container(ContainerKind::Vertical, "Surfaces", vec![surfaces, about], &[3.4, 1.0]);
    let legend = PlotLegend::new().with_corner(Corner2D::LeftTop);
    let contents = ["+ /difference/**"];
    let plot =
        layout.view("TimeSeries", "Largest difference [radii]", "/difference", &contents, &[("PlotLegend", &legend)]);
    let events = layout.lines("Events", "/events");
    let right = layout.container(ContainerKind::Vertical, "Differences", vec![plot, events], &[1.5, 1.0]);
    let root = layout.container(ContainerKind::Horizontal, "meldscope", vec![left, right], &[1.6, 1.0]);
    layout.finish(root)
}

/// Surfaces of more bodies than this look in views of forces as they do elsewhere.
const MOST_SHEER: usize = 16;

/// A container or a view that has been logged.
struct Part {
    id: Uuid,
    path: String,
}

/// A tab of the layout.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tab {
    /// Everything at one glance.
    Scene,
    /// A view a cause.
    Forces,
    /// Surfaces by how far they are displaced, vertices to select.
    Displacement,
    /// Distances, phases, events.
    Pairs,
    /// What it costs.
    Timings,
    /// What the state is like.
    Energy,
    /// The inside of steps.
    Stages,
}

impl Tab {
    /// All of them, in the viewer's order.
    pub const ALL: [Tab; 7] =
        [Tab::Scene, Tab::Forces, Tab::Displacement, Tab::Pairs, Tab::Timings, Tab::Energy, Tab::Stages];

    /// The name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Tab::Scene => "scene",
            Tab::Forces => "forces",
            Tab::Displacement => "displacement",
            Tab::Pairs => "pairs",
            Tab::Timings => "timings",
            Tab::Energy => "energy",
            Tab::Stages => "stages",
        }
    }
}

/// The stages of the plots in the tab of timings.
const SIMULATING: &[&str] = TIMINGS.split_at(3).0;
const STEPPING: &[&str] = TIMINGS.split_at(4).0;
const OBSERVING: &[&str] = TIMINGS.split_at(3).1.split_at(2).0;
const RECORDING: &[&str] = TIMINGS.split_at(5).1;

/// What a visualizer takes for one of its components.
#[derive(Clone, Copy)]
struct Mapping {
    target: &'static str,
    source: &'static str,
}

struct Layout {
    chunks: Chunks,
    next_id: u64,
    /// The plots of times, and which.
    timings: Vec<(String, &'static [&'static str])>,
}

impl Layout {
    /// For a recording, with nothing in it.
    fn of(recording: &StoreId) -> Layout {
        let id = format!("blueprint-{}", recording.recording_id().as_str());
        let store = StoreId::new(StoreKind::Blueprint, recording.application_id().clone(), id);
        Layout { chunks: Chunks::new(store), next_id: 0, timings: Vec::new() }
    }

    /// Makes `root` the whole window.
    fn finish(&mut self, root: Part) -> Vec<LogMsg> {
        self.log(
            "viewport",
            &ViewportBlueprint::new().with_root_container(root.id).with_auto_layout(false).with_auto_views(false),
        );
        for panel in ["blueprint_panel", "selection_panel"] {
            self.log(panel, &PanelBlueprint::new().with_state(PanelState::Collapsed));
        }
        self.log("time_panel", &TimePanelBlueprint::new().with_state(PanelState::Collapsed).with_timeline("sim_time"));

        let messages = self.chunks.take();
        self.activate(messages)
    }

    fn activate(&self, mut messages: Vec<LogMsg>) -> Vec<LogMsg> {
        let blueprint_id = self.chunks.store().clone();
        let activate = BlueprintActivationCommand { blueprint_id, make_active: true, make_default: true };
        messages.push(LogMsg::BlueprintActivationCommand(activate));
        messages
    }

    fn root(&mut self, scene: &Scene, settings: &Settings, front: Tab) -> Part {
        let mut tabs = vec![(Tab::Scene, self.scene_tab(scene, settings))];
        if settings.detail != Detail::Surface {
            tabs.push((Tab::Forces, self.forces_tab(scene, settings)));
            tabs.push((Tab::Displacement, self.displacement_tab(scene, settings)));
        }
        if scene.bodies.len() > 1 {
            let parts = self.pair_views(scene);
            tabs.push((Tab::Pairs, self.container(ContainerKind::Vertical, "Pairs", parts, &[2.0, 1.0, 0.8])));
        }
        tabs.push((Tab::Timings, self.timings_tab()));
        let plots = self.diagnostics();
        tabs.push((Tab::Energy, self.container(ContainerKind::Vertical, "Energy", plots, &[1.0; 4])));
        if matches!(settings.detail, Detail::Stages { .. }) {
            tabs.push((Tab::Stages, self.stages_tab(scene, settings)));
        }
        let active = tabs.iter().find(|(tab, _)| *tab == front).map(|(_, part)| part.path.clone());
        let root =
            self.container(ContainerKind::Tabs, "meldscope", tabs.into_iter().map(|(_, part)| part).collect(), &[]);
        if let Some(active) = active {
            self.log(&root.path, &ContainerBlueprint::update_fields().with_active_tab(active.as_str()));
        }
        root
    }

    /// The inside of steps: on the timeline `stage`.
    fn stages_tab(&mut self, scene: &Scene, settings: &Settings) -> Part {
        let view = self.scene_view(scene, "Inside of a step (timeline: stage)", settings);
        let lines = self.lines("Stages", "/stages");
        self.container(ContainerKind::Horizontal, "Stages", vec![view, lines], &[2.0, 1.0])
    }

    fn lines(&mut self, name: &str, entity: &str) -> Part {
        let columns = TextLogColumns::new()
            .with_timeline_columns(Vec::<TimelineColumn>::new())
            .with_text_log_columns([TextLogColumn { kind: TextLogColumnKind::Body, visible: true.into() }]);
        self.view("TextLog", name, entity, &[&format!("+ {entity}")], &[("TextLogColumns", &columns)])
    }

    /// Everything at one glance.
    fn scene_tab(&mut self, scene: &Scene, settings: &Settings) -> Part {
        let scene_view = self.scene_view(scene, "Bodies, influence spheres, forces", settings);
        let about = self.view("TextDocument", "What is what", "/about", &["+ /about"], &[]);
        let left = self.container(ContainerKind::Vertical, "Space", vec![scene_view, about], &[2.6, 1.0]);
        let right = if scene.bodies.len() > 1 {
            let mut parts = self.pair_views(scene);
            parts.push(self.timings());
            self.container(ContainerKind::Vertical, "Time", parts, &[1.4, 0.75, 0.75, 1.0])
        } else {
            // a body that is alone: how it moves, and what it cost
            let mut parts = self.diagnostics();
            parts.push(self.timings());
            self.container(ContainerKind::Vertical, "Time", parts, &[1.0, 1.0, 1.0, 1.0, 1.2])
        };
        self.container(ContainerKind::Horizontal, "Scene", vec![left, right], &[1.6, 1.0])
    }

    /// A view a cause, of those that the scene can have, all from the same side: from there each is turned by itself, as
    /// Rerun 0.36 has a camera for every view and nothing that ties two together.
    fn forces_tab(&mut self, scene: &Scene, settings: &Settings) -> Part {
        const WHITE: palette::Rgb = [0xFF; 3];
        let camera = close_camera(scene);
        let has = |cause: Cause| match cause {
            Cause::Attraction | Cause::Repulsion => scene.bodies.len() > 1,
            Cause::Core => scene.bodies.len() > 1 && scene.thresholds.core_at > 0.0,
            Cause::Push => !scene.pushes.is_empty(),
            Cause::Restoring | Cause::Damping | Cause::Carry | Cause::Net => true,
        };
        let views: Vec<Part> = Cause::ALL
            .into_iter()
            .filter(|&cause| has(cause))
            .map(|cause| {
                let arrows = format!("+ {}", forces::entity(cause));
                let contents = ["+ /world/bodies/**", "+ /world/deforming/**", arrows.as_str()];
                let view = self.space(&camera, cause_title(cause), &contents);
                if scene.bodies.len() <= MOST_SHEER || settings.entities == Entities::Batch {
                    for (index, surface) in surfaces(scene, settings).into_iter().enumerate() {
                        // a batch has a colour for each vertex
                        let rgb = if settings.entities == Entities::Batch { WHITE } else { palette::body(index) };
                        let sheer = Mesh3D::update_fields().with_albedo_factor(palette::sheer(rgb));
                        self.visualize(&view, &surface, &[("Mesh3D", None, &sheer)]);
                    }
                }
                view
            })
            .collect();
        self.grid("Forces", views, 3)
    }

    /// Surfaces coloured by how far they are displaced, and vertices to select.
    fn displacement_tab(&mut self, scene: &Scene, settings: &Settings) -> Part {
        let title = format!(
            "Displacement: purple 0, green {}, yellow {HOTTEST} radii and more; select a vertex to see its numbers",
            0.6 * HOTTEST
        );
        let view = self.space(&close_camera(scene), &title, &["+ /world/bodies/**", "+ /world/deforming/**"]);
        let heat = Mapping { target: "Mesh3D:vertex_colors", source: "Points3D:colors" };
        let positions = Mapping { target: "Points3D:positions", source: "Mesh3D:vertex_positions" };
        let opaque = Mesh3D::update_fields().with_albedo_factor(rerun::Rgba32::WHITE);
        let dots = Points3D::update_fields().with_radii([rerun::Radius::new_ui_points(2.5)]);
        for surface in surfaces(scene, settings) {
            self.visualize(&view, &surface, &[("Mesh3D", Some(heat), &opaque), ("Points3D", Some(positions), &dots)]);
        }
        self.container(ContainerKind::Vertical, "Displacement", vec![view], &[])
    }

    /// What happens between bodies.
    fn pair_views(&mut self, scene: &Scene) -> Vec<Part> {
        let legend = PlotLegend::new().with_corner(Corner2D::RightBottom);
        let [low, high] = q_range(scene);
        let axis = ScalarAxis::new().with_range(Range1D::new(low, high));
        let distances = self.view(
            "TimeSeries",
            "Pair distances q and their thresholds",
            "/pairs",
            &["+ /pairs/**", "- /pairs/*/phase"],
            &[("PlotLegend", &legend), ("ScalarAxis", &axis)],
        );
        let phases = self.view("StateTimeline", "Pair phases", "/pairs", &["+ /pairs/**"], &[]);
        let events = self.lines("Events", "/events");
        vec![distances, phases, events]
    }

    /// What it costs, apart: each of these has an order of magnitude of its own.
    fn timings_tab(&mut self) -> Part {
        let left = vec![
            self.times("Timings, ms per step: simulating", SIMULATING),
            self.times("Timings, ms per step: observing, and waiting for the recording", OBSERVING),
        ];
        let right =
            vec![self.times("Timings, ms per step: recording, on a thread of its own", RECORDING), self.speed()];
        let left = self.container(ContainerKind::Vertical, "The simulation's time", left, &[1.0, 1.0]);
        let right = self.container(ContainerKind::Vertical, "Beside it", right, &[1.0, 1.0]);
        self.container(ContainerKind::Horizontal, "Timings", vec![left, right], &[1.0, 1.0])
    }

    /// What the thread that steps does.
    fn timings(&mut self) -> Part {
        self.times("Timings, ms per step", STEPPING)
    }

    fn times(&mut self, name: &str, stages: &'static [&'static str]) -> Part {
        let contents: Vec<String> = stages.iter().map(|stage| format!("+ /timings/{stage}")).collect();
        let contents: Vec<&str> = contents.iter().map(String::as_str).collect();
        let plot = self.plot(name, "/timings", &contents, Corner2D::LeftTop);
        self.timings.push((plot.path.clone(), stages));
        plot
    }

    fn speed(&mut self) -> Part {
        let contents = [format!("+ {SPEED}"), format!("+ {LAG}")];
        let contents = [contents[0].as_str(), contents[1].as_str()];
        self.plot("Steps per second, and milliseconds behind real time", "/timings", &contents, Corner2D::LeftTop)
    }

    fn diagnostics(&mut self) -> Vec<Part> {
        let mut plot = |name: &str, contents: &[&str]| self.plot(name, "/diagnostics", contents, Corner2D::RightTop);
        vec![
            plot("Energy", &["+ /diagnostics/energy"]),
            plot("Displacement", &["+ /diagnostics/max_displacement"]),
            plot("Estimated error", &["+ /diagnostics/estimated_error"]),
            plot(
                "Counts",
                &["+ /diagnostics/reached_vertices", "+ /diagnostics/substeps", "+ /diagnostics/sleeping_bodies"],
            ),
        ]
    }

    fn plot(&mut self, name: &str, origin: &str, contents: &[&str], corner: Corner2D) -> Part {
        let legend = PlotLegend::new().with_corner(corner);
        self.view("TimeSeries", name, origin, contents, &[("PlotLegend", &legend)])
    }

    /// Everything in space, with those forces that make bodies merge and split.
    fn scene_view(&mut self, scene: &Scene, name: &str, settings: &Settings) -> Part {
        let view = self.space(&camera(scene), name, &["+ /world/**"]);
        let mut hide = |entity: &str| {
            let path = format!("{}/ViewContents/overrides{entity}/visualizers", view.path);
            self.log(&path, &EntityBehavior::new().with_visible(false));
        };
        if settings.entities == Entities::Batch {
            hide("/world/influence"); // those that reach somebody are with the pairs
        }
        if settings.detail != Detail::Surface {
            // the others are one click away in the view's entity list
            for cause in [Cause::Restoring, Cause::Damping, Cause::Push, Cause::Carry, Cause::Net] {
                if cause == Cause::Push && !scene.pushes.is_empty() {
                    continue;
                }
                hide(&forces::entity(cause));
            }
        }
        view
    }

    /// A 3D view.
    fn space(&mut self, camera: &EyeControls3D, name: &str, contents: &[&str]) -> Part {
        let grid = LineGrid3D::new().with_visible(false);
        let background = Background::new(BackgroundKind::SolidColor).with_color(palette::color(palette::BACKGROUND));
        let properties: [(&str, &dyn AsComponents); 3] =
            [("EyeControls3D", camera), ("LineGrid3D", &grid), ("Background", &background)];
        self.view("3D", name, "/world", contents, &properties)
    }

    /// Shows an entity of a view with these visualizers instead of those that the viewer would choose.
    fn visualize(&mut self, view: &Part, entity: &str, visualizers: &[(&str, Option<Mapping>, &dyn AsComponents)]) {
        let base = format!("{}/ViewContents/overrides/{entity}/visualizers", view.path);
        let mut ids = Vec::new();
        for (class, mapping, overrides) in visualizers {
            let (id, text) = self.id();
            let path = format!("{base}/{text}");
            let mapping = mapping.map(|mapping| VisualizerComponentMapping {
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
        // Version 8 of RFC 9562: bits of our own, here just a count.
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

    fn grid(&mut self, name: &str, parts: Vec<Part>, columns: u32) -> Part {
        let grid = self.container(ContainerKind::Grid, name, parts, &[]);
        self.log(&grid.path, &ContainerBlueprint::update_fields().with_grid_columns(columns));
        grid
    }
}

/// What a view of a force is called.
fn cause_title(cause: Cause) -> &'static str {
    match cause {
        Cause::Attraction => "Attraction (orange)",
        Cause::Repulsion => "Repulsion of bodies apart (blue)",
        Cause::Core => "Repulsion in the core (purple)",
        Cause::Restoring => "Restoring (green)",
        Cause::Damping => "Damping (yellow)",
        Cause::Push => "Push (red)",
        Cause::Carry => "Carry: its own motion (grey)",
        Cause::Net => "Net (white)",
    }
}

/// The surfaces that deform.
fn surfaces(scene: &Scene, settings: &Settings) -> Vec<String> {
    match settings.entities {
        Entities::Body => scene.bodies.iter().map(|body| format!("world/bodies/{}/surface", body.name)).collect(),
        Entities::Batch => vec!["world/deforming/surface".to_owned()],
    }
}

/// Instants of the first minute at which cameras look where bodies are.
fn instants(scene: &Scene) -> impl Iterator<Item = f64> {
    let duration = scene.duration.min(60.0);
    (0..=32).map(move |k| duration * f64::from(k) / 32.0)
}

/// A camera that has every influence sphere in view wherever its path takes it.
fn camera(scene: &Scene) -> EyeControls3D {
    let spheres = scene.bodies.iter().flat_map(|body| {
        let radius = scene.influence.sphere_radius(body.radius).min(2.0 * body.radius);
        instants(scene).map(move |time| (body.path.position(time), radius))
    });
    camera_on(&spheres.collect::<Vec<_>>())
}

/// A camera that has those bodies in view that something acts on, while it does.
fn close_camera(scene: &Scene) -> EyeControls3D {
    /// Pairs of more bodies are not gone through.
    const MOST: usize = 1000;
    /// Of a body, with what it is displaced by [radii].
    const ROOM: f64 = 1.15;
    /// How much is shown of a body that is larger than this [radii of the other].
    const SIDE: f64 = 3.0;

    let bodies = &scene.bodies;
    let mut acted_on = Vec::new();
    for push in &scene.pushes {
        let body = &bodies[push.body];
        acted_on.push((body.path.position(push.start), ROOM * body.radius));
    }
    let pairs_of = if bodies.len() > MOST { 0 } else { bodies.len() };
    let movers: Vec<usize> = (0..pairs_of).filter(|&i| !bodies[i].path.is_fixed()).collect();
    let all: Vec<usize> = (0..pairs_of).collect();
    for (k, time) in instants(scene).enumerate() {
        let centres: Vec<DVec3> = bodies[..pairs_of].iter().map(|body| body.path.position(time)).collect();
        // those that do not move are as they were at the first instant
        for &b in if k == 0 { &all } else { &movers } {
            for a in (0..pairs_of).filter(|&a| a != b) {
                let reach =
                    |from: usize, to: usize| scene.influence.sphere_radius(bodies[from].radius) + bodies[to].radius;
                if centres[a].distance(centres[b]) < f64::max(reach(a, b), reach(b, a)) {
                    // of a body that is much larger than the other only the side where that is
                    let shown = |i: usize, other: usize| {
                        let radius = f64::min(bodies[i].radius, SIDE * bodies[other].radius);
                        let towards = (centres[other] - centres[i]).normalize_or_zero();
                        (centres[i] + (bodies[i].radius - radius) * towards, ROOM * radius)
                    };
                    acted_on.extend([shown(a, b), shown(b, a)]);
                }
            }
        }
    }
    if acted_on.is_empty() { camera(scene) } else { camera_on(&acted_on) }
}

/// A camera from the front, somewhat from the side and from above, that has these spheres in view: centres and radii. What is
/// flat is seen from higher up.
fn camera_on(spheres: &[(DVec3, f64)]) -> EyeControls3D {
    /// Half the viewer's vertical field of view, 55°.
    const HALF_HEIGHT: f64 = 0.5205;
    /// Views are 1.45 times as wide as they are high, or wider.
    const HALF_WIDTH: f64 = 1.42 * HALF_HEIGHT;

    let low = spheres.iter().fold(DVec3::INFINITY, |low, &(centre, radius)| low.min(centre - radius));
    let high = spheres.iter().fold(DVec3::NEG_INFINITY, |high, &(centre, radius)| high.max(centre + radius));
    let (middle, extent) = (0.5 * (low + high), high - low);
    let is_flat = extent.z < 0.2 * f64::min(extent.x, extent.y);
    let back = DVec3::new(-0.2, -1.0, if is_flat { 1.0 } else { 0.4 }).normalize(); // towards the eye
    let right = DVec3::Z.cross(back).normalize();
    let up = back.cross(right);
    // The distance from which a sphere at `centre` just fits between the planes that bound the view.
    let distance = |centre: DVec3, radius: f64| {
        let offset = centre - middle;
        let fits = |sideways: f64, half: f64| (sideways.abs() + radius * half.hypot(1.0)) / half;
        offset.dot(back) + f64::max(fits(offset.dot(right), HALF_WIDTH), fits(offset.dot(up), HALF_HEIGHT))
    };
    let eye = middle + back * spheres.iter().map(|&(centre, radius)| distance(centre, radius)).fold(0.0, f64::max);
    EyeControls3D::new()
        .with_kind(Eye3DKind::Orbital)
        .with_position(Position3D::from(eye.as_vec3()))
        .with_look_target(Position3D::from(middle.as_vec3()))
        .with_eye_up(Vector3D::from(glam::Vec3::Z))
}

/// The range of q worth looking at: the thresholds and what is around them.
fn q_range(scene: &Scene) -> [f64; 2] {
    let thresholds = &scene.thresholds;
    let low = if thresholds.core_at > 0.0 { thresholds.core_at } else { thresholds.merge_at };
    [low - 0.25, thresholds.split_at + 0.25]
}

/// What the colours mean, and which scene, integrator, step and settings these are; of a recording that begins with step
/// `first`.
pub fn about(scene: &Scene, settings: &Settings, first: u64) -> String {
    let (influence, thresholds) = (&scene.influence, &scene.thresholds);
    let frames = match (&settings.frames, settings.every) {
        (Frames::Thin, _) => {
            "no frames: only checksums (`meldscope replay F.rrd --save G.rrd` makes the rest)".to_owned()
        }
        (Frames::All, 1) => "a frame every step".to_owned(),
        (Frames::All, every) => format!("a frame every {every} steps"),
        (Frames::Last { most: 1, on }, _) if on.is_empty() => "the last frame".to_owned(),
        (Frames::Last { most, on }, _) if on.is_empty() => format!("the last {most} frames"),
        (Frames::Last { most, on }, _) => {
            let on: Vec<&str> = on.iter().map(|trigger| trigger.name()).collect();
            let frames = if *most == 1 { "frame".to_owned() } else { format!("{most} frames") };
            format!("the last {frames} before each {}", on.join(", "))
        }
    };
    let steps = match settings.steps {
        None => "until stopped".to_owned(),
        Some(last) if first > 0 => format!("steps {first} to {last}"),
        Some(1) => "1 step".to_owned(),
        Some(steps) => format!("{steps} steps"),
    };
    let head = format!(
        "**{}**: {} {}, {} vertices. `{}`, Δt = {:.6} s, {steps}, {frames}.  \n",
        scene.name,
        scene.bodies.len(),
        if scene.bodies.len() == 1 { "body" } else { "bodies" },
        scene.vertex_count(),
        settings.integrator,
        settings.dt,
    );
    let law = format!(
        "α = {}/s², β = {}/s², spheres {:.3} R. Merge at q = {}, split at {}{}; q: centre distance over the sum of the radii.  \n",
        influence.alpha,
        influence.beta,
        influence.reach,
        thresholds.merge_at,
        thresholds.split_at,
        if thresholds.core_at > 0.0 { format!(", core below {}", thresholds.core_at) } else { String::new() },
    );
    let spheres = format!(
        "Influence spheres, lines, lanes: blue **{}**, orange **{}**, purple **{}**, grey: reaches nobody{}.  \n",
        Phase::Apart,
        Phase::Merged,
        Phase::Core,
        if settings.entities == Entities::Batch { " (hidden at first)" } else { "" },
    );
    let arrows = match settings.detail {
        Detail::Surface => "Force arrows were not recorded (`--detail forces`).  \n".to_owned(),
        Detail::Forces | Detail::Stages { .. } => format!(
            "Arrows: forces of the state on screen, {} unit long per unit/s²: orange **attraction**, blue **repulsion**, \
             purple **core**, red **push**; hidden at first: green **restoring**, yellow **damping**, grey **carry** (own \
             motion), white **net**.  \n",
            arrow_scale(scene)
        ),
    };
    let bound = if scene.bodies.len() * scene.bodies.len().saturating_sub(1) / 2 > settings.pairs {
        let most = settings.pairs;
        format!(
            "The first {most} pairs that come within reach have plots and lanes, the closest {most} have lines (`--pairs`); events \
                 list them all.\n"
        )
    } else {
        String::new()
    };
    match settings.frames {
        Frames::Thin => head + &law,
        _ => head + &law + &spheres + &arrows + &bound,
    }
}
