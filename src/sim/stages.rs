//! The stages inside a step, recomputed outside the world, for debugging integrators.
//!
//! Starting from the state before a step and the events in it, every interval between two jumps is integrated again
//! with the components that the step itself uses. The world is only read, and steps that are not inspected cost
//! nothing.

use glam::DVec3;

use super::{
    arrays::{LANES, Vectors},
    body::Body,
    deformation::Deformation,
    frames::{add_forces, pair_frame},
    integrator::{
        explicit::Scheme,
        exponential::{self, StepControl, course::Course},
    },
    neighbours::Neighbour,
    span::Span,
    state::State,
    terms::{Acting, Cause, Moment, On, Phases, Surroundings, carry, push::PushField},
    work::{Tally, Work},
    world::{PairView, States, World},
};
use crate::{
    model::{oscillator::Oscillator, phase::Phase},
    observe::{BodyFrame, Frame, Instant, PairFrame, Simulation as _, StageFrame, Want},
    scene::Integrator,
};

/// The largest number of intervals that are recomputed to find a state within a step.
const MAX_PARTS: usize = 64;

/// What a stage's frame contains.
const WANT: Want = Want { forces: true, scalars: false };

/// Frames of all stages of a step have no more vertices than this, …
const MAX_VERTICES: u64 = 1 << 20;
/// … but at least this many stages are always kept.
const MIN_STAGES: u64 = 16;
/// Work limit for recomputing a step [units].
const MAX_WORK: u64 = 100_000_000;
/// Work limit for the state of a few bodies at one instant within a step [units].
const MAX_WORK_WITHIN: u64 = 4_000_000;

/// The stages of the step that led from `before` to the current state of the world, in order. If there are too many,
/// or they take too much work, or the world was interrupted, middle ones are omitted, and the name of the last one says
/// so.
pub fn inside(before: &Frame, world: &World) -> Vec<StageFrame> {
    let work = Work::limited(MAX_WORK, world.options().interrupt);
    let recomputed = Recomputed { world, before, work: Tally::new(&work, None) };
    let max = (MAX_VERTICES / world.scene().vertex_count().max(1)).max(MIN_STAGES) as usize;
    let mut last = "end".to_owned();
    let (start, end) = (before.at.time, world.time());
    let mut stages = vec![
        StageFrame { name: "start".to_owned(), frame: before.clone() },
        StageFrame { name: "influence forces".to_owned(), frame: influence_only(before.clone()) },
    ];
    let mut states: Vec<States> = (0..world.body_count()).map(|index| recomputed.states_before(index)).collect();
    let flown = (0..world.body_count()).map(|index| recomputed.flow(index, &states[index])).collect();
    stages.push(StageFrame { name: "after the flow alone".to_owned(), frame: recomputed.frame(end, start, flown) });

    match world.scene().integrator {
        Integrator::Exponential => {
            let breaks = recomputed.breaks();
            for (number, ends) in (1..).zip(breaks.windows(2)) {
                let (from, to) = (ends[0], ends[1]);
                if stages.len() >= max || recomputed.work.is_over() {
                    last = format!("end; sub-steps from {number} to {} are left out", breaks.len() - 1);
                    break;
                }
                for (index, states) in states.iter_mut().enumerate() {
                    recomputed.advance(index, from, to, states);
                }
                if breaks.len() > 2 {
                    let name = format!("after sub-step {number}, at t = {to:.9} s");
                    stages.push(StageFrame { name, frame: recomputed.frame(to, from, states.clone()) });
                }
                let events = world.report().events.iter().filter(|event| event.time == to);
                for event in events.take(max.saturating_sub(stages.len())) {
                    let name = |i: u32| &world.scene().bodies[i as usize].name;
                    let name = format!("{} {}~{}, at t = {to:.9} s", event.name(), name(event.a), name(event.b));
                    stages.push(StageFrame { name, frame: recomputed.frame(to, to, states.clone()) });
                }
            }
        }
        Integrator::Thesis | Integrator::Mps => {
            let predicted = (0..world.body_count()).map(|index| recomputed.predict(index, &states[index])).collect();
            let name = "prediction, (3.6) and (3.7)".to_owned();
            stages.push(StageFrame { name, frame: recomputed.frame(end, start, predicted) });
        }
        Integrator::Euler | Integrator::Verlet | Integrator::Rk4 => {}
    }
    let mut frame = Frame::default();
    world.observe(WANT, &mut frame);
    stages.push(StageFrame { name: last, frame });
    stages
}

