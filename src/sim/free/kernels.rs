//! Loops over vertices, in lanes: eight vertices side by side on every instruction set, with sums in the same order, so
//! that results are bit-identical everywhere.

use glam::{DMat3, DVec3};
use pulp::{Arch, Simd, WithSimd};

use super::{
    force::Sphere,
    passive::{Linear, Moments},
};
use crate::{
    model::{energy::influence_potential, influence::Weight},
    sim::numerics::{
        bernstein::Basis,
        dense::Dense,
        lanes::{Reals, Vector},
        larger,
    },
};

/// Number of vertices side by side. Arrays are padded to multiples of it, with vertices without mass.
pub const WIDTH: usize = 8;

/// One number for each of [`WIDTH`] vertices.
pub type Lane = [f64; WIDTH];

/// One vector for each of [`WIDTH`] vertices, by coordinate. Loops over arrays of these need no bounds checks.
pub type Lanes = [Lane; 3];

#[inline(always)]
pub(super) fn load<S: Simd, const W: usize>(simd: S, lanes: &Lanes) -> Vector<S, W> {
    Vector::of_block(simd, lanes, 0)
}

/// The lanes from `at` on that fill one register. Kernels that need many registers process the [`WIDTH`] lanes one
/// register at a time.
#[inline(always)]
fn part<S: Simd>(simd: S, lanes: &Lanes, at: usize) -> Vector<S, 1> {
    Vector::of_block(simd, lanes, at)
}

#[inline(always)]
pub(super) fn store<S: Simd, const W: usize>(v: Vector<S, W>, lanes: &mut Lanes) {
    v.into_block(lanes, 0);
}

#[inline(always)]
fn get([x, y, z]: &Lanes, lane: usize) -> DVec3 {
    DVec3::new(x[lane], y[lane], z[lane])
}

#[inline(always)]
fn set([x, y, z]: &mut Lanes, lane: usize, v: DVec3) {
    (x[lane], y[lane], z[lane]) = (v.x, v.y, v.z);
}

/// Vector `i` of an array; panics if out of range.
#[inline]
pub fn at(of: &[Lanes], i: usize) -> DVec3 {
    get(&of[i / WIDTH], i % WIDTH)
}

/// Replaces vector `i` of an array; panics if out of range.
#[inline]
pub fn replace(of: &mut [Lanes], i: usize, v: DVec3) {
    set(&mut of[i / WIDTH], i % WIDTH, v);
}

/// A loop over vertices.
pub(super) trait Kernel {
    type Output;

    /// `W` registers hold [`WIDTH`] numbers.
    fn run<S: Simd, const W: usize>(self, simd: S) -> Self::Output;

