//! The models of a scene: selection, recording, and recordings of bodies that tear.

use std::{path::Path, process::Command, sync::Arc};

use glam::DVec3;
use meldscope::{
    Scene,
    analysis::{surface::Merger, touch::Touches},
    bench,
    geometry::{Mesh, mesh::signed_volume},
    models::{self, SceneRun, side_by_side::SideBySide},
    observe::{Experiment, Frame, Refusal, Schema, Simulation, StepSummary, Want},
    recording::{
        Recorded, diff,
        frames::FrameReader,
        golden::{self, GoldenOutcome},
        replay::{self, Verdict},
    },
    scene::{Model, builtin},
    sim::Options,
    stream::{
        self, Settings,
        settings::{Detail, Entities, Frames},
        sinks::Destinations,
    },
};

use crate::{
    octahedra::Octahedra,
    recording::{Dir, Recording},
};

/// Records a run of an experiment.
fn record(experiment: &dyn Experiment, path: &Path, settings: Settings) {
    let destinations = Destinations { save: Some(path.to_owned()), ..Destinations::default() };
    stream::record(experiment, settings, &destinations).expect("it is recorded");
}

fn run(name: &str, model: Model) -> SceneRun {
    SceneRun { scene: Scene { model, ..Scene::builtin(name).expect("a built-in scene") }, options: Options::default() }
}

/// Spheres that nothing deforms touch where their paths say, in every model; one of them jumps away.
#[test]
fn bodies_on_paths_touch_where_their_paths_are() {
    let text = "duration = 1.5\n[material]\nresponse = \"rigid\"\n[influence]\nalpha = 0\nbeta = 0\n\
                [[body]]\nname = \"a\"\nradius = 1.0\nmotion = { fixed = [0, 0, 0] }\n[[body]]\nname = \"b\"\nradius = 0.8\n\
                motion = { sine = { center = [2.2, 0, 0], amplitude = [1, 0, 0], frequency = 1.2, phase = 0.3 } }\n\
                [[body]]\nname = \"h\"\nradius = 0.5\n\
                motion = { keyframes = { keys = [[0, 0, 1.2, 0], [1.01, 0, 4, 0]], interpolation = \"hold\" } }\n";
    let scene = Scene::parse(text, "rigid.toml").expect("a valid scene");
    for (model, dt) in
        [Model::Oscillators, Model::Lattice, Model::Fem].into_iter().flat_map(|model| [(model, 0.01), (model, 0.05)])
    {
        let scene = Scene { model, dt, ..scene.clone() };
        let steps = scene.steps();
        let mut simulation =
            SceneRun { scene: scene.clone(), options: Options::default() }.start().expect("it can run");
        let mut touches = Touches::new(&*simulation);
        let (mut frame, mut found, mut events) = (Frame::default(), Vec::new(), Vec::new());
        for _ in 0..steps {
            let mut summary = StepSummary::default();
            simulation.step(&mut summary);
            simulation.observe(Want::default(), &mut frame);
            touches.step(&*simulation, &frame, &summary.events, &mut found);
            events.extend(found.iter().filter(|event| event.is_contact()).map(|event| (event.b, event.time, event.q)));
        }
        let path = scene.bodies[1].path().expect("a path");
        let of_b: Vec<(f64, f64)> = events.iter().filter(|(b, ..)| *b == 1).map(|&(_, time, q)| (time, q)).collect();
        assert!(of_b.len() >= 2, "{model:?}: {events:?}");
        for (time, q) in of_b {
            let distance = path.position(time).length();
            assert!((distance - 1.8).abs() < 1e-6 && (q - distance / 1.8).abs() < 1e-9, "{model:?}, {dt}: {time}, {q}");
        }
        let of_h: Vec<f64> = events.iter().filter(|(b, ..)| *b == 2).map(|of| of.1).collect();
        assert!(matches!(of_h[..], [jump] if (jump - 1.01).abs() < 2e-7), "{model:?}, {dt}: {of_h:?}");
    }
}

