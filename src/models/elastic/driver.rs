//! The step of a scene: all bodies together, since free ones act on each other, and each needs the others' centres at the
//! same instants.
//!
//! A step is taken in intervals in which the motion of all centres is known in advance. Without free bodies that is the
//! whole step, and each body divides it as it needs; a free centre is known for one common step of all bodies. Phase
//! changes are located on these motions.
//!
//! # Lattice
//! Velocity Verlet. Free centres move on parabolas, and an interval ends where the first phase changes. Without free
//! bodies, a body divides the interval at the changes of its own pairs only. Springs and dampers act along the line
//! between two nodes, spheres along the line to a centre, so momentum and angular momentum are conserved.
//!
//! # Finite elements
//! Linear elements are not invariant under rotation, so a free body is co-rotated as a whole: displacements are measured
//! in axes Q that rotate with it, the best fit to its nodes at the middle of a step (Müller et al., Meshless
//! Deformations Based on Shape Matching, 2005; Terzopoulos and Witkin, Physically based models with rigid and
//! deformable components, 1988, use such axes, too). Axes per element would handle larger deformations, but A in
//! [`fem`](crate::models::fem), and so the factor that makes the method fast, would change in every step. The price: a
//! body bent by tens of degrees swells at the bend.
//!
//! Linear forces exert a second-order torque about the displaced nodes, which would rotate an isolated body. A rigid
//! rotation at the end of each step removes it, so that only external torques change the angular momentum. If a pair
//! changes its phase within a step, spheres act in proportion to time, because the factor requires a fixed step.

use std::{
    borrow::Cow,
    collections::BTreeMap,
    sync::{Arc, atomic::AtomicBool},
    time::{Duration, Instant as Clock},
};

use glam::{DMat3, DVec3};

use super::{
    Elastic,
    act::{Course, ExternalForces, Instantaneous, StepContext, mean_motion},
    body::{Body, Finite, Matter, OF_LIMIT},
    free::Free,
    friction::{Contact, impulses},
    note_phase,
};
use crate::{
    interrupt::is_raised,
    model::{
        phase::Phase,
        shape_matching::{best_rotation, outer, resistance, solve},
    },
    models::lattice::{Outside, Scheme},
    observe::{PairEvent, StepFailure},
    parallel,
    scene::{Integrator, Model, Path, Scene, path::Kinematics},
    sim::{
        Event,
        events::{PairPaths, Search},
        reach::Ball,
        terms::{self, carry},
        work::{Tally, Work},
    },
};

/// Upper limit on the springs evaluated in a step, of a body or of all that are stepped together; more would take
/// too long.
const MAX_SPRINGS: f64 = 2e8;
/// Upper limit on phase changes of a pair in a step, if there are free bodies: each divides it, and more would take too
/// long.
const MAX_CHANGES: usize = 1000;
/// The same of all pairs together.
const MAX_ALL_CHANGES: usize = 20_000;
/// Work for finding the phase changes of a step [units of a step's work]: a second or two.
const MAX_SEARCH: u64 = 1_000_000_000;
/// With fewer nodes than this, a second thread does not pay off for a step …
const PARALLEL_NODES: usize = 128;
/// … and with fewer than this, not for its end.
const PARALLEL_ENDS: usize = 2048;

impl Elastic {
    pub(super) fn take_step(&mut self) {
        self.events.clear();
        self.tears.clear();
        if self.failure.as_ref().is_some_and(|failure| !failure.is_whole_step()) {
            return;
        }
        let ends = [self.time_of(self.step), self.time_of(self.step + 1)];
        let begun = Clock::now();
        self.failure = None;
        self.timings = [Duration::ZERO; 3];
        for body in &mut self.bodies {
            (body.statistics.substeps, body.statistics.strain, body.statistics.tension) = (0, 0.0, 0.0);
            body.tears.clear();
            body.failure = None;
        }
        let taken = match self.scene.model {
            Model::Fem => self.take_implicit(ends),
            _ => self.take_explicit(ends),
        };
        let taken =
            taken.and_then(|()| self.for_each_body(ends, &[], PARALLEL_ENDS, |around, body| body.finish(around)));
        self.failure = taken.err();
        if self.failure.as_ref().is_none_or(StepFailure::is_whole_step) {
            self.end_step(ends[1]);
        }
        self.timings[2] = begun.elapsed().saturating_sub(self.timings[0] + self.timings[1]);
    }

