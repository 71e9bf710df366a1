//! The inputs that reproduce a run, and the run's results.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    sync::Arc,
};

use super::{ReadError, contents::Contents, existing::Existing, read::End};
use crate::{
    hash, models,
    observe::{Experiment, Parameter, Refusal, Schema, Simulation, simulation::ReadExperiment},
    sdk::{
        Chunk, ComponentDescriptor, Loggable, TextLog,
        arrow::{
            array::{Array as _, ArrayRef, AsArray as _},
            datatypes::{ArrowPrimitiveType, UInt64Type},
        },
        datatypes::{Float64, Utf8},
    },
    stream::{
        contract::{
            self, BLESSED, BODIES, CHECKSUM, CHECKSUMS, COUNTS, Component, DIGEST, FAILURE, MACHINE, OVERRIDES, PHASES,
            PROPERTIES, Q, SCENE, SETTINGS, STEP, TIME, VERSION, path_of,
        },
        settings::{FORMAT, Settings, application, recording_id},
    },
    text::thousands,
};

/// Size of a checksum in a file [bytes]: checksums are incompressible.
const CHECKSUM_BYTES: u64 = 8;
/// This many checksums are accepted whatever the size of the file.
const SPARE: u64 = 4096;
/// Characters of the name of a recording that are read.
const MAX_NAME: usize = 200;
/// Upper limit on the length of a text, such as that of the scene: a constant [bytes], plus a multiple of what was read of the
/// file so far.
const TEXT: (u64, u64) = (1 << 20, 16);
/// Nor is it longer than this: the text of a scene, and as much for its meshes [bytes].
const LARGEST_TEXT: u64 = 2 * crate::scene::Scene::LARGEST_TEXT;

/// A recording without its frames.
#[derive(Clone, Debug)]
pub struct Recorded {
    /// The file.
    pub path: PathBuf,
    /// Its id, which tells it from others in the file.
    pub id: String,
    /// The experiment that was run, overrides included.
    pub experiment: Arc<dyn Experiment>,
    /// The schema of the experiment.
    pub schema: Schema,
    /// The settings of the run, as recorded.
    pub run: toml::Table,
    /// How the run was recorded.
    pub settings: Settings,
    /// Overrides of the scene by the run, as lines of the scene's file.
    pub overrides: String,
    /// Version of the program that made the recording.
    pub version: String,
    /// The machine on which the recording was made.
    pub machine: String,
    /// The reason for a golden recording; `None` for any other recording.
    pub blessed: Option<String>,
    /// The numbers of vertices and triangles of a golden recording, in words; `None` for any other recording.
    pub counts: Option<String>,
    /// Why the run ended before its last step, if it failed.
    pub failure: Option<String>,
    /// The step of the first checksum.
    pub first: u64,
    /// Checksums of every step from `first` on.
    pub checksums: Vec<u64>,
    /// All phase changes, in the order of the file.
    pub events: Vec<RecordedEvent>,
    /// When surfaces touch and part, in the order of the file.
    pub contacts: Vec<RecordedEvent>,
    /// Whether the file is complete.
    pub end: End,
}

/// An event as stored in a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedEvent {
    /// Kind of event, such as `merge`.
    pub name: String,
    /// The pair, as `A~B`.
    pub pair: String,
    /// The phases before and after the event; empty if surfaces touch or part, which changes none.
    pub phases: [String; 2],
    /// Centre distance over the sum of the radii at the event [–].
    pub q: f64,
    /// Exact time of the event [s].
    pub time: f64,
    /// The first step whose state is affected by the event.
    pub step: u64,
}

/// What a file holds of a recording, frames excepted.
#[derive(Clone, Debug, Default)]
pub(super) struct Found {
    pub id: String,
    application: String,
    /// The name of the recording.
    pub called: Option<String>,
    /// The texts among its properties, by the names of these.
    texts: BTreeMap<&'static str, String>,
    format: Option<f64>,
    sums: ReadChecksums,
    events: Vec<RecordedEvent>,
    contacts: Vec<RecordedEvent>,
}

/// The name by which a recording is found.
pub fn called_as(name: &str) -> String {
    name.chars().filter(|c| !c.is_control()).take(MAX_NAME).collect()
}

impl Recorded {
    /// What the run overrode of its scene, to follow other settings in a line; empty if nothing.
    pub fn overridden(&self) -> String {
        self.overrides.lines().filter(|line| !line.trim().is_empty()).map(|line| format!(", {line}")).collect()
    }

