//! Vertices that cross rims within a step, several side by side: each in parts of its own length.
//!
//! This is the usual case, at the cost of arithmetic in lanes only: the step is short enough for [`series`], spheres move
//! along the step's quartics, and rest positions are constant. A vertex that turns out to be unusual (a distance to a rim
//! that does not just fall, a part that is not accurate enough) is left to [`single`](super::single), which does the same for
//! any step.

use glam::DVec3;
use pulp::{Simd, WithSimd};

use super::{
    course::Course,
    lanes::{LANES, Mask, Reals, Vector},
    series::{LONGEST, Series, weigh},
    step::{LEFT_OUT, MAX_SWEEPS, SMOOTHNESS, Step, UNSETTLED, has_kink, left_out, usual},
    together::{Outcomes, RESULTS},
    weights::{ASIDE, BEND_ASIDE, Polynomials, SKEW_ASIDE, quartic_through},
    work_of,
};
use crate::{
    scene::Material,
    sim::{arrays, deformation::ActiveSet, nodes::SAMPLES, work::Tally},
};

/// A vertex whose step has more parts is unusual.
const MAX_PARTS: usize = 4;
/// A root that needs more Newton steps is unusual.
const MAX_NEWTON: usize = 6;
/// A Newton step of this size or smaller is the last, as a fraction of the part. The error after it is about its square,
/// and since the force is zero at the rim, only the square of that error has an effect.
const LAST_STEP: f64 = 1e-4;
/// Index of the sample at [`ASIDE`].
const ASIDE_LOOK: usize = 5;
/// The number of each lane.
const NUMBERS: [f64; LANES] = {
    let mut numbers = [0.0; LANES];
    let mut lane = 0;
    while lane < LANES {
        numbers[lane] = lane as f64;
        lane += 1;
    }
    numbers
};
/// Work of a vertex apart from that of its forces.
const VERTEX: u64 = 40;

/// Buffers, reused from step to step.
#[derive(Default)]
pub struct Scratch {
    /// The vertices to be stepped, as indices in the active set.
    pending: Vec<usize>,
    /// For each sphere, the coefficients of its path relative to the body, in the time over the step's length.
    paths: Vec<[DVec3; 5]>,
    /// For each sphere, its strength on each vertex; 0 where the vertex is outside of it.
    strengths: Vec<[f64; LANES]>,
    /// The spheres that contain any of the vertices.
    pulls: Vec<usize>,
    /// Their centres at each of a part's samples.
    centres: Vec<[arrays::Lanes; 6]>,
    /// The whole step's results for the vertices, …
    results: [arrays::Lanes; RESULTS],
    /// … displacement and velocity at its end, rest position, …
    ends: [arrays::Lanes; 3],
    /// … the estimated errors [scene unit], …
    errors: [f64; LANES],
    /// … and the number of parts beyond the first, negative for a vertex that is unusual.
    parts: [f64; LANES],
}

/// Steps vertices side by side through an interval in which they cross rims.
pub struct Crossings<'a> {
    /// The body's course.
    pub course: &'a Course<'a>,
    /// The step over the whole interval.
    pub whole: &'a Step,
    /// The largest acceptable error per unit of time [scene unit/s].
    pub tolerance: f64,
    /// The vertices; the states of those that are stepped here become those at the end.
    pub active_set: &'a mut ActiveSet,
    /// The whole step's results for the vertices that need attention. Those that are stepped here no longer do.
    pub outcomes: &'a mut Outcomes,
    /// The work budget; once it is exhausted, the rest of the step is not computed.
    pub work: &'a Tally<'a>,
    /// Buffers.
    pub scratch: &'a mut Scratch,
}

/// What [`Crossings`] did.
#[derive(Clone, Copy, Debug, Default)]
pub struct Crossed {
    /// Number of steps beyond the first of each vertex.
    pub substeps: u64,
    /// The largest sum of estimated errors of a vertex [scene unit].
    pub error: f64,
}

/// Whether a step may be usual for any vertex.
pub fn is_usual(course: &Course<'_>, whole: &Step) -> bool {
    let Material { omega, damping, .. } = course.material;
    let is_short = (omega + 2.0 * damping) * whole.h <= LONGEST;
    has_kink(course.weight()) && is_short && whole.smooth && course.weighted.is_empty() && course.local.is_none()
}

