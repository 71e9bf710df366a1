//! The folder of a sweep: finished and unfinished rows.
//!
//! | file | |
//! | --- | --- |
//! | `sweep.toml`, `scene.toml` | the sweep and its scene, compared when the sweep is resumed |
//! | `rows-LEVEL-SHARDofSHARDS-BLOCK.parquet` | rows; each file is written atomically |
//! | `.rows-….journal` | rows of an incomplete block, each written as soon as its run ends |
//!
//! The sweep determines the rows of a block. Two processes that run the same shard, by mistake or because the first one
//! was presumed lost, therefore write the same file. Processes need neither communication nor locks.

use std::{
    collections::{BTreeMap, BTreeSet, HashSet},
    fs::{self, File, OpenOptions},
    io::{self, Write as _},
    path::{Path, PathBuf},
    time::Duration,
};

use super::{
    Sweep,
    row::{Row, from_line, line_of},
    table,
};
use crate::{
    atomic::{self, AtomicFile, PARTIAL},
    table::Column,
};

/// Age of the last write from which on a temporary file counts as abandoned: a table is written within seconds.
const ABANDONED: Duration = Duration::from_secs(600);
const JOURNAL: &str = ".journal";
const PARQUET: &str = ".parquet";

/// Why a sweep cannot continue in its folder.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// A file operation failed.
    #[error("cannot {doing} {path}: {source}{}", help(source))]
    File {
        /// What was attempted.
        doing: &'static str,
        /// The file or folder.
        path: String,
        /// The operating system's error.
        source: io::Error,
    },
    /// The folder belongs to another sweep.
    #[error("{path} has the rows of another sweep (its {file} differs): choose another folder")]
    Other {
        /// The folder.
        path: String,
        /// The file that differs.
        file: &'static str,
    },
    /// The folder has a file of the user where a copy of the sweep or its scene would be.
    #[error(
        "a sweep keeps a copy of itself and of its scene in its folder, where {path} stands: choose another folder"
    )]
    Taken {
        /// The file.
        path: String,
    },
    /// A table cannot be read.
    #[error(transparent)]
    Table(#[from] table::TableError),
}

fn help(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            "; rows already written are kept: free some space, and run the same command to resume"
        }
        _ => "",
    }
}

/// The part of a level that a process runs: rows whose index in the level is congruent to `index` modulo `count`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Shard {
    /// Index of the shard, from 0.
    pub index: u64,
    /// Number of shards.
    pub count: u64,
}

impl Shard {
    /// All rows.
    pub const ALL: Shard = Shard { index: 0, count: 1 };
}

/// A file of rows.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Part {
    level: u32,
    shard: Shard,
    block: u64,
}

impl Part {
    fn name(&self) -> String {
        format!("{}{:06}{PARQUET}", stem(self.level, self.shard), self.block)
    }

    fn parse(name: &str) -> Option<Part> {
        let mut fields = name.strip_prefix("rows-")?.strip_suffix(PARQUET)?.splitn(3, '-');
        let level = fields.next()?.parse().ok()?;
        let (index, count) = fields.next()?.split_once("of")?;
        let shard = Shard { index: index.parse().ok()?, count: count.parse().ok()? };
        let part = Part { level, shard, block: fields.next()?.parse().ok()? };
        (part.name() == name).then_some(part)
    }
}

fn stem(level: u32, shard: Shard) -> String {
    format!("rows-{level:02}-{}of{}-", shard.index, shard.count)
}

/// The folder of a sweep.
pub struct Store {
    path: PathBuf,
    columns: Vec<Column>,
}

