//! The loop behind everything that runs a simulation: step, summarise, end.

use super::{Simulation, StepFailure, StepSummary};
use crate::interrupt::is_raised;

/// A simulation on the way to its last step. Between two steps, it can be observed.
pub struct Run {
    /// The simulation.
    pub simulation: Box<dyn Simulation>,
    /// What happened in its last step.
    pub summary: StepSummary,
    /// Why the last step failed, or was not taken.
    pub failure: Option<StepFailure>,
    /// The last step to be taken; `None`: there is no end.
    pub last: Option<u64>,
    /// Whether steps follow on a state that has diverged.
    outlasts_divergence: bool,
}

impl Run {
    /// Begins a run that ends with the step `last`, if there is one, or with the first failure.
    pub fn new(simulation: Box<dyn Simulation>, last: Option<u64>) -> Run {
        Run { simulation, summary: StepSummary::default(), failure: None, last, outlasts_divergence: false }
    }

    /// Begins a run that is compared with an earlier one, step by step: it ends where that one ended, even if a state has
    /// diverged before.
    pub fn again(simulation: Box<dyn Simulation>, last: u64) -> Run {
        Run { outlasts_divergence: true, ..Run::new(simulation, Some(last)) }
    }

    /// Takes a step, unless the run has ended or is [interrupted](Simulation::interrupt). Returns whether there is a new
    /// state, which may be one that has diverged.
    pub fn step(&mut self) -> bool {
        let has_failed =
            self.failure.as_ref().is_some_and(|failure| !(self.outlasts_divergence && failure.is_whole_step()));
        if has_failed || self.last.is_some_and(|last| self.simulation.steps_taken() >= last) {
            return false;
        }
        if is_raised(self.simulation.interrupt()) {
            let step = self.simulation.steps_taken();
            self.failure = Some(StepFailure::Interrupted(format!("interrupted after step {step}")));
            return false;
        }
        self.summary.clear();
        self.simulation.step(&mut self.summary);
        self.failure.clone_from(&self.summary.failure);
        self.failure.as_ref().is_none_or(StepFailure::is_whole_step)
    }

    /// Why the run failed, in words; an interrupt is no failure.
    pub fn cause(&self) -> Option<String> {
        let is_cause = |failure: &&StepFailure| !matches!(failure, StepFailure::Interrupted(_));
        self.failure.as_ref().filter(is_cause).map(ToString::to_string)
    }

    /// Takes a step as [`step`](Run::step) does, for those who need valid states only. Returns whether there is a new one.
    ///
    /// # Errors
    /// The simulation has failed.
    pub fn valid_step(&mut self) -> Result<bool, StepFailure> {
        let has_stepped = self.step();
        self.failure.clone().map_or(Ok(has_stepped), Err)
    }
}
