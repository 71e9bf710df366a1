//! Cubic Hermite interpolation of motions.

use glam::{DQuat, DVec3};

/// The weights of a cubic Hermite interpolation at one instant. Its error is h⁴/384 times the fourth derivative, at most,
/// over an interval h.
#[derive(Clone, Copy, Debug)]
pub struct Hermite {
    /// Factors of the values at both ends.
    pub values: [f64; 2],
    /// Factors of the derivatives at both ends [s].
    pub rates: [f64; 2],
}

impl Hermite {
    /// The weights at `time`, between two others [s].
    pub fn new([start, end]: [f64; 2], time: f64) -> Hermite {
        let length = end - start;
        let z = if length > 0.0 { ((time - start) / length).clamp(0.0, 1.0) } else { 1.0 };
        let first = (1.0 - z) * (1.0 - z) * (1.0 + 2.0 * z);
        Hermite {
            values: [first, 1.0 - first],
            rates: [z * (1.0 - z) * (1.0 - z) * length, -z * z * (1.0 - z) * length],
        }
    }

    /// Interpolates a vector, given its values and derivatives at both ends.
    pub fn vector(&self, values: [DVec3; 2], rates: [DVec3; 2]) -> DVec3 {
        values[0] * self.values[0] + values[1] * self.values[1] + rates[0] * self.rates[0] + rates[1] * self.rates[1]
    }

    /// Interpolates a rotation, given the angular velocities at both ends [rad/s].
    pub fn rotation(&self, [from, to]: [DQuat; 2], [start, end]: [DVec3; 2]) -> DQuat {
        // the rotation since the start as a rotation vector, whose rate is J⁻¹ times the angular velocity
        let turned = to * from.inverse();
        let turn = (if turned.w < 0.0 { -turned } else { turned }).to_scaled_axis();
        let rate = end - 0.5 * turn.cross(end) + turn.cross(turn.cross(end)) / 12.0;
        let turn = self.vector([DVec3::ZERO, turn], [start, rate]);
        (DQuat::from_scaled_axis(turn) * from).normalize()
    }
}
