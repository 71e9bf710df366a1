//! Frames, schema and scalars of bodies made of cells.

use std::sync::atomic::AtomicBool;

use glam::{DMat3, DVec3};

use super::{
    Elastic,
    act::{Course, Instantaneous, StepContext},
    body::{Body, Matter},
    free::Free,
    has_free,
};
use crate::{
    geometry::Vectors,
    hash,
    model::{
        phase::Phase,
        shape_matching::{outer, resistance, solve},
    },
    models::lattice::Constants,
    observe::{
        BodyFrame, Frame, Instant, MotionFrame, NearPair, NetForce, PairFrame, Schema, Simulation, StepSummary, Want,
        frame::{TermFrame, weighted_sum},
    },
    scene::{Integrator, Model, Scene, TearMode, path::Kinematics},
    sim::{Cause, terms},
    view::{
        self,
        scalars::{self, ScalarValue, jumping, momenta, smooth},
    },
};

/// Springs are drawn in scenes of at most this many cells: more would hide each other.
const DRAWN_CELLS: usize = 64;

const ENERGY: &str = "Energy [mass·unit²/s²] by kind; work of forces and damping is not counted";

/// A scalar of bodies made of cells; the values of the state also depend on the frames of the bodies.
type Scalar = scalars::Scalar<fn(&Elastic, &[BodyFrame]) -> f64, fn(&Elastic) -> f64>;

/// The scalars of a scene.
fn scalars(scene: &Scene) -> impl Iterator<Item = &'static Scalar> {
    let momenta = if has_free(scene) { &MOMENTA[..] } else { &[] };
    let (of_model, of_tearing) = match (scene.model, scene.lattice.tear) {
        (Model::Fem, _) => (&[][..], if scene.fem.tear_stress.is_some() { TENSION } else { &[] }),
        (_, TearMode::None) => (SPRINGS, &[][..]),
        (_, TearMode::Cut) => (SPRINGS, CUT),
        (_, TearMode::Split) => (SPRINGS, SPLIT),
    };
    [STATE, momenta, SUBSTEPS, of_model, of_tearing].into_iter().flatten()
}

/// Name, plot and label of the scalars of all scenes.
pub fn all_scalars() -> impl Iterator<Item = [&'static str; 3]> {
    let all = [STATE, &MOMENTA, SUBSTEPS, SPRINGS, TENSION, CUT, SPLIT].into_iter().flatten();
    all.map(|scalar| [scalar.name, scalar.plot, scalar.label])
}

const STATE: &[Scalar] = &[
    smooth("energy", "kinetic + elastic [mass·unit²/s²]", ENERGY, |simulation, _| {
        simulation.kinetic_energy() + simulation.elastic_energy()
    }),
    smooth("energy_vibration", "kinetic", ENERGY, |simulation, _| simulation.kinetic_energy()),
    smooth("energy_elastic", "elastic", ENERGY, |simulation, _| simulation.elastic_energy()),
    smooth("max_displacement", "largest displacement [radii]", "Displacement", |simulation, frames| {
        let bodies = simulation.bodies.iter().zip(frames);
        bodies.map(|(body, now)| now.max_displacement / body.radius).fold(0.0, f64::max)
    }),
    smooth("sleeping_bodies", "bodies at rest", "Counts", |simulation, _| {
        let is_still =
            |body: &&Body| body.free.as_ref().is_none_or(|free| [free.velocity, free.spin] == [DVec3::ZERO; 2]);
        simulation.bodies.iter().filter(|body| body.is_at_rest).filter(is_still).count() as f64
    }),
];

/// Only in scenes with free bodies.
const MOMENTA: [Scalar; 6] = momenta([
    |simulation, _| simulation.momentum().x,
    |simulation, _| simulation.momentum().y,
    |simulation, _| simulation.momentum().z,
    |simulation, _| simulation.angular_momentum().x,
    |simulation, _| simulation.angular_momentum().y,
    |simulation, _| simulation.angular_momentum().z,
]);

const SUBSTEPS: &[Scalar] = &[jumping(
    "substeps",
    "steps of the integrator",
    "Counts",
    ScalarValue::SumOfSteps(|simulation| simulation.sum(|body| body.statistics.substeps as f64)),
)];

