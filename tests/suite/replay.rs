//! Replay, check and diff, as a library and as a program.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use glam::DVec3;
use meldscope::{
    Scene, World,
    analysis::surface::Merger,
    observe::{Frame, Schema, Simulation, StepSummary, Want},
    recording::{
        Recorded, diff,
        golden::{self, GoldenOutcome},
        replay::{self, Verdict},
    },
    scene::builtin,
    sdk,
    sim::Options,
    stream::{
        Recorder, Settings,
        blueprint::Tab,
        settings::{Frames, Trigger},
        sinks::{Destinations, Sinks},
    },
};

use crate::recording::{Dir, Recording, Row};

/// A world of another version of the program, in which its text described it although that here describes another one.
struct AnotherVersion<'a>(&'a World);

impl Simulation for AnotherVersion<'_> {
    fn schema(&self) -> Schema {
        self.0.schema()
    }
    fn overrides(&self, steps: Option<u64>) -> Result<String, String> {
        self.0.overrides(steps).or_else(|_| {
            let Scene { dt, tolerance, integrator, model, ref source, ref name, ref set, .. } = *self.0.scene();
            let own = Scene::parse(source, name).and_then(|own| own.with(set, name)).expect("its text is a scene");
            Scene { dt, tolerance, integrator, model, ..own }.overrides(steps)
        })
    }
    fn steps_taken(&self) -> u64 {
        self.0.steps_taken()
    }
    fn time(&self) -> f64 {
        self.0.time()
    }
    fn step(&mut self, _: &mut StepSummary) {
        unreachable!("only its start is recorded through it");
    }
    fn checksum(&self) -> u64 {
        self.0.checksum()
    }
    fn observe(&self, want: Want, frame: &mut Frame) {
        self.0.observe(want, frame);
    }
    fn framing(&self, only_what_happens: bool) -> Vec<(DVec3, f64)> {
        self.0.framing(only_what_happens)
    }
}

/// Records `played` with the scene text that it carries, as another version of the program would have done.
fn record(path: &Path, played: &Scene, settings: Settings) {
    record_all(path, &[(played, settings)]);
}

/// Records scenes one after the other in one file.
fn record_all(path: &Path, played: &[(&Scene, Settings)]) {
    let mut sinks =
        Sinks::open(&Destinations { save: Some(path.to_owned()), ..Destinations::default() }).expect("a file");
    for (scene, settings) in played {
        send(&mut sinks, scene, Options::default(), settings);
    }
    sinks.finish().expect("disk space");
}

fn record_with(path: &Path, played: &Scene, options: Options, settings: Settings) {
    let mut sinks =
        Sinks::open(&Destinations { save: Some(path.to_owned()), ..Destinations::default() }).expect("a file");
    send(&mut sinks, played, options, &settings);
    sinks.finish().expect("disk space");
}

fn send(sinks: &mut Sinks, played: &Scene, options: Options, settings: &Settings) {
    let mut world = World::with_options(played.clone(), options).expect("enough memory");
    let mut recorder = Recorder::new(&AnotherVersion(&world), settings.clone()).expect("a valid schema");
    let mut messages = recorder.blueprint(&world, Tab::Scene);
    for step in 1..=settings.steps.expect("a last step") {
        let mut summary = StepSummary::default();
        Simulation::step(&mut world, &mut summary);
        recorder.observe(&world, &summary).expect("a valid step");
        if step % 1000 == 0 {
            messages.extend(recorder.take());
        }
    }
    recorder.finish();
    messages.extend(recorder.take());
    messages.into_iter().for_each(|message| sinks.send(message).expect("disk space"));
}

fn two() -> Scene {
    Scene::builtin("two").expect("a built-in scene")
}

/// Runs the program; returns its status, standard output and standard error.
fn meldscope(dir: &Dir, arguments: &[&str]) -> (i32, String, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_meldscope"))
        .args(arguments)
        .current_dir(dir.path())
        .output()
        .expect("the program starts");
    let [out, err] = [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes).into_owned());
    assert!(!err.contains("panicked"), "{err}");
    (output.status.code().expect("a status"), out, err)
}

fn succeeds(dir: &Dir, arguments: &[&str]) -> String {
    let (status, out, err) = meldscope(dir, arguments);
    assert_eq!((status, err.as_str()), (0, ""), "{out}");
    out
}

fn fails(dir: &Dir, status: i32, arguments: &[&str]) -> String {
    let (found, out, err) = meldscope(dir, arguments);
    assert_eq!(found, status, "{out}{err}");
    assert!(err.starts_with("error: "), "{err}");
    out + &err
}

// ---- replay --------------------------------------------------------------------------------------------------------

#[test]
fn every_kind_of_recording_is_replayed() {
    let dir = Dir::new();
    let path = dir.file("kind.rrd");
    let scene = two();
    let own = Settings::of(&scene);
    let kinds = [
        own.clone(),
        Settings { every: 7, steps: Some(100), ..own.clone() },
        Settings { frames: Frames::Thin, ..own.clone() },
        Settings { frames: Frames::Last { most: 5, on: vec![], after: 0 }, ..own.clone() },
        Settings { frames: Frames::Last { most: 5, on: vec![Trigger::Event("core".to_owned())], after: 2 }, ..own },
    ];
    for settings in kinds {
        record_with(&path, &scene, Options::default(), settings.clone());
        let recorded = Recorded::open(&path).expect("a recording");
        assert_eq!((recorded.first, recorded.last()), (0, settings.steps.expect("a last step")));
        let mut steps = Vec::new();
        let verdict = replay::verify(&recorded, |run| {
            steps.push(run.simulation.steps_taken());
            true
        });
        assert_eq!(verdict.expect("it runs"), Verdict::Identical, "{settings:?}");
        assert_eq!(steps, (0..=recorded.last()).collect::<Vec<_>>());
    }
}

/// Three scenes in one file, of which the second is played with this α.
fn three_in_one(path: &Path, alpha: f64) {
    let [push, mut two, three] = ["push", "two", "three"].map(|name| Scene::builtin(name).expect("a built-in scene"));
    two.influence.alpha = alpha;
    let of = |scene: &Scene, steps| Settings { steps: Some(steps), ..Settings::of(scene) };
    record_all(path, &[(&push, of(&push, 30)), (&two, of(&two, 100)), (&three, of(&three, 20))]);
}

#[test]
fn every_recording_of_a_file_is_replayed_and_one_can_be_chosen() {
    let dir = Dir::new();
    three_in_one(&dir.file("x.rrd"), two().influence.alpha);
    let line = |name: &str, steps: u64| format!("{name}: identical, {steps} steps (run with steps = {steps})\n");
    let lines = [("x.rrd, push", 30), ("x.rrd, two", 100), ("x.rrd, three", 20)].map(|(name, steps)| line(name, steps));
    assert_eq!(succeeds(&dir, &["replay", "x.rrd"]), lines.concat());
    assert_eq!(succeeds(&dir, &["replay", "x.rrd/two"]), line("x.rrd", 100));

    // what makes one recording of one needs to know which
    for arguments in [
        &["replay", "x.rrd", "--save", "y.rrd"] as &[&str],
        &["replay", "x.rrd", "--set", "influence.alpha=150"],
        &["diff", "x.rrd", "x.rrd"],
        &["explain", "x.rrd", "--step", "9"],
        &["export", "x.rrd", "--events", "e.csv"],
    ] {
        let text = fails(&dir, 2, arguments);
        let expected = "error: x.rrd: it holds 3 recordings: choose one, as x.rrd/NAME: push, two, three\n";
        assert_eq!(text, expected, "{arguments:?}");
    }
    assert!(!dir.file("y.rrd").exists() && !dir.file("e.csv").exists());
    let text = fails(&dir, 2, &["replay", "x.rrd/tow"]);
    assert!(
        text.contains("there is no \"tow\" among its 3 recordings: ") && text.contains("push, two, three"),
        "{text}"
    );
    let text = fails(&dir, 2, &["replay", "x.rrd/two", "--save", "x.rrd"]);
    assert!(text.contains("x.rrd is the recording to be replayed"), "{text}");

    succeeds(&dir, &["replay", "x.rrd/two", "--save", "y.rrd"]);
    assert!(succeeds(&dir, &["replay", "y.rrd"]).starts_with("y.rrd: identical, 100 steps"));
    assert!(succeeds(&dir, &["replay", "x.rrd/two", "--set", "influence.alpha=150"]).contains("not verified"));
    // the frames of the others are left aside
    let text = succeeds(&dir, &["diff", "x.rrd/two", "y.rrd"]);
    assert!(text.contains("101 instants in common") && text.contains("no body differs"), "{text}");
    assert!(succeeds(&dir, &["explain", "x.rrd/two", "--step", "90"]).starts_with("two, step 90 of 100"));
    succeeds(&dir, &["export", "x.rrd/two", "--events", "e.csv"]);
    assert!(fs::read_to_string(dir.file("e.csv")).expect("written").contains("merge"));
}

