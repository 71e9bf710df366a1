//! A typed view of a TOML document that keeps the source position and dotted path of every value.
//!
//! serde could fill the structs, but its messages name a type where a user needs the key's range, and it loses the
//! positions needed to report two values that are inconsistent.

use std::{fmt, ops::Range};

use glam::DVec3;
use toml::de::{DeTable, DeValue};

use super::error::{Place, SceneError, clip, one_line};
use crate::text::did_you_mean;

/// The text of a scene file and its name.
pub(crate) struct Source<'a> {
    pub text: &'a str,
    pub file: &'a str,
}

impl<'a> Source<'a> {
    /// Parses the text into a tree of tables.
    ///
    /// # Errors
    /// The text is not TOML.
    pub fn document(&self) -> Result<DeTable<'a>, SceneError> {
        DeTable::parse(self.text).map(|document| document.into_inner()).map_err(|error| self.syntax_error(&error))
    }

    fn syntax_error(&self, error: &toml::de::Error) -> SceneError {
        // the parser ends some messages like this where something should be removed
        let message = one_line(error.message().trim_end_matches(", expected nothing"));
        let Some(span) = error.span() else {
            let message = format!("\"{}\" is not valid TOML: {message}", one_line(self.file));
            return SceneError { file: self.file.to_owned(), place: None, key: String::new(), message, help: None };
        };
        let mut message = format!("not valid TOML: {message}");
        match self.text.get(span.clone()) {
            Some("") if span.start == self.text.len() => message.push_str(", found the end of the file"),
            None | Some("" | "\n" | "\r\n") => {}
            Some(found) => message.push_str(&format!(", found \"{}\"", clip(found))),
        }
        // there is no tree to look up the key, but its name usually starts the line
        let line = self.text[..self.text.floor_char_boundary(span.start)].rfind('\n').map_or(0, |newline| newline + 1);
        let key =
            self.text[line..].lines().next().and_then(|line| line.split_once('=')).map_or("", |(key, _)| key.trim());
        let is_key = key.bytes().all(|byte| is_bare(byte) || byte == b'.');
        let place = Some(Place::of(self.text, span.start));
        let key = if is_key { clip(key) } else { String::new() };
        SceneError { file: self.file.to_owned(), place, key, message, help: None }
    }

    fn error(&self, offset: usize, key: &Key<'_>, message: String) -> SceneError {
        let place = Some(Place::of(self.text, offset));
        SceneError { file: self.file.to_owned(), place, key: key.to_string(), message, help: None }
    }
}

/// The dotted path of a value, as a linked list from the value outwards; formatted only for errors.
#[derive(Clone, Copy)]
enum Key<'a> {
    File,
    Field(&'a Key<'a>, &'a str),
    Item(&'a Key<'a>, usize),
    /// A named item of an array of tables.
    Named(&'a Key<'a>, &'a str),
}

impl fmt::Display for Key<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Key::File => Ok(()),
            Key::Field(parent, field) => {
                write!(f, "{parent}{}", if matches!(parent, Key::File) { "" } else { "." })?;
                let bare = !field.is_empty() && field.bytes().all(is_bare);
                if bare { f.write_str(&clip(field)) } else { write!(f, "\"{}\"", clip(field)) }
            }
            Key::Item(parent, index) => write!(f, "{parent}[{index}]"),
            Key::Named(parent, name) => write!(f, "{parent}[\"{name}\"]"),
        }
    }
}

/// Whether `byte` may appear in a TOML key without quotes, and in the name of a body.
fn is_bare(byte: u8) -> bool {
    byte.is_ascii_alphanumeric() || matches!(byte, b'-' | b'_')
}

/// Whether `name` is valid for a body: 1 to 64 letters, digits, `-` and `_`.
pub(crate) fn is_body_name(name: &str) -> bool {
    (1..=64).contains(&name.len()) && name.bytes().all(is_bare)
}

/// The keys that a table accepts.
pub(crate) struct Keys {
    /// Where these keys belong, as the text after "belongs".
    pub home: &'static str,
    /// Description of the table, as the text after "expected".
    pub form: &'static str,
    /// Names of the keys, in the order in which they are listed to users.
    pub names: &'static [&'static str],
}

