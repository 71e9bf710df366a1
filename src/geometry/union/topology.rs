//! Connectivity of the triangles of a closed mesh.

use std::sync::{OnceLock, atomic::AtomicBool};

use rustc_hash::FxHashMap;
use thiserror::Error;

use super::distance::Branch;
use crate::{geometry::grouped, interrupt::is_raised};

/// Checks a flag.
type Check<'c> = &'c dyn Fn() -> Result<(), TopologyError>;

/// Number of triangles between two checks of a flag.
const UNCHECKED: usize = 1 << 16;

/// Largest number of triangles in a block, which is culled by one box.
const BLOCK: usize = 16;

/// The connectivity of a closed, oriented triangle mesh: computed once, used with any positions.
///
/// Closed and oriented means that every edge has one triangle that runs along it and one that runs against it. A vertex
/// at which several fans of triangles touch is represented by several vertices.
#[derive(Clone, Debug)]
pub struct Topology {
    pub(super) vertex_count: u32,
    /// For vertices beyond `vertex_count`, which are further fans: the vertex whose position they share.
    pub(super) copies: Vec<u32>,
    pub(super) triangles: Vec<[u32; 3]>,
    /// Edge k of a triangle runs from its vertex k to vertex k + 1.
    pub(super) triangle_edges: Vec<[u32; 3]>,
    /// Edges, lower vertex first.
    pub(super) edges: Vec<[u32; 2]>,
    /// The triangle that runs along the edge, and the one that runs against it.
    pub(super) edge_triangles: Vec<[u32; 2]>,
    /// Edges at vertex v: `vertex_edges[vertex_start[v]..vertex_start[v + 1]]`.
    vertex_start: Vec<u32>,
    vertex_edges: Vec<u32>,
    /// Triangles in patches of up to [`BLOCK`] neighbours: block i is
    /// `block_triangles[block_start[i]..block_start[i + 1]]`.
    block_start: Vec<u32>,
    block_triangles: Vec<u32>,
    /// Used vertices of each block, in the same layout.
    block_vertex_start: Vec<u32>,
    block_vertices: Vec<u32>,
    /// The block of each triangle.
    pub(super) block_of: Vec<u32>,
    /// Pairs of blocks with a common edge, ascending.
    pub(super) block_pairs: Vec<[u32; 2]>,
    /// Hierarchy of the blocks, built from the first positions that are searched.
    pub(super) hierarchy: OnceLock<Vec<Branch>>,
    /// A triangle of each connected component.
    pub(crate) components: Vec<u32>,
    /// Number of vertices used by triangles, further fans included.
    pub(super) used_vertices: u32,
}

/// Why triangles do not form a closed, oriented mesh.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum TopologyError {
    /// A triangle refers to a vertex that does not exist.
    #[error("triangle {triangle} refers to vertex {vertex}, but there are {vertex_count}")]
    NoSuchVertex {
        /// Index of the triangle.
        triangle: usize,
        /// The vertex index that it refers to.
        vertex: u32,
        /// Number of vertices.
        vertex_count: usize,
    },
    /// A triangle refers to a vertex twice.
    #[error("triangle {triangle} refers to vertex {vertex} twice")]
    RepeatedVertex {
        /// Index of the triangle.
        triangle: usize,
        /// The vertex that it refers to.
        vertex: u32,
    },
    /// Edges without their counterpart: a hole, a third sheet, or neighbours that disagree on which side is outside.
    #[error("not closed and oriented: {count} edges have no counterpart, the first from vertex {from} to vertex {to}")]
    Unpaired {
        /// Number of directed edges.
        count: usize,
        /// Start vertex of the first of them.
        from: u32,
        /// End vertex of the first of them.
        to: u32,
    },
    /// Two triangles have the same three vertices, with nothing between them.
    #[error("triangles {first} and {second} have the same vertices")]
    SameTriangle {
        /// Index of the first triangle.
        first: u32,
        /// Index of the second triangle.
        second: u32,
    },
    /// There are more vertices or triangles than a 31-bit index can number.
    #[error("more than 2^29 vertices or triangles")]
    TooLarge,
    /// The interrupt flag was set.
    #[error("interrupted")]
    Interrupted,
}

