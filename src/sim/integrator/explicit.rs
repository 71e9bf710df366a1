//! The explicit schemes: the thesis's, the one it builds on, and common alternatives.

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
    /// The thesis's scheme as printed, [`thesis`].
    Thesis,
    /// The consistent scheme that the thesis builds on, [`mps`].
    Mps,
    /// Semi-implicit Euler, [`euler`].
    Euler,
    /// Velocity Verlet, [`verlet`].
    Verlet,
    /// Classical Runge–Kutta, [`rk4`].
    Rk4,
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

/// A vertex in its interval, with the accelerations that the schemes need.
#[derive(Clone, Copy, Debug)]
pub struct Vertex<'a> {
    interval: &'a Interval,
    rest: DVec3,
    facing: DVec3,
}

impl Vertex<'_> {
    /// F: all accelerations except the vertex's own oscillator, at one of the interval's instants, for displacement `x`
    /// [scene unit/s²].
    #[inline]
    fn force(&self, surroundings: &Surroundings, x: DVec3) -> DVec3 {
        surroundings.acceleration(self.interval.weight, self.rest, self.facing, x)
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

/// Advances all vertices of a body, all of which are in the active set, in place over the interval, until the budget of
/// `work` is exhausted.
pub fn advance(scheme: Scheme, interval: &Interval, rest: Rest<'_>, active_set: &mut ActiveSet, work: &Tally<'_>) {
    match scheme {
        Scheme::Thesis => each(interval, rest, active_set, work, thesis),
        Scheme::Mps => each(interval, rest, active_set, work, mps),
        Scheme::Euler => each(interval, rest, active_set, work, euler),
        Scheme::Verlet => each(interval, rest, active_set, work, verlet),
        Scheme::Rk4 => each(interval, rest, active_set, work, rk4),
    }
}

/// The loop over vertices, compiled once per scheme.
fn each(
    interval: &Interval,
    rest: Rest<'_>,
    active_set: &mut ActiveSet,
    work: &Tally<'_>,
    scheme: impl Fn(&Vertex<'_>, State) -> State,
) {
    let acts = |surroundings: &Surroundings| 1 + surroundings.sources.len() + surroundings.weighted.len();
    let each = [&interval.start, &interval.middle, &interval.end].map(acts).iter().sum::<usize>() as u64;
    for i in 0..rest.len() {
        if !work.spend(each) {
            return;
        }
        let vertex = Vertex { interval, rest: rest.position(i), facing: rest.direction(i) };
        active_set.set_state(i, scheme(&vertex, active_set.state(i)));
    }
}

/// (3.6)–(3.10) exactly as printed.
///
/// The scheme advances the position twice per step, in (3.7) and (3.10), but the velocity once. So it is not consistent
/// with (3.2): as Δt → 0 it converges to x″ = −2ω²x − 2κx′, an oscillator √2 times too fast. It is kept as the
/// baseline.
pub fn thesis(vertex: &Vertex<'_>, State { x, u }: State) -> State {
    let dt = vertex.interval.h;
    let force = vertex.force(&vertex.interval.start, x);
    let u_star = u + force * dt; // (3.6)
    let x_star = x + u_star * dt; // (3.7)
    let restoring = vertex.restoring(State { x: x_star, u: u_star }); // (3.8)
    let u_next = u_star + restoring * dt; // (3.9)
    let x_next = x_star + u_next * dt; // (3.10)
    State { x: x_next, u: u_next }
}

/// The prediction and correction of the MPS method, which (3.6)–(3.10) build on: (3.10) starts from r, not from r*.
pub fn mps(vertex: &Vertex<'_>, State { x, u }: State) -> State {
    let dt = vertex.interval.h;
    let u_star = u + vertex.force(&vertex.interval.start, x) * dt;
    let x_star = x + u_star * dt;
    let u_next = u_star + vertex.restoring(State { x: x_star, u: u_star }) * dt;
    State { x: x + u_next * dt, u: u_next }
}

/// Semi-implicit (symplectic) Euler: the new velocity moves the position.
pub fn euler(vertex: &Vertex<'_>, State { x, u }: State) -> State {
    let dt = vertex.interval.h;
    let u_next = u + vertex.acceleration(&vertex.interval.start, State { x, u }) * dt;
    State { x: x + u_next * dt, u: u_next }
}

/// Velocity Verlet. Damping makes the second half kick implicit in u, which for −2κu is a division:
/// u⁺ = u½ + Δt/2 (F⁺ − ω²x⁺ − 2κu⁺)  ⇒  u⁺ = (u½ + Δt/2 (F⁺ − ω²x⁺)) / (1 + κΔt).
pub fn verlet(vertex: &Vertex<'_>, State { x, u }: State) -> State {
    let (dt, damping) = (vertex.interval.h, vertex.interval.oscillator.damping);
    let u_half = u + vertex.acceleration(&vertex.interval.start, State { x, u }) * (0.5 * dt);
    let x_next = x + u_half * dt;
    let undamped = State { x: x_next, u: DVec3::ZERO };
    let kick = vertex.acceleration(&vertex.interval.end, undamped) * (0.5 * dt);
    State { x: x_next, u: (u_half + kick) / (1.0 + damping * dt) }
}

/// The classical Runge–Kutta scheme.
pub fn rk4(vertex: &Vertex<'_>, state: State) -> State {
    let interval = vertex.interval;
    let dt = interval.h;
    let slope = |surroundings, state: State| State { x: state.u, u: vertex.acceleration(surroundings, state) };
    let moved = |k: State, dt: f64| State { x: state.x + k.x * dt, u: state.u + k.u * dt };
    let k1 = slope(&interval.start, state);
    let k2 = slope(&interval.middle, moved(k1, 0.5 * dt));
    let k3 = slope(&interval.middle, moved(k2, 0.5 * dt));
    let k4 = slope(&interval.end, moved(k3, dt));
    State {
        x: state.x + (k1.x + 2.0 * (k2.x + k3.x) + k4.x) * (dt / 6.0),
        u: state.u + (k1.u + 2.0 * (k2.u + k3.u) + k4.u) * (dt / 6.0),
    }
}
