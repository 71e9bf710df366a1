//! The benchmarks: the reference solution that errors are measured against, and the reports made from measurements.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    process::Command,
    time::Duration,
};

use glam::DVec3;
use meldscope::{
    Scene,
    bench::{
        error::{self, Measured, Scheme, Settings},
        record,
        reference::{
            Accuracy, NoReference, Reference,
            extrapolation::{Extrapolation, Start},
        },
        report::{Machine, Report},
    },
    scene::Integrator,
};

const SCENES: [&str; 4] = ["push", "two", "three", "size_ratio"];
const FREE_SCENES: [&str; 4] = ["free_bounce", "free_fall", "free_settle", "free_tug"];

/// A scene whose reference solution is stored in a file.
fn scene(name: &str) -> Scene {
    Scene::load(&PathBuf::from(format!("tests/reference/{name}.toml"))).expect("a valid scene")
}

/// The times of all steps of a scene.
fn instants(scene: &Scene) -> Vec<f64> {
    (0..=scene.steps()).map(|step| step as f64 * scene.dt).collect()
}

#[test]
fn extrapolation_solves_the_damped_oscillator() {
    let (omega, damping) = (12.0, 1.5);
    let nu = f64::sqrt(omega * omega - damping * damping);
    let exact = |t: f64| (-damping * t).exp() * ((nu * t).cos() + damping / nu * (nu * t).sin());
    let mut slope = |_: f64, y: &[f64], slope: &mut [f64]| {
        slope.copy_from_slice(&[y[1], -omega * omega * y[0] - 2.0 * damping * y[1]]);
    };
    let mut method = Extrapolation::default();
    for steps in [40, 160, 640] {
        let h = 4.0 / f64::from(steps);
        let (mut y, mut end, mut rate) = (vec![1.0, 0.0], Vec::new(), [0.0; 2]);
        let mut worst = 0.0;
        for k in 0..steps {
            let t = f64::from(k) * h;
            slope(t, &y, &mut rate);
            let step = method.step(&mut slope, Start { t, y: &y, slope: &rate }, h, &[1e-14, 1e-13], &mut end);
            assert!(step.is_accurate(), "{step:?}");
            std::mem::swap(&mut y, &mut end);
            worst = f64::max(worst, (y[0] - exact(t + h)).abs());
        }
        // Measured: 3.3e-14, 2.0e-15, 8.9e-16.
        assert!(worst <= 1e-12, "{steps} steps: {worst:e}");
    }
}

#[test]
fn the_reference_agrees_with_itself_at_ten_times_the_accuracy() {
    for name in SCENES {
        let scene = scene(name);
        let times = instants(&scene);
        let solve = |accuracy| Reference::solve(&scene, &times, accuracy).expect("quick");
        let off = solve(Accuracy::DEFAULT).largest_difference(&solve(Accuracy::TIGHTER), &scene);
        // Measured: 1.4e-14, 1.9e-14, 1.8e-14, 5.7e-15; the stated accuracy is 1e-11.
        assert!(off <= 0.01 * Reference::ACCURACY, "{name}: {off:e}");
    }
}

