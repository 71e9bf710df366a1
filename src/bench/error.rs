//! Error against run time: every integrator, over a range of steps, on one scene.
//!
//! The error is the largest distance of any vertex from its position in an independent [`Reference`], in radii of the
//! vertex's body, over all steps of the run that coincide with a step of the scene. The run time covers the steps
//! alone, on one thread. Cases take turns, so that other load on the machine affects all of them alike.

use std::{
    fmt,
    time::{Duration, Instant},
};

use super::{
    MeasureError,
    chart::{Axis, Chart, DIAMOND, Line, Marker, Panel, SQUARE, Style, TIP, TRIANGLE},
    reference::{Accuracy, Reference},
    report::{Cell, Column, Machine, Report, Table},
};
use crate::{
    scene::{Integrator, Scene},
    sim::{World, WorldError},
    svg,
    text::{counted, significant},
};

/// What to measure.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// The integrators, in this order.
    pub integrators: Vec<Integrator>,
    /// Step sizes Δt, in steps of the scene, descending. Those that do not divide the scene's duration are skipped.
    pub factors: Vec<f64>,
    /// Tolerances of [`Integrator::Exponential`] with error control, at the scene's step size, descending [1/s].
    pub tolerances: Vec<f64>,
    /// Each case is timed at least this often; the median counts.
    pub runs: usize,
    /// Each case is timed for at least this long in total.
    pub shortest: Duration,
}

impl Settings {
    /// The default for a scene: step sizes from 4 times to 1/16 of its own, tolerances from 1e-3 to 1e-11 and its own.
    /// For free bodies, which take longer: step sizes from twice to 1/8, tolerances from 1e-3 to 1e-8, fewer runs.
    pub fn of(scene: &Scene) -> Settings {
        let is_coupled = scene.is_coupled();
        let mut tolerances: Vec<f64> =
            (3..=if is_coupled { 8 } else { 11 }).map(|digits| 10f64.powi(-digits)).collect();
        if !tolerances.iter().any(|tolerance| (tolerance / scene.tolerance - 1.0).abs() < 1e-9) {
            tolerances.push(scene.tolerance);
            tolerances.sort_by(|x, y| y.total_cmp(x));
        }
        Settings {
            integrators: Integrator::ALL.to_vec(),
            factors: match is_coupled {
                true => vec![2.0, 1.0, 0.5, 0.25, 0.125],
                false => vec![4.0, 2.0, 1.0, 0.5, 0.25, 0.125, 0.0625],
            },
            tolerances,
            runs: if is_coupled { 3 } else { 5 },
            shortest: Duration::from_millis(20),
        }
    }
}

/// A case is not timed again once its runs have taken this long in total.
const MAX_TIME_PER_CASE: Duration = Duration::from_secs(10);
/// A tolerance that every step meets.
const NO_CONTROL: f64 = 1e15;
/// A vertex with a larger error than this has diverged [radii].
const DIVERGED: f64 = 1e3;
/// The least error that a tolerance can ask for, at any time [radii].
pub const LEAST_ALLOWED: f64 = 1e-10;
/// Upper limit on the number of instants at which runs are compared with the reference.
const MAX_INSTANTS: u64 = 1024;
/// The smallest error drawn [radii].
const FLOOR: f64 = 1e-12;

/// An integrator and its step control.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Scheme {
    /// Fixed steps, divided only at events.
    Fixed(Integrator),
    /// [`Integrator::Exponential`] with error control: steps are subdivided to meet a tolerance [1/s].
    Controlled {
        /// In radii per second of scene time.
        tolerance: f64,
    },
}

impl Scheme {
    /// The integrator.
    pub fn integrator(self) -> Integrator {
        match self {
            Scheme::Fixed(integrator) => integrator,
            Scheme::Controlled { .. } => Integrator::Exponential,
        }
    }

