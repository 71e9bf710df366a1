//! The thesis, section by section: what each figure and claim says, and what is measured on a [built-in
//! scene](crate::scene::builtin).

use std::{f64::consts::TAU, time::Instant};

use glam::DVec3;

use super::{
    MeasureError, influence, models,
    report::{Cell, Column, Report, Table},
};
use crate::{
    Scene, World,
    geometry::{Shape, Sphere},
    model::THESIS,
    models::{
        cells::Cells,
        lattice::{Constants, Lattice},
    },
    scene::{Integrator, Model, TearMode},
    text::{significant, thousands},
};

/// The built-in scenes of the figures, in the order of the thesis.
const SCENES: [&str; 8] =
    ["figure-2-1", "figure-2-2b", "figure-2-2c", "figure-2-3", "figure-4-1", "figure-4-2", "figure-4-3", "section-4-3"];

/// Runs are repeated for at least this time [s], and at least [`RUNS`] times; the shortest counts.
const SECONDS: f64 = 0.25;
const RUNS: u32 = 3;
/// Time between two frames on a screen [s].
const FRAME: f64 = 1.0 / 60.0;
/// Stacks of the spheres of `figure-4-2` with which the cost per vertex is measured; there are twice as many slices.
const STACKS: [u32; 4] = [12, 24, 48, 96];
/// A displacement that changes by more than this in a step is a snap [radii].
const SNAP: f64 = 0.05;
/// Bodies that are displaced by more than this are deformed extremely [radii].
const EXTREME: f64 = 0.3;

/// A claim, and a measurement of it.
#[derive(Clone, Debug)]
pub struct Row {
    /// The section, and the figure if there is one.
    pub section: &'static str,
    /// What the thesis says.
    pub claim: &'static str,
    /// The scene, with what differs from it.
    pub scene: String,
    /// What was measured, with its unit.
    pub quantity: &'static str,
    /// The value.
    pub value: f64,
    /// The value with its unit as printed.
    pub shown: String,
    /// Whether the claim holds here, in a word.
    pub verdict: &'static str,
}

/// Measures every row. `progress` is told the share that is done.
///
/// # Errors
/// A built-in scene is missing or fails.
pub fn measure(progress: &mut dyn FnMut(f64)) -> Result<Vec<Row>, MeasureError> {
    type Part = fn() -> Result<Vec<Row>, MeasureError>;
    let parts: [Part; 8] = [springs, elements, tearing, metaballs, scheme, figures, sizes, rates];
    let mut rows = Vec::new();
    for (number, part) in (0..).zip(parts) {
        progress(f64::from(number) / parts.len() as f64);
        rows.extend(part()?);
    }
    Ok(rows)
}

fn builtin(name: &'static str) -> Result<Scene, MeasureError> {
    Scene::builtin(name).ok_or(MeasureError::NoScene(name))
}

/// A built-in scene with another model, whose own scheme is the integrator.
fn with_model(name: &'static str, model: Model) -> Result<Scene, MeasureError> {
    Ok(Scene { model, integrator: Integrator::Exponential, ..builtin(name)? })
}

fn yes(holds: bool) -> &'static str {
    if holds { "yes" } else { "no" }
}

fn percent(share: f64) -> String {
    format!("{:.1} %", 100.0 * share + 0.0)
}

fn milliseconds(seconds: f64) -> String {
    format!("{} ms", significant(1e3 * seconds))
}

// --- chapter 2: the other models -------------------------------------------------------------------------------------

