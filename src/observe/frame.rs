//! The state of a simulation at an instant.

use std::sync::Arc;

use glam::{DMat3, DQuat, DVec3};

use super::{event::Instant, schema::BodySchema};
use crate::geometry::{Mesh, Rest, Vectors};

/// Optional contents of a frame. Bodies, vertices and pairs are always included; nothing else is computed unless it is
/// requested here.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Want {
    /// Whether forces by term, vertex labels and springs are included.
    pub forces: bool,
    /// Whether the scalars of the state are included, and those of bodies and pairs.
    pub scalars: bool,
}

impl Want {
    /// Requests everything.
    pub const ALL: Want = Want { forces: true, scalars: true };
}

/// The state at an instant. Frames are reused from one instant to the next.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct Frame {
    /// The instant of the state.
    pub at: Instant,
    /// The bodies, in the order of the schema.
    pub bodies: Vec<BodyFrame>,
    /// Pairs that can act on each other or are not in the first phase, in ascending order of their bodies.
    pub pairs: Vec<PairFrame>,
    /// Scalars in the order of the schema; entries of scalars that do not describe the state are ignored.
    pub scalars: Vec<f64>,
    /// The scalars of each body, body by body, `[bodies × body_scalars]`: NaN where a body has no such number.
    pub body_scalars: Vec<f64>,
    /// The scalars of each of `pairs`, pair by pair, `[pairs × pair_scalars]`: NaN where a pair has no such number.
    pub pair_scalars: Vec<f64>,
}

/// A body at an instant. Reused from one frame to the next.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct BodyFrame {
    /// Position of its centre [scene unit].
    pub centre: DVec3,
    /// Rotation Q of its rest shape: a vertex at rest is at centre + Q l. The identity for a body that does not rotate.
    pub rotation: DQuat,
    /// Whether it is not there, yet or any more ([`BodySchema::can_be_absent`]). It is then at rest, and in no pair; its
    /// centre is of no importance. All its vertices count as being at its centre.
    pub is_absent: bool,
    /// Whether every displacement and velocity is exactly zero; if so, the vectors are empty.
    pub is_at_rest: bool,
    /// The mesh of a body that has torn ([`BodySchema::can_tear`]); `None` for the schema's mesh. Tearing only adds
    /// vertices: the first ones are those of the schema's mesh, in the same order, though some may be in no triangle.
    /// Rest positions are in units of the schema's radius, see [`Mesh::version`]. All vectors here have one entry per
    /// vertex of this mesh.
    pub mesh: Option<Arc<Mesh>>,
    /// Displacements x of the vertices from Q l, in world axes like all vectors here [scene unit], `[vertex_count]`.
    pub displacements: Vectors,
    /// Velocities x′ of the vertices [scene unit/s], `[vertex_count]`.
    pub velocities: Vectors,
    /// Positions of the vertices relative to the centre [scene unit], `[vertex_count]`.
    pub positions: Vectors,
    /// Displacement lengths |x| of the vertices [scene unit], `[vertex_count]`.
    pub lengths: Vec<f64>,
    /// The largest |x| [scene unit].
    pub max_displacement: f64,
    /// Whether `terms` or `point_forces` has any force on the body.
    pub has_forces: bool,
    /// Accelerations of the vertices, one entry per force term of the schema.
    pub terms: Vec<TermFrame>,
    /// Forces at points that are no vertices, such as contacts, in any order: as many as there are, each with a source of
    /// its own.
    pub point_forces: Vec<PointForce>,
    /// A label for each vertex, as an index into the schema's labels, `[vertex_count]`; empty if no force acts.
    pub labels: Vec<u8>,
    /// The springs of a body that is made of them ([`BodySchema::has_springs`]), in any order; broken ones are left out.
    pub springs: Vec<SpringFrame>,
    /// Rigid motion of a free body; `None` for other bodies.
    pub motion: Option<MotionFrame>,
    /// Net force and torque on a free body; `None` for other bodies, and if forces are not requested.
    pub net_force: Option<NetForce>,
}

/// A spring of a body.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct SpringFrame {
    /// Positions of its ends relative to the centre of the body [scene unit].
    pub ends: [DVec3; 2],
    /// Its length over that at rest, minus 1 [–].
    pub strain: f64,
}

/// A force of a term at a point of a body.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct PointForce {
    /// Index into the schema's terms.
    pub term: usize,
    /// The point, relative to the centre of the body and in world axes [scene unit].
    pub place: DVec3,
    /// The acceleration that it gives the body [scene unit/s²].
    pub acceleration: DVec3,
    /// Index of the body that causes it, if it is one.
    pub source: Option<u32>,
}

