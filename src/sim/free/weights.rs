//! The response of an oscillator, at any instant of a step, to forces at its nodes; also to forces that begin within
//! the step.

use std::sync::LazyLock;

use super::super::{
    integrator::exponential::weights::Dense,
    nodes::{NODES, SAMPLES},
};
use crate::model::oscillator::Oscillator;

/// An oscillator without spring and damping: the motion of a centre.
pub const BALLISTIC: Oscillator = Oscillator { omega: 0.0, damping: 0.0 };

/// `CUBIC[i]` holds the coefficients of the cubic that is 1 at node i and 0 at the others.
static CUBIC: LazyLock<[[f64; 4]; 4]> = LazyLock::new(|| {
    std::array::from_fn(|i| {
        // Π (θ − θ_j)/(θ_i − θ_j), multiplied out
        let mut c = [1.0, 0.0, 0.0, 0.0];
        for (degree, j) in (0..4).filter(|&j| j != i).enumerate() {
            let scale = 1.0 / (NODES[i] - NODES[j]);
            for k in (0..=degree + 1).rev() {
                let lower = if k > 0 { c[k - 1] } else { 0.0 };
                c[k] = scale * (lower - NODES[j] * c[k]);
            }
        }
        c
    })
});

/// Weights at `theta` of the values at each node, in the cubic through them.
pub fn cubic(theta: f64) -> [f64; 4] {
    CUBIC.map(|[a, b, c, d]| a + theta * (b + theta * (c + theta * d)))
}

/// Dense output at each sample after the start of a step of length `h` [s]: the three other nodes, and the middle.
pub fn looks(oscillator: Oscillator, h: f64) -> [Dense; 4] {
    std::array::from_fn(|look| Dense::new(oscillator, h, SAMPLES[look + 1]))
}

/// Weights of forces that begin within the step, in the state at a later instant: weights of their values at the four
/// nodes, which the cubic interpolates.
#[derive(Clone, Copy, Debug, Default)]
pub struct Late {
    /// Weights in x [s²].
    pub x: [f64; 4],
    /// Weights in u [s].
    pub u: [f64; 4],
}

impl Late {
    /// The weights at `theta` of forces that act from `from` on, in a step of length `h` [s].
    pub fn new(oscillator: Oscillator, h: f64, from: f64, theta: f64) -> Late {
        let length = theta - from;
        if length <= 0.0 {
            return Late::default();
        }
        let p = oscillator.propagator(length * h);
        let weights = |powers: &[f64; 4]| {
            CUBIC.map(|[a, b, c, d]| {
                let at = a + from * (b + from * (c + from * d));
                let slope = b + from * (2.0 * c + from * (3.0 * d));
                let bend = c + from * (3.0 * d);
                at * powers[0] + length * (slope * powers[1] + length * (bend * powers[2] + length * (d * powers[3])))
            })
        };
        Late { x: weights(&p.x), u: weights(&p.u) }
    }
}