/// Writes the state of some bodies at a time within the step that led from `before` to the current state of the world,
/// on the solution of the step; false if that is too much work. Only for the exponential integrator: the others have no
/// dense output.
pub fn within(before: &Frame, world: &World, time: f64, bodies: &[usize], frame: &mut Frame) -> bool {
    let work = Work::limited(MAX_WORK_WITHIN, world.options().interrupt);
    let recomputed = Recomputed { world, before, work: Tally::new(&work, None) };
    let mut breaks = recomputed.breaks();
    breaks.retain(|&at| at < time);
    if breaks.len() > MAX_PARTS {
        return false;
    }
    breaks.push(time);
    frame.at = Instant { step: world.steps_taken(), time };
    frame.bodies.resize_with(world.body_count(), BodyFrame::default);
    for &index in bodies {
        let mut states = recomputed.states_before(index);
        for ends in breaks.windows(2) {
            recomputed.advance(index, ends[0], ends[1], &mut states);
        }
        if recomputed.work.is_over() {
            return false;
        }
        let now = &mut frame.bodies[index];
        now.centre = world.path(index).position(time);
        (now.displacements, now.velocities) = (states.displacement, states.velocity);
        now.displaced(recomputed.body(index).rest());
    }
    true
}

/// Like [`within`] for a coupled scene. Bodies that took no step in which they act on others are left unchanged; returns
/// the others.
pub fn within_coupled(before: &Frame, world: &World, time: f64, bodies: &[usize], frame: &mut Frame) -> Vec<usize> {
    let Some(coupled) = &world.coupled else { return Vec::new() };
    let work = Work::limited(MAX_WORK, world.options().interrupt);
    frame.at = Instant { step: world.steps_taken(), time };
    frame.bodies.resize_with(world.body_count(), BodyFrame::default);
    let mut written = Vec::new();
    let ends = [before.at.time, world.time()];
    coupled.within(world.scene(), ends, time, bodies, &Tally::new(&work, None), |index, body| {
        let now = &mut frame.bodies[index];
        (now.centre, now.rotation) = (body.centre(), body.rotation());
        now.displacements.reset(world.bodies[index].rest().len());
        body.displacements().enumerate().for_each(|(i, x)| now.displacements.set(i, x));
        now.displaced(world.bodies[index].rest());
        written.push(index);
    });
    written
}

/// The frame without the forces that do not come from influence spheres.
fn influence_only(mut frame: Frame) -> Frame {
    let is_influence = |cause: Cause| matches!(cause, Cause::Attraction | Cause::Repulsion | Cause::Core);
    for body in frame.bodies.iter_mut().filter(|body| body.has_forces) {
        let [terms @ .., net] = body.terms.as_mut_slice() else { continue };
        let count = net.accelerations.len();
        net.accelerations.reset(count);
        for (cause, term) in Cause::ALL.into_iter().zip(terms) {
            if is_influence(cause) {
                net.accelerations.add_times(1.0, &term.accelerations);
            } else {
                term.accelerations.clear();
            }
        }
    }
    frame
}

/// A step that is recomputed.
struct Recomputed<'a> {
    /// The world after the step.
    world: &'a World,
    before: &'a Frame,
    work: Tally<'a>,
}

