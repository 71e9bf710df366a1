//! How close pairs came without leaving their first phase: the answer to "why did these two not merge?".

use std::{collections::BTreeMap, mem::take};

use glam::DVec3;

use crate::{
    model::hermite::Hermite,
    observe::{NearPair, PairEvent, Schema, Simulation},
};

/// Upper limit on the number of tracked pairs.
const MAX_PAIRS: usize = 1 << 16;

/// The closest approach of a pair.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Approach {
    /// Index of the first body.
    pub a: usize,
    /// Index of the second body; a < b.
    pub b: usize,
    /// The smallest centre distance over the sum of the radii [–].
    pub q: f64,
    /// Time of the closest approach [s].
    pub time: f64,
}

/// A pair whose q falls by less does not approach [–].
const STILL: f64 = 1e-4;
/// Number of instants in a step at which a pair's distance is sampled.
const LOOKS: usize = 8;

/// How far a body is at `time` from the cubic through the ends of a step [s, scene unit]; 0 unless it is on a path.
fn beside_cubic(simulation: &dyn Simulation, body: usize, ends: [f64; 2], time: f64) -> DVec3 {
    let on_path = |time: f64| simulation.on_path(body, time);
    let (Some([from, rate]), Some([to, last_rate]), Some([now, _])) =
        (on_path(ends[0]), on_path(ends[1]), on_path(time))
    else {
        return DVec3::ZERO;
    };
    now - Hermite::new(ends, time).vector([from, to], [rate, last_rate])
}

/// Where in a step an instant is.
fn at(k: usize) -> f64 {
    k as f64 / LOOKS as f64
}

/// Index of the least value.
fn least(looks: &[f64; LOOKS + 1]) -> usize {
    (0..=LOOKS).min_by(|&i, &j| looks[i].total_cmp(&looks[j])).unwrap_or(0)
}

impl NearPair {
    /// Time [s] and distance [scene unit] of an extremum of the centre distance within the step of a simulation from
    /// this state to `next`: of its minimum, or of its maximum. Bodies on paths are where their paths are; the motion of
    /// others is interpolated by a cubic from their velocities at both ends.
    pub fn extremum(&self, next: &NearPair, simulation: &dyn Simulation, ends: [f64; 2], is_maximum: bool) -> [f64; 2] {
        let sign = if is_maximum { -1.0 } else { 1.0 };
        let looks = self.looks(next, simulation, ends).map(|apart| sign * apart.length());
        let [time, least] = self.golden_section(next, simulation, ends, sign, &looks);
        [time, sign * least]
    }

    /// Time [s] and distance [scene unit] of the minimum within the step, like [`NearPair::extremum`]; `None` if it is at one
    /// of the step's ends, or is not below `limit` [scene unit].
    fn minimum_below(
        &self,
        limit: f64,
        next: &NearPair,
        simulation: &dyn Simulation,
        ends: [f64; 2],
    ) -> Option<[f64; 2]> {
        if !self.may_be_nearer(next, simulation, ends, limit) {
            return None;
        }
        let places = self.looks(next, simulation, ends);
        let looks = places.map(|apart| apart.length());
        let is_excluded = match least(&looks) {
            0 => self.apart.dot(self.rate) > 0.0,
            LOOKS => next.apart.dot(next.rate) < 0.0,
            k => {
                // between two instants the pair hardly comes nearer than by how far it is from one to the next
                let hop = |k: usize| places[k].distance(places[k + 1]);
                looks[k] - f64::max(hop(k - 1), hop(k)) > limit
            }
        };
        let found = (!is_excluded).then(|| self.golden_section(next, simulation, ends, 1.0, &looks));
        found.filter(|[_, distance]| *distance < limit)
    }

    /// The centre of the second body as seen from that of the first at a time within the step [scene unit].
    fn apart_at(&self, next: &NearPair, simulation: &dyn Simulation, ends: [f64; 2], time: f64) -> DVec3 {
        match [self.a, self.b].map(|body| simulation.on_path(body, time)) {
            [Some([a, _]), Some([b, _])] => b - a,
            _ => {
                let [a, b] = [self.a, self.b].map(|body| beside_cubic(simulation, body, ends, time));
                Hermite::new(ends, time).vector([self.apart, next.apart], [self.rate, next.rate]) + b - a
            }
        }
    }

