//! Errors of random short scenes: balls that drop on planes, pairs of unequal size and mass that meet, bodies on paths
//! that pass them, pushes, all models of the pair law.
//!
//! At any instant t the error should be at most the tolerance times t, and no more than the sum of the estimates so far.
//! A scene whose motion amplifies whatever is done to it is marked: a change of every omega by a millionth moves a
//! vertex by more than 30 millionths of R omega t.

use std::fmt;

use rayon::prelude::*;

use super::{
    MeasureError,
    error::LEAST_ALLOWED,
    reference::{Accuracy, NoReference, Reference},
};
use crate::{Scene, World, random::Random};

/// What to measure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Number of scenes.
    pub count: u64,
    /// Seed of the random numbers.
    pub seed: u64,
    /// Tolerance of the scenes [1/s].
    pub tolerance: f64,
}

/// A random scene and its error.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// The scene.
    pub scene: Scene,
    /// The largest ratio of an error to what the tolerance allows until then [–].
    pub factor: f64,
    /// The largest error of a vertex [radii].
    pub error: f64,
    /// The sum of the estimates [radii].
    pub estimates: f64,
    /// Whether the error was above the sum of the estimates at some instant.
    pub is_underestimated: bool,
    /// Distance of the reference from one with ten times the tolerance and twice the step [radii].
    pub agreement: f64,
    /// Whether the motion amplifies any error. Examined only where the error is too large.
    pub amplifies: bool,
    /// Why there is no error to compare: the run ended early, or there is no reference.
    pub failure: Option<String>,
}

impl Outcome {
    /// Whether it is not as it should be, whatever the reason.
    pub fn is_listed(&self) -> bool {
        self.factor > 1.0 || self.is_underestimated || self.failure.is_some()
    }

    /// Whether the error is above what was asked, and the motion is not to blame.
    pub fn is_miss(&self) -> bool {
        self.factor > 1.0 && !self.amplifies
    }

    /// Whether the error is above the sum of the estimates, and the motion is not to blame.
    pub fn is_blind(&self) -> bool {
        self.is_underestimated && !self.amplifies
    }
}

/// A line on a scene that misses; counts on all.
impl fmt::Display for Outcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Outcome { scene, factor, error, estimates, agreement, amplifies, failure, .. } = self;
        if let Some(failure) = failure {
            return write!(f, "{}: not compared: {failure}", scene.name);
        }
        write!(
            f,
            "{}: {factor:.1} times what was asked, error {error:.1e} R, sum of estimates {estimates:.1e} R, reference within \
             {agreement:.0e} R{}",
            scene.name,
            if *amplifies { "; the motion amplifies" } else { "" }
        )
    }
}

/// Counts over random scenes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Counts {
    /// Scenes that were compared with a reference and do not amplify errors above what was asked.
    pub compared: usize,
    /// Of these, scenes with errors above what was asked …
    pub missed: usize,
    /// … and scenes whose sum of estimates was below the error.
    pub underestimated: usize,
    /// Scenes with such errors whose motion amplifies.
    pub amplifying: usize,
    /// Scenes that could not be compared.
    pub failed: usize,
}

impl Counts {
    /// Counts outcomes.
    pub fn of(outcomes: &[Outcome]) -> Counts {
        let count = |is: fn(&Outcome) -> bool| outcomes.iter().filter(|outcome| is(outcome)).count();
        let (failed, amplifying) = (count(|it| it.failure.is_some()), count(|it| it.amplifies));
        Counts {
            compared: outcomes.len() - failed - amplifying,
            missed: count(Outcome::is_miss),
            underestimated: count(Outcome::is_blind),
            amplifying,
            failed,
        }
    }

    /// Whether errors are as asked in 99 of 100 scenes, and below the sum of the estimates in 95.
    pub fn are_met(&self) -> bool {
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

/// Measures random scenes on all cores, in order of their index. Calls `progress` after each.
///
/// # Errors
/// [`MeasureError`]
pub fn measure(settings: &Settings, progress: &(dyn Fn() + Sync)) -> Result<Vec<Outcome>, MeasureError> {
    let outcome = |index: u64| {
        let outcome = scene(settings, index).map_err(MeasureError::from).and_then(judge);
        progress();
        outcome
    };
    (0..settings.count).into_par_iter().map(outcome).collect()
}

/// Runs a scene and compares every step with the reference.
///
/// # Errors
/// [`MeasureError::World`]
pub fn judge(scene: Scene) -> Result<Outcome, MeasureError> {
    let instants: Vec<f64> = (0..=scene.steps()).map(|step| step as f64 * scene.dt).collect();
    let mut outcome = Outcome {
        factor: 0.0,
        error: 0.0,
        estimates: 0.0,
        is_underestimated: false,
        agreement: 0.0,
        amplifies: false,
        failure: None,
        scene,
    };
    let solve = |scene: &Scene, accuracy| Reference::solve(scene, &instants, accuracy);
    let found = solve(&outcome.scene, Accuracy::TIGHTER)
        .and_then(|reference| Ok((solve(&outcome.scene, Accuracy::DEFAULT)?, reference)));
    let (usual, reference) = match found {
        Ok(found) => found,
        Err(error) => return Ok(Outcome { failure: Some(error.to_string()), ..outcome }),
    };
    let mut world = World::new(outcome.scene.clone())?;
    for (k, &t) in instants.iter().enumerate().skip(1) {
        let report = world.step();
        if let Some(failure) = &report.failure {
            outcome.failure = Some(failure.to_string());
            return Ok(outcome);
        }
        outcome.estimates += report.error;
        outcome.agreement = outcome.agreement.max(usual.difference(&reference, &outcome.scene, k));
        // what the two references do not agree on is no error
        let largest = world.bodies().enumerate().map(|(index, body)| reference.error(index, &body, k));
        let error = (largest.fold(0.0, f64::max) - outcome.agreement).max(0.0);
        outcome.error = outcome.error.max(error);
        outcome.factor = outcome.factor.max(error / f64::max(LEAST_ALLOWED, outcome.scene.tolerance * t));
        outcome.is_underestimated |= error > outcome.estimates.max(0.1 * LEAST_ALLOWED);
    }
    if outcome.factor > 1.0 || outcome.is_underestimated {
        outcome.amplifies = match amplifies(&outcome.scene, &reference, &instants) {
            Ok(amplifies) => amplifies,
            Err(error) => return Ok(Outcome { failure: Some(error.to_string()), ..outcome }),
        };
    }
    Ok(outcome)
}

/// Whether a change of every omega by a millionth moves a vertex by more than 30 millionths of R omega t at some
/// instant.
///
/// # Errors
/// The changed scene has no reference.
pub fn amplifies(scene: &Scene, reference: &Reference, instants: &[f64]) -> Result<bool, NoReference> {
    const CHANGE: f64 = 1e-6;
    const ORDINARY: f64 = 30.0;
    let mut changed = scene.clone();
    changed.bodies.iter_mut().for_each(|body| body.material.omega *= 1.0 + CHANGE);
    let other = Reference::solve(&changed, instants, Accuracy::DEFAULT)?;
    let omega = scene.bodies.iter().map(|body| body.material.omega).fold(0.0, f64::max);
    let is_far = |(k, &t): (usize, &f64)| reference.difference(&other, scene, k) > ORDINARY * CHANGE * omega * t;
    Ok(instants.iter().enumerate().skip(1).any(is_far))
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
///
/// # Errors
/// None is known to occur.
pub fn scene(settings: &Settings, index: u64) -> Result<Scene, crate::SceneError> {
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
    Scene::parse(&text, "random.toml")
}
