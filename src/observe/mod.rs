//! The observer's interface to any simulation, not only this crate's [`World`](crate::World).
//!
//! | contents | module |
//! | --- | --- |
//! | constant properties of a run: bodies, force terms, scalars, thresholds | [`schema`] |
//! | the state at an instant; only what is requested is computed | [`frame`] |
//! | points in time, events | [`event`] |
//! | the events of a step as rows, in order of time | [`row`] |
//! | the traits of a simulation, and of the experiment that creates it | [`simulation`] |
//! | closest approaches of pairs that did not change phase | [`approach`] |
//! | the largest difference between two states | [`worst`] |
//! | the merged surface of groups of bodies, and geometric measures of pairs | [`surface`] |
//! | times at which surfaces touch and part | [`touch`] |
//! | hashes of exact states | [`checksum`] |
//! | colours | [`colors`] |
//!
//! The recorder, `replay`, `check` and `diff` depend on nothing else. Nothing here depends on Rerun, on files or on a
//! particular simulation.

pub mod approach;
pub mod checksum;
pub mod colors;
pub mod event;
pub mod frame;
pub mod row;
pub mod schema;
pub mod simulation;
pub mod surface;
pub mod touch;
pub mod worst;

pub use approach::{Approach, Approaches, NearPair};
pub use event::{BodyEvent, Instant, PairEvent};
pub use frame::{BodyFrame, Frame, MotionFrame, NetForce, PairFrame, Want};
pub use row::EventRow;
pub use schema::Schema;
pub use simulation::{Experiment, Refusal, Shortfall, Simulation, StageFrame, StepFailure, StepSummary, between};
pub use touch::SurfaceEvent;
pub use worst::Worst;
