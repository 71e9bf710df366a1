//! `meldscope scenes`: lists the built-in scenes and sweeps, or shows one.

use super::{Failure, print, print_lines};
use crate::{
    scene::{Scene, builtin},
    sweep,
    text::{counted, did_you_mean},
};

#[derive(clap::Args)]
pub struct Arguments {
    /// Print the text of this scene or sweep: a file to start from.
    #[arg(long, value_name = "NAME")]
    show: Option<String>,
}

/// Lists the built-in scenes with the number of their bodies and vertices and what to look for, and the sweeps.
pub fn scenes(arguments: &Arguments) -> Result<(), Failure> {
    if let Some(name) = &arguments.show {
        return show(name);
    }
    for builtin in builtin::ALL {
        let Some(scene) = Scene::builtin(builtin.name) else { continue };
        let (bodies, vertices) = (scene.bodies.len() as u64, scene.vertex_count());
        print(&format!("{}: {}, {}", builtin.name, counted(bodies, "body"), counted(vertices, "vertex")));
        for sentence in builtin.what_to_look_at() {
            print(&format!("    {sentence}"));
        }
    }
    print("");
    print("Sweeps, which run a scene with many values of a key:");
    for builtin in sweep::builtin::ALL {
        let about = builtin.text.lines().next().unwrap_or_default();
        print(&format!("{}: {}", builtin.name, about.trim_start_matches(['#', ' '])));
    }
    print("");
    print("`meldscope run NAME` runs a scene, `meldscope sweep NAME --out DIR` a sweep.");
    print("`meldscope scenes --show NAME` prints its text, and `meldscope reference scene` explains every key.");
    Ok(())
}

fn show(name: &str) -> Result<(), Failure> {
    // With the meshes that it names, so that its text alone is a scene; without its name, so that the recording of the
    // user's file is named after that file.
    let own_name = format!("name = {name:?}");
    let unnamed = |text: &str| text.lines().filter(|line| *line != own_name).collect::<Vec<_>>().join("\n");
    let scene = Scene::builtin(name).map(|scene| unnamed(&scene.source));
    let sweep = || sweep::builtin::ALL.iter().find(|builtin| builtin.name == name);
    let Some(text) = scene.or_else(|| Some(sweep()?.text.to_owned())) else {
        let scenes = builtin::ALL.iter().map(|builtin| builtin.name);
        let hint = did_you_mean(name, scenes.chain(sweep::builtin::ALL.iter().map(|builtin| builtin.name)));
        return Err(Failure::Input(format!(
            "there is no built-in scene or sweep {name:?}{hint} (`meldscope scenes` lists them)"
        )));
    };
    print_lines(text.trim_end());
    Ok(())
}
