//! An island: coupled bodies, advanced together with adaptive steps that end where a pair changes phase.

use glam::DVec3;
use pulp::Arch;

use super::{
    super::work::Tally,
    body::Body,
    conserved,
    field::{Field, Pair, Paths},
    force::Acting,
    ledger::{Done, Ledger},
    phases::Crossing,
    split::Motion,
    step::{Course, Place, Span},
    verlet,
};
use crate::{
    model::phase::Phase,
    sim::numerics::{
        control::{GROWTH, MAX_ANGLE, MAX_GROWTH, ORDER, RESOLVED, ROUNDING, SAFETY, STANDING},
        larger,
    },
};

/// Largest number of attempts in one advance of an island that fail, are too inaccurate, or take no time.
const MAX_STEPS: u64 = 20_000;
/// Largest number of phase changes of one pair in one advance of an island.
pub(super) const MAX_CHANGES: u32 = 200;

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

/// Results and statistics, accumulated while an island is advanced.
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
    /// Largest number of contacts of vertices with planes in a sweep; not counted where bodies take their own steps.
    pub held: u64,
    /// Sum over the steps of the largest estimated error [radii], times `GROWTH`.
    pub error: f64,
    /// Energy added to the bodies, by cause.
    pub ledger: Ledger,
}

/// Why an island cannot be advanced any further.
#[derive(Clone, Debug, PartialEq)]
pub enum Failure {
    /// A pair chatters: it changes its phase over and over.
    Chatter {
        /// Index of the pair's first body.
        a: u32,
        /// Index of the pair's second body.
        b: u32,
        /// Time of the failure [s].
        time: f64,
    },
    /// The step size underflows: the tolerance would require ever shorter steps.
    Unresolved {
        /// Index of the body.
        body: usize,
        /// Time of the failure [s].
        time: f64,
        /// Length of the last step tried [s].
        step: f64,
    },
    /// The limit of work is reached, or the run is interrupted.
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
}

/// An advance of an island to a time.
pub(in crate::sim) struct Advance {
    end: f64,
    /// Steps below this length are not tried [s].
    shortest: f64,
    /// Nor are longer ones [s]: their polynomials would not follow the paths.
    longest: f64,
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
    pub(super) acting: Vec<Acting>,
    pub(super) places: Vec<[Place; 5]>,
    pub(super) motions: Vec<Motion>,
    /// The reaction on each body's sphere at a sample.
    pub(super) reactions: Vec<DVec3>,
    /// The pairs that each body belongs to.
    pub(super) pairs_of: Vec<Vec<u32>>,
    pub(super) changes: Vec<u32>,
    pub(in crate::sim) arch: Arch,
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
    pub(super) fn find_motions(&mut self, span: &Span) -> bool {
        let Scratch { courses, places, motions, .. } = self;
        motions.clear();
        let any = courses.iter().any(|course| !course.splits.is_empty());
        if any {
            motions.extend(courses.iter().zip(places).map(|(course, places)| course.motion(span, places)));
        }
        any
    }
}

/// The ratio of the step length that is expected to meet the tolerance to one with this error, over tolerance.
fn growth(error: f64) -> f64 {
    SAFETY * libm::pow(error.max(f64::MIN_POSITIVE), -1.0 / f64::from(ORDER))
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
    pub body: usize,
    /// Estimated error [radii].
    pub estimate: f64,
}

