//! The history of a run's messages, which every viewer reads from the beginning.
//!
//! The SDK's own proxy passes new messages to all readers through one channel, so one stalled reader blocks all others.
//! Here every reader has its own position in a shared log: a slow reader costs one integer, not memory.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex};
use std::task::Poll;

use hyper::body::Bytes;
use re_protos::external::prost::Message as _;
use re_protos::log_msg::v1alpha1 as proto;
use re_protos::sdk_comms::v1alpha1::ReadMessagesResponse;
use tokio::sync::watch;

use super::follow::{Parts, follow};
use crate::lock;
use crate::sdk::{Compression, LogMsg, StoreKind, ToTransport as _};
use crate::stream::sinks::live::LogSink;

/// Approximate overhead per message [bytes].
const ENTRY: u64 = 96;

/// Creates a history of at most `limit` bytes, with its only writer.
pub(super) fn history(limit: u64) -> (Feed, History) {
    let log = Arc::new(Log(Mutex::new(Entries { limit, ..Entries::default() })));
    let (news, readers) = watch::channel(());
    (Feed { log: Arc::clone(&log), news, failure: Mutex::new(None) }, History { log, news: readers })
}

/// The writer. Readers reach their end when it is dropped.
pub(super) struct Feed {
    log: Arc<Log>,
    news: watch::Sender<()>,
    failure: Mutex<Option<String>>,
}

impl LogSink for Feed {
    fn send(&self, msg: LogMsg) {
        match encode(&msg) {
            Ok((frame, keep)) => {
                lock(&self.log.0).push(frame, keep);
                self.news.send(()).ok();
            }
            Err(reason) => *lock(&self.failure) = Some(reason),
        }
    }

    fn flush(&self) -> Result<(), String> {
        if let Some(reason) = &*lock(&self.failure) {
            return Err(format!("a message cannot be encoded: {reason}"));
        }
        if self.news.is_closed() { Err("it crashed".to_owned()) } else { Ok(()) }
    }
}

/// The reading side. When the last copy is dropped, the feed reports that the server has stopped.
#[derive(Clone)]
pub(super) struct History {
    log: Arc<Log>,
    news: watch::Receiver<()>,
}

impl History {
    /// Everything kept as gRPC frames, in order, and then new messages.
    pub fn read(&self) -> Parts {
        let (log, mut next) = (Arc::clone(&self.log), 0);
        follow(self.news.clone(), move || match lock(&log.0).from(next) {
            Some((number, frame)) => {
                next = number + 1;
                Poll::Ready(Some(frame))
            }
            None => Poll::Pending,
        })
    }

    /// The stored messages. Holding them does not count as a reader: the feed fails without a [`History`].
    pub fn log(&self) -> Arc<Log> {
        Arc::clone(&self.log)
    }
}

/// The stored messages, behind a lock.
pub(super) struct Log(Mutex<Entries>);

impl Log {
    /// Whether messages have been discarded, so that a viewer that connects now misses the beginning.
    pub fn is_forgetting(&self) -> bool {
        lock(&self.0).is_forgetting
    }
}

/// Retention of a message: temporal data is discarded first, then static data.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Keep {
    /// Store infos and blueprints: nothing can be displayed without them.
    Always,
    Static,
    Temporal,
}

#[derive(Default)]
struct Entries {
    /// Frames by sequence number; numbers are never reused.
    frames: BTreeMap<u64, Bytes>,
    next: u64,
    /// Total size of the stored messages [bytes].
    bytes: u64,
    /// Upper limit on `bytes`.
    limit: u64,
    temporal: VecDeque<u64>,
    statics: VecDeque<u64>,
    is_forgetting: bool,
}

impl Entries {
    fn push(&mut self, frame: Bytes, keep: Keep) {
        self.bytes += frame.len() as u64 + ENTRY;
        match keep {
            Keep::Always => {}
            Keep::Static => self.statics.push_back(self.next),
            Keep::Temporal => self.temporal.push_back(self.next),
        }
        self.frames.insert(self.next, frame);
        self.next += 1;
        while self.bytes > self.limit {
            let Some(oldest) = self.temporal.pop_front().or_else(|| self.statics.pop_front()) else { return };
            self.bytes -= self.frames.remove(&oldest).map_or(0, |frame| frame.len() as u64 + ENTRY);
            self.is_forgetting = true;
        }
    }

