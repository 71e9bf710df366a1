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

/// Installs a handler: the first interrupt sets [`STOP`], a second one ends the program at once.
pub fn raise_stop() -> Result<(), Failure> {
    let mut first: Option<Instant> = None;
    listen(move || match first {
        None => {
            first = Some(Instant::now());
            STOP.store(true, Ordering::Relaxed);
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

/// Ends the program with the exit status of an interrupt.
pub fn exit() -> ! {
    std::process::exit(STATUS.into())
}

fn listen(handler: impl FnMut() + Send + 'static) -> Result<(), Failure> {
    ctrlc::set_handler(handler).map_err(|error| Failure::Run(format!("cannot listen for Ctrl-C: {error}")))
}
