//! Bodies as cubes of a regular grid: the cells that cover a closed mesh, their corner nodes, and the mesh's vertices
//! embedded in them. Lattices and finite elements share them.
//!
//! Lengths are in radii of the body: all bodies of a shape share one set of cells. The grid spans [−1, 1]³ around the
//! centre of the body, with [`Cells::across`] cells along each axis. A cell belongs to the body if the surface passes
//! through it or if its centre is inside: the cells cover the body, and protrude from it by less than a cell. All cells
//! have the same mass, an eighth of it at each corner (2.1.1: "each cell has a uniform mass"). If the mass centre of
//! the nodes would then differ from that of the mesh, which is the body's centre, a linear density gradient corrects
//! it, and no cell gets less than a fifth of the mean. Nodes and cells are in ascending order of z, y, x, so the result
//! depends on the mesh alone.

mod boundary;
mod cover;

use std::sync::atomic::AtomicBool;

use glam::{DMat3, DVec3};

use crate::{
    disjoint_sets::DisjointSets,
    geometry::Mesh,
    interrupt::is_raised,
    model::shape_matching::{outer, solve},
};

pub use boundary::{BoundaryMesh, boundary};

/// The offset of corner `i` of a cell: bit 0 is x, bit 1 is y, bit 2 is z.
#[inline]
pub fn corner(i: usize) -> DVec3 {
    DVec3::new((i & 1) as f64, (i >> 1 & 1) as f64, (i >> 2 & 1) as f64)
}

/// The corners of the six tetrahedra of a cell, positively oriented: the paths from corner 0 to corner 7 along the three
/// axes in every order (Kuhn). All share the diagonal, and match across the faces of neighbouring cells.
pub const TETRAHEDRA: [[usize; 4]; 6] =
    [[0, 1, 3, 7], [0, 2, 6, 7], [0, 4, 5, 7], [0, 3, 2, 7], [0, 6, 4, 7], [0, 5, 1, 7]];

/// Cells of a regular grid, their nodes, and points embedded in them.
#[derive(Clone, Debug, PartialEq)]
pub struct Cells {
    /// Number of cells along a diameter; a cell has sides of 2/across [radii].
    pub across: u32,
    /// Rest positions of the nodes [radii], `[node_count]`.
    pub nodes: Vec<DVec3>,
    /// The corner nodes of each cell, in the order of [`corner`], `[cell_count]`.
    pub corners: Vec<[u32; 8]>,
    /// Fraction of the body's mass in each cell [–], `[cell_count]`; the sum is 1.
    pub weights: Vec<f64>,
    /// Grid coordinates of each cell, `[cell_count]`.
    pub places: Vec<[u32; 3]>,
    /// Cell and weights of each surface vertex, `[vertex_count]`.
    pub embedded: Vec<Embedded>,
}

/// A point in a cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Embedded {
    /// Index of the cell.
    pub cell: u32,
    /// Trilinear weights of its corners [–]; their sum is 1.
    pub weights: [f64; 8],
}

impl Embedded {
    /// The point at `place` within a cell, from 0 to 1 along each axis; points slightly outside are extrapolated.
    pub fn at(cell: u32, place: DVec3) -> Embedded {
        let weights = std::array::from_fn(|i| {
            let along = |axis: usize| if i >> axis & 1 == 1 { place[axis] } else { 1.0 - place[axis] };
            along(0) * along(1) * along(2)
        });
        Embedded { cell, weights }
    }

    /// The weighted mean of a quantity of the cell's corners.
    #[inline]
    pub fn mean(&self, corners: &[u32; 8], of: &[DVec3]) -> DVec3 {
        let mut sum = DVec3::ZERO;
        for (&node, &weight) in corners.iter().zip(&self.weights) {
            sum += of[node as usize] * weight;
        }
        sum
    }
}

impl Cells {
    /// The cells that cover a mesh of radius 1, `across` along its diameter. `None` if interrupted.
    pub fn cover(mesh: &Mesh, across: u32, interrupt: Option<&AtomicBool>) -> Option<Cells> {
        let inside = cover::cover(mesh, across, interrupt)?;
        let n = across as usize;
        let places = (0..n * n * n).filter(|&at| inside[at]);
        let places = places.map(|at| [at % n, at / n % n, at / (n * n)].map(|i| i as u32)).collect();
        let mut cells = Cells::of(across, places);
        let mut index = vec![u32::MAX; n * n * n];
        for (cell, &place) in (0..).zip(&cells.places) {
            index[flat(place, n)] = cell;
        }
        cells.embedded.reserve_exact(mesh.vertex_count());
        for position in mesh.positions().iter() {
            if is_raised(interrupt) {
                return None;
            }
            cells.embedded.push(embed(position, n, &index, &cells.places)?);
        }
        Some(cells)
    }

