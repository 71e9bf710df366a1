//! Work per step is limited: an endless step is ended at the same point in every run, and an interrupted step ends at
//! once.
//!
//! A fuzzer of scenes searches for excessive time and memory; `MELDSCOPE_FUZZ_SECONDS` lets it run longer.

use std::{
    fmt::Write as _,
    fs,
    process::{Command, Stdio},
    sync::atomic::{AtomicBool, Ordering},
    time::{Duration, Instant},
};

use meldscope::{
    Scene, World,
    recording::{
        Recorded,
        replay::{self, Verdict},
    },
    sim::{Failure, Options, Toil},
};

use crate::{random::cases, recording::Dir};

/// CPU time limit for work that ends by itself.
const LIMIT: Duration = Duration::from_secs(10);
/// A mesh of five vertices.
const SMALL: &str = "shape = { sphere = { stacks = 2, slices = 3 } }";

fn body(name: &str, more: &str, motion: &str) -> String {
    format!("[[body]]\nname = \"{name}\"\nradius = 1.0\n{more}\nmotion = {{ {motion} }}\n")
}

fn sine(center: f64, amplitude: [f64; 3], frequency: f64, phase: f64) -> String {
    format!(
        "sine = {{ center = [{center:?}, 0, 0], amplitude = {amplitude:?}, frequency = {frequency:?}, phase = {phase:?} }}"
    )
}

/// A body at rest, and one that oscillates beside it.
fn swinging(frequency: f64, center: f64, amplitude: f64) -> String {
    let moves = sine(center, [amplitude, 0.0, 0.0], frequency, 0.0);
    format!("duration = 4.0\n{}{}", body("a", "", "fixed = [0, 0, 0]"), body("b", "", &moves))
}

/// This many bodies at the same position.
fn pile(count: usize, more: &str) -> String {
    let bodies = (0..count).map(|i| body(&format!("b{i}"), more, "fixed = [0, 0, 0]"));
    format!("duration = 1.0\n{}", bodies.collect::<String>())
}

/// Takes up to `max_steps` steps; returns their number and the failure that ended them.
fn steps(scene: &str, max_steps: u64, options: Options) -> (u64, Option<Failure>) {
    let scene = Scene::parse(scene, "work.toml").expect("a scene");
    let mut world = World::with_options(scene, options).expect("enough memory");
    while world.steps_taken() < max_steps {
        if let Some(failure) = world.step().failure.clone() {
            return (world.steps_taken(), Some(failure));
        }
    }
    (max_steps, None)
}

/// An endless step is not taken; the error names the step and a remedy. The result is the same for any number of
/// threads.
#[test]
fn endless_work_ends_with_a_failure() {
    let cases = [
        ("events without end", swinging(1e9, 2.1, 1.5), true),
        ("a rim that is crossed without end", swinging(1e5, 1.8, 0.2), false),
        ("long steps", swinging(0.25, 2.1, 1.5).replace("duration = 4.0", "duration = 1e10\ndt = 1e8"), true),
        ("many stiff bodies in one place", pile(400, SMALL), false),
    ];
    for (what, text, is_pair) in cases {
        let outcomes = [1, 2].map(|threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            pool.install(|| steps(&text, 60, Options::default()))
        });
        let [(taken, failure), other] = outcomes;
        assert_eq!((taken, &failure), (other.0, &other.1), "{what}");
        let Some(Failure::Overworked(overworked)) = failure else { panic!("{what}: {failure:?} after {taken} steps") };
        assert_eq!(overworked.step, taken + 1, "{what}");
        let names_pair =
            matches!(&overworked.toil, Toil::Events { a, b, .. } if (a.as_str(), b.as_str()) == ("a", "b"));
        assert_eq!(names_pair, is_pair, "{what}: {overworked}");
        assert!(overworked.to_string().contains("lower"), "{what}: {overworked}");
    }
}

