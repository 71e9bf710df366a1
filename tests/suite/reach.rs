//! `reach` of a body: influence spheres of different sizes in one scene.

use std::fmt::Write;

use glam::DVec3;
use meldscope::{
    Scene, World,
    observe::{Experiment as _, StepSummary},
    scene::{Integrator, Model, Motion, Path, builtin},
};

/// Pseudo-random numbers (xorshift64*).
struct Random(u64);

impl Random {
    fn between(&mut self, low: f64, high: f64) -> f64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        low + (high - low) * (self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 11) as f64 / (1u64 << 53) as f64
    }
}

fn scene(text: &str) -> Scene {
    Scene::parse(text, "reach.toml").unwrap_or_else(|error| panic!("{error}\n{text}"))
}

fn run(scene: &Scene) -> World {
    let mut world = World::new(scene.clone()).expect("enough memory");
    for _ in 0..scene.steps() {
        assert_eq!(world.step().failure, None);
    }
    world
}

/// Bodies of random sizes and reaches on lines through each other's spheres, or thrown; their phases do not change.
fn random_scene(random: &mut Random, are_free: bool, is_merged: bool) -> String {
    let mut text = format!(
        "dt = 0.02\nduration = 0.6\n[influence]\nalpha = 40.0\nbeta = 50.0\nreach = {:?}\ncore_at = 0.0\n",
        random.between(1.1, 1.8)
    );
    text += if is_merged { "merge_at = 50.0\nsplit_at = 50.0\n" } else { "merge_at = 1e-6\nsplit_at = 1e-6\n" };
    for k in 0..3 {
        let radius = random.between(0.6, 1.3);
        let angle = std::f64::consts::TAU * (f64::from(k) + random.between(-0.1, 0.1)) / 3.0;
        let at = 1.5 * DVec3::new(angle.cos(), angle.sin(), random.between(-0.2, 0.2));
        let [at, velocity] = [at, -random.between(0.2, 0.8) * at].map(|vector| vector.to_array());
        let motion = match are_free {
            true => format!("free = {{ from = {at:?}, velocity = {velocity:?}, rotation = \"fixed\" }}"),
            false => format!("line = {{ from = {at:?}, velocity = {velocity:?} }}"),
        };
        let _ = write!(text, "[[body]]\nname = \"b{k}\"\nradius = {radius:?}\n");
        if k > 0 {
            let _ = writeln!(text, "reach = {:?}", random.between(0.8, 2.2));
        }
        let _ = write!(text, "shape = {{ sphere = {{ stacks = 4, slices = 5 }} }}\nmotion = {{ {motion} }}\n");
    }
    text
}

/// The equations of motion as they are written, for bodies that do not rotate, by classical Runge-Kutta with short steps.
struct ByHand<'a> {
    scene: &'a Scene,
    /// +α or −β [1/s²].
    strength: f64,
    /// Body, rest position and mass of every vertex.
    vertices: Vec<(usize, DVec3, f64)>,
}