/// Only of finite elements that would tear.
const TENSION: &[Scalar] = &[
    jumping(
        "tension",
        "largest tension [mass/(unit·s²)]",
        "Tension",
        ScalarValue::MaxOfSteps(|simulation| simulation.largest(|body| body.statistics.tension)),
    ),
    smooth("would_tear", "cells that would have torn", "Counts", |simulation, _| {
        simulation.sum(|body| body.statistics.torn as f64)
    }),
];

/// Only of lattices.
const SPRINGS: &[Scalar] = &[
    jumping(
        "step_limit",
        "longest stable step [s]",
        "Step limit",
        ScalarValue::State(|simulation, _| {
            let limits = simulation.bodies.iter().map(|body| body.statistics.step_limit);
            let limit = limits.fold(f64::INFINITY, f64::min);
            if limit.is_finite() { limit } else { 0.0 }
        }),
    ),
    jumping(
        "strain",
        "largest strain of a spring [–]",
        "Strain",
        ScalarValue::MaxOfSteps(|simulation| simulation.largest(|body| body.statistics.strain)),
    ),
];

/// Only of lattices whose cells are cut.
const CUT: &[Scalar] = &[
    smooth("volume_lost", "fraction of the volume that is lost [–]", "Volume lost", |simulation, _| {
        let volume =
            |body: &Body| body.surface.cells.cell_count() as f64 * (body.surface.cells.size() * body.radius).powi(3);
        simulation.sum(|body| body.statistics.lost * volume(body)) / simulation.sum(volume)
    }),
    smooth("cut_cells", "cells cut", "Counts", |simulation, _| simulation.sum(|body| body.statistics.torn as f64)),
];

/// Only of lattices whose nodes are split.
const SPLIT: &[Scalar] = &[smooth("split_nodes", "nodes split", "Counts", |simulation, _| {
    simulation.sum(|body| body.statistics.split as f64)
})];

/// The schema of a scene of bodies made of cells.
pub fn schema(scene: &Scene) -> Schema {
    let mut schema = view::schema(scene);
    let integrator = match (scene.model, scene.integrator) {
        (Model::Fem, _) => "midpoint",
        (_, Integrator::Exponential) => "substeps",
        (_, other) => other.name(),
    };
    schema.model = scene.model.name().to_owned();
    schema.integrator = integrator.to_owned();
    schema.scalars = scalars(scene).map(|scalar| scalar.schema(scene)).collect();
    let can_tear = scene.model == Model::Lattice && scene.lattice.tear != TearMode::None;
    schema.bodies.iter_mut().for_each(|body| body.can_tear = can_tear);
    for term in &mut schema.terms {
        if term.name == Cause::Restoring.name() {
            term.label = if scene.model == Model::Fem { "Elastic" } else { "Springs" };
        } else if term.name == Cause::Damping.name() {
            term.label = "Dampers";
        }
    }
    let limit = scene.bodies.iter().map(|body| step_limit(scene, body)).fold(f64::INFINITY, f64::min);
    let across = if scene.model == Model::Fem { scene.fem.cells } else { scene.lattice.cells };
    let made_of = match scene.model {
        Model::Fem => format!(
            "Bodies are linear finite elements in {across} cells along a diameter, Poisson's ratio {}; implicit steps of any length are \
             stable.",
            scene.fem.poisson
        ),
        _ => format!(
            "Bodies are lattices of {across} cells along a diameter, each with 28 springs; at rest, steps up to {limit:.2e} s are stable."
        ),
    };
    schema.law = format!("{made_of} {}", schema.law);
    if scene.model == Model::Lattice && scene.integrator != Integrator::Exponential && scene.dt > limit {
        schema.warnings.push(format!(
            "dt = {:?} s is too long for integrator = \"{}\" with this lattice, which is stable up to {limit:.2e} s at rest: lower dt, or \
             choose \"exponential\", the default, with which the model divides dt",
            scene.dt, scene.integrator
        ));
    }
    if scene.tolerance != Scene::DEFAULT_TOLERANCE {
        schema.warnings.push(format!(
            "tolerance has no effect with model = \"{}\": its step length follows from stability, and its accuracy from dt and cells",
            scene.model
        ));
    }
    schema
}

