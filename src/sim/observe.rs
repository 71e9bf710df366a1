//! Observation of a state: forces by cause, energy, number of vertices reached.

use glam::DVec3;

use super::{
    body::States,
    coupled::dense::Interpolated,
    free::{Conserved, Forces, Ledger, Snapshot},
    numerics::arrays::Vectors,
    terms::{self, Cause, Source, Surroundings, oscillator, spheres},
    work::{Tally, Work},
    world::World,
};
use crate::{
    geometry::Rest,
    model::{influence::Weight, phase::Phase},
    scene::{Body, Scene},
};

/// Accelerations of the vertices of one body by cause [scene unit/s²]; reused for every body.
#[derive(Clone, Debug, Default)]
pub struct BodyForces(Forces);

impl BodyForces {
    /// Acceleration of each vertex by `cause` [scene unit/s²], `[vertex_count]`.
    pub fn of(&self, cause: Cause) -> &Vectors {
        &self.0.by_cause[cause as usize]
    }

    /// Force at the centre of a free body, M c″ [mass · scene unit/s²]; zero for others.
    pub fn at_centre(&self) -> DVec3 {
        self.0.force
    }

    /// Torque about the centre of a free body [mass · scene unit²/s²]; zero for others.
    pub fn torque(&self) -> DVec3 {
        self.0.torque
    }
}

impl World {
    /// Computes the forces by cause on every vertex of body `index` in the current state, into `forces` (reused).
    ///
    /// # Panics
    /// There is no such body.
    pub fn forces(&self, index: usize, forces: &mut BodyForces) {
        if let Some(snapshot) = self.current() {
            snapshot.forces(index, terms::uniform_on(self.scene(), index, self.time()), &mut forces.0);
        } else {
            let (states, surroundings) = (self.body(index).states(), self.surroundings(index));
            let seen = self.seen(index, [&states.displacement, &states.velocity], &surroundings);
            seen.forces(self.scene().influence.weight, &mut forces.0.by_cause);
        }
        for vectors in forces.0.by_cause.iter_mut().filter(|vectors| vectors.is_empty()) {
            vectors.reset(self.body(index).vertex_count());
        }
    }

    /// The current state of all bodies of a coupled scene; `None` for other scenes.
    pub(crate) fn current(&self) -> Option<Snapshot<'_>> {
        Some(self.solver.coupled()?.snapshot(self.scene(), self.time()))
    }

    /// Momentum, angular momentum and energy by kind of the free bodies; `None` if the scene is not coupled.
    pub fn conserved(&self) -> Option<Conserved> {
        self.current().map(|snapshot| snapshot.conserved())
    }

    /// Energy brought to the free bodies since t = 0, by cause: their energy minus [`Ledger::total`] is constant up to
    /// the integrator's error. Bodies that a program adds, removes or moves count as edits. Only
    /// [`Integrator::Exponential`](crate::scene::Integrator::Exponential) keeps this account.
    pub fn ledger(&self) -> Ledger {
        self.solver.coupled().map(|coupled| coupled.ledger).unwrap_or_default()
    }

    /// The energy of the free bodies at t = 0 [mass · scene unit²/s²].
    pub(crate) fn first_energy(&self) -> f64 {
        self.solver.coupled().map_or(0.0, |coupled| coupled.first_energy)
    }

    /// The energy of the current state. In a coupled scene, the energy of the free bodies, in units of mass · scene
    /// unit²/s²; see [`World::conserved`].
    pub fn energy(&self) -> Energy {
        if let Some(snapshot) = self.current() {
            return Energy::of(&snapshot.conserved(), snapshot.reached());
        }
        let Some(mut energy) = self.energy_sum() else { return Energy::default() };
        let mut states = States::default();
        for (index, body) in self.bodies().enumerate() {
            let surroundings = self.surroundings(index);
            if !(body.is_at_rest() && surroundings.sources.is_empty()) {
                body.states_into(&mut states);
                energy.add(&self.seen(index, [&states.displacement, &states.velocity], &surroundings));
            }
        }
        energy.sum
    }

    /// An energy sum to which bodies can be added; `None` if the scene is coupled.
    pub(crate) fn energy_sum(&self) -> Option<EnergySum> {
        let (prescribed, scene) = (self.solver.prescribed()?, self.scene());
        Some(EnergySum::new(scene, prescribed.energy_of_distant_pairs(scene), prescribed.phases()))
    }

    /// Calls `write` with the states of some bodies of a coupled scene at `time` [s] within the last step of the solver, from
    /// one of the instants `ends` [s] to the other, on its own solution. Omits bodies that took no step of the solver, and
    /// those that would be too much work.
    pub(crate) fn coupled_within(
        &self,
        ends: [f64; 2],
        time: f64,
        bodies: &[usize],
        work: &Work,
        write: impl FnMut(usize, &Interpolated<'_>),
    ) {
        if let Some(coupled) = self.solver.coupled() {
            coupled.within(self.setting(), ends, time, bodies, &Tally::new(work, None), write);
        }
    }

    /// A body in the given state. Displacements and velocities are empty if all are zero.
    pub(crate) fn seen<'a>(
        &'a self,
        index: usize,
        [displacement, velocity]: [&'a Vectors; 2],
        surroundings: &'a Surroundings,
    ) -> Observed<'a> {
        let (body, rest) = (&self.scene().bodies[index], self.body(index).rest_shape());
        Observed { body, rest, displacement, velocity, surroundings }
    }
}

