//! Verification cost: the checksum of a step relative to the step, and a replay relative to the run.

use std::{hint::black_box, path::Path, time::Instant};

use super::scenes;
use crate::{
    Scene, World,
    recording::{
        Recorded,
        replay::{self, Verdict},
    },
    stream::{
        Recorder, Settings,
        pipeline::send,
        settings::Frames,
        sinks::{Destinations, Sinks},
    },
};

/// The best of this many runs is reported, because other load only ever slows them down.
const RUNS: usize = 20;
/// Number of unaffected bodies beside a pair.
const OTHERS: usize = 4000;
/// Steps before measuring starts; the pushes have ended by then.
const WARM: u64 = 10;
const STEPS: u64 = 50;

/// The cost of checksums in a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Hashing {
    /// Name of the scene.
    pub scene: String,
    /// Time of a step [s].
    pub step: f64,
    /// Additional time of a step with its checksum [s].
    pub checksum: f64,
}

/// A run, and the verification of its thin recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Replaying {
    /// Name of the scene.
    pub scene: String,
    /// Number of steps.
    pub steps: u64,
    /// Time to read the scene and simulate it [s].
    pub plain: f64,
    /// Time to read the recording, simulate, and compare all checksums [s].
    pub replay: f64,
}

impl Replaying {
    /// Ratio of replay to run time [–].
    pub fn ratio(&self) -> f64 {
        self.replay / self.plain
    }
}

/// The measured costs.
#[derive(Clone, Debug, PartialEq)]
pub struct Verifying {
    /// One entry per scene.
    pub hashing: Vec<Hashing>,
    /// Time of a checksum of a pair of bodies [s]: alone, and among many unaffected bodies.
    pub pair: [f64; 2],
    /// One entry per scene.
    pub replaying: Vec<Replaying>,
}

impl Verifying {
    /// Ratio of the checksum times among many bodies and alone [–].
    pub fn among_many(&self) -> f64 {
        self.pair[1] / self.pair[0]
    }
}

/// Measures the costs on built-in scenes. A recording goes to `file`, which is removed.
pub(super) fn measure(file: &Path) -> Result<Verifying, String> {
    let builtin = |name: &str| Scene::builtin(name).ok_or_else(|| format!("the built-in scene \"{name}\" is missing"));
    let pair = scenes::pair().map_err(|error| error.to_string())?;
    let hashing = ["two", "three", "crowd"].map(|name| hash(&builtin(name)?)).into_iter().collect::<Result<_, _>>()?;
    let replaying =
        [Ok(pair), builtin("crowd")].map(|scene| replay(scene?, file)).into_iter().collect::<Result<_, _>>()?;
    Ok(Verifying { hashing, pair: hash_among_many()?, replaying })
}

fn world(scene: &Scene) -> Result<World, String> {
    World::new(scene.clone()).map_err(|error| error.to_string())
}

/// Alternates runs with and without checksums. Takes the best time of each step, because no whole run is ever
/// undisturbed. Both times include reading the clock, which cancels out in their difference.
fn hash(scene: &Scene) -> Result<Hashing, String> {
    let mut best = vec![[f64::INFINITY; 2]; scene.steps() as usize];
    for _ in 0..RUNS {
        for hashes in [false, true] {
            let mut world = world(scene)?;
            for best in &mut best {
                let best = &mut best[usize::from(hashes)];
                let start = Instant::now();
                world.step();
                if hashes {
                    black_box(world.checksum());
                }
                *best = best.min(start.elapsed().as_secs_f64());
            }
        }
    }
    let [step, both] = [0, 1].map(|which| best.iter().map(|best| best[which]).sum::<f64>() / best.len() as f64);
    Ok(Hashing { scene: scene.name.clone(), step, checksum: both - step })
}

/// Times only the checksum, after every step.
fn hash_among_many() -> Result<[f64; 2], String> {
    let scenes = [0, OTHERS].map(scenes::pair_among);
    let mut best = [f64::INFINITY; 2];
    for (scene, best) in scenes.into_iter().zip(&mut best) {
        let mut world = world(&scene.map_err(|error| error.to_string())?)?;
        (0..WARM).for_each(|_| _ = world.step());
        for _ in 0..STEPS {
            world.step();
            let start = Instant::now();
            black_box(world.checksum());
            *best = best.min(start.elapsed().as_secs_f64());
        }
    }
    Ok(best)
}

fn replay(scene: Scene, file: &Path) -> Result<Replaying, String> {
    record_thinly(&scene, file)?;
    let (mut plain, mut replay) = (f64::INFINITY, f64::INFINITY);
    for _ in 0..RUNS {
        let start = Instant::now();
        let read = Scene::parse(&scene.source, &scene.name).map_err(|error| error.to_string())?;
        let mut world = world(&read)?;
        (0..scene.steps()).for_each(|_| _ = world.step());
        plain = plain.min(start.elapsed().as_secs_f64());
        let start = Instant::now();
        let recorded = Recorded::open(file).map_err(|error| error.to_string())?;
        let verdict = replay::verify(&recorded, |_| true).map_err(|error| error.to_string())?;
        replay = replay.min(start.elapsed().as_secs_f64());
        if verdict != Verdict::Identical {
            return Err(format!(
                "a replay of {} differs from its recording; this is a bug, please report it",
                scene.name
            ));
        }
    }
    std::fs::remove_file(file).ok();
    Ok(Replaying { steps: scene.steps(), scene: scene.name, plain, replay })
}

fn record_thinly(scene: &Scene, file: &Path) -> Result<(), String> {
    let destinations = Destinations { save: Some(file.to_owned()), ..Destinations::default() };
    let mut sinks = Sinks::open(&destinations).map_err(|error| error.to_string())?;
    let mut world = world(scene)?;
    let mut recorder = Recorder::new(&world, Settings { frames: Frames::Thin, ..Settings::of(scene) });
    for _ in 0..scene.steps() {
        world.step();
        recorder.observe(&world);
    }
    recorder.finish(&world);
    send(&mut sinks, recorder.take()).map_or(Ok(()), Err)?;
    sinks.finish().map(drop).map_err(|error| error.to_string())
}
