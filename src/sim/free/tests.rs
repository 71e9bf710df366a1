//! Free bodies: tests against closed forms, against conservation laws, and for self-consistency.

use std::sync::Arc;

use glam::{DMat3, DVec3};
use pulp::Arch;

use super::*;
use crate::model::{
    ForFree,
    oscillator::Oscillator,
    phase::{Phase, Thresholds},
    shape_matching::{Plane, rotation_by},
};
use crate::{
    scene::Push,
    sim::{terms::Cause, work::Tally},
};

impl Island {
    /// An island at t = 0 whose error stays within `tolerance` [radii/s].
    fn new(bodies: Vec<Body>, pairs: Vec<Pair>, field: Field, tolerance: f64) -> Island {
        Island::resume(Parts { bodies, pairs, field, ..Parts::default() }, tolerance, 0.0)
    }

    fn advance(&mut self, end: f64, paths: &dyn Paths, report: &mut Report) -> Result<(), Failure> {
        self.advance_with(&mut Scratch::default(), end, paths, &Tally::unlimited(), report, &mut |_| ())
    }

    fn snapshot(&self) -> Snapshot<'_> {
        Snapshot::new(self.bodies.iter().collect(), self.pairs.clone(), self.field.clone(), self.time)
    }

    fn conserved(&self) -> Conserved {
        self.snapshot().conserved()
    }
}

impl Body {
    /// World position of a vertex [scene unit].
    fn position(&self, vertex: usize) -> DVec3 {
        self.centre + (self.rotation * self.shape.rest[vertex] + self.x[vertex])
    }

    /// World velocity of every vertex [scene unit/s].
    fn velocities(&self) -> impl Iterator<Item = DVec3> + '_ {
        let (spin, axes) = (self.frame_spin(), DMat3::from_quat(self.rotation));
        self.shape.rest.iter().zip(&self.u).map(move |(&l, &u)| self.velocity + (spin.cross(axes * l) + u))
    }
}

fn falling(gravity: DVec3) -> Vec<(Cause, DVec3)> {
    vec![(Cause::Gravity, gravity)]
}

/// No paths, for islands without prescribed bodies.
struct NoPaths;

impl Paths for NoPaths {
    fn at(&self, _: usize, _: f64, _: bool) -> Driven {
        Driven::default()
    }
}

impl<F: Fn(usize, f64, bool) -> Driven + Sync> Paths for F {
    fn at(&self, body: usize, t: f64, before: bool) -> Driven {
        self(body, t, before)
    }
}

/// A sphere of 86 vertices. Masses are shares of the surface by bands between rings, not by triangles.
fn sphere(radius: f64, mass: f64) -> Arc<Shape> {
    stretched_sphere(radius, mass, DVec3::ONE)
}

/// Like [`sphere`], stretched along the axes.
fn stretched_sphere(radius: f64, mass: f64, stretch: DVec3) -> Arc<Shape> {
    let (stacks, slices) = (8, 12);
    let mut rest = vec![DVec3::Z, -DVec3::Z];
    let cap = |polar: f64| 1.0 - libm::cos(polar);
    let width = std::f64::consts::PI / f64::from(stacks);
    let mut masses = vec![cap(0.5 * width) / 2.0; 2];
    for i in 1..stacks {
        let polar = width * f64::from(i);
        for j in 0..slices {
            let (sin, cos) = libm::sincos(std::f64::consts::TAU * f64::from(j) / f64::from(slices));
            rest.push(DVec3::new(libm::sin(polar) * cos, libm::sin(polar) * sin, libm::cos(polar)));
            masses.push((cap(polar + 0.5 * width) - cap(polar - 0.5 * width)) / (2.0 * f64::from(slices)));
        }
    }
    let rest = rest.into_iter().map(|v| radius * stretch * v).collect();
    Arc::new(Shape::new(rest, masses.into_iter().map(|m| mass * m).collect()))
}

const LAW: PairLaw = PairLaw {
    alpha: 100.0,
    beta: 60.0,
    apart_repels: true,
    thresholds: Thresholds { merge_at: 1.05, split_at: 1.15, core_at: 0.0 },
    core_width: 0.0,
    for_free: ForFree::Nothing,
};

fn body(radius: f64, oscillator: Oscillator, from: DVec3, velocity: DVec3, spin: DVec3) -> Body {
    let mut body = Body::free(sphere(radius, radius.powi(3)), radius, oscillator, Rotation::Free);
    body.throw(from, velocity, spin);
    body
}

fn pair(a: u32, b: u32, phase: Phase, law: PairLaw) -> Pair {
    Pair { a, b, phase, law, window: None }
}

