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

shape::shapes! {
    sphere::Sphere: "sphere",
}