#[test]
fn the_reference_agrees_with_the_files() {
    for name in SCENES.into_iter().chain(FREE_SCENES) {
        let scene = scene(name);
        let text = std::fs::read_to_string(format!("tests/reference/{name}.csv")).expect("a reference solution");
        let (mut samples, mut events) = (BTreeMap::<u64, Vec<(usize, usize, DVec3)>>::new(), vec![]);
        for line in text.lines().filter(|line| !line.starts_with("t,")) {
            if let Some(event) = line.strip_prefix("# event ") {
                events.push(event.split(' ').map(str::to_owned).collect::<Vec<_>>());
                continue;
            }
            let fields: Vec<&str> = line.split(',').collect();
            let number = |i: usize| fields[i].parse::<f64>().expect("a number");
            if fields[2] == "-1" {
                continue; // a centre: the mean of vertices, or known
            }
            let body = scene.bodies.iter().position(|body| body.name == fields[1]).expect("a body");
            let position = DVec3::new(number(3), number(4), number(5));
            samples.entry((number(0) / scene.dt).round() as u64).or_default().push((
                body,
                number(2) as usize,
                position,
            ));
        }
        let times: Vec<f64> = samples.keys().map(|&step| step as f64 * scene.dt).collect();
        let reference = Reference::solve(&scene, &times, Accuracy::DEFAULT).expect("quick");

        let mut worst = 0.0;
        for (k, samples) in samples.values().enumerate() {
            for &(index, vertex, expected) in samples {
                let body = &scene.bodies[index];
                let rest = body.shape.mesh().at(body.radius).position(vertex);
                let of_rest = body.path().map_or(DVec3::ZERO, |path| path.position(times[k]) + rest);
                let position = of_rest + reference.displacement(index, vertex, k);
                worst = f64::max(worst, position.distance(expected) / body.radius);
            }
        }
        // Measured: 1.5e-14, 1.1e-9, 6.8e-10, 1.6e-10; free bodies: 1.1e-8, 1.9e-9, 6.1e-10, 8.3e-10. This is the accuracy of the files, which were computed with
        // short steps and without locating rim crossings. In `push`, where no vertex crosses a rim, all their digits
        // are correct.
        let bound = if FREE_SCENES.contains(&name) { 2e-8 } else { 2e-9 };
        assert!(worst <= bound, "{name}: {worst:e}");
        assert_eq!(reference.events().len(), events.len());
        for (change, event) in reference.events().iter().zip(&events) {
            assert_eq!(format!("{}~{}", scene.bodies[change.a].name, scene.bodies[change.b].name), event[0]);
            // The files give 12 digits after the point. Measured: 4.6e-13, and 2.0e-11 for free bodies, whose motion
            // decides the times.
            let (bound, time) = (if FREE_SCENES.contains(&name) { 1e-10 } else { 1e-12 }, event[1].parse::<f64>());
            assert!((change.time - time.expect("a time")).abs() <= bound, "{change:?}, {event:?}");
            assert_eq!(change.to.name(), event[2]);
        }
    }
}

/// Contacts, rims and cores of free bodies are located: half the step and a tenth of the tolerance change nothing that
/// could be taken for an error. The scenes: first contact in the second half of a step, a bouncing ball, and bodies of
/// very different sizes.
#[test]
fn the_reference_locates_the_contacts_and_rims_of_free_bodies() {
    let ball = |name: &str, radius: f64, from: [f64; 3], velocity: [f64; 3]| {
        format!(
            "[[body]]\nname = \"{name}\"\nradius = {radius:?}\nshape = {{ sphere = {{ stacks = 6, slices = 8 }} }}\nmotion = {{ \
             free = {{ from = {from:?}, velocity = {velocity:?} }} }}\n"
        )
    };
    let contact = "dt = 0.02\nduration = 0.24\ngravity = [0, 0, -9]\n[[plane]]\nnormal = [0, 0, 1]\noffset = -1.19882818\n\
                   stiffness = 20000.0\n";
    let bounce = "duration = 1.0\ngravity = [0, 0, -9.81]\n[[plane]]\nnormal = [0, 0, 1]\nfriction = 0.3\n";
    let sizes = "dt = 0.02\nduration = 1.2\n[material]\nomega = 16.0\ndamping = 1.0\n[influence]\ncore_at = 0.0\nalpha = 110.0\n";
    let still = [0.0; 3];
    for (name, text, bound) in [
        // Measured: 2.3e-15, 4.6e-12, 5.5e-11.
        ("contact", contact.to_owned() + &ball("a", 1.0, still, still), 1e-13),
        ("bounce", bounce.to_owned() + &ball("a", 1.0, [0.0, 0.0, 1.2325], [0.0, 0.0, -1.5244]), 1e-10),
        (
            "sizes",
            sizes.to_owned() + &ball("a", 10.0, still, still) + &ball("b", 1.0, [11.8, 0.3, 0.0], [-4.0, 0.0, 0.0]),
            1e-9,
        ),
    ] {
        let scene = Scene::parse(&text, name).expect("a valid scene");
        let times = instants(&scene);
        let solve = |accuracy| Reference::solve(&scene, &times, accuracy).expect("quick");
        let off = solve(Accuracy::DEFAULT).largest_difference(&solve(Accuracy::TIGHTER), &scene);
        assert!(off <= bound, "{name}: {off:e}");
    }
}

