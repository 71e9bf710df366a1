//! Recording settings. Together with the scene they determine a recording.

use std::{fmt, str::FromStr};

use crate::{
    observe::{Experiment, PairEvent, Schema, StepSummary, Want},
    text::{did_you_mean, printable},
};

/// Scenes with more bodies than this are batched: the viewer slows down at several hundred entities.
pub(super) const MAX_BODY_ENTITIES: usize = 64;
/// Default limit on the number of pairs with their own plots. Events of all pairs are logged.
pub const MOST_PAIRS: usize = 16;
/// Default limit for batched scenes, which then have at most 110 entities if all bodies have one shape.
pub const MOST_PAIRS_OF_MANY: usize = 5;

/// Level of detail of recorded frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Detail {
    /// Surfaces, spheres, pairs, events, timings and diagnostics.
    Surface,
    /// `Surface`, plus force arrows by cause, and values of single vertices.
    Forces,
    /// `Forces`, plus the stages inside a range of steps.
    Stages {
        /// The first step whose stages are recorded.
        from: u64,
        /// The last step whose stages are recorded.
        to: u64,
    },
}

/// The forms of a [`Detail`] on the command line.
pub const DETAILS: &str = "surface|forces|stages[=FROM..TO]";

/// The form on the command line; `stages` alone covers every step.
impl FromStr for Detail {
    type Err = String;

    fn from_str(text: &str) -> Result<Detail, String> {
        let range = |text: &str| {
            let (from, to) = text.split_once("..")?;
            let (from, to) = (from.parse().ok()?, to.parse().ok()?);
            (from <= to).then_some(Detail::Stages { from, to })
        };
        match text {
            "surface" => Ok(Detail::Surface),
            "forces" => Ok(Detail::Forces),
            "stages" => Ok(Detail::Stages { from: 0, to: u64::MAX }),
            _ => text
                .strip_prefix("stages=")
                .and_then(range)
                .ok_or_else(|| format!("expected {DETAILS}, where FROM and TO are steps, FROM not after TO")),
        }
    }
}

impl fmt::Display for Detail {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Detail::Stages { from, to } if (from, to) != (0, u64::MAX) => write!(f, "stages={from}..{to}"),
            detail => f.write_str(detail.name()),
        }
    }
}

impl Detail {
    /// The name on the command line and in recordings.
    pub fn name(self) -> &'static str {
        match self {
            Detail::Surface => "surface",
            Detail::Forces => "forces",
            Detail::Stages { .. } => "stages",
        }
    }
}

named! {
    /// How bodies are distributed over entities.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum Entities {
        /// Each body has its own entity, `/world/bodies/NAME`.
        Body = "body",
        /// All bodies share `/world/resting/SHAPE` and `/world/deforming/surface`.
        Batch = "batch",
    }
}

/// Selects which frames are recorded. Properties, checksums and events of all steps are recorded in any case.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Frames {
    /// All frames.
    All,
    /// No frames: only the scene, checksums and events, from which everything else can be reproduced.
    Thin,
    /// A flight recorder: the last `most` frames, written when a trigger of `on` fires, or at the end if `on` is empty;
    /// and the `after` frames that follow a trigger.
    Last {
        /// Number of frames kept, ≥ 1.
        most: u64,
        /// Triggers that cause the frames to be written.
        on: Vec<Trigger>,
        /// Number of frames written after a trigger.
        after: u64,
    },
}

/// What makes a flight recorder write its frames.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Trigger {
    /// An event of a pair, by its [word](Schema::event_words).
    Event(String),
    /// The state diverges: the step led to an impossible state.
    Diverge,
}

impl Trigger {
    /// The name of [`Trigger::Diverge`].
    pub const DIVERGE: &str = "diverge";

    /// Parses the name of an event of this simulation, or `diverge`.
    ///
    /// # Errors
    /// It is neither; the error names the known ones.
    pub fn parse(word: &str, schema: &Schema) -> Result<Trigger, String> {
        let known = || schema.event_words().into_iter().chain([Trigger::DIVERGE]);
        if known().any(|known| known == word) {
            return Ok(Trigger::of(word));
        }
        let hint = did_you_mean(word, known());
        Err(format!("no event {:?}{hint} (known: {})", printable(word), known().collect::<Vec<_>>().join(", ")))
    }

    fn of(name: &str) -> Trigger {
        if name == Trigger::DIVERGE { Trigger::Diverge } else { Trigger::Event(name.to_owned()) }
    }

