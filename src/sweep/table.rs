//! Rows as Parquet files.
//!
//! A column has its meaning and unit as metadata of its field (`about`), so that a table explains itself wherever it is
//! read. Files are compressed with zstd and depend on nothing but the rows.

use std::{
    collections::HashMap,
    fs::File,
    io::{self, Write},
    path::Path,
    sync::Arc,
};

use parquet::{
    arrow::{ArrowWriter, ProjectionMask, arrow_reader::ParquetRecordBatchReaderBuilder},
    basic::{Compression, ZstdLevel},
    errors::ParquetError,
    file::properties::WriterProperties,
};
use rerun::external::arrow::{
    array::{
        Array, ArrayRef, AsArray as _, Float64Array, Float64Builder, Int64Array, ListBuilder, RecordBatch, StringArray,
        UInt64Array,
    },
    datatypes::{DataType, Field, Float64Type, Int64Type, Schema, UInt64Type},
};

use super::row::{Cell, Column, Kind, Row};

/// Why a table cannot be read.
#[derive(Debug, thiserror::Error)]
#[error("{path} is not a table of this sweep: {why}")]
pub struct TableError {
    path: String,
    why: String,
}

fn data_type(kind: Kind) -> DataType {
    match kind {
        Kind::I64 => DataType::Int64,
        Kind::U64 => DataType::UInt64,
        Kind::F64 => DataType::Float64,
        Kind::Text => DataType::Utf8,
        Kind::List => DataType::List(Arc::new(Field::new("item", DataType::Float64, true))),
    }
}

fn schema(columns: &[Column]) -> Schema {
    let fields = columns.iter().map(|column| {
        let about = HashMap::from([("about".to_owned(), column.about.to_owned())]);
        Field::new(&column.name, data_type(column.kind), column.is_nullable).with_metadata(about)
    });
    Schema::new(fields.collect::<Vec<_>>())
}

/// Writes rows as a table; every row has a cell for each column but the first, which is its number.
pub fn write(columns: &[Column], rows: &[Row], to: impl Write + Send) -> io::Result<()> {
    let schema = Arc::new(schema(columns));
    let failed = |error: ParquetError| match error {
        ParquetError::External(error) => match error.downcast::<io::Error>() {
            Ok(error) => *error,
            Err(error) => io::Error::other(error),
        },
        error => io::Error::other(error),
    };
    let arrays = columns.iter().enumerate().map(|(index, column)| array(column, index, rows)).collect();
    let batch = RecordBatch::try_new(Arc::clone(&schema), arrays).map_err(io::Error::other)?;
    let level = ZstdLevel::try_new(3).map_err(failed)?;
    let properties = WriterProperties::builder()
        .set_compression(Compression::ZSTD(level))
        .set_created_by(concat!("meldscope ", env!("CARGO_PKG_VERSION")).to_owned())
        .build();
    let mut writer = ArrowWriter::try_new(to, schema, Some(properties)).map_err(failed)?;
    writer.write(&batch).map_err(failed)?;
    writer.close().map_err(failed)?;
    Ok(())
}

fn array(column: &Column, index: usize, rows: &[Row]) -> ArrayRef {
    let cells = || rows.iter().map(|(_, cells)| index.checked_sub(1).and_then(|index| cells.get(index)));
    match column.kind {
        Kind::U64 if index == 0 => Arc::new(rows.iter().map(|(row, _)| Some(*row)).collect::<UInt64Array>()),
        Kind::U64 => Arc::new(
            cells().map(|cell| if let Some(Cell::U64(n)) = cell { Some(*n) } else { None }).collect::<UInt64Array>(),
        ),
        Kind::I64 => Arc::new(
            cells().map(|cell| if let Some(Cell::I64(n)) = cell { Some(*n) } else { None }).collect::<Int64Array>(),
        ),
        Kind::F64 => Arc::new(
            cells().map(|cell| if let Some(Cell::F64(x)) = cell { Some(*x) } else { None }).collect::<Float64Array>(),
        ),
        Kind::Text => Arc::new(
            cells()
                .map(|cell| if let Some(Cell::Text(text)) = cell { Some(text.as_str()) } else { None })
                .collect::<StringArray>(),
        ),
        Kind::List => {
            let mut lists = ListBuilder::new(Float64Builder::new());
            for cell in cells() {
                if let Some(Cell::List(list)) = cell {
                    list.iter().for_each(|x| lists.values().append_value(*x));
                }
                lists.append(true);
            }
            Arc::new(lists.finish())
        }
    }
}

/// Reads some columns of a table, by their names; the first is the number of the row.
///
/// # Errors
/// The file cannot be read, or has no such columns.
pub fn read(path: &Path, columns: &[Column], mut each: impl FnMut(Row)) -> Result<(), TableError> {
    let refuse = |why: String| TableError { path: path.display().to_string(), why };
    let file = File::open(path).map_err(|error| refuse(error.to_string()))?;
    let builder = ParquetRecordBatchReaderBuilder::try_new(file).map_err(|error| refuse(error.to_string()))?;
    for column in columns {
        let field = builder.schema().field_with_name(&column.name);
        if !field.is_ok_and(|field| *field.data_type() == data_type(column.kind)) {
            return Err(refuse(format!("it has no column \"{}\" of this type", column.name)));
        }
    }
    // whole names, which may have dots
    let roots: Vec<usize> = columns.iter().filter_map(|column| builder.schema().index_of(&column.name).ok()).collect();
    let mask = ProjectionMask::roots(builder.parquet_schema(), roots);
    let reader = builder.with_projection(mask).build().map_err(|error| refuse(error.to_string()))?;
    for batch in reader {
        let batch = batch.map_err(|error| refuse(error.to_string()))?;
        let arrays: Vec<&ArrayRef> = columns.iter().filter_map(|column| batch.column_by_name(&column.name)).collect();
        for i in 0..batch.num_rows() {
            let mut cells = columns.iter().zip(&arrays).map(|(column, array)| cell(column.kind, array, i));
            let Some(Cell::U64(row)) = cells.next() else {
                return Err(refuse("a row has no number".to_owned()));
            };
            each((row, cells.collect()));
        }
    }
    Ok(())
}

fn cell(kind: Kind, array: &ArrayRef, i: usize) -> Cell {
    if array.is_null(i) {
        return Cell::Null;
    }
    match kind {
        Kind::I64 => Cell::I64(array.as_primitive::<Int64Type>().value(i)),
        Kind::U64 => Cell::U64(array.as_primitive::<UInt64Type>().value(i)),
        Kind::F64 => Cell::F64(array.as_primitive::<Float64Type>().value(i)),
        Kind::Text => Cell::Text(array.as_string::<i32>().value(i).to_owned()),
        Kind::List => {
            let list = array.as_list::<i32>().value(i);
            Cell::List(list.as_primitive::<Float64Type>().values().to_vec())
        }
    }
}