impl ByHand<'_> {
    fn of(scene: &Scene, is_merged: bool) -> ByHand<'_> {
        let mut vertices = Vec::new();
        for (index, body) in scene.bodies.iter().enumerate() {
            let mesh = body.shape.mesh();
            let rest = mesh.positions();
            vertices.extend((0..rest.len()).map(|i| (index, body.radius * rest.get(i), body.mass * mesh.shares()[i])));
        }
        let strength = if is_merged { scene.influence.alpha } else { -scene.influence.beta };
        ByHand { scene, strength, vertices }
    }

    fn free(&self) -> bool {
        matches!(self.scene.bodies[0].motion, Motion::Free(_))
    }

    /// Position and velocity of a body's centre.
    fn centre(&self, body: usize, t: f64, state: &[[DVec3; 2]]) -> [DVec3; 2] {
        match &self.scene.bodies[body].motion {
            Motion::Prescribed(Path::Line { from, velocity }) => [*from + t * *velocity, *velocity],
            Motion::Prescribed(_) => panic!("bodies are on lines"),
            Motion::Free(_) => {
                let own = self.vertices.iter().zip(state).filter(|((of, ..), _)| *of == body);
                let sum =
                    own.fold([DVec3::ZERO; 2], |[r, v], ((.., mass), now)| [r + *mass * now[0], v + *mass * now[1]]);
                sum.map(|sum| sum / self.scene.bodies[body].mass)
            }
        }
    }

    /// The derivatives of position and velocity of each vertex.
    fn slope(&self, t: f64, state: &[[DVec3; 2]]) -> Vec<[DVec3; 2]> {
        let bodies = &self.scene.bodies;
        let centres: Vec<_> = (0..bodies.len()).map(|body| self.centre(body, t, state)).collect();
        let mut reactions = vec![DVec3::ZERO; bodies.len()];
        let mut accelerations = Vec::new();
        for (&(of, rest, mass), &[r, v]) in self.vertices.iter().zip(state) {
            let (body, [centre, velocity]) = (&bodies[of], centres[of]);
            let (omega, damping) = (body.material.omega, body.material.damping);
            let mut a = -omega * omega * (r - centre - rest) - 2.0 * damping * (v - velocity);
            for (j, source) in bodies.iter().enumerate().filter(|(j, _)| *j != of) {
                let scale = f64::min(1.0, body.radius / source.radius);
                let z = centres[j][0].distance(r) / (source.reach * source.radius);
                let pull = scale * self.strength * (centres[j][0] - r) * f64::max(0.0, 1.0 - z);
                a += pull;
                reactions[j] -= mass * pull;
            }
            accelerations.push([v, a]);
        }
        if self.free() {
            for ((of, ..), [_, a]) in self.vertices.iter().zip(&mut accelerations) {
                *a += reactions[*of] / bodies[*of].mass;
            }
        }
        accelerations
    }

    /// World positions of all vertices at the end.
    fn run(&self) -> Vec<DVec3> {
        const STEPS: u32 = 3000;
        let h = self.scene.duration / f64::from(STEPS);
        let start = |&(body, rest, _): &(usize, DVec3, f64)| match &self.scene.bodies[body].motion {
            Motion::Free(free) => [free.from + rest, free.velocity],
            Motion::Prescribed(_) => {
                let [centre, velocity] = self.centre(body, 0.0, &[]);
                [centre + rest, velocity]
            }
        };
        let mut state: Vec<[DVec3; 2]> = self.vertices.iter().map(start).collect();
        let plus = |state: &[[DVec3; 2]], h: f64, slope: &[[DVec3; 2]]| -> Vec<[DVec3; 2]> {
            state.iter().zip(slope).map(|(now, by)| [now[0] + h * by[0], now[1] + h * by[1]]).collect()
        };
        for k in 0..STEPS {
            let t = h * f64::from(k);
            let one = self.slope(t, &state);
            let two = self.slope(t + 0.5 * h, &plus(&state, 0.5 * h, &one));
            let three = self.slope(t + 0.5 * h, &plus(&state, 0.5 * h, &two));
            let four = self.slope(t + h, &plus(&state, h, &three));
            for (slope, share) in [(&one, 1.0), (&two, 2.0), (&three, 2.0), (&four, 1.0)] {
                state = plus(&state, h * share / 6.0, slope);
            }
        }
        state.into_iter().map(|[r, _]| r).collect()
    }
}

/// The largest distance of a world's vertices from these positions.
fn error(world: &World, expected: &[DVec3]) -> f64 {
    let positions = world.bodies().flat_map(|body| body.positions().collect::<Vec<_>>());
    positions.zip(expected).map(|(found, expected)| found.distance(*expected)).fold(0.0, f64::max)
}

#[test]
fn spheres_of_different_sizes_act_as_the_equations_say() {
    let mut random = Random(20_061_125);
    let (mut worst, mut effect) = (0.0, f64::INFINITY);
    for case in 0..24 {
        let (are_free, is_merged) = (case % 2 == 1, case % 4 > 1);
        let text = random_scene(&mut random, are_free, is_merged);
        let scene = scene(&text);
        let expected = ByHand::of(&scene, is_merged).run();
        for integrator in [Integrator::Exponential, Integrator::Rk4] {
            let divided = if integrator == Integrator::Rk4 { 40.0 } else { 1.0 };
            let found = run(&Scene { integrator, dt: scene.dt / divided, tolerance: 1e-8, ..scene.clone() });
            worst = f64::max(worst, error(&found, &expected));
        }
        let lines = text.lines().collect::<Vec<_>>();
        let first = lines.iter().position(|line| line.starts_with("[[body]]")).expect("bodies");
        let common = lines.iter().enumerate().filter(|(k, line)| *k < first || !line.starts_with("reach"));
        let common = common.map(|(_, line)| format!("{line}\n")).collect::<String>();
        effect = f64::min(effect, error(&run(&self::scene(&common)), &expected));
    }
    println!("largest error {worst:e}, smallest effect of the reaches {effect:e}");
    // measured: 8.2e-8 and 1.8e-4
    assert!(worst < 1e-7 && effect > 1e-4, "{worst:e} {effect:e}");
}

/// The order of two bodies in the file does not matter.
#[test]
fn swapped_bodies_move_alike() {
    let [left, right] = [("a", 1.0, 1.4, "[0, 0, 0]"), ("b", 0.7, 1.9, "[1.9, 0.2, 0.1]")];
    for kind in ["fixed", "free"] {
        let body = |(name, radius, reach, at): (&str, f64, f64, &str)| {
            let motion = if kind == "free" { format!("free = {{ from = {at} }}") } else { format!("fixed = {at}") };
            format!("[[body]]\nname = \"{name}\"\nradius = {radius}\nreach = {reach}\nmotion = {{ {motion} }}\n")
        };
        let text = |first, second| format!("duration = 1.0\n{}{}", body(first), body(second));
        let [one, other] = [text(left, right), text(right, left)].map(|text| run(&scene(&text)));
        let mut farthest = 0.0;
        for (a, b) in [(0, 1), (1, 0)] {
            let pairs = one.body(a).positions().zip(other.body(b).positions()).map(|(x, y)| x.distance(y));
            farthest = pairs.fold(farthest, f64::max);
            assert!(one.body(a).max_displacement() > 1e-3, "it is acted on");
        }
        assert!(if kind == "free" { farthest < 1e-5 } else { farthest == 0.0 }, "{kind}: {farthest:e}");
    }
}

