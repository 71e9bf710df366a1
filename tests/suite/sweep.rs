//! Sweeps: rejected files, rows that do not depend on shards and interruptions, thresholds, maps.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    io::Write as _,
    path::Path,
    process::{Command, Output, Stdio},
    sync::Barrier,
    time::Duration,
};

use meldscope::{
    Scene,
    sweep::{
        Sweep,
        row::{Cell, RUN_TIME, columns},
        run::Runner,
        store::{Shard, Store},
        table,
    },
    table::{Column, Kind},
};

use crate::recording::Dir;

/// Two bodies that do not act on each other, on straight lines that pass at a distance of `offset`.
const PASSING: &str = "duration = 4.0\ndt = 0.05\n[influence]\nalpha = 0\nbeta = 0\n\
                       [[body]]\nname = 'a'\nradius = 1.0\nshape = { sphere = { stacks = 3, slices = 4 } }\n\
                       motion = { fixed = [0, 0, 0] }\n\
                       [[body]]\nname = 'b'\nradius = 1.0\nshape = { sphere = { stacks = 3, slices = 4 } }\n\
                       motion = { line = { from = [-4.0, 2.0, 0], velocity = [2.0, 0, 0] } }\n";
const OVER_OFFSETS: &str = "scene = 'passing.toml'\n\
                            [[axis]]\nkey = 'body.b.motion.line.from[1]'\nfrom = 1.5\nto = 2.5\ncount = 9\n\
                            [[axis]]\nkey = 'influence.merge_at'\nfrom = 0.9\nto = 1.1\ncount = 9\n";

fn folder(sweep: &str) -> Dir {
    let dir = Dir::new();
    fs::write(dir.file("passing.toml"), PASSING).unwrap();
    fs::write(dir.file("s.toml"), sweep).unwrap();
    dir
}

fn program(dir: &Dir, arguments: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_meldscope"));
    command.arg("sweep").args(arguments.split_whitespace()).current_dir(dir.path()).stdin(Stdio::null());
    command
}

fn run(dir: &Dir, arguments: &str) -> (i32, String) {
    let Output { status, stdout, stderr } = program(dir, arguments).output().unwrap();
    let output = String::from_utf8_lossy(&stdout).into_owned() + &String::from_utf8_lossy(&stderr);
    (status.code().unwrap_or(-1), output)
}

fn succeeds(dir: &Dir, arguments: &str) -> String {
    let (status, output) = run(dir, arguments);
    assert_eq!(status, 0, "{arguments}: {output}");
    output
}

/// A number of a row without its run time.
fn number(columns: &[Column], cells: &[Cell], name: &str) -> f64 {
    let mut columns = columns.iter().filter(|column| column.name != RUN_TIME);
    let at = columns.position(|column| column.name == name).unwrap();
    // the row is no cell
    let Cell::Float(number) = cells[at - 1] else { panic!("{name}: {cells:?}") };
    number
}

/// All rows in a folder, without their run times.
fn rows(folder: &Path, columns: &[Column]) -> BTreeMap<u64, Vec<Cell>> {
    let columns: Vec<Column> = columns.iter().filter(|column| column.name != RUN_TIME).cloned().collect();
    let mut rows = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if name.starts_with("rows-") {
            let each = |(row, cells)| assert!(rows.insert(row, cells).is_none(), "row {row} twice");
            table::read(&path, &columns, each).unwrap();
        }
    }
    rows
}

fn of(dir: &Dir) -> Vec<Column> {
    columns(&Sweep::load(&dir.file("s.toml")).unwrap())
}

