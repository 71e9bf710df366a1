//! The sweep file: parses text to a [`Sweep`] that is valid by construction, or to an error that locates the mistake.

use std::{
    collections::HashMap,
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use super::{
    classes::Classes,
    design::{Axis, Design, MOST_ROWS, Sampling, Scale, Values},
    row::Measures,
};
use crate::{
    models,
    observe::{Experiment, InvalidVariation, Variation, simulation::FindExperiment},
    scene::{
        Model, Scene, SceneError, builtin,
        keys::{ANY, Fallback, Key, Kind, Range, Section, Text, find, words},
        parse::{
            on_deep_stack,
            reader::{Source, Table, Value},
        },
        template::{KeyPath, Setting, Template},
    },
    text::{did_you_mean, thousands},
};

/// Maximum number of axes.
const MAX_AXES: usize = 8;
/// Maximum number of listed values of an axis.
const MAX_VALUES: usize = 100_000;
/// Approximate maximum number of values of an axis that are validated before anything runs, at equal intervals.
const MAX_VALIDATED: u64 = 4096;

/// How points are chosen.
#[derive(Clone, Copy, PartialEq)]
enum Sample {
    Grid,
    Latin,
    Sobol,
}

const SAMPLES: [(&str, Sample); 3] = [("grid", Sample::Grid), ("latin", Sample::Latin), ("sobol", Sample::Sobol)];
const SCALES: [(&str, Scale); 2] = [("linear", Scale::Linear), ("log", Scale::Log)];
const MEASURES: [(&str, usize); 2] = [("displacement", 0), ("surfaces", 1)];

/// When a run ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Until {
    /// As soon as its outcome is certain; see [`super::run`].
    Certain,
    /// At the end of the scene.
    End,
}

const UNTILS: [(&str, Until); 2] = [("certain", Until::Certain), ("end", Until::End)];

/// Columns by which the map can be coloured.
const COLORS: [&str; 8] = [
    "outcome",
    "max_displacement",
    "closest",
    "time_merged",
    "first_merge",
    "first_split",
    "merges",
    "energy_by_events",
];

const NOT_MEASURED: &str = "max_displacement is not measured";
const MEASURE_IT: &str = "add measures = [\"displacement\"]";

// --- the keys -------------------------------------------------------------------------------------------------------

const KEY: Text = Text { form: "the path of a key, such as \"influence.merge_at\"", accepts: |text| text.len() <= 256 };
const SCENE: Text = Text { form: "a scene file or the name of a built-in scene", accepts: |text| text.len() <= 4096 };
const NAME: Text = Text {
    form: "a name of 1 to 60 characters on one line",
    accepts: |text| (1..=60).contains(&text.chars().count()) && !text.chars().any(char::is_control),
};
const COUNT: Kind = Kind::Integer([1, u32::MAX]);
const AXIS_COUNT: Kind = Kind::Integer([2, u32::MAX]);
const MEASURE_FORM: &str = "an array of \"displacement\" and \"surfaces\"";
const VALUES_FORM: &str = "an array of numbers or of strings";
const VALUE_FORM: &str = "a number or a string";

const fn key(name: &'static str, kind: Kind, default: Fallback, about: &'static str) -> Key {
    Key { name, kind, unit: "", default, usual: None, about }
}

/// A measure whose jumps can refine the grid, in the unit of its column.
const fn jump(name: &'static str) -> Key {
    let kind = Kind::Number(Range { min: 1e-12, max: 1e15 });
    key(name, kind, Fallback::Else("none"), "Neighbours that differ by more are refined as if their outcomes differed.")
}

