//! A closed mesh at its current positions, with data that does not depend on other bodies.

use std::sync::OnceLock;

use glam::DVec3;
use pulp::{Arch, Simd, WithSimd};
use thiserror::Error;

use super::topology::Topology;

/// Limit on coordinates; larger ones would overflow in a volume.
const MAX_COORDINATE: f64 = 1e90;

/// An axis-aligned bounding box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aabb {
    /// Smallest coordinates [scene unit].
    pub min: DVec3,
    /// Largest coordinates [scene unit].
    pub max: DVec3,
}

impl Aabb {
    /// The empty box.
    pub(super) const EMPTY: Aabb = Aabb { min: DVec3::INFINITY, max: DVec3::NEG_INFINITY };

    #[inline]
    pub(super) fn take_in(&mut self, point: DVec3) {
        (self.min, self.max) = (lower(self.min, point), higher(self.max, point));
    }

    #[inline]
    pub(crate) fn of(points: impl IntoIterator<Item = DVec3>) -> Aabb {
        let mut hull = Aabb::EMPTY;
        for point in points {
            hull.take_in(point);
        }
        hull
    }

    #[inline]
    pub(super) fn joined(&self, other: &Aabb) -> Aabb {
        Aabb { min: lower(self.min, other.min), max: higher(self.max, other.max) }
    }

    #[inline]
    pub(super) fn grown(&self, by: f64) -> Aabb {
        Aabb { min: self.min - by, max: self.max + by }
    }

    #[inline]
    pub(crate) fn meets(&self, other: &Aabb) -> bool {
        self.min.cmple(other.max).all() && other.min.cmple(self.max).all()
    }

    #[inline]
    pub(super) fn size_squared(&self) -> f64 {
        (self.max - self.min).length_squared()
    }

    /// Whether a point is in the box.
    #[inline]
    pub fn contains(&self, point: DVec3) -> bool {
        self.min.cmple(point).all() && point.cmple(self.max).all()
    }
}

/// The lower coordinates of two points: one comparison each, because nothing here is NaN.
#[inline]
pub(super) fn lower(a: DVec3, b: DVec3) -> DVec3 {
    let lower = |a: f64, b: f64| if b < a { b } else { a };
    DVec3::new(lower(a.x, b.x), lower(a.y, b.y), lower(a.z, b.z))
}

/// The higher coordinates of two points.
#[inline]
pub(super) fn higher(a: DVec3, b: DVec3) -> DVec3 {
    let higher = |a: f64, b: f64| if b > a { b } else { a };
    DVec3::new(higher(a.x, b.x), higher(a.y, b.y), higher(a.z, b.z))
}

/// A convex set that contains a body: the intersection of its box and a ball.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hull {
    bounds: Aabb,
    centre: DVec3,
    radius_squared: f64,
}

impl Hull {
    #[inline]
    pub(super) fn meets(&self, bounds: &Aabb) -> bool {
        self.bounds.meets(bounds)
            && self.centre.clamp(bounds.min, bounds.max).distance_squared(self.centre) <= self.radius_squared
    }

    #[inline]
    pub(super) fn contains(&self, point: DVec3) -> bool {
        self.bounds.contains(point) && point.distance_squared(self.centre) <= self.radius_squared
    }
}

/// A closed mesh at given positions. It may intersect itself, lie inside out and have any number of components.
#[derive(Clone, Debug)]
pub struct Body<'a> {
    pub(super) topology: &'a Topology,
    pub(super) positions: &'a [DVec3],
    /// Positions of the vertices of further fans, which follow the given ones.
    copied: Vec<DVec3>,
    pub(super) bounds: Aabb,
    pub(super) block_bounds: Vec<Aabb>,
    /// Mean of the vertices.
    pub(super) centre: DVec3,
    /// Radius of the ball about the centre that contains all vertices.
    pub(super) radius: f64,
    star: OnceLock<Star>,
    extent: OnceLock<Extent>,
    enclosed: OnceLock<f64>,
}

/// Properties of a body whose whole surface is visible from the centre, from its inner side.
#[derive(Clone, Copy, Debug)]
struct Star {
    inner_radius: f64,
    slack: f64,
}

/// Volume [scene unit³] and area [scene unit²].
#[derive(Clone, Copy, Debug)]
struct Extent {
    volume: f64,
    area: f64,
}

/// Why positions are rejected.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum BodyError {
    /// The number of positions differs from the number of vertices of the topology.
    #[error("{given} positions for {wanted} vertices")]
    Count {
        /// Number of positions given.
        given: usize,
        /// Number of vertices of the topology.
        wanted: usize,
    },
    /// A coordinate that is NaN, infinite, or beyond 1e90.
    #[error("vertex {vertex} is at {position}, which cannot be computed with")]
    Position {
        /// The first such vertex.
        vertex: usize,
        /// Its position.
        position: DVec3,
    },
}

