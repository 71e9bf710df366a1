//! Which bodies are awake.

use super::{
    Coupled,
    islands::{Group, Job},
    member::{FixedSteps, Member},
};
use crate::{
    scene::{Point, Scene},
    sim::{
        numerics::control::MAX_SLOW_TOLERANCE,
        report::StepReport,
        solver::{Setting, Step},
        span::Span,
        work::Tally,
    },
};
use glam::DVec3;

/// Number of steps between checks of whether an isolated body turns like a rigid one.
const RIGID_SPIN_EVERY: u64 = 16;

impl Coupled {
    /// Wakes the bodies on which pushes act during the step.
    pub(super) fn wake_pushed(&mut self, step: &Step<'_>) {
        for body in step.pushed_before(step.span.end) {
            if !self.members[body as usize].is_awake {
                self.wake(body);
            }
        }
        self.awake.sort_unstable();
    }

    /// Wakes the bodies near which a force point moves, or begins or ceases to act, during the step.
    pub(super) fn wake_near_points(&mut self, step: &Step<'_>) {
        let (Setting { scene, .. }, span) = (step.setting, step.span);
        let changes = |point: &Point| {
            let is_switched = [point.start, point.end()].iter().any(|t| (span.start..=span.end).contains(t));
            is_switched || !point.path.is_still(span.start, span.end)
        };
        if !scene.points.iter().any(changes) {
            return;
        }
        let tally = Tally::new(step.work, None);
        for body in 0..self.members.len() as u32 {
            if !tally.spend(scene.points.len() as u64) {
                break;
            }
            let is_awake = self.members[body as usize].is_awake;
            if !is_awake && self.points_near(scene, span, body as usize).any(|(_, point)| changes(point)) {
                self.wake(body);
            }
        }
        self.awake.sort_unstable();
    }

    /// The force points that may act on vertices of a body during `span` and its ends.
    pub(super) fn points_near<'a>(
        &'a self,
        scene: &'a Scene,
        span: Span,
        body: usize,
    ) -> impl Iterator<Item = (u32, &'a Point)> + 'a {
        let Member { body: own, bounds, extent, .. } = &self.members[body];
        let vertices = f64::max(*extent, bounds.extent) + bounds.way;
        scene.points_on(body).filter(move |(_, point)| {
            let (centre, radius) = point.path.ball(span.start, span.end);
            let reach = scene.influence.sphere_radius(point.radius) + radius + vertices;
            let is_near = centre.distance(own.centre) <= reach * (1.0 + 1e-9) + 1e-9 * centre.length();
            is_near && point.start <= span.end && span.start <= point.end()
        })
    }

    pub(super) fn wake(&mut self, body: u32) {
        let member = &mut self.members[body as usize];
        self.sleeping_hash = self.sleeping_hash.wrapping_sub(member.sleeping_hash);
        (member.is_awake, member.slow_steps) = (true, 0);
        self.awake.push(body);
    }

    /// Wakes a body between two steps.
    pub fn wake_up(&mut self, body: usize) {
        if !self.members[body].is_awake {
            self.wake(body as u32);
            self.awake.sort_unstable();
        }
    }

    /// Puts slow islands to rest, and clears the deformation of bodies on which nothing acts any more.
    pub(super) fn sleep(&mut self, scene: &Scene, span: Span, jobs: &[Job], report: &mut StepReport) {
        for job in jobs {
            let Group { bodies, sources, pairs } = &job.group;
            let tolerance = |member: &Member| match member.fixed.left {
                0 => scene.tolerance,
                _ => MAX_SLOW_TOLERANCE,
            };
            let is_still = |body: &u32| {
                let path = scene.bodies[*body as usize].path();
                path.is_none_or(|path| path.is_still(span.end, f64::INFINITY))
            };
            let is_slow = |body: &u32| {
                let member = &self.members[*body as usize];
                let is_pushed = member.pushes.iter().any(|push| push.start <= span.end && push.end() > span.end);
                let mut points = self.points_near(scene, span, *body as usize);
                let is_driven = is_pushed
                    || scene.bodies[*body as usize].force.is_some()
                    || points.any(|(_, point)| !point.path.is_still(span.end, f64::INFINITY));
                !is_driven && is_still(body) && member.is_slow(tolerance(member))
            };
            if sources.iter().all(is_still) && bodies.iter().all(is_slow) {
                let mut may_sleep = true;
                for &body in bodies {
                    let member = &mut self.members[body as usize];
                    may_sleep &= member.stays_slow(tolerance(member), span.length());
                }
                if may_sleep {
                    for &body in bodies {
                        report.ledger.rest -= self.members[body as usize].stop();
                        self.put_to_sleep(body);
                    }
                }
            } else {
                bodies.iter().for_each(|&body| self.members[body as usize].slow_steps = 0);
            }
            if let (&[body], []) = (&bodies[..], &pairs[..]) {
                let member = &mut self.members[body as usize];
                let is_turning = member.body.turns() && member.body.spin != DVec3::ZERO;
                if member.touches(&scene.planes) {
                    continue;
                }
                if is_turning {
                    if report.step.is_multiple_of(RIGID_SPIN_EVERY) {
                        member.rigid_spin = member.find_rigid_spin(scene.tolerance);
                    }
                } else if member.is_nearly_undeformed(scene.tolerance) {
                    report.error += member.clear_deformation();
                    if !member.is_awake {
                        self.put_to_sleep(body); // with the hash of this state
                    }
                }
            }
        }
    }

    /// Puts a body to rest.
    pub(super) fn put_to_sleep(&mut self, body: u32) {
        let member = &mut self.members[body as usize];
        let before = if member.is_awake { 0 } else { member.sleeping_hash };
        (member.is_awake, member.fixed) = (false, FixedSteps::default());
        member.sleeping_hash = member.hash(body);
        self.sleeping_hash = self.sleeping_hash.wrapping_add(member.sleeping_hash).wrapping_sub(before);
    }
}
