//! An independent solution of a scene, against which the integrators are compared.
//!
//! It uses nothing from [`crate::sim`]. The equation of motion is implemented here a second time, from the model alone.
//! Pair phases are found by scanning the distances and bisecting. Each vertex is integrated separately by
//! [extrapolation], restarted wherever the right-hand side jumps (pair phases, pushes, keyframes)
//! and at every requested instant.
//!
//! The weight has a kink at the rim of an influence sphere. Within a step, a vertex that starts inside a sphere
//! keeps the inside law even after leaving it, and vice versa, so the law is smooth over each step. Root finding then
//! locates the crossing, and the step ends there.

use std::sync::OnceLock;

use glam::DVec3;
use rayon::prelude::*;

use super::{
    extrapolation::{self, Step},
    path,
};
use crate::{
    model::{
        PairLaw,
        influence::{Scaling, Weight},
        phase::Phase,
    },
    scene::{Body, Path, Push, Response, Scene, path::Kinematics},
};

/// The accuracy of a reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Accuracy {
    /// Permitted error of a step [–]: of a displacement in radii of the body; of a velocity in radii times the largest
    /// rate of the scene.
    pub tolerance: f64,
    /// The longest step, in units of the inverse of that rate [–]: short enough that a vertex cannot turn twice in it.
    pub longest_step: f64,
}

impl Accuracy {
    /// Gives the [stated](Reference::ACCURACY) accuracy of 1e-11 of a radius.
    pub const DEFAULT: Accuracy = Accuracy { tolerance: 1e-13, longest_step: 0.25 };
    /// Ten times as accurate, for measuring the accuracy of the default.
    pub const TIGHTER: Accuracy = Accuracy { tolerance: 1e-14, longest_step: 0.125 };
}

/// Why a scene has no reference solution.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum NoReference {
    /// The solution would take too long.
    #[error(
        "a reference solution would take {evaluations:.0e} evaluations of the equation of motion, more than \
         {MAX_EVALUATIONS:.0e}: its explicit method follows the fastest motion (omega, damping, alpha, beta), for every \
         vertex and the whole duration; make the scene softer, smaller or shorter"
    )]
    TooLong {
        /// The estimated number of evaluations.
        evaluations: f64,
    },
    /// The time of a pair's phase change is ambiguous.
    #[error(
        "there is no reference solution: bodies {a} and {b} (counted from 0) come close to merge_at, split_at or core_at \
         so often, so fast or for so long that the times at which they pass it are ambiguous, from {time:e} s on; move \
         the thresholds or shorten the scene"
    )]
    Undecided {
        /// One body of the pair …
        a: usize,
        /// … and the other.
        b: usize,
        /// From this time on [s].
        time: f64,
    },
    /// The solution for a vertex makes no progress.
    #[error(
        "there is no reference solution: a vertex of body {body} (counted from 0) needs too many steps beyond \
         {time:e} s; make the scene softer or shorter"
    )]
    Stuck {
        /// The vertex's body.
        body: usize,
        /// At this time [s].
        time: f64,
    },
    /// The solution for a vertex overflows.
    #[error(
        "there is no reference solution: the state of a vertex of body {body} (counted from 0) overflows at {time:e} s; \
         make the scene softer or smaller"
    )]
    TooLarge {
        /// The vertex's body.
        body: usize,
        /// At this time [s].
        time: f64,
    },
}

/// Upper limit on evaluations of the equation of motion: a few minutes.
const MAX_EVALUATIONS: f64 = 5e9;
/// Evaluations of the equation of motion in a typical step.
const EVALUATIONS_PER_STEP: f64 = 40.0;
/// Relative rounding error of a coordinate after a few operations.
const ROUNDING: f64 = 8.0 * f64::EPSILON;

/// The positions of all vertices at given instants.
pub struct Reference {
    times: Vec<f64>,
    /// `[body][vertex][time]`; empty for a vertex that has stayed at rest.
    tracks: Vec<Vec<Vec<DVec3>>>,
    events: Vec<PhaseChange>,
}

/// A phase change of a pair.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhaseChange {
    /// When it happens [s].
    pub time: f64,
    /// One body of the pair …
    pub a: usize,
    /// … and the other, a < b.
    pub b: usize,
    /// The phase that begins.
    pub to: Phase,
}

