//! The events and curves of a run: what a page shows before there is a picture.

use std::collections::BTreeMap;

use serde_json::{Value, json};

use super::change::Problem;
use crate::{
    colors::{self, hex},
    observe::{BodyEvent, EventRow, Frame, PairEvent, Schema, Simulation, StepSummary, SurfaceEvent, row::rows},
};

/// Largest number of pairs with a curve: those that come closest.
const CURVES: usize = 16;
/// Upper limit on the pairs among which they are chosen: the first that come within reach. Bounds the memory of a scene
/// of many bodies to a hundred megabytes.
const CANDIDATES: usize = 4096;
/// Largest number of instants at which thresholds that change are looked up.
const MAX_LEVELS: u64 = 2000;
/// Upper limit on the events that are sent: the first.
const MAX_EVENTS: usize = 2000;
/// Largest number of values in a curve.
const POINTS: u64 = 2000;

/// The events and curves of a run, as it goes.
pub struct Outline {
    /// What is simulated.
    pub schema: Schema,
    events: Vec<PairEvent>,
    bodies: Vec<BodyEvent>,
    /// q of each pair at the instants of a curve; shorter lists lack their end.
    curves: BTreeMap<[usize; 2], Vec<Option<f64>>>,
    /// Number of instants so far.
    instants: usize,
    /// Steps from one instant to the next.
    every: u64,
    /// Number of steps taken.
    pub steps: u64,
    /// Duration of the simulation alone [ms].
    pub simulated_ms: f64,
    /// Why the run ended early.
    pub failure: Option<String>,
    /// What is wrong with the change for which the run stands in.
    problem: Option<Problem>,
}

impl Outline {
    /// An empty outline of a run; of one that stands in for a change that is invalid, with what is wrong with that.
    pub fn new(schema: Schema, problem: Option<Problem>) -> Outline {
        Outline {
            every: schema.steps.div_ceil(POINTS).max(1),
            schema,
            events: Vec::new(),
            bodies: Vec::new(),
            curves: BTreeMap::new(),
            instants: 0,
            steps: 0,
            simulated_ms: 0.0,
            failure: None,
            problem,
        }
    }

    /// Takes in what happened in a step; returns whether it is an instant of the curves.
    pub fn step(&mut self, simulation: &dyn Simulation, summary: &StepSummary) -> bool {
        if let Some(failure) = &summary.failure {
            self.failure = Some(failure.to_string());
            if !failure.is_whole_step() {
                return false;
            }
        }
        self.events.extend_from_slice(&summary.events);
        self.bodies.extend_from_slice(&summary.body_events);
        self.steps = simulation.steps_taken();
        self.steps.is_multiple_of(self.every)
    }

    /// Takes in the state at an instant of the curves.
    pub fn frame(&mut self, frame: &Frame) {
        for pair in &frame.pairs {
            if self.curves.len() >= CANDIDATES && !self.curves.contains_key(&[pair.a, pair.b]) {
                continue;
            }
            let curve = self.curves.entry([pair.a, pair.b]).or_default();
            curve.resize(self.instants, None);
            curve.push(Some(pair.q).filter(|q| q.is_finite()));
        }
        self.instants += 1;
    }

