//! Distances from a point to a surface and between surfaces.
//!
//! Searches use a bounding volume hierarchy that is built once per topology and refitted to current positions. Results
//! do not depend on its structure: they are the smallest of all computed distances (of equal ones, that of the first
//! triangle), and boxes are skipped only if rounding cannot matter.

use glam::DVec3;

use super::{
    body::{Aabb, Body, higher, lower},
    report::{Failure, Meter},
};
use crate::geometry::mesh::solid_angle;

/// Number of steps from triangle to triangle before a search uses the hierarchy.
const WALK: usize = 4;

/// A bounding volume hierarchy of a body's blocks.
pub struct Tree<'t, 'a> {
    pub body: &'t Body<'a>,
    branches: &'a [Branch],
    /// The box of each branch.
    bounds: Vec<Aabb>,
    /// Squared distances below this are rounding errors [scene unit²].
    tiny: f64,
}

/// A node of a hierarchy of blocks: an inner node with two children, which follow it, or a block.
#[derive(Clone, Copy, Debug)]
pub struct Branch {
    /// Indices of the two child nodes, or the block twice.
    parts: [u32; 2],
    is_block: bool,
}

/// Builds a hierarchy of blocks with these boxes.
fn hierarchy(boxes: &[Aabb]) -> Vec<Branch> {
    /// Adds the node for some blocks and returns its index.
    fn split(middles: &[DVec3], blocks: &mut [u32], branches: &mut Vec<Branch>) -> u32 {
        let number = branches.len();
        if let [only] = *blocks {
            branches.push(Branch { parts: [only; 2], is_block: true });
            return number as u32;
        }
        let hull = Aabb::of(blocks.iter().map(|&b| middles[b as usize]));
        let extent = hull.max - hull.min;
        let axis = extent.max_position();
        let middle = blocks.len() / 2;
        let key = |b: u32| middles[b as usize][axis];
        blocks.select_nth_unstable_by(middle, |&a, &b| key(a).total_cmp(&key(b)).then(a.cmp(&b)));
        let (low, high) = blocks.split_at_mut(middle);
        branches.push(Branch { parts: [0; 2], is_block: false });
        let parts = [split(middles, low, branches), split(middles, high, branches)];
        branches[number].parts = parts;
        number as u32
    }
    let middles: Vec<DVec3> = boxes.iter().map(|bounds| bounds.min + bounds.max).collect();
    let mut blocks: Vec<u32> = (0..boxes.len() as u32).collect();
    let mut branches = Vec::with_capacity(2 * blocks.len());
    if !blocks.is_empty() {
        split(&middles, &mut blocks, &mut branches);
    }
    branches
}

/// The state of a search. Reused, because nearby points have nearby nearest triangles.
#[derive(Default)]
pub struct Search {
    /// The triangle to begin with: the nearest one of the last point, or one that proved it too near. Does not affect
    /// results.
    pub hint: u32,
    queue: Vec<(u32, f64)>,
}

/// The point of a surface that is nearest to a given point.
#[derive(Clone, Copy, Debug)]
pub struct Nearest {
    pub distance_squared: f64,
    pub position: DVec3,
    triangle: u32,
    feature: Feature,
}

/// The part of a triangle that is nearest.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Feature {
    Corner(usize),
    /// From corner k to corner k + 1.
    Edge(usize),
    Inside,
}

impl<'t, 'a> Tree<'t, 'a> {
    pub fn new(body: &'t Body<'a>) -> Self {
        let branches = body.topology.hierarchy.get_or_init(|| hierarchy(&body.block_bounds));
        let mut bounds = vec![Aabb::EMPTY; branches.len()];
        for (i, branch) in branches.iter().enumerate().rev() {
            bounds[i] = match branch.parts {
                [block, _] if branch.is_block => body.block_bounds[block as usize],
                [low, high] => bounds[low as usize].joined(&bounds[high as usize]),
            };
        }
        let extent = body.bounds.max - body.bounds.min + body.bounds.max.abs().max(body.bounds.min.abs());
        Tree { body, branches, bounds, tiny: 1e-20 * extent.length_squared() }
    }

