//! Rest shapes: positions, normals, triangles and masses, and the shapes that a scene can name.
//!
//! | contents | module |
//! | --- | --- |
//! | a closed triangle mesh | [`mesh`] |
//! | the parameters of a shape, and its mesh shared by all bodies | [`shape`] |
//! | one file per shape | [`sphere`] |
//! | closed meshes from files | [`files`] |
//! | arrays of vectors | [`vectors`] |
//! | smoothing of the crease where surfaces meet | [`fairing`] |
//! | the union of overlapping meshes, and geometric measures of a pair | [`union`] |
//!
//! A new shape is a file that implements [`shape::Solid`] and an entry in the table below. This module does not depend
//! on bodies, scenes or time.

use glam::DVec3;

mod facets;
pub mod fairing;
pub mod files;
pub mod mesh;
pub mod shape;
pub mod sphere;
pub mod union;
pub mod vectors;

pub use facets::Facets;
pub use files::MeshFile;
pub use mesh::{Mesh, Rest};
pub use vectors::Vectors;

/// The least and the largest corner of the box around spheres (centre and radius); infinite if there are none.
pub fn bounds(spheres: impl Iterator<Item = (DVec3, f64)>) -> [DVec3; 2] {
    spheres.fold([DVec3::INFINITY, DVec3::NEG_INFINITY], |[low, high], (centre, radius)| {
        [low.min(centre - radius), high.max(centre + radius)]
    })
}

/// Sorts items by the number of their group, below `groups`, and by their order in each. Returns where each group starts,
/// followed by the number of items; and the items.
fn grouped<T: Copy + Default>(groups: usize, items: impl Iterator<Item = (u32, T)> + Clone) -> (Vec<u32>, Vec<T>) {
    // Counts are kept two places ahead of their groups, and starts one place ahead: each of these has advanced to the
    // next one in the end.
    let mut starts = vec![0; groups + 2];
    items.clone().for_each(|(group, _)| starts[group as usize + 2] += 1);
    (2..starts.len()).for_each(|group| starts[group] += starts[group - 1]);
    let mut sorted = vec![T::default(); starts[groups + 1] as usize];
    for (group, item) in items {
        let next = &mut starts[group as usize + 1];
        sorted[*next as usize] = item;
        *next += 1;
    }
    starts.pop();
    (starts, sorted)
}

shape::shapes! {
    sphere::Sphere: "sphere",
}
