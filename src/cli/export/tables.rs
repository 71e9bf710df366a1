//! The tables of a run and their columns.

use std::{collections::BTreeMap, path::PathBuf};

use super::Arguments;
use crate::{
    analysis::surface::Merger,
    cli::Failure,
    geometry::Vectors,
    observe::{
        BodyFrame, EventRow, Frame, Instant, Schema, StepSummary,
        schema::{BodySchema, ScalarOf, ScalarSchema},
    },
    table::{Cell, Column, Kind, Table, TableError},
};

impl From<TableError> for Failure {
    fn from(error: TableError) -> Failure {
        match error {
            TableError::Refused(why) => Failure::Input(why),
            TableError::Failed(why) => Failure::Run(why),
        }
    }
}

const STEP: Column = Column::required("step", Kind::Count, "number of the step");
const TIME: Column = Column::required("time", Kind::Float, "simulated time [s]");
const Q: &str = "centre distance over the sum of the radii";

/// The columns of a table of events.
pub const EVENTS: [Column; 10] = [
    Column::required("step", Kind::Count, "the first step that the event affects"),
    Column::required("time", Kind::Float, "exact time [s]"),
    Column::required("event", Kind::Text, "kind of event: see `meldscope reference events`"),
    Column::required("a", Kind::Text, "a body"),
    Column::new("b", Kind::Text, "the other body; empty for an event of a single body"),
    Column::new("q", Kind::Float, Q),
    Column::new("rate", Kind::Float, "rate of change of q [1/s]; empty unless a phase changes"),
    Column::new("from", Kind::Text, "phase before; empty unless a phase changes"),
    Column::new("to", Kind::Text, "phase after; empty unless a phase changes"),
    Column::new("surfaces", Kind::Text, "the surfaces at a change of phase, in words"),
];
/// The first columns of a table of pairs within reach; each scalar of a pair of the simulation follows.
pub const PAIRS: [Column; 9] = [
    STEP,
    TIME,
    Column::required("a", Kind::Text, "a body"),
    Column::required("b", Kind::Text, "the other body"),
    Column::required("q", Kind::Float, Q),
    Column::required("phase", Kind::Text, "phase"),
    Column::new(
        "gap",
        Kind::Float,
        "smallest distance of the surfaces; where they overlap, minus how deep a point of one surface lies inside the other \
         at most [radii of the smaller body]; with overlap and neck, empty but for the 64 closest pairs",
    ),
    Column::new("overlap", Kind::Float, "volume of the intersection [radius³ of the smaller body]"),
    Column::new("neck", Kind::Float, "radius of the line along which the surfaces meet [radii of the smaller body]"),
];
/// Number of pairs whose surfaces are compared in a step: each may take a millisecond.
const MEASURED: usize = 64;
/// The first columns of a table of bodies; each scalar of a body of the simulation follows.
pub const BODIES: [Column; 7] = [
    STEP,
    TIME,
    Column::required("body", Kind::Text, "body"),
    Column::required("x", Kind::Float, "position of its centre [scene unit]"),
    Column::required("y", Kind::Float, ""),
    Column::required("z", Kind::Float, ""),
    Column::required("max_displacement", Kind::Float, "largest displacement of a vertex [radii]"),
];
/// The first columns of a table of scalars; each scalar of the simulation follows.
pub const SCALARS: [Column; 2] = [STEP, TIME];
/// The columns of a table of states.
pub const STATES: [Column; 13] = [
    STEP,
    TIME,
    Column::required("body", Kind::Text, "body"),
    Column::required("vertex", Kind::Count, "index of the vertex"),
    Column::required("x", Kind::Float, "position in the world [scene unit]"),
    Column::required("y", Kind::Float, ""),
    Column::required("z", Kind::Float, ""),
    Column::required("dx", Kind::Float, "displacement from rest, which is integrated [scene unit]"),
    Column::required("dy", Kind::Float, ""),
    Column::required("dz", Kind::Float, ""),
    Column::required("vx", Kind::Float, "velocity of the displacement, which is integrated [scene unit/s]"),
    Column::required("vy", Kind::Float, ""),
    Column::required("vz", Kind::Float, ""),
];

/// The columns of a table of forces.
pub const FORCES: [Column; 12] = [
    STEP,
    TIME,
    Column::required("body", Kind::Text, "body"),
    Column::new("vertex", Kind::Count, "index of the vertex; empty for a force at another point"),
    Column::required("cause", Kind::Text, "cause of the acceleration; net: the sum of all others"),
    Column::new("source", Kind::Text, "the body whose sphere causes it, if it is a single one"),
    Column::required("x", Kind::Float, "acceleration [scene unit/s²]"),
    Column::required("y", Kind::Float, ""),
    Column::required("z", Kind::Float, ""),
    Column::new("at_x", Kind::Float, "the point, if it is no vertex [scene unit]"),
    Column::new("at_y", Kind::Float, ""),
    Column::new("at_z", Kind::Float, ""),
];

