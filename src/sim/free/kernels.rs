//! Loops over vertices, in lanes: eight vertices side by side on every instruction set, and sums over all of them in the
//! same order, so that results are bit-identical everywhere.

use glam::{DMat3, DVec3};
use pulp::{Arch, Simd, WithSimd};

use super::{
    super::integrator::exponential::{
        lanes::{Mask, Reals, Vector},
        weights::Dense,
    },
    body::Sums,
    force::Sphere,
    passive::{Linear, Moments},
    step::larger,
};
use crate::{geometry::Vectors, model::influence::Weight};

/// Vertices side by side. Arrays are padded to multiples of it, by vertices without mass.
pub const WIDTH: usize = 8;

/// A loop over vertices.
trait Kernel {
    type Output;

    /// `W` registers hold [`WIDTH`] numbers.
    fn run<S: Simd, const W: usize>(self, simd: S) -> Self::Output;
}

struct InLanes<K>(K);

impl<K: Kernel> WithSimd for InLanes<K> {
    type Output = K::Output;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> K::Output {
        match S::F64_LANES {
            8 => self.0.run::<S, 1>(simd),
            4 => self.0.run::<S, 2>(simd),
            2 => self.0.run::<S, 4>(simd),
            _ => self.0.run::<S, 8>(simd),
        }
    }
}

/// The sum of all lanes.
#[inline(always)]
fn total<S: Simd, const W: usize>(v: Reals<S, W>) -> f64 {
    let mut a = [0.0; WIDTH];
    v.store(&mut a, 0);
    ((a[0] + a[1]) + (a[2] + a[3])) + ((a[4] + a[5]) + (a[6] + a[7]))
}

/// The largest of all lanes; NaN if any is.
#[inline(always)]
fn largest<S: Simd, const W: usize>(v: Reals<S, W>) -> f64 {
    let mut a = [0.0; WIDTH];
    v.store(&mut a, 0);
    a.into_iter().fold(0.0, larger)
}

#[inline(always)]
fn total_vector<S: Simd, const W: usize>(v: Vector<S, W>) -> DVec3 {
    DVec3::new(total(v.x), total(v.y), total(v.z))
}

/// A matrix, as three registers of each of its columns.
type Columns<S, const W: usize> = [Vector<S, W>; 3];

#[inline(always)]
fn zero<S: Simd, const W: usize>(simd: S) -> Vector<S, W> {
    Vector::splat(simd, DVec3::ZERO)
}

#[inline(always)]
fn columns<S: Simd, const W: usize>(simd: S, a: DMat3) -> Columns<S, W> {
    [Vector::splat(simd, a.x_axis), Vector::splat(simd, a.y_axis), Vector::splat(simd, a.z_axis)]
}

/// A v.
#[inline(always)]
fn times<S: Simd, const W: usize>(a: &Columns<S, W>, v: Vector<S, W>) -> Vector<S, W> {
    a[0] * v.x + a[1] * v.y + a[2] * v.z
}

/// Adds p qᵀ.
#[inline(always)]
fn add_outer<S: Simd, const W: usize>(sum: &mut Columns<S, W>, p: Vector<S, W>, q: Vector<S, W>) {
    sum[0] = sum[0] + p * q.x;
    sum[1] = sum[1] + p * q.y;
    sum[2] = sum[2] + p * q.z;
}

#[inline(always)]
fn total_matrix<S: Simd, const W: usize>(sum: &Columns<S, W>) -> DMat3 {
    DMat3::from_cols(total_vector(sum[0]), total_vector(sum[1]), total_vector(sum[2]))
}

#[inline(always)]
fn cross<S: Simd, const W: usize>(p: Vector<S, W>, q: Vector<S, W>) -> Vector<S, W> {
    Vector { x: p.y * q.z - p.z * q.y, y: p.z * q.x - p.x * q.z, z: p.x * q.y - p.y * q.x }
}

/// Vectors by coordinate, with zeros up to `room`.
pub fn by_coordinate(from: &[DVec3], room: usize, into: &mut Vectors) {
    into.resize(room);
    for ((v, x), (y, z)) in from.iter().zip(&mut into.x).zip(into.y.iter_mut().zip(&mut into.z)) {
        (*x, *y, *z) = (v.x, v.y, v.z);
    }
    (from.len()..room).for_each(|i| into.set(i, DVec3::ZERO));
}

