//! The cost limit of a union, and its errors.

use std::{
    sync::atomic::{AtomicBool, AtomicU64, Ordering},
    time::{Duration, Instant},
};

use thiserror::Error;

use crate::interrupt::is_raised;

/// The cost limit of a union, beyond which it gives up.
#[derive(Clone, Copy, Debug)]
pub struct Budget {
    /// Work steps, each 50 to 300 nanoseconds and a few tens of bytes; the count is the same on every machine and for
    /// any number of threads.
    pub work: u64,
    /// A flag that ends the union once it is set.
    pub interrupt: Option<&'static AtomicBool>,
}

impl Default for Budget {
    /// A hundred million steps: about ten seconds, and at most a few gigabytes.
    fn default() -> Self {
        Budget { work: 100_000_000, interrupt: None }
    }
}

/// Why there is no union.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum UnionError {
    /// The budget was exhausted, or the union was interrupted.
    #[error("gave up after {work} steps and {elapsed:?}")]
    GaveUp {
        /// Work steps done.
        work: u64,
        /// Time elapsed.
        elapsed: Duration,
    },
    /// No attempt brought the bodies into general position, or arithmetic failed.
    #[error("undecided after {attempts} attempts: {reason}")]
    Undecided {
        /// Number of attempts.
        attempts: u32,
        /// Why the last attempt failed.
        reason: &'static str,
    },
    /// There are more vertices, edges or triangles in total than a 31-bit index can number.
    #[error("more than 2^30 vertices, edges or triangles in all")]
    TooLarge,
}

/// Why an attempt failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Failure {
    /// A decisive sign is 0.
    Tie,
    /// An invariant of arrangements is violated.
    Inconsistent(&'static str),
    /// The budget is exhausted, or the union is interrupted.
    GaveUp,
}

/// Counts the work of a union.
pub struct Meter {
    budget: Budget,
    start: Instant,
    spent: AtomicU64,
}

impl Meter {
    pub fn new(budget: Budget) -> Meter {
        Meter { budget, start: Instant::now(), spent: AtomicU64::new(0) }
    }

    /// Counts `steps`; fails if the budget is exhausted or the union is interrupted.
    #[inline]
    pub fn spend(&self, steps: u64) -> Result<(), Failure> {
        let before = self.spent.fetch_add(steps, Ordering::Relaxed);
        if before + steps > self.budget.work {
            return Err(Failure::GaveUp);
        }
        // The flag is read only every few thousand steps.
        if before >> 12 != (before + steps) >> 12 { self.check() } else { Ok(()) }
    }

    /// Fails if the union is interrupted.
    pub fn check(&self) -> Result<(), Failure> {
        if is_raised(self.budget.interrupt) { Err(Failure::GaveUp) } else { Ok(()) }
    }

    pub fn spent(&self) -> u64 {
        self.spent.load(Ordering::Relaxed)
    }

    pub fn gave_up(&self) -> UnionError {
        UnionError::GaveUp { work: self.spent(), elapsed: self.start.elapsed() }
    }
}