impl Topology {
    /// The connectivity of `triangles` (vertex indices, counter-clockwise seen from outside) over `vertex_count`
    /// vertices.
    ///
    /// # Errors
    ///
    /// If they are not closed and oriented, and where that fails first.
    pub fn new(vertex_count: usize, triangles: &[[u32; 3]]) -> Result<Topology, TopologyError> {
        Topology::interruptible(vertex_count, triangles, None)
    }

    /// Like [`Topology::new`], but ends soon after a flag is set: millions of triangles take seconds.
    ///
    /// # Errors
    ///
    /// Those of [`Topology::new`], and [`TopologyError::Interrupted`].
    pub fn interruptible(
        vertex_count: usize,
        triangles: &[[u32; 3]],
        interrupt: Option<&AtomicBool>,
    ) -> Result<Topology, TopologyError> {
        if vertex_count > 1 << 29 || triangles.len() > 1 << 29 {
            return Err(TopologyError::TooLarge);
        }
        for (triangle, corners) in triangles.iter().enumerate() {
            for k in 0..3 {
                let vertex = corners[k];
                if vertex as usize >= vertex_count {
                    return Err(TopologyError::NoSuchVertex { triangle, vertex, vertex_count });
                }
                if corners[(k + 1) % 3] == vertex {
                    return Err(TopologyError::RepeatedVertex { triangle, vertex });
                }
            }
        }

        let mut topology = Topology {
            vertex_count: vertex_count as u32,
            copies: Vec::new(),
            triangles: triangles.to_vec(),
            triangle_edges: vec![[0; 3]; triangles.len()],
            edges: Vec::new(),
            edge_triangles: Vec::new(),
            vertex_start: Vec::new(),
            vertex_edges: Vec::new(),
            block_start: vec![0],
            block_triangles: Vec::with_capacity(triangles.len()),
            block_vertex_start: vec![0],
            block_vertices: Vec::new(),
            block_of: vec![0; triangles.len()],
            block_pairs: Vec::new(),
            hierarchy: OnceLock::new(),
            components: Vec::new(),
            used_vertices: 0,
        };
        let check = || if is_raised(interrupt) { Err(TopologyError::Interrupted) } else { Ok(()) };
        topology.pair_edges(&check)?;
        topology.split_fans(&check)?;
        topology.list_edges_of_vertices();
        topology.cluster(&check)?;
        topology.pair_blocks(&check)?;
        topology.find_components(&check)?;
        Ok(topology)
    }

    fn pair_edges(&mut self, check: Check) -> Result<(), TopologyError> {
        const NONE: u32 = u32::MAX;
        let mut edge_of: FxHashMap<[u32; 2], u32> = FxHashMap::default();
        let mut surplus: Vec<[u32; 2]> = Vec::new();
        for (t, corners) in self.triangles.iter().enumerate() {
            if t % UNCHECKED == 0 {
                check()?;
            }
            for k in 0..3 {
                let (a, b) = (corners[k], corners[(k + 1) % 3]);
                let key = [a.min(b), a.max(b)];
                let edge = *edge_of.entry(key).or_insert_with(|| {
                    self.edges.push(key);
                    self.edge_triangles.push([NONE; 2]);
                    self.edges.len() as u32 - 1
                });
                let side = &mut self.edge_triangles[edge as usize][usize::from(a > b)];
                if *side == NONE {
                    *side = t as u32;
                } else {
                    surplus.push([a, b]);
                }
                self.triangle_edges[t][k] = edge;
            }
        }
        let open = self.edges.iter().zip(&self.edge_triangles).flat_map(|(&[a, b], sides)| {
            let missing = [(sides[0] == NONE, [b, a]), (sides[1] == NONE, [a, b])];
            missing.into_iter().filter(|m| m.0).map(|m| m.1)
        });
        let unpaired: Vec<[u32; 2]> = surplus.into_iter().chain(open).collect();
        if let Some(&[from, to]) = unpaired.first() {
            return Err(TopologyError::Unpaired { count: unpaired.len(), from, to });
        }
        for sides in &self.edge_triangles {
            let [mut first, mut second] = sides.map(|t| self.triangles[t as usize]);
            first.sort_unstable();
            second.sort_unstable();
            if first == second {
                return Err(TopologyError::SameTriangle { first: sides[0], second: sides[1] });
            }
        }
        Ok(())
    }

