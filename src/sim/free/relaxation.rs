//! Large islands: every body takes its own steps.
//!
//! If all bodies of an island take the same steps, an event of one pair ends the step of all. In a heap of hundreds,
//! events are so frequent that steps become too short. But within a frame, a body is hardly affected by its neighbours'
//! neighbours. A large island is therefore advanced by waveform relaxation (Lelarasmee, Ruehli &
//! Sangiovanni-Vincentelli 1982): each body alone, as an island of one, on the latest tracks of the others. This is
//! repeated until no track changes. Each round reduces the differences by a factor of about (h/T)², where h is the
//! length of the stretch and T the time scale of the influence. A body whose neighbours' tracks did not change is not
//! advanced again.
//!
//! Bodies exchange only the tracks of centres and the integrals of reactions. The reaction on a sphere is computed with
//! the vertices on which the sphere acts, in the steps of their body. It acts on the centre of the sphere alone, so its
//! first and second integrals, known exactly for every step, are all that the other body needs. Momentum is conserved
//! although steps differ, up to the remaining difference between rounds.
//!
//! The events of a pair are found with its first body that has vertices. The other body ends its steps at these times
//! too, and so do the neighbours of both, because the accelerations of the two bodies jump there.

use std::sync::{Arc, Mutex, PoisonError};

use glam::DVec3;
use pulp::Arch;
use rayon::prelude::*;

use super::{
    super::{
        nodes::NODES,
        work::{Tally, Work},
    },
    body::{Body, Motion, Shape},
    crossing::Curve,
    field::{Driven, Paths, Push},
    island::{Failure, Island, MAX_SETTLED_TOLERANCE, Parts, Report, Scratch, settled},
    step::{Course, Place, combine, larger},
    weights::Late,
};
use crate::model::phase::Phase;

/// Largest number of rounds before a shorter stretch is tried.
const MAX_ROUNDS: u32 = 16;
/// A body is advanced again when its neighbours' records have changed by more than this times [`settled`], a third of
/// the tolerance; its own track would change by a small fraction of that.
const MAX_STALE: f64 = 10.0;
/// Factor on that share for tolerances above [`MAX_SETTLED_TOLERANCE`], at which [`settled`] stops growing; the limit is
/// never below [`MAX_STALE`].
const LOOSE: f64 = 0.1;
/// Multiple of [`settled`] at which corrections within a step end in the first rounds.
const ROUGH: f64 = 300.0;
/// Largest such multiple in the last round.
const MAX_ROUGH: f64 = 3.0;
/// Stretches shorter than this fraction of the interval are not divided further.
const SHORTEST: f64 = 1e-4;
/// Average number of steps that a body takes in a stretch.
const STEPS: f64 = 2.0;
/// Largest number of steps of a body that counts towards the number of stretches.
const MAX_COUNTED_STEPS: f64 = 1000.0;
/// With fewer vertices than this, a second thread does not pay off.
const PARALLEL_VERTICES: usize = 1024;

/// Constraints on an island of one body, and records of its motion.
#[derive(Clone, Debug, Default)]
pub struct Part {
    /// Track of the body and its action on others.
    pub record: Record,
    /// Events found elsewhere, by time.
    schedule: Vec<Scheduled>,
    next: usize,
    /// Number of pairs, the first ones, whose events are found here.
    pub found: usize,
    /// Multiple of [`settled`] at which corrections end.
    pub rough: f64,
    /// Ends of steps chosen for the tolerance, not for an event [s].
    pub ends: Vec<f64>,
    /// Those of the previous round, which are used again so that different steps do not change the track [s].
    known: Vec<f64>,
}

/// An event found elsewhere.
#[derive(Clone, Copy, Debug)]
struct Scheduled {
    time: f64,
    /// The pair and its new phase, if it is a pair of this body.
    change: Option<(usize, Phase)>,
    /// Whether a step must end there.
    stops: bool,
}

