//! What a union costs at most, and why there is none.

use std::{
    sync::atomic::{AtomicU64, Ordering},
    time::{Duration, Instant},
};

use thiserror::Error;

/// What a union may cost before it is given up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Budget {
    /// Steps of work, each some tens of nanoseconds and bytes: the same on every machine and for any number of threads.
    pub work: u64,
    /// Wall time. Whether it suffices depends on the machine, but what comes out within it does not.
    pub time: Option<Duration>,
}

impl Default for Budget {
    /// A hundred million steps: seconds, and at most a few gigabytes.
    fn default() -> Self {
        Budget { work: 100_000_000, time: None }
    }
}

/// Why there is no union.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum UnionError {
    /// The budget did not suffice.
    #[error("gave up after {work} steps and {elapsed:?}")]
    GaveUp {
        /// Steps done.
        work: u64,
        /// Time taken.
        elapsed: Duration,
    },
    /// The bodies are in no general position after every attempt to displace them, or arithmetic failed.
    #[error("undecided after {attempts} attempts: {reason}")]
    Undecided {
        /// How often it was tried.
        attempts: u32,
        /// What the last attempt met with.
        reason: &'static str,
    },
    /// More vertices, edges or triangles in all than a 31-bit index counts.
    #[error("more than 2^30 vertices, edges or triangles in all")]
    TooLarge,
}

/// Why an attempt came to nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Failure {
    /// A sign that decides is 0.
    Tie,
    /// What has to hold of every arrangement does not.
    Inconsistent(&'static str),
    /// The budget is used up.
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

    /// Counts `steps`; fails once there have been too many, or too much time is gone.
    #[inline]
    pub fn spend(&self, steps: u64) -> Result<(), Failure> {
        let before = self.spent.fetch_add(steps, Ordering::Relaxed);
        if before + steps > self.budget.work {
            return Err(Failure::GaveUp);
        }
        // The clock is looked at every some thousand steps.
        match self.budget.time {
            Some(time) if before >> 12 != (before + steps) >> 12 && self.start.elapsed() > time => Err(Failure::GaveUp),
            _ => Ok(()),
        }
    }

    pub fn spent(&self) -> u64 {
        self.spent.load(Ordering::Relaxed)
    }

    pub fn gave_up(&self) -> UnionError {
        UnionError::GaveUp { work: self.spent(), elapsed: self.start.elapsed() }
    }
}