/// Springs (2.1.1).
fn springs() -> Result<Vec<Row>, MeasureError> {
    let cell = Cells::block(2, [1; 3]);
    let held = vec![false; cell.node_count()];
    let constants = |density| Constants::of(1.0, 0.0, 1.0, density);
    let count = Lattice::new(&cell, 1.0, 1.0, held, constants, None).map_or(0, |lattice| lattice.spring_count());
    let mut rows = vec![Row {
        section: "2.1.1, Fig. 2.1",
        claim: "a cell has 28 springs",
        scene: "one cell".to_owned(),
        quantity: "springs",
        value: count as f64,
        shown: format!("{count} springs"),
        verdict: yes(count == 28),
    }];
    for omega in [12.0, 24.0] {
        let mut scene = with_model("three", Model::Lattice)?;
        scene.bodies.iter_mut().for_each(|body| body.material.omega = omega);
        let lost = models::observe(&scene).map_err(MeasureError::Model)?.volume_lost;
        rows.push(Row {
            section: "2.1.1",
            claim: "too much force breaks springs locally",
            scene: format!("three, lattice, ω = {omega}"),
            quantity: "volume lost in the worst frame, overlaps included [–]",
            value: lost,
            shown: format!("{} of the volume lost", percent(lost)),
            verdict: yes(lost > 0.1),
        });
    }
    let scene = builtin("figure-4-2")?;
    let longest = models::largest_step(&scene, models::STABLE_LIMIT).unwrap_or(0.0);
    rows.push(Row {
        section: "2.1.1",
        claim: "too long a step diverges",
        scene: "figure-4-2, oscillators".to_owned(),
        quantity: "largest stable step [s]",
        value: longest,
        shown: format!("stable up to steps of {longest:.3} s"),
        verdict: yes(longest < models::LONGEST * scene.dt),
    });
    Ok(rows)
}

/// Finite elements (2.1.2, 2.2.1).
fn elements() -> Result<Vec<Row>, MeasureError> {
    let two = with_model("two", Model::Fem)?;
    let run = models::follow(&two, two.dt).map_err(MeasureError::Model)?;
    let step = run.seconds / run.steps as f64;
    let mut rows = vec![Row {
        section: "2.1.2",
        claim: "finite elements are too slow for real time",
        scene: "two, fem".to_owned(),
        quantity: "time of a step [s]",
        value: step,
        shown: format!("{} per step", milliseconds(step)),
        verdict: yes(step > FRAME),
    }];
    for cells in [6, 12] {
        let mut scene = with_model("figure-4-1", Model::Fem)?;
        scene.fem.cells = cells;
        let best = shortest(|| {
            let clock = Instant::now();
            models::start(&scene).map(|_| clock.elapsed().as_secs_f64()).map_err(MeasureError::Model)
        })?;
        rows.push(Row {
            section: "2.2.1",
            claim: "K cannot be rebuilt in real time",
            scene: format!("figure-4-1, fem, {cells} cells"),
            quantity: "time to build and factor [s]",
            value: best,
            shown: format!("{} to build and factor", milliseconds(best)),
            verdict: yes(best > FRAME),
        });
    }
    Ok(rows)
}

/// Tearing (2.2.2).
fn tearing() -> Result<Vec<Row>, MeasureError> {
    let mut rows = Vec::new();
    for cells in [8, 16, 32] {
        let lost = torn("figure-2-2b", cells)?.lost;
        let (claim, verdict) = match rows.last() {
            None => ("cutting springs loses volume", yes(lost > 0.0)),
            Some(Row { value, .. }) => ("more cells lose less volume", yes(lost < *value)),
        };
        rows.push(Row {
            section: "2.2.2, Fig. 2.2b",
            claim,
            scene: format!("figure-2-2b, {cells} cells"),
            quantity: "share of the cells that are cut [–]",
            value: lost,
            shown: format!("{} of the volume lost", percent(lost)),
            verdict,
        });
    }
    let Torn { lost, split } = torn("figure-2-2c", 8)?;
    rows.push(Row {
        section: "2.2.2, Fig. 2.2c",
        claim: "splitting nodes keeps the volume",
        scene: "figure-2-2c, 8 cells".to_owned(),
        quantity: "share of the cells that are cut [–]",
        value: lost,
        shown: format!("{} of the volume lost, {split} nodes split", percent(lost)),
        verdict: yes(lost == 0.0 && split > 0),
    });
    let mut scene = builtin("figure-2-2c")?;
    let mut time = |tear: TearMode| -> Result<f64, MeasureError> {
        scene.lattice.tear = tear;
        let run = || models::follow(&scene, scene.dt).map(|run| run.seconds / run.steps as f64);
        shortest(|| run().map_err(MeasureError::Model))
    };
    let (cut, split) = (time(TearMode::Cut)?, time(TearMode::Split)?);
    rows.push(Row {
        section: "2.2.2, Fig. 2.2c",
        claim: "splitting nodes costs more than cutting",
        scene: "figure-2-2c, figure-2-2b".to_owned(),
        quantity: "time of a step that splits over that of one that cuts [–]",
        value: split / cut,
        shown: format!("{:.1} times the time of a step ({})", split / cut, milliseconds(split)),
        verdict: yes(split > cut),
    });
    Ok(rows)
}

