//! How a vertex is advanced over a time interval.
//!
//! Vertices do not act on each other, so a scheme is a function of one vertex: from its state at the start and what
//! acts on it in between to its state at the end. The state is the displacement in body coordinates, `x = r − c − l`,
//! and its velocity.
//!
//! | scheme | order | where |
//! | --- | --- | --- |
//! | [`Thesis`](crate::scene::Integrator::Thesis), (3.6)–(3.10) as printed | 0: converges to another equation | [`explicit`] |
//! | [`Mps`](crate::scene::Integrator::Mps), [`Euler`](crate::scene::Integrator::Euler) | 1 | [`explicit`] |
//! | [`Verlet`](crate::scene::Integrator::Verlet) | 2 | [`explicit`] |
//! | [`Rk4`](crate::scene::Integrator::Rk4) | 4 between jumps | [`explicit`] |
//! | [`Exponential`](crate::scene::Integrator::Exponential) | 5, with error control | [`exponential`] |
//!
//! Only `exponential` ends its steps where something jumps. The others keep the phases of the start of the step, as in
//! their usual form.

pub mod explicit;
pub mod exponential;