#[test]
fn the_worst_recording_of_a_file_decides() {
    let dir = Dir::new();
    three_in_one(&dir.file("x.rrd"), 1.01 * two().influence.alpha);
    let text = fails(&dir, 1, &["replay", "x.rrd"]);
    for part in ["x.rrd, push: identical", "x.rrd, two: divergent at step 84 of 100", "x.rrd, three: identical"] {
        assert!(text.contains(part), "{part}: {text}");
    }
    assert!(text.contains("error: two: x.rrd is not reproduced from step 84 on\n"), "{text}");
    assert!(text.ends_with("error: x.rrd: 1 of 3 recordings failed\n"), "{text}");
    assert!(succeeds(&dir, &["replay", "x.rrd/push"]).starts_with("x.rrd: identical, 30 steps"));

    // only the last recording of a file that was cut has lost its end
    three_in_one(&dir.file("x.rrd"), two().influence.alpha);
    let bytes = fs::read(dir.file("x.rrd")).expect("a file");
    fs::write(dir.file("x.rrd.partial"), &bytes[..bytes.len() * 9 / 10]).expect("disk space");
    fs::rename(dir.file("x.rrd.partial"), dir.file("cut.rrd")).expect("disk space");
    let text = fails(&dir, 2, &["replay", "cut.rrd"]);
    assert!(
        text.contains("cut.rrd, push: identical, 30 steps") && text.contains("cut.rrd, two: identical, 100"),
        "{text}"
    );
    assert!(text.contains("error: three: cut.rrd is cut short"), "{text}");
    // what does not need the end says so
    let (status, _, text) = meldscope(&dir, &["explain", "cut.rrd/three", "--step", "99999"]);
    assert!(text.starts_with("warning: cut.rrd is cut short") && text.contains("beyond the last step"), "{text}");
    assert_eq!(status, 2);
}

/// Recordings of one scene are told apart by their ids.
#[test]
fn recordings_of_one_name_go_by_their_ids() {
    let dir = Dir::new();
    let (scene, mut other) = (two(), two());
    other.dt /= 2.0;
    let of = |scene: &Scene| Settings { steps: Some(5), ..Settings::of(scene) };
    record_all(&dir.file("x.rrd"), &[(&scene, of(&scene)), (&other, of(&other))]);
    let text = fails(&dir, 2, &["replay", "x.rrd/two"]);
    let (_, names) = text.trim_end().split_once("/NAME: ").expect("the names");
    for id in names.split(", ") {
        assert!(id.starts_with("two-"), "{text}");
        let found = succeeds(&dir, &["replay", &format!("x.rrd/{id}")]);
        assert!(found.starts_with("x.rrd: identical, 5 steps"), "{found}");
    }
    assert_eq!(names.split(", ").count(), 2, "{text}");
}

#[test]
fn a_divergence_is_reported_with_step_body_vertex_and_both_values() {
    let dir = Dir::new();
    let path = dir.file("other.rrd");
    for (name, entities) in
        [("body", meldscope::stream::settings::Entities::Body), ("batch", meldscope::stream::settings::Entities::Batch)]
    {
        let mut played = two();
        played.influence.alpha *= 1.01; // in effect from the merge in step 84 on
        let settings = Settings { entities, ..Settings::of(&played) };
        record(&path, &played, settings);
        let recorded = Recorded::open(&path).expect("a recording");
        let Ok(Verdict::Divergent(divergence)) = replay::verify(&recorded, |_| true) else {
            panic!("{name}: it differs")
        };
        assert_eq!(divergence.step, 84, "{name}");
        let worst = divergence.worst(&recorded).expect("it can be read").expect("a difference");
        assert_eq!(worst.step, 84, "{name}");

        // computed by hand
        let (mut was, mut is) = (World::new(played).expect("enough memory"), World::new(two()).expect("enough memory"));
        for _ in 0..84 {
            let _ = was.step();
            let _ = is.step();
        }
        let (mut largest, mut worst_vertex) = (0.0, (0, 0));
        for (index, (a, b)) in was.bodies().zip(is.bodies()).enumerate() {
            for vertex in 0..a.vertex_count() {
                let distance = (a.local_position(vertex) - b.local_position(vertex)).length() / a.scene().radius;
                if distance > largest {
                    (largest, worst_vertex) = (distance, (index, vertex));
                }
            }
        }
        assert_eq!((worst.body.as_str(), worst.vertex), (was.body(worst_vertex.0).name(), worst_vertex.1), "{name}");
        assert!((worst.difference - largest).abs() < 1e-6, "{name}: {} {largest}", worst.difference);
        let [then, now] = [&was, &is].map(|world| world.body(worst_vertex.0).local_position(worst_vertex.1));
        assert!(worst.recorded.distance(then) < 1e-6 && worst.found.distance(now) < 1e-6, "{name}");
    }
    let output = fails(&dir, 1, &["replay", "other.rrd"]);
    for part in
        ["divergent at step 84 of 300", "up to step 83", "body \"", "vertex ", "radii apart", "is not reproduced"]
    {
        assert!(output.contains(part), "{part}: {output}");
    }
}

#[test]
fn a_thin_recording_leads_to_the_steps_in_question() {
    let dir = Dir::new();
    succeeds(&dir, &["run", "two", "--thin", "--save", "bug.rrd"]);
    let size = fs::metadata(dir.file("bug.rrd")).expect("a file").len();
    assert!(size < 32 << 10, "{size} bytes do for an e-mail");
    succeeds(&dir, &["run", "two", "--thin", "--steps", "10300", "--save", "long.rrd"]);
    let long = fs::metadata(dir.file("long.rrd")).expect("a file").len();
    assert!((long - size) / 10_000 < 16, "{} bytes a step", (long - size) / 10_000);

    assert_eq!(succeeds(&dir, &["replay", "bug.rrd"]), "bug.rrd: identical, 300 steps\n");
    let output = succeeds(&dir, &["replay", "bug.rrd", "--save", "odd.rrd", "--from", "80", "--to", "90"]);
    assert!(output.contains("saved odd.rrd: steps 80 to 90, 11 frames"), "{output}");
    let odd = Recording::open(&dir.file("odd.rrd"));
    let steps: Vec<i64> = odd.changes("/world/forces/net").iter().map(|row| row.step).collect();
    assert_eq!(steps, (80..=90).collect::<Vec<_>>());
    let output = succeeds(&dir, &["replay", "odd.rrd"]);
    assert!(output.starts_with("odd.rrd: identical, 11 steps (80 to 90)"), "{output}");
    succeeds(&dir, &["run", "two", "--thin", "--integrator", "verlet", "--save", "plain.rrd"]);
    let output = succeeds(&dir, &["replay", "plain.rrd"]);
    assert_eq!(output, "plain.rrd: identical, 300 steps (run with integrator = \"verlet\")\n");
    let set = ["--set", "influence.merge_at=1.1", "--set", "dt=0.02"];
    succeeds(&dir, &[&["run", "two", "--thin", "--save", "set.rrd"], &set[..]].concat());
    let output = succeeds(&dir, &["replay", "set.rrd", "--save", "again.rrd"]);
    let with = "(run with influence.merge_at = 1.1, dt = 0.02)";
    assert!(output.starts_with(&format!("set.rrd: identical, 250 steps {with}")), "{output}");
    let output = succeeds(&dir, &["replay", "again.rrd"]);
    assert!(output.contains(with), "{output}");
    let output = succeeds(&dir, &["replay", "set.rrd", "--set", "dt=0.01"]);
    assert!(output.contains("500 steps of 0.01 s") && output.contains("instead of 250 of 0.02 s"), "{output}");
    let output = succeeds(&dir, &["replay", "bug.rrd", "--set", "integrator=rk4"]);
    assert!(output.contains("with rk4") && output.contains("merge a~b") && output.contains("not verified"), "{output}");
}

