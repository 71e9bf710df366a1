//! Why a recording cannot be used.

use std::io;
use std::path::PathBuf;

use crate::observe::StepFailure;

/// A recording that cannot be read, or not be used for what it is wanted. Displays on one line: which file, what is
/// wrong with it and where, what to do.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The operating system does not give it.
    #[error("cannot read {}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The system's answer.
        source: io::Error,
    },
    /// Something else.
    #[error("{} is not a recording of meldscope: {what}", path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
        /// What was found instead.
        what: String,
    },
    /// Of a format that this program does not read.
    #[error("{} {what}", path.display())]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// Why not, and what to do.
        what: String,
    },
    /// Bytes are not as they were written.
    #[error("{} is damaged{}: {what}; get it again from where it was made", path.display(), place(*at))]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Of the message in question [bytes from the start], where there is one.
        at: Option<u64>,
        /// What is wrong.
        what: String,
    },
    /// The scene in it is not one.
    #[error("the scene in {}: {what}", path.display())]
    Scene {
        /// The file.
        path: PathBuf,
        /// What the parser says, or what it would need.
        what: String,
    },
    /// Run again, it fails before it comes to its end.
    #[error("{}, run again, fails: {failure}", path.display())]
    Failed {
        /// The file.
        path: PathBuf,
        /// Why.
        failure: Box<StepFailure>,
    },
}

fn place(at: Option<u64>) -> String {
    at.map_or_else(String::new, |at| format!(" at byte {at}"))
}
