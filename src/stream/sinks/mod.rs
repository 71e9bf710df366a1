//! Destinations of a recording: a file, standard output, viewers, a server for viewers, or several of these.
//!
//! Every destination has its own thread behind a queue that is bounded in bytes, and receives messages in the order in
//! which they were sent. Files and pipes receive every message; the run waits for them if they are slow. A viewer
//! receives what it can keep up with. The simulation never blocks on a viewer. The server receives everything and keeps
//! a history for viewers that connect later; a slow or stalled client affects no other client and not the run.
//!
//! Memory: 16 MiB for a file or pipe; 128 MiB for each viewer and for the server, twice as much if every waiting
//! message has values that no newer message replaces; the SDK's own buffers; and 1 GiB of history for the server,
//! regardless of the number of clients. Queues share messages, so that a message in several queues is stored once. The
//! footer of a file takes about 1 kB per message, kept until the end.
//!
//! The SDK's own sinks are not used directly because of their behaviour on errors: `FileSink` overwrites the file
//! immediately and only logs that the disk is full; `GrpcSink` waits forever for a viewer that does not read;
//! `GrpcServerSink` lets anyone read and write, and waits for the slowest reader. The web viewer's server allocates as
//! much memory as a request asks for.

use std::ffi::OsString;
use std::net::{IpAddr, Ipv4Addr, ToSocketAddrs as _};
use std::path::PathBuf;
use std::str::FromStr;
use std::time::Duration;

use crate::sdk::re_uri::{Origin, ProxyUri, Scheme};

mod error;
mod file;
mod live;
mod note;
mod queue;
pub(crate) mod serve;
mod spawn;

pub use error::SinkError;
pub use file::Complete;
pub use serve::{Host, Serving};

use super::chunks::Audience;
use crate::sdk::{self, LogMsg};
use crate::text::{counted, listed};
use file::{Claim, Writer};
use live::Live;
use note::seconds;
use queue::Parcel;

/// The requested destinations.
#[derive(Clone, Debug)]
pub struct Destinations {
    /// The file to write.
    pub save: Option<PathBuf>,
    /// Whether to write to standard output.
    pub stdout: bool,
    /// The viewer to start, if any.
    pub spawn: Option<Spawn>,
    /// The address of a running viewer, such as [`DEFAULT_CONNECT_URL`](sdk::DEFAULT_CONNECT_URL).
    pub connect: Option<String>,
    /// The web viewer to serve.
    pub serve: Option<Serve>,
    /// Time limit, after the run, on a viewer that makes no progress with the remaining messages [5 s].
    pub patience: Duration,
}

impl Destinations {
    /// A file alone.
    pub fn file(path: impl Into<PathBuf>) -> Destinations {
        Destinations { save: Some(path.into()), ..Destinations::default() }
    }
}

/// No destination.
impl Default for Destinations {
    fn default() -> Self {
        let patience = Duration::from_secs(5);
        Destinations { save: None, stdout: false, spawn: None, connect: None, serve: None, patience }
    }
}

/// A viewer to start. If a viewer already listens on the port, it is used instead.
#[derive(Clone, Debug)]
pub struct Spawn {
    /// Path of the viewer, or a name to be found on the PATH [`rerun`].
    pub program: OsString,
    /// Port on which it listens, on this machine only [9876].
    pub port: u16,
}

impl Default for Spawn {
    fn default() -> Self {
        Spawn { program: "rerun".into(), port: sdk::DEFAULT_SERVER_PORT }
    }
}

/// A web viewer to serve.
#[derive(Clone, Debug)]
pub struct Serve {
    /// The address to listen on [127.0.0.1].
    pub bind: IpAddr,
    /// Port of the web page [9090]; 0 selects a free one.
    pub web_port: u16,
    /// Port of the data server [9876]; 0 selects a free one.
    pub grpc_port: u16,
    /// Additional host names that viewers may use, besides this machine's loopback names and the addresses of `bind`.
    pub allow: Vec<Host>,
}

impl Default for Serve {
    fn default() -> Self {
        let bind = Ipv4Addr::LOCALHOST.into();
        Serve { bind, web_port: 9090, grpc_port: sdk::DEFAULT_SERVER_PORT, allow: Vec::new() }
    }
}

