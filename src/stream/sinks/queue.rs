//! The queue between a run and the thread that serves one destination: bounded in bytes, in order.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::hash::{DefaultHasher, Hash as _, Hasher as _};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use rerun::SizeBytes as _;
use rerun::log::LogMsg;

use super::SinkError;

/// Messages from this size on are left out first when a viewer cannot keep up [bytes]. Below it are events, phases and
/// scalars, which cost little and are what a viewer's user looks for: one of them takes some 2 kB.
const BULKY: u64 = 8 * 1024;
/// What a column takes beside its values: its description and the vectors' own sizes [bytes].
const COLUMN: u64 = 512;

/// A message on its way, with what the queues need to know about it.
#[derive(Clone)]
pub(super) struct Parcel {
    pub msg: LogMsg,
    /// Size in memory [bytes].
    bytes: u64,
    /// What a later message replaces it in: same recording, entity and columns. `None`: it is needed whatever follows.
    stream: Option<u64>,
}

impl Parcel {
    pub fn new(msg: LogMsg) -> Parcel {
        Parcel { bytes: size_of(&msg), stream: stream_of(&msg), msg }
    }
}

/// Size in memory [bytes], as if nothing else held the same data: a message may be shared by several queues, but each has
/// to count on keeping it longest. (The SDK's own figure is divided by the number of owners.)
fn size_of(msg: &LogMsg) -> u64 {
    match msg {
        LogMsg::ArrowMsg(_, arrow) => {
            arrow.batch.columns().iter().map(|column| COLUMN + column.as_ref().heap_size_bytes()).sum()
        }
        other => other.total_size_bytes(),
    }
}