    /// Works on all bodies, given what they share in an interval [s] and the phase changes in it; on several threads from
    /// `parallel_from` nodes on.
    fn for_each_body(
        &mut self,
        [start, end]: [f64; 2],
        events: &[PairEvent],
        parallel_from: usize,
        work: impl Fn(&StepContext<'_>, &mut Body) + Sync + Send,
    ) -> Result<(), StepFailure> {
        let Elastic { scene, bodies, phases, step, .. } = self;
        let courses = courses(scene, bodies, start);
        let around = StepContext { scene, courses: &courses, phases, events, start, end, step: *step + 1 };
        let nodes: usize = bodies.iter().filter(|body| !body.sleeps(&around)).map(Body::node_count).sum();
        parallel::over(nodes >= parallel_from, bodies, |_, body| work(&around, body));
        // that of the first body, whichever thread finished first
        bodies.iter_mut().find_map(|body| body.failure.take()).map_or(Ok(()), Err)
    }

    /// Takes a step of lattices.
    fn take_explicit(&mut self, [start, end]: [f64; 2]) -> Result<(), StepFailure> {
        let Elastic { scene, phases, step, .. } = &*self;
        let around = StepContext { scene, courses: &[], phases, events: &[], start, end, step: *step + 1 };
        let jumps = around.all_jumps();
        let mut breaks = vec![start, end];
        if self.has_free {
            breaks.extend_from_slice(&jumps);
            breaks.sort_unstable_by(f64::total_cmp);
            breaks.dedup();
        }
        for part in breaks.windows(2) {
            if jumps.contains(&part[0]) {
                self.bodies.iter_mut().for_each(Body::forget);
            }
            self.take_part([part[0], part[1]])?;
        }
        Ok(())
    }

    /// Takes a part of a step of lattices, without jumps inside if there are free bodies.
    fn take_part(&mut self, [start, end]: [f64; 2]) -> Result<(), StepFailure> {
        self.find_sources(start, end);
        let count = self.common_steps([start, end])?;
        let mut t = start;
        for number in 1..=count {
            let to = if number == count { end } else { start + (end - start) * (number as f64 / count as f64) };
            while t < to {
                self.check_interrupt()?;
                if [t, to] != [start, end] {
                    self.find_sources(t, to);
                }
                self.start_interval([t, to])?;
                let mut changes = self.changes([t, to], self.has_free)?;
                // a change right now comes before the interval
                let ends_at = |first: &&PairEvent| self.has_free || first.time == t;
                let until = changes.first().filter(ends_at).map_or(to, |first| first.time);
                changes.retain(|change| change.time <= until);
                if until > t {
                    self.advance([t, until], &changes)?;
                }
                for change in changes {
                    if change.time == until {
                        [change.a, change.b].into_iter().for_each(|body| self.bodies[body].forget());
                    }
                    self.record(change);
                }
                t = until;
            }
        }
        Ok(())
    }

    /// Number of steps that lattices must take together in a part of a step: 1 without free bodies.
    fn common_steps(&mut self, [start, end]: [f64; 2]) -> Result<u64, StepFailure> {
        let Elastic { scene, bodies, phases, step, .. } = self;
        let around = StepContext { scene, courses: &[], phases, events: &[], start, end, step: *step + 1 };
        let (mut limit, mut stiffest, mut springs) = (f64::INFINITY, 0, 0);
        for body in bodies {
            let planes = body.planes_in_reach(scene).map(|plane| plane.stiffness).sum::<f64>() * body.surface.contact;
            let outside = around.stiffness(body.index, &body.sources) + planes;
            let Matter::Lattice(of) = &body.matter else { continue };
            body.statistics.step_limit = of.lattice.step_limit(outside);
            springs += of.lattice.spring_count();
            if body.statistics.step_limit < limit {
                (limit, stiffest) = (body.statistics.step_limit, body.index);
            }
        }
        if self.has_free { around.steps(stiffest, limit, end - start, springs) } else { Ok(1) }
    }

    /// Evaluates the forces at the start of an interval where they are unknown, if free centres need them.
    fn start_interval(&mut self, ends: [f64; 2]) -> Result<(), StepFailure> {
        if !self.has_free {
            return Ok(());
        }
        if !self.bodies.iter().all(Body::is_known) {
            self.for_each_body(ends, &[], PARALLEL_NODES, |around, body| {
                if !body.is_known() {
                    body.pull(around, ends, ends[0], 0.0, 0);
                }
            })?;
            self.accelerate_centres();
        }
        if self.scene.integrator != Integrator::Euler && self.scene.planes.iter().any(|plane| plane.friction > 0.0) {
            self.for_each_body(ends, &[], PARALLEL_NODES, |around, body| {
                if body.free.is_some() {
                    body.rub(around, ends, ends[0], ends[1] - ends[0]);
                }
            })?;
            self.accelerate_centres();
        }
        Ok(())
    }

    /// Advances lattices over an interval, with the phase changes in it, and evaluates the forces at its end.
    fn advance(&mut self, ends: [f64; 2], changes: &[PairEvent]) -> Result<(), StepFailure> {
        let (is_common, interrupt) = (self.has_free, self.options.interrupt);
        self.for_each_body(ends, changes, PARALLEL_NODES, |around, body| {
            body.failure = body.advance(around, is_common, interrupt).err();
        })?;
        let h = ends[1] - ends[0];
        for free in self.bodies.iter_mut().filter_map(|body| body.free.as_mut()) {
            (free.centre, free.velocity) =
                (free.motion().after(h).position, free.velocity + free.acceleration * (0.5 * h));
        }
        self.accelerate_centres();
        for free in self.bodies.iter_mut().filter_map(|body| body.free.as_mut()) {
            free.velocity += free.acceleration * (0.5 * h);
        }
        Ok(())
    }

    /// Updates c″ = f̄ + g + R/M of free bodies from the last external forces.
    fn accelerate_centres(&mut self) {
        if !self.has_free {
            return;
        }
        let mut reactions = vec![DVec3::ZERO; self.bodies.len()];
        for body in &self.bodies {
            body.acted.pulls.iter().for_each(|&(source, pull)| reactions[source as usize] -= pull);
        }
        let free_fall = terms::free_fall(&self.scene);
        for (body, reaction) in self.bodies.iter_mut().zip(reactions) {
            let mass = body.free_mass();
            if let Some(free) = &mut body.free {
                let back = if mass > 0.0 { reaction / mass } else { DVec3::ZERO };
                free.acceleration = body.acted.mean + body.acted.rubbed + free_fall + back;
            }
        }
    }

    /// Takes a step of finite elements.
    fn take_implicit(&mut self, [start, end]: [f64; 2]) -> Result<(), StepFailure> {
        let divided = self.divided;
        let at = |step: u64| start + (end - start) * (step as f64 / divided as f64);
        for number in 0..divided {
            self.check_interrupt()?;
            let (ends, h) = ([at(number), at(number + 1)], (end - start) / divided as f64);
            self.find_sources(ends[0], ends[1]);
            for (body, described) in self.bodies.iter_mut().zip(&self.scene.bodies) {
                if let Some(path) = described.path() {
                    body.kick(carry::kick(&described.material, path, ends[0]));
                }
            }
            // how free centres move depends on the forces, which depend on the phases
            if self.has_free {
                self.for_each_body(ends, &[], PARALLEL_NODES, |around, body| body.load(around, h))?;
                self.accelerate_centres();
            }
            let changes = self.changes(ends, false)?;
            let is_loaded = self.has_free && changes.is_empty();
            self.for_each_body(ends, &changes, PARALLEL_NODES, |around, body| {
                if !is_loaded {
                    body.load(around, h);
                }
                body.step_implicit(around.start, h);
            })?;
            self.accelerate_centres();
            for free in self.bodies.iter_mut().filter_map(|body| body.free.as_mut()) {
                (free.centre, free.velocity) = (free.motion().after(h).position, free.velocity + free.acceleration * h);
            }
            changes.into_iter().for_each(|change| self.record(change));
        }
        Ok(())
    }

    fn check_interrupt(&self) -> Result<(), StepFailure> {
        match is_raised(self.options.interrupt) {
            true => Err(interrupted(self.step + 1)),
            false => Ok(()),
        }
    }

    /// Records a phase change.
    fn record(&mut self, event: PairEvent) {
        note_phase(&mut self.phases, &event);
        self.events.push(event);
    }

    /// Finds the bodies and force points whose spheres can reach each body within some time, and the bodies near it.
    pub(super) fn find_sources(&mut self, start: f64, end: f64) {
        let begun = Clock::now();
        let Elastic { scene, bodies, grid, farthest, .. } = self;
        for (body, described) in bodies.iter_mut().zip(&scene.bodies) {
            let (centre, spread) = match (&body.free, described.path()) {
                (Some(free), _) => (free.centre, free.farthest(end - start)),
                (None, Some(path)) => {
                    let (centre, spread) = path.ball(start, end);
                    // a body that jumps is in several places; jumps are rare, so a ball around all of them is good enough
                    let knots = if path.is_held() { path.knots() } else { &[] };
                    let places = knots.iter().filter(|&&knot| knot > start && knot <= end);
                    (centre, places.map(|&knot| path.position(knot).distance(centre)).fold(spread, f64::max))
                }
                (None, None) => continue,
            };
            let extent = body.extent + body.speed * (end - start);
            let reach = described.sphere_radius().max(extent).max(*farthest * described.radius);
            let ball = Ball { centre, radius: (reach + spread) * (1.0 + 1e-12) };
            body.reach = extent + spread;
            body.spread = spread;
            if body.placed != Some(ball) {
                grid.place(body.index as u32, ball);
                body.placed = Some(ball);
            }
        }
        let centres: Vec<_> = bodies.iter().map(|body| body.placed.unwrap_or_default().centre).collect();
        let spheres: Vec<f64> =
            bodies.iter().zip(&scene.bodies).map(|(body, described)| described.sphere_radius() + body.spread).collect();
        let (grid, scene) = (&*grid, &*scene);
        bodies.iter_mut().for_each(|body| {
            body.near.clear();
            grid.touching(body.index as u32, &mut body.near);
            let (centre, reach) = (centres[body.index], body.reach);
            let is_in_reach = |&&other: &&u32| {
                let other = other as usize;
                let within = (reach + spheres[other]) * (1.0 + 1e-12);
                centre.distance_squared(centres[other]) <= within * within
            };
            body.sources.clear();
            body.sources.extend(body.near.iter().filter(is_in_reach));
            let acting = scene.points_on(body.index).filter(|(_, point)| point.start <= end && start <= point.end());
            let near = acting.filter(|(_, point)| {
                let (place, spread) = point.path.ball(start, end);
                let within = reach + scene.influence.sphere_radius(point.radius) + spread;
                point.path.is_held() || !(centre.distance(place) > within * (1.0 + 1e-12))
            });
            body.sources.extend(near.map(|(source, _)| source));
        });
        self.timings[0] += begun.elapsed();
    }

    /// The pairs of bodies that are near each other or not apart, ascending.
    pub(super) fn near_each_other(&self) -> Vec<[u32; 2]> {
        let mut pairs: Vec<[u32; 2]> = self.phases.keys().copied().collect();
        for body in &self.bodies {
            let index = body.index as u32;
            pairs.extend(body.near.iter().filter(|&&other| other > index).map(|&other| [index, other]));
        }
        pairs.sort_unstable();
        pairs.dedup();
        pairs
    }

    /// The phase changes in an interval, in order of time; only the first if `only_first`.
    fn changes(&mut self, [start, end]: [f64; 2], only_first: bool) -> Result<Vec<PairEvent>, StepFailure> {
        let (begun, step) = (Clock::now(), self.step + 1);
        let mut found: Vec<PairEvent> = Vec::new();
        let work = Work::limited(MAX_SEARCH, self.options.interrupt);
        let tally = Tally::new(&work, None);
        let mut counts: BTreeMap<[usize; 2], usize> = BTreeMap::new();
        self.events.iter().for_each(|event| *counts.entry([event.a, event.b]).or_default() += 1);
        for pair in self.near_each_other() {
            let [a, b] = pair.map(|body| body as usize);
            let (one, other) = (&self.bodies[a], &self.bodies[b]);
            if [one, other].iter().all(|body| body.free.is_none() && body.spread == 0.0) {
                continue; // neither moves
            }
            let path = |body: &Body| match (&body.free, self.scene.bodies[body.index].path()) {
                (Some(free), _) => Cow::Owned(free.path(None, start, end)),
                (None, Some(path)) => Cow::Borrowed(path),
                (None, None) => Cow::Owned(Path::Fixed(DVec3::ZERO)),
            };
            let [from_one, from_other] = match (&one.free, &other.free) {
                // they may be fast, but hardly move relative to each other
                (Some(one), Some(other)) => {
                    [Cow::Owned(Path::Fixed(DVec3::ZERO)), Cow::Owned(other.path(Some(one), start, end))]
                }
                _ => [path(one), path(other)],
            };
            let between = PairPaths { a: &from_one, b: &from_other, radii: one.radius + other.radius };
            let thresholds = self.scene.law(a, b).thresholds;
            let search = Search { paths: between, thresholds: &thresholds, work: &tally };
            let mut phase = self.phases.get(&pair).copied().unwrap_or(Phase::Apart);
            let (mut from, mut count) = (start, counts.get(&[a, b]).copied().unwrap_or(0));
            let too_much = |what: &str| {
                let [a, b] = pair.map(|body| &self.scene.bodies[body as usize].name);
                StepFailure::NotTaken(format!(
                    "too much to do in step {step} (from t = {start:.6} s on): bodies \"{a}\" and \"{b}\" {what}"
                ))
            };
            while let Some((time, to)) = search.first_change(phase, from, end) {
                let ([a, b], q, rate) = (pair, between.q(time), between.rate(time));
                found.push(PairEvent::from(&Event { time, step, a, b, q, rate, from: phase, to, energy: 0.0 }));
                (from, phase, count) = (time, to, count + 1);
                if self.has_free && self.events.len() + found.len() > MAX_ALL_CHANGES {
                    return Err(StepFailure::NotTaken(format!(
                        "too much to do in step {step} (from t = {start:.6} s on): bodies change their phases more than {MAX_ALL_CHANGES} \
                         times; lower dt"
                    )));
                }
                if self.has_free && count > MAX_CHANGES {
                    return Err(too_much(
                        "change their phase again and again; set core_width, or move merge_at, split_at and core_at apart",
                    ));
                }
                if only_first {
                    break;
                }
            }
            if tally.is_over() {
                self.check_interrupt()?;
                return Err(too_much("move too fast to find when they change phase; lower their velocities"));
            }
        }
        found.sort_by(|x, y| x.time.total_cmp(&y.time).then((x.a, x.b).cmp(&(y.a, y.b))));
        if only_first {
            found.truncate(1);
        }
        self.timings[1] += begun.elapsed();
        Ok(found)
    }
}

/// The motion of all centres, and of the force points, from `start` on [s].
fn courses<'a>(scene: &'a Scene, bodies: &[Body], start: f64) -> Vec<Course<'a>> {
    let of_bodies = bodies.iter().zip(&scene.bodies).filter_map(|(body, described)| {
        let free = body.free.as_ref().map(|free| match scene.model {
            // only the velocity determines the middle of an implicit step, where its forces are evaluated
            Model::Fem => Course::Parabola(start, Kinematics { acceleration: DVec3::ZERO, ..free.motion() }),
            _ => Course::Parabola(start, free.motion()),
        });
        free.or(described.path().map(Course::Path))
    });
    of_bodies.chain(scene.points.iter().map(|point| Course::Path(&point.path))).collect()
}

