//! The values of a parameter at which the outcome of a run changes.

use serde::Serialize;

use super::outline::outcome_of;
use crate::observe::{Experiment, StepSummary, Variation};

/// Number of values for which the outcome is found first.
const SAMPLES: usize = 24;
/// Bisection stops at this fraction of the parameter's range, or after [`MAX_RUNS`].
const RESOLUTION: f64 = 1e-4;

/// Upper limit on the number of runs: where outcomes are chaotic, each of them has more between its neighbours.
const MAX_RUNS: usize = 256;

/// A value at which the outcome changes.
#[derive(Serialize)]
pub struct Mark {
    value: f64,
    below: String,
    above: String,
}

/// Finds the values of a parameter, in its range, at which the outcome of a run changes: by bisection, wherever it
/// differs between two of `SAMPLES` values. Leaves out what [`MAX_RUNS`] do not resolve. Returns no marks for an
/// unknown parameter, and `None` if `is_current` says that the result is no longer needed.
pub fn find(
    experiment: &dyn Experiment,
    variation: &Variation,
    key: &str,
    is_current: &dyn Fn() -> bool,
) -> Option<Vec<Mark>> {
    let parameters = experiment.parameters();
    let Some([low, high]) = parameters.iter().find(|parameter| parameter.key == key).map(|parameter| parameter.range)
    else {
        return Some(Vec::new());
    };
    let outcome = |value: f64| {
        let mut variation = variation.clone();
        variation.values.insert(key.to_owned(), value);
        outcome(experiment, &variation, is_current)
    };
    let at = |k: usize| low + (high - low) * k as f64 / (SAMPLES - 1) as f64;
    let samples = (0..SAMPLES).map(|k| Some((at(k), outcome(at(k))?))).collect::<Option<Vec<_>>>()?;
    let (mut marks, mut runs) = (Vec::new(), SAMPLES);
    for pair in samples.windows(2) {
        let [(a, Outcome::Ended(below)), (b, Outcome::Ended(above))] = pair else { continue };
        let (mut a, mut below) = (*a, below.clone());
        // ends of intervals that are still to be searched, the nearest last, each with its outcome
        let mut ends = vec![(*b, above.clone())];
        while let Some((b, above)) = ends.pop() {
            let is_narrow = b - a <= RESOLUTION * (high - low);
            if below == above || runs >= MAX_RUNS || is_narrow {
                if below != above && is_narrow {
                    marks.push(Mark { value: 0.5 * (a + b), below, above: above.clone() });
                }
                (a, below) = (b, above);
                continue;
            }
            let middle = 0.5 * (a + b);
            runs += 1;
            match outcome(middle)? {
                Outcome::Ended(found) if found == below => {
                    a = middle;
                    ends.push((b, above));
                }
                Outcome::Ended(found) if found == above => ends.push((middle, above)),
                Outcome::Ended(found) => ends.extend([(b, above), (middle, found)]),
                // nothing is known in between
                Outcome::None => (a, below) = (b, above),
            }
        }
    }
    Some(marks)
}

enum Outcome {
    /// How often each kind of event happens.
    Ended(String),
    /// The values are invalid, or the run fails.
    None,
}

/// `None` if the result is no longer needed.
fn outcome(experiment: &dyn Experiment, variation: &Variation, is_current: &dyn Fn() -> bool) -> Option<Outcome> {
    // what else is asked for interrupts a run, which then fails
    let none = || is_current().then_some(Outcome::None);
    let Ok(varied) = experiment.varied(variation) else { return none() };
    let Ok(mut simulation) = varied.start() else { return none() };
    let (steps, mut events, mut summary) = (simulation.schema().steps, Vec::new(), StepSummary::default());
    while simulation.steps_taken() < steps {
        if !is_current() {
            return None;
        }
        summary.clear();
        simulation.step(&mut summary);
        events.append(&mut summary.events);
        if summary.failure.is_some() {
            return none();
        }
    }
    Some(Outcome::Ended(outcome_of(events.iter().map(|event| event.name))))
}

#[cfg(test)]
mod tests {
    use std::{
        cell::Cell,
        sync::atomic::{AtomicBool, Ordering},
    };

    use super::*;
    use crate::{Scene, models::SceneRun, sim::Options};

    static INTERRUPT: AtomicBool = AtomicBool::new(false);

    /// Something else is asked for while the last step of all runs is taken.
    #[test]
    fn a_search_that_is_interrupted_at_its_end_finds_nothing() {
        let text = "duration = 0.05\n[[body]]\nname = 'a'\nradius = 1.0\nmotion = { free = { from = [0, 0, 0] } }\n\
                    [[body]]\nname = 'b'\nradius = 1.0\nmotion = { free = { from = [2.3, 0, 0] } }\n";
        let options = Options { interrupt: Some(&INTERRUPT), ..Options::default() };
        let run = SceneRun { scene: Scene::parse(text, "pair.toml").unwrap(), options };
        let (looks, last) = (Cell::new(0), Cell::new(usize::MAX));
        let is_current = || {
            looks.set(looks.get() + 1);
            INTERRUPT.store(looks.get() >= last.get(), Ordering::Relaxed);
            looks.get() <= last.get()
        };
        let find = || find(&run, &Variation::default(), "influence.alpha", &is_current).is_some();
        assert!(find());
        last.set(looks.replace(0));
        assert!(!find());
    }
}
