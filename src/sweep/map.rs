//! The map of a sweep: outcomes, or a measure, over its first two numeric axes. There is one map for each combination
//! of values on the other axes.

use std::collections::{BTreeMap, HashMap};

use super::{
    Sweep,
    bisect::Threshold,
    classes::{self, Classes},
    design::{Axis, Design, Sampling, Scale, Values},
    file::Until,
    row::Cell,
    store::{Store, StoreError},
};
use crate::{
    scene::template::{KeyPath, Setting},
    stream::palette,
    svg,
    table::Kind,
    text::{counted, trimmed},
};

/// Maximum number of points of a map along an axis.
const MAX_POINTS: u64 = 1200;
/// Maximum number of maps drawn.
pub const MOST_SLICES: usize = 64;
/// Maximum number of runs shown as points.
pub const MAX_DOTS: usize = 20_000;

/// Colour of unknown points.
pub const UNKNOWN: [u8; 3] = [255, 255, 255];

/// The maps of a sweep.
pub struct Map {
    /// The horizontal axis, and the vertical one if there is a second numeric axis.
    pub axes: Vec<Axis>,
    /// The quantity by which the map is coloured.
    pub color: String,
    /// What it is, with its unit.
    pub about_color: String,
    /// Range of the measure, if the map is coloured by one.
    pub range: Option<[f64; 2]>,
    /// One map for each combination of values on the other axes.
    pub slices: Vec<Slice>,
    /// Number of rows.
    pub rows: u64,
    /// Whether the points form a grid.
    pub is_grid: bool,
    /// The classes of the outcomes, in the order of the rows.
    pub classes: Classes,
    /// Number of runs whose outcome was not certain when the scene ended, and the time of that [s].
    pub undecided: Option<(u64, f64)>,
}

/// A map.
#[derive(Default)]
pub struct Slice {
    /// Values on the other axes.
    pub title: String,
    /// Number of grid points, horizontally and vertically.
    pub size: [usize; 2],
    /// Boundaries between the cells of the grid points, as fractions of the axis, `[size + 1]`.
    pub edges: [Vec<f64>; 2],
    /// Classes of the points' outcomes, row by row upwards; `u8::MAX` if unknown.
    pub classes: Vec<u8>,
    /// Values of the measure at the points; NaN if unknown.
    pub values: Vec<f64>,
    /// The runs.
    pub dots: Vec<Dot>,
    /// Places of the thresholds that were bisected, as fractions of the axes.
    pub thresholds: Vec<[f64; 2]>,
}

impl Slice {
    /// Whether there is a run or a region of this class.
    pub fn shows(&self, class: u8) -> bool {
        self.classes.contains(&class) || self.dots.iter().any(|dot| dot.class == class)
    }

    /// Whether it may have more runs than points.
    pub fn is_cut(&self) -> bool {
        self.dots.len() == MAX_DOTS
    }
}

/// A run on a map.
#[derive(Clone, Debug)]
pub struct Dot {
    /// Number of the row.
    pub row: u64,
    /// Position, as fractions of the axes.
    pub at: [f64; 2],
    /// Class of the outcome.
    pub class: u8,
    /// The outcome, the values on all axes, and how to record the run.
    pub label: String,
}

/// The parts of a row that a map needs.
struct Seen {
    class: u8,
    value: f64,
}

/// What a map cannot show, for its readers.
pub fn missable(design: &Design) -> &'static str {
    match design.sampling {
        Sampling::Grid => {
            "a region smaller than a cell of the first grid may be missing: --refine divides only cells with a boundary in sight"
        }
        Sampling::Latin { .. } | Sampling::Sobol { .. } => {
            "a region without a sample is missing: a larger count shows more"
        }
    }
}

