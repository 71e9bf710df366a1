//! Near pairs of bodies, their phases, and when these change.
//!
//! A body's fat bounds contain everything that it can touch and every point at which it can be touched, until its
//! centre or its vertices have moved by more than their margin. All pairs with overlapping fat bounds are listed, and
//! all pairs that are not apart. (In molecular dynamics: Verlet lists with a skin.)

use std::{
    ops::Range,
    sync::atomic::{AtomicU64, Ordering},
};

use rayon::prelude::*;

use super::{
    body::Body,
    neighbours::{FatBounds, Neighbour},
    tracks::Tracks,
};
use crate::{
    model::phase::Phase,
    scene::{Path, Scene},
    sim::{
        events::{Event, PairPaths, Search},
        reach::{Ball, Grid},
        report::StepReport,
        solver::Takeover,
        span::Span,
        terms::spheres,
        work::{DISTANCE, EVENT, NEAR_ENOUGH, NEW_PAIR, Stop, Tally, Work},
    },
};

/// How far a body may move before its neighbours are searched for again [radii].
const SKIN: f64 = 0.25;
/// The next phase change of a pair is searched for up to a multiple of this number of frames.
const AHEAD: f64 = 16.0;
/// Largest number of steps for which fat bounds are valid.
const MAX_STAY: f64 = 256.0;
/// Up to this many pairs are listed without counting them first.
const FEW_PAIRS: u64 = 1 << 16;

/// Two bodies that are near each other.
#[derive(Clone, Debug)]
pub(in crate::sim) struct Pair {
    /// Index of the first body.
    pub a: u32,
    /// Index of the second body; a < b.
    pub b: u32,
    /// Index of its law in the scene.
    law: u32,
    /// Phase at the start of the step; at its end once the step is done.
    pub phase: Phase,
    /// The next change of phase, if there is one before `known_until`.
    upcoming: Option<(f64, Phase)>,
    /// All changes up to this time are known [s].
    known_until: f64,
    /// The phase changes within the step, as a range of the list of all pairs' changes.
    pub changes: Range<u32>,
}

/// The input of a neighbour search.
pub(in crate::sim) struct Surrounded<'a> {
    pub scene: &'a Scene,
    pub bodies: &'a mut [Body],
    pub tracks: &'a Tracks,
    pub work: Tally<'a>,
}

/// The bodies of a step, and its work limit.
pub(in crate::sim) struct Moving<'a> {
    pub scene: &'a Scene,
    pub bodies: &'a mut [Body],
    pub tracks: &'a mut Tracks,
    pub work: &'a Work,
}

/// All pairs of bodies that are near each other.
#[derive(Clone, Default)]
pub(in crate::sim) struct Pairs {
    pairs: Vec<Pair>,
    /// Unused indices of `pairs`.
    free: Vec<u32>,
    grid: Grid,
    /// Phase changes of the current step, grouped by pair.
    changes: Vec<(f64, Phase)>,
    /// Pairs with phase changes in the current step.
    changed: Vec<u32>,
    /// The largest q at which a pair can merge [–].
    max_merge_at: f64,
    /// Buffers, reused.
    found: Vec<u32>,
    kept: Vec<Neighbour>,
}

impl Pairs {
    /// Finds all pairs that are near each other at `time` [s]; false if there are more than `max`. Pairs are counted
    /// before they are stored. When interrupted, keeps those found until then.
    pub fn start(
        &mut self,
        scene: &Scene,
        bodies: &mut [Body],
        tracks: &Tracks,
        time: f64,
        max: u64,
        work: &Work,
    ) -> bool {
        let mut of = Surrounded { scene, bodies, tracks, work: Tally::new(work, None) };
        self.max_merge_at = scene.laws().map(|law| law.thresholds.merge_at).fold(0.0, f64::max);
        for i in 0..of.bodies.len() {
            let radius = scene.bodies[i].radius;
            self.place(&mut of, i, radius, time);
        }
        let Some(count) = self.count_near(scene, of.bodies, max, work) else { return work.is_interrupted() };
        self.pairs.reserve_exact(count as usize);
        for i in 0..of.bodies.len() {
            self.find_neighbours(&mut of, i, time);
        }
        self.pairs.shrink_to_fit();
        of.bodies.iter_mut().for_each(|body| body.neighbours.shrink_to_fit());
        true
    }

