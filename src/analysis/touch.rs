//! Finds the times at which surfaces touch and part, and compares the surfaces of a pair when its phase changes.
//!
//! Times are found by bisection over the states within a step ([`Simulation::within`]). With the exponential
//! integrator, these states are its own solution: the step is repeated up to that time, so the error is within its
//! tolerance. This holds for bodies on paths and for free bodies. The explicit schemes use cubic Hermite interpolation
//! between steps, whose error is of fourth order in the step. So does the exponential integrator for a step of bodies
//! on paths in which forces jump more than 1024 times or that takes very much work, and for a step in which a large
//! scene has edits, or any scene more than sixteen. Centres on paths are always exact. Fourth is also the order of
//! `rk4`; with the other schemes, the times have the lower order of the scheme.

use std::{
    collections::BTreeMap,
    sync::{Arc, atomic::AtomicBool},
};

use glam::DVec3;

use super::surface::{Closed, for_all};
use crate::{
    geometry::{
        Vectors,
        union::{Aabb, Contact, Crossing, contact},
    },
    interrupt::is_raised,
    observe::{
        Frame, NearPair, PairEvent, PairFrame, Schema, Simulation, SurfaceEvent, Want, between, put_on_paths,
        state_within, surface::Finding,
    },
};

/// Precision of the times found [s].
const PRECISION: f64 = 1e-7;
/// Upper limit on the bisections within a step.
const MAX_BISECTIONS: u32 = 60;
/// Upper limit on the watched pairs. If there are more, the closest are watched.
const MAX_PAIRS: usize = 64;
/// Surfaces are compared within a step each time that they have moved by this much [radii of the smaller body], …
const FAR: f64 = 0.1;
/// … and each time that they have turned and vibrated by this much [radii of the smaller body], …
const FAR_AROUND: f64 = 0.125;
/// … which in surfaces that touch at both ends of the step must be more than this in all [radii of the smaller body].
const STIRRED: f64 = 0.3;
/// Least number of comparisons in a step in which something scheduled makes forces jump: no cubic follows that.
const AT_JUMPS: u32 = 4;
/// Largest number of comparisons in a step.
const MAX_SAMPLES: f64 = 256.0;
/// Largest number of comparisons in a step of all pairs together, unless each has no more than …
const MOST_COMPARED: usize = 2048;
/// … so many.
const LEAST_SAMPLES: usize = 32;
/// Surfaces are compared at an extremum of the centre distance that differs from it at the ends of the step by more than
/// this [radii of the smaller body].
const TREMBLE: f64 = 1e-6;
/// Upper limit on the phase changes of a step for which the surfaces are compared.
const MAX_CHANGES: usize = 16;

/// Watches the surfaces of pairs over successive steps.
pub struct Touches {
    schema: Schema,
    closed: Closed,
    pairs: BTreeMap<[usize; 2], Known>,
    /// State before the step.
    before: Frame,
    /// The motion of the pairs before the step.
    near: Vec<NearPair>,
    /// Scratch storage for it, reused.
    spare: Vec<NearPair>,
    /// Whether a state has been seen.
    has_begun: bool,
    /// Scratch storage, reused.
    inside: Frame,
    local: Vectors,
    placed: BTreeMap<usize, Vec<DVec3>>,
    interrupt: Option<&'static AtomicBool>,
    /// Whether the simulation has events of its own with the names of those that are found here: these are left out.
    has_own: bool,
}

/// The last known state of a pair.
#[derive(Clone, Copy, Default)]
struct Known {
    is_touching: bool,
    /// The last crossing of the surfaces that was found.
    crossing: Option<Crossing>,
    /// Time at which they began to touch [s].
    touched: Option<f64>,
}

/// Where the surfaces of a pair are compared within a step.
#[derive(Clone, Copy, Default)]
struct Samples {
    /// Number of instants, evenly spaced.
    count: u32,
    /// Time of an extremum of the centre distance [s], of a cubic between the ends of the step.
    extremum: Option<f64>,
}

/// A pair during a step.
struct Tracked {
    bodies: [usize; 2],
    /// Its last known state, and the time of that [s].
    last: Known,
    since: f64,
    /// Its state after the step.
    end: Known,
    samples: Samples,
}

impl Touches {
    /// Starts at the simulation's current state.
    pub fn new(simulation: &dyn Simulation) -> Touches {
        let schema = simulation.schema();
        let mut touches = Touches {
            closed: Closed::new(&schema, simulation.interrupt()),
            interrupt: simulation.interrupt(),
            pairs: BTreeMap::new(),
            before: Frame::default(),
            near: Vec::new(),
            spare: Vec::new(),
            has_begun: false,
            inside: Frame::default(),
            local: Vectors::default(),
            placed: BTreeMap::new(),
            has_own: schema.event_words().iter().any(|word| Finding::KINDS.iter().any(|(known, _)| known == word)),
            schema,
        };
        let mut now = Frame::default();
        simulation.observe(Want::default(), &mut now);
        touches.step(simulation, &now, &[], &mut Vec::new());
        touches
    }

    /// Finds the events of the last step, given its phase changes and the state `now` after it. Must be called after
    /// every step.
    ///
    /// Surfaces are compared at the end of the step and, for visits that are shorter than a step, at the extremum of the
    /// centre distance, each time that they have moved by a tenth of the smaller radius or turned and vibrated by an
    /// eighth, and several times where something scheduled, such as an edit, makes forces jump.
    pub fn step(
        &mut self,
        simulation: &dyn Simulation,
        now: &Frame,
        changes: &[PairEvent],
        found: &mut Vec<SurfaceEvent>,
    ) {
        self.find(simulation, now, changes, found);
        self.before.at = now.at;
        self.before.pairs.clone_from(&now.pairs);
        self.before.bodies.resize_with(now.bodies.len(), Default::default);
        for (from, to) in now.bodies.iter().zip(&mut self.before.bodies) {
            (to.centre, to.rotation, to.motion) = (from.centre, from.rotation, from.motion);
            (to.is_at_rest, to.max_displacement) = (from.is_at_rest, from.max_displacement);
            to.mesh.clone_from(&from.mesh);
            to.displacements.copy_from(&from.displacements);
            to.velocities.copy_from(&from.velocities);
        }
    }

