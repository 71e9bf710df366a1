//! Records a whole run: for programs that need no more control.

use super::{
    Pipeline, Recorder, Settings,
    blueprint::Tab,
    chunks::Audience,
    sinks::{Destinations, SinkError, Sinks},
};
use crate::observe::{Experiment, StepSummary};

/// Why a run was not recorded completely.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The experiment does not start; the text gives the reason.
    #[error("{0}")]
    Start(String),
    /// A destination cannot be opened, or failed.
    #[error(transparent)]
    Sink(#[from] SinkError),
    /// The recording failed during the run; as much as possible was saved.
    #[error("{0}")]
    Recording(String),
}

/// Runs an experiment and records it on a separate thread. Ends after [`Settings::steps`], or with the step at which
/// the simulation fails. Returns the number of frames.
///
/// # Errors
/// The experiment does not start, a destination cannot be opened, or recording fails.
pub fn record(
    experiment: &dyn Experiment,
    settings: Settings,
    destinations: &Destinations,
) -> Result<u64, RecordError> {
    let mut simulation = experiment.start().map_err(RecordError::Start)?;
    let mut sinks = Sinks::open(destinations)?;
    let steps = settings.steps.unwrap_or(experiment.schema().steps);
    let recorder = Recorder::new(&*simulation, settings);
    for message in recorder.blueprint(&*simulation) {
        sinks.send(message)?;
    }
    let mut pipeline = Pipeline::start(&*simulation, recorder, sinks)?;
    let mut summary = StepSummary::default();
    while simulation.steps_taken() < steps {
        simulation.step();
        simulation.summary(&mut summary);
        let is_whole_step = summary.failure.as_ref().is_none_or(|failure| failure.is_whole_step());
        if is_whole_step {
            pipeline.observe(&*simulation, None).map_err(RecordError::Recording)?;
        }
        if summary.failure.is_some() {
            break;
        }
    }
    let mut end = pipeline.finish().map_err(RecordError::Recording)?;
    if let Some(failure) = end.failure.take().or_else(|| end.finish(&*simulation)) {
        return Err(RecordError::Recording(failure));
    }
    for message in end.recorder.measured_layout(&*simulation, Tab::Scene) {
        end.sinks.send_to(Audience::Files, message)?;
    }
    let frames = end.recorder.written();
    end.sinks.finish()?;
    Ok(frames)
}