    /// A block of cells (a bar, a chain) at the lowest corner of the grid.
    pub fn block(across: u32, [x, y, z]: [u32; 3]) -> Cells {
        let mut places = Vec::new();
        for k in 0..z {
            for j in 0..y {
                places.extend((0..x).map(|i| [i, j, k]));
            }
        }
        Cells::of(across, places)
    }

    /// The cells at the given grid coordinates, in ascending order of z, y, x.
    fn of(across: u32, places: Vec<[u32; 3]>) -> Cells {
        // a sorted list of the corners, so that memory is proportional to the cells, not to the grid
        let key = |place: [u32; 3], i: usize| {
            let at = |axis: usize| u64::from(place[axis]) + (i >> axis & 1) as u64;
            at(2) << 42 | at(1) << 21 | at(0)
        };
        let mut keys: Vec<u64> = places.iter().flat_map(|&place| (0..8).map(move |i| key(place, i))).collect();
        keys.sort_unstable();
        keys.dedup();
        let h = 2.0 / f64::from(across);
        let coordinate = |key: u64, axis: u32| (key >> (21 * axis) & 0x1f_ffff) as f64 * h - 1.0;
        let nodes = keys.iter().map(|&key| DVec3::new(coordinate(key, 0), coordinate(key, 1), coordinate(key, 2)));
        let nodes = nodes.collect();
        let node = |place, i| keys.partition_point(|&other| other < key(place, i)) as u32;
        let corners = places.iter().map(|&place| std::array::from_fn(|i| node(place, i))).collect();
        drop(keys); // the weights need as much
        let weights = weights(&places, across);
        Cells { across, nodes, corners, weights, places, embedded: Vec::new() }
    }

    /// The side of a cell [radii].
    pub fn size(&self) -> f64 {
        2.0 / f64::from(self.across)
    }

    /// Number of nodes.
    pub fn node_count(&self) -> usize {
        self.nodes.len()
    }

    /// Number of cells.
    pub fn cell_count(&self) -> usize {
        self.corners.len()
    }

    /// Fraction of the body's mass at each node [–], `[node_count]`; the sum is 1.
    pub fn shares(&self) -> Vec<f64> {
        let mut shares = vec![0.0; self.nodes.len()];
        for (corners, weight) in self.corners.iter().zip(&self.weights) {
            corners.iter().for_each(|&node| shares[node as usize] += 0.125 * weight);
        }
        shares
    }

    /// The mass centre of the nodes [radii]: that of the body, unless no densities of the cells move it there.
    pub fn mass_centre(&self) -> DVec3 {
        self.nodes.iter().zip(self.shares()).map(|(&node, share)| node * share).sum()
    }

    /// The nodes that hold a body on a prescribed path: those within `radius` of its centre [radii], and for every
    /// connected component without such nodes, the corners of its cell nearest to the centre.
    pub fn core(&self, radius: f64) -> Vec<bool> {
        let mut held: Vec<bool> = self.nodes.iter().map(|node| node.length() <= radius).collect();
        let part = self.parts();
        let mut has_core = vec![false; part.iter().map(|&part| part as usize + 1).max().unwrap_or(0)];
        let mut nearest = vec![(f64::INFINITY, 0); has_core.len()];
        for (cell, corners) in self.corners.iter().enumerate() {
            let part = part[cell] as usize;
            has_core[part] |= corners.iter().any(|&node| held[node as usize]);
            let centre: DVec3 = corners.iter().map(|&node| self.nodes[node as usize]).sum::<DVec3>() / 8.0;
            let distance = centre.length();
            if distance < nearest[part].0 {
                nearest[part] = (distance, cell);
            }
        }
        for (_, (_, cell)) in has_core.iter().zip(&nearest).filter(|(has_core, _)| !**has_core) {
            self.corners[*cell].iter().for_each(|&node| held[node as usize] = true);
        }
        held
    }

    /// The connected component of each cell, `[cell_count]`: cells that share a node are connected.
    fn parts(&self) -> Vec<u32> {
        const NONE: u32 = u32::MAX;
        let mut sets = DisjointSets::singletons(self.cell_count());
        let mut first = vec![NONE; self.nodes.len()];
        for (cell, corners) in (0..).zip(&self.corners) {
            for &node in corners {
                let other = first[node as usize];
                if other == NONE {
                    first[node as usize] = cell;
                } else {
                    sets.join(other, cell);
                }
            }
        }
        let mut number = vec![NONE; self.cell_count()];
        let mut count = 0;
        let number_of = |least: u32| {
            let number = &mut number[least as usize];
            if *number == NONE {
                *number = count;
                count += 1;
            }
            *number
        };
        sets.all_least().into_iter().map(number_of).collect()
    }

    /// Upper bound of the memory to cover a mesh with this many vertices, for a body that fills the grid [bytes].
    pub fn most_memory(across: u32, vertices: u64) -> u64 {
        const GRID_BYTES: u64 = 9; // inside flag, winding number, index
        const CELL_BYTES: u64 = 8 * 8 + 32 + 12 + 8; // keys of the corners, corners, place, weight
        let across = u64::from(across);
        let cells = across * across * across;
        let nodes = (across + 1) * (across + 1) * (across + 1);
        cells * (GRID_BYTES + CELL_BYTES) + nodes * size_of::<DVec3>() as u64 + vertices * size_of::<Embedded>() as u64
    }
}