/// The longest stable step of a body at rest without external forces [s]:
/// [`Lattice::step_limit`](crate::models::lattice::Lattice::step_limit), where density and radius cancel.
fn step_limit(scene: &Scene, body: &crate::scene::Body) -> f64 {
    let material = body.material;
    let Constants { young, damping } = Constants::of(material.omega, material.damping, 1.0, 1.0);
    let size = 2.0 / f64::from(scene.lattice.cells);
    let fastest = (8.0 * young).sqrt() / size;
    let ratio = damping * fastest;
    2.0 / (fastest * ((1.0 + ratio * ratio).sqrt() + ratio))
}

impl Elastic {
    /// Whether frames have the springs of the bodies.
    fn has_springs(&self) -> bool {
        let cells = self.bodies.iter().map(|body| body.surface.cells.cell_count()).sum::<usize>();
        self.scene.model == Model::Lattice && cells <= DRAWN_CELLS
    }

    /// The sum of a value over all bodies.
    fn sum(&self, of: impl Fn(&Body) -> f64) -> f64 {
        self.bodies.iter().map(of).sum()
    }

    /// The largest of all bodies' values, at least 0.
    fn largest(&self, of: impl Fn(&Body) -> f64) -> f64 {
        self.bodies.iter().map(of).fold(0.0, f64::max)
    }

    fn kinetic_energy(&self) -> f64 {
        let of = |body: &Body| -> f64 {
            let moving = body.free.as_ref().map_or(DVec3::ZERO, |free| free.velocity);
            let nodes = body.state()[1].iter().zip(body.masses()).enumerate();
            let part = nodes.filter(|(node, _)| body.free.is_none() || !body.held()[*node]);
            part.map(|(_, (u, mass))| 0.5 * mass * (moving + *u).length_squared()).sum()
        };
        self.bodies.iter().filter(|body| !body.is_at_rest || body.free.is_some()).map(of).sum()
    }

    /// Momentum of free bodies [mass · scene unit/s].
    pub fn momentum(&self) -> DVec3 {
        let of = |body: &Body| body.free.as_ref().map_or(DVec3::ZERO, |free| free.velocity * body.free_mass());
        self.bodies.iter().map(of).sum()
    }

    /// Angular momentum of free bodies about the origin [mass · scene unit²/s].
    pub fn angular_momentum(&self) -> DVec3 {
        let of = |body: &Body| {
            let whole = |free: &Free| free.centre.cross(free.velocity) * body.free_mass();
            body.free.as_ref().map_or(DVec3::ZERO, whole) + body.angular_momentum()
        };
        self.bodies.iter().map(of).sum()
    }

    /// The centre of a body [scene unit].
    pub(super) fn centre(&self, body: usize) -> DVec3 {
        let path = || self.path(body).map_or(DVec3::ZERO, |path| path.position(self.time_of(self.step)));
        self.bodies[body].free.as_ref().map_or_else(path, |free| free.centre)
    }

    /// The velocity of the centre of a body [scene unit/s].
    fn velocity(&self, body: usize) -> DVec3 {
        let path = || self.path(body).map_or(DVec3::ZERO, |path| path.at(self.time_of(self.step)).velocity);
        self.bodies[body].free.as_ref().map_or_else(path, |free| free.velocity)
    }

    fn radii(&self, a: usize, b: usize) -> f64 {
        self.bodies[a].radius + self.bodies[b].radius
    }

    /// The distance up to which two bodies, as deformed as they are, can act on each other, touch or merge [scene unit].
    fn reach_of(&self, a: usize, b: usize) -> f64 {
        let extent = |body: usize| self.bodies[body].extent.max(self.bodies[body].radius);
        let sphere = |body: usize| self.scene.bodies[body].sphere_radius();
        let of_spheres = f64::max(sphere(a) + extent(b), sphere(b) + extent(a));
        let merge_at = self.scene.law(a, b).thresholds.merge_at;
        of_spheres.max(extent(a) + extent(b)).max(merge_at * self.radii(a, b))
    }

