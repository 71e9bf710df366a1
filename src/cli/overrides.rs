//! Options that override keys of a scene: the same for every command that runs one.

use std::{path::Path, sync::Arc};

use super::{Failure, load};
use crate::{
    models,
    observe::{Experiment, Refusal},
    recording::Recorded,
    scene::{Integrator, Model, Scene, template::Override},
};

/// What a command changes in a scene.
#[derive(clap::Args, Clone, Default)]
pub struct Overrides {
    /// Another value for a key of the scene, such as influence.merge_at=1.1 (`meldscope reference scene` lists the
    /// keys); may be repeated.
    #[arg(long, value_name = "KEY=VALUE", value_parser = Override::parse, help_heading = "Scene")]
    pub set: Vec<Override>,
    /// Another integrator.
    #[arg(long, value_parser = parse_integrator, value_name = "thesis|mps|euler|verlet|rk4|exponential",
          help_heading = "Scene")]
    pub integrator: Option<Integrator>,
    /// Another model of a soft body.
    #[arg(long, value_parser = models::parse, value_name = "oscillators|metaballs|lattice|fem", help_heading = "Scene")]
    pub model: Option<Model>,
}

fn parse_integrator(text: &str) -> Result<Integrator, String> {
    let known = Integrator::ALL.into_iter().find(|integrator| integrator.name() == text);
    known.ok_or_else(|| format!("expected one of {}", Integrator::ALL.map(Integrator::name).join(", ")))
}

impl Overrides {
    /// The scene with these changes; `file` is its name in errors.
    pub fn apply(&self, scene: Scene, file: &str) -> Result<Scene, Failure> {
        for (option, is_given) in [("integrator", self.integrator.is_some()), ("model", self.model.is_some())] {
            if is_given && self.set.iter().any(|set| set.key() == option) {
                return Err(Failure::Input(format!("--{option} and --set {option}=… are both given: leave one out")));
            }
        }
        let mut scene = with(scene, &self.set, file, load::folder(file))?;
        scene.integrator = self.integrator.unwrap_or(scene.integrator);
        scene.model = self.model.unwrap_or(scene.model);
        load::supported(scene, file, self.integrator.map(|_| "integrator"))
    }
}

fn with(scene: Scene, set: &[Override], file: &str, folder: Option<&Path>) -> Result<Scene, Failure> {
    if let Some([first, second]) = scene.set_twice(set).map(|twice| twice.map(|index| set[index].key())) {
        let what = if first == second { "is given twice".to_owned() } else { format!("sets {first} again") };
        return Err(Failure::Input(format!("--set {second}=… {what}: leave one out")));
    }
    scene.with_files(set, file, folder).map_err(|error| Failure::Input(format!("--set: {error}")))
}

/// The scene of a recording with these changes.
pub fn rerun(set: &[Override], recorded: &Recorded) -> Result<Arc<dyn Experiment>, Failure> {
    let (was, mut settings) = (&recorded.schema, recorded.run.clone());
    // a scene without a name has that of its file
    let file = format!("{}.toml", was.name);
    let scene = Scene::parse(&was.source, &file).map_err(Failure::input)?;
    let scene = with(scene, set, &file, None)?;
    let values: [(&str, toml::Value); 4] = [
        ("integrator", scene.integrator.name().into()),
        ("model", scene.model.name().into()),
        ("dt", scene.dt.into()),
        ("tolerance", scene.tolerance.into()),
    ];
    for (key, value) in values {
        if set.iter().any(|one| one.key() == key) {
            settings.insert(key.to_owned(), value);
        }
    }
    if let toml::Value::Array(all) = settings.entry("set").or_insert_with(|| toml::Value::Array(Vec::new())) {
        let key = |one: &toml::Value| one.as_str().and_then(|one| Some(one.split_once('=')?.0.trim().to_owned()));
        all.retain(|one| !set.iter().any(|new| key(one).as_deref() == Some(new.key())));
        all.extend(set.iter().map(|one| one.to_string().into()));
    }
    models::read(&file, &was.source, &settings)
        .map_err(|(Refusal::Source(what) | Refusal::Run(what))| Failure::Input(what))
}
