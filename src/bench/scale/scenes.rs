//! Scenes of 2 to 100,000 bodies, derived from the built-in scene `two`.
//!
//! Pairs in contact repeat one motion at different initial phases, so that together they do the same work in every step.
//! Pairs on paths approach, merge, stay merged for a while and separate. Free pairs have no damping and oscillate within
//! each other's spheres. Bodies at rest stand as close as possible without touching, or on a plane.

use std::f64::consts::TAU;

use glam::DVec3;

use crate::{
    geometry::{Shape, files::from_content},
    model::shape_matching::{Plane, Rotation},
    scene::{Body, FreeMotion, Material, Motion, Path, Response, Scene},
};

/// Steps per period of a pair on paths.
pub const PERIOD: u64 = 240;
/// Number of different initial phases of pairs.
pub const PHASES: usize = 8;
/// Mean distance of the bodies of a pair on paths, and its amplitude [radii]: q from 0.98 to 1.22, merging at 1.05,
/// splitting at 1.2.
const DISTANCE: f64 = 2.2;
const SWING: f64 = 0.24;
/// Distances between bodies at rest, and between the cells of pairs on paths and of free pairs [radii].
const PITCH: f64 = 2.6;
const CELL: DVec3 = DVec3::new(2.0 * PITCH, PITCH, PITCH);
const FREE_CELL: DVec3 = DVec3::new(8.0, 5.0, 5.0);
/// The shape of the bodies on a plane: a cube, which stands on four of its vertices.
const CUBE: &str = "
v -1 -1 -1\nv 1 -1 -1\nv 1 1 -1\nv -1 1 -1\nv -1 -1 1\nv 1 -1 1\nv 1 1 1\nv -1 1 1
f 1 4 3 2\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8";

named! {
    /// Which bodies move, and how.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
    pub enum Family {
        /// All of them on paths, in pairs.
        Contact = "all in contact",
        /// One pair in a hundred on paths, and at least one; the others stand still.
        Hundredth = "1 % in contact",
        /// One pair on paths; the others stand still.
        Rest = "all at rest but one pair",
        /// All of them free, in pairs.
        FreeContact = "free, all in contact",
        /// A free body that a body on a path carries along; the others are free and rest on a plane.
        FreeRest = "free, all at rest but one",
    }
}

/// The placement of the bodies of a scene.
#[derive(Clone, Debug)]
pub struct Layout {
    /// Which bodies move.
    pub family: Family,
    /// Number of bodies.
    pub bodies: usize,
    /// The pairs in contact.
    pub pairs: Vec<Pair>,
}

/// Two bodies in contact. The second, at the next index, moves along or around the first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair {
    /// Index of the first body in the scene.
    pub first: usize,
    /// The place of its cell, where its motion begins [scene unit].
    pub corner: DVec3,
    /// Index of its initial phase.
    pub phase: usize,
}

impl Layout {
    /// A layout of this many bodies, at least two.
    pub fn new(family: Family, bodies: usize) -> Layout {
        let cells = bodies / 2;
        let pairs = match family {
            Family::Contact | Family::FreeContact => cells,
            Family::Hundredth => (cells / 100).max(1),
            Family::Rest => 1,
            Family::FreeRest => 0,
        };
        let mut layout = Layout { family, bodies, pairs: vec![] };
        for k in 0..pairs {
            let cell = k * cells / pairs;
            layout.pairs.push(Pair { first: 2 * cell, corner: layout.corner(cell), phase: k % PHASES });
        }
        layout
    }

    fn corner(&self, cell: usize) -> DVec3 {
        let side = (1..).find(|side| side * side * side >= self.bodies.div_ceil(2)).unwrap_or(1);
        let [x, y, z] = [cell % side, cell / side % side, cell / side / side].map(|i| i as f64);
        DVec3::new(x, y, z) * if self.family == Family::FreeContact { FREE_CELL } else { CELL }
    }

    /// The scene, derived from `two`.
    pub fn scene(&self, two: &Scene) -> Scene {
        let still = |index: usize| self.corner(index / 2) + DVec3::X * PITCH * (index % 2) as f64;
        let mut scene = with_bodies(two, (0..self.bodies).map(|index| Path::Fixed(still(index)).into()).collect());
        match self.family {
            Family::FreeContact => make_free(&mut scene),
            Family::FreeRest => put_on_plane(&mut scene),
            _ => {}
        }
        for pair in &self.pairs {
            for (body, motion) in scene.bodies[pair.first..].iter_mut().zip(self.motions(two, pair)) {
                body.motion = motion;
            }
        }
        scene.name = format!("{} {}", self.bodies, self.family.name());
        scene
    }

