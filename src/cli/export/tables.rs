//! Tables of a run as CSV, a file each. A file is there as a whole or not at all.

use std::{
    fs::{self, File},
    io::{self, BufRead as _, BufReader, BufWriter, Read as _},
    path::{Path, PathBuf},
};

use crate::{
    cli::Failure,
    observe::{Frame, Instant, PairEvent, Schema, StepSummary, schema::ScalarOf},
    stream::unfinished,
};

/// Longest header that is compared with that of a file to be replaced [bytes].
const LONGEST_HEADER: u64 = 1 << 16;

/// A table that is being written.
pub struct Table {
    path: PathBuf,
    partial: PathBuf,
    writer: csv::Writer<BufWriter<File>>,
}

impl Table {
    /// Begins a table of events: `step`, `time` [s], `event`, the bodies `a` and `b`, `q` and its `rate` [1/s], the phases
    /// `from` and `to`.
    pub fn of_events(path: &Path) -> Result<Table, Failure> {
        Table::create(path, &["step", "time", "event", "a", "b", "q", "rate", "from", "to"])
    }

    /// Begins a table of pairs within reach: `step`, `time` [s], the bodies `a` and `b`, `q`, `phase`.
    pub fn of_pairs(path: &Path) -> Result<Table, Failure> {
        Table::create(path, &["step", "time", "a", "b", "q", "phase"])
    }

    /// Begins a table of scalars: `step`, `time` [s], and a column for each scalar of the schema.
    pub fn of_scalars(path: &Path, schema: &Schema) -> Result<Table, Failure> {
        let names = schema.scalars.iter().map(|scalar| scalar.name);
        Table::create(path, &["step", "time"].into_iter().chain(names).collect::<Vec<_>>())
    }

    fn create(path: &Path, header: &[&str]) -> Result<Table, Failure> {
        if path.extension().is_none_or(|extension| !extension.eq_ignore_ascii_case("csv")) {
            let path = path.display();
            return Err(Failure::Input(format!("{path}: tables are written as CSV: give a name that ends in .csv")));
        }
        let mut partial = path.as_os_str().to_owned();
        partial.push(super::PARTIAL);
        let partial = PathBuf::from(partial);
        for path in [path, &partial] {
            if path.symlink_metadata().is_ok() && !is_table(path, header) {
                return Err(Failure::Input(format!(
                    "{} is not such a table and is not replaced: choose another name",
                    path.display()
                )));
            }
        }
        let failed = |error| Failure::Input(format!("cannot write {}: {error}", path.display()));
        fs::remove_file(&partial).ok(); // left by a run that was killed
        let file = unfinished::create_new(&partial).map_err(failed)?;
        let mut table =
            Table { path: path.to_owned(), partial, writer: csv::Writer::from_writer(BufWriter::new(file)) };
        table.row(header.iter().map(|name| (*name).to_owned()))?;
        Ok(table)
    }

    /// Adds an event.
    pub fn event(&mut self, schema: &Schema, event: &PairEvent) -> Result<(), Failure> {
        let phase = |phase: usize| schema.phases[phase].name.to_owned();
        let body = |body: usize| schema.bodies[body].name.clone();
        self.row([
            event.step.to_string(),
            number(event.time),
            event.name.to_owned(),
            body(event.a),
            body(event.b),
            number(event.q),
            number(event.rate),
            phase(event.from),
            phase(event.to),
        ])
    }

    /// Adds the pairs of a frame.
    pub fn pairs(&mut self, schema: &Schema, frame: &Frame) -> Result<(), Failure> {
        let Instant { step, time } = frame.at;
        frame.pairs.iter().try_for_each(|pair| {
            let body = |body: usize| schema.bodies[body].name.clone();
            let phase = schema.phases[pair.phase].name.to_owned();
            self.row([step.to_string(), number(time), body(pair.a), body(pair.b), number(pair.q), phase])
        })
    }

    /// Adds the scalars of a frame and of the step that led to it.
    pub fn scalars(&mut self, schema: &Schema, frame: &Frame, summary: &StepSummary) -> Result<(), Failure> {
        let scalars = schema.scalars.iter().enumerate().map(|(index, scalar)| {
            let values = if scalar.of == ScalarOf::State { &frame.scalars } else { &summary.scalars };
            values.get(index).copied().map_or(String::new(), number)
        });
        self.row([frame.at.step.to_string(), number(frame.at.time)].into_iter().chain(scalars))
    }

    fn row(&mut self, cells: impl IntoIterator<Item = String>) -> Result<(), Failure> {
        self.writer.write_record(cells).map_err(|error| self.failed(&error))
    }

    /// Puts the file in its place; returns its size [bytes].
    pub fn finish(mut self) -> Result<u64, Failure> {
        let placed = |table: &mut Table| -> io::Result<u64> {
            table.writer.flush()?;
            fs::rename(&table.partial, &table.path)?;
            Ok(table.path.metadata()?.len())
        };
        let size = placed(&mut self).map_err(|error| self.failed(&error))?;
        Ok(size)
    }

    fn failed(&self, error: &dyn std::error::Error) -> Failure {
        Failure::Run(format!("cannot write {}: {error}", self.path.display()))
    }
}

impl Drop for Table {
    fn drop(&mut self) {
        fs::remove_file(&self.partial).ok(); // gone if the table was finished
        unfinished::forget(&self.partial);
    }
}

/// The shortest text that is this number, to the last bit.
fn number(number: f64) -> String {
    format!("{number:?}")
}

/// Whether a file begins with this header, or is empty.
fn is_table(path: &Path, header: &[&str]) -> bool {
    let mut line = String::new();
    let is_file = path.symlink_metadata().is_ok_and(|metadata| metadata.is_file());
    is_file
        && File::open(path).is_ok_and(|file| BufReader::new(file.take(LONGEST_HEADER)).read_line(&mut line).is_ok())
        && (line.is_empty() || line.trim_end() == header.join(","))
}
