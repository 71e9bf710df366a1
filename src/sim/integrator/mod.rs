//! Schemes that advance a vertex over a time interval.
//!
//! The vertices of a body on a path do not act on each other, so a scheme is a function of one vertex: its state at the end follows from its
//! state at the start and the forces in between. The state is the displacement in body coordinates, `x = r − c − l`,
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
//! Only `exponential` ends its steps where something jumps. The others use the phases at the start of the step
//! throughout, as in their usual form.

pub mod explicit;
pub mod exponential;