#[test]
fn broken_sweeps_are_rejected_with_their_position() {
    let axis = "[[axis]]\nkey = 'influence.alpha'\nfrom = 0\nto = 1\ncount = 3\n";
    let cases = [
        ("scene = 'two'\n", "s.toml:1:1: axis: missing, expected at least one [[axis]]"),
        (&format!("scene = 'tow'\n{axis}"), "s.toml:1:9: scene: there is no scene \"tow\"; did you mean \"two\"?"),
        (
            &format!("scene = 'two'\nsamples = 'grid'\n{axis}"),
            "s.toml:2:1: samples: unknown key; did you mean \"sample\"?",
        ),
        (&axis.replace("alpha", "alhpa"), "axis[0].key: influence.alhpa: unknown key; did you mean \"alpha\"?"),
        (
            &axis.replace("influence.alpha", "body.c.radius"),
            "s.toml:3:7: axis[0].key: body.c.radius: there is nothing named \"c\"",
        ),
        (
            &axis.replace("alpha", "merge_at"),
            "s.toml:4:8: axis[0].from: influence.merge_at = 0 makes the scene invalid: influence.merge_at: expected a number between",
        ),
        (
            &format!("{axis}[[axis]]\nkey = 'influence.merge_at'\nfrom = 1.5\nto = 1.1\ncount = 2\n"),
            "s.toml:9:8: axis[1].from: influence.merge_at = 1.5 makes the scene invalid: influence.split_at",
        ),
        (
            "[[axis]]\nkey = 'influence.merge_at'\nvalues = [1.0, 1.1, 1.3, 1.2]\n",
            "s.toml:4:10: axis[0].values: influence.merge_at = 1.3 makes the scene invalid: influence.split_at: expected a number of at least merge_at (1.3), found 1.2",
        ),
        (
            "[[axis]]\nkey = 'body.a.motion.fixed'\nvalues = [0.3]\n",
            "body.a.motion.fixed = 0.3 makes the scene invalid: body[\"a\"].motion.fixed: expected an array of 3 numbers [x, y, z], found 0.3",
        ),
        (
            "[[axis]]\nkey = 'influence.weight'\nvalues = ['linear', 'cubic']\n",
            "influence.weight = \"cubic\" makes the scene invalid: influence.weight: expected one of",
        ),
        (
            "[[axis]]\nkey = 'influence.alpha'\nfrom = 0\nto = 1\ncount = 3\nscale = 'log'\n",
            "axis[0].from: expected a number above 0 on a log scale, found 0.0",
        ),
        (
            "[[axis]]\nkey = 'influence.alpha'\nfrom = 0\nto = 1\ncount = 1000000\n[[axis]]\nkey = 'influence.beta'\nfrom = 0\nto = 1\ncount = 1000000\n",
            "axis[0].count: 1,000,000,000,000 runs are too many",
        ),
        (&format!("{axis}{axis}"), "axis[1].key: expected a key that no other axis has"),
        (
            &format!("{axis}[[set]]\nkey = 'influence.alpha'\nvalue = 4\n"),
            "set[0].key: expected a key that no [[axis]] has",
        ),
        (&axis.replace("count = 3", "count = 1"), "axis[0].count: expected an integer from 2 to 4294967295, found 1"),
        ("[[body]]\nname = 'a'\n", "s.toml is a scene, not a sweep; a sweep has scene = "),
        (
            &format!("[[set]]\nkey = 'dt'\nvalue = -1\n{axis}"),
            "s.toml:4:9: set[0].value: dt: expected a number between",
        ),
        (&format!("count = 4\n{axis}"), "s.toml:2:9: count: not for a grid"),
        (
            "[[axis]]\nkey = 'model'\nvalues = ['oscillators', 'lattice']\n",
            "s.toml:4:10: axis[0].values: model = \"lattice\" makes the scene invalid: ",
        ),
        (
            &format!("{axis}[jump]\nfirst_merg = 0.1\n"),
            "s.toml:8:1: jump.first_merg: unknown key; did you mean \"first_merge\"?",
        ),
        (
            &format!("{axis}[jump]\nmax_displacement = 0.1\n"),
            "s.toml:8:20: jump.max_displacement: max_displacement is not measured; add measures = [\"displacement\"]",
        ),
    ];
    let dir = folder("");
    for (text, expected) in cases {
        let text = if text.contains("scene =") { text.to_owned() } else { format!("scene = 'two'\n{text}") };
        fs::write(dir.file("s.toml"), &text).unwrap();
        let (status, output) = run(&dir, "s.toml --out out");
        assert_eq!(status, 2, "{text}\n{output}");
        assert!(output.contains(expected), "{text}\n{output}");
        assert!(!dir.file("out").exists(), "nothing is written");
    }
}

#[test]
fn a_boundary_in_closed_form_is_found_to_1e_9() {
    let dir = folder(OVER_OFFSETS);
    let output = succeeds(&dir, "s.toml --out out --bisect influence.merge_at");
    assert!(output.contains("81 runs"), "{output}");
    assert!(output.contains("a region smaller than a cell of the first grid may be missing"), "{output}");
    assert!(output.contains("two changes between neighbours of the same outcome are not found"), "{output}");
    let svg = fs::read_to_string(dir.file("out/map.svg")).unwrap();
    assert!(svg.contains("a region smaller than a cell of the first grid may be missing"), "{svg}");
    assert!(svg.contains("influence.merge_at") && svg.contains(">split<") && svg.contains(">apart<"), "{svg}");
    assert!(svg.contains("bisected to") && svg.contains("turned back."), "{svg}");
    let column = |name, kind| Column::required(name, kind, "");
    let columns = [
        column("row", Kind::Count),
        column("body.b.motion.line.from[1]", Kind::Float),
        column("threshold", Kind::Float),
        column("below", Kind::Text),
    ];
    let (mut found, mut all) = (0, 0);
    table::read(&dir.file("out/thresholds-1.parquet"), &columns, |(_, cells)| {
        all += 1;
        let [Cell::Float(offset), Cell::Float(threshold), Cell::Text(below)] = &cells[..] else { panic!("{cells:?}") };
        // the closest distance is the offset, and the sum of the radii is 2
        if below == "apart" {
            assert!((threshold - offset / 2.0).abs() < 1e-9, "{offset}: {threshold}");
            found += 1;
        }
    })
    .unwrap();
    assert!(found >= 3, "{found} offsets between 1.8 and 2.2");
    assert_eq!(svg.matches("a2.6 2.6 0 ").count(), 2 * (all + 1), "each threshold, and the legend: {svg}");
    // and the closest approaches of runs without a merge are the offsets
    for cells in rows(&dir.file("out"), &of(&dir)).values() {
        let [Cell::Float(offset), Cell::Float(merge_at), Cell::Text(outcome), ..] = &cells[..] else {
            panic!("{cells:?}")
        };
        assert_eq!(outcome == "apart", offset / 2.0 > *merge_at, "{cells:?}");
        if let (true, Cell::Float(closest)) = (outcome == "apart", &cells[11]) {
            assert!((closest - offset / 2.0).abs() < 1e-12, "{cells:?}");
        }
    }
}

