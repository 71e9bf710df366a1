//! What a step reports to whoever observes it.

use std::time::Duration;

use glam::DVec3;

use super::events::Event;
use crate::scene::Integrator;

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

/// A state that the equation of motion cannot lead to: the integrator is unstable at this step.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "diverged at step {step} (t = {time:.6} s): body \"{body}\", vertex {vertex}: displacement {:e} scene units, speed {:e} \
     scene units/s, beyond what any forces so far can have done; integrator {integrator} with dt = {dt:e} s: use a smaller dt \
     or `exponential`, which is stable at any",
    displacement.length(), velocity.length()
)]
pub struct Diverged {
    /// How steps were taken.
    pub integrator: Integrator,
    /// Step Δt [s].
    pub dt: f64,
    /// The first step whose state is wrong.
    pub step: u64,
    /// Simulated time at its end [s].
    pub time: f64,
    /// Name of the body.
    pub body: String,
    /// The worst of its vertices.
    pub vertex: usize,
    /// Its displacement [scene unit].
    pub displacement: DVec3,
    /// Its velocity [scene unit/s].
    pub velocity: DVec3,
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
    /// Steps taken by the integrator: one a body and stretch of time without a jump, and those that single vertices took
    /// beyond it.
    pub substeps: u64,
    /// The largest error that any vertex made in this step, as the integrator estimates it [radii of its body]; 0 for
    /// integrators that don't.
    pub error: f64,
    /// Set if the step led to a state that the equation of motion cannot lead to; a run should end there.
    pub diverged: Option<Diverged>,
    /// Bodies at rest for the whole step, for which nothing was computed.
    pub sleeping_bodies: u64,
    /// Time spent in each stage, by [`Stage::ALL`].
    pub timings: [Duration; Stage::ALL.len()],
}

impl StepReport {
    /// Forgets the step before.
    pub(super) fn begin(&mut self, step: u64, time: f64) {
        let StepReport { events, .. } = self;
        let mut events = std::mem::take(events);
        events.clear();
        *self = StepReport { step, time, events, ..StepReport::default() };
    }
}
