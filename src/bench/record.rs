//! Recording cost: frames per second and bytes per frame by detail and destination, compared with the payload itself and
//! with the same data recorded by the SDK's `log()`, one entity at a time; and the cost of verification: a checksum
//! beside its step, and a replay beside its run.

use std::{
    cell::RefCell,
    collections::HashSet,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use glam::DVec3;

use super::report::{Cell, Column, Report, Table};
use crate::{
    atomic,
    models::SceneRun,
    observe::{BodyFrame, Experiment as _, Frame, Schema, Simulation},
    recording::{
        Recorded,
        read::Reader,
        replay::{self, Verdict},
    },
    scene::Scene,
    sdk::{Arrows3D, Mesh3D, RecordingStream, RecordingStreamBuilder, RecordingStreamResult, Scalars, Transform3D},
    sim::{Options, World},
    stream::{
        Recorder, Settings,
        contract::{BODY, BODY_SURFACE, DIAGNOSTIC, FORCE},
        extract::{Arrows, Extractor, Surface},
        pipeline::send,
        record::{record, record_to},
        settings::{Detail, Frames},
        sinks::{Destinations, Serve, Sinks},
        step::{StepRecord, StepWatch},
    },
    text::{number, significant},
};

/// A measurement lasts at least this long; the scene is repeated as often as necessary.
const MIN_DURATION: Duration = Duration::from_millis(600);
/// Memory limit for precomputed frames [bytes].
const MAX_KEPT: usize = 256 << 20;
/// The best of this many runs counts in a verification, because other load only ever slows them down.
const RUNS: usize = 20;
/// A verification ends with the run during which it has taken this long.
const LONGEST_VERIFICATION: Duration = Duration::from_secs(10);

named! {
    /// Where frames are sent.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum Destination {
        /// Nowhere: frames are simulated only, or recorded and dropped.
        None = "none",
        /// A file.
        File = "file",
        /// A gRPC server on this machine.
        Server = "gRPC server",
        /// A file, by the SDK's `log()` for each entity.
        Log = "file, by log()",
    }
}

/// The cost of recording a scene in one way.
#[derive(Clone, Debug)]
pub struct Measurement {
    /// Name of the scene.
    pub scene: String,
    /// Number of bodies.
    pub bodies: usize,
    /// Level of detail.
    pub detail: Detail,
    /// Destination of the frames.
    pub destination: Destination,
    /// Whether the scene was simulated during the measurement; otherwise its states were computed beforehand.
    pub is_simulated: bool,
    /// Number of frames simulated or recorded.
    pub frames: u64,
    /// The time that this took [s].
    pub seconds: f64,
    /// Size of the file [bytes].
    pub bytes: Option<u64>,
    /// Size of the positions, normals and arrows of these frames [bytes].
    pub payload: u64,
    /// Number of entities in the recording.
    pub entities: Option<usize>,
}

/// The cost of verifying a scene.
#[derive(Clone, Debug)]
pub struct Verification {
    /// Name of the scene.
    pub scene: String,
    /// Mean time of a step [s].
    pub step: f64,
    /// Mean additional time of a step with its checksum [s].
    pub checksum: f64,
    /// Time to read the scene and simulate it [s].
    pub run: f64,
    /// Time to read a thin recording, simulate, and compare all checksums [s].
    pub replay: f64,
}

/// A recording in the system's temporary folder, which is removed in the end, or by an interrupt.
struct Temporary(PathBuf);

impl Temporary {
    fn new() -> Result<Temporary, String> {
        let name = atomic::unique_name("meldscope-bench-", ".rrd").map_err(|error| error.to_string())?;
        let file = std::env::temp_dir().join(name);
        atomic::add(&file);
        Ok(Temporary(file))
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        std::fs::remove_file(&self.0).ok();
    }
}

/// Measures a scene in every way.
///
/// # Errors
/// A description of what failed.
pub fn measure(scene: &Scene) -> Result<Vec<Measurement>, String> {
    let mut all = Vec::new();
    for detail in [Detail::Surface, Detail::Forces] {
        let bench = Bench::new(scene, detail)?;
        for is_simulated in [true, false] {
            for destination in Destination::ALL {
                if destination == Destination::Log && is_simulated {
                    continue;
                }
                all.push(bench.measure(destination, is_simulated)?);
            }
        }
    }
    Ok(all)
}

