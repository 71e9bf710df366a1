//! An island: coupled bodies, advanced together with adaptive steps that end where a pair changes phase.

use glam::DVec3;
use pulp::Arch;
use rayon::prelude::*;
use smallvec::SmallVec;

use super::{
    super::work::Tally,
    body::Body,
    conserved::{self, Conserved},
    field::{Driven, Field, Pair, Paths},
    force::{Acting, View},
    ledger::{Done, Ledger},
    observed::Snapshot,
    split::{Around, By, Motion, Piece},
    step::{Course, MIDDLE, Place, Span},
    verlet,
};
use crate::{
    model::phase::Phase,
    sim::numerics::{bernstein::Polynomial, larger, nodes::MIDPOINTS},
};

/// Largest number of sweeps of a step before a shorter one is tried.
const MAX_SWEEPS: u32 = 24;
/// Largest number of steps of one [`Island::advance`].
const MAX_STEPS: u64 = 20_000;
/// Largest number of phase changes of one pair in one [`Island::advance`].
const MAX_CHANGES: u32 = 200;
/// With fewer vertices than this, a second thread does not pay off.
const PARALLEL_VERTICES: usize = 4096;
/// A step has converged when the remaining corrections are below this fraction of the tolerance, so that its error is
/// the discretisation error, not that of unfinished iteration.
const SETTLED: f64 = 3e-2;
/// Larger tolerances than this make steps longer, but do not end their iteration earlier [radii/s]. Otherwise its
/// remainder, which is of low order, would dominate the error of steps much shorter than the tolerance requires.
pub(super) const MAX_SETTLED_TOLERANCE: f64 = 1e-6;
/// A step may be longer than [`Island::step_length`] by this factor if that saves another step. Its expected error is then
/// nine tenths of the tolerance, and this saves far more steps than are rejected.
const HOPED: f64 = 1.15;
/// Distances within this fraction of a threshold count as on it.
const STANDING: f64 = 1e-12;
/// Largest ratio by which the expected step length grows from one step to the next.
const MAX_GROWTH: f64 = 4.0;
/// The reported sum of estimates is meant to bound the error: it allows for errors that grow after their step, and for
/// residuals that are larger between the midpoints.
pub(super) const GROWTH: f64 = 2.0;
/// In islands with more bodies than this, steps do not end where a gradual change of strength begins or ends: it is
/// smooth enough for the error estimate, and the steps of all bodies would become shorter.
const MAX_WAITING: usize = 8;
/// Work of the force of a plane on a vertex, a solution of nine equations [units].
const HOLD: u64 = 200;
/// Work of a sweep for each part of a step of a vertex that is advanced alone [units].
const LEG: u64 = 200;
/// Largest rotation of a body's frame in a step [rad].
const MAX_TURN: f64 = 1.0;

/// A phase change of a pair.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Change {
    /// Time of the change [s].
    pub time: f64,
    /// Index of the pair.
    pub pair: usize,
    /// Centre distance over the sum of the radii [–].
    pub q: f64,
    /// Its rate q′ [1/s].
    pub rate: f64,
    /// The phase that ended.
    pub from: Phase,
    /// The phase that began.
    pub to: Phase,
    /// Sudden change of the influence's energy, Σ m Δs (Φ − Φ(r_e)) [mass · scene unit²/s²].
    pub energy: f64,
}

/// Results and statistics, accumulated by [`Island::advance`].
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// Phase changes, in order of time.
    pub changes: Vec<Change>,
    /// Steps taken; where bodies take their own steps, the largest number of any body.
    pub steps: u64,
    /// Steps taken, summed over bodies.
    pub body_steps: u64,
    /// The length of the shortest step [s], and the body with the largest error in it.
    pub shortest: Option<(f64, u32)>,
    /// Number of rejected steps, retried with shorter ones.
    pub rejected: u64,
    /// Number of correction sweeps over all bodies.
    pub sweeps: u64,
    /// Largest number of contacts of vertices with planes in a sweep; not counted where bodies take their own steps.
    pub held: u64,
    /// Sum over the steps of the largest estimated error [radii], times [`GROWTH`].
    pub error: f64,
    /// Energy added to the bodies, by cause.
    pub ledger: Ledger,
}

/// Why an island cannot be advanced any further.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Failure {
    /// A pair chatters: it changes its phase over and over.
    #[error(
        "the pair of bodies {a} and {b} changed its phase {MAX_CHANGES} times by t = {time:.9} s within one step: where \
         attraction turns into repulsion at once, bodies chatter; give the core a width (core_width), or thresholds that \
         are farther apart"
    )]
    Chatter {
        /// Index of the pair's first body.
        a: u32,
        /// Index of the pair's second body.
        b: u32,
        /// Time of the failure [s].
        time: f64,
    },
    /// The step size underflows: the tolerance would require ever shorter steps.
    #[error(
        "at t = {time:.9} s body {body} cannot be followed within the tolerance: steps of {step:e} s are still too long; \
         allow a larger tolerance, or make what acts on it smoother (core_width, a plane's slip)"
    )]
    Unresolved {
        /// Index of the body.
        body: usize,
        /// Time of the failure [s].
        time: f64,
        /// Length of the last step tried [s].
        step: f64,
    },
    /// The limit of work is reached, or the run is interrupted.
    #[error("stopped at t = {time:.9} s")]
    Stopped {
        /// Index of the body with the most vertices.
        body: usize,
        /// Time of the failure [s].
        time: f64,
        /// Expected length of the next step [s].
        step: f64,
    },
}

/// The parts of an island, into which it is taken apart to reuse its lists.
#[derive(Clone, Debug, Default)]
pub(in crate::sim) struct Parts {
    pub bodies: Vec<Body>,
    pub pairs: Vec<Pair>,
    pub field: Field,
    /// Motion of each body so far.
    pub ways: Vec<Way>,
    /// Step length at which each body is expected to meet the tolerance [s]; unlimited where missing.
    pub step_lengths: Vec<f64>,
}