/// What a run has torn.
struct Torn {
    /// Share of the cells that were cut [–].
    lost: f64,
    /// Number of nodes that were split.
    split: usize,
}

/// Runs a scene of one lattice, with this many cells along its diameter.
fn torn(name: &'static str, cells: u32) -> Result<Torn, MeasureError> {
    let mut scene = builtin(name)?;
    scene.lattice.cells = cells;
    let all = scene.bodies.first().and_then(|body| Cells::cover(&body.shape.mesh(), cells, None));
    let all = all.map_or(0, |cells| cells.cell_count());
    let mut run = models::start(&scene).map_err(MeasureError::Model)?;
    let (mut cut, mut split) = (0, 0);
    while models::step(&mut run).map_err(MeasureError::Model)? {
        let events = &run.summary.body_events;
        cut += events.iter().filter(|event| event.name == "cut cell").count();
        split += events.iter().filter(|event| event.name == "split node").count();
    }
    Ok(Torn { lost: cut as f64 / all as f64, split })
}

/// Metaballs (2.2.3).
fn metaballs() -> Result<Vec<Row>, MeasureError> {
    let scene = builtin("figure-2-3")?;
    let observed = models::observe(&scene).map_err(MeasureError::Model)?;
    let touch = observed.events.iter().find(|(name, _)| name.starts_with("touch"));
    let q = touch.map_or(0.0, |&(_, time)| {
        let [a, b] = [0, 1].map(|body| super::path(&scene.bodies[body]).position(time));
        a.distance(b) / (scene.bodies[0].radius + scene.bodies[1].radius)
    });
    Ok(vec![Row {
        section: "2.2.3, Fig. 2.3",
        claim: "facing sides bulge and join",
        scene: "figure-2-3".to_owned(),
        quantity: "q at which the surfaces join [–]",
        value: q,
        shown: format!("surfaces join at q = {q:.3}"),
        verdict: yes(q > 1.0),
    }])
}

// --- chapter 3: the model --------------------------------------------------------------------------------------------

/// The influence (3.2), and the scheme as printed (3.3).
fn scheme() -> Result<Vec<Row>, MeasureError> {
    let scene = builtin("figure-4-1")?;
    let material = scene.bodies[0].material;
    let exact = (material.omega * material.omega - material.damping * material.damping).sqrt();
    let ratio = swing(&scene)? / exact;
    let switched = builtin("figure-4-2")?;
    let at_the_switch = influence::at_the_switch(&switched);
    let warnings =
        SCENES.iter().map(|name| Ok(builtin(name)?.warnings().len())).sum::<Result<usize, MeasureError>>()?;
    Ok(vec![
        Row {
            section: "3.2, Fig. 3.2",
            claim: "the sphere encloses the body, the body its centre",
            scene: format!("all {}", SCENES.len()),
            quantity: "warnings",
            value: warnings as f64,
            shown: format!("{warnings} warnings"),
            verdict: yes(warnings == 0),
        },
        Row {
            section: "3.2, Fig. 3.3",
            claim: "influence falls with the distance",
            scene: switched.name.clone(),
            quantity: "force of attraction on the nearest vertex when a pair merges, over the largest at any distance [–]",
            value: at_the_switch,
            shown: format!("{} of the largest force at the switch", percent(at_the_switch)),
            verdict: yes(at_the_switch < 0.1),
        },
        Row {
            section: "3.3, Fig. 3.4",
            claim: "(3.6)–(3.10) solve (3.2)",
            scene: "figure-4-1".to_owned(),
            quantity: "frequency over that of (3.2) [–]",
            value: ratio,
            shown: format!("{ratio:.3} times the frequency"),
            verdict: yes((ratio - 1.0).abs() < 0.01),
        },
    ])
}

