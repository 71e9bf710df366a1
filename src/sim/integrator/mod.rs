//! How a vertex is advanced over an interval of time.
//!
//! Vertices do not act on each other, so a scheme is a function of one vertex: its state at the start, what acts on it
//! in between, its state at the end. All state is displacement in body coordinates, `x = r − c − l`, and its velocity.
//!
//! | scheme | order | where |
//! | --- | --- | --- |
//! | [`Thesis`](crate::scene::Integrator::Thesis), (3.6)–(3.10) as printed | 0: converges to another equation | [`explicit`] |
//! | [`Mps`](crate::scene::Integrator::Mps), [`Euler`](crate::scene::Integrator::Euler) | 1 | [`explicit`] |
//! | [`Verlet`](crate::scene::Integrator::Verlet) | 2 | [`explicit`] |
//! | [`Rk4`](crate::scene::Integrator::Rk4) | 4 where nothing jumps | [`explicit`] |
//! | [`Exponential`](crate::scene::Integrator::Exponential) | 5, with error control | [`exponential`] |
//!
//! Only `exponential` ends its steps where something jumps; the others take the phases of the start of the step as they
//! are, as their authors would have.

pub mod explicit;
pub mod exponential;
