//! What it takes to make a recording again, and what came of it.

use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

use rerun::{
    Loggable,
    datatypes::{Float64, Utf8},
    external::{
        arrow::array::{Array as _, ArrayRef, AsArray as _},
        arrow::datatypes::UInt64Type,
        re_chunk_store::external::re_chunk::Chunk,
    },
};

use super::{
    ReadError,
    read::{End, Reader},
};
use crate::{
    observe::{Experiment, Refusal, Schema, Simulation, simulation::ReadExperiment},
    sim::{checksum, simulation},
    stream::{
        checksums,
        parts::pairs::event,
        settings::{FORMAT, Settings, recording_id, table},
    },
};

/// Where the properties are.
pub(super) const PROPERTIES: &str = "/__properties/meldscope";
/// Checksums do not pack: each takes so much of its file [bytes].
const CHECKSUM_BYTES: u64 = 8;
/// So many may be read before the file has room for them.
const SPARE: u64 = 4096;
/// No property but the scene is longer [bytes].
const LONGEST_PROPERTY: usize = 64 << 10;
/// A scene's text packs to no less than a part in so many, beyond this length [bytes].
const TEXT: (u64, u64) = (1 << 20, 16);

/// A recording without its frames.
#[derive(Clone, Debug)]
pub struct Recorded {
    /// The file.
    pub path: PathBuf,
    /// What was run: overrides included.
    pub experiment: Arc<dyn Experiment>,
    /// What that says of itself.
    pub schema: Schema,
    /// How it is run, as the recording has it.
    pub run: toml::Table,
    /// How it was recorded.
    pub settings: Settings,
    /// What the run changed of the scene, as lines of its file.
    pub overrides: String,
    /// Version of the program that made it.
    pub version: String,
    /// The machine that it was made on.
    pub machine: String,
    /// Why it was made, if it is a golden one.
    pub blessed: Option<String>,
    /// Why the run ended before its last step, if it failed.
    pub failure: Option<String>,
    /// The step of the first checksum.
    pub first: u64,
    /// Of every step from `first` on.
    pub checksums: Vec<u64>,
    /// Every event, in the order of the file.
    pub events: Vec<RecordedEvent>,
    /// Whether it is all there.
    pub end: End,
}

/// An event as a recording tells of it.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedEvent {
    /// What: merge, split, core, core left.
    pub name: String,
    /// The pair, as `A~B`.
    pub pair: String,
    /// The phases before and after, if they are recorded.
    pub phases: Option<[String; 2]>,
    /// Centre distance over the sum of the radii then [–], if it is recorded.
    pub q: Option<f64>,
    /// When [s]: to the nanosecond in golden recordings of before, exactly in others.
    pub time: f64,
    /// The first step whose state has felt it.
    pub step: u64,
}

/// The properties as they are in the file.
#[derive(Default)]
struct Properties {
    scene: Option<String>,
    settings: Option<String>,
    overrides: Option<String>,
    version: Option<String>,
    machine: Option<String>,
    blessed: Option<String>,
    failure: Option<String>,
    digest: Option<String>,
    format: Option<f64>,
}

impl Recorded {
    /// Reads a recording of a scene, whole or cut short.
    ///
    /// # Errors
    /// It is not a recording of this program, of a format that this one does not know, or damaged.
    pub fn open(path: &Path) -> Result<Recorded, ReadError> {
        Recorded::open_as(path, &simulation::read)
    }

    /// The same of an experiment that `read` makes again from what the recording carries.
    ///
    /// # Errors
    /// As [`Recorded::open`].
    pub fn open_as(path: &Path, read: &ReadExperiment<'_>) -> Result<Recorded, ReadError> {
        let mut reader = Reader::open(path)?;
        let mut properties = Properties::default();
        let (mut sums, mut events) = (ReadChecksums::default(), Vec::new());
        while let Some(chunk) = reader.next(|entity| [PROPERTIES, checksums::ENTITY, "/events"].contains(&entity))? {
            let damaged = |what: String| ReadError::Damaged { path: path.to_owned(), at: None, what };
            match chunk.entity_path().to_string().as_str() {
                PROPERTIES => properties.take(&chunk, reader.at()).map_err(damaged)?,
                checksums::ENTITY => sums.take(&chunk, reader.at()).map_err(damaged)?,
                _ => events.extend(events_of(&chunk).map_err(damaged)?),
            }
        }
        let id = reader.id().unwrap_or_default().to_owned();
        properties.understand(path, read, &id, sums, events, reader.end().unwrap_or(End::Cut))
    }

    /// What was run, at its start.
    ///
    /// # Errors
    /// It cannot be run here.
    pub fn start(&self) -> Result<Box<dyn Simulation>, ReadError> {
        start(&*self.experiment, &self.path)
    }

    /// The last step that there is a checksum of.
    pub fn last(&self) -> u64 {
        self.first + (self.checksums.len() as u64).saturating_sub(1)
    }

