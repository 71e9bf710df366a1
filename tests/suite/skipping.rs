//! Skipping, the number of threads and the instruction set do not change the results.

use std::path::PathBuf;

use glam::DVec3;
use meldscope::{
    Scene, World,
    bench::reference::{Accuracy, Reference},
    scene::Integrator,
    sim::{Event, Options},
};
use proptest::prelude::*;
use pulp::Arch;

fn reference(name: &str) -> Scene {
    Scene::load(&PathBuf::from(format!("tests/reference/{name}.toml"))).expect("a valid scene")
}

/// Scenes in which much happens within 60 steps.
fn scenes() -> Vec<Scene> {
    let names = ["push", "two", "three", "size_ratio", "crowd"];
    let mut scenes: Vec<Scene> = names.map(|name| Scene::builtin(name).expect("a built-in scene")).into();
    scenes.extend(["push", "two", "three", "size_ratio"].map(reference));
    scenes.extend([arrival(), pendulum()]);
    scenes
}

/// A pair that comes to rest exactly on both its thresholds, at a keyframe. The result is the same whether this is
/// found far ahead or within the step.
fn arrival() -> Scene {
    let text = r#"
        name = "arrival"
        duration = 1.5
        [influence]
        merge_at = 0.6666666666666666
        split_at = 0.6666666666666666
        [[body]]
        name = "still"
        radius = 1.0
        motion = { fixed = [0, 0, 0] }
        [[body]]
        name = "arrives"
        radius = 0.5
        motion = { keyframes = [[0.0, 2, 0, 0], [0.5, 1, 0, 0], [1.0, 1, 0, 0]] }
    "#;
    Scene::parse(text, "arrival.toml").expect("a valid scene")
}

/// A body that oscillates after a push, into a sphere that never moves. In the step in which its vertices pass their
/// rest positions, none is within reach.
fn pendulum() -> Scene {
    let text = r#"
        name = "pendulum"
        duration = 6.0
        [material]
        omega = 6.0
        damping = 0.02
        [[body]]
        name = "swings"
        radius = 1.0
        motion = { fixed = [0, 0, 0] }
        [[body]]
        name = "still"
        radius = 0.5
        motion = { fixed = [2.0, 0, 0] }
        [[push]]
        body = "swings"
        direction = [-1, 0, 0]
        strength = 30.0
        start = 0.05
        duration = 0.2
    "#;
    Scene::parse(text, "pendulum.toml").expect("a valid scene")
}

/// Bodies with every kind of motion, some of them pushed while others touch them.
fn company(weight: &str, response: &str) -> Scene {
    let text = format!(
        r#"
        name = "company"
        duration = 2.5
        [material]
        response = "{response}"
        damping = 0.4
        [influence]
        weight = "{weight}"
        core_at = 0.6
        [[body]]
        name = "still"
        radius = 1.0
        motion = {{ fixed = [0, 0, 0] }}
        [[body]]
        name = "passes"
        radius = 0.5
        motion = {{ line = {{ from = [-4, 0.4, 0.3], velocity = [3, 0, 0] }} }}
        [[body]]
        name = "swings"
        radius = 0.8
        motion = {{ sine = {{ center = [1.9, 0, 0], amplitude = [0.6, 0.1, 0], frequency = 0.7 }} }}
        [[body]]
        name = "follows"
        radius = 1.2
        motion = {{ keyframes = [[0.2, 0, 6, 0], [1.1, 0, 1.4, 0.2], [1.6, 0, 1.2, 0], [2.3, 0, 5, 0]] }}
        [[body]]
        name = "apart"
        radius = 1.0
        motion = {{ fixed = [0, 0, 50] }}
        [[push]]
        body = "still"
        direction = [1, 0.2, 0]
        strength = 40.0
        start = 0.31
        duration = 0.4
        [[push]]
        body = "still"
        direction = [0, -1, 0]
        strength = 25.0
        start = 0.55
        duration = 0.5
        [[push]]
        body = "apart"
        direction = [0, -1, 0]
        strength = 60.0
        start = 0.1
        duration = 0.1
        "#
    );
    Scene::parse(&text, "company.toml").expect("a valid scene")
}

fn companies() -> Vec<Scene> {
    let kinds = [("linear", "inertial"), ("linear", "world"), ("wendland", "inertial"), ("linear", "rigid")];
    kinds.map(|(weight, response)| company(weight, response)).into()
}