    /// Runs it.
    fn find(self, arch: Arch) -> Self::Output
    where
        Self: Sized,
    {
        arch.dispatch(InLanes(self))
    }
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
pub(super) fn total<S: Simd, const W: usize>(v: Reals<S, W>) -> f64 {
    let mut a = [0.0; WIDTH];
    v.store(&mut a, 0);
    sum_of(a)
}

/// Like [`total`], of lanes in several registers.
#[inline(always)]
fn total_parts<S: Simd, const W: usize>(v: [Reals<S, 1>; W]) -> f64 {
    sum_of(joined(v))
}

#[inline(always)]
fn total_vector_parts<S: Simd, const W: usize>(v: [Vector<S, 1>; W]) -> DVec3 {
    DVec3::new(total_parts(v.map(|v| v.x)), total_parts(v.map(|v| v.y)), total_parts(v.map(|v| v.z)))
}

#[inline(always)]
fn largest_parts<S: Simd, const W: usize>(v: [Reals<S, 1>; W]) -> f64 {
    joined(v).into_iter().fold(0.0, larger)
}

#[inline(always)]
fn joined<S: Simd, const W: usize>(v: [Reals<S, 1>; W]) -> Lane {
    let mut a = [0.0; WIDTH];
    for (register, v) in v.into_iter().enumerate() {
        v.store(&mut a, register * S::F64_LANES);
    }
    a
}

#[inline(always)]
fn sum_of(a: Lane) -> f64 {
    ((a[0] + a[1]) + (a[2] + a[3])) + ((a[4] + a[5]) + (a[6] + a[7]))
}

/// The largest of all lanes; NaN if any is.
#[inline(always)]
pub(super) fn largest<S: Simd, const W: usize>(v: Reals<S, W>) -> f64 {
    let mut a = [0.0; WIDTH];
    v.store(&mut a, 0);
    a.into_iter().fold(0.0, larger)
}

#[inline(always)]
pub(super) fn total_vector<S: Simd, const W: usize>(v: Vector<S, W>) -> DVec3 {
    DVec3::new(total(v.x), total(v.y), total(v.z))
}

/// A matrix per lane, by columns.
pub(super) type Columns<S, const W: usize> = [Vector<S, W>; 3];

#[inline(always)]
pub(super) fn zero<S: Simd, const W: usize>(simd: S) -> Vector<S, W> {
    Vector::splat(simd, DVec3::ZERO)
}

#[inline(always)]
pub(super) fn columns<S: Simd, const W: usize>(simd: S, a: DMat3) -> Columns<S, W> {
    [Vector::splat(simd, a.x_axis), Vector::splat(simd, a.y_axis), Vector::splat(simd, a.z_axis)]
}

/// A v.
#[inline(always)]
pub(super) fn times<S: Simd, const W: usize>(a: &Columns<S, W>, v: Vector<S, W>) -> Vector<S, W> {
    a[0] * v.x + a[1] * v.y + a[2] * v.z
}

/// Adds p qᵀ.
#[inline(always)]
pub(super) fn add_outer<S: Simd, const W: usize>(sum: &mut Columns<S, W>, p: Vector<S, W>, q: Vector<S, W>) {
    sum[0] = sum[0] + p * q.x;
    sum[1] = sum[1] + p * q.y;
    sum[2] = sum[2] + p * q.z;
}

#[inline(always)]
pub(super) fn total_matrix<S: Simd, const W: usize>(sum: &Columns<S, W>) -> DMat3 {
    DMat3::from_cols(total_vector(sum[0]), total_vector(sum[1]), total_vector(sum[2]))
}

#[inline(always)]
pub(super) fn cross<S: Simd, const W: usize>(p: Vector<S, W>, q: Vector<S, W>) -> Vector<S, W> {
    Vector { x: p.y * q.z - p.z * q.y, y: p.z * q.x - p.x * q.z, z: p.x * q.y - p.y * q.x }
}

/// Converts vectors to lanes, padded with zeros.
pub fn by_coordinate(from: &[DVec3], into: &mut Vec<Lanes>) {
    into.resize(from.len().div_ceil(WIDTH), [[0.0; WIDTH]; 3]);
    for (from, into) in from.chunks(WIDTH).zip(into) {
        if from.len() < WIDTH {
            *into = [[0.0; WIDTH]; 3];
        }
        for (lane, &v) in from.iter().enumerate() {
            set(into, lane, v);
        }
    }
}

/// Converts lanes to vectors, without padding.
pub fn by_vertex(from: &[Lanes], into: &mut [DVec3]) {
    for (from, into) in from.iter().zip(into.chunks_mut(WIDTH)) {
        for (lane, v) in into.iter_mut().enumerate() {
            *v = get(from, lane);
        }
    }
}

/// State of all vertices of a body at the start of a step, padded.
#[derive(Clone, Debug, Default)]
pub struct Start {
    pub x: Vec<Lanes>,
    pub u: Vec<Lanes>,
    /// Masses; zero for active vertices.
    pub masses: Vec<Lane>,
    /// Positive if a vertex starts outside the bands of all spheres and planes, so that nothing reaches it in the step.
    /// Only the sign matters: differences of squared distances for spheres, distances for planes.
    pub gap: Vec<Lane>,
}

/// Computes [`Start::gap`].
pub struct Reach<'a> {
    pub start: &'a mut Start,
    pub rest: &'a [Lanes],
    pub axes: DMat3,
    /// Centres of spheres relative to the body's centre, and their radii including the band.
    pub spheres: &'a [(DVec3, f64)],
    /// Normals n of planes, and the value of n·s up to which a vertex may be reached.
    pub planes: &'a [(DVec3, f64)],
}

impl Kernel for Reach<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd, const W: usize>(self, simd: S) {
        let axes = columns::<S, W>(simd, self.axes);
        let Start { x, gap: gaps, .. } = self.start;
        for ((rest, x), into) in self.rest.iter().zip(x).zip(gaps) {
            let s = times(&axes, load(simd, rest)) + load(simd, x);
            let mut gap = Reals::splat(simd, f64::INFINITY);
            for &(centre, radius) in self.spheres {
                let square = (Vector::splat(simd, centre) - s).length_squared();
                gap = gap.smaller(square - Reals::splat(simd, radius * radius));
            }
            for &(normal, side) in self.planes {
                let along = s.x * normal.x + s.y * normal.y + s.z * normal.z;
                gap = gap.smaller(along - Reals::splat(simd, side));
            }
            gap.store(into, 0);
        }
    }
}

/// The largest |v|².
pub fn largest_square(arch: Arch, v: &[Lanes]) -> f64 {
    Largest(v).find(arch)
}

struct Largest<'a>(&'a [Lanes]);