static TOP: [Key; 10] = [
    key("scene", Kind::Text(SCENE), Fallback::Required, "The scene: a file in the same folder, or a built-in one."),
    key(
        "sample",
        Kind::Word(|| words(&SAMPLES)),
        Fallback::Word("grid"),
        "How points are chosen: on a grid, or as a fixed number of samples.",
    ),
    key("count", COUNT, Fallback::Else("each [[axis]] of a grid has its own"), "Number of samples."),
    key("seed", Kind::Integer([0, u32::MAX]), Fallback::Number(0.0), "Seed of the samples."),
    key(
        "until",
        Kind::Word(|| words(&UNTILS)),
        Fallback::Word("certain"),
        "When a run ends: as soon as its outcome is certain, or at the end of the scene.",
    ),
    key("measures", Kind::Other(MEASURE_FORM), Fallback::Else("none"), "Optional measures, which take time."),
    key("color", Kind::Word(|| COLORS.to_vec()), Fallback::Word("outcome"), "The column by which the map is coloured."),
    key(
        "jump",
        Kind::Other("a table, written [jump]"),
        Fallback::Else("none"),
        "What --refine refines besides the boundaries between outcomes.",
    ),
    key("axis", Kind::Other("tables, written [[axis]]"), Fallback::Required, "The axes of the sweep, up to 8."),
    key(
        "set",
        Kind::Other("tables, written [[set]]"),
        Fallback::Else("none"),
        "Keys of the scene with the same values in all runs.",
    ),
];
static AXES: [Key; 7] = [
    key(
        "key",
        Kind::Text(KEY),
        Fallback::Required,
        "A path into the scene; bodies by name: body.left.motion.free.velocity[0].",
    ),
    key("from", Kind::Number(ANY), Fallback::Required, "First value."),
    key("to", Kind::Number(ANY), Fallback::Required, "Last value."),
    key("count", AXIS_COUNT, Fallback::Required, "Number of values on a grid."),
    key("scale", Kind::Word(|| words(&SCALES)), Fallback::Word("linear"), "Spacing of the values."),
    key(
        "values",
        Kind::Other(VALUES_FORM),
        Fallback::Else("none"),
        "The values, instead of from, to, count and scale.",
    ),
    key("name", Kind::Text(NAME), Fallback::Else("the key"), "Its name on the map."),
];
static SETS: [Key; 2] = [
    key("key", Kind::Text(KEY), Fallback::Required, "A path into the scene."),
    key("value", Kind::Other(VALUE_FORM), Fallback::Required, "Its value in all runs."),
];
static JUMPS: [Key; 8] = [
    jump("max_displacement"),
    jump("closest"),
    jump("time_merged"),
    jump("first_merge"),
    jump("first_split"),
    jump("merges"),
    jump("splits"),
    jump("energy_by_events"),
];

static SWEEP: Section = Section {
    header: "",
    home: "at the top of the sweep",
    form: "a table",
    about: "A sweep: one run of a scene for every point of a grid over its keys.",
    example: "",
    keys: &[&TOP],
    shared: &[],
};
static AXIS: Section = Section {
    header: "[[axis]]",
    home: "in an [[axis]]",
    form: "a table, written [[axis]]",
    about: "A key of the scene that varies.",
    example: "[[axis]]\nkey = \"influence.merge_at\"\nfrom = 0.8\nto = 1.15\ncount = 8",
    keys: &[&AXES],
    shared: &[],
};
static SET: Section = Section {
    header: "[[set]]",
    home: "in a [[set]]",
    form: "a table, written [[set]]",
    about: "A key of the scene that is the same in all runs.",
    example: "[[set]]\nkey = \"duration\"\nvalue = 6.0",
    keys: &[&SETS],
    shared: &[],
};
static JUMP: Section = Section {
    header: "[jump]",
    home: "in [jump]",
    form: "a table",
    about: "Measures whose jumps --refine refines.",
    example: "",
    keys: &[&JUMPS],
    shared: &[],
};

/// All sections of a sweep, in the order in which they are listed to users.
pub fn sections() -> impl Iterator<Item = &'static Section> {
    [&SWEEP, &JUMP, &AXIS, &SET].into_iter()
}

/// A key of the tables above, found when the program is built.
macro_rules! key {
    ($group:ident.$name:ident) => {
        const { find(&$group, stringify!($name)) }
    };
}

// --- the file -------------------------------------------------------------------------------------------------------

/// A sweep: a scene, the axes along which it varies, and the measures of each run.
pub struct Sweep {
    /// The text of its file.
    pub text: String,
    /// The name of the file in errors and titles.
    pub file: String,
    /// The text of the scene.
    pub scene_text: String,
    /// The name of the scene in errors.
    pub scene_file: String,
    /// The folder of the scene, if it is a file.
    pub folder: Option<PathBuf>,
    /// The experiment whose parameters vary, in place of a scene.
    pub experiment: Option<Arc<dyn Experiment>>,
    /// Values that are the same in all runs.
    pub set: Vec<(KeyPath, Setting)>,
    /// The axes and the sampling.
    pub design: Design,
    /// The classes of the outcomes.
    pub classes: Classes,
    /// Optional measures.
    pub measures: Measures,
    /// When a run ends.
    pub until: Until,
    /// The column by which the map is coloured.
    pub color: String,
    /// Columns and their limits: neighbours that differ by more, or of which only one has a value, are refined as if
    /// their outcomes differed.
    pub jumps: Vec<(String, f64)>,
    /// Values of several axes that make the scene invalid only together, in words: such runs fail.
    pub invalid: Option<String>,
}