fn interrupted(step: u64) -> StepFailure {
    StepFailure::Interrupted(format!("interrupted in step {step}"))
}

impl StepContext<'_> {
    /// Number of explicit steps in some time [s], given the longest stable one of a body [s], and the number of springs to
    /// evaluate in each.
    fn steps(&self, body: usize, limit: f64, time: f64, springs: usize) -> Result<u64, StepFailure> {
        let count = match self.scene.integrator {
            Integrator::Exponential => (time / (OF_LIMIT * limit)).ceil().max(1.0),
            _ => 1.0,
        };
        if count * springs as f64 <= MAX_SPRINGS {
            return Ok(count as u64);
        }
        Err(StepFailure::NotTaken(format!(
            "too much to do in step {} (from t = {:.6} s on): the springs of body \"{}\" need steps below {limit:.1e} s, {count:.0} per step of the \
             scene; lower `omega`, `damping` or `cells` in [lattice]",
            self.step, self.start, self.scene.bodies[body].name
        )))
    }
}

impl Body {
    /// Whether the forces on its nodes are known for the current positions.
    fn is_known(&self) -> bool {
        match &self.matter {
            Matter::Lattice(springs) => springs.motion.accelerations.len() == springs.lattice.node_count(),
            Matter::Fem(_) => true,
        }
    }

