use std::f64::consts::PI;

use glam::DVec3;

use super::*;
use crate::{
    geometry::{Vectors, mesh::signed_volume_of},
    models::lattice::Constants,
    observe::{Frame, Simulation, StepSummary, Want},
    scene::TearMode,
    sim::{Cause, World},
};

fn scene(name: &str, model: Model) -> Scene {
    Scene { model, ..Scene::builtin(name).unwrap() }
}

fn start(scene: &Scene) -> Elastic {
    Elastic::new(scene.clone(), Options::default()).unwrap()
}

fn run(simulation: &mut Elastic, steps: u64) -> Vec<PairEvent> {
    let (mut summary, mut events) = (StepSummary::default(), Vec::new());
    for _ in 0..steps {
        summary.clear();
        simulation.step(&mut summary);
        assert_eq!(summary.failure, None);
        events.extend_from_slice(&summary.events);
    }
    events
}

/// Phases follow the paths, so the events are those of the oscillators. Their times are equal to rounding, because the
/// interval in which an event is searched for depends on which bodies may reach each other.
#[test]
fn events_are_those_of_the_oscillators() {
    for name in ["two", "three", "size_ratio"] {
        let mut world = World::new(scene(name, Model::Oscillators)).unwrap();
        let steps = world.scene().steps();
        let mut expected = Vec::new();
        for _ in 0..steps {
            expected
                .extend(world.step().events.iter().map(|event| (event.name(), event.time, event.a, event.b, event.q)));
        }
        assert!(!expected.is_empty());
        for model in [Model::Lattice, Model::Fem] {
            let events = run(&mut start(&scene(name, model)), steps);
            assert_eq!(events.len(), expected.len(), "{name} {model}");
            for (event, &(kind, time, a, b, q)) in events.iter().zip(&expected) {
                assert_eq!((event.name, event.a as u32, event.b as u32), (kind, a, b), "{name} {model}");
                let near = |found: f64, expected: f64| (found - expected).abs() <= 4.0 * f64::EPSILON * expected;
                assert!(near(event.time, time) && near(event.q, q), "{name} {model}: {} {time}", event.time);
            }
        }
    }
}

/// A free body far away changes no event of bodies on paths, not even where one jumps into another, and is not stepped
/// while nothing acts on it.
#[test]
fn a_free_body_elsewhere_changes_no_event() {
    let paths = "duration = 0.5\n[[body]]\nname = 'a'\nradius = 1.0\nmotion = { fixed = [0, 0, 0] }\n\
                 [[body]]\nname = 'b'\nradius = 1.0\nmotion = { keyframes = { keys = [[0, 9, 0, 0], [0.1, 1, 0, 0], [0.31, 9, 0, 0]], interpolation = 'hold' } }\n\
                 [[body]]\nname = 'c'\nradius = 1.0\nmotion = { sine = { center = [0, 2, 0], amplitude = [0, 1, 0], frequency = 2.5, phase = 0.0 } }\n";
    let free = "[[body]]\nname = 'z'\nradius = 1.0\nmotion = { free = { from = [90, 0, 0] } }\n";
    let mut world = World::new(Scene::parse(paths, "paths.toml").unwrap()).unwrap();
    let mut expected = Vec::new();
    for _ in 0..30 {
        expected.extend(world.step().events.iter().map(|event| (event.name(), event.time, event.a, event.b)));
    }
    assert!(expected.len() >= 6, "{expected:?}");
    for model in [Model::Lattice, Model::Fem] {
        for text in [paths.to_owned(), format!("{paths}{free}")] {
            let mut simulation = start(&Scene { model, ..Scene::parse(&text, "paths.toml").unwrap() });
            let events = run(&mut simulation, 30);
            assert_eq!(events.len(), expected.len(), "{model}");
            for (event, &(kind, time, a, b)) in events.iter().zip(&expected) {
                assert_eq!((event.name, event.a as u32, event.b as u32), (kind, a, b), "{model}");
                assert!((event.time - time).abs() < 1e-12, "{model}: {} {time}", event.time);
            }
            let resting = simulation.bodies.get(3).map(|body| body.statistics.substeps);
            assert!(resting.is_none_or(|steps| steps == 0), "{model}: {resting:?}");
        }
    }
}

/// "Too much force breaks springs locally" (2.1.1): strong attraction turns cells of a lattice inside out, which no spring
/// resists. With twice the ω none is.
#[test]
fn too_much_force_turns_cells_of_a_lattice_inside_out() {
    let inverted = |omega: f64| {
        let mut scene = scene("three", Model::Lattice);
        scene.bodies.iter_mut().for_each(|body| body.material.omega = omega);
        let (steps, mut simulation) = (scene.steps(), start(&scene));
        let is_inverted = |body: &Body, cell: u32| {
            let corners = body.corners()[cell as usize];
            let at = |i: usize| body.rest[corners[i] as usize] + body.x[corners[i] as usize];
            let [x, y, z] = [1, 2, 4].map(|i| at(i) - at(0));
            x.cross(y).dot(z) < 0.0
        };
        let mut most = 0;
        for _ in 0..steps {
            run(&mut simulation, 1);
            let cells = |body: &Body| {
                (0..body.surface.cells.cell_count() as u32).filter(|&cell| is_inverted(body, cell)).count()
            };
            most = most.max(simulation.bodies.iter().map(cells).sum());
        }
        most
    };
    let found = (inverted(12.0), inverted(24.0));
    assert!(found.0 > 20 && found.1 == 0, "{found:?}");
}

