//! Speed of merged surfaces: unions of two to hundreds of spheres, and a scene with the surface of every frame.

use std::{sync::Arc, time::Instant};

use glam::DVec3;

use super::tables;
use crate::{
    Scene, World,
    analysis::surface::Merger,
    geometry::{
        Mesh, Sphere,
        shape::Solid as _,
        union::{Body, Budget, Hint, Topology, UnionError, measures_of, union},
    },
    observe::{
        BodyFrame, Frame, PairFrame, Schema, Simulation as _, Want,
        schema::{BodySchema, PhaseSchema},
    },
    text::thousands,
};

/// Each arrangement is computed for at least this total time [s], and at least [`MIN_RUNS`] times.
const SECONDS: f64 = 0.5;
const MIN_RUNS: u32 = 3;

/// The cost of an arrangement of spheres, best of several runs.
#[derive(Clone, Debug)]
pub struct Row {
    /// The arrangement.
    pub name: &'static str,
    /// Number of bodies.
    pub bodies: usize,
    /// Number of vertices of all bodies.
    pub vertices: usize,
    /// Time of the union alone [s].
    pub union: f64,
    /// Time of the drawn surface: union, mesh, components, fairing [s].
    pub drawn: f64,
    /// Time of gap, overlap and neck, in addition to the union [s]; only for two bodies.
    pub measures: Option<f64>,
    /// Euler characteristic of the union and number of further attempts, or why it failed.
    pub result: Result<(i64, u32), UnionError>,
}

/// Frames per second of a scene that is stepped, observed and united.
#[derive(Clone, Copy, Debug)]
pub struct Run {
    /// Frames per second with the surface of every frame, and the measures of every pair.
    pub merged: f64,
    /// Frames per second without surfaces and measures.
    pub plain: f64,
    /// Fraction of the frames that have a group.
    pub share: f64,
    /// Mean time of surface and measures in a frame without a group, and in one with a group [s]; NaN without such
    /// frames.
    pub costs: [f64; 2],
}

/// Measures all arrangements.
pub fn measure() -> Vec<Row> {
    let coarse = Arc::new(Sphere { stacks: 12, slices: 24 }.mesh());
    let fine = Arc::new(Sphere { stacks: 72, slices: 141 }.mesh());
    let line = |count: u32, step: f64| -> Vec<DVec3> {
        // not aligned with the axes, like moving bodies
        (0..count).map(|i| f64::from(i) * step * DVec3::new(0.96, 0.224, 0.168)).collect()
    };
    let heap = |count: u32| -> Vec<DVec3> {
        let at = |i: u32, factor: f64| (f64::from(i) * factor).fract() - 0.5;
        (0..count).map(|i| DVec3::new(at(i, 0.754877666), at(i, 0.569840291), at(i, 0.438579))).collect()
    };
    let lattice = |side: u32| -> Vec<DVec3> {
        let of = |i: u32| DVec3::new(f64::from(i % side), f64::from(i / side % side), f64::from(i / side / side));
        (0..side.pow(3)).map(|i| 1.61 * of(i) + 0.01 * DVec3::new(0.3, 0.7, 0.1) * f64::from(i % 7)).collect()
    };
    vec![
        row("two of 266 vertices", &coarse, &line(2, 1.6)),
        row("two of 10,000 vertices", &fine, &line(2, 1.6)),
        row("a chain of 300", &coarse, &line(300, 1.6)),
        row("a lattice of 5 × 5 × 5", &coarse, &lattice(5)),
        row("64 in one place", &coarse, &heap(64)),
    ]
}

