//! When two metaballs are joined: the saddle of the density between them.
//!
//! By Morse theory, the level set at the threshold changes its topology only when a critical point of the density
//! crosses the threshold. Two components join when a saddle of index 1 does (a minimum along the path from one to the
//! other, a maximum across it). For two balls, the saddle is on the line of their centres. Other balls shift it off
//! that line; Newton's method finds it from the minimum on the line. It joins the two balls if the paths of steepest
//! ascent from it end in them.

use glam::{DMat3, DVec3};

use super::density::{Ball, Jet, density_of, jet_of, slope_of};
use crate::sim::numerics::roots::root;

/// Number of samples on the line of centres.
const SAMPLES: u32 = 32;
/// Upper limit on Newton steps.
const MAX_STEPS: u32 = 60;
/// The longest Newton step, and the steps of an ascent [centre distances].
const MAX_STRIDE: f64 = 0.05;
/// Upper limit on the steps of an ascent.
const MAX_ASCENT: u32 = 100;

/// The saddle between two balls.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Saddle {
    /// Position [scene unit].
    pub place: DVec3,
    /// The density there, in units of the threshold: the balls are joined if it is at least 1.
    pub density: f64,
}

impl Saddle {
    /// The saddle between the first two balls, in the density of all. `None` if there is none: the balls are so close
    /// that the density is monotonic between the centres, or so far apart that there is no density between them, or a
    /// third ball fills the space between, or joins them.
    pub fn between(balls: &[Ball]) -> Option<Saddle> {
        let (a, b) = (balls.first()?, balls.get(1)?);
        let along = b.centre - a.centre;
        let distance = along.length();
        if !(distance > 0.0 && distance < a.support() + b.support()) {
            return None;
        }
        let start = lowest(balls)?;
        let mut place = start;
        for _ in 0..MAX_STEPS {
            let Jet { value, gradient, hessian } = jet_of(balls, place);
            let determinant = hessian.determinant();
            if determinant == 0.0 || !determinant.is_finite() {
                return None;
            }
            let step = -(hessian.inverse() * gradient);
            let length = step.length();
            if length <= 4.0 * f64::EPSILON * (place.length() + distance) {
                let is_between = place.distance(start) < 0.5 * distance;
                let is_saddle = is_between && has_index_one(&hessian) && ascends_to_both(balls, place);
                return is_saddle.then_some(Saddle { place, density: value });
            }
            place += step * f64::min(1.0, MAX_STRIDE * distance / length);
        }
        // at the level of rounding errors, steps need not shrink: accept a stationary point
        let Jet { value, gradient, hessian } = jet_of(balls, place);
        let is_still = gradient.length() * distance < 1e-10 && place.distance(start) < 0.5 * distance;
        let is_saddle = is_still && has_index_one(&hessian) && ascends_to_both(balls, place);
        is_saddle.then_some(Saddle { place, density: value })
    }
}

/// Whether the first two balls are joined directly at the threshold, not through other balls.
pub fn are_one(balls: &[Ball]) -> bool {
    let [a, b, others @ ..] = balls else { return false };
    let distance = a.centre.distance(b.centre);
    if distance <= a.radius + b.radius {
        return true; // the density is above the threshold inside both balls
    }
    if distance >= a.support() + b.support() {
        return false;
    }
    if !others.is_empty() && are_one(&balls[..2]) {
        return true; // whatever is between them
    }
    // a straight path that is dense enough suffices, unless it leads through another ball
    let along = (b.centre - a.centre) / distance;
    let is_in_the_way = |other: &Ball| {
        let nearest = (other.centre - a.centre).dot(along).clamp(a.radius, distance - b.radius);
        other.centre.distance(a.centre + nearest * along) <= other.radius
    };
    match lowest(balls) {
        _ if others.iter().any(is_in_the_way) => false,
        None => true,
        Some(place) if density_of(balls, place) >= 1.0 => true,
        Some(_) => Saddle::between(balls).is_some_and(|saddle| saddle.density >= 1.0),
    }
}

/// Whether the density ascends from a saddle to the first two balls, one on each side of it.
fn ascends_to_both(balls: &[Ball], saddle: DVec3) -> bool {
    let along = balls[1].centre - balls[0].centre;
    if balls.len() == 2 || along.length() <= balls[0].radius + balls[1].radius {
        return true; // no other ball joins them
    }
    let stride = MAX_STRIDE * along.length();
    [-along, along].into_iter().enumerate().all(|(expected, side)| {
        let mut place = saddle + 0.1 * stride * side.normalize_or_zero();
        for _ in 0..MAX_ASCENT {
            let contains = |ball: &Ball| place.distance(ball.centre) <= ball.radius;
            if contains(&balls[expected]) || balls.iter().any(contains) {
                return contains(&balls[expected]);
            }
            place += stride * slope_of(balls, place).normalize_or_zero();
        }
        false
    })
}

