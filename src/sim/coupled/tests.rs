//! Coupled scenes: skipping changes nothing, no step hangs, and bodies at rest stay at rest.

use glam::DVec3;

use crate::{
    Scene, World,
    model::phase::Phase,
    observe::{BodyFrame, Frame, Simulation, Want, between, state_within},
    scene::{
        Force, Integrator, Motion, Path,
        path::{Bounds, Given, Kinematics},
    },
    sim::{EditError, Failure, coupled::member::FixedSteps, report::Toil, solver::Solver},
};

fn scene(text: &str) -> Scene {
    Scene::parse(&format!("duration = 100.0\n{text}"), "test.toml").unwrap()
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

fn run(world: &mut World, steps: u32) {
    for _ in 0..steps {
        let report = world.step();
        assert!(report.failure.is_none(), "{:?}", report.failure);
    }
}

/// The largest distance between corresponding vertices.
fn difference(a: &World, b: &World) -> f64 {
    let all = a.bodies().zip(b.bodies());
    all.flat_map(|(a, b)| a.positions().zip(b.positions())).map(|(a, b)| a.distance(b)).fold(0.0, f64::max)
}

#[test]
fn an_isolated_body_flies_in_closed_form() {
    let text = format!("gravity = [0, 0, -9.81]\n{}", free("a", [1.0, 0.0, 5.0], [2.0, 0.0, 3.0]));
    let mut world = World::new(scene(&text)).unwrap();
    for _ in 0..60 {
        assert_eq!(world.step().substeps, 0);
    }
    let t = world.time();
    let expected = DVec3::new(1.0 + 2.0 * t, 0.0, 5.0 + 3.0 * t - 0.5 * 9.81 * t * t);
    assert!(world.body(0).centre().distance(expected) < 1e-13, "{}", world.body(0).centre());
    assert!(world.body(0).is_at_rest());
}

/// Bodies that fall on a plane come to rest, cost nothing then, and wake when another body touches them.
#[test]
fn resting_bodies_cost_nothing_until_touched() {
    let text = format!(
        "gravity = [0, 0, -9.81]\ntolerance = 1e-3\n[material]\nomega = 20.0\ndamping = 8.0\n[influence]\ncore_at = 0.9\ncore_width = 0.3\n{FLOOR}{}{}{}",
        ball("a", "{ free = { from = [0, 0, 0.02], rotation = \"fixed\" } }"),
        ball("far", "{ free = { from = [50, 0, 0.02], rotation = \"fixed\" } }"),
        ball("late", "{ keyframes = [[0, 0.3, 0.1, 40], [18, 0.3, 0.1, 40], [20, 0.3, 0.1, 1.5]] }"),
    );
    let mut world = World::new(scene(&text)).unwrap();
    run(&mut world, 1020);
    assert_eq!(world.report().sleeping_bodies, 2, "{:?}", world.report()); // the third wobbles on its way
    assert_eq!(world.solver.coupled().unwrap().awake_count(), 1);
    let before = world.body(1).position(3);
    run(&mut world, 60);
    let centre = world.body(0).centre();
    let settled = world.body(0).position(0);
    while world.body(2).centre().z > 6.0 {
        run(&mut world, 1);
    }
    assert_eq!(world.body(0).position(0), settled);
    run(&mut world, 60);
    assert!(world.body(0).centre().distance(centre) > 1e-3);
    assert_eq!(world.body(1).position(3), before);
}

/// With a plane out of reach, the coupled engine steps a scene of prescribed paths: both engines give the same result.
#[test]
fn both_engines_agree_on_prescribed_paths() {
    let jumping = |interpolation: &str| {
        let path = |shift: f64| {
            format!(
                "{{ keyframes = {{ keys = [[0, -2, 0, 0], [0.3, -1.2, {shift}, 0], [0.62, 1.7, 0, 0], [1.0, 0.4, 0, 0], [1.5, -2.5, 0, 0]], interpolation = \"{interpolation}\" }} }}"
            )
        };
        scene(&format!("{}{}", ball("still", "{ fixed = [0.1, 0, 0] }"), ball("jumps", &path(0.2))))
    };
    let scenes = ["two", "three", "size_ratio", "push"].map(|name| (name, Scene::builtin(name).unwrap()));
    let jumping = ["linear", "hold"].map(|interpolation| (interpolation, jumping(interpolation)));
    for (name, alone) in scenes.into_iter().chain(jumping) {
        let mut coupled = alone.clone();
        let mut floor = scene(&format!("{FLOOR}{}", ball("a", "{ fixed = [0, 0, 0] }"))).planes[0];
        floor.offset = -100.0;
        coupled.planes.push(floor);
        let (mut alone, mut coupled) = (World::new(alone).unwrap(), World::new(coupled).unwrap());
        for _ in 0..120 {
            run(&mut alone, 1);
            run(&mut coupled, 1);
            let error = difference(&alone, &coupled);
            assert!(error < 1e-6, "{name}: {error:e}");
            assert_eq!(alone.report().events.len(), coupled.report().events.len());
            for (a, b) in alone.report().events.iter().zip(&coupled.report().events) {
                assert_eq!((a.a, a.b, a.from, a.to), (b.a, b.b, b.from, b.to));
                assert!((a.time - b.time).abs() < 1e-9);
            }
            let pairs = |world: &World| {
                world
                    .pairs()
                    .filter(|pair| pair.phase != Phase::Apart)
                    .map(|pair| (pair.a, pair.b, pair.phase))
                    .collect::<Vec<_>>()
            };
            assert_eq!(pairs(&alone), pairs(&coupled), "{name}");
        }
    }
}

fn crowd() -> Scene {
    let mut text = format!("gravity = [0, 0, -5]\ntolerance = 1e-4\n{FLOOR}");
    for i in 0..36 {
        let at = DVec3::new(f64::from(i % 6) * 2.3, f64::from(i / 6) * 2.9, f64::from(i * 7 % 5) * 0.4);
        text += &free(&format!("b{i}"), at.to_array(), [0.1 * f64::from(i % 3), 0.0, 0.0]);
    }
    scene(&text)
}

#[test]
fn the_number_of_threads_makes_no_difference() {
    let checksums = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut world = World::new(crowd()).unwrap();
            (0..20).map(|_| (run(&mut world, 1), world.checksum()).1).collect::<Vec<_>>()
        })
    };
    assert_eq!(checksums(1), checksums(3));
}

