//! The surface of metaballs: the level set of their density at the threshold.
//!
//! # Extraction
//! Marching tetrahedra on a grid around the group: every cube of the grid is cut into the six tetrahedra around its
//! diagonal (Freudenthal's, or Kuhn's, triangulation), which match those of its neighbours. Tetrahedra have no
//! ambiguous cases, so the surface is always closed, manifold and oriented. Each vertex is on an edge of a tetrahedron,
//! at the root of the density: exactly on the surface. The triangles are chords of it, so the volume of the mesh is too
//! small by an error of second order in the spacing.
//!
//! The grid of two balls is aligned with the line of their centres, with a node at the saddle: the mesh is connected
//! exactly if the surface is.

use std::sync::atomic::AtomicBool;

use glam::{DMat3, DVec3};

use super::{
    contact::{Saddle, are_one},
    density::{Ball, Kernel, density_of, slope_of},
};
use crate::{
    analysis::surface::{connected, for_all},
    disjoint_sets::DisjointSets,
    interrupt::is_raised,
    models::cells::TETRAHEDRA,
    observe::{
        Frame, Schema,
        surface::{Group, PairMeasures, Surfaced, Surfaces, VertexOrigin},
    },
    sim::numerics::roots::root,
};

/// Spacing of the grid [radii of the smallest ball of a group].
const SPACING: f64 = 0.2;
/// Upper limit on the grid squares on the surfaces of a group's balls, per ball: next to a much larger ball, a small
/// one gets fewer.
const MAX_SQUARES: f64 = 2000.0;
/// Upper limit on the nodes of a grid; beyond it, the grid is coarser.
const MAX_NODES: f64 = 2e6;

/// The surfaces of a scene of metaballs.
#[derive(Clone, Debug)]
pub struct LevelSet {
    /// The density of each body.
    pub kernels: Vec<Kernel>,
}

impl Surfaces for LevelSet {
    fn merge(&self, schema: &Schema, frame: &Frame, pairs: &[[usize; 2]], interrupt: Option<&AtomicBool>) -> Surfaced {
        // groups are connected by merged pairs (thresholds on q) and by joined surfaces
        let groups = connected(frame, |pair| {
            schema.phases[pair.phase].is_joined || {
                let balls = self.around(schema, frame, &[pair.a, pair.b]);
                are_one(&balls)
            }
        });
        Surfaced {
            groups: for_all(&groups, |group| self.unite(schema, frame, group, interrupt)),
            pairs: for_all(pairs, |pair| self.measure(schema, frame, *pair, interrupt)),
        }
    }

    fn measure(
        &self,
        schema: &Schema,
        frame: &Frame,
        pair: [usize; 2],
        interrupt: Option<&AtomicBool>,
    ) -> Option<PairMeasures> {
        if is_raised(interrupt) {
            return None;
        }
        let balls = self.around(schema, frame, &pair);
        let (a, b) = (&balls[0], &balls[1]);
        let (radius, distance) = (f64::min(a.radius, b.radius), a.centre.distance(b.centre));
        let is_one = are_one(&balls);
        let gap = if is_one { f64::min(0.0, distance - a.radius - b.radius) } else { gap(&balls)? };
        let neck = if is_one { neck(&balls) } else { 0.0 };
        let overlap = lens(a.radius, b.radius, distance);
        Some(PairMeasures {
            gap: gap / radius,
            overlap: overlap / (radius * radius * radius),
            share: overlap / (std::f64::consts::PI * 4.0 / 3.0 * radius * radius * radius),
            neck: neck / radius,
            perimeter: std::f64::consts::TAU * neck / radius,
        })
    }
}