/// Two bodies of different size that meet off-centre.
fn two(oscillator: Oscillator, law: PairLaw, tolerance: f64) -> Island {
    let a = body(1.0, oscillator, DVec3::new(-1.6, 0.1, 0.0), DVec3::new(1.2, 0.0, 0.0), DVec3::new(0.2, 0.0, 0.5));
    let b = body(0.8, oscillator, DVec3::new(1.2, -0.1, 0.05), DVec3::new(-1.0, 0.0, 0.0), DVec3::ZERO);
    Island::new(vec![a, b], vec![pair(0, 1, Phase::Apart, law)], Field::default(), tolerance)
}

fn run(island: &mut Island, duration: f64, dt: f64) -> Report {
    let mut report = Report::default();
    let start = island.time();
    for step in 1..=(duration / dt).round() as u32 {
        island.advance(start + f64::from(step) * dt, &NoPaths, &mut report).expect("can be followed");
    }
    report
}

/// The largest distance between corresponding vertices.
fn difference(a: &Island, b: &Island) -> f64 {
    let all = a.bodies().iter().zip(b.bodies());
    all.flat_map(|(a, b)| (0..a.x.len()).map(|i| a.position(i).distance(b.position(i)))).fold(0.0, f64::max)
}

#[test]
fn a_throw_is_a_parabola() {
    let gravity = DVec3::new(0.3, 0.0, -9.81);
    let o = Oscillator { omega: 12.0, damping: 1.0 };
    let (from, velocity) = (DVec3::new(1.0, 2.0, 3.0), DVec3::new(-1.0, 4.0, 5.0));
    let thrown = body(1.0, o, from, velocity, DVec3::new(0.5, -1.0, 2.0));
    let mut island = Island::new(vec![thrown], vec![], Field { uniform: falling(gravity), ..Field::default() }, 1e-6);
    let spin = island.bodies()[0].spin;
    run(&mut island, 2.0, 1.0 / 60.0);
    let expected = from + 2.0 * velocity + 2.0 * gravity;
    assert!(island.bodies()[0].centre.distance(expected) < 1e-12);
    assert!((island.bodies()[0].spin - spin).length() < 1e-12);
}

/// sn, cn, dn for the parameter m = k², by the arithmetic-geometric mean (Abramowitz & Stegun 16.4).
fn jacobi(u: f64, m: f64) -> [f64; 3] {
    let (mut a, mut b, mut c) = (vec![1.0], (1.0 - m).sqrt(), vec![m.sqrt()]);
    while c[c.len() - 1] > 1e-16 {
        let last = a[a.len() - 1];
        a.push(0.5 * (last + b));
        c.push(0.5 * (last - b));
        b = (last * b).sqrt();
    }
    let n = a.len() - 1;
    let mut phi = f64::powi(2.0, n as i32) * a[n] * u;
    for k in (1..=n).rev() {
        phi = 0.5 * (phi + (c[k] / a[k] * phi.sin()).asin());
    }
    [phi.sin(), phi.cos(), (1.0 - m * phi.sin().powi(2)).sqrt()]
}

/// A stiff body with three different moments follows Euler's equations (Landau & Lifshitz, Mechanics, § 37).
#[test]
fn a_stiff_body_turns_like_a_top() {
    let shape = stretched_sphere(1.0, 1.0, DVec3::new(1.0, 0.8, 0.6));
    let mut top = Body::free(shape, 1.0, Oscillator { omega: 1e5, damping: 1e3 }, Rotation::Free);
    let start = DVec3::new(0.6, 0.0, 2.0); // I₁ < I₂ < I₃ about x, y, z
    top.throw(DVec3::ZERO, DVec3::ZERO, start);
    let spread = top.shape.spread;
    let (x, y, z) = (spread.x_axis.x, spread.y_axis.y, spread.z_axis.z);
    let [i1, i2, i3] = [y + z, x + z, x + y];
    let energy2 = i1 * start.x * start.x + i3 * start.z * start.z;
    let momentum2 = (i1 * start.x).powi(2) + (i3 * start.z).powi(2);
    assert!(momentum2 > energy2 * i2);
    let rate = ((i3 - i2) * (momentum2 - energy2 * i1) / (i1 * i2 * i3)).sqrt();
    let m = (i2 - i1) * (energy2 * i3 - momentum2) / ((i3 - i2) * (momentum2 - energy2 * i1));

    let mut island = Island::new(vec![top], vec![], Field::default(), 1e-6);
    let duration = 5.0;
    run(&mut island, duration, 1.0 / 60.0);
    let [sn, cn, dn] = jacobi(rate * duration, m);
    let second = ((energy2 * i3 - momentum2) / (i2 * (i3 - i2))).sqrt();
    let expected = DVec3::new(start.x * cn, second * sn, start.z * dn);
    let top = &island.bodies()[0];
    let found = top.rotation.inverse() * top.frame_spin();
    // the orientation of the axes leaves the sign open
    let error = found.distance(expected).min(found.distance(expected * DVec3::new(1.0, -1.0, 1.0)));
    assert!(error < 1e-7, "{found} {expected}");
}