    /// What is sent to pages; `contacts` are known once the run is recorded. `of_file` is what is wrong with a scene file that
    /// has changed meanwhile.
    pub fn answer(&self, number: u64, contacts: Option<&[SurfaceEvent]>, of_file: Option<Problem>) -> Value {
        let schema = &self.schema;
        let rows = rows(&self.events, contacts.unwrap_or_default(), &self.bodies);
        let events = rows.iter().take(MAX_EVENTS).map(|row| {
            let pair = row.pair().map(|([a, b], _)| schema.pair_name(a, b));
            let (color, whom) = match row {
                EventRow::Phase(event, _) => (schema.phases[event.to].color, pair.as_deref()),
                EventRow::Contact(_) => (colors::SILVER, pair.as_deref()),
                EventRow::Body(event) => (colors::SILVER, Some(&*schema.bodies[event.body].name)),
            };
            let (time, step, text) = (row.time(), row.step(), row.describe(schema));
            json!({
                "event": format!("{} {}", row.name(), whom.unwrap_or_default()),
                "pair": pair,
                "time": time,
                "step": step,
                "q": row.pair().map(|(_, q)| q),
                "is_contact": matches!(row, EventRow::Contact(_)),
                "color": hex(color),
                "text": text,
            })
        });
        let events: Vec<Value> = events.collect();
        let least = |curve: &[Option<f64>]| curve.iter().flatten().copied().fold(f64::INFINITY, f64::min);
        let mut pairs: Vec<(&[usize; 2], &Vec<Option<f64>>)> = self.curves.iter().collect();
        pairs.sort_by(|x, y| least(x.1).total_cmp(&least(y.1)));
        pairs.truncate(CURVES);
        pairs.sort_by_key(|pair| pair.0);
        let mut levels: Vec<Value> = Vec::new();
        let instants = if schema.own_levels.is_changing() { schema.steps.min(MAX_LEVELS) } else { 0 };
        for &(&[a, b], _) in &pairs {
            for (index, threshold) in schema.thresholds.iter().enumerate() {
                let level = |step: u64| schema.level(index, [a, b], step as f64 * schema.dt).filter(|&q| q > 0.0);
                // from which step on it is how large: an edit changes it
                let mut lines: Vec<(u64, Option<f64>)> = vec![(0, level(0))];
                for step in (1..=instants).map(|k| k * schema.steps / instants) {
                    let q = level(step);
                    if lines.last().is_some_and(|(_, last)| *last != q) {
                        lines.push((step, q));
                    }
                }
                if lines.iter().all(|(_, q)| q.is_none()) {
                    continue;
                }
                let level = json!({ "label": threshold.label, "lines": lines, "color": hex(threshold.color) });
                if !levels.contains(&level) {
                    levels.push(level);
                }
            }
        }
        let plot = |(&[a, b], q): (&[usize; 2], &Vec<Option<f64>>)| {
            // q is null while the pair is out of reach
            json!({ "pair": schema.pair_name(a, b), "every": self.every, "q": q })
        };
        json!({
            "number": number,
            "outcome": outcome_of(self.events.iter().map(|event| event.name)),
            "simulated_ms": self.simulated_ms,
            // whether the events include those of surfaces, which take longer to find
            "is_measured": contacts.is_some(),
            "events": events,
            "event_count": rows.len(),
            "levels": levels,
            "plots": pairs.into_iter().map(plot).collect::<Vec<Value>>(),
            "problem": self.failure.clone().map(Problem::new).or_else(|| self.problem.clone()).or(of_file),
            // whether the problem is that of the run itself
            "failed": self.failure.is_some(),
            "is_repeated": self.problem.is_some(),
            "warnings": schema.warnings,
        })
    }
}

/// How often each kind of event happens, in words.
pub fn outcome_of<'e>(names: impl Iterator<Item = &'e str>) -> String {
    let mut counts: Vec<(&str, usize)> = Vec::new();
    for name in names {
        match counts.iter_mut().find(|(known, _)| *known == name) {
            Some((_, count)) => *count += 1,
            None => counts.push((name, 1)),
        }
    }
    match &counts[..] {
        [] => "no event".to_owned(),
        _ => counts.iter().map(|(name, count)| format!("{count} {name}")).collect::<Vec<String>>().join(", "),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Scene,
        observe::{Experiment as _, Instant, surface::Finding},
    };

    #[test]
    fn the_first_of_many_events_are_sent() {
        let mut outline = Outline::new(Scene::builtin("two").unwrap().schema(), None);
        let at = |time: f64| Instant { step: 0, time };
        let merge = |k: i32| PairEvent::new("merge", at(f64::from(k) + 0.5), [0, 1], 1.0, [0, 1]);
        outline.events.extend((0..40_000).map(merge));
        let touch = |k: i32| SurfaceEvent { what: Finding::Touch, time: f64::from(k), step: 0, a: 0, b: 1, q: 1.0 };
        let contacts: Vec<SurfaceEvent> = (0..40_000).map(touch).collect();
        let answer = outline.answer(1, Some(&contacts), None);
        let events = answer["events"].as_array().unwrap();
        assert_eq!((events.len(), answer["event_count"].as_u64()), (MAX_EVENTS, Some(80_000)));
        assert_eq!((&events[1]["event"], &answer["outcome"]), (&json!("merge a~b"), &json!("40000 merge")));
    }
}
