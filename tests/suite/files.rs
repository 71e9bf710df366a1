//! Existing files are safe: which files the program replaces, which it does not replace, and that the content of a file
//! never controls the terminal that displays it.

use std::{
    fs,
    path::Path,
    process::{Command, Stdio},
    time::{Duration, Instant},
};

use meldscope::{
    Scene, World,
    observe::{Simulation, StepSummary},
    recording::Recorded,
    sdk::{self, AnyValues, StoreId, StoreKind, TextDocument, components::Text},
    stream::{
        Recorder, Settings,
        chunks::Chunks,
        contract,
        settings::{Around, Detail, Entities, Frames, Trigger},
        sinks::{Destinations, SinkError, Sinks},
    },
};
use proptest::prelude::*;

use crate::{
    bad_recordings::{SCENE, encoded},
    recording::{Dir, Recording},
};

/// Returns exit status, standard output, standard error.
fn meldscope(dir: &Dir, arguments: &[&str]) -> (i32, String, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_meldscope"));
    let output = command.args(arguments).current_dir(dir.path()).stdin(Stdio::null()).output().expect("it starts");
    let [out, err] = [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes).into_owned());
    assert!(!err.contains("panicked"), "{err}");
    (output.status.code().expect("a status"), out, err)
}

fn succeeds(dir: &Dir, arguments: &[&str]) -> (String, String) {
    let (status, out, err) = meldscope(dir, arguments);
    assert_eq!(status, 0, "{arguments:?}: {out}{err}");
    (out, err)
}

/// Rejected as bad input with a one-line message; every file is unchanged.
#[track_caller]
fn rejected(dir: &Dir, arguments: &[&str]) -> String {
    let before = content(dir);
    let (status, out, err) = meldscope(dir, arguments);
    assert_eq!((status, err.lines().count()), (2, 1), "{arguments:?}: {out}{err}");
    assert!(err.starts_with("error: "), "{err}");
    assert!(content(dir) == before, "{arguments:?} changed something");
    err
}

/// The content of every file, by name.
fn content(dir: &Dir) -> Vec<(String, Vec<u8>)> {
    let read = |name: String| {
        let path = dir.file(&name);
        let bytes =
            if fs::symlink_metadata(&path).is_ok_and(|there| there.is_file()) { fs::read(&path).ok() } else { None };
        (name, bytes.unwrap_or_default())
    };
    dir.names().into_iter().map(read).collect()
}

fn scene_dir() -> Dir {
    let dir = Dir::new();
    fs::write(dir.file("s.toml"), SCENE).expect("disk space");
    dir
}

// ---- overwriting ---------------------------------------------------------------------------------------------------

#[test]
fn a_scene_is_never_replaced_by_its_recording() {
    let dir = scene_dir();
    fs::create_dir(dir.file("sub")).expect("disk space");
    fs::hard_link(dir.file("s.toml"), dir.file("hard.rrd")).expect("a link");
    fs::write(dir.file("other.toml"), SCENE).expect("disk space");
    succeeds(&dir, &["run", "s.toml", "--quiet", "--thin", "--save", "a.rrd"]);
    let mut ways = vec!["s.toml", "./s.toml", "sub/../s.toml", "hard.rrd"];
    if cfg!(unix) {
        #[cfg(unix)]
        std::os::unix::fs::symlink("s.toml", dir.file("link.rrd")).expect("a link");
        ways.push("link.rrd");
    }
    let absolute = dir.file("s.toml").to_string_lossy().into_owned();
    ways.push(&absolute);
    for way in ways {
        let error = rejected(&dir, &["run", "s.toml", "--save", way]);
        assert!(error.contains("is the scene to be run") && error.contains("another name"), "{error}");
        for arguments in [
            &["run", "other.toml", "--save", way] as &[_],
            &["replay", "a.rrd", "--save", way],
            &["diff", "a.rrd", "a.rrd", "--save", way],
        ] {
            let error = rejected(&dir, arguments);
            assert!(error.contains("it is not a recording") && error.contains("another name"), "{error}");
        }
    }
    #[cfg(target_os = "linux")]
    for redirection in [">> s.toml", "1<> s.toml", ">> a.rrd"] {
        let before = content(&dir);
        let script = format!("'{}' run s.toml --stdout {redirection}", env!("CARGO_BIN_EXE_meldscope"));
        let output = Command::new("sh").args(["-c", &script]).current_dir(dir.path()).output().expect("a shell");
        let error = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{error}");
        assert!(error.contains("is not empty") || error.contains("is also standard output"), "{error}");
        let script = format!("'{}' run s.toml --save /dev/stdout {redirection}", env!("CARGO_BIN_EXE_meldscope"));
        if redirection != ">> a.rrd" {
            let output = Command::new("sh").args(["-c", &script]).current_dir(dir.path()).output().expect("a shell");
            assert_eq!(output.status.code(), Some(2));
        }
        assert!(content(&dir) == before, "{redirection}");
    }
    #[cfg(target_os = "linux")]
    for script in ["run s.toml --save b.rrd >> s.toml", "run s.toml --save b.rrd 1<> s.toml", "replay a.rrd 1<> a.rrd"]
    {
        let before = content(&dir);
        let script = format!("'{}' {script}", env!("CARGO_BIN_EXE_meldscope"));
        let output = Command::new("sh").args(["-c", &script]).current_dir(dir.path()).output().expect("a shell");
        assert_eq!(output.status.code(), Some(2), "{script}");
        assert!(content(&dir) == before, "{script}");
    }
}