/// The point of minimum density on the line from the first ball's centre to the second's, or only between their
/// surfaces if the lone balls are apart. `None` if that is an end of the line.
fn lowest(balls: &[Ball]) -> Option<DVec3> {
    let (a, b) = (balls.first()?, balls.get(1)?);
    let along = b.centre - a.centre;
    let distance = along.length();
    let [from, to] =
        if distance > a.radius + b.radius { [a.radius / distance, 1.0 - b.radius / distance] } else { [0.0, 1.0] };
    let at = |z: f64| density_of(balls, a.centre + z * along);
    let of = |k: u32| from + (to - from) * (f64::from(k) / f64::from(SAMPLES));
    let (mut least, mut value) = (0, f64::INFINITY);
    for k in 0..=SAMPLES {
        let here = at(of(k));
        if here < value {
            (least, value) = (k, here);
        }
    }
    // the slope along the line changes sign there
    let slope = |z: f64| -slope_of(balls, a.centre + z * along).dot(along);
    let (low, high) = (of(least.saturating_sub(1)), of((least + 1).min(SAMPLES)));
    // between an end and the sample beside it only if the density falls from the end
    if least == 0 && slope(low) <= 0.0 || least == SAMPLES && slope(high) >= 0.0 {
        return None;
    }
    let z = if slope(low) > 0.0 && slope(high) < 0.0 { root(low, high, slope) } else { of(least) };
    Some(a.centre + z * along)
}

/// Whether a symmetric matrix has one positive and two negative eigenvalues: its determinant is positive, and it is not
/// positive definite.
fn has_index_one(matrix: &DMat3) -> bool {
    let DMat3 { x_axis: x, y_axis: y, .. } = *matrix;
    let is_definite = x.x > 0.0 && x.x * y.y - x.y * y.x > 0.0;
    matrix.determinant() > 0.0 && !is_definite
}

#[cfg(test)]
mod tests {
    use std::f64::consts::SQRT_2;

    use super::*;
    use crate::models::metaballs::density::Kernel;

    fn ball(x: f64, y: f64, radius: f64, reach: f64) -> Ball {
        Ball { centre: DVec3::new(x, y, 0.0), radius, kernel: Kernel::new(reach).unwrap() }
    }

    /// 2 (1 − d²/4r_e²)³ = (1 − R²/r_e²)³, solved for d.
    #[test]
    fn two_equal_balls_are_one_from_a_distance_in_closed_form() {
        for reach in [1.2, SQRT_2, 2.0] {
            let inside = 1.0 - 1.0 / (reach * reach);
            let expected = 2.0 * reach * (1.0 - inside * 0.5f64.cbrt()).sqrt();
            let is_one = |d: f64| are_one(&[ball(0.0, 0.0, 1.0, reach), ball(0.6 * d, 0.8 * d, 1.0, reach)]);
            let found = root(1.5, 2.5 * reach, |d| if is_one(d) { 1.0 } else { -1.0 });
            assert!((found - expected).abs() < 1e-12, "{reach}: {found} {expected}");
        }
    }

    /// Balls at the corners of an equilateral triangle: the saddle is on an altitude, where the density is a function
    /// of one variable.
    #[test]
    fn a_third_ball_moves_the_saddle_off_the_line() {
        let d = 3.2;
        let height = d * 0.75f64.sqrt();
        let balls = [ball(-0.5 * d, 0.0, 1.0, 3.0), ball(0.5 * d, 0.0, 1.0, 3.0), ball(0.0, height, 1.0, 3.0)];
        let saddle = Saddle::between(&balls).unwrap();
        // the first stationary point of the density along the altitude, from the side inwards
        let f = |y: f64| {
            let of = |r2: f64| (1.0 - r2 / 9.0).max(0.0).powi(3) / (8.0f64 / 9.0).powi(3);
            2.0 * of(0.25 * d * d + y * y) + of((height - y) * (height - y))
        };
        let slope = |y: f64| {
            let of = |r2: f64, by: f64| -2.0 / 3.0 * (1.0 - r2 / 9.0).max(0.0).powi(2) * by / (8.0f64 / 9.0).powi(3);
            2.0 * of(0.25 * d * d + y * y, y) - of((height - y) * (height - y), height - y)
        };
        assert!(slope(0.0) > 0.0, "the third ball is felt");
        let y = root(0.0, 0.9, slope);
        assert!(saddle.place.distance(DVec3::new(0.0, y, 0.0)) < 1e-12, "{saddle:?} {y}");
        assert!((saddle.density - f(y)).abs() < 1e-13);
        assert!(saddle.density > f(0.0), "higher than on the line");
    }

    #[test]
    fn balls_that_a_third_one_bridges_are_not_one() {
        let row = |d: f64| [ball(0.0, 0.0, 1.0, 2.0), ball(d, 0.0, 1.0, 2.0), ball(0.5 * d, 0.0, 0.4, 2.0)];
        for d in [2.6, 2.7, 2.8] {
            let [a, c, b] = row(d);
            assert!(!are_one(&[a, c, b]) && are_one(&[a, b, c]) && are_one(&[b, c, a]), "{d}");
            assert!(Saddle::between(&[a, c, b]).is_none(), "{d}");
        }
        assert!(are_one(&row(2.2)), "without the third");
        // beside them, it only helps
        let [a, c, mut b] = row(2.6);
        assert!(!are_one(&[a, c]));
        b.centre.y = 1.2;
        assert!(!are_one(&[a, c, b]), "{b:?}");
        b.radius = 1.2;
        b.centre.y = 1.25;
        assert!(are_one(&[a, c, b]), "{b:?}");
    }

    #[test]
    fn far_near_and_concentric_balls_are_decided() {
        let one = |x, radius| are_one(&[ball(0.0, 0.0, 1.0, SQRT_2), ball(x, 0.0, radius, SQRT_2)]);
        assert!(!one(2.9, 1.0) && !one(2.3, 1.0) && one(2.1, 1.0) && one(0.5, 1.0) && one(0.0, 1.0));
        assert!(!one(1.3, 0.1) && one(1.05, 0.1) && one(0.2, 0.1));
    }
}
