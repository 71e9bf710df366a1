//! The models of a soft body, and the choice between them.
//!
//! | `model` | a body is | module |
//! | --- | --- | --- |
//! | `oscillators` | vertices that are damped oscillators about their rest positions (the thesis's own, chapter 3) | [`crate::sim`] |
//! | `metaballs` | a density around its centre, with a level set as surface (2.2.3) | [`metaballs`] |
//! | `lattice` | cubes of masses and springs (2.1.1, 2.2.2) | [`lattice`], [`elastic`] |
//! | `fem` | linear finite elements (2.1.2) | [`fem`], [`elastic`] |
//!
//! Each is a [`Simulation`] of the same [`Scene`], and is observed in the same way. A model lists the parts of a scene
//! that it ignores in [`Schema::warnings`], and rejects what it cannot simulate correctly as [`Unsupported`].
//!
//! | | free bodies | pushes, planes, force points | shapes from meshes |
//! | --- | --- | --- | --- |
//! | `oscillators` | yes | yes | yes |
//! | `metaballs` | rejected: a density has no mass, so forces cannot move it | ignored, with a warning | rejected: only spheres are supported |
//! | `lattice` | yes, except `rotation = "fixed"` | yes | yes, as the cells that cover them |
//! | `fem` | yes, except `rotation = "fixed"`; co-rotated as a whole | yes | yes, as the cells that cover them |
//!
//! [`side_by_side`] runs several of them as one simulation, and `meldscope bench models` measures them.
//!
//! Models import `sim`, `observe`, `view`, `analysis`, `scene`, `geometry` and `model`; none of these imports models.
//!
//! # Claims of the thesis, and measurements
//! `meldscope bench thesis` measures most of these claims again, and those of the other chapters.
//!
//! Chapter 2 compares the models from the literature. Measured here with `bench models two` (two bodies of 266
//! vertices, steps of 1/60 s; lattice and finite elements of 6 cells along a diameter) on one core of an AMD EPYC. A
//! frame is a step, the state with its forces, and the merged surface.
//!
//! | model | step | frame | build | error against its own converged run | surfaces joined from – to |
//! | --- | --- | --- | --- | --- | --- |
//! | `oscillators` | 0.003 ms | 0.25 ms | 0.01 ms | 8e-9 R | 1.480 – 3.389 s |
//! | `metaballs` | 0.002 ms | 0.75 ms | 0.04 ms | below 1e-12 R | 1.214 – 2.928 s |
//! | `lattice` | 0.082 ms | 0.41 ms | 1.1 ms | 6e-4 R | 1.465 – 2.831 s |
//! | `fem` | 0.097 ms | 0.54 ms | 3.2 ms | 1e-3 R | 1.464 – 2.830 s |
//!
//! By the thresholds on q, all four merge at 1.397 s and split at 3.315 s. They take 303,000, 654,000, 12,200 and
//! 10,300 steps per second, compared with 6,400 for Jolt's soft bodies: the oscillators are 25 and 30 times as fast as
//! lattice and finite elements. On `collide`, with free bodies, lattice and finite elements merge within 2e-5 s of each
//! other, and first enter and leave the core within 3e-3 s: they are two discretisations of nearly the same solid. They use
//! 0.9 and 1.1 MiB on `two` (`bench models`).
//!
//! 1,000 of the cases of `bench stability`, run with these models, each limited to 60 steps or 0.3 s; every failure
//! reported its cause (a test runs the first 200):
//!
//! | model | completed | cut short | rejected | diverged | step not taken |
//! | --- | --- | --- | --- | --- | --- |
//! | `metaballs` | 995 | 5 | 0 | 0 | 0 |
//! | `lattice` | 863 | 82 | 31 | 3 | 21 |
//! | `fem` | 947 | 9 | 41 | 3 | 0 |
//!
//! The lattice cases that fail or are cut short vary ω, damping, free bodies or everything; of 100 cases that vary only
//! the influence, one was cut short.
//!
//! | thesis | measured |
//! | --- | --- |
//! | 2.1.1: springs cannot describe the physical properties of a real object directly | no: the springs of a cubic cell have a Young's modulus; only Poisson's ratio is fixed, at 1/4 ([`lattice`]) |
//! | 2.1.1: force reaches only the neighbours of a mass, so too much of it breaks the structure locally | yes, without a spring that breaks: at ω = 12 the attraction of `three` turns cells inside out, which no spring resists, and the surfaces enclose 46.8 % less; at ω = 24 no cell is, and they enclose 4.5 % less, as merged bodies overlap |
//! | 2.1.1: with too large a step the model oscillates and diverges; the limit has to be found by trial | there is a limit (10.2 ms on `two`, below its step of 16.7 ms), but it can be computed, and the step is divided accordingly |
//! | 2.1.1: the cost of a cycle grows with the number of masses and springs | yes: a step of `two` evaluates 2 × 2,842 springs three times, 41 µs of one core per body, about 4.8 ns per spring |
//! | 2.1.2: finite elements describe Young's modulus and Poisson's ratio directly, with good accuracy | yes; for the accuracy, see the tests of [`fem`] |
//! | 2.1.2: they take an enormous amount of computation, and are not suitable for real time | no, at this size: 0.1 ms of the 16.7 ms of a frame, after 3.2 ms to build |
//! | 2.1.2: with a precomputed inverse they are, as long as the topology does not change | yes, with a factorisation instead: the inverse is slower at every size measured (26 nodes and more) |
//! | 2.2.1: where stress tears the body the matrix has to be rebuilt, which real time does not allow | no at 6 cells, where it takes no more than the build above; yes at 12 cells, where it takes 30 times as long. Here nothing is rebuilt: position and time are reported as `would tear` |
//! | 2.2.2: springs beyond a length are cut with their cells, which loses volume | yes: 22 % of the volume, 80 cells, on `two` with `tear = "cut"`, `limit = 0.12`. More cells lose less: on `figure-2-2b` 50 % with 8 along the bar, 19 % with 16, 10 % with 32 |
//! | 2.2.2: nodes beyond a force are split, which keeps the volume and costs more | volume is kept: 298 split nodes lose no cell with `limit = 0.1`. It costs more: the steps of `figure-2-2c` take 2 to 3 times as long as those of `figure-2-2b` |
//! | 2.2.3: densities add up, so that facing sides bulge and join | yes: at q = 1.0983, before lone balls would touch (q = 1), 0.184 s before they merge by `merge_at`; they part 0.387 s before they split |
//! | 2.2.3: merging and splitting need only a simple algorithm | yes: a whole step takes 0.002 ms; the exact time is a root of one function of time |
//! | 2.2.3: ray casting is too expensive for real time, marching cubes are usual | second claim only: extraction (marching tetrahedra) takes most of a frame of 0.75 ms; rays are not cast, because the viewer draws meshes |
//! | 2.2.3: physical properties are not considered, so that dynamics are hard to simulate | yes: pushes, planes, force points and materials have no effect, and free bodies are rejected |

