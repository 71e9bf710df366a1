//! How much slower steps are while frames are saved at the rate of a screen.
//!
//! A scene that goes on for ever is stepped as fast as it goes, for a moment without and for a moment with a recorder beside
//! it, in turns: what else the machine does, and how fast it runs, changes by more than what is looked for, so that each
//! moment is compared with the one next to it, and of these ratios the middle one counts. Only the thread that steps is timed:
//! what recording takes on its own thread costs the simulation as much as it takes from it, of caches, memory and cores.

use std::{
    path::Path,
    time::{Duration, Instant},
};

use super::scenes;
use crate::{
    World,
    stream::{
        Pipeline, Recorder, Settings,
        sinks::{Destinations, Sinks},
    },
};

/// Frames a second of wall time.
pub const RATE: f64 = 60.0;
/// So many blocks of each kind.
const BLOCKS: usize = 60;
/// How long one takes: some hundred periods of the scene, and 6 frames.
const BLOCK: Duration = Duration::from_millis(100);
/// The clock is looked at after so many steps.
const STEPS: u64 = 8;

/// What is saved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    /// A frame every 1/60 s of wall time, and nothing of the steps in between.
    Frames,
    /// A frame every so many steps that it comes to as many, and the checksum of every step, as `run --every N` does.
    EveryStep,
}

impl Way {
    /// Both.
    pub const ALL: [Way; 2] = [Way::Frames, Way::EveryStep];
}

/// What was measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Saving {
    /// What was saved.
    pub way: Way,
    /// Steps per second without …
    pub plain: f64,
    /// … and with it, in the middle one of the blocks.
    pub saving: f64,
    /// By how much longer a step takes [–]: in the middle one of the comparisons, and in those a quarter from either end.
    pub slow_down: [f64; 3],
    /// Frames per second that were saved.
    pub frames: f64,
}

/// What is a quarter, a half and three quarters of the way from the least to the largest.
fn quartiles(mut numbers: Vec<f64>) -> [f64; 3] {
    numbers.sort_unstable_by(f64::total_cmp);
    [1, 2, 3].map(|k| numbers.get(k * numbers.len() / 4).copied().unwrap_or(f64::NAN))
}

/// Measures one way; the recording goes to `file`, which is removed again.
pub(super) fn measure(way: Way, file: &Path) -> Result<Saving, String> {
    let scene = scenes::pair().map_err(|error| error.to_string())?;
    let mut world = World::new(scene).map_err(|error| error.to_string())?;
    let mut none = |_: &World, _: Duration| Ok(());
    let rate = block(&mut world, &mut none)?.max(block(&mut world, &mut none)?).max(block(&mut world, &mut none)?);
    let every = match way {
        Way::Frames => 1,
        Way::EveryStep => (rate / RATE).round().max(1.0) as u64,
    };
    let settings = Settings { steps: None, every, ..Settings::of(world.scene()) };
    let destinations = Destinations { save: Some(file.to_owned()), ..Destinations::default() };
    let sinks = Sinks::open(&destinations).map_err(|error| error.to_string())?;
    let recorder = Recorder::new(&world, settings);
    let mut pipeline = Pipeline::start(&world, recorder, sinks).map_err(|error| error.to_string())?;

    let (mut plain, mut saving) = (vec![], vec![]);
    for _ in 0..BLOCKS {
        plain.push(block(&mut world, &mut none)?);
        let mut frames = 0.0;
        let mut save = |world: &World, elapsed: Duration| match way {
            Way::EveryStep => pipeline.observe(world, None),
            Way::Frames if elapsed.as_secs_f64() * RATE < frames + 0.5 => Ok(()),
            Way::Frames => {
                frames += 1.0;
                pipeline.observe(world, None)
            }
        };
        saving.push(match way {
            Way::Frames => block(&mut world, &mut save)?,
            Way::EveryStep => block_of_every_step(&mut world, &mut save)?,
        });
    }
    let mut recorded = pipeline.finish()?;
    let frames = (recorded.recorder.written() - 1) as f64 / (BLOCKS as f64 * BLOCK.as_secs_f64());
    recorded.finish(&world).map_or(Ok(()), Err)?;
    recorded.sinks.finish().map_err(|error| error.to_string())?;
    std::fs::remove_file(file).ok();

    // each with the block before it and the one after it, so that what gets faster or slower all the time cancels out
    let around = |i: usize| 0.5 * (plain[i] + plain.get(i + 1).unwrap_or(&plain[i]));
    let slow_down = quartiles(saving.iter().enumerate().map(|(i, saving)| around(i) / saving - 1.0).collect());
    let ([_, plain, _], [_, saving, _]) = (quartiles(plain.clone()), quartiles(saving.clone()));
    Ok(Saving { way, plain, saving, slow_down, frames })
}

type Look<'a> = &'a mut dyn FnMut(&World, Duration) -> Result<(), String>;

/// Steps for the time of a block; steps per second.
fn block(world: &mut World, look: Look<'_>) -> Result<f64, String> {
    let start = Instant::now();
    let mut steps = 0;
    loop {
        (0..STEPS).for_each(|_| _ = world.step());
        steps += STEPS;
        let elapsed = start.elapsed();
        look(world, elapsed)?;
        if elapsed >= BLOCK {
            return Ok(steps as f64 / start.elapsed().as_secs_f64());
        }
    }
}

/// The same, and every step is looked at.
fn block_of_every_step(world: &mut World, look: Look<'_>) -> Result<f64, String> {
    let start = Instant::now();
    let mut steps = 0;
    loop {
        for _ in 0..STEPS {
            world.step();
            look(world, Duration::ZERO)?;
        }
        steps += STEPS;
        if start.elapsed() >= BLOCK {
            return Ok(steps as f64 / start.elapsed().as_secs_f64());
        }
    }
}
