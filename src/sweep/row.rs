//! Rows of a sweep's table: the columns, and the lines of the journal.

use serde_json::{Value as Json, json};

use super::{Sweep, design::Axis};
use crate::{
    observe::{
        Schema,
        schema::{ScalarOf, ScalarSchema},
    },
    scene::template::Setting,
    table::{Column, Kind, Value},
};

/// Optional measures, which need much more work than a number per step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Measures {
    /// The largest displacement: examines every vertex in every step.
    pub displacement: bool,
    /// Gap, overlap and neck at every event: compares the surfaces in every step.
    pub surfaces: bool,
}

/// A value of a table.
pub type Cell = Value<String, Vec<f64>>;

/// A row: its number, and one cell per further column.
pub type Row = (u64, Vec<Cell>);

/// The name of the run time column, the only one that depends on the machine.
pub const RUN_TIME: &str = "run_time";

/// The number of a row.
pub const ROW: Column = Column::required("row", Kind::Count, "number of the point");
/// What the column of an axis holds.
pub const AXIS: &str = "value at this key of the scene: a number, or a string where the values are words";
/// The results of every sweep.
pub const RESULTS: [Column; 19] = [
    Column::new("outcome", Kind::Text, "apart, bounced, merged, passed or split; null if the run failed"),
    Column::required("events", Kind::Text, "the phase changes in order, the first 64 of them"),
    Column::required("event_times", Kind::List, "exact times of these events [s]"),
    Column::required("merges", Kind::Integer, "number of merges"),
    Column::required("splits", Kind::Integer, "number of splits"),
    Column::required("cores", Kind::Integer, "number of times that a pair entered its core"),
    Column::new("first_merge", Kind::Float, "exact time of the first merge [s]"),
    Column::new("first_split", Kind::Float, "exact time of the first split [s]"),
    Column::required(
        "time_merged",
        Kind::Float,
        "time that pairs were merged or in their core, all pairs together [s]",
    ),
    Column::new(
        "closest",
        Kind::Float,
        "smallest centre distance over the sum of the radii, among pairs that came within reach; of free bodies, within a step, \
         on a cubic through its ends",
    ),
    Column::new("closest_time", Kind::Float, "time of the closest approach [s]"),
    Column::new("energy_by_events", Kind::Float, "energy that phase changes brought to free bodies [mass unit²/s²]"),
    Column::new("momentum_x", Kind::Float, "x component of the momentum of the free bodies at the end [mass unit/s]"),
    Column::new("momentum_y", Kind::Float, "y component of the momentum"),
    Column::new("momentum_z", Kind::Float, "z component of the momentum"),
    Column::required(
        "estimated_error",
        Kind::Float,
        "sum over steps of the largest estimated error of a vertex [radii]",
    ),
    Column::required("steps", Kind::Integer, "steps taken: to the end of the scene, or until the outcome was certain"),
    Column::required("end", Kind::Float, "simulated time at the end [s]"),
    Column::required("checksum", Kind::Count, "hash of the exact state at the end"),
];
/// With the measure `displacement`.
pub const DISPLACEMENT: [Column; 1] = [Column::required(
    "max_displacement",
    Kind::Float,
    "largest displacement of a vertex at the end of a step [radii]",
)];
/// With the measure `surfaces`.
pub const SURFACES: [Column; 3] = [
    Column::required("gaps", Kind::List, "distance of the surfaces at each event, negative where they overlap [radii]"),
    Column::required("overlaps", Kind::List, "volume of the intersection at each event [share of the smaller body]"),
    Column::required("necks", Kind::List, "radius of the seam at each event [radii]"),
];
/// The results of a sweep over an experiment that is not a scene; each [scalar of its state](ScalarOf::State) follows, as
/// `final_SCALAR`.
pub const OWN: [Column; 7] = [
    Column::new("outcome", Kind::Text, "the kinds of events of pairs in order, the first 64 of them, or none"),
    Column::required("events", Kind::Text, "the events of pairs in order, the first 64 of them"),
    Column::required("event_times", Kind::List, "exact times of these events [s]"),
    Column::required("event_count", Kind::Integer, "number of events of pairs"),
    Column::required("steps", Kind::Integer, "steps taken"),
    Column::required("end", Kind::Float, "simulated time at the end [s]"),
    Column::required("checksum", Kind::Count, "hash of the exact state at the end"),
];
/// The last columns of every sweep.
pub const LAST: [Column; 2] = [
    Column::new("failure", Kind::Text, "why the run failed"),
    Column::required(RUN_TIME, Kind::Float, "wall time of the run [s]: the only column that differs between machines"),
];

/// The column of an axis.
pub fn axis_column(axis: &Axis, about: &'static str) -> Column {
    let kind = if axis.is_number() { Kind::Float } else { Kind::Text };
    Column { name: axis.key.to_string().into(), ..Column::required("", kind, about) }
}

