//! Comparison of the events of two runs.

use std::collections::BTreeMap;
use std::fmt;

use super::recorded::RecordedEvent;
use crate::{
    observe::{PairEvent, Schema, SurfaceEvent, schema::titled},
    text::significant,
};

/// Times of an event that are at most this far apart are equal [s]. Those at which surfaces touch or part are found to a
/// tenth of it.
pub const SAME_TIME: f64 = 1e-6;

/// How an event differs between two runs.
#[derive(Clone, Debug, PartialEq)]
pub enum Change {
    /// Both runs have it, at different times.
    Moved(RecordedEvent, RecordedEvent),
    /// Only the first run has it.
    Vanished(RecordedEvent),
    /// Only the second run has it.
    Appeared(RecordedEvent),
    /// Both runs have it, but in a different order relative to other events.
    Reordered(RecordedEvent),
}

impl Change {
    /// The event, in the run that has it; in the first, if both have.
    pub fn event(&self) -> &RecordedEvent {
        match self {
            Change::Moved(event, _) | Change::Vanished(event) | Change::Appeared(event) | Change::Reordered(event) => {
                event
            }
        }
    }

    /// How it differs, in words.
    pub fn how(&self) -> String {
        match self {
            Change::Moved(was, is) => is.delay(was),
            Change::Vanished(_) => "vanished".to_owned(),
            Change::Appeared(_) => "appeared".to_owned(),
            Change::Reordered(_) => "in another order".to_owned(),
        }
    }
}

/// The changes to list first, at most `most`: all in order of time, or else what only one run has, and the largest moves.
pub fn listed(changes: &[Change], most: usize) -> Vec<&Change> {
    let mut listed: Vec<&Change> = changes.iter().collect();
    if listed.len() > most {
        let size = |change: &Change| match change {
            Change::Moved(was, is) => (is.time - was.time).abs(),
            Change::Vanished(_) | Change::Appeared(_) => f64::INFINITY,
            Change::Reordered(_) => 0.0,
        };
        listed.sort_by(|x, y| size(y).total_cmp(&size(x)));
        listed.truncate(most);
    }
    listed
}

impl fmt::Display for Change {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Change::Moved(was, is) => write!(f, "moved: {was}, now at {:.9} s, {}", is.time, is.delay(was)),
            _ => write!(f, "{}: {}", self.how(), self.event()),
        }
    }
}

impl fmt::Display for RecordedEvent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} at t = {:.9} s (step {})", self.what(), self.time, self.step)
    }
}

impl RecordedEvent {
    /// Whether surfaces touch or part in it, which changes no phase.
    pub fn is_contact(&self) -> bool {
        self.phases.iter().all(String::is_empty)
    }

    /// Its kind and pair, in words.
    pub fn what(&self) -> String {
        titled(&self.name, &self.pair)
    }

    /// How much later or earlier it is than another event, in words.
    pub fn delay(&self, than: &RecordedEvent) -> String {
        let later = self.time - than.time;
        format!("{} s {}", significant(later.abs()), if later > 0.0 { "later" } else { "earlier" })
    }

    /// Converts an event to its recorded form.
    pub fn of(schema: &Schema, event: &PairEvent) -> RecordedEvent {
        RecordedEvent {
            name: event.name.to_owned(),
            pair: schema.pair_name(event.a, event.b),
            phases: [event.from, event.to].map(|phase| schema.phases[phase].name.to_owned()),
            q: event.q,
            time: event.time,
            step: event.step,
        }
    }

    /// Converts an event of surfaces that touch or part to its recorded form.
    pub fn of_contact(schema: &Schema, event: &SurfaceEvent) -> RecordedEvent {
        RecordedEvent {
            name: event.name().to_owned(),
            pair: schema.pair_name(event.a, event.b),
            phases: Default::default(),
            q: event.q,
            time: event.time,
            step: event.step,
        }
    }
}

/// Compares the events of two runs. The n-th event of a kind of a pair in one run corresponds to the n-th in the other.
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
            // two events at the same instant may be in either order
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
    changes.sort_by(|a, b| a.event().time.total_cmp(&b.event().time));
    changes
}