    /// The name on the command line and in recordings.
    pub fn name(&self) -> &str {
        match self {
            Trigger::Event(word) => word,
            Trigger::Diverge => Trigger::DIVERGE,
        }
    }

    /// Whether the trigger fired in a step.
    pub fn is_in(&self, summary: &StepSummary) -> bool {
        match self {
            Trigger::Event(word) => summary.events.iter().any(|event| event.is(word)),
            Trigger::Diverge => summary.failure.is_some(),
        }
    }
}

/// Version of the recording format, independent of the program version. This program reads this version only.
pub const FORMAT: u32 = 1;

/// The recording settings of a run. Together with the text of the scene and the simulation's own settings
/// ([`Schema::run`](crate::observe::Schema::run)), they suffice to reproduce a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Number of steps to take; `None`: until stopped.
    pub steps: Option<u64>,
    /// Interval between frames, in steps, ≥ 1.
    pub every: u64,
    /// Level of detail of frames.
    pub detail: Detail,
    /// How bodies are distributed over entities.
    pub entities: Entities,
    /// Which frames are recorded.
    pub frames: Frames,
    /// Upper limit on the number of pairs with their own plots, lanes and lines.
    pub pairs: usize,
    /// The only pairs with their own plots, lanes and lines, as `A~B` in the order of the scene; empty: any.
    pub only: Vec<String>,
    /// The event at which a file opens; `None`: the first.
    pub around: Option<Around>,
}

/// An event, as a user specifies it: by any of kind, pair and number.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Around {
    /// The kind, by its [word](Schema::event_words); `None`: any.
    pub kind: Option<String>,
    /// The pair, as `A~B` in the order of the scene; `None`: any.
    pub pair: Option<String>,
    /// Number among the events of that kind and pair, from 1.
    pub number: u64,
}

impl Around {
    /// Parses words such as `merge`, `a~b`, `merge a~b` or `split a~b 2`, separated by spaces or colons.
    ///
    /// # Errors
    /// A word is not the kind, pair or number of an event of this scene; the error names the word and the nearest valid
    /// one.
    pub fn parse(text: &str, schema: &Schema) -> Result<Around, String> {
        let kinds = schema.event_words();
        // an example in the words of this simulation
        let example = format!("`{} a~b 2`", kinds.first().unwrap_or(&"event"));
        let (mut around, mut is_numbered) = (Around { number: 1, ..Around::default() }, false);
        let is_named =
            |name: &&str| text.strip_prefix(*name).is_some_and(|rest| rest.is_empty() || rest.starts_with([' ', ':']));
        let names = schema.events.iter().map(|event| event.name).filter(|name| name.contains(' '));
        let full = names.filter(is_named).max_by_key(|name| name.len()).unwrap_or_default();
        around.kind = (!full.is_empty()).then(|| full.to_owned());
        for word in text[full.len()..].split([' ', ':']).filter(|word| !word.is_empty()) {
            if kinds.contains(&word) {
                around.kind = Some(word.to_owned());
            } else if let Ok(number @ 1..) = word.parse() {
                (around.number, is_numbered) = (number, true);
            } else if word.contains('~') {
                around.pair = Some(pair(word, schema)?);
            } else {
                let hint = did_you_mean(word, kinds.iter().copied());
                let (known, word) = (kinds.join(", "), printable(word));
                return Err(format!(
                    "no event {word:?}{hint} (an event is one of {known}, a pair a~b, a number, or these together: {example})"
                ));
            }
        }
        if around.kind.is_none() && around.pair.is_none() && !is_numbered {
            return Err(format!("name an event: its kind, its pair, its number, or these together: {example}"));
        }
        Ok(around)
    }

    /// Whether an event is of this kind and pair.
    pub fn is_kind_of(&self, event: &PairEvent, schema: &Schema) -> bool {
        self.kind.as_ref().is_none_or(|word| event.is(word))
            && self.pair.as_ref().is_none_or(|pair| *pair == schema.pair_name(event.a, event.b))
    }
}

impl fmt::Display for Around {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let is_first = self.number == 1 && (self.kind.is_some() || self.pair.is_some());
        let number = (!is_first).then(|| self.number.to_string());
        let words: Vec<String> = self.kind.clone().into_iter().chain(self.pair.clone()).chain(number).collect();
        f.write_str(&words.join(" "))
    }
}

