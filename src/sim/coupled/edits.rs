//! Changes between steps: the state of another scene, new bodies, pushes.

use super::{
    Coupled,
    member::Member,
    near::{Among, Near},
};
use crate::{
    model::phase::Phase,
    scene::{self, Scene},
    sim::{
        events::Event,
        free::{self, Field, Pair, Snapshot},
        neighbours::{Neighbour, PairId},
        report::StepReport,
        solver::Takeover,
        span::Span,
        terms::free_fall,
        work::Work,
    },
};

impl Coupled {
    /// Takes over the state of another scene, and adds the phase changes and the energy that this causes to the report.
    /// False if there are too many pairs.
    pub fn resume(
        &mut self,
        scene: &Scene,
        before: &Coupled,
        takeover: &Takeover<'_>,
        report: &mut StepReport,
    ) -> bool {
        let time = takeover.time;
        let span = Span { start: time, end: time + scene.dt };
        (self.ledger, self.first_energy) = (before.ledger, before.first_energy);
        self.has_fixed = before.has_fixed;
        self.move_points(scene, time);
        for ((member, before), body) in self.members.iter_mut().zip(&before.members).zip(&scene.bodies) {
            member.resume(before);
            if !member.is_awake {
                (member.is_awake, member.slow_steps) = (true, 0);
            }
            member.bound_motion(body, free_fall(scene), span);
        }
        let among = Among { scene, members: &mut self.members, time };
        let Some(near) = Near::of_all(among, takeover.max_pairs, &Work::limited(u64::MAX, None)) else { return false };
        self.near = near;
        // pairs that were not listed were apart
        self.near.all_mut().iter_mut().for_each(|pair| pair.phase = Phase::Apart);
        let mut among = Among { scene, members: &mut self.members, time };
        for pair in before.pairs().filter(|pair| pair.phase != Phase::Apart) {
            let index = self.near.list(&mut among, pair.a, pair.b);
            self.near.enter(index, pair.phase);
        }
        let brought = self.energy(scene, time) - before.energy(takeover.scene, time);
        self.ledger.edits += brought;
        report.ledger.edits += brought;
        let known: Vec<PairId> = self.pair_ids().collect();
        self.enter_phases(scene, time, &known, report);
        true
    }

    /// Adds the last body of the scene at `time` [s], with the phase changes and the energy that this causes. False, and
    /// nothing has changed, if there would be more than `max_pairs` pairs.
    pub fn add_last(&mut self, scene: &Scene, time: f64, max_pairs: u64, report: &mut StepReport) -> bool {
        let last = self.members.len();
        let member = self.awakened(scene, last, time);
        self.members.push(member);
        if !self.near.enter_body(&mut Among { scene, members: &mut self.members, time }, last as u32, max_pairs) {
            self.members.pop();
            self.shapes.forget_unused();
            return false;
        }
        self.awake.push(last as u32);
        self.job_of.push(0);
        self.forget_results();
        self.begin(scene, last, 0.0, time, report);
        true
    }

    /// Removes a body of the scene, which has it still, at `time` [s], with the energy that this takes. All others wake.
    pub fn remove(&mut self, scene: &Scene, body: usize, time: f64, report: &mut StepReport) {
        let energy = self.energy_of(scene, time, body);
        self.bring(-energy, time, report);
        self.near.remove(&mut Among { scene, members: &mut self.members, time }, body as u32);
        self.members.remove(body);
        let pushes = self.members[body..].iter_mut().flat_map(|member| &mut member.pushes);
        pushes.for_each(|push| push.body -= 1);
        self.shapes.forget_unused();
        self.job_of.pop();
        self.forget_results();
        for member in self.members.iter_mut().filter(|member| !member.is_awake) {
            (member.is_awake, member.slow_steps) = (true, 0);
        }
        self.sleeping_hash = 0;
        self.awake.clear();
        self.awake.extend(0..self.members.len() as u32);
    }

