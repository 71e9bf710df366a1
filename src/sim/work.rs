//! Limits the work of a step. Work is counted, never timed, so that a run that would take forever ends at the same step
//! on every machine, with any number of threads and under any load.
//!
//! A unit is about the force of a sphere on a vertex. Every step has an allowance; work beyond it accumulates as debt,
//! and too much debt ends the run. Bodies are stepped in parallel, but counted in order: the run ends at the first body
//! whose work, together with that of the bodies before it, is too much. The bodies before it are always completed, so
//! that it is the same body in every run.

use std::{
    cell::Cell,
    sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering},
};

/// What a run may owe [units].
const MOST_OWED: u64 = 600_000_000;
/// What every step may take, …
const FREE: u64 = 500_000;
/// … what it may take for each vertex of the scene that takes steps, …
const FREE_PER_VERTEX: u64 = 100;
/// … and what it may take of [`StepStatistics::base`](super::integrator::exponential::StepStatistics::base), twice over, but no more than this.
const MOST_BASE: u64 = 300_000_000;
/// Work is told to others when it has come to so much.
const GRAIN: u64 = 1 << 15;
/// A body that has done no more has nothing to tell.
const LITTLE: u64 = 1 << 10;

/// An evaluation of the distance of two centres.
pub(super) const LOOK_AT_PATHS: u64 = 80;
/// A change of phase: to be found, kept, looked up and recorded.
pub(super) const EVENT: u64 = 2000;
/// Two bodies whose fat bounds may overlap.
pub(super) const NEAR_ENOUGH: u64 = 8;
/// A pair that is not known yet: to be found, and kept.
pub(super) const NEW_PAIR: u64 = 600;

/// The work of a step.
#[derive(Default)]
pub(super) struct Work {
    /// What the steps so far took beyond what they may.
    owed: u64,
    /// [`StepStatistics::base`](super::integrator::exponential::StepStatistics::base) of the last step, or what it may be in the first.
    base: u64,
    /// What this one may take.
    limit: u64,
    /// What it took so far: a little less than that where it is done side by side.
    total: AtomicU64,
    /// What it took before bodies were stepped.
    before: u64,
    /// No more than each body took so far, in the order of their turns.
    of_each: Vec<AtomicU64>,
    /// From this turn on it is too much.
    last_turn: AtomicUsize,
    /// Raised to end the run.
    interrupt: Option<&'static AtomicBool>,
}

/// Why a step is not taken to its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Stop {
    Interrupted,
    Overworked,
}

impl Work {
    /// Before the first step.
    pub fn new(interrupt: Option<&'static AtomicBool>) -> Work {
        Work { interrupt, limit: u64::MAX, ..Work::default() }
    }

    /// For what takes no more than `limit`.
    pub fn limited(limit: u64, interrupt: Option<&'static AtomicBool>) -> Work {
        Work { limit, ..Work::new(interrupt) }
    }

    /// What the first step may be expected to take.
    pub fn expect(&mut self, base: u64) {
        self.base = base;
    }

    /// A step of a scene of so many vertices begins.
    pub fn begin(&mut self, vertices: u64) {
        self.limit = MOST_OWED.saturating_sub(self.owed).saturating_add(self.free(vertices));
        self.total = AtomicU64::new(0);
        self.before = 0;
    }

    /// So many bodies are about to be stepped.
    pub fn begin_turns(&mut self, count: usize) {
        self.before = *self.total.get_mut();
        self.last_turn = AtomicUsize::new(usize::MAX);
        self.of_each.truncate(count);
        self.of_each.iter_mut().for_each(|of_one| *of_one.get_mut() = 0);
        self.of_each.resize_with(count, AtomicU64::default);
    }

    /// Bodies came to this together, of which `base` was to be expected for `vertices`.
    pub fn end(&mut self, work: u64, base: u64, vertices: u64) {
        self.base = base;
        let free = self.free(vertices);
        self.owed = self.owed.saturating_add(self.before.saturating_add(work)).saturating_sub(free);
    }

    /// What a step may take of which so many vertices are part, without owing anything.
    fn free(&self, vertices: u64) -> u64 {
        let of_base = self.base.saturating_mul(2).min(MOST_BASE);
        FREE.saturating_add(of_base).saturating_add(FREE_PER_VERTEX.saturating_mul(vertices))
    }

