//! The solution within a step, recomputed for debugging and for what is searched for between the ends of steps.

use glam::DVec3;

use super::{Prescribed, body::Body, deformation::Deformation};
use crate::{
    lock,
    model::phase::Phase,
    scene::Path,
    sim::{
        States, World,
        integrator::exponential::{self, StepControl, course::Course},
        neighbours::Neighbour,
        numerics::arrays::{LANES, Vectors},
        span::Span,
        state::State,
        terms::{Moment, On, Phases, Surroundings, carry, push::PushField},
        work::{Tally, Work},
    },
};

/// The state of a world before its last step.
#[derive(Clone, Debug, Default)]
pub(crate) struct Before {
    /// Simulated time [s].
    pub time: f64,
    /// The bodies of the pairs that were near each other, in ascending order, and their phases.
    pub phases: Vec<([usize; 2], Phase)>,
}

/// What is known of the states within the last step.
#[derive(Default)]
pub(super) struct Known {
    reached: Vec<Reached>,
    /// The earliest time that took too much work [s].
    too_far: Option<f64>,
}

/// A state of a body, from which later ones are computed.
struct Reached {
    body: usize,
    /// [s]
    time: f64,
    states: States,
    pushes: PushField,
}

/// The last step of a world of bodies on paths, recomputed from the state before it. The world is only read, and steps
/// that are not inspected cost nothing.
pub(crate) struct Recomputed<'a> {
    /// The world after the step.
    world: &'a World,
    /// Its bodies.
    prescribed: &'a Prescribed,
    before: Before,
    /// Simulated time after the step [s].
    end: f64,
    work: Tally<'a>,
}

