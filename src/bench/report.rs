//! Results of a benchmark: what the terminal, a CSV file and a diagram show.

use std::{fmt, iter};

use super::chart::Chart;
use crate::{
    stream::machine,
    table::{self, Kind},
    text::{aligned, thousands},
};

/// The results of a benchmark.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// The tables that are printed.
    pub tables: Vec<Table>,
    /// What the tables show.
    pub notes: String,
    /// The measurements for a file; `None`: those of all tables.
    pub file: Option<Table>,
    /// The diagram, if there is one.
    pub chart: Option<Chart>,
    /// What must not be: the benchmark has failed.
    pub failure: Option<String>,
}

/// A table.
#[derive(Clone, Debug, Default)]
pub struct Table {
    /// What it is about.
    pub title: String,
    /// Its columns, of which those without a heading are not printed.
    pub columns: Vec<Column>,
    /// Its rows, with a cell per column, or none: a blank line.
    pub rows: Vec<Vec<Cell>>,
    /// Lines of text below it.
    pub conclusions: Vec<String>,
}

/// A column of a table.
#[derive(Clone, Debug)]
pub struct Column {
    /// Its heading on the terminal, with the unit; empty in files only.
    heading: String,
    /// Its name in files, with the unit; empty on the terminal only.
    name: &'static str,
    kind: Kind,
    show: fn(f64) -> String,
}

impl Column {
    /// Words.
    pub fn text(heading: &str, name: &'static str) -> Column {
        Column { heading: heading.to_owned(), name, kind: Kind::Text, show: |x| x.to_string() }
    }

    /// Whole numbers.
    pub fn count(heading: &str, name: &'static str) -> Column {
        Column { heading: heading.to_owned(), name, kind: Kind::Count, show: |x| x.to_string() }
    }

    /// Numbers, printed with `show`.
    pub fn number(heading: &str, name: &'static str, show: fn(f64) -> String) -> Column {
        Column { heading: heading.to_owned(), name, kind: Kind::Float, show }
    }
}

/// A value of a table.
#[derive(Clone, Debug, PartialEq)]
pub enum Cell {
    /// Words.
    Text(String),
    /// A whole number.
    Count(u64),
    /// A number.
    Number(f64),
    /// A number that is printed as this text.
    Shown(f64, String),
    /// Nothing that applies.
    Missing,
}

impl From<&str> for Cell {
    fn from(text: &str) -> Cell {
        Cell::Text(text.to_owned())
    }
}

impl From<u64> for Cell {
    fn from(count: u64) -> Cell {
        Cell::Count(count)
    }
}

impl From<usize> for Cell {
    fn from(count: usize) -> Cell {
        Cell::Count(count as u64)
    }
}

impl From<f64> for Cell {
    fn from(number: f64) -> Cell {
        Cell::Number(number)
    }
}

impl<T: Into<Cell>> From<Option<T>> for Cell {
    fn from(value: Option<T>) -> Cell {
        value.map_or(Cell::Missing, T::into)
    }
}

impl fmt::Display for Table {
    /// The title, the table with its first printed column and all words aligned to the left, and the conclusions.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let shown = |(column, cell): (&Column, &Cell)| match cell {
            Cell::Text(text) | Cell::Shown(_, text) => text.clone(),
            Cell::Count(count) => thousands(*count),
            Cell::Number(number) => (column.show)(*number),
            Cell::Missing => "–".to_owned(),
        };
        let is_printed = |(column, _): &(&Column, &Cell)| !column.heading.is_empty();
        let rows = self.rows.iter().map(|row| self.columns.iter().zip(row).filter(is_printed).map(shown).collect());
        let headings = self.columns.iter().map(|column| column.heading.clone()).filter(|heading| !heading.is_empty());
        let lines: Vec<Vec<String>> = iter::once(headings.collect()).chain(rows).collect();
        if !self.title.is_empty() {
            writeln!(f, "{}\n", self.title)?;
        }
        let printed = self.columns.iter().filter(|column| !column.heading.is_empty());
        let are_words: Vec<bool> = printed.map(|column| column.kind == Kind::Text).collect();
        for line in aligned(&lines, |k| k == 0 || are_words[k]) {
            writeln!(f, "{line}")?;
        }
        if !self.conclusions.is_empty() {
            writeln!(f, "\n{}", self.conclusions.join("\n"))?;
        }
        Ok(())
    }
}

/// The columns of a file of measurements: those given, and the machine.
pub fn file_columns(columns: &[Column]) -> Vec<table::Column> {
    let written = columns.iter().filter(|column| !column.name.is_empty());
    let of = |column: &Column| table::Column::new(column.name, column.kind, "");
    let machine = ["processor", "version"].map(|name| table::Column::new(name, Kind::Text, ""));
    written.map(of).chain(machine).collect()
}

/// Writes measurements to a file.
///
/// # Errors
/// A row cannot be written.
pub fn write(mut file: table::Table, report: &Report, machine: &Machine) -> Result<(), table::TableError> {
    let machine = [table::Cell::Text(&machine.processor), table::Cell::Text(machine.version)];
    let tables = report.file.as_ref().map_or(&report.tables[..], std::slice::from_ref);
    for (table, row) in tables.iter().flat_map(|table| table.rows.iter().map(move |row| (table, row))) {
        let written = table.columns.iter().zip(row).filter(|(column, _)| !column.name.is_empty());
        let cells = written.map(|(_, cell)| match cell {
            Cell::Text(text) => table::Cell::Text(text),
            Cell::Count(count) => table::Cell::Count(*count),
            Cell::Number(number) | Cell::Shown(number, _) => table::Cell::Float(*number),
            Cell::Missing => table::Cell::Null,
        });
        file.row(&cells.chain(machine).collect::<Vec<_>>())?;
    }
    file.finish().map(drop)
}

/// The machine that was measured, and the version of the program.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Machine {
    /// The processor's model name.
    pub processor: String,
    /// Number of cores available to the program.
    pub cores: usize,
    /// Version of the program.
    pub version: &'static str,
}

impl Machine {
    /// The current machine.
    pub fn detect() -> Machine {
        Machine {
            processor: machine::processor(),
            cores: std::thread::available_parallelism().map_or(1, |cores| cores.get()),
            version: env!("CARGO_PKG_VERSION"),
        }
    }
}

impl fmt::Display for Machine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}, {} cores; meldscope {}", self.processor, self.cores, self.version)
    }
}