/// A scene and its precomputed states.
struct Bench<'a> {
    scene: &'a Scene,
    settings: Settings,
    schema: Schema,
    frames: Vec<(StepRecord, Frame)>,
    /// Payload of `frames` [bytes].
    payload: u64,
    file: Temporary,
}

impl Bench<'_> {
    fn new(scene: &Scene, detail: Detail) -> Result<Bench<'_>, String> {
        let settings = Settings { detail, ..Settings::of(scene) };
        let schema = scene.schema();
        let mut bench = Bench { scene, settings, schema, frames: Vec::new(), payload: 0, file: Temporary::new()? };
        let (mut world, mut kept) = (world(scene)?, 0);
        let mut watch = StepWatch::new(&world, &bench.settings);
        for _ in 0..scene.steps() {
            let (mut frame, mut step) = (Frame::default(), StepRecord::default());
            Simulation::step(&mut world, &mut step.summary);
            if let Some(failure) = &step.summary.failure {
                return Err(failure.to_string());
            }
            watch.step(&world, &bench.settings, &mut step, Some(&mut frame))?;
            kept += frame.memory();
            bench.payload += payload_of(&frame);
            bench.frames.push((step, frame));
            if kept > MAX_KEPT {
                break;
            }
        }
        Ok(bench)
    }

    fn measure(&self, destination: Destination, is_simulated: bool) -> Result<Measurement, String> {
        let destinations = match destination {
            Destination::File => Destinations::file(&self.file.0),
            Destination::Server => {
                let serve = Serve { web_port: 0, grpc_port: 0, ..Serve::default() };
                Destinations { serve: Some(serve), ..Destinations::default() }
            }
            Destination::None | Destination::Log => Destinations::default(),
        };
        let mut sinks = match destination {
            Destination::None | Destination::Log => None,
            _ => Some(Sinks::open(&destinations).map_err(|error| error.to_string())?),
        };
        let (mut frames, mut seconds, mut bytes, mut entities) = (0, 0.0, None, None);
        while seconds < MIN_DURATION.as_secs_f64() {
            let mut world = world(self.scene)?;
            let start = Instant::now();
            if destination == Destination::Log {
                let stream = self.log().map_err(|error| error.to_string())?;
                stream.flush_blocking().map_err(|error| error.to_string())?;
                let size = std::fs::metadata(&self.file.0).map_err(|error| error.to_string())?.len();
                bytes = Some(bytes.unwrap_or(0) + size);
            } else if is_simulated {
                match sinks.take() {
                    Some(open) => sinks = Some(self.simulate(world, open)?),
                    None => (0..self.frames.len()).for_each(|_| _ = world.step()),
                }
            } else {
                self.record(&world, sinks.as_mut())?;
            }
            seconds += start.elapsed().as_secs_f64();
            frames += self.frames.len() as u64;
        }
        if let Some(sinks) = sinks {
            let finished = sinks.finish().map_err(|error| error.to_string())?;
            bytes = finished.save.map(|saved| saved.bytes);
            entities = bytes.map(|_| entities_in(&self.file.0)).transpose()?;
        }
        let (scene, bodies, detail) = (self.scene.name.clone(), self.scene.bodies.len(), self.settings.detail);
        let payload = self.payload * frames / self.frames.len().max(1) as u64;
        Ok(Measurement { scene, bodies, detail, destination, is_simulated, frames, seconds, bytes, payload, entities })
    }

    /// Simulates and records as `run` does, until the operating system has all the data.
    fn simulate(&self, world: World, sinks: Sinks) -> Result<Sinks, String> {
        let recorded = record_to(Box::new(world), self.frames.len() as u64, self.settings.clone(), sinks);
        let (_, sinks) = recorded.map_err(|error| error.to_string())?;
        sinks.flush().map_err(|error| error.to_string())?;
        Ok(sinks)
    }

    /// Records the precomputed states.
    fn record(&self, world: &World, mut sinks: Option<&mut Sinks>) -> Result<(), String> {
        let mut recorder = Recorder::new(world, self.settings.clone())?;
        for (step, frame) in &self.frames {
            recorder.record(step, Some(frame));
            let messages = recorder.take_full();
            if let Some(sinks) = &mut sinks {
                send(sinks, messages).map_or(Ok(()), Err)?;
            }
        }
        recorder.finish();
        let messages = recorder.take();
        let Some(sinks) = sinks else { return Ok(()) };
        send(sinks, messages).map_or(Ok(()), Err)?;
        sinks.flush().map_err(|error| error.to_string())
    }

    /// Logs the precomputed states with the SDK: positions, normals and arrows, one entity at a time.
    fn log(&self) -> RecordingStreamResult<RecordingStream> {
        let (mut extractor, mut surface, mut origins) = (Extractor::default(), Surface::default(), Vec::new());
        let stream: RecordingStream =
            RecordingStreamBuilder::new("meldscope_bench").enabled(true).save(&self.file.0)?;
        for body in &self.schema.bodies {
            let mesh = Mesh3D::update_fields().with_triangle_indices(body.mesh.triangles().iter().copied());
            stream.log_static(BODY_SURFACE.of(&[&body.name]), &mesh)?;
        }
        for (step, frame) in &self.frames {
            stream.set_timepoint(step.summary.at.time_point());
            let mut arrows: Vec<Arrows> = self.schema.terms.iter().map(|_| Arrows::default()).collect();
            for (body, now) in self.schema.bodies.iter().zip(&frame.bodies) {
                let transform = Transform3D::from_translation_rotation(now.centre.as_vec3(), now.rotation.as_quat());
                stream.log(BODY.of(&[&body.name]), &transform)?;
                if !now.is_at_rest {
                    surface.clear();
                    surface.append_in_body(body, now, &mut extractor);
                    let mesh = Mesh3D::update_fields()
                        .with_vertex_positions(surface.positions.iter().copied())
                        .with_vertex_normals(surface.normals.iter().copied());
                    stream.log(BODY_SURFACE.of(&[&body.name]), &mesh)?;
                }
                if now.has_forces {
                    extractor.world_positions(body, now, &mut origins);
                    for (term, arrows) in now.terms.iter().zip(&mut arrows) {
                        arrows.append(&origins, None, &term.accelerations, self.schema.arrow_scale);
                    }
                }
            }
            if self.settings.detail == Detail::Forces {
                for (term, arrows) in self.schema.terms.iter().zip(&arrows) {
                    let batch = Arrows3D::update_fields()
                        .with_origins(arrows.origins.iter().copied())
                        .with_vectors(arrows.vectors.iter().copied());
                    stream.log(FORCE.of(&[term.name]), &batch)?;
                }
            }
            for (name, value) in [("energy", frame.scalars[0]), ("time", step.summary.at.time)] {
                stream.log(DIAGNOSTIC.of(&[name]), &Scalars::single(value))?;
            }
        }
        Ok(stream)
    }
}

