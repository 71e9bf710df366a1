//! The closed form of a vertex outside all influence: pushes, and the body's own motion on a line or a sine.
//!
//! Derived from the characteristic roots, independently of [`oscillator`](crate::model::oscillator).

use std::f64::consts::TAU;

use glam::DVec3;

use crate::{
    bench::path,
    scene::{Body, Path, Response, Scene},
};

/// A displacement, and the size of the terms of its sum.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exact {
    /// Displacement x [scene unit].
    pub x: DVec3,
    /// Sum of the terms' magnitudes, to which rounding errors are relative [scene unit].
    pub terms: f64,
}

/// The displacement at time `t` [s] of the vertex of body `index` whose rest position has the direction `facing`;
/// `None` if there is no closed form.
pub fn displacement(scene: &Scene, index: usize, facing: DVec3, t: f64) -> Option<Exact> {
    let body = &scene.bodies[index];
    let (omega, damping) = (body.material.omega, body.material.damping);
    let mut exact = Exact { x: DVec3::ZERO, terms: 0.0 };
    let mut add = |x: DVec3| {
        exact.x += x;
        exact.terms += x.length();
    };
    for push in scene.pushes.iter().filter(|push| push.body == index) {
        let force = push.direction * (push.strength * f64::max(0.0, -facing.dot(push.direction)));
        add(force * step_response(omega, damping, t - push.start));
        add(-force * step_response(omega, damping, t - push.end()));
    }
    match (path(body), body.material.response) {
        (Path::Fixed(_), _) | (_, Response::Rigid) | (Path::Line { .. }, Response::Inertial) => {}
        (Path::Line { velocity, .. }, Response::World) => {
            add(-2.0 * damping * *velocity * step_response(omega, damping, t));
        }
        (Path::Sine { .. }, _) => swing(body, t, &mut add)?,
        (Path::Keyframes(_) | Path::Given(_), _) => return None,
    }
    Some(exact)
}

/// The response to the body's own motion on a sine: x = Im(Z e^(i(Ωt + φ))), plus the transient of the start from rest.
fn swing(body: &Body, t: f64, add: &mut impl FnMut(DVec3)) -> Option<()> {
    let Path::Sine { amplitude, frequency, phase, .. } = *path(body) else { return None };
    let (omega, damping) = (body.material.omega, body.material.damping);
    let rate = TAU * frequency;
    // Z (ω² − Ω² + 2iκΩ) = Ω² − 2iκΩ, the last term only if damping is relative to the world
    let carried = if body.material.response == Response::World { -2.0 * damping * rate } else { 0.0 };
    let (a, b) = ((omega - rate) * (omega + rate), 2.0 * damping * rate);
    let size = a * a + b * b;
    if size < 1e-4 * (omega * omega + rate * rate).powi(2) {
        return None; // near resonance: a difference of large numbers
    }
    let (re, im) = ((rate * rate * a + carried * b) / size, (carried * a - rate * rate * b) / size);
    let at = |angle: f64| {
        let (sin, cos) = libm::sincos(angle);
        (re * sin + im * cos, rate * (re * cos - im * sin))
    };
    let ((x, _), (x0, u0)) = (at(rate * t + phase), at(phase));
    let (by_displacement, by_velocity) = flow(omega, damping, t);
    add(amplitude * x);
    add(-amplitude * (x0 * by_displacement));
    add(-amplitude * (u0 * by_velocity));
    Some(())
}

/// ∂x(t)/∂x(0) [–] and ∂x(t)/∂u(0) = S(t) [s] of the oscillator.
fn flow(omega: f64, damping: f64, t: f64) -> (f64, f64) {
    let difference = (damping - omega) * (damping + omega) * t * t;
    if difference.abs() < 1.0 {
        // cosh √d and sinh √d / √d by their series, for either sign
        let (mut cosh, mut sinhc, mut term) = (0.0, 0.0, 1.0);
        for n in 1..16 {
            let n = f64::from(n);
            cosh += term;
            sinhc += term / (2.0 * n - 1.0);
            term *= difference / (2.0 * n * (2.0 * n - 1.0));
        }
        let decay = (-damping * t).exp();
        (decay * (cosh + damping * t * sinhc), decay * t * sinhc)
    } else if difference < 0.0 {
        let nu = ((omega - damping) * (omega + damping)).sqrt();
        let (sin, cos) = (nu * t).sin_cos();
        let decay = (-damping * t).exp();
        (decay * (cos + damping / nu * sin), decay * sin / nu)
    } else {
        let mu = ((damping - omega) * (damping + omega)).sqrt();
        let (slow, fast) = (omega / (damping + mu) * omega, damping + mu);
        let (slowly, fast_decay) = ((-slow * t).exp(), (-fast * t).exp());
        ((fast * slowly - slow * fast_decay) / (2.0 * mu), (slowly - fast_decay) / (2.0 * mu))
    }
}

/// ∫₀ᵗ S: the displacement under a constant unit force that starts at time 0 [s²].
fn step_response(omega: f64, damping: f64, t: f64) -> f64 {
    if t <= 0.0 {
        return 0.0;
    }
    if (omega + damping) * t < 4.0 {
        // Gauss–Legendre, ten points in each of eight panels
        let panel = t / 8.0;
        let at = |s: f64| flow(omega, damping, s).1;
        let pair = |middle: f64, (node, weight): (f64, f64)| {
            0.5 * panel * weight * (at(middle - 0.5 * panel * node) + at(middle + 0.5 * panel * node))
        };
        return (0..8).map(|k| GAUSS.map(|point| pair((f64::from(k) + 0.5) * panel, point)).iter().sum::<f64>()).sum();
    }
    if damping > 1.01 * omega {
        let mu = ((damping - omega) * (damping + omega)).sqrt();
        let (slow, fast) = (omega / (damping + mu) * omega, damping + mu);
        let slowly = if slow * t < 1e-300 { t } else { -(-slow * t).exp_m1() / slow };
        return (slowly + (-fast * t).exp_m1() / fast) / (2.0 * mu);
    }
    (1.0 - flow(omega, damping, t).0) / (omega * omega)
}

/// Positive nodes and their weights on [−1, 1]; the nodes are symmetric.
const GAUSS: [(f64, f64); 5] = [
    (0.148_874_338_981_631_22, 0.295_524_224_714_752_87),
    (0.433_395_394_129_247_2, 0.269_266_719_309_996_35),
    (0.679_409_568_299_024_4, 0.219_086_362_515_982_04),
    (0.865_063_366_688_984_5, 0.149_451_349_150_580_6),
    (0.973_906_528_517_171_7, 0.066_671_344_308_688_14),
];
