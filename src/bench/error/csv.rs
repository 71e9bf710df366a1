//! Measurements as CSV.

use serde::Serialize;

use super::{Report, Scheme};
use crate::bench::{machine::Machine, tables};

#[derive(Serialize)]
struct Row<'a> {
    scene: &'a str,
    vertices: u64,
    integrator: &'a str,
    tolerance_per_s: Option<f64>,
    dt_s: f64,
    steps: u64,
    error_radii: f64,
    order: Option<f64>,
    run_time_ms: f64,
    runs: usize,
    vertex_steps_per_s: f64,
    cpu: &'a str,
    version: &'a str,
}

/// All measurements. `error_radii` is `inf` for a run that diverged; fields that do not apply are empty.
///
/// # Errors
/// None is known to occur.
pub fn csv(reports: &[Report], machine: &Machine) -> Result<String, String> {
    let all = reports.iter().flat_map(|report| report.measurements.iter().map(move |measured| (report, measured)));
    tables::csv(all.map(|(report, measured)| Row {
        scene: &report.scene,
        vertices: report.vertices,
        integrator: measured.scheme.integrator().name(),
        tolerance_per_s: match measured.scheme {
            Scheme::Fixed(_) => None,
            Scheme::Controlled { tolerance } => Some(tolerance),
        },
        dt_s: measured.dt,
        steps: measured.steps,
        error_radii: measured.error.unwrap_or(f64::INFINITY),
        order: measured.order,
        run_time_ms: 1e3 * measured.seconds,
        runs: measured.runs,
        vertex_steps_per_s: report.vertex_steps_per_second(measured).round(),
        cpu: &machine.cpu,
        version: machine.version,
    }))
}
