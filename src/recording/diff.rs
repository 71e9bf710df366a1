//! Comparison of two recordings of a scene, aligned by simulated time.
//!
//! Surfaces are read from the recordings, so that recordings of older program versions can be compared, at the recorded
//! precision of about 1e-7 of a radius. A recording without surfaces is run again.
//!
//! The events are phase changes, and surfaces that touch or part. Near misses are not compared: they are extrema of a
//! distance, so any two runs that differ, differ in them.

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt,
};

use super::{
    ReadError, Recorded,
    comparison::{Comparison, MAX_PAIRS, Plan},
    events::{self, Change},
    frames::{FrameReader, RecordedFrame},
    quantities::{self, Deviation, Deviations, SENSITIVITY},
    read::End,
    recorded::RecordedEvent,
};
use crate::{
    analysis::{Worst, touch::Touches},
    observe::{Frame, PairFrame, Run, Schema, Want},
    stream::{
        settings::Frames,
        sinks::{Saved, SinkError},
    },
    text::{counted, short, step_size, thousands, vector},
};

/// Instants at most this far apart are equal [s]; recordings have a resolution of one nanosecond.
const SAME_TIME: f64 = 2e-9;

/// Upper limit on listed bodies or events; the rest are counted.
const LISTED: usize = 8;

/// The differences between two recordings; as text, a report of some lines.
#[derive(Clone, Debug)]
pub struct Difference {
    /// Differences up to this size are ignored [radii].
    pub tolerance: f64,
    /// Δt of the first recording [s].
    pub dt: f64,
    /// Number of instants in both recordings.
    pub instants: u64,
    /// The first step whose checksums differ; `None` if all are equal, or if the steps are not comparable.
    pub first_bits: Option<u64>,
    /// Whether checksums could be compared: both recordings have the same Δt.
    pub has_bits: bool,
    /// The worst vertex of each body that differs, in descending order of difference. `recorded` is its position in the
    /// first recording, `found` in the second.
    pub bodies: Vec<Worst>,
    /// The worst vertex at the first instant at which the difference exceeds the tolerance.
    pub first_beyond: Option<Worst>,
    /// Pairs that begin in different phases, in words.
    pub starts: Vec<String>,
    /// Differences between the events.
    pub events: Vec<Change>,
    /// The first and the last time that both runs reach [s].
    pub common: [f64; 2],
    /// Number of events of the first recording in the time in common.
    pub event_count: usize,
    /// Number of events of either recording at other times.
    pub event_count_beyond: usize,
    /// Geometric quantities that differ beyond the tolerance; `None` unless both recordings have them.
    pub surfaces: Option<Vec<Deviation>>,
    /// Whether there are quantities that only one of them has.
    pub has_others: bool,
    /// Whether each recording had to be run again because it has no surfaces, or none that is complete.
    pub run_again: [bool; 2],
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.first_bits {
            Some(step) => writeln!(f, "bits: different from step {step} (t = {:.6} s) on", step as f64 * self.dt)?,
            // surfaces that were run again are those of the checksums
            None if self.has_bits && self.first_beyond.is_some() && self.run_again == [false; 2] => writeln!(
                f,
                "bits: the same at every common step, so one of the files is damaged: equal checksums have equal surfaces"
            )?,
            None if self.has_bits => writeln!(f, "bits: the same at every common step")?,
            None => {}
        }
        if self.instants < 2 {
            return write!(f, "nothing was compared: fewer than two instants in common");
        }
        write!(f, "{} instants in common, tolerance {:e} radii", thousands(self.instants), self.tolerance)?;
        for worst in self.bodies.iter().take(LISTED) {
            let Worst { body, difference, vertex, time, step, .. } = worst;
            write!(
                f,
                "\n  body \"{body}\": up to {} radii, vertex {vertex} at t = {time:.6} s (step {step})",
                short(*difference)
            )?;
        }
        match self.bodies.len() {
            0 if self.first_bits.is_some() => write!(f, "\n  no body differs by more than single precision shows")?,
            0 => write!(f, "\n  no body differs")?,
            n if n > LISTED => write!(f, "\n  … and {} that differ less", counted((n - LISTED) as u64, "body"))?,
            _ => {}
        }
        if let Some(Worst { body, difference, vertex, time, step, recorded, found, .. }) = &self.first_beyond {
            let [recorded, found] = [recorded, found].map(vector);
            write!(
                f,
                "\nfirst beyond tolerance: step {step} (t = {time:.6} s), body \"{body}\", vertex {vertex}: {recorded} and \
                 {found}, from the centre: {} radii apart",
                short(*difference)
            )?;
        }
        self.starts.iter().take(LISTED).try_for_each(|pair| write!(f, "\nphases at the start: {pair}"))?;
        if self.starts.len() > LISTED {
            write!(f, "\n… and {}", counted((self.starts.len() - LISTED) as u64, "more pair"))?;
        }
        if self.events.is_empty() {
            write!(f, "\nevents: the same{}", self.beyond())?;
        }
        events::listed(&self.events, LISTED).iter().try_for_each(|change| {
            write!(f, "\nevent {change}")?;
            change.remark(self.common).map_or(Ok(()), |remark| write!(f, "; {remark}"))
        })?;
        if self.events.len() > LISTED {
            write!(f, "\n… and {}", counted((self.events.len() - LISTED) as u64, "more event"))?;
        }
        let Some(surfaces) = &self.surfaces else { return Ok(()) };
        if surfaces.is_empty() {
            let of_both = if self.has_others { ", where both have them" } else { "" };
            write!(
                f,
                "\nsurfaces: gap, overlap, neck, volume, area and topology are the same within the tolerance{of_both}"
            )?;
        }
        surfaces.iter().take(LISTED).try_for_each(|deviation| write!(f, "\nsurfaces: {deviation}"))?;
        if surfaces.len() > LISTED {
            write!(f, "\n… and {}", counted((surfaces.len() - LISTED) as u64, "more difference"))?;
        }
        Ok(())
    }
}

