//! State as arrays, by coordinate: one vector quantity of many vertices, or several quantities of a few vertices that
//! are stepped side by side.
//!
//! # Precision
//! The error budget is 1e-6 of a radius over a scene, of which the integrator uses about 1e-9 at 60 steps per second.
//!
//! | quantity | stored as | why |
//! | --- | --- | --- |
//! | displacement, velocity | f64, in body coordinates | f32 would add 1.5e-7 of a radius (measured on the built-in `two`; see the test of `sim::world`), a hundred times the integrator's error, and would hide its order |
//! | rest positions, in radii | f64 | a constant error of the rest shape, but visible where forces are compared |
//! | centres, paths, times | f64 | 1e6 units from the origin a centre is still accurate to 1e-10, and so are displacements, which depend only on differences of centres; events are accurate to 1e-12 s |
//! | weights of a step | f64 | computed once per step length |
//! | recorded data | f32 | the viewer's format; recording does not change the state |

use glam::DVec3;

pub use crate::geometry::Vectors;

/// The largest number of vertices that any instruction set processes in parallel. Arrays that are read in lanes are
/// padded to a multiple of this.
pub const LANES: usize = 16;

/// One vector for each vertex of a block, by coordinate.
pub type Lanes = [[f64; LANES]; 3];

/// `V` vectors for each vertex of a block.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(64))] // whole cache lines
pub struct Block<const V: usize>(pub [Lanes; V]);

/// `V` vectors for each of many vertices. All vectors of the same lanes are contiguous in memory, so that a body's step
/// streams through one array instead of one per quantity.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Blocks<const V: usize>(Vec<Block<V>>);

impl<const V: usize> Blocks<V> {
    /// Number of vertices for which there is room.
    pub fn room(&self) -> usize {
        self.0.len() * LANES
    }

    /// Vector number `v` of vertex `i`; panics if out of range.
    #[inline]
    pub fn get(&self, v: usize, i: usize) -> DVec3 {
        let [x, y, z] = &self.0[i / LANES].0[v];
        DVec3::new(x[i % LANES], y[i % LANES], z[i % LANES])
    }

    /// Replaces vector number `v` of vertex `i`; panics if out of range.
    #[inline]
    pub fn set(&mut self, v: usize, i: usize, vector: DVec3) {
        let [x, y, z] = &mut self.0[i / LANES].0[v];
        (x[i % LANES], y[i % LANES], z[i % LANES]) = (vector.x, vector.y, vector.z);
    }

    /// The blocks, in order.
    #[inline]
    pub fn all(&self) -> &[Block<V>] {
        &self.0
    }

    /// The blocks, in order.
    #[inline]
    pub fn all_mut(&mut self) -> &mut [Block<V>] {
        &mut self.0
    }

    /// Makes room for `count` vertices; new entries are zero.
    pub fn resize(&mut self, count: usize) {
        let blocks = count.div_ceil(LANES);
        self.0.reserve_exact(blocks.saturating_sub(self.0.len())); // blocks are large, and growth stops soon
        self.0.resize(blocks, Block([[[0.0; LANES]; 3]; V]));
    }

    /// Removes all vertices and keeps the storage.
    pub fn clear(&mut self) {
        self.0.clear();
    }

    /// Fills the last block by repeating vertex `count - 1`.
    pub fn pad(&mut self, count: usize) {
        for i in count..self.room() {
            for v in 0..V {
                self.set(v, i, self.get(v, count - 1));
            }
        }
    }
}