/// Rigid motion of a free body.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct MotionFrame {
    /// Velocity of its centre [scene unit/s].
    pub velocity: DVec3,
    /// Angular velocity of its rest shape, in world axes [rad/s].
    pub spin: DVec3,
}

/// Net force and torque on a free body.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct NetForce {
    /// Force at its centre [mass · scene unit/s²].
    pub force: DVec3,
    /// Torque about its centre [mass · scene unit²/s²].
    pub torque: DVec3,
    /// Mass of the body now: less than in the schema, if a piece has come off.
    pub mass: f64,
}

/// The contribution of one force term to a body.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct TermFrame {
    /// Accelerations [scene unit/s²], `[vertex_count]`; empty if all are zero.
    pub accelerations: Vectors,
    /// Index of the body that causes the accelerations, if it is a single one.
    pub source: Option<u32>,
    /// Their sum over the masses that they move, by the mass of the body [scene unit/s²], if these masses are not at the
    /// vertices.
    pub mean: Option<DVec3>,
}

/// A pair of bodies at an instant.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct PairFrame {
    /// Index of the first body.
    pub a: usize,
    /// Index of the second body; a < b.
    pub b: usize,
    /// The quantity that decides the phase: centre distance over the sum of the radii [–].
    pub q: f64,
    /// Rate at which q changes [1/s]; NaN if it is not known.
    pub rate: f64,
    /// Index into the schema's phases.
    pub phase: usize,
}

impl SpringFrame {
    /// A spring between two positions relative to the centre of the body [scene unit], and its strain [–].
    pub fn new(ends: [DVec3; 2], strain: f64) -> SpringFrame {
        SpringFrame { ends, strain }
    }
}

impl PointForce {
    /// A force of a term at a point relative to the centre of the body [scene unit]: the acceleration that it gives the
    /// body [scene unit/s²], and the body that causes it, if it is one.
    pub fn new(term: usize, place: DVec3, acceleration: DVec3, source: Option<u32>) -> PointForce {
        PointForce { term, place, acceleration, source }
    }
}

impl MotionFrame {
    /// A velocity [scene unit/s] and an angular velocity [rad/s].
    pub fn new(velocity: DVec3, spin: DVec3) -> MotionFrame {
        MotionFrame { velocity, spin }
    }
}

impl NetForce {
    /// A force [mass · scene unit/s²] and a torque [mass · scene unit²/s²] on a body of this mass.
    pub fn new(force: DVec3, torque: DVec3, mass: f64) -> NetForce {
        NetForce { force, torque, mass }
    }
}

impl TermFrame {
    /// Accelerations of the vertices [scene unit/s²], by one body if `source` is given.
    pub fn new(accelerations: Vectors, source: Option<u32>) -> TermFrame {
        TermFrame { accelerations, source, mean: None }
    }
}

impl PairFrame {
    /// The pair of bodies `a` < `b` with this q [–], in a phase of the schema.
    pub fn new(a: usize, b: usize, q: f64, phase: usize) -> PairFrame {
        PairFrame { a, b, q, rate: f64::NAN, phase }
    }

    /// The same with q changing at this rate [1/s].
    pub fn with_rate(self, rate: f64) -> PairFrame {
        PairFrame { rate, ..self }
    }
}

/// The weighted sum of vectors; zero where only rounding is left.
pub(crate) fn weighted_sum(of: impl Iterator<Item = (DVec3, f64)>) -> DVec3 {
    const ROUNDING: f64 = 1e-12;

    let (mut sum, mut lengths) = (DVec3::ZERO, 0.0);
    for (vector, weight) in of {
        (sum, lengths) = (sum + vector * weight, lengths + (vector * weight).length());
    }
    if sum.length() > ROUNDING * lengths { sum } else { DVec3::ZERO }
}

impl BodyFrame {
    /// The mesh of the body as it is now.
    pub fn mesh_of<'a>(&'a self, body: &'a BodySchema) -> &'a Arc<Mesh> {
        self.mesh.as_ref().unwrap_or(&body.mesh)
    }

    /// The rest positions of the body's current vertices.
    pub fn rest_of<'a>(&'a self, body: &'a BodySchema) -> Rest<'a> {
        self.mesh_of(body).at(body.radius)
    }

    /// What a force term does to the body as a whole [scene unit/s²]: the mean of its accelerations, of a free body by
    /// mass, so that it is the net force over the mass. Zero where only rounding is left, as of internal forces.
    pub fn mean_acceleration(&self, body: &BodySchema, term: &TermFrame) -> DVec3 {
        let accelerations = &term.accelerations;
        let shares = self.mesh_of(body).shares();
        let equal = 1.0 / accelerations.len().max(1) as f64;
        let is_weighted = body.is_free && shares.len() == accelerations.len();
        let share = |i: usize| if is_weighted { shares[i] } else { equal };
        term.mean.unwrap_or_else(|| weighted_sum((0..accelerations.len()).map(|i| (accelerations.get(i), share(i)))))
    }

