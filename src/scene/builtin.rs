//! The built-in scenes: those in `recordings/`, beside their golden recordings, and one that is too large to have a
//! golden recording.

use super::Scene;

/// A scene file that is compiled into the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Builtin {
    /// Its name on the command line.
    pub name: &'static str,
    /// The scene file.
    pub text: &'static str,
    /// Names and contents of the mesh files that it uses.
    pub meshes: &'static [(&'static str, &'static str)],
}

/// All built-in scenes, in the order in which they are listed to users.
pub const ALL: [Builtin; 10] = [
    scene("push", include_str!("../../recordings/push.toml")),
    scene("two", include_str!("../../recordings/two.toml")),
    scene("three", include_str!("../../recordings/three.toml")),
    scene("size_ratio", include_str!("../../recordings/size_ratio.toml")),
    scene("crowd", include_str!("../../recordings/crowd.toml")),
    scene("collide", include_str!("../../recordings/collide.toml")),
    scene("orbit", include_str!("../../recordings/orbit.toml")),
    scene("drop", include_str!("../../recordings/drop.toml")),
    Builtin {
        name: "mesh",
        text: include_str!("../../recordings/mesh.toml"),
        meshes: &[
            ("knot.obj", include_str!("../../recordings/knot.obj")),
            ("star.obj", include_str!("../../recordings/star.obj")),
        ],
    },
    scene("rain", include_str!("rain.toml")),
];

const fn scene(name: &'static str, text: &'static str) -> Builtin {
    Builtin { name, text, meshes: &[] }
}

impl Builtin {
    /// What to look for: the lines of the comment at the head of the file.
    pub fn what_to_look_at(&self) -> impl Iterator<Item = &'static str> {
        self.text.lines().map_while(|line| line.strip_prefix('#')).map(str::trim)
    }
}

impl Scene {
    /// A built-in scene: `push`, `two`, `three`, `size_ratio`, `crowd`, `collide`, `orbit`, `drop`, `mesh` or `rain`; `None`
    /// for other names.
    pub fn builtin(name: &str) -> Option<Scene> {
        let builtin = ALL.iter().find(|builtin| builtin.name == name)?;
        // a test parses every built-in scene, so an error means a broken build; the scene then counts as unknown
        Scene::parse_given(builtin.text, builtin.name, builtin.meshes).ok()
    }
}