    /// Like [`Touches::step`], but takes the state instead of a copy: `now` becomes scratch storage.
    pub fn step_and_take(
        &mut self,
        simulation: &dyn Simulation,
        now: &mut Frame,
        changes: &[PairEvent],
        found: &mut Vec<SurfaceEvent>,
    ) {
        self.find(simulation, now, changes, found);
        std::mem::swap(&mut self.before, now);
    }

    fn find(&mut self, simulation: &dyn Simulation, now: &Frame, changes: &[PairEvent], found: &mut Vec<SurfaceEvent>) {
        found.clear();
        let is_next = self.has_begun && now.at.step == self.before.at.step + 1;
        self.has_begun = true;
        let mut near = std::mem::take(&mut self.spare);
        simulation.near(&mut near);
        self.placed.clear();
        let own = simulation.contacts();
        let mut watched: Vec<PairFrame> = now.pairs.clone();
        // pairs that met and left within the step, and pairs in contact that are out of reach
        let met = changes.iter().take(MAX_CHANGES).map(|of| PairFrame::new(of.a, of.b, of.q, of.to));
        let touching = self.pairs.iter().filter(|(_, known)| known.is_touching).map(|(&[a, b], _)| {
            let [one, other] = [a, b].map(|body| (now.bodies[body].centre, self.schema.bodies[body].radius));
            PairFrame::new(a, b, one.0.distance(other.0) / (one.1 + other.1), 0)
        });
        for left in met.chain(touching) {
            if !watched.iter().any(|pair| (pair.a, pair.b) == (left.a, left.b)) {
                watched.push(left);
            }
        }
        if watched.len() > MAX_PAIRS {
            watched.sort_by(|x, y| x.q.total_cmp(&y.q).then((x.a, x.b).cmp(&(y.a, y.b))));
            watched.truncate(MAX_PAIRS);
        }
        let mut pairs = BTreeMap::new();
        let mut tracked = Vec::new();
        for pair in &watched {
            if is_raised(self.interrupt) {
                return; // no further step will be searched
            }
            let bodies = [pair.a, pair.b];
            let mut before = self.pairs.get(&bodies).copied();
            if before.is_none() && is_next && !self.before.pairs.iter().any(|known| [known.a, known.b] == bodies) {
                before = Some(Known::default()); // it was out of reach
            }
            let is_torn = bodies.iter().any(|&body| self.has_torn(body, now));
            if is_torn {
                // it consists of vertices of the former mesh
                before.iter_mut().for_each(|before| before.crossing = None);
            }
            let mut known = before.unwrap_or_default();
            if own.is_none() {
                if self.is_far(bodies, now) {
                    (known.is_touching, known.crossing) = (false, None);
                } else {
                    bodies.iter().for_each(|&body| self.place(body, now));
                    self.update_contact(bodies, &mut known);
                }
                if let Some(before) = before.filter(|_| is_next) {
                    let ends = [before, known];
                    let samples = if is_torn {
                        Samples::default()
                    } else {
                        self.samples(simulation, &near, bodies, ends, changes, now)
                    };
                    tracked.push(Tracked { bodies, last: before, since: self.before.at.time, end: known, samples });
                }
            }
            pairs.insert(bodies, known);
        }
        if self.track(simulation, &mut tracked, now, found).is_none() {
            return; // the times are not accurate yet
        }
        pairs.extend(tracked.into_iter().map(|pair| (pair.bodies, pair.last)));
        take(own.unwrap_or_default(), &mut pairs, found);
        if is_next {
            self.compare(simulation, now, &changes[..changes.len().min(MAX_CHANGES)], found);
        }
        if self.has_own {
            found.retain(|event| !event.is_contact());
        }
        found.sort_by(|x, y| x.time.total_cmp(&y.time));
        self.pairs = pairs;
        self.spare = std::mem::replace(&mut self.near, near);
    }

    /// Compares the surfaces of pairs at their changes of phase.
    fn compare(
        &mut self,
        simulation: &dyn Simulation,
        now: &Frame,
        changes: &[PairEvent],
        found: &mut Vec<SurfaceEvent>,
    ) {
        let (mut measures, mut placed) = (Vec::new(), Vec::new());
        for change in changes {
            if is_raised(self.interrupt) {
                return;
            }
            let Touches { schema, closed, local, inside, before, .. } = self;
            let bodies = [change.a, change.b];
            state_within(simulation, schema, [before, now], change.time, &bodies, inside);
            match schema.surfaces.get() {
                Some(own) => measures.push(own.measure(schema, inside, bodies, self.interrupt)),
                None => placed.push((bodies, bodies.map(|body| positions(schema, closed, body, inside, local)))),
            }
        }
        let Touches { schema, closed, .. } = &*self;
        measures.extend(for_all(&placed, |(bodies, [a, b])| closed.measure(schema, *bodies, [a, b])));
        for (change, measures) in changes.iter().zip(measures) {
            let PairEvent { time, step, a, b, q, name, .. } = *change;
            let known = self.pairs.get(&[a, b]).copied().unwrap_or_default();
            // what the last contact event before the change says
            let is_before =
                |event: &&SurfaceEvent| [event.a, event.b] == [a, b] && event.is_contact() && event.time <= time;
            let last = found.iter().filter(is_before).max_by(|x, y| x.time.total_cmp(&y.time));
            let (is_touching, touched) = match last {
                Some(last) if last.what == Finding::Touch => (true, Some(last.time)),
                Some(_) => (false, None),
                // what joins by a rule of its own may be joined from the start, of which there is no event
                None => {
                    let is_joined = self.has_own && measures.is_some_and(|measures| measures.gap <= 0.0);
                    (known.is_touching || is_joined, known.touched)
                }
            };
            let what = Finding::Phase { name, is_touching, touched, measures };
            found.push(SurfaceEvent { what, time, step, a, b, q });
        }
    }

