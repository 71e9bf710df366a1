//! A simulation that can be stepped and looked at.

use std::{fmt::Debug, sync::Arc, time::Duration};

use glam::DVec3;

use super::{
    frame::{Frame, Want},
    schema::Schema,
};

/// A simulation that an instrument can step and look at. Looking never changes anything.
pub trait Simulation {
    /// What is simulated; asked once.
    fn schema(&self) -> Schema;

    /// What differs from what the text of the scene says if so many steps are to be taken (`None`: until stopped), as lines
    /// of it; empty if nothing does.
    fn overrides(&self, steps: Option<u64>) -> String {
        let _ = steps;
        String::new()
    }

    /// Number of steps taken.
    fn steps_taken(&self) -> u64;

    /// Simulated time [s].
    fn time(&self) -> f64;

    /// Takes one step.
    fn step(&mut self);

    /// What the last step came to, into `summary` (reused).
    fn summary(&self, summary: &mut StepSummary);

    /// A hash of the exact state: the same for the same bits, and for no others.
    fn checksum(&self) -> u64;

    /// The state, as far as it is wanted, into `frame` (reused).
    fn observe(&self, want: Want, frame: &mut Frame);

    /// The inside of the step that led from `before` to here, in order; both its ends if there is no more to tell.
    fn stages(&self, before: &Frame) -> Vec<StageFrame> {
        let mut frame = Frame::default();
        self.observe(Want { forces: true, scalars: false }, &mut frame);
        let stage = |name: &str, frame| StageFrame { name: name.to_owned(), frame };
        vec![stage("start", before.clone()), stage("end", frame)]
    }

    /// Spheres that a camera should have in view, centres and radii: all that is to be seen in the course of the run, or
    /// only where something happens.
    fn framing(&self, only_what_happens: bool) -> Vec<(DVec3, f64)> {
        let _ = only_what_happens;
        let (mut frame, schema) = (Frame::default(), self.schema());
        self.observe(Want::default(), &mut frame);
        let bodies = frame.bodies.iter().zip(&schema.bodies);
        bodies.map(|(now, body)| (now.centre, f64::max(body.reach, body.radius))).collect()
    }
}

/// What simulations can be made from, again and again: a scene.
pub trait Experiment: Debug + Send + Sync {
    /// What will be simulated.
    fn schema(&self) -> Schema;

    /// The simulation at its start.
    ///
    /// # Errors
    /// It cannot be run here: why, in words.
    fn start(&self) -> Result<Box<dyn Simulation>, String>;

    /// One of its kind, from what a recording of it carries: the name of the file, [`Schema::source`] and [`Schema::run`].
    ///
    /// # Errors
    /// It is none.
    fn read(&self, name: &str, text: &str, run: &toml::Table) -> Result<Arc<dyn Experiment>, Refusal>;
}

/// Makes an experiment again from what a recording of it carries, see [`Experiment::read`].
pub type ReadExperiment<'a> = dyn Fn(&str, &str, &toml::Table) -> Result<Arc<dyn Experiment>, Refusal> + 'a;

/// Why an experiment cannot be made, in words.
#[derive(Clone, Debug)]
pub enum Refusal {
    /// Its text is none.
    Source(String),
    /// It is to be run in a way that is not known here.
    Run(String),
}

/// When something was.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Instant {
    /// Number of the step.
    pub step: u64,
    /// Simulated time [s].
    pub time: f64,
}

/// A change of phase of a pair, at its exact time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PairEvent {
    /// What it is called: `merge`, `split`, …
    pub name: &'static str,
    /// When it happened [s].
    pub time: f64,
    /// The first step whose state has felt it.
    pub step: u64,
    /// Index of one body of the pair …
    pub a: usize,
    /// … and of the other, a < b.
    pub b: usize,
    /// Centre distance over the sum of the radii at that time [–].
    pub q: f64,
    /// The phase that ended, as an index of the schema's.
    pub from: usize,
    /// The phase that began.
    pub to: usize,
}

/// What a step came to; reused.
#[derive(Clone, Debug, Default)]
pub struct StepSummary {
    /// Its number, and the time at its end.
    pub at: Instant,
    /// Changes of phase within it, by time.
    pub events: Vec<PairEvent>,
    /// What its stages took, by the schema's order.
    pub timings: Vec<Duration>,
    /// By the schema's order; of those that are not of steps, nothing.
    pub scalars: Vec<f64>,
    /// Set if a run should end here, and why.
    pub failure: Option<StepFailure>,
}

/// Why a run should end with a step, in words.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum StepFailure {
    /// The step led to a state that cannot be.
    #[error("{0}")]
    Diverged(String),
    /// The step was not taken to its end, and no further one can be.
    #[error("{0}")]
    NotTaken(String),
    /// The same, because somebody wanted the run to end.
    #[error("{0}")]
    Interrupted(String),
}

impl StepFailure {
    /// Whether the step was taken: there is a state after it.
    pub fn is_whole_step(&self) -> bool {
        matches!(self, StepFailure::Diverged(_))
    }
}

/// An instant inside a step.
#[derive(Clone, Debug)]
pub struct StageFrame {
    /// What has just been done.
    pub name: String,
    /// The state and the forces then.
    pub frame: Frame,
}