impl Sweep {
    /// The sweep in the file at `path`.
    ///
    /// # Errors
    /// The file cannot be read or is not a valid sweep, or its scene is invalid.
    pub fn load(path: &Path) -> Result<Sweep, SceneError> {
        let file = path.display().to_string();
        let text = read(path, &file)?;
        Sweep::parse(&text, &file, path.parent())
    }

    /// Parses `text`; `file` is its name in errors, and scenes are searched for in `folder`.
    ///
    /// # Errors
    /// The text is not a valid sweep, or its scene is invalid.
    pub fn parse(text: &str, file: &str, folder: Option<&Path>) -> Result<Sweep, SceneError> {
        on_deep_stack(|| parse(text, file, Home::Folder(folder)))
    }

    /// The sweep in the file at `path` over parameters of an experiment that `find` finds by its name, for which `scene`
    /// stands.
    ///
    /// # Errors
    /// The file cannot be read or is not a valid sweep, or there is no such experiment or parameter.
    pub fn load_own(path: &Path, find: &FindExperiment<'_>) -> Result<Sweep, SceneError> {
        let file = path.display().to_string();
        let text = read(path, &file)?;
        let name = on_deep_stack(|| {
            let source = Source { text: &text, file: &file };
            Table::root(&source, &source.document()?, &SWEEP)?.text(key!(TOP.scene))
        })?;
        let found = find(&name);
        on_deep_stack(|| parse(&text, &file, Home::Own(found.clone())))
    }

    /// The experiment at a point, if this is not a sweep of a scene.
    pub fn own(&self, point: &[Setting]) -> Option<Result<Arc<dyn Experiment>, InvalidVariation>> {
        let experiment = self.experiment.as_ref()?;
        let mut variation = Variation::default();
        for (key, setting) in self.settings(point) {
            let invalid = |what: &str| {
                let text = format!("{what} {:?}", key.text());
                Some(Err(InvalidVariation { key: Some(key.text().to_owned()), text }))
            };
            let Setting::Number(number) = setting else { return invalid("expected a number for the parameter") };
            if !experiment.parameters().iter().any(|parameter| parameter.key == key.text()) {
                return invalid("there is no parameter");
            }
            variation.values.insert(key.text().to_owned(), *number);
        }
        Some(experiment.varied(&variation))
    }

    /// The scene as a template.
    ///
    /// # Errors
    /// The scene is invalid, which [`Sweep::parse`] rules out.
    pub fn template(&self) -> Result<Template<'_>, SceneError> {
        Template::new(&self.scene_text, &self.scene_file, self.folder.as_deref())
    }

    /// The text of the scene, with the meshes of all runs embedded.
    pub fn scene_with_meshes(&self) -> String {
        let listed = self.design.axes.iter().flat_map(|axis| match &axis.values {
            Values::List(values) => values.iter().map(|value| (&axis.key, value)).collect(),
            Values::Range { .. } => Vec::new(),
        });
        let texts = self.set.iter().map(|(key, value)| (key, value)).chain(listed);
        let texts = texts.filter(|(_, value)| matches!(value, Setting::Text(_)));
        match self.template() {
            Ok(template) if self.experiment.is_none() => template.with_meshes(texts),
            _ => self.scene_text.clone(),
        }
    }

    /// The settings of a point: those fixed for all runs, and those of the axes.
    pub fn settings<'s>(&'s self, point: &'s [Setting]) -> impl Iterator<Item = (&'s KeyPath, &'s Setting)> {
        let same = self.set.iter().map(|(key, setting)| (key, setting));
        same.chain(self.design.axes.iter().map(|axis| &axis.key).zip(point))
    }
}

/// Where a sweep finds what its key `scene` names.
enum Home<'a> {
    Folder(Option<&'a Path>),
    Own(Result<Arc<dyn Experiment>, String>),
}