/// Every step of an extreme scene ends in bounded time, with a state or a failure.
#[test]
fn extreme_scenes_do_not_hang() {
    let fast = |spin: f64| ball("a", &format!("{{ free = {{ from = [0, 0, 0.4], spin = [0, {spin:e}, 0] }} }}"));
    let light = "[[body]]\nname = \"light\"\nradius = 1.0\nmass = 1e-6\nshape = { sphere = { stacks = 6, slices = 8 } }\nmotion = { free = { from = [0.9, 0, 0] } }\n";
    let deep = |k: f64| {
        format!("[[plane]]\nnormal = [0, 0, 1]\noffset = 0.0\nstiffness = {k:e}\nfriction = 0.9\nslip = 1e-6\n")
    };
    let cases = [
        ("stiff", format!("{}{}", deep(1e12), free("a", [0.0, 0.0, 1.01], [0.0, 0.0, -1.0]))),
        ("deep and stiff", format!("{}{}", deep(1e12), free("a", [0.0; 3], [0.0; 3]))),
        ("spin", fast(1e4)),
        ("spin on a plane", format!("{}{}", deep(4000.0), fast(1e4))),
        ("mass ratio", free("a", [0.0; 3], [0.0; 3]) + light),
        ("deep overlap", free("a", [0.0; 3], [0.0; 3]) + &free("b", [1e-9, 0.0, 0.0], [0.0; 3])),
        ("same place", free("a", [0.0; 3], [0.0; 3]) + &free("b", [0.0; 3], [0.0; 3])),
        ("fast", free("a", [0.0; 3], [1e9, 0.0, 0.0]) + &free("b", [1e7, 0.0, 0.0], [0.0; 3])),
    ];
    for (name, text) in cases {
        for integrator in [Integrator::Exponential, Integrator::Rk4, Integrator::Thesis] {
            let start = std::time::Instant::now();
            let mut world = World::new(Scene { integrator, ..scene(&text) }).unwrap();
            let mut outcome = String::new();
            for _ in 0..10 {
                if let Some(failure) = &world.step().failure {
                    outcome = failure.to_string();
                    break;
                }
            }
            let took = start.elapsed().as_secs_f64();
            assert!(took < 60.0, "{name} {integrator}: {took} s, {outcome}");
        }
    }
}

