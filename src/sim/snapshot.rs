//! A copy of what there is to see of a world: quickly taken, and looked at by another thread while the world goes on.

use std::sync::Arc;

use glam::DVec3;

use super::{
    World,
    arrays::Vectors,
    observe::{BodyForces, Energy, EnergySum, Seen},
    terms::Surroundings,
    world::{PairView, States},
};
use crate::{
    geometry::Mesh,
    model::phase::Phase,
    scene::{self, Scene},
};

/// What there is to see of a world at an instant; reused from one to the next.
#[derive(Clone, Debug, Default)]
pub struct Snapshot {
    /// Number of steps taken.
    pub step: u64,
    /// Simulated time [s].
    pub time: f64,
    /// As [`World::pairs`] has them.
    pub pairs: Vec<PairView>,
    bodies: Vec<Body>,
    phases: Vec<(usize, usize, Phase)>,
    energy_of_distant_pairs: f64,
    /// Forces but those of influence spheres are left out.
    has_influence_only: bool,
}

#[derive(Clone, Debug)]
struct Body {
    mesh: Arc<Mesh>,
    centre: DVec3,
    at_rest: bool,
    /// Empty if at rest.
    states: States,
    surroundings: Surroundings,
}

impl World {
    /// What there is to see now, into a snapshot of this world or a new one.
    pub fn look(&self, snapshot: &mut Snapshot) {
        snapshot.step = self.steps_taken();
        snapshot.has_influence_only = false;
        snapshot.time = self.time();
        snapshot.pairs.clear();
        snapshot.pairs.extend(self.pairs());
        snapshot.phases.clear();
        snapshot.phases.extend(self.phases());
        snapshot.energy_of_distant_pairs = self.energy_of_distant_pairs();
        for body in &self.bodies[snapshot.bodies.len().min(self.bodies.len())..] {
            snapshot.bodies.push(Body {
                mesh: Arc::clone(&body.mesh),
                centre: DVec3::ZERO,
                at_rest: true,
                states: States::default(),
                surroundings: Surroundings::default(),
            });
        }
        for (index, seen) in snapshot.bodies.iter_mut().enumerate() {
            let body = self.body(index);
            (seen.centre, seen.at_rest) = (body.centre(), body.is_at_rest());
            if seen.at_rest {
                seen.states = States::default();
            } else {
                body.states_into(&mut seen.states);
            }
            self.surroundings_into(index, &mut seen.surroundings);
        }
    }
}

impl Snapshot {
    /// The same with no forces but those of influence spheres.
    pub(super) fn with_influence_only(mut self) -> Snapshot {
        self.has_influence_only = true;
        self
    }

    /// Another state of the same bodies at time `t`: centre, states, surroundings of each.
    pub(super) fn at(
        &self,
        t: f64,
        scene: &Scene,
        phase: impl Fn(usize, usize) -> Phase,
        bodies: impl Iterator<Item = (DVec3, States, Surroundings)>,
    ) -> Snapshot {
        let body = |(before, (centre, states, surroundings)): (&Body, (DVec3, States, Surroundings))| Body {
            mesh: Arc::clone(&before.mesh),
            centre,
            at_rest: false,
            states,
            surroundings,
        };
        let bodies: Vec<Body> = self.bodies.iter().zip(bodies).map(body).collect();
        let pair = |pair: &PairView| {
            let (a, b) = (pair.a, pair.b);
            let radii = scene.bodies[a].radius + scene.bodies[b].radius;
            PairView { a, b, q: bodies[a].centre.distance(bodies[b].centre) / radii, phase: phase(a, b) }
        };
        Snapshot { time: t, pairs: self.pairs.iter().map(pair).collect(), bodies, ..Snapshot::default() }
    }

    /// Displacements and velocities of a body; none if it is at rest.
    pub(super) fn states(&self, index: usize) -> &States {
        &self.bodies[index].states
    }

