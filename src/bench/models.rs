//! The soft-body models side by side: cost, error, stability, volume loss, and times of merging and splitting.
//!
//! Nothing here depends on a particular model: everything is measured through [`Simulation`].

use std::time::Instant;

use glam::DVec3;
use plotters::style::RGBColor;
use serde::Serialize;

use super::{
    drawing::{Area, Axis, Failure, INK, LEFT, Line, Marker, Sheet, Style, draw_axes, draw_lines, error_range, write},
    machine::Machine,
    tables::{self, missing},
};
use crate::{
    Scene,
    analysis::{surface::Merger, touch::Touches},
    geometry::Vectors,
    models::SceneRun,
    observe::{Experiment as _, Frame, Schema, Simulation, StepSummary, SurfaceEvent, Want, surface::Finding},
    scene::Model,
    sim::Options,
    text::{bytes, counted, significant},
};

/// Upper limit on the measured steps of a scene.
const MAX_STEPS: u64 = 1200;
/// Number of timings of a run, of which the median is reported.
const RUNS: usize = 3;
/// Divisors of the scene's step for the work-precision diagram.
const DIVISORS: [f64; 5] = [0.5, 1.0, 2.0, 4.0, 8.0];
/// Divisor of the scene's step for the converged solution of each model.
const FINEST: f64 = 32.0;
/// Longer steps are tried up to this multiple of the scene's step.
const LONGEST: f64 = 64.0;
/// A run is stable while every displacement is below the larger of two limits: this one [radii] …
const STABLE_LIMIT: f64 = 10.0;
/// … and this multiple of the maximum in the run with the scene's own step.
const STABLE_MULTIPLE: f64 = 3.0;
/// Smaller errors are drawn at this value [radii].
const FLOOR: f64 = 1e-12;

/// The models on one scene.
#[derive(Clone, Debug)]
pub struct Report {
    /// Name of the scene.
    pub scene: String,
    /// Number of vertices of all bodies.
    pub vertices: u64,
    /// The scene's own step [s].
    pub dt: f64,
    /// Measurements of each model, or why it cannot run this scene.
    pub rows: Vec<(Model, Result<Row, String>)>,
}

/// The measurements of a model.
#[derive(Clone, Debug)]
pub struct Row {
    /// Time to build the simulation, before its first step [s].
    pub build: f64,
    /// Time of a step [s].
    pub step: f64,
    /// Time of a step with its frame: the state with its forces, and the merged surface [s].
    pub frame: f64,
    /// Memory of the simulation, if known [bytes].
    pub memory: Option<u64>,
    /// Runs of the diagram, with the largest error over time and vertices against the model's own converged solution.
    pub points: Vec<Point>,
    /// The largest stable step [s]; `None` if no step that was tried is stable.
    pub largest_step: Option<f64>,
    /// Whether all longer steps that were tried are stable.
    pub is_unlimited: bool,
    /// The largest relative loss of total volume during the run [–].
    pub volume_lost: f64,
    /// Touch and part events, and phase changes, in order of time.
    pub events: Vec<(String, f64)>,
}

/// A run with one of the diagram's steps.
#[derive(Clone, Copy, Debug)]
pub struct Point {
    /// The step [s].
    pub dt: f64,
    /// Run time [s], the shortest of several; NaN if the run failed.
    pub seconds: f64,
    /// The error [radii]; `None` if the run failed.
    pub error: Option<f64>,
}

impl Row {
    /// The error with the scene's own step [radii].
    fn error(&self, dt: f64) -> Option<f64> {
        self.points.iter().find(|point| point.dt == dt)?.error
    }
}

/// Measures some models on a scene.
pub fn measure(scene: &Scene, models: &[Model], progress: &mut dyn FnMut(f64)) -> Report {
    let mut scene = scene.clone();
    if scene.steps() > MAX_STEPS {
        scene.duration = MAX_STEPS as f64 * scene.dt;
    }
    let count = models.len() as f64;
    let rows = (0..).zip(models.iter().copied()).map(|(k, model)| {
        progress(f64::from(k) / count);
        let run = SceneRun { scene: Scene { model, ..scene.clone() }, options: Options::default() };
        let row = row(&run, &mut |share| progress((f64::from(k) + share) / count));
        (model, row)
    });
    Report { scene: scene.name.clone(), vertices: scene.vertex_count(), dt: scene.dt, rows: rows.collect() }
}

