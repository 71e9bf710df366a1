//! A run of an experiment that is not a scene.

use std::sync::atomic::AtomicBool;

use super::{
    Sweep,
    row::{Cell, final_scalars, without_results},
    run::{Interrupted, MAX_EVENTS},
};
use crate::{
    interrupt::is_raised,
    observe::{Frame, Run, StepFailure, Want},
    scene::template::Setting,
};

/// Runs a point, and adds the cells of its results and of its failure.
///
/// # Errors
/// The run was interrupted.
pub fn run(
    sweep: &Sweep,
    point: &[Setting],
    interrupt: Option<&AtomicBool>,
    cells: &mut Vec<Cell>,
) -> Result<(), Interrupted> {
    let started = match sweep.own(point) {
        Some(Ok(experiment)) => experiment.start().map(|simulation| (experiment.schema(), simulation)),
        Some(Err(invalid)) => Err(invalid.to_string()),
        None => Err("the sweep is of a scene".to_owned()),
    };
    let (schema, simulation) = match started {
        Ok(started) => started,
        Err(reason) => {
            cells.extend(without_results(sweep, reason));
            return Ok(());
        }
    };
    let mut run = Run::new(simulation, Some(schema.steps));
    let (mut events, mut times, mut count) = (Vec::new(), Vec::new(), 0);
    while run.step() {
        if is_raised(interrupt) {
            return Err(Interrupted);
        }
        for event in &run.summary.events {
            count += 1;
            if events.len() < MAX_EVENTS {
                events.push(event.name);
                times.push(event.time);
            }
        }
    }
    if let Some(StepFailure::Interrupted(_)) = run.failure {
        return Err(Interrupted);
    }
    let (simulation, mut frame) = (&*run.simulation, Frame::default());
    simulation.observe(Want { scalars: true, forces: false }, &mut frame);
    let events = events.join(" ");
    cells.push(match run.failure {
        None if events.is_empty() => Cell::Text("none".to_owned()),
        None => Cell::Text(events.clone()),
        Some(_) => Cell::Null,
    });
    cells.extend([Cell::Text(events), Cell::List(times), Cell::Integer(count)]);
    cells.extend([Cell::Integer(simulation.steps_taken() as i64), Cell::Float(simulation.time())]);
    cells.push(Cell::Count(simulation.checksum()));
    let scalar = |index: usize| frame.scalars.get(index).filter(|value| !value.is_nan());
    cells
        .extend(final_scalars(&schema).map(|(index, _)| scalar(index).map_or(Cell::Null, |&value| Cell::Float(value))));
    cells.push(run.cause().map_or(Cell::Null, Cell::Text));
    Ok(())
}
