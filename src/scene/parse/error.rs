//! Errors in scene files: what is wrong, where, and how to fix it.

use std::fmt;

use crate::text::printable;

/// A rejected scene file: the position, the key, what was expected and what was found.
///
/// Displays on one line: `two.toml:12:12: influence.split_at: expected …, found 0.9`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SceneError {
    /// Name of the file, as given.
    pub file: String,
    /// Position in the file; `None` if the error concerns the whole file (it cannot be read, it is too large).
    pub place: Option<Place>,
    /// The key as a dotted path (`influence.split_at`, `body["b"].radius`, `push[0].start`); empty if the error
    /// concerns no key.
    pub key: String,
    /// What was expected and what was found.
    pub message: String,
    /// How to fix it, if there is a hint.
    pub help: Option<String>,
}

/// A position in a text; lines and columns count from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Place {
    /// Line number.
    pub line: u32,
    /// Column, in characters; a byte order mark does not count.
    pub column: u32,
}

impl SceneError {
    /// An error that concerns the whole file.
    pub(crate) fn plain(file: &str, message: String) -> SceneError {
        SceneError { file: file.to_owned(), place: None, key: String::new(), message, help: None }
    }

    /// Line of the error, from 1.
    pub fn line(&self) -> Option<u32> {
        self.place.map(|place| place.line)
    }

    /// Column of the error in its line, in characters, from 1.
    pub fn column(&self) -> Option<u32> {
        self.place.map(|place| place.column)
    }

    /// The same error with a hint on how to fix it.
    pub(crate) fn with_help(self, help: impl Into<String>) -> SceneError {
        SceneError { help: Some(help.into()), ..self }
    }
}

impl std::error::Error for SceneError {}

impl fmt::Display for SceneError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(Place { line, column }) = self.place {
            write!(f, "{}:{line}:{column}: ", one_line(&self.file))?;
        }
        if !self.key.is_empty() {
            write!(f, "{}: ", self.key)?;
        }
        f.write_str(&self.message)?;
        match &self.help {
            Some(help) => write!(f, "; {help}"),
            None => Ok(()),
        }
    }
}

impl Place {
    /// The position of the byte `offset` of `text`.
    pub(in crate::scene) fn of(text: &str, offset: usize) -> Place {
        let before = &text[..text.floor_char_boundary(offset)];
        let line_start = before.rfind('\n').map_or(0, |newline| newline + 1);
        let count = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
        Place {
            line: count(before.matches('\n').count()).saturating_add(1),
            column: count(before[line_start..].trim_start_matches('\u{feff}').chars().count()).saturating_add(1),
        }
    }
}

/// Largest number of characters of the file that a message quotes.
const QUOTED: usize = 40;

/// The beginning of `text`, without characters that could break a line or a terminal.
pub(super) fn clip(text: &str) -> String {
    // escape_debug also escapes invisible characters and those that change the text direction; apostrophes are harmless
    let escape = |c: char| if c == '\'' { c.to_string() } else { c.escape_debug().to_string() };
    let mut clipped: String = text.chars().take(QUOTED).map(escape).collect();
    if text.chars().nth(QUOTED).is_some() {
        clipped.push('…');
    }
    clipped
}

/// `text` with its control characters escaped.
pub(super) fn one_line(text: &str) -> String {
    printable(text).into_owned()
}
