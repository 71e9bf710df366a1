//! A stress sweep: thousands of small scenes at the limits of every setting, run with every integrator.
//!
//! | contents | module |
//! | --- | --- |
//! | the cases, generated from their numbers | [`cases`] |
//! | the energy bound | [`bound`] |
//! | the closed form without influence | [`exact`] |
//! | a million steps without damping | [`drift`] |
//! | free bodies | [`free`] |
//!
//! A run passes if its state is finite after every step and within [`MARGIN`] of the energy bound. The exponential
//! integrator has a tolerance, so it must also be as close to the exact solution as the tolerance promises, where there
//! is a closed form or a [`Reference`].

pub mod bound;
pub mod cases;
pub mod drift;
pub mod exact;
pub mod free;

use std::time::Instant;

use rayon::prelude::*;

use super::{
    MeasureError, path,
    reference::{Accuracy, Reference},
    report::{Cell, Column, Report, Table},
};
use crate::{
    Scene,
    model::phase::Phase,
    scene::{Body, Integrator, Path},
    sim::{Event, World, WorldError},
    text::{significant, thousands},
};
use bound::Allowance;
use cases::{Axis, Case};

/// A state that exceeds the energy bound by more than this factor is not a solution, not even an inaccurate one.
pub const MARGIN: f64 = 2.0;
/// A reference is computed only if it takes at most this many evaluations of the equation of motion.
const MAX_EVALUATIONS: f64 = 6e6;
/// Relative rounding error of a number after some operations.
const ROUNDING: f64 = 16.0 * f64::EPSILON;
/// Number of instants at which a run is compared with the exact solution.
const INSTANTS: u64 = 32;
/// Largest amplification of neighbouring solutions; beyond it, [`Outcome::allowed`] would permit anything.
const LARGEST_GROWTH: f64 = 1e4;

/// Settings of the sweep.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Number of cases, counted from the first.
    pub cases: u64,
    /// The integrators to run.
    pub integrators: Vec<Integrator>,
    /// Maximum number of steps per case.
    pub most_steps: u64,
}

/// Why a run failed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Failure {
    /// Its state contains NaN or infinity.
    NotFinite,
    /// It exceeds the energy bound by more than [`MARGIN`].
    BeyondBound,
    /// It is farther from the exact solution than [`Outcome::allowed`].
    Error,
}

/// The result of running a case with one integrator.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// The integrator.
    pub integrator: Integrator,
    /// Steps taken; a run ends where it fails.
    pub steps: u64,
    /// Whether the run was stopped early because it took too many integrator steps.
    pub is_cut: bool,
    /// Why the run failed, if it did.
    pub failure: Option<Failure>,
    /// The largest ratio of a vertex's state to the energy bound [–].
    pub used: f64,
    /// The largest distance from the exact solution [radii], if known.
    pub error: Option<f64>,
    /// The permitted distance from the exact solution, if one applies [radii].
    pub allowed: Option<f64>,
    /// Total number of integrator steps, over all vertices.
    pub substeps: u64,
    /// Largest number of integrator steps in one step.
    pub most_substeps: u64,
    /// Run time of all steps [s].
    pub seconds: f64,
}

/// The results of a case for all integrators.
#[derive(Clone, Debug)]
pub struct Row {
    /// The case.
    pub case: Case,
    /// Its outcomes, in the order of [`Settings::integrators`].
    pub outcomes: Vec<Outcome>,
}

/// Runs the cases on all cores. Calls `progress` after each.
///
/// # Errors
/// [`MeasureError`]
pub fn sweep(settings: &Settings, progress: &(dyn Fn() + Sync)) -> Result<Vec<Row>, MeasureError> {
    let row = |index: u64| {
        let row = Case::new(index).map_err(MeasureError::from).and_then(|case| run(case, settings));
        progress();
        row
    };
    (0..settings.cases).into_par_iter().map(row).collect()
}