impl Part {
    /// End of the step that began at `t` in the previous round [s].
    pub fn known_end(&self, t: f64) -> Option<f64> {
        self.known.get(self.known.partition_point(|&end| end <= t)).copied()
    }

    /// Discards the steps of the previous round.
    pub fn forget_ends(&mut self) {
        self.known.clear();
    }

    /// The next instant after `t` at which a step must end [s].
    pub fn next_stop(&self, t: f64) -> f64 {
        let later = self.schedule[self.next..].iter().find(|event| event.stops && event.time > t);
        later.map_or(f64::INFINITY, |event| event.time)
    }

    /// The next scheduled change of phase up to `t` [s]: the pair and its new phase.
    pub fn next_change(&mut self, t: f64) -> Option<(usize, Phase)> {
        while let Some(event) = self.schedule.get(self.next).filter(|event| event.time <= t) {
            self.next += 1;
            if event.change.is_some() {
                return event.change;
            }
        }
        None
    }
}

/// The track of a body, and its reactions on the centres of others.
#[derive(Clone, Debug, Default)]
pub struct Record {
    legs: Vec<Leg>,
    /// By index of the other body.
    pulses: Vec<Vec<Pulse>>,
    /// Buffer: (second, first) integral of each reaction at the nodes of a step.
    sums: Vec<Option<[(DVec3, DVec3); 4]>>,
}

/// The track of the centre in a step.
#[derive(Clone, Copy, Debug)]
struct Leg {
    start: f64,
    h: f64,
    at: Curve,
}

/// The first integral of a reaction [mass · scene unit/s] and the second [mass · scene unit] since the track began.
#[derive(Clone, Copy, Debug)]
struct Pulse {
    start: f64,
    h: f64,
    /// The second integral within the step.
    by: Curve,
    /// (Second, first) integral at the start of the step and at its end.
    before: (DVec3, DVec3),
    after: (DVec3, DVec3),
}

impl Record {
    fn clear(&mut self, others: usize) {
        self.legs.clear();
        self.pulses.truncate(others);
        self.pulses.iter_mut().for_each(Vec::clear);
        self.pulses.resize_with(others, Vec::new);
    }

    /// Adds a step; `number` gives the index of a source among the others.
    pub fn add(
        &mut self,
        course: &Course,
        places: &[Place; 5],
        (start, end): (f64, f64),
        number: impl Fn(u32) -> Option<u32>,
    ) {
        let h = end - start;
        let nodes = [places[0], places[1], places[2], places[3]];
        let at = Curve::new(&nodes.map(|place| place.centre), &nodes.map(|place| h * place.velocity));
        self.legs.push(Leg { start, h, at });
        let Record { sums, pulses, .. } = self;
        sums.clear();
        sums.resize(pulses.len(), None);
        let mut add = |source: u32, from: f64, force: [DVec3; 4]| {
            let Some(sum) = number(source).and_then(|number| sums.get_mut(number as usize)) else { return };
            let sum = sum.get_or_insert_default();
            for (sum, &node) in sum.iter_mut().zip(&NODES).skip(1) {
                let late = Late::ballistic(h, from, node);
                sum.0 += combine(&late.x, force);
                sum.1 += combine(&late.u, force);
            }
        };
        for reaction in &course.reactions {
            let [force @ .., _] = reaction.force;
            if force != [DVec3::ZERO; 4] {
                add(reaction.source, 0.0, force);
            }
        }
        for piece in &course.pieces {
            if let Some((own, source)) = piece.own.as_ref().and_then(|own| Some((own, own.source?))) {
                let mass = piece.sign * course.active.mass(own.vertex as usize);
                add(source, piece.from, own.g.map(|g| -mass * g));
            }
        }
        for (sum, pulses) in sums.iter().zip(pulses) {
            let Some(sum) = sum else { continue };
            let before = integrals(pulses, start);
            let (x, u) = (sum.map(|sum| sum.0), sum.map(|sum| h * sum.1));
            let after = (before.0 + h * before.1 + sum[3].0, before.1 + sum[3].1);
            pulses.push(Pulse { start, h, by: Curve::new(&x, &u), before, after });
        }
    }

