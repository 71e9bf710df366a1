//! The world: the state of every body and pair, and the step.

use std::{
    sync::{
        Arc, OnceLock,
        atomic::{AtomicBool, Ordering},
    },
    time::Instant,
};

use glam::{DQuat, DVec3};
use pulp::Arch;
use rayon::prelude::*;

use super::{
    active_set::ActiveSet,
    advance::Context,
    arrays::Vectors,
    body::{Active, Body},
    checksum,
    coupled::{Coupled, member::Member},
    deformation::Now,
    free::Ledger,
    integrator::exponential,
    memory::{self, TooLarge},
    pairs::{Moving, Pair, Pairs, Surrounded},
    report::{Diverged, EditError, Failure, Overworked, Shortfall, Stage, StepReport, Strain, Toil},
    span::Span,
    state::State,
    terms::{self, Moment, Surroundings},
    tracks::Tracks,
    work::{Stop, Tally, Work},
};
use crate::{
    geometry::{Mesh, Rest},
    model::phase::Phase,
    scene::{self, Path, Scene},
};

/// With fewer vertices than this to step, a second thread does not pay off.
const PARALLEL_VERTICES: usize = 2048;
/// With fewer bodies than this, a second thread does not pay off for the bounds on their vertices.
const PARALLEL_BODIES: usize = 512;
/// When a body outgrows its fat bounds, the new ones allow its vertices this factor of their current distance from
/// rest.
const ROOM: f64 = 1.5;

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

/// The bodies of a scene at an instant, advanced step by step.
pub struct World {
    scene: Scene,
    pub(super) options: Options,
    pub(super) step: u64,
    pub(super) bodies: Vec<Body>,
    /// Bodies that are not at rest.
    pub(super) actives: ActiveSet,
    tracks: Tracks,
    pub(super) pairs: Pairs,
    /// Buffer, reused.
    woken: Vec<u32>,
    /// Times at which terms begin to act on bodies by themselves [s], ascending, with the bodies' indices; …
    starts: Vec<(f64, u32)>,
    /// … and how many of them have begun.
    started: usize,
    /// Total number of vertices.
    vertices: u64,
    work: Work,
    report: StepReport,
    /// The bodies of a coupled scene, in place of `actives`, `tracks` and `pairs`.
    pub(super) coupled: Option<Coupled>,
    /// Energy brought to free bodies so far, by cause.
    pub(super) ledger: Ledger,
    /// Energy of free bodies at t = 0.
    pub(crate) first_energy: f64,
    /// Computed when the energy is first requested.
    pub(super) energy_of_distant_pairs: OnceLock<f64>,
}

impl World {
    /// The scene at t = 0: every displacement and velocity is zero.
    ///
    /// # Errors
    /// [`TooLarge`] if the scene needs more memory than is available; nothing has been allocated in that case.
    pub fn new(scene: Scene) -> Result<World, TooLarge> {
        World::with_options(scene, Options::default())
    }

    /// Like [`World::new`], with options for stepping.
    ///
    /// # Errors
    /// [`TooLarge`], as for [`World::new`].
    pub fn with_options(scene: Scene, options: Options) -> Result<World, TooLarge> {
        let budget = memory::check(&scene)?;
        let mut pushes = vec![Vec::new(); scene.bodies.len()];
        scene.pushes.iter().for_each(|push| pushes[push.body].push(*push));
        let bodies = pushes.into_iter().enumerate().map(|(index, pushes)| Body::new(&scene, index, pushes)).collect();
        let mut world = World {
            coupled: None,
            ledger: Ledger::default(),
            first_energy: 0.0,
            energy_of_distant_pairs: OnceLock::new(),
            step: 0,
            bodies,
            actives: ActiveSet::default(),
            tracks: Tracks::new(&scene),
            pairs: Pairs::default(),
            woken: Vec::new(),
            starts: terms::starts(&scene),
            started: 0,
            vertices: scene.vertex_count(),
            work: Work::new(options.interrupt),
            report: StepReport { sleeping_bodies: scene.bodies.len() as u64, ..StepReport::default() },
            options,
            scene,
        };
        let max_pairs = budget.max_pairs(&world.scene);
        if !world.start(max_pairs) {
            return Err(budget.exceeded(&world.scene, Some(max_pairs)));
        }
        Ok(world)
    }

