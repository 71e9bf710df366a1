//! Live viewers: the SDK's gRPC client on a separate thread, so that no viewer can block a run.

use std::io;
use std::net::{TcpStream, ToSocketAddrs as _};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, mpsc};
use std::time::Duration;

use re_sorbet::timestamp_metadata::{TimestampLocation, now_timestamp};

use super::SinkError;
use super::note::viewer_help;
use super::queue::{Parcel, Queue, WhenFull};
use crate::sdk::LogMsg;
use crate::sdk::{
    re_grpc_client::write::{Client, ClientConnectionFailure, GrpcFlushError, Options},
    re_uri::ProxyUri,
};

/// Upper limit on data waiting for a viewer [bytes]: several thousand steps of a scene with a few bodies.
const VIEWER_LIMIT: u64 = 128 << 20;
/// Messages handed to the SDK before it is flushed. The SDK's own queue is bounded by 100 messages of any size;
/// flushing keeps it at this length, and tells whether the viewer makes progress and is still connected.
const BATCH: usize = 8;
/// Timeout of a connection attempt to one address of a viewer.
const PROBE: Duration = Duration::from_secs(1);
/// Timeout of resolving a viewer's name and trying all of its addresses.
const LOOK_UP: Duration = Duration::from_secs(5);

/// The other end of a queue.
pub(super) trait LogSink {
    /// Sends a message, waiting while there are too many before it.
    fn send(&self, msg: LogMsg);

    /// Waits until everything is delivered. `Err` tells why it cannot be.
    fn flush(&self) -> Result<(), String>;
}

impl LogSink for Client {
    fn send(&self, mut msg: LogMsg) {
        // for the latencies that the viewer shows
        if let Some(key) = TimestampLocation::GrpcSink.metadata_key() {
            msg.insert_arrow_record_batch_metadata(key.to_owned(), now_timestamp());
        }
        self.send_blocking(msg);
    }

    fn flush(&self) -> Result<(), String> {
        // No timeout: the SDK returns as soon as the connection is lost. If the viewer is connected but does not read,
        // this blocks forever, which is why nothing waits long for this thread.
        self.flush_blocking(Duration::MAX).map_err(|err| plain(&err))
    }
}

/// A destination that displays messages, over a gRPC connection.
pub(super) struct Live {
    queue: Arc<Queue>,
    /// Whether its disconnection has been reported to the user.
    pub reported_gone: bool,
    /// Whether dropped messages have been reported to the user.
    pub reported_thinned: bool,
}

impl Live {
    /// Connects to the viewer at `uri`, which must have answered a [`probe`].
    pub fn connect(uri: ProxyUri) -> Result<Live, SinkError> {
        let name = format!("the viewer at {uri}");
        Live::start(name, VIEWER_LIMIT, WhenFull::Thin, false, move || {
            Ok(Box::new(Client::new(uri, Options::default())))
        })
    }

    /// Starts the thread, which calls `open`. With `stays`, the sink is dropped only on [`Queue::release`], not as soon
    /// as everything is delivered.
    pub fn start(
        name: String,
        limit: u64,
        when_full: WhenFull,
        stays: bool,
        open: impl FnOnce() -> Result<Box<dyn LogSink>, String> + Send + 'static,
    ) -> Result<Live, SinkError> {
        let queue = Arc::new(Queue::new(name.clone(), limit, when_full));
        // Detached: the thread cannot be stopped while it waits for a viewer that does not read.
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
            Ok(_) => Ok(Live { queue, reported_gone: false, reported_thinned: false }),
            Err(err) => Err(SinkError::Thread { target: name, reason: err.to_string() }),
        }
    }

    /// Queues a message without waiting. `Err` tells why the viewer receives no more.
    pub fn send(&self, parcel: Parcel) -> Result<(), SinkError> {
        self.queue.send(parcel)
    }

    /// The queue, for its state.
    pub fn queue(&self) -> &Queue {
        &self.queue
    }

    /// Why the viewer receives no more; `None` if it does.
    pub fn failure(&self) -> Option<SinkError> {
        self.queue.failure()
    }
}

/// On failure: does not wait for the viewer.
impl Drop for Live {
    fn drop(&mut self) {
        self.queue.release();
    }
}

/// Delivers messages from the queue until the queue ends or the sink fails.
fn attend(queue: &Queue, sink: Box<dyn LogSink>, stays: bool) {
    loop {
        let mut batch = queue.take(BATCH, None);
        let delivered = batch.messages.len();
        for msg in batch.messages.drain(..) {
            sink.send(msg);
        }
        if delivered > 0
            && let Err(reason) = sink.flush()
        {
            queue.gone(reason);
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
    // blocks until the other side has received everything: forever, if it does not read
    drop(sink);
}

/// The SDK's error as a message for users; the original is about implementation details.
fn plain(error: &GrpcFlushError) -> String {
    match error {
        GrpcFlushError::FailedToConnect { .. } => "it does not speak gRPC, or not on this port".to_owned(),
        GrpcFlushError::GracefulDisconnect { .. } => "it closed the connection".to_owned(),
        GrpcFlushError::ErrorDisconnect { err: ClientConnectionFailure::FailedToSendMessages(code), .. } => {
            match code.description() {
                "Unknown error" => "the connection broke".to_owned(),
                // the response of another kind or version of viewer is worth reporting
                code => format!("the connection broke: {code}"),
            }
        }
        _ => "the connection broke".to_owned(),
    }
}

/// Checks that something listens at the address; otherwise the SDK would retry forever.
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
    let help = viewer_help(uri.origin.is_localhost());
    Err(SinkError::Failed(format!(
        "no viewer answers at {uri} ({reason}); start one first with `rerun`, or let --spawn start it{help}"
    )))
}

/// The result of `work`, or `None` if it takes longer than `limit`, cannot be started, or panics. After a timeout it
/// continues in the background, and its result is ignored.
pub(super) fn within<T: Send + 'static>(limit: Duration, work: impl FnOnce() -> T + Send + 'static) -> Option<T> {
    let (sender, receiver) = mpsc::sync_channel(1);
    let thread = std::thread::Builder::new().name("bounded".to_owned());
    thread
        .spawn(move || {
            if let Ok(result) = catch_unwind(AssertUnwindSafe(work)) {
                sender.send(result).ok();
            }
        })
        .ok()?;
    receiver.recv_timeout(limit).ok()
}
