//! Steps a vertex individually: one that needs shorter steps than its body, or crosses a rim.

use glam::DVec3;
use pulp::Scalar;

use super::{
    course::Course,
    rim::{self, Motion, Rim, Unresolved},
    step::{Collocated, Group, Moment, Outcome, Pull, Step, Trajectories, Vertex},
    weights::{BEND_ASIDE, KnownWeights, Residual, Stage, Weights},
    work_of,
};
use crate::{
    model::{energy, influence},
    sim::{
        numerics::{
            control::{ASIDE, RESOLVED, SHORTER},
            dense::Dense,
            lanes::{LANES, Reals, Vector},
        },
        state::State,
        terms::Sphere,
        work::Tally,
    },
};

/// Upper limit on the steps of a vertex in one step of the world. The rest is then taken in a single step, unchecked
/// but bounded. After half of them the acceptable error grows: it doubles with each of `DOUBLINGS` equal shares of the
/// others.
pub const MAX_STEPS: u32 = 3072;
const DOUBLINGS: u32 = 32;

/// Work of preparing a step of one vertex by polynomials [units].
const STEP: u64 = 60;
/// Work of the same by the paths [units].
const STEP_EXACTLY: u64 = 400;
/// Ratio of the work of forces on a single vertex to that of forces evaluated side by side.
const ALONE: u64 = 8;
/// Work of a sample of a vertex's position relative to a rim, by polynomials [units].
const SAMPLE: u64 = 4;
/// Work of the same by the paths [units].
const SAMPLE_EXACTLY: u64 = 120;

/// Buffers, reused from step to step.
#[derive(Default)]
pub struct Scratch {
    part: Step,
    /// Remaining parts of the interval as (start, length) [s], the next one last.
    left: Vec<(f64, f64)>,
    pulls: Vec<Pull>,
    inside: Vec<u64>,
    aside: Moment,
}

/// The spheres that contain a vertex throughout a step, one bit each, if the weight has a kink at their rims. Otherwise the
/// weight is cut off at the rim wherever the vertex is sampled.
type Inside<'a> = Option<&'a [u64]>;

fn is_inside(inside: &[u64], sphere: usize) -> bool {
    inside[sphere / 64] >> (sphere % 64) & 1 == 1
}

/// A vertex at the start of one of its steps.
#[derive(Clone, Copy)]
struct Start<'a> {
    vertex: &'a Vertex,
    /// The spheres that it is inside of.
    inside: Inside<'a>,
    state: State,
    /// The sphere at whose rim the step starts because the previous one ended there.
    crossed: Option<usize>,
}

/// Steps vertices individually through an interval.
pub struct Single<'a> {
    /// The body's course.
    pub course: &'a Course<'a>,
    /// The step over the whole interval.
    pub whole: &'a Step,
    /// The shared response of all vertices at its start.
    pub carried: State,
    /// The largest acceptable error per unit of time [scene unit/s].
    pub tolerance: f64,
    /// Upper limit on the steps of a vertex in the interval, see [`MAX_STEPS`].
    pub max_steps: u32,
    /// Bound on the acceleration of a vertex by anything but its oscillator [scene unit/s²].
    pub force: f64,
    /// The work budget; once it is exhausted, the rest of the step is not computed.
    pub work: &'a Tally<'a>,
    /// Number of steps beyond the first of each vertex.
    pub substeps: u64,
    /// The largest sum of estimated errors of a vertex [scene unit].
    pub error: f64,
    /// The largest sum of their parts beyond the tolerance, where steps could not be made shorter [scene unit].
    pub excess: f64,
}

