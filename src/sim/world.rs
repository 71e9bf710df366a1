//! The world: the state of every body and pair, and the step.

use std::{
    collections::HashMap,
    sync::{Arc, OnceLock},
    time::Instant,
};

use glam::DVec3;
use rayon::prelude::*;

use super::{
    Span,
    advance::{Context, Moment},
    arrays::Vectors,
    body::{Body, Neighbour},
    events::Event,
    memory::{self, TooLarge},
    pairs::{self, Pair, PairFinder},
    report::{Diverged, Stage, StepReport},
    surroundings::Surroundings,
};
use crate::{
    model::phase::Phase,
    scene::{self, Scene},
};

/// Fewer vertices than this in motion are not worth a second thread.
const PARALLEL_VERTICES: usize = 8192;

/// The bodies of a scene at an instant, on their way through it.
pub struct World {
    scene: Scene,
    step: u64,
    bodies: Vec<Body>,
    /// Pairs that can touch in the current step, or are not apart; ascending.
    pairs: Vec<Pair>,
    finder: PairFinder,
    /// Phase changes of the current step, grouped by pair.
    changes: Vec<(f64, Phase)>,
    report: StepReport,
    /// Computed when the energy is first asked for.
    pub(super) energy_of_distant_pairs: OnceLock<f64>,
}

impl World {
    /// The scene at t = 0: every displacement and velocity is zero.
    ///
    /// # Errors
    /// [`TooLarge`] if the scene needs more memory than is available; nothing has been allocated then.
    pub fn new(scene: Scene) -> Result<World, TooLarge> {
        memory::check(&scene)?;
        let mut shapes: HashMap<scene::Sphere, Arc<Vectors>> = HashMap::new();
        let bodies = (0..scene.bodies.len())
            .map(|index| {
                let shape = scene.bodies[index].shape;
                let unit = shapes.entry(shape).or_insert_with(|| Arc::new(shape.unit_vertices().into_iter().collect()));
                Body::new(&scene, index, Arc::clone(unit))
            })
            .collect();
        let mut world = World {
            energy_of_distant_pairs: OnceLock::new(),
            step: 0,
            bodies,
            pairs: Vec::new(),
            finder: PairFinder::default(),
            changes: Vec::new(),
            report: StepReport::default(),
            scene,
        };
        world.find_pairs(Span { start: 0.0, end: 0.0 });
        Ok(world)
    }

    /// Advances the world by one step of the scene's Δt and reports what happened.
    pub fn step(&mut self) -> &StepReport {
        let span = Span { start: self.time(), end: self.time_of(self.step + 1) };
        self.step += 1;
        self.report.step = self.step;
        self.report.time = span.end;

        self.timed(Stage::Reach, |world| world.find_pairs(span));
        self.timed(Stage::Events, |world| world.find_events(span));
        self.timed(Stage::Integrate, |world| world.integrate(span));
        self.enter_phases();
        self.report.diverged = self.find_divergence();
        &self.report
    }

    fn timed(&mut self, stage: Stage, work: impl FnOnce(&mut World)) {
        let start = Instant::now();
        work(self);
        self.report.timings[stage as usize] = start.elapsed();
    }

    /// Who can touch whom during `span`.
    fn find_pairs(&mut self, span: Span) {
        let World { scene, bodies, pairs, finder, .. } = self;
        finder.find(scene, bodies, pairs, span);

        for body in bodies.iter_mut() {
            body.neighbours.clear();
        }
        for (index, pair) in (0..).zip(pairs.iter()) {
            bodies[pair.a as usize].neighbours.push(Neighbour { other: pair.b, pair: index });
            bodies[pair.b as usize].neighbours.push(Neighbour { other: pair.a, pair: index });
        }
    }

    /// When pairs change phase during `span`, exactly.
    fn find_events(&mut self, span: Span) {
        let World { scene, pairs, changes, report, .. } = self;
        changes.clear();
        report.events.clear();
        for pair in pairs.iter_mut() {
            let paths = pairs::paths(scene, pair.a, pair.b);
            let first = changes.len();
            let mut from = pair.phase;
            paths.phase_changes(&scene.thresholds, pair.phase, span.start, span.end, |time, to| {
                changes.push((time, to));
                report.events.push(Event { time, step: report.step, a: pair.a, b: pair.b, q: paths.q(time), from, to });
                from = to;
            });
            pair.changes = first..changes.len();
        }
        report.events.sort_by(|x, y| x.time.total_cmp(&y.time));
    }

