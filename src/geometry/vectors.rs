//! Arrays of vectors, stored by coordinate.

use glam::DVec3;

/// One vector per vertex, stored by coordinate; all three arrays have the same length.
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

    /// Vector `i`; panics if out of range.
    #[inline]
    pub fn get(&self, i: usize) -> DVec3 {
        DVec3::new(self.x[i], self.y[i], self.z[i])
    }

    /// Replaces vector `i`; panics if out of range.
    #[inline]
    pub fn set(&mut self, i: usize, v: DVec3) {
        (self.x[i], self.y[i], self.z[i]) = (v.x, v.y, v.z);
    }

    /// Appends a vector.
    pub fn push(&mut self, v: DVec3) {
        self.x.push(v.x);
        self.y.push(v.y);
        self.z.push(v.z);
    }

    /// Appends other vectors.
    pub fn extend(&mut self, others: &Vectors) {
        self.x.extend_from_slice(&others.x);
        self.y.extend_from_slice(&others.y);
        self.z.extend_from_slice(&others.z);
    }

    /// Replaces the contents by a copy of `others`.
    pub fn copy_from(&mut self, others: &Vectors) {
        self.clear();
        self.extend(others);
    }

    /// Changes the length to `count`; new vectors are zero.
    pub fn resize(&mut self, count: usize) {
        for axis in [&mut self.x, &mut self.y, &mut self.z] {
            axis.resize(count, 0.0);
        }
    }

    /// Removes all vectors and keeps the storage.
    pub fn clear(&mut self) {
        self.x.clear();
        self.y.clear();
        self.z.clear();
    }

    /// Memory allocated for the vectors [bytes].
    pub fn memory(&self) -> usize {
        (self.x.capacity() + self.y.capacity() + self.z.capacity()) * size_of::<f64>()
    }

    /// All vectors, in order.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = DVec3> + '_ {
        (0..self.len()).map(|i| self.get(i))
    }

    /// Adds `factor` times `others`, element by element.
    pub fn add_times(&mut self, factor: f64, others: &Vectors) {
        for (axis, other) in [(&mut self.x, &others.x), (&mut self.y, &others.y), (&mut self.z, &others.z)] {
            axis.iter_mut().zip(other).for_each(|(sum, other)| *sum += factor * other);
        }
    }

    /// Sets all vectors to one value.
    pub fn fill(&mut self, DVec3 { x, y, z }: DVec3) {
        self.x.fill(x);
        self.y.fill(y);
        self.z.fill(z);
    }

    /// Sets the contents to `count` zero vectors, keeping the storage.
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
