//! Loops over vertices of [`verlet`](super::verlet), in lanes like those of [`kernels`](super::kernels).

use glam::{DMat3, DVec3};
use pulp::{Arch, Simd};

use super::kernels::{
    Kernel, Lane, Lanes, add_outer, columns, cross, largest, load, store, times, total, total_matrix, total_vector,
    zero,
};
use crate::{
    model::{energy::influence_potential, influence::Weight, shape_matching::Plane},
    sim::numerics::lanes::{Reals, Vector},
};

/// Sets the accelerations to those of the springs: −ω² (r − c − Q l).
pub struct Spring<'a> {
    pub r: &'a [Lanes],
    pub a: &'a mut [Lanes],
    pub rest: &'a [Lanes],
    pub axes: DMat3,
    pub centre: DVec3,
    /// ω² [1/s²].
    pub stiffness: f64,
}

impl Kernel for Spring<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd, const W: usize>(self, simd: S) {
        let axes = columns::<S, W>(simd, self.axes);
        let centre = Vector::splat(simd, self.centre);
        for ((r, rest), into) in self.r.iter().zip(self.rest).zip(self.a) {
            let goal = centre + times(&axes, load(simd, rest));
            store((goal - load(simd, r)) * self.stiffness, into);
        }
    }
}

/// Adds the pressure of a plane: k d n.
pub struct Support<'a> {
    pub r: &'a [Lanes],
    pub a: &'a mut [Lanes],
    pub normal: DVec3,
    /// Depth of the reference point of `r` [scene unit].
    pub offset: f64,
    pub stiffness: f64,
}

impl Kernel for Support<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd, const W: usize>(self, simd: S) {
        let normal = Vector::<S, W>::splat(simd, self.normal);
        let (offset, none) = (Reals::splat(simd, self.offset), Reals::splat(simd, 0.0));
        for (r, a) in self.r.iter().zip(self.a) {
            let depth = offset - normal.dot(load(simd, r));
            if none.below(depth).any() {
                store(load(simd, a) + normal * (none.larger(depth) * self.stiffness), a);
            }
        }
    }
}

/// Adds the accelerations by a sphere.
pub struct Pull<'a> {
    pub r: &'a [Lanes],
    pub v: &'a [Lanes],
    pub a: &'a mut [Lanes],
    pub masses: &'a [Lane],
    /// Centre of the sphere, relative to the reference point of `r` [scene unit].
    pub centre: DVec3,
    pub radius: f64,
    pub strength: f64,
    pub weight: Weight,
}

/// What [`Pull`] finds.
pub struct PulledBy {
    /// Σ m f.
    pub force: DVec3,
    /// Σ m f·v.
    pub power: f64,
    /// Σ m (Φ − Φ(r_e)).
    pub potential: f64,
}

impl Kernel for Pull<'_> {
    type Output = PulledBy;

    #[inline(always)]
    fn run<S: Simd, const W: usize>(self, simd: S) -> PulledBy {
        let centre = Vector::<S, W>::splat(simd, self.centre);
        let (none, reach) = (Reals::splat(simd, 0.0), Reals::splat(simd, self.radius * self.radius));
        let outside = influence_potential(self.weight, self.radius, self.radius);
        let (mut force, mut power, mut potential) = (zero::<S, W>(simd), none, none);
        for (((r, v), a), m) in self.r.iter().zip(self.v).zip(self.a).zip(self.masses) {
            let to = centre - load(simd, r);
            let square = to.length_squared();
            let is_inside = square.below(reach);
            if !is_inside.any() {
                continue;
            }
            let z = square.sqrt() * (1.0 / self.radius);
            let f = to * is_inside.select(self.weight.inside(z) * self.strength, none);
            let m = is_inside.select(Reals::load(simd, m, 0), none);
            let mf = f * m;
            force = force + mf;
            power = power + mf.dot(load(simd, v));
            let phi = self.weight.potential(z) * (self.radius * self.radius) - Reals::splat(simd, outside);
            potential = potential + m * phi;
            store(load(simd, a) + f, a);
        }
        PulledBy { force: total_vector(force), power: total(power), potential: total(potential) }
    }
}

/// The largest |a − b|².
pub fn largest_change(arch: Arch, a: &[Lanes], b: &[Lanes]) -> f64 {
    struct Change<'a>(&'a [Lanes], &'a [Lanes]);
    impl Kernel for Change<'_> {
        type Output = f64;

        #[inline(always)]
        fn run<S: Simd, const W: usize>(self, simd: S) -> f64 {
            let mut max = Reals::<S, W>::splat(simd, 0.0);
            for (a, b) in self.0.iter().zip(self.1) {
                max = max.larger_or_nan((load(simd, a) - load(simd, b)).length_squared());
            }
            largest(max)
        }
    }
    Change(a, b).find(arch)
}

/// Σ m s×v about a centre, with velocities relative to its own.
pub fn angular_momentum(
    arch: Arch,
    r: &[Lanes],
    v: &[Lanes],
    masses: &[Lane],
    centre: DVec3,
    velocity: DVec3,
) -> DVec3 {
    struct Momentum<'a>(&'a [Lanes], &'a [Lanes], &'a [Lane], [DVec3; 2]);
    impl Kernel for Momentum<'_> {
        type Output = DVec3;

        #[inline(always)]
        fn run<S: Simd, const W: usize>(self, simd: S) -> DVec3 {
            let Momentum(r, v, masses, about) = self;
            let [centre, velocity] = about.map(|v| Vector::<S, W>::splat(simd, v));
            let mut sum = zero::<S, W>(simd);
            for ((r, v), m) in r.iter().zip(v).zip(masses) {
                let s = load(simd, r) - centre;
                sum = sum + cross(s, load(simd, v) - velocity) * Reals::load(simd, m, 0);
            }
            total_vector(sum)
        }
    }
    Momentum(r, v, masses, [centre, velocity]).find(arch)
}