impl Kernel for Largest<'_> {
    type Output = f64;

    #[inline(always)]
    fn run<S: Simd, const W: usize>(self, simd: S) -> f64 {
        let mut max = Reals::<S, W>::splat(simd, 0.0);
        for v in self.0 {
            max = max.larger_or_nan(load(simd, v).length_squared());
        }
        largest(max)
    }
}

/// Moments of all vertices, with the masses of [`Start`]: of the inactive ones.
pub struct Sum<'a> {
    pub start: &'a Start,
    pub rest: &'a [Lanes],
}

impl Kernel for Sum<'_> {
    type Output = Moments;

    #[inline(always)]
    fn run<S: Simd, const W: usize>(self, simd: S) -> Moments {
        let Start { x, u, masses, .. } = self.start;
        sum::<S, W, _>(simd, || masses.iter().zip(self.rest).zip(x.iter().zip(u)).map(|((m, l), (x, u))| (m, l, x, u)))
    }
}

/// Moments of active vertices at the start.
pub struct SumActive<'a>(pub &'a Active);

impl Kernel for SumActive<'_> {
    type Output = Moments;

    #[inline(always)]
    fn run<S: Simd, const W: usize>(self, simd: S) -> Moments {
        sum::<S, W, _>(simd, || self.0.blocks.iter().map(|b| (&b.masses, &b.rest, &b.x[0], &b.u[0])))
    }
}

/// Moments of vertices with these masses, rest positions, displacements and velocities.
#[inline(always)]
fn sum<'a, S: Simd, const W: usize, I>(simd: S, vertices: impl Fn() -> I) -> Moments
where
    I: Iterator<Item = (&'a Lane, &'a Lanes, &'a Lanes, &'a Lanes)>,
{
    let none = [zero::<S, W>(simd); 3];
    let mut moments = Moments::default();
    // several loops, so that the sums stay in registers
    let (mut xx, mut xu, mut x) = (none, none, zero::<S, W>(simd));
    for (m, _, x0, u0) in vertices() {
        let at = load::<S, W>(simd, x0);
        let mx = at * Reals::load(simd, m, 0);
        add_outer(&mut xx, mx, at);
        add_outer(&mut xu, mx, load(simd, u0));
        x = x + mx;
    }
    (moments.xx, moments.xu, moments.x) = (total_matrix(&xx), total_matrix(&xu), total_vector(x));
    let (mut xl, mut ul) = (none, none);
    for (m, rest, x0, u0) in vertices() {
        let ml = load::<S, W>(simd, rest) * Reals::load(simd, m, 0);
        add_outer(&mut xl, load(simd, x0), ml);
        add_outer(&mut ul, load(simd, u0), ml);
    }
    (moments.xl, moments.ul) = (total_matrix(&xl), total_matrix(&ul));
    let (mut uu, mut ll, mut u, mut l) = (none, none, zero::<S, W>(simd), zero::<S, W>(simd));
    let mut mass = Reals::splat(simd, 0.0);
    for (m, rest, _, u0) in vertices() {
        let m = Reals::load(simd, m, 0);
        let (rate, at) = (load::<S, W>(simd, u0), load::<S, W>(simd, rest));
        let (mu, ml) = (rate * m, at * m);
        add_outer(&mut uu, mu, rate);
        add_outer(&mut ll, ml, at);
        (u, l, mass) = (u + mu, l + ml, mass + m);
    }
    (moments.uu, moments.ll) = (total_matrix(&uu), total_matrix(&ll));
    (moments.u, moments.l, moments.mass) = (total_vector(u), total_vector(l), total(mass));
    moments
}

/// Replaces the states of all vertices in [`Start`] by those at the end of the step, as if nothing reached them.
pub struct Finish<'a> {
    pub start: &'a mut Start,
    pub rest: &'a [Lanes],
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
        let Start { x: displacements, u: rates, .. } = self.start;
        for ((into_x, into_u), rest) in displacements.iter_mut().zip(rates).zip(self.rest) {
            let (x0, u0, rest) = (load(simd, into_x), load(simd, into_u), load(simd, rest));
            store(linear(&x, x0, u0, rest), into_x);
            store(linear(&u, x0, u0, rest), into_u);
        }
    }
}

/// Active vertices side by side.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(64))] // whole cache lines
pub struct Block {
    pub masses: Lane,
    pub rest: Lanes,
    /// Displacements x at the samples [scene unit].
    pub x: [Lanes; 5],
    /// Velocities u at the samples [scene unit/s].
    pub u: [Lanes; 5],
    /// Positions relative to the centre at the samples, s = Q l + x [scene unit].
    pub s: [Lanes; 5],
    /// Accelerations at the samples, without pieces that begin or end in the step and without accelerations that all
    /// vertices share [scene unit/s²].
    pub f: [Lanes; 5],
    /// Estimated errors of x and u at the end of the step [scene unit], [scene unit/s].
    pub errors: [Lanes; 2],
    /// Not zero for vertices that are advanced alone, see `split`.
    pub split: Lane,
    /// Without this padding a block has 4 KiB, and equal fields of all blocks compete for a few lines of the cache.
    _apart: Lane,
}