/// The angular frequency at which the vertex that was displaced most swings after the force points have ceased to act
/// [rad/s].
fn swing(scene: &Scene) -> Result<f64, MeasureError> {
    let end = scene.points.iter().map(|point| point.end()).fold(0.0, f64::max);
    let mut world = World::new(scene.clone())?;
    let (mut vertex, mut axis) = (0, DVec3::ZERO);
    let (mut before, mut crossings) = (0.0, Vec::new());
    for _ in 0..scene.steps() {
        let _ = world.step();
        let body = world.body(0);
        if world.time() < end {
            let farthest =
                |&a: &usize, &b: &usize| body.displacement(a).length().total_cmp(&body.displacement(b).length());
            vertex = (0..body.vertex_count()).max_by(farthest).unwrap_or(0);
            axis = body.displacement(vertex).normalize_or_zero();
            continue;
        }
        let now = body.displacement(vertex).dot(axis);
        if before < 0.0 && now >= 0.0 {
            crossings.push(world.time() - scene.dt * now / (now - before));
        }
        before = now;
    }
    let periods = crossings.len().saturating_sub(1) as f64;
    Ok(match (crossings.first(), crossings.last()) {
        (Some(first), Some(last)) if periods > 0.0 => TAU * periods / (last - first),
        _ => 0.0,
    })
}

// --- chapter 4: the figures ------------------------------------------------------------------------------------------

/// The motion of the vertices of a scene.
#[derive(Clone, Debug)]
pub struct Moved {
    /// The largest displacement of each body [radii].
    pub largest: Vec<f64>,
    /// The largest change of a displacement in a step [radii].
    pub in_a_step: f64,
    /// The largest displacement after each step, of all bodies [radii].
    pub after: Vec<f64>,
}

/// Runs a scene of oscillators.
///
/// # Errors
/// The scene needs more memory than is available, or its run fails.
pub fn moved(scene: &Scene) -> Result<Moved, MeasureError> {
    let mut world = World::new(scene.clone())?;
    let state = |world: &World| -> Vec<DVec3> {
        let of = |body| (0..world.body(body).vertex_count()).map(move |i| (body, i));
        let all = (0..world.body_count()).flat_map(of);
        all.map(|(body, i)| world.body(body).displacement(i) / world.body(body).scene().radius).collect()
    };
    let mut moved = Moved { largest: vec![0.0; world.body_count()], in_a_step: 0.0, after: Vec::new() };
    let mut before = state(&world);
    for _ in 0..scene.steps() {
        if let Some(failure) = world.step().failure.clone() {
            return Err(failure.into());
        }
        let now = state(&world);
        let changes = now.iter().zip(&before).map(|(now, before)| now.distance(*before));
        moved.in_a_step = changes.fold(moved.in_a_step, f64::max);
        before = now;
        let mut after = 0.0f64;
        for (body, largest) in moved.largest.iter_mut().enumerate() {
            let displacement = world.body(body).max_displacement() / world.body(body).scene().radius;
            *largest = largest.max(displacement);
            after = after.max(displacement);
        }
        moved.after.push(after);
    }
    Ok(moved)
}