/// Runs one case.
///
/// # Errors
/// [`MeasureError::World`]
pub fn run(case: Case, settings: &Settings) -> Result<Row, MeasureError> {
    let steps = case.scene.steps().min(settings.most_steps);
    let judge = Judge::new(&case, steps);
    let outcomes = settings.integrators.iter().map(|&integrator| judge.run(integrator)).collect::<Result<_, _>>()?;
    Ok(Row { case, outcomes })
}

/// The criteria for the runs of a case.
struct Judge<'a> {
    case: &'a Case,
    steps: u64,
    /// Number of steps between comparisons with the exact solution.
    stride: u64,
    reference: Option<Reference>,
}

impl Judge<'_> {
    fn new(case: &Case, steps: u64) -> Judge<'_> {
        let stride = steps.div_ceil(INSTANTS).max(1);
        let instants: Vec<f64> = (0..=steps / stride).map(|k| (k * stride) as f64 * case.scene.dt).collect();
        let is_quick = case.axis != Axis::Free
            && Reference::evaluations(&case.scene, &instants, Accuracy::DEFAULT) <= MAX_EVALUATIONS;
        let reference = is_quick.then(|| Reference::solve(&case.scene, &instants, Accuracy::DEFAULT).ok()).flatten();
        Judge { case, steps, stride, reference }
    }

    fn run(&self, integrator: Integrator) -> Result<Outcome, WorldError> {
        let scene = Scene { integrator, ..self.case.scene.clone() };
        let mut allowances: Vec<_> = (0..scene.bodies.len()).map(|index| Allowance::new(&scene, index)).collect();
        let mut doubt = vec![0.0; scene.bodies.len()];
        let mut world = World::new(scene)?;
        let mut outcome = Outcome {
            integrator,
            steps: 0,
            is_cut: false,
            failure: None,
            used: 0.0,
            error: None,
            allowed: None,
            substeps: 0,
            most_substeps: 0,
            seconds: 0.0,
        };
        while outcome.steps < self.steps && outcome.failure.is_none() {
            if outcome.substeps >= self.case.axis.most_substeps() {
                outcome.is_cut = true;
                break;
            }
            let clock = Instant::now();
            let report = world.step();
            if report.failure.as_ref().is_some_and(|failure| !failure.is_whole_step()) {
                outcome.is_cut = true;
                break;
            }
            let seconds = clock.elapsed().as_secs_f64();
            let substeps = report.substeps;
            for event in &report.events {
                let sides = [(event.a as usize, event.b as usize), (event.b as usize, event.a as usize)];
                for (index, other) in sides {
                    doubt[index] += doubt_of(event, &self.case.scene, index, other);
                }
            }
            outcome.steps += 1;
            outcome.substeps += substeps;
            outcome.most_substeps = outcome.most_substeps.max(substeps);
            outcome.seconds += seconds;
            for (index, (body, allowance)) in world.bodies().zip(&mut allowances).enumerate() {
                allowance.advance(world.scene(), index, world.time());
                let used = allowance.used(&body);
                // written so that NaN propagates
                if !(used <= outcome.used) {
                    outcome.used = used;
                }
                if !(used < f64::INFINITY) {
                    outcome.failure = Some(Failure::NotFinite);
                } else if used > MARGIN && outcome.failure.is_none() {
                    outcome.failure = Some(Failure::BeyondBound);
                }
            }
            if outcome.failure.is_none() && outcome.steps.is_multiple_of(self.stride) {
                self.compare(&world, &doubt, &mut outcome);
            }
        }
        Ok(outcome)
    }

    /// Compares the state with the exact solution; `doubt` is the sum of [`doubt_of`] over the events so far, per body.
    fn compare(&self, world: &World, doubt: &[f64], outcome: &mut Outcome) {
        let instant = (outcome.steps / self.stride) as usize;
        for (index, body) in world.bodies().enumerate() {
            for i in 0..body.vertex_count() {
                let (exact, terms) = if self.case.axis == Axis::Free {
                    let Some(exact) = exact::displacement(world.scene(), index, body.direction(i), world.time()) else {
                        return;
                    };
                    (exact.x, exact.terms)
                } else if let Some(reference) = &self.reference {
                    (reference.displacement(index, i, instant), 0.0)
                } else {
                    return;
                };
                let radius = body.scene().radius;
                let error = exact.distance(body.displacement(i)) / radius;
                let allowed = allowed(world, index, doubt[index])
                    .map(|allowed| allowed + rounding(world, index) * terms / radius);
                outcome.error = Some(outcome.error.map_or(error, |largest| largest.max(error)));
                outcome.allowed =
                    allowed.map(|allowed| outcome.allowed.map_or(allowed, |largest| largest.max(allowed)));
                let is_within = allowed.is_none_or(|allowed| error <= allowed);
                if outcome.integrator == Integrator::Exponential && !is_within {
                    outcome.failure = Some(Failure::Error);
                }
            }
        }
    }
}