/// Vectors one by one, without padding.
pub fn by_vertex(from: &Vectors, into: &mut [DVec3]) {
    for ((v, &x), (&y, &z)) in into.iter_mut().zip(&from.x).zip(from.y.iter().zip(&from.z)) {
        *v = DVec3::new(x, y, z);
    }
}

/// State of all vertices of a body at the start of a step, padded.
#[derive(Clone, Debug, Default)]
pub struct Start {
    pub x: Vectors,
    pub u: Vectors,
    /// Masses, zero of those that something can reach.
    pub masses: Vec<f64>,
    /// How much nearer than it may get each vertex is to something that acts, at the start; positive if it is out of
    /// reach in the whole step.
    pub gap: Vec<f64>,
}

/// Sets which vertices of a body may be reached in a step: those that start less than `band` outside a sphere or plane.
pub struct Reach<'a> {
    pub start: &'a mut Start,
    pub rest: &'a Vectors,
    pub axes: DMat3,
    /// Where spheres are relative to the centre, and how near to that a vertex has to be.
    pub spheres: &'a [(DVec3, f64)],
    /// Normals of planes, and how far to that side of the centre a vertex has to be.
    pub planes: &'a [(DVec3, f64)],
}

impl Kernel for Reach<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd, const W: usize>(self, simd: S) {
        let axes = columns::<S, W>(simd, self.axes);
        for first in (0..self.rest.len()).step_by(WIDTH) {
            let s = times(&axes, Vector::load(simd, self.rest, first)) + Vector::load(simd, &self.start.x, first);
            let mut gap = Reals::splat(simd, f64::INFINITY);
            for &(centre, radius) in self.spheres {
                let square = (Vector::splat(simd, centre) - s).length_squared();
                gap = gap.smaller(square - Reals::splat(simd, radius * radius));
            }
            for &(normal, side) in self.planes {
                let along = s.x * normal.x + s.y * normal.y + s.z * normal.z;
                gap = gap.smaller(along - Reals::splat(simd, side));
            }
            gap.store(&mut self.start.gap, first);
        }
    }
}

impl Reach<'_> {
    pub fn find(self, arch: Arch) {
        arch.dispatch(InLanes(self));
    }
}

/// The largest |v|².
pub fn largest_square(arch: Arch, v: &Vectors) -> f64 {
    arch.dispatch(InLanes(Largest(v)))
}

struct Largest<'a>(&'a Vectors);

impl Kernel for Largest<'_> {
    type Output = f64;

    #[inline(always)]
    fn run<S: Simd, const W: usize>(self, simd: S) -> f64 {
        let mut most = Reals::<S, W>::splat(simd, 0.0);
        for first in (0..self.0.len()).step_by(WIDTH) {
            most = most.larger_or_nan(Vector::load(simd, self.0, first).length_squared());
        }
        largest(most)
    }
}

/// Moments of vertices with the masses of [`Start`].
pub fn moments(arch: Arch, start: &Start, rest: &Vectors) -> Moments {
    arch.dispatch(InLanes(Sum { start, rest }))
}

struct Sum<'a> {
    start: &'a Start,
    rest: &'a Vectors,
}

