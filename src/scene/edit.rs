//! `[[edit]]`: from an instant on, other values for some numbers of a scene.

use glam::DVec3;

use super::{ForFree, Material, PairLaws, Point, Scene};
use crate::model::{influence::Influence, phase::Thresholds, shape_matching::Plane};

/// An edit: from an instant on, and for good, some numbers of the scene have other values. Every force may jump at that
/// instant, and a pair whose thresholds have passed its q changes phase.
#[derive(Clone, Debug)]
pub struct Edit {
    /// The instant [s], ≥ 0.
    pub time: f64,
    /// What it sets, as lines of TOML without quotes around the keys: `influence.merge_at = 1.1`.
    pub set: Vec<String>,
    /// The numbers of the scene that an edit can change, from then on.
    numbers: Numbers,
}

/// The numbers of a scene that an edit can change.
#[derive(Clone, Debug)]
struct Numbers {
    influence: Influence,
    thresholds: Thresholds,
    core_width: f64,
    for_free: ForFree,
    pairs: PairLaws,
    gravity: DVec3,
    planes: Vec<Plane>,
    points: Vec<Point>,
    /// Of each body.
    materials: Vec<Material>,
}

impl Edit {
    /// The edit at `time` [s] that leads to `after`, a scene with the same bodies.
    pub(super) fn new(time: f64, set: Vec<String>, after: Scene) -> Edit {
        let Scene { influence, thresholds, core_width, for_free, pairs, gravity, planes, points, bodies, .. } = after;
        let materials = bodies.iter().map(|body| body.material).collect();
        let numbers =
            Numbers { influence, thresholds, core_width, for_free, pairs, gravity, planes, points, materials };
        Edit { time, set, numbers }
    }

    /// Removes a body; the indices of later bodies decrease by one.
    pub(crate) fn remove_body(&mut self, index: usize) {
        if index < self.numbers.materials.len() {
            self.numbers.materials.remove(index);
        }
        self.numbers.points.iter_mut().for_each(|point| point.remove_body(index));
    }
}

impl Scene {
    /// The scene from edit `index` on; it keeps the list of edits.
    pub(crate) fn after_edit(&self, index: usize) -> Scene {
        let Numbers { influence, thresholds, core_width, for_free, pairs, gravity, planes, points, materials } =
            self.edits[index].numbers.clone();
        let mut scene =
            Scene { influence, thresholds, core_width, for_free, pairs, gravity, planes, points, ..self.clone() };
        for (body, material) in scene.bodies.iter_mut().zip(materials) {
            body.material = material;
        }
        scene
    }

    /// When the last edit in [start, end) is entered, if there is one [s].
    pub(crate) fn last_edit(&self, start: f64, end: f64) -> Option<f64> {
        self.edits.iter().map(|edit| edit.time).rfind(|time| (start..end).contains(time))
    }

    /// Whether an edit leads to a scene that needs the coupled solver.
    pub(super) fn becomes_coupled(&self) -> bool {
        self.edits.iter().any(|Edit { numbers, .. }| {
            numbers.core_width > 0.0 || numbers.pairs.laws().iter().any(|law| law.core_width > 0.0)
        })
    }
}