/// Whether a replay ends before its last step because it differs, or because a varied run fails.
#[test]
fn a_replay_that_ends_early_is_saved_with_its_end() {
    let dir = Dir::new();
    let mut played = two();
    played.influence.alpha *= 1.01; // in effect from the merge in step 84 on
    record(&dir.file("other.rrd"), &played, Settings::of(&played));
    fails(&dir, 1, &["replay", "other.rrd", "--save", "odd.rrd"]);
    let odd = Recorded::open(&dir.file("odd.rrd")).expect("a whole recording");
    assert_eq!((odd.last(), &odd.failure), (83, &None));
    let output = succeeds(&dir, &["replay", "odd.rrd"]);
    assert!(output.starts_with("odd.rrd: identical, 83 steps"), "{output}");

    succeeds(&dir, &["run", "two", "--thin", "--steps", "1200", "--quiet", "--save", "long.rrd"]);
    let varied = ["replay", "long.rrd", "--set", "integrator=euler", "--set", "dt=1", "--save", "failed.rrd"];
    let output = fails(&dir, 1, &varied);
    let failed = Recorded::open(&dir.file("failed.rrd")).expect("a whole recording");
    assert!(failed.last() < 20, "{}", failed.last());
    assert!(output.contains(&format!("saved failed.rrd: steps 0 to {}, ", failed.last())), "{output}");
    let cause = failed.failure.expect("why it ended");
    assert!(output.contains(&cause), "{cause}: {output}");
    let before = fs::read(dir.file("failed.rrd")).unwrap();
    for save in ["failed.rrd", "none.rrd"] {
        let output = fails(&dir, 1, &[&varied[..7], &[save, "--from", "20"]].concat());
        assert!(output.contains("nothing is saved: the replay ended before step 20"), "{output}");
    }
    assert_eq!(fs::read(dir.file("failed.rrd")).unwrap(), before);
    assert!(!dir.file("none.rrd").exists() && !dir.file("none.rrd.partial").exists());
    let output = succeeds(&dir, &["replay", "failed.rrd"]);
    assert!(output.contains("and it fails as it did: "), "{output}");
}

#[test]
fn differences_in_program_and_machine_are_reported() {
    let dir = Dir::new();
    let path = dir.file("own.rrd");
    record(&path, &two(), Settings { frames: Frames::Thin, steps: Some(5), ..Settings::of(&two()) });
    let recorded = Recorded::open(&path).expect("a recording");
    assert!(recorded.foreign_to(&recorded.machine).is_empty());
    let other = Recorded { version: "0.0.9".to_owned(), ..recorded };
    let output = other.foreign_to("an abacus").join("\n");
    assert!(output.contains("0.0.9") && output.contains("an abacus"), "{output}");
}

#[test]
fn replay_usage_errors_have_status_2() {
    let dir = Dir::new();
    succeeds(&dir, &["run", "push", "--thin", "--quiet", "--save", "a.rrd"]);
    for arguments in [
        &["replay"] as &[&str],
        &["replay", "missing.rrd"],
        &["replay", "a.rrd", "--from", "3"],
        &["replay", "a.rrd", "--save", "b.rrd", "--from", "9", "--to", "3"],
        &["replay", "a.rrd", "--save", "b.rrd", "--to", "181"],
        &["replay", "a.rrd", "--save", "a.rrd"],
        &["diff", "a.rrd"],
        &["diff", "a.rrd", "missing.rrd"],
        &["diff", "a.rrd", "a.rrd", "--save", "a.rrd"],
        &["diff", "a.rrd", "a.rrd", "--within", "-1"],
        &["check", "missing"],
        &["check", "--bless"],
        &["check", "--bless", " "],
        &["run", "push", "--thin", "--every", "2"],
        &["run", "push", "--thin", "--keep", "2"],
        &["run", "push", "--keep", "0"],
        &["run", "push", "--on", "merge"],
        &["run", "push", "--keep", "2", "--on", "lunch"],
        &["run", "push", "--thin", "--detail", "stages"],
    ] {
        fails(&dir, 2, arguments);
    }
    assert_eq!(dir.names(), ["a.rrd"]);
}

/// Thousands of steps, with checksums in many rows, and hundreds of bodies. (`meldscope bench record` measures the cost
/// of a replay.)
#[test]
fn long_and_crowded_thin_recordings_are_replayed() {
    let dir = Dir::new();
    let path = dir.file("thin.rrd");
    // in this scene two bodies meet and separate every four seconds
    let two = Scene::load(&project().join("tests/reference/two.toml")).expect("a scene");
    let two = Scene { duration: 100.0, ..two };
    for scene in [two, Scene::builtin("crowd").expect("a built-in scene")] {
        record(&path, &scene, Settings { frames: Frames::Thin, ..Settings::of(&scene) });
        let recorded = Recorded::open(&path).expect("a recording");
        assert_eq!(recorded.last(), scene.steps());
        assert_eq!(replay::verify(&recorded, |_| true).expect("it runs"), Verdict::Identical, "{}", scene.name);
    }
}

/// b leaves a, and its reach, between two frames.
#[test]
fn a_pair_that_leaves_between_frames_is_apart() {
    let dir = Dir::new();
    let body = |name: &str, motion: &str| format!("[[body]]\nname = \"{name}\"\nradius = 1.0\nmotion = {motion}\n");
    let text = "duration = 4.0\n".to_owned()
        + &body("a", "{ fixed = [0, 0, 0] }")
        + &body("b", "{ line = { from = [-3, 0, 0], velocity = [2, 0, 0] } }");
    fs::write(dir.file("pass.toml"), text).expect("a temporary directory");
    succeeds(&dir, &["run", "pass.toml", "--every", "60", "-q"]);
    let lane = Recording::open(&dir.file("pass.rrd")).changes("/pairs/a~b/contact");
    let lane: Vec<_> = lane.iter().map(|row| (row.step, row.text("StateChange:state"))).collect();
    assert_eq!(lane, [(60, "joined and touching".to_owned()), (180, "apart".to_owned())]);
}

/// The name of a scene without one is that of its file, wherever its recordings are moved.
#[test]
fn a_recording_keeps_the_name_of_its_scene() {
    let dir = Dir::new();
    let text = "duration = 0.1\n[[body]]\nname = \"a\"\nradius = 1.0\nmotion = { fixed = [0, 0, 0] }\n";
    for name in ["ball", "ball.v2", "\u{e9}t\u{e9}"] {
        fs::write(dir.file(&format!("{name}.toml")), text).expect("a temporary directory");
        let own = format!("{name}.rrd");
        // a second time, without a note that another scene is replaced
        for _ in 0..2 {
            succeeds(&dir, &["run", &format!("{name}.toml"), "-q"]);
        }
        assert_eq!(succeeds(&dir, &["replay", &format!("{own}/{name}")]), format!("{own}: identical, 6 steps\n"));
        fs::rename(dir.file(&own), dir.file("moved.rrd")).expect("a file");
        for set in ["tolerance=1e-5", "tolerance=1e-4"] {
            succeeds(&dir, &["replay", "moved.rrd", "--set", set, "--save", "again.rrd", "-q"]);
            assert!(
                succeeds(&dir, &["explain", "again.rrd", "--step", "0"]).starts_with(&format!("{name}, step 0")),
                "{name}"
            );
            fs::rename(dir.file("again.rrd"), dir.file("moved.rrd")).expect("a file");
        }
        // the last of several values counts, and is the only one named
        let output = succeeds(&dir, &["replay", "moved.rrd"]);
        assert_eq!(output, "moved.rrd: identical, 6 steps (run with tolerance = 1e-4)\n");
        fs::remove_file(dir.file("moved.rrd")).expect("a file");
    }
}

