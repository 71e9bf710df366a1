//! Rows of a sweep's table: the columns, and a binary format for the journal.

use std::hash::{BuildHasher as _, BuildHasherDefault};

use rustc_hash::FxHasher;

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
pub const AXIS: &str = "value at this key of the scene";
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
        "smallest centre distance over the sum of the radii, among pairs that came within reach",
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

/// Appends a record to a journal: length, hash, row. [`take_record`] ignores truncated and damaged records.
pub fn append_record((row, cells): &Row, to: &mut Vec<u8>) {
    let start = to.len();
    to.extend([0; 12]);
    to.extend(row.to_le_bytes());
    let number = |to: &mut Vec<u8>, tag: u8, bits: u64| {
        to.push(tag);
        to.extend(bits.to_le_bytes());
    };
    for cell in cells {
        match cell {
            Cell::Null => to.push(0),
            Cell::Integer(n) => number(to, 1, *n as u64),
            Cell::Count(n) => number(to, 2, *n),
            Cell::Float(x) => number(to, 3, x.to_bits()),
            Cell::Text(text) => {
                number(to, 4, text.len() as u64);
                to.extend(text.as_bytes());
            }
            Cell::List(list) => {
                number(to, 5, list.len() as u64);
                list.iter().for_each(|x| to.extend(x.to_bits().to_le_bytes()));
            }
        }
    }
    let payload = &to[start + 12..];
    let (length, hash) = ((payload.len() as u32).to_le_bytes(), hash(payload).to_le_bytes());
    to[start..start + 4].copy_from_slice(&length);
    to[start + 4..start + 12].copy_from_slice(&hash);
}

/// Removes the first record from `bytes`; `None` at the end, or if the record is truncated or damaged.
pub fn take_record(bytes: &mut &[u8]) -> Option<Row> {
    let length = u32::from_le_bytes(take(bytes)?) as usize;
    let expected = u64::from_le_bytes(take(bytes)?);
    let payload = bytes.split_off(..length)?;
    if hash(payload) != expected {
        return None;
    }
    let mut rest = payload;
    let row = u64::from_le_bytes(take(&mut rest)?);
    let mut cells = Vec::new();
    while !rest.is_empty() {
        let [tag] = take(&mut rest)?;
        if tag == 0 {
            cells.push(Cell::Null);
            continue;
        }
        let bits = u64::from_le_bytes(take(&mut rest)?);
        cells.push(match tag {
            1 => Cell::Integer(bits as i64),
            2 => Cell::Count(bits),
            3 => Cell::Float(f64::from_bits(bits)),
            4 => Cell::Text(String::from_utf8(rest.split_off(..bits as usize)?.to_vec()).ok()?),
            5 => {
                let list = rest.split_off(..(bits as usize).checked_mul(8)?)?;
                let numbers = list
                    .chunks_exact(8)
                    .filter_map(|number| Some(f64::from_bits(u64::from_le_bytes(number.try_into().ok()?))));
                Cell::List(numbers.collect())
            }
            _ => return None,
        });
    }
    Some((row, cells))
}

fn take<const N: usize>(bytes: &mut &[u8]) -> Option<[u8; N]> {
    bytes.split_off(..N)?.try_into().ok()
}

fn hash(bytes: &[u8]) -> u64 {
    BuildHasherDefault::<FxHasher>::default().hash_one(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intact_records_are_read_and_damaged_ones_rejected() {
        let cells = vec![
            Cell::Null,
            Cell::Integer(-5),
            Cell::Count(u64::MAX),
            Cell::Float(0.1),
            Cell::Text("größe".to_owned()),
            Cell::List(vec![1.0, f64::NEG_INFINITY]),
        ];
        let mut bytes = Vec::new();
        append_record(&(7, cells.clone()), &mut bytes);
        let one = bytes.len();
        append_record(&(8, vec![]), &mut bytes);
        let mut rest = &bytes[..];
        assert_eq!(take_record(&mut rest), Some((7, cells)));
        assert_eq!(take_record(&mut rest), Some((8, vec![])));
        assert_eq!(take_record(&mut rest), None);
        for cut in 0..one {
            assert_eq!(take_record(&mut &bytes[..cut]), None);
        }
        for at in 0..one {
            let mut damaged = bytes.clone();
            damaged[at] ^= 4;
            assert_eq!(take_record(&mut &damaged[..]), None, "{at}");
        }
    }
}