    /// The equation of motion of every body that something happens to.
    fn integrate(&mut self, span: Span) {
        let World { scene, bodies, pairs, changes, report, .. } = self;
        let context = Context { scene, pairs, changes };
        let advance = |(index, body): (usize, &mut Body)| {
            let effort = context.advance(index, body, span);
            let error = effort.error / scene.bodies[index].radius;
            Total { substeps: effort.substeps, sleeping_bodies: u64::from(effort.substeps == 0), error }
        };

        let moving: usize = bodies.iter().map(|body| body.displacement.len()).sum();
        let total = if moving < PARALLEL_VERTICES {
            bodies.iter_mut().enumerate().map(advance).fold(Total::default(), Total::add)
        } else {
            bodies.par_iter_mut().enumerate().map(advance).reduce(Total::default, Total::add)
        };
        report.substeps = total.substeps;
        report.sleeping_bodies = total.sleeping_bodies;
        report.error = total.error;
    }

    /// The first body whose state cannot be, and its worst vertex.
    fn find_divergence(&self) -> Option<Diverged> {
        let index = self.bodies.iter().position(Body::has_diverged)?;
        let body = self.body(index);
        let size = |i: usize| body.displacement(i).length_squared() + body.velocity(i).length_squared();
        // what is not a number is the worst
        let rank = |i: &usize| if size(*i).is_nan() { f64::INFINITY } else { size(*i) };
        let vertex = (0..body.vertex_count()).max_by(|i, j| rank(i).total_cmp(&rank(j)))?;
        Some(Diverged {
            integrator: self.scene.integrator,
            dt: self.scene.dt,
            step: self.step,
            time: self.time(),
            body: body.name().to_owned(),
            vertex,
            displacement: body.displacement(vertex),
            velocity: body.velocity(vertex),
        })
    }

    /// The phases at the end of the step become those at the start of the next.
    fn enter_phases(&mut self) {
        for pair in &mut self.pairs {
            if let Some(&(_, last)) = self.changes[pair.changes.clone()].last() {
                pair.phase = last;
            }
            pair.changes = 0..0;
        }
    }
}

/// What the integration of bodies adds up to.
#[derive(Clone, Copy, Default)]
struct Total {
    substeps: u64,
    sleeping_bodies: u64,
    error: f64,
}

impl Total {
    /// Sums and the largest error: the same in any order.
    fn add(self, other: Total) -> Total {
        Total {
            substeps: self.substeps + other.substeps,
            sleeping_bodies: self.sleeping_bodies + other.sleeping_bodies,
            error: self.error.max(other.error),
        }
    }
}

/// Looking at the world; nothing here changes it.
impl World {
    /// The scene that is simulated.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Number of steps taken.
    pub fn steps_taken(&self) -> u64 {
        self.step
    }

    /// Simulated time [s]: steps taken times Δt.
    pub fn time(&self) -> f64 {
        self.time_of(self.step)
    }

    fn time_of(&self, step: u64) -> f64 {
        step as f64 * self.scene.dt
    }

    /// What the last step reported.
    pub fn report(&self) -> &StepReport {
        &self.report
    }

    /// Number of bodies.
    pub fn body_count(&self) -> usize {
        self.bodies.len()
    }

    /// Body `index`, in the order of the scene; panics beyond the last, like a slice.
    pub fn body(&self, index: usize) -> BodyView<'_> {
        let body = &self.scene.bodies[index];
        BodyView { body, state: &self.bodies[index], centre: body.path.position(self.time()) }
    }

    /// All bodies, in the order of the scene.
    pub fn bodies(&self) -> impl ExactSizeIterator<Item = BodyView<'_>> {
        (0..self.bodies.len()).map(|index| self.body(index))
    }

    /// Pairs of which one's influence sphere can reach the other's vertices, as far as those swing now, or that are near
    /// enough to merge, or not apart; in ascending order of their bodies. All others are apart, and do nothing to each
    /// other.
    pub fn pairs(&self) -> impl Iterator<Item = PairView> + '_ {
        let time = self.time();
        self.pairs
            .iter()
            .map(move |pair| {
                let paths = pairs::paths(&self.scene, pair.a, pair.b);
                PairView { a: pair.a as usize, b: pair.b as usize, q: paths.q(time), phase: pair.phase }
            })
            .filter(|pair| pair.phase != Phase::Apart || pair.q <= self.reach_of(pair.a, pair.b))
    }

    /// Bodies and phase of every pair that may not be apart.
    pub(super) fn phases(&self) -> impl Iterator<Item = (usize, usize, Phase)> + '_ {
        self.pairs.iter().map(|pair| (pair.a as usize, pair.b as usize, pair.phase))
    }

    /// The q up to which one of two bodies can have vertices inside the other's influence sphere, or can merge [–].
    fn reach_of(&self, a: usize, b: usize) -> f64 {
        let vertices = |i: usize| self.scene.bodies[i].radius + self.bodies[i].amplitude();
        let sphere = |i: usize| self.scene.influence.sphere_radius(self.scene.bodies[i].radius);
        let touching = f64::max(sphere(a) + vertices(b), sphere(b) + vertices(a));
        let radii = self.scene.bodies[a].radius + self.scene.bodies[b].radius;
        (touching / radii).max(self.scene.thresholds.merge_at)
    }

    /// The phase of the pair of bodies `a` and `b`.
    pub fn phase(&self, a: usize, b: usize) -> Phase {
        let key = (a.min(b) as u32, a.max(b) as u32);
        let found = self.pairs.binary_search_by_key(&key, |pair| (pair.a, pair.b));
        found.map_or(Phase::Apart, |index| self.pairs[index].phase)
    }

    /// What acts on body `index` in the current state, but for its own oscillators.
    pub fn surroundings(&self, index: usize) -> Surroundings {
        let time = self.time();
        let mut surroundings = Surroundings::default();
        let context = Context { scene: &self.scene, pairs: &self.pairs, changes: &[] };
        context.surroundings(index, &self.bodies[index], Moment { time, phases_at: time }, &mut surroundings);
        surroundings
    }
}

