//! Winding numbers of bodies: at vertices by flood fill from known values, along edges and segments by counting the
//! triangles that these pass through.
//!
//! "In front" of a surface means next to it on the outer side. Behind a triangle of a body its winding number is larger
//! by one.

use glam::DVec3;
use rayon::prelude::*;
use rustc_hash::FxHashMap;

use super::{
    arrangement::{Arrangement, End, is_in_front},
    bits::Ranks,
    body::Aabb,
    candidates::Meeting,
    placement::Placement,
    report::{Failure, Meter},
};

/// Vertex, body, and the body's winding number in front of the surface there.
type AtVertex = (u32, u32, i32);

/// Winding numbers of bodies, by body, without those that are 0.
type Windings = Vec<(u32, i32)>;

#[inline]
fn add(windings: &mut Windings, body: u32, by: i32) {
    match windings.iter().position(|w| w.0 >= body) {
        Some(i) if windings[i].0 == body => {
            windings[i].1 += by;
            if windings[i].1 == 0 {
                windings.remove(i);
            }
        }
        Some(i) => windings.insert(i, (body, by)),
        None => windings.push((body, by)),
    }
}

#[inline]
fn of(windings: &[(u32, i32)], body: u32) -> i32 {
    windings.iter().find(|w| w.0 == body).map_or(0, |w| w.1)
}

/// Whether a point is inside a body other than the two given ones.
#[inline]
fn is_inside_another(windings: &[(u32, i32)], a: u32, b: u32) -> bool {
    windings.iter().any(|w| w.1 >= 1 && w.0 != a && w.0 != b)
}

/// Whether a body's surface bounds the union, from the winding numbers in front of it: nothing in front, something
/// behind.
#[inline]
fn is_boundary(front: &[(u32, i32)], body: u32) -> bool {
    of(front, body) == 0 && !is_inside_another(front, body, body)
}

/// Bits for which of a segment's four neighbouring half-triangles bound the union; the bits above them are for which of
/// the four sectors about it are occupied.
pub mod shown {
    /// The part of the first triangle that is in front of the second.
    pub const FIRST_IN_FRONT: u8 = 1;
    /// The part of the first triangle that is behind the second.
    pub const FIRST_BEHIND: u8 = 2;
    /// The part of the second triangle that is in front of the first.
    pub const SECOND_IN_FRONT: u8 = 4;
    /// The part of the second triangle that is behind the first.
    pub const SECOND_BEHIND: u8 = 8;
}

/// The parts of the surfaces that bound the union, by winding numbers.
pub struct Classified {
    /// Ranks of the vertices with non-zero winding numbers in front of the surface.
    wound: Ranks,
    /// Start of the winding numbers of each of them in `windings`, followed by the end.
    first_winding: Vec<u32>,
    windings: Windings,
    /// For vertices where segments start because triangles of their own body pass through their fan: the body's winding
    /// number in front of an edge there, relative to that in front of the first edge.
    over_first_edge: FxHashMap<(u32, u32), i32>,
    /// Such vertices, ascending.
    pub fan_vertices: Vec<u32>,
    /// Vertices with non-zero winding numbers, ascending.
    pub vertices: Vec<u32>,
    /// For every node, whether its edge bounds the union before it and after it.
    pub edge_shown: Vec<[bool; 2]>,
    /// For every segment, the start of its parts in `parts`; it has one more part than triple points.
    pub first_part: Vec<u32>,
    /// Bits of each part, see [`shown`].
    pub parts: Vec<u8>,
    /// For every node, the winding numbers in front of the edge's surface and of the triangle, as a range of `fronts`.
    node_fronts: Vec<(u32, u32)>,
    fronts: Windings,
}

