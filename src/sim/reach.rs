//! Who can touch whom: a sweep over balls that hold everything a body can touch or be touched at in a step.

use glam::DVec3;

/// A ball that bounds where a body acts or can be acted on during a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ball {
    /// [scene unit]
    pub centre: DVec3,
    /// [scene unit]
    pub radius: f64,
}

/// Sort and sweep along x (Baraff 1992), the order kept from step to step: near-sorted input sorts in O(n).
#[derive(Clone, Debug, Default)]
pub struct Sweep {
    order: Vec<u32>,
}

impl Sweep {
    /// Appends every pair `(a, b)`, a < b, of balls that overlap, in ascending order.
    pub fn overlapping(&mut self, balls: &[Ball], found: &mut Vec<(u32, u32)>) {
        if self.order.len() != balls.len() {
            self.order.clear();
            self.order.extend(0..balls.len() as u32);
        }
        let low = |i: u32| balls[i as usize].centre.x - balls[i as usize].radius;
        self.order.sort_by(|&i, &j| low(i).total_cmp(&low(j)));

        let first = found.len();
        for (position, &i) in self.order.iter().enumerate() {
            let ball = balls[i as usize];
            let high = ball.centre.x + ball.radius;
            for &j in &self.order[position + 1..] {
                if low(j) > high {
                    break;
                }
                let other = balls[j as usize];
                let touching = ball.radius + other.radius;
                if ball.centre.distance_squared(other.centre) <= touching * touching {
                    found.push((i.min(j), i.max(j)));
                }
            }
        }
        found[first..].sort_unstable();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_sweep_finds_what_all_pairs_find(
            balls in prop::collection::vec((prop::array::uniform3(-5.0..5.0), 0.0..2.0), 0..40),
            moved in prop::collection::vec((prop::array::uniform3(-5.0..5.0), 0.0..2.0), 0..40),
        ) {
            let mut sweep = Sweep::default();
            for set in [&balls, &moved] {
                let set: Vec<Ball> = set.iter().map(|&(c, radius)| Ball { centre: c.into(), radius }).collect();
                let mut found = vec![];
                sweep.overlapping(&set, &mut found);
                let mut expected = vec![];
                for a in 0..set.len() {
                    for b in a + 1..set.len() {
                        if set[a].centre.distance(set[b].centre) <= set[a].radius + set[b].radius {
                            expected.push((a as u32, b as u32));
                        }
                    }
                }
                prop_assert_eq!(found, expected);
            }
        }
    }
}
