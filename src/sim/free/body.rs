//! A free or prescribed body: vertices with masses around a rest shape that follows them.

use std::{f64::consts::SQRT_2, ops::Add, sync::Arc};

use glam::{DMat3, DQuat, DVec3};

use super::{
    kernels::{Lane, Lanes, WIDTH, by_coordinate},
    passive::Linear,
    step::Place,
};
use crate::{
    model::{
        oscillator::Oscillator,
        shape_matching::{Inner, Rotation, best_rotation, cross_matrix, moment, outer, resistance, solve},
    },
    scene::path::Kinematics,
    sim::numerics::{control::STANDING, larger},
};

/// A body counts as inside out once det G is below this share of its value at rest. It is 0 where the best-fitting
/// rotation is not unique; a body that is compressed evenly to a third of its size reaches 0.04.
const INSIDE_OUT: f64 = 0.01;

/// A rest shape, relative to its mass centre.
#[derive(Clone, Debug)]
pub struct Shape {
    /// Rest positions l, Σ m l = 0 [scene unit], `[vertex_count]`.
    pub(super) rest: Vec<DVec3>,
    /// Vertex masses m [mass], `[vertex_count]`.
    pub(super) masses: Vec<f64>,
    /// Total mass M = Σ m.
    pub(super) mass: f64,
    /// Second moment Σ m l lᵀ.
    pub(super) spread: DMat3,
    /// Largest |l| [scene unit].
    pub(super) extent: f64,
    /// Rest positions by coordinate, padded to full lanes.
    pub(super) lanes: Vec<Lanes>,
    /// Masses, padded with zeros.
    pub(super) lanes_masses: Vec<Lane>,
}

impl Shape {
    /// A shape with vertices at `rest` [scene unit] and `masses` > 0, shifted so that its mass centre is the origin.
    pub fn new(mut rest: Vec<DVec3>, masses: Vec<f64>) -> Shape {
        let mass: f64 = masses.iter().sum();
        let middle = rest.iter().zip(&masses).map(|(&l, &m)| m * l).sum::<DVec3>() / mass;
        for l in &mut rest {
            *l -= middle;
        }
        let spread = rest.iter().zip(&masses).fold(DMat3::ZERO, |sum, (&l, &m)| sum + outer(m * l, l));
        let extent = rest.iter().map(|l| l.length()).fold(0.0, f64::max);
        let mut lanes = Vec::new();
        by_coordinate(&rest, &mut lanes);
        let mut lanes_masses = vec![[0.0; WIDTH]; lanes.len()];
        for (into, from) in lanes_masses.iter_mut().zip(masses.chunks(WIDTH)) {
            into[..from.len()].copy_from_slice(from);
        }
        Shape { rest, masses, mass, spread, extent, lanes, lanes_masses }
    }

    /// A shape without vertices, for bodies that only act on others.
    pub fn none() -> Shape {
        let (lanes, lanes_masses) = (Vec::new(), Vec::new());
        Shape { rest: Vec::new(), masses: Vec::new(), mass: 0.0, spread: DMat3::ZERO, extent: 0.0, lanes, lanes_masses }
    }

    /// Total mass M.
    pub fn mass(&self) -> f64 {
        self.mass
    }

    /// Largest |l| [scene unit].
    pub fn extent(&self) -> f64 {
        self.extent
    }

    /// Rest positions l about the mass centre [scene unit].
    pub fn rest(&self) -> &[DVec3] {
        &self.rest
    }

    /// Masses of the vertices.
    pub fn masses(&self) -> &[f64] {
        &self.masses
    }
}

/// What moves a body.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Motion {
    /// Forces move it.
    Free(Rotation),
    /// A path moves it, see [`super::Paths`].
    Prescribed,
}

/// A body and its state. A vertex is at c + Q l + x and moves at c′ + Ω_Q×Q l + u.
#[derive(Clone, Debug)]
pub struct Body {
    /// Rest shape, which bodies may share.
    pub shape: Arc<Shape>,
    /// Radius R [scene unit].
    pub radius: f64,
    /// Radius r_e of its influence sphere [scene unit].
    pub sphere_radius: f64,
    /// ω and κ of its vertices.
    pub oscillator: Oscillator,
    /// What moves the body.
    pub motion: Motion,
    /// Position c of the centre [scene unit].
    pub centre: DVec3,
    /// Velocity c′ of the centre [scene unit/s].
    pub velocity: DVec3,
    /// Rotation Q of the rest shape.
    pub rotation: DQuat,
    /// Angular momentum S = Σ m s×s′ about the centre [mass · scene unit²/s]. Meaningless unless the body rotates.
    pub spin: DVec3,
    /// Displacements x, in world axes [scene unit], `[vertex_count]`.
    pub x: Vec<DVec3>,
    /// Velocities u = x′ [scene unit/s], `[vertex_count]`.
    pub u: Vec<DVec3>,
}

impl Body {
    /// Whether damping takes energy from vertices that can be told from rounding.
    pub(super) fn is_losing_energy(&self) -> bool {
        let Oscillator { omega, damping } = self.oscillator;
        let least = STANDING * (omega.max(damping) * self.radius).powi(2);
        damping > 0.0 && self.u.iter().any(|u| u.length_squared() > least)
    }

