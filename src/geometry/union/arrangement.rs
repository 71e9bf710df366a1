//! Intersections of surfaces: nodes (an edge through a triangle), segments (a triangle through a triangle, from node to
//! node) and triple points (three triangles).
//!
//! Only signs of polynomials decide, and signs are exact; so the result is the exact arrangement of the displaced
//! bodies, not an approximation. Coordinates are computed last, and no decision depends on them.

use glam::DVec3;
use rayon::prelude::*;

use super::{
    bits::Ranks,
    candidates::{AT_ONCE, EdgeAndTriangle},
    exact::{Bounded, Number, Plane, Polynomial},
    placement::Placement,
    report::{Failure, Meter},
};
use crate::parallel;

/// An end of a line: a node, or a vertex (numbered uniquely over all bodies).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    Node(u32),
    /// The only common vertex of two triangles of a body.
    Vertex(u32),
}

/// A line's passage through a triangle.
#[derive(Clone, Copy, Debug)]
pub struct Passage {
    pub triangle: u32,
    pub body: u32,
    /// Heights of the line's first and second end in front of the triangle; of opposite signs.
    heights: [Bounded; 2],
    /// Position on the line, from 0 at the first end to 1 at the second.
    pub at: f64,
}

impl Passage {
    /// Whether the line goes from in front of the triangle to behind it.
    #[inline]
    pub fn enters(&self) -> bool {
        self.heights[0].value > 0.0
    }
}

/// Where an edge passes through a triangle.
#[derive(Clone, Copy, Debug)]
pub struct Node {
    pub edge: u32,
    pub edge_body: u32,
    pub passage: Passage,
}

/// Where two triangles meet.
#[derive(Clone, Debug)]
pub struct Segment {
    /// The two triangles, ascending.
    pub triangles: [u32; 2],
    pub bodies: [u32; 2],
    /// The two ends; the first is a node.
    pub ends: [End; 2],
    /// Whether it runs along normal(second) × normal(first) from its first end, so that on the first triangle, the part
    /// in front of the second is on its left.
    pub forward: bool,
    /// Whether the segment lies entirely inside a third body, where it is invisible; its triple points are not
    /// computed.
    pub buried: bool,
    /// Triple points on the segment, in order from the first end, each with its index.
    pub passages: Vec<(Passage, u32)>,
}

/// The intersections of the bodies, as determined by the predicates.
#[derive(Default)]
pub struct Arrangement {
    /// Nodes, sorted by edge and by position along it.
    pub nodes: Vec<Node>,
    /// True position of every node on its edge, from 0 to 1.
    pub positions_on_edge: Vec<f64>,
    /// Ranks of the edges that have nodes.
    edges: Ranks,
    /// Start of the nodes of each of them in `nodes`, followed by the end.
    first_node: Vec<u32>,
    /// Segments, sorted by triangles.
    pub segments: Vec<Segment>,
    /// (triangle, segment), ascending.
    pub segments_of_triangles: Vec<(u32, u32)>,
    /// True positions of the triple points [scene unit].
    pub triple_points: Vec<DVec3>,
    /// Triangles of each triple point, ascending.
    pub triple_point_triangles: Vec<[u32; 3]>,
}

/// Height of an end in front of a triangle, times a positive factor that depends on the end alone.
struct Height<'p, 'a, 'b> {
    placement: &'p Placement<'a, 'b>,
    nodes: &'p [Node],
}

