//! A program with experiments of its own, which `meldscope::cli::run` gives the commands of `meldscope`.

use std::{
    fs,
    process::{Command, ExitCode, Stdio},
    sync::Arc,
};

use meldscope::{
    Scene, cli,
    observe::{Experiment, Run},
    stream::{self, Settings, sinks::Destinations},
    sweep::{
        Sweep,
        row::{Cell, columns},
        table,
    },
};

use crate::{
    octahedra::Octahedra,
    recording::{Dir, Recording},
    rigid::Boxes,
};

/// Names the command line of [`program`], whose arguments are separated by this.
const LINE: &str = "OWN_PROGRAM";
const SEPARATOR: char = '\u{1f}';

fn experiment(name: &str) -> Result<Arc<dyn Experiment>, String> {
    match name {
        "octahedra" => Ok(Arc::new(Octahedra::two(3.0))),
        "boxes" => Ok(Arc::new(Boxes { count: 4, stiffness: 4000.0 })),
        "alias" => Ok(Arc::new(Octahedra::two(5.0))),
        _ => Err("there are octahedra, boxes and alias".to_owned()),
    }
}

/// The program, when the tests below run it.
#[test]
fn program() {
    let Ok(line) = std::env::var(LINE) else { return };
    let args = std::iter::once("/bin/own").chain(line.split(SEPARATOR).filter(|argument| !argument.is_empty()));
    let status = cli::run(args, experiment);
    let number = (0..=u8::MAX).find(|&number| ExitCode::from(number) == status);
    std::process::exit(number.expect("a status").into()) // before the harness prints anything
}

/// Exit status, results and messages of the program.
fn own(dir: &Dir, arguments: &[&str]) -> (i32, String, String) {
    let mut command = Command::new(std::env::current_exe().expect("a test"));
    command.args(["own_program::program", "--exact", "--nocapture", "--test-threads=1"]);
    command.env(LINE, arguments.join(&SEPARATOR.to_string())).current_dir(dir.path()).stdin(Stdio::null());
    let output = command.output().expect("the program starts");
    let [out, err] = [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes).into_owned());
    assert!(!err.contains("panicked"), "{err}");
    let before = "running 1 test\ntest own_program::program ... ";
    let out = out.trim_start().strip_prefix(before).expect("the harness").to_owned();
    (output.status.code().expect("no signal"), out, err)
}

fn succeeded(dir: &Dir, arguments: &[&str]) -> String {
    let (status, out, err) = own(dir, arguments);
    assert_eq!((status, err.as_str()), (0, ""), "{out}");
    out
}

fn failed(dir: &Dir, status: i32, arguments: &[&str]) -> String {
    let (found, out, err) = own(dir, arguments);
    assert_eq!(found, status, "{out}{err}");
    err
}

