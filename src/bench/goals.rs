//! Goals, and what was measured beside each.

use super::tables;
use crate::text::number;

/// A goal, and what became of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Goal {
    /// Of what.
    pub what: String,
    /// In words.
    pub goal: String,
    /// In words.
    pub measured: String,
    /// Whether it was reached.
    pub is_met: bool,
}

/// A goal for what should be large.
pub(super) fn at_least(what: &str, goal: f64, unit: &str, measured: f64) -> Goal {
    goal_of(what, "≥", goal, unit, measured, measured >= goal)
}

/// A goal for what should be small.
pub(super) fn at_most(what: &str, goal: f64, unit: &str, measured: f64) -> Goal {
    goal_of(what, "≤", goal, unit, measured, measured <= goal)
}

fn goal_of(what: &str, relation: &str, goal: f64, unit: &str, measured: f64, is_met: bool) -> Goal {
    let goal_number = if goal >= 100.0 { number(goal) } else { format!("{goal}") };
    Goal {
        what: what.to_owned(),
        goal: format!("{relation} {goal_number}{unit}"),
        measured: format!("{}{unit}", number(measured)),
        is_met,
    }
}

/// Goals as a table.
pub fn table(goals: &[Goal]) -> String {
    tables::table(
        ["goals", "wanted", "measured", ""],
        goals.iter().map(|goal| {
            let verdict = if goal.is_met { "met" } else { "missed" };
            [&goal.what, &goal.goal, &goal.measured, verdict]
        }),
    )
}
