//! When a vertex crosses the rim of an influence sphere within a step.

use glam::DVec3;

use super::{
    super::State,
    course::Course,
    step::{Outcome, Step},
};
use crate::model::oscillator::Oscillator;

/// The motion of a vertex over a step that has been taken, between its two ends: the quintic that has its displacement,
/// velocity and acceleration at both.
pub struct Motion {
    start: f64,
    h: f64,
    rest: DVec3,
    coefficients: [DVec3; 6],
    /// Bounds of |x′| [scene unit/s] and |x″| [scene unit/s²] on the step.
    speed: f64,
    acceleration: f64,
}

impl Motion {
    /// Of a vertex with rest position `rest` from `state` to the step's outcome.
    pub fn new(step: &Step, rest: DVec3, oscillator: Oscillator, state: State, outcome: &Outcome) -> Motion {
        let h = step.weights.h;
        let Oscillator { omega, damping } = oscillator;
        let acceleration = |state: State, force: DVec3| force - omega * omega * state.x - 2.0 * damping * state.u;
        let (from, to) = (state, outcome.end);
        let (x0, u0, a0) = (from.x, from.u * h, acceleration(from, outcome.forces[0]) * (h * h));
        let (x1, u1, a1) = (to.x, to.u * h, acceleration(to, outcome.forces[1]) * (h * h));
        let d = x1 - x0 - u0 - a0 / 2.0;
        let v = u1 - u0 - a0;
        let a = a1 - a0;
        let force = outcome.forces[0].length().max(outcome.forces[1].length());
        let momentum = (from.u.length_squared() + omega * omega * from.x.length_squared()).sqrt() + force * h;
        Motion {
            start: step.start,
            h,
            rest,
            coefficients: [
                x0,
                u0,
                a0 / 2.0,
                10.0 * d - 4.0 * v + a / 2.0,
                -15.0 * d + 7.0 * v - a,
                6.0 * d - 3.0 * v + a / 2.0,
            ],
            speed: momentum,
            acceleration: (omega + 2.0 * damping) * momentum + force,
        }
    }

    /// Position and velocity in body coordinates at time `t` of the step.
    fn at(&self, t: f64) -> (DVec3, DVec3) {
        let s = (t - self.start) / self.h;
        let [a, b, c, d, e, f] = self.coefficients;
        let position = a + s * (b + s * (c + s * (d + s * (e + s * f))));
        let velocity = b + s * (2.0 * c + s * (3.0 * d + s * (4.0 * e + s * (5.0 * f))));
        (self.rest + position, velocity / self.h)
    }

    /// The first time in the step, which is the one that the motion is of, at which the vertex crosses the rim of
    /// `sphere`: outwards if it is `inside` now, inwards otherwise.
    pub fn crossing(&self, course: &Course<'_>, step: &Step, sphere: usize, inside: bool) -> Option<f64> {
        let rim = course.spheres[sphere].radius;
        let sign = if inside { -1.0 } else { 1.0 };
        let bounds = step.relative[sphere];
        let speed = self.speed + bounds.speed;
        let acceleration = self.acceleration + bounds.acceleration;

        // distance² − r_e² is on the same side at both ends, and too far to have been on the other in between:
        // it differs from the straight line between them by no more than its curvature times h²/8
        let last = self.coefficients.iter().sum::<DVec3>() + self.rest;
        let [d0, d1] = [(0, self.rest + self.coefficients[0]), (3, last)]
            .map(|(node, position)| (step.moments[node].centres[sphere] - position).length());
        let curvature = 2.0 * speed * speed + 2.0 * (d0.max(d1) + speed * self.h) * acceleration;
        let gap = |distance: f64| sign * (distance - rim) * (distance + rim);
        if gap(d0).min(gap(d1)) > curvature * self.h * self.h / 8.0 {
            return None;
        }

        // and its slope; a crossing is a fall of it, times the sign, through zero
        let gap_at = |t: f64| {
            let (position, velocity) = self.at(t);
            let (own, other) = (course.body().path.at(t), course.path(sphere).at(t));
            let apart = other.position - own.position - position;
            let slope = 2.0 * apart.dot(other.velocity - own.velocity - velocity);
            let distance = apart.length();
            (gap(distance), sign * slope, distance)
        };
        first_fall(&gap_at, speed, acceleration, rim, step.start, step.end())
    }
}

/// The first root in `[start, end]` of a function that falls through zero there, given its value, its slope and the
/// distance that it is made of, and bounds of the speed and acceleration of that distance. Stretches that can hold no
/// root are passed over whole; those on which the function is monotone are searched; others are halved.
fn first_fall(
    gap: &impl Fn(f64) -> (f64, f64, f64),
    speed: f64,
    acceleration: f64,
    rim: f64,
    start: f64,
    end: f64,
) -> Option<f64> {
    let half = 0.5 * (end - start);
    let middle = start + half;
    let (g, slope, distance) = gap(middle);
    let curvature = 2.0 * speed * speed + 2.0 * (distance + speed * half) * acceleration;
    let range = slope.abs() * half + 0.5 * curvature * half * half;
    let close = 1e-13 * rim * rim; // nearer to zero, only rounding is seen
    if g.abs() > range + close {
        return (g < 0.0).then_some(start); // no root; but if it has fallen already, that is seen now
    }
    let ends = || (gap(start).0, gap(end).0);
    if range <= close || middle <= start || middle >= end {
        let (before, after) = ends();
        return (before > 0.0 && after <= 0.0).then_some(end); // too short to tell more
    }
    if slope.abs() > curvature * half {
        if slope > 0.0 {
            return None;
        }
        return match ends() {
            (_, after) if after > 0.0 => None,
            (before, _) if before > 0.0 => Some(root(gap, start, end)),
            _ => Some(start), // it stands on the rim
        };
    }
    first_fall(gap, speed, acceleration, rim, start, middle)
        .or_else(|| first_fall(gap, speed, acceleration, rim, middle, end))
}

/// The root of a function that falls throughout `[low, high]` from above zero to below: Newton's steps, bisection where
/// they leave the bracket. Late by a rounding error rather than early: the crossing has happened then.
fn root(gap: &impl Fn(f64) -> (f64, f64, f64), mut low: f64, mut high: f64) -> f64 {
    let mut t = low + 0.5 * (high - low);
    while low < t && t < high {
        let (g, slope, _) = gap(t);
        if g > 0.0 {
            low = t;
        } else {
            high = t;
        }
        let newton = t - g / slope;
        let next = if newton > low && newton < high { newton } else { low + 0.5 * (high - low) };
        if (next - t).abs() <= 4.0 * f64::EPSILON * t.abs() {
            return next.clamp(low, high);
        }
        t = next;
    }
    high
}
