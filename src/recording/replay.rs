//! The same steps again, compared checksum by checksum.

use std::path::Path;

use super::{ReadError, Recorded, frames};
use crate::observe::{Frame, Simulation, StepSummary, Want, Worst};

/// What a replay came to.
#[derive(Clone, Debug, PartialEq)]
pub enum Verdict {
    /// Every checksum is the same.
    Identical,
    /// One is not.
    Divergent(Divergence),
    /// Every checksum is the same, but the run ended with a failure then, and now with another one or with none.
    OtherEnd {
        /// The present one, in words.
        replayed: Option<String>,
    },
}

/// Where a replay and its recording part.
#[derive(Clone, Debug, PartialEq)]
pub struct Divergence {
    /// The first step whose state differs; its predecessor's is the same.
    pub step: u64,
    /// Simulated time at its end [s].
    pub time: f64,
    /// Its checksum in the recording.
    pub recorded: u64,
    /// Its checksum now.
    pub replayed: u64,
}

impl Divergence {
    /// The first frame at or after the divergence in which the difference is large enough to be seen in what is recorded
    /// there (single precision), and its worst vertex; `None` if there is none.
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

/// Runs what a recording holds again, and compares every step of which it has a checksum; `observe` sees the simulation
/// at step 0 and after every step. Ends at the first that differs, or when `observe` says so by `false`.
///
/// # Errors
/// The scene cannot be run here, or the recording is damaged: a checksum alone differs, and those after it do not, as no
/// simulation does it.
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
                last_step = last_step.min(step + 1); // one more, to see whether the two meet again
            }
        } else if let (Some(expected), Some(found)) = (recorded.checksum(step), &divergence)
            && simulation.checksum() == expected
        {
            let what = format!("the checksum of step {} is wrong, that of the next is right", found.step);
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
        simulation.step(); // the one that was not recorded, because it was not taken
        simulation.summary(&mut summary);
    }
    let replayed = summary.failure.as_ref().map(ToString::to_string);
    Ok(match &recorded.failure {
        Some(recorded) if replayed.as_ref() != Some(recorded) => Verdict::OtherEnd { replayed },
        _ => Verdict::Identical,
    })
}

/// Takes a step; one that was not taken to its end is of use to nobody.
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