/// The name of a pair of this scene, `A~B` in the order of its bodies.
///
/// # Errors
/// There is no such pair; the error names the missing body and the nearest known name.
pub fn pair(text: &str, schema: &Schema) -> Result<String, String> {
    let Some((a, b)) = text.split_once('~') else {
        return Err(format!("{:?} is not a pair: give two bodies as a~b", printable(text)));
    };
    let find = |name: &str| {
        schema.body(name).ok_or_else(|| {
            let hint = did_you_mean(name, schema.bodies.iter().map(|body| body.name.as_str()));
            format!("no body {:?}{hint}", printable(name))
        })
    };
    match (find(a)?, find(b)?) {
        (a, b) if a == b => Err(format!("{:?} is a single body: give two as a~b", printable(text))),
        (a, b) => Ok(schema.pair_name(a.min(b), a.max(b))),
    }
}

impl Settings {
    /// Whether the stages inside a step are recorded.
    pub fn has_stages(&self, step: u64) -> bool {
        matches!(self.detail, Detail::Stages { from, to } if from <= step && step <= to) && self.frames == Frames::All
    }

    /// Whether a step has a frame.
    pub fn has_frame(&self, step: u64) -> bool {
        self.frames != Frames::Thin && step.is_multiple_of(self.every)
    }

    /// The contents that a frame needs.
    pub fn want(&self) -> Want {
        Want { forces: self.detail != Detail::Surface, scalars: true }
    }

    /// The default settings of a scene: everything is recorded.
    pub fn of(scene: &dyn Experiment) -> Settings {
        let schema = scene.schema();
        Settings::for_schema(&schema)
    }

    /// The default settings of a run with this schema.
    pub fn for_schema(schema: &Schema) -> Settings {
        let own = Settings::for_bodies(schema.bodies.len(), schema.steps);
        // as many in each variant of a scene
        Settings { pairs: own.pairs * schema.variants.len().max(1), ..own }
    }

    fn for_bodies(bodies: usize, steps: u64) -> Settings {
        let is_crowd = bodies > MAX_BODY_ENTITIES;
        Settings {
            steps: Some(steps),
            every: 1,
            detail: Detail::Forces,
            entities: if is_crowd { Entities::Batch } else { Entities::Body },
            frames: Frames::All,
            pairs: if is_crowd { MOST_PAIRS_OF_MANY } else { MOST_PAIRS },
            only: Vec::new(),
            around: None,
        }
    }

    /// Parses the settings in the properties of a recording with this many bodies. Values that only describe how it
    /// was recorded may be unknown, because a newer program may have added them: they are replaced by the defaults of
    /// [`Settings::of`].
    ///
    /// # Errors
    /// Describes what is missing or invalid.
    pub fn from_toml(text: &str, bodies: usize) -> Result<Settings, String> {
        let table: toml::Table = text.parse().unwrap_or_default();
        let text = |key: &str| table.get(key).and_then(toml::Value::as_str);
        let count = |key: &str| table.get(key).and_then(number);
        let steps = count("steps").ok_or("the settings have no usable number of steps")?;
        let own = Settings::for_bodies(bodies, steps);
        Ok(Settings {
            steps: (steps > 0).then_some(steps),
            every: count("every").filter(|&every| every > 0).unwrap_or(own.every),
            detail: match (text("detail"), table.get("stages").and_then(toml::Value::as_array).map(Vec::as_slice)) {
                (Some("surface"), _) => Detail::Surface,
                (Some("stages"), Some([from, to])) => {
                    Detail::Stages { from: number(from).unwrap_or(0), to: number(to).unwrap_or(u64::MAX) }
                }
                _ => own.detail,
            },
            entities: text("entities")
                .and_then(|name| Entities::ALL.into_iter().find(|entities| entities.name() == name))
                .unwrap_or(own.entities),
            frames: match table.get("frames") {
                Some(toml::Value::String(_)) => Frames::Thin,
                Some(last) => {
                    let on = last.get("on").and_then(toml::Value::as_array).into_iter().flatten();
                    let trigger = |name: &toml::Value| name.as_str().map(Trigger::of);
                    Frames::Last {
                        most: last.get("last").and_then(number).unwrap_or(1),
                        on: on.filter_map(trigger).collect(),
                        after: last.get("after").and_then(number).unwrap_or(0),
                    }
                }
                None => Frames::All,
            },
            pairs: count("pairs").map_or(own.pairs, |pairs| pairs.min(1000) as usize),
            only: {
                let only = table.get("only").and_then(toml::Value::as_array).into_iter().flatten();
                only.filter_map(|pair| pair.as_str().map(str::to_owned)).collect()
            },
            around: table.get("around").and_then(toml::Value::as_table).map(|around| {
                let text = |key: &str| around.get(key).and_then(toml::Value::as_str);
                Around {
                    kind: text("kind").map(str::to_owned),
                    pair: text("pair").map(str::to_owned),
                    number: around.get("number").and_then(number).unwrap_or(1).max(1),
                }
            }),
        })
    }

