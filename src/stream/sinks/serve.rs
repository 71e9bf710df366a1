//! The embedded web viewer, and the server that feeds it.
//!
//! Any client that reaches the two ports can read everything the run sends; only the run can write. The host name of a
//! request must be this machine's own or allowed, and so must the host of the page that it comes from. No request can
//! stop the run; rejected requests are counted and reported at the end.

use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use percent_encoding::{AsciiSet, NON_ALPHANUMERIC, utf8_percent_encode};
use re_web_viewer_server::WebViewerData;
use socket2::{Domain, Protocol, Socket, Type};
use tokio::net::TcpListener;
use tokio::sync::oneshot;

mod answer;
mod follow;
mod guard;
mod history;
mod port;

pub(crate) use answer::{Content, body, confine, respond};
pub(crate) use follow::{Parts, follow};
pub(crate) use guard::Guard;
pub use guard::Host;
pub(crate) use port::Site;

use super::live::{Live, within};
use super::queue::{Parcel, WhenFull};
use super::{Serve, SinkError};
use answer::OfRun;
use history::Log;
use port::Port;

/// Upper limit on data waiting for the server [bytes].
const LIMIT: u64 = 128 << 20;
/// A message dropped for the server is missing for every later viewer. So the run waits when the queue is full, as long
/// as the server makes progress.
const WHEN_FULL: WhenFull = WhenFull::WaitThenThin(Duration::from_secs(1));
/// Upper limit on history kept for viewers that connect late, compressed [bytes].
const HISTORY: u64 = 1 << 30;
/// Timeout for stopping the server.
const STOP: Duration = Duration::from_secs(1);
/// Part of it during which viewers can receive the last messages.
const DRAIN: Duration = Duration::from_millis(200);
/// Send buffer of a connection [bytes].
const SEND: usize = 256 << 10;
/// Connections that may wait to be accepted.
const BACKLOG: i32 = 1024;

/// The servers of a run: both ports, served by one thread. Viewers can connect to them as long as this value lives.
pub struct Serving {
    pub(super) live: Live,
    pub(super) notes: Vec<String>,
    pub(super) data_port: u16,
    log: Arc<Log>,
    guard: Arc<Guard>,
    /// The thread, and a sender that stops it when dropped.
    thread: Option<(oneshot::Sender<()>, JoinHandle<()>)>,
    reported_forgetting: bool,
}

impl Serving {
    /// Starts both servers; they accept connections when this returns.
    pub(super) fn start(serve: &Serve) -> Result<Serving, SinkError> {
        let Serve { bind, web_port, grpc_port, ref allow } = *serve;
        if web_port == grpc_port && web_port != 0 {
            return Err(SinkError::SamePort { port: web_port });
        }
        let guard = Arc::new(Guard::new(allow.clone()));
        let (feed, history) = history::history(HISTORY);
        let log = history.log();
        let open = |stopping| {
            let (web_listener, web_address) = listen(WEB, bind, web_port)?;
            let (data_listener, data_address) = listen(NAME, bind, grpc_port)?;
            let files = viewer_files()
                .map_err(|reason| SinkError::Failed(format!("{WEB} did not start on {web_address}: {reason}")))?;
            let web = Port::new(OfRun::Viewer(files, data_address.port()), Arc::clone(&guard));
            let data = Port::new(OfRun::Data(history), Arc::clone(&guard));
            let serving = async move {
                serve_ports([(web, web_listener), (Arc::clone(&data), data_listener)], stopping).await;
                let started = Instant::now();
                while data.is_busy() && started.elapsed() < DRAIN {
                    tokio::time::sleep(DRAIN / 20).await;
                }
            };
            Ok(([web_address, data_address], serving))
        };
        let ([web_address, data_address], stop, thread) = in_thread(NAME, open)?;
        let live = Live::start(NAME.to_owned(), LIMIT, WHEN_FULL, true, move || Ok(Box::new(feed)))?;

        let reachable = reachable(bind);
        let addresses = |host: &str| {
            let data_url = format!("rerun+http://{host}:{}/proxy", data_address.port());
            let page = format!("http://{host}:{}/?url={}", web_address.port(), percent_encoded(&data_url));
            (page, data_url)
        };
        let (page, data_url) = addresses(&in_url(reachable));
        let mut notes = vec![
            format!("serving at {page}"),
            format!(
                "listening on {web_address} (web viewer) and {data_address} (data; a native viewer connects with \
                 `rerun --connect {data_url}`)"
            ),
        ];
        notes.extend(exposure(bind, &addresses("HOST").0));
        Ok(Serving {
            live,
            notes,
            data_port: data_address.port(),
            log,
            guard,
            thread: Some((stop, thread)),
            reported_forgetting: false,
        })
    }