/// After a step that could not be taken, no further step is taken.
#[test]
fn no_step_follows_one_that_was_not_taken() {
    let scene = Scene::parse(&swinging(1e9, 2.1, 1.5), "work.toml").expect("a scene");
    let mut world = World::new(scene).expect("enough memory");
    let failure = world.step().failure.clone();
    assert!(matches!(failure, Some(Failure::Overworked(_))));
    assert_eq!(world.step().failure, failure);
    assert_eq!(world.steps_taken(), 0);
}

/// Two bodies stay on the threshold forever, a quarter turn apart. The search for phase changes ends soon, with a failure
/// that names the pair.
#[test]
fn a_pair_that_stays_on_its_threshold_is_named() {
    let standing = |amplitude: f64| {
        let (a, b) = (
            sine(0.0, [amplitude, 0.0, 0.0], 1.0, 0.0),
            sine(0.0, [0.0, amplitude, 0.0], 1.0, std::f64::consts::FRAC_PI_2),
        );
        let (a, b) = (body("a", SMALL, &a), body("b", SMALL, &b));
        format!("duration = 1.0\n[influence]\nmerge_at = 1.05\nsplit_at = 1.05\n{a}{b}")
    };
    let cases = [standing(2.1), standing(2.1 + 1e-12), standing(2.1 - 1e-12)];
    for text in cases {
        let start = Instant::now();
        let (taken, failure) = steps(&text, 60, Options::default());
        let Some(Failure::Overworked(overworked)) = failure else { panic!("{failure:?} after {taken} steps: {text}") };
        assert!(matches!(overworked.toil, Toil::Events { .. }) && overworked.to_string().contains("move merge_at"));
        assert!(start.elapsed() < Duration::from_secs(5), "{:?}: {text}", start.elapsed());
    }
}

/// A path that oscillates many times per step is followed, or ends the run soon with a failure that says what to lower.
#[test]
fn motion_too_fast_for_steps_is_named() {
    for (response, frequency) in [("rigid", 1e5), ("rigid", 1e9), ("inertial", 1e5), ("world", 1e9)] {
        let text = swinging(frequency, 6.0, 0.5) + &format!("[material]\nresponse = \"{response}\"\n");
        let start = Instant::now();
        let (taken, failure) = steps(&text, 240, Options::default());
        match failure {
            None => assert_eq!(taken, 240),
            Some(failure) => {
                assert!(
                    failure.to_string().contains("lower") && failure.to_string().contains("frequencies"),
                    "{failure}"
                );
            }
        }
        assert!(start.elapsed() < Duration::from_secs(10), "{:?}: {text}", start.elapsed());
    }
}

/// Scenes with very many pushes or keys end, and take no longer than their events require.
#[test]
fn very_many_pushes_and_keys_are_handled() {
    const COUNT: usize = 100_000;
    let keys = |from: f64, center: f64| {
        let key = |k: usize| (from + 4e-5 * k as f64, center + 0.3 * (2e-4 * k as f64).sin());
        let keys: Vec<String> = (0..COUNT).map(key).map(|(t, x)| format!("[{t:?}, {x:?}, 0, 0]")).collect();
        format!("keyframes = [{}]", keys.join(", "))
    };
    let bodies = |a: &str, b: &str| format!("duration = 4.0\n{}{}", body("a", "", a), body("b", "", b));
    let pushes = |length: f64| {
        let push = |i: usize| {
            let (start, turn) = (4e-5 * i as f64, 0.1 * i as f64);
            let direction = [turn.cos(), turn.sin(), (1.7 * turn).cos()];
            format!(
                "[[push]]\nbody = \"a\"\ndirection = {direction:?}\nstrength = 1.0\nstart = {start:?}\nduration = {length:?}\n"
            )
        };
        bodies("fixed = [0, 0, 0]", "fixed = [2, 0, 0]") + &(0..COUNT).map(push).collect::<String>()
    };
    let cases = [
        ("short pushes", pushes(1e-5)),
        ("overlapping pushes", pushes(1.0)),
        ("keys at equal times", bodies(&keys(0.0, 0.0), &keys(0.0, 2.3))),
        ("keys at times close by", bodies(&keys(0.0, 0.0), &keys(1e-9, 2.3))),
    ];
    for (what, text) in cases {
        assert_eq!(steps(&text, 240, Options::default()), (240, None), "{what}");
    }
}

