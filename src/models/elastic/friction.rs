//! Contacts of a body's surface with planes, and their friction.
//!
//! The few vertices in contact bear the whole body, and below `slip` friction is far stiffer than the springs. It is
//! therefore implicit in the velocities v of the nodes at the end of a kick of h:
//!
//! ```text
//! v = v₀ + W Σ Bᵀ J,    J = −h m μ k d v_t / √(|v_t|² + v_s²)    at each contact, v_t = B v in the plane
//! ```
//!
//! where B interpolates a vertex from the corners of its cell, and W is the response of the nodes to impulses. The root
//! is taken at the last iterate, which leaves a symmetric positive definite system for J, solved by conjugate gradients.

use glam::DVec3;

use super::body::Body;
use crate::scene::{Plane, Scene};

/// Iterations for the root.
const ITERATIONS: usize = 4;
/// Relative change of the root at which they end.
const SAME_ROOT: f64 = 0.05;
/// Iterations of conjugate gradients. They start from impulses that add no energy, and each takes some away: friction that
/// has not converged is dissipative, too.
const GRADIENTS: usize = 12;
/// Relative residual at which they end.
const RESIDUAL: f64 = 1e-3;
/// Upper limit on velocity by impulse: friction that is weaker is none.
const MOST: f64 = 1e200;

/// A vertex below a plane.
pub struct Contact<'a> {
    plane: &'a Plane,
    corners: [u32; 8],
    weights: [f64; 8],
    /// Mass of the vertex.
    mass: f64,
    /// k d [scene unit/s²].
    pressure: f64,
}

impl Contact<'_> {
    fn mean(&self, of: &[DVec3]) -> DVec3 {
        self.corners.iter().zip(self.weights).map(|(&node, weight)| of[node as usize] * weight).sum()
    }

    /// The part of a vector in the plane.
    fn along(&self, vector: DVec3) -> DVec3 {
        vector - self.plane.normal * self.plane.normal.dot(vector)
    }

    /// The velocity at which the vertex slides, given those of the nodes.
    fn slide(&self, velocities: &[DVec3]) -> DVec3 {
        self.along(self.mean(velocities))
    }

    /// μ k d/√(v² + v_s²) [1/s].
    fn rate(&self, speed: f64) -> f64 {
        self.plane.friction * self.pressure / speed.hypot(self.plane.slip)
    }

    /// The velocity of the vertex by an impulse on it, if the nodes were on their own [1/mass].
    fn mobility(&self, masses: &[f64]) -> f64 {
        self.corners.iter().zip(self.weights).map(|(&node, weight)| weight * weight / masses[node as usize]).sum()
    }

    /// Adds the share of each node in a vector at the vertex.
    fn spread(&self, vector: DVec3, into: &mut [DVec3]) {
        for (&node, weight) in self.corners.iter().zip(self.weights) {
            into[node as usize] += vector * weight;
        }
    }

    /// Adds the accelerations of the nodes by the pressure, and by friction if their velocities are given [scene unit/s²].
    pub fn accelerate(&self, masses: &[f64], velocity: Option<(&[DVec3], DVec3)>, into: &mut [DVec3]) {
        let mut force = self.plane.normal * self.pressure;
        if let Some((velocities, of_centre)) = velocity {
            let slide = self.along(self.mean(velocities) + of_centre);
            force -= slide * self.rate(slide.length());
        }
        for (&node, weight) in self.corners.iter().zip(self.weights).filter(|(_, weight)| *weight != 0.0) {
            into[node as usize] += force * (weight * self.mass / masses[node as usize]);
        }
    }
}

impl Body {
    /// Calls `found` for each contact, given the position of the centre. Each vertex has its share of the body's mass; the
    /// surface of a body that has torn consists of nodes.
    pub fn contacts<'a>(
        &self,
        scene: &'a Scene,
        centre: DVec3,
        positions: &[DVec3],
        mut found: impl FnMut(Contact<'a>),
    ) {
        let planes = self.planes(scene, centre);
        // of a body that has lost all its cells, nothing is left to touch
        if planes.is_empty() || self.torn.is_some() && self.surface.exposed.is_empty() {
            return;
        }
        let mut touch = |corners: [u32; 8], weights: [f64; 8], mass: f64, place: DVec3| {
            for plane in planes {
                let depth = plane.depth(place + centre);
                if depth > 0.0 {
                    found(Contact { plane, corners, weights, mass, pressure: plane.stiffness * depth });
                }
            }
        };
        let (surface, masses) = (&self.surface, self.masses());
        for &node in &surface.exposed {
            let weights = std::array::from_fn(|i| f64::from(i == 0));
            touch([node; 8], weights, masses[node as usize], positions[node as usize]);
        }
        if surface.exposed.is_empty() {
            let corners = self.corners();
            for (embedded, share) in surface.cells.embedded.iter().zip(surface.mesh.shares()) {
                let corners = &corners[embedded.cell as usize];
                touch(*corners, embedded.weights, share * surface.mass, embedded.mean(corners, positions));
            }
        }
    }

