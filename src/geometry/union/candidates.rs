//! Candidate intersections: pairs of bodies, of blocks and of triangles with overlapping boxes, and the edges and triangles
//! of pairs that straddle each other's plane.

use glam::{DVec3, Vec3A};
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

/// Two triangles whose boxes overlap, of the first and the second body.
type TrianglePair = [u32; 2];

/// The triangles of two bodies, or of one, whose boxes overlap.
#[derive(Default)]
pub struct Near {
    bodies: [u32; 2],
    pairs: Vec<TrianglePair>,
    /// The triangles of each body that are in a pair.
    triangles: [Vec<u32>; 2],
}

/// The triangles near each other, of all meetings and of the bodies that may intersect themselves.
pub fn near(placement: &Placement, meetings: &[Meeting], meter: &Meter, threads: bool) -> Result<Vec<Near>, Failure> {
    let of_meeting = |meeting: &Meeting| {
        let [a, b] = meeting.bodies;
        let mut found = Near { bodies: [a, b], ..Near::default() };
        if !meeting.blocks.iter().any(Vec::is_empty) {
            let zoom = Zoom::new(placement, [a, b]);
            let lists = [
                Listed::new(placement, a, &meeting.blocks[0], &zoom, Some(b)),
                Listed::new(placement, b, &meeting.blocks[1], &zoom, Some(a)),
            ];
            lists[0].meet(&lists[1], meter, &mut found)?;
        }
        Ok(found)
    };
    let of_fold = |body: u32| {
        let blocks: Vec<u32> = (0..placement.bodies[body as usize].topology.block_count() as u32).collect();
        let list = Listed::new(placement, body, &blocks, &Zoom::new(placement, [body; 2]), None);
        let mut found = Near { bodies: [body; 2], ..Near::default() };
        list.meet(&list, meter, &mut found)?;
        Ok(found)
    };
    let folds: Vec<u32> = (0..placement.bodies.len() as u32).filter(|&b| placement.folds[b as usize]).collect();
    if threads {
        (meetings.par_iter().map(of_meeting)).chain(folds.par_iter().map(|&b| of_fold(b))).collect()
    } else {
        (meetings.iter().map(of_meeting)).chain(folds.iter().map(|&b| of_fold(b))).collect()
    }
}

impl Near {
    /// The triangles of each body that are near others.
    pub fn triangles(&self) -> impl Iterator<Item = (u32, &[u32])> {
        self.bodies.into_iter().zip(self.triangles.iter().map(Vec::as_slice))
    }
}

/// An edge and a triangle of two triangles that straddle each other's plane: the edge in the upper half, the triangle
/// in the lower, so that candidates sort by edge.
pub type EdgeAndTriangle = u64;

/// The edges and triangles that may meet, ascending, each once. The triangles near each other must be placed.
pub fn edges_and_triangles(
    placement: &Placement,
    near: &[Near],
    meter: &Meter,
    threads: bool,
) -> Result<Vec<EdgeAndTriangle>, Failure> {
    let of_near = |near: &Near| {
        let (mut found, [a, b]) = (Vec::new(), near.bodies);
        let mut straddle: Option<Straddle> = None;
        for &[ta, tb] in &near.pairs {
            let known = straddle.take().filter(|straddle| straddle.triangle == tb);
            straddle.insert(known.unwrap_or_else(|| Straddle::new(placement, tb, b, a))).test(ta, &mut found)?;
        }
        meter.check()?;
        Ok(found)
    };
    let found: Result<Vec<Vec<EdgeAndTriangle>>, Failure> =
        if threads { near.par_iter().map(of_near).collect() } else { near.iter().map(of_near).collect() };
    let mut found = found?.concat();
    found.sort_unstable();
    found.dedup();
    Ok(found)
}

/// Coordinates about two bodies, of their size, in which single precision suffices to cull.
struct Zoom {
    origin: DVec3,
    factor: f64,
}

impl Zoom {
    fn new(placement: &Placement, bodies: [u32; 2]) -> Zoom {
        let [a, b] = bodies.map(|body| placement.bodies[body as usize]);
        let size = a.radius + b.radius;
        Zoom { origin: (a.centre + b.centre) / 2.0, factor: if size > 0.0 { 1.0 / size } else { 1.0 } }
    }

    /// A box that contains one in scene units.
    #[inline]
    fn of(&self, bounds: &Aabb) -> Box32 {
        let single = |at: DVec3| Vec3A::from(((at - self.origin) * self.factor).as_vec3());
        let (min, max) = (single(bounds.min), single(bounds.max));
        // rounding of the differences, the product and the conversion
        let rounding = |at: Vec3A| at.abs() * (8.0 * f32::EPSILON) + Vec3A::splat(1e-7);
        Box32 { min: min - rounding(min), max: max + rounding(max) }
    }
}

/// A bounding box in single precision.
#[derive(Clone, Copy)]
struct Box32 {
    min: Vec3A,
    max: Vec3A,
}

impl Box32 {
    #[inline]
    fn meets(&self, other: &Box32) -> bool {
        (self.min.cmple(other.max) & other.min.cmple(self.max)).all()
    }
}

