//! A body of a coupled scene: its state, bounds of its motion in a step, and whether it is at rest.

use std::{collections::HashMap, sync::Arc};

use glam::{DMat3, DVec3};
use rustc_hash::FxBuildHasher;

use crate::{
    geometry::{Mesh, Vectors},
    model::{
        oscillator::Oscillator,
        shape_matching::{Plane, resistance, rotation_by, solve},
    },
    scene::{self, Motion, Push, Scene},
    sim::{
        checksum,
        free::{Body, Driven, Place, Shape, Way},
        neighbours::{FatBounds, Neighbours},
        numerics::control::{MAX_SLOW_TOLERANCE, NEGLIGIBLE, NEGLIGIBLE_TOLERANCE, SLOW_TIME},
        span::Span,
        terms::{self, carry},
    },
};

/// How much farther than in free flight a body may move in a step before the step is repeated [radii].
const SLACK: f64 = 0.05;
/// Least and largest number of steps of fixed length within the tolerance before adaptive ones are tried again.
const MIN_WAIT: u16 = 30;
const MAX_WAIT: u16 = 1920;

/// A body, and the solver's bookkeeping for it.
#[derive(Clone)]
pub(in crate::sim) struct Member {
    /// Its rest shape.
    pub mesh: Arc<Mesh>,
    /// Its state. An undeformed body has empty lists of displacements and velocities.
    pub body: Body,
    /// Step length with which its island last met the tolerance [s].
    pub step_length: f64,
    /// Whether its island takes steps of fixed length.
    pub fixed: FixedSteps,
    /// Number of consecutive steps after which it was slow.
    pub slow_steps: u32,
    /// Its motion at the end of the first of these steps.
    pub slow_from: Drift,
    /// Whether it takes steps; otherwise it rests and keeps its state.
    pub is_awake: bool,
    /// How far it may move in the current step.
    pub bounds: MemberBounds,
    /// The fat bounds for which its neighbours were found.
    pub fat: FatBounds,
    /// Nearby bodies, ascending.
    pub neighbours: Neighbours,
    /// A bound on the distance of its vertices from the centre [scene unit].
    pub extent: f64,
    /// A bound on the speed of its vertices relative to the frame [scene unit/s].
    pub speed: f64,
    /// [`Member::hash`] while it rests.
    pub sleeping_hash: u64,
    /// Angular velocity, if the body turns like a rigid one, see [`Member::find_rigid_spin`] [rad/s].
    pub rigid_spin: Option<DVec3>,
    /// The pushes on it, in order of their starts.
    pub pushes: Box<[Push]>,
}

/// The velocity of a body [scene unit/s] and the angular velocity of its frame [rad/s].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(in crate::sim) struct Drift {
    velocity: DVec3,
    spin: DVec3,
}

/// Whether the island of a body takes steps of fixed length, because adaptive ones were too much work.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(in crate::sim) struct FixedSteps {
    /// Number of steps within the tolerance until adaptive ones are tried again; 0 if it takes these.
    pub left: u16,
    /// That number when they were last given up; 0 if they never were.
    pub wait: u16,
}

impl FixedSteps {
    /// Of an island with bodies of both kinds.
    pub fn join(self, other: FixedSteps) -> FixedSteps {
        FixedSteps { left: self.left.max(other.left), wait: self.wait.max(other.wait) }
    }

    /// After adaptive steps were given up: each time, the next try is later.
    pub fn begin(self) -> FixedSteps {
        let wait = (2 * self.wait).clamp(MIN_WAIT, MAX_WAIT);
        FixedSteps { left: wait, wait }
    }
}

/// Bounds on the motion of a body in a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(in crate::sim) struct MemberBounds {
    /// Largest distance of the centre from its initial position [scene unit].
    pub way: f64,
    /// Largest distance of a vertex from the centre [scene unit].
    pub extent: f64,
}

/// Rest shapes at the scale of bodies, shared by equal bodies.
#[derive(Clone, Default)]
pub(in crate::sim) struct Shapes(HashMap<(usize, u64, u64), Arc<Shape>, FxBuildHasher>);

impl Shapes {
    /// Forgets shapes that no body has: their meshes may be gone.
    pub fn forget_unused(&mut self) {
        self.0.retain(|_, shape| Arc::strong_count(shape) > 1);
    }

    fn get(&mut self, mesh: &Arc<Mesh>, radius: f64, mass: f64) -> Arc<Shape> {
        let key = (Arc::as_ptr(mesh) as usize, radius.to_bits(), mass.to_bits());
        let make = || {
            let rest = mesh.at(radius);
            let masses = mesh.shares().iter().map(|share| mass * share).collect();
            Arc::new(Shape::new((0..rest.len()).map(|i| rest.position(i)).collect(), masses))
        };
        Arc::clone(self.0.entry(key).or_insert_with(make))
    }
}