    /// Continues with a changed scene; `kept` is the former index of each body that keeps its state.
    pub(super) fn restart(&mut self, scene: Scene, kept: &[Option<usize>], wake_all: bool) -> Result<(), EditError> {
        let mut world = World::with_options(scene, self.options)?;
        if self.step > 0 {
            let time = self.time();
            let (Some(before), Some(coupled)) = (&self.coupled, &mut world.coupled) else {
                return Err(EditError::Prescribed);
            };
            coupled.resume(&world.scene, before, kept, wake_all, time);
            (world.step, world.ledger) = (self.step, self.ledger);
            world.report = std::mem::take(&mut self.report);
            world.work = std::mem::take(&mut self.work);
        }
        *self = world;
        Ok(())
    }

    /// Finds the initial pairs; false if there are more than `max_pairs`.
    fn start(&mut self, max_pairs: u64) -> bool {
        if self.scene.is_coupled() {
            let meshes: Vec<Arc<Mesh>> = self.bodies.iter().map(|body| Arc::clone(&body.mesh)).collect();
            self.coupled = Coupled::new(&self.scene, &meshes, self.options.arch, max_pairs, &self.work);
            self.first_energy = self.conserved().map_or(0.0, |conserved| conserved.energy());
            return self.coupled.is_some();
        }
        let World { scene, bodies, tracks, pairs, work, .. } = self;
        if !pairs.start(scene, bodies, tracks, max_pairs, work) {
            return false;
        }
        let first_step =
            bodies.iter().map(|body| exponential::work_of(body.mesh.vertex_count(), body.neighbours.len()));
        self.work.expect(first_step.fold(0, u64::saturating_add));
        // A body with neighbours may be reached from the start; bodies that are not reached go back to sleep in the
        // first step.
        for index in 0..self.bodies.len() {
            if !self.bodies[index].neighbours.is_empty() {
                self.wake_one(index as u32);
            }
        }
        true
    }

    /// Advances the world by one step of the scene's Δt and reports what happened.
    ///
    /// A step that is not completed ([`Failure::Overworked`], [`Failure::Interrupted`]) does not count as taken: from
    /// then on the state is meaningless and the world takes no further step.
    pub fn step(&mut self) -> &StepReport {
        if self.report.failure.as_ref().is_some_and(|failure| !failure.is_whole_step()) {
            return &self.report;
        }
        let span = Span { start: self.time(), end: self.time_of(self.step + 1) };
        self.report.begin(self.step + 1, span.end);
        if let Err(failure) = self.take_step(span) {
            self.report.failure = Some(failure);
        }
        &self.report
    }

    fn take_step(&mut self, span: Span) -> Result<(), Failure> {
        self.work.begin(self.vertices);
        if let Some(coupled) = &mut self.coupled {
            self.report.error = 0.0; // it becomes the largest of this step
            let diverged = coupled.step(&self.scene, span, &mut self.work, &mut self.report)?;
            self.step += 1;
            self.ledger += self.report.ledger;
            self.report.failure = diverged.map(|body| self.divergence(body).into());
            return Ok(());
        }
        let start = Instant::now();
        self.broad_phase(span)?;
        let followed = Instant::now();
        self.find_events(span)?;
        let found = Instant::now();
        self.wake(span);
        self.find_bounds(span)?;
        let ready = Instant::now();
        let sum = self.integrate(span)?;
        self.step += 1;
        self.pairs.enter_phases();
        self.finish(&sum);
        self.sleep(&sum, span);
        self.report.timings[Stage::Reach as usize] = (followed - start) + (ready - found);
        self.report.timings[Stage::Events as usize] = found - followed;
        self.report.timings[Stage::Integrate as usize] = ready.elapsed();
        Ok(())
    }

    /// Bounds the motion of moving bodies during `span` and finds which bodies they come near.
    fn broad_phase(&mut self, span: Span) -> Result<(), Failure> {
        let World { scene, bodies, tracks, pairs, work, .. } = self;
        tracks.follow(span);
        let followed = pairs.follow(Moving { scene, bodies, tracks, work }, span);
        followed.map_err(|(stop, body)| self.neighbours_failure(stop, body))
    }