impl Reference {
    /// The largest error of a solution with [`Accuracy::DEFAULT`], in radii of the vertex's body.
    pub const ACCURACY: f64 = 1e-11;

    /// Solves `scene` for the displacements at `times` [s], which must be ascending and non-negative.
    ///
    /// # Errors
    /// [`NoReference`] if the scene is too stiff, too large or too long, or if its solution is ambiguous.
    pub fn solve(scene: &Scene, times: &[f64], accuracy: Accuracy) -> Result<Reference, NoReference> {
        let end = times.last().copied().unwrap_or(0.0);
        let evaluations = EVALUATIONS_PER_STEP
            * scene.vertex_count() as f64
            * f64::max(times.len() as f64, end * fastest_rate(scene) / accuracy.longest_step);
        if evaluations > MAX_EVALUATIONS {
            return Err(NoReference::TooLong { evaluations });
        }
        let histories = histories(scene, end)?;
        let tracks = (0..scene.bodies.len())
            .into_par_iter()
            .map(|body| {
                let problem = Problem::new(scene, &histories, times, accuracy, body);
                {
                    let mesh = scene.bodies[body].shape.mesh();
                    let rest = mesh.at(scene.bodies[body].radius);
                    let track = |vertex| problem.track(rest.position(vertex), rest.direction(vertex));
                    (0..rest.len()).into_par_iter().map(track).collect()
                }
            })
            .collect::<Result<_, _>>()?;
        let mut events: Vec<_> = histories.iter().flat_map(|history| history.changes.iter().copied()).collect();
        events.sort_by(|x, y| x.time.total_cmp(&y.time));
        Ok(Reference { times: times.to_vec(), tracks, events })
    }

    /// The requested instants [s].
    pub fn times(&self) -> &[f64] {
        &self.times
    }

    /// The phase changes up to the last instant, in order of time.
    pub fn events(&self) -> &[PhaseChange] {
        &self.events
    }

    /// Displacement x of a vertex from rest at instant `k` [scene unit].
    pub fn displacement(&self, body: usize, vertex: usize, k: usize) -> DVec3 {
        self.tracks[body][vertex].get(k).copied().unwrap_or(DVec3::ZERO)
    }

    /// The largest distance between a body's vertices in this solution at instant `k` and the vertices with the
    /// displacements `found` [scene unit]; NaN if any of those is NaN.
    pub fn distance(&self, body: usize, k: usize, found: impl Iterator<Item = DVec3>) -> f64 {
        let distances = found.enumerate().map(|(vertex, x)| x.distance(self.displacement(body, vertex, k)));
        distances
            .fold(0.0, |largest, distance| if distance <= largest || largest.is_nan() { largest } else { distance })
    }

    /// The largest distance of a vertex from its position in another solution of the same scene at the same times
    /// [radii].
    pub fn largest_difference(&self, other: &Reference, scene: &Scene) -> f64 {
        let samples = (0..self.tracks.len()).flat_map(|body| (0..self.times.len()).map(move |k| (body, k)));
        let apart = samples.map(|(body, k)| {
            let found = (0..self.tracks[body].len()).map(|vertex| other.displacement(body, vertex, k));
            self.distance(body, k, found) / scene.bodies[body].radius
        });
        apart.fold(0.0, f64::max)
    }
}

/// The rate of the fastest motion of a scene [1/s]: of its oscillators, its influence, or its paths.
fn fastest_rate(scene: &Scene) -> f64 {
    let body = |body: &Body| {
        let path = match *path(body) {
            Path::Sine { frequency, .. } => std::f64::consts::TAU * frequency.abs(),
            _ => 0.0,
        };
        body.material.omega.max(body.material.damping).max(path)
    };
    // allows for a few sources acting on one vertex
    let strongest = scene.laws().map(|law| f64::max(law.alpha, law.beta)).fold(0.0, f64::max);
    let influence = (3.0 * strongest).sqrt();
    scene.bodies.iter().map(body).fold(influence, f64::max)
}

// --- pair phases ----------------------------------------------------------------------------------------------------