/// The combined strength of everything that can act on a body [1/s²]: a bound of |∂F/∂x|.
fn stiffness(scene: &Scene, index: usize) -> f64 {
    let radius = scene.bodies[index].radius;
    let strongest = |(other, source): (usize, &Body)| {
        let (phases, law) = ([Phase::Merged, Phase::Apart, Phase::Core], scene.law(index, other));
        phases.map(|phase| scene.strength(&law, phase, radius, source.radius).abs()).into_iter().fold(0.0, f64::max)
    };
    scene.bodies.iter().enumerate().filter(|&(other, _)| other != index).map(strongest).sum()
}

/// The effect of an event's timing error on a body's velocities [scene unit/s]. The timing error comes from rounding of
/// the distance between centres.
fn doubt_of(event: &Event, scene: &Scene, index: usize, other: usize) -> f64 {
    let (body, source) = (&scene.bodies[index], &scene.bodies[other]);
    let (a, b) = (path(body).at(event.time), path(source).at(event.time));
    let apart = a.position - b.position;
    let speed = (apart.dot(a.velocity - b.velocity) / apart.length()).abs();
    let far = a.position.length() + b.position.length() + path(body).position(0.0).length();
    let law = scene.law(index, other);
    let strength = |phase| scene.strength(&law, phase, body.radius, source.radius);
    let jump =
        (strength(event.from) - strength(event.to)).abs() * source.sphere_radius() * scene.influence.weight.max_pull();
    if jump == 0.0 { 0.0 } else { jump * (ROUNDING * far / speed) }
}

/// The permitted error of a run with the scene's tolerance at the current time [radii]: ten times the tolerance for
/// velocity errors, plus the rounding of coordinates, plus the `doubt` of the events, amplified by the divergence of
/// neighbouring solutions. `None` if these diverge too far.
fn allowed(world: &World, index: usize, doubt: f64) -> Option<f64> {
    let (scene, t) = (world.scene(), world.time());
    let body = &scene.bodies[index];
    let omega = body.material.omega;
    let far = scene.bodies.iter().map(|body| path(body).position(t).length() + path(body).position(0.0).length());
    let rounding = (ROUNDING * far.fold(0.0, f64::max) + doubt * t.min(1.0 / omega)) / body.radius;
    let stiffness = stiffness(scene, index);
    let unstable = f64::max(0.0, stiffness - omega * omega).sqrt();
    let growth = (unstable * t).cosh() * f64::max(1.0, stiffness * (t * t).min(1.0 / (omega * omega)));
    (growth <= LARGEST_GROWTH).then_some(growth * (10.0 * scene.tolerance * t + rounding) + 1e-9)
}

/// The accumulated effect of rounding on a free oscillation, relative to its amplitude [–].
fn rounding(world: &World, index: usize) -> f64 {
    let (scene, t) = (world.scene(), world.time());
    let body = &scene.bodies[index];
    let rate = match *path(body) {
        Path::Sine { frequency, .. } => std::f64::consts::TAU * frequency,
        _ => 0.0,
    };
    ROUNDING * (world.steps_taken() as f64 + (body.material.omega + rate) * t)
}