    /// The checksum of a step, if there is one.
    pub fn checksum(&self, step: u64) -> Option<u64> {
        let index = usize::try_from(step.checked_sub(self.first)?).ok()?;
        self.checksums.get(index).copied()
    }

    /// What differs between where it was made and here, in words; empty if nothing does.
    pub fn foreign_to(&self, machine: &str) -> Vec<String> {
        let mut differences = Vec::new();
        let here = env!("CARGO_PKG_VERSION");
        if self.version != here {
            differences.push(format!("it was made by meldscope {}, this is {here}", self.version));
        }
        if self.machine != machine {
            differences.push(format!("it was made on {}, this is {machine}", self.machine));
        }
        differences
    }
}

impl Properties {
    /// Those of a chunk, with which `read` bytes of the file are read.
    fn take(&mut self, chunk: &Chunk, read: u64) -> Result<(), String> {
        for (field, name) in [
            (&mut self.scene, "scene"),
            (&mut self.settings, "settings"),
            (&mut self.overrides, "overrides"),
            (&mut self.version, "version"),
            (&mut self.machine, "machine"),
            (&mut self.blessed, "blessed"),
            (&mut self.failure, "failure"),
            (&mut self.digest, "digest"),
        ] {
            if let Some(text) = cell::<Utf8>(chunk, name, 0).into_iter().next() {
                let text = text.as_str();
                let most = match name {
                    "scene" => crate::scene::Scene::LARGEST_TEXT.min(TEXT.0 + TEXT.1 * read) as usize,
                    _ => LONGEST_PROPERTY,
                };
                if text.len() > most {
                    return Err(format!("its {name} has {} bytes, more than the {most} that it may have", text.len()));
                }
                *field = Some(text.to_owned());
            }
        }
        self.format = cell::<Float64>(chunk, "format", 0).first().map(|number| number.0).or(self.format);
        Ok(())
    }

    fn understand(
        self,
        path: &Path,
        read: &ReadExperiment<'_>,
        id: &str,
        sums: ReadChecksums,
        events: Vec<RecordedEvent>,
        end: End,
    ) -> Result<Recorded, ReadError> {
        let foreign = |what: &str| ReadError::Foreign { path: path.to_owned(), what: what.to_owned() };
        let unsupported = |what: String| ReadError::Unsupported { path: path.to_owned(), what };
        let scene_error = |what: String| ReadError::Scene { path: path.to_owned(), what };
        let Some(format) = self.format else {
            return Err(match (self.scene, end) {
                (Some(_), _) => unsupported(
                    "was made before recordings carried checksums, so that there is nothing to verify: run its scene again"
                        .to_owned(),
                ),
                (None, End::Cut) => foreign("it ends before it says what it is"),
                (None, End::Whole) => foreign("it has no properties of one"),
            });
        };
        if format != f64::from(FORMAT) {
            let version = self.version.unwrap_or_default();
            return Err(unsupported(format!(
                "has format {format}, made by meldscope {version}, and this program reads format {FORMAT}: use that version"
            )));
        }
        let (Some(text), Some(settings), Some(version)) = (self.scene, self.settings, self.version) else {
            return Err(foreign("it has no scene, no settings or no version"));
        };
        let file = path.file_name().unwrap_or_default().to_string_lossy();
        // An id is made of these texts, so any change of them shows.
        let ending = |id: &str| id.rsplit('-').next().unwrap_or_default().to_owned();
        let is_as_made = ending(id) == ending(&recording_id("", &text, &settings, &version));
        let run = table(&settings);
        let cannot_run = |what: String| unsupported(format!("cannot be run here: {what}"));
        let experiment = match read(&file, &text, &run) {
            Err(Refusal::Source(what)) => return Err(scene_error(what)),
            _ if !is_as_made => {
                let what = "its scene or its settings are not those that it was made of".to_owned();
                return Err(ReadError::Damaged { path: path.to_owned(), at: None, what });
            }
            Err(Refusal::Run(what)) => return Err(cannot_run(what)),
            Ok(experiment) => experiment,
        };
        let schema = experiment.schema();
        let settings = Settings::from_toml(&settings, schema.bodies.len()).map_err(cannot_run)?;
        // a run that was killed may not have come to the first step
        if sums.values.is_empty() && end == End::Whole {
            return Err(foreign("it has no checksums"));
        }
        let damaged = |what: String| ReadError::Damaged { path: path.to_owned(), at: None, what };
        let last = sums.first + (sums.values.len() as u64).saturating_sub(1);
        match (settings.steps, &self.digest) {
            (Some(steps), _) if last > steps => {
                return Err(damaged(format!("it has a checksum of step {last}, and step {steps} is its last")));
            }
            // only a replay begins late, and it knows its end
            (None, _) if sums.first > 0 => {
                return Err(damaged(format!("its checksums begin with step {}", sums.first)));
            }
            (_, Some(digest)) => {
                let found = checksum::sequence(sums.values.iter().copied());
                if *digest != format!("{found:016x}") {
                    return Err(damaged("its checksums are not those that were written".to_owned()));
                }
            }
            (_, None) if end == End::Whole => return Err(damaged("it has an end but no digest".to_owned())),
            (_, None) => {}
        }
        Ok(Recorded {
            path: path.to_owned(),
            experiment,
            schema,
            run,
            settings,
            overrides: self.overrides.unwrap_or_default(),
            version,
            machine: self.machine.unwrap_or_else(|| "a machine that it does not name".to_owned()),
            blessed: self.blessed,
            failure: self.failure,
            first: sums.first,
            checksums: sums.values,
            events,
            end,
        })
    }
}

