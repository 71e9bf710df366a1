//! Cost against scene size: step time of scenes with 2 to 100,000 bodies, of which all, one in a hundred, or two are in
//! contact.
//!
//! Every scene is built from the same pairs ([`scenes`]), so reference solutions of these pairs serve all scenes. A
//! world is stepped on one core and on all cores alternately, so that other load on the machine affects both equally.

pub mod scenes;

use std::time::{Duration, Instant};

use rayon::{ThreadPool, ThreadPoolBuilder, prelude::*};

use super::{
    MeasureError,
    chart::{Axis, Chart, DIAMOND, Line, Marker, Panel, SQUARE, Style, TRIANGLE},
    reference::{Accuracy, NoReference, Reference},
    report::{Cell, Column, Machine, Report, Table},
};
use crate::{
    Scene, World,
    sim::WorldError,
    svg,
    text::{number, significant},
};
use scenes::{Family, Layout, PERIOD, PHASES};

/// Settings of the benchmark.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Numbers of bodies, ascending.
    pub bodies: Vec<usize>,
    /// Approximate duration of timed steps, for each number of bodies, family and number of threads.
    pub time: Duration,
}

/// Steps before steps are timed: bodies at rest meet their neighbours and fall asleep.
const WARM: u64 = 60;
/// Steps between comparisons with the reference while a world warms up. As pairs have different initial phases, this
/// covers their whole period.
const JUDGED_EVERY: u64 = 20;
/// Upper limit on the compared pairs, which are spread over the scene.
const MAX_JUDGED: usize = 64;
/// The best of this many blocks of steps is reported, because other load only ever adds to run times.
const BLOCKS: usize = 9;
/// Number of blocks if [`BLOCKS`] would take too long.
const LONG_BLOCKS: usize = 3;
/// Scenes are skipped if their steps are expected to take longer [s].
const LONGEST_STEP: f64 = 1.0;

/// The measurements of one scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Point {
    /// The family of the scene.
    pub family: Family,
    /// Number of bodies.
    pub bodies: usize,
    /// Number of vertices.
    pub vertices: u64,
    /// Number of bodies that are awake.
    pub awake: u64,
    /// Step time on one core [s].
    pub one: f64,
    /// Step time on all cores [s]; `None` on a single-core machine.
    pub all: Option<f64>,
    /// The largest error of a vertex of a pair at any compared instant [radii]; `None` without pairs.
    pub error: Option<f64>,
}

/// Measures all families at all sizes. Reports the completed fraction of the work to `progress`.
///
/// # Errors
/// [`MeasureError`]. A scene that needs too much memory ends its family, which is not an error.
pub fn measure(settings: &Settings, progress: &mut dyn FnMut(f64)) -> Result<Measured, MeasureError> {
    let two = Scene::builtin("two").ok_or(MeasureError::NoScene("two"))?;
    let cores = rayon::current_num_threads();
    let pool = |threads| ThreadPoolBuilder::new().num_threads(threads).build();
    let pools = if cores > 1 { vec![pool(1)?, pool(cores)?] } else { vec![pool(1)?] };

    let mut measured = Measured { points: vec![], left_out: vec![] };
    let all = (Family::ALL.len() * settings.bodies.len()) as f64;
    for (number, family) in Family::ALL.into_iter().enumerate() {
        let judge = Judge::new(&two, family)?;
        let mut expected = 0.0;
        for (k, &bodies) in settings.bodies.iter().enumerate() {
            if expected * bodies as f64 > LONGEST_STEP {
                measured.left_out.push(format!("{bodies} bodies, {}: a step would take too long", family.name()));
                continue;
            }
            match measure_point(&Layout::new(family, bodies), &two, &judge, &pools, settings.time) {
                Ok(point) => {
                    expected = point.one / bodies as f64;
                    measured.points.push(point);
                }
                Err(error) => measured.left_out.push(format!("{bodies} bodies, {}: {error}", family.name())),
            }
            progress((number * settings.bodies.len() + k + 1) as f64 / all);
        }
    }
    Ok(measured)
}

