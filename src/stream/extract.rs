//! Converts states to meshes and arrows, in the single precision of the viewer.

use glam::{DQuat, DVec3};

use crate::{
    geometry::{Mesh, Vectors, mesh},
    observe::{BodyFrame, schema::BodySchema},
};

/// Single-precision coordinates, as in the viewer.
pub type Float3 = [f32; 3];

/// Scratch storage, reused from body to body.
#[derive(Debug, Default)]
pub struct Extractor {
    rest: Vectors,
    sums: Vec<DVec3>,
}

impl Extractor {
    /// Vertex positions of a body relative to its centre, in world axes [scene unit].
    fn local<'a>(&'a mut self, body: &BodySchema, now: &'a BodyFrame) -> &'a Vectors {
        if !now.is_at_rest {
            return &now.positions;
        }
        now.local_positions(now.rest_of(body), &mut self.rest);
        &self.rest
    }

    /// Writes the world positions of a body's vertices [scene unit] to `positions` (reused).
    pub fn world_positions(&mut self, body: &BodySchema, now: &BodyFrame, positions: &mut Vec<Float3>) {
        positions.clear();
        append_moved(self.local(body, now), now.centre, positions);
    }

    /// Vertex normals of a mesh, smooth unless it is faceted; `positions` are relative to its centre.
    pub fn normals(&mut self, mesh: &Mesh, positions: &Vectors) -> Vec<Float3> {
        let mut normals = Vec::new();
        append_normals(mesh, positions, &mut self.sums, &mut normals);
        normals
    }
}

/// Vertex positions and normals of bodies, with the copies of faceted meshes. Reused.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Surface {
    /// Vertex positions [scene unit], `[drawn_vertex_count]`.
    pub positions: Vec<Float3>,
    /// Unit normals, `[drawn_vertex_count]`.
    pub normals: Vec<Float3>,
}

impl Surface {
    /// Appends the surface of a body in world coordinates.
    pub fn append_in_world(&mut self, body: &BodySchema, now: &BodyFrame, extractor: &mut Extractor) {
        let first = self.positions.len();
        append_moved(extractor.local(body, now), now.centre, &mut self.positions);
        self.copy(now.mesh_of(body), first);
        // Normals are computed relative to the centre: its position would cost precision.
        let Extractor { rest, sums } = extractor;
        let local = if now.is_at_rest { rest } else { &now.positions };
        append_normals(now.mesh_of(body), local, sums, &mut self.normals);
    }

    /// Appends the surface of a body relative to its centre, in body axes.
    pub fn append_in_body(&mut self, body: &BodySchema, now: &BodyFrame, extractor: &mut Extractor) {
        let Extractor { rest, sums } = extractor;
        let positions = if now.is_at_rest || now.rotation != DQuat::IDENTITY {
            now.body_positions(now.rest_of(body), rest);
            rest
        } else {
            &now.positions
        };
        let first = self.positions.len();
        append_moved(positions, DVec3::ZERO, &mut self.positions);
        self.copy(now.mesh_of(body), first);
        append_normals(now.mesh_of(body), positions, sums, &mut self.normals);
    }

    /// Appends the copies of a mesh whose vertices begin at `first`.
    fn copy(&mut self, mesh: &Mesh, first: usize) {
        if let Some(facets) = mesh.facets() {
            facets.extend(&mut self.positions, first);
        }
    }

    /// Removes all vertices and keeps the allocation.
    pub fn clear(&mut self) {
        self.positions.clear();
        self.normals.clear();
    }
}

/// Appends the unit normals of a deformed mesh: smooth ones, or those of its faces and copies if it is faceted; `positions`
/// are its vertices relative to its centre.
fn append_normals(mesh: &Mesh, positions: &Vectors, sums: &mut Vec<DVec3>, normals: &mut Vec<Float3>) {
    // Positions of another number do not belong to this mesh, and its faces would be missing some.
    match mesh.facets().filter(|_| positions.len() == mesh.vertex_count()) {
        Some(facets) => facets.append_normals(|i| positions.get(i), positions.len(), normals),
        None => mesh::append_normals(positions, mesh.triangles(), sums, normals),
    }
}

/// Appends vectors in single precision, each with `offset` added.
fn append_moved(vectors: &Vectors, offset: DVec3, moved: &mut Vec<Float3>) {
    let n = vectors.len();
    let (x, y, z) = (&vectors.x[..n], &vectors.y[..n], &vectors.z[..n]);
    moved.extend((0..n).map(|i| [(x[i] + offset.x) as f32, (y[i] + offset.y) as f32, (z[i] + offset.z) as f32]));
}

/// Force arrows in world coordinates. Reused.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Arrows {
    /// Positions of the vertices on which the force acts [scene unit].
    pub origins: Vec<Float3>,
    /// Accelerations times the arrow scale [scene unit].
    pub vectors: Vec<Float3>,
    /// Classes that identify the pair of bodies between which a force acts; empty if it does not act between two
    /// bodies.
    pub classes: Vec<u16>,
}

impl Arrows {
    /// Appends an arrow for every vertex with a nonzero acceleration; `scale` is its length per acceleration
    /// [scene unit per scene unit/s²]. `origins` are the vertices of the body, `[vertex_count]`; `class` is the class
    /// of the arrows, if any.
    pub fn append(&mut self, origins: &[Float3], class: Option<u16>, accelerations: &Vectors, scale: f64) {
        let (n, arrows) = (accelerations.len().min(origins.len()), self);
        let (x, y, z) = (&accelerations.x[..n], &accelerations.y[..n], &accelerations.z[..n]);
        for i in 0..n {
            let vector = [(x[i] * scale) as f32, (y[i] * scale) as f32, (z[i] * scale) as f32];
            if vector != [0.0; 3] {
                arrows.origins.push(origins[i]);
                arrows.vectors.push(vector);
                arrows.classes.extend(class);
            }
        }
    }

    /// Appends one arrow at `origin` [scene unit], of this class if it has one.
    pub fn append_one(&mut self, origin: DVec3, acceleration: DVec3, class: Option<u16>, scale: f64) {
        let vector = (scale * acceleration).as_vec3().to_array();
        if vector != [0.0; 3] {
            self.origins.push(origin.as_vec3().to_array());
            self.vectors.push(vector);
            self.classes.extend(class);
        }
    }

    /// Removes all arrows and keeps the allocation.
    pub fn clear(&mut self) {
        self.origins.clear();
        self.vectors.clear();
        self.classes.clear();
    }
}
