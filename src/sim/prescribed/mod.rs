//! The solver of scenes whose bodies are all on paths. Their centres are known, so each body is stepped on its own, and
//! the times at which pairs change phase are found ahead.
//!
//! | contents | module |
//! | --- | --- |
//! | the stages of a step | here |
//! | the motion of all centres during a step | [`tracks`] |
//! | pairs of bodies that are near each other, and when they change phase | [`pairs`] |
//! | the state of a body; the bodies that are not at rest | [`body`], [`active_set`] |
//! | how a body is advanced, and which of its vertices | [`advance`], [`deformation`] |
//! | the last step, recomputed for debugging and for states within it | [`within`] |

pub(super) mod active_set;
pub(super) mod advance;
pub(super) mod body;
pub(super) mod deformation;
pub(super) mod pairs;
pub(super) mod tracks;
pub(crate) mod within;

use std::sync::{
    OnceLock,
    atomic::{AtomicBool, Ordering},
};

use rayon::prelude::*;

use self::{
    active_set::ActiveSet,
    advance::Context,
    body::{Active, Body},
    deformation::Now,
    pairs::{Pair, Pairs, Surrounded},
    tracks::Tracks,
    within::Known,
};
use super::{
    body::{BodyView, Solved},
    integrator::{explicit::Scheme, exponential},
    neighbours::later_neighbours,
    on_request::OnRequest,
    report::{Failure, Shortfall, Stage, StepReport, Stopwatch, Strain, Toil},
    solver::{Setting, Step, Takeover},
    span::Span,
    terms::{Moment, Surroundings, spheres},
    work::{Stop, Tally, Work},
};
use crate::{
    model::phase::Phase,
    scene::{self, Scene},
};

/// With fewer vertices than this to step, a second thread does not pay off.
const PARALLEL_VERTICES: usize = 2048;
/// With fewer bodies than this, a second thread does not pay off for the bounds on their vertices.
const PARALLEL_BODIES: usize = 512;
/// When a body outgrows its fat bounds, the new ones allow its vertices this factor of their current distance from
/// rest.
const ROOM: f64 = 1.5;

/// The bodies of a scene, all of which are on paths.
#[derive(Clone)]
pub(super) struct Prescribed {
    pub bodies: Vec<Body>,
    /// Bodies that are not at rest.
    pub actives: ActiveSet,
    tracks: Tracks,
    pub pairs: Pairs,
    /// Buffer, reused.
    woken: Vec<u32>,
    /// Computed when the energy is first requested.
    energy_of_distant_pairs: OnceLock<f64>,
    /// States within the last step.
    known: OnRequest<Known>,
}

impl Prescribed {
    /// The bodies at t = 0; `None` if there are more than `max_pairs` pairs of nearby bodies.
    pub fn new(scene: &Scene, max_pairs: u64, work: &mut Work) -> Option<Prescribed> {
        let mut prescribed = Prescribed::undeformed(scene);
        let Prescribed { bodies, tracks, pairs, .. } = &mut prescribed;
        if !pairs.start(scene, bodies, tracks, 0.0, max_pairs, work) {
            return None;
        }
        let first_step = |body: &Body| exponential::work_of(body.mesh.vertex_count(), body.neighbours.len());
        work.expect(prescribed.bodies.iter().map(first_step).fold(0, u64::saturating_add));
        prescribed.wake_neighbours(scene, 0);
        Some(prescribed)
    }

    /// Undeformed bodies, without pairs.
    pub fn undeformed(scene: &Scene) -> Prescribed {
        let mut pushes = vec![Vec::new(); scene.bodies.len()];
        scene.pushes.iter().for_each(|push| pushes[push.body].push(*push));
        let bodies = pushes.into_iter().enumerate().map(|(index, pushes)| Body::new(scene, index, pushes));
        Prescribed {
            bodies: bodies.collect(),
            actives: ActiveSet::default(),
            tracks: Tracks::new(scene),
            pairs: Pairs::new(scene),
            woken: Vec::new(),
            energy_of_distant_pairs: OnceLock::new(),
            known: OnRequest::default(),
        }
    }