    /// One pair alone at the origin: it moves like all pairs with this initial phase.
    pub fn pair(&self, two: &Scene, phase: usize) -> Scene {
        let motions = self.motions(two, &Pair { first: 0, corner: DVec3::ZERO, phase });
        let mut scene = with_bodies(two, motions.to_vec());
        if self.family == Family::FreeContact {
            make_free(&mut scene);
        }
        scene
    }

    fn motions(&self, two: &Scene, pair: &Pair) -> [Motion; 2] {
        if self.family == Family::FreeContact {
            let apart = 1.5 + 0.05 * pair.phase as f64;
            let velocity = 0.2 * DVec3::Y;
            return [(0.0, DVec3::ZERO), (apart, velocity)]
                .map(|(x, velocity)| thrown(pair.corner + x * DVec3::X, velocity, Rotation::Free));
        }
        let swing = Path::Sine {
            center: pair.corner + DVec3::X * DISTANCE,
            amplitude: DVec3::X * SWING,
            frequency: 1.0 / (PERIOD as f64 * two.dt),
            phase: TAU * pair.phase as f64 / PHASES as f64,
        };
        [Path::Fixed(pair.corner).into(), swing.into()]
    }
}

/// A scene with bodies like the first of `two`.
fn with_bodies(two: &Scene, motions: Vec<Motion>) -> Scene {
    let body = |(index, motion)| Body { name: format!("b{index}"), motion, ..two.bodies[0].clone() };
    let bodies = motions.into_iter().enumerate().map(body).collect();
    Scene { bodies, pushes: vec![], source: String::new(), ..two.clone() }
}

fn thrown(from: DVec3, velocity: DVec3, rotation: Rotation) -> Motion {
    Motion::Free(FreeMotion { from, velocity, spin: DVec3::ZERO, rotation })
}

/// Gives all bodies a material without damping, so that free pairs oscillate forever.
fn make_free(scene: &mut Scene) {
    for body in &mut scene.bodies {
        body.material = Material { damping: 0.0, response: Response::Inertial, ..body.material };
    }
    (scene.thresholds.core_at, scene.core_width) = (0.7, 0.4);
}

/// Puts cubes on a plane, out of each other's reach and in balance; the last two bodies are one on a path, and the free
/// body that it carries along. Steps are long, so that the half second before bodies come to rest takes few steps.
fn put_on_plane(scene: &mut Scene) {
    const OMEGA: f64 = 40.0;
    const STIFFNESS: f64 = 4000.0;
    let resting = scene.bodies.len() - 2;
    let side = (resting as f64).sqrt().ceil().max(1.0) as usize;
    let cube = from_content("cube.obj", CUBE).map_or(Shape::default(), |loaded| Shape::Mesh(loaded.mesh));
    (scene.dt, scene.tolerance, scene.gravity) = (1.0 / 24.0, 1e-2, -DVec3::Z);
    scene.planes.push(Plane { normal: DVec3::Z, offset: 0.0, stiffness: STIFFNESS, friction: 0.0, slip: 0.05 });
    (scene.thresholds.core_at, scene.core_width) = (0.7, 0.4);
    // half of the vertices carry the weight of all: the plane yields twice as far as for each, and they are bent up
    let height = 1.0 / 3f64.sqrt() - 1.0 / (OMEGA * OMEGA) - 2.0 / STIFFNESS;
    for (index, body) in scene.bodies.iter_mut().enumerate() {
        body.material = Material { omega: OMEGA, damping: OMEGA, response: Response::Inertial };
        if index < resting {
            let position = DVec3::new((index % side) as f64, (index / side) as f64, 0.0) * 3.0 * body.radius;
            body.motion = thrown(position + height * DVec3::Z, DVec3::ZERO, Rotation::Fixed);
            body.shape = cube.clone();
        }
    }
    let center = -30.0 * DVec3::X + 9.0 * DVec3::Z;
    let path = Path::Sine { center, amplitude: 0.3 * DVec3::X, frequency: 1.0, phase: 0.0 };
    if let [.., leader, follower] = &mut scene.bodies[..] {
        (leader.motion, follower.motion) = (path.into(), thrown(center - 1.5 * DVec3::Z, DVec3::ZERO, Rotation::Free));
    }
}
