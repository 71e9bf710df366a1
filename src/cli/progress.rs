//! The progress of long-running work, on standard error: on a terminal, a line that is rewritten from the first
//! second on; elsewhere, a line every ten seconds.

use std::{
    path::{Path, PathBuf},
    sync::{
        Arc, Condvar, Mutex, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};

use indicatif::{ProgressBar, ProgressStyle};

use super::{is_quiet, say};
use crate::lock;
use crate::text::{bytes, significant, thousands};

/// Work is reported on a terminal once it takes this long.
const FIRST: Duration = Duration::from_secs(1);
/// The interval between lines on a terminal, and elsewhere.
const REWRITTEN: Duration = Duration::from_millis(200);
const PRINTED: Duration = Duration::from_secs(10);
/// A unit of work that takes longer than this is reported with its duration instead of a rate.
const LONG_UNIT: Duration = Duration::from_secs(3);

/// How the amount of work is counted.
#[derive(Clone, Copy)]
pub enum Work {
    /// Not at all: only the time is shown.
    Uncounted,
    /// In units with this name, such as steps; the total number, if known.
    Units(&'static str, Option<u64>),
    /// As a share of the whole, in thousandths.
    Share,
}

impl Work {
    fn total(self) -> Option<u64> {
        match self {
            Work::Uncounted => None,
            Work::Units(_, total) => total,
            Work::Share => Some(1000),
        }
    }
}

/// Reports the progress of one piece of work until it is dropped.
pub struct Progress {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

struct Shared {
    /// Hidden if standard error is not a terminal.
    bar: ProgressBar,
    work: Work,
    done: AtomicU64,
    /// Simulated time [s], as bits.
    time: AtomicU64,
    text: Mutex<Text>,
    changed: Condvar,
}

struct Text {
    what: String,
    /// The file that the work writes.
    file: Option<PathBuf>,
    has_ended: bool,
}

impl Progress {
    /// Starts to report; `what` names the work, and may be empty if its unit does.
    pub fn new(what: impl Into<String>, work: Work) -> Progress {
        if is_quiet() {
            return Progress::hidden();
        }
        let bar = match work.total() {
            Some(total) => ProgressBar::new(total),
            None => ProgressBar::new_spinner(),
        };
        let template = if work.total().is_some() { "{bar:20} {wide_msg}" } else { "{wide_msg}" };
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style);
        }
        let text = Mutex::new(Text { what: what.into(), file: None, has_ended: false });
        let (done, time, changed) = (AtomicU64::new(0), AtomicU64::new(f64::NAN.to_bits()), Condvar::new());
        let shared = Arc::new(Shared { bar, work, done, time, text, changed });
        let to_report = Arc::clone(&shared);
        // without a thread there are no reports, but the work is the same
        let thread = std::thread::Builder::new().name("progress".to_owned()).spawn(move || to_report.report());
        Progress { shared, thread: thread.ok() }
    }

    /// Reports nothing.
    pub fn hidden() -> Progress {
        let text = Mutex::new(Text { what: String::new(), file: None, has_ended: true });
        let (done, time, changed) = (AtomicU64::new(0), AtomicU64::new(0), Condvar::new());
        let shared = Shared { bar: ProgressBar::hidden(), work: Work::Uncounted, done, time, text, changed };
        Progress { shared: Arc::new(shared), thread: None }
    }

    /// Also shows the size of the file that the work writes.
    pub fn with_file(self, file: &Path) -> Progress {
        lock(&self.shared.text).file = Some(file.to_owned());
        self
    }

    /// Names what is being done now.
    pub fn stage(&self, what: impl Into<String>) {
        lock(&self.shared.text).what = what.into();
    }

    /// Sets the amount of work that is done.
    pub fn set(&self, done: u64) {
        self.shared.done.store(done, Ordering::Relaxed);
    }

    /// Sets the share of the work that is done.
    pub fn set_share(&self, share: f64) {
        self.set((1000.0 * share) as u64);
    }

    pub fn add(&self, more: u64) {
        self.shared.done.fetch_add(more, Ordering::Relaxed);
    }

    /// Sets the number of steps that are done, and the simulated time [s].
    pub fn step(&self, steps: u64, time: f64) {
        self.set(steps);
        self.shared.time.store(time.to_bits(), Ordering::Relaxed);
    }

    /// Lets `print` write lines that the report does not overwrite.
    pub fn suspend(&self, print: impl FnOnce()) {
        self.shared.bar.suspend(print);
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        lock(&self.shared.text).has_ended = true;
        self.shared.changed.notify_all();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
        self.shared.bar.finish_and_clear();
    }
}

impl Shared {
    /// Reports until the work has ended.
    fn report(&self) {
        let mut changed = (Instant::now(), 0);
        let mut next = Instant::now() + if self.bar.is_hidden() { PRINTED } else { FIRST };
        let mut text = lock(&self.text);
        loop {
            let wait = next.saturating_duration_since(Instant::now()).min(REWRITTEN);
            // checked before waiting too: short work has ended before this thread starts
            let waited = self.changed.wait_timeout_while(text, wait, |text| !text.has_ended);
            text = waited.unwrap_or_else(PoisonError::into_inner).0;
            if text.has_ended {
                return;
            }
            let now = Instant::now();
            let done = self.done.load(Ordering::Relaxed);
            if done != changed.1 {
                changed = (now, done);
            }
            if now < next {
                continue;
            }
            self.bar.set_position(done);
            let pace = Pace { done, elapsed: self.bar.elapsed(), idle: now - changed.0, rate: self.bar.per_sec() };
            let size = text.file.as_deref().and_then(written);
            let time = Some(f64::from_bits(self.time.load(Ordering::Relaxed))).filter(|time| time.is_finite());
            let line = line(&text.what, self.work, time, size, &pace);
            if self.bar.is_hidden() {
                say(&line);
                next = now + PRINTED;
            } else {
                self.bar.set_message(line);
                next = now + REWRITTEN;
            }
        }
    }
}

/// The size of a file that is being written, under its own or its temporary name.
fn written(file: &Path) -> Option<u64> {
    let mut partial = file.as_os_str().to_owned();
    partial.push(".partial");
    let found = std::fs::metadata(partial).or_else(|_| std::fs::metadata(file));
    found.ok().map(|found| found.len()).filter(|&size| size > 0)
}

/// How far some work is, and how fast.
struct Pace {
    done: u64,
    /// Time since the start.
    elapsed: Duration,
    /// Time since the amount changed.
    idle: Duration,
    /// Units per second of late; 0 if not known.
    rate: f64,
}

fn line(what: &str, work: Work, time: Option<f64>, size: Option<u64>, pace: &Pace) -> String {
    let Pace { done, elapsed, idle, rate } = *pace;
    let mut parts = Vec::new();
    match work {
        Work::Uncounted => parts.push(span(elapsed.as_secs_f64())),
        Work::Share => parts.push(format!("{} %", done / 10)),
        Work::Units(unit, Some(total)) => parts.push(format!("{unit} {} of {}", thousands(done), thousands(total))),
        Work::Units(unit, None) => parts.push(format!("{unit} {}", thousands(done))),
    }
    parts.extend(time.map(|time| format!("t = {time:.3} s")));
    if let Work::Units(unit, _) = work {
        if idle >= LONG_UNIT {
            parts.push(format!("{} in this {unit}", span(idle.as_secs_f64())));
        } else if rate > 0.0 {
            parts.push(format!("{} {unit}s/s", significant(rate)));
        }
    }
    // a share grows in few and unequal parts, so that the last ones say little about the rest; and a rate of late decays while a
    // unit takes long
    let is_mean = matches!(work, Work::Share) || idle >= LONG_UNIT;
    let rate = if is_mean { done as f64 / elapsed.as_secs_f64() } else { rate };
    if let Some(total) = work.total().filter(|_| rate > 0.0) {
        parts.push(format!("{} left", span(total.saturating_sub(done) as f64 / rate)));
    }
    parts.extend(size.map(bytes));
    let separator = if what.is_empty() { "" } else { ": " };
    format!("{what}{separator}{}", parts.join(", "))
}

/// A duration in readable form.
fn span(seconds: f64) -> String {
    let whole = seconds.round() as u64;
    match whole {
        0..60 => format!("{whole} s"),
        60..3600 => format!("{} min {:02} s", whole / 60, whole % 60),
        3600..360_000 => format!("{} h {:02} min", whole / 3600, whole / 60 % 60),
        _ => format!("{} days", thousands(whole / 86_400)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pace(done: u64, elapsed: u64, idle: u64, rate: f64) -> Pace {
        Pace { done, elapsed: Duration::from_secs(elapsed), idle: Duration::from_secs(idle), rate }
    }

    #[test]
    fn steps_are_reported_with_their_rate() {
        let steps = Work::Units("step", Some(6000));
        let changing = pace(130, 4, 0, 100.0);
        let of_steps = line("", steps, Some(2.1667), Some(12 << 20), &changing);
        assert_eq!(of_steps, "step 130 of 6,000, t = 2.167 s, 100 steps/s, 59 s left, 12.0 MiB");
        let endless = line("", Work::Units("step", None), Some(0.5), None, &changing);
        assert_eq!(endless, "step 130, t = 0.500 s, 100 steps/s");
    }

    #[test]
    fn a_long_step_is_reported_with_its_duration() {
        let slow = pace(1, 75, 55, 2e-5);
        let line = line("", Work::Units("step", Some(3)), None, None, &slow);
        assert_eq!(line, "step 1 of 3, 55 s in this step, 2 min 30 s left");
        assert_eq!(
            super::line("", Work::Units("step", Some(3)), None, None, &pace(0, 9, 9, 0.0)),
            "step 0 of 3, 9 s in this step"
        );
    }

    #[test]
    fn work_without_units_is_reported_by_share_or_time() {
        assert_eq!(
            line("measuring two", Work::Share, None, None, &pace(400, 2, 0, 0.0)),
            "measuring two: 40 %, 3 s left"
        );
        // a part that takes long among some that do not
        let uneven = pace(160, 64, 4, 0.03);
        assert_eq!(line("bodies", Work::Share, None, None, &uneven), "bodies: 16 %, 5 min 36 s left");
        assert_eq!(
            line("building bodies", Work::Uncounted, None, None, &pace(0, 4000, 4000, 0.0)),
            "building bodies: 1 h 06 min"
        );
    }
}