    /// Tracks pairs through the step to `now`, and finds when they touch and part. `None` if it is interrupted.
    fn track(
        &mut self,
        simulation: &dyn Simulation,
        pairs: &mut [Tracked],
        now: &Frame,
        found: &mut Vec<SurfaceEvent>,
    ) -> Option<()> {
        // all pairs are compared at the same instants, because the simulation recomputes the step for each of them
        let ends = [self.before.at.time, now.at.time];
        let sampled = pairs.iter().filter(|pair| pair.samples.count > 0).count();
        let most = (MOST_COMPARED / sampled.max(1)).max(LEAST_SAMPLES) as u32;
        let count = pairs.iter().map(|pair| pair.samples.count).max().unwrap_or(0).min(most);
        let mut bodies: Vec<usize> =
            pairs.iter().filter(|pair| pair.samples.count > 0).flat_map(|pair| pair.bodies).collect();
        bodies.sort_unstable();
        bodies.dedup();
        let mut state = Frame::default();
        for k in 1..=count {
            let time = ends[0] + f64::from(k) / f64::from(count + 1) * (ends[1] - ends[0]);
            if is_raised(self.interrupt) {
                return None;
            }
            state_within(simulation, &self.schema, [&self.before, now], time, &bodies, &mut state);
            for pair in pairs.iter_mut().filter(|pair| pair.samples.count > 0) {
                self.compare_at_extremum(simulation, pair, time, now, found)?;
                let mut known = pair.last;
                self.update_contact_in(&state, pair.bodies, &mut known);
                self.advance(simulation, pair, known, time, now, found)?;
            }
        }
        for pair in pairs {
            self.compare_at_extremum(simulation, pair, ends[1], now, found)?;
            self.advance(simulation, pair, pair.end, ends[1], now, found)?;
        }
        Some(())
    }

    /// Compares the surfaces of a pair at the extremum of its centre distance, if that is before `end` [s]. The state is
    /// interpolated, which costs little; if it shows a change, the simulation recomputes it.
    fn compare_at_extremum(
        &mut self,
        simulation: &dyn Simulation,
        pair: &mut Tracked,
        end: f64,
        now: &Frame,
        found: &mut Vec<SurfaceEvent>,
    ) -> Option<()> {
        let Some(time) = pair.samples.extremum.take_if(|time| *time < end) else { return Some(()) };
        let mut inside = std::mem::take(&mut self.inside);
        let mut known = pair.last;
        for is_exact in [false, true] {
            let ends = [&self.before, now];
            if is_exact {
                state_within(simulation, &self.schema, ends, time, &pair.bodies, &mut inside);
            } else {
                between(&self.schema, ends, time, &pair.bodies, &mut inside);
                put_on_paths(simulation, time, &pair.bodies, &mut inside);
            }
            known = pair.last;
            self.update_contact_in(&inside, pair.bodies, &mut known);
            if !is_exact && known.is_touching == pair.last.is_touching {
                self.inside = inside;
                return Some(()); // which does not prove that there was no change before
            }
        }
        self.inside = inside;
        self.advance(simulation, pair, known, time, now, found)
    }

    /// Takes a pair to its state at a time within the step [s].
    fn advance(
        &mut self,
        simulation: &dyn Simulation,
        pair: &mut Tracked,
        known: Known,
        time: f64,
        now: &Frame,
        found: &mut Vec<SurfaceEvent>,
    ) -> Option<()> {
        let mut touched = pair.last.touched;
        if known.is_touching != pair.last.is_touching {
            let (time, q) = self.when(simulation, pair.bodies, pair.last, now, [pair.since, time]);
            if is_raised(self.interrupt) {
                return None;
            }
            let (what, [a, b]) = (if known.is_touching { Finding::Touch } else { Finding::Part }, pair.bodies);
            touched = known.is_touching.then_some(time);
            found.push(SurfaceEvent { what, time, step: now.at.step, a, b, q });
        }
        (pair.last, pair.since) = (Known { touched, ..known }, time);
        Some(())
    }

    /// Where within the step to `now` the surfaces of a pair have to be compared, given its states at both ends.
    fn samples(
        &self,
        simulation: &dyn Simulation,
        near: &[NearPair],
        bodies: [usize; 2],
        [before, known]: [Known; 2],
        changes: &[PairEvent],
        now: &Frame,
    ) -> Samples {
        let ends = [self.before.at.time, now.at.time];
        let [radius, other_radius] = bodies.map(|body| self.schema.bodies[body].radius);
        let smaller = radius.min(other_radius);
        let count =
            |path: f64, around: f64| (path / (FAR * smaller) + around / (FAR_AROUND * smaller)).min(MAX_SAMPLES) as u32;
        let apart = |frame: &Frame| frame.bodies[bodies[1]].centre - frame.bodies[bodies[0]].centre;
        let is_it = |pair: &&NearPair| [pair.a, pair.b] == bodies;
        let (Some(from), Some(to)) = (self.near.iter().find(is_it), near.iter().find(is_it)) else {
            // it came within reach in this step, or left
            return Samples { count: count(apart(now).distance(apart(&self.before)), 0.0).max(1), extremum: None };
        };
        let span = ends[1] - ends[0];
        let path = from.path_length(to, simulation, ends).max(0.5 * (from.rate.length() + to.rate.length()) * span);
        let [time, distance] = from.extremum(to, simulation, ends, before.is_touching);
        // where forces jump, the cubic that the extremum comes from is no bound
        let next = self.schema.scheduled.partition_point(|of| of.time <= ends[0]);
        let is_scheduled = self.schema.scheduled.get(next).is_some_and(|of| of.time < ends[1]);
        let jumps =
            is_scheduled || changes.iter().any(|change| bodies.contains(&change.a) || bodies.contains(&change.b));
        let least = if jumps { 0.5 * (from.apart.length() + to.apart.length() - path) } else { distance };
        let displaced = |frame: &Frame, body: usize| frame.bodies.get(body).map_or(0.0, |body| body.max_displacement);
        let displaced = bodies.map(|body| displaced(&self.before, body).max(displaced(now, body)));
        // surfaces move as bodies turn and vibrate, too
        let around = bodies.map(|body| f64::max(self.surface_speed(body, &self.before), self.surface_speed(body, now)));
        let around = span * (around[0] + around[1]);
        let reach = radius + other_radius + displaced.iter().sum::<f64>() + 0.5 * around;
        let has_changed = before.is_touching != known.is_touching;
        if !before.is_touching && !has_changed && least > reach * (1.0 + 1e-9) {
            return Samples::default();
        }
        // bodies at rest on each other tremble by less than any visit
        let far = [from, to].map(|pair| (pair.apart.length() - distance).abs()).into_iter().fold(f64::MAX, f64::min);
        let is_turning = !has_changed && ends[0] < time && time < ends[1] && far > TREMBLE * smaller;
        let is_held = before.is_touching && known.is_touching && around < STIRRED * smaller;
        let count = count(path, if is_held { 0.0 } else { around }).max(if is_scheduled { AT_JUMPS } else { 0 });
        Samples { count, extremum: is_turning.then_some(time) }
    }

