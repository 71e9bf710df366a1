//! Polynomials over a step, with time from 0 to 1, through values at its nodes or samples.

use std::sync::LazyLock;

use glam::{DMat3, DVec3};

use super::nodes::{NODES, SAMPLES};

/// `[i]`: coefficients of the polynomial that is 1 at instant i and 0 at the others of the first `count` of `instants`.
fn basis<const N: usize>(instants: &[f64; N], count: usize) -> [[f64; N]; N] {
    let mut all = [[0.0; N]; N];
    for (i, coefficients) in all.iter_mut().enumerate().take(count) {
        // Π (θ − θ_j)/(θ_i − θ_j), multiplied out
        coefficients[0] = 1.0;
        for (degree, j) in (0..count).filter(|&j| j != i).enumerate() {
            let scale = 1.0 / (instants[i] - instants[j]);
            for k in (0..=degree + 1).rev() {
                let lower = if k > 0 { coefficients[k - 1] } else { 0.0 };
                coefficients[k] = scale * (lower - instants[j] * coefficients[k]);
            }
        }
    }
    all
}

/// `THROUGH[n]`: basis of the polynomials through values at the first n nodes.
pub static THROUGH: LazyLock<[[[f64; 4]; 4]; 5]> = LazyLock::new(|| std::array::from_fn(|n| basis(&NODES, n)));

/// Basis of the quartics through values at the samples.
static QUARTIC: LazyLock<[[f64; 5]; 5]> = LazyLock::new(|| basis(&SAMPLES, 5));

/// Weights at `theta` of the values at the nodes, in the cubic through them.
pub fn cubic(theta: f64) -> [f64; 4] {
    THROUGH[4].map(|[a, b, c, d]| a + theta * (b + theta * (c + theta * d)))
}

/// Weights at `theta` of the values at the samples, in the quartic through them.
pub fn quartic(theta: f64) -> [f64; 5] {
    QUARTIC.map(|[a, b, c, d, e]| a + theta * (b + theta * (c + theta * (d + theta * e))))
}

/// The coefficients of the quartic through vectors at the samples.
pub fn quartic_through(known: &[DVec3; 5]) -> [DVec3; 5] {
    let all = &*QUARTIC;
    let mut coefficients = [DVec3::ZERO; 5];
    // loops of constant length, which are unrolled wherever this is inlined
    for (k, coefficient) in coefficients.iter_mut().enumerate() {
        for (row, &known) in all.iter().zip(known) {
            *coefficient += row[k] * known;
        }
    }
    coefficients
}

/// Weights of the values at the nodes in the first and second integral of the cubic through them, up to an instant.
#[derive(Clone, Copy, Debug)]
pub struct CubicIntegrals {
    pub once: [f64; 4],
    pub twice: [f64; 4],
}

impl CubicIntegrals {
    /// The integrals from 0 to 1.
    pub fn whole() -> &'static CubicIntegrals {
        static WHOLE: LazyLock<CubicIntegrals> = LazyLock::new(|| CubicIntegrals::up_to(1.0));
        &WHOLE
    }

    /// The integrals from 0 to `z`.
    pub fn up_to(z: f64) -> CubicIntegrals {
        let once = THROUGH[4].map(|[a, b, c, d]| z * (a + z * (b / 2.0 + z * (c / 3.0 + z * (d / 4.0)))));
        let twice = THROUGH[4].map(|[a, b, c, d]| z * z * (a / 2.0 + z * (b / 6.0 + z * (c / 12.0 + z * (d / 20.0)))));
        CubicIntegrals { once, twice }
    }
}

/// Σ wᵢ vᵢ.
#[inline(always)]
pub fn combine(w: &[f64; 4], v: [DVec3; 4]) -> DVec3 {
    (w[0] * v[0] + w[1] * v[1]) + (w[2] * v[2] + w[3] * v[3])
}

/// Σ wᵢ mᵢ.
#[inline(always)]
pub fn combine_matrices(w: &[f64; 4], m: [DMat3; 4]) -> DMat3 {
    (m[0] * w[0] + m[1] * w[1]) + (m[2] * w[2] + m[3] * w[3])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polynomials_are_one_at_their_node_and_zero_at_the_others() {
        for n in 1..=4 {
            for i in 0..n {
                for j in 0..n {
                    let [a, b, c, d] = THROUGH[n][i];
                    let t = NODES[j];
                    let value = a + t * (b + t * (c + t * d));
                    assert!((value - f64::from(i == j)).abs() < 1e-14, "{n} {i} {j}: {value}");
                }
            }
        }
    }
}