/// Free bodies, and the bodies on prescribed paths near them.
#[derive(Clone, Debug, Default)]
pub struct Island {
    pub(super) bodies: Vec<Body>,
    pub(super) pairs: Vec<Pair>,
    pub(super) field: Field,
    pub(super) tolerance: f64,
    pub(super) time: f64,
    /// Step length that is expected to meet the tolerance [s].
    pub(super) step_length: f64,
    pub(super) step_lengths: Vec<f64>,
    /// Motion of each body so far.
    pub(super) ways: Vec<Way>,
    scratch: Scratch,
}

/// An advance of an island to a time.
pub(in crate::sim) struct Advance {
    end: f64,
    /// Steps below this length are not tried [s].
    shortest: f64,
    /// Number of steps tried so far.
    tried: u64,
}

/// Extremes of a body's motion since the island was created.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Way {
    /// Initial position of the centre [scene unit].
    pub from: DVec3,
    /// Largest distance of the centre from there [scene unit].
    pub centre: f64,
    /// Upper bound of the distance of a vertex from the centre [scene unit].
    pub extent: f64,
    /// Largest |x| at the end [scene unit].
    pub displacement: f64,
    /// Largest |u| at the end [scene unit/s].
    pub speed: f64,
}

/// Buffers, reused between steps and islands.
#[derive(Clone, Debug, Default)]
pub(in crate::sim) struct Scratch {
    /// By body, up to the last with vertices.
    pub(super) courses: Vec<Course>,
    acting: Vec<Acting>,
    pub(super) places: Vec<[Place; 5]>,
    motions: Vec<Motion>,
    /// The reaction on each body's sphere at a sample.
    reactions: Vec<DVec3>,
    /// The pairs that each body belongs to.
    pub(super) pairs_of: Vec<Vec<u32>>,
    changes: Vec<u32>,
    pub(super) arch: Arch,
    pub(super) verlet: verlet::Buffers,
    /// Left over from islands with more bodies.
    spare: Spare,
}

#[derive(Clone, Debug, Default)]
struct Spare {
    courses: Vec<Course>,
    acting: Vec<Acting>,
    pairs_of: Vec<Vec<u32>>,
}

impl Scratch {
    /// Finds the motions of bodies, for vertices that are advanced alone. Returns whether there are any.
    fn find_motions(&mut self, span: &Span) -> bool {
        let Scratch { courses, places, motions, .. } = self;
        motions.clear();
        let any = courses.iter().any(|course| !course.splits.is_empty());
        if any {
            motions.extend(courses.iter().zip(places).map(|(course, places)| course.motion(span, places)));
        }
        any
    }
}

/// Resizes a list to `count` elements. Surplus elements go to `spare` and come from there, so that they keep their
/// allocations.
fn resize<T: Default>(list: &mut Vec<T>, spare: &mut Vec<T>, count: usize) {
    while list.len() > count {
        spare.extend(list.pop());
    }
    while list.len() < count {
        list.push(spare.pop().unwrap_or_default());
    }
}

impl Scratch {
    /// Buffers of a solver that uses these instructions.
    pub fn new(arch: Arch) -> Scratch {
        Scratch { arch, ..Scratch::default() }
    }
}

/// The instant of a step at which a pair reaches a level where the step has to end.
#[derive(Clone, Copy, Debug)]
pub(super) struct Crossing {
    /// Time as a fraction of the step.
    theta: f64,
    /// Index of the pair.
    pair: usize,
    /// The level of q that is reached [–].
    level: f64,
    /// The phase that begins, if any.
    to: Option<Phase>,
}

/// A step that was solved.
#[derive(Clone, Copy, Debug)]
struct Attempt {
    /// Its end [s].
    end: f64,
    outcome: Outcome,
    /// Why it ends there, if it had to end.
    crossing: Option<Crossing>,
}

/// The error estimate of a step.
#[derive(Clone, Copy, Debug)]
pub(super) struct Outcome {
    /// Error over tolerance.
    pub error: f64,
    /// Index of the worst body.
    body: usize,
    /// Estimated error [radii].
    pub estimate: f64,
}

/// Corrections of a body below this size count as converged, in a step of length `h` [s] [scene unit].
pub(super) fn small_correction(tolerance: f64, radius: f64, h: f64) -> f64 {
    SETTLED * tolerance.min(MAX_SETTLED_TOLERANCE) * radius * h
}

impl Island {
    /// An island at t = 0 whose error stays within `tolerance` [radii/s]. Pairs start in their given phases. Bodies on
    /// prescribed paths must be at the start of their paths.
    pub fn new(bodies: Vec<Body>, pairs: Vec<Pair>, field: Field, tolerance: f64) -> Island {
        let parts = Parts { bodies, pairs, field, ..Parts::default() };
        Island::resume(parts, tolerance, 0.0)
    }

    /// Like [`Island::new`], at `time` [s] and from existing lists.
    pub(in crate::sim) fn resume(parts: Parts, tolerance: f64, time: f64) -> Island {
        let Parts { bodies, pairs, field, mut ways, mut step_lengths } = parts;
        step_lengths.resize(bodies.len(), f64::INFINITY);
        let step_length = step_lengths.iter().copied().fold(f64::INFINITY, f64::min);
        let way = |body: &Body| Way { from: body.centre, extent: body.shape.extent, ..Way::default() };
        ways.clear();
        ways.extend(bodies.iter().map(way));
        let scratch = Scratch::default();
        Island { bodies, pairs, field, tolerance, time, step_length, step_lengths, ways, scratch }
    }

