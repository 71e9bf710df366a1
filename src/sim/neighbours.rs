//! Which bodies are near each other, for both solvers.
//!
//! A body's fat bounds contain everything that it can touch and every point at which it can be touched, until its
//! centre or its vertices have moved by more than their margin. All pairs that can touch within their fat bounds are
//! listed, and all pairs that are not apart. (In molecular dynamics: Verlet lists with a skin.)

use std::sync::atomic::{AtomicU64, Ordering};

use glam::DVec3;
use rayon::prelude::*;
use smallvec::SmallVec;

use super::{
    checksum,
    reach::{Ball, Grid},
    terms::spheres,
    work::{NEAR_ENOUGH, NEW_PAIR, Tally, Work},
};
use crate::{model::phase::Phase, scene::Scene};

/// How far a body may move before its neighbours are searched for again [radii].
pub(super) const SKIN: f64 = 0.25;
/// Up to this many pairs are listed without counting them first.
const FEW_PAIRS: u64 = 1 << 16;

/// The nearby bodies of one, ascending. Up to three are stored inline: a separate allocation costs large scenes a cache miss.
pub(super) type Neighbours = SmallVec<[Neighbour; 3]>;

/// A pair in the list of near pairs; force points have none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct PairId(u32);

/// A nearby body, or a force point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Neighbour {
    /// Index of the other body; force points follow the bodies.
    pub other: u32,
    /// The pair of the two; [`Neighbour::POINT`] for a force point.
    pub pair: PairId,
    /// Index of the pair's law in the scene.
    pub law: u32,
    /// A bound on the acceleration of any vertex of this body by the other's sphere, in any phase [scene unit/s²].
    pub pull: f64,
    /// Whether the other's sphere acts on this body in every phase of the pair.
    pub always_acts: bool,
}

impl Neighbour {
    /// In place of a pair, for a force point.
    pub const POINT: PairId = PairId(u32::MAX);

    /// Whether it is a force point.
    pub fn is_point(&self) -> bool {
        self.pair == Neighbour::POINT
    }
}

/// The limits within which a body's neighbours are complete.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct FatBounds {
    /// Largest allowed distance of a vertex from the centre [scene unit].
    pub vertices: f64,
    /// Largest allowed distance of the centre from where it was when the neighbours were found [scene unit].
    pub skin: f64,
}

/// The pairs of all bodies with these neighbours, in ascending order of their bodies.
pub(super) fn later_neighbours<'a>(of: impl Iterator<Item = &'a Neighbours>) -> impl Iterator<Item = PairId> {
    (0..).zip(of).flat_map(|(index, neighbours)| {
        let later = neighbours.iter().filter(move |neighbour| neighbour.other > index);
        later.map(|neighbour| neighbour.pair)
    })
}

/// A listed pair, as the solver knows it.
pub(super) trait Listed {
    /// Its bodies, ascending, and its phase.
    fn bodies_and_phase(&self) -> ([u32; 2], Phase);

    /// Gives its bodies other indices, and sets its phase.
    fn set_bodies_and_phase(&mut self, bodies: [u32; 2], phase: Phase);
}

/// The bodies of a solver, as the search for neighbours sees them.
pub(super) trait Bodies {
    /// What the solver knows of a pair.
    type Pair: Listed;

    /// The scene.
    fn scene(&self) -> &Scene;

    /// The fat bounds of a body.
    fn fat_bounds(&self, body: u32) -> FatBounds;

    /// The neighbours of a body.
    fn neighbours(&mut self, body: u32) -> &mut Neighbours;

    /// A pair that comes near each other, of bodies in ascending order.
    fn meet(&mut self, a: u32, b: u32) -> Self::Pair;
}

/// All pairs of bodies that are near each other.
#[derive(Clone)]
pub(super) struct NearPairs<P> {
    pairs: Vec<P>,
    /// Unused places in `pairs`.
    unused: Vec<PairId>,
    grid: Grid,
    /// The largest q at which a pair can merge [–].
    max_merge_at: f64,
    /// Buffers, reused.
    found: Vec<u32>,
    known: Neighbours,
}

impl<P: Listed> NearPairs<P> {
    /// No pairs yet.
    pub fn new(scene: &Scene) -> NearPairs<P> {
        NearPairs {
            pairs: Vec::new(),
            unused: Vec::new(),
            grid: Grid::default(),
            max_merge_at: scene.laws().map(|law| law.thresholds.merge_at).fold(0.0, f64::max),
            found: Vec::new(),
            known: Neighbours::new(),
        }
    }