impl Height<'_, '_, '_> {
    fn of_vertex<N: Number>(&self, vertex: u32, triangle: u32, body: u32) -> N {
        let names = self.placement.corners(triangle, body);
        if names.contains(&vertex) {
            return N::zero();
        }
        let [a, b, c] = names.map(|v| self.placement.placed(v));
        N::orientation(a, b, c, self.placement.placed(vertex))
    }

    /// For a node on the edge ab, with heights (p, q) over its own triangle and (f, g) over this one, the height is (p
    /// g − q f)/(p − q).
    fn of_end<N: Number>(&self, end: End, triangle: u32, body: u32) -> N {
        match end {
            End::Vertex(vertex) => self.of_vertex(vertex, triangle, body),
            End::Node(node) => {
                let node = &self.nodes[node as usize];
                let ends = self.placement.ends(node.edge, node.edge_body);
                let [p, q] = ends.map(|v| self.of_vertex::<N>(v, node.passage.triangle, node.passage.body));
                let [f, g] = ends.map(|v| self.of_vertex::<N>(v, triangle, body));
                if node.passage.enters() { p.times(&g).minus(&q.times(&f)) } else { q.times(&f).minus(&p.times(&g)) }
            }
        }
    }

    /// |p − q| of a node: the factor by which [`Self::of_end`] is too large.
    fn factor(&self, end: End) -> f64 {
        match end {
            End::Vertex(_) => 1.0,
            End::Node(node) => {
                let [p, q] = self.nodes[node as usize].passage.heights;
                p.value.abs() + q.value.abs()
            }
        }
    }

    /// The passage of a line through a triangle; `None` if both ends are on the same side.
    fn passage(&self, ends: [End; 2], triangle: u32, body: u32) -> Result<Option<Passage>, Failure> {
        let mut heights = [Bounded::zero(); 2];
        for k in 0..2 {
            heights[k] = self.of_end::<Bounded>(ends[k], triangle, body);
            if heights[k].is_positive().is_none() {
                let exact = OfEnd(self, ends[k], triangle, body).exactly_positive().ok_or(Failure::Tie)?;
                // keep the error bound, so that comparisons of positions also fall back to the exact number
                let magnitude = heights[k].value.abs().max(f64::MIN_POSITIVE);
                heights[k].value = if exact { magnitude } else { -magnitude };
                heights[k].error *= 4.0;
            }
        }
        if (heights[0].value > 0.0) == (heights[1].value > 0.0) {
            return Ok(None);
        }
        let (p, q) = (heights[0].value.abs() / self.factor(ends[0]), heights[1].value.abs() / self.factor(ends[1]));
        Ok(Some(Passage { triangle, body, heights, at: p / (p + q) }))
    }

    /// Whether a line passes `first` before `second`.
    ///
    /// Through a triangle whose heights at the ends are (p, q) it passes at p/(p − q). So the first is before the
    /// second if p₁ (p₂ − q₂) < p₂ (p₁ − q₁), all divided by (p₁ − q₁)(p₂ − q₂): p₂ q₁ < p₁ q₂ if p₁ and p₂ have the
    /// same sign.
    fn is_before(&self, ends: [End; 2], first: &Passage, second: &Passage) -> Result<bool, Failure> {
        let bounded = (second.heights[0].times(&first.heights[1])).minus(&first.heights[0].times(&second.heights[1]));
        let exact = || Later { heights: self, ends, first: *first, second: *second }.exactly_positive();
        let positive = bounded.is_positive().or_else(exact).ok_or(Failure::Tie)?;
        Ok(positive != (first.enters() == second.enters()))
    }

    /// Sorts a line's passages, which are nearly in order.
    fn sort_along<T>(&self, ends: [End; 2], items: &mut [T], passage: impl Fn(&T) -> &Passage) -> Result<(), Failure> {
        if items.len() < 2 {
            return Ok(());
        }
        items.sort_by(|x, y| {
            let (x, y) = (passage(x), passage(y));
            x.at.total_cmp(&y.at).then(x.triangle.cmp(&y.triangle))
        });
        for i in 1..items.len() {
            let mut k = i;
            while k > 0 && !self.is_before(ends, passage(&items[k - 1]), passage(&items[k]))? {
                items.swap(k - 1, k);
                k -= 1;
            }
        }
        Ok(())
    }
}

struct OfEnd<'h, 'p, 'a, 'b>(&'h Height<'p, 'a, 'b>, End, u32, u32);

impl Polynomial for OfEnd<'_, '_, '_, '_> {
    fn value<N: Number>(&self) -> N {
        self.0.of_end(self.1, self.2, self.3)
    }
}

struct Later<'h, 'p, 'a, 'b> {
    heights: &'h Height<'p, 'a, 'b>,
    ends: [End; 2],
    first: Passage,
    second: Passage,
}

impl Polynomial for Later<'_, '_, '_, '_> {
    fn value<N: Number>(&self) -> N {
        let height = |end: usize, of: &Passage| self.heights.of_end::<N>(self.ends[end], of.triangle, of.body);
        height(0, &self.second)
            .times(&height(1, &self.first))
            .minus(&height(0, &self.first).times(&height(1, &self.second)))
    }
}

/// Whether four placed points are oriented counter-clockwise, seen from the last.
struct Orientation([DVec3; 4]);

impl Polynomial for Orientation {
    #[inline]
    fn value<N: Number>(&self) -> N {
        let [a, b, c, d] = self.0;
        N::orientation(a, b, c, d)
    }
}

