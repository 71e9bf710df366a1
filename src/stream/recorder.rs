//! Which entities a recording has, and when each is logged: the contract of the README's entity table.
//!
//! What did not change is not logged again; the viewer's latest-at query holds it. Lines of plots therefore hold their
//! value until the next one (`StepAfter`), and get one more point at the end of the run.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::time::{Duration, Instant as Clock};

use glam::{DVec3, Vec3};
use rerun::{
    AnyValues, Arrows3D, Color, Ellipsoids3D, InstancePoses3D, Mesh3D, Scalars, SeriesLines, StateChange,
    StateConfiguration, StoreId, StoreKind, TextDocument, TextLog, Transform3D, ViewCoordinates,
    components::{FillMode, InterpolationMode, MediaType, Text},
    external::re_log_types::{ApplicationId, LogMsg},
};

use super::{
    blueprint,
    chunks::{Chunks, Instant},
    extract::{Arrows, Surface},
    palette::{self, Rgb},
};
use crate::{
    model::phase::Phase,
    scene::{Integrator, Scene, Sphere},
    sim::{BodyForces, Cause, Event, Stage, World},
};

/// More bodies than this are batched: the viewer slows down at several hundred entities.
const MOST_BODY_ENTITIES: usize = 64;
/// More pairs than this get no plots of their own; their events are logged all the same.
pub const MOST_PAIRS: usize = 16;
/// A body displaced by less than this much of its radius is drawn with the resting ones.
const DEFORMED: f64 = 1e-6;
/// Threshold lines get a point at least every so many frames, so that they keep up with a live plot.
const THRESHOLD_FRAMES: u64 = 64;

/// How much is recorded of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Detail {
    /// Surfaces, spheres, pairs, events, timings, diagnostics.
    Surface,
    /// Those, and force arrows by cause.
    Forces,
}

/// One entity a body, or all bodies in few.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Entities {
    /// `/world/bodies/NAME` each.
    Body,
    /// `/world/resting/SHAPE` and `/world/deforming`.
    Batch,
}

/// The settings of a run, resolved: with the scene's text, what it takes to make a recording again.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// How steps are taken.
    pub integrator: Integrator,
    /// Step Δt [s].
    pub dt: f64,
    /// Number of steps to take; `None`: until stopped.
    pub steps: Option<u64>,
    /// A frame is recorded every so many steps, ≥ 1.
    pub every: u64,
    /// How much is recorded of a frame.
    pub detail: Detail,
    /// One entity a body, or all bodies in few.
    pub entities: Entities,
}

impl Settings {
    /// The settings that the scene itself asks for, everything recorded.
    pub fn of(scene: &Scene) -> Settings {
        Settings {
            integrator: scene.integrator,
            dt: scene.dt,
            steps: Some(scene.steps()),
            every: 1,
            detail: Detail::Forces,
            entities: if scene.bodies.len() > MOST_BODY_ENTITIES { Entities::Batch } else { Entities::Body },
        }
    }

    /// As TOML, for the recording's properties.
    pub fn to_toml(&self) -> String {
        let detail = match self.detail {
            Detail::Surface => "surface",
            Detail::Forces => "forces",
        };
        let entities = match self.entities {
            Entities::Body => "body",
            Entities::Batch => "batch",
        };
        format!(
            "integrator = \"{}\"\ndt = {:?}\nsteps = {}\nevery = {}\ndetail = \"{detail}\"\nentities = \"{entities}\"\n",
            self.integrator,
            self.dt,
            self.steps.unwrap_or(0),
            self.every,
        )
    }
}

/// Turns a world, step by step, into the messages of a recording.
pub struct Recorder {
    settings: Settings,
    /// [scene unit per scene unit/s²]
    arrow_scale: f64,
    chunks: Chunks,
    triangles: HashMap<Sphere, Vec<[u32; 3]>>,
    bodies: Vec<BodyTrack>,
    batch: BatchTrack,
    spheres: (Vec<Vec3>, Vec<Rgb>),
    arrows: [Arrows; Cause::ALL.len()],
    forces: BodyForces,
    pairs: BTreeMap<(usize, usize), PairTrack>,
    distant_pairs: HashSet<(usize, usize)>,
    series: BTreeMap<String, Series>,
    frames: u64,
    stage_time: [Duration; Stage::ALL.len()],
    log_time: Duration,
    steps_since_frame: u32,
}