    /// Takes over the `phases` of all pairs of bodies of another scene that are not apart. Then enters the phases of pairs
    /// that a threshold has passed, and reports these changes.
    pub fn resume(
        &mut self,
        mut of: Surrounded<'_>,
        phases: impl Iterator<Item = (usize, usize, Phase)>,
        takeover: &Takeover<'_>,
        report: &mut StepReport,
    ) {
        let (t, scene, tracks) = (takeover.time, of.scene, of.tracks);
        let is_kept = |body: u32| takeover.kept[body as usize].is_some();
        for pair in &mut self.pairs {
            let initial = || scene.law_at(pair.law).thresholds.initial(tracks.pair(pair.a, pair.b).q(t));
            pair.phase = if is_kept(pair.a) && is_kept(pair.b) { Phase::Apart } else { initial() };
        }
        for (a, b, phase) in phases {
            let index = self.list(&mut of, a as u32, b as u32, t);
            self.pairs[index as usize].phase = phase;
        }
        for Pair { a, b, law, phase, .. } in &mut self.pairs {
            let (a, b, paths) = (*a, *b, tracks.pair(*a, *b));
            let (q, rate) = (paths.q(t), paths.rate(t));
            while let Some(to) = scene.law_at(*law).thresholds.next(*phase, q) {
                let (time, step, from) = (t, report.step, *phase);
                report.events.push(Event { time, step, a, b, q, rate, from, to, energy: 0.0 });
                *phase = to;
            }
        }
    }

    /// The index of a pair, which is listed at any distance.
    fn list(&mut self, of: &mut Surrounded<'_>, a: u32, b: u32, t: f64) -> u32 {
        let known = of.bodies[a as usize].neighbours.binary_search_by_key(&b, |neighbour| neighbour.other);
        if let Ok(index) = known {
            return of.bodies[a as usize].neighbours[index].pair;
        }
        let pair = self.add(of.tracks.pair(a, b), [a, b], of.scene, t);
        for (body, other) in [(a, b), (b, a)] {
            let neighbours = &mut of.bodies[body as usize].neighbours;
            let index = neighbours.partition_point(|neighbour| neighbour.other < other);
            neighbours.insert(index, spheres::neighbour(of.scene, body, other, pair));
        }
        pair
    }

    /// Number of pairs of bodies that are near each other; `None` if more than `max`.
    fn count_near(&self, scene: &Scene, bodies: &[Body], max: u64, work: &Work) -> Option<u64> {
        let n = bodies.len() as u64;
        if n * n.saturating_sub(1) / 2 <= max.min(FEW_PAIRS) {
            return Some(0); // too few to be worth counting
        }
        let (grid, all) = (&self.grid, AtomicU64::new(0));
        let counted = (0..n as u32).into_par_iter().try_for_each(|i| {
            let mut near = 0;
            grid.each_touching(i, |j| near += u64::from(j > i && are_near(scene, bodies, grid, i, j)));
            let sum = all.fetch_add(near, Ordering::Relaxed) + near;
            (sum <= max && !work.is_interrupted()).then_some(())
        });
        counted.map(|()| all.into_inner())
    }

    /// Finds the neighbours of bodies that leave their fat bounds before the end of `span`.
    ///
    /// # Errors
    /// If there are too many: the body at which the search stopped.
    pub fn update(&mut self, among: Moving<'_>, span: Span) -> Result<(), (Stop, u32)> {
        let Moving { scene, bodies, tracks, work } = among;
        tracks.watch(|track| bodies[track.body as usize].fat_bounds.until < span.end);
        let mut of = Surrounded { scene, bodies, tracks, work: Tally::new(work, None) };
        for body in of.tracks.watched() {
            let vertices = of.bodies[body as usize].fat_bounds.vertices;
            self.anchor(&mut of, body as usize, vertices, span.start);
            if of.work.is_over() {
                return work.check().map_err(|stop| (stop, body));
            }
        }
        Ok(())
    }

    /// Gives a body fat bounds from time `t` on, for vertices up to `vertices` from its centre, and finds its
    /// neighbours.
    pub fn anchor(&mut self, of: &mut Surrounded<'_>, i: usize, vertices: f64, t: f64) {
        self.place(of, i, vertices, t);
        self.find_neighbours(of, i, t);
    }

