//! Refinement: where neighbours differ in outcome, or by more than a jump in a measure, the grid is halved, level by
//! level.
//!
//! A cell lies between neighbours of the grid of a level: it has 2ⁿ corners if n axes are ranges. It is divided if two
//! of its known points differ: its corners, or points of finer levels on its faces. All 3ⁿ points of its halves are
//! then required. This is repeated up to the last level, so that every cell of the last level whose corners or faces
//! show a boundary is resolved. A region smaller than the cells of the first grid may be missed: the first grid must
//! hit every region.
//!
//! The required points depend only on the results of runs, not on their order. A level can therefore be divided among
//! machines, and an interrupted sweep resumes with the same rows.

use std::{
    collections::{BTreeMap, BTreeSet, HashMap, HashSet},
    ops::Range,
};

use super::{
    Sweep,
    design::{Axis, Design, Place},
    row::Cell,
};

/// The results of a run that decide where the grid is refined.
#[derive(Clone, Debug)]
pub struct Given {
    /// The class of its outcome.
    pub class: u8,
    /// The measures whose jumps count, in the order of [`Sweep::jumps`]; NaN if missing.
    pub measures: Box<[f64]>,
}

impl Given {
    /// Reads the cells of the columns listed by [`columns`].
    pub fn new(sweep: &Sweep, cells: &[Cell]) -> Given {
        let measures = cells.iter().skip(1).map(|cell| match cell {
            Cell::Float(number) => *number,
            Cell::Integer(count) => *count as f64,
            _ => f64::NAN,
        });
        Given { class: sweep.classes.of(cells.first()), measures: measures.collect() }
    }
}

/// The columns that decide where the grid of a sweep is refined.
pub fn columns(sweep: &Sweep) -> Vec<&str> {
    std::iter::once("outcome").chain(sweep.jumps.iter().map(|(name, _)| name.as_str())).collect()
}

/// The known points of a grid, and its divided cells.
pub struct Known<'a> {
    design: &'a Design,
    /// Largest difference of each measure between neighbours.
    jumps: Vec<f64>,
    /// The last level.
    last: u32,
    given: HashMap<u64, Given>,
    /// Divided cells, by level and first corner.
    divided: HashSet<(u32, Vec<u64>)>,
    wanted: BTreeSet<u64>,
}

