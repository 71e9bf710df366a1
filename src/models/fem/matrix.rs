//! Symmetric sparse matrices of 3×3 blocks, one block row per node, and their Cholesky factors.
//!
//! The elimination order is nested dissection of the grid (George, Nested dissection of a regular finite element mesh,
//! 1973): a plane of nodes separates the nodes on its two sides, which are ordered recursively, before the plane.
//! Factorisation and solution are scalar code without fused multiply-adds, so results are bit-identical on every
//! machine.

use std::sync::atomic::AtomicBool;

use glam::{DMat3, DVec3};

use crate::interrupt::is_raised;

/// A symmetric matrix: the blocks on and below the diagonal, by column.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Symmetric {
    /// Start of each column in `blocks`, followed by the end, `[n + 1]`.
    pub starts: Vec<usize>,
    /// The row of each block, ascending in a column; the first is the diagonal.
    pub rows: Vec<u32>,
    /// The blocks.
    pub blocks: Vec<DMat3>,
}

impl Symmetric {
    /// Assembles blocks at `(row, column)` with row ≥ column; blocks at the same position are added in the order given.
    /// `None` if interrupted.
    pub fn sum(n: usize, mut parts: Vec<(u32, u32, DMat3)>, interrupt: Option<&AtomicBool>) -> Option<Symmetric> {
        /// Number of blocks sorted between two checks of the interrupt.
        const CHUNK: usize = 1 << 18;
        // sorted chunks, which the last sort then merges
        for some in parts.chunks_mut(CHUNK) {
            some.sort_by_key(|&(row, column, _)| (column, row));
            if is_raised(interrupt) {
                return None;
            }
        }
        parts.sort_by_key(|&(row, column, _)| (column, row));
        let mut matrix = Symmetric { starts: vec![0; n + 1], rows: Vec::new(), blocks: Vec::new() };
        for same in parts.chunk_by(|x, y| (x.0, x.1) == (y.0, y.1)) {
            let (row, column, _) = same[0];
            matrix.rows.push(row);
            matrix.blocks.push(same.iter().fold(DMat3::ZERO, |sum, part| sum + part.2));
            matrix.starts[column as usize + 1] += 1;
        }
        for column in 0..n {
            matrix.starts[column + 1] += matrix.starts[column];
        }
        Some(matrix)
    }

    /// Number of rows of blocks.
    pub fn size(&self) -> usize {
        self.starts.len() - 1
    }

    /// Adds the product with `x` to `y`.
    pub fn multiply_add(&self, x: &[DVec3], y: &mut [DVec3]) {
        for column in 0..self.size() {
            let range = self.starts[column]..self.starts[column + 1];
            let own = x[column];
            let mut sum = DVec3::ZERO;
            for (&row, block) in self.rows[range.clone()].iter().zip(&self.blocks[range]) {
                let row = row as usize;
                if row == column {
                    sum += *block * own;
                } else {
                    y[row] += *block * own;
                    let other = x[row];
                    sum += DVec3::new(block.x_axis.dot(other), block.y_axis.dot(other), block.z_axis.dot(other));
                }
            }
            y[column] += sum;
        }
    }
}

/// The Cholesky factor of a positive definite matrix.
#[derive(Clone, Debug)]
pub struct Cholesky {
    /// Start of each column in `blocks`, followed by the end, `[n + 1]`.
    starts: Vec<usize>,
    rows: Vec<u32>,
    /// The blocks below the diagonal, each multiplied by the inverse of its column's diagonal block …
    pub blocks: Vec<DMat3>,
    /// … and the inverses of the diagonal blocks of D in L D Lᵀ.
    inverses: Vec<DMat3>,
}

/// Why a matrix could not be factored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unfactored {
    /// It is not positive definite.
    Singular,
    /// The factor would exceed the memory limit.
    TooLarge {
        /// Memory of the factor, at least [bytes].
        bytes: u64,
    },
    /// It was interrupted.
    Interrupted,
}

