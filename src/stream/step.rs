//! What a step leaves to be recorded.

use std::time::{Duration, Instant as Clock};

use super::settings::Settings;
use crate::sim::{
    Snapshot, StepReport, World,
    stages::{self, Inside},
};

/// What a step leaves to be recorded, apart from its frame.
#[derive(Clone, Debug)]
pub struct Step {
    /// What happened.
    pub report: StepReport,
    /// The hash of the state after it.
    pub checksum: u64,
    /// What looking at the world took of the simulation's time …
    pub observing: Duration,
    /// … and what waiting for the recording took.
    pub waiting: Duration,
    /// How far the simulation is behind real time, if it runs no faster than that.
    pub lag: Option<Duration>,
    /// When the step was complete.
    pub end: Clock,
    /// What happened inside, if that is wanted.
    pub stages: Vec<Inside>,
}

/// Looks into steps, for which it keeps the state before the next one.
#[derive(Default)]
pub struct StageWatch {
    before: Option<Snapshot>,
}

impl StageWatch {
    /// From the world as it is on.
    pub fn new(world: &World, settings: &Settings) -> StageWatch {
        let mut watch = StageWatch::default();
        watch.observe(world, settings);
        watch
    }

    /// The stages of the step just taken, if they are wanted.
    pub fn observe(&mut self, world: &World, settings: &Settings) -> Vec<Inside> {
        let step = world.steps_taken();
        let stages = match &self.before {
            Some(before) if settings.has_stages(step) => stages::inside(before, world),
            _ => Vec::new(),
        };
        if settings.has_stages(step + 1) {
            world.look(self.before.get_or_insert_default());
        } else {
            self.before = None;
        }
        stages
    }
}
