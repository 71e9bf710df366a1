//! General position: the perturbed bodies on which predicates are evaluated.
//!
//! Bodies often touch, coincide or are aligned: scenes along the axes, copies, stacks. The predicates therefore see
//! every body deflated by a small amount of its own, and every vertex displaced by a hundredth of that, pseudo-randomly
//! but reproducibly. Bodies in contact are then apart, one of two identical bodies is inside the other, and
//! degeneracies such as four coplanar points do not occur; if one does, everything is repeated with other
//! displacements. The result has the true positions.

use glam::DVec3;

use super::{
    bits::Bits,
    body::{Aabb, Body},
    candidates::Meeting,
    sweep::body_pairs,
};
use crate::random::Random;

/// Largest random displacement, relative to a body's scale.
const JITTER: f64 = 1.0 / (1u64 << 36) as f64;
/// Largest random displacement, relative to the scene's scale: the resolution of its coordinates.
const SCENE_JITTER: f64 = 1.0 / (1u64 << 47) as f64;
/// Deflation over jitter.
const DEFLATION: f64 = 64.0;
/// Number of distinct deflations. Where more bodies than this overlap, some are deflated equally.
const COLOURS: u32 = 64;
/// Smallest ratio of a body's size to its jitter; smaller bodies are left out.
const SMALLEST: f64 = (1u64 << 20) as f64;
/// Coordinates are multiples of 1 over this, with the scene within ±1. So polynomials of degree 12, the highest in use,
/// neither under- nor overflow, and their expansions are exact.
const LATTICE: f64 = (1u64 << 60) as f64;

/// The bodies of a union, perturbed.
pub struct Placement<'a, 'b> {
    pub bodies: Vec<&'b Body<'a>>,
    /// Indices of the given bodies that are kept: bodies too small to be resolved are left out.
    pub kept: Vec<u32>,
    /// Number of bodies left out.
    pub dropped: usize,
    /// First vertex, edge and triangle of each body, in numbers that are unique over all bodies, followed by the
    /// totals.
    pub first_vertex: Vec<u32>,
    pub first_edge: Vec<u32>,
    pub first_triangle: Vec<u32>,
    /// Pairs with overlapping boxes, ascending.
    pub pairs: Vec<[u32; 2]>,
    /// Bound on the displacement of any vertex of a body [scene unit].
    pub displaced: Vec<f64>,
    /// Whether each body is to be tested against itself.
    pub folds: Vec<bool>,
    /// The triangles that are known to lie inside another body.
    buried: Bits,
    /// For every body, whether each block has triangles that are not buried, and a box of these blocks; empty if
    /// `buried` is.
    shown: Vec<(Vec<bool>, Aabb)>,
    /// For every vertex, its index in `positions`; 0 for vertices that have not been placed ([`Placement::place`]),
    /// which are most of a large mesh.
    slots: Vec<u32>,
    /// Positions as the predicates see them.
    positions: Vec<DVec3>,
    scale: f64,
    jitter: Vec<f64>,
    deflation: Vec<f64>,
    seed: u64,
}

