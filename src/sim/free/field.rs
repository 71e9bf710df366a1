//! External influences on free bodies: pairs, planes, pushes, gravity.

use glam::DVec3;

use super::step::Place;
use crate::{
    model::{
        PairLaw,
        influence::{Scaling, Weight},
        phase::{Phase, Transition},
        shape_matching::Plane,
    },
    scene::{Force, Point, Push, Scene},
    sim::terms::{self, Cause},
};

/// External forces, and the parameters that all pairs share.
#[derive(Clone, Debug)]
pub struct Field {
    /// Accelerations of all free bodies, by cause [scene unit/s²].
    pub uniform: Vec<(Cause, DVec3)>,
    /// Planes, which act on every vertex of every body.
    pub planes: Vec<Plane>,
    /// Pushes, which act on single bodies of the group.
    pub pushes: Vec<Push>,
    /// Forces set by a program, with the indices of their bodies.
    pub forces: Vec<(u32, Force)>,
    /// Weight of the influence by distance (3.3).
    pub weight: Weight,
    /// Dependence of strengths on body sizes.
    pub scaling: Scaling,
    /// Instants at which a path or one of its derivatives jumps, or a force point begins or ceases to act [s],
    /// ascending.
    pub breaks: Vec<f64>,
    /// Index of the first body that stands for a force point; those after it do so, too.
    pub first_point: u32,
}

impl Default for Field {
    fn default() -> Field {
        Field {
            uniform: Vec::new(),
            planes: Vec::new(),
            pushes: Vec::new(),
            forces: Vec::new(),
            weight: Weight::Linear,
            scaling: Scaling::Relative,
            breaks: Vec::new(),
            first_point: u32::MAX,
        }
    }
}

/// Two bodies that can interact, or a body and a force point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair {
    /// Index of the first body.
    pub a: u32,
    /// Index of the second body.
    pub b: u32,
    /// Current phase, which determines how the bodies act on each other.
    pub phase: Phase,
    /// Thresholds of the phases and strength of the influence.
    pub law: PairLaw,
    /// When the second one acts, if it is a force point.
    pub window: Option<Window>,
}

/// The time during which a force point acts: [start, end).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// Its start [s].
    pub start: f64,
    /// Its end, exclusive [s].
    pub end: f64,
}

impl Window {
    /// The phase of a body and the force point at `t` [s], see [`Pair::with_point`].
    pub fn phase(self, t: f64) -> Phase {
        if self.start <= t && t < self.end { Phase::Merged } else { Phase::Apart }
    }
}

impl Pair {
    /// Body `a` and a force point as body `b`, at `t` [s]: merged while the point acts, with its signed strength as α, and
    /// apart otherwise, without a force. The distance does not change the phase.
    pub fn with_point(a: u32, b: u32, point: &Point, t: f64) -> Pair {
        let window = Window { start: point.start, end: point.end() };
        let alpha = point.strength;
        let law = PairLaw { alpha, beta: 0.0, apart_repels: false, core_width: 0.0, ..PairLaw::DEFAULT };
        Pair { a, b, phase: window.phase(t), law, window: Some(window) }
    }

    /// The transitions out of its phase at thresholds of the distance.
    pub(super) fn transitions(&self) -> impl Iterator<Item = Transition> + use<> {
        let has_thresholds = self.window.is_none();
        self.law.thresholds.transitions(self.phase).filter(move |_| has_thresholds)
    }
}

impl Field {
    /// Sets what acts on all bodies of a scene, and the parameters that all pairs share.
    pub(in crate::sim) fn set_common(&mut self, scene: &Scene) {
        self.uniform.clear();
        self.uniform.extend(terms::free_fall_by_cause(scene));
        self.planes.clone_from(&scene.planes);
        (self.weight, self.scaling) = (scene.influence.weight, scene.influence.scaling);
    }

    /// The acceleration of a free body on which nothing else acts [scene unit/s²].
    pub(super) fn free_fall(&self) -> DVec3 {
        self.uniform.iter().map(|(_, acceleration)| acceleration).sum()
    }

    /// Acceleration of free body `index` by forces set by a program, at `t` [s] [scene unit/s²].
    pub(super) fn given(&self, index: usize, t: f64, centre: DVec3, velocity: DVec3) -> DVec3 {
        let own = self.forces.iter().filter(|(body, _)| *body as usize == index);
        own.fold(DVec3::ZERO, |sum, (_, force)| sum + force.acceleration(t, centre, velocity))
    }

    /// Factor on the strength with which a body of radius `source` acts on one of radius `radius`.
    pub fn scale(&self, radius: f64, source: f64) -> f64 {
        self.scaling.factor(radius, source)
    }

    /// The next instant after `t` at which a push or force point begins or ends, or a path jumps [s]; all are known in
    /// advance.
    pub(super) fn next_break(&self, t: f64) -> f64 {
        let edges = self.pushes.iter().flat_map(|push| [push.start, push.end()]);
        edges.chain(self.breaks.iter().copied()).filter(|&edge| edge > t).fold(f64::INFINITY, f64::min)
    }
}

/// The motion of a body on a prescribed path at an instant.
#[derive(Clone, Copy, Debug, Default)]
pub struct Driven {
    /// Its centre.
    pub place: Place,
    /// The acceleration that all its vertices share, as by its inertial response to its own motion [scene unit/s²].
    pub uniform: DVec3,
}

/// The motion of bodies on prescribed paths.
pub trait Paths: Sync {
    /// The motion of `body` at `t` [s]; with `before`, the left limit if something jumps there.
    fn at(&self, body: usize, t: f64, before: bool) -> Driven;

    /// The rate at which the path turns [rad/s]; 0 if it is piecewise polynomial.
    fn turning_rate(&self, _body: usize) -> f64 {
        0.0
    }

    /// Jump of the velocities u of the body's vertices at `t` [s], where the velocity of its path jumps [scene unit/s].
    fn kick(&self, _body: usize, _t: f64) -> DVec3 {
        DVec3::ZERO
    }
}
