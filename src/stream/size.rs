//! How large a recording will be, before it is made: the scene is simulated once without recording it, and a few of its
//! frames are recorded to nowhere.

use std::{
    io::{self, Write},
    time::{Duration, Instant as Clock},
};

use rerun::external::{
    re_build_info::CrateVersion,
    re_log_encoding::{EncodeError, Encoder, EncodingOptions},
    re_log_types::LogMsg,
};

use super::{
    Recorder, Settings,
    settings::{Detail, Frames},
};
use crate::observe::{Experiment, Frame, Simulation, StepSummary, Want};

/// A recording larger than this is announced before the run starts [bytes].
pub const LARGE: u64 = 200_000_000;
/// Upper limit on the time that each of the two passes takes.
pub const BUDGET: Duration = Duration::from_millis(700);
/// Frames that are looked at.
const SAMPLES: u64 = 24;
/// A deformed vertex takes at most this much in a frame [bytes]; with forces, and without.
const MOST_OF_VERTEX: [u64; 2] = [250, 90];
/// And usually at least this much.
const LEAST_OF_VERTEX: u64 = 12;

/// What a run's frames take of the size that a few of them suggest: those few hold the events of the frames between, and are
/// compressed in smaller batches. Measured on the built-in scenes (0.78 to 1.0).
const BATCHED: (u128, u128) = (9, 10);

/// The projected size of a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Projection {
    /// Size of the file [bytes].
    pub bytes: u64,
    /// The same without forces, if they are recorded [bytes].
    pub without_forces: Option<u64>,
    /// Number of frames.
    pub frames: u64,
    /// The last step that was looked at.
    pub seen: u64,
}

impl Projection {
    /// The least interval between frames, in steps, that keeps a file below [`LARGE`].
    pub fn every(&self, settings: &Settings) -> u64 {
        settings.every * self.bytes.div_ceil(LARGE).max(1)
    }
}

/// Projects the size of a run's recording: `None` if it cannot be larger than `least` [bytes], if it has no known end,
/// or if the scene does not start. Passes end after `budget` each; the rest of the run is taken to be like what was seen.
pub fn project(experiment: &dyn Experiment, settings: &Settings, least: u64, budget: Duration) -> Option<Projection> {
    let steps = settings.steps.filter(|_| settings.frames == Frames::All)?;
    let schema = experiment.schema();
    let frames = steps / settings.every + 1;
    let most = MOST_OF_VERTEX[usize::from(settings.detail == Detail::Surface)];
    if frames.saturating_mul(schema.vertex_count()).saturating_mul(most) < least {
        return None;
    }
    let stride = settings.every * (frames / SAMPLES).max(1);

    // what moves and deforms, without recording it
    let mut simulation = experiment.start().ok()?;
    let (mut frame, mut vertices, mut looks) = (Frame::default(), 0, 0);
    each(&mut *simulation, steps, stride, budget, &mut |simulation| {
        simulation.observe(Want::default(), &mut frame);
        let deformed = schema.bodies.iter().zip(&frame.bodies).filter(|(_, now)| !now.is_at_rest);
        vertices += deformed.map(|(body, _)| body.vertex_count() as u64).sum::<u64>();
        looks += 1;
    });
    let mean = vertices / u64::max(looks, 1);
    if frames.saturating_mul(mean).saturating_mul(2 * most) < least {
        return None;
    }

    let mut simulation = experiment.start().ok()?;
    let sampled = |detail| Settings { every: stride, detail, ..settings.clone() };
    let detail = if settings.detail == Detail::Surface { Detail::Surface } else { Detail::Forces };
    let mut probes = vec![Probe::new(&*simulation, sampled(detail))?];
    if settings.detail != Detail::Surface {
        probes.push(Probe::new(&*simulation, sampled(Detail::Surface))?);
    }
    let seen = each(&mut *simulation, steps, stride, budget, &mut |simulation| {
        probes.iter_mut().for_each(|probe| probe.recorder.observe(simulation));
    });
    let sizes: Option<Vec<u64>> = probes.into_iter().map(|probe| probe.finish(&*simulation, frames)).collect();
    let (bytes, without_forces) = match sizes?[..] {
        [bytes] => (bytes, None),
        [bytes, without] => (bytes, Some(without)),
        _ => return None,
    };
    let least_there_is = frames.saturating_mul(mean).saturating_mul(LEAST_OF_VERTEX);
    Some(Projection { bytes: bytes.max(least_there_is), without_forces, frames, seen })
}

/// Steps to the end, or as far as `budget` allows, and looks at every `stride`th step; returns the last step taken.
fn each(
    simulation: &mut dyn Simulation,
    steps: u64,
    stride: u64,
    budget: Duration,
    look: &mut dyn FnMut(&dyn Simulation),
) -> u64 {
    let (start, mut summary) = (Clock::now(), StepSummary::default());
    // one look at least: there is nothing to say otherwise
    while simulation.steps_taken() < steps && (start.elapsed() < budget || simulation.steps_taken() <= stride) {
        simulation.step();
        simulation.summary(&mut summary);
        if summary.failure.is_some() {
            break;
        }
        if simulation.steps_taken().is_multiple_of(stride) {
            look(simulation);
        }
    }
    simulation.steps_taken()
}

/// A recording that is counted and thrown away.
struct Probe {
    recorder: Recorder,
    encoder: Encoder<Count>,
    /// Size of what does not grow with the frames [bytes].
    head: u64,
    first: u64,
}

impl Probe {
    fn new(simulation: &dyn Simulation, settings: Settings) -> Option<Probe> {
        let mut recorder = Recorder::new(simulation, settings);
        let mut encoder =
            Encoder::new_eager(CrateVersion::LOCAL, EncodingOptions::PROTOBUF_COMPRESSED, Count::default()).ok()?;
        let layout = recorder.blueprint(simulation);
        let head = append(&mut encoder, layout.into_iter().chain(recorder.take())).ok()?;
        let first = recorder.frames();
        Some(Probe { recorder, encoder, head, first })
    }

    /// The size of a recording with this many frames [bytes].
    fn finish(self, simulation: &dyn Simulation, frames: u64) -> Option<u64> {
        let Probe { mut recorder, mut encoder, head, first } = self;
        let seen = recorder.frames() - first;
        let body = append(&mut encoder, recorder.take()).ok()?;
        recorder.finish(simulation);
        append(&mut encoder, recorder.take()).ok()?;
        encoder.finish().ok()?;
        let tail = encoder.into_inner().ok()?.0.saturating_sub(head + body);
        let all = u128::from(body) * u128::from(frames) / u128::from(seen.max(1));
        Some(head + tail + (all * BATCHED.0 / BATCHED.1) as u64)
    }
}

/// Returns the encoded size of the messages [bytes].
fn append(encoder: &mut Encoder<Count>, messages: impl IntoIterator<Item = LogMsg>) -> Result<u64, EncodeError> {
    messages.into_iter().map(|message| encoder.append(&message)).sum()
}

/// Counts what is written to it [bytes].
#[derive(Default)]
struct Count(u64);

impl Write for Count {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0 += bytes.len() as u64;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