impl<'a, 'b> Placement<'a, 'b> {
    /// Places `bodies`, given in an order that depends on them alone. Each attempt uses different displacements.
    pub fn new(bodies: Vec<&'b Body<'a>>, attempt: u32) -> Self {
        let farthest =
            bodies.iter().map(|b| b.bounds.min.abs().max(b.bounds.max.abs()).max_element()).fold(0.0, f64::max);
        // a power of two, so that scaling does not round
        let scale = 1.0 / power_of_two_above(farthest);
        let jitter_of = |body: &Body| (JITTER * power_of_two_above(body.radius * scale)).max(SCENE_JITTER);
        let given = bodies.len();
        let is_resolved = |body: &Body| body.radius * scale > SMALLEST * jitter_of(body);
        let kept: Vec<u32> = (0..given as u32).filter(|&b| is_resolved(bodies[b as usize])).collect();
        let bodies: Vec<&Body> = kept.iter().map(|&b| bodies[b as usize]).collect();
        let jitter: Vec<f64> = bodies.iter().map(|b| jitter_of(b)).collect();

        let max = DEFLATION * f64::from(2 * COLOURS + 1) + 4.0;
        let displaced: Vec<f64> = jitter.iter().map(|j| j * max / scale).collect();
        let boxes: Vec<Aabb> = bodies.iter().zip(&displaced).map(|(b, d)| b.bounds.grown(*d)).collect();
        let pairs = body_pairs(&boxes);
        // odd multiples, so that different colours deflate differently at any ratio of the bodies' scales
        let deflation: Vec<f64> = (jitter.iter().zip(colours(bodies.len(), &pairs)))
            .map(|(j, colour)| j * DEFLATION * f64::from(2 * (colour % COLOURS) + 1))
            .collect();
        let folds = (0..bodies.len()).map(|b| bodies[b].slack() <= (deflation[b] + 4.0 * jitter[b]) / scale).collect();

        let ends = |count: &dyn Fn(&Body) -> usize| {
            let mut sum = 0;
            std::iter::once(0)
                .chain(bodies.iter().map(|b| {
                    sum += count(b) as u32;
                    sum
                }))
                .collect::<Vec<u32>>()
        };
        let first_vertex = ends(&|b| b.topology.fan_count());
        let vertices = first_vertex[bodies.len()] as usize;
        Placement {
            first_vertex,
            first_edge: ends(&|b| b.topology.edges.len()),
            first_triangle: ends(&|b| b.topology.triangles.len()),
            pairs,
            displaced,
            folds,
            buried: Bits::default(),
            shown: Vec::new(),
            slots: vec![0; vertices],
            positions: vec![DVec3::ZERO],
            scale,
            jitter,
            deflation,
            seed: u64::from(attempt),
            dropped: given - kept.len(),
            kept,
            bodies,
        }
    }

    /// Marks the triangles that lie inside the largest ball about the centre of another body. No part of them bounds
    /// the union: they need not be cut, and intersections of two of them do not matter. Triangles of bodies that may
    /// intersect themselves are not marked, because computing such a body's own winding numbers requires all of its
    /// triangles.
    pub fn bury(&mut self, meetings: &[Meeting]) {
        let mut buried = Bits::new(self.first_triangle[self.bodies.len()] as usize);
        let mut shown: Vec<Vec<bool>> = self.bodies.iter().map(|body| vec![true; body.block_bounds.len()]).collect();
        let mut is_any = false;
        for meeting in meetings {
            for (k, blocks) in meeting.blocks.iter().enumerate() {
                let (me, other) = (meeting.bodies[k] as usize, meeting.bodies[1 - k] as usize);
                let (mesh, around) = (self.bodies[me], self.bodies[other]);
                let radius = around.inner_radius() * 0.999 - 4.0 * (self.displaced[me] + self.displaced[other]);
                if self.folds[me] || self.folds[other] || radius <= 0.0 {
                    continue;
                }
                let (centre, squared) = (around.centre, radius * radius);
                for &block in blocks {
                    let bounds = &mesh.block_bounds[block as usize];
                    if !shown[me][block as usize]
                        || centre.clamp(bounds.min, bounds.max).distance_squared(centre) >= squared
                    {
                        continue;
                    }
                    let farthest = (bounds.min - centre).abs().max((bounds.max - centre).abs());
                    let is_whole = farthest.length_squared() < squared;
                    let mut is_shown = false;
                    for &t in mesh.topology.block(block as usize) {
                        let is_inside = || mesh.corners(t).iter().all(|at| at.distance_squared(centre) < squared);
                        let global = t + self.first_triangle[me];
                        if is_whole || is_inside() {
                            buried.insert(global);
                            is_any = true;
                        }
                        is_shown |= !buried.contains(global);
                    }
                    shown[me][block as usize] = is_shown;
                }
            }
        }
        if is_any {
            self.buried = buried;
            for (b, shown) in shown.into_iter().enumerate() {
                let bounds = self.bodies[b].block_bounds.iter().zip(&shown);
                let hull = bounds.filter(|(_, shown)| **shown).fold(Aabb::EMPTY, |hull, (block, _)| hull.joined(block));
                self.shown.push((shown, hull));
            }
        }
    }

