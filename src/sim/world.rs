//! The world: a scene at an instant, its step, and access to its state.

use std::sync::atomic::AtomicBool;

use pulp::Arch;

use super::{
    body::{BodyView, PairView},
    checksum,
    coupled::Coupled,
    events::Event,
    handle::{BodyHandle, Handles},
    memory,
    prescribed::Prescribed,
    report::{Diverged, EditError, Failure, StepReport, WorldError},
    solver::{Setting, Solver, Step, Takeover},
    span::Span,
    terms::Surroundings,
    work::Work,
};

use crate::{
    model::phase::Phase,
    scene::{ROUNDING, Scene},
};

/// How the world is stepped. No option changes the result beyond rounding.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// The instruction set of the kernels; results are bit-identical.
    pub arch: Arch,
    /// A flag that stops building and stepping once it is set: the current step soon ends with
    /// [`Failure::Interrupted`].
    pub interrupt: Option<&'static AtomicBool>,
}

impl Default for Options {
    fn default() -> Options {
        Options { arch: Arch::new(), interrupt: None }
    }
}

/// The bodies of a scene at an instant, advanced step by step. A clone continues to the same bits.
#[derive(Clone)]
pub struct World {
    pub(super) scene: Scene,
    options: Options,
    /// Number of steps taken.
    pub(super) step: u64,
    pub(super) report: StepReport,
    pub(crate) work: Work,
    pub(super) solver: Solver,
    /// Number of the scene's edits that have been entered.
    edits: usize,
    /// What led to each edit of the last step that is not at its start; `None` if that is not kept.
    parts: Option<Vec<Part>>,
    pub(super) handles: Handles,
}

/// Upper limits on the worlds that are kept of a step, and on their vertices.
const MOST_PARTS: usize = 16;
const MOST_KEPT_VERTICES: u64 = 1 << 19;

/// A part of a step that an edit divides, up to the edit.
#[derive(Clone)]
pub(crate) struct Part {
    /// The world before the edit is entered.
    pub world: World,
    /// The instant of the edit [s].
    pub end: f64,
}

impl World {
    /// The scene at t = 0: every displacement and velocity is zero.
    ///
    /// # Errors
    /// [`WorldError::Invalid`] if a program has given the scene a value that no scene file could have;
    /// [`WorldError::TooLarge`] if it needs more memory than is available, of which nothing has been allocated then.
    pub fn new(scene: Scene) -> Result<World, WorldError> {
        World::with_options(scene, Options::default())
    }

    /// Like [`World::new`], with options for stepping.
    ///
    /// # Errors
    /// [`WorldError`], as for [`World::new`].
    pub fn with_options(scene: Scene, options: Options) -> Result<World, WorldError> {
        scene.validate()?;
        let budget = memory::check(&scene)?;
        let (max_pairs, mut work) = (budget.max_pairs(&scene), Work::new(scene.vertex_count(), options.interrupt));
        let Some(solver) = Solver::new(&scene, max_pairs, &mut work) else {
            return Err(budget.exceeded(&scene, Some(max_pairs)).into());
        };
        let handles = Handles::new(scene.bodies.len());
        let report = StepReport { sleeping_bodies: scene.bodies.len() as u64, ..StepReport::default() };
        Ok(World { scene, options, step: 0, report, work, solver, edits: 0, parts: Some(Vec::new()), handles })
    }

    /// Continues with a changed scene at `time` [s]. `kept` is the former index of each body that keeps its state.
    pub(super) fn restart(&mut self, scene: Scene, kept: &[Option<usize>], time: f64) -> Result<(), EditError> {
        let budget = memory::check(&scene)?;
        let max_pairs = budget.max_pairs(&scene);
        let mut work = Work::new(scene.vertex_count(), self.options.interrupt);
        let solver = if self.step > 0 || self.edits > 0 {
            let setting = Setting { scene: &scene, ..self.setting() };
            let takeover = Takeover { scene: &self.scene, kept, time, max_pairs };
            let mut solver = Solver::undeformed(&scene);
            let is_resumed = solver.resume(setting, &self.solver, &takeover, &mut self.report)?;
            if is_resumed {
                work.resume(&mut self.work);
            }
            is_resumed.then_some(solver)
        } else {
            Solver::new(&scene, max_pairs, &mut work)
        };
        let Some(solver) = solver else { return Err(budget.exceeded(&scene, Some(max_pairs)).into()) };
        (self.scene, self.solver, self.work) = (scene, solver, work);
        Ok(())
    }