/// Every bit of the state, and the events.
#[derive(Debug, PartialEq)]
struct Outcome {
    bits: Vec<u64>,
    checksum: u64,
    events: Vec<Event>,
    substeps: Vec<u64>,
}

fn run(scene: &Scene, options: Options, mut look: impl FnMut(&World)) -> Outcome {
    let mut world = World::with_options(scene.clone(), options).expect("enough memory");
    let mut outcome = Outcome { bits: vec![], checksum: 0, events: vec![], substeps: vec![] };
    for _ in 0..scene.steps() {
        let report = world.step();
        outcome.events.extend(&report.events);
        outcome.substeps.push(report.substeps);
        look(&world);
    }
    for body in world.bodies() {
        let states = body.states();
        for vectors in [&states.displacement, &states.velocity] {
            let numbers = vectors.x.iter().chain(&vectors.y).chain(&vectors.z);
            outcome.bits.extend(numbers.map(|x| x.to_bits()));
        }
    }
    outcome.checksum = world.checksum();
    outcome
}

/// The reference examines every vertex and every sphere at every instant.
#[test]
fn skipping_misses_nothing() {
    // whether the pair that stays on both thresholds merges is a matter of rounding
    for scene in scenes().into_iter().chain(companies()).filter(|scene| scene.name != "arrival") {
        assert_accurate(&scene, if scene.bodies.len() > 10 { 60 } else { 400 });
    }
}

#[cfg(target_arch = "x86_64")]
fn instruction_sets() -> Vec<Arch> {
    let v3 = pulp::x86::V3::try_new().map(Arch::V3);
    let v4 = pulp::x86::V4::try_new().map(Arch::V4);
    [Some(Arch::Scalar), v3, v4].into_iter().flatten().collect()
}

#[cfg(not(target_arch = "x86_64"))]
fn instruction_sets() -> Vec<Arch> {
    vec![Arch::Scalar, Arch::new()]
}

#[test]
fn instruction_sets_agree_to_the_bit() {
    for scene in scenes().into_iter().chain(companies()) {
        let scene = Scene { duration: scene.duration.min(10.0), ..scene.clone() };
        let outcomes = instruction_sets().into_iter().map(|arch| {
            let mut checksums = vec![];
            let outcome = run(&scene, Options { arch, ..Options::default() }, |world| checksums.push(world.checksum()));
            (outcome, checksums)
        });
        let outcomes: Vec<(Outcome, Vec<u64>)> = outcomes.collect();
        assert!(outcomes.windows(2).all(|two| two[0] == two[1]), "{}", scene.name);
    }
}

/// Observing every vertex after every step changes nothing, even though states are computed lazily.
#[test]
fn observation_changes_nothing() {
    for scene in scenes().into_iter().chain(companies()) {
        let unseen = run(&scene, Options::default(), |_| {});
        let seen = run(&scene, Options::default(), |world| {
            let sum: f64 = world.bodies().flat_map(|body| body.positions()).map(|position| position.x).sum();
            assert!(sum.is_finite() && world.energy().total().is_finite());
            world.checksum(); // also covers bodies that have gone to sleep since
        });
        assert!(unseen == seen, "{}", scene.name);
    }
}

/// The state is the same whether read vertex by vertex or all at once.
#[test]
fn states_are_the_same_one_by_one_and_at_once() {
    let mut world = World::new(company("linear", "inertial")).expect("enough memory");
    for _ in 0..world.scene().steps() {
        let _ = world.step();
        for body in world.bodies() {
            let states = body.states();
            for i in 0..body.vertex_count() {
                assert_eq!(states.displacement.get(i), body.displacement(i));
                assert_eq!(states.velocity.get(i), body.velocity(i));
            }
        }
    }
}

/// A body on which nothing acts any more takes no steps, but still follows its equation of motion.
#[test]
fn a_body_left_alone_costs_nothing_and_keeps_oscillating() {
    let scene = Scene { duration: 4.0, ..reference("push") };
    let mut world = World::new(scene.clone()).expect("enough memory");
    let reference = solve(&scene, scene.steps());
    let mut idle = 0;
    for step in 0..world.scene().steps() {
        idle += u64::from(world.step().substeps == 0);
        for (index, body) in world.bodies().enumerate() {
            let error = reference.error(index, &body, step as usize);
            assert!(error < 1e-12, "step {step}: {error:e}");
        }
    }
    let pushed = world.scene().pushes.iter().map(|push| (push.duration / world.scene().dt).ceil() as u64 + 1);
    assert!(idle >= world.scene().steps() - pushed.sum::<u64>(), "{idle} of {}", world.scene().steps());
}

