//! The soft-body models side by side: cost, error, stability, volume loss, and times of merging and splitting.
//!
//! Nothing here depends on a particular model: everything is measured through [`Simulation`](crate::observe::Simulation).

use std::time::Instant;

use glam::DVec3;

use super::{
    chart::{Axis, Chart, Line, Marker, Panel, SQUARE, Style, TIP, TRIANGLE},
    report::{Cell, Column, Machine, Report, Table},
};
use crate::{
    Scene,
    analysis::{surface::Merger, touch::Touches},
    geometry::{Vectors, mesh::signed_volume_of},
    models::SceneRun,
    observe::{Experiment as _, Frame, Run, Schema, SurfaceEvent, Want, schema::titled, surface::Finding},
    scene::Model,
    sim::Options,
    svg,
    text::{counted, significant},
};

/// Upper limit on the measured steps of a scene.
const MAX_STEPS: u64 = 1200;
/// Number of timings of a run, of which the best is reported.
const RUNS: usize = 3;
/// Divisors of the scene's step for the work-precision diagram.
const DIVISORS: [f64; 5] = [0.5, 1.0, 2.0, 4.0, 8.0];
/// Divisor of the scene's step for the converged solution of each model.
const FINEST: f64 = 32.0;
/// Longer steps are tried up to this multiple of the scene's step.
pub(super) const LONGEST: f64 = 64.0;
/// A run is stable while every displacement is below this [radii], or below [`STABLE_MULTIPLE`] times the largest in the
/// run with the scene's own step.
pub(super) const STABLE_LIMIT: f64 = 10.0;
/// See [`STABLE_LIMIT`].
const STABLE_MULTIPLE: f64 = 3.0;
/// Smaller errors are drawn at this value [radii].
const FLOOR: f64 = 1e-12;
/// Upper limit on the number of events that are listed of a model.
const MOST_EVENTS: usize = 12;

/// The models on one scene.
#[derive(Clone, Debug)]
pub struct Measured {
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
    /// Time of a step with its frame: the state with its forces, and the merged surface [s].
    pub frame: f64,
    /// Runs with several steps, with the largest error over time and vertices against the model's own converged solution.
    pub points: Vec<Point>,
    /// The largest stable step [s], if any that was tried is stable.
    pub largest_step: Option<f64>,
    /// The largest relative loss of total volume during the run [–].
    pub volume_lost: f64,
    /// Touch and part events, and phase changes, in order of time.
    pub events: Vec<(String, f64)>,
}

/// A run with one of the steps.
#[derive(Clone, Copy, Debug)]
pub struct Point {
    /// The step [s].
    pub dt: f64,
    /// Time of all steps [s], the shortest of several; NaN if the run failed.
    pub seconds: f64,
    /// Number of steps.
    pub steps: u64,
    /// The error [radii]; infinite if the run failed.
    pub error: f64,
}

/// Measures some models on a scene.
pub fn measure(scene: &Scene, models: &[Model], progress: &mut dyn FnMut(f64)) -> Measured {
    let mut scene = scene.clone();
    if scene.steps() > MAX_STEPS {
        scene.duration = MAX_STEPS as f64 * scene.dt;
    }
    let count = models.len() as f64;
    let rows = (0..).zip(models.iter().copied()).map(|(k, model)| {
        progress(f64::from(k) / count);
        let scene = Scene { model, ..scene.clone() };
        (model, row(&scene, &mut |share| progress((f64::from(k) + share) / count)))
    });
    Measured { scene: scene.name.clone(), vertices: scene.vertex_count(), dt: scene.dt, rows: rows.collect() }
}

/// A run of a scene, at its start.
pub(super) fn start(scene: &Scene) -> Result<Run, String> {
    let simulation = SceneRun { scene: scene.clone(), options: Options::default() }.start()?;
    Ok(Run::new(simulation, Some(scene.steps())))
}

/// Takes a step; returns whether there was one left.
pub(super) fn step(run: &mut Run) -> Result<bool, String> {
    run.valid_step().map_err(|failure| failure.to_string())
}

