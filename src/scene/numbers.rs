//! The numbers of a scene that decide what happens: what a page has sliders for.

use toml::{Table, Value};

use super::{
    Scene,
    keys::{self, Fallback, Key, Kind, Range, Section},
};
use crate::model::PairLaw;

/// Upper limit on the tables of a kind whose numbers are listed.
const LISTED: usize = 12;

/// A number of a scene, which [`Template`](super::template::Template) can replace.
#[derive(Clone, Debug, PartialEq)]
pub struct Number {
    /// Path of its key: `influence.merge_at`, `body.a.omega`, `gravity[2]`.
    pub path: String,
    /// What it belongs to: `influence`, `body a`.
    pub group: String,
    /// Its key, with the axis of a component.
    pub name: String,
    /// Its unit; empty for a pure number.
    pub unit: &'static str,
    /// What it is.
    pub about: &'static str,
    /// Its value in the scene.
    pub value: f64,
    /// The range in which it usually is, and its value.
    pub usual: [f64; 2],
}

/// The numbers of a scene, in the order of its tables. A number that the file omits is listed if it still has a value: its
/// default, or that of the table from which it is inherited. None of a scene that was not parsed.
pub fn numbers(scene: &Scene) -> Vec<Number> {
    let Ok(document) = scene.source.parse::<Table>() else { return Vec::new() };
    let mut numbers = Numbers { document: &document, found: Vec::new() };
    let has_free = scene.bodies.iter().any(|body| body.path().is_none());
    if document.contains_key("body") || document.contains_key("grid") {
        numbers.table(&keys::INFLUENCE, "influence", |key| threshold(&scene.common_law().of_pair(has_free), key));
        numbers.table(&keys::MATERIAL, "material", |_| None);
        if has_free {
            numbers.vector("gravity", "gravity", keys::find(&keys::TOP, "gravity"), document.get("gravity"));
        }
    }
    for (name, section) in [("lattice", &keys::LATTICE), ("fem", &keys::FEM), ("surface", &keys::SURFACE)] {
        if document.contains_key(name) {
            numbers.table(section, name, |_| None);
        }
    }
    for (index, (pair, law)) in tables(&document, "pair").zip(scene.pairs.laws()).enumerate() {
        let sides = pair.get("bodies").and_then(Value::as_array).into_iter().flatten().filter_map(Value::as_str);
        let group = format!("pair {}", sides.collect::<Vec<_>>().join("~"));
        numbers
            .item(&keys::PAIR, &group, &format!("pair[{index}]"), pair, |key| threshold(&law.of_pair(has_free), key));
    }
    for kind in ["body", "grid"] {
        for body in tables(&document, kind) {
            let Some(name) = body.get("name").and_then(Value::as_str) else { continue };
            let section = if kind == "body" { &keys::BODY } else { &keys::GRID };
            let (group, path) = (format!("{kind} {name}"), format!("{kind}.{name}"));
            numbers.item(section, &group, &path, body, |_| None);
            for (inner, section) in [("free", &keys::FREE), ("line", &keys::LINE), ("sine", &keys::SINE)] {
                let motion = body.get("motion").and_then(|motion| motion.get(inner)).and_then(Value::as_table);
                if let Some(motion) = motion {
                    numbers.item(section, &group, &format!("{path}.motion.{inner}"), motion, |_| None);
                }
            }
        }
    }
    for (kind, section) in [("plane", &keys::PLANE), ("push", &keys::PUSH)] {
        for (index, table) in tables(&document, kind).enumerate() {
            let group = match table.get("body").and_then(Value::as_str) {
                Some(body) => format!("{kind} of {body}"),
                None => format!("{kind} {index}"),
            };
            numbers.item(section, &group, &format!("{kind}[{index}]"), table, |_| None);
        }
    }
    for point in tables(&document, "point") {
        let Some(name) = point.get("name").and_then(Value::as_str) else { continue };
        numbers.item(&keys::POINT, &format!("point {name}"), &format!("point.{name}"), point, |_| None);
        // it has the strength of what it does
        let other = if point.get("act").and_then(Value::as_str) == Some("repel") { "alpha" } else { "beta" };
        numbers.found.retain(|number| number.path != format!("point.{name}.{other}"));
    }
    numbers.found
}

/// The thresholds whose defaults depend on others.
fn threshold(law: &PairLaw, key: &str) -> Option<f64> {
    match key {
        "core_at" => Some(law.thresholds.core_at),
        "core_width" => Some(law.core_width),
        _ => None,
    }
}

/// The first tables of a kind.
fn tables<'a>(document: &'a Table, kind: &str) -> impl Iterator<Item = &'a Table> + use<'a> {
    let all = document.get(kind).and_then(Value::as_array);
    all.into_iter().flatten().filter_map(Value::as_table).take(LISTED)
}

/// An integer or a float.
pub fn number(value: &Value) -> Option<f64> {
    value.as_float().or_else(|| value.as_integer().map(|integer| integer as f64))
}

struct Numbers<'a> {
    document: &'a Table,
    found: Vec<Number>,
}