/// The phases of a pair that is not apart throughout.
struct History {
    a: usize,
    b: usize,
    /// The phase at t = 0.
    first: Phase,
    changes: Vec<PhaseChange>,
}

impl History {
    fn phase_at(&self, t: f64) -> Phase {
        self.changes.iter().rev().find(|change| change.time <= t).map_or(self.first, |change| change.to)
    }
}

/// A visit to another phase can be missed if it is shorter than this [s] …
const MIN_VISIT: f64 = 1e-6;
/// … and q changes by less than this during it [–].
const MIN_CHANGE: f64 = 1e-4;
/// Upper limit on the samples of a pair's distance: about a second.
const MAX_SAMPLES: u64 = 10_000_000;

/// The histories of all pairs that are ever in a phase other than apart, ascending.
fn histories(scene: &Scene, end: f64) -> Result<Vec<History>, NoReference> {
    let pairs = |a| (a + 1..scene.bodies.len()).map(move |b| (a, b));
    let all = (0..scene.bodies.len()).into_par_iter().flat_map_iter(pairs);
    let found = all.map(|(a, b)| history(scene, a, b, end));
    let is_ever_close = |history: &History| history.first != Phase::Apart || !history.changes.is_empty();
    found.filter(|history| history.as_ref().map_or(true, is_ever_close)).collect()
}

fn history(scene: &Scene, a: usize, b: usize, end: f64) -> Result<History, NoReference> {
    let (one, other) = (&scene.bodies[a], &scene.bodies[b]);
    let radii = one.radius + other.radius;
    let q = |t| (path(one).position(t) - path(other).position(t)).length() / radii;
    let thresholds = scene.law(a, b).thresholds;
    let crate::model::phase::Thresholds { merge_at, split_at, core_at } = thresholds;

    let mut phase = Phase::Apart;
    if q(0.0) <= merge_at {
        phase = Phase::Merged;
    }
    if q(0.0) < core_at {
        phase = Phase::Core;
    }
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
        if let Some(passage) = watch.check(&transitions(phase, &thresholds), q(t), q(later), uncertainty) {
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

/// A transition out of a phase: q passes a level, falling or rising.
#[derive(Clone, Copy)]
struct Transition {
    level: f64,
    falls: bool,
    /// Whether reaching the level is enough, without passing it.
    on_level: bool,
    to: Phase,
}

impl Transition {
    /// Distance of q from completing the transition [–]: zero on the level, negative beyond.
    fn gap(self, q: f64) -> f64 {
        if self.falls { q - self.level } else { self.level - q }
    }
}

/// The transitions out of `phase`.
fn transitions(phase: Phase, thresholds: &crate::model::phase::Thresholds) -> Vec<Transition> {
    let crate::model::phase::Thresholds { merge_at, split_at, core_at } = *thresholds;
    match phase {
        Phase::Apart => vec![Transition { level: merge_at, falls: true, on_level: true, to: Phase::Merged }],
        Phase::Merged => vec![
            Transition { level: split_at, falls: false, on_level: true, to: Phase::Apart },
            Transition { level: core_at, falls: true, on_level: false, to: Phase::Core },
        ],
        Phase::Core => vec![Transition { level: core_at, falls: false, on_level: true, to: Phase::Merged }],
    }
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
        let gap = self.transition.gap(q) - self.within;
        gap < 0.0 || gap == 0.0 && self.transition.on_level
    }
}

impl Watch {
    /// Checks q at two successive times, with an uncertainty of `uncertainty`.
    fn check(&mut self, transitions: &[Transition], before: f64, now: f64, uncertainty: f64) -> Option<Passage> {
        for (&transition, was_clear) in transitions.iter().zip(&mut self.was_clear) {
            *was_clear |= transition.gap(before) > uncertainty;
            let gap = transition.gap(now);
            if gap < -uncertainty || *was_clear && transition.on_level && gap <= uncertainty {
                // the level itself, unless the pair comes to rest just short of it
                return Some(Passage { transition, within: f64::max(0.0, gap) });
            }
        }
        None
    }
}

// --- influences on a body -------------------------------------------------------------------------------------------

/// A time interval over which the influences on a body do not jump; requested instants also end intervals.
struct Chunk<'a> {
    start: f64,
    end: f64,
    /// The index of the requested instant at its end, if there is one.
    sample: Option<usize>,
    sources: Vec<Source<'a>>,
    pushes: Vec<&'a Push>,
    /// Whether the motion of the body's centre has no effect on its displacements.
    is_carried: bool,
}