/// The rates of q against the differences of the frames around.
#[test]
fn pairs_know_how_fast_q_changes() {
    for (name, model) in [
        ("two", Model::Oscillators),
        ("collide", Model::Oscillators),
        ("two", Model::Lattice),
        ("collide", Model::Lattice),
        ("collide", Model::Fem),
        ("two", Model::Metaballs),
    ] {
        let mut scene = Scene::builtin(name).expect("a scene");
        (scene.model, scene.dt) = (model, 1e-3);
        let mut simulation = SceneRun { scene, options: Options::default() }.start().expect("it can run");
        let (mut frame, mut pairs) = (Frame::default(), Vec::new());
        for _ in 0..2000 {
            simulation.step(&mut StepSummary::default());
            simulation.observe(Want::default(), &mut frame);
            pairs.push(frame.pairs.first().map(|pair| (pair.q, pair.rate)));
        }
        let (mut compared, mut fastest, mut worst) = (0, 0.0, 0.0);
        for around in pairs.windows(3) {
            if let [Some((before, _)), Some((_, rate)), Some((after, _))] = around {
                let error = (rate - (after - before) / 2e-3).abs();
                (compared, fastest, worst) = (compared + 1, f64::max(fastest, rate.abs()), f64::max(worst, error));
            }
        }
        // measured: 2.5e-4, at the jumps of forces in `collide`; 3.3e-7 on paths
        assert!(compared > 1000 && worst <= 3e-4 * fastest, "{name}, {model}: {worst} of {fastest} at {compared}");
    }
}

#[test]
fn a_recording_names_its_model() {
    // neither recordings from before there were models nor those of oscillators name a model
    let oscillators = run("two", Model::Oscillators).schema();
    assert!(!oscillators.run.contains("model"), "{}", oscillators.run);
    assert_eq!(oscillators.model, "oscillators");
    let [with, without] = [Some("fem"), None].map(|model| {
        let mut table: toml::Table = oscillators.run.parse().expect("settings");
        if let Some(model) = model {
            table.insert("model".to_owned(), model.into());
        }
        models::read("two", &oscillators.source, &table).expect("known").schema()
    });
    assert_eq!([with.model.as_str(), without.model.as_str()], ["fem", "oscillators"]);
    assert!(with.run.contains("model = \"fem\"\n"), "{}", with.run);
    let scene = run("two", Model::Fem).scene;
    assert_eq!(scene.overrides(Some(scene.steps())), Ok("model = \"fem\"\n".to_owned()));

    let table: toml::Table = (oscillators.run.clone() + "model = \"jelly\"\n").parse().expect("settings");
    let rejected = models::read("two", &oscillators.source, &table).expect_err("no such model");
    assert!(matches!(rejected, Refusal::Run(what) if what.contains("jelly")));
    assert!(models::parse("latice").is_err_and(|error| error.contains("did you mean \"lattice\"")));
}

/// Octahedra of which the first tears at a corner after 50 steps: it gets a second vertex at the same position.
#[derive(Clone, Debug)]
struct Tearing(Octahedra);

struct Torn {
    whole: Box<dyn Simulation>,
    version: Arc<Mesh>,
}

const TEARS: u64 = 50;

impl Torn {
    fn version() -> Arc<Mesh> {
        let mesh = &Octahedra::two(0.0).schema().bodies[0].mesh;
        let mut positions = mesh.positions().clone();
        let first = positions.get(0);
        positions = positions.iter().chain([first]).collect();
        let mut triangles = mesh.triangles().to_vec();
        for corner in triangles[4..].iter_mut().flatten() {
            *corner = if *corner == 0 { 6 } else { *corner };
        }
        Arc::new(Mesh::version(positions, triangles))
    }
}

