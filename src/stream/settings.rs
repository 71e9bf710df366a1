//! What a recording is a function of: the scene, and the settings of the run.

use crate::observe::{Experiment, StepSummary, Want};

/// More bodies than this are batched: the viewer slows down at several hundred entities.
pub(super) const MOST_BODY_ENTITIES: usize = 64;
/// More pairs than this get no plots of their own, unless asked for; their events are logged all the same.
pub const MOST_PAIRS: usize = 16;
/// The same in a scene that is batched: with these it has 60 entities at most, if all its bodies are of one shape.
pub const MOST_PAIRS_OF_MANY: usize = 5;

/// How much is recorded of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Detail {
    /// Surfaces, spheres, pairs, events, timings, diagnostics.
    Surface,
    /// Those, and force arrows by cause, pairs in space, numbers of vertices.
    Forces,
    /// Those, and the inside of these steps.
    Stages {
        /// The first step that is looked into.
        from: u64,
        /// The last one.
        to: u64,
    },
}

impl Detail {
    /// All of them, from the least on; every step is looked into.
    pub const ALL: [Detail; 3] = [Detail::Surface, Detail::Forces, Detail::Stages { from: 0, to: u64::MAX }];

    /// The name on the command line and in recordings.
    pub fn name(self) -> &'static str {
        match self {
            Detail::Surface => "surface",
            Detail::Forces => "forces",
            Detail::Stages { .. } => "stages",
        }
    }
}

/// One entity a body, or all bodies in few.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Entities {
    /// `/world/bodies/NAME` each.
    Body,
    /// `/world/resting/SHAPE` and `/world/deforming`.
    Batch,
}

impl Entities {
    /// Both.
    pub const ALL: [Entities; 2] = [Entities::Body, Entities::Batch];

    /// The name on the command line and in recordings.
    pub fn name(self) -> &'static str {
        match self {
            Entities::Body => "body",
            Entities::Batch => "batch",
        }
    }
}

/// Which frames are recorded. Properties, checksums and events of all steps are, whichever frames (but a thin recording
/// has no events).
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Frames {
    /// All of them.
    All,
    /// None: the scene and checksums, from which the rest can be made again.
    Thin,
    /// A flight recorder: the last `most` until something of `on` happens, or at the end if `on` is empty.
    Last {
        /// How many, ≥ 1.
        most: u64,
        /// What they are written for.
        on: Vec<Trigger>,
    },
}

/// Something that a flight recorder waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trigger {
    /// A pair merges.
    Merge,
    /// A pair splits.
    Split,
    /// A pair enters its core, or leaves it.
    Core,
    /// The state becomes one that no forces can have led to.
    Diverge,
}

impl Trigger {
    /// All of them, in the order in which they are listed to users.
    pub const ALL: [Trigger; 4] = [Trigger::Merge, Trigger::Split, Trigger::Core, Trigger::Diverge];

    /// The name on the command line and in recordings.
    pub fn name(self) -> &'static str {
        match self {
            Trigger::Merge => "merge",
            Trigger::Split => "split",
            Trigger::Core => "core",
            Trigger::Diverge => "diverge",
        }
    }

    /// Whether a step was one of these.
    pub fn is_in(self, summary: &StepSummary) -> bool {
        match self {
            Trigger::Diverge => summary.failure.is_some(),
            _ => summary.events.iter().any(|event| event.name.starts_with(self.name())),
        }
    }
}

/// The version of what is in a recording, beside that of the program: a program reads this one and older ones.
pub const FORMAT: u32 = 1;

/// How a run is recorded: with the scene's text and what its simulation says of itself
/// ([`Schema::run`](crate::observe::Schema::run)), what it takes to make a recording again.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Number of steps to take; `None`: until stopped.
    pub steps: Option<u64>,
    /// A frame is recorded every so many steps, ≥ 1.
    pub every: u64,
    /// How much is recorded of a frame.
    pub detail: Detail,
    /// One entity a body, or all bodies in few.
    pub entities: Entities,
    /// Which frames are recorded.
    pub frames: Frames,
    /// So many pairs at most have plots, lanes and lines of their own.
    pub pairs: usize,
}

impl Settings {
    /// Whether a step is looked into.
    pub fn has_stages(&self, step: u64) -> bool {
        matches!(self.detail, Detail::Stages { from, to } if from <= step && step <= to) && self.frames == Frames::All
    }

    /// Whether there is a frame of a step.
    pub fn has_frame(&self, step: u64) -> bool {
        self.frames != Frames::Thin && step.is_multiple_of(self.every)
    }

    /// What is wanted of a frame.
    pub fn want(&self) -> Want {
        Want { forces: self.detail != Detail::Surface, scalars: true }
    }