fn world(scene: &Scene) -> Result<World, String> {
    World::new(scene.clone()).map_err(|error| error.to_string())
}

/// Size of the f32 positions and normals of bodies not at rest, and of non-zero arrows [bytes].
fn payload_of(frame: &Frame) -> u64 {
    let of_body = |now: &BodyFrame| {
        let arrows = now.terms.iter().flat_map(|term| term.accelerations.iter()).filter(|force| *force != DVec3::ZERO);
        2 * (now.positions.len() + arrows.count()) as u64
    };
    12 * frame.bodies.iter().map(of_body).sum::<u64>()
}

/// Number of entities in a recording.
fn entities_in(file: &Path) -> Result<usize, String> {
    let entities = RefCell::new(HashSet::new());
    let note = |entity: &str| {
        entities.borrow_mut().insert(entity.to_owned());
        false
    };
    let mut reader = Reader::open(file).map_err(|error| error.to_string())?;
    while reader.next(note).map_err(|error| error.to_string())?.is_some() {}
    Ok(entities.into_inner().len())
}

/// Measures the cost of verifying a scene. Takes the best time of each step with and without a checksum, because no whole
/// run is ever undisturbed; both include reading the clock, which cancels out in their difference.
///
/// # Errors
/// A description of what failed.
pub fn verify(scene: &Scene) -> Result<Verification, String> {
    let file = Temporary::new()?;
    let experiment = SceneRun { scene: scene.clone(), options: Options::default() };
    let settings = Settings { frames: Frames::Thin, ..Settings::of(scene) };
    let destinations = Destinations::file(&file.0);
    record(&experiment, settings, &destinations).map_err(|error| error.to_string())?;
    let mut best = vec![[f64::INFINITY; 2]; scene.steps() as usize];
    let (mut run, mut replay) = (f64::INFINITY, f64::INFINITY);
    let begin = Instant::now();
    for _ in 0..RUNS {
        if begin.elapsed() > LONGEST_VERIFICATION {
            break;
        }
        for has_checksum in [false, true] {
            let mut world = world(scene)?;
            for best in &mut best {
                let best = &mut best[usize::from(has_checksum)];
                let start = Instant::now();
                let _ = world.step();
                if has_checksum {
                    std::hint::black_box(world.checksum());
                }
                *best = best.min(start.elapsed().as_secs_f64());
            }
        }
        let start = Instant::now();
        let read = Scene::parse(&scene.source, &scene.name).map_err(|error| error.to_string())?;
        let mut world = world(&read)?;
        (0..scene.steps()).for_each(|_| _ = world.step());
        run = run.min(start.elapsed().as_secs_f64());
        let start = Instant::now();
        let recorded = Recorded::open(&file.0).map_err(|error| error.to_string())?;
        let verdict = replay::verify(&recorded, |_| true).map_err(|error| error.to_string())?;
        replay = replay.min(start.elapsed().as_secs_f64());
        if verdict != Verdict::Identical {
            return Err(format!("a replay of {} differs; this is a bug, please report it", scene.name));
        }
    }
    let [step, both] = [0, 1].map(|which| best.iter().map(|best| best[which]).sum::<f64>() / best.len() as f64);
    Ok(Verification { scene: scene.name.clone(), step, checksum: both - step, run, replay })
}

