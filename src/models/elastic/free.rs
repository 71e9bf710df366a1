//! Free bodies: the motion of a body of which no node is held.
//!
//! A free body consists of its nodes. Their positions s are relative to the mass centre c, which is integrated
//! separately:
//!
//! ```text
//! c″ = f̄ + g + R/M        s″ = f − f̄ + internal accelerations,   f̄ = Σ m f/M
//! ```
//!
//! where f is the external acceleration of a node, and R the reaction, at the centre, to the forces of the body's
//! sphere on others. Internal forces thus never move the centre, not even by rounding, and a falling body is undeformed
//! to the bit.

use glam::{DMat3, DQuat, DVec3};

use super::body::{Body, Matter, Springs};
use crate::{
    model::shape_matching::{best_rotation, moment, outer, resistance, solve},
    scene::{
        FreeMotion, Path,
        path::{Bounds, Given, Kinematics},
    },
};

/// The rigid motion of a free body.
#[derive(Clone, Debug)]
pub struct Free {
    /// Mass centre [scene unit].
    pub centre: DVec3,
    /// Velocity of the centre [scene unit/s].
    pub velocity: DVec3,
    /// Acceleration of the centre [scene unit/s²].
    pub acceleration: DVec3,
    /// The rotation Q that best fits the nodes.
    pub rotation: DQuat,
    /// Angular velocity of Q [rad/s].
    pub spin: DVec3,
    /// When Q was fitted [s].
    pub fitted: f64,
}

impl Free {
    /// A body at t = 0.
    pub fn new(motion: &FreeMotion) -> Free {
        let FreeMotion { from, velocity, spin, .. } = *motion;
        let (acceleration, rotation) = (DVec3::ZERO, DQuat::IDENTITY);
        Free { centre: from, velocity, acceleration, rotation, spin, fitted: 0.0 }
    }

    /// The motion of the centre.
    pub fn motion(&self) -> Kinematics {
        Kinematics { position: self.centre, velocity: self.velocity, acceleration: self.acceleration }
    }

    /// Q at time `t` [s] if it goes on turning as it did at the start of the step.
    pub fn turned(&self, t: f64) -> DQuat {
        let turn = self.spin * (t - self.fitted);
        let angle = turn.length();
        if angle == 0.0 {
            return self.rotation;
        }
        let (sin, cos) = libm::sincos(0.5 * angle);
        DQuat::from_xyzw(turn.x * sin / angle, turn.y * sin / angle, turn.z * sin / angle, cos) * self.rotation
    }

    /// Upper bound of the distance that the centre moves within some time [scene unit].
    pub fn farthest(&self, time: f64) -> f64 {
        (self.velocity.length() + 0.5 * time * self.acceleration.length()) * time
    }

    /// Its motion from `start` to `end` [s], seen from the centre of another body if one is given.
    pub fn path(&self, from: Option<&Free>, start: f64, end: f64) -> Path {
        let (mut motion, other) = (self.motion(), from.map(Free::motion));
        if let Some(other) = other {
            motion.position -= other.position;
            motion.velocity -= other.velocity;
            motion.acceleration -= other.acceleration;
        }
        let Kinematics { velocity, acceleration, .. } = motion;
        let speed = velocity.length() + acceleration.length() * (end - start);
        Path::Given(Given::new(Bounds { speed, acceleration: acceleration.length() }, move |t: f64| {
            motion.after(t - start)
        }))
    }
}

impl Body {
    /// Mass of the nodes that are still part of the body.
    pub fn free_mass(&self) -> f64 {
        self.held().iter().zip(self.masses()).filter(|(held, _)| !**held).map(|(_, mass)| mass).sum()
    }

    /// Starts a free body with its spin.
    pub fn spin(&mut self) {
        let Some(free) = &self.free else { return };
        let velocities = match &mut self.matter {
            Matter::Lattice(springs) => &mut springs.motion.velocities,
            Matter::Fem(finite) => &mut finite.velocities,
        };
        velocities.iter_mut().zip(&self.rest).for_each(|(velocity, l)| *velocity = free.spin.cross(*l));
        self.fit();
        self.measure();
        self.is_at_rest = self.speed == 0.0;
    }

    /// Moves the centre of a lattice to the mass centre of its remaining nodes.
    pub fn recentre(&mut self) {
        let mass = self.free_mass();
        let Body { matter, free: Some(free), .. } = self else { return };
        let Matter::Lattice(springs) = matter else { return };
        let Springs { lattice, motion } = &mut **springs;
        let mean = |of: &[DVec3]| -> DVec3 {
            let left = of.iter().zip(&lattice.masses).zip(&lattice.held).filter(|(_, held)| !**held);
            left.map(|((v, m), _)| *v * *m).sum::<DVec3>() / mass
        };
        let [place, velocity] = [mean(&motion.positions), mean(&motion.velocities)];
        if mass > 0.0 {
            motion.positions.iter_mut().for_each(|s| *s -= place);
            motion.velocities.iter_mut().for_each(|u| *u -= velocity);
            free.centre += place;
            free.velocity += velocity;
            motion.accelerations.clear();
        }
    }

    /// Updates the displacements of the nodes from the rest shape, and for a free body rotation and spin of that.
    pub fn fit(&mut self) {
        let (mut x, mut u) = (std::mem::take(&mut self.x), std::mem::take(&mut self.u));
        let [positions, velocities] = self.state();
        let is_still = velocities.iter().all(|u| *u == DVec3::ZERO) && positions == self.rest;
        x.clear();
        u.clear();
        let Some(Free { mut rotation, .. }) = self.free else {
            x.extend(positions.iter().zip(&self.rest).map(|(s, l)| *s - *l));
            u.extend_from_slice(velocities);
            (self.x, self.u) = (x, u);
            return;
        };
        let mut spin = DVec3::ZERO;
        if !is_still {
            let (masses, held) = (self.masses(), self.held());
            let nodes = || (0..positions.len()).filter(|&node| !held[node]);
            rotation = best_rotation(self.moment_of(positions), rotation);
            let axes = DMat3::from_quat(rotation);
            let [mut spread, mut turning] = [DMat3::ZERO; 2];
            for i in nodes() {
                let a = axes * self.rest[i] * masses[i];
                spread += outer(a, positions[i]);
                turning += outer(a, velocities[i]);
            }
            // G Ω_Q = Σ m a×s′
            spin = solve(resistance(spread), moment(turning));
            if !spin.is_finite() {
                spin = DVec3::ZERO;
            }
        }
        let axes = DMat3::from_quat(rotation);
        let displaced = |(s, l): (&DVec3, &DVec3)| if is_still { DVec3::ZERO } else { *s - axes * *l };
        x.extend(positions.iter().zip(&self.rest).map(displaced));
        u.extend(velocities.iter().zip(&self.rest).map(|(u, l)| *u - spin.cross(axes * *l)));
        (self.x, self.u) = (x, u);
        if let Some(free) = &mut self.free {
            (free.rotation, free.spin) = (rotation, spin);
        }
    }

    /// Angular momentum of a free body about its centre [mass · scene unit²/s].
    pub fn angular_momentum(&self) -> DVec3 {
        if self.free.is_none() {
            return DVec3::ZERO;
        }
        let [positions, velocities] = self.state();
        let of = positions.iter().zip(velocities).zip(self.masses()).enumerate();
        of.filter(|(node, _)| !self.held()[*node]).map(|(_, ((s, u), m))| s.cross(*u) * *m).sum()
    }
}
