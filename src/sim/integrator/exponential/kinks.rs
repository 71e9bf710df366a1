//! What a step leaves out where the force has a kink between its samples.
//!
//! The force of the linear weight contains `|d| d`, whose second derivative jumps at the centre of the sphere; that of the
//! Wendland weight contains `|d|³ d`, and ends at the rim like the fourth power of the distance from it. A vertex that
//! passes such a place leaves a residual that the samples of the step may not show, and that is not smooth enough for the
//! estimates of [`Group::collocate`](super::step::Group::collocate). It is bounded here, wherever in the step the kink is.
//! (The linear weight's kink at the rim is larger; steps end there.)

use glam::DVec3;
use pulp::Simd;

use super::{
    course::Course,
    step::{Step, Vertex},
};
use crate::{
    model::influence::Weight,
    sim::{
        numerics::{
            lanes::{Mask, Reals},
            nodes::NODES,
        },
        state::State,
        terms::Sphere,
    },
};

/// The largest mean residual of the cubic through the nodes for `|t| t`.
const SQUARE: f64 = 3.7e-3;
/// The same for `|t|³ t`.
const FOURTH: f64 = 4.25e-4;
/// The same for the fourth power of t where t is positive, t being the time from the kink over the length of the step.
const HALF_FOURTH: f64 = 2.13e-4;
/// Factor from the bound on the error to the usual error: passages at the worst time of a step are rare.
const USUAL: f64 = 0.5;
/// Errors smaller than this part of the acceptable one need not be computed.
const NEGLIGIBLE: f64 = 0.5;

/// Decides for which vertices [`error`] may matter, by little arithmetic.
#[derive(Clone, Copy, Debug)]
pub struct Limit {
    weight: Weight,
    /// For Wendland's weight, the largest way at which it does not matter [radii]. For the linear weight, a quarter of the
    /// ratio of the error for a way of one radius past the centre to the negligible error, as a square root.
    bound: f64,
}

impl Limit {
    /// For a step with an acceptable error of `wanted` [scene unit].
    pub fn new(course: &Course<'_>, step: &Step, wanted: f64) -> Limit {
        let of_sphere = |sphere: &Sphere| sphere.strength.abs() * sphere.radius;
        let strongest = course.spheres.iter().map(of_sphere).fold(0.0, f64::max);
        let ratio = strongest * USUAL * step.weights.gain() / (NEGLIGIBLE * wanted);
        let weight = course.weight();
        let bound = match weight {
            Weight::Linear => 0.25 * (SQUARE * ratio).sqrt(),
            Weight::Wendland => 1.0 / (20.0 * FOURTH * ratio).sqrt().sqrt(),
        };
        Limit { weight, bound }
    }

    /// The vertices to which it may matter, by the way past a sphere and by the distance from its centre at the start [radii].
    #[inline(always)]
    pub fn exceeded<S: Simd, const W: usize>(self, simd: S, way: Reals<S, W>, distance: Reals<S, W>) -> Mask<S, W> {
        match self.weight {
            // m w⁶ > (w² + 8 z²)² with m = (4 bound)², where the least distance z is the distance at the start less w:
            // that distance is below (1 + a) w with 8 a² = √m w − 1, and (1 + a)² ≤ 2 + 2 a²
            Weight::Linear => {
                let near = Reals::splat(simd, 1.75) + way * self.bound;
                (distance * distance).below(way * way * near)
            }
            Weight::Wendland => Reals::splat(simd, self.bound).below(way),
        }
    }
}

/// Estimate of the error of the displacement caused by kinks [scene unit], at least half of it, for a vertex that takes a
/// step from a state under `forces` at the nodes; `acts` tells which spheres act on it.
pub fn error(
    course: &Course<'_>,
    step: &Step,
    vertex: &Vertex,
    State { x, u }: State,
    forces: &[DVec3; 4],
    acts: impl Fn(usize) -> bool,
) -> f64 {
    let [f0, f1, f2, f3] = *forces;
    let mut positions = [x; 4];
    for node in 0..4 {
        if node > 0 {
            let stage = &step.weights.nodes[node];
            let [w0, w1, w2, w3] = stage.force;
            positions[node] = (stage.xx * x + stage.xu * u) + ((w0 * f0 + w1 * f1) + (w2 * f2 + w3 * f3));
        }
        positions[node] += vertex.rest;
    }
    let mut sum = 0.0;
    for (j, sphere) in course.spheres.iter().enumerate() {
        if acts(j) {
            let apart = std::array::from_fn(|node| step.moments[node].centres[j] - positions[node]);
            sum += left_out(course.weight(), sphere.radius, sphere.strength, &apart);
        }
    }
    USUAL * sum * step.weights.gain()
}

