//! Slow-down of steps while frames are saved at display rate.
//!
//! An endless scene is stepped as fast as possible in alternating blocks, without and with a recorder. Other load and
//! clock speed vary by more than the measured effect, so each block is compared with its neighbours, and the median of
//! these ratios is reported. Only the stepping thread is timed. The recording thread costs the simulation caches,
//! memory bandwidth and cores. If all cores are busy with other work, the recording thread uses the stepping thread's
//! core, which adds to wall time. The CPU time of the stepping thread is therefore compared as well, where the system
//! reports it.

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

/// Frames per second of wall time.
pub const RATE: f64 = 60.0;
/// Number of blocks of each kind.
const BLOCKS: usize = 60;
/// Duration of a block: about a hundred periods of the scene, and 6 frames.
const BLOCK: Duration = Duration::from_millis(100);
/// Number of steps between checks of the clock.
const STEPS: u64 = 8;

/// The data that is saved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    /// A frame every 1/60 s of wall time, and nothing for the steps in between.
    Frames,
    /// A frame every N steps, with N chosen for the same frame rate, and the checksum of every step, as `run --every N`
    /// does.
    EveryStep,
}

impl Way {
    /// Both ways.
    pub const ALL: [Way; 2] = [Way::Frames, Way::EveryStep];
}

/// The measured slow-down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Saving {
    /// What was saved.
    pub way: Way,
    /// Steps per second without saving, in the median block.
    pub plain: f64,
    /// Steps per second with saving, in the median block.
    pub saving: f64,
    /// Relative increase of the step time by saving [–]: lower quartile, median and upper quartile of the comparisons.
    pub slow_down: [f64; 3],
    /// Median relative increase of the stepping thread's CPU time [–], if the system reports it.
    pub on_core: Option<f64>,
    /// Frames saved per second.
    pub frames: f64,
}

/// Lower quartile, median and upper quartile; NaN if there are no numbers.
fn quartiles(mut numbers: Vec<f64>) -> [f64; 3] {
    numbers.sort_unstable_by(f64::total_cmp);
    [1, 2, 3].map(|k| numbers.get(k * numbers.len() / 4).copied().unwrap_or(f64::NAN))
}

/// Measures one way of saving. The recording goes to `file`, which is removed.
pub(super) fn measure(way: Way, file: &Path) -> Result<Saving, String> {
    let scene = scenes::pair().map_err(|error| error.to_string())?;
    let mut world = World::new(scene).map_err(|error| error.to_string())?;
    let mut none = |_: &World, _: Duration| Ok(());
    let mut rate = 0.0;
    for _ in 0..3 {
        rate = f64::max(rate, block(&mut world, &mut none)?.per_second());
    }
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

    let slow_downs = |of: fn(&Block) -> f64| {
        // relative to the blocks before and after, so that a steady drift in speed cancels out
        let around = |i: usize| 0.5 * (of(&plain[i]) + of(plain.get(i + 1).unwrap_or(&plain[i])));
        quartiles(saving.iter().enumerate().map(|(i, saving)| of(saving) / around(i) - 1.0).collect())
    };
    let rate = |blocks: &[Block]| quartiles(blocks.iter().map(Block::per_second).collect())[1];
    let has_cores = plain.iter().chain(&saving).all(|block| block.on_core > 0.0);
    Ok(Saving {
        way,
        plain: rate(&plain),
        saving: rate(&saving),
        slow_down: slow_downs(|block| block.seconds / block.steps as f64),
        on_core: has_cores.then(|| slow_downs(|block| block.on_core / block.steps as f64)[1]),
        frames,
    })
}

/// Steps timed together.
struct Block {
    steps: u64,
    /// [s]
    seconds: f64,
    /// CPU time of the thread [s]; 0 where the system does not report it.
    on_core: f64,
}

impl Block {
    fn per_second(&self) -> f64 {
        self.steps as f64 / self.seconds
    }
}

/// CPU time of this thread [s]. Linux updates it every few milliseconds.
fn cpu_time() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    let nanoseconds = text.split(' ').next().and_then(|number| number.parse::<f64>().ok());
    1e-9 * nanoseconds.unwrap_or(0.0)
}

type Observe<'a> = &'a mut dyn FnMut(&World, Duration) -> Result<(), String>;

/// Takes steps for the duration of a block, and calls `observe` every [`STEPS`] steps.
fn block(world: &mut World, observe: Observe<'_>) -> Result<Block, String> {
    time_block(world, |world, elapsed| {
        (0..STEPS).for_each(|_| _ = world.step());
        observe(world, elapsed)
    })
}

/// Like [`block`], but calls `observe` after every step.
fn block_of_every_step(world: &mut World, observe: Observe<'_>) -> Result<Block, String> {
    time_block(world, |world, elapsed| {
        for _ in 0..STEPS {
            world.step();
            observe(world, elapsed)?;
        }
        Ok(())
    })
}

fn time_block(
    world: &mut World,
    mut steps_of: impl FnMut(&mut World, Duration) -> Result<(), String>,
) -> Result<Block, String> {
    let (start, cpu_time_before) = (Instant::now(), cpu_time());
    let mut steps = 0;
    loop {
        steps_of(world, start.elapsed())?;
        steps += STEPS;
        let elapsed = start.elapsed();
        if elapsed >= BLOCK {
            return Ok(Block { steps, seconds: elapsed.as_secs_f64(), on_core: cpu_time() - cpu_time_before });
        }
    }
}
