//! The queue between a run and the thread that serves one destination: FIFO, bounded in bytes.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::hash::{DefaultHasher, Hash as _, Hasher as _};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::SinkError;
use crate::lock;
use crate::sdk::{self, LogMsg, SizeBytes as _};

/// Size from which messages are dropped first when a viewer cannot keep up [bytes]. Smaller ones (about 2 kB each) are
/// events, phases and scalars, which cost little and matter most to the user.
const BULKY: u64 = 8 * 1024;
/// Overhead of a column in addition to its values: its description and the sizes of the vectors [bytes].
const COLUMN: u64 = 512;

/// A message in transit, with its size and stream.
#[derive(Clone)]
pub(super) struct Parcel {
    pub msg: LogMsg,
    /// Size in memory [bytes].
    bytes: u64,
    /// Identifies messages that replace each other: same recording, entity and columns. `None`: it must not be dropped.
    stream: Option<u64>,
}

impl Parcel {
    pub fn new(msg: LogMsg) -> Parcel {
        Parcel { bytes: size_of(&msg), stream: stream_of(&msg), msg }
    }
}

/// Size in memory [bytes], as if no other owner held the data: several queues may share a message, but each must assume
/// that it holds the message longest. (The SDK's own figure is divided by the number of owners.)
fn size_of(msg: &LogMsg) -> u64 {
    match msg {
        LogMsg::ArrowMsg(_, arrow) => {
            arrow.batch.columns().iter().map(|column| COLUMN + column.as_ref().heap_size_bytes()).sum()
        }
        other => other.total_size_bytes(),
    }
}

/// The stream to which `msg` belongs; `None` for messages that are sent only once: store infos, blueprints, static
/// data.
fn stream_of(msg: &LogMsg) -> Option<u64> {
    let LogMsg::ArrowMsg(store, arrow) = msg else { return None };
    if store.kind() == sdk::StoreKind::Blueprint {
        return None;
    }
    let schema = arrow.batch.schema_ref();
    let is_index = |kind: Option<&String>| kind.is_some_and(|kind| kind == "index");
    if !schema.fields().iter().any(|field| is_index(field.metadata().get("rerun:kind"))) {
        return None;
    }
    let mut hasher = DefaultHasher::new();
    store.hash(&mut hasher);
    schema.metadata().get("rerun:entity_path").hash(&mut hasher);
    for field in schema.fields() {
        field.name().hash(&mut hasher);
    }
    Some(hasher.finish())
}

/// The waiting messages, and which of them can be dropped without changing the final state of a viewer.
///
/// Unchanged values are not sent again, so a message can be dropped only if it has a successor. Then the final state in
/// the viewer is exact, and only the intermediate states are coarser.
#[derive(Default)]
struct Backlog {
    /// Waiting messages by sequence number.
    waiting: BTreeMap<u64, Parcel>,
    /// Total size of waiting messages [bytes].
    bytes: u64,
    /// Sequence number of the next message; never reused.
    next: u64,
    /// The newest message of each stream, waiting or delivered.
    newest: HashMap<u64, u64>,
    /// Large messages that were still waiting when a newer one of their stream arrived.
    superseded_bulky: VecDeque<u64>,
    /// Small messages that were still waiting when a newer one of their stream arrived.
    superseded_small: VecDeque<u64>,
    /// Number of messages dropped so far.
    left_out: u64,
}

impl Backlog {
    fn push(&mut self, parcel: Parcel) {
        let number = self.next;
        self.next += 1;
        self.bytes += parcel.bytes;
        if let Some(previous) = parcel.stream.and_then(|stream| self.newest.insert(stream, number))
            && let Some(superseded) = self.waiting.get(&previous)
        {
            let list = if superseded.bytes >= BULKY { &mut self.superseded_bulky } else { &mut self.superseded_small };
            // remove entries delivered in the meantime, so that the list does not outgrow the waiting messages
            while list.front().is_some_and(|number| !self.waiting.contains_key(number)) {
                list.pop_front();
            }
            list.push_back(previous);
        }
        self.waiting.insert(number, parcel);
    }