/// `HOST[:PORT]`: an address or a name of this machine, which requests may then use, and the port of the page. The data is
/// on the next port; without a port, on 9876; with port 0, on any free one.
impl FromStr for Serve {
    type Err = String;

    fn from_str(text: &str) -> Result<Serve, String> {
        let wrong = || "expected an address or a name of this machine, and a port below 65535 after a colon".to_owned();
        let with_port = || {
            let (host, port) = text.rsplit_once(':')?;
            let port: u16 = port.parse().ok()?;
            Some((host.parse::<Host>().ok()?, port, if port == 0 { 0 } else { port.checked_add(1)? }))
        };
        let own = Serve::default();
        let alone = text.parse::<Host>().ok().map(|host| (host, own.web_port, own.grpc_port));
        let (host, web_port, grpc_port) = alone.or_else(with_port).ok_or_else(wrong)?;
        let (bind, allow) = match host {
            Host::Ip(ip) => (ip, Vec::new()),
            Host::Name(name) => {
                let found: Vec<_> = (name.as_str(), 0).to_socket_addrs().into_iter().flatten().collect();
                // a machine's own name may also be one of its loopback addresses, at which nobody else reaches it
                let found = found.iter().find(|address| !address.ip().is_loopback()).or(found.first());
                let ip = found.ok_or_else(|| format!("there is no host {name:?}"))?.ip();
                (ip, vec![Host::Name(name)])
            }
        };
        Ok(Serve { bind, web_port, grpc_port, allow })
    }
}

/// All destinations of a run, open.
///
/// Dropping it without [`Sinks::finish`] leaves a file under its temporary name, with everything sent so far.
pub struct Sinks {
    writers: Vec<Writer>,
    viewers: Vec<Live>,
    server: Option<Serving>,
    notes: Vec<String>,
    /// Whether a file or pipe has the messages that a viewer misses.
    is_recorded: bool,
    patience: Duration,
}

/// The results of finished destinations.
pub struct Finished {
    /// The file that was saved.
    pub save: Option<Saved>,
    /// Notes for the user since the last [`Sinks::notes`].
    pub notes: Vec<String>,
    /// The servers: they stay up as long as this value lives.
    pub serving: Option<Serving>,
}

/// A file that is complete.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Saved {
    /// The file.
    pub path: PathBuf,
    /// Its size [bytes].
    pub bytes: u64,
}

impl Sinks {
    /// Opens every destination. A missing viewer is an error only if there is no other destination; any other failure
    /// is always an error. On an error, no file has been modified and no viewer started.
    pub fn open(destinations: &Destinations) -> Result<Sinks, SinkError> {
        let Destinations { save, stdout, spawn, connect, serve, patience } = destinations;
        // first the checks that have no side effects
        let connect = connect.as_deref().map(parse_url).transpose()?;
        if *stdout && file::is_terminal() {
            return Err(SinkError::terminal());
        }
        if *stdout {
            file::check_stdout(save.as_deref())?;
        }
        let claim = save.as_deref().map(Claim::new).transpose()?;

        let mut sinks = Sinks {
            writers: Vec::new(),
            viewers: Vec::new(),
            server: None,
            notes: Vec::new(),
            is_recorded: false,
            patience: *patience,
        };
        let mut missing = Vec::new();
        if let Some(uri) = &connect {
            match live::probe(uri) {
                Ok(()) => sinks.viewers.push(Live::connect(uri.clone())?),
                Err(err) => missing.push(err),
            }
        }
        let is_connected = !sinks.viewers.is_empty();
        if let Some(serve) = serve {
            let mut server = Serving::start(serve)?;
            sinks.notes.append(&mut server.notes);
            sinks.server = Some(server);
        }
        // last, because it opens a window
        if let Some(options) = spawn {
            let is_there = |uri: &ProxyUri| uri.origin.port == options.port && uri.origin.is_localhost();
            if is_connected && connect.as_ref().is_some_and(is_there) {
                sinks.notes.push("the viewer to start is the one already connected".to_owned());
            } else {
                let is_ours = sinks.server.as_ref().is_some_and(|server| server.data_port == options.port);
                match spawn::spawn(options, is_ours) {
                    Ok(spawned) => {
                        sinks.notes.extend(spawned.notes);
                        let origin = Origin::from_scheme_and_socket_addr(Scheme::RerunHttp, spawned.address);
                        sinks.viewers.push(Live::connect(ProxyUri::new(origin))?);
                    }
                    Err(err) => missing.push(err),
                }
            }
        }

        let is_alone = claim.is_none() && !stdout && sinks.viewers.is_empty() && sinks.server.is_none();
        if is_alone {
            return Err(missing.into_iter().next().unwrap_or(SinkError::Nowhere));
        }
        sinks.notes.extend(missing.iter().map(|err| format!("continuing without a viewer: {err}")));
        if let Some(claim) = claim {
            let (writer, note) = claim.start()?;
            sinks.notes.extend(note);
            sinks.writers.push(writer);
        }
        if *stdout {
            sinks.writers.push(Writer::stdout()?);
        }
        sinks.is_recorded = !sinks.writers.is_empty();
        Ok(sinks)
    }

