//! Variations of a scene: the same document with different values at some of its keys.
//!
//! The text is parsed once. A variation replaces values in the tree of tables, which is then validated like any scene:
//! every key can be varied, and defaults follow (the default mass of a body follows its radius).

use std::{fmt, path::Path};

use toml::de::{DeTable, DeValue};

use super::{
    Scene, SceneError, builtin,
    parse::{
        ARRAYS, Files, Meshes, Place, Watch, on_deep_stack, read_document,
        reader::{Source, is_bare},
    },
};
use crate::text::did_you_mean;

/// Ignores the progress of reading a mesh.
const QUIET: Watch<'static> = &|_, _| ();
/// Limit on the parts of a key path; no key of a scene has this many.
const MAX_PARTS: usize = 16;
/// Limit on the indices in key paths.
const MAX_INDEX: usize = 1 << 20;

/// The path of a value in a scene: `influence.merge_at`, `body.b.motion.free.velocity[0]`, `push[0].strength`.
///
/// An item of an array of tables is named by its `name` or by its index; a name with dots stands in quotes, as in
/// `edit[0].set["influence.merge_at"]`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KeyPath {
    text: String,
    parts: Vec<Part>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Part {
    Name(String),
    Index(usize),
}

impl fmt::Display for KeyPath {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl KeyPath {
    /// The number of its parts: names and indices.
    pub(super) fn len(&self) -> usize {
        self.parts.len()
    }

    /// Whether this is the path of a value that has another one in it, or is it; an index may be that of any name.
    fn may_contain(&self, other: &KeyPath) -> bool {
        let is_same = |(one, other): (&Part, &Part)| {
            one == other || matches!(one, Part::Index(_)) || matches!(other, Part::Index(_))
        };
        self.parts.len() <= other.parts.len() && self.parts.iter().zip(&other.parts).all(is_same)
    }

    /// Its names, in order.
    pub(super) fn names(&self) -> Vec<&str> {
        let names = self.parts.iter().filter_map(|part| match part {
            Part::Name(name) => Some(name.as_str()),
            Part::Index(_) => None,
        });
        names.collect()
    }

    /// Parses `text`.
    ///
    /// # Errors
    /// The text is not names separated by dots, with indices in brackets; the error says what was expected.
    pub fn parse(text: &str) -> Result<KeyPath, String> {
        let expected = || "expected the path of a key, such as influence.merge_at or body.b.radius".to_owned();
        let is_name = |name: &str| !name.is_empty() && name.bytes().all(is_bare);
        let mut parts = Vec::new();
        let mut is_quoted = false;
        let is_dot = |c: char| {
            is_quoted ^= c == '"';
            c == '.' && !is_quoted
        };
        for part in text.split(is_dot) {
            let (name, mut rest) = part.split_at(part.find('[').unwrap_or(part.len()));
            if !is_name(name) {
                return Err(expected());
            }
            parts.push(Part::Name(name.to_owned()));
            while let Some(opened) = rest.strip_prefix('[') {
                let in_quotes = opened.strip_prefix('"').and_then(|name| name.split_once("\"]"));
                let quoted = in_quotes.map(|(name, _)| name);
                let (index, after) = in_quotes.or_else(|| opened.split_once(']')).ok_or_else(expected)?;
                parts.push(match (quoted, index.parse()) {
                    (Some(name), _) if !name.is_empty() => Part::Name(name.to_owned()),
                    (None, Ok(index)) if index <= MAX_INDEX => Part::Index(index),
                    _ => return Err(expected()),
                });
                rest = after;
            }
            if !rest.is_empty() || parts.len() > MAX_PARTS {
                return Err(expected());
            }
        }
        Ok(KeyPath { text: text.to_owned(), parts })
    }
}

/// The value of a key in a variation.
#[derive(Clone, Debug, PartialEq)]
pub enum Setting {
    /// A finite number; an integer where the scene needs one.
    Number(f64),
    /// A choice, a name, a file.
    Text(String),
}

impl fmt::Display for Setting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            // exact as a double and as a TOML integer, which are read as the same number
            Setting::Number(number) if number.fract() == 0.0 && number.abs() < 1e15 => write!(f, "{}", *number as i64),
            Setting::Number(number) => write!(f, "{number:?}"),
            Setting::Text(text) => toml::Value::String(text.clone()).fmt(f),
        }
    }
}

/// Another value for a key of a scene, as `--set KEY=VALUE` gives it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Override {
    key: KeyPath,
    /// TOML.
    value: String,
}

