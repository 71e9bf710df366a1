//! The program as users run it: its output, its files, and its exit status.

use std::{
    ffi::OsStr,
    fs,
    io::{BufRead as _, BufReader, Read as _, Write as _},
    net::{Ipv4Addr, TcpListener, TcpStream},
    path::Path,
    process::{Child, Command, Output, Stdio},
    sync::mpsc,
    time::{Duration, Instant},
};

use meldscope::{
    Scene, World, recording::read::Reader, scene::builtin, sdk::EntityPath, sim::Event, stream::Settings, text,
};
use proptest::prelude::*;

use crate::{
    bad_recordings::{Message, fields, file},
    recording::{Dir, Recording, content},
    tolerance,
    viewer::Viewer,
};

/// A program that runs longer than this is considered hung.
const PATIENCE: Duration = Duration::from_secs(60);

// ---- running -------------------------------------------------------------------------------------------------------

/// The result of running the program.
#[derive(Debug)]
struct Ran {
    status: i32,
    out: String,
    err: String,
    bytes: Vec<u8>,
}

impl Ran {
    fn new(output: Output) -> Ran {
        let [out, err] = [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes).into_owned());
        assert!(!err.contains("panicked"), "{err}");
        let status = output.status.code().unwrap_or_else(|| panic!("{}: {err}", output.status));
        Ran { status, out, err, bytes: output.stdout }
    }

    /// Asserts success, with only results in the output.
    fn succeeded(self) -> Ran {
        self.warned_of(&[])
    }

    /// Asserts success, with these warnings beside the results.
    fn warned_of(self, warnings: &[String]) -> Ran {
        let warnings: String = warnings.iter().map(|warning| format!("warning: {warning}\n")).collect();
        assert_eq!((self.status, self.err.as_str()), (0, warnings.as_str()), "{}", self.out);
        self
    }

    /// Asserts this exit status, with a one-line error and no results; returns the error.
    fn failed(self, status: i32) -> String {
        assert_eq!((self.status, self.out.as_str()), (status, ""), "{}", self.err);
        let lines: Vec<&str> = self.err.lines().filter(|line| !line.is_empty()).collect();
        assert!(lines.first().is_some_and(|line| line.starts_with("error: ")), "{}", self.err);
        assert!(!self.err.contains(['\u{1b}', '\r']), "{:?}", self.err);
        self.err
    }
}

fn meldscope(dir: &Dir, arguments: impl IntoIterator<Item = impl AsRef<OsStr>>) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_meldscope"));
    command.args(arguments).current_dir(dir.path());
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

fn run(dir: &Dir, arguments: &[&str]) -> Ran {
    Running::start(dir, arguments).end()
}

/// A running program, killed when its test ends.
struct Running(Option<Child>);

impl Running {
    fn start(dir: &Dir, arguments: &[&str]) -> Running {
        Running(Some(meldscope(dir, arguments).spawn().expect("the program starts")))
    }

    fn child(&mut self) -> &mut Child {
        self.0.as_mut().expect("it has not ended")
    }

    /// Waits for it to end.
    fn end(mut self) -> Ran {
        let child = self.0.take().expect("it has not ended");
        let id = child.id();
        let (sender, receiver) = mpsc::channel();
        std::thread::spawn(move || sender.send(child.wait_with_output()));
        let output = receiver.recv_timeout(PATIENCE).unwrap_or_else(|_| {
            signal(id, "KILL");
            panic!("the program does not end");
        });
        Ran::new(output.expect("its output"))
    }

    fn signal(&mut self, name: &str) {
        signal(self.child().id(), name);
    }

    /// Sends a signal and waits for the end. Also returns how long this took [s]: in processor time where the system
    /// reports it per process, because other work may delay the process.
    #[cfg(unix)]
    fn ends_after(mut self, name: &str) -> (Ran, f64) {
        let id = self.child().id();
        let spent = move || {
            let text = fs::read_to_string(format!("/proc/{id}/stat")).ok()?;
            let ticks = text.rsplit_once(')')?.1.split_whitespace().skip(11).take(2);
            Some(ticks.filter_map(|ticks| ticks.parse::<f64>().ok()).sum::<f64>() / 100.0)
        };
        let (start, before) = (Instant::now(), spent());
        self.signal(name);
        let watch = std::thread::spawn(move || {
            let mut last = before?;
            while let Some(now) = spent().filter(|&now| now >= last) {
                last = now;
                std::thread::sleep(Duration::from_millis(2));
            }
            Some(last - before?)
        });
        let ran = self.end();
        let wall = start.elapsed().as_secs_f64();
        (ran, watch.join().expect("a number").unwrap_or(wall))
    }

