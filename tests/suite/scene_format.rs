//! The scene file format, and the centre paths that it describes.

use std::f64::consts::{FRAC_PI_2, PI, SQRT_2, TAU};

use glam::{DVec3, dvec3};
use meldscope::Scene;
use meldscope::geometry::{Shape, Sphere};
use meldscope::model::influence::{Scaling, Weight};
use meldscope::scene::path::{Path, Spline};
use meldscope::scene::{Body, Integrator, Material, Motion, Plane, Response, Rotation};
use proptest::prelude::*;

/// Scenes with known solutions: name, file.
pub const REFERENCES: &[(&str, &str)] = &[
    ("push", include_str!("../reference/push.toml")),
    ("two", include_str!("../reference/two.toml")),
    ("three", include_str!("../reference/three.toml")),
    ("size_ratio", include_str!("../reference/size_ratio.toml")),
];

/// Every key that a scene file can contain.
const EVERYTHING: &str = r#"
name = "two"                  # [file stem]
dt = 0.01                     # step, s [1/60]
duration = 4.0                # s; steps = round(duration / dt)
integrator = "exponential"    # thesis | mps | euler | verlet | rk4 | exponential [exponential]

[material]                    # defaults for every body; a body may override each
omega = 12.0                  # rad/s [12.0]
damping = 1.5                 # 1/s [1.5]
response = "inertial"         # rigid | inertial | world [inertial]

[influence]
alpha = 100.0                 # 1/s² [100]
beta = 60.0                   # 1/s² [60]
reach = 1.5                   # r_e / R [√2]
weight = "linear"             # linear | wendland [linear]
scaling = "relative"          # relative | absolute [relative]
merge_at = 1.05               # centre distance / (R_a + R_b) [1.05]
split_at = 1.15               # [1.15], not below merge_at
core_at = 0.0                 # [0 = none], below merge_at
apart = "repel"               # repel | none [repel]

[[body]]
name = "a"                    # unique; letters, digits, - and _
radius = 1.0
shape = { sphere = { stacks = 12, slices = 24 } }     # [that: 266 vertices]
motion = { fixed = [0, 0, 0] }                        # one of:
       # { line = { from = [..], velocity = [..] } }
       # { sine = { center = [..], amplitude = [..], frequency = 0.25, phase = 0.0 } }
       # { keyframes = [[t, x, y, z], …] }  (t strictly increasing, two keys or more)

[[push]]
body = "a"
direction = [1, 0, 0]         # normalised on load
strength = 60.0               # scene unit/s²
start = 0.2                   # s
duration = 0.1                # s
"#;

/// The smallest scene file.
const LITTLE: &str = "
duration = 4
[[body]]
name = \"a\"
radius = 1
motion = { fixed = [0, 0, 0] }
";

/// The scene described by `text`.
fn scene(text: &str) -> Scene {
    let scene = Scene::parse(text, "folder/file.toml").unwrap_or_else(|error| panic!("{error}\n{text}"));
    assert_valid(&scene);
    scene
}

/// The single body of a scene with the given further keys.
fn body(lines: &str) -> Body {
    let motion = if lines.contains("motion") { "" } else { "motion = { fixed = [0, 0, 0] }" };
    let text = format!("duration = 4\n[[body]]\nname = \"a\"\nradius = 1\n{motion}\n{lines}\n");
    scene(&text).bodies.remove(0)
}

/// The path described by `motion`.
fn path(motion: &str) -> Path {
    body(&format!("motion = {motion}")).path().cloned().expect("a path")
}

