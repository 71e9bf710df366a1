//! Collocation weights: the exact response of the oscillator to forces at four instants of a step.

use crate::{
    model::oscillator::{Oscillator, Propagator},
    sim::numerics::{
        control::{ASIDE, RESOLVED},
        dense::responses,
        lagrange::{THROUGH, cubic},
        nodes::NODES,
    },
};

/// Weights that give the displacement at an instant of the step from the state at its start and the forces at the
/// nodes.
#[derive(Clone, Copy, Debug, Default)]
pub struct Stage {
    /// Weight of the displacement at the start [–].
    pub xx: f64,
    /// Weight of the velocity at the start [s].
    pub xu: f64,
    /// Weight of the force at each node [s²].
    pub force: [f64; 4],
    /// Weights of the forces at the preceding nodes only, for prediction [s²].
    pub predict: [f64; 4],
}

/// All weights of a step of a given length.
#[derive(Clone, Copy, Debug, Default)]
pub struct Weights {
    /// ω and κ.
    pub oscillator: Oscillator,
    /// The length h of the step [s].
    pub h: f64,
    /// Weights for the displacement at each node; the first node is the start and is not used.
    pub nodes: [Stage; 4],
    /// Weights for the displacement in the middle.
    pub middle: Stage,
    /// Weights for the displacement at `ASIDE`.
    pub aside: Stage,
    /// Weight of each node's force in the polynomial's value in the middle [–].
    pub polynomial: [f64; 4],
    /// Like [`Weights::polynomial`], at `ASIDE`.
    pub polynomial_aside: [f64; 4],
    /// Weight of the displacement at the start in the velocity at the end [1/s].
    pub ux: f64,
    /// Weight of the velocity at the start in the velocity at the end [–].
    pub uu: f64,
    /// Weights of the forces in the velocity at the end [s].
    pub velocity: [f64; 4],
    /// Displacement at the end caused by a constant unit force [s²].
    pub constant: f64,
    /// Largest displacement per error in the velocity, once the oscillator has converted it [s].
    pub swing: f64,
    /// Set if more than `RESOLVED` time scales of the oscillator pass in the step: the samples then cannot distinguish
    /// its oscillation from a polynomial.
    pub ringing: Option<Ringing>,
}

/// Value at `ASIDE` of the quartic that is 1 in the middle and 0 at the nodes [–].
pub const BEND_ASIDE: f64 = 80.0 * ASIDE * (ASIDE - 1.0) * (ASIDE * ASIDE - ASIDE + 0.2);

/// The amplitudes of the free oscillation or decay about the cubic motion under a cubic force [scene unit]. An
/// oscillation has two, and so has a decay at two rates.
pub type Ringing = [Mode; 2];

/// A linear function of a state and of the forces at the nodes.
#[derive(Clone, Copy, Debug, Default)]
pub struct Mode {
    /// Weight of the displacement [–].
    pub x: f64,
    /// Weight of the velocity [s].
    pub u: f64,
    /// Weight of the force at each node [s²].
    pub force: [f64; 4],
}

