//! Measurements as tables for the terminal.

use super::{Measurement, Report};
use crate::{
    bench::{
        machine::Machine,
        tables::{self, missing},
    },
    text::{counted, significant, thousands},
};

/// The measurements of one scene, with a heading and the verdict.
pub fn table(report: &Report) -> String {
    let heading = ["integrator", "dt [s]", "steps", "error [R]", "order", "run time [ms]", "vertex-steps [M/s]"];
    let families = report.measurements.chunk_by(|a, b| a.scheme.family() == b.scheme.family());
    // a blank line above each family
    let blank = || std::iter::once([(); 7].map(|()| String::new()));
    let rows = families.flat_map(|family| blank().chain(family.iter().map(|measured| row(report, measured))));
    format!(
        "{}: {}, {}, {} s in steps of {:.6} s\n\n{}\n\n{}\n\
         reference: extrapolation (Gragg, Bulirsch, Stoer), restarted at events, contacts, rims and cores; with a tenth of \
         the tolerance and half the step it changes by {:.0e} R",
        report.scene,
        counted(report.bodies as u64, "body"),
        counted(report.vertices, "vertex"),
        report.duration,
        report.dt,
        tables::table(heading, rows),
        report.verdict().join("\n"),
        report.agreement
    )
}

fn row(report: &Report, measurement: &Measurement) -> [String; 7] {
    let resolution = report.resolution();
    [
        measurement.scheme.to_string(),
        format!("{:.6}", measurement.dt),
        thousands(measurement.steps),
        match measurement.error {
            None => "diverged".to_owned(),
            Some(error) if error < resolution => format!("< {resolution:.0e}"),
            Some(error) => format!("{error:.2e}"),
        },
        // rounded first, to avoid a negative zero
        measurement.order.map_or_else(missing, |order| format!("{:.2}", (100.0 * order).round() / 100.0 + 0.0)),
        significant(1e3 * measurement.seconds),
        format!("{:.1}", 1e-6 * report.vertex_steps_per_second(measurement)),
    ]
}

/// The meaning of the columns of all tables, and the machine on which they were measured.
pub fn footer(machine: &Machine) -> String {
    format!(
        "error: the largest over time and vertices, in radii; order: relative to the previous step size; \
         run time: of the steps alone, median of 5 runs or more\n{machine}"
    )
}