impl Kernel for Sum<'_> {
    type Output = Moments;

    #[inline(always)]
    fn run<S: Simd, const W: usize>(self, simd: S) -> Moments {
        let Sum { start, rest } = self;
        let n = rest.len();
        let none = [zero::<S, W>(simd); 3];
        let mut moments = Moments::default();
        // in several loops, so that sums stay in registers
        let (mut xx, mut xu, mut x) = (none, none, zero::<S, W>(simd));
        for first in (0..n).step_by(WIDTH) {
            let at = Vector::<S, W>::load(simd, &start.x, first);
            let mx = at * Reals::load(simd, &start.masses, first);
            add_outer(&mut xx, mx, at);
            add_outer(&mut xu, mx, Vector::load(simd, &start.u, first));
            x = x + mx;
        }
        (moments.xx, moments.xu, moments.x) = (total_matrix(&xx), total_matrix(&xu), total_vector(x));
        let (mut xl, mut ul) = (none, none);
        for first in (0..n).step_by(WIDTH) {
            let ml = Vector::<S, W>::load(simd, rest, first) * Reals::load(simd, &start.masses, first);
            add_outer(&mut xl, Vector::load(simd, &start.x, first), ml);
            add_outer(&mut ul, Vector::load(simd, &start.u, first), ml);
        }
        (moments.xl, moments.ul) = (total_matrix(&xl), total_matrix(&ul));
        let (mut uu, mut ll, mut u, mut l) = (none, none, zero::<S, W>(simd), zero::<S, W>(simd));
        let mut mass = Reals::splat(simd, 0.0);
        for first in (0..n).step_by(WIDTH) {
            let m = Reals::load(simd, &start.masses, first);
            let (rate, at) = (Vector::<S, W>::load(simd, &start.u, first), Vector::<S, W>::load(simd, rest, first));
            let (mu, ml) = (rate * m, at * m);
            add_outer(&mut uu, mu, rate);
            add_outer(&mut ll, ml, at);
            (u, l, mass) = (u + mu, l + ml, mass + m);
        }
        (moments.uu, moments.ll) = (total_matrix(&uu), total_matrix(&ll));
        (moments.u, moments.l, moments.mass) = (total_vector(u), total_vector(l), total(mass));
        moments
    }
}

/// The state of all vertices at the end of a step, into `x` and `u`, as if nothing reached them.
pub struct Finish<'a> {
    pub start: &'a mut Start,
    pub rest: &'a Vectors,
    pub x: &'a Linear,
    pub u: &'a Linear,
}

/// A [`Linear`] vector, for use in lanes.
type Spread<S, const W: usize> = ([Columns<S, W>; 3], Vector<S, W>);

#[inline(always)]
fn spread<S: Simd, const W: usize>(simd: S, a: &Linear) -> Spread<S, W> {
    ([columns(simd, a.by_x), columns(simd, a.by_u), columns(simd, a.by_rest)], Vector::splat(simd, a.shift))
}

#[inline(always)]
fn linear<S: Simd, const W: usize>(
    (by, shift): &Spread<S, W>,
    x: Vector<S, W>,
    u: Vector<S, W>,
    rest: Vector<S, W>,
) -> Vector<S, W> {
    times(&by[0], x) + times(&by[1], u) + (times(&by[2], rest) + *shift)
}

impl Kernel for Finish<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd, const W: usize>(self, simd: S) {
        let (x, u) = (spread::<S, W>(simd, self.x), spread::<S, W>(simd, self.u));
        for first in (0..self.rest.len()).step_by(WIDTH) {
            let (x0, u0) = (Vector::load(simd, &self.start.x, first), Vector::load(simd, &self.start.u, first));
            let rest = Vector::load(simd, self.rest, first);
            linear(&x, x0, u0, rest).store(&mut self.start.x, first);
            linear(&u, x0, u0, rest).store(&mut self.start.u, first);
        }
    }
}

impl Finish<'_> {
    pub fn find(self, arch: Arch) {
        arch.dispatch(InLanes(self));
    }
}

/// The vertices of a body that something may reach in a step, padded.
#[derive(Clone, Debug, Default)]
pub struct Active {
    /// Their indices, ascending.
    pub vertices: Vec<u32>,
    pub masses: Vec<f64>,
    pub rest: Vectors,
    /// Displacements x at the samples [scene unit].
    pub x: [Vectors; 5],
    /// Velocities u at the samples [scene unit/s].
    pub u: [Vectors; 5],
    /// Positions relative to the centre at the samples, s = Q l + x [scene unit].
    pub s: [Vectors; 5],
    /// Accelerations at the samples without those that begin or end in the step, and without those that all vertices
    /// share [scene unit/s²].
    pub f: [Vectors; 5],
}

impl Active {
    /// Number of vertices.
    pub fn len(&self) -> usize {
        self.vertices.len()
    }

    /// Makes room for the vertices; what is in it has no meaning but for masses of zero.
    pub fn resize(&mut self) {
        let room = self.vertices.len().next_multiple_of(WIDTH);
        if room != self.rest.len() {
            let all = [&mut self.x, &mut self.u, &mut self.s, &mut self.f].into_iter().flatten();
            all.chain([&mut self.rest]).for_each(|vectors| vectors.resize(room));
        }
        self.masses.clear();
        self.masses.resize(room, 0.0);
    }
}

