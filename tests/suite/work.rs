//! Work per step is bounded: an endless step is ended, at the same point in every run, and an interrupted step ends at
//! once.

use std::{
    fs,
    process::Command,
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

use crate::recording::Dir;

/// CPU time limit for work that ends by itself [s]; other programs may extend it.
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

/// This many bodies in one place.
fn pile(count: usize, more: &str) -> String {
    let bodies = (0..count).map(|i| body(&format!("b{i}"), more, "fixed = [0, 0, 0]"));
    format!("duration = 1.0\n{}", bodies.collect::<String>())
}

/// Takes steps until something ends them; returns their number and the cause.
fn steps(scene: &str, most: u64, options: Options) -> (u64, Option<Failure>) {
    let scene = Scene::parse(scene, "work.toml").expect("a scene");
    let mut world = World::with_options(scene, options).expect("fits");
    while world.steps_taken() < most {
        if let Some(failure) = world.step().failure.clone() {
            return (world.steps_taken(), Some(failure));
        }
    }
    (most, None)
}

/// An endless step is not taken; the error says which and what to do. The result is the same for any number of threads.
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

/// After a step that could not be taken, no further step is.
#[test]
fn no_step_follows_one_that_was_not_taken() {
    let scene = Scene::parse(&swinging(1e9, 2.1, 1.5), "work.toml").expect("a scene");
    let mut world = World::new(scene).expect("fits");
    let failure = world.step().failure.clone();
    assert!(matches!(failure, Some(Failure::Overworked(_))));
    assert_eq!(world.step().failure, failure);
    assert_eq!(world.steps_taken(), 0);
}

/// Two bodies rest on the threshold forever, a quarter turn apart: nothing happens, and that is detected at once.
#[test]
fn what_only_looks_endless_is_none() {
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
        assert_eq!(steps(&text, 60, Options::default()), (60, None), "{text}");
        assert!(start.elapsed() < Duration::from_secs(5), "{:?}: {text}", start.elapsed());
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
    assert_eq!(outcome, (0, Some(Failure::Interrupted { step: 1 })));
    assert!(raised.elapsed() < Duration::from_secs(1), "{:?}", raised.elapsed());
}

/// Pairs are counted before memory is allocated for them.
#[test]
fn too_many_pairs_are_refused() {
    let scene = Scene::parse(&pile(10_000, SMALL), "pile.toml").expect("a scene");
    for skip in [true, false] {
        let start = Instant::now();
        let refused = World::with_options(scene.clone(), Options { skip, ..Options::default() }).map(|_| ());
        let text = refused.expect_err("too many pairs").to_string();
        assert!(text.contains("10000 bodies") && text.contains("pairs near each other"), "{text}");
        assert!(start.elapsed() < LIMIT, "{:?}", start.elapsed());
    }
}

/// The recording of an interrupted run extends up to the interruption; it replays, and fails as the run did.
#[test]
fn the_recording_of_a_run_that_failed_replays_to_the_same_failure() {
    let dir = Dir::new();
    fs::write(dir.file("endless.toml"), swinging(1e4, 1.8, 0.5)).expect("room");
    let program = |arguments: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_meldscope")).args(arguments).current_dir(dir.path()).output();
        let output = output.expect("it starts");
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        (output.status.code(), text(&output.stdout), text(&output.stderr))
    };
    let (status, _, said) = program(&["run", "endless.toml", "--quiet", "--save", "endless.rrd"]);
    assert_eq!(status, Some(1), "{said}");
    assert!(
        said.contains("too much to do in step ") && said.contains("endless.rrd has the steps up to here"),
        "{said}"
    );
    let recorded = Recorded::open(&dir.file("endless.rrd")).expect("a recording");
    let failure = recorded.failure.clone().expect("it says why it ended");
    assert!(failure.starts_with(&format!("too much to do in step {} ", recorded.last() + 1)), "{failure}");
    assert_eq!(replay::verify(&recorded, |_| true).expect("it runs"), Verdict::Identical);
    let (status, printed, said) = program(&["replay", "endless.rrd"]);
    assert_eq!(status, Some(0), "{said}");
    assert!(printed.contains(&format!("and it fails as it did: {failure}")), "{printed}");
}