impl Numbers<'_> {
    /// The numbers of a table that occurs once.
    fn table(&mut self, section: &'static Section, name: &str, resolved: impl Fn(&str) -> Option<f64>) {
        let empty = Table::new();
        let table = self.document.get(name).and_then(Value::as_table).unwrap_or(&empty);
        self.item(section, name, name, table, resolved);
    }

    /// The numbers of a table at a path. `resolved` has the values of keys whose defaults the table of keys describes
    /// in words.
    fn item(
        &mut self,
        section: &'static Section,
        group: &str,
        path: &str,
        table: &Table,
        resolved: impl Fn(&str) -> Option<f64>,
    ) {
        for key in section.all() {
            let path = format!("{path}.{}", key.name);
            let own = table.get(key.name);
            match key.kind {
                Kind::Number(range) => {
                    let inherited = || {
                        let (_, from) =
                            section.shared.iter().find(|(keys, _)| keys.iter().any(|k| k.name == key.name))?;
                        self.document.get(from.trim_matches(['[', ']']))?.get(key.name)
                    };
                    let default = || match key.default {
                        Fallback::Number(value) | Fallback::Written(value, _) => Some(value),
                        _ => resolved(key.name),
                    };
                    let value = own.or_else(inherited).and_then(number).or_else(default);
                    if let (Some(value), Some(usual)) = (value, key.usual) {
                        self.push(path, group, key.name.to_owned(), key, value, widened(usual, range, value));
                    }
                }
                Kind::Vector(_) => self.vector(&path, group, key, own),
                _ => (),
            }
        }
    }

    /// The components of a vector.
    fn vector(&mut self, path: &str, group: &str, key: &'static Key, own: Option<&Value>) {
        let given = own.and_then(Value::as_array).map(|items| items.iter().filter_map(number).collect::<Vec<f64>>());
        let components = match (given.as_deref(), key.default) {
            (Some(&[x, y, z]), _) => [x, y, z],
            (None, Fallback::Vector(value)) => [value; 3],
            _ => return,
        };
        let largest = components.iter().fold(1.0, |largest: f64, x| largest.max(x.abs()));
        let decade = 10f64.powf(largest.log10().floor());
        let end = [2.0, 5.0, 10.0, 20.0].map(|step| step * decade).into_iter().find(|&end| end >= 1.5 * largest);
        let end = end.unwrap_or(2.0 * largest);
        for (axis, value) in components.into_iter().enumerate() {
            let name = format!("{} {}", key.name, ["x", "y", "z"][axis]);
            self.push(format!("{path}[{axis}]"), group, name, key, value, [-end, end]);
        }
    }

    fn push(&mut self, path: String, group: &str, name: String, key: &'static Key, value: f64, usual: [f64; 2]) {
        let (unit, about) = (key.unit, key.about);
        self.found.push(Number { path, group: group.to_owned(), name, unit, about, value, usual });
    }
}

/// A range with a value, within the limits of the key.
fn widened(usual: [f64; 2], limits: Range, value: f64) -> [f64; 2] {
    [usual[0].min(value).max(limits.min), usual[1].max(value).min(limits.max)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{
        builtin,
        template::{KeyPath, Setting, Template},
    };

    #[test]
    fn every_number_of_the_built_in_scenes_can_be_set_to_its_own_value() {
        for builtin in builtin::ALL.iter().filter(|builtin| builtin.name != "rain") {
            let scene = Scene::builtin(builtin.name).unwrap();
            let template = Template::new(&scene.source, builtin.name, None).unwrap();
            let numbers = numbers(&scene);
            assert!(numbers.iter().any(|number| number.path == "influence.merge_at"), "{}", builtin.name);
            for number in &numbers {
                let key = KeyPath::parse(&number.path).unwrap();
                let set = template.scene([(&key, &Setting::Number(number.value))]);
                let set = set.unwrap_or_else(|error| panic!("{} in {}: {error}", number.path, builtin.name));
                if !number.name.starts_with("core") {
                    let [set, scene] = [&set, &scene].map(|scene| Scene { source: String::new(), ..scene.clone() });
                    assert_eq!(format!("{set:?}"), format!("{scene:?}"), "{} in {}", number.path, builtin.name);
                }
                assert!(number.usual[0] <= number.value && number.value <= number.usual[1], "{number:?}");
            }
        }
    }

    #[test]
    fn missing_numbers_have_the_values_that_hold() {
        let text = "duration = 1.0\n[influence]\nmerge_at = 0.9\n[material]\nomega = 7\n\
                    [[body]]\nname = \"a\"\nradius = 1.0\nmotion = { free = { from = [0, 0, 3] } }\n\
                    [[body]]\nname = \"b\"\nradius = 1.0\nomega = 9.0\nmotion = { fixed = [0, 0, 0] }\n\
                    [[pair]]\nbodies = [\"a\", \"b\"]\nmerge_at = 1.0\n";
        let numbers = numbers(&Scene::parse(text, "missing.toml").unwrap());
        let value = |path: &str| {
            let found = numbers.iter().find(|number| number.path == path);
            found.unwrap_or_else(|| panic!("no {path}")).value
        };
        assert_eq!(value("influence.merge_at"), 0.9);
        assert_eq!(value("body.a.omega"), 7.0);
        assert_eq!(value("body.b.omega"), 9.0);
        assert_eq!(value("body.a.damping"), 1.5);
        assert_eq!(value("body.a.motion.free.from[2]"), 3.0);
        assert_eq!(value("body.a.motion.free.velocity[1]"), 0.0);
        assert_eq!(value("pair[0].merge_at"), 1.0);
        assert_eq!(value("pair[0].core_at"), 0.76);
        assert_eq!(value("influence.core_at"), 0.76 * 0.9);
        assert_eq!(value("gravity[2]"), 0.0);
    }
}
