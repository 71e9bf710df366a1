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
        numbers::{LAG, SPEED, TIMINGS},
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
    let id = format!("blueprint-{}", recording.recording_id().as_str());
    let store = StoreId::new(StoreKind::Blueprint, recording.application_id().clone(), id);
    let mut layout = Layout { chunks: Chunks::new(store.clone()), next_id: 0 };
    let root = layout.root(world.scene(), settings, tab);
    layout.finish(root, store)
}

/// The same for a recording of two runs side by side: surfaces and error arrows, differences over time, what happened.
pub fn of_comparison(scene: &Scene, recording: &StoreId) -> Vec<LogMsg> {
    let id = format!("blueprint-{}", recording.recording_id().as_str());
    let store = StoreId::new(StoreKind::Blueprint, recording.application_id().clone(), id);
    let mut layout = Layout { chunks: Chunks::new(store.clone()), next_id: 0 };
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
    layout.finish(root, store)
}

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

/// What a visualizer takes for one of its components.
#[derive(Clone, Copy)]
struct Mapping {
    target: &'static str,
    source: &'static str,
}

struct Layout {
    chunks: Chunks,
    next_id: u64,
}

impl Layout {
    /// Makes `root` the whole window.
    fn finish(mut self, root: Part, store: StoreId) -> Vec<LogMsg> {
        self.log(
            "viewport",
            &ViewportBlueprint::new().with_root_container(root.id).with_auto_layout(false).with_auto_views(false),
        );
        for panel in ["blueprint_panel", "selection_panel"] {
            self.log(panel, &PanelBlueprint::new().with_state(PanelState::Collapsed));
        }
        self.log("time_panel", &TimePanelBlueprint::new().with_state(PanelState::Collapsed).with_timeline("sim_time"));

        let mut messages = self.chunks.take();
        let activate = BlueprintActivationCommand { blueprint_id: store, make_active: true, make_default: true };
        messages.push(LogMsg::BlueprintActivationCommand(activate));
        messages
    }