    /// Marks the forces on its nodes as out of date.
    pub fn forget(&mut self) {
        if let Matter::Lattice(springs) = &mut self.matter {
            springs.motion.accelerations.clear();
        }
    }

    /// Advances a lattice over an interval: in one step if all bodies take `is_common` steps, otherwise in as many as it
    /// needs between the jumps of what acts on it.
    fn advance(
        &mut self,
        around: &StepContext<'_>,
        is_common: bool,
        interrupt: Option<&'static AtomicBool>,
    ) -> Result<(), StepFailure> {
        if self.sleeps(around) {
            self.acted.clear();
            return Ok(());
        }
        let Matter::Lattice(springs) = &self.matter else { return Ok(()) };
        let springs = springs.lattice.spring_count();
        let described = &around.scene.bodies[self.index];
        self.is_at_rest = false;
        for (number, ends) in around.breaks(self.index, &self.sources, &self.pushes).windows(2).enumerate() {
            if number > 0 {
                self.forget();
            }
            if let Some(path) = described.path() {
                self.kick(carry::kick(&described.material, path, ends[0]));
            }
            let (length, limit) = (ends[1] - ends[0], self.statistics.step_limit);
            let count = if is_common { 1 } else { around.steps(self.index, limit, length, springs)? };
            let h = length / count as f64;
            for step in 0..count {
                if is_raised(interrupt) {
                    return Err(interrupted(around.step));
                }
                self.pull(around, [ends[0], ends[1]], ends[0] + h * step as f64, h, 1);
            }
        }
        self.measure();
        Ok(())
    }

