//! Candidate intersections: pairs of bodies, of blocks and of triangles, and the edges and triangles of pairs that
//! straddle each other's plane.

use glam::DVec3;
use rayon::prelude::*;

use super::{
    body::Aabb,
    exact::{Expansion, Number, Plane},
    placement::Placement,
    report::{Failure, Meter},
    sweep::sweep,
};

/// Two bodies with overlapping boxes, and the blocks of each that overlap the box of the other.
pub struct Meeting {
    pub bodies: [u32; 2],
    pub blocks: [Vec<u32>; 2],
}

/// The meetings of all pairs of bodies.
pub fn meetings(placement: &Placement) -> Vec<Meeting> {
    let within = |me: u32, other: u32| {
        let margin = placement.displaced[me as usize] + placement.displaced[other as usize];
        let there = placement.bodies[other as usize].bounds.grown(margin);
        let blocks = &placement.bodies[me as usize].block_bounds;
        (0..blocks.len() as u32).filter(|&i| blocks[i as usize].meets(&there)).collect()
    };
    placement.pairs.iter().map(|&[a, b]| Meeting { bodies: [a, b], blocks: [within(a, b), within(b, a)] }).collect()
}

/// An edge and a triangle of two triangles that straddle each other's plane: the edge in the upper half, the triangle
/// in the lower, so that candidates sort by edge.
pub type EdgeAndTriangle = u64;

/// The edges and triangles that may meet, ascending, each once.
pub fn edges_and_triangles(
    placement: &Placement,
    meetings: &[Meeting],
    meter: &Meter,
    threads: bool,
) -> Result<Vec<EdgeAndTriangle>, Failure> {
    let of_meeting = |meeting: &Meeting| {
        let [a, b] = meeting.bodies;
        let mut found = Vec::new();
        if !meeting.blocks.iter().any(Vec::is_empty) {
            let lists = [Listed::new(placement, a, &meeting.blocks[0]), Listed::new(placement, b, &meeting.blocks[1])];
            lists[0].meet(&lists[1], placement, meter, &mut found)?;
        }
        Ok(found)
    };
    let of_fold = |body: u32| {
        let blocks: Vec<u32> = (0..placement.bodies[body as usize].topology.block_count() as u32).collect();
        let list = Listed::new(placement, body, &blocks);
        let mut found = Vec::new();
        list.meet(&list, placement, meter, &mut found)?;
        Ok(found)
    };
    let folds: Vec<u32> = (0..placement.bodies.len() as u32).filter(|&b| placement.folds[b as usize]).collect();
    let found: Result<Vec<Vec<EdgeAndTriangle>>, Failure> = if threads {
        (meetings.par_iter().map(of_meeting)).chain(folds.par_iter().map(|&b| of_fold(b))).collect()
    } else {
        (meetings.iter().map(of_meeting)).chain(folds.iter().map(|&b| of_fold(b))).collect()
    };
    let mut found = found?.concat();
    found.sort_unstable();
    found.dedup();
    Ok(found)
}

/// Triangles of the listed blocks of a body, with their boxes.
struct Listed {
    body: u32,
    hulls: Vec<Aabb>,
    /// Block i of the list has `triangles[start[i]..start[i + 1]]`.
    start: Vec<u32>,
    triangles: Vec<(u32, Aabb)>,
}

impl Listed {
    fn new(placement: &Placement, body: u32, blocks: &[u32]) -> Listed {
        let topology = placement.bodies[body as usize].topology;
        let mut listed =
            Listed { body, hulls: Vec::with_capacity(blocks.len()), start: vec![0], triangles: Vec::new() };
        for &block in blocks {
            let mut hull = Aabb::EMPTY;
            for &t in topology.block(block as usize) {
                let triangle = t + placement.first_triangle[body as usize];
                let bounds = Aabb::of(placement.placed_corners(triangle, body));
                hull = hull.joined(&bounds);
                listed.triangles.push((triangle, bounds));
            }
            listed.hulls.push(hull);
            listed.start.push(listed.triangles.len() as u32);
        }
        listed
    }

    fn of(&self, block: u32) -> &[(u32, Aabb)] {
        &self.triangles[self.start[block as usize] as usize..self.start[block as usize + 1] as usize]
    }