/// Once every array has reached its size, steps allocate no memory.
#[test]
fn a_warm_step_allocates_nothing() {
    for integrator in [Integrator::Exponential, Integrator::Rk4] {
        // four identical periods: two bodies meet and separate in 4 s
        let scene = Scene { integrator, duration: 16.0, ..reference("two") };
        let half = scene.steps() as usize / 2;
        let mut world = World::new(scene).expect("enough memory");
        let mut allocations = vec![];
        for _ in 0..2 * half {
            let taken = allocation_counter::measure(|| {
                let _ = world.step();
            });
            allocations.push(taken.count_total);
        }
        // The periods are not exactly identical: residual oscillations of the previous one may involve a few more
        // vertices.
        let (warming, warm) = allocations.split_at(half);
        assert!(warm.iter().all(|&count| count == 0), "{integrator}: {warming:?} {warm:?}");
    }
}

/// However long a decay takes, it ends at exactly zero, without passing through subnormal numbers.
#[test]
fn decay_ends_at_rest() {
    let scene = company("linear", "rigid");
    let slow = |x: f64| x != 0.0 && x.abs() < 1e-290;
    for integrator in Integrator::ALL {
        let mut scene = Scene { integrator, dt: 0.01, ..scene.clone() };
        scene.bodies.truncate(1);
        scene.pushes.truncate(2);
        scene.bodies[0].material.damping = 12.0;
        let mut world = World::new(scene).expect("enough memory");
        for _ in 0..12_000 {
            let _ = world.step();
        }
        let states = world.body(0).states();
        assert!(states.displacement.iter().all(|x| !(slow(x.x) || slow(x.y) || slow(x.z))), "{integrator}");
        assert!(states.displacement.iter().chain(states.velocity.iter()).all(|v| v == DVec3::ZERO), "{integrator}");
    }
}

/// Without a spring, a body comes to rest where it is, not at its rest position, however slowly it moves at the end.
#[test]
fn without_a_spring_a_pushed_body_stays_where_it_is() {
    let mut scene = company("linear", "rigid");
    scene.dt = 0.25;
    scene.bodies.truncate(1);
    scene.pushes.truncate(1);
    scene.bodies[0].material.omega = 0.0;
    scene.bodies[0].material.damping = 1.5;
    for integrator in Integrator::ALL {
        let mut world = World::new(Scene { integrator, ..scene.clone() }).expect("enough memory");
        for _ in 0..100 {
            let _ = world.step();
        }
        let then = world.body(0).max_displacement();
        for _ in 0..900 {
            let _ = world.step(); // finally it moves less than a float can resolve
        }
        assert!(then > 1e-3, "{integrator}: {then:e}");
        let now = world.body(0).max_displacement();
        assert!((now - then).abs() < 1e-9 * then, "{integrator}: {now:e} after {then:e}");
    }
}

/// A pushed body between fixed ones oscillates freely through its rest shape and far out again, into their spheres.
/// Another one oscillates where a third body passes later.
#[test]
fn freely_oscillating_bodies_are_reached_again() {
    let text = r#"
        duration = 3.0
        [material]
        damping = 0.1
        [influence]
        split_at = 1.6
        merge_at = 1.05
        [[body]]
        name = "pushed"
        radius = 1.0
        motion = { fixed = [0, 0, 0] }
        [[body]]
        name = "left"
        radius = 1.0
        motion = { fixed = [-2.6, 0, 0] }
        [[body]]
        name = "right"
        radius = 1.0
        motion = { fixed = [2.75, 0, 0] }
        [[body]]
        name = "comes"
        radius = 1.0
        motion = { keyframes = [[1.5, 0, 9, 0], [2.2, 0, 2.7, 0]] }
        [[push]]
        body = "pushed"
        direction = [1, 0, 0]
        strength = 120.0
        start = 0.1
        duration = 0.06
        [[push]]
        body = "pushed"
        direction = [0, -1, 0]
        strength = 120.0
        start = 0.1
        duration = 0.06
    "#;
    let scene = Scene::parse(text, "between.toml").expect("a valid scene");
    assert_accurate(&scene, u64::MAX);

    // the test is not void: the fixed spheres have an effect, and later the passing one
    let mut alone = scene.clone();
    alone.bodies.truncate(1);
    let [mut among, mut alone] = [scene, alone].map(|scene| World::new(scene).expect("enough memory"));
    let (mut before, mut after) = (0.0, 0.0);
    for _ in 0..among.scene().steps() {
        let _ = among.step();
        let _ = alone.step();
        let apart = among.body(0).positions().zip(alone.body(0).positions()).map(|(x, y)| x.distance(y));
        let largest = if among.time() < 1.5 { &mut before } else { &mut after };
        *largest = apart.fold(*largest, f64::max);
    }
    assert!(before > 0.05 && after > 1.2 * before, "{before} {after}");
}

