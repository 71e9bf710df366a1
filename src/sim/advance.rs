//! One body over one step: where its sub-steps end, what acts on it in each, and the scheme's turn.

use std::cell::RefCell;

use glam::DVec3;
use pulp::Arch;

use super::{
    Span,
    body::{Active, Body, Extent, Scratch, Seen},
    integrator::{
        explicit::{self, Interval, Scheme},
        exponential::{
            self, Effort, Manner,
            course::{Course, Push, Sphere},
        },
    },
    pairs::{Neighbour, Pairs},
    surroundings::{Source, Surroundings, carry, push_acts},
    tracks::Tracks,
};
use crate::{
    model::phase::Phase,
    scene::{Response, Scene},
};

/// How far spheres may move before a front is chosen anew: no less than this [radii] …
const SKIN: f64 = 0.1;
/// … and this many times what they move in a step.
const SKIN_STEPS: f64 = 3.0;
/// A body whose vertices all move by less than this is put to rest [scene unit/s]; numbers that are much smaller still are
/// slow to compute with.
const REST: f64 = 1e-150;

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

/// What the integration of a body reads and does not change.
#[derive(Clone, Copy)]
pub(super) struct Context<'a> {
    pub scene: &'a Scene,
    pub bodies: &'a [Body],
    pub pairs: &'a Pairs,
    pub tracks: &'a Tracks,
    pub arch: Arch,
    /// Whether what need not be computed is skipped.
    pub skip: bool,
    /// Steps taken before this one.
    pub step: u64,
}

/// An instant at which surroundings are wanted.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moment {
    /// When [s].
    pub time: f64,
    /// Pairs have the phases that they have from this time on [s].
    pub phases_at: f64,
}