/// The figures of 4.2, and the settings of 4.1.
fn figures() -> Result<Vec<Row>, MeasureError> {
    let mut rows = Vec::new();
    let figures = [
        ("figure-4-1", "4.2.1, Fig. 4.1", "an outside force changes the shape"),
        ("figure-4-2", "4.2.2, Fig. 4.2", "two merge gradually"),
        ("figure-4-3", "4.2.3, Fig. 4.3", "three change their shapes smoothly"),
    ];
    for (name, section, claim) in figures {
        let scene = builtin(name)?;
        let moved = moved(&scene)?;
        let largest = moved.largest.iter().copied().fold(0.0, f64::max);
        rows.push(Row {
            section: "4.1",
            claim: "with a small α, shapes are not deformed extremely",
            scene: name.to_owned(),
            quantity: "largest displacement [radii]",
            value: largest,
            shown: format!("displaced by {largest:.2} R"),
            verdict: yes(largest <= EXTREME),
        });
        rows.push(Row {
            section,
            claim,
            scene: name.to_owned(),
            quantity: "largest change of a displacement in a step [radii]",
            value: moved.in_a_step,
            shown: format!("{:.3} R in a step", moved.in_a_step),
            verdict: yes(moved.in_a_step <= SNAP),
        });
        if name == "figure-4-1" {
            let left = moved.after.last().map_or(0.0, |end| end / largest);
            rows.push(Row {
                section,
                claim: "it returns in waves when the force is gone",
                scene: name.to_owned(),
                quantity: "displacement at the end over the largest [–]",
                value: left,
                shown: format!("{} of the displacement left", percent(left)),
                verdict: yes(left < 0.1),
            });
        }
    }
    Ok(rows)
}

/// Very different sizes (4.3).
fn sizes() -> Result<Vec<Row>, MeasureError> {
    let row = |name: &'static str, claim: &'static str, is_met: fn(f64) -> bool| -> Result<Row, MeasureError> {
        let small = moved(&builtin(name)?)?.largest.last().copied().unwrap_or(0.0);
        Ok(Row {
            section: "4.3",
            claim,
            scene: name.to_owned(),
            quantity: "largest displacement of the small body [its radii]",
            value: small,
            shown: format!("small body displaced by {small:.2} R"),
            verdict: yes(is_met(small)),
        })
    };
    Ok(vec![
        row("section-4-3", "very different sizes fail", |small| small > 1.0)?,
        row("size_ratio", "(relative strengths: ours) they do not", |small| small < 1.0)?,
    ])
}