/// What was last logged of a body.
#[derive(Default)]
struct BodyTrack {
    centre: Option<Vec3>,
    surface: Surface,
    next: Surface,
}

/// What was last logged of the bodies together.
#[derive(Default)]
struct BatchTrack {
    deforming: Vec<usize>,
    surface: Surface,
    next: Surface,
    resting: Option<Vec<(usize, Vec3)>>,
}

/// A pair that has entities of its own.
struct PairTrack {
    name: String,
    in_reach: bool,
    thresholds_at: u64,
}

/// A line of a plot.
struct Series {
    value: f64,
    /// When the value was last logged, and when it was last seen to be still the same.
    logged: Instant,
    seen: Instant,
}

impl Recorder {
    /// Begins a recording: its properties, everything static, the blueprint, and the world as it is.
    pub fn new(world: &World, settings: Settings) -> Recorder {
        let scene = world.scene();
        // A viewer keeps one layout an application: each scene is one, so that layouts do not replace each other's.
        let application = ApplicationId::new_or_unknown(format!("meldscope_{}", file_stem(&scene.name)));
        let id = recording_id(scene, &settings);
        let mut recorder = Recorder {
            arrow_scale: arrow_scale(scene),
            chunks: Chunks::new(StoreId::new(StoreKind::Recording, application, id)),
            triangles: scene.bodies.iter().map(|body| (body.shape, body.shape.triangles())).collect(),
            bodies: scene.bodies.iter().map(|_| BodyTrack::default()).collect(),
            batch: BatchTrack::default(),
            spheres: Default::default(),
            arrows: Default::default(),
            forces: BodyForces::default(),
            pairs: BTreeMap::new(),
            distant_pairs: HashSet::new(),
            series: BTreeMap::new(),
            frames: 0,
            stage_time: Default::default(),
            log_time: Duration::ZERO,
            steps_since_frame: 0,
            settings,
        };
        recorder.log_properties(scene, recorder.settings.steps);
        recorder.log_statics(scene);
        recorder.frame(world);
        recorder
    }

    /// The messages since the last call, for the sinks. The first ones are those of the blueprint.
    pub fn take(&mut self) -> Vec<LogMsg> {
        let start = Clock::now();
        let messages = self.chunks.take();
        self.log_time += start.elapsed();
        messages
    }

    /// The layout that the viewer opens with, to be sent before anything else.
    pub fn blueprint(&self, world: &World) -> Vec<LogMsg> {
        blueprint::messages(world, &self.settings, self.chunks.store())
    }

    /// Number of frames recorded so far.
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// Adds time that the caller spent on bringing messages to their sinks, for `/timings/log`.
    pub fn add_log_time(&mut self, time: Duration) {
        self.log_time += time;
    }

    /// Looks at the world after a step: its events always, a frame if it is the turn of one.
    pub fn observe(&mut self, world: &World) {
        let report = world.report();
        self.steps_since_frame += 1;
        for (sum, spent) in self.stage_time.iter_mut().zip(report.timings) {
            *sum += spent;
        }
        for event in &report.events {
            self.log_event(world, event);
        }
        if world.steps_taken() % self.settings.every == 0 {
            self.frame(world);
        }
    }

    /// Ends the recording: lines reach its end, properties say how many steps there are.
    pub fn finish(&mut self, world: &World) {
        let now = now(world);
        for track in self.pairs.values_mut().filter(|track| track.in_reach) {
            log_thresholds(&mut self.chunks, &mut self.series, world.scene(), track, now);
        }
        for (entity, series) in &mut self.series {
            if series.logged.step < series.seen.step {
                self.chunks.log(entity, series.seen, &Scalars::single(series.value));
            }
        }
        self.log_properties(world.scene(), Some(world.steps_taken()));
    }

    // ---- static ------------------------------------------------------------------------------------------------