    /// Enters the scene's next edit at `time` [s].
    fn enter_edit(&mut self, time: f64) -> Result<(), Failure> {
        let scene = self.scene.after_edit(self.edits);
        self.edits += 1;
        let kept: Vec<Option<usize>> = (0..scene.bodies.len()).map(Some).collect();
        let step = self.step + 1;
        let failed = |error: EditError| Failure::Edit { step, time, error: Box::new(error) };
        self.restart(scene, &kept, time).map_err(failed)
    }

    /// Advances the world by one step of the scene's Δt and reports what happened.
    ///
    /// A step that is not completed ([`Failure::Overworked`], [`Failure::Interrupted`]) does not count as taken: from
    /// then on the state is meaningless and the world takes no further step. [`World::run`] makes it an error.
    ///
    /// [`Failure::Overworked`]: super::Failure::Overworked
    /// [`Failure::Interrupted`]: super::Failure::Interrupted
    #[must_use = "a step can fail: see `StepReport::failure`"]
    pub fn step(&mut self) -> &StepReport {
        if self.report.failure.as_ref().is_some_and(|failure| !failure.is_whole_step()) {
            return &self.report;
        }
        let span = Span { start: self.time(), end: self.time_of(self.step + 1) };
        self.report.begin(self.step + 1, span.end);
        self.parts.get_or_insert_default().clear();
        match self.advance(span) {
            Ok(diverged) => {
                self.step += 1;
                self.report.failure = diverged.map(|body| self.divergence(body).into());
            }
            Err(failure) => self.report.failure = Some(failure),
        }
        &self.report
    }

    /// Takes a number of steps, and returns the events on the way.
    ///
    /// # Errors
    /// The failure that ended the run before; the events until then are lost.
    pub fn run(&mut self, steps: u64) -> Result<Vec<Event>, Failure> {
        let mut events = Vec::new();
        for _ in 0..steps {
            let report = self.step();
            if let Some(failure) = &report.failure {
                return Err(failure.clone());
            }
            events.extend_from_slice(&report.events);
        }
        Ok(events)
    }

    /// Advances the world over `span`, and enters the scene's edits on the way. Returns the first body whose state is
    /// invalid afterwards.
    fn advance(&mut self, span: Span) -> Result<Option<usize>, Failure> {
        let rounding = ROUNDING * span.length();
        let mut start = span.start;
        while let Some(edit) = self.scene.edits.get(self.edits).filter(|edit| edit.time < span.end - rounding) {
            let end = edit.time.max(start);
            if end > start + rounding {
                if let Some(diverged) = self.solve(Span { start, end }, true)? {
                    return Ok(Some(diverged));
                }
                start = end;
                self.keep_part(start);
            }
            self.enter_edit(start)?;
        }
        self.solve(Span { start, end: span.end }, start > span.start)
    }

    /// Keeps the world as it is now, at `end` [s], before an edit, as after a step.
    fn keep_part(&mut self, end: f64) {
        let Some(mut parts) = self.parts.take() else { return };
        let vertices = self.scene.vertex_count() * (parts.len() as u64 + 1);
        if parts.len() < MOST_PARTS && vertices <= MOST_KEPT_VERTICES {
            parts.push(Part { world: World { step: self.step + 1, ..self.clone() }, end });
            self.parts = Some(parts);
        }
    }

    /// Forgets the parts of the last step: bodies are about to change.
    pub(super) fn forget_parts(&mut self) {
        self.parts = None;
    }

    /// Lets the solver advance over a step, or a part of one.
    fn solve(&mut self, span: Span, is_partial: bool) -> Result<Option<usize>, Failure> {
        let earlier = self.report.take_sums();
        self.work.begin();
        let World { scene, options, step, report, work, solver, .. } = self;
        let setting = Setting { scene, step: *step, arch: options.arch, is_partial };
        let diverged = solver.step(&mut Step { setting, span, work, report });
        self.report.add_sums(earlier);
        diverged
    }

    /// Describes a body in an invalid state, and its worst vertex.
    fn divergence(&self, index: usize) -> Diverged {
        let body = self.body(index);
        let states = body.states();
        let size = |i: usize| states.displacement.get(i).length_squared() + states.velocity.get(i).length_squared();
        // NaN ranks worst
        let rank = |i: &usize| if size(*i).is_nan() { f64::INFINITY } else { size(*i) };
        let vertex = (0..body.vertex_count()).max_by(|i, j| rank(i).total_cmp(&rank(j))).unwrap_or_default();
        Diverged {
            integrator: self.scene.integrator,
            dt: self.scene.dt,
            step: self.step,
            time: self.time(),
            body: body.name().to_owned(),
            vertex,
            displacement: states.displacement.get(vertex),
            velocity: states.velocity.get(vertex),
        }
    }
}