/// A ball falls on a plane; after first contact its lowest vertex and its centre obey two linear equations, solved here
/// in steps of a microsecond: z″ = g − ω²(z − c − l) − 2κ(z′ − c′) + kd, c″ = g + (m/M) kd.
#[test]
fn the_reference_agrees_with_the_equations_of_a_first_contact() {
    let text = "dt = 0.02\nduration = 0.22\ngravity = [0, 0, -9]\n[[plane]]\nnormal = [0, 0, 1]\noffset = -1.19882818\n\
                stiffness = 20000.0\n[[body]]\nname = \"a\"\nradius = 1.0\nshape = { sphere = { stacks = 6, slices = 8 } }\n\
                motion = { free = { from = [0, 0, 0] } }\n";
    let scene = Scene::parse(text, "contact").expect("a valid scene");
    let reference = Reference::solve(&scene, &instants(&scene), Accuracy::DEFAULT).expect("quick");
    let mesh = scene.bodies[0].shape.mesh();
    let (lowest, share) = (mesh.vertex_count() - 1, mesh.shares()[mesh.vertex_count() - 1]);
    let (g, k, offset, omega, damping) = (-9.0, 20000.0, -1.198_828_18, 12.0, 1.5);

    let contact = f64::sqrt(2.0 * (offset + 1.0) / g);
    let slope = |[z, c, z_rate, c_rate]: [f64; 4]| {
        let push = k * (offset - z);
        let spring = -omega * omega * (z - c + 1.0) - 2.0 * damping * (z_rate - c_rate);
        [z_rate, c_rate, g + spring + push, g + share * push]
    };
    let mut y = [offset, offset + 1.0, g * contact, g * contact];
    let steps = 10_000;
    let h = (0.22 - contact) / f64::from(steps);
    for _ in 0..steps {
        let moved = |k: [f64; 4], h: f64| std::array::from_fn(|i| y[i] + h * k[i]);
        let a = slope(y);
        let b = slope(moved(a, 0.5 * h));
        let c = slope(moved(b, 0.5 * h));
        let d = slope(moved(c, h));
        y = std::array::from_fn(|i| y[i] + h / 6.0 * (a[i] + 2.0 * b[i] + 2.0 * c[i] + d[i]));
    }
    let found = reference.displacement(0, lowest, 11).z;
    assert!((found - y[0]).abs() <= 1e-13, "{found} {}", y[0]);
}

/// Bodies on paths of all kinds, pushed, behind a plane: solved together with a free body far away, they move as they do
/// when each vertex is solved on its own.
#[test]
fn the_reference_solves_bodies_on_paths_with_and_without_a_free_body() {
    for (interpolation, response) in
        [("spline", "world"), ("linear", "inertial"), ("linear", "rigid"), ("hold", "world")]
    {
        let text = format!(
            r#"
            duration = 1.0
            [material]
            response = "{response}"
            [influence]
            core_at = 0.6
            core_width = 0.1
            [[plane]]
            normal = [0, 0, 1]
            offset = -0.8
            friction = 0.3
            [[body]]
            name = "a"
            radius = 1.0
            shape = {{ sphere = {{ stacks = 4, slices = 6 }} }}
            motion = {{ sine = {{ center = [0, 0, 0], amplitude = [0.1, 0, 0.2], frequency = 1.3 }} }}
            [[body]]
            name = "b"
            radius = 0.7
            shape = {{ sphere = {{ stacks = 4, slices = 6 }} }}
            motion = {{ keyframes = {{ keys = [[0, 2.4, 0, 0], [0.33, 1.1, 0.1, 0], [0.7, 2.2, 0, 0.3]], interpolation = "{interpolation}" }} }}
            [[push]]
            body = "a"
            direction = [1, 0, 0]
            strength = 20.0
            start = 0.123
            duration = 0.1
            "#
        );
        let far = "[[body]]\nname = \"c\"\nradius = 1.0\nresponse = \"inertial\"\nshape = { sphere = { stacks = 4, slices = 6 } }\n\
                   motion = { free = { from = [0, 90, 0], spin = [1, 0, 0] } }\n[[pair]]\nbodies = [\"a\", \"b\"]\ncore_at = 0.6\n";
        let solve = |text: &str| {
            let scene = Scene::parse(text, "paths").expect("a valid scene");
            let reference = Reference::solve(&scene, &instants(&scene), Accuracy::DEFAULT).expect("quick");
            (scene, reference)
        };
        let ((scene, alone), (_, beside)) = (solve(&text), solve(&(text.clone() + far)));
        assert_eq!(alone.events(), beside.events(), "{interpolation}");
        let off = alone.largest_difference(&beside, &scene);
        // Measured: 4.7e-12 at most.
        assert!(off <= Reference::ACCURACY, "{interpolation}: {off:e}");
    }
}

