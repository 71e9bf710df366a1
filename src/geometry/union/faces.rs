//! The parts of the triangles that bound the union.

use glam::DVec3;
use rayon::prelude::*;

use super::{
    arrangement::{Arrangement, End},
    placement::Placement,
    report::{Failure, Meter},
    triangulate::{ADDED, Filling, Region},
    winding::{Classified, shown},
};

/// Numbering of points: vertices, then nodes, triple points, and added points.
#[derive(Clone, Copy)]
pub struct Points {
    pub first_node: u32,
    pub first_triple: u32,
    pub first_added: u32,
}

impl Points {
    pub fn new(placement: &Placement, arrangement: &Arrangement) -> Points {
        let first_node = placement.first_vertex[placement.bodies.len()];
        let first_triple = first_node + arrangement.nodes.len() as u32;
        Points { first_node, first_triple, first_added: first_triple + arrangement.triple_points.len() as u32 }
    }

    fn of_end(&self, end: End) -> u32 {
        match end {
            End::Vertex(v) => v,
            End::Node(n) => self.first_node + n,
        }
    }
}

/// A triangle of the result that is not a whole triangle of a body.
#[derive(Clone, Copy, Debug)]
pub struct Face {
    pub corners: [u32; 3],
    /// The triangle that it is part of, and its body.
    pub triangle: u32,
    pub body: u32,
}

/// An edge on the union where the surfaces of two bodies meet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct SeamEdge {
    pub bodies: [u32; 2],
    /// Start of the edge; on the surface of the first body, the union is on the left.
    pub from: u32,
    pub to: u32,
}

/// The parts of cut triangles.
#[derive(Default)]
pub struct Faces {
    pub faces: Vec<Face>,
    pub seam: Vec<SeamEdge>,
    /// True positions of added points [scene unit].
    pub added: Vec<DVec3>,
    /// The triangle, and its body, of each added point.
    pub added_in: Vec<(u32, u32)>,
}

/// A worker's buffers, reused from triangle to triangle.
#[derive(Default)]
struct Scratch {
    region: Region,
    filling: Filling,
}

/// The input for cutting a triangle.
struct Cutter<'f, 'a, 'b> {
    placement: &'f Placement<'a, 'b>,
    arrangement: &'f Arrangement,
    classified: &'f Classified,
    points: Points,
}

impl Faces {
    /// Cuts every triangle that has segments.
    pub fn new(
        placement: &Placement,
        arrangement: &Arrangement,
        classified: &Classified,
        meter: &Meter,
        threads: bool,
    ) -> Result<Faces, Failure> {
        let points = Points::new(placement, arrangement);
        let cutter = Cutter { placement, arrangement, classified, points };
        let is_shown = |segments: &&[(u32, u32)]| !placement.is_buried(segments[0].0);
        let cut: Vec<&[(u32, u32)]> = arrangement.cut_triangles().filter(is_shown).collect();
        const AT_ONCE: usize = 64;
        let work = |segments: &[&[(u32, u32)]]| -> Result<Faces, Failure> {
            let (mut scratch, mut faces) = (Scratch::default(), Faces::default());
            for segments in segments {
                meter.spend(segments.len() as u64 + 4)?;
                cutter.cut(segments, &mut scratch, &mut faces, meter)?;
            }
            Ok(faces)
        };
        let parts: Result<Vec<Faces>, Failure> = if threads && cut.len() > 4 * AT_ONCE {
            cut.par_chunks(AT_ONCE).map(work).collect()
        } else {
            cut.chunks(cut.len().max(1)).map(work).collect()
        };

        let mut all = Faces::default();
        for part in parts? {
            let shift = all.added.len() as u32;
            let renamed = |p: u32| if p >= ADDED { p - ADDED + shift + points.first_added } else { p };
            all.faces.extend(part.faces.iter().map(|f| Face { corners: f.corners.map(renamed), ..*f }));
            all.seam.extend_from_slice(&part.seam);
            all.added.extend_from_slice(&part.added);
            all.added_in.extend_from_slice(&part.added_in);
        }
        Ok(all)
    }
}

