//! Islands: bodies that can act on each other within a step, and how they are advanced.

use std::sync::{Mutex, PoisonError};

use glam::DVec3;
use pulp::Arch;

use super::{
    dense::{DenseOutput, Interpolated},
    member::{Member, driven, kick},
    near::Near,
};
use crate::{
    lock,
    model::oscillator::Oscillator,
    parallel,
    scene::{Path, Point, Push, Scene},
    sim::{
        free::{self, Body, Driven, Island, Pair, Parts, Paths, Report, Scratch, Shape},
        neighbours::PairId,
        on_request::OnRequest,
        span::Span,
        work::{MAX_WITHIN, Tally, Work},
    },
};

/// With fewer vertices than this to step, a second thread does not pay off.
const PARALLEL_VERTICES: usize = 512;
/// With fewer vertices than this to copy, a second thread does not pay off.
const PARALLEL_COPIES: usize = 8192;

/// The bodies and pairs of an island, ascending.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Group {
    pub bodies: Vec<u32>,
    /// Bodies on paths that act on the island but are advanced elsewhere.
    pub sources: Vec<u32>,
    pub pairs: Vec<PairIn>,
}

/// A pair in an island. A pair between a body on a path and a free one may be in two.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PairIn {
    pub pair: PairId,
    /// Whether this island reports its phase changes.
    pub is_own: bool,
}

impl Group {
    pub fn clear(&mut self) {
        let Group { bodies, sources, pairs } = self;
        bodies.clear();
        sources.clear();
        pairs.clear();
    }
}

/// An island in a step.
#[derive(Clone, Default)]
pub(super) struct Job {
    pub group: Group,
    pub is_done: bool,
    /// The bodies at the end of the step, pairs, forces, and how far each body moved.
    pub parts: Parts,
    /// The bodies of the island, then its sources, then the force points that act in the step.
    all: Vec<u32>,
    pub report: Report,
    pub failure: Option<free::Failure>,
    pub work: u64,
    /// The work that it may do in adaptive steps [units].
    pub budget: u64,
    /// Whether it takes steps of fixed length.
    pub is_fixed: bool,
    /// The states within the step, computed on first use; `Some(None)` if they cannot be found.
    dense: OnRequest<Option<DenseOutput>>,
    /// The lengths of the first steps of its bodies [s].
    first_lengths: Vec<f64>,
    /// Whether it keeps these states in the step, because they were asked for in the one before.
    keeps_states: bool,
}

/// The input for advancing islands.
pub(super) struct Conditions<'a> {
    pub scene: &'a Scene,
    pub members: &'a [Member],
    pub near: &'a Near,
    pub span: Span,
    pub work: &'a Work,
    pub scratches: &'a Mutex<Vec<Scratch>>,
    pub arch: Arch,
}

/// Advances the islands that are not done, in parallel.
pub(super) fn advance(jobs: &mut [Job], conditions: &Conditions<'_>) {
    let vertices = |job: &Job| {
        let of = |&body: &u32| conditions.members[body as usize].body.shape.rest().len();
        job.group.bodies.iter().map(of).sum::<usize>()
    };
    let in_fixed_steps = jobs.iter().filter(|job| job.is_fixed).map(vertices).sum::<usize>() as u64;
    let advance = |turn: usize, job: &mut Job| {
        if !job.is_done {
            let pooled = lock(conditions.scratches).pop();
            let mut scratch = pooled.unwrap_or_else(|| Scratch::new(conditions.arch));
            job.advance(turn, in_fixed_steps, conditions, &mut scratch);
            lock(conditions.scratches).push(scratch);
        }
    };
    let left = jobs.iter().filter(|job| !job.is_done).map(vertices).sum::<usize>();
    parallel::over(left >= PARALLEL_VERTICES, jobs, advance);
}