    /// Bodies and phase of every pair that may not be apart.
    pub(super) fn phases(&self) -> impl Iterator<Item = (usize, usize, Phase)> + '_ {
        self.phases.iter().copied()
    }

    /// Number of bodies.
    pub fn body_count(&self) -> usize {
        self.bodies.len()
    }

    /// Body `index` of `scene`, the world's own; panics beyond the last, like a slice.
    pub fn body<'a>(&'a self, scene: &'a Scene, index: usize) -> SeenBody<'a> {
        SeenBody { scene: &scene.bodies[index], seen: &self.bodies[index], influence_only: self.has_influence_only }
    }

    /// All bodies, in the order of the scene.
    pub fn bodies<'a>(&'a self, scene: &'a Scene) -> impl ExactSizeIterator<Item = SeenBody<'a>> {
        let influence_only = self.has_influence_only;
        self.bodies.iter().zip(&scene.bodies).map(move |(seen, scene)| SeenBody { scene, seen, influence_only })
    }

    /// [`World::energy`].
    pub fn energy(&self, scene: &Scene) -> Energy {
        let mut energy = EnergySum::new(scene, self.energy_of_distant_pairs, self.phases.iter().copied());
        for body in self.bodies(scene) {
            if !(body.is_at_rest() && body.seen.surroundings.sources.is_empty()) {
                energy.add(&body.seen());
            }
        }
        energy.sum
    }

    /// What it takes of memory, by what was allocated for it [bytes].
    pub fn memory(&self) -> usize {
        let of_body = |body: &Body| body.states.displacement.memory() + body.states.velocity.memory();
        self.bodies.capacity() * size_of::<Body>() + self.bodies.iter().map(of_body).sum::<usize>()
    }
}

/// A body of a snapshot.
#[derive(Clone, Copy)]
pub struct SeenBody<'a> {
    scene: &'a scene::Body,
    seen: &'a Body,
    influence_only: bool,
}

impl<'a> SeenBody<'a> {
    fn seen(self) -> Seen<'a> {
        let Body { mesh, states, surroundings, .. } = self.seen;
        Seen { body: self.scene, rest: mesh.at(self.scene.radius), states, surroundings }
    }

    /// What the scene says of it.
    pub fn scene(self) -> &'a scene::Body {
        self.scene
    }

    /// Where its centre is [scene unit].
    pub fn centre(self) -> DVec3 {
        self.seen.centre
    }

    /// Whether nothing has acted on it yet: every displacement and velocity is exactly zero.
    pub fn is_at_rest(self) -> bool {
        self.seen.at_rest
    }

    /// Its rest shape.
    pub fn mesh(self) -> &'a Mesh {
        &self.seen.mesh
    }

    /// Number of vertices.
    pub fn vertex_count(self) -> usize {
        self.seen.mesh.vertex_count()
    }

    /// Displacements of its vertices from rest [scene unit], `[vertex_count]`; none if it is at rest.
    pub fn displacements(self) -> &'a Vectors {
        &self.seen.states.displacement
    }

    /// What acts on it, but for its own oscillators.
    pub fn surroundings(self) -> &'a Surroundings {
        &self.seen.surroundings
    }

    /// The largest |x| of its vertices [scene unit].
    pub fn max_displacement(self) -> f64 {
        self.displacements().iter().map(DVec3::length_squared).fold(0.0, f64::max).sqrt()
    }

    /// Positions l + x of its vertices relative to the centre [scene unit], into `positions` (reused).
    pub fn local_positions(self, positions: &mut Vectors) {
        let (radius, moved) = (self.scene.radius, self.displacements());
        positions.copy_from(self.seen.mesh.positions());
        for (axis, moved) in [(&mut positions.x, &moved.x), (&mut positions.y, &moved.y), (&mut positions.z, &moved.z)]
        {
            axis.iter_mut().for_each(|l| *l *= radius);
            axis.iter_mut().zip(moved).for_each(|(l, x)| *l += x);
        }
    }

    /// The forces by cause on its vertices, into `forces` (reused).
    pub fn forces(self, scene: &Scene, forces: &mut BodyForces) {
        self.seen().forces(scene.influence.weight, forces);
        if self.influence_only {
            forces.keep_influence();
        }
    }
}
