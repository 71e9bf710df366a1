//! The near pairs of a coupled scene. How far a free body moves is known only after the step, so the neighbours of a
//! body are searched for again before it may leave its fat bounds.

use super::member::Member;
use crate::{
    model::phase::Phase,
    scene::Scene,
    sim::{
        free::Pair,
        neighbours::{Bodies, FatBounds, Listed, NearPairs, Neighbours, PairId, SKIN},
        work::{Tally, Work},
    },
};

/// All pairs of bodies that are near each other; the bodies of a pair are indices of the scene.
pub(super) type Near = NearPairs<Pair>;

/// The bodies of a search for neighbours.
pub(in crate::sim) struct Among<'a> {
    pub scene: &'a Scene,
    pub members: &'a mut [Member],
    /// The time at which it is searched [s]; pairs found later than at 0 are apart.
    pub time: f64,
}

impl Listed for Pair {
    fn bodies_and_phase(&self) -> ([u32; 2], Phase) {
        ([self.a, self.b], self.phase)
    }

    fn set_bodies_and_phase(&mut self, [a, b]: [u32; 2], phase: Phase) {
        (self.a, self.b, self.phase) = (a, b, phase);
    }
}

impl Bodies for Among<'_> {
    type Pair = Pair;

    fn scene(&self) -> &Scene {
        self.scene
    }

    fn fat_bounds(&self, body: u32) -> FatBounds {
        self.members[body as usize].fat
    }

    fn neighbours(&mut self, body: u32) -> &mut Neighbours {
        &mut self.members[body as usize].neighbours
    }

    fn meet(&mut self, a: u32, b: u32) -> Pair {
        let law = self.scene.law(a as usize, b as usize);
        let [first, second] = [a, b].map(|body| &self.members[body as usize].body);
        let phase = if self.time == 0.0 { law.thresholds.initial(first.q(second)) } else { Phase::Apart };
        Pair { a, b, phase, law, window: None }
    }
}

impl Near {
    /// The pairs of all bodies; `None` if there are more than `max`.
    pub fn of_all(mut among: Among<'_>, max: u64, work: &Work) -> Option<Near> {
        let mut near = Near::new(among.scene);
        for body in 0..among.members.len() as u32 {
            near.place_again(&mut among, body);
        }
        near.start(&mut among, max, work, &Tally::new(work, None)).then_some(near)
    }

    /// Finds the pairs of a body that has none yet; false, and nothing has changed, if there would be more than `max`.
    pub fn enter_body(&mut self, among: &mut Among<'_>, body: u32, max: u64) -> bool {
        self.place_again(among, body);
        self.join(among, body, max)
    }

    /// Finds the neighbours of a body again if it may leave its fat bounds in this step.
    pub fn update(&mut self, among: &mut Among<'_>, body: u32, work: &Tally<'_>) {
        let Member { body: own, bounds, fat, .. } = &among.members[body as usize];
        if own.centre.distance(self.placed_at(body)) + bounds.way > fat.skin || bounds.extent > fat.vertices {
            self.place_again(among, body);
            self.search(among, body, work);
        }
    }

    fn place_again(&mut self, among: &mut Among<'_>, body: u32) {
        let Member { body: own, bounds, extent, fat, .. } = &mut among.members[body as usize];
        let skin = SKIN * own.radius;
        *fat = FatBounds { vertices: bounds.extent.max(*extent) + skin, skin: skin.max(4.0 * bounds.way) };
        self.place(among.scene, body, own.centre, *fat);
    }

    /// Sets the phase of a pair.
    pub fn enter(&mut self, id: PairId, phase: Phase) {
        self.get_mut(id).phase = phase;
    }

    /// Whether, within the step, one body of a pair can have vertices inside the other's sphere, or the pair can change
    /// phase.
    pub fn is_coupled(&self, id: PairId, members: &[Member]) -> bool {
        let pair = self.get(id);
        let (a, b) = (&members[pair.a as usize], &members[pair.b as usize]);
        if pair.phase != Phase::Apart {
            return true;
        }
        let sphere = |member: &Member| member.body.sphere_radius;
        let touching = match pair.law.strength(Phase::Apart, f64::INFINITY) {
            0.0 => 0.0,
            _ => f64::max(sphere(a) + b.bounds.extent, sphere(b) + a.bounds.extent),
        };
        let near = touching.max(pair.law.thresholds.merge_at * (a.body.radius + b.body.radius));
        let (from, to) = (a.body.centre, b.body.centre);
        let rounding = 16.0 * f64::EPSILON * (from.abs().max_element() + to.abs().max_element());
        !(from.distance(to) > near + a.bounds.way + b.bounds.way + rounding)
    }
}