/// The smallest fraction of the mass in a cell [that of the mean].
const LEAST: f64 = 0.2;
/// A mass centre this close to the centre of the grid is there, but for rounding [radii].
pub const BALANCED: f64 = 1e-9;

/// Fractions of the mass in cells at the given grid coordinates: equal if their mass centre is then at the centre of the grid,
/// or if no others move it there.
fn weights(places: &[[u32; 3]], across: u32) -> Vec<f64> {
    let (mean, h) = (1.0 / places.len() as f64, 2.0 / f64::from(across));
    let centre = |place: &[u32; 3]| (DVec3::from_array(place.map(f64::from)) + 0.5) * h - 1.0;
    let is_off = (places.iter().map(centre).sum::<DVec3>() * mean).length() > BALANCED;
    let balanced = || balanced(&places.iter().map(centre).collect::<Vec<_>>());
    is_off.then(balanced).flatten().unwrap_or_else(|| vec![mean; places.len()])
}

/// Fractions of the mass in cells with these centres that are close to their mean, at least [`LEAST`] of it, and have their mass
/// centre at the origin: linear, except where that would be too little. `None` if none are found: the cells lie on one side.
fn balanced(centres: &[DVec3]) -> Option<Vec<f64>> {
    /// Spreads smaller than this are none [that of all].
    const FLAT: f64 = 1e-12;

    let least = LEAST / centres.len() as f64;
    let mut is_light = vec![false; centres.len()];
    loop {
        let all = || centres.iter().copied().zip(&is_light);
        let linear = || all().filter(|(_, is_light)| !**is_light).map(|(centre, _)| centre);
        let count = linear().count();
        if count == 0 {
            return None;
        }
        let (mut left, mut wanted) = (1.0, DVec3::ZERO);
        for (centre, _) in all().filter(|(_, is_light)| **is_light) {
            left -= least;
            wanted -= least * centre;
        }
        let middle = linear().sum::<DVec3>() / count as f64;
        let mut spread = DMat3::ZERO;
        linear().for_each(|centre| spread += outer(centre - middle, centre - middle));
        // cells in one plane cannot be moved out of it
        let extent = spread.x_axis.x + spread.y_axis.y + spread.z_axis.z;
        let moment = wanted - left * middle;
        let slope = solve(spread + DMat3::from_diagonal(DVec3::splat(FLAT * extent)), moment);
        if !((spread * slope - moment).length() < BALANCED) {
            return None;
        }
        let weight = |centre: DVec3| left / count as f64 + slope.dot(centre - middle);
        let weights: Vec<f64> =
            all().map(|(centre, is_light)| if *is_light { least } else { weight(centre) }).collect();
        let is_too_light = |weight: &f64| *weight < least;
        if !weights.iter().any(is_too_light) {
            return Some(weights);
        }
        is_light.iter_mut().zip(&weights).for_each(|(is_light, weight)| *is_light |= is_too_light(weight));
    }
}

/// Index of a cell in an array of the whole grid.
fn flat([x, y, z]: [u32; 3], n: usize) -> usize {
    (z as usize * n + y as usize) * n + x as usize
}

/// Finds the cell of a point; on a face between two cells, one that is part of the body. `None` if the body has no cell
/// there, which cannot happen for points of its surface.
fn embed(position: DVec3, n: usize, index: &[u32], places: &[[u32; 3]]) -> Option<Embedded> {
    let scaled = (position + 1.0) * (0.5 * n as f64);
    let mut best: Option<(f64, u32)> = None;
    let clamp = |value: f64| value.clamp(0.0, n as f64 - 1.0) as i64;
    let home = [scaled.x, scaled.y, scaled.z].map(|value| clamp(value.floor()));
    for dz in -1..=1 {
        for dy in -1..=1 {
            for dx in -1..=1 {
                let place = [home[0] + dx, home[1] + dy, home[2] + dz];
                if place.iter().any(|&i| i < 0 || i >= n as i64) {
                    continue;
                }
                let cell = index[flat(place.map(|i| i as u32), n)];
                if cell == u32::MAX {
                    continue;
                }
                let low = DVec3::new(place[0] as f64, place[1] as f64, place[2] as f64);
                let outside = (low - scaled).max(scaled - low - 1.0).max(DVec3::ZERO).length_squared();
                if best.is_none_or(|(least, _)| outside < least) {
                    best = Some((outside, cell));
                }
            }
        }
    }
    let (_, cell) = best?;
    let low = DVec3::from_array(places[cell as usize].map(f64::from));
    Some(Embedded::at(cell, scaled - low))
}

#[cfg(test)]
mod tests;
