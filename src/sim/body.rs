//! The state of one body.

use std::sync::Arc;

use super::{
    arrays::Vectors,
    integrator::{
        explicit::Interval,
        exponential::{self, course::Sphere},
    },
};
use crate::{
    model::oscillator::Oscillator,
    scene::{Push, Scene},
};

/// A body's state. While it is at rest, as it is until something acts on it, it has no vertices of its own.
pub(super) struct Body {
    /// Unit rest positions, shared by all bodies of the same shape.
    pub unit: Arc<Vectors>,
    /// ω and κ of its vertices.
    pub oscillator: Oscillator,
    /// The scene's pushes on this body.
    pub pushes: Vec<Push>,
    /// Displacements x [scene unit]; empty at rest.
    pub displacement: Vectors,
    /// Velocities x′ [scene unit/s]; empty at rest.
    pub velocity: Vectors,
    /// How far the vertices are and can get.
    pub extent: Extent,
    /// What √(|u|² + ω²|x|²) of no vertex can exceed, whatever happened so far: it grows by no more than the forces
    /// that the body was under [scene unit/s].
    pub bound: f64,
    /// Pairs in which the body takes part in the current step.
    pub neighbours: Vec<Neighbour>,
    pub scratch: Scratch,
}

/// Another body that can touch this one in the current step.
#[derive(Clone, Copy, Debug)]
pub(super) struct Neighbour {
    /// Index of the other body.
    pub other: u32,
    /// Index of the pair.
    pub pair: u32,
}

/// Reused from step to step.
#[derive(Default)]
pub(super) struct Scratch {
    pub interval: Interval,
    pub breaks: Vec<f64>,
    pub spheres: Vec<Sphere>,
    pub pushes: Vec<Push>,
    pub exponential: exponential::Scratch,
}

impl Body {
    /// Body `index` of the scene, at rest.
    pub fn new(scene: &Scene, index: usize, unit: Arc<Vectors>) -> Body {
        let material = scene.bodies[index].material;
        Body {
            unit,
            oscillator: Oscillator { omega: material.omega, damping: material.damping },
            pushes: scene.pushes.iter().filter(|push| push.body == index).copied().collect(),
            displacement: Vectors::default(),
            velocity: Vectors::default(),
            extent: Extent::default(),
            bound: 0.0,
            neighbours: Vec::new(),
            scratch: Scratch::default(),
        }
    }

    /// Whether nothing has acted on the body yet: every displacement and velocity is exactly zero.
    pub fn is_at_rest(&self) -> bool {
        self.displacement.is_empty()
    }

    /// How far from rest its vertices swing if nothing else acts [scene unit]: no less than any |x|, and unlike those
    /// it does not swing itself.
    pub fn amplitude(&self) -> f64 {
        let Extent { displacement, momentum } = self.extent;
        if self.oscillator.omega > 0.0 { momentum / self.oscillator.omega } else { displacement }
    }

    /// Whether its state is one that the equation of motion cannot lead to: not finite, or far beyond [`Body::bound`].
    /// The margin leaves room for schemes that are merely inaccurate.
    pub fn has_diverged(&self) -> bool {
        const MARGIN: f64 = 100.0;
        let Extent { displacement, momentum } = self.extent;
        !displacement.is_finite() || !momentum.is_finite() || momentum > MARGIN * self.bound
    }

    /// From here on the body has vertices of its own.
    pub fn wake(&mut self) {
        if self.is_at_rest() {
            self.displacement.reset(self.unit.len());
            self.velocity.reset(self.unit.len());
        }
    }
}

/// Bounds over the vertices of a body, from which it is told how far they can get in a step.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Extent {
    /// Largest |x| [scene unit].
    pub displacement: f64,
    /// Largest √(|u|² + ω²|x|²) [scene unit/s].
    pub momentum: f64,
}

impl Extent {
    /// The bounds of a state; not a number if any of it isn't.
    pub fn of(displacement: &Vectors, velocity: &Vectors, oscillator: Oscillator) -> Extent {
        let omega_squared = oscillator.omega * oscillator.omega;
        let (mut x2, mut m2) = (0.0, 0.0);
        for (x, u) in displacement.iter().zip(velocity.iter()) {
            let (x_squared, u_squared) = (x.length_squared(), u.length_squared());
            x2 = larger(x2, x_squared);
            m2 = larger(m2, u_squared + omega_squared * x_squared);
        }
        Extent { displacement: x2.sqrt(), momentum: m2.sqrt() }
    }

    /// How far from its rest position a vertex can get within `h` [s] under no more than `force` [scene unit/s²].
    ///
    /// Without force √(|u|² + ω²|x|²) never grows, and under one at no more than its size: so |x| grows by no more
    /// than that times h, nor beyond that over ω.
    pub fn after(&self, oscillator: Oscillator, force: f64, h: f64) -> f64 {
        let momentum = self.momentum + force * h;
        let travelled = self.displacement + momentum * h;
        if oscillator.omega > 0.0 { travelled.min(momentum / oscillator.omega) } else { travelled }
    }
}

/// The larger of two numbers, or what is not a number: `f64::max` would pass over that.
fn larger(a: f64, b: f64) -> f64 {
    if b > a || b.is_nan() { b } else { a }
}
