//! The parts of a layout: containers and views, each an entity of the blueprint store with its own id.

use glam::DVec3;

use super::{
    camera::{Arrangement, Framing, camera_past},
    plots::Plot,
};
use crate::{
    observe::Schema,
    sdk::{
        AsComponents, BlueprintActivationCommand, LogMsg, Mesh3D, StoreId, StoreKind, TimePoint,
        blueprint::{
            archetypes::{
                ActiveVisualizers, Background, ContainerBlueprint, LineGrid3D, PanelBlueprint, PlotLegend, ScalarAxis,
                TextLogColumns, TimeAxis, TimePanelBlueprint, ViewBlueprint, ViewContents, ViewportBlueprint,
                VisualBounds2D, VisualizerInstruction,
            },
            components::{
                AbsoluteTimeRange, BackgroundKind, ContainerKind, Corner2D, LinkAxis, LoopMode, PanelState, PlayState,
                TimelineColumn, VisualizerInstructionId,
            },
            datatypes::{ComponentSourceKind, TextLogColumn, TextLogColumnKind, VisualizerComponentMapping},
        },
        components::{Plane3D, Range1D},
        datatypes::{self, Uuid},
    },
    stream::{
        chunks::{Chunks, blueprint_time},
        contract::{DRAWN, Entity, MARKS_ON_AXIS, RESTING, SIM_TIME, STAGE, WORLD},
        light, palette,
        parts::ranking,
        settings::{Entities, Settings},
    },
    text::round_numbers,
};

/// A line of a view's contents: an entity.
pub fn including(entity: &str) -> String {
    format!("+ {entity}")
}

/// A line of a view's contents: all entities of a family, and what is below them.
pub fn family(entity: &Entity) -> String {
    format!("+ {}/**", entity.family())
}

/// A plot of timings.
pub struct TimingsPlot {
    pub path: String,
    /// Whether its stages are those of recording.
    pub is_recording: bool,
    pub title: String,
}

/// A container or a view that has been logged.
pub struct Part {
    pub id: Uuid,
    pub path: String,
}

/// Source of a component of a visualizer.
#[derive(Clone, Copy, Debug)]
pub struct Mapping {
    /// The component of the visualizer.
    pub target: &'static str,
    /// The component of the entity that supplies it.
    pub source: &'static str,
}

/// The vertices of a mesh as points.
pub const VERTICES: Mapping = Mapping { target: "Points3D:positions", source: "Mesh3D:vertex_positions" };