impl WithSimd for Crossings<'_> {
    type Output = Crossed;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Crossed {
        let Crossings { course, whole, tolerance, active_set, outcomes, work, scratch } = self;
        let count = active_set.vertices.len();
        let wanted = tolerance * whole.h;
        let mut pending = std::mem::take(&mut scratch.pending);
        pending.clear();
        for group in &outcomes.groups {
            for i in group.start..group.end.min(count) {
                if outcomes.attention[i] != 0.0 && outcomes.error[i] <= wanted {
                    pending.push(i);
                }
            }
        }
        let of_vertex = VERTEX + 2 * work_of(1, course.spheres.len(), 0);
        let mut crossed = Crossed::default();
        if work.spend(of_vertex * pending.len() as u64) && !pending.is_empty() {
            scratch.paths.clear();
            for j in 0..course.spheres.len() {
                let mut known = [DVec3::ZERO; 5];
                for (known, moment) in known.iter_mut().zip(&whole.moments) {
                    *known = moment.centres[j];
                }
                scratch.paths.push(quartic_through(&known));
            }
            scratch.strengths.resize(course.spheres.len(), [0.0; LANES]);
            scratch.centres.resize(course.spheres.len(), [[[0.0; LANES]; 3]; 6]);
            let series = Series::new(course.oscillator(), whole.h);
            let polynomials = Polynomials::get();
            for vertices in pending.chunks(Reals::<S, 1>::COUNT) {
                gather::<S>(course, active_set, outcomes, vertices, scratch);
                let batch = Batch { simd, course, whole, tolerance, series: &series, polynomials: &polynomials };
                let Ends { x, u, error, parts, is_usual } = batch.step(scratch, vertices.len());
                let [ends, others, _] = &mut scratch.ends;
                x.into_block(ends, 0);
                u.into_block(others, 0);
                error.store(&mut scratch.errors, 0);
                let unusual = Reals::splat(simd, -1.0);
                is_usual.select(parts, unusual).store(&mut scratch.parts, 0);
                for (lane, &i) in vertices.iter().enumerate() {
                    if scratch.parts[lane] < 0.0 {
                        continue;
                    }
                    let block = &mut active_set.blocks.all_mut()[i / LANES].0;
                    for (to, from) in block.iter_mut().zip(&scratch.ends) {
                        for axis in 0..3 {
                            to[axis][i % LANES] = from[axis][lane];
                        }
                    }
                    outcomes.attention[i] = 0.0;
                    crossed.substeps += scratch.parts[lane] as u64;
                    crossed.error = crossed.error.max(scratch.errors[lane]);
                }
            }
        }
        scratch.pending = pending;
        crossed
    }
}

/// Copies what is known of `vertices` to the buffers. The lanes that are left keep what was there.
#[inline(always)]
fn gather<S: Simd>(
    course: &Course<'_>,
    active_set: &ActiveSet,
    outcomes: &Outcomes,
    vertices: &[usize],
    scratch: &mut Scratch,
) {
    for (lane, &i) in vertices.iter().enumerate().take(Reals::<S, 1>::COUNT) {
        scratch.errors[lane] = outcomes.error[i];
        let results = &outcomes.results.all()[i / LANES].0;
        let ends = &active_set.blocks.all()[i / LANES].0;
        for (to, from) in scratch.results.iter_mut().zip(results) {
            for axis in 0..3 {
                to[axis][lane] = from[axis][i % LANES];
            }
        }
        for (to, from) in scratch.ends.iter_mut().zip(ends) {
            for axis in 0..3 {
                to[axis][lane] = from[axis][i % LANES];
            }
        }
        for (j, strengths) in scratch.strengths[..course.spheres.len()].iter_mut().enumerate() {
            strengths[lane] = outcomes.strength(j, i);
        }
    }
}

/// Vertices whose steps are taken side by side.
struct Batch<'a, S: Simd> {
    simd: S,
    course: &'a Course<'a>,
    whole: &'a Step,
    tolerance: f64,
    series: &'a Series,
    polynomials: &'a Polynomials,
}

