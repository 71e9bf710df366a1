//! Each scheme against its explicit equations, its order of convergence, and the exact flow to 300 digits. For all
//! schemes, the number of threads, sleeping and observation change nothing.

use glam::{DVec3, dvec3};
use meldscope::model::{
    oscillator::{Oscillator, Propagator},
    phase::Phase,
};
use meldscope::scene::{Integrator, Path, Push, Response};
use meldscope::sim::{BodyForces, Event};
use meldscope::{Scene, World};
use proptest::{prelude::*, test_runner::RngSeed};

fn scene(text: &str) -> Scene {
    Scene::parse(text, "integrators.toml").unwrap_or_else(|error| panic!("{error}\n{text}"))
}

fn world(text: &str) -> World {
    World::new(scene(text)).expect("enough memory")
}

/// Displacement and velocity of every vertex of every body.
fn state(world: &World) -> Vec<[[f64; 3]; 2]> {
    let body = |b: usize| {
        let body = world.body(b);
        (0..body.vertex_count()).map(|v| [body.displacement(v), body.velocity(v)].map(|w| w.to_array())).collect()
    };
    (0..world.body_count()).flat_map(|b| -> Vec<_> { body(b) }).collect()
}

/// The bits of the state.
fn bits(world: &World) -> Vec<u64> {
    state(world).iter().flatten().flatten().map(|x| x.to_bits()).collect()
}

/// A push, and a force point's time, that begin and end at ends of steps cost no scheme its order.
#[test]
fn windows_at_ends_of_steps_keep_the_order() {
    const PUSH: &str = "[[push]]\nbody = 'a'\ndirection = [0, 1, 0]\nstrength = 40\nstart = 0.25\nduration = 0.5\n";
    const POINT: &str = "[[point]]\nname = 'p'\nradius = 1.2\nact = 'attract'\nalpha = 60\nstart = 0.25\nduration = 0.25\n\
                         motion = { fixed = [0.4, 0.3, 0] }\n";
    for motion in
        ["sine = { center = [0, 0, 0], amplitude = [0.1, 0, 0], frequency = 0.6 }", "free = { from = [0, 0, 0] }"]
    {
        for window in [PUSH, POINT] {
            let after = |integrator: Integrator, steps: u64, tolerance: f64| {
                let text = format!(
                    "dt = {:?}\nduration = 1\n[[body]]\nname = 'a'\nradius = 1\nshape = {{ sphere = {{ stacks = 4, slices = 6 }} }}\n\
                     motion = {{ {motion} }}\n{window}",
                    1.0 / steps as f64
                );
                let mut world = World::new(Scene { integrator, tolerance, ..scene(&text) }).expect("enough memory");
                world.run(steps).expect("it runs");
                world.body(0).positions().collect::<Vec<_>>()
            };
            let exact = after(Integrator::Exponential, 40, 1e-12);
            for (integrator, least) in [(Integrator::Verlet, 1.9), (Integrator::Rk4, 3.7)] {
                let error = |steps| {
                    let found = after(integrator, steps, 1e-6);
                    found.iter().zip(&exact).map(|(found, exact)| found.distance(*exact)).fold(0.0, f64::max)
                };
                let order = (error(40) / error(80)).log2();
                assert!(order >= least, "{integrator}, {motion}: order {order}");
            }
        }
    }
}

// ---------------------------------------------------------------------------------------------------------------------
// The schemes, written out per coordinate

type V = [f64; 3];

fn map(f: impl Fn(usize) -> f64) -> V {
    std::array::from_fn(f)
}

/// A pair that merges and splits; vertices of `a` are tracked. Δt is a power of two, so that k Δt is exact.
fn pair(integrator: Integrator) -> Scene {
    scene(&format!(
        r#"
dt = 0.015625
duration = 4.0
integrator = "{integrator}"
[material]
omega = 12.0
damping = 1.5
response = "rigid"
[influence]
scaling = "absolute"
alpha = 100.0
beta = 60.0
reach = 1.5
[[body]]
name = "a"
radius = 0.75
shape = {{ sphere = {{ stacks = 5, slices = 7 }} }}
motion = {{ fixed = [0.1, -0.2, 0.3] }}
[[body]]
name = "b"
radius = 1.25
motion = {{ sine = {{ center = [2.0, 0.3, 0.1], amplitude = [0.5, -0.1, 0.2], frequency = 0.4, phase = 1.0 }} }}
"#
    ))
}

