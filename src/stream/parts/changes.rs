//! A ranking of pairs by how soon they change phase if q goes on changing as it does.

use std::{cmp::Ordering, collections::BTreeMap};

use super::{
    FrameView,
    pairs::told_q,
    ranking::{Mark, Ranking, Row, is_ranked},
};
use crate::{
    observe::{PairFrame, Schema},
    stream::{chunks::Chunks, contract::RANKED_PAIRS},
    text::significant,
};

/// Rate of q [1/s], and rate of change of that [1/s²], below which a pair does not move.
const STILL: f64 = 1e-3;
/// Predictions in which |dq/dt| falls, or rises, by a larger share than this are not shown. In a scene of 22 bodies, 97
/// % of the others came true to a fifth of the wait, and 77 % of these; in `rain`, 46 % and 23 %.
const MOST_CHANGE: [f64; 2] = [0.5, 1.0];
/// What is in view beyond the highest threshold, as a ratio.
const BEYOND: f64 = 1.3;

/// The ranking of the pairs within reach. Of a simulation that does not know the rates of q, differences between frames.
pub struct Changes {
    ranking: Ranking,
    /// q of the pairs in the last frame and its rate [1/s], and the time of that [s].
    last: BTreeMap<(usize, usize), [f64; 2]>,
    time: f64,
    /// When the run ends [s].
    end: f64,
}

/// A threshold that a pair can cross.
#[derive(Clone, Copy)]
struct Next {
    /// Index into the schema's thresholds.
    threshold: usize,
    /// Its level for the pair [–].
    level: f64,
    /// Time until q is there if it goes on changing as it does [s]; infinite if it moves away, or if that cannot be told.
    wait: f64,
    /// Whether q changes towards it.
    is_neared: bool,
}

impl Next {
    /// Orders changes by how soon they come; then those towards a threshold, the nearest first.
    fn cmp(&self, q: f64, other: &Next, other_q: f64) -> Ordering {
        let distance = |next: &Next, q: f64| (next.level - q).abs();
        let by_wait = self.wait.total_cmp(&other.wait).then(other.is_neared.cmp(&self.is_neared));
        by_wait.then(distance(self, q).total_cmp(&distance(other, other_q)))
    }
}

/// How far ahead changes are told [s, Δt]: extrapolated further, q most often takes another way.
const SOON: (f64, f64) = (0.15, 3.0);

impl Changes {
    /// Starts without pairs, in a run of so many steps; of few bodies, there is no ranking.
    pub fn new(schema: &Schema, steps: Option<u64>, chunks: &mut Chunks) -> Option<Changes> {
        let is_ranked = is_ranked(schema) && !schema.thresholds.is_empty();
        let ranking = is_ranked.then(|| Ranking::new(RANKED_PAIRS.path, chunks))?;
        let end = steps.map_or(f64::INFINITY, |steps| (steps as f64 + 1e-9) * schema.dt);
        Some(Changes { ranking, last: BTreeMap::new(), time: 0.0, end })
    }

    /// Logs changed rows.
    pub fn log(&mut self, view: FrameView<'_>, chunks: &mut Chunks) {
        let FrameView { schema, frame, at, .. } = view;
        let since = (at.time - self.time).max(f64::MIN_POSITIVE);
        let mut ranked: Vec<(PairFrame, f64, Option<Next>)> = Vec::with_capacity(frame.pairs.len());
        let mut now = BTreeMap::new();
        for &pair in &frame.pairs {
            let before = self.last.get(&(pair.a, pair.b));
            let difference = || before.map_or(0.0, |[q, _]| (pair.q - q) / since);
            let rate = if pair.rate.is_nan() { difference() } else { pair.rate };
            let acceleration = before.map_or(0.0, |[_, before]| (rate - before) / since);
            let mut next = next(schema, &pair, [rate, acceleration], at.time);
            if let Some(next) = next.as_mut().filter(|next| at.time + next.wait > self.end) {
                next.wait = f64::INFINITY; // the run ends before
            }
            ranked.push((pair, if rate.abs() > STILL { rate } else { 0.0 }, next));
            now.insert((pair.a, pair.b), [pair.q, rate]);
        }
        self.last = now;
        self.time = at.time;
        // those that do not come nearer to a threshold are last, the nearest first
        ranked.sort_by(|(one, _, next), (other, _, other_next)| match (next, other_next) {
            (Some(next), Some(other_next)) => next.cmp(one.q, other_next, other.q),
            _ => other_next.is_some().cmp(&next.is_some()),
        });
        let highest = schema.thresholds.iter().map(|threshold| threshold.level).fold(0.0, f64::max);
        let place = |q: f64| q / (BEYOND * highest);
        let rows = ranked.iter().map(|(pair, rate, next)| {
            let phase = &schema.phases[pair.phase];
            let level = |threshold: usize| schema.level(threshold, [pair.a, pair.b], at.time);
            let levels = (0..schema.thresholds.len()).filter_map(|threshold| Some((threshold, level(threshold)?)));
            let ticks = levels.map(|(threshold, level)| (Mark::Tick(place(level)), schema.thresholds[threshold].color));
            let marks = ticks.chain([(Mark::Dot(place(pair.q)), phase.color)]).collect();
            let what = match next.filter(|next| next.wait <= f64::max(SOON.0, SOON.1 * schema.dt)) {
                Some(Next { threshold, wait, .. }) => {
                    let label = schema.thresholds[threshold].name.trim_end_matches("_at");
                    let leaves = if label == phase.name { "leave " } else { "" };
                    match wait {
                        ..0.001 => format!("{leaves}{label} in < 1 ms"),
                        _ => format!("{leaves}{label} in {:.0} ms", 1e3 * wait),
                    }
                }
                None => match *rate {
                    0.0 => "does not move".to_owned(),
                    ..0.0 => format!("-{}/s", significant(-rate)),
                    _ => format!("+{}/s", significant(*rate)),
                },
            };
            let q = told_q(schema, [pair.a, pair.b], pair.q, at.time);
            let label = format!("{} {q}: {what}", schema.pair_name(pair.a, pair.b));
            Row { label, color: phase.color, marks }
        });
        self.ranking.log(rows, "no pair is within reach", at, chunks);
    }
}

