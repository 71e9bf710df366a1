//! The main loop of a run.

use std::{
    sync::atomic::Ordering,
    time::{Duration, Instant},
};

use super::{Arguments, CHECK_INTERVAL, console::Console, events::Events, settings, watch::Changes};
use crate::{
    cli::{
        Failure,
        interrupt::{HAS_STEPPED, STOP},
        warnings,
    },
    observe::{Run, Schema, Simulation, row::rows},
    scene::Scene,
    stream::{
        Pipeline, Recorder,
        pipeline::PipelineEnd,
        settings::{Frames, Settings},
        sinks::{Complete, Finished, Serving, Sinks},
    },
};

/// The clock is read only every few steps.
const STEPS_BETWEEN_CHECKS: u64 = 16;

/// The result of a run.
pub struct Outcome {
    pub simulation: Box<dyn Simulation>,
    pub schema: Schema,
    pub settings: Settings,
    /// Number of frames in the recording.
    pub frames: u64,
    pub events: Events,
    /// Closest approaches of pairs that did not change phase.
    pub approaches: Vec<String>,
    /// Wall time of the simulation alone, and including recording [s].
    pub seconds: [f64; 2],
}

impl Outcome {
    /// Whether a flight recorder waited for an event that did not occur.
    pub fn is_unwritten(&self) -> bool {
        self.frames == 0 && matches!(self.settings.frames, Frames::Last { .. })
    }
}

/// A run whose recording is complete and whose destinations are still open.
pub struct Simulated {
    pub outcome: Outcome,
    pub sinks: Sinks,
    pub failure: Option<String>,
    /// The edited scene that ended the run, if any.
    pub next: Option<Scene>,
}

impl Simulated {
    /// Finishes every destination. A file that a flight recorder has written no frame to is removed.
    pub fn conclude(mut self, console: &Console) -> Result<(Outcome, Finished), Failure> {
        if STOP.load(Ordering::Relaxed) {
            self.sinks.hurry();
        }
        let finished = match self.outcome.is_unwritten() {
            true => {
                let (finished, file) = self.sinks.complete();
                file.into_iter().for_each(Complete::discard);
                finished
            }
            false => self.sinks.finish(),
        };
        let Some(failure) = self.failure else {
            let finished = finished.map_err(|error| Failure::Run(error.to_string()))?;
            return Ok((self.outcome, finished));
        };
        let finished = finished.ok();
        let serving = finished.as_ref().and_then(|finished| finished.serving.as_ref());
        console.notes(serving.and_then(Serving::refused).as_slice());
        let saved = finished.and_then(|finished| finished.save).filter(|_| !self.outcome.is_unwritten());
        let saved = saved.map(|saved| format!("; {} contains the steps up to here", saved.path.display()));
        Err(Failure::Run(format!("{failure}{}", saved.unwrap_or_default())))
    }
}

/// The main loop: step, then record. Ends early when `changes` reports an edited scene.
pub fn simulate(
    simulation: Box<dyn Simulation>,
    sinks: Sinks,
    arguments: &Arguments,
    mut changes: Option<&mut Changes>,
    console: &mut Console,
) -> Result<Simulated, Failure> {
    let schema = simulation.schema();
    let settings = settings(arguments, &schema)?;
    // without its own number, a restarted run would have the id of the previous one, and a viewer would append to that
    let number = changes.as_mut().map_or(0, |changes| changes.next_run());
    console.notes(&warnings(&schema));
    console.begin(&settings, super::destinations(arguments, &schema.name).save.as_deref());
    let recorder = Recorder::numbered(&*simulation, settings.clone(), number).map_err(Failure::Input)?;
    let mut pipeline = Pipeline::start(&*simulation, recorder, sinks, arguments.tab)?;
    console.progress.stage("");
    let (mut events, mut next) = (Events::default(), None);
    let (start, mut simulating) = (Instant::now(), Duration::ZERO);
    let mut looked = start;
    let mut run = Run::new(simulation, settings.steps);
    let mut is_recording = true;
    while is_recording && next.is_none() && !STOP.load(Ordering::Relaxed) {
        let step = Instant::now();
        let has_stepped = run.step();
        simulating += step.elapsed();
        HAS_STEPPED.store(true, Ordering::Relaxed);
        if !has_stepped {
            break;
        }
        let Run { simulation, summary, .. } = &run;
        if let Some(warning) = &summary.warning {
            console.notes(&[format!("warning: {warning}")]);
        }
        if let Some(shortfall) = summary.shortfall {
            events.missed(summary.at, shortfall);
        }
        let due = arguments.realtime.then(|| start + Duration::from_secs_f64(simulation.time().min(1e9)));
        let lag = due.map(|due| Instant::now().saturating_duration_since(due));
        is_recording = pipeline.observe(&**simulation, summary, lag);
        let surfaces = pipeline.surface_events();
        for row in rows(&summary.events, &surfaces, &summary.body_events) {
            events.add(&row, &schema);
        }
        if let Some(due) = due {
            is_recording &= pipeline.flush();
            wait_until(due);
        }
        let is_time = simulation.steps_taken().is_multiple_of(STEPS_BETWEEN_CHECKS) || arguments.realtime;
        console.progress.step(simulation.steps_taken(), simulation.time());
        if is_time && looked.elapsed() >= CHECK_INTERVAL {
            looked = Instant::now();
            console.notes(&pipeline.notes());
            next = changes.as_mut().and_then(|changes| changes.scene(arguments, console));
        }
    }

    // The steps simulated so far are saved, however the run ended.
    console.progress.stage("finishing the recording");
    let failed = run.cause();
    let PipelineEnd { recorder, sinks, mut notes, failure } =
        pipeline.finish(&*run.simulation, failed.as_deref()).map_err(Failure::Run)?;
    let seconds = [simulating, start.elapsed()].map(|time| time.as_secs_f64());
    let (simulation, failure) = (run.simulation, failed.or(failure));
    notes.extend(events.inaccuracy(&schema));
    notes.extend(recorder.dropped_frames());
    if next.is_none() {
        notes.extend(recorder.missed_event());
    }
    console.end();
    console.notes(&notes);
    let (frames, approaches) = (recorder.written(), recorder.approaches());
    let outcome = Outcome { simulation, schema, settings, frames, events, approaches, seconds };
    Ok(Simulated { outcome, sinks, failure, next })
}

/// Sleeps until `due`, or until an interrupt.
fn wait_until(due: Instant) {
    while !STOP.load(Ordering::Relaxed) {
        let left = due.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return;
        }
        std::thread::sleep(left.min(Duration::from_millis(50)));
    }
}