#[test]
fn an_own_program_runs_replays_and_compares_its_experiments() {
    let dir = Dir::new();
    let out = succeeded(&dir, &["run", "octahedra"]);
    assert!(out.contains("octahedra: 2 bodies") && out.contains("saved octahedra.rrd: 101 frames"), "{out}");
    assert!(out.contains("grip a~b at t = ") && out.contains("`own run … --serve`"), "{out}");
    assert!(succeeded(&dir, &["replay", "octahedra.rrd"]).contains("octahedra.rrd: identical, 100 steps"));
    // the name that finds it is the recorded one, whatever the file is called
    fs::rename(dir.path().join("octahedra.rrd"), dir.path().join("x.rrd")).expect("a file");
    assert!(succeeded(&dir, &["replay", "x.rrd"]).contains("identical"));

    succeeded(&dir, &["run", "octahedra", "--set", "pull=3.5", "--save", "y.rrd"]);
    assert!(succeeded(&dir, &["replay", "y.rrd"]).contains("identical"));
    let (status, out, err) = own(&dir, &["diff", "x.rrd", "y.rrd"]);
    assert!(status == 1 && out.contains("radii") && err == "error: x.rrd and y.rrd differ\n", "{out}{err}");
    assert!(!out.contains("with ,") && !out.contains("0.000/s"), "{out}");
    succeeded(&dir, &["run", "octahedra", "--thin", "--save", "thin.rrd"]);
    let about = Recording::open(&dir.path().join("thin.rrd")).fixed("/about").text("TextDocument:text");
    assert!(about.contains("`own replay F.rrd`") && !about.contains("meldscope"), "{about}");
    assert!(succeeded(&dir, &["diff", "x.rrd", "thin.rrd"]).contains("recorded without surfaces"));
    let out = succeeded(&dir, &["replay", "x.rrd", "--set", "pull=3.5"]);
    assert!(out.contains("not verified") && out.contains("phase changes, 2 recorded"), "{out}");

    let out = succeeded(&dir, &["explain", "x.rrd", "--step", "50", "--vertex", "a:0"]);
    assert!(out.contains("Grip") || out.contains("grip"), "{out}");
    succeeded(&dir, &["export", "octahedra", "--scalars", "s.csv", "--pairs", "p.csv", "--bodies", "b.csv"]);
    let table = |name: &str| fs::read_to_string(dir.path().join(name)).expect("a table");
    assert!(table("s.csv").starts_with("step,time,stretch,projections\n"));
    let bodies = table("b.csv");
    assert!(bodies.starts_with("step,time,body,x,y,z,max_displacement,corner_speed\n0,0.0,a,"), "{bodies}");
    assert_eq!(bodies.lines().count(), 1 + 2 * 101);
    succeeded(&dir, &["export", "boxes", "--forces", "f.csv"]);
    let forces = table("f.csv");
    assert!(forces.contains(",,boxes,box") && forces.contains(",,floor,,"), "{}", forces.len());
    succeeded(&dir, &["export", "boxes", "--bodies", "boxes.csv", "--mesh", "meshes", "--every", "599"]);
    // of four boxes, one is there at first, and one has gone at the end
    assert_eq!(table("boxes.csv").lines().count(), 1 + 1 + 3);
    let out = succeeded(&dir, &["explain", "boxes", "--step", "599", "--body", "box0", "--body", "box2"]);
    assert!(out.contains("it is absent") && out.contains("Floor"), "{out}");
    // the grip holds in one phase only
    let pairs = table("p.csv");
    assert!(pairs.starts_with("step,time,a,b,q,phase,gap,overlap,neck,hold\n"), "{pairs}");
    let holds = |line: &&str| line.contains(",gripped,") != line.ends_with(',');
    assert_eq!(pairs.lines().skip(1).filter(holds).count(), 101, "{pairs}");
}

#[test]
fn an_own_program_checks_its_golden_recordings() {
    let dir = Dir::new();
    let missing = failed(&dir, 1, &["check", "octahedra.rrd"]);
    assert!(missing.contains("1 of 1"), "{missing}");
    succeeded(&dir, &["check", "--bless", "a test", "octahedra.rrd"]);
    let golden = failed(&dir, 2, &["run", "octahedra"]);
    assert!(golden.contains("which only `own check --bless REASON` replaces"), "{golden}");
    let out = succeeded(&dir, &["check", "."]);
    assert!(out.contains("octahedra: identical, 100 steps, 2 events"), "{out}");
    succeeded(&dir, &["run", "octahedra", "--set", "pull=3.5", "--save", "other.rrd"]);
    let unknown = failed(&dir, 2, &["check", "other.rrd"]);
    assert!(unknown.contains("no experiment \"other\": there are octahedra, boxes and alias"), "{unknown}");
}

#[test]
fn an_own_program_sweeps_over_parameters() {
    let (dir, sweep) = (Dir::new(), "scene = \"octahedra\"\n[[axis]]\nkey = \"pull\"\nfrom = 0\nto = 4\ncount = 5\n");
    fs::write(dir.file("s.toml"), sweep).expect("disk space");
    let out = succeeded(&dir, &["sweep", "s.toml", "--out", "rows"]);
    assert!(out.contains("s.toml: 5 runs; 500 steps") && out.contains("outcomes: grip slip 5"), "{out}");
    assert!(succeeded(&dir, &["sweep", "s.toml", "--out", "rows"]).contains("5 runs"));
    let rows = dir.file("rows/rows-00-0of1-000000.parquet");
    let mut checksums = std::collections::HashSet::new();
    let columns = columns(&Sweep::load_own(&dir.file("s.toml"), &experiment).expect("a sweep"));
    let names: Vec<&str> = columns.iter().map(|column| &*column.name).collect();
    assert_eq!(names[..5], ["row", "pull", "outcome", "events", "event_times"]);
    assert_eq!(names[8..], ["checksum", "final_stretch", "failure", "run_time"]);
    table::read(&rows, &columns, |(row, cells)| {
        assert_eq!((&cells[0], &cells[1]), (&Cell::Float(row as f64), &Cell::Text("grip slip".to_owned())));
        assert_eq!(cells[1], cells[2]);
        let Cell::Count(checksum) = cells[7] else { panic!("{cells:?}") };
        checksums.insert(checksum);
    })
    .expect("rows");
    assert_eq!(checksums.len(), 5);

    for (from, to, expected) in [
        ("pull", "pul", "there is no parameter \"pul\""),
        ("octahedra", "cube", "there is no experiment \"cube\": there are octahedra, boxes and alias"),
        ("from = 0", "from = -1", "pull = -1 makes"),
        ("[[axis]]", "color = \"closest\"\n[[axis]]", "only for scenes"),
    ] {
        fs::write(dir.file("bad.toml"), sweep.replacen(from, to, 1)).expect("disk space");
        let error = failed(&dir, 2, &["sweep", "bad.toml", "--out", "other"]);
        assert!(error.contains(expected) && error.contains("bad.toml:"), "{error}");
    }
    let error = failed(&dir, 2, &["sweep", "s.toml", "--out", "rows", "--open", "1"]);
    assert!(error.contains("--open is for scenes: record a run with `own run octahedra --set KEY=VALUE`"), "{error}");
}