#[test]
fn only_recordings_are_replaced() {
    let dir = scene_dir();
    for (name, text) in [("letter.txt", "Dear all,"), ("short.rrd", "RR"), ("code.rrd", "fn main() {}")] {
        fs::write(dir.file(name), text).expect("disk space");
        let error = rejected(&dir, &["run", "s.toml", "--save", name]);
        assert!(error.contains("it is not a recording") && error.contains("remove it"), "{error}");
    }
    // files as created by mktemp, and by an earlier run
    fs::write(dir.file("empty.rrd"), "").expect("disk space");
    for _ in 0..2 {
        let (_, err) = succeeds(&dir, &["run", "s.toml", "--quiet", "--save", "empty.rrd"]);
        assert_eq!(err, "");
        let (_, err) = succeeds(&dir, &["run", "s.toml"]);
        assert_eq!(err, "");
    }
    // a recording of another program
    let mut chunks = Chunks::new(StoreId::new(StoreKind::Recording, "flight_logs", "1"));
    chunks.log_static("/text", &TextDocument::new("precious"));
    fs::write(dir.file("foreign.rrd"), encoded(chunks)).expect("disk space");
    let error = rejected(&dir, &["run", "s.toml", "--save", "foreign.rrd"]);
    assert!(error.contains("flight_logs") && error.contains("not of this program"), "{error}");
}

#[test]
fn replacing_another_kind_of_file_is_announced_before_the_run() {
    let dir = scene_dir();
    succeeds(&dir, &["run", "s.toml", "--quiet", "--save", "x.rrd"]);
    let cases: [(&[&str], &str); 6] = [
        (&["run", "push", "--quiet", "--save", "x.rrd"], "a recording of the scene \"small\""),
        (&["run", "push", "--quiet", "--thin", "--save", "x.rrd"], "a recording of the scene \"push\""),
        (&["run", "push", "--quiet", "--keep", "3", "--save", "x.rrd"], "a thin recording of the scene \"push\""),
        (&["run", "s.toml", "--quiet", "--save", "x.rrd"], "a recording of the last frames of the scene \"push\""),
        (&["diff", "a.rrd", "a.rrd", "--save", "x.rrd"], "a recording of the scene \"small\""),
        (&["replay", "a.rrd", "--save", "x.rrd"], "a comparison of two recordings"),
    ];
    succeeds(&dir, &["run", "s.toml", "--quiet", "--save", "a.rrd"]);
    for (arguments, what) in cases {
        let (_, err) = succeeds(&dir, arguments);
        assert_eq!(err, format!("note: {} is replaced, {what}\n", "x.rrd"), "{arguments:?}");
        if arguments[0] != "diff" {
            assert_eq!(succeeds(&dir, arguments).1, "", "{arguments:?} a second time");
        }
    }
}