impl Context<'_> {
    /// Advances one body over `span`; its [`Active::effort`] says what that took: nothing if nothing acted on it.
    pub fn advance(&self, active: &mut Active, span: Span) {
        SCRATCH.with_borrow_mut(|scratch| {
            active.effort = match Scheme::of(self.scene.integrator) {
                Some(scheme) => self.advance_explicitly(scheme, active, span, &mut scratch.interval),
                None => self.advance_exponentially(active, span, scratch),
            };
        });
        if active.effort.substeps > 0 {
            active.extent = Extent::of(&active.deformation, active.oscillator, self.arch);
            active.bound += self.force_bound(active.body, span) * span.length();
            let is_plain = !self.skip || Scheme::of(self.scene.integrator).is_some();
            if is_plain && active.extent.momentum < REST && active.common.is_zero() {
                active.deformation.clear();
                active.extent = Extent::default();
            }
        }
    }

    fn body(&self, index: u32) -> &Body {
        &self.bodies[index as usize]
    }

    /// A bound of the acceleration of any vertex by anything but its oscillator during `span` [scene unit/s²].
    fn force_bound(&self, index: u32, span: Span) -> f64 {
        let neighbours = &self.body(index).neighbours;
        let pulls = neighbours.iter().map(|neighbour| strongest_pull(self.scene, index, neighbour.other));
        self.own_force(index, span) + pulls.sum::<f64>()
    }

    /// A bound of the acceleration of any vertex by pushes and by the body's own motion during `span` [scene unit/s²].
    pub fn own_force(&self, index: u32, span: Span) -> f64 {
        let this = &self.scene.bodies[index as usize];
        let carry = self.tracks.bounds(index as usize).map_or(0.0, |motion| match this.material.response {
            Response::Rigid => 0.0,
            Response::Inertial => motion.acceleration,
            Response::World => motion.acceleration + 2.0 * this.material.damping * motion.speed,
        });
        let acting = self.body(index).pushes.iter().filter(|push| push.start < span.end && span.start < push.end());
        carry + acting.map(|push| push.strength.abs()).sum::<f64>()
    }

    /// How near the centres of two bodies can come within the step, less what rounding of them can do [scene unit].
    pub fn nearest(&self, a: u32, b: u32, span: Span) -> f64 {
        let [a, b] = [a, b].map(|i| {
            let centre = self.tracks.kinematics(self.scene, i as usize, 0).position;
            let speed = self.tracks.bounds(i as usize).map_or(0.0, |bounds| bounds.speed);
            (centre, speed * span.length())
        });
        let distance = a.0.distance(b.0);
        let far = a.0.abs().max_element() + b.0.abs().max_element() + distance;
        distance - (a.1 + b.1) - 8.0 * f64::EPSILON * far
    }

    /// Finds the influence spheres that can reach a body's vertices within the step, and how far from the centre it can
    /// have vertices then. How far vertices get depends on who can pull them, which depends on
    /// how far they get: found from no pull on. A sphere that cannot reach where the others can pull a vertex cannot be
    /// the first to do so, so never does.
    pub fn find_reachable(&self, active: &mut Active, span: Span) {
        let mut reachable = std::mem::take(&mut active.reachable);
        active.farthest = self.farthest(active, span, &mut reachable);
        reachable.retain(|source| self.acts(source, active.body));
        active.reachable = reachable;
    }

    fn farthest(&self, active: &Active, span: Span, reachable: &mut Vec<Neighbour>) -> f64 {
        let index = active.body;
        let radius = self.scene.bodies[index as usize].radius;
        let own_force = self.own_force(index, span);
        let neighbours = &self.body(index).neighbours;
        let h = span.length();
        let mut pull = 0.0;
        loop {
            let farthest = radius + active.farthest(own_force, pull, h);
            reachable.clear();
            reachable.extend(neighbours.iter().filter(|neighbour| {
                let sphere = self.scene.influence.sphere_radius(self.scene.bodies[neighbour.other as usize].radius);
                self.nearest(index, neighbour.other, span) <= sphere + farthest
            }));
            let next = reachable.iter().map(|source| strongest_pull(self.scene, index, source.other)).sum();
            // written so that what is not a number ends it
            if !(next > pull) {
                return farthest;
            }
            pull = next;
        }
    }

    /// One step, with the phases as they are at its start.
    fn advance_explicitly(&self, scheme: Scheme, active: &mut Active, span: Span, interval: &mut Interval) -> Effort {
        let (middle, end) = scheme.looks_at();
        // A sphere that ends short of every vertex of a body at rest would wake it for nothing; one in motion may get
        // anywhere in an inaccurate step.
        let at_rest = active.is_at_rest();
        let farthest = if at_rest { self.scene.bodies[active.body as usize].radius } else { f64::INFINITY };
        let look = |time, surroundings: &mut Surroundings| {
            let moment = Moment { time, phases_at: span.start };
            self.surroundings(active.body, farthest, moment, surroundings);
        };
        interval.h = span.length();
        interval.oscillator = active.oscillator;
        interval.weight = self.scene.influence.weight;
        look(span.start, &mut interval.start);
        if middle {
            look(span.start + 0.5 * span.length(), &mut interval.middle);
        }
        if end {
            look(span.end, &mut interval.end);
        }
        if active.is_at_rest() && interval.is_idle(scheme) {
            return Effort::default();
        }
        let (unit, radius) = (&self.body(active.body).unit, self.scene.bodies[active.body as usize].radius);
        active.deformation.wake_all(unit, radius);
        let front = &mut active.deformation.front;
        explicit::advance(scheme, interval, radius, unit, &mut front.displacement, &mut front.velocity);
        front.pad_again();
        Effort { substeps: 1, error: 0.0 }
    }

    /// As many stretches as there are jumps in the step, each as exactly as the scene's tolerance asks for.
    fn advance_exponentially(&self, active: &mut Active, span: Span, scratch: &mut Scratch) -> Effort {
        let scene = self.scene;
        let index = active.body as usize;
        let now = active.now(self.step, scene.dt);
        if !self.skip {
            active.deformation.wake_all(&self.body(active.body).unit, scene.bodies[index].radius);
        } else if active.reachable.is_empty() {
            if active.can_sleep() {
                active.deformation.let_go(now);
                active.seen.clear();
            }
            let is_idle = self.own_force(active.body, span) == 0.0;
            if is_idle && active.can_sleep() {
                return Effort::default();
            }
        }
        if active.common_as_of < self.step {
            active.common = active.common_at(now);
        }
        active.common_as_of = self.step + 1;

        self.find_breaks(active.body, &active.reachable, span, &mut scratch.breaks);
        if self.skip && !(active.reachable.is_empty() && active.can_sleep()) {
            self.choose_front(active, span, scratch);
        }
        let Scratch { breaks, spheres, pushes, exponential, .. } = scratch;
        let manner = Manner { arch: self.arch, tolerance: scene.tolerance * scene.bodies[index].radius };
        let mut total = Effort::default();
        for ends in breaks.windows(2) {
            let part = Span { start: ends[0], end: ends[1] };
            self.find_spheres(active.body, &active.reachable, part, spheres);
            self.find_pushes(active.body, part, pushes);
            let is_whole = breaks.len() == 2;
            let course = Course {
                scene,
                index,
                start: part.start,
                // All whole steps have the same length to the bit, so that weights are computed once.
                length: if is_whole { scene.dt } else { part.length() },
                tracks: is_whole.then_some(self.tracks),
                spheres,
                pushes,
            };
            let front = &mut active.deformation.front;
            let effort = exponential::advance(&course, manner, &mut active.common, front, exponential);
            if !self.skip {
                // the plain way: every vertex has a state of its own, and nothing in common with others
                let body = self.body(active.body);
                active.deformation.absorb(&mut active.common, &body.unit, &body.pushes);
            }
            total.substeps += effort.substeps;
            total.error += effort.error;
        }
        total
    }

    /// Whether a sphere acts on a body in any phase that the pair has in the step.
    fn acts(&self, source: &Neighbour, index: u32) -> bool {
        let strength = |phase| {
            let (this, other) = (&self.scene.bodies[index as usize], &self.scene.bodies[source.other as usize]);
            self.scene.influence.strength(phase, this.radius, other.radius)
        };
        let phases = self.pairs.changes(source.pair).iter().map(|&(_, phase)| phase);
        phases.chain([self.pairs.get(source.pair).phase]).any(|phase| strength(phase) != 0.0)
    }

    /// The ends of the stretches of a step in which nothing about a body jumps.
    fn find_breaks(&self, index: u32, reachable: &[Neighbour], span: Span, breaks: &mut Vec<f64>) {
        breaks.clear();
        breaks.push(span.start);
        let within = |t: &f64| span.start < *t && *t < span.end;
        for push in &self.body(index).pushes {
            breaks.extend([push.start, push.end()].iter().filter(|t| within(t)));
        }
        let mut knots = |body: u32| {
            let knots = self.scene.bodies[body as usize].path.knots();
            let first = knots.partition_point(|&knot| knot <= span.start);
            breaks.extend(knots[first..].iter().take_while(|t| within(t)));
        };
        knots(index);
        reachable.iter().for_each(|source| knots(source.other));
        for source in reachable {
            breaks.extend(self.pairs.changes(source.pair).iter().map(|&(time, _)| time).filter(within));
        }
        if breaks.len() > 1 {
            breaks.sort_by(f64::total_cmp);
            breaks.dedup();
        }
        breaks.push(span.end);
    }

    /// The influence spheres among `sources` that act on a body in a stretch of the step.
    fn find_spheres(&self, index: u32, sources: &[Neighbour], part: Span, spheres: &mut Vec<Sphere>) {
        let scene = self.scene;
        let this = &scene.bodies[index as usize];
        spheres.clear();
        for source in sources {
            let other = &scene.bodies[source.other as usize];
            let phase = self.pairs.phase_at(source.pair, part.start);
            let strength = scene.influence.strength(phase, this.radius, other.radius);
            let radius = scene.influence.sphere_radius(other.radius);
            if strength != 0.0 {
                spheres.push(Sphere { body: source.other, radius, inverse_radius: 1.0 / radius, strength });
            }
        }
    }

    /// A body's pushes, those that don't act in a stretch of the step with strength zero.
    fn find_pushes(&self, index: u32, part: Span, pushes: &mut Vec<Push>) {
        let inside = part.start + 0.5 * part.length();
        pushes.clear();
        pushes.extend(self.body(index).pushes.iter().map(|push| {
            let strength = if push_acts(push, inside) { push.strength } else { 0.0 };
            Push { direction: push.direction, strength }
        }));
    }

    /// Sees to it that the front has every vertex that a sphere can reach within the step.
    fn choose_front(&self, active: &mut Active, span: Span, scratch: &mut Scratch) {
        let Scratch { gaps, centres, moved, deformation, .. } = scratch;
        let reachable = &active.reachable;
        let (scene, index) = (self.scene, active.body as usize);
        let radius = scene.bodies[index].radius;
        let exponential::course::Common { carried, pushed } = &active.common;
        let own = self.tracks.kinematics(scene, index, 0).position + carried.x;
        centres.clear();
        centres.extend(reachable.iter().map(|source| {
            let other = &scene.bodies[source.other as usize];
            let centre = self.tracks.kinematics(scene, source.other as usize, 0).position;
            (centre - own, scene.influence.sphere_radius(other.radius))
        }));

        // How far spheres move relative to rest positions within the step.
        let own_force = self.own_force(active.body, span);
        let (_, momentum) = active.common.bounds(active.oscillator.omega);
        let common = (momentum + own_force * span.length()) * span.length();
        let speed = |body: usize| self.tracks.bounds(body).map_or(0.0, |bounds| bounds.speed);
        let fastest = reachable.iter().map(|source| speed(source.other as usize)).fold(0.0, f64::max);
        let travel = (speed(index) + fastest) * span.length() + common;
        let turned: f64 = pushed.iter().zip(&active.seen_pushed).map(|(now, then)| (now.x - then).abs()).sum();

        let mut seen = active.seen.iter();
        let is_good = !active.seen.is_empty()
            && reachable.iter().zip(&*centres).all(|(source, &(centre, _))| {
                // both are in the order of the bodies
                let found = seen.find(|seen| seen.body >= source.other);
                let then = found.filter(|seen| seen.body == source.other);
                then.is_some_and(|seen| (centre - seen.centre).length() + turned + travel <= active.skin)
            });
        if is_good {
            return;
        }

        active.skin = f64::max(SKIN * radius, SKIN_STEPS * travel);
        active.seen.clear();
        active
            .seen
            .extend(reachable.iter().zip(&*centres).map(|(source, &(centre, _))| Seen { body: source.other, centre }));
        active.seen_pushed.clear();
        active.seen_pushed.extend(pushed.iter().map(|pushed| pushed.x));

        let unit = &self.body(active.body).unit;
        gaps.clear();
        gaps.resize(unit.len(), f64::INFINITY);
        moved.clear();
        if pushed.iter().any(|pushed| pushed.x != 0.0) {
            let pushes = &self.body(active.body).pushes;
            moved.extend(unit.iter().map(|unit| active.common.moved(unit, pushes)));
        }
        self.arch.dispatch(|| find_gaps(unit, radius, moved, centres, gaps));
        let now = active.now(self.step, scene.dt);
        active.deformation.choose_front(unit, radius, gaps, active.skin, now, deformation);
    }

    /// What acts on a body at a moment, with no vertices farther from its centre than `farthest` [scene unit].
    pub fn surroundings(&self, index: u32, farthest: f64, moment: Moment, surroundings: &mut Surroundings) {
        let scene = self.scene;
        let this = &scene.bodies[index as usize];
        let body = self.body(index);
        let own = this.path.at(moment.time);
        surroundings.carry = carry(this.material.response, this.material.damping, &own);
        surroundings.pushes.clear();
        surroundings.pushes.extend(body.pushes.iter().filter(|push| push_acts(push, moment.time)));
        surroundings.sources.clear();
        for neighbour in &body.neighbours {
            let other = &scene.bodies[neighbour.other as usize];
            let phase = self.pairs.phase_at(neighbour.pair, moment.phases_at);
            let strength = scene.influence.strength(phase, this.radius, other.radius);
            if strength == 0.0 {
                continue;
            }
            let source = Source {
                body: neighbour.other,
                centre: other.path.position(moment.time) - own.position,
                sphere_radius: scene.influence.sphere_radius(other.radius),
                strength,
            };
            if source.centre.length() <= source.sphere_radius + farthest {
                surroundings.sources.push(source);
            }
        }
    }
}