impl Member {
    /// A body of the scene that starts at `time` [s], awake.
    pub fn new(scene: &Scene, index: usize, shapes: &mut Shapes, time: f64) -> Member {
        let body = &scene.bodies[index];
        let mesh = body.shape.mesh();
        let mut pushes: Vec<Push> = scene.pushes.iter().filter(|push| push.body == index).copied().collect();
        pushes.sort_by(|p, q| p.start.total_cmp(&q.start));
        let shape = shapes.get(&mesh, body.radius, body.mass);
        let oscillator = body.material.oscillator();
        let extent = shape.extent();
        let sphere_radius = body.sphere_radius();
        let body = match &body.motion {
            Motion::Prescribed(path) => {
                let mut prescribed = Body::prescribed(shape, body.radius, oscillator);
                prescribed.follow(path.at(time));
                prescribed
            }
            Motion::Free(free) => {
                let mut thrown = Body::free(shape, body.radius, oscillator, free.rotation);
                thrown.throw(free.from, free.velocity, free.spin);
                thrown
            }
        };
        let speed = body.u.iter().map(|u| u.length()).fold(0.0, f64::max);
        let mut member = Member {
            mesh,
            body: Body { sphere_radius, ..body },
            step_length: f64::INFINITY,
            fixed: FixedSteps::default(),
            slow_steps: 0,
            slow_from: Drift::default(),
            is_awake: true,
            bounds: MemberBounds::default(),
            fat: FatBounds::default(),
            neighbours: Neighbours::new(),
            extent,
            speed,
            sleeping_hash: 0,
            rigid_spin: None,
            pushes: pushes.into(),
        };
        if speed == 0.0 {
            member.clear_deformation();
        }
        member
    }

    /// Adds a push on it.
    pub fn add_push(&mut self, push: &Push) {
        let mut pushes = std::mem::take(&mut self.pushes).into_vec();
        pushes.insert(pushes.partition_point(|other| other.start <= push.start), *push);
        self.pushes = pushes.into();
    }

    /// Takes over the state of another body with the same shape.
    pub fn resume(&mut self, before: &Member) {
        let Member { body, step_length, fixed, slow_steps, slow_from, is_awake, extent, speed, rigid_spin, .. } =
            before;
        self.fixed = *fixed;
        let is_same = self.body.oscillator == body.oscillator;
        let Body { sphere_radius, oscillator, .. } = self.body;
        self.body = Body { shape: Arc::clone(&self.body.shape), sphere_radius, oscillator, ..body.clone() };
        (self.step_length, self.slow_steps, self.slow_from, self.is_awake) =
            (*step_length, *slow_steps, *slow_from, *is_awake);
        (self.extent, self.speed, self.rigid_spin) = (*extent, *speed, rigid_spin.filter(|_| is_same));
    }

    /// Makes the body undeformed. Returns the error that this is [radii].
    pub fn clear_deformation(&mut self) -> f64 {
        let error = self.displacement() + self.speed / self.body.oscillator.omega.max(1.0);
        (self.body.x, self.body.u) = (Vec::new(), Vec::new());
        (self.extent, self.speed) = (self.body.shape.extent(), 0.0);
        error / self.body.radius
    }

    /// The largest |x| [scene unit].
    fn displacement(&self) -> f64 {
        self.body.x.iter().map(|x| x.length_squared()).fold(0.0, f64::max).sqrt()
    }

    /// Whether the body has displacements and velocities.
    pub fn is_deformed(&self) -> bool {
        !self.body.x.is_empty()
    }

    /// Sets the expected bounds on its motion during `span`. If it moves farther, [`Member::left_bounds`] detects that and
    /// the step is repeated.
    pub fn bound_motion(&mut self, scene: &scene::Body, free_fall: DVec3, span: Span) {
        let Member { body, extent, speed, .. } = self;
        let (slack, h) = (SLACK * body.radius, span.length());
        let way = match scene.path() {
            Some(path) => path.bounds(span.start, span.end).speed * h,
            None => {
                let given = scene.force.as_ref().map_or(0.0, scene::Force::bound);
                1.5 * body.velocity.length() * h + 0.5 * (free_fall.length() + given) * h * h
            }
        };
        self.bounds = MemberBounds { way: slack + way, extent: *extent + slack + 1.5 * *speed * h };
    }

    /// Whether it may touch one of `planes` in the step.
    pub fn touches(&self, planes: &[Plane]) -> bool {
        let MemberBounds { way, extent } = self.bounds;
        planes.iter().any(|plane| plane.depth(self.body.centre) + extent + way > 0.0)
    }

