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

/// Instants between the nodes at which the residual of a step is sampled, as fractions of the step.
pub const MIDPOINTS: [f64; 3] = [0.5 * NODES[1], 0.5, 1.0 - 0.5 * NODES[1]];

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

/// Weights of the values at the four nodes in the first and second integral of the cubic through them, up to an instant.
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
        let once = CUBIC.map(|[a, b, c, d]| z * (a + z * (b / 2.0 + z * (c / 3.0 + z * (d / 4.0)))));
        let twice = CUBIC.map(|[a, b, c, d]| z * z * (a / 2.0 + z * (b / 6.0 + z * (c / 12.0 + z * (d / 20.0)))));
        CubicIntegrals { once, twice }
    }
}
