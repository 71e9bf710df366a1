//! An independent solution of a scene with free bodies, against which the integrators are compared.
//!
//! It uses nothing from [`crate::sim`]. Every vertex is a particle: its acceleration is evaluated from the positions
//! and velocities of all particles, with mass centres and best-fit rotations (Newton's iteration for the polar
//! decomposition) recomputed each time. The classical Runge–Kutta method takes many small steps of fixed length; a step
//! in which a pair reaches a threshold ends there. Rims of spheres and planes are crossed within steps, which limits
//! the accuracy to about 1e-8 radii, as measured by halving the steps.

use std::ops::Range;

use glam::{DMat3, DVec3};

use crate::{
    model::{
        influence::{self, Scaling},
        phase::Phase,
        shape_matching::{Rotation, resistance},
    },
    scene::{Motion, Path, Response, Scene},
};

/// Steps per period of the largest rate of the scene.
const STEPS: f64 = 400.0;
/// Lower limit on the steps per second.
const MIN_STEPS_PER_SECOND: f64 = 8_000.0;
/// Upper limit on evaluations of a particle's acceleration: about a minute.
const MAX_EVALUATIONS: f64 = 2e9;
/// Precision to which a threshold crossing is located, as a fraction of a step.
const CROSSING_PRECISION: f64 = 1e-9;

/// World positions at given instants.
pub struct Particles {
    /// `[instant][particle]` [scene unit]
    positions: Vec<Vec<DVec3>>,
    /// The particles of each body.
    ranges: Vec<Range<usize>>,
}

/// Why there is no solution.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum NoParticles {
    /// The solution would take too long.
    #[error(
        "a reference solution would take {0:.0e} evaluations, more than {MAX_EVALUATIONS:.0e}; make the scene softer, smaller \
         or shorter"
    )]
    TooLong(f64),
    /// The scene has pushes.
    #[error("the reference solution for free bodies does not support pushes; remove them")]
    Pushes,
}

impl Particles {
    /// Solves the scene. Each default step is divided into `divided` steps.
    ///
    /// # Errors
    /// The scene has pushes, or would take too long.
    pub fn solve(scene: &Scene, instants: &[f64], divided: u32) -> Result<Particles, NoParticles> {
        if !scene.pushes.is_empty() {
            return Err(NoParticles::Pushes);
        }
        let planes = scene.planes.iter().map(|plane| plane.stiffness.sqrt());
        let laws = scene.laws().map(|law| law.alpha.max(law.beta).sqrt());
        let rates = scene.bodies.iter().map(|body| body.material.omega.max(2.0 * body.material.damping));
        let rate = rates.chain(planes).chain(laws).fold(0.0, f64::max);
        let per_second = (STEPS * rate / std::f64::consts::TAU).max(MIN_STEPS_PER_SECOND) * f64::from(divided);
        let end = instants.last().copied().unwrap_or(0.0);
        let evaluations = 4.0 * per_second * end * scene.vertex_count() as f64 * scene.bodies.len() as f64;
        if !(evaluations < MAX_EVALUATIONS * f64::from(divided)) {
            return Err(NoParticles::TooLong(evaluations));
        }
        let mut system = System::new(scene);
        let (mut state, mut buffers) = (system.initial(), Buffers::default());
        let mut positions = Vec::with_capacity(instants.len());
        let mut t = 0.0;
        for &instant in instants {
            let steps = ((instant - t) * per_second).ceil();
            let start = t;
            for step in 1..=steps as u64 {
                let next = start + (instant - start) * (step as f64 / steps);
                system.advance(&mut state, t, next, &mut buffers);
                t = next;
            }
            t = instant;
            positions.push(state.positions.clone());
        }
        Ok(Particles { positions, ranges: system.ranges })
    }

    /// The largest distance between a body's vertices in this solution and the positions `found` at an instant
    /// [scene unit]; NaN if any of those is NaN.
    pub fn distance(&self, body: usize, instant: usize, found: impl Iterator<Item = DVec3>) -> f64 {
        let own = &self.positions[instant][self.ranges[body].clone()];
        let distances = own.iter().zip(found).map(|(own, found)| own.distance(found));
        distances
            .fold(0.0, |largest, distance| if distance > largest || distance.is_nan() { distance } else { largest })
    }