#[test]
fn only_bless_replaces_golden_recordings() {
    let dir = scene_dir();
    succeeds(&dir, &["check", "s.toml", "--bless", "a test"]);
    fs::write(dir.file("small.toml"), SCENE).expect("disk space");
    succeeds(&dir, &["run", "push", "--quiet", "--save", "a.rrd"]);
    fs::copy(dir.file("s.rrd"), dir.file("copy.rrd")).expect("disk space");
    for golden in ["s.rrd", "copy.rrd", "./s.rrd"] {
        for arguments in [
            &["run", "s.toml", "--save", golden] as &[_],
            &["run", "s.toml", "--thin", "--save", golden],
            &["run", "push", "--save", golden],
            &["replay", "a.rrd", "--save", golden],
            &["diff", "a.rrd", "a.rrd", "--save", golden],
        ] {
            let error = rejected(&dir, arguments);
            assert!(error.contains("golden recording") && error.contains("check --bless"), "{error}");
        }
    }
    // the default destination for a scene that is named like its file
    succeeds(&dir, &["check", "small.toml", "--bless", "a test"]);
    let error = rejected(&dir, &["run", "small.toml"]);
    assert!(error.contains("small.rrd") && error.contains("golden recording"), "{error}");

    // a file that `check` treats as golden, although it cannot be read
    fs::write(dir.file("s.rrd"), "RRF2 and nothing else").expect("disk space");
    let error = rejected(&dir, &["run", "s.toml", "--save", "s.rrd"]);
    assert!(error.contains("golden recording"), "{error}");
    succeeds(&dir, &["check", "s.toml", "--bless", "it was damaged"]);
    succeeds(&dir, &["check", "s.toml"]);

    // nor does one that has lost its end pass, which may hold events and states
    let whole = fs::read(dir.file("s.rrd")).expect("a file");
    for share in [0.5, 0.9, 0.999] {
        fs::write(dir.file("s.rrd"), &whole[..(share * whole.len() as f64) as usize]).expect("disk space");
        let (status, out, err) = meldscope(&dir, &["check", "s.toml"]);
        assert!(status != 0 && (out + &err).contains("cut short"), "{share}");
    }
    succeeds(&dir, &["check", "s.toml", "--bless", "it was cut short"]);
    succeeds(&dir, &["check", "s.toml"]);

    // the comparison that `check` writes does not replace one either
    fs::write(dir.file("s.check.toml"), SCENE).expect("disk space");
    succeeds(&dir, &["check", "s.check.toml", "--bless", "a trap"]);
    let golden = fs::read(dir.file("s.check.rrd")).expect("a file");
    fs::write(dir.file("s.toml"), SCENE.replace("[-2, 0, 0]", "[-2.5, 0, 0]")).expect("disk space");
    let (status, out, err) = meldscope(&dir, &["check", "s.toml"]);
    assert!(status == 1 && out.contains("could not be written") && out.contains("golden"), "{out}{err}");
    assert!(fs::read(dir.file("s.check.rrd")).expect("a file") == golden);
}

/// A mesh that this program wrote, and that a scene reads.
#[test]
fn an_export_does_not_replace_a_mesh_of_its_scene() {
    let dir = Dir::new();
    fs::write(dir.file("small.toml"), SCENE).expect("disk space");
    let export = ["export", "small.toml", "--mesh", "m", "--format", "obj", "--to", "1"];
    succeeds(&dir, &export);
    let before = fs::read(dir.file("m/small-000000.obj")).expect("a file");
    let with_mesh = SCENE.replacen("{ sphere = { stacks = 3, slices = 4 } }", "{ mesh = \"m/small-000000.obj\" }", 1);
    fs::write(dir.file("small.toml"), with_mesh).expect("disk space");
    let error = rejected(&dir, &export);
    assert!(error.contains("small-000000.obj is a mesh of the scene and is not replaced"), "{error}");
    assert!(fs::read(dir.file("m/small-000000.obj")).expect("a file") == before);
    succeeds(&dir, &[&export[..], &["--from", "1"]].concat());
}

/// Runs that fail are all named, and no recording is said to be replaced that is not.
#[test]
fn each_scene_that_is_not_blessed_is_named() {
    let dir = Dir::new();
    fs::write(dir.file("good.toml"), SCENE).expect("disk space");
    let stiff = "duration = 20.0\ndt = 0.1\nintegrator = 'verlet'\nmaterial = { omega = 50.0 }";
    let diverges = SCENE.replace("duration = 0.5", stiff);
    for name in ["bad", "worse"] {
        fs::write(dir.file(&format!("{name}.toml")), &diverges).expect("disk space");
    }
    succeeds(&dir, &["run", "good.toml", "--thin", "--save", "bad.rrd"]);
    let before = fs::read(dir.file("bad.rrd")).expect("a file");
    let (status, out, err) = meldscope(&dir, &["check", ".", "--bless", "a test"]);
    assert!(status == 1 && err.contains("2 of 3 scenes were not blessed: bad, worse"), "{out}{err}");
    assert!(err.contains("bad: ") && err.contains("worse: ") && !err.contains("is replaced"), "{out}{err}");
    assert!(out.contains("good.rrd") && fs::read(dir.file("bad.rrd")).expect("a file") == before);
}

/// Scenes with the same name in two folders: each one that differs gets its own comparison.
#[test]
fn comparisons_do_not_replace_each_other() {
    let dir = Dir::new();
    for folder in ["one", "two"] {
        fs::create_dir(dir.file(folder)).expect("disk space");
        fs::write(dir.file(&format!("{folder}/s.toml")), SCENE).expect("disk space");
    }
    succeeds(&dir, &["check", "one", "two", "--bless", "a test"]);
    for folder in ["one", "two"] {
        let other = SCENE.replace("[-2, 0, 0]", "[-2.5, 0, 0]");
        fs::write(dir.file(&format!("{folder}/s.toml")), other).expect("disk space");
    }
    let (status, out, err) = meldscope(&dir, &["check", "one", "two"]);
    assert!(status == 1 && out.contains("rerun s.check.rrd") && out.contains("rerun s-2.check.rrd"), "{out}{err}");
    assert_eq!(dir.names(), ["one", "s-2.check.rrd", "s.check.rrd", "two"]);
}

