//! Free bodies: pairs in contact compared with pairs on prescribed paths, and a moving body beside bodies at rest on a
//! plane compared with the moving body alone.

use std::time::{Duration, Instant};

use glam::DVec3;

use super::{Clock, Pools, scenes::Layout};
use crate::{
    Scene, World,
    bench::scale::scenes::Family,
    geometry::{Shape, files::from_content},
    model::shape_matching::{Plane, Rotation},
    scene::{FreeMotion, Material, Path, Response},
    sim::TooLarge,
};

/// Scenes whose step is expected to take longer are skipped.
const LONGEST_STEP: f64 = 0.5;
/// Time limit for bodies to come to rest.
const LONGEST_SETTLING: Duration = Duration::from_secs(120);
/// Step limit for bodies to come to rest.
const MAX_SETTLING_STEPS: usize = 1000;
/// The shape of the bodies on the plane: a cube, which stands on four of its vertices.
const CUBE: &str = "
v -1 -1 -1\nv 1 -1 -1\nv 1 1 -1\nv -1 1 -1\nv -1 -1 1\nv 1 -1 1\nv 1 1 1\nv -1 1 1
f 1 4 3 2\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8";

/// Pairs in contact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// Number of bodies.
    pub bodies: usize,
    /// Step time of free bodies on one core [s].
    pub free: f64,
    /// Step time of the same number of bodies on prescribed paths, on one core [s].
    pub prescribed: f64,
}

impl Contact {
    /// Step rate of free pairs relative to prescribed ones [–].
    pub fn rate(&self) -> f64 {
        self.prescribed / self.free
    }
}

/// Bodies at rest on a plane, and one that moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Resting {
    /// Number of bodies that should be at rest.
    pub bodies: usize,
    /// Number of bodies that are at rest.
    pub asleep: usize,
    /// Step time on one core [s].
    pub seconds: f64,
    /// Step time of the moving body alone, on one core [s].
    pub alone: f64,
}

/// The measurements.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Free {
    /// By number of bodies, ascending.
    pub contact: Vec<Contact>,
    /// By number of bodies, ascending.
    pub resting: Vec<Resting>,
}

/// Measures pairs with the given numbers of bodies, and as many bodies at rest. `prescribed` returns the step time on
/// one core of the same number of bodies on paths [s].
///
/// # Errors
/// [`TooLarge`]
pub(super) fn measure(
    two: &Scene,
    pools: &Pools,
    bodies: &[usize],
    time: Duration,
    prescribed: impl Fn(usize) -> Option<f64>,
) -> Result<Free, TooLarge> {
    let mut free = Free::default();
    let mut per_body = 0.0;
    for &count in bodies {
        let Some(prescribed) = prescribed(count).filter(|_| per_body * count as f64 <= LONGEST_STEP) else { continue };
        let mut world = pools.one.install(|| World::new(in_contact(two, count)))?;
        let seconds = pools.one.install(|| timed(&mut world, time));
        per_body = seconds / count as f64;
        free.contact.push(Contact { bodies: count, free: seconds, prescribed });
    }
    // the height at which a body comes to rest: the others start there, so they settle quickly
    let mut first = World::new(resting(two, 1, 0.57))?;
    (0..MAX_SETTLING_STEPS).any(|_| {
        first.step();
        first.report().sleeping_bodies > 0
    });
    let height = first.body(0).centre().z;
    let mut alone = World::new(resting(two, 0, height))?;
    let alone = pools.one.install(|| {
        (0..60).for_each(|_| _ = alone.step());
        timed(&mut alone, time)
    });
    for &count in bodies {
        let mut world = pools.best().install(|| World::new(resting(two, count, height)))?;
        let start = Instant::now();
        let settle = || {
            let step = |_| {
                world.step();
                world.report().sleeping_bodies as usize >= count || start.elapsed() > LONGEST_SETTLING
            };
            (0..MAX_SETTLING_STEPS).any(step)
        };
        pools.best().install(settle);
        let asleep = world.report().sleeping_bodies as usize;
        let seconds = pools.one.install(|| timed(&mut world, time));
        free.resting.push(Resting { bodies: count, asleep, seconds, alone });
        if asleep < count {
            break;
        }
    }
    Ok(free)
}