impl Simulation for Torn {
    fn schema(&self) -> Schema {
        Tearing(Octahedra::two(3.0)).schema()
    }
    fn steps_taken(&self) -> u64 {
        self.whole.steps_taken()
    }
    fn time(&self) -> f64 {
        self.whole.time()
    }
    fn step(&mut self, summary: &mut StepSummary) {
        self.whole.step(summary);
    }
    fn checksum(&self) -> u64 {
        self.whole.checksum()
    }
    fn observe(&self, want: Want, frame: &mut Frame) {
        frame.bodies.iter_mut().for_each(|body| body.mesh = None);
        self.whole.observe(want, frame);
        if self.steps_taken() >= TEARS {
            let (schema, now) = (self.schema(), &mut frame.bodies[0]);
            let same = now.displacements.get(0) + DVec3::Z;
            now.displacements = now.displacements.iter().chain([same]).collect();
            now.velocities = now.velocities.iter().chain([DVec3::ZERO]).collect();
            for term in &mut now.terms {
                term.accelerations = term.accelerations.iter().chain([DVec3::ZERO]).collect();
            }
            now.labels.resize(self.version.vertex_count(), 0);
            now.mesh = Some(Arc::clone(&self.version));
            now.displaced(self.version.at(schema.bodies[0].radius));
        }
    }
}

impl Experiment for Tearing {
    fn schema(&self) -> Schema {
        let mut schema = self.0.schema();
        schema.bodies[0].can_tear = true;
        schema
    }
    fn start(&self) -> Result<Box<dyn Simulation>, String> {
        Ok(Box::new(Torn { whole: self.0.start()?, version: Torn::version() }))
    }
    fn read(&self, _: &str, text: &str, _: &toml::Table) -> Result<Arc<dyn Experiment>, Refusal> {
        let pull = text.strip_suffix(" 2").and_then(|pull| pull.parse().ok());
        Ok(Arc::new(Tearing(Octahedra::two(pull.expect("its own text")))))
    }
}

#[test]
fn a_body_that_tears_is_recorded_and_read_back() {
    let dir = Dir::new();
    let tearing = Tearing(Octahedra::two(3.0));
    let open =
        |path: &Path| Recorded::open_as(path, &|name, text, run| tearing.read(name, text, run)).expect("a recording");
    for (name, entities, detail) in [
        ("bodies", Entities::Body, Detail::Forces),
        ("plain", Entities::Body, Detail::Surface),
        ("batch", Entities::Batch, Detail::Forces),
    ] {
        let path = dir.file(name);
        record(&tearing, &path, Settings { entities, detail, ..Settings::of(&tearing) });
        let recorded = open(&path);
        assert_eq!(replay::verify(&recorded, |_| true).expect("it runs"), Verdict::Identical);
        let (mut frames, mut frame) = (FrameReader::open(&recorded).expect("a recording"), Frame::default());
        let mut simulation = tearing.start().expect("it starts");
        let mut count = 0;
        while let Some(read) = frames.next().expect("frames") {
            simulation.observe(Want::default(), &mut frame);
            assert_eq!(read.compare(&recorded.schema, &frame), None, "{name}, step {}", read.step);
            let surface = read.surfaces[0].as_ref().expect("a surface");
            let expected = if read.step < TEARS { 6 } else { 7 };
            assert_eq!(surface.positions.len(), expected, "{name}, step {}", read.step);
            if entities == Entities::Body {
                let mesh = frame.bodies[0].mesh_of(&recorded.schema.bodies[0]);
                assert_eq!(surface.triangles.as_deref(), Some(mesh.triangles()), "{name}, step {}", read.step);
            }
            count += 1;
            simulation.step(&mut StepSummary::default());
        }
        assert_eq!(count, 101);
    }
}

