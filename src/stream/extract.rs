//! The state as meshes and arrows, in the viewer's single precision.

use glam::{DVec3, Vec3};

use crate::sim::{BodyForces, BodyView, Cause};

/// Vertex positions and smooth normals of a surface; reused.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Surface {
    /// [scene unit], `[vertex_count]`
    pub positions: Vec<Vec3>,
    /// Unit vectors, `[vertex_count]`
    pub normals: Vec<Vec3>,
}

impl Surface {
    /// Appends the surface of a body, its vertices moved by `offset` [scene unit] from body coordinates.
    pub fn append(&mut self, body: &BodyView<'_>, offset: DVec3, triangles: &[[u32; 3]]) {
        let (first, count) = (self.positions.len(), body.vertex_count());
        self.positions.extend((0..count).map(|i| (body.local_position(i) + offset).as_vec3()));
        self.normals.resize(first + count, Vec3::ZERO);
        // From body coordinates: an offset would cost precision.
        smooth_normals(|i| body.local_position(i), triangles, &mut self.normals[first..]);
    }

    /// Keeps the storage, holds nothing.
    pub fn clear(&mut self) {
        self.positions.clear();
        self.normals.clear();
    }
}

/// Smooth normals: the sums of those of the triangles around a vertex, weighted by area. `normals` are zero before.
pub fn smooth_normals(position: impl Fn(usize) -> DVec3, triangles: &[[u32; 3]], normals: &mut [Vec3]) {
    for corners in triangles {
        let [a, b, c] = corners.map(|i| position(i as usize));
        let twice_area = (b - a).cross(c - a).as_vec3();
        for &i in corners {
            normals[i as usize] += twice_area;
        }
    }
    for (i, normal) in normals.iter_mut().enumerate() {
        // Where triangles cancel out, the direction from the centre is as good as any.
        *normal = normal.try_normalize().unwrap_or(position(i).normalize_or(DVec3::Z).as_vec3());
    }
}

/// Arrows in world coordinates; reused.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Arrows {
    /// The vertices that feel the force [scene unit].
    pub origins: Vec<Vec3>,
    /// The force times the arrow scale [scene unit].
    pub vectors: Vec<Vec3>,
}

impl Arrows {
    /// Appends an arrow for every vertex of the body that feels `cause`, `scale` [scene unit per scene unit/s²] long.
    pub fn append(&mut self, body: &BodyView<'_>, forces: &BodyForces, cause: Cause, scale: f64) {
        for (i, force) in forces.of(cause).iter().enumerate() {
            let vector = (force * scale).as_vec3();
            if vector != Vec3::ZERO {
                self.origins.push(body.position(i).as_vec3());
                self.vectors.push(vector);
            }
        }
    }

    /// Keeps the storage, holds nothing.
    pub fn clear(&mut self) {
        self.origins.clear();
        self.vectors.clear();
    }
}