/// The columns of a sweep: the row number, the axes, then the results.
pub fn columns(sweep: &Sweep) -> Vec<Column> {
    let mut columns = vec![ROW];
    columns.extend(sweep.design.axes.iter().map(|axis| axis_column(axis, AXIS)));
    if let Some(experiment) = &sweep.experiment {
        columns.extend(OWN);
        columns.extend(final_scalars(&experiment.schema()).map(|(_, scalar)| Column {
            name: format!("final_{}", scalar.name).into(),
            ..Column::new("", Kind::Float, scalar.label)
        }));
        columns.extend(LAST);
        return columns;
    }
    columns.extend(RESULTS);
    if sweep.measures.displacement {
        columns.extend(DISPLACEMENT);
    }
    if sweep.measures.surfaces {
        columns.extend(SURFACES);
    }
    columns.extend(LAST);
    columns
}

/// The cells of a run without results, from the first result to the reason: empty, or 0 where a value is required.
pub(super) fn without_results(sweep: &Sweep, why: String) -> Vec<Cell> {
    let columns = columns(sweep);
    let results = &columns[1 + sweep.design.axes.len()..columns.len() - LAST.len()];
    let empty = |column: &Column| match column.kind {
        _ if column.is_nullable => Cell::Null,
        Kind::Float => Cell::Float(0.0),
        Kind::Count => Cell::Count(0),
        Kind::Integer => Cell::Integer(0),
        Kind::Text => Cell::Text(String::new()),
        Kind::List => Cell::List(vec![]),
    };
    results.iter().map(empty).chain([Cell::Text(why)]).collect()
}

/// The scalars that are in a row of a sweep, with their indices.
pub(super) fn final_scalars(schema: &Schema) -> impl Iterator<Item = (usize, &ScalarSchema)> {
    schema.scalars.iter().enumerate().filter(|(_, scalar)| scalar.of == ScalarOf::State)
}

impl From<&Setting> for Cell {
    fn from(setting: &Setting) -> Cell {
        match setting {
            Setting::Number(number) => Cell::Float(*number),
            Setting::Text(text) => Cell::Text(text.clone()),
        }
    }
}

/// A row as a line of a journal, a JSON array: doubles as their bits.
pub fn line_of((row, cells): &Row) -> String {
    let bits = |x: &f64| Json::from(x.to_bits());
    let cell = |cell: &Cell| match cell {
        Cell::Null => Json::Null,
        Cell::Integer(n) => Json::from(*n),
        Cell::Count(n) => Json::from(*n),
        Cell::Float(x) => bits(x),
        Cell::Text(text) => Json::from(text.as_str()),
        Cell::List(list) => list.iter().map(bits).collect(),
    };
    format!("{}\n", json!([row, cells.iter().map(cell).collect::<Json>()]))
}

/// Reads a line of a journal of a table with these columns; `None` if the line is cut short or damaged.
pub fn from_line(line: &str, columns: &[Column]) -> Option<Row> {
    let (row, cells): (u64, Vec<Json>) = serde_json::from_str(line).ok()?;
    let bits = |bits: &Json| bits.as_u64().map(f64::from_bits);
    let cell = |(column, cell): (&Column, &Json)| {
        Some(match column.kind {
            _ if cell.is_null() => Cell::Null,
            Kind::Integer => Cell::Integer(cell.as_i64()?),
            Kind::Count => Cell::Count(cell.as_u64()?),
            Kind::Float => Cell::Float(bits(cell)?),
            Kind::Text => Cell::Text(cell.as_str()?.to_owned()),
            Kind::List => Cell::List(cell.as_array()?.iter().map(bits).collect::<Option<_>>()?),
        })
    };
    let of_cells = columns.get(1..).filter(|columns| columns.len() == cells.len())?;
    Some((row, of_cells.iter().zip(&cells).map(cell).collect::<Option<_>>()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intact_lines_are_read_and_others_rejected() {
        let kinds = [Kind::Count, Kind::Text, Kind::Integer, Kind::Count, Kind::Float, Kind::Text, Kind::List];
        let columns = kinds.map(|kind| Column::new("", kind, ""));
        let cells = vec![
            Cell::Null,
            Cell::Integer(-5),
            Cell::Count(u64::MAX),
            Cell::Float(0.1),
            Cell::Text("größe\n".to_owned()),
            Cell::List(vec![1.0, f64::NEG_INFINITY]),
        ];
        let line = line_of(&(7, cells.clone()));
        assert_eq!(from_line(&line, &columns), Some((7, cells)));
        assert_eq!(from_line(&line, &columns[1..]), None);
        let ends = line.trim_end().char_indices().map(|(end, _)| end);
        ends.for_each(|end| assert_eq!(from_line(&line[..end], &columns), None, "{end}"));
    }
}