impl Map {
    /// The maps of the rows in a folder, with thresholds that were bisected; `None` if the sweep has no numeric axis, or
    /// combinations that cannot be drawn.
    ///
    /// # Errors
    /// The rows cannot be read.
    pub fn new(sweep: &Sweep, store: &Store, thresholds: &[Threshold]) -> Result<Option<Map>, StoreError> {
        let design = &sweep.design;
        let numbers: Vec<usize> =
            (0..design.axes.len()).filter(|&axis| design.axes[axis].is_number()).take(2).collect();
        if numbers.is_empty() {
            return Ok(None);
        }
        let is_measure = sweep.color != "outcome";
        let columns = store.named(&["outcome", &sweep.color]);
        let is_count = columns.get(2).or(columns.get(1)).is_some_and(|column| column.kind == Kind::Integer);
        let mut found: BTreeMap<u64, (Option<Cell>, f64)> = BTreeMap::new();
        store.read(0..u32::MAX, None, &columns, |(row, cells)| {
            let value = match cells.last() {
                Some(Cell::Float(x)) => *x,
                Some(Cell::Integer(n)) if is_count => *n as f64,
                _ => f64::NAN,
            };
            found.insert(row, (cells.first().cloned(), value));
        })?;
        // numbered in the order of the rows, however they were found
        let classes = sweep.classes.afresh();
        let seen = |(row, (outcome, value)): (u64, (Option<Cell>, f64))| {
            (row, Seen { class: classes.of(outcome.as_ref()), value })
        };
        let seen: BTreeMap<u64, Seen> = found.into_iter().map(seen).collect();
        let values = || seen.values().map(|seen| seen.value).filter(|value| value.is_finite());
        let range = [values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max)];
        let is_grid = design.sampling == Sampling::Grid;
        let mut map = Map {
            axes: numbers.iter().map(|&axis| design.axes[axis].clone()).collect(),
            color: sweep.color.clone(),
            about_color: columns.last().map_or_else(String::new, |column| column.about.to_string()),
            range: (is_measure && range[0] <= range[1]).then_some(range),
            slices: Vec::new(),
            rows: seen.len() as u64,
            is_grid,
            classes,
            undecided: undecided(sweep, store)?,
        };
        let mut by_slice: BTreeMap<Vec<u64>, Vec<u64>> = BTreeMap::new();
        for row in seen.keys() {
            let key = match (is_grid, design.place(*row)) {
                (true, Some(place)) => {
                    let others = place.index.iter().enumerate().filter(|(axis, _)| !numbers.contains(axis));
                    // on a refined third axis, only the values of level 0 are drawn
                    let at: Option<Vec<u64>> = others
                        .map(|(axis, &index)| match design.axes[axis].is_range() {
                            true => (index % (1 << place.level) == 0).then_some(index >> place.level),
                            false => Some(index),
                        })
                        .collect();
                    match at {
                        Some(at) => at,
                        None => continue,
                    }
                }
                _ => Vec::new(),
            };
            by_slice.entry(key).or_default().push(*row);
        }
        for rows in by_slice.values().take(MOST_SLICES) {
            let mut slice = slice(sweep, &map, &numbers, rows, &seen);
            let is_here = |threshold: &&Threshold| {
                numbers.contains(&threshold.axis) && other_axes(sweep, &numbers, &threshold.point) == slice.title
            };
            let places =
                thresholds.iter().filter(is_here).map(|Threshold { axis, point, bracket: [low, high], .. }| {
                    let mut point = point.clone();
                    point[*axis] = Setting::Number(0.5 * (low + high));
                    place(sweep, &numbers, &point)
                });
            slice.thresholds = places.collect();
            map.slices.push(slice);
        }
        Ok((!map.slices.is_empty()).then_some(map))
    }

    /// How many outcomes are those of the end of the scene, and could be others in a longer one.
    pub fn about_undecided(&self) -> Option<String> {
        let (count, time) = self.undecided?;
        let were = if count == 1 { "was" } else { "were" };
        Some(format!(
            "{} {were} not certain when the scene ended, at {time} s: a longer one may end otherwise",
            counted(count, "run")
        ))
    }

    /// The colour of a grid point of a slice.
    pub fn color(&self, slice: &Slice, point: usize) -> [u8; 3] {
        let class = slice.classes.get(point).copied().unwrap_or(u8::MAX);
        match self.range {
            Some([low, high]) if class != u8::MAX => {
                let value = slice.values.get(point).copied().unwrap_or(f64::NAN);
                if value.is_finite() { ramp((value - low) / f64::max(high - low, f64::MIN_POSITIVE)) } else { UNKNOWN }
            }
            _ if class == u8::MAX => UNKNOWN,
            _ => classes::color(class).0,
        }
    }
}