    /// An upper bound on the speed of a body's surface relative to its centre in a frame [scene unit/s].
    fn surface_speed(&self, body: usize, frame: &Frame) -> f64 {
        let Some(now) = frame.bodies.get(body) else { return 0.0 };
        let spin = now.motion.map_or(0.0, |motion| motion.spin.length());
        let vibration =
            if now.is_at_rest { 0.0 } else { now.velocities.iter().map(DVec3::length_squared).fold(0.0, f64::max) };
        spin * (self.schema.bodies[body].radius + now.max_displacement) + vibration.sqrt()
    }

    /// Time at which the surfaces of a pair touched or parted between two times in the step [s], and q at that time.
    fn when(
        &mut self,
        simulation: &dyn Simulation,
        bodies: [usize; 2],
        before: Known,
        now: &Frame,
        ends: [f64; 2],
    ) -> (f64, f64) {
        let [mut low, mut high] = ends;
        let mut inside = std::mem::take(&mut self.inside);
        let mut known = before;
        for _ in 0..MAX_BISECTIONS {
            let middle = 0.5 * (low + high);
            if high - low <= PRECISION || middle <= low || middle >= high || is_raised(self.interrupt) {
                break;
            }
            state_within(simulation, &self.schema, [&self.before, now], middle, &bodies, &mut inside);
            self.update_contact_in(&inside, bodies, &mut known);
            if known.is_touching == before.is_touching { low = middle } else { high = middle }
        }
        state_within(simulation, &self.schema, [&self.before, now], high, &bodies, &mut inside);
        let [a, b] = bodies;
        let radii = self.schema.bodies[a].radius + self.schema.bodies[b].radius;
        let q = inside.bodies[a].centre.distance(inside.bodies[b].centre) / radii;
        self.inside = inside;
        (high, q)
    }

    /// Computes the positions of a body in the world, unless they are known.
    fn place(&mut self, body: usize, frame: &Frame) {
        let Touches { schema, local, placed, closed, .. } = self;
        placed.entry(body).or_insert_with(|| positions(schema, closed, body, frame, local));
    }

    /// Whether a body has another mesh than before the step.
    fn has_torn(&self, body: usize, now: &Frame) -> bool {
        let mesh = |frame: &Frame| frame.bodies.get(body).and_then(|body| body.mesh.as_ref().map(Arc::as_ptr));
        mesh(&self.before) != mesh(now)
    }

    /// Whether two bodies are so far apart that no vertex needs testing.
    fn is_far(&self, bodies: [usize; 2], now: &Frame) -> bool {
        let [a, b] = bodies.map(|body| &now.bodies[body]);
        let reach: f64 =
            bodies.map(|body| self.schema.bodies[body].radius + now.bodies[body].max_displacement).iter().sum();
        a.centre.distance(b.centre) > reach * (1.0 + 1e-9)
    }

    /// Updates whether the surfaces of a pair touch, at their positions in a frame within the step.
    fn update_contact_in(&mut self, inside: &Frame, bodies: [usize; 2], known: &mut Known) {
        for body in bodies {
            self.placed.remove(&body);
            self.place(body, inside);
        }
        self.update_contact(bodies, known);
    }

    /// Updates whether the surfaces of a pair touch, at their current positions.
    fn update_contact(&self, [a, b]: [usize; 2], known: &mut Known) {
        let (Some(first), Some(second)) = (self.placed.get(&a), self.placed.get(&b)) else { return };
        if known.crossing.is_some_and(|crossing| crossing.is_at(first, second)) {
            known.is_touching = true;
            return;
        }
        let [bounds, other_bounds] = [first, second].map(|of| Aabb::of(of.iter().copied()));
        if !bounds.meets(&other_bounds) {
            (known.is_touching, known.crossing) = (false, None);
            return;
        }
        let closed = &self.closed;
        let bodies = (closed.body(a, first), closed.body(b, second));
        let found = if let (Some(a), Some(b)) = bodies { contact(&a, &b) } else { None };
        known.is_touching = found.is_some();
        known.crossing = match found {
            Some(Contact::Crossing(crossing)) => Some(crossing),
            _ => None,
        };
    }
}

/// The positions of a body in the world.
fn positions(schema: &Schema, closed: &mut Closed, body: usize, frame: &Frame, local: &mut Vectors) -> Vec<DVec3> {
    let now = &frame.bodies[body];
    closed.tear(body, now.mesh.as_ref());
    now.local_positions(now.rest_of(&schema.bodies[body]), local);
    local.iter().map(|position| position + now.centre).collect()
}

