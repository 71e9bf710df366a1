//! Runs a recording again and compares every checksum.

use std::path::Path;

use super::{ReadError, Recorded, frames};
use crate::{
    analysis::Worst,
    observe::{Frame, Simulation, StepSummary, Want},
};

/// The result of a replay.
#[derive(Clone, Debug, PartialEq)]
pub enum Verdict {
    /// All checksums are equal.
    Identical,
    /// A checksum differs.
    Divergent(Divergence),
    /// All checksums are equal, but the recorded run ended with a failure and the replay with a different one or none.
    OtherEnd {
        /// The failure of the replay, in words.
        replayed: Option<String>,
    },
}

/// The first difference between a replay and its recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Divergence {
    /// The first step whose state differs; the state of the step before is equal.
    pub step: u64,
    /// Simulated time at the end of that step [s].
    pub time: f64,
    /// Checksum of that step in the recording.
    pub recorded: u64,
    /// Checksum of that step in the replay.
    pub replayed: u64,
}

impl Divergence {
    /// The worst vertex of the first frame, at or after the divergence, whose difference is visible in the single
    /// precision of the recording; `None` if there is no such frame.
    ///
    /// # Errors
    /// The recording cannot be read.
    pub fn worst(&self, recorded: &Recorded) -> Result<Option<Worst>, ReadError> {
        let mut stream = frames::FrameReader::open(recorded)?;
        let Ok(mut simulation) = recorded.start() else { return Ok(None) };
        let (mut now, mut summary) = (Frame::default(), StepSummary::default());
        while let Some(frame) = stream.next()? {
            if frame.step < self.step || frame.step > recorded.last() {
                continue;
            }
            while simulation.steps_taken() < frame.step {
                step(&mut *simulation, &mut summary, &recorded.path)?;
            }
            simulation.observe(Want::default(), &mut now);
            if let Some(worst) = frame.compare(&recorded.schema, &now) {
                return Ok(Some(worst));
            }
        }
        Ok(None)
    }
}

/// Runs a recorded experiment again and compares every step that has a checksum; `observe` is called with the
/// simulation at step 0 and after every step. Stops at the first difference, or when `observe` returns `false`.
///
/// # Errors
/// The scene cannot be run here, or the recording is damaged: a single checksum differs and the next ones are right,
/// which no simulation can produce.
pub fn verify(recorded: &Recorded, mut observe: impl FnMut(&dyn Simulation) -> bool) -> Result<Verdict, ReadError> {
    let mut simulation = recorded.start()?;
    let mut last_step = recorded.last();
    let mut summary = StepSummary::default();
    let mut divergence = None;
    loop {
        let step = simulation.steps_taken();
        if let (Some(expected), None) = (recorded.checksum(step), &divergence) {
            let found = simulation.checksum();
            if found != expected {
                divergence = Some(Divergence { step, time: simulation.time(), recorded: expected, replayed: found });
                last_step = last_step.min(step + 1); // one more, to see whether the two agree again
            }
        } else if let (Some(expected), Some(found)) = (recorded.checksum(step), &divergence)
            && simulation.checksum() == expected
        {
            let what = format!("the checksum of step {} is wrong, but the next one is right", found.step);
            return Err(ReadError::Damaged { path: recorded.path.clone(), at: None, what });
        }
        if divergence.is_none() && !observe(&*simulation) {
            break;
        }
        if step >= last_step {
            break;
        }
        self::step(&mut *simulation, &mut summary, &recorded.path)?;
    }
    if let Some(divergence) = divergence {
        return Ok(Verdict::Divergent(divergence));
    }
    if recorded.failure.is_some() && summary.failure.is_none() && simulation.steps_taken() == recorded.last() {
        simulation.step(); // the step that was not recorded, because it was not completed
        simulation.summary(&mut summary);
    }
    let replayed = summary.failure.as_ref().map(ToString::to_string);
    Ok(match &recorded.failure {
        Some(recorded) if replayed.as_ref() != Some(recorded) => Verdict::OtherEnd { replayed },
        _ => Verdict::Identical,
    })
}

/// Takes a step; a step that is not completed is an error.
pub(super) fn step(simulation: &mut dyn Simulation, summary: &mut StepSummary, path: &Path) -> Result<(), ReadError> {
    simulation.step();
    simulation.summary(summary);
    match &summary.failure {
        Some(failure) if !failure.is_whole_step() => {
            Err(ReadError::Failed { path: path.to_owned(), failure: Box::new(failure.clone()) })
        }
        _ => Ok(()),
    }
}
