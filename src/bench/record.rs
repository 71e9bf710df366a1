//! Recording cost: frames per second and bytes per frame, by detail and destination, compared with the payload itself
//! and with the same data recorded as a plain `log()` does, one entity at a time; the slow-down of steps, and the cost
//! of verification.
//!
//! # What bounds the frame rate
//! Instructions per simulated and saved frame of `two` with surfaces: the mean over its 300 frames, without the start
//! and the layout (callgrind, one thread; each byte of a long copy counts as one). In 115 of them the bodies are merged,
//! in 83 more they are within reach:
//!
//! | stage | instructions |
//! | --- | --- |
//! | unions | 0.77 M |
//! | gaps, overlaps and necks from them | 0.28 M |
//! | smooth seams | 0.22 M |
//! | boxes, gaps of bodies apart, meshes and components of the unions | 0.28 M |
//! | normals, colours and copies of the merged surface | 0.11 M |
//! | the bodies' own surfaces | 0.08 M |
//! | step, observation, search for touches | 0.18 M |
//! | encoding and writing, of which LZ4 0.22 M | 0.52 M |
//! | all | 2.5 M |
//!
//! A frame with a merged surface takes 3.5 M for that surface alone. Its triangles are the same as in the frame before
//! in 7 of 115 frames, so logging them only when they change would save nothing.

pub mod csv;
pub mod goals;
pub mod plain;
pub mod saving;
pub mod scenes;
pub mod table;
pub mod verifying;

use std::{
    cell::RefCell,
    collections::HashSet,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use glam::DVec3;

use plain::PlainLog;
use saving::{Saving, Way};
use verifying::Verifying;

use crate::{
    atomic,
    observe::{BodyFrame, Experiment as _, Frame, Schema},
    recording::read::Reader,
    scene::Scene,
    sdk::{Arrows3D, Mesh3D, Scalars, TimePoint, Transform3D},
    sim::World,
    stream::{
        Pipeline, Recorder, Settings,
        extract::{Arrows, Extractor, Surface},
        parts::forces,
        pipeline::send,
        settings::Detail,
        sinks::{Destinations, Serve, Sinks},
        step::{StepRecord, StepWatch},
    },
};

/// A measurement lasts at least this long; the scene is repeated as often as necessary.
const MIN_DURATION: Duration = Duration::from_millis(600);
/// Memory limit for precomputed frames [bytes].
const MAX_KEPT: usize = 256 << 20;

/// Where frames are sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Destination {
    /// Nowhere: frames are simulated only, or recorded and dropped.
    None,
    /// A file.
    File,
    /// A gRPC server on this machine.
    Server,
    /// A file, written as by the SDK's `log()` for each entity.
    PlainLog,
}

impl Destination {
    /// All destinations.
    pub const ALL: [Destination; 4] =
        [Destination::None, Destination::File, Destination::Server, Destination::PlainLog];

    /// The name used in tables.
    pub fn name(self) -> &'static str {
        match self {
            Destination::None => "none",
            Destination::File => "file",
            Destination::Server => "gRPC server",
            Destination::PlainLog => "file, plain log()",
        }
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
    /// Number of frames simulated or recorded …
    pub frames: u64,
    /// … and the time that this took [s].
    pub seconds: f64,
    /// Size of the file [bytes].
    pub bytes: Option<u64>,
    /// Size of the positions, normals and arrows of these frames [bytes].
    pub payload: u64,
    /// Number of entities in the recording.
    pub entities: Option<usize>,
}

impl Measurement {
    /// Frames per second.
    pub fn rate(&self) -> f64 {
        self.frames as f64 / self.seconds
    }
}

/// Costs other than frame rates and sizes.
#[derive(Clone, Debug)]
pub struct Costs {
    /// How much saving slows down steps.
    pub saving: Vec<Saving>,
    /// The cost of checksums and replays.
    pub verifying: Verifying,
}

/// All measurements.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// One entry per scene and way of recording.
    pub measurements: Vec<Measurement>,
    /// The other costs, if measured.
    pub costs: Option<Costs>,
}

/// Measures how much recording slows down steps, and the cost of verification. Temporary files go to `folder` and are
/// removed.
///
/// # Errors
/// A description of what failed.
pub fn measure_costs(folder: &Path) -> Result<Costs, String> {
    let file = file(folder)?;
    let saving = Way::ALL.into_iter().map(|way| saving::measure(way, &file)).collect::<Result<_, _>>()?;
    Ok(Costs { saving, verifying: verifying::measure(&file)? })
}

fn file(folder: &Path) -> Result<PathBuf, String> {
    let name = atomic::unique_name("meldscope-bench-", ".rrd").map_err(|error| error.to_string())?;
    let file = folder.join(name);
    atomic::add(&file);
    Ok(file)
}

