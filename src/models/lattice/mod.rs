//! Masses and springs on a lattice of cubes (2.1.1, Fig. 2.1), and two ways to tear it (2.2.2, Fig. 2.2).
//!
//! A cell has 28 springs: 12 along its edges, 12 along the diagonals of its faces, 4 along those of the cube. Springs
//! on edges and faces are shared with the neighbouring cells; each cell contributes its share of their stiffness, so
//! that a lattice is homogeneous up to its boundary:
//!
//! ```text
//! k_edge : k_face : k_space = 2 : 1 : 3/8        a cell's share: 1/4, 1/2, 1
//! ```
//!
//! These are the proportions of fourth-order isotropic lattices (the weights 16 : 4 : 1 of D3Q27, times the squared
//! lengths 1 : 2 : 3): with k_face = k, C_11 = 9k/2h and C_12 = C_44 = 3k/2h, an isotropic solid with λ = μ. Its Poisson's
//! ratio is 1/4, as for every lattice of central forces (Cauchy); Young's modulus is E = 15k/4h.
//!
//! # Constants from the scene
//! The thesis states that springs describe no physical property (2.1.1). Here they do: E is chosen such that a bar one
//! radius long, held at one end, has the scene's ω as its lowest frequency, ω = (π/2R) √(E/ρ), so
//!
//! ```text
//! E = ρ c²,   c = 2ωR/π          k = 4Eh/15
//! ```
//!
//! with ρ the mass over the volume of the cells. Every spring has a parallel damper, of γ = 2κ/ω² times its stiffness:
//! a mode of frequency ω decays at the scene's rate κ, higher ones faster. Springs and dampers are internal: they
//! change neither momentum nor angular momentum.
//!
//! # Step limit
//! Velocity Verlet with damping at a predicted velocity is stable for h < (2/ω_max)(√(1 + (γω_max)²) − γω_max), where
//! its amplification factor reaches −1. No mode of a lattice is faster than that of a single free cell (Irons' bound),
//! √(30 k/m) for a cell of mass m: ω_max ≤ √8 c/h. Stretched springs raise it by at most 9/5, the ratio to Gershgorin's
//! bound, which holds for any deformation under tension.
//!
//! # Surfaces
//! A body is drawn with its mesh until it tears, then with the boundary of its cells, which protrude from the mesh: its
//! volume and area rise at that instant.

mod lanes;
mod step;
mod tear;

use std::sync::atomic::AtomicBool;

use glam::DVec3;

use super::cells::Cells;
use crate::interrupt::is_raised;

use lanes::{Group, group};
pub use step::{Motion, Outside, Scheme};

/// Stiffness of a cell's share of a spring, over k: along an edge, a quarter of 2; along the diagonal of a face, half
/// of 1; along that of the cube, 3/8.
const SHARES: [f64; 3] = [0.5, 0.5, 0.375];
/// The highest squared frequency of a free cell, times its mass over k.
const CELL_MODE: f64 = 30.0;

/// The elastic constants of a body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Constants {
    /// Young's modulus E [mass/(scene unit · s²)].
    pub young: f64,
    /// Damping over stiffness, γ [s].
    pub damping: f64,
}

impl Constants {
    /// The constants of a body of the given radius [scene unit] and density [mass/scene unit³], for the scene's ω
    /// [rad/s], > 0, and κ [1/s].
    pub fn of(omega: f64, damping: f64, radius: f64, density: f64) -> Constants {
        let speed = omega * radius / std::f64::consts::FRAC_PI_2;
        Constants { young: density * speed * speed, damping: 2.0 * damping / (omega * omega) }
    }
}

/// A spring with a damper.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spring {
    /// Index of one node …
    pub a: u32,
    /// … and of the other.
    pub b: u32,
    /// Rest length [scene unit].
    pub rest: f64,
    /// Stiffness [mass/s²].
    pub stiffness: f64,
}