/// Frame rates of 4.2, and their dependence on the number of vertices.
fn rates() -> Result<Vec<Row>, MeasureError> {
    let mut rows = Vec::new();
    let row = |section, claim, scene: &Scene, what: &str, than: f64| -> Result<Row, MeasureError> {
        let rate = rate(scene)?;
        Ok(Row {
            section,
            claim,
            scene: format!("{}, {} vertices, {what}", scene.name, thousands(scene.vertex_count())),
            quantity: "steps per second [1/s]",
            value: rate,
            shown: format!("{} steps/s", thousands(rate.round() as u64)),
            verdict: if rate > than { "faster" } else { "slower" },
        })
    };
    let schemes = [(Integrator::Thesis, "as printed"), (Integrator::Exponential, "exponential")];
    for (integrator, what) in schemes {
        let scene = |name| Ok::<_, MeasureError>(Scene { integrator, ..builtin(name)? });
        rows.push(row("4.2.1", "266 vertices: no rate is given", &scene("figure-4-1")?, what, 0.0)?);
        rows.push(row("4.2.2", "532 vertices: about 30 frames/s", &scene("figure-4-2")?, what, 30.0)?);
        rows.push(row("4.2.3", "798 vertices: about 24 frames/s", &scene("figure-4-3")?, what, 24.0)?);
    }
    rows[0].verdict = "–";
    rows[3].verdict = "–";
    for (integrator, what) in schemes {
        let mut measured = Vec::new();
        for stacks in STACKS {
            let mut scene = Scene { integrator, ..builtin("figure-4-2")? };
            let shape = Shape::Sphere(Sphere { stacks, slices: 2 * stacks });
            scene.bodies.iter_mut().for_each(|body| body.shape = shape.clone());
            let claim = "the rate falls as vertices are added";
            let of = row("4.3, 5", claim, &scene, what, 0.0)?;
            measured.push((scene.vertex_count() as f64, of.value));
            rows.push(Row { verdict: "–", ..of });
        }
        for (number, pair) in (rows.len() - STACKS.len() + 1..).zip(measured.windows(2)) {
            rows[number].verdict = yes(pair[1].1 < pair[0].1);
        }
        if let (Some(first), Some(last)) = (measured.first(), measured.last()) {
            let exponent = (first.1 / last.1).ln() / (last.0 / first.0).ln();
            rows.push(Row {
                section: "1, 2.1.1",
                claim: "cost is proportional to the vertices",
                scene: format!("figure-4-2, {what}"),
                quantity: "exponent of the vertices in the cost [–]",
                value: exponent,
                shown: format!("cost ~ vertices^{exponent:.2}"),
                verdict: if exponent > 0.9 { "yes" } else { "less" },
            });
        }
    }
    Ok(rows)
}

/// Steps per second of a scene of oscillators [1/s].
fn rate(scene: &Scene) -> Result<f64, MeasureError> {
    let seconds = shortest(|| {
        let mut world = World::new(scene.clone())?;
        let clock = Instant::now();
        for _ in 0..scene.steps() {
            let _ = world.step();
        }
        let seconds = clock.elapsed().as_secs_f64();
        world.report().failure.clone().map_or(Ok(seconds), |failure| Err(failure.into()))
    })?;
    Ok(scene.steps() as f64 / seconds)
}

/// The shortest of the times [s] that a run reports: of at least [`RUNS`], and of as many as fit into [`SECONDS`].
fn shortest(mut run: impl FnMut() -> Result<f64, MeasureError>) -> Result<f64, MeasureError> {
    let (begin, mut shortest, mut runs) = (Instant::now(), f64::INFINITY, 0);
    while runs < RUNS || begin.elapsed().as_secs_f64() < SECONDS {
        shortest = shortest.min(run()?);
        runs += 1;
    }
    Ok(shortest)
}

// --- results --------------------------------------------------------------------------------------------------------

/// The columns of the table.
pub fn columns() -> Vec<Column> {
    vec![
        Column::text("section", "section"),
        Column::text("claim", "claim"),
        Column::text("scene", "scene"),
        Column::text("", "quantity"),
        Column::number("measured", "value", significant),
        Column::text("verdict", "verdict"),
    ]
}

/// The table of all rows, and Fig. 3.3 as a chart.
///
/// # Errors
/// A built-in scene is missing.
pub fn report(rows: &[Row]) -> Result<Report, MeasureError> {
    let cells = |row: &Row| -> Vec<Cell> {
        vec![
            row.section.into(),
            row.claim.into(),
            row.scene.as_str().into(),
            row.quantity.into(),
            Cell::Shown(row.value, row.shown.clone()),
            row.verdict.into(),
        ]
    };
    let scenes = influence::SCENES.into_iter().map(builtin).collect::<Result<Vec<_>, _>>()?;
    Ok(Report {
        tables: vec![Table { columns: columns(), rows: rows.iter().map(cells).collect(), ..Table::default() }],
        notes: format!(
            "{THESIS}\nits rates are frames of a Pentium D of 2.8 GHz, with drawing; these are steps alone; as printed: (3.6)–(3.10)"
        ),
        chart: Some(influence::chart(&scenes)),
        ..Report::default()
    })
}
