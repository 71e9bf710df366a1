//! The phases of pairs whose centres are both on paths: found by scanning their distance and bisecting, whatever the
//! vertices do.

use rayon::prelude::*;

use super::{NoReference, PhaseChange, ROUNDING};
use crate::{
    bench::path,
    model::phase::{Phase, Thresholds, Transition},
    scene::Scene,
};

/// The phases of a pair that is not apart throughout.
pub(super) struct History {
    pub(super) a: usize,
    pub(super) b: usize,
    /// The phase at t = 0.
    first: Phase,
    pub(super) changes: Vec<PhaseChange>,
}

impl History {
    /// The phase at time `t` [s].
    pub(super) fn phase_at(&self, t: f64) -> Phase {
        self.changes.iter().rev().find(|change| change.time <= t).map_or(self.first, |change| change.to)
    }
}

/// A visit to another phase can be missed if it is shorter than this [s] …
const MIN_VISIT: f64 = 1e-6;
/// … and q changes by less than this during it [–].
const MIN_CHANGE: f64 = 1e-4;
/// Upper limit on the samples of a pair's distance: about a second.
const MAX_SAMPLES: u64 = 10_000_000;

/// The histories of all pairs on paths that are ever in a phase other than apart, ascending.
pub(super) fn histories(scene: &Scene, end: f64) -> Result<Vec<History>, NoReference> {
    let on_paths: Vec<usize> = (0..scene.bodies.len()).filter(|&body| scene.bodies[body].path().is_some()).collect();
    let pairs = |k: usize| on_paths[k + 1..].iter().map(move |&b| (k, b));
    let all = (0..on_paths.len()).into_par_iter().flat_map_iter(pairs).map(|(k, b)| (on_paths[k], b));
    let found = all.map(|(a, b)| history(scene, a, b, end));
    let is_ever_close = |history: &History| history.first != Phase::Apart || !history.changes.is_empty();
    found.filter(|history| history.as_ref().map_or(true, is_ever_close)).collect()
}

fn history(scene: &Scene, a: usize, b: usize, end: f64) -> Result<History, NoReference> {
    let (one, other) = (&scene.bodies[a], &scene.bodies[b]);
    let radii = one.radius + other.radius;
    let q = |t| (path(one).position(t) - path(other).position(t)).length() / radii;
    let thresholds = scene.law(a, b).thresholds;
    let Thresholds { merge_at, split_at, core_at } = thresholds;

    let mut phase = thresholds.initial(q(0.0));
    let mut history = History { a, b, first: phase, changes: vec![] };
    if path(one).relative_bounds(path(other), 0.0, end).speed == 0.0 {
        return Ok(history); // q is constant, and its phase with it, even if q equals one or two thresholds
    }
    let mut t = 0.0;
    let mut watch = Watch::default();
    for _ in 0..MAX_SAMPLES {
        if t >= end {
            return Ok(history);
        }
        // no threshold can be reached before the centres have moved that far
        let far = [merge_at, split_at, core_at].map(|level| (q(t) - level).abs()).into_iter().fold(f64::MAX, f64::min);
        let stretch = f64::min(end - t, 0.1);
        let speed = path(one).relative_bounds(path(other), t, t + stretch).speed;
        let safe = if far * radii >= speed * stretch { stretch } else { far * radii / speed };
        let shortest = f64::min(MIN_VISIT, MIN_CHANGE * radii / speed);
        let mut later = f64::min(end, t + f64::max(safe, shortest));
        if later <= t {
            break; // too fast for the resolution of t
        }
        let distances =
            [one, other].map(|body| path(body).position(0.0).length() + path(body).position(later).length());
        let uncertainty = ROUNDING * (1.0 + distances.iter().sum::<f64>() / radii);
        if let Some(passage) = watch.check(thresholds.transitions(phase), q(t), q(later), uncertainty) {
            let mut earlier = t;
            loop {
                let middle = 0.5 * (earlier + later);
                if middle <= earlier || middle >= later {
                    break;
                }
                if passage.has_happened(q(middle)) { later = middle } else { earlier = middle }
            }
            phase = passage.transition.to;
            history.changes.push(PhaseChange { time: later, a, b, to: phase });
            watch = Watch::default();
        }
        t = later;
    }
    Err(NoReference::Undecided { a, b, time: t })
}

/// Distance of q from completing a transition [–]: zero on the level, negative beyond.
fn gap(transition: Transition, q: f64) -> f64 {
    if transition.falling { q - transition.level } else { transition.level - q }
}

/// Whether reaching the level of a transition is enough, without passing it.
fn is_on_level_enough(transition: Transition) -> bool {
    transition.to != Phase::Core
}

/// Watches a pair for the end of its current phase.
///
/// Two levels may coincide. A pair on such a level could be in either phase, and rounding alone would make it alternate
/// forever. Its phase therefore changes only if q reaches the level from a clear distance, or is clearly beyond it.
#[derive(Default)]
struct Watch {
    /// For each level, whether the pair has been at a clear distance from it since the phase began.
    was_clear: [bool; 2],
}

/// A level has been passed, or approached to within the tolerance.
struct Passage {
    transition: Transition,
    within: f64,
}

impl Passage {
    fn has_happened(&self, q: f64) -> bool {
        let gap = gap(self.transition, q) - self.within;
        gap < 0.0 || gap == 0.0 && is_on_level_enough(self.transition)
    }
}

impl Watch {
    /// Checks q at two successive times, with an uncertainty of `uncertainty`.
    fn check(
        &mut self,
        transitions: impl Iterator<Item = Transition>,
        before: f64,
        now: f64,
        uncertainty: f64,
    ) -> Option<Passage> {
        for (transition, was_clear) in transitions.zip(&mut self.was_clear) {
            *was_clear |= gap(transition, before) > uncertainty;
            let gap = gap(transition, now);
            if gap < -uncertainty || *was_clear && is_on_level_enough(transition) && gap <= uncertainty {
                // the level itself, unless the pair comes to rest just short of it
                return Some(Passage { transition, within: f64::max(0.0, gap) });
            }
        }
        None
    }
}
