//! What a new recording would replace.
//!
//! [`Sinks`](crate::stream::sinks::Sinks) replace recordings only; here is which ones: golden recordings are made anew by
//! `check --bless` alone, those of other programs not at all, and of what is another scene or kind it is said.

use std::fmt;
use std::path::Path;

use rerun::datatypes::Utf8;

use super::{
    read::Reader,
    recorded::{PROPERTIES, cell},
};
use crate::stream::{
    settings::{Frames, Settings, application},
    sinks::SinkError,
};

/// What a file is of is at its beginning [bytes].
const HEAD: u64 = 4 << 20;
/// Every application id of this program begins with it.
const OURS: &str = "meldscope";
/// Where the reasons for golden recordings are, beside them.
pub const REASONS: &str = "BLESSED.md";

/// What a recording is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// What a scene should give.
    Golden,
    /// Checksums only.
    Thin,
    /// The last frames of a run.
    Last,
    /// All frames of a run.
    Run,
    /// Two runs side by side.
    Comparison,
}

impl Kind {
    /// Of a run with these settings.
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

/// The recording in a file, as far as its beginning says it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Existing {
    /// The application id.
    pub application: String,
    /// `None` if it is not known, or of another program.
    pub kind: Option<Kind>,
}

impl Existing {
    /// Whether a file begins as recordings do.
    pub fn is_recording(path: &Path) -> bool {
        path.is_file() && Reader::open(path).is_ok()
    }

    /// `None` if there is no recording that can be read.
    pub fn at(path: &Path) -> Option<Existing> {
        if !std::fs::metadata(path).is_ok_and(|there| there.is_file()) {
            return None;
        }
        let mut reader = Reader::open(path).ok()?;
        reader.stop_after(HEAD);
        let mut kind = None;
        while let Ok(Some(chunk)) = reader.next(|entity| entity == PROPERTIES) {
            let text = |name| cell::<Utf8>(&chunk, name, 0).into_iter().next();
            if let Some(settings) = text("settings") {
                let frames = settings.as_str().lines().find_map(|line| line.strip_prefix("frames = "));
                kind = Some(match frames {
                    None => Kind::Run,
                    Some("\"thin\"") => Kind::Thin,
                    Some(_) => Kind::Last,
                });
            }
            if text("blessed").is_some() {
                kind = Some(Kind::Golden);
            }
            if matches!(kind, Some(Kind::Golden | Kind::Last | Kind::Run)) {
                break;
            }
        }
        let application = reader.application()?.to_owned();
        if application == Existing::comparison().application {
            kind = kind.or(Some(Kind::Comparison)); // a scene may have that name, too
        }
        Some(Existing { application, kind })
    }

    /// What [`super::comparison`] makes.
    pub fn comparison() -> Existing {
        Existing { application: application("difference"), kind: Some(Kind::Comparison) }
    }

    fn is_ours(&self) -> bool {
        self.application.starts_with(OURS)
    }
}

/// Whether a recording of this kind may replace what is at `path`; what to say about it beforehand, if that is something
/// else than what comes.
///
/// # Errors
/// It is a golden recording (and the new one is none), or one of another program.
pub fn replace(path: &Path, new: &Existing) -> Result<Option<String>, SinkError> {
    let taken = |what: String| SinkError::Taken { path: path.to_owned(), what };
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
        return Err(taken(
            "it is a golden recording, which `meldscope check --bless REASON` alone makes anew; save under another name"
                .to_owned(),
        ));
    }
    let Some(there) = there.filter(|there| there != new) else { return Ok(None) };
    let kind = there.kind.map_or("a recording".to_owned(), |kind| kind.to_string());
    let scene = match there.application.strip_prefix(&application("")) {
        Some(scene) if there.kind != Some(Kind::Comparison) => format!(" of the scene \"{scene}\""),
        _ => String::new(),
    };
    Ok(Some(format!("{} is replaced, {kind}{scene}", path.display())))
}

/// Whether `check` takes this file for a golden one, whatever is in it: it is beside its scene, where reasons are kept.
fn is_checked(path: &Path) -> bool {
    let path = std::fs::canonicalize(path).unwrap_or_default();
    let is_recording = path.extension().is_some_and(|extension| extension == "rrd") && path.is_file();
    is_recording && path.with_extension("toml").is_file() && path.with_file_name(REASONS).is_file()
}
