//! An independent solution of a scene, to judge the integrators by.
//!
//! Nothing of [`crate::sim`] is used: the equation of motion is written down here once more, from the model alone; pair
//! phases are found by a scan of the distances and bisection; every vertex is integrated for itself by
//! [extrapolation](super::extrapolation), restarted wherever the right-hand side jumps (pair phases, pushes,
//! keyframes), and at every instant asked for. The weight has a kink at the rim of an influence sphere: within a step a
//! vertex that is inside of a sphere feels the law of the inside even where the step takes it out, and the other way
//! round, so that the law of each step is smooth; the time of the crossing is then found by root finding, and the step
//! ends there.

use std::sync::OnceLock;

use glam::DVec3;
use rayon::prelude::*;

use super::extrapolation::{self, Step};
use crate::{
    model::{
        influence::{Scaling, Weight},
        phase::Phase,
    },
    scene::{Body, Path, Push, Response, Scene, path::Kinematics},
};

/// How exact a reference is to be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Accuracy {
    /// The error that a step may make, in radii of the body for a displacement, and as much times the largest rate of
    /// the scene for a velocity [–].
    pub tolerance: f64,
    /// The longest step, in units of the inverse of that rate [–]: short enough that a vertex cannot turn twice in it.
    pub longest_step: f64,
}

impl Accuracy {
    /// What gives the 1e-11 of a radius that is [claimed](Reference::ACCURACY).
    pub const DEFAULT: Accuracy = Accuracy { tolerance: 1e-13, longest_step: 0.25 };
    /// Ten times as exact, to see how exact that is.
    pub const TIGHTER: Accuracy = Accuracy { tolerance: 1e-14, longest_step: 0.125 };
}

/// A scene whose reference would take too long.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "a reference solution would take {evaluations:.0e} evaluations of the equation of motion, more than \
     {MOST_EVALUATIONS:.0e}: its explicit method follows the fastest motion (omega, damping, alpha, beta), for every \
     vertex and the whole duration; make the scene softer, smaller or shorter"
)]
pub struct TooLong {
    /// An estimate of them.
    pub evaluations: f64,
}

/// A few minutes.
const MOST_EVALUATIONS: f64 = 5e9;
/// Of a typical step.
const EVALUATIONS_PER_STEP: f64 = 40.0;
/// What is left of a coordinate after a few roundings, of its size.
const ROUNDING: f64 = 8.0 * f64::EPSILON;

/// Where every vertex is at given instants.
pub struct Reference {
    times: Vec<f64>,
    /// `[body][vertex][time]`; empty for a vertex that has stayed at rest.
    tracks: Vec<Vec<Vec<DVec3>>>,
    events: Vec<PhaseChange>,
}

/// A pair changes its phase.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhaseChange {
    /// When [s].
    pub time: f64,
    /// One body of the pair …
    pub a: usize,
    /// … and the other, a < b.
    pub b: usize,
    /// The phase that begins.
    pub to: Phase,
}

impl Reference {
    /// How far [`Accuracy::DEFAULT`] may be off, in radii of a vertex's body.
    pub const ACCURACY: f64 = 1e-11;

    /// Solves `scene` for the displacements at `times` [s], ascending, none negative.
    ///
    /// # Errors
    /// [`TooLong`] if the scene is too stiff, too large or too long for that.
    pub fn solve(scene: &Scene, times: &[f64], accuracy: Accuracy) -> Result<Reference, TooLong> {
        let end = times.last().copied().unwrap_or(0.0);
        let evaluations = EVALUATIONS_PER_STEP
            * scene.vertex_count() as f64
            * f64::max(times.len() as f64, end * fastest_rate(scene) / accuracy.longest_step);
        if evaluations > MOST_EVALUATIONS {
            return Err(TooLong { evaluations });
        }
        let histories = histories(scene, end);
        let tracks = (0..scene.bodies.len())
            .into_par_iter()
            .map(|body| {
                let problem = Problem::new(scene, &histories, times, accuracy, body);
                scene.bodies[body].shape.unit_vertices().into_par_iter().map(|unit| problem.track(unit)).collect()
            })
            .collect();
        let mut events: Vec<_> = histories.iter().flat_map(|history| history.changes.iter().copied()).collect();
        events.sort_by(|x, y| x.time.total_cmp(&y.time));
        Ok(Reference { times: times.to_vec(), tracks, events })
    }

    /// The instants [s].
    pub fn times(&self) -> &[f64] {
        &self.times
    }

