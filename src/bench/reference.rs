//! An independent solution of a scene, against which the integrators are compared.
//!
//! It uses nothing from [`crate::sim`]. The equation of motion is implemented here a second time, from the model alone
//! (`system`), and solved by [`extrapolation`] with a tolerance far below what is asked of a run (`solver`). Every
//! step ends where the right-hand side or one of its derivatives jumps: at pushes, keyframes and phase changes, where a
//! vertex crosses a plane or the rim of an influence sphere, at the ends of the rim of a core, and at every requested
//! instant.
//!
//! Vertices of bodies on paths do not depend on each other: each is solved on its own, and the phases of their pairs are
//! found beforehand by scanning the distances and bisecting (`histories`). In a scene with a free body all vertices are
//! solved together, as particles; thresholds are then located on the way, like other kinks.

pub mod extrapolation;
mod histories;
mod solver;
mod system;

use std::sync::OnceLock;

use glam::DVec3;
use rayon::prelude::*;

use super::{path, source_path};
use crate::{
    model::{PairLaw, phase::Phase},
    scene::{Body, Motion, Path, Push, Response, Scene},
    sim::BodyView,
};
use histories::{History, histories};
use solver::{Settings, Track};
use system::{Chunk, Link, System};

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
         {MAX_EVALUATIONS:.0e}: its explicit method follows the fastest motion (omega, damping, alpha, beta, stiffness of planes, \
         spin), for every vertex and the whole duration; make the scene softer, smaller or shorter"
    )]
    TooLong {
        /// The estimated number of evaluations.
        evaluations: f64,
    },
    /// The scene has edits.
    #[error("there is no reference solution of a scene with [[edit]]s; leave them out")]
    Edits,
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
         {time:e} s; make the scene softer or shorter, or set core_width where pairs chatter at the rim of their core"
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
/// Evaluations of the equation of motion in a typical step, each of a vertex and all that acts on it.
const EVALUATIONS_PER_STEP: f64 = 40.0;
/// Relative rounding error of a coordinate after a few operations.
const ROUNDING: f64 = 8.0 * f64::EPSILON;
/// A vertex this close to a rim or a plane, as a fraction of the radius, may be on either side of it [–].
const AT_KINK: f64 = 5e-10;

/// The vertices at given instants.
pub struct Reference {
    times: Vec<f64>,
    /// `[body]`
    tracks: Vec<Vertices>,
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
    /// The largest error of a solution with [`Accuracy::DEFAULT`], in radii of the vertex's body, where the motion
    /// itself does not amplify errors.
    pub const ACCURACY: f64 = 1e-11;

    /// Solves `scene` for the vertices at `times` [s], which must be ascending and non-negative.
    ///
    /// # Errors
    /// [`NoReference`] if the scene is too stiff, too large or too long, or if its solution is ambiguous.
    pub fn solve(scene: &Scene, times: &[f64], accuracy: Accuracy) -> Result<Reference, NoReference> {
        Reference::check(scene, times, accuracy)?;
        let histories = histories(scene, times.last().copied().unwrap_or(0.0))?;
        let rate = fastest_rate(scene);
        let problem = Problem { scene, histories: &histories, times, accuracy, rate };
        let changes = histories.iter().flat_map(|history| history.changes.iter().copied());
        let mut events: Vec<PhaseChange> = changes.collect();
        let tracks = if has_free_body(scene) {
            let (tracks, found) = problem.together()?;
            events.extend(found);
            tracks
        } else {
            (0..scene.bodies.len()).into_par_iter().map(|body| problem.each(body)).collect::<Result<_, _>>()?
        };
        events.sort_by(|x, y| x.time.total_cmp(&y.time));
        Ok(Reference { times: times.to_vec(), tracks, events })
    }

    /// Whether a solution is affordable.
    ///
    /// # Errors
    /// The scene is too large or too long, or has edits.
    pub fn check(scene: &Scene, times: &[f64], accuracy: Accuracy) -> Result<(), NoReference> {
        if !scene.edits.is_empty() {
            return Err(NoReference::Edits);
        }
        let evaluations = Reference::evaluations(scene, times, accuracy);
        if evaluations > MAX_EVALUATIONS { Err(NoReference::TooLong { evaluations }) } else { Ok(()) }
    }

