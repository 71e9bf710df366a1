//! The benchmark scenes: a grid of cells, each with two bodies that are in contact or two at rest.
//!
//! The bodies of a pair are those of the built-in `two`, with the same material and the same law. One stands still; the
//! other oscillates towards it and away. In each period they approach, merge, stay merged, separate and split, and are
//! out of each other's reach only for a moment. The pairs of a scene run at different phases, so that together they do
//! the same work in every step. Bodies at rest stand as close as possible without touching, as in the built-in `crowd`.

use std::f64::consts::TAU;

use glam::DVec3;

use crate::scene::{Body, Path, Scene};

/// Steps per period of a pair's motion.
pub const PERIOD: u64 = 240;
/// Number of different initial phases of pairs.
pub const PHASES: usize = 8;
/// Mean distance of the bodies of a pair, and its amplitude [radii]: q from 0.98 to 1.22, merging at 1.05, splitting at
/// 1.2.
const DISTANCE: f64 = 2.2;
const SWING: f64 = 0.24;
/// Distances between cells, across and along the line of a pair [radii].
const PITCH: f64 = 2.6;
const LONG_PITCH: f64 = 2.0 * PITCH;

/// Which bodies are in contact.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Family {
    /// All of them, in pairs.
    Contact,
    /// One pair in a hundred, and at least one.
    Hundredth,
    /// One pair.
    Rest,
}

impl Family {
    /// All families, most expensive first.
    pub const ALL: [Family; 3] = [Family::Contact, Family::Hundredth, Family::Rest];

    /// The name used in tables.
    pub fn name(self) -> &'static str {
        match self {
            Family::Contact => "all in contact",
            Family::Hundredth => "1 % in contact",
            Family::Rest => "all at rest but one pair",
        }
    }
}

/// The placement of the bodies of a scene.
#[derive(Clone, Debug)]
pub struct Layout {
    /// Which bodies are in contact.
    pub family: Family,
    /// Number of bodies.
    pub bodies: usize,
    /// The pairs in contact.
    pub pairs: Vec<Pair>,
}

/// Two bodies in contact, by their indices in the scene.
#[derive(Clone, Copy, Debug)]
pub struct Pair {
    /// The body that stands still.
    pub still: usize,
    /// The body that moves.
    pub moving: usize,
    /// Index of its initial phase.
    pub phase: usize,
}

impl Layout {
    /// A layout of this many bodies, at least two.
    pub fn new(family: Family, bodies: usize) -> Layout {
        let cells = bodies / 2;
        let pairs = match family {
            Family::Contact => cells,
            Family::Hundredth => (cells / 100).max(1),
            Family::Rest => 1,
        };
        let pair = |k: usize| {
            let cell = k * cells / pairs;
            Pair { still: 2 * cell, moving: 2 * cell + 1, phase: k % PHASES }
        };
        Layout { family, bodies, pairs: (0..pairs).map(pair).collect() }
    }

    /// The scene, derived from `two`.
    pub fn scene(&self, two: &Scene) -> Scene {
        let cells = self.bodies.div_ceil(2);
        let side = (1..).find(|side| side * side * side >= cells).unwrap_or(1);
        let corner = |cell: usize| {
            let [x, y, z] = [cell % side, cell / side % side, cell / side / side].map(|i| i as f64);
            DVec3::new(LONG_PITCH * x, PITCH * y, PITCH * z)
        };
        let fixed = |index: usize| Path::Fixed(corner(index / 2) + DVec3::X * PITCH * (index % 2) as f64);
        let mut scene = scene(two, (0..self.bodies).map(fixed).collect());
        scene.name = format!("{} {}", self.bodies, self.family.name());
        for pair in &self.pairs {
            scene.bodies[pair.moving].motion = swing(corner(pair.still / 2), pair.phase, scene.dt).into();
        }
        scene
    }
}

/// Pairs with the first `count` initial phases, too far apart to interact, for a common reference solution.
pub fn every_phase(two: &Scene, count: usize) -> Scene {
    let corner = |pair: usize| DVec3::Y * (100.0 * pair as f64);
    let paths = (0..count).flat_map(|phase| [Path::Fixed(corner(phase)), swing(corner(phase), phase, two.dt)]);
    scene(two, paths.collect())
}

/// The path of the moving body; the other stands at `corner`.
fn swing(corner: DVec3, phase: usize, dt: f64) -> Path {
    Path::Sine {
        center: corner + DVec3::X * DISTANCE,
        amplitude: DVec3::X * SWING,
        frequency: 1.0 / (PERIOD as f64 * dt),
        phase: TAU * phase as f64 / PHASES as f64,
    }
}

/// A scene with bodies like those of `two` on these paths.
pub(super) fn scene(two: &Scene, paths: Vec<Path>) -> Scene {
    let body =
        |(index, path): (usize, Path)| Body { name: format!("b{index}"), motion: path.into(), ..two.bodies[0].clone() };
    let bodies = paths.into_iter().enumerate().map(body).collect();
    Scene { bodies, pushes: vec![], source: String::new(), ..two.clone() }
}