    /// Takes `count` steps of `h` of a lattice from time `t` [s] on, in an interval without jumps; 0 only evaluates the
    /// forces.
    fn pull(&mut self, around: &StepContext<'_>, ends: [f64; 2], t: f64, h: f64, count: u64) {
        let scheme = if around.scene.integrator == Integrator::Euler { Scheme::Euler } else { Scheme::Verlet };
        if self.free.is_none() && scheme == Scheme::Verlet && count > 0 && !around.scene.planes.is_empty() {
            if !self.is_known() {
                self.pull(around, ends, t, 0.0, 0);
            }
            self.rub(around, ends, t, h);
        }
        let Matter::Lattice(springs) = &mut self.matter else { return };
        let mut motion = std::mem::take(&mut springs.motion);
        let (now, acted) = (std::mem::take(&mut self.now), std::mem::take(&mut self.acted));
        let kicked = if scheme == Scheme::Verlet { 0.5 * h } else { 0.0 };
        let before = acted.mean + acted.rubbed;
        let mut outside = External { body: self, around, ends, t, kicked, before, now, acted };
        let Matter::Lattice(springs) = &outside.body.matter else { return };
        let largest = springs.lattice.advance(&mut motion, scheme, h, count, &mut outside);
        let External { now, acted, .. } = outside;
        if let Matter::Lattice(springs) = &mut self.matter {
            springs.motion = motion;
        }
        (self.now, self.acted) = (now, acted);
        self.statistics.strain = self.statistics.strain.max(largest - 1.0);
        self.statistics.substeps += count;
    }