/// Read access to the state.
impl World {
    /// The scene that is simulated, with what its edits have set so far: another world starts from it only without
    /// [`edits`](Scene::edits).
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Number of the scene's edits that have been entered.
    pub(crate) fn edits_entered(&self) -> usize {
        self.edits
    }

    /// The parts of the last step that its edits ended, in order; `None` if they were not kept.
    pub(crate) fn parts(&self) -> Option<&[Part]> {
        self.parts.as_deref()
    }

    /// Number of steps taken.
    pub fn steps_taken(&self) -> u64 {
        self.step
    }

    /// Simulated time [s]: steps taken times Δt.
    pub fn time(&self) -> f64 {
        self.time_of(self.step)
    }

    fn time_of(&self, step: u64) -> f64 {
        step as f64 * self.scene.dt
    }

    /// The report of the last step.
    pub fn report(&self) -> &StepReport {
        &self.report
    }

    /// A hash of the exact state: the number of steps taken, the bits of all stored state of every body that is not at
    /// rest, and every pair that is not apart. (Future events follow from these and from the scene.)
    ///
    /// Equal runs have equal checksums on every machine, for any number of threads and any instruction set, whatever is
    /// observed or recorded and however often this is called. Two states that differ in one number never have the same
    /// checksum; others do so only by chance.
    pub fn checksum(&self) -> u64 {
        checksum::of_world(self.step, self.solver.hash())
    }

    /// Number of bodies.
    pub fn body_count(&self) -> usize {
        self.scene.bodies.len()
    }

    /// Number of bodies that are undeformed, or that rest on or against each other.
    pub fn resting_count(&self) -> usize {
        match &self.solver {
            Solver::Prescribed(_) => self.bodies().filter(BodyView::is_at_rest).count(),
            Solver::Coupled(coupled) => self.body_count() - coupled.awake_count(),
        }
    }

    /// The handle of the body at an index, in the order of the scene.
    pub fn handle(&self, index: usize) -> Option<BodyHandle> {
        self.handles.of(index)
    }

    /// The index of a body, in the order of the scene; `None` if it has been removed.
    pub fn index_of(&self, handle: BodyHandle) -> Option<usize> {
        self.handles.index(handle)
    }

