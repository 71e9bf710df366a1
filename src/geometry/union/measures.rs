//! Geometric measures of a pair of bodies: distance or depth, overlap, and neck.

use std::{cmp::Ordering, collections::BinaryHeap};

use glam::DVec3;

use super::{
    Aabb, Body, Budget, Seam, UnionError,
    distance::{Search, Tree, separation},
    report::{Failure, Meter},
    surface::{Origin, Union},
    union,
};

/// Work steps to find the depth of a point.
const SAMPLE: u64 = 64;
/// Triangles larger than this, from the centre to a corner, are sampled more densely than once [radii of the smaller body].
const COARSE: f64 = 0.5;
/// So are those as close to the deepest sample as this, once [from their own centre to a corner].
const BESIDE: f64 = 1.5;
/// Parts of them are divided no further if they are smaller than this, or cannot be deeper than the deepest sample by more
/// than this [radii of the smaller body].
const FINE: f64 = 0.05;
const NEGLIGIBLE: f64 = 0.01;
/// Most parts of the triangles of one body in another: a surface may be any number of times larger than the radius.
const PARTS: usize = 2_048;
/// Bodies this far apart are apart in a union, too [radii]; …
const APART: f64 = 1e-6;
/// … plus this fraction of it per unit of their coordinates.
const SCENE: f64 = 1e-3;

/// Where two bodies were nearest to each other, as the starting point of a search in a later frame. Does not affect
/// results.
#[derive(Clone, Copy, Debug, Default)]
pub struct Hint {
    triangles: [u32; 2],
}

/// Geometric measures of a pair of bodies, independent of thresholds.
#[derive(Clone, Debug, PartialEq)]
pub struct PairMeasures {
    /// Smallest distance of the surfaces; where the bodies overlap, minus the greatest depth [scene unit].
    pub gap: f64,
    /// Volume of the intersection [scene unit³].
    pub overlap: f64,
    /// Radius of the circle with the magnitude of the seam's vector area as area [scene unit]; 0 without a seam.
    pub neck: f64,
    /// Length of the seam [scene unit].
    pub perimeter: f64,
    /// The curves along which the surfaces meet; vertices are numbered as in the union of the two.
    pub seams: Vec<Seam>,
}

/// Measures two bodies, given by their indices, from their union.
///
/// The depth is the greatest distance of a sample point on either surface, inside the other body, to that body's
/// surface. Sample points are the vertices, the midpoints of edges and of the parts of cut edges, and the centres of
/// triangles; of triangles that are large compared with a body, or beside the deepest of these, also the centres of
/// parts, unless the other body may intersect itself. For bodies that intersect themselves, the distance is to the
/// nearest sheet.
///
/// # Errors
///
/// Those of [`union`], which measures each body that intersects itself.
pub fn measures_of(
    united: &Union,
    pair: [usize; 2],
    budget: &Budget,
    hint: &mut Hint,
) -> Result<PairMeasures, UnionError> {
    let bodies = united.bodies;
    let volume = |body: usize| -> Result<f64, UnionError> {
        if united.is_simple(body) {
            return Ok(bodies[body].volume());
        }
        bodies[body].enclosed(|only| Ok(union(only, budget)?.volume()))
    };
    let gap = gap_of(united, pair, budget, hint)?;
    let overlap = if gap > 0.0 {
        0.0
    } else if pair.iter().all(|&body| bodies[body].slack() > 0.0) {
        united.taken(pair)
    } else {
        volume(pair[0])? + volume(pair[1])? - united.volume()
    };
    Ok(PairMeasures::new(gap, overlap.max(0.0), united.seams.clone()))
}

impl PairMeasures {
    fn new(gap: f64, overlap: f64, seams: Vec<Seam>) -> PairMeasures {
        let vector_area: DVec3 = seams.iter().map(|seam| seam.vector_area).sum();
        let neck = (vector_area.length() / std::f64::consts::PI).sqrt();
        PairMeasures { gap, overlap, neck, perimeter: seams.iter().map(|seam| seam.length).sum(), seams }
    }
}

/// Whether a plane is found that separates two bodies, neither of which may intersect itself: their measures do not need
/// their union.
pub fn are_apart(a: &Body, b: &Body) -> bool {
    // farther than a union displaces vertices
    let magnitude = a.bounds.max.abs().max(a.bounds.min.abs()).max_element();
    let is_apart = separation(a, b, b.centre - a.centre) > APART * (a.radius + b.radius + SCENE * magnitude);
    is_apart && a.slack() > 0.0 && b.slack() > 0.0
}

