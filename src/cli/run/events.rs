//! What happened in a run, for its summary.

use std::collections::HashMap;

use crate::{
    observe::{EventRow, Instant, Schema, Shortfall},
    text::counted,
};

/// At most this many events are listed; the rest are counted.
const LISTED_EVENTS: usize = 20;

/// The events of a run: the first [`LISTED_EVENTS`] of pairs, and the total count.
#[derive(Default)]
pub struct Events {
    pub first: Vec<ListedEvent>,
    pub count: u64,
    /// Number of those that are of single bodies; they are not listed.
    pub of_bodies: u64,
    /// When the present phase of a pair began [s].
    begun: HashMap<(usize, usize), f64>,
    /// Number of steps that missed the tolerance.
    inaccurate: u64,
    /// The first and the worst of these steps.
    shortfalls: Option<[(Instant, Shortfall); 2]>,
}

impl Events {
    /// Adds an event.
    pub fn add(&mut self, row: &EventRow<'_>, schema: &Schema) {
        self.count += 1;
        let Some(([a, b], _)) = row.pair() else {
            self.of_bodies += 1;
            return;
        };
        let what = format!("{} {}", row.name(), schema.pair_name(a, b));
        let line = match row {
            EventRow::Phase(event, surfaces) => {
                // other simulations need not know it
                let rate = match event.rate {
                    0.0 => String::new(),
                    rate => format!("q {} by {:.3}/s ", if rate < 0.0 { "falling" } else { "rising" }, rate.abs()),
                };
                let lasted = event.time - self.begun.insert((event.a, event.b), event.time).unwrap_or(0.0);
                let phase = schema.phases[event.from].name;
                let surfaces = surfaces.as_ref().map_or(String::new(), |surfaces| format!("; {surfaces}"));
                let line = schema.describe(event);
                format!("{line}; {rate}after {lasted:.3} s {phase}{surfaces}")
            }
            _ => row.describe(schema),
        };
        if self.first.len() < LISTED_EVENTS {
            let number = 1 + self.first.iter().filter(|other| other.what == what).count();
            self.first.push(ListedEvent { what, number, time: row.time(), line });
        }
    }

    /// Adds a step that missed the tolerance.
    pub fn missed(&mut self, at: Instant, shortfall: Shortfall) {
        self.inaccurate += 1;
        let [first, worst] = self.shortfalls.unwrap_or([(at, shortfall); 2]);
        let is_worse = shortfall.ratio() > worst.1.ratio();
        self.shortfalls = Some([first, if is_worse { (at, shortfall) } else { worst }]);
    }

    /// Describes where the tolerance was missed; `None` if it was met.
    pub fn inaccuracy(&self, schema: &Schema) -> Option<String> {
        let [(at, first), (worst_at, worst)] = self.shortfalls?;
        let steps = counted(self.inaccurate, "step");
        let mut line = format!("warning: the tolerance was not met in {steps}: {}", first.describe(schema, at));
        if worst_at.step != at.step {
            line += &format!("; the worst is {}", worst.describe(schema, worst_at));
        }
        Some(line + "; lower dt, omega, alpha or beta, or raise tolerance")
    }
}

/// An event: kind and pair, number among the events of that kind and pair, time [s], and description.
#[derive(Clone)]
pub struct ListedEvent {
    pub what: String,
    pub number: usize,
    pub time: f64,
    pub line: String,
}
