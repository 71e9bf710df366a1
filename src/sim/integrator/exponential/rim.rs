//! When a vertex crosses the rim of an influence sphere within a step.

use std::cell::Cell;

use glam::DVec3;

use super::{
    course::Course,
    step::{Apart, LookUp, Outcome, Step, Vertex},
};
use crate::sim::state::State;

/// Looks for the crossing of a rim in a step: more are needed where a vertex swings many times in it, or its bounds are
/// far too wide.
pub const MOST_SAMPLES: u32 = 4096;

/// Not found out in so many looks.
#[derive(Clone, Copy, Debug)]
pub struct Unresolved;

/// The motion of a vertex over a step that has been taken, between its two ends: the quintic that has its displacement,
/// velocity and acceleration at both.
pub struct Motion<'a> {
    vertex: &'a Vertex,
    start: f64,
    h: f64,
    coefficients: [DVec3; 6],
    /// Bounds of |x′| [scene unit/s] and |x″| [scene unit/s²] on the step.
    speed: f64,
    acceleration: f64,
}

impl<'a> Motion<'a> {
    /// Of a vertex from `state` to the step's outcome.
    pub fn new(course: &Course<'_>, step: &Step, vertex: &'a Vertex, state: State, outcome: &Outcome) -> Motion<'a> {
        let h = step.h;
        let (omega, damping) = (course.body().material.omega, course.body().material.damping);
        let acceleration = |state: State, force: DVec3| force - omega * omega * state.x - 2.0 * damping * state.u;
        let (from, to) = (state, outcome.end);
        let (x0, u0, a0) = (from.x, from.u * h, acceleration(from, outcome.forces[0]) * (h * h));
        let (x1, u1, a1) = (to.x, to.u * h, acceleration(to, outcome.forces[3]) * (h * h));
        let d = x1 - x0 - u0 - a0 / 2.0;
        let v = u1 - u0 - a0;
        let a = a1 - a0;
        let force = outcome.forces[0].length().max(outcome.forces[3].length());
        let momentum = (from.u.length_squared() + omega * omega * from.x.length_squared()).sqrt() + force * h;
        Motion {
            vertex,
            start: step.start,
            h,
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

    /// The first time in the step, which is the one that the motion is of, at which the vertex crosses the rim of
    /// `sphere`: outwards if it is `inside` now, inwards otherwise. It may take so many `looks`, of which it leaves the rest.
    ///
    /// # Errors
    /// If that takes too many looks.
    pub fn crossing(
        &self,
        look: LookUp<'_>,
        step: &Step,
        sphere: usize,
        inside: bool,
        looks: &mut u32,
    ) -> Result<Option<f64>, Unresolved> {
        let rim = look.course.spheres[sphere].radius;
        let mut bounds = step.relative[sphere];
        if !look.whole.smooth {
            bounds = look.bounds(self.vertex, bounds);
        }
        // in units of the step
        let speed = (self.speed + bounds.speed) * self.h;
        let acceleration = (self.acceleration + bounds.acceleration) * self.h * self.h;

        // distance² − r_e² is on the same side at both ends, and too far to have been on the other in between:
        // it differs from the straight line between them by no more than its curvature/8
        let last = self.coefficients.iter().sum::<DVec3>();
        let [d0, d1] = [(0, self.coefficients[0]), (3, last)].map(|(node, displacement)| {
            let moment = &step.moments[node];
            (moment.centres[sphere] - self.vertex.rest_at(look.course, &moment.pushed) - displacement).length()
        });
        let mut gap = Gap {
            looks: Cell::new(*looks),
            sign: if inside { -1.0 } else { 1.0 },
            rim,
            curvature: 2.0 * speed * speed + 2.0 * (d0.max(d1) + speed) * acceleration,
        };
        let [g0, g1] = [d0, d1].map(|d| gap.of(d));
        if g0.min(g1) > gap.curvature / 8.0 {
            return Ok(None);
        }

        // a crossing is a fall of it, times the sign, through zero
        let [a, b, c, d, e, f] = self.coefficients;
        let theta = match look.apart(self.vertex, sphere, self.start, self.h) {
            Apart::Quartic([p, q, r, s, t]) => {
                // its centre relative to the vertex: one polynomial
                let (a, b, c, d, e) = (p - a, q - b, r - c, s - d, t - e);
                // whose own bounds are most often tighter
                let [c2, d2, e2, f2] = [c, d, e, f].map(DVec3::length);
                let speed = b.length() + 2.0 * c2 + 3.0 * d2 + 4.0 * e2 + 5.0 * f2;
                let acceleration = 2.0 * c2 + 6.0 * d2 + 12.0 * e2 + 20.0 * f2;
                let curvature = 2.0 * speed * speed + 2.0 * (d0 + speed) * acceleration;
                gap.curvature = gap.curvature.min(curvature);
                gap.first_fall(&|s| {
                    let position = a + s * (b + s * (c + s * (d + s * (e - s * f))));
                    let velocity = b + s * (2.0 * c + s * (3.0 * d + s * (4.0 * e - s * (5.0 * f))));
                    gap.at(position, velocity)
                })
            }
            Apart::Exact(path) => gap.first_fall(&|s| {
                let displacement = a + s * (b + s * (c + s * (d + s * (e + s * f))));
                let velocity = b + s * (2.0 * c + s * (3.0 * d + s * (4.0 * e + s * (5.0 * f))));
                let (position, motion) = path.at(self.start + s * self.h);
                gap.at(position - displacement, self.h * motion - velocity)
            }),
        };
        *looks = gap.looks.get();
        if *looks == 0 {
            return Err(Unresolved);
        }
        Ok(theta.map(|theta| if theta >= 1.0 { step.end() } else { self.start + theta * self.h }))
    }
}

/// `distance² − r_e²` of a vertex and a sphere over a step, times a sign so that the crossing looked for is a fall through
/// zero; the step lasts from 0 to 1.
struct Gap {
    /// How often it may still be looked at.
    looks: Cell<u32>,
    sign: f64,
    rim: f64,
    /// Bound of its second derivative.
    curvature: f64,
}

impl Gap {
    fn of(&self, distance: f64) -> f64 {
        self.sign * (distance - self.rim) * (distance + self.rim)
    }

