//! Self-contact of a surface: triangles that cross, touch or overlap without being neighbours.
//!
//! Boxes of blocks of neighbouring triangles find candidates, as for a union; exact signs decide. Unlike in a union,
//! positions are not perturbed, so that touching surfaces are found, too.

use glam::DVec3;

use super::{
    body::Aabb,
    exact::{Expansion, Number, Plane},
    report::{Budget, Failure, Meter, UnionError},
    sweep::{best_axis, sweep},
    topology::{Topology, TopologyError},
};
use crate::disjoint_sets::DisjointSets;

/// Why self-contact could not be determined.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SelfContactError {
    /// The triangles are not closed and oriented.
    #[error(transparent)]
    Topology(#[from] TopologyError),
    /// Too many triangles are near each other.
    #[error(transparent)]
    Union(#[from] UnionError),
}

/// Two triangles of a closed, oriented mesh that meet other than at common vertices and edges, if there are any.
///
/// Positions must be finite. `watch` is called with the fraction done, from 0 to 1.
///
/// # Errors
/// The triangles are not closed and oriented, or `budget` does not suffice.
pub fn self_contact(
    positions: &[DVec3],
    triangles: &[[u32; 3]],
    budget: &Budget,
    watch: &dyn Fn(f64),
) -> Result<Option<[u32; 2]>, SelfContactError> {
    let topology = match Topology::new(positions.len(), triangles) {
        Ok(topology) => topology,
        Err(TopologyError::SameTriangle { first, second }) => return Ok(Some([first, second])),
        Err(error) => return Err(error.into()),
    };
    watch(0.4);
    let meter = Meter::new(*budget);
    match Surface::new(positions, triangles, &topology).meeting(&meter, watch) {
        Ok(found) => Ok(found),
        Err(_) => Err(meter.gave_up().into()),
    }
}

/// Tests of two boxes that cost as much as a step of work.
const TESTS_PER_STEP: u64 = 32;

struct Surface<'a> {
    triangles: &'a [[u32; 3]],
    topology: &'a Topology,
    /// Scaled by a power of two to coordinates of up to 1.
    positions: Vec<DVec3>,
    boxes: Vec<Aabb>,
    /// One vertex of each set of vertices that triangles without area join; empty if there are no such triangles.
    joined: Vec<u32>,
}

