//! A port and its connections: each one costs little memory, and none can lock out others.
//!
//! The *quiet time* of a connection starts when it is accepted, when it sends a request, and whenever it reads some of
//! its response. A connection without a pending request is closed when it has been quiet for [`REQUEST_TIMEOUT`]. At
//! most [`MAX_CONNECTIONS`] connections are served. When the limit is reached, a new connection replaces another one:
//! first one without a pending request, then one that does not read what there is, then any other; and among these the
//! one that has been served for the shortest time. A client that sends nothing, an incomplete request or garbage, or
//! that does not read, therefore loses its connection to one that does, and the viewer that has been served longest goes
//! last. A viewer that has received everything and waits for more is being served.

use std::collections::HashMap;
use std::convert::Infallible;
use std::net::IpAddr;
use std::pin::Pin;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use hyper::body::{Body, Bytes, Frame, Incoming, SizeHint};
use hyper::service::service_fn;
use hyper::{Request, Response};
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use hyper_util::server::conn::auto;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Notify;

use super::answer::{Content, SHARE};
use super::guard::Guard;
use crate::lock;

/// Upper limit on the number of connections. Two ports with this many, plus the other files of a run, stay below the
/// default limits per process: 1,024 files, 256 on macOS.
const MAX_CONNECTIONS: usize = if cfg!(target_os = "macos") { 64 } else { 256 };
/// Timeout for a complete request, the first or the next one on a connection.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(10);
/// Timeout for reading a finite response.
const READ_TIMEOUT: Duration = Duration::from_secs(60);
/// A connection that has been quiet for less than this is not replaced.
const GRACE: Duration = Duration::from_millis(500);
/// Interval between checks of the timeouts.
const SWEEP: Duration = Duration::from_millis(500);
/// Upper limit on the memory of a request's header, and on the buffer of a response [bytes].
const BUFFER: usize = 32 << 10;
/// HTTP/2 streams per connection; a viewer uses one.
const STREAMS: u32 = 8;
/// Interval of HTTP/2 pings.
const PING: Duration = Duration::from_secs(10);
/// Timeout of the response to a ping.
const PONG: Duration = Duration::from_secs(20);

/// The content that a port serves.
pub(crate) trait Site: Send + Sync + 'static {
    /// Whether responses last as long as the run.
    fn is_endless(&self) -> bool;

    /// Responds to a request received at this machine's address `at`.
    fn answer(
        &self,
        guard: &Guard,
        request: Request<Incoming>,
        at: IpAddr,
    ) -> impl Future<Output = Response<Content>> + Send;
}

/// A port and the content that it serves.
pub(crate) struct Port<S> {
    pub site: S,
    pub guard: Arc<Guard>,
    clients: Mutex<HashMap<u64, Arc<Client>>>,
    /// Number of connections accepted.
    accepted: AtomicU64,
}

impl<S: Site> Port<S> {
    pub fn new(site: S, guard: Arc<Guard>) -> Arc<Port<S>> {
        Arc::new(Port { site, guard, clients: Mutex::default(), accepted: AtomicU64::new(0) })
    }

    /// Accepts connections forever.
    pub async fn listen(self: Arc<Self>, listener: TcpListener) {
        loop {
            match listener.accept().await {
                Ok((stream, _)) => {
                    // further connections wait in the system's backlog
                    while self.is_full() && !self.close_one() {
                        tokio::time::sleep(GRACE / 10).await;
                    }
                    self.serve_in_task(stream);
                }
                // The client has disconnected already, or file handles are exhausted, which justifies closing a
                // connection.
                Err(_) => {
                    self.close_one();
                    tokio::time::sleep(GRACE / 10).await;
                }
            }
        }
    }

    /// Closes connections that exceed their timeouts, forever.
    pub async fn sweep(self: Arc<Self>) {
        loop {
            tokio::time::sleep(SWEEP).await;
            let patience = |activity: Activity| match activity.responses {
                0 => REQUEST_TIMEOUT,
                // a viewer in the background may not read for hours while the run continues
                _ if self.site.is_endless() => Duration::MAX,
                _ => READ_TIMEOUT,
            };
            let late = |client: &Client| {
                let activity = *lock(&client.activity);
                activity.quiet_since.elapsed() > patience(activity)
            };
            let numbers: Vec<u64> =
                lock(&self.clients).iter().filter(|(_, client)| late(client)).map(|(number, _)| *number).collect();
            numbers.into_iter().for_each(|number| self.close(number));
        }
    }

    /// Whether a response is in progress.
    pub fn is_busy(&self) -> bool {
        lock(&self.clients).values().any(|client| lock(&client.activity).responses > 0)
    }

    fn is_full(&self) -> bool {
        lock(&self.clients).len() >= MAX_CONNECTIONS
    }

    /// Closes the most expendable connection; `false` if there is none.
    fn close_one(&self) -> bool {
        let clients = lock(&self.clients);
        let activities = clients.iter().map(|(number, client)| (*number, *lock(&client.activity)));
        let expendable = activities.filter_map(|(number, activity)| Some((activity.worth()?, number))).min();
        drop(clients);
        let Some((_, number)) = expendable else { return false };
        self.close(number);
        true
    }

    fn close(&self, number: u64) {
        let Some(client) = lock(&self.clients).remove(&number) else { return };
        let Activity { responses, has_requested, .. } = *lock(&client.activity);
        if responses > 0 {
            self.guard.unread.fetch_add(1, Ordering::Relaxed);
        } else if !has_requested {
            self.guard.unfinished.fetch_add(1, Ordering::Relaxed);
        }
        client.closing.notify_one();
    }