/// Whether a run ends early or not, and however far the bodies move in a step.
#[test]
fn the_closest_approach_and_the_time_merged_are_exact() {
    for until in ["certain", "end"] {
        let dir = folder(&format!(
            "scene = 'passing.toml'\nuntil = '{until}'\n\
             [[axis]]\nkey = 'body.b.motion.line.velocity[0]'\nvalues = [1.1, 2.0, 30.0]\n\
             [[set]]\nkey = 'influence.merge_at'\nvalue = 1.05\n[[set]]\nkey = 'influence.split_at'\nvalue = 1.2\n"
        ));
        succeeds(&dir, "s.toml --out out");
        let columns = of(&dir);
        let rows = rows(&dir.file("out"), &columns);
        assert_eq!(rows.len(), 3);
        for cells in rows.values() {
            let number = |name: &str| number(&columns, cells, name);
            let speed = number("body.b.motion.line.velocity[0]");
            let from_middle = |q: f64| (4.0 * q * q - 4.0).sqrt() / speed;
            let split = 4.0 / speed + from_middle(1.2);
            let merged = f64::min(split, 4.0) - (4.0 / speed - from_middle(1.05));
            assert!((number("time_merged") - merged).abs() < 1e-12, "{until}, {speed}: {cells:?}");
            assert!((number("closest") - 1.0).abs() < 1e-12, "{until}, {speed}: {cells:?}");
            assert!((number("closest_time") - 4.0 / speed).abs() < 1e-7, "{until}, {speed}: {cells:?}");
        }
    }
}

/// b passes at q = 1 between two steps at whose ends it is out of reach, or swings to q = 1.05 and back within each step.
#[test]
fn the_closest_approach_is_found_within_a_step() {
    let dir = folder(
        "scene = 'passing.toml'\n[[axis]]\nkey = 'body.b.motion.line.velocity[0]'\nvalues = [150, 200, 250, 300, 350, 400]\n\
         [[set]]\nkey = 'duration'\nvalue = 0.4\n[[set]]\nkey = 'body.b.motion.line.from[0]'\nvalue = -10.5\n\
         [[set]]\nkey = 'influence.merge_at'\nvalue = 0.9\n",
    );
    let swinging = PASSING.replace("dt = 0.05", "dt = 0.1").replace(
        "line = { from = [-4.0, 2.0, 0], velocity = [2.0, 0, 0] }",
        "sine = { center = [2.4, 0, 0], amplitude = [0.3, 0, 0], frequency = 11.0, phase = 3.0 }",
    );
    fs::write(dir.file("swinging.toml"), swinging).unwrap();
    let over_phases = "scene = 'swinging.toml'\n[[axis]]\nkey = 'body.b.motion.sine.phase'\nfrom = 0.0\nto = 6.0\ncount = 13\n\
                       [[set]]\nkey = 'duration'\nvalue = 0.3\n[[set]]\nkey = 'influence.merge_at'\nvalue = 0.9\n";
    for (closest, count) in [(1.0, 6), (1.05, 13)] {
        succeeds(&dir, "s.toml --out out");
        let columns = of(&dir);
        let rows = rows(&dir.file("out"), &columns);
        assert_eq!(rows.len(), count);
        for cells in rows.values() {
            assert!((number(&columns, cells, "closest") - closest).abs() < 1e-9, "{cells:?}");
        }
        fs::remove_dir_all(dir.file("out")).unwrap();
        fs::write(dir.file("s.toml"), over_phases).unwrap();
    }
}

