//! `meldscope scenes`: lists the built-in scenes.

use super::print;
use crate::{
    scene::{Scene, builtin},
    text::counted,
};

/// Lists the built-in scenes: name, number of bodies and vertices, what to look for.
pub fn list() {
    for builtin in builtin::ALL {
        let Some(scene) = Scene::builtin(builtin.name) else { continue };
        let (bodies, vertices) = (scene.bodies.len() as u64, scene.vertex_count());
        print(&format!("{}: {}, {}", builtin.name, counted(bodies, "body"), counted(vertices, "vertex")));
        for sentence in builtin.what_to_look_at() {
            print(&format!("    {sentence}"));
        }
    }
    print("");
    print("Run one with `meldscope run NAME`, or any scene file with `meldscope run SCENE.toml`.");
}