fn read(path: &Path, file: &str) -> Result<String, SceneError> {
    let error_of = |message: String| SceneError::plain(file, message);
    let metadata = fs::metadata(path).map_err(|error| error_of(format!("cannot read \"{file}\": {error}")))?;
    if !metadata.is_file() || metadata.len() > Scene::LARGEST_TEXT {
        return Err(error_of(format!("\"{file}\" is not a file of at most {} MiB", Scene::LARGEST_TEXT >> 20)));
    }
    fs::read_to_string(path).map_err(|error| error_of(format!("cannot read \"{file}\": {error}")))
}

fn parse(text: &str, file: &str, home: Home<'_>) -> Result<Sweep, SceneError> {
    let source = Source { text, file };
    let document = source.document()?;
    if document.get("axis").is_none() && ["body", "grid"].iter().any(|name| document.get(*name).is_some()) {
        let help = format!("a sweep has scene = {file:?}, and an [[axis]] for each key that varies");
        return Err(SceneError::plain(file, format!("{file} is a scene, not a sweep")).with_help(help));
    }
    let root = Table::root(&source, &document, &SWEEP)?;
    let [axis_array, set_array] = ["axis", "set"].map(|name| root.get(name));
    let Some(axis_array) = axis_array else {
        return Err(root.error("axis", "missing, expected at least one [[axis]]".to_owned()));
    };
    let axis_tables = axis_array.tables(&AXIS)?;
    let set_tables = set_array.as_ref().map_or(Ok(Vec::new()), |array| array.tables(&SET))?;
    if axis_tables.is_empty() || axis_tables.len() > MAX_AXES {
        return Err(axis_array.unexpected(format_args!("1 to {MAX_AXES} axes")));
    }

    let sample = root.word(key!(TOP.sample), &SAMPLES)?;
    let seed = root.integer(key!(TOP.seed))?;
    let sampling = match sample {
        Sample::Grid => {
            for name in ["count", "seed"] {
                if let Some(value) = root.get(name) {
                    let help = "each [[axis]] of a grid has its own count; or set sample = \"latin\" or \"sobol\"";
                    return Err(value.error("not for a grid".to_owned()).with_help(help));
                }
            }
            Sampling::Grid
        }
        sample => {
            let (count, seed) = (u64::from(root.integer(key!(TOP.count))?), u64::from(seed));
            if sample == Sample::Latin { Sampling::Latin { count, seed } } else { Sampling::Sobol { count, seed } }
        }
    };
    let axes = axis_tables.iter().map(|table| read_axis(table, sampling)).collect::<Result<Vec<_>, _>>()?;
    for (index, axis) in axes.iter().enumerate() {
        if axes[..index].iter().any(|other| other.key == axis.key) {
            return Err(axis_tables[index].error("key", "expected a key that no other axis has".to_owned()));
        }
        let is_taken = |name: &str| {
            let others = axes.iter().enumerate().filter(|(other, _)| *other != index);
            others.into_iter().any(|(_, other)| other.name.as_deref() == Some(name) || other.key.to_string() == name)
        };
        if axis.name.as_deref().is_some_and(is_taken) {
            return Err(axis_tables[index].error("name", "expected a name that no other axis has".to_owned()));
        }
    }
    let set = set_tables.iter().map(read_set).collect::<Result<Vec<_>, _>>()?;
    for (table, (key, _)) in set_tables.iter().zip(&set) {
        if axes.iter().any(|axis| axis.key == *key) {
            return Err(table.error("key", "expected a key that no [[axis]] has".to_owned()));
        }
    }
    let measures = read_measures(root.get("measures"))?;
    let color = read_color(root.get("color"), measures)?;
    let jumps = read_jumps(root.get("jump"), measures)?;
    let until = root.word(key!(TOP.until), &UNTILS)?;
    let design = Design { axes, sampling };

    let name = root.text(key!(TOP.scene))?;
    let scene_error = |message: String| root.error("scene", message);
    let mut experiment = None;
    let builtin = builtin::ALL.iter().find(|builtin| builtin.name == name);
    let (scene_text, scene_file, scene_folder) = match (home, builtin) {
        (Home::Own(found), _) => {
            for key in ["until", "measures", "color", "jump"] {
                if let Some(value) = root.get(key) {
                    return Err(value.error("only for scenes".to_owned()));
                }
            }
            let found = found.map_err(|why| scene_error(format!("there is no experiment {name:?}: {why}")))?;
            (experiment.insert(found).schema().source, name, None)
        }
        (Home::Folder(_), Some(builtin)) => (builtin.text.to_owned(), name, None),
        (Home::Folder(folder), None) => {
            let path = folder.unwrap_or(Path::new("")).join(&name);
            if !path.exists() && !name.contains(['/', '\\', '.']) {
                let names = builtin::ALL.map(|builtin| builtin.name);
                let hint = did_you_mean(&name, names.into_iter());
                return Err(scene_error(format!(
                    "there is no scene \"{name}\"{hint} (built-in scenes: {})",
                    names.join(", ")
                )));
            }
            let shown = path.display().to_string();
            let text = read(&path, &shown).map_err(|error| scene_error(error.message))?;
            (text, shown, Some(path.parent().unwrap_or(Path::new("")).to_owned()))
        }
    };
    let classes = if experiment.is_some() { Classes::open() } else { Classes::of_scenes() };
    let mut sweep = Sweep {
        classes,
        text: text.to_owned(),
        file: file.to_owned(),
        scene_text,
        scene_file,
        folder: scene_folder,
        experiment,
        set,
        design,
        measures,
        until,
        color,
        jumps,
        invalid: None,
    };
    sweep.invalid = try_values(&sweep, &root, &axis_tables, &set_tables)?;
    Ok(sweep)
}

