//! What acts on a body over a stretch of time in which nothing jumps, at any instant of it.

use glam::DVec3;

use super::super::State;
use crate::{
    geometry::Mesh,
    model::{influence::Weight, oscillator::Oscillator},
    scene::{self, Path, Scene, path::Bounds},
    sim::{surroundings::carry, tracks::Tracks},
};

/// An influence sphere of another body that can reach the body in the stretch.
#[derive(Clone, Copy, Debug)]
pub struct Sphere {
    /// Index of the body that it belongs to.
    pub body: u32,
    /// Its radius r_e [scene unit].
    pub radius: f64,
    /// 1 / r_e.
    pub inverse_radius: f64,
    /// Signed strength [1/s²]: positive attracts, negative repels.
    pub strength: f64,
}

/// A push of the body's, as it is in the stretch.
#[derive(Clone, Copy, Debug)]
pub struct Push {
    /// Unit direction d.
    pub direction: DVec3,
    /// Acceleration of a vertex that faces it squarely [scene unit/s²]; 0 while it does not act.
    pub strength: f64,
}

/// The response of a vertex that faces a push squarely, along the push.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pushed {
    /// [scene unit]
    pub x: f64,
    /// [scene unit/s]
    pub u: f64,
}

/// What all vertices of a body do alike: the equation of motion is linear but for the influence, so that the response
/// to the body's own motion is one vector for all of them, and that to a push one number, times how squarely each faces it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Common {
    /// Response to the body's own motion.
    pub carried: State,
    /// Response to each of the body's pushes, in the order of the scene.
    pub pushed: Vec<Pushed>,
}

impl Common {
    /// Whether nothing has happened to all vertices alike.
    pub fn is_zero(&self) -> bool {
        self.carried == State::default() && self.pushed.iter().all(|pushed| *pushed == Pushed::default())
    }

    /// What it adds to the displacement and velocity of the vertex whose rest position has the direction `facing`.
    pub fn of(&self, facing: DVec3, pushes: &[scene::Push]) -> State {
        let mut state = self.carried;
        for (pushed, push) in self.pushed.iter().zip(pushes) {
            let along = push.direction * f64::max(0.0, -facing.dot(push.direction));
            state.x += along * pushed.x;
            state.u += along * pushed.u;
        }
        state
    }

    /// What pushes add to the displacement of the vertex whose rest position has the direction `facing` [scene unit].
    pub fn moved(&self, facing: DVec3, pushes: &[scene::Push]) -> DVec3 {
        self.of(facing, pushes).x - self.carried.x
    }

    /// What √(|u|² + ω²|x|²) of a vertex cannot exceed that faces the pushes so squarely, from 0 to 1 each [scene unit/s].
    pub fn momentum(&self, omega: f64, facing: impl Iterator<Item = f64>) -> f64 {
        let momentum = |x2: f64, u2: f64| (u2 + omega * omega * x2).sqrt();
        let State { x, u } = self.carried;
        let pushed = self.pushed.iter().zip(facing).map(|(Pushed { x, u }, facing)| facing * momentum(x * x, u * u));
        momentum(x.length_squared(), u.length_squared()) + pushed.sum::<f64>()
    }

    /// No |x| that it gives any vertex exceeds the first [scene unit], no √(|u|² + ω²|x|²) the second [scene unit/s].
    pub fn bounds(&self, omega: f64) -> (f64, f64) {
        let momentum = |x2: f64, u2: f64| (u2 + omega * omega * x2).sqrt();
        let State { x, u } = self.carried;
        let mut sum = (x.length(), momentum(x.length_squared(), u.length_squared()));
        for Pushed { x, u } in &self.pushed {
            sum = (sum.0 + x.abs(), sum.1 + momentum(x * x, u * u));
        }
        sum
    }
}

/// A body's course over a stretch of time in which nothing jumps: phases, pushes and paths are smooth inside it.
#[derive(Clone, Copy)]
pub struct Course<'a> {
    /// The scene …
    pub scene: &'a Scene,
    /// … and the body's index in it.
    pub index: usize,
    /// Its rest shape.
    pub mesh: &'a Mesh,
    /// Where the stretch starts [s].
    pub start: f64,
    /// How long it is [s].
    pub length: f64,
    /// Where the bodies are in the course of a whole step, if the stretch is one.
    pub tracks: Option<&'a Tracks>,
    /// Spheres that can reach the body.
    pub spheres: &'a [Sphere],
    /// The body's pushes.
    pub pushes: &'a [Push],
}

impl Course<'_> {
    /// Where the stretch ends [s].
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

    /// How squarely a vertex faces a push [–]: max(0, −l̂·d) for rest position l (Fig. 4.1).
    pub fn facing(&self, push: &Push, rest: DVec3) -> f64 {
        let length = if self.mesh.is_round() { self.body().radius } else { rest.length() };
        f64::max(0.0, -(rest.dot(push.direction) / length)) // of a vertex at the centre: 0
    }

    /// The weight (3.3).
    pub fn weight(&self) -> Weight {
        self.scene.influence.weight
    }

    /// The path of a sphere's centre.
    pub fn path(&self, sphere: usize) -> &Path {
        &self.scene.bodies[self.spheres[sphere].body as usize].path
    }

    /// The centres of the spheres relative to that of the body at time `t` [scene unit], into `centres` (reused), and
    /// what the body feels of its own motion [scene unit/s²]. At the end of the stretch: just before it.
    pub fn look(&self, t: f64, centres: &mut Vec<DVec3>) -> DVec3 {
        let body = self.body();
        let own = if t >= self.end() { body.path.before(t) } else { body.path.at(t) };
        centres.clear();
        centres.extend((0..self.spheres.len()).map(|j| self.path(j).position(t) - own.position));
        carry(body.material.response, body.material.damping, &own)
    }

    /// [`Course::look`] at one of the five looks of a whole step, where the tracks have it.
    pub fn look_whole(&self, tracks: &Tracks, look: usize, centres: &mut Vec<DVec3>) -> DVec3 {
        let body = self.body();
        let own = tracks.kinematics(self.scene, self.index, look);
        let position = |sphere: &Sphere| tracks.kinematics(self.scene, sphere.body as usize, look).position;
        centres.clear();
        centres.extend(self.spheres.iter().map(|sphere| position(sphere) - own.position));
        carry(body.material.response, body.material.damping, &own)
    }

    /// Bounds of the motion of a sphere's centre relative to the body's within `[start, end]` [s].
    pub fn relative_bounds(&self, sphere: usize, start: f64, end: f64) -> Bounds {
        let other = self.spheres[sphere].body as usize;
        let known = |tracks: &Tracks| {
            let [own, its] = [tracks.bounds(self.index), tracks.bounds(other)];
            own.is_none().then_some(its).or(its.is_none().then_some(own)) // one of the two stands still
        };
        let still = Bounds { speed: 0.0, acceleration: 0.0 };
        match self.tracks.and_then(known) {
            Some(bounds) => bounds.unwrap_or(still),
            None => self.path(sphere).relative_bounds(&self.body().path, start, end),
        }
    }

    /// The largest acceleration by influence [scene unit/s²].
    pub fn strongest_pull(&self) -> f64 {
        let max_pull = self.weight().max_pull();
        self.spheres.iter().map(|sphere| sphere.strength.abs() * sphere.radius * max_pull).sum()
    }
}