/// An error above what was asked is a miss however small the tolerance, unless the reference cannot tell.
#[test]
fn errors_that_the_reference_resolves_are_misses() {
    let mut report = measured("tiny");
    assert_eq!(report.missed().count(), 0, "{report:?}");
    for it in report.measurements.iter_mut().filter(|it| it.scheme == (Scheme::Controlled { tolerance: 1e-6 })) {
        (it.error, it.share) = (1e-3, Some(1e3));
    }
    assert_eq!(report.missed().collect::<Vec<_>>(), [(1e-6, 1e3)]);
    let text = printed(&error::report(&[report], &Machine::detect()));
    assert!(text.contains("missed at some instant: 1e-6 (1000.0 times)"), "{text}");
}

/// Laws, paths, responses and positions that the files do not cover: two programs that share no equation agree.
#[test]
fn the_reference_agrees_with_the_simulation_without_files() {
    let scene = |influence: &str, offset: f64| {
        let text = format!(
            r#"
            dt = 0.02
            duration = 2.0

            [influence]
            core_at = 0.6
            merge_at = 0.9
            split_at = 0.9
            {influence}

            [[body]]
            name = "a"
            radius = 1.0
            response = "world"
            motion = {{ line = {{ from = [{offset}, 0.1, 0], velocity = [0.9, 0, 0.1] }} }}

            [[body]]
            name = "b"
            radius = 0.5
            omega = 8.0
            damping = 9.0
            motion = {{ sine = {{ center = [{offset}, 0, 0.2], amplitude = [1.4, 0.2, 0], frequency = 0.7 }} }}

            [[body]]
            name = "c"
            radius = 0.7
            damping = 0.0
            motion = {{ keyframes = [[0.3, {offset}, 2.5, 0], [0.9, {offset}, 1.1, 0], [1.7, {offset}, 1.9, 0.4]] }}

            [[push]]
            body = "c"
            direction = [1, 1, 0]
            strength = 30.0
            start = 0.55
            duration = 0.2
            "#
        );
        Scene::parse(&text, "laws").expect("a valid scene")
    };
    for (influence, offset, bound) in [
        // Measured: 4.1e-13, 6.7e-12, 4.1e-13, 4.1e-13; far from the origin rounding is coarser, 1.8e-10.
        ("weight = \"linear\"", 0.0, 2e-10),
        ("weight = \"wendland\"", 0.0, 2e-10),
        ("scaling = \"absolute\"", 0.0, 2e-10),
        ("apart = \"none\"\nreach = 1.1", 0.0, 2e-10),
        ("weight = \"linear\"", 1e6, 1e-8),
    ] {
        let scene = scene(influence, offset);
        let settings = Settings {
            integrators: vec![Integrator::Exponential],
            factors: vec![],
            tolerances: vec![1e-10],
            ..quick(&scene)
        };
        let report = error::measure(&scene, &settings, &mut |_| ()).expect("quick");
        assert!(report.measurements[0].error <= bound, "{influence}: {report:?}");
    }
}

#[test]
fn a_stiff_scene_has_no_reference() {
    let scene = Scene { duration: 1e9, ..scene("two") };
    let error = Reference::solve(&scene, &[1e9], Accuracy::DEFAULT).err().expect("too long");
    assert!(matches!(error, NoReference::TooLong { evaluations } if evaluations > 1e12), "{error}");
}

