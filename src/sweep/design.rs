//! The points of a sweep and their row numbers.
//!
//! # Rows
//! A row is a point, and its number is a function of the point alone, so it does not depend on how a sweep is refined,
//! resumed or divided among machines. On a grid, rows are counted level by level, and within a level with the last axis
//! fastest. Level 0 is the grid of the file; each further level halves the spacing on every axis that is a range. A
//! point belongs to the first level that contains it.

use crate::{
    hash::{SEED, mix},
    random::unit,
    scene::template::{KeyPath, Setting},
};

/// Maximum number of runs of a sweep.
pub const MOST_ROWS: u64 = 100_000_000;
/// Maximum number of refinement levels.
pub const MOST_LEVELS: u32 = 20;

/// The axes of a sweep, and its sampling.
#[derive(Clone, Debug)]
pub struct Design {
    /// The axes; at least one.
    pub axes: Vec<Axis>,
    /// How points are chosen.
    pub sampling: Sampling,
}

/// An axis of a sweep.
#[derive(Clone, Debug)]
pub struct Axis {
    /// The key that varies.
    pub key: KeyPath,
    /// Its name on the map; `None` for the key.
    pub name: Option<String>,
    /// Its values.
    pub values: Values,
}

/// The values of an axis.
#[derive(Clone, Debug)]
pub enum Values {
    /// A range.
    Range {
        /// The first value.
        from: f64,
        /// The last value.
        to: f64,
        /// Number of values on a grid, including both ends.
        count: u64,
        /// Spacing of the values.
        scale: Scale,
    },
    /// A list of values.
    List(Vec<Setting>),
}

/// Spacing of the values of an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// Constant difference between neighbours.
    Linear,
    /// Constant ratio between neighbours.
    Log,
}

/// How points are chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sampling {
    /// Every combination of the axes' values.
    Grid,
    /// A Latin hypercube: each axis is divided into as many intervals as there are points, with one point in each.
    Latin {
        /// Number of points.
        count: u64,
        /// Seed of the permutations.
        seed: u64,
    },
    /// A Sobol sequence with a random shift (Sobol 1967; direction numbers of Joe and Kuo 2008).
    Sobol {
        /// Number of points.
        count: u64,
        /// Seed of the shift.
        seed: u64,
    },
}

impl Axis {
    /// Its name on the map.
    pub fn label(&self) -> String {
        self.name.clone().unwrap_or_else(|| self.key.to_string())
    }

    /// Number of values on the grid of a level.
    pub fn count(&self, level: u32) -> Option<u64> {
        match &self.values {
            Values::Range { count, .. } => {
                (count - 1).checked_shl(level).filter(|n| n >> level == count - 1)?.checked_add(1)
            }
            Values::List(values) => Some(values.len() as u64),
        }
    }

    /// Whether each level adds values to it.
    pub fn is_range(&self) -> bool {
        matches!(self.values, Values::Range { .. })
    }

    /// Whether its values are numbers.
    pub fn is_number(&self) -> bool {
        match &self.values {
            Values::Range { .. } => true,
            Values::List(values) => matches!(values.first(), Some(Setting::Number(_))),
        }
    }

    /// The value at a fraction of a range, 0 to 1.
    pub fn at(&self, share: f64) -> Setting {
        match &self.values {
            Values::Range { from, to, scale, .. } => Setting::Number(match scale {
                _ if share <= 0.0 => *from,
                _ if share >= 1.0 => *to,
                Scale::Linear => from + (to - from) * share,
                Scale::Log => from * libm::pow(to / from, share),
            }),
            Values::List(values) => {
                let index = ((share * values.len() as f64) as usize).min(values.len() - 1);
                values[index].clone()
            }
        }
    }

    /// The position of a number as a fraction of the range: the inverse of [`Axis::at`].
    pub fn share(&self, value: f64) -> f64 {
        match &self.values {
            Values::Range { from, to, scale: Scale::Linear, .. } => (value - from) / (to - from),
            Values::Range { from, to, scale: Scale::Log, .. } => (value / from).ln() / (to / from).ln(),
            Values::List(values) => {
                let index = values.iter().position(|known| *known == Setting::Number(value)).unwrap_or(0);
                (index as f64 + 0.5) / values.len() as f64
            }
        }
    }

    /// The value at an index of the grid of a level.
    pub fn value(&self, level: u32, index: u64) -> Setting {
        match &self.values {
            Values::Range { count, .. } => {
                // powers of two cancel exactly, so the value does not depend on the level
                self.at(index as f64 / ((count - 1) << level) as f64)
            }
            Values::List(values) => values[index as usize].clone(),
        }
    }

    /// Number of values to validate before a sweep starts: those of the grid or list.
    pub fn sample_count(&self) -> u64 {
        self.count(0).unwrap_or(2)
    }

