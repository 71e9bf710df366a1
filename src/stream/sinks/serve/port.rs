//! A port and those who are connected to it: each costs little memory, and none keeps another out.
//!
//! A connection counts as *quiet* from when it was accepted, asked for something, or took something of its answer. One
//! without an unanswered request is closed when it has been quiet for [`REQUEST`]. As many as [`SEATS`] are served; when
//! they are taken, the one that has been quiet for longest goes for the one that comes, first of those that have not
//! asked for anything; if none is quiet, the one that has taken least. So somebody who sends nothing, half of something or
//! nonsense, or who does not read, loses the place to somebody who does. A viewer that has everything and waits for more
//! is quiet, too, and goes last.

use std::collections::HashMap;
use std::convert::Infallible;
use std::pin::Pin;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll, ready};
use std::time::{Duration, Instant};

use hyper::body::{Body, Bytes, Frame, SizeHint};
use hyper::service::service_fn;
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use hyper_util::server::conn::auto;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Notify;

use super::answer::Site;
use super::guard::Guard;
use super::history::Reader;

/// Connections served at a time. Two ports of that many, and what else a run has open, stay below what systems allow a
/// process by default: 1,024 files, on macOS 256.
const SEATS: usize = if cfg!(target_os = "macos") { 64 } else { 256 };
/// How long a connection has to send a whole request, or the next one.
const REQUEST: Duration = Duration::from_secs(10);
/// How long an answer that ends may not be taken.
const TAKE: Duration = Duration::from_secs(60);
/// Who has been quiet for less than this is not closed for another.
const GRACE: Duration = Duration::from_millis(500);
/// How often the clocks are looked at.
const SWEEP: Duration = Duration::from_millis(500);
/// What may be in memory of a request's head, and of an answer on its way [bytes].
const BUFFER: usize = 32 << 10;
/// Streams of a connection with several of them; a viewer uses one.
const STREAMS: u32 = 8;
/// What a client has to take to count as taking [bytes].
const SHARE: usize = 64 << 10;
/// How often an HTTP/2 client is asked whether it is still there, and how long it has to answer.
const PING: Duration = Duration::from_secs(10);
const PONG: Duration = Duration::from_secs(20);

/// A port and what is behind it.
pub(super) struct Port {
    pub site: Site,
    pub guard: Arc<Guard>,
    clients: Mutex<HashMap<u64, Arc<Client>>>,
    /// Connections accepted.
    accepted: AtomicU64,
}

impl Port {
    pub fn new(site: Site, guard: Arc<Guard>) -> Arc<Port> {
        Arc::new(Port { site, guard, clients: Mutex::default(), accepted: AtomicU64::new(0) })
    }

    /// Accepts connections for ever.
    pub async fn listen(self: Arc<Port>, listener: TcpListener) {
        loop {
            match listener.accept().await {
                Ok((stream, _)) => {
                    // who comes meanwhile waits in the system's queue
                    while self.is_full() && !self.close_one() {
                        tokio::time::sleep(GRACE / 10).await;
                    }
                    self.seat(stream);
                }
                // A client that has gone already, or no more files to be had, which is worth a seat.
                Err(_) => {
                    self.close_one();
                    tokio::time::sleep(GRACE / 10).await;
                }
            }
        }
    }

    /// Closes for ever who is out of time.
    pub async fn sweep(self: Arc<Port>) {
        loop {
            tokio::time::sleep(SWEEP).await;
            let patience = |doing: Doing| match doing.answers {
                0 => REQUEST,
                // a viewer in the background may not look for hours at a run that goes on
                _ if self.site.is_endless() => Duration::MAX,
                _ => TAKE,
            };
            let late = |client: &Client| {
                let doing = *client.doing();
                doing.quiet_since.elapsed() > patience(doing)
            };
            let numbers: Vec<u64> =
                self.clients().iter().filter(|(_, client)| late(client)).map(|(number, _)| *number).collect();
            numbers.into_iter().for_each(|number| self.close(number));
        }
    }

    /// Whether an answer is under way.
    pub fn is_busy(&self) -> bool {
        self.clients().values().any(|client| client.doing().answers > 0)
    }

    fn clients(&self) -> MutexGuard<'_, HashMap<u64, Arc<Client>>> {
        self.clients.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn is_full(&self) -> bool {
        self.clients().len() >= SEATS
    }

    /// Closes the connection that can best be spared, if one can.
    fn close_one(&self) -> bool {
        let quiet =
            |doing: &Doing| (doing.quiet_since.elapsed() >= GRACE).then_some((doing.answers > 0, doing.quiet_since));
        // Systems take more for a client than it reads: who does not read looks like a viewer until that is full.
        let idle = |doing: &Doing| (doing.seated.elapsed() >= GRACE).then_some((doing.taken, doing.seated));
        let seated: Vec<(u64, Doing)> =
            self.clients().iter().map(|(number, client)| (*number, *client.doing())).collect();
        let quietest = seated.iter().filter_map(|(number, doing)| Some((quiet(doing)?, *number))).min();
        let idlest = || seated.iter().filter_map(|(number, doing)| Some((idle(doing)?, *number))).min();
        let Some(number) = quietest.map(|(_, number)| number).or_else(|| idlest().map(|(_, number)| number)) else {
            return false;
        };
        self.close(number);
        true
    }