/// Results are bit-identical for any number of threads, with and without observation, in the built-in scenes on paths.
#[test]
fn bits_do_not_depend_on_threads_or_observers() {
    for (name, steps) in [("two", 120), ("three", 60), ("size_ratio", 60), ("push", 60), ("crowd", 3)] {
        for model in [Model::Lattice, Model::Fem] {
            let checksum = |threads: usize, observes: bool| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                pool.install(|| {
                    let mut simulation = start(&scene(name, model));
                    let mut frame = Frame::default();
                    for _ in 0..steps {
                        run(&mut simulation, 1);
                        if observes {
                            simulation.observe(Want::ALL, &mut frame);
                        }
                    }
                    simulation.checksum()
                })
            };
            let expected = checksum(1, false);
            assert_eq!([checksum(2, name != "crowd"), checksum(8, false)], [expected; 2], "{name} {model}");
        }
    }
}

/// One body that is pushed or carried, with additional lines for the scene and the body.
fn single(model: Model, scene: &str, body: &str) -> Scene {
    let text = format!(
        "duration = 4.0\nmodel = '{model}'\n{scene}\n[[body]]\nname = 'a'\nradius = 0.5\nshape = {{ sphere = {{ stacks = 6, slices = 8 }} }}\n{body}"
    );
    Scene::parse(&text, "single.toml").unwrap()
}

/// Lattice and finite elements with the same E and ν converge to the same body: displacements under constant
/// acceleration are equal up to the discretisation error, which decreases with the number of cells.
#[test]
fn lattice_and_elements_agree() {
    let sag = |model: Model, cells: u32| {
        let lines = format!("[material]\ndamping = 8.0\n[lattice]\ncells = {cells}\n[fem]\ncells = {cells}");
        // the path accelerates by 0.02 per s² from the start, almost constantly for a fifth of a period
        let motion = "motion = { sine = { center = [0, 0, 0], amplitude = [0, 0, 50.66], frequency = 0.003183, phase = 1.5707963267948966 } }";
        let mut simulation = start(&single(model, &lines, motion));
        run(&mut simulation, 240);
        let mut frame = Frame::default();
        simulation.observe(Want::default(), &mut frame);
        frame.bodies[0].displacement(0).z
    };
    let difference = |cells| sag(Model::Lattice, cells) / sag(Model::Fem, cells) - 1.0;
    let [coarse, fine] = [4, 8].map(difference);
    assert!(coarse.abs() < 0.6 && fine.abs() < 0.6 * coarse.abs(), "{coarse} {fine}");
}

/// Smaller steps converge to the same state, in second order where nothing jumps.
#[test]
fn steps_converge() {
    for model in [Model::Lattice, Model::Fem] {
        let end = |dt: f64, integrator: Integrator| {
            let motion =
                "motion = { sine = { center = [0, 0, 0], amplitude = [0.3, 0, 0], frequency = 0.5, phase = 0.0 } }";
            let scene = single(model, &format!("dt = {dt}"), motion);
            let mut simulation = start(&Scene { integrator, ..scene });
            run(&mut simulation, (1.0 / dt).round() as u64);
            simulation.bodies[0].x.clone()
        };
        let integrator = if model == Model::Lattice { Integrator::Verlet } else { Integrator::Exponential };
        let states = [1.0 / 200.0, 1.0 / 400.0, 1.0 / 800.0].map(|dt| end(dt, integrator));
        let difference = |a: &[DVec3], b: &[DVec3]| a.iter().zip(b).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
        let ratio = difference(&states[0], &states[1]) / difference(&states[1], &states[2]);
        assert!((3.0..5.0).contains(&ratio), "{model}: {ratio}");
        assert!(states[2].iter().any(|x| x.length() > 1e-3));
    }
}

/// At a sharp turn of a path, nodes that are not held keep their velocity; at t = 0 everything is at rest, however the
/// path begins.
#[test]
fn sharp_turns_kick_the_nodes() {
    for model in [Model::Lattice, Model::Fem] {
        let path = |keys: &str| {
            format!(
                "motion = {{ keyframes = {{ keys = {keys}, interpolation = 'linear' }} }}\nomega = 1.0\ndamping = 0.0"
            )
        };
        let mut simulation = start(&single(model, "dt = 0.001", &path("[[0, 0, 0, 0], [1, 1, 0, 0], [2, 1, 0, 0]]")));
        run(&mut simulation, 900);
        assert!(simulation.bodies[0].is_at_rest, "{model}");
        run(&mut simulation, 101);
        let body = &simulation.bodies[0];
        for (node, velocity) in body.u.iter().enumerate().filter(|(node, _)| !body.held()[*node]) {
            assert!(velocity.distance(DVec3::X) < 0.02, "{model}: {node} {velocity}");
        }
    }
}