/// The reported error is that of the last step, not the largest of the run.
#[test]
fn the_reported_error_falls_with_the_motion() {
    let body = "name = \"a\"\nradius = 1.0\nmotion = { free = { from = [0, 0, 0], spin = [0, 0, 2] } }\n";
    let mut world = World::new(scene(&format!("[material]\ndamping = 6.0\n[[body]]\n{body}"))).unwrap();
    let first = world.step().error;
    run(&mut world, 120);
    let last = world.report().error;
    assert!(last > 0.0 && last < 0.5 * first, "{first:e}, then {last:e}");
}

/// A heap of small spheres.
fn heap(counts: [u32; 3], friction: f64) -> World {
    World::new(scene(&format!(
        "gravity = [0, 0, -9.81]\n[material]\ndamping = 4.0\n[[plane]]\nnormal = [0, 0, 1]\nfriction = {friction:?}\n\
         [[grid]]\nname = \"b\"\nradius = 1.0\nshape = {{ sphere = {{ stacks = 6, slices = 8 }} }}\ncount = {counts:?}\n\
         spacing = [2.1, 2.1, 2.1]\njitter = 0.1\nmotion = {{ free = {{ from = [0, 0, 1.1] }} }}\n"
    )))
    .unwrap()
}

/// A heap whose islands take steps of fixed length from the start.
fn heap_in_fixed_steps(counts: [u32; 3], friction: f64) -> World {
    let mut world = heap(counts, friction);
    let Solver::Coupled(coupled) = &mut world.solver else { unreachable!() };
    coupled.members.iter_mut().for_each(|member| member.fixed = FixedSteps { left: u16::MAX, wait: u16::MAX });
    world
}

/// A heap in steps of fixed length keeps its momentum, accounts for its energy, reports its error, and does not sink into
/// the plane.
#[test]
fn a_heap_in_fixed_steps_keeps_what_is_conserved() {
    let mut world = heap_in_fixed_steps([3, 3, 3], 0.0);
    let first = world.conserved().unwrap();
    let mut is_reported = false;
    for step in 1..=240 {
        let report = world.step();
        assert!(report.failure.is_none(), "{:?}", report.failure);
        assert_eq!(report.fallback.is_some(), step == 1);
        is_reported |= report.shortfall.is_some_and(|shortfall| shortfall.error > shortfall.allowed);
        let now = world.conserved().unwrap();
        // a plane without friction acts along its normal
        assert!((now.momentum - first.momentum).truncate().length() < 1e-9, "step {step}: {}", now.momentum);
        assert!(now.angular_momentum.z.abs() < 1e-8, "step {step}: {}", now.angular_momentum);
        let brought = world.ledger();
        let left = now.energy() - first.energy() - brought.total();
        assert!(left.abs() < 0.1 * first.energy(), "step {step}: {left} of {}", first.energy());
        let lowest =
            world.bodies().flat_map(|body| body.positions().map(|r| r.z).collect::<Vec<_>>()).fold(0.0, f64::min);
        assert!(lowest > -0.5, "step {step}: {lowest}");
    }
    assert!(is_reported);
}

/// On a plane with friction it comes to rest and sleeps.
#[test]
fn a_heap_in_fixed_steps_comes_to_rest() {
    let mut world = heap_in_fixed_steps([3, 3, 3], 0.3);
    let rests = (0..6000).any(|_| {
        run(&mut world, 1);
        world.resting_count() == 27
    });
    assert!(rests, "{} rest; {:?}", world.resting_count(), world.conserved());
}

/// Steps of fixed length are the same for any number of threads.
#[test]
fn fixed_steps_do_not_depend_on_threads() {
    let [one, three] = [1, 3].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut world = heap_in_fixed_steps([4, 4, 4], 0.3);
            run(&mut world, 60);
            let events: usize = world.pairs().filter(|pair| pair.phase != Phase::Apart).count();
            (world.checksum(), events)
        })
    });
    assert_eq!(one, three);
    assert!(one.1 > 0);
}

/// Five balls on a plane with friction reach the end of the run.
#[test]
fn a_rough_heap_of_five_reaches_its_end() {
    let mut world = heap_in_fixed_steps([1, 1, 5], 0.3);
    run(&mut world, 600);
    assert!(world.bodies().all(|body| (0.0..10.0).contains(&body.centre().z)));
}