/// b swings to and fro 30 times in the first step: more changes than the surfaces are compared at.
#[test]
fn the_measures_of_surfaces_belong_to_their_events() {
    let dir =
        folder("scene = 'swinging.toml'\nmeasures = ['surfaces']\n[[axis]]\nkey = 'influence.alpha'\nvalues = [0.0]\n");
    let keys: Vec<String> =
        (0..60).map(|k| format!("[{}, {}, 0, 0]", f64::from(k) / 600.0, 2.4 - 0.5 * f64::from(k % 2))).collect();
    let path = format!(
        "keyframes = {{ interpolation = 'linear', keys = [{}, [0.15, 2.4, 0, 0], [0.25, 1.9, 0, 0]] }}",
        keys.join(", ")
    );
    let line = "line = { from = [-4.0, 2.0, 0], velocity = [2.0, 0, 0] }";
    let swinging = PASSING.replace("dt = 0.05", "dt = 0.1").replace("4.0\n", "0.3\n").replace(line, &path);
    fs::write(dir.file("swinging.toml"), swinging).unwrap();
    succeeds(&dir, "s.toml --out out");
    let columns = of(&dir);
    let rows = rows(&dir.file("out"), &columns);
    let list = |name: &str| {
        let mut columns = columns.iter().filter(|column| column.name != RUN_TIME);
        let at = columns.position(|column| column.name == name).unwrap();
        let Cell::List(list) = &rows[&0][at - 1] else { panic!("{name}") };
        list.clone()
    };
    let times = list("event_times");
    let of_step = times.iter().filter(|&&time| time < 0.1).count();
    assert!(of_step > 20 && times.len() > of_step, "{times:?}");
    for name in ["gaps", "overlaps", "necks"] {
        let is_known: Vec<bool> = list(name).iter().map(|value| value.is_finite()).collect();
        let expected: Vec<bool> = (0..times.len()).map(|k| k < 16 || k >= of_step).collect();
        assert_eq!(is_known, expected, "{name}");
    }
}

#[test]
fn shards_refinement_and_a_plain_run_have_the_same_rows() {
    let dir = folder(OVER_OFFSETS);
    let columns = of(&dir);
    succeeds(&dir, "s.toml --out plain --refine 3");
    let plain = rows(&dir.file("plain"), &columns);
    for level in 0.. {
        let output = succeeds(&dir, &format!("s.toml --out shards --refine 3 --shard 1/2 --level {level}"));
        if output.contains("complete, nothing is left to refine") {
            assert!(level >= 4, "{output}");
            break;
        }
        let (status, output) = run(&dir, &format!("s.toml --out shards --refine 3 --shard 0/2 --level {}", level + 1));
        assert_eq!(status, 2, "{output}");
        assert!(output.contains(&format!("level {level} is not complete")), "{output}");
        succeeds(&dir, &format!("s.toml --out shards --refine 3 --shard 0/2 --level {level} --threads 1"));
    }
    assert_eq!(rows(&dir.file("shards"), &columns), plain);
    succeeds(&dir, "s.toml --out shards --refine 3"); // finds nothing to do
    assert_eq!(rows(&dir.file("shards"), &columns), plain);

    // rows that two divisions have are counted once
    let outcomes = |output: &str| output.lines().find(|line| line.starts_with("outcomes: ")).map(str::to_owned);
    let before = succeeds(&dir, "s.toml --out plain --refine 3");
    let [one, two] =
        ["rows-00-0of1-000000.parquet", "rows-00-0of2-000000.parquet"].map(|name| dir.file("plain").join(name));
    std::fs::copy(one, &two).expect("its first rows");
    let after = succeeds(&dir, "s.toml --out plain --refine 3");
    assert!(outcomes(&before).is_some() && outcomes(&before) == outcomes(&after), "{before}\n{after}");
    std::fs::remove_file(two).expect("the copy");

    // every point of a grid as fine as the last level has the outcome of the refined map at that point
    let full = folder(&OVER_OFFSETS.replace("count = 9", "count = 65"));
    succeeds(&full, "s.toml --out out");
    let full = rows(&full.file("out"), &columns);
    assert_eq!(full.len(), 65 * 65);
    assert!(plain.len() < 65 * 65 / 4, "{} runs", plain.len());
    let by_point = |cells: &[Cell]| format!("{:?}", &cells[..2]);
    let known: BTreeMap<String, &Cell> = plain.values().map(|cells| (by_point(cells), &cells[2])).collect();
    let mut same = 0;
    for cells in full.values() {
        if let Some(outcome) = known.get(&by_point(cells)) {
            assert_eq!(*outcome, &cells[2], "{cells:?}");
            same += 1;
        }
    }
    assert_eq!(same, plain.len());
}

#[test]
fn a_jump_of_a_measure_refines_like_a_boundary() {
    // The closest approach is half the offset. It differs by 1/16 between neighbours of the first grid, and by less
    // than 1/100 from the third level on. The last two levels add a point each only where the outcome changes (at 1.553
    // and 2.1), or where reach ends and there is no approach (at 2.414); the three points out of reach between 2.4375
    // and 2.5 are skipped.
    let text = "scene = 'passing.toml'\n[jump]\nclosest = 0.01\n\
                [[axis]]\nkey = 'body.b.motion.line.from[1]'\nfrom = 1.5\nto = 2.5\ncount = 9\n";
    let dir = folder(text);
    let output = succeeds(&dir, "s.toml --out out --refine 5");
    assert_eq!(rows(&dir.file("out"), &of(&dir)).len(), 8 * 8 + 1 + 3 * 2 - 3, "{output}");
}