    /// The common name of cases that differ only in step size or tolerance.
    fn family(self) -> &'static str {
        match self {
            Scheme::Fixed(integrator) => integrator.name(),
            Scheme::Controlled { .. } => "exponential, error control",
        }
    }

    fn tolerance(self) -> Option<f64> {
        match self {
            Scheme::Fixed(_) => None,
            Scheme::Controlled { tolerance } => Some(tolerance),
        }
    }

    fn style(self) -> Style {
        let (color, marker, width) = match self {
            Scheme::Fixed(Integrator::Thesis) => (svg::VERMILION, Marker::Cross, 3.0),
            Scheme::Fixed(Integrator::Mps) => (svg::ORANGE, TIP, 2.0),
            Scheme::Fixed(Integrator::Euler) => (svg::PURPLE, SQUARE, 2.0),
            Scheme::Fixed(Integrator::Verlet) => (svg::SKY_BLUE, DIAMOND, 2.0),
            Scheme::Fixed(Integrator::Rk4) => (svg::BLUE, TRIANGLE, 2.0),
            Scheme::Fixed(Integrator::Exponential) => (svg::GREEN, Marker::Disc, 3.0),
            Scheme::Controlled { .. } => (svg::INK, Marker::Star, 2.0),
        };
        Style { color, marker, width }
    }
}

impl fmt::Display for Scheme {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Scheme::Fixed(integrator) => integrator.fmt(f),
            Scheme::Controlled { tolerance } => write!(f, "exponential, tolerance {tolerance:.0e}"),
        }
    }
}

/// One integrator with one step size.
#[derive(Clone, Debug, PartialEq)]
pub struct Measurement {
    /// The integrator and its step control.
    pub scheme: Scheme,
    /// Step size Δt [s].
    pub dt: f64,
    /// Number of steps.
    pub steps: u64,
    /// The largest error over time and vertices [radii]; infinite if the run diverged.
    pub error: f64,
    /// The largest ratio of an error to what the tolerance allows until then [–], with error control: tolerance times
    /// time, but no less than 1e-10 R and what the reference resolves. Above 1, the tolerance is missed.
    pub share: Option<f64>,
    /// The convergence order between this error and that of the previous step size [–], if both errors are resolved.
    pub order: Option<f64>,
    /// Run time [s], median.
    pub seconds: f64,
    /// Number of runs timed.
    pub runs: usize,
}

/// The measurements of one scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Measured {
    /// Name of the scene.
    pub scene: String,
    /// Step size of the scene [s].
    pub dt: f64,
    /// Simulated time [s].
    pub duration: f64,
    /// Number of bodies.
    pub bodies: usize,
    /// Number of vertices.
    pub vertices: u64,
    /// Distance of the reference from a less accurate one [radii]: with twice the step and ten times the tolerance.
    pub agreement: f64,
    /// Ordered by integrator, then by step size or tolerance, descending.
    pub measurements: Vec<Measurement>,
}

/// Errors below this cannot be distinguished from those of a reference with this agreement [radii].
fn resolution(agreement: f64) -> f64 {
    f64::max(1e-13, 10.0 * agreement)
}

/// One run to measure.
struct Case {
    scene: Scene,
    scheme: Scheme,
    /// Step size Δt in steps of the scene.
    factor: f64,
    steps: u64,
    /// [s]
    run_times: Vec<f64>,
}