pub mod cells;
pub mod elastic;
pub mod fem;
pub mod lattice;
pub mod metaballs;
pub mod side_by_side;
mod variation;

use std::sync::Arc;

use crate::{
    observe::{Experiment, InvalidVariation, Parameter, Refusal, Schema, Simulation, Variation},
    scene::{Body, Integrator, Model, Scene, SceneError, template::Override},
    sim::{Options, World, memory},
    text::did_you_mean,
    view,
};
use metaballs::Metaballs;
use side_by_side::SideBySide;

/// A scene and the options for stepping it: starts the simulation of its [model](Scene::model).
#[derive(Clone, Debug)]
pub struct SceneRun {
    /// The scene to simulate.
    pub scene: Scene,
    /// Options of its step.
    pub options: Options,
}

/// A part of a scene that its model does not support.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("scene \"{scene}\": {key}: cannot run with model = \"{model}\": {what}; {remedy}")]
pub struct Unsupported {
    /// Name of the scene.
    pub scene: String,
    /// The model.
    pub model: Model,
    /// The path of the unsupported key, such as `body["a"].motion.free`.
    pub key: String,
    /// Why it is unsupported.
    pub what: String,
    /// What to do.
    pub remedy: String,
}

impl Unsupported {
    fn new(scene: &Scene, key: impl Into<String>, what: impl Into<String>, remedy: &str) -> Unsupported {
        Unsupported {
            scene: scene.name.clone(),
            model: scene.model,
            key: key.into(),
            what: what.into(),
            remedy: remedy.to_owned(),
        }
    }

    /// Rejects edits, for models that have none.
    fn edits(scene: &Scene) -> Result<(), Unsupported> {
        if scene.edits.is_empty() {
            return Ok(());
        }
        let what = "the model does not change within a run";
        Err(Unsupported::new(scene, "edit", what, "leave the edits out, or choose model = \"oscillators\""))
    }

