//! Which entities a recording has, and when each is logged: the contract of the README's entity table.
//!
//! What did not change is not logged again; the viewer's latest-at query holds it. Lines of plots therefore hold their
//! value until the next one (`StepAfter`), and get one more point at the end of the run.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::time::{Duration, Instant as Clock};

use glam::{DVec3, Vec3};
use rerun::{
    AnyValues, Arrows3D, AsComponents, Ellipsoids3D, InstancePoses3D, Mesh3D, Scalars, StateChange, StateConfiguration,
    StoreId, StoreKind, TextDocument, TextLog, Transform3D, ViewCoordinates,
    components::{FillMode, MediaType, Text},
    external::re_log_types::{ApplicationId, LogMsg},
};

pub use super::settings::{Detail, Entities, MOST_PAIRS, Settings, arrow_scale, file_stem};
use super::settings::{FORMAT, Frames, recording_id};
use super::{
    blueprint,
    checksums::Checksums,
    chunks::{Chunks, Instant},
    extract::{Arrows, Surface, smooth_normals},
    flight::FlightRecorder,
    machine,
    palette::{self, Rgb, color},
    series::{Series, Shape},
};
use crate::{
    model::phase::{Phase, Thresholds},
    scene::{Scene, Sphere},
    sim::{BodyForces, Cause, Event, Stage, World},
};

/// A body displaced by less than this much of its radius is drawn with the resting ones.
pub const DEFORMED: f64 = 1e-6;
/// Threshold lines get a point at least every so many frames, so that they keep up with a live plot.
const THRESHOLD_FRAMES: u64 = 64;

/// Turns a world, step by step, into the messages of a recording.
pub struct Recorder {
    settings: Settings,
    /// [scene unit per scene unit/s²]
    arrow_scale: f64,
    chunks: Chunks,
    checksums: Checksums,
    flight: Option<FlightRecorder>,
    triangles: HashMap<Sphere, Vec<[u32; 3]>>,
    bodies: Vec<BodyTrack>,
    batch: BatchTrack,
    spheres: (Vec<Vec3>, Vec<Rgb>),
    arrows: [Arrows; Cause::ALL.len()],
    forces: BodyForces,
    /// Names of the pairs that have entities of their own.
    pairs: BTreeMap<(usize, usize), String>,
    pairs_in_reach: HashSet<(usize, usize)>,
    series: Series,
    /// Made, and of them those that are in the recording.
    frames: u64,
    written: u64,
    stage_time: [Duration; Stage::ALL.len()],
    steps_since_frame: u32,
    /// Steps of the integrator, and the largest error of a step, since the last frame.
    substeps: u64,
    error: f64,
    /// Since messages were last sent.
    log_time: Duration,
    steps_since_sent: u32,
    /// As it was when they were.
    log_time_per_step: Duration,
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

impl Recorder {
    /// Begins a recording: its properties, everything static, the blueprint, and the world as it is.
    pub fn new(world: &World, settings: Settings) -> Recorder {
        let scene = world.scene();
        // A viewer keeps one layout an application: each scene is one, so that layouts do not replace each other's.
        let application = ApplicationId::new_or_unknown(format!("meldscope_{}", file_stem(&scene.name)));
        let id = recording_id(&scene.name, &scene.source, &settings.to_toml(), env!("CARGO_PKG_VERSION"));
        let flight = match settings.frames {
            Frames::Last { most, .. } => Some(FlightRecorder::new(most)),
            Frames::All | Frames::Thin => None,
        };
        let mut recorder = Recorder {
            arrow_scale: arrow_scale(scene),
            chunks: Chunks::new(StoreId::new(StoreKind::Recording, application, id)),
            checksums: match settings.frames {
                Frames::Thin => Checksums::packed(scene.vertex_count()),
                Frames::All | Frames::Last { .. } => Checksums::by_step(),
            },
            flight,
            triangles: shapes(scene).into_iter().map(|shape| (shape, shape.triangles())).collect(),
            bodies: scene.bodies.iter().map(|_| BodyTrack::default()).collect(),
            batch: BatchTrack::default(),
            spheres: Default::default(),
            arrows: Default::default(),
            forces: BodyForces::default(),
            pairs: BTreeMap::new(),
            pairs_in_reach: HashSet::new(),
            series: Series::default(),
            frames: 0,
            written: 0,
            stage_time: Default::default(),
            steps_since_frame: 0,
            substeps: 0,
            error: 0.0,
            log_time: Duration::ZERO,
            steps_since_sent: 0,
            log_time_per_step: Duration::ZERO,
            settings,
        };
        recorder.log_properties(scene);
        recorder.log_steps(recorder.settings.steps);
        recorder.log_statics(scene);
        recorder.checksum(world);
        recorder.checksums.log(&mut recorder.chunks, true); // by itself: a run that is killed has at least this one
        recorder.frame(world);
        recorder.keep(world);
        recorder
    }