    /// The contacts with friction.
    pub fn rubbing<'a>(&self, scene: &'a Scene, centre: DVec3, positions: &[DVec3]) -> Vec<Contact<'a>> {
        let mut contacts = Vec::new();
        if scene.planes.iter().any(|plane| plane.friction > 0.0) {
            let has_friction = |contact: &Contact<'_>| (contact.mass * contact.rate(0.0)).is_normal();
            self.contacts(scene, centre, positions, |contact| contacts.extend(Some(contact).filter(has_friction)));
        }
        contacts
    }
}

/// The impulses of friction on the nodes during `h` [s], given a guess of their velocities, and those without friction
/// [scene unit/s], and a function that turns impulses into changes of velocity.
pub fn impulses(
    contacts: &[Contact<'_>],
    h: f64,
    guess: &[DVec3],
    without: &[DVec3],
    masses: &[f64],
    respond: impl Fn(&mut [DVec3]),
) -> Vec<DVec3> {
    let spread = |of: &[DVec3]| {
        let mut sum = vec![DVec3::ZERO; without.len()];
        contacts.iter().zip(of).for_each(|(contact, impulse)| contact.spread(*impulse, &mut sum));
        sum
    };
    let response = |of: &[DVec3]| -> Vec<DVec3> {
        let mut sum = spread(of);
        respond(&mut sum);
        contacts.iter().map(|contact| contact.slide(&sum)).collect()
    };
    let dot = |a: &[DVec3], b: &[DVec3]| a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum::<f64>();
    let without: Vec<DVec3> = contacts.iter().map(|contact| contact.slide(without)).collect();
    let enough = RESIDUAL * RESIDUAL * dot(&without, &without);
    let mut now: Vec<DVec3> = contacts.iter().map(|contact| contact.slide(guess)).collect();
    let mut found: Vec<DVec3> = Vec::new();
    for iteration in 0..ITERATIONS {
        let speeds: Vec<f64> = now.iter().map(|now| now.length()).collect();
        let yields: Vec<f64> = contacts
            .iter()
            .zip(&speeds)
            .map(|(contact, &v)| f64::min(1.0 / (h * contact.mass * contact.rate(v)), MOST))
            .collect();
        if iteration == 0 {
            found = now.iter().zip(&yields).map(|(now, yields)| *now * (-1.0 / yields)).collect();
        }
        let apply = |of: &[DVec3]| -> Vec<DVec3> {
            response(of).into_iter().zip(of).zip(&yields).map(|((moved, of), yields)| moved + *of * *yields).collect()
        };
        // the diagonal, with the nodes on their own
        let scales: Vec<f64> =
            contacts.iter().zip(&yields).map(|(contact, yields)| 1.0 / (yields + contact.mobility(masses))).collect();
        let scaled = |of: &[DVec3]| -> Vec<DVec3> { of.iter().zip(&scales).map(|(of, scale)| *of * *scale).collect() };
        let mut applied = apply(&found);
        if !(0.5 * dot(&found, &applied) + dot(&found, &without) <= 0.0) {
            found.fill(DVec3::ZERO);
            applied.fill(DVec3::ZERO);
        }
        let mut left: Vec<DVec3> = applied.iter().zip(&without).map(|(now, without)| -*without - *now).collect();
        let mut way = scaled(&left);
        let mut size = dot(&left, &way);
        for _ in 0..GRADIENTS {
            if dot(&left, &left) <= enough {
                break;
            }
            let changed = apply(&way);
            let by = size / dot(&way, &changed);
            if !by.is_finite() {
                break;
            }
            for (i, found) in found.iter_mut().enumerate() {
                *found += way[i] * by;
                left[i] -= changed[i] * by;
            }
            let next = scaled(&left);
            let before = std::mem::replace(&mut size, dot(&left, &next));
            way.iter_mut().zip(&next).for_each(|(way, next)| *way = *next + *way * (size / before));
        }
        now = found.iter().zip(&yields).map(|(found, yields)| *found * -*yields).collect();
        let is_same = |((now, speed), contact): ((&DVec3, &f64), &Contact<'_>)| {
            (now.length() - speed).abs() <= SAME_ROOT * (speed + contact.plane.slip)
        };
        if now.iter().zip(&speeds).zip(contacts).all(is_same) {
            break;
        }
    }
    spread(&found)
}
