//! The forces on a body at any instant of an interval without jumps.

use glam::DVec3;

use crate::{
    geometry::Mesh,
    model::{influence::Weight, oscillator::Oscillator},
    scene::{Material, Scene, path::Bounds},
    sim::{
        arrays::Vectors,
        state::State,
        terms::{self, Sphere, Steady, Weighted},
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
    /// The constants of its oscillators.
    pub material: Material,
    /// Its radius [scene unit].
    pub radius: f64,
    /// Its rest shape.
    pub mesh: &'a Mesh,
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
    /// The body's weighted terms.
    pub weighted: &'a [Weighted],
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
        Oscillator { omega: self.material.omega, damping: self.material.damping }
    }

    /// The weight of a vertex in a weighted term along `direction` d, that is, how squarely the vertex faces it [–]:
    /// max(0, −l̂·d) for rest position l (Fig. 4.1).
    pub fn facing(&self, direction: DVec3, rest: DVec3) -> f64 {
        let length = if self.mesh.is_round() { self.radius } else { rest.length() };
        f64::max(0.0, -(rest.dot(direction) / length)) // 0 for a vertex at the centre
    }

    /// The weight (3.3).
    pub fn weight(&self) -> Weight {
        self.scene.influence.weight
    }

    /// The track of a body over the interval.
    pub fn track(&self, body: usize) -> Track<'_> {
        self.tracks.track(body).between(self.start, self.end())
    }

    /// The track of a sphere's centre over the interval.
    pub fn sphere_track(&self, sphere: usize) -> Track<'_> {
        self.track(self.spheres[sphere].body as usize)
    }

    /// Writes the centres of the spheres relative to that of the body at time `t` [s] to `centres` [scene unit], and
    /// returns the acceleration that all vertices share [scene unit/s²]; at the end of the interval, the left limits.
    pub fn sample(&self, t: f64, centres: &mut Vec<DVec3>) -> DVec3 {
        let track = self.track(self.index);
        let own = if t >= self.end() { track.before(t) } else { track.at(t) };
        centres.clear();
        centres.extend((0..self.spheres.len()).map(|j| self.sphere_track(j).position(t) - own.position));
        terms::uniform(&self.material, &own)
    }

    /// The response to the body's own motion at the end of the interval, given the response `carried` at its start, in
    /// closed form; `None` unless steps would not resolve the motion.
    pub fn carried_over(&self, carried: State) -> Option<State> {
        let steady = Steady::of(&self.material, self.track(self.index), self.length)?;
        // bit-identical to the start of the next step, which matters if the body oscillates a million times in between
        let end = if self.is_whole { ((self.start / self.length).round() + 1.0) * self.length } else { self.end() };
        let (from, to) = (steady.at(self.start), steady.at(end));
        let (x, u) = (carried.x - from.x, carried.u - from.u);
        let [xx, xu, ux, uu] = self.oscillator().flow(self.length);
        Some(State { x: xx * x + xu * u + to.x, u: ux * x + uu * u + to.u })
    }

    /// Bounds on the motion of a sphere's centre relative to the body's within `[start, end]` [s].
    pub fn relative_bounds(&self, sphere: usize, start: f64, end: f64) -> Bounds {
        let other = self.spheres[sphere].body as usize;
        let [own, its] = [self.tracks.bounds(self.index), self.tracks.bounds(other)];
        let still = Bounds { speed: 0.0, acceleration: 0.0 };
        match (own, its) {
            // at least one of the two does not move
            (None, moves) | (moves, None) if self.is_whole => moves.unwrap_or(still),
            _ => self.track(other).relative_bounds(self.track(self.index), start, end),
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