/// The reference solution at the ends of the first `steps` steps.
fn solve(scene: &Scene, steps: u64) -> Reference {
    let times: Vec<f64> = (1..=scene.steps().min(steps)).map(|step| step as f64 * scene.dt).collect();
    Reference::solve(scene, &times, Accuracy::DEFAULT).expect("quick")
}

/// Takes up to `steps` steps of the scene. After every step, every vertex is within the tolerance of the reference; all
/// events are those of the reference.
fn assert_accurate(scene: &Scene, steps: u64) {
    let reference = solve(scene, steps);
    let mut world = World::new(scene.clone()).expect("enough memory");
    let (mut worst, mut events) = (0.0, vec![]);
    for k in 0..reference.times().len() {
        let report = world.step();
        assert_eq!(report.failure, None);
        events.extend(report.events.iter().map(|event| (event.a as usize, event.b as usize, event.to, event.time)));
        for (index, body) in world.bodies().enumerate() {
            let error = reference.error(index, &body, k);
            let most = scene.tolerance * world.time();
            assert!(error < most, "{}, step {k}, {}: {error:e}, not {most:e}", scene.name, body.name());
            worst = f64::max(worst, error / most);
        }
    }
    let of_reference = |time: f64| reference.events().iter().filter(move |change| change.time <= time);
    assert_eq!(events.len(), of_reference(world.time()).count(), "{}", scene.name);
    for (a, b, to, time) in events {
        // simultaneous events may be listed in another order
        let is_it = of_reference(world.time())
            .any(|change| (change.a, change.b, change.to) == (a, b, to) && (change.time - time).abs() < 1e-9);
        assert!(is_it, "{}: {a}~{b} {to} at {time}", scene.name);
    }
    eprintln!("{}: {worst:.3} of the tolerance", scene.name);
}

/// A vertex of a large, fast body grazes the sphere of a small one for a millisecond. The step at whose start it enters,
/// by rounding still outside, is twelve times as long.
#[test]
fn a_visit_of_a_millisecond_is_not_missed() {
    let text = "duration = 0.1\n[material]\nresponse = \"rigid\"\n\
                [[body]]\nname = \"small\"\nradius = 10.3397659042697\nshape = { sphere = { stacks = 5, slices = 8 } }\n\
                motion = { line = { from = [-22.57074691563694, -18.99342737940674, -0.6319557513388091], \
                velocity = [-4.48788489789955, 27.686939309698904, 24.615113955238662] } }\n\
                [[body]]\nname = \"large\"\nradius = 315.23799774954927\nshape = { sphere = { stacks = 5, slices = 8 } }\n\
                motion = { sine = { center = [-107.3518480277031, 407.49028895369935, 23.43724974254925], \
                amplitude = [584.3976492291342, -931.988673329601, -755.5661872092719], frequency = 0.4 } }\n";
    let scene = Scene::parse(text, "graze.toml").expect("a valid scene");
    let moved = |reference: &Reference| reference.displacement(1, 15, reference.times().len() - 1).length();
    assert!(moved(&solve(&scene, u64::MAX)) > 1e-5, "it is pushed");
    assert_accurate(&scene, u64::MAX);
}

/// A large body among small ones, most of which reach none of its vertices: the error estimate of its steps does not
/// depend on these.
#[test]
fn bodies_out_of_reach_do_not_change_how_steps_are_divided() {
    let body = |name: &str, radius: f64, motion: &str| {
        format!(
            "[[body]]\nname = \"{name}\"\nradius = {radius:?}\nshape = {{ sphere = {{ stacks = 5, slices = 8 }} }}\n\
             motion = {{ {motion} }}\n"
        )
    };
    let sine = "center = [-259.43, 173.36, 9.618], amplitude = [592.25, 0, 0], frequency = 0.4";
    let text = String::from("duration = 0.45\n[material]\nresponse = \"rigid\"\n")
        + &body("swings", 202.305, &format!("sine = {{ {sine} }}"))
        + &body("one", 1.0, "fixed = [0, 0, 0]")
        + &body("two", 1.0, "fixed = [0, 0, 0]")
        + &body("far", 67.402, "fixed = [0, 0, 121.885]")
        + &body("aside", 20.788, "fixed = [-17.2, 34.203, -51.296]")
        + &body("three", 1.0, "fixed = [0, 0, 0]");
    assert_accurate(&Scene::parse(&text, "sizes.toml").expect("a valid scene"), u64::MAX);
}