    /// Finds the friction in the first half of a step of `h` of a lattice from time `t` on [s].
    fn rub(&mut self, around: &StepContext<'_>, ends: [f64; 2], t: f64, h: f64) {
        let Matter::Lattice(springs) = &self.matter else { return };
        let motion = &springs.motion;
        let (half, centre) = (0.5 * h, around.courses[self.index].at(t, ends[1]));
        let contacts = self.rubbing(around.scene, centre.position, &motion.positions);
        if contacts.is_empty() {
            self.acted.rubbed = DVec3::ZERO;
            if let Matter::Lattice(springs) = &mut self.matter {
                springs.motion.friction.clear();
            }
            return;
        }
        let without = |free: &Free| free.velocity + (free.acceleration - self.acted.rubbed) * half;
        let moving = self.free.as_ref().map_or(centre.velocity, without);
        let now = self.free.as_ref().map_or(centre.velocity, |free| free.velocity);
        let kicked = motion.velocities.iter().zip(&motion.accelerations).map(|(u, a)| *u + *a * half);
        let velocities: Vec<DVec3> = kicked.collect();
        let (friction, mean) = self.friction(&contacts, half, (&motion.velocities, now), (&velocities, moving));
        self.acted.rubbed = mean;
        if let Matter::Lattice(springs) = &mut self.matter {
            springs.motion.friction = friction;
        }
    }