#[test]
fn benchmarks_replace_only_their_own_files() {
    let dir = scene_dir();
    let scale = ["bench", "scale", "2", "--svg"];
    let error = rejected(&dir, &[&scale[..], &["s.toml"]].concat());
    assert!(error.contains("was not written by this benchmark and is not replaced"), "{error}");
    for _ in 0..2 {
        succeeds(&dir, &[&scale[..], &["s.svg"]].concat());
    }
    fs::write(dir.file("data.csv"), "time,price\n1,2\n").expect("disk space");
    for arguments in [
        &["bench", "error", "s.toml", "--csv", "s.toml"] as &[_],
        &["bench", "error", "s.toml", "--svg", "s.toml"],
        &["bench", "error", "s.toml", "--csv", "data.csv"],
        &["bench", "scale", "--csv", "data.csv"],
        &["bench", "scale", "--svg", "s.toml"],
        &["bench", "record", "s.toml", "--csv", "s.toml"],
        &["bench", "stability", "--csv", "s.toml"],
    ] {
        rejected(&dir, arguments);
    }
}

// ---- partial files
// -----------------------------------------------------------------------------------------------------

#[cfg(unix)]
#[test]
fn links_at_the_partial_path_are_not_followed() {
    let dir = scene_dir();
    let link = |to: &str, name: &str| {
        fs::remove_file(dir.file(name)).ok();
        std::os::unix::fs::symlink(to, dir.file(name)).expect("a link");
    };
    fs::write(dir.file("mine.txt"), "precious").expect("disk space");
    succeeds(&dir, &["run", "s.toml", "--quiet", "--save", "mine.rrd"]);
    for to in ["mine.txt", "mine.rrd", "not-there", "/etc/passwd"] {
        link(to, "x.rrd.partial");
        let error = rejected(&dir, &["run", "s.toml", "--save", "x.rrd"]);
        assert!(
            error.contains("x.rrd.partial") && error.contains("symbolic link") && error.contains("remove it"),
            "{error}"
        );
        assert!(!dir.file("not-there").exists());
    }
    fs::remove_file(dir.file("x.rrd.partial")).expect("it exists");
    // nor any other existing file
    fs::create_dir(dir.file("x.rrd.partial")).expect("disk space");
    rejected(&dir, &["run", "s.toml", "--save", "x.rrd"]);
    fs::remove_dir(dir.file("x.rrd.partial")).expect("it exists");
    assert!(Command::new("mkfifo").arg(dir.file("x.rrd.partial")).status().expect("mkfifo").success());
    let error = rejected(&dir, &["run", "s.toml", "--save", "x.rrd"]);
    assert!(error.contains("is not a file"), "{error}");
    fs::remove_file(dir.file("x.rrd.partial")).expect("it exists");
    fs::write(dir.file("x.rrd.partial"), "a letter").expect("disk space");
    let error = rejected(&dir, &["run", "s.toml", "--save", "x.rrd"]);
    assert!(error.contains("is not a recording"), "{error}");
    fs::remove_file(dir.file("x.rrd.partial")).expect("it exists");

    // the file of a killed run is replaced; its hard links keep their content
    let bytes = fs::read(dir.file("mine.rrd")).expect("a file");
    fs::hard_link(dir.file("mine.rrd"), dir.file("x.rrd.partial")).expect("a link");
    let (_, err) = succeeds(&dir, &["run", "s.toml", "--save", "x.rrd"]);
    assert!(err.contains("left unfinished"), "{err}");
    assert!(fs::read(dir.file("mine.rrd")).expect("a file") == bytes);
    assert!(!dir.file("x.rrd.partial").exists());

    // the destination itself: a link to a recording is kept, a dangling link is rejected
    link("mine.rrd", "l.rrd");
    succeeds(&dir, &["run", "s.toml", "--steps", "3", "--save", "l.rrd"]);
    assert!(fs::symlink_metadata(dir.file("l.rrd")).expect("a link").is_symlink());
    assert_eq!(Recording::open(&dir.file("mine.rrd")).steps(), 3.0);
    link("nowhere.rrd", "l.rrd");
    let error = rejected(&dir, &["run", "s.toml", "--save", "l.rrd"]);
    assert!(error.contains("symbolic link to nothing"), "{error}");
}

fn to_file(path: &Path) -> Destinations {
    Destinations { save: Some(path.to_owned()), ..Destinations::default() }
}

