//! Every force term, in every model and integrator: what is observed as the net force is what moves the vertices.

use std::collections::BTreeSet;

use glam::DVec3;
use meldscope::{
    Scene, World,
    bench::reference::{Accuracy, Reference},
    geometry::Vectors,
    models::SceneRun,
    observe::{Experiment, Frame, Schema, StepSummary, Want},
    scene::{Integrator, Model},
    sim::{Cause, Options},
};

/// Step of the scenes [s]: a few thousandths of the shortest time scale of an oscillator in them.
const STEP: f64 = 2e-4;
/// Upper limit on the difference between a second difference and the net force [largest net force on the body]. Measured:
/// at most 6.2e-3 of `mps`, whose springs act on predicted positions; of the others 9.7e-5 on paths, and 3.1e-3 free.
fn bound(integrator: Integrator, is_free: bool) -> f64 {
    match (integrator, is_free) {
        (Integrator::Mps, _) => 8e-3,
        (_, false) => 1.5e-4,
        (_, true) => 4e-3,
    }
}

/// What both scenes have: force points, a push, and a body `a` with others merged with it, apart from it and in its core.
const COMMON: &str = r#"
duration = 0.06
dt = 2e-4
tolerance = 1e-8
[influence]
core_at = 0.5
[lattice]
cells = 4
[fem]
cells = 4
[[point]]
name = "pulls"
motion = { line = { from = [-2.2, 0.3, 0.0], velocity = [0.5, 0.0, 0.0] } }
radius = 0.8
act = "attract"
[[point]]
name = "repels"
motion = { fixed = [0.0, -2.1, 0.2] }
radius = 1.2
act = "repel"
beta = 80.0
bodies = ["a"]
start = 0.02
duration = 0.02
[[push]]
body = "a"
direction = [1, 0.5, 0]
strength = 30.0
start = 0.01
duration = 0.03
"#;

fn body(name: &str, motion: &str) -> String {
    format!(
        "[[body]]\nname = \"{name}\"\nradius = 1.0\nshape = {{ sphere = {{ stacks = 6, slices = 8 }} }}\nmotion = {{ {motion} }}\n"
    )
}

fn on_paths() -> String {
    COMMON.to_owned()
        + &body("a", "sine = { center = [0, 0, 0], amplitude = [0.02, 0, 0], frequency = 2.0 }")
        + &body("merged", "fixed = [2.05, 0, 0]")
        + &body("apart", "fixed = [0, 2.34, 0]")
        + &body("core", "fixed = [0, 0, 0.9]")
}

fn free() -> String {
    let planes = "[[plane]]\nnormal = [0, 0, 1]\noffset = -0.98\nstiffness = 1000.0\nfriction = 0.5\nslip = 1.0\n";
    format!("gravity = [0, 0, -9.81]\n{COMMON}{planes}")
        + &body("a", "free = { from = [0, 0, 0], velocity = [0.1, 0, 0], spin = [0, 0.3, 0] }")
        + &body("merged", "free = { from = [2.05, 0, 0] }")
        + &body("apart", "line = { from = [0, 2.34, 0], velocity = [0, 0.02, 0] }")
        + &body("core", "free = { from = [0, 0, 0.9] }")
        + &body("swung", "sine = { center = [-2.05, 0, 0.4], amplitude = [0.02, 0, 0], frequency = 2.0 }")
}

/// Positions of the vertices of each body: of a free one in the world, of another relative to its centre.
fn places(schema: &Schema, frame: &Frame) -> Vec<Vec<DVec3>> {
    let mut local = Vectors::default();
    let of = |(now, body): (&meldscope::observe::BodyFrame, &meldscope::observe::schema::BodySchema)| {
        now.local_positions(now.rest_of(body), &mut local);
        let centre = if body.is_free { now.centre } else { DVec3::ZERO };
        local.iter().map(|place| place + centre).collect()
    };
    frame.bodies.iter().zip(&schema.bodies).map(of).collect()
}

