//! Measurements as tables for the terminal.

use super::{
    Costs, Measurement,
    saving::{RATE, Way},
};
use crate::{
    bench::tables::{self, missing},
    text::{number, significant, thousands},
};

/// Frame rates and sizes.
pub fn table(measurements: &[Measurement]) -> String {
    let heading = [
        "scene",
        "detail",
        "destination",
        "simulated",
        "frames/s",
        "bytes/frame",
        "payload/frame",
        "ratio",
        "entities",
    ];
    let row = |measured: &Measurement| {
        let frames = measured.frames as f64;
        let (bytes, payload) = (measured.bytes.map(|bytes| bytes as f64), measured.payload as f64);
        [
            measured.scene.clone(),
            measured.detail.name().to_owned(),
            measured.destination.name().to_owned(),
            if measured.is_simulated { "yes" } else { "no" }.to_owned(),
            number(measured.rate()),
            bytes.map_or_else(String::new, |bytes| number(bytes / frames)),
            number(payload / frames),
            bytes.map_or_else(String::new, |bytes| format!("{:.2}", bytes / payload)),
            measured.entities.map_or_else(String::new, |entities| entities.to_string()),
        ]
    };
    tables::table(heading, measurements.iter().map(row))
}

/// The slow-down of steps by recording, and the cost of verification.
pub fn costs(costs: &Costs) -> String {
    let percent = |share: f64| format!("{:.1} %", 100.0 * share);
    let micro = |seconds: f64| format!("{} µs", significant(1e6 * seconds));
    let milli = |seconds: f64| format!("{} ms", significant(1e3 * seconds));

    let saving = costs.saving.iter().map(|saving| {
        let what = match saving.way {
            Way::Frames => "frames",
            Way::EveryStep => "frames, and a checksum of every step",
        };
        let [low, middle, high] = saving.slow_down.map(|share| format!("{:.1}", 100.0 * share));
        let slow_down = format!("{middle} % ({low} to {high})");
        let on_core = saving.on_core.map_or_else(missing, percent);
        [what.to_owned(), number(saving.plain), number(saving.saving), slow_down, on_core, significant(saving.frames)]
    });

    let verifying = &costs.verifying;
    let hashing = verifying.hashing.iter().map(|hashing| {
        let ratio = percent(hashing.checksum / hashing.step);
        [hashing.scene.clone(), micro(hashing.step), micro(hashing.checksum), ratio]
    });
    let [alone, among] = verifying.pair;
    let ratio = format!("{} ×", significant(verifying.among_many()));
    let pairs = [("two bodies", alone, String::new()), ("two among thousands", among, ratio)]
        .map(|(name, checksum, ratio)| [name.to_owned(), String::new(), micro(checksum), ratio]);

    let replaying = verifying.replaying.iter().map(|replaying| {
        [
            replaying.scene.clone(),
            thousands(replaying.steps),
            milli(replaying.plain),
            milli(replaying.replay),
            format!("{:.2} ×", replaying.ratio()),
        ]
    });
    format!(
        "two bodies, stepped as fast as possible while {RATE} frames per second of wall time are saved\n\n{}\n\n\
         checksums\n\n{}\n\nreplays of thin recordings\n\n{}",
        tables::table(["", "steps/s without", "with", "slow-down", "CPU time", "frames/s"], saving),
        tables::table(["", "step", "checksum", "ratio"], hashing.chain(pairs)),
        tables::table(["", "steps", "simulated in", "verified in", "ratio"], replaying),
    )
}
