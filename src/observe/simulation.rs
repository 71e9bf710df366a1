//! Simulations that can be stepped and observed.

use std::{
    fmt::Debug,
    sync::{Arc, atomic::AtomicBool},
    time::Duration,
};

use glam::DVec3;

use crate::model::hermite::Hermite;

use super::{
    InvalidVariation, Parameter, Variation,
    event::{BodyEvent, Instant, PairEvent},
    frame::{BodyFrame, Frame, PairFrame, Want},
    schema::{BodySchema, Schema},
    surface::SurfaceEvent,
};

/// A simulation that can be stepped and observed. Observation never changes the simulation.
pub trait Simulation {
    /// The schema, which does not change during a run.
    fn schema(&self) -> Schema;

    /// Overrides of [`Schema::source`] for a run of this many steps (`None`: until stopped), as lines of that text; empty
    /// if there are none.
    ///
    /// # Errors
    /// The source does not describe this simulation, so that no recording of it could be run again: what differs, and
    /// what to do. It is then not recorded.
    fn overrides(&self, steps: Option<u64>) -> Result<String, String> {
        let _ = steps;
        Ok(String::new())
    }

    /// Number of steps taken.
    fn steps_taken(&self) -> u64;

    /// Simulated time [s].
    fn time(&self) -> f64;

    /// Takes one step, and writes what happened in it to `summary`, which is empty. If the step fails, so do all later ones.
    fn step(&mut self, summary: &mut StepSummary);

    /// The causes of energy changes since the start, in a few words; `None` if unknown.
    fn account(&self) -> Option<String> {
        None
    }

    /// A flag that, once raised, ends the simulation and all analysis of its states as soon as possible.
    fn interrupt(&self) -> Option<&'static AtomicBool> {
        None
    }

    /// Hash of the exact state: equal for bit-identical states, different for all others (barring collisions).
    fn checksum(&self) -> u64;

    /// Writes the requested parts of the state to `frame` (reused).
    fn observe(&self, want: Want, frame: &mut Frame);

    /// Writes the pairs of [`Frame::pairs`], with the motion of their centres, to `pairs` (reused), and those that may have
    /// been within [`reach`](Simulation::reach) in the last step; in ascending order. Called after every step. The default
    /// observes a frame, and knows no velocities.
    fn near(&self, pairs: &mut Vec<NearPair>) {
        let mut frame = Frame::default();
        self.observe(Want::default(), &mut frame);
        pairs.clear();
        pairs.extend(frame.pairs.iter().map(|&PairFrame { a, b, phase, .. }| {
            let [one, other] = [a, b].map(|body| &frame.bodies[body]);
            let velocity = |body: &BodyFrame| body.motion.map_or(DVec3::ZERO, |motion| motion.velocity);
            let rate = velocity(other) - velocity(one);
            NearPair { a, b, phase, apart: other.centre - one.centre, rate }
        }));
    }

    /// The q up to which bodies `a` and `b` can interact [–]; by default, all pairs that [`near`](Simulation::near) writes
    /// can.
    fn reach(&self, a: usize, b: usize) -> f64 {
        let _ = (a, b);
        f64::INFINITY
    }

    /// Position and velocity of the centre of a body at a time within the last step [s, scene unit], if it is on a path.
    fn on_path(&self, body: usize, time: f64) -> Option<[DVec3; 2]> {
        let _ = (body, time);
        None
    }

    /// States inside the step that led from `before` to the current state, in order; by default only its start and end.
    fn stages(&self, before: &Frame) -> Vec<StageFrame> {
        let mut frame = Frame::default();
        self.observe(Want { forces: true, scalars: false }, &mut frame);
        let stage = StageFrame::new;
        vec![stage("start", before.clone()), stage("end", frame)]
    }

    /// Improves the states of some bodies in `frame` at a time [s] within the step that led from `before` to the current
    /// state. They are interpolated by [`between`]; the default keeps them.
    fn within(&self, before: &Frame, time: f64, bodies: &[usize], frame: &mut Frame) {
        let _ = (before, time, bodies, frame);
    }

    /// Touch and part events of pairs in the last step, in order of time, if the simulation detects them itself
    /// ([`Finding::Touch`](super::surface::Finding::Touch) and `Part` only). If `None`, they are searched for in
    /// the states that [`within`](Simulation::within) returns; if [`Schema::events`] has a kind `touch` or `part`, those of
    /// the simulation take their place.
    fn contacts(&self) -> Option<&[SurfaceEvent]> {
        None
    }

    /// Spheres (centre and radius) for the camera to frame: everything visible during the run, or only the regions in
    /// which something happens.
    fn framing(&self, only_what_happens: bool) -> Vec<(DVec3, f64)> {
        let _ = only_what_happens;
        let (mut frame, schema) = (Frame::default(), self.schema());
        self.observe(Want::default(), &mut frame);
        let bodies = frame.bodies.iter().zip(&schema.bodies);
        bodies.map(|(now, body)| (now.centre, f64::max(body.reach, body.radius))).collect()
    }
}