#[test]
fn the_second_of_two_runs_that_save_to_one_file_is_rejected() {
    let dir = scene_dir();
    let first = Sinks::open(&to_file(&dir.file("x.rrd"))).expect("a file");
    let (status, _, err) = meldscope(&dir, &["run", "s.toml", "--save", "x.rrd"]);
    assert!(status == 1 && err.contains("another run is writing"), "{err}");
    // nor through the path to which the first run is writing
    let error = rejected(&dir, &["run", "s.toml", "--save", "x.rrd.partial"]);
    assert!(error.contains(".partial"), "{error}");
    drop(first);
    // the remains of a killed run, claimed twice
    fs::write(dir.file("x.rrd.partial"), "RRF2").expect("disk space");
    let first = Sinks::open(&to_file(&dir.file("x.rrd"))).expect("a file");
    assert!(matches!(Sinks::open(&to_file(&dir.file("x.rrd"))), Err(SinkError::Busy { .. })));
    drop(first);
}

/// A run whose file is removed or replaced reports this and loses no data.
#[cfg(unix)]
#[test]
fn files_created_during_a_run_are_not_replaced() {
    let dir = scene_dir();
    let (path, partial) = (dir.file("x.rrd"), dir.file("x.rrd.partial"));
    let sinks = Sinks::open(&to_file(&path)).expect("a file");
    fs::write(&path, "a letter").expect("disk space");
    let error = sinks.finish().err().expect("an error").to_string();
    assert!(error.contains("x.rrd.partial") && error.contains("something else has been put there"), "{error}");
    assert_eq!(fs::read(&path).expect("a file"), b"a letter");
    assert!(fs::read(&partial).expect("a file").starts_with(b"RRF2"));
    fs::remove_file(&path).and_then(|()| fs::remove_file(&partial)).expect("they exist");

    let sinks = Sinks::open(&to_file(&path)).expect("a file");
    fs::remove_file(&partial).and_then(|()| fs::write(&partial, "another's")).expect("disk space");
    let error = sinks.finish().err().expect("an error").to_string();
    assert!(error.contains("another program"), "{error}");
    assert_eq!(fs::read(&partial).expect("a file"), b"another's");
    assert!(!path.exists());
}

/// A killed run's recording is not overwritten while it is being read.
#[test]
fn a_replay_is_not_written_over_its_input() {
    let dir = scene_dir();
    succeeds(&dir, &["run", "s.toml", "--quiet", "--save", "x.rrd"]);
    fs::rename(dir.file("x.rrd"), dir.file("x.rrd.partial")).expect("disk space");
    let error = rejected(&dir, &["replay", "x.rrd.partial", "--save", "x.rrd"]);
    assert!(error.contains("first written to") && error.contains("another name"), "{error}");
    rejected(&dir, &["diff", "x.rrd.partial", "x.rrd.partial", "--save", "x.rrd"]);
    succeeds(&dir, &["replay", "x.rrd.partial", "--save", "y.rrd"]);
}

#[cfg(target_os = "linux")]
#[test]
fn devices_and_pipes_are_written_directly() {
    let dir = scene_dir();
    succeeds(&dir, &["run", "s.toml", "--save", "/dev/null"]);
    let (status, _, err) = meldscope(&dir, &["run", "s.toml", "--save", "/dev/full"]);
    assert!(status == 1 && err.contains("/dev/full"), "{err}");
    let fifo = dir.file("pipe");
    assert!(Command::new("mkfifo").arg(&fifo).status().expect("mkfifo").success());
    let reader = std::thread::spawn(move || fs::read(fifo).expect("a recording"));
    succeeds(&dir, &["run", "s.toml", "--save", "pipe"]);
    assert_eq!(Recording::read(&reader.join().expect("no panic")[..]).steps(), 30.0);
    assert_eq!(dir.names(), ["pipe", "s.toml"]);
}

// ---- settings ------------------------------------------------------------------------------------------------------

fn count() -> impl Strategy<Value = u64> {
    let edges = [1, 2, 3, 7, (1 << 63) - 1, 1 << 63, (1 << 63) + 1, u64::MAX - 1, u64::MAX];
    prop_oneof![3 => prop::sample::select(edges.to_vec()), 1 => 1u64..100, 1 => 1u64..]
}

fn triggers() -> Vec<Trigger> {
    ["merge", "split", "core"]
        .map(|word| Trigger::Event(word.to_owned()))
        .into_iter()
        .chain([Trigger::Diverge])
        .collect()
}