/// What a table by step has its rows from.
pub struct StepData<'a> {
    pub schema: &'a Schema,
    pub frame: &'a Frame,
    /// The step that led to the frame.
    pub summary: &'a StepSummary,
    /// Measures pairs.
    pub merger: &'a mut Merger,
}

/// A table with rows for each step.
pub struct ByStep {
    /// Where it is to be written, if at all.
    pub path: fn(&Arguments) -> Option<&PathBuf>,
    /// Its columns.
    pub columns: fn(&Schema) -> Vec<Column>,
    /// Adds the rows of a step.
    pub add: fn(&mut Table, &mut StepData<'_>) -> Result<(), TableError>,
}

/// The tables with rows for each step.
pub const BY_STEP: [ByStep; 5] = [
    ByStep {
        path: |arguments| arguments.pairs.as_ref(),
        columns: |schema| with_scalars(&PAIRS, &schema.pair_scalars),
        add: add_pairs,
    },
    ByStep {
        path: |arguments| arguments.bodies.as_ref(),
        columns: |schema| with_scalars(&BODIES, &schema.body_scalars),
        add: add_bodies,
    },
    ByStep {
        path: |arguments| arguments.scalars.as_ref(),
        columns: |schema| with_scalars(&SCALARS, &schema.scalars),
        add: add_scalars,
    },
    ByStep { path: |arguments| arguments.states.as_ref(), columns: |_| STATES.into(), add: add_states },
    ByStep { path: |arguments| arguments.forces.as_ref(), columns: |_| FORCES.into(), add: add_forces },
];

/// Adds an event to a table of events.
pub fn add_event(table: &mut Table, schema: &Schema, row: &EventRow<'_>) -> Result<(), TableError> {
    let head = |name| [Cell::Count(row.step()), Cell::Float(row.time()), Cell::Text(name)];
    let pair = |a, b, q| [body(schema, a), body(schema, b), Cell::Float(q)];
    let cells = match row {
        EventRow::Phase(event, surfaces) => {
            let phase = |phase: usize| Cell::Text(schema.phases[phase].name);
            let surfaces = surfaces.as_deref().map_or(Cell::Null, Cell::Text);
            let rest = [Cell::Float(event.rate), phase(event.from), phase(event.to), surfaces];
            [&head(event.name)[..], &pair(event.a, event.b, event.q), &rest].concat()
        }
        EventRow::Contact(event) => {
            [&head(event.name())[..], &pair(event.a, event.b, event.q), &[Cell::Null; 4]].concat()
        }
        EventRow::Body(event) => [&head(event.name)[..], &[body(schema, event.body)], &[Cell::Null; 6]].concat(),
    };
    table.row(&cells)
}

/// Adds the pairs within reach.
fn add_pairs(table: &mut Table, data: &mut StepData<'_>) -> Result<(), TableError> {
    let StepData { schema, frame, ref mut merger, .. } = *data;
    let [step, time] = instant(frame.at);
    let count = schema.pair_scalars.len();
    let mut closest: Vec<_> = frame.pairs.iter().collect();
    closest.sort_by(|x, y| x.q.total_cmp(&y.q));
    let closest: Vec<[usize; 2]> = closest.iter().take(MEASURED).map(|pair| [pair.a, pair.b]).collect();
    let measures = merger.measure(schema, frame, &closest);
    let measures: BTreeMap<_, _> =
        closest.iter().zip(measures).filter_map(|(&pair, of)| Some((pair, (*of)?))).collect();
    frame.pairs.iter().enumerate().try_for_each(|(index, pair)| {
        let phase = Cell::Text(schema.phases[pair.phase].name);
        let [gap, overlap, neck] = match measures.get(&[pair.a, pair.b]) {
            Some(of) => [of.gap, of.overlap, of.neck].map(Cell::Float),
            None => [Cell::Null; 3],
        };
        let (a, b) = (body(schema, pair.a), body(schema, pair.b));
        let cells = [step, time, a, b, Cell::Float(pair.q), phase, gap, overlap, neck];
        table.row(&[&cells[..], &numbers(&frame.pair_scalars, index, count)].concat())
    })
}

/// The bodies that are there, with their indices and states.
fn present<'a>(data: &StepData<'a>) -> impl Iterator<Item = (usize, &'a BodySchema, &'a BodyFrame)> + use<'a> {
    let bodies = data.schema.bodies.iter().zip(&data.frame.bodies).enumerate();
    bodies.filter(|(_, (_, now))| !now.is_absent).map(|(index, (of, now))| (index, of, now))
}