    /// The phase changes up to the last instant, by time.
    pub fn events(&self) -> &[PhaseChange] {
        &self.events
    }

    /// Displacement x of a vertex from rest at instant `k` [scene unit].
    pub fn displacement(&self, body: usize, vertex: usize, k: usize) -> DVec3 {
        self.tracks[body][vertex].get(k).copied().unwrap_or(DVec3::ZERO)
    }

    /// The largest distance of a vertex from where it is in another solution of the same scene at the same times [radii].
    pub fn largest_difference(&self, other: &Reference, scene: &Scene) -> f64 {
        let mut largest = 0.0;
        for (body, tracks) in self.tracks.iter().enumerate() {
            for vertex in 0..tracks.len() {
                for k in 0..self.times.len() {
                    let apart = self.displacement(body, vertex, k).distance(other.displacement(body, vertex, k));
                    largest = f64::max(largest, apart / scene.bodies[body].radius);
                }
            }
        }
        largest
    }
}

/// The rate of the fastest motion of a scene [1/s]: of its oscillators, of its influence, of its paths.
fn fastest_rate(scene: &Scene) -> f64 {
    let body = |body: &Body| {
        let path = match body.path {
            Path::Sine { frequency, .. } => std::f64::consts::TAU * frequency.abs(),
            _ => 0.0,
        };
        body.material.omega.max(body.material.damping).max(path)
    };
    // a few sources on one vertex
    let influence = (3.0 * f64::max(scene.influence.alpha.abs(), scene.influence.beta.abs())).sqrt();
    scene.bodies.iter().map(body).fold(influence, f64::max)
}

// --- pair phases -------------------------------------------------------------------------------------------------------

/// The phases of a pair that is not apart all the time.
struct History {
    a: usize,
    b: usize,
    /// At t = 0.
    first: Phase,
    changes: Vec<PhaseChange>,
}

impl History {
    fn phase_at(&self, t: f64) -> Phase {
        self.changes.iter().rev().find(|change| change.time <= t).map_or(self.first, |change| change.to)
    }
}

/// A visit to another phase that is shorter than this can be missed [s].
const SHORTEST_VISIT: f64 = 1e-6;

/// Those of all pairs that are ever anything else than apart, ascending.
fn histories(scene: &Scene, end: f64) -> Vec<History> {
    let pairs = |a| (a + 1..scene.bodies.len()).map(move |b| (a, b));
    let all = (0..scene.bodies.len()).into_par_iter().flat_map_iter(pairs);
    let found = all.map(|(a, b)| history(scene, a, b, end));
    found.filter(|history| history.first != Phase::Apart || !history.changes.is_empty()).collect()
}

fn history(scene: &Scene, a: usize, b: usize, end: f64) -> History {
    let (one, other) = (&scene.bodies[a], &scene.bodies[b]);
    let radii = one.radius + other.radius;
    let q = |t| (one.path.position(t) - other.path.position(t)).length() / radii;
    let crate::model::phase::Thresholds { merge_at, split_at, core_at } = scene.thresholds;
    let next = |phase, q: f64| match phase {
        Phase::Apart if q <= merge_at => Phase::Merged,
        Phase::Merged if q >= split_at => Phase::Apart,
        Phase::Merged if q < core_at => Phase::Core,
        Phase::Core if q >= core_at => Phase::Merged,
        same => same,
    };

    let (mut t, mut phase) = (0.0, Phase::Apart);
    if q(0.0) <= merge_at {
        phase = Phase::Merged;
    }
    if q(0.0) < core_at {
        phase = Phase::Core;
    }
    let mut history = History { a, b, first: phase, changes: vec![] };
    while t < end {
        // no threshold can be reached before the centres have moved that far
        let far = [merge_at, split_at, core_at].map(|level| (q(t) - level).abs()).into_iter().fold(f64::MAX, f64::min);
        let stretch = f64::min(end - t, 0.1);
        let speed = [one, other].map(|body| body.path.bounds(t, t + stretch).speed).iter().sum::<f64>();
        let safe = if far * radii >= speed * stretch { stretch } else { far * radii / speed };
        let mut later = f64::min(end, t + f64::max(safe, SHORTEST_VISIT));
        let to = next(phase, q(later));
        if to != phase {
            let mut earlier = t;
            loop {
                let middle = 0.5 * (earlier + later);
                if middle <= earlier || middle >= later {
                    break;
                }
                if next(phase, q(middle)) == phase { earlier = middle } else { later = middle }
            }
            history.changes.push(PhaseChange { time: later, a, b, to });
            phase = to;
        }
        t = later;
    }
    history
}