    fn log_properties(&mut self, scene: &Scene, steps: Option<u64>) {
        let properties = AnyValues::default()
            .with_component::<Text>("scene", [scene.source.as_str()])
            .with_component::<Text>("settings", [self.settings.to_toml()])
            .with_component::<Text>("version", [env!("CARGO_PKG_VERSION")])
            .with_component::<Text>("integrator", [self.settings.integrator.name()])
            .with_component::<rerun::components::Scalar>("steps", [steps.unwrap_or(0) as f64]);
        self.chunks.log_static("/__properties/meldscope", &properties);
        self.chunks.log_static("/__properties", &rerun::RecordingInfo::new().with_name(scene.name.as_str()));
    }

    fn log_statics(&mut self, scene: &Scene) {
        self.chunks.log_static("/world", &ViewCoordinates::RIGHT_HAND_Z_UP());
        let about = TextDocument::new(blueprint::about(scene, &self.settings, self.arrow_scale));
        self.chunks.log_static("/about", &about.with_media_type(MediaType::MARKDOWN));

        let radii = scene.bodies.iter().map(|body| scene.influence.sphere_radius(body.radius) as f32);
        let spheres = Ellipsoids3D::update_fields()
            .with_half_sizes(radii.map(|r| [r, r, r]))
            .with_fill_mode(FillMode::MajorWireframe)
            .with_line_radii([rerun::Radius::new_ui_points(0.6)])
            .with_labels(scene.bodies.iter().map(|body| body.name.as_str()))
            .with_show_labels(scene.bodies.len() <= 8);
        self.chunks.log_static("/world/influence", &spheres);

        match self.settings.entities {
            Entities::Body => {
                for (index, body) in scene.bodies.iter().enumerate() {
                    let mesh = Mesh3D::update_fields()
                        .with_triangle_indices(self.triangles[&body.shape].iter().copied())
                        .with_albedo_factor(rgba(palette::body(index)));
                    self.chunks.log_static(&format!("/world/bodies/{}/surface", body.name), &mesh);
                }
            }
            Entities::Batch => {
                for (shape, triangles) in by_shape(&self.triangles) {
                    let unit: Vec<Vec3> = shape.unit_vertices().iter().map(|v| v.as_vec3()).collect();
                    let mesh = Mesh3D::new(unit.iter().copied())
                        .with_vertex_normals(unit)
                        .with_triangle_indices(triangles.iter().copied())
                        .with_albedo_factor(rgba(palette::IDLE_SPHERE));
                    self.chunks.log_static(&resting_entity(shape), &mesh);
                }
            }
        }
        if self.settings.detail == Detail::Forces {
            for cause in Cause::ALL {
                let style = Arrows3D::update_fields()
                    .with_colors([color(palette::cause(cause))])
                    .with_radii([rerun::Radius::new_ui_points(1.2)]);
                self.chunks.log_static(&force_entity(cause), &style);
            }
        }

        let mut line = |entity: String, name: &str, color: Rgb| {
            log_line_style(&mut self.chunks, &entity, name, color, 1.5);
        };
        for (i, stage) in TIMINGS.into_iter().enumerate() {
            line(format!("/timings/{stage}"), &format!("{stage} [ms]"), palette::line(i));
        }
        for (i, (name, label)) in DIAGNOSTICS.into_iter().enumerate() {
            line(format!("/diagnostics/{name}"), label, palette::line(i));
        }
    }

    // ---- frames ------------------------------------------------------------------------------------------------

    fn frame(&mut self, world: &World) {
        let start = Clock::now();
        let now = now(world);
        self.log_pairs(world, now);
        let mut extracting = Duration::ZERO;
        match self.settings.entities {
            Entities::Body => extracting += self.log_bodies(world, now),
            Entities::Batch => extracting += self.log_batch(world, now),
        }
        self.log_spheres(world, now);
        if self.settings.detail == Detail::Forces {
            extracting += self.log_forces(world, now);
        }
        self.log_diagnostics(world, now);
        self.log_timings(now, extracting);
        self.frames += 1;
        self.log_time += start.elapsed() - extracting;
    }