    /// Adds the track of a body under the forces at the start of a step, assumed constant, and its reactions on others.
    fn guess(&mut self, body: &Body, course: &Course, (start, end): (f64, f64), number: impl Fn(u32) -> Option<u32>) {
        let h = end - start;
        let acceleration = course.frames[0].acceleration;
        let at = NODES.map(|node| body.centre + node * h * (body.velocity + 0.5 * node * h * acceleration));
        let rates = NODES.map(|node| h * (body.velocity + node * h * acceleration));
        self.legs.push(Leg { start, h, at: Curve::new(&at, &rates) });
        for reaction in &course.reactions {
            let Some(pulses) = number(reaction.source).and_then(|number| self.pulses.get_mut(number as usize)) else {
                continue;
            };
            let force = reaction.force[0];
            let x = NODES.map(|node| 0.5 * (node * h) * (node * h) * force);
            let u = NODES.map(|node| node * h * h * force);
            let (before, after) = (Default::default(), (x[3], h * force));
            pulses.push(Pulse { start, h, by: Curve::new(&x, &u), before, after });
        }
    }

    /// Position and velocity of the centre at `t` [s].
    fn place(&self, t: f64) -> Place {
        let after = self.legs.partition_point(|leg| leg.start <= t).max(1);
        let Some(leg) = self.legs.get(after - 1) else { return Place::default() };
        let (centre, rate) = leg.at.at((t - leg.start) / leg.h);
        Place { centre, velocity: rate / leg.h }
    }

    /// Largest difference from an earlier record, of the track and of the reactions over the masses that they act on
    /// [scene unit]; a velocity counts as the displacement in one second.
    fn change(&self, before: &Record, (start, end): (f64, f64), mass: impl Fn(usize) -> Option<f64>) -> f64 {
        const LOOKS: [f64; 4] = [0.25, 0.5, 0.75, 1.0];
        let mut largest: f64 = 0.0;
        for look in LOOKS {
            let t = start + look * (end - start);
            let (now, then) = (self.place(t), before.place(t));
            largest = larger(largest, (now.centre - then.centre).length());
            largest = larger(largest, (now.velocity - then.velocity).length());
            for (number, (now, then)) in self.pulses.iter().zip(&before.pulses).enumerate() {
                if let Some(mass) = mass(number) {
                    largest = larger(largest, (integrals(now, t).1 - integrals(then, t).1).length() / mass);
                }
            }
        }
        largest
    }
}

/// The second and the first integral at `t` [s].
fn integrals(pulses: &[Pulse], t: f64) -> (DVec3, DVec3) {
    let after = pulses.partition_point(|pulse| pulse.start <= t);
    let Some(Pulse { start, h, by, before, after }) = after.checked_sub(1).and_then(|last| pulses.get(last)) else {
        return Default::default();
    };
    let length = t - start;
    if length >= *h {
        return (after.0 + (length - h) * after.1, after.1);
    }
    let (at, rate) = by.at(length / h);
    (before.0 + length * before.1 + at, before.1 + rate / *h)
}

/// An event of a pair of the whole island.
#[derive(Clone, Copy, Debug)]
struct Event {
    time: f64,
    pair: u32,
    bodies: [u32; 2],
    to: Phase,
    jumps: bool,
}

