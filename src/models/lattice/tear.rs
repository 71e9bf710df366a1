//! The two ways to tear a lattice (2.2.2, Fig. 2.2).
//!
//! - `cut` (Fig. 2.2b; [11, 12] of the thesis): an overstretched spring is cut with all springs of its cells. That is
//!   cheap, but the volume of the cells is lost; their mass stays at the nodes that are left.
//! - `split` (Fig. 2.2c; [9, 12]): an overloaded node becomes two, one for the cells on either side of the plane across
//!   which the tension is strongest, and the springs are rebuilt. The volume is kept.
//!
//! Both limits are strains, so that they can be compared: a spring is cut at the length (1 + limit) L; a node is split
//! at the force of a bar under the strain `limit` on the node's share of its section, E · limit · h²/4 for each pair of
//! cells separated by the plane.

use glam::DVec3;

use super::{Lattice, SHARES};

/// The corner of a cell at which a node is: one bit per axis, clear if the cell is on the node's far side.
type Sides = u8;

/// A node to be split, and the axis of its plane.
struct Split {
    node: u32,
    axis: usize,
}

impl Lattice {
    /// Cuts the cells with springs longer than (1 + limit) L, and returns them. Nodes without remaining cells leave the
    /// body, and are held from now on.
    pub fn cut(&mut self, positions: &[DVec3], limit: f64) -> Vec<usize> {
        let is_torn = |corners: &[u32; 8]| {
            (0..8).any(|i| {
                (0..i).any(|j| {
                    let [a, b] = [corners[i] as usize, corners[j] as usize];
                    let rest = self.rest[a].distance(self.rest[b]);
                    positions[a].distance(positions[b]) > (1.0 + limit) * rest
                })
            })
        };
        let torn = (0..self.corners.len()).filter(|&cell| self.is_whole[cell] && is_torn(&self.corners[cell]));
        let torn: Vec<usize> = torn.collect();
        torn.iter().for_each(|&cell| self.is_whole[cell] = false);
        if !torn.is_empty() {
            self.connect(None); // not interruptible: fewer cells than before
            let mut is_left = vec![false; self.node_count()];
            let whole = self.corners.iter().zip(&self.is_whole).filter(|(_, is_whole)| **is_whole);
            whole.flat_map(|(corners, _)| corners).for_each(|&node| is_left[node as usize] = true);
            self.held.iter_mut().zip(is_left).for_each(|(held, is_left)| *held |= !is_left);
        }
        torn
    }

    /// Splits the nodes whose load exceeds that of a strain of `limit`, and returns them in the order of the added
    /// nodes, each of which has the state of its original.
    pub fn split(&mut self, positions: &[DVec3], limit: f64) -> Vec<u32> {
        let splits = self.overloaded(positions, limit);
        if splits.is_empty() {
            return Vec::new();
        }
        let mut axis_of = vec![None; self.node_count()];
        splits.iter().for_each(|split| axis_of[split.node as usize] = Some(split.axis));
        let mut copy_of = vec![u32::MAX; self.node_count()];
        for (copy, split) in (self.node_count() as u32..).zip(&splits) {
            copy_of[split.node as usize] = copy;
            self.rest.push(self.rest[split.node as usize]);
            self.masses.push(0.0);
            self.held.push(false);
        }
        for (corners, mass) in self.corners.iter_mut().zip(&self.cell_masses) {
            let share = 0.125 * mass;
            for i in 0..8 {
                let node = corners[i] as usize;
                // a cell is on the far side if the node is its near corner
                if let Some(Some(axis)) = axis_of.get(node)
                    && i >> axis & 1 == 0
                {
                    corners[i] = copy_of[node];
                    self.masses[node] -= share;
                    self.masses[copy_of[node] as usize] += share;
                }
            }
        }
        self.connect(None); // not interruptible: no more cells than before
        splits.iter().map(|split| split.node).collect()
    }

    /// The nodes to be split, ascending.
    fn overloaded(&self, positions: &[DVec3], limit: f64) -> Vec<Split> {
        // force on each node by the cells on its far side minus that by the cells on its near side, along each axis
        let mut pulls = vec![[DVec3::ZERO; 3]; self.node_count()];
        let mut towards = vec![[DVec3::ZERO; 3]; self.node_count()];
        let mut sides: Vec<[[u8; 2]; 3]> = vec![[[0; 2]; 3]; self.node_count()];
        for (corners, _) in self.corners.iter().zip(&self.is_whole).filter(|(_, is_whole)| **is_whole) {
            for i in 0..8usize {
                for j in 0..i {
                    let [a, b] = [corners[i] as usize, corners[j] as usize];
                    let along = positions[b] - positions[a];
                    let length = along.length();
                    if !(length > 0.0) {
                        continue;
                    }
                    let kind = (i ^ j).count_ones() as usize - 1;
                    let rest = self.rest[a].distance(self.rest[b]);
                    let force = along * (SHARES[kind] * self.stiffness * (length - rest) / length);
                    for (node, corner, force) in [(a, i as Sides, force), (b, j as Sides, -force)] {
                        for axis in 0..3 {
                            let is_far = corner >> axis & 1 == 0;
                            pulls[node][axis] += if is_far { force } else { -force };
                        }
                    }
                }
            }
            for i in 0..8usize {
                let node = corners[i] as usize;
                for axis in 0..3 {
                    let is_far = i >> axis & 1 == 0;
                    sides[node][axis][usize::from(is_far)] += 1;
                    let along = positions[corners[i ^ 1 << axis] as usize] - positions[node];
                    towards[node][axis] += if is_far { along } else { -along };
                }
            }
        }
        let section = 0.25 * self.size * self.size;
        let mut splits = Vec::new();
        for node in (0..self.node_count()).filter(|&node| !self.held[node]) {
            let mut strongest = (limit, 3);
            for axis in 0..3 {
                let pairs = sides[node][axis].into_iter().min().unwrap_or(0);
                if pairs == 0 {
                    continue; // on one side only
                }
                let tension = 0.5 * pulls[node][axis].dot(towards[node][axis].normalize_or_zero());
                let strain = tension / (self.young() * section * f64::from(pairs));
                if strain > strongest.0 {
                    strongest = (strain, axis);
                }
            }
            if strongest.1 < 3 {
                splits.push(Split { node: node as u32, axis: strongest.1 });
            }
        }
        splits
    }
}