fn read_key(table: &Table<'_>) -> Result<KeyPath, SceneError> {
    let key = table.text(key!(AXES.key))?;
    KeyPath::parse(&key).map_err(|message| table.error("key", message))
}

fn read_axis(table: &Table<'_>, sampling: Sampling) -> Result<Axis, SceneError> {
    let key = read_key(table)?;
    let name = table.given_text(key!(AXES.name))?;
    if let Some(values) = table.get("values") {
        for other in ["from", "to", "count", "scale"] {
            if table.get(other).is_some() {
                return Err(table.error(other, "not allowed together with values".to_owned()));
            }
        }
        let items = values.items().filter(|items| (1..=MAX_VALUES).contains(&items.len()));
        let items = items.ok_or_else(|| values.unexpected(VALUES_FORM))?;
        let values = items.map(|item| read_setting(&item)).collect::<Result<Vec<_>, _>>()?;
        let is_number = |setting: &Setting| matches!(setting, Setting::Number(_));
        if values.iter().any(|value| is_number(value) != is_number(&values[0])) {
            return Err(table.error("values", "expected numbers only, or strings only".to_owned()));
        }
        let mut places = HashMap::new();
        for (place, value) in (1..).zip(&values) {
            if let Some(earlier) = places.insert(value.to_string(), place) {
                return Err(table.error("values", format!("{value} is listed twice, at places {earlier} and {place}")));
            }
        }
        return Ok(Axis { key, name, values: Values::List(values) });
    }
    let (from, to) = (table.number(key!(AXES.from))?, table.number(key!(AXES.to))?);
    let scale = table.word(key!(AXES.scale), &SCALES)?;
    if scale == Scale::Log {
        for (name, number) in [("from", from), ("to", to)] {
            if number <= 0.0 {
                return Err(table.error(name, format!("expected a number above 0 on a log scale, found {number:?}")));
            }
        }
    }
    if from == to {
        return Err(table.error("to", format!("expected a number other than from ({from:?})")));
    }
    let count = match sampling {
        Sampling::Grid => u64::from(table.integer(key!(AXES.count))?),
        _ if table.get("count").is_some() => {
            return Err(table.error("count", "not for samples: their count is at the top of the sweep".to_owned()));
        }
        _ => 2,
    };
    Ok(Axis { key, name, values: Values::Range { from, to, count, scale } })
}

fn read_setting(value: &Value<'_>) -> Result<Setting, SceneError> {
    match value.text() {
        Some(text) => Ok(Setting::Text(text.to_owned())),
        None => value.number(ANY).map(Setting::Number),
    }
}

fn read_set(table: &Table<'_>) -> Result<(KeyPath, Setting), SceneError> {
    Ok((read_key(table)?, read_setting(&table.present("value", VALUE_FORM)?)?))
}

fn read_measures(value: Option<Value<'_>>) -> Result<Measures, SceneError> {
    let mut wanted = [false; 2];
    if let Some(value) = value {
        let items = value.items().ok_or_else(|| value.unexpected(MEASURE_FORM))?;
        for item in items {
            wanted[item.word(&MEASURES)?] = true;
        }
    }
    Ok(Measures { displacement: wanted[0], surfaces: wanted[1] })
}