#[test]
fn momentum_and_angular_momentum_are_conserved_and_energy_is_accounted_for() {
    let mut island = two(Oscillator { omega: 12.0, damping: 0.0 }, LAW, 1e-6);
    let first = island.conserved();
    let report = run(&mut island, 3.0, 1.0 / 60.0);
    let last = island.conserved();
    assert!((last.momentum - first.momentum).length() < 1e-13);
    assert!((last.angular_momentum - first.angular_momentum).length() < 1e-13);
    assert!(!report.changes.is_empty());
    let brought: f64 = report.changes.iter().map(|change| change.energy).sum();
    assert!((last.energy() - first.energy() - brought).abs() < 1e-6 * first.energy().abs());
}

/// The spring causes no stiff coupling between vertices and frame.
#[test]
fn accuracy_does_not_depend_on_stiffness() {
    for omega in [3.0, 12.0, 100.0, 1e3, 1e4] {
        for damping in [0.0, 0.1 * omega, 2.0 * omega] {
            let o = Oscillator { omega, damping };
            let mut island = two(o, LAW, 1e-6);
            let mut exact = two(o, LAW, 1e-8);
            let (report, close) = (run(&mut island, 0.7, 1.0 / 60.0), run(&mut exact, 0.7, 1.0 / 60.0));
            let error = difference(&island, &exact);
            assert!(error < 7e-7, "{omega} {damping}: {error:e}");
            assert!((report.changes[0].time - close.changes[0].time).abs() < 1e-8);
            assert!(report.steps < 400, "{omega} {damping}: {}", report.steps); // the minimum is 42
        }
    }
}

/// With a tolerance that divides no step, shorter steps show the order of the method, down to the limit of its
/// iteration.
#[test]
fn the_error_falls_with_the_fifth_power_of_the_step() {
    let outcome = |divided: u32, tolerance: f64| {
        let mut island = two(Oscillator { omega: 12.0, damping: 1.5 }, LAW, tolerance);
        run(&mut island, 1.0, 1.0 / f64::from(50 * divided));
        island
    };
    let exact = outcome(8, 1e-9);
    let errors = [1, 2].map(|divided| difference(&outcome(divided, 1.0), &exact));
    assert!((errors[0] / errors[1]).log2() > 4.4, "{errors:?}");
}

#[test]
fn the_number_of_steps_grows_slowly_with_accuracy() {
    let o = Oscillator { omega: 12.0, damping: 1.5 };
    let mut exact = two(o, LAW, 1e-11);
    run(&mut exact, 1.0, 1.0 / 60.0);
    let mut last = None;
    for tolerance in [1e-4, 1e-6, 1e-8] {
        let mut island = two(o, LAW, tolerance);
        let report = run(&mut island, 1.0, 1.0 / 20.0);
        let error = difference(&island, &exact);
        assert!(error < tolerance, "{tolerance:e}: {error:e}");
        if let Some(before) = last {
            assert!(report.steps < 4 * before, "{tolerance:e}: {} after {before}", report.steps);
        }
        last = Some(report.steps);
    }
}

/// Known outcomes of head-on encounters, by strengths and speed.
#[test]
fn slow_bodies_bounce_off_and_fast_ones_merge_or_pass() {
    let o = Oscillator { omega: 12.0, damping: 1.5 };
    for (alpha, beta, speed, expected) in [
        (100.0, 60.0, 0.4, &[][..]),
        (100.0, 60.0, 0.8, &[Phase::Merged][..]),
        (100.0, 60.0, 6.4, &[Phase::Merged]),
        (100.0, 60.0, 12.8, &[Phase::Merged, Phase::Apart]),
        (220.0, 120.0, 0.8, &[]),
        (220.0, 120.0, 12.8, &[Phase::Merged]),
    ] {
        let law = PairLaw { alpha, beta, ..LAW };
        let half = 0.5 * speed * DVec3::X;
        let a = body(1.0, o, -1.6 * DVec3::X, half, DVec3::ZERO);
        let b = body(1.0, o, 1.6 * DVec3::X, -half, DVec3::ZERO);
        let mut island = Island::new(vec![a, b], vec![pair(0, 1, Phase::Apart, law)], Field::default(), 1e-6);
        let report = run(&mut island, 2.5, 1.0 / 60.0);
        let found: Vec<Phase> = report.changes.iter().map(|change| change.to).collect();
        assert_eq!(found, expected, "{alpha} {speed}");
    }
}