    fn place(&mut self, of: &mut Surrounded<'_>, i: usize, vertices: f64, t: f64) {
        let scene = of.scene;
        let (this, path) = (&scene.bodies[i], of.tracks.path(i));
        let (skin, until) = stay(path, SKIN * this.radius, t, scene.dt);
        let merging = self.max_merge_at * this.radius;
        let reach = this.sphere_radius().max(vertices).max(merging) + skin;
        let centre = path.position(t);
        // so that a pair exactly on a threshold is not lost to rounding of the centres
        let rounding = 16.0 * f64::EPSILON * (centre.abs().max_element() + reach);
        of.bodies[i].fat_bounds = FatBounds { vertices, skin: skin + rounding, until };
        self.grid.place(i as u32, Ball { centre, radius: reach + rounding });
    }

    fn find_neighbours(&mut self, of: &mut Surrounded<'_>, i: usize, t: f64) {
        self.found.clear();
        self.grid.touching(i as u32, &mut self.found);
        let grid = &self.grid;
        if of.work.spend(NEAR_ENOUGH * self.found.len() as u64) {
            self.found.retain(|&j| are_near(of.scene, of.bodies, grid, i as u32, j));
            self.replace_neighbours(of, i, t);
        }
    }

    /// Makes `found` the neighbours of body `i`. A known pair keeps its phase; a pair that is not apart stays listed at
    /// any distance.
    fn replace_neighbours(&mut self, of: &mut Surrounded<'_>, i: usize, t: f64) {
        let Surrounded { scene, bodies, tracks, work } = of;
        let found = std::mem::take(&mut self.found);
        let mut kept = std::mem::take(&mut self.kept);
        kept.clear();
        kept.extend(bodies[i].neighbours.drain(..));
        let mut known = kept.drain(..).peekable();
        let leave = |pairs: &mut Pairs, bodies: &mut [Body], neighbour: Neighbour| {
            if pairs.pairs[neighbour.pair as usize].phase != Phase::Apart {
                bodies[i].neighbours.push(neighbour);
                return;
            }
            let others = &mut bodies[neighbour.other as usize].neighbours;
            if let Ok(index) = others.binary_search_by_key(&(i as u32), |other| other.other) {
                others.remove(index);
            }
            pairs.free.push(neighbour.pair);
        };
        for &other in &found {
            while let Some(gone) = known.next_if(|neighbour| neighbour.other < other) {
                leave(self, bodies, gone);
            }
            let neighbour = known.next_if(|neighbour| neighbour.other == other).unwrap_or_else(|| {
                work.spend(NEW_PAIR);
                let pair = self.add(tracks.pair(i as u32, other), [i as u32, other], scene, t);
                let others = &mut bodies[other as usize].neighbours;
                let index = others.partition_point(|neighbour| neighbour.other < i as u32);
                others.insert(index, spheres::neighbour(scene, other, i as u32, pair));
                for body in [i, other as usize] {
                    bodies[body].unchanged_until = f64::NEG_INFINITY;
                }
                spheres::neighbour(scene, i as u32, other, pair)
            });
            bodies[i].neighbours.push(neighbour);
            if work.is_over() {
                break;
            }
        }
        for gone in known {
            leave(self, bodies, gone);
        }
        (self.found, self.kept) = (found, kept);
    }

    fn add(&mut self, paths: PairPaths<'_>, [i, j]: [u32; 2], scene: &Scene, t: f64) -> u32 {
        let (a, b) = (i.min(j), i.max(j));
        let law = scene.law_index(a as usize, b as usize);
        let phase = if t == 0.0 { scene.law_at(law).thresholds.initial(paths.q(0.0)) } else { Phase::Apart };
        let pair = Pair { a, b, law, phase, upcoming: None, known_until: t, changes: 0..0 };
        if let Some(index) = self.free.pop() {
            self.pairs[index as usize] = pair;
            return index;
        }
        self.pairs.push(pair);
        self.pairs.len() as u32 - 1
    }