    /// One of the values to validate.
    pub fn sample(&self, index: u64) -> Setting {
        self.value(0, index)
    }
}

/// A point of the grid of a level.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Place {
    /// The first level that contains it.
    pub level: u32,
    /// Its index on each axis.
    pub index: Vec<u64>,
}

impl Design {
    /// Number of rows without refinement; `None` if it exceeds 64 bits.
    pub fn count(&self) -> Option<u64> {
        match self.sampling {
            Sampling::Grid => self.size(0),
            Sampling::Latin { count, .. } | Sampling::Sobol { count, .. } => Some(count),
        }
    }

    /// Number of points of the grid of a level; `None` if it exceeds 64 bits.
    pub fn size(&self, level: u32) -> Option<u64> {
        self.axes.iter().try_fold(1u64, |size, axis| size.checked_mul(axis.count(level)?))
    }

    /// The finest level whose rows can be numbered.
    pub fn most_levels(&self) -> u32 {
        let mut sum = 0u64;
        let numbered = |level: &u32| match self.size(*level).and_then(|size| sum.checked_add(size)) {
            Some(total) => {
                sum = total;
                true
            }
            None => false,
        };
        (0..=MOST_LEVELS).take_while(numbered).last().unwrap_or(0)
    }

    /// The row number of the point `index` on the grid of `level`, which is at most [`Design::most_levels`].
    pub fn row(&self, mut level: u32, index: &[u64]) -> u64 {
        let mut index: Vec<u64> = index.to_vec();
        let ranges = || self.axes.iter().map(Axis::is_range);
        while level > 0 && index.iter().zip(ranges()).all(|(index, is_range)| !is_range || index % 2 == 0) {
            index.iter_mut().zip(ranges()).filter(|(_, is_range)| *is_range).for_each(|(index, _)| *index /= 2);
            level -= 1;
        }
        let before: u64 = (0..level).filter_map(|level| self.size(level)).sum();
        let digits = index.iter().zip(&self.axes);
        before + digits.fold(0, |sum, (index, axis)| sum * axis.count(level).unwrap_or(1) + index)
    }

    /// The grid point of a row.
    pub fn place(&self, row: u64) -> Option<Place> {
        let (mut level, mut rest) = (0, row);
        loop {
            let size = self.size(level)?;
            if rest < size {
                break;
            }
            if !self.axes.iter().any(Axis::is_range) {
                return None;
            }
            (rest, level) = (rest - size, level + 1);
        }
        let mut index = vec![0; self.axes.len()];
        for (slot, axis) in index.iter_mut().zip(&self.axes).rev() {
            let count = axis.count(level)?;
            (*slot, rest) = (rest % count, rest / count);
        }
        Some(Place { level, index })
    }

    /// The values of a row's axes.
    pub fn point(&self, row: u64) -> Option<Vec<Setting>> {
        match self.sampling {
            Sampling::Latin { count, .. } | Sampling::Sobol { count, .. } if row >= count => None,
            Sampling::Grid => {
                let Place { level, index } = self.place(row)?;
                Some(self.axes.iter().zip(&index).map(|(axis, &index)| axis.value(level, index)).collect())
            }
            Sampling::Latin { count, seed } => {
                Some(self.axes.iter().zip(0..).map(|(axis, k)| axis.at(latin(row, count, seed, k))).collect())
            }
            Sampling::Sobol { seed, .. } => {
                Some(self.axes.iter().zip(0..).map(|(axis, k)| axis.at(sobol(row, seed, k))).collect())
            }
        }
    }
}

/// The coordinate of a row of a Latin hypercube on axis `k`, in [0, 1). Its interval is a permutation of the row: a
/// Feistel network over the next power of four, iterated until the value is in range (cycle walking), which needs no
/// table.
fn latin(row: u64, count: u64, seed: u64, k: u64) -> f64 {
    let key = mix(mix(seed.wrapping_add(SEED)).wrapping_add(k));
    let bits = (64 - (count.max(2) - 1).leading_zeros()).div_ceil(2);
    let mask = (1u64 << bits) - 1;
    let mut x = row;
    loop {
        let (mut left, mut right) = (x >> bits, x & mask);
        for round in 0..6 {
            (left, right) = (right, left ^ (mix(key ^ mix(right.wrapping_add(round << 40))) & mask));
        }
        x = left << bits | right;
        if x < count {
            break;
        }
    }
    let within = unit(mix(key.wrapping_add(mix(row.wrapping_add(1)))));
    (x as f64 + within) / count as f64
}

