//! Conversion of an [`Instant`] to the two timelines of a recording.

use super::contract::{SIM_TIME, STEP};
use crate::sdk::{self, TimePoint, Timeline};

pub use crate::observe::Instant;

impl Instant {
    /// The time point of a row.
    pub fn time_point(self) -> TimePoint {
        TimePoint::from_iter([
            (*Timeline::new_sequence(STEP).name(), sdk::TimeCell::from_sequence(self.step as i64)),
            (*Timeline::new_duration(SIM_TIME).name(), sdk::TimeCell::from_duration_nanos(self.nanoseconds())),
        ])
    }

    /// The value of `sim_time` [ns]. Times beyond its range (292 years) are clamped.
    pub fn nanoseconds(self) -> i64 {
        (self.time * 1e9).round().clamp(0.0, i64::MAX as f64) as i64
    }
}
