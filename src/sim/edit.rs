//! Changes to a world between steps: adding and removing bodies, pushes, other motions.
//!
//! The result is the same as if the scene had contained the change: pushes and bodies added before they begin to act
//! lead to bit-identical states.

use super::{report::EditError, world::World};
use crate::scene::{Body, Force, Motion, Push, Scene};

impl World {
    /// Adds a body and returns its index. A free body starts now, with the position and velocity of its motion.
    ///
    /// # Errors
    /// [`EditError`]; the world is then unchanged.
    pub fn add(&mut self, body: Body) -> Result<usize, EditError> {
        let mut scene = self.scene().clone();
        if scene.bodies.iter().any(|other| other.name == body.name) {
            return Err(EditError::Name(body.name));
        }
        scene.bodies.push(body);
        let last = scene.bodies.len() - 1;
        let kept: Vec<Option<usize>> = (0..last).map(Some).chain([None]).collect();
        self.restart_now(scene, &kept, false)?;
        Ok(last)
    }

    /// Removes a body and its pushes; the indices of later bodies decrease by one. All other bodies wake.
    ///
    /// # Errors
    /// [`EditError`]; the world is then unchanged.
    pub fn remove(&mut self, index: usize) -> Result<(), EditError> {
        let mut scene = self.scene().clone();
        match () {
            () if index >= scene.bodies.len() => return Err(EditError::NoBody(index)),
            () if scene.bodies.len() == 1 => return Err(EditError::LastBody),
            () if !scene.pairs.is_empty() => return Err(EditError::Laws),
            () => {}
        }
        scene.bodies.remove(index);
        scene.pushes.retain(|push| push.body != index);
        scene.pushes.iter_mut().filter(|push| push.body > index).for_each(|push| push.body -= 1);
        scene.points.iter_mut().for_each(|point| point.remove_body(index));
        scene.edits.iter_mut().for_each(|edit| edit.remove_body(index));
        let kept: Vec<Option<usize>> = (0..=scene.bodies.len()).filter(|&old| old != index).map(Some).collect();
        self.restart_now(scene, &kept, true)
    }

    /// Pushes a body.
    ///
    /// # Errors
    /// [`EditError`]; the world is then unchanged.
    pub fn push(&mut self, push: Push) -> Result<(), EditError> {
        let mut scene = self.scene().clone();
        if push.body >= scene.bodies.len() {
            return Err(EditError::NoBody(push.body));
        }
        scene.pushes.push(push);
        let kept: Vec<Option<usize>> = (0..scene.bodies.len()).map(Some).collect();
        self.restart_now(scene, &kept, false)
    }

    /// Sets or removes the force on a free body from now on. All bodies wake.
    ///
    /// # Errors
    /// [`EditError`]; the world is then unchanged.
    pub fn set_force(&mut self, index: usize, force: Option<Force>) -> Result<(), EditError> {
        let mut scene = self.scene().clone();
        let body = scene.bodies.get_mut(index).ok_or(EditError::NoBody(index))?;
        if body.path().is_some() {
            return Err(EditError::OnPath(body.name.clone()));
        }
        body.force = force;
        let kept: Vec<Option<usize>> = (0..scene.bodies.len()).map(Some).collect();
        self.restart_now(scene, &kept, true)
    }

    /// Sets the motion of a body from now on: a path, which may be a function ([`Given`](crate::scene::path::Given)),
    /// or free motion. The body becomes undeformed; all other bodies wake.
    ///
    /// # Errors
    /// [`EditError`]; the world is then unchanged.
    pub fn set_motion(&mut self, index: usize, motion: Motion) -> Result<(), EditError> {
        let mut scene = self.scene().clone();
        scene.bodies.get_mut(index).ok_or(EditError::NoBody(index))?.motion = motion;
        let kept: Vec<Option<usize>> = (0..scene.bodies.len()).map(|old| (old != index).then_some(old)).collect();
        self.restart_now(scene, &kept, true)
    }

    fn restart_now(&mut self, scene: Scene, kept: &[Option<usize>], wake_all: bool) -> Result<(), EditError> {
        self.restart(scene, kept, wake_all, self.time())
    }
}