/// A table whose keys are all known. A missing table reads like an empty one.
pub(crate) struct Table<'a> {
    source: &'a Source<'a>,
    key: Key<'a>,
    /// Position of its header, or of the whole table if it is inline.
    span: Range<usize>,
    entries: Option<&'a DeTable<'a>>,
}

impl<'a> Table<'a> {
    /// The root table of a file.
    ///
    /// # Errors
    /// There is an unknown key.
    pub fn root(source: &'a Source<'a>, document: &'a DeTable<'a>, known: &Keys) -> Result<Table<'a>, SceneError> {
        Table { source, key: Key::File, span: 0..0, entries: Some(document) }.known(known)
    }

    /// Unknown keys are reported before anything else: an unknown key is usually misspelled or misplaced, and its
    /// message is more helpful than the one that the intended key is missing.
    fn known(self, known: &Keys) -> Result<Table<'a>, SceneError> {
        let unknown = self.entries.iter().flat_map(|entries| entries.keys());
        let unknown = unknown.filter(|key| !known.names.contains(&key.get_ref().as_ref()));
        // the tree is sorted by name
        let Some(key) = unknown.min_by_key(|key| key.span().start) else { return Ok(self) };
        let name = key.get_ref().as_ref();
        let homes: Vec<&str> =
            super::all_keys().filter(|keys| keys.names.contains(&name)).map(|keys| keys.home).collect();
        let hint = if !homes.is_empty() {
            format!("; \"{name}\" belongs {}", homes.join(" or "))
        } else {
            did_you_mean(name, known.names.iter().copied())
        };
        let message = format!("unknown key{hint} (known keys: {})", known.names.join(", "));
        Err(self.source.error(key.span().start, &Key::Field(&self.key, name), message))
    }

    /// The value of `name`, if present.
    pub fn get(&self, name: &'static str) -> Option<Value<'_>> {
        let value = self.entries?.get(name)?;
        Some(Value {
            source: self.source,
            key: Key::Field(&self.key, name),
            span: value.span(),
            value: value.get_ref(),
        })
    }

    /// The value of `name` as a `kind`, if present.
    ///
    /// # Errors
    /// The value is not a `kind`.
    pub fn optional<K: Kind>(&self, name: &'static str, kind: K) -> Result<Option<K::Read>, SceneError> {
        self.get(name).map(|value| kind.read(&value)).transpose()
    }

    /// The value of `name` as a `kind`.
    ///
    /// # Errors
    /// The value is missing, or is not a `kind`.
    pub fn required<K: Kind>(&self, name: &'static str, kind: K) -> Result<K::Read, SceneError> {
        kind.read(&self.present(name, &kind.expected())?)
    }

    /// The value of `name`.
    ///
    /// # Errors
    /// The value is missing; `expected` describes it in the message.
    pub fn present(&self, name: &'static str, expected: &str) -> Result<Value<'_>, SceneError> {
        self.get(name).ok_or_else(|| {
            let message = format!("missing, expected {expected}");
            self.source.error(self.span.start, &Key::Field(&self.key, name), message)
        })
    }

    /// An error at the value of `name`, or at the table if that is missing.
    pub fn error(&self, name: &'static str, message: String) -> SceneError {
        let offset = self.get(name).map_or(self.span.start, |value| value.span.start);
        self.source.error(offset, &Key::Field(&self.key, name), message)
    }

    /// Line of the table, from 1.
    pub fn line(&self) -> u32 {
        Place::of(self.source.text, self.span.start).line
    }

    /// The table `name`; empty if it is missing.
    ///
    /// # Errors
    /// The value is not a table, or has an unknown key.
    pub fn table(&self, name: &'static str, known: &Keys) -> Result<Table<'_>, SceneError> {
        match self.get(name) {
            Some(value) => value.into_table(known),
            None => Ok(Table {
                source: self.source,
                key: Key::Field(&self.key, name),
                span: self.span.clone(),
                entries: None,
            }),
        }
    }
}

/// A value with its path and its position in the file.
#[derive(Clone)]
pub(crate) struct Value<'a> {
    source: &'a Source<'a>,
    key: Key<'a>,
    span: Range<usize>,
    value: &'a DeValue<'a>,
}

impl<'a> Value<'a> {
    /// An error at this value's position.
    pub fn error(&self, message: String) -> SceneError {
        self.source.error(self.span.start, &self.key, message)
    }

    /// The error that this value is not what was `expected`.
    pub fn unexpected(&self, expected: impl fmt::Display) -> SceneError {
        self.error(format!("expected {expected}, found {}", self.found()))
    }

    /// This value as quoted in messages.
    pub fn found(&self) -> String {
        let written = || self.source.text.get(self.span.clone()).unwrap_or_default();
        let as_written = || clip(written());
        // a sweep may have put another number in the place of what is written there
        let as_number = |number: &str| {
            let parsed = |text: &str| text.replace('_', "").parse::<f64>().map(f64::to_bits);
            if parsed(written()) == parsed(number) { as_written() } else { clip(number) }
        };
        match self.value {
            DeValue::String(text) => format!("the string \"{}\"", clip(text)),
            DeValue::Float(number) => as_number(number.as_str()),
            DeValue::Integer(number) if number.radix() == 10 => as_number(number.as_str()),
            DeValue::Integer(_) | DeValue::Boolean(_) => as_written(),
            DeValue::Datetime(_) => format!("the date-time {}", as_written()),
            DeValue::Array(items) => match items.len() {
                0 => "an empty array".to_owned(),
                1 => "an array of 1 value".to_owned(),
                n => format!("an array of {n} values"),
            },
            DeValue::Table(_) => "a table".to_owned(),
        }
    }

    /// Whether this value is a table.
    pub fn is_table(&self) -> bool {
        self.value.is_table()
    }

    /// The string, if this value is one.
    pub fn text(&self) -> Option<&'a str> {
        self.value.as_str()
    }

    /// Line of this value, from 1.
    pub fn line(&self) -> u32 {
        Place::of(self.source.text, self.span.start).line
    }

    /// The items of this value, if it is an array.
    pub fn items(&self) -> Option<impl ExactSizeIterator<Item = Value<'_>>> {
        let items = self.value.as_array()?;
        Some(items.iter().enumerate().map(|(index, item)| Value {
            source: self.source,
            key: Key::Item(&self.key, index),
            span: item.span(),
            value: item.get_ref(),
        }))
    }

    /// This value as a table.
    ///
    /// # Errors
    /// The value is not a table, or has an unknown key.
    pub fn into_table(self, known: &Keys) -> Result<Table<'a>, SceneError> {
        let entries = self.value.as_table().ok_or_else(|| self.unexpected(known.form))?;
        Table { source: self.source, key: self.key, span: self.span, entries: Some(entries) }.known(known)
    }

    /// This value as an array of tables, each identified by its name if that is valid, otherwise by its index.
    ///
    /// # Errors
    /// The value is not an array of tables, or one of them has an unknown key.
    pub fn tables(&self, known: &Keys) -> Result<Vec<Table<'_>>, SceneError> {
        let items = self
            .items()
            .ok_or_else(|| self.unexpected(format_args!("an array of tables, each written [[{}]]", self.key)))?;
        items
            .map(|item| {
                let name = item.value.get("name").and_then(|name| name.get_ref().as_str());
                match name.filter(|name| is_body_name(name)) {
                    Some(name) => Value { key: Key::Named(&self.key, name), ..item }.into_table(known),
                    None => item.into_table(known),
                }
            })
            .collect()
    }

    /// This value as an array of exactly `N` numbers; `expected` describes it.
    ///
    /// # Errors
    /// The value is not such an array.
    pub fn numbers<const N: usize>(&self, number: Number, expected: &str) -> Result<[f64; N], SceneError> {
        let items = self.items().filter(|items| items.len() == N).ok_or_else(|| self.unexpected(expected))?;
        let mut numbers = [0.0; N];
        for (slot, item) in numbers.iter_mut().zip(items) {
            *slot = number.read(&item)?;
        }
        Ok(numbers)
    }
}

