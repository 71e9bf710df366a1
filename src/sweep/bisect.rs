//! Thresholds: where the outcome changes along one axis, between neighbours of the grid that differ.

use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;

use super::{
    classes::Classes,
    design::Design,
    row::{Cell, Row, axis_column},
    run::Runner,
};
use crate::{
    scene::template::Setting,
    table::{Column, Kind},
};

/// Precision of a threshold, absolute or relative, whichever is larger.
pub const PRECISION: f64 = 1e-9;
/// Upper limits on the changes of outcome between two neighbours of the grid, and on the bisections of each.
const MAX_CHANGES: usize = 16;
const MAX_BISECTIONS: u32 = 200;

/// A change of outcome along an axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Threshold {
    /// The bisected axis.
    pub axis: usize,
    /// The values on the axes; on the bisected axis, the lower end of the bracket.
    pub point: Vec<Setting>,
    /// Ends of the bracket.
    pub bracket: [f64; 2],
    /// Classes of the outcomes at its ends.
    pub classes: [u8; 2],
}

/// Finds changes of outcome along an axis, between neighbours of the grid whose outcomes differ; `outcome` returns the
/// class of a grid point. An even number of changes between two neighbours is not seen. `None` if interrupted.
pub fn thresholds(
    runner: &Runner<'_>,
    design: &Design,
    axis: usize,
    outcome: &(dyn Fn(&[u64]) -> Option<u8> + Sync),
    stop: &AtomicBool,
    progress: &(dyn Fn(u64) + Sync),
) -> Option<Vec<Threshold>> {
    let size = design.size(0).unwrap_or(0);
    let brackets: Vec<Threshold> = (0..size)
        .filter_map(|row| {
            let index = design.place(row)?.index;
            let mut next = index.clone();
            next[axis] += 1;
            if next[axis] >= design.axes[axis].count(0)? {
                return None;
            }
            let classes = [outcome(&index)?, outcome(&next)?];
            let number = |index: &[u64]| match design.axes[axis].value(0, index[axis]) {
                Setting::Number(number) => Some(number),
                Setting::Text(_) => None,
            };
            let bracket = [number(&index)?, number(&next)?];
            (classes[0] != classes[1]).then_some(Threshold { axis, point: design.point(row)?, bracket, classes })
        })
        .collect();
    let found: Vec<Option<Vec<Threshold>>> = brackets
        .par_iter()
        .with_max_len(1)
        .map(|bracket| {
            let found = narrow(runner, axis, bracket, stop);
            progress(1);
            found
        })
        .collect();
    found.into_iter().collect::<Option<Vec<_>>>().map(|found| found.into_iter().flatten().collect())
}

/// The changes of outcome in a bracket, in order.
fn narrow(runner: &Runner<'_>, axis: usize, bracket: &Threshold, stop: &AtomicBool) -> Option<Vec<Threshold>> {
    let (mut open, mut found) = (vec![bracket.clone()], Vec::new());
    while let Some(mut threshold) = open.pop() {
        for _ in 0..MAX_BISECTIONS {
            let [low, high] = threshold.bracket;
            let middle = 0.5 * (low + high);
            let width = (high - low).abs();
            let is_narrow = width <= PRECISION * f64::max(1.0, middle.abs());
            if is_narrow || middle == low || middle == high {
                break;
            }
            if stop.load(Ordering::Relaxed) {
                return None;
            }
            let mut point = threshold.point.clone();
            point[axis] = Setting::Number(middle);
            let cells = runner.cells(&point).ok()?;
            let at_middle = runner.classes().of(cells.get(point.len()));
            if at_middle == threshold.classes[0] {
                threshold.bracket[0] = middle;
            } else {
                // if this outcome also differs from that at the upper end, there is another change above
                if at_middle != threshold.classes[1] && found.len() + open.len() < MAX_CHANGES {
                    let mut above = threshold.clone();
                    (above.bracket[0], above.classes[0]) = (middle, at_middle);
                    open.push(above);
                }
                (threshold.bracket[1], threshold.classes[1]) = (middle, at_middle);
            }
        }
        threshold.point[axis] = Setting::Number(threshold.bracket[0]);
        found.push(threshold);
    }
    Some(found)
}

/// What the column of an axis holds in a table of thresholds.
pub const AXIS: &str = "value at this key of the scene; on the bisected axis, the lower end";
/// The columns of a table of thresholds beside the axes.
pub const COLUMNS: [Column; 5] = [
    Column::required("row", Kind::Count, "number of the threshold"),
    Column::required("threshold", Kind::Float, "the middle of the bracket"),
    Column::required("width", Kind::Float, "width of the bracket"),
    Column::required("below", Kind::Text, "outcome at its first end"),
    Column::required("above", Kind::Text, "outcome at its second end"),
];

/// The columns of a table of thresholds.
pub fn columns(design: &Design) -> Vec<Column> {
    let [row, rest @ ..] = COLUMNS;
    let axes = design.axes.iter().map(|axis| axis_column(axis, AXIS));
    std::iter::once(row).chain(axes).chain(rest).collect()
}

/// The rows of a table of thresholds.
pub fn rows(thresholds: &[Threshold], classes: &Classes) -> Vec<Row> {
    let rows = thresholds.iter().zip(0..).map(|(threshold, number)| {
        let [low, high] = threshold.bracket;
        let mut cells: Vec<Cell> = threshold.point.iter().map(Cell::from).collect();
        cells.extend([Cell::Float(0.5 * (low + high)), Cell::Float((high - low).abs())]);
        cells.extend(threshold.classes.map(|class| Cell::Text(classes.name(class))));
        (number, cells)
    });
    rows.collect()
}