    /// Whether a block has triangles that do not lie inside another body.
    #[inline]
    pub fn is_block_shown(&self, block: u32, body: u32) -> bool {
        self.shown.get(body as usize).is_none_or(|(shown, _)| shown[block as usize])
    }

    /// A box that contains the true positions of the blocks that [`Self::is_block_shown`].
    pub fn shown_bounds(&self, body: u32) -> Aabb {
        self.shown.get(body as usize).map_or(self.bodies[body as usize].bounds, |(_, hull)| *hull)
    }

    /// Whether a triangle lies inside another body.
    #[inline]
    pub fn is_buried(&self, triangle: u32) -> bool {
        self.buried.contains(triangle)
    }

    /// The triangles that lie inside another body.
    pub fn buried(&self) -> impl Iterator<Item = u32> {
        self.buried.iter()
    }

    /// Whether both triangles of an edge of a body lie inside other bodies, by the number of the edge in its body.
    #[inline]
    pub fn is_edge_buried(&self, edge: u32, body: u32) -> bool {
        !self.buried.is_none() && {
            let first = self.first_triangle[body as usize];
            let sides = self.bodies[body as usize].topology.edge_triangles[edge as usize];
            sides.iter().all(|&t| self.is_buried(t + first))
        }
    }

    /// Perturbed position of a vertex of a body, as the predicates see it.
    pub fn position(&self, body: u32, vertex: u32) -> DVec3 {
        let (b, global) = (body as usize, self.first_vertex[body as usize] + vertex);
        let mesh = self.bodies[b];
        let true_position = mesh.position(vertex) * self.scale;
        let displaced =
            true_position - mesh.normal(vertex) * self.deflation[b] + random(global, self.seed) * self.jitter[b];
        (displaced * LATTICE).round() / LATTICE
    }

    /// Computes the perturbed positions of the vertices of some triangles of a body.
    pub fn place(&mut self, body: u32, triangles: &[u32]) {
        let first = self.first_vertex[body as usize];
        for &triangle in triangles {
            for vertex in self.corners(triangle, body) {
                if self.slots[vertex as usize] == 0 {
                    self.slots[vertex as usize] = self.positions.len() as u32;
                    self.positions.push(self.position(body, vertex - first));
                }
            }
        }
    }

    /// Computes the perturbed positions of all vertices of a body.
    pub fn place_all(&mut self, body: u32) {
        let first = self.first_triangle[body as usize];
        let triangles = self.bodies[body as usize].topology.triangles.len() as u32;
        self.place(body, &(first..first + triangles).collect::<Vec<u32>>());
    }

    /// Perturbed position of a vertex that has been placed.
    #[inline]
    pub fn placed(&self, vertex: u32) -> DVec3 {
        self.positions[self.slots[vertex as usize] as usize]
    }

    /// Perturbed position of a vertex, whether it has been placed or not.
    pub fn placed_or_not(&self, vertex: u32, body: u32) -> DVec3 {
        match self.slots[vertex as usize] {
            0 => self.position(body, vertex - self.first_vertex[body as usize]),
            slot => self.positions[slot as usize],
        }
    }

    /// Factor from scene units to the units of perturbed positions.
    pub fn scale(&self) -> f64 {
        self.scale
    }

    #[inline]
    pub fn corners(&self, triangle: u32, body: u32) -> [u32; 3] {
        let local = triangle - self.first_triangle[body as usize];
        let first = self.first_vertex[body as usize];
        self.bodies[body as usize].topology.triangles[local as usize].map(|v| v + first)
    }