impl LevelSet {
    fn unite(&self, schema: &Schema, frame: &Frame, group: &[usize], interrupt: Option<&AtomicBool>) -> Option<Group> {
        if is_raised(interrupt) {
            return None;
        }
        let balls = self.around(schema, frame, group);
        let Mesh { positions, triangles } = extract(&balls, group.len(), interrupt)?;
        let origins = positions.iter().map(|&at| origin(&balls[..group.len()], group, at)).collect();
        let [volume, area] = measures(&positions, &triangles);
        let components = components(positions.len(), &triangles);
        let euler = positions.len() as i64 - triangles.len() as i64 / 2;
        Some(Group {
            bodies: group.to_vec(),
            normals: positions.iter().map(|&at| (-slope_of(&balls, at)).normalize_or(DVec3::Z)).collect(),
            positions,
            origins,
            triangles,
            seams: Vec::new(),
            components,
            euler,
            genus: components as i64 - euler / 2,
            volume,
            area,
        })
    }

    /// The balls of a group in a frame, followed by all others whose supports reach theirs.
    fn around(&self, schema: &Schema, frame: &Frame, group: &[usize]) -> Vec<Ball> {
        let ball = |body: usize| Ball {
            centre: frame.bodies[body].centre,
            radius: schema.bodies[body].radius,
            kernel: self.kernels[body],
        };
        super::around(frame.bodies.len(), ball, group)
    }
}

/// The distance between the surfaces of the first two balls, which are not joined, on the line of their centres
/// [scene unit]; `None` if that is inside of other balls all along.
fn gap(balls: &[Ball]) -> Option<f64> {
    let (a, b) = (&balls[0], &balls[1]);
    let distance = a.centre.distance(b.centre);
    let end = |from: &Ball, to: &Ball| {
        let along = (to.centre - from.centre) / distance;
        let excess = |r: f64| density_of(balls, from.centre + r * along) - 1.0;
        // outwards from the ball to the first point outside
        let step = (distance - a.radius - b.radius) / 64.0;
        let outside = (1..=64).map(|k| from.radius + f64::from(k) * step).find(|&r| excess(r) < 0.0);
        outside.map(|r| root(r - step, r, excess))
    };
    match (end(a, b), end(b, a)) {
        (Some(of_a), Some(of_b)) => Some(f64::max(0.0, distance - of_a - of_b)),
        _ if balls.len() == 2 => Some(0.0), // narrower than a sample
        _ => None,
    }
}

/// The radius of the circle with the area of a cross-section of the first two balls, which are joined [scene unit]: without
/// other balls the thinnest between the centres, with others that through the saddle between them.
fn neck(balls: &[Ball]) -> f64 {
    const DIRECTIONS: u32 = 16;
    const SECTIONS: u32 = 32;
    let (a, b) = (&balls[0], &balls[1]);
    let Some(along) = (b.centre - a.centre).try_normalize() else { return f64::max(a.radius, b.radius) };
    let (u, v) = along.any_orthonormal_pair();
    let support = f64::max(a.support(), b.support());
    let radius = |middle: DVec3, directions: u32| {
        let squares = (0..directions).map(|k| {
            let (sin, cos) = libm::sincos(std::f64::consts::TAU * f64::from(k) / f64::from(directions));
            let direction = cos * u + sin * v;
            let excess = |r: f64| density_of(balls, middle + r * direction) - 1.0;
            let r = root(0.0, support, excess);
            r * r
        });
        (squares.sum::<f64>() / f64::from(directions)).sqrt()
    };
    if let (true, Some(saddle)) = (balls.len() > 2, Saddle::between(balls)) {
        return radius(saddle.place, DIRECTIONS);
    }
    let distance = a.centre.distance(b.centre);
    // two balls are symmetric about the line of their centres
    let directions = if balls.len() == 2 { 1 } else { DIRECTIONS };
    let at = |r: f64| radius(a.centre + r * along, directions);
    let width = distance / f64::from(SECTIONS);
    let thinnest = (0..=SECTIONS).map(|k| (at(f64::from(k) * width), k)).min_by(|x, y| x.0.total_cmp(&y.0));
    let middle = thinnest.map_or(0.0, |(_, k)| f64::from(k) * width);
    golden_section([f64::max(0.0, middle - width), f64::min(distance, middle + width)], at)
}

