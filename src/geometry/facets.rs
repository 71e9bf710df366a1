//! Flat faces: a mesh whose triangles share no vertices, so that each has a normal of its own.

use glam::DVec3;

/// The vertices and triangles with which a mesh is drawn if its faces are flat.
#[derive(Clone, Debug, PartialEq)]
pub struct Facets {
    /// The vertices whose copies follow the mesh's own.
    copies: Vec<u32>,
    /// The triangles of the mesh; no two share a vertex.
    triangles: Vec<[u32; 3]>,
}

impl Facets {
    /// Those of a mesh.
    pub fn new(vertex_count: usize, triangles: &[[u32; 3]]) -> Facets {
        let (mut is_used, mut copies) = (vec![false; vertex_count], Vec::new());
        let mut own = |vertex: u32| match is_used.get_mut(vertex as usize) {
            Some(is_used) if !*is_used => {
                *is_used = true;
                vertex
            }
            _ => {
                copies.push(vertex);
                (vertex_count + copies.len() - 1) as u32
            }
        };
        let triangles = triangles.iter().map(|corners| corners.map(&mut own)).collect();
        Facets { copies, triangles }
    }

    /// The triangles that are drawn: indices of vertices and copies.
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    /// Number of copies.
    pub fn copy_count(&self) -> usize {
        self.copies.len()
    }

    /// Appends the values of the copies to those of the vertices, which begin at `first`.
    pub fn extend<T: Clone>(&self, values: &mut Vec<T>, first: usize) {
        values.reserve(self.copies.len());
        for &vertex in &self.copies {
            values.push(values[first + vertex as usize].clone());
        }
    }

    /// Appends the unit normals of the vertices and their copies. A triangle without an area has that of the direction of
    /// its first vertex.
    pub fn append_normals(&self, positions: impl Fn(usize) -> DVec3, count: usize, normals: &mut Vec<[f32; 3]>) {
        let first = normals.len();
        normals.resize(first + count + self.copies.len(), [0.0, 0.0, 1.0]);
        for drawn in &self.triangles {
            let vertex = |i: u32| match (i as usize).checked_sub(count) {
                Some(copy) => self.copies[copy] as usize,
                None => i as usize,
            };
            let [a, b, c] = drawn.map(|i| positions(vertex(i)));
            let area = (b - a).cross(c - a);
            let normal = area.try_normalize().unwrap_or_else(|| a.normalize_or(DVec3::Z)).as_vec3().to_array();
            drawn.iter().for_each(|&i| normals[first + i as usize] = normal);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_triangle_has_its_own_vertices_and_normal() {
        let corners = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
        let triangles = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
        let facets = Facets::new(corners.len(), &triangles);
        let mut positions = corners.to_vec();
        facets.extend(&mut positions, 0);
        let mut seen: Vec<u32> = facets.triangles().iter().flatten().copied().collect();
        seen.sort_unstable();
        assert_eq!(seen, (0..12).collect::<Vec<u32>>());
        assert_eq!(positions.len(), 12);
        let mut normals = vec![[9.0; 3]];
        facets.append_normals(|i| corners[i], corners.len(), &mut normals);
        assert_eq!(normals.len(), 13);
        let diagonal = DVec3::ONE.normalize().as_vec3().to_array();
        let expected = [[0.0, 0.0, -1.0], [0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], diagonal];
        for ((drawn, of), normal) in facets.triangles().iter().zip(triangles).zip(expected) {
            assert_eq!(drawn.map(|i| positions[i as usize]), of.map(|i| corners[i as usize]));
            assert_eq!(drawn.map(|i| normals[1 + i as usize]), [normal; 3]);
        }
    }
}
