//! Frame rates and sizes as CSV.

use serde::Serialize;

use super::Measurement;
use crate::bench::{machine::Machine, tables};

#[derive(Serialize)]
struct Row<'a> {
    scene: &'a str,
    bodies: usize,
    detail: &'a str,
    destination: &'a str,
    simulated: bool,
    frames: u64,
    seconds: f64,
    bytes: Option<u64>,
    payload_bytes: u64,
    entities: Option<usize>,
    machine: &'a str,
}

/// One row per measurement.
///
/// # Errors
/// None is known to occur.
pub fn csv(measurements: &[Measurement], machine: &Machine) -> Result<String, String> {
    let machine = machine.to_string();
    tables::csv(measurements.iter().map(|measured| Row {
        scene: &measured.scene,
        bodies: measured.bodies,
        detail: measured.detail.name(),
        destination: measured.destination.name(),
        simulated: measured.is_simulated,
        frames: measured.frames,
        seconds: measured.seconds,
        bytes: measured.bytes,
        payload_bytes: measured.payload,
        entities: measured.entities,
        machine: &machine,
    }))
}