/// Measures a scene in every way. Temporary files go to `folder` and are removed.
///
/// # Errors
/// A description of what failed.
pub fn measure(scene: &Scene, folder: &Path) -> Result<Vec<Measurement>, String> {
    let mut all = Vec::new();
    for detail in [Detail::Surface, Detail::Forces] {
        let bench = Bench::new(scene, detail, folder)?;
        for is_simulated in [true, false] {
            for destination in Destination::ALL {
                if destination == Destination::PlainLog && is_simulated {
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
    file: PathBuf,
}

impl Bench<'_> {
    fn new<'a>(scene: &'a Scene, detail: Detail, folder: &Path) -> Result<Bench<'a>, String> {
        let settings = Settings { detail, ..Settings::of(scene) };
        let schema = scene.schema();
        let mut bench = Bench { scene, settings, schema, frames: Vec::new(), payload: 0, file: file(folder)? };
        let (mut world, mut kept) = (bench.world()?, 0);
        for _ in 0..scene.steps() {
            if let Some(failure) = &world.step().failure {
                return Err(failure.to_string());
            }
            let mut frame = Frame::default();
            let mut step = StepRecord::default();
            StepWatch::default().step(&world, &bench.settings, &mut step, Some(&mut frame));
            kept += frame.memory();
            bench.payload += payload_of(&frame);
            bench.frames.push((step, frame));
            if kept > MAX_KEPT {
                break;
            }
        }
        Ok(bench)
    }

    fn world(&self) -> Result<World, String> {
        World::new(self.scene.clone()).map_err(|error| error.to_string())
    }

    fn measure(&self, destination: Destination, is_simulated: bool) -> Result<Measurement, String> {
        let destinations = match destination {
            Destination::File => Destinations { save: Some(self.file.clone()), ..Destinations::default() },
            Destination::Server => {
                let serve = Serve { web_port: 0, grpc_port: 0, ..Serve::default() };
                Destinations { serve: Some(serve), ..Destinations::default() }
            }
            Destination::None | Destination::PlainLog => Destinations::default(),
        };
        let mut sinks = match destination {
            Destination::None | Destination::PlainLog => None,
            _ => Some(Sinks::open(&destinations).map_err(|error| error.to_string())?),
        };
        let (mut frames, mut seconds, mut bytes, mut entities) = (0, 0.0, None, None);
        while seconds < MIN_DURATION.as_secs_f64() {
            let mut world = self.world()?;
            let start = Instant::now();
            if destination == Destination::PlainLog {
                bytes = Some(bytes.unwrap_or(0) + self.log_plainly()?);
            } else if is_simulated {
                match sinks.take() {
                    Some(open) => sinks = Some(self.simulate(&mut world, open)?),
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
            entities = bytes.map(|_| entities_in(&self.file)).transpose()?;
        }
        std::fs::remove_file(&self.file).ok();
        let (scene, bodies, detail) = (self.scene.name.clone(), self.scene.bodies.len(), self.settings.detail);
        let payload = self.payload * frames / self.frames.len().max(1) as u64;
        Ok(Measurement { scene, bodies, detail, destination, is_simulated, frames, seconds, bytes, payload, entities })
    }

    /// Simulates and records as `run` does, until the operating system has all the data.
    fn simulate(&self, world: &mut World, sinks: Sinks) -> Result<Sinks, String> {
        let recorder = Recorder::new(world, self.settings.clone());
        let mut pipeline = Pipeline::start(world, recorder, sinks).map_err(|error| error.to_string())?;
        for _ in 0..self.frames.len() {
            world.step();
            pipeline.observe(world, None)?;
        }
        let mut recorded = pipeline.finish()?;
        recorded.finish(world).map_or(Ok(()), Err)?;
        recorded.sinks.flush().map_err(|error| error.to_string())?;
        Ok(recorded.sinks)
    }

    /// Records the precomputed states.
    fn record(&self, world: &World, mut sinks: Option<&mut Sinks>) -> Result<(), String> {
        let mut recorder = Recorder::new(world, self.settings.clone());
        for (step, frame) in &self.frames {
            recorder.record(step, Some(frame));
            let messages = recorder.take_full();
            if let Some(sinks) = &mut sinks {
                send(sinks, messages).map_or(Ok(()), Err)?;
            }
        }
        self.end(&mut recorder, world, sinks)
    }

    fn end(&self, recorder: &mut Recorder, world: &World, sinks: Option<&mut Sinks>) -> Result<(), String> {
        recorder.finish(world);
        let messages = recorder.take();
        let Some(sinks) = sinks else { return Ok(()) };
        send(sinks, messages).map_or(Ok(()), Err)?;
        sinks.flush().map_err(|error| error.to_string())
    }

    /// Records the precomputed states as the SDK's `log()` does; returns the size of the file [bytes].
    fn log_plainly(&self) -> Result<u64, String> {
        let (mut extractor, mut surface, mut origins) = (Extractor::default(), Surface::default(), Vec::new());
        let log = PlainLog::save(&self.file)?;
        for body in &self.schema.bodies {
            let mesh = Mesh3D::update_fields().with_triangle_indices(body.mesh.triangles().iter().copied());
            log.log(&format!("world/bodies/{}/surface", body.name), TimePoint::STATIC, &mesh);
        }
        for (step, frame) in &self.frames {
            let at = || step.summary.at.time_point();
            let mut arrows: Vec<Arrows> = self.schema.terms.iter().map(|_| Arrows::default()).collect();
            for (body, now) in self.schema.bodies.iter().zip(&frame.bodies) {
                let entity = format!("world/bodies/{}", body.name);
                let transform = Transform3D::from_translation_rotation(now.centre.as_vec3(), now.rotation.as_quat());
                log.log(&entity, at(), &transform);
                if !now.is_at_rest {
                    surface.clear();
                    surface.append_in_body(body, now, &mut extractor);
                    let mesh = Mesh3D::update_fields()
                        .with_vertex_positions(surface.positions.iter().copied())
                        .with_vertex_normals(surface.normals.iter().copied());
                    log.log(&format!("{entity}/surface"), at(), &mesh);
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
                    log.log(&forces::entity(term.name), at(), &batch);
                }
            }
            for (name, value) in [("energy", frame.scalars[0]), ("time", step.summary.at.time)] {
                log.log(&format!("diagnostics/{name}"), at(), &Scalars::single(value));
            }
        }
        log.finish()?;
        std::fs::metadata(&self.file).map(|file| file.len()).map_err(|error| error.to_string())
    }
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
