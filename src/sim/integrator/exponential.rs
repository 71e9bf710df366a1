//! Exponential time differencing: the oscillator's flow is exact, only the force is approximated.

use super::{State, Vertex};

/// Second-order exponential Runge–Kutta (ETD2RK, Cox & Matthews 2002, eq. 22): the force is taken as linear in time
/// between its value at the start and that at the end, predicted with the force of the start held.
///
/// Exact when no force acts and when the force is linear in time; stable for any ω and κ.
pub fn advance(vertex: &Vertex<'_>, State { x, u }: State) -> State {
    let p = &vertex.interval.propagator;
    let start = vertex.force(&vertex.interval.start, x);
    let predicted = State {
        x: p.xx * x + p.xu * u + p.constant * start, //
        u: p.ux * x + p.uu * u + p.xu * start,
    };
    let rise = vertex.force(&vertex.interval.end, predicted.x) - start;
    State { x: predicted.x + p.ramp * rise, u: predicted.u + p.ramp_u * rise }
}
