//! Compares geometric quantities of two runs: gap, overlap and neck of pairs; volume, area and topology of groups.

use std::{collections::BTreeMap, fmt, path::Path};

use super::{
    ReadError,
    read::Reader,
    recorded::{cell, step_of},
};
use crate::{
    analysis::surface::Merged,
    observe::Schema,
    sdk::datatypes::Float64,
    stream::{
        instant::STAGE,
        parts::{groups, pairs::MEASURES},
    },
};

/// Volumes, areas and distances of surfaces differ by a small multiple of the difference of their vertices: the volume
/// of a unit sphere by three times, its area by twice. This multiple is allowed.
const SENSITIVITY: f64 = 10.0;

/// Quantities by the entity that plots each, such as `/pairs/a~b/gap`.
pub type Values = BTreeMap<String, f64>;

/// The quantities of a frame.
pub fn of_frame(schema: &Schema, merged: &Merged, pairs: &[[usize; 2]]) -> Values {
    let mut values = Values::new();
    for (&[a, b], measures) in pairs.iter().zip(&merged.pairs) {
        let Some(measures) = measures else { continue };
        let numbers = [measures.gap, measures.overlap, measures.neck];
        for ((part, ..), value) in MEASURES.iter().zip(numbers) {
            values.insert(format!("/pairs/{}/{part}", schema.pair_name(a, b)), value);
        }
    }
    for group in &merged.groups {
        let Some(first) = group.bodies.first().and_then(|&first| schema.bodies.get(first)) else { continue };
        for ((part, ..), value) in groups::LINES.iter().zip(groups::values(group)) {
            values.insert(format!("/groups/{}/{part}", first.name), value);
        }
    }
    values
}

/// A quantity that differs between two runs.
#[derive(Clone, Debug, PartialEq)]
pub struct Deviation {
    /// The quantity, such as `gap of a~b`.
    pub what: String,
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
        let Deviation { what, step, time, values: [first, second], largest: (largest, at), .. } = self;
        let value = |value: &f64| if value.is_nan() { "none".to_owned() } else { value.to_string() };
        write!(f, "{what}: {} and {} at step {step} (t = {time:.6} s)", value(first), value(second))?;
        if at == step { Ok(()) } else { write!(f, ", up to {largest:.3e} apart, at step {at}") }
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
        let Some((name, part)) = entity.trim_start_matches("/").split_once('/').and_then(|of| of.1.rsplit_once('/'))
        else {
            return;
        };
        let difference = (first - second).abs();
        // ratio to what the tolerance allows, in radii of the pair or relative to the group
        let excess = match part {
            _ if first.to_bits() == second.to_bits() => 0.0,
            "gap" | "overlap" => difference / (SENSITIVITY * self.tolerance),
            // the seam's area is proportional to the penetration depth, its radius only to the root of it
            "neck" => (first * first - second * second).abs() / (SENSITIVITY * self.tolerance),
            "volume" | "area" => {
                difference / (SENSITIVITY * self.tolerance * first.abs().max(second.abs()).max(f64::MIN_POSITIVE))
            }
            _ => f64::INFINITY, // counts
        };
        if !(excess > self.min_excess || excess.is_nan()) {
            return;
        }
        let group = if entity.starts_with("/groups/") { "'s group" } else { "" };
        let known = self.found.entry(entity.to_owned()).or_insert_with(|| Deviation {
            what: format!("{part} of {name}{group}"),
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
    pub fn read(path: &Path) -> Result<Recorded, ReadError> {
        let parts: Vec<&str> =
            MEASURES.iter().map(|(part, ..)| *part).chain(groups::LINES.iter().map(|(part, ..)| *part)).collect();
        let is_wanted = |entity: &str| {
            (entity.starts_with("/pairs/") || entity.starts_with("/groups/"))
                && entity.rsplit_once('/').is_some_and(|(_, part)| parts.contains(&part))
        };
        let mut recorded = Recorded::default();
        let mut reader = Reader::open(path)?;
        while let Some(chunk) = reader.next(is_wanted)? {
            // stages inside a step are not frames
            if chunk.is_static() || chunk.timelines().keys().any(|name| name.as_str() == STAGE) {
                continue;
            }
            // the ~ of a pair is escaped in paths
            let entity = chunk.entity_path().to_string().replace('\\', "");
            let line = recorded.lines.entry(entity).or_default();
            for row in 0..chunk.num_rows() {
                let damaged = |what| ReadError::Damaged { path: path.to_owned(), at: None, what };
                let step = step_of(&chunk, row).map_err(damaged)?;
                line.push((step, cell::<Float64>(&chunk, "Scalars:scalars", row).first().map(|value| value.0)));
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
        assert_eq!(
            found,
            ["components of a's group: 2 and none at step 3 (t = 0.050000 s), up to 1.000e0 apart, at step 4"]
        );
    }
}
