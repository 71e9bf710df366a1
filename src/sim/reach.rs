//! Broad phase: a hierarchical grid of balls, each of which bounds where a body can act or be acted on for some time.
//!
//! For balls of very different sizes, there is one grid per power of two: a ball is in one cell of the grid whose cells
//! are just larger than it (Ericson, Real-Time Collision Detection, 7.2.1). A body that stays within its ball costs
//! nothing; one that leaves it is reinserted, in time proportional to the number of nearby bodies.

use std::{collections::HashMap, hash::BuildHasherDefault};

use glam::DVec3;
use rustc_hash::FxHasher;

/// A ball that bounds where a body acts or can be acted on.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ball {
    /// Centre [scene unit].
    pub centre: DVec3,
    /// Radius [scene unit].
    pub radius: f64,
}

impl Ball {
    /// Whether two balls have a point in common.
    pub fn touches(&self, other: &Ball) -> bool {
        let touching = self.radius + other.radius;
        self.centre.distance_squared(other.centre) <= touching * touching
    }
}

/// Balls in a spatial index.
#[derive(Clone, Debug, Default)]
pub struct Grid {
    balls: Vec<Placed>,
    /// One grid per size class that occurs.
    levels: Vec<Level>,
}

/// The end of a list.
const NONE: u32 = u32::MAX;

#[derive(Clone, Copy, Debug)]
struct Placed {
    ball: Ball,
    /// Index of its grid, or [`NONE`] if the ball has not been placed.
    level: u32,
    /// The previous ball in the same cell, or [`NONE`].
    before: u32,
    /// The next ball in the same cell, or [`NONE`].
    after: u32,
}

#[derive(Clone, Debug)]
struct Level {
    /// The edge length of a cell is 2 to the power of this.
    exponent: i32,
    size: f64,
    /// The first ball in each non-empty cell.
    cells: HashMap<[i64; 3], u32, BuildHasherDefault<FxHasher>>,
    count: usize,
}

impl Level {
    /// The cell that contains a point; points beyond the range of i64 share the outermost cells.
    fn cell(&self, point: DVec3) -> [i64; 3] {
        (point / self.size).floor().to_array().map(|x| x as i64)
    }
}

impl Grid {
    /// Ball `i`, as placed.
    pub fn ball(&self, i: u32) -> &Ball {
        &self.balls[i as usize].ball
    }

    /// Inserts ball `i`, or moves it.
    pub fn place(&mut self, i: u32, ball: Ball) {
        let index = i as usize;
        if index >= self.balls.len() {
            let none = Placed { ball: Ball::default(), level: NONE, before: NONE, after: NONE };
            self.balls.resize(index + 1, none);
        }
        self.remove(index);
        let level = self.level_for(ball.radius);
        let cell = self.levels[level].cell(ball.centre);
        self.levels[level].count += 1;
        let head = self.levels[level].cells.entry(cell).or_insert(NONE);
        let after = std::mem::replace(head, i);
        if let Some(after) = self.balls.get_mut(after as usize) {
            after.before = i;
        }
        self.balls[index] = Placed { ball, level: level as u32, before: NONE, after };
    }

    /// Takes out ball `i`, if it has been placed.
    pub fn take(&mut self, i: u32) {
        self.remove(i as usize);
        self.balls[i as usize].level = NONE;
    }

    /// Takes out ball `i`, if it has been placed; the numbers of later ones decrease by one.
    pub fn forget(&mut self, i: u32) {
        if i as usize >= self.balls.len() {
            return;
        }
        self.take(i);
        self.balls.remove(i as usize);
        let shift = |number: &mut u32| *number -= u32::from(*number != NONE && *number > i);
        for Placed { before, after, .. } in &mut self.balls {
            shift(before);
            shift(after);
        }
        self.levels.iter_mut().flat_map(|level| level.cells.values_mut()).for_each(shift);
    }

    fn remove(&mut self, index: usize) {
        let Placed { ball, level, before, after } = self.balls[index];
        let Some(level) = self.levels.get_mut(level as usize) else { return };
        level.count -= 1;
        if before == NONE {
            let cell = level.cell(ball.centre);
            if after == NONE {
                level.cells.remove(&cell);
            } else {
                level.cells.insert(cell, after);
            }
        } else {
            self.balls[before as usize].after = after;
        }
        if let Some(after) = self.balls.get_mut(after as usize) {
            after.before = before;
        }
    }