/// Asserts the invariants that every scene guarantees to the rest of the program.
pub fn assert_valid(scene: &Scene) {
    let finite = |x: f64| x.abs() <= 1e15; // false for NaN
    let positive = |x: f64| finite(x) && x >= 1e-12;
    let non_negative = |x: f64| finite(x) && x >= 0.0 && x.is_sign_positive();
    let vector = |v: DVec3| v.to_array().into_iter().all(finite);

    assert!((1..=200).contains(&scene.name.chars().count()) && !scene.name.chars().any(char::is_control));
    assert!(positive(scene.dt) && positive(scene.duration) && scene.duration / scene.dt <= 1e12);
    assert_eq!(scene.steps(), (scene.duration / scene.dt).round() as u64);

    let influence = scene.influence;
    assert!(non_negative(influence.alpha) && non_negative(influence.beta) && positive(influence.reach));
    let thresholds = scene.thresholds;
    assert!(positive(thresholds.merge_at) && finite(thresholds.split_at) && non_negative(thresholds.core_at));
    assert!(thresholds.core_at < thresholds.merge_at && thresholds.merge_at <= thresholds.split_at);

    assert!(!scene.bodies.is_empty());
    for (i, body) in scene.bodies.iter().enumerate() {
        let plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        assert!((1..=64).contains(&body.name.len()) && body.name.chars().all(plain), "{:?}", body.name);
        assert!(scene.bodies[..i].iter().all(|other| other.name != body.name), "two bodies {:?}", body.name);
        assert!(positive(body.radius) && non_negative(body.material.omega) && non_negative(body.material.damping));
        if let Shape::Sphere(Sphere { stacks, slices }) = body.shape {
            assert!((2..=65_535).contains(&stacks) && (3..=65_535).contains(&slices));
        }
        assert!(body.shape.vertex_count() <= u64::from(u32::MAX));
        assert!((1e-37..=1e46).contains(&body.mass)); // radius³ by default
        let path = match &body.motion {
            Motion::Prescribed(path) => path,
            Motion::Free(free) => {
                assert!(vector(free.from) && vector(free.velocity) && vector(free.spin));
                assert_eq!(body.material.response, Response::Inertial);
                continue;
            }
        };
        match path {
            Path::Fixed(position) => assert!(vector(*position)),
            Path::Line { from, velocity } => assert!(vector(*from) && vector(*velocity)),
            Path::Sine { center, amplitude, frequency, phase } => {
                assert!(vector(*center) && vector(*amplitude) && non_negative(*frequency) && finite(*phase));
            }
            Path::Keyframes(_) => {
                assert!(path.knots().len() >= 2 && path.knots().iter().copied().all(finite));
                assert!(path.knots().is_sorted_by(|a, b| a < b));
            }
            Path::Given(_) => panic!("no scene file has such a path"),
        }
        let knots = path.knots().iter().copied();
        for t in [0.0, scene.dt, 0.3 * scene.duration, scene.duration].into_iter().chain(knots) {
            let at = path.at(t);
            assert!(at.position.is_finite() && at.velocity.is_finite() && at.acceleration.is_finite(), "{t}: {at:?}");
        }
        let bounds = path.bounds(0.0, scene.duration);
        assert!(bounds.speed.is_finite() && bounds.acceleration.is_finite());
    }
    for push in &scene.pushes {
        assert!(push.body < scene.bodies.len());
        assert!((push.direction.length() - 1.0).abs() < 1e-15);
        assert!(finite(push.strength) && non_negative(push.start) && non_negative(push.duration));
    }
}

// --- the file ---

#[test]
fn free_bodies_planes_and_laws_of_pairs_are_parsed() {
    let file = "duration = 1\ngravity = [0, 0, -9.81]\n[influence]\ncore_at = 0.4\ncore_width = 0.1\n\
                [[body]]\nname = \"a\"\nradius = 2\ngroup = \"left\"\ncolor = \"#fF8000\"\nmotion.free.from = [0, 0, 3]\n\
                [[body]]\nname = \"b\"\nradius = 2\nmass = 5\nmotion = { free = { from = [0, 1, 3], velocity = [1, 0, 0], spin \
                = [0, 0, 2], rotation = \"fixed\" } }\n[[body]]\nname = \"c\"\nradius = 1\ngroup = \"left\"\nmotion = { fixed = \
                [9, 0, 0] }\n[[plane]]\nnormal = [0, 0, 2]\n[[pair]]\nbodies = [\"left\", \"b\"]\nmerge_at = 0.9\ncore_at = 0\n";
    let scene = scene(file);
    assert!(scene.is_coupled());
    assert_eq!(scene.gravity, dvec3(0.0, 0.0, -9.81));
    let plane = Plane { normal: DVec3::Z, offset: 0.0, stiffness: 4000.0, friction: 0.0, slip: 0.01 };
    assert_eq!(scene.planes, [plane]);
    let [a, b, c] = &scene.bodies[..] else { panic!("three bodies") };
    assert_eq!((a.mass, b.mass, c.mass), (8.0, 5.0, 1.0));
    assert_eq!((a.color, a.group.as_deref(), b.group.as_deref()), (Some([0xff, 0x80, 0]), Some("left"), None));
    let (Motion::Free(a), Motion::Free(b)) = (&a.motion, &b.motion) else { panic!("two free bodies") };
    assert_eq!(
        (a.from, a.velocity, a.spin, a.rotation),
        (dvec3(0.0, 0.0, 3.0), DVec3::ZERO, DVec3::ZERO, Rotation::Free)
    );
    assert_eq!((b.velocity, b.spin, b.rotation), (DVec3::X, 2.0 * DVec3::Z, Rotation::Fixed));
    for (x, y) in [(0, 1), (1, 0), (1, 2)] {
        let law = scene.law(x, y);
        let thresholds = law.thresholds;
        assert_eq!((thresholds.merge_at, thresholds.split_at, thresholds.core_at), (0.9, 1.15, 0.0));
        assert_eq!((law.alpha, law.core_width), (100.0, 0.0));
    }
    assert_eq!((scene.law(0, 2).thresholds.core_at, scene.law(0, 2).core_width), (0.4, 0.1));
}