impl<'a> Body<'a> {
    /// The mesh `topology` with its vertices at `positions` [scene unit], `[vertex_count]`.
    ///
    /// Computes boxes, in time proportional to the mesh. So does the first union of the body, to prove that it does not
    /// intersect itself. All other costs of a union are proportional to the overlap.
    ///
    /// # Errors
    ///
    /// If a position is not usable, or the number of positions is wrong.
    pub fn new(topology: &'a Topology, positions: &'a [DVec3]) -> Result<Body<'a>, BodyError> {
        if positions.len() != topology.vertex_count() {
            return Err(BodyError::Count { given: positions.len(), wanted: topology.vertex_count() });
        }
        let mut sum = DVec3::ZERO;
        for (vertex, &position) in positions.iter().enumerate() {
            if !position.abs().cmplt(DVec3::splat(MAX_COORDINATE)).all() {
                return Err(BodyError::Position { vertex, position });
            }
            sum += position;
        }
        let mut body = Body {
            topology,
            positions,
            copied: topology.copies.iter().map(|&place| positions[place as usize]).collect(),
            bounds: Aabb::EMPTY,
            block_bounds: Vec::with_capacity(topology.block_count()),
            centre: sum / positions.len().max(1) as f64,
            radius: 0.0,
            star: OnceLock::new(),
            extent: OnceLock::new(),
            enclosed: OnceLock::new(),
        };
        body.bound();
        Ok(body)
    }

    fn bound(&mut self) {
        for block in 0..self.topology.block_count() {
            let mut hull = Aabb::EMPTY;
            for &v in self.topology.vertices_of_block(block) {
                hull.take_in(self.position(v));
            }
            self.bounds = self.bounds.joined(&hull);
            self.block_bounds.push(hull);
        }
        // over all vertices that some triangle uses
        let is_every_used = self.topology.used_vertices as usize == self.topology.fan_count();
        let is_used = |v: usize| is_every_used || !self.topology.edges_at(v as u32).is_empty();
        let distances = self.positions.iter().map(|p| p.distance_squared(self.centre));
        let mut farthest = 0.0;
        for (v, distance) in distances.enumerate() {
            if distance > farthest && is_used(v) {
                farthest = distance;
            }
        }
        self.radius = farthest.sqrt();
    }

    /// Calls a kernel for all triangles.
    fn of_triangles<K: Kernel>(&self, kernel: K) -> K {
        let every_fan: Vec<DVec3>;
        let positions = if self.copied.is_empty() {
            self.positions
        } else {
            every_fan = [self.positions, &self.copied].concat();
            &every_fan
        };
        Arch::new().dispatch(OfTriangles {
            triangles: &self.topology.triangles,
            positions,
            centre: self.centre,
            kernel,
        })
    }

    /// Whether the inner side of every triangle faces the centre. A connected mesh for which this holds, whatever its
    /// χ, covers the sphere of directions without a fold, so exactly once: it does not intersect itself.
    fn star(&self) -> &Star {
        self.star.get_or_init(|| {
            let least = self.of_triangles(Least::default());
            let (slack_squared, height_squared) = (least.slack_squared.least(), least.height_squared.least());
            // beyond these radii, the compared products over- or underflow; single triangles of other sizes do not
            // matter: where they are so small that their products underflow, the slack is negligible
            let is_known = (1e-30..1e30).contains(&self.radius) && slack_squared > 0.0 && slack_squared.is_finite();
            if is_known && height_squared.is_finite() && self.topology.components.len() == 1 {
                Star { slack: slack_squared.sqrt() / (6.0 * self.radius), inner_radius: height_squared.sqrt() }
            } else {
                Star { slack: -1.0, inner_radius: 0.0 }
            }
        })
    }

    /// Distance by which every vertex may be displaced without the surface intersecting itself; < 0 if unknown.
    pub(super) fn slack(&self) -> f64 {
        self.star().slack
    }

    /// Radius of a ball about the centre that lies inside; 0 if none is known.
    pub(super) fn inner_radius(&self) -> f64 {
        self.star().inner_radius
    }

    /// The body without a known ball inside it.
    #[cfg(test)]
    pub(super) fn with_unknown_inside(mut self) -> Body<'a> {
        let slack = self.slack();
        self.star = OnceLock::from(Star { slack, inner_radius: 0.0 });
        self
    }

    fn extent(&self) -> &Extent {
        self.extent.get_or_init(|| {
            let sums = self.of_triangles(Sums::default());
            Extent { volume: sums.volume / 6.0, area: sums.area / 2.0 }
        })
    }

    /// The topology.
    pub fn topology(&self) -> &'a Topology {
        self.topology
    }

    /// Positions of the vertices [scene unit], `[vertex_count]`.
    pub fn positions(&self) -> &'a [DVec3] {
        self.positions
    }

    /// Its bounding box [scene unit].
    pub fn bounds(&self) -> Aabb {
        self.bounds
    }

    /// Signed volume [scene unit³]; for a mesh that intersects itself, volume times winding number.
    pub fn volume(&self) -> f64 {
        self.extent().volume
    }

    /// Whether it is inside out: the volume that it encloses is negative.
    pub fn is_inside_out(&self) -> bool {
        self.slack() < 0.0 && self.volume() < 0.0
    }

    /// Area [scene unit²].
    pub fn area(&self) -> f64 {
        self.extent().area
    }

    /// Volume of what the body encloses [scene unit³], where what it encloses twice counts once: on the first call, that of
    /// the union of `only` this body.
    pub(super) fn enclosed<E>(&self, volume: impl FnOnce(&[Body<'a>]) -> Result<f64, E>) -> Result<f64, E> {
        match self.enclosed.get() {
            Some(&known) => Ok(known),
            None => volume(std::slice::from_ref(self)).map(|volume| *self.enclosed.get_or_init(|| volume)),
        }
    }

    /// Contains the body after a displacement of its vertices by less than `margin` [scene unit].
    pub(super) fn hull(&self, margin: f64) -> Hull {
        let radius = self.radius + 2.0 * margin; // rounding is less than another margin
        Hull { bounds: self.bounds.grown(margin), centre: self.centre, radius_squared: radius * radius }
    }

    #[inline]
    pub(super) fn position(&self, vertex: u32) -> DVec3 {
        match self.positions.get(vertex as usize) {
            Some(&position) => position,
            None => self.copied[vertex as usize - self.positions.len()],
        }
    }

    #[inline]
    pub(super) fn corners(&self, triangle: u32) -> [DVec3; 3] {
        let [a, b, c] = self.topology.triangles[triangle as usize];
        [self.position(a), self.position(b), self.position(c)]
    }

    /// The outward unit normal at a vertex, weighted such that neither edge lengths nor diagonals matter (Max, *Weights
    /// for Computing Vertex Normals from Facet Normals*, 1999); 0 where it is not defined.
    pub(super) fn normal(&self, vertex: u32) -> DVec3 {
        let at = self.position(vertex);
        let mut sum = DVec3::ZERO;
        for &edge in self.topology.edges_at(vertex) {
            let (t, k) = self.topology.triangle_left_of(edge, vertex);
            let corners = &self.topology.triangles[t as usize];
            let (a, b) = (self.position(corners[(k + 1) % 3]) - at, self.position(corners[(k + 2) % 3]) - at);
            let weighted = a.cross(b) / (a.length_squared() * b.length_squared());
            if weighted.is_finite() {
                sum += weighted;
            }
        }
        sum.try_normalize().unwrap_or(DVec3::ZERO)
    }
}

/// Number of triangles that are measured at once. They are summed in order, so the result does not depend on the
/// instruction set.
const AT_ONCE: usize = 8;

/// One number for each of the triangles that are measured at once.
type Lanes = [f64; AT_ONCE];

/// A reduction over all triangles of a body.
trait Kernel {
    /// Adds `count` triangles with the corners a, b, c relative to the common apex; the remaining lanes repeat the last
    /// one.
    fn take(&mut self, corners: &[[Lanes; 3]; 3], count: usize);
}

/// Calls a kernel for all triangles of a body.
struct OfTriangles<'m, K> {
    triangles: &'m [[u32; 3]],
    positions: &'m [DVec3],
    /// The common apex of the triangles' tetrahedra [scene unit].
    centre: DVec3,
    kernel: K,
}