/// Measures two bodies that [are apart](are_apart) as [`measures_of`] does, without their union; `None` if they are not.
///
/// # Errors
///
/// Those of [`union`].
pub fn measures_apart(
    a: &Body,
    b: &Body,
    budget: &Budget,
    hint: &mut Hint,
) -> Result<Option<PairMeasures>, UnionError> {
    if !are_apart(a, b) {
        return Ok(None);
    }
    let meter = Meter::new(Budget { work: u64::MAX, ..*budget });
    let gap = Tree::new(a).distance(&Tree::new(b), &mut hint.triangles, &meter).map_err(|_| meter.gave_up())?;
    Ok(Some(PairMeasures::new(gap, 0.0, Vec::new())))
}

fn gap_of(united: &Union, [a, b]: [usize; 2], budget: &Budget, hint: &mut Hint) -> Result<f64, UnionError> {
    let meter = Meter::new(Budget { work: u64::MAX, ..*budget });
    let trees = [a, b].map(|body| Tree::new(&united.bodies[body]));
    let mut deepest = 0.0f64;
    for (body, tree) in [(a, &trees[1]), (b, &trees[0])].into_iter().filter(|&(body, _)| united.is_inside(body)) {
        deepen(united, body, tree, &mut deepest, &meter).map_err(|_| meter.gave_up())?;
    }
    // without a seam, what is not on the union may be inside its own body only
    if united.seams.is_empty() && deepest == 0.0 {
        return trees[0].distance(&trees[1], &mut hint.triangles, &meter).map_err(|_| meter.gave_up());
    }
    Ok(-deepest)
}

/// Raises `deepest` to the greatest depth in `other` of the part of a body's surface that is not on the union.
fn deepen(united: &Union, body: usize, other: &Tree, deepest: &mut f64, meter: &Meter) -> Result<(), Failure> {
    let samples = samples(united, body);
    let mut search = Search::default();
    let mut place = None;
    // where the search for a vertex ended, those for samples beside it begin
    let mut ended = vec![u32::MAX; united.bodies[body].topology.fan_count()];
    // the deepest point is usually the one nearest to the centre; shallower points then cost little
    let centre = other.body.centre;
    let key = |sample: &&Sample| sample.at.distance_squared(centre);
    let nearest = samples.iter().min_by(|a, b| key(a).total_cmp(&key(b)));
    // a surface that may cross itself is wound around each point
    let winding = if other.body.slack() > 0.0 { 0 } else { other.body.topology.triangle_count() as u64 / 64 };
    let cost = SAMPLE + winding;
    for &Sample { at, vertex, is_vertex } in nearest.into_iter().chain(&samples) {
        meter.spend(cost)?;
        let beside = &mut ended[vertex as usize];
        if !is_vertex && *beside != u32::MAX {
            search.hint = *beside;
        }
        if let Some(depth) = other.depth_beyond(at, *deepest, &mut search).filter(|depth| depth > deepest) {
            (*deepest, place) = (depth, Some(at));
        }
        if is_vertex {
            *beside = search.hint;
        }
    }
    deepen_in_coarse(united, body, (other, place), deepest, meter)
}

/// Raises `deepest` to the greatest depth in triangles that are large compared with one of the bodies, or beside the
/// `place` of the deepest sample, if this body has it. The depth grows by no more than the way, so that parts that
/// cannot exceed `deepest` are left out; those that may be deepest come first.
fn deepen_in_coarse(
    united: &Union,
    body: usize,
    (other, place): (&Tree, Option<DVec3>),
    deepest: &mut f64,
    meter: &Meter,
) -> Result<(), Failure> {
    let mesh = &united.bodies[body];
    if other.body.slack() <= 0.0 {
        return Ok(()); // whether points are inside takes long to tell
    }
    let radius = f64::min(mesh.radius, other.body.radius);
    let mut search = Search::default();
    // only of those that are divided further is more asked than whether they are deeper
    let mut sample = |corners: [DVec3; 3], is_last: bool, deepest: &mut f64| {
        let (at, size) = extent(corners);
        if !Aabb::of(corners).meets(&other.body.bounds) {
            return None;
        }
        let least = if is_last { *deepest } else { f64::max(*deepest - size, 0.0) };
        let depth = other.depth_beyond(at, least, &mut search).unwrap_or(0.0);
        *deepest = deepest.max(depth);
        Some(Part { corners, size, limit: depth + size })
    };
    let mut parts = BinaryHeap::new();
    for &t in &united.removed[body] {
        meter.spend(SAMPLE)?;
        let corners = mesh.corners(t);
        let (at, size) = extent(corners);
        if size > COARSE * radius {
            parts.extend(sample(corners, false, deepest));
        } else if place.is_some_and(|place| place.distance_squared(at) < (BESIDE * size).powi(2)) {
            meter.spend(4 * SAMPLE)?;
            for corners in divided(corners) {
                sample(corners, true, deepest);
            }
        }
    }
    for _ in 0..PARTS / 4 {
        let Some(part) = parts.pop().filter(|part| part.limit > *deepest + NEGLIGIBLE * radius) else { break };
        if part.size > FINE * radius {
            meter.spend(4 * SAMPLE)?;
            parts.extend(divided(part.corners).into_iter().filter_map(|corners| sample(corners, false, deepest)));
        }
    }
    Ok(())
}

