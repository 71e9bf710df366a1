//! The stages inside a step, recomputed outside the world, for debugging integrators.
//!
//! Starting from the state before a step and the events in it, every interval between two jumps is integrated again
//! with the components that the step itself uses. Of a step of free bodies, the states at its events are shown.

use std::collections::BTreeSet;

use super::frames::add_forces;
use crate::{
    model::phase::Phase,
    observe::{BodyFrame, Frame, Instant, PairFrame, Simulation, StageFrame, Want, body_between, state_within},
    scene::{Integrator, Scene},
    sim::{
        Cause, Part, States, World,
        prescribed::within::{Before, Recomputed},
        work::{MAX_WITHIN, Work},
    },
};

/// The largest number of intervals that are recomputed to find a state within a step.
const MAX_PARTS: usize = 1024;

/// What a stage's frame contains.
const WANT: Want = Want { forces: true, scalars: false };

/// Frames of all stages of a step have no more vertices than this, but at least [`MIN_STAGES`] are always kept.
const MAX_VERTICES: u64 = 1 << 20;
const MIN_STAGES: u64 = 16;

/// The stages of the step that led from `before` to the current state of the world, in order. If there are too many,
/// or they take too much work, or the world was interrupted, middle ones are omitted, and the name of the last one says
/// so.
pub fn inside(before: &Frame, world: &World) -> Vec<StageFrame> {
    let mut stages = vec![
        StageFrame::new("start", before.clone()),
        StageFrame::new("start, with the influence forces alone", only(before.clone(), world.scene(), is_influence)),
    ];
    let max = (MAX_VERTICES / world.scene().vertex_count().max(1)).max(MIN_STAGES) as usize;
    let work = Work::limited(MAX_WITHIN, world.options().interrupt);
    let mut after = Frame::default();
    world.observe(WANT, &mut after);
    let recomputed = Recomputed::new(world, before_step(before), world.time(), &work);
    let last = match recomputed.filter(|_| world.parts().is_some_and(<[_]>::is_empty)) {
        Some(recomputed) => intervals(&recomputed, before, world, max, &mut stages),
        None => at_events([before, &after], world, max, &mut stages),
    };
    stages.push(StageFrame::new(last, after));
    stages
}

/// Adds the states at the phase changes of a step of a coupled scene, or of one that edits divide, without forces. Returns
/// the name of the last stage.
fn at_events(ends: [&Frame; 2], world: &World, max: usize, stages: &mut Vec<StageFrame>) -> String {
    let (events, schema) = (&world.report().events, Simulation::schema(world));
    let all: Vec<usize> = (0..world.body_count()).collect();
    let mut pairs = ends[0].pairs.clone();
    for event in events.iter().take(max) {
        let now = PairFrame::new(event.a as usize, event.b as usize, event.q, event.to as usize);
        match pairs.binary_search_by_key(&(now.a, now.b), |pair| (pair.a, pair.b)) {
            Ok(index) => (pairs[index].phase, pairs[index].q) = (now.phase, now.q),
            Err(index) => pairs.insert(index, now), // it came within reach in this step
        }
        let mut frame = Frame { pairs: pairs.clone(), ..Frame::default() };
        state_within(world, &schema, ends, event.time, &all, &mut frame);
        stages.push(StageFrame::new(name_of(event, world), frame));
    }
    match events.len().saturating_sub(max) {
        0 => "end".to_owned(),
        left_out => format!("end; {left_out} events before are left out"),
    }
}