    /// Wakes the bodies that may be reached from the start. Those that are not go back to sleep in the first step.
    fn wake_neighbours(&mut self, scene: &Scene, step: u64) {
        for index in 0..self.bodies.len() {
            if !self.bodies[index].neighbours.is_empty() {
                self.actives.wake(scene, &mut self.bodies, index, step);
            }
        }
    }

    /// Takes over the state of another scene, and reports the phase changes that this brings. False if there are too many
    /// pairs.
    pub fn resume(
        &mut self,
        setting: Setting<'_>,
        before: &Prescribed,
        takeover: &Takeover<'_>,
        report: &mut StepReport,
    ) -> bool {
        let Setting { scene, step, arch, .. } = setting;
        for (index, kept) in takeover.kept.iter().enumerate() {
            if let Some(active) = kept.and_then(|old| before.active(old)) {
                let mut active = active.clone();
                active.body = index as u32;
                active.settle(step, scene.dt, self.bodies[index].rest(), arch);
                active.change_oscillator(&scene.bodies[index].material, arch);
                self.actives.insert(&mut self.bodies, active);
            }
        }
        let now_at = takeover.now_at(before.bodies.len());
        let phases = before.phases().filter(|&(_, _, phase)| phase != Phase::Apart);
        let phases = phases.filter_map(|(a, b, phase)| Some((now_at[a]?, now_at[b]?, phase)));
        let Prescribed { bodies, tracks, pairs, .. } = self;
        let work = Work::limited(u64::MAX, None);
        if !pairs.start(scene, bodies, tracks, takeover.time, takeover.max_pairs, &work) {
            return false;
        }
        let surrounded = Surrounded { scene, bodies, tracks, time: takeover.time };
        pairs.resume(surrounded, phases, takeover, report);
        self.wake_neighbours(scene, step);
        true
    }

    /// Adds the last body of the scene. False, and nothing has changed, if there would be more than `max_pairs` pairs.
    pub fn add_last(&mut self, setting: Setting<'_>, max_pairs: u64) -> bool {
        let (scene, last) = (setting.scene, self.bodies.len());
        self.bodies.push(Body::new(scene, last, Vec::new()));
        self.tracks.insert(scene, last, setting.time());
        let is_entered = self.enter(setting, last, max_pairs);
        if !is_entered {
            self.bodies.pop();
            self.tracks.remove(last);
        }
        is_entered
    }

    /// Removes a body of the scene, which has it still.
    pub fn remove(&mut self, setting: Setting<'_>, body: usize) {
        let (scene, time) = (setting.scene, setting.time());
        let Prescribed { bodies, actives, tracks, pairs, .. } = self;
        actives.drop_state(bodies, body);
        actives.renumber(body as u32);
        pairs.near.remove(&mut Surrounded { scene, bodies, tracks, time }, body as u32);
        bodies.remove(body);
        tracks.remove(body);
        self.energy_of_distant_pairs = OnceLock::new();
    }

    /// Gives a body the path that the scene has for it now. It becomes undeformed.
    pub fn restart(&mut self, setting: Setting<'_>, body: usize) {
        let (scene, time) = (setting.scene, setting.time());
        let Prescribed { bodies, actives, tracks, pairs, .. } = self;
        actives.drop_state(bodies, body);
        pairs.near.isolate(&mut Surrounded { scene, bodies, tracks, time }, body as u32);
        tracks.remove(body);
        tracks.insert(scene, body, time);
        self.enter(setting, body, u64::MAX);
    }