impl<K: Kernel> WithSimd for OfTriangles<'_, K> {
    type Output = K;

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, _: S) -> K {
        let (whole, rest) = self.triangles.as_chunks::<AT_ONCE>();
        for triangles in whole {
            self.take(triangles, AT_ONCE);
        }
        if let Some(&last) = rest.last() {
            let mut filled = [last; AT_ONCE];
            filled[..rest.len()].copy_from_slice(rest);
            self.take(&filled, rest.len());
        }
        self.kernel
    }
}

impl<K: Kernel> OfTriangles<'_, K> {
    #[inline(always)]
    fn take(&mut self, triangles: &[[u32; 3]; AT_ONCE], count: usize) {
        let corners = [0, 1, 2].map(|i| {
            let at: [DVec3; AT_ONCE] = std::array::from_fn(|k| self.positions[triangles[k][i] as usize]);
            let (x, y, z) = (at.map(|at| at.x), at.map(|at| at.y), at.map(|at| at.z));
            let centre = self.centre;
            [x.map(|x| x - centre.x), y.map(|y| y - centre.y), z.map(|z| z - centre.z)]
        });
        self.kernel.take(&corners, count);
    }
}

#[inline(always)]
fn corner([x, y, z]: &[Lanes; 3], k: usize) -> DVec3 {
    DVec3::new(x[k], y[k], z[k])
}

