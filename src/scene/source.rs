//! What a recording needs to create a scene again: its text, and what a run changes in it.

use super::{Body, ForFree, Model, Scene, SceneError};

/// The name of the first of these fields in which two values differ.
macro_rules! first_difference {
    ($one:expr, $other:expr; $Type:ident { $($field:ident),+ } except $($ignored:ident),+) => {{
        let $Type { $($field,)+ $($ignored: _),+ } = $one; // all fields: a new one does not compile until it is listed
        [$((stringify!($field), *$field == $other.$field)),+].into_iter().find(|(_, is_same)| !is_same).map(|(name, _)| name)
    }};
}

impl Scene {
    /// What a run of this scene changes in its text, as lines of TOML: the keys that were [set](Scene::set), then the
    /// model, the integrator, the step, the tolerance, and the number of steps (`None`: until stopped).
    ///
    /// # Errors
    /// The text describes another scene, because a program has changed this one: names a field that differs.
    pub fn overrides(&self, steps: Option<u64>) -> Result<String, String> {
        self.overrides_after(0, steps)
    }

    /// Like [`Scene::overrides`], for a scene some of whose edits a run has entered.
    pub(crate) fn overrides_after(&self, edits: usize, steps: Option<u64>) -> Result<String, String> {
        if self.source.is_empty() {
            return Ok(String::new());
        }
        let own = Scene::parse(&self.source, &self.name).and_then(|own| own.with(&self.set, &self.name));
        let mut own = own.map_err(|error| format!("the text of the scene is not valid: {error}"))?;
        if !self.has_core_defaults() {
            own.drop_core_defaults();
        }
        if let Some(last) = edits.checked_sub(1).filter(|&last| last < own.edits.len()) {
            own = own.after_edit(last);
        }
        if let Some(field) = self.difference(&own) {
            return Err(format!(
                "a program has changed `{field}` of the scene \"{}\", so its text describes another one and no recording could be run \
                 again; give it its new text with `Scene::with_source`, or an empty one for a recording that is only to be \
                 looked at",
                self.name
            ));
        }
        let changed = [
            (own.model != self.model).then(|| format!("model = \"{}\"\n", self.model)),
            (own.integrator != self.integrator).then(|| format!("integrator = \"{}\"\n", self.integrator)),
            (own.dt != self.dt).then(|| format!("dt = {:?}\n", self.dt)),
            (own.tolerance != self.tolerance).then(|| format!("tolerance = {:?}\n", self.tolerance)),
            (Some(own.steps()) != steps).then(|| format!("steps = {}\n", steps.unwrap_or(0))),
        ];
        Ok(self.set.iter().map(|one| format!("{one}\n")).chain(changed.into_iter().flatten()).collect())
    }

    /// The scene with a text that describes it, after a program has changed it. With an empty text, recordings of it
    /// cannot be run again.
    ///
    /// # Errors
    /// The text is not that of a scene. Whether it is that of this one is checked before it is recorded.
    pub fn with_source(self, source: &str) -> Result<Scene, SceneError> {
        if !source.is_empty() {
            Scene::parse(source, &self.name)?;
        }
        Ok(Scene { source: source.to_owned(), set: Vec::new(), ..self })
    }

    /// A field in which the scene differs from another one, apart from its name and what [`Scene::overrides`] lists.
    fn difference(&self, other: &Scene) -> Option<String> {
        let named = match self.bodies.len() == other.bodies.len() {
            true => first_difference!(
                self, other; Scene {
                    lattice, fem, influence, thresholds, core_width, for_free, pairs, gravity, planes, blend, points, pushes, edits
                } except name, dt, duration, integrator, model, tolerance, bodies, source, set, pushed_out
            ),
            false => Some("bodies"),
        };
        let of_body = || {
            let mut bodies = self.bodies.iter().zip(&other.bodies).enumerate();
            bodies.find_map(|(index, (body, other))| Some(format!("bodies[{index}].{}", body.difference(other)?)))
        };
        named.map(str::to_owned).or_else(of_body)
    }

    fn has_core_defaults(&self) -> bool {
        std::iter::once(&self.common_law()).chain(self.pairs.laws()).any(|law| law.for_free != ForFree::Nothing)
    }

    /// The settings of a run, as lines of TOML: what a recording needs besides the scene's text. The default model is
    /// omitted, for compatibility with recordings made before other models existed.
    pub fn run_settings(&self) -> String {
        let model = match self.model {
            Model::Oscillators => String::new(),
            model => format!("model = \"{model}\"\n"),
        };
        let cores = if self.has_core_defaults() { "free_cores = true\n" } else { "" };
        let set = match self.set.as_slice() {
            [] => String::new(),
            set => format!("set = {}\n", toml::Value::from(set.iter().map(ToString::to_string).collect::<Vec<_>>())),
        };
        let Scene { integrator, dt, tolerance, .. } = self;
        format!("integrator = \"{integrator}\"\ndt = {dt:?}\ntolerance = {tolerance:?}\n{model}{cores}{set}")
    }
}

impl Body {
    /// A field in which the body differs from another one.
    fn difference(&self, other: &Body) -> Option<&'static str> {
        let named = first_difference!(
            self, other; Body { name, radius, reach, material, shape, mass, group, color, motion } except force
        );
        named.or((self.force.is_some() || other.force.is_some()).then_some("force"))
    }
}
