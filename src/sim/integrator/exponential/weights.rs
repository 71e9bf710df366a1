//! Collocation weights: what forces at four instants of a step do to the oscillator, exactly.

use std::sync::LazyLock;

use crate::model::oscillator::{Oscillator, Propagator};

/// The nodes of Lobatto quadrature with four points, on [0, 1]: exact for polynomials of degree five.
pub const NODES: [f64; 4] = [0.0, 0.276_393_202_250_021, 0.723_606_797_749_978_9, 1.0];

/// `LAGRANGE[n][i]` holds the coefficients of the polynomial that is 1 at node i and 0 at the other nodes before node n.
static LAGRANGE: LazyLock<[[[f64; 4]; 4]; 5]> = LazyLock::new(|| {
    let mut all = [[[0.0; 4]; 4]; 5];
    for (n, basis) in all.iter_mut().enumerate().skip(1) {
        for (i, coefficients) in basis.iter_mut().enumerate().take(n) {
            // Π (θ − θ_j)/(θ_i − θ_j), multiplied out
            coefficients[0] = 1.0;
            for (degree, j) in (0..n).filter(|&j| j != i).enumerate() {
                let scale = 1.0 / (NODES[i] - NODES[j]);
                for k in (0..=degree + 1).rev() {
                    let lower = if k > 0 { coefficients[k - 1] } else { 0.0 };
                    coefficients[k] = scale * (lower - NODES[j] * coefficients[k]);
                }
            }
        }
    }
    all
});

/// How the displacement at an instant of the step follows from the state at its start and the forces at the nodes.
#[derive(Clone, Copy, Debug, Default)]
pub struct Stage {
    /// Weight of the displacement at the start [–].
    pub xx: f64,
    /// Weight of the velocity at the start [s].
    pub xu: f64,
    /// Weight of the force at each node [s²].
    pub force: [f64; 4],
    /// The same from the nodes before this one only [s²].
    pub predict: [f64; 4],
}

/// All weights of a step of a given length.
#[derive(Clone, Copy, Debug, Default)]
pub struct Weights {
    /// The length h of the step [s].
    pub h: f64,
    /// Displacement at each node; the first is the start and is not used.
    pub nodes: [Stage; 4],
    /// Displacement in the middle.
    pub middle: Stage,
    /// Weight of each node's force in the polynomial's value in the middle [–].
    pub polynomial: [f64; 4],
    /// Velocity at the end: weights of the state at the start [1/s], [–] …
    pub ux: f64,
    /// …
    pub uu: f64,
    /// … and of the forces [s].
    pub velocity: [f64; 4],
    /// What a constant unit force adds to the displacement at the end [s²].
    pub constant: f64,
    /// What an error of the velocity becomes in the displacement, at most, once the oscillator has taken it up [s].
    pub swing: f64,
}

impl Weights {
    /// The weights of a step of length `h` > 0 [s].
    pub fn new(oscillator: Oscillator, h: f64) -> Weights {
        let whole = oscillator.propagator(h);
        let stage = |theta: f64, n: usize, p: &Propagator| Stage {
            xx: p.xx,
            xu: p.xu,
            force: responses(&LAGRANGE[4], theta, &p.x),
            predict: responses(&LAGRANGE[n], theta, &p.x),
        };
        let at = |theta: f64| oscillator.propagator(theta * h);
        let lagrange = &LAGRANGE[4];
        Weights {
            h,
            nodes: [
                Stage::default(),
                stage(NODES[1], 1, &at(NODES[1])),
                stage(NODES[2], 2, &at(NODES[2])),
                stage(1.0, 3, &whole),
            ],
            middle: stage(0.5, 4, &at(0.5)),
            polynomial: lagrange.map(|[a, b, c, d]| a + 0.5 * (b + 0.5 * (c + 0.5 * d))),
            ux: whole.ux,
            uu: whole.uu,
            velocity: responses(lagrange, 1.0, &whole.u),
            constant: whole.x[0],
            swing: 1.0 / oscillator.omega.max(2.0 * oscillator.damping).max(1.0),
        }
    }
}

/// The response at `theta` h to each of the polynomials, from that to the powers of time.
fn responses(basis: &[[f64; 4]; 4], theta: f64, powers: &[f64; 4]) -> [f64; 4] {
    let [p0, p1, p2, p3] = *powers;
    basis.map(|[a, b, c, d]| a * p0 + theta * (b * p1 + theta * (c * p2 + theta * (d * p3))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polynomials_are_one_at_their_node_and_zero_at_the_others() {
        for n in 1..=4 {
            for i in 0..n {
                for j in 0..n {
                    let [a, b, c, d] = LAGRANGE[n][i];
                    let t = NODES[j];
                    let value = a + t * (b + t * (c + t * d));
                    assert!((value - f64::from(i == j)).abs() < 1e-14, "{n} {i} {j}: {value}");
                }
            }
        }
    }

    #[test]
    fn without_an_oscillator_the_weights_are_lobatto_quadrature() {
        let weights = Weights::new(Oscillator { omega: 0.0, damping: 0.0 }, 2.0);
        for (weight, lobatto) in weights.velocity.into_iter().zip([1.0, 5.0, 5.0, 1.0]) {
            assert!((weight - 2.0 * lobatto / 12.0).abs() < 1e-14);
        }
    }
}
