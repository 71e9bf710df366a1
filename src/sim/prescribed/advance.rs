//! Advances one body over one step: determines its sub-steps and the forces in each, and calls the integrator.

use std::cell::RefCell;

use glam::DVec3;
use pulp::{Simd, WithSimd};

use super::{
    body::{Active, Body, Reference, StateBounds},
    deformation::{self, ActiveSet, REST},
    pairs::Pairs,
    tracks::Tracks,
};
use crate::{
    geometry::Rest,
    model::phase::Phase,
    sim::{
        integrator::{
            explicit::{self, Interval, Scheme},
            exponential::{self, StepControl, StepStatistics, course::Course},
        },
        neighbours::Neighbour,
        numerics::arrays::{Block, LANES},
        solver::Setting,
        span::Span,
        state::State,
        terms::{
            Moment, On, Phases, Sphere, Surroundings, acts_during, carry,
            push::{self, PushField},
        },
        work::{Tally, Work},
    },
};

/// Least distance that spheres may move before an active set is selected again [radii].
const SKIN: f64 = 0.1;
/// The same in travels of the spheres in a step.
const SKIN_STEPS: f64 = 3.0;

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

/// Buffers that each thread reuses from body to body.
#[derive(Default)]
struct Scratch {
    interval: Interval,
    breaks: Vec<f64>,
    margins: Vec<Margin>,
    contributing: Vec<Neighbour>,
    touching: Vec<Neighbour>,
    acting: Vec<Sphere>,
    pushes: PushField,
    gaps: Vec<f64>,
    centres: Vec<(DVec3, f64)>,
    deformation: deformation::Scratch,
    exponential: exponential::Scratch,
}

/// The read-only inputs of the integration of a body.
#[derive(Clone, Copy)]
pub(in crate::sim) struct Context<'a> {
    pub setting: Setting<'a>,
    pub bodies: &'a [Body],
    pub pairs: &'a Pairs,
    pub tracks: &'a Tracks,
    /// The work budget of the step.
    pub work: &'a Work,
}

/// Bounds on a neighbour's sphere in a step.
#[derive(Clone, Copy, Debug)]
pub(in crate::sim) struct Margin {
    /// Its smallest distance from the centre of the body [scene unit].
    gap: f64,
    /// The largest acceleration that it can cause [scene unit/s²].
    pull: f64,
}

/// Bounds on the vertices of a body.
#[derive(Clone, Copy, Debug)]
struct Farthest {
    /// Their largest distance from the centre in the step [scene unit].
    distance: f64,
    /// Their largest acceleration by spheres in the step [scene unit/s²].
    pull: f64,
    /// Their largest distance from the centre in the step, or later if nothing else acts [scene unit].
    later: f64,
}

impl Phases for &Pairs {
    fn from(&self, _: u32, neighbour: &Neighbour, t: f64) -> Phase {
        self.phase_at(neighbour.pair, t)
    }

    fn changes(&self, _: u32, neighbour: &Neighbour, times: &mut Vec<f64>) {
        times.extend(Pairs::changes(self, neighbour.pair).iter().map(|&(time, _)| time));
    }
}

impl<'a> Context<'a> {
    /// Advances one body over `span`, in turn `turn`, and sets its [`Active::statistics`]: no substeps if nothing acted
    /// on it.
    pub fn advance(&self, active: &mut Active, turn: usize, span: Span) {
        let work = Tally::new(self.work, Some(turn));
        if work.is_over() {
            return;
        }
        SCRATCH.with_borrow_mut(|scratch| {
            active.statistics = match Scheme::of(self.setting.scene.integrator) {
                Some(scheme) => self.advance_explicitly(scheme, active, span, &mut scratch.interval, &work),
                None => self.advance_exponentially(active, span, scratch, &work),
            };
        });
        active.statistics.work = work.done();
        if active.statistics.substeps > 0 {
            active.state.state_bounds =
                StateBounds::of(&active.state.deformation, active.state.oscillator, self.setting.arch);
            active.state.bound += self.force_bound(active, span) * span.length();
            let is_explicit = Scheme::of(self.setting.scene.integrator).is_some();
            // without a spring, neither bounds the other
            let StateBounds { displacement, momentum } = active.state.state_bounds;
            if is_explicit && momentum < REST && displacement < REST {
                active.state.deformation.clear();
                active.state.state_bounds = StateBounds::default();
            }
        }
    }

