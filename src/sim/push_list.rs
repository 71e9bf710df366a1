//! The pushes on one body, found by time, and the acceleration of its vertices by many of them.
//!
//! The response of a body to a push is one number for all vertices, see [`Common`](super::state::Common), which every
//! step advances and every vertex near a sphere sums. That is cheapest for a few pushes. With more than [`MAX_SHARED`]
//! pushes, a body keeps the sum of their accelerations per vertex instead: a push then costs something only when it
//! begins and when it ends.

use super::{arrays::Vectors, span::Span};
use crate::scene::Push;

/// The largest number of pushes on a body whose responses are kept separately.
const MAX_SHARED: usize = 16;
/// Bound on the rounding error of sums of strengths, relative to the sum of all of them.
const ROUNDING: f64 = 1e-9;

/// The pushes on one body.
pub(super) struct PushList {
    /// In the order of the scene.
    all: Box<[Push]>,
    /// Present if there are more than [`MAX_SHARED`], which is rare.
    index: Option<Box<Index>>,
}

/// An index of many pushes by time.
struct Index {
    starts: Edges,
    ends: Edges,
    /// A tree over `starts`: node 1 is the root, node n has the children 2n and 2n + 1, and each holds the latest end
    /// of the pushes below it [s].
    latest_end: Box<[f64]>,
    /// Number of leaves.
    leaves: usize,
}

/// The starts or the ends of pushes.
struct Edges {
    /// Ascending [s].
    times: Box<[f64]>,
    /// Index of the push of each time.
    pushes: Box<[u32]>,
    /// Sums of the absolute strengths of the pushes before each, and of all [scene unit/s²].
    strengths: Box<[f64]>,
}

impl Edges {
    fn new(all: &[Push], time: impl Fn(&Push) -> f64) -> Edges {
        let mut order: Vec<u32> = (0..all.len() as u32).collect();
        order.sort_by(|&a, &b| time(&all[a as usize]).total_cmp(&time(&all[b as usize])));
        let mut sum = 0.0;
        let mut strengths = vec![0.0];
        strengths.extend(order.iter().map(|&push| {
            sum += all[push as usize].strength.abs();
            sum
        }));
        Edges {
            times: order.iter().map(|&push| time(&all[push as usize])).collect(),
            pushes: order.into(),
            strengths: strengths.into(),
        }
    }

    /// Number of times at or before `t`.
    fn until(&self, t: f64) -> usize {
        self.times.partition_point(|&time| time <= t)
    }

    /// Number of times before `t`.
    fn before(&self, t: f64) -> usize {
        self.times.partition_point(|&time| time < t)
    }

    fn within(&self, span: Span) -> &[f64] {
        &self.times[self.until(span.start)..self.before(span.end).max(self.until(span.start))]
    }

    fn memory(&self) -> usize {
        size_of_val(&*self.times) + size_of_val(&*self.pushes) + size_of_val(&*self.strengths)
    }
}

impl Index {
    fn new(all: &[Push]) -> Index {
        let (starts, ends) = (Edges::new(all, |push| push.start), Edges::new(all, Push::end));
        let leaves = all.len().next_power_of_two();
        let mut latest_end = vec![f64::NEG_INFINITY; 2 * leaves];
        for (leaf, &push) in starts.pushes.iter().enumerate() {
            latest_end[leaves + leaf] = all[push as usize].end();
        }
        for node in (1..leaves).rev() {
            latest_end[node] = latest_end[2 * node].max(latest_end[2 * node + 1]);
        }
        Index { starts, ends, latest_end: latest_end.into(), leaves }
    }

    /// Number of pushes that act at some time within `span`.
    fn count_within(&self, span: Span) -> usize {
        // a push without duration may count as ended before it has begun
        self.starts.before(span.end).saturating_sub(self.ends.until(span.start))
    }