/// Adds the stages of a step of bodies on paths. Returns the name of the last one.
fn intervals(
    recomputed: &Recomputed<'_>,
    before: &Frame,
    world: &World,
    max: usize,
    stages: &mut Vec<StageFrame>,
) -> String {
    let (start, end) = (before.at.time, world.time());
    let frame = |t: f64, phases_at: f64, states: Vec<States>| frame_of(recomputed, before, world, t, phases_at, states);
    let mut states: Vec<States> = (0..world.body_count()).map(|index| states_before(before, world, index)).collect();
    let mut pushes: Vec<_> = (0..world.body_count()).map(|index| recomputed.pushes(index)).collect();
    let flown = states.iter().enumerate().map(|(index, states)| recomputed.flow(index, states)).collect();
    let mut last = "end".to_owned();
    let without =
        StageFrame { is_hypothetical: true, ..StageFrame::new("end if no sphere acted", frame(end, end, flown)) };
    match world.scene().integrator {
        Integrator::Exponential => {
            let breaks = recomputed.breaks();
            for (number, ends) in (1..).zip(breaks.windows(2)) {
                let (from, to) = (ends[0], ends[1]);
                if stages.len() >= max || recomputed.is_over() {
                    last = format!("end; parts {number} to {} are omitted", breaks.len() - 1);
                    break;
                }
                for (index, (states, pushes)) in states.iter_mut().zip(&mut pushes).enumerate() {
                    recomputed.advance(index, from, to, states, pushes);
                }
                if breaks.len() > 2 {
                    let name = format!("after part {number}, at t = {to:.9} s");
                    stages.push(StageFrame::new(name, frame(to, from, states.clone())));
                }
                let events = world.report().events.iter().filter(|event| event.time == to);
                for event in events.take(max.saturating_sub(stages.len())) {
                    stages.push(StageFrame::new(name_of(event, world), frame(to, to, states.clone())));
                }
            }
        }
        Integrator::Thesis | Integrator::Mps => {
            let predicted =
                states.iter().enumerate().map(|(index, states)| recomputed.predict(index, states)).collect();
            let predicted = frame(end, start, predicted);
            let restoring =
                only(predicted.clone(), world.scene(), |cause| matches!(cause, Cause::Restoring | Cause::Damping));
            stages.push(StageFrame::new("prediction, (3.6) and (3.7)", predicted));
            stages.push(StageFrame::new("restoring force T, (3.8)", restoring));
        }
        Integrator::Euler | Integrator::Verlet | Integrator::Rk4 => {}
    }
    stages.push(without);
    last
}

fn name_of(event: &crate::sim::Event, world: &World) -> String {
    let name = |body: u32| &world.scene().bodies[body as usize].name;
    format!("{} {}~{}, at t = {:.9} s", event.name(), name(event.a), name(event.b), event.time)
}

/// What recomputing a step needs of the frame before it.
fn before_step(before: &Frame) -> Before {
    let phase = |pair: &PairFrame| [Phase::Apart, Phase::Merged, Phase::Core].get(pair.phase).copied();
    let phases = before.pairs.iter().filter_map(|pair| Some(([pair.a, pair.b], phase(pair)?)));
    Before { time: before.at.time, phases: phases.collect() }
}

fn states_before(before: &Frame, world: &World, index: usize) -> States {
    let BodyFrame { displacements, velocities, .. } = &before.bodies[index];
    let mut states = States { displacement: displacements.clone(), velocity: velocities.clone() };
    states.displacement.resize(world.body(index).vertex_count());
    states.velocity.resize(world.body(index).vertex_count());
    states
}

/// A frame of the same bodies in other states at `t`, with the phases that hold from `phases_at` on.
fn frame_of(
    recomputed: &Recomputed<'_>,
    before: &Frame,
    world: &World,
    t: f64,
    phases_at: f64,
    states: Vec<States>,
) -> Frame {
    let causes: Vec<Cause> = Cause::of(world.scene()).collect();
    let bodies = states.into_iter().enumerate().map(|(index, states)| {
        let surroundings = recomputed.surroundings(index, t, phases_at, &states);
        let States { displacement: displacements, velocity: velocities } = states;
        let centre = recomputed.path(index).position(t);
        let mut now = BodyFrame { centre, displacements, velocities, ..BodyFrame::default() };
        now.displaced(world.body(index).rest_shape());
        add_forces(world, &causes, index, &surroundings, &mut now);
        now
    });
    let bodies: Vec<BodyFrame> = bodies.collect();
    let events = world.report().events.iter().map(|event| (event.a as usize, event.b as usize));
    let pairs: BTreeSet<(usize, usize)> = before.pairs.iter().map(|pair| (pair.a, pair.b)).chain(events).collect();
    let pairs = pairs.into_iter().map(|(a, b)| {
        let radii = world.scene().bodies[a].radius + world.scene().bodies[b].radius;
        let q = bodies[a].centre.distance(bodies[b].centre) / radii;
        PairFrame::new(a, b, q, recomputed.phase(a, b, phases_at) as usize)
    });
    let at = Instant { step: world.steps_taken(), time: t };
    Frame { at, pairs: pairs.collect(), bodies, ..Frame::default() }
}

/// A step of the solver, as far as states within it need it.
#[derive(Clone, Copy)]
pub struct StepOfSolver<'a> {
    /// The state before it.
    pub before: &'a Frame,
    /// The world after it, and the time then [s].
    pub world: &'a World,
    pub end: f64,
}

