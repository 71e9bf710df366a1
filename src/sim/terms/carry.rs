//! Carry: the inertial response of a body's vertices to its own motion.

use glam::DVec3;

use super::{Cause, On, Term};
use crate::{
    scene::{Response, Scene, path::Kinematics},
    sim::span::Span,
};

pub struct Carry;

impl Term for Carry {
    fn uniform(scene: &Scene, index: usize, motion: &Kinematics) -> Option<(Cause, DVec3)> {
        let material = &scene.bodies[index].material;
        let carry = match material.response {
            Response::Rigid => DVec3::ZERO,
            Response::Inertial => motion.acceleration,
            Response::World => motion.acceleration + 2.0 * material.damping * motion.velocity,
        };
        (carry != DVec3::ZERO).then_some((Cause::Carry, -carry))
    }

    fn own_bound<P>(on: &On<'_, P>, _: Span) -> f64 {
        let material = &on.scene.bodies[on.index as usize].material;
        on.tracks.bounds(on.index as usize).map_or(0.0, |motion| match material.response {
            Response::Rigid => 0.0,
            Response::Inertial => motion.acceleration,
            Response::World => motion.acceleration + 2.0 * material.damping * motion.speed,
        })
    }
}
