//! Options that override keys of a scene: the same for every command that runs one.

use std::sync::Arc;

use super::Failure;
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
    /// Whether the scene stays as it is.
    pub fn is_empty(&self) -> bool {
        self.set.is_empty() && self.integrator.is_none() && self.model.is_none()
    }

    /// The scene with these changes; `file` is its name in errors.
    pub fn apply(&self, scene: Scene, file: &str) -> Result<Scene, Failure> {
        let mut scene = scene.with(&self.set, file).map_err(|error| Failure::Input(format!("--set: {error}")))?;
        scene.integrator = self.integrator.unwrap_or(scene.integrator);
        scene.model = self.model.unwrap_or(scene.model);
        Ok(scene)
    }

    /// The scene of a recording with these changes.
    pub fn rerun(&self, recorded: &Recorded) -> Result<Arc<dyn Experiment>, Failure> {
        let (was, mut settings) = (&recorded.schema, recorded.run.clone());
        let scene = Scene::parse(&was.source, &was.name).map_err(Failure::input)?;
        let scene = self.apply(scene, &was.name)?;
        let sets = |key: &str| self.set.iter().any(|one| one.key() == key);
        if self.integrator.is_some() || sets("integrator") {
            settings.insert("integrator".to_owned(), scene.integrator.name().into());
        }
        if self.model.is_some() || sets("model") {
            settings.insert("model".to_owned(), scene.model.name().into());
        }
        for (key, number) in [("dt", scene.dt), ("tolerance", scene.tolerance)] {
            if sets(key) {
                settings.insert(key.to_owned(), number.into());
            }
        }
        let set = settings.entry("set").or_insert_with(|| toml::Value::Array(Vec::new()));
        if let toml::Value::Array(set) = set {
            set.extend(self.set.iter().map(|one| one.to_string().into()));
        }
        models::read(&was.name, &was.source, &settings)
            .map_err(|(Refusal::Source(what) | Refusal::Run(what))| Failure::Input(what))
    }
}