/// The step of the solver that `time` [s] is in: the last step of the world, after the state `before`, or if edits divide it,
/// a part of it. Then writes the states of these bodies at `time`, interpolated in this part alone. `None` if the parts are
/// not known. `first` is storage for the state before the part, of these bodies.
pub fn step_of_solver<'a>(
    before: &'a Frame,
    world: &'a World,
    time: f64,
    bodies: &[usize],
    frame: &mut Frame,
    first: &'a mut Frame,
) -> Option<StepOfSolver<'a>> {
    let parts = world.parts()?;
    if parts.is_empty() {
        return Some(StepOfSolver { before, world, end: world.time() });
    }
    let observe = |part: &World, end: f64, index: usize, now: &mut BodyFrame| {
        super::observe_state(part.body(index), now);
        if let Some(path) = part.scene().bodies[index].path() {
            now.centre = path.position(end);
        }
    };
    let number = parts.partition_point(|part| part.end <= time);
    let (part, end) = parts.get(number).map_or((world, world.time()), |part| (&part.world, part.end));
    let before = match number.checked_sub(1).map(|number| &parts[number]) {
        Some(Part { world: ended, end }) => {
            first.at = Instant { step: world.steps_taken(), time: *end };
            first.pairs.extend(ended.pairs().map(super::pair_frame));
            first.bodies.resize_with(world.body_count(), BodyFrame::default);
            bodies.iter().for_each(|&index| observe(ended, *end, index, &mut first.bodies[index]));
            &*first
        }
        None => before,
    };
    for &index in bodies {
        let mut last = BodyFrame::default();
        observe(part, end, index, &mut last);
        let body = super::body_schema(&world.scene().bodies[index]);
        let ends = [&before.bodies[index], &last];
        body_between(&body, ends, [before.at.time, end], time, &mut frame.bodies[index]);
    }
    Some(StepOfSolver { before, world: part, end })
}

/// Writes the state of some bodies at a time within a step, on its solution; false if that is too much work, or if the scene
/// is coupled. Only for the exponential integrator: the others have no dense output.
///
/// A search for the time of a contact calls this many times a step: each state is computed from one that was found before.
pub fn within(
    StepOfSolver { before, world, end }: StepOfSolver<'_>,
    time: f64,
    bodies: &[usize],
    frame: &mut Frame,
) -> bool {
    let work = Work::limited(MAX_WITHIN, world.options().interrupt);
    let Some(recomputed) = Recomputed::new(world, before_step(before), end, &work) else { return false };
    let breaks = recomputed.breaks();
    if breaks.partition_point(|&at| at < time) > MAX_PARTS {
        return false;
    }
    for &index in bodies {
        let start = || states_before(before, world, index);
        let Some(states) = recomputed.at(index, time, &breaks, start) else { return false };
        let now = &mut frame.bodies[index];
        now.centre = recomputed.path(index).position(time);
        (now.displacements, now.velocities) = (states.displacement, states.velocity);
        now.displaced(world.body(index).rest_shape());
    }
    true
}

/// Like [`within`] for a coupled scene. Bodies that took no step in which they act on others are left unchanged.
pub fn within_coupled(
    StepOfSolver { before, world, end }: StepOfSolver<'_>,
    time: f64,
    bodies: &[usize],
    frame: &mut Frame,
) {
    let work = Work::limited(MAX_WITHIN, world.options().interrupt);
    world.coupled_within([before.at.time, end], time, bodies, &work, |index, body| {
        let (now, rest) = (&mut frame.bodies[index], world.body(index).rest_shape());
        (now.centre, now.rotation) = (body.centre(), body.rotation());
        now.displacements.reset(rest.len());
        body.displacements().enumerate().for_each(|(i, x)| now.displacements.set(i, x));
        now.displaced(rest);
    });
}

/// Whether a force comes from influence spheres.
fn is_influence(cause: Cause) -> bool {
    matches!(cause, Cause::Attraction | Cause::Repulsion | Cause::Core | Cause::Point)
}

