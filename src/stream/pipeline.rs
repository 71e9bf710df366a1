//! Recording on a separate thread: the simulation only copies the data to be recorded, and continues.
//!
//! The data is passed in a small pool of packets of several frames each. When all packets are full, the simulation
//! waits, so that files are complete and memory is bounded. It never waits for a viewer: viewers are behind the queue
//! of each [sink](super::sinks).

use std::{
    mem::{replace, take},
    sync::{
        Arc, Mutex,
        mpsc::{Receiver, RecvTimeoutError, Sender, channel},
    },
    thread::JoinHandle,
    time::{Duration, Instant as Clock},
};

use super::{
    Recorder, Settings,
    blueprint::Tab,
    chunks::Audience,
    parts::merged::Ahead,
    sinks::{SinkError, Sinks},
    step::{StepRecord, StepWatch},
};
use crate::lock;
use crate::observe::{Frame, Simulation, StageFrame, StepSummary, SurfaceEvent};
use crate::sdk::LogMsg;

/// Number of packets: in transit, or being filled.
const PACKETS: usize = 4;
/// A packet is full with this many frames.
const FRAMES: usize = 16;
/// If the simulation waits for the recording thread longer than this, packets hold one frame each, so that few frames
/// are in transit when the run is interrupted.
const SLOW: Duration = Duration::from_millis(100);
/// A packet is full with this many steps.
const STEPS: usize = 4096;
/// A packet is full with this many bytes.
const BYTES: usize = 8 << 20;
/// A packet is handed over after this time, even if it is not full.
const AGE: Duration = Duration::from_millis(10);
/// Upper limit on the time until recorded data is sent to viewers.
const LIVE_INTERVAL: Duration = Duration::from_millis(30);
/// Upper limit on the time until recorded data is sent to files. Each chunk costs some 0.3 million instructions besides
/// those for its values.
const FILE_INTERVAL: Duration = Duration::from_millis(400);

/// Viewers of a shorter run get the layout of its end, too: users cannot have rearranged it yet.
const UNTOUCHED: Duration = Duration::from_secs(3);

/// The simulation's side of the pipeline.
pub struct Pipeline {
    settings: Settings,
    /// Until the end.
    watch: Option<StepWatch>,
    packet: Packet,
    /// Current number of frames in a full packet.
    max_frames: usize,
    handed_over: Clock,
    /// Time spent waiting since the last step.
    waiting: Duration,
    /// Findings about surfaces since the last [`Pipeline::surface_events`].
    surfaces: Vec<SurfaceEvent>,
    /// Why nothing more can be recorded, if so.
    refused: Option<String>,
    full: Option<Sender<Packet>>,
    empty: Receiver<Packet>,
    shared: Arc<Mutex<Shared>>,
    tab: Tab,
    started: Clock,
    thread: Option<JoinHandle<Recording>>,
}

/// A complete recording, whose destinations are still open.
pub struct PipelineEnd {
    /// The recorder, finished.
    pub recorder: Recorder,
    /// The destinations, which have all messages.
    pub sinks: Sinks,
    /// Notes for the user since the last [`Pipeline::notes`].
    pub notes: Vec<String>,
    /// Why recording failed, if it did: the first reason.
    pub failure: Option<String>,
}

/// State shared with the recording thread.
#[derive(Default)]
struct Shared {
    notes: Vec<String>,
    failure: Option<String>,
}

/// Several steps and their recorded frames.
#[derive(Default)]
struct Packet {
    /// The first `steps_used` are filled; the others are kept for reuse.
    steps: Vec<StepRecord>,
    steps_used: usize,
    /// The first `used` are filled; the others are kept for reuse.
    frames: Vec<Frame>,
    used: usize,
    bytes: usize,
}

impl Packet {
    fn frames(&self) -> &[Frame] {
        &self.frames[..self.used]
    }
}