    /// A body; `None` if it has been removed.
    pub fn get(&self, handle: BodyHandle) -> Option<BodyView<'_>> {
        self.index_of(handle).map(|index| self.body(index))
    }

    /// Body `index`, in the order of the scene; panics if out of range.
    pub fn body(&self, index: usize) -> BodyView<'_> {
        let body = &self.scene.bodies[index];
        match &self.solver {
            Solver::Prescribed(prescribed) => prescribed.view(self.setting(), body, index),
            Solver::Coupled(coupled) => coupled.view(body, index),
        }
    }

    /// What the solver reads besides its own state.
    pub(super) fn setting(&self) -> Setting<'_> {
        Setting { scene: &self.scene, step: self.step, arch: self.options.arch, is_partial: false }
    }

    /// The options of this world.
    pub fn options(&self) -> Options {
        self.options
    }

    /// All bodies, in the order of the scene.
    pub fn bodies(&self) -> impl ExactSizeIterator<Item = BodyView<'_>> {
        (0..self.body_count()).map(|index| self.body(index))
    }

    /// Pairs in which one body's influence sphere can reach the other's vertices at their current amplitude, that are
    /// near enough to touch or merge, or that are not apart; in ascending order of their bodies. All other pairs are
    /// apart and do not interact.
    pub fn pairs(&self) -> impl Iterator<Item = PairView> + '_ {
        self.near_pairs()
            .map(|(a, b, phase)| {
                let [q, rate] = self.q_and_rate(a, b);
                PairView { a, b, q, rate, phase }
            })
            .filter(|pair| pair.phase != Phase::Apart || pair.q <= self.reach_of(pair.a, pair.b))
    }

    /// The pairs of [`World::pairs`], and others that may have been among them within the last step, with their phases; in
    /// ascending order of their bodies.
    pub(crate) fn near_pairs(&self) -> impl Iterator<Item = (usize, usize, Phase)> + '_ {
        let prescribed = self.solver.prescribed().into_iter().flat_map(Prescribed::phases);
        let coupled = self.solver.coupled().into_iter().flat_map(Coupled::pairs);
        prescribed.chain(coupled.map(|pair| (pair.a as usize, pair.b as usize, pair.phase)))
    }

    /// A bound on the acceleration of a body's centre in the last step, which has these ends [scene unit/s², s]; infinite if
    /// there is none, or if it is unknown.
    #[cfg(feature = "cli")]
    pub(crate) fn acceleration_within(&self, body: usize, ends: [f64; 2]) -> f64 {
        self.solver.prescribed().map_or(f64::INFINITY, |prescribed| prescribed.acceleration_within(body, ends))
    }

    /// Centre distance over the sum of the radii [–], and the rate at which it changes [1/s].
    fn q_and_rate(&self, a: usize, b: usize) -> [f64; 2] {
        let (a, b) = (self.body(a), self.body(b));
        let (apart, velocity) = (b.centre() - a.centre(), b.centre_velocity() - a.centre_velocity());
        let radii = a.scene().radius + b.scene().radius;
        [apart.length() / radii, apart.normalize_or_zero().dot(velocity) / radii]
    }

    /// The q up to which one of two bodies can have vertices inside the other's influence sphere, or the two can touch
    /// or merge [–].
    pub(crate) fn reach_of(&self, a: usize, b: usize) -> f64 {
        let vertices = |i: usize| match &self.solver {
            Solver::Prescribed(prescribed) => prescribed.extent(i),
            Solver::Coupled(coupled) => coupled.member(i).extent,
        };
        let sphere = |i: usize| self.scene.bodies[i].sphere_radius();
        let acting = f64::max(sphere(a) + vertices(b), sphere(b) + vertices(a));
        let touching = acting.max(vertices(a) + vertices(b));
        let radii = self.scene.bodies[a].radius + self.scene.bodies[b].radius;
        (touching / radii).max(self.scene.law(a, b).thresholds.merge_at)
    }

    /// The phase of the pair of bodies `a` and `b`, in any order; panics if out of range.
    pub fn phase(&self, a: usize, b: usize) -> Phase {
        let count = self.body_count();
        assert!(a < count && b < count, "there are {count} bodies, and no pair of {a} and {b}");
        match &self.solver {
            Solver::Prescribed(prescribed) => prescribed.phase(a, b),
            Solver::Coupled(coupled) => coupled.phase(a, b),
        }
    }

    /// What acts on body `index` in the current state, except its own oscillators; with free bodies, also without
    /// gravity, planes, reactions and the forces of a program.
    ///
    /// # Panics
    /// There is no such body.
    pub fn surroundings(&self, index: usize) -> Surroundings {
        let mut surroundings = Surroundings::default();
        self.surroundings_into(index, &mut surroundings);
        surroundings
    }

    /// Like [`World::surroundings`], into an existing value (reused).
    pub(crate) fn surroundings_into(&self, index: usize, surroundings: &mut Surroundings) {
        match &self.solver {
            Solver::Prescribed(prescribed) => prescribed.surroundings_into(self.setting(), index, surroundings),
            Solver::Coupled(coupled) => coupled.surroundings_into(&self.scene, index, self.time(), surroundings),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::prescribed::deformation::Deformation;

    /// The error of single precision: a run whose state is rounded to f32 after every step, compared with the f64 run.
    #[test]
    fn single_precision_is_not_enough() {
        let scene = Scene::builtin("two").unwrap();
        let (mut world, mut rounded) = (World::new(scene.clone()).unwrap(), World::new(scene).unwrap());
        let mut error = 0.0;
        for _ in 0..world.scene().steps() {
            let _ = world.step();
            let _ = rounded.step();
            let Solver::Prescribed(prescribed) = &mut rounded.solver else { unreachable!() };
            for active in prescribed.actives.all_mut() {
                let Deformation { active_set, free_vertices, .. } = &mut active.state.deformation;
                let of_active_set = active_set.blocks.all_mut().iter_mut().flat_map(|block| &mut block.0[..2]);
                let of_free_vertices = free_vertices.blocks.all_mut().iter_mut().flat_map(|block| &mut block.0);
                for number in of_active_set.chain(of_free_vertices).flatten().flatten() {
                    *number = f64::from(*number as f32);
                }
            }
            for (a, b) in world.bodies().zip(rounded.bodies()) {
                error = a.positions().zip(b.positions()).map(|(a, b)| a.distance(b)).fold(error, f64::max);
            }
        }
        assert!((2e-8..5e-7).contains(&error), "{error:e}"); // of a radius; seen: 1.5e-7
    }
}