/// Rotating the whole setup rotates the result.
#[test]
fn results_do_not_depend_on_orientation() {
    let o = Oscillator { omega: 12.0, damping: 1.5 };
    let turn = rotation_by(DVec3::new(0.4, -1.0, 0.7));
    let mut island = two(o, LAW, 1e-6);
    let mut turned = island.clone();
    for body in &mut turned.bodies {
        body.centre = turn * body.centre;
        body.velocity = turn * body.velocity;
        body.rotation = turn * body.rotation;
        body.spin = turn * body.spin;
    }
    run(&mut island, 1.0, 1.0 / 60.0);
    run(&mut turned, 1.0, 1.0 / 60.0);
    for (body, turned) in island.bodies().iter().zip(turned.bodies()) {
        for i in 0..body.x.len() {
            assert!((turn * body.position(i)).distance(turned.position(i)) < 1e-9);
        }
    }
}

/// Four vertices in a square that does not rotate: a plane acts on it like on a point.
fn slab(omega: f64, from: DVec3, velocity: DVec3) -> Body {
    let rest = vec![DVec3::X, DVec3::Y, -DVec3::X, -DVec3::Y];
    let shape = Arc::new(Shape::new(rest, vec![0.25; 4]));
    let mut slab = Body::free(shape, 1.0, Oscillator { omega, damping: 0.0 }, Rotation::Fixed);
    slab.throw(from, velocity, DVec3::ZERO);
    slab
}

#[test]
fn a_slab_bounces_off_a_plane_like_a_spring() {
    let plane = Plane { normal: DVec3::Z, offset: 0.0, stiffness: 4000.0, friction: 0.0, slip: 0.01 };
    let thrown = slab(30.0, DVec3::new(0.0, 0.0, 0.33), DVec3::new(0.2, 0.0, -1.5));
    let mut island = Island::new(vec![thrown], vec![], Field { planes: vec![plane], ..Field::default() }, 1e-6);
    run(&mut island, 0.5, 1.0 / 60.0);
    // contact at 0.22 s, and separation half a period later
    let away = 0.22 + std::f64::consts::PI / 4000f64.sqrt();
    let expected = DVec3::new(0.1, 0.0, 1.5 * (0.5 - away));
    let found = &island.bodies()[0];
    assert!(found.centre.distance(expected) < 1e-6, "{} {expected}", found.centre);
    assert!((found.velocity.z - 1.5).abs() < 1e-6);
}

#[test]
fn a_slab_slides_as_far_as_friction_lets_it() {
    let (stiffness, friction, slip, gravity, speed) = (4000.0, 0.3, 0.02, 9.81, 1.2);
    let plane = Plane { normal: DVec3::Z, offset: 0.0, stiffness, friction, slip };
    let thrown = slab(30.0, DVec3::new(0.0, 0.0, -gravity / stiffness), speed * DVec3::X);
    let field = Field { planes: vec![plane], uniform: falling(-gravity * DVec3::Z), ..Field::default() };
    let mut island = Island::new(vec![thrown], vec![], field, 1e-6);
    run(&mut island, 1.0, 1.0 / 60.0);
    // v′ = −μ g v/√(v² + v_s²)
    let way = 0.5 * (speed * (speed * speed + slip * slip).sqrt() + slip * slip * (speed / slip).asinh());
    let found = &island.bodies()[0];
    assert!((found.centre.x - way / (friction * gravity)).abs() < 1e-6, "{}", found.centre.x);
    assert!(found.velocity.length() < 1e-7);
}

/// Two bodies on a rough plane, which damps their motion, where attraction turns into repulsion.
#[test]
fn chatter_is_reported_and_a_core_width_prevents_it() {
    let plane = Plane { normal: DVec3::Z, offset: 0.0, stiffness: 4000.0, friction: 0.5, slip: 0.01 };
    let thresholds = Thresholds { core_at: 0.7, ..LAW.thresholds };
    let outcome = |core_width: f64| {
        let law = PairLaw { thresholds, core_width, ..LAW };
        let at = |x: f64| slab(30.0, DVec3::new(x, 0.0, -9.81 / 4000.0), DVec3::ZERO);
        let pairs = vec![pair(0, 1, Phase::Merged, law)];
        let field = Field { planes: vec![plane], uniform: falling(-9.81 * DVec3::Z), ..Field::default() };
        let mut island = Island::new(vec![at(-0.71), at(0.71)], pairs, field, 1e-6);
        let mut report = Report::default();
        (1..=60).try_for_each(|step| island.advance(f64::from(step) / 60.0, &NoPaths, &mut report))
    };
    let chattering = outcome(0.0);
    assert!(matches!(chattering, Err(Failure::Chatter { a: 0, b: 1, .. })), "{chattering:?}");
    assert_eq!(outcome(0.3), Ok(()));
}

