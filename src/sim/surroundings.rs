//! What acts on the vertices of one body at one instant, but for its own oscillators: the right-hand side of the
//! equation of motion beyond (3.2), in body coordinates.

use glam::DVec3;

use crate::{
    model::{
        influence::{self, Weight},
        phase::Phase,
    },
    scene::{Push, Response, path::Kinematics},
};

/// An influence sphere of another body, seen from the body acted on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Source {
    /// Index of the body that it belongs to.
    pub body: u32,
    /// Its centre relative to the centre of the body acted on, c_j − c_i [scene unit].
    pub centre: DVec3,
    /// Its radius r_e [scene unit].
    pub sphere_radius: f64,
    /// Signed strength [1/s²]: positive attracts, negative repels.
    pub strength: f64,
    /// The phase of the pair, from which that follows.
    pub phase: Phase,
}

/// What acts on a body's vertices at one instant.
#[derive(Clone, Debug, Default)]
pub struct Surroundings {
    /// The influence spheres that can reach the body.
    pub sources: Vec<Source>,
    /// The pushes that act.
    pub pushes: Vec<Push>,
    /// How the body feels its own motion; subtracted from the acceleration [scene unit/s²].
    pub carry: DVec3,
}

impl Surroundings {
    /// Σ_j s_j (c_j − r_i) W + push − carry, for the vertex with rest position `rest`, whose direction is `facing`, and
    /// displacement `x` [scene unit/s²].
    #[inline]
    pub fn acceleration(&self, weight: Weight, facing: DVec3, rest: DVec3, x: DVec3) -> DVec3 {
        let position = rest + x;
        let mut acceleration = DVec3::ZERO;
        for source in &self.sources {
            let to_centre = source.centre - position;
            acceleration += influence::acceleration(weight, source.strength, source.sphere_radius, to_centre);
        }
        for push in &self.pushes {
            acceleration += push_acceleration(push, facing);
        }
        acceleration - self.carry
    }

    /// Whether nothing acts: a body at rest stays at rest.
    pub fn is_idle(&self) -> bool {
        self.sources.iter().all(|source| source.strength == 0.0)
            && self.pushes.iter().all(|push| push.strength == 0.0)
            && self.carry == DVec3::ZERO
    }
}

/// Fig. 4.1: vertices that face the push accelerate along it by `strength · max(0, −l̂·d)` [scene unit/s²]; `facing` is l̂.
#[inline]
pub fn push_acceleration(push: &Push, facing: DVec3) -> DVec3 {
    push.direction * (push.strength * f64::max(0.0, -facing.dot(push.direction)))
}

/// Whether a push acts at time `t` [s].
pub fn push_acts(push: &Push, t: f64) -> bool {
    push.start <= t && t < push.end()
}

/// The acceleration that a body's vertices feel from its own motion, by its response [scene unit/s²].
pub fn carry(response: Response, damping: f64, motion: &Kinematics) -> DVec3 {
    match response {
        Response::Rigid => DVec3::ZERO,
        Response::Inertial => motion.acceleration,
        Response::World => motion.acceleration + 2.0 * damping * motion.velocity,
    }
}