    fn close(&self, number: u64) {
        let Some(client) = self.clients().remove(&number) else { return };
        let Doing { answers, has_asked, .. } = *client.doing();
        if answers > 0 {
            self.guard.unread.fetch_add(1, Ordering::Relaxed);
        } else if !has_asked {
            self.guard.unfinished.fetch_add(1, Ordering::Relaxed);
        }
        client.closing.notify_one();
    }

    /// Serves a connection on a task of its own.
    fn seat(self: &Arc<Port>, stream: TcpStream) {
        let number = self.accepted.fetch_add(1, Ordering::Relaxed);
        let now = Instant::now();
        let doing = Doing { seated: now, has_asked: false, answers: 0, taken: 0, quiet_since: now };
        let client = Arc::new(Client { doing: Mutex::new(doing), closing: Notify::new() });
        self.clients().insert(number, Arc::clone(&client));
        let seat = Seat { port: Arc::clone(self), number };
        tokio::spawn(async move {
            tokio::select! {
                result = seat.port.serve(stream, &client) => {
                    if result.is_err() && !client.doing().has_asked {
                        seat.port.guard.unfinished.fetch_add(1, Ordering::Relaxed);
                    }
                }
                () = client.closing.notified() => {}
            }
        });
    }

    async fn serve(
        self: &Arc<Port>,
        stream: TcpStream,
        client: &Arc<Client>,
    ) -> Result<(), Box<dyn std::error::Error + Send + Sync>> {
        let at = stream.local_addr()?.ip();
        stream.set_nodelay(true)?;
        let mut builder = auto::Builder::new(TokioExecutor::new());
        // Who has sent all may still read a page. That a viewer is gone can only be seen from its silence.
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

/// A connection's entry in the list, which goes when it does.
struct Seat {
    port: Arc<Port>,
    number: u64,
}

impl Drop for Seat {
    fn drop(&mut self) {
        self.port.clients().remove(&self.number);
    }
}

/// One connection.
struct Client {
    doing: Mutex<Doing>,
    /// Rung when it is to be closed.
    closing: Notify,
}

/// What a connection is doing.
#[derive(Clone, Copy)]
struct Doing {
    seated: Instant,
    has_asked: bool,
    /// Answers under way.
    answers: usize,
    /// What it took of answers until then [bytes].
    taken: u64,
    quiet_since: Instant,
}

impl Client {
    fn doing(&self) -> MutexGuard<'_, Doing> {
        self.doing.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// What there is to answer.
pub(super) enum Content {
    Whole(Bytes),
    /// What the run sends, and what comes after it.
    Stream(Reader, Option<Frame<Bytes>>),
}

/// An answer that keeps account of how it is taken.
struct Answer {
    content: Content,
    client: Arc<Client>,
    /// Taken since that was last noted [bytes].
    unnoted: usize,
}

impl Answer {
    fn new(content: Content, client: Arc<Client>) -> Answer {
        let mut doing = client.doing();
        doing.has_asked = true;
        doing.answers += 1;
        doing.quiet_since = Instant::now();
        drop(doing);
        Answer { content, client, unnoted: 0 }
    }
}

impl Drop for Answer {
    fn drop(&mut self) {
        let mut doing = self.client.doing();
        doing.answers -= 1;
        doing.quiet_since = Instant::now();
    }
}

impl Content {
    fn poll_frame(&mut self, context: &mut Context<'_>) -> Poll<Option<Frame<Bytes>>> {
        match self {
            Content::Whole(rest) if rest.is_empty() => Poll::Ready(None),
            Content::Whole(rest) => Poll::Ready(Some(Frame::data(rest.split_to(rest.len().min(SHARE))))),
            Content::Stream(reader, end) => match ready!(reader.poll_next(context)) {
                Some(message) => Poll::Ready(Some(Frame::data(message))),
                None => Poll::Ready(end.take()),
            },
        }
    }
}

impl Body for Answer {
    type Data = Bytes;
    type Error = Infallible;

    fn poll_frame(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, Infallible>>> {
        let answer = self.get_mut();
        let frame = answer.content.poll_frame(context);
        answer.unnoted += match &frame {
            Poll::Ready(Some(frame)) => frame.data_ref().map_or(0, Bytes::len),
            _ => 0,
        };
        // who has taken everything there is has done its share
        if answer.unnoted >= SHARE || !matches!(frame, Poll::Ready(Some(_))) {
            let mut doing = answer.client.doing();
            doing.taken += std::mem::take(&mut answer.unnoted) as u64;
            doing.quiet_since = Instant::now();
        }
        frame.map(|frame| frame.map(Ok))
    }

    fn is_end_stream(&self) -> bool {
        matches!(&self.content, Content::Whole(rest) if rest.is_empty())
    }

    fn size_hint(&self) -> SizeHint {
        match &self.content {
            Content::Whole(rest) => SizeHint::with_exact(rest.len() as u64),
            Content::Stream(..) => SizeHint::default(),
        }
    }
}
