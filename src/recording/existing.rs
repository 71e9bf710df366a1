//! Protection of existing recordings from being overwritten.
//!
//! [`Sinks`](crate::stream::sinks::Sinks) overwrite recordings only; this module decides which ones. Only
//! `check --bless` replaces golden recordings. Recordings of other programs are never replaced. If a recording of
//! another scene or kind is replaced, the user is notified.

use std::fmt;
use std::path::Path;

use super::{contents::file_and_name, read::Reader, recorded::cell};
use crate::sdk::datatypes::Utf8;
use crate::stream::{
    contract::{BLESSED, Component, PROPERTIES, SETTINGS},
    settings::{Frames, Settings, application},
    sinks::SinkError,
};
use crate::text;

/// Length of the beginning of a file, which determines the kind of a recording [bytes].
const HEAD: u64 = 4 << 20;
/// Prefix of all application ids of this program.
const OURS: &str = "meldscope";
/// Name of the file next to golden recordings that lists the reasons for them.
pub const REASONS: &str = "BLESSED.md";

/// The kind of a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// The expected results of a scene.
    Golden,
    /// The scene, its checksums and events only, without frames.
    Thin,
    /// The last frames of a run.
    Last,
    /// All frames of a run.
    Run,
    /// A comparison of two runs.
    Comparison,
}

impl Kind {
    /// The kind of a run with these settings.
    pub fn of(settings: &Settings) -> Kind {
        match settings.frames {
            Frames::All => Kind::Run,
            Frames::Thin => Kind::Thin,
            Frames::Last { .. } => Kind::Last,
        }
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Kind::Golden => "a golden recording",
            Kind::Thin => "a thin recording",
            Kind::Last => "a recording of the last frames",
            Kind::Run => "a recording",
            Kind::Comparison => "a comparison of two recordings",
        })
    }
}

/// The recording in an existing file, identified by the beginning of the file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Existing {
    /// Its application id.
    pub application: String,
    /// Its kind; `None` if unknown, or if another program made the recording.
    pub kind: Option<Kind>,
}

impl Existing {
    /// Whether a file begins like a recording, or has the name of one, which may be damaged.
    pub fn is_recording(path: &Path) -> bool {
        let (file, _) = file_and_name(path);
        let is_named = file.extension().is_some_and(|extension| extension == "rrd");
        file.is_file() && (is_named || Reader::open(file).is_ok())
    }

    /// The recording at `path`; `None` if there is no readable one.
    pub fn at(path: &Path) -> Option<Existing> {
        if !std::fs::metadata(path).is_ok_and(|there| there.is_file()) {
            return None;
        }
        let mut reader = Reader::open(path).ok()?;
        reader.stop_after(HEAD);
        let mut kind = None;
        while let Ok(Some(chunk)) = reader.next(|entity| PROPERTIES.is(entity)) {
            // a file with several recordings counts as its first
            if let Some(id) = reader.id().map(str::to_owned) {
                reader.read_only(&id);
            }
            let text = |property: Component| cell::<Utf8>(&chunk, &property.descriptor(), 0).into_iter().next();
            if let Some(settings) = text(SETTINGS) {
                let frames = settings.as_str().lines().find_map(|line| line.strip_prefix("frames = "));
                kind = Some(match frames {
                    None => Kind::Run,
                    Some("\"thin\"") => Kind::Thin,
                    Some(_) => Kind::Last,
                });
            }
            if text(BLESSED).is_some() {
                kind = Some(Kind::Golden);
            }
            if matches!(kind, Some(Kind::Golden | Kind::Last | Kind::Run)) {
                break;
            }
        }
        let application = reader.application()?.to_owned();
        if application == Existing::comparison().application {
            kind = kind.or(Some(Kind::Comparison)); // a scene may have that name too
        }
        Some(Existing { application, kind })
    }

    /// A recording made by [`super::comparison`].
    pub fn comparison() -> Existing {
        Existing { application: application("difference"), kind: Some(Kind::Comparison) }
    }

    fn is_ours(&self) -> bool {
        self.application.starts_with(OURS)
    }
}

/// Checks whether a recording of this kind may replace the file at `path`. Returns a note for the user if the file is a
/// recording of another scene or kind.
///
/// # Errors
/// The file is a golden recording and the new one is not, or it was recorded by another program.
pub fn replace(path: &Path, new: &Existing) -> Result<Option<String>, SinkError> {
    let taken = |what: String| SinkError::taken(path, &what);
    let there = Existing::at(path);
    if let Some(there) = &there
        && !there.is_ours()
    {
        let application = &there.application;
        return Err(taken(format!(
            "it is a recording of \"{application}\", not of this program; save under another name or remove it first"
        )));
    }
    let is_golden = there.as_ref().is_some_and(|there| there.kind == Some(Kind::Golden)) || is_checked(path);
    if is_golden && new.kind != Some(Kind::Golden) {
        return Err(taken(format!(
            "it is a golden recording, which only `{} check --bless REASON` replaces; save under another name",
            text::program()
        )));
    }
    let Some(there) = there.filter(|there| there != new) else { return Ok(None) };
    let kind = there.kind.map_or("a recording".to_owned(), |kind| kind.to_string());
    let scene = match there.application.strip_prefix(&application("")) {
        Some(scene) if there.kind != Some(Kind::Comparison) => format!(" of the scene \"{scene}\""),
        _ => String::new(),
    };
    Ok(Some(format!("{} is replaced, {kind}{scene}", path.display())))
}

/// Whether `check` treats this file as a golden recording, whatever its contents: it is next to its scene, in a folder
/// with [`REASONS`].
fn is_checked(path: &Path) -> bool {
    let path = std::fs::canonicalize(path).unwrap_or_default();
    let is_recording = path.extension().is_some_and(|extension| extension == "rrd") && path.is_file();
    is_recording && path.with_extension("toml").is_file() && path.with_file_name(REASONS).is_file()
}
