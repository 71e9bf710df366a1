//! Recording of a simulation as Rerun data, for a file or a live viewer.
//!
//! | contents | module |
//! | --- | --- |
//! | recording of a whole run | [`mod@record`] |
//! | a recording from its first message to its last | [`recorder`] |
//! | recording on a separate thread | [`pipeline`] |
//! | the entities of a frame, and what is logged to each | [`parts`] |
//! | the data of a step to be recorded | [`step`] |
//! | states as meshes and arrows, in the precision of the viewer | [`extract`] |
//! | the settings that determine a recording | [`settings`] |
//! | prediction of the size of a recording | [`size`] |
//! | every entity, component and property | [`contract`] |
//! | plot lines | [`series`] |
//! | a hash of the state for every step | [`checksums`] |
//! | the last frames, kept until a trigger fires | `flight` |
//! | the machine on which a recording was made | [`machine`] |
//! | time points of rows | [`instant`] |
//! | batching of rows into chunks and messages | [`chunks`]; [`columns`] for what is logged every frame |
//! | the layout that the viewer opens with | [`blueprint`] |
//! | colours and their meaning | [`palette`] |
//! | the light on surfaces | [`light`] |
//! | destinations of messages: files, viewers, servers | [`sinks`] |
//!
//! Nothing here depends on a particular simulation: see [`observe`](crate::observe).
//!
//! # Contents of a recording
//! A recording has two timelines, `step` and `sim_time`, and the entities in [`contract`], which
//! `meldscope reference recording` prints. Unchanged values are not logged again. Equal runs give equal recordings except
//! for `/timings`, the axis ranges of their plots in the layout, and the name of the machine.

pub mod blueprint;
pub mod checksums;
pub mod chunks;
pub mod columns;
pub mod contract;
pub mod extract;
mod flight;
mod focus;
pub mod instant;
pub mod light;
pub mod machine;
pub mod palette;
pub mod parts;
pub mod pipeline;
pub mod record;
pub mod recorder;
pub mod series;
pub mod settings;
pub mod sinks;
pub mod size;
pub mod step;

pub use pipeline::Pipeline;
pub use record::{RecordError, record, record_all};
pub use recorder::Recorder;
pub use settings::Settings;
