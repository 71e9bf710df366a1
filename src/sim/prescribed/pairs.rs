//! Near pairs of bodies, their phases, and when these change.

use std::ops::Range;

use super::{body::Body, tracks::Tracks};
use crate::{
    model::phase::Phase,
    scene::{Path, Scene},
    sim::{
        events::{Event, Search},
        neighbours::{Bodies, FatBounds, Listed, NearPairs, Neighbours, PairId, SKIN},
        report::StepReport,
        solver::{Step, Takeover},
        span::Span,
        work::{DISTANCE, EVENT, Stop, Tally, Work},
    },
};

/// The next phase change of a pair is searched for up to a multiple of this number of frames.
const AHEAD: f64 = 16.0;
/// Largest number of steps for which fat bounds are valid.
const MAX_STAY: f64 = 256.0;

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
    /// The time at which it is searched [s].
    pub time: f64,
}

/// All pairs of bodies that are near each other, and their phase changes in the current step.
#[derive(Clone)]
pub(in crate::sim) struct Pairs {
    pub(super) near: NearPairs<Pair>,
    /// Phase changes of the current step, grouped by pair.
    changes: Vec<(f64, Phase)>,
    /// Pairs with phase changes in the current step.
    changed: Vec<PairId>,
}

impl Listed for Pair {
    fn bodies_and_phase(&self) -> ([u32; 2], Phase) {
        ([self.a, self.b], self.phase)
    }

    fn set_bodies_and_phase(&mut self, [a, b]: [u32; 2], phase: Phase) {
        (self.a, self.b, self.phase) = (a, b, phase);
    }
}

impl Bodies for Surrounded<'_> {
    type Pair = Pair;

    fn scene(&self) -> &Scene {
        self.scene
    }

    fn fat_bounds(&self, body: u32) -> FatBounds {
        self.bodies[body as usize].fat_bounds
    }

    fn neighbours(&mut self, body: u32) -> &mut Neighbours {
        &mut self.bodies[body as usize].neighbours
    }

    fn meet(&mut self, a: u32, b: u32) -> Pair {
        let law = self.scene.law_index(a as usize, b as usize);
        let initial = || self.scene.law_at(law).thresholds.initial(self.tracks.pair(a, b).q(0.0));
        let phase = if self.time == 0.0 { initial() } else { Phase::Apart };
        for body in [a, b] {
            self.bodies[body as usize].unchanged_until = f64::NEG_INFINITY;
        }
        Pair { a, b, law, phase, upcoming: None, known_until: self.time, changes: 0..0 }
    }
}

impl Pairs {
    /// No pairs yet.
    pub fn new(scene: &Scene) -> Pairs {
        Pairs { near: NearPairs::new(scene), changes: Vec::new(), changed: Vec::new() }
    }

    /// Finds all pairs that are near each other at `time` [s]; false if there are more than `max`.
    pub fn start(
        &mut self,
        scene: &Scene,
        bodies: &mut [Body],
        tracks: &Tracks,
        time: f64,
        max: u64,
        work: &Work,
    ) -> bool {
        let mut of = Surrounded { scene, bodies, tracks, time };
        for i in 0..of.bodies.len() {
            self.place(&mut of, i, scene.bodies[i].radius);
        }
        self.near.start(&mut of, max, work, &Tally::new(work, None))
    }

    /// Finds the pairs of a body that has none yet, in the phase of their q; false if there would be more than `max`.
    pub fn enter_body(&mut self, mut of: Surrounded<'_>, body: usize, max: u64) -> bool {
        let vertices = of.scene.bodies[body].radius;
        self.place(&mut of, body, vertices);
        if !self.near.join(&mut of, body as u32, max) {
            return false;
        }
        for neighbour in &of.bodies[body].neighbours {
            let pair = self.near.get_mut(neighbour.pair);
            pair.phase = of.scene.law_at(pair.law).thresholds.initial(of.tracks.pair(pair.a, pair.b).q(of.time));
        }
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
        for pair in self.near.all_mut() {
            let initial = || scene.law_at(pair.law).thresholds.initial(tracks.pair(pair.a, pair.b).q(t));
            pair.phase = if is_kept(pair.a) && is_kept(pair.b) { Phase::Apart } else { initial() };
        }
        for (a, b, phase) in phases {
            let index = self.near.list(&mut of, a as u32, b as u32);
            self.near.get_mut(index).phase = phase;
        }
        for Pair { a, b, law, phase, .. } in self.near.all_mut() {
            let (a, b, paths) = (*a, *b, tracks.pair(*a, *b));
            let (q, rate) = (paths.q(t), paths.rate(t));
            while let Some(to) = scene.law_at(*law).thresholds.next(*phase, q) {
                let (time, step, from) = (t, report.step, *phase);
                report.events.push(Event { time, step, a, b, q, rate, from, to, energy: 0.0 });
                *phase = to;
            }
        }
    }