    /// The largest distance of any vertex from its position in another solution [radii of its body].
    pub fn largest_difference(&self, other: &Particles, scene: &Scene) -> f64 {
        let each =
            (0..self.positions.len()).flat_map(|instant| (0..scene.bodies.len()).map(move |body| (instant, body)));
        let difference = |(instant, body): (usize, usize)| {
            let others = &other.positions[instant][other.ranges[body].clone()];
            self.distance(body, instant, others.iter().copied()) / scene.bodies[body].radius
        };
        each.map(difference).fold(0.0, f64::max)
    }
}

/// Positions and velocities of all particles, one body after the other.
#[derive(Clone, Default)]
struct State {
    positions: Vec<DVec3>,
    velocities: Vec<DVec3>,
}

/// Scratch storage, reused from step to step.
#[derive(Default)]
struct Buffers {
    /// The state at a stage of a step.
    stage: State,
    /// The state at the end of a step.
    next: State,
    accelerations: Vec<DVec3>,
    centres: Vec<DVec3>,
    reactions: Vec<DVec3>,
}

struct Particle {
    /// Rest position relative to the mass centre [scene unit].
    rest: DVec3,
    mass: f64,
}

struct System<'a> {
    scene: &'a Scene,
    particles: Vec<Particle>,
    /// Particles of each body.
    ranges: Vec<Range<usize>>,
    /// Total mass of each body.
    masses: Vec<f64>,
    /// The phase of each pair of bodies a < b.
    phases: Vec<(usize, usize, Phase)>,
}

