//! Errors of destinations, with advice on how to fix them.

use std::io;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::atomic;
use crate::sdk;
use crate::text::counted;

/// A destination that cannot be opened, or a required one that has failed.
///
/// Displays on one line: what failed, which destination, the operating system's message, what to do.
#[derive(Clone, Debug, thiserror::Error)]
pub enum SinkError {
    /// The request is invalid: the message.
    #[error("{0}")]
    Usage(String),
    /// A destination has failed, see the message.
    #[error("{0}")]
    Failed(String),
    /// No destination was asked for.
    #[error("there is nowhere to send the recording: give at least one destination")]
    Nowhere,
    /// The address of a viewer is invalid.
    #[error(
        "\"{url}\" is not the address of a viewer ({reason}); expected something like {}",
        sdk::DEFAULT_CONNECT_URL
    )]
    Url {
        /// The address as given.
        url: String,
        /// What is wrong with the address.
        reason: String,
    },
    /// The web page and its data server cannot share a port.
    #[error("the web viewer and its data cannot both use port {port}; give each its own")]
    SamePort {
        /// The port.
        port: u16,
    },
    /// A file cannot be created, written, synced or renamed.
    #[error("cannot {doing} {}: {source}; {help}", path.display())]
    File {
        /// The operation that failed, as in "cannot {doing} F.rrd".
        doing: &'static str,
        /// The file.
        path: PathBuf,
        /// The operating system's error.
        source: Arc<io::Error>,
        /// What to do about it.
        help: String,
    },
    /// Another run is currently writing that file.
    #[error("another run is writing {} now; wait for it or save under another name", path.display())]
    Busy {
        /// The requested file.
        path: PathBuf,
    },
    /// Writing to standard output failed.
    #[error("cannot write the recording to standard output: {source}; {help}")]
    Stdout {
        /// The operating system's error.
        source: Arc<io::Error>,
        /// What to do about it.
        help: String,
    },
    /// A server cannot listen on its address.
    #[error("{what} cannot listen on {address}: {source}; {help}")]
    Listen {
        /// "the web viewer" or "the data server".
        what: &'static str,
        /// The requested address.
        address: SocketAddr,
        /// The operating system's error.
        source: Arc<io::Error>,
        /// What to do about it.
        help: String,
    },
    /// A viewer, or the server for viewers, has disconnected, and no other destination is left.
    #[error("{name} went away after {} ({reason}), and no other destination is left", counted(*messages, "message"))]
    Gone {
        /// The viewer or the server.
        name: String,
        /// Number of messages delivered before that.
        messages: u64,
        /// The reason, if known.
        reason: String,
    },
    /// The last viewer accepts nothing any more, so it does not show the end of the run.
    #[error("{name} {what}; no other destination has the whole run")]
    GivenUp {
        /// The viewer.
        name: String,
        /// What happened to it.
        what: String,
    },
    /// A thread could not be started, or has ended unexpectedly.
    #[error("cannot send the recording to {target}: {reason}")]
    Thread {
        /// The destination.
        target: String,
        /// The reason, if known.
        reason: String,
    },
}

impl SinkError {
    /// Whether the request itself is invalid (exit status 2), as opposed to a failure while running (exit status 1).
    pub fn is_usage(&self) -> bool {
        matches!(self, Self::Usage(_) | Self::Nowhere | Self::Url { .. } | Self::SamePort { .. })
    }

    /// The existing file at `path`, or one in the way, must not be replaced by this program: what is there, and what to
    /// do.
    pub(crate) fn taken(path: &Path, what: &str) -> SinkError {
        SinkError::Usage(format!("cannot save to {}: {what}", path.display()))
    }

    /// Standard output is a terminal.
    pub(super) fn terminal() -> SinkError {
        let what = "a recording is binary data and standard output is a terminal; \
                    send it into a file or a program, for example `… --stdout | rerun -`";
        SinkError::Usage(what.to_owned())
    }
}

/// Advice for an error of a file that is being written.
pub(super) fn file_help(path: &Path, source: &io::Error, kept: Option<&Path>) -> String {
    let remedy = atomic::remedy(path, source);
    // an empty file is removed
    match kept.filter(|kept| std::fs::metadata(kept).is_ok_and(|written| written.len() > 0)) {
        Some(kept) => format!("{remedy}; the data written so far is in {}", kept.display()),
        None => remedy,
    }
}