/// Whether `d` is in front of a, b, c, decided exactly.
#[inline]
pub fn is_in_front(a: DVec3, b: DVec3, c: DVec3, d: DVec3) -> Result<bool, Failure> {
    Orientation([a, b, c, d]).is_positive().ok_or(Failure::Tie)
}

/// Whether the line through two points passes inside a triangle: whether its turns about all three sides have the same
/// sign.
fn passes_inside([a, b]: [DVec3; 2], [x, y, z]: [DVec3; 3]) -> Result<bool, Failure> {
    let beside_x = Plane::new(a, b, x);
    let exactly = |from, to| Orientation([a, b, from, to]).exactly_positive();
    let turn = beside_x.side(y).is_positive().or_else(|| exactly(x, y)).ok_or(Failure::Tie)?;
    // the volume for the side from z to x, with the opposite sign
    let behind = beside_x.side(z).is_positive().or_else(|| exactly(x, z)).ok_or(Failure::Tie)?;
    Ok(behind != turn && is_in_front(a, b, y, z)? == turn)
}

/// Whether an edge that straddles the plane of a triangle without a common vertex passes through it; both with their
/// bodies.
fn passes(placement: &Placement, [edge, edge_body]: [u32; 2], [triangle, body]: [u32; 2]) -> Result<bool, Failure> {
    let ends = placement.ends(edge, edge_body);
    let names = placement.corners(triangle, body);
    if body == edge_body && (names.contains(&ends[0]) || names.contains(&ends[1])) {
        return Ok(false);
    }
    passes_inside(ends.map(|v| placement.placed(v)), names.map(|v| placement.placed(v)))
}

/// Whether a body intersects itself, by its candidate edges and triangles.
pub fn meets_itself(
    placement: &Placement,
    body: u32,
    candidates: &[EdgeAndTriangle],
    meter: &Meter,
) -> Result<bool, Failure> {
    for candidates in candidates.chunks(AT_ONCE) {
        meter.spend(candidates.len() as u64)?;
        for &candidate in candidates {
            if passes(placement, [(candidate >> 32) as u32, body], [candidate as u32, body])? {
                return Ok(true);
            }
        }
    }
    Ok(false)
}

impl Arrangement {
    /// The nodes and segments of the candidate edges and triangles.
    pub fn new(
        placement: &Placement,
        candidates: &[EdgeAndTriangle],
        meter: &Meter,
        threads: bool,
    ) -> Result<Arrangement, Failure> {
        let mut arrangement = Arrangement::default();
        arrangement.find_nodes(placement, candidates, meter, threads)?;
        arrangement.order_nodes(placement)?;
        arrangement.positions_on_edge =
            arrangement.nodes.iter().map(|node| Self::position_on_edge(placement, node)).collect();
        arrangement.connect(placement)?;
        Ok(arrangement)
    }

    /// The nodes and segments of some of the bodies, without triple points.
    pub fn of_some(&self, placement: &Placement, is_one: impl Fn(u32) -> bool) -> Result<Arrangement, Failure> {
        let is_kept = |node: &Node| is_one(node.edge_body) && is_one(node.passage.body);
        let kept = self.nodes.iter().zip(&self.positions_on_edge).filter(|(node, _)| is_kept(node));
        let (nodes, positions_on_edge) = kept.unzip();
        let mut arrangement = Arrangement { nodes, positions_on_edge, ..Arrangement::default() };
        arrangement.connect(placement)?;
        Ok(arrangement)
    }

    fn find_nodes(
        &mut self,
        placement: &Placement,
        candidates: &[EdgeAndTriangle],
        meter: &Meter,
        threads: bool,
    ) -> Result<(), Failure> {
        let test = |candidates: &[EdgeAndTriangle], nodes: &mut Vec<Node>| -> Result<(), Failure> {
            meter.spend(candidates.len() as u64)?;
            let (mut edge_body, mut body) = (0, 0);
            for &candidate in candidates {
                let (edge, triangle) = ((candidate >> 32) as u32, candidate as u32);
                if !placement.is_edge_of(edge, edge_body) {
                    edge_body = placement.body_of_edge(edge);
                }
                if !placement.is_triangle_of(triangle, body) {
                    body = placement.body_of_triangle(triangle);
                }
                if !passes(placement, [edge, edge_body], [triangle, body])? {
                    continue;
                }
                let ends = placement.ends(edge, edge_body);
                let heights = Height { placement, nodes: &[] };
                let passage = heights.passage(ends.map(End::Vertex), triangle, body)?;
                let passage = passage.ok_or(Failure::Inconsistent("an edge that crosses a plane does not"))?;
                nodes.push(Node { edge, edge_body, passage });
            }
            Ok(())
        };
        if threads && candidates.len() > 4 * AT_ONCE {
            let test = |candidates| {
                let mut nodes = Vec::new();
                test(candidates, &mut nodes).map(|()| nodes)
            };
            self.nodes = candidates.par_chunks(AT_ONCE).map(test).collect::<Result<Vec<_>, _>>()?.concat();
        } else {
            self.nodes.reserve(candidates.len() / 4);
            candidates.chunks(AT_ONCE).try_for_each(|candidates| test(candidates, &mut self.nodes))?;
        }
        Ok(())
    }