fn read_color(value: Option<Value<'_>>, measures: Measures) -> Result<String, SceneError> {
    let Some(value) = value else { return Ok(COLORS[0].to_owned()) };
    let color = value.word(&COLORS.map(|name| (name, name)))?;
    if color == "max_displacement" && !measures.displacement {
        return Err(value.error(NOT_MEASURED.to_owned()).with_help(MEASURE_IT));
    }
    Ok(color.to_owned())
}

fn read_jumps(value: Option<Value<'_>>, measures: Measures) -> Result<Vec<(String, f64)>, SceneError> {
    let Some(value) = value else { return Ok(Vec::new()) };
    let table = value.into_table(&JUMP)?;
    let mut jumps = Vec::new();
    for key in &JUMPS {
        let Some(jump) = table.given_number(key)? else { continue };
        let name = key.name;
        if name == "max_displacement" && !measures.displacement {
            return Err(table.error(name, NOT_MEASURED.to_owned()).with_help(MEASURE_IT));
        }
        jumps.push((name.to_owned(), jump));
    }
    Ok(jumps)
}

/// Why a run without steps is rejected.
const NO_STEP: &str = "there would be no step: lower dt, or raise duration";

/// Rejects values that make the scene invalid, and sweeps with too many runs, before anything runs. Returns values that
/// make it invalid only together, in words.
fn try_values(
    sweep: &Sweep,
    root: &Table<'_>,
    axes: &[Table<'_>],
    sets: &[Table<'_>],
) -> Result<Option<String>, SceneError> {
    let template = if sweep.experiment.is_none() { Some(sweep.template()?) } else { None };
    let design = &sweep.design;
    let keys: Vec<&KeyPath> =
        sweep.set.iter().map(|(key, _)| key).chain(design.axes.iter().map(|axis| &axis.key)).collect();
    if let Some([first, second]) = template.as_ref().and_then(|template| template.same_value(&keys)) {
        let table = sets.iter().chain(axes).nth(second).unwrap_or(root);
        let first = if keys[first] == keys[second] { String::new() } else { format!(", also as {}", keys[first]) };
        return Err(table.error("key", format!("this value is set twice{first}: leave one out")));
    }
    let first: Vec<Setting> = design.axes.iter().map(|axis| axis.sample(0)).collect();
    // whether the keys of `set` up to some, and those of a point, are valid
    let check = |count: usize, point: &[Setting]| -> Result<(), SceneError> {
        if let Some(template) = &template {
            let fixed = sweep.set[..count].iter().map(|(key, setting)| (key, setting));
            let of_axes = design.axes.iter().map(|axis| &axis.key).zip(point);
            let scene = template.scene(fixed.chain(of_axes))?;
            if scene.steps() == 0 && count == sweep.set.len() && point.len() == design.axes.len() {
                return Err(SceneError::plain(&sweep.scene_file, NO_STEP.to_owned()));
            }
            if template.base().model != Model::Oscillators {
                return Ok(()); // whatever the values are: the sweep says so when it runs
            }
            let supported = models::need_oscillators(&scene, "a sweep");
            return supported.map_err(|error| SceneError::plain(&sweep.scene_file, error.to_string()));
        }
        let invalid = match sweep.own(point) {
            Some(Err(invalid)) => invalid,
            _ => return Ok(()),
        };
        let (file, key) = (sweep.scene_file.clone(), invalid.key.unwrap_or_default());
        Err(SceneError { key, ..SceneError::plain(&file, invalid.text) })
    };
    for index in 0..sweep.set.len() {
        if let Err(error) = check(index + 1, &[]) {
            return Err(sets[index].error(if is_unknown(&error) { "key" } else { "value" }, in_words(&error)));
        }
    }
    let is_of_time = |key: &KeyPath| ["dt", "duration"].contains(&key.to_string().as_str());
    let of_axis = |index: usize, value: &Setting, error: &SceneError| {
        let (mut index, mut value) = (index, value);
        if error.message == NO_STEP && !is_of_time(&design.axes[index].key) {
            if let Some(set) = sweep.set.iter().position(|(key, _)| is_of_time(key)) {
                return sets[set].error("value", NO_STEP.to_owned());
            }
            if let Some(axis) = design.axes.iter().position(|axis| is_of_time(&axis.key)) {
                (index, value) = (axis, &first[axis]);
            }
        }
        let table = &axes[index];
        if is_unknown(error) {
            return table.error("key", in_words(error));
        }
        let last = design.axes[index].sample(design.axes[index].sample_count() - 1);
        let is_last = *value == last && *value != first[index];
        let at = ["values", if is_last { "to" } else { "from" }].into_iter().find(|at| table.get(at).is_some());
        let at = if at == Some("from") && *value != first[index] { "count" } else { at.unwrap_or("from") };
        let key = &design.axes[index].key;
        table.error(at, format!("{key} = {value} makes the scene invalid: {}", in_words(error)))
    };
    let last: Vec<Setting> = design.axes.iter().map(|axis| axis.sample(axis.sample_count() - 1)).collect();
    if check(sweep.set.len(), &first).is_err() && check(sweep.set.len(), &last).is_err() {
        // the first axis with whose first value the scene becomes invalid
        for (index, value) in first.iter().enumerate() {
            check(sweep.set.len(), &first[..=index]).map_err(|error| of_axis(index, value, &error))?;
        }
    }
    let mut invalid = None;
    let mut fails_together = |point: &[Setting], error: &SceneError| {
        let values = design.axes.iter().zip(point).map(|(axis, value)| format!("{} = {value}", axis.key));
        let values = crate::text::listed(&values.collect::<Vec<_>>());
        invalid.get_or_insert_with(|| format!("{values} together make the scene invalid: {}", in_words(error)));
    };
    for (index, axis) in design.axes.iter().enumerate() {
        let stride = axis.sample_count().div_ceil(MAX_VALIDATED).max(1);
        let all = (0..axis.sample_count()).step_by(stride as usize).chain([axis.sample_count() - 1]);
        for sample in all {
            let [with_first, with_last] = [&first, &last].map(|end| {
                let mut point = end.clone();
                point[index] = axis.sample(sample);
                point
            });
            if let Err(error) = check(sweep.set.len(), &with_first) {
                check(sweep.set.len(), &with_last).map_err(|_| of_axis(index, &with_first[index], &error))?;
                fails_together(&with_first, &error);
            }
        }
    }
    for corner in 0..1u32 << design.axes.len() {
        let ends = design.axes.iter().enumerate().map(|(index, axis)| {
            if corner >> index & 1 == 1 { axis.sample(axis.sample_count() - 1) } else { axis.sample(0) }
        });
        let point: Vec<Setting> = ends.collect();
        if let Err(error) = check(sweep.set.len(), &point) {
            fails_together(&point, &error);
        }
    }
    match design.count() {
        Some(count) if count <= MOST_ROWS => Ok(invalid),
        count => {
            let product = || design.axes.iter().map(|axis| axis.sample_count() as f64).product::<f64>();
            let runs = count.map_or_else(|| format!("{:e}", product()), thousands);
            // of samples, the count is at the top
            let counted = if root.get("count").is_some() { root } else { &axes[0] };
            Err(counted.error("count", format!("{runs} runs are too many")).with_help(format!(
                "lower the counts: a sweep has at most {} runs, and --refine finds boundaries",
                thousands(MOST_ROWS)
            )))
        }
    }
}

fn is_unknown(error: &SceneError) -> bool {
    error.message.starts_with("unknown key") || error.message.starts_with("there is no")
}

/// Describes an error in a variation of the scene, without a position: its text is in no file.
fn in_words(error: &SceneError) -> String {
    SceneError { place: None, ..error.clone() }.to_string()
}

/// Describes a time [s] in words.
pub fn duration(seconds: f64) -> String {
    const UNITS: [(&str, f64); 5] =
        [("years", 365.25 * 86_400.0), ("days", 86_400.0), ("hours", 3600.0), ("minutes", 60.0), ("seconds", 1.0)];
    let unit = UNITS.iter().find(|(_, length)| seconds >= 2.0 * length).unwrap_or(&UNITS[4]);
    let number = seconds / unit.1;
    if number >= 1e6 {
        format!("{number:.1e} {}", unit.0)
    } else if number >= 10.0 {
        format!("{} {}", thousands(number.round() as u64), unit.0)
    } else {
        format!("{number:.1} {}", unit.0)
    }
}