    /// Appends the pushes below `node` that are among the first `count` by start and end after `t` [s].
    fn lasting(&self, node: usize, first: usize, leaves: usize, count: usize, t: f64, found: &mut Vec<u32>) {
        if first >= count || self.latest_end[node] <= t {
            return;
        }
        if leaves == 1 {
            found.push(self.starts.pushes[first]);
            return;
        }
        let half = leaves / 2;
        self.lasting(2 * node, first, half, count, t, found);
        self.lasting(2 * node + 1, first + half, half, count, t, found);
    }
}

impl PushList {
    /// The list of the pushes on one body, given in the order of the scene.
    pub fn new(all: Vec<Push>) -> PushList {
        let index = (all.len() > MAX_SHARED).then(|| Box::new(Index::new(&all)));
        PushList { all: all.into(), index }
    }

    /// The pushes whose responses the body's vertices share; empty if there are more than [`MAX_SHARED`].
    pub fn shared(&self) -> &[Push] {
        if self.index.is_some() { &[] } else { &self.all }
    }

    /// Whether the body needs a [`PushField`]: it has more than [`MAX_SHARED`] pushes, and some act within `span`.
    pub fn many_act(&self, span: Span) -> bool {
        self.index.as_ref().is_some_and(|index| index.count_within(span) > 0)
    }

    /// The pushes that act at `t` [s], in the order of the scene.
    pub fn acting(&self, t: f64) -> impl Iterator<Item = &Push> {
        let (few, many) = match &self.index {
            None => (&*self.all, Vec::new()),
            Some(index) => {
                let mut found = Vec::new();
                index.lasting(1, 0, index.leaves, index.starts.until(t), t, &mut found);
                found.sort_unstable();
                (&[][..], found)
            }
        };
        let few = few.iter().filter(move |push| push.start <= t && t < push.end());
        few.chain(many.into_iter().map(|push| &self.all[push as usize]))
    }

    /// A bound on the acceleration of any vertex by the pushes that act within `span` [scene unit/s²].
    pub fn bound(&self, span: Span) -> f64 {
        let Some(index) = &self.index else {
            let acting = self.all.iter().filter(|push| push.start < span.end && span.start < push.end());
            return acting.map(|push| push.strength.abs()).sum();
        };
        if index.count_within(span) == 0 {
            return 0.0;
        }
        let begun = index.starts.strengths[index.starts.before(span.end)];
        let over = index.ends.strengths[index.ends.until(span.start)];
        f64::max(0.0, begun - over) + ROUNDING * begun
    }

    /// Appends the times within `span` at which a push begins or ends [s].
    pub fn jumps(&self, span: Span, jumps: &mut Vec<f64>) {
        match &self.index {
            None => {
                let edges = self.all.iter().flat_map(|push| [push.start, push.end()]);
                jumps.extend(edges.filter(|&t| span.holds(t)));
            }
            Some(index) => {
                jumps.extend_from_slice(index.starts.within(span));
                jumps.extend_from_slice(index.ends.within(span));
            }
        }
    }

    /// Memory allocated for the list [bytes].
    pub fn memory(&self) -> usize {
        let index = self
            .index
            .as_ref()
            .map_or(0, |index| index.starts.memory() + index.ends.memory() + size_of_val(&*index.latest_end));
        size_of_val(&*self.all) + index
    }
}

/// The acceleration of each vertex of a body by many pushes.
#[derive(Clone, Debug, Default)]
pub(super) struct PushField {
    /// [scene unit/s²], `[vertex_count]`.
    accelerations: Vectors,
    /// Number of pushes that have begun …
    begun: usize,
    /// … and that have ended.
    ended: usize,
    /// Number of pushes added or subtracted since the sum was last computed from scratch.
    changes: usize,
}