/// A kind of value, with its constraints.
pub(crate) trait Kind {
    /// The type that it is read into.
    type Read;

    /// Description of the kind, as the text after "expected".
    fn expected(&self) -> String;

    /// # Errors
    /// The value is not of this kind.
    fn read(&self, value: &Value<'_>) -> Result<Self::Read, SceneError>;
}

/// A finite number within a closed range. TOML integers are accepted.
#[derive(Clone, Copy)]
pub(crate) struct Number {
    pub min: f64,
    pub max: f64,
}

impl Kind for Number {
    type Read = f64;

    fn expected(&self) -> String {
        match self {
            Number { max: f64::MAX, .. } => "a finite number".to_owned(),
            // in scientific notation: 1e15, not 1000000000000000
            Number { min, max } => {
                let short = |x: f64| if x == 0.0 { "0".to_owned() } else { format!("{x:e}") };
                format!("a number between {} and {}", short(*min), short(*max))
            }
        }
    }

    fn read(&self, value: &Value<'_>) -> Result<f64, SceneError> {
        let number = match value.value {
            DeValue::Float(float) => float.as_str().parse().ok(),
            // as a float, because a TOML integer may exceed any integer type
            DeValue::Integer(integer) if integer.radix() == 10 => integer.as_str().parse().ok(),
            DeValue::Integer(integer) => u128::from_str_radix(integer.as_str(), integer.radix()).ok().map(|n| n as f64),
            _ => None,
        };
        match number {
            Some(number) if (self.min..=self.max).contains(&number) => Ok(number + 0.0), // −0 is 0
            _ => Err(unquoted(value, value.unexpected(self.expected()))),
        }
    }
}

/// An integer within a closed range.
#[derive(Clone, Copy)]
pub(crate) struct Integer {
    pub min: u32,
    pub max: u32,
}

impl Kind for Integer {
    type Read = u32;

