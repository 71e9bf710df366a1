//! The simulation: a [`World`] made from a scene, stepped, and looked at.
//!
//! | what | where |
//! | --- | --- |
//! | the world and its step | [`world`] |
//! | the state of one body, and its turn in a step | `body`, `advance` |
//! | what single vertices do beyond what all of them do | `deformation` |
//! | what acts on vertices, one file a force term | [`terms`] |
//! | where moving bodies are in the course of a step | `tracks` |
//! | who can touch whom | `neighbours` of `pairs`, by a grid in [`reach`] |
//! | when pairs merge, split, enter and leave their core | [`events`] |
//! | how a vertex is advanced | [`integrator`] |
//! | forces by cause, energy: looking at a state | [`observe`] |
//! | what another thread can look at meanwhile | [`snapshot`] |
//! | what happens inside of a step, on request | [`stages`] |
//! | what a step reports | [`report`] |
//! | one number for the exact state | [`checksum`] |
//! | what a scene needs before it is built | [`memory`] |
//!
//! Nothing here knows Rerun, files or clocks beyond the step's own timers.

mod advance;
pub mod arrays;
mod body;
pub mod checksum;
mod deformation;
pub mod events;
pub mod integrator;
pub mod memory;
mod neighbours;
pub mod observe;
mod pairs;
pub mod reach;
pub mod report;
pub mod snapshot;
pub mod stages;
mod state;
pub mod terms;
mod tracks;
pub mod world;

pub use arrays::Vectors;
pub use events::Event;
pub use memory::TooLarge;
pub use observe::{BodyForces, Energy};
pub use report::{Diverged, Stage, StepReport};
pub use snapshot::Snapshot;
pub use terms::Cause;
pub use world::{BodyView, Options, PairView, States, World};

/// A stretch of time [s].
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