/// Measures one scene. Reports the completed fraction of the work to `progress`.
///
/// # Errors
/// [`MeasureError`], before anything is measured.
pub fn measure(scene: &Scene, settings: &Settings, progress: &mut dyn FnMut(f64)) -> Result<Measured, MeasureError> {
    try_out(scene)?;
    let judge = Judge::new(scene)?;
    let mut cases = cases(scene, settings);
    let thread = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let all = cases.iter().map(|case| case.steps).sum::<u64>() as f64 * (settings.runs + 1) as f64;
    let mut done = 0.0;
    let mut progress = |steps: u64| {
        done += steps as f64;
        progress(done / all);
    };
    let mut errors = Vec::with_capacity(cases.len());
    for case in &cases {
        errors.push(thread.install(|| judge.error(case))?);
        progress(case.steps);
    }
    for round in 0..settings.runs {
        for case in &mut cases {
            thread.install(|| case.time_runs(round, settings))?;
            progress(case.steps);
        }
    }

    let measurement = |(mut case, (error, share)): (Case, (f64, f64))| {
        case.run_times.sort_by(f64::total_cmp);
        Measurement {
            scheme: case.scheme,
            dt: case.scene.dt,
            steps: case.steps,
            error,
            share: case.scheme.tolerance().map(|_| share),
            order: None,
            seconds: case.run_times.get(case.run_times.len() / 2).copied().unwrap_or(f64::NAN),
            runs: case.run_times.len(),
        }
    };
    let mut measurements: Vec<Measurement> = cases.into_iter().zip(errors).map(measurement).collect();
    fill_in_orders(&mut measurements, resolution(judge.agreement));
    Ok(Measured {
        scene: scene.name.clone(),
        dt: scene.dt,
        duration: scene.steps() as f64 * scene.dt,
        bodies: scene.bodies.len(),
        vertices: scene.vertex_count(),
        agreement: judge.agreement,
        measurements,
    })
}

/// The cases, in the order of [`Measured::measurements`].
fn cases(scene: &Scene, settings: &Settings) -> Vec<Case> {
    let steps = scene.steps() as f64;
    let case = |scheme: Scheme, factor: f64| {
        let count = (steps / factor).round();
        let tolerance = scheme.tolerance().unwrap_or(NO_CONTROL);
        let scene = Scene { dt: scene.dt * factor, integrator: scheme.integrator(), tolerance, ..scene.clone() };
        let is_whole = (count * factor - steps).abs() < 1e-9 * steps && count >= 1.0;
        is_whole.then(|| Case { scene, scheme, factor, steps: count as u64, run_times: vec![] })
    };
    let of_integrator = |&integrator: &Integrator| {
        let fixed = settings.factors.iter().filter_map(move |&factor| case(Scheme::Fixed(integrator), factor));
        let tolerances: &[f64] = if integrator == Integrator::Exponential { &settings.tolerances } else { &[] };
        let controlled = tolerances.iter().filter_map(move |&tolerance| case(Scheme::Controlled { tolerance }, 1.0));
        fixed.chain(controlled)
    };
    settings.integrators.iter().flat_map(of_integrator).collect()
}

impl Case {
    /// Performs as many runs as fit into one round's share of the requested time.
    fn time_runs(&mut self, round: usize, settings: &Settings) -> Result<(), WorldError> {
        if self.run_times.iter().sum::<f64>() > MAX_TIME_PER_CASE.as_secs_f64() {
            return Ok(());
        }
        let share = settings.shortest.as_secs_f64() / settings.runs as f64;
        let known = self.run_times.first().copied();
        let mut left = share * (round + 1) as f64 - self.run_times.iter().sum::<f64>();
        loop {
            let mut world = World::new(self.scene.clone())?;
            let start = Instant::now();
            for _ in 0..self.steps {
                let _ = world.step();
            }
            let seconds = start.elapsed().as_secs_f64();
            self.run_times.push(seconds);
            left -= seconds;
            if left <= 0.0 || known.is_some_and(|known| known >= share) {
                return Ok(());
            }
        }
    }
}

fn fill_in_orders(measurements: &mut [Measurement], resolution: f64) {
    for k in 1..measurements.len() {
        let (before, this) = (&measurements[k - 1], &measurements[k]);
        let is_resolved = [before, this].iter().all(|it| it.error > resolution && it.error.is_finite());
        if before.scheme == this.scheme && is_resolved {
            measurements[k].order = Some((before.error / this.error).ln() / (before.dt / this.dt).ln());
        }
    }
}