impl PushField {
    /// Updates the accelerations to time `t` [s], not before that of the last call; `facing` are the directions of the
    /// vertices' rest positions. Returns the number of pushes that were summed.
    pub fn advance(&mut self, list: &PushList, facing: &Vectors, t: f64) -> usize {
        let Some(index) = &list.index else { return 0 };
        let (begun, ended) = (index.starts.until(t), index.ends.until(t));
        let [begins, ends] = [self.begun..begun, self.ended..ended];
        let is_first = self.accelerations.len() != facing.len();
        let new = begins.len() + ends.len();
        if new == 0 && !is_first {
            return 0;
        }
        (self.begun, self.ended) = (begun, ended);
        self.changes += new;
        let acting = begun.saturating_sub(ended);
        if is_first || self.changes > acting {
            // costs no more than the changes since the last full sum, and removes the rounding error of subtracted
            // pushes
            self.accelerations.reset(facing.len());
            self.changes = 0;
            let mut summed = 0;
            for push in list.acting(t) {
                self.add(push, 1.0, facing);
                summed += 1;
            }
            return summed;
        }
        for &push in &index.starts.pushes[begins] {
            self.add(&list.all[push as usize], 1.0, facing);
        }
        for &push in &index.ends.pushes[ends] {
            self.add(&list.all[push as usize], -1.0, facing);
        }
        new
    }

    fn add(&mut self, push: &Push, sign: f64, facing: &Vectors) {
        let (d, strength) = (push.direction, sign * push.strength);
        // slices of equal length, so that the loop needs no bounds checks and vectorises
        let n = facing.len();
        let [lx, ly, lz] = [&facing.x[..n], &facing.y[..n], &facing.z[..n]];
        let Vectors { x, y, z } = &mut self.accelerations;
        let [x, y, z] = [&mut x[..n], &mut y[..n], &mut z[..n]];
        for i in 0..n {
            let squarely = -(lx[i] * d.x + ly[i] * d.y + lz[i] * d.z);
            let acts = if squarely > 0.0 { strength * squarely } else { 0.0 };
            x[i] += d.x * acts;
            y[i] += d.y * acts;
            z[i] += d.z * acts;
        }
    }

    /// Writes the accelerations of some vertices to `found`, in this order and padded to a multiple of `lanes`
    /// [scene unit/s²]. Returns the largest.
    pub fn of(&self, vertices: &[u32], lanes: usize, found: &mut Vectors) -> f64 {
        found.reset(vertices.len().next_multiple_of(lanes));
        let mut largest = 0.0;
        for (i, &vertex) in vertices.iter().enumerate() {
            let acceleration = self.accelerations.get(vertex as usize);
            found.set(i, acceleration);
            largest = f64::max(largest, acceleration.length_squared());
        }
        largest.sqrt()
    }