/// The runs whose outcome was not certain when the scene ended, at the same time in all of them; `None` without any, or if
/// that is not known.
fn undecided(sweep: &Sweep, store: &Store) -> Result<Option<(u64, f64)>, StoreError> {
    let sets_end = |key: &KeyPath| ["duration", "dt"].contains(&key.to_string().as_str());
    let varies =
        sweep.design.axes.iter().any(|axis| sets_end(&axis.key)) || sweep.set.iter().any(|(key, _)| sets_end(key));
    if sweep.experiment.is_some() || sweep.until != Until::Certain || varies {
        return Ok(None);
    }
    let Ok(template) = sweep.template() else { return Ok(None) };
    let last = template.base().steps();
    let mut count = 0;
    store.read(0..u32::MAX, None, &store.named(&["outcome", "steps"]), |(_, cells)| {
        let is_last = |steps: &i64| u64::try_from(*steps) == Ok(last);
        let is_undecided = matches!(&cells[..], [Cell::Text(_), Cell::Integer(steps)] if is_last(steps));
        count += u64::from(is_undecided);
    })?;
    Ok((count > 0).then_some((count, last as f64 * template.base().dt)))
}

/// The values of a point on the axes that are not on the map, in words.
fn other_axes(sweep: &Sweep, numbers: &[usize], point: &[Setting]) -> String {
    let others = sweep.design.axes.iter().zip(point).enumerate().filter(|(axis, _)| !numbers.contains(axis));
    let others = others.map(|(_, (axis, value))| format!("{} = {value}", axis.label()).replace('"', ""));
    others.collect::<Vec<_>>().join(", ")
}

/// The place of a point on the map, as fractions of its axes.
fn place(sweep: &Sweep, numbers: &[usize], point: &[Setting]) -> [f64; 2] {
    let share = |&axis: &usize| match point.get(axis) {
        Some(Setting::Number(value)) => sweep.design.axes[axis].share(*value),
        _ => 0.5,
    };
    [0, 1].map(|side| numbers.get(side).map_or(0.5, share))
}

fn slice(sweep: &Sweep, map: &Map, numbers: &[usize], rows: &[u64], seen: &BTreeMap<u64, Seen>) -> Slice {
    let design = &sweep.design;
    let mut slice = Slice::default();
    let first = rows.first().and_then(|&row| design.point(row)).filter(|_| map.is_grid);
    slice.title = first.map_or(String::new(), |first| other_axes(sweep, numbers, &first));
    for &row in rows.iter().take(MAX_DOTS) {
        let (Some(Seen { class, .. }), Some(point)) = (seen.get(&row), design.point(row)) else { continue };
        let values = design.axes.iter().zip(&point).map(|(axis, value)| format!("{} = {value}", axis.label()));
        let values = values.collect::<Vec<_>>().join(", ");
        let recorded = if sweep.experiment.is_none() { format!("; record it: --open {row}") } else { String::new() };
        let label = format!("row {row}: {}, {values}{recorded}", map.classes.name(*class));
        slice.dots.push(Dot { row, at: place(sweep, numbers, &point), class: *class, label });
    }
    if !map.is_grid {
        return slice;
    }
    let deepest = rows.iter().filter_map(|&row| Some(design.place(row)?.level)).max().unwrap_or(0);
    let fits = |level: u32| numbers.iter().all(|&axis| design.axes[axis].count(level).is_some_and(|n| n <= MAX_POINTS));
    let level = (0..=deepest).take_while(|&level| fits(level)).last().unwrap_or(0);
    let counts: Vec<usize> = numbers.iter().map(|&axis| design.axes[axis].count(level).unwrap_or(1) as usize).collect();
    slice.size = [counts[0], counts.get(1).copied().unwrap_or(1)];
    slice.edges = [0, 1].map(|side| match numbers.get(side) {
        Some(&axis) => edges(&design.axes[axis], slice.size[side]),
        None => vec![0.0, 1.0],
    });
    slice.classes = vec![u8::MAX; slice.size[0] * slice.size[1]];
    slice.values = vec![f64::NAN; slice.classes.len()];
    // a point represents its Voronoi cell among the points of its level, except where a finer level has points
    let mut by_level: HashMap<u32, Vec<u64>> = HashMap::new();
    for &row in rows {
        if let Some(place) = design.place(row) {
            by_level.entry(place.level).or_default().push(row);
        }
    }
    for at in 0..=level {
        let half = (1u64 << (level - at)) / 2;
        for row in by_level.get(&at).into_iter().flatten() {
            let (Some(place), Some(known)) = (design.place(*row), seen.get(row)) else { continue };
            let reach = |side: usize| {
                let Some(&axis) = numbers.get(side) else { return 0..1 };
                if !design.axes[axis].is_range() {
                    let index = place.index[axis] as usize;
                    return index..index + 1;
                }
                let centre = place.index[axis] << (level - at);
                centre.saturating_sub(half) as usize..((centre + half + 1).min(slice.size[side] as u64)) as usize
            };
            for j in reach(1) {
                for i in reach(0) {
                    slice.classes[j * slice.size[0] + i] = known.class;
                    slice.values[j * slice.size[0] + i] = known.value;
                }
            }
        }
    }
    slice
}