    fn order_nodes(&mut self, placement: &Placement) -> Result<(), Failure> {
        let heights = Height { placement, nodes: &[] };
        for nodes in self.nodes.chunk_by_mut(|a, b| a.edge == b.edge) {
            let ends = placement.ends(nodes[0].edge, nodes[0].edge_body).map(End::Vertex);
            heights.sort_along(ends, nodes, |n| &n.passage)?;
        }
        Ok(())
    }

    /// Joins the nodes of each pair of triangles to a segment.
    fn connect(&mut self, placement: &Placement) -> Result<(), Failure> {
        let mut edges = Vec::with_capacity(self.nodes.len());
        self.first_node.push(0);
        for nodes in self.nodes.chunk_by(|a, b| a.edge == b.edge) {
            edges.push(nodes[0].edge);
            self.first_node.push(self.first_node[self.first_node.len() - 1] + nodes.len() as u32);
        }
        self.edges = Ranks::new(placement.first_edge[placement.bodies.len()], &edges);
        // the two triangles in one number, the lower in its upper half
        let mut ends: Vec<(u64, u32)> = Vec::with_capacity(2 * self.nodes.len());
        for (i, node) in self.nodes.iter().enumerate() {
            let other = node.passage.triangle;
            let is_other_buried = placement.is_buried(other);
            for side in placement.sides_of(node.edge, node.edge_body) {
                // intersections of two triangles inside other bodies were not searched for
                if is_other_buried && placement.is_buried(side) {
                    continue;
                }
                ends.push((u64::from(side.min(other)) << 32 | u64::from(side.max(other)), i as u32));
            }
        }
        ends.sort_unstable();
        self.segments.reserve(self.nodes.len() + 1);
        let mut from = 0;
        while from < ends.len() {
            let (pair, first) = ends[from];
            let count = ends[from..].iter().take_while(|end| end.0 == pair).count();
            let triangles = [(pair >> 32) as u32, pair as u32];
            let node = &self.nodes[first as usize];
            let bodies = if placement.sides_of(node.edge, node.edge_body).contains(&triangles[0])
                && node.passage.triangle == triangles[1]
            {
                [node.edge_body, node.passage.body]
            } else {
                [node.passage.body, node.edge_body]
            };
            let last = match count {
                2 => End::Node(ends[from + 1].1),
                1 if bodies[0] == bodies[1] => {
                    let others = placement.corners(triangles[1], bodies[1]);
                    let shared = placement.corners(triangles[0], bodies[0]).into_iter().find(|v| others.contains(v));
                    End::Vertex(shared.ok_or(Failure::Inconsistent("a segment of one end"))?)
                }
                _ => return Err(Failure::Inconsistent("a segment of more than two ends")),
            };
            let forward = self.runs_forward(placement, first, triangles);
            if let End::Node(last) = last
                && self.runs_forward(placement, last, triangles) == forward
            {
                return Err(Failure::Inconsistent("a segment of two beginnings"));
            }
            self.segments.push(Segment {
                triangles,
                bodies,
                ends: [End::Node(first), last],
                forward,
                buried: false,
                passages: Vec::new(),
            });
            from += count;
        }
        let of_triangles = |(segment, i): (&Segment, u64)| segment.triangles.map(|t| u64::from(t) << 32 | i);
        let mut of_triangles: Vec<u64> = self.segments.iter().zip(0..).flat_map(of_triangles).collect();
        of_triangles.sort_unstable();
        self.segments_of_triangles = of_triangles.into_iter().map(|of| ((of >> 32) as u32, of as u32)).collect();
        Ok(())
    }

