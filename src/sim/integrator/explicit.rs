//! The explicit schemes: the thesis's own, what it builds on, and what a programmer would try next.

use super::{State, Vertex};

/// (3.6)–(3.10) exactly as printed.
///
/// The position is advanced twice a step, in (3.7) and (3.10), the velocity once. So this is no consistent scheme for
/// (3.2): as Δt → 0 it converges to x″ = −2ω²x − 2κx′, an oscillator √2 times too fast. Kept as the baseline.
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

/// The MPS method's prediction and correction, on which (3.6)–(3.10) build: (3.10) starts from r, not from r*.
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
    let undamped = State { x: x_next, u: glam::DVec3::ZERO };
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
