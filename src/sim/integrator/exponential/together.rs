//! Steps the vertices of an active set side by side, and finds those that must be treated individually.

use std::ops::Range;

use glam::DVec3;
use pulp::{Simd, WithSimd};

use super::{
    course::Course,
    step::{Collocated, Group, Pull, Step, has_kink, respond},
};
use crate::sim::{
    numerics::{
        arrays::{Block, Blocks},
        control::SHORTER,
        lanes::{LANES, Mask, Reals, Vector},
    },
    prescribed::deformation::{ActiveSet, REST},
    work::Tally,
};

/// A vertex with |x|² + |u|² below this, in scene units and seconds, is at rest.
const REST_SQUARED: f64 = REST * REST;

/// Work of a step of a vertex, and of each sphere that is examined for it [units].
const EXAMINE: u64 = 2;
/// Work of each sphere that contains the vertex [units].
const PULL: u64 = 24;

/// Data kept from a step of the active set for the groups with a vertex that needs attention. The arrays have room for the
/// padded active set and only grow: values of an earlier step stay where no group is kept.
#[derive(Clone, Debug, Default)]
pub struct Outcomes {
    /// Number of vertices of the padded active set.
    count: usize,
    /// Number of spheres.
    spheres: usize,
    /// Results of the vertices, see [`START`] and the others.
    pub results: Blocks<RESULTS>,
    /// Estimated errors of the displacements [scene unit].
    pub error: Vec<f64>,
    /// For each sphere and vertex: its strength there at the start, 0 outside; only for a weight with a kink.
    inside: Vec<f64>,
    /// 1 for vertices for which this step is not accurate enough or that may cross a rim, otherwise 0.
    pub attention: Vec<f64>,
    /// The groups with at least one vertex that needs attention.
    pub groups: Vec<Range<usize>>,
    /// The largest estimated errors of the other vertices, by lanes [scene unit].
    largest: [f64; LANES],
    /// The number of vertices for which a step of twice the length would not be accurate enough, if it is counted.
    pub near: u64,
}

/// Displacement and velocity at the start in a block of results [scene unit, scene unit/s].
pub const START: [usize; 2] = [0, 1];
/// Forces at the four nodes in a block of results [scene unit/s²].
pub const FORCES: [usize; 4] = [2, 3, 4, 5];
/// Difference of the force in the middle from the cubic through these, in a block of results [scene unit/s²].
pub const BEND: usize = 6;
/// Number of vectors in a block of results.
pub const RESULTS: usize = 7;

impl Outcomes {
    fn resize(&mut self, count: usize, spheres: usize) {
        (self.count, self.spheres) = (count, spheres);
        let Outcomes { results, error, inside, attention, groups, largest, near, .. } = self;
        groups.clear();
        (*largest, *near) = ([0.0; LANES], 0);
        inside.resize(inside.len().max(count * spheres), 0.0);
        if error.len() >= count {
            return; // all are equally long
        }
        results.resize(count);
        error.resize(count, 0.0);
        attention.resize(count, 0.0);
    }

    /// Finds the spheres that contain vertex `i` at the start, one bit each; only for a weight with a kink.
    pub fn inside(&self, i: usize, bits: &mut Vec<u64>) {
        bits.clear();
        for (j, strengths) in self.inside.chunks_exact(self.count).take(self.spheres).enumerate() {
            if j % 64 == 0 {
                bits.push(0);
            }
            bits[j / 64] |= u64::from(strengths[i] != 0.0) << (j % 64);
        }
    }

    /// The largest estimated error of the vertices that need no attention [scene unit].
    pub fn largest_error(&self) -> f64 {
        self.largest.iter().fold(0.0, |largest, &error| largest.max(error))
    }
}