/// A heap that is too much work for adaptive steps takes steps of fixed length from the same step on, with any number of
/// threads.
#[test]
fn too_much_work_is_the_same_for_any_number_of_threads() {
    let [one, three] = [1, 3].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut world = heap([5, 5, 3], 0.3);
            let mut fallbacks = Vec::new();
            for step in 1..=40 {
                let report = world.step();
                assert!(report.failure.is_none(), "{:?}", report.failure);
                fallbacks.extend(report.fallback.is_some().then_some(step));
            }
            (world.checksum(), fallbacks)
        })
    });
    assert_eq!(one, three);
    assert!(!one.1.is_empty());
}

#[test]
fn a_pair_that_chatters_is_named() {
    let text = format!(
        "gravity = [0, 0, -9.81]\n[material]\nomega = 30.0\ndamping = 5.0\n[influence]\ncore_at = 0.7\ncore_width = 0.0\n{FLOOR}{}{}",
        free("left", [-0.71, 0.0, 0.0], [0.0; 3]),
        free("right", [0.71, 0.0, 0.0], [0.0; 3]),
    );
    let mut world = World::new(scene(&text)).unwrap();
    let failure = (0..600).find_map(|_| world.step().failure.clone());
    let Some(Failure::Overworked(overworked)) = failure else { panic!("{failure:?}") };
    assert!(matches!(&overworked.toil, Toil::Chatter { a, b } if a == "left" && b == "right"), "{overworked}");
    assert!(overworked.to_string().contains("core_width"));
}

/// The explicit schemes converge to the same motion, each with its order; the thesis's scheme converges to another.
#[test]
fn explicit_schemes_converge() {
    let text = free("a", [0.0; 3], [0.6, 0.0, 0.0])
        + &ball("b", "{ free = { from = [1.6, 0.3, 0.1], velocity = [-0.6, 0.0, 0.0], spin = [0.0, 0.3, 1.0] } }");
    let text = format!("[influence]\nmerge_at = 1.05\n{text}");
    let end = |integrator: Integrator, divided: u32| {
        let own = scene(&text);
        let mut world = World::new(Scene { integrator, dt: own.dt / f64::from(divided), ..own }).unwrap();
        run(&mut world, 30 * divided);
        world
    };
    let exact = end(Integrator::Exponential, 1);
    let errors = |integrator| [2, 4, 8].map(|divided| difference(&end(integrator, divided), &exact));
    for (integrator, order) in
        [(Integrator::Mps, 1.0), (Integrator::Euler, 1.0), (Integrator::Verlet, 2.0), (Integrator::Rk4, 4.0)]
    {
        let errors = errors(integrator);
        let seen = (errors[0] / errors[2]).log2() / 2.0;
        assert!(seen > 0.75 * f64::min(order, 2.0), "{integrator}: order {seen} of {errors:?}");
    }
    let errors = errors(Integrator::Thesis);
    assert!(errors[2] > 1e-3, "{errors:?}");
}

/// Pushes and bodies added between steps, before they act, lead to the same states as in the scene file.
#[test]
fn changes_between_steps_equal_changes_of_the_scene() {
    let text = format!(
        "gravity = [0, 0, -3]\n[influence]\ncore_at = 0.6\ncore_width = 0.3\n{FLOOR}{}{}",
        free("a", [0.0, 0.0, 0.3], [0.0; 3]),
        free("b", [1.8, 0.2, 0.3], [0.0; 3]),
    );
    let push = "[[push]]\nbody = \"b\"\ndirection = [1, 0, 0]\nstrength = 9.0\nstart = 0.5\nduration = 0.2\n";
    let full = scene(&format!("{text}{push}"));
    let mut known = World::new(full.clone()).unwrap();
    let mut pushed = World::new(scene(&text)).unwrap();
    for step in 0..45 {
        if step == 20 {
            pushed.push(full.pushes[0]).unwrap();
        }
        run(&mut known, 1);
        run(&mut pushed, 1);
        assert_eq!(known.checksum(), pushed.checksum(), "step {step}");
    }
    // a body added far away and removed again does not change the others
    let far = scene(&format!("{text}{push}{}", free("far", [90.0, 0.0, 50.0], [0.0; 3]))).bodies[2].clone();
    let added = pushed.add(far.clone()).unwrap();
    assert_eq!(pushed.index_of(added), Some(2));
    assert!(matches!(pushed.add(far), Err(EditError::Name(_))));
    run(&mut known, 5);
    run(&mut pushed, 5);
    pushed.remove(added).unwrap();
    run(&mut known, 5);
    run(&mut pushed, 5);
    assert_eq!(known.checksum(), pushed.checksum());
    pushed.set_motion(1, scene(&text).bodies[0].motion.clone()).unwrap();
    run(&mut pushed, 1);
    assert_eq!(pushed.remove(7), Err(EditError::NoBody(7)));
    let mut prescribed = World::new(Scene::builtin("two").unwrap()).unwrap();
    run(&mut prescribed, 1);
    let free = crate::scene::Body { name: "free".to_owned(), ..scene(&text).bodies[0].clone() };
    assert_eq!(prescribed.add(free), Err(EditError::Solver));
}