/// Masses and springs. Positions and velocities of the nodes are in [`Motion`].
#[derive(Clone, Debug)]
pub struct Lattice {
    /// The corner nodes of each cell, `[cell_count]`.
    pub corners: Vec<[u32; 8]>,
    /// Whether each cell is intact, `[cell_count]`.
    pub is_whole: Vec<bool>,
    /// Rest positions of the nodes [scene unit], `[node_count]`.
    pub rest: Vec<DVec3>,
    /// Mass of each node, `[node_count]`.
    pub masses: Vec<f64>,
    /// Whether each node is held in place, `[node_count]`.
    pub held: Vec<bool>,
    /// Side of a cell [scene unit].
    pub size: f64,
    groups: Vec<Group>,
    spring_count: usize,
    /// Stiffness k of a spring along a diagonal of a face between two cells [mass/s²].
    pub stiffness: f64,
    /// Damping over stiffness, γ [s].
    pub damping: f64,
    /// Mass of each cell, `[cell_count]`.
    pub cell_masses: Vec<f64>,
    /// Mass of the lightest cell.
    lightest: f64,
    keys: Vec<(u64, u32)>,
}

impl Lattice {
    /// The lattice on `cells` at the scale of a body of the given radius [scene unit] and mass. `None` if interrupted.
    pub fn new(
        cells: &Cells,
        radius: f64,
        mass: f64,
        held: Vec<bool>,
        of: impl Fn(f64) -> Constants,
        interrupt: Option<&AtomicBool>,
    ) -> Option<Lattice> {
        let size = cells.size() * radius;
        let density = mass / (cells.cell_count() as f64 * size * size * size);
        let Constants { young, damping } = of(density);
        let cell_masses: Vec<f64> = cells.weights.iter().map(|weight| weight * mass).collect();
        let mut lattice = Lattice {
            corners: cells.corners.clone(),
            is_whole: vec![true; cells.cell_count()],
            rest: cells.nodes.iter().map(|&node| node * radius).collect(),
            masses: cells.shares().into_iter().map(|share| share * mass).collect(),
            held,
            size,
            groups: Vec::new(),
            spring_count: 0,
            stiffness: 4.0 * young * size / 15.0,
            damping,
            lightest: cell_masses.iter().copied().fold(f64::INFINITY, f64::min),
            cell_masses,
            keys: Vec::new(),
        };
        lattice.connect(interrupt)?;
        Some(lattice)
    }

    /// Number of nodes.
    pub fn node_count(&self) -> usize {
        self.rest.len()
    }

    /// Young's modulus [mass/(scene unit · s²)].
    pub fn young(&self) -> f64 {
        3.75 * self.stiffness / self.size
    }

    /// Rebuilds the springs of all intact cells. `None` if interrupted.
    fn connect(&mut self, interrupt: Option<&AtomicBool>) -> Option<()> {
        /// Nodes whose springs are sorted together.
        const STRETCH: usize = 1 << 16;
        let Lattice { corners, is_whole, keys, rest, .. } = self;
        let check = || (!is_raised(interrupt)).then_some(());
        let whole =
            || corners.iter().zip(is_whole.iter()).filter(|(_, is_whole)| **is_whole).map(|(corners, _)| corners);
        let pairs = |corners: &[u32; 8], found: &mut dyn FnMut(u32, u32, u32)| {
            for i in 0..8usize {
                for j in 0..i {
                    let (a, b) = (corners[i].min(corners[j]), corners[i].max(corners[j]));
                    found(a, b, (i ^ j).count_ones() - 1);
                }
            }
        };
        // by ranges of first nodes, each small enough to be sorted between two checks of the interrupt
        let mut ends = vec![0usize; rest.len() / STRETCH + 2];
        for (number, corners) in whole().enumerate() {
            if number % STRETCH == 0 {
                check()?;
            }
            pairs(corners, &mut |a, _, _| ends[a as usize / STRETCH + 1] += 1);
        }
        for stretch in 1..ends.len() {
            ends[stretch] += ends[stretch - 1];
        }
        let mut next = ends.clone();
        keys.clear();
        keys.resize(ends[ends.len() - 1], (0, 0));
        for (number, corners) in whole().enumerate() {
            if number % STRETCH == 0 {
                check()?;
            }
            pairs(corners, &mut |a, b, kind| {
                let at = &mut next[a as usize / STRETCH];
                keys[*at] = (u64::from(a) << 32 | u64::from(b), kind);
                *at += 1;
            });
        }
        let stiffness = self.stiffness;
        let spring = |same: &[(u64, u32)]| {
            let (key, kind) = same[0];
            let (a, b) = ((key >> 32) as u32, key as u32);
            let stiffness = SHARES[kind as usize] * stiffness * same.len() as f64;
            // bit-identical to the length computed for the force at rest, so that the force is exactly zero there
            Spring { a, b, rest: (rest[b as usize] - rest[a as usize]).length(), stiffness }
        };
        self.groups.clear();
        self.spring_count = 0;
        for ends in ends.windows(2) {
            check()?;
            let keys = &mut keys[ends[0]..ends[1]];
            keys.sort_unstable();
            let springs: Vec<Spring> = keys.chunk_by(|x, y| x.0 == y.0).map(spring).collect();
            self.spring_count += springs.len();
            group(springs, &mut self.groups);
        }
        Some(())
    }

