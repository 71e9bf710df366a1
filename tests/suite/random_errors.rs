//! Errors of random short scenes: balls that drop on planes, pairs of unequal size and mass that meet, bodies on paths
//! that pass them, pushes, all models of the pair law. See [`judge`] for what is asked.

use std::fmt;

use meldscope::{
    Scene,
    bench::judge::{Outcome, judge},
    random::Random,
};
use rayon::prelude::*;

/// What to measure.
#[derive(Clone, Copy)]
struct Settings {
    /// Number of scenes.
    count: u64,
    /// Seed of the random numbers.
    seed: u64,
    /// Tolerance of the scenes [1/s].
    tolerance: f64,
}

/// Random scenes are valid and have references that resolve a tenth of what is asked; their errors are as asked.
#[test]
fn errors_of_random_scenes_are_as_asked() {
    let settings = Settings { count: 300, seed: 5, tolerance: 1e-8 };
    (0..settings.count).for_each(|index| _ = scene(&settings, index));
    let few = Settings { count: 24, ..settings };
    let of = |index: u64| judge(scene(&few, index)).expect("enough memory");
    let outcomes: Vec<Outcome> = (0..few.count).into_par_iter().map(of).collect();
    assert!(outcomes.iter().all(|outcome| outcome.failure.is_none()), "{outcomes:?}");
    for outcome in &outcomes {
        let asked = 0.1 * few.tolerance * outcome.scene.duration;
        assert!(outcome.agreement <= asked || outcome.amplifies, "{outcome:?}");
    }
    let counts = Counts::of(&outcomes);
    assert_eq!(counts.compared + counts.amplifying, 24, "{counts}");
    assert!(counts.are_met(), "{counts}");
}

/// Counts over random scenes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Counts {
    /// Scenes that were compared with a reference and do not amplify errors above what was asked.
    compared: usize,
    /// Of these, scenes with errors above what was asked …
    missed: usize,
    /// … and scenes whose sum of estimates was below the error.
    underestimated: usize,
    /// Scenes with such errors whose motion amplifies.
    amplifying: usize,
    /// Scenes that could not be compared.
    failed: usize,
}

impl Counts {
    /// Counts outcomes.
    fn of(outcomes: &[Outcome]) -> Counts {
        let is_miss = |it: &Outcome| it.factor > 1.0 && !it.amplifies;
        let is_blind = |it: &Outcome| it.is_underestimated && !it.amplifies;
        let count = |is: fn(&Outcome) -> bool| outcomes.iter().filter(|outcome| is(outcome)).count();
        let (failed, amplifying) = (count(|it| it.failure.is_some()), count(|it| it.amplifies));
        Counts {
            compared: outcomes.len() - failed - amplifying,
            missed: count(is_miss),
            underestimated: count(is_blind),
            amplifying,
            failed,
        }
    }

    /// Whether errors are as asked in 99 of 100 scenes, and below the sum of the estimates in 95.
    fn are_met(&self) -> bool {
        self.failed == 0 && 100 * self.missed <= self.compared && 20 * self.underestimated <= self.compared
    }
}

impl fmt::Display for Counts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Counts { compared, missed, underestimated, amplifying, failed } = *self;
        let share = 100.0 * underestimated as f64 / compared.max(1) as f64;
        write!(
            f,
            "{missed} of {compared} scenes above tolerance × time; in {underestimated} ({share:.0} %) the sum of the estimates is \
             below the error; {amplifying} more whose motion amplifies, {failed} not compared"
        )
    }
}

/// Between two numbers, to three places.
fn between(random: &mut Random, low: f64, high: f64) -> f64 {
    (1e3 * (low + random.unit() * (high - low))).round() / 1e3
}

/// Whether something of a given probability happens.
fn happens(random: &mut Random, share: f64) -> bool {
    between(random, 0.0, 1.0) < share
}

/// What a random scene is about.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    /// A ball falls on a plane.
    Drop,
    /// Two free bodies meet.
    Pair,
    /// The same above a plane.
    Both,
    /// Two bodies on paths pass each other, perhaps through a plane.
    Paths,
    /// A body on a path passes a free one.
    Passing,
}