impl fmt::Display for Override {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} = {}", self.key, self.value)
    }
}

impl KeyPath {
    /// The path as text.
    pub fn text(&self) -> &str {
        &self.text
    }
}

impl Override {
    /// Parses `KEY=VALUE`. The value is TOML, or else a string without its quotes.
    ///
    /// # Errors
    /// The text is not a key and a value; the error says what was expected.
    pub fn parse(text: &str) -> Result<Override, String> {
        let expected = || "expected KEY=VALUE, such as influence.merge_at=1.1".to_owned();
        let (key, value) = text.split_once('=').ok_or_else(expected)?;
        let (key, value) = (KeyPath::parse(key.trim())?, value.trim());
        if value.is_empty() {
            return Err(expected());
        }
        let value = match DeValue::parse(value) {
            Ok(_) => value.to_owned(),
            Err(_) => toml::Value::String(value.to_owned()).to_string(),
        };
        Ok(Override { key, value })
    }

    /// The path of the key.
    pub fn key(&self) -> &str {
        &self.key.text
    }

    /// The value, if it is a number.
    pub fn number(&self) -> Option<f64> {
        super::numbers::number(&self.value.parse::<toml::Value>().ok()?)
    }
}

impl Scene {
    /// The scene with other values at some keys, beside those that it has [already](Scene::set). Its text stays. `file`
    /// is its name in errors.
    ///
    /// # Errors
    /// A key does not exist, or the resulting scene is invalid.
    pub fn with(self, overrides: &[Override], file: &str) -> Result<Scene, SceneError> {
        self.with_files(overrides, file, None)
    }

    /// Like [`Scene::with`]; meshes that the text does not contain are read from `folder`, and added to it.
    ///
    /// # Errors
    /// Those of [`Scene::with`], or a mesh cannot be read.
    pub fn with_files(self, overrides: &[Override], file: &str, folder: Option<&Path>) -> Result<Scene, SceneError> {
        if overrides.is_empty() {
            return Ok(self);
        }
        let set = [&self.set, overrides].concat();
        let (scene, source) = on_deep_stack(|| {
            let template = Template::new(&self.source, file, folder)?;
            let settings = written(set.iter().map(|one| (&one.key, &one.value)));
            let (scene, meshes) = template.read(&settings)?;
            let source =
                meshes.is_longer_than(&template.meshes).then(|| meshes.carried_by(Scene::without_meshes(&self.source)));
            Ok((scene, source))
        })?;
        Ok(Scene { source: source.unwrap_or(self.source), set, ..scene })
    }

    /// The indices of two of these settings that are of the same value; the text must be that of a scene.
    pub fn set_twice(&self, settings: &[Override]) -> Option<[usize; 2]> {
        if settings.len() < 2 {
            return None;
        }
        let source = Source { text: Scene::without_meshes(&self.source), file: "" };
        let keys: Vec<&KeyPath> = settings.iter().map(|one| &one.key).collect();
        on_deep_stack(|| same_place(&source.document().ok()?, &keys))
    }

    /// The error that the value at the path `key` cannot be used: where it stands in the text, or if it is a default, the
    /// table that it belongs to; no place if the value is not that of the text. `file` is its name.
    pub(crate) fn error_at(&self, file: &str, key: String, message: String, help: String) -> SceneError {
        let source = Source { text: &self.source, file };
        let place = || {
            let (document, path) = (source.document().ok()?, KeyPath::parse(&key).ok()?);
            let is_set = self.set.iter().any(|set| set.key.may_contain(&path));
            if is_set { None } else { Some(Place::of(source.text, position(&document, &path)?)) }
        };
        let place = place();
        SceneError { place, key, help: Some(help), ..SceneError::plain(file, message) }
    }

    /// The scene with its [settings](Scene::set) in its text, which loses its comments if there are any to write. `file` is
    /// its name in errors.
    ///
    /// # Errors
    /// Those of [`Scene::with`].
    pub fn rewritten(self, file: &str) -> Result<Scene, SceneError> {
        if self.set.is_empty() {
            return Ok(self);
        }
        let text = on_deep_stack(|| {
            Template::new(&self.source, file, None)?.text(self.set.iter().map(|one| (&one.key, &one.value)))
        })?;
        Ok(Scene { name: self.name, ..Scene::parse(&text, file)? })
    }
}