// --- what acts on a body ---------------------------------------------------------------------------------------------

/// A stretch of time in which what acts on a body does not jump, and that no instant asked for divides.
struct Chunk<'a> {
    start: f64,
    end: f64,
    /// Which instant its end is.
    sample: Option<usize>,
    sources: Vec<Source<'a>>,
    pushes: Vec<&'a Push>,
    /// Whether the body feels no motion of its own.
    is_carried: bool,
}

/// An influence sphere that acts and that can reach the body.
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
    /// Of x and of u.
    tolerance: [f64; 6],
    /// For vertices that stay within [`Problem::leash`] of rest.
    chunks: Vec<Chunk<'a>>,
    /// For all others: every source everywhere.
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
        // far from the origin positions are rounded more coarsely than a small tolerance allows
        let end = times.last().copied().unwrap_or(0.0);
        let far = times.iter().map(|&t| body.path.position(t).length()).fold(0.0, f64::max);
        let rounding = ROUNDING * (far + body.path.bounds(0.0, end).speed * end);
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

    /// How far from rest a vertex can be for the sources of [`Problem::chunks`] to be all [scene unit].
    fn leash(&self) -> f64 {
        self.body.radius
    }

    /// Divides the time where something jumps and at the instants asked for.
    fn divide(&self, leash: f64) -> Vec<Chunk<'a>> {
        let Problem { scene, histories, times, index, body, .. } = *self;
        let Some(&end) = times.last() else { return vec![] };
        let pushes = || scene.pushes.iter().filter(|push| push.body == index);
        let own = || histories.iter().filter(|history| history.a == index || history.b == index);
        let mut ends: Vec<f64> = times.to_vec();
        ends.extend(own().flat_map(|history| history.changes.iter().map(|change| change.time)));
        ends.extend(pushes().flat_map(|push| [push.start, push.start + push.duration]));
        ends.extend(scene.bodies.iter().flat_map(|body| body.path.knots().iter().copied()));
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
            let own_speed = body.path.bounds(start, end).speed;
            let source = |(other, source): (usize, &'a Body)| {
                let radius = scene.influence.reach * source.radius;
                let near = radius + body.radius + leash;
                let speed = own_speed + source.path.bounds(start, end).speed;
                let distance = body.path.position(start).distance(source.path.position(start));
                if other == index || distance - speed * (end - start) > near {
                    return None;
                }
                let strength = strength(scene, phase(other), body.radius / source.radius);
                (strength != 0.0).then_some(Source { body: other, path: &source.path, radius, strength })
            };
            chunks.push(Chunk {
                start,
                end,
                sample: times.binary_search_by(|t| t.total_cmp(&end)).ok(),
                sources: scene.bodies.iter().enumerate().filter_map(source).collect(),
                pushes: pushes().filter(|push| push.start <= middle && middle < push.start + push.duration).collect(),
                is_carried: body.material.response == Response::Rigid || body.path.is_fixed(),
            });
            start = end;
        }
        chunks
    }

    /// x of one vertex at every instant asked for; empty if it stays 0.
    fn track(&self, unit: DVec3) -> Vec<DVec3> {
        self.track_within(unit, &self.chunks, self.leash()).unwrap_or_else(|| {
            let all = self.all_chunks.get_or_init(|| self.divide(f64::INFINITY));
            self.track_within(unit, all, f64::INFINITY).unwrap_or_default()
        })
    }

    /// As [`Problem::track`]; `None` if the vertex gets farther from rest than `leash`.
    fn track_within(&self, unit: DVec3, chunks: &[Chunk<'a>], leash: f64) -> Option<Vec<DVec3>> {
        let mut vertex = Vertex { problem: self, unit, state: [0.0; 6], step: self.longest_step, sides: vec![] };
        let mut track = vec![DVec3::ZERO; self.times.partition_point(|&t| t <= 0.0)];
        let mut is_at_rest = true;
        for chunk in chunks {
            vertex.advance(chunk);
            let [x, y, z, ..] = vertex.state;
            let x = DVec3::new(x, y, z);
            is_at_rest &= x == DVec3::ZERO;
            if x.length() > leash {
                return None;
            }
            if chunk.sample.is_some() {
                track.push(x);
            }
        }
        Some(if is_at_rest { vec![] } else { track })
    }
}