/// Runs the scene once as it is: a scene that cannot finish would keep the reference busy forever.
fn try_out(scene: &Scene) -> Result<(), MeasureError> {
    let mut world = World::new(scene.clone())?;
    for _ in 0..scene.steps() {
        if let Some(failure) = &world.step().failure
            && !failure.is_whole_step()
        {
            return Err(failure.clone().into());
        }
    }
    Ok(())
}

/// The reference and its accuracy.
struct Judge {
    reference: Reference,
    /// See [`Measured::agreement`].
    agreement: f64,
    /// Number of scene steps between instants.
    stride: u64,
}

impl Judge {
    fn new(scene: &Scene) -> Result<Judge, MeasureError> {
        let steps = scene.steps();
        let stride = steps.div_ceil(MAX_INSTANTS).next_power_of_two();
        let instants: Vec<f64> = (0..=steps / stride).map(|k| (k * stride) as f64 * scene.dt).collect();
        Reference::check(scene, &instants, Accuracy::TIGHTER)?; // before minutes are spent on the usual one
        let usual = Reference::solve(scene, &instants, Accuracy::DEFAULT)?;
        let reference = Reference::solve(scene, &instants, Accuracy::TIGHTER)?;
        let agreement = usual.largest_difference(&reference, scene);
        Ok(Judge { agreement, reference, stride })
    }

    /// The index of the reference instant that coincides with `step` steps of a case, if there is one.
    fn instant(&self, case: &Case, step: u64) -> Option<usize> {
        let instant = step as f64 * case.factor / self.stride as f64;
        let whole = instant.round();
        ((instant - whole).abs() < 1e-9 * f64::max(1.0, whole)).then_some(whole as usize)
    }

    /// The largest error over time and vertices [radii], and its [share](Measurement::share) of what is allowed;
    /// infinite if the run diverged.
    fn error(&self, case: &Case) -> Result<(f64, f64), WorldError> {
        let mut world = World::new(case.scene.clone())?;
        let (mut largest, mut share) = (0.0, 0.0);
        let least = f64::max(LEAST_ALLOWED, resolution(self.agreement));
        for step in 1..=case.steps {
            if world.step().failure.is_some() {
                return Ok((f64::INFINITY, f64::INFINITY));
            }
            let Some(instant) = self.instant(case, step) else { continue };
            for (index, body) in world.bodies().enumerate() {
                let error = self.reference.error(index, &body, instant);
                if error.is_nan() || error > DIVERGED {
                    return Ok((f64::INFINITY, f64::INFINITY));
                }
                largest = f64::max(largest, error);
                share = f64::max(share, error / f64::max(least, case.scene.tolerance * world.time()));
            }
        }
        Ok((largest, share))
    }
}

// --- results --------------------------------------------------------------------------------------------------------

impl Measured {
    /// Errors below this cannot be distinguished from those of the reference [radii].
    fn resolution(&self) -> f64 {
        resolution(self.agreement)
    }

    /// The measurements that differ only in step size or tolerance.
    fn families(&self) -> impl Iterator<Item = &[Measurement]> {
        self.measurements.chunk_by(|a, b| a.scheme.family() == b.scheme.family())
    }

    /// The fastest measurement of each integrator with an error of at most `target` [radii], fastest first.
    pub fn fastest(&self, target: f64) -> Vec<&Measurement> {
        let mut all: Vec<_> = self.measurements.iter().filter(|it| it.error.max(self.resolution()) <= target).collect();
        all.sort_by(|x, y| x.seconds.total_cmp(&y.seconds));
        let mut seen = vec![];
        all.retain(|it| {
            let integrator = it.scheme.integrator();
            let is_first = !seen.contains(&integrator);
            seen.push(integrator);
            is_first
        });
        all
    }

