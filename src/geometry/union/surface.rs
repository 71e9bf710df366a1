//! The union, stored as the parts kept from the bodies plus the new ones.

use std::{collections::hash_map::Entry, sync::OnceLock};

use glam::DVec3;
use rustc_hash::FxHashMap;

use super::{
    arrangement::Arrangement,
    bits::Bits,
    body::Body,
    faces::{Faces, Points},
    placement::Placement,
    report::Failure,
    seams::{Seam, seams},
    winding::Classified,
};
use crate::{disjoint_sets::DisjointSets, geometry::grouped};

/// Origin of a vertex of the union. Vertices, edges and triangles are numbered as in the given bodies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Origin {
    /// A vertex of a body, with the same position to the bit.
    Vertex {
        /// Index of the body.
        body: u32,
        /// Index of the vertex in that body.
        vertex: u32,
    },
    /// The point where an edge of one body passes through a triangle of another body or of its own.
    Edge {
        /// Index of the edge's body.
        body: u32,
        /// Start and end vertex of the edge.
        edge: [u32; 2],
        /// Position on the edge, from 0 to 1.
        at: f64,
        /// Index of the triangle's body.
        through: u32,
        /// Index of the triangle.
        triangle: u32,
    },
    /// The point where three triangles meet: (body, triangle) of each.
    Triangles([[u32; 2]; 3]),
    /// A point added within a triangle whose part could not be triangulated otherwise.
    Within {
        /// Index of the body.
        body: u32,
        /// Index of the triangle in that body.
        triangle: u32,
    },
}

/// A new vertex: its position and origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NewVertex {
    /// Position of the vertex [scene unit].
    pub position: DVec3,
    /// Origin of the vertex.
    pub origin: Origin,
}

/// A new triangle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NewTriangle {
    /// Vertices, counter-clockwise from outside: those of body b start at [`Union::first_vertex`]`[b]`, new ones follow
    /// those of the last body.
    pub corners: [u32; 3],
    /// The body and triangle that it is part of.
    pub part_of: [u32; 2],
}

/// Statistics of a union.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Statistics {
    /// Number of attempts beyond the first.
    pub retries: u32,
    /// Number of edge–triangle tests.
    pub tests: usize,
    /// Number of bodies tested against themselves.
    pub folds: usize,
    /// Number of bodies left out because they are too small to be resolved beside the others.
    pub dropped: usize,
    /// Work steps, as in [`super::Budget`].
    pub work: u64,
}

/// The boundary of the union of bodies: closed, manifold, oriented.
///
/// It is stored as a difference from the bodies, so that its cost is proportional to their overlap; [`Union::mesh`]
/// turns it into a mesh.
#[derive(Clone, Debug)]
pub struct Union<'a, 'b> {
    pub(super) bodies: &'b [Body<'a>],
    /// Number of each body's first vertex, followed by the number of the first new vertex.
    pub first_vertex: Vec<u32>,
    /// Triangles of each body that are not in the union or no longer whole, ascending.
    pub removed: Vec<Vec<u32>>,
    /// The removed triangles of each body as bits.
    is_removed: Vec<Bits>,
    /// Whether each body is left out from the start: it is a copy of another, or too small to be resolved.
    absent: Vec<bool>,
    /// Whether each body may intersect itself: of those that were placed, it is known.
    pub(super) may_cross_itself: Vec<bool>,
    /// Vertices that belong to no body.
    pub new_vertices: Vec<NewVertex>,
    /// Triangles that belong to no body.
    pub new_triangles: Vec<NewTriangle>,
    /// Curves along which the surfaces of two bodies meet.
    pub seams: Vec<Seam>,
    /// Statistics of the computation.
    pub statistics: Statistics,
    change: OnceLock<Change>,
}

/// The union's volume [scene unit³] and area [scene unit²] minus those of the bodies that are not left out.
#[derive(Clone, Copy, Debug)]
struct Change {
    volume: f64,
    area: f64,
}