/// Second order with a jump on the boundary of a step: of a force, of the acceleration or of the velocity of the path; of pushes
/// on a body that spins as well. The nodes of a body at rest do not move before the jump.
#[test]
fn jumps_on_boundaries_of_steps_keep_the_order() {
    let at_rest = "motion = { fixed = [0, 0, 0] }";
    let push = "[[push]]\nbody = 'a'\ndirection = [0, 0, 1]\nstrength = 5.0\n";
    let spline = "motion = { keyframes = [[0.1, 0, 0, 0], [0.3, 0.4, 0, 0], [0.9, 0, 0, 0]] }";
    let corner = "motion = { keyframes = { keys = [[0, 0, 0, 0], [0.1, 0, 0, 0], [0.9, 0.8, 0, 0]], interpolation = 'linear' } }";
    let free = "motion = { free = { from = [0, 0, 0], spin = [3, 0, 0] } }";
    let far_plane = "\n[[plane]]\nnormal = [0, 0, 1]\noffset = -99.0\n";
    for (what, body, is_smooth) in [
        ("a push begins", format!("{at_rest}\n{push}start = 0.1\nduration = 9.0"), false),
        ("a push ends", format!("{at_rest}\n{push}start = 0.0\nduration = 0.1"), true),
        (
            "a point acts",
            format!(
                "{at_rest}\n[[point]]\nname = 'p'\nmotion = {{ fixed = [0.6, 0, 0] }}\nradius = 0.5\nact = 'attract'\nstart = 0.1"
            ),
            false,
        ),
        (
            "a source jumps away",
            format!(
                "{at_rest}\n[[body]]\nname = 'b'\nradius = 0.5\nmotion = {{ keyframes = {{ keys = [[0, 0.9, 0, 0], [0.1, 50, 0, 0]], interpolation = 'hold' }} }}"
            ),
            true,
        ),
        ("a spline begins", spline.to_owned(), false),
        ("a path turns", corner.to_owned(), false),
        ("a spline begins, coupled", format!("{spline}{far_plane}"), false),
        ("a path turns, coupled", format!("{corner}{far_plane}"), false),
        ("a spinning body is pushed", format!("{free}\n{push}start = 0.1\nduration = 0.1"), true),
    ] {
        for (model, integrator) in [(Model::Lattice, Integrator::Verlet), (Model::Fem, Integrator::Exponential)] {
            let end = |dt: f64| {
                let scene = single(model, &format!("dt = {dt:?}"), &body);
                let mut simulation = start(&Scene { integrator, ..scene });
                run(&mut simulation, (0.1 / dt).round() as u64);
                let moved = simulation.bodies[0].x.iter().any(|x| *x != DVec3::ZERO);
                assert!(is_smooth || !moved, "{model}, {what}: moves before");
                run(&mut simulation, (0.2 / dt).round() as u64);
                simulation.bodies[0].x.clone()
            };
            let states = [1.0 / 200.0, 1.0 / 400.0, 1.0 / 800.0].map(end);
            let difference =
                |a: &[DVec3], b: &[DVec3]| a.iter().zip(b).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
            let ratio = difference(&states[0], &states[1]) / difference(&states[1], &states[2]);
            assert!((3.8..4.3).contains(&ratio), "{model}, {what}: {ratio}");
            assert!(states[2].iter().any(|x| x.length() > 1e-3), "{model}, {what}");
        }
    }
}

/// An explicit scheme at a dt beyond the limit diverges, and reports the limit; the default divides dt.
#[test]
fn instability_is_reported() {
    let scene = Scene { integrator: Integrator::Euler, dt: 0.05, ..scene("two", Model::Lattice) };
    let mut simulation = start(&scene);
    let mut summary = StepSummary::default();
    let failure = (0..2000).find_map(|_| {
        summary.clear();
        simulation.step(&mut summary);
        summary.failure.clone()
    });
    let Some(StepFailure::Diverged(words)) = failure else { panic!("{failure:?}") };
    assert!(words.contains("stable below") && words.contains("euler"), "{words}");
    run(&mut start(&Scene { integrator: Integrator::Exponential, ..scene }), 100);
}

