//! Measurements as comma-separated values: one row each, complete in itself.

use std::fmt::Write as _;

use super::{Judged, Point, Report, Run};
use crate::{
    bench::{error::csv::quoted, machine::Machine},
    sim::report::Stage,
};

/// The names of the columns.
pub const COLUMNS: [&str; 20] = [
    "family",
    "bodies",
    "touching_bodies",
    "active_bodies",
    "vertices",
    "way",
    "threads",
    "steps",
    "step_ms",
    "steps_per_s",
    "vertex_steps_per_s",
    "reached_vertices",
    "ns_per_reached_vertex",
    "memory_bytes",
    "reach_share",
    "events_share",
    "integrate_share",
    "error_radii",
    "cpu",
    "version",
];

/// A row for each scene, number of threads and way. What does not apply is empty.
pub fn csv(report: &Report, machine: &Machine) -> String {
    let mut text = COLUMNS.join(",");
    text.push('\n');
    let mut add = |point: &Point, way: &str, run: &Run, judged: Option<Judged>, memory: Option<usize>| {
        let mut row = vec![
            quoted(point.family.name()),
            point.bodies.to_string(),
            point.touching.to_string(),
            point.active.to_string(),
            point.vertices.to_string(),
            way.to_owned(),
            run.threads.to_string(),
            run.steps.to_string(),
            format!("{:.6}", 1e3 * run.seconds),
            format!("{:.3}", run.steps_per_second()),
            format!("{:.0}", point.vertices as f64 / run.seconds),
            format!("{:.1}", point.reached),
            format!("{:.3}", 1e9 * run.seconds / point.reached),
            memory.map_or(String::new(), |bytes| bytes.to_string()),
        ];
        row.extend(Stage::ALL.map(|stage| format!("{:.4}", run.stages[stage as usize])));
        row.push(judged.map_or(String::new(), |judged| format!("{:.4e}", judged.error)));
        row.extend([quoted(&machine.cpu), machine.version.to_owned()]);
        let _ = writeln!(text, "{}", row.join(",")); // into a string: cannot fail
    };
    for point in &report.points {
        add(point, "default", &point.one, point.judged, Some(point.memory));
        if let Some(all) = &point.all {
            add(point, "default", all, point.judged, Some(point.memory));
        }
        if let Some(plain) = &point.plain {
            add(point, "plain", &plain.run, plain.judged, None);
        }
    }
    text
}
