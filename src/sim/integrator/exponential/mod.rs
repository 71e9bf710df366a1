//! The exponential integrator: the oscillator's flow is exact, only the force is approximated, as closely as wanted.
//!
//! | what | where |
//! | --- | --- |
//! | what acts on a body over an interval of time, and what all its vertices do alike | [`course`] |
//! | the weights of a step, from the oscillator's φ-functions | [`weights`] |
//! | one step of a few vertices side by side, and the error it makes | [`step`], [`lanes`] |
//! | a step of all vertices near a sphere | [`together`] |
//! | a vertex that crosses a rim or needs shorter steps | [`single`], [`rim`] |
//!
//! [`advance`] takes a body over an interval in which nothing jumps. What its own motion and pushes do to all vertices alike
//! is a few numbers. A vertex near a sphere takes a step, and takes it again in halves as long as it would make too large
//! an error; where it crosses a rim, at which the linear weight has a kink, its step ends and another begins. All other
//! vertices are left to the exact flow, which takes them to wherever they are next wanted.

pub mod course;
pub mod lanes;
pub mod rim;
pub mod single;
pub mod step;
pub mod together;
pub mod weights;

use glam::DVec3;
use pulp::Arch;

use crate::sim::{
    deformation::ActiveSet,
    state::{Common, State},
    work::Tally,
};
use course::Course;
use single::Single;
use step::{Outcome, Pull, Step, Vertex};
use together::{Outcomes, Together};
use weights::KnownWeights;

/// Halvings of a body's interval for the sake of its own motion.
const MOST_HALVINGS: u32 = 10;

/// Reused from step to step.
#[derive(Default)]
pub struct Scratch {
    whole: Step,
    pulls: Vec<Pull>,
    outcomes: Outcomes,
    known: KnownWeights,
    single: single::Scratch,
}

/// What it took.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepStatistics {
    /// Steps: one a body and interval, and those that single vertices took beyond it.
    pub substeps: u64,
    /// The largest sum of estimated errors of a vertex [scene unit].
    pub error: f64,
    /// In units of [`crate::sim::work`] …
    pub work: u64,
    /// … and what one step of all would have been.
    pub base: u64,
}

/// The kernels' instruction set, the error that will do, and what it may take.
#[derive(Clone, Copy)]
pub struct StepControl<'a> {
    /// Which instructions there are; the result is the same with any.
    pub arch: Arch,
    /// The largest error that will do, per time [scene unit/s].
    pub tolerance: f64,
    /// When it is over, what is left is not done.
    pub work: &'a Tally<'a>,
}

/// The work of a step of so many vertices under so many spheres.
pub fn work_of(vertices: usize, spheres: usize) -> u64 {
    /// Forces are found at the four nodes, corrected at three of them, and found in the middle.
    const FORCES: u64 = 12;
    FORCES * vertices as u64 * (1 + spheres as u64)
}

/// Advances what the vertices of a body do alike, and those in its active set, over `course`.
pub fn advance(
    course: &Course<'_>,
    control: StepControl<'_>,
    common: &mut Common,
    active_set: &mut ActiveSet,
    scratch: &mut Scratch,
) -> StepStatistics {
    let mut statistics = StepStatistics::default();
    halve(course, control, common, active_set, scratch, MOST_HALVINGS, &mut statistics);
    statistics
}

/// [`advance`], in halves as long as the body's own motion is not resolved.
fn halve(
    course: &Course<'_>,
    control: StepControl<'_>,
    common: &mut Common,
    active_set: &mut ActiveSet,
    scratch: &mut Scratch,
    halvings: u32,
    statistics: &mut StepStatistics,
) {
    let h = course.length;
    if !control.work.spend((16 + 8 * course.spheres.len() + 5 * course.weighted.len()) as u64) {
        return;
    }
    let weights = scratch.known.get(course.oscillator(), h);
    let wanted = control.tolerance * h;
    scratch.whole.prepare(course, weights, common, wanted);
    let uniform_error = scratch.whole.uniform_error();
    let middle = course.start + 0.5 * h;
    if uniform_error > wanted && halvings > 0 && course.start < middle {
        for start in [course.start, middle] {
            let half = Course { start, length: 0.5 * h, is_whole: false, ..*course };
            halve(&half, control, common, active_set, scratch, halvings - 1, statistics);
        }
        return;
    }
    statistics.substeps += 1;
    let mut error = 0.0;
    if !active_set.vertices.is_empty() {
        error = take(course, control, common, active_set, scratch, statistics);
    }
    statistics.error += uniform_error.max(error);
    scratch.whole.advance_common(course, common);
}

/// A step of the vertices of the active set, together, and of those for which that will not do one by one. Returns the largest
/// estimated error of one [scene unit].
fn take(
    course: &Course<'_>,
    control: StepControl<'_>,
    common: &Common,
    active_set: &mut ActiveSet,
    scratch: &mut Scratch,
    statistics: &mut StepStatistics,
) -> f64 {
    let Scratch { whole, pulls, outcomes, known, single } = scratch;
    let force = course.strongest_pull();
    let wanted = control.tolerance * course.length;
    let stiff = single::is_stiff(course, course.length);
    let work = control.work;
    control.arch.dispatch(Together { course, step: whole, active_set, wanted, force, stiff, work, pulls, outcomes });

    let tolerance = control.tolerance;
    let mut alone = Single { course, whole, common, tolerance, force, work, substeps: 0, error: 0.0 };
    let has_kink = step::has_kink(course.weight());
    let count = active_set.vertices.len();
    for group in &outcomes.groups {
        for i in group.start..group.end.min(count) {
            if outcomes.attention[i] == 0.0 || work.is_over() {
                continue;
            }
            let vertex = Vertex { rest: active_set.rest(i), inside: has_kink.then_some(outcomes.inside[i]) };
            let forces: [DVec3; 4] = std::array::from_fn(|node| outcomes.forces[node].get(i));
            let end = active_set.state(i);
            let outcome = Outcome { end, forces, bend: outcomes.bend.get(i), error: outcomes.error[i] };
            let start = State { x: outcomes.displacement.get(i), u: outcomes.velocity.get(i) };
            outcomes.error[i] = 0.0; // what it makes of it counts instead
            let end = alone.take(vertex, start, outcome, known, single);
            active_set.set_state(i, end);
        }
    }
    if !outcomes.groups.is_empty() {
        active_set.pad_again(); // what a step came to there was not looked at
    }
    statistics.substeps += alone.substeps;
    outcomes.error[..count].iter().fold(alone.error, |largest, &error| largest.max(error))
}