    /// The pairs that can act on each other, are near enough to merge, or are not apart.
    fn near_pairs(&self, pairs: &mut Vec<PairFrame>) {
        for pair in self.near_each_other() {
            let [a, b] = pair.map(|body| body as usize);
            let (apart, radii) = (self.centre(b) - self.centre(a), self.radii(a, b));
            let distance = apart.length();
            let phase = self.phases.get(&pair).copied().unwrap_or(Phase::Apart);
            if phase != Phase::Apart || distance <= self.reach_of(a, b) {
                let rate = apart.normalize_or_zero().dot(self.velocity(b) - self.velocity(a)) / radii;
                pairs.push(PairFrame::new(a, b, distance / radii, phase as usize).with_rate(rate));
            }
        }
    }

    fn elastic_energy(&self) -> f64 {
        self.bodies.iter().filter(|body| !body.is_at_rest).map(Body::elastic_energy).sum()
    }

    /// Where the centres and force points are now.
    fn courses(&self) -> Vec<Course<'_>> {
        let time = self.time_of(self.step);
        let of_bodies = (0..self.bodies.len()).map(|body| Kinematics {
            position: self.centre(body),
            velocity: self.velocity(body),
            acceleration: DVec3::ZERO,
        });
        let of_points = self.scene.points.iter().map(|point| point.path.at(time));
        of_bodies.chain(of_points).map(|motion| Course::Parabola(time, motion)).collect()
    }

    /// Adds the forces on a body in its current state, interpolated from its nodes to the vertices.
    fn add_forces(&self, body: &Body, sources: &[u32], around: &StepContext<'_>, now: &mut BodyFrame) {
        let causes: Vec<Cause> = Cause::of(&self.scene).collect();
        let (time, mut acting) = (around.start, Instantaneous::default());
        around.acting(body.index, sources, &body.pushes, [time, time], time, &mut acting);
        let (n, back) = (body.node_count(), body.axes().transpose());
        let [positions, velocities] = body.state();
        let mut by_cause: Vec<(Cause, Vec<DVec3>)> = Vec::new();
        let mut add = |cause: Cause, of: &dyn Fn(usize) -> DVec3| {
            let at = by_cause.iter().position(|(known, _)| *known == cause).unwrap_or_else(|| {
                by_cause.push((cause, vec![DVec3::ZERO; n]));
                by_cause.len() - 1
            });
            for (node, sum) in by_cause[at].1.iter_mut().enumerate() {
                *sum += of(node);
            }
        };
        let weight = self.scene.influence.weight;
        for sphere in &acting.spheres {
            add(sphere.cause(), &|node| sphere.acceleration(weight, positions[node]));
        }
        for &(direction, strength) in &acting.pushes {
            let towards = back * direction;
            add(Cause::Push, &|node| direction * (strength * f64::max(0.0, -body.directions[node].dot(towards))));
        }
        if let Some(path) = self.path(body.index) {
            let material = &self.scene.bodies[body.index].material;
            for (cause, force) in terms::uniform_by_cause(&self.scene, material, &path.before(time)) {
                add(cause, &|_| force);
            }
        }
        if !self.scene.planes.is_empty() {
            let (centre, velocity) = (self.centre(body.index), self.velocity(body.index));
            let mut pressed = vec![DVec3::ZERO; n];
            let friction = body.acted.friction.as_slice();
            let velocity = (self.step == 0).then_some((velocities, velocity));
            body.contacts(&self.scene, centre, positions, |contact| {
                contact.accelerate(body.masses(), velocity, &mut pressed);
            });
            pressed.iter_mut().zip(friction).for_each(|(pressed, friction)| *pressed += *friction);
            add(Cause::Plane, &|node| pressed[node]);
        }
        if !body.is_at_rest {
            let [springs, dampers] = body.internal();
            // what keeps the torque of linear forces from turning the body belongs to them
            let turning = match body.free.is_some() && self.scene.model == Model::Fem {
                true => {
                    let all = || positions.iter().zip(body.masses());
                    let internal = springs.iter().zip(&dampers).map(|(spring, damper)| *spring + *damper);
                    let torque = all().zip(internal).map(|((s, m), f)| s.cross(f * *m)).sum();
                    solve(
                        resistance(all().map(|(s, m)| outer(*s * *m, *s)).fold(DMat3::ZERO, |sum, of| sum + of)),
                        torque,
                    )
                }
                false => DVec3::ZERO,
            };
            let turning = if turning.is_finite() { turning } else { DVec3::ZERO };
            add(Cause::Restoring, &|node| springs[node] - turning.cross(positions[node]));
            add(Cause::Damping, &|node| dampers[node]);
        }
        let mut back_at_centre = DVec3::ZERO;
        if body.free.is_some() {
            let reaction = self.reaction(body, sources, around);
            back_at_centre = reaction;
            let per_mass = reaction / body.free_mass();
            for (cause, whole) in terms::free_fall_by_cause(&self.scene).chain([(Cause::Reaction, per_mass)]) {
                if whole != DVec3::ZERO {
                    add(cause, &|_| whole);
                }
            }
        }
        let count = now.mesh.as_ref().map_or(body.surface.mesh.vertex_count(), |mesh| mesh.vertex_count());
        now.terms.resize_with(causes.len(), Default::default);
        let (mut net, mut net_mean, mass_now) = (Vectors::zeros(count), DVec3::ZERO, body.free_mass());
        let mut of_vertices = Vectors::default();
        for (cause, term) in causes.iter().zip(&mut now.terms) {
            (term.source, term.mean) = (None, body.free.as_ref().map(|_| DVec3::ZERO));
            term.accelerations.clear();
            let Some((_, nodes)) = by_cause.iter_mut().find(|(known, _)| known == cause) else { continue };
            // no force acts on held nodes
            nodes.iter_mut().zip(body.held()).filter(|(_, held)| **held).for_each(|(sum, _)| *sum = DVec3::ZERO);
            if nodes.iter().all(|sum| *sum == DVec3::ZERO) {
                continue;
            }
            at_vertices(body, nodes, count, &mut of_vertices);
            if now.mesh.is_some() {
                (0..body.surface.cells.embedded.len()).for_each(|former| of_vertices.set(former, DVec3::ZERO));
            }
            term.accelerations.copy_from(&of_vertices);
            net.add_times(1.0, &of_vertices);
            if body.free.is_some() {
                let mean = weighted_sum(nodes.iter().copied().zip(body.masses().iter().map(|mass| mass / mass_now)));
                (term.mean, net_mean) = (Some(mean), net_mean + mean);
            }
            let mut of_cause = acting.spheres.iter().filter(|sphere| sphere.cause() == *cause);
            if let (Some(only), None) = (of_cause.next(), of_cause.next()) {
                term.source = only.body();
            }
        }
        now.net_force = body.free.is_some().then(|| {
            let outer = [Cause::Attraction, Cause::Repulsion, Cause::Core, Cause::Point, Cause::Push, Cause::Plane];
            let (mut force, mut torque) =
                (back_at_centre + terms::free_fall(&self.scene) * body.free_mass(), DVec3::ZERO);
            for (_, nodes) in by_cause.iter().filter(|(cause, _)| outer.contains(cause)) {
                for ((f, m), place) in nodes.iter().zip(body.masses()).zip(positions) {
                    force += *f * *m;
                    torque += place.cross(*f * *m);
                }
            }
            NetForce::new(force, torque, mass_now)
        });
        let label = |i: usize| {
            view::terms::label([Cause::Attraction, Cause::Repulsion, Cause::Core].map(|cause| {
                let at = causes.iter().position(|known| *known == cause);
                let forces = at.map(|at| &now.terms[at].accelerations);
                forces.is_some_and(|forces| !forces.is_empty() && forces.get(i) != DVec3::ZERO)
            }))
        };
        let labels: Vec<u8> = (0..count).map(label).collect();
        now.labels = labels;
        now.has_forces = true;
        if let Some(at) = causes.iter().position(|cause| *cause == Cause::Net) {
            now.terms[at] = TermFrame { mean: body.free.as_ref().map(|_| net_mean), ..TermFrame::new(net, None) };
        }
    }
}