/// Lattices and finite elements are recorded, thin and in full, and replayed to the same bits. Recordings contain the
/// tears with their positions, and the model.
#[test]
fn bodies_made_of_cells_are_recorded_replayed_and_compared() {
    let dir = Dir::new();
    let shaken = "duration = 1\n[[body]]\nname = 'a'\nradius = 0.5\n\
                  motion = { sine = { center = [0, 0, 0], amplitude = [3, 0, 0], frequency = 1.5, phase = 0 } }\n";
    let two = Scene::builtin("two").expect("a built-in scene").source;
    for (model, scene, tables, entity) in [
        (Model::Lattice, shaken, "[lattice]\ntear = 'split'\nlimit = 0.3\n", "diagnostics/split_nodes"),
        (Model::Lattice, shaken, "[lattice]\ntear = 'cut'\nlimit = 0.3\n", "diagnostics/volume_lost"),
        (Model::Fem, &two, "[fem]\ntear_stress = 4.0\n", "diagnostics/would_tear"),
    ] {
        let scene = Scene::parse(&format!("{scene}{tables}"), "cells").expect("a scene");
        let run = SceneRun { scene: Scene { model, ..scene }, options: Options::default() };
        let path = |name: &str| dir.file(&format!("{name}-{}.rrd", entity.replace('/', "-")));
        let settings = Settings { steps: Some(if model == Model::Fem { 110 } else { 60 }), ..Settings::of(&run) };
        record(&run, &path("full"), settings.clone());
        record(&run, &path("thin"), Settings { frames: Frames::Thin, ..settings });
        let [full, thin] = ["full", "thin"].map(|name| Recorded::open(&path(name)).expect("a recording"));
        for recorded in [&full, &thin] {
            assert_eq!(replay::verify(recorded, |_| true).expect("it runs"), Verdict::Identical, "{model}");
        }
        let compared = diff::diff([&full, &thin], 1e-6).expect("the same bodies");
        assert_eq!((compared.first_bits, compared.bodies.len()), (None, 0), "{model}");
        let entities = Recording::open(&path("full")).entities();
        for entity in [entity, "events/bodies", "diagnostics/energy", "world/forces/restoring"] {
            assert!(entities.contains(&entity.into()), "{model}: {entity}");
        }
    }
}

/// All tools work with metaballs: any number of threads, thin and full recordings, replay, diff and golden recordings.
#[test]
fn metaballs_are_recorded_replayed_compared_and_checked() {
    let (dir, balls) = (Dir::new(), run("two", Model::Metaballs));
    let (full, thin, golden) = (dir.file("full"), dir.file("thin"), dir.file("golden"));
    record(&balls, &full, Settings { steps: Some(150), ..Settings::of(&balls) });
    record(&balls, &thin, Settings { steps: Some(150), frames: Frames::Thin, ..Settings::of(&balls) });
    let [full, thin] = [&full, &thin].map(|path| Recorded::open(path).expect("a recording"));
    assert_eq!(full.schema.model, "metaballs");
    for recorded in [&full, &thin] {
        assert_eq!(replay::verify(recorded, |_| true).expect("it runs"), Verdict::Identical);
    }
    let same = diff::diff([&full, &thin], 1e-6).expect("the same bodies");
    assert_eq!((same.first_bits, same.bodies, same.events), (None, vec![], vec![]));
    golden::bless(&balls, &golden, "a test").expect("disk space");
    let outcome = golden::check(&balls, &golden, None).expect("it runs");
    assert!(matches!(outcome, GoldenOutcome::Identical { events: 2, .. }), "{outcome:?}");

    // the phases change when those of the oscillators do
    let events = |model| {
        let mut simulation = run("two", model).start().expect("it starts");
        let (mut summary, mut events) = (StepSummary::default(), Vec::new());
        for _ in 0..300 {
            summary.clear();
            simulation.step(&mut summary);
            events.extend(summary.events.iter().map(|event| (event.name, event.time.to_bits())));
        }
        events
    };
    assert_eq!(events(Model::Metaballs), events(Model::Oscillators));

    let digests = [1, 2, 8].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| {
            let mut simulation = run("crowd", Model::Metaballs).start().expect("it starts");
            let (schema, mut frame) = (simulation.schema(), Frame::default());
            let mut merger = Merger::new(&schema, None);
            (0..20).for_each(|_| simulation.step(&mut StepSummary::default()));
            simulation.observe(Want::ALL, &mut frame);
            (simulation.checksum(), merger.merge(&schema, &frame, &[[0, 1]]).clone().groups)
        })
    });
    assert!(digests.iter().all(|digest| *digest == digests[0]));
}