    /// The messages since the last call, for the sinks. The first ones are those of the blueprint.
    pub fn take(&mut self) -> Vec<LogMsg> {
        let start = Clock::now();
        self.checksums.log(&mut self.chunks, false);
        let messages = self.chunks.take();
        self.log_time += start.elapsed();
        messages
    }

    /// The layout that the viewer opens with, to be sent before anything else.
    pub fn blueprint(&self, world: &World) -> Vec<LogMsg> {
        match self.settings.frames {
            Frames::Thin => Vec::new(), // nothing to lay out
            _ => blueprint::messages(world, &self.settings, self.chunks.store()),
        }
    }

    /// Number of frames made so far.
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// Number of frames in the recording so far: a flight recorder makes more than it writes.
    pub fn written(&self) -> u64 {
        self.written
    }

    /// Adds time that the caller spent on bringing the messages last taken to their sinks. With what building them
    /// took it is `/timings/log`, spread over the steps that they came from.
    pub fn messages_sent(&mut self, time: Duration) {
        let steps = std::mem::take(&mut self.steps_since_sent).max(1);
        self.log_time_per_step = (std::mem::take(&mut self.log_time) + time) / steps;
    }

    /// Looks at the world after a step: its events always, a frame if it is the turn of one.
    pub fn observe(&mut self, world: &World) {
        let report = world.report();
        self.steps_since_frame += 1;
        self.steps_since_sent += 1;
        for (sum, spent) in self.stage_time.iter_mut().zip(report.timings) {
            *sum += spent;
        }
        self.substeps += report.substeps;
        self.error = self.error.max(report.error);
        self.checksum(world);
        if self.settings.frames == Frames::Thin {
            return;
        }
        for event in &report.events {
            self.log_event(world, event);
        }
        if world.steps_taken().is_multiple_of(self.settings.every) {
            self.frame(world);
        }
        self.keep(world);
    }

    /// Logs something of the caller's own at the world's instant.
    pub fn log(&mut self, entity: &str, world: &World, components: &dyn AsComponents) {
        self.chunks.log(entity, now(world), components);
    }

    /// Adds a text to the recording's properties.
    pub fn log_property(&mut self, name: &'static str, text: &str) {
        let property = AnyValues::default().with_component::<Text>(name, [text]);
        self.chunks.log_static("/__properties/meldscope", &property);
    }

    /// Logs the events of the last step as [`Recorder::observe`] does, for recordings that have no frames.
    pub fn log_events(&mut self, world: &World) {
        for event in &world.report().events {
            self.log_event_line(world, event);
        }
    }

    fn checksum(&mut self, world: &World) {
        let start = Clock::now();
        self.checksums.push(now(world), world.checksum());
        self.log_time += start.elapsed();
    }