impl Classified {
    /// Computes the winding numbers at the vertices and nodes, and marks buried segments.
    pub fn new(
        placement: &Placement,
        meetings: &[Meeting],
        arrangement: &mut Arrangement,
        meter: &Meter,
        threads: bool,
    ) -> Result<Classified, Failure> {
        let mut classified = Classified {
            wound: Ranks::default(),
            first_winding: Vec::new(),
            windings: Vec::new(),
            over_first_edge: FxHashMap::default(),
            fan_vertices: Vec::new(),
            vertices: Vec::new(),
            edge_shown: Vec::with_capacity(arrangement.nodes.len()),
            first_part: Vec::new(),
            parts: Vec::new(),
            node_fronts: Vec::with_capacity(arrangement.nodes.len()),
            fronts: Vec::new(),
        };
        classified.walk_fans(placement, arrangement)?;
        classified.flood(placement, meetings, arrangement, meter, threads)?;
        classified.walk_edges(placement, arrangement, meter)?;
        classified.bury(placement, arrangement);
        Ok(classified)
    }

    /// Finds the winding numbers around every vertex at which segments start.
    fn walk_fans(&mut self, placement: &Placement, arrangement: &Arrangement) -> Result<(), Failure> {
        let fan_vertex = |s: &super::arrangement::Segment| match s.ends[1] {
            End::Vertex(v) => Some(v),
            End::Node(_) => None,
        };
        self.fan_vertices = arrangement.segments.iter().filter_map(fan_vertex).collect();
        self.fan_vertices.sort_unstable();
        self.fan_vertices.dedup();
        for &vertex in &self.fan_vertices {
            let body = placement.body_of_vertex(vertex);
            let topology = placement.bodies[body as usize].topology;
            let (first_vertex, first_edge, first_triangle) = (
                placement.first_vertex[body as usize],
                placement.first_edge[body as usize],
                placement.first_triangle[body as usize],
            );
            let local = vertex - first_vertex;
            let start = topology.edges_at(local)[0];
            let (mut edge, mut over) = (start, 0);
            loop {
                self.over_first_edge.insert((vertex, edge + first_edge), over);
                let (t, k) = topology.triangle_left_of(edge, local);
                let corners = topology.triangles[t as usize];
                let [from, to] = [1, 2].map(|i| placement.placed(corners[(k + i) % 3] + first_vertex));
                for &(t, segment) in arrangement.segments_of(t + first_triangle) {
                    let segment = &arrangement.segments[segment as usize];
                    if segment.ends[1] != End::Vertex(vertex) {
                        continue;
                    }
                    let passed = segment.triangles[usize::from(segment.triangles[0] == t)];
                    let [a, b, c] = placement.placed_corners(passed, body);
                    let enters = is_in_front(a, b, c, from)?;
                    if enters == is_in_front(a, b, c, to)? {
                        return Err(Failure::Inconsistent("a fan that is passed through is not"));
                    }
                    over += if enters { 1 } else { -1 };
                }
                edge = topology.triangle_edges[t as usize][(k + 2) % 3];
                if edge == start {
                    break;
                }
            }
            if over != 0 {
                return Err(Failure::Inconsistent("around a vertex"));
            }
        }
        Ok(())
    }

    fn over_first_edge(&self, vertex: u32, edge: u32) -> i32 {
        if self.fan_vertices.is_empty() { 0 } else { self.over_first_edge.get(&(vertex, edge)).copied().unwrap_or(0) }
    }

