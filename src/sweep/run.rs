//! One run of a sweep, and its measures.
//!
//! # Outcomes
//! For a pair of bodies:
//!
//! | outcome | |
//! | --- | --- |
//! | `merged` | merged, or in its core, at the end |
//! | `passed` | merged and split after passing through: between the first merge and the last split the line of centres turned by more than a right angle, and the relative velocity by less |
//! | `split` | merged and split without passing through: torn off, or pushed back |
//! | `bounced` | never merged, but turned back: the angle between the relative velocities at the end and when the pair came within reach exceeds a right angle, one of the bodies is free, and they move apart |
//! | `apart` | anything else: the pair never came within reach, passed by, or is still within reach |
//!
//! The outcome of a run is the first of these, in this order, that applies to any of its pairs.
//!
//! # When a run ends
//! With `until = "certain"`, the default, a run ends as soon as no pair can change its phase any more:
//!
//! - if all bodies are on paths that are lines, keyframes or fixed: after the last phase change, which the paths determine
//!   in advance; a run without one continues to the end of the scene, so that its closest approach is known;
//! - if there are free bodies: once nothing else acts (no gravity, plane or further push), and for every pair the centres
//!   move apart and each body is out of reach of the other's sphere, even if its vertices were displaced by one and a half
//!   times the distance that their energy allows.
//!
//! A run continues while any pair is merged. Scenes of more than eight bodies run to the end. All measures are over the
//! steps taken.

use std::{collections::BTreeMap, sync::atomic::AtomicBool, time::Instant};

use glam::DVec3;

use super::{
    classes::Classes,
    file::{Sweep, Until},
    own,
    row::{Cell, Row, without_results},
};
use crate::{
    Scene, World,
    analysis::{
        approach::{Followed, Follower},
        touch::Touches,
    },
    model::phase::Phase,
    models,
    observe::{Frame, Simulation as _, StepSummary, Want, surface::Finding},
    scene::{
        Motion, Path,
        template::{Setting, Template},
    },
    sim::{Event, Failure, Options, States, events::PairPaths, terms::free_fall},
    view,
};

/// Maximum number of events listed in a row.
pub(super) const MAX_EVENTS: usize = 64;
/// Maximum number of bodies of a run that may end before its scene.
const MAX_BODIES: usize = 8;
/// A change of phase this close to the end of a step is at it but for rounding [Δt].
const ROUNDING: f64 = 1e-9;
/// Safety factor on the displacement that the energy of a vertex allows.
const MARGIN: f64 = 1.5;

/// Outcomes of pairs, in ascending order of precedence for the outcome of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Outcome {
    /// None of the other outcomes.
    Apart,
    /// Never merged, and turned back.
    Bounced,
    /// Merged and split.
    Split,
    /// Merged, passed through, and split.
    Passed,
    /// Merged at the end.
    Merged,
}

impl Outcome {
    /// All outcomes, in the order of output.
    pub const ALL: [Outcome; 5] = [Outcome::Apart, Outcome::Bounced, Outcome::Merged, Outcome::Passed, Outcome::Split];

    /// The name in tables and maps.
    pub fn name(self) -> &'static str {
        match self {
            Outcome::Apart => "apart",
            Outcome::Bounced => "bounced",
            Outcome::Split => "split",
            Outcome::Passed => "passed",
            Outcome::Merged => "merged",
        }
    }

    /// What it says of a run, as a sentence.
    pub fn about(self) -> &'static str {
        match self {
            Outcome::Apart => "No pair merged, and no free body turned back.",
            Outcome::Bounced => "No pair merged, and a free body turned back.",
            Outcome::Split => "Bodies merged, and split without passing through each other.",
            Outcome::Passed => {
                "Bodies merged, passed through each other (their line of centres turned by more than 90°), and split."
            }
            Outcome::Merged => "A pair is merged at the end.",
        }
    }
}

/// Data shared by runs.
pub struct Runner<'a> {
    sweep: &'a Sweep,
    /// The scene; `None` if the sweep is over another experiment.
    template: Option<&'a Template<'a>>,
    interrupt: Option<&'static AtomicBool>,
}