#[test]
fn a_killed_sweep_resumes_where_it_stopped() {
    let text = "scene = 'two'\n[[axis]]\nkey = 'influence.alpha'\nfrom = 0\nto = 300\ncount = 120\n";
    let dir = folder(text);
    let columns = of(&dir);
    succeeds(&dir, "s.toml --out plain");
    let plain = rows(&dir.file("plain"), &columns);
    assert_eq!(plain.len(), 120);
    let mut journals = Vec::new();
    for number in 0..6 {
        let mut child =
            program(&dir, "s.toml --out out --threads 1").stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        std::thread::sleep(Duration::from_millis(40 + 15 * number));
        child.kill().unwrap();
        child.wait().unwrap();
        let entries = fs::read_dir(dir.file("out")).into_iter().flatten().map(|entry| entry.unwrap());
        let names = entries.map(|entry| entry.file_name().into_string().unwrap());
        journals.extend(names.filter(|name| name.ends_with(".journal")));
    }
    succeeds(&dir, "s.toml --out out");
    assert_eq!(rows(&dir.file("out"), &columns), plain);
    // a run that was killed after its last row, before it removed its journal
    fs::write(dir.file("out").join(journals.last().expect("a journal of a killed run")), b"").unwrap();
    succeeds(&dir, "s.toml --out out");
    assert_eq!(rows(&dir.file("out"), &columns), plain);
    let names = fs::read_dir(dir.file("out")).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    assert!(
        !names.into_iter().any(|name| name.ends_with(".journal")),
        "journals are removed when their rows are written"
    );
    // the folder rejects another sweep
    fs::write(dir.file("s.toml"), text.replace("120", "121")).unwrap();
    let (status, output) = run(&dir, "s.toml --out out");
    assert!(status == 2 && output.contains("has the rows of another sweep"), "{output}");
}

#[test]
fn a_sweep_keeps_no_copy_in_place_of_its_own_files() {
    let (dir, axis) = (Dir::new(), "[[axis]]\nkey = 'influence.merge_at'\nvalues = [0.9, 1.0]\n");
    fs::write(dir.file("scene.toml"), Scene::builtin("two").expect("built in").source).unwrap();
    fs::write(dir.file("s.toml"), format!("scene = 'scene.toml'\n{axis}")).unwrap();
    // the file of another, in a folder without rows
    fs::create_dir(dir.file("other")).unwrap();
    fs::write(dir.file("other/scene.toml"), "# mine").unwrap();
    for folder in [".", "other"] {
        let names = || {
            let names = fs::read_dir(dir.file(folder)).unwrap().map(|entry| entry.unwrap().file_name());
            names.collect::<BTreeSet<_>>()
        };
        let before = names();
        let (status, output) = run(&dir, &format!("s.toml --out {folder}"));
        assert!(status == 2 && output.contains("scene.toml stands: choose another folder"), "{output}");
        assert_eq!(names(), before, "nothing is written");
    }
}

#[test]
fn a_value_is_set_once() {
    let dir = Dir::new();
    let (axis, set) = ("[[axis]]\nkey = 'KEY'\nvalues = [1.0, 2.0]\n", "[[set]]\nkey = 'KEY'\nvalue = 3.0\n");
    let by_name = "body.left.motion.free.velocity[0]";
    let by_number = "body[0].motion.free.velocity[0]";
    for [first, second] in [[axis, axis], [axis, set], [set, set]] {
        for keys in [[by_name, by_number], [by_number, by_name]] {
            let tables = first.replace("KEY", keys[0]) + &second.replace("KEY", keys[1]);
            let more =
                if first == set { axis.replace("KEY", "dt").replace("1.0, 2.0", "0.01, 0.02") } else { String::new() };
            fs::write(dir.file("s.toml"), format!("scene = 'collide'\n{tables}{more}")).unwrap();
            let (status, output) = run(&dir, "s.toml --out out");
            assert!(status == 2 && output.contains("this value is set twice"), "{output}");
        }
    }
}

#[test]
fn a_row_opens_as_a_recording_with_its_checksum() {
    let text = "scene = 'collide'\nmeasures = ['displacement', 'surfaces']\n\
                [[axis]]\nkey = 'body.left.motion.free.velocity[0]'\nvalues = [0.2, 1.0]\n\
                [[set]]\nkey = 'duration'\nvalue = 1.2\n";
    let dir = folder(text);
    succeeds(&dir, "s.toml --out out");
    let output = succeeds(&dir, "s.toml --out out --open 1");
    assert!(output.contains("row 1: body.left.motion.free.velocity[0] = 1; merged"), "{output}");
    assert!(output.contains("the same as in the table"), "{output}");
    assert!(dir.file("out/row-1.rrd").exists());
    for row in [2, u64::MAX] {
        let (status, output) = run(&dir, &format!("s.toml --out out --open {row}"));
        assert!(status == 2 && output.contains(&format!("has no row {row}: it has 2 rows, the last is 1")), "{output}");
    }
    let (status, output) = run(&dir, "s.toml --out out --shard 0/1 --level 21");
    assert!(status == 2 && output.contains("--level"), "{output}");
    let columns = of(&dir);
    let rows = rows(&dir.file("out"), &columns);
    let cell = |name: &str| rows[&1][columns.iter().position(|column| column.name == name).unwrap() - 1].clone();
    assert_eq!(cell("events"), Cell::Text("merge, core".to_owned()));
    let (Cell::Float(displacement), Cell::List(gaps)) = (cell("max_displacement"), cell("gaps")) else { panic!() };
    assert!(displacement > 0.01 && gaps.len() == 2 && gaps[1] < 0.0, "{displacement} {gaps:?}");
}