/// The state of some bodies at a time [s] within the last step of a simulation, which led from `ends[0]` to `ends[1]`, as
/// accurately as the simulation knows it: centres, and vertex positions relative to these [scene unit]. `frame` is reused.
pub fn state_within(
    simulation: &dyn Simulation,
    schema: &Schema,
    ends: [&Frame; 2],
    time: f64,
    bodies: &[usize],
    frame: &mut Frame,
) {
    between(schema, ends, time, bodies, frame);
    simulation.within(ends[0], time, bodies, frame);
    put_on_paths(simulation, time, bodies, frame);
}

/// Writes the centres of the bodies that are on paths at a time [s].
pub fn put_on_paths(simulation: &dyn Simulation, time: f64, bodies: &[usize], frame: &mut Frame) {
    for &body in bodies {
        if let Some([position, _]) = simulation.on_path(body, time) {
            frame.bodies[body].centre = position;
        }
    }
}

/// The state of some bodies at a time [s] between two frames. Displacements are interpolated by cubic Hermite
/// polynomials, and so are centres and rotations where their velocities are known; otherwise centres are interpolated
/// linearly, rotations spherically. The error of the cubics is of fourth order in the step, unless a force jumps within
/// it.
///
/// # Panics
/// A frame or the schema has no such body.
pub fn between(schema: &Schema, ends: [&Frame; 2], time: f64, bodies: &[usize], frame: &mut Frame) {
    let instants = ends.map(|end| end.at.time);
    frame.at = Instant { step: ends[1].at.step, time };
    frame.bodies.resize_with(schema.bodies.len(), BodyFrame::default);
    for &index in bodies {
        let ends = ends.map(|end| &end.bodies[index]);
        body_between(&schema.bodies[index], ends, instants, time, &mut frame.bodies[index]);
    }
}

/// Like [`between`] for a body, whose states at both ends are those at two `instants` [s].
pub(crate) fn body_between(
    body: &BodySchema,
    [from, to]: [&BodyFrame; 2],
    instants: [f64; 2],
    time: f64,
    now: &mut BodyFrame,
) {
    let [start, end] = instants;
    let z = if end > start { ((time - start) / (end - start)).clamp(0.0, 1.0) } else { 1.0 };
    let cubic = Hermite::new(instants, time);
    now.centre = from.centre.lerp(to.centre, z);
    now.rotation = from.rotation.slerp(to.rotation, z);
    if let (Some(start), Some(end)) = (from.motion, to.motion) {
        now.centre = cubic.vector([from.centre, to.centre], [start.velocity, end.velocity]);
        now.rotation = cubic.rotation([from.rotation, to.rotation], [start.spin, end.spin]);
    }
    now.mesh.clone_from(&to.mesh);
    if from.is_at_rest && to.is_at_rest {
        now.rest();
        return;
    }
    let count = to.mesh_of(body).vertex_count();
    now.displacements.reset(count);
    if count != from.mesh_of(body).vertex_count() {
        // it tore in this step: the new vertices have no previous state
        now.displacements.add_times(1.0, &to.displacements);
    } else {
        for (factor, vectors) in [
            (cubic.values[0], &from.displacements),
            (cubic.values[1], &to.displacements),
            (cubic.rates[0], &from.velocities),
            (cubic.rates[1], &to.velocities),
        ] {
            now.displacements.add_times(factor, vectors); // adds nothing for a body at rest
        }
    }
    now.displaced(to.rest_of(body));
}

/// A pair that can interact, and how its centres move.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct NearPair {
    /// Index of the first body.
    pub a: usize,
    /// Index of the second body; a < b.
    pub b: usize,
    /// Index into the schema's phases.
    pub phase: usize,
    /// Centre of the second body as seen from that of the first [scene unit].
    pub apart: DVec3,
    /// Its rate of change [scene unit/s].
    pub rate: DVec3,
}

impl NearPair {
    /// The bodies `a` < `b` in a phase of the schema, with the centre of the second as seen from that of the first
    /// [scene unit], and its rate of change [scene unit/s].
    pub fn new([a, b]: [usize; 2], phase: usize, apart: DVec3, rate: DVec3) -> NearPair {
        NearPair { a, b, phase, apart, rate }
    }
}

/// A scene, from which a simulation can be started any number of times.
pub trait Experiment: Debug + Send + Sync {
    /// The schema of its simulations.
    fn schema(&self) -> Schema;

    /// Starts a simulation.
    ///
    /// # Errors
    /// The simulation cannot run here, for the returned reason.
    fn start(&self) -> Result<Box<dyn Simulation>, String>;

    /// Creates an experiment of the same kind from the contents of a recording: `NAME.toml` with its name, for errors and for
    /// what has no other name, [`Schema::source`] and [`Schema::run`].
    ///
    /// # Errors
    /// The text does not describe an experiment of this kind.
    fn read(&self, name: &str, text: &str, run: &toml::Table) -> Result<Arc<dyn Experiment>, Refusal>;