/// Settings, Δt and tolerance.
fn settings() -> impl Strategy<Value = (Settings, (f64, f64))> {
    let detail = prop_oneof![
        Just(Detail::Surface),
        Just(Detail::Forces),
        (prop_oneof![Just(0), count()], count()).prop_map(|(from, to)| Detail::Stages { from, to }),
    ];
    let frames = prop_oneof![
        2 => Just(Frames::All),
        1 => Just(Frames::Thin),
        2 => (count(), prop::sample::subsequence(triggers(), 0..=4), prop_oneof![Just(0), count()])
            .prop_map(|(most, on, after)| Frames::Last { most, on, after }),
    ];
    let numbers = (Scene::POSITIVE, Scene::POSITIVE, prop::option::of(count()), count());
    let kind =
        prop::option::of(prop::sample::select(vec!["merge".to_owned(), "core".to_owned(), "a \"kind\"".to_owned()]));
    let pair = || prop::sample::select(vec!["a~b".to_owned(), "a~c-1".to_owned(), "b_2~é".to_owned()]);
    let around = (kind, prop::option::of(pair()), count());
    let around = prop::option::of(around.prop_map(|(kind, pair, number)| Around { kind, pair, number }));
    let entities = prop::sample::select(Entities::ALL.to_vec());
    let shown = (0usize..=1000, prop::collection::vec(pair(), 0..3), around);
    (numbers, detail, frames, entities, shown).prop_map(
        move |((dt, tolerance, steps, every), detail, frames, entities, (pairs, only, around))| {
            (Settings { steps, every, detail, frames, entities, pairs, only, around }, (dt, tolerance))
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    /// Settings survive a round trip through their text form.
    #[test]
    fn settings_survive_a_round_trip((settings, _) in settings()) {
        let text = settings.to_toml();
        prop_assert!(text.parse::<toml::Table>().is_ok(), "{}", text);
        prop_assert_eq!(Settings::from_toml(&text, 2), Ok(settings));
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, failure_persistence: None, ..ProptestConfig::default() })]

    /// A recording with any settings can be read and verified.
    #[test]
    fn every_setting_replays((settings, (dt, tolerance)) in settings(), taken in 0u64..12) {
        let dir = Dir::new();
        let mut scene = Scene::parse(SCENE, "small").expect("a scene");
        scene.tolerance = tolerance.clamp(1e-9, 1e-3);
        scene.dt = dt.clamp(1e-4, 0.1);
        let mut world = World::new(scene.clone()).expect("enough memory");
        let mut sinks = Sinks::open(&to_file(&dir.file("x.rrd"))).expect("a file");
        let steps = settings.steps.unwrap_or(taken).min(taken);
        let mut recorder = Recorder::new(&world, settings.clone()).expect("its text describes it");
        for _ in 0..steps {
            let mut summary = StepSummary::default();
            Simulation::step(&mut world, &mut summary);
            recorder.observe(&world, &summary).expect("a valid step");
        }
        recorder.finish();
        recorder.take().into_iter().for_each(|message| sinks.send(message).expect("disk space"));
        sinks.finish().expect("disk space");
        let recorded = Recorded::open(&dir.file("x.rrd")).expect("a recording");
        prop_assert_eq!(&recorded.settings, &settings);
        prop_assert_eq!((recorded.schema.dt, recorded.schema.tolerance), (scene.dt, scene.tolerance));
        prop_assert_eq!(recorded.last(), steps);
        let verdict = meldscope::recording::replay::verify(&recorded, |_| true).expect("a recording");
        prop_assert_eq!(verdict, meldscope::recording::replay::Verdict::Identical);
    }
}

#[test]
fn every_option_that_a_run_accepts_replays() {
    let dir = scene_dir();
    for options in [
        &["--detail", "stages"] as &[&str],
        &["--detail", "stages=8..18446744073709551615"],
        &["--detail", "stages=8..9"],
        &["--every", "9223372036854775808"],
        &["--every", "18446744073709551615"],
        &["--keep", "9223372036854775808"],
        &["--keep", "18446744073709551615", "--on", "merge,core"],
        &["--detail", "surface", "--plots", "0", "--every", "7"],
        &["--entities", "batch", "--integrator", "rk4"],
        &[
            "--set",
            "dt=1e-3",
            "--set",
            "tolerance=1e-12",
            "--set",
            "influence.alpha=7.5",
            "--set",
            "material.response=world",
        ],
        &["--thin", "--steps", "17"],
    ] {
        succeeds(&dir, &[&["run", "s.toml", "--quiet", "--save", "x.rrd"], options].concat());
        let (out, _) = succeeds(&dir, &["replay", "x.rrd"]);
        assert!(out.contains("identical"), "{options:?}: {out}");
        succeeds(&dir, &["replay", "x.rrd", "--from", "8", "--to", "9", "--detail", "stages", "--save", "slice.rrd"]);
        let (out, _) = succeeds(&dir, &["replay", "slice.rrd"]);
        assert!(out.contains("identical"), "{options:?}: {out}");
    }
}