    /// Like [`Recorded::overridden`], beside another recording: also with what else differs in the parameters of both.
    pub fn overridden_beside(&self, other: &Recorded) -> String {
        /// Upper limit on the parameters that are named.
        const NAMED: usize = 8;

        let is_overridden = |of: &Recorded, key: &str| {
            of.overrides.lines().any(|line| line.split_once(" = ").is_some_and(|(known, _)| known == key))
        };
        // these are the values in the texts of the scenes
        let others = other.experiment.parameters();
        let differs = |of: &Parameter| {
            let is_other = |other: &Parameter| other.key == of.key && other.value != of.value;
            is_overridden(other, &of.key) || others.iter().any(is_other)
        };
        let parameters = self.experiment.parameters();
        let values = parameters.iter().filter(|of| differs(of) && !is_overridden(self, &of.key)).take(NAMED);
        self.overridden() + &values.map(|of| format!(", {} = {}", of.key, of.value)).collect::<String>()
    }

    /// Reads the recording of a scene in a file, complete or truncated.
    ///
    /// # Errors
    /// The file is not a recording of this program, has an unsupported format, holds several recordings, or is damaged.
    pub fn open(path: &Path) -> Result<Recorded, ReadError> {
        Recorded::open_as(path, &models::read)
    }

    /// Like [`Recorded::open`], for an experiment that `read` recreates from the contents of the recording.
    ///
    /// # Errors
    /// As for [`Recorded::open`].
    pub fn open_as(path: &Path, read: &ReadExperiment<'_>) -> Result<Recorded, ReadError> {
        let contents = Contents::read(path)?;
        contents.recorded(contents.only()?, read)
    }

    /// Starts the recorded experiment.
    ///
    /// # Errors
    /// It cannot be run here.
    pub fn start(&self) -> Result<Box<dyn Simulation>, ReadError> {
        start(&*self.experiment, &self.path)
    }

    /// The last step that has a checksum.
    pub fn last(&self) -> u64 {
        self.first + (self.checksums.len() as u64).saturating_sub(1)
    }

    /// In words, what a recording without an end lacks; `None` if it has its end.
    pub fn cut_short(&self) -> Option<String> {
        let (path, last) = (self.path.display(), thousands(self.last()));
        let lacks = match self.settings.steps {
            _ if self.end == End::Whole => return None,
            Some(steps) if steps == self.last() => format!(": it has all {last} steps but lacks its end"),
            Some(steps) => format!(" after step {last} of {}", thousands(steps)),
            None => format!(" after step {last}"),
        };
        Some(format!("{path} is cut short{lacks}: the run was killed, or the file is incomplete"))
    }

    /// The checksum of a step, if it has one.
    pub fn checksum(&self, step: u64) -> Option<u64> {
        let index = usize::try_from(step.checked_sub(self.first)?).ok()?;
        self.checksums.get(index).copied()
    }

    /// Differences between the environment of the recording and this one, in words; empty if there are none.
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

impl Found {
    pub fn new(id: &str, application: &str) -> Found {
        Found { id: id.to_owned(), application: application.to_owned(), ..Found::default() }
    }

    /// The name of the scene, or what another program has called it.
    pub fn name(&self) -> &str {
        let of_application = || self.application.strip_prefix(&application("")).unwrap_or(&self.application);
        self.called.as_deref().unwrap_or_else(of_application)
    }

    /// Whether the run has written its end.
    pub fn has_end(&self) -> bool {
        self.texts.contains_key(DIGEST.0)
    }

    /// Reads a chunk of properties, checksums or events; `read` bytes of the file have been read.
    pub fn take(&mut self, chunk: &Chunk, read: u64) -> Result<(), String> {
        let entity = path_of(chunk);
        if PROPERTIES.is(&entity) {
            self.take_properties(chunk, read)?;
        } else if CHECKSUM.is(&entity) {
            self.sums.take(chunk, read)?;
        } else {
            let (contacts, events): (Vec<_>, Vec<_>) =
                events_of(chunk)?.into_iter().partition(RecordedEvent::is_contact);
            self.contacts.extend(contacts);
            self.events.extend(events);
        }
        Ok(())
    }