impl<'a> System<'a> {
    fn new(scene: &'a Scene) -> System<'a> {
        let particles = |body: &crate::scene::Body| {
            let mesh = body.shape.mesh();
            let rest = mesh.positions().iter().zip(mesh.shares());
            let mut particles: Vec<Particle> =
                rest.map(|(p, share)| Particle { rest: body.radius * p, mass: body.mass * share }).collect();
            if matches!(body.motion, Motion::Free(_)) {
                let mass: f64 = particles.iter().map(|p| p.mass).sum();
                let centre = particles.iter().map(|p| p.mass * p.rest).sum::<DVec3>() / mass;
                particles.iter_mut().for_each(|p| p.rest -= centre);
            }
            particles
        };
        let (mut all, mut ranges, mut masses) = (Vec::new(), Vec::new(), Vec::new());
        for own in scene.bodies.iter().map(particles) {
            ranges.push(all.len()..all.len() + own.len());
            masses.push(own.iter().map(|p| p.mass).sum());
            all.extend(own);
        }
        let mut system = System { scene, particles: all, ranges, masses, phases: Vec::new() };
        let state = system.initial();
        for a in 0..scene.bodies.len() {
            for b in a + 1..scene.bodies.len() {
                let q = system.distance(&state, 0.0, a, b);
                system.phases.push((a, b, scene.law(a, b).thresholds.initial(q)));
            }
        }
        system
    }

    fn initial(&self) -> State {
        let mut state = State { positions: Vec::new(), velocities: Vec::new() };
        for (body, range) in self.scene.bodies.iter().zip(&self.ranges) {
            let particles = &self.particles[range.clone()];
            let (centre, velocity, spin) = match &body.motion {
                Motion::Free(free) => (free.from, free.velocity, free.spin),
                // the vertices start at rest relative to the centre: x′ = 0
                Motion::Prescribed(path) => (path.at(0.0).position, path.at(0.0).velocity, DVec3::ZERO),
            };
            state.positions.extend(particles.iter().map(|p| centre + p.rest));
            state.velocities.extend(particles.iter().map(|p| velocity + spin.cross(p.rest)));
        }
        state
    }

    fn path(&self, body: usize) -> Option<&Path> {
        self.scene.bodies[body].path()
    }

    fn centre(&self, state: &State, t: f64, body: usize) -> DVec3 {
        match self.path(body) {
            Some(path) => path.at(t).position,
            None => self.mean(body, &state.positions),
        }
    }

    /// The mass-weighted mean over a body's particles.
    fn mean(&self, body: usize, of: &[DVec3]) -> DVec3 {
        let own = self.ranges[body].clone();
        let sum: DVec3 = self.particles[own.clone()].iter().zip(&of[own]).map(|(p, v)| p.mass * *v).sum();
        sum / self.masses[body]
    }

    /// q of a pair.
    fn distance(&self, state: &State, t: f64, a: usize, b: usize) -> f64 {
        let radii = self.scene.bodies[a].radius + self.scene.bodies[b].radius;
        self.centre(state, t, a).distance(self.centre(state, t, b)) / radii
    }

    /// Takes a step, divided where thresholds are reached.
    fn advance(&mut self, state: &mut State, mut t: f64, end: f64, buffers: &mut Buffers) {
        let mut next = std::mem::take(&mut buffers.next);
        while t < end {
            self.after(state, t, end - t, &mut next, buffers);
            let Some(first) = self.first_change(state, &next, t, end) else {
                std::mem::swap(state, &mut next);
                break;
            };
            // the first change in the step, by bisection of the time by which any pair has changed
            let (mut low, mut high) = (0.0, 1.0);
            let mut change = first;
            while high - low > CROSSING_PRECISION {
                let middle = 0.5 * (low + high);
                let trial = t + middle * (end - t);
                self.after(state, t, trial - t, &mut next, buffers);
                match self.first_change(state, &next, t, trial) {
                    Some(found) => (high, change) = (middle, found),
                    None => low = middle,
                }
            }
            let crossing = t + high * (end - t);
            self.after(state, t, crossing - t, &mut next, buffers);
            std::mem::swap(state, &mut next);
            self.phases[change.0].2 = change.1;
            t = crossing;
        }
        buffers.next = next;
    }

    /// A pair that has passed a threshold between two states, and its new phase.
    fn first_change(&self, before: &State, after: &State, t: f64, end: f64) -> Option<(usize, Phase)> {
        self.phases.iter().enumerate().find_map(|(index, &(a, b, phase))| {
            let (from, to) = (self.distance(before, t, a, b), self.distance(after, end, a, b));
            let mut transitions = self.scene.law(a, b).thresholds.transitions(phase);
            let passed = transitions.find(|change| {
                let sign = if change.falling { 1.0 } else { -1.0 };
                sign * (to - change.level) < 0.0 && sign * (from - to) > 0.0
            });
            passed.map(|change| (index, change.to))
        })
    }

    /// The state after a step of the classical Runge–Kutta method.
    fn after(&self, from: &State, t: f64, h: f64, to: &mut State, buffers: &mut Buffers) {
        let mut stage = std::mem::take(&mut buffers.stage);
        stage.positions.clone_from(&from.positions);
        stage.velocities.clone_from(&from.velocities);
        to.positions.clone_from(&from.positions);
        to.velocities.clone_from(&from.velocities);
        for (weight, at, next) in [(1.0, 0.0, 0.5), (2.0, 0.5, 0.5), (2.0, 0.5, 1.0), (1.0, 1.0, 0.0)] {
            self.accelerate(&stage, t + at * h, buffers);
            let (part, ahead) = (weight * h / 6.0, next * h);
            for (i, &acceleration) in buffers.accelerations.iter().enumerate() {
                let velocity = stage.velocities[i];
                to.positions[i] += part * velocity;
                to.velocities[i] += part * acceleration;
                stage.positions[i] = from.positions[i] + ahead * velocity;
                stage.velocities[i] = from.velocities[i] + ahead * acceleration;
            }
        }
        buffers.stage = stage;
    }

    /// Writes the accelerations of all particles to their buffer.
    fn accelerate(&self, state: &State, t: f64, buffers: &mut Buffers) {
        let scene = self.scene;
        let count = self.ranges.len();
        let Buffers { accelerations, centres, reactions, .. } = buffers;
        centres.clear();
        centres.extend((0..count).map(|body| self.centre(state, t, body)));
        accelerations.clear();
        (0..count).for_each(|body| self.own(state, t, body, centres[body], accelerations));
        reactions.clear();
        reactions.resize(count, DVec3::ZERO);
        for &(a, b, phase) in &self.phases {
            let law = scene.law(a, b);
            let radii = scene.bodies[a].radius + scene.bodies[b].radius;
            let strength = law.strength(phase, centres[a].distance(centres[b]) / radii);
            for (own, source) in [(a, b), (b, a)] {
                let (radius, of_source) = (scene.bodies[own].radius, scene.bodies[source].radius);
                let scale = match scene.influence.scaling {
                    Scaling::Absolute => 1.0,
                    Scaling::Relative => (radius / of_source).min(1.0),
                };
                let reach = scene.influence.reach * of_source;
                if strength == 0.0 {
                    continue;
                }
                let mut pull = DVec3::ZERO;
                for i in self.ranges[own].clone() {
                    let to_centre = centres[source] - state.positions[i];
                    let force = influence::acceleration(scene.influence.weight, scale * strength, reach, to_centre);
                    accelerations[i] += force;
                    pull += self.particles[i].mass * force;
                }
                reactions[source] -= pull;
            }
        }
        for body in (0..count).filter(|&body| self.path(body).is_none()) {
            let all = scene.gravity + reactions[body] / scene.bodies[body].mass;
            accelerations[self.ranges[body].clone()].iter_mut().for_each(|acceleration| *acceleration += all);
        }
    }

    /// Appends the accelerations of a body's particles by springs, damping and planes.
    fn own(&self, state: &State, t: f64, index: usize, centre: DVec3, into: &mut Vec<DVec3>) {
        let (body, range) = (&self.scene.bodies[index], self.ranges[index].clone());
        let particles = &self.particles[range.clone()];
        let (positions, velocities) = (&state.positions[range.clone()], &state.velocities[range]);
        let (omega, damping) = (body.material.omega, body.material.damping);
        let (velocity, rotation, spin, carried) = match &body.motion {
            Motion::Prescribed(path) => {
                let at = path.at(t);
                let carry = match body.material.response {
                    Response::Rigid => DVec3::ZERO,
                    Response::Inertial => at.acceleration,
                    Response::World => at.acceleration + 2.0 * damping * at.velocity,
                };
                (at.velocity, DMat3::IDENTITY, DVec3::ZERO, at.acceleration - carry)
            }
            Motion::Free(free) => {
                let velocity = self.mean(index, &state.velocities);
                let (mut fit, mut spread, mut momentum) = (DMat3::ZERO, DMat3::ZERO, DVec3::ZERO);
                for (i, Particle { rest, mass }) in particles.iter().enumerate() {
                    let (s, rate) = (positions[i] - centre, velocities[i] - velocity);
                    fit += DMat3::from_cols(s * rest.x, s * rest.y, s * rest.z) * *mass;
                    spread += DMat3::from_cols(s * s.x, s * s.y, s * s.z) * *mass;
                    momentum += *mass * s.cross(rate);
                }
                match free.rotation {
                    Rotation::Fixed => (velocity, DMat3::IDENTITY, DVec3::ZERO, DVec3::ZERO),
                    Rotation::Free => (velocity, polar(fit), resistance(spread).inverse() * momentum, DVec3::ZERO),
                }
            }
        };
        let each = particles.iter().zip(positions.iter().zip(velocities));
        into.extend(each.map(|(particle, (&r, &v))| {
            let s = r - centre;
            let mut sum = carried
                - omega * omega * (s - rotation * particle.rest)
                - 2.0 * damping * (v - velocity - spin.cross(s));
            for plane in &self.scene.planes {
                let depth = plane.offset - plane.normal.dot(r);
                if depth > 0.0 {
                    let along = v - plane.normal.dot(v) * plane.normal;
                    let slip = (along.length_squared() + plane.slip * plane.slip).sqrt();
                    sum += plane.stiffness * depth * (plane.normal - plane.friction / slip * along);
                }
            }
            sum
        }));
    }
}

/// The rotation of the polar decomposition, by Newton's iteration (Higham 1986): X ← ½ (X + X⁻ᵀ).
fn polar(mut x: DMat3) -> DMat3 {
    for _ in 0..60 {
        let next = (x + x.inverse().transpose()) * 0.5;
        let change = next - x;
        let far = [change.x_axis, change.y_axis, change.z_axis].map(DVec3::length).into_iter().fold(0.0, f64::max);
        x = next;
        if !(far > 1e-15) {
            break;
        }
    }
    x
}