/// The vertices of a body that something may reach in a step, padded.
#[derive(Clone, Debug, Default)]
pub struct Active {
    /// Their indices, ascending.
    pub vertices: Vec<u32>,
    /// Unused lanes of the last block repeat the last vertex, without its mass.
    pub blocks: Vec<Block>,
}

impl Active {
    /// Number of vertices.
    pub fn len(&self) -> usize {
        self.vertices.len()
    }

    /// Makes room for the vertices; the contents are unspecified.
    pub fn resize(&mut self) {
        self.blocks.resize(self.vertices.len().div_ceil(WIDTH), Block::default());
    }

    /// Mass of vertex `i`.
    #[inline(always)]
    pub fn mass(&self, i: usize) -> f64 {
        self.blocks[i / WIDTH].masses[i % WIDTH]
    }

    /// Rest position of vertex `i` [scene unit].
    #[inline(always)]
    pub fn rest(&self, i: usize) -> DVec3 {
        get(&self.blocks[i / WIDTH].rest, i % WIDTH)
    }

    /// Displacement of vertex `i` at a sample [scene unit].
    #[inline(always)]
    pub fn x(&self, sample: usize, i: usize) -> DVec3 {
        get(&self.blocks[i / WIDTH].x[sample], i % WIDTH)
    }

    /// Velocity of vertex `i` at a sample [scene unit/s].
    #[inline(always)]
    pub fn u(&self, sample: usize, i: usize) -> DVec3 {
        get(&self.blocks[i / WIDTH].u[sample], i % WIDTH)
    }

    /// Position of vertex `i` relative to the centre at a sample [scene unit].
    #[inline(always)]
    pub fn s(&self, sample: usize, i: usize) -> DVec3 {
        get(&self.blocks[i / WIDTH].s[sample], i % WIDTH)
    }

    /// Sets the mass, the rest position and the state at the start of vertex `i`; the mass is zero in unused lanes.
    pub fn begin(&mut self, i: usize, mass: f64, rest: DVec3, x: DVec3, u: DVec3) {
        let (block, lane) = (&mut self.blocks[i / WIDTH], i % WIDTH);
        block.split[lane] = 0.0;
        block.masses[lane] = mass;
        set(&mut block.rest, lane, rest);
        set(&mut block.x[0], lane, x);
        set(&mut block.u[0], lane, u);
    }

    /// Whether vertex `i` is advanced alone.
    #[inline(always)]
    pub fn is_split(&self, i: usize) -> bool {
        self.blocks[i / WIDTH].split[i % WIDTH] != 0.0
    }

    /// Sets whether vertex `i` is advanced alone.
    pub fn set_split(&mut self, i: usize, is_split: bool) {
        self.blocks[i / WIDTH].split[i % WIDTH] = f64::from(u8::from(is_split));
    }

    /// Adds to the displacement and the velocity of vertex `i` at a sample.
    pub fn shift(&mut self, sample: usize, i: usize, x: DVec3, u: DVec3) {
        let (block, lane) = (&mut self.blocks[i / WIDTH], i % WIDTH);
        for (of, by) in [(&mut block.x[sample], x), (&mut block.u[sample], u)] {
            let moved = get(of, lane) + by;
            set(of, lane, moved);
        }
    }

    /// Adds to the acceleration of vertex `i` at a sample.
    #[inline(always)]
    pub fn accelerate(&mut self, sample: usize, i: usize, by: DVec3) {
        let (f, lane) = (&mut self.blocks[i / WIDTH].f[sample], i % WIDTH);
        let changed = get(f, lane) + by;
        set(f, lane, changed);
    }

    /// Sets all accelerations at samples to zero.
    pub fn clear_forces(&mut self, samples: std::ops::Range<usize>) {
        for block in &mut self.blocks {
            block.f[samples.clone()].fill([[0.0; WIDTH]; 3]);
        }
    }

    /// Sets all errors to zero.
    pub fn clear_errors(&mut self) {
        for block in &mut self.blocks {
            block.errors = [[[0.0; WIDTH]; 3]; 2];
        }
    }
}

/// Σ wᵢ vᵢ.
#[inline(always)]
fn combine<S: Simd, const W: usize>(w: &[f64; 4], v: &[Vector<S, W>; 4]) -> Vector<S, W> {
    (v[0] * w[0] + v[1] * w[1]) + (v[2] * w[2] + v[3] * w[3])
}

