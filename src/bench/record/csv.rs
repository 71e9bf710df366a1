//! Frames and bytes for programs.

use std::fmt::Write as _;

use super::Measurement;
use crate::bench::machine::Machine;

/// A line for each measurement.
pub fn csv(measurements: &[Measurement], machine: &Machine) -> String {
    let mut text =
        "scene,bodies,detail,destination,simulated,frames,seconds,bytes,payload_bytes,entities,machine\n".to_owned();
    let quoted = |text: &str| text.replace('"', "\"\"");
    for measured in measurements {
        let Measurement { bodies, is_simulated, frames, seconds, payload, .. } = measured;
        let _ = writeln!(
            text,
            "\"{}\",{bodies},{},\"{}\",{is_simulated},{frames},{seconds},{},{payload},{},\"{}\"",
            quoted(&measured.scene),
            measured.detail.name(),
            measured.destination.name(),
            measured.bytes.map_or_else(String::new, |bytes| bytes.to_string()),
            measured.entities.map_or_else(String::new, |entities| entities.to_string()),
            quoted(&machine.to_string()),
        );
    }
    text
}
