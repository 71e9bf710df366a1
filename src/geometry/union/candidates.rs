//! Candidate intersections: pairs of bodies, of blocks and of triangles with overlapping boxes, and the edges and triangles
//! of pairs that straddle each other's plane.

use glam::{DVec3, Vec3A};

use super::{
    body::{Aabb, higher, lower},
    exact::{Expansion, Number, Plane},
    placement::Placement,
    report::{Failure, Meter},
    sweep::sweep,
};
use crate::parallel;

/// Two bodies with overlapping boxes, and the blocks of each that overlap the hull of the other.
#[derive(Clone)]
pub struct Meeting {
    pub bodies: [u32; 2],
    pub blocks: [Vec<u32>; 2],
}

/// The meetings of all pairs of bodies.
pub fn meetings(placement: &Placement) -> Vec<Meeting> {
    let within = |me: u32, other: u32| {
        let margin = placement.displaced[me as usize] + placement.displaced[other as usize];
        let there = placement.bodies[other as usize].hull(margin);
        let blocks = &placement.bodies[me as usize].block_bounds;
        (0..blocks.len() as u32).filter(|&i| there.meets(&blocks[i as usize])).collect()
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

/// The triangles that are near each other, for all meetings.
pub fn near(placement: &Placement, meetings: &[Meeting], meter: &Meter, threads: bool) -> Result<Vec<Near>, Failure> {
    let of_meeting = |meeting: &Meeting| {
        let [first, second] = &meeting.blocks;
        Near::between(placement, meeting.bodies, [first, second], None, meter)
    };
    parallel::collect(threads, meetings, of_meeting)
}

/// The triangles of a body that are near each other; if `suspects` are given, only those of them.
pub fn near_itself(
    placement: &Placement,
    body: u32,
    suspects: Option<&[bool]>,
    meter: &Meter,
) -> Result<Near, Failure> {
    let topology = placement.bodies[body as usize].topology;
    let is_suspect = |t: &u32| suspects.is_none_or(|suspects| suspects[*t as usize]);
    let has_suspects = |block: &u32| topology.block(*block as usize).iter().any(is_suspect);
    let blocks: Vec<u32> = (0..topology.block_count() as u32).filter(has_suspects).collect();
    Near::between(placement, [body; 2], [&blocks; 2], suspects, meter)
}

impl Near {
    /// Finds the triangles of some blocks of two bodies, or of one, whose boxes overlap, unless both lie inside other
    /// bodies. For one body, `suspects` may restrict them.
    fn between(
        placement: &Placement,
        bodies: [u32; 2],
        blocks: [&[u32]; 2],
        suspects: Option<&[bool]>,
        meter: &Meter,
    ) -> Result<Near, Failure> {
        let mut found = Near { bodies, ..Near::default() };
        if blocks.iter().any(|blocks| blocks.is_empty()) {
            return Ok(found);
        }
        meter.spend((blocks[0].len() + blocks[1].len()) as u64)?;
        let is_one = bodies[0] == bodies[1];
        let hulls = [0, 1].map(|k| {
            let (mesh, margin) = (placement.bodies[bodies[k] as usize], placement.displaced[bodies[k] as usize]);
            blocks[k].iter().map(|&block| mesh.block_bounds[block as usize].grown(margin)).collect::<Vec<Aabb>>()
        });
        let shown = [0, 1]
            .map(|k| blocks[k].iter().map(|&block| placement.is_block_shown(block, bodies[k])).collect::<Vec<bool>>());
        let [first, second] = [0, 1].map(|k| (0..blocks[k].len() as u32).collect::<Vec<u32>>());
        // where two bodies face each other, their blocks are spread sideways
        let all = hulls.iter().flatten().fold(Aabb::EMPTY, |all, hull| all.joined(hull));
        let axis = (all.max - all.min).max_position();
        let (mut pairs, mut is_met) = (Vec::new(), [0, 1].map(|k| vec![false; blocks[k].len()]));
        let mut tested = 0_usize;
        sweep(axis, [&first, &second], [&hulls[0], &hulls[1]], |a, b| {
            // around a vertex of many triangles, all blocks overlap
            tested += 1;
            if tested.is_multiple_of(AT_ONCE) {
                meter.spend(AT_ONCE as u64)?;
            }
            if (!is_one || a <= b) && (shown[0][a as usize] || shown[1][b as usize]) {
                pairs.push([a, b]);
                is_met[0][a as usize] = true;
                is_met[1][b as usize] = true;
            }
            Ok(())
        })?;
        if pairs.is_empty() {
            return Ok(found);
        }
        let zoom = Zoom::new(placement, bodies);
        let lists = [0, 1].map(|k| {
            let other = (!is_one).then_some(bodies[1 - k]);
            Listed::new(placement, bodies[k], blocks[k], &is_met[k], &zoom, other, suspects)
        });
        lists[0].meet(&lists[1], &pairs, meter, &mut found)?;
        Ok(found)
    }

    /// The triangles of each body that are near others.
    pub fn triangles(&self) -> impl Iterator<Item = (u32, &[u32])> {
        self.bodies.into_iter().zip(self.triangles.iter().map(Vec::as_slice))
    }
}

/// Number of candidates that are tested between two checks of the budget.
pub const AT_ONCE: usize = 512;

/// An edge of one and the index of the other of two triangles that straddle each other's plane: the edge in the upper
/// half, the triangle in the lower, so that candidates sort by edge.
pub type EdgeAndTriangle = u64;

/// The edges and triangles that may meet and those in `known`, ascending, each once. The triangles near each other must be
/// placed.
pub fn edges_and_triangles(
    placement: &Placement,
    near: &[Near],
    mut known: Vec<EdgeAndTriangle>,
    meter: &Meter,
    threads: bool,
) -> Result<Vec<EdgeAndTriangle>, Failure> {
    let of_near = |near: &Near| {
        let (mut found, [a, b]) = (Vec::new(), near.bodies);
        let mut straddle: Option<Straddle> = None;
        for pairs in near.pairs.chunks(AT_ONCE) {
            meter.spend(pairs.len() as u64)?;
            for &[ta, tb] in pairs {
                let known = straddle.take().filter(|straddle| straddle.triangle == tb);
                straddle.insert(known.unwrap_or_else(|| Straddle::new(placement, tb, b, a))).test(ta, &mut found)?;
            }
        }
        Ok(found)
    };
    let found: Result<Vec<Vec<EdgeAndTriangle>>, Failure> = parallel::collect(threads, near, of_near);
    found?.into_iter().for_each(|mut found| known.append(&mut found));
    known.sort_unstable();
    known.dedup();
    Ok(known)
}

/// Coordinates relative to two bodies and their size, in which single precision suffices for culling.
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

    /// A box that contains one given in scene units.
    #[inline]
    fn of(&self, bounds: &Aabb) -> Box32 {
        let single = |at: DVec3| Vec3A::from(((at - self.origin) * self.factor).as_vec3());
        let (min, max) = (single(bounds.min), single(bounds.max));
        // covers rounding of the differences, the product and the conversion
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
    /// The boxes of the blocks.
    hulls: Vec<Box32>,
    /// Block i of the list is `triangles[start[i]..start[i + 1]]`; those from `start_of_buried[i]` on are inside other
    /// bodies.
    start: Vec<u32>,
    start_of_buried: Vec<u32>,
    triangles: Vec<(u32, Box32)>,
}

impl Listed {
    /// The triangles of the blocks that meet others; if there is another body, only those in its hull, and if there are
    /// suspects, only those. Triangles inside other bodies are listed only if triangles of the other body that are not
    /// inside one may be near.
    fn new(
        placement: &Placement,
        body: u32,
        blocks: &[u32],
        is_met: &[bool],
        zoom: &Zoom,
        other: Option<u32>,
        suspects: Option<&[bool]>,
    ) -> Listed {
        let mesh = placement.bodies[body as usize];
        let margin = placement.displaced[body as usize];
        let there = other.map(|other| {
            let margin = placement.displaced[other as usize];
            (placement.bodies[other as usize].hull(margin), placement.shown_bounds(other).grown(margin))
        });
        let mut listed = Listed {
            body,
            hulls: Vec::with_capacity(blocks.len()),
            start: Vec::with_capacity(blocks.len() + 1),
            start_of_buried: Vec::with_capacity(blocks.len()),
            triangles: Vec::new(),
        };
        listed.start.push(0);
        let mut buried = Vec::new();
        for (&block, &is_met) in blocks.iter().zip(is_met) {
            let mut hull = Aabb::EMPTY;
            for &t in if is_met { mesh.topology.block(block as usize) } else { &[] } {
                if suspects.is_some_and(|suspects| !suspects[t as usize]) {
                    continue;
                }
                let [a, b, c] = mesh.corners(t);
                let bounds = Aabb { min: lower(lower(a, b), c), max: higher(higher(a, b), c) }.grown(margin);
                let t = t + placement.first_triangle[body as usize];
                let is_buried = placement.is_buried(t);
                let is_there = there.is_none_or(|(hull, shown)| match is_buried {
                    true => shown.meets(&bounds),
                    false => hull.meets(&bounds),
                });
                if is_there {
                    hull = hull.joined(&bounds);
                    let to = if is_buried { &mut buried } else { &mut listed.triangles };
                    to.push((t, zoom.of(&bounds)));
                }
            }
            listed.start_of_buried.push(listed.triangles.len() as u32);
            listed.triangles.append(&mut buried);
            listed.start.push(listed.triangles.len() as u32);
            listed.hulls.push(zoom.of(&hull));
        }
        listed
    }

    fn of(&self, block: u32) -> std::ops::Range<usize> {
        self.start[block as usize] as usize..self.start[block as usize + 1] as usize
    }

    /// Finds the triangles of this list and of another list whose boxes overlap, in pairs of blocks, unless both lie inside
    /// other bodies.
    fn meet(&self, other: &Listed, pairs: &[[u32; 2]], meter: &Meter, found: &mut Near) -> Result<(), Failure> {
        let same = self.body == other.body;
        let (mut is_near, mut is_other_near) = (vec![false; self.triangles.len()], vec![false; other.triangles.len()]);
        let mut near: Vec<(u32, u32, Box32)> = Vec::new();
        for &[a, b] in pairs {
            near.clear();
            let (here, there) = (&self.hulls[a as usize], &other.hulls[b as usize]);
            if !here.meets(there) {
                continue;
            }
            let start_of_buried = self.start_of_buried[a as usize];
            near.extend(self.of(a).filter_map(|i| {
                let (triangle, bounds) = self.triangles[i];
                bounds.meets(there).then_some((i as u32, triangle, bounds))
            }));
            let shown = near.partition_point(|&(i, ..)| i < start_of_buried);
            let before = found.pairs.len();
            for j in other.of(b) {
                let (tb, box_b) = &other.triangles[j];
                if !box_b.meets(here) {
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
            meter.spend((near.len() + (found.pairs.len() - before)) as u64 + 1)?;
        }
        for ((list, is_near), triangles) in
            [(self, is_near), (other, is_other_near)].into_iter().zip(&mut found.triangles)
        {
            triangles.extend(list.triangles.iter().zip(is_near).filter(|(_, is_near)| *is_near).map(|((t, _), _)| *t));
        }
        Ok(())
    }
}

/// A triangle against which others are tested.
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