impl Difference {
    /// What equal events leave open, in words.
    fn beyond(&self) -> String {
        match self.event_count_beyond {
            0 => String::new(),
            n => {
                let [start, end] = self.common;
                let events = counted(n as u64, "event");
                format!(" from {start:.3} to {end:.3} s, which both runs have; not compared: {events} at other times")
            }
        }
    }
}

/// Frames from a file or from a new run of the scene.
enum FrameSource {
    Stored(Box<FrameReader>),
    Replayed { run: Box<Run>, touches: Box<Touches>, has_begun: bool, events: Vec<RecordedEvent> },
}

impl FrameSource {
    fn of(recorded: &Recorded, run_again: bool) -> Result<FrameSource, ReadError> {
        if !run_again {
            return Ok(FrameSource::Stored(Box::new(FrameReader::open(recorded)?)));
        }
        let run = Box::new(Run::again(recorded.start()?, recorded.last()));
        let touches = Box::new(Touches::new(&*run.simulation));
        Ok(FrameSource::Replayed { run, touches, has_begun: false, events: Vec::new() })
    }

    fn next(&mut self, recorded: &Recorded) -> Result<Option<RecordedFrame>, ReadError> {
        match self {
            FrameSource::Stored(frames) => frames.next(),
            FrameSource::Replayed { run, touches, has_begun, events } => {
                let (schema, mut frame) = (&recorded.schema, Frame::default());
                let is_first = !std::mem::replace(has_begun, true);
                if !is_first && !super::replay::step(run, &recorded.path)? {
                    return Ok(None);
                }
                run.simulation.observe(Want::default(), &mut frame);
                if !is_first {
                    let mut contacts = Vec::new();
                    touches.step(&*run.simulation, &frame, &run.summary.events, &mut contacts);
                    let contacts = contacts.iter().filter(|event| event.is_contact());
                    events.extend(contacts.map(|event| RecordedEvent::of_contact(schema, event)));
                    events.extend(run.summary.events.iter().map(|event| RecordedEvent::of(schema, event)));
                }
                Ok(Some(RecordedFrame::of(schema, &frame)))
            }
        }
    }

    /// All events in order of time: surfaces that touch or part, and phase changes.
    fn events(self, recorded: &Recorded) -> Vec<RecordedEvent> {
        let mut events = match self {
            FrameSource::Stored(_) => [&recorded.contacts[..], &recorded.events].concat(),
            FrameSource::Replayed { events, .. } => events,
        };
        events.sort_by(|x, y| x.time.total_cmp(&y.time));
        events
    }
}

