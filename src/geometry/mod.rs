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

shape::shapes! {
    sphere::Sphere: "sphere",
}
