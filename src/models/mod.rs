//! The models of a soft body that a scene can be simulated with, and the one place that chooses between them.
//!
//! | `model` | what a body is | where |
//! | --- | --- | --- |
//! | `oscillators` | vertices that are damped oscillators about their rest positions (the thesis's own, chapter 3) | [`crate::sim`] |
//! | `metaballs` | a density about its centre, and a level of it as surface (2.2.3) | [`metaballs`] |
//! | `lattice` | cubes of masses and springs (2.1.1, 2.2.2) | [`lattice`], [`elastic`] |
//! | `fem` | linear finite elements (2.1.2) | [`fem`], [`elastic`] |
//!
//! Each is a [`Simulation`] of the same [`Scene`], so that all instruments show them alike. What a model has no use for in a
//! scene, it says in [`Schema::warnings`]; what it cannot do without being wrong, it refuses as [`Unsupported`].
//!
//! Models import `sim`, `observe`, `scene`, `geometry` and `model`; nothing of these imports models.

pub mod cells;
pub mod elastic;
pub mod fem;
pub mod lattice;
pub mod metaballs;
pub mod side_by_side;

use std::sync::Arc;

use crate::{
    observe::{Experiment, Refusal, Schema, Simulation},
    scene::{Integrator, Model, Scene},
    sim::{Options, World, simulation},
    text::did_you_mean,
};
use metaballs::Metaballs;
use side_by_side::SideBySide;

/// A scene and the options for stepping it: starts the simulation of its [model](Scene::model).
#[derive(Clone, Debug)]
pub struct SceneRun {
    /// The scene to simulate.
    pub scene: Scene,
    /// How it is stepped.
    pub options: Options,
}

/// Something of a scene that its model cannot do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "scene \"{scene}\" cannot run with model = \"{model}\": {}{what}; {remedy}",
    .body.as_ref().map_or(String::new(), |body| format!("body \"{body}\": "))
)]
pub struct Unsupported {
    /// Name of the scene.
    pub scene: String,
    /// The model.
    pub model: Model,
    /// The body that it cannot simulate, if it is a single one.
    pub body: Option<String>,
    /// The key of the scene and what the model cannot do with it.
    pub what: String,
    /// What to do.
    pub remedy: String,
}

impl Experiment for SceneRun {
    fn schema(&self) -> Schema {
        match self.scene.model {
            Model::Oscillators => simulation::schema(&self.scene, self.options),
            Model::Metaballs => metaballs::schema(&self.scene, self.options),
            Model::Lattice | Model::Fem => elastic::schema(&self.scene, self.options),
        }
    }

    fn start(&self) -> Result<Box<dyn Simulation>, String> {
        let SceneRun { scene, options } = self;
        match scene.model {
            Model::Oscillators => match World::with_options(scene.clone(), *options) {
                Ok(world) => Ok(Box::new(world)),
                Err(error) => Err(error.to_string()),
            },
            Model::Metaballs => Ok(Box::new(Metaballs::new(scene, *options)?)),
            Model::Lattice | Model::Fem => Ok(Box::new(elastic::Elastic::new(scene.clone(), *options)?)),
        }
    }

    fn read(&self, name: &str, text: &str, run: &toml::Table) -> Result<Arc<dyn Experiment>, Refusal> {
        read(name, text, run)
    }
}

impl Experiment for Scene {
    fn schema(&self) -> Schema {
        SceneRun { scene: self.clone(), options: Options::default() }.schema()
    }

    fn start(&self) -> Result<Box<dyn Simulation>, String> {
        SceneRun { scene: self.clone(), options: Options::default() }.start()
    }

    fn read(&self, name: &str, text: &str, run: &toml::Table) -> Result<Arc<dyn Experiment>, Refusal> {
        read(name, text, run)
    }
}

/// Reads a recorded scene: its text, and the settings of its run.
///
/// # Errors
/// The text is not a valid scene, or the settings are unknown here.
pub fn read(name: &str, text: &str, run: &toml::Table) -> Result<Arc<dyn Experiment>, Refusal> {
    let mut scene = Scene::parse(text, name).map_err(|error| Refusal::Source(error.to_string()))?;
    let positive = |key: &str| {
        let number = run.get(key).and_then(toml::Value::as_float).filter(|number| Scene::POSITIVE.contains(number));
        number.ok_or_else(|| Refusal::Run(format!("the settings have no usable {key}")))
    };
    let integrator = run.get("integrator").and_then(toml::Value::as_str).unwrap_or("none");
    scene.integrator = Integrator::ALL
        .into_iter()
        .find(|known| known.name() == integrator)
        .ok_or_else(|| Refusal::Run(format!("this program has no integrator \"{integrator}\"")))?;
    // what was recorded before there were other models does not name its own
    let model = run.get("model").map_or(Some(Model::Oscillators.name()), toml::Value::as_str).unwrap_or("none");
    scene.model = parse(model).map_err(|_| Refusal::Run(format!("this program has no model \"{model}\"")))?;
    scene.dt = positive("dt")?;
    scene.tolerance = positive("tolerance")?;
    let skip = run.get("skip").and_then(toml::Value::as_bool).unwrap_or(true);
    let options = Options { skip, ..Options::default() };
    if let Some(names) = run.get("models").and_then(toml::Value::as_array) {
        let named = |name: &toml::Value| parse(name.as_str().unwrap_or("none"));
        let models = names.iter().map(named).collect::<Result<Vec<_>, _>>();
        let models = models.map_err(|_| Refusal::Run("this program has not all of its models".to_owned()))?;
        return Ok(Arc::new(SideBySide { scene, options, models }));
    }
    Ok(Arc::new(SceneRun { scene, options }))
}

/// The model of this name.
///
/// # Errors
/// There is none; says which there are, and the nearest one.
pub fn parse(name: &str) -> Result<Model, String> {
    let names = Model::ALL.map(Model::name);
    let known = Model::ALL.into_iter().find(|model| model.name() == name);
    known.ok_or_else(|| format!("expected one of {}{}", names.join(", "), did_you_mean(name, names.into_iter())))
}

/// Refuses a scene whose model is not the oscillators, for `what` works with [`World`] alone.
///
/// # Errors
/// The scene has another model.
pub fn need_oscillators(scene: &Scene, what: &str) -> Result<(), Unsupported> {
    match scene.model {
        Model::Oscillators => Ok(()),
        model => Err(Unsupported {
            scene: scene.name.clone(),
            model,
            body: None,
            what: format!("{what} measures the oscillators only"),
            remedy: "remove the key model".to_owned(),
        }),
    }
}
