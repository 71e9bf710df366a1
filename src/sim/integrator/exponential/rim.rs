//! Locates the time at which a vertex crosses the rim of an influence sphere within a step.

use std::cell::Cell;

use glam::DVec3;

use super::{
    course::Course,
    step::{Apart, Outcome, Step, Trajectories, Vertex},
};
use crate::sim::{
    numerics::roots::{self, Falling, Sample},
    state::State,
};

/// Largest number of samples in the search for a rim crossing. More would be needed only if a vertex oscillates many
/// times in a step, or if its bounds are far too wide.
pub const MAX_SAMPLES: u32 = 4096;

/// The crossing was not resolved within the allowed number of samples.
#[derive(Clone, Copy, Debug)]
pub struct Unresolved;

/// The rim of a sphere that a vertex may cross in a step.
#[derive(Clone, Copy, Debug)]
pub struct Rim {
    /// Index of the sphere in the course.
    pub sphere: usize,
    /// Whether the vertex is inside at the start of the step, so that it crosses outwards; otherwise inwards.
    pub is_inside: bool,
    /// Whether it is at the rim at the start of the step, to within rounding: it has just crossed it.
    pub is_start: bool,
}

/// The motion of a vertex over a completed step, interpolated by the quintic that matches displacement, velocity and
/// acceleration at both ends.
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
    /// The motion of a vertex from `state` to the step's outcome.
    pub fn new(course: &Course<'_>, step: &Step, vertex: &'a Vertex, state: State, outcome: &Outcome) -> Motion<'a> {
        let h = step.h;
        let (omega, damping) = (course.material.omega, course.material.damping);
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

    /// The first time after the start of the step at which the vertex crosses a rim. The step must be the one that this
    /// motion belongs to. `samples_left` is the number of samples that may still be taken; the search decrements it.
    ///
    /// # Errors
    /// If the search needs too many samples.
    pub fn crossing(
        &self,
        trajectories: Trajectories<'_>,
        step: &Step,
        Rim { sphere, is_inside, is_start }: Rim,
        samples_left: &mut u32,
    ) -> Result<Option<f64>, Unresolved> {
        let rim = trajectories.course.spheres[sphere].radius;
        let bounds = step.relative[sphere];
        // in units of the step length
        let speed = (self.speed + bounds.speed) * self.h;
        let acceleration = (self.acceleration + bounds.acceleration) * self.h * self.h;

        // distance² − r_e² has the same sign at both ends and is too large for a zero in between: it differs from
        // linear interpolation by at most curvature/8
        let last = self.coefficients.iter().sum::<DVec3>();
        let distance = |node: usize, displacement: DVec3| {
            (step.moments[node].centres[sphere] - self.vertex.rest - displacement).length()
        };
        let (d0, d1) = (distance(0, self.coefficients[0]), distance(3, last));
        let mut gap = Gap {
            samples_left: Cell::new(*samples_left),
            sign: if is_inside { -1.0 } else { 1.0 },
            rim,
            curvature: 2.0 * speed * speed + 2.0 * (d0.max(d1) + speed) * acceleration,
        };
        let (g0, g1) = (gap.of(d0), gap.of(d1));
        if g0.min(g1) > gap.curvature / 8.0 {
            return Ok(None);
        }
        // From zero at the start it is at least t (g₁ − curvature (1 − t)/2): most vertices cross a rim only once in a
        // step.
        if is_start && g1 > gap.curvature / 2.0 {
            return Ok(None);
        }

        // a crossing is where it falls through zero, after multiplication by the sign
        let [a, b, c, d, e, f] = self.coefficients;
        let theta = match trajectories.apart(self.vertex, sphere, self.start, self.h) {
            Apart::Quartic([p, q, r, s, t]) => {
                // the sphere's centre relative to the vertex, as one polynomial
                let (a, b, c, d, e) = (p - a, q - b, r - c, s - d, t - e);
                // the polynomial's own bounds are usually tighter
                let [c2, d2, e2, f2] = [c, d, e, f].map(DVec3::length);
                let speed = b.length() + 2.0 * c2 + 3.0 * d2 + 4.0 * e2 + 5.0 * f2;
                let acceleration = 2.0 * c2 + 6.0 * d2 + 12.0 * e2 + 20.0 * f2;
                let curvature = 2.0 * speed * speed + 2.0 * (d0 + speed) * acceleration;
                gap.curvature = gap.curvature.min(curvature);
                first_fall(&gap, |s| {
                    let position = a + s * (b + s * (c + s * (d + s * (e - s * f))));
                    let velocity = b + s * (2.0 * c + s * (3.0 * d + s * (4.0 * e - s * (5.0 * f))));
                    gap.at(position, velocity)
                })
            }
            Apart::Exact(path) => first_fall(&gap, |s| {
                let displacement = a + s * (b + s * (c + s * (d + s * (e + s * f))));
                let velocity = b + s * (2.0 * c + s * (3.0 * d + s * (4.0 * e + s * (5.0 * f))));
                let (position, motion) = path.at(self.start + s * self.h);
                gap.at(position - displacement, self.h * motion - velocity)
            }),
        };
        *samples_left = gap.samples_left.get();
        if *samples_left == 0 {
            return Err(Unresolved);
        }
        Ok(theta.map(|theta| if theta >= 1.0 { step.end() } else { self.start + theta * self.h }))
    }
}

/// `distance² − r_e²` of a vertex and a sphere over a step, with a sign such that the crossing is a fall through zero.
/// Time runs from 0 to 1 over the step.
struct Gap {
    /// Number of samples that may still be taken.
    samples_left: Cell<u32>,
    sign: f64,
    rim: f64,
    /// Bound on its second derivative.
    curvature: f64,
}

impl Gap {
    fn of(&self, distance: f64) -> f64 {
        self.sign * (distance - self.rim) * (distance + self.rim)
    }

    /// Its value and slope.
    #[inline(always)]
    fn at(&self, apart: DVec3, velocity: DVec3) -> (f64, f64) {
        (self.sign * (apart.length_squared() - self.rim * self.rim), self.sign * (2.0 * apart.dot(velocity)))
    }
}

/// The first fall of a [`Gap`] through zero, given its value and slope.
fn first_fall(gap: &Gap, at: impl Fn(f64) -> (f64, f64)) -> Option<f64> {
    roots::first_fall(&Fall { gap, at }, 0.0, 1.0)
}

/// A [`Gap`] as a function of time, given its value and slope.
struct Fall<'a, F> {
    gap: &'a Gap,
    at: F,
}

impl<F: Fn(f64) -> (f64, f64)> Falling for Fall<'_, F> {
    /// Newton's error after a step is about the square of the step, so after a step this small it is below rounding.
    const LAST_STEP: f64 = 1e-8;

    #[inline(always)]
    fn at(&self, t: f64) -> (f64, f64) {
        (self.at)(t)
    }

    fn sample(&self, start: f64, middle: f64, end: f64) -> Option<Sample> {
        let Gap { samples_left, rim, curvature, .. } = self.gap;
        samples_left.set(samples_left.get().checked_sub(1)?);
        let half = 0.5 * (end - start);
        let (value, slope) = self.at(middle);
        let range = slope.abs() * half + 0.5 * curvature * half * half;
        let close = 1e-13 * rim * rim; // nearer to zero, there is only rounding error
        Some(Sample {
            value,
            slope,
            curvature: *curvature,
            is_clear: value.abs() > range + close,
            is_unresolved: range <= close,
            rounding: 0.0,
            guess: middle - value / slope,
        })
    }
}
