//! Looking at a state: forces by cause, energy, how many vertices are reached.

use glam::DVec3;

use super::{
    World,
    arrays::Vectors,
    surroundings::{Source, Surroundings, push_acceleration},
    world::States,
};
use crate::{
    geometry::Rest,
    model::{
        energy,
        influence::{self, Influence, Weight},
        phase::Phase,
    },
    scene::{Body, Scene},
};

/// Why a vertex accelerates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// (3.4): influence spheres of merged bodies.
    Attraction,
    /// (3.5): influence spheres of bodies apart.
    Repulsion,
    /// The same of bodies in their core.
    Core,
    /// −ω²x of (3.2).
    Restoring,
    /// −2κx′ of (3.2).
    Damping,
    /// Pushes (Fig. 4.1).
    Push,
    /// −carry: the body's own motion.
    Carry,
    /// The sum of all: x″.
    Net,
}

impl Cause {
    /// All causes, the sum last.
    pub const ALL: [Cause; 8] = [
        Cause::Attraction,
        Cause::Repulsion,
        Cause::Core,
        Cause::Restoring,
        Cause::Damping,
        Cause::Push,
        Cause::Carry,
        Cause::Net,
    ];

    /// The name used in recordings.
    pub fn name(self) -> &'static str {
        match self {
            Cause::Attraction => "attraction",
            Cause::Repulsion => "repulsion",
            Cause::Core => "core",
            Cause::Restoring => "restoring",
            Cause::Damping => "damping",
            Cause::Push => "push",
            Cause::Carry => "carry",
            Cause::Net => "net",
        }
    }
}

impl Source {
    /// As what its force counts.
    pub fn cause(&self) -> Cause {
        match (self.phase, self.strength > 0.0) {
            (Phase::Core, _) => Cause::Core,
            (_, true) => Cause::Attraction,
            (_, false) => Cause::Repulsion,
        }
    }
}

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
        for cause in [Cause::Restoring, Cause::Damping, Cause::Push, Cause::Carry] {
            let count = self.of(cause).len();
            self.by_cause[cause as usize].reset(count);
        }
        let net = self.acting().collect();
        self.by_cause[Cause::Net as usize] = net;
    }

    /// What acts on each vertex but for its own oscillator [scene unit/s²].
    pub(super) fn acting(&self) -> impl Iterator<Item = DVec3> + '_ {
        let causes = [Cause::Attraction, Cause::Repulsion, Cause::Core, Cause::Push, Cause::Carry];
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
        *self.energy_of_distant_pairs.get_or_init(|| energy_of_distant_pairs(self.scene()))
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
    /// Displacement and velocity of vertex `i`.
    fn state(&self, i: usize) -> (DVec3, DVec3) {
        let States { displacement, velocity } = self.states;
        if displacement.is_empty() { (DVec3::ZERO, DVec3::ZERO) } else { (displacement.get(i), velocity.get(i)) }
    }

    /// How far some vertices from `first` on are from `centre`, which is relative to the body's [scene unit].
    fn distances(&self, centre: DVec3, first: usize, distances: &mut [f64]) {
        let n = distances.len();
        let (l, radius) = (self.rest.mesh.positions(), self.rest.radius);
        let [lx, ly, lz] = [&l.x, &l.y, &l.z].map(|axis| &axis[first..first + n]);
        let Vectors { x, y, z } = &self.states.displacement;
        if x.is_empty() {
            for i in 0..n {
                let (dx, dy, dz) = (centre.x - radius * lx[i], centre.y - radius * ly[i], centre.z - radius * lz[i]);
                distances[i] = (dx * dx + dy * dy + dz * dz).sqrt();
            }
        } else {
            let [x, y, z] = [x, y, z].map(|axis| &axis[first..first + n]);
            for i in 0..n {
                let dx = centre.x - (radius * lx[i] + x[i]);
                let dy = centre.y - (radius * ly[i] + y[i]);
                let dz = centre.z - (radius * lz[i] + z[i]);
                distances[i] = (dx * dx + dy * dy + dz * dz).sqrt();
            }
        }
    }

    /// The forces by cause on every vertex.
    pub fn forces(&self, weight: Weight, forces: &mut BodyForces) {
        let material = self.body.material;
        for vectors in &mut forces.by_cause {
            vectors.resize(self.rest.len()); // every one is set below
        }
        for i in 0..self.rest.len() {
            let (x, u) = self.state(i);
            let position = self.rest.position(i) + x;
            let mut by_cause = [DVec3::ZERO; Cause::ALL.len()];
            for source in &self.surroundings.sources {
                let to_centre = source.centre - position;
                by_cause[source.cause() as usize] +=
                    influence::acceleration(weight, source.strength, source.sphere_radius, to_centre);
            }
            by_cause[Cause::Restoring as usize] = material.omega * material.omega * -x;
            by_cause[Cause::Damping as usize] = -2.0 * material.damping * u;
            for push in &self.surroundings.pushes {
                by_cause[Cause::Push as usize] += push_acceleration(push, self.rest.direction(i));
            }
            by_cause[Cause::Carry as usize] = -self.surroundings.carry;
            by_cause[Cause::Net as usize] = by_cause.iter().sum();
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

/// Vertices whose distances are computed together.
const STRIP: usize = 64;

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
            sum.influence += energy_outside(scene, a, b, phase) - energy_outside(scene, a, b, Phase::Apart);
            sum.influence += energy_outside(scene, b, a, phase) - energy_outside(scene, b, a, Phase::Apart);
        }
        EnergySum { weight: scene.influence.weight, sum }
    }

    /// Adds what the vertices of a body have, and have more than that by being inside of spheres.
    pub fn add(&mut self, seen: &Seen<'_>) {
        let States { displacement, velocity } = seen.states;
        self.sum.kinetic += energy::kinetic(sum_of_squares(velocity));
        self.sum.elastic += energy::elastic(seen.body.material.omega, sum_of_squares(displacement));
        if seen.surroundings.sources.is_empty() {
            return;
        }
        for first in (0..seen.rest.len()).step_by(STRIP) {
            let n = STRIP.min(seen.rest.len() - first);
            let mut reached = [false; STRIP];
            for source in &seen.surroundings.sources {
                let mut distances = [0.0; STRIP];
                seen.distances(source.centre, first, &mut distances[..n]);
                let potential = |r| energy::influence_potential(self.weight, source.sphere_radius, r);
                for (&distance, reached) in distances[..n].iter().zip(&mut reached) {
                    if distance < source.sphere_radius {
                        let inside = potential(distance) - potential(source.sphere_radius);
                        self.sum.influence += source.strength * inside;
                        *reached = true;
                    }
                }
            }
            self.sum.reached_vertices += reached.iter().filter(|&&reached| reached).count() as u64;
        }
    }
}