fn row(run: &SceneRun, progress: &mut dyn FnMut(f64)) -> Result<Row, String> {
    let dt = run.scene.dt;
    let timed = || -> Result<(f64, Box<dyn Simulation>), String> {
        let start = Instant::now();
        let simulation = run.start()?;
        Ok((start.elapsed().as_secs_f64(), simulation))
    };
    let (build, simulation) = timed()?;
    drop(simulation);
    let build = median((1..RUNS).map(|_| timed().map(|(seconds, _)| seconds)).collect::<Result<Vec<_>, _>>()?, build);
    progress(0.1);

    let observed = observe(run)?;
    progress(0.2);
    let steps = run.scene.steps();
    let times = (0..RUNS).map(|_| plain(run)).collect::<Result<Vec<_>, _>>()?;
    let first = times.first().copied().unwrap_or(0.0);
    let step = median(times, first) / steps.max(1) as f64;
    progress(0.3);

    let finest = states(run, dt / FINEST)?.0;
    progress(0.6);
    let mut points = Vec::new();
    for divisor in DIVISORS {
        let with = with_step(run, dt / divisor);
        let seconds = (0..RUNS).filter_map(|_| plain(&with).ok()).fold(f64::NAN, f64::min);
        let error = states(run, dt / divisor).ok().and_then(|(states, _)| difference(&run.scene, &states, &finest));
        points.push(Point { dt: dt / divisor, seconds, error });
    }
    progress(0.8);
    let (largest_step, is_unlimited) = largest_step(run, observed.displacement);
    Ok(Row {
        build,
        step,
        frame: observed.frame,
        memory: observed.memory,
        points,
        largest_step,
        is_unlimited,
        volume_lost: observed.volume_lost,
        events: observed.events,
    })
}

fn with_step(run: &SceneRun, dt: f64) -> SceneRun {
    SceneRun { scene: Scene { dt, ..run.scene.clone() }, options: run.options }
}

/// The run time of all steps of a scene [s].
fn plain(run: &SceneRun) -> Result<f64, String> {
    let (mut simulation, mut summary) = (run.start()?, StepSummary::default());
    let start = Instant::now();
    for _ in 0..run.scene.steps() {
        simulation.step();
        simulation.summary(&mut summary);
        if let Some(failure) = &summary.failure {
            return Err(failure.to_string());
        }
    }
    Ok(start.elapsed().as_secs_f64())
}

/// Observations of a run.
struct Observed {
    frame: f64,
    memory: Option<u64>,
    volume_lost: f64,
    displacement: f64,
    events: Vec<(String, f64)>,
}

fn observe(run: &SceneRun) -> Result<Observed, String> {
    let mut simulation = run.start()?;
    let schema = simulation.schema();
    let mut merger = Merger::new(&schema, simulation.interrupt());
    let mut touches = Touches::new(&*simulation);
    let (mut frame, mut summary, mut found) = (Frame::default(), StepSummary::default(), Vec::new());
    let (mut seconds, mut events, mut displacement) = (0.0, Vec::new(), 0.0f64);
    let mut volumes: Vec<f64> = Vec::new();
    let (mut local, steps) = (Vectors::default(), run.scene.steps());
    for step in 0..=steps {
        let start = Instant::now();
        if step > 0 {
            simulation.step();
            simulation.summary(&mut summary);
            if let Some(failure) = &summary.failure {
                return Err(failure.to_string());
            }
        }
        simulation.observe(Want::ALL, &mut frame);
        let merged = merger.merge(&schema, &frame, &[]);
        seconds += start.elapsed().as_secs_f64();

        displacement = frame
            .bodies
            .iter()
            .zip(&schema.bodies)
            .map(|(now, body)| now.max_displacement / body.radius)
            .fold(displacement, f64::max);
        let of_groups: f64 = merged.groups.iter().map(|group| group.volume).sum();
        let alone = (0..frame.bodies.len()).filter(|&body| !merged.is_merged.get(body).copied().unwrap_or(false));
        volumes.push(of_groups + alone.map(|body| volume(&schema, &frame, body, &mut local)).sum::<f64>());
        if step > 0 {
            touches.step(&*simulation, &frame, &summary.events, &mut found);
            let surfaces = found.iter().filter(|event| matches!(event.what, Finding::Touch | Finding::Part));
            let surfaces = surfaces.map(|event: &SurfaceEvent| (event.name(), event.a, event.b, event.time));
            let phases = summary.events.iter().map(|event| (event.name, event.a, event.b, event.time));
            let named =
                |(name, a, b, time): (&str, usize, usize, f64)| (format!("{name} {}", schema.pair_name(a, b)), time);
            events.extend(surfaces.chain(phases).map(named));
        }
    }
    events.sort_by(|x, y| x.1.total_cmp(&y.1));
    let first = volumes.first().copied().unwrap_or(0.0);
    let least = volumes.iter().copied().fold(f64::INFINITY, f64::min);
    Ok(Observed {
        frame: seconds / steps.max(1) as f64,
        memory: simulation.memory(),
        volume_lost: if first > 0.0 { 1.0 - least / first } else { 0.0 },
        displacement,
        events,
    })
}

