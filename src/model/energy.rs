//! Energy per vertex and unit mass, for fixed centres and constant phases:
//!
//! ```text
//! E = ½|u|² + ½ω²|x|² + Σ_j s_j Φ(|c_j − r_i|),   force of source j = −∇(s_j Φ)
//! ```
//!
//! It is constant for κ = 0 and never grows for κ > 0.

use super::influence::Weight;

/// Φ(r), the potential of one influence sphere of unit strength, r from its centre [scene unit²].
///
/// Φ′(r) = r W(r / r_e), Φ(0) = 0. Linear weight: `r²/2 − r³/(3 r_e)` inside, `r_e²/6` outside. Wendland: the
/// integral of `z(1 − z)⁴(4z + 1)`, which is `z²/2 − 5z⁴/2 + 4z⁵ − 5z⁶/2 + 4z⁷/7`, times r_e²; `r_e²/14` outside.
pub fn influence_potential(weight: Weight, sphere_radius: f64, distance: f64) -> f64 {
    let z = f64::min(distance / sphere_radius, 1.0);
    let z2 = z * z;
    let phi = match weight {
        Weight::Linear => z2 * (1.0 / 2.0 - z / 3.0),
        Weight::Wendland => z2 * (0.5 + z2 * (-2.5 + z * (4.0 + z * (-2.5 + z * (4.0 / 7.0))))),
    };
    phi * sphere_radius * sphere_radius
}

/// ½|u|² [scene unit²/s²].
pub fn kinetic(speed_squared: f64) -> f64 {
    0.5 * speed_squared
}

/// ½ω²|x|² [scene unit²/s²].
pub fn elastic(omega: f64, displacement_squared: f64) -> f64 {
    0.5 * omega * omega * displacement_squared
}
