//! Scenes that a command line names: files and built-ins.

use std::path::Path;

use super::{
    Failure,
    progress::{Progress, Work},
};
use crate::{
    models,
    recording::existing::Existing,
    scene::{Scene, SceneError, builtin},
    sim::memory,
    text::did_you_mean,
};

/// Reads a scene file; meshes may take long.
pub fn read(path: &Path) -> Result<Scene, Failure> {
    let progress = Progress::new("reading the scene", Work::Share);
    let loaded = Scene::load_watched(path, &|mesh, share| {
        progress.stage(format!("reading {mesh}"));
        progress.set_share(share);
    });
    loaded.map_err(Failure::input).and_then(fitting)
}

/// Refuses a scene that its model cannot run; `file` is its name in errors, and `option` a key whose value is not that of
/// the file.
pub fn supported(scene: Scene, file: &str, option: Option<&str>) -> Result<Scene, Failure> {
    let scene = fitting(scene)?;
    models::check(&scene).map_err(|error| {
        let error = error.in_file(&scene, file);
        let place = error.place.filter(|_| option != Some(&error.key));
        Failure::input(SceneError { place, ..error })
    })?;
    Ok(scene)
}

/// Refuses a scene whose shapes do not fit into memory.
fn fitting(scene: Scene) -> Result<Scene, Failure> {
    memory::check_shapes(&scene).map_err(Failure::input)?;
    Ok(scene)
}

/// The built-in scene with this name, or the scene in this file.
pub fn scene(name: &str) -> Result<Scene, Failure> {
    match Scene::builtin(name) {
        Some(scene) => Ok(scene),
        None => {
            file("scene", name, &builtin::ALL.map(|builtin| builtin.name), "; see `meldscope scenes`")?;
            let path = Path::new(name);
            if Existing::is_recording(path) {
                let word = shell_word(name);
                return Err(Failure::Input(format!(
                    "{name} is a recording, not a scene: `meldscope replay {word}` runs it again"
                )));
            }
            read(path)
        }
    }
}

/// The folder of a scene file, with the meshes that it names.
pub fn folder(name: &str) -> Option<&Path> {
    let path = Path::new(name);
    if path.is_file() { path.parent() } else { None }
}

/// Rejects what is neither the name of a built-in scene or sweep nor that of a file.
pub fn file(what: &str, name: &str, builtin: &[&str], help: &str) -> Result<(), Failure> {
    if Path::new(name).exists() || name.contains(['/', '\\', '.']) {
        return Ok(());
    }
    let (hint, names) = (did_you_mean(name, builtin.iter().copied()), builtin.join(", "));
    Err(Failure::Input(format!(
        "no {what} {name:?}{hint} (there is no such file, and the built-in {what}s are {names}{help})"
    )))
}

/// Quotes a path for a shell, if necessary.
pub fn shell_word(path: &str) -> String {
    let is_plain = |c: char| c.is_alphanumeric() || "/._-+@%:,".contains(c);
    match path.starts_with('-') {
        true => shell_word(&format!("./{path}")),
        false if path.chars().all(is_plain) => path.to_owned(),
        false => format!("'{}'", path.replace('\'', r"'\''")),
    }
}