fn row(scene: &Scene, progress: &mut dyn FnMut(f64)) -> Result<Row, String> {
    let clock = Instant::now();
    drop(start(scene)?);
    let build = clock.elapsed().as_secs_f64();
    let mut row = observe(scene)?;
    row.build = build;
    progress(0.3);
    let own = follow(scene, scene.dt)?;
    let finest = follow(scene, scene.dt / FINEST)?;
    progress(0.6);
    for divisor in DIVISORS {
        let dt = scene.dt / divisor;
        let runs: Vec<_> = (0..RUNS).filter_map(|_| follow(scene, dt).ok()).collect();
        let error = runs.first().map_or(f64::INFINITY, |run| difference(scene, run, &finest));
        let seconds = runs.iter().map(|run| run.seconds).fold(f64::NAN, f64::min);
        row.points.push(Point { dt, seconds, steps: runs.first().map_or(0, |run| run.steps), error });
    }
    progress(0.8);
    row.largest_step = largest_step(scene, f64::max(STABLE_LIMIT, STABLE_MULTIPLE * own.displacement));
    Ok(row)
}

/// Runs a scene with everything that a recording shows.
pub(super) fn observe(scene: &Scene) -> Result<Row, String> {
    let mut run = start(scene)?;
    let schema = run.simulation.schema();
    let mut merger = Merger::new(&schema, run.simulation.interrupt());
    let mut touches = Touches::new(&*run.simulation);
    let (mut frame, mut found, mut local) = (Frame::default(), Vec::new(), Vectors::default());
    let (mut seconds, mut events, mut volumes) = (0.0, Vec::new(), Vec::new());
    let mut clock = Instant::now();
    loop {
        let simulation = &*run.simulation;
        simulation.observe(Want::ALL, &mut frame);
        let merged = merger.merge(&schema, &frame, &[]);
        seconds += clock.elapsed().as_secs_f64();

        let of_groups: f64 = merged.groups.iter().map(|group| group.volume).sum();
        let alone = (0..frame.bodies.len()).filter(|&body| !merged.is_merged.get(body).copied().unwrap_or(false));
        volumes.push(of_groups + alone.map(|body| volume(&schema, &frame, body, &mut local)).sum::<f64>());
        if simulation.steps_taken() > 0 {
            let phases = &run.summary.events;
            touches.step(simulation, &frame, phases, &mut found);
            let surfaces = found.iter().filter(|event| matches!(event.what, Finding::Touch | Finding::Part));
            let surfaces = surfaces.map(|event: &SurfaceEvent| (event.name(), event.a, event.b, event.time));
            let phases = phases.iter().map(|event| (event.name, event.a, event.b, event.time));
            let named = |(name, a, b, time): (&str, usize, usize, f64)| (titled(name, &schema.pair_name(a, b)), time);
            events.extend(surfaces.chain(phases).map(named));
        }
        clock = Instant::now();
        if !step(&mut run)? {
            break;
        }
    }
    events.sort_by(|x, y| x.1.total_cmp(&y.1));
    let least = volumes.iter().copied().fold(f64::INFINITY, f64::min);
    let lost = volumes.first().map(|first| 1.0 - least / first).filter(|lost| lost.is_finite());
    Ok(Row {
        build: 0.0,
        frame: seconds / scene.steps().max(1) as f64,
        points: vec![],
        largest_step: None,
        volume_lost: lost.unwrap_or(0.0),
        events,
    })
}

/// The volume of a body's own mesh [scene unit³].
fn volume(schema: &Schema, frame: &Frame, body: usize, local: &mut Vectors) -> f64 {
    let (of, now) = (&schema.bodies[body], &frame.bodies[body]);
    now.local_positions(now.rest_of(of), local);
    signed_volume_of(local, now.mesh_of(of).triangles())
}

/// The motion in a run with some step.
pub(super) struct Trajectory {
    /// Positions of all vertices relative to their centres [scene unit], `[instant][body][vertex]`, at every second
    /// instant of the scene's own steps.
    states: Vec<Vec<Vec<DVec3>>>,
    /// Time of all steps [s].
    pub seconds: f64,
    pub steps: u64,
    /// The largest displacement at these instants, or at every step that is longer [radii].
    displacement: f64,
}