/// Shards on several machines may have the same process id.
#[test]
fn shards_in_one_process_keep_their_files_apart() {
    let dir = folder(OVER_OFFSETS);
    let sweep = Sweep::load(&dir.file("s.toml")).unwrap();
    let columns = of(&dir);
    let template = sweep.template().unwrap();
    let point = Runner::new(&sweep, Some(&template), None).row(0).unwrap().1;
    for round in 0..8 {
        let out = dir.file(&format!("out{round}"));
        let start = Barrier::new(12);
        std::thread::scope(|scope| {
            let shards: Vec<_> = (0..12)
                .map(|index| {
                    let (sweep, columns, point, out, start) = (&sweep, &columns, &point, &out, &start);
                    scope.spawn(move || {
                        start.wait();
                        let store = Store::open(out, sweep, columns.clone())?;
                        let shard = Shard { index: index / 2, count: 6 }; // each shard runs twice
                        for block in 0..4 {
                            let mut journal = store.journal(0, shard)?;
                            let row = (index + 100 * block, point.clone());
                            journal.add(&row)?;
                            store.write_block(0, shard, block, &[row])?;
                            store.write("map.svg", |to| to.write_all(b"<svg/>"))?;
                        }
                        store.clean(0, shard)
                    })
                })
                .collect();
            shards.into_iter().for_each(|shard| shard.join().unwrap().unwrap());
        });
        let names: Vec<String> =
            fs::read_dir(&out).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        assert_eq!(names.len(), 6 * 4 + 3, "{names:?}");
    }
}

/// Of two sweeps that start in one folder at the same time, one is refused.
#[test]
fn two_sweeps_never_share_a_folder() {
    let dir = folder(OVER_OFFSETS);
    let one = Sweep::load(&dir.file("s.toml")).unwrap();
    fs::write(dir.file("s.toml"), OVER_OFFSETS.replace("0.9", "0.95")).unwrap();
    let other = Sweep::load(&dir.file("s.toml")).unwrap();
    let columns = of(&dir);
    for round in 0..200 {
        let out = dir.file(&format!("out{round}"));
        let start = Barrier::new(2);
        let open = |sweep| {
            start.wait();
            Store::open(&out, sweep, columns.clone()).is_ok()
        };
        let opened = std::thread::scope(|scope| {
            let threads = [&one, &other].map(|sweep| scope.spawn(move || open(sweep)));
            threads.map(|thread| thread.join().unwrap())
        });
        assert!(opened[0] != opened[1], "{opened:?}");
    }
}

/// Meshes beside the scene, and those that an axis names, belong to the sweep.
#[test]
fn a_sweep_with_another_mesh_is_another_sweep() {
    let sweep = "scene = 'passing.toml'\n[[axis]]\nkey = 'body.b.shape.mesh'\nvalues = ['own.obj', 'other.obj']\n";
    let dir = folder(sweep);
    let own = "shape = { mesh = 'own.obj' }\nmotion = { line";
    let scene = PASSING.replace("shape = { sphere = { stacks = 3, slices = 4 } }\nmotion = { line", own);
    let scene =
        scene.replace("shape = { sphere = { stacks = 3, slices = 4 } }\n                       motion = { line", own);
    assert!(scene.contains("own.obj"), "{scene}");
    fs::write(dir.file("passing.toml"), scene).unwrap();
    let mesh = |x: f64| format!("v 0 0 0\nv {x} 0 0\nv 0 3 0\nv 0 0 3\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n");
    for name in ["own.obj", "other.obj"] {
        fs::write(dir.file(name), mesh(3.0)).unwrap();
    }
    succeeds(&dir, "s.toml --out out --quiet");
    succeeds(&dir, "s.toml --out out --quiet");
    for name in ["own.obj", "other.obj"] {
        fs::write(dir.file(name), mesh(2.0)).unwrap();
        let (status, output) = run(&dir, "s.toml --out out --quiet");
        assert!(status == 2 && output.contains("its scene.toml differs"), "{name}: {output}");
        fs::write(dir.file(name), mesh(3.0)).unwrap();
    }
}

/// Where a plane moves a body out, rows that place it differently are the same run.
#[test]
fn a_sweep_warns_of_a_body_that_a_plane_moves() {
    let sweep =
        "scene = 'falling.toml'\n[[axis]]\nkey = 'body.a.motion.free.from[2]'\nfrom = 0.1\nto = 0.2\ncount = 2\n";
    let dir = folder(sweep);
    let falling = "duration = 0.2\n[[plane]]\nnormal = [0, 0, 1]\n[[body]]\nname = 'a'\nradius = 1.0\n\
                   shape = { sphere = { stacks = 3, slices = 4 } }\nmotion = { free = { from = [0, 0, 0.1] } }\n";
    fs::write(dir.file("falling.toml"), falling).unwrap();
    let output = succeeds(&dir, "s.toml --out out");
    assert!(output.contains("warning: a is placed 0.900 deep in a plane"), "{output}");
}