impl Elastic {
    /// The reaction to the forces of a free body's sphere on others [mass · scene unit/s²].
    fn reaction(&self, body: &Body, others: &[u32], around: &StepContext<'_>) -> DVec3 {
        let (time, weight) = (around.start, self.scene.influence.weight);
        let mut acting = Instantaneous::default();
        let mut sum = DVec3::ZERO;
        for other in others.iter().filter_map(|&other| self.bodies.get(other as usize)) {
            around.acting(other.index, &[body.index as u32], &[], [time, time], time, &mut acting);
            for sphere in &acting.spheres {
                for ((node, place), mass) in other.state()[0].iter().enumerate().zip(other.masses()) {
                    if other.free.is_none() || !other.held()[node] {
                        sum -= sphere.acceleration(weight, *place) * *mass;
                    }
                }
            }
        }
        sum
    }
}

/// A quantity of the nodes, interpolated to the current vertices of a body.
fn at_vertices(body: &Body, nodes: &[DVec3], count: usize, vertices: &mut Vectors) {
    vertices.clear();
    let corners = body.corners();
    for embedded in &body.surface.cells.embedded {
        vertices.push(embedded.mean(&corners[embedded.cell as usize], nodes));
    }
    if count > vertices.len() {
        body.surface.exposed.iter().for_each(|&node| vertices.push(nodes[node as usize]));
    }
}

