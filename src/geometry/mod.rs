//! Rest shapes: positions, normals, triangles and masses, and the shapes that a scene can name.
//!
//! | what | where |
//! | --- | --- |
//! | a closed surface of triangles | [`mesh`] |
//! | the table of shapes, and one mesh for all bodies of a shape | [`shape`] |
//! | a file for each shape | [`sphere`] |
//! | arrays of vectors | [`vectors`] |
//!
//! A new shape is a file that implements [`shape::Solid`] and its line in the table of [`shape`]. Nothing here knows bodies,
//! scenes or time.

pub mod mesh;
pub mod shape;
pub mod sphere;
pub mod vectors;

pub use mesh::{Mesh, Rest, Rings};
pub use shape::Shape;
pub use sphere::Sphere;
pub use vectors::Vectors;
