//! Broad phase of coupled scenes, and the phases of near pairs.
//!
//! As for prescribed bodies, a body's fat bounds contain everything that it can touch and every point at which it can
//! be touched, until it has moved by more than their margin. But how far a free body moves is known only after the
//! step.

use super::{
    member::Member,
    neighbours::{FatBounds, Neighbour},
};
use crate::{
    model::phase::Phase,
    scene::Scene,
    sim::{
        checksum,
        free::Pair,
        reach::{Ball, Grid},
        work::{NEAR_ENOUGH, NEW_PAIR, Tally},
    },
};

/// How far a body may move before its neighbours are searched for again [radii].
const SKIN: f64 = 0.3;

/// All pairs of bodies that are near each other.
#[derive(Clone, Default)]
pub(in crate::sim) struct Near {
    pairs: Vec<Pair>,
    /// Unused indices of `pairs`.
    free: Vec<u32>,
    grid: Grid,
    /// The largest merge_at of any law [–].
    merge_at: f64,
    /// Sum of the hashes of pairs that are not apart.
    hash: u64,
    found: Vec<u32>,
    kept: Vec<Neighbour>,
}

impl Near {
    pub fn new(scene: &Scene) -> Near {
        let merge_at = scene.laws().map(|law| law.thresholds.merge_at).fold(0.0, f64::max);
        Near { merge_at, ..Near::default() }
    }

    /// Finds the pairs of all bodies at the start; false if there are more than `max`.
    pub fn start(&mut self, scene: &Scene, members: &mut [Member], max: u64, work: &Tally<'_>) -> bool {
        for i in 0..members.len() {
            self.place(members, i);
        }
        for i in 0..members.len() {
            self.find(scene, members, i, 0.0, work);
            if self.count() as u64 > max {
                return false;
            }
            if work.is_over() {
                break;
            }
        }
        true
    }

    /// Finds the pairs of the last body, which is new at `t` [s]; false, and nothing has changed, if there would be more
    /// than `max`.
    pub fn add_last(&mut self, scene: &Scene, members: &mut [Member], t: f64, max: u64) -> bool {
        let last = members.len() - 1;
        self.place(members, last);
        let mut found = 0;
        self.grid.each_touching(last as u32, |_| found += 1);
        if self.count() as u64 + found > max {
            self.grid.take(last as u32);
            return false;
        }
        self.find(scene, members, last, t, &Tally::unlimited());
        true
    }

    /// Finds the neighbours of a body again if it may leave its fat bounds in this step.
    pub fn update(&mut self, scene: &Scene, members: &mut [Member], i: usize, t: f64, work: &Tally<'_>) {
        let Member { body, bounds, fat, .. } = &members[i];
        if body.centre.distance(fat.centre) + bounds.way > fat.skin || bounds.extent > fat.extent {
            self.place(members, i);
            self.find(scene, members, i, t, work);
        }
    }

    fn place(&mut self, members: &mut [Member], i: usize) {
        let Member { body, bounds, extent, fat, .. } = &mut members[i];
        let skin = (SKIN * body.radius).max(4.0 * bounds.way);
        let extent = bounds.extent.max(*extent) + SKIN * body.radius;
        *fat = FatBounds { centre: body.centre, skin, extent };
        let reach = body.sphere_radius.max(extent).max(self.merge_at * body.radius) + skin;
        let rounding = 16.0 * f64::EPSILON * (body.centre.abs().max_element() + reach);
        self.grid.place(i as u32, Ball { centre: body.centre, radius: reach + rounding });
    }