/// Adds touch and part events that the simulation found itself.
fn take(own: &[SurfaceEvent], pairs: &mut BTreeMap<[usize; 2], Known>, found: &mut Vec<SurfaceEvent>) {
    for event in own {
        if let Some(known) = pairs.get_mut(&[event.a, event.b]) {
            known.is_touching = event.what == Finding::Touch;
            known.touched = known.is_touching.then_some(event.time);
        }
        found.push(*event);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{World, scene::Scene};

    fn found(text: &str, dt: f64) -> Vec<SurfaceEvent> {
        let mut scene = Scene::parse(text, "test").unwrap();
        scene.dt = dt;
        let steps = scene.steps();
        let mut world = World::new(scene).unwrap();
        let mut touches = Touches::new(&world);
        let (mut all, mut of_step) = (Vec::new(), Vec::new());
        let (mut summary, mut frame) = (crate::observe::StepSummary::default(), Frame::default());
        for _ in 0..steps {
            summary.clear();
            Simulation::step(&mut world, &mut summary);
            world.observe(Want::default(), &mut frame);
            touches.step(&world, &frame, &summary.events, &mut of_step);
            all.append(&mut of_step);
        }
        all
    }

    /// b jumps into a, within a step: the surfaces overlap when the phase changes.
    #[test]
    fn bodies_that_jump_together_are_not_apart() {
        let body = |name: &str, motion: &str| format!("[[body]]\nname = '{name}'\nradius = 1.0\nmotion = {motion}\n");
        let still =
            "duration = 1.0\n[influence]\nalpha = 0\nbeta = 0\n".to_owned() + &body("a", "{ fixed = [0, 0, 0] }");
        for at in [0.3, 0.5737410169338213] {
            let jump =
                format!("{{ keyframes = {{ keys = [[0, 4, 0, 0], [{at}, 1, 0, 0]], interpolation = 'hold' }} }}");
            let text = format!("{still}{}", body("b", &jump));
            let schema = Simulation::schema(&World::new(Scene::parse(&text, "test").unwrap()).unwrap());
            let found = found(&text, 0.02);
            let merge = found.iter().find(|event| event.name() == "merge").unwrap();
            assert!(merge.describe(&schema).contains("overlap 30.6 %"), "{}", merge.describe(&schema));
        }
    }

    /// In a scene of many bodies, too, a pair that comes within reach is followed from the step before on, even where the
    /// simulation knows no states within a step.
    #[test]
    fn a_pair_that_comes_within_reach_among_many_touches_when_its_surfaces_do() {
        let text = "duration = 2.0\nintegrator = \"verlet\"\n[influence]\nalpha = 0\nbeta = 0\n\
                    [[grid]]\nname = \"far\"\ncount = [70, 1, 1]\nspacing = [9, 0, 0]\nradius = 1.0\n\
                    shape = { sphere = { stacks = 3, slices = 4 } }\nmotion = { free = { from = [0, 50, 0] } }\n\
                    [[body]]\nname = \"a\"\nradius = 1.0\nmotion = { free = { from = [-1.9, 0, 0], velocity = [1, 0, 0] } }\n\
                    [[body]]\nname = \"b\"\nradius = 1.0\nmotion = { free = { from = [1.9, 0, 0], velocity = [-1, 0, 0] } }\n";
        let found = found(text, 1.0 / 60.0);
        let touches: Vec<_> = found.iter().filter(|event| event.what == Finding::Touch).collect();
        assert_eq!(touches.len(), 1, "{touches:?}");
        assert!((touches[0].time - 0.9).abs() < 1e-6 && (touches[0].q - 1.0).abs() < 1e-6, "{touches:?}");
    }

    #[test]
    fn spheres_on_paths_touch_and_part_at_the_exact_times() {
        // poles and equators are vertices, so along an axis the meshes touch where the spheres do
        for (along, radius) in [("[1, 0, 0]", 0.5), ("[0, 0, 1]", 0.5), ("[0, 1, 0]", 1.25)] {
            let from = along.replace('1', "-4");
            let text = format!(
                "duration = 8.0\n[influence]\nalpha = 0\nbeta = 0\nreach = 3\n[[body]]\nname = \"a\"\nradius = 1.0\n\
                 motion = {{ fixed = [0, 0, 0] }}\n[[body]]\nname = \"b\"\nradius = {radius}\n\
                 motion = {{ line = {{ from = {from}, velocity = {along} }} }}\n"
            );
            let events = found(&text, 1.0 / 60.0);
            let of = |what: Finding| {
                let times: Vec<f64> =
                    events.iter().filter(|event| event.what == what).map(|event| event.time).collect();
                assert_eq!(times.len(), 1, "{events:?}");
                times[0]
            };
            let (touch, part) = (of(Finding::Touch), of(Finding::Part));
            assert!((touch - (4.0 - 1.0 - radius)).abs() < 1e-6, "{along}: {touch}");
            assert!((part - (4.0 + 1.0 + radius)).abs() < 1e-6, "{along}: {part}");
        }
    }

    /// A small body shoots past a large one: they touch for 12 ms, between two steps of 17 ms, in every model.
    #[test]
    fn a_visit_within_a_step_is_a_touch_and_a_part() {
        use crate::{models::SceneRun, observe::Experiment, scene::Model, sim::Options};
        // metaballs join at a distance
        let side = |model| if model == Model::Metaballs { 2.1 } else { 1.3 };
        for model in Model::ALL {
            let side = side(model);
            let text = format!(
                "duration = 0.2\nmodel = \"{model}\"\n[influence]\nalpha = 0\nbeta = 0\nreach = 3\n[[body]]\nname = \"a\"\n\
                 radius = 1.0\nmotion = {{ fixed = [0, 0, 0] }}\n[[body]]\nname = \"b\"\nradius = 0.5\n\
                 motion = {{ line = {{ from = [-11, {side}, 0], velocity = [120, 0, 0] }} }}\n"
            );
            let scene = Scene::parse(&text, "visit").unwrap();
            let steps = scene.steps();
            let mut simulation = SceneRun { scene, options: Options::default() }.start().unwrap();
            let (mut touches, mut all, mut of_step) = (Touches::new(&*simulation), Vec::new(), Vec::new());
            let (mut summary, mut frame) = (crate::observe::StepSummary::default(), Frame::default());
            for _ in 0..steps {
                summary.clear();
                simulation.step(&mut summary);
                simulation.observe(Want::default(), &mut frame);
                touches.step(&*simulation, &frame, &summary.events, &mut of_step);
                all.extend(of_step.drain(..).filter(SurfaceEvent::is_contact));
            }
            let [touch, part] = all[..] else { panic!("{model}: {all:?}") };
            assert_eq!(
                (touch.what, part.what, touch.step, part.step),
                (Finding::Touch, Finding::Part, 6, 6),
                "{model}"
            );
            let middle = 11.0 / 120.0;
            assert!(touch.time < middle && middle < part.time && part.time - touch.time < 0.0167, "{model}: {all:?}");
        }
    }

    /// A body that swings through the place where it touches another two and a half times in a step.
    #[test]
    fn all_visits_within_a_step_are_found() {
        let text = "duration = 0.5\n[influence]\nalpha = 0\nbeta = 0\nreach = 3\n[[body]]\nname = \"a\"\nradius = 1.0\n\
                    motion = { fixed = [0, 0, 0] }\n[[body]]\nname = \"b\"\nradius = 1.0\nresponse = \"rigid\"\n\
                    motion = { sine = { center = [2.05, 0, 0], amplitude = [-0.2, 0, 0], frequency = 5.0 } }\n";
        let early = 0.25f64.asin() / (10.0 * std::f64::consts::PI);
        let expected = [early, 0.1 - early, 0.2 + early, 0.3 - early, 0.4 + early, 0.5 - early];
        let events: Vec<_> = found(text, 0.5).into_iter().filter(SurfaceEvent::is_contact).collect();
        assert_eq!(events.len(), expected.len(), "{events:?}");
        for (k, (event, expected)) in events.iter().zip(expected).enumerate() {
            assert_eq!(event.what, if k % 2 == 0 { Finding::Touch } else { Finding::Part }, "{events:?}");
            assert!((event.time - expected).abs() < PRECISION, "{events:?}");
        }
    }

    /// Bodies whose spheres are too small to act before they touch, on paths and free.
    #[test]
    fn bodies_touch_before_their_spheres_reach() {
        for motion in
            ["line = { from = [4, 0, 0], velocity = [-2, 0, 0] }", "free = { from = [4, 0, 0], velocity = [-2, 0, 0] }"]
        {
            let text = format!(
                "duration = 1.5\n[influence]\nalpha = 0\nbeta = 0\nreach = 0.6\nmerge_at = 0.3\nsplit_at = 0.4\ncore_at = 0.2\n\
                 [[body]]\nname = \"a\"\nradius = 1.0\nmotion = {{ fixed = [0, 0, 0] }}\n[[body]]\nname = \"b\"\nradius = 1.0\n\
                 motion = {{ {motion} }}\n"
            );
            let events: Vec<_> = found(&text, 1.0 / 60.0).into_iter().filter(SurfaceEvent::is_contact).collect();
            let [touch] = events[..] else { panic!("{motion}: {events:?}") };
            assert!(touch.what == Finding::Touch && (touch.time - 1.0).abs() < PRECISION, "{motion}: {touch:?}");
        }
    }

    #[test]
    fn a_pair_that_leaves_its_reach_within_a_step_parts() {
        let text = "duration = 1.0\n[influence]\nalpha = 0\nbeta = 0\nreach = 1.1\n[[body]]\nname = \"a\"\nradius = 1.0\n\
                    motion = { fixed = [0, 0, 0] }\n[[body]]\nname = \"b\"\nradius = 1.0\n\
                    motion = { line = { from = [1.8, 0, 0], velocity = [3, 0, 0] } }\n";
        let events: Vec<_> = found(text, 0.5).into_iter().filter(SurfaceEvent::is_contact).collect();
        let [part] = events[..] else { panic!("{events:?}") };
        assert!(part.what == Finding::Part && (part.time - 0.2 / 3.0).abs() < PRECISION, "{events:?}");
    }

    /// Merged where the surfaces begin to touch: the remark does not say that they touch before they do.
    #[test]
    fn surfaces_that_do_not_touch_yet_are_apart() {
        let text = "duration = 4.0\n[influence]\nalpha = 0\nbeta = 0\nreach = 3\nmerge_at = 1.0\n[[body]]\nname = \"a\"\n\
                    radius = 1.0\nmotion = { fixed = [0, 0, 0] }\n[[body]]\nname = \"b\"\nradius = 0.5\n\
                    motion = { line = { from = [-4.003, 0, 0], velocity = [1, 0, 0] } }\n";
        let events = found(text, 1.0 / 60.0);
        let of = |name: &str| events.iter().find(|event| event.name() == name).unwrap();
        let (merge, touch) = (of("merge"), of("touch"));
        assert!(merge.time <= touch.time, "{merge:?} {touch:?}");
        assert_eq!(merge.findings().as_deref(), Some("surfaces 0.000 R apart"));
    }

    #[test]
    fn a_falling_body_touches_and_parts_at_the_exact_times() {
        // onto a fixed body, and onto one that oscillates as a whole
        for (motion, swing) in [
            ("{ fixed = [0, 0, 0] }", 0.0),
            ("{ sine = { center = [0, 0, 0], amplitude = [0, 0, 0.3], frequency = 0.5 } }", 0.3),
        ] {
            let text = format!(
                "duration = 1.2\ngravity = [0, 0, -9.8]\n[influence]\nalpha = 0\nbeta = 0\n[[body]]\nname = \"a\"\n\
                 radius = 1.0\nresponse = \"rigid\"\nmotion = {motion}\n[[body]]\nname = \"b\"\nradius = 0.5\n\
                 motion = {{ free = {{ from = [0, 0, 3], velocity = [0, 0, 0.7] }} }}\n"
            );
            let events = found(&text, 1.0 / 60.0);
            for (what, distance) in [(Finding::Touch, 1.5), (Finding::Part, -1.5)] {
                let above = |t: f64| 3.0 + 0.7 * t - 4.9 * t * t - swing * (std::f64::consts::PI * t).sin() - distance;
                let (mut low, mut high) = (0.2, 1.2);
                for _ in 0..60 {
                    let middle = 0.5 * (low + high);
                    if above(middle) > 0.0 { low = middle } else { high = middle }
                }
                let times: Vec<f64> = events.iter().filter(|of| of.what == what).map(|of| of.time).collect();
                assert!(times.len() == 1 && (times[0] - low).abs() < 1e-6, "{motion} {what:?}: {times:?}, not {low}");
            }
        }
    }

    /// Two free spheres, one of them spinning, that deform each other before and while they touch.
    const FREE: &str = "duration = 0.7\n[influence]\nreach = 1.8\n[[body]]\nname = \"a\"\nradius = 1.0\nmotion = { free = \
        { from = [0, 0, 0], velocity = [1.5, 0, 0], spin = [0.3, 1.0, 2.0] } }\n[[body]]\nname = \"b\"\nradius = 0.8\n\
        motion = { free = { from = [2.6, 0.25, 0.1], velocity = [-1.2, 0, 0] } }\n";

    fn touches_of(text: &str, dt: f64) -> Vec<f64> {
        let touches = found(text, dt).into_iter().filter(|event| event.what == Finding::Touch);
        touches.map(|event| event.time).collect()
    }

    #[test]
    fn touch_times_of_free_spheres_match_a_converged_run() {
        let converged = touches_of(&format!("tolerance = 1e-10\n{FREE}"), 1.0 / 960.0);
        for dt in [1.0 / 60.0, 1.0 / 25.0, 1.0 / 10.0] {
            let times = touches_of(FREE, dt);
            assert_eq!(times.len(), 1, "{times:?}");
            assert!((times[0] - converged[0]).abs() < 1e-6, "dt {dt}: {} instead of {}", times[0], converged[0]);
        }
    }

    /// An edit divides a step: states are found in its parts, before the edit, between edits, and after them.
    #[test]
    fn surfaces_touch_at_the_same_time_in_a_step_with_edits() {
        let body = |name: &str, motion: &str| format!("[[body]]\nname = \"{name}\"\nradius = 1.0\nmotion = {motion}\n");
        let moving = "from = [2.2, 0.1, 0], velocity = [-2, 0, 0]";
        for [a, b] in [
            ["{ free = { from = [0, 0, 0] } }".to_owned(), format!("{{ free = {{ {moving} }} }}")],
            ["{ fixed = [0, 0, 0] }".to_owned(), format!("{{ line = {{ {moving} }} }}")],
            [
                "{ sine = { center = [0, 0, 0], amplitude = [0.1, 0.2, 0], frequency = 1.5 } }".to_owned(),
                format!("{{ line = {{ {moving} }} }}"),
            ],
        ] {
            for edits in [&[0.122][..], &[0.115, 0.13], &[0.1, 0.118]] {
                let edit =
                    |time: &f64| format!("[[edit]]\ntime = {time}\nset = {{ \"influence.beta\" = {} }}\n", 1e3 * time);
                let text = format!(
                    "duration = 0.5\n[material]\nomega = 30.0\ndamping = 1.0\n[influence]\nalpha = 20.0\nbeta = 20.0\n\
                     merge_at = 0.6\nsplit_at = 0.7\n{}{}{}",
                    body("a", &a),
                    body("b", &b),
                    edits.iter().map(edit).collect::<String>()
                );
                let first = |dt: f64| touches_of(&text, dt)[0];
                let fine = first(1.0 / 960.0);
                for dt in [1.0 / 60.0, 0.05, 0.1] {
                    let coarse = first(dt);
                    assert!((coarse - fine).abs() < 2e-7, "{b}, {edits:?}, {dt}: {coarse} instead of {fine}");
                }
            }
        }
    }

    /// The corners of an octahedron that turns by a radian a step dip into a sphere beside it, four times a turn.
    #[test]
    fn surfaces_that_turn_within_a_step_touch_as_in_shorter_steps() {
        let text = "duration = 0.5\n[material]\nomega = 400.0\n[influence]\nalpha = 0\nbeta = 0\nmerge_at = 0.3\nsplit_at = 0.4\n\
            [[body]]\nname = \"a\"\nradius = 1.0\nshape = { sphere = { stacks = 2, slices = 4 } }\n\
            motion = { free = { from = [0, 0, 0], spin = [0, 0, 60] } }\n\
            [[body]]\nname = \"b\"\nradius = 1.0\nmotion = { fixed = [1.9, 0, 0] }\n";
        let [coarse, fine] = [1.0 / 60.0, 1.0 / 960.0].map(|dt| touches_of(text, dt));
        assert!(fine.len() >= 18, "{fine:?}");
        assert_eq!(coarse.len(), fine.len(), "{coarse:?} {fine:?}");
        let far = coarse.iter().zip(&fine).map(|(coarse, fine)| (coarse - fine).abs()).fold(0.0, f64::max);
        assert!(far < 2e-7, "{far}: {coarse:?} {fine:?}");
    }

    /// The tip of an octahedron brushes an edge for less than a step, six times.
    #[test]
    fn a_tip_that_brushes_an_edge_within_a_step_touches() {
        let text = "duration = 1.0\n[material]\nomega = 4000.0\ndamping = 0.0\n\
            [influence]\nalpha = 0\nbeta = 0\nmerge_at = 0.3\nsplit_at = 0.4\n\
            [[body]]\nname = \"a\"\nradius = 1.0\nshape = { sphere = { stacks = 2, slices = 4 } }\n\
            motion = { free = { from = [0, 0, 0], spin = [0, 0, 10] } }\n\
            [[body]]\nname = \"b\"\nradius = 1.0\nshape = { sphere = { stacks = 2, slices = 3 } }\n\
            motion = { fixed = [1.498, 0, 0] }\n";
        // while cos θ > 0.998
        let half = libm::acos(0.998) / 10.0;
        for dt in [0.01, 1.0 / 60.0, 0.025, 0.05] {
            let touches = touches_of(text, dt);
            assert_eq!(touches.len(), 6, "{dt}: {touches:?}");
            for (number, touch) in (1..).zip(touches) {
                let expected = 0.05 * std::f64::consts::PI * f64::from(number) - half;
                assert!((touch - expected).abs() < 2e-5, "{dt}: {touch}, not {expected}");
            }
        }
    }

    /// Stiff springs take many steps of the integrator in each of these: more than a step is usually allowed.
    #[test]
    fn surfaces_touch_at_the_same_time_in_a_long_step() {
        let text = "duration = 1.0\n[material]\nomega = 30\ndamping = 0.2\n[influence]\nalpha = 300\nbeta = 100\n\
            merge_at = 1.05\nsplit_at = 1.06\n[[body]]\nname = \"a\"\nradius = 1.0\n\
            motion = { sine = { center = [0, 0, 0], amplitude = [0.2, 0, 0], frequency = 3 } }\n\
            [[body]]\nname = \"b\"\nradius = 0.8\nmotion = { line = { from = [2.6, 0.2, 0], velocity = [-1.2, 0, 0] } }\n";
        let times = |dt: f64| -> Vec<f64> {
            found(text, dt).into_iter().filter(SurfaceEvent::is_contact).map(|event| event.time).collect()
        };
        let fine = times(1.0 / 240.0);
        for dt in [0.25, 0.1] {
            let coarse = times(dt);
            assert_eq!(coarse.len(), fine.len(), "{dt}: {coarse:?} {fine:?}");
            assert!(
                coarse.iter().zip(&fine).all(|(one, other)| (one - other).abs() < 2e-7),
                "{dt}: {coarse:?} {fine:?}"
            );
        }
    }

    /// In a long step, an extremum of the distance at which an interpolated state shows no contact is no end of the interval
    /// that is searched, and a body swings there and back.
    #[test]
    fn paths_that_turn_within_a_step_touch_at_the_same_times() {
        let of = |radius: f64, [stacks, slices]: [u32; 2], motion: &str, name: &str| {
            format!(
                "[[body]]\nname = '{name}'\nradius = {radius}\nshape = {{ sphere = {{ stacks = {stacks}, slices = {slices} }} }}\n\
                 motion = {{ {motion} }}\n"
            )
        };
        let head = |damping: f64, merge_at: f64| {
            format!(
                "duration = 2.0\n[material]\nomega = 60.0\ndamping = {damping}\nresponse = 'rigid'\n[influence]\nalpha = 20.0\n\
                 beta = 200.0\nreach = 2.0\nmerge_at = {merge_at}\nsplit_at = 1.35\ncore_at = 0.0\n"
            )
        };
        let sine = |center: &str, amplitude: &str, rest: &str| {
            format!("sine = {{ center = [{center}], amplitude = [{amplitude}], {rest} }}")
        };
        let vibrating = head(0.3, 1.05)
            + &of(1.0, [8, 12], "fixed = [-0.271, -0.09, 0.035]", "a")
            + &of(
                1.0,
                [6, 8],
                "keyframes = { keys = [[0, 0.877, 0.086, 0.116], [0.652, 1.167, 0.051, -0.065], [1.369, 0.747, 0.21, 0.427]] }",
                "b",
            )
            + &of(
                0.7,
                [8, 12],
                &sine("3.221, -0.195, -0.022", "-0.539, -0.279, -0.137", "frequency = 2.868, phase = -0.329"),
                "c",
            );
        let swinging = head(8.0, 0.8)
            + &of(
                1.0,
                [8, 12],
                &sine("-0.408, 0.299, -0.12", "-0.502, 0.03, -0.138", "frequency = 0.59, phase = 2.555"),
                "a",
            )
            + &of(
                0.7,
                [12, 24],
                &sine("1.194, -0.103, -0.295", "0.776, 0.459, -0.388", "frequency = 3.716, phase = 1.746"),
                "b",
            );
        let times = |text: &str, dt: f64| -> Vec<f64> {
            found(text, dt).into_iter().filter(SurfaceEvent::is_contact).map(|event| event.time).collect()
        };
        for text in [vibrating, swinging] {
            let fine = times(&text, 1.0 / 60.0);
            for dt in [0.1, 0.25] {
                let coarse = times(&text, dt);
                assert_eq!(coarse.len(), fine.len(), "{dt}: {coarse:?} {fine:?}");
                let is_same = coarse.iter().zip(&fine).all(|(one, other)| (one - other).abs() < 2e-7);
                assert!(is_same, "{dt}: {coarse:?} {fine:?}");
            }
        }
    }

    /// A strongly deformed body leaves the reach of another that its surface still touches.
    #[test]
    fn a_contact_beyond_the_reach_of_spheres_ends() {
        let body = |name: &str, radius: f64, from: &str, velocity: &str, spin: &str| {
            format!(
                "[[body]]\nname = '{name}'\nradius = {radius}\nshape = {{ sphere = {{ stacks = 5, slices = 6 }} }}\n\
                 motion = {{ free = {{ from = [{from}], velocity = [{velocity}], spin = [{spin}] }} }}\n"
            )
        };
        let text =
            "duration = 1.7\ngravity = [0, 0, -3]\n[material]\nomega = 5.0\ndamping = 0.0\n[influence]\nalpha = 50.0\n\
                    beta = 60.0\nmerge_at = 0.8\nsplit_at = 1.2\n"
                .to_owned()
                + &body("a", 0.6, "-0.061, -0.356, 0.37", "2.34, 0.464, 0", "2.679, -3.363, 5.191")
                    .replace("5, slices = 6", "8, slices = 12")
                + &body("b", 1.0, "2.196, -0.374, -0.197", "0, -0.491, 0", "3.177, -4.984, 3.805")
                + &body("c", 1.0, "4.142, -0.169, -0.008", "-2.54, -0.108, 0", "1.841, -3.657, -3.822")
                + "[[push]]\nbody = 'a'\ndirection = [1, 0, 0]\nstrength = 200\nstart = 0.933\nduration = 0.1\n";
        for dt in [0.02, 0.005] {
            let events = found(&text, dt);
            let last = events.iter().rfind(|event| event.is_contact() && [event.a, event.b] == [0, 2]);
            let last = last.unwrap_or_else(|| panic!("{dt}: {events:?}"));
            assert!(last.what == Finding::Part && (last.time - 1.5259348).abs() < 3e-7, "{dt}: {last:?}");
        }
    }

    /// The cubic interpolation preserves the order of the explicit schemes if no phase changes earlier.
    #[test]
    fn touches_of_explicit_schemes_converge() {
        let text = FREE.replace("reach = 1.8", "reach = 1.8\nbeta = 10\nmerge_at = 0.4\nsplit_at = 0.5");
        let converged = touches_of(&text, 1.0 / 240.0)[0];
        // measured: 9e-4 and 2.3e-4, 5e-5 and 4e-6, 1.1e-6 and the error of the bisection
        for (scheme, largest, least_gain) in [("euler", 2e-3, 3.5), ("verlet", 1e-4, 10.0), ("rk4", 3e-6, 5.0)] {
            let text = format!("integrator = \"{scheme}\"\n{text}");
            let errors = [1.0 / 60.0, 1.0 / 240.0].map(|dt| (touches_of(&text, dt)[0] - converged).abs());
            assert!(errors[0] < largest && errors[0] > least_gain * errors[1], "{scheme}: {errors:?}");
        }
    }

    #[test]
    fn deformed_bodies_touch_at_the_same_time_in_shorter_steps() {
        for name in ["two", "collide"] {
            let text = crate::scene::builtin::ALL.iter().find(|scene| scene.name == name).unwrap().text;
            check_in_shorter_steps(text, if name == "two" { 960.0 } else { 240.0 });
        }
    }

    fn check_in_shorter_steps(text: &str, rate: f64) {
        let (coarse, fine) = (found(text, 1.0 / 60.0), found(text, 1.0 / rate));
        let times = |events: &[SurfaceEvent], what: &str| -> Vec<f64> {
            events.iter().filter(|event| event.name() == what).map(|event| event.time).collect()
        };
        for what in ["touch", "part", "merge", "split"] {
            let (coarse, fine) = (times(&coarse, what), times(&fine, what));
            let is_there = !coarse.is_empty() || !["touch", "merge"].contains(&what);
            assert!(is_there && coarse.len() == fine.len(), "{what}: {coarse:?} {fine:?}");
            for (coarse, fine) in coarse.iter().zip(&fine) {
                assert!((coarse - fine).abs() < 1e-5, "{what}: {coarse} {fine}");
            }
        }
    }
}