/// The sphere of a body on a path pulls the vertices of a free body. The free body's sphere pulls those of the
/// prescribed body, and their reaction pulls the free body.
#[test]
fn a_free_body_follows_one_on_a_path() {
    let o = Oscillator { omega: 12.0, damping: 1.5 };
    let path = |body: usize, t: f64, _: bool| match body {
        0 => Driven { place: Place { centre: 0.5 * t * DVec3::X, velocity: 0.5 * DVec3::X }, uniform: DVec3::ZERO },
        _ => Driven::default(),
    };
    let led = body(0.5, o, DVec3::new(1.0, 0.0, 0.0), DVec3::ZERO, DVec3::ZERO);
    let leads = Body::prescribed(sphere(1.0, 1.0), 1.0, o);
    let law = PairLaw { thresholds: Thresholds { core_at: 0.6, ..LAW.thresholds }, core_width: 0.3, ..LAW };
    let mut island = Island::new(vec![leads, led], vec![pair(0, 1, Phase::Merged, law)], Field::default(), 1e-6);
    let mut report = Report::default();
    for step in 1..=360 {
        island.advance(f64::from(step) / 60.0, &path, &mut report).expect("can be followed");
    }
    assert!(island.bodies()[1].centre.distance(island.bodies()[0].centre) < 1.2);
}

/// Steps of fixed length end within their reported error of the exact state, and keep momentum.
#[test]
fn fixed_steps_stay_within_their_reported_error() {
    let oscillator = Oscillator { omega: 12.0, damping: 1.5 };
    let (mut exact, mut island) = (two(oscillator, LAW, 1e-6), two(oscillator, LAW, 1e-6));
    let (mut scratch, mut report) = (Scratch::new(Arch::new()), Report::default());
    let first = island.conserved();
    for step in 1..=120 {
        let end = f64::from(step) / 60.0;
        exact.advance(end, &NoPaths, &mut Report::default()).unwrap();
        let work = Tally::unlimited();
        let done = island.advance_in_fixed_steps(&mut scratch, end, 0, &NoPaths, &work, &mut report);
        done.unwrap();
        let apart = |(a, b): (&Body, &Body)| {
            (0..a.x.len()).map(|i| a.position(i).distance(b.position(i)) / a.radius).fold(0.0, f64::max)
        };
        let error = exact.bodies().iter().zip(island.bodies()).map(apart).fold(0.0, f64::max);
        assert!(error <= report.error, "step {step}: {error} of {}", report.error);
        let now = island.conserved();
        assert!(now.momentum.distance(first.momentum) < 1e-12, "{}", now.momentum);
        assert!(now.angular_momentum.distance(first.angular_momentum) < 1e-12, "{}", now.angular_momentum);
    }
    let left = island.conserved().energy() - first.energy() - report.ledger.total();
    let scale = first.kinetic;
    assert!(left.abs() < 0.2 * scale, "{left} of {scale}");
}

/// An island takes shorter steps than stability requires only where those of all islands together cost little.
#[test]
fn the_allowance_for_short_fixed_steps_is_shared() {
    let steps = |vertices: u64| {
        let mut island = two(Oscillator { omega: 12.0, damping: 1.5 }, LAW, 1e-6);
        let (mut scratch, mut report) = (Scratch::new(Arch::new()), Report::default());
        let work = Tally::unlimited();
        island.advance_in_fixed_steps(&mut scratch, 1.0 / 60.0, vertices, &NoPaths, &work, &mut report).unwrap();
        report.steps
    };
    assert_eq!(steps(0), 32);
    assert!(steps(100_000) <= 4, "{}", steps(100_000));
}