#[test]
fn models_side_by_side_are_one_recording() {
    let dir = Dir::new();
    let mut scene = Scene::builtin("two").expect("a built-in scene");
    scene.duration = 2.0;
    let all = SideBySide::all(&scene, Options::default());
    assert!(all.models.starts_with(&[Model::Oscillators, Model::Metaballs]), "{:?}", all.models);
    let path = dir.file("beside");
    record(&all, &path, Settings { steps: Some(120), ..Settings::of(&all) });
    let recorded = Recorded::open(&path).expect("a recording");
    assert_eq!(replay::verify(&recorded, |_| true).expect("it runs"), Verdict::Identical);
    let merges = recorded.events.iter().filter(|event| event.name == "merge").map(|event| event.pair.clone());
    let merges: Vec<String> = merges.collect();
    assert!(merges.contains(&"oscillators-a~oscillators-b".to_owned()), "{merges:?}");
    assert!(merges.contains(&"metaballs-a~metaballs-b".to_owned()), "{merges:?}");
    // each model's lane of touching surfaces changes in the step of its event, and its surfaces have a volume
    let rows = Recording::open(&path);
    for model in &all.models {
        let pair = format!("{model}-a~{model}-b");
        let touch = recorded.contacts.iter().find(|event| event.name == "touch" && event.pair == pair);
        let expected = [(0, "none"), (touch.expect("they touch").step as i64, "a~b")];
        let lane = rows.changes(&format!("/touching/{model}"));
        let lane: Vec<_> = lane.iter().map(|row| (row.step, row.text("StateChange:state"))).collect();
        assert!(lane.iter().map(|(step, state)| (*step, state.as_str())).eq(expected), "{model}: {lane:?}");
        let volumes = rows.changes(&format!("/volume/{model}"));
        let apart = volumes.first().and_then(|row| row.scalar()).expect("a volume");
        let bodies = recorded.schema.bodies.iter().filter(|body| body.name.starts_with(model.name()));
        let volume =
            |mesh: &Mesh| signed_volume(mesh.triangles().iter().map(|t| t.map(|v| mesh.positions().get(v as usize))));
        let expected: f64 = bodies.map(|body| body.radius.powi(3) * volume(&body.mesh)).sum();
        assert!((apart / expected - 1.0).abs() < 1e-12, "{model}: {apart}, not {expected}");
    }
}

#[test]
fn models_side_by_side_give_a_warning_of_their_scene_once() {
    let mut scene = Scene::builtin("two").expect("a built-in scene");
    scene.thresholds.merge_at = 50.0;
    scene.thresholds.split_at = 60.0;
    scene.bodies[0].reach = 0.5;
    let all = SideBySide::all(&scene, Options::default());
    assert!(all.models.len() > 1);
    let warnings = all.schema().warnings;
    let own = scene.warnings();
    assert!(
        own.len() > 1 && own.iter().all(|own| warnings.iter().filter(|one| *one == own).count() == 1),
        "{warnings:#?}"
    );
}

