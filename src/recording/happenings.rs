//! The events of two runs beside each other.

use std::collections::BTreeMap;
use std::fmt;

use super::recorded::Happened;
use crate::{scene::Scene, sim::Event, stream::recorder::pair_name};

/// Times of one event that are no farther apart are the same [s].
pub const SAME_TIME: f64 = 1e-6;

/// How an event differs between two runs.
#[derive(Clone, Debug, PartialEq)]
pub enum Change {
    /// It is at another time.
    Moved(Happened, Happened),
    /// It is in the first only.
    Vanished(Happened),
    /// It is in the second only.
    Appeared(Happened),
    /// Both have it, and before and after it others than in the first run.
    Reordered(Happened),
}

impl Change {
    /// When it is, in the run that has it [s].
    pub fn time(&self) -> f64 {
        match self {
            Change::Moved(event, _) | Change::Vanished(event) | Change::Appeared(event) | Change::Reordered(event) => {
                event.time
            }
        }
    }
}

impl fmt::Display for Change {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Change::Moved(was, is) => {
                let later = is.time - was.time;
                let word = if later > 0.0 { "later" } else { "earlier" };
                write!(f, "moved: {was}, now at {:.9} s, {:.3e} s {word}", is.time, later.abs())
            }
            Change::Vanished(event) => write!(f, "vanished: {event}"),
            Change::Appeared(event) => write!(f, "appeared: {event}"),
            Change::Reordered(event) => write!(f, "in another order: {event}"),
        }
    }
}

impl fmt::Display for Happened {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {} at t = {:.9} s (step {})", self.name, self.pair, self.time, self.step)
    }
}

impl Happened {
    /// An event as a recording tells of it.
    pub fn of(scene: &Scene, event: &Event) -> Happened {
        Happened {
            name: event.name().to_owned(),
            pair: pair_name(scene, event.a as usize, event.b as usize),
            time: (event.time * 1e9).round() * 1e-9,
            step: event.step,
        }
    }
}

/// What differs between the events of two runs: the n-th of its kind of a pair in one is the n-th of it in the other.
pub fn compare(first: &[Happened], second: &[Happened]) -> Vec<Change> {
    let mut others: BTreeMap<(&str, &str), std::collections::VecDeque<(usize, &Happened)>> = BTreeMap::new();
    for (index, event) in second.iter().enumerate() {
        others.entry((&event.name, &event.pair)).or_default().push_back((index, event));
    }
    let mut changes = Vec::new();
    let mut latest = None;
    for event in first {
        match others.get_mut(&(event.name.as_str(), event.pair.as_str())).and_then(|queue| queue.pop_front()) {
            None => changes.push(Change::Vanished(event.clone())),
            Some((_, other)) if (other.time - event.time).abs() > SAME_TIME => {
                changes.push(Change::Moved(event.clone(), other.clone()));
            }
            // of two at one instant either may come first
            Some((index, other)) => {
                if let Some((last, time)) = latest
                    && index < last
                    && other.time + SAME_TIME < time
                {
                    changes.push(Change::Reordered(event.clone()));
                }
                latest = Some((index, other.time));
            }
        }
    }
    changes.extend(others.into_values().flatten().map(|(_, event)| Change::Appeared(event.clone())));
    changes.sort_by(|a, b| a.time().total_cmp(&b.time()));
    changes
}