/// A scene that can be varied.
pub struct Template<'a> {
    source: Source<'a>,
    /// Without its meshes, which have been read.
    document: DeTable<'a>,
    meshes: Meshes<'a>,
    base: Scene,
}

impl<'a> Template<'a> {
    /// Parses the scene `text`; `file` is its name in errors. Meshes are read from `folder`, or without one, taken from
    /// the built-in scene of that name.
    ///
    /// # Errors
    /// Those of [`Scene::parse`].
    pub fn new(text: &'a str, file: &'a str, folder: Option<&'a Path>) -> Result<Template<'a>, SceneError> {
        on_deep_stack(|| {
            let source = Source { text, file };
            let builtin = || builtin::ALL.iter().find(|builtin| builtin.name == file);
            let files = match folder {
                Some(folder) => Files::Folder(folder, QUIET),
                None => builtin().map_or(Files::None, |builtin| Files::Given(builtin.meshes)),
            };
            let (mut document, mut meshes) = (source.document()?, Meshes::beside(files));
            let base = read_document(&source, &document, &mut meshes)?;
            if let Some(tables) = document.remove("mesh") {
                let tables = toml::Table::from_iter([("mesh".to_owned(), owned(tables.get_ref()))]);
                let text = toml::to_string(&tables);
                meshes.carry(&text.map_err(|error| SceneError::plain(file, error.to_string()))?);
            }
            Ok(Template { source, document, meshes, base })
        })
    }

    /// The text of the scene with the meshes of all its variations embedded, to be compared. Settings that make it invalid
    /// are left out.
    pub fn with_meshes<'s>(&self, settings: impl IntoIterator<Item = (&'s KeyPath, &'s Setting)>) -> String {
        let mut meshes = self.meshes.clone();
        for setting in settings {
            if let Ok(document) = self.varied(&written([setting])) {
                read_document(&self.source, &document, &mut meshes).ok();
            }
        }
        meshes.carried_by(Scene::without_meshes(self.source.text))
    }

    /// The indices of two of these keys that are those of the same value.
    pub fn same_value(&self, keys: &[&KeyPath]) -> Option<[usize; 2]> {
        same_place(&self.document, keys)
    }

    /// The scene as its text describes it.
    pub fn base(&self) -> &Scene {
        &self.base
    }

    /// The scene with these values, which are TOML, at these keys. Its [`Scene::source`] is empty: see [`Template::text`].
    ///
    /// # Errors
    /// A key does not exist, or the resulting scene is invalid.
    pub fn scene<'s>(
        &self,
        settings: impl IntoIterator<Item = (&'s KeyPath, impl fmt::Display)>,
    ) -> Result<Scene, SceneError> {
        Ok(self.read(&written(settings))?.0)
    }

    /// The scene with these values, and its meshes.
    fn read(&self, settings: &[(&KeyPath, String)]) -> Result<(Scene, Meshes<'a>), SceneError> {
        let (document, mut meshes) = (self.varied(settings)?, self.meshes.clone());
        // a mesh that the text does not name may be read from its file
        let scene = read_document(&self.source, &document, &mut meshes).map_err(|error| {
            // the position would be inside the replaced value, not in the text
            SceneError { place: None, ..error }
        })?;
        Ok((scene, meshes))
    }

    /// The text of the scene with these values at these keys, without comments. It parses to the scene of
    /// [`Template::scene`].
    ///
    /// # Errors
    /// Those of [`Template::scene`].
    pub fn text<'s>(
        &self,
        settings: impl IntoIterator<Item = (&'s KeyPath, impl fmt::Display)>,
    ) -> Result<String, SceneError> {
        let settings = written(settings);
        let document = self.varied(&settings)?;
        let mut meshes = self.meshes.clone();
        read_document(&self.source, &document, &mut meshes)?;
        let text = toml::to_string(&table(&document)).map_err(|error| self.error(String::new(), error.to_string()))?;
        Ok(meshes.carried_by(&text)) // it may be read without the files
    }

    /// The document with these values.
    fn varied<'s>(&'s self, settings: &'s [(&KeyPath, String)]) -> Result<DeTable<'s>, SceneError> {
        let mut document: DeTable<'s> = self.document.clone();
        for (key, setting) in settings {
            let value = DeValue::parse(setting).map_err(|error| self.error(key.text.clone(), error.to_string()))?;
            replace(&mut document, key, value.into_inner()).map_err(|message| self.error(key.text.clone(), message))?;
        }
        Ok(document)
    }