impl Job {
    /// Calls `write` with the states of some bodies of the island at `time` [s] within the last step, which began at
    /// `start` [s] and ended at `end`, and whose results have become the state. `None` if that fails or exceeds `work`.
    pub fn within(
        &self,
        scene: &Scene,
        ([start, end], time): ([f64; 2], f64),
        bodies: &[usize],
        arch: Arch,
        work: &Tally<'_>,
        write: impl FnMut(usize, &Interpolated<'_>),
    ) -> Option<()> {
        if self.is_fixed {
            return None; // its steps are not accurate enough to be subdivided
        }
        let paths = OfScene { scene, bodies: &self.all };
        let mut dense = lock(&self.dense.0);
        let dense = dense.get_or_insert_with(|| {
            let (parts, mut scratch) = (self.parts_before(scene, start), Scratch::new(arch));
            let report = &mut Report::default();
            DenseOutput::advance(parts, scene.tolerance, [start, end], &mut scratch, &paths, work, report).1.ok()
        });
        dense.as_mut()?.at(time, bodies, &paths, work, write)
    }

    /// Prepares for the next step.
    pub fn begin_step(&mut self) {
        self.is_fixed = false;
        let known = self.dense.0.get_mut().unwrap_or_else(PoisonError::into_inner);
        self.keeps_states = matches!(known, Some(Some(dense)) if dense.is_used);
    }

    /// The island at the start of the last step, at `start` [s].
    fn parts_before(&self, scene: &Scene, start: f64) -> Parts {
        // as before the step, except for the lengths of steps, the bodies on paths and the phases
        let mut parts = Parts { step_lengths: self.first_lengths.clone(), ..self.parts.clone() };
        for (&body, copy) in self.all.iter().zip(&mut parts.bodies) {
            copy.fill_states();
            if let Some(path) = scene.source_path(body as usize) {
                copy.follow(path.at(start));
            }
        }
        for (index, pair) in parts.pairs.iter_mut().enumerate() {
            pair.phase = pair.window.map_or(pair.phase, |window| window.phase(start));
            let first = self.report.changes.iter().find(|change| change.pair == index);
            pair.phase = first.map_or(pair.phase, |change| change.from);
        }
        parts
    }

    /// Advances the island, the one of this turn; `in_fixed_steps` is the number of vertices of all that take fixed steps.
    fn advance(&mut self, turn: usize, in_fixed_steps: u64, conditions: &Conditions<'_>, scratch: &mut Scratch) {
        let Conditions { scene, members, near, span, work, .. } = *conditions;
        let Group { bodies, sources, pairs } = &self.group;
        self.dense = OnRequest::default();
        self.all.clear();
        self.all.extend(bodies.iter().chain(sources));
        let first_point = self.all.len() as u32;
        let points = (scene.bodies.len() as u32..).zip(&scene.points);
        let acts = |point: &Point| point.start <= span.end && span.start <= point.end();
        self.all.extend(points.filter(|(_, point)| acts(point)).map(|(source, _)| source));
        let local = |body: u32| match bodies.binary_search(&body) {
            Ok(index) => index as u32,
            Err(_) => (bodies.len() + sources.binary_search(&body).unwrap_or_default()) as u32,
        };
        let mut parts = std::mem::take(&mut self.parts);
        let Parts { bodies: copies, field, pairs: between, step_lengths, .. } = &mut parts;
        step_lengths.clear();
        step_lengths.extend(bodies.iter().map(|&body| members[body as usize].step_length));
        self.first_lengths.clone_from(step_lengths);
        field.set_common(scene);
        field.pushes.clear();
        field.forces.clear();
        field.breaks.clear();
        span.jumps_of(scene, self.all.iter().copied(), &mut field.breaks);
        field.breaks.sort_by(f64::total_cmp);
        field.first_point = first_point;
        for (index, &body) in bodies.iter().enumerate() {
            let pushes = members[body as usize].pushes.iter().take_while(|push| push.start < span.end);
            let pushes = pushes.filter(|push| push.end() > span.start);
            field.pushes.extend(pushes.map(|&push| Push { body: index, ..push }));
            field.forces.extend(scene.bodies[body as usize].force.iter().map(|force| (index as u32, force.clone())));
        }
        copies.resize_with(self.all.len(), || source(&members[self.all[0] as usize].body));
        let vertices = bodies.iter().map(|&body| members[body as usize].body.shape.rest().len()).sum::<usize>();
        parallel::over(vertices >= PARALLEL_COPIES, copies, |index, copy| {
            let body = self.all[index] as usize;
            if let Some(point) = body.checked_sub(scene.bodies.len()) {
                *copy = source_at(scene, &scene.points[point], span.start);
            } else if index >= bodies.len() {
                *copy = source(&members[body].body);
            } else {
                copy.copy_from(&members[body].body);
                copy.fill_states();
            }
        });
        let local_pair = |of: &PairIn| {
            let pair = near.get(of.pair);
            free::Pair { a: local(pair.a), b: local(pair.b), ..*pair }
        };
        between.clear();
        between.extend(pairs.iter().map(local_pair));
        for (b, &source) in (first_point..).zip(&self.all[first_point as usize..]) {
            let point = &scene.points[source as usize - scene.bodies.len()];
            let on = (0..).zip(bodies).filter(|(_, body)| point.acts_on(**body as usize));
            between.extend(on.map(|(a, _)| Pair::with_point(a, b, point, span.start)));
        }
        let paths = OfScene { scene, bodies: &self.all };
        let tally = Tally::limited(work, turn, if self.is_fixed { u64::MAX } else { self.budget });
        let mut changes = std::mem::take(&mut self.report.changes);
        changes.clear();
        self.report = Report { changes, ..Report::default() };
        let (tolerance, report) = (scene.tolerance, &mut self.report);
        let island = if self.keeps_states && !self.is_fixed {
            let ends = [span.start, span.end];
            let (island, done) = DenseOutput::advance(parts, tolerance, ends, scratch, &paths, &tally, report);
            // it would not be repeated for more
            let is_little = tally.done() <= MAX_WITHIN;
            self.failure = done.map(|dense| self.dense = OnRequest(Mutex::new(is_little.then_some(Some(dense))))).err();
            island
        } else {
            let mut island = Island::resume(parts, tolerance, span.start);
            let done = match self.is_fixed {
                true => island.advance_in_fixed_steps(scratch, span.end, in_fixed_steps, &paths, &tally, report),
                false => island.advance_with(scratch, span.end, &paths, &tally, report, &mut |_| ()),
            };
            self.failure = done.err();
            island
        };
        self.work = tally.done();
        self.parts = island.into_parts();
        self.is_done = true;
    }
}

/// The paths of a scene's bodies, by their indices in an island.
pub(super) struct OfScene<'a> {
    scene: &'a Scene,
    bodies: &'a [u32],
}