#[test]
fn the_model_benchmark_measures_every_model_that_can_run() {
    let mut scene = Scene::builtin("two").expect("a built-in scene");
    scene.duration = 1.6;
    let report = bench::models::measure(&scene, &[Model::Oscillators, Model::Metaballs], &mut |_| ());
    let row = |model: Model| {
        let row = report.rows.iter().find(|(of, _)| *of == model).map(|(_, row)| row.clone());
        row.expect("a row").expect("it runs")
    };
    let (oscillators, metaballs) = (row(Model::Oscillators), row(Model::Metaballs));
    assert!(metaballs.points.iter().all(|point| point.error < 1e-9), "{metaballs:?}");
    assert!((1e-12..1e-2).contains(&oscillators.points[0].error), "{oscillators:?}");
    for row in [&oscillators, &metaballs] {
        assert!(row.events.iter().any(|(name, _)| name == "merge a~b"), "{row:?}");
        assert!(row.points[0].seconds > 0.0 && row.frame > 0.0);
        assert!(row.largest_step.is_some_and(|dt| dt >= scene.dt), "{row:?}");
    }
    assert!(metaballs.events.iter().any(|(name, _)| name == "touch a~b"), "{metaballs:?}");
}

#[test]
fn unsupported_features_of_a_model_are_rejected_with_status_2() {
    let dir = Dir::new();
    let meldscope = |arguments: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_meldscope")).args(arguments).current_dir(dir.path()).output();
        let output = output.expect("it starts");
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let (status, error) = meldscope(&["run", "collide", "--model", "metaballs"]);
    assert_eq!(status, Some(2));
    let line = builtin_text("collide").lines().position(|line| line.starts_with("motion = { free")).unwrap() + 1;
    let expected =
        format!("error: collide:{line}:12: body[\"left\"].motion.free: cannot run with model = \"metaballs\"");
    assert!(error.starts_with(&expected), "{error}");
    let (status, error) = meldscope(&["run", "two", "--model", "metabals"]);
    assert!(status == Some(2) && error.contains("did you mean \"metaballs\""), "{status:?} {error}");
    std::fs::write(dir.path().join("balls.toml"), "model = 'metaballs'\n".to_owned() + &two()).expect("disk space");
    let (status, error) = meldscope(&["bench", "error", "balls.toml"]);
    assert!(status == Some(2) && error.contains("metaballs"), "{status:?} {error}");
    // the place of a key, also where another key is set, unless its value is not that of the file
    std::fs::write(dir.path().join("explicit.toml"), "\nintegrator = 'rk4'\n".to_owned() + &two()).unwrap();
    let commands: [(&[&str], &str); 6] = [
        (&["run", "--set", "model=fem"], "explicit.toml:2:1: integrator"),
        (&["run", "--model", "lattice"], "explicit.toml:2:1: integrator"),
        (&["live", "--set", "model=fem"], "explicit.toml:2:1: integrator"),
        (&["export", "--events", "e.csv", "--set", "model=fem"], "explicit.toml:2:1: integrator"),
        (&["run", "--set", "model=fem", "--set", "integrator=mps"], "integrator"),
        (&["run", "--model", "fem", "--integrator", "euler"], "integrator"),
    ];
    for (arguments, place) in commands {
        let (status, error) = meldscope(&[&arguments[..1], &["explicit.toml"], &arguments[1..]].concat());
        let is_placed = error.starts_with(&format!("error: {place}: cannot run with model"));
        assert!(status == Some(2) && is_placed, "{arguments:?} {status:?} {error}");
    }
    std::fs::remove_file(dir.path().join("explicit.toml")).unwrap();
    // nor is such a scene blessed
    std::fs::create_dir(dir.path().join("golden")).unwrap();
    std::fs::write(dir.path().join("golden/fem.toml"), "integrator = 'rk4'\nmodel = 'fem'\n".to_owned() + &two())
        .unwrap();
    for arguments in [&["check", "golden"][..], &["check", "golden", "--bless", "new"]] {
        let (status, error) = meldscope(arguments);
        let place = format!("error: {}:1:1: integrator: ", Path::new("golden").join("fem.toml").display());
        assert!(status == Some(2) && error.starts_with(&place), "{status:?} {error}");
    }
    std::fs::remove_dir_all(dir.path().join("golden")).unwrap();
    assert_eq!(std::fs::read_dir(dir.path()).expect("it exists").count(), 1, "nothing was written");
    let (status, error) = meldscope(&["run", "balls.toml", "--save", "balls.rrd"]);
    assert_eq!(status, Some(0), "{error}");
    let (status, error) = meldscope(&["replay", "balls.rrd"]);
    assert_eq!(status, Some(0), "{error}");
}