    fn body(&self, index: u32) -> &'a Body {
        &self.bodies[index as usize]
    }

    /// A bound on the acceleration of any vertex during `span` by all terms except its oscillator [scene unit/s²].
    fn force_bound(&self, active: &Active, span: Span) -> f64 {
        let own = self.own_force(active.body, span);
        if Scheme::of(self.setting.scene.integrator).is_none() {
            return own + active.bounds.pull;
        }
        // an inaccurate step may have taken vertices to any neighbour
        own + self.sources(active.body, span).map(|source| source.pull).sum::<f64>()
    }

    /// A bound on the acceleration of any vertex during `span` by terms that do not depend on other bodies
    /// [scene unit/s²].
    pub fn own_force(&self, index: u32, span: Span) -> f64 {
        self.on(index).own_bound(span)
    }

    /// The data about a body that force terms use.
    pub fn on(&self, index: u32) -> On<'a, &'a Pairs> {
        let Context { setting: Setting { scene, .. }, tracks, pairs, .. } = *self;
        self.body(index).on(scene, index, tracks, pairs)
    }

    /// The nearby bodies, and the force points that act during `span`: whatever has a sphere that may act on a body.
    fn sources(&self, index: u32, span: Span) -> impl Iterator<Item = &'a Neighbour> + use<'a> {
        let (scene, body) = (self.setting.scene, self.body(index));
        let acts = move |point: &&Neighbour| {
            let point = &scene.points[point.other as usize - scene.bodies.len()];
            acts_during([point.start, point.end()], scene, span)
        };
        body.neighbours.iter().chain(body.points.iter().filter(acts))
    }

    /// Whether a force point comes so near a body during `span` that it may act on vertices up to `farthest` from the
    /// centre [scene unit].
    pub fn is_near_point(&self, index: u32, farthest: f64, span: Span) -> bool {
        let mut points = self.sources(index, span).filter(|source| source.is_point());
        points.any(|point| {
            self.nearest(index, point.other, span) <= self.tracks.motion_bounds(point.other).sphere + farthest
        })
    }

    /// Lower bound on the distance of the centres of two bodies within the step, allowing for rounding [scene unit].
    pub fn nearest(&self, a: u32, b: u32, span: Span) -> f64 {
        self.tracks.motion_bounds(a).nearest(self.tracks.motion_bounds(b), span.length())
    }

    /// Finds the influence spheres that can reach a body's vertices within the step, and bounds the distance of the
    /// vertices from the centre. That distance depends on which spheres pull, and vice versa: iterate, starting without
    /// pull. A sphere that does not reach where the others can pull a vertex cannot be the first to pull it farther,
    /// and so never pulls.
    pub fn find_reachable(&self, active: &mut Active, span: Span) {
        SCRATCH.with_borrow_mut(|scratch| {
            let margins = &mut scratch.margins;
            let Farthest { distance, pull, later } = self.farthest(active, span, margins);
            let bounds = &mut active.bounds;
            (bounds.farthest, bounds.pull, bounds.max_reach) = (distance, pull, later);
            bounds.may_sleep = !margins.iter().any(|margin| margin.gap <= later);
            bounds.reachable.clear();
            for (source, margin) in self.sources(active.body, span).zip(&*margins) {
                if margin.gap <= distance && (source.always_acts || self.acts(source, active.body)) {
                    bounds.reachable.push(*source);
                }
            }
        });
    }

    /// Whether vertices may leave the body's fat bounds, in the step or later if nothing else acts. False for NaN,
    /// which [`Active::has_diverged`] detects.
    pub fn left_fat_bounds(&self, active: &Active) -> bool {
        active.bounds.max_reach > self.body(active.body).fat_bounds.vertices
    }

    /// Bounds the vertices of a body, and fills `margins` with one entry per neighbour.
    fn farthest(&self, active: &Active, span: Span, margins: &mut Vec<Margin>) -> Farthest {
        let index = active.body;
        let own = *self.tracks.motion_bounds(index);
        let own_force = self.own_force(index, span);
        margins.clear();
        margins.extend(self.sources(index, span).map(|neighbour| {
            let other = self.tracks.motion_bounds(neighbour.other);
            Margin { gap: own.nearest(other, span.length()) - other.sphere, pull: neighbour.pull }
        }));
        let mut pull = 0.0;
        loop {
            let farthest = own.radius + active.farthest(own_force, pull, span.length());
            let next = margins.iter().filter(|margin| margin.gap <= farthest).map(|margin| margin.pull).sum();
            // written so that NaN ends the loop
            if !(next > pull) {
                return Farthest { distance: farthest, pull, later: farthest.max(own.radius + active.amplitude()) };
            }
            pull = next;
        }
    }

    /// Takes one step with the phases at its start.
    fn advance_explicitly(
        &self,
        scheme: Scheme,
        active: &mut Active,
        span: Span,
        interval: &mut Interval,
        work: &Tally<'_>,
    ) -> StepStatistics {
        let (middle, end) = scheme.evaluates_at();
        // A body at rest must not be woken by a sphere that reaches none of its vertices. The vertices of a moving body
        // may get anywhere in an inaccurate step.
        let at_rest = active.is_at_rest();
        let farthest = if at_rest { self.body(active.body).radius } else { f64::INFINITY };
        let collect = |time, surroundings: &mut Surroundings| {
            let moment = Moment { time, phases_at: span.start, windows_at: span.inside(time) };
            self.on(active.body).surroundings_into(moment, farthest, surroundings);
        };
        interval.h = span.length();
        interval.oscillator = active.state.oscillator;
        interval.weight = self.setting.scene.influence.weight;
        collect(span.start, &mut interval.start);
        if middle {
            collect(span.start + 0.5 * span.length(), &mut interval.middle);
        }
        if end {
            collect(span.end, &mut interval.end);
        }
        if active.is_at_rest() && interval.is_idle(scheme) && self.kicks(active.body, span) == DVec3::ZERO {
            return StepStatistics::default();
        }
        let rest = self.body(active.body).rest();
        active.state.deformation.wake_all(rest);
        let active_set = &mut active.state.deformation.active_set;
        // an explicit step cannot resolve jumps of the velocity within it, so they act at its start
        let kicks = self.kicks(active.body, span);
        if kicks != DVec3::ZERO {
            for i in 0..rest.len() {
                let State { x, u } = active_set.state(i);
                active_set.set_state(i, State { x, u: u + kicks });
            }
        }
        explicit::advance(scheme, interval, rest, active_set, work);
        active_set.pad_again();
        StepStatistics { substeps: 1, base: work.done(), ..StepStatistics::default() }
    }

    /// The sum of the jumps of a body's velocity within `span`, including its start, as they act on the vertices
    /// [scene unit/s].
    fn kicks(&self, body: u32, span: Span) -> DVec3 {
        let inside = span.among(self.tracks.breaks(body)).iter().filter(|&&t| t < span.end);
        inside.map(|&t| self.kick(body, t)).sum()
    }

    /// The jump of the velocities of a body's vertices at time `t`, within the step [scene unit/s].
    fn kick(&self, body: u32, t: f64) -> DVec3 {
        match self.tracks.of(body as usize) {
            Some(mover) if mover.kicks > 0.0 => {
                carry::kick(&self.body(body).material, self.tracks.path(body as usize), t)
            }
            _ => DVec3::ZERO,
        }
    }

    /// Divides the step where something jumps, and integrates each interval to the scene's tolerance.
    fn advance_exponentially(
        &self,
        active: &mut Active,
        span: Span,
        scratch: &mut Scratch,
        work: &Tally<'_>,
    ) -> StepStatistics {
        let scene = self.setting.scene;
        let index = active.body as usize;
        let now = active.now(self.setting.step, scene.dt, self.setting.arch);
        let body = self.body(active.body);
        // A push acts on vertices anywhere, so all are stepped. And free vertices are known at the ends of steps only.
        let all = push::any_acts(&body.pushes, span) || self.setting.is_partial && !active.is_at_rest();
        let is_reached = all || !active.bounds.reachable.is_empty();
        if !is_reached && active.can_sleep() {
            active.state.deformation.release(body.rest().len(), now, &mut scratch.deformation);
            active.chosen.references.clear();
            active.chosen.all = false;
            if self.own_force(active.body, span) == 0.0 {
                active.state.halvings = 0;
                return StepStatistics::default();
            }
        }
        if active.state.carried_as_of < self.setting.step {
            active.state.carried = active.carried_at(now);
        }
        active.state.carried_as_of = self.setting.step + 1;

        scratch.contributing.clear();
        if is_reached || !active.can_sleep() {
            self.choose_active_set(active, span, all, scratch);
            if active.is_at_rest() && self.own_force(active.body, span) == 0.0 {
                return StepStatistics::default();
            }
        }
        let Scratch { breaks, contributing, touching, acting, pushes, exponential, .. } = scratch;
        self.find_breaks(active.body, contributing, span, breaks, work);
        if breaks.len() > 2 {
            // jumps of spheres that reach no vertex need not divide the step
            touching.clear();
            touching.extend(contributing.iter().filter(|source| self.may_touch(active, source, span)));
            if touching.len() < contributing.len() {
                self.find_breaks(active.body, touching, span, breaks, work);
            }
        }
        let body = self.body(active.body);
        let tolerance = scene.tolerance * body.radius;
        let control = StepControl { arch: self.setting.arch, tolerance, work };
        let vertices = &active.state.deformation.active_set.vertices;
        let pushed = pushes.begin(&body.pushes, span, vertices, LANES);
        let base = exponential::work_of(vertices.len(), contributing.len()) + (pushed * vertices.len()) as u64;
        let mut total = StepStatistics { base, ..StepStatistics::default() };
        for ends in breaks.windows(2) {
            let part = Span { start: ends[0], end: ends[1] };
            let kick = self.kick(active.body, part.start);
            if kick != DVec3::ZERO {
                active.state.carried.u += kick;
            }
            work.spend(contributing.len() as u64);
            self.on(active.body).over(contributing, part, acting);
            let is_whole = breaks.len() == 2 && !self.setting.is_partial;
            if pushed > 0 {
                let vertices = &active.state.deformation.active_set.vertices;
                let changes = pushes.advance(part.start + 0.5 * part.length(), body.rest(), vertices);
                work.spend((changes * vertices.len()) as u64);
            }
            let course = Course {
                scene,
                index,
                material: body.material,
                vertices: body.mesh.vertex_count(),
                start: part.start,
                // All whole steps have bit-identical lengths, so that weights are computed once.
                length: if is_whole { scene.dt } else { part.length() },
                tracks: self.tracks,
                is_whole,
                spheres: acting,
                local: pushes.local(),
            };
            let active_set = &mut active.state.deformation.active_set;
            let (carried, halvings) = (&mut active.state.carried, &mut active.state.halvings);
            let statistics = exponential::advance(&course, control, carried, active_set, halvings, exponential);
            total.substeps += statistics.substeps;
            total.error += statistics.error;
            total.excess += statistics.excess;
            if work.is_over() {
                break;
            }
        }
        total
    }

    /// Whether a sphere acts on a body in any phase that the pair has in the step.
    fn acts(&self, source: &Neighbour, index: u32) -> bool {
        let on = self.on(index);
        let phases = self.pairs.changes(source.pair).iter().map(|&(_, phase)| phase);
        phases.chain([self.pairs.get(source.pair).phase]).any(|phase| on.strength(source, phase) != 0.0)
    }

    /// Whether a sphere may reach any of a body's vertices within the step.
    fn may_touch(&self, active: &Active, source: &Neighbour, span: Span) -> bool {
        let (own, other) = (self.tracks.motion_bounds(active.body), self.tracks.motion_bounds(source.other));
        let swings = active.bounds.farthest - own.radius;
        let near = other.sphere + swings + (own.speed + other.speed) * span.length();
        let (rest, centre) = (self.body(active.body).rest(), other.centre - own.centre);
        // written so that NaN is near
        (0..rest.len()).any(|i| !(rest.position(i).distance(centre) > near))
    }

    /// Finds the ends of the intervals of a step within which nothing that acts on a body jumps.
    fn find_breaks(&self, index: u32, reachable: &[Neighbour], span: Span, breaks: &mut Vec<f64>, work: &Tally<'_>) {
        breaks.clear();
        breaks.push(span.start);
        let mut knots = |body: u32| {
            breaks.extend(span.among(self.tracks.breaks(body)).iter().filter(|&&t| span.holds(t)));
        };
        knots(index);
        reachable.iter().for_each(|source| knots(source.other));
        self.on(index).jumps(reachable, span, breaks);
        work.spend(breaks.len() as u64);
        if breaks.len() > 1 {
            breaks.sort_by(f64::total_cmp);
            breaks.dedup();
        }
        breaks.push(span.end);
    }

    /// Ensures that the active set contains every vertex that a sphere can reach within the step, or every vertex if
    /// `all`. Finds the contributing spheres: those that can reach any vertex of the set.
    fn choose_active_set(&self, active: &mut Active, span: Span, all: bool, scratch: &mut Scratch) {
        let Scratch { gaps, centres, deformation, contributing, .. } = scratch;
        let reachable = &active.bounds.reachable;
        let this = self.tracks.motion_bounds(active.body);
        let radius = this.radius;
        let own = this.centre + active.state.carried.x;
        centres.clear();
        centres.extend(reachable.iter().map(|source| {
            let other = self.tracks.motion_bounds(source.other);
            (other.centre - own, other.sphere)
        }));

        // Distance that spheres move relative to rest positions within the step.
        let own_force = self.own_force(active.body, span);
        let momentum = active.state.carried.momentum(active.state.oscillator.omega);
        let common = (momentum + own_force * span.length()) * span.length();
        let speed = |body: u32| self.tracks.motion_bounds(body).speed;
        let fastest = reachable.iter().map(|source| speed(source.other)).fold(0.0, f64::max);
        let travel = (this.speed + fastest) * span.length() + common;

        // No vertex gets farther than this from rest: a sphere farther from the whole active set does not contribute.
        let swings = active.bounds.farthest - radius;
        let contributes = |clear: f64, moved: f64| !(clear - moved > swings);
        let mut references = active.chosen.references.iter();
        contributing.clear();
        let is_good = active.chosen.all == all
            && (all || !active.chosen.references.is_empty())
            && reachable.iter().zip(&*centres).all(|(source, &(centre, _))| {
                // both are in the order of the bodies
                let found = references.find(|then| then.body >= source.other);
                let then = found.filter(|then| then.body == source.other);
                then.is_some_and(|then| {
                    let moved = (centre - then.centre).length() + travel;
                    if contributes(then.clear, moved) {
                        contributing.push(*source);
                    }
                    moved <= active.chosen.skin
                })
            });
        if is_good {
            return;
        }

        active.chosen.skin = f64::max(SKIN * radius, SKIN_STEPS * travel);

        let rest = self.body(active.body).rest();
        gaps.clear();
        gaps.resize(rest.len(), f64::INFINITY);
        self.setting.arch.dispatch(FindGaps { rest, centres, gaps });
        let now = active.now(self.setting.step, self.setting.scene.dt, self.setting.arch);
        // all vertices are selected, whatever their gaps
        let skin = if all { f64::INFINITY } else { active.chosen.skin };
        active.chosen.all = all;
        active.state.deformation.choose_active_set(rest, gaps, skin, now, deformation);

        active.chosen.references.clear();
        contributing.clear();
        for (source, &(centre, sphere)) in reachable.iter().zip(&*centres) {
            let active_set = &active.state.deformation.active_set;
            let clear = self.setting.arch.dispatch(Clearance { active_set, centre }) - sphere;
            active.chosen.references.push(Reference { body: source.other, centre, clear });
            if contributes(clear, travel) {
                contributing.push(*source);
            }
        }
    }
}

