//! A scene that decays to zero. Arithmetic on subnormal floats is slow, so none may occur on the way.
//!
//! Two bodies are torn apart and left alone. Step times are followed while their vertices oscillate with amplitudes of
//! every magnitude that a float can have, and long after they have come to rest.

use std::time::Instant;

use super::free_oscillation;
use crate::{
    Scene, World,
    bench::MeasureError,
    sim::{Options, States},
};

/// The measured step times.
#[derive(Clone, Debug, PartialEq)]
pub struct Decay {
    /// Whether inactive parts were skipped.
    pub skip: bool,
    /// Number of steps taken.
    pub steps: u64,
    /// Time of a step and of reading all vertices [s], at the start …
    pub early: f64,
    /// … at its slowest …
    pub slowest: f64,
    /// … and at the end.
    pub late: f64,
}

/// Number of steps timed together. The best of several such blocks counts, because other load only adds to them
/// (medians differed by a factor of four between runs, never at the same step). Subnormal floats would slow down all of
/// these blocks, because amplitudes of such sizes take thousands of steps to pass.
const STEPS: u64 = 200;
const BLOCKS: usize = 10;

/// Follows the decay both ways: with skipping over `steps` steps, and the naive baseline over a twentieth of that.
pub(super) fn measure(two: &Scene, steps: u64) -> Result<Vec<Decay>, MeasureError> {
    [(true, steps), (false, steps / 20)].into_iter().map(|(skip, steps)| follow(two, skip, steps)).collect()
}

fn follow(two: &Scene, skip: bool, steps: u64) -> Result<Decay, MeasureError> {
    let scene = free_oscillation::scene(free_oscillation::Cause::Sphere, two, 1);
    let mut world = World::with_options(scene, Options { skip, ..Options::default() })?;
    while world.time() < free_oscillation::LEFT_ALONE && world.step().failure.is_none() {}
    let mut states = States::default();
    let mut block = || {
        let start = Instant::now();
        for _ in 0..STEPS {
            world.step();
            for body in world.bodies() {
                body.states_into(&mut states);
                std::hint::black_box(&states);
            }
        }
        start.elapsed().as_secs_f64() / STEPS as f64
    };
    let times: Vec<f64> = (0..steps / STEPS).map(|_| block()).collect();
    let best: Vec<f64> =
        times.chunks_exact(BLOCKS).map(|times| times.iter().copied().fold(f64::INFINITY, f64::min)).collect();
    let of = |time: Option<&f64>| time.copied().unwrap_or(f64::NAN);
    Ok(Decay {
        skip,
        steps,
        early: of(best.first()),
        slowest: best.iter().copied().fold(0.0, f64::max),
        late: of(best.last()),
    })
}
