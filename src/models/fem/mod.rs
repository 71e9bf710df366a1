//! Linear finite elements (2.1.2, (2.1)): F = K δ on tetrahedra in the cells of a body.
//!
//! Each cell is cut into six tetrahedra. Displacements are linear in each, so its strain and stress are constant. The cut has a
//! direction: a scene that is turned by 90° differs by up to 2 % of a radius with 6 cells.
//!
//! ```text
//! K = Σ V Bᵀ D B        σ = λ tr(ε) 1 + 2μ ε
//! ```
//!
//! A body on a prescribed path is held at the nodes of its core, so K is positive definite for the others.
//!
//! # Motion
//! (2.1) is an equilibrium. Dynamics needs M δ″ + C δ′ + K δ = F, with lumped masses M and C = γK, γ = 2κ/ω², so that a
//! mode with the scene's ω decays at its κ. The implicit midpoint rule solves, for the mean velocity v of a step h,
//!
//! ```text
//! A v = M u + (h/2)(F − K δ),   A = M + (h/2) C + (h²/4) K
//! δ ← δ + h v,   u ← 2v − u
//! ```
//!
//! It is second order, except where a path turns sharply inside a step (the mean acceleration acts there) and for free
//! bodies (their frame turns once per step, to remove the torque of linear forces): both are errors of first order. It
//! conserves the energy of an undamped body on a path; that of a free body drifts by about 1e-4 in 3 s. It has no step
//! limit. A is constant as long as the body's topology is, so it is factored once, as 2.1.2 proposes for K (Hirota and
//! Kaneko; Cotin et al.). That makes the method fast, but rules out tearing: where stress exceeds a limit, the body is
//! only reported to [would tear](Element::tensions).
//!
//! # Factor or inverse
//! A precomputed A⁻¹ takes 9n² multiplications per step for n free nodes, L D Lᵀ 18 per block. Measured on one core (µs
//! per solution), for spheres with this many cells along a diameter:
//!
//! | cells | free nodes | blocks of L | inverse | factor |
//! | --- | --- | --- | --- | --- |
//! | 2 | 26 | 174 | 1.1 | 0.9 |
//! | 3 | 56 | 559 | 4.9 | 2.3 |
//! | 4 | 118 | 1,982 | 23 | 8.5 |
//! | 6 | 292 | 8,516 | 146 | 34 |
//! | 8 | 580 | 25,635 | 2,500 | 204 |
//!
//! The inverse is never faster, so only the factor is used.
//!
//! # Constants from the scene
//! Young's modulus is that of the lattice, [`Constants::of`](super::lattice::Constants::of), unless the scene gives
//! one: a bar one radius long has the scene's ω. Poisson's ratio is 1/4 by default, that of any lattice of springs.

mod element;
mod matrix;

use std::sync::atomic::AtomicBool;

use glam::{DMat3, DVec3};

use super::cells::{Cells, TETRAHEDRA};
use crate::{interrupt::is_raised, model::shape_matching::outer};

pub use element::{Elasticity, cube_stiffness, gradients, largest_eigenvalue};
pub use matrix::{Cholesky, Symmetric, Unfactored, dissection};

/// No node.
const NONE: u32 = u32::MAX;

/// The constant data of a body of finite elements, shared by equal bodies.
#[derive(Clone, Debug)]
pub struct Element {
    /// Elastic constants.
    pub elasticity: Elasticity,
    /// Damping over stiffness, γ [s].
    pub damping: f64,
    /// Side of a cell [scene unit].
    pub size: f64,
    /// The corner nodes of each cell.
    corners: Vec<[u32; 8]>,
    /// Mass of each node, `[node_count]`.
    pub masses: Vec<f64>,
    /// Free nodes in the order of elimination, `[free_count]`.
    pub free: Vec<u32>,
    /// K of the free nodes, in that order.
    pub stiffness: Symmetric,
    /// Gradients of the shape functions of each tetrahedron of a cell [1/scene unit].
    gradients: [[DVec3; 4]; 6],
}

/// The factor of A for one step length.
#[derive(Clone, Debug)]
pub struct Stepper {
    /// Length of the step [s].
    pub h: f64,
    factor: Cholesky,
}

/// The motion of the nodes: displacements and velocities of the free nodes, in the order of elimination.
#[derive(Clone, Debug, Default)]
pub struct Motion {
    /// Displacements δ [scene unit], `[free_count]`.
    pub displacements: Vec<DVec3>,
    /// Velocities [scene unit/s], `[free_count]`.
    pub velocities: Vec<DVec3>,
    scratch: Vec<DVec3>,
}