/// Stability over decades of dt, ω, κ, α, β and mass. Every case ends, and every failure is reported. (`bench stability
/// --model` runs a thousand.)
#[test]
fn hard_cases_end() {
    const CASES: u32 = 8;
    let mut state = 1u64;
    let mut decades = |low: f64, high: f64| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        low * (high / low).powf((state >> 33) as f64 / f64::from(1u32 << 31))
    };
    let mut outcomes = [[0; 3]; 2];
    for _ in 0..CASES {
        let (dt, omega, damping) = (decades(1e-3, 0.3), decades(1.0, 300.0), decades(0.01, 300.0));
        let (alpha, beta, mass) = (decades(1.0, 1e4), decades(1.0, 1e4), decades(1e-3, 1e3));
        for (i, model) in [Model::Lattice, Model::Fem].into_iter().enumerate() {
            let mut scene = scene("two", model);
            (scene.dt, scene.influence.alpha, scene.influence.beta) = (dt, alpha, beta);
            for body in &mut scene.bodies {
                (body.material.omega, body.material.damping, body.mass) = (omega, damping, mass);
            }
            let mut simulation = start(&scene);
            let mut summary = StepSummary::default();
            let mut outcome = 0;
            for _ in 0..(scene.duration / dt).ceil().min(60.0) as u64 {
                summary.clear();
                simulation.step(&mut summary);
                match &summary.failure {
                    None => assert!(simulation.bodies.iter().all(|body| body.extent.is_finite())),
                    Some(StepFailure::Diverged(_)) => outcome = 1,
                    Some(_) => outcome = 2,
                }
                if outcome > 0 {
                    break;
                }
            }
            outcomes[i][outcome] += 1;
        }
    }
    assert_eq!(outcomes.map(|[completed, ..]| completed), [CASES - outcomes[0][2], CASES]);
}

/// A soft ball falls on a plane too fast for its springs: they let it through itself, and it stays flat.
#[test]
fn a_body_that_collapses_is_an_event() {
    let text = "duration = 1.0\nmodel = 'lattice'\ngravity = [0, 0, -9.81]\n[material]\nomega = 25.0\ndamping = 4.0\n\
                [[plane]]\nnormal = [0, 0, 1]\n[[body]]\nname = 'ball'\nradius = 0.6\n\
                motion = { free = { from = [0, 0, 3.0] } }\n";
    let mut simulation = start(&Scene::parse(text, "fall").unwrap());
    let schema = simulation.schema();
    let (mut summary, mut frame) = (StepSummary::default(), Frame::default());
    let (mut collapsed, mut volumes) = (Vec::new(), Vec::new());
    for _ in 0..60 {
        summary.clear();
        simulation.step(&mut summary);
        collapsed.extend(summary.body_events.iter().filter(|event| event.name == COLLAPSE.0).copied());
        simulation.observe(Want::default(), &mut frame);
        let (mesh, mut at) = (&schema.bodies[0].mesh, Vectors::default());
        frame.bodies[0].local_positions(mesh.at(0.6), &mut at);
        volumes.push(signed_volume_of(&at, mesh.triangles()));
    }
    let Some(event) = collapsed.first() else { panic!("{volumes:?}") };
    // the surface is that of the nodes, but for the cells that it cuts
    let first = volumes.iter().position(|volume| *volume < 0.2 * volumes[0]).unwrap() as u64 + 1;
    assert!(event.step.abs_diff(first) <= 3, "{event:?} {first}");
    assert!(volumes.iter().any(|volume| *volume < 0.0));
    assert!((-0.1..0.6).contains(&event.place.z), "{event:?}");
}

/// A body held by its core, shaken hard: `cut` loses volume and reports it, `split` does not; both change the frame's
/// mesh.
#[test]
fn both_tear_modes_show_in_frames() {
    let motion = "motion = { sine = { center = [0, 0, 0], amplitude = [3.0, 0, 0], frequency = 1.5, phase = 0.0 } }";
    for tear in [TearMode::None, TearMode::Cut, TearMode::Split] {
        let lines = format!("[lattice]\ntear = '{}'\nlimit = 0.3\ncells = 6", tear.name());
        let scene = single(Model::Lattice, &lines, motion);
        let mut simulation = start(&scene);
        run(&mut simulation, 60);
        let mut frame = Frame::default();
        simulation.observe(Want::ALL, &mut frame);
        let schema = simulation.schema();
        let value = |name: &str| {
            let at = schema.scalars.iter().position(|scalar| scalar.name == name);
            at.map(|at| frame.scalars[at])
        };
        let now = &frame.bodies[0];
        assert_eq!((now.mesh.is_some(), schema.bodies[0].can_tear), (tear != TearMode::None, tear != TearMode::None));
        assert_eq!(simulation.account().is_some(), tear != TearMode::None);
        match tear {
            TearMode::None => {}
            TearMode::Cut => assert!(value("volume_lost").is_some_and(|lost| lost > 0.0)),
            TearMode::Split => assert!(value("volume_lost").is_none() && value("split_nodes").is_some_and(|n| n > 0.0)),
        }
        if let Some(mesh) = &now.mesh {
            let first = simulation.bodies[0].surface.mesh.vertex_count();
            assert!(mesh.vertex_count() > first && mesh.triangles().iter().flatten().all(|&i| i as usize >= first));
            assert_eq!(now.displacements.len(), mesh.vertex_count());
            let mut edges = std::collections::HashMap::new();
            for &[a, b, c] in mesh.triangles() {
                [(a, b), (b, c), (c, a)].into_iter().for_each(|edge| *edges.entry(edge).or_insert(0) += 1);
            }
            assert!(edges.iter().all(|(&(a, b), count)| edges.get(&(b, a)) == Some(count)), "{}: open", tear.name());
        }
        assert!(
            frame.bodies[0]
                .terms
                .iter()
                .all(|term| term.accelerations.is_empty() || term.accelerations.len() == now.displacements.len())
        );
    }
}