/// Σ wᵢ vᵢ.
#[inline(always)]
fn combine<S: Simd, const W: usize>(w: &[f64; 4], v: &[Vector<S, W>; 4]) -> Vector<S, W> {
    (v[0] * w[0] + v[1] * w[1]) + (v[2] * w[2] + v[3] * w[3])
}

/// The lanes that are vertices, not padding.
#[inline(always)]
fn real<S: Simd, const W: usize>(simd: S, active: &Active, first: usize) -> Mask<S, W> {
    Reals::splat(simd, 0.0).below(Reals::load(simd, &active.masses, first))
}

/// What moves active vertices to a sample.
pub struct Move<'a> {
    pub active: &'a mut Active,
    pub look: usize,
    pub weights: &'a Dense,
    /// Shared displacement and velocity.
    pub common: [DVec3; 2],
    /// The same by rest position.
    pub by_rest: [DMat3; 2],
}

impl Kernel for Move<'_> {
    /// The largest square of a change in x and in u.
    type Output = [f64; 2];

    #[inline(always)]
    fn run<S: Simd, const W: usize>(self, simd: S) -> [f64; 2] {
        let Move { active, look, weights: w, common, by_rest } = self;
        let common = [Vector::<S, W>::splat(simd, common[0]), Vector::splat(simd, common[1])];
        let by_rest = [columns::<S, W>(simd, by_rest[0]), columns(simd, by_rest[1])];
        let none = Reals::splat(simd, 0.0);
        let [mut far, mut fast] = [none; 2];
        for first in (0..active.rest.len()).step_by(WIDTH) {
            let (x0, u0) = (Vector::load(simd, &active.x[0], first), Vector::load(simd, &active.u[0], first));
            let rest = Vector::load(simd, &active.rest, first);
            let f: [Vector<S, W>; 4] = [
                Vector::load(simd, &active.f[0], first),
                Vector::load(simd, &active.f[1], first),
                Vector::load(simd, &active.f[2], first),
                Vector::load(simd, &active.f[3], first),
            ];
            let x = x0 * w.xx + u0 * w.xu + (combine(&w.x, &f) + (common[0] + times(&by_rest[0], rest)));
            let u = x0 * w.ux + u0 * w.uu + (combine(&w.u, &f) + (common[1] + times(&by_rest[1], rest)));
            let (x_before, u_before) =
                (Vector::load(simd, &active.x[look], first), Vector::load(simd, &active.u[look], first));
            let real = real(simd, active, first);
            far = far.larger_or_nan(real.select((x - x_before).length_squared(), none));
            fast = fast.larger_or_nan(real.select((u - u_before).length_squared(), none));
            x.store(&mut active.x[look], first);
            u.store(&mut active.u[look], first);
        }
        [largest(far), largest(fast)]
    }
}

impl Move<'_> {
    /// The largest square of a change in x and in u.
    pub fn find(self, arch: Arch) -> [f64; 2] {
        arch.dispatch(InLanes(self))
    }
}

/// The sums over active vertices at a sample, and their largest |x|² and |u|².
pub fn sums(arch: Arch, active: &Active, look: usize) -> (Sums, [f64; 2]) {
    arch.dispatch(InLanes(SumUp { active, look }))
}

struct SumUp<'a> {
    active: &'a Active,
    look: usize,
}

impl Kernel for SumUp<'_> {
    type Output = (Sums, [f64; 2]);

    #[inline(always)]
    fn run<S: Simd, const W: usize>(self, simd: S) -> (Sums, [f64; 2]) {
        let SumUp { active, look } = self;
        let none = zero::<S, W>(simd);
        let (mut lx, mut lu, mut xx) = ([none; 3], [none; 3], [none; 3]);
        let (mut xu, mut mean_x, mut mean_u) = (none, none, none);
        let [mut most_x, mut most_u] = [Reals::splat(simd, 0.0); 2];
        for first in (0..active.rest.len()).step_by(WIDTH) {
            let m = Reals::load(simd, &active.masses, first);
            let ml = Vector::load(simd, &active.rest, first) * m;
            let (x, u) = (Vector::load(simd, &active.x[look], first), Vector::load(simd, &active.u[look], first));
            let (mx, mu) = (x * m, u * m);
            add_outer(&mut lx, ml, x);
            add_outer(&mut lu, ml, u);
            add_outer(&mut xx, mx, x);
            xu = xu + cross(mx, u);
            (mean_x, mean_u) = (mean_x + mx, mean_u + mu);
            most_x = most_x.larger_or_nan(x.length_squared());
            most_u = most_u.larger_or_nan(u.length_squared());
        }
        let sums = Sums {
            lx: total_matrix(&lx),
            lu: total_matrix(&lu),
            xx: total_matrix(&xx),
            xu: total_vector(xu),
            x: total_vector(mean_x),
            u: total_vector(mean_u),
        };
        (sums, [largest(most_x), largest(most_u)])
    }
}