    fn corners(&self, triangle: u32) -> [DVec3; 3] {
        self.body.corners(triangle)
    }

    /// The nearest point of the surface; `None` for a body without triangles, or if the point is known to be no farther
    /// than `least` [scene unit].
    fn nearest_beyond(&self, point: DVec3, least: f64, search: &mut Search) -> Option<Nearest> {
        let Search { hint, queue } = search;
        let least_squared = least * least;
        let first = *hint;
        let corners = self.body.topology.triangles.get(first as usize).map(|_| self.corners(first))?;
        let of = |triangle: u32, corners: [DVec3; 3]| {
            let (position, feature) = nearest_of_triangle(point, corners);
            Nearest { distance_squared: point.distance_squared(position), position, triangle, feature }
        };
        let mut best = of(first, corners);
        // a walk across the nearest edges often ends the search
        for _ in 0..WALK {
            let across = match best.feature {
                _ if best.distance_squared <= least_squared => break,
                Feature::Inside => break,
                Feature::Corner(k) | Feature::Edge(k) => {
                    let edge = self.body.topology.triangle_edges[best.triangle as usize][k];
                    self.body.topology.beside(edge, best.triangle)
                }
            };
            let next = of(across, self.corners(across));
            if next.distance_squared >= best.distance_squared {
                break;
            }
            best = next;
        }
        *hint = best.triangle;
        if best.distance_squared <= least_squared {
            return None;
        }
        queue.clear();
        queue.push((0, 0.0));
        while let Some((branch, bound)) = queue.pop() {
            if best.distance_squared <= least_squared {
                break;
            }
            if self.is_farther(bound, best.distance_squared) {
                continue;
            }
            let Branch { parts, is_block } = self.branches[branch as usize];
            if !is_block {
                let mut next = parts.map(|part| (part, point_to_box_squared(point, &self.bounds[part as usize])));
                if next[0].1 < next[1].1 {
                    next.swap(0, 1);
                }
                queue.extend(next.into_iter().filter(|next| !self.is_farther(next.1, best.distance_squared)));
                continue;
            }
            for &triangle in self.body.topology.block(parts[0] as usize) {
                let corners = self.corners(triangle);
                let [a, b, c] = corners;
                let bounds = Aabb { min: lower(lower(a, b), c), max: higher(higher(a, b), c) };
                if self.is_farther(point_to_box_squared(point, &bounds), best.distance_squared) {
                    continue;
                }
                let next = of(triangle, corners);
                if (next.distance_squared, triangle) < (best.distance_squared, best.triangle) {
                    best = next;
                }
            }
        }
        *hint = best.triangle;
        (best.distance_squared > least_squared).then_some(best)
    }

    /// Whether everything in a box at one squared distance is farther than another, allowing for rounding.
    #[inline]
    fn is_farther(&self, bound: f64, than: f64) -> bool {
        bound > than * (1.0 + 1e-9) + self.tiny
    }