    /// Finds the pairs of a body that starts now, and wakes them.
    fn enter(&mut self, setting: Setting<'_>, body: usize, max_pairs: u64) -> bool {
        let Prescribed { bodies, tracks, pairs, .. } = self;
        let of = Surrounded { scene: setting.scene, bodies, tracks, time: setting.time() };
        if !pairs.enter_body(of, body, max_pairs) {
            return false;
        }
        let near: Vec<u32> = self.bodies[body].neighbours.iter().map(|neighbour| neighbour.other).collect();
        if !near.is_empty() {
            near.into_iter().chain([body as u32]).for_each(|one| self.wake(setting, one));
        }
        self.energy_of_distant_pairs = OnceLock::new();
        true
    }

    /// Adds a push, which the scene has already.
    pub fn push(&mut self, push: &scene::Push) {
        let pushes = &mut self.bodies[push.body].pushes;
        *pushes = std::mem::take(pushes).into_vec().into_iter().chain([*push]).collect();
    }

    /// Takes a step, stage by stage. Returns the first body whose state is invalid afterwards.
    ///
    /// # Errors
    /// The step could not be completed.
    pub fn step(&mut self, step: &mut Step<'_>) -> Result<Option<usize>, Failure> {
        let mut stopwatch = Stopwatch::start();
        self.known = OnRequest::default();
        if step.setting.is_partial {
            self.actives.wake_all();
        }
        self.find_neighbours(step)?;
        stopwatch.stop(Stage::Reach, step.report);
        self.find_events(step)?;
        stopwatch.stop(Stage::Events, step.report);
        self.wake_pushed(step);
        self.wake_moved(step);
        self.wake_near_points(step);
        self.find_bounds(step)?;
        stopwatch.stop(Stage::Reach, step.report);
        let sum = self.integrate(step)?;
        self.pairs.enter_phases();
        self.sleep(&sum, step);
        stopwatch.stop(Stage::Integrate, step.report);
        Ok(sum.diverged.map(|body| body as usize))
    }

    /// Bounds the motion of moving bodies during the step and finds which bodies they come near.
    fn find_neighbours(&mut self, step: &Step<'_>) -> Result<(), Failure> {
        let Prescribed { bodies, tracks, pairs, .. } = self;
        tracks.evaluate(step.setting.scene, step.span);
        pairs.update(bodies, tracks, step).map_err(|(stop, body)| too_many_neighbours(step, stop, body, pairs))
    }

    /// Finds the exact times at which pairs change phase during the step.
    fn find_events(&mut self, step: &mut Step<'_>) -> Result<(), Failure> {
        let Prescribed { bodies, tracks, pairs, .. } = self;
        pairs.find_events(bodies, tracks, step).map_err(|(stop, pair)| {
            let [a, b] = pair.map(|body| step.setting.scene.bodies[body as usize].name.clone());
            step.failure(stop, Toil::Events { a, b, found: step.report.events.len() })
        })
    }

    /// Wakes the bodies on which pushes act before the end of the step, or for an explicit scheme, which evaluates the
    /// forces there, at its end.
    fn wake_pushed(&mut self, step: &Step<'_>) {
        let end = match Scheme::of(step.setting.scene.integrator) {
            Some(_) => step.span.end.next_up(),
            None => step.span.end,
        };
        step.pushed_before(end).for_each(|body| self.wake(step.setting, body));
    }

    /// Wakes the bodies that respond to their own motion during the step, those that a moving sphere can reach, and
    /// those whose vertices can move into a sphere.
    fn wake_moved(&mut self, step: &Step<'_>) {
        if self.actives.awake().len() == self.bodies.len() {
            return; // large scenes need not visit every mover
        }
        let Prescribed { tracks, bodies, actives, woken, .. } = self;
        let is_awake = |body: u32| actives.is_awake(&bodies[body as usize]);
        tracks.watch(|track| {
            let mut neighbours = bodies[track.body as usize].neighbours.iter();
            !track.is_idle && (!is_awake(track.body) || neighbours.any(|neighbour| !is_awake(neighbour.other)))
        });
        let mut watched = std::mem::take(woken);
        watched.clear();
        watched.extend(tracks.watched());
        let (setting, span) = (step.setting, step.span);
        for &mover in &watched {
            if !self.is_awake(mover) && self.reading(setting, step.work).own_force(mover, span) > 0.0 {
                self.wake(setting, mover);
            }
            for n in 0..self.bodies[mover as usize].neighbours.len() {
                let other = self.bodies[mover as usize].neighbours[n].other;
                for (this, source) in [(mover, other), (other, mover)] {
                    if self.is_awake(this) {
                        continue;
                    }
                    let reach = self.tracks.motion_bounds(source).sphere + self.extent(this as usize);
                    if self.reading(setting, step.work).nearest(this, source, span) <= reach {
                        self.wake(setting, this);
                    }
                }
            }
        }
        self.woken = watched;
    }