/// Whether a recording has too few frames to compare: it is thin, or cut short before they were complete.
fn must_run_again(recorded: &Recorded) -> Result<bool, ReadError> {
    if recorded.settings.frames == Frames::Thin {
        return Ok(true);
    }
    if recorded.end == End::Whole {
        return Ok(false);
    }
    let mut frames = FrameReader::open(recorded)?;
    Ok(frames.next()?.is_none() || frames.next()?.is_none())
}

/// Steps through the instants that are in both recordings.
fn walk(
    recorded: [&Recorded; 2],
    run_again: [bool; 2],
    mut visit: impl FnMut([&RecordedFrame; 2]) -> Result<(), SinkError>,
) -> Result<Result<[Vec<RecordedEvent>; 2], SinkError>, ReadError> {
    let [mut first, mut second] =
        [FrameSource::of(recorded[0], run_again[0])?, FrameSource::of(recorded[1], run_again[1])?];
    let (mut a, mut b) = (first.next(recorded[0])?, second.next(recorded[1])?);
    while let (Some(frame_a), Some(frame_b)) = (&a, &b) {
        if (frame_a.time - frame_b.time).abs() <= SAME_TIME {
            if let Err(error) = visit([frame_a, frame_b]) {
                return Ok(Err(error));
            }
            (a, b) = (first.next(recorded[0])?, second.next(recorded[1])?);
        } else if frame_a.time < frame_b.time {
            a = first.next(recorded[0])?;
        } else {
            b = second.next(recorded[1])?;
        }
    }
    // the events of a new run are complete only when it has reached its end
    while a.is_some() && matches!(first, FrameSource::Replayed { .. }) {
        a = first.next(recorded[0])?;
    }
    while b.is_some() && matches!(second, FrameSource::Replayed { .. }) {
        b = second.next(recorded[1])?;
    }
    Ok(Ok([first.events(recorded[0]), second.events(recorded[1])]))
}

/// Compares two recordings; differences up to `tolerance` [radii] are ignored.
///
/// # Errors
/// One of them cannot be read, or they do not have the same bodies.
pub fn diff(recorded: [&Recorded; 2], tolerance: f64) -> Result<Difference, ReadError> {
    let [a, b] = recorded;
    check_same_bodies(a, b)?;
    let mut bodies: Vec<Option<Worst>> = vec![None; a.schema.bodies.len()];
    let (mut instants, mut first_beyond) = (Vec::new(), None);
    let run_again = [must_run_again(a)?, must_run_again(b)?];
    let events = walk(recorded, run_again, |frames| {
        instants.push(frames.map(|frame| frame.step));
        let mut worst: Option<Worst> = None;
        for (index, body) in bodies.iter_mut().enumerate() {
            let Some(here) = difference(&a.schema, frames, index) else { continue };
            if here.difference > worst.as_ref().map_or(0.0, |worst| worst.difference) {
                worst = Some(here.clone());
            }
            if body.as_ref().is_none_or(|known| here.difference > known.difference) {
                *body = Some(here);
            }
        }
        first_beyond = first_beyond.take().or(worst.filter(|worst| worst.difference > tolerance));
        Ok(())
    })?;
    let mut bodies: Vec<Worst> = bodies.into_iter().flatten().collect();
    bodies.sort_by(|x, y| y.difference.total_cmp(&x.difference));
    let has_bits = a.schema.dt == b.schema.dt;
    let mut common = (a.first.max(b.first)..=a.last().min(b.last())).filter(|_| has_bits);
    // events before the start of the later recording or after the end of the shorter one do not count as differences
    let (steps, dt) = ([a.first, b.first, a.last(), b.last()], [a.schema.dt, b.schema.dt]);
    let [from_a, from_b, to_a, to_b] = std::array::from_fn(|i| steps[i] as f64 * dt[i % 2]);
    let (start, end) = (from_a.max(from_b), to_a.min(to_b));
    let is_common = |event: &RecordedEvent| (start..=end).contains(&event.time);
    let count = |events: &[Vec<RecordedEvent>; 2]| events.iter().map(Vec::len).sum::<usize>();
    let all = events.as_ref().map_or(0, count);
    let events = events.map(|events| events.map(|list| list.into_iter().filter(is_common).collect::<Vec<_>>()));
    let event_count_beyond = all - events.as_ref().map_or(0, count);
    let [quantities_a, quantities_b] = [quantities::Recorded::read(a)?, quantities::Recorded::read(b)?];
    let surfaces = (!quantities_a.is_empty() && !quantities_b.is_empty()).then(|| {
        let mut deviations = Deviations::new(tolerance, 1.0);
        quantities_a.compare(&quantities_b, &instants, a.schema.dt, &mut deviations);
        deviations.finish()
    });
    // bodies that differ within the tolerance meet, touch and part earlier or later
    let is_tolerable = |change: &Change| {
        let Change::Moved(was, is) = change else { return false };
        let change_in = |of: &quantities::Recorded, dt: f64| of.change_of_gap(&was.pair, [was.time / dt, is.time / dt]);
        let change = change_in(&quantities_a, a.schema.dt).or_else(|| change_in(&quantities_b, b.schema.dt));
        change.is_some_and(|change| change <= SENSITIVITY * tolerance)
    };
    let event_count = events.as_ref().map_or(0, |[first, _]| first.len());
    let mut changes = events.map(|[first, second]| events::compare(&first, &second)).unwrap_or_default();
    changes.retain(|change| !is_tolerable(change));
    Ok(Difference {
        starts: if a.first.max(b.first) == 0 { starts(a, b).unwrap_or_default() } else { Vec::new() },
        has_others: quantities_a.has_others(&quantities_b),
        tolerance,
        dt: a.schema.dt,
        instants: instants.len() as u64,
        surfaces,
        // a recording that was cut short has no checksums of its last frames
        first_bits: common.find(|&step| a.checksum(step).zip(b.checksum(step)).is_some_and(|(a, b)| a != b)),
        has_bits,
        bodies,
        first_beyond,
        event_count,
        event_count_beyond,
        events: changes,
        common: [start, end],
        run_again,
    })
}

