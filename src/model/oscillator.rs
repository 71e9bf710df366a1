//! The damped oscillator (3.2), `x″ = −ω² x − 2κ x′ + f`, and its exact solution.
//!
//! It is linear with constant coefficients, so its flow over a time h is one 2×2 matrix per (ω, κ, h), exact for any
//! stiffness; a force enters through the φ-functions of the same matrix (Hochbruck & Ostermann, Exponential
//! integrators, Acta Numerica 2010). Both follow from the impulse response
//!
//! ```text
//! S(t) = e^(−κt) sinh(μt)/μ,   μ² = κ² − ω²      (sin for κ < ω, t e^(−κt) for κ = ω)
//! ```

/// The largest (ω + 2κ) h for which the series of [`SERIES`] is exact to rounding.
const SHORT: f64 = 0.5;

/// Weights of one term of the series for S in each of the sums.
struct Term {
    /// n! k!/(n + k + 1)!, k = 0 … 3.
    moments: [f64; 4],
    /// 1 / (n (n + 1))
    per_n_and_next: f64,
    /// 1 / (n + 1)
    per_next: f64,
}

/// The terms n = 1 … 14 of the series for S; the next term would be below 0.5¹⁴/15! ≈ 5e-17 of the first.
static SERIES: [Term; 14] = {
    const NONE: Term = Term { moments: [0.0; 4], per_n_and_next: 0.0, per_next: 0.0 };
    let mut terms = [NONE; 14];
    let mut i = 0;
    while i < terms.len() {
        let n = (i + 1) as f64;
        let mut moment = 1.0 / (n + 1.0);
        let mut k = 0;
        while k < 4 {
            terms[i].moments[k] = moment;
            moment *= (k + 1) as f64 / (n + k as f64 + 2.0);
            k += 1;
        }
        terms[i].per_n_and_next = 1.0 / (n * (n + 1.0));
        terms[i].per_next = 1.0 / (n + 1.0);
        i += 1;
    }
    terms
};

/// ω and κ of (3.2).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Oscillator {
    /// Natural angular frequency ω [rad/s], ≥ 0.
    pub omega: f64,
    /// Damping rate κ [1/s], ≥ 0.
    pub damping: f64,
}

/// The exact solution over a time h: `(x, u) ← flow · (x, u)` plus the response to a force that is a polynomial in
/// time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Propagator {
    /// ∂x(h)/∂x(0) [–]
    pub xx: f64,
    /// ∂x(h)/∂u(0) = S(h) [s]
    pub xu: f64,
    /// ∂u(h)/∂x(0) [1/s]
    pub ux: f64,
    /// ∂u(h)/∂u(0) [–]
    pub uu: f64,
    /// Contributions of the forces (s/h)ᵏ, k = 0 … 3, to x: X_k = ∫₀ʰ S(h − s) (s/h)ᵏ ds [s²]; k! times the φ-functions
    /// of the flow's matrix.
    pub x: [f64; 4],
    /// Contributions of these forces to u: U_k = ∫₀ʰ S′(h − s) (s/h)ᵏ ds = k X_{k−1}/h, U_0 = S(h) [s].
    pub u: [f64; 4],
}

impl Oscillator {
    /// The exact propagator over `h` > 0 [s].
    pub fn propagator(&self, h: f64) -> Propagator {
        let Oscillator { omega, damping } = *self;
        if (omega + 2.0 * damping) * h <= SHORT {
            return self.short_propagator(h);
        }
        let [xx, xu, ux, uu] = self.flow(h);
        let x = self.responses(h, xx, xu);
        Propagator { xx, xu, ux, uu, x, u: [xu, x[0] / h, 2.0 * (x[1] / h), 3.0 * (x[2] / h)] }
    }

    /// The propagator over a time that is short for the oscillator, by the Taylor series S = Σ a_n tⁿ: S″ = −ω²S −
    /// 2κS′, so (n+2)(n+1) a_{n+2} = −ω² a_n − 2κ (n+1) a_{n+1}. With b_n = a_n hⁿ the terms decay like zⁿ/n!, z = (ω +
    /// 2κ) h, and ∫₀¹ (1 − θ)ⁿ θᵏ dθ = n! k!/(n + k + 1)!.
    fn short_propagator(&self, h: f64) -> Propagator {
        let Oscillator { omega, damping } = *self;
        let (a, b) = (-(omega * h) * (omega * h), -2.0 * damping * h);
        let (mut before, mut current) = (0.0, 1.0);
        // divided by h; the first term is by far the largest and is added last, so that only that addition rounds
        let (mut s, mut slope, mut sums) = (0.0, 0.0, [0.0; 4]);
        for (n, row) in (1..).zip(&SERIES) {
            if n > 1 {
                s += current;
                slope += f64::from(n) * current;
                for (sum, weight) in sums.iter_mut().zip(&row.moments) {
                    *sum += current * weight;
                }
            }
            (before, current) = (current, a * before * row.per_n_and_next + b * current * row.per_next);
        }
        let first = &SERIES[0].moments;
        let (s, uu) = (h * (1.0 + s), 1.0 + slope);
        let xx = 1.0 + (slope + 2.0 * damping * s);
        let m: [f64; 4] = std::array::from_fn(|k| h * (first[k] + sums[k]));
        Propagator {
            xx,
            xu: s,
            ux: -omega * omega * s,
            uu: if damping == 0.0 { xx } else { uu },
            x: m.map(|m| m * h),
            u: [s, m[0], 2.0 * m[1], 3.0 * m[2]],
        }
    }