    /// Serves a connection in its own task.
    fn serve_in_task(self: &Arc<Self>, stream: TcpStream) {
        let number = self.accepted.fetch_add(1, Ordering::Relaxed);
        let now = Instant::now();
        let activity =
            Activity { accepted_at: now, has_requested: false, responses: 0, has_all: false, quiet_since: now };
        let client = Arc::new(Client { activity: Mutex::new(activity), closing: Notify::new() });
        lock(&self.clients).insert(number, Arc::clone(&client));
        let entry = Entry { port: Arc::clone(self), number };
        tokio::spawn(async move {
            tokio::select! {
                result = entry.port.serve(stream, &client) => {
                    if result.is_err() && !lock(&client.activity).has_requested {
                        entry.port.guard.unfinished.fetch_add(1, Ordering::Relaxed);
                    }
                }
                () = client.closing.notified() => {}
            }
        });
    }

    async fn serve(
        self: &Arc<Self>,
        stream: TcpStream,
        client: &Arc<Client>,
    ) -> Result<(), Box<dyn std::error::Error + Send + Sync>> {
        let at = stream.local_addr()?.ip();
        stream.set_nodelay(true)?;
        let mut builder = auto::Builder::new(TokioExecutor::new());
        // A client that has closed its sending side may still be reading a page. On an endless stream, that is the only
        // sign that a viewer has disconnected.
        builder.http1().max_buf_size(BUFFER).half_close(!self.site.is_endless());
        builder
            .http2()
            .timer(TokioTimer::new())
            .keep_alive_interval(PING)
            .keep_alive_timeout(PONG)
            .max_concurrent_streams(STREAMS)
            .max_header_list_size(BUFFER as u32)
            .max_send_buf_size(BUFFER)
            .initial_stream_window_size(BUFFER as u32)
            .initial_connection_window_size(2 * BUFFER as u32);
        let service = service_fn(move |request| {
            let (port, client) = (Arc::clone(self), Arc::clone(client));
            async move {
                let response = port.site.answer(&port.guard, request, at).await;
                Ok::<_, Infallible>(response.map(|content| Answer::new(content, client)))
            }
        });
        builder.serve_connection(TokioIo::new(stream), service).await
    }
}

/// An entry in the list of connections, removed when dropped.
struct Entry<S: Site> {
    port: Arc<Port<S>>,
    number: u64,
}

impl<S: Site> Drop for Entry<S> {
    fn drop(&mut self) {
        lock(&self.port.clients).remove(&self.number);
    }
}

/// One connection.
struct Client {
    activity: Mutex<Activity>,
    /// Notified when the connection is to be closed.
    closing: Notify,
}

/// The activity of a connection.
#[derive(Clone, Copy)]
struct Activity {
    /// When the connection was accepted.
    accepted_at: Instant,
    has_requested: bool,
    /// Number of responses in progress.
    responses: usize,
    /// Whether it has received everything there is, and waits for more. The system buffers more than the client reads:
    /// until the buffers are full, a stalled client looks like a viewer.
    has_all: bool,
    quiet_since: Instant,
}

impl Activity {
    /// How much the connection is worth keeping: first its kind, then how long it has been served. `None` while it is
    /// too new to be replaced.
    fn worth(&self) -> Option<(u8, Duration)> {
        let now = Instant::now();
        let is_quiet = now - self.quiet_since >= GRACE;
        let kind = match self.responses {
            0 if is_quiet => 0,
            1.. if is_quiet && !self.has_all => 1,
            _ => 2,
        };
        let until = if kind == 2 { now } else { self.quiet_since };
        (now - self.accepted_at >= GRACE).then_some((kind, until - self.accepted_at))
    }
}

/// A response body that records how much of it is read.
struct Answer {
    content: Content,
    client: Arc<Client>,
    /// Amount read since the last record of activity [bytes].
    unrecorded: usize,
}

impl Answer {
    fn new(content: Content, client: Arc<Client>) -> Answer {
        let mut activity = lock(&client.activity);
        activity.has_requested = true;
        activity.responses += 1;
        activity.quiet_since = Instant::now();
        drop(activity);
        Answer { content, client, unrecorded: 0 }
    }
}

impl Drop for Answer {
    fn drop(&mut self) {
        let mut activity = lock(&self.client.activity);
        activity.responses -= 1;
        activity.quiet_since = Instant::now();
    }
}

impl Body for Answer {
    type Data = Bytes;
    type Error = Infallible;

    fn poll_frame(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, Infallible>>> {
        let answer = self.get_mut();
        let frame = answer.content.poll_frame(context);
        answer.unrecorded += match &frame {
            Poll::Ready(Some(frame)) => frame.data_ref().map_or(0, Bytes::len),
            _ => 0,
        };
        let mut activity = lock(&answer.client.activity);
        activity.has_all = frame.is_pending();
        // a client that has read everything available counts as active
        if answer.unrecorded >= SHARE || !matches!(frame, Poll::Ready(Some(_))) {
            answer.unrecorded = 0;
            activity.quiet_since = Instant::now();
        }
        drop(activity);
        frame.map(|frame| frame.map(Ok))
    }

    fn is_end_stream(&self) -> bool {
        matches!(&self.content, Content::Whole(rest) if rest.is_empty())
    }

    fn size_hint(&self) -> SizeHint {
        match &self.content {
            Content::Whole(rest) => SizeHint::with_exact(rest.len() as u64),
            Content::Parts(..) => SizeHint::default(),
        }
    }
}