    /// One transform and one mesh a body; returns the time that extracting took.
    fn log_bodies(&mut self, world: &World, now: Instant) -> Duration {
        let mut extracting = Duration::ZERO;
        for (body, track) in world.bodies().zip(&mut self.bodies) {
            let entity = format!("/world/bodies/{}", body.name());
            let centre = body.centre().as_vec3();
            if track.centre != Some(centre) {
                self.chunks.log(&entity, now, &Transform3D::from_translation(centre));
                track.centre = Some(centre);
            }
            let start = Clock::now();
            track.next.clear();
            track.next.append(&body, DVec3::ZERO, &self.triangles[&body.scene().shape]);
            extracting += start.elapsed();
            if track.next != track.surface {
                std::mem::swap(&mut track.next, &mut track.surface);
                self.chunks.log(&format!("{entity}/surface"), now, &moved(&track.surface));
            }
        }
        extracting
    }

    /// All deformed bodies in one mesh, the others as instances of their shapes; returns the time of extracting.
    fn log_batch(&mut self, world: &World, now: Instant) -> Duration {
        let start = Clock::now();
        let (deforming, resting): (Vec<usize>, Vec<usize>) = (0..world.body_count())
            .partition(|&i| world.body(i).max_displacement() > DEFORMED * world.body(i).scene().radius);
        let batch = &mut self.batch;
        batch.next.clear();
        for &i in &deforming {
            let body = world.body(i);
            batch.next.append(&body, body.centre(), &self.triangles[&body.scene().shape]);
        }
        let resting: Vec<(usize, Vec3)> = resting.into_iter().map(|i| (i, world.body(i).centre().as_vec3())).collect();
        let extracting = start.elapsed();

        if deforming != batch.deforming {
            let (mut first, mut triangles, mut colors, mut names) = (0, vec![], vec![], vec![]);
            for &i in &deforming {
                let body = world.body(i);
                triangles.extend(self.triangles[&body.scene().shape].iter().map(|t| t.map(|v| v + first)));
                colors.extend(std::iter::repeat_n(color(palette::body(i)), body.vertex_count()));
                names.extend(std::iter::repeat_n(body.name(), body.vertex_count()));
                first += body.vertex_count() as u32;
            }
            let mesh = Mesh3D::update_fields().with_triangle_indices(triangles).with_vertex_colors(colors);
            self.chunks.log("/world/deforming/surface", now, &mesh);
            self.chunks.log("/world/deforming/surface", now, &body_names(&names));
            batch.deforming = deforming;
        }
        if batch.next != batch.surface {
            std::mem::swap(&mut batch.next, &mut batch.surface);
            self.chunks.log("/world/deforming/surface", now, &moved(&batch.surface));
        }
        if batch.resting.as_ref() != Some(&resting) {
            for shape in by_shape(&self.triangles).into_iter().map(|(shape, _)| shape) {
                let of_shape = |list: &[(usize, Vec3)]| -> Vec<(usize, Vec3)> {
                    list.iter().copied().filter(|&(i, _)| world.body(i).scene().shape == *shape).collect()
                };
                let instances = of_shape(&resting);
                if batch.resting.as_ref().is_some_and(|last| of_shape(last) == instances) {
                    continue;
                }
                let poses = InstancePoses3D::update_fields()
                    .with_translations(instances.iter().map(|&(_, centre)| centre))
                    .with_scales(instances.iter().map(|&(i, _)| Vec3::splat(world.body(i).scene().radius as f32)));
                let names: Vec<&str> = instances.iter().map(|&(i, _)| world.scene().bodies[i].name.as_str()).collect();
                self.chunks.log(&resting_entity(shape), now, &poses);
                self.chunks.log(&resting_entity(shape), now, &body_names(&names));
            }
            batch.resting = Some(resting);
        }
        extracting
    }

    /// Influence spheres, coloured by the deepest phase that each is in.
    fn log_spheres(&mut self, world: &World, now: Instant) {
        let centres: Vec<Vec3> = world.bodies().map(|body| body.centre().as_vec3()).collect();
        let mut phases: Vec<Option<Phase>> = vec![None; world.body_count()];
        for pair in world.pairs() {
            for i in [pair.a, pair.b] {
                let depth = |phase| [Phase::Apart, Phase::Merged, Phase::Core].iter().position(|&p| p == phase);
                if phases[i].is_none_or(|known| depth(pair.phase) > depth(known)) {
                    phases[i] = Some(pair.phase);
                }
            }
        }
        let colors: Vec<Rgb> = phases.iter().map(|p| p.map_or(palette::IDLE_SPHERE, palette::phase)).collect();
        let mut spheres = Ellipsoids3D::update_fields();
        let first = self.frames == 0;
        if first || centres != self.spheres.0 {
            spheres = spheres.with_centers(centres.iter().copied());
        }
        if first || colors != self.spheres.1 {
            spheres = spheres.with_colors(colors.iter().map(|&rgb| color(rgb)));
        }
        if first || (&centres, &colors) != (&self.spheres.0, &self.spheres.1) {
            self.chunks.log("/world/influence", now, &spheres);
            self.spheres = (centres, colors);
        }
    }

