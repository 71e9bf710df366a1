//! A closed mesh at its current positions, with data that does not depend on other bodies.

use glam::DVec3;
use pulp::{Arch, Simd, WithSimd};
use thiserror::Error;

use super::topology::Topology;

/// Limit of coordinates; larger ones would overflow in a volume.
const FARTHEST: f64 = 1e90;

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
    pub(super) fn of(points: impl IntoIterator<Item = DVec3>) -> Aabb {
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
    pub(super) fn meets(&self, other: &Aabb) -> bool {
        self.min.cmple(other.max).all() && other.min.cmple(self.max).all()
    }

    #[inline]
    pub(super) fn size_squared(&self) -> f64 {
        (self.max - self.min).length_squared()
    }

    #[inline]
    pub(super) fn contains(&self, point: DVec3) -> bool {
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

/// A convex set that contains a body: what its box and a ball have in common.
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
    pub(super) bounds: Aabb,
    pub(super) block_bounds: Vec<Aabb>,
    /// Mean of the vertices.
    pub(super) centre: DVec3,
    /// Radius of the ball about the centre that contains all vertices.
    pub(super) radius: f64,
    /// Radius of a ball about the centre that lies inside; 0 if none is known.
    pub(super) inner_radius: f64,
    /// Distance by which every vertex may be displaced without the surface intersecting itself; < 0 if unknown.
    pub(super) slack: f64,
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
    /// Takes time proportional to the mesh; the union then takes time proportional to the overlap.
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
            if !position.abs().cmplt(DVec3::splat(FARTHEST)).all() {
                return Err(BodyError::Position { vertex, position });
            }
            sum += position;
        }
        let mut body = Body {
            topology,
            positions,
            bounds: Aabb::EMPTY,
            block_bounds: Vec::with_capacity(topology.block_count()),
            centre: sum / positions.len().max(1) as f64,
            radius: 0.0,
            inner_radius: 0.0,
            slack: -1.0,
            volume: 0.0,
            area: 0.0,
        };
        body.bound();
        body.measure();
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
        // of all vertices that some triangle uses
        let is_used = |v: usize| !self.topology.edges_at(v as u32).is_empty();
        let distances = self.positions.iter().map(|p| p.distance_squared(self.centre));
        let mut farthest = 0.0;
        for (v, distance) in distances.enumerate() {
            if distance > farthest && is_used(v) {
                farthest = distance;
            }
        }
        self.radius = farthest.sqrt();
    }

    /// Computes the volume, the area, and whether every triangle is seen from the centre from its inner side. A
    /// connected mesh for which this holds, whatever its χ, covers the sphere of directions without a fold, so exactly
    /// once: it does not intersect itself.
    fn measure(&mut self) {
        let (topology, positions) = (self.topology, self.positions);
        let every_fan: Vec<DVec3>;
        let positions = if topology.copies.is_empty() {
            positions
        } else {
            every_fan = (0..topology.fan_count() as u32).map(|v| self.position(v)).collect();
            &every_fan
        };
        let of_all = Arch::new().dispatch(Measure { triangles: &topology.triangles, positions, centre: self.centre });
        self.volume = of_all.volume / 6.0;
        self.area = of_all.area / 2.0;
        let (slack_squared, height_squared) = (of_all.least_slack_squared, of_all.least_height_squared);
        // Beyond 1e50 scene units squares overflow and tell nothing.
        let is_known = slack_squared > 0.0 && slack_squared.is_finite() && height_squared.is_finite();
        if is_known && topology.components == 1 {
            self.slack = slack_squared.sqrt() / (6.0 * self.radius);
            self.inner_radius = height_squared.sqrt();
        }
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
        self.volume
    }

    /// Area [scene unit²].
    pub fn area(&self) -> f64 {
        self.area
    }

    /// Contains the body after a displacement of its vertices by less than `margin` [scene unit].
    pub(super) fn hull(&self, margin: f64) -> Hull {
        let radius = self.radius + 2.0 * margin; // rounding is less than another margin
        Hull { bounds: self.bounds.grown(margin), centre: self.centre, radius_squared: radius * radius }
    }

    #[inline]
    pub(super) fn position(&self, vertex: u32) -> DVec3 {
        self.positions[self.topology.place_of(vertex) as usize]
    }

    #[inline]
    pub(super) fn corners(&self, triangle: u32) -> [DVec3; 3] {
        let [a, b, c] = self.topology.triangles[triangle as usize];
        [self.position(a), self.position(b), self.position(c)]
    }

    /// In front of its surface, weighted at every vertex so that neither the lengths of edges nor diagonals matter
    /// (Max, *Weights for Computing Vertex Normals from Facet Normals*, 1999); 0 where it is not defined.
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