/// Steps of fixed length, and their work, do not depend on what the buffers held before.
#[test]
fn fixed_steps_do_not_depend_on_reused_buffers() {
    let run = |scratch: &mut Scratch| {
        let mut island = two(Oscillator { omega: 12.0, damping: 1.5 }, LAW, 1e-6);
        let work = Tally::unlimited();
        for step in 1..=40 {
            let end = f64::from(step) / 60.0;
            island.advance_in_fixed_steps(scratch, end, 0, &NoPaths, &work, &mut Report::default()).unwrap();
        }
        let positions = |body: &Body| (0..body.x.len()).map(|i| body.position(i).to_array()).collect::<Vec<_>>();
        (island.bodies().iter().map(positions).collect::<Vec<_>>(), work.done())
    };
    let mut scratch = Scratch::new(Arch::new());
    let first = run(&mut scratch);
    assert_eq!(first, run(&mut scratch));
}

#[test]
fn results_do_not_depend_on_the_instruction_set() {
    let outcome = |arch: Arch| {
        let mut island = two(Oscillator { omega: 12.0, damping: 1.5 }, LAW, 1e-6);
        let (mut scratch, mut report) = (Scratch::new(arch), Report::default());
        for step in 1..=40 {
            let end = f64::from(step) / 60.0;
            island
                .advance_with(&mut scratch, end, &NoPaths, &Tally::unlimited(), &mut report, &mut |_| ())
                .expect("can be followed");
        }
        assert!(!report.changes.is_empty());
        island
    };
    let (best, plain) = (outcome(Arch::new()), outcome(Arch::Scalar));
    for (a, b) in best.bodies().iter().zip(plain.bodies()) {
        assert_eq!((a.centre, a.rotation, a.spin), (b.centre, b.rotation, b.spin));
        assert_eq!((&a.x, &a.u), (&b.x, &b.u));
    }
}

/// A cube of bodies that fly at each other, with spin, on a rough plane.
fn cube(tolerance: f64, damping: f64) -> Island {
    let o = Oscillator { omega: 12.0, damping };
    let place = |i: u32| DVec3::new(f64::from(i % 3), f64::from(i / 3 % 3), f64::from(i / 9)) - DVec3::ONE;
    let thrown =
        |i: u32| body(1.0 - 0.01 * f64::from(i % 4), o, 2.3 * place(i), -2.0 * place(i), 0.3 * place((i + 5) % 27));
    let bodies: Vec<Body> = (0..27).map(thrown).collect();
    let mut pairs = Vec::new();
    for a in 0..27 {
        for b in a + 1..27 {
            pairs.push(pair(a, b, Phase::Apart, LAW));
        }
    }
    let plane = Plane { normal: DVec3::Z, offset: -3.2, stiffness: 800.0, friction: 0.3, slip: 0.1 };
    let planes = if damping > 0.0 { vec![plane] } else { vec![] };
    Island::new(bodies, pairs, Field { planes, ..Field::default() }, tolerance)
}

#[test]
fn many_bodies_converge_with_the_tolerance() {
    let (mut loose, mut tight) = (cube(1e-5, 1.5), cube(1e-7, 1.5));
    let [found, expected] = [&mut loose, &mut tight].map(|island| run(island, 15.0 / 60.0, 1.0 / 60.0));
    assert!(found.changes.len() > 20 && found.changes.len() == expected.changes.len());
    for (found, expected) in found.changes.iter().zip(&expected.changes) {
        assert_eq!((found.pair, found.to), (expected.pair, expected.to));
        assert!((found.time - expected.time).abs() < 1e-7, "{} {}", found.time, expected.time);
        assert!((found.energy - expected.energy).abs() < 1e-5, "{} {}", found.energy, expected.energy);
    }
    let error = difference(&loose, &tight);
    assert!(error < 1e-6, "{error:e}");
}

#[test]
fn many_bodies_conserve_momentum_and_balance_the_ledger() {
    let mut island = cube(1e-6, 0.0);
    let first = island.conserved();
    let (error, ledger) = {
        let report = run(&mut island, 15.0 / 60.0, 1.0 / 60.0);
        let last = island.conserved();
        assert!((last.momentum - first.momentum).length() < 1e-7, "{}", last.momentum);
        assert!((last.angular_momentum - first.angular_momentum).length() < 1e-6, "{}", last.angular_momentum);
        ((last.energy() - first.energy() - report.ledger.total()) / first.energy(), report.ledger)
    };
    assert!(error.abs() < 1e-6, "{error:e} {ledger:?}");
    assert!(ledger.events != 0.0 && ledger.prescribed == 0.0);
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let o = Oscillator { omega: 12.0, damping: 1.5 };
    let place = |i: u32| DVec3::new(f64::from(i % 4), f64::from(i / 4 % 4), f64::from(i / 16)) * 1.9;
    let bodies: Vec<Body> = (0..48).map(|i| body(1.0, o, place(i), -0.1 * place(i), DVec3::X)).collect();
    let mut pairs = Vec::new();
    for a in 0..48 {
        for b in a + 1..48 {
            let q = place(a).distance(place(b)) / 2.0;
            if q < 2.0 {
                pairs.push(pair(a, b, LAW.thresholds.initial(q), LAW));
            }
        }
    }
    let outcome = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        let mut island = Island::new(bodies.clone(), pairs.clone(), Field::default(), 1e-4);
        pool.install(|| run(&mut island, 2.0 / 60.0, 1.0 / 60.0));
        island
    };
    let (one, three) = (outcome(1), outcome(3));
    for (a, b) in one.bodies().iter().zip(three.bodies()) {
        assert_eq!((a.centre, a.velocity, a.rotation, &a.x, &a.u), (b.centre, b.velocity, b.rotation, &b.x, &b.u));
    }
}