/// A path given as a function, from the start or between steps, leads to the same states as that path in the scene
/// file.
#[test]
fn a_path_by_a_function_equals_that_path_in_the_scene() {
    let text = free("a", [0.0; 3], [0.1, 0.0, 0.0])
        + &ball("leads", "{ line = { from = [2, 0, 0], velocity = [-0.3, 0, 0] } }");
    let line = |from: DVec3, velocity: DVec3| {
        let at = move |t: f64| Kinematics { position: from + velocity * t, velocity, acceleration: DVec3::ZERO };
        let given = Given::new(Bounds { speed: velocity.length(), acceleration: 0.0 }, at);
        [Path::Line { from, velocity }, Path::Given(given)].map(Motion::Prescribed)
    };
    let mut own = scene(&text);
    own.bodies[1].motion = line(2.0 * DVec3::X, -0.3 * DVec3::X)[1].clone();
    let mut parsed = World::new(scene(&text)).unwrap();
    let mut given = World::new(own).unwrap();
    let later = line(DVec3::new(1.5, 0.1, 0.0), DVec3::new(0.1, 0.4, 0.0));
    for step in 0..50 {
        if step == 30 {
            for (world, motion) in [&mut parsed, &mut given].into_iter().zip(later.clone()) {
                world.set_motion(1, motion).unwrap();
            }
        }
        run(&mut parsed, 1);
        run(&mut given, 1);
        assert_eq!(parsed.checksum(), given.checksum(), "step {step}");
    }
    assert_eq!(parsed.phase(0, 1), Phase::Core);
}

/// A body that starts from rest and speeds up does not count as resting, however slow it is at first.
#[test]
fn an_accelerating_body_does_not_rest() {
    let spun = ball("a", "{ free = { from = [0, 0, 0], spin = [0, 0, 1e-3] } }");
    let mut world = World::new(scene(&format!("gravity = [0, 0, -0.008]\ntolerance = 1e-2\n{spun}"))).unwrap();
    run(&mut world, 300);
    assert!((world.body(0).centre().z + 0.004 * 25.0).abs() < 1e-9, "{}", world.body(0).centre());
}

/// Once buffers have grown to their final sizes, steps of islands allocate no memory.
#[test]
fn a_warm_step_of_islands_allocates_nothing() {
    let text = format!(
        "gravity = [0, 0, -2]\n[material]\ndamping = 0.5\n[influence]\ncore_at = 0.7\ncore_width = 0.4\n{FLOOR}{}{}{}{}{}",
        free("a", [0.0; 3], [0.0; 3]),
        free("b", [1.7, 0.1, 0.1], [0.0; 3]),
        free("c", [20.0, 0.0, 0.0], [0.0; 3]),
        ball("d", "{ sine = { center = [21.8, 0, 0], amplitude = [0.1, 0, 0], frequency = 0.5 } }"),
        free("e", [40.0, 0.0, 90.0], [0.0; 3]),
    );
    let mut world = World::new(scene(&text)).unwrap();
    run(&mut world, 240);
    let allocations = (0..120).map(|_| {
        let taken = allocation_counter::measure(|| {
            let _ = world.step();
        });
        taken.count_total
    });
    let allocations: Vec<u64> = allocations.collect();
    assert!(allocations.iter().all(|&count| count == 0), "{allocations:?}");
    assert!(world.report().failure.is_none() && world.report().sleeping_bodies == 1);
}