/// Six times the volume and twice the area.
#[derive(Default)]
struct Sums {
    volume: f64,
    area: f64,
}

impl Kernel for Sums {
    #[inline(always)]
    fn take(&mut self, corners: &[[Lanes; 3]; 3], count: usize) {
        let (mut volumes, mut areas) = ([0.0; AT_ONCE], [0.0; AT_ONCE]);
        for k in 0..AT_ONCE {
            let [a, b, c] = [0, 1, 2].map(|i| corner(&corners[i], k));
            let normal = (b - a).cross(c - a);
            (volumes[k], areas[k]) = (a.dot(normal), normal.length_squared().sqrt());
        }
        for k in 0..count {
            self.volume += volumes[k];
            self.area += areas[k];
        }
    }
}

/// The smallest fraction per lane, as numerators and positive denominators: comparing products avoids a division each.
struct Fractions {
    above: Lanes,
    below: Lanes,
}

impl Default for Fractions {
    fn default() -> Fractions {
        Fractions { above: [f64::INFINITY; AT_ONCE], below: [1.0; AT_ONCE] }
    }
}

impl Fractions {
    #[inline(always)]
    fn take(&mut self, k: usize, above: f64, below: f64) {
        let is_less = above * self.below[k] < self.above[k] * below;
        self.above[k] = if is_less { above } else { self.above[k] };
        self.below[k] = if is_less { below } else { self.below[k] };
    }

    fn least(&self) -> f64 {
        (0..AT_ONCE).map(|k| self.above[k] / self.below[k]).fold(f64::INFINITY, f64::min)
    }
}

/// Squares of the smallest slack and of the smallest height over the centre, up to constant factors.
#[derive(Default)]
struct Least {
    slack_squared: Fractions,
    height_squared: Fractions,
}

impl Kernel for Least {
    #[inline(always)]
    fn take(&mut self, corners: &[[Lanes; 3]; 3], _: usize) {
        for k in 0..AT_ONCE {
            let [a, b, c] = [0, 1, 2].map(|i| corner(&corners[i], k));
            let (ab, bc, ca) = (b - a, c - b, a - c);
            let normal = ab.cross(-ca);
            let volume = a.dot(normal);
            // Displacing each corner by d changes the volume by at most d (|a×b| + |b×c| + |c×a|) to first order, and
            // |a×b| ≤ |a| |ab|; twice that covers the higher orders. Signed and squared, to avoid a square root.
            let sides = [ab.length_squared(), bc.length_squared(), ca.length_squared()];
            let longer = if sides[0] > sides[1] { sides[0] } else { sides[1] };
            let longest = if longer > sides[2] { longer } else { sides[2] };
            self.slack_squared.take(k, volume * volume.abs(), longest);
            self.height_squared.take(k, volume * volume, normal.length_squared());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{shape::Solid as _, sphere::Sphere};

    #[cfg(target_arch = "x86_64")]
    #[test]
    fn every_instruction_set_measures_the_same() {
        let mesh = Sphere { stacks: 9, slices: 13 }.mesh();
        let shift = |(v, at): (usize, DVec3)| at * (1.0 + 0.01 * libm::sin(v as f64)) + DVec3::new(3.0, 0.1, -2.0);
        let positions: Vec<DVec3> = mesh.positions().iter().enumerate().map(shift).collect();
        let centre = DVec3::new(3.01, 0.1, -2.0);
        let archs = [
            Some(Arch::Scalar),
            pulp::x86::V3::try_new().map(Arch::V3),
            pulp::x86::V4::try_new().map(Arch::V4),
            Some(Arch::new()),
        ];
        // whole groups of triangles, and remainders
        for count in [mesh.triangles().len(), 16, 5, 1, 0] {
            let triangles = &mesh.triangles()[..count];
            fn all<K: Kernel>(arch: Arch, triangles: &[[u32; 3]], positions: &[DVec3], centre: DVec3, kernel: K) -> K {
                arch.dispatch(OfTriangles { triangles, positions, centre, kernel })
            }
            let of = |arch: Arch| {
                let Sums { volume, area } = all(arch, triangles, &positions, centre, Sums::default());
                let least = all(arch, triangles, &positions, centre, Least::default());
                [volume, area, least.slack_squared.least(), least.height_squared.least()].map(f64::to_bits)
            };
            let plain = of(Arch::Scalar);
            assert!(archs.into_iter().flatten().all(|arch| of(arch) == plain), "{count} triangles");
        }
    }
}