/// Σ |v|², in eight sums side by side, which are vectorised.
fn sum_of_squares(vectors: &Vectors) -> f64 {
    const LANES: usize = 8;
    let n = vectors.len();
    let (x, y, z) = (&vectors.x[..n], &vectors.y[..n], &vectors.z[..n]);
    let mut sums = [0.0; LANES];
    for first in (0..n / LANES * LANES).step_by(LANES) {
        let [x, y, z] = [x, y, z].map(|axis| &axis[first..first + LANES]);
        for lane in 0..LANES {
            sums[lane] += x[lane] * x[lane] + y[lane] * y[lane] + z[lane] * z[lane];
        }
    }
    let rest = (n / LANES * LANES..n).map(|i| x[i] * x[i] + y[i] * y[i] + z[i] * z[i]);
    sums.iter().sum::<f64>() + rest.sum::<f64>()
}

/// Σ s Φ over the vertices of body `index`, all of them outside the sphere of body `source` [scene unit²/s²].
fn energy_outside(scene: &Scene, index: usize, source: usize, phase: Phase) -> f64 {
    let (body, source) = (&scene.bodies[index], scene.bodies[source].radius);
    outside_per_vertex(&scene.influence, body.radius, source, phase) * body.shape.vertex_count() as f64
}

fn outside_per_vertex(influence: &Influence, radius: f64, source: f64, phase: Phase) -> f64 {
    let sphere = influence.sphere_radius(source);
    influence.strength(phase, radius, source) * energy::influence_potential(influence.weight, sphere, sphere)
}

/// Σ [`energy_outside`] over all ordered pairs of bodies as if all were apart: a constant of the scene, in
/// O(bodies · distinct radii).
fn energy_of_distant_pairs(scene: &Scene) -> f64 {
    let mut radii: Vec<f64> = scene.bodies.iter().map(|body| body.radius).collect();
    radii.sort_by(f64::total_cmp);
    let sources = radii.chunk_by(|a, b| a == b);
    let per_vertex = |radius, source| outside_per_vertex(&scene.influence, radius, source, Phase::Apart);
    let all_of = |radius| sources.clone().map(|same| same.len() as f64 * per_vertex(radius, same[0])).sum::<f64>();
    let energy = |body: &Body| {
        let others = all_of(body.radius) - per_vertex(body.radius, body.radius);
        others * body.shape.vertex_count() as f64
    };
    scene.bodies.iter().map(energy).sum()
}