    fn pop(&mut self) -> Option<Parcel> {
        let (_, parcel) = self.waiting.pop_first()?;
        self.bytes -= parcel.bytes;
        Some(parcel)
    }

    /// Drops the oldest superseded messages until at most `limit` bytes wait, or none is superseded.
    fn thin(&mut self, limit: u64) {
        while self.bytes > limit {
            let Some(number) = self.superseded_bulky.pop_front().or_else(|| self.superseded_small.pop_front()) else {
                return;
            };
            if let Some(parcel) = self.waiting.remove(&number) {
                self.bytes -= parcel.bytes;
                self.left_out += 1;
            }
        }
    }

    fn clear(&mut self) {
        *self = Backlog { next: self.next, left_out: self.left_out, ..Backlog::default() };
    }
}

/// Policy for a full queue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum WhenFull {
    /// The run waits: no message is lost.
    Wait,
    /// Superseded messages are dropped. If that does not suffice, the destination is given up. The run never waits.
    Thin,
    /// The run waits as long as messages are delivered within this time; otherwise messages are dropped until delivery
    /// resumes.
    WaitThenThin(Duration),
}

/// A queue for one sender and one thread that serves a destination.
///
/// Memory bound: `limit` bytes waiting or in delivery, or one larger message. If messages may be dropped, twice that:
/// the messages that must not be dropped may exceed the limit.
pub(super) struct Queue {
    /// Name of the destination in messages to users.
    name: String,
    limit: u64,
    when_full: WhenFull,
    state: Mutex<State>,
    changed: Condvar,
}

struct State {
    backlog: Backlog,
    /// Messages taken by the thread and not yet reported as delivered [bytes].
    in_hand: u64,
    /// Number of messages delivered.
    delivered: u64,
    /// When a message was last delivered.
    progress: Instant,
    /// The value of `delivered` when waiting for it last timed out.
    stalled_at: Option<u64>,
    /// A flush is requested up to this sequence number (exclusive).
    flush_to: u64,
    /// Everything up to this sequence number (exclusive) has been flushed.
    flushed: u64,
    /// Whether the sender has finished.
    closed: bool,
    /// Whether the thread may drop its sink.
    released: bool,
    /// Whether the thread has ended.
    ended: bool,
    failure: Option<SinkError>,
}

/// Work for the thread.
#[derive(Default)]
pub(super) struct Batch {
    /// Messages to deliver, in order.
    pub messages: Vec<LogMsg>,
    /// Whether the sender waits for everything up to this batch to be flushed.
    pub flush: bool,
    /// Whether this is the last batch.
    pub last: bool,
    bytes: u64,
    /// Sequence number of the first message after this batch.
    upto: u64,
}

impl Queue {
    pub fn new(name: String, limit: u64, when_full: WhenFull) -> Queue {
        let state = State {
            backlog: Backlog::default(),
            in_hand: 0,
            delivered: 0,
            progress: Instant::now(),
            stalled_at: None,
            flush_to: 0,
            flushed: 0,
            closed: false,
            released: false,
            ended: false,
            failure: None,
        };
        Queue { name, limit, when_full, state: Mutex::new(state), changed: Condvar::new() }
    }