pub(super) fn follow(scene: &Scene, dt: f64) -> Result<Trajectory, String> {
    let every = (2.0 * scene.dt / dt).round().max(1.0) as u64; // all runs include every second instant
    let scene = Scene { dt, ..scene.clone() };
    let (mut run, mut frame, mut local) = (start(&scene)?, Frame::default(), Vectors::default());
    let schema = run.simulation.schema();
    let mut trajectory = Trajectory { states: vec![], seconds: 0.0, steps: scene.steps(), displacement: 0.0 };
    loop {
        let clock = Instant::now();
        if !step(&mut run)? {
            return Ok(trajectory);
        }
        trajectory.seconds += clock.elapsed().as_secs_f64();
        if !run.simulation.steps_taken().is_multiple_of(every) {
            continue;
        }
        run.simulation.observe(Want::default(), &mut frame);
        let mut state = Vec::with_capacity(frame.bodies.len());
        for (now, body) in frame.bodies.iter().zip(&schema.bodies) {
            let displacement = now.max_displacement / body.radius;
            let largest = &mut trajectory.displacement;
            *largest = if displacement <= *largest { *largest } else { displacement };
            now.local_positions(now.rest_of(body), &mut local);
            state.push(local.iter().take(body.vertex_count()).collect());
        }
        trajectory.states.push(state);
    }
}

/// The largest distance between a vertex's positions in two runs, at common instants [radii]; infinite if NaN.
fn difference(scene: &Scene, run: &Trajectory, finest: &Trajectory) -> f64 {
    let mut largest = 0.0f64;
    for (one, other) in run.states.iter().zip(&finest.states) {
        for ((one, other), body) in one.iter().zip(other).zip(&scene.bodies) {
            for (one, other) in one.iter().zip(other) {
                let distance = one.distance(*other) / body.radius;
                largest = if distance.is_finite() { largest.max(distance) } else { f64::INFINITY };
            }
        }
    }
    largest
}

/// The largest stable step [s] among doublings of the scene's step, or else the first stable one of its halves. A run is
/// stable if no displacement exceeds `limit` [radii].
pub(super) fn largest_step(scene: &Scene, limit: f64) -> Option<f64> {
    let is_stable = |dt: &f64| follow(scene, *dt).is_ok_and(|run| run.displacement <= limit);
    let longest = f64::min(LONGEST * scene.dt, 0.5 * scene.duration);
    let doubled = |dt: &f64| Some(2.0 * dt).filter(|dt| *dt <= longest);
    let longer = std::iter::successors(Some(scene.dt), doubled).take_while(is_stable).last();
    longer.or_else(|| (1..=6).map(|halvings| scene.dt * 0.5f64.powi(halvings)).find(is_stable))
}

// --- results --------------------------------------------------------------------------------------------------------

/// The columns of the measurements: a row per model in the table, a row per point of the diagram in a file.
pub fn columns() -> Vec<Column> {
    let error = |error: f64| match error {
        ..FLOOR => format!("< {FLOOR:.0e}"),
        f64::INFINITY => "diverged".to_owned(),
        error => format!("{error:.1e}"),
    };
    vec![
        Column::text("", "scene"),
        Column::text("model", "model"),
        Column::number("", "dt_s", |dt| dt.to_string()),
        Column::number("", "run_time_ms", significant),
        Column::number("step [ms]", "step_ms", significant),
        Column::number("frame [ms]", "frame_ms", significant),
        Column::number("build [ms]", "build_ms", significant),
        Column::number("error [R]", "error_radii", error),
        Column::number("largest dt [s]", "largest_dt_s", |dt| format!("{dt:.4}")),
        Column::number("volume lost", "volume_lost", |share| format!("{:.2} %", 100.0 * share + 0.0)),
        Column::text("", "refused"),
    ]
}

impl Measured {
    /// The models that can run the scene.
    fn rows(&self) -> impl Iterator<Item = (Model, &Row)> {
        self.rows.iter().filter_map(|(model, row)| Some((*model, row.as_ref().ok()?)))
    }

    fn cells(&self, model: Model, row: &Row, point: &Point) -> Vec<Cell> {
        vec![
            self.scene.as_str().into(),
            model.name().into(),
            point.dt.into(),
            (1e3 * point.seconds).into(),
            (1e3 * point.seconds / point.steps as f64).into(),
            (1e3 * row.frame).into(),
            (1e3 * row.build).into(),
            point.error.into(),
            row.largest_step.into(),
            row.volume_lost.into(),
            Cell::Missing,
        ]
    }

