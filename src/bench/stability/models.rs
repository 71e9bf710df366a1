//! Stability of the other models, on the cases of the sweep: a state that is not finite without a report is a failure.

use std::time::{Duration, Instant};

use rayon::prelude::*;

use super::{Judged, Verdict, cases::Case};
use crate::{
    bench::MeasureError,
    models::SceneRun,
    observe::{Experiment as _, Frame, Run, Want},
    scene::{Integrator, Model},
    sim::Options,
};

/// Upper limit on the steps of a case.
const MAX_STEPS: u64 = 60;
/// Time limit of a case, asked after each step.
const TIME_LIMIT: Duration = Duration::from_millis(300);
/// Cells along a diameter. Their number affects the cost, but hardly the stability.
const CELLS: u32 = 3;

/// Runs the first cases with a model.
///
/// # Errors
/// A case is not a valid scene.
pub fn measure(model: Model, cases: u64, progress: &(dyn Fn() + Sync)) -> Result<Vec<Judged>, MeasureError> {
    let run = |index: u64| {
        let mut case = Case::new(index)?;
        case.scene.model = model;
        case.scene.integrator = Integrator::Exponential;
        (case.scene.lattice.cells, case.scene.fem.cells) = (CELLS, CELLS);
        let verdict = verdict(&SceneRun { scene: case.scene, options: Options::default() });
        progress();
        let what = format!("case {index}: {}", case.what);
        Ok(Judged { axis: case.axis.name(), what, verdicts: vec![(model.name(), verdict)] })
    };
    (0..cases).into_par_iter().map(run).collect()
}

fn verdict(scene: &SceneRun) -> Verdict {
    let start = Instant::now();
    let simulation = match scene.start() {
        Ok(simulation) => simulation,
        Err(why) => return Verdict::Stopped(why),
    };
    let mut run = Run::new(simulation, Some(scene.scene.steps().min(MAX_STEPS)));
    let mut frame = Frame::default();
    loop {
        match run.valid_step() {
            Ok(true) => run.simulation.observe(Want::default(), &mut frame),
            Ok(false) => return Verdict::Passed,
            Err(failure) => return Verdict::Stopped(failure.to_string()),
        }
        if !frame.bodies.iter().all(|body| body.centre.is_finite() && body.max_displacement.is_finite()) {
            return Verdict::Failed("not finite, and not reported".to_owned());
        }
        if start.elapsed() > TIME_LIMIT {
            return Verdict::Stopped("the time limit".to_owned());
        }
    }
}