/// Degree, coefficients and first direction numbers of the second and higher dimensions (Joe and Kuo 2008).
const DIRECTIONS: [(u32, u32, &[u32]); 7] = [
    (1, 0, &[1]),
    (2, 1, &[1, 3]),
    (3, 1, &[1, 3, 1]),
    (3, 2, &[1, 1, 1]),
    (4, 1, &[1, 1, 3, 3]),
    (4, 4, &[1, 3, 5, 13]),
    (5, 2, &[1, 1, 5, 5, 17]),
];

/// The coordinate of a point of the Sobol sequence on axis `k`.
fn sobol(row: u64, seed: u64, k: u64) -> f64 {
    let mut numbers = [0u32; 32];
    match (k as usize).checked_sub(1).and_then(|k| DIRECTIONS.get(k)) {
        None => numbers.iter_mut().zip(0..).for_each(|(number, i)| *number = 1 << (31 - i)),
        Some(&(degree, coefficients, first)) => {
            let degree = degree as usize;
            for i in 0..32 {
                numbers[i] = if i < degree {
                    first[i] << (31 - i)
                } else {
                    let mut number = numbers[i - degree] ^ (numbers[i - degree] >> degree);
                    for j in 1..degree {
                        if coefficients >> (degree - 1 - j) & 1 == 1 {
                            number ^= numbers[i - j];
                        }
                    }
                    number
                };
            }
        }
    }
    let gray = row ^ (row >> 1);
    let point = (0..32).filter(|i| gray >> i & 1 == 1).fold(0, |sum, i| sum ^ numbers[i]);
    let shift = mix(mix(seed).wrapping_add(k));
    let shifted = u64::from(point ^ (shift >> 32) as u32) << 32 | (shift & 0xffff_ffff);
    unit(shifted)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn range(from: f64, to: f64, count: u64, scale: Scale) -> Axis {
        let values = Values::Range { from, to, count, scale };
        Axis { key: KeyPath::parse("influence.alpha").unwrap(), name: None, values }
    }

    #[test]
    fn rows_and_points_are_one_to_one() {
        let list = vec![Setting::Number(1.0), Setting::Number(5.0)];
        let axes = vec![
            range(0.0, 1.0, 3, Scale::Linear),
            Axis { values: Values::List(list), ..range(0.0, 1.0, 2, Scale::Linear) },
            range(1.0, 16.0, 5, Scale::Log),
        ];
        let design = Design { axes, sampling: Sampling::Grid };
        assert_eq!([design.size(0), design.size(1)], [Some(30), Some(5 * 2 * 9)]);
        let mut seen = std::collections::BTreeSet::new();
        for level in 0..3 {
            let counts: Vec<u64> = design.axes.iter().map(|axis| axis.count(level).unwrap()).collect();
            for linear in 0..design.size(level).unwrap() {
                let index = [linear / (counts[1] * counts[2]), linear / counts[2] % counts[1], linear % counts[2]];
                let row = design.row(level, &index);
                let place = design.place(row).unwrap();
                assert!(place.level <= level);
                assert_eq!(design.row(place.level, &place.index), row);
                let values: Vec<Setting> =
                    design.axes.iter().zip(index).map(|(axis, index)| axis.value(level, index)).collect();
                assert_eq!(design.point(row).unwrap(), values);
                seen.insert(row);
            }
        }
        assert_eq!(seen.len() as u64, design.size(2).unwrap());
        let Setting::Number(middle) = design.axes[2].value(0, 2) else { panic!() };
        assert!((middle - 4.0).abs() < 1e-12);
    }

    #[test]
    fn a_latin_hypercube_has_one_point_in_each_interval() {
        for (count, seed) in [(1, 0), (2, 5), (100, 1), (257, 2)] {
            for k in 0..3 {
                let mut hit = vec![false; count as usize];
                for row in 0..count {
                    let share = latin(row, count, seed, k);
                    assert!((0.0..1.0).contains(&share));
                    hit[(share * count as f64) as usize] = true;
                }
                assert!(hit.iter().all(|hit| *hit), "{count} {k}");
            }
        }
    }

    /// With 2^m points, every interval of length 2^−m on each axis contains one, and so does every elementary rectangle
    /// of the first two axes.
    #[test]
    fn sobol_points_are_a_net() {
        for k in 0..8 {
            let mut hit = [false; 64];
            (0..64).for_each(|row| hit[(sobol(row, 7, k) * 64.0) as usize] = true);
            assert!(hit.iter().all(|hit| *hit), "axis {k}");
        }
        for log in 0..=6 {
            let (columns, rows) = (1usize << log, 64usize >> log);
            let mut hit = [false; 64];
            for row in 0..64 {
                let (x, y) = (sobol(row, 3, 0), sobol(row, 3, 1));
                hit[(x * columns as f64) as usize * rows + (y * rows as f64) as usize] = true;
            }
            assert!(hit.iter().all(|hit| *hit), "{columns} columns");
        }
    }
}