    /// [`NearPair::apart_at`] at evenly spaced instants.
    fn looks(&self, next: &NearPair, simulation: &dyn Simulation, ends: [f64; 2]) -> [DVec3; LOOKS + 1] {
        std::array::from_fn(|k| self.apart_at(next, simulation, ends, ends[0] + at(k) * (ends[1] - ends[0])))
    }

    /// About how far the one centre moves as seen from the other within the step to `next` [scene unit].
    pub fn path_length(&self, next: &NearPair, simulation: &dyn Simulation, ends: [f64; 2]) -> f64 {
        self.looks(next, simulation, ends).windows(2).map(|ends| ends[0].distance(ends[1])).sum()
    }

    /// Time [s] and value of the minimum of `sign` times the distance, by golden section about the least of `looks`.
    fn golden_section(
        &self,
        next: &NearPair,
        simulation: &dyn Simulation,
        ends: [f64; 2],
        sign: f64,
        looks: &[f64; LOOKS + 1],
    ) -> [f64; 2] {
        let h = ends[1] - ends[0];
        let distance = |z: f64| sign * self.apart_at(next, simulation, ends, ends[0] + z * h).length();
        let least = least(looks);
        let share = 0.5 * (5f64.sqrt() - 1.0);
        let (mut low, mut high) = (at(least.saturating_sub(1)), at((least + 1).min(LOOKS)));
        let (mut best, mut best_at) = (looks[least], at(least));
        for _ in 0..40 {
            let (one, other) = (high - share * (high - low), low + share * (high - low));
            let (of_one, of_other) = (distance(one), distance(other));
            for (value, at) in [(of_one, one), (of_other, other)] {
                if value < best {
                    (best, best_at) = (value, at);
                }
            }
            if of_one < of_other { high = other } else { low = one }
        }
        [ends[0] + best_at * h, best]
    }

    /// Whether the distance may be below `nearest` [scene unit] in the step to `next`.
    fn may_be_nearer(&self, next: &NearPair, simulation: &dyn Simulation, ends: [f64; 2], nearest: f64) -> bool {
        let pair = [self.a, self.b];
        if pair.into_iter().all(|body| simulation.on_path(body, ends[1]).is_some()) {
            return true;
        }
        let h = ends[1] - ends[0];
        let beside = |z: f64| pair.map(|body| beside_cubic(simulation, body, ends, ends[0] + z * h).length());
        let beside = [0.25, 0.5, 0.75].map(beside).into_iter().flatten().fold(0.0, f64::max);
        // between these instants a path may be farther from the cubic
        self.least_distance(next, h) - 2.0 * beside < nearest
    }

    /// A lower bound of the distance [scene unit] of bodies neither of which is on a path, in a step of `h` [s] to `next`: a
    /// cubic does not leave the convex hull of its Bézier points.
    fn least_distance(&self, next: &NearPair, h: f64) -> f64 {
        let along = next.apart.normalize_or_zero();
        let points = [self.apart, self.apart + self.rate * (h / 3.0), next.apart - next.rate * (h / 3.0), next.apart];
        points.map(|point| point.dot(along)).into_iter().fold(f64::INFINITY, f64::min)
    }
}

/// Follows the pairs near each other from step to step.
#[derive(Clone, Debug, Default)]
pub struct Follower {
    /// The pairs after the last step, and the time then [s].
    before: Vec<NearPair>,
    time: f64,
    /// Scratch storage, reused.
    now: Vec<NearPair>,
}

/// A near pair in the last step.
pub struct Followed<'a> {
    /// The pair after the step.
    pub pair: NearPair,
    /// Its centre distance over the sum of the radii after the step [–].
    pub q: f64,
    /// Whether it is within reach after the step.
    pub is_within_reach: bool,
    /// Sum of the radii [scene unit].
    radii: f64,
    reach: f64,
    before: Option<NearPair>,
    /// The times at which the step starts and ends [s].
    pub ends: [f64; 2],
    simulation: &'a dyn Simulation,
}

