//! Speed of merged surfaces: unions of two to hundreds of spheres.

use std::{sync::Arc, time::Instant};

use glam::DVec3;

use super::report::{Cell, Column, Report, Table};
use crate::{
    analysis::surface::Merger,
    geometry::{
        Mesh, Sphere,
        shape::Solid as _,
        union::{Body, Budget, Hint, Topology, UnionError, measures_of, union},
    },
    observe::{
        BodyFrame, Frame, PairFrame, Schema,
        schema::{BodySchema, PhaseSchema},
    },
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
    pub union: Option<f64>,
    /// Time of the drawn surface: union, mesh, components, fairing [s].
    pub drawn: Option<f64>,
    /// Time of gap, overlap and neck, in addition to the union [s]; only for two bodies.
    pub measures: Option<f64>,
    /// Euler characteristic of the union, or why it failed.
    pub result: Result<i64, UnionError>,
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
    let failed = |error| Row { name, bodies, vertices, union: None, drawn: None, measures: None, result: Err(error) };
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
    let measures = (bodies == 2).then(|| best(|| drop(measures_of(&united, [0, 1], &budget, &mut Hint::default()))));

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
        pairs: (1..bodies).map(|b| PairFrame::new(0, b, 1.0, 0)).collect(),
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
        union: Some(best(|| drop(union(&placed(), &budget)))),
        drawn: Some(best(&mut draw)),
        measures,
        result: Ok(united.euler()),
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

/// The columns of a measurement.
pub fn columns() -> Vec<Column> {
    let time = |heading, name| Column::number(heading, name, |seconds| format!("{:.3}", 1e3 * seconds));
    vec![
        Column::text("spheres", "spheres"),
        Column::count("bodies", "bodies"),
        Column::count("vertices", "vertices"),
        time("union [ms]", "union_s"),
        time("drawn [ms]", "drawn_s"),
        time("measures [ms]", "measures_s"),
        Column::text("χ", "euler_characteristic"),
    ]
}

/// The measured arrangements.
pub fn report(rows: &[Row]) -> Report {
    let unions = Table {
        columns: columns(),
        rows: rows
            .iter()
            .map(|row| {
                let result = row.result.as_ref().map_or_else(ToString::to_string, ToString::to_string);
                let of = [row.name.into(), row.bodies.into(), row.vertices.into()];
                of.into_iter().chain([row.union, row.drawn, row.measures].map(Cell::from)).chain([Cell::Text(result)])
            })
            .map(Iterator::collect)
            .collect(),
        ..Table::default()
    };
    Report {
        tables: vec![unions],
        notes: "union: the closed surface alone; drawn: with its mesh, components and smooth seams; measures: gap, overlap and \
                neck;\nbest of several runs"
            .to_owned(),
        ..Report::default()
    }
}
