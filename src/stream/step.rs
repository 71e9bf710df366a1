//! What a step leaves to be recorded.

use std::time::{Duration, Instant as Clock};

use super::settings::Settings;
use crate::observe::{Frame, Simulation, StageFrame, StepSummary};

/// What a step leaves to be recorded, apart from its frame; reused.
#[derive(Clone, Debug, Default)]
pub struct StepRecord {
    /// What happened.
    pub summary: StepSummary,
    /// The hash of the state after it.
    pub checksum: u64,
    /// What looking at the simulation took of its time …
    pub observing: Duration,
    /// … and what waiting for the recording took.
    pub waiting: Duration,
    /// How far the simulation is behind real time, if it runs no faster than that.
    pub lag: Option<Duration>,
    /// When the step was complete.
    pub end: Option<Clock>,
    /// What happened inside, if that is wanted.
    pub stages: Vec<StageFrame>,
}

/// Looks at steps; keeps the state before the next one if that is to be looked into.
#[derive(Default)]
pub struct StepWatch {
    before: Option<Frame>,
}

impl StepWatch {
    /// From the simulation as it is on.
    pub fn new(simulation: &dyn Simulation, settings: &Settings) -> StepWatch {
        let mut watch = StepWatch::default();
        watch.stages(simulation, settings);
        watch
    }

    /// The step just taken into `record`, and its frame into `frame` if it is the turn of one.
    pub fn step(
        &mut self,
        simulation: &dyn Simulation,
        settings: &Settings,
        record: &mut StepRecord,
        frame: Option<&mut Frame>,
    ) {
        let start = Clock::now();
        if let Some(frame) = frame {
            simulation.observe(settings.want(), frame);
        }
        simulation.summary(&mut record.summary);
        record.checksum = simulation.checksum();
        record.stages = self.stages(simulation, settings);
        let end = Clock::now();
        (record.observing, record.end) = (end - start, Some(end));
    }

    /// The stages of the step just taken, if they are wanted.
    fn stages(&mut self, simulation: &dyn Simulation, settings: &Settings) -> Vec<StageFrame> {
        let step = simulation.steps_taken();
        let stages = match &self.before {
            Some(before) if settings.has_stages(step) => simulation.stages(before),
            _ => Vec::new(),
        };
        if settings.has_stages(step + 1) {
            simulation.observe(settings.want(), self.before.get_or_insert_default());
        } else {
            self.before = None;
        }
        stages
    }
}