impl Follower {
    /// Hands over the near pairs of the last step, or of the start, in ascending order, given the radii of bodies [scene
    /// unit].
    pub fn step(
        &mut self,
        simulation: &dyn Simulation,
        radius: impl Fn(usize) -> f64,
        mut each: impl FnMut(&Followed<'_>),
    ) {
        simulation.near(&mut self.now);
        let ends = [self.time, simulation.time()];
        let mut before = self.before.iter().peekable();
        for pair in &self.now {
            let key = (pair.a, pair.b);
            while before.next_if(|before| (before.a, before.b) < key).is_some() {}
            let before = before.next_if(|before| (before.a, before.b) == key).copied();
            let (radii, reach) = (radius(pair.a) + radius(pair.b), simulation.reach(pair.a, pair.b));
            let q = pair.apart.length() / radii;
            let is_within_reach = pair.phase != 0 || q <= reach;
            each(&Followed { pair: *pair, q, is_within_reach, before, ends, simulation, radii, reach });
        }
        (self.before, self.now, self.time) = (take(&mut self.now), take(&mut self.before), ends[1]);
    }
}

impl Followed<'_> {
    /// Time [s] and q of the closest approach within the step, if it is below `limit` [–] and within reach, or `was_near`: once a
    /// pair was, it is followed beyond. The ends of the step are not searched. `acceleration` bounds that of b as seen from a [scene unit/s²]; infinite if unknown.
    pub fn closest_below(&self, limit: f64, acceleration: f64, was_near: bool) -> Option<[f64; 2]> {
        let Followed { pair, ends, simulation, .. } = self;
        let limit = if self.is_within_reach || was_near { limit } else { limit.min(self.reach) };
        // the least rate with which it cannot have turned in the step
        let steady = 0.5 * acceleration * (ends[1] - ends[0]);
        if -pair.apart.dot(pair.rate) >= steady * pair.apart.length() {
            return None; // it is nearest at the end
        }
        let on_paths = || {
            let [a, b] = [pair.a, pair.b].map(|body| simulation.on_path(body, ends[0]));
            let ([from, rate], [to, other_rate]) = (a?, b?);
            Some(NearPair { apart: to - from, rate: other_rate - rate, ..*pair })
        };
        let before = self.before.or_else(on_paths).filter(|_| ends[0] < ends[1])?;
        if before.apart.dot(before.rate) >= steady * before.apart.length() {
            return None; // it is nearest at the start
        }
        let [time, distance] = before.minimum_below(limit * self.radii, pair, *simulation, *ends)?;
        Some([time, distance / self.radii])
    }
}

/// The closest approaches of all pairs that came within reach and stayed in their first phase. They are found in the
/// motion of every step, so they do not depend on which frames are recorded.
#[derive(Clone, Debug, Default)]
pub struct Approaches {
    pairs: BTreeMap<(usize, usize), Watched>,
    follower: Follower,
}

#[derive(Clone, Copy, Debug)]
struct Watched {
    closest: Approach,
    /// q at the start; infinite if the pair came within reach later [–].
    first: f64,
    /// Whether the pair has left its first phase.
    has_changed: bool,
}

impl Approaches {
    /// Starts at the simulation's current state.
    pub fn new(simulation: &dyn Simulation, schema: &Schema) -> Approaches {
        let mut approaches = Approaches::default();
        approaches.step(simulation, schema, &[]);
        approaches.pairs.values_mut().for_each(|watched| watched.first = watched.closest.q);
        approaches
    }

