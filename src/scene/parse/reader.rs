//! A typed view of a TOML document that keeps the source position and dotted path of every value.
//!
//! serde could fill the structs, but its messages name a type where a user needs the key's range, and it loses the
//! positions needed to report two values that are inconsistent.

use std::{fmt, ops::Range};

use glam::DVec3;
use toml::de::{DeTable, DeValue};

use super::error::{Place, SceneError, clip, one_line};
use crate::{
    scene::keys::{ANY, FINITE, Fallback, Key, Kind, Range as Limits, Section, sections},
    text::did_you_mean,
};

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
            return SceneError::plain(self.file, message);
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

    fn error(&self, offset: usize, path: &Path<'_>, message: String) -> SceneError {
        let place = Some(Place::of(self.text, offset));
        SceneError { file: self.file.to_owned(), place, key: path.to_string(), message, help: None }
    }
}

/// The dotted path of a value, as a linked list from the value outwards; formatted only for errors.
#[derive(Clone, Copy)]
enum Path<'a> {
    File,
    Field(&'a Path<'a>, &'a str),
    Item(&'a Path<'a>, usize),
    /// A named item of an array of tables.
    Named(&'a Path<'a>, &'a str),
}

impl fmt::Display for Path<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Path::File => Ok(()),
            Path::Field(parent, field) => {
                write!(f, "{parent}{}", if matches!(parent, Path::File) { "" } else { "." })?;
                let bare = !field.is_empty() && field.bytes().all(is_bare);
                if bare { f.write_str(&clip(field)) } else { write!(f, "\"{}\"", clip(field)) }
            }
            Path::Item(parent, index) => write!(f, "{parent}[{index}]"),
            Path::Named(parent, name) => write!(f, "{parent}[\"{name}\"]"),
        }
    }
}

/// Whether `byte` may appear in a TOML key without quotes, and in the name of a body.
pub(crate) fn is_bare(byte: u8) -> bool {
    byte.is_ascii_alphanumeric() || matches!(byte, b'-' | b'_')
}

/// Whether `name` is valid for a body: 1 to 64 letters, digits, `-` and `_`.
pub(crate) fn is_body_name(name: &str) -> bool {
    (1..=64).contains(&name.len()) && name.bytes().all(is_bare)
}

/// A table whose keys are all known. A missing table reads like an empty one.
pub(crate) struct Table<'a> {
    source: &'a Source<'a>,
    path: Path<'a>,
    /// Position of its header, or of the whole table if it is inline.
    span: Range<usize>,
    entries: Option<&'a DeTable<'a>>,
}

