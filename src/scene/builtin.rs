//! The built-in scenes: files in `recordings/`, compiled in.

use super::Scene;

/// A scene file that is compiled into the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Builtin {
    /// Its name on the command line.
    pub name: &'static str,
    /// The scene file.
    pub text: &'static str,
}

/// All built-in scenes, in the order in which they are listed to users.
pub const ALL: [Builtin; 8] = [
    Builtin { name: "push", text: include_str!("../../recordings/push.toml") },
    Builtin { name: "two", text: include_str!("../../recordings/two.toml") },
    Builtin { name: "three", text: include_str!("../../recordings/three.toml") },
    Builtin { name: "size_ratio", text: include_str!("../../recordings/size_ratio.toml") },
    Builtin { name: "crowd", text: include_str!("../../recordings/crowd.toml") },
    Builtin { name: "collide", text: include_str!("../../recordings/collide.toml") },
    Builtin { name: "orbit", text: include_str!("../../recordings/orbit.toml") },
    Builtin { name: "drop", text: include_str!("../../recordings/drop.toml") },
];

impl Builtin {
    /// What to watch for: the lines of the comment at the head of the file.
    pub fn what_to_look_at(&self) -> impl Iterator<Item = &'static str> {
        self.text.lines().map_while(|line| line.strip_prefix('#')).map(str::trim)
    }
}

impl Scene {
    /// A built-in scene: `push`, `two`, `three`, `size_ratio`, `crowd`, `collide`, `orbit` or `drop`; `None` for other
    /// names.
    pub fn builtin(name: &str) -> Option<Scene> {
        let builtin = ALL.iter().find(|builtin| builtin.name == name)?;
        // A test parses every built-in scene, so an error would mean a broken build; the scene is then treated as
        // absent.
        Scene::parse(builtin.text, builtin.name).ok()
    }
}