#[test]
fn a_grid_expands_to_many_bodies() {
    let grid = |more: &str| {
        scene(&format!(
            "duration = 1\n[[body]]\nname = \"a\"\nradius = 1\nmotion = {{ fixed = [0, 0, 0] }}\n[[grid]]\nname = \"drop\"\ncount \
             = [2, 3, 2]\nspacing = [2, 3, -4]\nradius = 0.5\nomega = 9\nmotion = {{ line = {{ from = [1, 1, 1], velocity = [1, 0, \
             0] }} }}\n{more}"
        ))
    };
    let plain = grid("");
    assert_eq!(plain.bodies.len(), 13);
    let names: Vec<&str> = plain.bodies.iter().map(|body| body.name.as_str()).collect();
    assert_eq!(names[..4], ["a", "drop-0-0-0", "drop-1-0-0", "drop-0-1-0"]);
    assert_eq!(names[12], "drop-1-2-1");
    assert_eq!(plain.bodies[12].path().unwrap().position(2.0), dvec3(1.0 + 2.0 + 2.0, 1.0 + 6.0, 1.0 - 4.0));
    assert!(plain.bodies[1..].iter().all(|body| (body.radius, body.material.omega) == (0.5, 9.0)));

    let positions = |scene: &Scene| -> Vec<DVec3> {
        scene.bodies[1..].iter().map(|body| body.path().unwrap().position(0.0)).collect()
    };
    let (exact, moved) = (positions(&plain), positions(&grid("jitter = 0.25\nseed = 7\n")));
    assert_eq!(moved, positions(&grid("jitter = 0.25\nseed = 7\n")));
    assert_ne!(moved, positions(&grid("jitter = 0.25\nseed = 8\n")));
    let apart: Vec<DVec3> = exact.iter().zip(&moved).map(|(a, b)| (*b - *a).abs()).collect();
    assert!(apart.iter().all(|by| by.max_element() <= 0.25) && apart.iter().any(|by| by.max_element() > 0.2));
}

#[test]
fn omitted_keys_have_defaults() {
    let little = scene(LITTLE);
    assert_eq!(little.name, "file");
    assert_eq!((little.dt, little.duration, little.steps()), (1.0 / 60.0, 4.0, 240));
    assert_eq!(little.integrator, Integrator::Exponential);
    let influence = little.influence;
    assert_eq!((influence.alpha, influence.beta, influence.reach), (100.0, 60.0, SQRT_2));
    assert_eq!(
        (influence.weight, influence.scaling, influence.apart_repels),
        (Weight::Linear, Scaling::Relative, true)
    );
    let thresholds = little.thresholds;
    assert_eq!((thresholds.merge_at, thresholds.split_at, thresholds.core_at), (1.05, 1.15, 0.0));
    let material = Material { omega: 12.0, damping: 1.5, response: Response::Inertial };
    assert_eq!(little.bodies[0].material, material);
    assert_eq!(little.bodies[0].shape, sphere_of(12, 24));
    assert_eq!(little.vertex_count(), 266);
    assert!(little.pushes.is_empty());
    assert_eq!(little.source, LITTLE);
}

#[test]
fn every_key_is_parsed() {
    let everything = scene(EVERYTHING);
    assert_eq!(everything.name, "two");
    assert_eq!((everything.dt, everything.duration, everything.steps()), (0.01, 4.0, 400));
    assert_eq!(everything.influence.reach, 1.5);
    assert_eq!((everything.bodies.len(), everything.pushes.len()), (1, 1));
    let push = everything.pushes[0];
    assert_eq!((push.body, push.direction, push.strength), (0, DVec3::X, 60.0));
    assert_eq!((push.start, push.duration), (0.2, 0.1));
    assert_eq!(everything.source, EVERYTHING);
}

