//! Benchmarks. A speed is reported together with the error and the machine.
//!
//! | command | what it measures | module |
//! | --- | --- | --- |
//! | `bench error` | error against run time, for every integrator and a range of step sizes | [`mod@error`] |
//! | `bench scale` | cost of a step against the number of bodies | [`scale`] |
//! | `bench record` | frames per second and bytes per frame by detail and destination, beside the SDK's `log()` | [`record`] |
//! | `bench models` | the models of a soft body, side by side | [`models`] |
//! | `bench surface` | unions of many spheres, and scenes with the surface of every frame | [`surface`] |
//! | `bench stability` | every integrator at the limits of every setting | [`stability`] |
//! | `bench thesis` | the thesis's figures and claims, section by section | [`thesis`], [`influence`] |
//!
//! Errors are measured against [`reference`], an independent solution that shares no code with the integrators. Each
//! benchmark returns a [`report::Report`], from which the terminal, `--csv` and `--svg` follow.

pub mod chart;
pub mod error;
pub mod influence;
pub mod judge;
pub mod models;
pub mod record;
pub mod reference;
pub mod report;
pub mod scale;
pub mod stability;
pub mod surface;
pub mod thesis;

use crate::{
    SceneError,
    scene::{Body, Path},
    sim::{self, WorldError},
};
use reference::NoReference;

/// Why something cannot be measured.
#[derive(Debug, thiserror::Error)]
pub enum MeasureError {
    /// A built-in scene is missing.
    #[error("the built-in scene \"{0}\" is missing")]
    NoScene(&'static str),
    /// A model cannot run a scene, or its run fails.
    #[error("{0}")]
    Model(String),
    /// A derived scene is not valid.
    #[error("a case is not a valid scene: {0}")]
    Scene(#[from] SceneError),
    /// No reference solution is available.
    #[error(transparent)]
    NoReference(#[from] NoReference),
    /// The scene needs more memory than is available.
    #[error(transparent)]
    World(#[from] WorldError),
    /// The scene's own run fails before its end.
    #[error(transparent)]
    Failed(#[from] sim::Failure),
    /// Worker threads could not be started.
    #[error("cannot start threads: {0}")]
    Threads(#[from] rayon::ThreadPoolBuildError),
}

/// The path of a body, where only those on paths matter.
fn path(body: &Body) -> &Path {
    body.path().unwrap_or(&NOWHERE)
}

/// The path of a body or force point, see [`Scene::source_path`]; a fixed one for a free body.
fn source_path(scene: &crate::scene::Scene, source: usize) -> &Path {
    scene.source_path(source).unwrap_or(&NOWHERE)
}

static NOWHERE: Path = Path::Fixed(glam::DVec3::ZERO);