impl Recomputed<'_> {
    fn body(&self, index: usize) -> &Body {
        &self.world.bodies[index]
    }

    fn oscillator(&self, index: usize) -> Oscillator {
        let material = self.world.scene().bodies[index].material;
        Oscillator { omega: material.omega, damping: material.damping }
    }

    fn states_before(&self, index: usize) -> States {
        let BodyFrame { displacements, velocities, .. } = &self.before.bodies[index];
        let mut states = States { displacement: displacements.clone(), velocity: velocities.clone() };
        states.displacement.resize(self.body(index).rest().len());
        states.velocity.resize(self.body(index).rest().len());
        states
    }

    /// The phase of a pair from `t` on.
    fn phase(&self, a: usize, b: usize, t: f64) -> Phase {
        let (a, b) = (a.min(b), a.max(b));
        let is_it = |x: usize, y: usize| (x, y) == (a, b);
        let mut events = self.world.report().events.iter();
        let last = events.rfind(|event| event.time <= t && is_it(event.a as usize, event.b as usize));
        let before = || {
            let known = self.before.pairs.iter().find(|pair| is_it(pair.a, pair.b))?;
            [Phase::Apart, Phase::Merged, Phase::Core].into_iter().find(|&phase| phase as usize == known.phase)
        };
        last.map(|event| event.to).or_else(before).unwrap_or(Phase::Apart)
    }

    /// The instants at which something jumps, and both ends of the step [s].
    fn breaks(&self) -> Vec<f64> {
        let scene = self.world.scene();
        let span = Span { start: self.before.at.time, end: self.world.time() };
        let tracks = self.world.reading().tracks;
        let knots = (0..scene.bodies.len()).flat_map(|body| tracks.path(body).knots().iter().copied());
        let mut breaks: Vec<f64> = knots.filter(|&t| span.holds(t)).chain([span.start, span.end]).collect();
        for index in 0..self.world.body_count() {
            self.on(index).jumps(&self.body(index).neighbours, span, &mut breaks);
        }
        breaks.sort_by(f64::total_cmp);
        breaks.dedup();
        breaks
    }

    /// The input of force terms for a body.
    fn on(&self, index: usize) -> On<'_, &Self> {
        self.world.reading().on(index as u32).with_phases(self)
    }

    /// What acts on a body at `t`, with the phases that hold from `phases_at` on.
    fn surroundings(&self, index: usize, t: f64, phases_at: f64, states: &States) -> Surroundings {
        let radius = self.world.scene().bodies[index].radius;
        let farthest = states.displacement.iter().map(DVec3::length).fold(0.0, f64::max) + radius;
        let mut surroundings = Surroundings::default();
        self.on(index).surroundings_into(Moment { time: t, phases_at }, farthest, &mut surroundings);
        surroundings
    }

    /// A frame of the same bodies in other states at `t`, with the phases that hold from `phases_at` on.
    fn frame(&self, t: f64, phases_at: f64, states: Vec<States>) -> Frame {
        let scene = self.world.scene();
        let bodies = states.into_iter().enumerate().map(|(index, states)| {
            let surroundings = self.surroundings(index, t, phases_at, &states);
            let States { displacement: displacements, velocity: velocities } = states;
            let centre = self.world.path(index).position(t);
            let mut now = BodyFrame { centre, displacements, velocities, ..BodyFrame::default() };
            now.displaced(self.body(index).rest());
            add_forces(self.world, index, &surroundings, &mut now);
            now
        });
        let bodies: Vec<BodyFrame> = bodies.collect();
        let pairs = self.before.pairs.iter().map(|&PairFrame { a, b, .. }| {
            let radii = scene.bodies[a].radius + scene.bodies[b].radius;
            let q = bodies[a].centre.distance(bodies[b].centre) / radii;
            pair_frame(PairView { a, b, q, phase: self.phase(a, b, phases_at) })
        });
        let at = Instant { step: self.world.steps_taken(), time: t };
        Frame { at, pairs: pairs.collect(), bodies, scalars: Vec::new() }
    }

    /// The states after the step under the oscillators alone.
    fn flow(&self, index: usize, states: &States) -> States {
        let [xx, xu, ux, uu] = self.oscillator(index).flow(self.world.time() - self.before.at.time);
        let both = || states.displacement.iter().zip(states.velocity.iter());
        States {
            displacement: both().map(|(x, u)| xx * x + xu * u).collect(),
            velocity: both().map(|(x, u)| ux * x + uu * u).collect(),
        }
    }

    /// Velocities after the forces have acted, and the resulting positions.
    fn predict(&self, index: usize, states: &States) -> States {
        let h = self.world.time() - self.before.at.time;
        let scene = self.world.scene();
        debug_assert!(Scheme::of(scene.integrator).is_some());
        let surroundings = self.surroundings(index, self.before.at.time, self.before.at.time, states);
        let rest = self.body(index).rest();
        let acting =
            states.displacement.iter().enumerate().map(|(i, x)| {
                surroundings.acceleration(scene.influence.weight, rest.position(i), rest.direction(i), x)
            });
        let velocity = states.velocity.iter().zip(acting).map(|(u, force)| u + h * force).collect();
        let moved = |(x, u): (DVec3, DVec3)| x + h * u;
        let velocity: Vectors = velocity;
        let displacement = states.displacement.iter().zip(velocity.iter()).map(moved).collect();
        States { displacement, velocity }
    }

    /// Advances a body over an interval without a jump, each vertex separately.
    fn advance(&self, index: usize, from: f64, to: f64, states: &mut States) {
        let scene = self.world.scene();
        let (this, body) = (&scene.bodies[index], self.body(index));
        let surroundings = self.surroundings(index, from, from, states);
        // a sphere may come within reach during the interval
        let mut acting = Acting::default();
        self.on(index).over(&body.neighbours, Span { start: from, end: to }, &mut acting);
        let Acting { spheres } = &acting;
        let is_still = states.displacement.iter().chain(states.velocity.iter()).all(|v| v == DVec3::ZERO);
        if is_still && spheres.is_empty() && surroundings.is_idle() && self.world.path(index).is_fixed() {
            return;
        }
        let every: Vec<u32> = (0..body.rest().len() as u32).collect();
        let mut pushes = PushField::default();
        pushes.begin(&body.pushes, Span { start: from, end: to }, &every, LANES);
        pushes.advance(from + 0.5 * (to - from), body.rest(), &every);
        let tracks = self.world.reading().tracks;
        let course = Course {
            scene,
            index,
            material: body.material,
            radius: body.radius,
            vertices: body.mesh.vertex_count(),
            start: from,
            length: to - from,
            tracks,
            is_whole: false,
            spheres,
            local: pushes.local(),
        };
        let mut deformation = Deformation::default();
        deformation.wake_all(body.rest());
        let active_set = &mut deformation.active_set;
        for i in 0..body.rest().len() {
            active_set.set_state(i, State { x: states.displacement.get(i), u: states.velocity.get(i) });
        }
        active_set.pad_again();
        let mut carried = State { x: DVec3::ZERO, u: carry::kick(&body.material, self.world.path(index), from) };
        let tolerance = scene.tolerance * this.radius;
        let control = StepControl { arch: self.world.options().arch, tolerance, work: &self.work };
        let scratch = &mut exponential::Scratch::default();
        exponential::advance(&course, control, &mut carried, active_set, &mut 0, scratch);
        for i in 0..body.rest().len() {
            let own = active_set.state(i);
            states.displacement.set(i, carried.x + own.x);
            states.velocity.set(i, carried.u + own.u);
        }
    }
}