    /// Finds the exact times at which pairs change phase during `span`.
    fn find_events(&mut self, span: Span) -> Result<(), Failure> {
        let World { scene, bodies, tracks, pairs, report, work, .. } = self;
        let found = pairs.find_events(Moving { scene, bodies, tracks, work }, span, report.step, &mut report.events);
        found.map_err(|(stop, pair)| {
            let [a, b] = pair.map(|body| self.scene.bodies[body as usize].name.clone());
            self.failure(stop, Toil::Events { a, b, found: self.report.events.len() })
        })
    }

    fn neighbours_failure(&self, stop: Stop, body: u32) -> Failure {
        let body = self.scene.bodies[body as usize].name.clone();
        self.failure(stop, Toil::Neighbours { body, pairs: self.pairs.count() })
    }

    /// Why the current step is not completed.
    fn failure(&self, stop: Stop, toil: Toil) -> Failure {
        let step = self.step + 1;
        match stop {
            Stop::Interrupted => Failure::Interrupted { step },
            Stop::Overworked => Overworked { step, time: self.time(), toil }.into(),
        }
    }

    /// Wakes the bodies that something acts on during `span`.
    fn wake(&mut self, span: Span) {
        self.wake_acted_on(span);
        self.wake_moved(span);
    }

    /// Bounds how far vertices of awake bodies can move during `span`, and finds which bodies can reach them.
    fn find_bounds(&mut self, span: Span) -> Result<(), Failure> {
        let (context, actives) = self.context();
        let awake = actives.len();
        let any_left = AtomicBool::new(false);
        each(actives, actives.len() >= PARALLEL_BODIES, |_, active| {
            context.find_reachable(active, span);
            if context.left_fat_bounds(active) {
                any_left.store(true, Ordering::Relaxed);
            }
        });
        if !any_left.into_inner() {
            return Ok(());
        }
        for slot in 0..awake {
            loop {
                let active = &self.actives.awake()[slot];
                let (body, max_reach) = (active.body, active.bounds.max_reach);
                if !self.reading().left_fat_bounds(active) {
                    break;
                }
                let World { scene, bodies, tracks, pairs, work, .. } = self;
                let radius = scene.bodies[body as usize].radius;
                let mut surrounded = Surrounded { scene, bodies, tracks, work: Tally::new(work, None) };
                pairs.anchor(&mut surrounded, body as usize, radius + ROOM * (max_reach - radius), span.start);
                drop(surrounded);
                self.work.check().map_err(|stop| self.neighbours_failure(stop, body))?;
                let (context, actives) = self.context();
                context.find_reachable(&mut actives[slot], span);
            }
        }
        Ok(())
    }

    /// Wakes the bodies on which something begins to act before the end of `span`.
    fn wake_acted_on(&mut self, span: Span) {
        while let Some(&(start, body)) = self.starts.get(self.started) {
            if start >= span.end {
                break;
            }
            self.wake_one(body);
            self.started += 1;
        }
    }

    /// Wakes the bodies that respond to their own motion during `span`, those that a moving sphere can reach, and those
    /// whose vertices can move into a sphere.
    fn wake_moved(&mut self, span: Span) {
        if self.actives.awake().len() == self.bodies.len() {
            return; // spares large scenes a look at every mover
        }
        let World { tracks, bodies, actives, woken, .. } = self;
        let is_awake = |body: u32| actives.is_awake(&bodies[body as usize]);
        tracks.watch(|track| {
            let mut neighbours = bodies[track.body as usize].neighbours.iter();
            !track.is_idle && (!is_awake(track.body) || neighbours.any(|neighbour| !is_awake(neighbour.other)))
        });
        let mut watched = std::mem::take(woken);
        watched.clear();
        watched.extend(tracks.watched());
        for &mover in &watched {
            if !self.is_awake(mover) && self.reading().own_force(mover, span) > 0.0 {
                self.wake_one(mover);
            }
            for n in 0..self.bodies[mover as usize].neighbours.len() {
                let other = self.bodies[mover as usize].neighbours[n].other;
                let sleeping = [(mover, other), (other, mover)].into_iter().filter(|&(this, _)| !self.is_awake(this));
                let reached = sleeping.filter(|&(this, source)| {
                    let [radius, sphere] =
                        [self.tracks.motion_bounds(this).radius, self.tracks.motion_bounds(source).sphere];
                    let vertices = radius + self.active(this as usize).map_or(0.0, Active::amplitude);
                    self.reading().nearest(this, source, span) <= sphere + vertices
                });
                let [first, second] = {
                    let mut reached = reached.map(|(this, _)| this);
                    [reached.next(), reached.next()]
                };
                first.into_iter().chain(second).for_each(|this| self.wake_one(this));
            }
        }
        self.woken = watched;
    }

