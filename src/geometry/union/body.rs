//! A closed mesh at its current positions, with data that does not depend on other bodies.

use glam::DVec3;
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
        self.min = self.min.min(point);
        self.max = self.max.max(point);
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
        Aabb { min: self.min.min(other.min), max: self.max.max(other.max) }
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
            if !(position.abs().max_element() < FARTHEST && position.is_finite()) {
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
        let mut farthest = 0.0f64;
        for block in 0..self.topology.block_count() {
            let mut hull = Aabb::EMPTY;
            for &v in self.topology.vertices_of_block(block) {
                let p = self.position(v);
                hull.take_in(p);
                farthest = farthest.max(p.distance_squared(self.centre));
            }
            self.bounds = self.bounds.joined(&hull);
            self.block_bounds.push(hull);
        }
        self.radius = farthest.sqrt();
    }

    /// Computes the volume, the area, and whether every triangle is seen from the centre from its inner side. A
    /// connected mesh for which this holds, whatever its χ, covers the sphere of directions without a fold, so exactly
    /// once: it does not intersect itself.
    fn measure(&mut self) {
        let (positions, centre) = (self.positions, self.centre);
        if self.topology.copies.is_empty() {
            self.measure_triangles(|v| positions[v as usize] - centre);
        } else {
            let topology = self.topology;
            self.measure_triangles(|v| positions[topology.place_of(v) as usize] - centre);
        }
    }

    #[inline]
    fn measure_triangles(&mut self, position: impl Fn(u32) -> DVec3) {
        let (mut least_height_squared, mut least_slack_squared) = (f64::INFINITY, f64::INFINITY);
        let (mut volumes, mut areas) = (0.0, 0.0);
        for &[a, b, c] in &self.topology.triangles {
            let (a, b, c) = (position(a), position(b), position(c));
            let (ab, bc, ca) = (b - a, c - b, a - c);
            let normal = ab.cross(-ca);
            let volume = a.dot(normal);
            let normal_squared = normal.length_squared();
            volumes += volume;
            areas += normal_squared.sqrt();
            // Displacing each corner by d changes the volume by at most d (|a×b| + |b×c| + |c×a|) to first order, and
            // |a×b| ≤ |a| |ab|; twice that covers the higher orders. With its sign, and squared: that spares a root.
            let sides = [ab.length_squared(), bc.length_squared(), ca.length_squared()];
            let longer = if sides[0] > sides[1] { sides[0] } else { sides[1] };
            let longest = if longer > sides[2] { longer } else { sides[2] };
            let slack_squared = volume * volume.abs() / longest;
            if slack_squared < least_slack_squared {
                least_slack_squared = slack_squared;
            }
            let height_squared = volume * volume / normal_squared;
            if height_squared < least_height_squared {
                least_height_squared = height_squared;
            }
        }
        self.volume = volumes / 6.0;
        self.area = areas / 2.0;
        // Beyond 1e50 scene units squares overflow and tell nothing.
        let is_known = least_slack_squared > 0.0 && least_slack_squared.is_finite() && least_height_squared.is_finite();
        if is_known && self.topology.components == 1 {
            self.slack = least_slack_squared.sqrt() / (6.0 * self.radius);
            self.inner_radius = least_height_squared.sqrt();
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
