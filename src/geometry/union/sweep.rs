//! Overlapping boxes, by sweep and prune along x.

use super::body::Aabb;

/// Pairs of overlapping boxes, each ascending, in ascending order.
pub fn body_pairs(boxes: &[Aabb]) -> Vec<[u32; 2]> {
    let everything: Vec<u32> = (0..boxes.len() as u32).collect();
    let mut pairs = Vec::new();
    sweep(&everything, boxes, &everything, boxes, |a, b| {
        if a < b {
            pairs.push([a, b]);
        }
    });
    pairs.sort_unstable();
    pairs
}

/// Calls `meet` for every element of `first` and every element of `second` whose boxes overlap.
pub fn sweep(
    first: &[u32],
    first_boxes: &[Aabb],
    second: &[u32],
    second_boxes: &[Aabb],
    mut meet: impl FnMut(u32, u32),
) {
    let sorted = |list: &[u32], boxes: &[Aabb]| {
        let mut list = list.to_vec();
        list.sort_unstable_by(|&a, &b| boxes[a as usize].min.x.total_cmp(&boxes[b as usize].min.x).then(a.cmp(&b)));
        list
    };
    let (first, second) = (sorted(first, first_boxes), sorted(second, second_boxes));
    let (mut i, mut j) = (0, 0);
    while i < first.len() && j < second.len() {
        let (a, b) = (first_boxes[first[i] as usize], second_boxes[second[j] as usize]);
        // The box that starts first overlaps those of the other list that start within it.
        if a.min.x <= b.min.x {
            for &other in second[j..].iter().take_while(|&&o| second_boxes[o as usize].min.x <= a.max.x) {
                if a.meets(&second_boxes[other as usize]) {
                    meet(first[i], other);
                }
            }
            i += 1;
        } else {
            for &other in first[i..].iter().take_while(|&&o| first_boxes[o as usize].min.x <= b.max.x) {
                if b.meets(&first_boxes[other as usize]) {
                    meet(other, second[j]);
                }
            }
            j += 1;
        }
    }
}
