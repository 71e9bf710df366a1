//! The events of a step as rows, the same in summaries, recordings and tables: one for each event, in order of time.

use super::{BodyEvent, PairEvent, Schema, surface::SurfaceEvent};

/// An event.
#[derive(Clone, Debug, PartialEq)]
pub enum EventRow<'a> {
    /// The phase of a pair changes; with a remark on its surfaces, if they could be compared.
    Phase(&'a PairEvent, Option<String>),
    /// The surfaces of a pair touch or part.
    Contact(&'a SurfaceEvent),
    /// Something happens to a single body.
    Body(&'a BodyEvent),
}

impl EventRow<'_> {
    /// Its kind.
    pub fn name(&self) -> &'static str {
        match self {
            EventRow::Phase(event, _) => event.name,
            EventRow::Contact(event) => event.name(),
            EventRow::Body(event) => event.name,
        }
    }

    /// Its pair, and the centre distance of that over the sum of the radii; `None` if it is of a single body.
    pub fn pair(&self) -> Option<([usize; 2], f64)> {
        match self {
            EventRow::Phase(event, _) => Some(([event.a, event.b], event.q)),
            EventRow::Contact(event) => Some(([event.a, event.b], event.q)),
            EventRow::Body(_) => None,
        }
    }

    /// When it happens [s].
    pub fn time(&self) -> f64 {
        match self {
            EventRow::Phase(event, _) => event.time,
            EventRow::Contact(event) => event.time,
            EventRow::Body(event) => event.time,
        }
    }

    /// The first step whose state is affected.
    pub fn step(&self) -> u64 {
        match self {
            EventRow::Phase(event, _) => event.step,
            EventRow::Contact(event) => event.step,
            EventRow::Body(event) => event.step,
        }
    }

    /// Describes the event in words.
    pub fn describe(&self, schema: &Schema) -> String {
        match self {
            EventRow::Phase(event, None) => schema.describe(event),
            EventRow::Phase(event, Some(surfaces)) => format!("{}; {surfaces}", schema.describe(event)),
            EventRow::Contact(event) => event.describe(schema),
            EventRow::Body(event) => event.describe(schema),
        }
    }
}

/// The rows of a step, from its phase changes, its findings about surfaces and its events of single bodies. Surfaces
/// that touch at the instant of a phase change come first.
pub fn rows<'a>(phases: &'a [PairEvent], surfaces: &'a [SurfaceEvent], bodies: &'a [BodyEvent]) -> Vec<EventRow<'a>> {
    let contacts = surfaces.iter().filter(|event| event.is_contact()).map(EventRow::Contact);
    let remarks: Vec<&SurfaceEvent> = surfaces.iter().filter(|event| !event.is_contact()).collect();
    let remark = |event: &PairEvent| remarks.iter().find(|found| found.is_on(event)).and_then(|found| found.findings());
    let phases = phases.iter().map(|event| EventRow::Phase(event, remark(event)));
    let mut rows: Vec<EventRow<'a>> = contacts.chain(phases).chain(bodies.iter().map(EventRow::Body)).collect();
    rows.sort_by(|x, y| x.time().total_cmp(&y.time()));
    rows
}