/// The volume of a body's own mesh [scene unit³].
fn volume(schema: &Schema, frame: &Frame, body: usize, local: &mut Vectors) -> f64 {
    let (of, now) = (&schema.bodies[body], &frame.bodies[body]);
    now.local_positions(now.rest_of(of), local);
    let corner = |v: u32| local.get(v as usize);
    now.mesh_of(of).triangles().iter().map(|&[a, b, c]| corner(a).dot(corner(b).cross(corner(c))) / 6.0).sum()
}

/// Time [s], and positions of all vertices relative to their centres [scene unit], at several instants.
type States = Vec<(f64, Vec<Vec<DVec3>>)>;

/// The states of a run with another step, at every second instant of the scene's own steps; and the largest
/// displacement [radii].
fn states(run: &SceneRun, dt: f64) -> Result<(States, f64), String> {
    let with = with_step(run, dt);
    let (mut simulation, mut summary, mut frame) = (with.start()?, StepSummary::default(), Frame::default());
    let schema = simulation.schema();
    let every = (2.0 * run.scene.dt / dt).round().max(1.0) as u64; // all runs include every second instant
    let (mut states, mut largest, mut local) = (Vec::new(), 0.0f64, Vectors::default());
    for step in 1..=with.scene.steps() {
        simulation.step();
        simulation.summary(&mut summary);
        if let Some(failure) = &summary.failure {
            return Err(failure.to_string());
        }
        if !step.is_multiple_of(every) {
            continue;
        }
        simulation.observe(Want::default(), &mut frame);
        let of = |(now, body): (&crate::observe::BodyFrame, &crate::observe::schema::BodySchema)| {
            largest = f64::max(largest, now.max_displacement / body.radius);
            now.local_positions(now.rest_of(body), &mut local);
            local.iter().take(body.vertex_count()).collect::<Vec<_>>()
        };
        states.push((frame.at.time, frame.bodies.iter().zip(&schema.bodies).map(of).collect()));
    }
    Ok((states, largest))
}

/// The largest distance between a vertex's positions in two runs, at common instants [radii]; `None` if NaN.
fn difference(scene: &Scene, run: &States, finest: &States) -> Option<f64> {
    let mut largest = 0.0f64;
    for ((_, one), (_, other)) in run.iter().zip(finest) {
        for ((one, other), body) in one.iter().zip(other).zip(&scene.bodies) {
            for (one, other) in one.iter().zip(other) {
                let distance = one.distance(*other) / body.radius;
                if !distance.is_finite() {
                    return None;
                }
                largest = largest.max(distance);
            }
        }
    }
    Some(largest)
}