    /// Whether the segment that starts at a node, inwards, is forward.
    ///
    /// Suppose the edge belongs to the first triangle. Counter-clockwise along it, the triangle is on the left; a
    /// segment that turns inwards there has the part where the edge comes from on its left. So it is forward if the
    /// edge comes from in front of the second triangle. If the edge belongs to the second triangle, the roles are
    /// exchanged: the segment is then backward if the edge comes from in front of the first.
    fn runs_forward(&self, placement: &Placement, node: u32, triangles: [u32; 2]) -> bool {
        let node = &self.nodes[node as usize];
        let of_first = node.passage.triangle == triangles[1];
        let own = triangles[usize::from(!of_first)];
        let along = placement.sides_of(node.edge, node.edge_body)[0] == own;
        (node.passage.enters() == along) == of_first
    }

    /// The nodes of an edge, in order from its first end.
    #[inline]
    pub fn nodes_of(&self, edge: u32) -> &[Node] {
        let std::ops::Range { start, end } = self.numbers_of(edge);
        &self.nodes[start as usize..end as usize]
    }

    /// The numbers of the nodes of an edge.
    #[inline]
    pub fn numbers_of(&self, edge: u32) -> std::ops::Range<u32> {
        self.edges.of(edge).map_or(0..0, |k| self.first_node[k]..self.first_node[k + 1])
    }

    /// The segments of a triangle, as (triangle, segment).
    pub fn segments_of(&self, triangle: u32) -> &[(u32, u32)] {
        let from = self.segments_of_triangles.partition_point(|s| s.0 < triangle);
        let count = self.segments_of_triangles[from..].iter().take_while(|s| s.0 == triangle).count();
        &self.segments_of_triangles[from..from + count]
    }

    /// The segments of each cut triangle, triangle by triangle.
    pub fn cut_triangles(&self) -> impl Iterator<Item = &[(u32, u32)]> {
        self.segments_of_triangles.chunk_by(|a, b| a.0 == b.0)
    }

    fn segment_between(&self, a: u32, b: u32) -> Option<u32> {
        self.segments.binary_search_by_key(&[a.min(b), a.max(b)], |s| s.triangles).ok().map(|i| i as u32)
    }

    /// Finds the triple points on all segments that are not buried.
    pub fn find_triple_points(&mut self, placement: &Placement, meter: &Meter, threads: bool) -> Result<(), Failure> {
        let cut: Vec<&[(u32, u32)]> = self.cut_triangles().filter(|segments| segments.len() > 1).collect();
        let of = |segments: &&[(u32, u32)]| self.triple_points_in(placement, segments, meter);
        let found: Result<Vec<Vec<TriplePoint>>, Failure> = parallel::collect(threads && cut.len() > 256, &cut, of);
        let found = found?.concat();

        for (number, point) in found.iter().enumerate() {
            for &(segment, passage) in point.on.iter().flatten() {
                self.segments[segment as usize].passages.push((passage, number as u32));
            }
        }
        let heights = Height { placement, nodes: &self.nodes };
        for segment in &mut self.segments {
            heights.sort_along(segment.ends, &mut segment.passages, |p| &p.0)?;
        }
        self.triple_points = found.iter().map(|point| self.position_of(placement, point)).collect();
        self.triple_point_triangles = found.iter().map(|point| point.triangles).collect();
        Ok(())
    }

