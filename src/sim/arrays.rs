//! State as arrays, by coordinate: one vector quantity of many vertices, or several of a few that are stepped side by side.
//!
//! # Precision
//! The error budget is 1e-6 of a radius over a scene, of which the integrator at 60 steps a second takes about 1e-9.
//!
//! | quantity | kept as | why |
//! | --- | --- | --- |
//! | displacement, velocity | f64, in body coordinates | f32 would leave 1.5e-7 of a radius (measured on the built-in `two`; see the test of `sim::world`), a hundred times what the integrator does, and would end the observation of its order |
//! | unit rest positions | f64 | a constant error of the rest shape, but one that shows where forces are compared |
//! | centres, paths, times | f64 | 1e6 units from the origin a centre is still good to 1e-10, and so are displacements, which only see differences of centres; events are good to 1e-12 s |
//! | weights of a step | f64 | computed once per length of step |
//! | what is recorded | f32 | what the viewer takes; the state is not changed by looking |

use glam::DVec3;

/// The most vertices that any instruction set takes side by side: arrays that are read in lanes are padded to this.
pub const LANES: usize = 16;

/// A vector of each of some vertices side by side, by coordinate.
pub type Lanes = [[f64; LANES]; 3];

/// `V` vectors of each of some vertices side by side.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(64))] // whole lines of a cache
pub struct Block<const V: usize>(pub [Lanes; V]);

/// `V` vectors of each of many vertices: what is known of those side by side is next to each other in memory, so that a
/// step of a body reads and writes one stretch of it and not one an array.
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

/// A vector per vertex, stored by coordinate; all three arrays have the same length.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Vectors {
    /// First coordinates, `[vertex_count]`.
    pub x: Vec<f64>,
    /// Second coordinates, `[vertex_count]`.
    pub y: Vec<f64>,
    /// Third coordinates, `[vertex_count]`.
    pub z: Vec<f64>,
}

impl Vectors {
    /// `count` zero vectors.
    pub fn zeros(count: usize) -> Vectors {
        Vectors { x: vec![0.0; count], y: vec![0.0; count], z: vec![0.0; count] }
    }

    /// Number of vectors.
    pub fn len(&self) -> usize {
        self.x.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.x.is_empty()
    }

    /// Vector `i`; panics beyond the end, like a slice.
    #[inline]
    pub fn get(&self, i: usize) -> DVec3 {
        DVec3::new(self.x[i], self.y[i], self.z[i])
    }

    /// Replaces vector `i`; panics beyond the end, like a slice.
    #[inline]
    pub fn set(&mut self, i: usize, v: DVec3) {
        (self.x[i], self.y[i], self.z[i]) = (v.x, v.y, v.z);
    }

    /// Adds one at the end.
    pub fn push(&mut self, v: DVec3) {
        self.x.push(v.x);
        self.y.push(v.y);
        self.z.push(v.z);
    }

    /// Adds others at the end.
    pub fn extend(&mut self, others: &Vectors) {
        self.x.extend_from_slice(&others.x);
        self.y.extend_from_slice(&others.y);
        self.z.extend_from_slice(&others.z);
    }

    /// Becomes a copy of others.
    pub fn copy_from(&mut self, others: &Vectors) {
        self.clear();
        self.extend(others);
    }

    /// Becomes `count` long, with zeros at the end if that is longer.
    pub fn resize(&mut self, count: usize) {
        for axis in [&mut self.x, &mut self.y, &mut self.z] {
            axis.resize(count, 0.0);
        }
    }

    /// Keeps the storage, holds none.
    pub fn clear(&mut self) {
        self.x.clear();
        self.y.clear();
        self.z.clear();
    }

    /// What was allocated for them [bytes].
    pub fn memory(&self) -> usize {
        (self.x.capacity() + self.y.capacity() + self.z.capacity()) * size_of::<f64>()
    }

    /// All vectors, in order.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = DVec3> + '_ {
        (0..self.len()).map(|i| self.get(i))
    }

    /// Makes all of them the same.
    pub fn fill(&mut self, DVec3 { x, y, z }: DVec3) {
        self.x.fill(x);
        self.y.fill(y);
        self.z.fill(z);
    }

    /// Keeps the storage, holds `count` zero vectors.
    pub fn reset(&mut self, count: usize) {
        for axis in [&mut self.x, &mut self.y, &mut self.z] {
            axis.clear();
            axis.resize(count, 0.0);
        }
    }
}

impl FromIterator<DVec3> for Vectors {
    fn from_iter<I: IntoIterator<Item = DVec3>>(vectors: I) -> Vectors {
        let mut all = Vectors::default();
        for v in vectors {
            all.x.push(v.x);
            all.y.push(v.y);
            all.z.push(v.z);
        }
        all
    }
}