/// One step of all vertices of an active set.
pub struct Together<'a> {
    /// The body's course.
    pub course: &'a Course<'a>,
    /// The step over the whole course.
    pub step: &'a Step,
    /// The vertices; their states become those at the end.
    pub active_set: &'a mut ActiveSet,
    /// The largest acceptable error [scene unit].
    pub wanted: f64,
    /// Bound on the acceleration of a vertex by anything but its oscillator [scene unit/s²].
    pub force: f64,
    /// Whether the step is too long to resolve the oscillation of a vertex.
    pub stiff: bool,
    /// The work budget; once it is exhausted, the rest of the step is not computed.
    pub work: &'a Tally<'a>,
    /// Work that was done but not counted yet.
    pub uncounted: u64,
    /// Whether to count the vertices for which a step of twice the length would not be accurate enough.
    pub count_near: bool,
    /// Buffer, reused.
    pub pulls: &'a mut Vec<Pull>,
    /// Results for the vertices that need attention.
    pub outcomes: &'a mut Outcomes,
}

impl WithSimd for Together<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let count = self.active_set.vertices.len();
        self.outcomes.resize(count.next_multiple_of(LANES), self.course.spheres.len());
        let of_vertex = EXAMINE * (1 + self.course.spheres.len()) as u64;
        for first in (0..count).step_by(Reals::<S, 2>::COUNT) {
            // counted per block and per vertex, so that the work is the same on all instruction sets
            if first.is_multiple_of(LANES) {
                let pulled = std::mem::take(&mut self.uncounted);
                if !self.work.spend(pulled + of_vertex * LANES.min(count - first) as u64) {
                    return;
                }
            }
            self.step_group::<S, 2>(simd, first);
        }
        self.work.spend(self.uncounted);
    }
}