// --- results --------------------------------------------------------------------------------------------------------

/// How a run ended.
#[derive(Clone, Debug, PartialEq)]
pub enum Verdict {
    /// To the end, and well.
    Passed,
    /// Earlier, with this reason.
    Stopped(String),
    /// With a state that is wrong in this way.
    Failed(String),
}

/// A case, and how it ended for each integrator or model.
#[derive(Clone, Debug)]
pub struct Judged {
    /// The setting that it takes to its limits.
    pub axis: &'static str,
    /// What identifies it.
    pub what: String,
    /// The name of each integrator or model, with its verdict.
    pub verdicts: Vec<(&'static str, Verdict)>,
}

impl Row {
    /// The verdicts on this case.
    pub fn judged(&self) -> Judged {
        let verdict = |outcome: &Outcome| match outcome.failure {
            None => Verdict::Passed,
            Some(Failure::NotFinite) => Verdict::Failed("not finite".to_owned()),
            Some(Failure::BeyondBound) => Verdict::Failed(format!("{:.1e} times the energy bound", outcome.used)),
            Some(Failure::Error) => Verdict::Failed(format!("an error of {:.1e} R", outcome.error.unwrap_or(f64::NAN))),
        };
        Judged {
            axis: self.case.axis.name(),
            what: format!("case {}: {}", self.case.index, self.case.what),
            verdicts: self.outcomes.iter().map(|outcome| (outcome.integrator.name(), verdict(outcome))).collect(),
        }
    }

    fn cells(&self) -> impl Iterator<Item = Vec<Cell>> + '_ {
        self.outcomes.iter().map(|outcome| {
            let failure = outcome.failure.map(|failure| match failure {
                Failure::NotFinite => "not finite",
                Failure::BeyondBound => "beyond bound",
                Failure::Error => "error",
            });
            let allowed = outcome.allowed.filter(|_| outcome.integrator == Integrator::Exponential);
            vec![
                self.case.index.into(),
                self.case.axis.name().into(),
                self.case.what.as_str().into(),
                outcome.integrator.name().into(),
                outcome.steps.into(),
                if outcome.is_cut { "yes" } else { "no" }.into(),
                failure.into(),
                outcome.used.into(),
                outcome.error.into(),
                allowed.into(),
                outcome.substeps.into(),
                outcome.most_substeps.into(),
                outcome.seconds.into(),
            ]
        })
    }
}

/// The columns of the outcomes.
pub fn columns() -> Vec<Column> {
    let size = |x: f64| format!("{x:.1e}");
    vec![
        Column::count("", "case"),
        Column::text("", "axis"),
        Column::text("", "what"),
        Column::text("integrator", "integrator"),
        Column::count("steps", "steps"),
        Column::text("cut short", "cut"),
        Column::text("failure", "failure"),
        Column::number("of bound", "of_bound", size),
        Column::number("error [R]", "error_radii", size),
        Column::number("allowed [R]", "allowed_radii", size),
        Column::count("sub-steps", "substeps"),
        Column::count("", "most_substeps_in_a_step"),
        Column::number("run time [s]", "run_time_s", significant),
    ]
}

/// The outcomes of one case in detail.
pub fn of_case(row: &Row) -> Report {
    let table = Table { columns: columns(), rows: row.cells().collect(), ..Table::default() };
    Report { tables: vec![table], failure: defects(&[row.judged()]), ..Report::default() }
}

