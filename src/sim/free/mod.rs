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
//! It does not depend on a world.

/// Implements `Default` by the zero of each field: the default of a matrix is the identity.
macro_rules! zero_by_default {
    ($of:ident { $($zero:expr => $($field:ident)*),* }) => {
        impl Default for $of {
            fn default() -> $of {
                $of { $($($field: $zero),*),* }
            }
        }
    };
}

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
pub use field::{Driven, Field, Pair, Paths, Window};
pub use island::{Change, Failure, Island, Report, Way};
pub(super) use island::{Parts, Scratch};
pub use ledger::Ledger;
pub use observed::{Forces, Snapshot};
pub use step::Place;

#[cfg(test)]
mod tests;