    /// Finds the pairs of all bodies, which have been [placed](NearPairs::place); false if there are more than `max`.
    /// Pairs are counted before they are stored. When interrupted, keeps those found until then.
    pub fn start<B: Bodies<Pair = P>>(&mut self, bodies: &mut B, max: u64, work: &Work, tally: &Tally<'_>) -> bool {
        let all: Vec<FatBounds> = (0..bodies.scene().bodies.len() as u32).map(|body| bodies.fat_bounds(body)).collect();
        let Some(count) = self.count_near(bodies.scene(), &all, max, work) else { return work.is_interrupted() };
        self.pairs.reserve_exact(count as usize);
        for body in 0..all.len() as u32 {
            self.search(bodies, body, tally);
        }
        self.pairs.shrink_to_fit();
        (0..all.len() as u32).for_each(|body| bodies.neighbours(body).shrink_to_fit());
        true
    }

    /// Number of pairs of bodies that are near each other; `None` if more than `max`.
    fn count_near(&self, scene: &Scene, all: &[FatBounds], max: u64, work: &Work) -> Option<u64> {
        let n = all.len() as u64;
        if n * n.saturating_sub(1) / 2 <= max.min(FEW_PAIRS) {
            return Some(0); // too few to be worth counting
        }
        let (grid, sum) = (&self.grid, AtomicU64::new(0));
        let counted = (0..n as u32).into_par_iter().try_for_each(|i| {
            let mut near = 0;
            let are_near = |j: u32| are_near(scene, grid, [i, j], [all[i as usize], all[j as usize]]);
            grid.each_touching(i, |j| near += u64::from(j > i && are_near(j)));
            let sum = sum.fetch_add(near, Ordering::Relaxed) + near;
            (sum <= max && !work.is_interrupted()).then_some(())
        });
        counted.map(|()| sum.into_inner())
    }

    /// Gives a body fat bounds about `centre`.
    pub fn place(&mut self, scene: &Scene, body: u32, centre: DVec3, bounds: FatBounds) {
        let of = &scene.bodies[body as usize];
        let reach = of.sphere_radius().max(bounds.vertices).max(self.max_merge_at * of.radius) + bounds.skin;
        // so that a pair exactly on a threshold is not lost to rounding of the centres
        let rounding = 16.0 * f64::EPSILON * (centre.abs().max_element() + reach);
        self.grid.place(body, Ball { centre, radius: reach + rounding });
    }

    /// Removes a body from all lists of neighbours, and empties its own.
    pub fn isolate<B: Bodies<Pair = P>>(&mut self, bodies: &mut B, body: u32) {
        for Neighbour { other, pair, .. } in std::mem::take(bodies.neighbours(body)) {
            let others = bodies.neighbours(other);
            if let Ok(index) = others.binary_search_by_key(&body, |other| other.other) {
                others.remove(index);
            }
            let listed = self.get_mut(pair);
            listed.set_bodies_and_phase(listed.bodies_and_phase().0, Phase::Apart);
            self.unused.push(pair);
        }
        self.grid.take(body);
    }

    /// Removes a body from all lists. The indices of later ones decrease by one, also in lists of neighbours.
    pub fn remove<B: Bodies<Pair = P>>(&mut self, bodies: &mut B, body: u32) {
        self.isolate(bodies, body);
        self.grid.forget(body);
        let shifted = |index: u32| index - u32::from(index > body);
        for pair in &mut self.pairs {
            let (bodies, phase) = pair.bodies_and_phase();
            pair.set_bodies_and_phase(bodies.map(shifted), phase);
        }
        for index in 0..bodies.scene().bodies.len() as u32 {
            bodies.neighbours(index).iter_mut().for_each(|neighbour| neighbour.other = shifted(neighbour.other));
        }
    }

    /// The centre of a body when it was placed [scene unit].
    pub fn placed_at(&self, body: u32) -> DVec3 {
        self.grid.ball(body).centre
    }

    /// Finds the pairs of a body that has been [placed](NearPairs::place) and has none; false, and it is taken out, if there
    /// may be more than `max` pairs then.
    pub fn join<B: Bodies<Pair = P>>(&mut self, bodies: &mut B, body: u32, max: u64) -> bool {
        let mut most = self.count() as u64;
        self.grid.each_touching(body, |_| most += 1);
        if most > max {
            self.grid.take(body);
            return false;
        }
        self.search(bodies, body, &Tally::unlimited());
        true
    }

    /// Finds the neighbours of a body that has been [placed](NearPairs::place). A known pair keeps its phase; a pair that
    /// is not apart stays listed at any distance.
    pub fn search<B: Bodies<Pair = P>>(&mut self, bodies: &mut B, body: u32, work: &Tally<'_>) {
        let (mut found, mut known) = (std::mem::take(&mut self.found), std::mem::take(&mut self.known));
        found.clear();
        self.grid.touching(body, &mut found);
        if work.spend(NEAR_ENOUGH * found.len() as u64) {
            let are_near = |other| {
                are_near(bodies.scene(), &self.grid, [body, other], [body, other].map(|body| bodies.fat_bounds(body)))
            };
            found.retain(|&other| are_near(other));
            known.clear();
            known.extend(bodies.neighbours(body).drain(..));
            self.replace(bodies, body, &found, &known, work);
        }
        (self.found, self.known) = (found, known);
    }