/// A union as a mesh.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct UnionMesh<L = Origin> {
    /// Position of each vertex [scene unit], `[vertex_count]`.
    pub positions: Vec<DVec3>,
    /// Origin of each vertex, or the caller's label for it, `[vertex_count]`.
    pub origins: Vec<L>,
    /// Vertices of each triangle, counter-clockwise from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Index in this mesh of each vertex numbered as in [`Union::first_vertex`]; `u32::MAX` if it is not in the union.
    pub names: Vec<u32>,
}

impl<'a, 'b> Union<'a, 'b> {
    /// The union of bodies that do not overlap: each body unchanged if it is `included`.
    pub(super) fn untouched(bodies: &'b [Body<'a>], included: &[bool]) -> Union<'a, 'b> {
        let mut first_vertex = vec![0];
        for body in bodies {
            first_vertex.push(first_vertex[first_vertex.len() - 1] + body.topology.fan_count() as u32);
        }
        let mut union = Union {
            bodies,
            first_vertex,
            removed: vec![Vec::new(); bodies.len()],
            is_removed: vec![Bits::default(); bodies.len()],
            absent: included.iter().map(|included| !included).collect(),
            may_cross_itself: vec![true; bodies.len()],
            new_vertices: Vec::new(),
            new_triangles: Vec::new(),
            seams: Vec::new(),
            statistics: Statistics::default(),
            change: OnceLock::new(),
        };
        for (b, body) in bodies.iter().enumerate().filter(|(b, _)| !included[*b]) {
            union.removed[b] = (0..body.topology.triangles.len() as u32).collect();
        }
        union.mark_removed();
        union
    }

    /// Replaces cut triangles by their faces and removes triangles that are inside. `order` gives the caller's index of
    /// every placed body.
    pub(super) fn assemble(
        mut self,
        placement: &Placement,
        arrangement: &Arrangement,
        classified: &Classified,
        faces: Faces,
        order: &[u32],
    ) -> Result<Union<'a, 'b>, Failure> {
        let points = Points::new(placement, arrangement);
        let gone = gone(placement, arrangement, classified);

        // numbering: the bodies' vertices in the caller's order, then new ones as they occur
        let mut names = vec![u32::MAX; points.first_added as usize + faces.added.len() - points.first_node as usize];
        let new_name = |union: &mut Self, position: DVec3, origin: Origin| {
            union.new_vertices.push(NewVertex { position, origin });
            union.first_vertex[union.bodies.len()] + union.new_vertices.len() as u32 - 1
        };
        let named =
            |body: u32, triangle: u32| [order[body as usize], triangle - placement.first_triangle[body as usize]];
        let mut name = |union: &mut Self, point: u32, beside: u32| -> u32 {
            if point < points.first_node {
                let is_known = placement.is_vertex_of(point, beside);
                let body = if is_known { beside } else { placement.body_of_vertex(point) };
                return point - placement.first_vertex[body as usize]
                    + union.first_vertex[order[body as usize] as usize];
            }
            let known = &mut names[(point - points.first_node) as usize];
            if *known != u32::MAX {
                return *known;
            }
            let (position, origin) = if point < points.first_triple {
                let number = point - points.first_node;
                let node = &arrangement.nodes[number as usize];
                let body = placement.bodies[node.edge_body as usize];
                let ends = placement.ends(node.edge, node.edge_body);
                let edge =
                    ends.map(|v| body.topology.given_vertex(v - placement.first_vertex[node.edge_body as usize]));
                let [through, triangle] = named(node.passage.body, node.passage.triangle);
                let origin = Origin::Edge {
                    body: order[node.edge_body as usize],
                    edge,
                    at: arrangement.positions_on_edge[number as usize],
                    through,
                    triangle,
                };
                (arrangement.true_position(placement, super::arrangement::End::Node(number)), origin)
            } else if point < points.first_added {
                let number = (point - points.first_triple) as usize;
                let triangles = arrangement.triple_point_triangles[number];
                let origin = Origin::Triangles(triangles.map(|t| named(placement.body_of_triangle(t), t)));
                (arrangement.triple_points[number], origin)
            } else {
                let number = (point - points.first_added) as usize;
                let (triangle, body) = faces.added_in[number];
                let [body, triangle] = named(body, triangle);
                (faces.added[number], Origin::Within { body, triangle })
            };
            *known = new_name(union, position, origin);
            *known
        };
        for face in &faces.faces {
            let corners = face.corners.map(|p| name(&mut self, p, face.body));
            // two copies of a vertex of the mesh have one name: such a triangle is an edge, there and back
            if corners[0] != corners[1] && corners[1] != corners[2] && corners[2] != corners[0] {
                self.new_triangles.push(NewTriangle { corners, part_of: named(face.body, face.triangle) });
            }
        }
        let mut seam_edges = Vec::with_capacity(faces.seam.len());
        for edge in &faces.seam {
            let [a, b] = edge.bodies.map(|b| order[b as usize]);
            let (from, to) = (name(&mut self, edge.from, edge.bodies[0]), name(&mut self, edge.to, edge.bodies[0]));
            seam_edges.push(if a < b { ([a, b], from, to) } else { ([b, a], to, from) });
        }
        let mut body = 0;
        for triangle in gone.iter() {
            while !placement.is_triangle_of(triangle, body) {
                body += 1;
            }
            let [body, triangle] = named(body, triangle);
            self.removed[body as usize].push(triangle);
        }
        self.mark_removed();

        self.audit()?;
        if placement.folds.contains(&true) {
            self.split_touching_fans()?;
        }
        self.seams = seams(|vertex| self.position(vertex), seam_edges);
        Ok(self)
    }

    /// Position of a vertex [scene unit].
    pub fn position(&self, vertex: u32) -> DVec3 {
        match vertex.checked_sub(self.first_vertex[self.bodies.len()]) {
            Some(number) => self.new_vertices[number as usize].position,
            None => {
                let body = self.body_of(vertex);
                self.bodies[body].position(vertex - self.first_vertex[body])
            }
        }
    }

    /// The body of a vertex; the number of bodies for a new vertex.
    fn body_of(&self, vertex: u32) -> usize {
        self.first_vertex.partition_point(|&first| first <= vertex) - 1
    }

    /// Whether a body is, entirely or in part, inside others or itself, or the same as another.
    pub(super) fn is_inside(&self, body: usize) -> bool {
        !self.removed[body].is_empty()
    }

    /// Updates `is_removed` from `removed`.
    fn mark_removed(&mut self) {
        for ((removed, bits), body) in self.removed.iter().zip(&mut self.is_removed).zip(self.bodies) {
            *bits = if removed.is_empty() { Bits::default() } else { Bits::new(body.topology.triangles.len()) };
            for &t in removed {
                bits.insert(t);
            }
        }
    }

    #[inline]
    pub(super) fn is_removed(&self, body: u32, triangle: u32) -> bool {
        self.is_removed[body as usize].contains(triangle)
    }

    /// Checks that new triangles close the holes left by removed ones: each of their edges is paired with an opposite
    /// edge of another new triangle or of one that remains, and none of those remains open.
    fn audit(&self) -> Result<(), Failure> {
        if self.first_vertex[self.bodies.len()] as usize + self.new_vertices.len() >= 1 << 31 {
            return Err(Failure::Inconsistent("too many vertices"));
        }
        // the edge from its lower vertex and whether the triangle runs along it, in one number; the triangle
        let mut edges = vec![(0u64, 0u32); 3 * self.new_triangles.len()];
        // nearly all edges have a new vertex, which is the higher one: sort by counting; the others come first
        let first_new = self.first_vertex[self.bodies.len()];
        let bucket = |a: u32, b: u32| (a.max(b) + 1).saturating_sub(first_new) as usize;
        let mut start = vec![0u32; self.new_vertices.len() + 2];
        for corners in self.new_triangles.iter().map(|triangle| triangle.corners) {
            for k in 0..3 {
                let (a, b) = (corners[k], corners[(k + 1) % 3]);
                if a == b {
                    return Err(Failure::Inconsistent("a triangle of two corners"));
                }
                start[bucket(a, b) + 1] += 1;
            }
        }
        for i in 1..start.len() {
            start[i] += start[i - 1];
        }
        for (i, triangle) in self.new_triangles.iter().enumerate() {
            for k in 0..3 {
                let (a, b) = (triangle.corners[k], triangle.corners[(k + 1) % 3]);
                let ends = u64::from(a.min(b)) << 31 | u64::from(a.max(b));
                let next = &mut start[bucket(a, b)];
                edges[*next as usize] = (ends << 1 | u64::from(a < b), i as u32);
                *next += 1;
            }
        }
        // by now, each start has advanced to the next one
        let mut from = 0;
        for &to in &start[..start.len() - 1] {
            edges[from..to as usize].sort_unstable_by_key(|edge| edge.0);
            from = to as usize;
        }
        let mut unpaired = 0;
        for group in edges.chunk_by(|a, b| a.0 >> 1 == b.0 >> 1) {
            match group {
                [one, other] if one.0 != other.0 => {}
                [(edge, i)] => {
                    let along = edge & 1 != 0;
                    let [body, triangle] = self.new_triangles[*i as usize].part_of;
                    let topology = self.bodies[body as usize].topology;
                    let first = self.first_vertex[body as usize];
                    let (low, high) = ((edge >> 32) as u32, (edge >> 1) as u32 & (u32::MAX >> 1));
                    let [from, to] = if along { [low, high] } else { [high, low] };
                    let corners = topology.triangles[triangle as usize].map(|v| v + first);
                    let k = (0..3).find(|&k| corners[k] == from && corners[(k + 1) % 3] == to);
                    let edge = k.map(|k| topology.triangle_edges[triangle as usize][k]);
                    let beside = edge.map(|edge| topology.edge_triangles[edge as usize][usize::from(along)]);
                    if beside.is_none_or(|t| self.is_removed(body, t)) {
                        return Err(Failure::Inconsistent("an open edge"));
                    }
                    unpaired += 1;
                }
                _ => return Err(Failure::Inconsistent("an edge of three triangles")),
            }
        }
        let mut open = 0;
        for (b, removed) in self.removed.iter().enumerate() {
            let topology = self.bodies[b].topology;
            if removed.len() == topology.triangles.len() {
                continue;
            }
            for &t in removed {
                for edge in topology.triangle_edges[t as usize] {
                    open += usize::from(!self.is_removed(b as u32, topology.beside(edge, t)));
                }
            }
        }
        if open == unpaired { Ok(()) } else { Err(Failure::Inconsistent("an edge left open")) }
    }

    /// The bodies that were not left out.
    fn present(&self) -> impl Iterator<Item = &Body<'a>> {
        self.bodies.iter().zip(&self.absent).filter(|(_, absent)| !**absent).map(|(body, _)| body)
    }

    /// Removed triangles by body, for the bodies that were not left out.
    fn removed_of_present(&self) -> impl Iterator<Item = (usize, &Vec<u32>)> {
        self.removed.iter().enumerate().filter(|(b, _)| !self.absent[*b])
    }

    /// Number of vertices of removed triangles that are no longer used.
    fn lost_vertices(&self) -> i64 {
        let mut is_done = vec![false; self.first_vertex[self.bodies.len()] as usize + self.new_vertices.len()];
        self.new_triangles.iter().flat_map(|t| t.corners).for_each(|v| is_done[v as usize] = true);
        let mut lost = 0;
        for (b, removed) in self.removed_of_present() {
            let topology = self.bodies[b].topology;
            for v in removed.iter().flat_map(|&t| topology.triangles[t as usize]) {
                if std::mem::replace(&mut is_done[(v + self.first_vertex[b]) as usize], true) {
                    continue;
                }
                let is_kept = || {
                    (topology.edges_at(v).iter())
                        .any(|&e| !self.is_removed(b as u32, topology.triangle_left_of(e, v).0))
                };
                lost += i64::from(!is_kept());
            }
        }
        lost
    }

    /// Volume [scene unit³]. Takes time proportional to the meshes of the bodies, for their volumes.
    pub fn volume(&self) -> f64 {
        self.present().fold(0.0, |sum, body| sum + body.volume()) + self.change().volume
    }

    /// Area [scene unit²]. Takes time proportional to the meshes of the bodies, for their areas.
    pub fn area(&self) -> f64 {
        self.present().fold(0.0, |sum, body| sum + body.area()) + self.change().area
    }

    /// Whether the union of a body with itself is that body: it does not intersect itself, has one part, and is not
    /// inside out.
    pub(super) fn is_simple(&self, body: usize) -> bool {
        let of = &self.bodies[body];
        of.slack() > 0.0 || !self.may_cross_itself[body] && of.topology.components.len() == 1 && of.volume() > 0.0
    }

    /// Sum of the volumes of two bodies minus that of their union, which this is [scene unit³]; 0 at no cost where they are
    /// apart.
    pub(super) fn taken(&self, pair: [usize; 2]) -> f64 {
        let absent = pair.iter().filter(|body| self.absent[**body]);
        absent.fold(0.0, |sum, body| sum + self.bodies[*body].volume()) - self.change().volume
    }

    /// Euler characteristic: vertices − edges + triangles.
    pub fn euler(&self) -> i64 {
        let of_body =
            |body: &Body<'_>| i64::from(body.topology.used_vertices) - body.topology.triangles.len() as i64 / 2;
        let of_bodies: i64 = self.present().map(of_body).sum();
        // the number of edges is 3/2 of that of triangles
        let removed: usize = self.removed_of_present().map(|(_, removed)| removed.len()).sum();
        of_bodies + self.new_vertices.len() as i64
            - self.lost_vertices()
            - (self.new_triangles.len() as i64 - removed as i64) / 2
    }

    /// The change, computed on first request.
    fn change(&self) -> &Change {
        self.change.get_or_init(|| {
            // relative to a point near the change, for accuracy
            let origin = self.new_triangles.first().map_or(DVec3::ZERO, |t| self.position(t.corners[0]));
            let (mut volume, mut area) = (0.0, 0.0);
            for (b, removed) in self.removed_of_present() {
                let body = &self.bodies[b];
                if removed.len() == body.topology.triangles.len() {
                    volume -= 6.0 * body.volume();
                    area -= 2.0 * body.area();
                    continue;
                }
                for &t in removed {
                    let [x, y, z] = body.topology.triangles[t as usize].map(|v| body.position(v) - origin);
                    volume -= x.dot(y.cross(z));
                    area -= (y - x).cross(z - x).length();
                }
            }
            for triangle in &self.new_triangles {
                let [x, y, z] = triangle.corners.map(|v| self.position(v) - origin);
                volume += x.dot(y.cross(z));
                area += (y - x).cross(z - x).length();
            }
            Change { volume: volume / 6.0, area: area / 2.0 }
        })
    }

    /// Gives every fan of triangles about a vertex of new triangles, except the first, a vertex of its own.
    fn split_touching_fans(&mut self) -> Result<(), Failure> {
        // where there are several fans, first turn the old triangles into new ones
        let mut several = Vec::new();
        let mut old = Vec::new();
        for (vertex, about) in self.new_triangles_about_vertices().chunk_by(|a, b| a.0 == b.0).map(|g| (g[0].0, g)) {
            let mut corners: Vec<[u32; 3]> =
                about.iter().map(|&(_, i)| self.new_triangles[i as usize].corners).collect();
            let kept = self.old_triangles_about(vertex);
            corners.extend(kept.iter().map(|t| t.corners));
            if fans(vertex, &corners)?.len() > 1 {
                several.push(vertex);
                old.extend(kept);
            }
        }
        if several.is_empty() {
            return Ok(());
        }
        old.sort_unstable_by_key(|t| t.part_of);
        old.dedup();
        for triangle in old {
            let [body, t] = triangle.part_of;
            let removed = &mut self.removed[body as usize];
            if let Err(i) = removed.binary_search(&t) {
                removed.insert(i, t);
            }
            self.new_triangles.push(triangle);
        }
        self.mark_removed();
        let about = self.new_triangles_about_vertices();
        for vertex in several {
            let from = about.partition_point(|a| a.0 < vertex);
            let about: Vec<u32> = about[from..].iter().take_while(|a| a.0 == vertex).map(|a| a.1).collect();
            let corners: Vec<[u32; 3]> = about.iter().map(|&i| self.new_triangles[i as usize].corners).collect();
            for fan in &fans(vertex, &corners)?[1..] {
                let (position, origin) = (self.position(vertex), self.origin(vertex));
                self.new_vertices.push(NewVertex { position, origin });
                let name = self.first_vertex[self.bodies.len()] + self.new_vertices.len() as u32 - 1;
                for &k in fan {
                    let corners = &mut self.new_triangles[about[k] as usize].corners;
                    *corners = corners.map(|v| if v == vertex { name } else { v });
                }
            }
        }
        Ok(())
    }

    /// (vertex, new triangle), ascending.
    fn new_triangles_about_vertices(&self) -> Vec<(u32, u32)> {
        let vertices = self.first_vertex[self.bodies.len()] as usize + self.new_vertices.len();
        let corners = (0..).zip(&self.new_triangles).flat_map(|(i, t)| t.corners.map(|v| (v, (v, i))));
        grouped(vertices, corners).1
    }

    /// Triangles about a vertex that are unchanged triangles of its body.
    fn old_triangles_about(&self, vertex: u32) -> Vec<NewTriangle> {
        let body = self.body_of(vertex);
        let Some(mesh) = self.bodies.get(body) else { return Vec::new() };
        let (topology, first) = (mesh.topology, self.first_vertex[body]);
        (topology.edges_at(vertex - first).iter())
            .map(|&edge| topology.triangle_left_of(edge, vertex - first).0)
            .filter(|&t| !self.is_removed(body as u32, t))
            .map(|t| NewTriangle {
                corners: topology.triangles[t as usize].map(|v| v + first),
                part_of: [body as u32, t],
            })
            .collect()
    }

    /// The united bodies.
    pub fn bodies(&self) -> &'b [Body<'a>] {
        self.bodies
    }

    /// Origin of a vertex.
    pub fn origin(&self, vertex: u32) -> Origin {
        let body = self.body_of(vertex);
        match self.bodies.get(body) {
            Some(mesh) => Origin::Vertex {
                body: body as u32,
                vertex: mesh.topology.given_vertex(vertex - self.first_vertex[body]),
            },
            None => self.new_vertices[(vertex - self.first_vertex[self.bodies.len()]) as usize].origin,
        }
    }

    /// Converts the union to a mesh, in time proportional to the whole mesh.
    pub fn mesh(&self) -> UnionMesh {
        self.labelled_mesh(|origin| origin)
    }

    /// Like [`Union::mesh`], with origins converted to labels of the caller.
    pub fn labelled_mesh<L>(&self, label: impl Fn(Origin) -> L) -> UnionMesh<L> {
        let count = self.first_vertex[self.bodies.len()] as usize + self.new_vertices.len();
        let triangles: usize = self.bodies.iter().map(|body| body.topology.triangles.len()).sum();
        let triangles = triangles + self.new_triangles.len() - self.removed.iter().map(Vec::len).sum::<usize>();
        let mut mesh = UnionMesh {
            positions: Vec::with_capacity(count),
            origins: Vec::with_capacity(count),
            triangles: Vec::with_capacity(triangles),
            names: vec![u32::MAX; count],
        };
        for (b, body) in self.bodies.iter().enumerate() {
            let first = self.first_vertex[b];
            let mut from = 0;
            for to in self.removed[b].iter().copied().chain([body.topology.triangles.len() as u32]) {
                let kept = &body.topology.triangles[from as usize..to as usize];
                mesh.triangles.extend(kept.iter().map(|corners| corners.map(|v| v + first)));
                from = to + 1;
            }
        }
        mesh.triangles.extend(self.new_triangles.iter().map(|t| t.corners));
        for &v in mesh.triangles.iter().flatten() {
            mesh.names[v as usize] = 0;
        }
        for (b, body) in self.bodies.iter().enumerate() {
            for v in 0..body.topology.fan_count() as u32 {
                let name = &mut mesh.names[(v + self.first_vertex[b]) as usize];
                if *name == 0 {
                    *name = mesh.positions.len() as u32;
                    mesh.positions.push(body.position(v));
                    mesh.origins.push(label(Origin::Vertex { body: b as u32, vertex: body.topology.given_vertex(v) }));
                }
            }
        }
        let first_new = self.first_vertex[self.bodies.len()] as usize;
        for (vertex, name) in self.new_vertices.iter().zip(&mut mesh.names[first_new..]) {
            if *name == 0 {
                *name = mesh.positions.len() as u32;
                mesh.positions.push(vertex.position);
                mesh.origins.push(label(vertex.origin));
            }
        }
        for v in mesh.triangles.iter_mut().flatten() {
            *v = mesh.names[*v as usize];
        }
        mesh
    }

    /// Number of connected components of the surface. Uncut parts are counted by blocks of triangles, so the cost
    /// hardly depends on the size of the meshes.
    pub fn component_count(&self) -> usize {
        let is_cut = |b: usize| !self.removed[b].is_empty();
        let whole = (0..self.bodies.len()).filter(|&b| !is_cut(b));
        let count: usize = whole.map(|b| self.bodies[b].topology.components.len()).sum();
        // a part is a whole block, a remaining triangle of another block, or a new triangle
        let mut parts = DisjointSets::default();
        let first_of: Vec<u32> = (self.bodies.iter().enumerate())
            .map(|(b, body)| if is_cut(b) { parts.add(body.topology.block_count()) } else { 0 })
            .collect();
        let first_new = parts.add(self.new_triangles.len());
        let mut is_partial: Vec<Vec<bool>> = vec![Vec::new(); self.bodies.len()];
        // the parts of single triangles, `u32::MAX` for others
        let mut singles: Vec<Vec<u32>> = vec![Vec::new(); self.bodies.len()];
        for (b, removed) in self.removed.iter().enumerate().filter(|(b, _)| is_cut(*b)) {
            let topology = self.bodies[b].topology;
            is_partial[b].resize(topology.block_count(), false);
            singles[b].resize(topology.triangles.len(), u32::MAX);
            removed.iter().for_each(|&t| is_partial[b][topology.block_of[t as usize] as usize] = true);
            for (block, _) in is_partial[b].iter().enumerate().filter(|(_, is_partial)| **is_partial) {
                parts.count -= 1;
                for &t in topology.block(block).iter().filter(|&&t| !self.is_removed(b as u32, t)) {
                    singles[b][t as usize] = parts.add(1);
                }
            }
        }
        let part_of = |b: usize, t: u32| match singles[b].get(t as usize) {
            Some(&part) if part != u32::MAX => part,
            _ => first_of[b] + self.bodies[b].topology.block_of[t as usize],
        };
        for (b, is_partial) in is_partial.iter().enumerate().filter(|(_, is_partial)| !is_partial.is_empty()) {
            let topology = self.bodies[b].topology;
            for &[one, other] in &topology.block_pairs {
                if !is_partial[one as usize] && !is_partial[other as usize] {
                    parts.join(first_of[b] + one, first_of[b] + other);
                }
            }
        }
        for (b, topology) in self.bodies.iter().map(|body| body.topology).enumerate() {
            let blocks = is_partial[b].iter().enumerate().filter(|(_, is_partial)| **is_partial);
            for &t in blocks.flat_map(|(block, _)| topology.block(block)).filter(|&&t| !self.is_removed(b as u32, t)) {
                for beside in topology.triangle_edges[t as usize].map(|edge| topology.beside(edge, t)) {
                    if !self.is_removed(b as u32, beside) {
                        parts.join(singles[b][t as usize], part_of(b, beside));
                    }
                }
            }
        }
        // all triangles about a vertex are connected
        let mut at_vertex: FxHashMap<u32, u32> = FxHashMap::default();
        let mut at_new_vertex = vec![u32::MAX; self.new_vertices.len()];
        let first_new_vertex = self.first_vertex[self.bodies.len()];
        for (triangle, part) in self.new_triangles.iter().zip(first_new..) {
            for v in triangle.corners {
                if v >= first_new_vertex {
                    let known = &mut at_new_vertex[(v - first_new_vertex) as usize];
                    if *known == u32::MAX {
                        *known = part;
                    } else {
                        parts.join(*known, part);
                    }
                    continue;
                }
                match at_vertex.entry(v) {
                    Entry::Occupied(known) => parts.join(*known.get(), part),
                    Entry::Vacant(entry) => {
                        entry.insert(part);
                        let b = self.body_of(v);
                        let (topology, local) = (self.bodies[b].topology, v - self.first_vertex[b]);
                        for &edge in topology.edges_at(local) {
                            let t = topology.triangle_left_of(edge, local).0;
                            if !self.is_removed(b as u32, t) {
                                parts.join(part, part_of(b, t));
                            }
                        }
                    }
                }
            }
        }
        count + parts.count
    }
}