    /// Whether the step can go on.
    pub fn check(&self) -> Result<(), Stop> {
        match () {
            () if self.is_interrupted() => Err(Stop::Interrupted),
            () if self.total.load(Ordering::Relaxed) > self.limit => Err(Stop::Overworked),
            () => Ok(()),
        }
    }

    /// Whether somebody wants the run to end.
    pub fn is_interrupted(&self) -> bool {
        self.interrupt.is_some_and(|flag| flag.load(Ordering::Relaxed))
    }

    /// The turn of the body with the most work of those that took theirs before it was too much, given what all came to
    /// and what each did; `None` if it was not.
    pub fn busiest(&self, all: u64, of_each: impl Iterator<Item = u64>) -> Option<usize> {
        let mut left = self.limit.saturating_sub(self.before);
        if all <= left {
            return None;
        }
        let mut busiest = (0, 0);
        for (turn, work) in of_each.enumerate() {
            let own = work.min(left.saturating_add(1)); // it may have gone on for a while
            if own > busiest.1 {
                busiest = (turn, own);
            }
            if work > left {
                break;
            }
            left -= work;
        }
        Some(busiest.0)
    }
}

/// The work of one body, or of something that is done before bodies are stepped.
pub struct Tally<'a> {
    work: Option<&'a Work>,
    turn: Option<usize>,
    done: Cell<u64>,
    told: Cell<u64>,
    is_over: Cell<bool>,
    is_aside: bool,
}

impl Tally<'static> {
    /// Work without a limit.
    pub fn unlimited() -> Tally<'static> {
        Tally {
            work: None,
            turn: None,
            done: Cell::new(0),
            told: Cell::new(0),
            is_over: Cell::new(false),
            is_aside: false,
        }
    }
}

impl<'a> Tally<'a> {
    /// Work that is counted for another, who tells of it afterwards; it ends when somebody wants the run to end, or with
    /// more than a whole step may take.
    pub(super) fn aside(work: Option<&'a Work>) -> Tally<'a> {
        let mut aside = Tally::unlimited();
        (aside.work, aside.is_aside) = (work, true);
        aside
    }

    /// What all count for.
    pub(super) fn common(&self) -> Option<&'a Work> {
        self.work
    }

    /// Work of a step, in turn `turn` of the bodies, or before them.
    pub(super) fn new(work: &'a Work, turn: Option<usize>) -> Tally<'a> {
        let is_too_much = turn.is_some_and(|turn| turn > work.last_turn.load(Ordering::Relaxed));
        let is_over = Cell::new(is_too_much || work.is_interrupted());
        Tally { work: Some(work), turn, done: Cell::new(0), told: Cell::new(0), is_over, is_aside: false }
    }

    /// Counts what is about to be done, and whether to do it: if not, the step is of no use any more.
    #[inline]
    pub fn spend(&self, units: u64) -> bool {
        let done = self.done.get().saturating_add(units);
        self.done.set(done);
        if done - self.told.get() >= GRAIN {
            self.tell();
        }
        !self.is_over.get()
    }

    /// Whether the step is of no use any more.
    #[inline]
    pub fn is_over(&self) -> bool {
        self.is_over.get()
    }

    /// What was done.
    pub fn done(&self) -> u64 {
        self.done.get()
    }

    #[cold]
    fn tell(&self) {
        let Some(work) = self.work else { return };
        let done = self.done.get();
        let news = done - self.told.replace(done);
        if self.is_aside {
            self.is_over.set(done > work.limit || work.is_interrupted());
            return;
        }
        let total = work.total.fetch_add(news, Ordering::Relaxed).saturating_add(news);
        let is_too_much = match self.turn {
            None => total > work.limit,
            Some(turn) => {
                work.of_each[turn].store(done, Ordering::Relaxed);
                if total > work.limit {
                    let before = work.of_each[..turn].iter().map(|of_one| of_one.load(Ordering::Relaxed));
                    if before.fold(work.before.saturating_add(done), u64::saturating_add) > work.limit {
                        work.last_turn.fetch_min(turn, Ordering::Relaxed);
                    }
                }
                turn >= work.last_turn.load(Ordering::Relaxed)
            }
        };
        if is_too_much || work.is_interrupted() {
            self.is_over.set(true);
        }
    }
}

impl Drop for Tally<'_> {
    fn drop(&mut self) {
        // few are worth the others' attention, and none of those before bodies are stepped may be lost
        if self.turn.is_none() || self.done.get() - self.told.get() >= LITTLE {
            self.tell();
        }
    }
}
