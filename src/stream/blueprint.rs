//! The layout that the viewer opens with, sent by code beside every recording.
//!
//! The SDK's own builder knows neither cameras nor axes, so this logs the blueprint's archetypes itself: a tree of
//! containers and views, each an entity of the blueprint store with an id of its own.

use glam::DVec3;
use rerun::{
    AsComponents, StoreId, StoreKind, TimePoint,
    external::{
        re_log_types::{BlueprintActivationCommand, LogMsg},
        re_sdk_types::{
            blueprint::{
                archetypes::{
                    Background, ContainerBlueprint, EntityBehavior, EyeControls3D, LineGrid3D, PanelBlueprint,
                    PlotLegend, ScalarAxis, TextLogColumns, TimePanelBlueprint, ViewBlueprint, ViewContents,
                    ViewportBlueprint,
                },
                components::{BackgroundKind, ContainerKind, Corner2D, Eye3DKind, PanelState, TimelineColumn},
                datatypes::{TextLogColumn, TextLogColumnKind},
            },
            components::{Position3D, Range1D, Vector3D},
            datatypes::Uuid,
        },
    },
};

use super::{
    chunks::{Chunks, blueprint_time},
    palette,
    recorder::{Detail, MOST_PAIRS, Settings},
};
use crate::{
    model::phase::Phase,
    scene::Scene,
    sim::{Cause, World},
};

/// The messages that bring the layout for `recording` and make it the active one.
pub fn messages(world: &World, settings: &Settings, recording: &StoreId) -> Vec<LogMsg> {
    let id = format!("blueprint-{}", recording.recording_id().as_str());
    let store = StoreId::new(StoreKind::Blueprint, recording.application_id().clone(), id);
    let mut layout = Layout { chunks: Chunks::new(store.clone()), next_id: 0 };
    let root = layout.root(world, settings);
    layout.log(
        "viewport",
        &ViewportBlueprint::new().with_root_container(root.id).with_auto_layout(false).with_auto_views(false),
    );
    for panel in ["blueprint_panel", "selection_panel"] {
        layout.log(panel, &PanelBlueprint::new().with_state(PanelState::Collapsed));
    }
    layout.log("time_panel", &TimePanelBlueprint::new().with_state(PanelState::Collapsed).with_timeline("sim_time"));

    let mut messages = layout.chunks.take();
    let activate = BlueprintActivationCommand { blueprint_id: store, make_active: true, make_default: true };
    messages.push(LogMsg::BlueprintActivationCommand(activate));
    messages
}

/// A container or a view that has been logged.
struct Part {
    id: Uuid,
    path: String,
}

struct Layout {
    chunks: Chunks,
    next_id: u64,
}

impl Layout {
    fn root(&mut self, world: &World, settings: &Settings) -> Part {
        let scene_view = self.scene_view(world, settings);
        let about = self.view("TextDocument", "What is what", "/about", &["/about"], &[]);
        let left = self.container(ContainerKind::Vertical, "Scene", vec![scene_view, about], &[3.4, 1.0]);

        let legend = PlotLegend::new().with_corner(Corner2D::RightTop);
        let range = q_range(world.scene());
        let axis = ScalarAxis::new().with_range(Range1D::new(range[0], range[1]));
        let distances = self.view(
            "TimeSeries",
            "Pair distances q and their thresholds",
            "/pairs",
            &["/pairs/**", "- /pairs/*/phase"],
            &[("PlotLegend", &legend), ("ScalarAxis", &axis)],
        );
        let phases = self.view("StateTimeline", "Pair phases", "/pairs", &["/pairs/**"], &[]);
        let column = |kind| TextLogColumn { kind, visible: true.into() };
        let columns = TextLogColumns::new()
            .with_timeline_columns(Vec::<TimelineColumn>::new())
            .with_text_log_columns([column(TextLogColumnKind::Body)]);
        let events = self.view("TextLog", "Events", "/events", &["/events"], &[("TextLogColumns", &columns)]);
        let legend = PlotLegend::new().with_corner(Corner2D::LeftTop);
        let timings =
            self.view("TimeSeries", "Timings, ms per step", "/timings", &["/timings/**"], &[("PlotLegend", &legend)]);
        let diagnostics = self.diagnostics();
        let tabs = self.container(ContainerKind::Tabs, "Numbers", vec![timings, diagnostics], &[]);
        let right = self.container(
            ContainerKind::Vertical,
            "Pairs",
            vec![distances, phases, events, tabs],
            &[1.5, 0.8, 0.8, 1.1],
        );
        self.container(ContainerKind::Horizontal, "meldscope", vec![left, right], &[1.7, 1.0])
    }