impl Paths for OfScene<'_> {
    fn at(&self, body: usize, t: f64, before: bool) -> Driven {
        driven(self.scene, self.bodies[body], t, before)
    }

    fn turning_rate(&self, body: usize) -> f64 {
        self.scene.source_path(self.bodies[body] as usize).map_or(0.0, Path::turning_rate)
    }

    fn kick(&self, body: usize, t: f64) -> DVec3 {
        kick(self.scene, self.bodies[body], t)
    }
}

/// A body on a path that only acts on others.
fn source(body: &Body) -> Body {
    Body { centre: body.centre, velocity: body.velocity, ..without_vertices(body.radius, body.sphere_radius) }
}

/// A force point at `t` [s], as a body without vertices.
pub(super) fn source_at(scene: &Scene, point: &Point, t: f64) -> Body {
    let mut body = without_vertices(point.radius, scene.influence.sphere_radius(point.radius));
    body.follow(point.path.at(t));
    body
}

fn without_vertices(radius: f64, sphere_radius: f64) -> Body {
    thread_local! {
        static NONE: std::sync::Arc<Shape> = std::sync::Arc::new(Shape::none());
    }
    let source = Body::prescribed(NONE.with(std::sync::Arc::clone), radius, Oscillator { omega: 0.0, damping: 0.0 });
    Body { sphere_radius, ..source }
}