/// Runs a scene and compares second differences of positions with net forces. Returns the largest difference, and adds the
/// terms that acted to `acted`; `None` if the model does not support the integrator.
fn compare(scene: &Scene, acted: &mut BTreeSet<&'static str>) -> Option<f64> {
    let run = SceneRun { scene: scene.clone(), options: Options::default() };
    let (mut simulation, schema) = (run.start().ok()?, run.schema());
    let terms: Vec<&'static str> = Cause::of(scene).map(Cause::name).collect();
    assert_eq!(terms, schema.terms.iter().map(|term| term.name).collect::<Vec<_>>());
    let mut jumps: Vec<f64> = scene.pushes.iter().flat_map(|push| [push.start, push.end()]).collect();
    jumps.extend(scene.points.iter().flat_map(|point| [point.start, point.end()]));
    let (mut frames, mut summary, mut worst) = (Vec::new(), StepSummary::default(), 0.0);
    for step in 0..=scene.steps() {
        if step > 0 {
            summary.clear();
            simulation.step(&mut summary);
            assert_eq!(summary.failure, None, "{} {}", scene.model, scene.integrator);
            jumps.extend(summary.events.iter().map(|event| event.time));
        }
        let mut frame = Frame::default();
        simulation.observe(Want::ALL, &mut frame);
        frames.push(frame);
    }
    for [before, now, after] in frames.windows(3).map(|three| [&three[0], &three[1], &three[2]]) {
        let is_near = |t: &f64| (t - now.at.time).abs() < 2.5 * STEP;
        if jumps.iter().any(is_near) {
            continue;
        }
        let [earlier, here, later] = [before, now, after].map(|frame| places(&schema, frame));
        for (index, body) in now.bodies.iter().enumerate().filter(|(_, body)| body.has_forces) {
            let names =
                terms.iter().zip(&body.terms).filter(|(_, term)| term.accelerations.iter().any(|f| f != DVec3::ZERO));
            acted.extend(names.map(|(name, _)| name));
            let of_body = &schema.bodies[index];
            let sum = &body.terms[body.terms.len() - 1];
            let net = &sum.accelerations;
            let largest = net.iter().map(DVec3::length).fold(0.0, f64::max);
            if let Some(whole) = body.net_force {
                let apart = body.mean_acceleration(of_body, sum).distance(whole.force / whole.mass);
                assert!(apart < 1e-12 * largest.max(1.0), "{}: net force, {apart}", scene.model);
                let internal =
                    terms.iter().zip(&body.terms).filter(|(name, _)| ["restoring", "damping"].contains(name));
                for (name, term) in internal {
                    let mean = body.mean_acceleration(of_body, term).length();
                    assert!(mean < 1e-12 * largest.max(1.0), "{}: {name} is internal, {mean}", scene.model);
                }
            }
            for i in 0..net.len() {
                let second = (later[index][i] - 2.0 * here[index][i] + earlier[index][i]) / (STEP * STEP);
                let difference = second.distance(net.get(i)) / largest.max(1.0);
                worst = f64::max(worst, difference);
            }
        }
    }
    Some(worst)
}

/// The torque of linear forces on deformed finite elements does not turn a free body, nor does it stand in the forces.
#[test]
fn the_net_force_moves_finite_elements_far_from_rest() {
    let text =
        "dt = 2e-4\nduration = 0.35\nmodel = \"fem\"\n[material]\nomega = 15.0\ndamping = 0.0\n[fem]\ncells = 4\n\
                [influence]\ncore_at = 0.0\n"
            .to_owned()
            + &body("a", "free = { from = [0, 0, 0], velocity = [2, 0.5, 0], spin = [0.3, 0.2, 1] }")
            + &body("b", "free = { from = [1.9, 0.3, 0.2], velocity = [-1, 0, 0.3], spin = [1, -2, 0.4] }")
                .replace("radius = 1.0", "radius = 0.6\nmass = 3.0");
    let scene = Scene::parse(&text, "fem.toml").unwrap_or_else(|error| panic!("{error}"));
    let difference = compare(&scene, &mut BTreeSet::new()).expect("it can run");
    assert!(difference < 2e-3, "{difference:.1e}");
}

