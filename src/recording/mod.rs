//! Reading recordings: replay and verify them, compare them with golden recordings or with each other.
//!
//! | contents | module |
//! | --- | --- |
//! | the chunks of a file, however malformed the file may be | [`read`] |
//! | the recordings in a file, which may hold several | [`contents`] |
//! | the inputs of a run (scene, settings) and its results (checksums, events) | [`recorded`] |
//! | surfaces, frame by frame | [`frames`] |
//! | existing files that a new recording would overwrite | [`existing`] |
//! | running a recording again and comparing every checksum | [`replay`] |
//! | golden recordings: the expected results of a scene | [`golden`] |
//! | comparison of the events of two runs | [`events`] |
//! | comparison of gap, overlap, volume, components … of two runs | [`quantities`] |
//! | comparison of two recordings of a scene | [`diff`] |
//! | a recording that shows the differences between two runs | [`comparison`] |

pub mod comparison;
pub mod contents;
pub mod diff;
pub mod error;
pub mod events;
pub mod existing;
pub mod frames;
pub mod golden;
pub mod quantities;
pub mod read;
pub mod recorded;
pub mod replay;

pub use error::ReadError;
pub use recorded::Recorded;