impl Phases for &Recomputed<'_> {
    fn from(&self, index: u32, neighbour: &Neighbour, t: f64) -> Phase {
        self.phase(index as usize, neighbour.other as usize, t)
    }

    fn changes(&self, index: u32, neighbour: &Neighbour, times: &mut Vec<f64>) {
        let (a, b) = (index.min(neighbour.other), index.max(neighbour.other));
        let events = self.world.report().events.iter().filter(|event| (event.a, event.b) == (a, b));
        times.extend(events.map(|event| event.time));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;

    /// A step with very many events has a bounded number of stages, and the last one reports how many are missing.
    #[test]
    fn a_step_with_very_many_events_has_few_stages() {
        let text = "duration = 1.0\n[material]\nresponse = \"rigid\"\n[influence]\nreach = 0.01\n\
                    [[body]]\nname = \"a\"\nradius = 1.0\nshape = { sphere = { stacks = 2, slices = 3 } }\nmotion = { fixed = [0, 0, 0] }\n\
                    [[body]]\nname = \"b\"\nradius = 1.0\nshape = { sphere = { stacks = 2, slices = 3 } }\n\
                    motion = { sine = { center = [2.1, 0, 0], amplitude = [1.5, 0, 0], frequency = 2e5 } }\n";
        let mut world = World::new(Scene::parse(text, "events.toml").unwrap()).unwrap();
        let mut before = Frame::default();
        world.observe(WANT, &mut before);
        let report = world.step();
        assert_eq!(report.failure, None);
        assert!(report.events.len() > 5000, "{}", report.events.len());
        let stages = inside(&before, &world);
        let last = &stages[stages.len() - 1];
        assert!(
            stages.len() as u64 <= MAX_VERTICES / 10 + 2 && last.name.starts_with("end; sub-steps from "),
            "{}",
            last.name
        );
    }

    #[test]
    fn the_stages_lead_from_one_state_to_the_next() {
        for name in ["push", "two", "three", "size_ratio"] {
            let scene = Scene::builtin(name).unwrap();
            let mut world = World::new(scene.clone()).unwrap();
            let (mut largest, mut sub_steps, mut events) = (0.0, 0, 0);
            for _ in 0..scene.steps() {
                let mut before = Frame::default();
                world.observe(WANT, &mut before);
                let report = world.step();
                let happened = report.events.len();
                let stages = inside(&before, &world);
                assert_eq!(stages[0].name, "start");
                assert_eq!(stages[stages.len() - 1].name, "end");
                let named = |word: &str| stages.iter().filter(|stage| stage.name.contains(word)).count();
                sub_steps += named("sub-step");
                events += named("~");
                assert_eq!(named("~"), happened);
                // the last interval ends the step
                if let Some(last) = stages.iter().rfind(|stage| stage.name.contains("sub-step")) {
                    for (index, body) in world.bodies().enumerate() {
                        let ended = &last.frame.bodies[index].displacements;
                        for i in 0..body.vertex_count() {
                            largest =
                                f64::max(largest, ended.get(i).distance(body.displacement(i)) / body.scene().radius);
                        }
                    }
                }
            }
            assert!(sub_steps > 0, "{name}: {sub_steps}");
            assert!(events > 0 || name == "push");
            assert!(largest < 1e-6, "{name}: {largest:e}");
        }
    }
}
