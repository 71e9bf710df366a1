//! Ctrl-C and termination requests.

use std::{
    sync::atomic::{AtomicBool, Ordering},
    time::{Duration, Instant},
};

use super::{Failure, say};
use crate::atomic;

/// Interrupts within this interval count as one: `timeout`, `cargo run` and others signal both a program and its
/// process group.
const SAME_INTERRUPT: Duration = Duration::from_secs(1);
/// Exit status of an interrupted program, as shells report it.
pub const STATUS: u8 = 130;

/// Set by Ctrl-C or a termination request; the run then finishes cleanly.
pub static STOP: AtomicBool = AtomicBool::new(false);

/// After an interrupt before the first step, the run has this long to save its initial state.
const PATIENCE: Duration = Duration::from_millis(1500);
/// Whether there is anything to save besides the initial state.
pub static HAS_STEPPED: AtomicBool = AtomicBool::new(false);

/// Ends the program soon after an interrupt that comes before the first step: building and recording the initial state
/// of a large scene may take minutes, and nothing would be lost.
pub fn end_before_first_step() -> Result<(), Failure> {
    let wait = || {
        while !STOP.load(Ordering::Relaxed) {
            std::thread::sleep(Duration::from_millis(100));
            if HAS_STEPPED.load(Ordering::Relaxed) {
                return;
            }
        }
        std::thread::sleep(PATIENCE);
        if !HAS_STEPPED.load(Ordering::Relaxed) {
            say("error: interrupted before the first step; nothing is saved");
            atomic::exit(STATUS.into());
        }
    };
    let started = std::thread::Builder::new().name("first step".to_owned()).spawn(wait);
    started.map(drop).map_err(|error| Failure::Run(format!("cannot start a thread: {error}")))
}

/// The user is told of a program that is still ending after this time: the reader of a pipe may have stopped reading.
const LONG: Duration = Duration::from_secs(2);

/// Installs a handler: the first interrupt sets [`STOP`], a second one ends the program at once.
pub fn raise_stop() -> Result<(), Failure> {
    let mut first: Option<Instant> = None;
    listen(move || match first {
        None => {
            first = Some(Instant::now());
            STOP.store(true, Ordering::Relaxed);
            let explain = || {
                std::thread::sleep(LONG);
                say("note: still ending; press Ctrl-C again to end at once");
            };
            std::thread::Builder::new().name("still ending".to_owned()).spawn(explain).ok();
        }
        Some(first) if first.elapsed() < SAME_INTERRUPT => {}
        Some(_) => std::process::exit(STATUS.into()),
    })
}

/// Installs a handler: the first interrupt removes unfinished files and ends the program.
pub fn end() -> Result<(), Failure> {
    listen(|| {
        say("error: interrupted");
        atomic::exit(STATUS.into())
    })
}

/// Lets a write beyond the limit on the size of files (`ulimit -f`) fail, as on a full disk, instead of ending the program; for the
/// whole process.
pub fn survive_limit_on_files() {
    #[cfg(unix)]
    signal_hook::flag::register(signal_hook::consts::SIGXFSZ, std::sync::Arc::default()).ok();
}

/// Ends the program with the exit status of an interrupt.
pub fn exit() -> ! {
    std::process::exit(STATUS.into())
}

fn listen(handler: impl FnMut() + Send + 'static) -> Result<(), Failure> {
    ctrlc::set_handler(handler).map_err(|error| Failure::Run(format!("cannot listen for Ctrl-C: {error}")))
}