/// (3.6)–(3.10), bit for bit. In displacement coordinates, x = r − c − l: r − c = l + x, and in (3.8) l − r* = −x*.
#[test]
fn thesis_matches_the_printed_equations_bit_by_bit() {
    let scene = pair(Integrator::Thesis);
    let (dt, alpha, beta): (f64, f64, f64) = (0.015625, 100.0, 60.0);
    let (w, k): (f64, f64) = (12.0, 1.5);
    let r_e = 1.5 * 1.25;
    let mut world = World::new(scene.clone()).expect("enough memory");
    let count = world.body(0).vertex_count();
    let l: Vec<V> = (0..count).map(|v| (world.body(0).rest(v)).to_array()).collect();
    let (mut x, mut u) = (vec![[0.0; 3]; count], vec![[0.0; 3]; count]);
    let (mut merged, mut reached) = (0, 0);
    for step in 0..world.scene().steps() {
        let t = step as f64 * dt;
        let c = (scene.bodies[1].path().unwrap().position(t) - scene.bodies[0].path().unwrap().position(t)).to_array();
        let s = if world.phase(0, 1) == Phase::Merged { alpha } else { -beta };
        merged += u64::from(s > 0.0);
        for v in 0..count {
            // (3.3) W = 1 − r/r_e for r ≤ r_e, else 0;  (3.4), (3.5) F = ±s (c − r) W
            let to_centre: V = map(|i| c[i] - (l[v][i] + x[v][i]));
            let r = (to_centre[0] * to_centre[0] + to_centre[1] * to_centre[1] + to_centre[2] * to_centre[2]).sqrt();
            let weight = if r / r_e >= 1.0 { 0.0 } else { 1.0 - r / r_e };
            reached += u64::from(weight > 0.0);
            let f: V = map(|i| to_centre[i] * (s * weight));

            let u_star: V = map(|i| u[v][i] + f[i] * dt); // (3.6)  u* = u + F Δt
            let x_star: V = map(|i| x[v][i] + u_star[i] * dt); // (3.7)  r* = r + u* Δt
            let t: V = map(|i| w * w * -x_star[i] - 2.0 * k * u_star[i]); // (3.8)  T = ω²(l − r*) − 2κu*
            u[v] = map(|i| u_star[i] + t[i] * dt); // (3.9)  u⁺ = u* + T Δt
            x[v] = map(|i| x_star[i] + u[v][i] * dt); // (3.10) r⁺ = r* + u⁺ Δt
        }
        let _ = world.step();
        let body = world.body(0);
        for v in 0..count {
            assert_eq!(body.displacement(v).to_array(), x[v], "step {step}, vertex {v}");
            assert_eq!(body.velocity(v).to_array(), u[v], "step {step}, vertex {v}");
        }
    }
    assert!(merged > 50 && merged < 200 && reached > 1000, "{merged} {reached}");
}

/// The thesis's scheme converges to x′ = 2u, u′ = F − ω²x − 2κu, which is x″ = 2F − 2ω²x − 2κx′.
#[test]
fn thesis_converges_to_an_oscillator_too_fast_by_root_two() {
    let (omega, kappa, dt0) = (12.0f64, 1.5f64, 1.0 / 64.0);
    let errors = [1.0, 2.0, 4.0, 8.0].map(|divided| {
        // one impulse to a velocity of 1/s, like a push over one step, then free motion
        let dt = dt0 / divided;
        let mut world = pushed_sphere(Integrator::Thesis, omega, kappa, dt, 3.0, dt);
        let nu = (2.0 * omega * omega - kappa * kappa).sqrt();
        let mut worst = 0.0;
        for _ in 0..world.scene().steps() {
            let _ = world.step();
            let t = world.time();
            let expected = 2.0 * (-kappa * t).exp() * (nu * t).sin() / nu;
            worst = f64::max(worst, (world.body(0).displacement(FACING).x - expected).abs() * omega);
        }
        worst
    });
    // Measured: 0.0885, 0.0398, 0.0188, 0.0091, of an amplitude of √2.
    assert!(errors[3] <= 0.01 && errors.windows(2).all(|e| e[1] <= 0.5 * e[0]), "{errors:?}");
}

/// The vertex of [`pushed_sphere`] that faces the push.
const FACING: usize = 3;

/// A still sphere pushed along +x in the first step so that vertex [`FACING`] gets a velocity of 1 scene unit/s.
fn pushed_sphere(integrator: Integrator, omega: f64, damping: f64, dt: f64, duration: f64, push: f64) -> World {
    let mut scene = scene(
        "duration = 1\n[[body]]\nname = \"a\"\nradius = 1\nshape = { sphere = { stacks = 2, slices = 4 } }\n\
         motion = { fixed = [0, 0, 0] }\n",
    );
    (scene.integrator, scene.dt, scene.duration) = (integrator, dt, duration);
    (scene.bodies[0].material.omega, scene.bodies[0].material.damping) = (omega, damping);
    scene.pushes.push(Push { body: 0, direction: DVec3::X, strength: 1.0 / push, start: 0.0, duration: push });
    World::new(scene).expect("enough memory")
}