/// Moves active vertices to a sample.
pub struct Move<'a> {
    pub active: &'a mut Active,
    pub sample: usize,
    pub weights: &'a Dense,
    /// Shared displacement and velocity.
    pub common: [DVec3; 2],
    /// Displacement and velocity per rest position.
    pub by_rest: [DMat3; 2],
}

/// How active vertices moved, and sums over their new states.
#[derive(Clone, Copy, Debug)]
pub struct Moved {
    /// The largest squares of a change in x and in u.
    pub changes: [f64; 2],
    /// The largest |x|² and |u|².
    pub largest: [f64; 2],
    /// Σ m x xᵀ
    pub xx: DMat3,
    /// Σ m x×u
    pub xu: DVec3,
}

zero_by_default!(Moved { [0.0; 2] => changes largest, DMat3::ZERO => xx, DVec3::ZERO => xu });

impl Kernel for Move<'_> {
    type Output = Moved;

    #[inline(always)]
    fn run<S: Simd, const W: usize>(self, simd: S) -> Moved {
        let Move { active, sample, weights: w, common, by_rest } = self;
        let common = [Vector::<S, 1>::splat(simd, common[0]), Vector::splat(simd, common[1])];
        let by_rest = [columns::<S, 1>(simd, by_rest[0]), columns(simd, by_rest[1])];
        let none = [Reals::splat(simd, 0.0); W];
        let [mut far, mut fast, mut max_x, mut max_u] = [none; 4];
        let [mut diagonal, mut beside, mut xu] = [[zero::<S, 1>(simd); W]; 3];
        for block in &mut active.blocks {
            for i in 0..W {
                let at = i * S::F64_LANES;
                let (x0, u0) = (part(simd, &block.x[0], at), part(simd, &block.u[0], at));
                let rest = part(simd, &block.rest, at);
                let [a, b, c, d, _] = &block.f;
                let f = [part(simd, a, at), part(simd, b, at), part(simd, c, at), part(simd, d, at)];
                let x = x0 * w.xx + u0 * w.xu + (combine(&w.x, &f) + (common[0] + times(&by_rest[0], rest)));
                let u = x0 * w.ux + u0 * w.uu + (combine(&w.u, &f) + (common[1] + times(&by_rest[1], rest)));
                let (x_before, u_before) = (part(simd, &block.x[sample], at), part(simd, &block.u[sample], at));
                // unused lanes repeat the last vertex
                far[i] = far[i].larger((x - x_before).length_squared());
                fast[i] = fast[i].larger((u - u_before).length_squared());
                max_x[i] = max_x[i].larger(x.length_squared());
                max_u[i] = max_u[i].larger(u.length_squared());
                x.into_block(&mut block.x[sample], at);
                u.into_block(&mut block.u[sample], at);
                let mx = x * Reals::load(simd, &block.masses, at);
                diagonal[i] = diagonal[i] + Vector { x: mx.x * x.x, y: mx.y * x.y, z: mx.z * x.z };
                beside[i] = beside[i] + Vector { x: mx.y * x.z, y: mx.z * x.x, z: mx.x * x.y };
                xu[i] = xu[i] + cross(mx, u);
            }
        }
        let (d, b) = (total_vector_parts(diagonal), total_vector_parts(beside));
        let xx = DMat3::from_cols(DVec3::new(d.x, b.z, b.y), DVec3::new(b.z, d.y, b.x), DVec3::new(b.y, b.x, d.z));
        let (mut far, xu) = (largest_parts(far), total_vector_parts(xu));
        if (d + xu).is_nan() {
            far = f64::NAN; // the maxima drop NaN, the sums do not
        }
        Moved { changes: [far, largest_parts(fast)], largest: [largest_parts(max_x), largest_parts(max_u)], xx, xu }
    }
}

/// Computes the positions of active vertices relative to the centre, for these axes.
pub struct PlaceAll<'a> {
    pub active: &'a mut Active,
    pub sample: usize,
    pub axes: DMat3,
}

impl Kernel for PlaceAll<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd, const W: usize>(self, simd: S) {
        let PlaceAll { active, sample, axes } = self;
        let axes = columns::<S, W>(simd, axes);
        for block in &mut active.blocks {
            store(times(&axes, load(simd, &block.rest)) + load(simd, &block.x[sample]), &mut block.s[sample]);
        }
    }
}