#[test]
fn non_default_values_are_parsed() {
    let other = scene(
        "dt = 0.5\nduration = 2.0\nintegrator = \"thesis\"\n\
         material = { omega = 1.0, damping = 0.0, response = \"world\" }\n\
         [influence]\nalpha = 0\nbeta = 0\nreach = 2\nweight = \"wendland\"\nscaling = \"absolute\"\n\
         merge_at = 0.8\nsplit_at = 0.8\ncore_at = 0.5\napart = \"none\"\n\
         [[body]]\nname = \"A-1_b\"\nradius = 0.25\nshape.sphere = { stacks = 2, slices = 3 }\n\
         motion.line = { from = [1, 2, 3], velocity = [-1, 0, 0.5] }\n",
    );
    assert_eq!((other.dt, other.steps(), other.integrator), (0.5, 4, Integrator::Thesis));
    let influence = other.influence;
    assert_eq!((influence.alpha, influence.beta, influence.reach), (0.0, 0.0, 2.0));
    let laws = (influence.weight, influence.scaling, influence.apart_repels);
    assert_eq!(laws, (Weight::Wendland, Scaling::Absolute, false));
    let thresholds = other.thresholds;
    assert_eq!((thresholds.merge_at, thresholds.split_at, thresholds.core_at), (0.8, 0.8, 0.5));
    let body = &other.bodies[0];
    assert_eq!((body.name.as_str(), body.radius, body.shape.vertex_count()), ("A-1_b", 0.25, 5));
    assert_eq!(body.material, Material { omega: 1.0, damping: 0.0, response: Response::World });
}

#[test]
fn every_keyword_is_parsed() {
    for integrator in Integrator::ALL {
        assert_eq!(scene(&format!("integrator = \"{integrator}\"\n{LITTLE}")).integrator, integrator);
    }
    for (word, response) in [("rigid", Response::Rigid), ("inertial", Response::Inertial), ("world", Response::World)] {
        assert_eq!(body(&format!("response = \"{word}\"")).material.response, response);
    }
}

#[test]
fn a_body_overrides_the_material_key_by_key() {
    let text = "duration = 1\n[material]\nomega = 3\ndamping = 4\nresponse = \"rigid\"\n";
    let with = |lines: &str| {
        let body = format!("[[body]]\nname = \"a\"\nradius = 1\nmotion = {{ fixed = [0, 0, 0] }}\n{lines}\n");
        scene(&format!("{text}{body}")).bodies[0].material
    };
    let material = Material { omega: 3.0, damping: 4.0, response: Response::Rigid };
    assert_eq!(with(""), material);
    assert_eq!(with("omega = 0"), Material { omega: 0.0, ..material });
    assert_eq!(with("damping = 7.5"), Material { damping: 7.5, ..material });
    assert_eq!(with("response = \"world\""), Material { response: Response::World, ..material });
}

fn sphere_of(stacks: u32, slices: u32) -> Shape {
    Shape::Sphere(Sphere { stacks, slices })
}

#[test]
fn stacks_and_slices_of_a_sphere_are_parsed() {
    let sphere = |keys: &str| body(&format!("shape = {{ sphere = {{ {keys} }} }}")).shape;
    assert_eq!(sphere(""), sphere_of(12, 24));
    assert_eq!(sphere("stacks = 5"), sphere_of(5, 24));
    assert_eq!(sphere("slices = 0x10"), sphere_of(12, 16));
    assert_eq!(sphere("stacks = 65535, slices = 65535").vertex_count(), 2 + 65_534 * 65_535);
}

#[test]
fn numbers_may_use_every_toml_notation() {
    for (written, number) in [
        ("1", 1.0),
        ("+2.5", 2.5),
        ("1e1", 10.0),
        ("5E-1", 0.5),
        ("1_000.5", 1000.5),
        ("0x1f", 31.0),
        ("0o17", 15.0),
        ("0b101", 5.0),
        ("1e15", 1e15),
        ("1e-12", 1e-12),
        ("1_000_000_000_000_000", 1e15),
        ("0.1", 0.1),
    ] {
        assert_eq!(scene(&LITTLE.replace("radius = 1", &format!("radius = {written}"))).bodies[0].radius, number);
    }
    assert!(body("omega = -0.0").material.omega.is_sign_positive(), "minus zero is read as zero");
}

#[test]
fn equivalent_layouts_give_the_same_scene() {
    let parsed = |text: &str| format!("{:?}", Scene { source: String::new(), ..scene(text) });
    let headers = "duration = 1\n[influence]\nalpha = 1\n[[body]]\nname = \"a\"\nradius = 1\n[body.motion]\n\
                   fixed = [0, 0, 0]\n[body.shape.sphere]\nstacks = 4\n";
    let dotted = "body = [{ name = 'a', radius = 1, motion.fixed = [0, 0, 0], shape.sphere.stacks = 4 }]\n\
                  influence.alpha = 1.0\nduration = 1.0\n";
    let windows = format!("\u{feff}{}", headers.replace('\n', "\r\n"));
    assert_eq!(parsed(headers), parsed(dotted));
    assert_eq!(parsed(headers), parsed(&windows));
}

