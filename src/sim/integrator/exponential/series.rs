//! The response of the oscillator over any part of a step, side by side for parts of different lengths: power series
//! with the same coefficients for all of them, in place of exponential and trigonometric functions of each length.
//!
//! With S the impulse response ([`oscillator`](crate::model::oscillator)) and I_m its m-fold integral from 0, I_1 = S and
//! I_0 = S′. S″ = −ω²S − 2κS′, integrated m + 1 times, is I_m = tᵐ/m! − 2κ I_{m+1} − ω² I_{m+2}: two series are enough, for
//! the highest two, and the recurrence does not cancel where (ω + 2κ) t is small.

use pulp::Simd;

use super::lanes::{Reals, Vector};
use crate::model::oscillator::Oscillator;

/// The largest (ω + 2κ) h of a step for which the series are exact to a few roundings.
pub const LONGEST: f64 = 1.0;
/// Number of terms; the next one would be below 1/17! ≈ 3e-15.
const TERMS: usize = 12;
/// 1/m!
const PER_FACTORIAL: [f64; 5] = [1.0, 1.0, 0.5, 1.0 / 6.0, 1.0 / 24.0];

/// The series for parts of a step.
pub struct Series {
    /// The length h of the step [s].
    pub h: f64,
    omega_squared: f64,
    /// 2κ h and (ω h)² [–].
    damping: f64,
    stiffness: f64,
    /// Coefficients of I_5/t⁵ and of I_6/t⁶ in t/h.
    highest: [[f64; TERMS]; 2],
}

/// The response over a part of length t: J_m = I_m/tᵐ, m = 0 … 6.
#[derive(Clone, Copy)]
pub struct Response<S: Simd> {
    /// t [s]
    pub t: Reals<S, 1>,
    /// J_m [–]
    pub j: [Reals<S, 1>; 7],
    /// ω² [1/s²] and (ω t)² [–].
    omega_squared: f64,
    stiffness: Reals<S, 1>,
}

impl Series {
    /// The series for parts of a step of length `h` [s].
    pub fn new(Oscillator { omega, damping }: Oscillator, h: f64) -> Series {
        let (stiffness, damping) = ((omega * h) * (omega * h), 2.0 * damping * h);
        let mut highest = [[0.0; TERMS]; 2];
        // S = Σ aₙ (t/h)ⁿ/n! and aₙ₊₂ = −2κh aₙ₊₁ − (ωh)² aₙ; the m − 1 integrations divide by n + 1 … n + m − 1
        let (mut before, mut current) = (0.0, 1.0);
        let mut per_factorial = 1.0 / 120.0;
        for n in 0..TERMS {
            highest[0][n] = current * per_factorial;
            per_factorial /= n as f64 + 6.0;
            highest[1][n] = current * per_factorial;
            (before, current) = (current, -damping * current - stiffness * before);
        }
        Series { h, omega_squared: omega * omega, damping, stiffness, highest }
    }

    /// The displacement at the end of the step by the force (s/h)⁴ [s²].
    pub fn fourth(&self) -> f64 {
        24.0 * self.h * self.h * self.highest[1].iter().rev().sum::<f64>()
    }

    /// The response over `theta` h.
    #[inline(always)]
    pub fn over<S: Simd>(&self, simd: S, theta: Reals<S, 1>) -> Response<S> {
        let mut j = [Reals::splat(simd, 0.0); 7];
        for (sum, coefficients) in j[5..].iter_mut().zip(&self.highest) {
            *sum = Reals::splat(simd, coefficients[TERMS - 1]);
            for &coefficient in coefficients[..TERMS - 1].iter().rev() {
                *sum = *sum * theta + Reals::splat(simd, coefficient);
            }
        }
        let (damping, stiffness) = (theta * self.damping, theta * theta * self.stiffness);
        for m in (0..5).rev() {
            j[m] = Reals::splat(simd, PER_FACTORIAL[m]) - damping * j[m + 1] - stiffness * j[m + 2];
        }
        Response { t: theta * self.h, j, omega_squared: self.omega_squared, stiffness }
    }
}

impl<S: Simd> Response<S> {
    /// ∂x/∂x₀ [–].
    #[inline(always)]
    pub fn xx(&self, simd: S) -> Reals<S, 1> {
        Reals::splat(simd, 1.0) - self.stiffness * self.j[2]
    }

