//! A ranking of pairs by how soon they change phase if q goes on changing as it does, after those that just have.

use std::collections::BTreeMap;

use super::{
    FrameView,
    ranking::{self, Mark, Ranking, Row},
};
use crate::{
    observe::{PairFrame, Schema},
    stream::{chunks::Chunks, contract::RANKED_PAIRS},
};

/// For how long a pair counts as just changed [s].
const JUST: f64 = 0.05;
/// Rate of q at which pairs are assumed to change, at least [1/s]: those that do not move are ranked by q.
const LEAST_RATE: f64 = 0.05;
/// What is in view beyond the highest threshold, as a ratio.
const BEYOND: f64 = 1.3;

/// The ranking of the pairs within reach.
pub struct Changes {
    ranking: Ranking,
    last: BTreeMap<(usize, usize), Seen>,
}

/// A pair in a frame.
#[derive(Clone, Copy)]
struct Seen {
    time: f64,
    q: f64,
    phase: usize,
    /// When its phase changed last [s].
    changed: f64,
}

impl Changes {
    /// Starts without pairs; of few bodies, there is no ranking.
    pub fn new(schema: &Schema, chunks: &mut Chunks) -> Option<Changes> {
        let is_ranked = schema.bodies.len() > ranking::FEW && !schema.thresholds.is_empty();
        is_ranked.then(|| Changes { ranking: Ranking::new(RANKED_PAIRS.path, chunks), last: BTreeMap::new() })
    }

    /// Logs changed rows.
    pub fn log(&mut self, view: FrameView<'_>, chunks: &mut Chunks) {
        let FrameView { schema, frame, at } = view;
        let last = std::mem::take(&mut self.last);
        let mut ranked: Vec<(f64, PairFrame, Option<usize>)> = Vec::new();
        for pair in &frame.pairs {
            let before = last.get(&(pair.a, pair.b)).copied();
            let changed = match before {
                Some(before) if before.phase == pair.phase => before.changed,
                Some(_) => at.time,
                None => f64::NEG_INFINITY,
            };
            self.last.insert((pair.a, pair.b), Seen { time: at.time, q: pair.q, phase: pair.phase, changed });
            let rate =
                before.map_or(0.0, |before| (pair.q - before.q) / (at.time - before.time).max(f64::MIN_POSITIVE));
            let next = next(schema, pair, at.time);
            let soon = next.map_or(f64::INFINITY, |(_, level)| {
                let towards = rate * (level - pair.q).signum();
                (level - pair.q).abs() / towards.max(LEAST_RATE)
            });
            let just = at.time - changed;
            ranked.push((if just <= JUST { just - JUST } else { soon }, *pair, next.map(|(threshold, _)| threshold)));
        }
        ranked.sort_by(|one, other| one.0.total_cmp(&other.0));
        let highest = schema.thresholds.iter().map(|threshold| threshold.level).fold(0.0, f64::max);
        let place = |q: f64| q / (BEYOND * highest);
        let rows = ranked.iter().map(|(soon, pair, next)| {
            let (name, of_phase) = (schema.pair_name(pair.a, pair.b), &schema.phases[pair.phase]);
            let level = |threshold: usize| schema.level(threshold, [pair.a, pair.b], at.time);
            let levels = (0..schema.thresholds.len()).filter_map(|threshold| Some((threshold, level(threshold)?)));
            let ticks = levels.map(|(threshold, level)| (Mark::Tick(place(level)), schema.thresholds[threshold].color));
            let marks = ticks.chain([(Mark::Dot(place(pair.q)), of_phase.color)]).collect();
            let next = next.and_then(|threshold| Some((schema.thresholds[threshold].label, level(threshold)?)));
            let label = match next {
                Some((label, level)) if *soon >= 0.0 => format!("{name} {:.3} → {label} {level}", pair.q),
                _ => format!("{name} {:.3}, now {}", pair.q, of_phase.name),
            };
            Row { label, color: of_phase.color, marks }
        });
        self.ranking.log(rows, at, chunks);
    }
}

/// The threshold at which a pair changes phase next, and its level: of bodies that are apart the first, of joined ones the
/// nearest of the others.
fn next(schema: &Schema, pair: &PairFrame, time: f64) -> Option<(usize, f64)> {
    let is_joined = schema.phases[pair.phase].is_joined;
    let thresholds = if is_joined { 1..schema.thresholds.len() } else { 0..1 };
    let levels = thresholds.filter_map(|index| Some((index, schema.level(index, [pair.a, pair.b], time)?)));
    levels.min_by(|one, other| (one.1 - pair.q).abs().total_cmp(&(other.1 - pair.q).abs()))
}