impl Store {
    /// Creates the folder of a sweep, or opens it to resume the sweep.
    ///
    /// # Errors
    /// The folder cannot be written, or belongs to another sweep.
    pub fn open(path: &Path, sweep: &Sweep, columns: Vec<Column>) -> Result<Store, StoreError> {
        let store = Store { path: path.to_owned(), columns };
        let copies =
            [("sweep.toml", &sweep.text, &sweep.file), ("scene.toml", &sweep.scene_with_meshes(), &sweep.scene_file)];
        // finished ones, and those of a run that was ended
        let is_of_rows = |name: &String| name.trim_start_matches('.').starts_with("rows-");
        let has_rows = path.is_dir() && store.names()?.iter().any(is_of_rows);
        for (file, text, own) in copies {
            let there = path.join(file);
            let Ok(known) = fs::read(&there) else { continue };
            // an original in place of its copy: a change of it would not be noticed
            let is_own =
                fs::canonicalize(own).is_ok_and(|own| fs::canonicalize(&there).is_ok_and(|there| own == there));
            if is_own || known != text.as_bytes() && !has_rows {
                return Err(StoreError::Taken { path: there.display().to_string() });
            }
        }
        fs::create_dir_all(path).map_err(|error| store.error("create the folder", path, error))?;
        for (file, text, _) in copies {
            let there = path.join(file);
            if !there.exists()
                && let Err(error) = atomic::write_new(&there, text)
                && error.kind() != io::ErrorKind::AlreadyExists
            {
                return Err(store.error("write", &there, error));
            }
            let known = fs::read(&there).map_err(|error| store.error("read", &there, error))?;
            if known != text.as_bytes() {
                return Err(StoreError::Other { path: path.display().to_string(), file });
            }
        }
        Ok(store)
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The columns of its tables.
    pub fn columns(&self) -> &[Column] {
        &self.columns
    }

    fn error(&self, doing: &'static str, path: &Path, source: io::Error) -> StoreError {
        StoreError::File { doing, path: path.display().to_string(), source }
    }

    /// Writes a file atomically, even if the machine crashes.
    ///
    /// # Errors
    /// The file cannot be written; no temporary file is left behind.
    pub fn write(
        &self,
        name: &str,
        write: impl FnOnce(&mut AtomicFile) -> io::Result<()>,
    ) -> Result<PathBuf, StoreError> {
        let path = self.path.join(name);
        let written = || {
            let mut file = AtomicFile::create(&path)?;
            write(&mut file)?;
            file.commit()
        };
        written().map_err(|error| self.error("write", &path, error))?;
        Ok(path)
    }

    /// Writes the rows of a block.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write_block(&self, level: u32, shard: Shard, block: u64, rows: &[Row]) -> Result<(), StoreError> {
        let name = Part { level, shard, block }.name();
        self.write(&name, |to| table::write(&self.columns, rows, to)).map(drop)
    }

    fn names(&self) -> Result<Vec<String>, StoreError> {
        let failed = |error| self.error("read the folder", &self.path, error);
        let mut names = Vec::new();
        for entry in fs::read_dir(&self.path).map_err(failed)? {
            names.extend(entry.map_err(failed)?.file_name().into_string());
        }
        names.sort();
        Ok(names)
    }

    fn parts(&self) -> Result<Vec<Part>, StoreError> {
        let mut parts: Vec<Part> = self.names()?.iter().filter_map(|name| Part::parse(name)).collect();
        parts.sort();
        Ok(parts)
    }

    /// The finished blocks of a shard.
    ///
    /// # Errors
    /// The folder cannot be read.
    pub fn blocks(&self, level: u32, shard: Shard) -> Result<BTreeSet<u64>, StoreError> {
        let parts = self.parts()?.into_iter().filter(|part| part.level == level && part.shard == shard);
        Ok(parts.map(|part| part.block).collect())
    }

    /// Reads some columns of the rows of some levels, in the order of their files; the first column is the row number.
    /// With `other`, only rows from divisions into another number of shards than this one's.
    ///
    /// # Errors
    /// A table cannot be read.
    pub fn read(
        &self,
        levels: std::ops::Range<u32>,
        other: Option<Shard>,
        columns: &[Column],
        mut each: impl FnMut(Row),
    ) -> Result<(), StoreError> {
        let parts = self.parts()?;
        // processes that divide a level differently may finish the same rows
        let is_divided_twice =
            parts.windows(2).any(|next| next[0].level == next[1].level && next[0].shard.count != next[1].shard.count);
        let mut seen = HashSet::new();
        for part in parts {
            let is_other = other.is_none_or(|shard| shard.count != part.shard.count);
            if levels.contains(&part.level) && is_other {
                table::read(&self.path.join(part.name()), columns, &mut |row: Row| {
                    if !is_divided_twice || seen.insert((part.level, row.0)) {
                        each(row);
                    }
                })?;
            }
        }
        Ok(())
    }