/// An experiment at its start; `path` is what it came from.
pub(super) fn start(experiment: &dyn Experiment, path: &Path) -> Result<Box<dyn Simulation>, ReadError> {
    experiment.start().map_err(|what| ReadError::Scene { path: path.to_owned(), what })
}

/// ReadChecksums as they come in.
#[derive(Default)]
struct ReadChecksums {
    first: u64,
    values: Vec<u64>,
}

impl ReadChecksums {
    /// Those of a chunk, with which `read` bytes of the file are read.
    fn take(&mut self, chunk: &Chunk, read: u64) -> Result<(), String> {
        for row in 0..chunk.num_rows() {
            let step = u64::try_from(step_of(chunk, row)?).map_err(|_| "a checksum of a negative step".to_owned())?;
            let cell = raw(chunk, checksums::COMPONENT, row).ok_or("a row of no checksum")?;
            let values = cell.as_primitive_opt::<UInt64Type>().ok_or("checksums that are no numbers")?.values();
            let first = step.saturating_add(1).checked_sub(values.len() as u64).ok_or("checksums of negative steps")?;
            if self.values.is_empty() {
                self.first = first;
            }
            let next = self.first + self.values.len() as u64;
            if first != next {
                return Err(format!("where the checksum of step {next} should be is that of step {first}"));
            }
            let count = (self.values.len() + values.len()) as u64;
            if count > SPARE + read / CHECKSUM_BYTES {
                return Err(format!("{count} checksums within {read} bytes"));
            }
            self.values.extend_from_slice(values);
        }
        Ok(())
    }
}

/// The events of a chunk of `/events`.
fn events_of(chunk: &Chunk) -> Result<Vec<RecordedEvent>, String> {
    let mut events = Vec::new();
    for row in 0..chunk.num_rows() {
        let texts = |component: &str| -> Vec<String> {
            cell::<Utf8>(chunk, component, row).iter().map(|text| text.as_str().to_owned()).collect()
        };
        let number = |component: &str| cell::<Float64>(chunk, component, row).first().map(|number| number.0);
        let Some(name) = texts("TextLog:level").pop() else { continue };
        let pair = match texts(event::BODIES).as_slice() {
            [a, b] => format!("{a}~{b}"),
            // golden recordings of before have the line alone: "NAME A~B at t = …"
            _ => {
                let line = texts("TextLog:text").pop();
                let pair = line.as_ref().and_then(|line| line.strip_prefix(&name)?.split_whitespace().next());
                pair.ok_or("an event of no pair")?.to_owned()
            }
        };
        events.push(RecordedEvent {
            name,
            pair,
            phases: texts(event::PHASES).try_into().ok(),
            q: number(event::Q),
            time: number(event::TIME).unwrap_or(time_of(chunk, row)? as f64 * 1e-9),
            step: u64::try_from(step_of(chunk, row)?).map_err(|_| "an event of a negative step".to_owned())?,
        });
    }
    Ok(events)
}

/// What the timeline `step` says of a row.
pub(super) fn step_of(chunk: &Chunk, row: usize) -> Result<i64, String> {
    index(chunk, "step", row)
}

/// What the timeline `sim_time` says of a row [ns].
pub(super) fn time_of(chunk: &Chunk, row: usize) -> Result<i64, String> {
    index(chunk, "sim_time", row)
}

fn index(chunk: &Chunk, timeline: &str, row: usize) -> Result<i64, String> {
    let column = chunk.timelines().values().find(|column| column.timeline().name().as_str() == timeline);
    let time = column.and_then(|column| column.times_raw().get(row));
    time.copied().ok_or_else(|| format!("{} has rows without {timeline}", chunk.entity_path()))
}

/// A component of a row as it is in the file.
pub(super) fn raw(chunk: &Chunk, component: &str, row: usize) -> Option<ArrayRef> {
    let column = chunk.components().values().find(|column| column.descriptor.component.as_str() == component)?;
    let list = &column.list_array;
    (row < list.len() && !list.is_null(row)).then(|| list.value(row))
}

/// A component of a row as the SDK reads it; nothing if there is none, or none of that kind.
pub(super) fn cell<T: Loggable>(chunk: &Chunk, component: &str, row: usize) -> Vec<T> {
    raw(chunk, component, row).and_then(|cell| T::from_arrow(&cell).ok()).unwrap_or_default()
}
