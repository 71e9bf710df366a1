//! One body over one step: where its sub-steps end, what acts on it in each, and the scheme's turn.

use super::{
    Span,
    body::{Body, Extent, Scratch},
    integrator::{self, Interval},
    pairs::Pair,
    surroundings::{Source, Surroundings, carry, push_acts},
};
use crate::{
    model::phase::Phase,
    scene::{Path, Scene, path::Kinematics},
};

/// What the integration of a body reads and does not change.
#[derive(Clone, Copy)]
pub(super) struct Context<'a> {
    pub scene: &'a Scene,
    pub pairs: &'a [Pair],
    /// Phase changes of the step, grouped by pair.
    pub changes: &'a [(f64, Phase)],
}

/// An instant at which surroundings are wanted. The times differ only where something jumps there.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moment {
    /// Where the centres are [s].
    pub time: f64,
    /// Which limit of the own acceleration is meant.
    pub side: Side,
    /// Pairs have the phases that they have from this time on [s].
    pub phases_at: f64,
    /// The pushes that act are those at this time [s].
    pub pushes_at: f64,
}

/// Which one-sided limit is meant at an instant at which something jumps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Side {
    Before,
    After,
}

impl Side {
    fn of(self, path: &Path, t: f64) -> Kinematics {
        match self {
            Side::Before => path.before(t),
            Side::After => path.at(t),
        }
    }
}

impl Context<'_> {
    /// Advances one body over `span`; returns the number of sub-steps taken, 0 if it slept.
    pub fn advance(&self, index: usize, body: &mut Body, span: Span) -> u64 {
        let scene = self.scene;
        // Out of the body, so that the body can be changed while they are read; a move, no allocation.
        let mut scratch = std::mem::take(&mut body.scratch);
        let Scratch { interval, breaks } = &mut scratch;
        self.find_breaks(index, body, span, breaks);
        interval.oscillator = body.oscillator;
        interval.weight = scene.influence.weight;

        let mut substeps = 0;
        for ends in breaks.windows(2) {
            self.look_around(index, body, Span { start: ends[0], end: ends[1] }, interval);
            if body.is_at_rest() && interval.is_idle(scene.integrator) {
                continue;
            }
            body.wake();
            let Body { unit, displacement, velocity, .. } = body;
            integrator::advance(scene.integrator, interval, scene.bodies[index].radius, unit, displacement, velocity);
            substeps += 1;
        }
        if substeps > 0 {
            body.extent = Extent::of(&body.displacement, &body.velocity, body.oscillator);
        }
        body.scratch = scratch;
        substeps
    }

    /// The ends of the sub-steps: those of `span`, and what jumps in between if the scheme divides its steps.
    fn find_breaks(&self, index: usize, body: &Body, span: Span, breaks: &mut Vec<f64>) {
        breaks.clear();
        breaks.push(span.start);
        if integrator::splits_steps(self.scene.integrator) {
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
        }
        breaks.push(span.end);
    }

    /// Sets `interval` up for one sub-step of a body.
    fn look_around(&self, index: usize, body: &Body, part: Span, interval: &mut Interval) {
        let integrator = self.scene.integrator;
        let (middle, end) = integrator::looks_at(integrator);
        interval.h = part.length();
        let inside = part.start + 0.5 * part.length();
        let at = |time| Moment { time, side: Side::After, phases_at: part.start, pushes_at: time };
        if integrator::splits_steps(integrator) {
            // Nothing jumps inside the sub-step: at its end look back into it.
            interval.propagator = body.oscillator.propagator(interval.h);
            let at = |time, side| Moment { side, pushes_at: inside, ..at(time) };
            self.surroundings(index, body, at(part.start, Side::After), &mut interval.start);
            self.surroundings(index, body, at(part.end, Side::Before), &mut interval.end);
            return;
        }
        // The others take what they find at each instant, and the phases as they were.
        self.surroundings(index, body, at(part.start), &mut interval.start);
        if middle {
            self.surroundings(index, body, at(inside), &mut interval.middle);
        }
        if end {
            self.surroundings(index, body, at(part.end), &mut interval.end);
        }
    }

    /// What acts on a body at a moment.
    pub fn surroundings(&self, index: usize, body: &Body, moment: Moment, surroundings: &mut Surroundings) {
        let scene = self.scene;
        let this = &scene.bodies[index];
        let own = moment.side.of(&this.path, moment.time);
        surroundings.carry = carry(this.material.response, this.material.damping, &own);
        surroundings.pushes.clear();
        surroundings.pushes.extend(body.pushes.iter().filter(|push| push_acts(push, moment.pushes_at)));
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
