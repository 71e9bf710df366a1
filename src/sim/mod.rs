//! The simulation: a [`World`] made from a scene, stepped, and looked at.
//!
//! | what | where |
//! | --- | --- |
//! | the world and its step | [`world`] |
//! | the state of one body, and its turn in a step | `body`, `advance` |
//! | the bodies that are not at rest | `active_set` |
//! | what single vertices do beyond what all of them do | `deformation` |
//! | what acts on vertices, one file a force term | [`terms`] |
//! | the frame of a body in the course of a step, and those of all that move | [`track`], `tracks` |
//! | who can touch whom | `neighbours` of `pairs`, by a grid in [`reach`] |
//! | when pairs merge, split, enter and leave their core | [`events`] |
//! | how a vertex is advanced | [`integrator`] |
//! | bodies that nobody moves: a solver by itself | [`free`] |
//! | forces by cause, energy: looking at a state | [`observe`] |
//! | all that instruments know of it | [`simulation`] |
//! | what happens inside of a step, on request | [`stages`] |
//! | what a step reports | [`report`] |
//! | how much a step may take | [`work`] |
//! | one number for the exact state | [`checksum`] |
//! | what a scene needs before it is built | [`memory`] |
//!
//! Nothing here knows Rerun, files or clocks beyond the step's own timers.
//!
//! # What a step skips
//! Step cost scales with active interactions, not with vertices, and skipping changes no result:
//!
//! - **Broad phase**: a grid with a level for each size of body finds pairs; its result holds until a body leaves its fat
//!   bounds. Only bodies that move are checked in a step.
//! - **Bodies at rest cost nothing**: no memory for their vertices, no time in a step. They wake when a push begins, when their
//!   own motion acts on them, when a sphere can reach them.
//! - **What all vertices of a body do alike**, by its own motion or a push, is a few numbers per body.
//! - **Only the active set is stepped**: the vertices near a sphere, chosen anew when spheres have moved by a tenth of a radius.
//!   All other vertices are free, and the exact flow takes them over any number of steps at once when a sphere or an observer
//!   needs them: `run --every 10` pays for a tenth of the observation.
//! - **Only contributing spheres are summed**: those that can reach the active set.
//! - The active set is stepped in SIMD lanes (AVX-512, AVX2 or SSE2), bodies on as many threads as pay off, to the same bits.

mod active_set;
mod advance;
pub mod arrays;
mod body;
pub mod checksum;
mod deformation;
pub mod events;
pub mod free;
pub mod integrator;
pub mod memory;
mod neighbours;
mod nodes;
pub mod observe;
mod pairs;
pub mod reach;
pub mod report;
pub mod simulation;
pub mod stages;
mod state;
pub mod terms;
pub mod track;
mod tracks;
pub mod work;
pub mod world;

pub use arrays::Vectors;
pub use events::Event;
pub use memory::TooLarge;
pub use observe::{BodyForces, Energy};
pub use report::{Diverged, Failure, Overworked, Stage, StepReport, Toil};
pub use terms::Cause;
pub use world::{BodyView, Options, PairView, States, World};

/// An interval of time [s].
#[derive(Clone, Copy, Debug)]
struct Span {
    start: f64,
    end: f64,
}

impl Span {
    fn length(&self) -> f64 {
        self.end - self.start
    }

    /// Whether `t` [s] is inside of it.
    fn holds(&self, t: f64) -> bool {
        self.start < t && t < self.end
    }
}
