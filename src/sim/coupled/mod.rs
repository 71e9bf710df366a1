//! Coupled scenes: free bodies, planes, and pairs whose strength changes gradually at the rim of the core.
//!
//! | contents | module |
//! | --- | --- |
//! | the step | here |
//! | which bodies are awake | [`rest`] |
//! | islands for which adaptive steps are too much work; failures | [`limits`] |
//! | changes between steps | [`edits`] |
//! | access to the state | [`access`] |
//! | a body, bounds of its motion in a step, when it rests | [`member`] |
//! | near pairs and their phases | [`near`] |
//! | islands of bodies that act on each other in a step, and advancing them | [`islands`] |
//! | the state within a step | [`dense`] |
//! | the schemes with fixed steps | [`explicit`] |
//!
//! Free bodies act on each other, so unlike in other scenes, bodies cannot be stepped one by one and events cannot be
//! found in advance. In each step, bodies that can act on each other form an island. [`free`] advances it with steps of
//! its own, which end at its events. A body on a path does not couple other bodies, because its centre is known.
//!
//! In a heap, contacts make all bodies one island, and its adaptive steps become very short. Where they are too much work,
//! the island takes steps of fixed length ([`free`]'s velocity Verlet) and reports their estimated error. Work is counted,
//! not timed, so it is the same step in every run. Adaptive steps are tried again after some steps within the
//! tolerance, twice as many each time.
//!
//! How far a free body moves is known only after the step. Islands are built for the expected motion; those with a body
//! that moved farther are rebuilt and advanced again from the start of the step.
//!
//! # What a step skips
//! - A body that is undeformed, does not turn and is out of reach of everything moves in closed form. So does one that
//!   turns like a rigid body about its axis of largest moment ([`member::Member::find_rigid_spin`]); damping leads there.
//!   In general, other rotations have no closed form. Vertices feel the centrifugal force, so a turning body is not
//!   rigid: if thrown undeformed, it swings about a stretched shape, and if it turns about no principal axis, its
//!   stretch keeps changing. Its motion is x = X l + ξ, where the ξ are free oscillators and X is a matrix whose nine
//!   equations contain the polar decomposition of Q + X: a pseudo-rigid body (Cohen & Muncaster, The Theory of
//!   Pseudo-rigid Bodies, 1988). Euler's top, which has a closed form, is off by Ω²/ω² of the radius. Such a body takes
//!   steps; the cost of their iterations does not depend on the number of vertices (`free::passive`).
//! - A body comes to rest when its whole island is nearly still ([`member::Member::is_slow`]), and costs nothing until
//!   a moving body comes near it or a push begins. Its island then wakes as a whole.

mod access;
pub(super) mod dense;
mod edits;
mod explicit;
mod islands;
mod limits;
pub(super) mod member;
mod near;
mod rest;

use std::{mem::take, sync::Mutex};

use glam::DVec3;

use self::{
    explicit::Scheme,
    islands::{Conditions, Group, Job, PairIn, source_at},
    limits::give_up_adaptive,
    member::{Member, Shapes},
    near::{Among, Near},
};
use super::{
    events::Event,
    free::{self, Ledger, Parts, Scratch},
    neighbours::{Neighbour, PairId},
    report::{Failure, Stage, StepReport, Stopwatch, Strain},
    solver::{Setting, Step},
    span::Span,
    terms::{free_fall, push},
    work::{Stop, Tally, Work},
};
use crate::{
    disjoint_sets::DisjointSets,
    scene::{Response, Scene, path::Bounds},
};

/// Limit on repetitions of a step because bodies moved farther than expected.
const MAX_ROUNDS: u32 = 40;

/// Ordinary work of a step per vertex: a few sweeps of a few steps, at four nodes [units].
const ORDINARY: u64 = 200;
/// Additional ordinary work per vertex in contact with a plane [units].
const ORDINARY_HELD: u64 = 2000;

/// Islands with more bodies than this may do [`MAX_ADAPTIVE`] in adaptive steps, even if the run could continue.
const MOST_UNLIMITED: usize = 64;
/// Largest work of the adaptive steps of an island in a step, in large islands and those for which they were too much work
/// before [units]: about 0.1 s on two cores.
const MAX_ADAPTIVE: u64 = 4_000_000;

