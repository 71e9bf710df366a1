//! Bodies whose vertices all oscillate freely, with every frame requested.
//!
//! No force acts, so steps cost almost nothing. The timings cover a step and reading the states of all vertices, as a
//! recording would. Each vertex that a sphere has touched has a state of 48 bytes, which must be read from memory;
//! vertices moved only by a push are computed from one number per body.

use std::time::{Duration, Instant};

use glam::DVec3;
use rayon::prelude::*;

use super::{BLOCKS, Pools, scenes};
use crate::{
    Scene, World,
    bench::MeasureError,
    scene::{Path, Push, path::Spline},
    sim::States,
};

/// Why the vertices oscillate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// An influence sphere surrounded each body.
    Sphere,
    /// The bodies were pushed.
    Push,
}

impl Cause {
    /// The name used in tables.
    pub fn name(self) -> &'static str {
        match self {
            Cause::Sphere => "each vertex by itself",
            Cause::Push => "all equally, pushed",
        }
    }
}

/// The measured frame rates.
#[derive(Clone, Debug, PartialEq)]
pub struct FreeOscillation {
    /// Why the vertices oscillate.
    pub cause: Cause,
    /// Number of vertices.
    pub vertices: u64,
    /// Memory allocated by the world, per vertex [bytes].
    pub memory: f64,
    /// Number of vertices times frame rate, on one core [1/s].
    pub one: f64,
    /// Number of vertices times frame rate, on all cores [1/s]; `None` on a single-core machine.
    pub all: Option<f64>,
}

/// Maximum number of bodies; their states exceed every cache.
const BODIES: usize = 4000;
/// No force acts after this time [s].
pub(super) const LEFT_ALONE: f64 = 1.0;

/// Measures both causes.
pub(super) fn measure(
    two: &Scene,
    pools: &Pools,
    time: Duration,
    max_bodies: usize,
) -> Result<Vec<FreeOscillation>, MeasureError> {
    [Cause::Sphere, Cause::Push].into_iter().map(|cause| measure_one(cause, two, pools, time, max_bodies)).collect()
}

fn measure_one(
    cause: Cause,
    two: &Scene,
    pools: &Pools,
    time: Duration,
    max_bodies: usize,
) -> Result<FreeOscillation, MeasureError> {
    let scene = scene(cause, two, BODIES.min(max_bodies) / 2);
    let vertices = scene.vertex_count();
    let mut world = pools.best().install(|| World::new(scene))?;
    pools.best().install(|| while world.time() < LEFT_ALONE && world.step().failure.is_none() {});
    let share = time.as_secs_f64() / BLOCKS as f64;
    let mut times = [vec![], vec![]];
    for _ in 0..BLOCKS {
        for (pool, times) in pools.each().zip(&mut times) {
            pool.install(|| times.push(block(&mut world, share)));
        }
    }
    let mut rates = times.into_iter().map(|times| Some(vertices as f64 / times.into_iter().min_by(f64::total_cmp)?));
    let one = rates.next().flatten().unwrap_or(f64::NAN);
    let memory = world.memory() as f64 / vertices as f64;
    Ok(FreeOscillation { cause, vertices, memory, one, all: rates.next().flatten() })
}

/// Takes steps and reads their states for `share` [s]; returns the time per step [s].
fn block(world: &mut World, share: f64) -> f64 {
    let start = Instant::now();
    for frames in 1.. {
        world.step();
        let world = &*world;
        let largest = |states: &mut States, index: usize| {
            world.body(index).states_into(states);
            states.displacement.x[0]
        };
        let sum: f64 = (0..world.body_count()).into_par_iter().map_init(States::default, largest).sum();
        std::hint::black_box(sum);
        let elapsed = start.elapsed().as_secs_f64();
        if elapsed >= share {
            return elapsed / f64::from(frames);
        }
    }
    f64::NAN
}

/// Pairs of bodies like those of `two`, which are pushed, or start inside each other and are torn apart.
pub fn scene(cause: Cause, two: &Scene, pairs: usize) -> Scene {
    let side = (1..).find(|side| side * side * side >= pairs).unwrap_or(1);
    let corner = |pair: usize| {
        let [x, y, z] = [pair % side, pair / side % side, pair / side / side].map(|i| i as f64);
        DVec3::new(8.0 * x, 4.0 * y, 4.0 * z)
    };
    let paths = |pair: usize| {
        let (a, away) = (corner(pair), corner(pair) + 4.0 * DVec3::X);
        let other = match cause {
            Cause::Sphere => Path::Keyframes(Spline::new(&[(0.0, a + 0.3 * DVec3::X), (0.5, away)])),
            Cause::Push => Path::Fixed(away),
        };
        [Path::Fixed(a), other]
    };
    let mut scene = scenes::scene(two, (0..pairs).flat_map(paths).collect());
    if cause == Cause::Push {
        let push = |body| Push { body, direction: DVec3::X, strength: 60.0, start: 0.1, duration: 0.1 };
        scene.pushes = (0..scene.bodies.len()).map(push).collect();
    }
    scene
}