/// The force on a vertex of body 0 in [`busy_pair`], implemented independently.
struct Busy {
    scene: Scene,
    omega: f64,
    kappa: f64,
}

impl Busy {
    /// F of the vertex with unit rest position `unit` and displacement `x` at time `t`, with strength `s`.
    fn force(&self, t: f64, s: f64, unit: V, x: V) -> V {
        let at = |i: usize| self.scene.bodies[i].path().unwrap().at(t);
        let (own, other) = (at(0), at(1));
        let radius = self.scene.bodies[0].radius;
        let r: V = map(|i| own.position[i] + radius * unit[i] + x[i]);
        let d: V = map(|i| other.position[i] - r[i]);
        let z = d[0].hypot(d[1]).hypot(d[2]) / (self.scene.bodies[1].reach * self.scene.bodies[1].radius);
        let weight = if z < 1.0 { 1.0 - z } else { 0.0 };
        let mut f: V = map(|i| s * weight * d[i] - own.acceleration[i] - 2.0 * self.kappa * own.velocity[i]);
        for push in &self.scene.pushes {
            if push.start <= t && t < push.start + push.duration {
                let n = push.direction.to_array();
                let facing = f64::max(0.0, -(unit[0] * n[0] + unit[1] * n[1] + unit[2] * n[2]));
                f = map(|i| f[i] + push.strength * facing * n[i]);
            }
        }
        f
    }

    /// x″ = F − ω²x − 2κu.
    fn acceleration(&self, t: f64, s: f64, unit: V, x: V, u: V) -> V {
        let f = self.force(t, s, unit, x);
        map(|i| f[i] - self.omega * self.omega * x[i] - 2.0 * self.kappa * u[i])
    }

    /// One step of a scheme from t to t + h, as in textbooks.
    fn step(&self, integrator: Integrator, t: f64, h: f64, s: f64, unit: V, (x, u): (V, V)) -> (V, V) {
        let (w2, k2) = (self.omega * self.omega, 2.0 * self.kappa);
        match integrator {
            Integrator::Thesis | Integrator::Mps => {
                let f = self.force(t, s, unit, x);
                let predicted: V = map(|i| u[i] + h * f[i]);
                let moved: V = map(|i| x[i] + h * predicted[i]);
                let corrected: V = map(|i| predicted[i] + h * (-w2 * moved[i] - k2 * predicted[i]));
                let from = if integrator == Integrator::Mps { x } else { moved };
                (map(|i| from[i] + h * corrected[i]), corrected)
            }
            Integrator::Euler => {
                let a = self.acceleration(t, s, unit, x, u);
                let next: V = map(|i| u[i] + h * a[i]);
                (map(|i| x[i] + h * next[i]), next)
            }
            Integrator::Verlet => {
                // x⁺ = x + hu + h²/2 a;  u⁺ = u + h/2 (a + a⁺), where a⁺ contains u⁺: iterate to a fixed point
                let a = self.acceleration(t, s, unit, x, u);
                let moved: V = map(|i| x[i] + h * u[i] + 0.5 * h * h * a[i]);
                let mut next = u;
                for _ in 0..100 {
                    let b = self.acceleration(t + h, s, unit, moved, next);
                    next = map(|i| u[i] + 0.5 * h * (a[i] + b[i]));
                }
                (moved, next)
            }
            Integrator::Rk4 => {
                let slope = |t: f64, y: (V, V)| (y.1, self.acceleration(t, s, unit, y.0, y.1));
                let along = |k: (V, V), h: f64| -> (V, V) { (map(|i| x[i] + h * k.0[i]), map(|i| u[i] + h * k.1[i])) };
                let k1 = slope(t, (x, u));
                let k2 = slope(t + h / 2.0, along(k1, h / 2.0));
                let k3 = slope(t + h / 2.0, along(k2, h / 2.0));
                let k4 = slope(t + h, along(k3, h));
                let mean = |a: V, b: V, c: V, d: V| -> V { map(|i| (a[i] + 2.0 * b[i] + 2.0 * c[i] + d[i]) / 6.0) };
                along((mean(k1.0, k2.0, k3.0, k4.0), mean(k1.1, k2.1, k3.1, k4.1)), h)
            }
            Integrator::Exponential => unreachable!("the exact flow has tests of its own"),
        }
    }
}

/// [`pair`], with its first body moved, dragged and pushed.
fn busy_pair(integrator: Integrator) -> Scene {
    let mut scene = pair(integrator);
    scene.duration = 2.0;
    scene.bodies[0].material.response = Response::World;
    scene.bodies[0].motion =
        Path::Sine { center: dvec3(0.1, -0.2, 0.3), amplitude: dvec3(0.05, 0.1, -0.1), frequency: 0.7, phase: 0.2 }
            .into();
    let push = |direction: DVec3, start, duration| Push {
        body: 0,
        direction: direction.normalize(),
        strength: 20.0,
        start,
        duration,
    };
    scene.pushes = vec![push(dvec3(1.0, 0.5, 0.0), 0.1, 0.33), push(dvec3(0.0, -0.5, 1.0), 0.3, 0.5)];
    scene
}