fn measure_point(
    layout: &Layout,
    two: &Scene,
    judge: &Judge,
    pools: &[ThreadPool],
    time: Duration,
) -> Result<Point, WorldError> {
    let fastest = &pools[pools.len() - 1];
    let mut world = fastest.install(|| World::new(layout.scene(two)))?;
    let mut error = None;
    let start = Instant::now();
    for step in 1..=WARM {
        fastest.install(|| world.step());
        if step.is_multiple_of(JUDGED_EVERY) {
            error = f64::max(error.unwrap_or(0.0), judge.error(&world, layout)).into();
        }
    }
    let estimate = start.elapsed().as_secs_f64() / WARM as f64;

    let steps = block(estimate, time.as_secs_f64() / BLOCKS as f64);
    let is_long = steps as f64 * estimate > time.as_secs_f64();
    let mut best = vec![f64::INFINITY; pools.len()];
    for _ in 0..if is_long { LONG_BLOCKS } else { BLOCKS } {
        for (pool, best) in pools.iter().zip(&mut best) {
            let start = Instant::now();
            pool.install(|| (0..steps).for_each(|_| _ = world.step()));
            *best = f64::min(*best, start.elapsed().as_secs_f64() / steps as f64);
        }
    }
    Ok(Point {
        family: layout.family,
        bodies: layout.bodies,
        vertices: world.scene().vertex_count(),
        awake: layout.bodies as u64 - world.report().sleeping_bodies,
        one: best[0],
        all: best.get(1).copied(),
        error: error.filter(|_| !layout.pairs.is_empty()),
    })
}

/// Number of steps that take about `share` [s] or more, at about `estimate` [s] per step. It is a number of whole
/// periods, or at least a multiple of the phase offset, so that every block does the same work.
fn block(estimate: f64, share: f64) -> u64 {
    let steps = (share / estimate) as u64;
    let unit = if steps >= PERIOD / 2 { PERIOD } else { PERIOD / PHASES as u64 };
    steps.div_ceil(unit).max(1) * unit
}

/// The exact motion of the pairs of a family, by initial phase.
struct Judge {
    references: Vec<Reference>,
}

impl Judge {
    fn new(two: &Scene, family: Family) -> Result<Judge, NoReference> {
        let layout = Layout::new(family, 2);
        let phases = if layout.pairs.is_empty() { 0 } else { PHASES };
        let solve = |phase| {
            let scene = layout.pair(two, phase);
            let times: Vec<f64> = (0..=WARM / JUDGED_EVERY).map(|k| (k * JUDGED_EVERY) as f64 * scene.dt).collect();
            Reference::solve(&scene, &times, Accuracy::DEFAULT)
        };
        let references = (0..phases).into_par_iter().map(solve).collect::<Result<_, _>>()?;
        Ok(Judge { references })
    }

    /// The largest error of a vertex of the pairs, now [radii]; NaN if a state is NaN.
    fn error(&self, world: &World, layout: &Layout) -> f64 {
        let instant = (world.steps_taken() / JUDGED_EVERY) as usize;
        let stride = layout.pairs.len().div_ceil(MAX_JUDGED).max(1);
        let mut largest = 0.0;
        for pair in layout.pairs.iter().step_by(stride) {
            let Some(reference) = self.references.get(pair.phase) else { continue };
            for side in 0..2 {
                let body = world.body(pair.first + side);
                let count = body.vertex_count();
                let distance = match body.scene().path() {
                    Some(_) => reference.distance(side, instant, (0..count).map(|i| body.displacement(i))),
                    None => reference.distance(side, instant, body.positions().map(|at| at - pair.corner)),
                };
                let error = distance / body.scene().radius;
                largest = if error > largest || error.is_nan() { error } else { largest };
            }
        }
        largest
    }
}

// --- results --------------------------------------------------------------------------------------------------------

/// All measurements.
#[derive(Clone, Debug, PartialEq)]
pub struct Measured {
    /// Ordered by family, then by number of bodies, ascending.
    pub points: Vec<Point>,
    /// Scenes that were not measured, with the reasons.
    pub left_out: Vec<String>,
}

impl Measured {
    /// The points of a family, by number of bodies.
    pub fn of(&self, family: Family) -> impl Iterator<Item = &Point> {
        self.points.iter().filter(move |point| point.family == family)
    }

