//! Tables in files that dataframe libraries read: CSV, JSON or Parquet, by file extension. Files are written
//! atomically, and replace only tables with the same columns.
//!
//! Numbers keep every bit: text formats use the shortest digits that read back as the same number. JSON has no NaN and
//! no infinity; they become `null`.

use std::{
    borrow::Cow,
    collections::HashMap,
    fs::File,
    io::{self, BufWriter, Read as _, Seek as _, SeekFrom, Write},
    path::{Path, PathBuf},
    sync::Arc,
};

use parquet::{arrow::ArrowWriter, basic::Compression, errors::ParquetError, file::properties::WriterProperties};

use crate::{
    atomic::{self, AtomicFile},
    sdk::arrow::{
        array::{ArrayRef, Float64Builder, Int64Builder, ListBuilder, RecordBatch, StringBuilder, UInt64Builder},
        datatypes::{DataType, Field, Schema},
        error::ArrowError,
    },
};

/// The `created_by` of a Parquet file.
const CREATED_BY: &str = concat!("meldscope ", env!("CARGO_PKG_VERSION"));
/// Magic number at both ends of a Parquet file.
const PARQUET: &[u8] = b"PAR1";
/// Number of bytes read at each end of a file to be replaced.
const LONGEST_HEADER: u64 = 1 << 16;
/// Number of rows encoded together.
const BATCH: usize = 8192;
/// Approximate size of a row group of a Parquet file [bytes], which is kept in memory until complete.
const GROUP: usize = 16 << 20;

/// The type of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// f64.
    Float,
    /// u64.
    Count,
    /// i64.
    Integer,
    /// UTF-8.
    Text,
    /// Any number of f64.
    List,
}

impl Kind {
    /// The type in Arrow's schema.
    pub fn data_type(self) -> DataType {
        match self {
            Kind::Float => DataType::Float64,
            Kind::Count => DataType::UInt64,
            Kind::Integer => DataType::Int64,
            Kind::Text => DataType::Utf8,
            Kind::List => DataType::List(Arc::new(Field::new("item", DataType::Float64, true))),
        }
    }
}

/// A column of a table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Column {
    /// Its name.
    pub name: Cow<'static, str>,
    /// Its type.
    pub kind: Kind,
    /// Description with unit: stored as `about` in the metadata of a Parquet field, so that tables are
    /// self-explanatory. Not stored if empty.
    pub about: Cow<'static, str>,
    /// Whether values can be missing.
    pub is_nullable: bool,
}

impl Column {
    /// A column whose values can be missing.
    pub const fn new(name: &'static str, kind: Kind, about: &'static str) -> Column {
        Column { name: Cow::Borrowed(name), kind, about: Cow::Borrowed(about), is_nullable: true }
    }

    /// A column with a value in every row.
    pub const fn required(name: &'static str, kind: Kind, about: &'static str) -> Column {
        Column { name: Cow::Borrowed(name), kind, about: Cow::Borrowed(about), is_nullable: false }
    }

    fn field(&self) -> Field {
        let field = Field::new(&*self.name, self.kind.data_type(), self.is_nullable);
        if self.about.is_empty() {
            return field;
        }
        field.with_metadata(HashMap::from([("about".to_owned(), self.about.to_string())]))
    }
}

/// A value of a row that borrows.
pub type Cell<'a> = Value<&'a str, &'a [f64]>;

/// A value of a row; a value of another type than its column's counts as missing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Value<T, L> {
    /// For [`Kind::Float`].
    Float(f64),
    /// For [`Kind::Count`].
    Count(u64),
    /// For [`Kind::Integer`].
    Integer(i64),
    /// For [`Kind::Text`].
    Text(T),
    /// For [`Kind::List`].
    List(L),
    /// Missing.
    Null,
}

/// Why a table could not be written. The text is a complete message.
#[derive(Debug, thiserror::Error)]
pub enum TableError {
    /// The request is invalid; nothing has been written.
    #[error("{0}")]
    Refused(String),
    /// Writing failed.
    #[error("{0}")]
    Failed(String),
}

/// The format of a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Csv,
    Json,
    Parquet,
}

impl Format {
    const ALL: [(&str, Format); 3] = [("csv", Format::Csv), ("json", Format::Json), ("parquet", Format::Parquet)];