    /// Whether the body moved farther than expected; if so, widens its bounds.
    pub fn left_bounds(&mut self, way: &Way) -> bool {
        let MemberBounds { way: max_way, extent } = &mut self.bounds;
        let is_beyond = [(way.centre, max_way), (way.extent, extent)].map(|(moved, max)| {
            let is_beyond = moved > *max;
            if is_beyond {
                *max = 2.0 * moved;
            }
            is_beyond
        });
        is_beyond != [false; 2]
    }

    /// Whether the body is nearly still: neither its rigid motion nor its vibration moves a vertex faster than half of
    /// the error growth that the tolerance allows.
    ///
    /// A body that is slow for half a second and [does not speed up](Member::stays_slow) rests: its velocities are set
    /// to zero and its displacements kept. The resulting error grows by less than half of the tolerance. No rule wakes
    /// a resting body that would have sped up, so a body must be slow for long enough to reveal an unstable
    /// equilibrium.
    pub fn is_slow(&self, tolerance: f64) -> bool {
        let max = self.max_slow_speed(tolerance);
        let swing = self.speed / self.body.oscillator.omega.max(1.0);
        swing <= max && self.body.velocity.length() + self.body.frame_spin().length() * self.extent <= max
    }

    /// The largest speed of any point of a slow body [scene unit/s].
    fn max_slow_speed(&self, tolerance: f64) -> f64 {
        NEGLIGIBLE * tolerance.min(MAX_SLOW_TOLERANCE) * self.body.radius
    }

    /// Counts another step of `h` [s] after which the body is slow. Returns whether it has been slow for long enough to
    /// rest.
    pub fn stays_slow(&mut self, tolerance: f64, h: f64) -> bool {
        let now = Drift { velocity: self.body.velocity, spin: self.body.frame_spin() };
        if self.slow_steps == 0 {
            self.slow_from = now;
        }
        self.slow_steps += 1;
        if f64::from(self.slow_steps) < (SLOW_TIME / h).ceil().max(2.0) {
            return false;
        }
        // a steady acceleration must gain no more than the slow speed per second
        let Drift { velocity, spin } = self.slow_from;
        let gained = (now.velocity - velocity).length() + (now.spin - spin).length() * self.extent;
        let steady = gained <= self.max_slow_speed(tolerance) * f64::from(self.slow_steps) * h;
        if !steady {
            self.slow_steps = 0;
        }
        steady
    }

    /// Whether its deformation is so small that setting it to zero is an error of less than a tenth of the tolerance.
    /// That is done if nothing acts on the body.
    pub fn is_nearly_undeformed(&self, tolerance: f64) -> bool {
        let max = NEGLIGIBLE * tolerance.min(NEGLIGIBLE_TOLERANCE) * self.body.radius;
        self.displacement() <= max && self.speed <= max * self.body.oscillator.omega.max(1.0)
    }

    /// Angular velocity Ω at which the body goes on turning like a rigid one if nothing acts on it: its vertices move
    /// with s′ = Ω×s, and springs balance the centrifugal force, ω² x = −Ω×(Ω×s), both within a tenth of the tolerance.
    /// Damping leads there.
    ///
    /// Ω must be along the axis of largest moment: about any other axis, the rotation of a damped body is unstable.
    pub fn find_rigid_spin(&self, tolerance: f64) -> Option<DVec3> {
        let body = &self.body;
        let Oscillator { omega, damping } = body.oscillator;
        if !body.turns() || damping == 0.0 || !self.is_deformed() {
            return None;
        }
        let (shape, axes) = (&body.shape, DMat3::from_quat(body.rotation));
        let position = |i: usize| axes * shape.rest()[i] + body.x[i];
        let mut squares = DMat3::ZERO;
        for (i, &m) in shape.masses().iter().enumerate() {
            let s = position(i);
            squares += DMat3::from_cols(m * s.x * s, m * s.y * s, m * s.z * s);
        }
        let (inertia, frame_spin) = (resistance(squares), body.frame_spin());
        let spin = solve(inertia, body.spin);
        // deviations of the vertices change the moments too, and thus the spin: this error grows with |Ω|
        let max = NEGLIGIBLE * tolerance.min(NEGLIGIBLE_TOLERANCE) * body.radius / spin.length().max(1.0);
        let wobble = solve(inertia, spin.cross(inertia * spin));
        if !(spin != DVec3::ZERO && wobble.length() * self.extent <= max && is_largest(inertia, spin)) {
            return None;
        }
        let (max_speed, max_force) = (max * omega.max(1.0), max * omega * omega);
        let is_steady = (0..body.x.len()).all(|i| {
            let s = position(i);
            let rate = frame_spin.cross(s - body.x[i]) + body.u[i];
            let turning = spin.cross(s);
            let force = omega * omega * body.x[i] + spin.cross(turning);
            (rate - turning).length() <= max_speed && force.length() <= max_force
        });
        is_steady.then_some(spin)
    }

