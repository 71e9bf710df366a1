//! Whether two surfaces touch, which a single crossing of an edge and a triangle proves.

use glam::DVec3;

use super::{
    body::{Aabb, Body},
    distance::{Search, Tree},
};

/// A volume below this fraction of a product of lengths counts as zero, so that a crossing at a corner counts. The
/// corresponding displacement is far too small to be visible.
const ZERO: f64 = 1e-12;

/// How two surfaces touch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Contact {
    /// An edge of one body passes through a triangle of the other.
    Crossing(Crossing),
    /// One body, or a separate piece of it, is inside the other.
    Inside,
}

/// An edge that passes through a triangle, given by vertex indices.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Crossing {
    /// Whether the edge belongs to the second body and the triangle to the first.
    is_of_second: bool,
    edge: [u32; 2],
    triangle: [u32; 3],
}

impl Crossing {
    /// Whether the edge passes through the triangle with the vertices of the two bodies at these positions.
    pub fn is_at(&self, first: &[DVec3], second: &[DVec3]) -> bool {
        let (edges, triangles) = if self.is_of_second { (second, first) } else { (first, second) };
        passes(self.edge.map(|v| edges[v as usize]), self.triangle.map(|v| triangles[v as usize]))
    }
}

/// How two bodies touch; `None` if they are apart.
pub fn contact(a: &Body, b: &Body) -> Option<Contact> {
    if !a.bounds.meets(&b.bounds) {
        return None;
    }
    let trees = [Tree::new(a), Tree::new(b)];
    let crossing = trees[0].first_of_near(&trees[1], |s, t| {
        let (first, second) = (a.topology.triangles[s as usize], b.topology.triangles[t as usize]);
        let (p, q) = (first.map(|v| a.position(v)), second.map(|v| b.position(v)));
        if !Aabb::of(p).meets(&Aabb::of(q)) {
            return None;
        }
        let given = |body: &Body, vertex: u32| body.topology.given_vertex(vertex);
        (0..3).find_map(|k| {
            let l = (k + 1) % 3;
            if passes([p[k], p[l]], q) {
                let (edge, triangle) = ([first[k], first[l]], second);
                let (edge, triangle) = (edge.map(|v| given(a, v)), triangle.map(|v| given(b, v)));
                return Some(Crossing { is_of_second: false, edge, triangle });
            }
            if passes([q[k], q[l]], p) {
                let (edge, triangle) = ([second[k], second[l]], first);
                let (edge, triangle) = (edge.map(|v| given(b, v)), triangle.map(|v| given(a, v)));
                return Some(Crossing { is_of_second: true, edge, triangle });
            }
            None
        })
    });
    if let Some(crossing) = crossing {
        return Some(Contact::Crossing(crossing));
    }
    let is_inside = |inner: &Body, outer: &Body, tree: &Tree| {
        let pieces = inner.topology.components.iter().map(|&t| inner.position(inner.topology.triangles[t as usize][0]));
        let mut near = pieces.filter(|&at| outer.bounds.contains(at));
        near.any(|at| tree.depth_beyond(at, 0.0, &mut Search::default()).is_some())
    };
    (is_inside(a, b, &trees[1]) || is_inside(b, a, &trees[0])).then_some(Contact::Inside)
}

/// Whether an edge passes through a triangle, or touches it.
fn passes([p, q]: [DVec3; 2], [a, b, c]: [DVec3; 3]) -> bool {
    let along = q - p;
    let (pa, pb, pc) = (a - p, b - p, c - p);
    let normal = (b - a).cross(c - a);
    let longest = pa.length_squared().max(pb.length_squared()).max(pc.length_squared()).sqrt();
    let bound = ZERO * normal.length() * longest.max(along.length());
    let (from, to) = (normal.dot(p - a), normal.dot(q - a));
    if from > bound && to > bound || from < -bound && to < -bound || from.abs().max(to.abs()) <= bound {
        return false; // on one side, or in the plane of the triangle, through which then another edge passes
    }
    // the volumes spanned by the edge and each side of the triangle have the same sign
    let bound = ZERO * along.length() * longest * longest;
    let sides = [along.dot(pa.cross(pb)), along.dot(pb.cross(pc)), along.dot(pc.cross(pa))];
    sides.iter().all(|&side| side >= -bound) || sides.iter().all(|&side| side <= bound)
}
