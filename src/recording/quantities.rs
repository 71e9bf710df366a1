//! Compares geometric quantities of two runs: gap, overlap and neck of pairs; volume, area and topology of groups.

use std::{collections::BTreeMap, fmt};

use super::{
    ReadError,
    read::Reader,
    recorded::{cell, step_of},
};
use crate::{
    analysis::surface::Merged,
    observe::Schema,
    sdk::{Scalars, datatypes::Float64},
    stream::{
        contract::{GROUP_LINE, PAIR_GAP, PAIR_NECK, STAGE, path_of},
        parts::{groups, pairs::MEASURES},
    },
    text::short,
};

/// Volumes, areas and distances of surfaces differ by a small multiple of the difference of their vertices: the volume
/// of a unit sphere by three times, its area by twice. This multiple is allowed.
pub const SENSITIVITY: f64 = 10.0;

/// Quantities by the entity that plots each, such as `/pairs/a~b/gap`.
pub type Values = BTreeMap<String, f64>;

/// The quantities of a frame.
pub fn of_frame(schema: &Schema, merged: &Merged, pairs: &[[usize; 2]]) -> Values {
    let mut values = Values::new();
    for (&[a, b], measures) in pairs.iter().zip(&merged.pairs) {
        let Some(measures) = measures else { continue };
        let numbers = [measures.gap, measures.overlap, measures.neck];
        for ((entity, ..), value) in MEASURES.iter().zip(numbers) {
            values.insert(entity.of(&[&schema.pair_name(a, b)]), value);
        }
    }
    for group in &merged.groups {
        let Some(first) = group.bodies.first().and_then(|&first| schema.bodies.get(first)) else { continue };
        for ((part, ..), value) in groups::LINES.iter().zip(groups::values(group)) {
            values.insert(GROUP_LINE.of(&[&first.name, part]), value);
        }
    }
    values
}

/// A quantity that differs between two runs.
#[derive(Clone, Debug, PartialEq)]
pub struct Deviation {
    /// The quantity, such as `gap of a~b`.
    pub what: String,
    /// The unit of its values, behind a space; empty for counts.
    pub unit: &'static str,
    /// The first step, of the first run, at which it deviates.
    pub step: u64,
    /// Simulated time of that step [s].
    pub time: f64,
    /// Its values at that step in the first and second run; NaN where a run has none.
    pub values: [f64; 2],
    /// The largest difference, and its step.
    pub largest: (f64, u64),
    /// The largest ratio of the difference to what the tolerance allows.
    pub excess: f64,
}

impl fmt::Display for Deviation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.line(&format!(" at step {} (t = {:.6} s)", self.step, self.time)))
    }
}

impl Deviation {
    /// Describes it; `at` tells when it begins.
    pub fn line(&self, at: &str) -> String {
        let Deviation { what, unit, step, values: [first, second], largest: (largest, last), .. } = self;
        // as many digits as show the difference
        let is_whole = [first, second].iter().all(|value| !(value.fract().abs() > 0.0));
        let digits = if is_whole { 0.0 } else { 1.0 - (first - second).abs().log10().floor() };
        let digits = if digits.is_finite() { digits.clamp(0.0, 17.0) as usize } else { 6 };
        let value = |value: &f64| match value.is_nan() {
            true => "none".to_owned(),
            false => format!("{value:.digits$}{unit}"),
        };
        let later = match last == step {
            true => String::new(),
            false => {
                let largest = if is_whole { format!("{largest:.0}") } else { short(*largest) };
                format!(", up to {largest}{unit} apart, at step {last}")
            }
        };
        format!("{what}: {} and {}{at}{later}", value(first), value(second))
    }
}

/// Collects deviations, instant by instant.
pub struct Deviations {
    /// Vertices may differ by this much [radii].
    tolerance: f64,
    /// Smaller ratios of the difference to what the tolerance allows are ignored.
    min_excess: f64,
    found: BTreeMap<String, Deviation>,
}

impl Deviations {
    /// Collects differences of more than `min_excess` times what `tolerance` [radii] allows.
    pub fn new(tolerance: f64, min_excess: f64) -> Deviations {
        Deviations { tolerance, min_excess, found: BTreeMap::new() }
    }

    /// Compares a quantity at a step of the first run.
    pub fn compare(&mut self, entity: &str, step: u64, time: f64, values: [f64; 2]) {
        let [first, second] = values;
        let difference = (first - second).abs();
        let allowed = SENSITIVITY * self.tolerance;
        let group = GROUP_LINE.names(entity);
        // ratio to what the tolerance allows, in radii of the pair or relative to the group
        let excess = match group.as_deref() {
            _ if first.to_bits() == second.to_bits() => 0.0,
            Some([_, "volume" | "area"]) => {
                difference / (allowed * first.abs().max(second.abs()).max(f64::MIN_POSITIVE))
            }
            Some(_) => f64::INFINITY, // counts
            // the seam's area is proportional to the penetration depth, its radius only to the root of it
            None if PAIR_NECK.is(entity) => (first * first - second * second).abs() / allowed,
            None => difference / allowed,
        };
        if !(excess > self.min_excess || excess.is_nan()) {
            return;
        }
        let group = if group.is_some() { "'s group" } else { "" };
        let mut parts = entity.rsplit('/');
        let (part, name) = (parts.next().unwrap_or_default(), parts.next().unwrap_or_default());
        let known = self.found.entry(entity.to_owned()).or_insert_with(|| Deviation {
            what: format!("{part} of {name}{group}"),
            unit: match part {
                "gap" | "neck" => " R",
                "overlap" => " R³",
                "volume" => " unit³",
                "area" => " unit²",
                _ => "",
            },
            step,
            time,
            values,
            largest: (difference, step),
            excess,
        });
        if difference > known.largest.0 || known.largest.0.is_nan() && !difference.is_nan() {
            known.largest = (difference, step);
        }
        known.excess = known.excess.max(excess);
    }