    /// The settings as TOML, for the recording's properties.
    pub fn to_toml(&self) -> String {
        let (detail, entities) = (self.detail.name(), self.entities.name());
        let stages = match self.detail {
            Detail::Stages { from, to } => format!("stages = [{}, {}]\n", written(from), written(to)),
            Detail::Surface | Detail::Forces => String::new(),
        };
        let frames = match &self.frames {
            Frames::All => String::new(),
            Frames::Thin => "frames = \"thin\"\n".to_owned(),
            Frames::Last { most, on, after } => {
                let on: Vec<String> = on.iter().map(|trigger| quoted(trigger.name())).collect();
                let after = if *after > 0 { format!(", after = {}", written(*after)) } else { String::new() };
                format!("frames = {{ last = {}, on = [{}]{after} }}\n", written(*most), on.join(", "))
            }
        };
        let only: Vec<String> = self.only.iter().map(|pair| quoted(pair)).collect();
        let only = if only.is_empty() { only.concat() } else { format!("only = [{}]\n", only.join(", ")) };
        let around = self.around.as_ref().map_or(String::new(), |Around { kind, pair, number }| {
            let kind = kind.as_ref().map_or(String::new(), |kind| format!("kind = {}, ", quoted(kind)));
            let pair = pair.as_ref().map_or(String::new(), |pair| format!("pair = {}, ", quoted(pair)));
            format!("around = {{ {kind}{pair}number = {} }}\n", written(*number))
        });
        format!(
            "steps = {}\nevery = {}\ndetail = \"{detail}\"\nentities = \"{entities}\"\npairs = {}\n{stages}{frames}{only}{around}",
            written(self.steps.unwrap_or(0)),
            written(self.every),
            self.pairs,
        )
    }
}

/// A text as TOML.
fn quoted(text: &str) -> String {
    toml::Value::from(text).to_string()
}

/// A number as TOML. TOML integers are limited to 2^63 − 1; larger numbers are written as strings.
fn written(number: u64) -> String {
    if i64::try_from(number).is_ok() { number.to_string() } else { format!("\"{number}\"") }
}

/// Parses a number from [`written`].
fn number(value: &toml::Value) -> Option<u64> {
    match value {
        toml::Value::Integer(number) => u64::try_from(*number).ok(),
        toml::Value::String(text) => text.parse().ok(),
        _ => None,
    }
}

/// Equal scenes and options give equal ids; if the id does not match its texts, the recording was damaged or edited.
pub(crate) fn recording_id(name: &str, scene: &str, settings: &str, version: &str) -> String {
    format!("{}-{:016x}", file_stem(name), fnv(&format!("{scene}\0{settings}\0{version}")))
}

/// The application id for recordings of a scene. A viewer keeps one layout per application; with one application per
/// scene, layouts do not replace each other. The SDK allows fewer characters than a [file_stem].
pub(crate) fn application(name: &str) -> String {
    let stem = if name.is_empty() { String::new() } else { file_stem(name) };
    let plain = |c: char| if c.is_ascii_alphanumeric() || "-_".contains(c) { c } else { '_' };
    format!("meldscope_{}", stem.chars().map(plain).collect::<String>())
}

/// The 64-bit FNV-1a hash of a text.
fn fnv(text: &str) -> u64 {
    text.bytes()
        .fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3))
}

/// The name of a scene as a file name: replaces every character but letters, digits, `-`, `_` and `.` with `_`, removes
/// leading `.` and `-`, and truncates it to 100 bytes, well below the limit of file systems.
pub fn file_stem(name: &str) -> String {
    let plain = |c: char| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '_' };
    let mut bytes = 0;
    let fits = |c: &char| {
        bytes += c.len_utf8();
        bytes <= 100
    };
    let stem: String = name.chars().map(plain).take_while(fits).collect();
    let stem = stem.trim_start_matches(['.', '-']);
    if stem.is_empty() { "scene".to_owned() } else { stem.to_owned() }
}