/// Its outcomes are the kinds of events, which refine the grid, are drawn, and have thresholds.
#[test]
fn an_own_program_maps_its_outcomes() {
    let (dir, axis) = (Dir::new(), "[[axis]]\nkey = \"stiffness\"\nfrom = 3500\nto = 6500\ncount = 4\n");
    fs::write(dir.file("s.toml"), format!("scene = \"boxes\"\n{axis}")).expect("disk space");
    let out = succeeded(&dir, &["sweep", "s.toml", "--out", "rows", "--refine", "2", "--bisect", "stiffness"]);
    // the fourth box touches the second one unless the contacts are of a middling stiffness
    let (rare, often) =
        ("touch part touch touch part part touch part", "touch part touch touch part part touch part touch part");
    let change = out.lines().find_map(|line| line.strip_prefix(&format!("{often} changes to {rare} at stiffness = ")));
    let threshold: f64 = change.unwrap_or_else(|| panic!("{out}")).parse().expect("a number");
    assert!((3500.0..4500.0).contains(&threshold), "{threshold}");
    for (stiffness, expected) in [(threshold - 1e-3, often), (threshold + 1e-3, rare)] {
        let boxes = Boxes { count: 4, stiffness };
        let mut run = Run::new(boxes.start().expect("it starts"), Some(600));
        let mut events = Vec::new();
        while run.step() {
            events.extend(run.summary.events.iter().map(|event| event.name));
        }
        assert_eq!(events.join(" "), expected, "{stiffness}");
    }
    assert!(out.contains("outcomes: ") && out.contains("map: "), "{out}");
    let map = fs::read_to_string(dir.path().join("rows/map.svg")).expect("a map");
    assert!(map.contains("experiment boxes") && map.contains(&format!(">{rare}<")), "{map}");
}

#[test]
fn an_own_program_says_what_is_wrong() {
    let dir = Dir::new();
    for (arguments, expected) in [
        (&["run", "cube"][..], "no experiment \"cube\": there are octahedra, boxes and alias"),
        (
            &["run", "octahedra", "--set", "pul=3"],
            "no parameter \"pul\"; did you mean \"pull\"? (its parameters are pull)",
        ),
        (&["run", "octahedra", "--set", "pull=much"], "expected a number"),
        (&["run", "octahedra", "--set", "pull=-1"], "--set: pull: expected 0 or more"),
        (&["run", "octahedra", "--integrator", "rk4"], "--integrator is for scenes"),
        (&["run", "octahedra", "--watch", "--serve"], "--watch is for scene files"),
        (&["scenes"], "unrecognized subcommand"),
        (&["replay", "none.rrd"], "none.rrd"),
    ] {
        let error = failed(&dir, 2, arguments);
        assert!(error.contains(expected), "{arguments:?}: {error}");
    }
    let help = succeeded(&dir, &["--help"]);
    assert!(help.contains("Usage: own") && !help.contains("scene") && !help.contains("meldscope"), "{help}");
    let help = succeeded(&dir, &["run", "--help"]);
    for unknown in ["the scene", "a scene", "--integrator", "--watch", "merge", "influence"] {
        assert!(!help.contains(unknown), "{unknown}: {help}");
    }
    assert_eq!(fs::read_dir(dir.path()).expect("a folder").count(), 0);

    // a recording of a program that knows other experiments
    let settings = Settings::of(&Scene::builtin("two").expect("built in"));
    let destinations = Destinations { save: Some(dir.path().join("two.rrd")), ..Destinations::default() };
    stream::record(&Scene::builtin("two").expect("built in"), settings, &destinations).expect("a recording");
    let error = failed(&dir, 2, &["replay", "two.rrd"]);
    assert!(error.contains("no experiment \"two\": there are octahedra, boxes and alias"), "{error}");
}