    fn of(path: &Path) -> Option<Format> {
        let extension = path.extension()?;
        let format = Format::ALL.into_iter().find(|(name, _)| extension.eq_ignore_ascii_case(name));
        format.map(|(_, format)| format)
    }
}

/// A table being written.
pub struct Table {
    path: PathBuf,
    file: AtomicFile,
    columns: Vec<Column>,
    writer: Writer,
}

enum Writer {
    Csv(Box<csv::Writer<BufWriter<File>>>),
    Json { file: BufWriter<File>, rows: u64 },
    Parquet(Box<ParquetTable<BufWriter<File>>>),
}

impl Table {
    /// Begins a table with these columns.
    ///
    /// # Errors
    /// The extension is unknown, an existing file is not such a table, or the file cannot be created.
    pub fn create(path: &Path, columns: Vec<Column>) -> Result<Table, TableError> {
        let Some(format) = Format::of(path) else {
            let path = path.display();
            return Err(TableError::Refused(format!(
                "{path}: the extension selects the table's format: use .csv, .json or .parquet"
            )));
        };
        may_replace(path, &columns)?;
        let failed = |error: io::Error| write_failed(path, &error);
        let file = AtomicFile::create(path).map_err(failed)?;
        let to = BufWriter::new(file.handle().map_err(failed)?);
        let writer = Writer::new(format, &columns, to).map_err(failed)?;
        Ok(Table { path: path.to_owned(), file, columns, writer })
    }

    /// Adds a row, with one cell per column.
    ///
    /// # Errors
    /// The row cannot be written.
    pub fn row(&mut self, cells: &[Cell<'_>]) -> Result<(), TableError> {
        self.writer.row(&self.columns, cells).map_err(|error| write_failed(&self.path, &error))
    }

    /// Puts the file in place; returns its size [bytes].
    ///
    /// # Errors
    /// The file cannot be written or renamed.
    pub fn finish(self) -> Result<u64, TableError> {
        let Table { path, file, writer, .. } = self;
        writer.finish().and_then(|()| file.commit()).map_err(|error| write_failed(&path, &error))
    }
}

fn write_failed(path: &Path, error: &io::Error) -> TableError {
    TableError::Failed(format!("cannot write {}: {error}; {}", path.display(), atomic::remedy(path, error)))
}

/// Checks that a table with these columns may be put at `path`.
///
/// # Errors
/// There is something else.
pub fn may_replace(path: &Path, columns: &[Column]) -> Result<(), TableError> {
    let is_table = |format| is_table(path, format, columns).unwrap_or(false);
    if path.symlink_metadata().is_ok() && !Format::of(path).is_some_and(is_table) {
        let path = path.display();
        return Err(TableError::Refused(format!(
            "{path} is not a table with these columns and is not replaced: choose another name"
        )));
    }
    Ok(())
}

impl Writer {
    fn new(format: Format, columns: &[Column], mut file: BufWriter<File>) -> io::Result<Writer> {
        Ok(match format {
            Format::Csv => {
                let mut writer = csv::Writer::from_writer(file);
                writer.write_record(columns.iter().map(|column| &*column.name))?;
                Writer::Csv(Box::new(writer))
            }
            Format::Json => {
                file.write_all(b"[")?;
                Writer::Json { file, rows: 0 }
            }
            Format::Parquet => Writer::Parquet(Box::new(ParquetTable::new(columns, file)?)),
        })
    }

