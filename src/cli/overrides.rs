//! Options that override keys of a scene: the same for every command that runs one.

use super::Failure;
use crate::{
    models,
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
}
