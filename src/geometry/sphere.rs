//! Unit spheres made of rings, as in the thesis.

use glam::DVec3;

use super::{
    mesh::Mesh,
    shape::{Parameter, Solid},
};

/// A unit sphere made of rings: a pole, `stacks − 1` rings of `slices` vertices, a pole.
///
/// Vertex 0 is the north pole (+z). The rings follow from north to south: ring i = 1 … stacks − 1 is at polar angle
/// πi/stacks, and its vertex j = 0 … slices − 1 is at azimuth 2πj/slices from +x towards +y. The south pole is the last
/// vertex.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Sphere {
    /// Number of bands from pole to pole, ≥ 2.
    pub stacks: u32,
    /// Number of vertices per ring, ≥ 3.
    pub slices: u32,
}

impl Default for Sphere {
    /// The sphere of the thesis, with 266 vertices.
    fn default() -> Self {
        Sphere { stacks: 12, slices: 24 }
    }
}

impl Solid for Sphere {
    const PARAMETERS: &'static [Parameter] = &[
        Parameter { name: "stacks", about: "Bands from pole to pole.", least: 2, most: 65_535, default: 12 },
        Parameter { name: "slices", about: "Vertices per ring.", least: 3, most: 65_535, default: 24 },
    ];
    const ABOUT: &'static str = "A sphere of rings.";
    const FORM: &'static str = "a table such as { stacks = 12, slices = 24 }";

    fn new(parameters: &[u32]) -> Sphere {
        Sphere { stacks: parameters[0], slices: parameters[1] }
    }

    fn parameters(&self) -> Vec<u32> {
        vec![self.stacks, self.slices]
    }

    /// `2 + (stacks − 1) · slices`.
    fn vertex_count(&self) -> u64 {
        2 + (u64::from(self.stacks) - 1) * u64::from(self.slices)
    }

    /// `2 (stacks − 1) · slices`.
    fn triangle_count(&self) -> u64 {
        2 * (u64::from(self.stacks) - 1) * u64::from(self.slices)
    }

    fn mesh(&self) -> Mesh {
        Mesh::round(self.unit_vertices().into_iter().collect(), self.triangles())
    }
}

impl Sphere {
    /// Unit vertices [–], `[vertex_count]`. These are also the outward normals.
    fn unit_vertices(&self) -> Vec<DVec3> {
        use std::f64::consts::PI;
        let mut vertices = Vec::with_capacity(self.vertex_count() as usize);
        vertices.push(DVec3::Z);
        for i in 1..self.stacks {
            let polar = PI * f64::from(i) / f64::from(self.stacks);
            let (sin_polar, cos_polar) = libm::sincos(polar);
            for j in 0..self.slices {
                let azimuth = 2.0 * PI * f64::from(j) / f64::from(self.slices);
                let (sin, cos) = libm::sincos(azimuth);
                vertices.push(DVec3::new(sin_polar * cos, sin_polar * sin, cos_polar));
            }
        }
        vertices.push(DVec3::NEG_Z);
        vertices
    }

    /// Vertex indices of each triangle, counter-clockwise seen from outside, `[triangle_count]`.
    fn triangles(&self) -> Vec<[u32; 3]> {
        let (stacks, slices) = (self.stacks, self.slices);
        let ring = |i: u32, j: u32| 1 + (i - 1) * slices + j % slices;
        let south = self.vertex_count() as u32 - 1;
        let mut triangles = Vec::with_capacity(self.triangle_count() as usize);
        for j in 0..slices {
            triangles.push([0, ring(1, j), ring(1, j + 1)]);
        }
        for i in 1..stacks - 1 {
            for j in 0..slices {
                let [nw, ne] = [ring(i, j), ring(i, j + 1)];
                let [sw, se] = [ring(i + 1, j), ring(i + 1, j + 1)];
                triangles.push([nw, sw, se]);
                triangles.push([nw, se, ne]);
            }
        }
        for j in 0..slices {
            triangles.push([ring(stacks - 1, j), south, ring(stacks - 1, j + 1)]);
        }
        triangles
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_is_the_thesis_sphere() {
        let sphere = Sphere::default();
        assert_eq!(sphere.vertex_count(), 266);
        assert_eq!(sphere.unit_vertices().len(), 266);
        assert_eq!(sphere.triangles().len() as u64, sphere.triangle_count());
    }
}