// ---- free bodies ---------------------------------------------------------------------------------------------------

fn small_scene(text: &str) -> Scene {
    Scene::parse(&format!("duration = 100.0\n{text}"), "test.toml").expect("a valid scene")
}

/// A small sphere.
fn ball(name: &str, motion: &str) -> String {
    format!(
        "[[body]]\nname = \"{name}\"\nradius = 1.0\nshape = {{ sphere = {{ stacks = 6, slices = 8 }} }}\nmotion = {motion}\n"
    )
}

fn free(name: &str, from: [f64; 3], velocity: [f64; 3]) -> String {
    ball(name, &format!("{{ free = {{ from = {from:?}, velocity = {velocity:?} }} }}"))
}

const FLOOR: &str = "[[plane]]\nnormal = [0, 0, 1]\noffset = -1.0\nfriction = 0.5\nslip = 0.05\n";

fn take_steps(world: &mut World, steps: u32) {
    for _ in 0..steps {
        assert_eq!(world.step().failure, None);
    }
}

/// A damped body that turns about its axis of largest moment stops swinging. It then goes on in closed form, like the
/// same body with steps, until it is pushed. Without damping it swings for ever.
#[test]
fn steady_rotation_needs_no_steps() {
    let turning = |spin: DVec3| {
        let motion =
            format!("{{ free = {{ from = [0, 0, 0], velocity = [0.1, 0, 0], spin = {:?} }} }}", spin.to_array());
        let push = "[[push]]\nbody = \"a\"\ndirection = [1, 0, 0]\nstrength = 9.0\nstart = 5.5\nduration = 0.2\n";
        format!("[material]\nomega = 12.0\ndamping = 8.0\n{}{push}", ball("a", &motion))
    };
    let text = turning(2.0 * DVec3::Z);
    let scene = small_scene(&text);
    let reference = solve(&scene, 340);
    let mut world = World::new(scene).expect("enough memory");
    take_steps(&mut world, 300);
    assert_eq!(world.report().substeps, 0);
    let kept = world.conserved().expect("a free body");
    take_steps(&mut world, 28);
    assert_eq!(world.report().substeps, 0);
    let off = reference.error(0, &world.body(0), 327);
    assert!(off < 1e-6 * world.time(), "{off:e}");
    let now = world.conserved().expect("a free body");
    assert!((now.angular_momentum - kept.angular_momentum).length() < 1e-14);
    assert!((now.elastic - kept.elastic).abs() < 1e-14 && (now.spin - kept.spin).abs() < 1e-13);
    take_steps(&mut world, 12);
    assert!(world.report().substeps > 0);
    let off = reference.error(0, &world.body(0), 339);
    assert!(off < 1e-6 * world.time(), "{off:e}");
    let mut swinging = World::new(small_scene(&text.replace("damping = 8.0", "damping = 0.0"))).expect("enough memory");
    take_steps(&mut swinging, 300);
    assert_eq!(swinging.report().substeps, 1);
}

/// Free bodies, bodies on paths and a plane: some fly alone, some meet, some are pushed.
#[test]
fn skipping_misses_nothing_among_free_bodies() {
    let text = format!(
        "gravity = [0, 0, -3]\n[material]\ndamping = 3.0\n[influence]\ncore_at = 0.6\ncore_width = 0.3\n{FLOOR}{}{}{}{}{}{}[[push]]\nbody = \"e\"\ndirection = [1, 0, 1]\nstrength = 20.0\nstart = 0.71\nduration = 0.2\n",
        free("a", [0.0, 0.0, 1.2], [0.5, 0.0, 0.0]),
        free("b", [2.5, 0.2, 0.6], [-0.5, 0.0, 0.0]),
        ball("c", "{ sine = { center = [0, 4, 0.2], amplitude = [0, 0.8, 0], frequency = 0.4 } }"),
        ball("d", "{ fixed = [0, 7, 0.2] }"),
        free("e", [-9.0, 0.0, 0.0], [0.0; 3]),
        ball("f", "{ fixed = [20, 0, 3] }"),
    );
    assert_accurate(&Scene { duration: 1.5, ..small_scene(&text) }, u64::MAX);
}