    /// Whether there are viewers or a server, and whether there are files or pipes.
    pub fn are_live_and_recorded(&self) -> [bool; 2] {
        [!self.viewers.is_empty() || self.server.is_some(), !self.writers.is_empty()]
    }

    /// Whether a file or pipe has failed, or no destination is left.
    pub fn failed(&self) -> bool {
        !self.is_any_left() || self.writers.iter().any(Writer::failed)
    }

    /// Notes for the user since the last call: whole sentences, each given once.
    pub fn notes(&mut self) -> Vec<String> {
        self.update_notes();
        std::mem::take(&mut self.notes)
    }

    /// Sends a message to all destinations. Waits while the queue of a file or pipe is full, and for a server as long
    /// as it makes progress.
    ///
    /// `Err` if a file or pipe cannot be written, or if no destination is left. A run should then end with
    /// [`Sinks::finish`], which returns the same error again.
    pub fn send(&mut self, msg: LogMsg) -> Result<(), SinkError> {
        self.send_to(Audience::All, msg)
    }

    /// Like [`Sinks::send`], to some of the destinations.
    ///
    /// # Errors
    /// As for [`Sinks::send`].
    pub fn send_to(&mut self, audience: Audience, msg: LogMsg) -> Result<(), SinkError> {
        let parcel = Parcel::new(msg);
        let mut written = Ok(());
        if audience != Audience::Viewers {
            // one that has failed leaves the others complete
            written = self.writers.iter_mut().map(|writer| writer.send(parcel.clone())).fold(written, Result::and);
        }
        if audience == Audience::Files {
            return written;
        }
        let mut gone = None;
        for viewer in &self.viewers {
            gone = viewer.send(parcel.clone()).err().or(gone);
        }
        if let Some(server) = &self.server {
            gone = server.send(parcel).err().or(gone);
        }
        match gone {
            Some(err) if !self.is_any_left() => written.and(Err(err)),
            _ => written,
        }
    }

    /// Waits until everything sent so far can be read from the file or pipe.
    pub fn flush(&self) -> Result<(), SinkError> {
        self.writers.iter().try_for_each(Writer::flush)
    }

    /// Waits for viewers that make no progress no longer than a second: the user wants the program to end.
    pub fn hurry(&mut self) {
        self.patience = self.patience.min(Duration::from_secs(1));
    }

    /// Finishes all destinations: writes footers, syncs and renames files, and delivers the remaining messages to
    /// viewers that still accept them. Every destination is finished even if one fails; the first failure is returned.
    ///
    /// # Errors
    /// A file or pipe has failed, or no destination has received everything.
    pub fn finish(self) -> Result<Finished, SinkError> {
        let (finished, file) = self.complete();
        file.map_or(Ok(()), Complete::place).and(finished)
    }