impl Pipeline {
    /// Starts to record the simulation from its current state, to the sinks. Viewers open on `tab`.
    ///
    /// # Errors
    /// The first messages cannot be sent, or the thread cannot be started.
    pub fn start(
        simulation: &dyn Simulation,
        mut recorder: Recorder,
        mut sinks: Sinks,
        tab: Tab,
    ) -> Result<Pipeline, SinkError> {
        let [is_live, _] = sinks.are_live_and_recorded();
        // first what a replay needs, because the run may be killed at any moment
        let mut first = if is_live { recorder.take() } else { recorder.take_full() };
        let rest = first.split_off(Recorder::HEAD.min(first.len()));
        first.into_iter().try_for_each(|message| sinks.send(message))?;
        let layout = recorder.blueprint(simulation, tab);
        if !is_live {
            sinks.flush()?;
        }
        layout.into_iter().chain(rest).try_for_each(|message| sinks.send(message))?;
        let (full, filled) = channel();
        let (emptied, empty) = channel();
        for _ in 1..PACKETS {
            emptied.send(Packet::default()).ok();
        }
        let shared = Arc::new(Mutex::new(Shared::default()));
        let settings = recorder.settings().clone();
        let thread = std::thread::Builder::new().name("recorder".to_owned()).spawn({
            let shared = Arc::clone(&shared);
            move || Recording::new(recorder, sinks, shared).run(&filled, &emptied)
        });
        let thread = thread
            .map_err(|error| SinkError::Thread { target: "the recording".to_owned(), reason: error.to_string() })?;
        Ok(Pipeline {
            watch: Some(StepWatch::new(simulation, &settings)),
            settings,
            packet: Packet::default(),
            max_frames: FRAMES,
            handed_over: Clock::now(),
            waiting: Duration::ZERO,
            surfaces: Vec::new(),
            refused: None,
            full: Some(full),
            empty,
            shared,
            tab,
            started: Clock::now(),
            thread: Some(thread),
        })
    }

    /// Observes the simulation after a step, whose summary it wrote; `lag` is its delay behind real time, if that is to be
    /// recorded. Returns whether more can be recorded; if not, [`Pipeline::finish`] says why.
    #[must_use]
    pub fn observe(&mut self, simulation: &dyn Simulation, summary: &StepSummary, lag: Option<Duration>) -> bool {
        let taken = self.take(simulation, summary, lag);
        self.allow(taken)
    }

    /// Hands over what has been observed, for a viewer that must not wait; returns as [`Pipeline::observe`] does.
    #[must_use]
    pub fn flush(&mut self) -> bool {
        let handed_over = self.hand_over();
        self.allow(handed_over)
    }

    fn allow(&mut self, done: Result<(), String>) -> bool {
        self.refused = self.refused.take().or(done.err());
        self.refused.is_none()
    }

    fn take(
        &mut self,
        simulation: &dyn Simulation,
        summary: &StepSummary,
        lag: Option<Duration>,
    ) -> Result<(), String> {
        let packet = &mut self.packet;
        let step = next_of(&mut packet.steps, &mut packet.steps_used);
        step.summary.clone_from(summary);
        let has_frame = self.settings.has_frame(simulation.steps_taken());
        let mut frame = has_frame.then(|| next_of(&mut packet.frames, &mut packet.used));
        if let Some(watch) = &mut self.watch
            && let Err(reason) = watch.step(simulation, &self.settings, step, frame.as_deref_mut())
        {
            // what breaks the contract is not recorded
            packet.steps_used -= 1;
            packet.used -= usize::from(has_frame);
            return Err(reason);
        }
        self.surfaces.extend_from_slice(&step.surfaces);
        (step.waiting, step.lag) = (take(&mut self.waiting), lag);
        let memory = |stage: &StageFrame| stage.frame.memory();
        packet.bytes += frame.map_or(0, |frame| frame.memory()) + step.stages.iter().map(memory).sum::<usize>();
        let is_old = step.end.is_some_and(|end| end - self.handed_over >= AGE);
        if packet.used >= self.max_frames || packet.steps_used >= STEPS || packet.bytes >= BYTES || is_old {
            return self.hand_over();
        }
        Ok(())
    }

