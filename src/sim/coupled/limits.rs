//! Limits of work: islands that take steps of fixed length, and why a step fails.

use super::{Coupled, islands::Job, member::FixedSteps};
use crate::{
    scene::Scene,
    sim::{
        free,
        report::{Failure, Fallback, Overworked, Shortfall, StepReport, Toil},
        solver::Step,
        span::Span,
        work::{Stop, Work},
    },
};

impl Coupled {
    /// Whether an island of these bodies takes steps of fixed length.
    pub(super) fn fixed_steps_of(&self, bodies: &[u32]) -> FixedSteps {
        bodies.iter().map(|&body| self.members[body as usize].fixed).fold(FixedSteps::default(), FixedSteps::join)
    }

    /// Counts a step of fixed length of an island, and reports its error.
    pub(super) fn report_fixed(&mut self, scene: &Scene, job: &Job, span: Span, report: &mut StepReport) {
        if !job.is_fixed {
            return;
        }
        let bodies = &job.group.bodies;
        let before = self.fixed_steps_of(bodies);
        let allowed = scene.tolerance * span.length();
        let (error, body) = (job.report.error, job.report.shortest.map_or(0, |(_, body)| body as usize));
        let is_calm = error <= allowed;
        let fixed = match before.left {
            0 => before.begin(),
            left => FixedSteps { left: left - u16::from(is_calm), ..before },
        };
        bodies.iter().for_each(|&body| self.members[body as usize].fixed = fixed);
        if error > allowed && report.shortfall.is_none_or(|worst| worst.error < error) {
            report.shortfall = Some(Shortfall { body: bodies[body] as usize, error, allowed });
        }
        if !self.has_fixed {
            self.has_fixed = true;
            let substep = job.report.shortest.map_or(span.length(), |(length, _)| length);
            report.fallback = Some(Fallback {
                step: report.step,
                time: span.end,
                bodies: bodies.len(),
                body: scene.bodies[bodies[body] as usize].name.clone(),
                tolerance: scene.tolerance,
                substep,
            });
        }
    }

    /// Whether the step can continue after the search for neighbours.
    pub(super) fn check(&self, step: &Step<'_>) -> Result<(), Failure> {
        step.work.check().map_err(|stop| {
            let busiest = self.awake.iter().max_by_key(|&&body| self.members[body as usize].neighbours.len());
            let body = step.setting.scene.bodies[busiest.copied().unwrap_or_default() as usize].name.clone();
            step.failure(stop, Toil::Neighbours { body, pairs: self.near.count() })
        })
    }

    /// The failure of a step whose bodies moved farther than expected again and again.
    pub(super) fn never_ends(&self, step: &Step<'_>) -> Failure {
        let body = self.jobs.iter().find(|job| !job.is_done).map_or(0, |job| job.group.bodies[0]);
        let member = &self.members[body as usize];
        let body = step.setting.scene.bodies[body as usize].name.clone();
        let toil = Toil::Forces { body, vertices: member.body.shape.rest().len(), spheres: member.neighbours.len() };
        step.failure(Stop::Overworked, toil)
    }

    /// What an island's bodies do that takes so much work.
    pub(super) fn toil(&self, scene: &Scene, job: &Job) -> Toil {
        let bodies = &job.group.bodies;
        let demanding = job.report.shortest.and_then(|(_, body)| bodies.get(body as usize)).or(bodies.first());
        let body = demanding.copied().unwrap_or_default();
        let name = scene.bodies[body as usize].name.clone();
        let member = &self.members[body as usize];
        match bodies.len() {
            ..=1 => {
                let (vertices, spheres) = (member.body.shape.rest().len(), member.neighbours.len());
                Toil::Forces { body: name, vertices, spheres }
            }
            count => Toil::Together {
                bodies: count,
                body: name,
                pairs: job.group.pairs.len(),
                steps: job.report.steps,
                changes: job.report.changes.len(),
                tolerance: scene.tolerance,
            },
        }
    }

    pub(super) fn failure(&self, scene: &Scene, report: &StepReport, job: &Job, failure: &free::Failure) -> Failure {
        let name = |body: usize| {
            let all = job.group.bodies.iter().chain(&job.group.sources);
            all.copied().nth(body).map_or_else(String::new, |body| scene.bodies[body as usize].name.clone())
        };
        let (time, toil) = match *failure {
            free::Failure::Chatter { a, b, time } => (time, Toil::Chatter { a: name(a as usize), b: name(b as usize) }),
            free::Failure::Unresolved { body, time, step } | free::Failure::Stopped { body, time, step } => {
                let is_wrong = |(index, now): &(&u32, &free::Body)| {
                    let force = scene.bodies[**index as usize].force.as_ref();
                    force.is_some_and(|force| force.validate(time, now.centre, now.velocity).is_err())
                };
                if let Some((&index, _)) = job.group.bodies.iter().zip(&job.parts.bodies).find(is_wrong) {
                    let toil = Toil::Force { body: scene.bodies[index as usize].name.clone() };
                    return Overworked { step: report.step, time, toil }.into();
                }
                let is_inside_out = job.parts.bodies.get(body).is_some_and(free::Body::is_inside_out);
                let (body, length) = (name(body), step);
                (time, if is_inside_out { Toil::InsideOut { body } } else { Toil::Unresolved { body, length } })
            }
        };
        Overworked { step: report.step, time, toil }.into()
    }
}

/// Decides which islands take steps of fixed length because adaptive ones are too much work, and which are advanced again.
/// Returns whether there are any. An island beyond the limit of the step may have been stopped anywhere after it, so only
/// its work up to the limit decides.
pub(super) fn give_up_adaptive(jobs: &mut [Job], work: &Work) -> bool {
    let beyond = work.first_beyond(jobs.iter().map(|job| job.work));
    let (last, left) = beyond.unwrap_or((jobs.len(), 0));
    let counted = |turn: usize, job: &Job| if turn == last { job.work.min(left + 1) } else { job.work };
    let mut any = false;
    for (turn, job) in jobs.iter_mut().enumerate().take(last + 1).filter(|(_, job)| !job.is_fixed) {
        let is_unresolved = turn < last && matches!(job.failure, Some(free::Failure::Unresolved { .. }));
        let is_inside_out = || job.parts.bodies.iter().any(free::Body::is_inside_out);
        if counted(turn, job) > job.budget || (is_unresolved && !is_inside_out()) {
            (job.is_fixed, job.is_done, any) = (true, false, true);
        }
    }
    if beyond.is_some() && !any {
        let adaptive = jobs.iter_mut().enumerate().take(last + 1).filter(|(_, job)| !job.is_fixed);
        if let Some((_, job)) = adaptive.max_by_key(|(turn, job)| counted(*turn, job)) {
            (job.is_fixed, job.is_done, any) = (true, false, true);
        }
    }
    if any {
        let stopped = jobs.iter_mut().skip(last).filter(|job| job.failure.is_some() || job.work > job.budget);
        stopped.for_each(|job| job.is_done = false);
    }
    any
}