    /// The numbers with which it can be started in place of its own, in the order in which they are shown.
    fn parameters(&self) -> Vec<Parameter> {
        Vec::new()
    }

    /// Whether it knows [`Variation::poke`].
    fn can_poke(&self) -> bool {
        false
    }

    /// The experiment with other values of [parameters](Experiment::parameters).
    ///
    /// # Errors
    /// A key is unknown or a value is invalid, or such a variation is not supported.
    fn varied(&self, variation: &Variation) -> Result<Arc<dyn Experiment>, InvalidVariation> {
        let _ = variation;
        Err(InvalidVariation { key: None, text: "this simulation has no parameters".to_owned() })
    }
}

/// Recreates an experiment from the contents of a recording, see [`Experiment::read`].
pub type ReadExperiment<'a> = dyn Fn(&str, &str, &toml::Table) -> Result<Arc<dyn Experiment>, Refusal> + 'a;

/// Finds an experiment by its name; the error says which there are.
pub type FindExperiment<'a> = dyn Fn(&str) -> Result<Arc<dyn Experiment>, String> + 'a;

/// Why an experiment cannot be recreated. The text is the reason.
#[derive(Clone, Debug)]
pub enum Refusal {
    /// The text is not a valid scene.
    Source(String),
    /// The settings of the run are not supported here.
    Run(String),
}

/// What happened in a step. Reused from one step to the next.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct StepSummary {
    /// Step number, and simulated time at the end of the step.
    pub at: Instant,
    /// Phase changes within the step, in order of time.
    pub events: Vec<PairEvent>,
    /// Events of single bodies within the step, in order of time.
    pub body_events: Vec<BodyEvent>,
    /// Duration of each stage, in the order of the schema.
    pub timings: Vec<Duration>,
    /// Scalars in the order of the schema; entries of scalars that do not describe a step are ignored.
    pub scalars: Vec<f64>,
    /// Where the step is less accurate than requested, if anywhere.
    pub shortfall: Option<Shortfall>,
    /// A warning that the run will end early, and why.
    pub warning: Option<String>,
    /// Why the run should end here, if it should.
    pub failure: Option<StepFailure>,
}

impl StepSummary {
    /// Empties it for the next step; its lists keep their memory.
    pub fn clear(&mut self) {
        let StepSummary { at, events, body_events, timings, scalars, shortfall, failure, warning } = self;
        events.clear();
        body_events.clear();
        timings.clear();
        scalars.clear();
        (*at, *shortfall, *failure, *warning) = (Instant::default(), None, None, None);
    }
}

/// A body whose estimated error exceeds the tolerance.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Shortfall {
    /// Index of the body with the largest ratio of `error` to `allowed`.
    pub body: usize,
    /// Estimated error of the step [radii of the body].
    pub error: f64,
    /// The error that the tolerance allows in a step [radii of the body].
    pub allowed: f64,
}

impl Shortfall {
    /// An error of a body and the error that is allowed [radii of the body].
    pub fn new(body: usize, error: f64, allowed: f64) -> Shortfall {
        Shortfall { body, error, allowed }
    }

    /// Ratio of the error to the allowed error [–].
    pub fn ratio(&self) -> f64 {
        self.error / self.allowed
    }

    /// Describes the shortfall in words: step, time, body and size.
    pub fn describe(&self, schema: &Schema, Instant { step, time }: Instant) -> String {
        let Shortfall { body, error, .. } = *self;
        let (body, ratio) = (&schema.bodies[body].name, self.ratio());
        let ratio = if ratio < 1e3 { format!("{ratio:.1}") } else { format!("{ratio:.0e}") };
        format!(
            "step {step} (t = {time:.6} s): body \"{body}\" may be off by {error:.1e} radii, {ratio} times what the tolerance allows"
        )
    }
}

/// Why a run should end with this step. The text is the reason.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum StepFailure {
    /// The step led to an impossible state.
    #[error("{0}")]
    Diverged(String),
    /// The step was not completed, and no further step can be taken.
    #[error("{0}")]
    NotTaken(String),
    /// The step was not completed because the run was interrupted.
    #[error("{0}")]
    Interrupted(String),
}

impl StepFailure {
    /// Whether the step was completed, so that there is a state after it.
    pub fn is_whole_step(&self) -> bool {
        matches!(self, StepFailure::Diverged(_))
    }
}

/// The state at a stage inside a step.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct StageFrame {
    /// Name of the operation just completed.
    pub name: String,
    /// State and forces at that point.
    pub frame: Frame,
    /// Whether it shows what would have been: it follows from the start of the step, and nothing follows from it.
    pub is_hypothetical: bool,
}

impl StageFrame {
    /// The state after an operation of this name.
    pub fn new(name: impl Into<String>, frame: Frame) -> StageFrame {
        StageFrame { name: name.into(), frame, is_hypothetical: false }
    }
}
