//! The contract between a simulation and whatever observes it: any simulation, not only this crate's
//! [`World`](crate::World).
//!
//! | contents | module |
//! | --- | --- |
//! | constant properties of a run: bodies, force terms, scalars, thresholds | [`schema`] |
//! | the state at an instant; only what is requested is computed | [`frame`] |
//! | points in time, events | [`event`] |
//! | surfaces of groups, and findings about pairs of surfaces | [`surface`] |
//! | the events of a step as rows, in order of time | [`row`] |
//! | the parameters of an experiment | [`parameter`] |
//! | the traits of a simulation, and of the experiment that creates it | [`simulation`] |
//! | the steps of a simulation up to its end | [`run`] |
//! | checks that a simulation keeps this contract | [`verify()`] |
//!
//! The recorder, `replay`, `check` and `diff` depend on nothing else. Nothing here depends on Rerun, on files or on a
//! particular simulation.

pub mod event;
pub mod frame;
mod name;
pub mod parameter;
pub mod row;
pub mod run;
pub mod schema;
pub mod simulation;
pub mod surface;
pub(crate) mod verify;

pub use event::{BodyEvent, Instant, PairEvent};
pub use frame::{BodyFrame, Frame, MotionFrame, NetForce, PairFrame, PointForce, SpringFrame, Want};
pub use name::name;
pub use parameter::{Branch, InvalidVariation, Parameter, Poke, Variation};
pub use row::EventRow;
pub use run::Run;
pub use schema::Schema;
pub use simulation::{
    Experiment, NearPair, Refusal, Shortfall, Simulation, StageFrame, StepFailure, StepSummary, between, state_within,
};
pub(crate) use simulation::{body_between, put_on_paths};
pub use surface::SurfaceEvent;
pub use verify::verify;