    fn error(&self, key: String, message: String) -> SceneError {
        SceneError { key, ..SceneError::plain(self.source.file, message) }
    }
}

/// The indices of two paths of which the second leads to the same value of a document, such as `body.a.radius` and
/// `body[0].radius`, or to one around it.
pub(super) fn same_place(document: &DeTable<'_>, paths: &[&KeyPath]) -> Option<[usize; 2]> {
    let places: Vec<_> = paths.iter().map(|path| numbered(document, path)).collect();
    let known = places.iter().enumerate().filter(|(_, place)| place.is_some());
    let is_in = |earlier: &Option<Vec<Part>>, place: &[Part]| earlier.as_ref().is_some_and(|of| of.starts_with(place));
    let mut pairs = known.filter_map(|(index, place)| {
        let place = place.as_ref()?;
        Some([places[..index].iter().position(|earlier| is_in(earlier, place))?, index])
    });
    pairs.next()
}

/// Settings with their values as text.
fn written<'s>(settings: impl IntoIterator<Item = (&'s KeyPath, impl fmt::Display)>) -> Vec<(&'s KeyPath, String)> {
    settings.into_iter().map(|(key, value)| (key, value.to_string())).collect()
}

/// Sets the value at a path of a document.
///
/// # Errors
/// There is no such place. The document may then be empty.
pub(super) fn replace<'a>(document: &mut DeTable<'a>, path: &KeyPath, value: DeValue<'a>) -> Result<(), String> {
    if let [Part::Name(name), _, ..] = &path.parts[..]
        && ARRAYS.contains(&name.as_str())
        && document.get(name.as_str()).is_none()
    {
        return Err(format!("there is no [[{name}]] to change"));
    }
    let mut root = DeValue::Table(std::mem::take(document));
    set(&mut root, &path.parts, value)?;
    if let DeValue::Table(table) = root {
        *document = table;
    }
    Ok(())
}

/// The position in the text of the value at a path, or of the innermost table around it; `None` if that is the document, or if
/// an array lacks the item, as that of a body which a grid makes.
fn position(document: &DeTable<'_>, path: &KeyPath) -> Option<usize> {
    let Some((Part::Name(first), rest)) = path.parts.split_first() else { return None };
    let (key, mut value) = document.get_key_value(first.as_str())?;
    let mut start = key.span().start;
    for part in rest {
        let next = match (value.get_ref(), part) {
            (DeValue::Table(table), Part::Name(name)) => table.get_key_value(name.as_str()).map(|(key, value)| {
                start = key.span().start;
                value
            }),
            (DeValue::Array(items), _) => {
                let item = match part {
                    Part::Index(index) => items.get(*index),
                    Part::Name(name) => items.iter().find(|item| name_of(item.get_ref()) == Some(name.as_str())),
                }?;
                start = item.span().start;
                Some(item)
            }
            _ => None,
        };
        let Some(next) = next else { break };
        value = next;
    }
    Some(start)
}

/// A path with the number of the item that it names; `None` if the array lacks that, as a body which a grid makes.
pub(super) fn numbered(document: &DeTable<'_>, path: &KeyPath) -> Option<Vec<Part>> {
    let mut parts = path.parts.clone();
    if let [Part::Name(array), item, ..] = &mut parts[..]
        && let Some(DeValue::Array(items)) = document.get(array.as_str()).map(|value| value.get_ref())
        && let Part::Name(name) = &*item
    {
        *item = Part::Index(items.iter().position(|item| name_of(item.get_ref()) == Some(name.as_str()))?);
    }
    Some(parts)
}

/// The name of an item of an array of tables.
fn name_of<'v>(item: &'v DeValue<'_>) -> Option<&'v str> {
    item.get("name")?.get_ref().as_str()
}

