//! Benchmarks. Every speed is reported together with the error and the machine.
//!
//! | contents | module |
//! | --- | --- |
//! | error against run time, for every integrator and a range of step sizes | [`mod@error`] |
//! | cost against the number of bodies, and its goals | [`scale`] |
//! | the independent solution that errors are measured against | [`reference`], by [`extrapolation`] |
//! | shared parts of diagrams and tables | `drawing`, `tables` |
//! | goals and measured values | [`goals`] |
//! | the machine that run times were measured on | [`machine`] |
//! | a stress sweep of every integrator, and bodies of very different sizes | [`stability`] |
//! | recording cost by detail and destination, verification cost, and their goals | [`record`] |
//! | unions of many spheres, and a scene with the surface of every frame | [`surface`] |
//! | the soft-body models side by side | [`models`] |
//! | output files, checked before and written after measuring | [`output`] |
//!
//! # Results
//! The figures are from 2026-11-21, before steps counted their work, which adds 7 to 11 % instructions per step
//! (Callgrind). Run the commands for the figures of this version on your machine.
//!
//! **Error against run time** (`bench error`): every integrator over a range of step sizes, compared with an
//! independent solution by extrapolation that shares no code with the integrators. The table shows the largest error
//! over time and vertices at the scene's own Δt (`exponential` in fixed steps of that length), in radii, against a
//! solution accurate to 1e-13 (`bench error tests/reference/*.toml`):
//!
//! | scene (`tests/reference/`) | thesis | mps | euler | verlet | rk4 | exponential |
//! | --- | --- | --- | --- | --- | --- | --- |
//! | push | 4.1e-1 | 9.5e-2 | 2.9e-2 | 1.7e-2 | 4.5e-3 | < 1e-13 |
//! | two | 2.2e-1 | 9.0e-2 | 1.3e-2 | 3.7e-3 | 5.1e-3 | 6e-10 |
//! | three | 2.0e-1 | 9.5e-2 | 1.4e-2 | 2.2e-2 | 2.2e-2 | 6e-10 |
//! | size_ratio | 4.3e-1 | 3.8e-1 | 1.1e-2 | 6.8e-3 | 7.1e-3 | 1.5e-12 |
//!
//! **Stability** (`bench stability`): thousands of small scenes at the limits of every setting (step sizes of 1e-6 to
//! 10 s, ω and κ up to 1e6, size ratios 1:1 to 1:1e4, coincident centres, hundreds of overlapping bodies, resonances).
//! For each integrator it counts the runs that stayed finite and within twice the energy bound. `exponential` must also
//! match an exact solution to within its tolerance where one exists (2,278 of the runs). The sweep takes three minutes
//! and exits with status 1 if `exponential` fails a case. `--case N` reruns a single case; `--write F.toml` saves it as
//! a scene file.
//!
//! | integrator | cases | passed | beyond bound | energy drift over a million undamped steps |
//! | --- | --- | --- | --- | --- |
//! | `thesis` | 4,000 | 2,663 | 1,337 | 13 % |
//! | `mps` | 4,000 | 2,646 | 1,354 | 21 % |
//! | `euler` | 4,000 | 2,700 | 1,300 | 2.4 % |
//! | `verlet` | 4,000 | 2,839 | 1,161 | 0.21 % |
//! | `rk4` | 4,000 | 2,815 | 1,185 | 13 % |
//! | `exponential` | 4,000 | 4,000 | 0 | 1.1e-6 |
//!
//! **Speed** (`bench scale`): 2 to 100,000 bodies of 266 vertices, in pairs as in `two`, which approach, merge, stay
//! merged and separate; bodies at rest stand between them as close as possible. The naive baseline is the thesis's
//! scheme: every vertex of every body that is not at rest, all pairs, one number at a time. Measured on a VM with two
//! cores of an Intel Xeon and memory shared with other guests (10,000 bodies in contact: 44 to 55 steps/s); best of 9
//! blocks of steps, or of 3 long ones:
//!
//! | scene | bodies | steps/s | on two cores | M vertex-steps/s | ns | memory per body | error | baseline, steps/s |
//! | --- | --- | --- | --- | --- | --- | --- | --- | --- |
//! | all in contact | 2 | 246,706 | 233,787 | 131 | 133 | 6.7 KiB | 9e-10 | 36,255 |
//! | | 100 | 4,034 | 4,714 | 107 | 163 | 6.5 KiB | 1e-9 | 94.2 |
//! | | 1,000 | 414 | 621 | 110 | 164 | 6.4 KiB | 9e-10 | 1.01 |
//! | | 10,000 | 32.5 | 50.2 | 86.5 | 212 | 7.4 KiB | 1e-9 | |
//! | | 100,000 | 2.33 | 4.15 | 61.8 | 296 | 7.4 KiB | 1e-9 | |
//! | 1 % in contact | 1,000 | 39,084 | 36,857 | 10,396 | 168 | 438 B | 1e-9 | 36.8 |
//! | | 10,000 | 3,829 | 4,217 | 10,186 | 172 | 474 B | 1e-9 | 0.211 |
//! | | 100,000 | 308 | 446 | 8,195 | 220 | 453 B | 9e-10 | |
//! | all at rest but one pair | 2 | 253,114 | 235,337 | 135 | 130 | 6.7 KiB | 9e-10 | 36,245 |
//! | | 1,000 | 214,082 | 201,778 | 56,946 | 154 | 373 B | 9e-10 | 61.3 |
//! | | 100,000 | 213,808 | 201,395 | 5,687,301 | 154 | 370 B | 9e-10 | |
//!
//! ns: step time per vertex inside a sphere. Error: the largest error of any vertex, in radii; it is 0.4 for the naive
//! baseline.
//!
//! **Free bodies**: `bench error collide orbit drop` compares every integrator with an independent solution that locates
//! every contact, rim and core. `bench error --random N` compares N random short scenes, with free bodies and paths,
//! planes, unequal sizes and masses, with it: a line for each that misses its tolerance, the counts, and whether the
//! motion itself amplifies. `bench stability` ends with free bodies at their limits (mass ratios up to 1e6, spins up to
//! 1e4 rad/s, deep overlap, corners of planes, stacks of 50, ωΔt up to 1e3) and reports where an integrator stopped, and
//! why; it compares the errors of `exponential` there too, where the reference does not take too long.
//! `bench scale` ends with the rate of free pairs in contact relative to prescribed ones, and with bodies at rest on a
//! plane.
//!
//! **Recording** (`bench record`): frames per second and bytes per frame by detail and destination, with and without
//! simulating, compared with the size of the payload and with the same data recorded as the SDK's plain `log()` does,
//! one entity at a time (through its batcher and its file sink: the crate with `log()` itself is not a dependency).
//! Most of a recorded frame of `two` is the merged surface of its bodies with its measures, which recordings did not
//! have when the goals were set (24,000 frames/s were saved then on two cores, 12,000 with all forces). Instructions per
//! frame with surfaces, over the 300 frames of `two`, start and end of the run included (Callgrind):
//!
//! | thread | thousand instructions per frame |
//! | --- | --- |
//! | simulation | 268: steps 31, observation 63, search for contacts 88, the layout and the start |
//! | recorder and the threads that help it | 3,120: surfaces and measures 2,620, the merged mesh 145, normals 40, other data of bodies 38 |
//! | writer | 940: LZ4 270, schemas, checks and copies of chunks 340, the footer 240 |
//!
//! Surfaces of several frames are computed at a time, on all cores. Two cores thus share 4.3 M instructions per frame,
//! where one thread had 3.8 M to itself before, so 50,000 frames/s are out of reach while every frame has its surface.
//! Without surfaces, LZ4 is the largest item (12 % of the processor time). A compressor that steps by words instead of
//! bytes was no faster, and files grew by up to a quarter.
//!
//! Saving two bodies at 60 frames/s makes a step 0.1 % slower. A checksum costs 2 to 3 % of a step of `two`; a
//! replay takes 1.0 to 1.2 times as long as the run.

mod drawing;
pub mod error;
pub mod extrapolation;
pub mod goals;
pub mod machine;
pub mod models;
pub mod output;
pub mod record;
pub mod reference;
pub mod scale;
pub mod stability;
pub mod surface;
mod tables;

use crate::{
    SceneError,
    scene::{Body, Path},
    sim::{self, TooLarge},
};
use reference::NoReference;

/// Why something cannot be measured.
#[derive(Debug, thiserror::Error)]
pub enum MeasureError {
    /// The built-in scene from which others are derived is missing.
    #[error("the built-in scene \"two\" is missing")]
    NoScene,
    /// A derived scene is not valid.
    #[error("a case is not a valid scene: {0}")]
    Scene(#[from] SceneError),
    /// No reference solution is available.
    #[error(transparent)]
    NoReference(#[from] NoReference),
    /// The scene needs more memory than is available.
    #[error(transparent)]
    TooLarge(#[from] TooLarge),
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
