//! The exact times at which a pair of bodies changes phase, by root finding on the prescribed paths.
//!
//! The distance of two centres reaches a threshold L where `g(t) = |c_a(t) − c_b(t)|² − L²` crosses zero. The paths
//! bound |g″| over any interval of time, so intervals that cannot contain a root are skipped, intervals on which g is
//! monotone are searched by safeguarded Newton steps, and others are halved: no crossing is missed, however brief. A
//! pair within a few rounding errors of a threshold counts as on it until it has left.

use super::{
    numerics::roots::{self, Falling, Sample},
    work::{DISTANCE, Tally},
};
use crate::{
    model::phase::{Phase, Thresholds},
    scene::{
        Path,
        path::{Bounds, Kinematics},
    },
};

/// A change of phase of a pair, at its exact time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Event {
    /// When it happened [s].
    pub time: f64,
    /// The first step whose final state it affects.
    pub step: u64,
    /// Index of the first body of the pair.
    pub a: u32,
    /// Index of the second body; a < b.
    pub b: u32,
    /// Centre distance over the sum of the radii at that time [–].
    pub q: f64,
    /// Rate of change of q at that time [1/s].
    pub rate: f64,
    /// The phase that ended.
    pub from: Phase,
    /// The phase that began.
    pub to: Phase,
    /// Energy brought by the change of strength, Σ m Δs (Φ − Φ(r_e)) [mass · scene unit²/s²]; 0 in scenes that are not
    /// coupled, and with explicit schemes.
    pub energy: f64,
}

/// The kinds of events, each with when it happens.
pub const KINDS: [(&str, &str); 4] = [
    ("merge", "The bodies of a pair come closer than `merge_at`: they are merged."),
    ("split", "The bodies of a pair move farther apart than `split_at`: they are apart."),
    ("core", "The bodies of a pair come closer than `core_at`: they are in their core, and repel each other."),
    ("core left", "The bodies of a pair leave their core: they are merged."),
];

impl Event {
    /// The name used in recordings and summaries.
    pub fn name(&self) -> &'static str {
        match (self.from, self.to) {
            (_, Phase::Apart) => "split",
            (_, Phase::Core) => "core",
            (Phase::Core, Phase::Merged) => "core left",
            (_, Phase::Merged) => "merge",
        }
    }
}

/// The paths of two bodies whose distance is watched.
#[derive(Clone, Copy, Debug)]
pub struct PairPaths<'a> {
    /// Path of one body.
    pub a: &'a Path,
    /// Path of the other body.
    pub b: &'a Path,
    /// Sum of the two radii [scene unit].
    pub radii: f64,
}

impl PairPaths<'_> {
    /// Centre distance over the sum of the radii at time `t` [–].
    pub fn q(&self, t: f64) -> f64 {
        (self.a.position(t) - self.b.position(t)).length() / self.radii
    }

    /// Rate of change of q at time `t` [1/s]; 0 where the centres coincide.
    pub fn rate(&self, t: f64) -> f64 {
        let (a, b) = (self.a.at(t), self.b.at(t));
        (a.position - b.position).normalize_or_zero().dot(a.velocity - b.velocity) / self.radii
    }

    /// The phase changes in `(start, end]` of a pair that is in `phase` at `start`, in order: `(time, new phase)`.
    /// A pair that stands exactly on a threshold at `start` and moves across it changes at `start`.
    ///
    /// `phase` is not checked: a pair that has already passed a threshold out of it changes as soon as that is found.
    pub fn phase_changes(
        &self,
        thresholds: &Thresholds,
        mut phase: Phase,
        start: f64,
        end: f64,
        mut found: impl FnMut(f64, Phase),
    ) {
        let mut t = start;
        while let Some((time, to)) = self.first_change(thresholds, phase, t, end) {
            found(time, to);
            (t, phase) = (time, to);
        }
    }

    /// The first of the [`PairPaths::phase_changes`].
    pub fn first_change(&self, thresholds: &Thresholds, phase: Phase, start: f64, end: f64) -> Option<(f64, Phase)> {
        Search { paths: *self, thresholds, work: &Tally::unlimited() }.first_change(phase, start, end)
    }
}

/// A search for the phase changes of a pair, limited by `work`: results are meaningless once that is over.
#[derive(Clone, Copy)]
pub(crate) struct Search<'a> {
    pub paths: PairPaths<'a>,
    pub thresholds: &'a Thresholds,
    pub work: &'a Tally<'a>,
}