    fn wait<'a>(&self, state: MutexGuard<'a, State>) -> MutexGuard<'a, State> {
        self.changed.wait(state).unwrap_or_else(PoisonError::into_inner)
    }

    fn wait_for<'a>(&self, state: MutexGuard<'a, State>, timeout: Duration) -> MutexGuard<'a, State> {
        self.changed.wait_timeout(state, timeout).unwrap_or_else(PoisonError::into_inner).0
    }

    // ---- the sender's side ----

    /// Adds a message. `Err` tells why the destination accepts no more.
    pub fn send(&self, mut parcel: Parcel) -> Result<(), SinkError> {
        if self.when_full == WhenFull::Wait {
            // messages are never dropped, so streams are irrelevant
            parcel.stream = None;
        }
        let patience = match self.when_full {
            WhenFull::Wait => Duration::MAX,
            WhenFull::WaitThenThin(patience) => patience,
            WhenFull::Thin => Duration::ZERO,
        };
        let mut state = lock(&self.state);
        let started = Instant::now();
        while state.is_full(self.limit, parcel.bytes) && state.failure.is_none() && !state.is_stalled() {
            let idle = state.progress.max(started).elapsed();
            if idle >= patience {
                state.stalled_at = Some(state.delivered);
                break;
            }
            // some systems cannot represent longer timeouts
            state = self.wait_for(state, (patience - idle).min(Duration::from_secs(3600)));
        }
        if let Some(failure) = &state.failure {
            return Err(failure.clone());
        }
        state.backlog.push(parcel);
        if self.when_full != WhenFull::Wait {
            let left = self.limit.saturating_sub(state.in_hand);
            state.backlog.thin(left);
            if state.backlog.bytes > 2 * self.limit {
                let failure = SinkError::Gone {
                    name: self.name.clone(),
                    messages: state.delivered,
                    reason: format!("it fell more than {} MiB behind", (2 * self.limit) >> 20),
                };
                state.fail(failure.clone());
                drop(state);
                self.changed.notify_all();
                return Err(failure);
            }
        }
        drop(state);
        self.changed.notify_all();
        Ok(())
    }

    /// Waits until everything sent so far is delivered and flushed. `Err` tells why that is impossible.
    pub fn flush(&self) -> Result<(), SinkError> {
        let mut state = lock(&self.state);
        let upto = state.backlog.next;
        state.flush_to = upto;
        self.changed.notify_all();
        while state.flushed < upto && state.failure.is_none() && !state.ended {
            state = self.wait(state);
        }
        state.failure.clone().map_or(Ok(()), Err)
    }

    /// Signals that nothing more will be sent.
    pub fn close(&self) {
        lock(&self.state).closed = true;
        self.changed.notify_all();
    }

    /// Signals that nothing more will be sent, and that the thread may drop its sink.
    pub fn release(&self) {
        let mut state = lock(&self.state);
        state.closed = true;
        state.released = true;
        drop(state);
        self.changed.notify_all();
    }

    /// Waits until the thread has ended; `false` if it made no progress for `patience`.
    pub fn wait_ended(&self, patience: Duration) -> bool {
        self.wait_until(patience, |state| state.ended)
    }

    /// Waits until everything sent is delivered or the thread has ended; `false` after no progress for `patience`.
    pub fn wait_drained(&self, patience: Duration) -> bool {
        self.wait_until(patience, |state| state.ended || (state.backlog.waiting.is_empty() && state.in_hand == 0))
    }

    fn wait_until(&self, patience: Duration, is_done: impl Fn(&State) -> bool) -> bool {
        let started = Instant::now();
        let mut state = lock(&self.state);
        while !is_done(&state) {
            // the time before this call does not count towards the patience
            let idle = state.progress.max(started).elapsed();
            let Some(left) = patience.checked_sub(idle).filter(|left| !left.is_zero()) else { return false };
            state = self.wait_for(state, left);
        }
        true
    }

    /// Name of the destination in messages to users.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Number of messages dropped so far.
    pub fn left_out(&self) -> u64 {
        lock(&self.state).backlog.left_out
    }

    /// Messages not delivered yet.
    pub fn waiting(&self) -> u64 {
        lock(&self.state).backlog.waiting.len() as u64
    }

    /// Why the destination accepts no more; `None` if it does.
    pub fn failure(&self) -> Option<SinkError> {
        lock(&self.state).failure.clone()
    }

    // ---- the thread's side ----

    /// The next messages, at most `max`. Waits up to `idle` for the first one.
    pub fn take(&self, max: usize, idle: Option<Duration>) -> Batch {
        let started = Instant::now();
        let mut state = lock(&self.state);
        loop {
            let has_work = !state.backlog.waiting.is_empty() || state.closed || state.flush_to > state.flushed;
            let left = idle.map(|idle| idle.saturating_sub(started.elapsed()));
            if has_work || left.is_some_and(|left| left.is_zero()) {
                break;
            }
            state = match left {
                Some(left) => self.wait_for(state, left),
                None => self.wait(state),
            };
        }
        let mut batch = Batch::default();
        // half the limit, so that the run can continue to fill the queue meanwhile
        while batch.messages.len() < max && (batch.messages.is_empty() || batch.bytes < self.limit / 2) {
            let Some(parcel) = state.backlog.pop() else { break };
            batch.bytes += parcel.bytes;
            batch.messages.push(parcel.msg);
        }
        state.in_hand += batch.bytes;
        batch.upto = state.backlog.waiting.first_key_value().map_or(state.backlog.next, |(first, _)| *first);
        batch.flush = state.flush_to > state.flushed && batch.upto >= state.flush_to;
        batch.last = state.closed && state.backlog.waiting.is_empty();
        batch
    }

    /// Reports that the batch was delivered, and whether it was flushed.
    pub fn done(&self, batch: &Batch, delivered: usize, is_flushed: bool) {
        let mut state = lock(&self.state);
        state.in_hand -= batch.bytes.min(state.in_hand);
        state.delivered += delivered as u64;
        if delivered > 0 {
            state.progress = Instant::now();
        }
        if is_flushed {
            state.flushed = batch.upto;
        }
        drop(state);
        self.changed.notify_all();
    }

    /// Waits until the thread may drop its sink.
    pub fn wait_released(&self) {
        let mut state = lock(&self.state);
        while !state.released {
            state = self.wait(state);
        }
    }

    /// Reports that the destination has disconnected.
    pub fn gone(&self, reason: String) {
        let mut state = lock(&self.state);
        let failure = SinkError::Gone { name: self.name.clone(), messages: state.delivered, reason };
        state.fail(failure);
        drop(state);
        self.changed.notify_all();
    }

    /// Reports that the destination accepts no more.
    pub fn fail(&self, failure: SinkError) {
        lock(&self.state).fail(failure);
        self.changed.notify_all();
    }

    /// A guard held by the thread: reports the end of the thread, even after a panic.
    pub fn attend(&self) -> Attendance<'_> {
        Attendance(self)
    }
}