/// The smallest value of a function with one minimum in an interval, to half of a double's digits in the place.
fn golden_section([mut low, mut high]: [f64; 2], of: impl Fn(f64) -> f64) -> f64 {
    const GOLDEN: f64 = 0.618_033_988_749_894_9;
    const TIMES: usize = 40;
    let mut places = [high - GOLDEN * (high - low), low + GOLDEN * (high - low)];
    let mut values = places.map(&of);
    for _ in 0..TIMES {
        if values[0] < values[1] {
            (high, places[1], values[1]) = (places[1], places[0], values[0]);
            places[0] = high - GOLDEN * (high - low);
            values[0] = of(places[0]);
        } else {
            (low, places[0], values[0]) = (places[0], places[1], values[1]);
            places[1] = low + GOLDEN * (high - low);
            values[1] = of(places[1]);
        }
    }
    [of(low), values[0], values[1], of(high)].into_iter().fold(f64::INFINITY, f64::min)
}

/// The two bodies of a group with the largest densities at a point.
fn origin(balls: &[Ball], group: &[usize], at: DVec3) -> VertexOrigin {
    let (mut first, mut second) = ((0, 0.0), (0, 0.0));
    for (ball, &body) in balls.iter().zip(group) {
        let density = ball.density(at);
        if density > first.1 {
            (second, first) = (first, (body, density));
        } else if density > second.1 {
            second = (body, density);
        }
    }
    let is_shared = second.1 > 0.0;
    VertexOrigin {
        bodies: [first.0 as u32, if is_shared { second.0 } else { first.0 } as u32],
        share: if is_shared { (second.1 / (first.1 + second.1)) as f32 } else { 0.0 },
        vertex: None,
    }
}

/// The volume of the intersection of two spheres [scene unit³].
fn lens(a: f64, b: f64, distance: f64) -> f64 {
    let (small, large) = (f64::min(a, b), f64::max(a, b));
    if distance >= a + b {
        0.0
    } else if distance <= large - small {
        4.0 / 3.0 * std::f64::consts::PI * small * small * small
    } else {
        let depth = a + b - distance;
        let (difference, sum) = (a - b, a + b);
        std::f64::consts::PI
            * depth
            * depth
            * (distance * distance + 2.0 * distance * sum - 3.0 * difference * difference)
            / (12.0 * distance)
    }
}

/// A closed triangle mesh.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    /// Positions of the vertices [scene unit], `[vertex_count]`.
    pub positions: Vec<DVec3>,
    /// Vertices of each triangle, counter-clockwise from outside.
    pub triangles: Vec<[u32; 3]>,
}

/// A grid of cubes.
struct Grid {
    origin: DVec3,
    axes: DMat3,
    spacing: f64,
    /// Number of nodes along each axis.
    counts: [usize; 3],
}

