//! The shapes that a scene can name.

use std::{
    collections::HashMap,
    hash::Hash,
    sync::{Arc, LazyLock, Mutex, PoisonError, Weak},
};

use super::{mesh::Mesh, sphere::Sphere};

/// A shape that is made from a few whole numbers.
pub trait Solid: Clone + Ord + Hash {
    /// Its key in a scene's `shape`.
    const NAME: &'static str;
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

macro_rules! shapes {
    ($($Kind:ident: $name:literal),* $(,)?) => {
        /// The rest shape of a body, of radius 1.
        #[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum Shape {
            $(#[doc = concat!("`shape = { ", $name, " = { … } }`")] $Kind($Kind)),*
        }

        impl Shape {
            /// All kinds of shapes, in the order in which they are listed to users.
            pub const KINDS: &'static [Kind] = &[$(Kind {
                name: $name,
                home: concat!("in shape = { ", $name, " = { … } }"),
                form: <$Kind as Solid>::FORM,
                keys: <$Kind as Solid>::KEYS,
                parameters: <$Kind as Solid>::PARAMETERS,
                make: |parameters| Shape::$Kind(<$Kind as Solid>::new(parameters)),
            }),*];
            /// Their keys.
            pub const NAMES: &'static [&'static str] = &[$($name),*];

            /// Number of vertices.
            pub fn vertex_count(&self) -> u64 {
                match self { $(Shape::$Kind(solid) => solid.vertex_count()),* }
            }

            /// Number of triangles.
            pub fn triangle_count(&self) -> u64 {
                match self { $(Shape::$Kind(solid) => solid.triangle_count()),* }
            }

            /// A name that no other shape has: letters, digits and `_`.
            pub fn label(&self) -> String {
                match self { $(Shape::$Kind(solid) => label($name, &solid.parameters())),* }
            }

            fn build(&self) -> Mesh {
                match self { $(Shape::$Kind(solid) => solid.mesh()),* }
            }
        }
    };
}

// A new shape is a file beside this one and a line here.
shapes! {
    Sphere: "sphere",
}

impl Default for Shape {
    fn default() -> Shape {
        Shape::Sphere(Sphere::default())
    }
}

fn label(name: &str, parameters: &[u32]) -> String {
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