/// A flag interrupts a long step, and the world reports it.
#[test]
fn an_interrupt_ends_a_step() {
    let stop: &'static AtomicBool = Box::leak(Box::default());
    let text = pile(400, SMALL);
    let (raised, outcome) = std::thread::scope(|scope| {
        let options = Options { interrupt: Some(stop), ..Options::default() };
        let run = scope.spawn(move || steps(&text, 60, options));
        std::thread::sleep(Duration::from_millis(300));
        stop.store(true, Ordering::Relaxed);
        let raised = Instant::now();
        (raised, run.join().expect("no panic"))
    });
    // the integrator's first step spans two of the scene's, and the state after the first of them is looked at too
    assert_eq!(outcome, (0, Some(Failure::Interrupted { step: 1 })));
    assert!(raised.elapsed() < Duration::from_secs(1), "{:?}", raised.elapsed());
}

/// Pairs are counted before memory is allocated for them.
#[test]
fn too_many_pairs_are_rejected() {
    let scene = Scene::parse(&pile(10_000, SMALL), "pile.toml").expect("a scene");
    let start = Instant::now();
    let rejected = World::new(scene).map(|_| ());
    let text = rejected.expect_err("too many pairs").to_string();
    assert!(text.contains("10000 bodies") && text.contains("pairs near each other"), "{text}");
    assert!(start.elapsed() < LIMIT, "{:?}", start.elapsed());
}

/// The recording of an interrupted run extends up to the interruption; it replays, and fails as the run did.
#[test]
fn the_recording_of_a_run_that_failed_replays_to_the_same_failure() {
    let dir = Dir::new();
    fs::write(dir.file("endless.toml"), swinging(1e4, 1.8, 0.5)).expect("disk space");
    let program = |arguments: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_meldscope")).args(arguments).current_dir(dir.path()).output();
        let output = output.expect("it starts");
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        (output.status.code(), text(&output.stdout), text(&output.stderr))
    };
    let (status, _, stderr) = program(&["run", "endless.toml", "--quiet", "--save", "endless.rrd"]);
    assert_eq!(status, Some(1), "{stderr}");
    assert!(
        stderr.contains("too much to do in step ") && stderr.contains("endless.rrd contains the steps up to here"),
        "{stderr}"
    );
    let recorded = Recorded::open(&dir.file("endless.rrd")).expect("a recording");
    let failure = recorded.failure.clone().expect("a reason for its end");
    assert!(failure.starts_with(&format!("too much to do in step {} ", recorded.last() + 1)), "{failure}");
    assert_eq!(replay::verify(&recorded, |_| true).expect("it runs"), Verdict::Identical);
    let (status, printed, stderr) = program(&["replay", "endless.rrd"]);
    assert_eq!(status, Some(0), "{stderr}");
    assert!(printed.contains(&format!("and it fails as it did: {failure}")), "{printed}");
}

/// A xorshift generator.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    fn below(&mut self, n: usize) -> usize {
        (self.next() % n as u64) as usize
    }

    fn one_in(&mut self, n: usize) -> bool {
        self.below(n) == 0
    }

    /// From 0 to 1.
    fn share(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// A number between two powers of ten, most often of ordinary size.
    fn size(&mut self, low: f64, high: f64) -> f64 {
        let exponent = if self.one_in(3) { low + (high - low) * self.share() } else { -1.0 + 2.0 * self.share() };
        10f64.powf(exponent.clamp(low, high))
    }

    fn number(&mut self, low: f64, high: f64) -> f64 {
        match self.below(6) {
            0 => 0.0,
            1 => -self.size(low, high),
            _ => self.size(low, high),
        }
    }

    fn vector(&mut self, low: f64, high: f64) -> String {
        format!("{:?}", [(); 3].map(|()| self.number(low, high)))
    }
}