/// Two spheres of few vertices that merge and separate within a second.
fn tiny(name: &str) -> Scene {
    let text = format!(
        r#"
        name = {name:?}
        dt = 0.02
        duration = 0.96

        [material]
        response = "rigid"

        [[body]]
        name = "a"
        radius = 1.0
        shape = {{ sphere = {{ stacks = 4, slices = 5 }} }}
        motion = {{ fixed = [0, 0, 0] }}

        [[body]]
        name = "b"
        radius = 0.8
        shape = {{ sphere = {{ stacks = 3, slices = 4 }} }}
        motion = {{ sine = {{ center = [2.0, 0.2, 0], amplitude = [0.5, 0, 0], frequency = 1.0, phase = 1.5 }} }}
        "#
    );
    Scene::parse(&text, "tiny").expect("a valid scene")
}

/// One run each, however short.
fn quick(scene: &Scene) -> Settings {
    Settings { tolerances: vec![1e-3, 1e-6], runs: 1, shortest: Duration::ZERO, ..Settings::of(scene) }
}

fn measured(name: &str) -> Measured {
    let scene = tiny(name);
    let mut shares = vec![];
    let report = error::measure(&scene, &quick(&scene), &mut |share| shares.push(share)).expect("quick");
    assert!(shares.is_sorted() && (shares.last().expect("not empty") - 1.0).abs() < 1e-9, "{shares:?}");
    report
}

/// What the terminal shows.
fn printed(report: &Report) -> String {
    report.tables.iter().map(ToString::to_string).collect::<String>() + &report.notes
}

#[test]
fn every_integrator_is_measured_with_every_step() {
    let report = measured("tiny");
    assert_eq!((report.bodies, report.vertices), (2, 27));
    assert!(report.agreement <= 1e-12, "{}", report.agreement);
    for integrator in Integrator::ALL {
        let rows: Vec<_> = report.measurements.iter().filter(|it| it.scheme == Scheme::Fixed(integrator)).collect();
        let steps: Vec<u64> = rows.iter().map(|row| row.steps).collect();
        assert_eq!(steps, [12, 24, 48, 96, 192, 384, 768], "{integrator}");
        for row in rows {
            assert!((row.dt * row.steps as f64 - 0.96).abs() < 1e-12, "{row:?}");
            assert!(row.error < 10.0 && row.seconds > 0.0 && row.runs == 1, "{row:?}");
        }
    }
    let controlled = report.measurements.iter().filter(|it| matches!(it.scheme, Scheme::Controlled { .. }));
    assert_eq!(controlled.map(|it| it.steps).collect::<Vec<_>>(), [48, 48]);

    let error = |integrator, steps| {
        let found = report.measurements.iter().find(|it| it.scheme == Scheme::Fixed(integrator) && it.steps == steps);
        found.expect("measured").error
    };
    assert!(error(Integrator::Thesis, 768) >= 0.5 * error(Integrator::Thesis, 12));
    for integrator in [Integrator::Mps, Integrator::Euler, Integrator::Rk4, Integrator::Exponential] {
        assert!(error(integrator, 768) <= 0.2 * error(integrator, 12), "{integrator}");
    }
}

#[test]
fn steps_that_do_not_divide_the_duration_are_skipped() {
    let scene = Scene { duration: 0.9, ..tiny("odd") };
    let settings =
        Settings { integrators: vec![Integrator::Euler], factors: vec![4.0, 2.0, 1.0, 0.5], ..quick(&scene) };
    let report = error::measure(&scene, &settings, &mut |_| ()).expect("quick");
    assert_eq!(report.measurements.iter().map(|it| it.steps).collect::<Vec<_>>(), [45, 90]);
}

#[test]
fn diverged_runs_are_reported() {
    let mut scene = tiny("diverging");
    for body in &mut scene.bodies {
        body.material.omega = 200.0;
    }
    let settings = Settings { integrators: vec![Integrator::Euler], ..quick(&scene) };
    let report = error::measure(&scene, &settings, &mut |_| ()).expect("quick");
    assert_eq!(report.measurements[0].error, f64::INFINITY);
    assert!(report.measurements[6].error < 0.1, "{:?}", report.measurements[6]);
    let report = error::report(&[report], &Machine::detect());
    assert!(printed(&report).contains("diverged"));
    assert!(report.chart.expect("drawn").svg().contains("euler (out of bounds)"));
}