    /// Takes what was logged of this step into the flight recorder, if there is one, and writes what that holds if this
    /// is a step that it waited for. Events and phases are always written.
    fn keep(&mut self, world: &World) {
        let (Some(flight), Frames::Last { on, .. }) = (&mut self.flight, &self.settings.frames) else { return };
        for chunk in self.chunks.drain() {
            let entity = chunk.entity_path().to_string();
            if entity == "/events" || (entity.starts_with("/pairs/") && entity.ends_with("/phase")) {
                self.chunks.send(chunk);
            } else {
                flight.push(chunk);
            }
        }
        if world.steps_taken().is_multiple_of(self.settings.every) {
            flight.end_frame();
        }
        if on.iter().any(|trigger| trigger.is_in(world.report())) {
            self.write_kept();
        }
    }

    /// Writes what the flight recorder holds.
    fn write_kept(&mut self) {
        if let Some(flight) = &mut self.flight {
            let (chunks, frames) = flight.take();
            chunks.into_iter().for_each(|chunk| self.chunks.send(chunk));
            self.written += frames;
        }
    }

    /// Ends the recording: lines reach its end, properties say how many steps there are.
    pub fn finish(&mut self, world: &World) {
        match &self.settings.frames {
            Frames::All => self.series.extend_all(&mut self.chunks),
            Frames::Last { on, .. } if on.is_empty() => {
                self.write_kept();
                self.series.extend_all(&mut self.chunks);
            }
            Frames::Thin | Frames::Last { .. } => {}
        }
        self.checksums.log(&mut self.chunks, true);
        self.log_property("digest", &format!("{:016x}", self.checksums.digest()));
        self.log_steps(Some(world.steps_taken()));
    }

    // ---- static ------------------------------------------------------------------------------------------------

    fn log_properties(&mut self, scene: &Scene) {
        let properties = AnyValues::default()
            .with_component::<Text>("scene", [scene.source.as_str()])
            .with_component::<Text>("settings", [self.settings.to_toml()])
            .with_component::<Text>("overrides", [self.settings.overrides(scene)])
            .with_component::<Text>("version", [env!("CARGO_PKG_VERSION")])
            .with_component::<rerun::components::Scalar>("format", [f64::from(FORMAT)])
            .with_component::<Text>("machine", [machine::describe()])
            .with_component::<Text>("integrator", [self.settings.integrator.name()]);
        self.chunks.log_static("/__properties/meldscope", &properties);
        self.chunks.log_static("/__properties", &rerun::RecordingInfo::new().with_name(scene.name.as_str()));
    }

    /// How many there are to be, and in the end how many there were.
    fn log_steps(&mut self, steps: Option<u64>) {
        let steps =
            AnyValues::default().with_component::<rerun::components::Scalar>("steps", [steps.unwrap_or(0) as f64]);
        self.chunks.log_static("/__properties/meldscope", &steps);
    }

    fn log_statics(&mut self, scene: &Scene) {
        self.chunks.log_static("/world", &ViewCoordinates::RIGHT_HAND_Z_UP());
        let about = TextDocument::new(blueprint::about(scene, &self.settings, self.arrow_scale));
        self.chunks.log_static("/about", &about.with_media_type(MediaType::MARKDOWN));
        if self.settings.frames == Frames::Thin {
            return;
        }

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
                    let unit = shape.unit_vertices();
                    let mut normals = vec![Vec3::ZERO; unit.len()];
                    smooth_normals(|i| unit[i], triangles, &mut normals);
                    let mesh = Mesh3D::new(unit.iter().map(|v| v.as_vec3()))
                        .with_vertex_normals(normals)
                        .with_triangle_indices(triangles.iter().copied())
                        .with_albedo_factor(rgba(palette::RESTING));
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

        for (i, stage) in TIMINGS.into_iter().enumerate() {
            let (entity, name) = (format!("/timings/{stage}"), format!("{stage} [ms]"));
            Series::style(&mut self.chunks, &entity, &name, palette::line(i), 1.5, Shape::Step);
        }
        for (i, (name, label, shape)) in DIAGNOSTICS.into_iter().enumerate() {
            Series::style(&mut self.chunks, &format!("/diagnostics/{name}"), label, palette::line(i), 1.5, shape);
        }
    }

