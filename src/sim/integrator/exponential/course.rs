//! The forces on a body at any instant of an interval without jumps.

use std::borrow::Cow;

use glam::DVec3;

use crate::{
    model::{influence::Weight, oscillator::Oscillator},
    scene::{Material, Path, Scene, path::Bounds},
    sim::{
        numerics::arrays::Vectors,
        prescribed::tracks::Tracks,
        terms::{self, Sphere},
    },
};

/// A body's course over an interval of time in which nothing jumps: phases, pushes and paths are smooth inside it.
#[derive(Clone, Copy)]
pub struct Course<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Index of the body in the scene.
    pub index: usize,
    /// The constants of its oscillators.
    pub material: Material,
    /// Number of its vertices.
    pub vertices: usize,
    /// Start of the interval [s].
    pub start: f64,
    /// Length of the interval [s].
    pub length: f64,
    /// The tracks of all bodies.
    pub tracks: &'a Tracks,
    /// Whether the interval is a whole step, for which the tracks hold samples.
    pub is_whole: bool,
    /// Spheres that can reach the body.
    pub spheres: &'a [Sphere],
    /// Constant accelerations of single vertices; `None` if there are none.
    pub local: Option<Local<'a>>,
}

/// Constant accelerations of single vertices.
#[derive(Clone, Copy)]
pub struct Local<'a> {
    /// In the order of the active set, padded like it [scene unit/s²].
    pub accelerations: &'a Vectors,
    /// The largest of them [scene unit/s²].
    pub largest: f64,
}

impl Course<'_> {
    /// End of the interval [s].
    pub fn end(&self) -> f64 {
        self.start + self.length
    }

    /// ω and κ.
    pub fn oscillator(&self) -> Oscillator {
        self.material.oscillator()
    }

    /// The weight (3.3).
    pub fn weight(&self) -> Weight {
        self.scene.influence.weight
    }

    /// The path of a body over the interval.
    pub fn path(&self, body: usize) -> Cow<'_, Path> {
        self.tracks.path(body).between(self.start, self.end())
    }

    /// The path of a sphere's centre over the interval.
    pub fn sphere_path(&self, sphere: usize) -> Cow<'_, Path> {
        self.path(self.spheres[sphere].body as usize)
    }

    /// Writes the centres of the spheres relative to that of the body at time `t` [s] to `centres` [scene unit], and
    /// returns the acceleration that all vertices share [scene unit/s²]; at the end of the interval, the left limits.
    pub fn sample(&self, t: f64, centres: &mut Vec<DVec3>) -> DVec3 {
        let path = self.path(self.index);
        let own = if t >= self.end() { path.before(t) } else { path.at(t) };
        centres.clear();
        centres.extend((0..self.spheres.len()).map(|j| self.sphere_path(j).position(t) - own.position));
        terms::uniform(self.scene, &self.material, &own)
    }

    /// Bounds on the motion of a sphere's centre relative to the body's within `[start, end]` [s].
    pub fn relative_bounds(&self, sphere: usize, start: f64, end: f64) -> Bounds {
        let other = self.spheres[sphere].body as usize;
        let [own, its] = [self.tracks.bounds(self.index), self.tracks.bounds(other)];
        let still = Bounds { speed: 0.0, acceleration: 0.0 };
        match (own, its) {
            // at least one of the two does not move
            (None, moves) | (moves, None) if self.is_whole => moves.unwrap_or(still),
            _ => self.path(other).relative_bounds(&self.path(self.index), start, end),
        }
    }

    /// The constant acceleration of vertex number `i` of the active set [scene unit/s²].
    pub fn local(&self, i: usize) -> DVec3 {
        self.local.map_or(DVec3::ZERO, |local| local.accelerations.get(i))
    }

    /// A bound on the acceleration of any vertex by the spheres and by its constant acceleration [scene unit/s²].
    pub fn strongest_pull(&self) -> f64 {
        let max_pull = self.weight().max_pull();
        let spheres: f64 = self.spheres.iter().map(|sphere| sphere.strength.abs() * sphere.radius * max_pull).sum();
        spheres + self.local.map_or(0.0, |local| local.largest)
    }
}