/// Finds active vertices that may cross the rim of a sphere in the step.
pub struct Detect<'a> {
    pub active: &'a mut Active,
    pub radius: f64,
    /// The sphere's centre relative to the body's, at the nodes.
    pub apart: [DVec3; 4],
    /// The sphere's velocity relative to the body's, at the nodes.
    pub passing: [DVec3; 4],
    /// The angular velocity of the frame at the nodes [rad/s].
    pub turning: [DVec3; 4],
    /// Length of the step [s].
    pub h: f64,
    /// Vertices farther from the rim than this at all nodes do not cross it within the step [scene unit].
    pub band: f64,
    /// They are listed here.
    pub crossing: &'a mut Vec<u32>,
    pub basis: &'a Basis,
}

impl Kernel for Detect<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd, const W: usize>(self, simd: S) {
        let Detect { active, radius, apart, passing, turning, h, band, crossing, basis } = self;
        let rim = Reals::splat(simd, radius * radius);
        let (inner, outer) = ((radius - band).max(0.0), radius + band);
        let (inner, outer) = (Reals::splat(simd, inner * inner), Reals::splat(simd, outer * outer));
        let (none, zero) = (Reals::<S, W>::splat(simd, 0.0), zero::<S, W>(simd));
        let apart = [
            Vector::<S, W>::splat(simd, apart[0]),
            Vector::splat(simd, apart[1]),
            Vector::splat(simd, apart[2]),
            Vector::splat(simd, apart[3]),
        ];
        let one = Reals::splat(simd, 1.0);
        // rounding errors must not decide
        let (above, below) = (rim * 1e-14, rim * -1e-14);
        let Active { vertices, blocks } = active;
        for (first, block) in (0..).step_by(WIDTH).zip(blocks) {
            let mut d = [zero; 4];
            let mut square = [none; 4];
            for node in 0..4 {
                d[node] = apart[node] - load(simd, &block.s[node]);
                square[node] = d[node].length_squared();
            }
            let min = square[0].smaller(square[1]).smaller(square[2].smaller(square[3]));
            let max = square[0].larger_or_nan(square[1]).larger_or_nan(square[2].larger_or_nan(square[3]));
            let mut crosses = outer.below(min).or(max.below(inner)).negated();
            if !crosses.any() {
                continue;
            }
            // nor do vertices cross it that are farther from it at all nodes than the largest of their rates takes them
            let (mut fastest, mut nearest) = (none, Reals::splat(simd, f64::INFINITY));
            let [mut values, mut rates] = [[none; 4]; 2];
            for node in 0..4 {
                let a = load(simd, &block.s[node]) - load(simd, &block.x[node]);
                let rate = cross(Vector::splat(simd, turning[node]), a) + load(simd, &block.u[node]);
                let v = Vector::splat(simd, passing[node]) - rate;
                let along = d[node].x * v.x + d[node].y * v.y + d[node].z * v.z;
                (values[node], rates[node]) = (rim - square[node], along * (-2.0 * h));
                fastest = fastest.larger_or_nan(rates[node].abs());
                nearest = nearest.smaller(values[node].abs());
            }
            let passes = fastest.below(nearest).negated();
            let mixed = max.below(rim).or(rim.below(min)).negated();
            crosses = crosses.and(passes.or(mixed));
            if !crosses.any() {
                continue;
            }
            // nor vertices whose polynomial has coefficients of one sign
            let (mut low, mut high) = (values[0].smaller(values[3]), values[0].larger_or_nan(values[3]));
            for row in &basis[1..7] {
                let b = (values[0] * row[0] + values[1] * row[1])
                    + (values[2] * row[2] + values[3] * row[3])
                    + ((rates[0] * row[4] + rates[1] * row[5]) + (rates[2] * row[6] + rates[3] * row[7]));
                (low, high) = (low.smaller(b), high.larger_or_nan(b));
            }
            crosses = crosses.and(above.below(low).or(high.below(below)).negated());
            if crosses.any() {
                let mut flags = [0.0; WIDTH];
                crosses.select(one, none).store(&mut flags, 0);
                let count = vertices.len();
                let flagged = (first..count.min(first + WIDTH)).filter(|&i| flags[i - first] != 0.0);
                crossing.extend(flagged.map(|i| i as u32));
            }
        }
    }
}

/// Adds the force of a sphere on the active vertices inside it, except those that are advanced alone.
pub struct Pull<'a> {
    pub active: &'a mut Active,
    pub sphere: &'a Sphere,
    pub weight: Weight,
    /// The sphere's centre relative to the body's, at the nodes.
    pub apart: [DVec3; 4],
    /// Velocity of the body's centre at the nodes, if the power is wanted.
    pub power: Option<[DVec3; 4]>,
    /// The first node at which accelerations are wanted.
    pub first: usize,
    /// Whether to replace the accelerations instead of adding to them.
    pub fresh: bool,
}

/// Σ m f of the vertices in a sphere at the nodes, and Σ m f·r′.
#[derive(Clone, Copy, Debug, Default)]
pub struct Pulled {
    pub force: [DVec3; 4],
    pub power: [f64; 4],
}