impl<'a> Surface<'a> {
    fn new(positions: &[DVec3], triangles: &'a [[u32; 3]], topology: &'a Topology) -> Surface<'a> {
        let hull = Aabb::of(positions.iter().copied());
        let farthest = hull.min.abs().max(hull.max.abs()).max_element();
        let (_, exponent) = libm::frexp(farthest);
        let scaled = |p: DVec3| DVec3::from_array(p.to_array().map(|x| libm::ldexp(x, -exponent)));
        let positions: Vec<DVec3> = positions.iter().map(|&p| scaled(p)).collect();
        let boxes = triangles.iter().map(|corners| Aabb::of(corners.map(|v| positions[v as usize]))).collect();
        let joined = joined(&positions, triangles);
        Surface { triangles, topology, positions, boxes, joined }
    }

    fn meeting(&self, meter: &Meter, watch: &dyn Fn(f64)) -> Result<Option<[u32; 2]>, Failure> {
        let blocks: Vec<u32> = (0..self.topology.block_count() as u32).collect();
        let of = |block: u32| self.topology.block(block as usize);
        let hull = |&block: &u32| of(block).iter().fold(Aabb::EMPTY, |hull, &t| hull.joined(&self.boxes[t as usize]));
        let hulls: Vec<Aabb> = blocks.iter().map(hull).collect();
        let (mut found, mut done) = (None, 0_usize);
        let (axis, tests) = best_axis(&blocks, &hulls);
        meter.spend(tests / TESTS_PER_STEP)?;
        sweep(axis, [&blocks; 2], [&hulls; 2], |a, b| {
            if a > b || found.is_some() {
                return Ok(());
            }
            if a == b {
                done += 1;
                if done % 4096 == 0 {
                    watch(0.4 + 0.6 * done as f64 / blocks.len() as f64);
                }
            }
            found = self.of_blocks([of(a), of(b)], [&hulls[a as usize], &hulls[b as usize]], a == b, meter)?;
            Ok(())
        })?;
        Ok(found)
    }

    /// Triangles of two blocks that meet.
    fn of_blocks(
        &self,
        [a, b]: [&[u32]; 2],
        [hull_a, hull_b]: [&Aabb; 2],
        is_same: bool,
        meter: &Meter,
    ) -> Result<Option<[u32; 2]>, Failure> {
        meter.spend(1)?;
        for &s in a.iter().filter(|&&s| self.boxes[s as usize].meets(hull_b)) {
            let bounds = &self.boxes[s as usize];
            meter.spend(1)?;
            for &t in b.iter().filter(|&&t| self.boxes[t as usize].meets(hull_a)) {
                if (!is_same || s < t) && bounds.meets(&self.boxes[t as usize]) {
                    meter.spend(1)?;
                    if self.do_meet(s, t) {
                        return Ok(Some([s.min(t), s.max(t)]));
                    }
                }
            }
        }
        Ok(None)
    }

    fn name(&self, vertex: u32) -> u32 {
        self.joined.get(vertex as usize).copied().unwrap_or(vertex)
    }

    /// Whether two triangles have a point in common besides their common vertices and edges.
    ///
    /// If they do, an edge of one meets the other, or both lie in one plane. In the latter case, an edge of a neighbour
    /// that leaves the plane meets one of them, because the surface is closed; so testing only edges that leave the
    /// plane misses nothing. Two triangles with a common edge meet only if one is folded onto the other.
    fn do_meet(&self, s: u32, t: u32) -> bool {
        let names = [s, t].map(|t| self.triangles[t as usize].map(|v| self.name(v)));
        let [p, q] = [s, t].map(|t| self.triangles[t as usize].map(|v| self.positions[v as usize]));
        let is_common = |k: usize, own: usize| names[1 - own].contains(&names[own][k]);
        let common = (0..3).filter(|&k| is_common(k, 0)).count();
        if common >= 2 {
            let [own, other] = [0, 1].map(|own| (0..3).find(|&k| !is_common(k, own)));
            let (Some(_), Some(other)) = (own, other) else { return false };
            let [m, n] = [p, q].map(|[a, b, c]| (b - a).cross(c - a));
            let folded = m.dot(n) < 0.0 && [(m, p), (n, q)].iter().all(|&(normal, corners)| has_area(normal, corners));
            return folded && side(&p, q[other]) == 0;
        }
        let meets = |own: usize, edges: &[DVec3; 3], of: &[DVec3; 3]| {
            (0..3).any(|k| {
                let next = (k + 1) % 3;
                // an edge from a common vertex meets the plane of the other triangle only at that vertex
                !(is_common(k, own) || is_common(next, own)) && edge_meets([edges[k], edges[next]], of)
            })
        };
        meets(0, &p, &q) || meets(1, &q, &p)
    }
}

/// Whether the area of a triangle is more than rounding.
fn has_area(normal: DVec3, [a, b, c]: [DVec3; 3]) -> bool {
    normal.length() > 1e-12 * (b - a).length() * (c - a).length()
}

/// Merges the vertices of triangles without area: such triangles fill the seams between edges that are subdivided
/// differently, so their corners lie on their neighbours' edges.
fn joined(positions: &[DVec3], triangles: &[[u32; 3]]) -> Vec<u32> {
    let is_flat = |corners: &[u32; 3]| {
        let [a, b, c] = corners.map(|v| positions[v as usize]);
        let (x, y) = (b - a, c - a);
        !has_area(x.cross(y), [a, b, c])
    };
    let mut joined = DisjointSets::default();
    for &[a, b, c] in triangles.iter().filter(|corners| is_flat(corners)) {
        if joined.count == 0 {
            joined.add(positions.len());
        }
        joined.join(a, b);
        joined.join(b, c);
    }
    joined.all_least()
}

/// 1 in front of a triangle, −1 behind it, 0 in its plane.
fn side(of: &[DVec3; 3], point: DVec3) -> i8 {
    sign(Plane::new(of[0], of[1], of[2]).side(point).is_positive(), || {
        Expansion::orientation(of[0], of[1], of[2], point).is_positive()
    })
}