/// Number of triangles that are measured at once. They are summed in their order: the result does not depend on the
/// instruction set.
const AT_ONCE: usize = 8;

/// Measures all triangles of a body.
struct Measure<'m> {
    triangles: &'m [[u32; 3]],
    positions: &'m [DVec3],
    /// What the tetrahedra of the triangles have in common [scene unit].
    centre: DVec3,
}

/// What is known of the triangles of a body, each times a factor.
struct Measured {
    /// Six times the volume.
    volume: f64,
    /// Twice the area.
    area: f64,
    least_slack_squared: f64,
    least_height_squared: f64,
}

impl WithSimd for Measure<'_> {
    type Output = Measured;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Measured {
        let (mut volume, mut area) = (0.0, 0.0);
        let (mut slack, mut height) = ([f64::INFINITY; AT_ONCE], [f64::INFINITY; AT_ONCE]);
        for triangles in self.triangles.chunks(AT_ONCE) {
            // the last one again, where there are fewer
            let mut filled = [triangles[triangles.len() - 1]; AT_ONCE];
            filled[..triangles.len()].copy_from_slice(triangles);
            let (volumes, areas) = self.of(&filled, &mut slack, &mut height);
            for k in 0..triangles.len() {
                volume += volumes[k];
                area += areas[k];
            }
        }
        let least = |of: [f64; AT_ONCE]| of.into_iter().fold(f64::INFINITY, f64::min);
        Measured { volume, area, least_slack_squared: least(slack), least_height_squared: least(height) }
    }
}

impl Measure<'_> {
    /// The volumes and areas of some triangles, times six and two.
    #[inline(always)]
    fn of(
        &self,
        triangles: &[[u32; 3]; AT_ONCE],
        least_slack_squared: &mut [f64; AT_ONCE],
        least_height_squared: &mut [f64; AT_ONCE],
    ) -> ([f64; AT_ONCE], [f64; AT_ONCE]) {
        let mut corners = [[0.0; AT_ONCE]; 9];
        for k in 0..AT_ONCE {
            for (i, vertex) in triangles[k].into_iter().enumerate() {
                let at = self.positions[vertex as usize];
                (corners[3 * i][k], corners[3 * i + 1][k], corners[3 * i + 2][k]) = (at.x, at.y, at.z);
            }
        }
        let (mut volumes, mut areas) = ([0.0; AT_ONCE], [0.0; AT_ONCE]);
        for k in 0..AT_ONCE {
            let corner = |i: usize| DVec3::new(corners[3 * i][k], corners[3 * i + 1][k], corners[3 * i + 2][k]);
            let (a, b, c) = (corner(0) - self.centre, corner(1) - self.centre, corner(2) - self.centre);
            let (ab, bc, ca) = (b - a, c - b, a - c);
            let normal = ab.cross(-ca);
            let volume = a.dot(normal);
            let normal_squared = normal.length_squared();
            // Displacing each corner by d changes the volume by at most d (|a×b| + |b×c| + |c×a|) to first order, and
            // |a×b| ≤ |a| |ab|; twice that covers the higher orders. With its sign, and squared: that spares a root.
            let sides = [ab.length_squared(), bc.length_squared(), ca.length_squared()];
            let longer = if sides[0] > sides[1] { sides[0] } else { sides[1] };
            let longest = if longer > sides[2] { longer } else { sides[2] };
            let slack_squared = volume * volume.abs() / longest;
            let height_squared = volume * volume / normal_squared;
            let slack = &mut least_slack_squared[k];
            *slack = if slack_squared < *slack { slack_squared } else { *slack };
            let height = &mut least_height_squared[k];
            *height = if height_squared < *height { height_squared } else { *height };
            volumes[k] = volume;
            areas[k] = normal_squared.sqrt();
        }
        (volumes, areas)
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
        // whole groups of triangles, and some beside them
        for count in [mesh.triangles().len(), 16, 5, 1, 0] {
            let triangles = &mesh.triangles()[..count];
            let of = |arch: Arch| {
                let of_all = arch.dispatch(Measure { triangles, positions: &positions, centre });
                [of_all.volume, of_all.area, of_all.least_slack_squared, of_all.least_height_squared].map(f64::to_bits)
            };
            let plain = of(Arch::Scalar);
            assert!(archs.into_iter().flatten().all(|arch| of(arch) == plain), "{count} triangles");
        }
    }
}