    /// Finds the neighbours of bodies that leave their fat bounds before the end of the step.
    ///
    /// # Errors
    /// If there are too many: the body at which the search stopped.
    pub fn update(&mut self, bodies: &mut [Body], tracks: &mut Tracks, step: &Step<'_>) -> Result<(), (Stop, u32)> {
        let (scene, span, work) = (step.setting.scene, step.span, &*step.work);
        tracks.watch(|track| bodies[track.body as usize].known_until < span.end);
        let mut of = Surrounded { scene, bodies, tracks, time: span.start };
        let tally = Tally::new(work, None);
        for body in of.tracks.watched() {
            let vertices = of.bodies[body as usize].fat_bounds.vertices;
            self.anchor(&mut of, body as usize, vertices, &tally);
            if tally.is_over() {
                return work.check().map_err(|stop| (stop, body));
            }
        }
        Ok(())
    }

    /// Gives a body fat bounds for vertices up to `vertices` from its centre, and finds its neighbours.
    pub fn anchor(&mut self, of: &mut Surrounded<'_>, i: usize, vertices: f64, work: &Tally<'_>) {
        self.place(of, i, vertices);
        self.near.search(of, i as u32, work);
    }

    fn place(&mut self, of: &mut Surrounded<'_>, i: usize, vertices: f64) {
        let (scene, path, t) = (of.scene, of.tracks.path(i), of.time);
        let (skin, until) = stay(path, SKIN * scene.bodies[i].radius, t, scene.dt);
        let bounds = FatBounds { vertices, skin };
        (of.bodies[i].fat_bounds, of.bodies[i].known_until) = (bounds, until);
        self.near.place(scene, i as u32, path.position(t), bounds);
    }

    /// Finds the exact times at which pairs change phase during the step, and reports them in order.
    ///
    /// # Errors
    /// If that takes too much work: the pair that took the most.
    pub fn find_events(
        &mut self,
        bodies: &mut [Body],
        tracks: &mut Tracks,
        step: &mut Step<'_>,
    ) -> Result<(), (Stop, [u32; 2])> {
        let (scene, span, work) = (step.setting.scene, step.span, &*step.work);
        let StepReport { step, events, .. } = &mut *step.report;
        let tally = Tally::new(work, None);
        let mut busiest = (0, [0, 0]);
        let ahead = AHEAD * scene.dt * ((span.start / (AHEAD * scene.dt) + 1e-6).floor() + 1.0);
        self.changes.clear();
        self.changed.clear();
        tracks.watch(|track| bodies[track.body as usize].unchanged_until <= span.end);
        for body in tracks.watched() {
            let mut unchanged_until = f64::INFINITY;
            for neighbour in &bodies[body as usize].neighbours {
                let index = neighbour.pair;
                // of two bodies that move, the first has found the changes for both
                if !self.near.get(index).may_change(span) {
                    unchanged_until = self.near.get(index).unchanged_until().min(unchanged_until);
                    continue;
                }
                let first = self.changes.len();
                let pair = self.near.get_mut(index);
                let both = tracks.pair(pair.a, pair.b);
                let rests = || [both.a, both.b].into_iter().all(|path| path.is_still(span.start, f64::INFINITY));
                let horizon = if rests() { f64::INFINITY } else { ahead };
                let mut from = pair.phase;
                let (a, b, before) = (pair.a, pair.b, tally.done());
                let search = Search { paths: both, thresholds: &scene.law_at(pair.law).thresholds, work: &tally };
                pair.advance(search, span, horizon, |time, to| {
                    self.changes.push((time, to));
                    let (q, rate) = (both.q(time), both.rate(time));
                    events.push(Event { time, step: *step, a, b, q, rate, from, to, energy: 0.0 });
                    from = to;
                });
                busiest = busiest.max((tally.done() - before, [a, b]));
                if tally.is_over() {
                    return work.check().map_err(|stop| (stop, busiest.1));
                }
                if self.changes.len() > first {
                    self.near.get_mut(index).changes = first as u32..self.changes.len() as u32;
                    self.changed.push(neighbour.pair);
                }
                unchanged_until = self.near.get(index).unchanged_until().min(unchanged_until);
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
            let pair = self.near.get_mut(index);
            pair.phase = last.unwrap_or(pair.phase);
            pair.changes = 0..0;
        }
    }

    /// A pair.
    pub fn get(&self, id: PairId) -> &Pair {
        self.near.get(id)
    }

    /// The phase changes of a pair in the current step, in order: time and new phase.
    pub fn changes(&self, id: PairId) -> &[(f64, Phase)] {
        let pair = self.get(id);
        &self.changes[pair.changes.start as usize..pair.changes.end as usize]
    }

    /// The phase of a pair from `t` on, within the current step.
    pub fn phase_at(&self, id: PairId, t: f64) -> Phase {
        let changes = self.changes(id);
        let passed = changes.partition_point(|&(time, _)| time <= t);
        changes[..passed].last().map_or(self.get(id).phase, |&(_, phase)| phase)
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