    /// Turns the body like a rigid one at `spin` [rad/s] for `h` [s].
    pub fn turn(&mut self, spin: DVec3, h: f64) {
        let turn = rotation_by(h * spin);
        let Body { rotation, x, u, .. } = &mut self.body;
        *rotation = (turn * *rotation).normalize();
        let turn = DMat3::from_quat(turn);
        x.iter_mut().chain(u).for_each(|v| *v = turn * *v);
    }

    /// Kinetic energy of a free body: translation, rotation and vibration [mass · scene unit²/s²]; zero on a path.
    fn kinetic_energy(&self) -> f64 {
        let Body { shape, velocity, rotation, .. } = &self.body;
        if !self.body.is_free() {
            return 0.0;
        }
        let (axes, spin) = (DMat3::from_quat(*rotation), self.body.frame_spin());
        let about_centre = |(i, (&l, &m)): (usize, (&DVec3, &f64))| {
            let u = self.body.u.get(i).copied().unwrap_or_default();
            0.5 * m * (spin.cross(axes * l) + u).length_squared()
        };
        let vertices = shape.rest().iter().zip(shape.masses()).enumerate().map(about_centre);
        0.5 * shape.mass() * velocity.length_squared() + vertices.sum::<f64>()
    }

    /// Sets all velocities to zero. Returns the lost energy [mass · scene unit²/s²].
    pub fn stop(&mut self) -> f64 {
        let lost = self.kinetic_energy();
        let Body { velocity, spin, u, .. } = &mut self.body;
        (*velocity, *spin) = (DVec3::ZERO, DVec3::ZERO);
        u.fill(DVec3::ZERO);
        self.speed = 0.0;
        lost
    }

    /// Displacements and velocities of all vertices.
    pub fn states_into(&self, displacement: &mut Vectors, velocity: &mut Vectors) {
        for (into, from) in [(displacement, &self.body.x), (velocity, &self.body.u)] {
            into.reset(self.body.shape.rest().len());
            from.iter().enumerate().for_each(|(i, &vector)| into.set(i, vector));
        }
    }

    /// A hash of its state; 0 for an undeformed body at rest on a path.
    pub fn hash(&self, index: u32) -> u64 {
        if !self.body.is_free() && !self.is_awake && !self.is_deformed() {
            return 0;
        }
        let is_steady = u64::from(self.rigid_spin.is_some());
        let FixedSteps { left, wait } = self.fixed;
        let flags = u64::from(self.is_awake) + 2 * is_steady + 4 * (u64::from(left) + (u64::from(wait) << 16));
        let others = [u64::from(self.slow_steps), flags, self.step_length.to_bits()];
        checksum::of_body(index, &self.body, others)
    }

    /// Approximate work of evaluating its forces: number of vertices times one plus the number of neighbours.
    pub fn size(&self) -> u64 {
        self.body.shape.rest().len() as u64 * (1 + self.neighbours.len() as u64)
    }
}

/// Whether no axis has a larger moment of inertia than that of `spin`.
fn is_largest(inertia: DMat3, spin: DVec3) -> bool {
    let axis = spin.normalize_or_zero();
    let own = axis.dot(inertia * axis);
    // compare with the larger eigenvalue of the moments across the axis
    let (across, second) = (axis.any_orthonormal_vector(), axis.cross(axis.any_orthonormal_vector()));
    let (a, b, c) = (across.dot(inertia * across), second.dot(inertia * second), across.dot(inertia * second));
    let half = 0.5 * (a - b);
    own >= 0.5 * (a + b) + (half * half + c * c).sqrt()
}

/// The motion at `t` [s] of a body on a path, or of a force point, which follow the bodies; the left limit if `before`
/// is set.
pub(in crate::sim) fn driven(scene: &Scene, source: u32, t: f64, before: bool) -> Driven {
    let Some(path) = scene.source_path(source as usize) else { return Driven::default() };
    let motion = if before { path.before(t) } else { path.at(t) };
    let body = scene.bodies.get(source as usize);
    let uniform = body.map_or(DVec3::ZERO, |body| terms::uniform(scene, &body.material, &motion));
    Driven { place: Place { centre: motion.position, velocity: motion.velocity }, uniform }
}

/// The jump of the velocities of a body's vertices at `t` [s], see [`carry::kick`]; zero for a free body and for a force
/// point.
pub(in crate::sim) fn kick(scene: &Scene, source: u32, t: f64) -> DVec3 {
    let body = scene.bodies.get(source as usize);
    let on_path = body.and_then(|body| Some((body, body.path()?)));
    on_path.map_or(DVec3::ZERO, |(body, path)| carry::kick(&body.material, path, t))
}
