//! The data of a step that is passed to the recorder.

use std::time::{Duration, Instant as Clock};

use super::settings::{Frames, Settings};
use crate::observe::{BodyEvent, Frame, Simulation, StageFrame, StepSummary, SurfaceEvent, touch::Touches};

/// The data of a step to be recorded, apart from its frame. Reused.
#[derive(Clone, Debug, Default)]
pub struct StepRecord {
    /// Summary of the step.
    pub summary: StepSummary,
    /// Hash of the state after the step.
    pub checksum: u64,
    /// Time that the simulation thread spent on observation.
    pub observing: Duration,
    /// Time that the simulation thread spent waiting for the recording thread.
    pub waiting: Duration,
    /// Delay behind real time, if the run is limited to real time.
    pub lag: Option<Duration>,
    /// When the step was completed.
    pub end: Option<Clock>,
    /// Geometric findings in the step.
    pub surfaces: Vec<SurfaceEvent>,
    /// Events of single bodies in the step.
    pub bodies: Vec<BodyEvent>,
    /// Stages inside the step, if they are recorded.
    pub stages: Vec<StageFrame>,
}

/// Observes steps. Keeps the state before a step whose stages are to be recorded.
#[derive(Default)]
pub struct StepWatch {
    before: Option<Frame>,
    /// The surfaces of pairs, if frames are recorded.
    touches: Option<Touches>,
}

impl StepWatch {
    /// Starts at the simulation's current state.
    pub fn new(simulation: &dyn Simulation, settings: &Settings) -> StepWatch {
        let mut watch = StepWatch::default();
        watch.stages(simulation, settings);
        let has_pairs = simulation.schema().bodies.len() > 1;
        watch.touches = (settings.frames != Frames::Thin && has_pairs).then(|| Touches::new(simulation));
        watch
    }

    /// Writes the last step to `record`, and its frame to `frame` if one is due.
    pub fn step(
        &mut self,
        simulation: &dyn Simulation,
        settings: &Settings,
        record: &mut StepRecord,
        mut frame: Option<&mut Frame>,
    ) {
        let start = Clock::now();
        if let Some(frame) = &mut frame {
            simulation.observe(settings.want(), frame);
        }
        simulation.summary(&mut record.summary);
        record.surfaces.clear();
        match (&mut self.touches, frame) {
            (Some(touches), Some(frame)) => {
                touches.step(simulation, frame, &record.summary.events, &mut record.surfaces);
            }
            (Some(touches), None) => touches.between_frames(simulation, &mut record.surfaces),
            (None, _) => {}
        }
        record.bodies.clear();
        record.bodies.extend_from_slice(simulation.body_events());
        record.checksum = simulation.checksum();
        record.stages = self.stages(simulation, settings);
        let end = Clock::now();
        (record.observing, record.end) = (end - start, Some(end));
    }

    /// The stages of the last step, if they are recorded.
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