    /// The grid whose cells are larger than a ball's diameter, but at most twice as large.
    fn level_for(&mut self, radius: f64) -> usize {
        let exponent = exponent_above(2.0 * radius);
        self.levels.iter().position(|level| level.exponent == exponent).unwrap_or_else(|| {
            let size = 2f64.powi(exponent);
            self.levels.push(Level { exponent, size, cells: HashMap::default(), count: 0 });
            self.levels.len() - 1
        })
    }

    /// Appends every ball that touches ball `i`, which has been placed; in ascending order.
    pub fn touching(&self, i: u32, found: &mut Vec<u32>) {
        let first = found.len();
        self.each_touching(i, |other| found.push(other));
        found[first..].sort_unstable();
    }

    /// Finds every ball that touches ball `i`, which has been placed.
    pub fn each_touching(&self, i: u32, mut found: impl FnMut(u32)) {
        let ball = self.balls[i as usize].ball;
        for level in &self.levels {
            let mut look = |mut head: u32| {
                while let Some(placed) = self.balls.get(head as usize) {
                    if head != i && placed.ball.touches(&ball) {
                        found(head);
                    }
                    head = placed.after;
                }
            };
            // a touching ball of this grid has its centre within this distance along each axis
            let far = ball.radius + 0.5 * level.size;
            let far = far + 1e-12 * (far + ball.centre.abs().max_element());
            let (low, high) = (level.cell(ball.centre - far), level.cell(ball.centre + far));
            let cells: f64 = (0..3).map(|axis| high[axis] as f64 - low[axis] as f64 + 1.0).product();
            if cells > level.count as f64 {
                level.cells.values().for_each(|&head| look(head));
                continue;
            }
            for x in low[0]..=high[0] {
                for y in low[1]..=high[1] {
                    for z in low[2]..=high[2] {
                        if let Some(&head) = level.cells.get(&[x, y, z]) {
                            look(head);
                        }
                    }
                }
            }
        }
    }
}

/// The smallest n for which 2ⁿ exceeds `x`, for any `x` that is not NaN.
fn exponent_above(x: f64) -> i32 {
    let biased = (x.to_bits() >> 52 & 0x7ff) as i32;
    (biased - 1022).clamp(-1000, 1000)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn balls() -> impl Strategy<Value = Vec<Ball>> {
        let ball = (prop::array::uniform3(-5.0..5.0), -8.0..2.0)
            .prop_map(|(centre, size): ([f64; 3], f64)| Ball { centre: centre.into(), radius: size.exp2() });
        prop::collection::vec(ball, 1..40)
    }

    proptest! {
        #[test]
        fn the_grid_finds_what_all_pairs_find(before in balls(), after in balls()) {
            let mut grid = Grid::default();
            let count = before.len().min(after.len());
            for set in [&before, &after] {
                for i in 0..count {
                    grid.place(i as u32, set[i]);
                }
                for i in 0..count {
                    let mut found = vec![];
                    grid.touching(i as u32, &mut found);
                    let touches = |&j: &u32| j != i as u32 && set[i].touches(&set[j as usize]);
                    let expected: Vec<u32> = (0..count as u32).filter(touches).collect();
                    prop_assert_eq!(found, expected);
                }
            }
        }
    }

    /// Sizes and positions at the ends of the range of f64.
    #[test]
    fn extreme_balls_are_found() {
        let mut grid = Grid::default();
        let ball = |x: f64, radius| Ball { centre: DVec3::new(x, 0.0, 0.0), radius };
        let all = [ball(0.0, 1e-300), ball(0.0, 1e300), ball(1e300, 1.0), ball(-1e9, 1e-3), ball(-1e9, 1e9)];
        for (i, &ball) in (0..).zip(&all) {
            grid.place(i, ball);
        }
        let mut found = vec![];
        grid.touching(1, &mut found);
        assert_eq!(found, [0, 2, 3, 4]);
    }
}