    /// Adds the last step of a simulation, given its phase changes.
    pub fn step(&mut self, simulation: &dyn Simulation, schema: &Schema, changes: &[PairEvent]) {
        for change in changes {
            if let Some(watched) = self.pairs.get_mut(&(change.a, change.b)) {
                watched.has_changed = true;
            }
        }
        let (start, time) = (self.follower.time, simulation.time());
        let pairs = &mut self.pairs;
        self.follower.step(
            simulation,
            |body| schema.bodies[body].radius,
            |followed| {
                let Followed { pair, q, radii, .. } = *followed;
                let key = (pair.a, pair.b);
                let has_changed = pair.phase != 0 || changes.iter().any(|change| (change.a, change.b) == key);
                let known = pairs.get(&key).copied();
                if known.is_none() && pairs.len() >= MAX_PAIRS {
                    return;
                }
                let mut closest =
                    known.map_or(Approach { q: f64::INFINITY, time, a: pair.a, b: pair.b }, |known| known.closest);
                // a reach that shrinks does not end the approach
                let was_near = closest.q < f64::INFINITY;
                if (followed.is_within_reach || was_near) && q < closest.q {
                    (closest.q, closest.time) = (q, time);
                }
                let has_changed = has_changed || known.is_some_and(|known| known.has_changed);
                if !has_changed
                    && let Some([time, q]) = followed.closest_below(closest.q * (1.0 - 1e-12), f64::INFINITY, was_near)
                {
                    // a distance below the threshold would have been an event: what is left is interpolation
                    let q = f64::max(q, schema.level(0, [pair.a, pair.b], time).unwrap_or(0.0));
                    (closest.q, closest.time) = (q.min(closest.q), time);
                }
                // a pair that came within reach because a body was deformed did not come nearer
                let is_still = || pair.rate.length() * (time - start) < STILL * radii;
                let first = || if is_still() { closest.q } else { f64::INFINITY };
                if closest.q < f64::INFINITY || has_changed {
                    let first = known.map_or_else(first, |known| known.first);
                    pairs.insert(key, Watched { closest, first, has_changed });
                }
            },
        );
    }

    /// The closest approaches, the nearest first; not of pairs that stay as far apart as they begin or move apart, unless
    /// all do.
    pub fn closest(&self) -> Vec<Approach> {
        let approaches = |pair: &&Watched| pair.first - pair.closest.q > STILL;
        let do_any = self.pairs.values().any(|pair| pair.has_changed || approaches(&pair));
        let unchanged = self.pairs.values().filter(|pair| !pair.has_changed && (approaches(pair) || !do_any));
        let mut closest: Vec<Approach> = unchanged.map(|pair| pair.closest).collect();
        closest.sort_by(|x, y| x.q.total_cmp(&y.q).then((x.a, x.b).cmp(&(y.a, y.b))));
        closest
    }
}

