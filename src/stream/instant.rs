//! When rows of a recording are: what an [`Instant`] is on its two timelines.

use rerun::{TimePoint, Timeline};

/// The timeline that walks through the inside of steps.
pub const STAGE: &str = "stage";

pub use crate::observe::Instant;

impl Instant {
    /// As a row has it.
    pub fn time_point(self) -> TimePoint {
        TimePoint::from_iter([
            (*Timeline::new_sequence("step").name(), rerun::TimeCell::from_sequence(self.step as i64)),
            (*Timeline::new_duration("sim_time").name(), rerun::TimeCell::from_duration_nanos(self.nanoseconds())),
        ])
    }

    /// What `sim_time` says [ns]. Times that it can't hold (292 years) stay at its end.
    pub fn nanoseconds(self) -> i64 {
        (self.time * 1e9).round().clamp(0.0, i64::MAX as f64) as i64
    }
}