/// The pairs whose phases differ before the first step, in words.
///
/// # Errors
/// One of the runs cannot be started here, which a comparison of recorded frames does not need.
fn starts(a: &Recorded, b: &Recorded) -> Result<Vec<String>, ReadError> {
    let phases = |of: &Recorded| {
        let mut frame = Frame::default();
        of.start()?.observe(Want::default(), &mut frame);
        let phase = |pair: &PairFrame| Some(([pair.a, pair.b], of.schema.phases.get(pair.phase)?.name));
        Ok(frame.pairs.iter().filter_map(phase).collect::<BTreeMap<_, _>>())
    };
    let [first, second] = [phases(a)?, phases(b)?];
    let apart = |of: &Recorded| of.schema.phases.first().map_or("", |phase| phase.name);
    let pairs: BTreeSet<[usize; 2]> = first.keys().chain(second.keys()).copied().collect();
    let differing = pairs.into_iter().filter_map(|pair| {
        let phase = |phases: &BTreeMap<_, _>, of| phases.get(&pair).copied().unwrap_or_else(|| apart(of));
        let [one, two] = [phase(&first, a), phase(&second, b)];
        (one != two).then(|| format!("{}: {one} and {two}", a.schema.pair_name(pair[0], pair[1])))
    });
    Ok(differing.collect())
}