    /// The accelerations of the nodes by friction in a kick of `h` [s], for a free body minus their mean, and that mean
    /// [scene unit/s²], given a guess of the velocities of the nodes and of the centre at the end of the kick, and what they
    /// are without friction [scene unit/s].
    fn friction(
        &self,
        contacts: &[Contact<'_>],
        h: f64,
        guess: (&[DVec3], DVec3),
        without: (&[DVec3], DVec3),
    ) -> (Vec<DVec3>, DVec3) {
        if contacts.is_empty() || self.free.is_some() && self.free_mass() == 0.0 {
            return (Vec::new(), DVec3::ZERO);
        }
        let (masses, held) = (self.masses(), self.held());
        let per_mass = |of: &mut [DVec3]| match &self.matter {
            Matter::Lattice(_) => {
                let nodes = of.iter_mut().zip(masses).zip(held);
                nodes.for_each(|((v, mass), held)| *v = if *held { DVec3::ZERO } else { *v / *mass });
            }
            Matter::Fem(finite) => finite.respond(self.axes(), of),
        };
        let all = |(nodes, centre): (&[DVec3], DVec3)| nodes.iter().map(|u| *u + centre).collect::<Vec<_>>();
        let mut friction = impulses(contacts, h, &all(guess), &all(without), masses, per_mass);
        let whole: DVec3 = friction.iter().zip(held).filter(|(_, held)| !**held).map(|(impulse, _)| *impulse).sum();
        let mean = if self.free.is_some() { whole / (h * self.free_mass()) } else { DVec3::ZERO };
        for ((v, mass), held) in friction.iter_mut().zip(masses).zip(held) {
            *v = if *held { DVec3::ZERO } else { *v / (h * *mass) - mean };
        }
        (friction, mean)
    }

    /// Writes what acts on the body at time `t` to `now`, in an interval of constant phases or averaged over one [s].
    fn find_acting(&self, around: &StepContext<'_>, ends: [f64; 2], t: f64, now: &mut Instantaneous) {
        let motion = around.courses[self.index].at(t, ends[1]);
        let described = &around.scene.bodies[self.index];
        now.uniform = match described.path() {
            Some(_) => terms::uniform(around.scene, &described.material, &motion),
            None => DVec3::ZERO,
        };
        now.centre = motion.position;
        now.rotation = self.free.as_ref().map(|free| free.turned(t)).unwrap_or_default();
        around.acting(self.index, &self.sources, &self.pushes, ends, t, now);
    }

    /// Evaluates the external forces on finite elements at the middle of a step of `h` [s].
    fn load(&mut self, around: &StepContext<'_>, h: f64) {
        let mut acted = std::mem::take(&mut self.acted);
        let before = acted.mean + acted.rubbed;
        acted.clear();
        if self.sleeps(around) {
            self.acted = acted;
            return;
        }
        self.is_at_rest = false;
        let (mut now, mut loads) = (std::mem::take(&mut self.now), std::mem::take(&mut acted.loads));
        let (ends, half) = ([around.start, around.end], 0.5 * h);
        self.find_acting(around, ends, around.start + half, &mut now);
        let described = &around.scene.bodies[self.index];
        if let Some(path) = described.path() {
            now.uniform = terms::uniform(around.scene, &described.material, &mean_motion(path, ends));
        }
        let [positions, velocities] = self.state();
        acted.places.clear();
        acted.places.extend(positions.iter().zip(velocities).map(|(s, u)| *s + *u * half));
        loads.resize(positions.len(), DVec3::ZERO);
        let places = std::mem::take(&mut acted.places);
        self.act(around.scene, &now, &places, &mut loads, &mut acted);
        let contacts = self.rubbing(around.scene, now.centre, &places);
        if !contacts.is_empty() {
            self.fit_axes(&places, around.start + half);
            let without = |free: &Free| free.velocity + (acted.mean + free.acceleration - before) * h;
            let on_path = || around.courses[self.index].at(around.end, around.end).velocity;
            let (now, moving) = match &self.free {
                Some(free) => (free.velocity, without(free)),
                None => (on_path(), on_path()),
            };
            let axes = self.free.as_ref().map(|_| self.axes());
            let Matter::Fem(finite) = &mut self.matter else { return };
            finite.step(&self.rest, axes, &loads);
            let mut ahead = vec![DVec3::ZERO; loads.len()];
            for (velocity, &node) in finite.motion.velocities.iter().zip(&finite.element.free) {
                ahead[node as usize] = axes.map_or(*velocity, |axes| axes * *velocity);
            }
            let [_, velocities] = self.state();
            let (friction, mean) = self.friction(&contacts, h, (velocities, now), (&ahead, moving));
            loads.iter_mut().zip(&friction).for_each(|(load, friction)| *load += *friction);
            acted.rub(friction, mean);
        }
        (acted.loads, acted.places) = (loads, places);
        (self.now, self.acted) = (now, acted);
    }

    /// Takes a step of finite elements from `t` [s] with the forces evaluated before.
    fn step_implicit(&mut self, t: f64, h: f64) {
        let [positions, velocities] = self.state();
        let stays = || self.acted.loads.iter().chain(velocities).all(|v| *v == DVec3::ZERO) && positions == self.rest;
        if self.is_at_rest || stays() {
            return;
        }
        self.statistics.substeps += 1;
        let acted = std::mem::take(&mut self.acted);
        self.fit_axes(&acted.places, t + 0.5 * h);
        let axes = self.free.as_ref().map(|_| self.axes());
        if let Matter::Fem(finite) = &mut self.matter {
            finite.advance(&self.rest, axes, &acted, h);
        }
        self.acted = acted;
    }

    /// Fits the axes of a free body to the positions of its nodes at time `t` [s].
    fn fit_axes(&mut self, places: &[DVec3], t: f64) {
        let fit = self.moment_of(places);
        if let Some(free) = &mut self.free {
            (free.rotation, free.fitted) = (best_rotation(fit, free.rotation), t);
        }
    }

    /// Updates the distance of the farthest node and the speed of the fastest.
    pub fn measure(&mut self) {
        let largest = |of: &[DVec3]| of.iter().map(|v| v.length_squared()).fold(0.0, f64::max).sqrt();
        [self.extent, self.speed] = self.state().map(largest);
    }

    /// Ends a step: tears, fits the rest shape, updates displacements.
    fn finish(&mut self, around: &StepContext<'_>) {
        if !self.is_at_rest {
            let on_path =
                || around.scene.bodies[self.index].path().map_or(DVec3::ZERO, |path| path.position(around.end));
            let centre = self.free.as_ref().map_or_else(on_path, |free| free.centre);
            let before = self.statistics.torn;
            self.tear(around, centre);
            if self.statistics.torn != before {
                self.recentre();
            }
            self.fit();
            if let Some(free) = &mut self.free {
                free.fitted = around.end;
            }
            self.strain(around, centre);
        }
        self.update_state(around);
    }
}

impl Finite {
    /// Takes a step with these accelerations at its middle, in `axes` if it is free; the result is in `motion`.
    fn step(&mut self, rest: &[DVec3], axes: Option<DMat3>, loads: &[DVec3]) {
        let Finite { element, stepper, motion, positions, velocities, forces, .. } = self;
        let back = axes.map(|axes| axes.transpose());
        let in_axes = |v: DVec3| back.map_or(v, |back| back * v);
        forces.clear();
        for (i, &node) in element.free.iter().enumerate() {
            let node = node as usize;
            motion.displacements[i] = in_axes(positions[node]) - rest[node];
            motion.velocities[i] = in_axes(velocities[node]);
            forces.push(in_axes(loads[node]) * element.masses[node]);
        }
        stepper.step(element, motion, forces);
    }