    fn root(&mut self, scene: &Scene, settings: &Settings, front: Tab) -> Part {
        let mut tabs = vec![(Tab::Scene, self.scene_tab(scene, settings))];
        if settings.detail != Detail::Surface {
            tabs.push((Tab::Forces, self.forces_tab(scene)));
            tabs.push((Tab::Displacement, self.displacement_tab(scene, settings)));
        }
        if scene.bodies.len() > 1 {
            let parts = self.pair_views(scene);
            tabs.push((Tab::Pairs, self.container(ContainerKind::Vertical, "Pairs", parts, &[2.0, 1.0, 0.8])));
        }
        let timings = vec![self.timings(), self.speed()];
        tabs.push((Tab::Timings, self.container(ContainerKind::Vertical, "Timings", timings, &[2.0, 1.0])));
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

    /// A view a cause, of those that the scene can have, all from the same side.
    fn forces_tab(&mut self, scene: &Scene) -> Part {
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
                self.space(scene, cause_title(cause), &contents)
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
        let view = self.space(scene, &title, &["+ /world/bodies/**", "+ /world/deforming/**"]);
        let heat = Mapping { target: "Mesh3D:vertex_colors", source: "Points3D:colors" };
        let positions = Mapping { target: "Points3D:positions", source: "Mesh3D:vertex_positions" };
        let opaque = Mesh3D::update_fields().with_albedo_factor(rerun::Rgba32::WHITE);
        let dots = Points3D::update_fields().with_radii([rerun::Radius::new_ui_points(2.5)]);
        let surfaces: Vec<String> = match settings.entities {
            Entities::Body => scene.bodies.iter().map(|body| format!("world/bodies/{}/surface", body.name)).collect(),
            Entities::Batch => vec!["world/deforming/surface".to_owned()],
        };
        for surface in surfaces {
            self.visualize(&view, &surface, &[("Mesh3D", heat, &opaque), ("Points3D", positions, &dots)]);
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

    fn timings(&mut self) -> Part {
        let contents: Vec<String> = TIMINGS.iter().map(|stage| format!("+ /timings/{stage}")).collect();
        let contents: Vec<&str> = contents.iter().map(String::as_str).collect();
        self.plot("Timings, ms per step", "/timings", &contents, Corner2D::LeftTop)
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
        let view = self.space(scene, name, &["+ /world/**"]);
        if settings.detail != Detail::Surface {
            // the others are one click away in the view's entity list
            for cause in [Cause::Restoring, Cause::Damping, Cause::Push, Cause::Carry, Cause::Net] {
                if cause == Cause::Push && !scene.pushes.is_empty() {
                    continue;
                }
                let path = format!("{}/ViewContents/overrides/world/forces/{}/visualizers", view.path, cause.name());
                self.log(&path, &EntityBehavior::new().with_visible(false));
            }
        }
        view
    }

    /// A 3D view that has the whole scene in sight.
    fn space(&mut self, scene: &Scene, name: &str, contents: &[&str]) -> Part {
        let (camera, grid) = (camera(scene), LineGrid3D::new().with_visible(false));
        let background = Background::new(BackgroundKind::SolidColor).with_color(palette::color(palette::BACKGROUND));
        let properties: [(&str, &dyn AsComponents); 3] =
            [("EyeControls3D", &camera), ("LineGrid3D", &grid), ("Background", &background)];
        self.view("3D", name, "/world", contents, &properties)
    }

    /// Shows an entity of a view with these visualizers instead of those that the viewer would choose.
    fn visualize(&mut self, view: &Part, entity: &str, visualizers: &[(&str, Mapping, &dyn AsComponents)]) {
        let base = format!("{}/ViewContents/overrides/{entity}/visualizers", view.path);
        let mut ids = Vec::new();
        for (class, mapping, overrides) in visualizers {
            let (id, text) = self.id();
            let path = format!("{base}/{text}");
            let mapping = VisualizerComponentMapping {
                target: mapping.target.into(),
                source_kind: ComponentSourceKind::SourceComponent,
                source_component: Some(mapping.source.into()),
                selector: None,
            };
            self.log(&path, &VisualizerInstruction::new(*class).with_component_map([mapping]));
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

/// A camera from the front, somewhat from the side and from above, that has every influence sphere in view wherever
/// its path takes it in the first minute.
fn camera(scene: &Scene) -> EyeControls3D {
    /// Half the viewer's vertical field of view, 55°.
    const HALF_HEIGHT: f64 = 0.5205;
    /// The first view is about 1.5 times as wide as it is high.
    const HALF_WIDTH: f64 = 1.5 * HALF_HEIGHT;

    let back = DVec3::new(-0.2, -1.0, 0.4).normalize(); // towards the eye
    let right = DVec3::Z.cross(back).normalize();
    let up = back.cross(right);
    let duration = scene.duration.min(60.0);
    let spheres = || {
        scene.bodies.iter().flat_map(move |body| {
            let radius = scene.influence.sphere_radius(body.radius).min(2.0 * body.radius);
            (0..=32).map(move |k| (body.path.position(duration * f64::from(k) / 32.0), radius))
        })
    };
    let low = spheres().fold(DVec3::INFINITY, |low, (centre, radius)| low.min(centre - radius));
    let high = spheres().fold(DVec3::NEG_INFINITY, |high, (centre, radius)| high.max(centre + radius));
    let middle = 0.5 * (low + high);
    // The distance from which a sphere at `centre` just fits between the planes that bound the view.
    let distance = |centre: DVec3, radius: f64| {
        let offset = centre - middle;
        let fits = |sideways: f64, half: f64| (sideways.abs() + radius * half.hypot(1.0)) / half;
        offset.dot(back) + f64::max(fits(offset.dot(right), HALF_WIDTH), fits(offset.dot(up), HALF_HEIGHT))
    };
    let eye = middle + back * spheres().map(|(centre, radius)| distance(centre, radius)).fold(0.0, f64::max);
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

/// What the colours mean, and which scene, integrator, step and settings these are.
pub fn about(scene: &Scene, settings: &Settings) -> String {
    let (influence, thresholds) = (&scene.influence, &scene.thresholds);
    let frames = match (&settings.frames, settings.every) {
        (Frames::Thin, _) => {
            "no frames: only checksums (`meldscope replay F.rrd --save G.rrd` makes the rest)".to_owned()
        }
        (Frames::All, 1) => "a frame every step".to_owned(),
        (Frames::All, every) => format!("a frame every {every} steps"),
        (Frames::Last { most, on }, _) if on.is_empty() => format!("the last {most} frames"),
        (Frames::Last { most, on }, _) => {
            let on: Vec<&str> = on.iter().map(|trigger| trigger.name()).collect();
            format!("the last {most} frames before each {}", on.join(", "))
        }
    };
    let steps = settings.steps.map_or("until stopped".to_owned(), |steps| format!("{steps} steps"));
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
        "Influence spheres, lines, lanes: blue **{}**, orange **{}**, purple **{}**, grey: reaches nobody.  \n",
        Phase::Apart,
        Phase::Merged,
        Phase::Core
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
