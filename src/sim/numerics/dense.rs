//! Response of an oscillator, at any instant of a step, to forces given at its nodes, including forces that begin
//! within the step.

use std::sync::LazyLock;

use glam::DVec3;

use super::{
    lagrange::THROUGH,
    nodes::{MIDPOINTS, NODES, SAMPLES},
};
use crate::{model::oscillator::Oscillator, sim::state::State};

/// An oscillator without spring and damping: the motion of a centre.
pub const BALLISTIC: Oscillator = Oscillator { omega: 0.0, damping: 0.0 };

/// Dense output of the collocation polynomial: weights that give the state at any instant of a step from the state at
/// its start and the forces at its nodes.
#[derive(Clone, Copy, Debug, Default)]
pub struct Dense {
    /// Flow to that instant: ∂x/∂x₀ [–].
    pub xx: f64,
    /// Flow to that instant: ∂x/∂u₀ [s].
    pub xu: f64,
    /// Flow to that instant: ∂u/∂x₀ [1/s].
    pub ux: f64,
    /// Flow to that instant: ∂u/∂u₀ [–].
    pub uu: f64,
    /// Weight of each node's force in the displacement [s²].
    pub x: [f64; 4],
    /// Weight of each node's force in the velocity [s].
    pub u: [f64; 4],
}

impl Dense {
    /// The dense output at time `theta` h of a step of length `h` [s]; `theta` > 0.
    pub fn new(oscillator: Oscillator, h: f64, theta: f64) -> Dense {
        let p = oscillator.propagator(theta * h);
        let (x, u) = (responses(&THROUGH[4], theta, &p.x), responses(&THROUGH[4], theta, &p.u));
        Dense { xx: p.xx, xu: p.xu, ux: p.ux, uu: p.uu, x, u }
    }

    /// The state at that instant, given the forces at the nodes.
    pub fn state(&self, State { x, u }: State, forces: &[DVec3; 4]) -> State {
        let response = |w: &[f64; 4]| (w[0] * forces[0] + w[1] * forces[1]) + (w[2] * forces[2] + w[3] * forces[3]);
        State { x: self.xx * x + self.xu * u + response(&self.x), u: self.ux * x + self.uu * u + response(&self.u) }
    }
}

/// The response at `theta` h to each polynomial, given the response to the powers of time.
pub fn responses(basis: &[[f64; 4]; 4], theta: f64, powers: &[f64; 4]) -> [f64; 4] {
    let [p0, p1, p2, p3] = *powers;
    basis.map(|[a, b, c, d]| a * p0 + theta * (b * p1 + theta * (c * p2 + theta * (d * p3))))
}

/// `[k]`: effect on x [s²] and on u [s] at the end of a step of a residual that is 1 at midpoint k and 0 at the other
/// midpoints and the nodes, a polynomial of degree six.
pub fn residual(oscillator: Oscillator, h: f64) -> [(f64, f64); 3] {
    // Gauss-Legendre quadrature with eight points
    const GAUSS: [(f64, f64); 4] = [
        (0.183_434_642_495_649_8, 0.362_683_783_378_362),
        (0.525_532_409_916_329, 0.313_706_645_877_887_3),
        (0.796_666_477_413_626_7, 0.222_381_034_453_374_5),
        (0.960_289_856_497_536_3, 0.101_228_536_290_376_3),
    ];
    let mut weights = [(0.0, 0.0); 3];
    for (at, weight) in GAUSS.into_iter().flat_map(|(at, weight)| [(at, weight), (-at, weight)]) {
        let theta = 0.5 + 0.5 * at;
        let [_, xu, _, uu] = oscillator.flow((1.0 - theta) * h);
        for (k, (x, u)) in weights.iter_mut().enumerate() {
            let others = (0..3).filter(|&j| j != k).map(|j| MIDPOINTS[j]).chain(NODES);
            let value: f64 = others.map(|other| (theta - other) / (MIDPOINTS[k] - other)).product();
            *x += 0.5 * h * weight * value * xu;
            *u += 0.5 * h * weight * value * uu;
        }
    }
    weights
}

/// Dense output at each sample after the start of a step of length `h` [s]: at the other three nodes and the middle.
pub fn at_samples(oscillator: Oscillator, h: f64) -> [Dense; 4] {
    std::array::from_fn(|sample| Dense::new(oscillator, h, SAMPLES[sample + 1]))
}

/// Like [`at_samples`], without spring and damping; these weights scale with powers of `h`.
pub fn ballistic(h: f64) -> [Dense; 4] {
    static UNIT: LazyLock<[Dense; 4]> = LazyLock::new(|| at_samples(BALLISTIC, 1.0));
    UNIT.map(|unit| scaled(unit, h))
}

fn scaled(unit: Dense, h: f64) -> Dense {
    Dense { xu: unit.xu * h, x: unit.x.map(|w| w * h * h), u: unit.u.map(|w| w * h), ..unit }
}

/// `[n][i]`: dense output at node i + 1, for the polynomial through the forces at the first n + 1 nodes.
pub fn early(oscillator: Oscillator, h: f64) -> [[Dense; 3]; 3] {
    let at = [1, 2, 3].map(|node| (NODES[node], oscillator.propagator(NODES[node] * h)));
    [1, 2, 3].map(|count| {
        at.map(|(theta, p)| {
            let response = |powers: &[f64; 4]| responses(&THROUGH[count], theta, powers);
            Dense { x: response(&p.x), u: response(&p.u), ..Dense::new(oscillator, h, theta) }
        })
    })
}

/// Like [`early`], without spring and damping.
pub fn early_ballistic(h: f64) -> [[Dense; 3]; 3] {
    static UNIT: LazyLock<[[Dense; 3]; 3]> = LazyLock::new(|| early(BALLISTIC, 1.0));
    UNIT.map(|known| known.map(|unit| scaled(unit, h)))
}