    /// Makes the bodies whose bounds touch those of body `i` its neighbours. A known pair keeps its phase; a pair that
    /// is not apart stays listed at any distance.
    fn find(&mut self, scene: &Scene, members: &mut [Member], i: usize, t: f64, work: &Tally<'_>) {
        let (mut found, mut kept) = (std::mem::take(&mut self.found), std::mem::take(&mut self.kept));
        found.clear();
        self.grid.touching(i as u32, &mut found);
        work.spend(NEAR_ENOUGH * found.len() as u64);
        kept.clear();
        kept.append(&mut members[i].neighbours);
        let mut known = kept.drain(..).peekable();
        for &other in &found {
            while let Some(gone) = known.next_if(|neighbour| neighbour.other < other) {
                self.leave(members, i, gone);
            }
            let neighbour = known.next_if(|neighbour| neighbour.other == other).unwrap_or_else(|| {
                work.spend(NEW_PAIR);
                let pair = self.add(scene, members, i, other as usize, t);
                let others = &mut members[other as usize].neighbours;
                let index = others.partition_point(|neighbour| neighbour.other < i as u32);
                others.insert(index, Neighbour { other: i as u32, pair });
                Neighbour { other, pair }
            });
            members[i].neighbours.push(neighbour);
            if work.is_over() {
                break;
            }
        }
        for gone in known {
            self.leave(members, i, gone);
        }
        (self.found, self.kept) = (found, kept);
    }

    fn leave(&mut self, members: &mut [Member], i: usize, neighbour: Neighbour) {
        if self.pairs[neighbour.pair as usize].phase != Phase::Apart {
            members[i].neighbours.push(neighbour);
            return;
        }
        let others = &mut members[neighbour.other as usize].neighbours;
        if let Ok(index) = others.binary_search_by_key(&(i as u32), |other| other.other) {
            others.remove(index);
        }
        self.free.push(neighbour.pair);
    }

    fn add(&mut self, scene: &Scene, members: &[Member], i: usize, j: usize, t: f64) -> u32 {
        let (a, b) = (i.min(j), i.max(j));
        let law = scene.law(a, b);
        let (first, second) = (&members[a].body, &members[b].body);
        let q = first.centre.distance(second.centre) / (first.radius + second.radius);
        let phase = if t == 0.0 { law.thresholds.initial(q) } else { Phase::Apart };
        let pair = Pair { a: a as u32, b: b as u32, phase, law, window: None };
        self.hash = self.hash.wrapping_add(checksum::of_pair(pair.a, pair.b, phase));
        if let Some(index) = self.free.pop() {
            self.pairs[index as usize] = pair;
            return index;
        }
        self.pairs.push(pair);
        self.pairs.len() as u32 - 1
    }

    /// Lists a pair that entered `phase` earlier.
    pub fn restore(&mut self, scene: &Scene, members: &mut [Member], a: usize, b: usize, phase: Phase) {
        let known = members[a].neighbours.binary_search_by_key(&(b as u32), |neighbour| neighbour.other);
        let pair = match known {
            Ok(index) => members[a].neighbours[index].pair,
            Err(_) => {
                let pair = self.add(scene, members, a, b, 0.0);
                for (i, j) in [(a, b), (b, a)] {
                    let others = &mut members[i].neighbours;
                    let index = others.partition_point(|neighbour| neighbour.other < j as u32);
                    others.insert(index, Neighbour { other: j as u32, pair });
                }
                pair
            }
        };
        self.enter(pair, phase);
    }

    /// The pair with an index; its bodies are indices of the scene.
    pub fn pair(&self, index: u32) -> &Pair {
        &self.pairs[index as usize]
    }

    /// Sets the phase of a pair.
    pub fn enter(&mut self, index: u32, phase: Phase) {
        let pair = &mut self.pairs[index as usize];
        let (before, after) = (pair.phase, phase);
        pair.phase = after;
        let [before, after] = [before, after].map(|phase| checksum::of_pair(pair.a, pair.b, phase));
        self.hash = self.hash.wrapping_sub(before).wrapping_add(after);
    }

    /// Whether, within the step, one body of a pair can have vertices inside the other's sphere, or the pair can change
    /// phase.
    pub fn is_coupled(&self, index: u32, members: &[Member]) -> bool {
        let pair = &self.pairs[index as usize];
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

    /// Number of pairs.
    pub fn count(&self) -> usize {
        self.pairs.len() - self.free.len()
    }

    /// The sum of the hashes of all pairs that are not apart.
    pub fn hash(&self) -> u64 {
        self.hash
    }

    /// Memory allocated for the pairs [bytes].
    pub fn memory(&self) -> usize {
        self.pairs.capacity() * size_of::<Pair>() + self.free.capacity() * size_of::<u32>() + self.grid.memory()
    }
}