/// Finite elements report where they would tear, once per cell, and continue.
#[test]
fn elements_report_where_they_would_tear() {
    let motion = "motion = { sine = { center = [0, 0, 0], amplitude = [1.0, 0, 0], frequency = 1.0, phase = 0.0 } }";
    let mut scene = single(Model::Fem, "[fem]\ntear_stress = 1.0", motion);
    let mut simulation = start(&scene);
    run(&mut simulation, 60);
    let account = simulation.account().unwrap();
    assert!(account.contains("would tear") && account.contains("\"a\""), "{account}");
    let torn = simulation.bodies[0].statistics.torn;
    assert!(torn > 0 && torn <= simulation.bodies[0].surface.cells.cell_count() as u64);
    scene.fem.tear_stress = Some(1e9);
    let mut simulation = start(&scene);
    run(&mut simulation, 60);
    assert_eq!(simulation.account(), None);
}

/// Planes press on the surface: a body lowered onto a plane by its path is dented.
#[test]
fn planes_dent_bodies() {
    let lines = "[[plane]]\nnormal = [0, 0, 1]\nfriction = 0.5\n[material]\nresponse = 'rigid'\ndamping = 6.0";
    let motion = "motion = { keyframes = [[0, 0, 0, 0.6], [1, 0.2, 0, 0.4], [9, 1, 0, 0.4]] }";
    for model in [Model::Lattice, Model::Fem] {
        let mut simulation = start(&single(model, lines, motion));
        run(&mut simulation, 120);
        let mut frame = Frame::default();
        simulation.observe(Want::ALL, &mut frame);
        let now = &frame.bodies[0];
        let lowest = now.positions.iter().map(|place| place.z + now.centre.z).fold(f64::INFINITY, f64::min);
        assert!((-0.05..0.02).contains(&lowest), "{model}: {lowest}");
        let names: Vec<&str> = Cause::of(&simulation.scene).map(Cause::name).collect();
        let pressed = &now.terms[names.iter().position(|name| *name == "plane").unwrap()].accelerations;
        assert!(pressed.iter().any(|force| force.z > 0.0), "{model}");
    }
}

/// A long push deforms a body to its static equilibrium (2.1) under the same load.
#[test]
fn a_long_push_leads_to_the_equilibrium() {
    let lines = "[material]\ndamping = 8.0\n[[push]]\nbody = 'a'\ndirection = [1, 0, 0]\nstrength = 0.5\nstart = 0.0\nduration = 9.0";
    let mut simulation = start(&single(Model::Fem, lines, "motion = { fixed = [0, 0, 0] }"));
    run(&mut simulation, 500);
    let body = &simulation.bodies[0];
    let body::Matter::Fem(finite) = &body.matter else { panic!() };
    let element = &finite.element;
    let load = element.free.iter().map(|&node| {
        let node = node as usize;
        DVec3::X * (0.5 * f64::max(0.0, -body.directions[node].x) * element.masses[node])
    });
    let mut expected: Vec<DVec3> = load.collect();
    element.factor(f64::INFINITY, u64::MAX, None).unwrap().equilibrium(&mut expected);
    let worst =
        element.free.iter().zip(&expected).map(|(&node, x)| body.x[node as usize].distance(*x)).fold(0.0, f64::max);
    let largest = expected.iter().map(|x| x.length()).fold(0.0, f64::max);
    assert!(worst < 1e-5 * largest, "{worst} of {largest}");
}

#[test]
fn unsupported_scenes_are_rejected() {
    let error = |scene: Scene| Elastic::new(scene, Options::default()).err().unwrap();
    for model in [Model::Lattice, Model::Fem] {
        let words = error(free(model, "", "rotation = 'fixed'"));
        assert!(words.contains("rotation") && words.contains(model.name()) && words.contains("oscillators"), "{words}");
        let words = error(Scene { integrator: Integrator::Rk4, ..scene("two", model) });
        assert!(words.contains("rk4"), "{words}");
        let words = error(single(model, "", "omega = 0.0\nmotion = { fixed = [0, 0, 0] }"));
        assert!(words.contains("omega"), "{words}");
        let mut large = scene("crowd", model);
        (large.lattice.cells, large.fem.cells) = (256, 256);
        let words = error(large);
        assert!(words.contains("cells") && words.contains("too large"), "{words}");
    }
    let words = error(Scene { integrator: Integrator::Euler, ..scene("two", Model::Fem) });
    assert!(words.contains("implicit"), "{words}");
    // springs so stiff that a step of the scene would take forever
    let mut hard = scene("two", Model::Lattice);
    hard.bodies[0].material.omega = 1e9;
    let mut simulation = start(&hard);
    let failure = (0..202).find_map(|_| {
        simulation.step(&mut StepSummary::default());
        simulation.failure.clone()
    });
    assert!(matches!(&failure, Some(StepFailure::NotTaken(words)) if words.contains("omega")), "{failure:?}");
}