/// Two bodies at rest that no force moves: only their phase differs, and it never changes.
#[test]
fn runs_that_begin_in_different_phases_differ() {
    let dir = Dir::new();
    let text = "duration = 0.1\n[influence]\nalpha = 0\nbeta = 0\nsplit_at = 1.5\n\
                [[body]]\nname = \"a\"\nradius = 1.0\nmotion = { fixed = [0, 0, 0] }\n\
                [[body]]\nname = \"b\"\nradius = 1.0\nmotion = { fixed = [1.9, 0, 0] }\n";
    fs::write(dir.file("rest.toml"), text).expect("a temporary directory");
    for (file, merge_at) in [("one.rrd", "1.05"), ("two.rrd", "0.9")] {
        let set = format!("influence.merge_at={merge_at}");
        succeeds(&dir, &["run", "rest.toml", "--set", &set, "--save", file, "-q"]);
    }
    let (status, out, err) = meldscope(&dir, &["diff", "one.rrd", "two.rrd"]);
    assert_eq!((status, err.as_str()), (1, "error: one.rrd and two.rrd differ\n"), "{out}");
    assert!(out.contains("\nphases at the start: a~b: merged and apart\n"), "{out}");
    assert!(out.contains("are the same within the tolerance, where both have them\n"), "{out}");
    succeeds(&dir, &["diff", "one.rrd", "one.rrd"]);
}

// ---- flight recorder -----------------------------------------------------------------------------------------------

#[test]
fn a_flight_recorder_holds_the_frames_before_its_trigger() {
    let dir = Dir::new();
    let output = succeeds(&dir, &["run", "two", "--keep", "10", "--on", "split", "--save", "split.rrd"]);
    assert!(output.contains("saved split.rrd: 10 frames"), "{output}");
    succeeds(&dir, &["run", "two", "--quiet", "--save", "all.rrd"]);
    let (kept, all) = (Recording::open(&dir.file("split.rrd")), Recording::open(&dir.file("all.rrd")));
    let frames: Vec<u64> = (190..=199).collect();
    let shown =
        ["/world/bodies/a/surface", "/world/bodies/a", "/world/bodies/b", "/world/influence", "/world/forces/net"];
    for entity in shown {
        let shown = |of: &Recording| of.held(entity, frames.clone()).into_iter().map(Row::values).collect::<Vec<_>>();
        assert_eq!(shown(&kept), shown(&all), "{entity}");
        // before the first frame and after the last one, views of an instant are empty
        let rows: Vec<_> = kept.rows(&entity.into()).into_iter().map(|(_, row)| row).collect();
        let cleared: Vec<i64> = rows.iter().filter(|row| row.has("Clear:is_recursive")).map(|row| row.step).collect();
        assert_eq!(cleared, [200], "{entity}");
        assert!(rows.iter().all(|row| (190..=200).contains(&row.step)), "{entity}");
    }
    // the last row is all that the viewer takes of a transform
    for entity in ["/world/bodies/a", "/world/bodies/b"] {
        let rows = kept.changes(entity).into_iter().filter(|row| row.step < 200);
        assert!(rows.into_iter().all(|row| row.vectors("Transform3D:translation").len() == 1), "{entity}");
    }
    for entity in ["/checksum", "/events", "/pairs/a~b/phase"] {
        assert_eq!(kept.changes(entity), all.changes(entity), "{entity}");
    }
    let output = succeeds(&dir, &["run", "two", "--keep", "10", "--on", "core,diverge", "--save", "none.rrd"]);
    assert!(output.contains("no --on event occurred: none.rrd is not written"), "{output}");
    assert!(!dir.file("none.rrd").exists());
    let output = succeeds(&dir, &["run", "two", "--keep", "4", "--save", "end.rrd"]);
    assert!(output.contains("4 frames"), "{output}");
    let end = Recording::open(&dir.file("end.rrd"));
    let surface = |of: &Recording| of.held("/world/bodies/a/surface", vec![297, 300]);
    assert_eq!(surface(&end), surface(&all));
    let output = succeeds(&dir, &["run", "three", "--keep", "3", "--on", "merge,split", "--save", "three.rrd"]);
    assert!(output.contains("saved three.rrd: 13 frames"), "each window once: steps 80, 81, 170, 178, 185: {output}");
}

/// Stages describe steps, but a flight recorder holds only frames.
#[test]
fn a_flight_recorder_rejects_stages_and_names_a_remedy() {
    let dir = Dir::new();
    let output = fails(&dir, 2, &["run", "two", "--keep", "10", "--on", "split", "--detail", "stages"]);
    assert!(
        output.contains("--keep") && output.contains("meldscope replay F.rrd --save G.rrd --from STEP"),
        "{output}"
    );
    assert!(dir.names().is_empty());
    // as the error message suggests
    succeeds(&dir, &["run", "two", "--keep", "10", "--on", "split", "--save", "split.rrd"]);
    let range = ["--from", "198", "--to", "199", "--detail", "stages"];
    succeeds(&dir, &[&["replay", "split.rrd", "--save", "inside.rrd"] as &[_], &range].concat());
    assert!(Recording::open(&dir.file("inside.rrd")).entities().contains(&"/stages".into()));
}

