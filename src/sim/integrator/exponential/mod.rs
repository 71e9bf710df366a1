//! The exponential integrator: the oscillator's flow is exact, only the force is approximated, as closely as wanted.
//!
//! | what | where |
//! | --- | --- |
//! | what acts on a body over a stretch of time | [`course`] |
//! | the weights of a step, from the oscillator's φ-functions | [`weights`] |
//! | one step of a few vertices side by side, and the error it makes | [`step`], [`lanes`] |
//! | when a vertex crosses the rim of a sphere | [`rim`] |
//!
//! [`advance`] takes a body over a stretch in which nothing jumps. A vertex out of every sphere's reach moves by the
//! flow, to which its body's own motion and a push add the same response for all. A vertex in reach takes a step, and
//! takes it again in halves as long as it would make too large an error; where it crosses a rim, at which the linear
//! weight has a kink, its step ends and another begins.

pub mod course;
pub mod lanes;
pub mod rim;
pub mod step;
pub mod weights;

use glam::DVec3;

use super::State;
use crate::sim::arrays::Vectors;
use course::Course;
use rim::Motion;
use step::{Step, Vertex};
use weights::Weights;

/// Vertices that step side by side.
const LANES: usize = 4;
/// Steps that a vertex may take in one stretch; what is left then is taken in one, unchecked but stable.
const MOST_STEPS: u32 = 1024;
/// Halvings of a body's stretch for the sake of its own motion.
const MOST_HALVINGS: u32 = 10;
/// Lengths of step whose weights are kept.
const MOST_WEIGHTS: usize = 24;

/// Reused from step to step.
#[derive(Default)]
pub struct Scratch {
    whole: Step,
    part: Step,
    /// Parts of the stretch that a vertex still has to take, the next one last: where each starts and how long it is [s].
    left: Vec<(f64, f64)>,
    /// Weights of steps of a few lengths.
    known: Vec<Weights>,
    /// Per sphere, the square of the distance from its centre beyond which a vertex stays out of it.
    out_of_reach: Vec<f64>,
    /// Per vertex, by how much the square of its distance from any centre exceeds that.
    margin: Vec<f64>,
    /// The vertices that are, with their states at the start of the stretch.
    in_reach: Vec<(usize, State)>,
}

/// What it took.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Effort {
    /// Steps: one a body and stretch, and those that single vertices took beyond it.
    pub substeps: u64,
    /// The largest sum of estimated errors of a vertex [scene unit].
    pub error: f64,
}

/// The vertices of a body.
pub struct Vertices<'a> {
    /// Unit rest positions [–], `[vertex_count]`.
    pub unit: &'a Vectors,
    /// Displacements [scene unit], `[vertex_count]`.
    pub displacement: &'a mut Vectors,
    /// Velocities [scene unit/s], `[vertex_count]`.
    pub velocity: &'a mut Vectors,
    /// A bound of √(|u|² + ω²|x|²) over the vertices [scene unit/s]; kept up to date.
    pub momentum: f64,
}

/// Advances all vertices of a body over `course`, making no larger error than `tolerance` [scene unit/s].
pub fn advance(course: &Course<'_>, tolerance: f64, vertices: &mut Vertices<'_>, scratch: &mut Scratch) -> Effort {
    let mut effort = Effort::default();
    halve(course, tolerance, vertices, scratch, MOST_HALVINGS, &mut effort);
    effort
}