    /// Takes the island apart.
    pub(in crate::sim) fn into_parts(self) -> Parts {
        let Island { bodies, pairs, field, ways, step_lengths, .. } = self;
        Parts { bodies, pairs, field, ways, step_lengths }
    }

    /// Number of bodies up to the last that has vertices; those after it only act on others.
    pub(super) fn stepped(&self) -> usize {
        self.bodies.iter().rposition(|body| !body.shape.rest.is_empty()).map_or(0, |last| last + 1)
    }

    /// The bodies.
    pub fn bodies(&self) -> &[Body] {
        &self.bodies
    }

    /// The bodies, mutable, to be modified between steps.
    pub fn bodies_mut(&mut self) -> &mut [Body] {
        &mut self.bodies
    }

    /// The pairs.
    pub fn pairs(&self) -> &[Pair] {
        &self.pairs
    }

    /// Current time [s].
    pub fn time(&self) -> f64 {
        self.time
    }

    /// Momentum, angular momentum and energy.
    pub fn conserved(&self) -> Conserved {
        Conserved::of(&self.bodies.iter().collect::<Vec<_>>(), &self.pairs, &self.field)
    }

    /// A view of the current state, for computing forces.
    pub fn snapshot(&self) -> Snapshot<'_> {
        Snapshot::new(self.bodies.iter().collect(), self.pairs.clone(), self.field.clone(), self.time)
    }

    /// Advances the island to `end` [s].
    ///
    /// # Errors
    /// If a pair chatters, or the tolerance would require steps that are too short. The state is then that at the last
    /// instant reached.
    pub fn advance(&mut self, end: f64, paths: &dyn Paths, report: &mut Report) -> Result<(), Failure> {
        let mut scratch = std::mem::take(&mut self.scratch);
        let done = self.advance_with(&mut scratch, end, paths, &Tally::unlimited(), report);
        self.scratch = scratch;
        done
    }

    /// Like [`Island::advance`], with buffers of the caller and within the limit of `work`.
    pub(in crate::sim) fn advance_with(
        &mut self,
        scratch: &mut Scratch,
        end: f64,
        paths: &dyn Paths,
        work: &Tally<'_>,
        report: &mut Report,
    ) -> Result<(), Failure> {
        let mut advance = self.begin(scratch, end);
        while self.time < end {
            self.substep(scratch, &mut advance, paths, work, report)?;
        }
        self.step_lengths.fill(self.step_length);
        self.finish(scratch, paths, report)
    }

    /// Prepares to advance the island to `end` [s] in [substeps](Self::substep).
    pub(in crate::sim) fn begin(&self, scratch: &mut Scratch, end: f64) -> Advance {
        let count = self.stepped();
        resize(&mut scratch.courses, &mut scratch.spare.courses, count);
        resize(&mut scratch.acting, &mut scratch.spare.acting, count);
        resize(&mut scratch.pairs_of, &mut scratch.spare.pairs_of, count);
        scratch.places.resize(self.bodies.len(), Default::default());
        scratch.changes.clear();
        scratch.changes.resize(self.pairs.len(), 0);
        scratch.pairs_of.iter_mut().for_each(Vec::clear);
        for (index, pair) in (0..).zip(&self.pairs) {
            for body in [pair.a as usize, pair.b as usize].into_iter().filter(|&body| body < count) {
                scratch.pairs_of[body].push(index);
            }
        }
        Advance { end, shortest: (end - self.time) * 1e-9, tried: 0 }
    }

    /// Takes one step of the solver, of the length that the tolerance allows.
    pub(in crate::sim) fn substep(
        &mut self,
        scratch: &mut Scratch,
        advance: &mut Advance,
        paths: &dyn Paths,
        work: &Tally<'_>,
        report: &mut Report,
    ) -> Result<(), Failure> {
        let stop = self.enter(scratch, advance.end, paths, report)?;
        let left = stop - self.time;
        let parts = (left / (HOPED * self.step_length)).ceil().max(1.0);
        let mut next = if parts > 1.0 { self.time + left / parts } else { stop };
        let attempt = loop {
            let attempt = self.attempt(scratch, next, paths, work, report);
            if work.is_over() {
                return Err(self.stopped());
            }
            advance.tried += 1;
            let (h, factor) = match attempt {
                Some(attempt) if attempt.outcome.error <= 1.0 => break attempt,
                Some(Attempt { end, outcome, .. }) => {
                    (end - self.time, (0.85 * libm::pow(outcome.error, -0.2)).clamp(0.1, 0.7))
                }
                None => (next - self.time, 0.4),
            };
            report.rejected += 1;
            if h < advance.shortest || advance.tried >= MAX_STEPS {
                let body = attempt.map_or(0, |attempt| attempt.outcome.body);
                return Err(Failure::Unresolved { body, time: self.time, step: h });
            }
            self.step_length = factor * h;
            next = self.time + factor * h;
        };
        let Attempt { end: next, outcome, crossing } = attempt;
        let (start, h) = (self.time, next - self.time);
        if h > 0.0 {
            let factor = 0.85 * libm::pow(outcome.error.max(1e-9), -0.2);
            // a step that was cut short does not limit the next one
            self.step_length = if factor > MAX_GROWTH { self.step_length.max(MAX_GROWTH * h) } else { factor * h };
            report.steps += 1;
            if report.shortest.is_none_or(|(shortest, _)| h < shortest) {
                report.shortest = Some((h, outcome.body as u32));
            }
            report.body_steps += self.stepped() as u64;
            report.error += GROWTH * outcome.estimate;
            self.commit(scratch, next, report);
            self.pass_gradually(scratch, start, report)?;
        }
        if let Some((pair, to)) = crossing.and_then(|crossing| Some((crossing.pair, crossing.to?))) {
            self.change(pair, to, scratch, report)?;
        }
        Ok(())
    }

    /// Applies the jumps and the changes of phase that are due now. Returns the next instant at which something jumps, at
    /// most `end` [s].
    pub(super) fn enter(
        &mut self,
        scratch: &mut Scratch,
        end: f64,
        paths: &dyn Paths,
        report: &mut Report,
    ) -> Result<f64, Failure> {
        if self.is_at_break() {
            self.kick(paths);
            self.jump(paths, report);
        }
        self.leave_phases(scratch, paths, report)?;
        Ok(f64::min(end, self.field.next_break(self.time)))
    }

    /// Applies jumps of position at the end, and changes of phase due there. Jumps of velocity ([`Island::kick`])
    /// follow at the start of the next interval.
    pub(super) fn finish(
        &mut self,
        scratch: &mut Scratch,
        paths: &dyn Paths,
        report: &mut Report,
    ) -> Result<(), Failure> {
        if self.is_at_break() {
            self.jump(paths, report);
            self.leave_phases(scratch, paths, report)?;
        }
        Ok(())
    }

    pub(in crate::sim) fn is_at_break(&self) -> bool {
        self.field.breaks.binary_search_by(|at| at.total_cmp(&self.time)).is_ok()
    }

    /// Where the velocity of a path jumps, adds the resulting jump to the velocities of the body's vertices.
    pub(in crate::sim) fn kick(&mut self, paths: &dyn Paths) {
        for (index, body) in self.bodies.iter_mut().enumerate().filter(|(_, body)| !body.is_free()) {
            let kick = paths.kick(index, self.time);
            if kick != DVec3::ZERO {
                body.u.iter_mut().for_each(|u| *u += kick);
            }
        }
    }

    /// Moves bodies on paths across jumps of position, together with their vertices. Force points begin and cease to act.
    pub(in crate::sim) fn jump(&mut self, paths: &dyn Paths, report: &mut Report) {
        for index in 0..self.bodies.len() {
            let body = &mut self.bodies[index];
            if body.is_free() {
                continue;
            }
            let to = paths.at(index, self.time, false);
            let from = std::mem::replace(&mut body.centre, to.position);
            if from == to.position {
                continue;
            }
            // change of the energy of the influence between it and free bodies
            let own = index as u32;
            for pair in self.pairs.iter().filter(|pair| pair.a == own || pair.b == own) {
                let (a, b) = (&self.bodies[pair.a as usize], &self.bodies[pair.b as usize]);
                let energy = |a: &Body, b: &Body| {
                    let q = a.centre.distance(b.centre) / (a.radius + b.radius);
                    conserved::influence(a, b, &self.field, pair.law.strength(pair.phase, q))
                };
                let after = energy(a, b);
                let old = Body { centre: from, ..self.bodies[index].clone() };
                let before = if pair.a == own { energy(&old, b) } else { energy(a, &old) };
                *report.ledger.of_source(own, &self.field) += after - before;
            }
        }
        for pair in &mut self.pairs {
            let phase = pair.window.map_or(pair.phase, |window| window.phase(self.time));
            if phase != pair.phase {
                let jump = pair.law.strength(phase, 0.0) - pair.law.strength(pair.phase, 0.0);
                let (a, b) = (&self.bodies[pair.a as usize], &self.bodies[pair.b as usize]);
                report.ledger.points += conserved::influence(a, b, &self.field, jump);
                pair.phase = phase;
            }
        }
    }

    pub(super) fn commit(&mut self, scratch: &mut Scratch, next: f64, report: &mut Report) {
        let Scratch { courses, places, .. } = &*scratch;
        let (bodies, pairs, field, h) = (&self.bodies, &self.pairs, &self.field, next - self.time);
        report.ledger +=
            Done { bodies, pairs, field, courses, places, start: self.time, h, arch: scratch.arch }.ledger();
        for (i, body) in self.bodies.iter_mut().enumerate() {
            let (places, way) = (&scratch.places[i], &mut self.ways[i]);
            let Some(course) = scratch.courses.get_mut(i) else {
                (body.centre, body.velocity) = (places[3].centre, places[3].velocity);
                continue;
            };
            for (place, frame) in places.iter().zip(&course.frames) {
                way.centre = larger(way.centre, place.centre.distance(way.from));
                way.extent = larger(way.extent, frame.extent);
            }
            let maxima = course.end(scratch.arch, body, places);
            (way.displacement, way.speed) = (maxima.x, maxima.u);
        }
        self.time = next;
    }

    pub(super) fn stopped(&self) -> Failure {
        let body = (0..self.bodies.len()).max_by_key(|&i| self.bodies[i].x.len()).unwrap_or(0);
        Failure::Stopped { body, time: self.time, step: self.step_length }
    }

    /// Tries a step to `next`, or to the first instant before at which a step has to end, without committing it; `None`
    /// if it does not converge.
    fn attempt(
        &self,
        scratch: &mut Scratch,
        next: f64,
        paths: &dyn Paths,
        work: &Tally<'_>,
        report: &mut Report,
    ) -> Option<Attempt> {
        let mut left = self.solve(scratch, &self.span(next), paths, work, report)?;
        let mut end = next;
        let crossing = self.first_crossing(scratch, next - self.time);
        if let Some(crossing) = crossing {
            (end, left) = self.end_at(scratch, next, crossing, paths, work, report)?;
        }
        let outcome = match end > self.time {
            true => self.estimate_error(scratch, &self.span(end), paths, left),
            false => Outcome { error: 0.0, body: 0, estimate: 0.0 },
        };
        Some(Attempt { end, crossing, outcome })
    }

    /// Solves the equations of a step. Returns what is left to correct, over what counts as converged; `None` if the
    /// iteration does not converge or the limit of work is reached.
    fn solve(
        &self,
        scratch: &mut Scratch,
        span: &Span,
        paths: &dyn Paths,
        work: &Tally<'_>,
        report: &mut Report,
    ) -> Option<f64> {
        // repeat with more active vertices if inactive ones may have come into reach
        let mut wide = 1.0;
        loop {
            let left = self.converge(scratch, span, wide, paths, work, report)?;
            let Scratch { courses, acting, places, .. } = &*scratch;
            let all = self.bodies.iter().zip(courses).zip(acting.iter().zip(places));
            let mut all = all
                .map(|((body, course), (acting, places))| course.outgrows_selection(body, &self.field, acting, places));
            if !all.any(|outgrows| outgrows) {
                return Some(left);
            }
            wide *= 8.0;
        }
    }

    /// The step to `next`.
    fn span(&self, next: f64) -> Span {
        let free = self.bodies.iter().filter(|body| body.is_free());
        let (sum, count) = free.fold((DVec3::ZERO, 0.0), |(sum, n), body| (sum + body.centre, n + 1.0));
        Span::new(self.time, next, sum / f64::max(count, 1.0))
    }

    /// Begins a step, and finds the vertices that something may reach in it, for bands `wide` times the expected ones.
    /// Returns their number.
    fn select(&self, scratch: &mut Scratch, span: &Span, wide: f64, paths: &dyn Paths) -> usize {
        let arch = scratch.arch;
        for (i, body) in self.bodies.iter().enumerate() {
            let places = &mut scratch.places[i];
            match scratch.courses.get_mut(i) {
                Some(course) => course.begin(arch, i, body, span, paths, places),
                None => {
                    let _: [Driven; 5] = span.driven(i, paths, places);
                }
            }
        }
        let Scratch { courses, acting, places, pairs_of, .. } = scratch;
        let mut vertices = 0;
        for (i, body) in self.bodies.iter().enumerate().take(courses.len()) {
            let pairs = pairs_of[i].iter().map(|&pair| &self.pairs[pair as usize]);
            acting[i].find(i, &self.bodies, pairs, &self.field, span, places);
            let view = View { body, field: &self.field, span, places: &places[i], first: 0, arch };
            courses[i].select(view, &mut acting[i], wide);
            vertices += courses[i].active.len();
        }
        vertices
    }

    /// Like [`Island::solve`], with active vertices for bands `wide` times the expected ones.
    fn converge(
        &self,
        scratch: &mut Scratch,
        span: &Span,
        wide: f64,
        paths: &dyn Paths,
        work: &Tally<'_>,
        report: &mut Report,
    ) -> Option<f64> {
        let arch = scratch.arch;
        let vertices = self.select(scratch, span, wide, paths);
        let parallel = vertices >= PARALLEL_VERTICES;
        // a sweep: at four nodes, every active vertex, the sums of every body, and every pair
        let sweep_work = 4 * (vertices + 16 * scratch.courses.len() + self.pairs.len()) as u64;
        if !work.spend(sweep_work) {
            return None;
        }
        // the first estimate, from node to node
        for node in 0..3 {
            self.evaluate_at(scratch, span, node);
            let Scratch { courses, places, .. } = &mut *scratch;
            for ((body, course), places) in self.bodies.iter().zip(courses).zip(places) {
                course.predict(arch, body, span, node + 1, places);
            }
        }
        let wanted = |body: &Body| small_correction(self.tolerance, body.radius, span.h);
        let mut before = f64::INFINITY;
        let mut growing = 0;
        for sweep in 0..MAX_SWEEPS {
            if !work.spend(sweep_work) {
                return None;
            }
            self.evaluate(scratch, span, sweep == 0, paths, parallel);
            report.sweeps += 1;
            let held = scratch.courses.iter().map(|course| course.held.len() as u64).sum();
            report.held = report.held.max(held);
            work.spend(HOLD * held);
            let legs = scratch.courses.iter().flat_map(|course| &course.splits).map(|split| split.legs().len() as u64);
            work.spend(LEG * legs.sum::<u64>());
            // largest correction over the wanted size
            let correct_one = |((body, course), places): ((&Body, &mut Course), &mut [Place; 5]),
                               samples: std::ops::Range<usize>| {
                let rounding = 4e-15 * (places[0].centre.length() + body.shape.extent) * f64::max(1.0, 1.0 / span.h);
                course.correct(arch, body, span, samples, places) / f64::max(wanted(body), rounding)
            };
            let mut correct = |samples: std::ops::Range<usize>| {
                let Scratch { courses, places, .. } = &mut *scratch;
                let correct_one = |all| correct_one(all, samples.clone());
                if parallel {
                    let all = self.bodies.par_iter().zip(courses.par_iter_mut()).zip(places.par_iter_mut());
                    all.map(correct_one).reduce(|| 0.0, larger)
                } else {
                    self.bodies.iter().zip(courses.iter_mut()).zip(places.iter_mut()).map(correct_one).fold(0.0, larger)
                }
            };
            // The end comes first. Once it has converged, the other nodes need no further correction: both follow from
            // the same forces.
            let mut change = correct(if sweep == 0 { 1..4 } else { 3..4 });
            if !change.is_finite() {
                return None;
            }
            let rate = if sweep > 0 { change / before } else { 1.0 };
            // the remaining corrections are the rest of a geometric series
            let left = if rate < 0.9 { change * rate / (1.0 - rate) } else { change };
            if sweep > 0 && left <= 1.0 {
                return Some(left);
            }
            if sweep > 0 {
                change = larger(change, correct(1..3));
            }
            growing = if change > 0.8 * before { growing + 1 } else { 0 };
            if growing >= 4 {
                return None;
            }
            before = change;
        }
        None
    }

    /// Evaluates the forces on all bodies at the nodes, for their currently estimated positions.
    fn evaluate(&self, scratch: &mut Scratch, span: &Span, is_first: bool, paths: &dyn Paths, parallel: bool) {
        let arch = scratch.arch;
        let Scratch { courses, acting, places, pairs_of, .. } = &mut *scratch;
        let view =
            |i: usize, first| View { body: &self.bodies[i], field: &self.field, span, places: &places[i], first, arch };
        let find = |(i, (course, acting)): (usize, (&mut Course, &mut Acting))| {
            let pairs = pairs_of[i].iter().map(|&pair| &self.pairs[pair as usize]);
            acting.find(i, &self.bodies, pairs, &self.field, span, places);
            acting.find_splits(&view(i, 0), course)
        };
        let any_changed = if parallel {
            let all = courses.par_iter_mut().zip(acting.par_iter_mut()).enumerate();
            all.map(find).reduce(|| false, |a, b| a | b)
        } else {
            courses.iter_mut().zip(acting.iter_mut()).enumerate().map(find).fold(false, |a, b| a | b)
        };
        // the forces at the start stay the same, unless other vertices are advanced alone
        let first = usize::from(!is_first && !any_changed);
        let evaluate = |(i, (course, acting)): (usize, (&mut Course, &mut Acting))| {
            acting.evaluate(&view(i, first), course);
        };
        if parallel {
            courses.par_iter_mut().zip(acting.par_iter_mut()).enumerate().for_each(evaluate);
        } else {
            courses.iter_mut().zip(acting.iter_mut()).enumerate().for_each(evaluate);
        }
        self.solve_splits(scratch, span, is_first, paths, parallel);
        for sample in first..4 {
            self.drive(scratch, span, sample);
        }
    }

    /// Advances the vertices on which contacts begin or cease to act.
    fn solve_splits(&self, scratch: &mut Scratch, span: &Span, is_first: bool, paths: &dyn Paths, parallel: bool) {
        if !scratch.find_motions(span) {
            scratch.courses.iter_mut().for_each(|course| course.pieces.clear());
            return;
        }
        let Scratch { courses, acting, places, motions, .. } = &mut *scratch;
        let small_correction = small_correction(self.tolerance, 1.0, span.h);
        let around =
            Around { bodies: &self.bodies, field: &self.field, span, paths, motions, places, small_correction };
        let solve = |(i, (course, acting)): (usize, (&mut Course, &Acting))| {
            let mut splits = std::mem::take(&mut course.splits);
            splits.iter_mut().for_each(|split| split.solve(i, course, acting, &around, is_first));
            course.splits = splits;
        };
        if parallel {
            courses.par_iter_mut().zip(acting.par_iter()).enumerate().for_each(solve);
        } else {
            courses.iter_mut().zip(acting.iter()).enumerate().for_each(solve);
        }
        for course in courses.iter_mut() {
            let Course { pieces, splits, .. } = course;
            pieces.clear();
            let legs = splits.iter().flat_map(|split| split.legs());
            pieces.extend(legs.filter(|leg| !leg.touches.is_empty()).map(|leg| leg.piece));
        }
        // reactions equal actions
        for i in 0..courses.len() {
            let splits = std::mem::take(&mut courses[i].splits);
            for split in &splits {
                let mass = courses[i].active.mass(split.vertex as usize);
                for leg in split.legs() {
                    for touch in &leg.touches {
                        let By::Sphere(source) = touch.by else { continue };
                        let body = &self.bodies[source as usize];
                        if body.is_free() {
                            let force = touch.g.map(|g| -mass * g);
                            let torque = std::array::from_fn(|n| span.arm(touch.source[n].centre).cross(force[n]));
                            let acceleration = force.map(|force| force / body.mass());
                            let turn = [DVec3::ZERO; 4];
                            let piece = Piece::new([leg.from, leg.to], span.h, acceleration, torque, turn);
                            courses[source as usize].pieces.push(piece);
                        }
                    }
                }
            }
            courses[i].splits = splits;
        }
    }

    /// Evaluates the forces on all bodies at a single sample.
    fn evaluate_at(&self, scratch: &mut Scratch, span: &Span, sample: usize) {
        let Scratch { courses, acting, places, pairs_of, arch, .. } = scratch;
        for (i, (course, acting)) in courses.iter_mut().zip(acting).enumerate() {
            let pairs = pairs_of[i].iter().map(|&pair| &self.pairs[pair as usize]);
            acting.find(i, &self.bodies, pairs, &self.field, span, places);
            let (body, places) = (&self.bodies[i], &places[i]);
            let view = View { body, field: &self.field, span, places, first: sample, arch: *arch };
            acting.evaluate_at(sample, &view, course);
        }
        self.drive(scratch, span, sample);
    }

    /// Updates all bodies for the forces at a sample.
    fn drive(&self, scratch: &mut Scratch, span: &Span, sample: usize) {
        let Scratch { courses, places, reactions, .. } = scratch;
        reactions.clear();
        reactions.resize(self.bodies.len(), DVec3::ZERO);
        for reaction in courses.iter().flat_map(|course| &course.reactions) {
            reactions[reaction.source as usize] += reaction.force[sample];
        }
        for (i, (body, course)) in self.bodies.iter().zip(courses).enumerate() {
            let Place { centre, velocity } = places[i][sample];
            let given = self.field.given(i, span.time(sample), centre, velocity);
            course.drive(body, sample, self.field.gravity + given, reactions[i], &places[i][sample], span);
        }
    }

    /// Estimates the error of a step from its residuals at the midpoints and from what is left to correct.
    fn estimate_error(&self, scratch: &mut Scratch, span: &Span, paths: &dyn Paths, left: f64) -> Outcome {
        let arch = scratch.arch;
        let mut span = span.clone();
        for k in 0..MIDPOINTS.len() {
            span.sample_midpoint(k);
            let Scratch { courses, places, .. } = &mut *scratch;
            for (i, body) in self.bodies.iter().enumerate() {
                match courses.get_mut(i) {
                    Some(course) => {
                        course.sample_midpoint(i, body, &span, k, paths, &mut places[i]);
                        course.correct(arch, body, &span, MIDDLE..MIDDLE + 1, &mut places[i]);
                    }
                    None => {
                        let Driven { position, velocity, .. } = paths.at(i, span.time(MIDDLE), false);
                        places[i][MIDDLE] = Place { centre: position, velocity };
                    }
                }
            }
            self.evaluate_at(scratch, &span, MIDDLE);
            scratch.courses.iter_mut().for_each(|course| course.add_residuals(arch, &span, k));
        }
        if scratch.find_motions(&span) {
            let Scratch { courses, acting, places, motions, .. } = &mut *scratch;
            let (bodies, field) = (&self.bodies[..], &self.field);
            let around = Around { bodies, field, span: &span, paths, motions, places, small_correction: 0.0 };
            for (i, acting) in acting.iter().enumerate() {
                let splits = std::mem::take(&mut courses[i].splits);
                for split in &splits {
                    let mass = courses[i].active.mass(split.vertex as usize);
                    let mut owners: SmallVec<[(u32, (f64, f64)); 8]> = SmallVec::new();
                    let error =
                        split.error(i, &courses[i], acting, &around, |owner, error| owners.push((owner, error)));
                    courses[i].errors.add_split(error, mass / bodies[i].mass());
                    for (owner, error) in owners {
                        let owner = owner as usize;
                        if bodies[owner].is_free() {
                            courses[owner].errors.add_reaction(error, mass / bodies[owner].mass());
                        }
                    }
                }
                courses[i].splits = splits;
            }
        }
        let mut worst = Outcome { error: 0.0, body: 0, estimate: 0.0 };
        for (i, (body, course)) in self.bodies.iter().zip(&scratch.courses).enumerate() {
            let found = course.error(arch, body, &self.field) / body.radius;
            let estimate = found + left * small_correction(self.tolerance, 1.0, span.h);
            let turned = course.frames[3].turned.length();
            // Rounding of position and velocity adds as much to the estimate of a shorter step.
            let rounded = body.centre.length() + body.shape.extent + body.velocity.length();
            let rounding = 2.0 * f64::EPSILON * rounded / body.radius;
            let error = estimate / (self.tolerance * span.h + rounding);
            let error = if turned > MAX_TURN { error.max(2.0) } else { error };
            if !(error <= worst.error) {
                worst = Outcome { error, body: i, estimate };
            }
        }
        worst
    }

    /// The levels of q at which a step ends, each with the direction of the crossing (whether it falls; `None`: either)
    /// and the new phase, if any.
    fn levels(&self, pair: &Pair) -> impl Iterator<Item = (f64, Option<bool>, Option<Phase>)> + use<> {
        let Pair { phase, law, .. } = *pair;
        let ends = law.rim(phase).into_iter().flat_map(|rim| rim.ends());
        let are_waited_for = self.bodies.len() <= MAX_WAITING;
        let ends = ends.filter(move |&level| level > 0.0 && are_waited_for).map(|level| (level, None, None));
        let ways = pair.transitions().filter(move |way| !law.is_gradual(phase, way.to));
        ways.map(|way| (way.level, Some(way.falling), Some(way.to))).chain(ends)
    }

    /// Polynomial, in the step just tried, whose zeros are the instants at which a pair's q passes `level`; `None` if
    /// it has none.
    fn course_of(&self, scratch: &Scratch, pair: &Pair, level: f64, h: f64) -> Option<Polynomial> {
        let (a, b) = (&scratch.places[pair.a as usize], &scratch.places[pair.b as usize]);
        let rim = level * (self.bodies[pair.a as usize].radius + self.bodies[pair.b as usize].radius);
        let distance: [f64; 4] = std::array::from_fn(|node| a[node].centre.distance(b[node].centre));
        let values = distance.map(|d| (d - rim) * (d + rim));
        let rates: [f64; 4] = std::array::from_fn(|node| {
            2.0 * h * (a[node].centre - b[node].centre).dot(a[node].velocity - b[node].velocity)
        });
        let fastest = rates.iter().fold(0.0, |m: f64, r| m.max(r.abs()));
        let alike = values.iter().all(|&v| (v > 0.0) == (values[0] > 0.0));
        if alike && values.iter().all(|v| v.abs() > fastest) {
            return None;
        }
        let polynomial = Polynomial::new(&values, &rates);
        let stands = (distance[0] - rim).abs() <= STANDING * rim;
        Some(if stands { polynomial.starting_at_zero() } else { polynomial })
    }

    /// Changes the phases of pairs that passed a threshold without a jump of strength in the step from `start` [s]
    /// until now; no step has to end there.
    pub(super) fn pass_gradually(
        &mut self,
        scratch: &mut Scratch,
        start: f64,
        report: &mut Report,
    ) -> Result<(), Failure> {
        let h = self.time - start;
        let first = report.changes.len();
        for index in 0..self.pairs.len() {
            let pair = self.pairs[index];
            let radii = self.bodies[pair.a as usize].radius + self.bodies[pair.b as usize].radius;
            let Some(level) = pair.law.gradual_level(pair.phase) else { continue };
            let Some(course) = self.course_of(scratch, &pair, level, h) else { continue };
            let mut positive = course.starts_positive();
            for &theta in course.crossings().as_slice() {
                let phase = self.pairs[index].phase;
                let passed = self.pairs[index].transitions().find(|way| way.level == level);
                let rate = course.rate_at(theta) / (2.0 * h * level * radii * radii);
                if let Some(way) = passed.filter(|way| way.falling == positive) {
                    let time = start + theta * h;
                    report.changes.push(Change {
                        time,
                        pair: index,
                        q: level,
                        rate,
                        from: phase,
                        to: way.to,
                        energy: 0.0,
                    });
                    self.pairs[index].phase = way.to;
                    self.count(index, time, scratch)?;
                }
                positive = !positive;
            }
        }
        report.changes[first..].sort_by(|one, other| one.time.total_cmp(&other.time));
        Ok(())
    }

    /// The first instant of the step just tried at which a step has to end.
    pub(super) fn first_crossing(&self, scratch: &Scratch, h: f64) -> Option<Crossing> {
        let mut first: Option<Crossing> = None;
        for (index, pair) in self.pairs.iter().enumerate() {
            for (level, falling, to) in self.levels(pair) {
                let Some(polynomial) = self.course_of(scratch, pair, level, h) else { continue };
                let mut positive = polynomial.starts_positive();
                for &theta in polynomial.crossings().as_slice() {
                    if falling.is_none_or(|falling| falling == positive) {
                        if first.is_none_or(|before| theta < before.theta) {
                            first = Some(Crossing { theta, pair: index, level, to });
                        }
                        break;
                    }
                    positive = !positive;
                }
            }
        }
        first
    }

    /// Repeats the step so that it ends where the pair reaches the level. Returns this time [s], which may be the start of
    /// the step, and what is left to correct; `None` if the iteration does not converge.
    fn end_at(
        &self,
        scratch: &mut Scratch,
        next: f64,
        crossing: Crossing,
        paths: &dyn Paths,
        work: &Tally<'_>,
        report: &mut Report,
    ) -> Option<(f64, f64)> {
        let Crossing { theta, pair, level, .. } = crossing;
        const MAX_TRIES: u32 = 5;
        let (a, b) = (self.pairs[pair].a as usize, self.pairs[pair].b as usize);
        let rim = level * (self.bodies[a].radius + self.bodies[b].radius);
        let mut end = self.time + theta * (next - self.time);
        let mut left = 0.0;
        for _ in 0..MAX_TRIES {
            if end <= self.time {
                return Some((self.time, 0.0));
            }
            left = self.solve(scratch, &self.span(end), paths, work, report)?;
            let (a, b) = (scratch.places[a][3], scratch.places[b][3]);
            let apart = a.centre - b.centre;
            let distance = apart.length();
            let rate = apart.dot(a.velocity - b.velocity) / distance;
            let off = (distance - rim) / rate;
            if !((distance - rim).abs() > 0.1 * STANDING * rim && off.abs() < next - self.time && end - off != end) {
                return Some((end, left));
            }
            end -= off;
        }
        // the last correction is below what can be distinguished, or the motion is too wild for Newton's method
        left = if end > self.time { self.solve(scratch, &self.span(end), paths, work, report)? } else { left };
        Some((end.max(self.time), left))
    }

    /// Changes the phases of pairs that are beyond a threshold of their phase, or on it and moving across it.
    pub(super) fn leave_phases(
        &mut self,
        scratch: &mut Scratch,
        paths: &dyn Paths,
        report: &mut Report,
    ) -> Result<(), Failure> {
        for (i, body) in self.bodies.iter().enumerate() {
            scratch.places[i][3] = if body.is_free() {
                Place { centre: body.centre, velocity: body.velocity }
            } else {
                let driven = paths.at(i, self.time, false);
                Place { centre: driven.position, velocity: driven.velocity }
            };
        }
        for index in 0..self.pairs.len() {
            let pair = self.pairs[index];
            let (a, b) = (scratch.places[pair.a as usize][3], scratch.places[pair.b as usize][3]);
            let radii = self.bodies[pair.a as usize].radius + self.bodies[pair.b as usize].radius;
            let apart = a.centre - b.centre;
            let rate = apart.dot(a.velocity - b.velocity);
            // a body that jumps may pass two thresholds at once
            for first in [true, false] {
                let beyond = self.pairs[index].transitions().find(|way| {
                    let side = if way.falling { 1.0 } else { -1.0 };
                    let gap = side * (apart.length() - way.level * radii);
                    let standing = STANDING * way.level * radii;
                    gap < -standing || (first && gap <= standing && side * rate < 0.0)
                });
                let Some(way) = beyond else { break };
                self.change(index, way.to, scratch, report)?;
            }
        }
        Ok(())
    }

    /// Changes the phase of a pair now.
    fn change(&mut self, index: usize, to: Phase, scratch: &mut Scratch, report: &mut Report) -> Result<(), Failure> {
        let pair = self.pairs[index];
        for i in [pair.a as usize, pair.b as usize] {
            if !self.bodies[i].is_free() {
                let Place { centre, velocity } = scratch.places[i][3];
                (self.bodies[i].centre, self.bodies[i].velocity) = (centre, velocity);
            }
        }
        let (a, b) = (&self.bodies[pair.a as usize], &self.bodies[pair.b as usize]);
        let (apart, radii) = (a.centre - b.centre, a.radius + b.radius);
        let q = apart.length() / radii;
        let rate = apart.normalize_or_zero().dot(a.velocity - b.velocity) / radii;
        let jump = pair.law.strength(to, q) - pair.law.strength(pair.phase, q);
        let energy = conserved::influence(a, b, &self.field, jump);
        report.ledger.events += energy;
        report.changes.push(Change { time: self.time, pair: index, q, rate, from: pair.phase, to, energy });
        self.pairs[index].phase = to;
        self.count(index, self.time, scratch)
    }

    /// Counts a change of phase; fails if the pair chatters.
    fn count(&self, index: usize, time: f64, scratch: &mut Scratch) -> Result<(), Failure> {
        scratch.changes[index] += 1;
        let Pair { a, b, .. } = self.pairs[index];
        if scratch.changes[index] > MAX_CHANGES { Err(Failure::Chatter { a, b, time }) } else { Ok(()) }
    }
}