/// Phase changes are searched for on the relative motion of two free bodies: these hardly move.
#[test]
fn bodies_that_fly_together_are_no_work_at_any_speed() {
    for model in [Model::Lattice, Model::Fem] {
        let text = format!(
            "duration = 0.1\nmodel = '{model}'\n\
             [[body]]\nname = 'a'\nradius = 1.0\nmotion = {{ free = {{ from = [0, 0, 0], velocity = [0, 0, -5e10] }} }}\n\
             [[body]]\nname = 'b'\nradius = 1.0\nmotion = {{ free = {{ from = [0.5, 0, 0.3], velocity = [0, 0, -5e10] }} }}\n"
        );
        run(&mut start(&Scene::parse(&text, "fast.toml").unwrap()), 2);
    }
}

/// The stiffness from ω: a bar one radius long has that frequency, by its closed form.
#[test]
fn stiffness_follows_omega() {
    let (omega, radius, density) = (12.0, 0.5, 3.0);
    let Constants { young, .. } = Constants::of(omega, 1.0, radius, density);
    assert!((PI / (2.0 * radius) * (young / density).sqrt() - omega).abs() < 1e-12);
}

/// One free body, with additional lines for the scene and its motion.
fn free(model: Model, scene: &str, motion: &str) -> Scene {
    let comma = if motion.is_empty() { "" } else { ", " };
    let body = format!("motion = {{ free = {{ from = [0.5, 0, 1.0]{comma}{motion} }} }}");
    single(model, scene, &body)
}

/// The scalars of a state.
fn scalar(simulation: &Elastic, name: &str) -> f64 {
    let mut frame = Frame::default();
    simulation.observe(Want::ALL, &mut frame);
    let schema = simulation.schema();
    frame.scalars[schema.scalars.iter().position(|scalar| scalar.name == name).unwrap()]
}

/// A falling body follows its parabola, and is not deformed.
#[test]
fn free_bodies_fall() {
    for model in [Model::Lattice, Model::Fem] {
        let mut simulation = start(&free(model, "gravity = [0, 0.5, -9.81]", "velocity = [1, 0, 2]"));
        run(&mut simulation, 60);
        let (mut frame, g) = (Frame::default(), DVec3::new(0.0, 0.5, -9.81));
        simulation.observe(Want::ALL, &mut frame);
        let expected = DVec3::new(0.5, 0.0, 1.0) + DVec3::new(1.0, 0.0, 2.0) + 0.5 * g;
        let now = &frame.bodies[0];
        assert!(now.centre.distance(expected) < 1e-12 && now.is_at_rest, "{model}: {} {expected}", now.centre);
        let velocity = now.motion.unwrap().velocity;
        assert!(velocity.distance(DVec3::new(1.0, 0.0, 2.0) + g) < 1e-12, "{model}: {velocity}");
    }
}

/// A spinning body conserves its angular momentum for three turns, and its energy up to the error of the step; its
/// shape rotates with it. The centrifugal stretch stays at its static value, of the order ω²ρR²/E.
#[test]
fn free_bodies_spin_without_growing() {
    for model in [Model::Lattice, Model::Fem] {
        let scene = free(model, "dt = 0.004\n[material]\ndamping = 0.0\nomega = 40.0", "spin = [0, 3, 4]");
        let mut simulation = start(&scene);
        let (momentum, energy) = (simulation.angular_momentum(), scalar(&simulation, "energy"));
        let extent = simulation.bodies[0].extent;
        let mut worst = 0.0f64;
        for _ in 0..10 {
            run(&mut simulation, 94);
            worst = worst.max((scalar(&simulation, "energy") / energy - 1.0).abs());
            let grown = simulation.bodies[0].extent / extent;
            assert!((1.0..1.06).contains(&grown), "{model}: grows {grown} times");
        }
        assert!(simulation.angular_momentum().distance(momentum) < 1e-12 * momentum.length(), "{model}");
        assert!(worst < 0.02, "{model}: energy {worst}");
        let spin = simulation.bodies[0].free.as_ref().unwrap().spin;
        assert!(spin.distance(DVec3::new(0.0, 3.0, 4.0)) < 0.3, "{model}: {spin}");
    }
}

/// Colliding bodies conserve momentum and angular momentum, also with internal damping.
#[test]
fn free_bodies_conserve_momentum() {
    for model in [Model::Lattice, Model::Fem] {
        for (name, steps) in [("collide", 150), ("orbit", 100)] {
            let mut simulation = start(&scene(name, model));
            let [momentum, moment] = [simulation.momentum(), simulation.angular_momentum()];
            let events = run(&mut simulation, steps);
            assert!(events.iter().any(|event| event.name == "merge"), "{name} {model}: {events:?}");
            let change = [simulation.momentum() - momentum, simulation.angular_momentum() - moment];
            assert!(change.iter().all(|change| change.length() < 1e-12), "{name} {model}: {change:?}");
        }
    }
}

