//! Stability of the other models, on the cases of the sweep.
//!
//! A case that ends with a reported reason is not a defect; an unreported non-finite state is.

use std::{
    sync::{
        atomic::{AtomicBool, Ordering},
        mpsc::{self, RecvTimeoutError},
    },
    time::Duration,
};

use rayon::prelude::*;

use super::cases::{Axis, Case};
use crate::{
    bench::{MeasureError, tables},
    models::SceneRun,
    observe::{Experiment as _, Frame, StepFailure, StepSummary, Want},
    scene::{Integrator, Model},
    sim::Options,
};

/// Upper limit on the steps of a case.
const MAX_STEPS: u64 = 60;
/// Time limit of a case.
const TIME_LIMIT: Duration = Duration::from_millis(300);
/// Cells along a diameter. Their number affects the cost, but hardly the stability.
const CELLS: u32 = 3;

/// How a case ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// All steps were taken.
    Completed,
    /// It was interrupted at the time limit.
    Cut,
    /// The model rejected the scene at the start.
    Rejected,
    /// It diverged, and reported it.
    Diverged,
    /// It did not complete a step, and reported why.
    NotTaken,
    /// A state is not finite, without a report.
    Defect,
}

impl End {
    const ALL: [End; 6] = [End::Completed, End::Cut, End::Rejected, End::Diverged, End::NotTaken, End::Defect];
}

/// Axis and end of each case, in order of case number.
pub type Ends = Vec<(Axis, End)>;

/// Runs the first cases with a model.
///
/// # Errors
/// A case is not a valid scene.
pub fn measure(model: Model, cases: u64, progress: &(dyn Fn() + Sync)) -> Result<Ends, MeasureError> {
    let run = |index: u64| {
        let mut case = Case::new(index)?;
        case.scene.model = model;
        case.scene.integrator = Integrator::Exponential;
        (case.scene.lattice.cells, case.scene.fem.cells) = (CELLS, CELLS);
        let end = timed(|interrupt| {
            end(&SceneRun { scene: case.scene, options: Options { interrupt: Some(interrupt), ..Options::default() } })
        });
        progress();
        Ok((case.axis, end))
    };
    (0..cases).into_par_iter().map(run).collect()
}

/// Runs a case, and interrupts it at the time limit.
fn timed(case: impl FnOnce(&'static AtomicBool) -> End) -> End {
    thread_local! {
        // interrupt flags are leaked: one per thread
        static INTERRUPT: &'static AtomicBool = Box::leak(Box::new(AtomicBool::new(false)));
    }
    let interrupt = INTERRUPT.with(|interrupt| *interrupt);
    interrupt.store(false, Ordering::Relaxed);
    std::thread::scope(|scope| {
        let (done, ended) = mpsc::channel::<()>();
        scope.spawn(move || {
            if ended.recv_timeout(TIME_LIMIT) == Err(RecvTimeoutError::Timeout) {
                interrupt.store(true, Ordering::Relaxed);
            }
        });
        let end = case(interrupt);
        drop(done);
        if interrupt.load(Ordering::Relaxed) && end != End::Defect { End::Cut } else { end }
    })
}

fn end(run: &SceneRun) -> End {
    let Ok(mut simulation) = run.start() else { return End::Rejected };
    let (mut summary, mut frame) = (StepSummary::default(), Frame::default());
    for _ in 0..run.scene.steps().min(MAX_STEPS) {
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
    }
    End::Completed
}

/// Table of the ends by axis.
pub fn table(ends: &Ends) -> String {
    let heading = ["axis", "cases", "completed", "cut short", "rejected", "diverged", "step not taken", "defects"];
    let line = |name: &str, axis: Option<Axis>| {
        let of_axis = || ends.iter().filter(|(of, _)| axis.is_none_or(|axis| axis == *of));
        let counts = End::ALL.map(|end| of_axis().filter(|(_, of)| *of == end).count().to_string());
        [name.to_owned(), of_axis().count().to_string()].into_iter().chain(counts).collect::<Vec<_>>()
    };
    let axes = Axis::SHARES.iter().map(|(axis, _)| line(axis.name(), Some(*axis)));
    tables::table(heading, axes.chain([line("all", None)]))
}