/// Time of a step in the best block [s].
fn timed(world: &mut World, time: Duration) -> f64 {
    let mut clock = Clock::new(1);
    clock.take(world, 1);
    let steps = (time.as_secs_f64() / 9.0 / clock.seconds()).clamp(1.0, 1000.0) as u64;
    let mut clock = Clock::new(1);
    while clock.blocks.len() < 3 || (clock.seconds() < time.as_secs_f64() && clock.blocks.len() < 9) {
        clock.take(world, steps);
    }
    clock.run().seconds
}

fn thrown(from: DVec3, velocity: DVec3, rotation: Rotation) -> crate::scene::Motion {
    crate::scene::Motion::Free(FreeMotion { from, velocity, spin: DVec3::ZERO, rotation })
}

/// Pairs that oscillate within each other's spheres forever: the material of `two` without damping.
fn in_contact(two: &Scene, bodies: usize) -> Scene {
    let layout = Layout::new(Family::Contact, bodies);
    let cells = bodies.div_ceil(2);
    let side = (1..).find(|side| side * side * side >= cells).unwrap_or(1);
    let mut scene = super::scenes::scene(two, (0..bodies).map(|_| Path::Fixed(DVec3::ZERO)).collect());
    for body in &mut scene.bodies {
        body.material = Material { damping: 0.0, response: Response::Inertial, ..body.material };
    }
    (scene.thresholds.core_at, scene.core_width) = (0.7, 0.4);
    for (cell, pair) in layout.pairs.iter().enumerate() {
        let [x, y, z] = [cell % side, cell / side % side, cell / side / side].map(|i| i as f64);
        let corner = DVec3::new(8.0 * x, 5.0 * y, 5.0 * z);
        let apart = 1.5 + 0.05 * pair.phase as f64;
        scene.bodies[pair.still].motion = thrown(corner, DVec3::ZERO, Rotation::Free);
        scene.bodies[pair.moving].motion = thrown(corner + apart * DVec3::X, 0.2 * DVec3::Y, Rotation::Free);
    }
    if bodies % 2 == 1 {
        scene.bodies[bodies - 1].motion = thrown(-20.0 * DVec3::X, DVec3::ZERO, Rotation::Free);
    }
    scene.name = format!("{bodies} free, in contact");
    scene
}

/// Cubes on a plane, with their centres at `height` and out of each other's reach, and a free body that is moved by
/// another body on a path. Steps are long, so that the half second before bodies come to rest takes few steps.
fn resting(two: &Scene, bodies: usize, height: f64) -> Scene {
    let mut scene = super::scenes::scene(two, (0..bodies + 2).map(|_| Path::Fixed(DVec3::ZERO)).collect());
    let side = (bodies as f64).sqrt().ceil().max(1.0) as usize;
    let cube = from_content("cube.obj", CUBE).map_or(Shape::default(), |loaded| Shape::Mesh(loaded.mesh));
    (scene.dt, scene.tolerance, scene.gravity) = (1.0 / 24.0, 1e-2, -DVec3::Z);
    scene.planes.push(Plane { normal: DVec3::Z, offset: 0.0, stiffness: 4000.0, friction: 0.0, slip: 0.05 });
    (scene.thresholds.core_at, scene.core_width) = (0.7, 0.4);
    for (index, body) in scene.bodies.iter_mut().enumerate() {
        body.material = Material { omega: 40.0, damping: 40.0, response: Response::Inertial };
        if index < bodies {
            let position = DVec3::new((index % side) as f64, (index / side) as f64, 0.0) * 3.0 * body.radius;
            body.motion = thrown(position + height * DVec3::Z, DVec3::ZERO, Rotation::Fixed);
            body.shape = cube.clone();
        }
    }
    // far from the cubes: a body on a path, and the free body that it moves
    let center = -30.0 * DVec3::X + 9.0 * DVec3::Z;
    let [.., leader, follower] = &mut scene.bodies[..] else { return scene };
    let path = Path::Sine { center, amplitude: 0.3 * DVec3::X, frequency: 1.0, phase: 0.0 };
    (leader.motion, follower.motion) = (path.into(), thrown(center - 1.5 * DVec3::Z, DVec3::ZERO, Rotation::Free));
    scene.name = format!("{bodies} at rest on a plane");
    scene
}
