//! Measurements as a table for people.

use super::{Measurement, Report};
use crate::{bench::machine::Machine, stream::sinks::thousands};

/// The measurements of one scene, aligned, with a heading and the verdict.
pub fn table(report: &Report) -> String {
    let heading = ["integrator", "dt [s]", "steps", "error [R]", "order", "run time [ms]", "vertex-steps [M/s]"];
    let mut rows = vec![heading.map(str::to_owned)];
    rows.extend(report.measurements.iter().map(|measurement| row(report, measurement)));
    let widths: [usize; 7] = std::array::from_fn(|column| {
        rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0) //
    });

    let mut lines = vec![format!(
        "{}: {} {}, {} vertices, {} s in steps of {:.6} s",
        report.scene,
        report.bodies,
        if report.bodies == 1 { "body" } else { "bodies" },
        thousands(report.vertices),
        report.duration,
        report.dt,
    )];
    let mut family = None;
    for (k, row) in rows.iter().enumerate() {
        let this = k.checked_sub(1).map(|k| report.measurements[k].scheme.family());
        if this != family || k == 0 {
            lines.push(String::new());
            family = this;
        }
        let cell = |(column, text): (usize, &String)| {
            let padding = " ".repeat(widths[column] - text.chars().count());
            if column == 0 { format!("{text}{padding}") } else { format!("  {padding}{text}") }
        };
        lines.push(row.iter().enumerate().map(cell).collect::<String>().trim_end().to_owned());
    }
    lines.push(String::new());
    lines.extend(report.verdict());
    lines.push(format!(
        "reference: extrapolation (Gragg, Bulirsch, Stoer), restarted at events and rims; with a tenth of the tolerance \
         and half the step it moves by {:.0e} R",
        report.agreement
    ));
    lines.join("\n")
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
        // rounded first, so that no zero is negative
        measurement.order.map_or("–".to_owned(), |order| format!("{:.2}", (100.0 * order).round() / 100.0 + 0.0)),
        significant(1e3 * measurement.seconds),
        format!("{:.1}", 1e-6 * report.vertex_steps_per_second(measurement)),
    ]
}

/// What the numbers of all tables mean, and where they were measured.
pub fn footer(machine: &Machine) -> String {
    format!(
        "error: the largest over time and vertices, in radii; order: against the step before; \
         run time: of the steps alone, median of 5 runs or more\n{machine}"
    )
}

/// Three significant digits.
pub(in crate::bench) fn significant(x: f64) -> String {
    let digits = 2 - x.abs().log10().floor().clamp(-9.0, 2.0) as i32;
    format!("{x:.*}", digits as usize)
}