/// An active influence sphere that can reach the body.
#[derive(Clone, Copy)]
struct Source<'a> {
    body: usize,
    path: &'a Path,
    radius: f64,
    /// Positive attracts.
    strength: f64,
}

/// The equation of motion of the vertices of one body.
struct Problem<'a> {
    scene: &'a Scene,
    histories: &'a [History],
    times: &'a [f64],
    index: usize,
    body: &'a Body,
    longest_step: f64,
    /// Tolerances of x and of u.
    tolerance: [f64; 6],
    /// For vertices that stay within [`Problem::leash`] of rest.
    chunks: Vec<Chunk<'a>>,
    /// For all others: includes every source throughout.
    all_chunks: OnceLock<Vec<Chunk<'a>>>,
}

impl<'a> Problem<'a> {
    fn new(
        scene: &'a Scene,
        histories: &'a [History],
        times: &'a [f64],
        accuracy: Accuracy,
        index: usize,
    ) -> Problem<'a> {
        let body = &scene.bodies[index];
        let rate = fastest_rate(scene).max(1e-3);
        // far from the origin, positions are rounded more coarsely than a small tolerance allows
        let end = times.last().copied().unwrap_or(0.0);
        let far = times.iter().map(|&t| path(body).position(t).length()).fold(0.0, f64::max);
        let rounding = ROUNDING * (far + path(body).bounds(0.0, end).speed * end);
        let x = f64::max(accuracy.tolerance * body.radius, rounding);
        let u = x * rate;
        let mut problem = Problem {
            scene,
            histories,
            times,
            index,
            body,
            longest_step: accuracy.longest_step / rate,
            tolerance: [x, x, x, u, u, u],
            chunks: vec![],
            all_chunks: OnceLock::new(),
        };
        problem.chunks = problem.divide(problem.leash());
        problem
    }

    /// The displacement up to which the sources of [`Problem::chunks`] are complete [scene unit].
    fn leash(&self) -> f64 {
        self.body.radius
    }

    /// Splits the time span where something jumps and at the requested instants.
    fn divide(&self, leash: f64) -> Vec<Chunk<'a>> {
        let Problem { scene, histories, times, index, body, .. } = *self;
        let Some(&end) = times.last() else { return vec![] };
        let pushes = || scene.pushes.iter().filter(|push| push.body == index);
        let own = || histories.iter().filter(|history| history.a == index || history.b == index);
        let mut ends: Vec<f64> = times.to_vec();
        ends.extend(own().flat_map(|history| history.changes.iter().map(|change| change.time)));
        ends.extend(pushes().flat_map(|push| [push.start, push.start + push.duration]));
        ends.extend(scene.bodies.iter().flat_map(|body| path(body).knots().iter().copied()));
        ends.retain(|&t| 0.0 < t && t <= end);
        ends.sort_by(f64::total_cmp);
        ends.dedup();

        let mut start = 0.0;
        let mut chunks = Vec::with_capacity(ends.len());
        for end in ends {
            let middle = 0.5 * (start + end);
            let phase = |other: usize| {
                let pair = (index.min(other), index.max(other));
                own().find(|history| (history.a, history.b) == pair).map_or(Phase::Apart, |it| it.phase_at(middle))
            };
            let own_speed = path(body).bounds(start, end).speed;
            let source = |(other, source): (usize, &'a Body)| {
                let radius = scene.influence.reach * source.radius;
                let near = radius + body.radius + leash;
                let speed = own_speed + path(source).bounds(start, end).speed;
                let distance = path(body).position(start).distance(path(source).position(start));
                if other == index || distance - speed * (end - start) > near {
                    return None;
                }
                let law = scene.law(index, other);
                let strength = strength(scene, &law, phase(other), body.radius / source.radius);
                (strength != 0.0).then_some(Source { body: other, path: path(source), radius, strength })
            };
            chunks.push(Chunk {
                start,
                end,
                sample: times.binary_search_by(|t| t.total_cmp(&end)).ok(),
                sources: scene.bodies.iter().enumerate().filter_map(source).collect(),
                pushes: pushes().filter(|push| push.start <= middle && middle < push.start + push.duration).collect(),
                is_carried: body.material.response == Response::Rigid || path(body).is_fixed(),
            });
            start = end;
        }
        chunks
    }

    /// The displacement x of the vertex at `rest`, whose direction is `facing`, at every requested instant; empty if it
    /// stays 0.
    fn track(&self, rest: DVec3, facing: DVec3) -> Result<Vec<DVec3>, NoReference> {
        if let Some(track) = self.track_within([rest, facing], &self.chunks, self.leash())? {
            return Ok(track);
        }
        let all = self.all_chunks.get_or_init(|| self.divide(f64::INFINITY));
        Ok(self.track_within([rest, facing], all, f64::INFINITY)?.unwrap_or_default())
    }

    /// Like [`Problem::track`]; `None` if the vertex moves farther from rest than `leash`.
    fn track_within(
        &self,
        [rest, facing]: [DVec3; 2],
        chunks: &[Chunk<'a>],
        leash: f64,
    ) -> Result<Option<Vec<DVec3>>, NoReference> {
        let end = chunks.last().map_or(0.0, |chunk| chunk.end);
        let trials = TRIALS_PER_STEP * (chunks.len() as f64 + end / self.longest_step);
        let mut vertex = Vertex {
            problem: self,
            rest,
            facing,
            state: [0.0; 6],
            step: self.longest_step,
            sides: vec![],
            trials: trials as u64,
        };
        let mut track = vec![DVec3::ZERO; self.times.partition_point(|&t| t <= 0.0)];
        let mut is_at_rest = true;
        for chunk in chunks {
            if chunk.start > 0.0 && self.body.material.response != Response::Rigid {
                // where the velocity of the centre jumps, the vertices keep their velocities in the world
                let kick = path(self.body).kick(chunk.start);
                vertex.state[3..].iter_mut().zip(kick.to_array()).for_each(|(u, kick)| *u -= kick);
            }
            vertex.advance(chunk)?;
            let [x, y, z, ..] = vertex.state;
            let x = DVec3::new(x, y, z);
            is_at_rest &= x == DVec3::ZERO;
            if x.length() > leash {
                return Ok(None);
            }
            if chunk.sample.is_some() {
                track.push(x);
            }
        }
        Ok(Some(if is_at_rest { vec![] } else { track }))
    }
}

