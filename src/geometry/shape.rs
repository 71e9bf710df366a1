//! The shapes that a scene can name; the table of them is in the module above.

use std::{
    collections::HashMap,
    hash::Hash,
    sync::{Arc, LazyLock, Mutex, PoisonError, Weak},
};

use super::{Mesh, Shape, Sphere};

/// A shape that is made from a few whole numbers.
pub trait Solid: Clone + Ord + Hash {
    /// The numbers, in the order in which they are given to [`Solid::new`].
    const PARAMETERS: &'static [Parameter];
    /// The keys of these.
    const KEYS: &'static [&'static str];
    /// What a scene gives for it, in words.
    const FORM: &'static str;

    /// From its numbers.
    fn new(parameters: &[u32]) -> Self;

    /// Its numbers.
    fn parameters(&self) -> Vec<u32>;

    /// Number of vertices, before they are made.
    fn vertex_count(&self) -> u64;

    /// Number of triangles, before they are made.
    fn triangle_count(&self) -> u64;

    /// Its vertices and triangles.
    fn mesh(&self) -> Mesh;
}

/// A whole number that a shape is made from.
#[derive(Clone, Copy, Debug)]
pub struct Parameter {
    /// The least that it can be …
    pub least: u32,
    /// … the most …
    pub most: u32,
    /// … and what it is if nothing is said.
    pub default: u32,
}

/// A kind of shape, as the scene file has it.
pub struct Kind {
    /// Its key.
    pub name: &'static str,
    /// Where its numbers belong, in words.
    pub home: &'static str,
    /// What a scene gives for it, in words.
    pub form: &'static str,
    /// The keys of its numbers …
    pub keys: &'static [&'static str],
    /// … and what they can be.
    pub parameters: &'static [Parameter],
    /// A shape of this kind.
    pub make: fn(&[u32]) -> Shape,
}

/// The table of shapes.
macro_rules! shapes {
    ($($module:ident::$Kind:ident: $name:literal),* $(,)?) => {
        $(pub use $module::$Kind;)*

        /// The rest shape of a body, of radius 1.
        #[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum Shape {
            $(#[doc = concat!("`shape = { ", $name, " = { … } }`")] $Kind($Kind)),*
        }

        impl Shape {
            /// All kinds of shapes, in the order in which they are listed to users.
            pub const KINDS: &'static [$crate::geometry::shape::Kind] = &[$($crate::geometry::shape::Kind {
                name: $name,
                home: concat!("in shape = { ", $name, " = { … } }"),
                form: <$Kind as $crate::geometry::shape::Solid>::FORM,
                keys: <$Kind as $crate::geometry::shape::Solid>::KEYS,
                parameters: <$Kind as $crate::geometry::shape::Solid>::PARAMETERS,
                make: |parameters| Shape::$Kind(<$Kind as $crate::geometry::shape::Solid>::new(parameters)),
            }),*];
            /// Their keys.
            pub const NAMES: &'static [&'static str] = &[$($name),*];

            /// Number of vertices, before they are made.
            pub fn vertex_count(&self) -> u64 {
                match self { $(Shape::$Kind(solid) => $crate::geometry::shape::Solid::vertex_count(solid)),* }
            }

            /// Number of triangles, before they are made.
            pub fn triangle_count(&self) -> u64 {
                match self { $(Shape::$Kind(solid) => $crate::geometry::shape::Solid::triangle_count(solid)),* }
            }

            /// A name that no other shape has: letters, digits and `_`.
            pub fn label(&self) -> String {
                match self { $(Shape::$Kind(solid) => $crate::geometry::shape::label($name, &$crate::geometry::shape::Solid::parameters(solid))),* }
            }

            pub(super) fn build(&self) -> Mesh {
                match self { $(Shape::$Kind(solid) => $crate::geometry::shape::Solid::mesh(solid)),* }
            }
        }
    };
}
pub(super) use shapes;

impl Default for Shape {
    fn default() -> Shape {
        Shape::Sphere(Sphere::default())
    }
}

pub(super) fn label(name: &str, parameters: &[u32]) -> String {
    let parameters: Vec<String> = parameters.iter().map(u32::to_string).collect();
    if parameters.is_empty() { name.to_owned() } else { format!("{name}_{}", parameters.join("x")) }
}

/// The meshes that are in use.
static MESHES: LazyLock<Mutex<HashMap<Shape, Weak<Mesh>>>> = LazyLock::new(Mutex::default);

impl Shape {
    /// Its mesh: one for all who ask, as long as any of them holds it.
    pub fn mesh(&self) -> Arc<Mesh> {
        let mut meshes = MESHES.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(mesh) = meshes.get(self).and_then(Weak::upgrade) {
            return mesh;
        }
        if meshes.len() == meshes.capacity() {
            meshes.retain(|_, mesh| mesh.strong_count() > 0);
        }
        let mesh = Arc::new(self.build());
        meshes.insert(self.clone(), Arc::downgrade(&mesh));
        mesh
    }
}