    /// The tolerances that were missed, each with the largest ratio of an error to what it allows until then.
    pub fn missed(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        self.measurements.iter().filter_map(|it| match (it.scheme, it.share) {
            (Scheme::Controlled { tolerance }, Some(share)) if !(share <= 1.0) => Some((tolerance, share)),
            _ => None,
        })
    }

    /// The ratio of the largest to the smallest step size of the scheme as printed in the thesis, and the fraction of
    /// the error that remains at the smallest, if it is too large for the scheme to be convergent.
    fn thesis_stagnation(&self) -> Option<(f64, f64)> {
        let of_thesis = || self.measurements.iter().filter(|it| it.scheme == Scheme::Fixed(Integrator::Thesis));
        let (largest, smallest) = (of_thesis().next()?, of_thesis().next_back()?);
        let share = smallest.error / largest.error;
        (share >= 0.5).then_some((largest.dt / smallest.dt, share))
    }

    fn conclusions(&self) -> Vec<String> {
        let milliseconds = |it: &Measurement| format!("{}, {} ms", it.scheme, significant(1e3 * it.seconds));
        let mut lines = vec!["fastest for an error of at most".to_owned()];
        for target in [1e-2, 1e-4, 1e-6, 1e-8] {
            let line = match self.fastest(target).as_slice() {
                [] => "none".to_owned(),
                [only] => format!("{}; no other integrator reaches it", milliseconds(only)),
                [first, second, ..] => format!("{}; then {}", milliseconds(first), milliseconds(second)),
            };
            lines.push(format!("  {target:.0e}  {line}"));
        }
        let share = |it: &Measurement| Some(it.error / (it.scheme.tolerance()? * self.duration));
        let shares = || self.measurements.iter().filter(|it| it.error > self.resolution()).filter_map(share);
        if let (Some(least), Some(largest)) = (shares().reduce(f64::min), shares().reduce(f64::max)) {
            lines
                .push(format!("error control: the error is {least:.0e} to {largest:.0e} of what the tolerance allows"));
        }
        let missed: Vec<String> =
            self.missed().map(|(tolerance, share)| format!("{tolerance:.0e} ({share:.1} times)")).collect();
        if !missed.is_empty() {
            lines.push(format!("  missed at some instant: {}", missed.join(", ")));
        }
        if let Some((factor, share)) = self.thesis_stagnation() {
            lines.push(format!(
                "thesis, as printed, does not converge: a step {factor:.0} times smaller leaves {:.0} % of its error",
                100.0 * share
            ));
        }
        lines.push(format!(
            "reference: with a tenth of the tolerance and half the step, it changes by {:.0e} R",
            self.agreement
        ));
        lines
    }

    fn row(&self, it: &Measurement) -> Vec<Cell> {
        let error = match it.error {
            f64::INFINITY => "diverged".to_owned(),
            error if error < self.resolution() => format!("< {:.0e}", self.resolution()),
            error => format!("{error:.2e}"),
        };
        vec![
            self.scene.as_str().into(),
            self.vertices.into(),
            Cell::Text(it.scheme.to_string()),
            it.scheme.integrator().name().into(),
            it.scheme.tolerance().into(),
            it.dt.into(),
            it.steps.into(),
            Cell::Shown(it.error, error),
            it.order.into(),
            (1e3 * it.seconds).into(),
            it.runs.into(),
            ((self.vertices * it.steps) as f64 / it.seconds).into(),
        ]
    }

