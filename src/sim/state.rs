//! Stored state of vertices: displacement from rest and its velocity, per vertex and shared by all vertices.

use glam::DVec3;

use crate::scene;

/// Displacement from rest and its velocity, in body coordinates.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State {
    /// x [scene unit]
    pub x: DVec3,
    /// u = x′ [scene unit/s]
    pub u: DVec3,
}

/// The response of a vertex that faces a push squarely, along the push.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pushed {
    /// Displacement along the push [scene unit].
    pub x: f64,
    /// Velocity along the push [scene unit/s].
    pub u: f64,
}

/// The motion that all vertices of a body share. The equation of motion is linear except for the influence, so the
/// response to the body's own motion is one vector for all vertices, and the response to a push is one number, scaled
/// by how squarely each vertex faces the push.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Common {
    /// Response to the body's own motion.
    pub carried: State,
    /// Response to each of the body's pushes, in the order of the scene.
    pub pushed: Vec<Pushed>,
}

impl Common {
    /// Whether the shared motion is zero.
    pub fn is_zero(&self) -> bool {
        self.carried == State::default() && self.pushed.iter().all(|pushed| *pushed == Pushed::default())
    }

    /// Contribution to the displacement and velocity of the vertex whose rest position has the direction `facing`.
    pub fn of(&self, facing: DVec3, pushes: &[scene::Push]) -> State {
        let mut state = self.carried;
        for (pushed, push) in self.pushed.iter().zip(pushes) {
            let along = push.direction * f64::max(0.0, -facing.dot(push.direction));
            state.x += along * pushed.x;
            state.u += along * pushed.u;
        }
        state
    }

    /// Contribution of pushes to the displacement of the vertex whose rest position has the direction `facing`
    /// [scene unit].
    pub fn moved(&self, facing: DVec3, pushes: &[scene::Push]) -> DVec3 {
        self.of(facing, pushes).x - self.carried.x
    }

    /// An upper bound of √(|u|² + ω²|x|²) of a vertex that faces each push as squarely as given, from 0 to 1
    /// [scene unit/s].
    pub fn momentum(&self, omega: f64, facing: impl Iterator<Item = f64>) -> f64 {
        let momentum = |x2: f64, u2: f64| (u2 + omega * omega * x2).sqrt();
        let State { x, u } = self.carried;
        let pushed = self.pushed.iter().zip(facing).map(|(Pushed { x, u }, facing)| facing * momentum(x * x, u * u));
        momentum(x.length_squared(), u.length_squared()) + pushed.sum::<f64>()
    }

    /// Upper bounds over all vertices of |x| [scene unit] and of √(|u|² + ω²|x|²) [scene unit/s] from the shared
    /// motion.
    pub fn bounds(&self, omega: f64) -> (f64, f64) {
        let momentum = |x2: f64, u2: f64| (u2 + omega * omega * x2).sqrt();
        let State { x, u } = self.carried;
        let mut sum = (x.length(), momentum(x.length_squared(), u.length_squared()));
        for Pushed { x, u } in &self.pushed {
            sum = (sum.0 + x.abs(), sum.1 + momentum(x * x, u * u));
        }
        sum
    }
}