/// Places active vertices relative to the centre, for these axes.
pub fn place(arch: Arch, active: &mut Active, look: usize, axes: DMat3) {
    arch.dispatch(InLanes(PlaceAll { active, look, axes }));
}

struct PlaceAll<'a> {
    active: &'a mut Active,
    look: usize,
    axes: DMat3,
}

impl Kernel for PlaceAll<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd, const W: usize>(self, simd: S) {
        let PlaceAll { active, look, axes } = self;
        let axes = columns::<S, W>(simd, axes);
        for first in (0..active.rest.len()).step_by(WIDTH) {
            let s = times(&axes, Vector::load(simd, &active.rest, first)) + Vector::load(simd, &active.x[look], first);
            s.store(&mut active.s[look], first);
        }
    }
}

/// The force of a sphere on the active vertices that are inside it at all nodes.
pub struct Pull<'a> {
    pub active: &'a mut Active,
    pub sphere: &'a Sphere,
    pub weight: Weight,
    /// Where the sphere is relative to the centre, at the nodes.
    pub apart: [DVec3; 4],
    /// The sphere's velocity relative to the centre, at the nodes.
    pub passing: [DVec3; 4],
    /// The angular velocity of the frame at the nodes [rad/s].
    pub turning: [DVec3; 4],
    /// Length of the step [s].
    pub h: f64,
    /// Vertices farther from the rim than this at all nodes do not cross it within the step [scene unit].
    pub band: f64,
    /// Such vertices are listed here, and left out.
    pub crossing: &'a mut Vec<u32>,
    /// Velocity of the vertices' body, if their power is wanted.
    pub power: Option<[DVec3; 4]>,
    /// The first node at which accelerations are wanted.
    pub first: usize,
}

/// Σ m f on a sphere's vertices, and their power.
#[derive(Clone, Copy, Debug, Default)]
pub struct Pulled {
    pub force: [DVec3; 4],
    pub power: [f64; 4],
}