    // ---- frames ------------------------------------------------------------------------------------------------

    fn frame(&mut self, world: &World) {
        if self.settings.frames == Frames::Thin {
            return;
        }
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
        self.written += u64::from(self.flight.is_none());
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
            if body.is_at_rest() && !track.surface.positions.is_empty() {
                continue;
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
        let idle = match self.settings.entities {
            Entities::Body => palette::IDLE_SPHERE,
            Entities::Batch => palette::IDLE_SPHERE_OF_MANY,
        };
        let colors: Vec<Rgb> = phases.iter().map(|p| p.map_or(idle, palette::phase)).collect();
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
        let mut in_reach = HashSet::new();
        for pair in world.pairs() {
            let Some(name) = self.track_pair(world, pair.a, pair.b, pair.phase, now) else { continue };
            let entity = |part: &str| format!("/pairs/{name}/{part}");
            self.series.log(&mut self.chunks, &entity("distance"), Shape::Linear, pair.q, now);
            for (part, _, level) in thresholds(world.scene()) {
                self.series.log(&mut self.chunks, &entity(part), Shape::Step, level, now);
                // A level line has nothing new to say, but should keep up with a plot that is looked at live.
                if self.frames.is_multiple_of(THRESHOLD_FRAMES) {
                    self.series.extend(&mut self.chunks, &entity(part));
                }
            }
            in_reach.insert((pair.a, pair.b));
        }
        let left: Vec<String> = self
            .pairs
            .iter()
            .filter(|(pair, _)| self.pairs_in_reach.contains(pair) && !in_reach.contains(pair))
            .map(|(_, name)| name.clone())
            .collect();
        for name in left {
            self.series.interrupt(&mut self.chunks, &format!("/pairs/{name}/distance"), now);
            for (part, _, _) in thresholds(world.scene()) {
                self.series.interrupt(&mut self.chunks, &format!("/pairs/{name}/{part}"), now);
            }
        }
        self.pairs_in_reach = in_reach;
    }

    /// The name of a pair, its entities made when it first comes within reach; `None` beyond [`MOST_PAIRS`].
    fn track_pair(&mut self, world: &World, a: usize, b: usize, phase: Phase, now: Instant) -> Option<String> {
        if let Some(name) = self.pairs.get(&(a, b)) {
            return Some(name.clone());
        }
        if self.pairs.len() >= MOST_PAIRS {
            return None;
        }
        let name = pair_name(world.scene(), a, b);
        let entity = |part: &str| format!("/pairs/{name}/{part}");
        let chunks = &mut self.chunks;
        let rgb = palette::distance(self.pairs.len());
        Series::style(chunks, &entity("distance"), &format!("q {name}"), rgb, 2.0, Shape::Linear);
        for (part, label, level) in thresholds(world.scene()) {
            let rgb = palette::threshold(part);
            Series::style(chunks, &entity(part), &format!("{label} {level}"), rgb, 1.0, Shape::Step);
        }
        let phases = [Phase::Apart, Phase::Merged, Phase::Core];
        let lane = StateConfiguration::new()
            .with_values(phases.map(Phase::name))
            .with_labels(phases.map(Phase::name))
            .with_colors(phases.map(|phase| color(palette::phase(phase))));
        chunks.log_static(&entity("phase"), &lane);
        chunks.log(&entity("phase"), now, &StateChange::single(phase.name()));
        self.pairs.insert((a, b), name.clone());
        Some(name)
    }

    /// A log line and a change of lane, at the exact time of the event.
    fn log_event(&mut self, world: &World, event: &Event) {
        let (a, b) = (event.a as usize, event.b as usize);
        let at = Instant { step: event.step, time: event.time };
        if let Some(name) = self.track_pair(world, a, b, event.from, at) {
            self.chunks.log(&format!("/pairs/{name}/phase"), at, &StateChange::single(event.to.name()));
        }
        self.log_event_line(world, event);
    }

    fn log_event_line(&mut self, world: &World, event: &Event) {
        let at = Instant { step: event.step, time: event.time };
        let line = TextLog::new(describe(world.scene(), event))
            .with_level(event.name())
            .with_color(color(palette::phase(event.to)));
        self.chunks.log("/events", at, &line);
    }

    // ---- numbers -----------------------------------------------------------------------------------------------

    fn log_diagnostics(&mut self, world: &World, now: Instant) {
        let energy = world.energy();
        let displacement = world.bodies().map(|body| body.max_displacement() / body.scene().radius);
        let values = [
            energy.total(),
            displacement.fold(0.0, f64::max),
            energy.reached_vertices as f64,
            std::mem::take(&mut self.substeps) as f64,
            std::mem::take(&mut self.error),
            world.bodies().filter(|body| body.is_at_rest()).count() as f64,
        ];
        for ((name, _, shape), value) in DIAGNOSTICS.into_iter().zip(values) {
            self.series.log(&mut self.chunks, &format!("/diagnostics/{name}"), shape, value, now);
        }
    }

    /// Milliseconds per step since the last frame: the simulation's stages, and what looking at it cost.
    fn log_timings(&mut self, now: Instant, extracting: Duration) {
        let steps = std::mem::take(&mut self.steps_since_frame).max(1);
        let stages = std::mem::take(&mut self.stage_time);
        if now.step == 0 {
            return;
        }
        let per_step = stages.into_iter().chain([extracting]).map(|time| time / steps);
        for (stage, time) in TIMINGS.into_iter().zip(per_step.chain([self.log_time_per_step])) {
            let milliseconds = time.as_secs_f64() * 1e3;
            self.chunks.log(&format!("/timings/{stage}"), now, &Scalars::single(milliseconds));
        }
    }
}

/// The stages in `/timings`: those of [`Stage`], then what recording costs.
const TIMINGS: [&str; 5] = [Stage::ALL[0].name(), Stage::ALL[1].name(), Stage::ALL[2].name(), "extract", "log"];

/// The entities in `/diagnostics`, what their lines are called, and how they are drawn.
const DIAGNOSTICS: [(&str, &str, Shape); 6] = [
    ("energy", "energy [unit²/s²]", Shape::Linear),
    ("max_displacement", "largest displacement [radii]", Shape::Linear),
    ("reached_vertices", "vertices inside a sphere", Shape::Step),
    ("substeps", "steps of the integrator", Shape::Step),
    ("estimated_error", "estimated error of the step [radii]", Shape::Step),
    ("sleeping_bodies", "bodies at rest", Shape::Step),
];

fn now(world: &World) -> Instant {
    Instant { step: world.steps_taken(), time: world.time() }
}

/// The thresholds that a scene has: entity, label, level of q.
fn thresholds(scene: &Scene) -> impl Iterator<Item = (&'static str, &'static str, f64)> + use<> {
    let Thresholds { merge_at, split_at, core_at } = scene.thresholds;
    let all = [
        ("merge_at", "merge at", merge_at),
        ("split_at", "split at", split_at), //
        ("core_at", "core at", core_at),
    ];
    all.into_iter().filter(move |&(part, _, _)| part != "core_at" || core_at > 0.0)
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

/// The shapes of a scene, each once.
fn shapes(scene: &Scene) -> HashSet<Sphere> {
    scene.bodies.iter().map(|body| body.shape).collect()
}

fn by_shape(triangles: &HashMap<Sphere, Vec<[u32; 3]>>) -> Vec<(&Sphere, &Vec<[u32; 3]>)> {
    let mut shapes: Vec<_> = triangles.iter().collect();
    shapes.sort_by_key(|(shape, _)| (shape.stacks, shape.slices));
    shapes
}

/// Where the undeformed bodies of a shape are if bodies are recorded together.
pub fn resting_entity(shape: &Sphere) -> String {
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

fn rgba([r, g, b]: Rgb) -> rerun::Rgba32 {
    rerun::Rgba32::from_unmultiplied_rgba(r, g, b, 150)
}
