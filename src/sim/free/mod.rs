//! Solver for free bodies, coupled by their influence spheres, on planes and under gravity.
//!
//! | contents | module |
//! | --- | --- |
//! | a body: vertices with masses around a rest shape that follows them | [`body`] |
//! | external influences: pairs, planes, pushes, gravity | [`field`] |
//! | the solver: adaptive steps that end where a pair changes phase | [`island`], `phases` |
//! | one step: exponential collocation of vertices, centres and frames together; its error | `solve`, `step`, `force` |
//! | vertices on which a contact begins or ends within a step | `split` |
//! | loops over vertices, in SIMD lanes | `kernels` |
//! | vertices that nothing reaches in a step | `passive` |
//! | steps of fixed length, where adaptive ones are too much work; their loops | `verlet`, `verlet_kernels` |
//! | momentum, angular momentum, energy | [`conserved`] |
//! | energy ledger | [`ledger`] |
//! | forces in the current state, by cause | [`observed`] |
//!
//! It takes plain data and does not depend on a world or a scene file:
//!
//! ```
//! # use std::sync::Arc;
//! # use glam::DVec3;
//! use meldscope::model::oscillator::Oscillator;
//! use meldscope::sim::free::{Body, Field, Island, NoPaths, Report, Rotation, Shape};
//!
//! // an octahedron, thrown upwards and turning
//! let rest = [DVec3::X, DVec3::Y, DVec3::Z].into_iter().flat_map(|v| [v, -v]).collect();
//! let shape = Arc::new(Shape::new(rest, vec![1.0 / 6.0; 6]));
//! let oscillator = Oscillator { omega: 50.0, damping: 1.0 };
//! let mut body = Body::free(shape, 1.0, oscillator, Rotation::Free);
//! body.throw(DVec3::ZERO, DVec3::new(0.0, 0.0, 4.0), DVec3::new(0.1, 0.0, 0.0));
//!
//! let field = Field { gravity: DVec3::new(0.0, 0.0, -9.81), ..Field::default() };
//! let mut island = Island::new(vec![body], vec![], field, 1e-6);
//! let mut report = Report::default();
//! for step in 1..=60 {
//!     island.advance(f64::from(step) / 60.0, &NoPaths, &mut report)?;
//! }
//! assert!((island.bodies()[0].centre.z - (4.0 - 9.81 / 2.0)).abs() < 1e-12);
//! # Ok::<(), meldscope::sim::free::Failure>(())
//! ```

pub mod body;
pub mod conserved;
pub mod field;
mod force;
pub mod island;
mod kernels;
pub mod ledger;
pub mod observed;
mod passive;
mod phases;
mod solve;
mod split;
mod step;
mod verlet;
mod verlet_kernels;

pub use crate::model::{PairLaw, shape_matching::Rotation};
pub use body::{Body, Motion, Shape};
pub use conserved::Conserved;
pub(super) use conserved::influence as influence_energy;
pub use field::{Driven, Field, NoPaths, Pair, Paths, Push, Window};
pub use island::{Change, Failure, Island, Report, Way};
pub(super) use island::{Parts, Scratch};
pub use ledger::Ledger;
pub use observed::{Forces, Snapshot};

#[cfg(test)]
mod tests;