    /// The flow alone over `h` ≥ 0 [s]: ∂x/∂x₀ [–], ∂x/∂u₀ [s], ∂u/∂x₀ [1/s], ∂u/∂u₀ [–].
    pub fn flow(&self, h: f64) -> [f64; 4] {
        let [xx, xu, uu] = self.modes(h);
        [xx, xu, -self.omega * self.omega * xu, if self.damping == 0.0 { xx } else { uu }]
    }

    /// `[xx, xu, uu]`: x = e^(−κt) (C + κS̃) x₀ + e^(−κt) S̃ u₀ with C = cosh μt, S̃ = sinh(μt)/μ.
    fn modes(&self, h: f64) -> [f64; 3] {
        let Oscillator { omega, damping } = *self;
        // κ² − ω² without cancellation, and without overflow unless a factor overflows
        let discriminant = (damping - omega) * (damping + omega);
        if discriminant < 0.0 {
            let nu = (-discriminant).sqrt();
            let (sin, cos) = libm::sincos(nu * h);
            let s = if nu * h < 1e-4 { h * (1.0 - (nu * h) * (nu * h) / 6.0) } else { sin / nu };
            let decay = libm::exp(-damping * h);
            [decay * (cos + damping * s), decay * s, decay * (cos - damping * s)]
        } else {
            // Overdamped: factor out the slow mode e^(−slow·t), slow = κ − μ = ω²/(κ + μ); what remains is
            // E = e^(−2μt) ≤ 1: nothing overflows, and all terms of xx and xu are positive.
            let mu = discriminant.sqrt();
            let slow = if omega == 0.0 { 0.0 } else { omega * (omega / (damping + mu)) };
            let decay = libm::exp(-slow * h);
            let y = 2.0 * mu * h;
            let fading = -libm::expm1(-y); // 1 − E
            let s = if y < 1e-8 { h * (1.0 - y / 2.0) } else { fading / (2.0 * mu) };
            let xx = decay * (1.0 + slow * s);
            let uu = decay * (1.0 - (damping + mu) * s);
            // away from t = 0, 1 − (κ + μ) s cancels; use 2μ uu = −slow + (κ + μ) E there
            let uu = if y > 1.0 { decay * ((damping + mu) * libm::exp(-y) - slow) / (2.0 * mu) } else { uu };
            [xx, decay * s, uu]
        }
    }

    /// The X_k of [`Propagator`].
    fn responses(&self, h: f64, xx: f64, xu: f64) -> [f64; 4] {
        let Oscillator { omega, damping } = *self;
        if (omega + 2.0 * damping) * h <= 3.0 {
            // The series of `short_propagator`, with more terms.
            let (a, b) = (-(omega * h) * (omega * h), -2.0 * damping * h);
            let (mut before, mut current) = (0.0, h);
            let mut sums = [0.0; 4];
            for n in 1..40 {
                let n = f64::from(n);
                let mut integral = current / (n + 1.0);
                for (sum, k) in sums.iter_mut().zip([1.0, 2.0, 3.0, 4.0]) {
                    *sum += integral;
                    integral *= k / (n + k + 1.0);
                }
                (before, current) = (current, (a * before / n + b * current) / (n + 1.0));
            }
            sums.map(|sum| sum * h)
        } else if damping >= 1.1 * omega {
            // Two separate real modes −slow, −fast: S is the difference of their exponentials over 2μ.
            let mu = ((damping - omega) * (damping + omega)).sqrt();
            let fast = damping + mu;
            let slow = omega * (omega / fast);
            let (slow, fast) = (moments(-slow * h), moments(-fast * h));
            std::array::from_fn(|k| h / (2.0 * mu) * (slow[k] - fast[k]))
        } else {
            // Put x = X_k into the equation of motion at the end of the ramp: ω²X_k = 1 − 2κU_k − U_k′.
            let per_omega2 = 1.0 / (omega * omega);
            let x0 = (1.0 - xx) * per_omega2;
            let x1 = (1.0 - (2.0 * damping * x0 + xu) / h) * per_omega2;
            let x2 = (1.0 - (4.0 * damping * x1 + 2.0 * x0 / h) / h) * per_omega2;
            let x3 = (1.0 - (6.0 * damping * x2 + 6.0 * x1 / h) / h) * per_omega2;
            [x0, x1, x2, x3]
        }
    }
}

/// ∫₀¹ e^((1−θ)z) θᵏ dθ = k! φ_{k+1}(z), k = 0 … 3, for real z ≤ 0.
fn moments(z: f64) -> [f64; 4] {
    if z > -3.0 {
        // Σ zⁿ k!/(n + k + 1)!
        std::array::from_fn(|k| {
            let k = k as f64;
            let (mut term, mut sum) = (1.0 / (k + 1.0), 0.0);
            for n in 1..40 {
                sum += term;
                term *= z / (f64::from(n) + k + 1.0);
            }
            sum
        })
    } else {
        // by parts: z m_k = k m_{k−1} − 1
        let m0 = libm::expm1(z) / z;
        let m1 = (m0 - 1.0) / z;
        let m2 = (2.0 * m1 - 1.0) / z;
        [m0, m1, m2, (3.0 * m2 - 1.0) / z]
    }
}
