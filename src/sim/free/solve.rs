//! The equations of a step of an island, their solution, and its error.

use std::sync::atomic::AtomicU64;

use glam::DVec3;
use rayon::prelude::*;
use smallvec::SmallVec;

use super::{
    super::work::Tally,
    body::Body,
    field::{Driven, Paths},
    force::{Acting, View},
    island::{Island, Outcome, Report, Scratch},
    split::{Around, By, MAX_LOAD, Piece},
    step::{Course, MIDDLE, Place, Span},
};
use crate::sim::numerics::{
    control::{MAX_ANGLE, MAX_SWEEPS, NEGLIGIBLE, NEGLIGIBLE_TOLERANCE},
    larger,
    nodes::MIDPOINTS,
};

/// With fewer vertices than this, a second thread does not pay off.
const PARALLEL_VERTICES: usize = 4096;
/// Work of the force of a plane on a vertex, a solution of nine equations in two parts [units].
const HOLD: u64 = 200;
/// Work of finding whether a push begins or ends to act on a vertex [units].
const PUSH: u64 = 8;
/// Work of a sweep for each part of a step of a vertex that is advanced alone [units].
const LEG: u64 = 200;

/// Corrections of a body below this size count as converged, in a step of length `h` [s] [scene unit].
pub(super) fn small_correction(tolerance: f64, radius: f64, h: f64) -> f64 {
    NEGLIGIBLE * tolerance.min(NEGLIGIBLE_TOLERANCE) * radius * h
}