/// The file of a scene's mesh is removed after the scene has been recorded.
#[test]
fn a_recording_carries_its_meshes() {
    let dir = Dir::new();
    fs::write(dir.file("tetrahedron.obj"), "v 0 0 0\nv 3 0 0\nv 0 3 0\nv 0 0 3\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
        .expect("disk space");
    let text = "duration = 0.5\n[[body]]\nname = \"a\"\nradius = 1\nshape = { mesh = \"tetrahedron.obj\" }\nmotion = { free = { from = [0, 0, 0] } }\n\
        [[body]]\nname = \"b\"\nradius = 1\nmotion = { free = { from = [1.5, 0, 0] } }\n";
    fs::write(dir.file("own.toml"), text).expect("disk space");
    fs::write(dir.file("other.obj"), "v 0 0 0\nv 2 0 0\nv 0 3 0\nv 0 0 3\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
        .expect("disk space");
    let with_other = ["--set", "body.a.shape.mesh=other.obj", "--save", "other.rrd"];
    succeeds(&dir, &["run", "own.toml", "--quiet"]);
    succeeds(&dir, &[&["run", "own.toml", "--quiet"] as &[_], &with_other].concat());
    for mesh in ["tetrahedron.obj", "other.obj"] {
        fs::remove_file(dir.file(mesh)).expect("it exists");
    }
    let rejected = fails(&dir, 2, &["run", "own.toml", "--quiet"]);
    assert!(rejected.contains("tetrahedron.obj"), "{rejected}");
    for recording in ["own.rrd", "other.rrd"] {
        let out = succeeds(&dir, &["replay", recording]);
        assert!(out.contains("identical, 30 steps"), "{out}");
    }
}

// ---- check ---------------------------------------------------------------------------------------------------------

fn project() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// The golden recordings of this repository match with any number of threads.
#[test]
fn the_golden_recordings_of_this_repository_match() {
    let dir = Dir::new();
    let recordings = project().join("recordings");
    // of rain it would take too long, and the scenes of the thesis's figures have tests of their own
    let has_golden = |name: &&str| recordings.join(format!("{name}.toml")).exists();
    let built_in = builtin::ALL.into_iter().map(|builtin| builtin.name).filter(has_golden);
    // one scene for each of the other models
    let kept: Vec<&str> = built_in.chain(["balls", "elements", "tear"]).collect();
    for threads in ["1", "2", "3", "8"] {
        let (status, out, err) = meldscope(&dir, &["check", &recordings.to_string_lossy(), "--threads", threads]);
        assert_eq!(status, 0, "on {threads} threads: {out}{err}");
        assert_eq!(out.lines().count(), kept.len(), "{out}");
    }
    let reasons = fs::read_to_string(recordings.join("BLESSED.md")).expect("reasons");
    let mut bytes = 0;
    for name in kept {
        let path = recordings.join(format!("{name}.rrd"));
        bytes += fs::metadata(&path).expect("a golden recording").len();
        let recorded = Recorded::open(&path).expect("a recording");
        assert!(reasons.contains(&format!("{name} {:016x}", golden::digest(&recorded.checksums))), "{reasons}");
        let reason = recorded.blessed.expect("a reason");
        assert!(!reason.is_empty() && reasons.contains(&reason), "{reason}");
    }
    assert!(bytes < 8 << 20, "{bytes} bytes");
}

#[test]
fn a_planted_bit_is_found_and_located() {
    let dir = Dir::new();
    let path = dir.file("two.rrd");
    golden::bless(&two(), &path, "a test").expect("disk space");
    let mut planted = two();
    planted.influence.beta = planted.influence.beta.next_up();
    let comparison = dir.file("two.check.rrd");
    let Ok(GoldenOutcome::Different(difference)) = golden::check(&planted, &path, Some(&comparison)) else {
        panic!("it differs")
    };
    assert!(difference.is_tolerable() && difference.is_within_tolerance && difference.events.is_empty());

    // the first state that differs, computed by hand
    let (mut was, mut is) = (World::new(two()).expect("enough memory"), World::new(planted).expect("enough memory"));
    let state = |world: &World| {
        let bodies = world.bodies();
        let bits = |body: meldscope::sim::BodyView<'_>| {
            (0..body.vertex_count()).map(|i| (body.displacement(i), body.velocity(i))).collect::<Vec<_>>()
        };
        bodies.map(bits).collect::<Vec<_>>()
    };
    while state(&was) == state(&is) {
        let _ = was.step();
        let _ = is.step();
    }
    let first = difference.first.expect("a step");
    assert_eq!(first.step, was.steps_taken());
    let differing: Vec<(String, Vec<usize>)> = was
        .bodies()
        .zip(state(&was).into_iter().zip(state(&is)))
        .map(|(body, (was, is))| {
            (body.name().to_owned(), (0..was.len()).filter(|&i| was[i] != is[i]).collect::<Vec<_>>())
        })
        .filter(|(_, vertices)| !vertices.is_empty())
        .collect();
    assert_eq!(first.bodies, differing, "every vertex, but for one chance in 65,536 each");
    let worst = difference.worst.expect("a differing state");
    assert!(worst.difference > 0.0 && worst.difference < 1e-12, "{}", worst.difference);
    let both = Recording::open(&comparison);
    for entity in ["/world/a/a", "/world/b/a", "/world/error", "/difference/a", "/difference/tolerance", "/about"] {
        assert!(both.entities().contains(&entity.into()), "{entity}");
    }
}

#[test]
fn check_reports_differences_and_bless_needs_a_reason() {
    let dir = Dir::new();
    let text = builtin::ALL[1].text;
    fs::write(dir.file("two.toml"), text).expect("disk space");
    let output = fails(&dir, 1, &["check", "."]);
    assert!(output.contains("two: no golden recording"), "{output}");
    succeeds(&dir, &["check", ".", "--bless", "first  of\nall"]);
    assert!(succeeds(&dir, &["check", "two.toml"]).starts_with("two: identical, 300 steps, 2 events"));
    assert!(succeeds(&dir, &["check", "two.rrd"]).starts_with("two: identical"));
    assert_eq!(succeeds(&dir, &["check", ".", "--bless", "again"]), "two: identical, kept\n");
    let reasons = fs::read_to_string(dir.file("BLESSED.md")).expect("reasons");
    assert_eq!(reasons.lines().filter(|line| line.ends_with(": first of all")).count(), 1, "{reasons}");
    assert!(!reasons.contains("again"), "nothing was made again: {reasons}");

    fs::write(dir.file("two.toml"), format!("# a comment\n{text}")).expect("disk space");
    assert!(succeeds(&dir, &["check", "."]).contains("its text has changed, without effect"));

    fs::write(dir.file("two.toml"), text.replace("merge_at = 1.05", "merge_at = 1.06")).expect("disk space");
    let output = fails(&dir, 1, &["check", "."]);
    for part in [
        "two: DIFFERENT",
        "first at step",
        "body \"",
        "BEYOND tolerance",
        "event moved: merge a~b",
        "rerun two.check.rrd",
    ] {
        assert!(output.contains(part), "{part}: {output}");
    }
    assert!(dir.names().contains(&"two.check.rrd".to_owned()));
    fails(&dir, 1, &["check", ".", "--tolerant"]);

    fs::write(dir.file("two.toml"), text.replace("duration = 5.0", "duration = 4.0")).expect("disk space");
    let output = fails(&dir, 1, &["check", "."]);
    assert!(output.contains("240 steps, 300 in the golden recording"), "{output}");

    fs::write(dir.file("two.toml"), format!("integrator = \"rk4\"\n{text}")).expect("disk space");
    let output = fails(&dir, 1, &["check", "."]);
    assert!(output.contains("run with rk4, the golden recording with exponential"), "{output}");

    let finer = text.replacen("radius = 1.0\n", "radius = 1.0\nshape = { sphere = { stacks = 6, slices = 8 } }\n", 1);
    fs::write(dir.file("two.toml"), finer).expect("disk space");
    let output = fails(&dir, 1, &["check", "."]);
    assert!(output.contains("532 vertices") && output.contains("triangles"), "{output}");

    fs::write(dir.file("two.toml"), "name = 3").expect("disk space");
    fails(&dir, 2, &["check", "."]);
    fs::write(dir.file("two.toml"), text).expect("disk space");
    fs::write(dir.file("two.rrd"), b"RRF2 and nothing else").expect("disk space");
    fails(&dir, 2, &["check", "."]);
}

/// Bodies at rest on their paths have no part in checksums.
#[test]
fn check_sees_bodies_that_are_elsewhere() {
    let dir = Dir::new();
    let text = "duration = 1.0\n[[body]]\nname = 'a'\nradius = 1.0\nmotion = { line = { from = [0, 0, 0], velocity = [1, 0, 0] } }\n\
        [[body]]\nname = 'b'\nradius = 1.0\nmotion = { fixed = [0, 9, 0] }\n";
    fs::write(dir.file("far.toml"), text).expect("disk space");
    succeeds(&dir, &["check", ".", "--bless", "a test"]);
    fs::write(dir.file("far.toml"), text.replace("duration = 1.0", "duration = 1")).expect("disk space");
    assert!(succeeds(&dir, &["check", "."]).contains("without effect"));
    for (old, new, step, expected) in [
        (
            "[1, 0, 0]",
            "[3, 0, 0]",
            1,
            "body \"a\" has radius 1, centre (0.05, 0.0, 0.0), in the golden recording radius 1, centre (0.01",
        ),
        ("[0, 9, 0]", "[0, 90, 0]", 0, "body \"b\" has radius 1, centre (0.0, 90.0, 0.0)"),
        ("'b'\nradius = 1.0", "'b'\nradius = 2.0", 0, "body \"b\" has radius 2, centre (0.0, 9.0, 0.0)"),
    ] {
        fs::write(dir.file("far.toml"), text.replace(old, new)).expect("disk space");
        for tolerant in [&["check", "."][..], &["check", ".", "--tolerant"]] {
            let output = fails(&dir, 1, tolerant);
            assert!(output.contains(&format!("  at step {step}: {expected}")), "{output}");
        }
    }
}

/// Any recording has checksums, but only a golden one has states, without which no difference is tolerable.
#[test]
fn check_says_what_an_ordinary_recording_lacks() {
    let dir = Dir::new();
    let text = builtin::ALL[1].text;
    fs::write(dir.file("two.toml"), text).expect("disk space");
    succeeds(&dir, &["run", "two.toml", "--quiet", "--save", "two.rrd"]);
    assert!(succeeds(&dir, &["check", "."]).starts_with("two: identical"));
    fs::write(dir.file("two.toml"), text.replace("alpha = 220", "alpha = 221")).expect("disk space");
    for tolerant in [&["check", "."][..], &["check", ".", "--tolerant"]] {
        let output = fails(&dir, 1, tolerant);
        assert!(output.contains("this is no golden recording; ") && !output.contains("body \""), "{output}");
    }
    assert!(!dir.names().contains(&"two.check.rrd".to_owned()));
    fs::write(dir.file("two.toml"), text).expect("disk space");
    let (status, out, err) = meldscope(&dir, &["check", ".", "--bless", "it has states now"]);
    assert!(status == 0 && !out.contains("kept") && err.contains("two.rrd is replaced, a recording of"), "{out}{err}");
    assert_eq!(succeeds(&dir, &["check", ".", "--bless", "again"]), "two: identical, kept\n");
}

// ---- diff ----------------------------------------------------------------------------------------------------------

#[test]
fn diff_compares_two_runs_of_a_scene() {
    let dir = Dir::new();
    succeeds(&dir, &["run", "two", "--quiet", "--save", "a.rrd"]);
    succeeds(&dir, &["run", "two", "--quiet", "--integrator", "rk4", "--every", "2", "--save", "b.rrd"]);
    succeeds(&dir, &["run", "two", "--quiet", "--set", "dt=0.008333333333333333", "--save", "c.rrd"]);
    succeeds(&dir, &["run", "two", "--quiet", "--thin", "--save", "thin.rrd"]);
    succeeds(&dir, &["run", "push", "--quiet", "--save", "push.rrd"]);

    let output = succeeds(&dir, &["diff", "a.rrd", "a.rrd"]);
    assert!(
        output.contains("bits: the same") && output.contains("no body differs") && output.contains("events: the same"),
        "{output}"
    );
    let output = succeeds(&dir, &["diff", "a.rrd", "c.rrd"]);
    assert!(output.contains("301 instants"), "aligned by time: {output}");
    let output = succeeds(&dir, &["diff", "a.rrd", "thin.rrd"]);
    assert!(output.contains("run again") && output.contains("no body differs"), "{output}");

    let output = fails(&dir, 1, &["diff", "a.rrd", "b.rrd", "--save", "d.rrd"]);
    for part in ["151 instants", "body \"a\": up to 0.014", "first beyond tolerance: step 52", "saved d.rrd"] {
        assert!(output.contains(part), "{part}: {output}");
    }
    let output = succeeds(&dir, &["diff", "a.rrd", "b.rrd", "--within", "0.1"]);
    assert!(output.contains("events: the same"), "{output}");
    let both = Recording::open(&dir.file("d.rrd"));
    assert_eq!(both.changes("/world/a/a").len(), 151);
    assert_eq!(both.changes("/difference/b").len(), 151);
    fails(&dir, 2, &["diff", "a.rrd", "push.rrd"]);
    let output = fails(&dir, 2, &["diff", "a.rrd", "d.rrd"]);
    assert!(output.contains("it is a comparison"), "{output}");

    let other =
        builtin::ALL[1].text.replace("merge_at = 1.05", "merge_at = 1.06").replace("split_at = 1.2", "split_at = 1.4");
    fs::write(dir.file("other.toml"), other).expect("disk space");
    succeeds(&dir, &["run", "other.toml", "--quiet", "--save", "other.rrd"]);
    let output = fails(&dir, 1, &["diff", "a.rrd", "other.rrd"]);
    for part in [
        "the texts of the two scenes differ",
        "event moved: merge a~b",
        "event vanished: split a~b",
        "exponential, influence.merge_at = 1.05, influence.split_at = 1.2, by",
        "exponential, influence.merge_at = 1.06, influence.split_at = 1.4, by",
    ] {
        assert!(output.contains(part), "{part}: {output}");
    }
    succeeds(&dir, &["run", "two", "--quiet", "--set", "influence.merge_at=1.0", "--save", "set.rrd"]);
    let output = fails(&dir, 1, &["diff", "a.rrd", "set.rrd"]);
    for part in ["exponential, influence.merge_at = 1.05, by", "exponential, influence.merge_at = 1.0, by"] {
        assert!(output.contains(part), "{part}: {output}");
    }
    fails(&dir, 1, &["diff", "a.rrd", "other.rrd", "--save", "moved.rrd"]);
    let events = Recording::open(&dir.file("moved.rrd")).rows(&"/events".into());
    let is_there = |part: &str| events.iter().any(|(_, row)| row.text("TextLog:text").contains(part));
    assert!(is_there("s earlier: merge a~b at t = ") && is_there("gap of a~b: "), "{events:?}");
}

/// b jumps to a at the end of step 3, which is after 0.3 s in floating point.
#[test]
fn a_comparison_has_an_event_at_the_end_of_its_step() {
    let dir = Dir::new();
    let text = "duration = 0.6\ndt = 0.1\n[[body]]\nname = 'a'\nradius = 1.0\nmotion = { fixed = [0, 0, 0] }\n[[body]]\n\
                name = 'b'\nradius = 1.0\nmotion = { keyframes = { interpolation = 'hold', keys = [[0, 4, 0, 0], \
                [0.30000000000000004, 2, 0, 0]] } }\n";
    fs::write(dir.file("jump.toml"), text).expect("disk space");
    succeeds(&dir, &["run", "jump.toml", "--quiet", "--save", "a.rrd"]);
    succeeds(&dir, &["run", "jump.toml", "--quiet", "--set", "influence.merge_at=0.5", "--save", "b.rrd"]);
    fails(&dir, 1, &["diff", "a.rrd", "b.rrd", "--save", "d.rrd"]);
    let compared = Recording::open(&dir.file("d.rrd"));
    let events = compared.rows(&"/events".into());
    let merge = events.iter().find(|(_, row)| row.text("TextLog:text").contains("vanished: merge a~b"));
    assert_eq!(merge.map(|(_, row)| row.step), Some(3), "{events:?}");
    // the thresholds that differ are drawn, and no others
    for (side, level) in [("a", 1.05), ("b", 0.5)] {
        let rows = |threshold: &str| compared.rows(&format!("/q/levels/{side}/a~b/{threshold}").as_str().into());
        let merge_at = rows("merge_at");
        assert!(merge_at.len() > 1 && merge_at.iter().all(|(_, row)| row.scalar() == Some(level)), "{merge_at:?}");
        assert!(rows("split_at").is_empty());
    }
}

/// Where a run failed, the body with the largest displacement is labelled, above its centre; the panel begins with the reason.
#[test]
fn a_failed_run_shows_where() {
    let dir = Dir::new();
    let unstable = ["--set", "integrator=euler", "--set", "material.omega=300"];
    fails(&dir, 1, &[&["run", "two", "--quiet", "--save", "a.rrd"], &unstable[..]].concat());
    let recording = Recording::open(&dir.file("a.rrd"));
    let rows = recording.rows(&"/world/not_recorded".into());
    let [(_, row)] = &rows[..] else { panic!("one label: {rows:?}") };
    let label = row.texts("Points3D:labels").concat();
    assert!(label.starts_with("failed; largest displacement: "), "{label}");
    let failure = recording.rows(&"/events/failure".into());
    assert_eq!(failure.last().map(|(_, row)| row.step), Some(row.step));
    let panel = recording.fixed("/about").text("TextDocument:text");
    assert!(panel.starts_with("**Failed**: "), "{panel}");
}

/// The frames of a flight recorder are those of the whole run.
#[test]
fn diff_reads_the_frames_of_a_flight_recorder() {
    let dir = Dir::new();
    let stronger = ["--set", "influence.beta=90"];
    for scene in ["two", "collide"] {
        let run = |name: &str, how: &[&str]| {
            let save = format!("{scene}-{name}.rrd");
            succeeds(&dir, &[&["run", scene, "--quiet", "--save", &save], how].concat());
            save
        };
        let [plain, other] = [run("plain", &[]), run("other", &stronger)];
        let keeps = [&["--keep", "100000"][..], &["--keep", "50"], &["--keep", "8+4", "--on", "merge,split"]];
        for (number, keep) in keeps.iter().enumerate() {
            let output = succeeds(&dir, &["diff", &plain, &run(&format!("kept-{number}"), keep)]);
            assert!(output.contains("bits: the same") && output.contains("no body differs"), "{keep:?}: {output}");
        }
        // so many that no chunk has the timings of all
        let long = ["--detail", "surface", "--set", "dt=0.005"];
        let kept = run("long-kept", &[&long[..], &["--keep", "780"]].concat());
        let output = succeeds(&dir, &["diff", &run("long", &long), &kept]);
        assert!(output.contains("780 instants in common") && output.contains("no body differs"), "{output}");
        let bodies = |first: &str, second: &str| {
            let output = fails(&dir, 1, &["diff", first, second]);
            output.lines().filter(|line| line.contains("body \"")).map(str::to_owned).collect::<Vec<_>>()
        };
        let differing = bodies(&plain, &other);
        assert!(differing.len() > 2, "{differing:?}");
        let other_kept = run("other-kept", &[&stronger[..], keeps[0]].concat());
        assert_eq!(bodies(&format!("{scene}-kept-0.rrd"), &other_kept), differing);
    }
}

/// A file that ends before what completes its frames is run again, like one that has none.
#[test]
fn diff_compares_a_recording_that_is_cut_short() {
    let dir = Dir::new();
    succeeds(&dir, &["run", "two", "--quiet", "--save", "whole.rrd"]);
    let whole = fs::read(dir.file("whole.rrd")).expect("a recording");
    for share in [0.4, 0.7] {
        fs::write(dir.file("cut.rrd"), &whole[..(share * whole.len() as f64) as usize]).expect("disk space");
        let (status, output, warnings) = meldscope(&dir, &["diff", "whole.rrd", "cut.rrd"]);
        assert_eq!(status, 0, "{share}: {output}{warnings}");
        assert!(output.contains("bits: the same") && output.contains("no body differs"), "{share}: {output}");
        assert!(warnings.starts_with("warning: cut.rrd is cut short"), "{share}: {warnings}");
    }
}

/// Surfaces may touch and part at other times though all phases change at the same.
#[test]
fn diff_compares_when_surfaces_touch_and_part() {
    let dir = Dir::new();
    let run = |save: &str, how: &[&str]| {
        succeeds(&dir, &[&["run", "two", "--quiet", "--save", save], how].concat());
    };
    let stronger = ["--set", "influence.alpha=221"];
    run("a.rrd", &[]);
    run("thin.rrd", &["--thin"]);
    run("kept.rrd", &["--keep", "3", "--on", "merge"]);
    run("dt.rrd", &["--set", "dt=0.01"]);
    run("strong.rrd", &stronger);
    run("strong-thin.rrd", &[&stronger[..], &["--thin"]].concat());
    succeeds(&dir, &["replay", "a.rrd", "--from", "100", "--to", "250", "--save", "slice.rrd"]);

    // times are found to 1e-7 s in steps of any size; a recording that begins later has only the later events
    for other in ["thin.rrd", "kept.rrd", "dt.rrd", "slice.rrd"] {
        let output = succeeds(&dir, &["diff", "a.rrd", other]);
        assert!(output.contains("events: the same"), "{other}: {output}");
    }
    for (one, other) in [("a.rrd", "strong.rrd"), ("a.rrd", "strong-thin.rrd"), ("thin.rrd", "strong-thin.rrd")] {
        let output = fails(&dir, 1, &["diff", one, other, "--save", "moved.rrd"]);
        let moved: Vec<&str> = output.lines().filter(|line| line.starts_with("event")).collect();
        let [touch, part] = moved[..] else { panic!("{one}, {other}: {output}") };
        assert!(touch.starts_with("event moved: touch a~b at t = 1.48017") && touch.ends_with(" s earlier"), "{touch}");
        assert!(part.starts_with("event moved: part a~b at t = 3.38924") && part.ends_with(" s later"), "{part}");
        let rows = Recording::open(&dir.file("moved.rrd")).rows(&"/events".into());
        let is_there = |part: &str| rows.iter().any(|(_, row)| row.text("TextLog:text").contains(part));
        assert!(is_there("s earlier: touch a~b at t = 1.48017") && !is_there("the same: "), "{rows:?}");
    }
}

/// Every line has a point in every kept frame, and no line connects one window to the next.
#[test]
fn a_flight_recorder_keeps_whole_lines() {
    let dir = Dir::new();
    succeeds(&dir, &["run", "three", "--keep", "3", "--on", "merge,split", "--quiet", "--save", "three.rrd"]);
    let kept = Recording::open(&dir.file("three.rrd"));
    let windows: Vec<i64> = [78..=81, 168..=170, 176..=178, 183..=185].into_iter().flatten().collect();
    let gaps = [82, 171, 179, 186];
    let entities = kept.entities();
    let lines: Vec<String> = entities
        .iter()
        .map(ToString::to_string)
        .filter(|entity| {
            entity.starts_with("/timings/")
                || entity.starts_with("/diagnostics/")
                || (entity.starts_with("/pairs/") && !entity.ends_with("/phase"))
        })
        .collect();
    assert!(lines.iter().any(|line| line.ends_with("/merge_at")), "{lines:?}");
    for line in lines {
        let rows = kept.changes(&line);
        let (points, ends): (Vec<_>, Vec<_>) =
            rows.iter().partition(|row| !row.get::<sdk::datatypes::Float64>("Scalars:scalars").is_empty());
        let [points, ends] = [points, ends].map(|rows| rows.iter().map(|row| row.step).collect::<Vec<_>>());
        if line.starts_with("/diagnostics/") || line == "/timings/integrate" {
            assert_eq!((&points, &ends[..]), (&windows, &gaps[..]), "{line}");
        }
        assert!(points.iter().all(|step| windows.contains(step)), "{line}: {points:?}");
        // a pair within reach at the end of a window is no longer within reach after it
        for (last, gap) in [(81, 82), (170, 171), (178, 179), (185, 186)] {
            assert!(!points.contains(&last) || ends.contains(&gap), "{line}: {points:?} {ends:?}");
        }
    }
    // thresholds accompany the distance wherever there is one
    let steps = |entity: &str| kept.changes(entity).iter().map(|row| row.step).collect::<Vec<_>>();
    for pair in ["a~b", "b~c"] {
        assert_eq!(steps(&format!("/pairs/{pair}/merge_at")), steps(&format!("/pairs/{pair}/distance")), "{pair}");
    }
    // lanes of what only frames tell end with them
    let lane = kept.changes("/pairs/a~b/contact");
    let state =
        |row: &crate::recording::Row| row.get::<sdk::datatypes::Utf8>("StateChange:state")[0].as_str().to_owned();
    let (ends, others): (Vec<_>, Vec<_>) = lane.iter().partition(|row| state(row).is_empty());
    let [ends, others] = [ends, others].map(|rows| rows.iter().map(|row| row.step).collect::<Vec<i64>>());
    assert!(!ends.is_empty() && ends.iter().all(|step| gaps.contains(step)), "{ends:?}");
    assert!(!others.is_empty() && others.iter().all(|step| windows.contains(step)), "{others:?}");
    // and it is read back with the frames that it has
    let recorded = Recorded::open(&dir.file("three.rrd")).expect("a recording");
    let mut frames = meldscope::recording::frames::FrameReader::open(&recorded).expect("a recording");
    let mut seen = Vec::new();
    while let Some(frame) = frames.next().expect("a recording") {
        seen.push(frame.step as i64);
    }
    assert_eq!(seen, windows);
}

#[test]
fn a_slice_names_its_steps() {
    let dir = Dir::new();
    succeeds(&dir, &["run", "two", "--thin", "--quiet", "--save", "a.rrd"]);
    succeeds(&dir, &["replay", "a.rrd", "--from", "80", "--to", "90", "--save", "b.rrd"]);
    let about = |name: &str| {
        let row = Recording::open(&dir.file(name)).fixed("/about");
        row.get::<sdk::datatypes::Utf8>("TextDocument:text")[0].as_str().to_owned()
    };
    assert!(about("b.rrd").contains("steps 80 to 90, a frame every step"), "{}", about("b.rrd"));
    succeeds(&dir, &["run", "two", "--steps", "1", "--quiet", "--save", "c.rrd"]);
    assert!(about("c.rrd").contains("1 step, a frame every step"), "{}", about("c.rrd"));
    let output = succeeds(&dir, &["replay", "c.rrd"]);
    assert!(output.contains("identical, 1 step (run with steps = 1)"), "{output}");
}

#[test]
fn check_runs_every_scene_once() {
    let dir = Dir::new();
    for name in ["one.toml", "two.toml"] {
        fs::write(dir.file(name), builtin::ALL[1].text).expect("disk space");
    }
    let output = succeeds(&dir, &["check", "one.toml", "two.toml", "one.toml", ".", "--bless", "first of all"]);
    let names: Vec<&str> = output.lines().filter_map(|line| line.split(':').next()).collect();
    assert_eq!(names, ["one", "two"], "{output}");
}

/// Scenes of the same name, in several folders, have their own comparisons and are told apart.
#[test]
fn check_tells_scenes_of_the_same_name_apart() {
    let dir = Dir::new();
    let files = ["x/a.toml", "y/a.toml", "x/a-2.toml"];
    for folder in ["x", "y"] {
        fs::create_dir(dir.file(folder)).expect("disk space");
    }
    let write = |text: &str| files.map(|file| fs::write(dir.file(file), text).expect("disk space"));
    write(builtin::ALL[1].text);
    succeeds(&dir, &["check", "x", "y", "--bless", "first of all"]);
    write(&builtin::ALL[1].text.replace("merge_at = 1.05", "merge_at = 1.06"));
    let output = fails(&dir, 1, &["check", "x", "y", "--out", "out"]);
    for name in ["x/a", "a-2", "y/a"] {
        assert!(output.lines().any(|line| line == format!("{name}: DIFFERENT")), "{name}: {output}");
    }
    let written = fs::read_dir(dir.file("out")).expect("a folder").count();
    assert_eq!(written, 3, "{output}");
}

/// A file that is said to be replaced is replaced.
#[test]
fn a_file_is_said_to_be_replaced_once_its_path_is_claimed() {
    let dir = Dir::new();
    succeeds(&dir, &["run", "push", "--thin", "--quiet", "--save", "a.rrd"]);
    fs::copy(dir.file("a.rrd"), dir.file("b.rrd")).expect("disk space");
    fs::create_dir(dir.file("b.rrd.partial")).expect("a folder");
    for arguments in
        [&["diff", "a.rrd", "a.rrd", "--save", "b.rrd"] as &[&str], &["bench", "models", "--save", "b.rrd"]]
    {
        let (status, _, err) = meldscope(&dir, arguments);
        assert_ne!(status, 0);
        assert!(err.contains("b.rrd.partial") && !err.contains("is replaced"), "{err}");
    }
    fs::remove_dir(dir.file("b.rrd.partial")).expect("an empty folder");
    let (status, _, err) = meldscope(&dir, &["diff", "a.rrd", "a.rrd", "--save", "b.rrd"]);
    assert_eq!((status, err.as_str()), (0, "note: b.rrd is replaced, a thin recording of the scene \"push\"\n"));
}

#[test]
fn check_rejects_missing_files() {
    let dir = Dir::new();
    let output = fails(&dir, 2, &["check", "two"]);
    assert!(output.contains("there is no scene two") && !output.contains("built-in"), "{output}");
}

/// A quantity of the surface of a scene after some steps, computed from the state alone.
fn surface_after(scene: &Scene, steps: u64, what: &str) -> f64 {
    let mut world = World::new(scene.clone()).expect("enough memory");
    for _ in 0..steps {
        let _ = world.step();
    }
    let (schema, mut frame) = (world.schema(), Frame::default());
    world.observe(Want::default(), &mut frame);
    let mut merger = Merger::new(&schema, None);
    let merged = merger.merge(&schema, &frame, &[[0, 1]]);
    let (pair, group) = (merged.pairs[0].expect("measures"), merged.groups.first());
    match what {
        "gap of a~b" => pair.gap,
        "overlap of a~b" => pair.overlap,
        "neck of a~b" => pair.neck,
        "volume of a's group" => group.expect("a group").volume,
        "area of a's group" => group.expect("a group").area,
        _ => panic!("{what}"),
    }
}

#[test]
fn diff_compares_surfaces() {
    let dir = Dir::new();
    let [a, b, fine] = ["a.rrd", "b.rrd", "fine.rrd"].map(|name| dir.file(name));
    let mut stronger = two();
    stronger.influence.alpha *= 1.01;
    let mut finer = two();
    finer.dt /= 2.0;
    for (path, scene) in [(&a, &two()), (&b, &stronger), (&fine, &finer)] {
        record(path, scene, Settings::of(scene));
    }
    let [a, b, fine] = [a, b, fine].map(|path| Recorded::open(&path).expect("a recording"));
    assert_eq!(diff::diff([&a, &a], 1e-9).expect("both can be read").surfaces, Some(Vec::new()));
    // two runs within the tolerance have surfaces within it at common instants
    let same = diff::diff([&a, &fine], 1e-6).expect("both can be read");
    assert_eq!((same.instants, same.first_beyond, same.surfaces), (301, None, Some(Vec::new())));

    let deviations = diff::diff([&a, &b], 1e-5).expect("both can be read").surfaces.expect("both hold surfaces");
    let named: Vec<&str> = deviations.iter().map(|deviation| deviation.what.as_str()).collect();
    for what in ["gap of a~b", "overlap of a~b", "neck of a~b", "volume of a's group", "area of a's group"] {
        let index = named.iter().position(|name| *name == what).unwrap_or_else(|| panic!("{what}: {named:?}"));
        let found = &deviations[index];
        assert!(found.step >= 84, "nothing differs before they merge: {found}");
        let by_hand = [&two(), &stronger].map(|scene| surface_after(scene, found.step, what));
        assert_eq!(found.values, by_hand, "{found}");
        assert!(found.largest.0 >= (by_hand[0] - by_hand[1]).abs() && found.excess > 1.0, "{found:?}");
    }
    let output = fails(&dir, 1, &["diff", "a.rrd", "b.rrd"]);
    assert!(output.contains("surfaces: gap of a~b: 0.33") && output.contains(" at step "), "{output}");
    let output = succeeds(&dir, &["diff", "a.rrd", "fine.rrd", "--within", "1e-6"]);
    assert!(output.contains("surfaces: gap, overlap, neck, volume, area and topology are the same"), "{output}");
}

#[test]
fn check_compares_surfaces() {
    let dir = Dir::new();
    let path = dir.file("two.rrd");
    golden::bless(&two(), &path, "a test").expect("disk space");
    assert!(matches!(golden::check(&two(), &path, None), Ok(GoldenOutcome::Identical { .. })));
    let mut stronger = two();
    stronger.influence.alpha *= 1.01;
    let Ok(GoldenOutcome::Different(difference)) = golden::check(&stronger, &path, None) else { panic!("it differs") };
    let gap = difference.surfaces.iter().find(|deviation| deviation.what == "gap of a~b").expect("the gap");
    let by_hand = [&two(), &stronger].map(|scene| surface_after(scene, gap.step, "gap of a~b"));
    assert_eq!((gap.values, gap.step % golden::STATE_EVERY), (by_hand, 0), "{gap}");
    assert!(!difference.is_tolerable());
}
