//! The exponential integrator: the oscillator's flow is exact; only the force is approximated, to a given tolerance.
//!
//! | contents | module |
//! | --- | --- |
//! | forces on a body over an interval, and the motion that all its vertices share | [`course`] |
//! | the weights of a step, from the oscillator's φ-functions | [`weights`] |
//! | one step of several vertices side by side, and its error | [`step`], `sim::numerics::lanes` |
//! | a step of all vertices near a sphere | [`together`] |
//! | a vertex that needs shorter steps, or crosses a rim | [`single`], [`rim`] |
//!
//! [`advance`] takes a body over an interval without jumps. The effect of its own motion and of pushes on all vertices
//! is a few numbers. A vertex near a sphere takes one step; if the error is too large, the step is repeated in halves.
//! If this happens to many vertices of a body, all of its vertices take shorter steps from then on, side by side. Where
//! a vertex crosses a rim, at which the linear weight has a kink, its step ends and another begins. All other vertices
//! are left to the exact flow, which advances them to the time at which they are next needed.

pub mod course;
pub mod rim;
pub mod single;
pub mod step;
pub mod together;
pub mod weights;

use pulp::Arch;

use crate::sim::{prescribed::deformation::ActiveSet, state::State, work::Tally};
use course::Course;
use single::Single;
use step::{Outcome, Pull, Step, Vertex};
use together::{BEND, FORCES, Outcomes, START, Together};
use weights::KnownWeights;

/// Upper limit on the halvings of a body's interval for its own motion, and on those for its vertices.
const MAX_HALVINGS: u32 = 10;
/// Number of steps that a vertex may always take, however short the step of all vertices is.
const MIN_STEPS: u32 = 128;
/// All vertices of a body take steps of half the length if longer ones fail for more than one in this many, and of twice the
/// length if these would fail for fewer than half of that: a vertex that is stepped alone costs about this many times as much.
const MANY: u64 = 32;

/// Buffers, reused from step to step.
#[derive(Default)]
pub struct Scratch {
    whole: Step,
    pulls: Vec<Pull>,
    outcomes: Outcomes,
    inside: Vec<u64>,
    count_near: bool,
    max_steps: u32,
    known: KnownWeights,
    single: single::Scratch,
}

/// Statistics of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepStatistics {
    /// Number of steps: one per body and interval, plus the substeps of single vertices.
    pub substeps: u64,
    /// The largest, over all vertices, of the sum of a vertex's estimated errors [scene unit].
    pub error: f64,
    /// A bound on the part of the errors that exceeds the tolerance because steps cannot be made shorter [scene unit].
    pub excess: f64,
    /// Number of vertices for which a step of all vertices was too long, summed over these steps.
    pub hard: u64,
    /// Like `hard`, for steps of twice the length; counted only where steps are halved.
    pub near: u64,
    /// Work done, in units of `sim::work`.
    pub work: u64,
    /// Work of a single step of all vertices, in the same units.
    pub base: u64,
}

/// Step control: the kernels' instruction set, the tolerance, and the work budget.
#[derive(Clone, Copy)]
pub struct StepControl<'a> {
    /// The instruction set; results do not depend on it.
    pub arch: Arch,
    /// The largest acceptable error per unit of time [scene unit/s].
    pub tolerance: f64,
    /// The work budget; once it is exhausted, the rest of the step is not computed.
    pub work: &'a Tally<'a>,
}

/// The work of a step of `vertices` vertices under `spheres` spheres.
pub fn work_of(vertices: usize, spheres: usize) -> u64 {
    /// Evaluations of a force: at four nodes, at three of them in each of two corrections, in the middle and at the sixth sample.
    const FORCES: u64 = 12;
    vertices as u64 * FORCES * (1 + spheres as u64)
}

/// Advances the shared motion of a body's vertices, and the vertices in its active set, over `course`, in steps
/// halved `halvings` times. Adjusts `halvings` to the number of vertices for which the steps were too long or
/// would be if they were longer; vertices on which nothing acts do not count.
pub fn advance(
    course: &Course<'_>,
    control: StepControl<'_>,
    carried: &mut State,
    active_set: &mut ActiveSet,
    halvings: &mut u32,
    scratch: &mut Scratch,
) -> StepStatistics {
    let mut statistics = StepStatistics::default();
    scratch.count_near = *halvings > 0;
    let steps = match *halvings {
        0 => 1.0,
        // a part of a step is already shorter by this ratio
        halvings => (f64::from(1 << halvings) * (course.length / course.scene.dt)).ceil(),
    };
    scratch.max_steps = (single::MAX_STEPS / steps as u32).max(MIN_STEPS);
    let length = course.length / steps;
    for step in 0..steps as u32 {
        let start = course.start + f64::from(step) * length;
        let is_whole = course.is_whole && steps == 1.0;
        let part = Course { start, length, is_whole, ..*course };
        halve(&part, control, carried, active_set, scratch, MAX_HALVINGS, &mut statistics);
        if control.work.is_over() {
            return statistics;
        }
    }
    if course.is_whole {
        let StepStatistics { hard, near, .. } = statistics;
        let vertices = course.vertices as u64 * steps as u64;
        *halvings = match *halvings {
            now if now < MAX_HALVINGS && hard * MANY > vertices => now + 1,
            1.. if near == 0 => 0,
            now @ 1.. if near * 2 * MANY < vertices => now - 1,
            now => now,
        };
    }
    statistics
}