    /// One batch of arrows a cause; returns the time that extracting took.
    fn log_forces(&mut self, world: &World, now: Instant) -> Duration {
        let start = Clock::now();
        let mut next: [Arrows; Cause::ALL.len()] = Default::default();
        for (index, body) in world.bodies().enumerate() {
            if body.is_at_rest() && world.surroundings(index).is_idle() {
                continue;
            }
            world.forces(index, &mut self.forces);
            for cause in Cause::ALL {
                next[cause as usize].append(&body, &self.forces, cause, self.arrow_scale);
            }
        }
        let extracting = start.elapsed();
        for (cause, arrows) in Cause::ALL.into_iter().zip(next) {
            if arrows != self.arrows[cause as usize] {
                let batch = Arrows3D::update_fields()
                    .with_origins(arrows.origins.iter().copied())
                    .with_vectors(arrows.vectors.iter().copied());
                self.chunks.log(&force_entity(cause), now, &batch);
                self.arrows[cause as usize] = arrows;
            }
        }
        extracting
    }

    // ---- pairs and events ------------------------------------------------------------------------------------------

    fn log_pairs(&mut self, world: &World, now: Instant) {
        for track in self.pairs.values_mut() {
            track.in_reach = false;
        }
        for pair in world.pairs() {
            let Some(track) = self.track_pair(world, pair.a, pair.b, pair.phase, now) else { continue };
            track.in_reach = true;
            let name = track.name.clone();
            self.scalar(&format!("/pairs/{name}/distance"), pair.q, now);
        }
        for track in self.pairs.values_mut().filter(|track| track.in_reach) {
            if self.frames >= track.thresholds_at {
                log_thresholds(&mut self.chunks, &mut self.series, world.scene(), track, now);
                track.thresholds_at = self.frames + THRESHOLD_FRAMES;
            }
        }
    }

    /// The entities of a pair, made when it first comes within reach; `None` beyond [`MOST_PAIRS`].
    fn track_pair(&mut self, world: &World, a: usize, b: usize, phase: Phase, now: Instant) -> Option<&mut PairTrack> {
        let scene = world.scene();
        if !self.pairs.contains_key(&(a, b)) {
            if self.pairs.len() >= MOST_PAIRS {
                self.distant_pairs.insert((a, b));
                return None;
            }
            let name = pair_name(scene, a, b);
            let (first, second) = (&scene.bodies[a].name, &scene.bodies[b].name);
            let entity = |part: &str| format!("/pairs/{name}/{part}");
            let chunks = &mut self.chunks;
            let q_color = palette::line(6 - self.pairs.len() % 3);
            log_line_style(chunks, &entity("distance"), &format!("q {first}~{second}"), q_color, 2.0);
            let thresholds = &scene.thresholds;
            let mut threshold = |part: &str, label: &str, level: f64, color| {
                log_line_style(chunks, &entity(part), &format!("{label} {level}"), color, 1.0);
            };
            threshold("merge_at", "merge at", thresholds.merge_at, palette::MERGE_AT);
            threshold("split_at", "split at", thresholds.split_at, palette::SPLIT_AT);
            if thresholds.core_at > 0.0 {
                threshold("core_at", "core at", thresholds.core_at, palette::CORE_AT);
            }
            let phases = [Phase::Apart, Phase::Merged, Phase::Core];
            let lanes = StateConfiguration::new()
                .with_values(phases.map(Phase::name))
                .with_labels(phases.map(Phase::name))
                .with_colors(phases.map(|phase| color(palette::phase(phase))));
            self.chunks.log_static(&entity("phase"), &lanes);
            self.chunks.log(&entity("phase"), now, &StateChange::single(phase.name()));
            self.pairs.insert((a, b), PairTrack { name, in_reach: false, thresholds_at: 0 });
        }
        self.pairs.get_mut(&(a, b))
    }

