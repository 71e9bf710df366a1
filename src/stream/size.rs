//! Predicts the size of a recording from a few sample frames, which are encoded and discarded. The choice of samples
//! depends on the scene and the settings alone, so that equal runs give equal predictions.

use std::io;

use super::{
    Recorder, Settings,
    blueprint::Tab,
    contract::{STACKED, TIMING},
    settings::{Detail, Frames},
};
use crate::observe::{Experiment, Frame, Run, Simulation, StepFailure, Want};
use crate::sdk::{CrateVersion, EncodeError, Encoder, EncodingOptions, LogMsg, StoreKind};

/// Recordings stay below this size unless requested otherwise [bytes].
pub const LARGE: u64 = 200_000_000;
/// Number of sample frames, spread over the run.
const SAMPLES: u64 = 24;
/// Number of sample frames if only the beginning of the run is simulated.
const MIN_SAMPLES: u64 = 4;
/// Upper limit on the simulation for the prediction, in steps times vertices: a second or two, for a run of minutes.
const MAX_VERTEX_STEPS: u64 = 1_500_000;
/// Maximum size of a deformed vertex in a frame [bytes]; with forces, and without.
const MAX_VERTEX_BYTES: [u64; 2] = [250, 90];
/// Typical minimum size of a deformed vertex in a frame [bytes].
const MIN_VERTEX_BYTES: u64 = 12;

/// Approximate size of a row of timings [bytes].
const TIMING_BYTES: u64 = 24;

/// Ratio of the actual size to that extrapolated from the samples, which also hold the events between them and are
/// compressed in smaller batches. Measured on the built-in scenes (0.78 to 1.0).
const BATCHED: (u128, u128) = (9, 10);

/// The projected size of a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Projection {
    /// Size of the file [bytes].
    pub bytes: u64,
    /// Number of frames.
    pub frames: u64,
    /// The last step simulated.
    pub seen: u64,
}

impl Projection {
    /// The smallest interval between frames, in steps, that keeps a file below [`LARGE`]. If only the beginning of the
    /// run was simulated, this assumes 1.5 times the predicted size, because groups grow.
    pub fn every(&self, settings: &Settings) -> u64 {
        let is_whole = self.seen >= (self.frames - 1) * settings.every;
        let max_bytes = if is_whole { self.bytes } else { self.bytes.saturating_add(self.bytes / 2) };
        settings.every * max_bytes.div_ceil(LARGE).max(1)
    }
}

/// Projects the size of a run's recording: `None` if it cannot be larger than `min_size` [bytes], if it has no known
/// end, or if the scene does not start or is interrupted. For a large scene, only the beginning is simulated and extrapolated.
pub fn project(experiment: &dyn Experiment, settings: &Settings, min_size: u64) -> Option<Projection> {
    let steps = settings.steps.filter(|_| settings.frames == Frames::All)?;
    let schema = experiment.schema();
    let frames = steps / settings.every + 1;
    let vertex_bytes = MAX_VERTEX_BYTES[usize::from(settings.detail == Detail::Surface)];
    if frames.saturating_mul(schema.vertex_count()).saturating_mul(vertex_bytes) < min_size {
        return None;
    }
    let last = (MAX_VERTEX_STEPS / schema.vertex_count().max(1)).max(MIN_SAMPLES * settings.every).min(steps);
    let samples = if last < steps { MIN_SAMPLES } else { SAMPLES };
    let stride = settings.every * (last / settings.every / samples).max(1);

    // what a recording of stages has besides is left out
    let detail = if settings.detail == Detail::Surface { Detail::Surface } else { Detail::Forces };
    let settings = Settings { every: stride, detail, ..settings.clone() };
    let simulation = experiment.start().ok()?;
    let mut probe = Probe::new(&*simulation, settings)?;
    let (mut frame, mut vertices, mut samples_taken) = (Frame::default(), 0, 0);
    let mut run = Run::new(simulation, Some(last));
    while matches!(run.valid_step(), Ok(true)) {
        let simulation = &*run.simulation;
        if simulation.steps_taken().is_multiple_of(stride) {
            simulation.observe(Want::default(), &mut frame);
            let deformed = schema.bodies.iter().zip(&frame.bodies).filter(|(_, now)| !now.is_at_rest);
            vertices += deformed.map(|(body, _)| body.vertex_count() as u64).sum::<u64>();
            samples_taken += 1;
            probe.recorder.observe(simulation, &run.summary).ok()?;
        }
    }
    if let Some(StepFailure::Interrupted(_)) = run.failure {
        return None;
    }
    let mean = vertices / u64::max(samples_taken, 1);
    let min_bytes = frames.saturating_mul(mean).saturating_mul(MIN_VERTEX_BYTES);
    let bytes = probe.finish(frames)?.max(min_bytes);
    Some(Projection { bytes, frames, seen: run.simulation.steps_taken() })
}

/// A recording whose messages are measured and discarded.
struct Probe {
    recorder: Recorder,
    encoder: Encoder<io::Sink>,
    /// Size of the data that does not depend on the number of frames [bytes].
    head: u64,
    first: u64,
}

impl Probe {
    fn new(simulation: &dyn Simulation, settings: Settings) -> Option<Probe> {
        let mut recorder = Recorder::new(simulation, settings).ok()?;
        let mut encoder =
            Encoder::new_eager(CrateVersion::LOCAL, EncodingOptions::PROTOBUF_COMPRESSED, io::sink()).ok()?;
        encoder.do_not_emit_footer(); // it is not counted, and expensive
        let layout = recorder.blueprint(simulation, Tab::Scene);
        let head = append(&mut encoder, layout.into_iter().chain(recorder.take())).ok()?;
        let first = recorder.frames();
        Some(Probe { recorder, encoder, head, first })
    }

    /// The size of a recording with this many frames [bytes].
    fn finish(self, frames: u64) -> Option<u64> {
        let Probe { mut recorder, mut encoder, head, first } = self;
        let seen = recorder.frames() - first;
        let body = append(&mut encoder, recorder.take()).ok()?;
        recorder.finish();
        let tail = append(&mut encoder, recorder.take()).ok()?;
        let all = u128::from(body) * u128::from(frames) / u128::from(seen.max(1));
        Some(head + tail + (all * BATCHED.0 / BATCHED.1) as u64)
    }
}

/// Returns the encoded size of the messages [bytes]. Timings and the axes of their plots vary from run to run; they
/// are counted with a typical size.
fn append(encoder: &mut Encoder<io::Sink>, messages: impl IntoIterator<Item = LogMsg>) -> Result<u64, EncodeError> {
    let size = |message: LogMsg| match timings(&message) {
        Some(rows) => Ok(rows * TIMING_BYTES),
        None => encoder.append(&message),
    };
    messages.into_iter().map(size).sum()
}

/// The number of rows of a message about timings; `None` for any other message.
fn timings(message: &LogMsg) -> Option<u64> {
    let LogMsg::ArrowMsg(store, arrow) = message else { return None };
    let schema = arrow.batch.schema();
    let entity = schema.metadata().get("rerun:entity_path")?;
    let varies = TIMING.is(entity) || STACKED.is(entity) || store.kind() == StoreKind::Blueprint;
    varies.then(|| arrow.batch.num_rows() as u64)
}