    fn row(&mut self, columns: &[Column], cells: &[Cell<'_>]) -> io::Result<()> {
        match self {
            Writer::Csv(writer) => Ok(writer.write_record(cells.iter().map(|cell| match cell {
                Cell::Null => String::new(),
                cell => plain(*cell),
            }))?),
            Writer::Json { file, rows } => {
                let mut before = if *rows == 0 { "\n{" } else { ",\n{" };
                for (column, cell) in columns.iter().zip(cells) {
                    let text = match *cell {
                        Cell::Text(text) => quoted(text)?,
                        Cell::Float(number) if !number.is_finite() => "null".to_owned(),
                        cell => plain(cell),
                    };
                    write!(file, "{before}{}:{text}", quoted(&column.name)?)?;
                    before = ",";
                }
                *rows += 1;
                file.write_all(b"}")
            }
            Writer::Parquet(table) => table.row(cells),
        }
    }

    fn finish(self) -> io::Result<()> {
        match self {
            Writer::Csv(mut writer) => writer.flush(),
            Writer::Json { mut file, .. } => {
                file.write_all(b"\n]\n")?;
                file.flush()
            }
            Writer::Parquet(table) => table.finish()?.flush(),
        }
    }
}

/// The shortest text that reads back as the same value.
fn plain(cell: Cell<'_>) -> String {
    match cell {
        Cell::Float(number) => format!("{number:?}"),
        Cell::Count(number) => number.to_string(),
        Cell::Integer(number) => number.to_string(),
        Cell::Text(text) => text.to_owned(),
        Cell::List(numbers) => serde_json::Value::from(numbers).to_string(),
        Cell::Null => "null".to_owned(),
    }
}

fn quoted(text: &str) -> io::Result<String> {
    Ok(serde_json::to_string(text)?)
}

/// Encodes rows to a Parquet file.
pub struct ParquetTable<W: Write + Send> {
    writer: ArrowWriter<W>,
    schema: Arc<Schema>,
    builders: Vec<Builder>,
    rows: usize,
}

enum Builder {
    Float(Float64Builder),
    Count(UInt64Builder),
    Integer(Int64Builder),
    Text(StringBuilder),
    List(ListBuilder<Float64Builder>),
}

/// The I/O error behind a Parquet error.
fn failed(error: ParquetError) -> io::Error {
    match error {
        ParquetError::External(error) => match error.downcast::<io::Error>() {
            Ok(error) => *error,
            Err(error) => io::Error::other(error),
        },
        error => io::Error::other(error),
    }
}

impl<W: Write + Send> ParquetTable<W> {
    /// Begins a table with these columns.
    ///
    /// # Errors
    /// The table cannot be written.
    pub fn new(columns: &[Column], to: W) -> io::Result<ParquetTable<W>> {
        let schema = Arc::new(Schema::new(columns.iter().map(Column::field).collect::<Vec<_>>()));
        let properties = WriterProperties::builder()
            .set_created_by(CREATED_BY.to_owned())
            .set_compression(Compression::LZ4_RAW)
            .build();
        let builder = |column: &Column| match column.kind {
            Kind::Float => Builder::Float(Float64Builder::new()),
            Kind::Count => Builder::Count(UInt64Builder::new()),
            Kind::Integer => Builder::Integer(Int64Builder::new()),
            Kind::Text => Builder::Text(StringBuilder::new()),
            Kind::List => Builder::List(ListBuilder::new(Float64Builder::new())),
        };
        let builders = columns.iter().map(builder).collect();
        let writer = ArrowWriter::try_new(to, Arc::clone(&schema), Some(properties)).map_err(failed)?;
        Ok(ParquetTable { writer, schema, builders, rows: 0 })
    }

    /// Adds a row, with one cell per column.
    ///
    /// # Errors
    /// The row cannot be written.
    pub fn row<'a, T, L>(&mut self, cells: impl IntoIterator<Item = &'a Value<T, L>>) -> io::Result<()>
    where
        T: AsRef<str> + 'a,
        L: AsRef<[f64]> + 'a,
    {
        for (builder, cell) in self.builders.iter_mut().zip(cells) {
            match (builder, cell) {
                (Builder::Float(builder), Value::Float(number)) => builder.append_value(*number),
                (Builder::Float(builder), _) => builder.append_null(),
                (Builder::Count(builder), Value::Count(number)) => builder.append_value(*number),
                (Builder::Count(builder), _) => builder.append_null(),
                (Builder::Integer(builder), Value::Integer(number)) => builder.append_value(*number),
                (Builder::Integer(builder), _) => builder.append_null(),
                (Builder::Text(builder), Value::Text(text)) => builder.append_value(text),
                (Builder::Text(builder), _) => builder.append_null(),
                (Builder::List(builder), Value::List(numbers)) => {
                    builder.values().append_slice(numbers.as_ref());
                    builder.append(true);
                }
                (Builder::List(builder), _) => builder.append_null(),
            }
        }
        self.rows += 1;
        if self.rows == BATCH { self.encode() } else { Ok(()) }
    }

