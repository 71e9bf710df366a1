//! How close pairs came without leaving their first phase: the answer to "why did these two not merge?".

use std::collections::BTreeMap;

use super::{Frame, PairEvent, Schema};

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

/// The closest approaches of all pairs that came within reach and stayed in their first phase, from the frames of a
/// run.
///
/// Between frames, q² is interpolated by a parabola through three frames: exact for bodies at constant velocity.
#[derive(Clone, Debug, Default)]
pub struct Approaches {
    pairs: BTreeMap<(usize, usize), Watched>,
}

/// A pair, and its last two frames.
#[derive(Clone, Copy, Debug)]
struct Watched {
    closest: Approach,
    /// Time and q² in the last frame, and in the previous one if it contained the pair.
    last: (f64, f64),
    before: Option<(f64, f64)>,
    /// Whether the pair has left its first phase.
    has_changed: bool,
}

impl Approaches {
    /// Adds a frame. Frames must be added in order of time.
    pub fn add(&mut self, frame: &Frame) {
        let time = frame.at.time;
        for pair in &frame.pairs {
            let now = (time, pair.q * pair.q);
            let is_full = self.pairs.len() >= MAX_PAIRS;
            let closest = Approach { a: pair.a, b: pair.b, q: pair.q, time };
            let Some(watched) = self.pairs.get_mut(&(pair.a, pair.b)) else {
                if !is_full {
                    let has_changed = pair.phase != 0;
                    let watched = Watched { closest, last: now, before: None, has_changed };
                    self.pairs.insert((pair.a, pair.b), watched);
                }
                continue;
            };
            watched.has_changed |= pair.phase != 0;
            if watched.has_changed {
                continue;
            }
            if pair.q < watched.closest.q {
                watched.closest = closest;
            }
            if let Some(before) = watched.before
                && let Some((time, squared)) = lowest([before, watched.last, now])
                && squared < watched.closest.q * watched.closest.q
            {
                (watched.closest.q, watched.closest.time) = (squared.max(0.0).sqrt(), time);
            }
            (watched.before, watched.last) = (Some(watched.last), now);
        }
    }

    /// Adds a phase change.
    pub fn change(&mut self, event: &PairEvent) {
        if let Some(watched) = self.pairs.get_mut(&(event.a, event.b)) {
            watched.has_changed = true;
        }
    }

    /// The closest approaches, the nearest first.
    pub fn closest(&self) -> Vec<Approach> {
        let unchanged = self.pairs.values().filter(|pair| !pair.has_changed);
        let mut closest: Vec<Approach> = unchanged.map(|pair| pair.closest).collect();
        closest.sort_by(|x, y| x.q.total_cmp(&y.q).then((x.a, x.b).cmp(&(y.a, y.b))));
        closest
    }
}

impl Approach {
    /// Describes the approach in words: its distance, its time, and by how much it missed the first threshold.
    pub fn describe(&self, schema: &Schema) -> String {
        let first = schema.thresholds.first().zip(schema.level(0, self.a, self.b));
        let missed = first.map_or(String::new(), |(threshold, level)| {
            format!(", {:.4} short of {} = {level}", self.q - level, threshold.name)
        });
        let (pair, Approach { q, time, .. }) = (schema.pair_name(self.a, self.b), self);
        format!("{pair} came to q = {q:.4} at t = {time:.4} s{missed}")
    }
}

/// The vertex of the parabola through three points (t, y), if it is a minimum between the first and the last.
pub(crate) fn lowest([(t0, y0), (t1, y1), (t2, y2)]: [(f64, f64); 3]) -> Option<(f64, f64)> {
    let (slope, next) = ((y1 - y0) / (t1 - t0), (y2 - y1) / (t2 - t1));
    let curvature = (next - slope) / (t2 - t0);
    let time = 0.5 * (t0 + t1) - 0.5 * slope / curvature;
    let lowest = y0 + (time - t0) * (slope + curvature * (time - t1));
    (curvature > 0.0 && t0 < time && time < t2).then_some((time, lowest))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Scene, World, observe::Simulation, observe::Want};

    /// b passes a at a distance of 2.14 in a straight line: q = 1.07 at t = 2.8 s, between two steps.
    #[test]
    fn a_near_miss_is_found_between_frames() {
        let scene = "duration = 4.0\ndt = 0.03\n[[body]]\nname = 'a'\nradius = 1.0\nmotion = { fixed = [0, 0, 0] }\n\
                     [[body]]\nname = 'b'\nradius = 1.0\n\
                     motion = { line = { from = [-1.4, 2.14, 0], velocity = [0.5, 0, 0] } }\n";
        let mut world = World::new(Scene::parse(scene, "miss.toml").unwrap()).unwrap();
        let (mut approaches, mut frame) = (Approaches::default(), Frame::default());
        let schema = Simulation::schema(&world);
        for _ in 0..133 {
            world.observe(Want::default(), &mut frame);
            approaches.add(&frame);
            world.step();
        }
        let [found] = approaches.closest()[..] else { panic!("one pair") };
        assert!((found.q - 1.07).abs() < 1e-12 && (found.time - 2.8).abs() < 1e-12, "{found:?}");
        assert_eq!(found.describe(&schema), "a~b came to q = 1.0700 at t = 2.8000 s, 0.0200 short of merge_at = 1.05");
    }

    #[test]
    fn a_pair_that_merges_is_not_listed() {
        let mut world = World::new(Scene::builtin("two").unwrap()).unwrap();
        let (mut approaches, mut frame) = (Approaches::default(), Frame::default());
        for _ in 0..240 {
            world.observe(Want::default(), &mut frame);
            approaches.add(&frame);
            world.step();
        }
        assert_eq!(approaches.closest(), []);
    }
}