impl Kernel for Pull<'_> {
    type Output = Pulled;

    #[inline(always)]
    fn run<S: Simd, const W: usize>(self, simd: S) -> Pulled {
        let Pull { active, sphere, weight, apart, power: moving, first: first_node, fresh } = self;
        let (none, no_force) = (Reals::<S, W>::splat(simd, 0.0), zero::<S, W>(simd));
        let (mut force, mut power) = ([no_force; 4], [none; 4]);
        let one = Reals::splat(simd, 1.0);
        let rim = Reals::splat(simd, sphere.radius * sphere.radius);
        for block in &mut active.blocks {
            let together = Reals::load(simd, &block.split, 0).below(one);
            let start = Vector::splat(simd, apart[0]) - load(simd, &block.s[0]);
            // a vertex that starts inside and does not cross the rim stays inside
            let mut inside = together.and(start.length_squared().below(rim));
            if weight == Weight::Linear && !inside.any() {
                if fresh {
                    block.f[first_node..4].fill([[0.0; WIDTH]; 3]);
                }
                continue;
            }
            let m = Reals::load(simd, &block.masses, 0);
            for node in 0..4 {
                let d = Vector::splat(simd, apart[node]) - load(simd, &block.s[node]);
                let z = d.length_squared().sqrt() * (1.0 / sphere.radius);
                if weight == Weight::Wendland {
                    inside = together.and(z.below(one));
                }
                let g = inside.select_vector(d * (weight.inside(z) * sphere.strength[node]), no_force);
                if node >= first_node {
                    let f = &mut block.f[node];
                    store(if fresh { g } else { load(simd, f) + g }, f);
                }
                let pull = g * m;
                force[node] = force[node] + pull;
                if let Some(velocity) = moving {
                    let v = load(simd, &block.u[node]) + Vector::splat(simd, velocity[node]);
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

/// Adds the force of a sphere at a single sample on the active vertices inside it, and finds Σ m f.
pub struct PullAt<'a> {
    pub active: &'a mut Active,
    pub sphere: &'a Sphere,
    pub weight: Weight,
    pub sample: usize,
    /// The sphere's centre relative to the body's.
    pub apart: DVec3,
}

impl Kernel for PullAt<'_> {
    type Output = DVec3;

    #[inline(always)]
    fn run<S: Simd, const W: usize>(self, simd: S) -> DVec3 {
        let PullAt { active, sphere, weight, sample, apart } = self;
        let rim = Reals::splat(simd, sphere.radius * sphere.radius);
        let apart = Vector::<S, W>::splat(simd, apart);
        let (one, no_force) = (Reals::splat(simd, 1.0), zero::<S, W>(simd));
        let mut force = no_force;
        for block in &mut active.blocks {
            let d = apart - load(simd, &block.s[sample]);
            let square = d.length_squared();
            let inside = square.below(rim).and(Reals::load(simd, &block.split, 0).below(one));
            if !inside.any() {
                continue;
            }
            let z = square.sqrt() * (1.0 / sphere.radius);
            let g = inside.select_vector(d * (weight.inside(z) * sphere.strength[sample]), no_force);
            let f = &mut block.f[sample];
            store(load(simd, f) + g, f);
            force = force + g * Reals::load(simd, &block.masses, 0);
        }
        total_vector(force)
    }
}

/// Sums over the accelerations of active vertices at a sample.
#[derive(Clone, Copy, Debug)]
pub struct Gathered {
    /// Σ m f
    pub force: DVec3,
    /// Σ m l fᵀ
    pub by_rest: DMat3,
    /// Σ m s×f
    pub spinning: DVec3,
}

zero_by_default!(Gathered { DMat3::ZERO => by_rest, DVec3::ZERO => force spinning });

/// Sums the accelerations of active vertices at a sample; then adds `turning`×x to them.
pub struct Gather<'a> {
    pub active: &'a mut Active,
    pub sample: usize,
    pub turning: DVec3,
}

impl Kernel for Gather<'_> {
    type Output = Gathered;

    #[inline(always)]
    fn run<S: Simd, const W: usize>(self, simd: S) -> Gathered {
        let Gather { active, sample, turning } = self;
        let none = [zero::<S, 1>(simd); W];
        let (mut sum, mut by_rest, mut spinning) = (none, [[none[0]; 3]; W], none);
        for block in &active.blocks {
            for i in 0..W {
                let at = i * S::F64_LANES;
                let force = part(simd, &block.f[sample], at) * Reals::load(simd, &block.masses, at);
                sum[i] = sum[i] + force;
                add_outer(&mut by_rest[i], part(simd, &block.rest, at), force);
                spinning[i] = spinning[i] + cross(part(simd, &block.s[sample], at), force);
            }
        }
        let column = |c: usize| total_vector_parts(by_rest.map(|by_rest| by_rest[c]));
        let by_rest = DMat3::from_cols(column(0), column(1), column(2));
        if turning != DVec3::ZERO {
            let turning = Vector::<S, W>::splat(simd, turning);
            for block in &mut active.blocks {
                let f = &mut block.f[sample];
                store(load(simd, f) + cross(turning, load(simd, &block.x[sample])), f);
            }
        }
        Gathered { force: total_vector_parts(sum), by_rest, spinning: total_vector_parts(spinning) }
    }
}

