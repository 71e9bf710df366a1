//! Performance goals with their measured values.

use super::tables;
use crate::text::number;

/// A goal and its measured value.
#[derive(Clone, Debug, PartialEq)]
pub struct Goal {
    /// The quantity.
    pub what: String,
    /// The goal, as text.
    pub goal: String,
    /// The measured value, as text.
    pub measured: String,
    /// Whether the goal was met.
    pub is_met: bool,
}

/// A lower bound on a measured value.
pub(super) fn at_least(what: &str, goal: f64, unit: &str, measured: f64) -> Goal {
    goal_of(what, "≥", goal, unit, measured, measured >= goal)
}

/// An upper bound on a measured value.
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

/// Formats goals as a table.
pub fn table(goals: &[Goal]) -> String {
    tables::table(
        ["goals", "goal", "measured", ""],
        goals.iter().map(|goal| {
            let verdict = if goal.is_met { "met" } else { "missed" };
            [&goal.what, &goal.goal, &goal.measured, verdict]
        }),
    )
}
