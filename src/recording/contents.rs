//! The recordings in a file: one, or several one after the other, as [`record_all`](crate::stream::record_all) and `rerun
//! rrd merge` make. The path `F.rrd/NAME` is that of one of them.

use std::{
    collections::HashMap,
    path::{Path, PathBuf},
};

use super::{
    ReadError, Recorded,
    read::{End, Reader},
    recorded::{Found, called_as, cell},
};
use crate::{
    observe::simulation::ReadExperiment,
    sdk::{RecordingInfo, datatypes::Utf8},
    stream::{
        contract::{CHECKSUM, EVENTS, PROPERTIES, RECORDING_INFO, SURFACE_EVENTS, path_of},
        settings::file_stem,
    },
};

/// The recordings in a file, whose scenes are not parsed yet.
pub struct Contents {
    path: PathBuf,
    /// In the order in which they begin, each with the way it ends.
    found: Vec<(Found, End)>,
}

/// Splits the path of one recording of a file, `F.rrd/NAME`, into the file and the name.
pub(crate) fn file_and_name(path: &Path) -> (&Path, Option<&str>) {
    match (path.parent(), path.file_name().and_then(|name| name.to_str())) {
        (Some(file), Some(name)) if !path.exists() && file.is_file() => (file, Some(name)),
        _ => (path, None),
    }
}

impl Contents {
    /// Reads a file, or one recording of it: `F.rrd/NAME`, the name of its scene or its id.
    ///
    /// # Errors
    /// The file cannot be read, is not a recording, is damaged, or has no recording of this name.
    pub fn read(path: &Path) -> Result<Contents, ReadError> {
        let (path, name) = file_and_name(path);
        let mut reader = Reader::open(path)?;
        let (mut found, mut indices) = (Vec::<Found>::new(), HashMap::new());
        let mut called = HashMap::new();
        let wanted = [&PROPERTIES, &CHECKSUM, &EVENTS, &SURFACE_EVENTS, &RECORDING_INFO];
        while let Some(chunk) = reader.next(|entity| wanted.iter().any(|wanted| wanted.is(entity)))? {
            let id = reader.id().unwrap_or_default();
            if RECORDING_INFO.is(&path_of(&chunk)) {
                let name = cell::<Utf8>(&chunk, &RecordingInfo::descriptor_name(), 0).into_iter().next();
                called.extend(name.map(|name| (id.to_owned(), called_as(name.as_str()))));
                continue;
            }
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
        for recording in &mut found {
            recording.called = called.remove(&recording.id);
        }
        let end = reader.end().unwrap_or(End::Cut);
        let last = found.len() - 1;
        // what another recording follows has ended before the file was cut
        let ended = |(index, one): (usize, Found)| {
            let end = if index < last && one.has_end() { End::Whole } else { end };
            (one, end)
        };
        let found = found.into_iter().enumerate().map(ended).collect();
        let mut contents = Contents { path: path.to_owned(), found };
        if let Some(name) = name {
            let names = contents.names();
            let is_exactly = |(known, of): (&&str, &(Found, End))| *known == name || of.0.id == name;
            let index = names.iter().zip(&contents.found).position(is_exactly);
            let index = index.or_else(|| names.iter().position(|known| file_stem(known) == name));
            let index = index.ok_or_else(|| contents.several(&format!("there is no {name:?} among its")))?;
            contents.found = vec![contents.found.swap_remove(index)];
        }
        Ok(contents)
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The name of each recording: that of its scene, or its id where several have that name.
    pub fn names(&self) -> Vec<&str> {
        let mut counts = HashMap::new();
        let all = || self.found.iter().map(|(recording, _)| recording);
        all().for_each(|recording| *counts.entry(recording.name()).or_insert(0) += 1);
        let name = |recording| if counts[Found::name(recording)] == 1 { recording.name() } else { &recording.id };
        all().map(name).collect()
    }

    /// The place of the only recording among the [names](Contents::names).
    ///
    /// # Errors
    /// There are several.
    pub fn only(&self) -> Result<usize, ReadError> {
        if self.found.len() == 1 { Ok(0) } else { Err(self.several("it holds")) }
    }

    /// The name of the scene of a recording; several may have the same.
    pub fn scene(&self, index: usize) -> &str {
        self.found[index].0.name()
    }

    /// Recreates a recording; `index` is its place among the [names](Contents::names).
    ///
    /// # Errors
    /// It is not a valid recording of this program.
    pub fn recorded(&self, index: usize, read: &ReadExperiment<'_>) -> Result<Recorded, ReadError> {
        let (recording, end) = &self.found[index];
        recording.clone().into_recorded(&self.path, read, *end)
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