/// Largest difference between the change of an island's energy and its ledger in a run, relative to the energy in it.
fn unexplained(mut island: Island, paths: &dyn Paths, duration: f64) -> (f64, Ledger) {
    let before = island.conserved().energy();
    let (mut report, mut worst, mut scale) = (Report::default(), 0.0, before.abs());
    for step in 1..=(duration * 60.0).round() as u32 {
        island.advance(f64::from(step) / 60.0, paths, &mut report).expect("can be followed");
        let now = island.conserved();
        worst = f64::max(worst, (now.energy() - before - report.ledger.total()).abs());
        scale = f64::max(scale, now.kinetic + now.spin + now.vibration + now.elastic);
    }
    (worst / scale, report.ledger)
}

#[test]
fn the_ledger_accounts_for_damping_events_and_the_rim_of_the_core() {
    for (damping, core_at, core_width) in [(0.0, 0.0, 0.0), (1.5, 0.0, 0.0), (0.0, 0.6, 0.3), (1.5, 0.6, 0.3)] {
        let law = PairLaw { thresholds: Thresholds { core_at, ..LAW.thresholds }, core_width, ..LAW };
        let (error, ledger) = unexplained(two(Oscillator { omega: 12.0, damping }, law, 1e-6), &NoPaths, 6.0);
        assert!(error < 1e-6, "{damping} {core_width}: {error:e} {ledger:?}");
        assert!(ledger.events != 0.0);
        assert_eq!((ledger.damping < 0.0, ledger.core != 0.0), (damping > 0.0, core_width > 0.0));
        assert_eq!((ledger.friction, ledger.pushes, ledger.prescribed), (0.0, 0.0, 0.0));
    }
}

#[test]
fn the_ledger_accounts_for_friction_and_pushes() {
    let plane = Plane { normal: DVec3::Z, offset: 0.0, stiffness: 4000.0, friction: 0.4, slip: 0.05 };
    let push = Push { body: 0, direction: DVec3::Y, strength: 30.0, start: 0.21, duration: 0.19 };
    let gravity = -9.81 * DVec3::Z;
    for (damping, pushes) in [(0.0, vec![]), (1.0, vec![push])] {
        let o = Oscillator { omega: 12.0, damping };
        let thrown = body(1.0, o, 1.2 * DVec3::Z, DVec3::new(2.0, 0.5, 0.0), DVec3::new(0.0, 3.0, 1.0));
        let field = Field { uniform: falling(gravity), planes: vec![plane], pushes, ..Field::default() };
        let (error, ledger) = unexplained(Island::new(vec![thrown], vec![], field, 1e-6), &NoPaths, 1.5);
        assert!(error < 1e-6, "{damping}: {error:e} {ledger:?}");
        assert!(ledger.friction < 0.0 && (ledger.pushes > 0.0) == (damping > 0.0));
    }
}

#[test]
fn the_ledger_accounts_for_bodies_on_paths() {
    let o = Oscillator { omega: 12.0, damping: 0.5 };
    let path = |body: usize, t: f64, _: bool| match body {
        0 => Driven {
            place: Place {
                centre: DVec3::new(0.6 * libm::sin(t), 0.1, 0.0),
                velocity: DVec3::new(0.6 * libm::cos(t), 0.0, 0.0),
            },
            uniform: DVec3::new(0.6 * libm::sin(t), 0.0, 0.0),
        },
        _ => Driven::default(),
    };
    let led = body(0.7, o, DVec3::new(1.6, 0.0, 0.0), DVec3::ZERO, DVec3::Z);
    let mut leads = Body::prescribed(sphere(1.0, 1.0), 1.0, o);
    leads.centre = 0.1 * DVec3::Y;
    let law = PairLaw { thresholds: Thresholds { core_at: 0.6, ..LAW.thresholds }, core_width: 0.3, ..LAW };
    let pairs = vec![pair(0, 1, Phase::Merged, law)];
    let (error, ledger) = unexplained(Island::new(vec![leads, led], pairs, Field::default(), 1e-6), &path, 6.0);
    assert!(error < 1e-6, "{error:e} {ledger:?}");
    assert!(ledger.prescribed != 0.0);
}

