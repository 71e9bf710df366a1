//! Files that remain when a run is killed, the disk is full, or two runs write the same file.
#![cfg(unix)]

use std::{
    fs,
    path::Path,
    process::{Child, Command, Output, Stdio},
    sync::atomic::{AtomicU32, Ordering},
    time::{Duration, Instant},
};

use meldscope::recording::{Recorded, read::End};

use crate::recording::Dir;

fn program(dir: &Dir, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_meldscope"));
    command.args(arguments).current_dir(dir.path()).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    command
}

/// A running program, killed when its test ends.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        self.0.kill().and_then(|()| self.0.wait()).ok();
    }
}

fn output_text(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned() + &String::from_utf8_lossy(&output.stdout)
}

/// Waits until the run has started to write.
fn wait_for_output(path: &Path) {
    let start = Instant::now();
    while fs::metadata(path).map_or(0, |file| file.len()) == 0 {
        assert!(start.elapsed() < Duration::from_secs(30), "it does not begin");
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// A hundred runs of several kinds, killed at various times. Each leaves a recording that replays up to its end.
#[test]
fn recordings_of_killed_runs_are_replayed() {
    let number = AtomicU32::new(0);
    let kinds: [&[&str]; 4] = [
        &["two", "--steps", "0"],
        &["two", "--steps", "0", "--thin"],
        &["three", "--steps", "100000000", "--every", "9", "--detail", "surface"],
        &["two", "--steps", "0", "--keep", "20", "--on", "merge,split"],
    ];
    let steps = AtomicU32::new(0);
    std::thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                let dir = Dir::new();
                let partial = dir.file("k.rrd.partial");
                loop {
                    let number = number.fetch_add(1, Ordering::Relaxed);
                    if number >= 100 {
                        break;
                    }
                    fs::remove_file(&partial).ok();
                    let kind = kinds[number as usize % kinds.len()];
                    let arguments = [&["run"], kind, &["--quiet", "--save", "k.rrd"]].concat();
                    let run = Running(program(&dir, &arguments).spawn().expect("it starts"));
                    wait_for_output(&partial);
                    // golden ratio: spread over the first quarter of a second
                    let moment = (f64::from(number) * 0.618_033_988_75).fract();
                    std::thread::sleep(Duration::from_secs_f64(0.25 * moment));
                    drop(run);
                    assert!(!dir.file("k.rrd").exists(), "an unfinished recording has no name");
                    match Recorded::open(&partial) {
                        Ok(recorded) => {
                            assert_eq!(recorded.end, End::Cut);
                            steps.fetch_add(recorded.last() as u32, Ordering::Relaxed);
                            let replay = program(&dir, &["replay", "k.rrd.partial"]).stderr(Stdio::piped()).output();
                            let replay = replay.expect("it runs");
                            assert_eq!(replay.status.code(), Some(0), "{kind:?}: {}", output_text(&replay));
                        }
                        Err(error) => panic!("killed at {moment:.3} of 250 ms, {kind:?}: {error}"),
                    }
                }
            });
        }
    });
    assert!(steps.into_inner() > 100, "no run took many steps");
}

/// What is in the file at any moment is what a run that is killed then leaves.
#[test]
fn a_killed_run_loses_at_most_half_a_second() {
    let dir = Dir::new();
    let (partial, left) = (dir.file("k.rrd.partial"), dir.file("left.rrd"));
    for kind in [&["--every", "1"] as &[&str], &["--thin"]] {
        let arguments = [&["run", "two", "--steps", "0", "--realtime", "--quiet", "--save", "k.rrd"], kind].concat();
        let run = Running(program(&dir, &arguments).spawn().expect("it starts"));
        wait_for_output(&partial);
        let start = Instant::now();
        let mut behind = Vec::new();
        while start.elapsed() < Duration::from_millis(1700) {
            std::thread::sleep(Duration::from_millis(20));
            let time = start.elapsed().as_secs_f64();
            fs::copy(&partial, &left).expect("disk space");
            let recorded = Recorded::open(&left).expect("a recording");
            behind.push(time - recorded.last() as f64 * recorded.schema.dt);
        }
        drop(run);
        // how long before `start` the run began is unknown, but at some moment everything had just been written
        let [most, least] =
            [behind.iter().copied().fold(f64::MIN, f64::max), behind.iter().copied().fold(f64::MAX, f64::min)];
        // on a busy machine the run itself may lag behind
        assert!(behind.len() > 10 && most - least < 0.5 + 0.3, "{kind:?}: {behind:?}");
        fs::remove_file(&partial).expect("it exists");
    }
}

/// `ulimit -f` acts like a disk that is full once the file reaches a size; the shell counts in blocks of 512 or 1024
/// bytes.
#[test]
fn a_full_disk_ends_the_run_and_keeps_what_was_written() {
    let dir = Dir::new();
    fs::write(dir.file("full.rrd"), "RRF2: what was there before").expect("disk space");
    let script = format!(
        "trap '' XFSZ; ulimit -f 2000; exec '{}' run two --steps 3000 --save full.rrd",
        env!("CARGO_BIN_EXE_meldscope")
    );
    let output = Command::new("sh").args(["-c", &script]).current_dir(dir.path()).output().expect("a shell");
    assert_eq!(output.status.code(), Some(1), "{}", output_text(&output));
    let text = output_text(&output);
    assert!(text.contains("full.rrd.partial") && text.contains("allows no larger file"), "{text}");
    assert_eq!(fs::read(dir.file("full.rrd")).expect("a file"), b"RRF2: what was there before");
    let recorded = Recorded::open(&dir.file("full.rrd.partial")).expect("what was written");
    assert!(recorded.last() > 10, "{}", recorded.last());
    let replay = program(&dir, &["replay", "full.rrd.partial"]).output().expect("it runs");
    assert_eq!(replay.status.code(), Some(0));
}

/// A claim to a file needs more than one handle.
#[test]
fn too_few_open_files_do_not_keep_a_run_waiting() {
    let dir = Dir::new();
    for files in 4..=8 {
        let script = format!("ulimit -n {files}; exec '{}' run two --save few.rrd", env!("CARGO_BIN_EXE_meldscope"));
        let mut command = Command::new("sh");
        command.args(["-c", &script]).current_dir(dir.path()).stderr(Stdio::null());
        let mut run = Running(command.spawn().expect("a shell"));
        let start = Instant::now();
        while run.0.try_wait().expect("a child").is_none() {
            assert!(start.elapsed() < Duration::from_secs(60), "with {files} open files it does not end");
            std::thread::sleep(Duration::from_millis(5));
        }
        assert!(!dir.file("few.rrd.partial").exists(), "with {files} open files an unfinished file is left");
    }
}