/// The run was interrupted, so there is no row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Interrupted;

impl<'a> Runner<'a> {
    /// Prepares the runs of a sweep, of whose scene this is the template; `None` if it is over another experiment. They end
    /// when `interrupt` is set.
    pub fn new(
        sweep: &'a Sweep,
        template: Option<&'a Template<'a>>,
        interrupt: Option<&'static AtomicBool>,
    ) -> Runner<'a> {
        Runner { sweep, template, interrupt }
    }

    /// The classes of the outcomes.
    pub fn classes(&self) -> &'a Classes {
        &self.sweep.classes
    }

    /// Runs a row of the sweep.
    ///
    /// # Errors
    /// The run was interrupted.
    pub fn row(&self, row: u64) -> Result<Row, Interrupted> {
        let point = self.sweep.design.point(row).unwrap_or_default();
        Ok((row, self.cells(&point)?))
    }

    /// Runs a point.
    ///
    /// # Errors
    /// The run was interrupted.
    pub fn cells(&self, point: &[Setting]) -> Result<Vec<Cell>, Interrupted> {
        let start = Instant::now();
        let mut cells: Vec<Cell> = point.iter().map(Cell::from).collect();
        match self.template {
            Some(template) => self.run(template, point, &mut cells)?,
            None => own::run(self.sweep, point, self.interrupt, &mut cells)?,
        }
        cells.push(Cell::Float(start.elapsed().as_secs_f64()));
        Ok(cells)
    }

    /// Runs the scene of a point.
    fn run(&self, template: &Template<'_>, point: &[Setting], cells: &mut Vec<Cell>) -> Result<(), Interrupted> {
        let scene = template.scene(self.sweep.settings(point)).map_err(|error| error.to_string());
        let scene = scene.and_then(|scene| {
            models::need_oscillators(&scene, "a sweep").map_err(|error| error.to_string()).map(|()| scene)
        });
        let options = Options { interrupt: self.interrupt, ..Options::default() };
        let world = scene.and_then(|scene| World::with_options(scene, options).map_err(|error| error.to_string()));
        match world {
            Ok(world) => Run::new(world, self.sweep).finish(cells)?,
            Err(error) => cells.extend(without_results(self.sweep, error)),
        }
        Ok(())
    }
}

/// The state of a pair.
struct Pair {
    /// Whether it is merged or in its core.
    is_merged: bool,
    /// Time from which it has been merged [s].
    since: f64,
    /// Position and velocity of b relative to a when the pair came within reach.
    met: [DVec3; 2],
    /// Position and velocity of b relative to a at the first merge.
    merged: Option<[DVec3; 2]>,
    /// Position and velocity of b relative to a at the last split.
    split: Option<[DVec3; 2]>,
}

/// A run in progress.
struct Run<'a> {
    world: World,
    sweep: &'a Sweep,
    pairs: BTreeMap<(usize, usize), Pair>,
    follower: Follower,
    /// Names of the events, in order; their times are in `times`.
    events: String,
    times: Vec<f64>,
    counts: [i64; 3],
    first_merge: Option<f64>,
    first_split: Option<f64>,
    time_merged: f64,
    /// q and time of the closest approach.
    closest: Option<(f64, f64)>,
    energy: f64,
    error: f64,
    displacement: f64,
    surfaces: [Vec<f64>; 3],
    /// Time of the last phase change of bodies on paths [s].
    last_change: Option<f64>,
    states: States,
}