/// The stream that `msg` belongs to, or `None` for what is sent only once: store infos, blueprints, static data.
fn stream_of(msg: &LogMsg) -> Option<u64> {
    let LogMsg::ArrowMsg(store, arrow) = msg else { return None };
    if store.kind() == rerun::StoreKind::Blueprint {
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

/// What is waiting, and what of it could be left out without changing what a viewer shows at the end.
///
/// A value that does not change is not sent again, so whatever is dropped must have a successor: then the picture at
/// the end is the true one, and only the way there is coarser.
#[derive(Default)]
struct Backlog {
    /// By number in order of arrival.
    waiting: BTreeMap<u64, Parcel>,
    /// Of what is waiting [bytes].
    bytes: u64,
    /// Number of the next message; numbers are never reused.
    next: u64,
    /// The newest message of each stream, waiting or delivered.
    newest: HashMap<u64, u64>,
    /// Messages that waited when a newer one of their stream came, large ones.
    superseded_bulky: VecDeque<u64>,
    /// The same, small ones.
    superseded_small: VecDeque<u64>,
    /// Messages left out so far.
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
            // forgets what was delivered meanwhile, so that the list does not outgrow what is waiting
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

    /// Leaves out the oldest superseded messages until at most `limit` bytes wait, or nothing else is superseded.
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

/// What happens to a message when the queue is full.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum WhenFull {
    /// The run waits: nothing is ever lost.
    Wait,
    /// Superseded messages are left out; if that is not enough the destination is given up. The run never waits.
    Thin,
    /// The run waits as long as something is delivered within this time, then messages are left out until it is again.
    WaitThenThin(Duration),
}

/// A queue for one sender and one thread that serves a destination.
///
/// Bound: `limit` bytes wait or are in hand, or one larger message; if messages may be left out twice that, where those
/// that may not take so much.
pub(super) struct Queue {
    /// The destination, as messages call it.
    name: String,
    limit: u64,
    when_full: WhenFull,
    state: Mutex<State>,
    changed: Condvar,
}

struct State {
    backlog: Backlog,
    /// What the thread has taken and not yet reported as delivered [bytes].
    in_hand: u64,
    /// Messages delivered.
    delivered: u64,
    /// When something was last delivered.
    progress: Instant,
    /// What was delivered when it was last waited for in vain.
    stalled_at: Option<u64>,
    /// A flush is wanted up to this number (not including it), and was done up to that one.
    flush_to: u64,
    flushed: u64,
    /// Nothing more will be sent.
    closed: bool,
    /// The thread may take down what it holds.
    released: bool,
    /// The thread has ended.
    ended: bool,
    failure: Option<SinkError>,
}

/// What a thread gets to do.
#[derive(Default)]
pub(super) struct Batch {
    /// To deliver, in order.
    pub messages: Vec<LogMsg>,
    /// Someone waits for everything up to here to be flushed.
    pub flush: bool,
    /// Nothing more will come.
    pub last: bool,
    bytes: u64,
    /// Number of the first message after this batch.
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

    /// A thread that panicked while it held the lock left the state as it was between two statements of this file:
    /// counters may be off by a message, which is no reason to bring the run down.
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn wait<'a>(&self, state: MutexGuard<'a, State>) -> MutexGuard<'a, State> {
        self.changed.wait(state).unwrap_or_else(PoisonError::into_inner)
    }

    fn wait_for<'a>(&self, state: MutexGuard<'a, State>, timeout: Duration) -> MutexGuard<'a, State> {
        self.changed.wait_timeout(state, timeout).unwrap_or_else(PoisonError::into_inner).0
    }

    // ---- the sender's side ----

    /// Adds a message; `Err` is why the destination takes no more.
    pub fn send(&self, mut parcel: Parcel) -> Result<(), SinkError> {
        if self.when_full == WhenFull::Wait {
            // nothing is left out, so nobody needs to know what replaces what
            parcel.stream = None;
        }
        let patience = match self.when_full {
            WhenFull::Wait => Duration::MAX,
            WhenFull::WaitThenThin(patience) => patience,
            WhenFull::Thin => Duration::ZERO,
        };
        let mut state = self.lock();
        let started = Instant::now();
        while state.is_full(self.limit, parcel.bytes) && state.failure.is_none() && !state.is_stalled() {
            let idle = state.progress.max(started).elapsed();
            if idle >= patience {
                state.stalled_at = Some(state.delivered);
                break;
            }
            // no longer at once than every system can count
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

    /// Waits until everything sent so far is delivered and flushed; `Err` is why it cannot be.
    pub fn flush(&self) -> Result<(), SinkError> {
        let mut state = self.lock();
        let upto = state.backlog.next;
        state.flush_to = upto;
        self.changed.notify_all();
        while state.flushed < upto && state.failure.is_none() && !state.ended {
            state = self.wait(state);
        }
        state.failure.clone().map_or(Ok(()), Err)
    }

    /// Nothing more will be sent.
    pub fn close(&self) {
        self.lock().closed = true;
        self.changed.notify_all();
    }

    /// Nothing more will be sent, and what the thread holds may be taken down.
    pub fn release(&self) {
        let mut state = self.lock();
        state.closed = true;
        state.released = true;
        drop(state);
        self.changed.notify_all();
    }

    /// Waits until the thread has ended; `false` if it made no progress for `patience`.
    pub fn wait_ended(&self, patience: Duration) -> bool {
        self.wait_until(patience, |state| state.ended)
    }

    /// Waits until everything sent is delivered or the thread has ended; `false` if there was no progress for `patience`.
    pub fn wait_drained(&self, patience: Duration) -> bool {
        self.wait_until(patience, |state| state.ended || (state.backlog.waiting.is_empty() && state.in_hand == 0))
    }

    fn wait_until(&self, patience: Duration, is_done: impl Fn(&State) -> bool) -> bool {
        let started = Instant::now();
        let mut state = self.lock();
        while !is_done(&state) {
            // what happened before somebody waited for it is no reason to lose patience
            let idle = state.progress.max(started).elapsed();
            let Some(left) = patience.checked_sub(idle).filter(|left| !left.is_zero()) else { return false };
            state = self.wait_for(state, left);
        }
        true
    }

    /// The destination, as messages call it.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Messages delivered so far.
    pub fn delivered(&self) -> u64 {
        self.lock().delivered
    }

    /// Messages left out so far.
    pub fn left_out(&self) -> u64 {
        self.lock().backlog.left_out
    }

    /// Messages not delivered yet.
    pub fn waiting(&self) -> u64 {
        self.lock().backlog.waiting.len() as u64
    }

    /// Why the destination takes no more, if it does not.
    pub fn failure(&self) -> Option<SinkError> {
        self.lock().failure.clone()
    }

    // ---- the thread's side ----

    /// The next messages, at most `most`: waits for one, but at most for `idle`.
    pub fn take(&self, most: usize, idle: Option<Duration>) -> Batch {
        let started = Instant::now();
        let mut state = self.lock();
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
        // half the limit, so that the run can go on filling the queue meanwhile
        while batch.messages.len() < most && (batch.messages.is_empty() || batch.bytes < self.limit / 2) {
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

    /// The batch was delivered, and flushed as well if `is_flushed`.
    pub fn done(&self, batch: &Batch, delivered: usize, is_flushed: bool) {
        let mut state = self.lock();
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

    /// Waits until what the thread holds may be taken down.
    pub fn wait_released(&self) {
        let mut state = self.lock();
        while !state.released {
            state = self.wait(state);
        }
    }

    /// The destination takes no more: it went away.
    pub fn gone(&self, reason: String) {
        let mut state = self.lock();
        let failure = SinkError::Gone { name: self.name.clone(), messages: state.delivered, reason };
        state.fail(failure);
        drop(state);
        self.changed.notify_all();
    }

    /// The destination takes no more.
    pub fn fail(&self, failure: SinkError) {
        self.lock().fail(failure);
        self.changed.notify_all();
    }

    /// To be held by the thread: says when it has ended, panic or not.
    pub fn attend(&self) -> Attendance<'_> {
        Attendance(self)
    }
}

impl State {
    /// Whether `bytes` more are too much. One message always has room, whatever its size.
    fn is_full(&self, limit: u64, bytes: u64) -> bool {
        let held = self.backlog.bytes + self.in_hand;
        held > 0 && held + bytes > limit
    }

    /// Whether nothing was delivered since it was waited for in vain.
    fn is_stalled(&self) -> bool {
        self.stalled_at == Some(self.delivered)
    }

    fn fail(&mut self, failure: SinkError) {
        // the first failure is the cause of the others
        self.failure.get_or_insert(failure);
        self.backlog.clear();
    }
}

/// See [`Queue::attend`].
pub(super) struct Attendance<'a>(&'a Queue);

impl Drop for Attendance<'_> {
    fn drop(&mut self) {
        let mut state = self.0.lock();
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

    use rerun::external::re_log_types::{SetStoreInfo, StoreInfo, StoreSource};
    use rerun::log::{Chunk, RowId};
    use rerun::{StoreId, StoreKind, TimePoint, Timeline};

    use super::*;

    const SMALL: u64 = 100;

    fn store(kind: StoreKind) -> StoreId {
        StoreId::new(kind, "queue_test", "one")
    }

    /// A message that is known by `name`, of a size and stream of choice.
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
    fn what_a_newer_message_replaces_is_left_out_oldest_and_largest_first() {
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
    fn small_messages_go_if_large_ones_do_not_suffice() {
        let queue = queue(1_000, WhenFull::Thin);
        for i in 0..50 {
            queue.send(parcel(&i.to_string(), SMALL, Some(1))).expect("room");
        }
        assert_eq!(names(&drain(&queue)), ["40", "41", "42", "43", "44", "45", "46", "47", "48", "49"]);
        assert_eq!(queue.left_out(), 40);
    }

    #[test]
    fn a_destination_is_given_up_when_even_the_newest_values_are_too_many() {
        let queue = queue(1_000, WhenFull::Thin);
        let refused = (0..50).find_map(|i| queue.send(parcel("value", SMALL, Some(i))).err().map(|err| (i, err)));
        let (at, err) = refused.expect("twice the limit is the end");
        assert_eq!(at, 20);
        assert!(matches!(err, SinkError::Gone { messages: 0, .. }), "{err}");
        // and stays so, holding nothing
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
                let (mut received, mut most) = (Vec::new(), 0);
                loop {
                    let mut batch = queue.take(3, None);
                    let state = queue.lock();
                    most = most.max(state.backlog.bytes + state.in_hand);
                    drop(state);
                    queue.done(&batch, batch.messages.len(), batch.flush);
                    received.append(&mut batch.messages);
                    if batch.last {
                        return (received, most);
                    }
                }
            }
        });
        for i in 0..1_000 {
            // the same stream: here that is no reason to leave anything out
            queue.send(parcel(&i.to_string(), SMALL, Some(1))).expect("a thread that works");
        }
        queue.flush().expect("a thread that works");
        assert_eq!(queue.waiting(), 0);
        // larger than the limit: goes through alone
        queue.send(parcel("large", 5_000, None)).expect("a thread that works");
        queue.close();
        assert!(queue.wait_ended(Duration::from_secs(10)));
        let (received, most) = thread.join().expect("the thread does not panic");
        assert_eq!(received.len(), 1_001);
        assert_eq!(names(&received[..3]), ["0", "1", "2"]);
        assert_eq!(names(&received[999..]), ["999", "large"]);
        assert!(most <= 5_000, "{most} bytes were held");
    }

    #[test]
    fn a_server_that_stands_still_is_waited_for_once() {
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
    fn a_thread_that_panics_is_a_failure_and_not_a_hang() {
        let queue = Arc::new(queue(1_000, WhenFull::Wait));
        let thread = std::thread::spawn({
            let queue = Arc::clone(&queue);
            move || {
                let _attendance = queue.attend();
                panic!("on purpose");
            }
        });
        let refused = (0..100).find_map(|_| queue.send(parcel("value", SMALL, None)).err());
        assert!(refused.expect("nothing is taken").to_string().contains("panicked"));
        assert!(queue.flush().is_err());
        assert!(thread.join().is_err());
    }

    #[test]
    fn patience_ends_where_progress_does() {
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

    /// A message with points at `entity`, in `kind` of store.
    fn points(kind: StoreKind, entity: &str, time: impl Into<TimePoint>, points: rerun::Points3D) -> Parcel {
        let chunk = Chunk::builder(entity).with_archetype_auto_row(time, &points).build().expect("a valid chunk");
        Parcel::new(LogMsg::ArrowMsg(store(kind), chunk.to_arrow_msg().expect("a chunk encodes")))
    }

    #[test]
    fn a_message_replaces_those_of_the_same_entity_and_columns() {
        use StoreKind::{Blueprint, Recording};
        let at = |step: i64| [(Timeline::new_sequence("step"), step)];
        let some = || rerun::Points3D::new([[1.0, 2.0, 3.0]]);
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
    fn a_message_counts_in_full_however_many_hold_it() {
        let many = vec![[1.0, 2.0, 3.0]; 1_000];
        let one = points(StoreKind::Recording, "a", TimePoint::STATIC, rerun::Points3D::new(many));
        let others = vec![one.msg.clone(); 10];
        assert!((13_000..15_000).contains(&one.bytes), "{}", one.bytes);
        assert_eq!(Parcel::new(others[0].clone()).bytes, one.bytes);
    }
}
