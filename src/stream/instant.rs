//! Conversion of an [`Instant`] to the two timelines of a recording.

use crate::sdk::{self, TimePoint, Timeline};

/// The timeline of the stages inside steps.
pub const STAGE: &str = "stage";

pub use crate::observe::Instant;

impl Instant {
    /// The time point of a row.
    pub fn time_point(self) -> TimePoint {
        TimePoint::from_iter([
            (*Timeline::new_sequence("step").name(), sdk::TimeCell::from_sequence(self.step as i64)),
            (*Timeline::new_duration("sim_time").name(), sdk::TimeCell::from_duration_nanos(self.nanoseconds())),
        ])
    }

    /// The value of `sim_time` [ns]. Times beyond its range (292 years) are clamped.
    pub fn nanoseconds(self) -> i64 {
        (self.time * 1e9).round().clamp(0.0, i64::MAX as f64) as i64
    }
}