impl<'a> Run<'a> {
    fn new(world: World, sweep: &'a Sweep) -> Run<'a> {
        let mut run = Run {
            last_change: last_change(world.scene()).filter(|_| sweep.until == Until::Certain),
            world,
            sweep,
            pairs: BTreeMap::new(),
            follower: Follower::default(),
            events: String::new(),
            times: Vec::new(),
            counts: [0; 3],
            first_merge: None,
            first_split: None,
            time_merged: 0.0,
            closest: None,
            energy: 0.0,
            error: 0.0,
            displacement: 0.0,
            surfaces: Default::default(),
            states: States::default(),
        };
        run.record_distances();
        run
    }

    fn finish(mut self, cells: &mut Vec<Cell>) -> Result<(), Interrupted> {
        let steps = self.world.scene().steps();
        let mut touches = self.sweep.measures.surfaces.then(|| (Touches::new(&self.world), Frame::default()));
        let (mut summary, mut found, mut failure) = (StepSummary::default(), Vec::new(), None);
        while self.world.steps_taken() < steps {
            let _ = self.world.step();
            let report = self.world.report();
            match &report.failure {
                Some(Failure::Interrupted { .. }) => return Err(Interrupted),
                Some(why) => {
                    failure = Some(why.to_string());
                    break;
                }
                None => {}
            }
            self.error += report.error;
            if !report.events.is_empty() {
                self.take_events();
            }
            self.record_distances();
            if self.sweep.measures.displacement {
                self.displace();
            }
            if let Some((touches, frame)) = &mut touches {
                summary.clear();
                view::summarise(&self.world, &mut summary);
                self.world.observe(Want::default(), frame);
                touches.step_and_take(&self.world, frame, &summary.events, &mut found);
                for found in found.drain(..) {
                    if let Finding::Phase { measures, .. } = found.what {
                        let of =
                            measures.map_or([f64::NAN; 3], |measures| [measures.gap, measures.share, measures.neck]);
                        self.surfaces.iter_mut().zip(of).for_each(|(list, value)| list.push(value));
                    }
                }
                // only the first changes of a step are measured
                self.surfaces.iter_mut().for_each(|list| list.resize(self.times.len(), f64::NAN));
            }
            if self.sweep.until == Until::Certain && self.is_certain() {
                break;
            }
        }
        self.write(failure, cells);
        Ok(())
    }

    /// Position and velocity of body b relative to a [scene unit, scene unit/s].
    fn relative(&self, a: usize, b: usize) -> [DVec3; 2] {
        let (a, b) = (self.world.body(a), self.world.body(b));
        [b.centre() - a.centre(), b.centre_velocity() - a.centre_velocity()]
    }

    /// The same just before an instant of the last step [s]: between that and the end of the step, paths may turn.
    fn relative_before(&self, a: usize, b: usize, time: f64) -> [DVec3; 2] {
        let [from, to] = [a, b].map(|body| {
            let body = self.world.body(body);
            let velocity = body.centre_velocity();
            let of_path = body.scene().path().map(|path| path.before(time));
            of_path.map_or([body.centre() - velocity * (self.world.time() - time), velocity], |then| {
                [then.position, then.velocity]
            })
        });
        [to[0] - from[0], to[1] - from[1]]
    }

    fn take_events(&mut self) {
        let events: Vec<Event> = self.world.report().events.clone();
        let is_single = self.world.body_count() == 2;
        for event in events {
            let (a, b) = (event.a as usize, event.b as usize);
            if self.times.len() < MAX_EVENTS {
                if !self.events.is_empty() {
                    self.events.push_str(", ");
                }
                self.events.push_str(event.name());
                if !is_single {
                    let bodies = &self.world.scene().bodies;
                    self.events.push_str(&format!(" {}~{}", bodies[a].name, bodies[b].name));
                }
                self.times.push(event.time);
            }
            self.energy += event.energy;
            let then = self.relative_before(a, b, event.time);
            let pair = self.pairs.entry((a, b)).or_insert_with(|| Pair::met(then, event.time));
            match (event.from, event.to) {
                (Phase::Apart, Phase::Apart) => {}
                (Phase::Apart, _) => {
                    self.counts[0] += 1;
                    self.first_merge.get_or_insert(event.time);
                    (pair.is_merged, pair.since) = (true, event.time);
                    pair.merged.get_or_insert(then);
                }
                (_, Phase::Apart) => {
                    self.counts[1] += 1;
                    self.first_split.get_or_insert(event.time);
                    self.time_merged += event.time - pair.since;
                    pair.is_merged = false;
                    pair.split = Some(then);
                }
                _ => {}
            }
            self.counts[2] += i64::from(event.to == Phase::Core && event.from != Phase::Core);
        }
    }

    /// Records the distances of pairs.
    fn record_distances(&mut self) {
        let Run { world, pairs, follower, closest, .. } = self;
        let (bodies, time) = (&world.scene().bodies, world.time());
        let mut least = closest.map_or(f64::INFINITY, |(q, _)| q);
        follower.step(
            &*world,
            |body| bodies[body].radius,
            |followed| {
                let Followed { pair, q, is_within_reach, ends, .. } = *followed;
                if is_within_reach {
                    pairs.entry((pair.a, pair.b)).or_insert_with(|| {
                        let (relative, is_merged) = ([pair.apart, pair.rate], pair.phase != Phase::Apart as usize);
                        Pair { is_merged, merged: is_merged.then_some(relative), ..Pair::met(relative, time) }
                    });
                }
                let acceleration = world.acceleration_within(pair.a, ends) + world.acceleration_within(pair.b, ends);
                let was_near = pairs.contains_key(&(pair.a, pair.b));
                let nearest = followed.closest_below(least, acceleration, was_near);
                for [time, q] in nearest.into_iter().chain(was_near.then_some([time, q])) {
                    if q < least {
                        (least, *closest) = (q, Some((q, time)));
                    }
                }
            },
        );
    }

    /// Records the largest displacement.
    fn displace(&mut self) {
        for body in self.world.bodies().filter(|body| !body.is_at_rest()) {
            body.states_into(&mut self.states);
            let largest = self.states.displacement.iter().map(DVec3::length_squared).fold(0.0, f64::max);
            self.displacement = self.displacement.max(largest.sqrt() / body.scene().radius);
        }
    }

    /// Whether no pair can change its phase any more.
    fn is_certain(&mut self) -> bool {
        if self.pairs.values().any(|pair| pair.is_merged) {
            return false;
        }
        if let Some(last) = self.last_change {
            // a change at the end of a step, but for rounding, may be that of the next one
            return self.world.time() > last + ROUNDING * self.world.scene().dt;
        }
        let count = self.world.body_count();
        let scene = self.world.scene();
        if count > MAX_BODIES
            || !scene.is_coupled()
            || free_fall(scene) != DVec3::ZERO
            || !scene.planes.is_empty()
            || self.world.pairs().next().is_some()
            || scene.points.iter().any(|point| point.end() > self.world.time())
            || scene.pushes.iter().any(|push| push.end() > self.world.time())
            || self.world.edits_entered() < scene.edits.len()
        {
            return false;
        }
        let is_steady = |motion: &Motion| !matches!(motion, Motion::Prescribed(path) if !matches!(path, Path::Fixed(_) | Path::Line { .. }));
        if !scene.bodies.iter().all(|body| is_steady(&body.motion)) {
            return false;
        }
        let mut extents = Vec::with_capacity(count);
        for index in 0..count {
            let body = self.world.body(index);
            let (radius, omega) = (body.scene().radius, body.scene().material.omega);
            if omega == 0.0 && !body.is_at_rest() {
                return false;
            }
            let mut largest = 0.0;
            if !body.is_at_rest() {
                body.states_into(&mut self.states);
                let States { displacement, velocity } = &self.states;
                let squared = displacement.iter().zip(velocity.iter());
                largest =
                    squared.map(|(x, u)| x.length_squared() + u.length_squared() / (omega * omega)).fold(0.0, f64::max);
            }
            extents.push((radius + MARGIN * largest.sqrt(), body.scene().sphere_radius()));
        }
        let apart = |a: usize, b: usize| {
            let [position, velocity] = self.relative(a, b);
            let scene = self.world.scene();
            let radii = scene.bodies[a].radius + scene.bodies[b].radius;
            let reach = f64::max(extents[a].0 + extents[b].1, extents[a].1 + extents[b].0);
            let reach = reach.max(radii * scene.law(a, b).thresholds.split_at);
            position.dot(velocity) >= 0.0 && position.length() > reach
        };
        (0..count).all(|b| (0..b).all(|a| apart(a, b)))
    }

    fn outcome(&self) -> Outcome {
        let is_free = |index: usize| matches!(self.world.scene().bodies[index].motion, Motion::Free(_));
        let of_pair = |(&(a, b), pair): (&(usize, usize), &Pair)| {
            if pair.is_merged {
                return Outcome::Merged;
            }
            if let (Some(merged), Some(split)) = (pair.merged, pair.split) {
                let through = merged[0].dot(split[0]) < 0.0 && merged[1].dot(split[1]) > 0.0;
                return if through { Outcome::Passed } else { Outcome::Split };
            }
            let now = self.relative(a, b);
            let is_turned = now[1].dot(pair.met[1]) < 0.0 && now[0].dot(now[1]) > 0.0;
            if is_turned && (is_free(a) || is_free(b)) { Outcome::Bounced } else { Outcome::Apart }
        };
        self.pairs.iter().map(of_pair).max().unwrap_or(Outcome::Apart)
    }

    fn write(mut self, failure: Option<String>, cells: &mut Vec<Cell>) {
        let (end, is_coupled) = (self.world.time(), self.world.scene().is_coupled());
        self.time_merged += self.pairs.values().filter(|pair| pair.is_merged).map(|pair| end - pair.since).sum::<f64>();
        let outcome = failure.is_none().then(|| self.outcome().name().to_owned());
        let number = |number: Option<f64>| number.map_or(Cell::Null, Cell::Float);
        cells.push(outcome.map_or(Cell::Null, Cell::Text));
        cells.push(Cell::Text(self.events));
        cells.push(Cell::List(self.times));
        cells.extend(self.counts.map(Cell::Integer));
        cells.extend([number(self.first_merge), number(self.first_split), Cell::Float(self.time_merged)]);
        cells.extend([number(self.closest.map(|(q, _)| q)), number(self.closest.map(|(_, time)| time))]);
        cells.push(number(is_coupled.then_some(self.energy)));
        let momentum = self.world.conserved().map(|conserved| conserved.momentum.to_array());
        cells.extend((0..3).map(|k| number(momentum.map(|momentum| momentum[k]))));
        cells.extend([Cell::Float(self.error), Cell::Integer(self.world.steps_taken() as i64), Cell::Float(end)]);
        cells.push(Cell::Count(self.world.checksum()));
        cells.extend(self.sweep.measures.displacement.then_some(Cell::Float(self.displacement)));
        if self.sweep.measures.surfaces {
            cells.extend(self.surfaces.map(Cell::List));
        }
        cells.push(failure.map_or(Cell::Null, Cell::Text));
    }
}

impl Pair {
    fn met(relative: [DVec3; 2], time: f64) -> Pair {
        Pair { is_merged: false, since: time, met: relative, merged: None, split: None }
    }
}

/// Time of the last phase change of a scene whose bodies are all on non-periodic paths [s]; `None` if there is none, or
/// if it is unknown.
fn last_change(scene: &Scene) -> Option<f64> {
    if scene.bodies.len() > MAX_BODIES || scene.is_coupled() || !scene.edits.is_empty() {
        return None;
    }
    let paths: Option<Vec<&Path>> =
        scene.bodies.iter().map(|body| body.path().filter(|path| !matches!(path, Path::Sine { .. }))).collect();
    let (paths, end) = (paths?, scene.steps() as f64 * scene.dt);
    let mut last = None;
    for b in 0..paths.len() {
        for a in 0..b {
            let radii = scene.bodies[a].radius + scene.bodies[b].radius;
            let tracks = PairPaths { a: paths[a], b: paths[b], radii };
            let thresholds = scene.law(a, b).thresholds;
            let first = thresholds.initial(tracks.q(0.0));
            tracks.phase_changes(&thresholds, first, 0.0, end, |time, _| {
                last = f64::max(last.unwrap_or(time), time).into()
            });
        }
    }
    last
}
