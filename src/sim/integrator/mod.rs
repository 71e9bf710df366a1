//! How a vertex is advanced over a stretch of time in which nothing about its surroundings jumps.
//!
//! Vertices do not act on each other, so a scheme is a function of one vertex: its state at the start, what acts on it
//! at the instants at which the scheme looks ([`Interval`]), its state at the end. All state is displacement in body
//! coordinates, `x = r − c − l`, and its velocity.
//!
//! | scheme | order | where |
//! | --- | --- | --- |
//! | [`Integrator::Thesis`], (3.6)–(3.10) as printed | 0: converges to another equation | [`explicit`] |
//! | [`Integrator::Mps`], [`Integrator::Euler`] | 1 | [`explicit`] |
//! | [`Integrator::Verlet`] | 2 | [`explicit`] |
//! | [`Integrator::Rk4`] | 4 where nothing jumps | [`explicit`] |
//! | [`Integrator::Exponential`] | 2 | [`exponential`] |
//!
//! Only `exponential` divides its steps where something jumps ([`splits_steps`]); the others take the surroundings of
//! the start of the step as they are, as their authors would have.

pub mod explicit;
pub mod exponential;

use glam::DVec3;

use super::{arrays::Vectors, surroundings::Surroundings};
use crate::{
    model::{influence::Weight, oscillator::Oscillator, oscillator::Propagator},
    scene::Integrator,
};

/// Displacement from rest and its velocity, in body coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State {
    /// x [scene unit]
    pub x: DVec3,
    /// u = x′ [scene unit/s]
    pub u: DVec3,
}

/// A stretch of time and what acts on a body in it; the same for all vertices of the body.
#[derive(Clone, Debug, Default)]
pub struct Interval {
    /// Its length Δt [s].
    pub h: f64,
    /// ω and κ.
    pub oscillator: Oscillator,
    /// The exact flow over `h`; only for [`Integrator::Exponential`].
    pub propagator: Propagator,
    /// The weight (3.3).
    pub weight: Weight,
    /// What acts at its start.
    pub start: Surroundings,
    /// What acts in its middle; only for [`Integrator::Rk4`].
    pub middle: Surroundings,
    /// What acts at its end; only for the schemes that look there.
    pub end: Surroundings,
}

impl Interval {
    /// Whether nothing acts at the instants at which `integrator` looks: a body at rest stays at rest.
    pub fn is_idle(&self, integrator: Integrator) -> bool {
        let (middle, end) = looks_at(integrator);
        self.start.is_idle() && (!middle || self.middle.is_idle()) && (!end || self.end.is_idle())
    }
}

/// A vertex in its interval: its rest position and what acts on it, as the schemes want to write it.
#[derive(Clone, Copy, Debug)]
pub struct Vertex<'a> {
    interval: &'a Interval,
    unit: DVec3,
    rest: DVec3,
}

impl Vertex<'_> {
    /// F: influence, push and carry, at one of the instants of the interval, for displacement `x` [scene unit/s²].
    #[inline]
    fn force(&self, surroundings: &Surroundings, x: DVec3) -> DVec3 {
        surroundings.acceleration(self.interval.weight, self.unit, self.rest, x)
    }

    /// x″ of the equation of motion: F − ω²x − 2κu [scene unit/s²].
    #[inline]
    fn acceleration(&self, surroundings: &Surroundings, state: State) -> DVec3 {
        self.force(surroundings, state.x) + self.restoring(state)
    }

    /// T of (3.8) in body coordinates, where l − r = −x: −ω²x − 2κu [scene unit/s²].
    #[inline]
    fn restoring(&self, State { x, u }: State) -> DVec3 {
        let Oscillator { omega, damping } = self.interval.oscillator;
        omega * omega * -x - 2.0 * damping * u
    }
}

/// Whether the scheme wants its steps divided where something jumps: phases, pushes, keyframes.
pub fn splits_steps(integrator: Integrator) -> bool {
    integrator == Integrator::Exponential
}

/// Whether the scheme looks at the middle and at the end of the interval.
pub fn looks_at(integrator: Integrator) -> (bool, bool) {
    match integrator {
        Integrator::Thesis | Integrator::Mps | Integrator::Euler => (false, false),
        Integrator::Verlet | Integrator::Exponential => (false, true),
        Integrator::Rk4 => (true, true),
    }
}

/// Advances all vertices of a body of radius `radius` [scene unit] over the interval, in place.
///
/// `unit` are the unit rest positions; all three arrays have `[vertex_count]` vectors.
pub fn advance(
    integrator: Integrator,
    interval: &Interval,
    radius: f64,
    unit: &Vectors,
    displacement: &mut Vectors,
    velocity: &mut Vectors,
) {
    match integrator {
        Integrator::Thesis => each(interval, radius, unit, displacement, velocity, explicit::thesis),
        Integrator::Mps => each(interval, radius, unit, displacement, velocity, explicit::mps),
        Integrator::Euler => each(interval, radius, unit, displacement, velocity, explicit::euler),
        Integrator::Verlet => each(interval, radius, unit, displacement, velocity, explicit::verlet),
        Integrator::Rk4 => each(interval, radius, unit, displacement, velocity, explicit::rk4),
        Integrator::Exponential => each(interval, radius, unit, displacement, velocity, exponential::advance),
    }
}

/// The loop over vertices, compiled once per scheme.
fn each(
    interval: &Interval,
    radius: f64,
    unit: &Vectors,
    displacement: &mut Vectors,
    velocity: &mut Vectors,
    scheme: impl Fn(&Vertex<'_>, State) -> State,
) {
    for i in 0..unit.len() {
        let vertex = Vertex { interval, unit: unit.get(i), rest: radius * unit.get(i) };
        let state = scheme(&vertex, State { x: displacement.get(i), u: velocity.get(i) });
        displacement.set(i, state.x);
        velocity.set(i, state.u);
    }
}