/// Σ m (Φ − Φ(r_e)) of the active vertices at a node, in a sphere of radius r_e with its centre at `apart` from the
/// body's.
pub struct Potential<'a> {
    pub active: &'a Active,
    pub node: usize,
    pub weight: Weight,
    pub radius: f64,
    pub apart: DVec3,
}

impl Kernel for Potential<'_> {
    type Output = f64;

    #[inline(always)]
    fn run<S: Simd, const W: usize>(self, simd: S) -> f64 {
        let Potential { active, node, weight, radius, apart } = self;
        let apart = Vector::<S, W>::splat(simd, apart);
        let number = |value: f64| Reals::<S, W>::splat(simd, value);
        let (one, mut sum) = (number(1.0), number(0.0));
        let outside = influence_potential(weight, 1.0, 1.0);
        for block in &active.blocks {
            let z = (apart - load(simd, &block.s[node])).length_squared().sqrt() * (1.0 / radius);
            let z = z.smaller(one);
            sum = sum + (weight.potential(z) - number(outside)) * Reals::load(simd, &block.masses, 0);
        }
        total(sum) * radius * radius
    }
}

/// Adds the effect of the residual f₄ − Σ wᵢ fᵢ + common + by_rest l at a midpoint to the errors of active vertices.
pub struct AddResidual<'a> {
    pub active: &'a mut Active,
    pub weights: [f64; 4],
    pub common: DVec3,
    pub by_rest: DMat3,
    /// Effect on x and u at the end of the step.
    pub effect: (f64, f64),
}

impl Kernel for AddResidual<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd, const W: usize>(self, simd: S) {
        let AddResidual { active, weights: w, common, by_rest, effect } = self;
        let (common, by_rest) = (Vector::<S, W>::splat(simd, common), columns::<S, W>(simd, by_rest));
        for block in &mut active.blocks {
            let [a, b, c, d, found] = &block.f;
            let through_nodes = combine(&w, &[load(simd, a), load(simd, b), load(simd, c), load(simd, d)]);
            let shared = common + times(&by_rest, load(simd, &block.rest));
            let residual = load(simd, found) - through_nodes + shared;
            let [x, u] = &mut block.errors;
            store(load(simd, x) + residual * effect.0, x);
            store(load(simd, u) + residual * effect.1, u);
        }
    }
}

/// The largest error of x and of u of an active vertex, squared.
pub struct LargestErrors<'a>(pub &'a Active);

impl Kernel for LargestErrors<'_> {
    type Output = [f64; 2];

    #[inline(always)]
    fn run<S: Simd, const W: usize>(self, simd: S) -> [f64; 2] {
        let none = Reals::<S, W>::splat(simd, 0.0);
        let mut max = [none; 2];
        for block in &self.0.blocks {
            // the padding has no mass
            let real = none.below(Reals::load(simd, &block.masses, 0));
            for k in 0..2 {
                let square = load::<S, W>(simd, &block.errors[k]).length_squared();
                max[k] = max[k].larger_or_nan(real.select(square, none));
            }
        }
        max.map(largest)
    }
}

/// Σ m |u − spin×x + slip l|² of active vertices at a node.
pub struct Slipping<'a> {
    pub active: &'a Active,
    pub node: usize,
    pub spin: DVec3,
    pub slip: DMat3,
}

impl Kernel for Slipping<'_> {
    type Output = f64;

    #[inline(always)]
    fn run<S: Simd, const W: usize>(self, simd: S) -> f64 {
        let Slipping { active, node, spin, slip } = self;
        let (spin, slip) = (Vector::<S, W>::splat(simd, spin), columns::<S, W>(simd, slip));
        let mut sum = Reals::splat(simd, 0.0);
        for block in &active.blocks {
            let (x, u) = (load(simd, &block.x[node]), load(simd, &block.u[node]));
            let rate = u - cross(spin, x) + times(&slip, load(simd, &block.rest));
            sum = sum + rate.length_squared() * Reals::load(simd, &block.masses, 0);
        }
        total(sum)
    }
}
