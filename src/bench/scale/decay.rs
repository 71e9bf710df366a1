//! A scene that decays to nothing: numbers too small for the usual format of a float would be slow to compute with, so none
//! may come up on the way.
//!
//! Two bodies are torn apart and left alone. The time of steps is followed while their vertices swing, through all sizes
//! that a number can have, and long after they have come to rest.

use std::time::Instant;

use super::free_oscillation;
use crate::{
    Scene, World,
    bench::MeasureError,
    sim::{Options, world::States},
};

/// What was measured.
#[derive(Clone, Debug, PartialEq)]
pub struct Decay {
    /// Whether what need not be computed was skipped.
    pub skip: bool,
    /// How many steps were taken.
    pub steps: u64,
    /// Time of a step and of looking at all vertices [s], in the beginning …
    pub early: f64,
    /// … where it took longest …
    pub slowest: f64,
    /// … and in the end.
    pub late: f64,
}

/// Steps are timed together by so many; of so many such blocks the best counts: what else the machine does only adds to
/// them (medians were seen to differ by four between runs, never at the same step), numbers that are slow to compute with
/// would add to all of them: such sizes take thousands of steps to pass.
const STEPS: u64 = 200;
const BLOCKS: usize = 10;

/// Follows the decay both ways, skipping over `steps` steps, the naive baseline over a twentieth of that.
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