/// The outcomes of the sweep, the energy drifts and the outcomes with free bodies.
pub fn report(rows: &[Row], drifts: &[drift::Drift], free: &[Judged]) -> Report {
    let judged: Vec<Judged> = rows.iter().map(Row::judged).collect();
    let mut sweep = by_axis(&judged);
    let exponential = || {
        let outcomes = rows.iter().flat_map(|row| &row.outcomes);
        outcomes.filter(|outcome| outcome.integrator == Integrator::Exponential)
    };
    let compared = exponential().filter(|outcome| outcome.error.is_some()).count() as u64;
    sweep.conclusions.push(format!(
        "{} of {} runs of exponential were compared with an exact solution",
        thousands(compared),
        thousands(exponential().count() as u64)
    ));
    let lost = drifts.iter().find(|drift| drift.integrator == Integrator::Exponential && !drift.is_small());
    let lost = lost.map(|drift| format!("exponential lets energy drift by {:.1e} over a million steps", drift.largest));
    let rows = rows.iter().flat_map(Row::cells).collect();
    Report {
        file: Some(Table { columns: columns(), rows, ..Table::default() }),
        tables: vec![sweep, drift::table(drifts), by_axis(free)],
        notes: format!(
            "passed: finite after every step, and within {MARGIN} times the energy bound; exponential also as close to the exact \
             solution, where there is one, as its tolerance promises\n`meldscope bench stability N` shows case N and its scene"
        ),
        failure: defects(&judged).or(lost).or_else(|| defects(free)),
        ..Report::default()
    }
}

/// How many cases of each axis each integrator or model passed, and the first that it did not.
pub fn by_axis(judged: &[Judged]) -> Table {
    let names: Vec<&str> = judged.first().map_or(vec![], |it| it.verdicts.iter().map(|verdict| verdict.0).collect());
    let mut axes: Vec<&str> = judged.iter().map(|it| it.axis).collect();
    axes.dedup();
    let mut seen = vec![];
    axes.retain(|axis| {
        !seen.contains(axis) && {
            seen.push(*axis);
            true
        }
    });
    let line = |axis: Option<&str>| {
        let of_axis = || judged.iter().filter(move |it| axis.is_none_or(|axis| axis == it.axis));
        let cell = |k: usize| {
            let count = |is: fn(&Verdict) -> bool| of_axis().filter(|it| is(&it.verdicts[k].1)).count() as u64;
            let stopped = count(|verdict| matches!(verdict, Verdict::Stopped(_)));
            let failed = count(|verdict| matches!(verdict, Verdict::Failed(_)));
            let passed = thousands(count(|verdict| *verdict == Verdict::Passed));
            let rest = [(stopped, "stopped"), (failed, "failed")];
            let rest = rest.into_iter().filter(|(count, _)| *count > 0);
            Cell::Text(rest.fold(passed, |text, (count, what)| format!("{text}, {} {what}", thousands(count))))
        };
        let first = [axis.unwrap_or("all").into(), of_axis().count().into()];
        first.into_iter().chain((0..names.len()).map(cell)).collect()
    };
    let conclusion = |(k, name): (usize, &&str)| {
        let other = judged.iter().find_map(|it| match &it.verdicts[k].1 {
            Verdict::Passed => None,
            Verdict::Stopped(why) | Verdict::Failed(why) => Some((it, why)),
        });
        other.map(|(it, why)| format!("{name}, first not passed: {}: {why}", it.what))
    };
    let columns = names.iter().map(|name| Column::text(name, ""));
    Table {
        title: String::new(),
        columns: [Column::text("axis", ""), Column::count("cases", "")].into_iter().chain(columns).collect(),
        rows: axes.iter().copied().map(Some).chain([None]).map(line).collect(),
        conclusions: names.iter().enumerate().filter_map(conclusion).collect(),
    }
}

/// What the exponential integrator, or a model, has failed; `None` if nothing. Explicit schemes fail stiff cases.
pub fn defects(judged: &[Judged]) -> Option<String> {
    let is_explicit = |name: &str| Integrator::ALL.iter().any(|it| it.name() == name && *it != Integrator::Exponential);
    let failed = judged.iter().flat_map(|it| {
        let failed =
            it.verdicts.iter().filter(|(name, verdict)| !is_explicit(name) && matches!(verdict, Verdict::Failed(_)));
        failed.map(move |(name, _)| (*name, &it.what))
    });
    let failed: Vec<_> = failed.collect();
    let (name, first) = failed.first()?;
    Some(format!("{name} fails {} of {} cases, the first: {first}", failed.len(), judged.len()))
}