/// What a source does to a body `size` times as large as its own: α attracts, β repels [1/s²].
fn strength(scene: &Scene, phase: Phase, size: f64) -> f64 {
    let law = &scene.influence;
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
    if law.scaling == Scaling::Relative && size < 1.0 { full * size } else { full }
}

// --- one vertex ------------------------------------------------------------------------------------------------------

/// A step that is as short as this, over t or 1 s, is taken as it is: rounding is all that is left to see.
const SHORTEST_STEP: f64 = 1e-12;

/// One vertex on its way.
struct Vertex<'p, 'a> {
    problem: &'p Problem<'a>,
    unit: DVec3,
    /// x, then u.
    state: [f64; 6],
    /// The next step, if nothing comes in between [s].
    step: f64,
    /// On which side of the rims of the sources of the current chunk the vertex is.
    sides: Vec<Side>,
}

#[derive(Clone, Copy)]
struct Side {
    body: usize,
    is_inside: bool,
}

/// The equation of motion of one vertex within a chunk, as long as it crosses no rim.
struct Law<'a> {
    body: &'a Body,
    weight: Weight,
    chunk: &'a Chunk<'a>,
    sides: &'a [Side],
    rest: DVec3,
    push: DVec3,
}

impl Vertex<'_, '_> {
    /// Through one chunk.
    fn advance(&mut self, chunk: &Chunk<'_>) {
        let push = |push: &&Push| push.strength * f64::max(0.0, -self.unit.dot(push.direction)) * push.direction;
        let push: DVec3 = chunk.pushes.iter().map(push).sum();
        if self.state == [0.0; 6] && chunk.sources.is_empty() && chunk.is_carried && push == DVec3::ZERO {
            self.sides.clear();
            return;
        }
        let rest = self.problem.body.radius * self.unit;
        let mut sides = std::mem::take(&mut self.sides);
        sides = chunk.sources.iter().map(|source| self.side(source, chunk, &sides, rest)).collect();
        let mut t = chunk.start;
        let mut turns = 0;
        while t < chunk.end {
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
                    self.state = [f64::NAN; 6]; // numbers too large to square: nothing can be said
                    break;
                }
            }
            if whole.is_easy() {
                self.step = f64::min(f64::max(self.step, 2.0 * h), self.problem.longest_step);
            }
            // Without end a vertex could go in and out only at a rim that moves along with it, where it feels nothing.
            match if turns < 8 { trial.first_crossing(h, whole.end) } else { None } {
                None => {
                    self.state = whole.end;
                    t = if h == left { chunk.end } else { t + h };
                    turns = 0;
                }
                Some(Crossing { after, end, source }) => {
                    self.state = end;
                    turns = if t + after > t { 0 } else { turns + 1 };
                    t += after;
                    sides[source].is_inside ^= true;
                }
            }
        }
        self.sides = sides;
    }

    /// On which side of a rim the vertex is at the start of a chunk.
    fn side(&self, source: &Source<'_>, chunk: &Chunk<'_>, known: &[Side], rest: DVec3) -> Side {
        let gap = gap(self.problem.body, source, chunk, rest, chunk.start, &self.state);
        let known = known.iter().find(|side| side.body == source.body);
        // at the very rim, which it may just have crossed, or where it may be about to
        let is_inside = if gap.value.abs() > 1e-9 * source.radius * source.radius {
            gap.value < 0.0
        } else {
            known.map_or(gap.rate < 0.0, |side| side.is_inside)
        };
        Side { body: source.body, is_inside }
    }
}

/// Where the centre is, within a chunk: at its end, as it comes to it.
fn centre(path: &Path, chunk: &Chunk<'_>, t: f64) -> Kinematics {
    if t < chunk.end { path.at(t) } else { path.before(chunk.end) }
}