#[test]
fn the_explicit_schemes_match_the_textbooks() {
    for integrator in Integrator::ALL.into_iter().filter(|&i| i != Integrator::Exponential) {
        let scene = busy_pair(integrator);
        let busy = Busy { scene: scene.clone(), omega: 12.0, kappa: 1.5 };
        let mut world = World::new(scene).expect("enough memory");
        let units: Vec<V> = (0..world.body(0).vertex_count()).map(|v| world.body(0).direction(v).to_array()).collect();
        let mut states = vec![([0.0; 3], [0.0; 3]); units.len()];
        let (mut worst, mut largest) = (0.0, 0.0);
        for step in 0..world.scene().steps() {
            let s = if world.phase(0, 1) == Phase::Merged { 100.0 } else { -60.0 };
            for (state, unit) in states.iter_mut().zip(&units) {
                *state = busy.step(integrator, step as f64 / 64.0, 1.0 / 64.0, s, *unit, *state);
            }
            let _ = world.step();
            for (v, (x, u)) in states.iter().enumerate() {
                let (dx, du) =
                    (world.body(0).displacement(v) - DVec3::from(*x), world.body(0).velocity(v) - DVec3::from(*u));
                assert!(dx.is_finite() && du.is_finite());
                worst = f64::max(worst, f64::max(dx.length(), du.length() / 12.0));
                largest = f64::max(largest, DVec3::from(*x).length());
            }
        }
        // Measured: 3.3e-16.
        assert!(worst <= 5e-16 && largest > 0.4, "{integrator}: {worst:e}, {largest}");
    }
}

/// x and x′ at t of the force-free oscillator from (x0, u0), by the textbook formulas.
fn free(omega: f64, kappa: f64, t: f64, x0: f64, u0: f64) -> (f64, f64) {
    if kappa < omega {
        let nu = ((omega - kappa) * (omega + kappa)).sqrt();
        let ((sin, cos), decay) = ((nu * t).sin_cos(), (-kappa * t).exp());
        let b = (u0 + kappa * x0) / nu;
        (decay * (x0 * cos + b * sin), decay * (u0 * cos - (kappa * b + nu * x0) * sin))
    } else if kappa == omega {
        let (b, decay) = (u0 + kappa * x0, (-kappa * t).exp());
        (decay * (x0 + b * t), decay * (u0 - kappa * b * t))
    } else if kappa < 1.1 * omega {
        // the two modes nearly coincide, so their difference would cancel
        let mu = ((kappa - omega) * (kappa + omega)).sqrt();
        let ((sinh, cosh), decay) = (((mu * t).sinh(), (mu * t).cosh()), (-kappa * t).exp());
        let b = (u0 + kappa * x0) / mu;
        (decay * (x0 * cosh + b * sinh), decay * (u0 * cosh - (kappa * b - mu * x0) * sinh))
    } else {
        // two modes: x = a e^(−slow t) + b e^(−fast t)
        let mu = ((kappa - omega) * (kappa + omega)).sqrt();
        let (fast, slow) = (kappa + mu, omega * (omega / (kappa + mu)));
        let (a, b) = ((u0 + fast * x0) / (2.0 * mu), -(u0 + slow * x0) / (2.0 * mu));
        let (p, q) = (a * (-slow * t).exp(), b * (-fast * t).exp());
        (p + q, -slow * p - fast * q)
    }
}

// ---------------------------------------------------------------------------------------------------------------------
// Orders on a smooth problem

