//! `[[edit]]`: other values from an instant on.

use glam::DVec3;
use meldscope::{
    Scene, World,
    observe::{Frame, Simulation as _, Want},
    scene::{Integrator, template::Override},
    sim::{Event, Failure, Options},
};
use pulp::Arch;

/// A scene whose bodies, at a distance of q from 1.3 to 0.95 and back, merge and split.
const PATHS: &str = "duration = 3.0
dt = 0.02
[[body]]
name = \"a\"
radius = 1.0
motion = { fixed = [0, 0, 0] }
[[body]]
name = \"b\"
radius = 0.8
motion = { sine = { center = [2.1, 0.1, 0], amplitude = [0.4, 0, 0], frequency = 0.5, phase = 1.2 } }
[[body]]
name = \"c\"
radius = 0.7
motion = { line = { from = [0, 3.0, 0], velocity = [0, -0.7, 0.1] } }
";

/// Two free bodies that fall onto a plane and onto each other.
const FREE: &str = "duration = 2.0
dt = 0.02
gravity = [0, 0, -4]
[[body]]
name = \"a\"
radius = 1.0
shape = { sphere = { stacks = 6, slices = 8 } }
motion = { free = { from = [0, 0, 1.1] } }
[[body]]
name = \"b\"
radius = 0.8
shape = { sphere = { stacks = 6, slices = 8 } }
motion = { free = { from = [0.3, 0.2, 3.2], spin = [0.4, 0.1, 0] } }
[[plane]]
normal = [0, 0, 1]
stiffness = 900.0
";

fn scene(text: &str) -> Scene {
    Scene::parse(text, "edits.toml").unwrap_or_else(|error| panic!("{error}\n{text}"))
}

fn edit(time: f64, set: &str) -> String {
    format!("[[edit]]\ntime = {time:?}\nset = {{ {set} }}\n")
}

/// Runs a scene to its end; returns the world and all events.
fn run(scene: &Scene) -> (World, Vec<Event>) {
    let mut world = World::new(scene.clone()).expect("enough memory");
    let mut events = Vec::new();
    for _ in 0..scene.steps() {
        let report = world.step();
        assert_eq!(report.failure, None);
        assert!(report.events.iter().all(|event| event.step == report.step));
        events.extend(report.events.iter().cloned());
    }
    (world, events)
}

/// The largest distance between equal vertices of two worlds.
fn distance(one: &World, other: &World) -> f64 {
    let pairs = one.bodies().zip(other.bodies());
    pairs
        .flat_map(|(a, b)| (0..a.vertex_count()).map(move |i| a.position(i).distance(b.position(i))))
        .fold(0.0, f64::max)
}

#[test]
fn an_edit_sets_each_number_once() {
    let set = "'body.a.damping' = 1.0, 'body[0].damping' = 2.0";
    let error = Scene::parse(&format!("{PATHS}{}", edit(0.1, set)), "edits.toml").expect_err("set twice").to_string();
    assert!(error.contains("body[0].damping sets body.a.damping again"), "{error}");
    let twice = [
        "'body.a.damping' = 1.0, 'body.b.damping' = 2.0, 'gravity[2]' = -1.0",
        "'gravity[0]' = 1.0, 'gravity[1]' = 1.0",
    ];
    scene(&format!("{PATHS}{}{}{}", edit(0.1, twice[0]), edit(0.2, twice[0]), edit(0.3, twice[1])));
}

#[test]
fn an_edit_after_the_end_changes_nothing() {
    for text in [PATHS, FREE] {
        let (plain, events) = run(&scene(text));
        for time in [5.0, scene(text).duration] {
            let (edited, same) = run(&scene(&format!("{text}{}", edit(time, "\"influence.merge_at\" = 1.1"))));
            assert_eq!((plain.checksum(), &events), (edited.checksum(), &same));
        }
    }
}

/// An edit that sets what holds already only divides a step.
#[test]
fn an_edit_to_the_same_values_changes_nothing_beyond_the_tolerance() {
    let set = "\"influence.alpha\" = 100, \"material.omega\" = 12, \"body.a.damping\" = 1.5";
    for (text, allowed) in [(PATHS, 3e-6), (FREE, 2e-4)] {
        for time in [0.0, 0.4, 1.2345, 1.9] {
            let ((plain, events), (edited, same)) =
                (run(&scene(text)), run(&scene(&format!("{text}{}", edit(time, set)))));
            let apart = distance(&plain, &edited);
            assert!(apart < allowed, "{time}: {apart:e}");
            assert_eq!(events.len(), same.len(), "{time}");
            for (one, other) in events.iter().zip(&same) {
                assert!((one.time - other.time).abs() < allowed, "{time}: {one:?} {other:?}");
            }
        }
    }
}