    /// The settings that the scene itself asks for, everything recorded.
    pub fn of(scene: &dyn Experiment) -> Settings {
        let schema = scene.schema();
        Settings::for_bodies(schema.bodies.len(), schema.steps)
    }

    /// The same, for so many bodies and steps.
    pub fn for_bodies(bodies: usize, steps: u64) -> Settings {
        let is_crowd = bodies > MOST_BODY_ENTITIES;
        Settings {
            steps: Some(steps),
            every: 1,
            detail: Detail::Forces,
            entities: if is_crowd { Entities::Batch } else { Entities::Body },
            frames: Frames::All,
            pairs: if is_crowd { MOST_PAIRS_OF_MANY } else { MOST_PAIRS },
        }
    }

    /// From the properties of a recording of so many bodies. What only says how it was recorded may be unknown, as it may
    /// be to an older program: it is then as in [`Settings::of`].
    ///
    /// # Errors
    /// What is missing or wrong, in words.
    pub fn from_toml(text: &str, bodies: usize) -> Result<Settings, String> {
        let table = table(text);
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
                    let trigger =
                        |name: &toml::Value| Trigger::ALL.into_iter().find(|on| name.as_str() == Some(on.name()));
                    Frames::Last {
                        most: last.get("last").and_then(number).unwrap_or(1),
                        on: on.filter_map(trigger).collect(),
                    }
                }
                None => Frames::All,
            },
            pairs: count("pairs").map_or(own.pairs, |pairs| pairs.min(1000) as usize),
        })
    }

    /// As TOML, for the recording's properties.
    pub fn to_toml(&self) -> String {
        let (detail, entities) = (self.detail.name(), self.entities.name());
        let stages = match self.detail {
            Detail::Stages { from, to } => format!("stages = [{}, {}]\n", written(from), written(to)),
            Detail::Surface | Detail::Forces => String::new(),
        };
        let frames = match &self.frames {
            Frames::All => String::new(),
            Frames::Thin => "frames = \"thin\"\n".to_owned(),
            Frames::Last { most, on } => {
                let on: Vec<String> = on.iter().map(|trigger| format!("\"{}\"", trigger.name())).collect();
                format!("frames = {{ last = {}, on = [{}] }}\n", written(*most), on.join(", "))
            }
        };
        format!(
            "steps = {}\nevery = {}\ndetail = \"{detail}\"\nentities = \"{entities}\"\npairs = {}\n{stages}{frames}",
            written(self.steps.unwrap_or(0)),
            written(self.every),
            self.pairs,
        )
    }
}

/// A number as TOML has it, whose integers end at 2^63 − 1: as a text from there on.
fn written(number: u64) -> String {
    if i64::try_from(number).is_ok() { number.to_string() } else { format!("\"{number}\"") }
}

/// The number that was [`written`].
fn number(value: &toml::Value) -> Option<u64> {
    match value {
        toml::Value::Integer(number) => u64::try_from(*number).ok(),
        toml::Value::String(text) => text.parse().ok(),
        _ => None,
    }
}

/// What a recording has as its settings, as they may be from before 2^63 and more were texts; empty if they are no TOML.
pub(crate) fn table(text: &str) -> toml::Table {
    within_toml(text).parse().unwrap_or_default()
}

fn within_toml(text: &str) -> String {
    let mut fixed = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(start) = rest.find(|c: char| c.is_ascii_digit()) {
        let (before, from) = rest.split_at(start);
        let (digits, after) = from.split_at(from.find(|c: char| !c.is_ascii_digit()).unwrap_or(from.len()));
        fixed.push_str(before);
        // of the number's own digits only, not of those behind a point or within a text
        let is_alone = !before.ends_with(['.', '"']) && !after.starts_with(['.', '"']);
        let is_large = digits.parse::<u64>().is_ok_and(|number| i64::try_from(number).is_err());
        fixed.push_str(&if is_alone && is_large { format!("\"{digits}\"") } else { digits.to_owned() });
        rest = after;
    }
    fixed + rest
}

/// The same scene and options give the same id; a recording whose texts do not give its id was damaged or edited.
pub(crate) fn recording_id(name: &str, scene: &str, settings: &str, version: &str) -> String {
    format!("{}-{:016x}", file_stem(name), fnv(&format!("{scene}\0{settings}\0{version}")))
}

/// The application id of recordings of a scene. A viewer keeps one layout an application: each scene is one, so that layouts
/// do not replace each other's.
pub(crate) fn application(name: &str) -> String {
    let stem = if name.is_empty() { String::new() } else { file_stem(name) };
    format!("meldscope_{stem}")
}

/// FNV-1a.
fn fnv(text: &str) -> u64 {
    text.bytes()
        .fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3))
}

/// The name of a scene as a file can have it: anything but letters, digits, `-`, `_` and `.` inside becomes `_`, and
/// it is no longer than file systems allow, which count bytes.
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