/// The bodies of a coupled scene.
#[derive(Clone)]
pub(super) struct Coupled {
    members: Vec<Member>,
    /// The force points, as bodies without vertices.
    points: Vec<free::Body>,
    near: Near,
    /// The bodies that take steps, ascending.
    awake: Vec<u32>,
    /// Sum of the hashes of the bodies that are not awake.
    sleeping_hash: u64,
    /// The rest shapes of the bodies.
    shapes: Shapes,
    /// The bodies that act on each other in the step: each set of those that are awake is an island.
    islands: DisjointSets,
    /// The pairs that couple their bodies in the step.
    coupled: Vec<PairId>,
    jobs: Vec<Job>,
    /// Buffers, reused; `before` holds the islands of the previous step.
    before: Vec<Job>,
    groups: Vec<Group>,
    unforced: Vec<u32>,
    stepped: Vec<u32>,
    /// Index of a body's island in the step, by its root.
    job_of: Vec<u32>,
    scratches: Scratches,
    /// Energy brought to free bodies so far, by cause.
    pub ledger: Ledger,
    /// Whether an island took steps of fixed length, which is announced once.
    has_fixed: bool,
    /// Energy of free bodies at t = 0.
    pub first_energy: f64,
}

/// Buffers of islands. A copy of a world begins with none.
#[derive(Default)]
struct Scratches(Mutex<Vec<Scratch>>);

impl Clone for Scratches {
    fn clone(&self) -> Scratches {
        Scratches::default()
    }
}

impl Coupled {
    /// The bodies at t = 0; `None` if there are more than `max_pairs` pairs of nearby bodies.
    pub fn new(scene: &Scene, max_pairs: u64, work: &Work) -> Option<Coupled> {
        let mut coupled = Coupled::undeformed(scene);
        let first = Span { start: 0.0, end: scene.dt };
        for (member, body) in coupled.members.iter_mut().zip(&scene.bodies) {
            member.bound_motion(body, free_fall(scene), first);
        }
        let among = Among { scene, members: &mut coupled.members, time: 0.0 };
        coupled.near = Near::of_all(among, max_pairs, work)?;
        coupled.first_energy = coupled.energy(scene, 0.0);
        Some(coupled)
    }

    /// Undeformed bodies, without pairs.
    pub fn undeformed(scene: &Scene) -> Coupled {
        let mut shapes = Shapes::default();
        let members: Vec<Member> =
            (0..scene.bodies.len()).map(|index| Member::new(scene, index, &mut shapes, 0.0)).collect();
        Coupled {
            members,
            points: scene.points.iter().map(|point| source_at(scene, point, 0.0)).collect(),
            near: Near::new(scene),
            awake: (0..scene.bodies.len() as u32).collect(),
            sleeping_hash: 0,
            shapes,
            islands: DisjointSets::default(),
            coupled: Vec::new(),
            jobs: Vec::new(),
            before: Vec::new(),
            groups: Vec::new(),
            unforced: Vec::new(),
            stepped: Vec::new(),
            job_of: vec![0; scene.bodies.len()],
            scratches: Scratches::default(),
            ledger: Ledger::default(),
            has_fixed: false,
            first_energy: 0.0,
        }
    }

    /// Takes a step, stage by stage. Returns the first body whose state is invalid afterwards.
    ///
    /// # Errors
    /// The step could not be completed.
    pub fn step(&mut self, step: &mut Step<'_>) -> Result<Option<usize>, Failure> {
        let mut stopwatch = Stopwatch::start();
        step.report.error = 0.0; // it becomes the largest of this step
        self.wake_pushed(step);
        self.wake_near_points(step);
        self.find_neighbours(step);
        self.jobs.iter_mut().for_each(Job::begin_step);
        if let Some(scheme) = Scheme::of(step.setting.scene.integrator) {
            return self.step_explicitly(scheme, step, stopwatch);
        }
        for _ in 0..MAX_ROUNDS {
            self.find_islands(step);
            self.check(step)?;
            stopwatch.stop(Stage::Reach, step.report);
            self.integrate(step)?;
            stopwatch.stop(Stage::Integrate, step.report);
            if !self.has_left_bounds() {
                self.end(step);
                stopwatch.stop(Stage::Reach, step.report);
                return Ok(None);
            }
        }
        Err(self.never_ends(step))
    }