impl Simulation for Elastic {
    fn schema(&self) -> Schema {
        let (mut schema, has_springs) = (schema(&self.scene), self.has_springs());
        schema.bodies.iter_mut().for_each(|body| body.has_springs = has_springs);
        schema
    }

    fn overrides(&self, steps: Option<u64>) -> Result<String, String> {
        self.scene.overrides(steps)
    }

    fn steps_taken(&self) -> u64 {
        self.step
    }

    fn time(&self) -> f64 {
        self.time_of(self.step)
    }

    fn step(&mut self, summary: &mut StepSummary) {
        self.take_step();
        summary.at = match &self.failure {
            Some(failure) if !failure.is_whole_step() => {
                Instant { step: self.step + 1, time: self.time_of(self.step + 1) }
            }
            _ => self.now(),
        };
        summary.events.extend_from_slice(&self.events);
        summary.body_events.extend_from_slice(&self.tears);
        summary.timings.extend(self.timings);
        summary.scalars.extend(scalars(&self.scene).map(|scalar| match scalar.value {
            ScalarValue::State(_) => 0.0,
            ScalarValue::SumOfSteps(value) | ScalarValue::MaxOfSteps(value) => value(self),
        }));
        summary.failure.clone_from(&self.failure);
    }

    fn near(&self, pairs: &mut Vec<NearPair>) {
        pairs.clear();
        pairs.extend(self.near_each_other().into_iter().map(|pair| {
            let [a, b] = pair.map(|body| body as usize);
            let phase = self.phases.get(&pair).copied().unwrap_or(Phase::Apart) as usize;
            let (apart, rate) = (self.centre(b) - self.centre(a), self.velocity(b) - self.velocity(a));
            NearPair { a, b, phase, apart, rate }
        }));
    }

    fn reach(&self, a: usize, b: usize) -> f64 {
        self.reach_of(a, b) / self.radii(a, b)
    }

    fn on_path(&self, body: usize, time: f64) -> Option<[DVec3; 2]> {
        view::on_path(&self.scene, body, time)
    }

    fn framing(&self, only_what_happens: bool) -> Vec<(DVec3, f64)> {
        view::camera::framing(&self.scene, only_what_happens)
    }