#[test]
fn a_sweep_replaces_no_file_of_the_user() {
    let dir = folder(OVER_OFFSETS);
    // a recording of a scene that is called "map"
    fs::create_dir(dir.file("own")).unwrap();
    fs::write(dir.file("map.toml"), format!("name = 'map'\n{PASSING}")).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_meldscope"));
    command.args(["run", "map.toml", "-q", "--thin", "--save", "own/map.rrd"]).current_dir(dir.path());
    assert!(command.status().unwrap().success());
    let (status, output) = run(&dir, "s.toml --out own");
    assert!(status == 2 && output.contains("map.rrd") && output.contains("is not replaced"), "{output}");
    for name in ["map.svg", "map.rrd", "thresholds-1.parquet"] {
        let out = dir.file("out");
        fs::create_dir(&out).unwrap();
        fs::write(out.join(name), "mine").unwrap();
        let (status, output) = run(&dir, "s.toml --out out --bisect influence.merge_at");
        assert!(status == 2 && output.contains(name) && output.contains("is not replaced"), "{output}");
        assert_eq!(fs::read_to_string(out.join(name)).unwrap(), "mine");
        assert_eq!(fs::read_dir(&out).unwrap().count(), 1, "nothing is written");
        fs::remove_dir_all(&out).unwrap();
    }
    // nor does a row that cannot be there claim a folder
    let (status, output) = run(&dir, "s.toml --out out --open 3");
    assert!(status == 2 && output.contains("out has no row 3: run the sweep first"), "{output}");
    assert!(!dir.file("out").exists());
    succeeds(&dir, "s.toml --out out --bisect influence.merge_at");
    succeeds(&dir, "s.toml --out out --bisect influence.merge_at"); // its own files are replaced
    fs::write(dir.file("out/row-3.toml"), "mine").unwrap();
    let (status, output) = run(&dir, "s.toml --out out --open 3");
    assert!(status == 2 && output.contains("row-3.toml") && output.contains("is not replaced"), "{output}");
    assert_eq!(fs::read_to_string(dir.file("out/row-3.toml")).unwrap(), "mine");
}

/// The decoder panics on some damaged files.
#[test]
fn a_damaged_table_is_an_error() {
    let dir = folder(OVER_OFFSETS);
    succeeds(&dir, "s.toml --out out");
    let columns = of(&dir);
    let (path, damaged) = (dir.file("out/rows-00-0of1-000000.parquet"), dir.file("damaged.parquet"));
    let bytes = fs::read(&path).unwrap();
    let (mut seed, mut errors) = (1u64, 0);
    for _ in 0..3000 {
        let mut copy = bytes.clone();
        for _ in 0..3 {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let at = (seed >> 33) as usize % copy.len();
            copy[at] = (seed >> 20) as u8;
        }
        fs::write(&damaged, copy).unwrap();
        errors += u32::from(table::read(&damaged, &columns, |_| ()).is_err());
    }
    assert!(errors > 100, "{errors}");
}

/// In floating point, the change is at the end of a step or just after it.
#[test]
fn a_change_at_the_end_of_a_step_counts_whenever_a_run_ends() {
    let scene = "duration = 2.0\n[[body]]\nname = 'a'\nradius = 1.0\nmotion = { fixed = [0, 0, 0] }\n[[body]]\nname = 'b'\n\
                 radius = 1.0\nmotion = { line = { from = [2.6, 0, 0], velocity = [-0.6, 0, 0] } }\n";
    for until in ["certain", "end"] {
        let dir = folder(&format!(
            "scene = 'closing.toml'\nuntil = '{until}'\n[[set]]\nkey = 'influence.merge_at'\nvalue = 1.0\n\
             [[axis]]\nkey = 'body.b.motion.line.velocity[0]'\nvalues = [-0.59, -0.6, -0.61]\n"
        ));
        fs::write(dir.file("closing.toml"), scene).unwrap();
        let output = succeeds(&dir, "s.toml --out out");
        assert!(output.contains("outcomes: merged 3\n"), "{until}: {output}");
    }
}

/// A path that turns in the step in which a pair splits has not turned yet when it does: the bodies have passed each other,
/// whatever the step.
#[test]
fn the_outcome_does_not_depend_on_where_a_path_turns_within_a_step() {
    let scene = "duration = 2.0\n[[body]]\nname = 'a'\nradius = 1.0\nmotion = { fixed = [0, 0, 0] }\n\
                 [[body]]\nname = 'b'\nradius = 1.0\nmotion = { keyframes = { interpolation = 'linear', \
                 keys = [[0.0, -3, 0.3, 0], [0.95, 2.5, 0.3, 0], [2.0, 2.4, 0.3, 0]] } }\n";
    let dir = folder("scene = 'turn.toml'\n[[axis]]\nkey = 'dt'\nvalues = [0.25, 0.05, 0.01]\n");
    fs::write(dir.file("turn.toml"), scene).unwrap();
    succeeds(&dir, "s.toml --out out");
    let columns = of(&dir);
    for cells in rows(&dir.file("out"), &columns).values() {
        assert!(cells.iter().any(|cell| matches!(cell, Cell::Text(text) if text == "passed")), "{cells:?}");
    }
}