impl Kernel for Pull<'_> {
    type Output = Pulled;

    #[inline(always)]
    fn run<S: Simd, const W: usize>(self, simd: S) -> Pulled {
        let Pull {
            active,
            sphere,
            weight,
            apart,
            passing,
            turning,
            h,
            band,
            crossing,
            power: moving,
            first: first_node,
        } = self;
        let rim = Reals::splat(simd, sphere.radius * sphere.radius);
        let (inner, outer) = ((sphere.radius - band).max(0.0), sphere.radius + band);
        let (inner, outer) = (Reals::splat(simd, inner * inner), Reals::splat(simd, outer * outer));
        let (none, no_force) = (Reals::<S, W>::splat(simd, 0.0), zero::<S, W>(simd));
        let apart = [
            Vector::<S, W>::splat(simd, apart[0]),
            Vector::splat(simd, apart[1]),
            Vector::splat(simd, apart[2]),
            Vector::splat(simd, apart[3]),
        ];
        let mut force = [no_force; 4];
        let mut power = [none; 4];
        let one = Reals::splat(simd, 1.0);
        for first in (0..active.rest.len()).step_by(WIDTH) {
            let mut d = [no_force; 4];
            let mut square = [none; 4];
            for node in 0..4 {
                d[node] = apart[node] - Vector::load(simd, &active.s[node], first);
                square[node] = d[node].length_squared();
            }
            let least = square[0].smaller(square[1]).smaller(square[2].smaller(square[3]));
            let most = square[0].larger_or_nan(square[1]).larger_or_nan(square[2].larger_or_nan(square[3]));
            let out = outer.below(least);
            let mut inside = most.below(inner);
            let mut crosses = out.or(inside).negated();
            if crosses.any() {
                // nor do those cross it that are farther from it at all nodes than they get in the step at any one's rate
                let (mut fastest, mut nearest) = (none, Reals::splat(simd, f64::INFINITY));
                for node in 0..4 {
                    let s = Vector::load(simd, &active.s[node], first);
                    let a = s - Vector::load(simd, &active.x[node], first);
                    let rate =
                        cross(Vector::splat(simd, turning[node]), a) + Vector::load(simd, &active.u[node], first);
                    let v = Vector::splat(simd, passing[node]) - rate;
                    let along = d[node].x * v.x + d[node].y * v.y + d[node].z * v.z;
                    fastest = fastest.larger_or_nan((along * (2.0 * h)).abs());
                    nearest = nearest.smaller((rim - square[node]).abs());
                }
                let passes = fastest.below(nearest).negated();
                let mixed = most.below(rim).or(rim.below(least)).negated();
                crosses = crosses.and(passes.or(mixed));
                inside = inside.or(crosses.negated().and(most.below(rim)));
            }
            if crosses.any() {
                let mut flags = [0.0; WIDTH];
                crosses.select(one, none).store(&mut flags, 0);
                let count = active.vertices.len();
                let flagged = (first..count.min(first + WIDTH)).filter(|&i| flags[i - first] != 0.0);
                crossing.extend(flagged.map(|i| i as u32));
            }
            if !inside.any() {
                continue;
            }
            let m = Reals::load(simd, &active.masses, first);
            for node in 0..4 {
                let z = square[node].sqrt() * (1.0 / sphere.radius);
                let y = one - z;
                let w = match weight {
                    Weight::Linear => y,
                    Weight::Wendland => (y * y) * (y * y) * (z * 4.0 + one),
                };
                let g = inside.select_vector(d[node] * (w * sphere.strength[node]), no_force);
                if node >= first_node {
                    let f = &mut active.f[node];
                    (Vector::load(simd, f, first) + g).store(f, first);
                }
                let pull = g * m;
                force[node] = force[node] + pull;
                if let Some(velocity) = moving {
                    let v = Vector::load(simd, &active.u[node], first) + Vector::splat(simd, velocity[node]);
                    power[node] = power[node] + (pull.x * v.x + pull.y * v.y + pull.z * v.z);
                }
            }
        }
        let mut pulled = Pulled::default();
        for node in 0..4 {
            (pulled.force[node], pulled.power[node]) = (total_vector(force[node]), total(power[node]));
        }
        pulled
    }
}

impl Pull<'_> {
    pub fn find(self, arch: Arch) -> Pulled {
        arch.dispatch(InLanes(self))
    }
}

/// The force of a sphere at a single sample, on the active vertices that are inside it there: Σ m f.
pub fn pull_at(arch: Arch, active: &mut Active, sphere: &Sphere, weight: Weight, look: usize, apart: DVec3) -> DVec3 {
    arch.dispatch(InLanes(PullAt { active, sphere, weight, look, apart }))
}

struct PullAt<'a> {
    active: &'a mut Active,
    sphere: &'a Sphere,
    weight: Weight,
    look: usize,
    apart: DVec3,
}

impl Kernel for PullAt<'_> {
    type Output = DVec3;

    #[inline(always)]
    fn run<S: Simd, const W: usize>(self, simd: S) -> DVec3 {
        let PullAt { active, sphere, weight, look, apart } = self;
        let rim = Reals::splat(simd, sphere.radius * sphere.radius);
        let apart = Vector::<S, W>::splat(simd, apart);
        let (one, no_force) = (Reals::splat(simd, 1.0), zero::<S, W>(simd));
        let mut force = no_force;
        for first in (0..active.rest.len()).step_by(WIDTH) {
            let d = apart - Vector::load(simd, &active.s[look], first);
            let square = d.length_squared();
            let inside = square.below(rim);
            if !inside.any() {
                continue;
            }
            let z = square.sqrt() * (1.0 / sphere.radius);
            let y = one - z;
            let w = match weight {
                Weight::Linear => y,
                Weight::Wendland => (y * y) * (y * y) * (z * 4.0 + one),
            };
            let g = inside.select_vector(d * (w * sphere.strength[look]), no_force);
            let f = &mut active.f[look];
            (Vector::load(simd, f, first) + g).store(f, first);
            force = force + g * Reals::load(simd, &active.masses, first);
        }
        total_vector(force)
    }
}

