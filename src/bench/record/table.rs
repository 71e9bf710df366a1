//! Measurements as tables for people.

use super::{
    Costs, Measurement,
    saving::{RATE, Way},
};
use crate::{
    bench::{
        error::table::significant,
        tables::{aligned, number},
    },
    stream::sinks::thousands,
};

/// Frames and bytes.
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
    let mut rows = vec![heading.map(str::to_owned)];
    for measured in measurements {
        let frames = measured.frames as f64;
        let (bytes, payload) = (measured.bytes.map(|bytes| bytes as f64), measured.payload as f64);
        rows.push([
            measured.scene.clone(),
            measured.detail.name().to_owned(),
            measured.destination.name().to_owned(),
            if measured.is_simulated { "yes" } else { "no" }.to_owned(),
            number(measured.rate()),
            bytes.map_or_else(String::new, |bytes| number(bytes / frames)),
            number(payload / frames),
            bytes.map_or_else(String::new, |bytes| format!("{:.2}", bytes / payload)),
            measured.entities.map_or_else(String::new, |entities| entities.to_string()),
        ]);
    }
    aligned(&rows).join("\n")
}

/// What recording costs steps, and what verifying does.
pub fn costs(costs: &Costs) -> String {
    let micro = |seconds: f64| format!("{} µs", significant(1e6 * seconds));
    let mut lines = vec![
        format!("two bodies, stepped as fast as it goes while {RATE} frames a second of wall time are saved"),
        String::new(),
    ];
    let mut rows = vec![["", "steps/s without", "with", "slow-down", "on its core", "frames/s"].map(str::to_owned)];
    rows.extend(costs.saving.iter().map(|saving| {
        let what = match saving.way {
            Way::Frames => "frames",
            Way::EveryStep => "frames, and a checksum of every step",
        };
        let [low, middle, high] = saving.slow_down.map(|share| format!("{:.1}", 100.0 * share));
        let slow_down = format!("{middle} % ({low} to {high})");
        let on_core = saving.on_core.map_or("–".to_owned(), |share| format!("{:.1} %", 100.0 * share));
        [what.to_owned(), number(saving.plain), number(saving.saving), slow_down, on_core, significant(saving.frames)]
    }));
    lines.extend(aligned(&rows));
    lines.extend([String::new(), "checksums".to_owned(), String::new()]);

    let verifying = &costs.verifying;
    let mut rows = vec![["", "a step", "its checksum", "ratio"].map(str::to_owned)];
    rows.extend(verifying.hashing.iter().map(|hashing| {
        let ratio = format!("{:.1} %", 100.0 * hashing.checksum / hashing.step);
        [hashing.scene.clone(), micro(hashing.step), micro(hashing.checksum), ratio]
    }));
    let [alone, among] = verifying.pair;
    rows.push(["two bodies".to_owned(), String::new(), micro(alone), String::new()]);
    let ratio = format!("{} ×", significant(verifying.among_many()));
    rows.push(["two among thousands".to_owned(), String::new(), micro(among), ratio]);
    lines.extend(aligned(&rows));
    lines.extend([String::new(), "replays of thin recordings".to_owned(), String::new()]);

    let mut rows = vec![["", "steps", "simulated in", "verified in", "ratio"].map(str::to_owned)];
    rows.extend(verifying.replaying.iter().map(|replaying| {
        let milli = |seconds: f64| format!("{} ms", significant(1e3 * seconds));
        [
            replaying.scene.clone(),
            thousands(replaying.steps),
            milli(replaying.plain),
            milli(replaying.replay),
            format!("{:.2} ×", replaying.ratio()),
        ]
    }));
    lines.extend(aligned(&rows));
    lines.join("\n")
}
