//! A body of a coupled scene: its state, bounds of its motion in a step, and whether it rests.

use std::{collections::HashMap, sync::Arc};

use glam::{DMat3, DVec3};
use pulp::Arch;
use rustc_hash::FxBuildHasher;

use super::neighbours::{FatBounds, Neighbour};
use crate::{
    geometry::{Mesh, Vectors},
    model::oscillator::Oscillator,
    scene::{self, Motion, Response, Scene},
    sim::{
        checksum,
        free::{Body, Driven, Push, Shape, Way},
        span::Span,
    },
};

/// Steps at the end of which a body must be [calm](Member::is_calm), one after another, before it rests, at the least …
const CALM_STEPS: f64 = 12.0;
/// … and for how long [s]. Engines for games take as long.
const CALM_TIME: f64 = 0.5;
/// The share of the tolerance that the motion of a calm body may be. The integrator's own errors are far below the
/// other half.
const CALM: f64 = 0.5;
/// A larger tolerance than this [radii/s] lets bodies rest no sooner: what they would have done yet is an error that no
/// shorter step would make smaller.
const MOST_CALM: f64 = 1e-2;
/// The share of the tolerance that the deformation of a body may be that counts as none.
const STRAIGHT: f64 = 0.1;
/// A larger tolerance than this [radii/s] lets no larger deformation count as none.
const FINEST: f64 = 1e-5;
/// How much farther than in free flight a body may get in a step, before its pairs are looked for again [radii].
const SLACK: f64 = 0.05;

/// A body, and what the engine keeps of it.
pub(in crate::sim) struct Member {
    /// Its state. A body that is not deformed has neither displacements nor velocities: the lists are empty.
    pub body: Body,
    /// Step length that its island last met the tolerance with [s].
    pub pace: f64,
    /// At how many ends of steps in a row it was calm, and how it moved at the first of them.
    pub calm: u32,
    pub calm_from: Drift,
    /// Whether it takes steps; else it rests, and keeps its state.
    pub is_awake: bool,
    /// How far it may get in the current step.
    pub bounds: StepBounds,
    /// The bounds for which its neighbours were found.
    pub fat: FatBounds,
    /// Nearby bodies, ascending.
    pub neighbours: Vec<Neighbour>,
    /// The largest distance of a vertex from the centre, or more [scene unit].
    pub extent: f64,
    /// The largest speed of a vertex relative to the frame, or more [scene unit/s].
    pub speed: f64,
    /// [`Member::hash`] while it rests.
    pub resting_hash: u64,
    /// The pushes on it, by their starts.
    pub pushes: Box<[Push]>,
}

/// The velocity of a body [scene unit/s] and the angular velocity of its frame [rad/s].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(in crate::sim) struct Drift {
    velocity: DVec3,
    spin: DVec3,
}

/// How far a body may get in a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(in crate::sim) struct StepBounds {
    /// Distance of its centre from where it was at the start [scene unit].
    pub way: f64,
    /// Distance of its vertices from the centre [scene unit].
    pub extent: f64,
}

/// The rest shapes at the scale of bodies, one for all that are alike.
#[derive(Default)]
pub(in crate::sim) struct Shapes(HashMap<(usize, u64, u64), Arc<Shape>, FxBuildHasher>);