    fn flood(
        &mut self,
        placement: &Placement,
        meetings: &[Meeting],
        arrangement: &Arrangement,
        meter: &Meter,
        threads: bool,
    ) -> Result<(), Failure> {
        let of_meeting = |meeting: &Meeting| -> Result<Vec<AtVertex>, Failure> {
            let mut found = Vec::new();
            for k in 0..2 {
                let flood = Flood { placement, arrangement, me: meeting.bodies[k], other: meeting.bodies[1 - k] };
                flood.of_other(&meeting.blocks[k], meter, &mut found)?;
            }
            Ok(found)
        };
        let of_fold = |body: u32| {
            let mut found = Vec::new();
            let flood = Flood { placement, arrangement, me: body, other: body };
            flood.of_itself(self, meter, &mut found)?;
            Ok(found)
        };
        let folds: Vec<u32> = (0..placement.bodies.len() as u32).filter(|&b| placement.folds[b as usize]).collect();
        let found: Result<Vec<Vec<AtVertex>>, Failure> = if threads {
            (meetings.par_iter().map(of_meeting)).chain(folds.par_iter().map(|&b| of_fold(b))).collect()
        } else {
            (meetings.iter().map(of_meeting)).chain(folds.iter().map(|&b| of_fold(b))).collect()
        };
        let mut found = found?.concat();
        found.sort_unstable();
        for group in found.chunk_by(|a, b| a.0 == b.0) {
            self.first_winding.push(self.windings.len() as u32);
            self.windings.extend(group.iter().map(|&(_, body, winding)| (body, winding)));
            self.vertices.push(group[0].0);
        }
        self.first_winding.push(self.windings.len() as u32);
        self.wound = Ranks::new(placement.first_vertex[placement.bodies.len()], &self.vertices);
        Ok(())
    }

    /// Winding numbers in front of the surface at a vertex, on its first edge.
    fn at(&self, vertex: u32) -> &[(u32, i32)] {
        let range = |k: usize| self.first_winding[k] as usize..self.first_winding[k + 1] as usize;
        self.wound.of(vertex).map_or(&[], |k| &self.windings[range(k)])
    }

    /// Winding numbers in front of the surface at a vertex of an edge, on that edge.
    fn front_at(&self, vertex: u32, edge: u32, body: u32, windings: &mut Windings) {
        windings.clear();
        windings.extend_from_slice(self.at(vertex));
        let over = self.over_first_edge(vertex, edge);
        if over != 0 {
            add(windings, body, over);
        }
    }

    /// Whether all edges at a vertex have the same winding numbers in front of them.
    pub fn is_plain(&self, vertex: u32) -> bool {
        self.fan_vertices.binary_search(&vertex).is_err()
    }

    /// Whether the surface bounds the union at a vertex of an edge that has no node, or before the first node.
    pub fn is_shown_at(&self, vertex: u32, edge: u32, body: u32) -> bool {
        let at = self.at(vertex);
        of(at, body) + self.over_first_edge(vertex, edge) == 0 && !is_inside_another(at, body, body)
    }

    fn walk_edges(&mut self, placement: &Placement, arrangement: &Arrangement, meter: &Meter) -> Result<(), Failure> {
        let (mut front, mut end) = (Windings::new(), Windings::new());
        for nodes in arrangement.nodes.chunk_by(|a, b| a.edge == b.edge) {
            let (edge, body) = (nodes[0].edge, nodes[0].edge_body);
            if placement.is_edge_buried(edge - placement.first_edge[body as usize], body) {
                // no part of it bounds the union, and not all of its nodes are known
                self.node_fronts.extend(nodes.iter().map(|_| (0, 0)));
                self.edge_shown.extend(nodes.iter().map(|_| [false; 2]));
                continue;
            }
            let [a, b] = placement.ends(edge, body);
            self.front_at(a, edge, body, &mut front);
            meter.spend((nodes.len() * (1 + front.len() / 4)) as u64)?;
            let mut before = is_boundary(&front, body);
            for node in nodes {
                let enters = node.passage.enters();
                if !enters {
                    add(&mut front, node.passage.body, -1);
                }
                let from = self.fronts.len() as u32;
                self.fronts.extend_from_slice(&front);
                self.node_fronts.push((from, self.fronts.len() as u32));
                if enters {
                    add(&mut front, node.passage.body, 1);
                }
                let after = is_boundary(&front, body);
                self.edge_shown.push([before, after]);
                before = after;
            }
            self.front_at(b, edge, body, &mut end);
            if front != end {
                return Err(Failure::Inconsistent("winding numbers along an edge"));
            }
        }
        Ok(())
    }