    /// Depth of a point inside the body [scene unit], if it is more than `least` ≥ 0. The side is that of the normal at
    /// the nearest point; a corner's normal is weighted by angles (Bærentzen and Aanæs, *Signed Distance Computation
    /// Using the Angle Weighted Pseudonormal*, 2005). Of a body that may intersect itself, sheets of which may be turned
    /// over, it is that of the winding number.
    pub fn depth_beyond(&self, point: DVec3, least: f64, search: &mut Search) -> Option<f64> {
        let may_cross_itself = self.body.slack() <= 0.0;
        if may_cross_itself && !Aabb::of([point]).meets(&self.body.bounds) {
            return None;
        }
        let nearest = self.nearest_beyond(point, least, search)?;
        let depth = nearest.distance_squared.sqrt();
        if may_cross_itself {
            return (self.winding_number(point) > 0.5).then_some(depth);
        }
        let topology = self.body.topology;
        let normal_of = |t: u32| {
            let [a, b, c] = self.corners(t);
            (b - a).cross(c - a).normalize_or_zero()
        };
        let normal = match nearest.feature {
            Feature::Inside => normal_of(nearest.triangle),
            Feature::Edge(k) => {
                let edge = topology.triangle_edges[nearest.triangle as usize][k];
                let [one, other] = topology.edge_triangles[edge as usize];
                normal_of(one) + normal_of(other)
            }
            Feature::Corner(k) => {
                let vertex = topology.triangles[nearest.triangle as usize][k];
                let around = topology.edges_at(vertex).iter().map(|&edge| {
                    let (t, k) = topology.triangle_left_of(edge, vertex);
                    let corners = self.corners(t);
                    let (a, b) = (corners[(k + 1) % 3] - corners[k], corners[(k + 2) % 3] - corners[k]);
                    normal_of(t) * libm::atan2(a.cross(b).length(), a.dot(b))
                });
                around.sum()
            }
        };
        ((point - nearest.position).dot(normal) <= 0.0).then_some(depth)
    }

    /// How often the surface winds around a point (Jacobson et al., *Robust Inside-Outside Segmentation using Generalized
    /// Winding Numbers*, 2013).
    fn winding_number(&self, point: DVec3) -> f64 {
        let triangles = 0..self.body.topology.triangles.len() as u32;
        let angle = |t: u32| solid_angle(self.corners(t).map(|corner| corner - point));
        triangles.map(angle).sum::<f64>() / (2.0 * std::f64::consts::TAU)
    }

    /// The first result of `test` for triangles of this surface and of another whose blocks' boxes meet.
    pub fn first_of_near<T>(&self, other: &Tree, mut test: impl FnMut(u32, u32) -> Option<T>) -> Option<T> {
        let mut queue = if self.branches.is_empty() || other.branches.is_empty() { vec![] } else { vec![(0, 0)] };
        while let Some((a, b)) = queue.pop() {
            let (first, second) = (&self.branches[a as usize], &other.branches[b as usize]);
            let (here, there) = (&self.bounds[a as usize], &other.bounds[b as usize]);
            if !here.meets(there) {
                continue;
            }
            if !first.is_block && (second.is_block || here.size_squared() >= there.size_squared()) {
                queue.extend(first.parts.map(|a| (a, b)));
            } else if !second.is_block {
                queue.extend(second.parts.map(|b| (a, b)));
            } else {
                for &s in self.body.topology.block(first.parts[0] as usize) {
                    for &t in other.body.topology.block(second.parts[0] as usize) {
                        if let Some(found) = test(s, t) {
                            return Some(found);
                        }
                    }
                }
            }
        }
        None
    }

    /// The smallest squared distance to another surface, if it is below `best`, the distance of the triangles of `hint`;
    /// sets `hint` to the nearest ones. Only compares triangles that, in one direction, are near enough to the other
    /// surface: very few if this is the direction from one nearest point to the other. `None` if they are many.
    fn distance_along(
        &self,
        other: &Tree,
        direction: DVec3,
        mut best: f64,
        hint: &mut [u32; 2],
        meter: &Meter,
    ) -> Result<Option<f64>, Failure> {
        let Some(along) = direction.try_normalize() else { return Ok(None) };
        let (own, others) = (Heights::new(self.body, along), Heights::new(other.body, -along));
        // of the other surface, heights are negative depths: those of two points differ by their sum
        let is_near = |a: f64, b: f64, best: f64| {
            let apart = -(a + b);
            apart <= 0.0 || !self.is_farther(apart * apart, best)
        };
        let Some(first) = own.triangles(|a| is_near(a, others.highest, best)) else { return Ok(None) };
        let Some(second) = others.triangles(|b| is_near(own.highest, b, best)) else { return Ok(None) };
        meter.spend((first.len() * second.len()) as u64 + 1)?;
        let second: Vec<(u32, f64, [DVec3; 3], Aabb)> = (second.into_iter())
            .map(|(t, b)| {
                let corners = other.corners(t);
                (t, b, corners, Aabb::of(corners))
            })
            .collect();
        for (s, a) in first {
            let corners = self.corners(s);
            let hull = Aabb::of(corners);
            for (t, b, others, bounds) in &second {
                if is_near(a, *b, best) && !self.is_farther(box_to_box_squared(&hull, bounds), best) {
                    let squared = between(corners, *others).length_squared();
                    if squared < best {
                        (best, *hint) = (squared, [s, *t]);
                    }
                }
            }
        }
        Ok(Some(best))
    }