    fn scene_view(&mut self, world: &World, settings: &Settings) -> Part {
        let camera = camera(world);
        let grid = LineGrid3D::new().with_visible(false);
        let background = Background::new(BackgroundKind::SolidColor).with_color(palette::color(palette::BACKGROUND));
        let view = self.view(
            "3D",
            "Bodies, influence spheres, forces",
            "/world",
            &["/world/**"],
            &[("EyeControls3D", &camera), ("LineGrid3D", &grid), ("Background", &background)],
        );
        if settings.detail == Detail::Forces {
            // At first only what merges and splits; the others are one click away in the view's entity list.
            for cause in [Cause::Restoring, Cause::Damping, Cause::Push, Cause::Carry, Cause::Net] {
                if cause == Cause::Push && !world.scene().pushes.is_empty() {
                    continue;
                }
                let path = format!("{}/ViewContents/overrides/world/forces/{}/visualizers", view.path, cause.name());
                self.log(&path, &EntityBehavior::new().with_visible(false));
            }
        }
        view
    }

    fn diagnostics(&mut self) -> Part {
        let legend = PlotLegend::new().with_corner(Corner2D::LeftTop);
        let mut plot = |name: &str, entities: &[&str]| {
            self.view("TimeSeries", name, "/diagnostics", entities, &[("PlotLegend", &legend)])
        };
        let parts = vec![
            plot("Energy", &["/diagnostics/energy"]),
            plot("Displacement", &["/diagnostics/max_displacement"]),
            plot("Counts", &["/diagnostics/reached_vertices", "/diagnostics/substeps", "/diagnostics/sleeping_bodies"]),
        ];
        self.container(ContainerKind::Horizontal, "Diagnostics", parts, &[])
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
        let contents = ViewContents::new(contents.iter().map(|query| format!("+ {query}").replace("+ - ", "- ")));
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

/// A view of the whole scene over its first seconds, from the front, somewhat from the side and from above.
fn camera(world: &World) -> EyeControls3D {
    let scene = world.scene();
    let duration = scene.duration.min(60.0);
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for body in &scene.bodies {
        for k in 0..=32 {
            let centre = body.path.position(duration * f64::from(k) / 32.0);
            let sphere = scene.influence.sphere_radius(body.radius).min(2.0 * body.radius);
            low = low.min(centre - sphere);
            high = high.max(centre + sphere);
        }
    }
    let middle = 0.5 * (low + high);
    let size = (high - low).length();
    let direction = DVec3::new(-0.25, -1.0, 0.45).normalize();
    let eye = middle + direction * size * 0.62;
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
pub fn about(scene: &Scene, settings: &Settings, arrow_scale: f64) -> String {
    let (influence, thresholds) = (&scene.influence, &scene.thresholds);
    let steps = settings.steps.map_or("until stopped".to_owned(), |steps| format!("{steps} steps"));
    let head = format!(
        "**{}**: {} bodies, {} vertices. `{}`, Δt = {:.6} s, {steps}, a frame every {}.\n\n",
        scene.name,
        scene.bodies.len(),
        scene.vertex_count(),
        settings.integrator,
        settings.dt,
        if settings.every == 1 { "step".to_owned() } else { format!("{} steps", settings.every) },
    );
    let law = format!(
        "α = {}/s², β = {}/s², spheres {:.3} R. Merge at q = {}, split at {}{}; q is the centre distance over the sum of the radii.\n\n",
        influence.alpha,
        influence.beta,
        influence.reach,
        thresholds.merge_at,
        thresholds.split_at,
        if thresholds.core_at > 0.0 { format!(", core below {}", thresholds.core_at) } else { String::new() },
    );
    let spheres = format!(
        "Influence spheres and lanes: blue **{}**, orange **{}**, purple **{}**, grey: reaches nobody.\n\n",
        Phase::Apart,
        Phase::Merged,
        Phase::Core
    );
    let arrows = match settings.detail {
        Detail::Surface => "Force arrows were not recorded (`--detail forces`).\n\n".to_owned(),
        Detail::Forces => format!(
            "Force arrows ({} unit long per unit/s²): orange **attraction**, blue **repulsion**, red **push**; hidden at \
             first: green **restoring**, yellow **damping**, purple **carry** (own motion), white **net**.\n\n",
            arrow_scale
        ),
    };
    let bound = if scene.bodies.len() * scene.bodies.len().saturating_sub(1) / 2 > MOST_PAIRS {
        format!("The first {MOST_PAIRS} pairs that come within reach have plots and lanes; events list them all.\n")
    } else {
        String::new()
    };
    head + &law + &spheres + &arrows + &bound
}