    /// All deviations, by their first step.
    pub fn finish(self) -> Vec<Deviation> {
        let mut found: Vec<Deviation> = self.found.into_values().collect();
        found.sort_by_key(|deviation| deviation.step);
        found
    }
}

/// The quantities in a recording, step by step.
#[derive(Debug, Default)]
pub struct Recorded {
    /// Points of each line, by step; `None` where a line is interrupted.
    lines: BTreeMap<String, Vec<(i64, Option<f64>)>>,
}

impl Recorded {
    /// Reads the quantities.
    ///
    /// # Errors
    /// The recording cannot be read.
    pub fn read(of: &super::Recorded) -> Result<Recorded, ReadError> {
        let is_wanted = |entity: &str| GROUP_LINE.is(entity) || MEASURES.iter().any(|(measure, ..)| measure.is(entity));
        let mut recorded = Recorded::default();
        let mut reader = Reader::of(of)?;
        while let Some(chunk) = reader.next(is_wanted)? {
            // stages inside a step are not frames
            if chunk.is_static() || chunk.timelines().keys().any(|name| name.as_str() == STAGE) {
                continue;
            }
            let line = recorded.lines.entry(path_of(&chunk)).or_default();
            for row in 0..chunk.num_rows() {
                let damaged = |what| ReadError::Damaged { path: of.path.clone(), at: None, what };
                let step = step_of(&chunk, row).map_err(damaged)?;
                line.push((
                    step,
                    cell::<Float64>(&chunk, &Scalars::descriptor_scalars(), row).first().map(|value| value.0),
                ));
            }
        }
        recorded.lines.values_mut().for_each(|line| line.sort_by_key(|point| point.0));
        Ok(recorded)
    }

    /// Compares two recordings at `instants`, the steps of both at equal times; `dt` is the step size of the first [s].
    pub fn compare(&self, other: &Recorded, instants: &[[u64; 2]], dt: f64, deviations: &mut Deviations) {
        for (entity, line) in &self.lines {
            let Some(others) = other.lines.get(entity) else { continue };
            let (mut one, mut two) = (Cursor::new(line), Cursor::new(others));
            for &[a, b] in instants {
                // a value that did not change is not recorded again
                if let (Some(first), Some(second)) = (one.at(a), two.at(b)) {
                    deviations.compare(entity, a, a as f64 * dt, [first, second]);
                }
            }
        }
    }

    /// The most by which the gap of a pair can change between two steps, at its fastest in the frames around them [radii of
    /// the smaller body]; infinite where it is interrupted, `None` if it is not recorded.
    pub fn change_of_gap(&self, pair: &str, [from, to]: [f64; 2]) -> Option<f64> {
        let line = self.lines.get(&PAIR_GAP.of(&[pair]))?;
        let steps = |ends: &[(i64, Option<f64>)]| [ends[0].0, ends[1].0];
        // values that did not change are not recorded again: frames are as far apart as the closest points
        let every = line.windows(2).map(|ends| steps(ends)[1] - steps(ends)[0]).min()?.max(1);
        let is_around = |ends: &&[(i64, Option<f64>)]| {
            let [start, end] = steps(ends).map(|step| step as f64);
            start <= from.max(to) && from.min(to) <= end
        };
        let change = |ends: &[(i64, Option<f64>)]| Some((ends[0].1? - ends[1].1?).abs());
        let changes = line.windows(2).filter(is_around).map(|ends| change(ends).unwrap_or(f64::INFINITY));
        Some(changes.reduce(f64::max)? / every as f64 * (to - from).abs())
    }

    /// Whether there are quantities that only one of two recordings has.
    pub fn has_others(&self, other: &Recorded) -> bool {
        !self.lines.keys().eq(other.lines.keys())
    }

    /// Whether there is nothing to compare.
    pub fn is_empty(&self) -> bool {
        self.lines.is_empty()
    }
}

/// Walks along a line.
struct Cursor<'a> {
    line: &'a [(i64, Option<f64>)],
    next: usize,
}

impl Cursor<'_> {
    fn new(line: &[(i64, Option<f64>)]) -> Cursor<'_> {
        Cursor { line, next: 0 }
    }

    /// The last value at or before `step`. Steps must not decrease from call to call.
    fn at(&mut self, step: u64) -> Option<f64> {
        let step = i64::try_from(step).unwrap_or(i64::MAX);
        while self.line.get(self.next).is_some_and(|point| point.0 <= step) {
            self.next += 1;
        }
        self.next.checked_sub(1).and_then(|last| self.line[last].1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A quantity that one run lacks is not a number that differs.
    #[test]
    fn a_missing_quantity_is_named_as_none() {
        let mut deviations = Deviations::new(1e-6, 1.0);
        deviations.compare("/groups/a/components", 3, 0.05, [2.0, f64::NAN]);
        deviations.compare("/groups/a/components", 4, 0.06, [2.0, 1.0]);
        let found: Vec<String> = deviations.finish().iter().map(ToString::to_string).collect();
        assert_eq!(found, ["components of a's group: 2 and none at step 3 (t = 0.050000 s), up to 1 apart, at step 4"]);
    }
}