    fn has(&self, triangle: u32) -> bool {
        (triangle as usize) < self.body.topology.triangles.len()
    }

    /// The smallest distance to another surface that does not intersect this one [scene unit]. The search begins with
    /// the triangles of `hint`, and sets it to the nearest ones.
    ///
    /// # Errors
    /// The meter's.
    pub fn distance(&self, other: &Tree, hint: &mut [u32; 2], meter: &Meter) -> Result<f64, Failure> {
        let mut best = f64::INFINITY;
        if self.branches.is_empty() || other.branches.is_empty() {
            return Ok(best);
        }
        if let ([s, t], true) = (*hint, self.has(hint[0]) && other.has(hint[1])) {
            let (corners, others) = (self.corners(s), other.corners(t));
            best = between(corners, others).length_squared();
            if let Some(nearest) = self.distance_along(other, between(corners, others), best, hint, meter)? {
                return Ok(nearest.sqrt());
            }
        }
        let mut queue = vec![(0, 0, 0.0)];
        while let Some((a, b, bound)) = queue.pop() {
            if self.is_farther(bound, best) {
                continue;
            }
            let (first, second) = (&self.branches[a as usize], &other.branches[b as usize]);
            let (here, there) = (&self.bounds[a as usize], &other.bounds[b as usize]);
            let mut next = if !first.is_block && (second.is_block || here.size_squared() >= there.size_squared()) {
                first.parts.map(|a| (a, b, 0.0))
            } else if !second.is_block {
                second.parts.map(|b| (a, b, 0.0))
            } else {
                meter.spend(16)?;
                for &s in self.body.topology.block(first.parts[0] as usize) {
                    let corners = self.corners(s);
                    let hull = Aabb::of(corners);
                    for &t in other.body.topology.block(second.parts[0] as usize) {
                        let others = other.corners(t);
                        if !self.is_farther(box_to_box_squared(&hull, &Aabb::of(others)), best) {
                            let squared = between(corners, others).length_squared();
                            if squared < best {
                                (best, *hint) = (squared, [s, t]);
                            }
                        }
                    }
                }
                continue;
            };
            for (a, b, bound) in &mut next {
                *bound = box_to_box_squared(&self.bounds[*a as usize], &other.bounds[*b as usize]);
            }
            if next[0].2 < next[1].2 {
                next.swap(0, 1);
            }
            queue.extend(next);
        }
        Ok(best.sqrt())
    }
}

/// Most triangles of a surface that are compared with those of another without a hierarchy.
const FEW: usize = 48;

/// Heights of a body's vertices in a direction.
struct Heights<'t, 'a> {
    body: &'t Body<'a>,
    along: DVec3,
    of_vertices: Vec<f64>,
    highest: f64,
}

impl<'t, 'a> Heights<'t, 'a> {
    fn new(body: &'t Body<'a>, along: DVec3) -> Self {
        let of_vertices: Vec<f64> = body.positions.iter().map(|at| along.dot(*at)).collect();
        let highest = of_vertices.iter().copied().fold(f64::NEG_INFINITY, |a, b| if b > a { b } else { a });
        Heights { body, along, of_vertices, highest }
    }

