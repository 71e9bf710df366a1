//! Measurements of an earlier version of the program, drawn beside this one's.
//!
//! Run times of different machines are not comparable. Those of the earlier version are therefore in units of the run
//! time of `rk4`, which does the same work per step in both versions. Its runs are long, so a busy machine interrupts
//! them more often than those of error control, and the earlier curve is then drawn too far to the right.

use std::sync::LazyLock;

use serde::Deserialize;

use super::{Report, Scheme};
use crate::scene::Integrator;

/// The commit of that version: the last one before steps were made cheaper, at the same accuracy.
pub const COMMIT: &str = "d8ab73b";

/// Its measurements of `rk4` and of error control: the smallest medians of four runs of `bench error two --csv`.
static ROWS: LazyLock<Vec<Row>> = LazyLock::new(|| {
    let text = include_str!("../../../recordings/error_before.csv");
    csv::Reader::from_reader(text.as_bytes()).deserialize().filter_map(Result::ok).collect()
});

#[derive(Deserialize)]
struct Row {
    scene: String,
    vertices: u64,
    integrator: String,
    tolerance_per_s: Option<f64>,
    dt_s: f64,
    steps: u64,
    error_radii: f64,
    run_time_ms: f64,
}

/// The curve of error control of the earlier version: run times [s] and errors [radii]. Empty if it did not measure this
/// scene, or if this report has no run time of `rk4`.
pub fn curve(report: &Report) -> Vec<(f64, f64)> {
    let rk4 = |scheme: Scheme| scheme == Scheme::Fixed(Integrator::Rk4);
    let now = report.measurements.iter().find(|it| rk4(it.scheme) && report.is_at_own_step(it));
    let Some(now) = now else { return Vec::new() };
    let of_scene = || {
        ROWS.iter().filter(|row| {
            row.scene == report.scene
                && row.vertices == report.vertices
                && row.steps == now.steps
                && (row.dt_s / report.dt - 1.0).abs() < 1e-9
        })
    };
    let Some(then) = of_scene().find(|row| row.integrator == Integrator::Rk4.name()) else { return Vec::new() };
    let controlled = of_scene().filter(|row| row.tolerance_per_s.is_some());
    controlled.map(|row| (row.run_time_ms / then.run_time_ms * now.seconds, row.error_radii)).collect()
}

#[cfg(test)]
mod tests {
    use super::{super::Measurement, *};

    /// A report of the built-in scene `two` in which only `rk4` was measured.
    fn report(steps: u64) -> Report {
        let rk4 = Measurement {
            scheme: Scheme::Fixed(Integrator::Rk4),
            dt: 5.0 / steps as f64,
            steps,
            error: Some(1e-2),
            share: None,
            order: None,
            seconds: 0.5,
            runs: 1,
        };
        Report {
            scene: "two".to_owned(),
            is_coupled: false,
            dt: rk4.dt,
            tolerance: 1e-6,
            duration: 5.0,
            bodies: 2,
            vertices: 532,
            agreement: 1e-14,
            measurements: vec![rk4],
        }
    }

    #[test]
    fn run_times_are_in_units_of_those_of_rk4() {
        let curve = curve(&report(300));
        assert_eq!(curve.len(), 9, "tolerances from 1e-3 to 1e-11");
        assert!(curve.iter().all(|&(seconds, error)| (1e-3..0.4).contains(&seconds) && error < 1e-7), "{curve:?}");
        assert!(curve.last() > curve.first(), "a tighter tolerance takes longer: {curve:?}");
    }

    #[test]
    fn other_scenes_have_no_earlier_curve() {
        assert!(curve(&report(301)).is_empty());
        assert!(curve(&Report { scene: "mine".to_owned(), ..report(300) }).is_empty());
        assert!(curve(&Report { measurements: Vec::new(), ..report(300) }).is_empty());
    }
}