/// Applies accelerations for `h`, then the friction of planes.
pub struct Kick<'a> {
    pub r: &'a [Lanes],
    pub v: &'a mut [Lanes],
    pub a: &'a [Lanes],
    pub masses: &'a [Lane],
    /// Acceleration that all vertices share.
    pub shared: DVec3,
    /// Velocity of the reference point of `r`.
    pub moving: DVec3,
    /// Planes with friction, and the depth of the reference point of `r`.
    pub planes: &'a [(Plane, f64)],
    pub h: f64,
}

/// What [`Kick`] finds.
pub struct Kicked {
    /// Σ m v.
    pub momentum: DVec3,
    /// Energy lost by friction.
    pub rubbed: f64,
}

impl Kernel for Kick<'_> {
    type Output = Kicked;

    #[inline(always)]
    fn run<S: Simd, const W: usize>(self, simd: S) -> Kicked {
        let Kick { r, v, a, masses, shared, moving, planes, h } = self;
        let (shared, moving) = (Vector::<S, W>::splat(simd, shared), Vector::splat(simd, moving));
        let (none, one) = (Reals::splat(simd, 0.0), Reals::splat(simd, 1.0));
        let (mut momentum, mut rubbed) = (zero::<S, W>(simd), none);
        for (((r, v), a), m) in r.iter().zip(v).zip(a).zip(masses) {
            let before = load(simd, v);
            let mut now = before + (load(simd, a) + shared) * h;
            let m = Reals::load(simd, m, 0);
            for (plane, offset) in planes {
                let normal = Vector::splat(simd, plane.normal);
                let depth = none.larger(Reals::splat(simd, *offset) - normal.dot(load(simd, r)));
                if !none.below(depth).any() {
                    continue;
                }
                let world = now + moving;
                let slide = world - normal * normal.dot(world);
                let slip = Reals::splat(simd, plane.slip * plane.slip);
                let square = slide.length_squared();
                // v⁺ = v − h μ k d v⁺/√(|v⁺|² + v_s²), with the root taken at v less the deceleration
                let slowing = depth * (h * plane.friction * plane.stiffness);
                let left = none.larger(square.sqrt() - slowing);
                let rate = slowing / (left * left + slip).sqrt();
                let lost = slide * (rate / (one + rate));
                now = now - lost;
                // at the mean of the velocities before and after the kick, like the work of other forces
                rubbed = rubbed + m * lost.dot((before + now) * 0.5 + moving);
            }
            momentum = momentum + now * m;
            store(now, v);
        }
        Kicked { momentum: total_vector(momentum), rubbed: total(rubbed) }
    }
}

/// Damps velocities relative to the rigid motion, and moves the vertices for `h`.
pub struct Drift<'a> {
    pub r: &'a mut [Lanes],
    pub v: &'a mut [Lanes],
    /// The accelerations of the kick.
    pub a: &'a [Lanes],
    pub rest: &'a [Lanes],
    pub masses: &'a [Lane],
    /// The rigid motion.
    pub centre: DVec3,
    pub velocity: DVec3,
    pub spin: DVec3,
    /// Factor on the velocities relative to it.
    pub slowed: f64,
    pub h: f64,
}

/// What [`Drift`] finds.
pub struct Drifted {
    /// Σ m r.
    pub first: DVec3,
    /// Σ m r lᵀ.
    pub fit: DMat3,
    /// Σ m r rᵀ.
    pub squares: DMat3,
    /// Σ m |v|² of the velocities relative to the rigid motion, before damping.
    pub relative: f64,
    /// Σ m v·a of these velocities.
    pub power: f64,
    /// The largest squared distance from the old centre.
    pub farthest: f64,
}

impl Kernel for Drift<'_> {
    type Output = Drifted;

    #[inline(always)]
    fn run<S: Simd, const W: usize>(self, simd: S) -> Drifted {
        let Drift { r, v, a, rest, masses, centre, velocity, spin, slowed, h } = self;
        let splat = |v| Vector::<S, W>::splat(simd, v);
        let (centre, velocity, spin) = (splat(centre), splat(velocity), splat(spin));
        let (none, none_of) = (Reals::splat(simd, 0.0), zero::<S, W>(simd));
        let (mut relative, mut power, mut farthest) = (none, none, none);
        for (((r, v), a), m) in r.iter_mut().zip(&mut *v).zip(a).zip(masses) {
            let at = load(simd, r);
            let rigid = velocity + cross(spin, at - centre);
            let own = load(simd, v) - rigid;
            relative = relative + own.length_squared() * Reals::load(simd, m, 0);
            power = power + own.dot(load(simd, a)) * Reals::load(simd, m, 0);
            let now = rigid + own * slowed;
            store(now, v);
            let at = at + now * h;
            store(at, r);
            let far = (at - centre).length_squared();
            // vertices without mass fill the lanes
            farthest = farthest.larger(none.below(Reals::load(simd, m, 0)).select(far, none));
        }
        let (mut first, mut fit, mut squares) = (none_of, [none_of; 3], [none_of; 3]);
        for ((r, rest), m) in r.iter().zip(rest).zip(masses) {
            let at = load(simd, r);
            let mr = at * Reals::load(simd, m, 0);
            first = first + mr;
            add_outer(&mut fit, mr, load(simd, rest));
            add_outer(&mut squares, mr, at);
        }
        Drifted {
            first: total_vector(first),
            fit: total_matrix(&fit),
            squares: total_matrix(&squares),
            relative: total(relative),
            power: total(power),
            farthest: largest(farthest),
        }
    }
}