/// The results of a batch.
struct Ends<S: Simd> {
    /// Displacement at the end.
    x: Vector<S, 1>,
    /// Velocity at the end.
    u: Vector<S, 1>,
    /// Sum of the estimated errors of the parts.
    error: Reals<S, 1>,
    /// Number of parts beyond the first.
    parts: Reals<S, 1>,
    /// Whether the vertex is not left to [`single`](super::single).
    is_usual: Mask<S, 1>,
}

/// A part of a step that extends to the end of the step, and the motion of vertices in it.
#[derive(Clone, Copy)]
struct Part<S: Simd> {
    /// Whether it is the whole step.
    is_whole: bool,
    /// Its start, as a fraction of the step.
    from: Reals<S, 1>,
    /// Its length, as a fraction of the step.
    share: Reals<S, 1>,
    /// Displacement and velocity at its start …
    start: [Vector<S, 1>; 2],
    /// … and at its end.
    end: [Vector<S, 1>; 2],
    /// Forces at its nodes [scene unit/s²].
    forces: [Vector<S, 1>; 4],
    /// Difference of the force in the middle from the cubic through these [scene unit/s²].
    bend: Vector<S, 1>,
    /// Estimated error of the displacement [scene unit].
    error: Reals<S, 1>,
}

/// The first crossings in a part.
struct First<S: Simd> {
    /// The time, as a fraction of the part; at least 1 without a crossing.
    time: Reals<S, 1>,
    /// The index of the sphere.
    sphere: Reals<S, 1>,
    /// The vertices for which this could not be determined.
    is_unknown: Mask<S, 1>,
}

/// True in lanes that are equal.
#[inline(always)]
fn equal<S: Simd>(a: Reals<S, 1>, b: Reals<S, 1>) -> Mask<S, 1> {
    a.at_most(b).and(b.at_most(a))
}

/// The polynomial with these coefficients at `t`.
#[inline(always)]
fn polynomial<S: Simd, const N: usize>(coefficients: &[Vector<S, 1>; N], t: Reals<S, 1>) -> Vector<S, 1> {
    let mut value = coefficients[N - 1];
    for &coefficient in coefficients[..N - 1].iter().rev() {
        value = value * t + coefficient;
    }
    value
}

/// `Σ wᵢ fᵢ` over the first `N` nodes.
#[inline(always)]
fn sum<S: Simd, const N: usize>(w: &[Reals<S, 1>; 4], f: &[Vector<S, 1>; 4]) -> Vector<S, 1> {
    let mut sum = f[0] * w[0];
    for i in 1..N {
        sum = sum + f[i] * w[i];
    }
    sum
}