/// A part of a triangle.
struct Part {
    corners: [DVec3; 3],
    /// From the centre to the farthest corner.
    size: f64,
    /// The depth that no point of it exceeds.
    limit: f64,
}

/// The centre of a triangle, and how far the farthest corner is from it.
fn extent(corners: [DVec3; 3]) -> (DVec3, f64) {
    let at = corners.iter().sum::<DVec3>() / 3.0;
    (at, corners.iter().map(|corner| corner.distance_squared(at)).fold(0.0, f64::max).sqrt())
}

/// The corners of the four parts of a triangle.
fn divided([a, b, c]: [DVec3; 3]) -> [[DVec3; 3]; 4] {
    let [ab, bc, ca] = [(a + b) / 2.0, (b + c) / 2.0, (c + a) / 2.0];
    [[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]
}

impl Ord for Part {
    fn cmp(&self, other: &Part) -> Ordering {
        self.limit.total_cmp(&other.limit)
    }
}

impl PartialOrd for Part {
    fn partial_cmp(&self, other: &Part) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Part {
    fn eq(&self, other: &Part) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Part {}

/// A point on a body's surface.
#[derive(Clone, Copy)]
struct Sample {
    at: DVec3,
    /// A vertex near it, or itself.
    vertex: u32,
    is_vertex: bool,
}

/// Sample points on the part of a body's surface that is not on the union.
fn samples(united: &Union, body: usize) -> Vec<Sample> {
    let near = |at: DVec3, vertex: u32| Sample { at, vertex, is_vertex: false };
    let mesh = &united.bodies[body];
    let topology = mesh.topology;
    let removed = &united.removed[body];
    let mut samples = Vec::with_capacity(4 * removed.len());
    // vertices that are still on the union are not inside, and each point counts once
    let (first, last) = (united.first_vertex[body], united.first_vertex[body + 1]);
    let mut is_done = vec![false; topology.fan_count()];
    for v in united.new_triangles.iter().flat_map(|triangle| triangle.corners) {
        if (first..last).contains(&v) {
            is_done[(v - first) as usize] = true;
        }
    }
    let is_lost = is_done.iter().map(|is_kept| !is_kept).collect::<Vec<bool>>();
    for v in removed.iter().flat_map(|&t| topology.triangles[t as usize]) {
        if !std::mem::replace(&mut is_done[v as usize], true) {
            samples.push(Sample { at: mesh.position(v), vertex: v, is_vertex: true });
        }
    }
    for &t in removed {
        let corners = topology.triangles[t as usize];
        for (k, edge) in topology.triangle_edges[t as usize].into_iter().enumerate() {
            let ends = [corners[k], corners[(k + 1) % 3]];
            let beside = topology.beside(edge, t);
            // if both triangles of the edge were removed, the first one samples it
            let is_first = t < beside || !united.is_removed(body as u32, beside);
            if is_first && ends.iter().all(|&v| is_lost[v as usize]) {
                samples.push(near((mesh.position(ends[0]) + mesh.position(ends[1])) / 2.0, ends[0]));
            }
        }
    }
    for &t in removed {
        let [a, b, c] = mesh.corners(t);
        samples.push(near((a + b + c) / 3.0, topology.triangles[t as usize][0]));
    }
    // between consecutive cuts of an edge, and between cuts and ends
    let mut cuts: Vec<([u32; 2], f64)> = (united.new_vertices.iter())
        .filter_map(|vertex| match vertex.origin {
            Origin::Edge { body: of, edge, at, .. } if of as usize == body => Some((edge, at)),
            _ => None,
        })
        .collect();
    cuts.sort_unstable_by(|x, y| x.0.cmp(&y.0).then(x.1.total_cmp(&y.1)));
    for cuts in cuts.chunk_by(|x, y| x.0 == y.0) {
        let [a, b] = cuts[0].0.map(|v| mesh.positions[v as usize]);
        let mut from = 0.0;
        for to in cuts.iter().map(|cut| cut.1).chain([1.0]) {
            samples.push(near(a + (b - a) * ((from + to) / 2.0), cuts[0].0[usize::from(from + to > 1.0)]));
            from = to;
        }
    }
    samples
}