impl Together<'_> {
    /// Steps one group of vertices, from `first` on.
    #[inline(always)]
    fn step_group<S: Simd, const W: usize>(&mut self, simd: S, first: usize) {
        let Together { course, step, ref active_set, .. } = *self;
        let (block, lane) = (first / LANES, first % LANES);
        let [x, u, rest] = &active_set.blocks.all()[block].0;
        let weights = &step.weights;
        let h = step.h;
        let material = course.material;
        let rest = Vector::<S, W>::of_block(simd, rest, lane);
        // (no closure for both, which would be compiled for the baseline instruction set)
        let x = Vector::<S, W>::of_block(simd, x, lane);
        let u = Vector::<S, W>::of_block(simd, u, lane);

        // How far each vertex can move: √(|u|² + ω²|x|²) bounds its speed, and divided by ω its distance from rest.
        let swing = (u.length_squared() + x.length_squared() * (material.omega * material.omega)).sqrt();
        let speed = swing + Reals::splat(simd, self.force * h);
        let travel = (speed * h).smaller(speed * (2.0 / material.omega));
        let local = match course.local {
            Some(local) => Vector::load(simd, local.accelerations, first),
            None => Vector::splat(simd, DVec3::ZERO),
        };
        let [near, passing] = self.find_pulls(simd, first, rest + x, travel);

        let zero = Vector::splat(simd, DVec3::ZERO);
        let end = if self.pulls.is_empty() {
            // as by collocation with the same force at all nodes, so that the result does not depend on the other lanes
            let (last, forces) = (&weights.nodes[3], [local; 4]);
            let x1 = respond(x * last.xx + u * last.xu, &last.force, &forces);
            let u1 = respond(x * weights.ux + u * weights.uu, &weights.velocity, &forces);
            Collocated {
                x: x1,
                u: u1,
                forces,
                bend: zero,
                error: Reals::splat(simd, 0.0),
                bent: Reals::splat(simd, 0.0),
            }
        } else {
            Group { simd, course, step, rest, local, pulls: &*self.pulls }.collocate(x, u, self.wanted)
        };
        let (x1, u1) = (end.x, end.u);
        let mut attention = end.error.at_most(Reals::splat(simd, self.wanted)).negated().or(passing);
        // A vertex with a smaller oscillation has no noticeable effect, and subnormal numbers are slow to compute with.
        // (NaN is kept, to be detected.)
        let rests = (u1.length_squared() + x1.length_squared()).below(Reals::splat(simd, REST_SQUARED));
        let (x1, u1) = (rests.select_vector(zero, x1), rests.select_vector(zero, u1));
        if near.any() && has_kink(course.weight()) {
            attention = attention.or(if self.stiff {
                near
            } else {
                let ends = [rest + x, rest + x1];
                let force = end.forces[0].length_squared().larger(end.forces[3].length_squared()).sqrt();
                may_cross(simd, course, step, ends, swing, force)
            });
        }
        let outcomes = &mut *self.outcomes;
        if self.count_near {
            let mut errors = [0.0; LANES];
            end.bent.store(&mut errors, 0);
            for error in &errors[..Reals::<S, W>::COUNT.min(self.active_set.vertices.len() - first)] {
                outcomes.near += u64::from(!(error * SHORTER <= self.wanted));
            }
        }
        let settled = attention.select(Reals::splat(simd, 0.0), end.error);
        Reals::load(simd, &outcomes.largest, 0).larger(settled).store(&mut outcomes.largest, 0);
        if attention.any() {
            end.error.store(&mut outcomes.error, first);
            attention.select(Reals::splat(simd, 1.0), Reals::splat(simd, 0.0)).store(&mut outcomes.attention, first);
            let results = &mut outcomes.results.all_mut()[block].0;
            x.into_block(&mut results[START[0]], lane);
            u.into_block(&mut results[START[1]], lane);
            for (node, force) in FORCES.into_iter().zip(end.forces) {
                force.into_block(&mut results[node], lane);
            }
            end.bend.into_block(&mut results[BEND], lane);
            outcomes.groups.push(first..first + Reals::<S, W>::COUNT);
        }
        let [x, u, _] = &mut self.active_set.blocks.all_mut()[block].0;
        x1.into_block(x, lane);
        u1.into_block(u, lane);
    }

    /// Finds the spheres that contain the vertices at `position`. Returns the vertices that may cross a rim at which the
    /// force has a kink, and those that may be inside a sphere between the nodes of the step but at none of them.
    #[inline(always)]
    fn find_pulls<S: Simd, const W: usize>(
        &mut self,
        simd: S,
        first: usize,
        position: Vector<S, W>,
        travel: Reals<S, W>,
    ) -> [Mask<S, W>; 2] {
        let Together { course, step, .. } = *self;
        let zero = Reals::splat(simd, 0.0);
        let (mut near, mut passing) = (Mask::none(simd), Mask::none(simd));
        let mut pulled = zero;
        let count = self.outcomes.count;
        self.pulls.clear();
        for (j, sphere) in course.spheres.iter().enumerate() {
            let rim = Reals::splat(simd, sphere.radius);
            let centre = Vector::splat(simd, step.moments[0].centres[j]);
            let distance = (centre - position).length_squared().sqrt();
            let reach = travel + Reals::splat(simd, step.relative[j].speed * step.h);
            // written so that NaN counts as near
            let close = reach.below((distance - rim).abs()).negated();
            let mut pull = Pull { sphere: j, strength: [0.0; LANES], cut: true };
            if has_kink(course.weight()) {
                let inside = distance.below(rim);
                let strength = inside.select(Reals::splat(simd, sphere.strength), zero);
                strength.store(&mut self.outcomes.inside, j * count + first);
                near = near.or(close);
                if !inside.any() {
                    continue;
                }
                pull.cut = false;
                strength.store(&mut pull.strength, 0);
                pulled = pulled + inside.select(Reals::splat(simd, 1.0), zero);
            } else {
                let reached = distance.below(rim).or(close);
                if !reached.any() {
                    continue;
                }
                reached.select(Reals::splat(simd, sphere.strength), zero).store(&mut pull.strength, 0);
                passing = passing.or(reach.at_most(rim).negated().and(reached));
                pulled = pulled + reached.select(Reals::splat(simd, 1.0), zero);
            }
            self.pulls.push(pull);
        }
        if !self.pulls.is_empty() {
            // without the padding, whose size depends on the register width
            let mut of_lanes = [0.0; LANES];
            pulled.store(&mut of_lanes, 0);
            let lanes = Reals::<S, W>::COUNT.min(self.active_set.vertices.len() - first);
            self.uncounted += PULL * of_lanes[..lanes].iter().sum::<f64>() as u64;
        }
        [near, passing]
    }
}