#[cfg(unix)]
#[test]
fn a_run_with_too_many_steps_is_replayed_as_far_as_it_got() {
    let dir = scene_dir();
    for steps in ["9223372036854775808", "18446744073709551615", "0"] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_meldscope"));
        command.args(["run", "s.toml", "--quiet", "--thin", "--steps", steps, "--save", "x.rrd"]);
        let mut child = command.current_dir(dir.path()).spawn().expect("it starts");
        let start = Instant::now();
        let partial = dir.file("x.rrd.partial");
        while fs::metadata(&partial).map_or(0, |there| there.len()) < 20_000
            && start.elapsed() < Duration::from_secs(60)
        {
            std::thread::sleep(Duration::from_millis(10));
        }
        let id = child.id().to_string();
        assert!(Command::new("kill").args(["-INT", &id]).status().expect("kill").success());
        let is_cut_short = steps != "0";
        assert_eq!(child.wait().expect("a child").code(), Some(if is_cut_short { 130 } else { 0 }));
        let (out, _) = succeeds(&dir, &["replay", "x.rrd"]);
        assert!(out.contains("identical"), "{out}");
        fs::remove_file(dir.file("x.rrd")).expect("it exists");
    }
}

// ---- terminals -----------------------------------------------------------------------------------------------------

/// Characters that a terminal acts on, except line ends.
fn acts_on_terminal(c: char) -> bool {
    c != '\n' && (c.is_control() || "\u{202e}\u{2066}\u{2028}".contains(c))
}

const EVIL: &str = "\u{1b}[2J\u{1b}]0;owned\u{7}\u{9b}31m\u{202e}\u{2066}\u{2028}\r\nx.rrd: identical";

#[test]
fn no_control_character_of_a_recording_reaches_a_terminal() {
    let dir = scene_dir();
    let scene = Scene::parse(SCENE, "small").expect("a scene");
    let settings = Settings { frames: Frames::Thin, ..Settings::of(&scene) };
    let mut world = World::new(scene.clone()).expect("enough memory");
    let mut recorder = Recorder::new(&world, settings).expect("its text describes it");
    for property in [contract::OVERRIDES, contract::MACHINE, contract::BLESSED, contract::INTEGRATOR] {
        recorder.log_property(property, EVIL);
    }
    for _ in 0..30 {
        let mut summary = StepSummary::default();
        Simulation::step(&mut world, &mut summary);
        recorder.observe(&world, &summary).expect("a valid step");
    }
    recorder.finish();
    let write = |recorder: &mut Recorder, name: &str| {
        let mut sinks = Sinks::open(&to_file(&dir.file(name))).expect("a file");
        recorder.take().into_iter().for_each(|message| sinks.send(message).expect("disk space"));
        sinks.finish().expect("disk space");
    };
    write(&mut recorder, "x.rrd");
    succeeds(&dir, &["run", "s.toml", "--quiet", "--thin", "--save", "good.rrd"]);
    let plain = |arguments: &[&str]| {
        let (_, out, err) = meldscope(&dir, arguments);
        assert!(!out.contains(acts_on_terminal) && !err.contains(acts_on_terminal), "{arguments:?}: {out:?} {err:?}");
        // nor can it add its own line
        assert!(!out.lines().skip(1).any(|line| line.starts_with("x.rrd: identical")), "{out}");
        out + &err
    };
    let printed = plain(&["replay", "x.rrd"]);
    assert!(printed.contains("identical") && printed.contains(r"\u{1b}[2J"), "{printed}");
    plain(&["diff", "x.rrd", "good.rrd"]);
    plain(&["run", "x.rrd"]);
    fs::copy(dir.file("x.rrd"), dir.file("s.rrd")).expect("disk space");
    plain(&["check", "s.toml"]);

    // texts that cannot be used: they are quoted in the error message
    for (settings, version) in [
        (Settings::of(&scene).to_toml().replace("exponential", "\\u001b[2Jevil\\u202e\\n"), "1"),
        (Settings::of(&scene).to_toml(), EVIL),
    ] {
        let text = |value: &str| [Text::from(value)];
        for format in [1.0, 99.0] {
            let properties = AnyValues::default()
                .with_component::<Text>("scene", text(SCENE))
                .with_component::<Text>("settings", text(&settings))
                .with_component::<Text>("version", text(version))
                .with_component::<sdk::components::Scalar>("format", [format]);
            let mut chunks = Chunks::new(StoreId::new(StoreKind::Recording, "meldscope_small", "small-0"));
            chunks.log_static("/__properties/meldscope", &properties);
            fs::write(dir.file("y.rrd"), encoded(chunks)).expect("disk space");
            plain(&["replay", "y.rrd"]);
        }
    }
    // another program's name
    let mut chunks = Chunks::new(StoreId::new(StoreKind::Recording, EVIL, "1"));
    chunks.log_static("/text", &TextDocument::new("precious"));
    fs::write(dir.file("z.rrd"), encoded(chunks)).expect("disk space");
    plain(&["run", "s.toml", "--save", "z.rrd"]);
    plain(&["replay", "z.rrd"]);
}

