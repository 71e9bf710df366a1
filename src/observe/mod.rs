//! What an instrument may know of a simulation: anybody's, not only this crate's [`World`](crate::World).
//!
//! | what | where |
//! | --- | --- |
//! | what is simulated, told once: bodies, force terms, scalars, thresholds | [`schema`] |
//! | the state at an instant, of which only what is wanted is computed | [`frame`] |
//! | a simulation that can be stepped and looked at, and what one can be made from | [`simulation`] |
//! | two states beside each other | [`worst`] |
//! | colours, for whoever draws it | [`colors`] |
//!
//! Recorder, replay, check and diff know no more than this. Nothing here knows Rerun, a file, or a simulation.

pub mod colors;
pub mod frame;
pub mod schema;
pub mod simulation;
pub mod worst;

pub use frame::{BodyFrame, Frame, PairFrame, Want};
pub use schema::Schema;
pub use simulation::{Experiment, Instant, PairEvent, Refusal, Simulation, StageFrame, StepFailure, StepSummary};
pub use worst::Worst;