/// A scene at the limits of valid scenes.
fn extreme_scene(random: &mut Random) -> String {
    let mut text = String::new();
    let dt = if random.one_in(3) { random.size(-9.0, 9.0) } else { 1.0 / 60.0 };
    let count = match random.below(8) {
        0 => 1 + random.below(400),
        1 => 1 + random.below(60),
        _ => 1 + random.below(6),
    };
    let _ = writeln!(text, "dt = {dt:?}\nduration = {:?}", 20.0 * dt);
    if random.one_in(4) {
        let all = ["thesis", "mps", "euler", "verlet", "rk4"];
        let _ = writeln!(text, "integrator = \"{}\"", all[random.below(all.len())]);
    }
    if random.one_in(4) {
        let _ = writeln!(text, "tolerance = {:?}", random.size(-12.0, 3.0));
    }
    let response = ["rigid", "inertial", "world"][random.below(3)];
    let (omega, damping) = (random.number(-9.0, 9.0).abs(), random.number(-9.0, 9.0).abs());
    let _ =
        writeln!(text, "[material]\nomega = {omega:?}\ndamping = {damping:?}\nresponse = \"{response}\"\n[influence]");
    let merge_at = random.size(-3.0, 3.0);
    let split_at = if random.one_in(2) { merge_at } else { merge_at * (1.0 + random.size(-12.0, 2.0)) };
    let core_at = if random.one_in(3) { merge_at * 0.5 } else { 0.0 };
    let _ = writeln!(text, "merge_at = {merge_at:?}\nsplit_at = {split_at:?}\ncore_at = {core_at:?}");
    for key in ["alpha", "beta"] {
        let _ = writeln!(text, "{key} = {:?}", 100.0 * random.number(-9.0, 9.0).abs());
    }
    if random.one_in(2) {
        let _ = writeln!(text, "reach = {:?}", random.size(-6.0, 6.0));
    }
    let _ = writeln!(text, "weight = \"{}\"", ["linear", "wendland"][random.below(2)]);
    let _ = writeln!(text, "scaling = \"{}\"", ["relative", "absolute"][random.below(2)]);
    let _ = writeln!(text, "apart = \"{}\"", ["repel", "none"][random.below(2)]);
    let (is_alike, frequency) = (random.one_in(2), random.size(-3.0, 10.0));
    let spread = if random.one_in(3) { 0.0 } else { random.size(-9.0, 4.0) };
    for i in 0..count {
        let radius = if is_alike { 1.0 } else { random.size(-6.0, 6.0) };
        let rings = if count > 60 || random.one_in(2) { [2, 3] } else { [2 + random.below(20), 3 + random.below(30)] };
        let _ = writeln!(text, "[[body]]\nname = \"b{i}\"\nradius = {radius:?}");
        let _ = writeln!(text, "shape = {{ sphere = {{ stacks = {}, slices = {} }} }}", rings[0], rings[1]);
        let place = format!("{:?}", [(); 3].map(|()| spread * (random.share() - 0.5)));
        let kinds = if count > 60 { 6 } else { 4 };
        let motion = match random.below(kinds) {
            0 => format!("line = {{ from = {place}, velocity = {} }}", random.vector(-6.0, 6.0)),
            1 | 2 => {
                let frequency = if random.one_in(2) { frequency } else { random.size(-3.0, 10.0) };
                let phase = [0.0, std::f64::consts::FRAC_PI_2, 3.0][random.below(3)];
                let amplitude = if random.one_in(2) { "[2.1, 0, 0]".to_owned() } else { random.vector(-3.0, 4.0) };
                format!(
                    "sine = {{ center = {place}, amplitude = {amplitude}, frequency = {frequency:?}, phase = {phase:?} }}"
                )
            }
            3 if random.one_in(2) => {
                let limit = if random.one_in(4) { 3000 } else { 30 };
                let keys = 2 + random.below(limit);
                let length = 10.0 * dt * random.size(-2.0, 1.0);
                let key = |k: usize, random: &mut Random| {
                    let [x, y, z] = [(); 3].map(|()| random.number(-3.0, 1.0));
                    format!("[{:?}, {x:?}, {y:?}, {z:?}]", (k as f64 * length / keys as f64).max(k as f64 * 1e-11))
                };
                let keys: Vec<String> = (0..keys).map(|k| key(k, random)).collect();
                format!("keyframes = [{}]", keys.join(", "))
            }
            _ => format!("fixed = {place}"),
        };
        let _ = writeln!(text, "motion = {{ {motion} }}");
    }
    let pushes = match random.below(8) {
        0 => random.below(2000),
        1 | 2 => random.below(10),
        _ => 0,
    };
    let one = random.below(count);
    for _ in 0..pushes {
        let on = if random.one_in(4) { random.below(count) } else { one };
        let (start, lasts) = (20.0 * dt * random.share(), 20.0 * dt * random.share() * random.size(-6.0, 1.0));
        let direction = format!("{:?}", [1.0, random.share(), random.share()]);
        let strength = random.number(-6.0, 9.0);
        let _ = writeln!(
            text,
            "[[push]]\nbody = \"b{on}\"\ndirection = {direction}\nstrength = {strength:?}\nstart = {start:?}\nduration = {lasts:?}"
        );
    }
    text
}