/// The boundaries of the cell of each grid point, as fractions of the axis.
fn edges(axis: &Axis, count: usize) -> Vec<f64> {
    if !axis.is_range() {
        return (0..=count).map(|k| k as f64 / count as f64).collect();
    }
    let cells = (count - 1).max(1) as f64;
    (0..=count).map(|k| ((k as f64 - 0.5) / cells).clamp(0.0, 1.0)).collect()
}

/// The colour of a share of a measure's range, in 32 steps, so that equal neighbours are drawn as one.
pub fn ramp(share: f64) -> [u8; 3] {
    palette::heat((share.clamp(0.0, 1.0) * 31.0).round() / 31.0)
}

/// The boundary between cells of different outcomes, as line segments in fractions of the axes.
pub fn boundary(slice: &Slice) -> Vec<[[f64; 2]; 2]> {
    let [width, height] = slice.size;
    let class = |i: usize, j: usize| slice.classes[j * width + i];
    let mut lines: Vec<[[f64; 2]; 2]> = Vec::new();
    let mut add = |from: [f64; 2], to: [f64; 2]| match lines.last_mut() {
        // a segment that goes on where the last one ended is part of it
        Some([first, last]) if *last == from && (first[0] == to[0] || first[1] == to[1]) => *last = to,
        _ => lines.push([from, to]),
    };
    let [x, y] = &slice.edges;
    for i in 1..width {
        let differ = (0..height).filter(|&j| class(i - 1, j) != class(i, j));
        differ.for_each(|j| add([x[i], y[j]], [x[i], y[j + 1]]));
    }
    for j in 1..height {
        let differ = (0..width).filter(|&i| class(i, j - 1) != class(i, j));
        differ.for_each(|i| add([x[i], y[j]], [x[i + 1], y[j]]));
    }
    lines
}

