//! Changes to a world between steps: adding and removing bodies, pushes, forces, other motions.
//!
//! The result is the same as if the scene had contained the change: pushes and bodies added before they begin to act
//! lead to bit-identical states.
//!
//! A change costs what the body in question costs, and, of a body that is added or removed, a look at the list of all
//! others. [`World::add`] and [`World::remove`] rebuild the world, in time proportional to its size, where bodies on paths and
//! force points meet. A change that would bring the first free body or take the last one is refused after the first step.

use super::{
    handle::{BodyHandle, BodyId},
    memory,
    report::{EditError, StepReport},
    solver::{Setting, Solver},
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
        body.validate(self.time()).map_err(|invalid| invalid.at("body"))?;
        if self.scene.bodies.iter().any(|other| other.name == body.name) {
            return Err(EditError::Name(body.name));
        }
        let last = self.body_count();
        self.scene.add_body(body);
        let is_in_place = self.keeps_solver(self.scene.is_coupled()) && self.renumbers_in_place();
        if is_in_place {
            if let Err(error) = self.add_last() {
                self.scene.remove_body(last);
                return Err(error);
            }
        } else {
            let grown = self.scene.clone();
            self.scene.remove_body(last);
            let kept: Vec<Option<usize>> = (0..last).map(Some).chain([None]).collect();
            self.restart_now(grown, &kept)?;
        }
        self.work.set_vertices(self.scene.vertex_count());
        Ok(self.handles.push())
    }

    /// Whether the solver is that of such a scene.
    fn keeps_solver(&self, is_coupled: bool) -> bool {
        is_coupled == matches!(self.solver, Solver::Coupled(_))
    }

    /// Whether bodies can get other indices in place: the tracks of force points follow those of bodies on paths.
    fn renumbers_in_place(&self) -> bool {
        matches!(self.solver, Solver::Coupled(_)) || self.scene.points.is_empty()
    }

    /// Adds the last body of the scene to the solver.
    fn add_last(&mut self) -> Result<(), EditError> {
        let budget = memory::check_grown(&self.scene)?;
        let max_pairs = budget.max_pairs(&self.scene);
        let (setting, solver, report) = self.split();
        let is_added = match solver {
            Solver::Coupled(coupled) => coupled.add_last(setting.scene, setting.time(), max_pairs, report),
            Solver::Prescribed(prescribed) => prescribed.add_last(setting, max_pairs),
        };
        if is_added { Ok(()) } else { Err(budget.exceeded(setting.scene, Some(max_pairs)).into()) }
    }

    /// Removes a body and its pushes; the indices of later bodies decrease by one, their handles stay. In a world with free
    /// bodies, planes or cores with a width, all others wake.
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
        if self.keeps_solver(self.scene.is_coupled_without(index)) && self.renumbers_in_place() {
            let (setting, solver, report) = self.split();
            match solver {
                Solver::Coupled(coupled) => coupled.remove(setting.scene, index, setting.time(), report),
                Solver::Prescribed(prescribed) => prescribed.remove(setting, index),
            }
            self.scene.remove_body(index);
            self.work.set_vertices(self.scene.vertex_count());
        } else {
            let mut scene = self.scene.clone();
            scene.remove_body(index);
            let kept: Vec<Option<usize>> = (0..self.body_count()).filter(|&old| old != index).map(Some).collect();
            self.restart_now(scene, &kept)?;
        }
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
        self.scene.check_push(&push).map_err(|invalid| invalid.at("push"))?;
        self.scene.pushes.push(push);
        match &mut self.solver {
            Solver::Coupled(coupled) => coupled.push(&push),
            Solver::Prescribed(prescribed) => prescribed.push(&push),
        }
        Ok(())
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
            force.validate(time, now.centre, now.velocity)?;
        }
        own.force = force;
        coupled.wake_up(index);
        Ok(())
    }

    /// Sets the motion of a body from now on: a path, which may be a function ([`Given`](crate::scene::path::Given)),
    /// or free motion. The body becomes undeformed, and loses its [`Force`] on a path; the bodies near it wake, and all
    /// where the world is built anew.
    ///
    /// # Errors
    /// [`EditError::NoBody`], [`EditError::Stale`], [`EditError::Solver`], or [`EditError::Invalid`] for a motion that no
    /// scene file could have; the world is then unchanged.
    pub fn set_motion(&mut self, body: impl BodyId, motion: impl Into<Motion>) -> Result<(), EditError> {
        let (index, motion) = (body.index_in(self)?, motion.into());
        let checked = self.scene.bodies[index].check_motion(&motion, self.time());
        checked.map_err(|invalid| invalid.at(format_args!("bodies[{index}]")))?;
        let time = self.time();
        let energy = self.solver.coupled().map_or(0.0, |coupled| coupled.energy_of(&self.scene, time, index));
        let own = &mut self.scene.bodies[index];
        let force = if matches!(motion, Motion::Prescribed(_)) { own.force.take() } else { None };
        let before = std::mem::replace(&mut own.motion, motion);
        if !self.keeps_solver(self.scene.is_coupled()) {
            let changed = self.scene.clone();
            let own = &mut self.scene.bodies[index];
            own.motion = before;
            own.force = force.or(own.force.take());
            let kept: Vec<Option<usize>> = (0..self.body_count()).map(|old| (old != index).then_some(old)).collect();
            return self.restart_now(changed, &kept);
        }
        let (setting, solver, report) = self.split();
        match solver {
            Solver::Coupled(coupled) => coupled.restart(setting.scene, index, energy, time, report),
            Solver::Prescribed(prescribed) => prescribed.restart(setting, index),
        }
        Ok(())
    }

    /// What a change of the solver's state reads, that state, and the report.
    fn split(&mut self) -> (Setting<'_>, &mut Solver, &mut StepReport) {
        self.forget_parts();
        let arch = self.options().arch;
        let World { scene, step, report, solver, .. } = self;
        (Setting { scene, step: *step, arch, is_partial: false }, solver, report)
    }

    fn restart_now(&mut self, scene: Scene, kept: &[Option<usize>]) -> Result<(), EditError> {
        self.forget_parts();
        self.restart(scene, kept, self.time())
    }
}
