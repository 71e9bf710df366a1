//! What a step reports to whoever observes it.

use std::time::Duration;

use super::events::Event;

/// The stages of a step, in the order in which they run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Who can touch whom in this step.
    Reach,
    /// Exact times at which pairs change phase.
    Events,
    /// The equation of motion of every vertex.
    Integrate,
}

impl Stage {
    /// All stages, in order.
    pub const ALL: [Stage; 3] = [Stage::Reach, Stage::Events, Stage::Integrate];

    /// The name used in recordings.
    pub const fn name(self) -> &'static str {
        match self {
            Stage::Reach => "reach",
            Stage::Events => "events",
            Stage::Integrate => "integrate",
        }
    }
}

/// What happened in one step. Reused from step to step.
#[derive(Clone, Debug, Default)]
pub struct StepReport {
    /// Number of this step; its state is that at `time`.
    pub step: u64,
    /// Simulated time at the end of the step [s].
    pub time: f64,
    /// Phase changes within the step, by time.
    pub events: Vec<Event>,
    /// Sub-steps taken, summed over the bodies that were integrated.
    pub substeps: u64,
    /// Bodies at rest for the whole step, for which nothing was computed.
    pub sleeping_bodies: u64,
    /// Time spent in each stage, by [`Stage::ALL`].
    pub timings: [Duration; Stage::ALL.len()],
}
