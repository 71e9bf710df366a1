//! The tables of a run and their columns.

use std::path::Path;

use crate::{
    cli::Failure,
    geometry::Vectors,
    observe::{EventRow, Frame, Instant, Schema, StepSummary, schema::ScalarOf},
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

fn columns(columns: &[(&str, Kind)]) -> Vec<Column> {
    columns.iter().map(|(name, kind)| Column::new(name, *kind)).collect()
}

/// A table of events.
pub struct Events(pub Table);

impl Events {
    /// `step`, `time` [s], `event`, the bodies `a` and `b`, `q` and its `rate` [1/s], the phases `from` and `to`, and a
    /// remark on the `surfaces` at a phase change. Empty cells do not apply: surfaces that touch and part change no
    /// phase, and an event of a single body has no `b`.
    pub fn create(path: &Path) -> Result<Events, Failure> {
        use Kind::{Count, Float, Text};
        let columns = columns(&[
            ("step", Count),
            ("time", Float),
            ("event", Text),
            ("a", Text),
            ("b", Text),
            ("q", Float),
            ("rate", Float),
            ("from", Text),
            ("to", Text),
            ("surfaces", Text),
        ]);
        Ok(Events(Table::create(path, columns)?))
    }

    /// Adds an event.
    pub fn add(&mut self, schema: &Schema, row: &EventRow<'_>) -> Result<(), Failure> {
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
        Ok(self.0.row(&cells)?)
    }
}

/// A table of pairs within reach.
pub struct Pairs(pub Table);

impl Pairs {
    /// `step`, `time` [s], the bodies `a` and `b`, `q`, and the `phase`.
    pub fn create(path: &Path) -> Result<Pairs, Failure> {
        use Kind::{Count, Float, Text};
        let columns =
            columns(&[("step", Count), ("time", Float), ("a", Text), ("b", Text), ("q", Float), ("phase", Text)]);
        Ok(Pairs(Table::create(path, columns)?))
    }

    /// Adds the pairs of a frame.
    pub fn add(&mut self, schema: &Schema, frame: &Frame) -> Result<(), Failure> {
        let [step, time] = instant(frame.at);
        frame.pairs.iter().try_for_each(|pair| {
            let phase = Cell::Text(schema.phases[pair.phase].name);
            Ok(self.0.row(&[step, time, body(schema, pair.a), body(schema, pair.b), Cell::Float(pair.q), phase])?)
        })
    }
}

/// A table of scalars.
pub struct Scalars(pub Table);

impl Scalars {
    /// `step`, `time` [s], and a column for each scalar of the schema.
    pub fn create(path: &Path, schema: &Schema) -> Result<Scalars, Failure> {
        let scalars = schema.scalars.iter().map(|scalar| (scalar.name, Kind::Float));
        let all: Vec<_> = [("step", Kind::Count), ("time", Kind::Float)].into_iter().chain(scalars).collect();
        Ok(Scalars(Table::create(path, columns(&all))?))
    }

    /// Adds the scalars of a frame and of the step that led to it.
    pub fn add(&mut self, schema: &Schema, frame: &Frame, summary: &StepSummary) -> Result<(), Failure> {
        let scalars = schema.scalars.iter().enumerate().map(|(index, scalar)| {
            let values = if scalar.of == ScalarOf::State { &frame.scalars } else { &summary.scalars };
            values.get(index).map_or(Cell::Null, |&value| Cell::Float(value))
        });
        Ok(self.0.row(&instant(frame.at).into_iter().chain(scalars).collect::<Vec<_>>())?)
    }
}

/// A table of exact states, with one row per vertex.
pub struct States {
    /// The file.
    pub table: Table,
    /// Positions relative to the centre; scratch storage.
    local: Vectors,
}

impl States {
    /// `step`, `time` [s], the `body`, the index of the `vertex`, its position in the world `x`, `y`, `z`
    /// [scene unit], its displacement from rest `dx`, `dy`, `dz` [scene unit], and the velocity of that displacement
    /// `vx`, `vy`, `vz` [scene unit/s]. The last six are the integrated state.
    pub fn create(path: &Path) -> Result<States, Failure> {
        let head = [("step", Kind::Count), ("time", Kind::Float), ("body", Kind::Text), ("vertex", Kind::Count)];
        let numbers = ["x", "y", "z", "dx", "dy", "dz", "vx", "vy", "vz"].map(|name| (name, Kind::Float));
        let columns = columns(&[&head[..], &numbers].concat());
        Ok(States { table: Table::create(path, columns)?, local: Vectors::default() })
    }

    /// Adds the vertices of a frame.
    pub fn add(&mut self, schema: &Schema, frame: &Frame) -> Result<(), Failure> {
        let [step, time] = instant(frame.at);
        for (index, (of, now)) in schema.bodies.iter().zip(&frame.bodies).enumerate() {
            now.local_positions(now.rest_of(of), &mut self.local);
            for i in 0..self.local.len() {
                let position = now.centre + self.local.get(i);
                let velocity = if now.is_at_rest { glam::DVec3::ZERO } else { now.velocities.get(i) };
                let [x, y, z] = position.to_array().map(Cell::Float);
                let [dx, dy, dz] = now.displacement(i).to_array().map(Cell::Float);
                let [vx, vy, vz] = velocity.to_array().map(Cell::Float);
                let vertex = Cell::Count(i as u64);
                self.table.row(&[step, time, body(schema, index), vertex, x, y, z, dx, dy, dz, vx, vy, vz])?;
            }
        }
        Ok(())
    }
}

fn instant(Instant { step, time }: Instant) -> [Cell<'static>; 2] {
    [Cell::Count(step), Cell::Float(time)]
}

fn body(schema: &Schema, index: usize) -> Cell<'_> {
    Cell::Text(&schema.bodies[index].name)
}