    fn is_awake(&self, body: u32) -> bool {
        self.actives.is_awake(&self.bodies[body as usize])
    }

    /// Wakes a body: it is stepped from now on.
    fn wake_one(&mut self, body: u32) {
        self.actives.wake(&self.scene, &mut self.bodies, body as usize, self.step);
    }

    /// What stepping a body reads.
    pub(super) fn reading(&self) -> Context<'_> {
        let World { scene, bodies, tracks, pairs, options: Options { arch, .. }, step, work, .. } = self;
        Context { scene, bodies, pairs, tracks, arch: *arch, step: *step, work }
    }

    /// What stepping a body reads, and the awake bodies.
    fn context(&mut self) -> (Context<'_>, &mut [Active]) {
        let World { scene, bodies, tracks, pairs, options: Options { arch, .. }, step, actives, work, .. } = self;
        (Context { scene, bodies, pairs, tracks, arch: *arch, step: *step, work }, actives.awake_mut())
    }

    /// Integrates the equation of motion of every awake body.
    fn integrate(&mut self, span: Span) -> Result<Sum, Failure> {
        self.work.begin_turns(self.actives.awake().len());
        let (context, actives) = self.context();
        let is_worth_threads = is_worth_threads(actives);
        let advance = |(turn, active): (usize, &mut Active)| {
            context.advance(active, turn, span);
            Sum::of(active, context.scene)
        };
        let sum = if is_worth_threads {
            actives.par_iter_mut().with_min_len(4).enumerate().map(advance).reduce(Sum::default, Sum::and)
        } else {
            actives.iter_mut().enumerate().map(advance).fold(Sum::default(), Sum::and)
        };
        if self.work.is_interrupted() {
            return Err(Failure::Interrupted { step: self.step + 1 });
        }
        let actives = self.actives.awake();
        if let Some(slot) = self.work.busiest(sum.work, actives.iter().map(|active| active.statistics.work)) {
            return Err(self.failure(Stop::Overworked, self.toil(&actives[slot])));
        }
        self.work.end(sum.work, sum.base, sum.vertices);
        if self.work.announce() {
            let busiest = self.actives.awake().iter().max_by_key(|active| active.statistics.work);
            let toil = busiest.map(|active| self.toil(active));
            self.report.strain = toil.map(|toil| Strain { step: self.step + 1, time: span.end, toil });
        }
        Ok(sum)
    }

    /// What a body does that takes so much work.
    fn toil(&self, active: &Active) -> Toil {
        let body = active.body as usize;
        let vertices = self.bodies[body].mesh.directions().len();
        Toil::Forces { body: self.scene.bodies[body].name.clone(), vertices, spheres: active.bounds.reachable.len() }
    }

    /// Writes the results of the step to the report, and whether it led to an invalid state.
    fn finish(&mut self, sum: &Sum) {
        self.report.substeps = sum.substeps;
        self.report.error = sum.error;
        self.report.shortfall = sum.shortfall;
        self.report.sleeping_bodies = self.bodies.len() as u64 - sum.stepped;
        self.report.failure = sum.diverged.map(|index| self.divergence(index as usize).into());
    }

    /// Puts bodies to sleep on which nothing acted.
    fn sleep(&mut self, sum: &Sum, span: Span) {
        if !sum.any_idle {
            return;
        }
        let World { scene, bodies, tracks, pairs, options: Options { arch, .. }, step, actives, work, .. } = self;
        actives.sleep(bodies, |bodies, active| {
            let context = Context { scene, bodies, pairs, tracks, arch: *arch, step: *step, work };
            active.statistics.substeps == 0 && active.bounds.may_sleep && context.own_force(active.body, span) == 0.0
        });
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

/// Whether the bodies' steps take long enough for several threads to pay off.
fn is_worth_threads(actives: &[Active]) -> bool {
    // a body without an active set costs about as much as one of a few vertices
    let cost = |active: &Active| 8 + active.state.deformation.active_set.vertices.len();
    let enough = |sum: &mut usize, active: &Active| {
        *sum += cost(active);
        (*sum < PARALLEL_VERTICES).then_some(())
    };
    actives.iter().scan(0, enough).count() < actives.len()
}

/// Applies `work` to every awake body, on several threads if that pays off.
fn each(actives: &mut [Active], is_worth_threads: bool, work: impl Fn(usize, &mut Active) + Sync + Send) {
    if is_worth_threads {
        actives.par_iter_mut().with_min_len(4).enumerate().for_each(|(slot, active)| work(slot, active));
    } else {
        actives.iter_mut().enumerate().for_each(|(slot, active)| work(slot, active));
    }
}

/// Results of the steps of some bodies; the order of summation does not matter.
#[derive(Clone, Copy, Default)]
struct Sum {
    stepped: u64,
    substeps: u64,
    error: f64,
    /// The one with the largest ratio to the tolerance; of equal ones the first body's.
    shortfall: Option<Shortfall>,
    work: u64,
    base: u64,
    /// Number of vertices that were stepped.
    vertices: u64,
    /// The first body in an invalid state.
    diverged: Option<u32>,
    /// Whether there is a body on which nothing acted.
    any_idle: bool,
}

impl Sum {
    fn of(active: &Active, scene: &Scene) -> Sum {
        let statistics = active.statistics;
        let is_idle = statistics.substeps == 0;
        Sum {
            stepped: u64::from(!is_idle),
            substeps: statistics.substeps,
            error: f64::max(0.0, statistics.error / scene.bodies[active.body as usize].radius),
            shortfall: shortfall(active, scene),
            work: statistics.work,
            base: statistics.base,
            vertices: active.state.deformation.active_set.vertices.len() as u64,
            diverged: active.has_diverged().then_some(active.body),
            any_idle: is_idle,
        }
    }

    fn and(self, other: Sum) -> Sum {
        Sum {
            stepped: self.stepped + other.stepped,
            substeps: self.substeps + other.substeps,
            error: self.error.max(other.error),
            shortfall: worse(self.shortfall, other.shortfall),
            work: self.work.saturating_add(other.work),
            base: self.base.saturating_add(other.base),
            vertices: self.vertices + other.vertices,
            diverged: self.diverged.into_iter().chain(other.diverged).min(),
            any_idle: self.any_idle || other.any_idle,
        }
    }
}

/// The error of a body's step, if it exceeds the tolerance because steps cannot be made shorter.
fn shortfall(active: &Active, scene: &Scene) -> Option<Shortfall> {
    let body = active.body as usize;
    let (allowed, excess) = (scene.tolerance * scene.dt, active.statistics.excess / scene.bodies[body].radius);
    (excess > 0.0).then_some(Shortfall { body, error: allowed + excess, allowed })
}

/// The shortfall with the larger error; of equal ones the first body's.
fn worse(a: Option<Shortfall>, b: Option<Shortfall>) -> Option<Shortfall> {
    let (Some(one), Some(other)) = (a, b) else { return a.or(b) };
    let is_other = other.error > one.error || other.error == one.error && other.body < one.body;
    if is_other { b } else { a }
}

/// Read access to the state.
impl World {
    /// The scene that is simulated.
    pub fn scene(&self) -> &Scene {
        &self.scene
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
        if let Some(coupled) = &self.coupled {
            return checksum::of_world(self.step, coupled.hash());
        }
        checksum::of_world(self.step, self.actives.hash().wrapping_add(self.pairs.hash()))
    }

    /// Number of bodies.
    pub fn body_count(&self) -> usize {
        self.bodies.len()
    }

    /// Number of bodies that are undeformed, or that rest on or against each other.
    pub fn resting_count(&self) -> usize {
        match &self.coupled {
            Some(coupled) => self.body_count() - coupled.awake_count(),
            None => self.bodies().filter(BodyView::is_at_rest).count(),
        }
    }

    /// Body `index`, in the order of the scene; panics if out of range.
    pub fn body(&self, index: usize) -> BodyView<'_> {
        let body = &self.scene.bodies[index];
        let active = self.active(index);
        let now = Now {
            step: self.step,
            dt: self.scene.dt,
            oscillator: active.map(|active| active.state.oscillator).unwrap_or_default(),
            arch: self.options.arch,
        };
        let member = self.coupled.as_ref().map(|coupled| coupled.member(index));
        BodyView {
            body,
            fixed: &self.bodies[index],
            active,
            member,
            now,
            path: self.path(index),
            centre: member.map_or_else(|| self.path(index).position(self.time()), |member| member.body.centre),
        }
    }

    /// The path of body `index`.
    pub(crate) fn path(&self, index: usize) -> &Path {
        self.tracks.path(index)
    }

    fn active(&self, index: usize) -> Option<&Active> {
        self.actives.get(&self.bodies[index])
    }

    /// The options of this world.
    pub fn options(&self) -> Options {
        self.options
    }

    /// Memory allocated for the state [bytes].
    pub fn memory(&self) -> usize {
        self.bodies.iter().map(Body::memory).sum::<usize>()
            + self.actives.memory()
            + self.bodies.capacity() * size_of::<Body>()
            + self.pairs.memory()
            + self.tracks.memory()
            + self.coupled.as_ref().map_or(0, Coupled::memory)
            + memory::of_scene_bodies(&self.scene)
    }

    /// All bodies, in the order of the scene.
    pub fn bodies(&self) -> impl ExactSizeIterator<Item = BodyView<'_>> {
        (0..self.bodies.len()).map(|index| self.body(index))
    }

    /// Pairs in which one body's influence sphere can reach the other's vertices at their current amplitude, that are
    /// near enough to merge, or that are not apart; in ascending order of their bodies. All other pairs are apart and
    /// do not interact.
    pub fn pairs(&self) -> impl Iterator<Item = PairView> + '_ {
        let time = self.time();
        let coupled = self.coupled.iter().flat_map(Coupled::pairs).map(|pair| {
            let (a, b) = (pair.a as usize, pair.b as usize);
            PairView { a, b, q: self.q_of(a, b), phase: pair.phase }
        });
        self.known_pairs()
            .map(move |pair| {
                let q = self.tracks.pair(pair.a, pair.b).q(time);
                PairView { a: pair.a as usize, b: pair.b as usize, q, phase: pair.phase }
            })
            .chain(coupled)
            .filter(|pair| pair.phase != Phase::Apart || pair.q <= self.reach_of(pair.a, pair.b))
    }

    /// Centre distance over the sum of the radii [–].
    fn q_of(&self, a: usize, b: usize) -> f64 {
        let (a, b) = (self.body(a), self.body(b));
        a.centre().distance(b.centre()) / (a.scene().radius + b.scene().radius)
    }

    /// All pairs that are near each other or not apart, in ascending order of their bodies.
    fn known_pairs(&self) -> impl Iterator<Item = &Pair> + '_ {
        (0..).zip(&self.bodies).flat_map(|(index, body)| {
            let later = body.neighbours.iter().filter(move |neighbour| neighbour.other > index);
            later.map(|neighbour| self.pairs.get(neighbour.pair))
        })
    }

    /// Bodies and phase of every pair that may not be apart.
    pub(crate) fn phases(&self) -> impl Iterator<Item = (usize, usize, Phase)> + '_ {
        self.known_pairs().map(|pair| (pair.a as usize, pair.b as usize, pair.phase))
    }

    /// The q up to which one of two bodies can have vertices inside the other's influence sphere, or the two can merge
    /// [–].
    fn reach_of(&self, a: usize, b: usize) -> f64 {
        let vertices = |i: usize| match &self.coupled {
            Some(coupled) => coupled.member(i).extent,
            None => self.scene.bodies[i].radius + self.active(i).map_or(0.0, Active::amplitude),
        };
        let sphere = |i: usize| self.scene.influence.sphere_radius(self.scene.bodies[i].radius);
        let touching = f64::max(sphere(a) + vertices(b), sphere(b) + vertices(a));
        let radii = self.scene.bodies[a].radius + self.scene.bodies[b].radius;
        (touching / radii).max(self.scene.law(a, b).thresholds.merge_at)
    }

    /// The phase of the pair of bodies `a` and `b`.
    pub fn phase(&self, a: usize, b: usize) -> Phase {
        if let Some(coupled) = &self.coupled {
            return coupled.phase(a, b);
        }
        let neighbours = &self.bodies[a].neighbours;
        let found = neighbours.binary_search_by_key(&(b as u32), |neighbour| neighbour.other);
        found.map_or(Phase::Apart, |index| self.pairs.get(neighbours[index].pair).phase)
    }

    /// What acts on body `index` in the current state, except its own oscillators.
    pub fn surroundings(&self, index: usize) -> Surroundings {
        let mut surroundings = Surroundings::default();
        self.surroundings_into(index, &mut surroundings);
        surroundings
    }

    /// Like [`World::surroundings`], into an existing value (reused).
    pub(crate) fn surroundings_into(&self, index: usize, surroundings: &mut Surroundings) {
        if let Some(coupled) = &self.coupled {
            coupled.surroundings_into(&self.scene, index, self.time(), surroundings);
            return;
        }
        let time = self.time();
        let farthest = self.scene.bodies[index].radius + self.active(index).map_or(0.0, Active::amplitude);
        self.reading().on(index as u32).surroundings_into(Moment { time, phases_at: time }, farthest, surroundings);
    }
}

