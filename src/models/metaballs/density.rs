//! The density of metaballs, its gradient and its Hessian.

use glam::{DMat3, DVec3};

use crate::model::shape_matching::outer;

/// The density of a ball at distance r from its centre, in units of the threshold:
///
/// ```text
/// f(r) = (1 − r²/r_e²)³ / (1 − R²/r_e²)³   for r < r_e, else 0
/// ```
///
/// so that the surface of a lone ball, f = 1, is the sphere of its radius R. This is the simplest of the polynomials in
/// r² used for soft objects (Wyvill, McPheeters, Wyvill: *Data Structure for Soft Objects*, 1986), with the finite
/// support that Nishimura et al. (1985) introduced in place of Blinn's (1982) exponentials. Nishimura's function is
/// piecewise quadratic, with a jump of the second derivative inside the support; this one is C² everywhere, so that
/// critical points can be found by Newton's method and volumes by quadrature.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kernel {
    /// r_e / R [–], > 1.
    reach: f64,
    /// 1 / (1 − R²/r_e²)³
    height: f64,
}

/// A ball.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ball {
    /// Its centre [scene unit].
    pub centre: DVec3,
    /// The radius of its surface when alone [scene unit].
    pub radius: f64,
    /// Its density.
    pub kernel: Kernel,
}

/// Density in units of the threshold, its gradient and its Hessian.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jet {
    /// F [–]
    pub value: f64,
    /// ∇F [1/scene unit]
    pub gradient: DVec3,
    /// ∇∇F [1/scene unit²]
    pub hessian: DMat3,
}

impl Kernel {
    /// The density for a support of `reach` radii; `None` if that is not larger than the ball.
    pub fn new(reach: f64) -> Option<Kernel> {
        let inside = 1.0 - 1.0 / (reach * reach);
        let height = 1.0 / (inside * inside * inside);
        (reach > 1.0 && height.is_finite()).then_some(Kernel { reach, height })
    }
}

impl Ball {
    /// The radius of its support [scene unit].
    pub fn support(&self) -> f64 {
        self.kernel.reach * self.radius
    }

    /// Its density at `at`.
    #[inline]
    pub fn density(&self, at: DVec3) -> f64 {
        let support = self.support();
        let u = 1.0 - (at - self.centre).length_squared() / (support * support);
        if u > 0.0 { self.kernel.height * (u * u * u) } else { 0.0 }
    }

    /// The gradient of its density [1/scene unit].
    #[inline]
    pub fn slope(&self, at: DVec3) -> DVec3 {
        let support = self.support();
        let (x, inverse) = (at - self.centre, 1.0 / (support * support));
        let u = 1.0 - x.length_squared() * inverse;
        if u > 0.0 { (-6.0 * self.kernel.height * (u * u) * inverse) * x } else { DVec3::ZERO }
    }
}

/// The density F of some balls at `at`, summed in their order.
#[inline]
pub fn density_of(balls: &[Ball], at: DVec3) -> f64 {
    balls.iter().map(|ball| ball.density(at)).sum()
}

/// The gradient of the density of some balls [1/scene unit].
#[inline]
pub fn slope_of(balls: &[Ball], at: DVec3) -> DVec3 {
    balls.iter().map(|ball| ball.slope(at)).sum()
}

/// F, ∇F and ∇∇F of some balls at `at`.
pub fn jet_of(balls: &[Ball], at: DVec3) -> Jet {
    let mut jet = Jet { value: 0.0, gradient: DVec3::ZERO, hessian: DMat3::ZERO };
    for ball in balls {
        let (support, height) = (ball.support(), ball.kernel.height);
        let (x, inverse) = (at - ball.centre, 1.0 / (support * support));
        let u = 1.0 - x.length_squared() * inverse;
        if u > 0.0 {
            jet.value += height * (u * u * u);
            let slope = -6.0 * height * (u * u) * inverse;
            jet.gradient += slope * x;
            // ∂/∂x (−6 u²/r_e² x) = −6 u²/r_e² 1 + 24 u/r_e⁴ x xᵀ
            let along = 24.0 * height * u * inverse * inverse;
            jet.hessian += outer(x, x) * along + DMat3::from_diagonal(DVec3::splat(slope));
        }
    }
    jet
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lone_ball_is_a_sphere_of_its_radius() {
        for reach in [1.1, std::f64::consts::SQRT_2, 2.0, 5.0] {
            let kernel = Kernel::new(reach).unwrap();
            let ball = Ball { centre: DVec3::new(3.0, -2.0, 1.0), radius: 0.7, kernel };
            let on = ball.centre + 0.7 * DVec3::new(2.0, 1.0, -2.0) / 3.0;
            assert!((ball.density(on) - 1.0).abs() < 1e-12 * reach * kernel.height);
            assert!(ball.density(ball.centre + DVec3::X * ball.support()) < 1e-30);
        }
        assert_eq!([0.5, 1.0, f64::NAN].map(Kernel::new), [None; 3]);
    }

    #[test]
    fn slope_and_curvature_match_finite_differences() {
        let ball = |x: f64, y: f64, radius, reach| Ball {
            centre: DVec3::new(x, y, 0.1),
            radius,
            kernel: Kernel::new(reach).unwrap(),
        };
        let balls = [ball(0.0, 0.0, 1.0, 1.5), ball(1.9, 0.3, 0.8, 1.9), ball(0.7, 1.4, 1.1, 1.3)];
        let (at, h) = (DVec3::new(0.8, 0.5, 0.2), 1e-5);
        let jet = jet_of(&balls, at);
        assert_eq!(jet.gradient, slope_of(&balls, at));
        for (k, axis) in DVec3::AXES.into_iter().enumerate() {
            let [before, after] = [-h, h].map(|h| jet_of(&balls, at + h * axis));
            assert!(((after.value - before.value) / (2.0 * h) - jet.gradient[k]).abs() < 1e-6);
            assert!((((after.gradient - before.gradient) / (2.0 * h)) - jet.hessian.col(k)).length() < 1e-6);
        }
    }
}
