//! The energy bound: limits of a vertex's displacement and velocity, given the forces so far.
//!
//! Starting from rest, `x(t) = ∫ S(t − s) F(s) ds` with the impulse response S of the oscillator, so bounds of F and S
//! bound x and x′. In addition, `√(|u|² + ω²|x|²)` grows at a rate of at most |F|. If nothing around the body ever
//! moves or changes, then E of [`energy`](crate::model::energy) never grows.

use std::f64::consts::PI;

use glam::DVec3;

use crate::{
    bench::path,
    model::{energy::influence_potential, influence, phase::Phase},
    scene::{Response, Scene},
    sim::BodyView,
};

/// The bounds of one body.
pub struct Allowance {
    omega: f64,
    damping: f64,
    /// ∫|F| dt so far [scene unit/s].
    impulse: f64,
    /// The largest |F| so far [scene unit/s²].
    force: f64,
    /// √(2 (E(0) − min V)) of each vertex [scene unit/s]; empty if energy can enter the system.
    energy: Vec<f64>,
    /// The strongest pull by all other bodies, in any phase they can be in [scene unit/s²].
    pull: f64,
    time: f64,
}

impl Allowance {
    /// The bounds of body `index` at t = 0.
    pub fn new(scene: &Scene, index: usize) -> Allowance {
        let body = &scene.bodies[index];
        let others = || (0..scene.bodies.len()).filter(move |&other| other != index);
        let law = |other: usize| scene.law(index, other);
        let phases = |other: usize| {
            let source = &scene.bodies[other];
            let q = (path(source).position(0.0) - path(body).position(0.0)).length() / (source.radius + body.radius);
            let moves = path(body).relative_bounds(path(source), 0.0, f64::MAX).speed != 0.0;
            if moves { vec![Phase::Merged, Phase::Apart, Phase::Core] } else { vec![law(other).thresholds.initial(q)] }
        };
        let strength =
            |phase, other: usize| scene.strength(&law(other), phase, body.radius, scene.bodies[other].radius);
        let pull: f64 = others()
            .map(|other| {
                let strongest = phases(other).into_iter().map(|phase| strength(phase, other).abs()).fold(0.0, f64::max);
                let sphere = scene.bodies[other].sphere_radius();
                strongest * sphere * scene.influence.weight.max_pull()
            })
            .sum();

        let is_still =
            scene.bodies.iter().all(|body| path(body).is_fixed()) && scene.pushes.iter().all(|push| push.body != index);
        // Rounding of positions also affects the energy.
        let far = scene.bodies.iter().map(|body| path(body).position(0.0).length()).fold(0.0, f64::max);
        let rounding = 8.0 * f64::EPSILON * (far + body.radius);
        let omega = body.material.omega;
        let ceiling = |rest: DVec3| {
            let vertex = path(body).position(0.0) + rest;
            let (mut available, mut force, mut stiffness) = (pull * rounding, DVec3::ZERO, 0.0);
            for other in others() {
                let source = &scene.bodies[other];
                let (weight, sphere) = (scene.influence.weight, source.sphere_radius());
                let strength: f64 = phases(other).into_iter().map(|phase| strength(phase, other)).sum();
                let to_centre = path(source).position(0.0) - vertex;
                let phi = |r: f64| influence_potential(weight, sphere, r);
                let least = if strength > 0.0 { 0.0 } else { phi(sphere) };
                available += strength * (phi(to_centre.length()) - least);
                force += influence::acceleration(weight, strength, sphere, to_centre);
                stiffness += strength.abs();
            }
            // With |x| ≤ M/ω and V(x) ≥ V(0) − |F||x|: M²/2 ≤ |F| M/ω. |F| exceeds neither the pull nor |F(0)| + L|x|.
            let force = force.length() + stiffness * rounding;
            let softening = 1.0 - stiffness / (omega * omega);
            let local = if softening > 0.0 { 2.0 * force / (omega * softening) } else { f64::INFINITY };
            f64::sqrt(2.0 * available).min(2.0 * pull / omega).min(local)
        };
        let mesh = body.shape.mesh();
        let rest = mesh.at(body.radius);
        Allowance {
            omega: body.material.omega,
            damping: body.material.damping,
            impulse: 0.0,
            force: 0.0,
            energy: if is_still { (0..rest.len()).map(|i| ceiling(rest.position(i))).collect() } else { vec![] },
            pull,
            time: 0.0,
        }
    }

    /// The energy of all vertices above its minimum [scene unit²/s²].
    pub fn energy(&self) -> f64 {
        self.energy.iter().map(|momentum| 0.5 * momentum * momentum).sum()
    }

    /// Advances to time `end` [s].
    pub fn advance(&mut self, scene: &Scene, index: usize, end: f64) {
        let start = self.time;
        let body = &scene.bodies[index];
        let motion = path(body).bounds(start, end);
        let carry = match body.material.response {
            Response::Rigid => 0.0,
            Response::Inertial => motion.acceleration,
            Response::World => motion.acceleration + 2.0 * body.material.damping * motion.speed,
        };
        let pushes = scene.pushes.iter().filter(|push| push.body == index);
        let acting = pushes.filter(|push| push.start <= end && start < push.end()).map(|push| push.strength.abs());
        let force = self.pull + carry + acting.sum::<f64>();
        self.impulse += force * (end - start);
        self.force = self.force.max(force);
        self.time = end;
    }

    /// The largest ratio of a vertex's state to the energy bound [–]; at most 1 for an exact solution. NaN if the state
    /// contains NaN.
    pub fn used(&self, body: &BodyView<'_>) -> f64 {
        let (furthest, fastest) = self.response();
        let mut used = 0.0;
        for i in 0..body.vertex_count() {
            let (x, u) = (body.displacement(i).length(), body.velocity(i).length());
            let momentum = u.hypot(self.omega * x);
            let limit = f64::min(self.impulse, self.energy.get(i).copied().unwrap_or(f64::INFINITY));
            for part in [part(momentum, limit), part(x, furthest), part(u, fastest)] {
                // written so that NaN propagates
                if !(part <= used) {
                    used = part;
                }
            }
        }
        used
    }

    /// Bounds of a vertex's displacement and velocity, given the forces so far [scene unit, scene unit/s].
    fn response(&self) -> (f64, f64) {
        let Allowance { omega, damping, impulse, force, time, .. } = *self;
        // |S| ≤ t, 1/ω, 1/2κ; and ∫|S|, ∫|S′| over all time: each lobe of the oscillation is smaller by a factor of
        // e^(−κπ/ν)
        let highest = time.min(1.0 / omega).min(0.5 / damping);
        let (area, variation) = if damping >= omega {
            (1.0 / (omega * omega), 2.0 * highest)
        } else {
            let per_lobe = damping * PI / ((omega - damping) * (omega + damping)).sqrt();
            (1.0 / (omega * omega) / (0.5 * per_lobe).tanh(), -2.0 * highest / (-per_lobe).exp_m1())
        };
        ((impulse * highest).min(force * area), impulse.min(force * variation))
    }
}

/// `value` / `limit`, where 0/0 is 0.
fn part(value: f64, limit: f64) -> f64 {
    if value == 0.0 { 0.0 } else { value / limit }
}
