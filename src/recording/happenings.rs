//! The events of two runs beside each other.

use std::collections::BTreeMap;
use std::fmt;

use super::recorded::RecordedEvent;
use crate::observe::{PairEvent, Schema};

/// Times of one event that are no farther apart are the same [s].
pub const SAME_TIME: f64 = 1e-6;

/// How an event differs between two runs.
#[derive(Clone, Debug, PartialEq)]
pub enum Change {
    /// It is at another time.
    Moved(RecordedEvent, RecordedEvent),
    /// It is in the first only.
    Vanished(RecordedEvent),
    /// It is in the second only.
    Appeared(RecordedEvent),
    /// Both have it, and before and after it others than in the first run.
    Reordered(RecordedEvent),
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

impl fmt::Display for RecordedEvent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {} at t = {:.9} s (step {})", self.name, self.pair, self.time, self.step)
    }
}

impl RecordedEvent {
    /// An event as a recording tells of it.
    pub fn of(schema: &Schema, event: &PairEvent) -> RecordedEvent {
        RecordedEvent {
            name: event.name.to_owned(),
            pair: schema.pair_name(event.a, event.b),
            phases: Some([event.from, event.to].map(|phase| schema.phases[phase].name.to_owned())),
            q: Some(event.q),
            time: event.time,
            step: event.step,
        }
    }
}

/// What differs between the events of two runs: the n-th of its kind of a pair in one is the n-th of it in the other.
pub fn compare(first: &[RecordedEvent], second: &[RecordedEvent]) -> Vec<Change> {
    let mut others: BTreeMap<(&str, &str), std::collections::VecDeque<(usize, &RecordedEvent)>> = BTreeMap::new();
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
