//! Measurements as CSV.

use serde::Serialize;

use super::{Judged, Point, Report, Run};
use crate::{
    bench::{machine::Machine, tables},
    sim::Stage,
};

#[derive(Serialize)]
struct Row<'a> {
    family: &'a str,
    bodies: usize,
    touching_bodies: usize,
    active_bodies: usize,
    vertices: u64,
    way: &'a str,
    threads: usize,
    steps: u64,
    step_ms: f64,
    steps_per_s: f64,
    vertex_steps_per_s: f64,
    reached_vertices: f64,
    ns_per_reached_vertex: f64,
    memory_bytes: Option<usize>,
    reach_share: f64,
    events_share: f64,
    integrate_share: f64,
    error_radii: Option<f64>,
    cpu: &'a str,
    version: &'a str,
}

/// One row per scene, number of threads and method. Fields that do not apply are empty.
///
/// # Errors
/// None is known to occur.
pub fn csv(report: &Report, machine: &Machine) -> Result<String, String> {
    let row = |point: &Point, way, run: &Run, judged: Option<Judged>, memory_bytes| {
        let [reach_share, events_share, integrate_share] = Stage::ALL.map(|stage| run.stages[stage as usize]);
        Row {
            family: point.family.name(),
            bodies: point.bodies,
            touching_bodies: point.touching,
            active_bodies: point.active,
            vertices: point.vertices,
            way,
            threads: run.threads,
            steps: run.steps,
            step_ms: 1e3 * run.seconds,
            steps_per_s: run.steps_per_second(),
            vertex_steps_per_s: (point.vertices as f64 / run.seconds).round(),
            reached_vertices: point.reached,
            ns_per_reached_vertex: 1e9 * run.seconds / point.reached,
            memory_bytes,
            reach_share,
            events_share,
            integrate_share,
            error_radii: judged.map(|judged| judged.error),
            cpu: &machine.cpu,
            version: machine.version,
        }
    };
    tables::csv(report.points.iter().flat_map(|point| {
        let plain = point.plain.as_ref().map(|plain| row(point, "plain", &plain.run, plain.judged, None));
        point.runs().map(|run| row(point, "default", run, point.judged, Some(point.memory))).chain(plain)
    }))
}