/// A body of the world at its current time.
#[derive(Clone, Copy)]
pub struct BodyView<'a> {
    body: &'a scene::Body,
    state: &'a Body,
    centre: DVec3,
}

impl<'a> BodyView<'a> {
    /// What the scene says of it.
    pub fn scene(&self) -> &'a scene::Body {
        self.body
    }

    /// Its name.
    pub fn name(&self) -> &'a str {
        &self.body.name
    }

    /// Where its centre is [scene unit].
    pub fn centre(&self) -> DVec3 {
        self.centre
    }

    /// Whether nothing has acted on it yet: every displacement and velocity is exactly zero.
    pub fn is_at_rest(&self) -> bool {
        self.state.is_at_rest()
    }

    /// Number of vertices.
    pub fn vertex_count(&self) -> usize {
        self.state.unit.len()
    }

    /// Unit rest direction l̂ of vertex `i` [–]; panics beyond the last, like a slice.
    pub fn unit(&self, i: usize) -> DVec3 {
        self.state.unit.get(i)
    }

    /// Displacement x of vertex `i` from rest [scene unit].
    pub fn displacement(&self, i: usize) -> DVec3 {
        if self.is_at_rest() { DVec3::ZERO } else { self.state.displacement.get(i) }
    }

    /// Velocity x′ of that displacement [scene unit/s].
    pub fn velocity(&self, i: usize) -> DVec3 {
        if self.is_at_rest() { DVec3::ZERO } else { self.state.velocity.get(i) }
    }

    /// Position of vertex `i` relative to the centre, l + x [scene unit].
    pub fn local_position(&self, i: usize) -> DVec3 {
        self.body.radius * self.unit(i) + self.displacement(i)
    }

    /// World position r = c + l + x of vertex `i` [scene unit].
    pub fn position(&self, i: usize) -> DVec3 {
        self.centre + self.local_position(i)
    }

    /// World positions of all vertices [scene unit].
    pub fn positions(self) -> impl ExactSizeIterator<Item = DVec3> + 'a {
        (0..self.vertex_count()).map(move |i| self.position(i))
    }

    /// The largest |x| of its vertices [scene unit].
    pub fn max_displacement(&self) -> f64 {
        self.state.extent.displacement
    }
}

/// A pair of bodies at the world's current time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PairView {
    /// Index of one body …
    pub a: usize,
    /// … and of the other, a < b.
    pub b: usize,
    /// Centre distance over the sum of the radii [–].
    pub q: f64,
    /// What the two do to each other.
    pub phase: Phase,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What single precision would cost: the state rounded to f32 after every step, against the state as it is.
    #[test]
    fn single_precision_is_not_enough() {
        let scene = Scene::builtin("two").unwrap();
        let (mut world, mut rounded) = (World::new(scene.clone()).unwrap(), World::new(scene).unwrap());
        let mut error = 0.0;
        for _ in 0..world.scene().steps() {
            world.step();
            rounded.step();
            for body in &mut rounded.bodies {
                for vectors in [&mut body.displacement, &mut body.velocity] {
                    for axis in [&mut vectors.x, &mut vectors.y, &mut vectors.z] {
                        axis.iter_mut().for_each(|v| *v = f64::from(*v as f32));
                    }
                }
            }
            for (a, b) in world.bodies().zip(rounded.bodies()) {
                error = a.positions().zip(b.positions()).map(|(a, b)| a.distance(b)).fold(error, f64::max);
            }
        }
        assert!((2e-8..5e-7).contains(&error), "{error:e}"); // of a radius; seen: 1.5e-7
    }
}
