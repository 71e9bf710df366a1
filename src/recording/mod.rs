//! Recordings read back: run again and verified, compared with what they should be, or with each other.
//!
//! | what | where |
//! | --- | --- |
//! | the chunks of a file, whatever is in it | [`read`] |
//! | what it takes to make a recording again, and what came of it: scene, settings, checksums, events | [`recorded`] |
//! | the surfaces in it, frame by frame | [`frames`] |
//! | what a new recording would replace | [`existing`] |
//! | the same steps again, compared checksum by checksum | [`replay`] |
//! | what a scene should give, and whether it does | [`golden`] |
//! | the events of two runs beside each other | [`happenings`] |
//! | two recordings of a scene side by side | [`diff`] |
//! | differences to look at | [`comparison`] |

pub mod comparison;
pub mod diff;
pub mod error;
pub mod existing;
pub mod frames;
pub mod golden;
pub mod happenings;
pub mod read;
pub mod recorded;
pub mod replay;

pub use error::ReadError;
pub use recorded::Recorded;
