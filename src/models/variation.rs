//! Scenes with other numbers: what `meldscope live` varies.

use std::{collections::BTreeMap, sync::Arc};

use super::SceneRun;
use crate::{
    observe::{Experiment, InvalidVariation, Parameter},
    scene::{
        Scene,
        numbers::{Number, numbers},
        template::{KeyPath, Setting, Template},
    },
};

/// The numbers of a scene that get sliders.
pub fn parameters(run: &SceneRun) -> Vec<Parameter> {
    let parameter = |number: Number| Parameter {
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

/// The scene with other numbers.
///
/// # Errors
/// A key is unknown, or the scene with these values is invalid.
pub fn varied(run: &SceneRun, values: &BTreeMap<String, f64>) -> Result<Arc<dyn Experiment>, InvalidVariation> {
    if values.is_empty() {
        return Ok(Arc::new(run.clone()));
    }
    let name = &run.scene.name;
    let unknown = |text: String| InvalidVariation { key: None, text };
    let template = Template::new(&run.scene.source, name, None).map_err(|error| unknown(error.to_string()))?;
    let mut settings = Vec::with_capacity(values.len());
    for (key, &value) in values {
        let path = KeyPath::parse(key).map_err(|text| InvalidVariation { key: Some(key.clone()), text })?;
        settings.push((path, Setting::Number(value)));
    }
    let text = template.text(settings.iter().map(|(path, setting)| (path, setting))).map_err(|error| {
        // the error names the key as the parser knows it, which for an item of an array is not its path
        let last = |key: &str| key.rsplit('.').next().unwrap_or_default().split('[').next().map(str::to_owned);
        let is_it = |key: &&String| error.key == **key || last(&error.key).is_some_and(|name| last(key) == Some(name));
        let changed = values.keys().find(|key| error.key == **key).or_else(|| values.keys().find(is_it)).cloned();
        let key = changed.or_else(|| Some(error.key.clone()).filter(|key| !key.is_empty()));
        InvalidVariation { key, text: error.to_string() }
    })?;
    let scene = Scene::parse(&text, name).map_err(|error| unknown(error.to_string()))?;
    Ok(Arc::new(SceneRun { scene, options: run.options }))
}