    #[inline]
    pub fn edges_of(&self, triangle: u32, body: u32) -> [u32; 3] {
        let local = triangle - self.first_triangle[body as usize];
        let first = self.first_edge[body as usize];
        self.bodies[body as usize].topology.triangle_edges[local as usize].map(|e| e + first)
    }

    #[inline]
    pub fn ends(&self, edge: u32, body: u32) -> [u32; 2] {
        let local = edge - self.first_edge[body as usize];
        let first = self.first_vertex[body as usize];
        self.bodies[body as usize].topology.edges[local as usize].map(|v| v + first)
    }

    /// The triangle that runs along an edge and the one that runs against it.
    #[inline]
    pub fn sides_of(&self, edge: u32, body: u32) -> [u32; 2] {
        let local = edge - self.first_edge[body as usize];
        let first = self.first_triangle[body as usize];
        self.bodies[body as usize].topology.edge_triangles[local as usize].map(|t| t + first)
    }

    /// Corners of a triangle as the predicates see them.
    #[inline]
    pub fn placed_corners(&self, triangle: u32, body: u32) -> [DVec3; 3] {
        self.corners(triangle, body).map(|v| self.placed(v))
    }

    /// The true position of a vertex [scene unit].
    #[inline]
    pub fn true_position(&self, vertex: u32, body: u32) -> DVec3 {
        self.bodies[body as usize].position(vertex - self.first_vertex[body as usize])
    }

    #[inline]
    pub fn is_triangle_of(&self, triangle: u32, body: u32) -> bool {
        (self.first_triangle[body as usize]..self.first_triangle[body as usize + 1]).contains(&triangle)
    }

    #[inline]
    pub fn is_vertex_of(&self, vertex: u32, body: u32) -> bool {
        (self.first_vertex[body as usize]..self.first_vertex[body as usize + 1]).contains(&vertex)
    }

    #[inline]
    pub fn is_edge_of(&self, edge: u32, body: u32) -> bool {
        (self.first_edge[body as usize]..self.first_edge[body as usize + 1]).contains(&edge)
    }

    pub fn body_of_triangle(&self, triangle: u32) -> u32 {
        self.first_triangle.partition_point(|&first| first <= triangle) as u32 - 1
    }

    pub fn body_of_edge(&self, edge: u32) -> u32 {
        self.first_edge.partition_point(|&first| first <= edge) as u32 - 1
    }

    pub fn body_of_vertex(&self, vertex: u32) -> u32 {
        self.first_vertex.partition_point(|&first| first <= vertex) as u32 - 1
    }
}

/// The smallest power of two above `x`; 1 for 0.
fn power_of_two_above(x: f64) -> f64 {
    if x < 1e-300 {
        return 1.0;
    }
    // The exponent alone is a power of two ≤ x.
    2.0 * f64::from_bits(x.to_bits() & 0x7ff0_0000_0000_0000)
}

/// Uniform in [−1, 1)³.
fn random(index: u32, seed: u64) -> DVec3 {
    let index = u64::from(index).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let mut random = Random::new(index ^ seed.wrapping_mul(0xD1B5_4A32_D192_ED03));
    DVec3::new(random.signed(), random.signed(), random.signed())
}

/// A greedy colouring with few colours in which the bodies of each pair differ.
fn colours(bodies: usize, pairs: &[[u32; 2]]) -> Vec<u32> {
    let mut lower = vec![Vec::new(); bodies];
    for &[a, b] in pairs {
        lower[b as usize].push(a);
    }
    let mut colours = vec![0; bodies];
    for b in 0..bodies {
        let mut taken: Vec<u32> = lower[b].iter().map(|&a| colours[a as usize]).collect();
        taken.sort_unstable();
        for colour in taken {
            colours[b] += u32::from(colour == colours[b]);
        }
    }
    colours
}