    /// The first message with sequence number `number` or later.
    fn from(&self, number: u64) -> Option<(u64, Bytes)> {
        self.frames.range(number..).next().map(|(number, frame)| (*number, frame.clone()))
    }
}

/// Encodes a message as readers receive it: a gRPC frame, which is a flag byte, a length, and a `ReadMessagesResponse`.
fn encode(msg: &LogMsg) -> Result<(Bytes, Keep), String> {
    let is_blueprint = msg.store_id().kind() == StoreKind::Blueprint;
    let msg = msg.to_transport(Compression::LZ4).map_err(|err| err.to_string())?;
    let keep = match &msg {
        proto::log_msg::Msg::ArrowMsg(arrow) if !is_blueprint => {
            if arrow.is_static == Some(true) {
                Keep::Static
            } else {
                Keep::Temporal
            }
        }
        _ => Keep::Always,
    };
    let response = ReadMessagesResponse { log_msg: Some(proto::LogMsg { msg: Some(msg) }) };
    let length = u32::try_from(response.encoded_len()).map_err(|_| "it is larger than 4 GiB".to_owned())?;
    let mut frame = Vec::with_capacity(5 + length as usize);
    frame.push(0);
    frame.extend_from_slice(&length.to_be_bytes());
    response.encode(&mut frame).map_err(|err| err.to_string())?;
    Ok((frame.into(), keep))
}

#[cfg(test)]
mod tests {
    use std::task::Context;

    use super::*;

    #[test]
    fn temporal_data_is_discarded_first_and_blueprints_never() {
        let mut entries = Entries { limit: 10 * (100 + ENTRY), ..Entries::default() };
        let frame = Bytes::from(vec![0; 100]);
        entries.push(frame.clone(), Keep::Always);
        entries.push(frame.clone(), Keep::Static);
        for _ in 0..8 {
            entries.push(frame.clone(), Keep::Temporal);
        }
        assert!(!entries.is_forgetting);
        entries.push(frame.clone(), Keep::Temporal);
        assert!(entries.is_forgetting);
        let numbers = |entries: &Entries| entries.frames.keys().copied().collect::<Vec<u64>>();
        assert_eq!(numbers(&entries), [0, 1, 3, 4, 5, 6, 7, 8, 9, 10]);
        for _ in 0..20 {
            entries.push(frame.clone(), Keep::Always);
        }
        // the limit applies to discardable messages; the others are few per recording
        assert_eq!(numbers(&entries)[..2], [0, 11]);
        assert_eq!(entries.bytes, 21 * (100 + ENTRY));
        assert_eq!(entries.from(1).map(|(number, _)| number), Some(11));
        assert!(entries.from(31).is_none());
    }

    #[test]
    fn independent_readers_receive_the_same_messages() {
        let (feed, history) = history(1 << 20);
        let mut context = Context::from_waker(std::task::Waker::noop());
        let (mut early, mut numbers) = (history.read(), Vec::new());
        assert!(early.as_mut().poll_next(&mut context).is_pending());
        for i in 0..5_u8 {
            lock(&feed.log.0).push(Bytes::from(vec![i]), Keep::Temporal);
            feed.news.send(()).expect("there are readers");
        }
        let mut late = history.read();
        drop(feed);
        while let Poll::Ready(Some(frame)) = early.as_mut().poll_next(&mut context) {
            numbers.push(frame[0]);
        }
        assert_eq!(numbers, [0, 1, 2, 3, 4]);
        assert!(matches!(early.as_mut().poll_next(&mut context), Poll::Ready(None)));
        for i in 0..5_u8 {
            assert!(matches!(late.as_mut().poll_next(&mut context), Poll::Ready(Some(frame)) if frame[0] == i));
        }
        assert!(matches!(late.as_mut().poll_next(&mut context), Poll::Ready(None)));
    }

    #[test]
    fn a_feed_fails_without_a_server() {
        let (feed, history) = history(1 << 20);
        assert!(feed.flush().is_ok());
        let _reader_of_a_connection = history.log();
        drop(history);
        assert!(feed.flush().is_err());
    }
}
