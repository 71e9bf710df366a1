//! Steps a vertex individually: one that crosses a rim, or needs shorter steps than its body.

use glam::DVec3;
use pulp::Scalar;

use super::{
    course::Course,
    lanes::{LANES, Vector},
    rim::{self, Motion, Rim, Unresolved},
    step::{Collocated, Group, Outcome, Pull, SHORTER, Step, Trajectories, Vertex, is_sampled_aside},
    weights::{Dense, KnownWeights, Stage, Weights},
    work_of,
};
use crate::{
    model::{energy, influence},
    sim::{
        state::{Common, State},
        terms::Sphere,
        work::Tally,
    },
};

/// Steps that a vertex may take in one step of the scene; what is left then is taken in one, unchecked but within bounds.
/// After half of them the acceptable error grows, by a factor of two with each of `DOUBLINGS` equal shares of the others.
pub const MOST_STEPS: u32 = 3072;
const DOUBLINGS: u32 = 32;

/// The work of preparing a step of one vertex, …
const STEP: u64 = 60;
/// … the same by the paths, …
const STEP_EXACTLY: u64 = 400;
/// … of a force on it, which is not found for several side by side, …
const ALONE: u64 = 8;
/// … of looking where it is relative to a rim, by polynomials, …
const LOOK: u64 = 4;
/// … and by the paths.
const LOOK_EXACTLY: u64 = 120;

/// Reused from step to step.
#[derive(Default)]
pub struct Scratch {
    part: Step,
    /// Parts of the interval that are still to be taken, the next one last: where each starts and how long it is [s].
    left: Vec<(f64, f64)>,
    pulls: Vec<Pull>,
    inside: Vec<u64>,
}

/// The spheres that contain a vertex throughout a step, one bit each, if the weight has a kink at their rims. Otherwise the
/// weight is cut off at the rim wherever the vertex is sampled.
type Inside<'a> = Option<&'a [u64]>;

fn is_inside(inside: &[u64], sphere: usize) -> bool {
    inside[sphere / 64] >> (sphere % 64) & 1 == 1
}

/// One by one through an interval.
pub struct Single<'a> {
    /// The body's course.
    pub course: &'a Course<'a>,
    /// The step over all of it.
    pub whole: &'a Step,
    /// What all vertices do alike, at its start.
    pub common: &'a Common,
    /// The largest error that will do, per time [scene unit/s].
    pub tolerance: f64,
    /// Steps that a vertex may take in the interval, see [`MOST_STEPS`].
    pub most_steps: u32,
    /// Bound of the acceleration of a vertex by anything but its oscillator [scene unit/s²].
    pub force: f64,
    /// When it is over, what is left is not done.
    pub work: &'a Tally<'a>,
    /// Steps that were taken beyond the first of each vertex.
    pub substeps: u64,
    /// The largest sum of estimated errors of a vertex [scene unit] …
    pub error: f64,
    /// … and of those beyond the tolerance, where steps could not be made shorter.
    pub excess: f64,
}

