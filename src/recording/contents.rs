//! The recordings in a file: one, or several one after the other, as `bench thesis --save` and `rerun rrd merge` make.

use std::{
    collections::HashMap,
    path::{Path, PathBuf},
};

use super::{
    ReadError, Recorded,
    read::{End, Reader},
    recorded::Found,
};
use crate::{
    observe::simulation::ReadExperiment,
    stream::contract::{CHECKSUM, EVENTS, PROPERTIES},
};

/// The recordings in a file, whose scenes are not parsed yet.
pub struct Contents {
    path: PathBuf,
    /// In the order in which they begin.
    found: Vec<Found>,
    end: End,
}

impl Contents {
    /// Reads a file.
    ///
    /// # Errors
    /// The file cannot be read, is not a recording, or is damaged.
    pub fn read(path: &Path) -> Result<Contents, ReadError> {
        let mut reader = Reader::open(path)?;
        let (mut found, mut indices) = (Vec::<Found>::new(), HashMap::new());
        while let Some(chunk) =
            reader.next(|entity| [&PROPERTIES, &CHECKSUM, &EVENTS].iter().any(|wanted| wanted.is(entity)))?
        {
            let id = reader.id().unwrap_or_default();
            let index = *indices.entry(id.to_owned()).or_insert_with(|| {
                found.push(Found::new(id, reader.application().unwrap_or_default()));
                found.len() - 1
            });
            let taken = found[index].take(&chunk, reader.at());
            taken.map_err(|what| ReadError::Damaged { path: path.to_owned(), at: None, what })?;
        }
        if found.is_empty() {
            found.push(Found::default());
        }
        Ok(Contents { path: path.to_owned(), found, end: reader.end().unwrap_or(End::Cut) })
    }

    /// The name of each recording: that of its scene, or its id where several have that name.
    pub fn names(&self) -> Vec<&str> {
        let mut counts = HashMap::new();
        self.found.iter().for_each(|recording| *counts.entry(recording.name()).or_insert(0) += 1);
        let name = |recording| if counts[Found::name(recording)] == 1 { recording.name() } else { &recording.id };
        self.found.iter().map(name).collect()
    }

    /// The recording of this name or id; without one, the only recording.
    ///
    /// # Errors
    /// There is no such recording, the file holds several and none is named, or it is not a valid recording.
    pub fn only(self, name: Option<&str>, read: &ReadExperiment<'_>) -> Result<Recorded, ReadError> {
        self.recorded(self.index(name)?, read)
    }

    /// The place of the recording of this name or id among the [names](Contents::names); without one, that of the only
    /// recording.
    ///
    /// # Errors
    /// There is no such recording, or the file holds several and none is named.
    pub fn index(&self, name: Option<&str>) -> Result<usize, ReadError> {
        let names = self.names();
        match name {
            None if names.len() == 1 => Ok(0),
            None => Err(self.several("it holds")),
            Some(name) => {
                let index = names.iter().zip(&self.found).position(|(known, of)| *known == name || of.id == name);
                index.ok_or_else(|| self.several(&format!("there is no {name:?} among its")))
            }
        }
    }

    /// The name of the scene of a recording; several may have the same.
    pub fn scene(&self, index: usize) -> &str {
        self.found[index].name()
    }

    /// Recreates a recording; `index` is its place among the [names](Contents::names).
    ///
    /// # Errors
    /// It is not a valid recording of this program.
    pub fn recorded(&self, index: usize, read: &ReadExperiment<'_>) -> Result<Recorded, ReadError> {
        let recording = &self.found[index];
        // what another recording follows has ended before the file was cut
        let is_followed = index + 1 < self.found.len() && recording.has_end();
        let end = if is_followed { End::Whole } else { self.end };
        recording.clone().into_recorded(&self.path, read, end)
    }

    fn several(&self, what: &str) -> ReadError {
        /// Upper limit on listed names.
        const LISTED: usize = 12;
        let names = self.names();
        let more = names.len().saturating_sub(LISTED);
        let mut listed = names.iter().take(LISTED).copied().collect::<Vec<_>>().join(", ");
        if more > 0 {
            listed += &format!(" and {more} more");
        }
        ReadError::Several { path: self.path.clone(), what: what.to_owned(), count: names.len(), names: listed }
    }
}