    /// A free body at rest at the origin, with an influence sphere of √2 R.
    pub fn free(shape: Arc<Shape>, radius: f64, oscillator: Oscillator, rotation: Rotation) -> Body {
        let none = vec![DVec3::ZERO; shape.rest.len()];
        Body {
            shape,
            radius,
            sphere_radius: SQRT_2 * radius,
            oscillator,
            motion: Motion::Free(rotation),
            centre: DVec3::ZERO,
            velocity: DVec3::ZERO,
            rotation: DQuat::IDENTITY,
            spin: DVec3::ZERO,
            x: none.clone(),
            u: none,
        }
    }

    /// A body on a path, undeformed.
    pub fn prescribed(shape: Arc<Shape>, radius: f64, oscillator: Oscillator) -> Body {
        Body { motion: Motion::Prescribed, ..Body::free(shape, radius, oscillator, Rotation::Fixed) }
    }

    /// Copies another body, reusing allocations.
    pub(in crate::sim) fn copy_from(&mut self, other: &Body) {
        let Body { shape, radius, sphere_radius, oscillator, motion, centre, velocity, rotation, spin, x, u } = other;
        if !Arc::ptr_eq(&self.shape, shape) {
            self.shape = Arc::clone(shape);
        }
        (self.radius, self.sphere_radius) = (*radius, *sphere_radius);
        (self.oscillator, self.motion) = (*oscillator, *motion);
        (self.centre, self.velocity, self.rotation, self.spin) = (*centre, *velocity, *rotation, *spin);
        self.x.clone_from(x);
        self.u.clone_from(u);
    }

    /// Gives every vertex a displacement and a velocity, as a step requires: the lists of an undeformed body may be
    /// empty.
    pub(in crate::sim) fn fill_states(&mut self) {
        let count = self.shape.rest.len();
        self.x.resize(count, DVec3::ZERO);
        self.u.resize(count, DVec3::ZERO);
    }

    /// Moves a free body to `from` [scene unit] and sets it in motion with `velocity` [scene unit/s] and angular
    /// velocity `spin` [rad/s].
    pub fn throw(&mut self, from: DVec3, velocity: DVec3, spin: DVec3) {
        (self.centre, self.velocity) = (from, velocity);
        if self.motion == Motion::Free(Rotation::Free) {
            let inertia = resistance(self.inner(self.rotation).ss);
            self.spin = inertia * spin;
        } else {
            let axes = DMat3::from_quat(self.rotation);
            for (u, &l) in self.u.iter_mut().zip(&self.shape.rest) {
                *u = spin.cross(axes * l);
            }
        }
    }

    /// Sets the rotation, and the state of the vertices from their positions and velocities relative to those of the centre.
    /// Returns the largest displacement and velocity.
    pub(in crate::sim) fn set_from(
        &mut self,
        rotation: DQuat,
        relative: impl Fn(usize) -> (DVec3, DVec3),
    ) -> (f64, f64) {
        let shape = Arc::clone(&self.shape);
        let axes = DMat3::from_quat(rotation);
        self.rotation = rotation;
        let mut frame_spin = DVec3::ZERO;
        if self.turns() {
            let (mut stretched, mut turning) = (DMat3::ZERO, DVec3::ZERO);
            self.spin = DVec3::ZERO;
            for (i, (&l, &m)) in shape.rest.iter().zip(&shape.masses).enumerate() {
                let (a, (s, rate)) = (axes * l, relative(i));
                stretched += outer(m * a, s);
                turning += m * a.cross(rate);
                self.spin += m * s.cross(rate);
            }
            frame_spin = solve(resistance(stretched), turning);
        }
        self.fill_states();
        let (mut largest, mut fastest) = (0.0, 0.0);
        for (i, &l) in shape.rest.iter().enumerate() {
            let (a, (s, rate)) = (axes * l, relative(i));
            self.x[i] = s - a;
            self.u[i] = rate - frame_spin.cross(a);
            largest = larger(largest, self.x[i].length_squared());
            fastest = larger(fastest, self.u[i].length_squared());
        }
        (f64::sqrt(largest), f64::sqrt(fastest))
    }

    /// Moves the centre to where a path is.
    pub(in crate::sim) fn follow(&mut self, motion: Kinematics) {
        (self.centre, self.velocity) = (motion.position, motion.velocity);
    }

    /// Its centre and velocity.
    pub(super) fn place(&self) -> Place {
        Place { centre: self.centre, velocity: self.velocity }
    }

    /// Distance of the centres of two bodies over the sum of their radii [–].
    pub fn q(&self, other: &Body) -> f64 {
        self.centre.distance(other.centre) / (self.radius + other.radius)
    }

    /// The same and its rate [1/s].
    pub fn q_and_rate(&self, other: &Body) -> (f64, f64) {
        let apart = other.centre - self.centre;
        let rate = apart.normalize_or_zero().dot(other.velocity - self.velocity);
        (self.q(other), rate / (self.radius + other.radius))
    }