/// A body and its neighbours.
#[derive(Clone, Debug, Default)]
struct Cell {
    /// The body, then those that it has pairs with, ascending.
    ids: Vec<u32>,
    /// Its pairs; the `found` whose events are found here come first.
    pairs: Vec<u32>,
    found: usize,
    /// Bodies whose vertices react on its centre, with its index in their [`Record::pulses`].
    incoming: Vec<(u32, u32)>,
    parts: Parts,
    schedule: Vec<Scheduled>,
    ends: Vec<f64>,
    report: Report,
    failure: Option<Failure>,
    work: u64,
    /// Change of its neighbours' records since it was last advanced, over [`settled`].
    stale: f64,
    rough: f64,
    /// Differs between neighbours: bodies of one colour are advanced at once.
    color: u32,
    is_due: bool,
}

/// Buffers, reused by any island.
#[derive(Debug, Default)]
pub struct Relaxation {
    cells: Vec<Cell>,
    records: Vec<Record>,
    fresh: Vec<Record>,
    changes: Vec<f64>,
    events: Vec<Event>,
    scratches: Mutex<Vec<Scratch>>,
    arch: Arch,
}

impl Clone for Relaxation {
    fn clone(&self) -> Relaxation {
        Relaxation::default()
    }
}

/// The surroundings of a body in a round.
struct Round<'a> {
    island: &'a Island,
    records: &'a [Record],
    events: &'a [Event],
    scratches: &'a Mutex<Vec<Scratch>>,
    paths: &'a dyn Paths,
    work: Option<&'a Work>,
    arch: Arch,
    span: (f64, f64),
}

/// The tracks that a body sees.
struct Tracks<'a> {
    round: &'a Round<'a>,
    ids: &'a [u32],
    incoming: &'a [(u32, u32)],
}

impl Paths for Tracks<'_> {
    fn at(&self, body: usize, t: f64, before: bool) -> Driven {
        let body = self.ids[body] as usize;
        if self.round.island.bodies[body].is_prescribed() {
            return self.round.paths.at(body, t, before);
        }
        let Place { centre, velocity } = self.round.records[body].place(t);
        Driven { position: centre, velocity, carry: DVec3::ZERO }
    }

    fn reaction(&self, body: usize, t: f64) -> Option<(DVec3, DVec3)> {
        let mass = self.round.island.bodies[self.ids[body] as usize].mass();
        let of =
            |&(other, number): &(u32, u32)| integrals(&self.round.records[other as usize].pulses[number as usize], t);
        let (x, u) =
            self.incoming.iter().map(of).fold((DVec3::ZERO, DVec3::ZERO), |sum, of| (sum.0 + of.0, sum.1 + of.1));
        Some((x / mass, u / mass))
    }
}

impl Cell {
    /// Collects the neighbours and pairs of body `own`, but not the incoming reactions.
    fn gather(&mut self, own: u32, island: &Island, pairs_of: &[u32], stepped: usize) {
        let Cell { ids, pairs, found, .. } = self;
        let ends = |&pair: &u32| {
            let pair = &island.pairs[pair as usize];
            (pair.a.min(pair.b), pair.a.max(pair.b))
        };
        ids.clear();
        ids.extend(pairs_of.iter().map(|pair| {
            let (a, b) = ends(pair);
            if a == own { b } else { a }
        }));
        ids.sort_unstable();
        ids.insert(0, own);
        // with the first body that has vertices
        let is_found = |pair: &u32| {
            let (a, b) = ends(pair);
            own == if (a as usize) < stepped { a } else { b }
        };
        pairs.clear();
        pairs.extend(pairs_of.iter().filter(|pair| is_found(pair)));
        *found = pairs.len();
        pairs.extend(pairs_of.iter().filter(|pair| !is_found(pair)));
    }

    /// Index of a body in [`Cell::ids`].
    fn position(&self, body: u32) -> Option<u32> {
        if self.ids[0] == body {
            return Some(0);
        }
        self.ids[1..].binary_search(&body).ok().map(|index| index as u32 + 1)
    }