    /// Sets the body to rest: no vertex is displaced. Leaves the forces unchanged.
    pub fn rest(&mut self) {
        self.is_at_rest = true;
        for vectors in [&mut self.displacements, &mut self.velocities, &mut self.positions] {
            vectors.clear();
        }
        self.lengths.clear();
        self.max_displacement = 0.0;
    }

    /// Computes positions and |x| from the displacements and the rotation.
    pub fn displaced(&mut self, rest: Rest<'_>) {
        let BodyFrame { rotation, displacements, positions, lengths, .. } = self;
        self.is_at_rest = false;
        rest_positions(rest, *rotation, positions);
        positions.add_times(1.0, displacements);
        lengths.clear();
        let xy = displacements.x.iter().zip(&displacements.y);
        lengths.extend(xy.zip(&displacements.z).map(|((x, y), z)| (x * x + y * y + z * z).sqrt()));
        self.max_displacement = lengths.iter().copied().fold(0.0, f64::max);
    }

    /// The vertex with the largest displacement, the first of several.
    pub fn most_displaced(&self) -> Option<usize> {
        (0..self.lengths.len()).rev().max_by(|&i, &j| self.lengths[i].total_cmp(&self.lengths[j]))
    }

    /// Removes all forces and springs.
    pub fn clear_forces(&mut self) {
        self.has_forces = false;
        self.terms.iter_mut().for_each(|term| term.accelerations.clear());
        self.point_forces.clear();
        self.labels.clear();
        self.springs.clear();
        self.net_force = None;
    }

    /// Writes the vertex positions relative to the centre [scene unit] to `positions` (reused), whether at rest or not.
    pub fn local_positions(&self, rest: Rest<'_>, positions: &mut Vectors) {
        if self.is_absent {
            positions.reset(rest.len());
        } else if self.is_at_rest {
            rest_positions(rest, self.rotation, positions);
        } else {
            positions.copy_from(&self.positions);
        }
    }

    /// Writes the vertex positions in body axes, l + Q⁻¹ x [scene unit], to `positions` (reused). For an undeformed
    /// body, they are exactly those of its rest shape at any rotation.
    pub fn body_positions(&self, rest: Rest<'_>, positions: &mut Vectors) {
        if self.is_absent || self.rotation == DQuat::IDENTITY {
            return self.local_positions(rest, positions);
        }
        rest_positions(rest, DQuat::IDENTITY, positions);
        if !self.is_at_rest {
            let back = DMat3::from_quat(self.rotation.inverse());
            for i in 0..positions.len() {
                positions.set(i, positions.get(i) + back * self.displacements.get(i));
            }
        }
    }

    /// Displacement of vertex `i` [scene unit], whether at rest or not.
    pub fn displacement(&self, i: usize) -> DVec3 {
        if self.is_at_rest { DVec3::ZERO } else { self.displacements.get(i) }
    }

    fn memory(&self) -> usize {
        let terms: usize = self.terms.iter().map(|term| size_of::<TermFrame>() + term.accelerations.memory()).sum();
        let vectors = [&self.displacements, &self.velocities, &self.positions].map(Vectors::memory);
        size_of::<BodyFrame>()
            + vectors.iter().sum::<usize>()
            + self.lengths.capacity() * size_of::<f64>()
            + self.labels.capacity()
            + self.point_forces.capacity() * size_of::<PointForce>()
            + self.springs.capacity() * size_of::<SpringFrame>()
            + terms
    }
}

/// Writes the rotated rest positions Q l [scene unit] to `positions` (reused).
fn rest_positions(rest: Rest<'_>, rotation: DQuat, positions: &mut Vectors) {
    positions.copy_from(rest.mesh.positions());
    for axis in [&mut positions.x, &mut positions.y, &mut positions.z] {
        axis.iter_mut().for_each(|l| *l *= rest.radius);
    }
    if rotation != DQuat::IDENTITY {
        let axes = DMat3::from_quat(rotation);
        for i in 0..positions.len() {
            positions.set(i, axes * positions.get(i));
        }
    }
}

impl Frame {
    /// Allocated memory [bytes].
    pub fn memory(&self) -> usize {
        self.bodies.iter().map(BodyFrame::memory).sum::<usize>()
            + self.pairs.capacity() * size_of::<PairFrame>()
            + [&self.scalars, &self.body_scalars, &self.pair_scalars].map(Vec::capacity).iter().sum::<usize>()
                * size_of::<f64>()
    }
}