    /// Its value and its slope.
    #[inline(always)]
    fn at(&self, apart: DVec3, velocity: DVec3) -> (f64, f64) {
        (self.sign * (apart.length_squared() - self.rim * self.rim), self.sign * (2.0 * apart.dot(velocity)))
    }

    /// The first root of a function that falls through zero there, given its value and its slope. Stretches that can hold
    /// no root are passed over whole; those on which the function is monotone are searched; others are halved.
    fn first_fall(&self, gap: &impl Fn(f64) -> (f64, f64)) -> Option<f64> {
        self.first_fall_within(gap, 0.0, 1.0)
    }

    fn first_fall_within(&self, gap: &impl Fn(f64) -> (f64, f64), start: f64, end: f64) -> Option<f64> {
        let looks = self.looks.get().checked_sub(1)?;
        self.looks.set(looks);
        let half = 0.5 * (end - start);
        let middle = start + half;
        let (g, slope) = gap(middle);
        let range = slope.abs() * half + 0.5 * self.curvature * half * half;
        let close = 1e-13 * self.rim * self.rim; // nearer to zero, only rounding is seen
        if g.abs() > range + close {
            return (g < 0.0).then_some(start); // no root; but if it has fallen already, that is seen now
        }
        let ends = || (gap(start).0, gap(end).0);
        if range <= close || middle <= start || middle >= end {
            let (before, after) = ends();
            return (before > 0.0 && after <= 0.0).then_some(end); // too short to tell more
        }
        if slope.abs() > self.curvature * half {
            if slope > 0.0 {
                return None;
            }
            return match ends() {
                (_, after) if after > 0.0 => None,
                (before, _) if before > 0.0 => Some(root(gap, start, end, middle - g / slope)),
                _ => Some(start), // it stands on the rim
            };
        }
        self.first_fall_within(gap, start, middle).or_else(|| self.first_fall_within(gap, middle, end))
    }
}

/// The root of a function that falls throughout `[low, high]` from above zero to below, from a first `guess` on: Newton's
/// steps, bisection where they leave the bracket.
fn root(gap: &impl Fn(f64) -> (f64, f64), mut low: f64, mut high: f64, guess: f64) -> f64 {
    // Newton's error after a step is about the square of the step: the last one is below rounding.
    const LAST_STEP: f64 = 1e-8;
    // On the stairs of rounded positions, far from the origin, Newton's steps are too small: so many, then bisection.
    const MOST_NEWTON: u32 = 32;
    let mut tries = 0;
    let mut t = if guess > low && guess < high { guess } else { low + 0.5 * (high - low) };
    while low < t && t < high {
        tries += 1;
        let (g, slope) = gap(t);
        if g > 0.0 {
            low = t;
        } else {
            high = t;
        }
        let newton = t - g / slope;
        let inside = newton > low && newton < high && tries < MOST_NEWTON;
        let next = if inside { newton } else { low + 0.5 * (high - low) };
        if (newton - t).abs() <= LAST_STEP {
            return newton.clamp(low, high);
        }
        t = next;
    }
    high
}
