//! Coupled scenes: free bodies, planes, and pairs whose strength changes gradually at the rim of the core.
//!
//! | contents | module |
//! | --- | --- |
//! | the step | here |
//! | a body, bounds of its motion in a step, when it rests | [`member`] |
//! | near pairs and their phases | [`near`] |
//! | islands of bodies that act on each other in a step, and advancing them | [`islands`] |
//! | the schemes with fixed steps | [`explicit`] |
//!
//! Free bodies act on each other, so unlike in other scenes, bodies cannot be stepped one by one and events cannot be
//! found in advance. In each step, bodies that can act on each other form an island. [`free`] advances it with steps of
//! its own, which end at its events. A body on a path does not couple other bodies, because its centre is known.
//!
//! In a heap, contacts make all bodies one island, and its adaptive steps become very short. Where they are too much work,
//! the island takes steps of fixed length ([`free`]'s velocity Verlet) and reports their estimated error. Work is counted,
//! not timed, so it is the same step in every run. Adaptive steps are tried again after calm steps, each time later.
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

pub(super) mod dense;
mod explicit;
mod islands;
pub(super) mod member;
mod near;

use std::{mem::take, sync::Mutex};

use glam::DVec3;

use self::{
    dense::Interpolated,
    explicit::Scheme,
    islands::{Conditions, Forest, Group, Job, source_at},
    member::{FixedSteps, MAX_SLOW_TOLERANCE, Member, Shapes, driven},
    near::{Among, Near},
};
use super::{
    body::{BodyView, Solved},
    events::Event,
    free::{self, Field, Ledger, Pair, Parts, Scratch, Snapshot, Window},
    neighbours::Neighbour,
    report::{Failure, Fallback, Overworked, Shortfall, Stage, StepReport, Stopwatch, Strain, Toil},
    solver::{Setting, Step, Takeover},
    span::Span,
    terms::{Cause, Origin, Source, Surroundings, Weighted},
    work::{Stop, Tally, Work},
};
use crate::{
    model::{phase::Phase, shape_matching::Plane},
    scene::{self, Point, Response, Scene},
};

/// Limit on repetitions of a step because bodies moved farther than expected.
const MAX_ROUNDS: u32 = 40;

/// Number of steps between tests whether a body that turns alone does so like a rigid one.
const RIGID_SPIN_EVERY: u64 = 16;

/// Ordinary work of a step per vertex: a few sweeps of a few steps, at four nodes [units].
const ORDINARY: u64 = 200;
/// Additional ordinary work per vertex in contact with a plane [units].
const ORDINARY_HELD: u64 = 2000;