    /// An estimate of the evaluations of a vertex's equation of motion that a solution takes.
    pub fn evaluations(scene: &Scene, times: &[f64], accuracy: Accuracy) -> f64 {
        let end = times.last().copied().unwrap_or(0.0);
        let acting = if has_free_body(scene) { scene.bodies.len() as f64 } else { 1.0 };
        EVALUATIONS_PER_STEP
            * scene.vertex_count() as f64
            * acting
            * f64::max(times.len() as f64, end * fastest_rate(scene) / accuracy.longest_step)
    }

    /// The requested instants [s].
    pub fn times(&self) -> &[f64] {
        &self.times
    }

    /// The phase changes up to the last instant, in order of time.
    pub fn events(&self) -> &[PhaseChange] {
        &self.events
    }

    /// Displacement x of a vertex from rest at instant `k`, of a body on a path; the world position of a vertex of a
    /// free body [scene unit].
    pub fn displacement(&self, body: usize, vertex: usize, k: usize) -> DVec3 {
        self.tracks[body][vertex].get(k).copied().unwrap_or(DVec3::ZERO)
    }

    /// The largest distance between a body's vertices in this solution at instant `k` and the vertices with the
    /// displacements, or positions, `found` [scene unit]; NaN if any of those is NaN.
    pub fn distance(&self, body: usize, k: usize, found: impl Iterator<Item = DVec3>) -> f64 {
        let distances = found.enumerate().map(|(vertex, x)| x.distance(self.displacement(body, vertex, k)));
        distances
            .fold(0.0, |largest, distance| if distance <= largest || largest.is_nan() { largest } else { distance })
    }

    /// The largest error of a vertex of a body in a world at instant `k` [radii]; NaN if its state is NaN.
    pub fn error(&self, index: usize, body: &BodyView<'_>, k: usize) -> f64 {
        let distance = match body.scene().motion {
            Motion::Prescribed(_) => {
                self.distance(index, k, (0..body.vertex_count()).map(|vertex| body.displacement(vertex)))
            }
            Motion::Free(_) => self.distance(index, k, body.positions()),
        };
        distance / body.scene().radius
    }

    /// The largest distance of a vertex from its position in another solution of the same scene at the same times
    /// [radii].
    pub fn largest_difference(&self, other: &Reference, scene: &Scene) -> f64 {
        (0..self.times.len()).map(|k| self.difference(other, scene, k)).fold(0.0, f64::max)
    }

    /// The same at instant `k`.
    pub fn difference(&self, other: &Reference, scene: &Scene, k: usize) -> f64 {
        let apart = (0..self.tracks.len()).map(|body| {
            let found = (0..self.tracks[body].len()).map(|vertex| other.displacement(body, vertex, k));
            self.distance(body, k, found) / scene.bodies[body].radius
        });
        apart.fold(0.0, f64::max)
    }
}

/// Whether vertices of different bodies depend on each other.
fn has_free_body(scene: &Scene) -> bool {
    scene.bodies.iter().any(|body| body.path().is_none())
}

/// The rate of the fastest motion of a scene [1/s]: of its oscillators, its influence, its planes, its paths or spins.
fn fastest_rate(scene: &Scene) -> f64 {
    let body = |body: &Body| {
        let motion = match &body.motion {
            Motion::Prescribed(Path::Sine { frequency, .. }) => std::f64::consts::TAU * frequency.abs(),
            Motion::Prescribed(_) => 0.0,
            Motion::Free(free) => free.spin.length(),
        };
        body.material.omega.max(body.material.damping).max(motion)
    };
    // allows for a few sources acting on one vertex
    let strongest = scene.laws().map(|law| f64::max(law.alpha, law.beta)).fold(0.0, f64::max);
    let strongest = scene.points.iter().map(|point| point.strength.abs()).fold(strongest, f64::max);
    let influence = (3.0 * strongest).sqrt();
    let planes = scene.planes.iter().map(|plane| plane.stiffness.sqrt());
    scene.bodies.iter().map(body).chain(planes).fold(f64::max(influence, 1e-3), f64::max)
}

