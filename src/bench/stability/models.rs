//! What the other models endure: the cases of the sweep, each with one of them.
//!
//! A case that ends for a reason that is said is not a defect; a state that is not finite and is not said to be so is one.

use std::time::{Duration, Instant};

use rayon::prelude::*;

use super::cases::{Axis, Case};
use crate::{
    bench::{MeasureError, tables},
    models::SceneRun,
    observe::{Experiment as _, Frame, StepFailure, StepSummary, Want},
    scene::{Integrator, Model},
    sim::Options,
};

/// Steps of a case at most.
const MOST_STEPS: u64 = 60;
/// Time of a case at most; it ends after the step in which that is over.
const MOST_TIME: Duration = Duration::from_millis(300);
/// Cells along a diameter: what bodies endure is hardly a matter of how many there are, what it takes is.
const CELLS: u32 = 3;

/// How a case ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// All steps were taken.
    Endured,
    /// As many as there was time for.
    Cut,
    /// The model says at the start that it cannot run the scene.
    Refused,
    /// It diverged, and said so.
    Diverged,
    /// It did not take a step, and said why.
    NotTaken,
    /// A state is not finite, and nothing was said.
    Defect,
}

impl End {
    const ALL: [End; 6] = [End::Endured, End::Cut, End::Refused, End::Diverged, End::NotTaken, End::Defect];
}

/// The end of each case, by its number.
pub type Ends = Vec<(Axis, End)>;

/// Runs the first cases with a model. Where the limits of its own steps allow it, they are divided.
///
/// # Errors
/// A case is not a valid scene.
pub fn measure(model: Model, cases: u64, progress: &(dyn Fn() + Sync)) -> Result<Ends, MeasureError> {
    let of = |index: u64| {
        let mut case = Case::new(index)?;
        case.scene.model = model;
        case.scene.integrator = Integrator::Exponential;
        (case.scene.lattice.cells, case.scene.fem.cells) = (CELLS, CELLS);
        let end = end(&SceneRun { scene: case.scene, options: Options::default() });
        progress();
        Ok((case.axis, end))
    };
    (0..cases).into_par_iter().map(of).collect()
}

fn end(run: &SceneRun) -> End {
    let Ok(mut simulation) = run.start() else { return End::Refused };
    let (mut summary, mut frame, start) = (StepSummary::default(), Frame::default(), Instant::now());
    for _ in 0..run.scene.steps().min(MOST_STEPS) {
        simulation.step();
        simulation.summary(&mut summary);
        match &summary.failure {
            Some(StepFailure::Diverged(_)) => return End::Diverged,
            Some(_) => return End::NotTaken,
            None => {}
        }
        simulation.observe(Want::default(), &mut frame);
        if !frame.bodies.iter().all(|body| body.centre.is_finite() && body.max_displacement.is_finite()) {
            return End::Defect;
        }
        if start.elapsed() > MOST_TIME {
            return End::Cut;
        }
    }
    End::Endured
}

/// The ends by axis.
pub fn table(ends: &Ends) -> String {
    let heading = ["axis", "cases", "endured", "cut short", "refused", "diverged, said", "not taken, said", "defects"];
    let line = |name: &str, axis: Option<Axis>| {
        let of_axis = || ends.iter().filter(|(of, _)| axis.is_none_or(|axis| axis == *of));
        let counts = End::ALL.map(|end| of_axis().filter(|(_, of)| *of == end).count().to_string());
        [name.to_owned(), of_axis().count().to_string()].into_iter().chain(counts).collect::<Vec<_>>()
    };
    let axes = Axis::SHARES.iter().map(|(axis, _)| line(axis.name(), Some(*axis)));
    tables::table(heading, axes.chain([line("all", None)]))
}
