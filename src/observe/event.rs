//! Instants and events of a run.

use glam::DVec3;

use super::schema::Schema;

/// A point in time of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Instant {
    /// Number of the step.
    pub step: u64,
    /// Simulated time [s].
    pub time: f64,
}

/// A phase change of a pair, at its exact time.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct PairEvent {
    /// Kind of event: `merge`, `split`, …
    pub name: &'static str,
    /// Exact time of the event [s].
    pub time: f64,
    /// The first step whose state is affected by the event.
    pub step: u64,
    /// Index of the first body of the pair.
    pub a: usize,
    /// Index of the second body of the pair; a < b.
    pub b: usize,
    /// Centre distance over the sum of the radii at that time [–].
    pub q: f64,
    /// Rate of change of q at that time [1/s].
    pub rate: f64,
    /// The previous phase, as an index into the schema's phases.
    pub from: usize,
    /// The new phase, as an index into the schema's phases.
    pub to: usize,
    /// Energy that free bodies gained by the event [mass · scene unit²/s²]; `None` without free bodies.
    pub energy: Option<f64>,
}

/// An event of a single body at a position, for example a tear.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct BodyEvent {
    /// Kind of event: `cut cell`, `split node`, …
    pub name: &'static str,
    /// Time of the event [s].
    pub time: f64,
    /// The first step whose state is affected.
    pub step: u64,
    /// Index of the body.
    pub body: usize,
    /// Position of the event [scene unit].
    pub place: DVec3,
}

impl PairEvent {
    /// An event of the bodies `a` < `b` at `at.time`, which affects the state of step `at.step`: q [–], and the phases
    /// before and after it. Its rate is unknown, 0, and so is its energy.
    pub fn new(name: &'static str, at: Instant, [a, b]: [usize; 2], q: f64, [from, to]: [usize; 2]) -> PairEvent {
        PairEvent { name, time: at.time, step: at.step, a, b, q, rate: 0.0, from, to, energy: None }
    }

    /// Whether the event is of the kind of a [word](Schema::event_words), or has this name.
    pub fn is(&self, word: &str) -> bool {
        self.name == word || self.name.split(' ').next() == Some(word)
    }
}

impl BodyEvent {
    /// An event of a body at `at.time`, which affects the state of step `at.step`, and its place [scene unit].
    pub fn new(name: &'static str, at: Instant, body: usize, place: DVec3) -> BodyEvent {
        BodyEvent { name, time: at.time, step: at.step, body, place }
    }

    /// Describes the event in words.
    pub fn describe(&self, schema: &Schema) -> String {
        let BodyEvent { name, time, step, body, place: DVec3 { x, y, z } } = *self;
        let body = &schema.bodies[body].name;
        format!("{name} {body} at ({x:.4}, {y:.4}, {z:.4}), t = {time:.6} s, step {step}")
    }
}