#[test]
fn every_scheme_has_its_order_on_a_smooth_problem() {
    let smooth = |integrator: Integrator, divided: u64| {
        let mut world = world(&format!(
            r#"
dt = {}
tolerance = 1.0 # steps of dt
duration = 1.5
integrator = "{integrator}"
[influence]
weight = "wendland"
[[body]]
name = "a"
radius = 1.0
shape = {{ sphere = {{ stacks = 6, slices = 8 }} }}
motion = {{ fixed = [0, 0, 0] }}
[[body]]
name = "b"
radius = 0.9
shape = {{ sphere = {{ stacks = 6, slices = 8 }} }}
motion = {{ fixed = [1.3, 0.3, 0.2] }}
"#,
            1.0 / (64 * divided) as f64
        ));
        let mut states = vec![];
        for step in 1..=world.scene().steps() {
            assert!(world.step().events.is_empty());
            if step % divided == 0 {
                states.push(state(&world));
            }
        }
        states
    };
    let exact = smooth(Integrator::Rk4, 64);
    // Errors measured with steps of dt and dt/4, in radii, and the expected order. Measured orders: 0.97, 1.01, 2.00,
    // 4.01, and 3.2 for the exponential scheme, whose second error is that of the reference solution.
    let measured = [
        (Integrator::Mps, [4.184e-2, 1.085e-2], 0.95),
        (Integrator::Euler, [1.289e-2, 3.161e-3], 0.99),
        (Integrator::Verlet, [7.459e-4, 4.643e-5], 1.98),
        (Integrator::Rk4, [4.649e-6, 1.801e-8], 3.98),
        (Integrator::Exponential, [2.18e-11, 2.71e-13], 1.98),
    ];
    for (integrator, [coarse, fine], order) in measured {
        let errors = [1, 4].map(|divided| {
            let states = smooth(integrator, divided);
            assert_eq!(states.len(), exact.len());
            let both = states.iter().flatten().zip(exact.iter().flatten());
            both.map(|(a, b)| DVec3::from(a[0]).distance(DVec3::from(b[0]))).fold(0.0, f64::max)
        });
        assert!(errors[0] <= 1.05 * coarse && errors[1] <= 1.05 * fine, "{integrator}: {errors:?}");
        let seen = (errors[0] / errors[1]).log2() / 2.0;
        assert!(seen >= order, "{integrator}: order {seen} of {errors:?}");
    }
}

// ---------------------------------------------------------------------------------------------------------------------
// The exact flow

/// A vertex displaced by a push and released follows the formula, through critical damping and far beyond.
#[test]
fn exponential_is_exact_for_a_released_body() {
    let omega = 12.0;
    // Measured after 1000 steps, in radii: 4.3e-14 undamped, 200 rad on; 2.4e-15 with light damping; 4.4e-16 near
    // critical damping; 1.8e-14 where heavy damping leaves a residual displacement.
    for (ratio, bound) in [
        (0.0, 6e-14),
        (0.1, 3.6e-15),
        (1.0 - 1e-9, 6.6e-16),
        (1.0, 6.6e-16),
        (1.0 + 1e-9, 6.6e-16),
        (3.0, 6.6e-16),
        (100.0, 2.7e-14),
        (1e6, 2.7e-14),
    ] {
        let kappa = ratio * omega;
        let mut world = pushed_sphere(Integrator::Exponential, omega, kappa, 1.0 / 60.0, 1001.0 / 60.0, 1.0 / 60.0);
        // a displacement of about the radius at any damping
        world = {
            let mut scene = world.scene().clone();
            scene.pushes[0].strength *= f64::max(omega, kappa);
            World::new(scene).expect("enough memory")
        };
        let _ = world.step();
        let at = |world: &World| (world.body(0).displacement(FACING).x, world.body(0).velocity(FACING).x);
        let (t0, (x0, u0)) = (world.time(), at(&world));
        assert!((0.05..2.0).contains(&x0), "{ratio}: {x0}");
        let mut worst: f64 = 0.0;
        for _ in 0..1000 {
            let _ = world.step();
            let (x, u) = free(omega, kappa, world.time() - t0, x0, u0);
            let error = ((at(&world).0 - x).abs(), (at(&world).1 - u).abs() / f64::max(omega, kappa));
            assert!(at(&world).0.is_finite() && at(&world).1.is_finite());
            worst = worst.max(error.0).max(error.1);
        }
        assert!(worst <= bound, "{ratio}: {worst:e}");
    }
}

/// However stiff the spring, a vertex is never farther from rest than its static displacement with overshoot.
#[test]
fn exponential_is_stable_when_stiff() {
    let reference = scene(include_str!("../reference/two.toml"));
    for phase in [1.0, 10.0, 100.0, 1e3, 1e4] {
        // Measured: 2.099, 1.578, and from critical damping on the static displacement. Undamped, a jump from repulsion
        // to attraction overshoots by both.
        for (ratio, bound) in [(0.0, 2.2), (0.1, 1.7), (1.0, 1.0), (1e3, 1.0)] {
            let mut scene = reference.clone();
            let omega = phase / scene.dt;
            for body in &mut scene.bodies {
                (body.material.omega, body.material.damping) = (omega, ratio * omega);
            }
            // α r_e/4 is the maximum pull of the other sphere
            let held = 100.0 * std::f64::consts::SQRT_2 / 4.0 / (omega * omega);
            let mut world = World::new(scene).expect("enough memory");
            let mut largest = 0.0;
            for _ in 0..world.scene().steps() {
                let _ = world.step();
                for [x, u] in state(&world) {
                    assert!(DVec3::from(x).is_finite() && DVec3::from(u).is_finite());
                    largest = f64::max(largest, DVec3::from(x).length() / held);
                }
            }
            assert!(0.0 < largest && largest <= bound, "ωΔt = {phase}, κ/ω = {ratio}: {largest}");
        }
    }
}

