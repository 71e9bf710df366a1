//! A visual debugger for soft bodies that merge and split.
//!
//! A 2006 thesis (海上 一徳, 「リアルタイム 3DCG における融合・分裂を考慮したソフトボディ表現」) shows soft bodies that merge and split in real time: every
//! vertex is a damped oscillator about its remembered rest position; each body carries an *influence sphere*, which
//! attracts or repels the vertices of other bodies, switched by distance. This crate steps that simulation and streams
//! it to the [Rerun](https://rerun.io) viewer, so that the merge and split thresholds can be inspected frame by frame.
//!
//! # The map of the house
//!
//! | module | what | knows |
//! | --- | --- | --- |
//! | [`model`] | the equations, scalar and readable, each with its number | nothing |
//! | [`geometry`] | rest shapes: positions, normals, triangles, masses | nothing |
//! | [`scene`] | the scene file: parse, validate, centre paths | `model`, `geometry` |
//! | [`observe`] | what an instrument may know of a simulation, anybody's | `geometry` |
//! | [`sim`] | the world, the step, integrators, events, reach | `scene`, `observe` |
//! | [`stream`] | frames as Rerun data: entities, blueprint, sinks | `observe` |
//! | [`recording`] | recordings read back: replay, check, diff | `stream` |
//! | [`bench`] | benchmarks: error against run time; the independent reference solution | `sim` |
//! | [`cli`] | one file a subcommand | all |
//!
//! Imports point one way, upwards in this table. Nothing in `model`, `geometry`, `scene`, `observe` or `sim` knows Rerun: they are
//! what `default-features = false` leaves, a few dozen small crates. The feature `viewer` adds `stream` and `recording`,
//! `cli` (the default) all of it. A program that wants the simulation alone needs no more than this:
//!
//! ```
//! use meldscope::{Scene, World};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let scene = Scene::parse(
//!     r#"
//!     duration = 2.0
//!
//!     [[body]]
//!     name = "still"
//!     radius = 1.0
//!     motion = { fixed = [0, 0, 0] }
//!
//!     [[body]]
//!     name = "passing"
//!     radius = 0.8
//!     motion = { line = { from = [2.5, 0, 0], velocity = [-0.5, 0, 0] } }
//!     "#,
//!     "example.toml",
//! )?;
//!
//! let mut world = World::new(scene)?;
//! for _ in 0..world.scene().steps() {
//!     let report = world.step();
//!     for event in &report.events {
//!         println!("{} at {:.9} s", event.name(), event.time);
//!     }
//! }
//!
//! let passing = world.body(1);
//! println!("vertex 0 is at {}", passing.position(0));
//! println!("the pair is {}", world.phase(0, 1));
//! assert_eq!(world.phase(0, 1), meldscope::model::phase::Phase::Merged);
//!
//! let mut forces = meldscope::sim::BodyForces::default();
//! world.forces(1, &mut forces);
//! let pull = forces.of(meldscope::sim::Cause::Attraction).iter().map(|f| f.length()).fold(0.0, f64::max);
//! assert!(pull > 0.0);
//! # Ok(())
//! # }
//! ```

// No input may bring the program down.
#![cfg_attr(not(test), warn(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

#[cfg(feature = "cli")]
pub mod bench;
#[cfg(feature = "cli")]
pub mod cli;
pub mod geometry;
pub mod model;
pub mod observe;
#[cfg(feature = "viewer")]
pub mod recording;
pub mod scene;
pub mod sim;
#[cfg(feature = "viewer")]
pub mod stream;
#[doc(hidden)]
pub mod text;

pub use scene::{Scene, SceneError};
pub use sim::{StepReport, World};