/// An undamped body that falls on a frictionless plane rebounds with the same energy, partly as vibration; the error
/// decreases with the step.
#[test]
fn a_bounce_conserves_energy() {
    for model in [Model::Lattice, Model::Fem] {
        let error = |dt: f64| {
            let lines = format!(
                "dt = {dt}\ngravity = [0, 0, -9.81]\n[material]\ndamping = 0.0\nomega = 60.0\n[[plane]]\nnormal = [0, 0, 1]\nstiffness = 2000.0"
            );
            let mut simulation = start(&free(model, &lines, "velocity = [0.3, 0, 0]"));
            let total = |simulation: &Elastic| {
                let height = simulation.bodies[0].free.as_ref().unwrap().centre.z;
                scalar(simulation, "energy") + 0.125 * 9.81 * height
            };
            let (first, mut lowest) = (total(&simulation), f64::INFINITY);
            for _ in 0..(0.8 / dt).round() as u64 {
                run(&mut simulation, 1);
                lowest = f64::min(lowest, simulation.bodies[0].free.as_ref().unwrap().centre.z);
            }
            let free = simulation.bodies[0].free.as_ref().unwrap();
            assert!(lowest < 0.5 && free.centre.z > 0.55, "{model}: {lowest} {}", free.centre.z);
            assert!((free.velocity.x - 0.3).abs() < 1e-12, "{model}: no friction");
            (total(&simulation) / first - 1.0).abs()
        };
        let [coarse, fine] = [error(0.008), error(0.002)];
        assert!(fine < 0.01 && (fine < 0.3 * coarse || coarse < 1e-3), "{model}: {coarse} {fine}");
    }
}

/// Friction slows a body that slides on a plane, and rotates it; the plane bears its weight.
#[test]
fn free_bodies_lie_on_planes() {
    let lines = "gravity = [0, 0, -9.81]\n[material]\nomega = 40.0\ndamping = 10.0\n[[plane]]\nnormal = [0, 0, 1]\noffset = 0.5\nfriction = 0.5\nstiffness = 20000.0";
    for model in [Model::Lattice, Model::Fem] {
        let mut simulation = start(&free(model, lines, "velocity = [1, 0, 0]"));
        run(&mut simulation, 60);
        let free = simulation.bodies[0].free.as_ref().unwrap();
        // in steps of 0.2 ms
        let converged = if model == Model::Lattice { 0.891 } else { 0.936 };
        assert!((free.centre.z - converged).abs() < 0.01, "{model}: {}", free.centre);
        assert!(
            (0.1..0.95).contains(&free.velocity.x) && free.spin.y > 0.3,
            "{model}: {} {}",
            free.velocity,
            free.spin
        );
        run(&mut start(&scene("drop", model)), 60);
    }
}

/// Bodies that collide, lose cells and fall on a plane sink into it by v/√k, not by what has come off.
#[test]
fn torn_bodies_lie_on_the_surface_that_is_left() {
    let text = "gravity = [0, 0, -5]\nmodel = 'lattice'\nduration = 1.5\ndt = 0.005\n[material]\nomega = 6\ndamping = 0.3\n\
                [influence]\nalpha = 300\nbeta = 300\ncore_at = 0.7\ncore_width = 0.2\n\
                [lattice]\ncells = 4\ntear = 'cut'\nlimit = 0.3\n\
                [[body]]\nname = 'a'\nradius = 1.0\nshape = { sphere = { stacks = 6, slices = 8 } }\n\
                motion = { free = { from = [-1.2, 0, 0], velocity = [3, 0.4, 0], spin = [0, 0, 4] } }\n\
                [[body]]\nname = 'b'\nradius = 0.8\nshape = { sphere = { stacks = 6, slices = 8 } }\n\
                motion = { free = { from = [1.3, 0.2, 0], velocity = [-3, 0, 0.3], spin = [0, 3, 0] } }\n\
                [[plane]]\nnormal = [0, 0, 1]\noffset = -5.2\nstiffness = 800.0\n";
    let mut simulation = start(&Scene::parse(text, "torn.toml").unwrap());
    let (mut frame, mut lowest) = (Frame::default(), f64::INFINITY);
    for _ in 0..300 {
        run(&mut simulation, 1);
        simulation.observe(Want::default(), &mut frame);
        for now in frame.bodies.iter() {
            let Some(mesh) = &now.mesh else { continue };
            let height = |&vertex: &u32| now.centre.z + now.positions.get(vertex as usize).z;
            lowest = mesh.triangles().iter().flatten().map(height).fold(lowest, f64::min);
        }
    }
    // they arrive with a velocity of 7.1, and 7.1/√800 is 0.25
    assert!((5.3..5.46).contains(&-lowest), "{lowest}");
}

/// However strong a force point is, steps of the default length end near those of shorter ones.
#[test]
fn force_points_divide_the_steps_of_finite_elements() {
    let largest = |dt: f64| {
        let text = format!(
            "model = 'fem'\nduration = 1.0\ndt = {dt}\n[fem]\ncells = 4\n[[body]]\nname = 'a'\nradius = 1.0\n\
             shape = {{ sphere = {{ stacks = 6, slices = 8 }} }}\nmotion = {{ fixed = [0, 0, 0] }}\n[[point]]\nname = 'p'\n\
             motion = {{ fixed = [1.6, 0.1, 0] }}\nradius = 1.0\nact = 'attract'\nalpha = 40000.0\n"
        );
        let scene = Scene::parse(&text, "points.toml").unwrap();
        let (steps, mut simulation) = (scene.steps(), start(&scene));
        let after_step = (0..steps).map(|_| {
            run(&mut simulation, 1);
            scalar(&simulation, "max_displacement")
        });
        after_step.fold(0.0, f64::max)
    };
    let [coarse, fine] = [1.0 / 60.0, 1e-3].map(largest);
    assert!((coarse - fine).abs() < 0.04 * fine, "{coarse} {fine}");
}

