//! The world as Rerun data: a recording that the viewer opens, or that it follows live.
//!
//! | what | where |
//! | --- | --- |
//! | a recording from its first message to its last | [`recorder`] |
//! | recording on a thread of its own | [`pipeline`] |
//! | which entities there are, and what is logged to each | [`parts`] |
//! | what a step leaves to be recorded | [`step`] |
//! | the state as meshes and arrows, in the viewer's precision | [`extract`] |
//! | smooth normals of deformed spheres | [`normals`] |
//! | what a recording is a function of | [`settings`] |
//! | lines of plots | [`series`] |
//! | a hash of the state for every step | [`checksums`] |
//! | the last frames, kept until something happens | `flight` |
//! | where a recording was made | [`machine`] |
//! | when rows are | [`instant`] |
//! | rows gathered into chunks, chunks into messages | [`chunks`], in [`columns`] what comes frame after frame |
//! | the layout that the viewer opens with | [`blueprint`] |
//! | colours and what they mean | [`palette`] |
//! | where the messages go: files, viewers, servers | [`sinks`] |
//!
//! Observers receive the world by shared reference: looking never changes anything.

pub mod blueprint;
pub mod checksums;
pub mod chunks;
pub mod columns;
pub mod extract;
mod flight;
pub mod instant;
pub mod machine;
pub mod normals;
pub mod palette;
pub mod parts;
pub mod pipeline;
pub mod recorder;
pub mod series;
pub mod settings;
pub mod sinks;
pub mod step;

pub use pipeline::Pipeline;
pub use recorder::Recorder;
pub use settings::Settings;