    /// The triangles whose highest corner is accepted, and its height; `None` if they are more than [`FEW`]. If a height
    /// is accepted, so are higher ones.
    fn triangles(&self, is_accepted: impl Fn(f64) -> bool) -> Option<Vec<(u32, f64)>> {
        let topology = self.body.topology;
        let mut found = Vec::new();
        for (block, bounds) in self.body.block_bounds.iter().enumerate() {
            let highest = (self.along * bounds.min).max(self.along * bounds.max).element_sum();
            // allows for rounding of this sum
            if !is_accepted(highest + 1e-12 * (highest.abs() + self.highest.abs())) {
                continue;
            }
            for &t in topology.block(block) {
                let corners = topology.triangles[t as usize];
                let height = corners.map(|v| match self.of_vertices.get(v as usize) {
                    Some(&height) => height,
                    None => self.along.dot(self.body.position(v)),
                });
                let height = height[0].max(height[1]).max(height[2]);
                if is_accepted(height) {
                    found.push((t, height));
                }
            }
            if found.len() > FEW {
                return None;
            }
        }
        Some(found)
    }
}

/// The width of the gap between two bodies, measured along a direction from the first to the second [scene unit]; not
/// positive if no plane across it separates them.
pub fn separation(first: &Body, second: &Body, along: DVec3) -> f64 {
    let Some(along) = along.try_normalize() else { return f64::NEG_INFINITY };
    -(Heights::new(first, along).highest + Heights::new(second, -along).highest)
}

fn point_to_box_squared(point: DVec3, bounds: &Aabb) -> f64 {
    (bounds.min - point).max(point - bounds.max).max(DVec3::ZERO).length_squared()
}

fn box_to_box_squared(a: &Aabb, b: &Aabb) -> f64 {
    (a.min - b.max).max(b.min - a.max).max(DVec3::ZERO).length_squared()
}

/// Nearest point of a triangle (Ericson, *Real-Time Collision Detection*, 2005, section 5.1.5).
fn nearest_of_triangle(p: DVec3, [a, b, c]: [DVec3; 3]) -> (DVec3, Feature) {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return (a, Feature::Corner(0));
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return (b, Feature::Corner(1));
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return (a + ab * (d1 / (d1 - d3)), Feature::Edge(0));
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return (c, Feature::Corner(2));
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return (a + ac * (d2 / (d2 - d6)), Feature::Edge(2));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        return (b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6))), Feature::Edge(1));
    }
    let share = 1.0 / (va + vb + vc);
    (a + ab * (vb * share) + ac * (vc * share), Feature::Inside)
}

/// A vector from a point of one triangle to one of another, about as near as they are.
fn between(first: [DVec3; 3], second: [DVec3; 3]) -> DVec3 {
    let corners = |of: [DVec3; 3], to: [DVec3; 3]| of.map(|p| nearest_of_triangle(p, to).0 - p);
    let mut all = [corners(first, second), corners(second, first).map(|back| -back)].into_iter().flatten();
    let mut least = all.next().unwrap_or_default();
    for vector in all {
        if vector.length_squared() < least.length_squared() {
            least = vector;
        }
    }
    for i in 0..3 {
        for j in 0..3 {
            let [p, q] = nearest_of_edges([first[i], first[(i + 1) % 3]], [second[j], second[(j + 1) % 3]]);
            if p.distance_squared(q) < least.length_squared() {
                least = q - p;
            }
        }
    }
    least
}

/// The nearest points of two edges (Ericson 2005, section 5.1.9).
fn nearest_of_edges([p1, q1]: [DVec3; 2], [p2, q2]: [DVec3; 2]) -> [DVec3; 2] {
    let (d1, d2, r) = (q1 - p1, q2 - p2, p1 - p2);
    let (a, e, f) = (d1.length_squared(), d2.length_squared(), d2.dot(r));
    let (b, c) = (d1.dot(d2), d1.dot(r));
    let ratio = |x: f64, y: f64| if y > 0.0 { (x / y).clamp(0.0, 1.0) } else { 0.0 };
    let mut s = ratio(b * f - c * e, a * e - b * b);
    let t = ratio(b * s + f, e);
    s = ratio(b * t - c, a);
    [p1 + d1 * s, p2 + d2 * t]
}