impl Island {
    /// Solves the equations of a step. Returns what is left to correct, over what counts as converged; `None` if the
    /// iteration does not converge or the limit of work is reached.
    pub(super) fn solve(
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
    pub(super) fn span(&self, next: f64) -> Span {
        let free = self.bodies.iter().filter(|body| body.is_free());
        let (sum, count) = free.fold((DVec3::ZERO, 0.0), |(sum, n), body| (sum + body.centre, n + 1.0));
        Span::new(self.time, next, sum / f64::max(count, 1.0))
    }

    /// Begins a step, and finds the vertices that something may reach in it, for bands `wide` times the expected ones.
    /// Returns their number.
    pub(super) fn select(&self, scratch: &mut Scratch, span: &Span, wide: f64, paths: &dyn Paths) -> usize {
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
    pub(super) fn converge(
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
        let wanted = |course: &Course| small_correction(self.tolerance, course.smallest_radius, span.h);
        // Vertices lag the rotation of their frame by a sweep, through damping and inertia: what is left of a correction
        // is no less than that, whatever the last two sweeps look like.
        let turning = self.bodies.iter().zip(&scratch.courses).filter(|(body, _)| body.turns());
        let slowest = turning.map(|(body, course)| body.oscillator.damping + course.frames[3].spin.length());
        let slowest = span.h * slowest.fold(0.0, f64::max);
        let mut before = f64::INFINITY;
        for sweep in 0..MAX_SWEEPS {
            if !work.spend(sweep_work) {
                return None;
            }
            if !self.evaluate(scratch, span, sweep == 0, paths, parallel) {
                return None;
            }
            let held = scratch.courses.iter().map(|course| course.held.len() as u64).sum();
            report.held = report.held.max(held);
            work.spend(HOLD * held);
            let bodies = scratch.courses.iter().zip(&scratch.acting);
            let pushes: usize = bodies.map(|(course, acting)| acting.pushes.len() * course.active.len()).sum();
            work.spend(PUSH * pushes as u64);
            let legs = scratch.courses.iter().flat_map(|course| &course.splits).map(|split| split.legs().len() as u64);
            work.spend(LEG * legs.sum::<u64>());
            // largest correction over the wanted size
            let correct_one = |((body, course), places): ((&Body, &mut Course), &mut [Place; 5]),
                               samples: std::ops::Range<usize>| {
                let rounding = 4e-15 * (places[0].centre.length() + body.shape.extent) * f64::max(1.0, 1.0 / span.h);
                let wanted = f64::max(wanted(course), rounding);
                course.correct(arch, body, span, samples, places) / wanted
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
            let rate = if sweep > 0 { larger(change / before, slowest) } else { 1.0 };
            // the remaining corrections are the rest of a geometric series
            let left = if rate < 1.0 { change * rate / (1.0 - rate) } else { change };
            if sweep > 0 && left <= 1.0 {
                return Some(left);
            }
            if sweep > 0 {
                change = larger(change, correct(1..3));
            }
            before = change;
        }
        None
    }

    /// Evaluates the forces on all bodies at the nodes, for their currently estimated positions. False if too much begins and
    /// ends within the step.
    pub(super) fn evaluate(
        &self,
        scratch: &mut Scratch,
        span: &Span,
        is_first: bool,
        paths: &dyn Paths,
        parallel: bool,
    ) -> bool {
        let (arch, load) = (scratch.arch, AtomicU64::new(0));
        let Scratch { courses, acting, places, pairs_of, .. } = &mut *scratch;
        let view =
            |i: usize, first| View { body: &self.bodies[i], field: &self.field, span, places: &places[i], first, arch };
        let find = |(i, (course, acting)): (usize, (&mut Course, &mut Acting))| {
            let pairs = pairs_of[i].iter().map(|&pair| &self.pairs[pair as usize]);
            acting.find(i, &self.bodies, pairs, &self.field, span, places);
            acting.find_splits(&view(i, 0), course, &load)
        };
        let any_changed = if parallel {
            let all = courses.par_iter_mut().zip(acting.par_iter_mut()).enumerate();
            all.map(find).reduce(|| false, |a, b| a | b)
        } else {
            courses.iter_mut().zip(acting.iter_mut()).enumerate().map(find).fold(false, |a, b| a | b)
        };
        if load.into_inner() > MAX_LOAD {
            return false;
        }
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
        true
    }

    /// Advances the vertices on which contacts begin or cease to act.
    pub(super) fn solve_splits(
        &self,
        scratch: &mut Scratch,
        span: &Span,
        is_first: bool,
        paths: &dyn Paths,
        parallel: bool,
    ) {
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
    pub(super) fn evaluate_at(&self, scratch: &mut Scratch, span: &Span, sample: usize) {
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
    pub(super) fn drive(&self, scratch: &mut Scratch, span: &Span, sample: usize) {
        let Scratch { courses, places, reactions, .. } = scratch;
        reactions.clear();
        reactions.resize(self.bodies.len(), DVec3::ZERO);
        for reaction in courses.iter().flat_map(|course| &course.reactions) {
            reactions[reaction.source as usize] += reaction.force[sample];
        }
        for (i, (body, course)) in self.bodies.iter().zip(courses).enumerate() {
            let Place { centre, velocity } = places[i][sample];
            let given = self.field.given(i, span.time(sample), centre, velocity);
            course.drive(body, sample, self.field.free_fall() + given, reactions[i], &places[i][sample], span);
        }
    }

    /// Estimates the error of a step from its residuals at the midpoints and from what is left to correct.
    pub(super) fn estimate_error(&self, scratch: &mut Scratch, span: &Span, paths: &dyn Paths, left: f64) -> Outcome {
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
                    None => places[i][MIDDLE] = paths.at(i, span.time(MIDDLE), false).place,
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
                    let mut owners: SmallVec<[(u32, [f64; 2]); 8]> = SmallVec::new();
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
            let found = course.error(arch, body, &self.field) / course.smallest_radius;
            let estimate = found + left * small_correction(self.tolerance, 1.0, span.h);
            let turned = course.frames[3].turned.length();
            // Rounding of position and velocity adds as much to the estimate of a shorter step.
            let rounded = body.centre.length() + body.shape.extent + body.velocity.length();
            let rounding = 2.0 * f64::EPSILON * rounded / course.smallest_radius;
            let error = estimate / (self.tolerance * span.h + rounding);
            let error = if turned > MAX_ANGLE { error.max(2.0) } else { error };
            if !(error <= worst.error) {
                worst = Outcome { error, body: i, estimate };
            }
        }
        worst
    }
}