    /// Reads the properties in a chunk; `read` bytes of the file have been read.
    fn take_properties(&mut self, chunk: &Chunk, read: u64) -> Result<(), String> {
        for property in [SCENE, SETTINGS, OVERRIDES, VERSION, MACHINE, BLESSED, COUNTS, FAILURE, DIGEST] {
            if let Some(text) = cell::<Utf8>(chunk, &property.descriptor(), 0).into_iter().next() {
                let text = text.as_str();
                let limit = LARGEST_TEXT.min(TEXT.0 + TEXT.1 * read) as usize;
                if text.len() > limit {
                    return Err(format!("its {} has {} bytes, over the limit of {limit}", property.0, text.len()));
                }
                self.texts.insert(property.0, text.to_owned());
            }
        }
        self.format =
            cell::<Float64>(chunk, &contract::FORMAT.descriptor(), 0).first().map(|number| number.0).or(self.format);
        Ok(())
    }

    /// Recreates the experiment.
    pub fn into_recorded(self, path: &Path, read: &ReadExperiment<'_>, end: End) -> Result<Recorded, ReadError> {
        let Found { id, application, called, mut texts, format, sums, events, contacts, .. } = self;
        let mut text = |property: Component| texts.remove(property.0);
        let foreign = |what: &str| ReadError::Foreign { path: path.to_owned(), what: what.to_owned() };
        let unsupported = |what: String| ReadError::Unsupported { path: path.to_owned(), what };
        let damaged = |what: String| ReadError::Damaged { path: path.to_owned(), at: None, what };
        let scene_error = |what: String| ReadError::Scene { path: path.to_owned(), what };
        let Some(format) = format else {
            return Err(match (text(SCENE), end) {
                (Some(_), _) => unsupported(
                    "was made before recordings carried checksums, so there is nothing to verify: run its scene again"
                        .to_owned(),
                ),
                (None, End::Cut) => foreign("it ends before its header is complete"),
                (None, End::Whole) if application == Existing::comparison().application => foreign(
                    "it is a comparison, as `diff --save` and `check` make them; use the recordings that it compares",
                ),
                (None, End::Whole) => foreign("it lacks the properties of one"),
            });
        };
        if format != f64::from(FORMAT) {
            let version = text(VERSION).unwrap_or_default();
            return Err(unsupported(format!(
                "has format {format}, made by meldscope {version}, and this program reads format {FORMAT}: use that version"
            )));
        }
        let (Some(scene), Some(settings), Some(version)) = (text(SCENE), text(SETTINGS), text(VERSION)) else {
            return Err(foreign("it has no scene, no settings or no version"));
        };
        // a scene without a name has that of its file, not of this one
        let of_file = || path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let file = called.map_or_else(of_file, |name| format!("{name}.toml"));
        // The id contains a hash of these texts, which reveals any change to them.
        let ending = |id: &str| id.rsplit('-').next().unwrap_or_default().to_owned();
        let is_as_made = ending(&id) == ending(&recording_id("", &scene, &settings, &version));
        let run: toml::Table = settings.parse().unwrap_or_default();
        let cannot_run = |what: String| unsupported(format!("cannot be run here: {what}"));
        let experiment = match read(&file, &scene, &run) {
            Err(Refusal::Source(what)) => return Err(scene_error(what)),
            _ if !is_as_made => return Err(damaged("its scene or settings do not match its id".to_owned())),
            Err(Refusal::Run(what)) => return Err(cannot_run(what)),
            Ok(experiment) => experiment,
        };
        let schema = experiment.schema();
        let settings = Settings::from_toml(&settings, schema.bodies.len()).map_err(cannot_run)?;
        // a run that was killed may not have reached the first step
        if sums.values.is_empty() && end == End::Whole {
            return Err(foreign("it has no checksums"));
        }
        let last = sums.first + (sums.values.len() as u64).saturating_sub(1);
        match (settings.steps, text(DIGEST)) {
            (Some(steps), _) if last > steps => {
                return Err(damaged(format!("it has a checksum of step {last}, but its last step is {steps}")));
            }
            // only a replay can start after step 0, and its end is known
            (None, _) if sums.first > 0 => {
                return Err(damaged(format!("its checksums begin with step {}", sums.first)));
            }
            (_, Some(digest)) => {
                let found = hash::sequence(sums.values.iter().copied());
                if digest != format!("{found:016x}") {
                    return Err(damaged("its checksums do not match its digest".to_owned()));
                }
            }
            (_, None) if end == End::Whole => return Err(damaged("it has an end but no digest".to_owned())),
            (_, None) => {}
        }
        Ok(Recorded {
            path: path.to_owned(),
            id,
            experiment,
            schema,
            run,
            settings,
            overrides: text(OVERRIDES).unwrap_or_default(),
            version,
            machine: text(MACHINE).unwrap_or_else(|| "an unnamed machine".to_owned()),
            blessed: text(BLESSED),
            counts: text(COUNTS),
            failure: text(FAILURE),
            first: sums.first,
            checksums: sums.values,
            events,
            contacts,
            end,
        })
    }
}

/// Starts an experiment; `path` is the file that it came from.
pub(super) fn start(experiment: &dyn Experiment, path: &Path) -> Result<Box<dyn Simulation>, ReadError> {
    experiment.start().map_err(|what| ReadError::Scene { path: path.to_owned(), what })
}

/// The checksums read so far.
#[derive(Clone, Debug, Default)]
struct ReadChecksums {
    first: u64,
    values: Vec<u64>,
}

impl ReadChecksums {
    /// Reads the checksums in a chunk; `read` bytes of the file have been read.
    fn take(&mut self, chunk: &Chunk, read: u64) -> Result<(), String> {
        for row in 0..chunk.num_rows() {
            let step = u64::try_from(step_of(chunk, row)?).map_err(|_| "a checksum of a negative step".to_owned())?;
            let values = numbers::<UInt64Type>(chunk, CHECKSUMS, row).ok_or("a row without checksums")?;
            let first = step.saturating_add(1).checked_sub(values.len() as u64).ok_or("checksums of negative steps")?;
            if self.values.is_empty() {
                self.first = first;
            }
            let next = self.first + self.values.len() as u64;
            if first != next {
                return Err(format!("expected the checksum of step {next}, found that of step {first}"));
            }
            let count = (self.values.len() + values.len()) as u64;
            if count > SPARE + read / CHECKSUM_BYTES {
                return Err(format!("{count} checksums in {read} bytes"));
            }
            self.values.extend(values);
        }
        Ok(())
    }
}

/// The events of a chunk of `/events` or `/events/surfaces`.
fn events_of(chunk: &Chunk) -> Result<Vec<RecordedEvent>, String> {
    let mut events = Vec::new();
    for row in 0..chunk.num_rows() {
        let texts = |component: &ComponentDescriptor| -> Vec<String> {
            cell::<Utf8>(chunk, component, row).iter().map(|text| text.as_str().to_owned()).collect()
        };
        let number =
            |component: Component| cell::<Float64>(chunk, &component.descriptor(), row).first().map(|number| number.0);
        let Some(name) = texts(&TextLog::descriptor_level()).pop() else { continue };
        let phases: [String; 2] = texts(&PHASES.descriptor()).try_into().unwrap_or_default();
        let [a, b] = match texts(&BODIES.descriptor()).try_into() {
            Ok(bodies) => bodies,
            // when surfaces touch, older programs say in words alone
            Err(_) if phases.iter().all(String::is_empty) => continue,
            Err(_) => return Err("an event without a pair".to_owned()),
        };
        events.push(RecordedEvent {
            name,
            pair: format!("{a}~{b}"),
            phases,
            q: number(Q).ok_or("an event without q")?,
            time: number(TIME).ok_or("an event without a time")?,
            step: u64::try_from(step_of(chunk, row)?).map_err(|_| "an event of a negative step".to_owned())?,
        });
    }
    Ok(events)
}

/// The value of the timeline `step` in a row.
pub(super) fn step_of(chunk: &Chunk, row: usize) -> Result<i64, String> {
    let column = chunk.timelines().values().find(|column| column.timeline().name().as_str() == STEP);
    let step = column.and_then(|column| column.times_raw().get(row));
    step.copied().ok_or_else(|| format!("{} has rows without {STEP}", chunk.entity_path()))
}

/// A component of a row as stored in the file.
pub(super) fn raw(chunk: &Chunk, component: &ComponentDescriptor, row: usize) -> Option<ArrayRef> {
    let list = &chunk.components().get(component.component)?.list_array;
    (row < list.len() && !list.is_null(row)).then(|| list.value(row))
}

/// The numbers of a component of a row; `None` if the row has none, or none of that type.
pub(super) fn numbers<T: ArrowPrimitiveType>(
    chunk: &Chunk,
    component: Component,
    row: usize,
) -> Option<Vec<T::Native>> {
    let cell = raw(chunk, &component.descriptor(), row)?;
    Some(cell.as_primitive_opt::<T>()?.values().to_vec())
}

/// A component of a row, decoded by the SDK; empty if the row has none, or none of that type.
pub(super) fn cell<T: Loggable>(chunk: &Chunk, component: &ComponentDescriptor, row: usize) -> Vec<T> {
    raw(chunk, component, row).and_then(|cell| T::from_arrow(&cell).ok()).unwrap_or_default()
}