#[test]
fn the_fastest_is_the_one_that_reaches_an_error_soonest() {
    let mut report = measured("tiny");
    report.measurements.retain(|it| it.scheme == Scheme::Fixed(Integrator::Mps));
    for (measurement, (seconds, error)) in report.measurements.iter_mut().zip([(1.0, 1e-1), (2.0, 3e-1), (4.0, 1e-3)]) {
        (measurement.seconds, measurement.error) = (seconds, error);
    }
    report.measurements.truncate(3);
    let seconds = |target| report.fastest(target).first().map(|it| it.seconds);
    assert_eq!([1.0, 1e-2, 1e-4].map(seconds), [Some(1.0), Some(4.0), None]);
}

#[test]
fn tables_name_every_integrator() {
    let text = printed(&error::report(&[measured("tiny")], &Machine::detect()));
    for name in Integrator::ALL.map(Integrator::name) {
        assert_eq!(text.lines().filter(|line| line.split("  ").next() == Some(name)).count(), 7, "{name}\n{text}");
    }
    assert!(text.contains("thesis, as printed, does not converge"), "{text}");
    assert!(text.lines().all(|line| line == line.trim_end()), "{text}");
}

#[test]
fn the_diagram_is_well_formed_and_names_every_integrator() {
    let reports = [measured("a < b & \"c\""), measured("tiny"), measured("third")];
    for reports in [&reports[..1], &reports[..]] {
        let svg = error::report(reports, &Machine::detect()).chart.expect("drawn").svg();
        let texts = texts_of_well_formed(&svg);
        let count = |wanted: &str| texts.iter().filter(|text| text.starts_with(wanted)).count();
        for name in Integrator::ALL.map(Integrator::name) {
            let lines = if name == "exponential" { 2 } else { 1 };
            assert_eq!(count(name), lines * reports.len(), "{name}: {texts:?}");
        }
        assert_eq!(count("run time [ms]"), reports.len());
        assert_eq!(count("largest error [radii]"), reports.len());
        assert!(texts.iter().any(|text| text.contains("a &lt; b &amp; \"c\"")), "{texts:?}");
        assert!(texts.iter().any(|text| text.contains("meldscope")), "{texts:?}");
    }
}

/// The raw texts between the tags of an XML document. Fails if tags, attributes or entities are malformed.
fn texts_of_well_formed(xml: &str) -> Vec<String> {
    let (mut open, mut texts, mut rest) = (vec![], vec![], xml);
    while let Some(start) = rest.find('<') {
        let text = rest[..start].trim();
        assert!(!text.contains('>') && (text.is_empty() || !open.is_empty()), "{text}");
        for entity in text.split('&').skip(1) {
            let name = entity.split(';').next().expect("not empty");
            assert!(["amp", "lt", "gt", "quot", "apos"].contains(&name), "{text}");
        }
        if !text.is_empty() {
            texts.push(text.to_owned());
        }
        let end = start + rest[start..].find('>').expect("the end of a tag");
        let tag = &rest[start + 1..end];
        rest = &rest[end + 1..];
        assert_eq!(tag.matches('"').count() % 2, 0, "{tag}");
        if let Some(name) = tag.strip_prefix('/') {
            assert_eq!(open.pop(), Some(name));
        } else if !tag.ends_with('/') {
            open.push(tag.split(' ').next().expect("a name"));
        }
    }
    assert!(open.is_empty() && rest.trim().is_empty(), "{open:?} {rest}");
    texts
}

/// An empty directory for this test.
fn directory(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("bench-{name}-{}", std::process::id()));
    std::fs::remove_dir_all(&path).ok();
    std::fs::create_dir_all(&path).expect("a directory");
    path
}

/// Runs `meldscope bench error` in `directory`; returns exit status, standard output, standard error.
fn bench_error(directory: &Path, arguments: &[&str]) -> (i32, String, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_meldscope"));
    let output = command.args(["bench", "error"]).args(arguments).current_dir(directory).output().expect("started");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.code().unwrap_or(-1), text(&output.stdout), text(&output.stderr))
}