/// The rows of a table of numbers with a header line.
fn table(text: &str) -> Vec<Vec<f64>> {
    let row = |line: &str| line.split(',').map(|field| field.parse().expect("a number")).collect();
    text.lines().skip(1).map(row).collect()
}

/// Against values with 300 digits from `tests/reference/propagator.py`.
#[test]
fn the_propagator_is_accurate() {
    let rows = table(include_str!("../reference/propagator.csv"));
    assert!(rows.len() > 200);
    // In units of 2.2e-16 times the reference magnitude of the error, times 1 and the exponent of the flow. Measured:
    // 1.0, 0.9, 1.2, 18.9; 3.8, 3.8, 18.1, 114.1; 0.9, 4.0, 3.7, 18.4: the largest, of x₃, is 2.5e-14.
    const BOUNDS: [f64; 12] = [1.5, 1.3, 1.8, 28.0, 5.5, 5.5, 27.0, 170.0, 1.3, 6.0, 5.5, 27.0];
    for row in rows {
        let [omega, kappa, h]: [f64; 3] = row[..3].try_into().expect("three");
        let found = fields(&Oscillator { omega, damping: kappa }.propagator(h));
        let expected: [f64; 12] = row[3..].try_into().expect("twelve");
        let [xx, xu, _, uu, ..] = expected;
        // The reference magnitude of an error: the number itself; for oscillations, and through critical damping, the
        // largest value during an oscillation.
        let envelope = xx.abs().max(uu.abs()).max(omega * xu.abs());
        let mut sizes = expected.map(f64::abs);
        if kappa < 1.1 * omega {
            let oscillating = [envelope, envelope / omega, envelope * omega, envelope];
            sizes[..4].copy_from_slice(&oscillating);
            sizes[4] = sizes[4].max(f64::min(0.1 * h * h, 1.0 / (omega * omega)));
            sizes[8] = envelope / omega;
            sizes[9] = sizes[4] / h;
        }
        // The exponents of the modes, which are rounded before exponentiation.
        let mu = ((kappa - omega) * (kappa + omega)).max(0.0).sqrt();
        let exponent = if kappa < omega {
            omega * h
        } else if omega > 0.0 {
            omega * (omega / (kappa + mu)) * h
        } else {
            0.0
        };
        for i in 0..12 {
            if sizes[i] < 1e-290 {
                assert!(found[i].abs() < 1e-290, "{row:?}: {found:?}");
                continue;
            }
            let error = (found[i] - expected[i]).abs() / sizes[i] / f64::EPSILON / (1.0 + exponent);
            assert!(error <= BOUNDS[i], "{row:?}, field {i}: {:e}, {error} roundings", found[i]);
        }
    }
}

/// xx, xu, ux, uu, x, u.
fn fields(p: &Propagator) -> [f64; 12] {
    [p.xx, p.xu, p.ux, p.uu, p.x[0], p.x[1], p.x[2], p.x[3], p.u[0], p.u[1], p.u[2], p.u[3]]
}

proptest! {
    // The same cases in each run: the bounds are statistical, and one run in some hundreds would exceed them.
    #![proptest_config(ProptestConfig {
        cases: 2000,
        failure_persistence: None,
        rng_seed: RngSeed::Fixed(1),
        ..ProptestConfig::default()
    })]

    /// Two half steps equal one step, for the flow and for the effect of constant and rising forces.
    #[test]
    fn two_half_steps_equal_one_step(
        log_phase in -4.0..3.0,
        ratio in prop_oneof![Just(0.0), 0.0..1.0, 0.999_999..1.000_001, 1.0..3.0, 3.0..1e4],
        h in 1e-3..1e3,
    ) {
        let omega = f64::powf(10.0, log_phase) / h;
        let oscillator = Oscillator { omega, damping: ratio * omega };
        let half = oscillator.propagator(h / 2.0);
        let Propagator { xx, xu, ux, uu, x, u } = half;
        // With θ from 0 to 1 in each half, a force (s/h)ᵏ is (θ/2)ᵏ, then (1/2 + θ/2)ᵏ = Σ_j (k over j) θʲ/2ᵏ.
        let binomials = [[1.0, 0.0, 0.0, 0.0], [1.0, 1.0, 0.0, 0.0], [1.0, 2.0, 1.0, 0.0], [1.0, 3.0, 3.0, 1.0]];
        let of_two_x = |k: usize| {
            let later: f64 = (0..4).map(|j| binomials[k][j] * x[j]).sum();
            (xx * x[k] + xu * u[k] + later) / f64::from(1 << k)
        };
        let of_two_u = |k: usize| {
            let later: f64 = (0..4).map(|j| binomials[k][j] * u[j]).sum();
            (ux * x[k] + uu * u[k] + later) / f64::from(1 << k)
        };
        let of_two = [
            xx * xx + xu * ux,
            xx * xu + xu * uu,
            ux * xx + uu * ux,
            ux * xu + uu * uu,
            of_two_x(0), of_two_x(1), of_two_x(2), of_two_x(3),
            of_two_u(0), of_two_u(1), of_two_u(2), of_two_u(3),
        ];
        let of_one = fields(&oscillator.propagator(h));
        // the largest values of x and u
        let kappa = oscillator.damping;
        let u = h.min(1.0 / omega).min(1.0 / kappa);
        let x = (h * h).min(1.0 / (omega * omega)).min(h / kappa);
        let sizes = [1.0, u, omega * omega * u, 1.0, x, x, x, x, u, u, u, u];
        // Largest values measured over 100,000 cases: 3.0, 2.9, 3.1, 2.5; 2.0, 1.3, 3.7, 14.7; 2.8, 1.7, 2.5, 10.9.
        // Rare cases exceed them: 5.5 was seen. The cases are random, so the bounds are about twice as large.
        let bounds = [6.5, 6.5, 6.5, 5.5, 4.5, 3.0, 8.0, 30.0, 6.5, 4.0, 5.5, 22.0];
        for i in 0..12 {
            let error = (of_two[i] - of_one[i]).abs() / sizes[i] / f64::EPSILON / (1.0 + omega * h);
            prop_assert!(error <= bounds[i], "field {}: {:e} {:e}, {} roundings", i, of_two[i], of_one[i], error);
        }
    }
}