    /// ∂x/∂u₀ [s].
    #[inline(always)]
    pub fn xu(&self) -> Reals<S, 1> {
        self.t * self.j[1]
    }

    /// The displacement at the end of the part without a force.
    #[inline(always)]
    pub fn displaced(&self, simd: S, x: Vector<S, 1>, u: Vector<S, 1>) -> Vector<S, 1> {
        x * self.xx(simd) + u * self.xu()
    }

    /// The velocity at the end of the part without a force.
    #[inline(always)]
    pub fn velocity(&self, x: Vector<S, 1>, u: Vector<S, 1>) -> Vector<S, 1> {
        u * self.j[0] - x * (self.xu() * self.omega_squared)
    }

    /// The displacement at the end of the part by the forces (s/t)ᵏ, k = 0 … 3, over k! t² [–].
    #[inline(always)]
    pub fn displacements(&self) -> [Reals<S, 1>; 4] {
        [self.j[2], self.j[3], self.j[4], self.j[5]]
    }

    /// The velocity at the end of the part by the forces (s/t)ᵏ, k = 0 … 3, over k! t [–].
    #[inline(always)]
    pub fn velocities(&self) -> [Reals<S, 1>; 4] {
        [self.j[1], self.j[2], self.j[3], self.j[4]]
    }
}

/// The weights of the forces at the first `N` nodes in a response, given the response to powers of time, by the
/// coefficients of the nodes' polynomials, the k-th times k!.
#[inline(always)]
pub fn weigh<S: Simd, const N: usize>(
    powers: &[Reals<S, 1>; 4],
    polynomials: &[[f64; 4]; 4],
    scale: Reals<S, 1>,
) -> [Reals<S, 1>; 4] {
    let mut weights = [scale; 4];
    for i in 0..N {
        // only the polynomial of the first node does not vanish at the start
        let lowest = if i > 0 { 1 } else { 0 };
        let mut sum = powers[lowest] * polynomials[i][lowest];
        for k in lowest + 1..N {
            sum = sum + powers[k] * polynomials[i][k];
        }
        weights[i] = sum * scale;
    }
    weights
}

#[cfg(test)]
mod tests {
    use pulp::Scalar;

    use super::*;
    use crate::model::oscillator::Propagator;

    fn number(reals: Reals<Scalar, 1>) -> f64 {
        let mut only = [0.0];
        reals.store(&mut only, 0);
        only[0]
    }

    /// Compared with the propagator, which uses exponential and trigonometric functions or its own series.
    #[test]
    fn series_agree_with_the_propagator() {
        let simd = Scalar;
        for (omega, damping) in [(12.0, 1.5), (15.0, 0.0), (5.0, 5.0), (0.01, 7.4), (0.0, 0.0), (3.0, 6.0)] {
            let oscillator = Oscillator { omega, damping };
            let h = LONGEST / f64::max(omega + 2.0 * damping, 1.0);
            let series = Series::new(oscillator, h);
            for theta in [1e-9, 0.01, 0.3, 0.7, 1.0] {
                let t = theta * h;
                let Propagator { xx, xu, ux, uu, x, u } = oscillator.propagator(t);
                let response = series.over(simd, Reals::splat(simd, theta));
                let [one, none] = [1.0, 0.0].map(|x| Vector::splat(simd, glam::DVec3::splat(x)));
                let flow = [
                    (number(response.displaced(simd, one, none).x), xx),
                    (number(response.displaced(simd, none, one).x), xu),
                    (number(response.velocity(one, none).x), ux),
                    (number(response.velocity(none, one).x), uu),
                ];
                let factorials = [1.0, 1.0, 2.0, 6.0];
                let [of_x, of_u] = [response.displacements(), response.velocities()].map(|powers| powers.map(number));
                let powers = (0..4).flat_map(|k| {
                    let [x, u] = [(t * t * of_x[k], x[k]), (t * of_u[k], u[k])];
                    [x, u].map(|(found, expected)| (factorials[k] * found, expected))
                });
                let flow = flow.map(|flow| (flow, 2e-14));
                // the highest power comes from a series directly, whose end is cut off: 5!/17! of it
                for ((found, expected), bound) in flow.into_iter().chain(powers.map(|power| (power, 4e-13))) {
                    let error = (found - expected).abs();
                    assert!(error <= bound * expected.abs(), "{omega} {damping} {theta}: {found:e} {expected:e}");
                }
            }
        }
    }
}