    /// Waits until a condition holds.
    fn eventually(&mut self, mut is_so: impl FnMut() -> bool) {
        let started = Instant::now();
        while !is_so() {
            if let Some(status) = self.child().try_wait().expect("a child") {
                panic!("it ended before: {status}");
            }
            assert!(started.elapsed() < PATIENCE, "the condition never holds");
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// Waits for a line on standard error that starts with `beginning`; returns the rest of the line.
    #[cfg(unix)]
    fn wait_for_line(&mut self, beginning: &str) -> String {
        wait_for_line(&self.lines(), beginning)
    }

    /// Its standard error.
    #[cfg(unix)]
    fn lines(&mut self) -> mpsc::Receiver<String> {
        let stderr = BufReader::new(self.child().stderr.take().expect("a pipe"));
        let (sender, receiver) = mpsc::channel();
        // keeps reading after the receiver is dropped, because further output must go somewhere
        std::thread::spawn(move || stderr.lines().map_while(Result::ok).for_each(|line| drop(sender.send(line))));
        receiver
    }
}

/// Waits for a line that starts with `beginning`; returns the rest of the line.
#[cfg(unix)]
fn wait_for_line(lines: &mpsc::Receiver<String>, beginning: &str) -> String {
    loop {
        let line = lines.recv_timeout(PATIENCE).unwrap_or_else(|_| panic!("no line starts with \"{beginning}\""));
        if let Some(rest) = line.strip_prefix(beginning) {
            return rest.to_owned();
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        if let Some(child) = &mut self.0 {
            child.kill().and_then(|()| child.wait()).ok();
        }
    }
}

/// Sends a signal to a program, which may just have ended.
fn signal(id: u32, name: &str) {
    let mut kill = Command::new("kill");
    kill.args([&format!("-{name}"), &id.to_string()]).stderr(Stdio::null()).status().expect("kill runs");
}

fn free_port() -> u16 {
    TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).and_then(|listener| listener.local_addr()).expect("a free port").port()
}

fn unused_viewer_url() -> String {
    format!("rerun+http://127.0.0.1:{}/proxy", free_port())
}

fn size(path: &Path) -> u64 {
    fs::metadata(path).map_or(0, |metadata| metadata.len())
}

/// A small scene with two events.
const SCENE: &str = r#"
name = "small"
duration = 2.0

[influence]
alpha = 50
merge_at = 1.05
split_at = 1.1

[[body]]
name = "a"
radius = 1.0
shape = { sphere = { stacks = 6, slices = 8 } }
motion = { fixed = [0, 0, 0] }

[[body]]
name = "b"
radius = 0.5
shape = { sphere = { stacks = 4, slices = 6 } }
motion = { line = { from = [2.0, 1.0, 0], velocity = [-2, 0, 0] } }

[[push]]
body = "a"
direction = [1, 0, 0]
strength = 10
start = 0.1
duration = 0.2
"#;

fn scene_dir() -> Dir {
    let dir = Dir::new();
    fs::write(dir.file("small.toml"), SCENE).expect("disk space");
    dir
}

fn settings(recording: &Recording) -> toml::Table {
    recording.property("settings").parse().expect("TOML")
}

// ---- results -------------------------------------------------------------------------------------------------------

#[test]
fn a_run_reports_its_results_and_how_to_open_the_recording() {
    let dir = Dir::new();
    let ran = run(&dir, &["run", "two", "--save", "x.rrd"]).succeeded();
    assert_eq!(dir.names(), ["x.rrd"]);

    let scene = Scene::builtin("two").expect("a built-in scene");
    let (vertices, steps) = (scene.vertex_count(), scene.steps());
    let mut world = World::new(scene).expect("enough memory");
    let mut events: Vec<Event> = Vec::new();
    (0..steps).for_each(|_| events.extend_from_slice(&world.step().events));
    let mut expected = vec![
        "two: 2 bodies".to_owned(),
        format!("{vertices} vertices"),
        format!("{steps} steps"),
        "exponential".to_owned(),
        format!("{:.3} s simulated in ", world.time()),
        format!("{} events", events.len() + 2), // the surfaces touch and part
        format!("saved x.rrd: {} frames, {}", steps + 1, text::bytes(size(&dir.file("x.rrd")))),
        "`rerun x.rrd`".to_owned(),
        "--serve".to_owned(),
    ];
    expected.extend(events.iter().map(|event| format!("{} a~b at t = {:.9} s", event.name(), event.time)));
    for part in expected {
        assert!(ran.out.contains(&part), "{part}: {}", ran.out);
    }
    // no progress bar in a pipe
    assert!(!ran.out.contains(['\u{1b}', '\r']), "{:?}", ran.out);

    let recording = Recording::open(&dir.file("x.rrd"));
    assert_eq!(recording.steps(), steps as f64);
    assert_eq!(recording.property("scene"), world.scene().source);
}

#[test]
fn a_quiet_run_prints_nothing() {
    let dir = scene_dir();
    let ran = run(&dir, &["run", "small.toml", "--quiet"]).succeeded();
    assert_eq!(ran.out, "");
    assert_eq!(dir.names(), ["small.rrd", "small.toml"]);
    // except errors
    run(&dir, &["run", "smll.toml", "--quiet"]).failed(2);
}

#[test]
fn the_default_recording_is_named_after_the_scene_in_the_current_folder() {
    let long = ["x".repeat(200), "漢".repeat(150)];
    let hostile = ["../x", "/etc/passwd", "..", ".", ".hidden", "a b/c\\d", "~", "$(id)", "-rf"];
    for name in hostile.into_iter().chain(long.iter().map(String::as_str)) {
        let dir = Dir::new();
        fs::create_dir(dir.file("here")).expect("disk space");
        let scene = SCENE.replace("\"small\"", &format!("{name:?}"));
        fs::write(dir.file("here/scene.toml"), scene).expect("disk space");
        let mut command = meldscope(&dir, ["run", "scene.toml", "--steps", "3"]);
        let output = command.current_dir(dir.file("here")).output().expect("the program runs");
        let ran = Ran::new(output).succeeded();

        assert_eq!(dir.names(), ["here"], "{name}");
        let mut names: Vec<String> = fs::read_dir(dir.file("here"))
            .expect("a directory")
            .map(|entry| file_name(&entry.expect("an entry").path()))
            .collect();
        names.retain(|name| name != "scene.toml");
        let [saved] = &names[..] else { panic!("{name}: {names:?}") };
        assert!(saved.ends_with(".rrd") && !saved.starts_with(['.', '-']), "{name}: {saved}");
        assert!(ran.out.contains(&format!("saved {saved}")), "{}", ran.out);
        assert_eq!(Recording::open(&dir.file("here").join(saved)).steps(), 3.0);
    }
}

fn file_name(path: &Path) -> String {
    path.file_name().expect("a name").to_string_lossy().into_owned()
}

#[test]
fn the_command_that_opens_the_recording_can_be_pasted() {
    let dir = scene_dir();
    for (file, word) in [("my file.rrd", "'my file.rrd'"), ("it's.rrd", r"'it'\''s.rrd'"), ("-x.rrd", "./-x.rrd")] {
        let save = format!("--save={file}");
        let ran = run(&dir, &["run", "small.toml", "--steps", "1", &save]).succeeded();
        assert!(ran.out.contains(&format!("`rerun {word}`")), "{}", ran.out);
    }
}

#[test]
fn the_built_in_scenes_are_listed_and_run() {
    let dir = Dir::new();
    let ran = run(&dir, &["scenes"]).succeeded();
    for builtin in builtin::ALL {
        let scene = Scene::builtin(builtin.name).expect("a built-in scene");
        let bodies = scene.bodies.len();
        let count = if bodies == 1000 { "1,000".into() } else { bodies.to_string() };
        let line = format!("{}: {count} {}", builtin.name, if bodies == 1 { "body" } else { "bodies" });
        assert!(ran.out.lines().any(|found| found.starts_with(&line) && found.ends_with(" vertices")), "{}", ran.out);
        assert!(builtin.what_to_look_at().count() > 0);
        assert!(builtin.what_to_look_at().all(|sentence| ran.out.contains(sentence)), "{}", ran.out);
    }
    assert_eq!(dir.names(), [""; 0]);
    for builtin in builtin::ALL {
        let scene = Scene::builtin(builtin.name).expect("a built-in scene");
        run(&dir, &["run", builtin.name, "--steps", "2", "--quiet"]).warned_of(&scene.warnings());
        assert_eq!(Recording::open(&dir.file(&format!("{}.rrd", builtin.name))).steps(), 2.0);
    }
    assert_eq!(dir.names().len(), builtin::ALL.len());
}

#[test]
fn help_and_version_are_results() {
    let dir = Dir::new();
    let version = run(&dir, &["--version"]).succeeded();
    assert_eq!(version.out, format!("meldscope {}\n", env!("CARGO_PKG_VERSION")));
    let help = run(&dir, &["--help"]).succeeded();
    assert!(help.out.contains("run") && help.out.contains("scenes"), "{}", help.out);
    let help = run(&dir, &["run", "--help"]).succeeded();
    let options =
        ["--save", "--spawn", "--connect", "--serve", "--stdout", "--integrator", "--set", "--steps", "--every"];
    for option in options.into_iter().chain(["--detail", "--realtime", "--threads", "--quiet", "--bind"]) {
        assert!(help.out.contains(option), "{option}: {}", help.out);
    }
    assert_eq!(dir.names(), [""; 0]);
}

// ---- rejected input ------------------------------------------------------------------------------------------------

#[test]
fn usage_errors_have_status_2_and_leave_nothing() {
    let dir = Dir::new();
    let error = run(&dir, &["run", "tow"]).failed(2);
    assert!(error.contains("did you mean \"two\"?") && error.contains("size_ratio"), "{error}");
    assert!(run(&dir, &["run", "Size-Ratio"]).failed(2).contains("did you mean \"size_ratio\"?"));
    assert!(run(&dir, &["run", "quite-something-else"]).failed(2).contains("meldscope scenes"));
    run(&dir, &["run", "two", "--sav", "x.rrd"]).failed(2);
    run(&dir, &["run"]).failed(2);
    run(&dir, &["run", "two", "three"]).failed(2);
    run(&dir, &["rnu", "two"]).failed(2);
    assert_eq!(run(&dir, &[]).status, 2);

    for bad in [
        "--set dt=0",
        "--set dt=-0.01",
        "--set dt=nan",
        "--set dt=inf",
        "--set dt=1e999",
        "--set dt=x",
        "--set dt",
        "--set",
        "--set tolerance=0",
        "--set tolerance=-1e-3",
        "--set influence.merge_a=1",
        "--set influence.merge_at=1.3",
        "--set body.c.radius=1",
        "--every 0",
        "--every=-1",
        "--every 1.5",
        "--integrator foo",
        "--integrator RK5",
        "--detail everything",
        "--entities few",
        "--steps=-1",
        "--steps 1.5",
        "--steps 1e3",
        "--threads 0",
        "--threads x",
        "--save",
        "--connect=http://127.0.0.1:1/proxy",
        "--connect=nonsense",
        "--connect rerun+http://127.0.0.1:1/proxy",
        "--serve --bind http://localhost",
        "--serve --bind *",
        "--serve --bind nowhere.invalid",
        "--serve --bind 127.0.0.1:70000",
        "--serve --bind 127.0.0.1:65535",
        "--serve --bind localhost:x",
        "--bind 127.0.0.1",
        "--quiet=yes",
        "--realtime 2",
        "--watch",
        "--watch --save x.rrd",
        "--watch --serve",
        "--detail forces=3..4",
        "--detail stages=5..2",
        "--detail stages=5",
        "--detail stages=-1..2",
        "--keep 0",
        "--keep 3+",
        "--keep 3+5",
        "--tab other",
        "--plots 1001",
    ] {
        let arguments: Vec<&str> = ["run", "two"].into_iter().chain(bad.split(' ')).collect();
        let error = run(&dir, &arguments).failed(2);
        assert!(error.lines().count() < 12, "{error}");
        assert_eq!(dir.names(), [""; 0], "{bad}");
    }
}

#[test]
fn a_broken_file_is_rejected_with_its_position_and_nothing_is_written() {
    let dir = Dir::new();
    let broken = SCENE.replace("radius = 0.5", "radios = 0.5");
    let line = broken.lines().position(|line| line.contains("radios")).expect("it exists") + 1;
    fs::write(dir.file("bad.toml"), &broken).expect("disk space");
    fs::write(dir.file("kept.rrd"), "RRF2: precious").expect("disk space");
    for destination in [&[][..], &["--save", "kept.rrd"], &["--stdout"], &["--serve", "--bind", "127.0.0.1:0"]] {
        let arguments: Vec<&str> = ["run", "bad.toml"].into_iter().chain(destination.iter().copied()).collect();
        let error = run(&dir, &arguments).failed(2);
        for part in [format!("bad.toml:{line}:"), "radios".to_owned(), "\"radius\"".to_owned()] {
            assert!(error.contains(&part), "{part}: {error}");
        }
        assert_eq!(error.lines().count(), 1, "{error}");
    }
    assert_eq!(dir.names(), ["bad.toml", "kept.rrd"]);
    assert_eq!(fs::read_to_string(dir.file("kept.rrd")).expect("it exists"), "RRF2: precious");

    for missing in ["missing.toml", "missing/scene.toml", "."] {
        let error = run(&dir, &["run", missing]).failed(2);
        assert!(error.contains(missing), "{error}");
    }
    fs::write(dir.file("bad.toml"), b"name = \"\xff\"").expect("disk space");
    assert!(run(&dir, &["run", "bad.toml"]).failed(2).contains("UTF-8"));
    assert_eq!(dir.names(), ["bad.toml", "kept.rrd"]);
}

/// A scene with one change that is likely to break it.
fn broken_scene() -> impl Strategy<Value = String> {
    let lines = SCENE.lines().count();
    let values = [
        "nan",
        "-inf",
        "1e300",
        "-1",
        "0",
        "\"x\"",
        "\"\"",
        "[]",
        "[1, 2]",
        "{}",
        "true",
        "1979-05-27",
        "",
        "= 1",
        "'''",
    ];
    let keys = ["radios", "name", "merge_at", "body", "motion", "ω", "\"\"", "a.b", "[x]", "[[body]]", "core_at"];
    let line = (0..lines, prop::sample::select(values.to_vec()), prop::sample::select(keys.to_vec()), 0..6u8);
    let edited = line.prop_map(|(at, value, key, how)| {
        let edit = |(number, line): (usize, &str)| {
            let (name, old) = line.split_once('=').unwrap_or((line, ""));
            match how {
                _ if number != at => line.to_owned(),
                0 => String::new(),
                1 => format!("{line}\n{line}"),
                2 => format!("{key} = {old}"),
                3 => format!("{line} {value}"),
                _ => format!("{name} = {value}"),
            }
        };
        SCENE.lines().enumerate().map(edit).collect::<Vec<_>>().join("\n")
    });
    let cut = (0..SCENE.len()).prop_map(|length| SCENE[..length].to_owned());
    prop_oneof![4 => edited, 1 => cut, 1 => any::<String>()]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn no_broken_scene_is_run(text in broken_scene()) {
        let rejection = Scene::parse(&text, "bad.toml");
        prop_assume!(rejection.is_err());
        let dir = Dir::new();
        fs::write(dir.file("bad.toml"), &text).expect("disk space");
        let error = run(&dir, &["run", "bad.toml", "--steps", "1"]).failed(2);
        prop_assert_eq!(error, format!("error: {}\n", rejection.expect_err("an error")));
        prop_assert_eq!(dir.names(), ["bad.toml"]);
    }
}

#[test]
fn unwritable_destinations_are_rejected_before_the_run() {
    let dir = scene_dir();
    // these runs would never end if they started
    let error = run(&dir, &["run", "small.toml", "--steps", "0", "--save", "no/such/x.rrd"]).failed(1);
    assert!(error.contains("no/such"), "{error}");
    run(&dir, &["run", "small.toml", "--steps", "0", "--save", "."]).failed(1);
    assert_eq!(dir.names(), ["small.toml"]);

    // an occupied port: the existing file stays
    let taken = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port");
    let port = taken.local_addr().expect("an address").port().to_string();
    fs::write(dir.file("kept.rrd"), "RRF2: precious").expect("disk space");
    let bind = format!("127.0.0.1:{port}");
    let arguments = ["run", "small.toml", "--save", "kept.rrd", "--serve", "--bind", &bind];
    let error = run(&dir, &arguments).failed(1);
    assert!(error.contains(&port), "{error}");
    assert_eq!(dir.names(), ["kept.rrd", "small.toml"]);
    assert_eq!(fs::read_to_string(dir.file("kept.rrd")).expect("it exists"), "RRF2: precious");

    // and a successful run replaces it
    run(&dir, &["run", "small.toml", "--save", "kept.rrd"]).succeeded();
    assert_eq!(Recording::open(&dir.file("kept.rrd")).steps(), 120.0);
}

/// Runs with limited memory: a program that allocated the memory of the scene would be killed.
#[cfg(unix)]
#[test]
fn a_scene_that_is_too_large_is_rejected_before_it_starts() {
    let dir = Dir::new();
    let mut text = "name = \"huge\"\nduration = 1\n".to_owned();
    for i in 0..40 {
        text += &format!(
            "[[body]]\nname = \"b{i}\"\nradius = 1\nshape = {{ sphere = {{ stacks = 65535, slices = 65535 }} }}\n\
             motion = {{ fixed = [{i}, 0, 0] }}\n"
        );
    }
    fs::write(dir.file("huge.toml"), text).expect("disk space");
    fs::write(dir.file("kept.rrd"), "RRF2: precious").expect("disk space");
    let mut limited = Command::new("sh");
    limited.args(["-c", "ulimit -v 2000000 && exec \"$0\" run huge.toml --save kept.rrd"]);
    limited.arg(env!("CARGO_BIN_EXE_meldscope")).current_dir(dir.path()).stdin(Stdio::null());
    let error = Ran::new(limited.output().expect("sh runs")).failed(2);
    for part in ["\"huge\"", "40 bodies", "TiB", "available", "stacks"] {
        assert!(error.contains(part), "{part}: {error}");
    }
    assert_eq!(dir.names(), ["huge.toml", "kept.rrd"]);
    assert_eq!(fs::read_to_string(dir.file("kept.rrd")).expect("it exists"), "RRF2: precious");
}

// ---- options -------------------------------------------------------------------------------------------------------

/// A value may be set again when a recording is run again, however its key is spelt, but not twice at once.
#[test]
fn a_value_is_set_once_at_a_time() {
    let dir = Dir::new();
    let (by_name, by_number) = ("body.left.radius=1.1", "body[0].radius=1.2");
    run(&dir, &["run", "collide", "--steps", "3", "--thin", "--set", by_name, "--save", "c.rrd"]).succeeded();
    let out = run(&dir, &["replay", "c.rrd", "--set", by_number]).succeeded().out;
    assert!(out.contains("set: body[0].radius = 1.2; not verified"), "{out}");
    let whole = "body.left={radius=1.0}";
    for (more, expected) in [
        (by_name, "body.left.radius=… is given twice: leave one out"),
        (by_number, "body[0].radius=… sets body.left.radius again: leave one out"),
        (whole, "body.left=… sets body.left.radius again: leave one out"),
    ] {
        let error = run(&dir, &["run", "collide", "--steps", "3", "--set", by_name, "--set", more]).failed(2);
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn options_have_their_documented_effect() {
    let dir = scene_dir();
    let recorded = |options: &str| {
        let arguments: Vec<&str> =
            ["run", "small.toml", "--save", "x.rrd"].into_iter().chain(options.split(' ')).collect();
        let ran = run(&dir, &arguments).succeeded();
        (Recording::open(&dir.file("x.rrd")), ran.out)
    };
    let forces = |recording: &Recording| {
        recording.entities().iter().filter(|entity| entity.to_string().starts_with("/world/forces/")).count()
    };
    let frames =
        |recording: &Recording| -> Vec<i64> { recording.changes("/timings/log").iter().map(|row| row.step).collect() };

    let (recording, out) = recorded("--steps 10");
    assert_eq!((recording.steps(), frames(&recording).last()), (10.0, Some(&10)));
    assert!(out.contains("10 steps") && out.contains("11 frames") && forces(&recording) > 0, "{out}");

    let (recording, out) = recorded("--set dt=0.01");
    assert_eq!(settings(&recording)["dt"], toml::Value::from(0.01));
    assert_eq!(recording.steps(), 200.0);
    assert!(recording.changes("/timings/log").iter().all(|row| row.time == row.step * 10_000_000), "{out}");

    let (recording, _) = recorded("--set tolerance=1e-4");
    assert_eq!(settings(&recording)["tolerance"], toml::Value::from(1e-4));

    let (recording, out) = recorded("--every 3 --steps 20");
    assert_eq!(frames(&recording), [3, 6, 9, 12, 15, 18]);
    assert!(out.contains("20 steps") && out.contains("7 frames"), "{out}");
    assert_eq!((recording.steps(), &settings(&recording)["every"]), (20.0, &toml::Value::from(3)));

    for integrator in ["thesis", "mps", "euler", "verlet", "rk4", "exponential"] {
        let (recording, out) = recorded(&format!("--integrator {integrator} --steps 5"));
        assert_eq!(recording.property("integrator"), integrator);
        assert_eq!(settings(&recording)["integrator"], toml::Value::from(integrator));
        assert!(out.contains(integrator), "{out}");
    }

    let (recording, _) = recorded("--detail surface");
    assert_eq!(forces(&recording), 0);
    let (recording, _) = recorded("--entities batch");
    assert!(recording.entities().iter().any(|entity| entity.to_string() == "/world/resting/sphere_6x8"));

    // the recording does not depend on the number of threads
    let (one, _) = recorded("--threads 1");
    let (two, _) = recorded("--threads 2");
    assert!(content(&one) == content(&two));
}

#[test]
fn the_recording_does_not_depend_on_speed() {
    let dir = scene_dir();
    run(&dir, &["run", "small.toml", "--steps", "60", "--save", "fast.rrd"]).succeeded();
    let started = Instant::now();
    run(&dir, &["run", "small.toml", "--steps", "60", "--save", "slow.rrd", "--realtime"]).succeeded();
    assert!(started.elapsed() >= Duration::from_secs(1), "faster than simulated time");
    let [fast, slow] = ["fast.rrd", "slow.rrd"].map(|name| Recording::open(&dir.file(name)));
    assert_eq!(fast.id, slow.id);
    let [fast, slow] = [content(&fast), content(&slow)];
    for (entity, rows) in &fast {
        assert!(slow.get(entity) == Some(rows), "{entity} differs");
    }
    assert_eq!(fast.len(), slow.len());
}

/// Without a terminal, a run that takes long prints a line every ten seconds, unless it is to be quiet.
#[test]
fn a_long_run_reports_its_progress() {
    let dir = scene_dir();
    let report = |more: &[&str]| {
        let arguments = ["run", "small.toml", "--steps", "630", "--realtime", "--save"];
        run(&dir, &[&arguments, more].concat()).err
    };
    std::thread::scope(|scope| {
        let quiet = scope.spawn(|| report(&["quiet.rrd", "--quiet"]));
        let said = report(&["said.rrd"]);
        let words: Vec<&str> = said.lines().next().unwrap_or_default().split(", ").collect();
        let [step, time, rate, left, size] = words[..] else { panic!("{said}") };
        assert!(step.starts_with("step ") && step.ends_with(" of 630"), "{said}");
        assert!(time.starts_with("t = ") && rate.ends_with(" steps/s") && left.ends_with(" s left"), "{said}");
        assert!(size.ends_with("iB"), "{said}");
        assert_eq!(said.lines().count(), 1, "{said}");
        assert_eq!(quiet.join().expect("no panic"), "");
    });
}

// ---- pipes ---------------------------------------------------------------------------------------------------------

#[test]
fn standard_output_can_be_the_recording() {
    let dir = scene_dir();
    let ran = run(&dir, &["run", "small.toml", "--stdout"]);
    assert_eq!(ran.status, 0, "{}", ran.err);
    assert!(ran.err.contains("small: 2 bodies") && ran.err.contains("4 events"), "{}", ran.err);
    assert!(!ran.err.contains(['\u{1b}', '\r']), "{:?}", ran.err);
    assert_eq!(dir.names(), ["small.toml"]);
    let piped = Recording::read(&ran.bytes[..]);
    assert_eq!(piped.steps(), 120.0);

    run(&dir, &["run", "small.toml", "--save", "x.rrd"]).succeeded();
    let saved = Recording::open(&dir.file("x.rrd"));
    assert_eq!(piped.id, saved.id);
    assert!(content(&piped) == content(&saved));

    let quiet = run(&dir, &["run", "small.toml", "--stdout", "--quiet"]);
    assert_eq!((quiet.status, quiet.err.as_str()), (0, ""));
    assert_eq!(Recording::read(&quiet.bytes[..]).steps(), 120.0);
}

#[test]
fn a_closed_pipe_ends_the_run() {
    let dir = scene_dir();
    let mut running = Running::start(&dir, &["run", "small.toml", "--stdout", "--steps", "0"]);
    let mut beginning = [0; 1000];
    running.child().stdout.take().expect("a pipe").read_exact(&mut beginning).expect("a recording");
    let ran = running.end();
    assert_eq!(ran.status, 1, "{}", ran.err);
    assert!(ran.err.contains("error: ") && ran.err.contains("standard output"), "{}", ran.err);
}

#[test]
fn a_diverging_run_is_reported_and_saved_up_to_that_step() {
    let dir = scene_dir();
    let options = ["--integrator", "euler", "--set", "dt=1", "--set", "push[0].duration=2", "--steps", "1000"];
    let arguments = [&["run", "small.toml", "--save", "x.rrd"], &options[..]].concat();
    let error = run(&dir, &arguments).failed(1);
    assert!(error.contains("diverged at step ") && error.contains("x.rrd"), "{error}");
    let recording = Recording::open(&dir.file("x.rrd"));
    assert!((1.0..1000.0).contains(&recording.steps()));
    assert!(error.contains(&format!("diverged at step {}", recording.steps())), "{error}");
    assert_eq!(recording.changes("/timings/log").last().map(|row| row.step as f64), Some(recording.steps()));
}

#[test]
fn a_missed_tolerance_is_reported_and_recorded() {
    let dir = scene_dir();
    let stiff = tolerance::UNRESOLVED;
    fs::write(dir.file("stiff.toml"), format!("dt = 0.1\ntolerance = 1e-10\n{stiff}")).expect("writable");
    let ran = run(&dir, &["run", "stiff.toml"]);
    assert_eq!(ran.status, 0, "{}", ran.err);
    let warning = "warning: the tolerance was not met in 1 step: step 1 (t = 0.100000 s): body \"";
    assert!(ran.err.contains(warning) && ran.err.contains("times what the tolerance allows"), "{}", ran.err);
    let lines = Recording::open(&dir.file("stiff.rrd")).changes("/events/accuracy");
    assert_eq!(lines.iter().map(|row| row.step).collect::<Vec<_>>(), [1]);
    let line = lines[0].text("TextLog:text");
    assert!(ran.err.contains(&line), "{line}");
}

#[test]
fn closed_output_is_not_an_error() {
    let dir = scene_dir();
    for arguments in [&["run", "small.toml"][..], &["scenes"], &["--help"], &["run", "--help"], &["--version"]] {
        let mut running = Running::start(&dir, arguments);
        drop(running.child().stdout.take());
        assert_eq!(running.end().status, 0, "{arguments:?}");
    }
    assert_eq!(Recording::open(&dir.file("small.rrd")).steps(), 120.0);
    let mut running = Running::start(&dir, &["run", "nothing.toml"]);
    drop(running.child().stderr.take());
    assert_eq!(running.end().status, 2);
}

// ---- Ctrl-C --------------------------------------------------------------------------------------------------------

#[cfg(unix)]
#[test]
fn an_interrupted_run_is_saved() {
    let vertices = Scene::parse(SCENE, "small.toml").expect("a valid scene").vertex_count();
    let every_step = "--realtime";
    let few_steps = "--every=1000";
    for (name, pace, twice, most) in [
        ("INT", every_step, false, "0"),
        ("TERM", every_step, false, "0"),
        ("INT", few_steps, false, "0"),
        ("INT", every_step, true, "0"),
        ("INT", every_step, false, "6000"),
    ] {
        let dir = scene_dir();
        run(&dir, &["run", "small.toml", "--steps", "1", "--save", "x.rrd"]).succeeded();
        // longer than the data written before the first steps
        let length = size(&dir.file("x.rrd")) * 2;
        let mut running = Running::start(&dir, &["run", "small.toml", "--steps", most, "--save", "x.rrd", pace]);
        running.eventually(|| size(&dir.file("x.rrd.partial")) > length);
        running.signal(name);
        if twice {
            // twice at once, like `timeout`, which signals a program and its process group
            signal(running.child().id(), name);
        }
        let ran = running.end();
        // a run without an end is to be ended so; any other run is cut short
        assert_eq!(ran.status, if most == "0" { 0 } else { 130 }, "{name}: {}", ran.err);
        assert_eq!(ran.err.contains("error: interrupted after step"), most != "0", "{}", ran.err);
        assert_eq!(dir.names(), ["small.toml", "x.rrd"]);

        let recording = Recording::open(&dir.file("x.rrd"));
        let steps = recording.steps();
        assert!(steps > 0.0);
        let printed: String = ran.out.chars().filter(|&c| c != ',').collect();
        assert!(printed.contains(&format!("small: 2 bodies {vertices} vertices; {steps} steps")), "{}", ran.out);
        // the recording is complete
        let last = recording.changes("/timings/log").last().expect("frames").step;
        assert_eq!(last, if pace == every_step { steps as i64 } else { steps as i64 / 1000 * 1000 });
    }
}

/// Pending frames are saved with overlapping meshes if their merged surfaces would take too long.
#[cfg(unix)]
#[test]
fn an_interrupt_does_not_wait_for_merged_surfaces() {
    let dir = scene_dir();
    let at = |i: u32, factor: f64| (f64::from(i) * factor).fract() - 0.5;
    let body = |i: u32| {
        let (x, y, z) = (at(i, 0.754877666), at(i, 0.569840291), at(i, 0.438579));
        format!(
            "[[body]]\nname = \"b{i}\"\nradius = 1.0\n\
             motion = {{ line = {{ from = [{x}, {y}, {z}], velocity = [{y}, {z}, {x}] }} }}\n"
        )
    };
    let heap: String = (0..64).map(body).collect();
    fs::write(dir.file("heap.toml"), format!("duration = 2.0\n[influence]\nalpha = 0\nbeta = 0\n{heap}"))
        .expect("disk space");
    for wait in [0, 1500] {
        // none if the request came before the first step, on a busy machine
        let end = || {
            let mut running = Running::start(&dir, &["run", "heap.toml", "--steps", "0", "--save", "x.rrd"]);
            running.eventually(|| dir.file("x.rrd.partial").exists());
            std::thread::sleep(Duration::from_millis(wait));
            let (ran, time) = running.ends_after("INT");
            if ran.err.contains("interrupted before the first step") {
                return None;
            }
            assert_eq!(ran.status, 0, "{}", ran.err);
            Some(time)
        };
        let ends = || (0..20).find_map(|_| end()).expect("it takes a step");
        // measured: 0.3 s, and 3.4 s if the run waited for the surfaces
        let times: Vec<f64> = (0..2).map(|_| ends()).collect();
        assert!(times.iter().any(|&time| time < 1.0), "after {wait} ms: {times:?} s");

        let recording = Recording::open(&dir.file("x.rrd"));
        let last = |entity: &str| recording.changes(entity).last().expect("rows").step as f64;
        // every step has its frame, and frames without a merged surface are marked
        assert!(recording.steps() == 0.0 || last("/timings/log") == recording.steps());
        assert_eq!(last("/diagnostics/overlapping_groups"), recording.steps());
    }
}

/// Commands whose partial results are of no use end at once and leave no file.
#[cfg(unix)]
#[test]
fn an_interrupted_check_leaves_nothing() {
    let dir = scene_dir();
    run(&dir, &["run", "small.toml", "--quiet", "--save", "x.rrd"]).succeeded();
    fs::write(dir.file("long.toml"), SCENE.replace("duration = 2.0", "duration = 1e6")).expect("disk space");
    let names = dir.names();
    let cases: [(&str, &[&str]); 5] = [
        ("INT", &["replay", "x.rrd", "--set", "dt=1e-8", "--save", "y.rrd"]),
        ("TERM", &["replay", "x.rrd", "--set", "dt=1e-8", "--save", "y.rrd"]),
        ("INT", &["check", "long.toml", "--bless", "a test"]),
        // the golden recording of the first scene is complete, but nobody knows why it was made
        ("INT", &["check", "small.toml", "long.toml", "--bless", "a test"]),
        ("TERM", &["bench", "error", "small.toml", "--csv", "o.csv"]),
    ];
    for (name, arguments) in cases {
        let mut running = Running::start(&dir, arguments);
        running.eventually(|| dir.names().iter().any(|name| name.ends_with(".partial")));
        if arguments.contains(&"--bless") {
            std::thread::sleep(Duration::from_millis(500));
        }
        let (ran, time) = running.ends_after(name);
        assert_eq!(ran.failed(130), "error: interrupted\n", "{arguments:?}");
        assert!(time < 1.0, "{arguments:?}: {time} s");
        assert_eq!(dir.names(), names, "{arguments:?}");
    }
}

// ---- viewers -------------------------------------------------------------------------------------------------------

#[test]
fn a_missing_viewer_is_an_error_only_without_another_destination() {
    let dir = scene_dir();
    let url = unused_viewer_url();
    let connect = format!("--connect={url}");
    let error = run(&dir, &["run", "small.toml", "--steps", "0", &connect]).failed(1);
    assert!(error.contains(&url) && error.contains("--spawn"), "{error}");
    assert_eq!(dir.names(), ["small.toml"]);

    for quiet in [&[][..], &["--quiet"]] {
        let arguments = ["run", "small.toml", &connect, "--save", "x.rrd"];
        let ran = run(&dir, &[&arguments[..], quiet].concat());
        assert_eq!(ran.status, 0, "{}", ran.err);
        assert_eq!(ran.err.lines().count(), 1, "{}", ran.err);
        assert!(ran.err.contains("without a viewer") && ran.err.contains(&url), "{}", ran.err);
        assert_eq!(ran.out.is_empty(), !quiet.is_empty());
        assert_eq!(Recording::open(&dir.file("x.rrd")).steps(), 120.0);
    }
}

#[cfg(unix)]
#[test]
fn a_browser_is_served_until_the_run_is_interrupted() {
    const PORTS: [&str; 3] = ["--serve", "--bind", "127.0.0.1:0"];
    for steps in ["0", "30"] {
        let dir = scene_dir();
        let arguments = ["run", "small.toml", "--steps", steps, "--realtime", "--save", "x.rrd"];
        let mut running = Running::start(&dir, &[&arguments[..], &PORTS].concat());
        let address = running.wait_for_line("serving at http://");
        let (host, path) = address.split_once('/').expect("a path");
        assert!(host.starts_with("127.0.0.1:"), "{address}");
        let mut stream = TcpStream::connect(host).expect("it listens");
        let request = format!("GET /{path} HTTP/1.1\r\nhost: {host}\r\nconnection: close\r\n\r\n");
        stream.write_all(request.as_bytes()).expect("it reads");
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).expect("it answers");
        assert!(answer.starts_with(b"HTTP/1.1 200 OK\r\n"), "{}", String::from_utf8_lossy(&answer));

        // after the run the file is complete and the server is still running
        if steps != "0" {
            running.eventually(|| dir.names().contains(&"x.rrd".to_owned()));
            assert_eq!(Recording::open(&dir.file("x.rrd")).steps(), 30.0);
            assert!(TcpStream::connect(host).is_ok());
        }
        running.signal("INT");
        assert_eq!(running.end().status, 0);
        assert_eq!(dir.names(), ["small.toml", "x.rrd"]);
        assert!(Recording::open(&dir.file("x.rrd")).steps() > 0.0);
    }
}

#[cfg(unix)]
#[test]
fn destinations_can_be_combined() {
    let dir = scene_dir();
    let connect = format!("--connect={}", unused_viewer_url());
    let arguments = ["run", "small.toml", "--save", "x.rrd", "--stdout", &connect];
    let serve = ["--serve", "--bind", "127.0.0.1:0"];
    let mut running = Running::start(&dir, &[&arguments[..], &serve].concat());
    let stdout = running.child().stdout.take().expect("a pipe");
    let reader = std::thread::spawn(move || {
        let (mut stdout, mut bytes) = (stdout, Vec::new());
        stdout.read_to_end(&mut bytes).map(|_| bytes)
    });
    running.wait_for_line("Serving until Ctrl-C");
    let saved = Recording::open(&dir.file("x.rrd"));
    running.signal("INT");
    assert_eq!(running.end().status, 0);
    let piped = reader.join().expect("no panic").expect("a recording");
    assert!(content(&saved) == content(&Recording::read(&piped[..])));
}

// ---- edited scenes -------------------------------------------------------------------------------------------------

#[cfg(unix)]
#[test]
fn a_valid_edit_restarts_the_run_and_a_broken_one_does_not() {
    let dir = scene_dir();
    let scene = dir.file("small.toml");
    for steps in ["0", "30"] {
        fs::write(&scene, SCENE).expect("disk space");
        let arguments = ["run", "small.toml", "--steps", steps, "--watch", "--serve", "--bind", "127.0.0.1:0"];
        let mut running = Running::start(&dir, &arguments);
        let lines = running.lines();
        wait_for_line(&lines, "serving at");
        fs::write(&scene, format!("{SCENE}\nwrong = 1\n")).expect("disk space");
        let why = lines.iter().find(|line| line.contains("wrong")).expect("a reason");
        assert!(why.contains("small.toml") && why.contains("continuing with the previous scene"), "{why}");
        for comment in ["one", "two"] {
            fs::write(&scene, format!("# {comment}\n{SCENE}")).expect("disk space");
            wait_for_line(&lines, "small.toml has changed: restarting");
        }
        running.signal("INT");
        wait_for_line(&lines, "Serving until Ctrl-C");
        std::thread::sleep(Duration::from_millis(1100)); // a second interrupt, not an echo of the first
        running.signal("INT");
        running.end();
    }
}

// ---- endless runs --------------------------------------------------------------------------------------------------

#[cfg(target_os = "linux")]
#[test]
fn memory_stays_bounded_over_a_hundred_thousand_frames() {
    let dir = Dir::new();
    let text = r#"
        name = "endless"
        duration = 1.0
        [[body]]
        name = "a"
        shape = { sphere = { stacks = 4, slices = 6 } }
        radius = 1.0
        motion = { fixed = [0, 0, 0] }
        [[body]]
        name = "b"
        shape = { sphere = { stacks = 4, slices = 6 } }
        radius = 1.0
        motion = { sine = { center = [2.1, 0, 0], amplitude = [0.4, 0, 0], frequency = 0.5 } }
    "#;
    fs::write(dir.file("endless.toml"), text).expect("disk space");
    let arguments = ["run", "endless.toml", "--steps", "120000", "--save", "x.rrd", "--quiet"];
    let mut running = Running::start(&dir, &arguments);
    let status = format!("/proc/{}/status", running.child().id());
    let resident = || {
        let status = fs::read_to_string(&status).ok()?;
        let line = status.lines().find(|line| line.starts_with("VmRSS:"))?.to_owned();
        line.split_whitespace().nth(1)?.parse::<u64>().ok()
    };
    let size = || fs::metadata(dir.file("x.rrd.partial")).map_or(0, |file| file.len());
    // buffers reach their full size in the first third; from then on nothing grows
    let (mut first, mut most) = (0, 0);
    while running.child().try_wait().expect("a child").is_none() {
        let now = resident().unwrap_or(0);
        most = most.max(now);
        if size() < 68 << 20 {
            first = most;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    running.end().succeeded();
    let recording = Recording::open(&dir.file("x.rrd"));
    assert_eq!(recording.steps(), 120_000.0);
    // the footer of a file of 206 MB takes up most of it
    assert!(first > 0 && most < first + (96 << 10), "{first} kB, then {most} kB");
}

/// The help lists the values that the recorder accepts.
#[test]
fn the_help_lists_the_accepted_names() {
    let help = |command: &str| {
        let output = Command::new(env!("CARGO_BIN_EXE_meldscope")).args([command, "--help"]).output().expect("starts");
        String::from_utf8(output.stdout).expect("text")
    };
    let details = "--detail <surface|forces|stages[=FROM..TO]>";
    let run = help("run");
    for values in [details, "body, batch]", "scene, surface, forces, displacement, pairs, timings, energy, stages]"] {
        assert!(run.contains(values), "{values}: {run}");
    }
    assert!(run.contains("--on <merge,split,core,diverge>"), "{run}");
    assert!(help("replay").contains(details));
}

#[test]
fn the_reference_explains_scenes_that_a_user_can_start_from() {
    let dir = Dir::new();
    for (of, words) in [
        ("scene", &["merge_at", "[[pair]]", "[[grid]]", "[[plane]]", "[[push]]", "rad/s", "[1.05]"][..]),
        ("sweep", &["[[axis]]", "influence.merge_at", "latin"]),
        ("recording", &["/world/bodies/NAME/surface", "Mesh3D", "/pairs/A~B/distance", "overrides", "sim_time"]),
        ("tables", &["outcome", "first_merge", "threshold", "momentum_x", "displacement from rest"]),
        ("events", &["core left", "touch", "would tear", "diverge", "bounced"]),
    ] {
        // -q does not hide what the command is for
        let out = run(&dir, &["reference", of, "-q"]).succeeded().out;
        for word in words {
            assert!(out.contains(word), "{of} lacks {word}: {out}");
        }
        assert!(out.lines().all(|line| line == line.trim_end()), "{out}");
    }
    assert!(run(&dir, &["reference", "scenes"]).failed(2).contains("scene"));
    for builtin in builtin::ALL {
        let shown = run(&dir, &["scenes", "--show", builtin.name]).succeeded().out;
        let scene = Scene::parse(&shown, builtin.name).expect("a scene");
        assert_eq!(Scene::builtin(builtin.name).map(|own| own.bodies.len()), Some(scene.bodies.len()));
    }
    let shown = run(&dir, &["scenes", "--show", "two"]).succeeded().out;
    std::fs::write(dir.file("mine.toml"), shown).expect("a file");
    let output = run(&dir, &["run", "mine.toml", "--thin"]).succeeded().out;
    assert!(output.contains("saved mine.rrd"), "not under the name of the built-in scene: {output}");
    assert!(run(&dir, &["scenes", "--show", "collid"]).failed(2).contains("did you mean \"collide\"?"));
}

/// The messages sent to a viewer, as a file: a scene's recordings without their ends.
fn seen(viewer: &Viewer) -> Vec<Message> {
    let arrow = |frame: Vec<u8>| {
        let inner = fields(&frame).into_iter().find_map(|(_, value)| value.err())?;
        let (_, body) = fields(&inner).into_iter().find(|(field, _)| *field == 2)?;
        Some(Message { kind: 2, body: body.err()? })
    };
    viewer.messages().into_iter().filter_map(arrow).collect()
}

/// The recording that a message belongs to; `None` for that of a blueprint.
fn recording_of(message: &Message) -> Option<String> {
    let store = fields(&message.body).into_iter().find(|(field, _)| *field == 1)?.1.err()?;
    let store = fields(&store);
    let is_recording = store.contains(&(1, Ok(1)));
    let id = store.into_iter().find(|(field, _)| *field == 2)?.1.err()?;
    is_recording.then(|| String::from_utf8(id).expect("a text"))
}

#[test]
fn a_viewer_beside_a_file_gets_every_row_once() {
    let dir = scene_dir();
    let viewer = Viewer::start();
    let connect = format!("--connect={}", viewer.url());
    let arguments = ["run", "small.toml", "--steps", "40", "--realtime", "--quiet", "--save", "x.rrd", &connect];
    assert_eq!(run(&dir, &arguments).status, 0);
    fs::write(dir.file("seen.rrd"), file(&seen(&viewer))).expect("disk space");
    let rows = |name: &str| {
        let mut reader = Reader::open(&dir.file(name)).expect("a recording");
        let mut ids = Vec::new();
        // checksums are sent only where they can be verified
        while let Some(chunk) = reader.next(|entity| entity != "/checksum").expect("a recording") {
            ids.extend(chunk.row_ids().map(|id| (chunk.entity_path().to_string(), id)));
        }
        ids.sort();
        ids
    };
    let (seen, saved) = (rows("seen.rrd"), rows("x.rrd"));
    let twice: Vec<_> = seen.windows(2).filter(|pair| pair[0] == pair[1]).map(|pair| &pair[0]).collect();
    assert!(twice.is_empty(), "{} rows twice, such as {:?}", twice.len(), twice[0]);
    assert!(seen == saved, "{} rows seen, {} saved", seen.len(), saved.len());
}

#[cfg(unix)]
#[test]
fn a_reverted_edit_is_a_new_run() {
    let dir = scene_dir();
    let viewer = Viewer::start();
    let connect = format!("--connect={}", viewer.url());
    let arguments = ["run", "small.toml", "--steps", "3", "--watch", &connect];
    let mut running = Running::start(&dir, &arguments);
    let lines = running.lines();
    for text in [format!("# other\n{SCENE}"), SCENE.to_owned()] {
        std::thread::sleep(Duration::from_millis(500));
        fs::write(dir.file("small.toml"), text).expect("disk space");
        wait_for_line(&lines, "small.toml has changed: restarting");
    }
    std::thread::sleep(Duration::from_millis(500));
    running.signal("INT");
    running.end();
    let ids: std::collections::BTreeSet<String> = seen(&viewer).iter().filter_map(recording_of).collect();
    assert_eq!(ids.len(), 3, "{ids:?}");
}

#[cfg(unix)]
#[test]
fn only_regular_files_are_watched() {
    let dir = scene_dir();
    let scene = dir.file("small.toml");
    assert!(Command::new("mkfifo").arg(dir.file("pipe")).status().expect("mkfifo").success());
    let serve = ["--watch", "--serve", "--bind", "127.0.0.1:0"];
    for name in ["pipe", "/dev/zero"] {
        let error = run(&dir, &[&["run", name], &serve[..]].concat()).failed(2);
        assert!(error.contains("--watch needs a scene file"), "{error}");
    }
    let mut running = Running::start(&dir, &[&["run", "small.toml", "--steps", "3"], &serve[..]].concat());
    let lines = running.lines();
    wait_for_line(&lines, "serving at");
    let replace = |by: &dyn Fn()| {
        fs::remove_file(&scene).expect("it exists");
        by();
    };
    replace(&|| fs::rename(dir.file("pipe"), &scene).expect("disk space"));
    let why = lines.iter().find(|line| line.contains("continuing")).expect("a reason");
    assert!(why.contains("is no longer a file"), "{why}");
    replace(&|| std::os::unix::fs::symlink("/dev/zero", &scene).expect("disk space"));
    std::thread::sleep(Duration::from_millis(200));
    replace(&|| fs::File::create(&scene).and_then(|file| file.set_len(64 << 30)).expect("a sparse file"));
    let why = lines.iter().find(|line| line.contains("continuing")).expect("a reason");
    assert!(why.contains("exceeds the size limit of a scene"), "{why}");
    // and back again
    replace(&|| fs::write(&scene, format!("# back\n{SCENE}")).expect("disk space"));
    wait_for_line(&lines, "small.toml has changed: restarting");
    // what is no text is told, too, and after it the same text is new again
    replace(&|| fs::write(&scene, b"\xff").expect("disk space"));
    let why = lines.iter().find(|line| line.contains("continuing")).expect("a reason");
    assert!(why.contains("small.toml:1:1: not UTF-8"), "{why}");
    replace(&|| fs::write(&scene, format!("# back\n{SCENE}")).expect("disk space"));
    wait_for_line(&lines, "small.toml has changed: restarting");
    running.signal("INT");
    std::thread::sleep(Duration::from_millis(1100)); // a second interrupt, not an echo of the first
    running.signal("INT");
    running.end();
}

#[test]
fn options_without_effect_are_rejected_with_the_missing_option() {
    let dir = scene_dir();
    let rejected = |arguments: &[&str], what: &str| {
        let error = run(&dir, arguments).failed(2);
        assert!(error.contains(what), "{arguments:?}: {error}");
    };
    rejected(&["run", "small.toml", "--detail", "stages=121..130"], "beyond the last, 120");
    rejected(&["run", "small.toml", "--detail", "stages=4..9", "--steps", "3"], "beyond the last, 3");
    rejected(&["run", "small.toml", "--tab", "stages"], "--detail stages");
    rejected(&["run", "small.toml", "--tab", "forces", "--detail", "surface"], "--detail surface");
    run(&dir, &["run", "small.toml", "--detail", "stages=120..120", "--tab", "stages", "--quiet"]).succeeded();
    // a recording where a scene is expected
    rejected(&["run", "small.rrd"], "`meldscope replay small.rrd`");
    rejected(&["bench", "error", "small.rrd"], "`meldscope replay small.rrd`");
    let printed = run(&dir, &["run", "small.toml", "--steps", "1", "--save", "x.rrd"]).succeeded().out;
    assert!(printed.contains("; 1 step of "), "{printed}");
}

// ---- events --------------------------------------------------------------------------------------------------------

/// One row for each event, in order of time, with the remark on the surfaces: the same in the summary, in the recording
/// and in the table, whatever is recorded. The closest approach is the same too.
#[test]
fn events_are_the_same_in_summaries_recordings_and_tables() {
    let dir = Dir::new();
    let scene = "name = \"s\"\nduration = 5.0\n[[body]]\nname = \"a\"\nradius = 1.0\nshape = { sphere = { stacks = 8, slices = 12 } }\n\
                 motion = { fixed = [0, 0, 0] }\n[[body]]\nname = \"b\"\nradius = 1.0\nshape = { sphere = { stacks = 8, slices = 12 } }\n\
                 motion = { sine = { center = [2.2, 0, 0], amplitude = [0.4, 0, 0], frequency = 0.4 } }\n[[body]]\nname = \"c\"\n\
                 radius = 1.0\nmotion = { line = { from = [-1.4, 2.14, 0], velocity = [0.5, 0, 0] } }\n";
    fs::write(dir.path().join("s.toml"), scene).expect("a file");
    let mut others: Option<(Vec<String>, Vec<String>)> = None;
    for options in [&[][..], &["--every", "7"], &["--thin"], &["--keep", "3"]] {
        let printed = run(&dir, &[&["run", "s.toml", "--save", "s.rrd"], options].concat()).succeeded().out;
        let lines = |what: &str| -> Vec<String> {
            printed.lines().filter(|line| line.starts_with("  ") && line.contains(what)).map(str::to_owned).collect()
        };
        let (events, misses) = (lines(", step "), lines(" short of "));
        assert!(printed.contains(&format!("{} events:", events.len())), "{printed}");
        assert!(events.iter().any(|line| line.contains("touch a~b")) && !misses.is_empty(), "{printed}");
        if let Some((others, misses_then)) = &others {
            assert_eq!((others, misses_then), (&events, &misses), "{options:?}");
        }
        let recording = Recording::open(&dir.path().join("s.rrd"));
        let entities = ["/events", "/events/surfaces", "/events/bodies"];
        let all = entities.iter().flat_map(|&entity| recording.rows(&EntityPath::from(entity)));
        let mut rows: Vec<_> = all.map(|(_, row)| row).collect();
        rows.sort_by_key(|row| row.time);
        let texts: Vec<String> = rows.iter().map(|row| row.text("TextLog:text")).collect();
        assert_eq!(texts.len(), events.len(), "{options:?}: {texts:?}");
        for (line, text) in events.iter().zip(&texts) {
            let (head, remark) = text.split_once(";\n    ").unwrap_or((text, ""));
            assert!(line.contains(head) && line.contains(remark), "{line}: {text}");
        }
        let merge = texts.iter().find(|text| text.starts_with("merge a~b")).expect("a merge");
        assert!(merge.contains(";\n    surfaces "), "{merge}");
        run(&dir, &["export", "s.rrd", "--events", "events.csv"]).succeeded();
        let table = fs::read_to_string(dir.path().join("events.csv")).expect("a table");
        let times: Vec<f64> = table
            .lines()
            .skip(1)
            .map(|line| line.split(',').nth(1).and_then(|time| time.parse().ok()).expect("a time"))
            .collect();
        assert!(times.len() == events.len() && times.is_sorted(), "{table}");
        others = Some((events, misses));
        for name in ["s.rrd", "events.csv"] {
            fs::remove_file(dir.path().join(name)).expect("it exists");
        }
    }
}

/// A rate of steps from a few milliseconds is noise: none is given.
#[test]
fn a_rate_of_steps_is_given_only_for_runs_that_take_a_while() {
    let dir = Dir::new();
    let printed = run(&dir, &["run", "push", "--steps", "3", "--save", "x.rrd"]).succeeded().out;
    assert!(printed.contains("s, recorded in") && !printed.contains("steps/s"), "{printed}");
}

#[test]
fn thin_recordings_say_that_they_hold_events() {
    let dir = Dir::new();
    let printed = run(&dir, &["run", "two", "--thin", "--save", "x.rrd"]).succeeded().out;
    assert!(printed.contains("the scene, ") && printed.contains(" events and 301 checksums"), "{printed}");
    let printed = run(&dir, &["replay", "x.rrd", "--set", "integrator=rk4"]).succeeded().out;
    assert!(printed.contains("2 phase changes, 2 recorded:"), "{printed}");
}

/// A file that lacks nothing but its end is not said to be cut short after the last of its steps.
#[test]
fn a_recording_without_its_end_names_what_it_lacks() {
    let dir = Dir::new();
    run(&dir, &["run", "push", "--save", "x.rrd"]).succeeded();
    let path = dir.path().join("x.rrd");
    let bytes = fs::read(&path).expect("the file");
    fs::write(&path, &bytes[..bytes.len() - 10]).expect("a file");
    let Ran { status, err, .. } = run(&dir, &["replay", "x.rrd"]);
    assert!(status == 2 && err.contains("has all 180 steps but lacks its end"), "{err}");
}

// ---- tables --------------------------------------------------------------------------------------------------------

#[test]
fn exported_tables_match_the_run_bit_by_bit() {
    let dir = Dir::new();
    let tables = ["--events", "events.csv", "--pairs", "pairs.csv", "--scalars", "scalars.csv"];
    run(&dir, &[&["export", "two"][..], &tables].concat()).succeeded();
    let rows = |name: &str| -> Vec<Vec<String>> {
        let text = fs::read_to_string(dir.path().join(name)).expect("a table");
        text.lines().skip(1).map(|line| line.split(',').map(str::to_owned).collect()).collect()
    };
    let mut world = World::new(Scene::builtin("two").expect("a scene")).expect("enough memory");
    let (mut events, mut pairs) = (Vec::new(), Vec::new());
    loop {
        let (step, time) = (world.steps_taken().to_string(), format!("{:?}", world.time()));
        pairs.extend(world.pairs().map(|pair| {
            let q = format!("{:?}", pair.q);
            vec![step.clone(), time.clone(), "a".to_owned(), "b".to_owned(), q, pair.phase.to_string()]
        }));
        if world.steps_taken() == world.scene().steps() {
            break;
        }
        events.extend(world.step().events.iter().map(|event| (event.step, event.name(), event.time, event.q)));
    }
    let all = rows("events.csv");
    assert!(all.is_sorted_by_key(|row| row[1].parse::<f64>().expect("a time")), "{all:?}");
    assert_eq!(all.iter().filter(|row| row[2] == "touch").count(), 1, "{all:?}");
    let found: Vec<_> = all.iter().filter(|row| !["touch", "part"].contains(&row[2].as_str())).collect();
    assert_eq!(found.len(), events.len());
    for (row, (step, name, time, q)) in found.iter().zip(events) {
        assert_eq!(row[..3], [step.to_string(), format!("{time:?}"), name.to_owned()]);
        assert_eq!(row[5].parse(), Ok(q));
    }
    let number = |cell: &String| cell.parse::<f64>().expect("a number");
    let (mut found, mut met) = (rows("pairs.csv"), 0);
    for row in &mut found {
        let measures: Vec<f64> = row.drain(6..).map(|cell| number(&cell)).collect();
        let [gap, overlap, neck] = measures[..] else { panic!("{measures:?}") };
        assert_eq!([overlap > 0.0, neck > 0.0], [gap < 0.0; 2], "{row:?}: {measures:?}");
        met += u64::from(gap < 0.0);
    }
    assert_eq!(found, pairs);
    assert!((50..200).contains(&met), "{met} steps in which they overlap");
    assert_eq!(rows("scalars.csv").len(), 301);

    // its own table is replaced; a foreign file is not
    run(&dir, &["export", "two", "--events", "events.csv"]).succeeded();
    fs::write(dir.path().join("mine.csv"), "a,b\n").expect("a file");
    let error = run(&dir, &["export", "two", "--events", "mine.csv"]).failed(2);
    assert!(error.contains("mine.csv is not a table with these columns and is not replaced"), "{error}");
    assert_eq!(fs::read_to_string(dir.path().join("mine.csv")).expect("the file"), "a,b\n");
    run(&dir, &["export", "two", "--events", "events.json"]).succeeded();
    run(&dir, &["export", "two", "--events", "events.json"]).succeeded();
    let more = fs::read_to_string(dir.file("events.json")).expect("a file").replacen('{', "{\"note\": \"mine\", ", 1);
    fs::write(dir.file("more.json"), more).expect("disk space");
    let error = run(&dir, &["export", "two", "--events", "more.json"]).failed(2);
    assert!(error.contains("more.json is not a table with these columns and is not replaced"), "{error}");
    let error = run(&dir, &["export", "two", "--pairs", "pairs.xlsx"]).failed(2);
    assert!(error.contains("use .csv, .json or .parquet"), "{error}");
    let error = run(&dir, &["export", "two", "--events", "e.csv", "--to", "18446744073709551615"]).failed(2);
    assert!(error.contains("--to 18446744073709551615 is beyond the last step, 300"), "{error}");
    for again in ["one.csv", "./one.csv", dir.file("one.csv").to_str().expect("UTF-8")] {
        let error = run(&dir, &["export", "two", "--pairs", "one.csv", "--states", again]).failed(2);
        assert!(error.contains("one.csv is given for two tables"), "{error}");
    }
    assert!(fs::read_dir(dir.path()).expect("a folder").all(|entry| {
        let name = entry.expect("an entry").file_name();
        !name.to_string_lossy().ends_with(".partial")
    }));
}

#[test]
fn exported_forces_are_those_of_the_world_and_add_up() {
    let dir = Dir::new();
    let options = ["--forces", "forces.csv", "--from", "90", "--to", "90"];
    run(&dir, &[&["export", "two"][..], &options].concat()).succeeded();
    let mut world = World::new(Scene::builtin("two").expect("a scene")).expect("enough memory");
    while world.steps_taken() < 90 {
        let _ = world.step();
    }
    let mut reader = csv::Reader::from_path(dir.path().join("forces.csv")).expect("a table");
    let mut sums = std::collections::BTreeMap::<(String, usize), [glam::DVec3; 2]>::new();
    let mut forces = meldscope::sim::BodyForces::default();
    let mut found = 0;
    for row in reader.records().map(|row| row.expect("a row")) {
        let number = |i: usize| row[i].parse::<f64>().expect("a number");
        let (vertex, acceleration) =
            (row[3].parse().expect("a vertex"), glam::DVec3::new(number(6), number(7), number(8)));
        let [causes, net] = sums.entry((row[2].to_owned(), vertex)).or_default();
        if &row[4] == "net" {
            *net += acceleration
        } else {
            *causes += acceleration
        }
        if &row[4] == "attraction" {
            let body = usize::from(&row[2] == "b");
            world.forces(body, &mut forces);
            assert_eq!(acceleration, forces.of(meldscope::sim::Cause::Attraction).get(vertex));
            assert_eq!(&row[5], ["b", "a"][body]);
            found += 1;
        }
    }
    // vertices at rest have no row
    assert_eq!((found, sums.len()), (42, 42));
    assert!(sums.values().all(|[causes, net]| causes.distance(*net) < 1e-9));
}

#[test]
fn a_step_is_explained() {
    let dir = Dir::new();
    let explain = |options: &[&str]| run(&dir, &[&["explain"], options].concat());
    let text = explain(&["two", "--step", "150"]).succeeded().out;
    for part in [
        "two, step 150 of 300, t = 2.500000 s",
        "pair a~b: merged since t = 1.397447 s (step 84: merge, q = 1.050000)",
        "split at 1.2: q is 0.1992 below",
        "next: split at t = 3.314918 s (step 199)",
        "Attraction",
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }
    // a thin recording is simulated again
    run(&dir, &["run", "two", "--thin", "--save", "thin.rrd", "--quiet"]).succeeded();
    assert_eq!(explain(&["thin.rrd", "--step", "150"]).succeeded().out, text);
    let vertex = explain(&["two", "--step", "150", "--vertex", "a:167"]).succeeded().out;
    assert!(vertex.contains("in the influence sphere of b") && !vertex.contains("pair"), "{vertex}");
    let pair = explain(&["two", "--step", "0", "--pair", "b~a"]).succeeded().out;
    assert!(pair.contains("pair a~b: apart since the start") && pair.contains("next: merge"), "{pair}");
    let far = explain(&["two", "--step", "0"]).succeeded().out;
    assert!(far.ends_with("no pair is within reach: name one, such as --pair a~b\n"), "{far}");
    for (options, part) in [
        (&["two", "--step", "301"][..], "--step 301 is beyond the last step of two, 300"),
        (&["two", "--step", "1", "--body", "c"], "--body: there is no body \"c\""),
        (&["two", "--step", "1", "--vertex", "a:266"], "body \"a\" has vertices 0 to 265"),
        (&["two", "--step", "1", "--vertex", "a"], "expected BODY:INDEX"),
        (&["two", "--step", "1", "--pair", "a~a"], "expected two bodies"),
    ] {
        let error = explain(options).failed(2);
        assert!(error.contains(part), "{part}: {error}");
    }
}

#[test]
fn exported_states_match_the_world_bit_by_bit() {
    use meldscope::sdk::arrow::array::{AsArray as _, Float64Array};
    use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;

    let dir = Dir::new();
    // two bodies that merge, and a rotating one
    for scene in ["two", "orbit"] {
        let range = ["--from", "90", "--to", "92", "--every", "2"];
        for format in ["csv", "json", "parquet"] {
            let name = format!("{scene}.{format}");
            run(&dir, &[&["export", scene, "--states", &name][..], &range].concat()).succeeded();
        }
        let mut world = World::new(Scene::builtin(scene).expect("a scene")).expect("enough memory");
        let mut expected = Vec::new();
        for step in 1..=92 {
            let _ = world.step();
            for body in world.bodies().filter(|_| step == 90 || step == 92) {
                expected.extend((0..body.vertex_count()).map(|i| {
                    let vectors = [body.position(i), body.displacement(i), body.velocity(i)];
                    (step, body.name().to_owned(), i as u64, vectors.map(|v| v.to_array().map(f64::to_bits)))
                }));
            }
        }
        let at = |name: String| dir.path().join(name);

        let mut rows = Vec::new();
        let mut reader = csv::Reader::from_path(at(format!("{scene}.csv"))).expect("a table");
        for row in reader.records().map(|row| row.expect("a row")) {
            let number = |i: usize| row[4 + i].parse::<f64>().expect("a number").to_bits();
            let vectors = [0, 3, 6].map(|first| [0, 1, 2].map(|axis| number(first + axis)));
            rows.push((row[0].parse().expect("a step"), row[2].to_owned(), row[3].parse().expect("a vertex"), vectors));
        }
        // positions of a rotating body agree up to the last bits
        let is_same = |found: &[u64; 3], wanted: &[u64; 3]| {
            let close = |(&x, &y): (&u64, &u64)| (f64::from_bits(x) - f64::from_bits(y)).abs() < 1e-14;
            found == wanted || (scene == "orbit" && found.iter().zip(wanted).all(close))
        };
        assert_eq!(rows.len(), expected.len());
        for (found, wanted) in rows.iter().zip(&expected) {
            assert_eq!(
                (&found.0, &found.1, &found.2, &found.3[1..]),
                (&wanted.0, &wanted.1, &wanted.2, &wanted.3[1..])
            );
            assert!(is_same(&found.3[0], &wanted.3[0]), "{found:?}, {wanted:?}");
        }

        let file = fs::File::open(at(format!("{scene}.parquet"))).expect("a table");
        let reader = ParquetRecordBatchReaderBuilder::try_new(file).expect("a Parquet file").build();
        let mut next = rows.iter();
        for batch in reader.expect("a reader") {
            let batch = batch.expect("rows");
            let columns: Vec<&Float64Array> = (4..13).map(|i| batch.column(i).as_primitive()).collect();
            for i in 0..batch.num_rows() {
                let found: Vec<u64> = columns.iter().map(|column| column.value(i).to_bits()).collect();
                let (_, name, _, vectors) = next.next().expect("as many rows");
                assert_eq!(
                    (batch.column(2).as_string::<i32>().value(i), &found[..]),
                    (&**name, vectors.as_flattened())
                );
            }
        }
        assert!(next.next().is_none());
        let json = fs::read_to_string(at(format!("{scene}.json"))).expect("a table");
        assert_eq!(json.matches("\"step\":").count(), rows.len());
    }
}

// ---- display -------------------------------------------------------------------------------------------------------

#[test]
fn selected_pairs_and_events_survive_a_replay() {
    let dir = Dir::new();
    for (arguments, expected) in [
        (["--pair", "a~x"], "--pair: no body \"x\""),
        (["--pair", "a"], "\"a\" is not a pair"),
        (["--pair", "a~a"], "\"a~a\" is a single body"),
        (["--around", "merg a~b"], "no event \"merg\"; did you mean \"merge\"?"),
        (["--around", "merge a~d"], "--around: no body \"d\""),
        (["--around", ""], "name an event"),
    ] {
        let error = run(&dir, &[&["run", "three", "--save", "x.rrd"][..], &arguments].concat()).failed(2);
        assert!(error.contains(expected), "{error}");
        assert!(dir.names().is_empty());
    }

    let shown = ["--pair", "c~a", "--around", "split a~c", "--steps", "200", "--every", "10"];
    run(&dir, &[&["run", "three", "--save", "x.rrd"][..], &shown].concat()).succeeded();
    let recording = Recording::open(&dir.file("x.rrd"));
    let pairs = |recording: &Recording| -> Vec<String> {
        let entities = recording.entities().into_iter().map(|entity| entity.to_string());
        entities
            .filter(|entity| entity.starts_with("/pairs/") && entity.ends_with("/distance"))
            .map(|entity| entity.replace('\\', ""))
            .collect()
    };
    assert_eq!(pairs(&recording), ["/pairs/a~c/distance"]);
    let settings = recording.property("settings");
    assert!(settings.contains("only = [\"a~c\"]"), "{settings}");
    assert!(settings.contains("around = { kind = \"split\", pair = \"a~c\", number = 1 }"), "{settings}");
    run(&dir, &["replay", "x.rrd", "--save", "y.rrd", "--to", "100"]).succeeded();
    let again = Recording::open(&dir.file("y.rrd"));
    assert_eq!(pairs(&again), pairs(&recording));
    assert_eq!(again.property("settings").matches("a~c").count(), 2);

    run(&dir, &["run", "two", "--save", "z.rrd", "--around", "1", "--every", "10"]).succeeded();
    let ran = run(&dir, &["run", "two", "--save", "z.rrd", "--around", "merge 7", "--every", "10"]);
    assert_eq!(ran.status, 0);
    assert!(ran.err.contains("there was no merge 7, only 1 event of that kind"), "{}", ran.err);
}

#[test]
fn a_flight_recorder_writes_frames_after_its_trigger() {
    let dir = Dir::new();
    let keep = ["--keep", "3+5", "--on", "merge"];
    run(&dir, &[&["run", "two", "--save", "x.rrd"][..], &keep].concat()).succeeded();
    let recording = Recording::open(&dir.file("x.rrd"));
    let frames = recording.changes("/timings/log").iter().map(|row| row.step).collect::<Vec<_>>();
    let merge = recording.changes("/events")[0].step; // the step at whose end it has happened
    // lines end where the frame after the window is dropped
    assert_eq!(frames, (merge - 2..=merge + 6).collect::<Vec<_>>());
    run(&dir, &["replay", "x.rrd"]).succeeded();
    // more frames after an event than are kept, another event among them, and the end of the run before the last of them
    let kept = |keep: &str, on: &str, more: &[&str]| {
        run(&dir, &[&["run", "two", "--save", "x.rrd", "--keep", keep, "--on", on][..], more].concat()).succeeded();
        let recording = Recording::open(&dir.file("x.rrd"));
        let frames = recording.changes("/timings/speed").iter().map(|row| row.step).collect::<Vec<_>>();
        run(&dir, &["replay", "x.rrd"]).succeeded();
        frames.into_iter().filter(|step| *step > 0).collect::<Vec<_>>()
    };
    let is_in = |frames: &[i64], range: std::ops::RangeInclusive<i64>| range.clone().all(|step| frames.contains(&step));
    assert!(is_in(&kept("2+40", "merge", &[]), 83..=124));
    assert!(is_in(&kept("5+120", "merge,split", &[]), 80..=300));
    assert!(is_in(&kept("30+50", "merge", &["--steps", "100"]), 55..=100));
    // of two windows, the panel says where there is nothing; the names of a group end with each window and with the group
    run(&dir, &["run", "two", "--save", "x.rrd", "--keep", "3", "--on", "merge,split"]).succeeded();
    let recording = Recording::open(&dir.file("x.rrd"));
    let about = recording.fixed("/about").text("TextDocument:text");
    assert!(about.starts_with("**Frames: only of steps 82 to 84, 197 to 199.**"), "{about}");
    let gaps = recording.changes("/world/not_recorded");
    let gaps: Vec<(i64, String)> = gaps.iter().map(|row| (row.step, row.texts("Points3D:labels").concat())).collect();
    let gap = |from: i64, to: i64| (from, format!("no frames of steps {from} to {to}"));
    let none = |step: i64| (step, String::new());
    assert_eq!(gaps, [gap(0, 81), none(82), gap(85, 196), none(197), gap(200, 300)]);
    let listed = |step: u64| recording.held("/ranking/forces", [step])[0].texts("Points2D:labels")[0].clone();
    assert_eq!(
        [0, 81, 85, 196].map(listed),
        [(0, 81), (0, 81), (85, 196), (85, 196)].map(|(from, to)| gap(from, to).1)
    );
    assert!([82, 84, 197, 199].map(listed).iter().all(|row| row.starts_with("a: ") || row.starts_with("b: ")));
    let groups: Vec<Vec<String>> = recording.changes("/groups/a").iter().map(|row| row.texts("bodies")).collect();
    let joined = vec!["a".to_owned(), "b".to_owned()];
    assert_eq!(groups, [joined.clone(), vec![], joined, vec![], vec![]]);
    let error = run(&dir, &["run", "two", "--keep", "3+5"]).failed(2);
    assert!(error.contains("--on"), "{error}");
}

/// Where the layout leaves out lines of q, the events of the pairs that it draws are marked, and no others.
#[test]
fn events_are_marked_on_the_lines_of_a_crowd() {
    let dir = Dir::new();
    run(&dir, &["run", "crowd", "--save", "x.rrd"]).succeeded();
    let recording = Recording::open(&dir.file("x.rrd"));
    let events = recording.rows(&"/events".into());
    let events: Vec<(String, i64, f64)> = events
        .iter()
        .map(|(_, row)| {
            (
                row.text("TextLog:level").replace(' ', "_"),
                row.time,
                row.get::<meldscope::sdk::datatypes::Float64>("q")[0].0,
            )
        })
        .collect();
    let mut marks = 0;
    for entity in recording.entities() {
        let Some(kind) = entity.to_string().strip_prefix("/marks/drawn/").map(str::to_owned) else { continue };
        if kind == "near_miss" {
            continue;
        }
        for (_, row) in recording.rows(&entity) {
            assert!(events.contains(&(kind.clone(), row.time, row.scalar().expect("a number"))), "{kind} {}", row.time);
            marks += 1;
        }
    }
    assert!(0 < marks && marks < events.len(), "{marks} marks of {} events", events.len());
}

/// The size of a file is within a fifth of the projection.
#[test]
fn the_size_of_a_recording_is_predicted() {
    use meldscope::stream::size;
    let dir = Dir::new();
    for scene in ["two", "three", "crowd", "mesh"] {
        let file = format!("{scene}.rrd");
        let ran = run(&dir, &["run", scene, "--save", &file, "--every", "2"]);
        let scene = Scene::builtin(scene).expect("a scene");
        ran.warned_of(&scene.warnings());
        let real = size(&dir.file(&file)) as f64;
        let settings = Settings { every: 2, ..Settings::of(&scene) };
        let projected = size::project(&scene, &settings, 0).expect("a size");
        let ratio = projected.bytes as f64 / real;
        assert!((0.8..1.2).contains(&ratio), "{}: {ratio}", scene.name);
        // scenes that are small by their number of vertices are not simulated
        assert_eq!(size::project(&scene, &settings, u64::MAX), None);
    }
}

/// Unless requested, a recording is not large: it has as many frames as fit, the same ones in every run.
#[test]
fn a_long_run_is_recorded_with_fewer_frames() {
    use meldscope::stream::size;
    let scene = Scene::builtin("two").expect("a scene");
    let settings = Settings { steps: Some(1_000_000), ..Settings::of(&scene) };
    let [projected, again] = [(); 2].map(|()| size::project(&scene, &settings, size::LARGE).expect("a size"));
    assert_eq!(projected, again);
    let every = projected.every(&settings);
    assert!(projected.bytes > size::LARGE && projected.bytes / every <= size::LARGE, "{projected:?}");
    // with a margin of one half, because only the beginning is known
    assert!(3 * projected.bytes / 2 / (every - 1) >= size::LARGE, "{projected:?}");
}

#[test]
fn a_thin_recording_shows_its_events_and_the_next_command() {
    let dir = Dir::new();
    run(&dir, &["run", "two", "--thin", "--save", "x.rrd"]).succeeded();
    let recording = Recording::open(&dir.file("x.rrd"));
    let events: Vec<String> =
        recording.rows(&EntityPath::from("/events")).iter().map(|(_, row)| row.text("TextLog:level")).collect();
    assert_eq!(events, ["merge", "touch", "split", "part"]);
    let about = recording.fixed("/about").text("TextDocument:text");
    assert!(about.contains("meldscope replay F.rrd --save full.rrd"), "{about}");
}

/// The initial state of 1,500 bodies in one place takes many seconds to record, and a step takes longer.
#[cfg(unix)]
#[test]
fn a_scene_that_takes_long_is_announced_and_can_be_interrupted() {
    let dir = Dir::new();
    let text = "duration = 1\n[[grid]]\nname = \"a\"\nradius = 1\ncount = [1500, 1, 1]\nspacing = [0, 0, 0]\n\
                motion = { fixed = [0, 0, 0] }\n";
    fs::write(dir.file("heap.toml"), text).expect("disk space");
    for options in [&["--thin"][..], &[]] {
        let mut running = Running::start(&dir, &[&["run", "heap.toml", "--save", "x.rrd"], options].concat());
        running.wait_for_line("note: about 1,124,250 pairs of bodies are within reach of each other at the start");
        running.eventually(|| dir.file("x.rrd.partial").exists());
        std::thread::sleep(Duration::from_secs(2));
        let start = Instant::now();
        running.signal("INT");
        let ran = running.end();
        assert_eq!(ran.status, 130, "{}", ran.err);
        assert!(start.elapsed() < Duration::from_secs(4), "{options:?}: {:?}", start.elapsed());
        assert!(!dir.file("x.rrd.partial").exists());
        fs::remove_file(dir.file("x.rrd")).ok();
    }
}

/// A reader of standard output that goes away ends the run, and leaves a file with the steps up to there.
#[cfg(unix)]
#[test]
fn a_lost_reader_leaves_the_file_complete() {
    let dir = Dir::new();
    let mut child = meldscope(&dir, ["run", "two", "--stdout", "--save", "two.rrd", "-q"]).spawn().unwrap();
    let mut head = vec![0; 1_500_000]; // with some frames
    child.stdout.take().unwrap().read_exact(&mut head).unwrap();
    let ran = Ran::new(child.wait_with_output().unwrap());
    assert!(ran.status == 1 && ran.err.contains("cannot write the recording to standard output"), "{ran:?}");
    let replayed = run(&dir, &["replay", "two.rrd"]);
    assert!(replayed.status == 0 && replayed.out.contains("identical"), "{replayed:?}");
}

#[test]
fn a_replay_may_have_another_duration() {
    let dir = Dir::new();
    run(&dir, &["run", "two", "--thin", "--save", "two.rrd"]);
    for (duration, steps) in [("1", "60 steps"), ("6", "360 steps")] {
        let ran = run(&dir, &["replay", "two.rrd", "--set", &format!("duration={duration}")]);
        assert!(ran.status == 0 && ran.out.contains(steps), "{ran:?}");
    }
}

/// A shape too large for the machine is refused before it is built, whatever the command and the model.
#[test]
fn shapes_that_do_not_fit_are_refused() {
    let dir = scene_dir();
    let shape =
        "radius = 1.0\nshape = { sphere = { stacks = 65535, slices = 65535 } }\nmotion = { fixed = [0, 0, 0] }\n";
    fs::write(dir.file("large.toml"), format!("duration = 0.05\n[[body]]\nname = \"a\"\n{shape}")).expect("disk space");
    for arguments in [
        &["live", "large.toml", "--bind", "127.0.0.1:0"][..],
        &["check", "large.toml", "--bless", "a test"],
        &["bench", "models", "large.toml"],
        &["run", "large.toml", "--model", "metaballs"],
        &["run", "large.toml", "--model", "lattice"],
        &["export", "large.toml", "--set", "model=fem", "--events", "e.csv"],
    ] {
        let error = run(&dir, arguments).failed(2);
        assert!(error.contains("too large for this machine") && error.contains("stacks"), "{arguments:?}: {error}");
    }
}