    /// Wakes the bodies near which a force point acts during the step.
    fn wake_near_points(&mut self, step: &Step<'_>) {
        if step.setting.scene.points.is_empty() {
            return;
        }
        let tally = Tally::new(step.work, None);
        for body in 0..self.bodies.len() as u32 {
            if !tally.spend(step.setting.scene.points.len() as u64) {
                return;
            }
            let reading = self.reading(step.setting, step.work);
            if !self.is_awake(body) && reading.is_near_point(body, self.extent(body as usize), step.span) {
                self.wake(step.setting, body);
            }
        }
    }

    fn is_awake(&self, body: u32) -> bool {
        self.actives.is_awake(&self.bodies[body as usize])
    }

    /// Wakes a body: it is stepped from now on.
    fn wake(&mut self, setting: Setting<'_>, body: u32) {
        self.actives.wake(setting.scene, &mut self.bodies, body as usize, setting.step);
    }

    /// Bounds how far vertices of awake bodies can move during the step, and finds which bodies can reach them.
    fn find_bounds(&mut self, step: &Step<'_>) -> Result<(), Failure> {
        let (Setting { scene, .. }, span) = (step.setting, step.span);
        let (context, actives) = self.context(step.setting, step.work);
        let awake = actives.len();
        let any_left = AtomicBool::new(false);
        let find = |active: &mut Active| {
            context.find_reachable(active, span);
            if context.left_fat_bounds(active) {
                any_left.store(true, Ordering::Relaxed);
            }
        };
        if awake >= PARALLEL_BODIES {
            actives.par_iter_mut().with_min_len(4).for_each(find);
        } else {
            actives.iter_mut().for_each(find);
        }
        if !any_left.into_inner() {
            return Ok(());
        }
        for slot in 0..awake {
            loop {
                let active = &self.actives.awake()[slot];
                let (body, max_reach) = (active.body, active.bounds.max_reach);
                if !self.reading(step.setting, step.work).left_fat_bounds(active) {
                    break;
                }
                let Prescribed { bodies, tracks, pairs, .. } = self;
                let radius = scene.bodies[body as usize].radius;
                let mut surrounded = Surrounded { scene, bodies, tracks, time: span.start };
                let vertices = radius + ROOM * (max_reach - radius);
                pairs.anchor(&mut surrounded, body as usize, vertices, &Tally::new(step.work, None));
                step.work.check().map_err(|stop| too_many_neighbours(step, stop, body, &self.pairs))?;
                let (context, actives) = self.context(step.setting, step.work);
                context.find_reachable(&mut actives[slot], span);
            }
        }
        Ok(())
    }