    /// Like [`Sinks::finish`], but the file still has its temporary name: [`Complete::place`] puts it in place.
    pub fn complete(mut self) -> (Result<Finished, SinkError>, Option<Complete>) {
        // close all of them first, so that they finish in parallel
        self.writers.iter().for_each(Writer::close);
        self.viewers.iter().for_each(|viewer| viewer.queue().close());
        if let Some(server) = &self.server {
            server.live.queue().close();
        }

        let mut failure = None;
        let (mut save, mut file, mut is_saved) = (None, None, false);
        for writer in std::mem::take(&mut self.writers) {
            let path = writer.path().map(PathBuf::from);
            match (writer.finish(), path) {
                (Ok(complete), Some(path)) => {
                    save = Some(Saved { path, bytes: complete.bytes });
                    (file, is_saved) = (Some(complete), true);
                }
                (Ok(_), None) => is_saved = true,
                (Err(err), _) => failure = failure.or(Some(err)),
            }
        }
        let (mut lost, mut is_shown) = (None, false);
        for i in 0..self.viewers.len() {
            let queue = self.viewers[i].queue();
            let has_ended = queue.wait_ended(self.patience);
            let gone = queue.failure();
            let mut given_up = None;
            if !has_ended && gone.is_none() {
                let rest = queue.waiting();
                let left =
                    if rest > 0 { format!(", {} before the end", counted(rest, "message")) } else { String::new() };
                let what = format!("has accepted nothing for {} and is given up{left}", seconds(self.patience));
                self.notes.push(format!("{} {what}", queue.name()));
                given_up = Some(SinkError::GivenUp { name: queue.name().to_owned(), what });
            }
            is_shown |= has_ended && gone.is_none();
            lost = lost.or(gone.clone()).or(given_up);
        }
        if let Some(server) = &self.server
            && !server.live.queue().wait_drained(self.patience)
        {
            self.notes.push("the data server is behind; it continues in the background".to_owned());
        }
        self.update_notes();
        is_shown |= self.server.as_ref().is_some_and(|server| server.live.failure().is_none());
        if failure.is_none() && !is_saved && !is_shown {
            failure = lost.or_else(|| self.server_failure());
        }
        if let Some(failure) = failure {
            return (Err(failure), file);
        }
        let finished = Finished { save, notes: std::mem::take(&mut self.notes), serving: self.server.take() };
        (Ok(finished), file)
    }

    fn server_failure(&self) -> Option<SinkError> {
        self.server.as_ref().and_then(|server| server.live.failure())
    }

    /// Whether any destination still receives messages.
    fn is_any_left(&self) -> bool {
        !self.writers.is_empty()
            || self.viewers.iter().any(|viewer| viewer.failure().is_none())
            || self.server.as_ref().is_some_and(|server| server.live.failure().is_none())
    }

    /// Adds notes about changes in the state of viewers and the server.
    fn update_notes(&mut self) {
        let is_news = |live: &Live| !live.reported_gone && live.failure().is_some();
        let has_news = self.viewers.iter().chain(self.server.as_ref().map(|server| &server.live)).any(is_news);
        let rest = if has_news { self.rest() } else { String::new() };
        let lives = self.viewers.iter_mut().chain(self.server.as_mut().map(|server| &mut server.live));
        for live in lives {
            if let Some(failure) = live.failure()
                && !std::mem::replace(&mut live.reported_gone, true)
            {
                let why = match &failure {
                    SinkError::Gone { messages, reason, .. } => {
                        format!("went away after {} ({reason})", counted(*messages, "message"))
                    }
                    other => format!("has failed ({other})"),
                };
                self.notes.push(format!("{} {why}{rest}", live.queue().name()));
            }
            if live.queue().left_out() > 0 && !std::mem::replace(&mut live.reported_thinned, true) {
                self.notes.push(format!(
                    "{} cannot keep up: it does not get values that newer ones replace{}",
                    live.queue().name(),
                    if self.is_recorded { " (the recording has them all)" } else { "" }
                ));
            }
        }
        self.notes.extend(self.server.as_mut().and_then(Serving::forgetting));
    }

    /// The end of a note about a lost destination: the destinations that are left.
    fn rest(&self) -> String {
        let mut rest: Vec<String> = Vec::new();
        for writer in &self.writers {
            rest.push(match writer.path() {
                Some(path) => format!("{} is still being written", path.display()),
                None => "standard output continues".to_owned(),
            });
        }
        let lives = self.viewers.iter().chain(self.server.as_ref().map(|server| &server.live));
        for live in lives.filter(|live| live.failure().is_none()) {
            rest.push(format!("{} continues", live.queue().name()));
        }
        if rest.is_empty() { String::new() } else { format!("; {}", listed(&rest)) }
    }
}

/// Parses the address of a viewer: `rerun+http://HOST:PORT/proxy`, or `rerun+https://` and `rerun://` for an encrypted
/// one.
fn parse_url(url: &str) -> Result<ProxyUri, SinkError> {
    url.parse()
        .map_err(|err: crate::sdk::re_uri::Error| SinkError::Url { url: url.to_owned(), reason: err.to_string() })
}