/// The largest stable step [s] among doublings and halvings of the scene's step, and whether all longer ones that were
/// tried are stable.
fn largest_step(run: &SceneRun, displacement: f64) -> (Option<f64>, bool) {
    let limit = f64::max(STABLE_LIMIT, STABLE_MULTIPLE * displacement);
    let is_stable = |dt: f64| {
        // the instants need not be those of the scene's own steps: only the largest displacement matters
        let scene = Scene { dt, ..run.scene.clone() };
        let with = SceneRun { scene, options: run.options };
        let Ok(mut simulation) = with.start() else { return false };
        let (mut summary, mut frame) = (StepSummary::default(), Frame::default());
        (0..with.scene.steps()).all(|_| {
            simulation.step();
            simulation.summary(&mut summary);
            simulation.observe(Want::default(), &mut frame);
            let bodies = frame.bodies.iter().zip(&run.scene.bodies);
            summary.failure.is_none()
                && bodies.into_iter().all(|(now, body)| now.max_displacement <= limit * body.radius)
        })
    };
    let longest = f64::min(LONGEST * run.scene.dt, 0.5 * run.scene.duration);
    let mut dt = run.scene.dt;
    if is_stable(dt) {
        while 2.0 * dt <= longest {
            if !is_stable(2.0 * dt) {
                return (Some(dt), false);
            }
            dt *= 2.0;
        }
        return (Some(dt), true);
    }
    for _ in 0..6 {
        dt *= 0.5;
        if is_stable(dt) {
            return (Some(dt), false);
        }
    }
    (None, false)
}

fn median(mut times: Vec<f64>, one: f64) -> f64 {
    times.push(one);
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

/// A table of the models on one scene, their events, and the reasons of models that cannot run it.
pub fn table(report: &Report) -> String {
    let heading = [
        "model",
        "step [ms]",
        "frame [ms]",
        "frames/s",
        "build [ms]",
        "memory",
        "error [R]",
        "largest dt [s]",
        "volume lost",
    ];
    let cells = |row: &Row| {
        [
            significant(1e3 * row.step),
            significant(1e3 * row.frame),
            format!("{:.0}", 1.0 / row.frame),
            significant(1e3 * row.build),
            row.memory.map_or_else(missing, bytes),
            match row.error(report.dt) {
                None => "diverged".to_owned(),
                Some(error) if error < FLOOR => format!("< {FLOOR:.0e}"),
                Some(error) => format!("{error:.1e}"),
            },
            match (row.largest_step, row.is_unlimited) {
                (None, _) => "none".to_owned(),
                (Some(dt), true) => format!("≥ {dt:.4}"),
                (Some(dt), false) => format!("{dt:.4}"),
            },
            format!("{:.2} %", 100.0 * row.volume_lost + 0.0),
        ]
    };
    let measured = report.rows.iter().filter_map(|(model, row)| Some((model, row.as_ref().ok()?)));
    let rows = measured
        .clone()
        .map(|(model, row)| std::iter::once(model.name().to_owned()).chain(cells(row)).collect::<Vec<_>>());
    let mut text = format!(
        "{}: {}, steps of {:.6} s\n\n{}\n",
        report.scene,
        counted(report.vertices, "vertex"),
        report.dt,
        tables::table(heading, rows)
    );
    for (model, row) in measured {
        let events: Vec<String> = row.events.iter().take(12).map(|(name, time)| format!("{name} {time:.6}")).collect();
        let events = if events.is_empty() { "no merges or splits".to_owned() } else { events.join(", ") };
        text += &format!("\n{model} [s]: {events}");
    }
    for (model, row) in &report.rows {
        if let Err(why) = row {
            text += &format!("\n{model}: {why}");
        }
    }
    text
}

/// Explains the columns.
pub fn footer(machine: &Machine) -> String {
    format!(
        "step: median of {RUNS} runs; frame: a step, its state with forces, and the merged surface; error: the largest over time and\n\
         vertices, against the model's own run with 1/{FINEST} of the step; largest dt: among doublings and halvings; volume lost:\n\
         of all surfaces together, in the worst frame\n{machine}"
    )
}

#[derive(Serialize)]
struct CsvLine<'a> {
    scene: &'a str,
    model: &'a str,
    dt_s: Option<f64>,
    run_time_ms: Option<f64>,
    error_radii: Option<f64>,
    step_ms: Option<f64>,
    frame_ms: Option<f64>,
    build_ms: Option<f64>,
    memory_bytes: Option<u64>,
    largest_dt_s: Option<f64>,
    volume_lost: Option<f64>,
    refused: &'a str,
    cpu: &'a str,
    version: &'a str,
}

