//! Error against run time: every integrator, over a range of steps, on one scene.
//!
//! The error is the largest distance of any vertex from its position in an independent [`Reference`], in radii of the
//! vertex's body, over all steps of the run that coincide with a step of the scene. The run time covers the steps
//! alone, on one thread. Cases take turns, so that other load on the machine affects all of them alike.

pub mod before;
pub mod csv;
pub mod diagram;
pub mod random;
pub mod table;
pub mod verdict;

use std::{
    fmt,
    time::{Duration, Instant},
};

use super::{
    MeasureError,
    reference::{Accuracy, Reference},
};
use crate::{
    scene::{Integrator, Scene},
    sim::{TooLarge, World},
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
    /// A run time is the median of at least this many runs …
    pub runs: usize,
    /// … that took at least this long in total.
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
    pub fn family(self) -> &'static str {
        match self {
            Scheme::Fixed(integrator) => integrator.name(),
            Scheme::Controlled { .. } => "exponential, error control",
        }
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
    /// The largest error over time and vertices [radii]; `None` if the run diverged.
    pub error: Option<f64>,
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
pub struct Report {
    /// Name of the scene.
    pub scene: String,
    /// Whether it has free bodies.
    pub is_coupled: bool,
    /// Step size of the scene [s].
    pub dt: f64,
    /// Tolerance of the scene [1/s].
    pub tolerance: f64,
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

impl Report {
    /// Errors below this cannot be distinguished from those of the reference [radii].
    pub fn resolution(&self) -> f64 {
        resolution(self.agreement)
    }

    /// Vertices times steps per run time [1/s].
    pub fn vertex_steps_per_second(&self, measurement: &Measurement) -> f64 {
        (self.vertices * measurement.steps) as f64 / measurement.seconds
    }

    /// Whether a measurement used the scene's own step size.
    pub fn is_at_own_step(&self, measurement: &Measurement) -> bool {
        (measurement.dt / self.dt - 1.0).abs() < 1e-9
    }
}

/// See [`Report::resolution`].
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
    error: Option<f64>,
    /// See [`Measurement::share`].
    share: Option<f64>,
    /// [s]
    run_times: Vec<f64>,
}

/// Measures one scene. Reports the completed fraction of the work to `progress`.
///
/// # Errors
/// [`MeasureError`], before anything is measured.
pub fn measure(scene: &Scene, settings: &Settings, progress: &mut dyn FnMut(f64)) -> Result<Report, MeasureError> {
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
    for case in &mut cases {
        (case.error, case.share) = thread.install(|| judge.error(case))?.unzip();
        if !matches!(case.scheme, Scheme::Controlled { .. }) {
            case.share = None;
        }
        progress(case.steps);
    }
    for round in 0..settings.runs {
        for case in &mut cases {
            thread.install(|| case.time_runs(round, settings))?;
            progress(case.steps);
        }
    }

    let mut report = Report {
        scene: scene.name.clone(),
        is_coupled: scene.is_coupled(),
        dt: scene.dt,
        tolerance: scene.tolerance,
        duration: scene.steps() as f64 * scene.dt,
        bodies: scene.bodies.len(),
        vertices: scene.vertex_count(),
        agreement: judge.agreement,
        measurements: cases.into_iter().map(Case::measurement).collect(),
    };
    fill_in_orders(&mut report);
    Ok(report)
}

/// The cases, in the order of [`Report::measurements`].
fn cases(scene: &Scene, settings: &Settings) -> Vec<Case> {
    let steps = scene.steps() as f64;
    let case = |scheme: Scheme, factor: f64| {
        let count = (steps / factor).round();
        let tolerance = match scheme {
            Scheme::Controlled { tolerance } => tolerance,
            Scheme::Fixed(_) => NO_CONTROL,
        };
        let scene = Scene { dt: scene.dt * factor, integrator: scheme.integrator(), tolerance, ..scene.clone() };
        let is_whole = (count * factor - steps).abs() < 1e-9 * steps && count >= 1.0;
        is_whole.then(|| Case {
            scene,
            scheme,
            factor,
            steps: count as u64,
            error: None,
            share: None,
            run_times: vec![],
        })
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
    fn time_runs(&mut self, round: usize, settings: &Settings) -> Result<(), TooLarge> {
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
                world.step();
            }
            let seconds = start.elapsed().as_secs_f64();
            self.run_times.push(seconds);
            left -= seconds;
            if left <= 0.0 || known.is_some_and(|known| known >= share) {
                return Ok(());
            }
        }
    }

    fn measurement(mut self) -> Measurement {
        self.run_times.sort_by(f64::total_cmp);
        Measurement {
            scheme: self.scheme,
            dt: self.scene.dt,
            steps: self.steps,
            error: self.error,
            share: self.share,
            order: None,
            seconds: self.run_times.get(self.run_times.len() / 2).copied().unwrap_or(f64::NAN),
            runs: self.run_times.len(),
        }
    }
}

fn fill_in_orders(report: &mut Report) {
    let resolution = report.resolution();
    let measured = |measurement: &Measurement| measurement.error.filter(|&error| error > resolution);
    for k in 1..report.measurements.len() {
        let (before, this) = (&report.measurements[k - 1], &report.measurements[k]);
        if before.scheme != this.scheme {
            continue;
        }
        if let (Some(coarse), Some(fine)) = (measured(before), measured(this)) {
            report.measurements[k].order = Some((coarse / fine).ln() / (before.dt / this.dt).ln());
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
    /// See [`Report::agreement`].
    agreement: f64,
    /// Number of scene steps between instants.
    stride: u64,
}

impl Judge {
    fn new(scene: &Scene) -> Result<Judge, MeasureError> {
        let steps = scene.steps();
        let stride = steps.div_ceil(MAX_INSTANTS).next_power_of_two();
        let instants: Vec<f64> = (0..=steps / stride).map(|k| (k * stride) as f64 * scene.dt).collect();
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

    /// The largest error over time and vertices [radii], and its [share](Measurement::share) of what is allowed; `None`
    /// if the run diverged.
    fn error(&self, case: &Case) -> Result<Option<(f64, f64)>, TooLarge> {
        let mut world = World::new(case.scene.clone())?;
        let (mut largest, mut share) = (0.0, 0.0);
        let least = f64::max(LEAST_ALLOWED, resolution(self.agreement));
        for step in 1..=case.steps {
            if world.step().failure.is_some() {
                return Ok(None);
            }
            let Some(instant) = self.instant(case, step) else { continue };
            for (index, body) in world.bodies().enumerate() {
                let error = self.reference.error(index, &body, instant);
                if error.is_nan() || error > DIVERGED {
                    return Ok(None);
                }
                largest = f64::max(largest, error);
                share = f64::max(share, error / f64::max(least, case.scene.tolerance * world.time()));
            }
        }
        Ok(Some((largest, share)))
    }
}