impl<'a> Known<'a> {
    /// Starts without points, for a sweep refined up to level `last`.
    pub fn new(sweep: &'a Sweep, last: u32) -> Known<'a> {
        Known::of(&sweep.design, sweep.jumps.iter().map(|(_, jump)| *jump).collect(), last)
    }

    fn of(design: &'a Design, jumps: Vec<f64>, last: u32) -> Known<'a> {
        Known { design, jumps, last, given: HashMap::new(), divided: HashSet::new(), wanted: BTreeSet::new() }
    }

    /// The axes.
    pub fn design(&self) -> &'a Design {
        self.design
    }

    /// Adds the results of rows, and divides cells accordingly.
    pub fn add(&mut self, rows: BTreeMap<u64, Given>) {
        for row in rows.keys() {
            self.wanted.remove(row);
        }
        let new: Vec<u64> = rows.keys().copied().collect();
        self.given.extend(rows);
        if self.last == 0 {
            return;
        }
        // first the cells of level 0, then the consequences of points within them
        let corners: Vec<Vec<u64>> =
            new.iter().filter_map(|&row| self.design.place(row)).flat_map(|place| self.first_cells(&place)).collect();
        for corner in corners {
            self.consider(0, corner);
        }
        loop {
            let before = self.divided.len();
            let mut rows: Vec<u64> = self.given.keys().copied().collect();
            rows.sort_unstable();
            for row in rows {
                if let Some(place) = self.design.place(row).filter(|place| place.level > 0) {
                    self.descend(row, &place);
                }
            }
            if self.divided.len() == before {
                break;
            }
        }
    }

    /// The rows to run next, in order.
    pub fn wanted(&self) -> Vec<u64> {
        self.wanted.iter().copied().collect()
    }

    /// The result of the run at a grid point, if known.
    fn at(&self, level: u32, index: &[u64]) -> Option<&Given> {
        self.given.get(&self.design.row(level, index))
    }

    fn differ(&self, a: &Given, b: &Given) -> bool {
        let jumps = || self.jumps.iter().zip(a.measures.iter().zip(&b.measures));
        a.class != b.class || jumps().any(|(jump, (a, b))| a.is_nan() != b.is_nan() || (a - b).abs() > *jump)
    }

    /// Whether a cell is divided.
    pub fn is_divided(&self, level: u32, corner: &[u64]) -> bool {
        self.divided.contains(&(level, corner.to_vec()))
    }

    /// The cells of level 0 that have this point as a corner; none for a point of a finer level.
    fn first_cells(&self, place: &Place) -> Vec<Vec<u64>> {
        if place.level > 0 { Vec::new() } else { self.cells_at(0, place) }
    }

    /// The cells of a level that contain a point, inside or on a face. The level must not be finer than the point's.
    fn cells_at(&self, level: u32, place: &Place) -> Vec<Vec<u64>> {
        let shift = place.level - level;
        self.combinations(&place.index, |axis, index| {
            let cell_count = axis.count(level).unwrap_or(1) - 1;
            let (whole, is_on_grid) = (index >> shift, index & ((1 << shift) - 1) == 0);
            whole.saturating_sub(u64::from(is_on_grid))..cell_count.min(whole + 1)
        })
    }

    /// The points of a cell on the grid `finer` levels below: 2ⁿ corners for 0, 3ⁿ points for 1.
    fn points(&self, corner: &[u64], finer: u32) -> Vec<Vec<u64>> {
        self.combinations(corner, |_, index| index << finer..((index + 1) << finer) + 1)
    }

    /// All combinations of the indices that `choices` gives for an axis with a range; other axes keep theirs.
    fn combinations(&self, index: &[u64], choices: impl Fn(&Axis, u64) -> Range<u64>) -> Vec<Vec<u64>> {
        let mut all = vec![Vec::with_capacity(index.len())];
        for (axis, &index) in self.design.axes.iter().zip(index) {
            let choices = if axis.is_range() { choices(axis, index) } else { index..index + 1 };
            all =
                all.iter().flat_map(|one| choices.clone().map(move |choice| [&one[..], &[choice]].concat())).collect();
        }
        all
    }

    /// Divides a cell if its corners are known and two of them differ.
    fn consider(&mut self, level: u32, corner: Vec<u64>) {
        let corners: Option<Vec<&Given>> = self.points(&corner, 0).iter().map(|point| self.at(level, point)).collect();
        let differ = |corners: &[&Given]| {
            let pairs = corners.iter().enumerate();
            pairs.clone().any(|(index, a)| corners[..index].iter().any(|b| self.differ(a, b)))
        };
        if corners.is_some_and(|corners| differ(&corners)) {
            self.divide(level, corner);
        }
    }

    fn divide(&mut self, level: u32, corner: Vec<u64>) {
        if level >= self.last || !self.divided.insert((level, corner.clone())) {
            return;
        }
        for point in self.points(&corner, 1) {
            let row = self.design.row(level + 1, &point);
            if !self.given.contains_key(&row) {
                self.wanted.insert(row);
            }
        }
        for child in self.children(&corner) {
            self.consider(level + 1, child);
        }
    }

    fn children(&self, corner: &[u64]) -> Vec<Vec<u64>> {
        self.combinations(corner, |_, index| 2 * index..2 * index + 2)
    }

    /// Compares a point with the cells that contain it, from the first level to the first undivided cell.
    fn descend(&mut self, row: u64, place: &Place) {
        let Some(given) = self.given.get(&row).cloned() else { return };
        let mut cells: Vec<Vec<u64>> = self.cells_at(0, place);
        for level in 0..place.level {
            let mut next = Vec::new();
            let within: HashSet<Vec<u64>> = self.cells_at(level + 1, place).into_iter().collect();
            for cell in cells {
                if !self.is_divided(level, &cell)
                    && self.at(level, &cell).is_some_and(|known| self.differ(known, &given))
                {
                    self.divide(level, cell.clone());
                }
                if self.is_divided(level, &cell) {
                    next.extend(self.children(&cell).into_iter().filter(|child| within.contains(child)));
                }
            }
            for cell in &next {
                self.consider(level + 1, cell.clone());
            }
            cells = next;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        scene::template::{KeyPath, Setting},
        sweep::design::{Sampling, Scale, Values},
    };

    fn design(counts: &[u64]) -> Design {
        let axes = counts.iter().map(|&count| Axis {
            key: KeyPath::parse("dt").unwrap(),
            name: None,
            values: Values::Range { from: 0.0, to: 1.0, count, scale: Scale::Linear },
        });
        Design { axes: axes.collect(), sampling: Sampling::Grid }
    }

    /// Refines with outcomes given by a rule, and checks that the cells predict every point of the last level. Returns
    /// the number of runs.
    fn refine(design: &Design, last: u32, rule: impl Fn(&[f64]) -> u8) -> usize {
        let of_row = |row: u64| {
            let point = design.point(row).unwrap();
            let numbers: Vec<f64> =
                point.iter().map(|value| if let Setting::Number(x) = value { *x } else { 0.0 }).collect();
            rule(&numbers)
        };
        let mut known = Known::of(design, vec![], last);
        let mut wanted: Vec<u64> = (0..design.count().unwrap()).collect();
        let mut runs = 0;
        while !wanted.is_empty() {
            runs += wanted.len();
            known.add(wanted.iter().map(|&row| (row, Given { class: of_row(row), measures: [].into() })).collect());
            wanted = known.wanted();
        }
        let mut wrong = 0;
        for linear in 0..design.size(last).unwrap() {
            let count = design.axes[0].count(last).unwrap();
            let index = [linear / count, linear % count];
            let row = design.row(last, &index);
            let mut predicted = None;
            let place = Place { level: last, index: index.to_vec() };
            for level in 0..=last {
                for cell in known.cells_at(level, &place) {
                    if !known.is_divided(level, &cell)
                        && (level == 0 || known.is_divided(level - 1, &[cell[0] / 2, cell[1] / 2]))
                    {
                        predicted =
                            predicted.or(if level == last { known.at(last, &index) } else { known.at(level, &cell) }
                                .map(|given| given.class));
                    }
                }
            }
            wrong += usize::from(predicted != Some(of_row(row)));
        }
        assert_eq!(wrong, 0);
        runs
    }

    #[test]
    fn only_points_near_boundaries_are_run() {
        let design = design(&[9, 9]);
        let disc = |p: &[f64]| u8::from((p[0] - 0.47).hypot(p[1] - 0.52) < 0.31);
        let runs = refine(&design, 5, disc);
        let full = design.size(5).unwrap();
        assert!(runs < full as usize / 12, "{runs} of {full}");
        // three regions that meet, and a boundary along the grid
        refine(&design, 5, |p| if p[1] >= 0.5 { 2 } else { u8::from(p[0] * p[0] + 0.3 * p[1] > 0.4) });
        // a tongue that enters a coarse cell through a face between its corners
        refine(&design, 5, |p| u8::from(p[0] < 0.3 || p[0] < 0.7 && (p[1] - 0.56).abs() < 0.045 * (1.0 - p[0])));
    }

    #[test]
    fn a_jump_of_a_measure_is_refined_like_a_boundary() {
        let (design, last) = (design(&[9]), 6);
        let front = 0.377;
        let measure = |x: f64| if x < front { 0.1 * x } else { 0.1 * x + 0.5 };
        let mut known = Known::of(&design, vec![0.2], last);
        let mut wanted: Vec<u64> = (0..9).collect();
        let mut nearest = [0.0f64, 1.0];
        let mut runs = 0;
        while !wanted.is_empty() {
            runs += wanted.len();
            let given = |&row: &u64| {
                let Some(Setting::Number(x)) = design.point(row).unwrap().pop() else { unreachable!() };
                nearest = if x < front { [nearest[0].max(x), nearest[1]] } else { [nearest[0], nearest[1].min(x)] };
                (row, Given { class: 0, measures: [measure(x)].into() })
            };
            known.add(wanted.iter().map(given).collect());
            wanted = known.wanted();
        }
        assert_eq!((runs, nearest[1] - nearest[0]), (9 + 6, 1.0 / (8.0 * 64.0)));
    }
}