impl Cholesky {
    /// L D Lᵀ with 3×3 blocks, where L has unit diagonal blocks. Allocates at most `max` bytes.
    ///
    /// # Errors
    /// [`Unfactored`].
    pub fn of(matrix: &Symmetric, max: u64, interrupt: Option<&AtomicBool>) -> Result<Cholesky, Unfactored> {
        const NONE: u32 = u32::MAX;
        let n = matrix.size();
        let is_interrupted = || is_raised(interrupt);
        let children = children(matrix, n);
        // the pattern of a column is the union of that of the matrix and those of its children in the elimination tree
        let mut patterns: Vec<Vec<u32>> = Vec::with_capacity(n);
        let (mut mark, mut count) = (vec![NONE; n], 0u64);
        for column in 0..n {
            let mut pattern = Vec::new();
            mark[column] = column as u32;
            let own = &matrix.rows[matrix.starts[column]..matrix.starts[column + 1]];
            let of_children = children[column].iter().flat_map(|&child| patterns[child as usize].iter());
            for &row in own.iter().chain(of_children) {
                if row as usize > column && mark[row as usize] != column as u32 {
                    mark[row as usize] = column as u32;
                    pattern.push(row);
                }
            }
            pattern.sort_unstable();
            count += pattern.len() as u64;
            let bytes = count * (size_of::<DMat3>() + 2 * size_of::<u32>()) as u64;
            if bytes > max {
                return Err(Unfactored::TooLarge { bytes });
            }
            if column % 64 == 0 && is_interrupted() {
                return Err(Unfactored::Interrupted);
            }
            patterns.push(pattern);
        }
        let mut starts = vec![0; n + 1];
        for column in 0..n {
            starts[column + 1] = starts[column] + patterns[column].len();
        }
        let rows: Vec<u32> = patterns.into_iter().flatten().collect();
        let mut factor =
            Cholesky { blocks: vec![DMat3::ZERO; rows.len()], starts, rows, inverses: Vec::with_capacity(n) };

        // left-looking: the columns that contribute to the current one are in a list, each with its progress
        let mut head = vec![NONE; n];
        let mut next = vec![NONE; n];
        let mut reached: Vec<usize> = factor.starts[..n].to_vec();
        let mut work = vec![DMat3::ZERO; n];
        let mut diagonals: Vec<DMat3> = Vec::with_capacity(n);
        for column in 0..n {
            if is_interrupted() {
                return Err(Unfactored::Interrupted);
            }
            let own = matrix.starts[column]..matrix.starts[column + 1];
            for (&row, &block) in matrix.rows[own.clone()].iter().zip(&matrix.blocks[own]) {
                work[row as usize] = block;
            }
            let (mut contributor, mut number) = (head[column], 0u32);
            while contributor != NONE {
                // the last columns have many long contributors
                number += 1;
                if number.is_multiple_of(1024) && is_interrupted() {
                    return Err(Unfactored::Interrupted);
                }
                let k = contributor as usize;
                contributor = next[k];
                let (from, end) = (reached[k], factor.starts[k + 1]);
                // L_ck D_k for the current row
                let scaled = (factor.blocks[from] * diagonals[k]).transpose();
                for (&row, block) in factor.rows[from..end].iter().zip(&factor.blocks[from..end]) {
                    work[row as usize] -= *block * scaled;
                }
                reached[k] += 1;
                if let Some(&row) = factor.rows[..end].get(reached[k]) {
                    next[k] = head[row as usize];
                    head[row as usize] = k as u32;
                }
            }
            let diagonal = std::mem::replace(&mut work[column], DMat3::ZERO);
            if !is_positive(diagonal) {
                return Err(Unfactored::Singular);
            }
            let inverse = diagonal.inverse();
            let range = factor.starts[column]..factor.starts[column + 1];
            for at in range.clone() {
                let row = factor.rows[at] as usize;
                factor.blocks[at] = std::mem::replace(&mut work[row], DMat3::ZERO) * inverse;
            }
            if let Some(&row) = factor.rows[range].first() {
                next[column] = head[row as usize];
                head[row as usize] = column as u32;
            }
            diagonals.push(diagonal);
            factor.inverses.push(inverse);
        }
        Ok(factor)
    }