/// The vertices of a body at the requested instants, `[vertex][time]`; empty for a vertex that has stayed at rest.
type Vertices = Vec<Vec<DVec3>>;

/// A scene to solve.
struct Problem<'a> {
    scene: &'a Scene,
    histories: &'a [History],
    times: &'a [f64],
    accuracy: Accuracy,
    /// The fastest rate of the scene [1/s].
    rate: f64,
}

impl<'a> Problem<'a> {
    fn settings(&self, system: &System<'_>, leash: f64) -> Settings {
        Settings {
            tolerances: system.tolerances(self.accuracy.tolerance, self.rate, self.times),
            longest_step: self.accuracy.longest_step / self.rate,
            leash,
        }
    }

    /// All vertices of the scene, and the phase changes of pairs with a free body.
    fn together(&self) -> Result<(Vec<Vertices>, Vec<PhaseChange>), NoReference> {
        let system = System::of_scene(self.scene);
        let all: Vec<usize> = (0..self.scene.bodies.len()).collect();
        let chunks = self.divide(&all, &|_, _, _| true);
        let settings = self.settings(&system, f64::INFINITY);
        let found = solver::solve(&system, &chunks, &settings)?;
        let Track { coordinates, changes } = found.unwrap_or(Track { coordinates: vec![], changes: vec![] });
        let mut first = 0;
        let tracks = self.scene.bodies.iter().map(|body| {
            let own = first..first + body.shape.vertex_count() as usize;
            first = own.end;
            own.map(|i| coordinates.iter().map(|at| at[i]).collect()).collect()
        });
        Ok((tracks.collect(), changes))
    }

    /// The vertices of a body in a scene without free bodies, each on its own.
    fn each(&self, body: usize) -> Result<Vertices, NoReference> {
        let leash = self.scene.bodies[body].radius;
        let near = |start, end, other| self.is_near(body, other, leash, start, end);
        let chunks = self.divide(&[body], &near);
        // for vertices that move farther from rest than the leash
        let all_chunks = OnceLock::new();
        let mesh = self.scene.bodies[body].shape.mesh();
        let track = |vertex| {
            let system = System::of_vertex(self.scene, body, &mesh, vertex);
            let track = match solver::solve(&system, &chunks, &self.settings(&system, leash))? {
                Some(track) => track,
                None => {
                    let chunks = all_chunks.get_or_init(|| self.divide(&[body], &|_, _, _| true));
                    let found = solver::solve(&system, chunks, &self.settings(&system, f64::INFINITY))?;
                    found.unwrap_or(Track { coordinates: vec![], changes: vec![] })
                }
            };
            let at: Vec<DVec3> = track.coordinates.iter().map(|at| at[0]).collect();
            Ok(if at.iter().all(|&x| x == DVec3::ZERO) { vec![] } else { at })
        };
        (0..mesh.vertex_count()).into_par_iter().map(track).collect()
    }

    /// Whether the influence sphere of a body on a path, or of a force point, can reach a vertex of another body within
    /// `leash` of rest.
    fn is_near(&self, index: usize, other: usize, leash: f64, start: f64, end: f64) -> bool {
        let (body, source) = (&self.scene.bodies[index], source_path(self.scene, other));
        let near = self.scene.source_sphere_radius(other) + body.radius + leash;
        let speed = path(body).bounds(start, end).speed + source.bounds(start, end).speed;
        let distance = path(body).position(start).distance(source.position(start));
        distance - speed * (end - start) <= near
    }