/// Strength of a source on a body `size` times as large as its own: α attracts, β repels [1/s²].
fn strength(scene: &Scene, law: &PairLaw, phase: Phase, size: f64) -> f64 {
    let full = match phase {
        Phase::Merged => law.alpha,
        Phase::Core => -law.beta,
        Phase::Apart => {
            if law.apart_repels {
                -law.beta
            } else {
                0.0
            }
        }
    };
    if scene.influence.scaling == Scaling::Relative && size < 1.0 { full * size } else { full }
}

// --- one vertex ------------------------------------------------------------------------------------------------------

/// A step no longer than this, relative to t or 1 s, is always accepted: only rounding errors remain.
const SHORTEST_STEP: f64 = 1e-12;
/// Upper limit on trial steps of any length, per longest step: far more than crossings and halvings need.
const TRIALS_PER_STEP: f64 = 200.0;

/// A vertex whose [`Gap`] is this fraction of the squared radius may be on either side of a rim [–].
const AT_RIM: f64 = 1e-9;

/// The state of one vertex during integration.
struct Vertex<'p, 'a> {
    problem: &'p Problem<'a>,
    /// Rest position l [scene unit] …
    rest: DVec3,
    /// … and its direction.
    facing: DVec3,
    /// x, then u.
    state: [f64; 6],
    /// The next step size, unless something intervenes [s].
    step: f64,
    /// The side of each rim of the current chunk's sources that the vertex is on.
    sides: Vec<Side>,
    /// Remaining trial steps.
    trials: u64,
}

#[derive(Clone, Copy)]
struct Side {
    body: usize,
    is_inside: bool,
}

