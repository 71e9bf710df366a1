//! `[[edit]]`: other values from an instant on.

use toml::de::DeTable;

use super::{
    Meshes, SceneError, key, read_document,
    reader::{Source, Table, Value},
};
use crate::scene::{
    Edit, Scene,
    keys::{self, EDIT_FORM, Kind, Section},
    template::{KeyPath, owned, replace, same_place},
};
use crate::text::did_you_mean;

/// Limit on the number of tables.
const MAX_EDITS: usize = 100;
/// Limit on the number of tables times the number of bodies: each edit keeps the oscillator of every body.
const MAX_BODIES: usize = 2_000_000;

/// The edits in these tables of a document, in order of time; those at one time in the order of the file.
pub(super) fn read(
    source: &Source<'_>,
    document: &DeTable<'_>,
    meshes: &Meshes<'_>,
    tables: &[Table<'_>],
    scene: &Scene,
) -> Result<Vec<Edit>, SceneError> {
    let Some(last) = tables.last() else { return Ok(Vec::new()) };
    if tables.len() > MAX_EDITS || tables.len() * scene.bodies.len() > MAX_BODIES {
        let most = MAX_EDITS.min(MAX_BODIES / scene.bodies.len().max(1));
        let message = format!("expected at most {most} [[edit]]s for this number of bodies, found {}", tables.len());
        return Err(last.error("time", message).with_help("set several keys in one edit"));
    }
    let mut in_order = Vec::with_capacity(tables.len());
    for table in tables {
        in_order.push((table.number(key!(EDITS.time))?, table.present("set", EDIT_FORM)?));
    }
    in_order.sort_by(|(a, _), (b, _)| a.total_cmp(b));
    let mut edited = document.clone();
    edited.remove("edit");
    edited.remove("mesh"); // already read
    let mut edits = Vec::with_capacity(tables.len());
    for (time, set) in &in_order {
        let entries: Vec<(&str, Value<'_>)> = set.entries().ok_or_else(|| set.unexpected(EDIT_FORM))?.collect();
        if entries.is_empty() {
            return Err(set.error(format!("expected {EDIT_FORM}, found an empty one")));
        }
        let mut lines = Vec::with_capacity(entries.len());
        let paths = entries.iter().map(|(name, value)| editable(name, value)).collect::<Result<Vec<_>, _>>()?;
        if let Some(same) = same_place(&edited, &paths.iter().collect::<Vec<_>>()) {
            let [(earlier, _), (name, value)] = same.map(|index| &entries[index]);
            return Err(value.error(format!("{name} sets {earlier} again")));
        }
        for ((name, value), path) in entries.iter().zip(&paths) {
            replace(&mut edited, path, value.raw().clone()).map_err(|message| value.error(message))?;
            lines.push(format!("{name} = {}", owned(value.raw())));
        }
        let after = read_document(source, &edited, &mut meshes.clone()).map_err(|error| {
            let of_error = |(name, _): &&(&str, Value<'_>)| keys_match(name, &error.key);
            let at = entries.iter().find(of_error).map_or(set, |(_, value)| value);
            let SceneError { place: _, key, message, help, .. } = &error;
            SceneError { help: help.clone(), ..at.error(format!("{message} ({key} after this edit)")) }
        })?;
        edits.push(Edit::new(*time, lines, scene, edits.last(), &after));
    }
    Ok(edits)
}

/// Whether an error about `reported` is about the key that an edit calls `name`: `body.a.omega` is reported as
/// `body["a"].omega`.
fn keys_match(name: &str, reported: &str) -> bool {
    let plain = |text: &str| text.replace("[\"", ".").replace("\"]", "");
    plain(name) == plain(reported)
}

impl Scene {
    /// Whether an edit may set the key at this path to a number.
    pub fn can_edit(path: &str) -> bool {
        KeyPath::parse(path).is_ok_and(|path| {
            let is_component = path.names() == ["gravity"] && path.len() == 2;
            is_component
                || numbers_beside(&path)
                    .is_some_and(|numbers| path.names().last().is_some_and(|name| numbers.contains(name)))
        })
    }
}

/// The names of the numbers that an edit may set in the table of a path; `None` if the path has another form.
fn numbers_beside(path: &KeyPath) -> Option<Vec<&'static str>> {
    let all = |section: &'static Section| section.all().collect::<Vec<_>>();
    let (depth, keys) = match *path.names().first()? {
        "influence" => (2, all(&keys::INFLUENCE)),
        "material" => (2, all(&keys::MATERIAL)),
        "body" | "grid" => (3, keys::OSCILLATOR.iter().chain(&keys::REACH).collect()),
        "pair" => (3, all(&keys::PAIR)),
        "plane" => (3, all(&keys::PLANE)),
        "point" => (3, all(&keys::POINT)),
        _ => return None,
    };
    let is_number = |key: &&keys::Key| matches!(key.kind, Kind::Number(_));
    (path.len() == depth).then(|| keys.into_iter().filter(is_number).map(|key| key.name).collect())
}

/// The path of a key that an edit may set to this value.
fn editable(name: &str, value: &Value<'_>) -> Result<KeyPath, SceneError> {
    let path = KeyPath::parse(name).map_err(|message| value.error(message))?;
    let names = path.names();
    if names == ["gravity"] && path.len() <= 2 {
        return match value.is_number() == (path.len() == 2) {
            true => Ok(path),
            false => Err(value.unexpected("gravity = [x, y, z], or gravity[0] = x")),
        };
    }
    let numbers = numbers_beside(&path);
    const TABLES: [&str; 8] = ["influence", "material", "gravity", "body", "grid", "pair", "plane", "point"];
    if names.len() == 1 && TABLES.contains(&names[0]) && !value.is_number() {
        let help = format!(
            "quote the whole path of the number: \"{name}.KEY\" = VALUE, or \"{name}[0].KEY\" of a list; on a command line, edit[0].set[\"{name}.KEY\"]=VALUE"
        );
        return Err(value.error(format!("expected the path of a number, found {name}")).with_help(help));
    }
    if !numbers.iter().flatten().any(|number| names.last() == Some(number)) {
        let hint = match &numbers {
            Some(numbers) => did_you_mean(names.last().unwrap_or(&""), numbers.iter().copied()),
            None => did_you_mean(names.first().unwrap_or(&""), TABLES.into_iter()),
        };
        let of = match numbers {
            Some(numbers) => format!("{}: {}", names[0], numbers.join(", ")),
            None => "influence, material, gravity, or a body, grid, pair, plane or point".to_owned(),
        };
        let message = format!("expected a number of {of}; found {name}{hint}");
        return Err(value
            .error(message)
            .with_help("an edit changes no shape, mass, motion, push, dt, duration or tolerance"));
    }
    if !value.is_number() {
        return Err(value.unexpected("a number"));
    }
    Ok(path)
}
