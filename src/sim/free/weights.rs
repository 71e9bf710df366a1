//! Response of an oscillator, at any instant of a step, to forces given at its nodes, including forces that begin
//! within the step.

use std::sync::LazyLock;

use super::super::{
    integrator::exponential::weights::Dense,
    nodes::{NODES, SAMPLES},
};
use crate::model::oscillator::Oscillator;

/// An oscillator without spring and damping: the motion of a centre.
pub const BALLISTIC: Oscillator = Oscillator { omega: 0.0, damping: 0.0 };

/// `[i]`: coefficients of the polynomial that is 1 at node i and 0 at the others of the first `count` nodes.
fn basis(count: usize) -> [[f64; 4]; 4] {
    std::array::from_fn(|i| {
        if i >= count {
            return [0.0; 4];
        }
        // Π (θ − θ_j)/(θ_i − θ_j), multiplied out
        let mut c = [1.0, 0.0, 0.0, 0.0];
        for (degree, j) in (0..count).filter(|&j| j != i).enumerate() {
            let scale = 1.0 / (NODES[i] - NODES[j]);
            for k in (0..=degree + 1).rev() {
                let lower = if k > 0 { c[k - 1] } else { 0.0 };
                c[k] = scale * (lower - NODES[j] * c[k]);
            }
        }
        c
    })
}

static CUBIC: LazyLock<[[f64; 4]; 4]> = LazyLock::new(|| basis(4));

/// Bases of the first node, the first two and the first three.
static EARLY: LazyLock<[[[f64; 4]; 4]; 3]> = LazyLock::new(|| [basis(1), basis(2), basis(3)]);

/// Weights of the values at the nodes, in the cubic through them, at `theta`.
pub fn cubic(theta: f64) -> [f64; 4] {
    CUBIC.map(|[a, b, c, d]| a + theta * (b + theta * (c + theta * d)))
}

/// Dense output at each sample after the start of a step of length `h` [s]: at the other three nodes and the middle.
pub fn looks(oscillator: Oscillator, h: f64) -> [Dense; 4] {
    std::array::from_fn(|look| Dense::new(oscillator, h, SAMPLES[look + 1]))
}

/// Like [`looks`], without spring and damping; these weights scale with powers of `h`.
pub fn ballistic(h: f64) -> [Dense; 4] {
    static UNIT: LazyLock<[Dense; 4]> = LazyLock::new(|| looks(BALLISTIC, 1.0));
    UNIT.map(|unit| scaled(unit, h))
}

fn scaled(unit: Dense, h: f64) -> Dense {
    Dense { xu: unit.xu * h, x: unit.x.map(|w| w * h * h), u: unit.u.map(|w| w * h), ..unit }
}

/// `[n][i]`: dense output at node i + 1, for the polynomial through the forces at the first n + 1 nodes.
pub fn early(oscillator: Oscillator, h: f64) -> [[Dense; 3]; 3] {
    let at = [1, 2, 3].map(|node| (NODES[node], oscillator.propagator(NODES[node] * h)));
    EARLY.map(|basis| {
        at.map(|(theta, p)| {
            let response = |powers: &[f64; 4]| {
                basis.map(|[a, b, c, _]| a * powers[0] + theta * (b * powers[1] + theta * (c * powers[2])))
            };
            Dense { x: response(&p.x), u: response(&p.u), ..Dense::new(oscillator, h, theta) }
        })
    })
}

/// Like [`early`], without spring and damping.
pub fn early_ballistic(h: f64) -> [[Dense; 3]; 3] {
    static UNIT: LazyLock<[[Dense; 3]; 3]> = LazyLock::new(|| early(BALLISTIC, 1.0));
    UNIT.map(|known| known.map(|unit| scaled(unit, h)))
}

/// Effect on the state at a later instant of a force that begins within the step: weights of its values at the four
/// nodes, which a cubic interpolates.
#[derive(Clone, Copy, Debug, Default)]
pub struct Late {
    /// Weights in x [s²].
    pub x: [f64; 4],
    /// Weights in u [s].
    pub u: [f64; 4],
}

/// A force that begins within the step, in powers of the time since then.
#[derive(Clone, Copy, Debug)]
pub struct Onset {
    from: f64,
    /// `[node]`: coefficients of the node's basis cubic, expanded about `from`.
    powers: [[f64; 4]; 4],
}

impl Onset {
    /// A force that begins at `from`, a fraction of the step.
    pub fn new(from: f64) -> Onset {
        let powers = CUBIC.map(|[a, b, c, d]| {
            let at = a + from * (b + from * (c + from * d));
            let slope = b + from * (2.0 * c + from * (3.0 * d));
            [at, slope, c + from * (3.0 * d), d]
        });
        Onset { from, powers }
    }

    /// The weights at `theta`, in a step of length `h` [s].
    pub fn late(&self, oscillator: Oscillator, h: f64, theta: f64) -> Late {
        let length = theta - self.from;
        if length <= 0.0 {
            return Late::default();
        }
        let p = oscillator.propagator(length * h);
        self.of(length, &p.x, &p.u)
    }

    /// Like [`Onset::late`], without spring and damping.
    pub fn ballistic(&self, h: f64, theta: f64) -> Late {
        let length = theta - self.from;
        if length <= 0.0 {
            return Late::default();
        }
        let t = length * h;
        let u = [t, t / 2.0, t / 3.0, t / 4.0];
        let x = [t * t / 2.0, t * t / 6.0, t * t / 12.0, t * t / 20.0];
        self.of(length, &x, &u)
    }

    /// Weights from the responses `x` and `u` to powers of the time since the force began.
    fn of(&self, length: f64, x: &[f64; 4], u: &[f64; 4]) -> Late {
        let mut late = Late::default();
        for (node, [at, slope, bend, d]) in self.powers.iter().enumerate() {
            let of = |p: &[f64; 4]| at * p[0] + length * (slope * p[1] + length * (bend * p[2] + length * (d * p[3])));
            (late.x[node], late.u[node]) = (of(x), of(u));
        }
        late
    }
}

impl Late {
    /// The weights at `theta` of forces that act from `from` on, in a step of length `h` [s].
    pub fn new(oscillator: Oscillator, h: f64, from: f64, theta: f64) -> Late {
        Onset::new(from).late(oscillator, h, theta)
    }

    /// Like [`Late::new`], without spring and damping.
    pub fn ballistic(h: f64, from: f64, theta: f64) -> Late {
        Onset::new(from).ballistic(h, theta)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ballistic_weights_are_those_of_an_oscillator_without_spring() {
        for (from, theta) in [(0.0, 1.0), (0.3, 0.5), (0.7, 1.0), (0.9, 0.4)] {
            let (found, expected) = (Late::ballistic(0.02, from, theta), Late::new(BALLISTIC, 0.02, from, theta));
            for (found, expected) in found.x.iter().chain(&found.u).zip(expected.x.iter().chain(&expected.u)) {
                assert!((found - expected).abs() < 1e-15, "{from} {theta}: {found:e} {expected:e}");
            }
        }
    }
}
