//! Limits the work of a step. Work is counted, never timed, so that a run that would take forever ends at the same step
//! on every machine, with any number of threads and under any load.
//!
//! A unit is about one evaluation of the force of a sphere on a vertex. Every step has an allowance; work beyond it
//! accumulates as debt, and too much debt ends the run. Bodies are stepped in parallel, but counted in order: the run
//! ends at the first body whose work, together with that of the bodies before it, exceeds the limit. The bodies before
//! it are always completed, so that it is the same body in every run.

use std::{
    cell::Cell,
    sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering},
};

use crate::interrupt::is_raised;

/// Debt that ends a run [units].
const MAX_DEBT: u64 = 600_000_000;
/// Debt that is announced [units].
const ANNOUNCED_DEBT: u64 = MAX_DEBT / 10;
/// Constant part of the allowance of a step [units].
const FREE: u64 = 500_000;
/// Part of the allowance of a step per stepped vertex [units].
const FREE_PER_VERTEX: u64 = 100;
/// Largest part of the allowance of a step for twice the [base](super::integrator::exponential::StepStatistics::base) of
/// the last one [units].
const MAX_BASE: u64 = 1_000_000_000;
/// A tally is added to the total each time it has grown by this much [units].
const GRAIN: u64 = 1 << 15;
/// A final remainder smaller than this is not added while other bodies run [units].
const MIN_REPORTED: u64 = 1 << 10;

/// Cost of evaluating the distance of two centres [units].
pub(super) const DISTANCE: u64 = 80;
/// Cost of finding, storing and recording a change of phase [units].
pub(super) const EVENT: u64 = 2000;
/// Cost of testing two bodies whose fat bounds may overlap [units].
pub(super) const NEAR_ENOUGH: u64 = 8;
/// Cost of finding and storing a new pair [units].
pub(super) const NEW_PAIR: u64 = 600;

/// The work of a step.
#[derive(Default)]
pub(crate) struct Work {
    /// Debt: work of the steps so far beyond their allowances.
    debt: u64,
    /// [Base](super::integrator::exponential::StepStatistics::base) of the last step; before the first, an estimate.
    base: u64,
    /// Number of vertices of the scene.
    vertices: u64,
    /// Limit of this step.
    limit: u64,
    /// Work of this step so far. Tallies of running bodies are added in grains, so it lags slightly.
    total: AtomicU64,
    /// Work of this step before bodies were stepped.
    before: u64,
    /// Lower bound of each body's work so far, by turn.
    by_turn: Vec<AtomicU64>,
    /// The first turn known to exceed the limit.
    last_turn: AtomicUsize,
    /// Whether the debt was announced.
    is_announced: bool,
    /// Set to end the run.
    interrupt: Option<&'static AtomicBool>,
}

impl Clone for Work {
    /// Between two steps: the counters of a step start from zero.
    fn clone(&self) -> Work {
        let Work { debt, base, vertices, limit, is_announced, interrupt, .. } = *self;
        Work { debt, base, vertices, limit, is_announced, interrupt, ..Work::default() }
    }
}

/// Why a step is not completed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Stop {
    Interrupted,
    Overworked,
}

/// Work that may be done to find the states within a step again [units].
pub const MAX_WITHIN: u64 = 100_000_000;

impl Work {
    /// Before the first step of a scene of `vertices`.
    pub fn new(vertices: u64, interrupt: Option<&'static AtomicBool>) -> Work {
        Work { vertices, interrupt, limit: u64::MAX, ..Work::default() }
    }

    /// Continues after the steps of another scene.
    pub fn resume(&mut self, before: &mut Work) {
        *self = Work { vertices: self.vertices, ..std::mem::take(before) };
    }

    /// Continues with another number of vertices.
    pub fn set_vertices(&mut self, vertices: u64) {
        self.vertices = vertices;
    }

    /// A single task of at most `limit` [units].
    pub fn limited(limit: u64, interrupt: Option<&'static AtomicBool>) -> Work {
        Work { limit, ..Work::new(0, interrupt) }
    }

    /// Sets the expected base of the first step.
    pub fn expect(&mut self, base: u64) {
        self.base = base;
    }

    /// Begins a step.
    pub fn begin(&mut self) {
        self.limit = MAX_DEBT.saturating_sub(self.debt).saturating_add(self.allowance(self.vertices));
        self.total = AtomicU64::new(0);
        self.before = 0;
    }

    /// Begins the turns of `count` bodies.
    pub fn begin_turns(&mut self, count: usize) {
        self.before = *self.total.get_mut();
        self.last_turn = AtomicUsize::new(usize::MAX);
        self.by_turn.truncate(count);
        self.by_turn.iter_mut().for_each(|work| *work.get_mut() = 0);
        self.by_turn.resize_with(count, AtomicU64::default);
    }

    /// Begins the turns of the bodies again that are not done; `done` is the work of the others, by turn, 0 for those.
    pub fn repeat_turns(&mut self, done: impl Iterator<Item = u64>) {
        self.last_turn = AtomicUsize::new(usize::MAX);
        let mut total = self.before;
        for (into, work) in self.by_turn.iter_mut().zip(done) {
            *into.get_mut() = work;
            total = total.saturating_add(work);
        }
        self.total = AtomicU64::new(total);
    }