impl Grid {
    /// A grid that encloses the surface of the first `own` balls.
    fn about(balls: &[Ball], own: usize) -> Option<Grid> {
        let balls_own = balls.get(..own)?;
        let (axes, centre) = match balls_own {
            [a, b] => {
                let along = (b.centre - a.centre).normalize_or(DVec3::Z);
                let u = along.any_orthonormal_vector();
                let v = along.cross(u);
                let place = Saddle::between(balls).map_or(a.centre, |saddle| saddle.place);
                (DMat3::from_cols(u, v, along), place)
            }
            [a, ..] => (DMat3::IDENTITY, a.centre),
            [] => return None,
        };
        let inverse = axes.transpose();
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for ball in balls_own {
            let (at, support) = (inverse * (ball.centre - centre), DVec3::splat(ball.support()));
            (low, high) = (low.min(at - support), high.max(at + support));
        }
        let size = high - low;
        let smallest = balls_own.iter().map(|ball| ball.radius).fold(f64::INFINITY, f64::min);
        let area = 4.0 * std::f64::consts::PI * balls_own.iter().map(|ball| ball.radius * ball.radius).sum::<f64>();
        let spacing = [
            SPACING * smallest,
            (area / (MAX_SQUARES * own as f64)).sqrt(),
            (size.x * size.y * size.z / MAX_NODES).cbrt(),
        ];
        let spacing = spacing.into_iter().fold(0.0, f64::max);
        // the centre is a node; all nodes of the outermost layer are outside
        let before = (-low / spacing).ceil() + DVec3::ONE;
        let after = (high / spacing).ceil() + DVec3::ONE;
        let counts = (before + after + DVec3::ONE).to_array();
        let is_sound = counts.iter().all(|count| (1.0..=1e6).contains(count)) && spacing.is_finite();
        is_sound.then(|| Grid {
            origin: centre - axes * (before * spacing),
            axes,
            spacing,
            counts: counts.map(|count| count as usize),
        })
    }

    fn place(&self, [i, j, k]: [usize; 3]) -> DVec3 {
        self.origin + self.axes * (self.spacing * DVec3::new(i as f64, j as f64, k as f64))
    }

    fn index(&self, [i, j, k]: [usize; 3]) -> usize {
        (k * self.counts[1] + j) * self.counts[0] + i
    }

    /// Index difference between the two ends of an edge; bit m of `edge` is set if it leads along axis m.
    fn stride(&self, edge: usize) -> usize {
        let strides = [1, self.counts[0], self.counts[0] * self.counts[1]];
        (0..3).filter(|m| edge >> m & 1 == 1).map(|m| strides[m]).sum()
    }
}

/// The even permutations of four that begin with each pair, and with each single element.
const PAIRS: [[usize; 4]; 6] = [[0, 1, 2, 3], [0, 2, 3, 1], [0, 3, 1, 2], [1, 2, 0, 3], [1, 3, 2, 0], [2, 3, 0, 1]];
const SINGLES: [[usize; 4]; 4] = [[0, 1, 2, 3], [1, 0, 3, 2], [2, 0, 1, 3], [3, 0, 2, 1]];

/// The surface of the first `own` balls in the density of all; `None` if it exceeds the grid limits, or after an
/// interrupt.
pub fn extract(balls: &[Ball], own: usize, interrupt: Option<&AtomicBool>) -> Option<Mesh> {
    let grid = Grid::about(balls, own)?;
    let [nx, ny, nz] = grid.counts;
    let mut inside = vec![false; nx * ny * nz];
    for k in 0..nz {
        if is_raised(interrupt) {
            return None;
        }
        for j in 0..ny {
            for i in 0..nx {
                inside[grid.index([i, j, k])] = is_inside(balls, own, grid.place([i, j, k]));
            }
        }
    }
    let mut mesh = Mesh::default();
    // the vertex on each edge, by the edge's first node and its axes, for this layer of nodes and the next
    let layer = nx * ny;
    let mut known = [vec![u32::MAX; 8 * layer], vec![u32::MAX; 8 * layer]];
    let strides: [usize; 8] = std::array::from_fn(|edge| grid.stride(edge));
    let mut cuts: Vec<[[usize; 2]; 3]> = Vec::new();
    for k in 0..nz - 1 {
        if is_raised(interrupt) {
            return None;
        }
        if k > 0 {
            known.swap(0, 1);
            known[1].fill(u32::MAX);
        }
        for j in 0..ny - 1 {
            for i in 0..nx - 1 {
                let first = grid.index([i, j, k]);
                let corners: [bool; 8] = std::array::from_fn(|corner| inside[first + strides[corner]]);
                if corners == [corners[0]; 8] {
                    continue;
                }
                cuts.clear();
                TETRAHEDRA.iter().for_each(|corners_of| cut(corners_of, &corners, &mut cuts));
                let mut vertex = |[from, to]: [usize; 2]| {
                    let (low, edge) = (from.min(to), from ^ to);
                    let node = first + strides[low] - k * layer;
                    let slot = &mut known[node / layer][8 * (node % layer) + edge];
                    if *slot == u32::MAX {
                        let place =
                            |corner: usize| grid.place([i + (corner & 1), j + (corner >> 1 & 1), k + (corner >> 2)]);
                        let (inner, outer) = if corners[from] { (from, to) } else { (to, from) };
                        *slot = mesh.positions.len() as u32;
                        mesh.positions.push(on_surface(balls, place(inner), place(outer)));
                    }
                    *slot
                };
                mesh.triangles.extend(cuts.iter().map(|edges| edges.map(&mut vertex)));
            }
        }
    }
    Some(mesh)
}