impl State {
    /// Whether `bytes` more would exceed the limit. One message always fits, whatever its size.
    fn is_full(&self, limit: u64, bytes: u64) -> bool {
        let held = self.backlog.bytes + self.in_hand;
        held > 0 && held + bytes > limit
    }

    /// Whether nothing was delivered since waiting last timed out.
    fn is_stalled(&self) -> bool {
        self.stalled_at == Some(self.delivered)
    }

    fn fail(&mut self, failure: SinkError) {
        // the first failure is the cause of later ones
        self.failure.get_or_insert(failure);
        self.backlog.clear();
    }
}

/// The guard returned by [`Queue::attend`].
pub(super) struct Attendance<'a>(&'a Queue);

impl Drop for Attendance<'_> {
    fn drop(&mut self) {
        let mut state = lock(&self.0.state);
        if std::thread::panicking() {
            let reason = "its thread panicked; this is a bug, please report it".to_owned();
            state.fail(SinkError::Thread { target: self.0.name.clone(), reason });
        }
        state.ended = true;
        drop(state);
        self.0.changed.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::sdk::{Chunk, RowId, SetStoreInfo, StoreId, StoreInfo, StoreKind, StoreSource, TimePoint, Timeline};

    const SMALL: u64 = 100;

    fn store(kind: StoreKind) -> StoreId {
        StoreId::new(kind, "queue_test", "one")
    }

    /// A message identified by `name`, with a given size and stream.
    fn parcel(name: &str, bytes: u64, stream: Option<u64>) -> Parcel {
        let id = StoreId::new(StoreKind::Recording, "queue_test", name);
        let info = StoreInfo::new_unversioned(id, StoreSource::Other(String::new()));
        Parcel { msg: LogMsg::SetStoreInfo(SetStoreInfo { row_id: *RowId::new(), info }), bytes, stream }
    }

    fn names(messages: &[LogMsg]) -> Vec<&str> {
        messages.iter().map(|msg| msg.store_id().recording_id().as_str()).collect()
    }

    fn queue(limit: u64, when_full: WhenFull) -> Queue {
        Queue::new("the test".to_owned(), limit, when_full)
    }

    fn drain(queue: &Queue) -> Vec<LogMsg> {
        queue.close();
        let mut all = Vec::new();
        loop {
            let mut batch = queue.take(usize::MAX, None);
            queue.done(&batch, batch.messages.len(), true);
            all.append(&mut batch.messages);
            if batch.last {
                return all;
            }
        }
    }

    #[test]
    fn superseded_messages_are_dropped_large_and_old_ones_first() {
        let queue = queue(10 * BULKY, WhenFull::Thin);
        let send = |name: &str, bytes, stream| queue.send(parcel(name, bytes, stream)).expect("room");
        send("info", 2 * BULKY, None);
        send("event 1", SMALL, Some(1));
        for i in 0..8 {
            send(&format!("mesh {i}"), 2 * BULKY, Some(2));
        }
        send("event 2", SMALL, Some(1));
        send("pose", 2 * BULKY, Some(3));
        assert_eq!(queue.left_out(), 6);
        assert_eq!(names(&drain(&queue)), ["info", "event 1", "mesh 6", "mesh 7", "event 2", "pose"]);
    }

    #[test]
    fn small_messages_are_dropped_if_large_ones_do_not_suffice() {
        let queue = queue(1_000, WhenFull::Thin);
        for i in 0..50 {
            queue.send(parcel(&i.to_string(), SMALL, Some(1))).expect("room");
        }
        assert_eq!(names(&drain(&queue)), ["40", "41", "42", "43", "44", "45", "46", "47", "48", "49"]);
        assert_eq!(queue.left_out(), 40);
    }

    #[test]
    fn a_destination_fails_if_the_newest_values_exceed_twice_the_limit() {
        let queue = queue(1_000, WhenFull::Thin);
        let failed = (0..50).find_map(|i| queue.send(parcel("value", SMALL, Some(i))).err().map(|err| (i, err)));
        let (at, err) = failed.expect("the queue fails at twice the limit");
        assert_eq!(at, 20);
        assert!(matches!(err, SinkError::Gone { messages: 0, .. }), "{err}");
        // the failure is permanent, and the queue is empty
        assert!(queue.send(parcel("value", SMALL, None)).is_err());
        assert_eq!(queue.waiting(), 0);
    }

    #[test]
    fn a_full_queue_waits_for_its_thread_and_loses_nothing() {
        let queue = Arc::new(queue(1_000, WhenFull::Wait));
        let thread = std::thread::spawn({
            let queue = Arc::clone(&queue);
            move || {
                let _attendance = queue.attend();
                let (mut received, mut max_held) = (Vec::new(), 0);
                loop {
                    let mut batch = queue.take(3, None);
                    let state = lock(&queue.state);
                    max_held = max_held.max(state.backlog.bytes + state.in_hand);
                    drop(state);
                    queue.done(&batch, batch.messages.len(), batch.flush);
                    received.append(&mut batch.messages);
                    if batch.last {
                        return (received, max_held);
                    }
                }
            }
        });
        for i in 0..1_000 {
            // the same stream, but this queue never drops messages
            queue.send(parcel(&i.to_string(), SMALL, Some(1))).expect("a thread that works");
        }
        queue.flush().expect("a thread that works");
        assert_eq!(queue.waiting(), 0);
        // larger than the limit: passes through alone
        queue.send(parcel("large", 5_000, None)).expect("a thread that works");
        queue.close();
        assert!(queue.wait_ended(Duration::from_secs(10)));
        let (received, max_held) = thread.join().expect("the thread does not panic");
        assert_eq!(received.len(), 1_001);
        assert_eq!(names(&received[..3]), ["0", "1", "2"]);
        assert_eq!(names(&received[999..]), ["999", "large"]);
        assert!(max_held <= 5_000, "{max_held} bytes were held");
    }

    #[test]
    fn a_stalled_server_is_waited_for_once() {
        let queue = queue(1_000, WhenFull::WaitThenThin(Duration::from_millis(200)));
        let started = Instant::now();
        for i in 0..100 {
            queue.send(parcel(&i.to_string(), SMALL, Some(1))).expect("room");
        }
        let elapsed = started.elapsed();
        assert!((200..2_000).contains(&elapsed.as_millis()), "{elapsed:?}");
        assert_eq!(queue.left_out(), 90);
    }

    #[test]
    fn a_panicking_thread_causes_a_failure_not_a_hang() {
        let queue = Arc::new(queue(1_000, WhenFull::Wait));
        let thread = std::thread::spawn({
            let queue = Arc::clone(&queue);
            move || {
                let _attendance = queue.attend();
                panic!("on purpose");
            }
        });
        let failed = (0..100).find_map(|_| queue.send(parcel("value", SMALL, None)).err());
        assert!(failed.expect("the queue fails").to_string().contains("panicked"));
        assert!(queue.flush().is_err());
        assert!(thread.join().is_err());
    }

    #[test]
    fn waiting_times_out_without_progress() {
        let queue = queue(1_000, WhenFull::Thin);
        queue.send(parcel("value", SMALL, None)).expect("room");
        let started = Instant::now();
        assert!(!queue.wait_drained(Duration::from_millis(100)));
        assert!(started.elapsed() >= Duration::from_millis(100));
        drain(&queue);
        assert!(queue.wait_drained(Duration::ZERO));
        drop(queue.attend());
        assert!(queue.wait_ended(Duration::ZERO));
    }

    /// A message with points at `entity`, in a store of this `kind`.
    fn points(kind: StoreKind, entity: &str, time: impl Into<TimePoint>, points: sdk::Points3D) -> Parcel {
        let chunk = Chunk::builder(entity).with_archetype_auto_row(time, &points).build().expect("a valid chunk");
        Parcel::new(LogMsg::ArrowMsg(store(kind), chunk.to_arrow_msg().expect("a chunk encodes")))
    }

    #[test]
    fn messages_of_the_same_entity_and_columns_share_a_stream() {
        use StoreKind::{Blueprint, Recording};
        let at = |step: i64| [(Timeline::new_sequence("step"), step)];
        let some = || sdk::Points3D::new([[1.0, 2.0, 3.0]]);
        let stream = |parcel: Parcel| parcel.stream;

        let first = stream(points(Recording, "a", at(0), some()));
        assert!(first.is_some());
        assert_eq!(first, stream(points(Recording, "a", at(1), some())));
        assert_ne!(first, stream(points(Recording, "b", at(1), some())));
        assert_ne!(first, stream(points(Recording, "a", at(1), some().with_radii([1.0]))));
        assert_eq!(None, stream(points(Recording, "a", TimePoint::STATIC, some())));
        assert_eq!(None, stream(points(Blueprint, "a", at(0), some())));
        assert_eq!(None, stream(parcel("info", 0, None)));
    }

    #[test]
    fn a_shared_message_counts_in_full() {
        let many = vec![[1.0, 2.0, 3.0]; 1_000];
        let one = points(StoreKind::Recording, "a", TimePoint::STATIC, sdk::Points3D::new(many));
        let others = vec![one.msg.clone(); 10];
        assert!((13_000..15_000).contains(&one.bytes), "{}", one.bytes);
        assert_eq!(Parcel::new(others[0].clone()).bytes, one.bytes);
    }
}