/// Islands with more bodies than this may do [`MAX_ADAPTIVE`] in adaptive steps, even if the run could continue.
const MOST_UNLIMITED: usize = 64;
/// Largest work of the adaptive steps of an island in a step, in large islands and those for which they were too much work
/// before [units]: about 0.1 s on two cores.
const MAX_ADAPTIVE: u64 = 4_000_000;
/// Steps of fixed length are calm if their estimated error is at most this many times what the tolerance allows: adaptive
/// ones may then be possible.
const CALM: f64 = 10.0;

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
    /// Times at which pushes begin [s], ascending, with the bodies' indices.
    starts: Vec<(f64, u32)>,
    /// Number of pushes that have begun.
    started: usize,
    /// The rest shapes of the bodies.
    shapes: Shapes,
    forest: Forest,
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
        let mut shapes = Shapes::default();
        let members: Vec<Member> =
            (0..scene.bodies.len()).map(|index| Member::new(scene, index, &mut shapes)).collect();
        let mut starts: Vec<(f64, u32)> = scene.pushes.iter().map(|push| (push.start, push.body as u32)).collect();
        starts.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut coupled = Coupled {
            members,
            points: scene.points.iter().map(|point| source_at(scene, point, 0.0)).collect(),
            near: Near::new(scene),
            awake: Vec::new(),
            sleeping_hash: 0,
            starts,
            started: 0,
            shapes,
            forest: Forest::default(),
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
        };
        let first = Span { start: 0.0, end: scene.dt };
        for (member, body) in coupled.members.iter_mut().zip(&scene.bodies) {
            member.bound_motion(body, scene.gravity, first);
        }
        let among = Among { scene, members: &mut coupled.members, time: 0.0 };
        coupled.near = Near::of_all(among, max_pairs, work)?;
        for body in 0..coupled.members.len() as u32 {
            coupled.members[body as usize].is_awake = true;
            coupled.awake.push(body);
        }
        coupled.first_energy = coupled.snapshot(scene, 0.0).conserved().energy();
        Some(coupled)
    }

    /// Takes over the state of another scene, and adds the phase changes and the energy that this brings to the report.
    /// False if there are too many pairs.
    pub fn resume(
        &mut self,
        scene: &Scene,
        before: &Coupled,
        takeover: &Takeover<'_>,
        report: &mut StepReport,
    ) -> bool {
        let &Takeover { kept, wake_all, time, .. } = takeover;
        let span = Span { start: time, end: time + scene.dt };
        (self.ledger, self.first_energy) = (before.ledger, before.first_energy);
        self.has_fixed = before.has_fixed;
        self.move_points(scene, time);
        for (index, (member, kept)) in self.members.iter_mut().zip(kept).enumerate() {
            member.neighbours.clear();
            match kept {
                Some(old) => member.resume(&before.members[*old]),
                None => {
                    if let Some(path) = scene.bodies[index].path() {
                        let motion = path.at(time);
                        (member.body.centre, member.body.velocity) = (motion.position, motion.velocity);
                    }
                }
            }
            if wake_all && !member.is_awake {
                (member.is_awake, member.slow_steps) = (true, 0);
            }
            member.bound_motion(&scene.bodies[index], scene.gravity, span);
        }
        // what was not apart before is listed below
        let among = Among { scene, members: &mut self.members, time: 0.0 };
        let Some(near) = Near::of_all(among, takeover.max_pairs, &Work::limited(u64::MAX, None)) else { return false };
        self.near = near;
        let now_at = takeover.now_at(before.members.len());
        // pairs that were not listed were apart
        let unknown: Vec<(usize, u32, u32)> = (0..self.members.len())
            .flat_map(|a| self.members[a].neighbours.iter().map(move |neighbour| (a, neighbour.other, neighbour.pair)))
            .filter(|&(a, other, _)| kept[a].is_some() && kept[other as usize].is_some())
            .collect();
        for (_, _, pair) in unknown {
            self.near.enter(pair, Phase::Apart);
        }
        for pair in before.pairs().filter(|pair| pair.phase != Phase::Apart) {
            if let (Some(a), Some(b)) = (now_at[pair.a as usize], now_at[pair.b as usize]) {
                let mut among = Among { scene, members: &mut self.members, time };
                let index = self.near.list(&mut among, a as u32, b as u32);
                self.near.enter(index, pair.phase);
            }
        }
        self.awake = (0..self.members.len() as u32).filter(|&body| self.members[body as usize].is_awake).collect();
        self.sleeping_hash = 0;
        for (body, member) in (0..).zip(&mut self.members).filter(|(_, member)| !member.is_awake) {
            member.sleeping_hash = member.hash(body);
            self.sleeping_hash = self.sleeping_hash.wrapping_add(member.sleeping_hash);
        }
        self.started = self.starts.partition_point(|start| start.0 < time);
        for start in 0..self.started {
            let body = self.starts[start].1;
            let member = &self.members[body as usize];
            if !member.is_awake && member.pushes.iter().any(|push| push.start < time && time < push.end) {
                self.wake(body);
            }
        }
        self.awake.sort_unstable();
        let brought = self.energy(scene, time) - before.energy(takeover.scene, time);
        self.ledger.edits += brought;
        report.ledger.edits += brought;
        let known = (0..).zip(&self.members).flat_map(|(a, member)| {
            let later = member.neighbours.iter().filter(move |neighbour| neighbour.other > a);
            later.map(|neighbour| neighbour.pair)
        });
        self.enter_phases(scene, time, &known.collect::<Vec<u32>>(), report);
        true
    }

    /// Adds the last body of the scene at `time` [s], with the phase changes and the energy that this brings. False, and
    /// nothing has changed, if there would be more than `max_pairs` pairs.
    pub fn add_last(&mut self, scene: &Scene, time: f64, max_pairs: u64, report: &mut StepReport) -> bool {
        let last = self.members.len();
        let mut member = Member::new(scene, last, &mut self.shapes);
        if let Some(path) = scene.bodies[last].path() {
            let motion = path.at(time);
            (member.body.centre, member.body.velocity) = (motion.position, motion.velocity);
        }
        member.is_awake = true;
        member.bound_motion(&scene.bodies[last], scene.gravity, Span { start: time, end: time + scene.dt });
        self.members.push(member);
        if !self.near.add_last(&mut Among { scene, members: &mut self.members, time }, max_pairs) {
            self.members.pop();
            self.shapes.forget_unused();
            return false;
        }
        self.awake.push(last as u32);
        self.job_of.push(0);
        // results of islands name force points by numbers that follow those of the bodies
        self.before.clear();
        self.jobs.clear();
        let brought = self.energy_of(scene, time, last);
        if time == 0.0 {
            self.first_energy += brought;
            return true;
        }
        self.ledger.edits += brought;
        report.ledger.edits += brought;
        let pairs: Vec<u32> = self.members[last].neighbours.iter().map(|neighbour| neighbour.pair).collect();
        self.enter_phases(scene, time, &pairs, report);
        true
    }

    /// Energy of a body at `time` [s], and of its pairs.
    fn energy_of(&self, scene: &Scene, time: f64, body: usize) -> f64 {
        let Member { body: own, neighbours, .. } = &self.members[body];
        let field = self.field(scene, time);
        let pairs = neighbours.iter().map(|&Neighbour { other, pair, .. }| {
            let free::Pair { law, phase, .. } = self.near.get(pair);
            let other = &self.members[other as usize].body;
            let q = own.centre.distance(other.centre) / (own.radius + other.radius);
            free::influence_energy(own, other, &field, law.strength(*phase, q))
        });
        let pairs: f64 = pairs.sum();
        let alone = Field { pushes: Vec::new(), forces: Vec::new(), first_point: 1, ..field };
        let here = Span { start: time, end: time };
        let with_points = self.points_near(scene, here, body).map(|(source, point)| {
            let window = Window { start: point.start, end: point.end() };
            Pair::with_point(0, 1 + source - scene.bodies.len() as u32, point.strength, window, time)
        });
        let bodies = std::iter::once(own).chain(&self.points).collect();
        pairs + Snapshot::new(bodies, with_points.collect(), alone, time).conserved().energy()
    }

    /// Adds a push, which the scene has already.
    pub fn push(&mut self, push: &scene::Push, time: f64) {
        let member = &mut self.members[push.body];
        member.add_push(push);
        let index = self.starts.partition_point(|start| start.0 <= push.start);
        self.starts.insert(index, (push.start, push.body as u32));
        if push.start < time {
            self.started += 1;
            if time < push.end() {
                self.wake_up(push.body);
            }
        }
    }

    /// Wakes a body between two steps.
    pub fn wake_up(&mut self, body: usize) {
        if !self.members[body].is_awake {
            self.wake(body as u32);
            self.awake.sort_unstable();
        }
    }

    /// The energy of the free bodies at `time` [s].
    fn energy(&self, scene: &Scene, time: f64) -> f64 {
        self.snapshot(scene, time).conserved().energy()
    }

    /// Changes the phases of pairs that a threshold has passed.
    fn enter_phases(&mut self, scene: &Scene, time: f64, pairs: &[u32], report: &mut StepReport) {
        let field = self.field(scene, time);
        for &index in pairs {
            let free::Pair { a, b, law, phase, .. } = *self.near.get(index);
            let [first, second] = [a, b].map(|body| &self.members[body as usize].body);
            let (apart, radii) = (second.centre - first.centre, first.radius + second.radius);
            let q = apart.length() / radii;
            let rate = (second.velocity - first.velocity).dot(apart.normalize_or_zero()) / radii;
            let mut from = phase;
            while let Some(to) = law.thresholds.next(from, q) {
                let jump = law.strength(to, q) - law.strength(from, q);
                let energy = free::influence_energy(first, second, &field, jump);
                report.ledger.events += energy;
                self.ledger.events += energy;
                report.events.push(Event { time, step: report.step, a, b, q, rate, from, to, energy });
                from = to;
            }
            self.near.enter(index, from);
        }
    }

    /// Takes a step, stage by stage. Returns the first body whose state is invalid afterwards.
    ///
    /// # Errors
    /// The step could not be completed.
    pub fn step(&mut self, step: &mut Step<'_>) -> Result<Option<usize>, Failure> {
        let mut stopwatch = Stopwatch::start();
        step.report.error = 0.0; // it becomes the largest of this step
        self.wake_pushed(step.span);
        self.wake_near_points(step);
        self.find_neighbours(step);
        self.jobs.iter_mut().for_each(|job| job.is_fixed = false);
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

    /// Wakes the bodies on which a push begins before the end of `span`.
    fn wake_pushed(&mut self, span: Span) {
        while let Some(&(start, body)) = self.starts.get(self.started).filter(|start| start.0 < span.end) {
            self.started += 1;
            if !self.members[body as usize].is_awake && start < span.end {
                self.wake(body);
            }
        }
        self.awake.sort_unstable();
    }

    /// Wakes the bodies near which a force point moves, or begins or ceases to act, during the step.
    fn wake_near_points(&mut self, step: &Step<'_>) {
        let (Setting { scene, .. }, span) = (step.setting, step.span);
        let changes = |point: &Point| {
            let is_switched = [point.start, point.end()].iter().any(|t| (span.start..=span.end).contains(t));
            is_switched || !point.path.is_still(span.start, span.end)
        };
        if !scene.points.iter().any(changes) {
            return;
        }
        let tally = Tally::new(step.work, None);
        for body in 0..self.members.len() as u32 {
            if !tally.spend(scene.points.len() as u64) {
                break;
            }
            let is_awake = self.members[body as usize].is_awake;
            if !is_awake && self.points_near(scene, span, body as usize).any(|(_, point)| changes(point)) {
                self.wake(body);
            }
        }
        self.awake.sort_unstable();
    }

    /// The force points that may act on vertices of a body during `span` and its ends.
    fn points_near<'a>(
        &'a self,
        scene: &'a Scene,
        span: Span,
        body: usize,
    ) -> impl Iterator<Item = (u32, &'a Point)> + 'a {
        let Member { body: own, bounds, extent, .. } = &self.members[body];
        let vertices = f64::max(*extent, bounds.extent) + bounds.way;
        scene.points_on(body).filter(move |(_, point)| {
            let (centre, radius) = point.path.ball(span.start, span.end);
            let reach = scene.influence.sphere_radius(point.radius) + radius + vertices;
            let is_near = centre.distance(own.centre) <= reach * (1.0 + 1e-9) + 1e-9 * centre.length();
            is_near && point.start <= span.end && span.start <= point.end()
        })
    }

    fn wake(&mut self, body: u32) {
        let member = &mut self.members[body as usize];
        self.sleeping_hash = self.sleeping_hash.wrapping_sub(member.sleeping_hash);
        (member.is_awake, member.slow_steps) = (true, 0);
        self.awake.push(body);
    }

    /// Bounds how far awake bodies may move during the step, and finds which bodies they come near.
    fn find_neighbours(&mut self, step: &Step<'_>) {
        let (Setting { scene, .. }, span) = (step.setting, step.span);
        for &body in &self.awake {
            let member = &mut self.members[body as usize];
            if let Some(path) = scene.bodies[body as usize].path() {
                let motion = path.at(span.start);
                (member.body.centre, member.body.velocity) = (motion.position, motion.velocity);
            }
            member.bound_motion(&scene.bodies[body as usize], scene.gravity, span);
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
        let Coupled { members, awake, forest, .. } = self;
        forest.clear(members.len());
        awake.iter().for_each(|&body| forest.plant(body));
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
                    self.members[other as usize].bound_motion(&scene.bodies[other as usize], scene.gravity, span);
                    self.forest.plant(other);
                }
            }
        }
        self.awake.sort_unstable();
        for &body in &self.awake {
            for &Neighbour { other, pair, .. } in &self.members[body as usize].neighbours {
                if other > body && self.members[other as usize].is_awake && self.near.is_coupled(pair, &self.members) {
                    self.forest.coupled.push(pair);
                    if self.is_free(body) || self.is_free(other) {
                        self.forest.join(body, other);
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
            let root = self.forest.root(body);
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
        for index in 0..self.forest.coupled.len() {
            let pair = self.forest.coupled[index];
            let free::Pair { a, b, .. } = *self.near.get(pair);
            let [of_a, of_b] = [a, b].map(|body| self.job_of[self.forest.root(body) as usize] as usize);
            groups[of_a].pairs.push((pair, true));
            if of_a != of_b {
                groups[of_a].sources.push(b);
                groups[of_b].sources.push(a);
                groups[of_b].pairs.push((pair, false));
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
        let is_pushed = member.pushes.iter().any(|push| push.start < span.end && push.end > span.start);
        let body = &member.body;
        let touches = |plane: &Plane| plane.depth(body.centre) + member.bounds.extent + member.bounds.way > 0.0;
        let is_driven =
            is_pushed || scene.bodies[index].force.is_some() || self.points_near(scene, span, index).next().is_some();
        if is_driven || scene.planes.iter().any(touches) {
            return true;
        }
        if member.rigid_spin.is_some() {
            return false;
        }
        if member.is_deformed() {
            return true;
        }
        match scene.bodies[index].path() {
            None => body.turns() && body.spin != DVec3::ZERO,
            Some(path) => {
                let bounds = path.bounds(span.start, span.end);
                if scene.bodies[index].material.response != Response::Rigid && path.kicks(span.start, span.end) > 0.0 {
                    return true;
                }
                match scene.bodies[index].material.response {
                    Response::Rigid => false,
                    Response::Inertial => bounds.acceleration != 0.0,
                    Response::World => bounds.acceleration != 0.0 || bounds.speed != 0.0,
                }
            }
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
                    let motion = path.at(span.end);
                    (member.body.centre, member.body.velocity) = (motion.position, motion.velocity);
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

    /// What acts on all bodies at `time` [s], beside pairs.
    fn field(&self, scene: &Scene, time: f64) -> Field {
        let pushes = self.members.iter().zip(0..).flat_map(|(member, body)| {
            let acting = member.pushes.iter().filter(move |push| push.start <= time && time < push.end);
            acting.map(move |&push| free::Push { body, ..push })
        });
        let forces = (0..).zip(&scene.bodies).filter_map(|(index, body)| Some((index, body.force.clone()?)));
        Field {
            gravity: scene.gravity,
            planes: scene.planes.clone(),
            pushes: pushes.collect(),
            forces: forces.collect(),
            weight: scene.influence.weight,
            scaling: scene.influence.scaling,
            first_point: scene.bodies.len() as u32,
            ..Field::default()
        }
    }

    /// The current state of all bodies, for their forces and conserved quantities.
    pub fn snapshot(&self, scene: &Scene, time: f64) -> Snapshot<'_> {
        let bodies = self.members.iter().map(|member| &member.body).chain(&self.points).collect();
        let here = Span { start: time, end: time };
        let on = |body: u32| {
            let near = self.points_near(scene, here, body as usize);
            near.map(move |(source, point)| {
                let window = Window { start: point.start, end: point.end() };
                Pair::with_point(body, source, point.strength, window, time)
            })
        };
        let with_points = (0..self.members.len() as u32).flat_map(on);
        Snapshot::new(bodies, self.pairs().copied().chain(with_points).collect(), self.field(scene, time), time)
    }

    /// Whether an island of these bodies takes steps of fixed length.
    fn fixed_steps_of(&self, bodies: &[u32]) -> FixedSteps {
        bodies.iter().map(|&body| self.members[body as usize].fixed).fold(FixedSteps::default(), FixedSteps::join)
    }

    /// Counts a step of fixed length of an island, and reports its error.
    fn report_fixed(&mut self, scene: &Scene, job: &Job, span: Span, report: &mut StepReport) {
        if !job.is_fixed {
            return;
        }
        let bodies = &job.group.bodies;
        let before = self.fixed_steps_of(bodies);
        let allowed = scene.tolerance * span.length();
        let (error, body) = (job.report.error, job.report.shortest.map_or(0, |(_, body)| body as usize));
        let is_calm = error <= CALM * allowed;
        let fixed = match before.left {
            0 => before.begin(),
            left => FixedSteps { left: left - u16::from(is_calm), ..before },
        };
        bodies.iter().for_each(|&body| self.members[body as usize].fixed = fixed);
        if error > allowed && report.shortfall.is_none_or(|worst| worst.error < error) {
            report.shortfall = Some(Shortfall { body: bodies[body] as usize, error, allowed });
        }
        if !self.has_fixed {
            self.has_fixed = true;
            let substep = job.report.shortest.map_or(span.length(), |(length, _)| length);
            report.fallback = Some(Fallback {
                step: report.step,
                time: span.end,
                bodies: bodies.len(),
                body: scene.bodies[bodies[body] as usize].name.clone(),
                tolerance: scene.tolerance,
                substep,
            });
        }
    }

    /// Reports the events of an island.
    fn report_events(&mut self, job: &Job, report: &mut StepReport) {
        for change in &job.report.changes {
            let (pair, is_own) = job.group.pairs[change.pair];
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
                let motion = path.at(span.end);
                (member.body.centre, member.body.velocity) = (motion.position, motion.velocity);
                if path.is_still(span.end, f64::INFINITY) {
                    self.put_to_sleep(body);
                }
                continue;
            }
            let free::Body { centre, velocity, .. } = &mut member.body;
            *centre += h * (*velocity + 0.5 * h * scene.gravity);
            *velocity += h * scene.gravity;
            member.step_length = f64::INFINITY;
            if let Some(spin) = member.rigid_spin {
                member.turn(spin, h);
            } else if scene.gravity == DVec3::ZERO && member.body.velocity == DVec3::ZERO {
                self.put_to_sleep(body);
            }
        }
        (self.stepped, self.unforced) = (stepped, unforced);
    }

    /// Moves the force points to where they are at `time` [s].
    fn move_points(&mut self, scene: &Scene, time: f64) {
        for (own, point) in self.points.iter_mut().zip(&scene.points) {
            let motion = point.path.at(time);
            (own.centre, own.velocity) = (motion.position, motion.velocity);
        }
    }

    /// Puts slow islands to rest, and clears the deformation of bodies on which nothing acts any more.
    fn sleep(&mut self, scene: &Scene, span: Span, jobs: &[Job], report: &mut StepReport) {
        for job in jobs {
            let Group { bodies, sources, pairs } = &job.group;
            let tolerance = |member: &Member| match member.fixed.left {
                0 => scene.tolerance,
                _ => MAX_SLOW_TOLERANCE,
            };
            let is_still = |body: &u32| {
                let path = scene.bodies[*body as usize].path();
                path.is_none_or(|path| path.is_still(span.end, f64::INFINITY))
            };
            let is_slow = |body: &u32| {
                let member = &self.members[*body as usize];
                let is_pushed = member.pushes.iter().any(|push| push.start <= span.end && push.end > span.end);
                let mut points = self.points_near(scene, span, *body as usize);
                let is_driven = is_pushed
                    || scene.bodies[*body as usize].force.is_some()
                    || points.any(|(_, point)| !point.path.is_still(span.end, f64::INFINITY));
                !is_driven && is_still(body) && member.is_slow(tolerance(member))
            };
            if sources.iter().all(is_still) && bodies.iter().all(is_slow) {
                let mut may_sleep = true;
                for &body in bodies {
                    let member = &mut self.members[body as usize];
                    may_sleep &= member.stays_slow(tolerance(member), span.length());
                }
                if may_sleep {
                    for &body in bodies {
                        report.ledger.rest -= self.members[body as usize].stop();
                        self.put_to_sleep(body);
                    }
                }
            } else {
                bodies.iter().for_each(|&body| self.members[body as usize].slow_steps = 0);
            }
            if let (&[body], []) = (&bodies[..], &pairs[..]) {
                let member = &mut self.members[body as usize];
                let touches =
                    |plane: &Plane| plane.depth(member.body.centre) + member.bounds.extent + member.bounds.way > 0.0;
                let is_turning = member.body.turns() && member.body.spin != DVec3::ZERO;
                if scene.planes.iter().any(touches) {
                    continue;
                }
                if is_turning {
                    if report.step.is_multiple_of(RIGID_SPIN_EVERY) {
                        member.rigid_spin = member.find_rigid_spin(scene.tolerance);
                    }
                } else if member.is_nearly_undeformed(scene.tolerance) {
                    member.clear_deformation();
                }
            }
        }
    }

    /// Puts a body to rest.
    fn put_to_sleep(&mut self, body: u32) {
        let member = &mut self.members[body as usize];
        (member.is_awake, member.fixed) = (false, FixedSteps::default());
        member.sleeping_hash = member.hash(body);
        self.sleeping_hash = self.sleeping_hash.wrapping_add(member.sleeping_hash);
    }
}

/// Decides which islands take steps of fixed length because adaptive ones are too much work, and which are advanced again.
/// Returns whether there are any. An island beyond the limit of the step may have been stopped anywhere after it, so only
/// its work up to the limit decides.
fn give_up_adaptive(jobs: &mut [Job], work: &Work) -> bool {
    let beyond = work.first_beyond(jobs.iter().map(|job| job.work));
    let (last, left) = beyond.unwrap_or((jobs.len(), 0));
    let counted = |turn: usize, job: &Job| if turn == last { job.work.min(left + 1) } else { job.work };
    let mut any = false;
    for (turn, job) in jobs.iter_mut().enumerate().take(last + 1).filter(|(_, job)| !job.is_fixed) {
        let is_unresolved = turn < last && matches!(job.failure, Some(free::Failure::Unresolved { .. }));
        let is_inside_out = || job.parts.bodies.iter().any(free::Body::is_inside_out);
        if counted(turn, job) > job.budget || (is_unresolved && !is_inside_out()) {
            (job.is_fixed, job.is_done, any) = (true, false, true);
        }
    }
    if beyond.is_some() && !any {
        let adaptive = jobs.iter_mut().enumerate().take(last + 1).filter(|(_, job)| !job.is_fixed);
        if let Some((_, job)) = adaptive.max_by_key(|(turn, job)| counted(*turn, job)) {
            (job.is_fixed, job.is_done, any) = (true, false, true);
        }
    }
    if any {
        let stopped = jobs.iter_mut().skip(last).filter(|job| job.failure.is_some() || job.work > job.budget);
        stopped.for_each(|job| job.is_done = false);
    }
    any
}

/// Failures.
impl Coupled {
    /// Whether the step can continue after the search for neighbours.
    fn check(&self, step: &Step<'_>) -> Result<(), Failure> {
        step.work.check().map_err(|stop| {
            let busiest = self.awake.iter().max_by_key(|&&body| self.members[body as usize].neighbours.len());
            let body = step.setting.scene.bodies[busiest.copied().unwrap_or_default() as usize].name.clone();
            step.failure(stop, Toil::Neighbours { body, pairs: self.near.count() })
        })
    }

    /// The failure of a step whose bodies moved farther than expected again and again.
    fn never_ends(&self, step: &Step<'_>) -> Failure {
        let body = self.jobs.iter().find(|job| !job.is_done).map_or(0, |job| job.group.bodies[0]);
        let member = &self.members[body as usize];
        let body = step.setting.scene.bodies[body as usize].name.clone();
        let toil = Toil::Forces { body, vertices: member.body.shape.rest().len(), spheres: member.neighbours.len() };
        step.failure(Stop::Overworked, toil)
    }

    /// What an island's bodies do that takes so much work.
    fn toil(&self, scene: &Scene, job: &Job) -> Toil {
        let bodies = &job.group.bodies;
        let demanding = job.report.shortest.and_then(|(_, body)| bodies.get(body as usize)).or(bodies.first());
        let body = demanding.copied().unwrap_or_default();
        let name = scene.bodies[body as usize].name.clone();
        let member = &self.members[body as usize];
        match bodies.len() {
            ..=1 => {
                let (vertices, spheres) = (member.body.shape.rest().len(), member.neighbours.len());
                Toil::Forces { body: name, vertices, spheres }
            }
            count => Toil::Together {
                bodies: count,
                body: name,
                pairs: job.group.pairs.len(),
                steps: job.report.steps,
                changes: job.report.changes.len(),
                tolerance: scene.tolerance,
            },
        }
    }

    fn failure(&self, scene: &Scene, report: &StepReport, job: &Job, failure: &free::Failure) -> Failure {
        let name = |body: usize| {
            let all = job.group.bodies.iter().chain(&job.group.sources);
            all.copied().nth(body).map_or_else(String::new, |body| scene.bodies[body as usize].name.clone())
        };
        let (time, toil) = match *failure {
            free::Failure::Chatter { a, b, time } => (time, Toil::Chatter { a: name(a as usize), b: name(b as usize) }),
            free::Failure::Unresolved { body, time, step } | free::Failure::Stopped { body, time, step } => {
                let is_inside_out = job.parts.bodies.get(body).is_some_and(free::Body::is_inside_out);
                let (body, length) = (name(body), step);
                (time, if is_inside_out { Toil::InsideOut { body } } else { Toil::Unresolved { body, length } })
            }
        };
        Overworked { step: report.step, time, toil }.into()
    }
}

/// Access to the state.
impl Coupled {
    /// Body `index` of the scene at the current time.
    pub fn view<'a>(&'a self, body: &'a scene::Body, index: usize) -> BodyView<'a> {
        let member = &self.members[index];
        BodyView { body, mesh: &member.mesh, centre: member.body.centre, solved: Solved::Coupled(member) }
    }

    /// A body.
    pub fn member(&self, index: usize) -> &Member {
        &self.members[index]
    }

    /// A hash of the exact state.
    pub fn hash(&self) -> u64 {
        let awake = self.awake.iter().map(|&body| self.members[body as usize].hash(body));
        awake.fold(self.sleeping_hash.wrapping_add(self.near.hash()), u64::wrapping_add)
    }

    /// All pairs that are near each other or not apart, in ascending order of their bodies.
    pub fn pairs(&self) -> impl Iterator<Item = &free::Pair> + '_ {
        (0..).zip(&self.members).flat_map(|(index, member)| {
            let later = member.neighbours.iter().filter(move |neighbour| neighbour.other > index);
            later.map(|neighbour| self.near.get(neighbour.pair))
        })
    }

    /// The pairs of a body, with the other body's index.
    pub fn pairs_of(&self, index: usize) -> impl Iterator<Item = (u32, &free::Pair)> + '_ {
        self.members[index].neighbours.iter().map(|neighbour| (neighbour.other, self.near.get(neighbour.pair)))
    }

    /// Calls `write` with the states of some bodies at `time` [s] within the last step, which began at `start` [s], on
    /// the solver's own solution. Omits bodies that took no step, and those that would be too much work.
    pub fn within(
        &self,
        setting: Setting<'_>,
        start: f64,
        time: f64,
        bodies: &[usize],
        work: &Tally<'_>,
        mut write: impl FnMut(usize, &Interpolated<'_>),
    ) {
        let ends = [start, setting.time()];
        for job in &self.jobs {
            let local = |&body: &usize| job.group.bodies.binary_search(&(body as u32)).ok();
            let own: Vec<usize> = bodies.iter().filter_map(local).collect();
            if !own.is_empty() {
                let name = |local: usize, body: &Interpolated<'_>| write(job.group.bodies[local] as usize, body);
                job.within(setting.scene, (ends, time), &own, setting.arch, work, name);
            }
        }
    }

    /// Number of bodies that are awake.
    pub fn awake_count(&self) -> usize {
        self.awake.len()
    }

    /// The phase of a pair.
    pub fn phase(&self, a: usize, b: usize) -> Phase {
        let found = self.pairs_of(a).find(|(other, _)| *other as usize == b);
        found.map_or(Phase::Apart, |(_, pair)| pair.phase)
    }

    /// What acts on a body at `time` [s], except its own oscillators and planes: gravity, carry, spheres in reach, pushes.
    pub fn surroundings_into(&self, scene: &Scene, index: usize, time: f64, surroundings: &mut Surroundings) {
        let Surroundings { uniform, weighted, sources } = surroundings;
        uniform.clear();
        weighted.clear();
        sources.clear();
        let member = &self.members[index];
        let carry = driven(scene, index as u32, time, false).carry;
        if carry != DVec3::ZERO {
            uniform.push((Cause::Carry, -carry));
        }
        let acting = member.pushes.iter().filter(|push| push.start <= time && time < push.end);
        weighted.extend(acting.map(|push| Weighted {
            cause: Cause::Push,
            direction: push.direction,
            strength: push.strength,
        }));
        for (other, pair) in self.pairs_of(index) {
            let (own, source) = (&member.body, &self.members[other as usize].body);
            let centre = source.centre - own.centre;
            let q = centre.length() / (own.radius + source.radius);
            let scaling = scene.influence.scaling.factor(own.radius, source.radius);
            let (strength, phase) = (scaling * pair.law.strength(pair.phase, q), pair.phase);
            let sphere_radius = source.sphere_radius;
            if strength != 0.0 && centre.length() <= sphere_radius + member.extent {
                sources.push(Source { origin: Origin::Body { index: other, phase }, centre, sphere_radius, strength });
            }
        }
        for (source, point) in scene.points_on(index).filter(|(_, point)| point.acts_at(time)) {
            let centre = point.path.position(time) - member.body.centre;
            let sphere_radius = scene.influence.sphere_radius(point.radius);
            if centre.length() <= sphere_radius + member.extent {
                let origin = Origin::Point { index: source - scene.bodies.len() as u32 };
                sources.push(Source { origin, centre, sphere_radius, strength: scene.point_strength(point, index) });
            }
        }
    }

    /// Memory allocated [bytes].
    pub fn memory(&self) -> usize {
        self.members.capacity() * size_of::<Member>()
            + self.members.iter().map(Member::memory).sum::<usize>()
            + self.jobs.iter().map(Job::memory).sum::<usize>()
            + self.near.memory()
            + (self.awake.capacity() + self.job_of.capacity()) * size_of::<u32>()
    }
}

#[cfg(test)]
mod tests;