/// The random scene of an index.
fn scene(settings: &Settings, index: u64) -> Scene {
    use Kind::{Both, Drop, Pair, Passing, Paths};
    let mut random =
        Random::new(settings.seed.wrapping_mul(0xd1b5_4a32_d192_ed03) ^ index.wrapping_mul(0x2545_f491_4f6c_dd1d));
    let r = &mut random;
    let kind = r.of(&[Drop, Drop, Pair, Pair, Both, Both, Paths, Passing]);
    let has_plane = matches!(kind, Drop | Both) || happens(r, 0.25);
    let Settings { seed, tolerance, .. } = *settings;
    let mut text = format!("name = \"random-{seed}-{index}\"\nduration = 0.5\ntolerance = {tolerance:e}\n");
    if matches!(kind, Drop | Both) {
        text += "gravity = [0, 0, -9.81]\n";
    }
    text += &format!("[material]\nomega = {}.0\ndamping = {}\n", r.of(&[9, 12, 25]), r.of(&["0.3", "1.5", "6.0"]));
    text += &format!("[influence]\nweight = \"{}\"\n", r.of(&["linear", "linear", "wendland"]));
    text += r.of(&["core_at = 0.0\n", "core_at = 0.8\ncore_width = 0.1\n", "core_at = 0.8\ncore_width = 0.4\n"]);
    if has_plane {
        text += &format!(
            "[[plane]]\nnormal = [{:?}, 0, 1]\noffset = {:?}\nstiffness = {}\nfriction = {}\n",
            if happens(r, 0.5) { 0.0 } else { between(r, -0.2, 0.2) },
            if matches!(kind, Drop | Both) { 0.0 } else { between(r, -1.1, -0.7) },
            r.of(&["1e3", "4e3", "2e4", "1e5"]),
            r.of(&["0.0", "0.3"])
        );
    }
    let stacks = [r.of(&[4, 8]), r.of(&[6, 12])];
    let mut body = |name: &str, radius: f64, mass: f64, motion: &str| {
        let [stacks, slices] = stacks;
        text += &format!(
            "[[body]]\nname = \"{name}\"\nradius = {radius:?}\nmass = {mass:?}\nshape = {{ sphere = {{ stacks = {stacks}, slices = \
             {slices} }} }}\nmotion = {{ {motion} }}\n"
        );
    };
    let height = if matches!(kind, Drop | Both) { 1.0 + between(r, 0.02, 0.9) } else { 0.0 };
    let falling = if matches!(kind, Drop | Both) { between(r, -3.0, 0.0) } else { 0.0 };
    let free = |r: &mut Random, from: [f64; 3], velocity: [f64; 3]| {
        let spin: [f64; 3] = [between(r, -2.0, 2.0), 0.0, between(r, -2.0, 2.0)];
        let spin = spin.map(|spin| if happens(r, 0.5) { 0.0 } else { spin });
        format!("free = {{ from = {from:?}, velocity = {velocity:?}, spin = {spin:?} }}")
    };
    let first = match kind {
        Paths => "fixed = [0, 0, 0]".to_owned(),
        _ => free(r, [0.0, 0.0, height], [0.0, 0.0, falling]),
    };
    body("a", 1.0, 1.0, &first);
    if kind != Drop {
        let radius = (1e4 / r.of(&[1.0f64, 1.0, 2.0, 5.0, 10.0, 30.0, 50.0])).round() / 1e4;
        let mass = r.of(&[radius * radius * radius, 1.0, 0.01, 0.001]);
        let (gap, side, speed) = (between(r, 1.02, 1.4) * (1.0 + radius), between(r, -0.3, 0.3), between(r, 0.5, 4.0));
        let motion = match kind {
            Paths | Passing => match r.bits() % 4 {
                0 => format!("line = {{ from = [{gap:?}, {side:?}, 0], velocity = [{:?}, 0, 0.1] }}", -speed),
                1 => format!(
                    "sine = {{ center = [{gap:?}, {side:?}, 0], amplitude = [{:?}, 0.1, 0], frequency = {:?} }}",
                    0.5 * gap,
                    between(r, 0.3, 3.0)
                ),
                n => format!(
                    "keyframes = {{ keys = [[0, {gap:?}, {side:?}, 0], [{:?}, {:?}, 0, 0], [{:?}, {gap:?}, 0.2, 0.1]], interpolation = \
                     \"{}\" }}",
                    between(r, 0.05, 0.2),
                    gap - 0.3 * speed,
                    between(r, 0.25, 0.6),
                    if n == 2 { "spline" } else { r.of(&["linear", "hold"]) }
                ),
            },
            _ => free(r, [gap, side, height], [-speed, 0.0, 0.0]),
        };
        body("b", radius, mass, &motion);
    }
    if happens(r, 0.2) {
        text += &format!(
            "[[push]]\nbody = \"a\"\ndirection = [1, 0, 0.3]\nstrength = {:?}\nstart = {:?}\nduration = {:?}\n",
            between(r, 1.0, 60.0),
            between(r, 0.0, 0.3),
            between(r, 0.01, 0.2)
        );
    }
    Scene::parse(&text, "random.toml").expect("a valid scene")
}
