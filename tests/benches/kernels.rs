//! Micro-benchmarks, one kernel each: `cargo bench`, or `cargo bench -- NAME` for some of them.
//!
//! Private kernels are measured through a world whose scene does little else.

#![allow(missing_docs, reason = "criterion's macro makes a public function")]

use std::{hint::black_box, time::Duration};

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use glam::DVec3;
use meldscope::{
    Scene, World,
    bench::scale::scenes::{Family, Layout},
    model::{
        oscillator::Oscillator,
        phase::{Phase, Thresholds},
    },
    scene::{Path, Push, path::Spline},
    sim::{
        Options, States,
        events::PairPaths,
        integrator::exponential::weights::Weights,
        reach::{Ball, Grid},
    },
};
use pulp::Arch;

fn two() -> Scene {
    Scene::builtin("two").expect("a built-in scene")
}

#[cfg(target_arch = "x86_64")]
fn instruction_sets() -> Vec<(&'static str, Arch)> {
    let v3 = pulp::x86::V3::try_new().map(|v3| ("AVX2", Arch::V3(v3)));
    let v4 = pulp::x86::V4::try_new().map(|v4| ("AVX-512", Arch::V4(v4)));
    [Some(("SSE2", Arch::Scalar)), v3, v4].into_iter().flatten().collect()
}

#[cfg(not(target_arch = "x86_64"))]
fn instruction_sets() -> Vec<(&'static str, Arch)> {
    vec![("default", Arch::new())]
}

/// The flow of the oscillator, its propagator over a short step and over a long one, and all weights of a step.
fn oscillator(c: &mut Criterion) {
    let mut group = c.benchmark_group("oscillator");
    let oscillator = Oscillator { omega: 12.0, damping: 1.5 };
    group.bench_function("flow", |b| b.iter(|| black_box(oscillator).flow(black_box(0.7))));
    group.bench_function("propagator, short", |b| b.iter(|| black_box(oscillator).propagator(black_box(1.0 / 60.0))));
    group.bench_function("propagator, long", |b| b.iter(|| black_box(oscillator).propagator(black_box(0.7))));
    group.bench_function("weights", |b| b.iter(|| Weights::new(black_box(oscillator), black_box(1.0 / 60.0))));
    group.finish();
}

/// A step of two overlapping bodies: all 532 vertices are always inside a sphere.
fn collocation(c: &mut Criterion) {
    let mut scene = two();
    for (body, x) in scene.bodies.iter_mut().zip([0.0, 0.2]) {
        body.motion = Path::Fixed(DVec3::X * x).into();
    }
    let mut group = c.benchmark_group("collocation");
    group.throughput(Throughput::Elements(scene.vertex_count()));
    for (name, arch) in instruction_sets() {
        let mut world =
            World::with_options(scene.clone(), Options { arch, ..Options::default() }).expect("enough memory");
        (0..600).for_each(|_| _ = world.step());
        group.bench_function(name, |b| b.iter(|| world.step().substeps));
    }
    group.finish();
}

/// Steps of a pair that oscillates so fast that vertices cross rims in most steps, which are then taken one by one.
fn single(c: &mut Criterion) {
    let mut scene = two();
    scene.bodies[0].motion = Path::Fixed(DVec3::ZERO).into();
    scene.bodies[1].motion =
        Path::Sine { center: DVec3::X * 2.1, amplitude: DVec3::X * 0.25, frequency: 4.0, phase: 0.0 }.into();
    let mut world = World::new(scene).expect("enough memory");
    (0..600).for_each(|_| _ = world.step());
    // 15 steps per period
    c.bench_function("single vertices/a period", |b| b.iter(|| (0..15).map(|_| world.step().substeps).sum::<u64>()));
}