fn row(name: &'static str, mesh: &Arc<Mesh>, centres: &[DVec3]) -> Row {
    let (bodies, vertices) = (centres.len(), centres.len() * mesh.vertex_count());
    let failed = |error| Row { name, bodies, vertices, union: 0.0, drawn: 0.0, measures: None, result: Err(error) };
    let Ok(topology) = Topology::new(mesh.vertex_count(), mesh.triangles()) else {
        return failed(UnionError::TooLarge);
    };
    let budget = Budget::default();
    let positions: Vec<Vec<DVec3>> =
        centres.iter().map(|centre| mesh.positions().iter().map(|position| position + centre).collect()).collect();
    let placed = || positions.iter().filter_map(|positions| Body::new(&topology, positions).ok()).collect::<Vec<_>>();
    let all = placed();
    let united = match union(&all, &budget) {
        Ok(united) => united,
        Err(error) => return failed(error),
    };
    let measures = (bodies == 2).then(|| best(|| drop(measures_of(&united, &budget, &mut Hint::default()))));

    // one group regardless of phases
    let schema = Schema {
        bodies: (0..bodies).map(|i| BodySchema::new(&i.to_string(), "sphere", Arc::clone(mesh), 1.0, 0.0)).collect(),
        phases: vec![PhaseSchema { is_joined: true, ..("merged", [0; 3]).into() }],
        ..Schema::default()
    };
    let at_rest = |centre: DVec3| BodyFrame { centre, is_at_rest: true, ..BodyFrame::default() };
    // alternates between two positions, because results are reused for bodies that have not moved
    let frames = [0.0, 1e-3].map(|by| Frame {
        bodies: centres.iter().map(|&centre| at_rest(centre + DVec3::splat(by))).collect(),
        pairs: (1..bodies).map(|b| PairFrame { a: 0, b, q: 1.0, phase: 0 }).collect(),
        ..Frame::default()
    });
    let (mut merger, mut turn) = (Merger::new(&schema, None), 0);
    let mut draw = || {
        turn += 1;
        merger.merge(&schema, &frames[turn % 2], &[]);
    };
    Row {
        name,
        bodies,
        vertices,
        union: best(|| drop(union(&placed(), &budget))),
        drawn: best(&mut draw),
        measures,
        result: Ok((united.euler(), united.statistics.retries)),
    }
}

/// The shortest time of several calls [s].
fn best(mut work: impl FnMut()) -> f64 {
    let (begin, mut best, mut count) = (Instant::now(), f64::INFINITY, 0);
    while count < MIN_RUNS || begin.elapsed().as_secs_f64() < SECONDS {
        let start = Instant::now();
        work();
        best = best.min(start.elapsed().as_secs_f64());
        count += 1;
    }
    best
}

/// Measures a scene.
///
/// # Errors
/// The scene cannot be run, for the returned reason.
pub fn run(scene: &Scene) -> Result<Run, String> {
    let mut fastest = [f64::INFINITY; 2];
    let (mut share, mut costs) = (0.0, [f64::INFINITY; 2]);
    for (has_surface, fastest) in [false, true].into_iter().zip(&mut fastest) {
        for _ in 0..MIN_RUNS {
            let mut world = World::new(scene.clone()).map_err(|error| error.to_string())?;
            let schema = world.schema();
            let (mut merger, mut frame) = (Merger::new(&schema, None), Frame::default());
            let (mut times, mut counts) = ([0.0; 2], [0u32; 2]);
            let start = Instant::now();
            for _ in 0..scene.steps() {
                world.step();
                world.observe(Want { forces: true, scalars: true }, &mut frame);
                if has_surface {
                    let pairs: Vec<[usize; 2]> = frame.pairs.iter().map(|pair| [pair.a, pair.b]).collect();
                    let start = Instant::now();
                    let has_group = usize::from(!merger.merge(&schema, &frame, &pairs).groups.is_empty());
                    times[has_group] += start.elapsed().as_secs_f64();
                    counts[has_group] += 1;
                }
            }
            *fastest = fastest.min(start.elapsed().as_secs_f64() / scene.steps() as f64);
            if has_surface {
                share = f64::from(counts[1]) / f64::from(counts[0] + counts[1]);
                costs = [0, 1].map(|k| costs[k].min(times[k] / f64::from(counts[k])));
            }
        }
    }
    let [plain, merged] = fastest.map(|seconds| 1.0 / seconds);
    Ok(Run { merged, plain, share, costs })
}

/// Formats the measurements.
pub fn table(rows: &[Row]) -> String {
    let heading = ["spheres", "bodies", "vertices", "union, ms", "drawn, ms", "measures, ms", "χ", "retries"];
    let milliseconds = |seconds: f64| format!("{:.3}", 1e3 * seconds);
    let cells = rows.iter().map(|row| {
        let (bodies, vertices) = (thousands(row.bodies as u64), thousands(row.vertices as u64));
        match &row.result {
            Ok((euler, retries)) => vec![
                row.name.to_owned(),
                bodies,
                vertices,
                milliseconds(row.union),
                milliseconds(row.drawn),
                row.measures.map_or_else(tables::missing, milliseconds),
                euler.to_string(),
                retries.to_string(),
            ],
            Err(error) => vec![row.name.to_owned(), bodies, vertices, error.to_string()],
        }
    });
    tables::table(heading, cells)
}