    /// Triple points in a triangle, except those that another triangle owns.
    fn triple_points_in(
        &self,
        placement: &Placement,
        segments: &[(u32, u32)],
        meter: &Meter,
    ) -> Result<Vec<TriplePoint>, Failure> {
        let heights = Height { placement, nodes: &self.nodes };
        let mut found = Vec::new();
        let triangle = segments[0].0;
        let other = |s: &Segment| {
            let k = usize::from(s.triangles[0] == triangle);
            (s.triangles[k], s.bodies[k])
        };
        for (i, &(_, first)) in segments.iter().enumerate() {
            let s1 = &self.segments[first as usize];
            let (t1, b1) = other(s1);
            meter.spend((segments.len() - i) as u64)?;
            for &(_, second) in &segments[i + 1..] {
                let s2 = &self.segments[second as usize];
                if s1.buried && s2.buried {
                    continue;
                }
                let (t2, b2) = other(s2); // > t1
                // the lowest triangle owns the triple point if one of its segments is not buried, otherwise the middle
                // one
                let is_only_here = s1.buried && !s2.buried;
                let left_to_another = triangle > t2 || (triangle > t1 && !is_only_here);
                if left_to_another || (b1 == b2 && !placement.folds[b1 as usize]) {
                    continue;
                }
                if s1.ends.iter().any(|end| s2.ends.contains(end)) {
                    continue;
                }
                let is_shared = |ends: [End; 2], t: u32, b: u32| {
                    let corners = placement.corners(t, b);
                    ends.iter().any(|end| matches!(end, End::Vertex(v) if corners.contains(v)))
                };
                if b1 == b2 && (is_shared(s1.ends, t2, b2) || is_shared(s2.ends, t1, b1)) {
                    continue;
                }
                let Some(on_first) = heights.passage(s1.ends, t2, b2)? else { continue };
                let Some(on_second) = heights.passage(s2.ends, t1, b1)? else { continue };
                let inconsistent = Failure::Inconsistent("a triple point of two segments");
                let third = self.segment_between(t1, t2).ok_or(inconsistent)?;
                let s3 = &self.segments[third as usize];
                if triangle > t1 && !s3.buried {
                    continue;
                }
                let body = s1.bodies[usize::from(s1.triangles[0] != triangle)];
                let on_third = heights.passage(s3.ends, triangle, body)?.ok_or(inconsistent)?;
                let on_shown = |number: u32, passage: Passage| {
                    (!self.segments[number as usize].buried).then_some((number, passage))
                };
                // sorted, so that the position does not depend on which segments are buried
                let mut triangles = [triangle, t1, t2];
                triangles.sort_unstable();
                let on = [on_shown(first, on_first), on_shown(second, on_second), on_shown(third, on_third)];
                found.push(TriplePoint { triangles, on });
            }
        }
        meter.spend(16 * found.len() as u64)?;
        Ok(found)
    }

    /// True position of a triple point [scene unit]: the intersection of the true planes, if that is near the perturbed
    /// position.
    fn position_of(&self, placement: &Placement, point: &TriplePoint) -> DVec3 {
        let Some((segment, passage)) = point.on.iter().flatten().next() else { return DVec3::ZERO };
        let [from, to] = self.segments[*segment as usize].ends.map(|end| self.true_position(placement, end));
        let seen = from + (to - from) * passage.at;
        let planes = point.triangles.map(|t| {
            let body = placement.body_of_triangle(t);
            let [a, b, c] = placement.corners(t, body).map(|v| placement.true_position(v, body) - seen);
            let normal = (b - a).cross(c - a).normalize_or_zero();
            (normal, normal.dot(a))
        });
        let [(n1, d1), (n2, d2), (n3, d3)] = planes;
        let offset = (n2.cross(n3) * d1 + n3.cross(n1) * d2 + n1.cross(n2) * d3) / n1.dot(n2.cross(n3));
        let near = NEAR * from.distance(to);
        if offset.length_squared() <= near * near { seen + offset } else { seen }
    }

    /// True position of an end [scene unit].
    pub fn true_position(&self, placement: &Placement, end: End) -> DVec3 {
        match end {
            End::Vertex(v) => placement.true_position(v, placement.body_of_vertex(v)),
            End::Node(node) => {
                let Node { edge, edge_body, .. } = self.nodes[node as usize];
                let [a, b] = placement.ends(edge, edge_body).map(|v| placement.true_position(v, edge_body));
                a + (b - a) * self.positions_on_edge[node as usize]
            }
        }
    }

    /// Position on a node's edge, from 0 to 1: where the true edge passes through the plane of the true triangle, if
    /// that is near the perturbed position, otherwise the latter.
    fn position_on_edge(placement: &Placement, node: &Node) -> f64 {
        let Node { edge, edge_body, passage } = *node;
        let ends = placement.ends(edge, edge_body).map(|v| placement.true_position(v, edge_body));
        let [a, b, c] =
            placement.corners(passage.triangle, passage.body).map(|v| placement.true_position(v, passage.body));
        let normal = (b - a).cross(c - a);
        let [p, q] = ends.map(|end| normal.dot(end - a));
        let at = p / (p - q);
        if (0.0..=1.0).contains(&at) && (at - passage.at).abs() <= NEAR { at } else { passage.at }
    }
}

/// Largest accepted distance of a point's true position from its perturbed one [lengths of its line]. Displacements are
/// smaller, except where lines and triangles are nearly parallel; there, true positions may be out of order.
const NEAR: f64 = 1e-6;

/// Where three triangles meet.
#[derive(Clone, Copy)]
struct TriplePoint {
    triangles: [u32; 3],
    /// The segments through it that are not buried, with the position on each.
    on: [Option<(u32, Passage)>; 3],
}
