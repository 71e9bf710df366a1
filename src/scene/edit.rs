//! `[[edit]]`: from an instant on, other values for some numbers of a scene.

use std::sync::Arc;

use glam::DVec3;

use super::{ForFree, Material, PairLaws, Point, Scene};
use crate::model::{PairLaw, influence::Influence, phase::Thresholds, shape_matching::Plane};

/// An edit this close to the end of a step is at its end but for rounding [Δt].
pub(crate) const ROUNDING: f64 = 1e-9;

/// An edit: from an instant on, some numbers of the scene have other values. Every force may jump at that
/// instant, and a pair whose thresholds have passed its q changes phase.
#[derive(Clone, Debug, PartialEq)]
pub struct Edit {
    /// The instant [s], ≥ 0.
    pub time: f64,
    /// What it sets, as lines of TOML without quotes around the keys: `influence.merge_at = 1.1`.
    pub set: Vec<String>,
    /// The numbers of the scene that an edit can change, until then …
    before: Arc<Numbers>,
    /// … and from then on.
    numbers: Arc<Numbers>,
}

/// The numbers of a scene that an edit can change.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Numbers {
    pub influence: Influence,
    pub thresholds: Thresholds,
    pub core_width: f64,
    pub for_free: ForFree,
    pub pairs: PairLaws,
    pub gravity: DVec3,
    pub planes: Vec<Plane>,
    pub points: Vec<Point>,
    /// Of each body.
    materials: Vec<Material>,
    /// Of each body.
    pub reaches: Vec<f64>,
}

impl Numbers {
    fn of(scene: &Scene) -> Numbers {
        let Scene { influence, thresholds, core_width, for_free, gravity, .. } = *scene;
        let (pairs, planes, points) = (scene.pairs.clone(), scene.planes.clone(), scene.points.clone());
        let materials = scene.bodies.iter().map(|body| body.material).collect();
        let reaches = scene.bodies.iter().map(|body| body.reach).collect();
        Numbers { influence, thresholds, core_width, for_free, pairs, gravity, planes, points, materials, reaches }
    }

    /// Appends a body, in the group of body `like` if there is one.
    fn add_body(&mut self, body: &super::Body, like: Option<usize>) {
        self.pairs.add_body(self.materials.len(), like);
        self.materials.push(body.material);
        self.reaches.push(body.reach);
    }

    /// Removes a body; the indices of later bodies decrease by one.
    fn remove_body(&mut self, index: usize) {
        self.pairs.remove_body(index);
        if index < self.materials.len() {
            self.materials.remove(index);
            self.reaches.remove(index);
        }
        self.points.iter_mut().for_each(|point| point.remove_body(index));
    }

    /// Like [`Scene::common_law`].
    pub fn common_law(&self) -> PairLaw {
        common_law(&self.influence, self.thresholds, self.core_width, self.for_free)
    }

    /// The common law and those of pairs.
    fn laws(&self) -> impl Iterator<Item = PairLaw> + '_ {
        std::iter::once(self.common_law()).chain(self.pairs.laws().iter().copied())
    }
}

/// The law of pairs that do not have their own.
pub(super) fn common_law(influence: &Influence, thresholds: Thresholds, core_width: f64, for_free: ForFree) -> PairLaw {
    let Influence { alpha, beta, apart_repels, .. } = *influence;
    PairLaw { alpha, beta, apart_repels, thresholds, core_width, for_free }
}

impl Edit {
    /// The edit at `time` [s] of `scene`, or of what `earlier` made of it, that leads to `after`, a scene with the same bodies.
    pub(super) fn new(time: f64, set: Vec<String>, scene: &Scene, earlier: Option<&Edit>, after: &Scene) -> Edit {
        let before = earlier.map_or_else(|| Arc::new(Numbers::of(scene)), |edit| Arc::clone(&edit.numbers));
        Edit { time, set, before, numbers: Arc::new(Numbers::of(after)) }
    }

