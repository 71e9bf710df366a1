//! Explicit steps of a lattice.

use glam::DVec3;

use super::{Lattice, lanes::Lanes};

/// The motion of the nodes.
#[derive(Clone, Debug, Default)]
pub struct Motion {
    /// Positions [scene unit], `[node_count]`.
    pub positions: Vec<DVec3>,
    /// Velocities [scene unit/s], `[node_count]`.
    pub velocities: Vec<DVec3>,
    /// Accelerations at the end of the last step [scene unit/s²], `[node_count]`; empty if unknown, as after a
    /// discontinuity of the forces.
    pub accelerations: Vec<DVec3>,
    /// Inverse masses of the nodes, 0 for held ones, `[node_count]`.
    pub inverse: Vec<f64>,
    /// Velocities at which dampers are evaluated; reused.
    predicted: Vec<DVec3>,
    /// Forces of springs and dampers; reused.
    forces: Vec<DVec3>,
    lanes: Lanes,
}

/// Time integration schemes of a lattice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scheme {
    /// Velocity Verlet: second order. Damping is evaluated at the predicted velocity u + h a (Groot and Warren,
    /// Dissipative particle dynamics, 1997).
    Verlet,
    /// Semi-implicit Euler: first order.
    Euler,
}

impl Motion {
    /// A lattice at rest.
    pub fn at_rest(lattice: &Lattice) -> Motion {
        let mut motion = Motion {
            positions: lattice.rest.clone(),
            velocities: vec![DVec3::ZERO; lattice.node_count()],
            ..Motion::default()
        };
        motion.weigh(lattice);
        motion
    }

    /// Updates the masses of the nodes, after some were added as copies of `originals`.
    pub fn split(&mut self, lattice: &Lattice, originals: &[u32]) {
        for &original in originals {
            self.positions.push(self.positions[original as usize]);
            self.velocities.push(self.velocities[original as usize]);
        }
        self.weigh(lattice);
    }

    /// Stops the nodes without remaining cells.
    pub fn cut(&mut self, lattice: &Lattice) {
        let held = self.velocities.iter_mut().zip(&lattice.held).filter(|(_, held)| **held);
        held.for_each(|(velocity, _)| *velocity = DVec3::ZERO);
        self.weigh(lattice);
    }

    /// Adds a velocity to the nodes that are not held [scene unit/s].
    pub fn kick(&mut self, by: DVec3) {
        let free = self.velocities.iter_mut().zip(&self.inverse).filter(|(_, inverse)| **inverse > 0.0);
        free.for_each(|(velocity, _)| *velocity += by);
    }

    fn weigh(&mut self, lattice: &Lattice) {
        let masses = lattice.masses.iter().zip(&lattice.held);
        self.inverse.clear();
        self.inverse.extend(masses.map(|(&mass, &held)| if held || !(mass > 0.0) { 0.0 } else { 1.0 / mass }));
        self.accelerations.clear();
    }
}

/// External accelerations [scene unit/s²], given the time within the steps [s], positions and velocities; written to
/// the last argument.
pub trait Outside: FnMut(f64, &[DVec3], &[DVec3], &mut [DVec3]) {}
impl<F: FnMut(f64, &[DVec3], &[DVec3], &mut [DVec3])> Outside for F {}

impl Lattice {
    /// Takes `count` steps of `h` [s]; returns the largest ratio of a spring's length to its rest length [–].
    pub fn advance(&self, motion: &mut Motion, scheme: Scheme, h: f64, count: u64, mut outside: impl Outside) -> f64 {
        let mut largest: f64 = 0.0;
        let n = self.node_count();
        let Motion { positions, velocities, accelerations, inverse, predicted, forces, lanes } = motion;
        let mut evaluate =
            |t: f64, positions: &[DVec3], velocities: &[DVec3], into: &mut Vec<DVec3>, inverse: &[f64]| {
                largest = largest.max(lanes.pull(&self.groups, self.damping, positions, velocities, forces));
                into.resize(n, DVec3::ZERO);
                outside(t, positions, velocities, into);
                for ((acceleration, force), &inverse) in into.iter_mut().zip(forces.iter()).zip(inverse) {
                    *acceleration = if inverse == 0.0 { DVec3::ZERO } else { *acceleration + *force * inverse };
                }
            };
        match scheme {
            Scheme::Verlet => {
                if accelerations.len() != n {
                    evaluate(0.0, positions, velocities, accelerations, inverse);
                }
                for step in 0..count {
                    predicted.clear();
                    for ((position, velocity), acceleration) in
                        positions.iter_mut().zip(velocities.iter_mut()).zip(accelerations.iter())
                    {
                        let kick = *acceleration * (0.5 * h);
                        *velocity += kick;
                        *position += *velocity * h;
                        predicted.push(*velocity + kick);
                    }
                    evaluate((step + 1) as f64 * h, positions, predicted, accelerations, inverse);
                    for (velocity, acceleration) in velocities.iter_mut().zip(accelerations.iter()) {
                        *velocity += *acceleration * (0.5 * h);
                    }
                }
            }
            Scheme::Euler => {
                for step in 0..count {
                    evaluate(step as f64 * h, positions, velocities, accelerations, inverse);
                    for ((position, velocity), acceleration) in
                        positions.iter_mut().zip(velocities.iter_mut()).zip(accelerations.iter())
                    {
                        *velocity += *acceleration * h;
                        *position += *velocity * h;
                    }
                }
                accelerations.clear();
            }
        }
        largest
    }
}
