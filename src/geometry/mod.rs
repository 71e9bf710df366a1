//! Rest shapes: positions, normals, triangles and masses, and the shapes that a scene can name.
//!
//! | what | where |
//! | --- | --- |
//! | a closed surface of triangles | [`mesh`] |
//! | what a shape is made from, and one mesh for all bodies of a shape | [`shape`] |
//! | a file for each shape | [`sphere`] |
//! | arrays of vectors | [`vectors`] |
//! | one surface of many that overlap, and what geometry says of a pair | [`union`] |
//!
//! A new shape is a file that implements [`shape::Solid`] and its lines in the table below. Nothing here knows bodies,
//! scenes or time.

pub mod mesh;
pub mod shape;
pub mod sphere;
pub mod union;
pub mod vectors;

pub use mesh::{Mesh, Rest, Rings};
pub use vectors::Vectors;

// A new shape is a file beside this one, which `pub mod` names, and a line here.
shape::shapes! {
    sphere::Sphere: "sphere",
}
