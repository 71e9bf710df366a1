//! Rows as Parquet files, written and read back.

use std::{
    fs::File,
    io::{self, Write},
    path::Path,
};

use parquet::arrow::{ProjectionMask, arrow_reader::ParquetRecordBatchReaderBuilder};

use super::row::{Cell, Row};
use crate::sdk::arrow::{
    array::{Array, ArrayRef, AsArray as _},
    datatypes::{Float64Type, Int64Type, UInt64Type},
};
use crate::{
    recording::read::catching,
    table::{Column, Kind, ParquetTable},
};

/// Why a table cannot be read.
#[derive(Debug, thiserror::Error)]
#[error("{path} is not a table of this sweep: {why}; delete it and repeat the command, which runs its rows again")]
pub struct TableError {
    path: String,
    why: String,
}

/// Writes rows as a table. A row has one cell per column except the first, which is its number.
///
/// # Errors
/// The table cannot be written.
pub fn write(columns: &[Column], rows: &[Row], to: impl Write + Send) -> io::Result<()> {
    let mut table = ParquetTable::new(columns, to)?;
    for (row, cells) in rows {
        table.row(std::iter::once(&Cell::Count(*row)).chain(cells))?;
    }
    table.finish().map(drop)
}

/// Reads some columns of a table by name; the first is the row number.
///
/// # Errors
/// The file cannot be read, or lacks one of the columns.
pub fn read(path: &Path, columns: &[Column], mut each: impl FnMut(Row)) -> Result<(), TableError> {
    let error_of = |why: String| TableError { path: path.display().to_string(), why };
    // the decoder may panic on a damaged file
    let rows = catching(|| rows(path, columns)).map_err(error_of)?;
    rows.into_iter().for_each(&mut each);
    Ok(())
}

fn rows(path: &Path, columns: &[Column]) -> Result<Vec<Row>, String> {
    let file = File::open(path).map_err(|error| error.to_string())?;
    let builder = ParquetRecordBatchReaderBuilder::try_new(file).map_err(|error| error.to_string())?;
    for column in columns {
        let field = builder.schema().field_with_name(&column.name);
        if !field.is_ok_and(|field| *field.data_type() == column.kind.data_type()) {
            return Err(format!("it has no column \"{}\" of this type", column.name));
        }
    }
    // match whole names, because they may contain dots
    let roots: Vec<usize> = columns.iter().filter_map(|column| builder.schema().index_of(&column.name).ok()).collect();
    let mask = ProjectionMask::roots(builder.parquet_schema(), roots);
    let reader = builder.with_projection(mask).build().map_err(|error| error.to_string())?;
    let mut rows = Vec::new();
    for batch in reader {
        let batch = batch.map_err(|error| error.to_string())?;
        let arrays: Vec<&ArrayRef> = columns.iter().filter_map(|column| batch.column_by_name(&column.name)).collect();
        for i in 0..batch.num_rows() {
            let mut cells = columns.iter().zip(&arrays).map(|(column, array)| cell(column.kind, array, i));
            let Some(Cell::Count(row)) = cells.next() else {
                return Err("a row has no number".to_owned());
            };
            rows.push((row, cells.collect()));
        }
    }
    Ok(rows)
}

fn cell(kind: Kind, array: &ArrayRef, i: usize) -> Cell {
    if array.is_null(i) {
        return Cell::Null;
    }
    match kind {
        Kind::Integer => Cell::Integer(array.as_primitive::<Int64Type>().value(i)),
        Kind::Count => Cell::Count(array.as_primitive::<UInt64Type>().value(i)),
        Kind::Float => Cell::Float(array.as_primitive::<Float64Type>().value(i)),
        Kind::Text => Cell::Text(array.as_string::<i32>().value(i).to_owned()),
        Kind::List => {
            let list = array.as_list::<i32>().value(i);
            Cell::List(list.as_primitive::<Float64Type>().values().to_vec())
        }
    }
}