/// In the middle of an encounter on a plane, the sum of the forces by cause is what accelerates vertices, centres and
/// frames (by finite differences of the run), and reactions equal actions to the last bit.
#[test]
fn observed_forces_are_those_that_move_the_bodies() {
    use crate::sim::Cause;
    let plane = Plane { normal: DVec3::Z, offset: -0.74, stiffness: 400.0, friction: 0.4, slip: 0.05 };
    let field = Field { uniform: falling(-2.0 * DVec3::Z), planes: vec![plane], ..Field::default() };
    let law = PairLaw { thresholds: Thresholds { core_at: 0.8, ..LAW.thresholds }, core_width: 0.3, ..LAW };
    let o = Oscillator { omega: 12.0, damping: 1.5 };
    let a = body(1.0, o, DVec3::new(-0.9, 0.1, 0.0), DVec3::new(1.2, 0.0, 0.0), DVec3::new(0.2, 0.0, 2.5));
    let b = body(0.8, o, DVec3::new(0.7, -0.1, 0.05), DVec3::new(-1.0, 0.0, 0.0), DVec3::ZERO);
    let pairs = vec![pair(0, 1, Phase::Merged, law)];
    let mut island = Island::new(vec![a, b], pairs, field, 1e-9);
    let mut report = Report::default();
    island.advance(0.2, &NoPaths, &mut report).expect("can be followed");

    let snapshot = island.snapshot();
    let forces: Vec<Forces> = (0..2)
        .map(|index| {
            let mut forces = Forces::default();
            snapshot.forces(index, std::iter::empty(), &mut forces);
            forces
        })
        .collect();
    let h = 1e-4;
    let mut after = island.clone();
    let mut at = |island: &mut Island, t: f64| {
        island.advance(t, &NoPaths, &mut report).expect("can be followed");
        let of = |body: &Body| (body.velocity, body.spin, body.velocities().collect::<Vec<_>>());
        island.bodies().iter().map(of).collect::<Vec<_>>()
    };
    let states =
        [0.2, 0.2 + h, 0.2 + 2.0 * h].map(|t| if t == 0.2 { at(&mut island.clone(), t) } else { at(&mut after, t) });
    // the derivative at the start, of second order
    let rate = |v: [DVec3; 3]| (-3.0 * v[0] + 4.0 * v[1] - v[2]) / (2.0 * h);
    for (index, forces) in forces.iter().enumerate() {
        let body = &island.bodies()[index];
        let of = |what: fn(&(DVec3, DVec3, Vec<DVec3>)) -> DVec3| std::array::from_fn(|k| what(&states[k][index]));
        let (force, torque) = (body.mass() * rate(of(|s| s.0)), rate(of(|s| s.1)));
        assert!(forces.force.distance(force) < 1e-4 * force.length(), "{} {force}", forces.force);
        assert!(forces.torque.distance(torque) < 1e-4 * force.length(), "{} {torque}", forces.torque);
        let net = &forces.by_cause[Cause::Net as usize];
        for i in 0..net.len() {
            let expected = rate(std::array::from_fn(|k| states[k][index].2[i]));
            assert!(
                net.get(i).distance(expected) < 2e-3 * expected.length().max(1.0),
                "{i}: {} {expected}",
                net.get(i)
            );
        }
        for cause in [Cause::Gravity, Cause::Plane, Cause::Reaction, Cause::Core] {
            assert!(!forces.by_cause[cause as usize].is_empty(), "{cause:?}");
        }
    }
    let pulls = [snapshot.pull(0, 1), snapshot.pull(1, 0)];
    let gravity = |i: usize| island.bodies()[i].mass() * -2.0 * DVec3::Z;
    for (i, forces) in forces.iter().enumerate() {
        let reaction = forces.by_cause[Cause::Reaction as usize].get(0);
        assert_eq!(reaction, -pulls[1 - i] / island.bodies()[i].mass());
        let of_plane = &forces.by_cause[Cause::Plane as usize];
        let plane: DVec3 = of_plane.iter().zip(island.bodies()[i].shape.masses()).map(|(f, &m)| m * f).sum();
        assert!((forces.force - (pulls[i] - pulls[1 - i] + plane + gravity(i))).length() < 1e-13);
    }
}