fn add_bodies(table: &mut Table, data: &mut StepData<'_>) -> Result<(), TableError> {
    let StepData { schema, frame, .. } = *data;
    let [step, time] = instant(frame.at);
    let count = schema.body_scalars.len();
    present(data).try_for_each(|(index, of, now)| {
        let [x, y, z] = now.centre.to_array().map(Cell::Float);
        let cells = [step, time, body(schema, index), x, y, z, Cell::Float(now.max_displacement / of.radius)];
        table.row(&[&cells[..], &numbers(&frame.body_scalars, index, count)].concat())
    })
}

fn with_scalars(first: &[Column], scalars: &[ScalarSchema]) -> Vec<Column> {
    let scalars = scalars.iter().map(|scalar| Column::new(scalar.name, Kind::Float, scalar.label));
    first.iter().cloned().chain(scalars).collect()
}

/// The scalars of body or pair `index`, which has `count` of them.
fn numbers(values: &[f64], index: usize, count: usize) -> Vec<Cell<'static>> {
    let of = |i: usize| values.get(index * count + i).copied().filter(|value| !value.is_nan());
    (0..count).map(|i| of(i).map_or(Cell::Null, Cell::Float)).collect()
}

fn add_scalars(table: &mut Table, data: &mut StepData<'_>) -> Result<(), TableError> {
    let StepData { schema, frame, summary, .. } = *data;
    let scalars = schema.scalars.iter().enumerate().map(|(index, scalar)| {
        let values = if scalar.of == ScalarOf::State { &frame.scalars } else { &summary.scalars };
        values.get(index).map_or(Cell::Null, |&value| Cell::Float(value))
    });
    table.row(&instant(frame.at).into_iter().chain(scalars).collect::<Vec<_>>())
}

/// Adds the exact state of each vertex.
fn add_states(table: &mut Table, data: &mut StepData<'_>) -> Result<(), TableError> {
    let StepData { schema, frame, .. } = *data;
    let [step, time] = instant(frame.at);
    let mut local = Vectors::default();
    for (index, of, now) in present(data) {
        now.local_positions(now.rest_of(of), &mut local);
        for i in 0..local.len() {
            let position = now.centre + local.get(i);
            let velocity = if now.is_at_rest { glam::DVec3::ZERO } else { now.velocities.get(i) };
            let [x, y, z] = position.to_array().map(Cell::Float);
            let [dx, dy, dz] = now.displacement(i).to_array().map(Cell::Float);
            let [vx, vy, vz] = velocity.to_array().map(Cell::Float);
            let vertex = Cell::Count(i as u64);
            table.row(&[step, time, body(schema, index), vertex, x, y, z, dx, dy, dz, vx, vy, vz])?;
        }
    }
    Ok(())
}

/// Adds each cause that acts on a vertex, and each force at another point. A force of zero has no row.
fn add_forces(table: &mut Table, data: &mut StepData<'_>) -> Result<(), TableError> {
    let StepData { schema, frame, .. } = *data;
    let [step, time] = instant(frame.at);
    let by = |source: Option<u32>| source.map_or(Cell::Null, |source| body(schema, source as usize));
    for (index, now) in frame.bodies.iter().enumerate() {
        for (of, term) in schema.terms.iter().zip(&now.terms) {
            let source = by(term.source);
            for (i, acceleration) in term.accelerations.iter().enumerate() {
                if acceleration != glam::DVec3::ZERO {
                    let [x, y, z] = acceleration.to_array().map(Cell::Float);
                    let (vertex, cause) = (Cell::Count(i as u64), Cell::Text(of.name));
                    let head = [step, time, body(schema, index), vertex, cause, source, x, y, z];
                    table.row(&[&head[..], &[Cell::Null; 3]].concat())?;
                }
            }
        }
        for force in &now.point_forces {
            let [x, y, z] = force.acceleration.to_array().map(Cell::Float);
            let at = (now.centre + force.place).to_array().map(Cell::Float);
            let (cause, source) = (Cell::Text(schema.terms[force.term].name), by(force.source));
            let head = [step, time, body(schema, index), Cell::Null, cause, source, x, y, z];
            table.row(&[&head[..], &at].concat())?;
        }
    }
    Ok(())
}

fn instant(Instant { step, time }: Instant) -> [Cell<'static>; 2] {
    [Cell::Count(step), Cell::Float(time)]
}

fn body(schema: &Schema, index: usize) -> Cell<'_> {
    Cell::Text(&schema.bodies[index].name)
}