    fn encode(&mut self) -> io::Result<()> {
        self.rows = 0;
        let column = |builder: &mut Builder| -> ArrayRef {
            match builder {
                Builder::Float(builder) => Arc::new(builder.finish()),
                Builder::Count(builder) => Arc::new(builder.finish()),
                Builder::Integer(builder) => Arc::new(builder.finish()),
                Builder::Text(builder) => Arc::new(builder.finish()),
                Builder::List(builder) => Arc::new(builder.finish()),
            }
        };
        let columns = self.builders.iter_mut().map(column).collect();
        let batch = RecordBatch::try_new(Arc::clone(&self.schema), columns);
        self.writer.write(&batch.map_err(|error: ArrowError| io::Error::other(error))?).map_err(failed)?;
        if self.writer.in_progress_size() >= GROUP {
            self.writer.flush().map_err(failed)?;
        }
        Ok(())
    }

    /// Ends the table; returns the underlying writer.
    ///
    /// # Errors
    /// The table cannot be written.
    pub fn finish(mut self) -> io::Result<W> {
        self.encode()?;
        self.writer.into_inner().map_err(failed)
    }
}

/// Whether a file is empty or a table with these columns.
fn is_table(path: &Path, format: Format, columns: &[Column]) -> io::Result<bool> {
    if !path.symlink_metadata()?.is_file() {
        return Ok(false);
    }
    let mut file = File::open(path)?;
    let mut head = Vec::new();
    (&mut file).take(LONGEST_HEADER).read_to_end(&mut head)?;
    if head.is_empty() {
        return Ok(true);
    }
    let contains = |text: &[u8], name: &[u8]| text.windows(name.len()).any(|part| part == name);
    Ok(match format {
        Format::Csv => {
            let mut header = csv::Writer::from_writer(Vec::new());
            header.write_record(columns.iter().map(|column| &*column.name))?;
            let header = header.into_inner().map_err(|error| io::Error::other(error.to_string()))?;
            let line = head.split(|&byte| byte == b'\n').next().unwrap_or_default();
            line.trim_ascii_end() == header.trim_ascii_end()
        }
        Format::Json => {
            let text = String::from_utf8_lossy(&head);
            let row = text.strip_prefix('[').unwrap_or_default().trim_start();
            let first = serde_json::Deserializer::from_str(row).into_iter::<serde_json::Map<_, _>>().next();
            let count = first
                .and_then(Result::ok)
                .map_or(columns.len(), |first: serde_json::Map<_, serde_json::Value>| first.len());
            let mut rest = row.strip_prefix('{').unwrap_or_default();
            let mut has = |column: &Column| {
                let key = quoted(&column.name).unwrap_or_default() + ":";
                let after = rest.find(&key).map(|index| &rest[index + key.len()..]);
                rest = after.unwrap_or_default();
                after.is_some()
            };
            matches!(text.trim(), "[" | "[]" | "[\n]") || count == columns.len() && columns.iter().all(&mut has)
        }
        Format::Parquet => {
            let from = file.metadata()?.len().saturating_sub(LONGEST_HEADER);
            let mut tail = Vec::new();
            file.seek(SeekFrom::Start(from))?;
            file.take(LONGEST_HEADER).read_to_end(&mut tail)?;
            let names = columns.iter().map(|column| column.name.as_bytes());
            head.starts_with(PARQUET)
                && tail.ends_with(PARQUET)
                && names.chain([&b"meldscope "[..]]).all(|name| contains(&tail, name))
        }
    })
}

#[cfg(test)]
mod tests {
    use std::fs;

    use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;

    use super::*;
    use crate::sdk::arrow::array::{Array as _, AsArray as _, Float64Array, Int64Array, UInt64Array};

    fn columns() -> Vec<Column> {
        [("count", Kind::Count), ("number", Kind::Float), ("integer", Kind::Integer), ("text", Kind::Text)]
            .map(|(name, kind)| Column::new(name, kind, ""))
            .into()
    }