/// CPU time and peak memory [KiB] of a process, where the system reports them.
fn taken(id: u32) -> Option<(Duration, u64)> {
    let stat = fs::read_to_string(format!("/proc/{id}/stat")).ok()?;
    let ticks: u64 =
        stat.rsplit(')').next()?.split_whitespace().skip(11).take(2).filter_map(|n| n.parse::<u64>().ok()).sum();
    let status = fs::read_to_string(format!("/proc/{id}/status")).ok()?;
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?.split_whitespace().next()?.parse().ok()?;
    Some((Duration::from_millis(10 * ticks), peak))
}

/// Every scene ends by itself within ten seconds of CPU time and 1 GiB, whatever its numbers.
#[test]
fn no_extreme_scene_runs_forever() {
    let dir = Dir::new();
    let mut random = Random(0x9e37_79b9_7f4a_7c15);
    let (mut runs, mut failed, mut longest) = (0u64, 0u64, Duration::ZERO);
    for _ in cases(8) {
        let text = extreme_scene(&mut random);
        fs::write(dir.file("extreme.toml"), &text).expect("disk space");
        let mut program = Command::new(env!("CARGO_BIN_EXE_meldscope"));
        program.args(["run", "extreme.toml", "--quiet", "--thin", "--threads", "1", "--save", "extreme.rrd"]);
        program.current_dir(dir.path()).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
        let mut child = program.spawn().expect("the program starts");
        let begin = Instant::now();
        let status = loop {
            let (time, memory) = taken(child.id()).unwrap_or_default();
            longest = longest.max(time);
            // the elapsed time is limited too, but other programs may use the processors for a while
            if time > LIMIT || memory > 1 << 20 || begin.elapsed() > 12 * LIMIT {
                child.kill().and_then(|()| child.wait()).ok();
                let kept = std::env::temp_dir().join("meldscope-extreme.toml");
                fs::write(&kept, &text).ok();
                panic!("scene {runs} ({}): {time:?}, {memory} KiB", kept.display());
            }
            if let Some(status) = child.try_wait().expect("a child") {
                break status;
            }
            std::thread::sleep(Duration::from_millis(2));
        };
        let stderr = std::io::read_to_string(child.stderr.take().expect("a pipe")).expect("text");
        assert!(matches!(status.code(), Some(0..=2)) && !stderr.contains("panicked"), "{status}: {stderr}\n{text}");
        assert!(status.success() || stderr.lines().any(|line| line.starts_with("error: ")), "{stderr}");
        runs += 1;
        failed += u64::from(!status.success());
    }
    println!("{runs} extreme scenes, {failed} of them ended with a failure or were rejected");
    println!("the longest took {longest:?}");
}