    /// Finds the exact times at which pairs change phase during `span`, in step `step`: adds them to `events`, in order.
    ///
    /// # Errors
    /// If that takes too much work: the pair that took the most.
    pub fn find_events(
        &mut self,
        among: Moving<'_>,
        span: Span,
        step: u64,
        events: &mut Vec<Event>,
    ) -> Result<(), (Stop, [u32; 2])> {
        let Moving { scene, bodies, tracks, work } = among;
        let tally = Tally::new(work, None);
        let mut busiest = (0, [0, 0]);
        let ahead = AHEAD * scene.dt * ((span.start / (AHEAD * scene.dt) + 1e-6).floor() + 1.0);
        self.changes.clear();
        self.changed.clear();
        tracks.watch(|track| bodies[track.body as usize].unchanged_until <= span.end);
        for body in tracks.watched() {
            let mut unchanged_until = f64::INFINITY;
            for neighbour in &bodies[body as usize].neighbours {
                let index = neighbour.pair as usize;
                // of two bodies that move, the first has found the changes for both
                if !self.pairs[index].may_change(span) {
                    unchanged_until = self.pairs[index].unchanged_until().min(unchanged_until);
                    continue;
                }
                let first = self.changes.len();
                let pair = &mut self.pairs[index];
                let both = tracks.pair(pair.a, pair.b);
                let rests = || [both.a, both.b].into_iter().all(|path| path.is_still(span.start, f64::INFINITY));
                let horizon = if rests() { f64::INFINITY } else { ahead };
                let mut from = pair.phase;
                let (a, b, before) = (pair.a, pair.b, tally.done());
                let search = Search { paths: both, thresholds: &scene.law_at(pair.law).thresholds, work: &tally };
                pair.advance(search, span, horizon, |time, to| {
                    self.changes.push((time, to));
                    let (q, rate) = (both.q(time), both.rate(time));
                    events.push(Event { time, step, a, b, q, rate, from, to, energy: 0.0 });
                    from = to;
                });
                busiest = busiest.max((tally.done() - before, [a, b]));
                if tally.is_over() {
                    return work.check().map_err(|stop| (stop, busiest.1));
                }
                if self.changes.len() > first {
                    self.pairs[index].changes = first as u32..self.changes.len() as u32;
                    self.changed.push(neighbour.pair);
                }
                unchanged_until = self.pairs[index].unchanged_until().min(unchanged_until);
            }
            bodies[body as usize].unchanged_until = unchanged_until;
        }
        events.sort_by(|x, y| x.time.total_cmp(&y.time).then((x.a, x.b).cmp(&(y.a, y.b))));
        Ok(())
    }

    /// The phases at the end of the step become those at the start of the next.
    pub fn enter_phases(&mut self) {
        for &index in &self.changed {
            let last = self.changes(index).last().map(|&(_, last)| last);
            let pair = &mut self.pairs[index as usize];
            pair.phase = last.unwrap_or(pair.phase);
            pair.changes = 0..0;
        }
    }

    /// Number of pairs.
    pub fn count(&self) -> usize {
        self.pairs.len() - self.free.len()
    }

    /// Memory allocated for the pairs [bytes].
    pub fn memory(&self) -> usize {
        self.pairs.capacity() * size_of::<Pair>() + self.free.capacity() * size_of::<u32>() + self.grid.memory()
    }

    /// The sum of the hashes of all pairs that are not apart.
    pub fn hash(&self) -> u64 {
        self.pairs.iter().map(Pair::hash).fold(0, u64::wrapping_add)
    }

    /// The pair with an index.
    pub fn get(&self, index: u32) -> &Pair {
        &self.pairs[index as usize]
    }

    /// The phase changes of a pair in the current step, in order: time and new phase.
    pub fn changes(&self, index: u32) -> &[(f64, Phase)] {
        let pair = self.get(index);
        &self.changes[pair.changes.start as usize..pair.changes.end as usize]
    }

    /// The phase of a pair from `t` on, within the current step.
    pub fn phase_at(&self, index: u32, t: f64) -> Phase {
        let changes = self.changes(index);
        let passed = changes.partition_point(|&(time, _)| time <= t);
        changes[..passed].last().map_or(self.get(index).phase, |&(_, phase)| phase)
    }
}

impl Pair {
    fn may_change(&self, span: Span) -> bool {
        self.known_until < span.end || self.upcoming.is_some_and(|(time, _)| time <= span.end)
    }

    /// The phase does not change before this time [s].
    fn unchanged_until(&self) -> f64 {
        self.upcoming.map_or(self.known_until, |(time, _)| time.min(self.known_until))
    }