/// [`advance`], in halves as long as the body's own motion is not resolved.
fn halve(
    course: &Course<'_>,
    tolerance: f64,
    vertices: &mut Vertices<'_>,
    scratch: &mut Scratch,
    halvings: u32,
    effort: &mut Effort,
) {
    let h = course.length;
    let weights = scratch.weights(course, h);
    scratch.whole.prepare(course, course.start, weights);
    let carry_error = carry_error(&scratch.whole);
    let middle = course.start + 0.5 * h;
    if carry_error > tolerance * h && halvings > 0 && course.start < middle {
        for start in [course.start, middle] {
            let half = Course { start, length: 0.5 * h, ..*course };
            halve(&half, tolerance, vertices, scratch, halvings - 1, effort);
        }
        return;
    }
    let Vertices { unit, displacement, velocity, momentum } = vertices;
    let radius = course.body().radius;
    let mut stretch = Stretch::new(course, tolerance, *momentum, scratch);
    // Those in reach step by step, from the state that they have now; the flow is for all, and wasted on few.
    let mut in_reach = std::mem::take(&mut stretch.scratch.in_reach);
    in_reach.clear();
    stretch.find_in_reach(radius, unit, displacement, |i| {
        in_reach.push((i, State { x: displacement.get(i), u: velocity.get(i) }));
    });
    stretch.flow(unit, displacement, velocity);
    for group in in_reach.chunks(LANES) {
        // A group that is not full is filled up with its last vertex.
        let members: [(usize, State); LANES] = std::array::from_fn(|lane| group[lane.min(group.len() - 1)]);
        let vertices = members.map(|(i, state)| {
            let rest = radius * unit.get(i);
            Vertex { rest, push: course.push(unit.get(i)), inside: stretch.spheres_around(rest + state.x) }
        });
        let ends = stretch.take_together(&vertices, &members.map(|(_, state)| state));
        for (&(i, _), end) in group.iter().zip(ends) {
            displacement.set(i, end.x);
            velocity.set(i, end.u);
        }
    }
    stretch.scratch.in_reach = in_reach;
    *momentum += stretch.force * h;
    effort.substeps += 1 + stretch.effort.substeps;
    effort.error += carry_error.max(stretch.effort.error);
}

/// The error that taking the carry as a cubic makes [scene unit]; see [`Step::take`].
fn carry_error(step: &Step) -> f64 {
    let weights = &step.weights;
    let cubic: DVec3 = (0..4).map(|node| weights.polynomial[node] * step.moments[node].carry).sum();
    let gain = weights.constant.abs() + weights.h * weights.swing;
    0.1 * (step.moments[4].carry - cubic).length() * gain
}

impl Scratch {
    /// The weights of a step of length `h`; those of a few lengths are kept.
    fn weights(&mut self, course: &Course<'_>, h: f64) -> Weights {
        if let Some(known) = self.known.iter().find(|known| known.h == h) {
            return *known;
        }
        let weights = Weights::new(course.oscillator(), h);
        if self.known.len() < MOST_WEIGHTS {
            self.known.push(weights);
        }
        weights
    }
}

/// A body on its course, vertex by vertex.
struct Stretch<'a> {
    course: &'a Course<'a>,
    scratch: &'a mut Scratch,
    tolerance: f64,
    stiffness: f64,
    /// Bound of the acceleration of a vertex by anything but its oscillator [scene unit/s²].
    force: f64,
    /// Response of every vertex to the body's own motion.
    carried: State,
    effort: Effort,
}

