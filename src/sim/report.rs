//! What a step reports to its observers, and why a world cannot be changed.

use std::{
    mem::take,
    time::{Duration, Instant},
};

use glam::DVec3;

use super::{events::Event, free::Ledger, memory::TooLarge};
use crate::{
    scene::{Integrator, InvalidScene},
    text::short,
};

named! {
    /// The stages of a step, in the order in which they run.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum Stage {
        /// Broad phase: which bodies can touch in this step.
        Reach = "reach",
        /// Event location: the exact times at which pairs change phase.
        Events = "events",
        /// Integration of the equation of motion of every vertex.
        Integrate = "integrate",
    }
}

/// Measures the stages of a step.
pub(super) struct Stopwatch(Instant);

impl Stopwatch {
    /// Begins to measure the first stage.
    pub fn start() -> Stopwatch {
        Stopwatch(Instant::now())
    }

    /// Adds the time since the start, or since the end of the previous stage, to the time of a stage.
    pub fn stop(&mut self, stage: Stage, report: &mut StepReport) {
        let now = Instant::now();
        report.timings[stage as usize] += now - self.0;
        self.0 = now;
    }
}

/// A state that cannot follow from the equation of motion: the integrator is unstable at this step.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "diverged at step {step} (t = {time:.6} s): body \"{body}\", vertex {vertex}: displacement {} scene units, speed {} \
     scene units/s, beyond what any forces so far can have caused; integrator {integrator} with dt = {} s: use a smaller dt \
     or `exponential`, which is stable at any",
    short(displacement.length()), short(velocity.length()), short(*dt)
)]
pub struct Diverged {
    /// The integrator in use.
    pub integrator: Integrator,
    /// Step Δt [s].
    pub dt: f64,
    /// The first step whose state is invalid.
    pub step: u64,
    /// Simulated time at the end of that step [s].
    pub time: f64,
    /// Name of the body.
    pub body: String,
    /// Index of its worst vertex.
    pub vertex: usize,
    /// Displacement of that vertex [scene unit].
    pub displacement: DVec3,
    /// Velocity of that vertex [scene unit/s].
    pub velocity: DVec3,
}

/// A step that would take so long that the run would appear to hang; it is not taken. The limit counts work, not time,
/// so the run ends at the same step on every machine.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("too much to do in step {step} (from t = {time:.6} s on): {toil}")]
pub struct Overworked {
    /// The step that could not be taken.
    pub step: u64,
    /// Simulated time at its start, at which the run ends [s].
    pub time: f64,
    /// What exceeded the limit.
    pub toil: Toil,
}

/// What made a step exceed its work limit.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Toil {
    /// Phase changes, or the search for them.
    #[error(
        "the distance of bodies \"{a}\" and \"{b}\" has {found} phase changes so far, and oscillates too often, or stays too close \
         to a threshold, to be followed further; lower their frequencies or dt, or move merge_at and split_at apart"
    )]
    Events {
        /// Name of one body of the pair.
        a: String,
        /// Name of the other body of the pair.
        b: String,
        /// Number of phase changes of all pairs found in the step.
        found: usize,
    },
    /// Forces that change too often, or too many forces.
    #[error(
        "the forces on body \"{body}\" change too fast to be followed (vertices: {vertices}, influence spheres in reach: \
         {spheres}); lower dt, frequencies, alpha and beta or planes' stiffness, raise tolerance, or overlap fewer bodies"
    )]
    Forces {
        /// Name of the body that took the most work.
        body: String,
        /// Number of its vertices.
        vertices: usize,
        /// Number of influence spheres that can reach it.
        spheres: usize,
    },
    /// Free bodies that act on each other, and are stepped together.
    #[error(
        "{bodies} bodies that act on each other, among them \"{body}\", are stepped together, and took {steps} \
         steps in this frame (pairs: {pairs}, phase changes: {changes}); {}",
        remedy(*changes, *steps, *tolerance)
    )]
    Together {
        /// Number of bodies.
        bodies: usize,
        /// Name of the body whose error made the shortest step.
        body: String,
        /// Number of pairs of these bodies that are near each other.
        pairs: usize,
        /// Number of steps taken, at most.
        steps: u64,
        /// Number of phase changes in these steps.
        changes: usize,
        /// Tolerance of the scene [radii per unit of scene time].
        tolerance: f64,
    },
    /// A body that is crushed.
    #[error(
        "body \"{body}\" is crushed until it turns inside out, where its rotation is not unique; soften what presses on it (planes' \
         stiffness, beta), raise its omega, or set rotation = \"fixed\""
    )]
    InsideOut {
        /// Name of the body.
        body: String,
    },
    /// A pair whose phase changes without end.
    #[error(
        "bodies \"{a}\" and \"{b}\" chatter: they change their phase without end where attraction turns into repulsion at \
         once; lower dt if they are not that fast, set core_width, or move merge_at, split_at and core_at apart"
    )]
    Chatter {
        /// Name of one body of the pair.
        a: String,
        /// Name of the other body of the pair.
        b: String,
    },
    /// A force that breaks its promise.
    #[error("the program's force on body \"{body}\" is not a number, or exceeds its bound; see `Force::new`")]
    Force {
        /// Name of the body.
        body: String,
    },
    /// A body that cannot be followed within the tolerance.
    #[error(
        "body \"{body}\" cannot be followed within the tolerance by steps of {length:e} s; raise tolerance, or make what acts on \
         it smoother: set core_width, raise a plane's slip, lower its stiffness or friction, lower spins"
    )]
    Unresolved {
        /// Name of the body.
        body: String,
        /// Length of the last steps tried [s].
        length: f64,
    },
    /// Too many bodies near each other.
    #[error(
        "too many bodies come near body \"{body}\" and others, {pairs} pairs in all; lower reach or dt, or use fewer or slower bodies"
    )]
    Neighbours {
        /// Name of the body whose neighbours were searched for.
        body: String,
        /// Number of pairs known so far.
        pairs: usize,
    },
}