    /// Splits the time span where something jumps and at the requested instants, for the system of some bodies;
    /// `is_near` says whether another body matters to the only one between two times.
    fn divide(&self, members: &[usize], is_near: &dyn Fn(f64, f64, usize) -> bool) -> Vec<Chunk<'a>> {
        let Problem { scene, histories, times, .. } = *self;
        let Some(&end) = times.last() else { return vec![] };
        let pushes = || scene.pushes.iter().filter(|push| members.contains(&push.body));
        let own = || histories.iter().filter(|it| members.contains(&it.a) || members.contains(&it.b));
        let mut ends: Vec<f64> = times.to_vec();
        ends.extend(own().flat_map(|history| history.changes.iter().map(|change| change.time)));
        ends.extend(pushes().flat_map(|push| [push.start, push.end()]));
        ends.extend(scene.points.iter().flat_map(|point| [point.start, point.end()]));
        let sources = 0..scene.bodies.len() + scene.points.len();
        ends.extend(sources.flat_map(|source| source_path(scene, source).knots().iter().copied()));
        ends.retain(|&t| 0.0 < t && t <= end);
        ends.sort_by(f64::total_cmp);
        ends.dedup();

        let is_at_zero = times.first().is_some_and(|&t| t <= 0.0);
        let mut start = 0.0;
        let mut chunks = Vec::with_capacity(ends.len() + 1);
        // a chunk without length, for what is requested at t = 0
        for end in is_at_zero.then_some(0.0).into_iter().chain(ends) {
            chunks.push(self.chunk(members, is_near, start, end));
            start = end;
        }
        chunks
    }

    fn chunk(&self, members: &[usize], is_near: &dyn Fn(f64, f64, usize) -> bool, start: f64, end: f64) -> Chunk<'a> {
        let Problem { scene, histories, times, .. } = *self;
        let middle = 0.5 * (start + end);
        let others = (0..scene.bodies.len()).filter(|&other| !members.contains(&other) && is_near(start, end, other));
        let points = (scene.bodies.len()..).zip(&scene.points);
        let points = points.filter(|&(source, point)| point.acts_at(middle) && is_near(start, end, source));
        let points = points.map(|(source, _)| source);
        let bodies: Vec<usize> = members.iter().copied().chain(others).chain(points).collect();
        let link = |[k, l]: [usize; 2]| {
            if let Some(point) = bodies[l].checked_sub(scene.bodies.len()) {
                let point = &scene.points[point];
                let law = PairLaw { alpha: point.strength, core_width: 0.0, ..PairLaw::DEFAULT };
                let link = Link { bodies: [k, l], law, phase: Some(Phase::Merged) };
                return point.acts_on(bodies[k]).then_some(link);
            }
            let (a, b) = (bodies[k].min(bodies[l]), bodies[k].max(bodies[l]));
            let are_on_paths = [a, b].iter().all(|&body| scene.bodies[body].path().is_some());
            let known = || {
                let history = histories.iter().find(|history| (history.a, history.b) == (a, b));
                history.map_or(Phase::Apart, |history| history.phase_at(middle))
            };
            let link = Link { bodies: [k, l], law: scene.law(a, b), phase: are_on_paths.then(known) };
            // what does nothing throughout is left out
            let is_idle = link.phase == Some(Phase::Apart) && !link.law.apart_repels;
            (!is_idle).then_some(link)
        };
        let pairs = (0..members.len()).flat_map(|k| (k + 1..bodies.len()).map(move |l| [k, l]));
        let links: Vec<Link> = pairs.filter_map(link).collect();
        let is_still = |&body: &usize| {
            let body = &scene.bodies[body];
            body.material.response == Response::Rigid || path(body).is_fixed()
        };
        let is_on_path = |&body: &usize| scene.bodies[body].path().is_some();
        let acts = |push: &&Push| members.contains(&push.body) && push.start <= middle && middle < push.end();
        let jumps = |source| {
            let path = source_path(scene, source);
            start > 0.0 && path.is_held() && path.knots().contains(&start)
        };
        Chunk {
            start,
            end,
            is_sample: times.binary_search_by(|t| t.total_cmp(&end)).is_ok(),
            is_calm: links.is_empty()
                && scene.planes.is_empty()
                && members.iter().all(|body| is_on_path(body) && is_still(body)),
            pushes: scene.pushes.iter().filter(acts).collect(),
            is_jump: (0..scene.bodies.len() + scene.points.len()).any(jumps),
            bodies,
            links,
        }
    }
}