/// A force given as a function acts like gravity of the same strength, its work is in the ledger, and it ends when it
/// is removed.
#[test]
fn a_force_by_a_function_equals_gravity() {
    let text = |gravity: f64| {
        let bodies = free("a", [0.0; 3], [0.1, 0.0, 0.0]) + &free("b", [1.9, 0.2, 0.0], [0.0; 3]);
        scene(&format!("gravity = [0, 0, {gravity}]\n[influence]\ncore_at = 0.6\ncore_width = 0.3\n{bodies}"))
    };
    let mut fallen = World::new(text(-3.0)).unwrap();
    let mut forced = text(0.0);
    for body in &mut forced.bodies {
        body.force = Some(Force::new(3.0, |_, _, _| -3.0 * DVec3::Z));
    }
    let mut forced = World::new(forced).unwrap();
    let first = forced.conserved().unwrap().energy();
    for _ in 0..45 {
        run(&mut fallen, 1);
        run(&mut forced, 1);
        let error = difference(&fallen, &forced);
        // the steps differ, because the time scales of a function are unknown
        assert!(error < 1e-7, "{}: {error:e}", forced.time());
    }
    assert_ne!(forced.phase(0, 1), Phase::Apart);
    let left = forced.conserved().unwrap().energy() - first - forced.ledger().total();
    assert!(forced.ledger().pushes > 1.0 && left.abs() < 1e-5, "{left:e} of {:?}", forced.ledger());
    // without forces, the momentum of the pair is conserved
    let momentum = forced.conserved().unwrap().momentum;
    (0..2).for_each(|body| forced.set_force(body, None).unwrap());
    run(&mut forced, 15);
    assert!(forced.conserved().unwrap().momentum.distance(momentum) < 1e-12);

    // drag, against exponential decay
    let mut world = World::new(scene(&free("a", [0.0; 3], [2.0, 0.0, 0.0]))).unwrap();
    world.set_force(0, Some(Force::new(2.0, |_, _, velocity| -0.5 * velocity))).unwrap();
    run(&mut world, 60);
    let expected = 4.0 * (1.0 - libm::exp(-0.5));
    assert!((world.body(0).centre().x - expected).abs() < 1e-7, "{}", world.body(0).centre());
    let on_path = ball("p", "{ fixed = [0, 0, 0] }");
    let mut world = World::new(scene(&format!("{}{on_path}", free("a", [9.0; 3], [0.0; 3])))).unwrap();
    assert_eq!(world.set_force(1, None), Err(EditError::OnPath("p".to_owned())));
}

/// The energy of a scene minus its ledger is constant, even though its bodies start and end out of each other's reach.
#[test]
fn the_ledger_of_a_world_accounts_for_its_energy() {
    for name in ["collide", "drop"] {
        let mut world = World::new(Scene::builtin(name).expect("built in")).expect("it fits");
        let energy = |world: &World| world.conserved().expect("it is coupled").energy();
        let (first, mut scale) = (energy(&world), 1.0f64);
        for _ in 0..120 {
            let _ = world.step();
            let now = world.conserved().expect("it is coupled");
            scale = scale.max(now.kinetic + now.vibration + now.elastic);
            let left = now.energy() - first - world.ledger().total();
            assert!(left.abs() < 1e-5 * scale, "{name}: {left:e} at {} s", world.time());
        }
    }
}

/// What damping takes is accounted for where a step is longer than an oscillation, also if the step begins before the impact.
#[test]
fn the_ledger_follows_oscillations_shorter_than_a_step() {
    for speed in [8.0, 40.0] {
        let text = "dt = 0.5\n[material]\ndamping = 0.6\n[influence]\ncore_width = 0.0\nalpha = 400.0\n".to_owned()
            + &free("a", [0.0; 3], [0.0; 3])
            + &free("b", [45.0, 0.0, 0.0], [-speed, 0.0, 0.0]);
        let mut world = World::new(scene(&text)).unwrap();
        let first = world.conserved().unwrap().energy();
        run(&mut world, 20);
        let (left, ledger) = (world.conserved().unwrap().energy() - first - world.ledger().total(), world.ledger());
        assert!(ledger.damping < -0.1 && left.abs() < 1e-5, "{speed}: {left:e} of {ledger:?}");
    }
}