impl Island {
    /// An island at `time` [s], from existing lists, whose error stays within `tolerance` [radii/s]. Pairs start in their
    /// given phases. Bodies on prescribed paths must be where their paths are.
    pub(in crate::sim) fn resume(parts: Parts, tolerance: f64, time: f64) -> Island {
        let Parts { bodies, pairs, field, mut ways, mut step_lengths } = parts;
        step_lengths.resize(bodies.len(), f64::INFINITY);
        let step_length = step_lengths.iter().copied().fold(f64::INFINITY, f64::min);
        let way = |body: &Body| Way { from: body.centre, extent: body.shape.extent, ..Way::default() };
        ways.clear();
        ways.extend(bodies.iter().map(way));
        Island { bodies, pairs, field, tolerance, time, step_length, step_lengths, ways }
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

    /// The place of a body at `t` [s]: now if it is free, with `before` the left limit if its path jumps there.
    pub(super) fn place(&self, body: usize, t: f64, before: bool, paths: &dyn Paths) -> Place {
        let known = &self.bodies[body];
        if known.is_free() { known.place() } else { paths.at(body, t, before).place }
    }

    /// The bodies.
    pub fn bodies(&self) -> &[Body] {
        &self.bodies
    }

    /// The pairs.
    pub fn pairs(&self) -> &[Pair] {
        &self.pairs
    }

    /// Current time [s].
    pub fn time(&self) -> f64 {
        self.time
    }

    /// Advances the island to `end` [s], with buffers of the caller and within the limit of `work`. Calls `see` with the island
    /// at the start and after each step of the solver.
    ///
    /// # Errors
    /// If a pair chatters, or the tolerance would require steps that are too short. The state is then that at the last
    /// instant reached.
    pub(in crate::sim) fn advance_with(
        &mut self,
        scratch: &mut Scratch,
        end: f64,
        paths: &dyn Paths,
        work: &Tally<'_>,
        report: &mut Report,
        see: &mut dyn FnMut(&Island),
    ) -> Result<(), Failure> {
        let mut advance = self.begin(scratch, end, paths);
        see(self);
        while self.time < end {
            self.substep(scratch, &mut advance, paths, work, report)?;
            see(self);
        }
        self.step_lengths.fill(self.step_length);
        self.finish(scratch, paths, report)
    }

    /// Prepares to advance the island to `end` [s] in [substeps](Self::substep).
    pub(in crate::sim) fn begin(&self, scratch: &mut Scratch, end: f64, paths: &dyn Paths) -> Advance {
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
        for ((body, course), pairs) in self.bodies.iter().zip(&mut scratch.courses).zip(&scratch.pairs_of) {
            let near = pairs.iter().map(|&pair| &self.pairs[pair as usize]).filter(|pair| pair.window.is_none());
            let radii = near.flat_map(|pair| [pair.a, pair.b]).map(|near| self.bodies[near as usize].radius);
            course.smallest_radius = radii.fold(body.radius, f64::min);
        }
        let on_paths = (0..self.bodies.len()).filter(|&body| !self.bodies[body].is_free());
        let fastest = on_paths.map(|body| paths.turning_rate(body)).fold(0.0, f64::max);
        let shortest = (end - self.time) * STANDING;
        Advance { end, shortest, longest: f64::max(MAX_ANGLE / fastest, shortest), tried: 0 }
    }

    /// The longest step whose samples resolve what damping takes from vertices that move now [s], for the ledger.
    fn longest_damped(&self) -> f64 {
        let damped = self.bodies[..self.stepped()].iter().filter(|body| body.is_free() && body.is_losing_energy());
        let rates = damped.map(|body| body.oscillator.omega + 2.0 * body.oscillator.damping);
        RESOLVED / rates.fold(0.0, f64::max)
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
        // an instant at which something jumps and the end of a step are the same if only rounding is between them
        if left < advance.shortest.max(ROUNDING * stop.abs()) {
            self.time = stop;
            return Ok(());
        }
        let longest = advance.longest.min(self.longest_damped()).max(advance.shortest);
        let parts = (left / self.step_length.min(longest)).ceil().max(1.0);
        let mut next = if parts > 1.0 { self.time + left / parts } else { stop };
        let attempt = loop {
            let attempt = self.attempt(scratch, next, paths, work, report);
            if work.is_over() {
                return Err(self.stopped());
            }
            let is_accurate = |attempt: &Attempt| attempt.outcome.error <= 1.0;
            if let Some(attempt) = attempt.filter(|attempt| is_accurate(attempt) && attempt.end > self.time) {
                break attempt;
            }
            advance.tried += 1;
            let (h, factor) = match attempt {
                // a change that takes no time
                Some(attempt) if is_accurate(&attempt) && advance.tried < MAX_STEPS => break attempt,
                Some(Attempt { end, outcome, .. }) => {
                    (end - self.time, growth(outcome.error).clamp(1.0 / MAX_GROWTH, SAFETY))
                }
                None => (next - self.time, 1.0 / MAX_GROWTH),
            };
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
            let factor = growth(outcome.error);
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
            let to = paths.at(index, self.time, false).place.centre;
            let from = std::mem::replace(&mut body.centre, to);
            if from == to {
                continue;
            }
            // change of the energy of the influence between it and free bodies
            let own = index as u32;
            for pair in self.pairs.iter().filter(|pair| pair.a == own || pair.b == own) {
                let (a, b) = (&self.bodies[pair.a as usize], &self.bodies[pair.b as usize]);
                let energy =
                    |a: &Body, b: &Body| conserved::influence(a, b, &self.field, pair.law.strength(pair.phase, a.q(b)));
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
}
