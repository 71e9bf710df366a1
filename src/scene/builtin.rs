//! The built-in scenes: those in `recordings/`, beside their golden recordings, those of the thesis's figures, and one
//! that is too large to have a golden recording.
//!
//! | thesis | scene |
//! | --- | --- |
//! | Fig. 2.1: the springs of a cell | `figure-2-1` |
//! | Fig. 2.2a and b: a lattice deforms, springs are cut | `figure-2-2b` |
//! | Fig. 2.2c: nodes are split | `figure-2-2c` |
//! | Fig. 2.3: metaballs join | `figure-2-3` |
//! | Fig. 4.1: an outside force | `figure-4-1`; `push` is larger and faster |
//! | Fig. 4.2: two objects | `figure-4-2`; `two` is larger, with hysteresis and a snap |
//! | Fig. 4.3: three objects | `figure-4-3`; `three` is larger, and of different sizes |
//! | section 4.3: very different sizes | `section-4-3`, and its cure `size_ratio` |
//!
//! `meldscope bench thesis` measures what the thesis says of each.

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
pub const ALL: [Builtin; 18] = [
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
    bar("figure-2-1", include_str!("thesis/figure-2-1.toml")),
    bar("figure-2-2b", include_str!("thesis/figure-2-2b.toml")),
    bar("figure-2-2c", include_str!("thesis/figure-2-2c.toml")),
    scene("figure-2-3", include_str!("thesis/figure-2-3.toml")),
    scene("figure-4-1", include_str!("thesis/figure-4-1.toml")),
    scene("figure-4-2", include_str!("thesis/figure-4-2.toml")),
    scene("figure-4-3", include_str!("thesis/figure-4-3.toml")),
    scene("section-4-3", include_str!("thesis/section-4-3.toml")),
];

const fn scene(name: &'static str, text: &'static str) -> Builtin {
    Builtin { name, text, meshes: &[] }
}

const fn bar(name: &'static str, text: &'static str) -> Builtin {
    Builtin { name, text, meshes: &[("bar.obj", include_str!("../../recordings/bar.obj"))] }
}

impl Builtin {
    /// What to look for: the lines of the comment at the head of the file.
    pub fn what_to_look_at(&self) -> impl Iterator<Item = &'static str> {
        self.text.lines().map_while(|line| line.strip_prefix('#')).map(str::trim)
    }
}

impl Scene {
    /// A built-in scene, by its name in [`ALL`]; `None` for other names.
    pub fn builtin(name: &str) -> Option<Scene> {
        let builtin = ALL.iter().find(|builtin| builtin.name == name)?;
        // a test parses every built-in scene, so an error means a broken build; the scene then counts as unknown
        Scene::parse_given(builtin.text, builtin.name, builtin.meshes).ok()
    }
}
