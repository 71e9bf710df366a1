//! Read access to a body and a pair of the world at its current time.

use glam::{DQuat, DVec3};

use super::{
    coupled::member::Member,
    numerics::arrays::Vectors,
    prescribed::{body::Active, deformation::Now},
    state::State,
};
use crate::{
    geometry::{Mesh, Rest},
    model::phase::Phase,
    scene::{self, Path},
};

/// A body of the world at its current time.
#[derive(Clone, Copy)]
pub struct BodyView<'a> {
    pub(super) body: &'a scene::Body,
    pub(super) mesh: &'a Mesh,
    pub(super) centre: DVec3,
    pub(super) solved: Solved<'a>,
}

/// A body as its solver knows it.
#[derive(Clone, Copy)]
pub(super) enum Solved<'a> {
    /// A body on a path; its state is `None` while it is at rest.
    Prescribed { path: &'a Path, active: Option<&'a Active>, now: Now },
    /// A body of a coupled scene.
    Coupled(&'a Member),
}

/// The states of all vertices of a body.
#[derive(Clone, Debug, Default)]
pub struct States {
    /// Displacements x from rest [scene unit], `[vertex_count]`.
    pub displacement: Vectors,
    /// Velocities x′ of these [scene unit/s], `[vertex_count]`.
    pub velocity: Vectors,
}

impl<'a> BodyView<'a> {
    /// The scene's description of the body.
    pub fn scene(&self) -> &'a scene::Body {
        self.body
    }

    /// Its name.
    pub fn name(&self) -> &'a str {
        &self.body.name
    }

    /// World position of its centre [scene unit].
    pub fn centre(&self) -> DVec3 {
        self.centre
    }

    /// Rotation of the body from its rest orientation.
    pub fn rotation(&self) -> DQuat {
        self.member().map_or(DQuat::IDENTITY, |member| member.body.rotation)
    }

    /// Velocity of its centre [scene unit/s].
    pub fn centre_velocity(&self) -> DVec3 {
        match self.solved {
            Solved::Prescribed { path, now, .. } => path.at(now.time()).velocity,
            Solved::Coupled(member) => member.body.velocity,
        }
    }

    /// Angular velocity of the body [rad/s].
    pub fn angular_velocity(&self) -> DVec3 {
        self.member().map_or(DVec3::ZERO, |member| member.body.frame_spin())
    }

    /// Whether every displacement and velocity is exactly zero.
    pub fn is_at_rest(&self) -> bool {
        match self.solved {
            Solved::Prescribed { active, .. } => active.is_none_or(Active::is_at_rest),
            Solved::Coupled(member) => !member.is_deformed(),
        }
    }

    fn member(&self) -> Option<&'a Member> {
        match self.solved {
            Solved::Prescribed { .. } => None,
            Solved::Coupled(member) => Some(member),
        }
    }

    /// Number of vertices.
    pub fn vertex_count(&self) -> usize {
        self.rest_shape().len()
    }

    /// Its rest shape.
    pub fn mesh(&self) -> &'a Mesh {
        self.mesh
    }

    /// Its rest shape at its scale, in the axes of the body.
    pub fn rest_shape(&self) -> Rest<'a> {
        self.mesh.at(self.body.radius)
    }

    /// Rest position l of vertex `i` from the centre, in the axes of the body [scene unit]; panics if out of range.
    pub fn rest(&self, i: usize) -> DVec3 {
        self.rest_shape().position(i)
    }

    /// Direction l̂ = l/|l| of the rest position of vertex `i`, in the axes of the body [–]; panics if out of range.
    pub fn direction(&self, i: usize) -> DVec3 {
        self.rest_shape().direction(i)
    }

    /// The states of all vertices; faster than computing them one by one.
    pub fn states(&self) -> States {
        let mut states = States::default();
        self.states_into(&mut states);
        states
    }

    /// Like [`BodyView::states`], into an existing value (reused).
    pub fn states_into(&self, states: &mut States) {
        let States { displacement, velocity } = states;
        let (active, now) = match self.solved {
            Solved::Prescribed { active, now, .. } => (active.filter(|active| !active.is_at_rest()), now),
            Solved::Coupled(member) => return member.states_into(displacement, velocity),
        };
        displacement.reset(self.vertex_count());
        velocity.reset(self.vertex_count());
        let Some(active) = active else { return };
        let State { x, u } = active.carried_at(now);
        displacement.fill(x);
        velocity.fill(u);
        active.state.deformation.add_to(displacement, velocity, now);
    }

    /// Displacement x and velocity x′ of vertex `i`.
    fn state_of(&self, i: usize) -> State {
        match self.solved {
            Solved::Prescribed { active: None, .. } => State::default(),
            Solved::Prescribed { active: Some(active), now, .. } => {
                let alike = active.carried_at(now);
                let own = active.state.deformation.state(i, now);
                State { x: alike.x + own.x, u: alike.u + own.u }
            }
            Solved::Coupled(member) => {
                let of = |vectors: &[DVec3]| vectors.get(i).copied().unwrap_or_default();
                State { x: of(&member.body.x), u: of(&member.body.u) }
            }
        }
    }

    /// Displacement x of vertex `i` from rest, in the axes of the world [scene unit]; 0 beyond the last vertex.
    pub fn displacement(&self, i: usize) -> DVec3 {
        self.state_of(i).x
    }

    /// Velocity x′ of the displacement of vertex `i` [scene unit/s]; 0 beyond the last vertex.
    pub fn velocity(&self, i: usize) -> DVec3 {
        self.state_of(i).u
    }

    /// Position of vertex `i` relative to the centre, Q l + x, in the axes of the world [scene unit].
    ///
    /// # Panics
    /// There is no such vertex; so does [`Body::position`].
    pub fn local_position(&self, i: usize) -> DVec3 {
        self.turned(self.rest(i)) + self.displacement(i)
    }

    /// Q l.
    fn turned(&self, rest: DVec3) -> DVec3 {
        if self.member().is_some() { self.rotation() * rest } else { rest }
    }

    /// World position r = c + Q l + x of vertex `i` [scene unit].
    pub fn position(&self, i: usize) -> DVec3 {
        self.centre + self.local_position(i)
    }

    /// World positions of all vertices [scene unit].
    pub fn positions(self) -> impl ExactSizeIterator<Item = DVec3> + 'a {
        let states = self.states();
        (0..self.vertex_count()).map(move |i| self.centre + (self.turned(self.rest(i)) + states.displacement.get(i)))
    }

    /// The largest |x| of its vertices [scene unit].
    pub fn max_displacement(&self) -> f64 {
        if self.is_at_rest() {
            return 0.0;
        }
        self.states().displacement.iter().map(DVec3::length_squared).fold(0.0, f64::max).sqrt()
    }
}

/// A pair of bodies at the world's current time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PairView {
    /// Index of the first body.
    pub a: usize,
    /// Index of the second body; `a < b`.
    pub b: usize,
    /// Centre distance over the sum of the radii [–].
    pub q: f64,
    /// Rate at which q changes [1/s].
    pub rate: f64,
    /// The phase of the pair, which determines how the two act on each other.
    pub phase: Phase,
}
