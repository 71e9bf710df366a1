//! Scenes with other numbers: what `meldscope live` varies.

use std::{
    collections::BTreeMap,
    fmt::{self, Write as _},
    sync::Arc,
};

use super::SceneRun;
use crate::{
    observe::{Branch, Experiment, InvalidVariation, Parameter, Poke, Variation},
    scene::{
        Model, Scene,
        numbers::{Number, numbers},
        template::{KeyPath, Setting, Template},
    },
};

/// The numbers of a scene that get sliders.
pub fn parameters(run: &SceneRun) -> Vec<Parameter> {
    let parameter = |number: Number| Parameter {
        can_branch: run.scene.model == Model::Oscillators && Scene::can_edit(&number.path),
        key: number.path,
        group: number.group,
        label: number.name,
        unit: number.unit.to_owned(),
        about: number.about.to_owned(),
        value: number.value,
        range: number.usual,
    };
    numbers(&run.scene).into_iter().map(parameter).collect()
}

/// The scene with other numbers, with further edits, and with a force point.
///
/// # Errors
/// A key is unknown, or the scene with these values is invalid.
pub fn varied(run: &SceneRun, variation: &Variation) -> Result<Arc<dyn Experiment>, InvalidVariation> {
    if variation.is_empty() {
        return Ok(Arc::new(run.clone()));
    }
    let Variation { values, branches, poke } = variation;
    let name = &run.scene.name;
    let mut added = String::new();
    if let Some(poke) = poke {
        let _ = write_point(&mut added, poke, &run.scene);
    }
    for branch in branches.iter().filter(|branch| !branch.values.is_empty()) {
        let _ = write_edit(&mut added, branch);
    }
    let base = run.scene.clone().rewritten(name);
    let base = base.map_err(|error| InvalidVariation { key: None, text: error.to_string() })?;
    let text = if values.is_empty() { base.source } else { with_values(&base, values)? };
    // an embedded mesh ends the text
    let (own, meshes) = text.split_at(Scene::without_meshes(&text).len());
    let scene = Scene::parse(&format!("{own}{added}{meshes}"), name).map_err(|error| {
        let mut keys = branches.iter().flat_map(|branch| branch.values.keys());
        let only = keys.clone().next().filter(|_| keys.clone().count() == 1);
        let key = keys.find(|key| error.key.contains(key.as_str())).or(only).cloned();
        // of generated text, the place means nothing
        let what = if error.key.starts_with("edit") { "this branch" } else { &error.key };
        let help = error.help.map_or_else(String::new, |help| format!("; {help}"));
        InvalidVariation { key, text: format!("{what}: {}{help}", error.message) }
    })?;
    let Scene { integrator, model, .. } = run.scene;
    Ok(Arc::new(SceneRun { scene: Scene { integrator, model, ..scene }, options: run.options }))
}

fn write_point(text: &mut String, poke: &Poke, scene: &Scene) -> fmt::Result {
    let Poke { body, at, radius, strength } = poke;
    let is_taken = |name: &str| scene.points.iter().any(|point| point.name == name);
    let name = (1..).map(|n| if n == 1 { "poke".to_owned() } else { format!("poke-{n}") }).find(|name| !is_taken(name));
    let (act, own) = if *strength < 0.0 { ("repel", "beta") } else { ("attract", "alpha") };
    write!(
        text,
        "\n[[point]]\nname = \"{}\"\nmotion = {{ fixed = [{:?}, {:?}, {:?}] }}\nradius = {radius:?}\nact = \"{act}\"\n\
         {own} = {:?}\nbodies = [{}]\n",
        name.unwrap_or_default(),
        at.x,
        at.y,
        at.z,
        strength.abs(),
        toml::Value::String(body.clone()),
    )
}

fn write_edit(text: &mut String, branch: &Branch) -> fmt::Result {
    let quoted = |key: &String| toml::Value::String(key.clone());
    let set: Vec<String> = branch.values.iter().map(|(key, value)| format!("{} = {value:?}", quoted(key))).collect();
    write!(text, "\n[[edit]]\ntime = {:?}\nset = {{ {} }}\n", branch.time, set.join(", "))
}

/// The text of the scene with other numbers.
fn with_values(scene: &Scene, values: &BTreeMap<String, f64>) -> Result<String, InvalidVariation> {
    let unknown = |text: String| InvalidVariation { key: None, text };
    let template = Template::new(&scene.source, &scene.name, None).map_err(|error| unknown(error.to_string()))?;
    let mut settings = Vec::with_capacity(values.len());
    for (key, &value) in values {
        let path = KeyPath::parse(key).map_err(|text| InvalidVariation { key: Some(key.clone()), text })?;
        settings.push((path, Setting::Number(value)));
    }
    template.text(settings.iter().map(|(path, setting)| (path, setting))).map_err(|error| {
        // of a text that nobody has written, the place means nothing
        let error = crate::scene::SceneError { place: None, ..error };
        // the error names the key as the parser knows it, which for an item of an array is not its path
        let last = |key: &str| key.rsplit('.').next().unwrap_or_default().split('[').next().map(str::to_owned);
        let is_it = |key: &&String| error.key == **key || last(&error.key).is_some_and(|name| last(key) == Some(name));
        let changed = values.keys().find(|key| error.key == **key).or_else(|| values.keys().find(is_it)).cloned();
        let key = changed.or_else(|| Some(error.key.clone()).filter(|key| !key.is_empty()));
        InvalidVariation { key, text: error.to_string() }
    })
}