impl Single<'_> {
    /// Takes a vertex to the end of the interval, in as many steps as it needs; `outcome` is that of the whole step.
    pub fn take(
        &mut self,
        (vertex, inside): (Vertex, Inside<'_>),
        mut state: State,
        mut outcome: Outcome,
        known: &mut KnownWeights,
        scratch: &mut Scratch,
    ) -> State {
        let course = self.course;
        let Scratch { part, left, pulls, inside: spheres } = scratch;
        let has_kink = inside.is_some();
        spheres.clear();
        spheres.extend_from_slice(inside.unwrap_or_default());
        let (mut start, mut h) = (course.start, course.length);
        let (mut is_whole, mut error, mut excess, mut steps) = (true, 0.0, 0.0, 1);
        // steps longer than this are not worth trying, because one was not accurate enough
        let mut longest = f64::INFINITY;
        left.clear();
        // the sphere at whose rim a step starts, because the one before it ended there
        let mut crossed = None;
        loop {
            let step = if is_whole { self.whole } else { &*part };
            let (middle, end) = (start + 0.5 * h, start + h);
            let wanted = self.wanted(h, steps);
            let inside = has_kink.then_some(&**spheres);
            let resolved = self.resolves_spheres(step, (&vertex, inside), state);
            // written so that NaN is not small enough
            let mut will_do = start >= middle || (outcome.error <= wanted && resolved);
            let mut crossing = None;
            if will_do {
                match self.first_crossing(step, (&vertex, inside), (state, crossed), &outcome) {
                    Ok(found) => crossing = found,
                    // a vertex that swings many times in the step is left to where crossings make no difference
                    Err(Unresolved) => will_do = start >= middle || is_stiff(course, h),
                }
            }
            if !will_do {
                longest = 0.5 * h;
                left.push((start, h));
            } else if let Some((t, sphere)) = crossing {
                // Up to the rim as the step goes, and on from there on its other side.
                crossed = Some(sphere);
                error += outcome.error;
                if t >= end {
                    state = outcome.end;
                } else if t > start {
                    state =
                        Dense::new(course.oscillator(), h, (t - start) / h).state(state, &outcome.forces, outcome.bend);
                }
                spheres[sphere / 64] ^= 1 << (sphere % 64);
                if t < end {
                    left.push((t, end - t));
                }
            } else {
                crossed = None;
                state = outcome.end;
                error += outcome.error;
                // of sixth order: an error of a step that a step of twice the length would not take beyond the tolerance
                let is_easy = SHORTER * outcome.error <= wanted;
                longest = if is_easy { longest.max(2.0 * h) } else { longest };
            }
            if will_do && !(outcome.error <= self.tolerance * h) {
                excess += outcome.error - self.tolerance * h;
            }

            let Some(mut next) = left.pop() else { break };
            while next.1 > longest && next.0 < next.0 + 0.5 * next.1 {
                next.1 *= 0.5;
                left.push((next.0 + next.1, next.1));
            }
            let prepare = if self.whole.smooth { STEP } else { STEP_EXACTLY };
            let forces = ALONE * work_of(1, course.spheres.len(), course.weighted.len());
            if !self.work.spend(prepare + forces) {
                break;
            }
            (start, h) = next;
            is_whole = false;
            steps += 1;
            if steps == self.most_steps {
                let weights = Weights::new(course.oscillator(), course.end() - start, false);
                part.prepare_part(course, self.whole, self.common, start, &weights);
                let held = hold(course, part, &vertex, state);
                error += (held.x - state.x).length();
                excess += (held.x - state.x).length();
                state = held;
                break;
            }
            let is_outside = has_kink && spheres.iter().all(|&word| word == 0);
            outcome = if is_outside && vertex.local == DVec3::ZERO {
                part.prepare_ends(course, self.whole, self.common, start, h);
                free(course, state, h)
            } else {
                // what is left beyond a rim is of no other length again
                let halved = course.length / h == (course.length / h).round();
                let once;
                let is_sampled_aside = is_sampled_aside(course, h, self.tolerance * h);
                let weights = if halved {
                    known.get(course.oscillator(), h, is_sampled_aside)
                } else {
                    once = Weights::new(course.oscillator(), h, is_sampled_aside);
                    &once
                };
                part.prepare_part(course, self.whole, self.common, start, weights);
                let inside = has_kink.then_some(&**spheres);
                collocate(course, part, (&vertex, inside), state, self.wanted(h, steps), pulls)
            };
        }
        self.substeps += u64::from(steps - 1);
        self.error = self.error.max(error);
        self.excess = self.excess.max(excess);
        state
    }

    /// The error that will do for a step of length `h` after so many others [scene unit].
    fn wanted(&self, h: f64, steps: u32) -> f64 {
        let half = self.most_steps / 2;
        self.tolerance * h * 2f64.powi((steps.saturating_sub(half) / (half / DOUBLINGS)) as i32)
    }

    /// How far the vertex can get by itself in a step [scene unit].
    fn travel(&self, h: f64, state: State) -> f64 {
        let omega = self.course.body().material.omega;
        let swing = (state.u.length_squared() + omega * omega * state.x.length_squared()).sqrt();
        let speed = swing + self.force * h;
        f64::min(speed * h, speed * (2.0 / omega))
    }

    /// Spheres whose rim the vertex can cross in a step.
    fn near_rims(&self, step: &Step, vertex: &Vertex, state: State) -> impl Iterator<Item = usize> {
        let moment = &step.moments[0];
        let position = vertex.rest_at(self.course, &moment.pushed) + state.x;
        let (h, course) = (step.h, self.course);
        let travel = self.travel(h, state);
        (0..course.spheres.len()).filter(move |&j| {
            let from_rim = (moment.centres[j] - position).length() - course.spheres[j].radius;
            from_rim.abs() <= travel + step.relative[j].speed * h
        })
    }

    /// Whether the step is short enough not to miss a sphere.
    fn resolves_spheres(&self, step: &Step, (vertex, inside): (&Vertex, Inside<'_>), state: State) -> bool {
        match inside {
            Some(_) => self.resolves_rims(step, vertex, state),
            None => self.passes_no_sphere(step, vertex, state),
        }
    }

    /// Whether the vertex cannot be in a sphere between the nodes of the step and at none of them, unless it is so near
    /// the rim that it feels next to nothing (with the Wendland weight: 4e-8 of the strength).
    fn passes_no_sphere(&self, step: &Step, vertex: &Vertex, state: State) -> bool {
        let moment = &step.moments[0];
        let position = vertex.rest_at(self.course, &moment.pushed) + state.x;
        let travel = self.travel(step.h, state);
        self.course.spheres.iter().zip(&moment.centres).zip(&step.relative).all(|((sphere, centre), bounds)| {
            let way = travel + bounds.speed * step.h;
            way <= sphere.radius || (*centre - position).length() > sphere.radius + way
        })
    }

    /// Whether the step is short enough to see the vertex swing, where it swings about a rim and that matters.
    fn resolves_rims(&self, step: &Step, vertex: &Vertex, state: State) -> bool {
        let h = step.h;
        if !is_stiff(self.course, h) {
            return true;
        }
        let omega = self.course.body().material.omega;
        let constant = f64::min(0.5 * h * h, 2.0 / (omega * omega)); // bounds what a unit force does in the step
        let stiffness: f64 = self.course.spheres.iter().map(|sphere| sphere.strength.abs()).sum();
        let kink = stiffness * self.travel(h, state) * constant;
        kink <= self.tolerance * h || self.near_rims(step, vertex, state).next().is_none()
    }

    /// The first crossing of a rim in a step that was taken: when, and of which sphere. The vertex starts from the rim of
    /// sphere `crossed`, if any.
    fn first_crossing(
        &self,
        step: &Step,
        (vertex, inside): (&Vertex, Inside<'_>),
        (state, crossed): (State, Option<usize>),
        outcome: &Outcome,
    ) -> Result<Option<(f64, usize)>, Unresolved> {
        let Some(inside) = inside else { return Ok(None) };
        let mut near = self.near_rims(step, vertex, state).peekable();
        if near.peek().is_none() {
            return Ok(None);
        }
        let motion = Motion::new(self.course, step, vertex, state, outcome);
        let trajectories = Trajectories { course: self.course, whole: self.whole, common: self.common };
        let mut first: Option<(f64, usize)> = None;
        for j in near {
            let mut looks = rim::MOST_SAMPLES;
            let rim = Rim { sphere: j, is_inside: is_inside(inside, j), is_start: crossed == Some(j) };
            let crossing = motion.crossing(trajectories, step, rim, &mut looks);
            let looks = u64::from(rim::MOST_SAMPLES - looks);
            let look_takes = if self.whole.smooth { LOOK } else { LOOK_EXACTLY + self.course.weighted.len() as u64 };
            if !self.work.spend(looks * look_takes) {
                return Ok(None);
            }
            if let Some(t) = crossing?
                && first.is_none_or(|(before, _)| t < before)
            {
                first = Some((t, j));
            }
        }
        Ok(first)
    }
}

/// Whether a step is too long to see the body's vertices swing.
pub fn is_stiff(course: &Course<'_>, h: f64) -> bool {
    let material = course.body().material;
    (material.omega + 2.0 * material.damping) * h > 1.0
}

/// The end of a step under the force of its start, for a vertex on which no more work can be spent. That force can act, so
/// the end is within all bounds of a motion by such forces. If nothing about the vertex moves, its energy does not grow
/// either; if that cannot be had, it stays where it is.
fn hold(course: &Course<'_>, step: &Step, vertex: &Vertex, state: State) -> State {
    let (Weights { ux, uu, constant, .. }, Stage { xx, xu, .. }) = (step.weights, step.weights.nodes[3]);
    let moment = &step.moments[0];
    let rest = vertex.rest_at(course, &moment.pushed);
    let to_centres = |x: DVec3| moment.centres.iter().map(move |centre| *centre - rest - x);
    let pull = |(sphere, to_centre): (&Sphere, DVec3)| {
        influence::acceleration(course.weight(), sphere.strength, sphere.radius, to_centre)
    };
    let force = vertex.local + course.spheres.iter().zip(to_centres(state.x)).map(pull).sum::<DVec3>();
    let end = State { x: xx * state.x + xu * state.u + constant * force, u: ux * state.x + uu * state.u + xu * force };

    if step.relative.iter().any(|bounds| bounds.speed != 0.0) {
        return end;
    }
    let potential = |x: DVec3| {
        let of_sphere = |(sphere, to_centre): (&Sphere, DVec3)| {
            sphere.strength * energy::influence_potential(course.weight(), sphere.radius, to_centre.length())
        };
        let of_spheres: f64 = course.spheres.iter().zip(to_centres(x)).map(of_sphere).sum();
        energy::elastic(course.oscillator().omega, x.length_squared()) + of_spheres - vertex.local.dot(x)
    };
    let kinetic = energy::kinetic(state.u.length_squared()) + potential(state.x) - potential(end.x);
    // written so that NaN is not enough
    if !(kinetic >= 0.0) {
        return state;
    }
    let slower = f64::min(1.0, (kinetic / energy::kinetic(end.u.length_squared())).sqrt());
    State { x: end.x, u: if slower < 1.0 { slower * end.u } else { end.u } }
}

/// The exact flow of a vertex on which nothing acts.
fn free(course: &Course<'_>, State { x, u }: State, h: f64) -> Outcome {
    let [xx, xu, ux, uu] = course.oscillator().flow(h);
    Outcome {
        end: State { x: xx * x + xu * u, u: ux * x + uu * u },
        forces: [DVec3::ZERO; 4],
        bend: DVec3::ZERO,
        error: 0.0,
    }
}

/// One step of one vertex.
fn collocate(
    course: &Course<'_>,
    step: &Step,
    (vertex, inside): (&Vertex, Inside<'_>),
    state: State,
    wanted: f64,
    pulls: &mut Vec<Pull>,
) -> Outcome {
    pulls.clear();
    for (j, sphere) in course.spheres.iter().enumerate() {
        if inside.is_none_or(|inside| is_inside(inside, j)) {
            pulls.push(Pull { sphere: j, strength: [sphere.strength; LANES], cut: inside.is_none() });
        }
    }
    let simd = Scalar;
    let [rest, local, x, u] = [vertex.rest, vertex.local, state.x, state.u].map(|vector| Vector::splat(simd, vector));
    let end = if course.weighted.is_empty() {
        Group::<_, 1, 1>::new(simd, course, step, rest, local, pulls).collocate(x, u, wanted)
    } else {
        Group::<_, 1, 6>::new(simd, course, step, rest, local, pulls).collocate(x, u, wanted)
    };
    let Collocated { x, u, forces, bend, error } = end;
    Outcome {
        end: State { x: first(x), u: first(u) },
        forces: forces.map(first),
        bend: first(bend),
        error: {
            let mut only = [0.0];
            error.store(&mut only, 0);
            only[0]
        },
    }
}

/// The vector of the only lane.
fn first(vector: Vector<Scalar, 1>) -> DVec3 {
    let mut only = [[0.0]; 3];
    for (axis, value) in only.iter_mut().zip([vector.x, vector.y, vector.z]) {
        value.store(axis, 0);
    }
    DVec3::new(only[0][0], only[1][0], only[2][0])
}
