//! State as arrays, by coordinate: one vector quantity of many vertices, or several of a few that are stepped side by side.
//!
//! # Precision
//! The error budget is 1e-6 of a radius over a scene, of which the integrator at 60 steps a second takes about 1e-9.
//!
//! | quantity | kept as | why |
//! | --- | --- | --- |
//! | displacement, velocity | f64, in body coordinates | f32 would leave 1.5e-7 of a radius (measured on the built-in `two`; see the test of `sim::world`), a hundred times what the integrator does, and would end the observation of its order |
//! | rest positions, in radii | f64 | a constant error of the rest shape, but one that shows where forces are compared |
//! | centres, paths, times | f64 | 1e6 units from the origin a centre is still good to 1e-10, and so are displacements, which only see differences of centres; events are good to 1e-12 s |
//! | weights of a step | f64 | computed once per length of step |
//! | what is recorded | f32 | what the viewer takes; the state is not changed by looking |

use glam::DVec3;

pub use crate::geometry::Vectors;

/// The most vertices that any instruction set takes side by side: arrays that are read in lanes are padded to this.
pub const LANES: usize = 16;

/// A vector of each of some vertices side by side, by coordinate.
pub type Lanes = [[f64; LANES]; 3];

/// `V` vectors of each of some vertices side by side.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(64))] // whole lines of a cache
pub struct Block<const V: usize>(pub [Lanes; V]);

/// `V` vectors of each of many vertices: what is known of those side by side is next to each other in memory, so that a
/// step of a body touches one run of it and not one per array.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Blocks<const V: usize>(Vec<Block<V>>);

impl<const V: usize> Blocks<V> {
    /// For how many vertices there is room.
    pub fn room(&self) -> usize {
        self.0.len() * LANES
    }

    /// Vector number `v` of vertex `i`; panics beyond the end, like a slice.
    #[inline]
    pub fn get(&self, v: usize, i: usize) -> DVec3 {
        let [x, y, z] = &self.0[i / LANES].0[v];
        DVec3::new(x[i % LANES], y[i % LANES], z[i % LANES])
    }

    /// Replaces vector number `v` of vertex `i`; panics beyond the end, like a slice.
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

    /// Has room for `count` vertices; what is new is zero.
    pub fn resize(&mut self, count: usize) {
        let blocks = count.div_ceil(LANES);
        self.0.reserve_exact(blocks.saturating_sub(self.0.len())); // they are large, and come to an end soon
        self.0.resize(blocks, Block([[[0.0; LANES]; 3]; V]));
    }

    /// Keeps the storage, holds none.
    pub fn clear(&mut self) {
        self.0.clear();
    }

    /// Repeats vertex `count - 1` to the end of its block.
    pub fn pad(&mut self, count: usize) {
        for i in count..self.room() {
            for v in 0..V {
                self.set(v, i, self.get(v, count - 1));
            }
        }
    }

    /// What was allocated for them [bytes].
    pub fn memory(&self) -> usize {
        self.0.capacity() * size_of::<Block<V>>()
    }
}
