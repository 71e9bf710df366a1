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
    /// Accelerations by friction in the first half of the next step of [`Scheme::Verlet`] [scene unit/s²], `[node_count]`;
    /// empty if there is none.
    pub friction: Vec<DVec3>,
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

/// What acts on a lattice from outside.
pub trait Outside {
    /// Writes the external accelerations [scene unit/s²] at a time within the steps [s], given the positions.
    fn accelerate(&mut self, t: f64, positions: &[DVec3], into: &mut [DVec3]);

    /// Friction changes the velocities at the end of a kick of `h` [s], at a time within the steps [s], given a guess of
    /// what they become.
    fn rub(&mut self, _t: f64, _h: f64, _positions: &[DVec3], _guess: &[DVec3], _velocities: &mut [DVec3]) {}
}

impl<F: FnMut(f64, &[DVec3], &mut [DVec3])> Outside for F {
    fn accelerate(&mut self, t: f64, positions: &[DVec3], into: &mut [DVec3]) {
        self(t, positions, into);
    }
}

impl Lattice {
    /// Takes `count` steps of `h` [s]; returns the largest ratio of a spring's length to its rest length [–].
    pub fn advance<O: Outside>(&self, motion: &mut Motion, scheme: Scheme, h: f64, count: u64, outside: &mut O) -> f64 {
        let mut largest: f64 = 0.0;
        let n = self.node_count();
        let Motion { positions, velocities, accelerations, friction, inverse, predicted, forces, lanes } = motion;
        let mut evaluate = |outside: &mut O,
                            t: f64,
                            positions: &[DVec3],
                            velocities: &[DVec3],
                            into: &mut Vec<DVec3>,
                            inverse: &[f64]| {
            largest = largest.max(lanes.pull(&self.groups, self.damping, positions, velocities, forces));
            into.resize(n, DVec3::ZERO);
            outside.accelerate(t, positions, into);
            for ((acceleration, force), &inverse) in into.iter_mut().zip(forces.iter()).zip(inverse) {
                *acceleration = if inverse == 0.0 { DVec3::ZERO } else { *acceleration + *force * inverse };
            }
        };
        match scheme {
            Scheme::Verlet => {
                if accelerations.len() != n {
                    evaluate(outside, 0.0, positions, velocities, accelerations, inverse);
                }
                if count > 0 {
                    accelerations.iter_mut().zip(friction.iter()).for_each(|(all, friction)| *all += *friction);
                    friction.clear();
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
                    let t = (step + 1) as f64 * h;
                    evaluate(outside, t, positions, predicted, accelerations, inverse);
                    for (velocity, acceleration) in velocities.iter_mut().zip(accelerations.iter()) {
                        *velocity += *acceleration * (0.5 * h);
                    }
                    outside.rub(t, 0.5 * h, positions, predicted, velocities);
                }
            }
            Scheme::Euler => {
                for step in 0..count {
                    let t = step as f64 * h;
                    evaluate(outside, t, positions, velocities, accelerations, inverse);
                    predicted.clone_from(velocities);
                    velocities.iter_mut().zip(accelerations.iter()).for_each(|(u, a)| *u += *a * h);
                    outside.rub(t, h, positions, predicted, velocities);
                    positions.iter_mut().zip(velocities.iter()).for_each(|(s, u)| *s += *u * h);
                }
                accelerations.clear();
            }
        }
        largest
    }
}
