//! meldscope
pub mod cli;
pub mod model;
pub mod scene;
pub mod sim;
pub mod stream;
pub use scene::{Scene, SceneError};
pub use sim::{StepReport, World};