    /// Solves the system with right-hand side `x` in place.
    pub fn solve(&self, x: &mut [DVec3]) {
        let n = self.inverses.len();
        for column in 0..n {
            let own = x[column];
            let range = self.starts[column]..self.starts[column + 1];
            for (&row, block) in self.rows[range.clone()].iter().zip(&self.blocks[range]) {
                x[row as usize] -= *block * own;
            }
        }
        for column in (0..n).rev() {
            let mut sums = [self.inverses[column] * x[column], DVec3::ZERO];
            let range = self.starts[column]..self.starts[column + 1];
            for (at, (&row, block)) in self.rows[range.clone()].iter().zip(&self.blocks[range]).enumerate() {
                let other = x[row as usize];
                sums[at & 1] -= DVec3::new(block.x_axis.dot(other), block.y_axis.dot(other), block.z_axis.dot(other));
            }
            x[column] = sums[0] + sums[1];
        }
    }

    /// Allocated memory [bytes].
    pub fn memory(&self) -> usize {
        self.blocks.capacity() * size_of::<DMat3>()
            + self.rows.capacity() * size_of::<u32>()
            + self.inverses.capacity() * size_of::<DMat3>()
            + self.starts.capacity() * size_of::<usize>()
    }
}

/// The children of every node of the elimination tree (Liu, The role of elimination trees in sparse factorization, 1990).
fn children(matrix: &Symmetric, n: usize) -> Vec<Vec<u32>> {
    const NONE: u32 = u32::MAX;
    // rows of the lower triangle, from its columns
    let mut columns_of: Vec<Vec<u32>> = vec![Vec::new(); n];
    for column in 0..n {
        for &row in &matrix.rows[matrix.starts[column]..matrix.starts[column + 1]] {
            if row as usize > column {
                columns_of[row as usize].push(column as u32);
            }
        }
    }
    let (mut parent, mut ancestor) = (vec![NONE; n], vec![NONE; n]);
    for (row, columns) in columns_of.iter().enumerate() {
        for &column in columns {
            let mut node = column;
            while node != NONE && node as usize != row {
                let above = ancestor[node as usize];
                ancestor[node as usize] = row as u32; // paths are shortened
                if above == NONE {
                    parent[node as usize] = row as u32;
                }
                node = above;
            }
        }
    }
    let mut children = vec![Vec::new(); n];
    for (node, &parent) in (0..).zip(&parent) {
        if parent != NONE {
            children[parent as usize].push(node);
        }
    }
    children
}

/// Whether a symmetric block is positive definite: its leading minors are.
fn is_positive(block: DMat3) -> bool {
    let minor = block.x_axis.x * block.y_axis.y - block.x_axis.y * block.y_axis.x;
    block.x_axis.x > 0.0 && minor > 0.0 && block.determinant() > 0.0 && block.is_finite()
}

/// The elimination order of nodes at grid positions, by nested dissection. Two nodes are coupled only if no coordinate
/// differs by more than 1.
pub fn dissection(places: &[[i32; 3]]) -> Vec<u32> {
    let mut nodes: Vec<u32> = (0..places.len() as u32).collect();
    let mut order = Vec::with_capacity(nodes.len());
    dissect(places, &mut nodes, &mut order);
    order
}

fn dissect(places: &[[i32; 3]], nodes: &mut [u32], order: &mut Vec<u32>) {
    const FEW: usize = 8;
    let range = |axis: usize| {
        let along = || nodes.iter().map(|&node| places[node as usize][axis]);
        let (low, high) = (along().min().unwrap_or(0), along().max().unwrap_or(0));
        (high - low, low, high)
    };
    let widest = (0..3).max_by_key(|&axis| (range(axis).0, axis)).unwrap_or(0);
    let (width, ..) = range(widest);
    if nodes.len() <= FEW || width < 2 {
        nodes.sort_unstable();
        order.extend_from_slice(nodes);
        return;
    }
    let at = |node: u32| places[node as usize][widest];
    nodes.sort_unstable_by_key(|&node| (at(node), node));
    let (low, high) = (at(nodes[0]), at(nodes[nodes.len() - 1]));
    let plane = at(nodes[nodes.len() / 2]).clamp(low + 1, high - 1);
    let first = nodes.partition_point(|&node| at(node) < plane);
    let last = nodes.partition_point(|&node| at(node) <= plane);
    let (before, rest) = nodes.split_at_mut(first);
    let (on, after) = rest.split_at_mut(last - first);
    dissect(places, before, order);
    dissect(places, after, order);
    // eliminating both sides couples all nodes of the plane, so their order does not matter
    order.extend_from_slice(on);
}
