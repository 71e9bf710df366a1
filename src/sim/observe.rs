//! Looking at a state: forces by cause, energy, how many vertices are reached.

use glam::DVec3;

use super::{
    World,
    arrays::Vectors,
    state::State,
    terms::{Cause, Surroundings, oscillator, spheres},
    world::States,
};
use crate::{
    geometry::Rest,
    model::{influence::Weight, phase::Phase},
    scene::{Body, Scene},
};

/// Accelerations of the vertices of one body by cause [scene unit/s²]; reused from body to body.
#[derive(Clone, Debug, Default)]
pub struct BodyForces {
    by_cause: [Vectors; Cause::ALL.len()],
}

impl BodyForces {
    /// Acceleration of each vertex by one cause [scene unit/s²], `[vertex_count]`.
    pub fn of(&self, cause: Cause) -> &Vectors {
        &self.by_cause[cause as usize]
    }

    /// Leaves out what does not come from influence spheres.
    pub(super) fn keep_influence(&mut self) {
        let is_influence = |cause: &Cause| matches!(cause, Cause::Attraction | Cause::Repulsion | Cause::Core);
        for cause in Cause::ALL.into_iter().filter(|cause| !is_influence(cause)) {
            let count = self.of(cause).len();
            self.by_cause[cause as usize].reset(count);
        }
        let net = self.acting().collect();
        self.by_cause[Cause::Net as usize] = net;
    }

    /// What acts on each vertex but for its own oscillator [scene unit/s²].
    pub(super) fn acting(&self) -> impl Iterator<Item = DVec3> + '_ {
        let is_own = |cause: &Cause| matches!(cause, Cause::Restoring | Cause::Damping | Cause::Net);
        let causes: Vec<Cause> = Cause::ALL.into_iter().filter(|cause| !is_own(cause)).collect();
        (0..self.of(Cause::Net).len()).map(move |i| causes.iter().map(|&cause| self.of(cause).get(i)).sum())
    }
}

impl World {
    /// The forces by cause on every vertex of body `index` in the current state, into `forces` (reused).
    pub fn forces(&self, index: usize, forces: &mut BodyForces) {
        let (states, surroundings) = (self.body(index).states(), self.surroundings(index));
        self.seen(index, &states, &surroundings).forces(self.scene().influence.weight, forces);
    }

    /// The energy of the current state.
    pub fn energy(&self) -> Energy {
        let mut energy = EnergySum::new(self.scene(), self.energy_of_distant_pairs(), self.phases());
        let mut states = States::default();
        for (index, body) in self.bodies().enumerate() {
            let surroundings = self.surroundings(index);
            if !(body.is_at_rest() && surroundings.sources.is_empty()) {
                body.states_into(&mut states);
                energy.add(&self.seen(index, &states, &surroundings));
            }
        }
        energy.sum
    }

    /// That of the influence as if every pair were apart and out of reach [scene unit²/s²].
    pub(super) fn energy_of_distant_pairs(&self) -> f64 {
        *self.energy_of_distant_pairs.get_or_init(|| spheres::energy_of_distant_pairs(self.scene()))
    }

    pub(super) fn seen<'a>(&'a self, index: usize, states: &'a States, surroundings: &'a Surroundings) -> Seen<'a> {
        Seen { body: &self.scene().bodies[index], rest: self.bodies[index].rest(), states, surroundings }
    }
}

/// A body, and what acts on it: what its forces and its energy follow from.
#[derive(Clone, Copy)]
pub(super) struct Seen<'a> {
    pub body: &'a Body,
    pub rest: Rest<'a>,
    /// Empty if every one is zero.
    pub states: &'a States,
    pub surroundings: &'a Surroundings,
}

impl Seen<'_> {
    /// State of vertex `i`.
    fn state(&self, i: usize) -> State {
        let States { displacement, velocity } = self.states;
        if displacement.is_empty() { State::default() } else { State { x: displacement.get(i), u: velocity.get(i) } }
    }

    /// The forces by cause on every vertex.
    pub fn forces(&self, weight: Weight, forces: &mut BodyForces) {
        for vectors in &mut forces.by_cause {
            vectors.resize(self.rest.len()); // every one is set below
        }
        for i in 0..self.rest.len() {
            let by_cause = self.surroundings.by_cause(self.body, weight, self.rest, i, self.state(i));
            for (vectors, force) in forces.by_cause.iter_mut().zip(by_cause) {
                vectors.set(i, force);
            }
        }
    }
}

/// Energy per unit mass of a vertex, summed over all vertices, and what was counted along the way.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Energy {
    /// Σ ½|u|² [scene unit²/s²].
    pub kinetic: f64,
    /// Σ ½ω²|x|² [scene unit²/s²].
    pub elastic: f64,
    /// Σ s Φ, influence spheres on vertices [scene unit²/s²].
    pub influence: f64,
    /// Vertices inside at least one influence sphere that acts on them.
    pub reached_vertices: u64,
}

impl Energy {
    /// E of model's `Energy` [scene unit²/s²].
    pub fn total(&self) -> f64 {
        self.kinetic + self.elastic + self.influence
    }
}

/// An energy that is being added up, body by body.
pub(super) struct EnergySum {
    weight: Weight,
    pub sum: Energy,
}

impl EnergySum {
    /// As if every vertex were at rest outside of every sphere: `distant` is that with all pairs apart, `phases` are
    /// those of the pairs that may not be.
    pub fn new(scene: &Scene, distant: f64, phases: impl Iterator<Item = (usize, usize, Phase)>) -> EnergySum {
        let mut sum = Energy { influence: distant, ..Energy::default() };
        for (a, b, phase) in phases {
            sum.influence +=
                spheres::energy_outside(scene, a, b, phase) - spheres::energy_outside(scene, a, b, Phase::Apart);
            sum.influence +=
                spheres::energy_outside(scene, b, a, phase) - spheres::energy_outside(scene, b, a, Phase::Apart);
        }
        EnergySum { weight: scene.influence.weight, sum }
    }

    /// Adds what the vertices of a body have, and have more than that by being inside of spheres.
    pub fn add(&mut self, seen: &Seen<'_>) {
        let States { displacement, velocity } = seen.states;
        let [kinetic, elastic] = oscillator::energy(seen.body.material, displacement, velocity);
        self.sum.kinetic += kinetic;
        self.sum.elastic += elastic;
        let sources = &seen.surroundings.sources;
        self.sum.reached_vertices +=
            spheres::energy_inside(seen.rest, displacement, sources, self.weight, &mut self.sum.influence);
    }
}