impl<'a> Stretch<'a> {
    fn new(course: &'a Course<'a>, tolerance: f64, momentum: f64, scratch: &'a mut Scratch) -> Stretch<'a> {
        let Scratch { whole: step, out_of_reach, .. } = scratch;
        let weights = &step.weights;
        let response = |w: &[f64; 4]| -(0..4).map(|node| w[node] * step.moments[node].carry).sum::<DVec3>();
        let carried = State { x: response(&weights.nodes[3].force), u: response(&weights.velocity) };
        let carry = step.moments.iter().map(|moment| moment.carry.length()).fold(0.0, f64::max);
        let push: f64 = course.pushes.iter().map(|push| push.strength.abs()).sum();
        let h = weights.h;
        let travelled = travel(course, momentum + (carry + push) * h, h);
        out_of_reach.clear();
        out_of_reach.extend(
            (0..course.spheres.len())
                .map(|j| (course.spheres[j].radius + travelled + step.relative[j].speed * h).powi(2)),
        );
        Stretch {
            stiffness: course.stiffness(),
            force: course.strongest_pull() + carry + push,
            course,
            tolerance,
            carried,
            effort: Effort::default(),
            scratch,
        }
    }

    /// Tells of every vertex that can get into a sphere in the stretch.
    fn find_in_reach(&mut self, radius: f64, unit: &Vectors, displacement: &Vectors, mut found: impl FnMut(usize)) {
        let Scratch { whole, out_of_reach, margin, .. } = &mut *self.scratch;
        margin.clear();
        margin.resize(unit.len(), f64::INFINITY);
        let (l, x) = (unit, displacement);
        for (centre, &far) in whole.moments[0].centres.iter().zip(&*out_of_reach) {
            // slices of one length, so that the loop below has no bounds to check and is vectorised
            let n = margin.len();
            let (lx, ly, lz) = (&l.x[..n], &l.y[..n], &l.z[..n]);
            let (xx, xy, xz) = (&x.x[..n], &x.y[..n], &x.z[..n]);
            for i in 0..n {
                let dx = centre.x - radius * lx[i] - xx[i];
                let dy = centre.y - radius * ly[i] - xy[i];
                let dz = centre.z - radius * lz[i] - xz[i];
                let beyond = dx * dx + dy * dy + dz * dz - far;
                margin[i] = if margin[i] < beyond { margin[i] } else { beyond };
            }
        }
        for (i, margin) in margin.iter().enumerate() {
            if *margin <= 0.0 || margin.is_nan() {
                found(i);
            }
        }
    }

    /// The exact flow of every vertex, with the response to the body's own motion and to pushes: what happens to those
    /// out of reach.
    fn flow(&self, unit: &Vectors, displacement: &mut Vectors, velocity: &mut Vectors) {
        let weights = &self.scratch.whole.weights;
        let (xx, xu) = (weights.nodes[3].xx, weights.nodes[3].xu);
        let (ux, uu) = (weights.ux, weights.uu);
        let axes = [
            (&mut displacement.x, &mut velocity.x, self.carried.x.x, self.carried.u.x),
            (&mut displacement.y, &mut velocity.y, self.carried.x.y, self.carried.u.y),
            (&mut displacement.z, &mut velocity.z, self.carried.x.z, self.carried.u.z),
        ];
        for (displacement, velocity, carried_x, carried_u) in axes {
            for (x, u) in displacement.iter_mut().zip(velocity) {
                (*x, *u) = (xx * *x + xu * *u + carried_x, ux * *x + uu * *u + carried_u);
            }
        }
        if !self.course.pushes.is_empty() {
            for i in 0..unit.len() {
                let push = self.course.push(unit.get(i));
                displacement.set(i, displacement.get(i) + weights.constant * push);
                velocity.set(i, velocity.get(i) + xu * push);
            }
        }
    }

    /// Takes vertices in reach to the end of the stretch: in one step together, and those for which that will not do
    /// one by one.
    fn take_together(&mut self, vertices: &[Vertex; LANES], states: &[State; LANES]) -> [State; LANES] {
        let step = &self.scratch.whole;
        let wanted = self.tolerance * self.course.length;
        let outcomes = step.take(self.course, vertices, states, self.stiffness, wanted);
        std::array::from_fn(|lane| {
            let (vertex, state, outcome) = (&vertices[lane], states[lane], &outcomes[lane]);
            let step = &self.scratch.whole;
            let crosses = |inside| self.first_crossing(step, vertex, inside, state, outcome).is_some();
            let will_do = outcome.error <= wanted
                && vertex.inside.is_none_or(|inside| self.resolves_rims(step, vertex, state) && !crosses(inside));
            if !will_do {
                return self.take_steps(*vertex, state);
            }
            self.effort.error = self.effort.error.max(outcome.error);
            outcome.end
        })
    }

    /// Takes a vertex in reach to the end of the stretch, in as many steps as it needs.
    fn take_steps(&mut self, mut vertex: Vertex, mut state: State) -> State {
        let course = self.course;
        let mut error = 0.0;
        let mut steps = 0;
        self.scratch.left.clear();
        self.scratch.left.push((course.start, course.length));
        while let Some((start, h)) = self.scratch.left.pop() {
            let (middle, end) = (start + 0.5 * h, start + h);
            steps += 1;
            let can_halve = steps < MOST_STEPS && start < middle;
            if steps == MOST_STEPS {
                vertex.inside = None; // no more looking for rims: the force is cut off, and so bounded
            }
            let whole = h == course.length;
            if !whole {
                let weights = self.scratch.weights(course, h);
                self.scratch.part.prepare(course, start, weights);
            }
            let step = if whole { &self.scratch.whole } else { &self.scratch.part };
            let wanted = self.tolerance * h;
            let [outcome] = step.take(course, &[vertex], &[state], self.stiffness, wanted);
            let resolved = vertex.inside.is_none() || self.resolves_rims(step, &vertex, state);
            // written so that what is not a number is not small enough
            if can_halve && !(outcome.error <= wanted && resolved) {
                self.scratch.left.extend([(middle, 0.5 * h), (start, 0.5 * h)]);
                continue;
            }
            let crossing = vertex.inside.and_then(|inside| self.first_crossing(step, &vertex, inside, state, &outcome));
            match crossing {
                Some((t, sphere)) if t < end => {
                    // Take the step up to the rim, and go on from there on its other side.
                    if t > start {
                        let weights = Weights::new(course.oscillator(), t - start);
                        self.scratch.part.prepare(course, start, weights);
                        let part = &self.scratch.part;
                        let [outcome] = part.take(course, &[vertex], &[state], self.stiffness, wanted);
                        state = outcome.end;
                        error += outcome.error;
                    }
                    vertex.inside = vertex.inside.map(|inside| inside ^ 1 << sphere);
                    self.scratch.left.push((t, end - t));
                }
                _ => {
                    state = outcome.end;
                    error += outcome.error;
                    if let Some((_, sphere)) = crossing {
                        vertex.inside = vertex.inside.map(|inside| inside ^ 1 << sphere);
                    }
                }
            }
        }
        self.effort.substeps += u64::from(steps - 1);
        self.effort.error = self.effort.error.max(error);
        state
    }

    /// Which spheres the position is inside of, a bit each; `None` if the weight has no kink at the rim.
    fn spheres_around(&self, position: DVec3) -> Option<u64> {
        let centres = &self.scratch.whole.moments[0].centres;
        let is_inside = |j: usize| (centres[j] - position).length_squared() < self.course.spheres[j].radius.powi(2);
        step::has_kink(self.course.weight())
            .then(|| (0..centres.len().min(64)).filter(|&j| is_inside(j)).fold(0, |inside, j| inside | 1 << j))
    }

    /// How far the vertex can get by itself in a step [scene unit].
    fn travel(&self, step: &Step, state: State) -> f64 {
        let omega = self.course.body().material.omega;
        let momentum = (state.u.length_squared() + omega * omega * state.x.length_squared()).sqrt();
        travel(self.course, momentum + self.force * step.weights.h, step.weights.h)
    }

    /// Spheres whose rim the vertex can cross in a step.
    fn near_rims(&self, step: &Step, vertex: &Vertex, state: State) -> impl Iterator<Item = usize> {
        let (course, position) = (self.course, vertex.rest + state.x);
        let travel = self.travel(step, state);
        (0..course.spheres.len().min(64)).filter(move |&j| {
            let from_rim = (step.moments[0].centres[j] - position).length() - course.spheres[j].radius;
            from_rim.abs() <= travel + step.relative[j].speed * step.weights.h
        })
    }

    /// Whether the step is short enough to see the vertex swing, where it swings about a rim and that matters.
    fn resolves_rims(&self, step: &Step, vertex: &Vertex, state: State) -> bool {
        let material = self.course.body().material;
        let h = step.weights.h;
        if (material.omega + 2.0 * material.damping) * h <= 1.0 {
            return true;
        }
        let kink = self.stiffness * self.travel(step, state) * step.weights.constant.abs();
        kink <= self.tolerance * h || self.near_rims(step, vertex, state).next().is_none()
    }

    /// The first crossing of a rim in a step that was taken: when, and of which sphere.
    fn first_crossing(
        &self,
        step: &Step,
        vertex: &Vertex,
        inside: u64,
        state: State,
        outcome: &step::Outcome,
    ) -> Option<(f64, usize)> {
        let mut near = self.near_rims(step, vertex, state).peekable();
        near.peek()?;
        let motion = Motion::new(step, vertex.rest, self.course.oscillator(), state, outcome);
        near.filter_map(|j| Some((motion.crossing(self.course, step, j, inside >> j & 1 == 1)?, j)))
            .min_by(|a, b| a.0.total_cmp(&b.0))
    }
}

/// How far a vertex can get within `h` [s] whose √(|u|² + ω²|x|²) stays below `momentum` [scene unit/s]: that is as fast
/// as it moves, and over ω as far from rest as it gets.
fn travel(course: &Course<'_>, momentum: f64, h: f64) -> f64 {
    f64::min(momentum * h, 2.0 * momentum / course.body().material.omega)
}