/// Takes one of the steps of [`advance`], halved until it resolves the body's own motion.
fn halve(
    course: &Course<'_>,
    control: StepControl<'_>,
    carried: &mut State,
    active_set: &mut ActiveSet,
    scratch: &mut Scratch,
    halvings: u32,
    statistics: &mut StepStatistics,
) {
    let h = course.length;
    if !control.work.spend((64 + 32 * course.spheres.len()) as u64) {
        return;
    }
    let wanted = control.tolerance * h;
    let weights = scratch.known.get(course.oscillator(), h);
    scratch.whole.prepare(course, weights, *carried, wanted);
    let uniform_error = scratch.whole.uniform_error();
    let middle = course.start + 0.5 * h;
    if uniform_error > wanted && halvings > 0 && course.start < middle {
        for start in [course.start, middle] {
            let half = Course { start, length: 0.5 * h, is_whole: false, ..*course };
            halve(&half, control, carried, active_set, scratch, halvings - 1, statistics);
        }
        return;
    }
    statistics.substeps += 1;
    let mut error = 0.0;
    if !active_set.vertices.is_empty() {
        error = step_active_set(course, control, *carried, active_set, scratch, statistics);
    }
    statistics.error += uniform_error.max(error);
    if !(uniform_error <= wanted) {
        statistics.excess += uniform_error - wanted;
    }
    *carried = scratch.whole.carried_at_end(*carried);
}

/// Steps the active set: all vertices together, then individually those for which that is not accurate enough or that
/// may cross a rim. Returns the largest estimated error of a vertex [scene unit].
fn step_active_set(
    course: &Course<'_>,
    control: StepControl<'_>,
    carried: State,
    active_set: &mut ActiveSet,
    scratch: &mut Scratch,
    statistics: &mut StepStatistics,
) -> f64 {
    let Scratch { whole, pulls, outcomes, inside, count_near, max_steps, known, single } = scratch;
    let force = course.strongest_pull();
    let wanted = control.tolerance * course.length;
    let stiff = single::is_stiff(course, course.length);
    let work = control.work;
    control.arch.dispatch(Together {
        course,
        step: whole,
        active_set,
        wanted,
        force,
        stiff,
        work,
        uncounted: 0,
        count_near: *count_near,
        pulls,
        outcomes,
    });

    let mut alone = Single {
        course,
        whole,
        carried,
        tolerance: control.tolerance,
        force,
        max_steps: *max_steps,
        work,
        substeps: 0,
        error: 0.0,
        excess: 0.0,
    };
    let has_kink = step::has_kink(course.weight());
    let count = active_set.vertices.len();
    for group in &outcomes.groups {
        for i in group.start..group.end.min(count) {
            if outcomes.attention[i] == 0.0 || work.is_over() {
                continue;
            }
            if has_kink {
                outcomes.inside(i, inside);
            }
            let inside = has_kink.then_some(&**inside);
            let vertex = Vertex { rest: active_set.rest(i), local: course.local(i) };
            let forces = FORCES.map(|node| outcomes.results.get(node, i));
            let end = active_set.state(i);
            let (error, bend) = (outcomes.error[i], outcomes.results.get(BEND, i));
            let outcome = Outcome { end, forces, bend, error, bent: error };
            let [x, u] = START.map(|k| outcomes.results.get(k, i));
            let start = State { x, u };
            // one more step for a rim is no sign that the steps are too long
            let expected = alone.substeps + u64::from(outcome.error <= wanted);
            let end = alone.advance(&vertex, inside, start, outcome, known, single);
            statistics.hard += alone.substeps.saturating_sub(expected);
            active_set.set_state(i, end);
        }
    }
    if !outcomes.groups.is_empty() {
        active_set.pad_again(); // the padding has not been updated
    }
    statistics.near += outcomes.near;
    statistics.substeps += alone.substeps;
    statistics.excess += alone.excess;
    alone.error.max(outcomes.largest_error())
}