/// The equation of motion of one vertex within a chunk while it crosses no rim.
struct Law<'a> {
    body: &'a Body,
    weight: Weight,
    chunk: &'a Chunk<'a>,
    sides: &'a [Side],
    rest: DVec3,
    push: DVec3,
}

impl Vertex<'_, '_> {
    /// Integrates through one chunk.
    fn advance(&mut self, chunk: &Chunk<'_>) -> Result<(), NoReference> {
        let push = |push: &&Push| push.strength * f64::max(0.0, -self.facing.dot(push.direction)) * push.direction;
        let push: DVec3 = chunk.pushes.iter().map(push).sum();
        if self.state == [0.0; 6] && chunk.sources.is_empty() && chunk.is_carried && push == DVec3::ZERO {
            self.sides.clear();
            return Ok(());
        }
        let rest = self.rest;
        let mut sides = std::mem::take(&mut self.sides);
        sides = chunk.sources.iter().map(|source| self.side(source, chunk, &sides, rest)).collect();
        let mut t = chunk.start;
        let mut turns = 0;
        while t < chunk.end {
            // Ends the loop even if crossings are only a rounding error apart or steps never grow.
            self.trials = self.trials.checked_sub(1).ok_or(NoReference::Stuck { body: self.problem.index, time: t })?;
            let left = chunk.end - t;
            let h = if self.step < left { self.step } else { left };
            let law = Law {
                body: self.problem.body,
                weight: self.problem.scene.influence.weight,
                chunk,
                sides: &sides,
                rest,
                push,
            };
            let trial = Trial {
                law: &law,
                t,
                state: &self.state,
                slope: law.slope(t, &self.state),
                tolerance: &self.problem.tolerance,
            };
            let whole = trial.step(h);
            if !whole.is_accurate() {
                if h > SHORTEST_STEP * f64::max(1.0, t) {
                    self.step = 0.5 * h;
                    continue;
                } else if whole.error.is_nan() {
                    return Err(NoReference::TooLarge { body: self.problem.index, time: t });
                }
            }
            if whole.is_easy() {
                self.step = f64::min(f64::max(self.step, 2.0 * h), self.problem.longest_step);
            }
            if turns > 2 * sides.len() {
                // The vertex has gone in and out without progress: it touches a rim, or the rim moves along with it. It
                // is assigned to the side on which it is a little later, but only at a rim itself, where the force is
                // too weak for the side to matter.
                let little = h / 1024.0;
                let end = trial.step(little).end;
                let touches = |(source, side): (usize, &Side)| {
                    let gap = |h, state| trial.margin(source, h, state).value;
                    let is_at_rim = gap(0.0, &self.state).abs() <= AT_RIM * chunk.sources[source].radius.powi(2);
                    Side { is_inside: side.is_inside ^ (is_at_rim && gap(little, &end) < 0.0), ..*side }
                };
                let sides_then = sides.iter().enumerate().map(touches).collect::<Vec<_>>();
                let law = Law { sides: &sides_then, ..law };
                let trial = Trial { law: &law, slope: law.slope(t, &self.state), ..trial };
                self.state = trial.step(little).end;
                t = if t + little < chunk.end { t + little } else { chunk.end };
                sides = sides_then;
                turns = 0;
                continue;
            }
            match trial.first_crossing(h, whole.end) {
                None => {
                    self.state = whole.end;
                    t = if h == left { chunk.end } else { t + h };
                    turns = 0;
                }
                Some(Crossing { after, end, source }) => {
                    self.state = end;
                    turns = if after > CROSSING { 0 } else { turns + 1 };
                    t += after;
                    sides[source].is_inside ^= true;
                }
            }
        }
        self.sides = sides;
        Ok(())
    }

    /// The side of a rim that the vertex is on at the start of a chunk.
    fn side(&self, source: &Source<'_>, chunk: &Chunk<'_>, known: &[Side], rest: DVec3) -> Side {
        let gap = gap(self.problem.body, source, chunk, rest, chunk.start, &self.state);
        let known = known.iter().find(|side| side.body == source.body);
        // on the rim itself, which it may just have crossed or be about to cross
        let is_inside = if gap.value.abs() > AT_RIM * source.radius * source.radius {
            gap.value < 0.0
        } else {
            known.map_or(gap.rate < 0.0, |side| side.is_inside)
        };
        Side { body: source.body, is_inside }
    }
}

