//! The explicit schemes: the thesis's, the one it builds on, and common alternatives. They are written once, for a vertex
//! of a body on a path, which depends on no other one, and for all vertices of a coupled scene.

use glam::DVec3;

use crate::{
    geometry::Rest,
    model::{influence::Weight, oscillator::Oscillator},
    scene::Integrator,
    sim::{prescribed::deformation::ActiveSet, state::State, terms::Surroundings, work::Tally},
};

/// The explicit schemes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scheme {
    /// (3.6)–(3.10) exactly as printed.
    ///
    /// The scheme advances the position twice per step, in (3.7) and (3.10), but the velocity once. So it is not
    /// consistent with (3.2): as Δt → 0 it converges to x″ = −2ω²x − 2κx′, an oscillator √2 times too fast. It is kept
    /// as the baseline.
    Thesis,
    /// The prediction and correction of the MPS method, which (3.6)–(3.10) build on: (3.10) starts from r, not from r*.
    Mps,
    /// Semi-implicit (symplectic) Euler: the new velocity moves the position.
    Euler,
    /// Velocity Verlet, with damping implicit in the second half kick.
    Verlet,
    /// The classical Runge–Kutta scheme.
    Rk4,
}

/// An instant of a step at which forces are evaluated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Instant {
    /// Its start.
    Start,
    /// Its middle.
    Middle,
    /// Its end.
    End,
}

/// Which accelerations count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// F: all except those of springs and damping.
    Outer,
    /// T of (3.8), of springs and damping.
    Inner,
    /// x″ = F + T.
    All,
    /// x″ without damping.
    Undamped,
}

/// Positions and velocities, and what accelerates them.
pub trait System {
    /// Positions and velocities.
    type State: Clone;
    /// Accelerations.
    type Forces;

    /// The accelerations of a state at an instant.
    fn forces(&self, at: Instant, state: &Self::State, part: Part) -> Self::Forces;

    /// Changes the velocities by the accelerations over `dt` [s].
    fn kick(&self, state: &mut Self::State, forces: &Self::Forces, dt: f64);

    /// Moves the positions by the velocities of a state over `dt` [s].
    fn drift(&self, state: &mut Self::State, velocities: &Self::State, dt: f64);

    /// Moves the positions by their own velocities over `dt` [s].
    fn move_on(&self, state: &mut Self::State, dt: f64);

    /// Divides the velocities that are damped by 1 + κ `dt`, `dt` [s]: damping over half a step of Verlet, implicit.
    fn damp(&self, state: &mut Self::State, dt: f64);
}

impl Scheme {
    /// The scheme of an integrator, if it is explicit.
    pub fn of(integrator: Integrator) -> Option<Scheme> {
        match integrator {
            Integrator::Thesis => Some(Scheme::Thesis),
            Integrator::Mps => Some(Scheme::Mps),
            Integrator::Euler => Some(Scheme::Euler),
            Integrator::Verlet => Some(Scheme::Verlet),
            Integrator::Rk4 => Some(Scheme::Rk4),
            Integrator::Exponential => None,
        }
    }

    /// Whether the scheme evaluates forces in the middle and at the end of the interval.
    pub fn evaluates_at(self) -> (bool, bool) {
        match self {
            Scheme::Thesis | Scheme::Mps | Scheme::Euler => (false, false),
            Scheme::Verlet => (false, true),
            Scheme::Rk4 => (true, true),
        }
    }

