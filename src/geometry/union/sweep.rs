//! Overlapping boxes, by sweep and prune along an axis.

use std::convert::Infallible;

use super::body::Aabb;

/// Pairs of overlapping boxes, each ascending, in ascending order.
pub fn body_pairs(boxes: &[Aabb]) -> Vec<[u32; 2]> {
    let everything: Vec<u32> = (0..boxes.len() as u32).collect();
    let mut pairs = Vec::new();
    let Ok(()) = sweep::<Infallible>(0, [&everything; 2], [boxes; 2], |a, b| {
        if a < b {
            pairs.push([a, b]);
        }
        Ok(())
    });
    pairs.sort_unstable();
    pairs
}

/// The axis along which a sweep tests the fewest pairs of boxes, and their number.
pub fn best_axis(list: &[u32], boxes: &[Aabb]) -> (usize, u64) {
    let tests = |axis: usize| {
        let mut starts: Vec<f64> = list.iter().map(|&i| boxes[i as usize].min[axis]).collect();
        starts.sort_unstable_by(f64::total_cmp);
        let within = |&i: &u32| {
            let Aabb { min, max } = boxes[i as usize];
            let from = starts.partition_point(|&start| start < min[axis]);
            (starts.partition_point(|&start| start <= max[axis]).saturating_sub(from)) as u64
        };
        list.iter().map(within).sum::<u64>()
    };
    let of_axes = [tests(0), tests(1), tests(2)];
    let best = (0..3).min_by_key(|&axis| of_axes[axis]).unwrap_or(0);
    (best, of_axes[best])
}

/// Calls `meet` for every pair of an element of the first list and one of the second whose boxes overlap, until it fails.
/// Boxes are indexed by element. The sweep is fastest along an axis on which the boxes are spread out.
pub fn sweep<E>(
    axis: usize,
    lists: [&[u32]; 2],
    boxes: [&[Aabb]; 2],
    mut meet: impl FnMut(u32, u32) -> Result<(), E>,
) -> Result<(), E> {
    let sorted = [0, 1].map(|k| {
        let start = |i: u32| boxes[k][i as usize].min[axis];
        let mut list: Vec<(f64, u32)> = lists[k].iter().map(|&i| (start(i), i)).collect();
        list.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        list
    });
    let [first, second] = &sorted;
    let (mut i, mut j) = (0, 0);
    while i < first.len() && j < second.len() {
        // The box that starts first overlaps those of the other list that start within it.
        if first[i].0 <= second[j].0 {
            let own = &boxes[0][first[i].1 as usize];
            for &(_, other) in second[j..].iter().take_while(|other| other.0 <= own.max[axis]) {
                if own.meets(&boxes[1][other as usize]) {
                    meet(first[i].1, other)?;
                }
            }
            i += 1;
        } else {
            let own = &boxes[1][second[j].1 as usize];
            for &(_, other) in first[i..].iter().take_while(|other| other.0 <= own.max[axis]) {
                if own.meets(&boxes[0][other as usize]) {
                    meet(other, second[j].1)?;
                }
            }
            j += 1;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Boxes that all overlap have n² pairs: the callback can end the search.
    #[test]
    fn a_sweep_ends_where_a_pair_fails() {
        let boxes = vec![Aabb { min: glam::DVec3::ZERO, max: glam::DVec3::ONE }; 100];
        let everything: Vec<u32> = (0..100).collect();
        for most in [1, 37, 9_999] {
            let mut met = 0;
            let count = |_, _| {
                met += 1;
                if met == most { Err(met) } else { Ok(()) }
            };
            assert_eq!(sweep(0, [&everything; 2], [&boxes; 2], count), Err(most));
        }
        let mut met = 0;
        let count = |_, _| {
            met += 1;
            Ok::<(), ()>(())
        };
        assert_eq!((sweep(0, [&everything; 2], [&boxes; 2], count), met), (Ok(()), 10_000));
    }
}