// ---------------------------------------------------------------------------------------------------------------------
// Threads, sleeping and observation change nothing

/// A carpet of touching bodies, some of them moving, with more vertices than one thread processes.
fn carpet() -> Scene {
    let mut text = String::from("duration = 0.5\n[influence]\ncore_at = 0.5\n");
    for i in 0..7 {
        for j in 0..6 {
            let (x, y) = (1.9 * f64::from(i), 1.9 * f64::from(j));
            let motion = match (i + j) % 3 {
                0 => format!("{{ fixed = [{x}, {y}, 0] }}"),
                1 => format!(
                    "{{ sine = {{ center = [{x}, {y}, 0], amplitude = [0.3, 0.2, 0.5], frequency = 0.8, phase = {i} }} }}"
                ),
                _ => format!(
                    "{{ line = {{ from = [{x}, {y}, 0], velocity = [{}, 0.4, 0.1] }} }}",
                    0.3 * f64::from(j - 2)
                ),
            };
            text +=
                &format!("[[body]]\nname = \"b{i}-{j}\"\nradius = {}\nmotion = {motion}\n", 1.0 + 0.02 * f64::from(i));
        }
    }
    scene(&text)
}

/// An explicit scheme evaluates forces at the ends of steps: what begins to act at one acts in the step before, whether or not
/// the body was at rest, and is no divergence.
#[test]
fn a_push_that_begins_at_the_end_of_a_step_acts_alike_on_all_bodies() {
    let body = "[[body]]\nname = \"a\"\nradius = 1.0\nshape = { sphere = { stacks = 3, slices = 4 } }\nmotion = { fixed = [0, 0, 0] }\n";
    let push = |strength: &str, start: f64| {
        format!(
            "[[push]]\nbody = \"a\"\ndirection = [0, 0, -1]\nstrength = {strength}\nstart = {start}\nduration = 0.1\n"
        )
    };
    let point = "[[point]]\nname = \"p\"\nmotion = { fixed = [0, 0, 1.5] }\nradius = 1.0\nact = \"attract\"\nalpha = 400.0\nstart = 0.24\n";
    for integrator in ["euler", "verlet", "rk4"] {
        let end = |more: &str| {
            let mut world = world(&format!("dt = 0.02\nduration = 1.0\nintegrator = \"{integrator}\"\n{body}{more}"));
            world.run(50).expect("no divergence");
            (0..world.body(0).vertex_count()).map(|i| world.body(0).displacement(i)).collect::<Vec<_>>()
        };
        let plane = "[[plane]]\nnormal = [0, 0, 1]\noffset = -99.0\n";
        for acts in [push("60.0", 0.24), point.to_owned()] {
            let alone = end(&acts);
            assert!(alone.iter().any(|x| x.length() > 1e-3), "{integrator}");
            // a body that is awake already, and the other solver
            for other in [end(&format!("{acts}{}", push("1e-9", 0.1))), end(&format!("{acts}{plane}"))] {
                let apart = alone.iter().zip(&other).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
                assert!(apart < 2e-11, "{integrator}: {apart} {acts}");
            }
        }
    }
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    for integrator in [Integrator::Exponential, Integrator::Rk4] {
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            pool.install(|| {
                assert_eq!(rayon::current_num_threads(), threads);
                let mut world = World::new(Scene { integrator, ..carpet() }).expect("enough memory");
                let mut events: Vec<Event> = vec![];
                let mut counts = vec![];
                for _ in 0..world.scene().steps() {
                    let report = world.step();
                    events.extend(&report.events);
                    counts.push((report.substeps, report.sleeping_bodies));
                }
                let awake: usize =
                    world.bodies().filter(|body| !body.is_at_rest()).map(|body| body.vertex_count()).sum();
                assert!(awake > 8192 && events.len() >= 5, "{awake} vertices, {} events", events.len());
                (bits(&world), events, counts, world.energy())
            })
        };
        let one = run(1);
        for threads in [2, 5] {
            let more = run(threads);
            assert!(one == more, "{integrator}, {threads} threads");
        }
    }
}

