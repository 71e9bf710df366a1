//! The surface of a set of cells: closed and oriented for any set.

use std::collections::{HashMap, HashSet};

use crate::disjoint_sets::DisjointSets;

/// The faces of a cell as corners, counter-clockwise seen from outside.
const FACES: [[usize; 4]; 6] = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];

/// The faces that belong to only one cell.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BoundaryMesh {
    /// Node of each vertex and one of its cells: `(node, cell)`, `[vertex_count]`.
    pub vertices: Vec<(u32, u32)>,
    /// Vertex indices, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

/// The boundary of the cells for which `is_there` holds, given their initial and current corner nodes, some of which
/// may have been split.
///
/// Two cells are joined if they initially shared the four nodes of a face, and still share at least one: a crack
/// appears only where a face has come apart completely, since the two sides of a partly split face coincide. A node
/// between cells that are not joined through faces around it has one vertex for each set of joined cells. An edge
/// therefore has two triangles, or four if two cells that touch only there are joined around both of its ends.
pub fn boundary(first: &[[u32; 8]], corners: &[[u32; 8]], is_there: impl Fn(usize) -> bool) -> BoundaryMesh {
    let present = || (0..corners.len()).filter(|&cell| is_there(cell));
    let face_of = |cell: usize, face: usize| FACES[face].map(|corner| first[cell][corner]);
    let mut faces: HashMap<[u32; 4], (u32, u32)> = HashMap::new();
    // the second sides of faces that have come apart
    let mut apart: HashSet<(u32, u32)> = HashSet::new();
    // cells around a node, joined through faces: a forest of the cells' corners
    let mut sets = DisjointSets::singletons(8 * corners.len());
    for cell in present() {
        for face in 0..6 {
            let nodes = face_of(cell, face);
            let mut key = nodes;
            key.sort_unstable();
            let Some(&(other, other_face)) = faces.get(&key) else {
                faces.insert(key, (cell as u32, face as u32));
                continue;
            };
            // the corners of the two cells that were initially the same node
            let pairs = FACES[face].map(|corner| {
                let its = FACES[other_face as usize];
                (corner, its.into_iter().find(|&across| first[other as usize][across] == first[cell][corner]))
            });
            let shares = |&(corner, across): &(usize, Option<usize>)| {
                across.is_some_and(|across| corners[other as usize][across] == corners[cell][corner])
            };
            if !pairs.iter().any(shares) {
                apart.insert((cell as u32, face as u32));
                continue;
            }
            faces.remove(&key);
            for (corner, across) in pairs {
                let Some(across) = across else { continue };
                sets.join(8 * cell as u32 + corner as u32, 8 * other + across as u32);
            }
        }
    }
    // faces shared by joined cells were removed from the map, so the remaining ones are on the boundary; in cell order
    let mut mesh = BoundaryMesh::default();
    let mut vertex_of: HashMap<u32, u32> = HashMap::new();
    for cell in present() {
        for face in 0..6 {
            let mut key = face_of(cell, face);
            key.sort_unstable();
            let this = (cell as u32, face as u32);
            if faces.get(&key) != Some(&this) && !apart.contains(&this) {
                continue;
            }
            let quad = FACES[face].map(|corner| {
                let set = sets.least(8 * cell as u32 + corner as u32);
                *vertex_of.entry(set).or_insert_with(|| {
                    mesh.vertices.push((corners[cell][corner], cell as u32));
                    mesh.vertices.len() as u32 - 1
                })
            });
            let [a, b, c, d] = quad;
            mesh.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    mesh
}