    /// A log line and a change of lane, at the exact time of the event.
    fn log_event(&mut self, world: &World, event: &Event) {
        let (a, b) = (event.a as usize, event.b as usize);
        let at = Instant { step: event.step, time: event.time };
        let tracked = self.track_pair(world, a, b, event.from, at).map(|track| track.name.clone());
        if let Some(name) = tracked {
            self.chunks.log(&format!("/pairs/{name}/phase"), at, &StateChange::single(event.to.name()));
        }
        let line = TextLog::new(describe(world.scene(), event))
            .with_level(event.name())
            .with_color(color(palette::phase(event.to)));
        self.chunks.log("/events", at, &line);
    }

    // ---- numbers -----------------------------------------------------------------------------------------------

    fn log_diagnostics(&mut self, world: &World, now: Instant) {
        let energy = world.energy();
        let report = world.report();
        let displacement = world.bodies().map(|body| body.max_displacement() / body.scene().radius);
        let values = [
            energy.total(),
            displacement.fold(0.0, f64::max),
            energy.reached_vertices as f64,
            report.substeps as f64,
            world.bodies().filter(|body| body.is_at_rest()).count() as f64,
        ];
        for ((name, _), value) in DIAGNOSTICS.into_iter().zip(values) {
            self.scalar(&format!("/diagnostics/{name}"), value, now);
        }
    }

    /// Milliseconds per step since the last frame: the simulation's stages, and what looking at it cost.
    fn log_timings(&mut self, now: Instant, extracting: Duration) {
        if now.step > 0 {
            let steps = f64::from(self.steps_since_frame.max(1));
            let spent = self.stage_time.into_iter().chain([extracting, self.log_time]);
            for (stage, time) in TIMINGS.into_iter().zip(spent) {
                let per_step = time.as_secs_f64() * 1e3 / steps;
                self.chunks.log(&format!("/timings/{stage}"), now, &Scalars::single(per_step));
            }
        }
        (self.stage_time, self.log_time, self.steps_since_frame) = (Default::default(), Duration::ZERO, 0);
    }

    /// A point of a line, if the value changed.
    fn scalar(&mut self, entity: &str, value: f64, now: Instant) {
        log_scalar(&mut self.chunks, &mut self.series, entity, value, now, false);
    }
}

/// The stages in `/timings`: those of [`Stage`], then what recording costs.
const TIMINGS: [&str; 5] = [Stage::ALL[0].name(), Stage::ALL[1].name(), Stage::ALL[2].name(), "extract", "log"];

/// The entities in `/diagnostics`, and what their lines are called.
const DIAGNOSTICS: [(&str, &str); 5] = [
    ("energy", "energy [unit²/s²]"),
    ("max_displacement", "largest displacement [radii]"),
    ("reached_vertices", "vertices inside a sphere"),
    ("substeps", "sub-steps, all bodies"),
    ("sleeping_bodies", "bodies at rest"),
];

fn now(world: &World) -> Instant {
    Instant { step: world.steps_taken(), time: world.time() }
}

fn log_scalar(
    chunks: &mut Chunks,
    series: &mut BTreeMap<String, Series>,
    entity: &str,
    value: f64,
    now: Instant,
    again: bool,
) {
    match series.get_mut(entity) {
        Some(series) if series.value == value && !again => series.seen = now,
        known => {
            chunks.log(entity, now, &Scalars::single(value));
            let next = Series { value, logged: now, seen: now };
            match known {
                Some(series) => *series = next,
                None => {
                    series.insert(entity.to_owned(), next);
                }
            }
        }
    }
}

/// A point of each threshold line of a pair.
fn log_thresholds(
    chunks: &mut Chunks,
    series: &mut BTreeMap<String, Series>,
    scene: &Scene,
    track: &PairTrack,
    now: Instant,
) {
    let thresholds = &scene.thresholds;
    let all = [("merge_at", thresholds.merge_at), ("split_at", thresholds.split_at), ("core_at", thresholds.core_at)];
    for (part, level) in all.into_iter().filter(|&(part, level)| part != "core_at" || level > 0.0) {
        log_scalar(chunks, series, &format!("/pairs/{}/{part}", track.name), level, now, true);
    }
}

