//! Errors of reading a recording.

use std::io;
use std::path::PathBuf;

use crate::observe::StepFailure;

/// A recording that cannot be read, or cannot be used for the purpose at hand. Displays on one line: the file, what is
/// wrong with it and where, and what to do.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The operating system cannot read the file.
    #[error("cannot read {}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The operating system's error.
        source: io::Error,
    },
    /// The file is not a recording of this program.
    #[error("{} is not a recording of meldscope: {what}", path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
        /// What was found instead.
        what: String,
    },
    /// The file holds several recordings, and no single one of them was asked for.
    #[error("{}: {what} {count} recordings: choose one, as {}/NAME: {names}", path.display(), path.display())]
    Several {
        /// The file.
        path: PathBuf,
        /// What is wrong, up to the number of recordings.
        what: String,
        /// Number of recordings.
        count: usize,
        /// Their names, or the first of them.
        names: String,
    },
    /// The recording has a format that this program cannot read.
    #[error("{} {what}", path.display())]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// Why it is not supported, and what to do.
        what: String,
    },
    /// The contents are corrupt.
    #[error("{} is damaged{}: {what}; get another copy of it", path.display(), position(*at))]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Position of the affected message, if known [bytes from the start].
        at: Option<u64>,
        /// What is wrong.
        what: String,
    },
    /// The recording's scene is invalid.
    #[error("the scene in {}: {what}", path.display())]
    Scene {
        /// The file.
        path: PathBuf,
        /// The parser's message, or what the scene would need.
        what: String,
    },
    /// The scene fails before its last step when it is run again.
    #[error("{} fails when it is run again: {failure}", path.display())]
    Failed {
        /// The file.
        path: PathBuf,
        /// The failure.
        failure: Box<StepFailure>,
    },
}

fn position(at: Option<u64>) -> String {
    at.map_or_else(String::new, |at| format!(" at byte {at}"))
}