    /// Reports the changes up to the end of `span`, searching up to `horizon` for the next. An infinite `horizon` means
    /// that no further change is possible.
    fn advance(&mut self, search: Search<'_>, span: Span, horizon: f64, mut found: impl FnMut(f64, Phase)) {
        let work = search.work;
        let mut phase = self.phase;
        let mut from = self.known_until.max(span.start);
        loop {
            if self.upcoming.is_none() {
                if from >= span.end {
                    self.known_until = from;
                    return;
                }
                if horizon == f64::INFINITY {
                    self.known_until = horizon;
                    return;
                }
                self.upcoming = search.first_change(phase, from, horizon);
                if !work.spend(DISTANCE) {
                    return;
                }
            }
            match self.upcoming {
                Some((time, to)) if time <= span.end => {
                    work.spend(EVENT);
                    found(time, to);
                    (from, phase) = (time, to);
                    // a jump of a centre can lead through two phases at once
                    while let Some(next) = search.paths.jump(search.thresholds, phase, time) {
                        found(time, next);
                        phase = next;
                    }
                    self.upcoming = None;
                }
                Some((time, _)) => {
                    self.known_until = time;
                    return;
                }
                None => from = horizon,
            }
        }
    }
}

/// Whether, within their fat bounds, one of two bodies can have vertices inside the other's sphere, or the two can
/// merge. (Stricter than overlap of the fat bounds: a sphere does not act on another sphere.)
fn are_near(scene: &Scene, bodies: &[Body], grid: &Grid, i: u32, j: u32) -> bool {
    let [a, b] = [i, j].map(|k| &bodies[k as usize].fat_bounds);
    let [one, other] = [i, j].map(|k| &scene.bodies[k as usize]);
    let touching = f64::max(one.sphere_radius() + b.vertices, other.sphere_radius() + a.vertices);
    let merge_at = scene.law(i as usize, j as usize).thresholds.merge_at;
    let near = touching.max(merge_at * (one.radius + other.radius)) + a.skin + b.skin;
    !(grid.ball(i).centre.distance(grid.ball(j).centre) > near)
}

/// A margin for the motion of a body's centre from time `t`, at least `skin` [scene unit], and the time until which the
/// centre stays within it [s].
fn stay(path: &Path, skin: f64, t: f64, dt: f64) -> (f64, f64) {
    if path.is_fixed() {
        return (0.0, f64::INFINITY);
    }
    let moved = |steps: f64| path.bounds(t, t + steps * dt).speed * steps * dt;
    if moved(1.0) > path.extent() {
        return (skin.max(path.extent()), t + MAX_STAY * dt);
    }
    let skin = skin.max(moved(1.0));
    let mut steps = MAX_STAY;
    while steps > 1.0 && moved(steps) > skin {
        steps /= 2.0;
    }
    (skin, t + steps * dt)
}

#[cfg(test)]
mod tests {
    use crate::{Scene, World};

    /// A pair with its own law is bit-identical to the pair in a scene with that law.
    #[test]
    fn a_pair_can_have_its_own_law() {
        let law = "merge_at = 0.9\nsplit_at = 1.0\ncore_at = 0.7\nalpha = 70.0\nbeta = 90.0\napart = \"none\"\n";
        let pair = |at: f64, names: [&str; 2]| {
            let body = |name: &str, motion: &str| {
                format!("[[body]]\nname = \"{name}\"\nradius = 1.0\ngroup = \"{name}s\"\nmotion = {{ {motion} }}\n")
            };
            body(names[0], &format!("fixed = [{at}, 0, 0]"))
                + &body(names[1], &format!("line = {{ from = [{at}, 2.4, 0], velocity = [0, -1, 0] }}"))
        };
        let run = |text: &str| {
            let mut world = World::new(Scene::parse(text, "laws.toml").unwrap()).unwrap();
            let mut events = vec![];
            for _ in 0..world.scene().steps() {
                events.extend(world.step().events.iter().map(|event| (event.time, event.q, event.from, event.to)));
            }
            let at: Vec<_> = world.bodies().map(|body| body.positions().collect::<Vec<_>>()).collect();
            (events, at)
        };
        let head = "duration = 4.0\n";
        let both = head.to_owned() + &pair(0.0, ["a", "b"]) + &pair(100.0, ["c", "d"]);
        let (own, own_at) = run(&(head.to_owned() + "[influence]\n" + law + &pair(100.0, ["c", "d"])));
        let (common, common_at) = run(&(head.to_owned() + &pair(0.0, ["a", "b"])));
        assert_ne!(own, common);
        for named in ["[\"c\", \"d\"]", "[\"ds\", \"cs\"]", "[\"cs\", \"d\"]"] {
            let (events, at) = run(&format!("{both}[[pair]]\nbodies = {named}\n{law}"));
            let mut expected = [common.clone(), own.clone()].concat();
            expected.sort_by(|x, y| x.0.total_cmp(&y.0));
            assert_eq!(events, expected, "{named}");
            assert_eq!(at, [common_at.clone(), own_at.clone()].concat(), "{named}");
        }
    }