    /// Takes a step of an explicit scheme. Returns the first body whose state is invalid afterwards.
    fn step_explicitly(
        &mut self,
        scheme: Scheme,
        step: &mut Step<'_>,
        mut stopwatch: Stopwatch,
    ) -> Result<Option<usize>, Failure> {
        let tally = Tally::new(step.work, None);
        tally.spend(self.members.iter().map(Member::size).sum());
        drop(tally);
        self.check(step)?;
        stopwatch.stop(Stage::Reach, step.report);
        let Coupled { members, near, .. } = self;
        let diverged = explicit::step(scheme, step.setting.scene, members, near, step.span, step.report);
        self.move_points(step.setting.scene, step.span.end);
        step.report.sleeping_bodies = 0;
        stopwatch.stop(Stage::Integrate, step.report);
        Ok(diverged)
    }

    /// Whether a body moved farther than was expected when islands were found. The islands of such bodies are advanced
    /// again.
    fn has_left_bounds(&mut self) -> bool {
        let mut any = false;
        for job in &mut self.jobs {
            for (&body, way) in job.group.bodies.iter().zip(&job.parts.ways) {
                if self.members[body as usize].left_bounds(way) {
                    (any, job.is_done) = (true, false);
                }
            }
        }
        any
    }

    /// Bounds how far awake bodies may move during the step, and finds which bodies they come near.
    fn find_neighbours(&mut self, step: &Step<'_>) {
        let (Setting { scene, .. }, span) = (step.setting, step.span);
        for &body in &self.awake {
            let member = &mut self.members[body as usize];
            if let Some(path) = scene.bodies[body as usize].path() {
                member.body.follow(path.at(span.start));
            }
            member.bound_motion(&scene.bodies[body as usize], free_fall(scene), span);
        }
        let tally = Tally::new(step.work, None);
        let mut among = Among { scene, members: &mut self.members, time: span.start };
        for &body in &self.awake {
            self.near.update(&mut among, body, &tally);
        }
    }

    /// Finds the islands of the step, and wakes bodies at rest that become part of one.
    fn find_islands(&mut self, step: &Step<'_>) {
        let (Setting { scene, .. }, span) = (step.setting, step.span);
        self.coupled.clear();
        self.islands.reset(self.members.len());
        let tally = Tally::new(step.work, None);
        let mut next = 0;
        while next < self.awake.len() {
            let body = self.awake[next];
            next += 1;
            self.near.update(&mut Among { scene, members: &mut self.members, time: span.start }, body, &tally);
            for index in 0..self.members[body as usize].neighbours.len() {
                let Neighbour { other, pair, .. } = self.members[body as usize].neighbours[index];
                let is_awake = self.members[other as usize].is_awake;
                if (is_awake && other < body) || !self.near.is_coupled(pair, &self.members) {
                    continue;
                }
                if !is_awake {
                    self.wake(other);
                    self.members[other as usize].bound_motion(&scene.bodies[other as usize], free_fall(scene), span);
                }
            }
        }
        self.awake.sort_unstable();
        for &body in &self.awake {
            for &Neighbour { other, pair, .. } in &self.members[body as usize].neighbours {
                if other > body && self.members[other as usize].is_awake && self.near.is_coupled(pair, &self.members) {
                    self.coupled.push(pair);
                    if self.is_free(body) || self.is_free(other) {
                        self.islands.join(body, other);
                    }
                }
            }
        }
        self.group(scene, span);
    }

    fn is_free(&self, body: u32) -> bool {
        self.members[body as usize].body.is_free()
    }

