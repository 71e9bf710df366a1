//! What acts on a body over a stretch of time in which nothing jumps, at any instant of it.

use glam::DVec3;

use crate::{
    model::{influence::Weight, oscillator::Oscillator},
    scene::{self, Path, Push, Scene, path::Bounds},
    sim::surroundings::{self, carry},
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

/// A body's course over a stretch of time in which nothing jumps: phases, pushes and paths are smooth inside it.
pub struct Course<'a> {
    /// The scene …
    pub scene: &'a Scene,
    /// … and the body's index in it.
    pub index: usize,
    /// Where the stretch starts [s].
    pub start: f64,
    /// How long it is [s].
    pub length: f64,
    /// Spheres that can reach the body.
    pub spheres: &'a [Sphere],
    /// Pushes that act.
    pub pushes: &'a [Push],
}

/// Where the spheres are at an instant, and what the body feels of its own motion.
#[derive(Clone, Debug, Default)]
pub struct Moment {
    /// Centres of the spheres relative to the centre of the body [scene unit].
    pub centres: Vec<DVec3>,
    /// Subtracted from the acceleration [scene unit/s²].
    pub carry: DVec3,
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

    /// The weight (3.3).
    pub fn weight(&self) -> Weight {
        self.scene.influence.weight
    }

    /// The path of a sphere's centre.
    pub fn path(&self, sphere: usize) -> &Path {
        &self.scene.bodies[self.spheres[sphere].body as usize].path
    }

    /// What acts at time `t`, into `moment` (reused). At the end of the stretch: just before it.
    pub fn look(&self, t: f64, moment: &mut Moment) {
        let body = self.body();
        let own = if t >= self.end() { body.path.before(t) } else { body.path.at(t) };
        moment.carry = carry(body.material.response, body.material.damping, &own);
        moment.centres.clear();
        moment.centres.extend((0..self.spheres.len()).map(|j| self.path(j).position(t) - own.position));
    }

    /// The sum of the pushes on a vertex with unit rest position `unit` [scene unit/s²].
    pub fn push(&self, unit: DVec3) -> DVec3 {
        self.pushes.iter().map(|push| surroundings::push_acceleration(push, unit)).sum()
    }

    /// Bounds of the motion of a sphere's centre relative to the body's within `[start, end]` [s].
    pub fn relative_bounds(&self, sphere: usize, start: f64, end: f64) -> Bounds {
        self.path(sphere).relative_bounds(&self.body().path, start, end)
    }

    /// Lipschitz constant of the influence: bounds |∂F/∂x| [1/s²]. Both weights have |d(r W)/dr| ≤ 1.
    pub fn stiffness(&self) -> f64 {
        self.spheres.iter().map(|sphere| sphere.strength.abs()).sum()
    }

    /// The largest acceleration by influence [scene unit/s²].
    pub fn strongest_pull(&self) -> f64 {
        let max_pull = self.weight().max_pull();
        self.spheres.iter().map(|sphere| sphere.strength.abs() * sphere.radius * max_pull).sum()
    }

    /// Whether nothing acts on the body at all.
    pub fn is_idle(&self) -> bool {
        let pushed = self.pushes.iter().any(|push| push.strength != 0.0);
        let body = self.body();
        let moves = body.path.bounds(self.start, self.end());
        let carried = match body.material.response {
            scene::Response::Rigid => false,
            scene::Response::Inertial => moves.acceleration > 0.0,
            scene::Response::World => moves.acceleration > 0.0 || (moves.speed > 0.0 && body.material.damping > 0.0),
        };
        self.spheres.is_empty() && !pushed && !carried
    }
}
