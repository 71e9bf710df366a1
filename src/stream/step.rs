//! The data of a step that is passed to the recorder.

use std::time::{Duration, Instant as Clock};

use super::settings::{Frames, Settings};
use crate::{
    analysis::{Approaches, approach::Approach, touch::Touches},
    observe::{BodyFrame, Frame, PairEvent, Schema, Simulation, StageFrame, StepSummary, SurfaceEvent, Want, verify},
};

/// Upper limit on the number of events of a step that are drawn in space.
const DRAWN_EVENTS: usize = 64;

/// The data of a step to be recorded, apart from its frame. Reused.
#[derive(Clone, Debug, Default)]
pub struct StepRecord {
    /// What happened in the step, as the simulation wrote it.
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
    /// The bodies of the pairs of the last events, after the step, at most 64; none in a thin recording.
    pub pairs: Vec<[BodyFrame; 2]>,
    /// Surfaces that touch or part in the step, and remarks on its phase changes.
    pub surfaces: Vec<SurfaceEvent>,
    /// Stages inside the step, if they are recorded.
    pub stages: Vec<StageFrame>,
}

/// Observes steps. Keeps the state before a step whose stages are to be recorded.
pub struct StepWatch {
    schema: Schema,
    before: Option<Frame>,
    /// What happens between bodies, if there are several: the same whatever is recorded.
    pairs: Option<PairWatch>,
}

struct PairWatch {
    touches: Touches,
    approaches: Approaches,
    /// The state after a step without a recorded frame; reused.
    frame: Frame,
}

impl StepWatch {
    /// Starts at the simulation's current state.
    pub fn new(simulation: &dyn Simulation, settings: &Settings) -> StepWatch {
        let schema = simulation.schema();
        let pairs = (schema.bodies.len() > 1).then(|| PairWatch {
            touches: Touches::new(simulation),
            approaches: Approaches::new(simulation, &schema),
            frame: Frame::default(),
        });
        let mut watch = StepWatch { schema, before: None, pairs };
        watch.stages(simulation, settings);
        watch
    }

    /// The closest approaches of pairs that stayed in their first phase, closest first.
    pub fn approaches(&self) -> Vec<Approach> {
        self.pairs.as_ref().map_or_else(Vec::new, |pairs| pairs.approaches.closest())
    }

    /// Adds to the summary of the last step in `record` what is observed after it, and writes its frame to `frame` if one
    /// is due.
    ///
    /// # Errors
    /// What the simulation says of the step breaks the contract of [`observe`](crate::observe): names the field.
    pub fn step(
        &mut self,
        simulation: &dyn Simulation,
        settings: &Settings,
        record: &mut StepRecord,
        mut frame: Option<&mut Frame>,
    ) -> Result<(), String> {
        let start = Clock::now();
        if let Some(frame) = &mut frame {
            simulation.observe(settings.want(), frame);
            verify::frame(&self.schema, frame, settings.want())?;
        }
        verify::summary(&self.schema, &record.summary)?;
        record.surfaces.clear();
        record.pairs.clear();
        let schema = &self.schema;
        if let Some(PairWatch { touches, approaches, frame: own }) = &mut self.pairs {
            if frame.is_none() {
                simulation.observe(Want::default(), own);
                verify::frame(schema, own, Want::default())?;
            }
            let now = frame.as_deref().unwrap_or(own);
            if settings.frames != Frames::Thin {
                let of_pair = |event: &PairEvent| [event.a, event.b].map(|body| now.bodies[body].clone());
                let events = &record.summary.events;
                record.pairs.extend(events[events.len().saturating_sub(DRAWN_EVENTS)..].iter().map(of_pair));
            }
            let (changes, surfaces) = (&record.summary.events, &mut record.surfaces);
            match frame {
                Some(frame) => touches.step(simulation, frame, changes, surfaces),
                None => touches.step_and_take(simulation, own, changes, surfaces),
            }
            approaches.step(simulation, schema, &record.summary.events);
        }
        record.checksum = simulation.checksum();
        record.stages = self.stages(simulation, settings);
        let end = Clock::now();
        (record.observing, record.end) = (end - start, Some(end));
        Ok(())
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