/// Groups the triangles about a vertex into fans, as indices into `corners`.
fn fans(vertex: u32, corners: &[[u32; 3]]) -> Result<Vec<Vec<usize>>, Failure> {
    // for each triangle, the two corners after the vertex
    let mut arcs: Vec<(u32, u32, usize)> = Vec::with_capacity(corners.len());
    for (i, corners) in corners.iter().enumerate() {
        let k = corners.iter().position(|&v| v == vertex);
        let k = k.ok_or(Failure::Inconsistent("a corner that is not there"))?;
        arcs.push((corners[(k + 1) % 3], corners[(k + 2) % 3], i));
    }
    let mut fans = Vec::new();
    while let Some((start, mut end, first)) = arcs.pop() {
        let mut fan = vec![first];
        while end != start {
            let next = arcs.iter().position(|arc| arc.0 == end);
            let next = next.ok_or(Failure::Inconsistent("a fan that does not close"))?;
            let (_, to, triangle) = arcs.swap_remove(next);
            fan.push(triangle);
            end = to;
        }
        fans.push(fan);
    }
    Ok(fans)
}

/// The triangles that are not in the union, or not whole.
fn gone(placement: &Placement, arrangement: &Arrangement, classified: &Classified) -> Bits {
    let mut gone = Bits::new(placement.first_triangle[placement.bodies.len()] as usize);
    for segments in arrangement.cut_triangles() {
        gone.insert(segments[0].0);
    }
    for t in placement.buried() {
        gone.insert(t);
    }
    let mut seen = gone.clone();
    let mut body = 0;
    for &vertex in classified.vertices.iter().chain(&classified.fan_vertices) {
        if !placement.is_vertex_of(vertex, body) {
            body = placement.body_of_vertex(vertex);
        }
        let b = body as usize;
        let topology = placement.bodies[b].topology;
        let local = vertex - placement.first_vertex[b];
        let is_shown = |edge: u32| classified.is_shown_at(vertex, edge + placement.first_edge[b], body);
        let edges = topology.edges_at(local);
        let is_shown_on_all =
            if classified.is_plain(vertex) { edges.first().map(|&edge| is_shown(edge)) } else { None };
        for &edge in edges {
            let t = topology.triangle_left_of(edge, local).0 + placement.first_triangle[b];
            if seen.insert(t) && !is_shown_on_all.unwrap_or_else(|| is_shown(edge)) {
                gone.insert(t);
            }
        }
    }
    gone
}