    fn refused(&self, model: Model, why: &str) -> Vec<Cell> {
        let mut cells = vec![Cell::Missing; columns().len()];
        (cells[0], cells[1]) = (self.scene.as_str().into(), model.name().into());
        if let Some(last) = cells.last_mut() {
            *last = why.into();
        }
        cells
    }

    fn table(&self) -> Table {
        let own = |row: &Row| row.points.iter().copied().find(|point| point.dt == self.dt);
        let mut conclusions = Vec::new();
        for (model, row) in self.rows() {
            let mut events: Vec<String> =
                row.events.iter().take(MOST_EVENTS).map(|(name, time)| format!("{name} {time:.6}")).collect();
            if row.events.len() > MOST_EVENTS {
                events.push(format!("and {} more", row.events.len() - MOST_EVENTS));
            }
            let events = if events.is_empty() { "no merges or splits".to_owned() } else { events.join(", ") };
            conclusions.push(format!("{model} [s]: {events}"));
        }
        let refused = self.rows.iter().filter_map(|(model, row)| Some(format!("{model}: {}", row.as_ref().err()?)));
        conclusions.extend(refused);
        Table {
            title: format!("{}: {}, steps of {:.6} s", self.scene, counted(self.vertices, "vertex"), self.dt),
            columns: columns(),
            rows: self.rows().filter_map(|(model, row)| Some(self.cells(model, row, &own(row)?))).collect(),
            conclusions,
        }
    }

    fn panel(&self) -> Panel {
        let line = |(model, row): (Model, &Row)| {
            let (color, marker, width) = match model {
                Model::Oscillators => (svg::GREEN, Marker::Disc, 3.0),
                Model::Metaballs => (svg::PURPLE, SQUARE, 2.0),
                Model::Lattice => (svg::ORANGE, TIP, 2.0),
                Model::Fem => (svg::BLUE, TRIANGLE, 2.0),
            };
            let points = row.points.iter().filter(|point| point.seconds > 0.0);
            let points = points.map(|point| [1e3 * point.seconds, point.error.max(FLOOR)]);
            Line {
                name: model.name().to_owned(),
                style: Style { color, marker, width },
                points: points.collect(),
                ringed: None,
            }
        };
        let lines: Vec<Line> = self.rows().map(line).collect();
        let of = |k: usize| lines.iter().flat_map(|line| &line.points).map(move |point| point[k]).collect::<Vec<_>>();
        let errors = of(1).into_iter().chain([0.1]);
        Panel {
            title: format!("{} ({} vertices)", self.scene, self.vertices),
            axes: [
                Axis::spanning("run time [ms]", of(0).into_iter(), 1.5),
                Axis::spanning("largest error [radii]", errors, 3.0),
            ],
            lines,
            marks: Vec::new(),
        }
    }
}

/// A table for each scene, and the work-precision diagram with a panel for each.
pub fn report(scenes: &[Measured], machine: &Machine) -> Report {
    let mut rows = Vec::new();
    for measured in scenes {
        for (model, row) in &measured.rows {
            match row {
                Ok(row) => rows.extend(row.points.iter().map(|point| measured.cells(*model, row, point))),
                Err(why) => rows.push(measured.refused(*model, why)),
            }
        }
    }
    let chart = Chart {
        title: "Models: work and precision".to_owned(),
        heading: [
            "Down is more accurate, left is faster. Each point halves the step, from twice the scene’s own on.",
            "Each model is compared with its own converged solution, not with the other models.",
        ],
        panels: scenes.iter().map(Measured::panel).collect(),
        notes: vec![
            "Error: the largest over time and vertices. Metaballs have no dynamics: their error is rounding error."
                .to_owned(),
            machine.to_string(),
        ],
    };
    Report {
        tables: scenes.iter().map(Measured::table).collect(),
        notes: format!(
            "step: the best of {RUNS} runs; frame: a step, its state with forces, and the merged surface; error: the largest over \
             time and\nvertices, against the model's own run with 1/{FINEST} of the step; largest dt: among doublings and halvings, up to {LONGEST} times; \
             volume lost:\nof all surfaces together, in the worst frame"
        ),
        file: Some(Table { columns: columns(), rows, ..Table::default() }),
        chart: Some(chart),
        ..Report::default()
    }
}