    /// Gives a body the motion that the scene has for it now, at `time` [s]; it had `energy` before, with its pairs. It
    /// becomes undeformed, and the bodies near it wake.
    pub fn restart(&mut self, scene: &Scene, body: usize, energy: f64, time: f64, report: &mut StepReport) {
        let near: Vec<u32> = self.members[body].neighbours.iter().map(|neighbour| neighbour.other).collect();
        near.into_iter().chain([body as u32]).for_each(|one| self.wake_up(one as usize));
        self.near.isolate(&mut Among { scene, members: &mut self.members, time }, body as u32);
        self.members[body] = self.awakened(scene, body, time);
        self.near.enter_body(&mut Among { scene, members: &mut self.members, time }, body as u32, u64::MAX);
        self.forget_results();
        self.begin(scene, body, energy, time, report);
    }

    /// A body of the scene that starts at `time` [s].
    fn awakened(&mut self, scene: &Scene, body: usize, time: f64) -> Member {
        let mut member = Member::new(scene, body, &mut self.shapes, time);
        member.bound_motion(&scene.bodies[body], free_fall(scene), Span { start: time, end: time + scene.dt });
        member
    }

    /// Drops the results of the last step, which name bodies and force points by their numbers.
    fn forget_results(&mut self) {
        self.before.clear();
        self.jobs.clear();
    }

    /// Adds the phase changes and the energy caused by a body that starts at `time` [s]; its energy before was `energy`.
    fn begin(&mut self, scene: &Scene, body: usize, energy: f64, time: f64, report: &mut StepReport) {
        let brought = self.energy_of(scene, time, body) - energy;
        self.bring(brought, time, report);
        if time > 0.0 {
            let pairs: Vec<PairId> = self.members[body].neighbours.iter().map(|neighbour| neighbour.pair).collect();
            self.enter_phases(scene, time, &pairs, report);
        }
    }

    /// Adds the energy that an edit causes at `time` [s].
    fn bring(&mut self, energy: f64, time: f64, report: &mut StepReport) {
        if time > 0.0 {
            self.ledger.edits += energy;
            report.ledger.edits += energy;
        } else {
            self.first_energy += energy;
        }
    }

    /// Energy of a body at `time` [s], and of its pairs.
    pub fn energy_of(&self, scene: &Scene, time: f64, body: usize) -> f64 {
        let Member { body: own, neighbours, .. } = &self.members[body];
        let field = self.field(scene, time);
        let pairs = neighbours.iter().map(|&Neighbour { other, pair, .. }| {
            let free::Pair { law, phase, .. } = self.near.get(pair);
            let other = &self.members[other as usize].body;
            free::influence_energy(own, other, &field, law.strength(*phase, own.q(other)))
        });
        let pairs: f64 = pairs.sum();
        let alone = Field { pushes: Vec::new(), forces: Vec::new(), first_point: 1, ..field };
        let here = Span { start: time, end: time };
        let with_points = self
            .points_near(scene, here, body)
            .map(|(source, point)| Pair::with_point(0, 1 + source - scene.bodies.len() as u32, point, time));
        let bodies = std::iter::once(own).chain(&self.points).collect();
        pairs + Snapshot::new(bodies, with_points.collect(), alone, time).conserved().energy()
    }

    /// Adds a push, which the scene has already.
    pub fn push(&mut self, push: &scene::Push) {
        self.members[push.body].add_push(push);
    }

    /// The energy of the free bodies at `time` [s].
    pub(super) fn energy(&self, scene: &Scene, time: f64) -> f64 {
        self.snapshot(scene, time).conserved().energy()
    }

    /// Changes the phases of pairs that a threshold has passed.
    pub(super) fn enter_phases(&mut self, scene: &Scene, time: f64, pairs: &[PairId], report: &mut StepReport) {
        let field = self.field(scene, time);
        for &index in pairs {
            let free::Pair { a, b, law, phase, .. } = *self.near.get(index);
            let [first, second] = [a, b].map(|body| &self.members[body as usize].body);
            let (q, rate) = first.q_and_rate(second);
            let mut from = phase;
            while let Some(to) = law.thresholds.next(from, q) {
                let jump = law.strength(to, q) - law.strength(from, q);
                let energy = free::influence_energy(first, second, &field, jump);
                report.ledger.events += energy;
                self.ledger.events += energy;
                report.events.push(Event { time, step: report.step, a, b, q, rate, from, to, energy });
                from = to;
            }
            self.near.enter(index, from);
        }
    }
}