/// The mass centre of a body's cells is that of its mesh, or the body drifts. What cannot be balanced is refused if it
/// is free.
#[test]
fn free_bodies_with_cells_that_cannot_be_balanced_are_refused() {
    let dir = Dir::new();
    let pyramid = "v 1 1 0\nv -1 1 0\nv -1 -1 0\nv 1 -1 0\nv 0 0 1.5\nf 4 3 2 1\nf 1 2 5\nf 2 3 5\nf 3 4 5\nf 4 1 5\n";
    std::fs::write(dir.file("pyramid.obj"), pyramid).expect("disk space");
    let scene = |model: Model, cells: u32, motion: &str| {
        let model = model.name();
        let text = format!(
            "duration = 0.1\nmodel = \"{model}\"\n[{model}]\ncells = {cells}\n[[body]]\nname = \"a\"\nradius = 1\n\
             shape = {{ mesh = \"pyramid.obj\" }}\nmotion = {{ {motion} }}\n"
        );
        std::fs::write(dir.file("a.toml"), text).expect("disk space");
        Scene::load(&dir.file("a.toml")).expect("a valid scene").start()
    };
    let (free, fixed) = ("free = { from = [0, 0, 0] }", "fixed = [0, 0, 0]");
    for model in [Model::Lattice, Model::Fem] {
        let error = scene(model, 3, free).err().expect("it is refused");
        let remedy = format!("use other `cells` in [{}]", model.name());
        assert!(error.contains("the cells of the free body \"a\"") && error.ends_with(&remedy), "{error}");
        assert_eq!(scene(model, 6, free).err(), None);
        assert_eq!(scene(model, 3, fixed).err(), None);
    }
}

/// A body that loses all its cells while it is merged leaves the other alone, with its surface.
#[test]
fn what_is_left_of_a_group_has_its_surface() {
    let text = "duration = 0.4\ndt = 0.01\nmodel = 'lattice'\n[lattice]\ncells = 4\ntear = 'cut'\nlimit = 0.3\n\
                [influence]\nalpha = 0\nbeta = 0\n[[body]]\nname = 'a'\nradius = 1.0\nmotion = { fixed = [0, 0, 0] }\n\
                [[body]]\nname = 'b'\nradius = 1.0\nmotion = { free = { from = [1.5, 0, 0], spin = [0, 0, 12] } }\n";
    let scene = Scene::parse(text, "torn.toml").expect("a valid scene");
    let mut simulation = SceneRun { scene, options: Options::default() }.start().expect("it starts");
    let mut frame = Frame::default();
    for _ in 0..40 {
        simulation.step(&mut StepSummary::default());
    }
    simulation.observe(Want::default(), &mut frame);
    let schema = simulation.schema();
    let mut merger = Merger::new(&schema, None);
    assert!(frame.bodies[1].mesh_of(&schema.bodies[1]).triangles().is_empty(), "b has nothing left");
    assert!(frame.pairs.iter().any(|pair| schema.phases[pair.phase].is_joined), "they are still merged");
    let merged = merger.merge(&schema, &frame, &[[0, 1]]);
    assert!(merged.groups.is_empty() && merged.overlapping == 0 && merged.is_merged == [false, false]);
    assert_eq!(merged.pairs, [None]);
}

fn two() -> String {
    builtin_text("two").to_owned()
}

fn builtin_text(name: &str) -> &'static str {
    builtin::ALL.iter().find(|scene| scene.name == name).expect("a built-in scene").text
}