/// A layout that is being made.
pub struct Layout {
    pub chunks: Chunks,
    next_id: u64,
    /// The plots of timings.
    pub timings: Vec<TimingsPlot>,
    /// The view of everything, with its title.
    pub scene: Option<(String, &'static str)>,
    /// The plot of speed.
    pub speeds: Option<String>,
    /// The plot of volumes.
    pub volumes: Option<String>,
    /// All plots over time.
    pub plots: Vec<Plot>,
    /// The plots of q.
    pub distances: Vec<String>,
    /// The plots of scalars, with their names.
    pub scalars: Vec<(String, &'static str)>,
    /// The plots of gaps, overlaps and necks, each with its measure.
    pub measures: Vec<(String, &'static Entity)>,
    /// The lanes of phases.
    pub phases: Vec<String>,
    /// Views of whether surfaces touch.
    pub contacts: Vec<String>,
    /// The view of each force term, with its name; none for terms that cannot act.
    pub forces: Vec<Option<(String, String)>>,
    /// The views in 3D, with their aspect ratios.
    pub spaces: Vec<(String, f64)>,
    /// The grid below everything visible, if there is one.
    pub ground: Option<Ground>,
    /// How the scene stands before the cameras.
    pub arrangement: Arrangement,
    /// The timeline that the viewer opens with.
    pub timeline: &'static str,
}

/// A horizontal grid below everything visible.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ground {
    /// Height [scene unit].
    height: f64,
    /// Distance between its lines [scene unit].
    spacing: f64,
}

impl Ground {
    /// The grid below these spheres (centre and radius).
    fn under(spheres: &[(DVec3, f64)], up: DVec3) -> Option<Ground> {
        let height = spheres.iter().map(|&(centre, radius)| centre.dot(up) - radius).fold(f64::INFINITY, f64::min);
        let largest = spheres.iter().map(|&(_, radius)| radius).fold(0.0, f64::max);
        let [least, two, five, _] = round_numbers(largest);
        let spacing = [five, two].into_iter().find(|&step| step <= largest).unwrap_or(least);
        (height.is_finite() && spacing.is_finite() && spacing > 0.0).then_some(Ground { height, spacing })
    }
}

impl Layout {
    /// An empty layout for a recording.
    pub fn of(recording: &StoreId) -> Layout {
        let id = format!("blueprint-{}", recording.recording_id().as_str());
        let store = StoreId::new(StoreKind::Blueprint, recording.application_id().clone(), id);
        Layout {
            chunks: Chunks::new(store),
            next_id: 0,
            timings: Vec::new(),
            scene: None,
            speeds: None,
            volumes: None,
            plots: Vec::new(),
            distances: Vec::new(),
            scalars: Vec::new(),
            measures: Vec::new(),
            phases: Vec::new(),
            contacts: Vec::new(),
            forces: Vec::new(),
            spaces: Vec::new(),
            ground: None,
            arrangement: Arrangement::default(),
            timeline: SIM_TIME,
        }
    }

    /// Opens the viewer in this interval of time [s], which it repeats: there is no other way to set its time cursor.
    pub fn open_at(&mut self, interval: [f64; 2]) {
        self.play(interval.map(|time| (1e9 * time) as i64), TimePanelBlueprint::update_fields());
    }

    /// Plays the stages from the first to the last in a loop, one per second.
    pub fn open_at_stages(&mut self, [first, last]: [u64; 2]) {
        self.play([first as i64, last as i64 + 1], TimePanelBlueprint::update_fields().with_fps(1.0));
    }

    fn play(&mut self, interval: [i64; 2], time_panel: TimePanelBlueprint) {
        let [min, max] = interval.map(Into::into);
        let time_panel = time_panel
            .with_time_selection(AbsoluteTimeRange::from(datatypes::AbsoluteTimeRange { min, max }))
            .with_loop_mode(LoopMode::Selection)
            .with_play_state(PlayState::Playing);
        self.log("time_panel", &time_panel);
    }

    /// Makes `root` the content of the whole window.
    pub fn finish(&mut self, root: Part) -> Vec<LogMsg> {
        self.log(
            "viewport",
            &ViewportBlueprint::new().with_root_container(root.id).with_auto_layout(false).with_auto_views(false),
        );
        for panel in ["blueprint_panel", "selection_panel"] {
            self.log(panel, &PanelBlueprint::new().with_state(PanelState::Collapsed));
        }
        let time_panel = TimePanelBlueprint::new().with_state(PanelState::Collapsed).with_timeline(self.timeline);
        // stages are looked at one by one
        let is_paused = self.timeline == STAGE;
        self.log("time_panel", &if is_paused { time_panel.with_play_state(PlayState::Paused) } else { time_panel });

        let messages = self.chunks.take();
        self.activate(messages)
    }

    /// Adds the command that makes the layout the active one.
    pub fn activate(&self, mut messages: Vec<LogMsg>) -> Vec<LogMsg> {
        let blueprint_id = self.chunks.store().clone();
        let activate = BlueprintActivationCommand { blueprint_id, make_active: true, make_default: true };
        messages.push(LogMsg::BlueprintActivationCommand(activate));
        messages
    }

    /// A container with these parts, which have these shares of its extent.
    pub fn container(&mut self, kind: ContainerKind, name: &str, parts: Vec<Part>, shares: &[f32]) -> Part {
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

    /// A view of a class of Rerun, with its contents as rules and its properties.
    pub fn view(
        &mut self,
        class: &str,
        name: &str,
        origin: &str,
        contents: &[String],
        properties: &[(&str, &dyn AsComponents)],
    ) -> Part {
        let (id, text) = self.id();
        let path = format!("view/{text}");
        let contents = ViewContents::new(contents.iter().map(String::as_str));
        self.log(&format!("{path}/ViewContents"), &contents);
        self.log(&path, &ViewBlueprint::new(class).with_display_name(name).with_space_origin(origin));
        for (property, components) in properties {
            self.log(&format!("{path}/{property}"), *components);
        }
        Part { id, path }
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

    /// Logs components of an entity of the blueprint store.
    pub fn log(&mut self, entity: &str, components: &dyn AsComponents) {
        let time: TimePoint = blueprint_time();
        self.chunks.row(entity, time, components);
    }

    /// A list of the lines of text of an entity and those below it.
    pub fn lines(&mut self, name: &str, entity: &str) -> Part {
        self.listed(name, entity, &[format!("+ {entity}/**")])
    }

    /// A list of lines of text.
    pub fn listed(&mut self, name: &str, entity: &str, contents: &[String]) -> Part {
        let columns = TextLogColumns::new()
            .with_timeline_columns(Vec::<TimelineColumn>::new())
            .with_text_log_columns([TextLogColumn { kind: TextLogColumnKind::Body, visible: true.into() }]);
        self.view("TextLog", name, entity, contents, &[("TextLogColumns", &columns)])
    }

    /// A plot over time, with the events as markers on its axis.
    pub fn plot(&mut self, name: &str, origin: &str, contents: &[String], corner: Corner2D) -> Part {
        self.time_series(name, origin, &[contents, &[family(&MARKS_ON_AXIS)]].concat(), corner)
    }

    /// A plot over time. All plots and lanes share one time range.
    pub fn time_series(&mut self, name: &str, origin: &str, contents: &[String], corner: Corner2D) -> Part {
        let legend = PlotLegend::new().with_corner(corner);
        let axis = TimeAxis::new().with_link(LinkAxis::LinkToGlobal);
        let view = self.view("TimeSeries", name, origin, contents, &[("PlotLegend", &legend), ("TimeAxis", &axis)]);
        self.plots.push(Plot { path: view.path.clone(), contents: contents.to_vec(), corner, range: None });
        view
    }

    /// Lanes of states over time, on the time range of all plots.
    pub fn lanes(&mut self, name: &str, origin: &str, contents: &[String]) -> Part {
        let axis = TimeAxis::new().with_link(LinkAxis::LinkToGlobal);
        self.view("StateTimeline", name, origin, contents, &[("TimeAxis", &axis)])
    }

    /// Hides the legend of a plot.
    pub fn hide_legend(&mut self, plot: &Part) {
        self.log(&format!("{}/PlotLegend", plot.path), &PlotLegend::new().with_visible(false));
    }

    /// Rows with labels and bars, as many as fit.
    pub fn ranking(&mut self, title: &str, path: &str) -> Part {
        self.ranking_of(ranking::ROWS, title, path)
    }

    /// So many rows with labels and bars.
    pub fn ranking_of(&mut self, rows: usize, title: &str, path: &str) -> Part {
        let [left, right, top, bottom] = ranking::bounds(rows);
        let range = datatypes::Range2D { x_range: [left, right].into(), y_range: [top, bottom].into() };
        self.view("2D", title, path, &[including(path)], &[("VisualBounds2D", &VisualBounds2D::new(range))])
    }

    /// Replaces the contents of a view.
    pub fn set_contents(&mut self, view: &str, contents: Vec<String>) {
        self.log(&format!("{view}/ViewContents"), &ViewContents::new(contents.iter().map(String::as_str)));
        if let Some(plot) = self.plots.iter_mut().find(|known| known.path == view) {
            plot.contents = contents;
        }
    }

    /// Sets how the scene stands before the cameras, and the ground below these spheres (centre and radius); planes have their own
    /// grids.
    pub fn set_arrangement(&mut self, schema: &Schema, spheres: &[(DVec3, f64)]) {
        self.arrangement = Arrangement::of(schema);
        self.ground = Ground::under(spheres, schema.up).filter(|_| schema.planes.is_empty());
    }

    /// Sets the ends of the axis of values of a plot.
    pub fn set_range(&mut self, plot: &str, [low, high]: [f64; 2]) {
        self.log(&format!("{plot}/ScalarAxis"), &ScalarAxis::new().with_range(Range1D::new(low, high)));
        if let Some(plot) = self.plots.iter_mut().find(|known| known.path == plot) {
            plot.range = Some([low, high]);
        }
    }

    /// A 3D view.
    pub fn space(&mut self, (spheres, aspect): Framing<'_>, name: &str, contents: &[String]) -> Part {
        let grid = match self.ground {
            None => LineGrid3D::new().with_visible(false),
            Some(Ground { height, spacing }) => LineGrid3D::new()
                .with_visible(true)
                .with_plane(Plane3D::new((self.arrangement.upright.conjugate() * DVec3::Z).as_vec3(), height as f32))
                .with_spacing(spacing as f32)
                .with_stroke_width(1.0)
                .with_color(palette::color(palette::GROUND)),
        };
        let background = Background::new(BackgroundKind::SolidColor).with_color(palette::color(palette::BACKGROUND));
        let camera = camera_past(spheres, &[], &[], aspect, self.arrangement);
        let properties: [(&str, &dyn AsComponents); 3] =
            [("EyeControls3D", &camera), ("LineGrid3D", &grid), ("Background", &background)];
        let view = self.view("3D", name, WORLD.path, contents, &properties);
        self.spaces.push((view.path.clone(), aspect));
        view
    }

    /// Draws the own surface of a body only while it is not part of a merged one.
    pub fn draw_unmerged(&mut self, view: &Part, surface: &str, overrides: &dyn AsComponents) {
        let drawn = Mapping { target: "Mesh3D:triangle_indices", source: DRAWN.0 };
        self.visualize(&view.path, surface, &[("Mesh3D", &[drawn, light::COLORS, light::NO_LIGHT], overrides)]);
    }

    /// Draws a surface with its baked lighting.
    pub fn draw_lit(&mut self, view: &Part, surface: &str, overrides: &dyn AsComponents) {
        let mappings = [light::COLORS, light::NO_LIGHT];
        self.visualize(&view.path, surface, &[("Mesh3D", &mappings, overrides)]);
    }

    /// Draws the undeformed bodies of a batched scene with baked lighting.
    pub fn draw_resting(&mut self, view: &Part, schema: &Schema, settings: &Settings) {
        if settings.entities == Entities::Batch {
            for shape in schema.shapes().keys() {
                self.draw_lit(view, &RESTING.of(&[shape]), &Mesh3D::update_fields());
            }
        }
    }

    /// Replaces the default visualizers of an entity in a view.
    pub fn visualize(&mut self, view: &str, entity: &str, visualizers: &[(&str, &[Mapping], &dyn AsComponents)]) {
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
}
