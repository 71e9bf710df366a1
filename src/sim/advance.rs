//! One body over one step: where its sub-steps end, what acts on it in each, and the scheme's turn.

use super::{
    Span,
    body::{Body, Extent, Scratch},
    integrator::{
        explicit::{self, Interval, Scheme},
        exponential::{
            self, Effort, Vertices,
            course::{Course, Sphere},
        },
    },
    pairs::{Pair, own_force, strongest_pull},
    surroundings::{Source, Surroundings, carry, push_acts},
};
use crate::{model::phase::Phase, scene::Scene};

/// What the integration of a body reads and does not change.
#[derive(Clone, Copy)]
pub(super) struct Context<'a> {
    pub scene: &'a Scene,
    pub pairs: &'a [Pair],
    /// Phase changes of the step, grouped by pair.
    pub changes: &'a [(f64, Phase)],
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
    /// Advances one body over `span`.
    pub fn advance(&self, index: usize, body: &mut Body, span: Span) -> Effort {
        // Out of the body, so that the body can be changed while they are read; a move, no allocation.
        let mut scratch = std::mem::take(&mut body.scratch);
        let was_at_rest = body.is_at_rest();
        let effort = match Scheme::of(self.scene.integrator) {
            Some(scheme) => self.advance_explicitly(scheme, index, body, span, &mut scratch.interval),
            None => self.advance_exponentially(index, body, span, &mut scratch),
        };
        if !(was_at_rest && body.is_at_rest()) {
            body.extent = Extent::of(&body.displacement, &body.velocity, body.oscillator);
            body.bound += self.force_bound(index, body, span) * span.length();
        }
        body.scratch = scratch;
        effort
    }

    /// A bound of the acceleration of any vertex by anything but its oscillator during `span` [scene unit/s²].
    fn force_bound(&self, index: usize, body: &Body, span: Span) -> f64 {
        let pulls = body.neighbours.iter().map(|neighbour| strongest_pull(self.scene, index as u32, neighbour.other));
        own_force(self.scene, body, index, span) + pulls.sum::<f64>()
    }

    /// One step, with the phases as they are at its start.
    fn advance_explicitly(
        &self,
        scheme: Scheme,
        index: usize,
        body: &mut Body,
        span: Span,
        interval: &mut Interval,
    ) -> Effort {
        let (middle, end) = scheme.looks_at();
        let look = |time, surroundings: &mut Surroundings| {
            let moment = Moment { time, phases_at: span.start };
            self.surroundings(index, body, moment, surroundings);
        };
        interval.h = span.length();
        interval.oscillator = body.oscillator;
        interval.weight = self.scene.influence.weight;
        look(span.start, &mut interval.start);
        if middle {
            look(span.start + 0.5 * span.length(), &mut interval.middle);
        }
        if end {
            look(span.end, &mut interval.end);
        }
        if body.is_at_rest() && interval.is_idle(scheme) {
            return Effort::default();
        }
        body.wake();
        let Body { unit, displacement, velocity, .. } = body;
        explicit::advance(scheme, interval, self.scene.bodies[index].radius, unit, displacement, velocity);
        Effort { substeps: 1, error: 0.0 }
    }

    /// As many stretches as there are jumps in the step, each as exactly as the scene's tolerance asks for.
    fn advance_exponentially(&self, index: usize, body: &mut Body, span: Span, scratch: &mut Scratch) -> Effort {
        let scene = self.scene;
        let tolerance = scene.tolerance * scene.bodies[index].radius;
        let mut total = Effort::default();
        let mut momentum = body.extent.momentum;
        self.find_breaks(index, body, span, &mut scratch.breaks);
        for ends in scratch.breaks.windows(2) {
            let part = Span { start: ends[0], end: ends[1] };
            self.find_spheres(index, body, part, &mut scratch.spheres);
            scratch.pushes.clear();
            let inside = part.start + 0.5 * part.length();
            scratch.pushes.extend(body.pushes.iter().filter(|push| push_acts(push, inside)));
            let course = Course {
                scene,
                index,
                start: part.start,
                // All whole steps have the same length to the bit, so that weights are computed once.
                length: if scratch.breaks.len() == 2 { scene.dt } else { part.length() },
                spheres: &scratch.spheres,
                pushes: &scratch.pushes,
            };
            if body.is_at_rest() && course.is_idle() {
                continue;
            }
            body.wake();
            let Body { unit, displacement, velocity, .. } = body;
            let mut vertices = Vertices { unit, displacement, velocity, momentum };
            let effort = exponential::advance(&course, tolerance, &mut vertices, &mut scratch.exponential);
            momentum = vertices.momentum;
            total.substeps += effort.substeps;
            total.error += effort.error;
        }
        total
    }

    /// The ends of the stretches of a step in which nothing about a body jumps.
    fn find_breaks(&self, index: usize, body: &Body, span: Span, breaks: &mut Vec<f64>) {
        breaks.clear();
        breaks.push(span.start);
        let within = |t: &f64| span.start < *t && *t < span.end;
        let mut jump = |times: &mut dyn Iterator<Item = f64>| breaks.extend(times.filter(within));
        let knots = |body: usize| self.scene.bodies[body].path.knots().iter().copied();
        jump(&mut body.pushes.iter().flat_map(|push| [push.start, push.end()]));
        jump(&mut knots(index));
        for neighbour in &body.neighbours {
            jump(&mut knots(neighbour.other as usize));
            let changes = self.pairs[neighbour.pair as usize].changes.clone();
            jump(&mut self.changes[changes].iter().map(|&(time, _)| time));
        }
        breaks.sort_by(f64::total_cmp);
        breaks.dedup();
        breaks.push(span.end);
    }

    /// The influence spheres that can reach a body in a stretch of the step.
    fn find_spheres(&self, index: usize, body: &Body, part: Span, spheres: &mut Vec<Sphere>) {
        let scene = self.scene;
        let this = &scene.bodies[index];
        spheres.clear();
        for neighbour in &body.neighbours {
            let other = &scene.bodies[neighbour.other as usize];
            let phase = self.phase_at(&self.pairs[neighbour.pair as usize], part.start);
            let strength = scene.influence.strength(phase, this.radius, other.radius);
            let radius = scene.influence.sphere_radius(other.radius);
            // A sphere that ends short of every vertex of a body at rest would wake it for nothing.
            let reaches_rest = || {
                let distance = this.path.position(part.start).distance(other.path.position(part.start));
                let speed = this.path.relative_bounds(&other.path, part.start, part.end).speed;
                distance - speed * part.length() <= radius + this.radius
            };
            if strength != 0.0 && (!body.is_at_rest() || reaches_rest()) {
                spheres.push(Sphere { body: neighbour.other, radius, inverse_radius: 1.0 / radius, strength });
            }
        }
    }

    /// What acts on a body at a moment.
    pub fn surroundings(&self, index: usize, body: &Body, moment: Moment, surroundings: &mut Surroundings) {
        let scene = self.scene;
        let this = &scene.bodies[index];
        let own = this.path.at(moment.time);
        surroundings.carry = carry(this.material.response, this.material.damping, &own);
        surroundings.pushes.clear();
        surroundings.pushes.extend(body.pushes.iter().filter(|push| push_acts(push, moment.time)));
        surroundings.sources.clear();
        for neighbour in &body.neighbours {
            let other = &scene.bodies[neighbour.other as usize];
            let phase = self.phase_at(&self.pairs[neighbour.pair as usize], moment.phases_at);
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
            // A sphere that ends short of every vertex of a body at rest would wake it for nothing.
            if body.is_at_rest() && source.centre.length() > source.sphere_radius + this.radius {
                continue;
            }
            surroundings.sources.push(source);
        }
    }

    /// The phase of a pair from `t` on, within the current step.
    fn phase_at(&self, pair: &Pair, t: f64) -> Phase {
        let changes = &self.changes[pair.changes.clone()];
        changes.iter().rev().find(|&&(time, _)| time <= t).map_or(pair.phase, |&(_, phase)| phase)
    }
}