/// The frame with only some of the forces, and their sum as net force.
fn only(mut frame: Frame, scene: &Scene, is_kept: impl Fn(Cause) -> bool) -> Frame {
    for body in frame.bodies.iter_mut().filter(|body| body.has_forces) {
        let [terms @ .., net] = body.terms.as_mut_slice() else { continue };
        let count = net.accelerations.len();
        net.accelerations.reset(count);
        for (cause, term) in Cause::of(scene).zip(terms) {
            if is_kept(cause) {
                net.accelerations.add_times(1.0, &term.accelerations);
            } else {
                term.accelerations.clear();
            }
        }
    }
    frame
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
        let [.., without, last] = &stages[..] else { panic!("no stages") };
        assert_eq!(without.name, "end if no sphere acted");
        assert!(stages.len() as u64 <= MAX_VERTICES / 10 + 2 && last.name.starts_with("end; parts "), "{}", last.name);
    }

    /// Fig. 3.4: the velocity after a step is that of the prediction, and T Δt (3.9).
    #[test]
    fn the_stages_of_the_printed_scheme_are_its_equations() {
        let scene = Scene::builtin("figure-4-2").unwrap();
        let mut world = World::new(scene.clone()).unwrap();
        let (mut largest, mut compared) = (0.0, 0);
        for _ in 0..120 {
            let mut before = Frame::default();
            world.observe(WANT, &mut before);
            let _ = world.step();
            let stages = inside(&before, &world);
            let named = |name: &str| &stages.iter().find(|stage| stage.name == name).unwrap().frame;
            let [predicted, restoring, end] =
                ["prediction, (3.6) and (3.7)", "restoring force T, (3.8)", "end"].map(named);
            for ((predicted, restoring), end) in predicted.bodies.iter().zip(&restoring.bodies).zip(&end.bodies) {
                let Some(net) = restoring.terms.last().filter(|_| restoring.has_forces && !end.is_at_rest) else {
                    continue;
                };
                for i in 0..net.accelerations.len() {
                    let expected = predicted.velocities.get(i) + net.accelerations.get(i) * scene.dt;
                    largest = f64::max(largest, expected.distance(end.velocities.get(i)));
                    compared += 1;
                }
            }
        }
        assert!(compared > 10_000 && largest < 1e-13, "{compared} {largest:e}");
    }

    #[test]
    fn the_stages_lead_from_one_state_to_the_next() {
        for name in ["push", "two", "three", "size_ratio"] {
            let scene = Scene::builtin(name).unwrap();
            let mut world = World::new(scene.clone()).unwrap();
            let (mut largest, mut parts, mut events) = (0.0, 0, 0);
            for _ in 0..scene.steps() {
                let mut before = Frame::default();
                world.observe(WANT, &mut before);
                let report = world.step();
                let happened = report.events.len();
                let stages = inside(&before, &world);
                assert_eq!(stages[0].name, "start");
                assert_eq!(stages[stages.len() - 1].name, "end");
                let named = |word: &str| stages.iter().filter(|stage| stage.name.contains(word)).count();
                parts += named("after part");
                events += named("~");
                assert_eq!(named("~"), happened);
                // the last interval ends the step
                if let Some(last) = stages.iter().rfind(|stage| stage.name.contains("after part")) {
                    for (index, body) in world.bodies().enumerate() {
                        let ended = &last.frame.bodies[index].displacements;
                        for i in 0..body.vertex_count() {
                            largest =
                                f64::max(largest, ended.get(i).distance(body.displacement(i)) / body.scene().radius);
                        }
                    }
                }
            }
            assert!(parts > 0, "{name}: {parts}");
            assert!(events > 0 || name == "push");
            assert!(largest < 1e-6, "{name}: {largest:e}");
        }
    }

    /// At an event inside a step of free bodies, its pair is in the new phase, at the q of the event.
    #[test]
    fn pairs_of_free_bodies_change_at_their_events() {
        let scene = Scene::builtin("collide").unwrap();
        let mut world = World::new(scene.clone()).unwrap();
        let mut events = 0;
        for _ in 0..scene.steps() {
            let mut before = Frame::default();
            world.observe(WANT, &mut before);
            let _ = world.step();
            let stages = inside(&before, &world);
            let named = stages.iter().filter(|stage| stage.name.contains('~'));
            for (stage, event) in named.zip(&world.report().events) {
                let [pair] = &stage.frame.pairs[..] else { panic!("{}", stage.name) };
                assert_eq!((pair.phase, pair.q), (event.to as usize, event.q), "{}", stage.name);
                events += 1;
            }
        }
        assert_eq!(events, 6);
    }

    /// b comes from out of reach and merges with a in one step.
    #[test]
    fn a_pair_that_comes_within_reach_has_its_stage() {
        for motion in [
            "free = { from = [5, 0, 0], velocity = [-240, 0, 0] }",
            "line = { from = [5, 0, 0], velocity = [-240, 0, 0] }",
        ] {
            let text = format!(
                "duration = 1.0\n[[body]]\nname = 'a'\nradius = 1.0\nmotion = {{ fixed = [0, 0, 0] }}\n[[body]]\n\
                 name = 'b'\nradius = 1.0\nmotion = {{ {motion} }}\n"
            );
            let mut world = World::new(Scene::parse(&text, "fast.toml").unwrap()).unwrap();
            let mut before = Frame::default();
            world.observe(WANT, &mut before);
            assert_eq!((before.pairs.len(), world.step().events.is_empty()), (0, false));
            let event = world.report().events[0];
            let stages = inside(&before, &world);
            let stage = stages.iter().find(|stage| stage.name.starts_with("merge a~b")).unwrap();
            let [pair] = &stage.frame.pairs[..] else { panic!("{motion}: {}", stage.frame.pairs.len()) };
            assert_eq!((pair.phase, (pair.q - event.q).abs() < 1e-9), (event.to as usize, true), "{motion}");
        }
    }
}