    /// Tests the triangles of this list against those of another list, or all pairs within this list.
    fn meet(
        &self,
        other: &Listed,
        placement: &Placement,
        meter: &Meter,
        found: &mut Vec<EdgeAndTriangle>,
    ) -> Result<(), Failure> {
        let all = |list: &Listed| (0..list.hulls.len() as u32).collect::<Vec<u32>>();
        let mut pairs = Vec::new();
        let same = self.body == other.body;
        sweep(&all(self), &self.hulls, &all(other), &other.hulls, |a, b| {
            if !same || a <= b {
                pairs.push([a, b]);
            }
        });
        let mut near: Vec<(u32, Aabb)> = Vec::new();
        for [a, b] in pairs {
            near.clear();
            near.extend(self.of(a).iter().filter(|(_, bounds)| bounds.meets(&other.hulls[b as usize])));
            meter.spend(near.len() as u64 + 1)?;
            for (tb, box_b) in other.of(b) {
                if !box_b.meets(&self.hulls[a as usize]) {
                    continue;
                }
                let mut straddle = None;
                for (ta, box_a) in &near {
                    if !box_a.meets(box_b) || (same && a == b && ta >= tb) {
                        continue;
                    }
                    let straddle = straddle.get_or_insert_with(|| Straddle::new(placement, *tb, other.body, self.body));
                    straddle.test(*ta, found)?;
                }
            }
        }
        Ok(())
    }
}

/// A triangle that others are tested against.
struct Straddle<'p, 'a, 'b> {
    placement: &'p Placement<'a, 'b>,
    triangle: u32,
    body: u32,
    other_body: u32,
    names: [u32; 3],
    corners: [DVec3; 3],
    plane: Plane,
}

impl<'p, 'a, 'b> Straddle<'p, 'a, 'b> {
    fn new(placement: &'p Placement<'a, 'b>, triangle: u32, body: u32, other_body: u32) -> Self {
        let names = placement.corners(triangle, body);
        let corners = names.map(|v| placement.placed[v as usize]);
        let plane = Plane::new(corners[0], corners[1], corners[2]);
        Straddle { placement, triangle, body, other_body, names, corners, plane }
    }

    /// Adds the edges of either triangle that straddle the other's plane, if both triangles have some.
    fn test(&self, other: u32, found: &mut Vec<EdgeAndTriangle>) -> Result<(), Failure> {
        let names = self.placement.corners(other, self.other_body);
        let shared = self.body == self.other_body && {
            let count = names.iter().filter(|v| self.names.contains(v)).count();
            if count >= 2 {
                return Ok(());
            }
            count > 0
        };
        let corners = names.map(|v| self.placement.placed[v as usize]);
        let Some(sides) = sides(&self.plane, &self.corners, &corners, |k| shared && self.names.contains(&names[k]))?
        else {
            return Ok(());
        };
        let plane = Plane::new(corners[0], corners[1], corners[2]);
        let Some(own_sides) =
            self::sides(&plane, &corners, &self.corners, |k| shared && names.contains(&self.names[k]))?
        else {
            return Ok(());
        };
        let pair = |edge: u32, triangle: u32| (u64::from(edge) << 32) | u64::from(triangle);
        let (edges, own_edges) =
            (self.placement.edges_of(other, self.other_body), self.placement.edges_of(self.triangle, self.body));
        for k in 0..3 {
            if sides[k] * sides[(k + 1) % 3] < 0 {
                found.push(pair(edges[k], self.triangle));
            }
            if own_sides[k] * own_sides[(k + 1) % 3] < 0 {
                found.push(pair(own_edges[k], other));
            }
        }
        Ok(())
    }
}

/// The side of a plane on which each corner lies, 0 for corners that are on it by definition; `None` if no edge crosses
/// it.
#[inline]
fn sides(
    plane: &Plane,
    of: &[DVec3; 3],
    corners: &[DVec3; 3],
    is_shared: impl Fn(usize) -> bool,
) -> Result<Option<[i8; 3]>, Failure> {
    let mut sides = [0i8; 3];
    for k in 0..3 {
        if !is_shared(k) {
            let front = plane
                .side(corners[k])
                .is_positive()
                .or_else(|| Expansion::orientation(of[0], of[1], of[2], corners[k]).is_positive());
            sides[k] = if front.ok_or(Failure::Tie)? { 1 } else { -1 };
        }
    }
    let crossed = sides.contains(&1) && sides.contains(&-1);
    Ok(crossed.then_some(sides))
}