#[test]
fn a_body_out_of_reach_sleeps_and_stays_exactly_at_rest() {
    for integrator in Integrator::ALL {
        let mut world = world(&format!(
            r#"
duration = 3.0
integrator = "{integrator}"
[[body]]
name = "a"
radius = 1.0
motion = {{ fixed = [0, 0, 0] }}
[[body]]
name = "comes"
radius = 0.5
motion = {{ line = {{ from = [3, 0, 0], velocity = [-1, 0, 0] }} }}
[[body]]
name = "passes"
radius = 0.5
motion = {{ line = {{ from = [-3, 2.42, 0], velocity = [2, 0, 0] }} }}
[[body]]
name = "never"
radius = 1.0
motion = {{ fixed = [0, -7, 0] }}
[[body]]
name = "later"
radius = 1.0
motion = {{ fixed = [0, 0, 40] }}
[[push]]
body = "later"
direction = [0, 0, 1]
strength = 10.0
start = 1.01
duration = 0.1
"#
        ));
        // `comes` is reached, or reaches, from 3 − t = 1 + √2/2 or √2 + 1/2 on; `passes` stays 2.42 > 1/2 + √2 away
        // from a
        let reached = 3.0 - (std::f64::consts::SQRT_2 + 0.5);
        for _ in 0..world.scene().steps() {
            let before = world.time();
            let sleeping = world.step().sleeping_bodies;
            let now = world.time();
            let resting: Vec<bool> = world.bodies().map(|body| body.is_at_rest()).collect();
            let expected_sleepers = resting.iter().filter(|&&rests| rests).count() as u64;
            // `exponential` does not compute `later` either once its push is over: it follows the exact flow
            let left_alone = u64::from(integrator == Integrator::Exponential && before > 1.11);
            assert_eq!(sleeping, expected_sleepers + left_alone, "{integrator} at {now}");
            for body in world.bodies().filter(|body| body.is_at_rest()) {
                assert!(body.max_displacement() == 0.0);
                assert!(
                    (0..body.vertex_count())
                        .all(|v| body.displacement(v) == DVec3::ZERO && body.velocity(v) == DVec3::ZERO)
                );
            }
            assert!(resting[2] && resting[3], "{integrator} at {now}");
            // a body wakes in the step in which something acts on it
            if now < reached {
                assert!(resting[0] && resting[1], "{integrator} at {now}");
            }
            if before > reached + world.scene().dt {
                assert!(!resting[1], "{integrator} at {now}");
            }
            if now < 1.01 {
                assert!(resting[4], "{integrator} at {now}");
            }
            if before > 1.01 {
                assert!(!resting[4], "{integrator} at {now}");
            }
        }
        assert!(!world.body(0).is_at_rest());
    }
}

#[test]
fn observation_changes_no_bit() {
    for integrator in Integrator::ALL {
        let scene = || Scene { integrator, ..scene(include_str!("../reference/three.toml")) };
        let (mut seen, mut unseen) =
            (World::new(scene()).expect("enough memory"), World::new(scene()).expect("enough memory"));
        let mut forces = BodyForces::default();
        for step in 0..seen.scene().steps() {
            let looks = if step % 3 == 0 { 2 } else { 1 };
            for _ in 0..looks {
                let energy = seen.energy();
                let pairs: Vec<_> = seen.pairs().collect();
                assert!(energy.total().is_finite() && pairs.len() <= 3);
                for b in 0..seen.body_count() {
                    seen.forces(b, &mut forces);
                    assert!(seen.body(b).positions().all(|position| position.is_finite()));
                    let _ = (seen.surroundings(b), seen.phase(0, b), seen.body(b).max_displacement());
                }
            }
            let _ = seen.step();
            let _ = unseen.step();
            assert_eq!(seen.report().events, unseen.report().events);
            assert!(bits(&seen) == bits(&unseen), "{integrator}, step {step}");
        }
        assert_eq!(seen.energy(), unseen.energy());
    }
}