    fn front_of(&self, node: u32) -> &[(u32, i32)] {
        let (from, to) = self.node_fronts[node as usize];
        &self.fronts[from as usize..to as usize]
    }

    /// Marks segments that lie inside a third body: those of triangles inside one, and those with both ends in the ball
    /// inside one, which is convex.
    fn bury(&self, placement: &Placement, arrangement: &mut Arrangement) {
        let buried: Vec<bool> = (arrangement.segments.iter())
            .map(|segment| {
                if segment.triangles.iter().any(|&t| placement.is_buried(t)) {
                    return true;
                }
                let [End::Node(from), End::Node(to)] = segment.ends else { return false };
                let last = self.front_of(to);
                self.front_of(from).iter().any(|&(body, winding)| {
                    if winding < 1 || segment.bodies.contains(&body) || of(last, body) < 1 {
                        return false;
                    }
                    let mesh = placement.bodies[body as usize];
                    let radius = mesh.inner_radius() * 0.999 - 4.0 * placement.displaced[body as usize];
                    !placement.folds[body as usize]
                        && radius > 0.0
                        && segment.ends.iter().all(|&end| {
                            arrangement.true_position(placement, end).distance_squared(mesh.centre) < radius * radius
                        })
                })
            })
            .collect();
        for (segment, buried) in arrangement.segments.iter_mut().zip(buried) {
            segment.buried = buried;
        }
    }

    /// Finds which sides of the segments bound the union, from the nodes at which they start.
    pub fn walk_segments(&mut self, arrangement: &Arrangement, meter: &Meter) -> Result<(), Failure> {
        let mut front = Windings::new();
        self.first_part.reserve(arrangement.segments.len() + 1);
        for segment in &arrangement.segments {
            self.first_part.push(self.parts.len() as u32);
            if segment.buried {
                self.parts.push(0);
                continue;
            }
            let End::Node(from) = segment.ends[0] else {
                return Err(Failure::Inconsistent("a segment that starts at no node"));
            };
            front.clear();
            front.extend_from_slice(self.front_of(from));
            meter.spend(segment.passages.len() as u64 + 1)?;
            self.parts.push(shown_beside(&front, segment.bodies));
            for (passage, _) in &segment.passages {
                add(&mut front, passage.body, if passage.enters() { 1 } else { -1 });
                self.parts.push(shown_beside(&front, segment.bodies));
            }
            if let End::Node(to) = segment.ends[1]
                && front != self.front_of(to)
            {
                return Err(Failure::Inconsistent("winding numbers along a segment"));
            }
        }
        self.first_part.push(self.parts.len() as u32);
        Ok(())
    }
}

/// The bits of [`shown`]; `front` are the winding numbers in front of both triangles.
fn shown_beside(front: &[(u32, i32)], [a, b]: [u32; 2]) -> u8 {
    if is_inside_another(front, a, b) {
        return 0b1111_0000;
    }
    // sectors: in front of both; behind the first; behind the second; behind both
    let (in_a, in_b) = (of(front, a), of(front, b));
    let [both_in_front, behind_first, behind_second, behind_both] = if a == b {
        [in_a >= 1, in_a >= 0, in_a >= 0, in_a >= -1]
    } else {
        [in_a >= 1 || in_b >= 1, in_a >= 0 || in_b >= 1, in_a >= 1 || in_b >= 0, in_a >= 0 || in_b >= 0]
    };
    let bit = |front: bool, back: bool, bit: u8| if !front && back { bit } else { 0 };
    let occupied = [both_in_front, behind_first, behind_second, behind_both];
    let quarters = (0..4).map(|k| u8::from(occupied[k]) << (4 + k)).sum::<u8>();
    quarters
        | bit(both_in_front, behind_first, shown::FIRST_IN_FRONT)
        | bit(behind_second, behind_both, shown::FIRST_BEHIND)
        | bit(both_in_front, behind_second, shown::SECOND_IN_FRONT)
        | bit(behind_first, behind_both, shown::SECOND_BEHIND)
}