#[test]
fn a_scene_without_a_name_is_named_after_its_file() {
    let long = format!("{}.toml", "x".repeat(300));
    for (file, name) in [
        ("two.toml", "two"),
        ("a/b/größe ratio.v2.toml", "größe ratio.v2"),
        ("two", "two"),
        (".toml", ".toml"),
        ("", "scene"),
        ("/", "scene"),
        ("\n.toml", "scene"),
        (long.as_str(), &long[..200]),
    ] {
        assert_eq!(Scene::parse(LITTLE, file).expect("a scene").name, name, "{file:?}");
    }
    assert_eq!(scene(&format!("name = \"Zwei Bälle\"\n{LITTLE}")).name, "Zwei Bälle");
}

#[test]
fn a_scene_is_loaded_from_a_file() {
    let file = std::env::temp_dir().join(format!("meldscope-{}-loaded.toml", std::process::id()));
    std::fs::write(&file, LITTLE).expect("a file can be written");
    let loaded = Scene::load(&file);
    std::fs::remove_file(&file).expect("it exists");
    let loaded = loaded.expect("a scene");
    assert_eq!(loaded.name, format!("meldscope-{}-loaded", std::process::id()));
    assert_eq!(loaded.source, LITTLE);
}

#[test]
fn the_direction_of_a_push_becomes_a_unit_vector() {
    let direction = |written: &str| {
        let push = format!("[[push]]\nbody = \"a\"\ndirection = {written}\nstrength = -1\nstart = 0\nduration = 0\n");
        scene(&format!("{LITTLE}{push}")).pushes[0].direction
    };
    assert_eq!(direction("[3, 0, 0]"), DVec3::X);
    assert_eq!(direction("[0, 0, -1e-300]"), DVec3::NEG_Z);
    assert_eq!(direction("[0, 5e-324, 0]"), DVec3::Y);
    assert_eq!(direction("[3, -4, 0]"), dvec3(0.6, -0.8, 0.0));
    let [d, plain] = [direction("[1, 0.2, 0.0]"), dvec3(1.0, 0.2, 0.0)];
    assert_eq!(d, plain / plain.length(), "scaled only by exact factors");
    for written in ["[1e300, 1e300, 0]", "[1e-300, 1e-300, 0]", "[1.7e308, 1.7e308, 1]", "[5e-324, 5e-324, 0]"] {
        assert!((direction(written) - dvec3(1.0, 1.0, 0.0) / SQRT_2).length() < 1e-15, "{written}");
    }
}

#[test]
fn pushes_name_their_bodies() {
    let mut text = String::from("duration = 1\n");
    for name in ["a", "b", "c"] {
        text += &format!("[[body]]\nname = \"{name}\"\nradius = 1\nmotion = {{ fixed = [0, 0, 0] }}\n");
    }
    for name in ["c", "a", "c"] {
        text += &format!("[[push]]\nbody = \"{name}\"\ndirection = [1, 0, 0]\nstrength = 1\nstart = 0\nduration = 1\n");
    }
    assert_eq!(scene(&text).pushes.iter().map(|push| push.body).collect::<Vec<_>>(), [2, 0, 2]);
}

/// If every body were compared with every other, this would take minutes.
#[test]
fn many_bodies_are_parsed() {
    let count = 100_000;
    let bodies =
        (0..count).map(|i| format!("[[body]]\nname = \"b{i}\"\nradius = 1\nmotion = {{ fixed = [{i}, 0, 0] }}\n"));
    let push = "direction = [1, 0, 0]\nstrength = 1\nstart = 0\nduration = 1\n";
    let pushes = (0..count).map(|i| format!("[[push]]\nbody = \"b{i}\"\n{push}"));
    let text: String = std::iter::once("duration = 1\n".to_owned()).chain(bodies).chain(pushes).collect();
    let scene = Scene::parse(&text, "many.toml").expect("a scene");
    assert_eq!((scene.bodies.len(), scene.pushes.len()), (count, count));
}

#[test]
fn the_references_are_parsed() {
    let reference = |name: &str| {
        let (_, text) = REFERENCES.iter().find(|(known, _)| *known == name).expect("a reference");
        let scene = scene(text);
        assert_eq!(scene.name, name);
        scene
    };
    let push = reference("push");
    assert_eq!((push.steps(), push.pushes[0].end()), (180, 0.23 + 0.11));

    let two = reference("two");
    assert_eq!((two.steps(), two.vertex_count()), (240, 532));
    assert!(two.bodies.iter().all(|body| body.material.response == Response::Rigid));
    assert!((two.bodies[1].path().expect("a path").position(0.0) - dvec3(2.7, 0.1, 0.05)).length() < 1e-15);
    assert!((two.bodies[1].path().expect("a path").position(2.0) - dvec3(1.3, 0.1, 0.05)).length() < 1e-15);

    let three = reference("three");
    assert_eq!((three.vertex_count(), three.bodies[2].radius), (798, 0.8));
    assert_eq!(three.bodies[1].path().expect("a path").position(1.5), dvec3(1.6, 0.2, 0.1));

    let size_ratio = reference("size_ratio");
    assert_eq!((size_ratio.steps(), size_ratio.thresholds.core_at), (240, 0.95));
    assert_eq!(size_ratio.vertex_count(), (2 + 15 * 32) + (2 + 7 * 12));
    let small = &size_ratio.bodies[1];
    assert_eq!(small.material, Material { omega: 10.0, damping: 14.0, response: Response::World });
    assert_eq!(size_ratio.bodies[0].material, Material { omega: 10.0, damping: 1.0, response: Response::Inertial });
}