    /// Gives every fan of triangles about a vertex, except the first, a vertex of its own.
    fn split_fans(&mut self, check: Check) -> Result<(), TopologyError> {
        let mut seen = vec![[false; 3]; self.triangles.len()];
        let mut used = vec![false; self.vertex_count as usize];
        let mut renamed = false;
        for start in 0..self.triangles.len() {
            if start % UNCHECKED == 0 {
                check()?;
            }
            for corner in 0..3 {
                if seen[start][corner] {
                    continue;
                }
                let vertex = self.triangles[start][corner];
                let name = if used[vertex as usize] {
                    renamed = true;
                    self.copies.push(vertex);
                    self.vertex_count + self.copies.len() as u32 - 1
                } else {
                    used[vertex as usize] = true;
                    vertex
                };
                // rotate about the vertex, across the incoming edge
                let (mut t, mut k) = (start, corner);
                while !seen[t][k] {
                    seen[t][k] = true;
                    let edge = self.triangle_edges[t][(k + 2) % 3];
                    self.triangles[t][k] = name;
                    t = self.beside(edge, t as u32) as usize;
                    k = self.triangle_edges[t].iter().position(|&e| e == edge).unwrap_or(0);
                }
            }
        }
        if renamed {
            for (t, corners) in self.triangles.iter().enumerate() {
                for k in 0..3 {
                    let (a, b) = (corners[k], corners[(k + 1) % 3]);
                    let edge = self.triangle_edges[t][k] as usize;
                    self.edges[edge] = [a.min(b), a.max(b)];
                    self.edge_triangles[edge][usize::from(a > b)] = t as u32;
                }
            }
        }
        Ok(())
    }

    fn list_edges_of_vertices(&mut self) {
        let vertices = self.vertex_count as usize + self.copies.len();
        let ends = self.edges.iter().zip(0..).flat_map(|(ends, edge)| ends.map(|v| (v, edge)));
        (self.vertex_start, self.vertex_edges) = grouped(vertices, ends);
        self.used_vertices = self.vertex_start.windows(2).filter(|w| w[0] < w[1]).count() as u32;
    }

    /// Groups neighbouring triangles into blocks by breadth-first search: up to [`BLOCK`] from each start, with the
    /// next start beside the last block.
    fn cluster(&mut self, check: Check) -> Result<(), TopologyError> {
        let mut taken = vec![false; self.triangles.len()];
        let mut border = std::collections::VecDeque::new();
        for t in 0..self.triangles.len() as u32 {
            border.push_back(t);
            while let Some(start) = border.pop_front() {
                if taken[start as usize] {
                    continue;
                }
                let first = self.block_triangles.len();
                if (self.block_start.len() - 1).is_multiple_of(UNCHECKED / BLOCK) {
                    check()?;
                }
                taken[start as usize] = true;
                self.block_triangles.push(start);
                let mut at = first;
                while at < self.block_triangles.len() {
                    let t = self.block_triangles[at];
                    at += 1;
                    for edge in self.triangle_edges[t as usize] {
                        let beside = self.beside(edge, t);
                        if taken[beside as usize] {
                            continue;
                        }
                        if self.block_triangles.len() - first < BLOCK {
                            taken[beside as usize] = true;
                            self.block_triangles.push(beside);
                        } else {
                            border.push_back(beside);
                        }
                    }
                }
                self.block_start.push(self.block_triangles.len() as u32);
                let vertices = self.block_vertices.len();
                self.block_vertices
                    .extend(self.block_triangles[first..].iter().flat_map(|&t| self.triangles[t as usize]));
                self.block_vertices[vertices..].sort_unstable();
                let mut kept = vertices;
                for i in vertices..self.block_vertices.len() {
                    if i == vertices || self.block_vertices[i] != self.block_vertices[kept - 1] {
                        self.block_vertices[kept] = self.block_vertices[i];
                        kept += 1;
                    }
                }
                self.block_vertices.truncate(kept);
                self.block_vertex_start.push(kept as u32);
            }
        }
        Ok(())
    }