    /// Hands over the current packet; waits if too many are in transit.
    fn hand_over(&mut self) -> Result<(), String> {
        if self.packet.steps_used == 0 {
            return Ok(());
        }
        let start = Clock::now();
        let next = self.empty.recv();
        self.handed_over = Clock::now();
        let waited = self.handed_over - start;
        self.max_frames = if waited > SLOW { 1 } else { FRAMES };
        self.waiting += waited;
        let packet = replace(&mut self.packet, next.unwrap_or_default());
        match self.full.as_ref().map(|full| full.send(packet)) {
            Some(Ok(())) => Ok(()),
            _ => Err(lock(&self.shared).failure.clone().unwrap_or_else(broken)),
        }
    }

    /// Findings about the surfaces of pairs since the last call.
    pub fn surface_events(&mut self) -> Vec<SurfaceEvent> {
        take(&mut self.surfaces)
    }

    /// Notes for the user since the last call.
    pub fn notes(&self) -> Vec<String> {
        take(&mut lock(&self.shared).notes)
    }

    /// Waits until everything observed is recorded, and ends the recording, with the
    /// [cause](crate::observe::Run::cause) if the run failed: sends the remaining messages, and to files and viewers of
    /// short runs the changes of their layout.
    ///
    /// # Errors
    /// The recording thread has panicked.
    pub fn finish(mut self, simulation: &dyn Simulation, cause: Option<&str>) -> Result<PipelineEnd, String> {
        let handed_over = self.hand_over();
        self.full = None;
        let Some(Ok(Recording { mut recorder, mut sinks, is_live, is_recorded, .. })) =
            self.thread.take().map(JoinHandle::join)
        else {
            return Err(broken());
        };
        self.watch.take().into_iter().for_each(|watch| recorder.watched_by(watch));
        if let Some(cause) = cause {
            recorder.fail(cause);
        }
        recorder.finish();
        let mut unsent = if is_live { show(&mut recorder, &mut sinks, is_recorded) } else { None };
        if is_recorded {
            unsent = unsent.or(send_to(Audience::Files, &mut sinks, recorder.take()));
        }
        let is_short = self.started.elapsed() < UNTOUCHED;
        if is_recorded || is_short {
            let audience = if is_short { Audience::All } else { Audience::Files };
            let layout = recorder.measured_layout(simulation, self.tab);
            unsent = unsent.or(send_to(audience, &mut sinks, layout));
        }
        let Shared { mut notes, failure } = take(&mut *lock(&self.shared));
        notes.append(&mut sinks.notes());
        let failure = self.refused.or(failure).or(handed_over.err()).or(unsent);
        Ok(PipelineEnd { recorder, sinks, notes, failure })
    }
}

/// The next element to be filled.
fn next_of<'a, T: Default>(all: &'a mut Vec<T>, used: &mut usize) -> &'a mut T {
    if *used == all.len() {
        all.push(T::default());
    }
    *used += 1;
    &mut all[*used - 1]
}

fn broken() -> String {
    "the recording thread has ended; this is a bug, please report it".to_owned()
}

/// The recording thread's side of the pipeline.
struct Recording {
    recorder: Recorder,
    sinks: Sinks,
    is_live: bool,
    is_recorded: bool,
    shared: Arc<Mutex<Shared>>,
    /// When everything was last sent to viewers.
    shown: Clock,
    /// When everything was last sent to files.
    saved: Clock,
}

impl Recording {
    fn new(recorder: Recorder, sinks: Sinks, shared: Arc<Mutex<Shared>>) -> Recording {
        let [is_live, is_recorded] = sinks.are_live_and_recorded();
        let now = Clock::now();
        Recording { recorder, sinks, is_live, is_recorded, shared, shown: now, saved: now }
    }