    /// Queues a message, waiting briefly if the queue is full. `Err` tells why the server accepts no more.
    pub(super) fn send(&self, parcel: Parcel) -> Result<(), SinkError> {
        self.live.send(parcel)
    }

    /// Returns a note, once, when the server has begun to discard history.
    pub(super) fn forgetting(&mut self) -> Option<String> {
        if self.reported_forgetting || !self.log.is_forgetting() {
            return None;
        }
        self.reported_forgetting = true;
        Some(
            "the server keeps the last 1 GiB, and this run is getting longer: \
             a viewer opened from now on does not see its beginning (--save keeps everything)"
                .to_owned(),
        )
    }

    /// Why the data server has stopped; `None` if it has not.
    pub fn failure(&self) -> Option<SinkError> {
        self.live.failure()
    }

    /// Summary of the requests rejected so far, as a sentence.
    pub fn refused(&self) -> Option<String> {
        self.guard.summary()
    }

    /// Stops both servers within a few seconds; dropping does the same.
    pub fn close(self) {
        drop(self);
    }
}

impl Drop for Serving {
    /// Stops both servers with a short timeout: a viewer that does not read could block them forever.
    fn drop(&mut self) {
        self.live.queue().release();
        self.live.queue().wait_ended(STOP);
        if let Some((stop, thread)) = self.thread.take() {
            drop(stop);
            within(STOP, move || thread.join());
        }
    }
}

/// Runs a server on a thread of its own. `open` listens, within a runtime, and returns what the caller wants to know and
/// the server, which is to end when the channel that it gets is closed: when the returned sender is dropped.
fn in_thread<T, F: Future<Output = ()> + Send + 'static>(
    target: &str,
    open: impl FnOnce(oneshot::Receiver<()>) -> Result<(T, F), SinkError>,
) -> Result<(T, oneshot::Sender<()>, JoinHandle<()>), SinkError> {
    let start = |err: io::Error| SinkError::Thread { target: target.to_owned(), reason: err.to_string() };
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(start)?;
    let (stop, stopping) = oneshot::channel();
    let entered = runtime.enter();
    let (opened, server) = open(stopping)?;
    drop(entered);
    let thread = std::thread::Builder::new().name("server".to_owned()).spawn(move || {
        runtime.block_on(server);
        runtime.shutdown_background();
    });
    Ok((opened, stop, thread.map_err(start)?))
}

/// Accepts connections on ports until the channel is closed.
async fn serve_ports<S: Site, const N: usize>(
    ports: [(Arc<Port<S>>, TcpListener); N],
    stopping: oneshot::Receiver<()>,
) {
    let tasks =
        ports.map(|(port, listener)| [tokio::spawn(Arc::clone(&port).listen(listener)), tokio::spawn(port.sweep())]);
    stopping.await.ok();
    tasks.as_flattened().iter().for_each(tokio::task::JoinHandle::abort);
}

/// Serves a page of its own on the web port; returns its address, a sender that stops it when dropped, and its thread.
pub(crate) fn page(
    serve: &Serve,
    site: impl Site,
) -> Result<(SocketAddr, oneshot::Sender<()>, JoinHandle<()>), SinkError> {
    let port = Port::new(site, Arc::new(Guard::new(serve.allow.clone())));
    let (address, stop, thread) = in_thread(WEB, |stopping| {
        let (listener, address) = listen(WEB, serve.bind, serve.web_port)?;
        Ok((address, serve_ports([(port, listener)], stopping)))
    })?;
    Ok((SocketAddr::new(reachable(address.ip()), address.port()), stop, thread))
}

/// An unguessable token.
///
/// # Errors
/// The system gives no random numbers.
pub(crate) fn token() -> Result<String, SinkError> {
    let mut random = [0; 16];
    getrandom::fill(&mut random)
        .map_err(|error| SinkError::Thread { target: "the page's token".to_owned(), reason: error.to_string() })?;
    Ok(random.iter().map(|byte| format!("{byte:02x}")).collect())
}

/// The files of the web viewer, embedded in this program.
///
/// # Errors
/// They cannot be unpacked, for the returned reason.
pub(crate) fn viewer_files() -> Result<&'static WebViewerData, String> {
    static FILES: OnceLock<WebViewerData> = OnceLock::new();
    if let Some(files) = FILES.get() {
        return Ok(files);
    }
    let files = WebViewerData::load(None).map_err(|error| error.to_string())?;
    Ok(FILES.get_or_init(|| files))
}

/// Name of the server in messages to users.
const NAME: &str = "the data server";

/// What listens on the port of the page.
const WEB: &str = "the web viewer";