    /// Schedules the events found elsewhere: ends of steps and changes of phase.
    fn schedule_events(&mut self, round: &Round<'_>) {
        let mut schedule = std::mem::take(&mut self.schedule);
        schedule.clear();
        let closest = 1e-7 * (round.span.1 - round.span.0);
        let mut last = f64::NEG_INFINITY;
        for &Event { time, pair, bodies, to, jumps } in round.events {
            let change = if bodies.contains(&self.ids[0]) {
                let Some(index) = self.pairs[self.found..].iter().position(|&own| own == pair) else { continue };
                Some((self.found + index, to))
            } else if jumps && time - last > closest && bodies.iter().any(|&body| self.position(body).is_some()) {
                None
            } else {
                continue;
            };
            if jumps {
                last = time;
            }
            schedule.push(Scheduled { time, change, stops: jumps });
        }
        self.schedule = schedule;
    }

    /// Advances the body over the span, on the records of the others.
    fn advance(&mut self, round: &Round<'_>, record: &mut Record) {
        self.schedule_events(round);
        let Round { island, span: (start, end), .. } = *round;
        let own = self.ids[0] as usize;
        let mut parts = std::mem::take(&mut self.parts);
        let Parts { bodies, pairs, field, paces, .. } = &mut parts;
        let none = || Arc::new(Shape::none());
        bodies.truncate(self.ids.len());
        bodies.resize_with(self.ids.len(), || Body::prescribed(none(), 1.0, island.bodies[own].oscillator));
        bodies[0].copy_from(&island.bodies[own]);
        for (body, &id) in bodies.iter_mut().zip(&self.ids).skip(1) {
            let known = &island.bodies[id as usize];
            (body.radius, body.centre, body.velocity) = (known.radius, known.centre, known.velocity);
            body.motion = if known.is_prescribed() { Motion::Prescribed } else { Motion::Tracked };
        }
        pairs.clear();
        for &pair in &self.pairs {
            let mut pair = island.pairs[pair as usize];
            (pair.a, pair.b) = (self.position(pair.a).unwrap_or_default(), self.position(pair.b).unwrap_or_default());
            pairs.push(pair);
        }
        let known = &island.field;
        field.gravity = known.gravity;
        field.planes.clone_from(&known.planes);
        (field.reach, field.weight, field.scaling) = (known.reach, known.weight, known.scaling);
        field.pushes.clear();
        let pushes = known.pushes.iter().filter(|push| push.body as usize == own);
        field.pushes.extend(pushes.map(|&push| Push { body: 0, ..push }));
        field.forces.clear();
        let forces = known.forces.iter().filter(|(body, _)| *body as usize == own);
        field.forces.extend(forces.map(|(_, force)| (0, force.clone())));
        paces.clear();
        paces.push(island.paces[own]);

        let mut part = Island::resume(parts, island.tolerance, start);
        let mut kept = std::mem::take(record);
        kept.clear(self.ids.len() - 1);
        let schedule = std::mem::take(&mut self.schedule);
        let (known, found, rough) = (std::mem::take(&mut self.ends), self.found, self.rough);
        part.part = Some(Part { record: kept, schedule, next: 0, found, rough, ends: Vec::new(), known });
        let pooled = round.scratches.lock().unwrap_or_else(PoisonError::into_inner).pop();
        let mut scratch = pooled.unwrap_or_default();
        scratch.arch = round.arch;
        let tracks = Tracks { round, ids: &self.ids, incoming: &self.incoming };
        let work = Tally::aside(round.work);
        let mut changes = std::mem::take(&mut self.report.changes);
        changes.clear();
        self.report = Report { changes, ..Report::default() };
        self.failure = part.advance_with(&mut scratch, end, &tracks, &work, &mut self.report).err();
        self.work = work.done();
        round.scratches.lock().unwrap_or_else(PoisonError::into_inner).push(scratch);
        if let Some(Part { record: kept, schedule, ends, .. }) = part.part.take() {
            (*record, self.schedule, self.ends) = (kept, schedule, ends);
        }
        self.parts = part.into_parts();
    }
}