/// Late in a run, an instant at the rim of a core is known to a rounding of the time: steps end there all the same.
#[test]
fn steps_end_at_a_rim_late_in_a_run() {
    let text = "dt = 0.5\n[influence]\nalpha = 400.0\n".to_owned()
        + &free("a", [0.0; 3], [0.0; 3])
        + &free("b", [24_005.0, 0.0, 0.0], [-8.0, 0.0, 0.0]);
    let text = format!("duration = 4000.0\n{text}");
    let mut world = World::new(Scene::parse(&text, "late.toml").unwrap()).unwrap();
    run(&mut world, 5999);
    for _ in 0..6 {
        let report = world.step();
        assert!(report.failure.is_none() && report.shortfall.is_none(), "{report:?}");
        assert!(report.substeps < 500, "{} steps", report.substeps);
    }
}

/// A world that is asked for states within every step keeps them during the step, one that is asked once repeats that step:
/// both give the same bits.
#[test]
fn states_within_a_step_are_the_same_if_the_step_is_repeated() {
    for (name, asked) in [("collide", 50), ("drop", 45)] {
        let scene = Scene::builtin(name).expect("built in");
        let all: Vec<usize> = (0..scene.bodies.len()).collect();
        let states = |from: u64| {
            let mut world = World::new(scene.clone()).expect("it fits");
            let schema = Simulation::schema(&world);
            let [mut before, mut now, mut within] = std::array::from_fn(|_| Frame::default());
            for step in 1..=asked {
                world.observe(Want::default(), &mut before);
                assert!(world.step().failure.is_none(), "{name}");
                world.observe(Want::default(), &mut now);
                if step >= from {
                    let time = 0.7 * now.at.time + 0.3 * before.at.time;
                    state_within(&world, &schema, [&before, &now], time, &all, &mut within);
                }
            }
            // more than what interpolates the ends
            let (mut plain, time) = (Frame::default(), 0.7 * now.at.time + 0.3 * before.at.time);
            between(&schema, [&before, &now], time, &all, &mut plain);
            let states = |frame: Frame| {
                frame.bodies.into_iter().map(|body| (body.centre, body.displacements)).collect::<Vec<_>>()
            };
            let within = states(within);
            assert_ne!(within, states(plain), "{name}");
            within
        };
        assert_eq!(states(1), states(asked), "{name}");
    }
}

/// States within a step are those of another solution, with steps an eighth as long.
#[test]
fn states_within_a_step_follow_the_solution() {
    const PARTS: u32 = 8;
    for (name, steps) in [("collide", 60), ("drop", 60), ("orbit", 60)] {
        let mut scene = Scene::builtin(name).expect("built in");
        scene.tolerance = 1e-9;
        let fine = Scene { dt: scene.dt / f64::from(PARTS), ..scene.clone() };
        let [mut coarse, mut fine] = [scene, fine].map(|scene| World::new(scene).expect("it fits"));
        let all: Vec<usize> = (0..coarse.body_count()).collect();
        let [mut before, mut now, mut within, mut expected] = std::array::from_fn(|_| Frame::default());
        let schema = Simulation::schema(&coarse);
        let mut worst = 0.0f64;
        for _ in 0..steps {
            coarse.observe(Want::default(), &mut before);
            assert!(coarse.step().failure.is_none(), "{name}");
            coarse.observe(Want::default(), &mut now);
            for _ in 0..PARTS {
                assert!(fine.step().failure.is_none(), "{name}");
                fine.observe(Want::default(), &mut expected);
                let time = fine.time().min(coarse.time());
                state_within(&coarse, &schema, [&before, &now], time, &all, &mut within);
                for ((now, then), body) in expected.bodies.iter().zip(&within.bodies).zip(coarse.bodies()) {
                    let place = |frame: &BodyFrame| {
                        let vectors = frame.displacements.iter().enumerate();
                        let place = |(i, x)| frame.centre + frame.rotation * body.rest(i) + x;
                        vectors.map(place).collect::<Vec<_>>()
                    };
                    let distance = place(now).iter().zip(place(then)).map(|(x, y)| x.distance(y)).fold(0.0, f64::max);
                    worst = worst.max(distance / body.scene().radius);
                }
            }
        }
        assert!(worst < 3e-7, "{name}: {worst:e}");
    }
}
