//! Results of the sweep as tables and CSV.

use serde::Serialize;

use super::{
    Failure, MARGIN, Outcome, Row,
    cases::{Axis, SEED},
    drift::{self, Drift},
    sizes::{self, Passage},
};
use crate::{
    bench::tables::{self, missing},
    model::influence::Scaling,
    scene::Integrator,
    text::{counted, thousands},
};

/// The outcomes of one integrator.
fn of(rows: &[Row], integrator: Integrator) -> impl Iterator<Item = (&Row, &Outcome)> {
    rows.iter().flat_map(move |row| {
        row.outcomes.iter().filter(move |outcome| outcome.integrator == integrator).map(move |outcome| (row, outcome))
    })
}

/// The integrators that ran.
fn integrators(rows: &[Row]) -> impl Iterator<Item = Integrator> {
    let has_run = |integrator: &Integrator| of(rows, *integrator).next().is_some();
    Integrator::ALL.into_iter().filter(has_run).collect::<Vec<_>>().into_iter()
}

/// Per integrator: the number of passed cases, the failures by kind, and the worst case.
pub fn by_integrator(rows: &[Row]) -> String {
    let heading = ["integrator", "cases", "passed", "not finite", "beyond bound", "error", "median error [R]"];
    let row = |integrator| {
        let count = |failure| of(rows, integrator).filter(|(_, outcome)| outcome.failure == failure).count() as u64;
        let mut errors: Vec<f64> = of(rows, integrator)
            .filter(|(_, outcome)| outcome.failure.is_none())
            .filter_map(|(_, outcome)| outcome.error)
            .collect();
        errors.sort_by(f64::total_cmp);
        let error = |failed: u64| match integrator {
            Integrator::Exponential => thousands(failed),
            _ => missing(),
        };
        [
            integrator.to_string(),
            thousands(of(rows, integrator).count() as u64),
            thousands(count(None)),
            thousands(count(Some(Failure::NotFinite))),
            thousands(count(Some(Failure::BeyondBound))),
            error(count(Some(Failure::Error))),
            errors.get(errors.len() / 2).map_or_else(missing, |error| format!("{error:.0e}")),
        ]
    };
    tables::table(heading, integrators(rows).map(row))
}

/// Per integrator: the worst case, and the command that reruns it.
pub fn worst_cases(rows: &[Row]) -> String {
    let of_integrator = |integrator| {
        let (row, outcome) = worst(rows, integrator)?;
        let index = row.case.index;
        Some(format!(
            "{integrator}: {}: {}\n    meldscope bench stability --case {index} --integrator {integrator}",
            row.case.what,
            described(outcome)
        ))
    };
    format!("worst case of each\n{}", integrators(rows).filter_map(of_integrator).collect::<Vec<_>>().join("\n"))
}

/// The results of one case.
pub fn one_case(row: &Row) -> String {
    let heading =
        ["integrator", "steps", "outcome", "of bound", "error [R]", "allowed [R]", "sub-steps", "run time [s]"];
    let number = |x: Option<f64>| x.map_or_else(missing, |x| format!("{x:.1e}"));
    let line = |outcome: &Outcome| {
        let end = if outcome.is_cut { "passed, cut short" } else { "passed" };
        [
            outcome.integrator.to_string(),
            thousands(outcome.steps),
            outcome.failure.map_or(end, Failure::name).to_owned(),
            if outcome.used < 1e3 { format!("{:.3}", outcome.used) } else { format!("{:.1e}", outcome.used) },
            number(outcome.error),
            number(outcome.allowed.filter(|_| outcome.integrator == Integrator::Exponential)),
            thousands(outcome.substeps),
            format!("{:.4}", outcome.seconds),
        ]
    };
    tables::table(heading, row.outcomes.iter().map(line))
}

/// The worst outcome of an integrator: the one that exceeds its limit the most.
fn worst(rows: &[Row], integrator: Integrator) -> Option<(&Row, &Outcome)> {
    of(rows, integrator).min_by(|(_, a), (_, b)| b.badness().total_cmp(&a.badness()))
}

fn described(outcome: &Outcome) -> String {
    match (outcome.failure, outcome.error) {
        (Some(Failure::NotFinite), _) => format!("not finite after {}", counted(outcome.steps, "step")),
        (Some(Failure::BeyondBound), _) => {
            format!("{:.1e} times the energy bound after {}", outcome.used, counted(outcome.steps, "step"))
        }
        (Some(Failure::Error), error) => format!("error {:.1e} R", error.unwrap_or(f64::NAN)),
        (None, _) => format!("passed with {:.2} of the energy bound", outcome.used),
    }
}

impl Outcome {
    /// The ratio to the limits that apply: above 1 for a failure [–].
    pub fn badness(&self) -> f64 {
        let error = match (self.error, self.allowed) {
            (Some(error), Some(allowed)) if self.integrator == Integrator::Exponential => error / allowed,
            _ => 0.0,
        };
        match self.failure {
            Some(Failure::NotFinite) => f64::INFINITY,
            _ => (self.used / MARGIN).max(error),
        }
    }
}

/// Per axis and integrator: the number of passed cases.
pub fn by_axis(rows: &[Row]) -> String {
    let heading = ["axis", "cases"].into_iter().chain(integrators(rows).map(Integrator::name));
    let line = |(axis, _): (Axis, u64)| {
        let of_axis = |row: &Row| row.case.axis == axis;
        let cases = rows.iter().filter(|row| of_axis(row)).count() as u64;
        let passed = |integrator| {
            let is_passed = |(row, outcome): &(&Row, &Outcome)| of_axis(row) && outcome.failure.is_none();
            thousands(of(rows, integrator).filter(is_passed).count() as u64)
        };
        let cells = [axis.to_string(), thousands(cases)].into_iter().chain(integrators(rows).map(passed));
        (cases > 0).then(|| cells.collect::<Vec<_>>())
    };
    tables::table(heading, Axis::SHARES.into_iter().filter_map(line))
}

