//! A visual debugger for soft bodies that merge and split.
//!
//! A 2006 thesis (海上 一徳, 「リアルタイム 3DCG における融合・分裂を考慮したソフトボディ表現」) describes soft bodies that merge and split in real
//! time. Every vertex is a damped oscillator about its rest position. Each body carries an *influence sphere*, which
//! attracts or repels the vertices of other bodies; distance thresholds switch between the two. This crate runs that
//! simulation and streams it to the [Rerun](https://rerun.io) viewer, where the merge and split thresholds can be
//! inspected frame by frame.
//!
//! # Your own simulation
//!
//! The debugger works with any simulation, not only this crate's: implement [`observe::Simulation`] for it, and
//! [`observe::Experiment`] for what starts it. It gets the viewer, forces by cause, thresholds and phases, events, stages,
//! timings, checksums, `diff`, golden recordings, the flight recorder, and thin recordings with replay.
//! This is a complete example, with two force terms, two thresholds and events of its own; the tests of this crate run it:
//!
//! ```ignore
#![doc = include_str!("../tests/suite/octahedra.rs")]
//! ```
//!
//! What it does not need: bodies that come and go ([`is_absent`](observe::BodyFrame::is_absent)) or tear
//! ([`can_tear`](observe::schema::BodySchema::can_tear)), forces at points of contact ([`PointForce`](observe::PointForce)), flat
//! faces ([`Mesh::faceted`](geometry::Mesh::faceted)), events of single bodies
//! ([`body_events`](observe::StepSummary::body_events)), planes ([`planes`](observe::Schema::planes)), surfaces of groups that are
//! not unions ([`surfaces`](observe::Schema::surfaces)). Vectors are those of [`glam`], which this crate re-exports in the version
//! that it takes, and so is [`toml`].
//!
//! [`observe::verify()`] reports mistakes of an implementation in plain sentences. Then it is recorded, replayed, compared
//! and checked, which restarts it with `Octahedra::read`:
//!
//! ```ignore
//! use meldscope::{observe, recording::{Recorded, diff, golden, replay}, stream::{self, Settings, sinks::Destinations}};
//!
//! let octahedra = Octahedra::two(3.0);
//! observe::verify(&octahedra, 100).map_err(|mistakes| mistakes.join("\n"))?;
//!
//! let destinations = Destinations::file("octahedra.rrd");
//! stream::record(&octahedra, Settings::of(&octahedra), &destinations)?;
//!
//! let open = |path: &str| Recorded::open_as(path.as_ref(), &|name, text, run| octahedra.read(name, text, run));
//! let recorded = open("octahedra.rrd")?;
//! println!("{:?}", replay::verify(&recorded, |_step| true)?); // Identical, or the first step that differs
//! println!("{}", diff::diff([&recorded, &open("other.rrd")?], 1e-6)?);
//!
//! golden::bless(&octahedra, "octahedra-golden.rrd".as_ref(), "first version")?; // a regression test
//! golden::check(&octahedra, "octahedra-golden.rrd".as_ref(), None)?;
//! ```
//!
//! And a program of its own for it, with `run`, `live`, `replay`, `check`, `explain`, `diff`, `export` and `sweep`, as `meldscope` has
//! them for scenes (`cargo run --release --example octahedra -- run octahedra --serve`):
//!
//! ```ignore
//! fn main() -> std::process::ExitCode {
//!     meldscope::cli::run(std::env::args_os(), |name| match name {
//!         "octahedra" => Ok(std::sync::Arc::new(Octahedra::two(3.0))),
//!         _ => Err("there is octahedra only".to_owned()),
//!     })
//! }
//! ```
//!
//! # Modules
//!
//! | module | contents | imports | feature |
//! | --- | --- | --- | --- |
//! | [`model`] | the equations, scalar and readable, each with its number | | |
//! | `text` | formatting of numbers and text for output | | |
//! | [`hash`] | hashes of exact states | | |
//! | `random` | random numbers, the same on every machine | `hash` | |
//! | `disjoint_sets` | sets of what is connected | | |
//! | `interrupt` | flags that interrupt long-running work | | |
//! | `parallel` | work on several threads | | |
//! | [`geometry`] | rest shapes (positions, normals, triangles, masses) and the union of overlapping surfaces | `random`, `disjoint_sets`, `interrupt`, `parallel` | |
//! | [`colors`] | a palette | | |
//! | [`scene`] | scene files: parsing, validation, centre paths | `model`, `geometry`, `random`, `text` | |
//! | [`sim`] | the world and its step: forces, integrators, events, solver of free bodies | `model`, `geometry`, `text`, `hash`, `disjoint_sets`, `interrupt`, `parallel`, `scene` | |
//! | [`observe`] | the contract between a simulation and its observers: schema, frames, events | `model`, `text`, `interrupt`, `geometry`, `colors` | |
//! | [`analysis`] | what is computed from frames: surfaces, touches, closest approaches | `disjoint_sets`, `interrupt`, `parallel`, `model`, `geometry`, `observe` | |
//! | [`view`] | how the world presents itself: titles, colours, plots, arrows, cameras | all above but `analysis` | |
//! | [`models`] | the models of a soft body, and which of them runs a scene | all above | |
//! | `atomic` | files that are either complete or not there | | `viewer` |
//! | [`sdk`] | the parts of the Rerun SDK that are used | | `viewer` |
//! | [`stream`] | frames as Rerun data: entities, blueprint, sinks | `geometry`, `text`, `hash`, `colors`, `observe`, `analysis`, `atomic`, `sdk` | `viewer` |
//! | `svg` | diagrams: shapes, text, ticks | `colors` | `cli` |
//! | [`table`] | tables as CSV, JSON and Parquet files | `atomic`, `sdk` | `cli` |
//! | [`recording`] | reading recordings: replay, check, diff | all above | `viewer` |
//! | [`sweep`] | grids of runs over a scene's parameters, refinement, thresholds, maps | all above | `cli` |
//! | [`live`] | the page with sliders, and the runs that answer it | `colors`, `observe`, `sdk`, `stream`, `atomic` | `cli` |
//! | [`bench`] | benchmarks, and an independent reference solution | all above | `cli` |
//! | [`cli`] | the command line, one file per subcommand | all above | `cli` |
//!
//! A module imports only from modules above it in this table. `stream` draws any simulation that implements
//! [`observe::Simulation`].
//!
//! # Features
//!
//! With `default-features = false`, the crate is the simulation alone, without Rerun: a few dozen small dependencies.
//! The feature `viewer` adds `stream` and `recording`, which is all that recording, replaying and comparing needs; `cli`, the
//! default, adds `viewer`, `bench`, the program and [`cli::run`].
//!
//! Cargo takes profiles from the program's `Cargo.toml` alone. The section `[profile.release.package]` of this crate's
//! compiles without optimisation what of the SDK runs once or never: copied, it halves the processor time of a first build
//! (some 22 minutes without it), and recordings are written as fast:
//!
//! ```sh
//! sed -n '/^\[profile.release.package\]/,/^$/p' meldscope/Cargo.toml >> Cargo.toml
//! ```
//!
//! A program that needs only this crate's own simulation looks like this:
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
//! for event in world.run(world.scene().steps())? {
//!     println!("{} at {:.9} s", event.name(), event.time);
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