    /// The columns with these names, after the row number.
    pub fn named(&self, names: &[&str]) -> Vec<Column> {
        let named = names.iter().filter_map(|name| self.columns.iter().find(|column| column.name == *name));
        self.columns.first().into_iter().chain(named).cloned().collect()
    }

    /// The rows in the journals of a shard, for blocks not yet written.
    ///
    /// # Errors
    /// A journal cannot be read.
    pub fn journals(&self, level: u32, shard: Shard) -> Result<BTreeMap<u64, Row>, StoreError> {
        let mut rows = BTreeMap::new();
        for path in self.journal_paths(level, shard)? {
            let bytes = match fs::read(&path) {
                Err(error) if error.kind() == io::ErrorKind::NotFound => continue, // its shard is complete by now
                read => read.map_err(|error| self.error("read", &path, error))?,
            };
            let text = String::from_utf8_lossy(&bytes);
            // what follows a damaged line may be damaged too
            let intact = text.lines().map_while(|line| from_line(line, &self.columns));
            rows.extend(intact.map(|row| (row.0, row)));
        }
        Ok(rows)
    }

    fn journal_paths(&self, level: u32, shard: Shard) -> Result<Vec<PathBuf>, StoreError> {
        let start = format!(".{}", stem(level, shard));
        let names = self.names()?.into_iter().filter(|name| name.starts_with(&start) && name.ends_with(JOURNAL));
        Ok(names.map(|name| self.path.join(name)).collect())
    }

    /// Creates a journal of this process.
    ///
    /// # Errors
    /// The journal cannot be created.
    pub fn journal(&self, level: u32, shard: Shard) -> Result<Journal, StoreError> {
        let start = format!(".{}", stem(level, shard));
        let name =
            atomic::unique_name(&start, JOURNAL).map_err(|error| self.error("name", Path::new(&start), error))?;
        let path = self.path.join(name);
        let file = OpenOptions::new().append(true).create_new(true).open(&path);
        let file = file.map_err(|error| self.error("create", &path, error))?;
        Ok(Journal { file, path })
    }

    /// Removes the leftovers of a complete shard: its journals, and temporary files of killed processes.
    pub fn clean(&self, level: u32, shard: Shard) -> Result<(), StoreError> {
        for path in self.journal_paths(level, shard)? {
            fs::remove_file(path).ok();
        }
        // other processes may be writing the recent ones
        for name in self.names()?.iter().filter(|name| name.starts_with('.') && name.ends_with(PARTIAL)) {
            let path = self.path.join(name);
            let age = || fs::metadata(&path)?.modified()?.elapsed().map_err(io::Error::other);
            if age().is_ok_and(|age| age > ABANDONED) {
                fs::remove_file(&path).ok();
            }
        }
        Ok(())
    }
}

/// The rows of a block in progress.
pub struct Journal {
    file: File,
    path: PathBuf,
}

impl Journal {
    /// Adds a row. It survives a crash of the process, though not of the machine.
    ///
    /// # Errors
    /// The journal cannot be written.
    pub fn add(&mut self, row: &Row) -> Result<(), StoreError> {
        self.file.write_all(line_of(row).as_bytes()).map_err(|error| self.error(error))
    }

    /// Clears the journal after its rows have been written to a table.
    ///
    /// # Errors
    /// The journal cannot be truncated.
    pub fn clear(&mut self) -> Result<(), StoreError> {
        self.file.set_len(0).map_err(|error| self.error(error))
    }

    fn error(&self, source: io::Error) -> StoreError {
        StoreError::File { doing: "write", path: self.path.display().to_string(), source }
    }
}