impl Law<'_> {
    /// (u, u′) at time `t`.
    fn slope(&self, t: f64, state: &[f64; 6]) -> [f64; 6] {
        let &[x, y, z, ux, uy, uz] = state;
        let (x, u) = (DVec3::new(x, y, z), DVec3::new(ux, uy, uz));
        let material = &self.body.material;
        let own = centre(&self.body.path, self.chunk, t);

        let mut acceleration = -(material.omega * material.omega) * x - (2.0 * material.damping) * u;
        for (source, side) in self.chunk.sources.iter().zip(self.sides) {
            if side.is_inside {
                let to_centre = centre(source.path, self.chunk, t).position - (own.position + self.rest + x);
                let z = to_centre.length() / source.radius;
                // beyond the rim, where a step may look before it is shortened, as it is inside
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

/// How far outside of a rim a vertex is: distance² − radius² [scene unit²], and its rate [scene unit²/s].
#[derive(Clone, Copy)]
struct Gap {
    value: f64,
    rate: f64,
}

fn gap(body: &Body, source: &Source<'_>, chunk: &Chunk<'_>, rest: DVec3, t: f64, state: &[f64; 6]) -> Gap {
    let &[x, y, z, ux, uy, uz] = state;
    let (own, other) = (centre(&body.path, chunk, t), centre(source.path, chunk, t));
    let to_centre = other.position - (own.position + rest + DVec3::new(x, y, z));
    let approach = other.velocity - (own.velocity + DVec3::new(ux, uy, uz));
    let distance = to_centre.length();
    Gap { value: (distance - source.radius) * (distance + source.radius), rate: 2.0 * to_centre.dot(approach) }
}

/// A step that is being tried, of any length.
struct Trial<'a> {
    law: &'a Law<'a>,
    tolerance: &'a [f64; 6],
    t: f64,
    state: &'a [f64; 6],
    slope: [f64; 6],
}

/// A vertex reaches a rim.
struct Crossing {
    /// The start of the step [s].
    after: f64,
    /// The state then.
    end: [f64; 6],
    /// Index into the sources of the chunk.
    source: usize,
}

impl Trial<'_> {
    fn step(&self, h: f64) -> Step<6> {
        let slope = |t: f64, state: &[f64; 6]| self.law.slope(t, state);
        extrapolation::step(&slope, self.t, self.state, &self.slope, h, self.tolerance)
    }

    /// How far the vertex is on its side of a rim, `h` into the step.
    fn margin(&self, source: usize, h: f64, state: &[f64; 6]) -> Gap {
        let Law { body, chunk, sides, rest, .. } = *self.law;
        let Gap { value, rate } = gap(body, &chunk.sources[source], chunk, rest, self.t + h, state);
        if sides[source].is_inside { Gap { value: -value, rate: -rate } } else { Gap { value, rate } }
    }

    /// The first rim that the vertex reaches in the step over `h`, which leads to `end`.
    fn first_crossing(&self, mut h: f64, mut end: [f64; 6]) -> Option<Crossing> {
        let mut first = None;
        for source in 0..self.law.chunk.sources.len() {
            if let Some((after, state)) = self.crossing(source, h, &end) {
                (h, end, first) = (after, state, Some(source));
            }
        }
        first.map(|source| Crossing { after: h, end, source })
    }

    /// When the vertex first reaches the rim of a source in the step over `h`, which leads to `end`, and its state then.
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
            // Still on its side, but it may have been beyond: that takes a turn, and one that is close enough.
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
            // It starts at the rim. Either it comes to its side first, and then it must have turned …
            if start.1.rate > 0.0 && last.1.rate < 0.0 {
                inside = turn(last);
            }
            // … or it was taken for being on the wrong side.
            if inside.1.value <= 0.0 {
                return Some((0.0, *self.state));
            }
        }
        let value = |h: f64, state: &[f64; 6]| self.margin(source, h, state).value;
        Some(self.root((inside.0, inside.1.value), (last.0, last.1.value), value))
    }

    /// The root of `f` between two times in the step, at which its values have opposite signs, and the state there:
    /// regula falsi, Illinois variant (Dahlquist & Björck, Numerical Methods, section 6.2).
    fn root(&self, low: (f64, f64), high: (f64, f64), f: impl Fn(f64, &[f64; 6]) -> f64) -> (f64, [f64; 6]) {
        let ((mut low, mut f_low), (mut high, mut f_high)) = (low, high);
        let (mut low_stayed, mut high_stayed) = (false, false);
        let mut found = (low, *self.state);
        for _ in 0..100 {
            let guess = low + (high - low) * (f_low / (f_low - f_high));
            let middle = if guess > low && guess < high { guess } else { low + 0.5 * (high - low) };
            found = (middle, self.step(middle).end);
            let value = f(middle, &found.1);
            // the distance to the root, from the slope of the secant
            let off = (high - low) * (value / (f_low - f_high)).abs();
            if off <= CROSSING || middle <= low || middle >= high {
                break;
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

/// Being so early or late [s] at a kink, where the force does not jump, changes a velocity by the square of it.
const CROSSING: f64 = 1e-11;