    /// Turns impulses on the nodes into the velocities that they cause in a step.
    fn respond(&self, axes: DMat3, of: &mut [DVec3]) {
        let nodes = || self.element.free.iter().map(|&node| node as usize);
        let back = axes.transpose();
        let mut changes: Vec<DVec3> = nodes().map(|node| back * of[node]).collect();
        self.stepper.respond(&mut changes);
        of.fill(DVec3::ZERO);
        nodes().zip(changes).for_each(|(node, change)| of[node] = axes * change);
    }

    /// Takes a step of `h` [s] with the forces evaluated before.
    fn advance(&mut self, rest: &[DVec3], axes: Option<DMat3>, acted: &ExternalForces, h: f64) {
        let element = Arc::clone(&self.element);
        let masses = &element.masses;
        // L + h Σ m s×f, where the forces act
        let momentum = |positions: &[DVec3], velocities: &[DVec3]| -> DVec3 {
            positions.iter().zip(velocities).zip(masses).map(|((s, u), m)| s.cross(*u) * *m).sum()
        };
        let expected = momentum(&self.positions, &self.velocities) + momentum(&acted.places, &acted.loads) * h;
        self.step(rest, axes, &acted.loads);
        let Finite { motion, positions, velocities, .. } = self;
        let from_axes = |v: DVec3| axes.map_or(v, |axes| axes * v);
        for (i, &node) in element.free.iter().enumerate() {
            let node = node as usize;
            positions[node] = from_axes(motion.displacements[i] + rest[node]);
            velocities[node] = from_axes(motion.velocities[i]);
        }
        if axes.is_none() {
            return;
        }
        // remove the mean, which is only rounding errors
        let all: f64 = masses.iter().sum();
        for of in [&mut *positions, &mut *velocities] {
            let mean = of.iter().zip(masses).map(|(v, m)| *v * *m).sum::<DVec3>() / all;
            of.iter_mut().for_each(|v| *v -= mean);
        }
        let mut spread = DMat3::ZERO;
        for (s, m) in positions.iter().zip(masses) {
            spread += outer(*s * *m, *s);
        }
        let turn = solve(resistance(spread), expected - momentum(positions, velocities));
        if turn.is_finite() {
            positions.iter().zip(velocities.iter_mut()).for_each(|(s, u)| *u += turn.cross(*s));
        }
    }
}

/// What acts on a lattice from outside, in a step from time `t` on [s].
struct External<'a> {
    body: &'a Body,
    around: &'a StepContext<'a>,
    ends: [f64; 2],
    t: f64,
    /// How long the velocity of a free centre has changed before the last kick [s].
    kicked: f64,
    /// f̄ of the last evaluation [scene unit/s²].
    before: DVec3,
    now: Instantaneous,
    acted: ExternalForces,
}

impl Outside for External<'_> {
    fn accelerate(&mut self, t: f64, positions: &[DVec3], into: &mut [DVec3]) {
        let External { body, around, ends, now, acted, .. } = self;
        body.find_acting(around, *ends, f64::min(self.t + t, ends[1]), now);
        body.act(around.scene, now, positions, into, acted);
    }

    fn rub(&mut self, t: f64, h: f64, positions: &[DVec3], guess: &[DVec3], velocities: &mut [DVec3]) {
        let External { body, around, ends, kicked, before, acted, .. } = self;
        let centre = around.courses[body.index].at(f64::min(self.t + t, ends[1]), ends[1]);
        let contacts = body.rubbing(around.scene, centre.position, positions);
        let without =
            |free: &Free| free.velocity + free.acceleration * *kicked + (acted.mean + free.acceleration - *before) * h;
        let moving = body.free.as_ref().map_or(centre.velocity, without);
        let (friction, mean) = body.friction(&contacts, h, (guess, moving), (velocities, moving));
        velocities.iter_mut().zip(&friction).for_each(|(u, a)| *u += *a * h);
        acted.rub(friction, mean);
    }
}
