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
/// Φ′(r) = r W(r / r_e), Φ(0) = 0: r_e² times [`Weight::potential`]. Outside, it is `r_e²/6` for the linear weight and
/// `r_e²/14` for Wendland's.
pub fn influence_potential(weight: Weight, sphere_radius: f64, distance: f64) -> f64 {
    let z = f64::min(distance / sphere_radius, 1.0);
    weight.potential(z) * sphere_radius * sphere_radius
}

/// ½|u|² [scene unit²/s²].
pub fn kinetic(speed_squared: f64) -> f64 {
    0.5 * speed_squared
}

/// ½ω²|x|² [scene unit²/s²].
pub fn elastic(omega: f64, displacement_squared: f64) -> f64 {
    0.5 * omega * omega * displacement_squared
}