/// See [`Weights::ringing`]; `None` if the oscillation is slow enough to be resolved in a step of length `h` [s].
fn ringing(Oscillator { omega, damping }: Oscillator, h: f64) -> Option<Ringing> {
    if (omega + 2.0 * damping) * h <= RESOLVED {
        return None;
    }
    // the force Σ pₖ sᵏ/k!
    let derivatives = THROUGH[4].map(|[a, b, c, d]| [a, b / h, 2.0 * c / (h * h), 6.0 * d / (h * h * h)]);
    if damping < 1.1 * omega {
        // the cubic motion x = Σ cₖ sᵏ/k!: ω² cₖ = pₖ − 2κ cₖ₊₁ − cₖ₊₂
        let per_omega2 = 1.0 / (omega * omega);
        let cubic = derivatives.map(|[p0, p1, p2, p3]| {
            let c3 = p3 * per_omega2;
            let c2 = (p2 - 2.0 * damping * c3) * per_omega2;
            let c1 = (p1 - 2.0 * damping * c2 - c3) * per_omega2;
            [(p0 - 2.0 * damping * c1 - c2) * per_omega2, c1]
        });
        let position = Mode { x: 1.0, u: 0.0, force: cubic.map(|[x, _]| -x) };
        let velocity = Mode { x: 0.0, u: 1.0 / omega, force: cubic.map(|[_, u]| -u / omega) };
        return Some([position, velocity]);
    }
    // Two decays: y = u + slow x decays fast, y′ = −fast y + f, and vice versa.
    let mu = ((damping - omega) * (damping + omega)).sqrt();
    let fast = damping + mu;
    let slow = omega * (omega / fast);
    let scale = 0.5 / mu;
    let mode = |rate: f64, other: f64| {
        let cubic = derivatives.map(|p| p.into_iter().rev().fold(0.0, |next, p| (p - next) / rate));
        Mode { x: scale * other, u: scale, force: cubic.map(|y| -scale * y) }
    };
    Some([mode(fast, slow), if slow * h > RESOLVED { mode(slow, fast) } else { Mode::default() }])
}

impl Weights {
    /// The weights of a step of length `h` > 0 [s].
    pub fn new(oscillator: Oscillator, h: f64) -> Weights {
        let whole = oscillator.propagator(h);
        let stage = |theta: f64, n: usize, p: &Propagator| Stage {
            xx: p.xx,
            xu: p.xu,
            force: responses(&THROUGH[4], theta, &p.x),
            predict: responses(&THROUGH[n], theta, &p.x),
        };
        let at = |theta: f64| oscillator.propagator(theta * h);
        Weights {
            oscillator,
            h,
            nodes: [
                Stage::default(),
                stage(NODES[1], 1, &at(NODES[1])),
                stage(NODES[2], 2, &at(NODES[2])),
                stage(1.0, 3, &whole),
            ],
            middle: stage(0.5, 4, &at(0.5)),
            aside: stage(ASIDE, 4, &at(ASIDE)),
            polynomial: cubic(0.5),
            polynomial_aside: cubic(ASIDE),
            ux: whole.ux,
            uu: whole.uu,
            velocity: responses(&THROUGH[4], 1.0, &whole.u),
            constant: whole.x[0],
            swing: 1.0 / oscillator.omega.max(2.0 * oscillator.damping).max(1.0),
            ringing: ringing(oscillator, h),
        }
    }
}

/// Number of step lengths whose weights are cached.
const MAX_WEIGHTS: usize = 24;

/// A cache of weights for a few step lengths.
#[derive(Default)]
pub struct KnownWeights(Vec<Weights>);

impl KnownWeights {
    /// The weights for a step of length `h` [s].
    pub fn get(&mut self, oscillator: Oscillator, h: f64) -> &Weights {
        let is_same = |known: &Weights| known.h == h && known.oscillator == oscillator;
        let known = self.0.iter().position(is_same);
        let index = known.unwrap_or_else(|| {
            if self.0.len() == MAX_WEIGHTS {
                self.0.clear();
            }
            self.0.push(Weights::new(oscillator, h));
            self.0.len() - 1
        });
        &self.0[index]
    }
}

/// Response to the residual of the cubic, which has hardly an effect at the end of a step, but one within it.
///
/// With q = 80 θ(θ − 1)(θ² − θ + 1/5), which vanishes at the nodes and is 1 in the middle, the residual is
/// a q + b (θ − ½) q and higher terms: a is the bend, b follows from the residual of the quartic at `ASIDE`, the skew.
#[derive(Clone, Copy, Debug, Default)]
pub struct Residual {
    /// Weight of the bend in the displacement [s²].
    pub bend_x: f64,
    /// Weight of the bend in the velocity [s].
    pub bend_u: f64,
    /// Weight of the skew in the velocity [s].
    pub skew_u: f64,
}

/// (θ − ½) q at `ASIDE`, see [`Residual`].
pub const SKEW_ASIDE: f64 = (ASIDE - 0.5) * BEND_ASIDE;