    /// What stepping a body reads.
    pub fn reading<'a>(&'a self, setting: Setting<'a>, work: &'a Work) -> Context<'a> {
        let Prescribed { bodies, tracks, pairs, .. } = self;
        Context { setting, bodies, pairs, tracks, work }
    }

    /// What stepping a body reads, and the awake bodies.
    fn context<'a>(&'a mut self, setting: Setting<'a>, work: &'a Work) -> (Context<'a>, &'a mut [Active]) {
        let Prescribed { bodies, tracks, pairs, actives, .. } = self;
        (Context { setting, bodies, pairs, tracks, work }, actives.awake_mut())
    }

    /// Integrates the equation of motion of every awake body, and reports what that took.
    fn integrate(&mut self, step: &mut Step<'_>) -> Result<Sum, Failure> {
        step.work.begin_turns(self.actives.awake().len());
        let (context, actives) = self.context(step.setting, step.work);
        let (is_worth_threads, span) = (is_worth_threads(actives), step.span);
        let advance = |(turn, active): (usize, &mut Active)| {
            context.advance(active, turn, span);
            Sum::of(active, context.setting.scene, span)
        };
        let sum = if is_worth_threads {
            actives.par_iter_mut().with_min_len(4).enumerate().map(advance).reduce(Sum::default, Sum::and)
        } else {
            actives.iter_mut().enumerate().map(advance).fold(Sum::default(), Sum::and)
        };
        if step.work.is_interrupted() {
            return Err(Failure::Interrupted { step: step.report.step });
        }
        let actives = self.actives.awake();
        if let Some(slot) = step.work.busiest(sum.work, actives.iter().map(|active| active.statistics.work)) {
            return Err(step.failure(Stop::Overworked, self.toil(&actives[slot], step.setting.scene)));
        }
        step.work.end(sum.work, sum.base, sum.vertices);
        if step.work.announce() {
            let busiest = actives.iter().max_by_key(|active| active.statistics.work);
            let toil = busiest.map(|active| self.toil(active, step.setting.scene));
            step.report.strain = toil.map(|toil| Strain { step: step.report.step, time: span.end, toil });
        }
        step.report.substeps = sum.substeps;
        step.report.error = sum.error;
        step.report.shortfall = sum.shortfall;
        step.report.sleeping_bodies = self.bodies.len() as u64 - sum.stepped;
        Ok(sum)
    }

    /// What a body does that takes so much work.
    fn toil(&self, active: &Active, scene: &Scene) -> Toil {
        let body = active.body as usize;
        let vertices = self.bodies[body].mesh.directions().len();
        Toil::Forces { body: scene.bodies[body].name.clone(), vertices, spheres: active.bounds.reachable.len() }
    }

    /// Puts bodies to sleep on which nothing acted.
    fn sleep(&mut self, sum: &Sum, step: &Step<'_>) {
        if !sum.any_idle {
            return;
        }
        let Prescribed { bodies, tracks, pairs, actives, .. } = self;
        actives.sleep(bodies, |bodies, active| {
            let context = Context { setting: step.setting, bodies, pairs, tracks, work: step.work };
            let own_force = context.own_force(active.body, step.span);
            active.statistics.substeps == 0 && active.bounds.may_sleep && own_force == 0.0
        });
    }
}