impl Relaxation {
    /// Makes a cell of every body with vertices. The first tracks are those of a joint step if one is known, else
    /// guesses.
    fn start(&mut self, island: &Island, scratch: &Scratch, span: (f64, f64), is_known: bool) {
        let stepped = island.stepped();
        let Relaxation { cells, records, fresh, changes, events, arch, .. } = self;
        *arch = scratch.arch;
        cells.resize_with(stepped, Cell::default);
        records.resize_with(stepped, Record::default);
        fresh.resize_with(stepped, Record::default);
        changes.clear();
        changes.resize(stepped, 0.0);
        events.clear();
        for (own, cell) in cells.iter_mut().enumerate() {
            cell.gather(own as u32, island, &scratch.pairs_of[own], stepped);
            (cell.stale, cell.rough) = (f64::INFINITY, ROUGH);
            cell.ends.clear();
        }
        for own in 0..stepped {
            let mut incoming = std::mem::take(&mut cells[own].incoming);
            incoming.clear();
            for &other in cells[own].ids[1..].iter().filter(|&&other| (other as usize) < stepped) {
                incoming.extend(cells[other as usize].position(own as u32).map(|index| (other, index - 1)));
            }
            cells[own].incoming = incoming;
        }
        for own in 0..stepped {
            // the first colour that no earlier neighbour has
            let mut used = 0u64;
            for &other in cells[own].ids[1..].iter().filter(|&&other| (other as usize) < own) {
                used |= 1 << cells[other as usize].color.min(63);
            }
            cells[own].color = used.trailing_ones();
        }
        for (own, (cell, record)) in cells.iter().zip(records).enumerate() {
            record.clear(cell.ids.len() - 1);
            let number = |source: u32| cell.position(source).and_then(|index| index.checked_sub(1));
            match is_known {
                true => record.add(&scratch.courses[own], &scratch.places[own], span, number),
                false => record.guess(&island.bodies[own], &scratch.courses[own], span, number),
            }
        }
    }

    /// Advances all bodies over the span, each alone, until their tracks agree.
    fn agree(&mut self, island: &Island, span: (f64, f64), paths: &dyn Paths, work: &Tally<'_>) -> Result<(), Failure> {
        let vertices: usize = island.bodies.iter().map(|body| body.shape.rest.len()).sum();
        let colors = self.cells.iter().map(|cell| cell.color + 1).max().unwrap_or(0);
        let max_stale = MAX_STALE * (LOOSE * island.tolerance / MAX_SETTLED_TOLERANCE).max(1.0);
        for _ in 0..MAX_ROUNDS {
            let mut any = false;
            for color in 0..colors {
                let Relaxation { cells, records, fresh, changes, events, scratches, arch } = self;
                let round = Round { island, records, events, scratches, paths, work: work.common(), arch: *arch, span };
                let advance = |(own, (cell, record)): (usize, (&mut Cell, &mut Record))| {
                    cell.is_due = cell.color == color && (cell.stale > max_stale || cell.rough > MAX_ROUGH);
                    if !cell.is_due {
                        return 0.0;
                    }
                    // corrections need not be finer than the changes that they follow
                    cell.rough = (1e-3 * cell.stale).clamp(1.0, ROUGH);
                    cell.advance(&round, record);
                    let mass = |number: usize| {
                        let other = &island.bodies[cell.ids[number + 1] as usize];
                        other.is_free().then(|| other.mass())
                    };
                    let change = record.change(&records[own], span, mass);
                    change / settled(island.tolerance, island.bodies[own].radius, span.1 - span.0)
                };
                changes.clear();
                if vertices >= PARALLEL_VERTICES {
                    let all = cells.par_iter_mut().zip(fresh.par_iter_mut()).enumerate();
                    changes.par_extend(all.map(advance));
                } else {
                    changes.extend(cells.iter_mut().zip(fresh.iter_mut()).enumerate().map(advance));
                }
                let due = |cell: &&Cell| cell.is_due;
                any |= cells.iter().any(|cell| cell.is_due);
                if !work.spend(cells.iter().filter(due).map(|cell| cell.work).sum()) {
                    return Err(island.stopped());
                }
                events.clear();
                for (own, cell) in cells.iter_mut().enumerate() {
                    if let Some(failure) = &cell.failure {
                        return Err(in_whole(failure, &cell.ids));
                    }
                    if cell.is_due {
                        cell.stale = 0.0;
                        std::mem::swap(&mut fresh[own], &mut records[own]);
                    }
                    for change in cell.report.changes.iter().filter(|change| change.pair < cell.found) {
                        let pair = cell.pairs[change.pair];
                        let known = &island.pairs[pair as usize];
                        let jumps = !known.law.is_gradual(change.from, change.to);
                        events.push(Event {
                            time: change.time,
                            pair,
                            bodies: [known.a, known.b],
                            to: change.to,
                            jumps,
                        });
                    }
                }
                events.sort_by(|one, other| one.time.total_cmp(&other.time).then(one.pair.cmp(&other.pair)));
                for cell in cells.iter_mut() {
                    let seen = cell.ids[1..].iter().filter_map(|&other| changes.get(other as usize));
                    cell.stale += seen.fold(0.0, |largest, &change| larger(largest, change));
                }
            }
            if !any {
                return Ok(());
            }
        }
        let left = self.cells.iter().enumerate().max_by(|(_, a), (_, b)| a.stale.total_cmp(&b.stale));
        match left {
            Some((body, cell)) if !(cell.stale <= max_stale) => {
                Err(Failure::Unresolved { body, time: span.0, step: span.1 - span.0 })
            }
            _ => Ok(()),
        }
    }