    /// Groups bodies and pairs into islands; an unchanged island keeps its result.
    fn group(&mut self, scene: &Scene, span: Span) {
        let mut groups = take(&mut self.groups);
        let mut count = 0;
        for &body in &self.awake {
            let root = self.islands.least(body);
            if root == body {
                self.job_of[root as usize] = count as u32;
                if count == groups.len() {
                    groups.push(Group::default());
                }
                groups[count].clear();
                count += 1;
            }
            groups[self.job_of[root as usize] as usize].bodies.push(body);
        }
        for &pair in &self.coupled {
            let free::Pair { a, b, .. } = *self.near.get(pair);
            let [of_a, of_b] = [a, b].map(|body| self.job_of[self.islands.least(body) as usize] as usize);
            groups[of_a].pairs.push(PairIn { pair, is_own: true });
            if of_a != of_b {
                groups[of_a].sources.push(b);
                groups[of_b].sources.push(a);
                groups[of_b].pairs.push(PairIn { pair, is_own: false });
            }
        }
        std::mem::swap(&mut self.jobs, &mut self.before);
        self.jobs.clear();
        let mut before = take(&mut self.before);
        let mut next = 0;
        for group in &mut groups[..count] {
            if !self.needs_steps(scene, span, group) {
                continue;
            }
            group.sources.sort_unstable();
            group.sources.dedup();
            let first = |job: &Job| job.group.bodies.first().copied().unwrap_or_default();
            while next < before.len() && first(&before[next]) < group.bodies[0] {
                next += 1;
            }
            // an island that has changed reuses the allocations of the old one
            let known = before.get_mut(next).filter(|job| first(job) == group.bodies[0]);
            let mut job = known.map(take).unwrap_or_default();
            job.is_done &= job.group == *group;
            let fixed = self.fixed_steps_of(&group.bodies);
            if !job.is_done {
                job.is_fixed |= fixed.left > 0;
            }
            let is_limited = fixed.wait > 0 || group.bodies.len() > MOST_UNLIMITED;
            job.budget = if is_limited { MAX_ADAPTIVE } else { u64::MAX };
            if !job.is_done {
                std::mem::swap(&mut job.group, group);
            }
            job.work = 0;
            self.jobs.push(job);
        }
        before.clear();
        (self.before, self.groups) = (before, groups);
    }

    /// Whether an island must be integrated: something acts on its bodies, or they are deformed.
    fn needs_steps(&self, scene: &Scene, span: Span, group: &Group) -> bool {
        if group.bodies.len() > 1 || !group.pairs.is_empty() {
            return true;
        }
        let index = group.bodies[0] as usize;
        let member = &self.members[index];
        let body = &member.body;
        let is_driven = push::any_acts(&member.pushes, span)
            || scene.bodies[index].force.is_some()
            || self.points_near(scene, span, index).next().is_some();
        if is_driven || member.touches(&scene.planes) {
            return true;
        }
        if member.rigid_spin.is_some() {
            return false;
        }
        if member.is_deformed() {
            return true;
        }
        let Some(path) = scene.bodies[index].path() else { return body.turns() && body.spin != DVec3::ZERO };
        let Bounds { speed, acceleration } = path.bounds(span.start, span.end);
        let is_accelerated = || acceleration != 0.0 || path.kicks(span.start, span.end) > 0.0;
        match scene.bodies[index].material.response {
            Response::Rigid => false,
            Response::Inertial => is_accelerated(),
            Response::World => speed != 0.0 || is_accelerated(),
        }
    }

    /// Advances copies of the islands' bodies to the end of the step.
    fn integrate(&mut self, step: &mut Step<'_>) -> Result<(), Failure> {
        let (Setting { scene, arch, .. }, span) = (step.setting, step.span);
        step.work.begin_turns(self.jobs.len());
        let left = step.work.left();
        self.jobs.iter_mut().for_each(|job| job.budget = job.budget.min(left));
        let mut is_repeated = false;
        loop {
            let Coupled { members, near, scratches, jobs, .. } = self;
            islands::advance(
                jobs,
                &Conditions { scene, members, near, span, work: step.work, scratches: &scratches.0, arch },
            );
            if step.work.is_interrupted() {
                return Err(Failure::Interrupted { step: step.report.step });
            }
            if !give_up_adaptive(jobs, step.work) {
                break;
            }
            step.work.repeat_turns(jobs.iter().map(|job| if job.is_done { job.work } else { 0 }));
            is_repeated = true;
        }
        if is_repeated {
            // what was stopped had been counted up to an instant that depends on threads
            step.work.repeat_turns(self.jobs.iter().map(|job| job.work));
        }
        let all = self.jobs.iter().map(|job| job.work).sum();
        if let Some(turn) = step.work.busiest(all, self.jobs.iter().map(|job| job.work)) {
            return Err(step.failure(Stop::Overworked, self.toil(scene, &self.jobs[turn])));
        }
        if let Some((job, failure)) = self.jobs.iter().find_map(|job| Some((job, job.failure.as_ref()?))) {
            return Err(self.failure(scene, step.report, job, failure));
        }
        let (mut vertices, mut ordinary) = (0, 0);
        for job in &self.jobs {
            let count = job.parts.bodies.iter().map(|body| body.x.len() as u64).sum::<u64>();
            vertices += count;
            ordinary += ORDINARY * count + ORDINARY_HELD * job.report.held;
        }
        step.work.end(all, ordinary, vertices);
        if step.work.announce() {
            let busiest = self.jobs.iter().max_by_key(|job| job.work);
            let toil = busiest.map(|job| self.toil(scene, job));
            step.report.strain = toil.map(|toil| Strain { step: step.report.step, time: span.end, toil });
        }
        Ok(())
    }