    fn pair_blocks(&mut self, check: Check) -> Result<(), TopologyError> {
        for block in 0..self.block_count() {
            for &t in &self.block_triangles[self.block_start[block] as usize..self.block_start[block + 1] as usize] {
                self.block_of[t as usize] = block as u32;
            }
        }
        check()?;
        for block in 0..self.block_count() as u32 {
            if (block as usize).is_multiple_of(UNCHECKED / BLOCK) {
                check()?;
            }
            let from = self.block_pairs.len();
            for &t in &self.block_triangles
                [self.block_start[block as usize] as usize..self.block_start[block as usize + 1] as usize]
            {
                for beside in self.triangle_edges[t as usize].iter().flat_map(|&e| self.edge_triangles[e as usize]) {
                    let other = self.block_of[beside as usize];
                    if other > block && !self.block_pairs[from..].contains(&[block, other]) {
                        self.block_pairs.push([block, other]);
                    }
                }
            }
            self.block_pairs[from..].sort_unstable();
        }
        Ok(())
    }

    fn find_components(&mut self, check: Check) -> Result<(), TopologyError> {
        let (mut seen, mut visited) = (vec![false; self.triangles.len()], 0);
        for start in 0..self.triangles.len() as u32 {
            if seen[start as usize] {
                continue;
            }
            self.components.push(start);
            seen[start as usize] = true;
            let mut queue = vec![start];
            while let Some(t) = queue.pop() {
                visited += 1;
                if visited % UNCHECKED == 0 {
                    check()?;
                }
                for edge in self.triangle_edges[t as usize] {
                    for beside in self.edge_triangles[edge as usize] {
                        if !seen[beside as usize] {
                            seen[beside as usize] = true;
                            queue.push(beside);
                        }
                    }
                }
            }
        }
        Ok(())
    }

    /// Number of vertices for which positions are required.
    pub fn vertex_count(&self) -> usize {
        self.vertex_count as usize
    }

    /// Number of triangles.
    pub fn triangle_count(&self) -> usize {
        self.triangles.len()
    }

    /// Number of vertices including further fans.
    pub(super) fn fan_count(&self) -> usize {
        self.vertex_count as usize + self.copies.len()
    }

    /// The given vertex whose position a fan's vertex shares.
    #[inline]
    pub(super) fn given_vertex(&self, vertex: u32) -> u32 {
        if vertex < self.vertex_count { vertex } else { self.copies[(vertex - self.vertex_count) as usize] }
    }

    #[inline]
    pub(super) fn edges_at(&self, vertex: u32) -> &[u32] {
        let (from, to) = (self.vertex_start[vertex as usize], self.vertex_start[vertex as usize + 1]);
        &self.vertex_edges[from as usize..to as usize]
    }

    /// The other triangle of an edge of triangle `t`.
    #[inline]
    pub(super) fn beside(&self, edge: u32, t: u32) -> u32 {
        let [one, other] = self.edge_triangles[edge as usize];
        if one == t { other } else { one }
    }

    /// The triangle in which an edge leaves one of its ends counter-clockwise, and the corner of that end.
    #[inline]
    pub(super) fn triangle_left_of(&self, edge: u32, from: u32) -> (u32, usize) {
        let side = usize::from(self.edges[edge as usize][0] != from);
        let t = self.edge_triangles[edge as usize][side];
        let corners = &self.triangles[t as usize];
        (
            t,
            if corners[0] == from {
                0
            } else if corners[1] == from {
                1
            } else {
                2
            },
        )
    }

    /// The other end of an edge.
    #[inline]
    pub(super) fn across(&self, edge: u32, vertex: u32) -> u32 {
        let [a, b] = self.edges[edge as usize];
        if a == vertex { b } else { a }
    }

    pub(super) fn block_count(&self) -> usize {
        self.block_start.len() - 1
    }

    #[inline]
    pub(super) fn block(&self, block: usize) -> &[u32] {
        &self.block_triangles[self.block_start[block] as usize..self.block_start[block + 1] as usize]
    }

    #[inline]
    pub(super) fn vertices_of_block(&self, block: usize) -> &[u32] {
        &self.block_vertices[self.block_vertex_start[block] as usize..self.block_vertex_start[block + 1] as usize]
    }
}