impl Search<'_> {
    /// See [`PairPaths::first_change`].
    pub fn first_change(&self, phase: Phase, start: f64, end: f64) -> Option<(f64, Phase)> {
        // From knot to knot, so that a pair that comes to rest on a threshold does so at the end of an interval.
        let mut from = start;
        let Search { paths, thresholds, work } = self;
        let may_jump = paths.a.is_held() || paths.b.is_held();
        if may_jump && let Some(to) = paths.jump(thresholds, phase, from) {
            return Some((from, to));
        }
        loop {
            let to = paths.knot_after(from).min(end);
            let (a, b) = (paths.a.between(from, to), paths.b.between(from, to));
            let between = Search { paths: PairPaths { a: &a, b: &b, radii: paths.radii }, ..*self };
            let found = between.first_change_between_knots(phase, from, to);
            if found.is_some() || work.is_over() {
                return found;
            }
            if may_jump && let Some(phase) = paths.jump(thresholds, phase, to) {
                return Some((to, phase));
            }
            if to >= end {
                return None;
            }
            from = to;
        }
    }

    fn first_change_between_knots(&self, phase: Phase, start: f64, end: f64) -> Option<(f64, Phase)> {
        let Search { paths, thresholds, work } = self;
        if paths.a.relative_bounds(paths.b, start, end).speed == 0.0 {
            return None; // at rest, or moving together: only rounding could change the distance
        }
        thresholds
            .transitions(phase)
            .filter_map(|way| {
                let sign = if way.falling { 1.0 } else { -1.0 };
                let mut gap = Gap { pair: paths, level: way.level * paths.radii, sign, was_above: false, work };
                gap.first_fall(start, end).map(|time| (time, way.to))
            })
            .min_by(|x, y| x.0.total_cmp(&y.0))
    }
}

impl PairPaths<'_> {
    /// The phase that a pair in `phase` enters at `t` [s] if a centre jumps at that time, by the position after the
    /// jump.
    pub(super) fn jump(&self, thresholds: &Thresholds, phase: Phase, t: f64) -> Option<Phase> {
        let jumps = |path: &Path| path.is_held() && path.knots().binary_search_by(|at| at.total_cmp(&t)).is_ok();
        if !(jumps(self.a) || jumps(self.b)) {
            return None;
        }
        thresholds.next(phase, self.q(t))
    }

    /// The first instant after `t` at which a derivative of a path jumps [s].
    fn knot_after(&self, t: f64) -> f64 {
        let after = |path: &Path| {
            let knots = path.knots();
            knots.get(knots.partition_point(|&knot| knot <= t)).copied().unwrap_or(f64::INFINITY)
        };
        after(self.a).min(after(self.b))
    }
}

/// `g(t) = |c_a − c_b|² − level²`, with a sign such that the crossing is always a fall through zero.
struct Gap<'a> {
    pair: &'a PairPaths<'a>,
    level: f64,
    /// 1 if the pair crosses the threshold by coming nearer, otherwise −1.
    sign: f64,
    /// Whether g was above zero by more than rounding when the search began.
    was_above: bool,
    work: &'a Tally<'a>,
}

impl Gap<'_> {
    /// Signed g and g′ from the motion of the two centres.
    fn of(&self, a: &Kinematics, b: &Kinematics) -> (f64, f64) {
        let (apart, relative) = (a.position - b.position, a.velocity - b.velocity);
        // (d − L)(d + L) avoids cancellation at d ≈ L
        let d = apart.length();
        (self.sign * ((d - self.level) * (d + self.level)), self.sign * (2.0 * apart.dot(relative)))
    }

    /// Effect of rounding of the centres on a g near zero.
    fn rounding(&self, a: &Kinematics, b: &Kinematics) -> f64 {
        let far = a.position.abs().max_element() + b.position.abs().max_element();
        8.0 * f64::EPSILON * self.level * (self.level + far)
    }

    /// The first time in `[start, end]` at which g falls through zero, given that it is above or on zero at `start`.
    fn first_fall(&mut self, start: f64, end: f64) -> Option<f64> {
        let (a, b) = (self.pair.a.at(start), self.pair.b.at(start));
        let (g, rounding) = (self.of(&a, &b).0, self.rounding(&a, &b));
        self.was_above = g > rounding;
        if start < end { roots::first_fall(self, start, end) } else { None }
    }
}

impl Falling for Gap<'_> {
    const LAST_STEP: f64 = 0.0;

    /// Signed g and g′ at `t`.
    fn at(&self, t: f64) -> (f64, f64) {
        self.work.spend(DISTANCE);
        self.of(&self.pair.a.at(t), &self.pair.b.at(t))
    }

    fn was_above(&self) -> bool {
        self.was_above
    }

    fn sample(&self, start: f64, middle: f64, end: f64) -> Option<Sample> {
        if !self.work.spend(DISTANCE) {
            return None;
        }
        let half = 0.5 * (end - start);
        let (a, b) = (self.pair.a.at(middle), self.pair.b.at(middle));
        let (g, slope) = self.of(&a, &b);
        let apart = (a.position - b.position).length();

        // bounds over the interval: |g″| = |2|Δv|² + 2Δc·Δa|, and the range of g about its value in the middle
        let Bounds { speed, acceleration } = self.pair.a.relative_bounds(self.pair.b, start, end);
        let curvature = 2.0 * speed * speed + 2.0 * (apart + speed * half) * acceleration;
        let range = slope.abs() * half + 0.5 * curvature * half * half;
        let rounding = self.rounding(&a, &b);
        let close = 8.0 * rounding;

        // no root: still above zero, or below since it passed within `close` of zero just before
        Some(Sample {
            value: g,
            slope,
            curvature,
            is_clear: g.abs() > range + close,
            is_unresolved: g.abs() + range <= close,
            rounding,
            guess: middle,
        })
    }
}
