//! The simulation: a [`World`] built from a scene, its time step, and access to its state.
//!
//! | contents | module |
//! | --- | --- |
//! | the world and its step | `world` |
//! | the state of one body and how a step advances it | `body`, `advance` |
//! | the bodies that are not at rest | `active_set` |
//! | per-vertex state beyond the motion that all vertices share | `deformation` |
//! | what acts on vertices, one file per force term | `terms` |
//! | the motion of all moving bodies during a step | `tracks` |
//! | broad phase: which bodies can touch | `neighbours` of `pairs`, by a grid in [`reach`] |
//! | when pairs merge, split, enter and leave their core | [`events`] |
//! | how a vertex is advanced | [`integrator`] |
//! | free bodies: a self-contained solver | [`free`] |
//! | scenes with free bodies or planes: their step | `coupled` |
//! | changes between steps | `edit` |
//! | observation: forces by cause, energy | `observe` |
//! | the solution within a step, on request | `within` |
//! | what a step reports | `report` |
//! | how much work a step may do | `work` |
//! | hash of the exact state | `checksum` |
//! | memory that a scene needs, estimated before it is built | `memory` |
//!
//! This module does not depend on Rerun or files, nor on clocks other than the step's own timers.
//!
//! # What a step skips
//! Step cost scales with active interactions, not with vertices, and skipping changes no result:
//!
//! - **Broad phase**: a multi-level grid, one level per size class, finds pairs. Its result holds until a body leaves
//!   its fat bounds. A step checks only bodies that move.
//! - **Bodies at rest cost nothing**: no memory for their vertices, no time in a step. They wake when a push begins,
//!   when their own motion acts on them, or when a sphere can reach them.
//! - **Motion shared by all vertices of a body**, caused by the body's own motion, is one state per body.
//! - **Only the active set is stepped**: the vertices near a sphere, selected again after spheres have moved by a tenth
//!   of a radius. All other vertices are free. The exact flow advances them over any number of steps at once when a
//!   sphere or an observer needs them: `run --every 10` pays for a tenth of the observation.
//! - **Only contributing spheres are summed**: those that can reach the active set.
//! - The active set is stepped in SIMD lanes (AVX-512, AVX2 or SSE2), and bodies on as many threads as pay off, with
//!   bit-identical results.

mod active_set;
mod advance;
mod arrays;
mod body;
mod checksum;
mod coupled;
mod deformation;
mod edit;
#[doc(hidden)]
pub mod events;
#[doc(hidden)]
pub mod free;
#[doc(hidden)]
pub mod integrator;
pub(crate) mod memory;
mod neighbours;
mod nodes;
pub(crate) mod observe;
mod pairs;
#[doc(hidden)]
pub mod reach;
mod report;
pub(crate) mod roots;
mod span;
mod state;
pub(crate) mod terms;
mod tracks;
pub(crate) mod within;
pub(crate) mod work;
mod world;

pub use arrays::Vectors;
pub use events::Event;
pub use memory::TooLarge;
pub use observe::{BodyForces, Energy};
pub use report::{Diverged, EditError, Failure, Overworked, Shortfall, Stage, StepReport, Strain, Toil};
pub use terms::Cause;
pub use world::{BodyView, Options, PairView, States, World};
