//! What acts on a body over an interval of time in which nothing jumps, at any instant of it.

use glam::DVec3;

use crate::{
    geometry::Mesh,
    model::{influence::Weight, oscillator::Oscillator},
    scene::{self, Scene, path::Bounds},
    sim::{
        terms::{self, Sphere, Weighted},
        track::Track,
        tracks::Tracks,
    },
};

/// A body's course over an interval of time in which nothing jumps: phases, pushes and paths are smooth inside it.
#[derive(Clone, Copy)]
pub struct Course<'a> {
    /// The scene …
    pub scene: &'a Scene,
    /// … and the body's index in it.
    pub index: usize,
    /// Its rest shape.
    pub mesh: &'a Mesh,
    /// Where the interval starts [s].
    pub start: f64,
    /// How long it is [s].
    pub length: f64,
    /// Where the bodies are.
    pub tracks: &'a Tracks,
    /// Whether the interval is a whole step, of which the tracks have the looks.
    pub is_whole: bool,
    /// Spheres that can reach the body.
    pub spheres: &'a [Sphere],
    /// The body's weighted terms.
    pub weighted: &'a [Weighted],
}

impl Course<'_> {
    /// Where the interval ends [s].
    pub fn end(&self) -> f64 {
        self.start + self.length
    }

    /// The body, as the scene has it.
    pub fn body(&self) -> &scene::Body {
        &self.scene.bodies[self.index]
    }

    /// ω and κ.
    pub fn oscillator(&self) -> Oscillator {
        let material = self.body().material;
        Oscillator { omega: material.omega, damping: material.damping }
    }

    /// The weight of a vertex in a weighted term along `direction` d, how squarely it faces that [–]: max(0, −l̂·d) for rest
    /// position l (Fig. 4.1).
    pub fn facing(&self, direction: DVec3, rest: DVec3) -> f64 {
        let length = if self.mesh.is_round() { self.body().radius } else { rest.length() };
        f64::max(0.0, -(rest.dot(direction) / length)) // of a vertex at the centre: 0
    }

    /// The weight (3.3).
    pub fn weight(&self) -> Weight {
        self.scene.influence.weight
    }

    /// The frame of a body.
    pub fn track(&self, body: usize) -> Track<'_> {
        self.tracks.track(body)
    }

    /// The frame that a sphere's centre is of.
    pub fn sphere_track(&self, sphere: usize) -> Track<'_> {
        self.track(self.spheres[sphere].body as usize)
    }

    /// The centres of the spheres relative to that of the body at time `t` [scene unit], into `centres` (reused), and
    /// what is the same for all vertices [scene unit/s²]. At the end of the interval: just before it.
    pub fn look(&self, t: f64, centres: &mut Vec<DVec3>) -> DVec3 {
        let track = self.track(self.index);
        let own = if t >= self.end() { track.before(t) } else { track.at(t) };
        centres.clear();
        centres.extend((0..self.spheres.len()).map(|j| self.sphere_track(j).position(t) - own.position));
        terms::uniform(self.scene, self.index, &own)
    }

    /// [`Course::look`] at one of the five looks of a whole step.
    pub fn look_whole(&self, look: usize, centres: &mut Vec<DVec3>) -> DVec3 {
        let tracks = self.tracks;
        let own = tracks.kinematics(self.index, look);
        let position = |sphere: &Sphere| tracks.kinematics(sphere.body as usize, look).position;
        centres.clear();
        centres.extend(self.spheres.iter().map(|sphere| position(sphere) - own.position));
        terms::uniform(self.scene, self.index, &own)
    }

    /// Bounds of the motion of a sphere's centre relative to the body's within `[start, end]` [s].
    pub fn relative_bounds(&self, sphere: usize, start: f64, end: f64) -> Bounds {
        let other = self.spheres[sphere].body as usize;
        let [own, its] = [self.tracks.bounds(self.index), self.tracks.bounds(other)];
        let still = Bounds { speed: 0.0, acceleration: 0.0 };
        match (own, its) {
            // one of the two stands still
            (None, moves) | (moves, None) if self.is_whole => moves.unwrap_or(still),
            _ => self.track(other).relative_bounds(self.track(self.index), start, end),
        }
    }

    /// The largest acceleration by influence [scene unit/s²].
    pub fn strongest_pull(&self) -> f64 {
        let max_pull = self.weight().max_pull();
        self.spheres.iter().map(|sphere| sphere.strength.abs() * sphere.radius * max_pull).sum()
    }
}