fn log_line_style(chunks: &mut Chunks, entity: &str, name: &str, rgb: Rgb, width: f32) {
    let style = SeriesLines::new()
        .with_names([name])
        .with_colors([color(rgb)])
        .with_widths([width])
        .with_interpolation_mode(InterpolationMode::StepAfter);
    chunks.log_static(entity, &style);
}

/// Positions and normals of a surface that moved.
fn moved(surface: &Surface) -> Mesh3D {
    Mesh3D::update_fields()
        .with_vertex_positions(surface.positions.iter().copied())
        .with_vertex_normals(surface.normals.iter().copied())
}

/// Says on selection which body a vertex or an instance is.
fn body_names(names: &[&str]) -> AnyValues {
    AnyValues::default().with_component::<Text>("body", names.iter().copied())
}

fn by_shape(triangles: &HashMap<Sphere, Vec<[u32; 3]>>) -> Vec<(&Sphere, &Vec<[u32; 3]>)> {
    let mut shapes: Vec<_> = triangles.iter().collect();
    shapes.sort_by_key(|(shape, _)| (shape.stacks, shape.slices));
    shapes
}

fn resting_entity(shape: &Sphere) -> String {
    format!("/world/resting/sphere_{}x{}", shape.stacks, shape.slices)
}

fn force_entity(cause: Cause) -> String {
    format!("/world/forces/{}", cause.name())
}

/// The name of a pair: `A~B`, in the order of the scene.
pub fn pair_name(scene: &Scene, a: usize, b: usize) -> String {
    format!("{}~{}", scene.bodies[a].name, scene.bodies[b].name)
}

/// An event in words: what, which pair, exactly when, at which q, felt by which step.
pub fn describe(scene: &Scene, event: &Event) -> String {
    let pair = pair_name(scene, event.a as usize, event.b as usize);
    format!("{} {pair} at t = {:.9} s, q = {:.6}, step {}", event.name(), event.time, event.q, event.step)
}

fn color([r, g, b]: Rgb) -> Color {
    Color::from_rgb(r, g, b)
}

fn rgba([r, g, b]: Rgb) -> rerun::Rgba32 {
    rerun::Rgba32::from_rgb(r, g, b)
}

/// Length of an arrow per acceleration [scene unit per scene unit/s²]: 1, 2 or 5 times a power of ten, such that the
/// strongest influence or push on the largest body is drawn about 0.4 of its radius long.
pub fn arrow_scale(scene: &Scene) -> f64 {
    let radius = scene.bodies.iter().map(|body| body.radius).fold(0.0, f64::max);
    let strength = scene.influence.alpha.max(scene.influence.beta);
    let pull = strength * scene.influence.sphere_radius(radius) * scene.influence.weight.max_pull();
    let strongest = scene.pushes.iter().map(|push| push.strength.abs()).fold(pull, f64::max);
    let wanted = 0.4 * radius / strongest;
    if !(wanted.is_finite() && wanted > 0.0) {
        return 0.01;
    }
    let decade = 10f64.powf(wanted.log10().floor());
    let step = [5.0, 2.0, 1.0].into_iter().find(|step| step * decade <= wanted * 1.0001).unwrap_or(1.0);
    step * decade
}

/// The same scene and options give the same id: FNV-1a of both.
fn recording_id(scene: &Scene, settings: &Settings) -> String {
    let text = format!("{}\0{}\0{}", scene.source, settings.to_toml(), env!("CARGO_PKG_VERSION"));
    let hash = text
        .bytes()
        .fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3));
    format!("{}-{hash:016x}", file_stem(&scene.name))
}

/// The name of a scene as a file can have it: anything but letters, digits, `-`, `_` and `.` inside becomes `_`.
pub fn file_stem(name: &str) -> String {
    let plain = |c: char| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '_' };
    let stem: String = name.chars().map(plain).take(100).collect();
    let stem = stem.trim_start_matches('.');
    if stem.is_empty() { "scene".to_owned() } else { stem.to_owned() }
}