/// Results with free bodies are bit-identical for any number of threads.
#[test]
fn bits_of_free_bodies_do_not_depend_on_threads() {
    for model in [Model::Lattice, Model::Fem] {
        let checksum = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let mut simulation = start(&scene("orbit", model));
                run(&mut simulation, 60);
                simulation.checksum()
            })
        };
        assert_eq!([checksum(2), checksum(8)], [checksum(1); 2], "{model}");
    }
}

/// A ball rolls down a slope as far in long steps as in short ones: friction that holds it does not creep.
#[test]
fn friction_does_not_depend_on_the_step() {
    let way = |model, dt: f64| {
        let lines = format!(
            "dt = {dt}\ngravity = [3.355, 0, -9.218]\n[material]\nomega = 40.0\ndamping = 10.0\n[[plane]]\nnormal = [0, 0, 1]\n\
             offset = -0.5\nfriction = 0.9\nstiffness = 20000.0"
        );
        let mut simulation = start(&free(model, &lines, "velocity = [0, 0, 0]"));
        run(&mut simulation, (1.0 / dt).round() as u64);
        let free = simulation.bodies[0].free.as_ref().unwrap();
        assert!(free.spin.y > 0.5, "{model}: {free:?}");
        free.centre.x
    };
    for model in [Model::Lattice, Model::Fem] {
        let [coarse, fine] = [1.0 / 60.0, 1.0 / 480.0].map(|dt| way(model, dt));
        assert!((coarse / fine - 1.0).abs() < 2e-3, "{model}: {coarse} {fine}");
    }
}

/// However strong friction is, it adds no energy; where nothing presses, there is none.
#[test]
fn friction_takes_energy() {
    let largest = |model, friction: f64, stiffness: f64| {
        let lines = format!(
            "[material]\nomega = 40.0\ndamping = 1.0\n[[plane]]\nnormal = [0, 0, 1]\noffset = 0.6\nfriction = {friction:?}\n\
             stiffness = {stiffness:?}"
        );
        let mut simulation = start(&free(model, &lines, "velocity = [1, 0, 0]"));
        let after_step = (0..30).map(|_| {
            run(&mut simulation, 1);
            scalar(&simulation, "energy")
        });
        after_step.fold(0.0, f64::max)
    };
    for model in [Model::Lattice, Model::Fem] {
        let without = largest(model, 0.0, 4000.0);
        for friction in [1.0, 1e3, 1e5, 1e15] {
            let with = largest(model, friction, 4000.0);
            assert!(with <= 1.01 * without, "{model}: friction {friction}: {with}, {without} without it");
        }
        assert_eq!(largest(model, 0.5, 0.0), largest(model, 0.0, 0.0), "{model}");
    }
}

/// Many pairs may change their phases in one step: only one that does so again and again is too much.
#[test]
fn pairs_count_their_own_changes() {
    let ball = |name: String, from: [f64; 3], velocity: f64| {
        format!(
            "[[body]]\nname = '{name}'\nradius = 1.0\nshape = {{ sphere = {{ stacks = 2, slices = 3 }} }}\n\
             motion = {{ free = {{ from = {from:?}, velocity = [{velocity:?}, 0, 0] }} }}\n"
        )
    };
    let pairs = (0..1010).map(|pair| {
        let y = 10.0 * f64::from(pair);
        ball(format!("a{pair}"), [0.0, y, 0.0], 0.0) + &ball(format!("b{pair}"), [2.11, y, 0.0], -1.0)
    });
    let text = "duration = 0.02\nmodel = 'lattice'\n[lattice]\ncells = 2\n".to_owned() + &pairs.collect::<String>();
    assert_eq!(run(&mut start(&Scene::parse(&text, "many.toml").unwrap()), 1).len(), 1010);
}

/// A body of which all cells are cut is no longer touched by anything.
#[test]
fn friction_ends_with_the_last_cell() {
    let text = "duration = 0.5\nmodel = 'lattice'\ngravity = [0, 0, -9]\n[material]\nomega = 8.0\n\
                [lattice]\ncells = 3\ntear = 'cut'\nlimit = 0.02\n[[plane]]\nnormal = [0, 0, 1]\noffset = -0.52\n\
                friction = 0.3\n[[body]]\nname = 'a'\nradius = 0.5\n\
                motion = { free = { from = [0, 0, 0], velocity = [1, 0, -3] } }\n";
    let mut simulation = start(&Scene::parse(text, "cut.toml").unwrap());
    run(&mut simulation, 30);
    assert_eq!(scalar(&simulation, "volume_lost"), 1.0);
    assert!(simulation.bodies[0].free.as_ref().unwrap().centre.is_finite());
}