/// Writes a recording that shows both runs.
///
/// # Errors
/// One of the recordings cannot be read. The inner error: the file cannot be written.
pub fn save(
    recorded: [&Recorded; 2],
    difference: &Difference,
    tolerance: f64,
    path: &std::path::Path,
) -> Result<Result<Option<Saved>, SinkError>, ReadError> {
    let schema = &recorded[0].schema;
    let mut bodies: Vec<usize> = difference.bodies.iter().filter_map(|worst| schema.body(&worst.body)).collect();
    if bodies.is_empty() {
        bodies = (0..schema.bodies.len()).collect();
    }
    let mut pairs: Vec<[usize; 2]> = Vec::new();
    let earliest = difference.events.iter().min_by(|x, y| x.event().time.total_cmp(&y.event().time));
    for change in earliest.into_iter().chain(events::listed(&difference.events, LISTED)) {
        let pair = change.event().pair.split_once('~').and_then(|(a, b)| Some([schema.body(a)?, schema.body(b)?]));
        pairs.extend(pair.filter(|pair| pairs.len() < MAX_PAIRS && !pairs.contains(pair)));
    }
    // the first to differ is shown first
    let first = |&[a, b]: &[usize; 2]| {
        let pair = schema.pair_name(a, b);
        let of_pair = difference.events.iter().map(|change| change.event()).filter(|event| event.pair == pair);
        of_pair.map(|event| event.time).fold(f64::INFINITY, f64::min)
    };
    pairs.sort_by(|one, other| first(one).total_cmp(&first(other)));
    let plan = Plan {
        changes: &difference.events,
        common: difference.common,
        second: &recorded[1].schema,
        pairs,
        labels: [[recorded[0], recorded[1]], [recorded[1], recorded[0]]].map(|[recorded, other]| {
            let name = recorded.path.file_name().unwrap_or_default().to_string_lossy();
            let Schema { integrator, dt, .. } = &recorded.schema;
            let by = if integrator.is_empty() { String::new() } else { format!("{integrator}, ") };
            format!("{name} ({by}Δt = {} s{})", step_size(*dt), recorded.overridden_beside(other))
        }),
        listed: [(difference.first_beyond.as_ref(), "first beyond tolerance"), (difference.bodies.first(), "largest")]
            .into_iter()
            .filter_map(|(worst, what)| Some((worst?.clone(), what)))
            .collect(),
        bodies,
        tolerance,
    };
    let mut comparison = match Comparison::new(schema, &recorded[0].start()?.framing(false), &plan, path) {
        Ok(comparison) => comparison,
        Err(error) => return Ok(Err(error)),
    };
    if difference.events.is_empty() {
        comparison.same_events(difference.event_count, &difference.beyond());
    }
    for deviation in difference.surfaces.iter().flatten().take(LISTED) {
        comparison.deviation(deviation);
    }
    let walked = walk(recorded, difference.run_again, |frames| {
        let centres = frames.map(|frame| &frame.centres[..]);
        comparison
            .frame(schema, frames[0].at(), tolerance, centres, |index| frames.map(|frame| frame.world_positions(index)))
    })?;
    Ok(walked.and_then(|_| comparison.finish()))
}

/// The worst vertex of a body at an instant; `None` if there is no difference.
fn difference(schema: &Schema, frames: [&RecordedFrame; 2], index: usize) -> Option<Worst> {
    let [first, second] = frames.map(|frame| frame.local_positions(index));
    let (first, second) = (first?, second?);
    let shift = frames[1].centres[index].as_dvec3() - frames[0].centres[index].as_dvec3();
    let body = &schema.bodies[index];
    let noise = frames.map(|frame| frame.noise(index, body.radius)).into_iter().fold(0.0, f64::max);
    let far = frames.map(|frame| frame.distance_of_centre(index)).into_iter().fold(0.0, f64::max);
    let noise = noise + if shift == glam::DVec3::ZERO { 0.0 } else { 2.0 * f64::from(f32::EPSILON) * far };
    let positions = first.into_iter().zip(second.into_iter().map(|position| position + shift));
    Worst::of(frames[0].at(), body, noise, positions)
}

/// Checks that both recordings have the same bodies with the same vertices, so that they can be compared.
fn check_same_bodies(a: &Recorded, b: &Recorded) -> Result<(), ReadError> {
    let [first, second] =
        [a, b].map(|recorded| recorded.schema.bodies.iter().map(|body| (&body.name, &body.shape)).collect::<Vec<_>>());
    if first == second {
        return Ok(());
    }
    let what = if first.len() != second.len() {
        format!("{}, the one in {} has {}", counted(second.len() as u64, "body"), a.path.display(), first.len())
    } else {
        let name = first.iter().zip(&second).find(|(a, b)| a != b).map_or("", |(_, (name, _))| name);
        format!("a body \"{name}\" where the one in {} has another", a.path.display())
    };
    Err(ReadError::Unsupported {
        path: b.path.clone(),
        what: format!("has a different scene: \"{}\" has {what}", b.schema.name),
    })
}
