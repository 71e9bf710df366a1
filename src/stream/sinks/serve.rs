//! The web viewer, which is part of this program, and the server that feeds it.

use std::any::Any;
use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::time::{Duration, Instant};

use percent_encoding::{AsciiSet, NON_ALPHANUMERIC, utf8_percent_encode};
use rerun::grpc_server::GrpcServerSink;
use rerun::web_viewer::WebViewerConfig;
use rerun::{MemoryLimit, PlaybackBehavior, ServerOptions};

use super::live::{Live, within};
use super::note::seconds;
use super::queue::{Parcel, WhenFull};
use super::{Serve, SinkError};

/// What may wait for the server [bytes].
const LIMIT: u64 = 128 << 20;
/// What is left out for the server is left out for every viewer to come. So the run waits when the queue is full, as
/// long as the server gets on; it does not when one of its viewers does not read and 1,024 messages or 128 MiB for that
/// one are under way.
const WHEN_FULL: WhenFull = WhenFull::WaitThenThin(Duration::from_secs(1));
/// What the server keeps for viewers that connect late, compressed [bytes].
const HISTORY: u64 = 1 << 30;
/// How long the servers may take to start, and to stop.
const START: Duration = Duration::from_secs(5);
const STOP: Duration = Duration::from_secs(1);

/// Both servers, running.
pub(super) struct Server {
    pub live: Live,
    /// The web viewer's server; it stops when dropped. Of a type that the SDK does not name.
    web: Option<Box<dyn Any + Send>>,
    pub notes: Vec<String>,
    pub data_port: u16,
    /// Handed over so far, uncompressed [bytes].
    sent: u64,
    said_forgetting: bool,
}

impl Server {
    /// Starts both; they answer when this returns.
    pub fn start(serve: &Serve) -> Result<Server, SinkError> {
        let Serve { bind, web_port, grpc_port, open_browser } = *serve;
        if web_port == grpc_port && web_port != 0 {
            return Err(SinkError::SamePort { port: web_port });
        }
        // Probed before anything starts: the data server's own attempt to listen happens on a thread of its own and an
        // error there is only logged. Both listen at the same time, so that two free ports (0) are two.
        let (web_probe, grpc_probe) = (listen(WEB, bind, web_port)?, listen(DATA, bind, grpc_port)?);
        let (web_address, grpc_address) = (web_probe.1, grpc_probe.1);
        drop((web_probe, grpc_probe));

        let reachable = reachable(bind);
        let data_url = format!("rerun+http://{}/proxy", SocketAddr::new(reachable, grpc_address.port()));
        let web_root = format!("http://{}/", SocketAddr::new(reachable, web_address.port()));

        let options = ServerOptions {
            // everything from the start, in order: a viewer that comes late is there to see what has happened
            playback_behavior: PlaybackBehavior::OldestFirst,
            memory_limit: MemoryLimit::from_bytes(HISTORY),
            cors_allowed_origins: vec![origin(bind, web_address.port())],
        };
        let grpc_ip = match bind {
            IpAddr::V4(ip) => ip.to_string(),
            IpAddr::V6(ip) => format!("[{ip}]"),
        };
        let live =
            Live::start("the data server".to_owned(), LIMIT, WHEN_FULL, true, move || {
                match GrpcServerSink::new(&grpc_ip, grpc_address.port(), options) {
                    Ok(sink) => Ok(Box::new(sink)),
                    Err(err) => Err(err.to_string()),
                }
            })?;
        wait_for(&live, SocketAddr::new(reachable, grpc_address.port()))?;

        let config = WebViewerConfig {
            bind_ip: bind.to_string(),
            web_port: web_address.port().into(),
            connect_to: vec![data_url.clone()],
            open_browser,
            ..WebViewerConfig::default()
        };
        let web = rerun::serve_web_viewer(config).map_err(|err| SinkError::Serve {
            what: WEB.what,
            address: web_address,
            reason: err.to_string(),
        })?;

        let mut notes = vec![
            format!("serving at {web_root}?url={}", percent_encoded(&data_url)),
            format!(
                "listening on {web_address} (web viewer) and {grpc_address} (data; a native viewer connects with \
                 `rerun --connect {data_url}`)"
            ),
        ];
        if bind.is_unspecified() {
            notes.push(format!(
                "anyone who can reach this machine can watch: there, its name or address goes in both places of {reachable}"
            ));
        } else if !bind.is_loopback() {
            notes.push("anyone who can reach that address can watch".to_owned());
        }
        Ok(Server {
            live,
            web: Some(Box::new(web)),
            notes,
            data_port: grpc_address.port(),
            sent: 0,
            said_forgetting: false,
        })
    }

    /// Queues a message, and waits a little if the queue is full; `Err` is why the server takes no more.
    pub fn send(&mut self, parcel: Parcel) -> Result<(), SinkError> {
        self.sent += parcel.bytes();
        self.live.send(parcel)
    }