#[test]
fn the_built_in_scenes_are_parsed() {
    for builtin in meldscope::scene::builtin::ALL {
        let found = Scene::builtin(builtin.name).expect("a built-in scene is found by its name");
        assert_eq!((found.name.as_str(), Scene::without_meshes(&found.source)), (builtin.name, builtin.text));
        // including the content of its files
        assert_eq!(scene(&found.source).source, found.source);
    }
    assert!(Scene::builtin("one").is_none());
}

// --- the paths ---

#[test]
fn a_fixed_centre_stays() {
    let path = path("{ fixed = [1, -2, 3.5] }");
    assert!(path.is_fixed() && path.knots().is_empty());
    for t in [-1.0, 0.0, 1e9] {
        let at = path.at(t);
        assert_eq!((at.position, at.velocity, at.acceleration), (dvec3(1.0, -2.0, 3.5), DVec3::ZERO, DVec3::ZERO));
    }
    let bounds = path.bounds(0.0, 10.0);
    assert_eq!((bounds.speed, bounds.acceleration), (0.0, 0.0));
}

#[test]
fn a_line_continues_forever() {
    let path = path("{ line = { from = [1, 0, 0], velocity = [0, 3, -4] } }");
    assert!(!path.is_fixed() && path.knots().is_empty());
    let at = path.at(2.0);
    assert_eq!(
        (at.position, at.velocity, at.acceleration),
        (dvec3(1.0, 6.0, -8.0), dvec3(0.0, 3.0, -4.0), DVec3::ZERO)
    );
    let bounds = path.bounds(0.0, 10.0);
    assert_eq!((bounds.speed, bounds.acceleration), (5.0, 0.0));
}

#[test]
fn a_sine_oscillates() {
    let (center, amplitude) = (dvec3(2.0, 0.1, 0.05), dvec3(0.7, 0.0, -0.2));
    let swing =
        path("{ sine = { center = [2, 0.1, 0.05], amplitude = [0.7, 0, -0.2], frequency = 0.25, phase = 1.0 } }");
    assert!(!swing.is_fixed() && swing.knots().is_empty());
    for i in 0..100 {
        let t = 0.13 * f64::from(i);
        let angle = TAU * 0.25 * t + 1.0;
        let at = swing.at(t);
        assert!((at.position - (center + amplitude * angle.sin())).length() < 1e-14);
        assert!((at.velocity - amplitude * (FRAC_PI_2 * angle.cos())).length() < 1e-14);
        assert!((at.acceleration + amplitude * (FRAC_PI_2 * FRAC_PI_2 * angle.sin())).length() < 1e-14);
    }
    let unphased = path("{ sine = { center = [0, 0, 0], amplitude = [1, 0, 0], frequency = 0.5 } }");
    assert_eq!(unphased.position(0.0), DVec3::ZERO);
    assert!((unphased.at(0.0).velocity - DVec3::X * PI).length() < 1e-15);
}

#[test]
fn two_keys_make_the_smoothest_step() {
    let path = path("{ keyframes = [[1, 0, 5, 0], [3, 1, 5, -2]] }");
    assert_eq!(path.knots(), [1.0, 3.0]);
    for i in 0..=20 {
        let s = f64::from(i) / 20.0; // clamped at both ends: 3s² − 2s³
        let expected = dvec3(0.0, 5.0, 0.0) + dvec3(1.0, 0.0, -2.0) * (s * s * (3.0 - 2.0 * s));
        assert!((path.position(1.0 + 2.0 * s) - expected).length() < 1e-14, "{s}");
    }
}

#[test]
fn keys_may_be_close_far_and_before_the_start() {
    for keys in [
        "[[0, 0, 0, 0], [1e-12, 1e15, -1e15, 0], [1e15, 0, 0, 0]]",
        "[[-1e15, 1e15, 0, 0], [1e15, -1e15, 0, 0]]",
        "[[0, 0, 0, 0], [1e-12, 1, 0, 0], [2e-12, 0, 0, 0], [1, 0, 0, 0]]",
    ] {
        path(&format!("{{ keyframes = {keys} }}")); // finite at its keys: `assert_valid`
    }
}