    fn panel(&self, errors: Axis) -> Panel {
        let floor = f64::max(FLOOR, self.resolution());
        let line = |family: &[Measurement]| {
            let scheme = family.first()?.scheme;
            let is_thesis = scheme == Scheme::Fixed(Integrator::Thesis);
            let name = match scheme.family() {
                name if family.iter().any(|it| it.error.is_infinite()) => format!("{name} (out of bounds)"),
                name if is_thesis && self.thesis_stagnation().is_some() => format!("{name} (no convergence)"),
                name => name.to_owned(),
            };
            let is_own = |it: &Measurement| (it.dt / self.dt - 1.0).abs() < 1e-9 && it.scheme.tolerance().is_none();
            let points = family.iter().map(|it| [1e3 * it.seconds, it.error.max(floor)]).collect();
            Some(Line { name, style: scheme.style(), points, ringed: family.iter().position(is_own) })
        };
        let times = self.measurements.iter().map(|it| 1e3 * it.seconds);
        Panel {
            title: format!("{} ({} vertices)", self.scene, self.vertices),
            axes: [Axis::spanning("run time [ms]", times, 1.5), errors],
            lines: self.families().filter_map(line).collect(),
            marks: Vec::new(),
        }
    }
}

/// The columns of the measurements.
pub fn columns() -> Vec<Column> {
    vec![
        Column::text("", "scene"),
        Column::count("", "vertices"),
        Column::text("scheme", ""),
        Column::text("", "integrator"),
        Column::number("", "tolerance_per_s", |x| x.to_string()),
        Column::number("dt [s]", "dt_s", |dt| format!("{dt:.6}")),
        Column::count("steps", "steps"),
        Column::number("error [R]", "error_radii", |error| format!("{error:.2e}")),
        // rounded first, to avoid a negative zero
        Column::number("order", "order", |order| format!("{:.2}", (100.0 * order).round() / 100.0 + 0.0)),
        Column::number("run time [ms]", "run_time_ms", significant),
        Column::count("", "runs"),
        Column::number("vertex-steps [M/s]", "vertex_steps_per_s", |rate| format!("{:.1}", 1e-6 * rate)),
    ]
}

/// A table for each scene, and the work-precision diagram with a panel for each.
pub fn report(scenes: &[Measured], machine: &Machine) -> Report {
    let table = |measured: &Measured| Table {
        title: format!(
            "{}: {}, {}, {} s in steps of {:.6} s",
            measured.scene,
            counted(measured.bodies as u64, "body"),
            counted(measured.vertices, "vertex"),
            measured.duration,
            measured.dt
        ),
        columns: columns(),
        rows: measured
            .families()
            .flat_map(|family| std::iter::once(vec![]).chain(family.iter().map(|it| measured.row(it))))
            .collect(),
        conclusions: measured.conclusions(),
    };
    let tables: Vec<Table> = scenes.iter().map(table).collect();
    let rows = scenes.iter().flat_map(|it| it.measurements.iter().map(|measurement| it.row(measurement))).collect();
    Report {
        file: Some(Table { columns: columns(), rows, ..Table::default() }),
        tables,
        notes: "error: the largest over time and vertices, in radii, against an independent solution by extrapolation (Gragg, \
                Bulirsch, Stoer);\norder: relative to the previous step size; run time: of the steps alone, on one thread, median \
                of several runs"
            .to_owned(),
        chart: Some(chart(scenes, machine)),
        ..Report::default()
    }
}

fn chart(scenes: &[Measured], machine: &Machine) -> Chart {
    // the same range for all panels, so that they can be compared
    let errors = scenes.iter().flat_map(|measured| {
        let floor = f64::max(FLOOR, measured.resolution());
        measured.measurements.iter().map(move |it| it.error.max(floor))
    });
    let errors = Axis::spanning("largest error [radii]", errors.chain([0.1]), 3.0);
    Chart {
        title: "Work and precision".to_owned(),
        heading: [
            "Down is more accurate, left is faster. Each point halves the step; a ring marks the scene’s own.",
            "Stars: error control, each with a tighter tolerance than the one before.",
        ],
        panels: scenes.iter().map(|measured| measured.panel(errors.clone())).collect(),
        notes: vec![
            "Error: the largest over time and vertices, relative to an independent solution.".to_owned(),
            "Run time: of the steps alone, on one thread; median of several runs.".to_owned(),
            machine.to_string(),
        ],
    }
}