impl Approach {
    /// Describes the approach in words: its distance, its time, and by how much it missed the first threshold.
    pub fn describe(&self, schema: &Schema) -> String {
        let first = schema.thresholds.first().zip(schema.level(0, [self.a, self.b], self.time));
        let missed = first.map_or(String::new(), |(threshold, level)| {
            let (by, at) = (self.q - level, format!("{} = {}", threshold.name, (1e4 * level).round() / 1e4));
            match by.abs() < 1e-9 {
                true => format!(", right at {at}"),
                false if by < 1e-4 => format!(", {by:.0e} short of {at}"),
                false => format!(", {by:.4} short of {at}"),
            }
        });
        let (pair, Approach { q, time, .. }) = (schema.pair_name(self.a, self.b), self);
        format!("{pair} came to q = {q:.4} at t = {time:.4} s{missed}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Scene, World};

    /// The closest approaches of a scene.
    fn closest(text: &str) -> (Vec<Approach>, Schema) {
        let mut world = World::new(Scene::parse(text, "miss.toml").unwrap()).unwrap();
        let schema = Simulation::schema(&world);
        let mut approaches = Approaches::new(&world, &schema);
        let mut summary = crate::observe::StepSummary::default();
        for _ in 0..world.scene().steps() {
            summary.clear();
            Simulation::step(&mut world, &mut summary);
            approaches.step(&world, &schema, &summary.events);
        }
        (approaches.closest(), schema)
    }

    /// b turns back at a keyframe between two steps, at a distance of 2.22 from a free body.
    #[test]
    fn a_near_miss_of_a_free_body_is_found_at_a_kink_of_a_path() {
        let (found, _) = closest(
            "duration = 1\ndt = 0.1\n[influence]\nalpha = 0\nbeta = 0\n[[body]]\nname = 'a'\nradius = 1.0\n\
             motion = { free = { from = [0, 0, 0] } }\n[[body]]\nname = 'b'\nradius = 1.0\nmotion = { keyframes = { \
             keys = [[0, 3, 0, 0], [0.25, 2.22, 0, 0], [0.5, 3.2, 0, 0]], interpolation = 'linear' } }\n",
        );
        let [found] = found[..] else { panic!("one pair") };
        assert!((found.q - 1.11).abs() < 1e-9 && (found.time - 0.25).abs() < 1e-6, "{found:?}");
    }

    /// b passes a in a straight line, out of reach at the ends of all steps: q = 1 in the middle of its way.
    #[test]
    fn a_near_miss_is_found_between_steps_out_of_reach() {
        for speed in [150, 200, 250, 300, 350, 400] {
            let (found, _) = closest(&format!(
                "duration = 0.2\n[influence]\nmerge_at = 0.9\nsplit_at = 1.3\n[[body]]\nname = 'a'\nradius = 1.0\n\
                 motion = {{ fixed = [0, 0, 0] }}\n[[body]]\nname = 'b'\nradius = 1.0\n\
                 motion = {{ line = {{ from = [-10.5, 2.0, 0], velocity = [{speed}, 0, 0] }} }}\n"
            ));
            assert!(found.len() == 1 && (found[0].q - 1.0).abs() < 1e-9, "{speed}: {found:?}");
        }
    }

    /// b passes a in a straight line at a distance of 3: never within reach.
    #[test]
    fn a_pair_out_of_reach_is_not_listed() {
        let (found, _) = closest(
            "duration = 2.0\n[[body]]\nname = 'a'\nradius = 1.0\nmotion = { fixed = [0, 0, 0] }\n[[body]]\n\
             name = 'b'\nradius = 1.0\nmotion = { line = { from = [-2, 3, 0], velocity = [2, 0, 0] } }\n",
        );
        assert_eq!(found, []);
    }

    /// b passes a at a distance of 2.14 in a straight line: q = 1.07 at t = 2.8 s, between two steps.
    #[test]
    fn a_near_miss_is_found_between_steps() {
        for dt in [0.03, 0.3] {
            let (found, schema) = closest(&format!(
                "duration = 3.9\ndt = {dt}\n[[body]]\nname = 'a'\nradius = 1.0\nmotion = {{ fixed = [0, 0, 0] }}\n\
                 [[body]]\nname = 'b'\nradius = 1.0\n\
                 motion = {{ line = {{ from = [-1.4, 2.14, 0], velocity = [0.5, 0, 0] }} }}\n"
            ));
            let [found] = found[..] else { panic!("one pair") };
            assert!((found.q - 1.07).abs() < 1e-12 && (found.time - 2.8).abs() < 1e-6, "{found:?}");
            assert_eq!(
                found.describe(&schema),
                "a~b came to q = 1.0700 at t = 2.8000 s, 0.0200 short of merge_at = 1.05"
            );
        }
    }

    /// A path that oscillates within a step: the nearest place is 1.0515 (2.103 apart), never below the threshold.
    #[test]
    fn a_near_miss_of_a_fast_path_is_found_within_a_step() {
        let (found, _) = closest(
            "duration = 2.0\ndt = 0.1\n[[body]]\nname = 'a'\nradius = 1.0\nmotion = { fixed = [0, 0, 0] }\n\
             [[body]]\nname = 'b'\nradius = 1.0\n\
             motion = { sine = { center = [2.4, 0, 0], amplitude = [0.297, 0, 0], frequency = 2.3 } }\n",
        );
        assert!(found.len() == 1 && (found[0].q - 1.0515).abs() < 1e-9, "{found:?}");
    }

    /// A free body turns back above the threshold; steps of a tenth of a second find the same distance as short ones.
    #[test]
    fn a_near_miss_of_free_bodies_does_not_depend_on_the_step() {
        let text = "duration = 1.0\n[[body]]\nname = 'a'\nradius = 1.0\nmotion = { free = { from = [0, 0, 0] } }\n\
                    [[body]]\nname = 'b'\nradius = 1.0\nmotion = { free = { from = [2.5, 0.1, 0], velocity = [-0.3, 0, 0] } }\n";
        let of = |dt: f64| closest(&format!("dt = {dt}\n{text}")).0;
        let (coarse, fine) = (of(0.1), of(1.0 / 240.0));
        assert!(coarse.len() == 1 && fine.len() == 1, "{coarse:?} {fine:?}");
        assert!((coarse[0].q - fine[0].q).abs() < 1e-4 && fine[0].q > 1.05, "{coarse:?} {fine:?}");
    }

    /// The pair is followed where its reach, which depends on how much its bodies are deformed, falls below its distance; a
    /// free body elsewhere changes nothing.
    #[test]
    fn a_near_miss_beyond_a_shrinking_reach_is_found() {
        let text = "dt = 0.03\nduration = 2.283\n[material]\nomega = 10.967\ndamping = 0.847\n[influence]\nalpha = 113.576\n\
                    beta = 49.103\nreach = 1.203\nweight = 'wendland'\nscaling = 'absolute'\nmerge_at = 1.289\nsplit_at = 1.357\n\
                    [[body]]\nname = 'b0'\nradius = 0.8259\nmotion = { sine = { center = [-0.275785, -1.35509, 1.25941], \
                    amplitude = [1.33728, 0.417466, 1.94396], frequency = 0.994 } }\n[[body]]\nname = 'b3'\nradius = 0.056\n\
                    motion = { line = { from = [0.692782, 0.408612, -1.0169], velocity = [-0.580103, -0.211096, 0.815525] } }\n";
        let free = "[[body]]\nname = 'b4'\nradius = 0.03\nmotion = { free = { from = [9, 9, 9] } }\n";
        for text in [text.to_owned(), format!("{text}{free}")] {
            let (found, _) = closest(&text);
            assert!((found[0].q - 1.647535).abs() < 1e-6 && (found[0].time - 1.98795).abs() < 1e-5, "{found:?}");
        }
    }

    /// b comes near a; c begins near both and moves away.
    #[test]
    fn a_pair_that_only_moves_apart_is_not_listed() {
        let (found, _) = closest(
            "duration = 2.0\n[[body]]\nname = 'a'\nradius = 1.0\nmotion = { fixed = [0, 0, 0] }\n\
             [[body]]\nname = 'b'\nradius = 1.0\n\
             motion = { sine = { center = [2.4, 0, 0], amplitude = [0.2, 0, 0], frequency = 0.5 } }\n\
             [[body]]\nname = 'c'\nradius = 1.0\n\
             motion = { line = { from = [0, 2.2, 0], velocity = [0, 0.5, 0] } }\n",
        );
        assert!(found.len() == 1 && (found[0].a, found[0].b) == (0, 1) && (found[0].q - 1.1).abs() < 1e-6, "{found:?}");
    }

    /// a and b stay 2.6 apart; they come within reach of each other when c deforms a.
    #[test]
    fn a_pair_that_keeps_its_distance_is_not_listed() {
        let (found, _) = closest(
            "duration = 4.0\n[[body]]\nname = 'a'\nradius = 1.0\nmotion = { line = { from = [0, 0, 0], velocity = [0, 1, 0] } }\n\
             [[body]]\nname = 'b'\nradius = 1.0\nmotion = { line = { from = [2.6, 0, 0], velocity = [0, 1, 0] } }\n\
             [[body]]\nname = 'c'\nradius = 1.0\nmotion = { line = { from = [-1.6, 6, 0], velocity = [0, -1, 0] } }\n",
        );
        assert_eq!(found, []);
    }

    #[test]
    fn a_pair_that_merges_is_not_listed() {
        assert_eq!(closest(Scene::builtin("two").unwrap().source.as_str()).0, []);
    }
}