/// At t = 0, an edit of strengths and oscillators equals the scene with these values.
#[test]
fn an_edit_at_the_start_equals_the_edited_scene() {
    for text in [PATHS, FREE] {
        let set = "\"influence.beta\" = 70, \"material.damping\" = 2.5, \"body.b.omega\" = 9";
        let (edited, _) = run(&scene(&format!("{text}{}", edit(0.0, set))));
        let changed = text.replacen("[[body]]", "[influence]\nbeta = 70\n[material]\ndamping = 2.5\n[[body]]", 1);
        let changed = changed.replace("radius = 0.8\n", "radius = 0.8\nomega = 9.0\n");
        let (plain, _) = run(&scene(&changed));
        let apart = distance(&plain, &edited);
        assert!(apart < 1e-4, "{apart:e}");
    }
}

/// Against runs of steps so short that the edit is at the end of one, by classical Runge-Kutta.
#[test]
fn edited_runs_agree_with_an_independent_integrator() {
    let sets = [
        "\"influence.alpha\" = 90, \"influence.beta\" = 30",
        "\"material.omega\" = 7, \"body.b.damping\" = 4.0",
        "\"influence.merge_at\" = 1.15, \"influence.split_at\" = 1.22",
        "\"influence.reach\" = 1.2",
        "\"body.b.reach\" = 1.8",
    ];
    for (text, step) in [(PATHS, 0.0005), (FREE, 0.00025)] {
        let own = if text == FREE {
            "gravity = [1, 0, -2], \"plane[0].stiffness\" = 500"
        } else {
            "\"influence.beta\" = 160"
        };
        for set in sets.into_iter().chain([own]) {
            let text = format!("{}{}", text.replace("duration = 3.0", "duration = 2.0"), edit(0.83, set));
            let exact = scene(&text);
            let (exact, _) = run(&Scene { tolerance: 1e-8, ..exact });
            let short = Scene { dt: step, integrator: Integrator::Rk4, ..scene(&text) };
            let (short, _) = run(&short);
            let apart = distance(&exact, &short);
            // events fall inside steps of rk4, which is of first order there
            assert!(apart < 0.02, "{set}: {apart:e}");
        }
    }
}

#[test]
fn a_threshold_that_passes_q_changes_the_phase_at_once() {
    // before the bodies merge by themselves
    let path = |index: usize| scene(PATHS).bodies[index].path().expect("a path").position(0.505);
    let q = path(0).distance(path(1)) / 1.8;
    assert!(q > 1.15, "{q}");
    for text in
        [PATHS.to_owned(), PATHS.replacen("[[body]]", "[influence]\ncore_at = 0.5\ncore_width = 0.2\n[[body]]", 1)]
    {
        let set = format!("\"influence.merge_at\" = {}, \"influence.split_at\" = {}", q + 0.05, q + 0.3);
        let back = "\"influence.merge_at\" = 0.7, \"influence.split_at\" = 0.8";
        let (_, events) = run(&scene(&format!("{text}{}{}", edit(0.505, &set), edit(0.7003, back))));
        let found: Vec<(&str, f64)> = events
            .iter()
            .filter(|event| (event.a, event.b) == (0, 1))
            .map(|event| (event.name(), event.time))
            .collect();
        assert_eq!(found, [("merge", 0.505), ("split", 0.7003)]);
    }
}

/// What an edit brings to free bodies is in the ledger: the rest of the energy stays accounted for.
#[test]
fn the_ledger_has_the_energy_of_edits() {
    let set = "gravity = [0, 0.5, -9], \"material.omega\" = 16, \"influence.alpha\" = 90, \"influence.merge_at\" = 1.1, \
               \"plane[0].stiffness\" = 1500";
    let first = World::new(scene(FREE)).expect("enough memory").conserved().expect("free bodies").energy();
    // at the start, at the end of a step, and within one
    for time in [0.0, 0.74, 0.7312] {
        let (world, _) = run(&Scene { tolerance: 1e-7, ..scene(&format!("{FREE}{}", edit(time, set))) });
        let (now, ledger) = (world.conserved().expect("free bodies").energy(), world.ledger());
        assert!(ledger.edits.abs() > 1.0, "{time}: {ledger:?}");
        let left = now - first - ledger.total();
        assert!(left.abs() < 1e-5 * now.abs().max(1.0), "{time}: {left:e} of {now}, {ledger:?}");
        assert_eq!(scalar(&world, "brought_by_edits"), Some(ledger.edits));
    }
}

/// A scalar of the state of a world, if it has it.
fn scalar(world: &World, name: &str) -> Option<f64> {
    let mut frame = Frame::default();
    world.observe(Want::ALL, &mut frame);
    let number = world.schema().scalars.iter().position(|scalar| scalar.name == name)?;
    Some(frame.scalars[number])
}

