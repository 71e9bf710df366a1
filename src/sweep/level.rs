//! The runs of a level: selects the missing ones, and runs them on all cores.

use std::{
    collections::{BTreeMap, HashSet},
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
};

use rayon::prelude::*;

use super::{
    Sweep,
    refine::{self, Given, Known},
    row::Row,
    run::Runner,
    store::{Journal, Shard, Store, StoreError},
};
use crate::lock;

/// Rows per file. Files are written one at a time, so this limits the memory for rows.
const BLOCK: u64 = 4096;

/// The rows of a level, in order.
#[derive(Clone, Debug)]
pub enum Plan {
    /// All rows below this number.
    First(u64),
    /// The listed rows.
    List(Vec<u64>),
}

impl Plan {
    /// Number of rows.
    pub fn len(&self) -> u64 {
        match self {
            Plan::First(count) => *count,
            Plan::List(rows) => rows.len() as u64,
        }
    }

    /// Whether there is nothing to do.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    fn row(&self, index: u64) -> u64 {
        match self {
            Plan::First(_) => index,
            Plan::List(rows) => rows[index as usize],
        }
    }

    /// Number of rows of a shard.
    pub fn row_count(&self, shard: Shard) -> u64 {
        (self.len() + shard.count - 1 - shard.index) / shard.count
    }

    /// Rows of a block of a shard.
    fn block(&self, shard: Shard, block: u64) -> Vec<u64> {
        let indices = block * BLOCK..((block + 1) * BLOCK).min(self.row_count(shard));
        indices.map(|index| self.row(shard.index + shard.count * index)).collect()
    }
}

/// How a level ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ended {
    /// All rows of the shard are done.
    Complete,
    /// It was interrupted; finished rows are kept.
    Interrupted,
}

/// Why a level could not be completed.
#[derive(Debug, thiserror::Error)]
pub enum LevelError {
    /// The folder cannot be read or written.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A previous level is not complete.
    #[error(
        "level {level} is not complete: {missing} of its {planned} rows are missing; run all its shards before those of the next \
         level, with the same --refine"
    )]
    Incomplete {
        /// The level.
        level: u32,
        /// Number of its rows.
        planned: u64,
        /// Number of missing rows.
        missing: u64,
    },
}

/// Runs a shard of a level. Calls `progress` with the number of existing rows, and with 1 after each new row.
///
/// # Errors
/// The folder cannot be read or written; rows already written are kept.
pub fn run(
    runner: &Runner<'_>,
    store: &Store,
    (level, plan, shard): (u32, &Plan, Shard),
    stop: &AtomicBool,
    progress: &(dyn Fn(u64) + Sync),
) -> Result<Ended, StoreError> {
    let done = store.blocks(level, shard)?;
    let blocks = plan.row_count(shard).div_ceil(BLOCK);
    if (0..blocks).all(|block| done.contains(&block)) {
        store.clean(level, shard)?; // a process killed just before this point left its files behind
        progress(plan.row_count(shard));
        return Ok(Ended::Complete);
    }
    let mut kept = store.journals(level, shard)?;
    // rows that are finished, from a division into another number of shards
    let mut elsewhere = HashSet::new();
    store.read(level..level + 1, Some(shard), &store.named(&[]), |(row, _)| _ = elsewhere.insert(row))?;
    let mut journal = store.journal(level, shard)?;
    for block in 0..blocks {
        let wanted = plan.block(shard, block);
        if done.contains(&block) {
            progress(wanted.len() as u64);
            continue;
        }
        let mut rows: Vec<Row> = wanted.iter().filter_map(|row| kept.remove(row)).collect();
        let present: HashSet<u64> = rows.iter().map(|(row, _)| *row).collect();
        let missing: Vec<u64> =
            wanted.iter().copied().filter(|row| !present.contains(row) && !elsewhere.contains(row)).collect();
        progress((wanted.len() - missing.len()) as u64);
        match run_rows(runner, &missing, &mut journal, stop, progress)? {
            Some(new) => rows.extend(new),
            None => return Ok(Ended::Interrupted),
        }
        rows.sort_unstable_by_key(|(row, _)| *row);
        if !rows.is_empty() {
            store.write_block(level, shard, block, &rows)?;
        }
        journal.clear()?;
    }
    drop(journal);
    store.clean(level, shard)?;
    Ok(Ended::Complete)
}

/// Runs some rows; `None` if interrupted.
fn run_rows(
    runner: &Runner<'_>,
    missing: &[u64],
    journal: &mut Journal,
    stop: &AtomicBool,
    progress: &(dyn Fn(u64) + Sync),
) -> Result<Option<Vec<Row>>, StoreError> {
    let shared: Mutex<(Vec<Row>, &mut Journal, Option<StoreError>)> = Mutex::new((Vec::new(), journal, None));
    missing.par_iter().with_max_len(1).for_each(|&row| {
        let has_failed = || lock(&shared).2.is_some();
        if stop.load(Ordering::Relaxed) || has_failed() {
            return;
        }
        let Ok(row) = runner.row(row) else { return };
        let mut shared = lock(&shared);
        let (rows, journal, failure) = &mut *shared;
        match journal.add(&row) {
            Ok(()) => rows.push(row),
            Err(error) => *failure = failure.take().or(Some(error)),
        }
        progress(1);
    });
    let (rows, _, failure) = shared.into_inner().unwrap_or_else(PoisonError::into_inner);
    match failure {
        Some(error) => Err(error),
        None => Ok((rows.len() == missing.len()).then_some(rows)),
    }
}

/// The results of the rows of a level.
///
/// # Errors
/// The rows cannot be read.
pub fn given(store: &Store, sweep: &Sweep, level: u32) -> Result<BTreeMap<u64, Given>, StoreError> {
    let mut given = BTreeMap::new();
    let columns = store.named(&refine::columns(sweep));
    store.read(level..level + 1, None, &columns, |(row, cells)| _ = given.insert(row, Given::new(sweep, &cells)))?;
    Ok(given)
}

/// The rows of a level, computed from those of the previous levels.
///
/// # Errors
/// The previous levels are not complete, or cannot be read.
pub fn plan(store: &Store, sweep: &Sweep, known: &mut Known<'_>, level: u32) -> Result<Plan, LevelError> {
    let mut plan = Plan::First(known.design().count().unwrap_or(0));
    for before in 0..level {
        if plan.is_empty() {
            break;
        }
        let results = given(store, sweep, before)?;
        let missing = (0..plan.len()).filter(|&index| !results.contains_key(&plan.row(index))).count() as u64;
        if missing > 0 {
            return Err(LevelError::Incomplete { level: before, planned: plan.len(), missing });
        }
        known.add(results);
        plan = Plan::List(known.wanted());
    }
    Ok(plan)
}
