//! When a pair of bodies changes phase: exact times, by root finding on the prescribed paths.
//!
//! The distance of two centres reaches a threshold L where `g(t) = |c_a(t) − c_b(t)|² − L²` crosses zero. The paths
//! bound |g″| over any stretch of time, so stretches that can't hold a root are passed over whole, stretches on which
//! g is monotone are searched by safeguarded Newton steps, and others are halved: no crossing is missed, however
//! short the visit.

use glam::DVec3;

use crate::{
    model::phase::{Phase, Thresholds},
    scene::{Path, path::Bounds},
};

/// A change of phase of a pair, at its exact time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Event {
    /// When it happened [s].
    pub time: f64,
    /// The first step whose state has felt it.
    pub step: u64,
    /// Index of one body of the pair …
    pub a: u32,
    /// … and of the other, a < b.
    pub b: u32,
    /// Centre distance over the sum of the radii at that time [–].
    pub q: f64,
    /// The phase that ended.
    pub from: Phase,
    /// The phase that began.
    pub to: Phase,
}

impl Event {
    /// What happened, as recordings and summaries call it.
    pub fn name(&self) -> &'static str {
        match (self.from, self.to) {
            (_, Phase::Apart) => "split",
            (_, Phase::Core) => "core",
            (Phase::Core, Phase::Merged) => "core left",
            (_, Phase::Merged) => "merge",
        }
    }
}

/// Two paths whose distance is watched.
#[derive(Clone, Copy, Debug)]
pub struct PairPaths<'a> {
    /// Path of one body …
    pub a: &'a Path,
    /// … and of the other.
    pub b: &'a Path,
    /// Sum of the two radii [scene unit].
    pub radii: f64,
}

impl PairPaths<'_> {
    /// Centre distance over the sum of the radii at time `t` [–].
    pub fn q(&self, t: f64) -> f64 {
        (self.a.position(t) - self.b.position(t)).length() / self.radii
    }

    /// Bounds of the motion of one centre relative to the other over `[start, end]` [s]: the sum of the two, or less
    /// where both move alike (bodies in formation would be a hard case otherwise).
    fn relative_bounds(&self, start: f64, end: f64) -> Bounds {
        let difference = match (self.a, self.b) {
            (Path::Line { velocity: v, .. }, Path::Line { velocity: w, .. }) => {
                Path::Line { from: DVec3::ZERO, velocity: *v - *w }
            }
            (
                Path::Sine { amplitude: v, frequency, phase, .. },
                Path::Sine { amplitude: w, frequency: other_frequency, phase: other_phase, .. },
            ) if frequency == other_frequency && phase == other_phase => {
                Path::Sine { center: DVec3::ZERO, amplitude: *v - *w, frequency: *frequency, phase: *phase }
            }
            (a, b) => {
                let (a, b) = (a.bounds(start, end), b.bounds(start, end));
                return Bounds { speed: a.speed + b.speed, acceleration: a.acceleration + b.acceleration };
            }
        };
        difference.bounds(start, end)
    }

    /// The phase changes in `(start, end]` of a pair that is in `phase` at `start`, in order: `(time, new phase)`.
    /// A pair that stands exactly on a threshold at `start` and moves across it changes at `start`.
    pub fn phase_changes(
        &self,
        thresholds: &Thresholds,
        mut phase: Phase,
        start: f64,
        end: f64,
        mut found: impl FnMut(f64, Phase),
    ) {
        let mut t = start;
        loop {
            let next = thresholds
                .transitions(phase)
                .filter_map(|way| {
                    let gap = Gap { pair: self, level: way.level * self.radii };
                    let sign = if way.falling { 1.0 } else { -1.0 };
                    gap.first_fall(sign, t, end).map(|time| (time, way.to))
                })
                .min_by(|x, y| x.0.total_cmp(&y.0));
            let Some((time, to)) = next else { return };
            found(time, to);
            (t, phase) = (time, to);
        }
    }
}

/// `g(t) = |c_a − c_b|² − level²`, times a sign so that the crossing looked for is always a fall through zero.
struct Gap<'a> {
    pair: &'a PairPaths<'a>,
    level: f64,
}

impl Gap<'_> {
    /// g and g′ at `t`.
    fn at(&self, t: f64) -> (f64, f64) {
        let (a, b) = (self.pair.a.at(t), self.pair.b.at(t));
        let (apart, relative) = (a.position - b.position, a.velocity - b.velocity);
        // (d − L)(d + L): no cancellation where it matters, at d ≈ L
        let d = apart.length();
        ((d - self.level) * (d + self.level), 2.0 * apart.dot(relative))
    }

    /// An upper bound of |g″| = |2|Δv|² + 2Δc·Δa| within `half` of the middle `m`, where Δc = `apart`.
    fn curvature(&self, m: f64, half: f64, apart: DVec3) -> f64 {
        let Bounds { speed, acceleration } = self.pair.relative_bounds(m - half, m + half);
        2.0 * speed * speed + 2.0 * (apart.length() + speed * half) * acceleration
    }

    /// The first time in `[start, end]` at which `sign · g` falls through zero.
    fn first_fall(&self, sign: f64, start: f64, end: f64) -> Option<f64> {
        if start >= end {
            return None;
        }
        let m = start + 0.5 * (end - start);
        let half = 0.5 * (end - start);
        let apart = self.pair.a.position(m) - self.pair.b.position(m);
        let (g, slope) = self.at(m);
        let curvature = self.curvature(m, half, apart);

        // |g(t) − g(m) − g′(m)(t − m)| ≤ curvature · half²/2 everywhere on the stretch: no root, next
        if g.abs() > slope.abs() * half + 0.5 * curvature * half * half {
            return None;
        }
        // g′ keeps its sign: at most one root, and only if it falls
        if slope.abs() > curvature * half {
            return if sign * slope < 0.0 { self.root_of_fall(sign, start, end) } else { None };
        }
        // Too short, or all of it too close to the threshold, to tell more: the signs at the ends decide.
        let largest = g.abs() + slope.abs() * half + 0.5 * curvature * half * half;
        if largest <= 1e-13 * self.level * self.level || m <= start || m >= end {
            let (before, after) = (sign * self.at(start).0, sign * self.at(end).0);
            return (before > 0.0 && after <= 0.0).then_some(end);
        }
        self.first_fall(sign, start, m).or_else(|| self.first_fall(sign, m, end))
    }

    /// The root of `sign · g`, which falls throughout `[low, high]`: Newton's steps, bisection where they leave the
    /// bracket. `low` itself if it has fallen already there (a pair that stands on its threshold).
    fn root_of_fall(&self, sign: f64, mut low: f64, mut high: f64) -> Option<f64> {
        if sign * self.at(high).0 > 0.0 {
            return None;
        }
        if sign * self.at(low).0 <= 0.0 {
            return Some(low);
        }
        let mut t = low + 0.5 * (high - low);
        for _ in 0..200 {
            let (g, slope) = self.at(t);
            if g == 0.0 {
                return Some(t);
            }
            if sign * g > 0.0 {
                low = t;
            } else {
                high = t;
            }
            let newton = t - g / slope;
            let next = if newton > low && newton < high { newton } else { low + 0.5 * (high - low) };
            if (next - t).abs() <= f64::EPSILON * t.abs() || next <= low || next >= high {
                return Some(next.clamp(low, high));
            }
            t = next;
        }
        Some(t)
    }
}