// --- results --------------------------------------------------------------------------------------------------------

/// The columns of the measurements.
pub fn columns() -> Vec<Column> {
    vec![
        Column::text("scene", "scene"),
        Column::count("", "bodies"),
        Column::text("detail", "detail"),
        Column::text("destination", "destination"),
        Column::text("simulated", "simulated"),
        Column::number("frames/s", "frames_per_s", number),
        Column::number("bytes/frame", "bytes_per_frame", number),
        Column::number("payload/frame", "payload_per_frame", number),
        Column::number("ratio", "bytes_per_payload", |ratio| format!("{ratio:.2}")),
        Column::count("entities", "entities"),
    ]
}

impl Measurement {
    fn row(&self) -> Vec<Cell> {
        let frames = self.frames as f64;
        let (bytes, payload) = (self.bytes.map(|bytes| bytes as f64), self.payload as f64);
        vec![
            self.scene.as_str().into(),
            self.bodies.into(),
            self.detail.name().into(),
            self.destination.name().into(),
            if self.is_simulated { "yes" } else { "no" }.into(),
            (frames / self.seconds).into(),
            bytes.map(|bytes| bytes / frames).into(),
            (payload / frames).into(),
            bytes.map(|bytes| bytes / payload).into(),
            self.entities.into(),
        ]
    }
}

/// The rates and sizes, and the cost of verification.
pub fn report(measurements: &[Measurement], verifications: &[Verification]) -> Report {
    let rates =
        Table { columns: columns(), rows: measurements.iter().map(Measurement::row).collect(), ..Table::default() };
    let verified = |it: &Verification| {
        let ratio = it.replay / it.run;
        let times = [1e6 * it.step, 1e6 * it.checksum, 1e3 * it.run, 1e3 * it.replay, ratio].map(Cell::Number);
        std::iter::once(it.scene.as_str().into()).chain(times).collect()
    };
    let times = [
        ("step [µs]", "step_us"),
        ("checksum [µs]", "checksum_us"),
        ("simulated in [ms]", "run_ms"),
        ("verified in [ms]", "replay_ms"),
        ("ratio", "ratio"),
    ];
    let times = times.map(|(heading, name)| Column::number(heading, name, significant));
    let verification = Table {
        title: "replays of thin recordings".to_owned(),
        columns: std::iter::once(Column::text("scene", "scene")).chain(times).collect(),
        rows: verifications.iter().map(verified).collect(),
        ..Table::default()
    };
    Report {
        file: Some(rates.clone()),
        tables: vec![rates, verification],
        notes: "payload: positions, normals and arrows; simulated: steps and recording together, otherwise recording alone;\n\
                log(): positions, normals and arrows without surfaces of groups, pairs and events"
            .to_owned(),
        ..Report::default()
    }
}