    /// Work that the turns may do together [units].
    pub fn left(&self) -> u64 {
        self.limit.saturating_sub(self.before)
    }

    /// The first turn whose work exceeds the limit, together with that of the turns before it, and what these have left
    /// [units]; `None` if the limit holds.
    pub fn first_beyond(&self, by_turn: impl Iterator<Item = u64>) -> Option<(usize, u64)> {
        let mut left = self.left();
        by_turn.enumerate().find_map(|(turn, work)| {
            let before = left;
            left = left.saturating_sub(work);
            (work > before).then_some((turn, before))
        })
    }

    /// Ends a step whose bodies did `work`, of which `base` is usual for their `vertices`.
    pub fn end(&mut self, work: u64, base: u64, vertices: u64) {
        self.base = base;
        let allowance = self.allowance(vertices);
        self.debt = self.debt.saturating_add(self.before).saturating_add(work).saturating_sub(allowance);
    }

    /// Whether the debt is to be announced, which happens once.
    pub fn announce(&mut self) -> bool {
        let is_due = self.debt > ANNOUNCED_DEBT && !self.is_announced;
        self.is_announced |= is_due;
        is_due
    }

    /// The allowance of a step of `vertices`.
    fn allowance(&self, vertices: u64) -> u64 {
        let from_base = self.base.saturating_mul(2).min(MAX_BASE);
        FREE.saturating_add(from_base).saturating_add(FREE_PER_VERTEX.saturating_mul(vertices))
    }

    /// Whether the step can continue.
    pub(super) fn check(&self) -> Result<(), Stop> {
        match () {
            () if self.is_interrupted() => Err(Stop::Interrupted),
            () if self.total.load(Ordering::Relaxed) > self.limit => Err(Stop::Overworked),
            () => Ok(()),
        }
    }

    /// Whether the run was interrupted.
    pub fn is_interrupted(&self) -> bool {
        is_raised(self.interrupt)
    }

    /// The turn of the body that did the most work, among those up to the one that exceeded the limit, given the total
    /// and the work by turn; `None` if the limit holds.
    pub fn busiest(&self, all: u64, by_turn: impl Iterator<Item = u64>) -> Option<usize> {
        if all <= self.left() {
            return None;
        }
        let all: Vec<u64> = by_turn.collect();
        let (last, left) = self.first_beyond(all.iter().copied())?;
        // that one may have continued past the limit
        let counted = |turn: usize| if turn == last { left + 1 } else { all[turn] };
        (0..=last).rev().max_by_key(|&turn| counted(turn))
    }
}

/// Counts the work of one body, or of a task before bodies are stepped.
pub struct Tally<'a> {
    work: Option<&'a Work>,
    turn: Option<usize>,
    done: Cell<u64>,
    reported: Cell<u64>,
    is_over: Cell<bool>,
    /// Work that this tally may do by itself [units].
    most: u64,
}

impl Tally<'static> {
    /// Work without a limit.
    pub fn unlimited() -> Tally<'static> {
        Tally::of(None, None, u64::MAX)
    }
}

impl<'a> Tally<'a> {
    /// A tally of a step: of the body in turn `turn`, or of the work before bodies are stepped.
    pub(crate) fn new(work: &'a Work, turn: Option<usize>) -> Tally<'a> {
        Tally::of(Some(work), turn, u64::MAX)
    }

    /// A tally of the body in turn `turn` of a step, which may do at most this work [units].
    pub(super) fn limited(work: &'a Work, turn: usize, most: u64) -> Tally<'a> {
        Tally::of(Some(work), Some(turn), most)
    }

    fn of(work: Option<&'a Work>, turn: Option<usize>, most: u64) -> Tally<'a> {
        let is_beyond = |work: &Work| turn.is_some_and(|turn| turn > work.last_turn.load(Ordering::Relaxed));
        let is_over = Cell::new(work.is_some_and(|work| is_beyond(work) || work.is_interrupted()));
        Tally { work, turn, done: Cell::new(0), reported: Cell::new(0), is_over, most }
    }

    /// Counts work that is about to be done. Returns whether to do it; if false, the step is abandoned.
    #[inline]
    pub fn spend(&self, units: u64) -> bool {
        let done = self.done.get().saturating_add(units);
        self.done.set(done);
        if done > self.most {
            self.is_over.set(true);
        }
        if done - self.reported.get() >= GRAIN {
            self.report();
        }
        !self.is_over.get()
    }

    /// Whether the step is abandoned.
    #[inline]
    pub fn is_over(&self) -> bool {
        self.is_over.get()
    }

    /// Work counted so far [units].
    pub fn done(&self) -> u64 {
        self.done.get()
    }

    #[cold]
    fn report(&self) {
        let Some(work) = self.work else { return };
        let done = self.done.get();
        let new = done - self.reported.replace(done);
        let total = work.total.fetch_add(new, Ordering::Relaxed).saturating_add(new);
        let is_too_much = match self.turn {
            None => total > work.limit,
            Some(turn) => {
                work.by_turn[turn].store(done, Ordering::Relaxed);
                if total > work.limit {
                    let before = work.by_turn[..turn].iter().map(|work| work.load(Ordering::Relaxed));
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
        // a small remainder is not worth a contended write; work before the turns must all be counted
        if self.turn.is_none() || self.done.get() - self.reported.get() >= MIN_REPORTED {
            self.report();
        }
    }
}