    /// Makes `found` the neighbours of a body, which were `known` so far.
    fn replace<B: Bodies<Pair = P>>(
        &mut self,
        bodies: &mut B,
        body: u32,
        found: &[u32],
        known: &[Neighbour],
        work: &Tally<'_>,
    ) {
        let mut known = known.iter().copied().peekable();
        for &other in found {
            while let Some(gone) = known.next_if(|neighbour| neighbour.other < other) {
                self.leave(bodies, body, gone);
            }
            match known.next_if(|neighbour| neighbour.other == other) {
                Some(neighbour) => bodies.neighbours(body).push(neighbour),
                None => {
                    work.spend(NEW_PAIR);
                    self.add(bodies, body, other);
                }
            }
            if work.is_over() {
                break;
            }
        }
        for gone in known {
            self.leave(bodies, body, gone);
        }
    }

    /// Removes a neighbour of a body from the lists, unless their phase keeps it there.
    fn leave<B: Bodies<Pair = P>>(&mut self, bodies: &mut B, body: u32, neighbour: Neighbour) {
        if self.get(neighbour.pair).bodies_and_phase().1 != Phase::Apart {
            bodies.neighbours(body).push(neighbour);
            return;
        }
        let others = bodies.neighbours(neighbour.other);
        if let Ok(index) = others.binary_search_by_key(&body, |other| other.other) {
            others.remove(index);
        }
        self.unused.push(neighbour.pair);
    }

    /// Lists a pair of bodies.
    fn add<B: Bodies<Pair = P>>(&mut self, bodies: &mut B, i: u32, j: u32) -> PairId {
        let pair = bodies.meet(i.min(j), i.max(j));
        let id = match self.unused.pop() {
            Some(id) => {
                *self.get_mut(id) = pair;
                id
            }
            None => {
                self.pairs.push(pair);
                PairId(self.pairs.len() as u32 - 1)
            }
        };
        for (body, other) in [(i, j), (j, i)] {
            let neighbour = spheres::neighbour(bodies.scene(), body, other, id);
            let neighbours = bodies.neighbours(body);
            let at = neighbours.partition_point(|neighbour| neighbour.other < other);
            neighbours.insert(at, neighbour);
        }
        id
    }

    /// A pair, which is listed at any distance.
    pub fn list<B: Bodies<Pair = P>>(&mut self, bodies: &mut B, a: u32, b: u32) -> PairId {
        let neighbours = bodies.neighbours(a);
        match neighbours.binary_search_by_key(&b, |neighbour| neighbour.other) {
            Ok(index) => neighbours[index].pair,
            Err(_) => self.add(bodies, a, b),
        }
    }

    /// A pair.
    pub fn get(&self, id: PairId) -> &P {
        &self.pairs[id.0 as usize]
    }

    /// A pair, to be changed.
    pub fn get_mut(&mut self, id: PairId) -> &mut P {
        &mut self.pairs[id.0 as usize]
    }

    /// All slots, unused ones included.
    pub fn all_mut(&mut self) -> &mut [P] {
        &mut self.pairs
    }

    /// Number of pairs.
    pub fn count(&self) -> usize {
        self.pairs.len() - self.unused.len()
    }

    /// The sum of the hashes of all pairs that are not apart.
    pub fn hash(&self) -> u64 {
        let of = |pair: &P| {
            let ([a, b], phase) = pair.bodies_and_phase();
            checksum::of_pair(a, b, phase)
        };
        self.pairs.iter().map(of).fold(0, u64::wrapping_add)
    }
}

/// Whether, within their fat bounds, one of two bodies can have vertices inside the other's sphere, or the two can
/// touch or merge. (Stricter than overlap of the fat bounds: a sphere does not act on another sphere.)
fn are_near(scene: &Scene, grid: &Grid, [i, j]: [u32; 2], [a, b]: [FatBounds; 2]) -> bool {
    let [one, other] = [i, j].map(|body| &scene.bodies[body as usize]);
    let acting = f64::max(one.sphere_radius() + b.vertices, other.sphere_radius() + a.vertices);
    let touching = acting.max(a.vertices + b.vertices);
    let merge_at = scene.law(i as usize, j as usize).thresholds.merge_at;
    let near = touching.max(merge_at * (one.radius + other.radius)) + a.skin + b.skin;
    let rounding = |ball: &Ball| 16.0 * f64::EPSILON * (ball.centre.abs().max_element() + ball.radius);
    let [first, second] = [i, j].map(|body| grid.ball(body));
    !(first.centre.distance(second.centre) > near + rounding(first) + rounding(second))
}
