//! Changes to a world between steps: adding and removing bodies, pushes, forces, other motions.
//!
//! The result is the same as if the scene had contained the change: pushes and bodies added before they begin to act
//! lead to bit-identical states.
//!
//! In worlds with free bodies, planes or cores with a width, [`World::set_force`], [`World::push`] and [`World::add`]
//! change the body in question; all other changes build the world anew, in time proportional to its size.

use super::{
    handle::{BodyHandle, BodyId},
    memory,
    report::EditError,
    solver::Solver,
    world::World,
};
use crate::scene::{Body, Force, Motion, Push, Scene};

impl World {
    /// Adds a body and returns its handle; its index is the last one. A free body starts now, with the position and
    /// velocity of its motion.
    ///
    /// # Errors
    /// [`EditError::Invalid`] for a body that no scene file could have, [`EditError::Name`], [`EditError::Solver`],
    /// [`EditError::TooLarge`]; the world is then unchanged.
    pub fn add(&mut self, body: Body) -> Result<BodyHandle, EditError> {
        body.validate(|part| format!("body.{part}"))?;
        if self.scene.bodies.iter().any(|other| other.name == body.name) {
            return Err(EditError::Name(body.name));
        }
        if matches!(self.solver, Solver::Coupled(_)) {
            self.scene.add_body(body);
            if let Err(error) = self.add_last() {
                self.scene.remove_body(self.scene.bodies.len() - 1);
                return Err(error);
            }
            self.work.set_vertices(self.scene.vertex_count());
        } else {
            let mut scene = self.scene.clone();
            scene.add_body(body);
            let kept: Vec<Option<usize>> = (0..self.body_count()).map(Some).chain([None]).collect();
            self.restart_now(scene, &kept, false)?;
        }
        Ok(self.handles.push())
    }

    /// Adds the last body of the scene to the solver.
    fn add_last(&mut self) -> Result<(), EditError> {
        let budget = memory::check_grown(&self.scene)?;
        let max_pairs = budget.max_pairs(&self.scene);
        let time = self.time();
        let World { scene, solver, report, .. } = self;
        let is_added = match solver {
            Solver::Coupled(coupled) => coupled.add_last(scene, time, max_pairs, report),
            Solver::Prescribed(_) => false,
        };
        if is_added { Ok(()) } else { Err(budget.exceeded(scene, Some(max_pairs)).into()) }
    }

    /// Removes a body and its pushes; the indices of later bodies decrease by one, their handles stay. All other bodies
    /// wake.
    ///
    /// # Errors
    /// [`EditError::NoBody`], [`EditError::Stale`], [`EditError::LastBody`], [`EditError::Laws`],
    /// [`EditError::Solver`]; the world is then unchanged.
    pub fn remove(&mut self, body: impl BodyId) -> Result<(), EditError> {
        let index = body.index_in(self)?;
        if self.body_count() == 1 {
            return Err(EditError::LastBody);
        }
        if !self.scene.pairs.is_empty() {
            return Err(EditError::Laws);
        }
        let mut scene = self.scene.clone();
        scene.remove_body(index);
        let kept: Vec<Option<usize>> = (0..self.body_count()).filter(|&old| old != index).map(Some).collect();
        self.restart_now(scene, &kept, true)?;
        self.handles.remove(index);
        Ok(())
    }

    /// Pushes a body. [`Push::start`] is a time of the simulation: that of a push from now on is [`World::time`].
    ///
    /// # Errors
    /// [`EditError::NoBody`], or [`EditError::Invalid`] for a push that no scene file could have, such as one whose
    /// direction is no unit vector; the world is then unchanged.
    pub fn push(&mut self, push: Push) -> Result<(), EditError> {
        push.body.index_in(self)?;
        self.scene.check_push(&push, |part| format!("push.{part}"))?;
        let time = self.time();
        if let Solver::Coupled(coupled) = &mut self.solver {
            self.scene.pushes.push(push);
            coupled.push(&push, time);
            return Ok(());
        }
        let mut scene = self.scene.clone();
        scene.pushes.push(push);
        let kept: Vec<Option<usize>> = (0..self.body_count()).map(Some).collect();
        self.restart_now(scene, &kept, false)
    }

    /// Sets or removes the force on a free body from now on. The body wakes.
    ///
    /// # Errors
    /// [`EditError::NoBody`], [`EditError::Stale`], [`EditError::OnPath`], or [`EditError::Invalid`] for a force that is
    /// not finite, or beyond its bound, where the body is now; the world is then unchanged.
    pub fn set_force(&mut self, body: impl BodyId, force: Option<Force>) -> Result<(), EditError> {
        let index = body.index_in(self)?;
        let time = self.time();
        let (scene, solver) = (&mut self.scene, &mut self.solver);
        let (own, Solver::Coupled(coupled)) = (&mut scene.bodies[index], solver) else {
            return Err(EditError::OnPath(scene.bodies[index].name.clone()));
        };
        if own.path().is_some() {
            return Err(EditError::OnPath(own.name.clone()));
        }
        if let Some(force) = &force {
            let now = &coupled.member(index).body;
            force.validate(time, now.centre, now.velocity, str::to_owned)?;
        }
        own.force = force;
        coupled.wake_up(index);
        Ok(())
    }

    /// Sets the motion of a body from now on: a path, which may be a function ([`Given`](crate::scene::path::Given)),
    /// or free motion. The body becomes undeformed; all other bodies wake.
    ///
    /// # Errors
    /// [`EditError::NoBody`], [`EditError::Stale`], [`EditError::Solver`], or [`EditError::Invalid`] for a motion that no
    /// scene file could have; the world is then unchanged.
    pub fn set_motion(&mut self, body: impl BodyId, motion: impl Into<Motion>) -> Result<(), EditError> {
        let (index, motion) = (body.index_in(self)?, motion.into());
        let mut scene = self.scene.clone();
        let own = &mut scene.bodies[index];
        own.check_motion(&motion, |part| format!("bodies[{index}].{part}"))?;
        own.motion = motion;
        if own.path().is_some() {
            own.force = None;
        }
        let kept: Vec<Option<usize>> = (0..self.body_count()).map(|old| (old != index).then_some(old)).collect();
        self.restart_now(scene, &kept, true)
    }

    fn restart_now(&mut self, scene: Scene, kept: &[Option<usize>], wake_all: bool) -> Result<(), EditError> {
        self.restart(scene, kept, wake_all, self.time())
    }
}