#[cfg(unix)]
#[test]
fn no_control_character_of_a_name_reaches_a_terminal() {
    let dir = scene_dir();
    let name = "\u{1b}]0;owned\u{7}\u{1b}[2J\u{202e}\nfake: identical";
    let [toml, rrd] = ["toml", "rrd"].map(|extension| format!("{name}.{extension}"));
    fs::write(dir.file(&toml), SCENE.replace("name = \"small\"\n", "")).expect("disk space");
    fs::write(dir.file("bidi.toml"), SCENE.replace("small", "a\u{202e}b\u{2066}")).expect("disk space");
    let plain = |arguments: &[&str]| {
        let (status, out, err) = meldscope(&dir, arguments);
        assert!(!out.contains(acts_on_terminal) && !err.contains(acts_on_terminal), "{arguments:?}: {out:?} {err:?}");
        assert!(!out.lines().any(|line| line.starts_with("fake")), "{out}");
        assert!(!err.lines().any(|line| line.starts_with("fake")), "{err}");
        status
    };
    assert_eq!(plain(&["run", &toml]), 0);
    assert_eq!(plain(&["run", &toml, "--thin", "--save", &rrd]), 0);
    assert_eq!(plain(&["run", "bidi.toml", "--thin", "--save", "b.rrd"]), 0);
    assert_eq!(plain(&["replay", &rrd]), 0);
    assert_eq!(plain(&["replay", &rrd, "--save", &rrd]), 2);
    assert_eq!(plain(&["diff", &rrd, "b.rrd"]), 0);
    assert_eq!(plain(&["check", &toml]), 0);
    assert_eq!(plain(&["check", &toml, "--bless", "a\u{1b}[2Jb"]), 0);
    assert_eq!(plain(&["check", "."]), 1);
    assert_eq!(plain(&["bench", "record", &toml, "--csv", &toml]), 2);
    assert_eq!(plain(&["run", &format!("{name}.missing")]), 2);
    assert_eq!(plain(&["replay", &format!("{name}.missing")]), 2);
    assert_eq!(plain(&["run", "s.toml", "--save", &toml]), 2);
    for bad in [name, "--\u{9b}31m\u{202e}x", "\u{85}\u{2066}\n"] {
        assert_eq!(plain(&[bad]), 2);
        assert_eq!(plain(&["run", "s.toml", bad]), 2);
        assert_eq!(plain(&["run", "s.toml", "--integrator", bad]), 2);
        assert_eq!(plain(&["run", "s.toml", &format!("--steps={bad}")]), 2);
    }
    fs::write(dir.file(&toml), "duration = \"\u{1b}[2J\u{9b}\u{202e}\"").expect("disk space");
    assert_eq!(plain(&["run", &toml]), 2);
    assert_eq!(plain(&["check", &toml]), 2);
}

// ---- standard output -----------------------------------------------------------------------------------------------

#[cfg(target_os = "linux")]
#[test]
fn results_that_cannot_be_printed_are_an_error() {
    let dir = scene_dir();
    succeeds(&dir, &["run", "s.toml", "--quiet", "--save", "a.rrd"]);
    succeeds(&dir, &["check", "s.toml", "--bless", "a test"]);
    for arguments in [
        &["run", "s.toml", "--save", "x.rrd"] as &[&str],
        &["replay", "a.rrd"],
        &["diff", "a.rrd", "a.rrd"],
        &["check", "s.toml"],
        &["check", "s.toml", "--bless", "again"],
        &["scenes"],
        &["bench", "stability", "3"],
        &["--help"],
        &["run", "--help"],
        &["--version"],
    ] {
        let run = |out: Stdio| {
            let mut command = Command::new(env!("CARGO_BIN_EXE_meldscope"));
            command.args(arguments).current_dir(dir.path()).stdout(out).stderr(Stdio::piped());
            let output = command.spawn().and_then(|child| child.wait_with_output()).expect("it starts");
            (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
        };
        let full = fs::OpenOptions::new().write(true).open("/dev/full").expect("a device");
        let (status, error) = run(full.into());
        assert_eq!(status, Some(1), "{arguments:?}: {error}");
        assert!(error.contains("standard output") && error.contains("No space left"), "{arguments:?}: {error}");
        // without a reader, nothing is reported
        let (reader, writer) = std::io::pipe().expect("a pipe");
        drop(reader);
        assert_eq!(run(writer.into()), (Some(0), String::new()), "{arguments:?}");
    }
    // other errors are still reported, with their exit status
    let full = fs::OpenOptions::new().write(true).open("/dev/full").expect("a device");
    fs::write(dir.file("s.toml"), SCENE.replace("[-2, 0, 0]", "[-2.5, 0, 0]")).expect("disk space");
    let mut command = Command::new(env!("CARGO_BIN_EXE_meldscope"));
    command.args(["check", "s.toml"]).current_dir(dir.path()).stdout(full).stderr(Stdio::piped());
    let output = command.spawn().and_then(|child| child.wait_with_output()).expect("it starts");
    let error = String::from_utf8_lossy(&output.stderr);
    assert!(
        output.status.code() == Some(1) && error.contains("differ") && error.contains("standard output"),
        "{error}"
    );
}