/// A body in some state and what acts on it: the input for its forces and its energy.
#[derive(Clone, Copy)]
pub(crate) struct Observed<'a> {
    pub body: &'a Body,
    pub rest: Rest<'a>,
    /// Empty if all are zero.
    pub displacement: &'a Vectors,
    /// Empty if all displacements and velocities are zero.
    pub velocity: &'a Vectors,
    pub surroundings: &'a Surroundings,
}

impl Observed<'_> {
    /// Computes the forces by cause on every vertex; empty for a cause that does not act.
    pub fn forces(&self, weight: Weight, by_cause: &mut [Vectors; Cause::ALL.len()]) {
        let Observed { body, rest, displacement, velocity, surroundings } = *self;
        let Surroundings { uniform, weighted, sources } = surroundings;
        by_cause.iter_mut().for_each(Vectors::clear);
        for cause in sources.iter().map(Source::cause).chain(weighted.iter().map(|weighted| weighted.cause)) {
            by_cause[cause as usize].resize(rest.len());
        }
        by_cause[Cause::Net as usize].resize(rest.len());
        for source in sources {
            let forces = &mut by_cause[source.cause() as usize];
            for i in 0..rest.len() {
                let x = if displacement.is_empty() { DVec3::ZERO } else { displacement.get(i) };
                forces.set(i, forces.get(i) + source.acceleration(weight, rest.position(i) + x));
            }
        }
        for weighted in weighted {
            let forces = &mut by_cause[weighted.cause as usize];
            for i in 0..rest.len() {
                forces.set(i, forces.get(i) + weighted.acceleration(rest.direction(i)));
            }
        }
        for (cause, factor, of) in oscillator::accelerations(body.material, displacement, velocity) {
            by_cause[cause as usize].resize(of.len());
            by_cause[cause as usize].add_times(factor, of);
        }
        for &(cause, force) in uniform {
            by_cause[cause as usize].resize(rest.len());
            by_cause[cause as usize].fill(force);
        }
        let [terms @ .., net] = by_cause;
        terms.iter().for_each(|forces| net.add_times(1.0, forces));
    }
}

/// Energy per unit mass of a vertex, summed over all vertices, and the number of vertices reached.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Energy {
    /// Σ ½|u|² [scene unit²/s²].
    pub kinetic: f64,
    /// Σ ½ω²|x|² [scene unit²/s²].
    pub elastic: f64,
    /// Σ s Φ of influence spheres on vertices [scene unit²/s²].
    pub influence: f64,
    /// Gravity and planes, in coupled scenes.
    pub external: f64,
    /// Number of vertices inside at least one influence sphere that acts on them.
    pub reached_vertices: u64,
}

impl Energy {
    pub(crate) fn of(conserved: &Conserved, reached_vertices: u64) -> Energy {
        let Conserved { kinetic, spin, vibration, elastic, influence, gravity, plane, .. } = *conserved;
        Energy { kinetic: kinetic + spin + vibration, elastic, influence, external: gravity + plane, reached_vertices }
    }

    /// Total energy E, as defined in [`crate::model::energy`] [scene unit²/s²].
    pub fn total(&self) -> f64 {
        self.kinetic + self.elastic + self.influence + self.external
    }
}

/// An energy sum that is accumulated body by body.
pub(crate) struct EnergySum {
    weight: Weight,
    pub sum: Energy,
}

impl EnergySum {
    /// Starts with every vertex at rest outside every sphere: `distant` is that energy with all pairs apart, `phases`
    /// are the phases of the pairs that may not be apart.
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

    /// Adds the energy of a body's vertices, including the part due to being inside spheres.
    pub fn add(&mut self, seen: &Observed<'_>) {
        let [kinetic, elastic] = oscillator::energy(seen.body.material, seen.displacement, seen.velocity);
        self.sum.kinetic += kinetic;
        self.sum.elastic += elastic;
        let sources = &seen.surroundings.sources;
        self.sum.reached_vertices +=
            spheres::energy_inside(seen.rest, seen.displacement, sources, self.weight, &mut self.sum.influence);
    }
}