/// A spline through two to seven keys, with its keys.
fn spline() -> impl Strategy<Value = (Path, Vec<(f64, DVec3)>)> {
    let key = (0.05..2.0, -5.0..5.0, -5.0..5.0, -5.0..5.0);
    (-1.0..1.0, prop::collection::vec(key, 2..8)).prop_map(|(start, steps)| {
        let mut t = start;
        let keys: Vec<_> = steps
            .into_iter()
            .map(|(step, x, y, z)| {
                t += step;
                (t, dvec3(x, y, z))
            })
            .collect();
        (Path::Keyframes(Spline::new(&keys)), keys)
    })
}

/// Any path.
fn any_path() -> impl Strategy<Value = Path> {
    let vector = || (-5.0..5.0, -5.0..5.0, -5.0..5.0).prop_map(|(x, y, z)| dvec3(x, y, z));
    prop_oneof![
        vector().prop_map(Path::Fixed),
        (vector(), vector()).prop_map(|(from, velocity)| Path::Line { from, velocity }),
        (vector(), vector(), 0.0..3.0, -7.0..7.0).prop_map(|(center, amplitude, frequency, phase)| Path::Sine {
            center,
            amplitude,
            frequency,
            phase
        }),
        spline().prop_map(|(path, _)| path),
    ]
}

/// Scale of a path's values, for tolerances; largest for a fast spline.
fn scale(path: &Path) -> f64 {
    let bounds = path.bounds(-10.0, 20.0);
    1.0 + bounds.speed + bounds.acceleration
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    /// These four conditions hold only for the clamped cubic spline.
    #[test]
    fn keyframes_make_the_clamped_cubic_spline((path, keys) in spline()) {
        let tolerance = 1e-12 * scale(&path);
        // passes through the keys
        for &(t, position) in &keys {
            prop_assert!((path.position(t) - position).length() < tolerance);
        }
        // at rest at both ends, and beyond them
        let [first, last] = [keys[0], keys[keys.len() - 1]];
        prop_assert!(path.at(first.0).velocity.length() < tolerance);
        prop_assert!(path.at(last.0.next_down()).velocity.length() < tolerance);
        for (t, position) in [(first.0 - 1e-9, first.1), (-50.0, first.1), (last.0, last.1), (1e9, last.1)] {
            let at = path.at(t);
            prop_assert_eq!((at.position, at.velocity, at.acceleration), (position, DVec3::ZERO, DVec3::ZERO));
        }
        // position, velocity and acceleration are continuous at every inner key
        for &(t, _) in &keys[1..keys.len() - 1] {
            let [before, after] = [path.at(t.next_down()), path.at(t)];
            prop_assert!((before.position - after.position).length() < tolerance);
            prop_assert!((before.velocity - after.velocity).length() < tolerance);
            // stepping back in time by one part in 2⁵² changes the acceleration by that fraction of the jerk
            prop_assert!((before.acceleration - after.acceleration).length() < 100.0 * tolerance);
        }
        // cubic between keys: the acceleration is linear
        for pair in keys.windows(2) {
            let [from, to] = [pair[0].0, pair[1].0];
            let at = |s: f64| path.at(from + s * (to - from)).acceleration;
            prop_assert!((at(0.25) - 2.0 * at(0.5) + at(0.75)).length() < tolerance);
        }
    }

    #[test]
    fn velocity_and_acceleration_are_derivatives(path in any_path(), t in -2.0..15.0) {
        let h = 1e-5;
        prop_assume!(path.knots().iter().all(|knot| f64::abs(knot - t) > 2.0 * h)); // the jerk jumps at knots
        let [before, at, after] = [path.at(t - h), path.at(t), path.at(t + h)];
        let velocity = (after.position - before.position) / (2.0 * h);
        let acceleration = (after.velocity - before.velocity) / (2.0 * h);
        let tolerance = 1e-7 * scale(&path);
        prop_assert!((at.velocity - velocity).length() < tolerance, "{} {}", at.velocity, velocity);
        prop_assert!((at.acceleration - acceleration).length() < tolerance, "{} {}", at.acceleration, acceleration);
    }

    /// The limit from before an instant differs from the value at it only at the ends of a key path.
    #[test]
    fn only_the_ends_of_a_key_path_are_discontinuous(path in any_path(), t in -2.0..15.0) {
        prop_assert_eq!(path.before(t), path.at(t));
        if let [first, inner @ .., last] = path.knots() {
            let tolerance = 1e-12 * scale(&path);
            for &knot in inner {
                prop_assert!((path.before(knot).acceleration - path.at(knot).acceleration).length() < tolerance);
            }
            prop_assert_eq!(path.before(*first).acceleration, DVec3::ZERO);
            prop_assert_eq!(path.at(*last).acceleration, DVec3::ZERO);
            let [before, shortly_before] = [path.before(*last), path.at(last.next_down())];
            prop_assert!((before.position - shortly_before.position).length() < tolerance);
            prop_assert!((before.acceleration - shortly_before.acceleration).length() < 100.0 * tolerance);
        }
    }

    /// A path never exceeds its speed bounds in an interval, whether the interval holds keys, ends or no motion.
    #[test]
    fn values_stay_within_the_bounds(path in any_path(), start in -3.0..15.0, length in prop_oneof![Just(0.0), 0.0..0.1, 0.0..20.0]) {
        let end = start + length;
        let bounds = path.bounds(start, end);
        let times = (0..=200).map(|i| f64::min(start + length * f64::from(i) / 200.0, end));
        let knots = path.knots().iter().copied().filter(|knot| (start..=end).contains(knot));
        for t in times.chain(knots) {
            let at = path.at(t);
            let slack = |bound: f64| bound * (1.0 + 1e-12) + 1e-12; // rounding
            prop_assert!(at.velocity.length() <= slack(bounds.speed), "at {}: {} {:?}", t, at.velocity, bounds);
            prop_assert!(at.acceleration.length() <= slack(bounds.acceleration), "at {}: {} {:?}", t, at.acceleration, bounds);
        }
    }

    /// Bounds of a key path suit root finding: over an instant, they equal the path's values.
    #[test]
    fn bounds_of_keyframes_are_tight((path, keys) in spline(), s in 0.0..1.0) {
        let [first, last] = [keys[0].0, keys[keys.len() - 1].0];
        let t = first + s * (last - first);
        let (bounds, at) = (path.bounds(t, t), path.at(t));
        prop_assert!((bounds.speed - at.velocity.length()).abs() < 1e-12 * scale(&path));
        prop_assert!((bounds.acceleration - at.acceleration.length()).abs() < 1e-12 * scale(&path));
        let outside = [path.bounds(first - 2.0, first - 1.0), path.bounds(last + 1.0, last + 2.0)];
        prop_assert!(outside.iter().all(|bounds| bounds.speed == 0.0 && bounds.acceleration == 0.0));
    }
}