/// A warning that a run will end as [`Overworked`], or that bodies will take steps of fixed length, see [`Fallback`].
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("step {step} (t = {time:.6} s) exceeds its work allowance: if this continues, {}; {toil}", toil.outcome())]
pub struct Strain {
    /// The step.
    pub step: u64,
    /// Simulated time at its end [s].
    pub time: f64,
    /// What takes the work.
    pub toil: Toil,
}

/// A warning that adaptive steps are too much work, and that bodies take steps of fixed length instead.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "step {step} (t = {time:.6} s): bodies that act on each other ({bodies}, among them \"{body}\") cannot be followed at tolerance \
     {tolerance:e} with reasonable work; they take steps of {substep:.1e} s until adaptive steps are affordable again, and \
     their estimated errors are recorded"
)]
pub struct Fallback {
    /// The step.
    pub step: u64,
    /// Simulated time at its end [s].
    pub time: f64,
    /// Number of bodies.
    pub bodies: usize,
    /// Name of the body with the largest estimated error.
    pub body: String,
    /// Tolerance of the scene [radii per unit of scene time].
    pub tolerance: f64,
    /// Length of their steps [s].
    pub substep: f64,
}

impl Toil {
    /// What happens if it goes on.
    fn outcome(&self) -> &'static str {
        match self {
            Toil::Together { .. } => "they take steps of fixed length",
            _ => "the run will end",
        }
    }
}

/// What makes steps of many bodies cheaper.
fn remedy(changes: usize, steps: u64, tolerance: f64) -> String {
    match 2 * changes as u64 >= steps {
        true => {
            "a phase change begins a new step of them all: use fewer bodies or vertices, spread them out, or lower \
                 merge_at so that fewer of them merge"
                .to_owned()
        }
        false => format!(
            "raise tolerance (now {tolerance:e}), set rotation = \"fixed\", soften planes, lower frequencies, alpha and beta, or \
             use fewer bodies or vertices"
        ),
    }
}

/// Why a run should end after a step.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Failure {
    /// The step led to an invalid state.
    #[error(transparent)]
    Diverged(#[from] Diverged),
    /// The step was not completed: the world stops in the middle of it and takes no further step.
    #[error(transparent)]
    Overworked(#[from] Overworked),
    /// The step was not completed because it was interrupted: see [`Options::interrupt`](super::Options::interrupt).
    #[error("interrupted in step {step}")]
    Interrupted {
        /// The step that was not taken.
        step: u64,
    },
    /// An edit of the scene leads to one that cannot be simulated.
    #[error("the edit at t = {time:.6} s in step {step}: {error}")]
    Edit {
        /// The step that was not taken.
        step: u64,
        /// Time of the edit [s].
        time: f64,
        /// Why.
        error: Box<EditError>,
    },
}

impl Failure {
    /// Whether the step was completed, so that there is a state after it.
    pub fn is_whole_step(&self) -> bool {
        matches!(self, Failure::Diverged(_))
    }
}

/// A body whose estimated error exceeds the tolerance because steps cannot be made shorter, or because shorter ones would be
/// too much work.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shortfall {
    /// Index of the body with the largest ratio of `error` to `allowed`.
    pub body: usize,
    /// Estimated error of the step [radii of the body].
    pub error: f64,
    /// The error that the tolerance allows in a step [radii of the body].
    pub allowed: f64,
}

