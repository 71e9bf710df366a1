//! The state of a vertex: its displacement from rest, and the velocity of that.

use glam::DVec3;

/// Displacement from rest and its velocity, in body coordinates.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State {
    /// x [scene unit]
    pub x: DVec3,
    /// u = x′ [scene unit/s]
    pub u: DVec3,
}

impl State {
    /// Whether both are exactly zero.
    pub fn is_zero(&self) -> bool {
        *self == State::default()
    }

    /// √(|u|² + ω²|x|²) [scene unit/s]: it never grows while only the oscillator acts, and bounds |u| and ω|x|.
    pub fn momentum(&self, omega: f64) -> f64 {
        (self.u.length_squared() + omega * omega * self.x.length_squared()).sqrt()
    }

    /// The state after the flow of an oscillator.
    #[inline(always)]
    pub fn after(self, [xx, xu, ux, uu]: [f64; 4]) -> State {
        State { x: xx * self.x + xu * self.u, u: ux * self.x + uu * self.u }
    }
}