/// Sets the value at the path `parts`. Creates missing tables, and zero vectors where an index follows; the scene's
/// parser reports unknown names.
fn set<'a>(at: &mut DeValue<'a>, parts: &[Part], value: DeValue<'a>) -> Result<(), String> {
    let Some((part, rest)) = parts.split_first() else {
        *at = value;
        return Ok(());
    };
    match (at, part) {
        (DeValue::Table(table), Part::Name(name)) => {
            if let Some(next) = table.get_mut(name.as_str()) {
                return set(next.get_mut(), rest, value);
            }
            let mut next = match rest.first() {
                Some(Part::Index(_)) if rest.len() > 1 => return Err(format!("there is no [[{name}]] to change")),
                Some(Part::Index(_)) => zeros(),
                _ => DeValue::Table(DeTable::new()),
            };
            set(&mut next, rest, value)?;
            let spanned = |value| toml::Spanned::new(0..0, value);
            table.insert(toml::Spanned::new(0..0, name.clone().into()), spanned(next));
            Ok(())
        }
        (DeValue::Array(items), Part::Name(name)) => {
            let names = || items.iter().filter_map(|item| name_of(item.get_ref()));
            let Some(index) = items.iter().position(|item| name_of(item.get_ref()) == Some(name.as_str())) else {
                let listed: Vec<&str> = names().take(8).collect();
                let hint = did_you_mean(name, names());
                return Err(match listed.len() {
                    0 => format!("there is nothing named \"{name}\"; use an index, such as [0]"),
                    _ => format!("there is nothing named \"{name}\"{hint} (names: {})", listed.join(", ")),
                });
            };
            match items.get_mut(index) {
                Some(item) => set(item.get_mut(), rest, value),
                None => Err(format!("there is nothing named \"{name}\"")),
            }
        }
        (DeValue::Array(items), Part::Index(index)) => {
            let count = items.len();
            let item = items.get_mut(*index).ok_or_else(|| match count.checked_sub(1) {
                Some(last) => format!("there is no [{index}], the last of {count} is [{last}]"),
                None => format!("there is no [{index}] in an empty array"),
            })?;
            set(item.get_mut(), rest, value)
        }
        (_, Part::Name(name)) => Err(format!("there is no \"{name}\" in a value that is not a table")),
        (_, Part::Index(index)) => Err(format!("there is no [{index}] in a value that is not an array")),
    }
}

/// The default of optional vectors.
fn zeros<'a>() -> DeValue<'a> {
    DeValue::parse("[0, 0, 0]").map_or_else(|_| DeValue::Table(DeTable::new()), toml::Spanned::into_inner)
}

/// A document as plain values, for writing.
fn table(document: &DeTable<'_>) -> toml::Table {
    document.iter().map(|(key, value)| (key.get_ref().to_string(), owned(value.get_ref()))).collect()
}