    /// The springs.
    pub fn springs(&self) -> impl Iterator<Item = Spring> + '_ {
        self.groups.iter().flat_map(Group::springs)
    }

    /// Number of springs.
    pub fn spring_count(&self) -> usize {
        self.spring_count
    }

    /// The longest stable step [s], with external accelerations whose derivative is at most `outside` [1/s²].
    pub fn step_limit(&self, outside: f64) -> f64 {
        let square = CELL_MODE * self.stiffness / self.lightest;
        let fastest = (square + outside).sqrt();
        let ratio = self.damping * square / fastest;
        // (√(1 + z²) − z) without cancellation
        2.0 / (fastest * ((1.0 + ratio * ratio).sqrt() + ratio))
    }

    /// Writes the forces of springs and of dampers on the nodes [mass · scene unit/s²] to `forces` and `drags`.
    pub fn forces(&self, positions: &[DVec3], velocities: &[DVec3], forces: &mut Vec<DVec3>, drags: &mut Vec<DVec3>) {
        for sums in [&mut *forces, &mut *drags] {
            sums.clear();
            sums.resize(self.node_count(), DVec3::ZERO);
        }
        for Spring { a, b, rest, stiffness } in self.springs() {
            let (a, b) = (a as usize, b as usize);
            let along = positions[b] - positions[a];
            let length = along.length();
            let direction = if length > 0.0 { along / length } else { DVec3::ZERO };
            let force = direction * (stiffness * (length - rest));
            let drag = direction * (stiffness * self.damping * direction.dot(velocities[b] - velocities[a]));
            forces[a] += force;
            forces[b] -= force;
            drags[a] += drag;
            drags[b] -= drag;
        }
    }

    /// The elastic energy [mass · scene unit²/s²].
    pub fn energy(&self, positions: &[DVec3]) -> f64 {
        let of = |spring: Spring| {
            let stretch = positions[spring.b as usize].distance(positions[spring.a as usize]) - spring.rest;
            0.5 * spring.stiffness * stretch * stretch
        };
        self.springs().map(of).sum()
    }

    /// Fraction of the volume lost by tearing [–].
    pub fn lost(&self) -> f64 {
        self.is_whole.iter().filter(|is_whole| !**is_whole).count() as f64 / self.is_whole.len() as f64
    }

    /// Upper bound of the memory of a lattice with this many cells along a diameter [bytes]; if it can be split, with
    /// all cells separate, each with its own nodes.
    pub fn most_memory(across: u32, can_split: bool) -> u64 {
        const NODE_BYTES: u64 = 24 * 8 + 9 * 8;
        const KEY_BYTES: u64 = 28 * 16;
        let (cells, row) = (u64::from(across).pow(3), u64::from(across) + 1);
        let (springs, nodes) = if can_split { (28 * cells, 8 * cells) } else { (13 * row.pow(3), row.pow(3)) };
        let groups = if can_split { springs } else { 13 * row * row * row.div_ceil(lanes::GROUP as u64) };
        let sizes = [size_of::<Spring>(), size_of::<Group>()].map(|size| size as u64);
        cells * (41 + KEY_BYTES) + springs * sizes[0] + groups * sizes[1] + nodes * NODE_BYTES
    }
}

#[cfg(test)]
mod tests;