/// A scene ends with its last step, which may be later than its duration.
#[test]
fn a_change_in_the_last_step_counts_after_the_duration() {
    let scene = "duration = 1.0\ndt = 0.4\n[influence]\nalpha = 0\nbeta = 0\n[[body]]\nname = 'a'\nradius = 1.0\n\
                 motion = { fixed = [0, 0, 0] }\n[[body]]\nname = 'b'\nradius = 1.0\n\
                 motion = { line = { from = [4.1, 0, 0], velocity = [-1.9, 0, 0] } }\n";
    for until in ["certain", "end"] {
        let dir = folder(&format!(
            "scene = 'late.toml'\nuntil = '{until}'\n[[axis]]\nkey = 'body.a.mass'\nvalues = [1, 2]\n"
        ));
        fs::write(dir.file("late.toml"), scene).unwrap();
        let output = succeeds(&dir, "s.toml --out out");
        assert!(output.contains("outcomes: merged 2\n"), "{until}: {output}");
    }
}

/// The two thresholds exclude each other in a corner of their map, which is no reason to refuse it.
#[test]
fn a_corner_that_is_invalid_fails_alone() {
    let dir = folder(
        "scene = 'passing.toml'\n[[axis]]\nkey = 'influence.merge_at'\nfrom = 1.0\nto = 1.3\ncount = 4\n\
         [[axis]]\nkey = 'influence.split_at'\nfrom = 1.1\nto = 1.4\ncount = 4\n",
    );
    let output = succeeds(&dir, "s.toml --out out");
    assert!(
        output
            .contains("warning: influence.merge_at = 1.2 and influence.split_at = 1.1 together make the scene invalid"),
        "{output}"
    );
    assert!(output.contains("failed 3"), "{output}");
    succeeds(&dir, "s.toml --out out --bisect influence.merge_at");
    succeeds(&dir, "s.toml --out out3 --refine 1 --bisect influence.split_at");
    // in any order
    let text = fs::read_to_string(dir.file("s.toml")).unwrap().replace("from = 1.0\nto = 1.3", "from = 1.3\nto = 1.0");
    fs::write(dir.file("s.toml"), text).unwrap();
    assert!(succeeds(&dir, "s.toml --out out4").contains("failed 3"));
    // a value that is invalid with all others is an error
    fs::write(dir.file("s.toml"), OVER_OFFSETS.replace("from = 0.9", "from = -0.9")).unwrap();
    let (status, output) = run(&dir, "s.toml --out out2");
    assert!(status == 2 && output.contains("influence.merge_at = -0.9 makes the scene invalid"), "{output}");
}

/// At values between integers, no run is valid.
#[test]
fn an_axis_of_integers_has_nothing_in_between() {
    let dir = folder(
        "scene = 'passing.toml'\n[[axis]]\nkey = 'body.b.shape.sphere.slices'\nfrom = 4\nto = 8\ncount = 3\n\
         [[axis]]\nkey = 'influence.merge_at'\nfrom = 0.9\nto = 1.1\ncount = 3\n",
    );
    for option in ["--refine 2", "--bisect body.b.shape.sphere.slices"] {
        let (status, output) = run(&dir, &format!("s.toml --out out {option}"));
        let name = option.split(' ').next().unwrap();
        let expected = format!("{name} needs values between those of the axis body.b.shape.sphere.slices, and ");
        assert!(status == 2 && output.contains(&expected), "{output}");
        assert!(!dir.file("out").exists());
    }
    succeeds(&dir, "s.toml --out out --refine 1");
    succeeds(&dir, "s.toml --out out2 --bisect influence.merge_at");
}

/// What flies apart for ever until the last edit does not end before that, also if it is at the end of a step.
#[test]
fn a_run_is_not_certain_before_its_last_edit() {
    let body = |name: &str, x: f64, speed: f64| {
        format!(
            "[[body]]\nname = '{name}'\nradius = 1.0\nshape = {{ sphere = {{ stacks = 4, slices = 6 }} }}\n\
             motion = {{ free = {{ from = [{x}, 0, 0], velocity = [{speed}, 0, 0] }} }}\n"
        )
    };
    let scene = format!(
        "dt = 0.02\nduration = 6.0\n{}{}[[edit]]\ntime = 4.0\n\
         set = {{ 'influence.split_at' = 9.0, 'influence.merge_at' = 8.0 }}\n",
        body("a", 0.0, -1.0),
        body("b", 2.6, 1.0)
    );
    let dir = folder("scene = 'late.toml'\n[[axis]]\nkey = 'dt'\nvalues = [0.02, 0.0125, 0.01]\n");
    fs::write(dir.file("late.toml"), scene).unwrap();
    let output = succeeds(&dir, "s.toml --out out");
    assert!(output.contains("outcomes: merged 3\n"), "{output}");
}
