//! Where a pair of an island changes its phase, and steps that end there.

use super::{
    super::work::Tally,
    conserved,
    field::{Pair, Paths},
    island::{Change, Failure, Island, MAX_CHANGES, Report, Scratch},
    step::Place,
};
use crate::{
    model::phase::{Phase, Transition},
    sim::numerics::{
        bernstein::Polynomial,
        control::{ROUNDING, STANDING},
    },
};

/// The instant of a step at which a pair reaches a level where the step has to end.
#[derive(Clone, Copy, Debug)]
pub(super) struct Crossing {
    /// Time as a fraction of the step.
    pub theta: f64,
    /// Index of the pair.
    pub pair: usize,
    /// The level of q that is reached [–].
    pub level: f64,
    /// The phase that begins, if any.
    pub to: Option<Phase>,
}

/// The difference of a distance from `rim` below which the two are the same [scene unit]: far from the origin, the rounding
/// of the centres; late in a run, the way at `rate` [scene unit/s] within the rounding of `time`.
fn standing(rim: f64, [a, b]: [Place; 2], time: f64) -> f64 {
    let rate = (a.centre - b.centre).normalize_or_zero().dot(a.velocity - b.velocity);
    let of_places = ROUNDING * (a.centre.length() + b.centre.length());
    (STANDING * rim).max(of_places).max(2.0 * f64::EPSILON * time * rate.abs())
}

impl Island {
    /// The levels of q at which a step ends, each with the direction of the crossing (whether it falls; `None`: either)
    /// and the new phase, if any.
    pub(super) fn levels(&self, pair: &Pair) -> impl Iterator<Item = (f64, Option<bool>, Option<Phase>)> + use<> {
        let Pair { phase, law, .. } = *pair;
        let ends = law.rim(phase).into_iter().flat_map(|rim| rim.ends());
        let ends = ends.filter(|&level| level > 0.0).map(|level| (level, None, None));
        let is_abrupt = move |from: Phase, way: &Transition| !law.is_gradual(from, way.to);
        // a pair that leaves its core gradually may also split in the same step
        let gradual = pair.transitions().filter(move |way| !is_abrupt(phase, way));
        let later =
            gradual.flat_map(move |way| law.thresholds.transitions(way.to).filter(move |next| is_abrupt(way.to, next)));
        let ways = pair.transitions().filter(move |way| is_abrupt(phase, way)).chain(later);
        ways.map(|way| (way.level, Some(way.falling), Some(way.to))).chain(ends)
    }

    /// Polynomial, in the step just tried, whose zeros are the instants at which a pair's q passes `level`; `None` if
    /// it has none.
    pub(super) fn course_of(&self, scratch: &Scratch, pair: &Pair, level: f64, h: f64) -> Option<Polynomial> {
        let (a, b) = (&scratch.places[pair.a as usize], &scratch.places[pair.b as usize]);
        let rim = level * (self.bodies[pair.a as usize].radius + self.bodies[pair.b as usize].radius);
        let distance: [f64; 4] = std::array::from_fn(|node| a[node].centre.distance(b[node].centre));
        let values = distance.map(|d| (d - rim) * (d + rim));
        let rates: [f64; 4] = std::array::from_fn(|node| {
            2.0 * h * (a[node].centre - b[node].centre).dot(a[node].velocity - b[node].velocity)
        });
        let fastest = rates.iter().fold(0.0, |m: f64, r| m.max(r.abs()));
        let alike = values.iter().all(|&v| (v > 0.0) == (values[0] > 0.0));
        if alike && values.iter().all(|v| v.abs() > fastest) {
            return None;
        }
        let polynomial = Polynomial::new(&values, &rates);
        let stands = (distance[0] - rim).abs() <= standing(rim, [a[0], b[0]], self.time);
        Some(if stands { polynomial.starting_at_zero() } else { polynomial })
    }

    /// Changes the phases of pairs that passed a threshold without a jump of strength in the step from `start` [s]
    /// until now; no step has to end there.
    pub(super) fn pass_gradually(
        &mut self,
        scratch: &mut Scratch,
        start: f64,
        report: &mut Report,
    ) -> Result<(), Failure> {
        let h = self.time - start;
        let first = report.changes.len();
        for index in 0..self.pairs.len() {
            let pair = self.pairs[index];
            let radii = self.bodies[pair.a as usize].radius + self.bodies[pair.b as usize].radius;
            let Some(level) = pair.law.gradual_level(pair.phase) else { continue };
            let Some(course) = self.course_of(scratch, &pair, level, h) else { continue };
            let mut positive = course.starts_positive();
            for &theta in course.crossings().as_slice() {
                let from = self.pairs[index].phase;
                let passed = self.pairs[index].transitions().find(|way| way.level == level);
                let rate = course.rate_at(theta) / (2.0 * h * level * radii * radii);
                if let Some(way) = passed.filter(|way| way.falling == positive) {
                    let (time, to) = (start + theta * h, way.to);
                    report.changes.push(Change { time, pair: index, q: level, rate, from, to, energy: 0.0 });
                    self.pairs[index].phase = to;
                    self.count(index, time, scratch)?;
                }
                positive = !positive;
            }
        }
        report.changes[first..].sort_by(|one, other| one.time.total_cmp(&other.time));
        Ok(())
    }

