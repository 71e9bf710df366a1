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

/// A step that would take so long that the run seems to hang: it is not taken. How much is too much is counted, not
/// timed, so the run ends there wherever it is run.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("too much to do in step {step} (from t = {time:.6} s on): {toil}")]
pub struct Overworked {
    /// The step that could not be taken.
    pub step: u64,
    /// Simulated time at its start, at which the run ends [s].
    pub time: f64,
    /// What there was too much of.
    pub toil: Toil,
}

/// What a step has too much of.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Toil {
    /// Changes of phase, or looking for them.
    #[error(
        "the distance of bodies \"{a}\" and \"{b}\" has {found} changes of phase so far, and swings too often, or stays too close \
         to a threshold, to be followed on; lower their frequencies or dt, or move merge_at and split_at apart"
    )]
    Events {
        /// Name of one body of the pair …
        a: String,
        /// … and of the other.
        b: String,
        /// Changes of phase of all pairs that were found in the step.
        found: usize,
    },
    /// Forces that change too often, or too many of them.
    #[error(
        "the forces on body \"{body}\" change too fast for its {vertices} vertices to be followed through {spheres} influence \
         spheres in reach; lower dt, frequencies or alpha and beta, raise tolerance, or put fewer bodies in one place"
    )]
    Forces {
        /// Name of the body that took most.
        body: String,
        /// How many vertices it has.
        vertices: usize,
        /// How many influence spheres can reach it.
        spheres: usize,
    },
    /// Bodies that come near each other.
    #[error(
        "too many bodies come near body \"{body}\" and others, {pairs} pairs in all; lower reach or dt, or use fewer or slower bodies"
    )]
    Neighbours {
        /// Name of the body whose neighbours were looked for.
        body: String,
        /// How many pairs are known.
        pairs: usize,
    },
}

/// Why a run should end with a step.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Failure {
    /// The step led to a state that cannot be.
    #[error(transparent)]
    Diverged(#[from] Diverged),
    /// The step was not taken: the world is as it is in the middle of it, and no further step is taken.
    #[error(transparent)]
    Overworked(#[from] Overworked),
    /// The same, because somebody wanted it to end: see [`Options::interrupt`](super::Options::interrupt).
    #[error("interrupted in step {step}")]
    Interrupted {
        /// The step that was not taken.
        step: u64,
    },
}

impl Failure {
    /// Whether the step was taken: there is a state after it.
    pub fn is_whole_step(&self) -> bool {
        matches!(self, Failure::Diverged(_))
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
    /// Steps taken by the integrator: one a body and interval of time without a jump, and those that single vertices took
    /// beyond it.
    pub substeps: u64,
    /// The largest error that any vertex made in this step, as the integrator estimates it [radii of its body]; 0 for
    /// integrators that don't.
    pub error: f64,
    /// Set if a run should end here, and why.
    pub failure: Option<Failure>,
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