/// Only the solver of bodies on paths knows the energy of the influence: in a coupled scene without free bodies it is left
/// out, and no zero.
#[test]
fn coupled_scenes_of_bodies_on_paths_show_no_energy_of_the_influence() {
    let gradual = PATHS.replacen("[[body]]", "[influence]\ncore_at = 0.5\ncore_width = 0.2\n[[body]]", 1);
    for (text, has_influence) in [(PATHS, true), (&gradual, false), (FREE, true)] {
        let (world, _) = run(&scene(text));
        assert_eq!(scalar(&world, "energy_influence").is_some(), has_influence);
        assert!(scalar(&world, "energy_elastic").is_some_and(|energy| energy > 0.0));
        assert_eq!(world.account().is_some(), text == FREE);
        assert_eq!(scalar(&world, "brought_by_edits"), None);
    }
}

/// Many edits at random times, of everything that an edit can set: finite, and the same bits for another instruction set
/// and for a world that is looked at.
#[test]
fn random_edits_keep_every_world_sound() {
    let mut state = 20_061_125_u64;
    let mut random = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as f64 / (1u64 << 31) as f64
    };
    for case in 0..60 {
        let mut text = if case % 2 == 0 { PATHS } else { FREE }.to_owned();
        text += "[[point]]\nname = \"p\"\nmotion = { fixed = [0.5, 0, 1] }\nradius = 1.0\nact = \"attract\"\nalpha = 20\nstart = 0.3\n";
        for _ in 0..1 + (3.0 * random()) as usize {
            let set = match (8.0 * random()) as usize {
                0 => format!("\"influence.merge_at\" = {:?}, \"influence.split_at\" = 1.3", 0.9 + 0.3 * random()),
                1 => {
                    format!("\"influence.alpha\" = {:?}, \"influence.beta\" = {:?}", 200.0 * random(), 90.0 * random())
                }
                2 => format!("\"material.omega\" = {:?}", 4.0 + 16.0 * random()),
                3 => format!("\"body.a.damping\" = {:?}", 6.0 * random()),
                4 => format!("gravity = [{:?}, 0, -3]", random()),
                5 => format!("\"point.p.alpha\" = {:?}, \"point.p.radius\" = {:?}", 60.0 * random(), 0.5 + random()),
                6 => format!("\"influence.reach\" = {:?}", 1.1 + 0.6 * random()),
                _ => format!("\"body.b.reach\" = {:?}", 0.9 + random()),
            };
            text += &edit(2.0 * random(), &set);
        }
        let scene = scene(&text);
        let mut world = World::new(scene.clone()).expect("enough memory");
        let options = Options { arch: Arch::Scalar, ..Options::default() };
        let (mut seen, mut frame) =
            (World::with_options(scene.clone(), options).expect("enough memory"), Frame::default());
        for _ in 0..scene.steps() {
            let _ = seen.step();
            seen.observe(Want::default(), &mut frame);
            let failure = world.step().failure.clone();
            assert_eq!(world.checksum(), seen.checksum(), "{text}");
            if let Some(failure) = failure {
                assert!(matches!(failure, Failure::Overworked(_)), "{failure}\n{text}");
                break;
            }
            assert!(world.bodies().all(|body| (0..body.vertex_count()).all(|i| body.position(i).is_finite())));
            assert!(world.bodies().all(|body| body.positions().all(|at: DVec3| at.length() < 1e3)));
        }
    }
}

/// Where centres coincide, q does not change in any direction.
#[test]
fn an_event_of_coinciding_centres_has_a_rate_of_zero() {
    let fixed = |name: &str| format!("[[body]]\nname = \"{name}\"\nradius = 1.0\nmotion = {{ fixed = [0, 0, 0] }}\n");
    let text = format!("duration = 1.0\n{}{}{}", fixed("a"), fixed("b"), edit(0.5, "\"influence.core_at\" = 0.5"));
    let (_, events) = run(&scene(&text));
    assert!(!events.is_empty() && events.iter().all(|event| event.rate == 0.0), "{events:?}");
}

/// What an edit sets can be given another value from outside, like every other key.
#[test]
fn values_of_edits_can_be_varied() {
    let text = format!("{PATHS}[[edit]]\ntime = 0.5\nset = {{ \"influence.merge_at\" = 1.1 }}\n");
    let varied = Override::parse("edit[0].set[\"influence.merge_at\"]=1.02").expect("a key and a value");
    let varied = Scene::parse(&text, "edit.toml").expect("a valid scene").with(&[varied], "edit.toml");
    let written = Scene::parse(&text.replace("= 1.1 ", "= 1.02 "), "edit.toml").expect("a valid scene");
    assert_eq!(run(&varied.expect("a valid scene")).0.checksum(), run(&written).0.checksum());
}