/// A bound on the mean force that a step leaves out at the kinks of a sphere [scene unit/s²], for a vertex that sees its
/// centre at `apart` at the nodes.
///
/// Between nodes the path is taken as straight. With w the way in radii of the sphere at the speed of that part, over
/// the whole step, and z the least distance, the bounds for z = 0 are divided by (1 + 8 z²/w²)² for the linear weight, and by
/// 1 + 4 z²/w² for Wendland's: fits from above to the largest mean residuals of `|d| d` and of `|d|³ d` on a straight path.
fn left_out(weight: Weight, radius: f64, strength: f64, apart: &[DVec3; 4]) -> f64 {
    let per_square = 1.0 / (radius * radius);
    let mut largest: f64 = 0.0;
    for node in 0..3 {
        let (from, to) = (apart[node], apart[node + 1]);
        let square = (to - from).length_squared();
        // without those that are NaN, for no way
        let nearest = f64::max(0.0, -from.dot(to - from) / square).min(1.0);
        let nearest = (from + nearest * (to - from)).length_squared() * per_square;
        let share = NODES[node + 1] - NODES[node];
        let way = square * (per_square / (share * share));
        let of_node = match weight {
            Weight::Linear => {
                let wider = way + 8.0 * nearest;
                SQUARE * way * way * way / (wider * wider)
            }
            // W = 1 − 10 z² + 20 z³ … at the centre and 5 (1 − z)⁴ at the rim
            Weight::Wendland if nearest < 1.0 => {
                let [start, end] = [from, to].map(|apart| (apart.length_squared() * per_square).sqrt());
                let fall = if (start < 1.0) != (end < 1.0) { (end - start) / share } else { 0.0 };
                let rim = 5.0 * HALF_FOURTH * (fall * fall) * (fall * fall);
                f64::max(rim, 20.0 * FOURTH * way * way * way / (way + 4.0 * nearest))
            }
            Weight::Wendland => 0.0,
        };
        largest = largest.max(of_node);
    }
    largest * strength.abs() * radius
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::influence::acceleration;

    const RADIUS: f64 = 1.3;
    const STRENGTH: f64 = -500.0;

    /// The mean residual of the cubic through the nodes for a vertex that passes a sphere on a straight path, over the bound.
    fn share(weight: Weight, from: DVec3, way: DVec3) -> f64 {
        let apart = |time: f64| from + time * way;
        let force = |time: f64| acceleration(weight, STRENGTH, RADIUS, apart(time));
        // Lobatto quadrature is the integral of the cubic; the midpoint rule is the reference
        let quadrature = [1.0, 5.0, 5.0, 1.0].iter().zip(NODES).map(|(w, node)| w / 12.0 * force(node)).sum::<DVec3>();
        const PARTS: usize = 4000;
        let parts = (0..PARTS).map(|part| force((part as f64 + 0.5) / PARTS as f64));
        let mean = parts.sum::<DVec3>() / PARTS as f64;
        (mean - quadrature).length() / left_out(weight, RADIUS, STRENGTH, &NODES.map(apart))
    }

    /// The largest [`share`] over where in the step the vertex passes, for a way in radii and the least distance in ways.
    fn largest_share(weight: Weight, way: f64, least: f64) -> f64 {
        let way = way * RADIUS;
        let at = |time: f64| share(weight, DVec3::new(-time * way, least * way, 0.0), DVec3::X * way);
        (0..=50).map(|time| at(f64::from(time) / 50.0)).fold(0.0, f64::max)
    }

    /// The bound holds wherever in the step the vertex passes the centre, and is no more than a few times too large.
    #[test]
    fn residuals_at_centres_are_bounded() {
        for way in [0.01, 0.1, 0.3] {
            for least in [0.0, 0.02, 0.1, 0.3, 0.6, 1.0] {
                let linear = largest_share(Weight::Linear, way, least);
                assert!(linear < 1.02 && linear > 0.4, "way {way}, least distance {least}: {linear}");
                let wendland = largest_share(Weight::Wendland, way, least);
                assert!(wendland < 1.1 && wendland > 0.3, "way {way}, least distance {least}: {wendland}");
            }
        }
    }

    /// The same where a vertex crosses the rim of a Wendland weight.
    #[test]
    fn residuals_at_rims_are_bounded() {
        for way in [0.01, 0.1, 0.3] {
            let at =
                |time: f64| share(Weight::Wendland, DVec3::X * (1.0 - time * way) * RADIUS, DVec3::X * way * RADIUS);
            let largest = (1..50).map(|time| at(f64::from(time) / 50.0)).fold(0.0, f64::max);
            assert!(largest < 1.3 && largest > 0.4, "way {way}: {largest}");
        }
    }

    /// A vertex that does not move has no residual.
    #[test]
    fn a_vertex_at_rest_has_no_residual() {
        for weight in [Weight::Linear, Weight::Wendland] {
            for at in [DVec3::ZERO, DVec3::X] {
                assert_eq!(left_out(weight, RADIUS, STRENGTH, &[at; 4]), 0.0);
            }
        }
    }
}
