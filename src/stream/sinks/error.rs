//! Errors of destinations, with advice on how to fix them.

use std::io;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;

use super::note::viewer_help;
use crate::sdk;
use crate::text::counted;

/// A destination that cannot be opened, or a required one that has failed.
///
/// Displays on one line: what failed, which destination, the operating system's message, what to do.
#[derive(Clone, Debug, thiserror::Error)]
pub enum SinkError {
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
    /// Standard output is a terminal.
    #[error(
        "a recording is binary data and standard output is a terminal; \
         send it into a file or a program, for example `… --stdout | rerun -`"
    )]
    Terminal,
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
    /// The existing file at the path, or one in the way, must not be replaced by this program.
    #[error("cannot save to {}: {what}", path.display())]
    Taken {
        /// The requested file.
        path: PathBuf,
        /// What is there, and what to do.
        what: String,
    },
    /// Standard output is a file that a recording would corrupt.
    #[error("{what}")]
    StdoutTaken {
        /// The file, and what to do.
        what: String,
    },
    /// Writing to standard output failed.
    #[error("cannot write the recording to standard output: {source}; {help}")]
    Stdout {
        /// The operating system's error.
        source: Arc<io::Error>,
        /// What to do about it.
        help: String,
    },
    /// Rerun's encoder rejected a message: a bug in this program or in the encoder.
    #[error("cannot encode a message for {target}: {reason}; this is a bug, please report it")]
    Encode {
        /// The destination.
        target: String,
        /// The encoder's message.
        reason: String,
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
    /// A server did not start although its port is free.
    #[error("{what} did not start on {address}: {reason}")]
    Serve {
        /// "the web viewer" or "the data server".
        what: &'static str,
        /// The requested address.
        address: SocketAddr,
        /// The reason, if known.
        reason: String,
    },
    /// Nothing listens at a viewer's address.
    #[error("no viewer answers at {url} ({reason}); start one first with `rerun`, or let --spawn start it{}", viewer_help(*.local))]
    NoViewer {
        /// The viewer's address.
        url: String,
        /// The error of the connection attempt.
        reason: String,
        /// Whether the viewer should be on this machine.
        local: bool,
    },
    /// A viewer could not be started.
    #[error("cannot start the viewer `{program}`: {reason}; {help}")]
    Spawn {
        /// The program that was run.
        program: String,
        /// The viewer's message, or the operating system's error.
        reason: String,
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
        matches!(
            self,
            Self::Nowhere
                | Self::Url { .. }
                | Self::Terminal
                | Self::SamePort { .. }
                | Self::Taken { .. }
                | Self::StdoutTaken { .. }
        )
    }
}

/// Advice for an error of a file that is being written.
pub(super) fn file_help(source: &io::Error, kept: Option<&std::path::Path>) -> String {
    let remedy = match source.kind() {
        io::ErrorKind::StorageFull => "the disk is full: make room or save elsewhere",
        io::ErrorKind::QuotaExceeded => "your disk quota is used up: make room or save elsewhere",
        io::ErrorKind::FileTooLarge => "the file system or a limit (`ulimit -f`) allows no larger file: save elsewhere",
        io::ErrorKind::PermissionDenied => "you have no write permission there: save elsewhere",
        io::ErrorKind::ReadOnlyFilesystem => "the file system is read-only: save elsewhere",
        io::ErrorKind::BrokenPipe => "the program that was reading it has gone",
        io::ErrorKind::IsADirectory => "that is a directory: give the name of a file",
        _ => "save elsewhere",
    };
    match kept {
        Some(kept) => format!("{remedy}; the data written so far is in {}", kept.display()),
        None => remedy.to_owned(),
    }
}