/// Listens on a port, or on any free one for port 0. Must be called within a runtime.
fn listen(what: &'static str, ip: IpAddr, port: u16) -> Result<(TcpListener, SocketAddr), SinkError> {
    let listen_error = |source: io::Error| {
        let help = match source.kind() {
            io::ErrorKind::AddrInUse => {
                let other = "maybe another run or viewer: end it, or give others with --bind HOST:PORT (0: any)";
                format!("something else is using port {port}, {other}")
            }
            io::ErrorKind::AddrNotAvailable => format!("{ip} is not an address of this machine: give one with --bind"),
            io::ErrorKind::PermissionDenied => "ports below 1024 are reserved: give another with --bind".to_owned(),
            _ => "give another address or port with --bind".to_owned(),
        };
        SinkError::Listen { what, address: SocketAddr::new(ip, port), source: Arc::new(source), help }
    };
    let listener = bound(SocketAddr::new(ip, port)).and_then(|socket| TcpListener::from_std(socket.into()));
    let listener = listener.map_err(listen_error)?;
    let address = listener.local_addr().map_err(listen_error)?;
    Ok((listener, address))
}

fn bound(address: SocketAddr) -> io::Result<Socket> {
    let socket = Socket::new(Domain::for_address(address), Type::STREAM, Some(Protocol::TCP))?;
    // on Windows, this would let two programs use the same port
    #[cfg(unix)]
    socket.set_reuse_address(true)?;
    if address.ip() == IpAddr::V6(Ipv6Addr::UNSPECIFIED) {
        // an unspecified address covers both IP versions, even where that is not the default
        socket.set_only_v6(false)?;
    }
    // bounds the system's memory per accepted connection, whether or not the client reads
    socket.set_send_buffer_size(SEND)?;
    socket.set_nonblocking(true)?;
    socket.bind(&address.into())?;
    socket.listen(BACKLOG)?;
    Ok(socket)
}

/// A note about who else can read the run, if the server can be reached from outside; `page` is the URL that they would
/// open.
fn exposure(bind: IpAddr, page: &str) -> Option<String> {
    let (who, host) = match bind {
        bind if bind.is_loopback() => return None,
        bind if bind.is_unspecified() => ("this machine", "an address of this machine"),
        _ => ("that address", "that address"),
    };
    Some(format!(
        "anyone who can reach {who} can read everything that the run shows, its scene and settings too, without a password \
         and unencrypted; nobody can write: {page} (for HOST {host}; `--bind NAME` listens on the address of a name, and accepts it)"
    ))
}

/// The address at which this machine itself reaches a server bound to `bind`.
fn reachable(bind: IpAddr) -> IpAddr {
    match bind {
        IpAddr::V4(ip) if ip.is_unspecified() => Ipv4Addr::LOCALHOST.into(),
        IpAddr::V6(ip) if ip.is_unspecified() => Ipv6Addr::LOCALHOST.into(),
        other => other,
    }
}

/// Formats an address as the host of a URL. A content security policy has no IPv6 addresses, but it has names.
fn in_url(ip: IpAddr) -> String {
    match ip {
        IpAddr::V4(ip) => ip.to_string(),
        IpAddr::V6(Ipv6Addr::LOCALHOST) => "localhost".to_owned(),
        IpAddr::V6(ip) => format!("[{ip}]"),
    }
}

/// Percent-encodes `text` as the value of a URL parameter.
fn percent_encoded(text: &str) -> String {
    /// Everything but the unreserved characters of RFC 3986.
    const RESERVED: AsciiSet = NON_ALPHANUMERIC.remove(b'-').remove(b'.').remove(b'_').remove(b'~');
    utf8_percent_encode(text, &RESERVED).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_is_encoded_as_a_url_parameter() {
        assert_eq!(
            percent_encoded("rerun+http://127.0.0.1:9876/proxy"),
            "rerun%2Bhttp%3A%2F%2F127.0.0.1%3A9876%2Fproxy"
        );
        assert_eq!(percent_encoded("http://[::1]:1/ü"), "http%3A%2F%2F%5B%3A%3A1%5D%3A1%2F%C3%BC");
    }

    #[test]
    fn exposure_to_others_is_reported() {
        let exposure = |bind: &str| exposure(bind.parse().expect("an address"), "http://HOST:9090/?url=x");
        assert_eq!([exposure("127.0.0.1"), exposure("::1")], [None, None]);
        for (bind, who) in [("0.0.0.0", "this machine"), ("::", "this machine"), ("192.168.1.5", "that address")] {
            let note = exposure(bind).expect("a note");
            for part in [who, "can read everything", "nobody can write", "http://HOST:9090/?url=x", "--bind"] {
                assert!(note.contains(part), "{bind}: {note}");
            }
        }
    }
}
