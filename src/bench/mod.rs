//! Benchmarks: each one measures, and says beside every speed which error, which machine.
//!
//! | what | where |
//! | --- | --- |
//! | error against run time, for every integrator and a range of steps | [`mod@error`] |
//! | cost against the number of bodies, and the goals for it | [`scale`] |
//! | the independent solution that errors are measured against | [`reference`], by [`extrapolation`] |
//! | what the diagrams have in common, and the tables | `drawing`, `tables` |
//! | goals beside measurements | [`goals`] |
//! | the machine that a run time belongs to | [`machine`] |
//! | a stress sweep of every integrator, and bodies of very different sizes | [`stability`] |
//! | what recording costs, by detail and destination; what verifying costs; the goals for both | [`record`] |
//! | files that are written when everything has been measured | [`output`] |
//!
//! # Measured
//! **Error against run time** (`bench error`): every integrator over a range of steps, against an independent solution by
//! extrapolation that shares no code with them. Largest error over time and vertices at the scene's own Δt, in radii, against
//! a solution good to 1e-13 (`bench error tests/reference/*.toml`):
//!
//! | scene (`tests/reference/`) | thesis | mps | euler | verlet | rk4 | exponential |
//! | --- | --- | --- | --- | --- | --- | --- |
//! | push | 4.1e-1 | 9.5e-2 | 2.9e-2 | 1.7e-2 | 4.5e-3 | < 1e-13 |
//! | two | 2.2e-1 | 9.0e-2 | 1.3e-2 | 3.7e-3 | 5.1e-3 | 6e-10 |
//! | three | 2.0e-1 | 9.5e-2 | 1.4e-2 | 2.2e-2 | 2.2e-2 | 6e-10 |
//! | size_ratio | 4.3e-1 | 3.8e-1 | 1.1e-2 | 6.8e-3 | 7.1e-3 | 1.5e-12 |
//!
//! **Stability** (`bench stability`): thousands of small scenes at the limits of every setting (steps of 1e-6 to 10 s, ω and κ
//! up to 1e6, sizes 1:1 to 1:1e4, coincident centres, hundreds of bodies in one place, resonances). It counts by integrator how
//! many stayed finite and within twice what energy allows; `exponential` must besides be as close to an exact solution as its
//! tolerance promises, where there is one (2,278 of the runs). It takes three minutes; its status is 1 if `exponential` fails a
//! case. `--case N` runs one again, `--write F.toml` makes a scene file of it.
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
//! **Speed** (`bench scale`): 2 to 100,000 bodies of 266 vertices, in pairs as in `two`, which approach, merge, hold and part;
//! resting bodies stand between them as close as they can. The naive baseline is the thesis's scheme: every vertex of every body
//! that is not at rest, all pairs, one number at a time. On a VM with two cores of an Intel Xeon, whose memory others share (10,000
//! bodies in contact: 44 to 55 steps/s); best of 9 blocks of steps, or of 3 that take long:
//!
//! | scene | bodies | steps/s | on two cores | M vertex-steps/s | ns | memory per body | error | naive baseline, steps/s |
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
//! ns: step time per vertex inside a sphere. Error: the largest of any vertex, in radii; that of the naive baseline is 0.4.
//!
//! **Recording** (`bench record`): frames per second and bytes per frame by detail and destination, with and without the
//! simulation, beside the payload's own bytes and a plain `log()` of the same data, one entity at a time. On two cores, every step of
//! `two` saved with its surfaces: 24,000 frames a second, 2.6 kB each of 10.7 kB of payload (plain `log()` without simulating:
//! 11,000); with all forces 12,000 (5,100), 7.4 kB of 14.3. While two bodies are saved at 60 frames a second, a step takes 0.1 %
//! longer. A checksum takes 2 to 3 % of a step of `two`, a replay 1.0 to 1.2 times as long as the run.

mod drawing;
pub mod error;
pub mod extrapolation;
pub mod goals;
pub mod machine;
pub mod output;
pub mod record;
pub mod reference;
pub mod scale;
pub mod stability;
mod tables;

use crate::{
    SceneError,
    sim::{self, TooLarge},
};
use reference::NoReference;

/// Why something cannot be measured.
#[derive(Debug, thiserror::Error)]
pub enum MeasureError {
    /// There is no scene to make others from.
    #[error("the built-in scene \"two\" is missing")]
    NoScene,
    /// A scene that was made from others is none.
    #[error("a case is no scene: {0}")]
    Scene(#[from] SceneError),
    /// There is no reference.
    #[error(transparent)]
    NoReference(#[from] NoReference),
    /// There is no memory.
    #[error(transparent)]
    TooLarge(#[from] TooLarge),
    /// The scene's own run does not come to its end.
    #[error(transparent)]
    Failed(#[from] sim::Failure),
    /// There are no threads to measure on.
    #[error("cannot start threads: {0}")]
    Threads(#[from] rayon::ThreadPoolBuildError),
}