    fn run(mut self, filled: &Receiver<Packet>, emptied: &Sender<Packet>) -> Recording {
        let interval = if self.is_live { LIVE_INTERVAL } else { FILE_INTERVAL };
        let mut lookahead = self.recorder.lookahead();
        let mut next: Option<(Packet, Ahead)> = None;
        loop {
            let packet = match next.take() {
                Some(next) => Ok(next),
                None => filled.recv_timeout(interval).map(|packet| {
                    let foreseen = self.recorder.foresee([&[], packet.frames()]);
                    let ahead = lookahead.compute(packet.frames(), &foreseen, || {});
                    (packet, ahead)
                }),
            };
            let is_last = matches!(packet, Err(RecvTimeoutError::Disconnected));
            if let Ok((mut packet, ahead)) = packet {
                self.recorder.expect(ahead);
                // the surfaces of the next packet are computed while this one is recorded
                let following = filled.try_recv().unwrap_or_default();
                let foreseen = self.recorder.foresee([packet.frames(), following.frames()]);
                let ahead = lookahead.compute(following.frames(), &foreseen, || self.record(&mut packet));
                next = (following.steps_used > 0).then_some((following, ahead));
                emptied.send(packet).ok(); // the receiver is gone after the last step
            }
            let start = Clock::now();
            let failure = self.send();
            self.recorder.messages_sent(start.elapsed());
            let has_failed = failure.is_some();
            let mut shared = lock(&self.shared);
            shared.notes.append(&mut self.sinks.notes());
            shared.failure = failure;
            drop(shared);
            if is_last || has_failed {
                return self;
            }
        }
    }

    /// Sends the data that is due: everything to viewers, full chunks to files.
    fn send(&mut self) -> Option<String> {
        let mut failure = None;
        if self.is_live && self.shown.elapsed() >= LIVE_INTERVAL {
            self.shown = Clock::now();
            failure = show(&mut self.recorder, &mut self.sinks, self.is_recorded);
        }
        if self.is_recorded && failure.is_none() {
            let is_due = self.saved.elapsed() >= FILE_INTERVAL;
            if self.is_live && (is_due || self.recorder.has_full()) {
                // data sent to the file is no longer available for viewers
                failure = show(&mut self.recorder, &mut self.sinks, true);
            }
            let messages = if is_due { self.recorder.take() } else { self.recorder.take_full() };
            if is_due {
                self.saved = Clock::now();
            }
            let audience = if self.is_live { Audience::Files } else { Audience::All };
            failure = failure.or(send_to(audience, &mut self.sinks, messages));
        }
        failure
    }

    fn record(&mut self, packet: &mut Packet) {
        let mut frames = packet.frames[..packet.used].iter();
        for step in &mut packet.steps[..packet.steps_used] {
            let has_frame = self.recorder.settings().has_frame(step.summary.at.step);
            self.recorder.record(step, if has_frame { frames.next() } else { None });
            step.stages.clear(); // stages are large
        }
        (packet.steps_used, packet.used, packet.bytes) = (0, 0, 0);
    }
}

/// Sends the data that viewers have not received. Files get the same, except for tracks, which they get in larger
/// chunks.
fn show(recorder: &mut Recorder, sinks: &mut Sinks, is_recorded: bool) -> Option<String> {
    if !is_recorded {
        return send(sinks, recorder.take());
    }
    all_sent(recorder.show().into_iter().map(|(audience, message)| sinks.send_to(audience, message)))
}

/// Sends messages; returns the reason if a required destination fails.
pub fn send(sinks: &mut Sinks, messages: impl IntoIterator<Item = LogMsg>) -> Option<String> {
    send_to(Audience::All, sinks, messages)
}

fn send_to(audience: Audience, sinks: &mut Sinks, messages: impl IntoIterator<Item = LogMsg>) -> Option<String> {
    all_sent(messages.into_iter().map(|message| sinks.send_to(audience, message)))
}

/// The reason why the first message that could not be sent failed; the others are sent, for other destinations.
fn all_sent(sent: impl Iterator<Item = Result<(), SinkError>>) -> Option<String> {
    sent.fold(Ok(()), Result::and).err().map(|error| error.to_string())
}