    fn rows() -> Vec<[Cell<'static>; 4]> {
        let numbers = [0.1, -0.0, 1e-310, f64::MAX, 1.0 / 3.0, f64::NAN];
        let mut rows: Vec<_> = (0..20_000_u64)
            .map(|i| {
                let number = numbers[i as usize % 6] * (1.0 + i as f64 * f64::EPSILON);
                [Cell::Count(u64::MAX - i), Cell::Float(number), Cell::Integer(-(i as i64)), Cell::Text("a \"b\", c")]
            })
            .collect();
        rows.push([Cell::Null; 4]);
        rows
    }

    fn written(name: &str) -> PathBuf {
        let path = std::env::temp_dir().join(format!("meldscope-table-{}-{name}", std::process::id()));
        let mut table = Table::create(&path, columns()).unwrap();
        rows().iter().for_each(|row| table.row(row).unwrap());
        assert_eq!(table.finish().unwrap(), path.metadata().unwrap().len());
        path
    }

    #[test]
    fn parquet_keeps_every_bit() {
        let path = written("bits.parquet");
        let reader = ParquetRecordBatchReaderBuilder::try_new(File::open(&path).unwrap()).unwrap();
        let mut expected = rows().into_iter();
        for batch in reader.build().unwrap() {
            let batch = batch.unwrap();
            let of = |i: usize| batch.column(i).as_any();
            let (counts, numbers) =
                (of(0).downcast_ref::<UInt64Array>().unwrap(), of(1).downcast_ref::<Float64Array>().unwrap());
            let (integers, texts) = (of(2).downcast_ref::<Int64Array>().unwrap(), batch.column(3).as_string::<i32>());
            for i in 0..batch.num_rows() {
                match expected.next().unwrap() {
                    [Cell::Count(count), Cell::Float(number), Cell::Integer(integer), Cell::Text(text)] => {
                        assert_eq!(
                            (counts.value(i), numbers.value(i).to_bits(), integers.value(i), texts.value(i)),
                            (count, number.to_bits(), integer, text)
                        );
                    }
                    _ => assert!(counts.is_null(i) && numbers.is_null(i) && integers.is_null(i) && texts.is_null(i)),
                }
            }
        }
        assert!(expected.next().is_none());
        written("bits.parquet"); // its own table is replaced
        fs::remove_file(path).unwrap();
    }

    #[test]
    fn texts_read_back_as_the_same_numbers() {
        let (csv, json) = (written("texts.csv"), written("texts.json"));
        let values: Vec<serde_json::Value> = serde_json::from_slice(&fs::read(&json).unwrap()).unwrap();
        let mut reader = csv::Reader::from_path(&csv).unwrap();
        for ((row, value), record) in rows().iter().zip(&values).zip(reader.records()) {
            let record = record.unwrap();
            let [Cell::Count(count), Cell::Float(number), Cell::Integer(integer), Cell::Text(text)] = *row else {
                assert!(record.iter().all(str::is_empty) && value["number"].is_null());
                continue;
            };
            assert_eq!(record[0].parse(), Ok(count));
            assert_eq!(record[1].parse::<f64>().unwrap().to_bits(), number.to_bits());
            assert_eq!((record[2].parse(), &record[3]), (Ok(integer), text));
            assert_eq!((value["count"].as_u64(), value["text"].as_str()), (Some(count), Some(text)));
            assert_eq!(value["number"].is_null(), !number.is_finite());
        }
        assert_eq!(values.len(), rows().len());
        for path in [csv, json] {
            Table::create(&path, columns()).unwrap(); // dropped unfinished: the table stays
            let others = Table::create(&path, vec![Column::new("else", Kind::Float, "")]);
            assert!(matches!(others, Err(TableError::Refused(_))));
            fs::remove_file(path).unwrap();
        }
    }

    #[test]
    fn foreign_files_are_not_replaced() {
        for (name, content) in [("mine.csv", "a,b\n"), ("mine.json", "[{\"a\":1}]"), ("mine.parquet", "PAR1....PAR1")] {
            let path = std::env::temp_dir().join(format!("meldscope-{}-{name}", std::process::id()));
            fs::write(&path, content).unwrap();
            assert!(matches!(Table::create(&path, columns()), Err(TableError::Refused(_))), "{name}");
            assert_eq!(fs::read_to_string(&path).unwrap(), content);
            fs::remove_file(path).unwrap();
        }
        assert!(matches!(Table::create(Path::new("t.xlsx"), columns()), Err(TableError::Refused(_))));
    }
}
