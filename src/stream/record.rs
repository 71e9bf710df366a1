//! Records a whole run: for programs that need no more control.

use super::{
    Pipeline, Recorder, Settings,
    blueprint::Tab,
    sinks::{Destinations, SinkError, Sinks},
};
use crate::observe::{Experiment, Run, Simulation};

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
/// the simulation fails, whose cause is then in the recording. Returns the number of frames.
///
/// # Errors
/// The experiment does not start, a destination cannot be opened, or recording fails.
pub fn record(
    experiment: &dyn Experiment,
    settings: Settings,
    destinations: &Destinations,
) -> Result<u64, RecordError> {
    record_all([(experiment, settings)], destinations)
}

/// Runs experiments one after the other, as [`record`] does, and sends each as a recording of its own to the same
/// destinations: a file then holds them all. Returns the number of frames of all.
///
/// # Errors
/// An experiment does not start, a destination cannot be opened, or recording fails.
pub fn record_all<'a>(
    experiments: impl IntoIterator<Item = (&'a dyn Experiment, Settings)>,
    destinations: &Destinations,
) -> Result<u64, RecordError> {
    let (mut sinks, mut frames) = (None, 0);
    for (experiment, settings) in experiments {
        let steps = settings.steps.unwrap_or(experiment.schema().steps);
        let simulation = experiment.start().map_err(RecordError::Start)?;
        let open = match sinks.take() {
            Some(open) => open,
            None => Sinks::open(destinations)?,
        };
        let (recorded, open) = record_to(simulation, steps, settings, open)?;
        frames += recorded;
        sinks = Some(open);
    }
    sinks.map(Sinks::finish).transpose()?;
    Ok(frames)
}

/// Records a simulation. Returns the number of frames, and the sinks for what follows.
pub fn record_to(
    simulation: Box<dyn Simulation>,
    steps: u64,
    settings: Settings,
    sinks: Sinks,
) -> Result<(u64, Sinks), RecordError> {
    let recorder = Recorder::new(&*simulation, settings).map_err(RecordError::Start)?;
    let mut pipeline = Pipeline::start(&*simulation, recorder, sinks, Tab::Scene)?;
    let mut run = Run::new(simulation, Some(steps));
    while run.step() && pipeline.observe(&*run.simulation, &run.summary, None) {}
    let end = pipeline.finish(&*run.simulation, run.cause().as_deref()).map_err(RecordError::Recording)?;
    match end.failure {
        Some(failure) => Err(RecordError::Recording(failure)),
        None => Ok((end.recorder.written(), end.sinks)),
    }
}
