//! The damped oscillator (3.2), `x″ = −ω² x − 2κ x′ + f`, and its exact solution.
//!
//! It is linear with constant coefficients, so its flow over a time h is one 2×2 matrix per (ω, κ, h), exact for any
//! stiffness; a force enters through the φ-functions of the same matrix (Hochbruck & Ostermann, Exponential
//! integrators, Acta Numerica 2010). Both follow from the impulse response
//!
//! ```text
//! S(t) = e^(−κt) sinh(μt)/μ,   μ² = κ² − ω²      (sin for κ < ω, t e^(−κt) for κ = ω)
//! ```

/// ω and κ of (3.2).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Oscillator {
    /// Natural angular frequency ω [rad/s], ≥ 0.
    pub omega: f64,
    /// Damping rate κ [1/s], ≥ 0.
    pub damping: f64,
}

/// The exact solution over a time h: `(x, u) ← flow · (x, u)` plus the response to a force linear in time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Propagator {
    /// ∂x(h)/∂x(0) [–]
    pub xx: f64,
    /// ∂x(h)/∂u(0) = S(h) [s]; also what a constant unit force adds to u.
    pub xu: f64,
    /// ∂u(h)/∂x(0) [1/s]
    pub ux: f64,
    /// ∂u(h)/∂u(0) [–]
    pub uu: f64,
    /// What a constant unit force adds to x, ∫₀ʰ S(h − s) ds [s²].
    pub constant: f64,
    /// What a force rising linearly from 0 to 1 adds to x, ∫₀ʰ S(h − s) s/h ds [s²].
    pub ramp: f64,
    /// What that force adds to u, ∫₀ʰ S′(h − s) s/h ds = constant / h [s].
    pub ramp_u: f64,
}

impl Oscillator {
    /// The exact propagator over `h` > 0 [s].
    pub fn propagator(&self, h: f64) -> Propagator {
        let Oscillator { omega, damping } = *self;
        let [xx, xu, uu] = self.flow(h);
        let [constant, ramp] = self.responses(h, xx, xu);
        Propagator {
            xx,
            xu,
            ux: -omega * omega * xu,
            uu: if damping == 0.0 { xx } else { uu },
            constant,
            ramp,
            ramp_u: constant / h,
        }
    }

    /// `[xx, xu, uu]`: x = e^(−κt) (C + κS̃) x₀ + e^(−κt) S̃ u₀ with C = cosh μt, S̃ = sinh(μt)/μ.
    fn flow(&self, h: f64) -> [f64; 3] {
        let Oscillator { omega, damping } = *self;
        // κ² − ω² without cancellation, and without overflow where the factors don't
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
            // far from t = 0, 1 − (κ + μ) s cancels; there 2μ uu = −slow + (κ + μ) E directly
            let uu = if y > 1.0 { decay * ((damping + mu) * libm::exp(-y) - slow) / (2.0 * mu) } else { uu };
            [xx, decay * s, uu]
        }
    }

    /// `[constant, ramp]` of [`Propagator`].
    fn responses(&self, h: f64, xx: f64, xu: f64) -> [f64; 2] {
        let Oscillator { omega, damping } = *self;
        if (omega + damping) * h <= 1.0 {
            // Taylor series of S: S″ = −ω²S − 2κS′, so (n+2)(n+1) a_{n+2} = −ω² a_n − 2κ (n+1) a_{n+1}. With
            // b_n = a_n hⁿ the terms shrink like 1/n!; 24 of them leave nothing.
            let (a, b) = (-(omega * h) * (omega * h), -2.0 * damping * h);
            let (mut before, mut current) = (0.0, h);
            let (mut constant, mut ramp) = (0.0, 0.0);
            for n in 1..24 {
                let n = f64::from(n);
                constant += current / (n + 1.0);
                ramp += current / ((n + 1.0) * (n + 2.0));
                (before, current) = (current, (a * before / n + b * current) / (n + 1.0));
            }
            [constant * h, ramp * h]
        } else if damping >= 2.0 * omega {
            // Two well separated real modes −slow, −fast: S is the difference of their exponentials over 2μ.
            let mu = ((damping - omega) * (damping + omega)).sqrt();
            let fast = damping + mu;
            let slow = omega * (omega / fast);
            let scale = h / (2.0 * mu);
            [scale * (phi1(-slow * h) - phi1(-fast * h)), scale * (phi2(-slow * h) - phi2(-fast * h))]
        } else {
            // The steady states of a constant and of a ramp, and the oscillation that brings them to 0 at t = 0.
            let per_omega2 = 1.0 / (omega * omega);
            let constant = (1.0 - xx) * per_omega2;
            [constant, per_omega2 * (1.0 - (2.0 * damping * constant + xu) / h)]
        }
    }
}

/// φ₁(z) = (eᶻ − 1)/z for real z ≤ 0.
fn phi1(z: f64) -> f64 {
    if z == 0.0 { 1.0 } else { libm::expm1(z) / z }
}

/// φ₂(z) = (φ₁(z) − 1)/z for real z ≤ 0.
fn phi2(z: f64) -> f64 {
    if z > -0.5 {
        // Σ zᵏ/(k+2)!
        let (mut term, mut sum) = (0.5, 0.0);
        for k in 3..20 {
            sum += term;
            term *= z / f64::from(k);
        }
        sum
    } else {
        (phi1(z) - 1.0) / z
    }
}