/// The vertices that may cross a rim between two positions, at the ends of a step. The squared distance to a centre
/// minus r_e² differs from linear interpolation between its end values by at most its curvature times h²/8: if both end
/// values have the same sign and are larger than that, there is no crossing.
#[inline(always)]
fn may_cross<S: Simd, const W: usize>(
    simd: S,
    course: &Course<'_>,
    step: &Step,
    [start, end]: [Vector<S, W>; 2],
    swing: Reals<S, W>,
    force: Reals<S, W>,
) -> Mask<S, W> {
    let h = step.h;
    let material = course.material;
    let zero = Reals::splat(simd, 0.0);
    let own_speed = swing + force * h;
    let own_acceleration = own_speed * (material.omega + 2.0 * material.damping) + force;
    let mut crossing = Mask::none(simd);
    for j in 0..course.spheres.len() {
        let (rim, relative) = (Reals::splat(simd, course.spheres[j].radius), step.relative[j]);
        let d0 = (Vector::splat(simd, step.moments[0].centres[j]) - start).length_squared().sqrt();
        let d1 = (Vector::splat(simd, step.moments[3].centres[j]) - end).length_squared().sqrt();
        let speed = own_speed + Reals::splat(simd, relative.speed);
        let acceleration = own_acceleration + Reals::splat(simd, relative.acceleration);
        let curvature = (speed * speed + (d0.larger(d1) + speed * h) * acceleration) * 2.0;
        let (g0, g1) = ((d0 - rim) * (d0 + rim), (d1 - rim) * (d1 + rim));
        let (outside, inside) = (g0.smaller(g1), (zero - g0).smaller(zero - g1));
        let clear = (curvature * (h * h / 8.0)).below(outside.larger(inside));
        crossing = crossing.or(clear.negated());
    }
    crossing
}

/// The largest |x|² and |u|² + ω²|x|² of an active set; NaN if any value is NaN.
pub struct Largest<'a> {
    /// The vertices.
    pub active_set: &'a ActiveSet,
    /// ω² [1/s²].
    pub omega_squared: f64,
}

impl WithSimd for Largest<'_> {
    type Output = [f64; 2];

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> [f64; 2] {
        let zero = Reals::<S, 2>::splat(simd, 0.0);
        let (mut x2, mut m2) = (zero, zero);
        let ActiveSet { vertices, blocks } = self.active_set;
        for (Block([x, u, _]), vertices) in blocks.all().iter().zip(vertices.chunks(LANES)) {
            // the padding lanes were not advanced
            for lane in (0..vertices.len()).step_by(Reals::<S, 2>::COUNT) {
                let x = Vector::<S, 2>::of_block(simd, x, lane).length_squared();
                let u = Vector::<S, 2>::of_block(simd, u, lane).length_squared();
                let m = u + x * self.omega_squared;
                (x2, m2) = (x2.larger_or_nan(x), m2.larger_or_nan(m));
            }
        }
        let mut largest = [0.0; 2];
        for (largest, lanes) in largest.iter_mut().zip([x2, m2]) {
            let mut array = [0.0; LANES];
            lanes.store(&mut array, 0);
            for value in array {
                *largest = if value > *largest || value.is_nan() { value } else { *largest };
            }
        }
        largest
    }
}