    fn expected(&self) -> String {
        format!("an integer from {} to {}", self.min, self.max)
    }

    fn read(&self, value: &Value<'_>) -> Result<u32, SceneError> {
        let integer = value.value.as_integer();
        let integer = integer.and_then(|integer| u32::from_str_radix(integer.as_str(), integer.radix()).ok());
        integer
            .filter(|integer| (self.min..=self.max).contains(integer))
            .ok_or_else(|| unquoted(value, value.unexpected(self.expected())))
    }
}

/// A vector of three numbers.
#[derive(Clone, Copy)]
pub(crate) struct Vector(pub Number);

impl Kind for Vector {
    type Read = DVec3;

    fn expected(&self) -> String {
        "an array of 3 numbers [x, y, z]".to_owned()
    }

    fn read(&self, value: &Value<'_>) -> Result<DVec3, SceneError> {
        value.numbers(self.0, &self.expected()).map(DVec3::from_array)
    }
}

/// A string that satisfies a condition.
pub(crate) struct Text {
    pub form: &'static str,
    pub accepts: fn(&str) -> bool,
}

impl Kind for Text {
    type Read = String;

    fn expected(&self) -> String {
        self.form.to_owned()
    }

    fn read(&self, value: &Value<'_>) -> Result<String, SceneError> {
        let text = value.text().filter(|text| (self.accepts)(text));
        text.map(str::to_owned).ok_or_else(|| value.unexpected(self.form))
    }
}

/// One of several keywords, each with the value that it stands for.
pub(crate) struct Choice<T, const N: usize>(pub [(&'static str, T); N]);

impl<T: Copy, const N: usize> Kind for Choice<T, N> {
    type Read = T;

    fn expected(&self) -> String {
        let words = self.0.each_ref().map(|(word, _)| format!("\"{word}\""));
        format!("one of {}", words.join(", "))
    }

    fn read(&self, value: &Value<'_>) -> Result<T, SceneError> {
        let text = value.text();
        if let Some((_, chosen)) = self.0.iter().find(|(word, _)| Some(*word) == text) {
            return Ok(*chosen);
        }
        let hint = text.map_or(String::new(), |text| did_you_mean(text, self.0.iter().map(|(word, _)| *word)));
        Err(value.error(format!("expected {}, found {}{hint}", self.expected(), value.found())))
    }
}

fn unquoted(value: &Value<'_>, error: SceneError) -> SceneError {
    match value.text() {
        Some(text) if text.trim().parse::<f64>().is_ok() => error.with_help("write the number without quotes"),
        _ => error,
    }
}