/// All measurements, one line per step of each model.
///
/// # Errors
/// None is known to occur.
pub fn csv(reports: &[Report], machine: &Machine) -> Result<String, String> {
    let mut lines = Vec::new();
    for report in reports {
        for (model, row) in &report.rows {
            let line = |row: Option<&Row>, point: Option<&Point>, refused| CsvLine {
                scene: &report.scene,
                model: model.name(),
                dt_s: point.map(|point| point.dt),
                run_time_ms: point.map(|point| 1e3 * point.seconds),
                error_radii: point.map(|point| point.error.unwrap_or(f64::INFINITY)),
                step_ms: row.map(|row| 1e3 * row.step),
                frame_ms: row.map(|row| 1e3 * row.frame),
                build_ms: row.map(|row| 1e3 * row.build),
                memory_bytes: row.and_then(|row| row.memory),
                largest_dt_s: row.and_then(|row| row.largest_step),
                volume_lost: row.map(|row| row.volume_lost),
                refused,
                cpu: &machine.cpu,
                version: machine.version,
            };
            match row {
                Ok(row) => lines.extend(row.points.iter().map(|point| line(Some(row), Some(point), ""))),
                Err(why) => lines.push(line(None, None, why.as_str())),
            }
        }
    }
    tables::csv(lines)
}

/// Size of a panel with its labels [px].
const PANEL: (u32, u32) = (900, 560);
const TOP: u32 = 46;
const RIGHT: u32 = 220;

fn style(model: Model) -> Style {
    let (color, marker, width) = match model {
        Model::Oscillators => (RGBColor(0, 158, 115), Marker::Disc, 3),
        Model::Metaballs => (RGBColor(204, 121, 167), Marker::Polygon(&[1.0, 3.0, 5.0, 7.0]), 2),
        Model::Lattice => (RGBColor(230, 159, 0), Marker::Polygon(&[4.0, 1.33, 6.67]), 2),
        Model::Fem => (RGBColor(0, 114, 178), Marker::Polygon(&[0.0, 2.67, 5.33]), 2),
    };
    Style { color, marker, width }
}

/// The work-precision diagram, one panel per scene.
///
/// # Errors
/// Errors of the drawing library; none is known to occur.
pub fn svg(reports: &[Report], machine: &Machine) -> Result<String, String> {
    let columns = if reports.len() > 1 { 2 } else { 1 };
    let rows = reports.len().div_ceil(columns).max(1);
    let sheet = Sheet {
        size: (PANEL.0 * columns as u32, PANEL.1 * rows as u32),
        title: "Models: work and precision",
        heading: [
            "Down is more accurate, left is faster. The step is halved from point to point, starting at twice the scene’s own.",
            "Each model is compared with its own converged solution, not with the other models.",
        ],
        notes: &[
            "Error: the largest over time and vertices. Metaballs have no dynamics: their error is rounding error.",
            &machine.to_string(),
        ],
    };
    sheet.svg(|panels| {
        let panels = panels.split_evenly((rows, columns));
        panels.iter().zip(reports).try_for_each(|(panel, report)| draw(panel, report))
    })
}

fn draw(panel: &Area<'_>, report: &Report) -> Result<(), Failure> {
    let rows = || report.rows.iter().filter_map(|(model, row)| Some((*model, row.as_ref().ok()?)));
    let points = || rows().flat_map(|(_, row)| &row.points).filter(|point| point.seconds > 0.0);
    let times: Vec<f64> = points().map(|point| 1e3 * point.seconds).collect();
    let errors: Vec<f64> = points().filter_map(|point| point.error).map(|error| error.max(FLOOR)).collect();
    let (times, errors) = (Axis::of_run_times(times.into_iter()), error_range(errors.into_iter()));
    let last = times.range.end;
    let at = draw_axes(panel, TOP, RIGHT, [times, Axis::of_errors("largest error [radii]", errors.clone())])?;
    let title = format!("{} ({} vertices)", report.scene, report.vertices);
    write(panel, &title, (LEFT as i32, TOP as i32 / 2), 24.0, INK)?;
    let right = at(last, errors.start).0;
    let pixel = |point: &Point| {
        at(1e3 * point.seconds, point.error.map_or(errors.end, |error| error.clamp(errors.start, errors.end)))
    };
    let lines = rows().map(|(model, row)| {
        let is_drawn = |point: &&Point| point.seconds > 0.0;
        Line {
            name: model.name().to_owned(),
            style: style(model),
            points: row.points.iter().filter(is_drawn).map(pixel).collect(),
        }
    });
    draw_lines(panel, TOP, right, lines.collect())
}