// No input may crash the program.
#![cfg_attr(not(test), warn(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

/// Defines an enum whose variants have names for users, with all variants in order.
macro_rules! named {
    ($(#[$about:meta])* pub enum $Name:ident { $($(#[$of_variant:meta])* $Variant:ident = $name:literal,)+ }) => {
        $(#[$about])*
        pub enum $Name {
            $($(#[$of_variant])* $Variant,)+
        }

        impl $Name {
            /// All of them, in the order in which they are listed to users.
            pub const ALL: [$Name; [$($name),+].len()] = [$($Name::$Variant),+];

            /// The name in files and tables, and on the command line.
            pub const fn name(self) -> &'static str {
                match self {
                    $($Name::$Variant => $name,)+
                }
            }
        }
    };
}

pub mod analysis;
#[cfg(feature = "viewer")]
#[cfg_attr(not(feature = "cli"), allow(dead_code))] // recordings need a part of it
mod atomic;
#[cfg(feature = "cli")]
pub mod bench;
#[cfg(feature = "cli")]
pub mod cli;
pub mod colors;
mod disjoint_sets;
pub mod geometry;
pub mod hash;
mod interrupt;
#[cfg(feature = "cli")]
pub mod live;
pub mod model;
pub mod models;
pub mod observe;
mod parallel;
#[doc(hidden)]
pub mod random;
#[cfg(feature = "viewer")]
pub mod recording;
pub mod scene;
#[cfg(feature = "viewer")]
pub mod sdk;
pub mod sim;
#[cfg(feature = "viewer")]
pub mod stream;
#[cfg(feature = "cli")]
mod svg;
#[cfg(feature = "cli")]
pub mod sweep;
#[cfg(feature = "cli")]
pub mod table;
#[doc(hidden)]
pub mod text;
#[doc(hidden)]
pub mod view;

use std::sync::{Mutex, MutexGuard, PoisonError};

pub use glam;
pub use scene::{Scene, SceneError};
pub use sim::{StepReport, World};
pub use toml;

/// Locks a mutex. A thread that panicked while it held the lock has left usable data everywhere in this crate: each change
/// is a single assignment, or a counter may be off by one.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
