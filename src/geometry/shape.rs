//! The kinds of shape that a scene can name; the parent module contains their table.

use std::{
    collections::HashMap,
    hash::Hash,
    sync::{Arc, LazyLock, Mutex, Weak},
};

use super::{Mesh, Shape, Sphere};

/// A shape with integer parameters.
pub trait Solid: Clone + Eq + Hash {
    /// The parameters, in the order of [`Solid::new`].
    const PARAMETERS: &'static [Parameter];
    /// What the shape is.
    const ABOUT: &'static str;
    /// The form of the shape's entry in a scene, for messages.
    const FORM: &'static str;

    /// Creates the shape from its parameters.
    fn new(parameters: &[u32]) -> Self;

    /// The values of the parameters.
    fn parameters(&self) -> Vec<u32>;

    /// Number of vertices, computed without creating them.
    fn vertex_count(&self) -> u64;

    /// Number of triangles, computed without creating them.
    fn triangle_count(&self) -> u64;

    /// Creates the vertices and triangles.
    fn mesh(&self) -> Mesh;
}

/// An integer parameter of a shape.
#[derive(Clone, Copy, Debug)]
pub struct Parameter {
    /// Its key in scene files.
    pub name: &'static str,
    /// What it is.
    pub about: &'static str,
    /// The smallest allowed value.
    pub least: u32,
    /// The largest allowed value.
    pub most: u32,
    /// The value if none is given.
    pub default: u32,
}

/// A kind of shape.
pub struct Kind {
    /// Its key in scene files.
    pub name: &'static str,
    /// Where its parameters belong, for messages.
    pub home: &'static str,
    /// The form of its entry in a scene, for messages.
    pub form: &'static str,
    /// What the shape is.
    pub about: &'static str,
    /// Its parameters.
    pub parameters: &'static [Parameter],
    /// Creates a shape of this kind.
    pub make: fn(&[u32]) -> Shape,
}

/// The table of shapes.
macro_rules! shapes {
    ($($module:ident::$Kind:ident: $name:literal),* $(,)?) => {
        $(pub use $module::$Kind;)*

        /// The rest shape of a body, of radius 1.
        #[derive(Clone, Debug, PartialEq, Eq, Hash)]
        pub enum Shape {
            $(#[doc = concat!("`shape = { ", $name, " = { … } }`")] $Kind($Kind),)*
            /// `shape = { mesh = "FILE" }`
            Mesh($crate::geometry::MeshFile),
        }

        impl Shape {
            /// All kinds of shapes, in the order in which they are listed to users.
            pub const KINDS: &'static [$crate::geometry::shape::Kind] = &[$($crate::geometry::shape::Kind {
                name: $name,
                home: concat!("in shape = { ", $name, " = { … } }"),
                form: <$Kind as $crate::geometry::shape::Solid>::FORM,
                about: <$Kind as $crate::geometry::shape::Solid>::ABOUT,
                parameters: <$Kind as $crate::geometry::shape::Solid>::PARAMETERS,
                make: |parameters| Shape::$Kind(<$Kind as $crate::geometry::shape::Solid>::new(parameters)),
            }),*];

            /// Number of vertices, computed without creating them.
            pub fn vertex_count(&self) -> u64 {
                match self {
                    $(Shape::$Kind(solid) => $crate::geometry::shape::Solid::vertex_count(solid),)*
                    Shape::Mesh(file) => file.mesh().vertex_count() as u64,
                }
            }

            /// Number of triangles, computed without creating them.
            pub fn triangle_count(&self) -> u64 {
                match self {
                    $(Shape::$Kind(solid) => $crate::geometry::shape::Solid::triangle_count(solid),)*
                    Shape::Mesh(file) => file.mesh().triangles().len() as u64,
                }
            }

            /// The first parameter that is out of its range, with its value.
            pub(crate) fn out_of_range(&self) -> Option<(&'static $crate::geometry::shape::Parameter, u32)> {
                use $crate::geometry::shape::Solid;
                match self {
                    $(Shape::$Kind(solid) => {
                        let mut all = <$Kind as Solid>::PARAMETERS.iter().zip(solid.parameters());
                        all.find(|(parameter, value)| !(parameter.least..=parameter.most).contains(value))
                    })*
                    Shape::Mesh(_) => None,
                }
            }

            /// A label unique to this shape: letters, digits and `_`.
            pub fn label(&self) -> String {
                match self {
                    $(Shape::$Kind(solid) => $crate::geometry::shape::label($name, &$crate::geometry::shape::Solid::parameters(solid)),)*
                    Shape::Mesh(file) => file.label().to_owned(),
                }
            }

            pub(super) fn build(&self) -> std::sync::Arc<Mesh> {
                match self {
                    $(Shape::$Kind(solid) => std::sync::Arc::new($crate::geometry::shape::Solid::mesh(solid)),)*
                    Shape::Mesh(file) => file.mesh().clone(),
                }
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

/// The meshes in use.
static MESHES: LazyLock<Mutex<HashMap<Shape, Weak<Mesh>>>> = LazyLock::new(Mutex::default);

impl Shape {
    /// The mesh of this shape, shared by all callers as long as any of them holds it.
    pub fn mesh(&self) -> Arc<Mesh> {
        let mut meshes = crate::lock(&MESHES);
        if let Some(mesh) = meshes.get(self).and_then(Weak::upgrade) {
            return mesh;
        }
        if meshes.len() == meshes.capacity() {
            meshes.retain(|_, mesh| mesh.strong_count() > 0);
        }
        let mesh = self.build();
        meshes.insert(self.clone(), Arc::downgrade(&mesh));
        mesh
    }
}
