//! The state as meshes and arrows, in the viewer's single precision.

use glam::DVec3;
use pulp::Arch;

use super::normals::{self, Vector};
use crate::{
    geometry::{Mesh, Vectors},
    sim::{BodyForces, Cause, snapshot::SeenBody},
};

/// Reused from body to body.
#[derive(Debug, Default)]
pub struct Extractor {
    arch: Arch,
    local: Vectors,
    normals: normals::Scratch,
}

impl Extractor {
    /// World positions of the vertices of a body [scene unit], into `positions` (reused).
    pub fn world_positions(&mut self, body: SeenBody<'_>, positions: &mut Vec<Vector>) {
        positions.clear();
        body.local_positions(&mut self.local);
        append_moved(&self.local, body.centre(), positions);
    }

    /// Smooth normals of a mesh whose vertices are at `positions` relative to its centre.
    pub fn normals(&mut self, mesh: &Mesh, positions: &Vectors) -> Vec<Vector> {
        let mut normals = Vec::new();
        normals::append(self.arch, mesh, positions, &mut self.normals, &mut normals);
        normals
    }
}

/// Vertex positions and smooth normals of a surface; reused.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Surface {
    /// [scene unit], `[vertex_count]`
    pub positions: Vec<Vector>,
    /// Unit vectors, `[vertex_count]`
    pub normals: Vec<Vector>,
}

impl Surface {
    /// Appends the surface of a body, its vertices moved by `offset` [scene unit] from body coordinates.
    pub fn append(&mut self, body: SeenBody<'_>, offset: DVec3, extractor: &mut Extractor) {
        body.local_positions(&mut extractor.local);
        append_moved(&extractor.local, offset, &mut self.positions);
        // From body coordinates: an offset would cost precision.
        let Extractor { arch, local, normals } = extractor;
        normals::append(*arch, body.mesh(), local, normals, &mut self.normals);
    }

    /// Keeps the storage, holds nothing.
    pub fn clear(&mut self) {
        self.positions.clear();
        self.normals.clear();
    }
}

/// Appends vectors, each with `offset` added, in single precision.
fn append_moved(vectors: &Vectors, offset: DVec3, moved: &mut Vec<Vector>) {
    let n = vectors.len();
    let (x, y, z) = (&vectors.x[..n], &vectors.y[..n], &vectors.z[..n]);
    moved.extend((0..n).map(|i| [(x[i] + offset.x) as f32, (y[i] + offset.y) as f32, (z[i] + offset.z) as f32]));
}

/// Arrows in world coordinates; reused.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Arrows {
    /// The vertices that feel the force [scene unit].
    pub origins: Vec<Vector>,
    /// The force times the arrow scale [scene unit].
    pub vectors: Vec<Vector>,
    /// Of the pair between whom it acts, if it acts between two.
    pub classes: Vec<u16>,
}

impl Arrows {
    /// Appends an arrow for every vertex that feels `cause`, `scale` [scene unit per scene unit/s²] long; `origins` are
    /// the vertices of the body, `[vertex_count]`, `classes` those of their arrows or none.
    pub fn append(&mut self, origins: &[Vector], classes: &[u16], forces: &BodyForces, cause: Cause, scale: f64) {
        let forces = forces.of(cause);
        let (n, arrows) = (origins.len(), self);
        let (x, y, z) = (&forces.x[..n], &forces.y[..n], &forces.z[..n]);
        for i in 0..n {
            let vector = [(x[i] * scale) as f32, (y[i] * scale) as f32, (z[i] * scale) as f32];
            if vector != [0.0; 3] {
                arrows.origins.push(origins[i]);
                arrows.vectors.push(vector);
                arrows.classes.extend(classes.get(i));
            }
        }
    }

    /// Keeps the storage, holds nothing.
    pub fn clear(&mut self) {
        self.origins.clear();
        self.vectors.clear();
        self.classes.clear();
    }
}
