//! Viewers: the SDK's gRPC client on a thread of its own, so that no viewer can hold up or hang a run.

use std::io;
use std::net::{TcpStream, ToSocketAddrs as _};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, mpsc};
use std::time::Duration;

use rerun::external::re_uri::ProxyUri;
use rerun::sink::{GrpcSink, LogSink};

use super::SinkError;
use super::queue::{Parcel, Queue, WhenFull};

/// What may wait for a viewer [bytes]: some thousand steps of a scene of a few bodies.
const VIEWER_LIMIT: u64 = 128 << 20;
/// Messages handed to the SDK before it is asked whether they are on their way. Its own queue is bounded at 100 messages
/// of any size; asking keeps it at this, and tells how a viewer gets on and whether it is still there.
const BATCH: usize = 8;
/// How long a viewer's address may take to answer.
const PROBE: Duration = Duration::from_secs(1);
/// How long its name may take to be looked up, and all of its addresses to be tried.
const LOOK_UP: Duration = Duration::from_secs(5);

/// A place that shows what comes in, over a gRPC connection.
pub(super) struct Live {
    queue: Arc<Queue>,
    /// Its going away, its falling behind: each is said once.
    pub said_gone: bool,
    pub said_thinned: bool,
}

impl Live {
    /// Streams to the viewer at `uri`, which must have answered a [`probe`].
    pub fn connect(uri: ProxyUri) -> Result<Live, SinkError> {
        let name = format!("the viewer at {uri}");
        Live::start(name, VIEWER_LIMIT, WhenFull::Thin, false, move || Ok(Box::new(GrpcSink::new(uri))))
    }

    /// Starts the thread; `open` is run on it. With `stays`, the sink is taken down on [`Live::release`] only, and not
    /// when everything is delivered.
    pub fn start(
        name: String,
        limit: u64,
        when_full: WhenFull,
        stays: bool,
        open: impl FnOnce() -> Result<Box<dyn LogSink>, String> + Send + 'static,
    ) -> Result<Live, SinkError> {
        let queue = Arc::new(Queue::new(name.clone(), limit, when_full));
        // Detached: it cannot be made to end while it waits for a viewer that does not read.
        let thread = std::thread::Builder::new().name("viewer".to_owned()).spawn({
            let queue = Arc::clone(&queue);
            move || {
                let _attendance = queue.attend();
                match open() {
                    Ok(sink) => attend(&queue, sink, stays),
                    Err(reason) => queue.gone(reason),
                }
            }
        });
        match thread {
            Ok(_) => Ok(Live { queue, said_gone: false, said_thinned: false }),
            Err(err) => Err(SinkError::Thread { target: name, reason: err.to_string() }),
        }
    }

    /// Queues a message, never waits; `Err` is why it takes no more.
    pub fn send(&self, parcel: Parcel) -> Result<(), SinkError> {
        self.queue.send(parcel)
    }

    /// What is known of it.
    pub fn queue(&self) -> &Queue {
        &self.queue
    }

    /// Why it takes no more, if it does not.
    pub fn failure(&self) -> Option<SinkError> {
        self.queue.failure()
    }
}

/// A run that ended badly: nobody waits for the viewer any more.
impl Drop for Live {
    fn drop(&mut self) {
        self.queue.release();
    }
}

/// Delivers what comes through the queue until its end, or the sink's.
fn attend(queue: &Queue, sink: Box<dyn LogSink>, stays: bool) {
    loop {
        let mut batch = queue.take(BATCH, None);
        let delivered = batch.messages.len();
        for msg in batch.messages.drain(..) {
            sink.send(msg);
        }
        // No time-out: the SDK answers as soon as the connection is lost. A viewer that only does not read makes this
        // wait for ever, which is why nobody waits for this thread for long.
        if delivered > 0
            && let Err(err) = sink.flush_blocking(Duration::MAX)
        {
            queue.gone(plain(&err.to_string()));
            break;
        }
        queue.done(&batch, delivered, true);
        if batch.last {
            if stays {
                queue.wait_released();
            }
            break;
        }
    }
    // waits until the other side has everything, and for ever if it does not read
    drop(sink);
}

/// What the SDK's error means to a user; its own words are about its insides.
fn plain(error: &str) -> String {
    const CODE: &str = "Failed to send messages: ";
    let code = error.split_once(CODE).and_then(|(_, rest)| rest.split(", uri: ").next());
    match code {
        // what a viewer of another kind or version answers is worth knowing
        Some(code) if code != "Unknown error" => format!("the connection broke: {code}"),
        _ if error.contains("unable to connect") => "it does not speak gRPC, or not on this port".to_owned(),
        _ if error.contains("gracefully") => "it closed the connection".to_owned(),
        _ if error.contains("server thread shut down") => "it crashed".to_owned(),
        _ => "the connection broke".to_owned(),
    }
}

/// Whether something listens at the address, before the SDK retries to connect to nothing for ever.
pub(super) fn probe(uri: &ProxyUri) -> Result<(), SinkError> {
    let address = format!("{}:{}", uri.origin.format_host(), uri.origin.port);
    let attempt = within(LOOK_UP, move || {
        let mut last = io::Error::from(io::ErrorKind::NotFound);
        for address in address.to_socket_addrs()? {
            match TcpStream::connect_timeout(&address, PROBE) {
                Ok(_) => return Ok(()),
                Err(err) => last = err,
            }
        }
        Err(last)
    });
    let reason = match attempt {
        Some(Ok(())) => return Ok(()),
        Some(Err(err)) => err.to_string(),
        None => "no answer".to_owned(),
    };
    Err(SinkError::NoViewer { url: uri.to_string(), reason, local: uri.origin.is_localhost() })
}

/// What `work` returns, or `None` if it takes longer than `limit`, cannot be started, or panics; it then goes on by
/// itself, and nobody listens.
pub(super) fn within<T: Send + 'static>(limit: Duration, work: impl FnOnce() -> T + Send + 'static) -> Option<T> {
    let (answer, question) = mpsc::sync_channel(1);
    let thread = std::thread::Builder::new().name("bounded".to_owned());
    thread
        .spawn(move || {
            if let Ok(result) = catch_unwind(AssertUnwindSafe(work)) {
                answer.send(result).ok();
            }
        })
        .ok()?;
    question.recv_timeout(limit).ok()
}
