//! Runs a recording again and compares every checksum.

use std::path::Path;

use super::{ReadError, Recorded, frames, read::End, recorded::RecordedEvent};
use crate::{
    analysis::Worst,
    observe::{Frame, Run, Want},
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
        let Ok(simulation) = recorded.start() else { return Ok(None) };
        let (mut run, mut now) = (Run::again(simulation, recorded.last()), Frame::default());
        while let Some(frame) = stream.next()? {
            if frame.step < self.step || frame.step > recorded.last() {
                continue;
            }
            go_to(frame.step, &mut run, &recorded.path)?;
            run.simulation.observe(Want::default(), &mut now);
            if let Some(worst) = frame.compare(&recorded.schema, &now) {
                return Ok(Some(worst));
            }
        }
        Ok(None)
    }
}

/// Runs a recorded experiment again and compares every step that has a checksum; `observe` is called at
/// step 0 and after every step. Stops at the first difference, or when `observe` returns `false`.
///
/// # Errors
/// The scene cannot be run here, or the recording is damaged: a single checksum differs and the next ones are right,
/// which no simulation can produce.
pub fn verify(recorded: &Recorded, observe: impl FnMut(&Run) -> bool) -> Result<Verdict, ReadError> {
    verify_run(recorded, &mut Run::again(recorded.start()?, recorded.last()), observe)
}

/// Like [`verify`], for a run that the caller has begun with [`Run::again`] and that is where it ended afterwards: of a
/// divergence, a step or two after the last one that was observed.
pub(crate) fn verify_run(
    recorded: &Recorded,
    run: &mut Run,
    mut observe: impl FnMut(&Run) -> bool,
) -> Result<Verdict, ReadError> {
    let mut divergence = None;
    loop {
        let simulation = &*run.simulation;
        let step = simulation.steps_taken();
        if let (Some(expected), None) = (recorded.checksum(step), &divergence) {
            let found = simulation.checksum();
            if found != expected {
                divergence = Some(Divergence { step, time: simulation.time(), recorded: expected, replayed: found });
                // one more, to see whether the two agree again
                run.last = Some(recorded.last().min(step + 1));
            }
        } else if let (Some(expected), Some(found)) = (recorded.checksum(step), &divergence)
            && simulation.checksum() == expected
        {
            let what = format!("the checksum of step {} is wrong, but the next one is right", found.step);
            return Err(ReadError::Damaged { path: recorded.path.clone(), at: None, what });
        }
        if divergence.is_none() && !observe(run) || !self::step(run, &recorded.path)? {
            break;
        }
    }
    if let Some(divergence) = divergence {
        return Ok(Verdict::Divergent(divergence));
    }
    if recorded.failure.is_some() && run.failure.is_none() && run.simulation.steps_taken() == recorded.last() {
        run.last = None; // the step that was not recorded, because it was not completed
        run.step();
    }
    let replayed = run.failure.as_ref().map(ToString::to_string);
    Ok(match &recorded.failure {
        Some(recorded) if replayed.as_ref() != Some(recorded) => Verdict::OtherEnd { replayed },
        _ => Verdict::Identical,
    })
}

/// Checks that the phase changes of a recording are those of its replay up to a step. That may not be so though all checksums
/// are right: they do not cover events.
///
/// # Errors
/// The recording is damaged.
pub(crate) fn verify_events(recorded: &Recorded, replayed: &[RecordedEvent], last: u64) -> Result<(), ReadError> {
    let is_verified = |event: &&RecordedEvent| (recorded.first + 1..=last).contains(&event.step);
    let [was, is] = [&recorded.events, replayed].map(|events| events.iter().filter(is_verified).collect::<Vec<_>>());
    // by their bits, as those of other programs may be NaN
    let bits = |event: &RecordedEvent| [event.q, event.time].map(f64::to_bits);
    let is_same = |was: &RecordedEvent, is: &RecordedEvent| {
        (&was.name, &was.pair, &was.phases, was.step, bits(was)) == (&is.name, &is.pair, &is.phases, is.step, bits(is))
    };
    let first = was.iter().zip(&is).take_while(|(was, is)| is_same(was, is)).count();
    // the end of a file that is cut short may lack events
    if recorded.end == End::Cut || first == was.len().max(is.len()) {
        return Ok(());
    }
    // with all digits: a single bit may differ
    let text = |event: &&RecordedEvent| format!("{event}, in full t = {:?} s, q = {:?}", event.time, event.q);
    let [was, is] = [was, is].map(|events| events.get(first).map_or("no more".to_owned(), text));
    let what = format!("all checksums are right, but event {} is not: {was}; the replay has {is}", first + 1);
    Err(ReadError::Damaged { path: recorded.path.clone(), at: None, what })
}

/// Takes a step; one that is not completed is an error. Returns whether there was one to take.
pub(super) fn step(run: &mut Run, path: &Path) -> Result<bool, ReadError> {
    let has_stepped = run.step();
    match &run.failure {
        Some(failure) if !failure.is_whole_step() => {
            Err(ReadError::Failed { path: path.to_owned(), failure: Box::new(failure.clone()) })
        }
        _ => Ok(has_stepped),
    }
}

/// Takes the steps up to this one.
pub(super) fn go_to(step: u64, run: &mut Run, path: &Path) -> Result<(), ReadError> {
    while run.simulation.steps_taken() < step && self::step(run, path)? {}
    Ok(())
}