/// The threshold that a pair crosses next, if q goes on with this rate [1/s] and this rate of change of it [1/s²]: of
/// bodies that are apart the first, of joined ones one of the others. If it reaches none, one that it nears.
fn next(schema: &Schema, pair: &PairFrame, [rate, acceleration]: [f64; 2], time: f64) -> Option<Next> {
    let is_joined = schema.phases[pair.phase].is_joined;
    let thresholds = if is_joined { 1..schema.thresholds.len() } else { 0..1 };
    let nexts = thresholds.filter_map(|threshold| {
        let level = schema.level(threshold, [pair.a, pair.b], time)?;
        let wait = first_time(pair.q - level, rate, acceleration);
        let most = MOST_CHANGE[usize::from(acceleration * rate > 0.0)];
        let is_told = acceleration.abs() * wait <= most * rate.abs();
        let is_neared = rate.abs() > STILL && rate * (level - pair.q) > 0.0;
        Some(Next { threshold, level, wait: if is_told { wait } else { f64::INFINITY }, is_neared })
    });
    nexts.min_by(|one, other| one.cmp(pair.q, other, pair.q))
}

/// The first time at which x + v t + ½ a t² is 0 [s]; infinite if it never is, or if x hardly moves.
fn first_time(x: f64, v: f64, a: f64) -> f64 {
    if v.abs().max(a.abs()) <= STILL {
        return f64::INFINITY;
    }
    // both roots without cancellation
    let under_root = v * v - 2.0 * a * x;
    let sum = -v - under_root.max(0.0).sqrt().copysign(v);
    let roots = [sum / a, 2.0 * x / sum];
    let later = roots.into_iter().filter(|root| *root >= 0.0 && root.is_finite() && under_root >= 0.0);
    later.fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Scene, view};

    #[test]
    fn a_pair_crosses_the_threshold_towards_which_it_moves() {
        let text = "duration = 1\n[influence]\nmerge_at = 1.05\nsplit_at = 1.15\ncore_at = 0.8\n[[body]]\nname = 'a'\nradius = 1\n\
                    motion = { fixed = [0, 0, 0] }\n[[body]]\nname = 'b'\nradius = 1\nmotion = { fixed = [9, 0, 0] }\n";
        let schema = view::schema(&Scene::parse(text, "next").unwrap());
        let phase = |name: &str| schema.phases.iter().position(|phase| phase.name == name).unwrap();
        for (name, q, rate, acceleration, threshold, wait) in [
            ("apart", 1.2, -1.0, 0.0, "merge_at", 0.15),
            ("apart", 1.2, 1.0, 0.0, "merge_at", f64::INFINITY),
            ("merged", 0.85, 1.0, 0.0, "split_at", 0.3),
            ("merged", 1.1, -2.0, 0.0, "core_at", 0.15),
            ("merged", 1.1, 0.0, 0.0, "split_at", f64::INFINITY),
            ("core", 0.7, 0.5, 0.0, "core_at", 0.2),
            ("apart", 1.2, -1.0, -2.0, "merge_at", (1.6f64.sqrt() - 1.0) / 2.0),
            // it turns back before the threshold; it may turn
            ("apart", 1.2, -1.0, 10.0, "merge_at", f64::INFINITY),
            ("core", 0.7, -1.0, 20.0, "core_at", f64::INFINITY),
        ] {
            let next = next(&schema, &PairFrame::new(0, 1, q, phase(name)), [rate, acceleration], 0.0).unwrap();
            assert_eq!(schema.thresholds[next.threshold].name, threshold, "{name}, q = {q}");
            assert!(next.wait == wait || (next.wait - wait).abs() < 1e-12, "{name}, q = {q}: {}", next.wait);
        }
        for (q, told) in [(1.05, "1.050"), (1.05007, "1.050070"), (1.1496, "1.149600"), (1.0494, "1.049")] {
            assert_eq!(told_q(&schema, [0, 1], q, 0.0), told);
        }
    }
}
