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

    /// A remark on an event that only one run has, shortly before the last time that both reach; `common` is the first and the
    /// last such time [s].
    pub fn remark(&self, [start, end]: [f64; 2]) -> Option<String> {
        /// Of the time in common.
        const LATE: f64 = 0.1;

        let (Change::Vanished(event) | Change::Appeared(event)) = self else { return None };
        let is_late = end - event.time < LATE * (end - start);
        is_late.then(|| format!("the runs are compared up to {end:.3} s: it may come later in the other"))
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

/// For each of some times, the index of its counterpart among at least as many others; both in ascending order. The
/// differences in time add up to the least.
fn counterparts(times: &[f64], others: &[f64]) -> Vec<usize> {
    /// Upper limit on the sums to compare; beyond it, each time has the other of the same number.
    const MOST: usize = 1 << 22;

    let shifts = others.len() - times.len() + 1;
    if shifts == 1 || times.len() * shifts > MOST {
        return (0..times.len()).collect();
    }
    // by shift: the least sum of the times so far, whose counterparts are shifted by no more, and the shift of the last one
    let (mut sums, mut last) = (vec![0.0; shifts], vec![0; times.len() * shifts]);
    for (number, time) in times.iter().enumerate() {
        let mut least = (f64::INFINITY, 0);
        for shift in 0..shifts {
            let sum = sums[shift] + (time - others[number + shift]).abs();
            if sum < least.0 {
                least = (sum, shift);
            }
            (sums[shift], last[number * shifts + shift]) = least;
        }
    }
    let mut shift = shifts - 1;
    let mut found: Vec<usize> = (0..times.len()).collect();
    for number in found.iter_mut().rev() {
        shift = last[*number * shifts + shift];
        *number += shift;
    }
    found
}

/// Compares the events of two runs. As many events of a kind of a pair as there are in both correspond to each other, in
/// their order, so that their differences in time add up to the least.
pub fn compare(first: &[RecordedEvent], second: &[RecordedEvent]) -> Vec<Change> {
    let mut kinds: BTreeMap<(&str, &str), [Vec<usize>; 2]> = BTreeMap::new();
    for (side, events) in [first, second].into_iter().enumerate() {
        for (index, event) in events.iter().enumerate() {
            kinds.entry((&event.name, &event.pair)).or_default()[side].push(index);
        }
    }
    let mut others = vec![None; first.len()];
    let mut is_matched = vec![false; second.len()];
    for [of_first, of_second] in kinds.values() {
        let times = of_first.iter().map(|&index| first[index].time).collect::<Vec<_>>();
        let other_times = of_second.iter().map(|&index| second[index].time).collect::<Vec<_>>();
        let pairs: Vec<(usize, usize)> = match times.len() <= other_times.len() {
            true => counterparts(&times, &other_times).into_iter().enumerate().collect(),
            false => counterparts(&other_times, &times).into_iter().enumerate().map(|(b, a)| (a, b)).collect(),
        };
        for (a, b) in pairs {
            others[of_first[a]] = Some(of_second[b]);
            is_matched[of_second[b]] = true;
        }
    }
    let mut changes = Vec::new();
    let mut latest = None;
    for (event, other) in first.iter().zip(others) {
        match other.map(|index| (index, &second[index])) {
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
    let appeared = second.iter().zip(is_matched).filter(|(_, is_matched)| !is_matched);
    changes.extend(appeared.map(|(event, _)| Change::Appeared(event.clone())));
    changes.sort_by(|a, b| a.event().time.total_cmp(&b.event().time));
    changes
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of more events than the other run has, those that are far from all of its events have no counterpart.
    #[test]
    fn events_correspond_to_the_nearest_in_order() {
        for (times, others, expected) in [
            (&[3.589][..], &[1.818, 3.538][..], &[1][..]),
            (&[1.0, 2.0], &[1.1, 1.2], &[0, 1]),
            (&[1.0, 2.0, 9.0], &[0.9, 1.4, 2.1, 5.0, 8.0, 9.5], &[0, 2, 5]),
            (&[], &[1.0], &[]),
        ] {
            assert_eq!(counterparts(times, others), expected);
        }
        // every choice of some of the others
        let mut random = crate::random::Random::new(1);
        for _ in 0..200 {
            let mut times = |count: usize| {
                let mut times: Vec<f64> = (0..count).map(|_| 9.0 * random.unit()).collect();
                times.sort_by(f64::total_cmp);
                times
            };
            let (times, others) = (times(3), times(7));
            let sum =
                |chosen: &[usize]| chosen.iter().zip(&times).map(|(&of, time)| (others[of] - time).abs()).sum::<f64>();
            let choices = (0..7).flat_map(|a| (a + 1..7).flat_map(move |b| (b + 1..7).map(move |c| [a, b, c])));
            let least = choices.map(|choice| sum(&choice)).fold(f64::INFINITY, f64::min);
            let found = counterparts(&times, &others);
            assert!(found.is_sorted() && (sum(&found) - least).abs() < 1e-12, "{times:?} {others:?} {found:?}");
        }
    }
}