impl Single<'_> {
    /// Advances a vertex to the end of the interval, in as many steps as it needs; `outcome` is the result of the whole
    /// step.
    pub fn advance(
        &mut self,
        vertex: &Vertex,
        inside: Inside<'_>,
        mut state: State,
        mut outcome: Outcome,
        known: &mut KnownWeights,
        scratch: &mut Scratch,
    ) -> State {
        let course = self.course;
        let Scratch { part, left, pulls, inside: spheres, aside } = scratch;
        let has_kink = inside.is_some();
        spheres.clear();
        spheres.extend_from_slice(inside.unwrap_or_default());
        let (mut start, mut h) = (course.start, course.length);
        let (mut is_whole, mut error, mut excess, mut steps) = (true, 0.0, 0.0, 1);
        // steps longer than this are not worth trying, because one was not accurate enough
        let mut longest = f64::INFINITY;
        left.clear();
        let mut crossed = None;
        loop {
            let step = if is_whole { self.whole } else { &*part };
            let (middle, end) = (start + 0.5 * h, start + h);
            let wanted = self.wanted(h, steps);
            let from = Start { vertex, inside: has_kink.then_some(&**spheres), state, crossed };
            let resolved = self.resolves_spheres(step, from);
            // written so that NaN is rejected
            let mut is_accepted = start >= middle || (outcome.error <= wanted && resolved);
            let mut crossing = None;
            if is_accepted {
                match self.first_crossing(step, from, &outcome) {
                    Ok(found) => crossing = found,
                    // a vertex that oscillates many times in the step gets here only where crossings make no difference
                    Err(Unresolved) => is_accepted = start >= middle || is_stiff(course, h),
                }
            }
            if !is_accepted {
                longest = 0.5 * h;
                left.push((start, h));
            } else if let Some((t, sphere)) = crossing {
                // Keep the step up to the rim, and continue from there on the other side.
                crossed = Some(sphere);
                error += outcome.error;
                if t >= end {
                    state = outcome.end;
                } else if t > start {
                    state = self.within(step, from, &outcome, (t - start) / h, aside);
                }
                spheres[sphere / 64] ^= 1 << (sphere % 64);
                if t < end {
                    left.push((t, end - t));
                }
            } else {
                crossed = None;
                state = outcome.end;
                error += outcome.error;
                // at sixth order, a step of twice the length would still meet the tolerance
                let is_easy = SHORTER * outcome.bent <= wanted && outcome.error <= wanted;
                longest = if is_easy { longest.max(2.0 * h) } else { longest };
            }
            if is_accepted && !(outcome.error <= self.tolerance * h) {
                excess += outcome.error - self.tolerance * h;
            }

            let Some(mut next) = left.pop() else { break };
            while next.1 > longest && next.0 < next.0 + 0.5 * next.1 {
                next.1 *= 0.5;
                left.push((next.0 + next.1, next.1));
            }
            let prepare = if self.whole.smooth { STEP } else { STEP_EXACTLY };
            let forces = ALONE * work_of(1, course.spheres.len());
            if !self.work.spend(prepare + forces) {
                break;
            }
            (start, h) = next;
            is_whole = false;
            steps += 1;
            if steps == self.max_steps {
                let weights = Weights::new(course.oscillator(), course.end() - start);
                part.prepare_part(self.trajectories(), start, &weights);
                let held = hold(course, part, vertex, state);
                error += (held.x - state.x).length();
                excess += (held.x - state.x).length();
                state = held;
                break;
            }
            let is_outside = has_kink && spheres.iter().all(|&word| word == 0);
            outcome = if is_outside && vertex.local == DVec3::ZERO {
                part.prepare_ends(self.trajectories(), start, h);
                coast(course, state, h)
            } else {
                // the length of the part beyond a rim does not recur, so its weights are not cached
                let once;
                let weights = if course.length / h == (course.length / h).round() {
                    known.get(course.oscillator(), h)
                } else {
                    once = Weights::new(course.oscillator(), h);
                    &once
                };
                part.prepare_part(self.trajectories(), start, weights);
                let from = Start { vertex, inside: has_kink.then_some(&**spheres), state, crossed };
                collocate(course, part, from, self.wanted(h, steps), pulls)
            };
        }
        self.substeps += u64::from(steps - 1);
        self.error = self.error.max(error);
        self.excess = self.excess.max(excess);
        state
    }

    /// The state at `theta` of a step that reaches a rim; `aside` is a buffer.
    fn within(
        &self,
        step: &Step,
        Start { vertex, inside, state, .. }: Start<'_>,
        Outcome { forces, bend, .. }: &Outcome,
        theta: f64,
        aside: &mut Moment,
    ) -> State {
        let (course, inside) = (self.course, inside.unwrap_or_default());
        let State { mut x, mut u } = Dense::new(course.oscillator(), step.h, theta).state(state, forces);
        if inside.iter().all(|&word| word == 0) {
            return State { x, u }; // the force is constant
        }
        self.trajectories().sample_at(step.start + ASIDE * step.h, aside);
        let displaced = Dense::new(course.oscillator(), step.h, ASIDE).state(state, forces).x;
        let position = vertex.rest + displaced;
        let mut found = vertex.local;
        for (j, sphere) in course.spheres.iter().enumerate().filter(|&(j, _)| is_inside(inside, j)) {
            let to_centre = aside.centres[j] - position;
            let weight = course.weight().inside(to_centre.length() * sphere.inverse_radius);
            found += (sphere.strength * weight) * to_centre;
        }
        let Weights { polynomial_aside: [w0, w1, w2, w3], .. } = step.weights;
        let cubic = (w0 * forces[0] + w1 * forces[1]) + (w2 * forces[2] + w3 * forces[3]);
        let Residual { bend_x, bend_u, skew_u } = Residual::new(course.oscillator(), step.h, theta);
        x += bend_x * *bend;
        u += bend_u * *bend + skew_u * (found - cubic - BEND_ASIDE * *bend);
        State { x, u }
    }

    /// The positions of the spheres relative to vertices in the interval.
    fn trajectories(&self) -> Trajectories<'_> {
        Trajectories { course: self.course, whole: self.whole, carried: self.carried }
    }

    /// The acceptable error of a step of length `h` [s] that is the `steps`-th [scene unit].
    fn wanted(&self, h: f64, steps: u32) -> f64 {
        let half = self.max_steps / 2;
        self.tolerance * h * 2f64.powi((steps.saturating_sub(half) / (half / DOUBLINGS)) as i32)
    }

    /// Bound on the distance that the vertex moves by itself in a step of length `h` [s] [scene unit].
    fn travel(&self, h: f64, state: State) -> f64 {
        let omega = self.course.material.omega;
        let swing = (state.u.length_squared() + omega * omega * state.x.length_squared()).sqrt();
        let speed = swing + self.force * h;
        f64::min(speed * h, speed * (2.0 / omega))
    }

    /// Spheres whose rim the vertex can cross in a step.
    fn near_rims(&self, step: &Step, vertex: &Vertex, state: State) -> impl Iterator<Item = usize> {
        let moment = &step.moments[0];
        let position = vertex.rest + state.x;
        let (h, course) = (step.h, self.course);
        let travel = self.travel(h, state);
        (0..course.spheres.len()).filter(move |&j| {
            let from_rim = (moment.centres[j] - position).length() - course.spheres[j].radius;
            from_rim.abs() <= travel + step.relative[j].speed * h
        })
    }

    /// Whether the step is short enough not to miss a sphere.
    fn resolves_spheres(&self, step: &Step, Start { vertex, inside, state, .. }: Start<'_>) -> bool {
        match inside {
            Some(_) => self.resolves_rims(step, vertex, state),
            None => self.passes_no_sphere(step, vertex, state),
        }
    }

    /// Whether the vertex cannot pass through a sphere between the nodes of the step, except so near the rim that the
    /// force is negligible (with the Wendland weight: 4e-8 of the strength).
    fn passes_no_sphere(&self, step: &Step, vertex: &Vertex, state: State) -> bool {
        let moment = &step.moments[0];
        let position = vertex.rest + state.x;
        let travel = self.travel(step.h, state);
        self.course.spheres.iter().zip(&moment.centres).zip(&step.relative).all(|((sphere, centre), bounds)| {
            let reach = travel + bounds.speed * step.h;
            reach <= sphere.radius || (*centre - position).length() > sphere.radius + reach
        })
    }

    /// Whether the step is short enough to resolve the vertex's oscillation, if that is about a rim and matters.
    fn resolves_rims(&self, step: &Step, vertex: &Vertex, state: State) -> bool {
        let h = step.h;
        if !is_stiff(self.course, h) {
            return true;
        }
        let omega = self.course.material.omega;
        let constant = f64::min(0.5 * h * h, 2.0 / (omega * omega)); // bounds the displacement by a unit force
        let stiffness: f64 = self.course.spheres.iter().map(|sphere| sphere.strength.abs()).sum();
        let kink = stiffness * self.travel(h, state) * constant;
        kink <= self.tolerance * h || self.near_rims(step, vertex, state).next().is_none()
    }

    /// The first crossing of a rim in a completed step: its time [s] and the sphere.
    fn first_crossing(
        &self,
        step: &Step,
        Start { vertex, inside, state, crossed }: Start<'_>,
        outcome: &Outcome,
    ) -> Result<Option<(f64, usize)>, Unresolved> {
        let Some(inside) = inside else { return Ok(None) };
        let mut near = self.near_rims(step, vertex, state).peekable();
        if near.peek().is_none() {
            return Ok(None);
        }
        let motion = Motion::new(self.course, step, vertex, state, outcome);
        let mut first: Option<(f64, usize)> = None;
        for j in near {
            let mut samples_left = rim::MAX_SAMPLES;
            let rim = Rim { sphere: j, is_inside: is_inside(inside, j), is_start: crossed == Some(j) };
            let crossing = motion.crossing(self.trajectories(), step, rim, &mut samples_left);
            let samples = u64::from(rim::MAX_SAMPLES - samples_left);
            let work_of_sample = if self.whole.smooth { SAMPLE } else { SAMPLE_EXACTLY };
            if !self.work.spend(samples * work_of_sample) {
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

/// Whether a step is too long to resolve the oscillation of the body's vertices.
pub fn is_stiff(course: &Course<'_>, h: f64) -> bool {
    let material = course.material;
    (material.omega + 2.0 * material.damping) * h > RESOLVED
}

/// The end of a step under the constant force at its start, for a vertex that has used up its steps. That force
/// is possible, so the end is within all bounds on motion under such forces. If no sphere moves relative to the
/// shared motion, the energy of the vertex does not grow either; where that is impossible, its state stays as it is.
fn hold(course: &Course<'_>, step: &Step, vertex: &Vertex, state: State) -> State {
    let (Weights { ux, uu, constant, .. }, Stage { xx, xu, .. }) = (step.weights, step.weights.nodes[3]);
    let moment = &step.moments[0];
    let to_centres = |x: DVec3| moment.centres.iter().map(move |centre| *centre - vertex.rest - x);
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
    // written so that NaN is rejected
    if !(kinetic >= 0.0) {
        return state;
    }
    let slower = f64::min(1.0, (kinetic / energy::kinetic(end.u.length_squared())).sqrt());
    State { x: end.x, u: if slower < 1.0 { slower * end.u } else { end.u } }
}

/// The exact flow of a vertex on which nothing acts.
fn coast(course: &Course<'_>, State { x, u }: State, h: f64) -> Outcome {
    let [xx, xu, ux, uu] = course.oscillator().flow(h);
    Outcome {
        end: State { x: xx * x + xu * u, u: ux * x + uu * u },
        forces: [DVec3::ZERO; 4],
        bend: DVec3::ZERO,
        error: 0.0,
        bent: 0.0,
    }
}

/// One step of one vertex.
fn collocate(
    course: &Course<'_>,
    step: &Step,
    Start { vertex, inside, state, .. }: Start<'_>,
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
    let end = Group::<_, 1> { simd, course, step, rest, local, pulls }.collocate(x, u, wanted);
    let Collocated { x, u, forces, bend, error, bent } = end;
    let only = |values: Reals<Scalar, 1>| {
        let mut only = [0.0];
        values.store(&mut only, 0);
        only[0]
    };
    Outcome {
        end: State { x: first(x), u: first(u) },
        forces: forces.map(first),
        bend: first(bend),
        error: only(error),
        bent: only(bent),
    }
}

/// The vector in the only lane.
fn first(vector: Vector<Scalar, 1>) -> DVec3 {
    let mut only = [[0.0]; 3];
    for (axis, value) in only.iter_mut().zip([vector.x, vector.y, vector.z]) {
        value.store(axis, 0);
    }
    DVec3::new(only[0][0], only[1][0], only[2][0])
}