fn sign(by_bound: Option<bool>, exactly: impl FnOnce() -> Option<bool>) -> i8 {
    match by_bound.or_else(exactly) {
        Some(true) => 1,
        Some(false) => -1,
        None => 0,
    }
}

/// Whether an edge that is not in the plane of a triangle meets it.
fn edge_meets([p, q]: [DVec3; 2], of: &[DVec3; 3]) -> bool {
    if is_apart(p, q, of) {
        return false;
    }
    let sides = [side(of, p), side(of, q)];
    if sides[0] == sides[1] {
        return false; // in the plane, or beside it
    }
    let turns = [0, 1, 2].map(|k| side(&[p, q, of[k]], of[(k + 1) % 3]));
    !(turns.contains(&1) && turns.contains(&-1))
}

/// Whether an edge is certainly beyond one side of a triangle, or on one side of its plane: avoids exact signs where
/// triangles lie in one plane.
fn is_apart(p: DVec3, q: DVec3, of: &[DVec3; 3]) -> bool {
    let normal = (of[1] - of[0]).cross(of[2] - of[0]);
    let is_beyond = |axis: DVec3, from: DVec3| {
        let (p, q) = (p - from, q - from);
        let margin = 1e-11 * axis.length() * p.length().max(q.length());
        let (p, q) = (p.dot(axis), q.dot(axis));
        p.min(q) > margin
    };
    if !has_area(normal, *of) {
        return false;
    }
    // the outward direction at each side
    let beyond_side = |k: usize| is_beyond((of[(k + 1) % 3] - of[k]).cross(normal), of[k]);
    is_beyond(normal, of[0]) || is_beyond(-normal, of[0]) || (0..3).any(beyond_side)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn meeting(positions: &[DVec3], triangles: &[[u32; 3]]) -> Option<[u32; 2]> {
        self_contact(positions, triangles, &Budget::default(), &|_| ()).unwrap()
    }

    /// A box, each face of `n` × `n` squares.
    fn cube(n: u32, low: DVec3, high: DVec3) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let (mut positions, mut triangles): (Vec<DVec3>, Vec<[u32; 3]>) = (vec![], vec![]);
        let mut vertex = |at: [u32; 3]| {
            let position = low + (high - low) * DVec3::from_array(at.map(f64::from)) / f64::from(n);
            let known = positions.iter().position(|&p| p == position);
            known.unwrap_or_else(|| {
                positions.push(position);
                positions.len() - 1
            }) as u32
        };
        for (axis, end) in (0..3).flat_map(|axis| [(axis, 0), (axis, n)]) {
            for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
                let mut at = |di: u32, dj: u32| {
                    let mut corner = [0; 3];
                    (corner[axis], corner[(axis + 1) % 3], corner[(axis + 2) % 3]) = (end, i + di, j + dj);
                    vertex(corner)
                };
                let [a, b, c, d] = [at(0, 0), at(1, 0), at(1, 1), at(0, 1)];
                let two = if end > 0 { [[a, b, c], [a, c, d]] } else { [[a, c, b], [a, d, c]] };
                triangles.extend(two);
            }
        }
        (positions, triangles)
    }

    /// Two surfaces in one mesh.
    fn both(
        (mut positions, mut triangles): (Vec<DVec3>, Vec<[u32; 3]>),
        (more, others): (Vec<DVec3>, Vec<[u32; 3]>),
    ) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let first = positions.len() as u32;
        positions.extend(more);
        triangles.extend(others.into_iter().map(|corners| corners.map(|v| v + first)));
        (positions, triangles)
    }

    #[test]
    fn a_box_does_not_meet_itself() {
        for n in [1, 2, 7] {
            for size in [1e-12, 0.3, 1.0, 1e12] {
                let (positions, triangles) = cube(n, DVec3::splat(-0.1 * size), DVec3::splat(size));
                assert_eq!(meeting(&positions, &triangles), None, "{n} {size}");
            }
        }
    }

    #[test]
    fn boxes_meet_where_they_touch() {
        let unit = || cube(2, DVec3::ZERO, DVec3::ONE);
        let one_at = |low: [f64; 3], high: [f64; 3]| cube(3, DVec3::from_array(low), DVec3::from_array(high));
        for (name, other, meets) in [
            ("apart", one_at([1.1, 0.0, 0.0], [2.0, 1.0, 1.0]), false),
            ("by a hair", one_at([1.0 + 1e-15, 0.0, 0.0], [2.0, 1.0, 1.0]), false),
            ("inside", one_at([0.1, 0.2, 0.3], [0.7, 0.8, 0.9]), false),
            ("through each other", one_at([0.4, 0.4, 0.4], [2.0, 1.7, 1.6]), true),
            ("a bar through it", one_at([-1.0, 0.4, 0.4], [2.0, 0.6, 0.6]), true),
            ("by a face", one_at([1.0, 0.0, 0.0], [2.0, 1.0, 1.0]), true),
            ("by a part of a face", one_at([1.0, 0.2, 0.3], [2.0, 0.7, 0.8]), true),
            ("by an edge", one_at([1.0, 1.0, 0.2], [2.0, 2.0, 0.7]), true),
            ("by a corner", one_at([1.0, 1.0, 1.0], [2.0, 2.0, 2.0]), true),
            ("in the same place", one_at([0.0; 3], [1.0; 3]), true),
        ] {
            let (positions, triangles) = both(unit(), other);
            let found = meeting(&positions, &triangles);
            assert_eq!(found.is_some(), meets, "{name}: {found:?}");
            if let Some([s, t]) = found {
                assert!((s < 48) != (t < 48), "{name}: {s} {t}");
            }
        }
    }

    /// Triangles with only a vertex in common that cross each other.
    #[test]
    fn neighbours_meet_beyond_their_vertex() {
        // an octahedron whose top vertex is pulled through its bottom
        let at = |z: f64| vec![DVec3::X, DVec3::Y, -DVec3::X, -DVec3::Y, z * DVec3::Z, -DVec3::Z];
        let ring = |a: u32| (a, (a + 1) % 4);
        let triangles: Vec<[u32; 3]> =
            (0..4).flat_map(|a| [[ring(a).0, ring(a).1, 4], [ring(a).1, ring(a).0, 5]]).collect();
        for (z, meets) in [(1.0, false), (1e-9, false), (-0.5, false), (-1.0, true), (-1.5, false)] {
            // at −1.5 it is inside out, at −1 its halves lie on each other
            assert_eq!(meeting(&at(z), &triangles).is_some(), meets, "{z}");
        }
        let mut pulled = at(1.0);
        pulled[4] = DVec3::new(3.0, 0.0, -0.1); // through the side
        assert!(meeting(&pulled, &triangles).is_some());
    }

    #[test]
    fn triangles_without_area_fill_seams() {
        // an edge of a box is subdivided on one side only: the triangle in between has no area
        let (mut positions, mut triangles) = cube(1, DVec3::ZERO, DVec3::ONE);
        let [a, b, c] = triangles[0];
        positions.push(0.5 * (positions[a as usize] + positions[b as usize]));
        let new = positions.len() as u32 - 1;
        triangles[0] = [a, new, c];
        triangles.extend([[new, b, c], [a, b, new]]);
        assert_eq!(meeting(&positions, &triangles), None);
    }

    /// Boxes in a layer, and one that is longest across it.
    #[test]
    fn boxes_are_swept_along_the_axis_with_the_fewest_tests() {
        let at = |x: u32, y: u32| DVec3::new(f64::from(x), f64::from(y), 0.0);
        let tile = |i: u32| Aabb { min: at(i % 60, i / 60), max: at(i % 60, i / 60) + DVec3::splat(0.5) };
        let mut boxes: Vec<Aabb> = (0..3600).map(tile).collect();
        boxes.push(Aabb { min: at(30, 30), max: at(30, 30) + DVec3::new(0.1, 0.1, 1000.0) });
        let all: Vec<u32> = (0..boxes.len() as u32).collect();
        assert_eq!(best_axis(&all, &boxes), (0, 59 * 60 * 60 + 61 * 61));
    }

    #[test]
    fn work_is_limited() {
        let (positions, triangles) = cube(7, DVec3::ZERO, DVec3::ONE);
        let budget = Budget { work: 100, ..Budget::default() };
        assert!(matches!(
            self_contact(&positions, &triangles, &budget, &|_| ()),
            Err(SelfContactError::Union(UnionError::GaveUp { .. }))
        ));
    }
}