#[test]
fn the_net_force_moves_the_vertices() {
    let mut wrong = Vec::new();
    for model in [Model::Oscillators, Model::Lattice, Model::Fem] {
        let mut acted = BTreeSet::new();
        // a term that cannot act in either scene is not tested at all
        let expected: BTreeSet<&str> = Cause::ALL.into_iter().map(Cause::name).collect();
        for (is_free, text) in [(false, on_paths()), (true, free())] {
            let common = Scene::parse(&text, "forces.toml").unwrap_or_else(|error| panic!("{error}"));
            let mut supported = 0;
            for integrator in Integrator::ALL.into_iter().filter(|&integrator| integrator != Integrator::Thesis) {
                let scene = Scene { model, integrator, ..common.clone() };
                let Some(difference) = compare(&scene, &mut acted) else { continue };
                supported += 1;
                if !(difference < bound(integrator, is_free)) {
                    let kind = if is_free { "free" } else { "on paths" };
                    wrong.push(format!("{model}, {integrator}, {kind}: {difference:.1e}"));
                }
            }
            assert!(supported > 0, "{model}: no integrator");
        }
        assert_eq!(acted, expected, "{model}: terms that act");
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Points that pass, jump, and begin and cease to act within steps, on bodies that are at rest until then.
const POINTS: &str = r#"
duration = 1.5
[[point]]
name = "passes"
motion = { line = { from = [-3.0, 0.4, 0.0], velocity = [4.0, 0.0, 0.0] } }
radius = 0.9
act = "attract"
[[point]]
name = "jumps"
motion = { keyframes = { interpolation = "hold", keys = [[0, 9, 0, 0], [0.503, 0, 1.9, 0.3], [1.107, 9, 0, 0]] } }
radius = 0.7
act = "repel"
[[point]]
name = "acts"
motion = { sine = { center = [5.0, 0.3, 1.2], amplitude = [0.3, 0, 0], frequency = 2.0 } }
radius = 1.1
act = "attract"
alpha = 40.0
bodies = ["right"]
start = 0.211
duration = 0.333
"#;

fn with_points(left: &str, right: &str) -> String {
    POINTS.to_owned() + &body("left", left) + &body("right", right)
}

/// The largest error over what the tolerance allows, after every step; and the world at the end.
fn of_tolerance(text: &str) -> (f64, World) {
    let scene = Scene::parse(text, "points.toml").unwrap_or_else(|error| panic!("{error}"));
    let instants: Vec<f64> = (0..=scene.steps()).map(|step| step as f64 * scene.dt).collect();
    let reference = Reference::solve(&scene, &instants, Accuracy::DEFAULT).expect("quick");
    let mut world = World::new(scene).expect("enough memory");
    let mut worst = 0.0;
    for instant in 1..instants.len() {
        assert_eq!(world.step().failure, None);
        for (index, body) in world.bodies().enumerate() {
            let error = reference.error(index, &body, instant);
            worst = f64::max(worst, error / f64::max(world.scene().tolerance * world.time(), 1e-10));
        }
    }
    (worst, world)
}

#[test]
fn force_points_meet_the_tolerance() {
    let (worst, _) = of_tolerance(&with_points("fixed = [0, 0, 0]", "fixed = [5, 0, 0]"));
    assert!(worst < 1.0, "on paths: {worst}");
    let (worst, world) = of_tolerance(&with_points(
        "free = { from = [0, 0, 0] }",
        "free = { from = [5, 0, 0], velocity = [0, 0.1, 0] }",
    ));
    assert!(worst < 1.0, "free: {worst}");
    // what points bring is in the account of the energy
    let ledger = world.ledger();
    let now = world.conserved().expect("free bodies").energy();
    let first = 0.5 * world.scene().bodies[1].mass * 0.01;
    assert!(ledger.points.abs() > 1e-3, "{ledger:?}");
    // measured: 1.4e-7 of 15.2
    assert!((now - first - ledger.total()).abs() < 1e-7 * ledger.points.abs(), "{now} {first} {ledger:?}");
}

/// A point that never acts, or acts on none of the bodies, changes no bit.
#[test]
fn points_that_do_not_act_change_nothing() {
    for motions in [
        ["fixed = [0, 0, 0]", "sine = { center = [2, 0, 0], amplitude = [0.4, 0, 0], frequency = 0.7 }"],
        ["free = { from = [0, 0, 0] }", "free = { from = [2.2, 0, 0], velocity = [-0.4, 0, 0] }"],
    ] {
        let bodies = "duration = 1.0\n".to_owned() + &body("a", motions[0]) + &body("b", motions[1]);
        let far = body("far", "fixed = [90, 0, 0]");
        let point = |keys: &str| {
            let text = "[[point]]\nname = \"p\"\nmotion = { fixed = [0, 1, 0] }\nradius = 1.0\nact = \"attract\"\n";
            format!("{bodies}{far}{text}{keys}\n")
        };
        let run = |text: &str| -> Vec<u64> {
            let mut world = World::new(Scene::parse(text, "points.toml").expect("valid")).expect("enough memory");
            (0..world.scene().steps())
                .map(|_| {
                    let _ = world.step();
                    world.checksum()
                })
                .collect()
        };
        let without = run(&format!("{bodies}{far}"));
        for keys in ["start = 5.0", "duration = 0.0", "alpha = 0.0", "bodies = [\"far\"]"] {
            assert_eq!(run(&point(keys)), without, "{keys}");
        }
        assert_ne!(run(&point("")), without);
    }
}