#[test]
fn the_command_rejects_bad_input_first_and_writes_last() {
    let directory = directory("command");
    let scene = tiny("small").source;
    std::fs::write(directory.join("small.toml"), scene).expect("written");

    for (arguments, status, what) in [
        (&["nowhere"][..], 2, "no scene"),
        (&["small.toml", "twoo"], 2, "did you mean"),
        (&["small.toml", "--csv", "missing/o.csv"], 1, "cannot write missing/o.csv"),
        (&["small.toml", "--csv", "o.txt"], 2, "use .csv, .json or .parquet"),
        (&["small.toml", "--svg", "."], 1, "cannot write ."),
        (&["small.toml", "--svg", "small.toml"], 2, "is not replaced"),
        (&["small.toml", "--svg", "o.csv", "--csv", "o.csv"], 2, "the same file"),
        (&["--random", "3"], 2, "it is for stability"),
        (&["small.toml", "--set", "dt=x"], 2, "dt"),
    ] {
        let (code, out, err) = bench_error(&directory, arguments);
        assert_eq!(code, status, "{arguments:?}: {err}");
        assert!(err.contains(what) && out.is_empty(), "{arguments:?}: {out}{err}");
    }
    assert_eq!(std::fs::read_dir(&directory).expect("a directory").count(), 1);

    let (code, out, err) = bench_error(&directory, &["small.toml", "--csv", "o.csv", "--svg", "o.svg"]);
    assert_eq!(code, 0, "{err}");
    assert!(out.starts_with("small: 2 bodies, 27 vertices"), "{out}");
    let csv = std::fs::read_to_string(directory.join("o.csv")).expect("written");
    let rows: Vec<Vec<&str>> = csv.lines().map(|line| line.split(',').collect()).collect();
    assert_eq!(rows.len(), 1 + 6 * 7 + 9);
    let columns = "scene,vertices,integrator,tolerance_per_s,dt_s,steps,error_radii,order,run_time_ms,runs,\
                   vertex_steps_per_s,processor,version";
    assert_eq!(rows[0].join(","), columns);
    assert!(rows[1].starts_with(&["small", "27", "thesis", ""]), "{csv}");
    for row in &rows[1..] {
        let number = |column: usize| row[column].parse::<f64>().expect("a number");
        assert!((number(4) * number(5) - 0.96).abs() < 1e-12 && number(6) > 0.0, "{row:?}");
    }
    // its own files are replaced
    assert_eq!(bench_error(&directory, &["small.toml", "--csv", "o.csv", "--svg", "o.svg"]).0, 0);
    texts_of_well_formed(&std::fs::read_to_string(directory.join("o.svg")).expect("written"));
    assert_eq!(std::fs::read_dir(&directory).expect("a directory").count(), 3);
    std::fs::remove_dir_all(&directory).ok();
}

#[test]
fn recording_costs_are_measured() {
    let mut scene = Scene::builtin("two").expect("a built-in scene");
    scene.duration = 2.0;
    let measurements = record::measure(&scene).expect("disk space");
    assert_eq!(measurements.len(), 14);
    for measured in &measurements {
        assert!(measured.frames >= 120 && measured.seconds > 0.0, "{measured:?}");
        assert_eq!(measured.entities.is_some(), measured.destination == record::Destination::File, "{measured:?}");
        assert!(measured.entities.is_none_or(|entities| (20..=95).contains(&entities)), "{measured:?}");
        // log() has neither the surface of the group nor the measures of the pair, but all positions and normals
        if measured.destination == record::Destination::Log {
            let ratio = measured.bytes.expect("a file") as f64 / measured.payload as f64;
            assert!((0.1..1.0).contains(&ratio), "{measured:?}");
        }
    }
    let verification = record::verify(&scene).expect("disk space");
    assert!(verification.step > 0.0 && verification.run > 0.0 && verification.replay > 0.0, "{verification:?}");
    let text = printed(&record::report(&measurements, &[verification]));
    assert!(text.contains("gRPC server") && text.contains("replays of thin recordings"), "{text}");
}