    /// Said once, when the server may have begun to forget.
    pub fn forgetting(&mut self) -> Option<String> {
        // The server only logs that it forgets; what it holds is compressed, so this may come early, never late.
        if self.said_forgetting || self.sent <= HISTORY {
            return None;
        }
        self.said_forgetting = true;
        Some(
            "the server keeps the last 1 GiB, and this run is getting longer: \
             a viewer opened from now on may not see its beginning (--save keeps everything)"
                .to_owned(),
        )
    }

    /// Stops both, and waits for that only shortly: a viewer that does not read could hold them for ever.
    fn stop(&mut self) {
        self.live.queue().release();
        let web = self.web.take();
        within(STOP, move || drop(web));
        self.live.queue().wait_ended(STOP);
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.stop();
    }
}

/// The servers after the run: viewers can connect and look at it as long as this lives.
pub struct Serving {
    pub(super) server: Server,
}

impl Serving {
    /// Takes both servers down, within a few seconds; dropping does the same.
    pub fn close(mut self) {
        self.server.stop();
    }

    /// Why the data server is no longer there, if it is not.
    pub fn failure(&self) -> Option<SinkError> {
        self.server.live.failure()
    }
}

/// One of the two servers, for messages.
#[derive(Clone, Copy)]
struct Kind {
    what: &'static str,
    option: &'static str,
}

const WEB: Kind = Kind { what: "the web viewer", option: "--web-port" };
const DATA: Kind = Kind { what: "the data server", option: "--grpc-port" };

/// Listens, to see whether that can be done and on which port if it was left open (0).
fn listen(kind: Kind, ip: IpAddr, port: u16) -> Result<(TcpListener, SocketAddr), SinkError> {
    let refuse = |source: io::Error| {
        let help = match source.kind() {
            io::ErrorKind::AddrInUse => {
                format!(
                    "something else is using port {port}, maybe another run or viewer: end it, or give another {}",
                    kind.option
                )
            }
            io::ErrorKind::AddrNotAvailable => format!("{ip} is not an address of this machine: give one with --bind"),
            io::ErrorKind::PermissionDenied => format!("ports below 1024 are reserved: give another {}", kind.option),
            _ => format!("give another {} or --bind", kind.option),
        };
        SinkError::Listen { what: kind.what, address: SocketAddr::new(ip, port), source: Arc::new(source), help }
    };
    let listener = TcpListener::bind((ip, port)).map_err(refuse)?;
    let address = listener.local_addr().map_err(refuse)?;
    Ok((listener, address))
}

/// Waits until the data server answers.
fn wait_for(live: &Live, address: SocketAddr) -> Result<(), SinkError> {
    let started = Instant::now();
    loop {
        let Err(err) = TcpStream::connect_timeout(&address, START) else { return Ok(()) };
        if let Some(failure) = live.failure() {
            return Err(failure);
        }
        if started.elapsed() > START {
            let reason = format!("no answer after {} ({err})", seconds(START));
            return Err(SinkError::Serve { what: DATA.what, address, reason });
        }
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// Where this machine itself reaches what listens on `bind`.
fn reachable(bind: IpAddr) -> IpAddr {
    match bind {
        IpAddr::V4(ip) if ip.is_unspecified() => Ipv4Addr::LOCALHOST.into(),
        IpAddr::V6(ip) if ip.is_unspecified() => Ipv6Addr::LOCALHOST.into(),
        other => other,
    }
}

/// The page's own origin, which the data server must accept in addition to `localhost` and `127.0.0.1`.
fn origin(bind: IpAddr, web_port: u16) -> String {
    if bind.is_unspecified() {
        // this machine has any number of names; the port is what distinguishes our page
        format!("http://*:{web_port}")
    } else {
        format!("http://{}", SocketAddr::new(bind, web_port))
    }
}

/// `text` as the value of a parameter of a URL.
fn percent_encoded(text: &str) -> String {
    /// All but what RFC 3986 calls unreserved.
    const RESERVED: AsciiSet = NON_ALPHANUMERIC.remove(b'-').remove(b'.').remove(b'_').remove(b'~');
    utf8_percent_encode(text, &RESERVED).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_address_is_safe_inside_another() {
        assert_eq!(
            percent_encoded("rerun+http://127.0.0.1:9876/proxy"),
            "rerun%2Bhttp%3A%2F%2F127.0.0.1%3A9876%2Fproxy"
        );
        assert_eq!(percent_encoded("http://[::1]:1/ü"), "http%3A%2F%2F%5B%3A%3A1%5D%3A1%2F%C3%BC");
    }

    #[test]
    fn only_the_own_page_may_read() {
        assert_eq!(origin(IpAddr::from([192, 168, 1, 5]), 9090), "http://192.168.1.5:9090");
        assert_eq!(origin(IpAddr::from([0, 0, 0, 0]), 9090), "http://*:9090");
        assert_eq!(origin(Ipv6Addr::LOCALHOST.into(), 80), "http://[::1]:80");
    }
}
