//! Looking at a state: forces by cause, energy, how many vertices are reached.

use super::{
    World,
    arrays::Vectors,
    surroundings::{Surroundings, push_acceleration},
    world::{BodyView, States},
};
use crate::{
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
    /// (3.5): influence spheres of bodies apart or in their core.
    Repulsion,
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
    pub const ALL: [Cause; 7] =
        [Cause::Attraction, Cause::Repulsion, Cause::Restoring, Cause::Damping, Cause::Push, Cause::Carry, Cause::Net];

    /// The name used in recordings.
    pub fn name(self) -> &'static str {
        match self {
            Cause::Attraction => "attraction",
            Cause::Repulsion => "repulsion",
            Cause::Restoring => "restoring",
            Cause::Damping => "damping",
            Cause::Push => "push",
            Cause::Carry => "carry",
            Cause::Net => "net",
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
}

impl World {
    /// The forces by cause on every vertex of body `index` in the current state, into `forces` (reused).
    pub fn forces(&self, index: usize, forces: &mut BodyForces) {
        self::forces(&self.body(index), &self.surroundings(index), self.scene().influence.weight, forces);
    }

    /// The energy of the current state.
    pub fn energy(&self) -> Energy {
        let distant = *self.energy_of_distant_pairs.get_or_init(|| energy_of_distant_pairs(self.scene()));
        self::energy(self, distant)
    }
}

/// The forces on every vertex of a body, given what acts on it.
fn forces(body: &BodyView<'_>, surroundings: &Surroundings, weight: Weight, forces: &mut BodyForces) {
    let material = body.scene().material;
    let states = body.states();
    for vectors in &mut forces.by_cause {
        vectors.reset(body.vertex_count());
    }
    for i in 0..body.vertex_count() {
        let (unit, x, u) = (body.unit(i), states.displacement.get(i), states.velocity.get(i));
        let position = body.scene().radius * unit + x;
        let mut by_cause = [glam::DVec3::ZERO; Cause::ALL.len()];
        for source in &surroundings.sources {
            let cause = if source.strength > 0.0 { Cause::Attraction } else { Cause::Repulsion };
            let to_centre = source.centre - position;
            by_cause[cause as usize] +=
                influence::acceleration(weight, source.strength, source.sphere_radius, to_centre);
        }
        by_cause[Cause::Restoring as usize] = material.omega * material.omega * -x;
        by_cause[Cause::Damping as usize] = -2.0 * material.damping * u;
        for push in &surroundings.pushes {
            by_cause[Cause::Push as usize] += push_acceleration(push, unit);
        }
        by_cause[Cause::Carry as usize] = -surroundings.carry;
        by_cause[Cause::Net as usize] = by_cause.iter().sum();
        for (vectors, force) in forces.by_cause.iter_mut().zip(by_cause) {
            vectors.set(i, force);
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

/// The energy of the current state; `distant` is that of the influence as if every pair were apart and out of reach.
fn energy(world: &World, distant: f64) -> Energy {
    let scene = world.scene();
    let mut sum = Energy { influence: distant, ..Energy::default() };
    for (a, b, phase) in world.phases() {
        sum.influence += energy_outside(scene, a, b, phase) - energy_outside(scene, a, b, Phase::Apart);
        sum.influence += energy_outside(scene, b, a, phase) - energy_outside(scene, b, a, Phase::Apart);
    }
    let mut states = States::default();
    for (index, body) in world.bodies().enumerate() {
        let surroundings = world.surroundings(index);
        if body.is_at_rest() && surroundings.sources.is_empty() {
            continue;
        }
        body.states_into(&mut states);
        for i in 0..body.vertex_count() {
            let (x, u) = (states.displacement.get(i), states.velocity.get(i));
            let position = body.scene().radius * body.unit(i) + x;
            let mut reached = false;
            for source in &surroundings.sources {
                let potential = |r| energy::influence_potential(scene.influence.weight, source.sphere_radius, r);
                let distance = (source.centre - position).length();
                if distance < source.sphere_radius {
                    sum.influence += source.strength * (potential(distance) - potential(source.sphere_radius));
                    reached = true;
                }
            }
            sum.kinetic += energy::kinetic(u.length_squared());
            sum.elastic += energy::elastic(body.scene().material.omega, x.length_squared());
            sum.reached_vertices += u64::from(reached);
        }
    }
    sum
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
