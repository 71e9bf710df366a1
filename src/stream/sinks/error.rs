//! What can go wrong with a destination, and what to do about it.

use std::io;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;

use super::note::viewer_help;
use crate::text::counted;

/// A destination that cannot be opened, or one that a run cannot do without and that failed.
///
/// Displays on one line: what, which one, the operating system's words, what to do.
#[derive(Clone, Debug, thiserror::Error)]
pub enum SinkError {
    /// No destination was asked for.
    #[error("there is nowhere to send the recording: give at least one destination")]
    Nowhere,
    /// The address of a viewer cannot be understood.
    #[error(
        "\"{url}\" is not the address of a viewer ({reason}); expected something like {}",
        rerun::DEFAULT_CONNECT_URL
    )]
    Url {
        /// As it was given.
        url: String,
        /// What is wrong with it.
        reason: String,
    },
    /// Standard output is a terminal.
    #[error(
        "a recording is binary data and standard output is a terminal; \
         send it into a file or a program, for example `… --stdout | rerun -`"
    )]
    Terminal,
    /// The web page and its data cannot share a port.
    #[error("the web viewer and its data cannot both use port {port}; give another --web-port or --grpc-port")]
    SamePort {
        /// The port.
        port: u16,
    },
    /// A file cannot be created, written, synced or renamed.
    #[error("cannot {doing} {}: {source}; {help}", path.display())]
    File {
        /// What was tried, as in "cannot {doing} F.rrd".
        doing: &'static str,
        /// The file.
        path: PathBuf,
        /// The operating system's answer.
        source: Arc<io::Error>,
        /// What to do about it.
        help: String,
    },
    /// Another run is writing that file at this moment.
    #[error("another run is writing {} now; wait for it or save under another name", path.display())]
    Busy {
        /// The file asked for.
        path: PathBuf,
    },
    /// What is there, or in the way, is not this program's to replace.
    #[error("cannot save to {}: {what}", path.display())]
    Taken {
        /// The file asked for.
        path: PathBuf,
        /// What it is, and what to do.
        what: String,
    },
    /// Standard output is a file that a recording would spoil.
    #[error("{what}")]
    StdoutTaken {
        /// Which, and what to do.
        what: String,
    },
    /// Standard output cannot be written.
    #[error("cannot write the recording to standard output: {source}; {help}")]
    Stdout {
        /// The operating system's answer.
        source: Arc<io::Error>,
        /// What to do about it.
        help: String,
    },
    /// Rerun's encoder refused a message: a bug, in this program or in it.
    #[error("cannot encode a message for {target}: {reason}; this is a bug, please report it")]
    Encode {
        /// The destination.
        target: String,
        /// The encoder's words.
        reason: String,
    },
    /// A server cannot listen where it was told to.
    #[error("{what} cannot listen on {address}: {source}; {help}")]
    Listen {
        /// "the web viewer" or "the data server".
        what: &'static str,
        /// Where it should.
        address: SocketAddr,
        /// The operating system's answer.
        source: Arc<io::Error>,
        /// What to do about it.
        help: String,
    },
    /// A server did not start, though its port is free.
    #[error("{what} did not start on {address}: {reason}")]
    Serve {
        /// "the web viewer" or "the data server".
        what: &'static str,
        /// Where it should have.
        address: SocketAddr,
        /// What is known about it.
        reason: String,
    },
    /// Nothing listens at a viewer's address.
    #[error("no viewer answers at {url} ({reason}); start one first with `rerun`, or let --spawn start it{}", viewer_help(*.local))]
    NoViewer {
        /// Its address.
        url: String,
        /// What the connection attempt said.
        reason: String,
        /// Whether it should be on this machine.
        local: bool,
    },
    /// A viewer could not be started.
    #[error("cannot start the viewer `{program}`: {reason}; {help}")]
    Spawn {
        /// What was run.
        program: String,
        /// What it said, or the operating system.
        reason: String,
        /// What to do about it.
        help: String,
    },
    /// A viewer, or the server for viewers, is gone, and it was the last place to send to.
    #[error("{name} went away after {} ({reason}), and nothing else is left to send to", counted(*messages, "message"))]
    Gone {
        /// Which one.
        name: String,
        /// Messages that it took until then.
        messages: u64,
        /// What is known about it.
        reason: String,
    },
    /// A thread could not be started, or ended when it should not have.
    #[error("cannot send the recording to {target}: {reason}")]
    Thread {
        /// The destination.
        target: String,
        /// What is known about it.
        reason: String,
    },
}

impl SinkError {
    /// Whether what was asked for is at fault (exit status 2), not what happened (exit status 1).
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

/// What to do about an error of a file that is being written.
pub(super) fn file_help(source: &io::Error, kept: Option<&std::path::Path>) -> String {
    let remedy = match source.kind() {
        io::ErrorKind::StorageFull => "the disk is full: make room or save elsewhere",
        io::ErrorKind::QuotaExceeded => "your disk quota is used up: make room or save elsewhere",
        io::ErrorKind::FileTooLarge => "the file system or a limit (`ulimit -f`) allows no larger file: save elsewhere",
        io::ErrorKind::PermissionDenied => "you may not write there: save elsewhere",
        io::ErrorKind::ReadOnlyFilesystem => "the file system is read-only: save elsewhere",
        io::ErrorKind::BrokenPipe => "the program that was reading it has gone",
        io::ErrorKind::IsADirectory => "that is a directory: give the name of a file",
        _ => "save elsewhere",
    };
    match kept {
        Some(kept) => format!("{remedy}; what was written until then is in {}", kept.display()),
        None => remedy.to_owned(),
    }
}