/// By how much the rest position of each vertex, moved if `moved` says so, is outside of the nearest of the spheres around
/// `centres` with these radii [scene unit].
#[inline(always)]
fn find_gaps(unit: &super::Vectors, radius: f64, moved: &[DVec3], centres: &[(DVec3, f64)], gaps: &mut [f64]) {
    for &(centre, sphere) in centres {
        // slices of one length, so that the loop below has no bounds to check and is vectorised
        let n = gaps.len();
        let (lx, ly, lz) = (&unit.x[..n], &unit.y[..n], &unit.z[..n]);
        if moved.is_empty() {
            for i in 0..n {
                let (dx, dy, dz) = (centre.x - radius * lx[i], centre.y - radius * ly[i], centre.z - radius * lz[i]);
                let gap = (dx * dx + dy * dy + dz * dz).sqrt() - sphere;
                gaps[i] = if gaps[i] < gap { gaps[i] } else { gap };
            }
        } else {
            for i in 0..n {
                let gap = (centre - radius * DVec3::new(lx[i], ly[i], lz[i]) - moved[i]).length() - sphere;
                gaps[i] = if gaps[i] < gap { gaps[i] } else { gap };
            }
        }
    }
}

/// A bound of the acceleration of any vertex of body `this` by the sphere of body `source`, in any phase
/// [scene unit/s²].
pub(super) fn strongest_pull(scene: &Scene, this: u32, source: u32) -> f64 {
    let (radius, source) = (scene.bodies[this as usize].radius, scene.bodies[source as usize].radius);
    let strength = [Phase::Merged, Phase::Apart, Phase::Core]
        .map(|phase| scene.influence.strength(phase, radius, source).abs())
        .into_iter()
        .fold(0.0, f64::max);
    strength * scene.influence.sphere_radius(source) * scene.influence.weight.max_pull()
}
