//! How much slower steps are while frames are saved at the rate of a screen.
//!
//! A scene that goes on for ever is stepped as fast as it goes, for a while without and for a while with a recorder beside
//! it, in turns, so that whatever else the machine does falls on both alike. Only the thread that steps is timed: what
//! recording takes on its own thread costs the simulation as much as it takes from it, of caches, memory and cores.

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
/// Of so many blocks of each kind the best counts, as what else the machine does only ever slows them down.
const BLOCKS: usize = 12;
/// How long one takes: some hundred periods of the scene, and 15 frames.
const BLOCK: Duration = Duration::from_millis(250);
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
    /// … and with it.
    pub saving: f64,
    /// Frames per second that were saved.
    pub frames: f64,
}

impl Saving {
    /// By how much longer a step takes [–].
    pub fn slow_down(&self) -> f64 {
        self.plain / self.saving - 1.0
    }
}

/// Measures one way; the recording goes to `file`, which is removed again.
pub(super) fn measure(way: Way, file: &Path) -> Result<Saving, String> {
    let scene = scenes::pair().map_err(|error| error.to_string())?;
    let mut world = World::new(scene).map_err(|error| error.to_string())?;
    let mut none = |_: &World, _: Duration| Ok(());
    let rate = block(&mut world, &mut none)?;
    let every = match way {
        Way::Frames => 1,
        Way::EveryStep => (rate / RATE).round().max(1.0) as u64,
    };
    let settings = Settings { steps: None, every, ..Settings::of(world.scene()) };
    let destinations = Destinations { save: Some(file.to_owned()), ..Destinations::default() };
    let sinks = Sinks::open(&destinations).map_err(|error| error.to_string())?;
    let recorder = Recorder::new(&world, settings);
    let mut pipeline = Pipeline::start(&world, recorder, sinks).map_err(|error| error.to_string())?;

    let (mut plain, mut saving, mut frames) = (0.0, 0.0, 0);
    for _ in 0..BLOCKS {
        plain = f64::max(plain, block(&mut world, &mut none)?);
        let mut due = Duration::ZERO;
        let mut save = |world: &World, elapsed: Duration| match way {
            Way::EveryStep => pipeline.observe(world, None),
            Way::Frames if elapsed < due => Ok(()),
            Way::Frames => {
                due += Duration::from_secs_f64(1.0 / RATE);
                pipeline.observe(world, None)
            }
        };
        let rate = match way {
            Way::Frames => block(&mut world, &mut save)?,
            Way::EveryStep => block_of_every_step(&mut world, &mut save)?,
        };
        saving = f64::max(saving, rate);
    }
    let mut recorded = pipeline.finish()?;
    frames += recorded.recorder.written();
    recorded.finish(&world).map_or(Ok(()), Err)?;
    recorded.sinks.finish().map_err(|error| error.to_string())?;
    std::fs::remove_file(file).ok();
    Ok(Saving { way, plain, saving, frames: frames as f64 / (BLOCKS as f64 * BLOCK.as_secs_f64()) })
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
