//! The goals for recording, with their measured values.

use super::{Destination, Measurement, Report, saving::Way};
use crate::{
    bench::goals::{Goal, at_least, at_most},
    stream::settings::Detail,
};

/// Scenes with at least this many bodies have a goal for their number of entities.
const CROWD: usize = 1000;

/// The goals for which there is a measurement. (That the cost of a checksum depends on the influence, not on the
/// number of bodies, is required without a figure; the factor of 10 was chosen here.)
pub fn goals(report: &Report) -> Vec<Goal> {
    let saved = |scene: &str, detail: Detail| {
        let is_saved = |m: &&Measurement| {
            m.scene == scene && m.detail == detail && m.destination == Destination::File && m.is_simulated
        };
        report.measurements.iter().find(is_saved)
    };
    let mut goals = vec![];
    // These goals date from before merged surfaces, which now take most of a frame's time.
    for (detail, what, goal) in [(Detail::Surface, "surfaces", 50_000.0), (Detail::Forces, "all forces", 25_000.0)] {
        if let Some(measured) = saved("two", detail) {
            let what = format!("two, {what}, simulated and saved every step");
            goals.push(at_least(&what, goal, " frames/s", measured.rate()));
        }
    }
    for measured in report.measurements.iter().filter(|m| m.destination == Destination::File && m.is_simulated) {
        if let Some(bytes) = measured.bytes {
            let what = format!("{}, {}: bytes in the file per byte of payload", measured.scene, measured.detail.name());
            goals.push(at_most(&what, 1.05, "", bytes as f64 / measured.payload as f64));
        }
    }
    if let Some(costs) = &report.costs {
        for saving in costs.saving.iter().filter(|saving| saving.way == Way::Frames) {
            let what = "slow-down of stepping while two bodies are saved at 60 frames/s";
            goals.push(at_most(what, 2.0, " %", 100.0 * saving.slow_down[1]));
        }
    }
    for measured in report.measurements.iter().filter(|m| m.bodies >= CROWD && m.detail == Detail::Forces) {
        if let Some(entities) = measured.entities.filter(|_| measured.is_simulated) {
            goals.push(at_most(&format!("{}: entities", measured.scene), 60.0, "", entities as f64));
        }
    }
    if let Some(costs) = &report.costs {
        let verifying = &costs.verifying;
        for hashing in verifying.hashing.iter().filter(|hashing| hashing.scene == "two") {
            goals.push(at_most(
                "two, a checksum relative to its step",
                5.0,
                " %",
                100.0 * hashing.checksum / hashing.step,
            ));
        }
        let what = "a checksum of a pair among thousands that do not affect it, relative to the pair alone";
        goals.push(at_most(what, 10.0, " ×", verifying.among_many()));
        for replaying in &verifying.replaying {
            let what = format!("{}: a replay relative to the run", replaying.scene);
            goals.push(at_most(&what, 1.1, " ×", replaying.ratio()));
        }
    }
    goals
}