impl<'a> Table<'a> {
    /// The root table of a file.
    ///
    /// # Errors
    /// There is an unknown key.
    pub fn root(source: &'a Source<'a>, document: &'a DeTable<'a>, known: &Section) -> Result<Table<'a>, SceneError> {
        Table { source, path: Path::File, span: 0..0, entries: Some(document) }.known(known)
    }

    /// Unknown keys are reported before anything else: an unknown key is usually misspelled or misplaced, and its
    /// message is more helpful than the one that the intended key is missing.
    fn known(self, known: &Section) -> Result<Table<'a>, SceneError> {
        let unknown = self.entries.iter().flat_map(|entries| entries.keys());
        let accepts = |section: &Section, name: &str| section.all().any(|key| key.name == name);
        let unknown = unknown.filter(|key| !accepts(known, key.get_ref().as_ref()));
        // the tree is sorted by name
        let Some(key) = unknown.min_by_key(|key| key.span().start) else { return Ok(self) };
        let name = key.get_ref().as_ref();
        // a key of a scene, in a scene
        let is_of_scene = sections().any(|section| std::ptr::eq(section, known));
        let homes = sections().filter(|section| is_of_scene && accepts(section, name));
        let homes: Vec<&str> = homes.map(|section| section.home).collect();
        let names: Vec<&str> = known.all().map(|key| key.name).collect();
        let hint = if !homes.is_empty() {
            format!("; \"{name}\" belongs {}", homes.join(" or "))
        } else {
            did_you_mean(name, names.iter().copied())
        };
        let message = format!("unknown key{hint} (known keys: {})", names.join(", "));
        Err(self.source.error(key.span().start, &Path::Field(&self.path, name), message))
    }

    /// The value of `name`, if present.
    pub fn get(&self, name: &'static str) -> Option<Value<'_>> {
        let value = self.entries?.get(name)?;
        Some(Value {
            source: self.source,
            path: Path::Field(&self.path, name),
            span: value.span(),
            value: value.get_ref(),
        })
    }

    /// The value of a key, if it is given.
    ///
    /// # Errors
    /// `read` rejects it.
    fn given<T>(
        &self,
        key: &Key,
        read: impl FnOnce(&Value<'_>) -> Result<T, SceneError>,
    ) -> Result<Option<T>, SceneError> {
        self.get(key.name).map(|value| read(&value)).transpose()
    }

    fn missing(&self, key: &Key) -> SceneError {
        let message = format!("missing, expected {}", key.kind.expected());
        self.source.error(self.span.start, &Path::Field(&self.path, key.name), message)
    }

    /// A number, or its default.
    ///
    /// # Errors
    /// It is not in the key's range, or a required one is missing.
    pub fn number(&self, key: &Key) -> Result<f64, SceneError> {
        match (self.given_number(key)?, key.default) {
            (Some(number), _) | (None, Fallback::Number(number) | Fallback::Written(number, _)) => Ok(number),
            _ => Err(self.missing(key)),
        }
    }

    /// A number, if it is given.
    ///
    /// # Errors
    /// It is not in the key's range.
    pub fn given_number(&self, key: &Key) -> Result<Option<f64>, SceneError> {
        self.given(key, |value| value.number(key.limits()))
    }

    /// An integer, or its default.
    ///
    /// # Errors
    /// It is not in the key's range, or a required one is missing.
    pub fn integer(&self, key: &Key) -> Result<u32, SceneError> {
        let limits = if let Kind::Integer(limits) = key.kind { limits } else { [0, u32::MAX] };
        match (self.given(key, |value| value.integer(limits))?, key.default) {
            (Some(integer), _) => Ok(integer),
            (None, Fallback::Number(number)) => Ok(number as u32),
            _ => Err(self.missing(key)),
        }
    }

    /// A vector, or its default.
    ///
    /// # Errors
    /// It is not an array of three numbers in the key's range, or a required one is missing.
    pub fn vector(&self, key: &Key) -> Result<DVec3, SceneError> {
        match (self.given(key, |value| value.vector(key.limits()))?, key.default) {
            (Some(vector), _) => Ok(vector),
            (None, Fallback::Vector(component)) => Ok(DVec3::splat(component)),
            _ => Err(self.missing(key)),
        }
    }

    /// A text, if it is given.
    ///
    /// # Errors
    /// It does not satisfy the key's condition.
    pub fn given_text(&self, key: &Key) -> Result<Option<String>, SceneError> {
        self.given(key, |value| {
            let accepts = |text: &&str| if let Kind::Text(form) = key.kind { (form.accepts)(text) } else { true };
            let text = value.text().filter(accepts);
            text.map(str::to_owned).ok_or_else(|| value.unexpected(key.kind.expected()))
        })
    }

    /// A text.
    ///
    /// # Errors
    /// It is missing, or does not satisfy the key's condition.
    pub fn text(&self, key: &Key) -> Result<String, SceneError> {
        self.given_text(key)?.ok_or_else(|| self.missing(key))
    }

    /// What a word stands for, if it is given.
    ///
    /// # Errors
    /// It is not one of the words.
    pub fn given_word<T: Copy>(&self, key: &Key, words: &[(&'static str, T)]) -> Result<Option<T>, SceneError> {
        self.given(key, |value| value.word(words))
    }

    /// What a word stands for, or the default one.
    ///
    /// # Errors
    /// It is not one of the words, or a required one is missing.
    pub fn word<T: Copy>(&self, key: &Key, words: &[(&'static str, T)]) -> Result<T, SceneError> {
        let by_default = || {
            let Fallback::Word(word) = key.default else { return None };
            words.iter().find(|(known, _)| *known == word).map(|(_, value)| *value)
        };
        self.given_word(key, words)?.or_else(by_default).ok_or_else(|| self.missing(key))
    }

    /// The value of `name`.
    ///
    /// # Errors
    /// The value is missing; `expected` describes it in the message.
    pub fn present(&self, name: &'static str, expected: &str) -> Result<Value<'_>, SceneError> {
        self.get(name).ok_or_else(|| {
            let message = format!("missing, expected {expected}");
            self.source.error(self.span.start, &Path::Field(&self.path, name), message)
        })
    }

    /// An error at the value of `name`, or at the table if that is missing.
    pub fn error(&self, name: &'static str, message: String) -> SceneError {
        let offset = self.get(name).map_or(self.span.start, |value| value.span.start);
        self.source.error(offset, &Path::Field(&self.path, name), message)
    }

    /// Line of the table, from 1.
    pub fn line(&self) -> u32 {
        Place::of(self.source.text, self.span.start).line
    }

    /// The table `name`; empty if it is missing.
    ///
    /// # Errors
    /// The value is not a table, or has an unknown key.
    pub fn table(&self, name: &'static str, known: &Section) -> Result<Table<'_>, SceneError> {
        match self.get(name) {
            Some(value) => value.into_table(known),
            None => Ok(Table {
                source: self.source,
                path: Path::Field(&self.path, name),
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
    path: Path<'a>,
    span: Range<usize>,
    value: &'a DeValue<'a>,
}

impl<'a> Value<'a> {
    /// An error at this value's position.
    pub fn error(&self, message: String) -> SceneError {
        self.source.error(self.span.start, &self.path, message)
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
            // values of `--set` are not in the text
            DeValue::Integer(number) if written().is_empty() => clip(number.as_str()),
            DeValue::Integer(_) => as_written(),
            DeValue::Boolean(value) => value.to_string(),
            DeValue::Datetime(value) => format!("the date-time {value}"),
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
            path: Path::Item(&self.path, index),
            span: item.span(),
            value: item.get_ref(),
        }))
    }

    /// The keys and values of this value, if it is a table.
    pub fn entries(&self) -> Option<impl ExactSizeIterator<Item = (&'a str, Value<'_>)>> {
        let entries = self.value.as_table()?;
        Some(entries.iter().map(|(key, value)| {
            let name = key.get_ref().as_ref();
            let path = Path::Field(&self.path, name);
            (name, Value { source: self.source, path, span: value.span(), value: value.get_ref() })
        }))
    }

    /// Whether this value is a number.
    pub fn is_number(&self) -> bool {
        matches!(self.value, DeValue::Integer(_) | DeValue::Float(_))
    }

    /// The value itself.
    pub fn raw(&self) -> &'a DeValue<'a> {
        self.value
    }

    /// This value as a table.
    ///
    /// # Errors
    /// The value is not a table, or has an unknown key.
    pub fn into_table(self, known: &Section) -> Result<Table<'a>, SceneError> {
        let entries = self.value.as_table().ok_or_else(|| self.unexpected(known.form))?;
        Table { source: self.source, path: self.path, span: self.span, entries: Some(entries) }.known(known)
    }

    /// This value as an array of tables, each identified by its name if that is valid, otherwise by its index.
    ///
    /// # Errors
    /// The value is not an array of tables, or one of them has an unknown key.
    pub fn tables(&self, known: &Section) -> Result<Vec<Table<'_>>, SceneError> {
        let items = self
            .items()
            .ok_or_else(|| self.unexpected(format_args!("an array of tables, each written [[{}]]", self.path)))?;
        items
            .map(|item| {
                let name = item.value.get("name").and_then(|name| name.get_ref().as_str());
                match name.filter(|name| is_body_name(name)) {
                    Some(name) => Value { path: Path::Named(&self.path, name), ..item }.into_table(known),
                    None => item.into_table(known),
                }
            })
            .collect()
    }

    /// This value as an array of exactly `N` numbers; `expected` describes it.
    ///
    /// # Errors
    /// The value is not such an array.
    pub fn numbers<const N: usize>(&self, limits: Limits, expected: &str) -> Result<[f64; N], SceneError> {
        let items = self.items().filter(|items| items.len() == N).ok_or_else(|| self.unexpected(expected))?;
        let mut numbers = [0.0; N];
        for (slot, item) in numbers.iter_mut().zip(items) {
            *slot = item.number(limits)?;
        }
        Ok(numbers)
    }

    /// This value as a finite number within a range. TOML integers are accepted.
    ///
    /// # Errors
    /// The value is not such a number.
    pub fn number(&self, limits: Limits) -> Result<f64, SceneError> {
        let number = match self.value {
            DeValue::Float(float) => float.as_str().parse().ok(),
            // as a float, because a TOML integer may exceed any integer type
            DeValue::Integer(integer) if integer.radix() == 10 => integer.as_str().parse().ok(),
            DeValue::Integer(integer) => u128::from_str_radix(integer.as_str(), integer.radix()).ok().map(|n| n as f64),
            _ => None,
        };
        match number {
            Some(number) if (limits.min..=limits.max).contains(&number) => Ok(number + 0.0), // −0 is 0
            _ => Err(self.unquoted(self.unexpected(Kind::Number(limits).expected()))),
        }
    }

    /// This value as an integer within a closed range.
    ///
    /// # Errors
    /// The value is not such an integer.
    pub fn integer(&self, limits: [u32; 2]) -> Result<u32, SceneError> {
        let integer = self.value.as_integer();
        let integer = integer.and_then(|integer| u32::from_str_radix(integer.as_str(), integer.radix()).ok());
        integer
            .filter(|integer| (limits[0]..=limits[1]).contains(integer))
            .ok_or_else(|| self.unquoted(self.unexpected(Kind::Integer(limits).expected())))
    }

    /// This value as a vector.
    ///
    /// # Errors
    /// The value is not an array of three numbers within the range.
    pub fn vector(&self, limits: Limits) -> Result<DVec3, SceneError> {
        self.numbers(limits, &Kind::Vector(limits).expected()).map(DVec3::from_array)
    }

    /// What this value stands for among some words.
    ///
    /// # Errors
    /// The value is not one of the words.
    pub fn word<T: Copy>(&self, words: &[(&'static str, T)]) -> Result<T, SceneError> {
        let text = self.text();
        if let Some((_, chosen)) = words.iter().find(|(word, _)| Some(*word) == text) {
            return Ok(*chosen);
        }
        let names = || words.iter().map(|(word, _)| *word);
        let hint = text.map_or(String::new(), |text| did_you_mean(text, names()));
        Err(self.error(format!("expected {}, found {}{hint}", one_of(names()), self.found())))
    }

    fn unquoted(&self, error: SceneError) -> SceneError {
        match self.text() {
            Some(text) if text.trim().parse::<f64>().is_ok() => {
                let has_digits = |(before, after): (&str, &str)| {
                    before.ends_with(|c: char| c.is_ascii_digit()) && after.starts_with(|c: char| c.is_ascii_digit())
                };
                error.with_help(match text.split_once('.').is_some_and(|parts| !has_digits(parts)) {
                    true => "write it without quotes, and with digits on both sides of its point, as in 0.5 or 1.0",
                    false => "write the number without quotes",
                })
            }
            _ => error,
        }
    }
}

fn one_of<'w>(words: impl Iterator<Item = &'w str>) -> String {
    let quoted: Vec<String> = words.map(|word| format!("\"{word}\"")).collect();
    format!("one of {}", quoted.join(", "))
}

impl Key {
    /// The range of its numbers.
    fn limits(&self) -> Limits {
        match self.kind {
            Kind::Number(limits) | Kind::Vector(limits) => limits,
            Kind::Direction => FINITE,
            _ => ANY,
        }
    }
}

impl Kind {
    /// What is expected, as the text after "expected".
    pub fn expected(&self) -> String {
        match self {
            Kind::Number(Limits { max: f64::MAX, .. }) => "a finite number".to_owned(),
            // in scientific notation: 1e15, not 1000000000000000
            Kind::Number(Limits { min, max }) => {
                let is_plain = |x: f64| x == 0.0 || (0.1..10.0).contains(&x.abs());
                let short = |x: f64| if is_plain(x) { x.to_string() } else { format!("{x:e}") };
                format!("a number between {} and {}", short(*min), short(*max))
            }
            Kind::Integer([min, max]) => format!("an integer from {min} to {max}"),
            Kind::Vector(_) | Kind::Direction => "an array of 3 numbers [x, y, z]".to_owned(),
            Kind::Text(text) => text.form.to_owned(),
            Kind::Word(words) => one_of(words().into_iter()),
            Kind::Other(form) => (*form).to_owned(),
        }
    }
}
