//! The state at an instant, as far as somebody wants to see it.

use glam::DVec3;

use super::simulation::Instant;
use crate::geometry::{Rest, Vectors};

/// What is wanted of a frame besides where bodies and vertices are, and the pairs; nothing else is computed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Want {
    /// Forces by term, and labels.
    pub forces: bool,
    /// Scalars of the state.
    pub scalars: bool,
}

impl Want {
    /// All of it.
    pub const ALL: Want = Want { forces: true, scalars: true };
}

/// The state at an instant; reused from one to the next.
#[derive(Clone, Debug, Default)]
pub struct Frame {
    /// When it is.
    pub at: Instant,
    /// In the order of the schema.
    pub bodies: Vec<BodyFrame>,
    /// Pairs that can act on each other, or that are not in the first phase; in ascending order of their bodies.
    pub pairs: Vec<PairFrame>,
    /// By the schema's order; of those that are not of the state, nothing.
    pub scalars: Vec<f64>,
}

/// A body at an instant; reused.
#[derive(Clone, Debug, Default)]
pub struct BodyFrame {
    /// Where its centre is [scene unit].
    pub centre: DVec3,
    /// Whether every displacement and velocity is exactly zero; the vectors are empty then.
    pub is_at_rest: bool,
    /// Displacements of the vertices from rest, x [scene unit], `[vertex_count]`.
    pub displacements: Vectors,
    /// Their velocities x′ [scene unit/s], `[vertex_count]`.
    pub velocities: Vectors,
    /// Positions of the vertices relative to the centre [scene unit], `[vertex_count]`.
    pub positions: Vectors,
    /// |x| [scene unit], `[vertex_count]`.
    pub lengths: Vec<f64>,
    /// The largest |x| [scene unit].
    pub max_displacement: f64,
    /// Whether anything acts on it that is in `terms`.
    pub has_forces: bool,
    /// Accelerations of the vertices, by the schema's terms.
    pub terms: Vec<TermFrame>,
    /// What is said of each vertex, as indices of the schema's labels, `[vertex_count]`; empty if nothing acts.
    pub labels: Vec<u8>,
}

/// What one cause does to a body.
#[derive(Clone, Debug, Default)]
pub struct TermFrame {
    /// Accelerations [scene unit/s²], `[vertex_count]`; empty if all are zero.
    pub accelerations: Vectors,
    /// The body that brings them, if it is one.
    pub source: Option<u32>,
}

/// A pair of bodies at an instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PairFrame {
    /// Index of one body …
    pub a: usize,
    /// … and of the other, a < b.
    pub b: usize,
    /// What decides on their phase, as centre distance over the sum of the radii [–].
    pub q: f64,
    /// Index of the schema's phases.
    pub phase: usize,
}

impl BodyFrame {
    /// The body is at rest: no vertex is displaced, and nothing is known to act.
    pub fn rest(&mut self) {
        self.is_at_rest = true;
        for vectors in [&mut self.displacements, &mut self.velocities, &mut self.positions] {
            vectors.clear();
        }
        self.lengths.clear();
        self.max_displacement = 0.0;
    }

    /// Positions and |x|, from the displacements.
    pub fn displaced(&mut self, rest: Rest<'_>) {
        let BodyFrame { displacements, positions, lengths, .. } = self;
        self.is_at_rest = false;
        positions.copy_from(rest.mesh.positions());
        let axes = [(&mut positions.x, &displacements.x), (&mut positions.y, &displacements.y)];
        for (axis, moved) in axes.into_iter().chain([(&mut positions.z, &displacements.z)]) {
            axis.iter_mut().zip(moved).for_each(|(l, x)| *l = *l * rest.radius + x);
        }
        lengths.clear();
        let xy = displacements.x.iter().zip(&displacements.y);
        lengths.extend(xy.zip(&displacements.z).map(|((x, y), z)| (x * x + y * y + z * z).sqrt()));
        self.max_displacement = lengths.iter().copied().fold(0.0, f64::max);
    }

    /// Forgets what acts on it.
    pub fn clear_forces(&mut self) {
        self.has_forces = false;
        self.terms.iter_mut().for_each(|term| term.accelerations.clear());
        self.labels.clear();
    }

    /// Positions of the vertices relative to the centre [scene unit], at rest or not, into `positions` (reused).
    pub fn local_positions(&self, rest: Rest<'_>, positions: &mut Vectors) {
        if !self.is_at_rest {
            positions.copy_from(&self.positions);
            return;
        }
        positions.copy_from(rest.mesh.positions());
        for axis in [&mut positions.x, &mut positions.y, &mut positions.z] {
            axis.iter_mut().for_each(|l| *l *= rest.radius);
        }
    }

    /// Displacement of vertex `i`, at rest or not [scene unit].
    pub fn displacement(&self, i: usize) -> DVec3 {
        if self.is_at_rest { DVec3::ZERO } else { self.displacements.get(i) }
    }

    fn memory(&self) -> usize {
        let terms: usize = self.terms.iter().map(|term| size_of::<TermFrame>() + term.accelerations.memory()).sum();
        let vectors = [&self.displacements, &self.velocities, &self.positions].map(Vectors::memory);
        size_of::<BodyFrame>()
            + vectors.iter().sum::<usize>()
            + self.lengths.capacity() * size_of::<f64>()
            + self.labels.capacity()
            + terms
    }
}

impl Frame {
    /// What it takes of memory, by what was allocated for it [bytes].
    pub fn memory(&self) -> usize {
        self.bodies.iter().map(BodyFrame::memory).sum::<usize>()
            + self.pairs.capacity() * size_of::<PairFrame>()
            + self.scalars.capacity() * size_of::<f64>()
    }
}