/// Flood fill of the winding numbers of a body at the vertices of another body, or of itself.
struct Flood<'f, 'a, 'b> {
    placement: &'f Placement<'a, 'b>,
    arrangement: &'f Arrangement,
    me: u32,
    other: u32,
}

/// A vertex outside the region of the flood.
const BEYOND: i32 = 0;
/// A vertex in the region without a number yet.
const UNSET: i32 = 1;
/// The number 0, as an offset.
const ZERO: i32 = 1 << 24;

impl Flood<'_, '_, '_> {
    /// The change of the winding number along an edge from one of its ends: entering the other body adds one.
    #[inline]
    fn change_along(&self, edge: u32, from: u32) -> i32 {
        let first_edge = self.placement.first_edge[self.me as usize];
        let nodes = self.arrangement.nodes_of(edge + first_edge);
        if nodes.is_empty() {
            return 0;
        }
        let passed = nodes.iter().map(|n| &n.passage).filter(|p| p.body == self.other);
        let sum: i32 = passed.map(|p| if p.enters() { 1 } else { -1 }).sum();
        if self.placement.bodies[self.me as usize].topology.edges[edge as usize][0] == from { sum } else { -sum }
    }

    /// Finds the non-zero winding numbers in front of this body's surface at its vertices in the other body's hull.
    fn of_other(&self, blocks: &[u32], meter: &Meter, found: &mut Vec<AtVertex>) -> Result<(), Failure> {
        if blocks.is_empty() {
            return Ok(());
        }
        let placement = self.placement;
        let mesh = placement.bodies[self.me as usize];
        let topology = mesh.topology;
        let margin = placement.displaced[self.me as usize] + placement.displaced[self.other as usize];
        let there = placement.bodies[self.other as usize].hull(margin);
        // not all nodes of edges inside other bodies are known; vertices without other edges need no numbers
        let is_known = |edge: &&u32| !placement.is_edge_buried(**edge, self.me);
        let mut state = vec![BEYOND; topology.fan_count()];
        let mut inside = Vec::new();
        for &block in blocks.iter().filter(|&&block| placement.is_block_shown(block, self.me)) {
            for &v in topology.vertices_of_block(block as usize) {
                if state[v as usize] == BEYOND
                    && there.contains(mesh.position(v))
                    && topology.edges_at(v).iter().any(|edge| is_known(&edge))
                {
                    state[v as usize] = UNSET;
                    inside.push(v);
                }
            }
        }
        meter.spend((inside.len() + blocks.len()) as u64)?;

        // outside the hull all winding numbers are 0: start there and proceed inwards
        let mut queue = Vec::new();
        for &v in &inside {
            let mut edges = topology.edges_at(v).iter().filter(is_known);
            let outwards = edges.find(|&&e| state[topology.across(e, v) as usize] == BEYOND);
            if let Some(&edge) = outwards {
                state[v as usize] = ZERO + self.change_along(edge, topology.across(edge, v));
                queue.push(v);
            }
        }
        let mut next = 0;
        loop {
            while let Some(v) = queue.pop() {
                for &edge in topology.edges_at(v).iter().filter(is_known) {
                    let across = topology.across(edge, v);
                    if state[across as usize] == UNSET {
                        state[across as usize] = state[v as usize] + self.change_along(edge, v);
                        queue.push(across);
                    }
                }
            }
            // the rest are components that lie entirely inside the hull
            while next < inside.len() && state[inside[next] as usize] != UNSET {
                next += 1;
            }
            let Some(&v) = inside.get(next) else { break };
            let from = placement.placed_or_not(v + placement.first_vertex[self.me as usize], self.me);
            let direction = from - placement.bodies[self.other as usize].centre * placement.scale();
            let ray = Ray { placement, body: self.other, from, skipped: [u32::MAX; 2] };
            state[v as usize] = ZERO + ray.cast(direction, meter)?;
            queue.push(v);
        }
        let first_vertex = placement.first_vertex[self.me as usize];
        let set = inside.iter().map(|&v| (v, state[v as usize] - ZERO)).filter(|&(_, winding)| winding != 0);
        found.extend(set.map(|(v, winding)| (v + first_vertex, self.other, winding)));
        Ok(())
    }

    /// Finds where this body's own winding number in front of its surface is not 0.
    fn of_itself(&self, classified: &Classified, meter: &Meter, found: &mut Vec<AtVertex>) -> Result<(), Failure> {
        let placement = self.placement;
        let topology = placement.bodies[self.me as usize].topology;
        let first_vertex = placement.first_vertex[self.me as usize];
        let first_edge = placement.first_edge[self.me as usize];
        let over = |v: u32, e: u32| classified.over_first_edge(v + first_vertex, e + first_edge);
        let mut state = vec![BEYOND; topology.fan_count()];
        for start in 0..topology.fan_count() as u32 {
            if state[start as usize] != BEYOND || topology.edges_at(start).is_empty() {
                continue;
            }
            let (v, edge) = self.seed_near(start);
            let winding = self.cast_from(v, edge, meter)?;
            state[v as usize] = ZERO + winding - over(v, edge);
            let mut queue = vec![v];
            while let Some(v) = queue.pop() {
                meter.spend(1)?;
                for &edge in topology.edges_at(v) {
                    let across = topology.across(edge, v);
                    let winding = state[v as usize] + over(v, edge) + self.change_along(edge, v) - over(across, edge);
                    if state[across as usize] == BEYOND {
                        state[across as usize] = winding;
                        queue.push(across);
                    } else if state[across as usize] != winding {
                        return Err(Failure::Inconsistent("winding numbers of a body about itself"));
                    }
                }
            }
        }
        let set =
            (0..topology.fan_count() as u32).map(|v| (v, state[v as usize])).filter(|w| w.1 != BEYOND && w.1 != ZERO);
        found.extend(set.map(|(v, winding)| (v + first_vertex, self.me, winding - ZERO)));
        Ok(())
    }

    /// Among the first edges of a component, the one, with its vertex, that has the longest free part from that vertex
    /// and the flattest surroundings.
    fn seed_near(&self, start: u32) -> (u32, u32) {
        let topology = self.placement.bodies[self.me as usize].topology;
        let (first_vertex, first_edge) =
            (self.placement.first_vertex[self.me as usize], self.placement.first_edge[self.me as usize]);
        let mut best = (-1.0, start, topology.edges_at(start)[0]);
        let mut seen = vec![start];
        let mut at = 0;
        while at < seen.len() {
            let v = seen[at];
            at += 1;
            for &edge in topology.edges_at(v) {
                let [a, b] = topology.edges[edge as usize];
                let length = self.placement.placed(a + first_vertex).distance(self.placement.placed(b + first_vertex));
                let free = length * self.free_from(edge + first_edge, a == v) * self.outwards(edge).length();
                if free > best.0 {
                    best = (free, v, edge);
                }
                let across = topology.across(edge, v);
                if seen.len() < 32 && !seen.contains(&across) {
                    seen.push(across);
                }
            }
        }
        (best.1, best.2)
    }

    /// Sum of the unit normals beside an edge.
    fn outwards(&self, edge: u32) -> DVec3 {
        let topology = self.placement.bodies[self.me as usize].topology;
        let first_vertex = self.placement.first_vertex[self.me as usize];
        let normals = topology.edge_triangles[edge as usize].map(|t| {
            let [x, y, z] = topology.triangles[t as usize].map(|v| self.placement.placed(v + first_vertex));
            (y - x).cross(z - x).normalize_or_zero()
        });
        normals[0] + normals[1]
    }

    /// The fraction of an edge before the first node from one of its ends.
    fn free_from(&self, edge: u32, from_first: bool) -> f64 {
        let nodes = self.arrangement.nodes_of(edge);
        match if from_first { nodes.first() } else { nodes.last() } {
            Some(node) if from_first => node.passage.at,
            Some(node) => 1.0 - node.passage.at,
            None => 1.0,
        }
    }

    /// This body's winding number in front of an edge, at its vertex `v`.
    fn cast_from(&self, v: u32, edge: u32, meter: &Meter) -> Result<i32, Failure> {
        let placement = self.placement;
        let topology = placement.bodies[self.me as usize].topology;
        let (b, first_edge) = (self.me as usize, placement.first_edge[self.me as usize]);
        let position = |v: u32| placement.placed(v + placement.first_vertex[b]);
        let free = self.free_from(edge + first_edge, topology.edges[edge as usize][0] == v);
        let from = position(v) + (position(topology.across(edge, v)) - position(v)) * (0.5 * free);
        // the ray starts on both triangles of the edge and leaves in front of them, so they are skipped
        let skipped = topology.edge_triangles[edge as usize];
        Ray { placement, body: self.me, from, skipped }.cast(self.outwards(edge), meter)
    }
}