    /// The exponent with which step time on one core grows with the number of bodies, by least squares of the logarithms
    /// over points of at least 100 bodies [–]; `None` with fewer than two such points.
    fn exponent(&self, family: Family) -> Option<f64> {
        let points = self.of(family).filter(|point| point.bodies >= 100);
        let logs: Vec<[f64; 2]> = points.map(|point| [(point.bodies as f64).ln(), point.one.ln()]).collect();
        let n = logs.len() as f64;
        let [x, y] = [0, 1].map(|k| logs.iter().map(|log| log[k]).sum::<f64>() / n);
        let spread: f64 = logs.iter().map(|log| (log[0] - x).powi(2)).sum();
        let exponent = logs.iter().map(|log| (log[0] - x) * (log[1] - y)).sum::<f64>() / spread;
        exponent.is_finite().then_some(exponent)
    }

    /// A table for each family, and a diagram.
    pub fn report(&self, machine: &Machine) -> Report {
        let table = |family: Family| {
            let exponent = self.exponent(family);
            let growth = |exponent| format!("from 100 bodies on, a step takes time ∝ bodies^{exponent:.2}");
            Table {
                title: family.name().to_owned(),
                columns: columns(),
                rows: self.of(family).map(Point::row).collect(),
                conclusions: exponent.map(growth).into_iter().collect(),
            }
        };
        let tables: Vec<Table> = Family::ALL.map(table).into_iter().filter(|table| !table.rows.is_empty()).collect();
        let left_out = self.left_out.iter().map(|what| format!("left out: {what}\n")).collect::<String>();
        Report {
            tables,
            notes: format!(
                "{left_out}error: the largest of any vertex in the first {WARM} steps, in radii, against an independent \
                 solution;\nrun times: the best of {BLOCKS} blocks of steps, or of {LONG_BLOCKS} long ones"
            ),
            chart: Some(self.chart(machine)),
            ..Report::default()
        }
    }

    fn chart(&self, machine: &Machine) -> Chart {
        let line = |family: Family| {
            let (color, marker) = match family {
                Family::Contact => (svg::VERMILION, TRIANGLE),
                Family::Hundredth => (svg::BLUE, SQUARE),
                Family::Rest => (svg::GREEN, Marker::Disc),
                Family::FreeContact => (svg::ORANGE, DIAMOND),
                Family::FreeRest => (svg::SKY_BLUE, Marker::Cross),
            };
            let points = self.of(family).map(|point| [point.bodies as f64, 1e3 * point.one]).collect();
            let style = Style { color, marker, width: 3.0 };
            Line { name: family.name().to_owned(), style, points, ringed: None }
        };
        let bodies = self.points.iter().map(|point| point.bodies as f64);
        let times = self.points.iter().map(|point| 1e3 * point.one);
        Chart {
            title: "Cost and size".to_owned(),
            heading: ["Time of a step against the number of bodies, on one core: down is faster.", ""],
            panels: vec![Panel {
                title: String::new(),
                axes: [Axis::spanning("bodies", bodies, 1.5), Axis::spanning("time of a step [ms]", times, 2.0)],
                lines: Family::ALL.map(line).to_vec(),
                marks: Vec::new(),
            }],
            notes: vec![machine.to_string()],
        }
    }
}

/// The columns of the measurements.
pub fn columns() -> Vec<Column> {
    vec![
        Column::text("", "family"),
        Column::count("bodies", "bodies"),
        Column::count("awake", "awake_bodies"),
        Column::count("vertices", "vertices"),
        Column::number("one core [steps/s]", "steps_per_s_on_one_core", number),
        Column::number("all cores [steps/s]", "steps_per_s_on_all_cores", number),
        Column::number("vertex-steps [M/s]", "vertex_steps_per_s", |rate| significant(1e-6 * rate)),
        Column::number("error [R]", "error_radii", |error| format!("{error:.0e}")),
    ]
}

impl Point {
    fn row(&self) -> Vec<Cell> {
        vec![
            self.family.name().into(),
            self.bodies.into(),
            self.awake.into(),
            self.vertices.into(),
            (1.0 / self.one).into(),
            self.all.map(|seconds| 1.0 / seconds).into(),
            (self.vertices as f64 / self.one).into(),
            self.error.into(),
        ]
    }
}