    /// Two centres that jump and hold: phases change at the jump, whether it is found ahead or within the step, and a
    /// jump into a core is a merge and a core event at the same time.
    #[test]
    fn phases_change_at_jumps() {
        let text = |times: [f64; 5]| {
            let keys: Vec<String> =
                times.iter().zip([4.0, 1.0, 1.8, 2.2, 4.0]).map(|(t, x)| format!("[{t:?}, {x:?}, 0, 0]")).collect();
            format!(
                "duration = 2.0\n[influence]\ncore_at = 0.7\n[[body]]\nname = \"a\"\nradius = 1.0\nmotion = {{ fixed = \
                 [0, 0, 0] }}\n[[body]]\nname = \"b\"\nradius = 1.0\nmotion = {{ keyframes = {{ interpolation = \"hold\", \
                 keys = [{}] }} }}\n",
                keys.join(", ")
            )
        };
        use crate::model::phase::Phase::{Apart, Core, Merged};
        let steps = [0.25, 0.5, 1.0, 1.25, 1.5].map(|t: f64| (t * 60.0).round() / 60.0);
        for times in [[0.25, 0.503, 1.001, 1.25, 1.507], steps] {
            let expected =
                [(times[1], Merged), (times[1], Core), (times[2], Merged), (times[4], Apart)].map(|(t, to)| (t, to));
            let mut world = World::new(Scene::parse(&text(times), "jumps.toml").unwrap()).unwrap();
            let mut events = vec![];
            for _ in 0..world.scene().steps() {
                events.extend(world.step().events.iter().map(|event| (event.time, event.to)));
                assert!(world.report().failure.is_none());
            }
            assert_eq!(events, expected);
        }
    }

    /// A jump Δv of a centre's velocity changes that of every vertex by −Δv in full: |x| = Δv sin(ω(t − t₀))/ω for any
    /// scheme, within a step or between two.
    #[test]
    fn a_kink_of_a_path_is_an_impulse() {
        for (at, integrator, accuracy) in [
            (0.503, "exponential", 1e-12),
            (30.0 / 60.0, "exponential", 1e-12),
            (0.503, "rk4", 1e-2),
            (0.5, "verlet", 1e-2),
        ] {
            let text = format!(
                "duration = 1.0\nintegrator = \"{integrator}\"\n[material]\ndamping = 0.0\n[[body]]\nname = \"a\"\nradius = \
                 1.0\nmotion = {{ keyframes = {{ interpolation = \"linear\", keys = [[0, 0, 0, 0], [{at:?}, {at:?}, 0, 0], [9, \
                 {at:?}, 0, 0]] }} }}\n"
            );
            let mut world = World::new(Scene::parse(&text, "kink.toml").unwrap()).unwrap();
            for _ in 0..60 {
                assert!(world.step().failure.is_none());
                let t = world.time();
                let expected = if t <= at { 0.0 } else { (12.0 * (t - at)).sin() / 12.0 };
                let found = world.body(0).displacement(7);
                assert!((found.x - expected).abs() < accuracy, "{integrator} {t}: {found} {expected}");
            }
            // a rigid body feels nothing
            let rigid = text.replace("damping = 0.0", "response = \"rigid\"");
            let mut world = World::new(Scene::parse(&rigid, "kink.toml").unwrap()).unwrap();
            (0..60).for_each(|_| _ = world.step());
            assert_eq!(world.body(0).displacement(7), glam::DVec3::ZERO);
        }
    }
}