/// Triangles of the listed blocks of a body, with their boxes.
struct Listed {
    body: u32,
    /// The boxes of the blocks, also as [`Box32`].
    hulls: Vec<Aabb>,
    small_hulls: Vec<Box32>,
    /// Block i of the list has `triangles[start[i]..start[i + 1]]`, from `start_of_buried[i]` on those inside other bodies.
    start: Vec<u32>,
    start_of_buried: Vec<u32>,
    triangles: Vec<(u32, Box32)>,
}

impl Listed {
    /// The triangles of some blocks; only those in the box of another body, if there is one. Those inside other bodies
    /// are there only if triangles of that body may be near that are not.
    fn new(placement: &Placement, body: u32, blocks: &[u32], zoom: &Zoom, other: Option<u32>) -> Listed {
        let mesh = placement.bodies[body as usize];
        let margin = placement.displaced[body as usize];
        let there = other.map(|other| {
            let margin = placement.displaced[other as usize];
            [placement.bodies[other as usize].bounds, placement.shown_bounds(other)].map(|bounds| bounds.grown(margin))
        });
        let mut listed = Listed {
            body,
            hulls: Vec::with_capacity(blocks.len()),
            small_hulls: Vec::with_capacity(blocks.len()),
            start: vec![0],
            start_of_buried: Vec::with_capacity(blocks.len()),
            triangles: Vec::new(),
        };
        let mut buried = Vec::new();
        for &block in blocks {
            let has_only_buried = !placement.is_block_shown(block, body);
            let is_far = |[_, shown]: [Aabb; 2]| !shown.meets(&mesh.block_bounds[block as usize].grown(margin));
            if has_only_buried && there.is_some_and(is_far) {
                continue;
            }
            let mut hull = Aabb::EMPTY;
            for &t in mesh.topology.block(block as usize) {
                let [a, b, c] = mesh.corners(t);
                let bounds = Aabb { min: a.min(b).min(c), max: a.max(b).max(c) }.grown(margin);
                let t = t + placement.first_triangle[body as usize];
                let is_buried = placement.is_buried(t);
                if there.is_none_or(|there| there[usize::from(is_buried)].meets(&bounds)) {
                    hull = hull.joined(&bounds);
                    let to = if is_buried { &mut buried } else { &mut listed.triangles };
                    to.push((t, zoom.of(&bounds)));
                }
            }
            let start_of_buried = listed.triangles.len() as u32;
            listed.triangles.append(&mut buried);
            if listed.triangles.len() as u32 > listed.start[listed.start.len() - 1] {
                listed.hulls.push(hull);
                listed.small_hulls.push(zoom.of(&hull));
                listed.start.push(listed.triangles.len() as u32);
                listed.start_of_buried.push(start_of_buried);
            }
        }
        listed
    }

    fn of(&self, block: u32) -> std::ops::Range<usize> {
        self.start[block as usize] as usize..self.start[block as usize + 1] as usize
    }

    fn has_only_buried(&self, block: u32) -> bool {
        self.start_of_buried[block as usize] == self.start[block as usize]
    }

    /// Finds the triangles of this list and of another list whose boxes overlap, or of all pairs within this list, unless
    /// both lie inside other bodies.
    fn meet(&self, other: &Listed, meter: &Meter, found: &mut Near) -> Result<(), Failure> {
        let all = |list: &Listed| (0..list.hulls.len() as u32).collect::<Vec<u32>>();
        let mut pairs = Vec::new();
        let same = self.body == other.body;
        sweep(&all(self), &self.hulls, &all(other), &other.hulls, |a, b| {
            if (!same || a <= b) && !(self.has_only_buried(a) && other.has_only_buried(b)) {
                pairs.push([a, b]);
            }
        });
        let (mut is_near, mut is_other_near) = (vec![false; self.triangles.len()], vec![false; other.triangles.len()]);
        let mut near: Vec<(u32, u32, Box32)> = Vec::new();
        for [a, b] in pairs {
            near.clear();
            let there = &other.small_hulls[b as usize];
            let start_of_buried = self.start_of_buried[a as usize];
            near.extend(self.of(a).filter_map(|i| {
                let (triangle, bounds) = self.triangles[i];
                bounds.meets(there).then_some((i as u32, triangle, bounds))
            }));
            let shown = near.partition_point(|&(i, ..)| i < start_of_buried);
            let before = found.pairs.len();
            for j in other.of(b) {
                let (tb, box_b) = &other.triangles[j];
                if !box_b.meets(&self.small_hulls[a as usize]) {
                    continue;
                }
                let is_buried = j >= other.start_of_buried[b as usize] as usize;
                for (i, ta, box_a) in if is_buried { &near[..shown] } else { &near } {
                    if box_a.meets(box_b) && !(same && a == b && ta >= tb) {
                        found.pairs.push([*ta, *tb]);
                        is_near[*i as usize] = true;
                        is_other_near[j] = true;
                    }
                }
            }
            meter.spend((near.len() + (found.pairs.len() - before) / 16) as u64 + 1)?;
        }
        for ((list, is_near), triangles) in
            [(self, is_near), (other, is_other_near)].into_iter().zip(&mut found.triangles)
        {
            triangles.extend(list.triangles.iter().zip(is_near).filter(|(_, is_near)| *is_near).map(|((t, _), _)| *t));
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
        let corners = names.map(|v| placement.placed(v));
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
        let corners = names.map(|v| self.placement.placed(v));
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