/// The centre within a chunk; at the chunk's end, its limit from the left.
fn centre(path: &Path, chunk: &Chunk<'_>, t: f64) -> Kinematics {
    if t < chunk.end { path.at(t) } else { path.before(chunk.end) }
}

impl Law<'_> {
    /// (u, u′) at time `t`.
    fn slope(&self, t: f64, state: &[f64; 6]) -> [f64; 6] {
        let &[x, y, z, ux, uy, uz] = state;
        let (x, u) = (DVec3::new(x, y, z), DVec3::new(ux, uy, uz));
        let material = &self.body.material;
        let own = centre(path(self.body), self.chunk, t);

        let mut acceleration = -(material.omega * material.omega) * x - (2.0 * material.damping) * u;
        for (source, side) in self.chunk.sources.iter().zip(self.sides) {
            if side.is_inside {
                let to_centre = centre(source.path, self.chunk, t).position - (own.position + self.rest + x);
                let z = to_centre.length() / source.radius;
                // beyond the rim, where a step may sample before it is shortened, the inside law continues
                let weight = match self.weight {
                    Weight::Linear => 1.0 - z,
                    Weight::Wendland => (1.0 - z).powi(4) * (4.0 * z + 1.0),
                };
                acceleration += source.strength * weight * to_centre;
            }
        }
        acceleration += self.push;
        match material.response {
            Response::Rigid => {}
            Response::Inertial => acceleration -= own.acceleration,
            Response::World => acceleration -= own.acceleration + 2.0 * material.damping * own.velocity,
        }
        [u.x, u.y, u.z, acceleration.x, acceleration.y, acceleration.z]
    }
}

/// How far a vertex is outside a rim: distance² − radius² [scene unit²], and its rate [scene unit²/s].
#[derive(Clone, Copy)]
struct Gap {
    value: f64,
    rate: f64,
}

fn gap(body: &Body, source: &Source<'_>, chunk: &Chunk<'_>, rest: DVec3, t: f64, state: &[f64; 6]) -> Gap {
    let &[x, y, z, ux, uy, uz] = state;
    let (own, other) = (centre(path(body), chunk, t), centre(source.path, chunk, t));
    let to_centre = other.position - (own.position + rest + DVec3::new(x, y, z));
    let approach = other.velocity - (own.velocity + DVec3::new(ux, uy, uz));
    let distance = to_centre.length();
    Gap { value: (distance - source.radius) * (distance + source.radius), rate: 2.0 * to_centre.dot(approach) }
}

/// A trial step of any length.
struct Trial<'a> {
    law: &'a Law<'a>,
    tolerance: &'a [f64; 6],
    t: f64,
    state: &'a [f64; 6],
    slope: [f64; 6],
}

/// A vertex reaches a rim.
struct Crossing {
    /// Time since the start of the step [s].
    after: f64,
    /// The state at that time.
    end: [f64; 6],
    /// Index into the sources of the chunk.
    source: usize,
}

