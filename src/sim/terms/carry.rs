//! Carry: the inertial response of a body's vertices to its own motion.

use glam::DVec3;

use super::{Cause, On, Term};
use crate::{
    scene::{
        Material, Path, Response, Scene,
        path::{Bounds, Kinematics},
    },
    sim::span::Span,
};

pub struct Carry;

/// The jump of the velocities of a body's vertices at time `t` due to the jump of its centre's velocity [scene unit/s]:
/// the vertices keep their world velocity, unless the body is rigid. A centre that jumps between positions takes the
/// vertices along. At t = 0 every velocity is zero.
pub fn kick(material: &Material, path: &Path, t: f64) -> DVec3 {
    match material.response {
        Response::Inertial | Response::World if t > 0.0 => -path.kick(t),
        _ => DVec3::ZERO,
    }
}

/// The inertial acceleration that is subtracted from the vertices of a body for its own motion, in the axes of the body
/// [scene unit/s²].
pub fn carry(material: &Material, motion: &Kinematics) -> DVec3 {
    match material.response {
        Response::Rigid => DVec3::ZERO,
        Response::Inertial => motion.acceleration,
        Response::World => motion.acceleration + 2.0 * material.damping * motion.velocity,
    }
}

impl Term for Carry {
    fn uniform(_: &Scene, material: &Material, motion: &Kinematics) -> Option<(Cause, DVec3)> {
        let carry = carry(material, motion);
        (carry != DVec3::ZERO).then_some((Cause::Carry, -carry))
    }

    fn own_bound<P>(on: &On<'_, P>, span: Span) -> f64 {
        let material = on.material;
        let Some(mover) = on.tracks.of(on.index as usize) else { return 0.0 };
        let Bounds { speed, acceleration } = mover.bounds;
        // a velocity jump acts on a vertex like the same change spread over the step
        let kicked = || if mover.kicks > 0.0 { acceleration + mover.kicks / span.length() } else { acceleration };
        match material.response {
            Response::Rigid => 0.0,
            Response::Inertial => kicked(),
            Response::World => kicked() + 2.0 * material.damping * speed,
        }
    }
}