impl Element {
    /// Elements in `cells` at the scale of a body of the given radius [scene unit] and mass, held at some nodes. `None`
    /// if interrupted.
    pub fn new(
        cells: &Cells,
        radius: f64,
        mass: f64,
        held: &[bool],
        of: impl Fn(f64) -> (Elasticity, f64),
        interrupt: Option<&AtomicBool>,
    ) -> Option<Element> {
        let size = cells.size() * radius;
        let density = mass / (cells.cell_count() as f64 * size * size * size);
        let (elasticity, damping) = of(density);
        let half = 0.5 * f64::from(cells.across);
        let place = |node: u32| ((cells.nodes[node as usize] + 1.0) * half).to_array().map(|x| x.round() as i32);
        let candidates: Vec<u32> = (0..cells.node_count() as u32).filter(|&node| !held[node as usize]).collect();
        let places: Vec<[i32; 3]> = candidates.iter().map(|&node| place(node)).collect();
        let free: Vec<u32> = dissection(&places).into_iter().map(|i| candidates[i as usize]).collect();
        let mut number = vec![NONE; cells.node_count()];
        (0..).zip(&free).for_each(|(i, &node)| number[node as usize] = i);
        let cube = cube_stiffness(elasticity);
        let mut parts = Vec::with_capacity(36 * cells.cell_count());
        for (cell, corners) in cells.corners.iter().enumerate() {
            if cell % 4096 == 0 && is_raised(interrupt) {
                return None;
            }
            for i in 0..8 {
                for j in 0..8 {
                    let [row, column] = [corners[i], corners[j]].map(|node| number[node as usize]);
                    if row != NONE && column != NONE && row >= column {
                        parts.push((row, column, cube[i][j] * size));
                    }
                }
            }
        }
        let stiffness = Symmetric::sum(free.len(), parts, interrupt)?;
        Some(Element {
            elasticity,
            damping,
            size,
            corners: cells.corners.clone(),
            masses: cells.shares().into_iter().map(|share| share * mass).collect(),
            stiffness,
            free,
            gradients: TETRAHEDRA.map(|tetrahedron| gradients(tetrahedron).map(|gradient| gradient / size)),
        })
    }

    /// Factors A for steps of `h` [s], or K, for the equilibrium, if `h` is infinite. The factor may use at most `max`
    /// bytes.
    ///
    /// # Errors
    /// [`Unfactored`].
    pub fn factor(&self, h: f64, max: u64, interrupt: Option<&AtomicBool>) -> Result<Stepper, Unfactored> {
        let mut matrix = self.stiffness.clone();
        if h.is_finite() {
            let factor = 0.5 * h * (self.damping + 0.5 * h);
            matrix.blocks.iter_mut().for_each(|block| *block *= factor);
            for (column, &node) in self.free.iter().enumerate() {
                matrix.blocks[matrix.starts[column]] += DMat3::from_diagonal(DVec3::splat(self.masses[node as usize]));
            }
        }
        Ok(Stepper { h, factor: Cholesky::of(&matrix, max, interrupt)? })
    }

    /// Adds K δ to `forces` [mass · scene unit/s²].
    pub fn forces(&self, displacements: &[DVec3], forces: &mut [DVec3]) {
        self.stiffness.multiply_add(displacements, forces);
    }

    /// The elastic energy ½ δᵀ K δ [mass · scene unit²/s²].
    pub fn energy(&self, displacements: &[DVec3]) -> f64 {
        let mut forces = vec![DVec3::ZERO; displacements.len()];
        self.forces(displacements, &mut forces);
        0.5 * displacements.iter().zip(&forces).map(|(x, f)| x.dot(*f)).sum::<f64>()
    }

    /// Calls `found` for each cell with its index and the largest principal stress of its tetrahedra
    /// [mass/(scene unit · s²)], given the displacements of all nodes.
    pub fn tensions(&self, displacements: &[DVec3], mut found: impl FnMut(usize, f64)) {
        for (cell, corners) in self.corners.iter().enumerate() {
            let of = |(tetrahedron, gradients): (&[usize; 4], &[DVec3; 4])| {
                let mut gradient = DMat3::ZERO;
                for (&corner, &slope) in tetrahedron.iter().zip(gradients) {
                    let x = displacements[corners[corner] as usize];
                    gradient += outer(x, slope);
                }
                largest_eigenvalue(self.elasticity.stress(gradient))
            };
            found(cell, TETRAHEDRA.iter().zip(&self.gradients).map(of).fold(f64::NEG_INFINITY, f64::max));
        }
    }

    /// Upper bound of the memory for this many cells along a diameter, without the factor [bytes].
    pub fn most_memory(across: u32) -> u64 {
        const NODE_BYTES: u64 = 14 * (72 + 4) + 16 + 6 * 24;
        let (cells, nodes) = (u64::from(across).pow(3), (u64::from(across) + 1).pow(3));
        cells * (32 + 36 * 80) + nodes * NODE_BYTES
    }
}

impl Stepper {
    /// Takes a step with `forces`, those at its middle [mass · scene unit/s²], `[free_count]`, which are overwritten.
    pub fn step(&self, element: &Element, motion: &mut Motion, forces: &mut [DVec3]) {
        let half = 0.5 * self.h;
        let Motion { displacements, velocities, scratch } = motion;
        scratch.clear();
        scratch.resize(displacements.len(), DVec3::ZERO);
        element.forces(displacements, scratch);
        for (i, &node) in element.free.iter().enumerate() {
            forces[i] = velocities[i] * element.masses[node as usize] + (forces[i] - scratch[i]) * half;
        }
        self.factor.solve(forces);
        for ((x, u), v) in displacements.iter_mut().zip(velocities).zip(forces) {
            *x += *v * self.h;
            *u = *v * 2.0 - *u;
        }
    }

    /// Turns impulses during a step into the changes of velocity at its end, `[free_count]`.
    pub fn respond(&self, impulses: &mut [DVec3]) {
        self.factor.solve(impulses);
    }

    /// Allocated memory of the factor [bytes].
    pub fn memory(&self) -> usize {
        self.factor.memory()
    }
}

impl Motion {
    /// A body at rest.
    pub fn at_rest(element: &Element) -> Motion {
        let zeros = vec![DVec3::ZERO; element.free.len()];
        Motion { displacements: zeros.clone(), velocities: zeros, scratch: Vec::new() }
    }
}

#[cfg(test)]
mod tests;