    fn interrupt(&self) -> Option<&'static AtomicBool> {
        self.options.interrupt
    }

    fn account(&self) -> Option<String> {
        let torn = |body: &&Body| body.statistics.first.is_some();
        let first = self.bodies.iter().filter(torn).min_by(|a, b| {
            let time = |body: &Body| body.statistics.first.map_or(f64::INFINITY, |(time, _)| time);
            time(a).total_cmp(&time(b))
        })?;
        let (time, place) = first.statistics.first?;
        let name = &self.scene.bodies[first.index].name;
        let what = match (&first.matter, self.scene.lattice.tear) {
            (Matter::Fem(_), _) => format!(
                "would tear: {} cells beyond tear_stress; with a factored stiffness, bodies cannot tear",
                self.sum(|body| body.statistics.torn as f64)
            ),
            (_, TearMode::Split) => {
                format!("torn: {} nodes split, no volume lost", self.sum(|body| body.statistics.split as f64))
            }
            _ => {
                let cells = self.sum(|body| body.surface.cells.cell_count() as f64);
                let cut = self.sum(|body| body.statistics.torn as f64);
                format!("torn: {cut} of {cells} cells cut, their volume lost")
            }
        };
        Some(format!(
            "{what}; first body \"{name}\" at ({:.4}, {:.4}, {:.4}), t = {time:.6} s",
            place.x, place.y, place.z
        ))
    }

    fn checksum(&self) -> u64 {
        let words = self.bodies.iter().filter(|body| !body.is_at_rest).flat_map(|body| {
            let vectors = body.state().into_iter().flatten().flat_map(|v| v.to_array());
            [body.index as u64, body.x.len() as u64, body.statistics.torn, body.statistics.split]
                .into_iter()
                .chain(vectors.map(hash::bits))
        });
        let phases =
            self.phases.iter().flat_map(|(pair, phase)| [u64::from(pair[0]), u64::from(pair[1]), *phase as u64]);
        let free = self.bodies.iter().filter_map(|body| body.free.as_ref()).flat_map(|free| {
            let vectors = [free.centre, free.velocity].into_iter().flat_map(|v| v.to_array());
            vectors.chain(free.rotation.to_array()).map(hash::bits)
        });
        hash::sequence([self.step].into_iter().chain(words).chain(phases).chain(free))
    }

    fn observe(&self, want: Want, frame: &mut Frame) {
        frame.at = self.now();
        frame.pairs.clear();
        self.near_pairs(&mut frame.pairs);
        frame.bodies.resize_with(self.bodies.len(), BodyFrame::default);
        let has_springs = want.forces && self.has_springs();
        let mut around: Vec<Vec<u32>> = vec![Vec::new(); if want.forces { self.bodies.len() } else { 0 }];
        if want.forces {
            for pair in &frame.pairs {
                around[pair.a].push(pair.b as u32);
                around[pair.b].push(pair.a as u32);
            }
        }
        let (Elastic { scene, phases, step, .. }, courses, time) = (self, self.courses(), frame.at.time);
        let now_around =
            StepContext { scene, courses: &courses, phases, events: &[], start: time, end: time, step: *step };
        for (body, now) in self.bodies.iter().zip(&mut frame.bodies) {
            now.centre = self.centre(body.index);
            now.rotation = body.rotation();
            now.motion = body.free.as_ref().map(|free| MotionFrame { velocity: free.velocity, spin: free.spin });
            now.net_force = None;
            now.mesh.clone_from(&body.torn);
            if body.is_at_rest {
                now.rest();
            } else {
                let mesh = now.mesh.clone().unwrap_or_else(|| body.surface.mesh.clone());
                let count = mesh.vertex_count();
                at_vertices(body, &body.x, count, &mut now.displacements);
                at_vertices(body, &body.u, count, &mut now.velocities);
                now.displaced(mesh.at(body.radius));
                if now.mesh.is_some() {
                    // the vertices of the surface before it tore are no longer part of it
                    now.lengths[..body.surface.cells.embedded.len()].fill(0.0);
                    now.max_displacement = now.lengths.iter().copied().fold(0.0, f64::max);
                }
            }
            now.clear_forces();
            if has_springs {
                body.add_springs(&mut now.springs);
            }
            if let Some(sources) = around.get_mut(body.index) {
                let acting = self.scene.points_on(body.index).filter(|(_, point)| point.acts_at(frame.at.time));
                sources.extend(acting.map(|(source, _)| source));
            }
            let sources = around.get_mut(body.index);
            if let Some(sources) =
                sources.filter(|sources| !(body.is_at_rest && sources.is_empty() && body.free.is_none()))
            {
                sources.extend(body.sources.iter().copied());
                sources.sort_unstable();
                sources.dedup();
                self.add_forces(body, sources, &now_around, now);
            }
        }
        frame.scalars.clear();
        if want.scalars {
            frame.scalars.extend(scalars(&self.scene).map(|scalar| match scalar.value {
                ScalarValue::State(value) => value(self, &frame.bodies) + 0.0, // the sum of nothing is −0
                ScalarValue::SumOfSteps(_) | ScalarValue::MaxOfSteps(_) => 0.0,
            }));
        }
    }
}