impl Shapes {
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
    /// A body of the scene at t = 0.
    pub fn new(scene: &Scene, index: usize, mesh: &Arc<Mesh>, shapes: &mut Shapes) -> Member {
        let body = &scene.bodies[index];
        let mut pushes: Vec<Push> = scene.pushes.iter().filter(|push| push.body == index).map(pushed).collect();
        pushes.sort_by(|p, q| p.start.total_cmp(&q.start));
        let shape = shapes.get(mesh, body.radius, body.mass);
        let oscillator = Oscillator { omega: body.material.omega, damping: body.material.damping };
        let extent = shape.extent();
        let body = match &body.motion {
            Motion::Prescribed(path) => {
                let start = path.at(0.0);
                let mut prescribed = Body::prescribed(shape, body.radius, oscillator);
                (prescribed.centre, prescribed.velocity) = (start.position, start.velocity);
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
            body,
            pace: f64::INFINITY,
            calm: 0,
            calm_from: Drift::default(),
            is_awake: false,
            bounds: StepBounds::default(),
            fat: FatBounds::default(),
            neighbours: Vec::new(),
            extent,
            speed,
            resting_hash: 0,
            pushes: pushes.into(),
        };
        if speed == 0.0 {
            member.straighten();
        }
        member
    }

    /// Takes over the state of another of the same shape.
    pub fn resume(&mut self, before: &Member) {
        let Member { body, pace, calm, calm_from, is_awake, extent, speed, .. } = before;
        self.body = Body { shape: Arc::clone(&self.body.shape), ..body.clone() };
        (self.pace, self.calm, self.calm_from, self.is_awake) = (*pace, *calm, *calm_from, *is_awake);
        (self.extent, self.speed) = (*extent, *speed);
    }

    /// Makes it undeformed.
    pub fn straighten(&mut self) {
        (self.body.x, self.body.u) = (Vec::new(), Vec::new());
        (self.extent, self.speed) = (self.body.shape.extent(), 0.0);
    }

    /// Whether it has displacements and velocities.
    pub fn is_deformed(&self) -> bool {
        !self.body.x.is_empty()
    }

    /// How far it can be expected to get in a step of `h` [s] when nothing unforeseen happens; what does is noticed, and
    /// the step taken again.
    pub fn expect(&mut self, scene: &scene::Body, gravity: DVec3, span: Span) {
        let Member { body, extent, speed, .. } = self;
        let (slack, h) = (SLACK * body.radius, span.length());
        let way = match scene.path() {
            Some(path) => path.bounds(span.start, span.end).speed * h,
            None => {
                let given = scene.force.as_ref().map_or(0.0, scene::Force::bound);
                1.5 * body.velocity.length() * h + 0.5 * (gravity.length() + given) * h * h
            }
        };
        self.bounds = StepBounds { way: slack + way, extent: *extent + slack + 1.5 * *speed * h };
    }

    /// Whether it got farther than was expected; then more is expected of it.
    pub fn strayed(&mut self, way: &Way) -> bool {
        let StepBounds { way: most, extent } = &mut self.bounds;
        let strays = [(way.centre, most), (way.extent, extent)].map(|(got, most)| {
            let strays = got > *most;
            if strays {
                *most = 2.0 * got;
            }
            strays
        });
        strays != [false; 2]
    }

    /// Whether everything about it moves so little that it may count as standing still: no vertex gets farther than half
    /// of what the tolerance allows an error to grow, be it by the motion of the body or about a resting place.
    ///
    /// A body that is calm for half a second, and [does not speed up](Member::stays_calm), rests: its velocities are set to
    /// zero and its displacements kept. The error that this makes grows by less than half of the tolerance. What moves faster
    /// than it did wakes by no rule, so a body has to be calm for as long as it takes an unstable balance to show.
    pub fn is_calm(&self, tolerance: f64) -> bool {
        let most = self.most_calm(tolerance);
        let swing = self.speed / self.body.oscillator.omega.max(1.0);
        swing <= most && self.body.velocity.length() + self.body.frame_spin().length() * self.extent <= most
    }

    /// The largest speed of any of its points while it is calm [scene unit/s].
    fn most_calm(&self, tolerance: f64) -> f64 {
        CALM * tolerance.min(MOST_CALM) * self.body.radius
    }

    /// Counts another end of a step of `h` [s] at which it is calm; whether it has been so for long enough to rest.
    pub fn stays_calm(&mut self, tolerance: f64, h: f64) -> bool {
        let now = Drift { velocity: self.body.velocity, spin: self.body.frame_spin() };
        if self.calm == 0 {
            self.calm_from = now;
        }
        self.calm += 1;
        if f64::from(self.calm) < (CALM_TIME / h).ceil().max(CALM_STEPS) {
            return false;
        }
        // a steady acceleration would take it as far in a second as its speed may
        let Drift { velocity, spin } = self.calm_from;
        let gained = (now.velocity - velocity).length() + (now.spin - spin).length() * self.extent;
        let steady = gained <= self.most_calm(tolerance) * f64::from(self.calm) * h;
        if !steady {
            self.calm = 0;
        }
        steady
    }

    /// Whether its deformation is so little that leaving it out is an error of less than a tenth of the tolerance: then
    /// it is left out, if nothing acts on it.
    pub fn is_nearly_straight(&self, tolerance: f64) -> bool {
        let most = STRAIGHT * tolerance.min(FINEST) * self.body.radius;
        let x = self.body.x.iter().map(|x| x.length_squared()).fold(0.0, f64::max).sqrt();
        x <= most && self.speed <= most * self.body.oscillator.omega.max(1.0)
    }

    /// Its kinetic energy, if it is free: of its centre, its rotation and its vertices [mass · scene unit²/s²].
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

    /// Makes it stand still. Returns the energy that it loses [mass · scene unit²/s²].
    pub fn halt(&mut self) -> f64 {
        let lost = self.kinetic_energy();
        let Body { velocity, spin, u, .. } = &mut self.body;
        (*velocity, *spin) = (DVec3::ZERO, DVec3::ZERO);
        u.fill(DVec3::ZERO);
        self.speed = 0.0;
        lost
    }

    /// Angular velocity of its rest shape [rad/s].
    pub fn spin(&self) -> DVec3 {
        self.body.frame_spin()
    }

    /// Displacements and velocities of all vertices.
    pub fn states_into(&self, displacement: &mut Vectors, velocity: &mut Vectors) {
        for (into, from) in [(displacement, &self.body.x), (velocity, &self.body.u)] {
            into.reset(self.body.shape.rest().len());
            from.iter().enumerate().for_each(|(i, &vector)| into.set(i, vector));
        }
    }

    /// A hash of its state; 0 of one that rests on a fixed path and is not deformed.
    pub fn hash(&self, arch: Arch, index: u32) -> u64 {
        if !self.body.is_free() && !self.is_awake && !self.is_deformed() {
            return 0;
        }
        let others = [u64::from(self.calm), u64::from(self.is_awake), self.pace.to_bits()];
        checksum::of_body(arch, index, &self.body, others)
    }

    /// How much work its forces are: number of vertices times that of the bodies nearby.
    pub fn size(&self) -> u64 {
        self.body.shape.rest().len() as u64 * (1 + self.neighbours.len() as u64)
    }

    /// Memory allocated for it [bytes].
    pub fn memory(&self) -> usize {
        (self.body.x.capacity() + self.body.u.capacity()) * size_of::<DVec3>()
            + self.neighbours.capacity() * size_of::<Neighbour>()
    }
}

fn pushed(push: &scene::Push) -> Push {
    let scene::Push { body, direction, strength, start, .. } = *push;
    Push { body: body as u32, direction, strength, start, end: push.end() }
}

/// The motion of a body on a path at `t` [s], just before it if `before` is set.
pub(in crate::sim) fn driven(scene: &Scene, body: u32, t: f64, before: bool) -> Driven {
    let body = &scene.bodies[body as usize];
    let Some(path) = body.path() else { return Driven::default() };
    let motion = if before { path.before(t) } else { path.at(t) };
    let carry = match body.material.response {
        Response::Rigid => DVec3::ZERO,
        Response::Inertial => motion.acceleration,
        Response::World => motion.acceleration + 2.0 * body.material.damping * motion.velocity,
    };
    Driven { position: motion.position, velocity: motion.velocity, carry }
}

/// By how much the velocities of a body's vertices jump at `t` [s], because that of its path does: they stay in motion as
/// they were, unless the body is rigid. At t = 0 every velocity is zero [scene unit/s].
pub(in crate::sim) fn kick(scene: &Scene, body: u32, t: f64) -> DVec3 {
    let body = &scene.bodies[body as usize];
    match (body.path(), body.material.response) {
        (Some(path), Response::Inertial | Response::World) if t > 0.0 => -path.kick(t),
        _ => DVec3::ZERO,
    }
}