/// Pairs with a free body have a core by default, which follows their own `merge_at`; pairs on paths have none.
#[test]
fn pairs_with_a_free_body_have_a_core_by_default() {
    let body = |name: &str, motion: &str| format!("[[body]]\nname = \"{name}\"\nradius = 1.0\nmotion = {motion}\n");
    let bodies = body("a", "{ free = { from = [0, 0, 0] } }")
        + &body("b", "{ fixed = [4, 0, 0] }")
        + &body("c", "{ fixed = [8, 0, 0] }");
    let cores = |text: &str| {
        let scene = Scene::parse(&format!("duration = 1.0\n{text}{bodies}"), "x.toml").expect("a valid scene");
        let core = |a, b| (scene.law(a, b).thresholds.core_at, scene.law(a, b).core_width);
        ([core(0, 1), core(0, 2), core(1, 2)], scene.warnings().iter().any(|warning| warning.contains("core_at = 0")))
    };
    let (default, own, none) = ((0.76 * 1.05, 0.38 * 1.05), (0.76 * 0.5, 0.38 * 0.5), (0.0, 0.0));
    assert_eq!(cores(""), ([default, default, none], false));
    assert_eq!(cores("[influence]\ncore_at = 0\n"), ([none; 3], true));
    assert_eq!(cores("[influence]\ncore_at = 0.8\n"), ([(0.8, 0.4), (0.8, 0.4), (0.8, 0.0)], false));
    assert_eq!(cores("[influence]\ncore_at = 0.8\ncore_width = 0.1\n"), ([(0.8, 0.1); 3], false));
    let pair = "[[pair]]\nbodies = [\"a\", \"c\"]\nmerge_at = 0.5\n";
    assert_eq!(cores(pair), ([default, own, none], false));
    // the width of a scene without `core_at` holds for pairs that have one
    let width = "[influence]\ncore_width = 0.1\n";
    let of_width = (0.76 * 1.05, 0.1);
    assert_eq!(cores(width), ([of_width, of_width, none], false));
    let pairs = "[[pair]]\nbodies = [\"a\", \"c\"]\ncore_at = 0.7\n[[pair]]\nbodies = [\"b\", \"c\"]\ncore_at = 0.6\n";
    assert_eq!(cores(&format!("{width}{pairs}")), ([of_width, (0.7, 0.1), (0.6, 0.1)], false));
}