/// A body that says what holds anyway changes no bit.
#[test]
fn the_same_reach_for_every_body_changes_nothing() {
    for (name, model) in [
        ("two", Model::Oscillators),
        ("three", Model::Oscillators),
        ("collide", Model::Oscillators),
        ("figure-4-2", Model::Oscillators),
        ("two", Model::Lattice),
        ("collide", Model::Lattice),
        ("two", Model::Fem),
        ("figure-2-3", Model::Metaballs),
    ] {
        let text = builtin::ALL.iter().find(|builtin| builtin.name == name).expect("a built-in scene").text;
        let own = text.replace("[[body]]\n", "[[body]]\nreach = 1.25\n");
        let common = match text.contains("[influence]\n") {
            true => text.replace("[influence]\n", "[influence]\nreach = 1.25\n"),
            false => text.replacen("[[body]]\n", "[influence]\nreach = 1.25\n[[body]]\n", 1),
        };
        let checksums = |text: &str| -> Vec<u64> {
            let integrator = if model == Model::Oscillators { scene(text).integrator } else { Integrator::Exponential };
            let scene = Scene { model, integrator, ..scene(text) };
            let mut simulation = scene.start().unwrap_or_else(|error| panic!("{error}"));
            let step = |_| {
                simulation.step(&mut StepSummary::default());
                simulation.checksum()
            };
            (0..150).map(step).collect()
        };
        let (own, common) = (checksums(&own), checksums(&common));
        assert!(own == common, "{name}, {model}");
        assert!(own != checksums(text) || model == Model::Metaballs, "{name}, {model}: the reach matters");
    }
}

/// An edit of the common reach leaves alone what a body has of its own.
#[test]
fn an_edit_of_the_common_reach_keeps_the_own() {
    let text = |common: &str, own: &str, edit: &str| {
        format!(
            "duration = 1.0\n[influence]\nreach = {common}\n[[body]]\nname = \"a\"\nradius = 1.0\nmotion = {{ fixed = [0, 0, 0] }}\n\
             [[body]]\nname = \"b\"\nradius = 0.8\nreach = {own}\nmotion = {{ fixed = [1.7, 0, 0.1] }}\n{edit}"
        )
    };
    let edit = |set: &str| format!("[[edit]]\ntime = 0.0\nset = {{ {set} }}\n");
    for (edited, plain) in [
        (text("1.4", "1.9", &edit("\"influence.reach\" = 1.2")), text("1.2", "1.9", "")),
        (text("1.4", "1.9", &edit("\"body.b.reach\" = 1.3")), text("1.4", "1.3", "")),
    ] {
        let [edited, plain] = [edited, plain].map(|text| run(&scene(&text)));
        let expected: Vec<DVec3> = plain.bodies().flat_map(|body| body.positions().collect::<Vec<_>>()).collect();
        let apart = error(&edited, &expected);
        assert!(apart < 1e-5, "{apart:e}");
    }
}

#[test]
fn the_spheres_that_are_shown_are_those_that_act() {
    let text = "duration = 1.0\n[[body]]\nname = \"a\"\nradius = 1.0\nreach = 1.2\nmotion = { fixed = [0, 0, 0] }\n\
                [[grid]]\nname = \"g\"\ncount = [2, 1, 1]\nspacing = [3, 0, 0]\nradius = 0.5\nreach = 2.0\n\
                motion = { fixed = [5, 0, 0] }\n[[body]]\nname = \"z\"\nradius = 2.0\nmotion = { fixed = [0, 9, 0] }\n";
    let scene = scene(text);
    let reaches: Vec<f64> = scene.bodies.iter().map(|body| body.reach).collect();
    assert_eq!(reaches, [1.2, std::f64::consts::SQRT_2, 2.0, 2.0]);
    let schema = scene.schema();
    let shown: Vec<f64> = schema.bodies.iter().map(|body| body.reach).collect();
    assert_eq!(shown, [1.2, 2.0 * std::f64::consts::SQRT_2, 1.0, 1.0]);
    assert!(schema.law.contains("spheres 1.200 to 2.000 R"), "{}", schema.law);

    let edits = "[[edit]]\ntime = 0.3\nset = { \"influence.reach\" = 1.1 }\n[[edit]]\ntime = 0.6\nset = { \"body.a.reach\" = 1.7 }\n";
    let schema = self::scene(&format!("{text}{edits}")).schema();
    let shown = |time: f64| [0, 1, 2].map(|body| schema.reach(body, time));
    let common = |reach: f64| 2.0 * reach;
    assert_eq!(shown(0.2), [1.2, common(std::f64::consts::SQRT_2), 1.0]);
    assert_eq!(shown(0.5), [1.2, common(1.1), 1.0]);
    assert_eq!(shown(0.9), [1.7, common(1.1), 1.0]);
}