/// Σ m f, Σ m a×f and Σ m s×f of the accelerations of active vertices at a sample; then adds `turning`×x to them.
pub fn gather(arch: Arch, active: &mut Active, look: usize, turning: DVec3) -> [DVec3; 3] {
    arch.dispatch(InLanes(Gather { active, look, turning }))
}

struct Gather<'a> {
    active: &'a mut Active,
    look: usize,
    turning: DVec3,
}

impl Kernel for Gather<'_> {
    type Output = [DVec3; 3];

    #[inline(always)]
    fn run<S: Simd, const W: usize>(self, simd: S) -> [DVec3; 3] {
        let Gather { active, look, turning } = self;
        let turning = Vector::<S, W>::splat(simd, turning);
        let mut sums = [zero::<S, W>(simd); 3];
        for first in (0..active.rest.len()).step_by(WIDTH) {
            let f = Vector::load(simd, &active.f[look], first);
            let (s, x) = (Vector::load(simd, &active.s[look], first), Vector::load(simd, &active.x[look], first));
            let force = f * Reals::load(simd, &active.masses, first);
            sums[0] = sums[0] + force;
            sums[1] = sums[1] + cross(s - x, force);
            sums[2] = sums[2] + cross(s, force);
            (f + cross(turning, x)).store(&mut active.f[look], first);
        }
        [total_vector(sums[0]), total_vector(sums[1]), total_vector(sums[2])]
    }
}

/// The largest square of the residual f₄ − Σ wᵢ fᵢ + common + by_rest l in the middle of the step.
pub fn bend(arch: Arch, active: &Active, weights: [f64; 4], common: DVec3, by_rest: DMat3) -> f64 {
    arch.dispatch(InLanes(Bend { active, weights, common, by_rest }))
}

struct Bend<'a> {
    active: &'a Active,
    weights: [f64; 4],
    common: DVec3,
    by_rest: DMat3,
}

impl Kernel for Bend<'_> {
    type Output = f64;

    #[inline(always)]
    fn run<S: Simd, const W: usize>(self, simd: S) -> f64 {
        let Bend { active, weights: w, common, by_rest } = self;
        let (common, by_rest) = (Vector::<S, W>::splat(simd, common), columns::<S, W>(simd, by_rest));
        let none = Reals::splat(simd, 0.0);
        let mut most = none;
        for first in (0..active.rest.len()).step_by(WIDTH) {
            let f: [Vector<S, W>; 4] = [
                Vector::load(simd, &active.f[0], first),
                Vector::load(simd, &active.f[1], first),
                Vector::load(simd, &active.f[2], first),
                Vector::load(simd, &active.f[3], first),
            ];
            let middle = Vector::load(simd, &active.f[4], first);
            let shared = common + times(&by_rest, Vector::load(simd, &active.rest, first));
            let square = (middle - combine(&w, &f) + shared).length_squared();
            most = most.larger_or_nan(real(simd, active, first).select(square, none));
        }
        largest(most)
    }
}

/// Σ m |u − spin×x + slip l|² of active vertices at a node.
pub fn slipping(arch: Arch, active: &Active, node: usize, spin: DVec3, slip: DMat3) -> f64 {
    arch.dispatch(InLanes(Slipping { active, node, spin, slip }))
}

struct Slipping<'a> {
    active: &'a Active,
    node: usize,
    spin: DVec3,
    slip: DMat3,
}

impl Kernel for Slipping<'_> {
    type Output = f64;

    #[inline(always)]
    fn run<S: Simd, const W: usize>(self, simd: S) -> f64 {
        let Slipping { active, node, spin, slip } = self;
        let (spin, slip) = (Vector::<S, W>::splat(simd, spin), columns::<S, W>(simd, slip));
        let mut sum = Reals::splat(simd, 0.0);
        for first in (0..active.rest.len()).step_by(WIDTH) {
            let (x, u) = (Vector::load(simd, &active.x[node], first), Vector::load(simd, &active.u[node], first));
            let rate = u - cross(spin, x) + times(&slip, Vector::load(simd, &active.rest, first));
            sum = sum + rate.length_squared() * Reals::load(simd, &active.masses, first);
        }
        total(sum)
    }
}