    /// Whether it was made from this scene, or from what the `earlier` edit makes of it.
    pub(super) fn follows(&self, scene: &Scene, earlier: Option<&Edit>) -> bool {
        earlier.map_or_else(
            || *self.before == Numbers::of(scene),
            |edit| Arc::ptr_eq(&self.before, &edit.numbers) || self.before == edit.numbers,
        )
    }

    /// The numbers that hold from then on.
    pub(crate) fn numbers(&self) -> &Numbers {
        &self.numbers
    }

    /// Number of bodies of the scene.
    pub(crate) fn body_count(&self) -> usize {
        self.numbers.materials.len()
    }

    /// Whether the state at `time` [s] follows from it. A world enters an edit at the end of a step in the next one.
    pub(crate) fn has_begun(&self, time: f64, dt: f64) -> bool {
        self.time < time - ROUNDING * dt
    }
}

impl Scene {
    /// Appends a body, with what the scene lists by body.
    pub(crate) fn add_body(&mut self, body: super::Body) {
        let known = self.bodies.iter().position(|other| body.group.is_some() && other.group == body.group);
        self.pairs.add_body(self.bodies.len(), known);
        self.change_edits(|numbers| numbers.add_body(&body, known));
        self.bodies.push(body);
    }

    /// Changes the numbers of all edits, each of which begins where the one before ends.
    fn change_edits(&mut self, change: impl Fn(&mut Numbers)) {
        let mut before: Option<Arc<Numbers>> = None;
        for edit in &mut self.edits {
            match before {
                Some(before) => edit.before = before,
                None => change(Arc::make_mut(&mut edit.before)),
            }
            change(Arc::make_mut(&mut edit.numbers));
            before = Some(Arc::clone(&edit.numbers));
        }
    }

    /// Removes a body, its pushes, and itself from what the scene lists by body; the indices of later bodies decrease by
    /// one. Laws of particular pairs must not name it.
    pub(crate) fn remove_body(&mut self, index: usize) {
        self.bodies.remove(index);
        self.pairs.remove_body(index);
        self.pushes.retain(|push| push.body != index);
        self.pushes.iter_mut().filter(|push| push.body > index).for_each(|push| push.body -= 1);
        self.points.iter_mut().for_each(|point| point.remove_body(index));
        self.change_edits(|numbers| numbers.remove_body(index));
    }

    /// The scene from edit `index` on; it keeps the list of edits.
    pub(crate) fn after_edit(&self, index: usize) -> Scene {
        let numbers = &self.edits[index].numbers;
        let Numbers { influence, thresholds, core_width, for_free, gravity, .. } = **numbers;
        let mut scene = Scene {
            influence,
            thresholds,
            core_width,
            for_free,
            pairs: numbers.pairs.clone(),
            gravity,
            planes: numbers.planes.clone(),
            points: numbers.points.clone(),
            ..self.clone()
        };
        for (body, (material, reach)) in scene.bodies.iter_mut().zip(numbers.materials.iter().zip(&numbers.reaches)) {
            (body.material, body.reach) = (*material, *reach);
        }
        scene
    }

    /// Whether an edit leads to a scene that needs the coupled solver.
    pub(super) fn becomes_coupled(&self) -> bool {
        self.edits.iter().any(|edit| edit.numbers.laws().any(|law| law.core_width > 0.0))
    }

    /// The lowest level of a threshold, from the start or else after an edit; `None` if it never exists.
    pub(crate) fn lowest_level(&self, level: impl Fn(&PairLaw) -> Option<f64>) -> Option<f64> {
        let lowest = |laws: &mut dyn Iterator<Item = PairLaw>| laws.filter_map(|law| level(&law)).reduce(f64::min);
        lowest(&mut self.laws()).or_else(|| self.edits.iter().find_map(|edit| lowest(&mut edit.numbers.laws())))
    }

    /// Whether there is gravity, from the start or after an edit.
    pub(crate) fn ever_has_gravity(&self) -> bool {
        self.gravity != DVec3::ZERO || self.edits.iter().any(|edit| edit.numbers.gravity != DVec3::ZERO)
    }
}
