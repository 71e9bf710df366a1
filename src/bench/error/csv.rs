//! Measurements as comma-separated values: one row each, complete in itself.

use std::fmt::Write as _;

use super::{Report, Scheme};
use crate::bench::machine::Machine;

/// The names of the columns.
pub const COLUMNS: [&str; 13] = [
    "scene",
    "vertices",
    "integrator",
    "tolerance_per_s",
    "dt_s",
    "steps",
    "error_radii",
    "order",
    "run_time_ms",
    "runs",
    "vertex_steps_per_s",
    "cpu",
    "version",
];

/// All measurements. `error_radii` is `inf` for a run that diverged; what does not apply is empty.
pub fn csv(reports: &[Report], machine: &Machine) -> String {
    let mut text = COLUMNS.join(",");
    text.push('\n');
    for report in reports {
        for measurement in &report.measurements {
            let tolerance = match measurement.scheme {
                Scheme::Fixed(_) => String::new(),
                Scheme::Controlled { tolerance } => format!("{tolerance:e}"),
            };
            let row = [
                quoted(&report.scene),
                report.vertices.to_string(),
                measurement.scheme.integrator().to_string(),
                tolerance,
                measurement.dt.to_string(),
                measurement.steps.to_string(),
                measurement.error.map_or("inf".to_owned(), |error| format!("{error:.4e}")),
                measurement.order.map_or(String::new(), |order| format!("{order:.3}")),
                format!("{:.6}", measurement.seconds * 1e3),
                measurement.runs.to_string(),
                format!("{:.0}", report.vertex_steps_per_second(measurement)),
                quoted(&machine.cpu),
                machine.version.to_owned(),
            ];
            let _ = writeln!(text, "{}", row.join(",")); // into a string: cannot fail
        }
    }
    text
}

/// A field, in quotes where it needs them (RFC 4180).
pub(in crate::bench) fn quoted(field: &str) -> String {
    if field.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", field.replace('"', "\"\""))
    } else {
        field.to_owned()
    }
}