    /// Displacement and velocity of a vertex; zero if the lists are empty because the body is undeformed.
    #[inline]
    pub(super) fn state(&self, vertex: usize) -> (DVec3, DVec3) {
        (self.x.get(vertex).copied().unwrap_or_default(), self.u.get(vertex).copied().unwrap_or_default())
    }

    /// Whether the rest shape can rotate.
    pub fn turns(&self) -> bool {
        self.motion == Motion::Free(Rotation::Free)
    }

    /// Whether forces move the body, not a path.
    pub fn is_free(&self) -> bool {
        matches!(self.motion, Motion::Free(_))
    }

    /// Total mass M.
    pub fn mass(&self) -> f64 {
        self.shape.mass
    }

    /// Angular velocity Ω_Q of the frame [rad/s].
    pub fn frame_spin(&self) -> DVec3 {
        if self.turns() { self.inner(self.rotation).frame_spin(self.spin) } else { DVec3::ZERO }
    }

    /// Whether the body is crushed so far that no rotation, or more than one, fits its vertices best: before it turns
    /// inside out, the angular velocity of its frame grows without bound.
    pub fn is_inside_out(&self) -> bool {
        let of = |spread: DMat3| resistance(spread).determinant();
        self.turns() && of(self.inner(self.rotation).as_) < INSIDE_OUT * of(self.shape.spread)
    }

    /// The sums over the vertices, for this rotation.
    pub(super) fn inner(&self, rotation: DQuat) -> Inner {
        Sums::of(&self.shape, &self.x, &self.u).inner(&self.shape, DMat3::from_quat(rotation))
    }

    /// Fits the frame to vertices with these sums; their positions stay. Returns the changes of their displacements and
    /// velocities, and the rotation.
    pub(super) fn refit(&self, sums: &Sums) -> ([Linear; 2], DQuat) {
        let shape = &*self.shape;
        let (x, u) = (sums.x / shape.mass, sums.u / shape.mass);
        let (mut to_x, mut to_u) = (Linear::default(), Linear::default());
        (to_x.shift, to_u.shift) = (-x, -u);
        if !self.turns() {
            return ([to_x, to_u], self.rotation);
        }
        // about the mean
        let sums = Sums { xx: sums.xx - outer(sums.x, x), xu: sums.xu - sums.x.cross(u), ..*sums };
        let axes = DMat3::from_quat(self.rotation);
        let inner = sums.inner(shape, axes);
        // Σ m s lᵀ
        let rotation = best_rotation(axes * shape.spread + sums.lx.transpose(), self.rotation);
        let turned = DMat3::from_quat(rotation);
        let spin = cross_matrix(inner.frame_spin(self.spin)) * axes;
        // the angular velocity of the new frame, from Σ m l s′ᵀ
        let moved = shape.spread * spin.transpose() + sums.lu;
        to_x.by_rest = axes - turned;
        let fitted = Sums { lx: sums.lx + shape.spread * to_x.by_rest.transpose(), ..sums };
        let turning = solve(resistance(fitted.inner(shape, turned).as_), moment(turned * moved));
        to_u.by_rest = spin - cross_matrix(turning) * turned;
        ([to_x, to_u], rotation)
    }
}

/// Sums over the vertices that do not depend on the frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sums {
    /// Σ m l xᵀ
    pub lx: DMat3,
    /// Σ m l uᵀ
    pub lu: DMat3,
    /// Σ m x xᵀ
    pub xx: DMat3,
    /// Σ m x×u
    pub xu: DVec3,
    /// Σ m x
    pub x: DVec3,
    /// Σ m u
    pub u: DVec3,
}

impl Add for Sums {
    type Output = Sums;

    fn add(self, other: Sums) -> Sums {
        Sums {
            lx: self.lx + other.lx,
            lu: self.lu + other.lu,
            xx: self.xx + other.xx,
            xu: self.xu + other.xu,
            x: self.x + other.x,
            u: self.u + other.u,
        }
    }
}

zero_by_default!(Sums { DMat3::ZERO => lx lu xx, DVec3::ZERO => xu x u });

impl Sums {
    pub fn of(shape: &Shape, x: &[DVec3], u: &[DVec3]) -> Sums {
        let mut sums = Sums::default();
        for (((&l, &m), &x), &u) in shape.rest.iter().zip(&shape.masses).zip(x).zip(u) {
            let (ml, mx) = (m * l, m * x);
            sums.lx += outer(ml, x);
            sums.lu += outer(ml, u);
            sums.xx += outer(mx, x);
            sums.xu += mx.cross(u);
            sums.x += mx;
            sums.u += m * u;
        }
        sums
    }

    /// The sums for the rotation matrix `axes`: a = Q l, s = a + x.
    pub fn inner(&self, shape: &Shape, axes: DMat3) -> Inner {
        let aa = axes * shape.spread * axes.transpose();
        let ax = axes * self.lx;
        Inner { as_: aa + ax, ax_rate: axes * self.lu, x_cross_rate: self.xu, ss: aa + ax + ax.transpose() + self.xx }
    }
}