/// Bodies that lie on each other and on a plane rest together, within the tolerance of the motion without rest; the
/// ledger holds the lost energy. A push on one wakes all of them.
#[test]
fn a_pile_rests_and_wakes_as_a_whole() {
    let rough = FLOOR.replace("slip = 0.05", "slip = 0.5");
    let fixed =
        |name: &str, from: [f64; 3]| ball(name, &format!("{{ free = {{ from = {from:?}, rotation = \"fixed\" }} }}"));
    let text = format!(
        "gravity = [0, 0, -9.81]\ntolerance = 1e-2\n[material]\nomega = 20.0\ndamping = 12.0\n[influence]\ncore_at = 0.8\ncore_width = 0.4\n{rough}{}{}{}[[push]]\nbody = \"c\"\ndirection = [1, 0, 0]\nstrength = 20.0\nstart = 11.0\nduration = 0.1\n",
        fixed("a", [-0.9, 0.0, 0.0]),
        fixed("b", [0.9, 0.1, 0.0]),
        fixed("c", [0.0, 0.0, 1.7]),
    );
    let scene = small_scene(&text);
    let reference = solve(&scene, 660);
    let mut world = World::new(scene).expect("enough memory");
    let first = world.conserved().expect("free bodies").energy();
    let mut rested = None;
    for k in 0..660 {
        take_steps(&mut world, 1);
        let resting = world.report().sleeping_bodies;
        assert!(resting == 0 || resting == 3, "{resting} at {}", world.time());
        if resting == 3 && rested.is_none() {
            rested = Some(world.time());
        }
        for (index, body) in world.bodies().enumerate() {
            let error = reference.error(index, &body, k);
            assert!(error < 1e-2 * world.time().max(0.5), "{}: {error:e}", world.time());
        }
    }
    assert!(rested.is_some_and(|time| time < 10.0), "{rested:?}");
    let (now, ledger) = (world.conserved().expect("free bodies"), world.ledger());
    assert_eq!((now.kinetic, now.spin, now.vibration), (0.0, 0.0, 0.0));
    assert!(ledger.rest < 0.0 && ledger.rest > -1e-3, "{ledger:?}");
    let left = now.energy() - first - ledger.total();
    assert!(left.abs() < 1e-3, "{left:e}");
    take_steps(&mut world, 3);
    assert_eq!(world.report().sleeping_bodies, 0);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// Bodies of sizes from 1 to 1,000 cross each other's paths: the grid finds the same pairs as a search over all
    /// pairs, and every body within reach wakes.
    #[test]
    fn bodies_of_all_sizes_find_each_other(
        bodies in prop::collection::vec((0.0..3.0_f64, prop::array::uniform3(-1.0..1.0_f64), prop::array::uniform3(-1.0..1.0_f64), 0..3), 3..12),
    ) {
        let mut text = String::from("duration = 0.5\n[material]\nresponse = \"rigid\"\n");
        for (i, (size, place, way, motion)) in bodies.iter().enumerate() {
            // large bodies are farther out, so that they do not all overlap
            let radius = 10f64.powf(*size);
            let [x, y, z] = place.map(|p| 2.5 * p * radius.max(4.0));
            let [u, v, w] = way.map(|v| 3.0 * v * radius.max(4.0));
            let motion = match motion {
                0 => format!("fixed = [{x:?}, {y:?}, {z:?}]"),
                1 => format!("line = {{ from = [{x:?}, {y:?}, {z:?}], velocity = [{u:?}, {v:?}, {w:?}] }}"),
                _ => format!("sine = {{ center = [{x:?}, {y:?}, {z:?}], amplitude = [{u:?}, {v:?}, {w:?}], frequency = 0.4 }}"),
            };
            text += &format!(
                "[[body]]\nname = \"b{i}\"\nradius = {radius:?}\nshape = {{ sphere = {{ stacks = 5, slices = 8 }} }}\n\
                 motion = {{ {motion} }}\n"
            );
        }
        let scene = Scene::parse(&text, "sizes.toml").expect("a valid scene");
        assert_accurate(&scene, u64::MAX);
    }
}