impl Cutter<'_, '_, '_> {
    fn cut(
        &self,
        segments: &[(u32, u32)],
        Scratch { region, filling }: &mut Scratch,
        faces: &mut Faces,
        meter: &Meter,
    ) -> Result<(), Failure> {
        let (triangle, first) = segments[0];
        let first = &self.arrangement.segments[first as usize];
        let body = first.bodies[usize::from(first.triangles[0] != triangle)];
        region.pieces.clear();
        region.lines.clear();
        self.outline(triangle, body, region);
        for (line, &(_, segment)) in segments.iter().enumerate() {
            self.inner_line(triangle, segment, 3 + line as u32, region, faces);
        }
        if region.pieces.is_empty() {
            return Ok(());
        }
        // ear clipping of n points takes n² steps
        meter.spend((region.pieces.len() * region.pieces.len() / 16) as u64)?;
        let [a, b, c] = self.placement.placed_corners(triangle, body);
        filling.triangles.clear();
        filling.added.clear();
        region
            .fill((b - a).cross(c - a), |p| self.placed(p), filling)
            .ok_or(Failure::Inconsistent("the outline of a cut triangle"))?;
        let shift = faces.added.len() as u32;
        let renamed = |p: u32| if p >= ADDED { p + shift } else { p };
        faces.faces.extend(filling.triangles.iter().map(|t| Face { corners: t.map(renamed), triangle, body }));
        for mean in &filling.added {
            let sum: DVec3 = mean.iter().map(|&p| self.true_position(p)).sum();
            faces.added.push(sum / mean.len() as f64);
            faces.added_in.push((triangle, body));
        }
        Ok(())
    }

    /// Adds the triangle's own edges, counter-clockwise, where they bound the union.
    fn outline(&self, triangle: u32, body: u32, region: &mut Region) {
        let corners = self.placement.corners(triangle, body);
        let edges = self.placement.edges_of(triangle, body);
        for k in 0..3 {
            let (from, to, edge) = (corners[k], corners[(k + 1) % 3], edges[k]);
            region.lines.extend([(from, k as u32), (to, k as u32)]);
            let nodes = self.arrangement.numbers_of(edge);
            if nodes.is_empty() {
                if self.classified.is_shown_at(from, edge, body) {
                    region.pieces.push([from, to]);
                }
                continue;
            }
            let forward = self.placement.ends(edge, body)[0] == from;
            let mut last = from;
            let mut shown = false;
            for i in 0..nodes.len() as u32 {
                let node = if forward { nodes.start + i } else { nodes.end - 1 - i };
                let mut beside = self.classified.edge_shown[node as usize];
                if !forward {
                    beside.reverse();
                }
                shown = beside[1];
                // a line with both parts of the triangle on the union does not cut it: that happens with bodies that
                // are inside out
                if beside == [true; 2] {
                    continue;
                }
                let point = self.points.first_node + node;
                region.lines.push((point, k as u32));
                if beside[0] {
                    region.pieces.push([last, point]);
                }
                last = point;
            }
            if shown {
                region.pieces.push([last, to]);
            }
        }
    }

    /// Adds the parts of a segment that separate the union's part of the triangle from the rest.
    fn inner_line(&self, triangle: u32, number: u32, line: u32, region: &mut Region, faces: &mut Faces) {
        let segment = &self.arrangement.segments[number as usize];
        let is_first = segment.triangles[0] == triangle;
        let (in_front, behind) = if is_first {
            (shown::FIRST_IN_FRONT, shown::FIRST_BEHIND)
        } else {
            (shown::SECOND_IN_FRONT, shown::SECOND_BEHIND)
        };
        let parts = &self.classified.parts[self.classified.first_part[number as usize] as usize..];
        let mut from = self.points.of_end(segment.ends[0]);
        region.lines.push((from, line));
        for part in 0..=segment.passages.len() {
            // a point that changes nothing beside a line does not cut the line either
            if part < segment.passages.len() && parts[part] == parts[part + 1] {
                continue;
            }
            let to = match segment.passages.get(part) {
                Some((_, triple)) => self.points.first_triple + triple,
                None => self.points.of_end(segment.ends[1]),
            };
            region.lines.push((to, line));
            let (front, back) = (parts[part] & in_front != 0, parts[part] & behind != 0);
            if front != back {
                let [from, to] = if (segment.forward == is_first) == front { [from, to] } else { [to, from] };
                region.pieces.push([from, to]);
                if is_first && segment.bodies[0] != segment.bodies[1] {
                    faces.seam.push(SeamEdge { bodies: segment.bodies, from, to });
                }
            }
            from = to;
        }
    }

    /// Perturbed position of a point, as accurate as possible.
    fn placed(&self, point: u32) -> DVec3 {
        if point < self.points.first_node {
            self.placement.placed(point)
        } else if point < self.points.first_triple {
            let node = &self.arrangement.nodes[(point - self.points.first_node) as usize];
            let [a, b] = self.placement.ends(node.edge, node.edge_body).map(|v| self.placement.placed(v));
            a + (b - a) * node.passage.at
        } else {
            self.arrangement.triple_points[(point - self.points.first_triple) as usize] * self.placement.scale()
        }
    }

    /// True position of a point [scene unit].
    fn true_position(&self, point: u32) -> DVec3 {
        if point < self.points.first_node {
            self.placement.true_position(point, self.placement.body_of_vertex(point))
        } else if point < self.points.first_triple {
            self.arrangement.true_position(self.placement, End::Node(point - self.points.first_node))
        } else {
            self.arrangement.triple_points[(point - self.points.first_triple) as usize]
        }
    }
}