impl<'a> Recomputed<'a> {
    /// The last step of the solver of `world`, which ended at `end` [s], recomputed within the limit of `work`; `None` for a
    /// coupled scene.
    pub fn new(world: &'a World, before: Before, end: f64, work: &'a Work) -> Option<Recomputed<'a>> {
        Some(Recomputed { world, prescribed: world.solver.prescribed()?, before, end, work: Tally::new(work, None) })
    }

    /// The path of a body.
    pub fn path(&self, index: usize) -> &Path {
        self.prescribed.tracks.path(index)
    }

    /// Whether the limit of work is reached: the states are then meaningless.
    pub fn is_over(&self) -> bool {
        self.work.is_over()
    }

    fn body(&self, index: usize) -> &Body {
        &self.prescribed.bodies[index]
    }

    /// The phase of a pair from `t` on.
    pub fn phase(&self, a: usize, b: usize, t: f64) -> Phase {
        let (a, b) = (a.min(b), a.max(b));
        let is_it = |x: usize, y: usize| (x, y) == (a, b);
        let mut events = self.world.report().events.iter();
        let last = events.rfind(|event| event.time <= t && is_it(event.a as usize, event.b as usize));
        let before = || self.before.phases.iter().find(|&&([a, b], _)| is_it(a, b)).map(|known| known.1);
        last.map(|event| event.to).or_else(before).unwrap_or(Phase::Apart)
    }

    /// The instants at which something jumps, and both ends of the step [s].
    pub fn breaks(&self) -> Vec<f64> {
        let scene = self.world.scene();
        let span = Span { start: self.before.time, end: self.end };
        let mut breaks = vec![span.start, span.end];
        span.jumps_of(scene, 0..(scene.bodies.len() + scene.points.len()) as u32, &mut breaks);
        for index in 0..self.world.body_count() {
            let Body { neighbours, points, .. } = self.body(index);
            self.on(index).jumps(neighbours, span, &mut breaks);
            self.on(index).jumps(points, span, &mut breaks);
        }
        breaks.sort_by(f64::total_cmp);
        breaks.dedup();
        breaks
    }

    /// The input of force terms for a body.
    fn on(&self, index: usize) -> On<'_, &Self> {
        self.body(index).on(self.world.scene(), index as u32, &self.prescribed.tracks, self)
    }

    /// What acts on a body at `t`, with the phases that hold from `phases_at` on.
    pub fn surroundings(&self, index: usize, t: f64, phases_at: f64, states: &States) -> Surroundings {
        let radius = self.world.scene().bodies[index].radius;
        let farthest = states.displacement.iter().map(DVec3::length).fold(0.0, f64::max) + radius;
        let mut surroundings = Surroundings::default();
        self.on(index).surroundings_into(Moment { time: t, phases_at, windows_at: t }, farthest, &mut surroundings);
        surroundings
    }

    /// The states after the step under the oscillators alone.
    pub fn flow(&self, index: usize, states: &States) -> States {
        let h = self.end - self.before.time;
        let [xx, xu, ux, uu] = self.world.scene().bodies[index].material.oscillator().flow(h);
        let both = || states.displacement.iter().zip(states.velocity.iter());
        States {
            displacement: both().map(|(x, u)| xx * x + xu * u).collect(),
            velocity: both().map(|(x, u)| ux * x + uu * u).collect(),
        }
    }

    /// Velocities after the forces have acted, and the resulting positions.
    pub fn predict(&self, index: usize, states: &States) -> States {
        let h = self.end - self.before.time;
        let scene = self.world.scene();
        let surroundings = self.surroundings(index, self.before.time, self.before.time, states);
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

    /// The states of a body at `time`, given those at the start of the step, and the [breaks](Recomputed::breaks). `None` if the
    /// limit of work is reached.
    pub fn at(&self, index: usize, time: f64, breaks: &[f64], start: impl FnOnce() -> States) -> Option<States> {
        /// Upper limits on the states of a body and on the vertices of all that are kept: a search asks for times ever closer to
        /// each other.
        const MOST: usize = 8;
        const MOST_VERTICES: usize = 1 << 20;

        let mut known = lock(&self.prescribed.known.0);
        let Known { reached, too_far } = known.get_or_insert_default();
        if too_far.is_some_and(|too_far| time >= too_far) {
            return None;
        }
        let before = reached.iter().filter(|of| of.body == index && of.time <= time);
        let (mut from, mut states, mut pushes) = match before.max_by(|one, other| one.time.total_cmp(&other.time)) {
            Some(of) => (of.time, of.states.clone(), of.pushes.clone()),
            None => (self.before.time, start(), self.pushes(index)),
        };
        let between = breaks.iter().copied().filter(|&at| from < at && at < time);
        for to in between.chain((from < time).then_some(time)).collect::<Vec<_>>() {
            self.advance(index, from, to, &mut states, &mut pushes);
            if self.is_over() {
                *too_far = Some(time);
                return None;
            }
            from = to;
        }
        let away = |of: &Reached| (of.time - time).abs();
        let own: Vec<usize> = (0..reached.len()).filter(|&at| reached[at].body == index).collect();
        if own.iter().any(|&at| reached[at].time == time) {
            return Some(states);
        }
        if let Some(&farthest) = own.iter().max_by(|&&x, &&y| away(&reached[x]).total_cmp(&away(&reached[y])))
            && own.len() == MOST
        {
            reached.swap_remove(farthest);
        }
        let vertices: usize = reached.iter().map(|of| of.states.displacement.len()).sum();
        if vertices + states.displacement.len() <= MOST_VERTICES {
            reached.push(Reached { body: index, time, states: states.clone(), pushes });
        }
        Some(states)
    }

    /// The pushes on a body, before it is [advanced](Recomputed::advance) from the start of the step.
    pub fn pushes(&self, index: usize) -> PushField {
        let (body, mut pushes) = (self.body(index), PushField::default());
        pushes.begin(&body.pushes, Span { start: self.before.time, end: self.end }, &every_vertex_of(body), LANES);
        pushes
    }

    /// Advances a body over an interval without a jump, each vertex separately. Intervals follow one another.
    pub fn advance(&self, index: usize, from: f64, to: f64, states: &mut States, pushes: &mut PushField) {
        let scene = self.world.scene();
        let (this, body) = (&scene.bodies[index], self.body(index));
        self.work.spend(body.pushes.len() as u64);
        let surroundings = self.surroundings(index, from, from, states);
        // a sphere may come within reach during the interval
        let mut spheres = Vec::new();
        let near: Vec<Neighbour> = body.neighbours.iter().chain(&body.points).copied().collect();
        self.on(index).over(&near, Span { start: from, end: to }, &mut spheres);
        let is_still = states.displacement.iter().chain(states.velocity.iter()).all(|v| v == DVec3::ZERO);
        if is_still && spheres.is_empty() && surroundings.is_idle() && self.path(index).is_fixed() {
            return;
        }
        let every = every_vertex_of(body);
        let changes = pushes.advance(from + 0.5 * (to - from), body.rest(), &every);
        self.work.spend((changes * every.len()) as u64);
        let tracks = &self.prescribed.tracks;
        let course = Course {
            scene,
            index,
            material: body.material,
            vertices: body.mesh.vertex_count(),
            start: from,
            length: to - from,
            tracks,
            is_whole: false,
            spheres: &spheres,
            local: pushes.local(),
        };
        let mut deformation = Deformation::default();
        deformation.wake_all(body.rest());
        let active_set = &mut deformation.active_set;
        for i in 0..body.rest().len() {
            active_set.set_state(i, State { x: states.displacement.get(i), u: states.velocity.get(i) });
        }
        active_set.pad_again();
        let mut carried = State { x: DVec3::ZERO, u: carry::kick(&body.material, self.path(index), from) };
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

fn every_vertex_of(body: &Body) -> Vec<u32> {
    (0..body.rest().len() as u32).collect()
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