impl Residual {
    /// The response at time `theta` h of a step of length `h` [s]; `theta` > 0.
    pub fn new(oscillator: Oscillator, h: f64, theta: f64) -> Residual {
        let t = theta * h;
        let p = oscillator.propagator(t);
        let fourth = fourth_response(oscillator, t, &p);
        // U_k = k X_{k−1}/t
        let (x, u) = ([p.x[1], p.x[2], p.x[3], fourth], [p.u[1], p.u[2], p.u[3], 4.0 * p.x[3] / t, 5.0 * fourth / t]);
        let q = |[a, b, c, d]: [f64; 4]| theta * (-0.2 * a + theta * (1.2 * b + theta * (-2.0 * c + theta * d)));
        let [a, b, c, d, e] = u;
        let skew = theta * (0.1 * a + theta * (-0.8 * b + theta * (2.2 * c + theta * (-2.5 * d + theta * e))));
        Residual { bend_x: 80.0 * q(x), bend_u: 80.0 * q([a, b, c, d]), skew_u: 80.0 / SKEW_ASIDE * skew }
    }
}

/// Number of terms of a series in (ω + 2κ) t ≤ 1; the next one would be below 1/17! ≈ 3e-15.
const SERIES_TERMS: usize = 12;

/// X_4 of an oscillator at `t` [s²]: the response to the force (s/t)⁴, see [`Propagator`].
fn fourth_response(Oscillator { omega, damping }: Oscillator, t: f64, p: &Propagator) -> f64 {
    if (omega + 2.0 * damping) * t <= 1.0 {
        // The impulse response is Σ aₙ (s/t)ⁿ/n! t with aₙ₊₂ = −2κt aₙ₊₁ − (ωt)² aₙ.
        let (mut before, mut current) = (0.0, 1.0);
        let (mut sum, mut per_factorial) = (0.0, 1.0 / 720.0);
        for n in 0..SERIES_TERMS {
            sum += current * per_factorial;
            per_factorial /= n as f64 + 7.0;
            (before, current) = (current, -2.0 * damping * t * current - (omega * t) * (omega * t) * before);
        }
        return 24.0 * t * t * sum;
    }
    if omega * t > 0.3 {
        // x″ = 1 − 2κ x′ − ω² x, with x′ = U_4 = 4 X_3/t and x″ = 12 X_2/t²
        return (1.0 - 12.0 * p.x[2] / (t * t) - 8.0 * damping * p.x[3] / t) / (omega * omega);
    }
    // integrated four times, with the fifth integral of x, which hardly counts, as t/7 times the fourth
    (t / 5.0 - 4.0 * p.x[3] / t) / (2.0 * damping + omega * omega * t / 7.0)
}

impl Weights {
    /// Displacement per error of the force, now or after the oscillator has converted the velocity [s²].
    #[inline(always)]
    pub fn gain(&self) -> f64 {
        self.constant.abs() + self.h * self.swing
    }

    /// Weights for the displacement at a sample: 1 … 3 are the nodes, 4 is the middle.
    #[inline(always)]
    pub fn stage(&self, sample: usize) -> &Stage {
        if sample == 4 { &self.middle } else { &self.nodes[sample] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Compared with the midpoint rule, for slow, fast and damped oscillators.
    #[test]
    fn the_response_to_the_fourth_power_is_its_integral() {
        const PARTS: usize = 2000;
        for (omega, damping, bound) in [(0.0, 0.0, 1e-5), (12.0, 1.5, 1e-5), (90.0, 3.0, 1e-4), (1.0, 80.0, 1e-3)] {
            let (oscillator, t) = (Oscillator { omega, damping }, 0.05);
            let part = |part: usize| {
                let theta = (part as f64 + 0.5) / PARTS as f64;
                oscillator.propagator(t * (1.0 - theta)).xu * theta.powi(4) * t / PARTS as f64
            };
            let expected = (0..PARTS).map(part).sum::<f64>();
            let found = fourth_response(oscillator, t, &oscillator.propagator(t));
            assert!((found - expected).abs() <= bound * expected.abs(), "{omega} {damping}: {found:e} {expected:e}");
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
