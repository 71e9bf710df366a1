//! The models of a scene: how one is chosen and recorded, and what recordings carry of those whose bodies tear.

use std::{path::Path, sync::Arc};

use glam::DVec3;
use meldscope::{
    Scene,
    geometry::Mesh,
    models::{self, SceneRun},
    observe::{Experiment, Frame, Refusal, Schema, Simulation, StepSummary, Want},
    recording::{Recorded, diff, frames::FrameReader, replay, replay::Verdict},
    scene::Model,
    sim::Options,
    stream::{
        Recorder, Settings,
        settings::{Detail, Entities, Frames},
        sinks::{Destinations, Sinks},
    },
};

use crate::{
    octahedra::Octahedra,
    recording::{Dir, Recording},
};

/// Records a run of an experiment.
pub fn record(experiment: &dyn Experiment, path: &Path, settings: Settings) {
    let mut simulation = experiment.start().expect("it starts");
    let destinations = Destinations { save: Some(path.to_owned()), ..Destinations::default() };
    let mut sinks = Sinks::open(&destinations).expect("a file");
    let mut recorder = Recorder::new(&*simulation, settings.clone());
    let mut messages = recorder.blueprint(&*simulation);
    while settings.steps.is_some_and(|steps| simulation.steps_taken() < steps) {
        simulation.step();
        recorder.observe(&*simulation);
        messages.append(&mut recorder.take());
    }
    recorder.finish(&*simulation);
    messages.append(&mut recorder.take());
    messages.into_iter().for_each(|message| sinks.send(message).expect("room"));
    sinks.finish().expect("room");
}

fn run(name: &str, model: Model) -> SceneRun {
    SceneRun { scene: Scene { model, ..Scene::builtin(name).expect("built in") }, options: Options::default() }
}

#[test]
fn a_recording_says_which_model_made_it() {
    // what was recorded before there were models says none, and neither do oscillators
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
    assert_eq!(scene.overrides(Some(scene.steps())), "model = \"fem\"\n");

    let table: toml::Table = (oscillators.run.clone() + "model = \"jelly\"\n").parse().expect("settings");
    let refused = models::read("two", &oscillators.source, &table).expect_err("no such model");
    assert!(matches!(refused, Refusal::Run(what) if what.contains("jelly")));
    assert!(models::parse("latice").is_err_and(|error| error.contains("did you mean \"lattice\"")));
}

/// Octahedra of which the first loses a corner after 50 steps: it gets a vertex of its own at the same place.
#[derive(Clone, Debug)]
struct Tearing(Octahedra);

struct Torn {
    whole: Box<dyn Simulation>,
    version: Arc<Mesh>,
}

const TEARS: u64 = 50;

impl Torn {
    fn version() -> Arc<Mesh> {
        let mesh = &Octahedra(0.0).schema().bodies[0].mesh;
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
        Tearing(Octahedra(3.0)).schema()
    }
    fn steps_taken(&self) -> u64 {
        self.whole.steps_taken()
    }
    fn time(&self) -> f64 {
        self.whole.time()
    }
    fn step(&mut self) {
        self.whole.step();
    }
    fn summary(&self, summary: &mut StepSummary) {
        self.whole.summary(summary);
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
        let pull = text.strip_prefix("pull = ").and_then(|pull| pull.parse().ok());
        Ok(Arc::new(Tearing(Octahedra(pull.expect("its own")))))
    }
}

#[test]
fn a_body_that_tears_is_recorded_and_read_back() {
    let dir = Dir::new();
    let tearing = Tearing(Octahedra(3.0));
    let open = |path: &Path| Recorded::open_as(path, &|name, text, run| tearing.read(name, text, run)).expect("ours");
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
            simulation.step();
        }
        assert_eq!(count, 101);
    }
}

/// Lattices and finite elements are recorded, thin and in full, and replayed to the same bits; what tears is in the
/// recording, with its place, and so is the settings' model.
#[test]
fn bodies_made_of_cells_are_recorded_replayed_and_compared() {
    let dir = Dir::new();
    for (model, tables, entity) in [
        (Model::Lattice, "[lattice]\ntear = 'split'\nlimit = 0.1\n", "diagnostics/split_nodes"),
        (Model::Lattice, "[lattice]\ntear = 'cut'\nlimit = 0.12\n", "diagnostics/volume_lost"),
        (Model::Fem, "[fem]\ntear_stress = 4.0\n", "diagnostics/would_tear"),
    ] {
        let own = Scene::builtin("two").expect("built in");
        let scene = Scene::parse(&(own.source + tables), "two").expect("a scene");
        let run = SceneRun { scene: Scene { model, ..scene }, options: Options::default() };
        let path = |name: &str| dir.file(&format!("{name}-{}.rrd", entity.replace('/', "-")));
        let settings = Settings { steps: Some(110), ..Settings::of(&run) };
        record(&run, &path("full"), settings.clone());
        record(&run, &path("thin"), Settings { frames: Frames::Thin, ..settings });
        let [full, thin] = ["full", "thin"].map(|name| Recorded::open(&path(name)).expect("a recording"));
        for recorded in [&full, &thin] {
            assert_eq!(replay::verify(recorded, |_| true).expect("it runs"), Verdict::Identical, "{model}");
        }
        let compared = diff::diff([&full, &thin], 1e-6).expect("the same bodies");
        assert_eq!((compared.first_bits, compared.bodies.len()), (None, 0), "{model}");
        let entities = Recording::open(&path("full")).entities();
        for entity in [entity, "events/bodies", "diagnostics/energy", "world/forces/restoring", "pairs/a~b/gap"] {
            assert!(entities.contains(&entity.into()), "{model}: {entity}");
        }
    }
}