impl<S: Simd> Batch<'_, S> {
    /// Steps the gathered vertices, in the first `count` lanes, to the end of the interval.
    #[inline(always)]
    fn step(&self, scratch: &mut Scratch, count: usize) -> Ends<S> {
        let simd = self.simd;
        let mut known = [zero_vector(simd); RESULTS];
        for (known, lanes) in known.iter_mut().zip(&scratch.results) {
            *known = Vector::of_block(simd, lanes, 0);
        }
        let [x0, u0, f0, f1, f2, f3, bend] = known;
        let [x1, u1, rest] = &scratch.ends;
        let [x1, u1] = [Vector::of_block(simd, x1, 0), Vector::of_block(simd, u1, 0)];
        let rest = Vector::of_block(simd, rest, 0);
        let (zero, one) = (Reals::splat(simd, 0.0), Reals::splat(simd, 1.0));
        let mut part = Part {
            is_whole: true,
            from: zero,
            share: one,
            start: [x0, u0],
            end: [x1, u1],
            forces: [f0, f1, f2, f3],
            bend,
            error: Reals::load(simd, &scratch.errors, 0),
        };
        let mut ends = Ends { x: part.end[0], u: part.end[1], error: zero, parts: zero, is_usual: zero.below(zero) };
        // what happens in other lanes is ignored, and starts no further work
        let mut pending = Reals::load(simd, &NUMBERS, 0).below(Reals::splat(simd, count as f64));
        // the sphere at whose rim a part starts
        let mut crossed = Reals::splat(simd, -1.0);
        self.find_pulls(scratch, pending);
        for _ in 0..MAX_PARTS {
            ends.error = pending.select(ends.error + part.error, ends.error);
            let First { time, sphere, is_unknown } = self.first_crossing(scratch, &part, rest, (crossed, pending));
            pending = pending.and(is_unknown.negated());
            let from = part.from + part.share * time;
            let is_crossing = time.below(one).and(from.below(one)).and(pending);
            let is_complete = pending.and(is_crossing.negated());
            ends.x = is_complete.select_vector(part.end[0], ends.x);
            ends.u = is_complete.select_vector(part.end[1], ends.u);
            ends.is_usual = ends.is_usual.or(is_complete);
            pending = is_crossing;
            if !pending.any() {
                break;
            }
            part.start = self.within(scratch, &part, rest, time);
            (part.is_whole, part.from, part.share) = (false, from, one - from);
            crossed = sphere;
            ends.parts = pending.select(ends.parts + one, ends.parts);
            for j in 0..self.course.spheres.len() {
                let strength = Reals::load(simd, &scratch.strengths[j], 0);
                let other = Reals::splat(simd, self.course.spheres[j].strength) - strength;
                let is_crossed = equal(sphere, Reals::splat(simd, j as f64)).and(pending);
                is_crossed.select(other, strength).store(&mut scratch.strengths[j], 0);
            }
            self.find_pulls(scratch, pending);
            if scratch.pulls.is_empty() {
                self.flow(&mut part);
            } else {
                self.collocate(scratch, &mut part, rest, pending);
            }
            let is_accurate = part.error.at_most(part.share * (self.tolerance * self.whole.h));
            pending = pending.and(is_accurate);
        }
        ends
    }

    /// Finds the spheres that contain any of the vertices that are `pending`.
    #[inline(always)]
    fn find_pulls(&self, scratch: &mut Scratch, pending: Mask<S, 1>) {
        let zero = Reals::<S, 1>::splat(self.simd, 0.0);
        scratch.pulls.clear();
        for (j, strength) in scratch.strengths[..self.course.spheres.len()].iter().enumerate() {
            if zero.below(Reals::load(self.simd, strength, 0).abs()).and(pending).any() {
                scratch.pulls.push(j);
            }
        }
    }

    /// The centre of a sphere at `theta` of the step.
    #[inline(always)]
    fn centre(&self, path: &[DVec3; 5], theta: Reals<S, 1>) -> Vector<S, 1> {
        let mut centre = Vector::splat(self.simd, path[4]);
        for &coefficient in path[..4].iter().rev() {
            centre = centre * theta + Vector::splat(self.simd, coefficient);
        }
        centre
    }

    /// The centre of a sphere relative to each vertex in a part, as coefficients in the time over that of the part. The
    /// motion of a vertex is interpolated by the quintic that matches displacement, velocity and acceleration at both ends.
    #[inline(always)]
    fn apart(&self, path: &[DVec3; 5], part: &Part<S>, rest: Vector<S, 1>) -> [Vector<S, 1>; 6] {
        let Material { omega, damping, .. } = self.course.material;
        let ([x0, u0], [x1, u1]) = (part.start, part.end);
        let h = part.share * self.whole.h;
        let square = h * h;
        let (v0, v1) = (u0 * h, u1 * h);
        let a0 = (part.forces[0] - x0 * (omega * omega) - u0 * (2.0 * damping)) * square;
        let a1 = (part.forces[3] - x1 * (omega * omega) - u1 * (2.0 * damping)) * square;
        let (d, v, a) = (x1 - x0 - v0 - a0 * 0.5, v1 - v0 - a0, (a1 - a0) * 0.5);
        let own =
            [rest + x0, v0, a0 * 0.5, d * 10.0 - v * 4.0 + a, v * 7.0 - d * 15.0 - a * 2.0, d * 6.0 - v * 3.0 + a];

        let mut c = [zero_vector(self.simd); 6];
        for k in 0..5 {
            c[k] = Vector::splat(self.simd, path[k]);
        }
        if part.is_whole {
            for k in 0..6 {
                c[k] = c[k] - own[k];
            }
            return c;
        }
        // the same polynomial in the time of the part: shifted (Horner) and rescaled
        for low in 0..4 {
            for k in (low..4).rev() {
                c[k] = c[k] + c[k + 1] * part.from;
            }
        }
        let mut power = part.share;
        c[0] = c[0] - own[0];
        for k in 1..6 {
            c[k] = c[k] * power - own[k];
            power = power * part.share;
        }
        c
    }

    /// Difference of the force at [`ASIDE`] of a part from the quartic through those at the nodes and in the middle
    /// [scene unit/s²].
    #[inline(always)]
    fn skew(&self, scratch: &mut Scratch, part: &Part<S>, rest: Vector<S, 1>) -> Vector<S, 1> {
        let (simd, polynomials, forces) = (self.simd, self.polynomials, &part.forces);
        let [x, u] = part.start;
        let response = self.series.over(simd, part.share * ASIDE);
        let scale = response.t * response.t;
        let weights = weigh::<S, 4>(&response.displacements(), &polynomials.samples[ASIDE_LOOK - 1], scale);
        for &j in &scratch.pulls {
            let centre = self.centre(&scratch.paths[j], part.from + part.share * ASIDE);
            centre.into_block(&mut scratch.centres[j][ASIDE_LOOK], 0);
        }
        let position = rest + response.displaced(simd, x, u) + sum::<S, 4>(&weights, forces);
        let found = self.force(scratch, ASIDE_LOOK, position);
        let w = polynomials.aside;
        let cubic = (forces[0] * w[0] + forces[1] * w[1]) + (forces[2] * w[2] + forces[3] * w[3]);
        found - cubic - part.bend * BEND_ASIDE
    }

    /// The state at `time`, as a fraction of a part, with the response to the [`Residual`](super::weights::Residual).
    #[inline(always)]
    fn within(
        &self,
        scratch: &mut Scratch,
        part: &Part<S>,
        rest: Vector<S, 1>,
        time: Reals<S, 1>,
    ) -> [Vector<S, 1>; 2] {
        let simd = self.simd;
        let [x, u] = part.start;
        let response = self.series.over(simd, part.share * time);
        let flow = [response.displaced(simd, x, u), response.velocity(x, u)];
        if scratch.pulls.is_empty() {
            return self.plus_zero(flow);
        }
        let mut powers = [time; 4];
        for k in 1..4 {
            powers[k] = powers[k - 1] * time;
        }
        let mut displacements = response.displacements();
        let mut velocities = response.velocities();
        for k in 1..4 {
            displacements[k] = displacements[k] * powers[k - 1];
            velocities[k] = velocities[k] * powers[k - 1];
        }
        let t = response.t;
        let of_displacement = weigh::<S, 4>(&displacements, self.polynomials.whole, t * t);
        let of_velocity = weigh::<S, 4>(&velocities, self.polynomials.whole, t);
        // the responses to q and to (θ − ½) q; the k-th power comes with its k!
        let fifth = powers[3] * time;
        let q_x = (powers[3] * response.j[6] * 24.0 - displacements[3] * 12.0)
            + (displacements[2] * 2.4 - displacements[1] * 0.2);
        let q_u =
            (powers[3] * response.j[5] * 24.0 - velocities[3] * 12.0) + (velocities[2] * 2.4 - velocities[1] * 0.2);
        let skewed = (fifth * response.j[6] * 120.0 - powers[3] * response.j[5] * 60.0)
            + (velocities[3] * 13.2 - velocities[2] * 1.6)
            + velocities[1] * 0.1;
        let skew = self.skew(scratch, part, rest);
        [
            flow[0] + sum::<S, 4>(&of_displacement, &part.forces) + part.bend * (q_x * (t * t) * 80.0),
            flow[1]
                + sum::<S, 4>(&of_velocity, &part.forces)
                + part.bend * (q_u * t * 80.0)
                + skew * (skewed * t * (80.0 / SKEW_ASIDE)),
        ]
    }

    /// The first crossing of a rim in a part, for `pending` vertices, which start from the rim of sphere `crossed`, if any.
    ///
    /// The motion is interpolated by the quintic that matches displacement, velocity and acceleration at both ends;
    /// bounds and tests are those of [`rim`](super::rim).
    #[inline(always)]
    fn first_crossing(
        &self,
        scratch: &Scratch,
        part: &Part<S>,
        rest: Vector<S, 1>,
        (crossed, pending): (Reals<S, 1>, Mask<S, 1>),
    ) -> First<S> {
        let simd = self.simd;
        let (zero, one) = (Reals::splat(simd, 0.0), Reals::splat(simd, 1.0));
        let Material { omega, damping, .. } = self.course.material;
        let h = part.share * self.whole.h;
        let ([x0, u0], [x1, _]) = (part.start, part.end);
        let force = part.forces[0].length_squared().larger(part.forces[3].length_squared()).sqrt();
        let momentum = (u0.length_squared() + x0.length_squared() * (omega * omega)).sqrt() + force * h;
        let acceleration = momentum * (omega + 2.0 * damping) + force;
        let (from, to) = (rest + x0, rest + x1);
        let square = h * h;

        let mut first =
            First { time: Reals::splat(simd, 2.0), sphere: Reals::splat(simd, -1.0), is_unknown: one.below(zero) };
        for j in 0..self.course.spheres.len() {
            let path = &scratch.paths[j];
            let (rim, relative) = (self.course.spheres[j].radius, self.whole.relative[j]);
            let strength = Reals::load(simd, &scratch.strengths[j], 0);
            let sign = zero.below(strength.abs()).select(zero - one, one);
            let rim = Reals::splat(simd, rim);
            let d0 = (self.centre(path, part.from) - from).length_squared().sqrt();
            let d1 = (Vector::splat(simd, self.whole.moments[3].centres[j]) - to).length_squared().sqrt();
            let (g0, g1) = (sign * (d0 - rim) * (d0 + rim), sign * (d1 - rim) * (d1 + rim));
            let speed = (momentum + Reals::splat(simd, relative.speed)) * h;
            let faster = (acceleration + Reals::splat(simd, relative.acceleration)) * square;
            let mut curvature = (speed * speed + (d0.larger(d1) + speed) * faster) * 2.0;
            let starts_there = equal(crossed, Reals::splat(simd, j as f64));
            let is_clear = (curvature * 0.125).below(g0.smaller(g1)).or(starts_there.and((curvature * 0.5).below(g1)));
            if !is_clear.negated().and(pending).any() {
                continue;
            }

            let c = self.apart(path, part, rest);
            let mut length = [zero; 6];
            for k in 1..6 {
                length[k] = c[k].length_squared().sqrt();
            }
            let speed = length[1] + length[2] * 2.0 + length[3] * 3.0 + length[4] * 4.0 + length[5] * 5.0;
            let faster = length[2] * 2.0 + length[3] * 6.0 + length[4] * 12.0 + length[5] * 20.0;
            curvature = curvature.smaller((speed * speed + (d0 + speed) * faster) * 2.0);
            let is_clear = is_clear
                .or((curvature * 0.125).below(g0.smaller(g1)))
                .or(starts_there.and((curvature * 0.5).below(g1)));

            let slopes = [c[1], c[2] * 2.0, c[3] * 3.0, c[4] * 4.0, c[5] * 5.0];
            let radius_squared = rim * rim;
            let mut t = Reals::splat(simd, 0.5);
            let (position, velocity) = (polynomial(&c, t), polynomial(&slopes, t));
            let value = sign * (position.length_squared() - radius_squared);
            let slope = sign * position.dot(velocity) * 2.0;
            // the slope does not change sign: at most one root
            let is_falling = slope.below(zero - curvature * 0.5);
            let is_rising = (curvature * 0.5).below(slope);
            let is_above = zero.below(g0);
            let is_clear = is_clear.or(is_above.and(is_rising.or(is_falling.and(zero.below(g1)))));
            let has_root = is_above.and(is_falling).and(g1.at_most(zero)).and(is_clear.negated());
            first.is_unknown = first.is_unknown.or(is_clear.or(has_root).negated());
            if !has_root.and(pending).any() {
                continue;
            }

            t = zero.larger(one.smaller(t - value / slope));
            let mut is_found = has_root.and(pending).negated();
            for _ in 0..MAX_NEWTON {
                let (position, velocity) = (polynomial(&c, t), polynomial(&slopes, t));
                let value = position.length_squared() - radius_squared;
                let next = t - value / (position.dot(velocity) * 2.0);
                let is_last = (next - t).abs().at_most(Reals::splat(simd, LAST_STEP));
                t = is_found.select(t, zero.larger(one.smaller(next)));
                is_found = is_found.or(is_last);
                if !is_found.negated().any() {
                    break;
                }
            }
            first.is_unknown = first.is_unknown.or(has_root.and(is_found.negated()));
            let is_first = has_root.and(t.below(first.time));
            first.time = is_first.select(t, first.time);
            first.sphere = is_first.select(Reals::splat(simd, j as f64), first.sphere);
        }
        first
    }

    /// The force on each vertex for displacement `x` at a sample of a part [scene unit/s²].
    #[inline(always)]
    fn force(&self, scratch: &Scratch, look: usize, position: Vector<S, 1>) -> Vector<S, 1> {
        let mut force = zero_vector(self.simd);
        let one = Reals::splat(self.simd, 1.0);
        for &j in &scratch.pulls {
            let to_centre = Vector::of_block(self.simd, &scratch.centres[j][look], 0) - position;
            let z = to_centre.length_squared().sqrt() * self.course.spheres[j].inverse_radius;
            let strength = Reals::load(self.simd, &scratch.strengths[j], 0);
            force = force + to_centre * (strength * (one - z)); // (3.3)
        }
        force
    }

    /// Adds the effect of no force, which makes zeros positive, as in lanes beside vertices on which forces act.
    #[inline(always)]
    fn plus_zero(&self, [x, u]: [Vector<S, 1>; 2]) -> [Vector<S, 1>; 2] {
        let zero = zero_vector(self.simd);
        [x + zero, u + zero]
    }

    /// Takes the step over a part, from its start, for vertices on which nothing acts.
    #[inline(always)]
    fn flow(&self, part: &mut Part<S>) {
        let zero = zero_vector(self.simd);
        let response = self.series.over(self.simd, part.share);
        let [x, u] = part.start;
        part.end = self.plus_zero([response.displaced(self.simd, x, u), response.velocity(x, u)]);
        (part.forces, part.bend, part.error) = ([zero; 4], zero, zero.x);
    }

    /// Takes the step over a part, from its start; see [`Group::collocate`](super::step::Group::collocate).
    #[inline(always)]
    fn collocate(&self, scratch: &mut Scratch, part: &mut Part<S>, rest: Vector<S, 1>, pending: Mask<S, 1>) {
        let (simd, polynomials) = (self.simd, self.polynomials);
        let [x, u] = part.start;
        let (zero, one) = (Reals::splat(simd, 0.0), Reals::splat(simd, 1.0));
        let nothing = zero_vector(simd);
        for look in 0..5 {
            let theta = part.from + part.share * SAMPLES[look];
            for &j in &scratch.pulls {
                let centre = self.centre(&scratch.paths[j], theta);
                centre.into_block(&mut scratch.centres[j][look], 0);
            }
        }
        // position without the forces, and the weights of the forces, at each sample but the first
        let last = self.series.over(simd, part.share);
        let mut flow = [nothing; 4];
        let mut weights = [[zero; 4]; 4];
        let mut before = [[zero; 4]; 3];
        for look in [1, 2, 4, 3] {
            let response = if look == 3 { last } else { self.series.over(simd, part.share * SAMPLES[look]) };
            let powers = response.displacements();
            let scale = response.t * response.t;
            flow[look - 1] = rest + response.displaced(simd, x, u);
            weights[look - 1] = weigh::<S, 4>(&powers, &polynomials.samples[look - 1], scale);
            match look {
                1 => before[0] = weigh::<S, 1>(&powers, &polynomials.before[0], scale),
                2 => before[1] = weigh::<S, 2>(&powers, &polynomials.before[1], scale),
                3 => before[2] = weigh::<S, 3>(&powers, &polynomials.before[2], scale),
                _ => {}
            }
        }

        let mut forces = [self.force(scratch, 0, rest + x), nothing, nothing, nothing];
        forces[1] = self.force(scratch, 1, flow[0] + sum::<S, 1>(&before[0], &forces));
        forces[2] = self.force(scratch, 2, flow[1] + sum::<S, 2>(&before[1], &forces));
        forces[3] = self.force(scratch, 3, flow[2] + sum::<S, 3>(&before[2], &forces));
        let mut stiffness = zero;
        for &j in &scratch.pulls {
            stiffness = stiffness + Reals::load(simd, &scratch.strengths[j], 0).abs();
        }
        let Material { omega, damping, .. } = self.course.material;
        let h = last.t;
        let wanted = h * self.tolerance;
        let constant = (h * h) * last.j[2];
        let gain = constant + h * self.whole.weights.swing;
        let left = stiffness * constant * (gain * UNSETTLED);
        let enough = wanted * 0.25;
        let mut unsettled = Reals::splat(simd, f64::INFINITY);
        let mut settled = pending.negated();
        for _ in 0..MAX_SWEEPS {
            let mut change = zero;
            for node in 1..4 {
                let position = flow[node - 1] + sum::<S, 4>(&weights[node - 1], &forces);
                let corrected = self.force(scratch, node, position);
                change = change.larger_or_nan((corrected - forces[node]).length_squared());
                forces[node] = settled.select_vector(forces[node], corrected);
            }
            unsettled = settled.select(unsettled, left * change.sqrt());
            settled = settled.or(unsettled.at_most(enough));
            if !settled.negated().any() {
                break;
            }
        }

        let found = self.force(scratch, 4, flow[3] + sum::<S, 4>(&weights[3], &forces));
        let cubic = polynomials.middle;
        let cubic = (forces[0] * cubic[0] + forces[1] * cubic[1]) + (forces[2] * cubic[2] + forces[3] * cubic[3]);
        part.bend = found - cubic;
        part.forces = forces;
        let displaced = sum::<S, 4>(&weights[2], &forces);
        let of_velocity = weigh::<S, 4>(&last.velocities(), polynomials.whole, h);
        part.end = [last.displaced(simd, x, u) + displaced, last.velocity(x, u) + sum::<S, 4>(&of_velocity, &forces)];

        // the error, as in `Group::collocate`, where that needs no sample aside
        let mut passed = zero;
        let mut pulled = zero;
        let max_pull = self.course.weight().max_pull();
        for &j in &scratch.pulls {
            let sphere = &self.course.spheres[j];
            let strength = Reals::load(simd, &scratch.strengths[j], 0).abs();
            let [start, _, _, end, ..] = &scratch.centres[j];
            let moved = Vector::of_block(simd, end, 0) - Vector::of_block(simd, start, 0);
            let way = moved - (part.end[0] - x);
            let way = (way.x.abs() + way.y.abs() + way.z.abs()) * sphere.inverse_radius;
            passed = passed.larger(zero.below(strength).select(way, zero));
            pulled = pulled + strength * (sphere.radius * max_pull);
        }
        let scales = (stiffness.sqrt() + Reals::splat(simd, omega + 2.0 * damping)) * h;
        let roughness = ((passed + scales) * SMOOTHNESS).smaller(one);
        let noise = Reals::splat(simd, self.whole.noise);
        let bent = zero.larger_or_nan(part.bend.length_squared().sqrt() - noise);
        let mut effect = bent * roughness * gain * 0.1;
        let expected = pulled * ((scales * scales) * (scales * scales)) * scales * h * usual(self.course, 1.0);
        let needs_more = one.below(scales).or(wanted.below(effect * 4.0).and(wanted.below(expected)));
        if needs_more.and(pending).any() {
            let skew = self.skew(scratch, part, rest).length_squared().sqrt() - noise;
            let skew = zero.larger_or_nan(skew);
            let all = left_out(simd, self.course.material, h, stiffness, [bent, skew]);
            effect = needs_more.select(all * gain, effect);
        }
        part.error = unsettled + effect * LEFT_OUT;
    }
}

#[inline(always)]
fn zero_vector<S: Simd>(simd: S) -> Vector<S, 1> {
    Vector::splat(simd, DVec3::ZERO)
}