fn too_many_neighbours(step: &Step<'_>, stop: Stop, body: u32, pairs: &Pairs) -> Failure {
    let body = step.setting.scene.bodies[body as usize].name.clone();
    step.failure(stop, Toil::Neighbours { body, pairs: pairs.near.count() })
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

/// Results of the steps of some bodies; the order of summation does not matter.
#[derive(Clone, Copy, Default)]
struct Sum {
    stepped: u64,
    substeps: u64,
    error: f64,
    /// The one with the largest error; of equal ones that of the first body.
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
    fn of(active: &Active, scene: &Scene, span: Span) -> Sum {
        let statistics = active.statistics;
        let is_idle = statistics.substeps == 0;
        Sum {
            stepped: u64::from(!is_idle),
            substeps: statistics.substeps,
            error: f64::max(0.0, statistics.error / scene.bodies[active.body as usize].radius),
            shortfall: shortfall(active, scene, span),
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
fn shortfall(active: &Active, scene: &Scene, span: Span) -> Option<Shortfall> {
    let body = active.body as usize;
    let (allowed, excess) = (scene.tolerance * span.length(), active.statistics.excess / scene.bodies[body].radius);
    (excess > 0.0).then_some(Shortfall { body, error: allowed + excess, allowed })
}

/// The shortfall with the larger error; of equal ones that of the first body.
fn worse(a: Option<Shortfall>, b: Option<Shortfall>) -> Option<Shortfall> {
    let (Some(one), Some(other)) = (a, b) else { return a.or(b) };
    let is_other = other.error > one.error || other.error == one.error && other.body < one.body;
    if is_other { b } else { a }
}

/// Access to the state.
impl Prescribed {
    /// The state of a body, if it is not at rest.
    pub fn active(&self, index: usize) -> Option<&Active> {
        self.actives.get(&self.bodies[index])
    }

    /// Body `index` of the scene at the current time.
    pub fn view<'a>(&'a self, setting: Setting<'_>, body: &'a scene::Body, index: usize) -> BodyView<'a> {
        let (active, path) = (self.active(index), self.tracks.path(index));
        let oscillator = active.map(|active| active.state.oscillator).unwrap_or_default();
        let Setting { scene, step, arch, .. } = setting;
        let now = Now { step, dt: scene.dt, oscillator, arch };
        let solved = Solved::Prescribed { path, active, now };
        BodyView { body, mesh: &self.bodies[index].mesh, centre: path.position(now.time()), solved }
    }

    /// A bound on the acceleration of a body's centre in the last step, which has these ends [scene unit/s², s]; infinite if
    /// a derivative of its path jumps there.
    #[cfg(feature = "cli")]
    pub fn acceleration_within(&self, index: usize, ends: [f64; 2]) -> f64 {
        let breaks = self.tracks.breaks(index as u32);
        if breaks.partition_point(|at| *at < ends[0]) < breaks.partition_point(|at| *at <= ends[1]) {
            return f64::INFINITY;
        }
        self.tracks.path(index).bounds(ends[0], ends[1]).acceleration
    }

    /// A bound on the distance of a body's vertices from its centre, now and later if nothing else acts [scene unit].
    pub fn extent(&self, index: usize) -> f64 {
        self.bodies[index].radius + self.active(index).map_or(0.0, Active::amplitude)
    }

    /// A hash of the exact state.
    pub fn hash(&self) -> u64 {
        self.actives.hash().wrapping_add(self.pairs.near.hash())
    }

    /// All pairs that are near each other or not apart, in ascending order of their bodies.
    pub fn known_pairs(&self) -> impl Iterator<Item = &Pair> + '_ {
        later_neighbours(self.bodies.iter().map(|body| &body.neighbours)).map(|pair| self.pairs.get(pair))
    }

    /// Bodies and phase of every pair that may not be apart.
    pub fn phases(&self) -> impl Iterator<Item = (usize, usize, Phase)> + '_ {
        self.known_pairs().map(|pair| (pair.a as usize, pair.b as usize, pair.phase))
    }

    /// The phase of the pair of bodies `a` and `b`.
    pub fn phase(&self, a: usize, b: usize) -> Phase {
        let neighbours = &self.bodies[a].neighbours;
        let found = neighbours.binary_search_by_key(&(b as u32), |neighbour| neighbour.other);
        found.map_or(Phase::Apart, |index| self.pairs.get(neighbours[index].pair).phase)
    }

    /// What acts on a body in the current state, except its own oscillators.
    pub fn surroundings_into(&self, setting: Setting<'_>, index: usize, surroundings: &mut Surroundings) {
        let time = setting.time();
        let on = self.bodies[index].on(setting.scene, index as u32, &self.tracks, &self.pairs);
        on.surroundings_into(Moment { time, phases_at: time, windows_at: time }, self.extent(index), surroundings);
    }

    /// The influence energy as if every pair were apart and out of reach [scene unit²/s²].
    pub fn energy_of_distant_pairs(&self, scene: &Scene) -> f64 {
        *self.energy_of_distant_pairs.get_or_init(|| spheres::energy_of_distant_pairs(scene))
    }
}