impl Trial<'_> {
    fn step(&self, h: f64) -> Step<6> {
        let slope = |t: f64, state: &[f64; 6]| self.law.slope(t, state);
        extrapolation::step(&slope, self.t, self.state, &self.slope, h, self.tolerance)
    }

    /// The gap to a rim `h` [s] into the step; positive on the vertex's own side.
    fn margin(&self, source: usize, h: f64, state: &[f64; 6]) -> Gap {
        let Law { body, chunk, sides, rest, .. } = *self.law;
        let Gap { value, rate } = gap(body, &chunk.sources[source], chunk, rest, self.t + h, state);
        if sides[source].is_inside { Gap { value: -value, rate: -rate } } else { Gap { value, rate } }
    }

    /// The first rim that the vertex reaches in the step of length `h` [s] that leads to `end`.
    fn first_crossing(&self, mut h: f64, mut end: [f64; 6]) -> Option<Crossing> {
        let mut first = None;
        for source in 0..self.law.chunk.sources.len() {
            if let Some((after, state)) = self.crossing(source, h, &end) {
                (h, end, first) = (after, state, Some(source));
            }
        }
        first.map(|source| Crossing { after: h, end, source })
    }

    /// The time [s] into the step of length `h` [s] that leads to `end` at which the vertex first reaches the rim of a
    /// source, and its state then.
    fn crossing(&self, source: usize, h: f64, end: &[f64; 6]) -> Option<(f64, [f64; 6])> {
        let start = (0.0, self.margin(source, 0.0, self.state));
        let mut last = (h, self.margin(source, h, end));
        let turn = |last: (f64, Gap)| {
            let rate = |h: f64, state: &[f64; 6]| self.margin(source, h, state).rate;
            let (turn, state) = self.root((0.0, start.1.rate), (last.0, last.1.rate), rate);
            (turn, self.margin(source, turn, &state))
        };
        let mut inside = start;
        if last.1.value >= 0.0 {
            // It ends on its own side, but may have crossed the rim in between. That takes a turning point close enough
            // to the rim.
            let nearest = f64::min(start.1.value, last.1.value);
            let is_turning = start.1.rate < 0.0 && last.1.rate > 0.0;
            if !is_turning || nearest > 2.0 * h * f64::max(-start.1.rate, last.1.rate) {
                return None;
            }
            last = turn(last);
            if last.1.value >= 0.0 {
                return None;
            }
        }
        if start.1.value <= 0.0 {
            // It starts at the rim. Either it first moves to its own side, and then it must have turned …
            if start.1.rate > 0.0 && last.1.rate < 0.0 {
                inside = turn(last);
            }
            // … or it was assigned to the wrong side.
            if inside.1.value <= 0.0 {
                return Some((0.0, *self.state));
            }
        }
        let value = |h: f64, state: &[f64; 6]| self.margin(source, h, state).value;
        Some(self.root((inside.0, inside.1.value), (last.0, last.1.value), value))
    }

    /// The root of `f` between two times in the step at which its values have opposite signs, and the state there, by
    /// regula falsi, Illinois variant (Dahlquist & Björck, Numerical Methods, section 6.2).
    fn root(&self, low: (f64, f64), high: (f64, f64), f: impl Fn(f64, &[f64; 6]) -> f64) -> (f64, [f64; 6]) {
        let ((mut low, mut f_low), (mut high, mut f_high)) = (low, high);
        let (mut low_stayed, mut high_stayed) = (false, false);
        let mut found = (low, *self.state);
        let mut bisect = false;
        for _ in 0..200 {
            let guess = low + (high - low) * (f_low / (f_low - f_high));
            let middle = if guess > low && guess < high && !bisect { guess } else { low + 0.5 * (high - low) };
            bisect = false;
            found = (middle, self.step(middle).end);
            let value = f(middle, &found.1);
            // the distance to the root, from the slope of the secant
            let off = (high - low) * (value / (f_low - f_high)).abs();
            if middle <= low || middle >= high {
                break;
            }
            let is_low = |value: f64| (value > 0.0) == (f_low > 0.0);
            if off <= CROSSING {
                // valid if the secant is accurate; far beyond the rim the function may be steep
                let probe = if is_low(value) { middle + CROSSING } else { middle - CROSSING };
                if probe <= low || probe >= high {
                    break;
                }
                let probed = f(probe, &self.step(probe).end);
                if is_low(probed) != is_low(value) {
                    break;
                }
                if is_low(probed) {
                    (low, f_low) = (probe, probed)
                } else {
                    (high, f_high) = (probe, probed)
                }
                (low_stayed, high_stayed) = (false, false);
                bisect = true;
                continue;
            }
            if (value > 0.0) == (f_low > 0.0) {
                (low, f_low) = (middle, value);
                f_high *= if high_stayed { 0.5 } else { 1.0 };
                (low_stayed, high_stayed) = (false, true);
            } else {
                (high, f_high) = (middle, value);
                f_low *= if low_stayed { 0.5 } else { 1.0 };
                (low_stayed, high_stayed) = (true, false);
            }
        }
        found
    }
}

/// Precision of crossing times [s]. The force has a kink there but does not jump, so a timing error changes a velocity
/// only by the order of its square.
const CROSSING: f64 = 1e-11;