/// The largest region of each class, if it is large enough for a name: the class, and the place furthest from the region's
/// boundary, as fractions of the axes.
pub fn regions(slice: &Slice) -> Vec<(u8, [f64; 2])> {
    /// Least area of a region with a name [map].
    const LEAST: f64 = 0.01;

    let [width, height] = slice.size;
    let neighbours = |cell: usize| {
        let (i, j) = (cell % width, cell / width);
        let sides = [(i > 0, -1), (i + 1 < width, 1), (j > 0, -(width as isize)), (j + 1 < height, width as isize)];
        let inside = sides.into_iter().filter(|(is_inside, _)| *is_inside);
        inside.map(move |(_, offset)| cell.wrapping_add_signed(offset))
    };
    let is_same = |cell: usize, other: &usize| slice.classes[cell] == slice.classes[*other];
    // from the boundaries inwards, so that the last cell of a region is its furthest from them
    let sides = 2 * (usize::from(width > 1) + usize::from(height > 1));
    let at_boundary = |cell: &usize| neighbours(*cell).filter(|other| is_same(*cell, other)).count() < sides;
    let mut inwards: Vec<usize> = (0..slice.classes.len()).filter(at_boundary).collect();
    let mut is_queued = vec![false; slice.classes.len()];
    inwards.iter().for_each(|&cell| is_queued[cell] = true);
    let mut next = 0;
    while let Some(&cell) = inwards.get(next) {
        next += 1;
        for other in neighbours(cell) {
            if !std::mem::replace(&mut is_queued[other], true) {
                inwards.push(other);
            }
        }
    }
    let [x, y] = &slice.edges;
    let area = |cell: usize| {
        let (i, j) = (cell % width, cell / width);
        (x[i + 1] - x[i]) * (y[j + 1] - y[j])
    };
    let mut largest: BTreeMap<u8, (f64, usize)> = BTreeMap::new();
    let mut is_known = vec![false; slice.classes.len()];
    for &deepest in inwards.iter().rev() {
        if std::mem::replace(&mut is_known[deepest], true) {
            continue;
        }
        let (mut region, mut next) = (vec![deepest], 0);
        while let Some(&cell) = region.get(next) {
            next += 1;
            for other in neighbours(cell).filter(|other| is_same(cell, other)) {
                if !std::mem::replace(&mut is_known[other], true) {
                    region.push(other);
                }
            }
        }
        let size = region.into_iter().map(area).sum::<f64>();
        let before = largest.entry(slice.classes[deepest]).or_default();
        if size > before.0 {
            *before = (size, deepest);
        }
    }
    largest.remove(&u8::MAX); // unknown
    let middle = |edges: &[f64], cell: usize| 0.5 * (edges[cell] + edges[cell + 1]);
    let place = |cell: usize| [middle(x, cell % width), middle(y, cell / width)];
    let named = largest.into_iter().filter(|(_, (size, _))| *size >= LEAST);
    named.map(|(class, (_, deepest))| (class, place(deepest))).collect()
}

/// Tick positions of an axis, as fractions of it, with their labels.
pub fn ticks(axis: &Axis) -> Vec<(f64, String)> {
    let (from, to, scale) = match &axis.values {
        Values::Range { from, to, scale, .. } => (*from, *to, *scale),
        Values::List(values) => {
            let stride = values.len().div_ceil(8);
            let numbers = values.iter().enumerate().step_by(stride);
            return numbers.map(|(k, value)| ((k as f64 + 0.5) / values.len() as f64, value.to_string())).collect();
        }
    };
    let values = svg::ticks([from.min(to), from.max(to)], scale == Scale::Log);
    values.into_iter().map(|x| (axis.share(x), written(x))).collect()
}

/// A number of an axis, without trailing zeros.
pub fn written(x: f64) -> String {
    if x != 0.0 && !(1e-3..1e6).contains(&x.abs()) { format!("{x:e}") } else { trimmed(&format!("{x:.6}")).to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of each class the largest region has a name, inside, unless it is small or unknown.
    #[test]
    fn regions_have_names_inside() {
        let rows = ["aaaaaa", "abbbaa", "abbbac", "abbba?", "aaaaa?"];
        let class = |letter: char| if letter == '?' { u8::MAX } else { letter as u8 - b'a' };
        let edges = |count: usize| (0..=count).map(|edge| edge as f64 / count as f64).collect::<Vec<_>>();
        let mut slice = Slice {
            size: [6, 5],
            edges: [edges(6), edges(5)],
            classes: rows.iter().flat_map(|row| row.chars().map(class)).collect(),
            ..Slice::default()
        };
        let named = regions(&slice);
        assert_eq!(named.iter().map(|(class, _)| *class).collect::<Vec<_>>(), [0, 1, 2]);
        let cell = |[x, y]: [f64; 2]| slice.classes[(y * 5.0) as usize * 6 + (x * 6.0) as usize];
        assert!(named.iter().all(|&(class, at)| cell(at) == class), "{named:?}");
        assert_eq!(named[1].1.map(|share| (share * 60.0).round()), [25.0, 30.0], "the middle of its region");
        let line = Slice {
            size: [7, 1],
            edges: [edges(7), edges(1)],
            classes: "aaaaabb".chars().map(class).collect(),
            ..Slice::default()
        };
        assert!((7.0 * regions(&line)[0].1[0] - 2.5).abs() < 1e-12, "the middle of its part of a line");
        slice.edges[0] = [0.0, 0.2, 0.4, 0.6, 0.8, 0.99, 1.0].to_vec();
        assert_eq!(regions(&slice).len(), 2, "the last column is thin");
    }
}