    /// This error at its place in the scene's text; `file` is the name of that.
    pub fn in_file(self, scene: &Scene, file: &str) -> SceneError {
        let message = format!("cannot run with model = \"{}\": {}", self.model, self.what);
        scene.error_at(file, self.key, message, self.remedy)
    }
}

impl Experiment for SceneRun {
    fn schema(&self) -> Schema {
        match self.scene.model {
            Model::Oscillators => view::schema(&self.scene),
            Model::Metaballs => metaballs::schema(&self.scene),
            Model::Lattice | Model::Fem => elastic::schema(&self.scene),
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

    fn parameters(&self) -> Vec<Parameter> {
        variation::parameters(self)
    }

    fn can_poke(&self) -> bool {
        self.scene.model != Model::Metaballs
    }

    fn varied(&self, variation: &Variation) -> Result<Arc<dyn Experiment>, InvalidVariation> {
        variation::varied(self, variation)
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
    let scene = Scene::parse(text, name).map_err(|error| Refusal::Source(error.to_string()))?;
    let set = run.get("set").and_then(toml::Value::as_array).into_iter().flatten();
    let set = set.map(|one| Override::parse(one.as_str().unwrap_or_default())).collect::<Result<Vec<_>, _>>();
    let set = set.map_err(|error| Refusal::Run(format!("a key that its settings set: {error}")))?;
    let mut scene = scene.with(&set, name).map_err(|error| Refusal::Run(error.to_string()))?;
    memory::check_shapes(&scene).map_err(|error| Refusal::Run(error.to_string()))?;
    let positive = |key: &str| {
        let number = run.get(key).and_then(toml::Value::as_float).filter(|number| Scene::POSITIVE.contains(number));
        number.ok_or_else(|| Refusal::Run(format!("the settings have no usable {key}")))
    };
    let integrator = run.get("integrator").and_then(toml::Value::as_str).unwrap_or("none");
    scene.integrator = Integrator::ALL
        .into_iter()
        .find(|known| known.name() == integrator)
        .ok_or_else(|| Refusal::Run(format!("this program has no integrator \"{integrator}\"")))?;
    // recordings made before other models existed do not name a model
    let model = run.get("model").map_or(Some(Model::Oscillators.name()), toml::Value::as_str).unwrap_or("none");
    scene.model = parse(model).map_err(|_| Refusal::Run(format!("this program has no model \"{model}\"")))?;
    if !run.contains_key("free_cores") {
        scene.drop_core_defaults();
    }
    scene.dt = positive("dt")?;
    scene.tolerance = positive("tolerance")?;
    if run.contains_key("skip") {
        let what = "it was made with --no-skip, whose checksums only versions up to November 2026 have";
        return Err(Refusal::Run(what.to_owned()));
    }
    let options = Options::default();
    if let Some(names) = run.get("models").and_then(toml::Value::as_array) {
        let named = |name: &toml::Value| parse(name.as_str().unwrap_or("none"));
        let models = names.iter().map(named).collect::<Result<Vec<_>, _>>();
        let models = models.map_err(|_| Refusal::Run("this program lacks some of its models".to_owned()))?;
        return Ok(Arc::new(SideBySide { scene, options, models }));
    }
    Ok(Arc::new(SceneRun { scene, options }))
}

/// Rejects a scene that its model does not support.
///
/// # Errors
/// [`Unsupported`], naming the key.
pub fn check(scene: &Scene) -> Result<(), Unsupported> {
    match scene.model {
        Model::Oscillators => Ok(()),
        Model::Metaballs => metaballs::check(scene),
        Model::Lattice | Model::Fem => elastic::check(scene),
    }
}

/// The path of a key of a body.
fn key_of(body: &Body, key: &str) -> String {
    format!("body[\"{}\"].{key}", body.name)
}

/// The model of this name.
///
/// # Errors
/// There is no such model; the error lists all names and the nearest one.
pub fn parse(name: &str) -> Result<Model, String> {
    let names = Model::ALL.map(Model::name);
    let known = Model::ALL.into_iter().find(|model| model.name() == name);
    known.ok_or_else(|| format!("expected one of {}{}", names.join(", "), did_you_mean(name, names.into_iter())))
}

/// Rejects a scene whose model is not `oscillators`, because `what` works with [`World`] only.
///
/// # Errors
/// The scene has another model.
pub fn need_oscillators(scene: &Scene, what: &str) -> Result<(), Unsupported> {
    match scene.model {
        Model::Oscillators => Ok(()),
        _ => {
            let what = format!("{what} measures the oscillators only");
            Err(Unsupported::new(scene, "model", what, "remove the key model"))
        }
    }
}