    /// The state after a step of `dt` [s].
    #[inline]
    pub fn advance<S: System>(self, system: &S, start: &S::State, dt: f64) -> S::State {
        let mut next = start.clone();
        match self {
            Scheme::Thesis | Scheme::Mps => {
                system.kick(&mut next, &system.forces(Instant::Start, start, Part::Outer), dt); // (3.6)
                let mut predicted = next.clone();
                system.move_on(&mut predicted, dt); // (3.7)
                let inner = system.forces(Instant::Start, &predicted, Part::Inner); // (3.8)
                if self == Scheme::Thesis {
                    next = predicted;
                }
                system.kick(&mut next, &inner, dt); // (3.9)
                system.move_on(&mut next, dt); // (3.10)
            }
            Scheme::Euler => {
                system.kick(&mut next, &system.forces(Instant::Start, start, Part::All), dt);
                system.move_on(&mut next, dt);
            }
            // u⁺ = u½ + Δt/2 (F⁺ − ω²x⁺ − 2κu⁺)  ⇒  u⁺ = (u½ + Δt/2 (F⁺ − ω²x⁺)) / (1 + κΔt)
            Scheme::Verlet => {
                system.kick(&mut next, &system.forces(Instant::Start, start, Part::All), 0.5 * dt);
                system.move_on(&mut next, dt);
                let forces = system.forces(Instant::End, &next, Part::Undamped);
                system.kick(&mut next, &forces, 0.5 * dt);
                system.damp(&mut next, dt);
            }
            Scheme::Rk4 => {
                let mut at = start.clone();
                let stages = [
                    (Instant::Start, 0.5, 1.0 / 6.0),
                    (Instant::Middle, 0.5, 1.0 / 3.0),
                    (Instant::Middle, 1.0, 1.0 / 3.0),
                    (Instant::End, 0.0, 1.0 / 6.0),
                ];
                for (instant, to, weight) in stages {
                    let forces = system.forces(instant, &at, Part::All);
                    system.drift(&mut next, &at, weight * dt);
                    system.kick(&mut next, &forces, weight * dt);
                    let mut stage = start.clone();
                    system.drift(&mut stage, &at, to * dt);
                    system.kick(&mut stage, &forces, to * dt);
                    at = stage;
                }
            }
        }
        next
    }
}

/// A time interval and the influences on a body in it, common to all vertices of the body.
#[derive(Clone, Debug, Default)]
pub struct Interval {
    /// Its length Δt [s].
    pub h: f64,
    /// ω and κ.
    pub oscillator: Oscillator,
    /// The weight (3.3).
    pub weight: Weight,
    /// The influences at its start.
    pub start: Surroundings,
    /// The influences in its middle; used by [`Scheme::Rk4`] only.
    pub middle: Surroundings,
    /// The influences at its end; used only by schemes that evaluate forces there.
    pub end: Surroundings,
}

impl Interval {
    /// Whether nothing acts at the instants at which `scheme` evaluates forces, so that a body at rest stays at rest.
    pub fn is_idle(&self, scheme: Scheme) -> bool {
        let (middle, end) = scheme.evaluates_at();
        self.start.is_idle() && (!middle || self.middle.is_idle()) && (!end || self.end.is_idle())
    }
}

/// A vertex of a body on a path, in its interval.
#[derive(Clone, Copy, Debug)]
pub struct Vertex<'a> {
    interval: &'a Interval,
    rest: DVec3,
    facing: DVec3,
}

impl System for Vertex<'_> {
    type State = State;
    type Forces = DVec3;

    #[inline]
    fn forces(&self, at: Instant, &State { x, u }: &State, part: Part) -> DVec3 {
        let Interval { oscillator: Oscillator { omega, damping }, weight, start, middle, end, .. } = self.interval;
        let surroundings = match at {
            Instant::Start => start,
            Instant::Middle => middle,
            Instant::End => end,
        };
        let outer = || surroundings.acceleration(*weight, self.rest, self.facing, x);
        // T of (3.8) in body coordinates, where l − r = −x
        let spring = omega * omega * -x;
        match part {
            Part::Outer => outer(),
            Part::Inner => spring - 2.0 * damping * u,
            Part::All => outer() + (spring - 2.0 * damping * u),
            Part::Undamped => outer() + spring,
        }
    }

    #[inline]
    fn kick(&self, state: &mut State, force: &DVec3, dt: f64) {
        state.u += *force * dt;
    }

    #[inline]
    fn drift(&self, state: &mut State, velocities: &State, dt: f64) {
        state.x += velocities.u * dt;
    }

    #[inline]
    fn move_on(&self, state: &mut State, dt: f64) {
        state.x += state.u * dt;
    }

    #[inline]
    fn damp(&self, state: &mut State, dt: f64) {
        state.u /= 1.0 + self.interval.oscillator.damping * dt;
    }
}

/// Advances all vertices of a body, all of which are in the active set, in place over the interval, until the budget of
/// `work` is exhausted.
pub fn advance(scheme: Scheme, interval: &Interval, rest: Rest<'_>, active_set: &mut ActiveSet, work: &Tally<'_>) {
    let acts = |surroundings: &Surroundings| 1 + surroundings.sources.len() + surroundings.weighted.len();
    let each = [&interval.start, &interval.middle, &interval.end].map(acts).iter().sum::<usize>() as u64;
    for i in 0..rest.len() {
        if !work.spend(each) {
            return;
        }
        let vertex = Vertex { interval, rest: rest.position(i), facing: rest.direction(i) };
        active_set.set_state(i, scheme.advance(&vertex, &active_set.state(i), interval.h));
    }
}