    /// Memory allocated for the field [bytes].
    pub fn memory(&self) -> usize {
        self.accelerations.memory()
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::{scene::Scene, sim::World};

    /// A body beside a sphere, with each push split into several equal parts.
    fn scene(parts: u32, count: usize, length: f64, weight: &str) -> Scene {
        let mut text = format!("duration = 1.5\n[influence]\nweight = \"{weight}\"\n");
        for (name, motion) in
            [("a", "fixed = [0, 0, 0]"), ("b", "line = { from = [2.6, 0, 0], velocity = [-0.4, 0, 0] }")]
        {
            text += &format!("[[body]]\nname = \"{name}\"\nradius = 1.0\nmotion = {{ {motion} }}\n");
        }
        for (i, push) in pushes(count).into_iter().enumerate() {
            for _ in 0..parts {
                let (d, strength, start) = (push.direction, push.strength / f64::from(parts), 0.25 * push.start);
                let duration = if i.is_multiple_of(9) { 0.2 } else { length * push.duration };
                text += &format!(
                    "[[push]]\nbody = \"a\"\ndirection = [{:?}, {:?}, {:?}]\nstrength = {strength:?}\nstart = {start:?}\nduration = {duration:?}\n",
                    d.x, d.y, d.z
                );
            }
        }
        Scene::parse(&text, "pushes.toml").unwrap()
    }

    /// Splitting each push into eight parts, and thereby switching to a push field, changes nothing.
    #[test]
    fn split_pushes_have_the_same_effect() {
        for weight in ["linear", "wendland"] {
            let [mut few, mut many] = [1, 8].map(|parts| World::new(scene(parts, MAX_SHARED, 0.5, weight)).unwrap());
            assert!(!few.bodies[0].pushes.shared().is_empty() && many.bodies[0].pushes.shared().is_empty());
            let (mut moved, mut error): (f64, f64) = (0.0, 0.0);
            while few.steps_taken() < few.scene().steps() {
                assert_eq!(few.step().failure, None);
                assert_eq!(many.step().failure, None);
                for (x, y) in few.body(0).states().displacement.iter().zip(many.body(0).states().displacement.iter()) {
                    (moved, error) = (moved.max(x.length()), error.max(x.distance(y)));
                }
            }
            assert!(moved > 0.05 && error < 1e-7, "{weight}: {moved} {error:e}");
        }
    }

    /// A hundred thousand pushes can be stepped, both short and overlapping: the cost of a step depends only on the
    /// pushes that begin or end in it.
    #[test]
    fn a_hundred_thousand_pushes_are_stepped() {
        for length in [1e-5, 1.0] {
            let mut world = World::new(scene(1, 100_000, length, "linear")).unwrap();
            let start = std::time::Instant::now();
            while world.steps_taken() < 90 {
                assert_eq!(world.step().failure, None);
            }
            println!("{length}: {:?}", start.elapsed());
            assert!(world.body(0).max_displacement() > 0.01);
        }
    }

    fn pushes(count: usize) -> Vec<Push> {
        let number = |i: usize, n: usize| (i * n % 100_003) as f64 / 100_003.0;
        let push = |i| Push {
            body: 0,
            direction: DVec3::new(number(i, 7_919) - 0.5, number(i, 13_007) - 0.5, number(i, 29_009) + 0.1).normalize(),
            strength: 10.0 * number(i, 31_013) - 3.0,
            start: 4.0 * number(i, 17_011),
            duration: if i.is_multiple_of(9) { 0.0 } else { number(i, 43_003) },
        };
        (0..count).map(push).collect()
    }

    /// The index gives the same pushes, times, bounds and accelerations as a linear search.
    #[test]
    fn many_pushes_are_found_like_few() {
        let all = pushes(300);
        let many = PushList::new(all.clone());
        let facing: Vectors =
            (0..50).map(|i| DVec3::new((i as f64).sin(), (i as f64).cos(), 0.3).normalize()).collect();
        let vertices: Vec<u32> = (0..50).rev().collect();
        let (mut field, mut found) = (PushField::default(), Vectors::default());
        for step in 0..500 {
            let t = 0.011 * f64::from(step);
            let span = Span { start: t, end: t + 0.02 };
            let acting: Vec<&Push> = all.iter().filter(|push| push.start <= t && t < push.end()).collect();
            assert!(many.acting(t).eq(acting.iter().copied()), "{t}");
            let within = all.iter().filter(|push| push.start < span.end && span.start < push.end());
            let bound: f64 = within.map(|push| push.strength.abs()).sum();
            assert!((bound..bound + 1e-5).contains(&many.bound(span)), "{t}: {bound} {}", many.bound(span));
            let mut jumps = [Vec::new(), Vec::new()];
            many.jumps(span, &mut jumps[0]);
            jumps[1].extend(all.iter().flat_map(|push| [push.start, push.end()]).filter(|&t| span.holds(t)));
            jumps.iter_mut().for_each(|jumps| jumps.sort_by(f64::total_cmp));
            assert_eq!(jumps[0], jumps[1], "{t}");
            field.advance(&many, &facing, t);
            field.of(&vertices, 16, &mut found);
            assert_eq!(found.len(), 64);
            for (i, &vertex) in vertices.iter().enumerate() {
                let facing = facing.get(vertex as usize);
                let of = |push: &&Push| push.direction * (push.strength * f64::max(0.0, -facing.dot(push.direction)));
                let exact: DVec3 = acting.iter().map(of).sum();
                assert!(found.get(i).distance(exact) < 1e-12, "{t}: {} {exact}", found.get(i));
                assert!(!acting.is_empty() || found.get(i) == DVec3::ZERO);
            }
        }
    }
}