/// A ray from a perturbed position to beyond a body.
struct Ray<'f, 'a, 'b> {
    placement: &'f Placement<'a, 'b>,
    body: u32,
    from: DVec3,
    skipped: [u32; 2],
}

impl Ray<'_, '_, '_> {
    /// The body's winding number at the ray's origin: the signed count of passages out of the body.
    fn cast(&self, direction: DVec3, meter: &Meter) -> Result<i32, Failure> {
        let placement = self.placement;
        let mesh = placement.bodies[self.body as usize];
        let scale = placement.scale();
        let margin = placement.displaced[self.body as usize] * scale;
        let scaled = |bounds: &Aabb| Aabb { min: bounds.min * scale, max: bounds.max * scale }.grown(margin);
        let all = scaled(&mesh.bounds);
        let reach = 2.0 * (all.max - all.min).length() + (self.from - all.min).length();
        let to = self.from + direction.normalize_or(DVec3::X) * reach;
        let span = to - self.from;
        let mut winding = 0;
        meter.spend(mesh.block_bounds.len() as u64 / 4 + 1)?;
        for (block, bounds) in mesh.block_bounds.iter().enumerate() {
            let bounds = scaled(bounds);
            let (one, other) = ((bounds.min - self.from) / span, (bounds.max - self.from) / span);
            // a zero component gives infinities, or NaN, which minimum and maximum ignore
            let (enter, leave) = (one.min(other).max_element(), one.max(other).min_element());
            if enter > leave + 1e-9 || leave < -1e-9 || enter > 1.0 {
                continue;
            }
            for &t in mesh.topology.block(block) {
                if self.skipped.contains(&t) {
                    continue;
                }
                let [a, b, c] = mesh.topology.triangles[t as usize]
                    .map(|v| placement.placed_or_not(v + placement.first_vertex[self.body as usize], self.body));
                let turn = is_in_front(self.from, to, a, b)?;
                if is_in_front(self.from, to, b, c)? != turn || is_in_front(self.from, to, c, a)? != turn {
                    continue;
                }
                let starts_in_front = is_in_front(a, b, c, self.from)?;
                if starts_in_front != is_in_front(a, b, c, to)? {
                    winding += if starts_in_front { -1 } else { 1 };
                }
            }
        }
        Ok(winding)
    }
}

/// Whether there are enough meetings for several threads to pay off.
pub fn is_worth_threads(meetings: &[Meeting]) -> bool {
    meetings.iter().map(|m| m.blocks[0].len() + m.blocks[1].len()).sum::<usize>() > 256
}