    /// Commits the result as the state of the island.
    fn commit(&mut self, island: &mut Island, span: (f64, f64), paths: &dyn Paths, report: &mut Report) {
        let (mut steps, mut error, first) = (0, 0.0, report.changes.len());
        // Each cell has the vertices of its own body: the energy of a change has a share in the cells of both bodies.
        let mut others: Vec<super::Change> = Vec::new();
        for (own, cell) in self.cells.iter_mut().enumerate() {
            let Cell { parts, pairs, found, report: of_cell, .. } = cell;
            let way = &mut island.ways[own];
            if let (Some(body), Some(got), Some(&pace)) =
                (parts.bodies.first_mut(), parts.ways.first(), parts.paces.first())
            {
                let from = island.bodies[own].centre.distance(way.from);
                way.centre = larger(way.centre, from + got.centre);
                way.extent = larger(way.extent, got.extent);
                (way.displacement, way.speed) = (got.displacement, got.speed);
                std::mem::swap(&mut island.bodies[own], body);
                island.paces[own] = pace;
            }
            for (&pair, known) in pairs.iter().zip(&parts.pairs).take(*found) {
                island.pairs[pair as usize].phase = known.phase;
            }
            for change in &of_cell.changes {
                let is_own = change.pair < *found;
                let change = super::Change { pair: pairs[change.pair] as usize, ..*change };
                if is_own { &mut report.changes } else { &mut others }.push(change);
            }
            steps = steps.max(of_cell.steps);
            report.body_steps += of_cell.steps;
            report.rejected += of_cell.rejected;
            report.sweeps += of_cell.sweeps;
            error = larger(error, of_cell.error);
            report.ledger += of_cell.ledger;
        }
        report.steps += steps;
        report.error += error;
        let changes = &mut report.changes[first..];
        let by_pair = |one: &super::Change, other: &super::Change| {
            one.pair.cmp(&other.pair).then(one.time.total_cmp(&other.time))
        };
        changes.sort_by(by_pair);
        others.sort_by(by_pair);
        let mut others = others.into_iter().peekable();
        for change in changes.iter_mut() {
            while others.next_if(|other| other.pair < change.pair).is_some() {}
            if let Some(other) = others.next_if(|other| other.pair == change.pair) {
                change.energy += other.energy;
            }
        }
        changes.sort_by(|one, other| one.time.total_cmp(&other.time).then(one.pair.cmp(&other.pair)));
        for (index, body) in island.bodies.iter_mut().enumerate().skip(self.cells.len()) {
            let Driven { position, velocity, .. } = paths.at(index, span.1, true);
            (body.centre, body.velocity) = (position, velocity);
        }
        island.time = span.1;
    }
}