    /// Stores the islands' results as the state, and advances all other bodies.
    fn end(&mut self, step: &mut Step<'_>) {
        let (Setting { scene, .. }, span, report) = (step.setting, step.span, &mut *step.report);
        let mut jobs = take(&mut self.jobs);
        let mut stepped = 0;
        for job in &mut jobs {
            self.report_events(job, report);
            self.report_fixed(scene, job, span, report);
            let bodies = job.group.bodies.len() as u64;
            report.substeps += job.report.body_steps;
            report.error = report.error.max(job.report.error);
            report.ledger += job.report.ledger;
            stepped += bodies;
            let Parts { bodies: after, ways, step_lengths, .. } = &mut job.parts;
            for ((&index, body), (way, step_length)) in
                job.group.bodies.iter().zip(after).zip(ways.iter().zip(step_lengths))
            {
                let member = &mut self.members[index as usize];
                std::mem::swap(&mut member.body, body);
                if let Some(path) = scene.bodies[index as usize].path().filter(|path| !path.knots().is_empty()) {
                    // the right limit: after any jump at the end of the step
                    member.body.follow(path.at(span.end));
                }
                (member.step_length, member.rigid_spin) = (*step_length, None);
                member.extent = member.body.shape.extent() + way.displacement;
                member.speed = way.speed;
            }
        }
        self.advance_unforced(scene, span, &jobs);
        self.move_points(scene, span.end);
        report.sleeping_bodies = self.members.len() as u64 - stepped;
        report.events.sort_by(|x, y| x.time.total_cmp(&y.time).then((x.a, x.b).cmp(&(y.a, y.b))));
        self.sleep(scene, span, &jobs, report);
        self.ledger += report.ledger;
        jobs.iter_mut().for_each(|job| job.is_done = false);
        self.jobs = jobs;
        let Coupled { awake, members, .. } = self;
        awake.retain(|&body| members[body as usize].is_awake);
    }

    /// Reports the events of an island.
    fn report_events(&mut self, job: &Job, report: &mut StepReport) {
        for change in &job.report.changes {
            let PairIn { pair, is_own } = job.group.pairs[change.pair];
            let free::Change { time, q, rate, from, to, energy, .. } = *change;
            let free::Pair { a, b, .. } = *self.near.get(pair);
            if is_own {
                report.events.push(Event { time, step: report.step, a, b, q, rate, from, to, energy });
                self.near.enter(pair, to);
            }
        }
    }

    /// Moves the awake bodies on which nothing acts, in closed form.
    fn advance_unforced(&mut self, scene: &Scene, span: Span, jobs: &[Job]) {
        let (mut stepped, mut unforced) = (take(&mut self.stepped), take(&mut self.unforced));
        stepped.clear();
        stepped.extend(jobs.iter().flat_map(|job| &job.group.bodies));
        stepped.sort_unstable();
        let h = span.length();
        unforced.clear();
        unforced.extend(self.awake.iter().filter(|body| stepped.binary_search(body).is_err()));
        for &body in &unforced {
            let (member, path) = (&mut self.members[body as usize], scene.bodies[body as usize].path());
            if let Some(path) = path {
                member.body.follow(path.at(span.end));
                if path.is_still(span.end, f64::INFINITY) {
                    self.put_to_sleep(body);
                }
                continue;
            }
            let free::Body { centre, velocity, .. } = &mut member.body;
            *centre += h * (*velocity + 0.5 * h * free_fall(scene));
            *velocity += h * free_fall(scene);
            member.step_length = f64::INFINITY;
            if let Some(spin) = member.rigid_spin {
                member.turn(spin, h);
            } else if free_fall(scene) == DVec3::ZERO && member.body.velocity == DVec3::ZERO {
                self.put_to_sleep(body);
            }
        }
        (self.stepped, self.unforced) = (stepped, unforced);
    }

    /// Moves the force points to where they are at `time` [s].
    fn move_points(&mut self, scene: &Scene, time: f64) {
        for (own, point) in self.points.iter_mut().zip(&scene.points) {
            own.follow(point.path.at(time));
        }
    }
}

#[cfg(test)]
mod tests;
