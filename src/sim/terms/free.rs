//! Terms of scenes with free bodies: gravity, planes, and the reactions to the forces of their spheres. The solver of
//! such scenes computes the forces of planes and the reactions itself; their names are needed for observation.

use glam::DVec3;

use super::{Cause, Term};
use crate::scene::Scene;

pub struct Coupled;

impl Term for Coupled {
    fn free_fall(scene: &Scene) -> Option<(Cause, DVec3)> {
        (scene.gravity != DVec3::ZERO).then_some((Cause::Gravity, scene.gravity))
    }
}