/// A failure of a part, with the indices of bodies in the whole island.
fn in_whole(failure: &Failure, ids: &[u32]) -> Failure {
    let of = |body: usize| ids.get(body).copied().unwrap_or_default();
    match *failure {
        Failure::Chatter { a, b, time } => Failure::Chatter { a: of(a as usize), b: of(b as usize), time },
        Failure::Unresolved { body, time, step } => Failure::Unresolved { body: of(body) as usize, time, step },
        Failure::Stopped { body, time, step } => Failure::Stopped { body: of(body) as usize, time, step },
    }
}

impl Island {
    /// Advances to `end` [s]: in joint steps of all bodies where these are accurate and without events, else body by
    /// body.
    pub(super) fn advance_apart(
        &mut self,
        scratch: &mut Scratch,
        end: f64,
        paths: &dyn Paths,
        work: &Tally<'_>,
        report: &mut Report,
    ) -> Result<(), Failure> {
        let shortest = (end - self.time) * SHORTEST;
        let mut longest = f64::INFINITY;
        while self.time < end {
            if self.is_at_break() {
                self.kick(paths);
                self.jump(paths, report);
            }
            self.leave_phases(scratch, paths, report)?;
            let stop = f64::min(end, self.field.next_break(self.time));
            let left = stop - self.time;
            // bodies take a few steps each in a stretch: the shorter it is, the fewer rounds they need to agree
            let steps: f64 = self.paces.iter().map(|pace| (left / pace).clamp(1.0, MAX_COUNTED_STEPS)).sum();
            let parts = (steps / (STEPS * self.paces.len() as f64)).floor().max((left / longest).ceil()).max(1.0);
            let next = if parts > 1.0 { self.time + left / parts } else { stop };
            let (start, h) = (self.time, next - self.time);
            // a joint step, if it is expected to meet the tolerance of every body
            let may_do = self.paces.iter().all(|&pace| pace >= h);
            let outcome = if may_do { self.step(scratch, next, paths, work, report) } else { None };
            if work.is_over() {
                return Err(self.stopped());
            }
            if outcome.is_some_and(|outcome| outcome.error <= 1.0) && self.first_crossing(scratch, h).is_none() {
                report.steps += 1;
                report.body_steps += self.stepped() as u64;
                report.error += outcome.map_or(0.0, |outcome| outcome.estimate);
                self.commit(scratch, next, report);
                self.pass_gradually(scratch, start, report)?;
                self.paces.iter_mut().for_each(|pace| *pace = pace.max(h));
                continue;
            }
            if outcome.is_none() {
                self.evaluate_start(scratch, next, paths, work);
            }
            let mut relaxation = std::mem::take(&mut scratch.relaxation);
            relaxation.start(self, scratch, (start, next), outcome.is_some());
            let agreed = relaxation.agree(self, (start, next), paths, work);
            if agreed.is_ok() {
                relaxation.commit(self, (start, next), paths, report);
            }
            scratch.relaxation = relaxation;
            match agreed {
                Ok(()) => longest *= 2.0,
                Err(_) if work.is_over() => return Err(self.stopped()),
                Err(failure) if h < shortest => return Err(failure),
                Err(_) => longest = 0.5 * h,
            }
        }
        self.finish(scratch, paths, report)
    }
}