/// The next phase change: without one for a long time, and with one.
fn events(c: &mut Criterion) {
    let mut group = c.benchmark_group("events");
    let thresholds = Thresholds { merge_at: 1.05, split_at: 1.2, core_at: 0.0 };
    let still = Path::Fixed(DVec3::ZERO);
    let keys = [(0.0, DVec3::new(2.7, 0.1, 0.0)), (1.8, DVec3::new(1.95, 0.0, 0.0)), (4.0, DVec3::new(2.6, 0.0, 0.0))];
    let moving = Path::Keyframes(Spline::new(&keys));
    let pair = PairPaths { a: &still, b: &moving, radii: 2.0 };
    let search = |start: f64, end: f64| pair.first_change(&thresholds, Phase::Apart, start, end);
    assert!(search(0.0, 1.0).is_none() && search(0.0, 1.8).is_some());
    group.bench_function("none in 16 steps", |b| b.iter(|| search(black_box(0.2), black_box(0.2 + 16.0 / 60.0))));
    group.bench_function("one", |b| b.iter(|| search(black_box(0.0), black_box(1.8))));
    group.finish();
}

/// Balls that move a little: updates the position of each, and finds the balls that touch it.
fn reach(c: &mut Criterion) {
    let mut group = c.benchmark_group("reach");
    let position = |i: u32| {
        let [x, y, z] = [i % 20, i / 20 % 20, i / 400].map(|k| 2.6 * f64::from(k));
        DVec3::new(x, y, z)
    };
    for (name, radius) in [
        ("equal sizes", (|_| 1.6) as fn(u32) -> f64),
        ("sizes 1 to 1,000", |i| if i % 1000 == 0 { 20.0 } else { 0.02 + 0.4 * f64::from(i % 7) }),
    ] {
        let count = 8000;
        let mut grid = Grid::default();
        (0..count).for_each(|i| grid.place(i, Ball { centre: position(i), radius: radius(i) }));
        let (mut i, mut found) = (0, vec![]);
        group.bench_function(name, |b| {
            b.iter(|| {
                i = (i + 7919) % count;
                grid.place(i, Ball { centre: position(i) + DVec3::X * 0.1, radius: radius(i) });
                found.clear();
                grid.touching(i, &mut found);
                found.len()
            });
        });
    }
    group.finish();
}

/// A step of scenes of the size benchmark.
fn step(c: &mut Criterion) {
    let mut group = c.benchmark_group("step");
    for (family, bodies) in [(Family::Contact, 2), (Family::Contact, 200), (Family::Rest, 2), (Family::Rest, 10_000)] {
        let mut world = World::new(Layout::new(family, bodies).scene(&two())).expect("enough memory");
        (0..240).for_each(|_| _ = world.step());
        let id = BenchmarkId::new(family.name(), bodies);
        group.bench_function(id, |b| b.iter(|| world.step().substeps));
    }
    group.finish();
}

/// The states of all vertices of a body that oscillate freely: each by itself, after another body has left its inside; and
/// all equally, after a push.
fn states(c: &mut Criterion) {
    let mut group = c.benchmark_group("states");
    group.throughput(Throughput::Elements(266));
    let away = DVec3::X * 4.0;
    for (name, is_pushed) in [("each vertex by itself", false), ("all equally", true)] {
        let mut scene = two();
        let leaving = Path::Keyframes(Spline::new(&[(0.0, DVec3::X * 0.3), (0.5, away)]));
        scene.bodies[0].motion = Path::Fixed(DVec3::ZERO).into();
        scene.bodies[1].motion = if is_pushed { Path::Fixed(away) } else { leaving }.into();
        let push = Push { body: 0, direction: DVec3::X, strength: 60.0, start: 0.1, duration: 0.1 };
        scene.pushes = if is_pushed { vec![push] } else { vec![] };
        for (arch_name, arch) in instruction_sets() {
            let options = Options { arch, ..Options::default() };
            let mut world = World::with_options(scene.clone(), options).expect("enough memory");
            (0..90).for_each(|_| _ = world.step());
            let mut states = States::default();
            group.bench_function(BenchmarkId::new(name, arch_name), |b| {
                b.iter(|| {
                    world.body(0).states_into(&mut states);
                    states.displacement.x[0]
                });
            });
        }
    }
    group.finish();
}

criterion_group! {
    name = kernels;
    config = Criterion::default().warm_up_time(Duration::from_millis(300)).measurement_time(Duration::from_secs(1));
    targets = oscillator, collocation, single, events, reach, step, states
}
criterion_main!(kernels);
