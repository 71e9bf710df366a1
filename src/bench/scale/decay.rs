//! A scene that decays to zero. Arithmetic on subnormal floats is slow, so none may occur during the decay.
//!
//! Two bodies are torn apart and left alone. Steps are timed while their vertices oscillate with amplitudes of every
//! magnitude that a float can have, and long after they have come to rest.

use std::time::Instant;

use super::free_oscillation;
use crate::{Scene, World, bench::MeasureError, sim::States};

/// The measured step times.
#[derive(Clone, Debug, PartialEq)]
pub struct Decay {
    /// Number of steps taken.
    pub steps: u64,
    /// Time of a step and of reading all vertices at the start [s].
    pub early: f64,
    /// The longest such time [s].
    pub slowest: f64,
    /// The time at the end [s].
    pub late: f64,
}

/// Number of steps timed together. Each time is the best of several such blocks, because other load only adds to them
/// (medians differed by a factor of four between runs, never at the same step). Subnormal floats would slow down all
/// blocks of a group, because the amplitudes stay subnormal for thousands of steps.
const STEPS: u64 = 200;
const BLOCKS: usize = 10;

/// Measures the decay over `steps` steps.
pub(super) fn measure(two: &Scene, steps: u64) -> Result<Decay, MeasureError> {
    let scene = free_oscillation::scene(free_oscillation::Cause::Sphere, two, 1);
    let mut world = World::new(scene)?;
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
        steps,
        early: of(best.first()),
        slowest: best.iter().copied().fold(0.0, f64::max),
        late: of(best.last()),
    })
}