    /// The first instant of the step just tried at which a step has to end.
    pub(super) fn first_crossing(&self, scratch: &Scratch, h: f64) -> Option<Crossing> {
        let mut first: Option<Crossing> = None;
        for (index, pair) in self.pairs.iter().enumerate() {
            for (level, falling, to) in self.levels(pair) {
                let Some(polynomial) = self.course_of(scratch, pair, level, h) else { continue };
                let mut positive = polynomial.starts_positive();
                for &theta in polynomial.crossings().as_slice() {
                    if falling.is_none_or(|falling| falling == positive) {
                        if first.is_none_or(|before| theta < before.theta) {
                            first = Some(Crossing { theta, pair: index, level, to });
                        }
                        break;
                    }
                    positive = !positive;
                }
            }
        }
        first
    }

    /// Repeats the step so that it ends where the pair reaches the level. Returns this time [s], which may be the start of
    /// the step, and what is left to correct; `None` if the iteration does not converge.
    pub(super) fn end_at(
        &self,
        scratch: &mut Scratch,
        next: f64,
        crossing: Crossing,
        paths: &dyn Paths,
        work: &Tally<'_>,
        report: &mut Report,
    ) -> Option<(f64, f64)> {
        let Crossing { theta, pair, level, .. } = crossing;
        const MAX_TRIES: u32 = 5;
        let (a, b) = (self.pairs[pair].a as usize, self.pairs[pair].b as usize);
        let rim = level * (self.bodies[a].radius + self.bodies[b].radius);
        let mut end = self.time + theta * (next - self.time);
        let mut left = 0.0;
        for _ in 0..MAX_TRIES {
            if end <= self.time {
                return Some((self.time, 0.0));
            }
            left = self.solve(scratch, &self.span(end), paths, work, report)?;
            let (a, b) = (scratch.places[a][3], scratch.places[b][3]);
            let apart = a.centre - b.centre;
            let distance = apart.length();
            let rate = apart.dot(a.velocity - b.velocity) / distance;
            let off = (distance - rim) / rate;
            let standing = standing(rim, [a, b], end);
            if !((distance - rim).abs() > 0.1 * standing && off.abs() < next - self.time && end - off != end) {
                return Some((end, left));
            }
            end -= off;
        }
        // the last correction is below what can be distinguished, or Newton's method does not converge
        left = if end > self.time { self.solve(scratch, &self.span(end), paths, work, report)? } else { left };
        Some((end.max(self.time), left))
    }

    /// Changes the phases of pairs that are beyond a threshold of their phase, or on it and moving across it.
    pub(super) fn leave_phases(
        &mut self,
        scratch: &mut Scratch,
        paths: &dyn Paths,
        report: &mut Report,
    ) -> Result<(), Failure> {
        for i in 0..self.bodies.len() {
            scratch.places[i][3] = self.place(i, self.time, false, paths);
        }
        for index in 0..self.pairs.len() {
            let pair = self.pairs[index];
            let (a, b) = (scratch.places[pair.a as usize][3], scratch.places[pair.b as usize][3]);
            let radii = self.bodies[pair.a as usize].radius + self.bodies[pair.b as usize].radius;
            let apart = a.centre - b.centre;
            let rate = apart.dot(a.velocity - b.velocity);
            // a body that jumps may pass two thresholds at once
            for first in [true, false] {
                let beyond = self.pairs[index].transitions().find(|way| {
                    let side = if way.falling { 1.0 } else { -1.0 };
                    let gap = side * (apart.length() - way.level * radii);
                    let standing = standing(way.level * radii, [a, b], self.time);
                    gap < -standing || (first && gap <= standing && side * rate < 0.0)
                });
                let Some(way) = beyond else { break };
                self.change(index, way.to, scratch, report)?;
            }
        }
        Ok(())
    }

    /// Changes the phase of a pair now.
    pub(super) fn change(
        &mut self,
        index: usize,
        to: Phase,
        scratch: &mut Scratch,
        report: &mut Report,
    ) -> Result<(), Failure> {
        let pair = self.pairs[index];
        for i in [pair.a as usize, pair.b as usize] {
            if !self.bodies[i].is_free() {
                let Place { centre, velocity } = scratch.places[i][3];
                (self.bodies[i].centre, self.bodies[i].velocity) = (centre, velocity);
            }
        }
        let (a, b) = (&self.bodies[pair.a as usize], &self.bodies[pair.b as usize]);
        let (q, rate) = a.q_and_rate(b);
        let jump = pair.law.strength(to, q) - pair.law.strength(pair.phase, q);
        let energy = conserved::influence(a, b, &self.field, jump);
        report.ledger.events += energy;
        report.changes.push(Change { time: self.time, pair: index, q, rate, from: pair.phase, to, energy });
        self.pairs[index].phase = to;
        self.count(index, self.time, scratch)
    }

    /// Counts a change of phase; fails if the pair chatters.
    pub(super) fn count(&self, index: usize, time: f64, scratch: &mut Scratch) -> Result<(), Failure> {
        scratch.changes[index] += 1;
        let Pair { a, b, .. } = self.pairs[index];
        if scratch.changes[index] > MAX_CHANGES { Err(Failure::Chatter { a, b, time }) } else { Ok(()) }
    }
}