/// What happened in one step. Reused for every step.
#[derive(Clone, Debug, Default)]
pub struct StepReport {
    /// Number of this step, which ends at `time`.
    pub step: u64,
    /// Simulated time at the end of the step [s].
    pub time: f64,
    /// Phase changes within the step, in order of time.
    pub events: Vec<Event>,
    /// Energy added to free bodies in this step, by cause; zero in scenes that are not coupled, and for integrators
    /// without an error estimate.
    pub ledger: Ledger,
    /// Number of integrator steps: one per body and interval without a jump, plus the substeps of single vertices.
    pub substeps: u64,
    /// The largest error of any vertex in the integrator's last step, as estimated by it [radii of its body, or of the
    /// smallest body near it if that is smaller]; 0 for integrators without an error estimate.
    pub error: f64,
    /// Where the error exceeds the tolerance.
    pub shortfall: Option<Shortfall>,
    /// What takes so much work that the run will end early if this continues; set once.
    pub strain: Option<Strain>,
    /// Which bodies take steps of fixed length from here on; set once.
    pub fallback: Option<Fallback>,
    /// Why the run should end here, if it should.
    pub failure: Option<Failure>,
    /// Number of bodies that were not integrated: at rest, or in free motion out of reach of all others.
    pub sleeping_bodies: u64,
    /// Time spent in each stage, in the order of [`Stage::ALL`].
    pub timings: [Duration; Stage::ALL.len()],
}

impl StepReport {
    /// Clears the report of the previous step, but for what is known only at the end of the step.
    pub(super) fn begin(&mut self, step: u64, time: f64) {
        let StepReport { events, error, sleeping_bodies, .. } = self;
        let (mut events, error, sleeping_bodies) = (take(events), *error, *sleeping_bodies);
        events.clear();
        *self = StepReport { step, time, events, error, sleeping_bodies, ..StepReport::default() };
    }
}

/// What is summed over the parts of a step.
pub(super) struct Sums {
    substeps: u64,
    error: f64,
    shortfall: Option<Shortfall>,
    ledger: Ledger,
}

impl StepReport {
    /// Takes the sums over the parts of the step that have been done, so that the next part begins its own.
    pub(super) fn take_sums(&mut self) -> Sums {
        let StepReport { substeps, error, shortfall, ledger, .. } = self;
        // before the first part it is that of an earlier step
        let error = if *substeps > 0 { take(error) } else { 0.0 };
        Sums { substeps: take(substeps), error, shortfall: take(shortfall), ledger: take(ledger) }
    }

    /// Adds the sums over earlier parts of the step.
    pub(super) fn add_sums(&mut self, earlier: Sums) {
        self.substeps += earlier.substeps;
        self.error = self.error.max(earlier.error);
        let ratio = |shortfall: &Shortfall| shortfall.error / shortfall.allowed;
        self.shortfall =
            self.shortfall.into_iter().chain(earlier.shortfall).max_by(|a, b| ratio(a).total_cmp(&ratio(b)));
        self.ledger += earlier.ledger;
    }
}

/// Why a world cannot start.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum WorldError {
    /// A program has given the scene a value that no scene file could have.
    #[error(transparent)]
    Invalid(#[from] InvalidScene),
    /// The scene needs more memory than is available; nothing has been allocated.
    #[error(transparent)]
    TooLarge(#[from] TooLarge),
}

/// Why a world cannot be changed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EditError {
    /// The body of this handle has been removed.
    #[error("the body of this handle is not in the world any more")]
    Stale,
    /// A value that no scene file could have.
    #[error(transparent)]
    Invalid(#[from] InvalidScene),
    /// There is no such body.
    #[error("there is no body {0}")]
    NoBody(usize),
    /// Another body already has this name.
    #[error("there is a body \"{0}\" already; names are unique")]
    Name(String),
    /// Forces cannot move a body on a path.
    #[error("the body \"{0}\" is on a path: no force moves it")]
    OnPath(String),
    /// The only body of a world cannot be removed.
    #[error("a world has at least one body")]
    LastBody,
    /// Bodies of a scene with laws for particular pairs cannot be removed.
    #[error("bodies cannot be removed from a scene with [[pair]] laws")]
    Laws,
    /// Free bodies, planes and cores with a width are simulated by another solver than bodies on paths.
    #[error("after the first step, a world cannot get its first or lose its last free body, plane or core_width")]
    Solver,
    /// The world would become too large.
    #[error(transparent)]
    TooLarge(#[from] TooLarge),
}
