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
/// Number of places in a step at which the distance of a pair is looked at.
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

impl NearPair {
    /// Time [s] and distance [scene unit] of an extremum of the centre distance within the step of a simulation from
    /// this state to `next`: of its minimum, or of its maximum. Bodies on paths are where their paths are; the motion of
    /// others is interpolated by a cubic from their velocities at both ends.
    pub fn extremum(&self, next: &NearPair, simulation: &dyn Simulation, ends: [f64; 2], is_maximum: bool) -> [f64; 2] {
        let h = ends[1] - ends[0];
        let sign = if is_maximum { -1.0 } else { 1.0 };
        let distance = |z: f64| {
            let time = ends[0] + z * h;
            let apart = match [self.a, self.b].map(|body| simulation.on_path(body, time)) {
                [Some([a, _]), Some([b, _])] => b - a,
                _ => {
                    let [a, b] = [self.a, self.b].map(|body| beside_cubic(simulation, body, ends, time));
                    Hermite::new(ends, time).vector([self.apart, next.apart], [self.rate, next.rate]) + b - a
                }
            };
            sign * apart.length()
        };
        let at = |k: usize| k as f64 / LOOKS as f64;
        let looks: [f64; LOOKS + 1] = std::array::from_fn(|k| distance(at(k)));
        let least = (0..=LOOKS).min_by(|&i, &j| looks[i].total_cmp(&looks[j])).unwrap_or(0);
        // golden section about the least
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
        [ends[0] + best_at * h, sign * best]
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

/// The closest approaches of all pairs that came within reach and stayed in their first phase. They are found in the
/// motion of every step, so they do not depend on which frames are recorded.
#[derive(Clone, Debug, Default)]
pub struct Approaches {
    pairs: BTreeMap<(usize, usize), Watched>,
    /// The pairs after the last step, and the time then [s].
    before: Vec<NearPair>,
    time: f64,
    /// Scratch storage, reused.
    now: Vec<NearPair>,
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
        let mut now = take(&mut self.now);
        simulation.near(&mut now);
        let time = simulation.time();
        for change in changes {
            if let Some(watched) = self.pairs.get_mut(&(change.a, change.b)) {
                watched.has_changed = true;
            }
        }
        let mut before = self.before.iter().peekable();
        for pair in &now {
            let key = (pair.a, pair.b);
            while before.next_if(|before| (before.a, before.b) < key).is_some() {}
            let before = before.next_if(|before| (before.a, before.b) == key);
            let has_changed = pair.phase != 0 || changes.iter().any(|change| (change.a, change.b) == key);
            let radii = schema.bodies[pair.a].radius + schema.bodies[pair.b].radius;
            let closest = Approach { a: pair.a, b: pair.b, q: pair.apart.length() / radii, time };
            let is_full = self.pairs.len() >= MAX_PAIRS;
            let watched = match self.pairs.get_mut(&key) {
                Some(watched) => watched,
                None if is_full => continue,
                None => {
                    // a pair that came within reach because a body was deformed did not come nearer
                    let is_still = pair.rate.length() * (time - self.time) < STILL * radii;
                    let first = if is_still { closest.q } else { f64::INFINITY };
                    self.pairs.entry(key).or_insert(Watched { closest, first, has_changed })
                }
            };
            watched.has_changed |= has_changed;
            if watched.has_changed {
                continue;
            }
            if closest.q < watched.closest.q {
                watched.closest = closest;
            }
            let nearest = watched.closest.q * radii * (1.0 - 1e-12);
            if let Some(before) = before
                && before.may_be_nearer(pair, simulation, [self.time, time], nearest)
            {
                let [time, distance] = before.extremum(pair, simulation, [self.time, time], false);
                if distance / radii < watched.closest.q {
                    // a distance below the threshold would have been an event: what is left is interpolation
                    let q = f64::max(distance / radii, schema.level(0, [pair.a, pair.b], time).unwrap_or(0.0));
                    (watched.closest.q, watched.closest.time) = (q.min(watched.closest.q), time);
                }
            }
        }
        (self.before, self.now, self.time) = (now, take(&mut self.before), time);
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