/// A value that does not borrow the text.
pub(super) fn owned(value: &DeValue<'_>) -> toml::Value {
    match value {
        DeValue::String(text) => toml::Value::String(text.to_string()),
        DeValue::Integer(integer) => match i64::from_str_radix(integer.as_str(), integer.radix()) {
            Ok(integer) => toml::Value::Integer(integer),
            // too large for i64; a scene reads it as a double anyway
            Err(_) => toml::Value::Float(
                u128::from_str_radix(integer.as_str(), integer.radix()).map_or(f64::NAN, |integer| integer as f64),
            ),
        },
        DeValue::Float(float) => toml::Value::Float(float.as_str().parse().unwrap_or(f64::NAN)),
        DeValue::Boolean(boolean) => toml::Value::Boolean(*boolean),
        DeValue::Datetime(datetime) => toml::Value::Datetime(*datetime),
        DeValue::Array(items) => toml::Value::Array(items.iter().map(|item| owned(item.get_ref())).collect()),
        DeValue::Table(entries) => toml::Value::Table(table(entries)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::World;

    fn template(name: &str) -> Template<'static> {
        let builtin = crate::scene::builtin::ALL.iter().find(|builtin| builtin.name == name).unwrap();
        Template::new(builtin.text, builtin.name, None).unwrap()
    }

    fn vary(name: &str, key: &str, setting: Setting) -> Result<Scene, String> {
        let key = KeyPath::parse(key)?;
        template(name).scene([(&key, &setting)]).map_err(|error| error.to_string())
    }

    #[test]
    fn tables_that_a_scene_lacks_are_not_made() {
        for (key, name) in [("grid.b0.omega", "grid"), ("point.p.alpha", "point"), ("plane[0].offset", "plane")] {
            let error = vary("two", key, Setting::Number(1.0)).unwrap_err();
            assert!(error.contains(&format!("there is no [[{name}]] to change")), "{error}");
        }
    }

    #[test]
    fn values_are_set_at_keys() {
        let number = Setting::Number;
        assert_eq!(vary("two", "influence.alpha", number(7.5)).unwrap().influence.alpha, 7.5);
        assert_eq!(vary("two", "body.b.radius", number(2.0)).unwrap().bodies[1].mass, 8.0); // by default
        assert_eq!(vary("two", "body[1].radius", number(2.0)).unwrap().bodies[1].radius, 2.0);
        assert_eq!(vary("two", "gravity[2]", number(-9.0)).unwrap().gravity, glam::DVec3::new(0.0, 0.0, -9.0));
        assert_eq!(vary("two", "surface.blend", number(0.1)).unwrap().blend, 0.1);
        let text = Setting::Text("absolute".to_owned());
        assert_eq!(
            vary("two", "influence.scaling", text).unwrap().influence.scaling,
            crate::model::influence::Scaling::Absolute
        );
        let fewer = vary("two", "body.a.shape.sphere.stacks", number(6.0)).unwrap();
        assert_eq!(fewer.bodies[0].shape.vertex_count(), 2 + 5 * 24);
        let key = "body.left.motion.free.velocity[0]";
        let crate::scene::Motion::Free(free) = &vary("collide", key, number(3.0)).unwrap().bodies[0].motion else {
            panic!("a free body")
        };
        assert_eq!(free.velocity.x, 3.0);
    }

    #[test]
    fn overrides_are_toml_or_bare_words() {
        let set = |text: &str| {
            let scene = Scene::builtin("two").unwrap();
            scene.with(&[Override::parse(text)?], "two").map_err(|error| error.to_string())
        };
        assert_eq!(set("influence.merge_at = 1.1").unwrap().thresholds.merge_at, 1.1);
        assert_eq!(set("material.response=rigid").unwrap().bodies[0].material.response, crate::scene::Response::Rigid);
        assert_eq!(set("gravity=[0, 0, -9.5]").unwrap().gravity.z, -9.5);
        assert_eq!(set("name=\"other\"").unwrap().name, "other");
        let scene = set("dt=0.01").unwrap();
        let twice = scene.with(&[Override::parse("influence.alpha=5").unwrap()], "two").unwrap();
        assert_eq!((twice.dt, twice.influence.alpha, twice.set.len()), (0.01, 5.0, 2));
        assert_eq!(twice.source, Scene::builtin("two").unwrap().source);
        for (text, why) in [
            ("influence.merge_a=1", "did you mean \"merge_at\"?"),
            ("influence.merge_at", "expected KEY=VALUE"),
            ("influence.merge_at=", "expected KEY=VALUE"),
            ("=1", "expected the path of a key"),
            ("influence.merge_at=nan", "merge_at"),
            ("influence.merge_at=high", "merge_at"),
        ] {
            let error = set(text).unwrap_err();
            assert!(error.contains(why), "{text}: {error}");
        }
    }

    #[test]
    fn invalid_keys_are_rejected() {
        let error = |key: &str| vary("two", key, Setting::Number(1.0)).unwrap_err();
        assert!(error("influence.merge_a").contains("unknown key; did you mean \"merge_at\"?"));
        assert!(error("influenc.merge_at").contains("did you mean \"influence\"?"));
        assert!(error("body.bb.radius").contains("nothing named \"bb\"; did you mean \"b\"? (names: a, b)"));
        assert!(error("body[2].radius").contains("there is no [2], the last of 2 is [1]"));
        assert!(error("dt.x").contains("there is no \"x\" in a value that is not a table"));
        assert!(error("influence..x").contains("expected the path of a key"));
        assert!(error("body[1.radius").contains("expected the path of a key"));
        assert!(vary("two", "influence.merge_at", Setting::Number(1.3)).unwrap_err().contains("split_at"));
    }

    #[test]
    fn the_text_of_a_variation_parses_to_the_same_scene() {
        let number = |x| Setting::Number(x);
        for (name, key, setting) in [
            ("two", "influence.alpha", number(1.0 / 3.0)),
            ("collide", "body.left.motion.free.from[1]", number(0.1 + 0.2)),
            ("crowd", "material.omega", number(17.0)),
            ("size_ratio", "influence.scaling", Setting::Text("absolute".to_owned())),
        ] {
            let (template, key) = (template(name), KeyPath::parse(key).unwrap());
            let scene = template.scene([(&key, &setting)]).unwrap();
            let text = template.text([(&key, &setting)]).unwrap();
            let again = Scene::parse(&text, name).unwrap();
            let checksum = |scene: Scene| {
                let mut world = World::new(scene).unwrap();
                (0..100).for_each(|_| _ = world.step());
                world.checksum()
            };
            assert_eq!(checksum(scene), checksum(again), "{name}: {text}");
        }
    }
}