/// Lowers each gap to the distance of the vertex's rest position from the nearest sphere, negative inside [scene unit];
/// spheres are given by centre and radius. (A closure would be compiled for the baseline instruction set.)
struct FindGaps<'a> {
    rest: Rest<'a>,
    centres: &'a [(DVec3, f64)],
    gaps: &'a mut [f64],
}

impl WithSimd for FindGaps<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let FindGaps { rest, centres, gaps } = self;
        let (l, radius) = (rest.mesh.positions(), rest.radius);
        for &(centre, sphere) in centres {
            // slices of equal length, so that the loop needs no bounds checks and vectorises
            let n = gaps.len();
            let (lx, ly, lz) = (&l.x[..n], &l.y[..n], &l.z[..n]);
            for i in 0..n {
                let (dx, dy, dz) = (centre.x - radius * lx[i], centre.y - radius * ly[i], centre.z - radius * lz[i]);
                let gap = (dx * dx + dy * dy + dz * dz).sqrt() - sphere;
                gaps[i] = if gaps[i] < gap { gaps[i] } else { gap };
            }
        }
    }
}

/// Distance of a centre from the nearest rest position of an active set [scene unit].
struct Clearance<'a> {
    active_set: &'a ActiveSet,
    centre: DVec3,
}

impl WithSimd for Clearance<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> f64 {
        let Clearance { active_set, centre } = self;
        let mut nearest = [f64::INFINITY; LANES];
        // padded to whole blocks
        for Block([.., [lx, ly, lz]]) in active_set.blocks.all() {
            for lane in 0..LANES {
                let (dx, dy, dz) = (centre.x - lx[lane], centre.y - ly[lane], centre.z - lz[lane]);
                let square = dx * dx + dy * dy + dz * dz;
                nearest[lane] = if square < nearest[lane] { square } else { nearest[lane] };
            }
        }
        nearest.into_iter().fold(f64::INFINITY, f64::min).sqrt()
    }
}