/// The cases in which the exponential integrator comes closest to its limits, and its largest costs.
pub fn extremes(rows: &[Row]) -> String {
    let mut lines = vec![];
    let mut say = |what: &str, key: &dyn Fn(&Outcome) -> f64, show: &dyn Fn(&Outcome) -> String| {
        let extreme = of(rows, Integrator::Exponential).max_by(|(_, a), (_, b)| key(a).total_cmp(&key(b)));
        if let Some((row, outcome)) = extreme {
            lines.push(format!("{what}: {} (case {}: {})", show(outcome), row.case.index, row.case.what));
        }
    };
    say("largest share of the energy bound", &|o| o.used, &|o| format!("{:.3}", o.used));
    say(
        "largest share of the permitted error",
        &|o| o.error.unwrap_or(0.0) / o.allowed.unwrap_or(f64::INFINITY),
        &|o| format!("{:.0e} of {:.0e} R", o.error.unwrap_or(0.0), o.allowed.unwrap_or(0.0)),
    );
    say("slowest step", &|o| o.slowest, &|o| format!("{:.1} ms", 1e3 * o.slowest));
    say("most sub-steps in a step", &|o| o.most_substeps as f64, &|o| thousands(o.most_substeps));
    say("slowest run", &|o| o.seconds, &|o| format!("{:.2} s for {}", o.seconds, counted(o.steps, "step")));
    let count = |is: &dyn Fn(&Outcome) -> bool| of(rows, Integrator::Exponential).filter(|(_, o)| is(o)).count() as u64;
    lines.push(format!(
        "{} of {} runs were compared with an exact solution, {} with a permitted error; {} were cut short",
        thousands(count(&|o| o.error.is_some())),
        thousands(count(&|_| true)),
        thousands(count(&|o| o.allowed.is_some())),
        thousands(count(&|o| o.is_cut)),
    ));
    lines.join("\n")
}

/// Explains the columns.
pub fn footer() -> String {
    format!(
        "passed: finite after every step, and within {MARGIN} times the energy bound; exponential also as close to the exact \
         solution, where there is one, as its tolerance promises (the other integrators have no tolerance); a run that takes too \
         much work is cut short and judged by its completed steps\n\
         seed {SEED}; --case N --write F.toml writes a case to a scene file"
    )
}

/// The energy drift over a million steps.
pub fn energy(drifts: &[Drift]) -> String {
    let heading = ["integrator", "steps", "energy drift", "run time [s]"];
    let rows = drifts.iter().map(|drift| {
        [
            drift.integrator.to_string(),
            thousands(drift.steps),
            if drift.largest.is_finite() { format!("{:.1e}", drift.largest) } else { "not finite".to_owned() },
            format!("{:.1}", drift.seconds),
        ]
    });
    format!(
        "two merged bodies without damping, dt = 1/60 s; the drift is relative to the energy above its minimum (exponential: at \
         most {:.0e})\n\n{}",
        drift::MOST,
        tables::table(heading, rows)
    )
}

/// The passages of a small body past a large one.
pub fn sizes(passages: &[Passage]) -> String {
    let heading = ["radii", "scaling", "large [R]", "inverted", "small [R]", "inverted"];
    let rows = passages.iter().map(|passage| {
        [
            format!("1:{}", passage.ratio),
            match passage.scaling {
                Scaling::Absolute => "absolute".to_owned(),
                Scaling::Relative => "relative".to_owned(),
            },
            format!("{:.3}", passage.large.displacement),
            passage.large.inverted.to_string(),
            format!("{:.3}", passage.small.displacement),
            passage.small.inverted.to_string(),
        ]
    });
    format!(
        "a small body passes a large one, q from 1.37 to 0.96 and back: largest displacement in its own radii (goal: at most {}), \
         and largest number of inverted triangles at a time (goal: none)\n\n{}",
        sizes::MOST,
        tables::table(heading, rows)
    )
}

#[derive(Serialize)]
struct Line<'a> {
    case: u64,
    axis: &'a str,
    what: &'a str,
    integrator: &'a str,
    steps: u64,
    failure: Option<&'a str>,
    of_bound: f64,
    error_radii: Option<f64>,
    allowed_radii: Option<f64>,
    cut: bool,
    substeps: u64,
    most_substeps_in_a_step: u64,
    seconds: f64,
}

/// All outcomes; fields that do not apply are empty.
///
/// # Errors
/// None is known to occur.
pub fn csv(rows: &[Row]) -> Result<String, String> {
    let all = rows.iter().flat_map(|row| row.outcomes.iter().map(move |outcome| (&row.case, outcome)));
    tables::csv(all.map(|(case, outcome)| Line {
        case: case.index,
        axis: case.axis.name(),
        what: &case.what,
        integrator: outcome.integrator.name(),
        steps: outcome.steps,
        failure: outcome.failure.map(Failure::name),
        of_bound: outcome.used,
        error_radii: outcome.error,
        allowed_radii: outcome.allowed,
        cut: outcome.is_cut,
        substeps: outcome.substeps,
        most_substeps_in_a_step: outcome.most_substeps,
        seconds: outcome.seconds,
    }))
}