/// The triangles in which the surface cuts a tetrahedron, each given by the edges of its corners: pairs of corners of
/// the cube.
fn cut(of: &[usize; 4], inside: &[bool; 8], cuts: &mut Vec<[[usize; 2]; 3]>) {
    let is_in = |m: usize| inside[of[m]];
    let edge = |a: usize, b: usize| [of[a], of[b]];
    match (0..4).filter(|&m| is_in(m)).count() {
        1 => {
            let single = SINGLES.into_iter().find(|single| is_in(single[0]));
            cuts.extend(single.map(|[a, b, c, d]| [edge(a, b), edge(a, c), edge(a, d)]));
        }
        2 => {
            let pair = PAIRS.into_iter().find(|pair| is_in(pair[0]) && is_in(pair[1]));
            cuts.extend(pair.into_iter().flat_map(|[a, b, c, d]| {
                let [ac, ad, bd, bc] = [edge(a, c), edge(a, d), edge(b, d), edge(b, c)];
                [[ac, ad, bd], [ac, bd, bc]]
            }));
        }
        3 => {
            let single = SINGLES.into_iter().find(|single| !is_in(single[0]));
            cuts.extend(single.map(|[a, b, c, d]| [edge(a, b), edge(a, d), edge(a, c)]));
        }
        _ => {}
    }
}

/// Whether a point is inside, and one of the first `own` balls is the densest there.
fn is_inside(balls: &[Ball], own: usize, at: DVec3) -> bool {
    let densest = |balls: &[Ball]| balls.iter().map(|ball| ball.density(at)).fold(0.0, f64::max);
    density_of(balls, at) >= 1.0 && (own == balls.len() || densest(&balls[..own]) >= densest(&balls[own..]))
}

/// The point of the surface between a point inside and a point outside.
fn on_surface(balls: &[Ball], inner: DVec3, outer: DVec3) -> DVec3 {
    let excess = |z: f64| density_of(balls, inner.lerp(outer, z)) - 1.0;
    // at the border to another group's surface, both points are inside
    let z = if excess(1.0) >= 0.0 { 0.5 } else { root(0.0, 1.0, excess) };
    inner.lerp(outer, z)
}

/// Number of connected components of a mesh.
fn components(vertices: usize, triangles: &[[u32; 3]]) -> usize {
    let mut sets = DisjointSets::singletons(vertices);
    for &[a, b, c] in triangles {
        sets.join(a, b);
        sets.join(b, c);
    }
    sets.count
}

/// Volume and area of a closed mesh [scene unit³, scene unit²].
pub(super) fn measures(positions: &[DVec3], triangles: &[[u32; 3]]) -> [f64; 2] {
    let origin = positions.first().copied().unwrap_or_default();
    triangles.iter().fold([0.0; 2], |[volume, area], corners| {
        let [a, b, c] = corners.map(|v| positions[v as usize] - origin);
        [volume + a.dot(b.cross(c)) / 6.0, area + 0.5 * (b - a).cross(c - a).length()]
    })
}