/// A body of the world at its current time.
#[derive(Clone, Copy)]
pub struct BodyView<'a> {
    body: &'a scene::Body,
    fixed: &'a Body,
    active: Option<&'a Active>,
    /// The body of a coupled scene.
    member: Option<&'a Member>,
    now: Now,
    path: &'a Path,
    centre: DVec3,
}

/// The states of all vertices of a body.
#[derive(Clone, Debug, Default)]
pub struct States {
    /// Displacements x from rest [scene unit], `[vertex_count]`.
    pub displacement: Vectors,
    /// Velocities x′ of these [scene unit/s], `[vertex_count]`.
    pub velocity: Vectors,
}

impl<'a> BodyView<'a> {
    /// The scene's description of the body.
    pub fn scene(&self) -> &'a scene::Body {
        self.body
    }

    /// Its name.
    pub fn name(&self) -> &'a str {
        &self.body.name
    }

    /// World position of its centre [scene unit].
    pub fn centre(&self) -> DVec3 {
        self.centre
    }

    /// Rotation of the body from its rest orientation.
    pub fn rotation(&self) -> DQuat {
        self.member.map_or(DQuat::IDENTITY, |member| member.body.rotation)
    }

    /// Velocity of its centre [scene unit/s].
    pub fn centre_velocity(&self) -> DVec3 {
        match self.member {
            Some(member) => member.body.velocity,
            None => self.path.at(self.now.step as f64 * self.now.dt).velocity,
        }
    }

    /// Angular velocity of the body [rad/s].
    pub fn angular_velocity(&self) -> DVec3 {
        self.member.map_or(DVec3::ZERO, |member| member.spin())
    }

    /// Whether every displacement and velocity is exactly zero.
    pub fn is_at_rest(&self) -> bool {
        self.active.is_none_or(Active::is_at_rest) && !self.member.is_some_and(Member::is_deformed)
    }

    /// Number of vertices.
    pub fn vertex_count(&self) -> usize {
        self.fixed.rest().len()
    }

    /// Its rest shape.
    pub fn mesh(&self) -> &'a Mesh {
        &self.fixed.mesh
    }

    /// Its rest shape at its scale, in the axes of the body.
    pub fn rest_shape(&self) -> Rest<'a> {
        self.fixed.rest()
    }

    /// Rest position l of vertex `i` from the centre, in the axes of the body [scene unit]; panics if out of range.
    pub fn rest(&self, i: usize) -> DVec3 {
        self.fixed.rest().position(i)
    }

    /// Direction l̂ = l/|l| of the rest position of vertex `i`, in the axes of the body [–]; panics if out of range.
    pub fn direction(&self, i: usize) -> DVec3 {
        self.fixed.rest().direction(i)
    }

    /// The states of all vertices; faster than computing them one by one.
    pub fn states(&self) -> States {
        let mut states = States::default();
        self.states_into(&mut states);
        states
    }

    /// Like [`BodyView::states`], into an existing value (reused).
    pub fn states_into(&self, states: &mut States) {
        let States { displacement, velocity } = states;
        if let Some(member) = self.member {
            member.states_into(displacement, velocity);
            return;
        }
        if let Some(active) = self.active.filter(|active| active.state.carried.is_zero() && !active.is_at_rest()) {
            displacement.resize(self.vertex_count());
            velocity.resize(self.vertex_count());
            if active.state.deformation.all_free_into(displacement, velocity, self.now) {
                return;
            }
        }
        displacement.reset(self.vertex_count());
        velocity.reset(self.vertex_count());
        let Some(active) = self.active.filter(|active| !active.is_at_rest()) else { return };
        let State { x, u } = active.carried_at(self.now);
        displacement.fill(x);
        velocity.fill(u);
        active.state.deformation.add_to(displacement, velocity, self.now);
    }

    /// Displacement x and velocity x′ of vertex `i`.
    fn state_of(&self, i: usize) -> State {
        if let Some(member) = self.member {
            let of = |vectors: &[DVec3]| vectors.get(i).copied().unwrap_or_default();
            return State { x: of(&member.body.x), u: of(&member.body.u) };
        }
        let Some(active) = self.active else { return State::default() };
        let alike = active.carried_at(self.now);
        let own = active.state.deformation.state(i, self.now);
        State { x: alike.x + own.x, u: alike.u + own.u }
    }

    /// Displacement x of vertex `i` from rest, in the axes of the world [scene unit].
    pub fn displacement(&self, i: usize) -> DVec3 {
        self.state_of(i).x
    }

    /// Velocity x′ of the displacement of vertex `i` [scene unit/s].
    pub fn velocity(&self, i: usize) -> DVec3 {
        self.state_of(i).u
    }

    /// Position of vertex `i` relative to the centre, Q l + x, in the axes of the world [scene unit].
    pub fn local_position(&self, i: usize) -> DVec3 {
        self.turned(self.rest(i)) + self.displacement(i)
    }

    /// Q l.
    fn turned(&self, rest: DVec3) -> DVec3 {
        if self.member.is_some() { self.rotation() * rest } else { rest }
    }

    /// World position r = c + Q l + x of vertex `i` [scene unit].
    pub fn position(&self, i: usize) -> DVec3 {
        self.centre + self.local_position(i)
    }

    /// World positions of all vertices [scene unit].
    pub fn positions(self) -> impl ExactSizeIterator<Item = DVec3> + 'a {
        let states = self.states();
        (0..self.vertex_count()).map(move |i| self.centre + (self.turned(self.rest(i)) + states.displacement.get(i)))
    }

    /// The largest |x| of its vertices [scene unit].
    pub fn max_displacement(&self) -> f64 {
        if self.is_at_rest() {
            return 0.0;
        }
        self.states().displacement.iter().map(DVec3::length_squared).fold(0.0, f64::max).sqrt()
    }
}

/// A pair of bodies at the world's current time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PairView {
    /// Index of the first body.
    pub a: usize,
    /// Index of the second body; `a < b`.
    pub b: usize,
    /// Centre distance over the sum of the radii [–].
    pub q: f64,
    /// The phase of the pair, which determines how the two act on each other.
    pub phase: Phase,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::deformation::Deformation;

    /// The error of single precision: a run whose state is rounded to f32 after every step, compared with the f64 run.
    #[test]
    fn single_precision_is_not_enough() {
        let scene = Scene::builtin("two").unwrap();
        let (mut world, mut rounded) = (World::new(scene.clone()).unwrap(), World::new(scene).unwrap());
        let mut error = 0.0;
        for _ in 0..world.scene().steps() {
            world.step();
            rounded.step();
            for active in rounded.actives.all_mut() {
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
