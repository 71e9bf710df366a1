//! Two recordings of a scene side by side, aligned by simulated time.
//!
//! Surfaces are taken from the recordings (they may be of programs that are no more), in the precision that they have
//! there: some 1e-7 of a radius. A recording without surfaces is run again.

use std::path::PathBuf;

use glam::DVec3;

use super::{
    ReadError, Recorded,
    comparison::{Comparison, Plan},
    frames::{Frame, Frames, Kind, Surface, Worst},
    happenings::{self, Change},
    recorded::Happened,
};
use crate::{
    scene::Scene,
    sim::World,
    stream::{
        instant::Instant,
        recorder::DEFORMED,
        settings::Frames as Recording,
        sinks::{Saved, SinkError},
    },
};

/// Instants no farther apart are the same [s]: recordings have nanoseconds.
const SAME_TIME: f64 = 2e-9;

/// What differs between two recordings.
#[derive(Clone, Debug)]
pub struct Difference {
    /// Instants that both have.
    pub instants: u64,
    /// The first step of the first recording whose checksum is another one; `None` if all are the same, or if steps are
    /// not comparable.
    pub first_bits: Option<u64>,
    /// Whether checksums could be compared: the same Δt.
    pub has_bits: bool,
    /// For each body that differs: where it does most, the worst first. `recorded` is in the first, `found` in the second.
    pub bodies: Vec<Worst>,
    /// The first instant at which something differs by more than the tolerance, and its worst vertex.
    pub first_beyond: Option<Worst>,
    /// What differs of the events.
    pub events: Vec<Change>,
    /// Which of the two had to be run again, having no surfaces.
    pub run_again: [bool; 2],
}

/// Frames from a file, or from the scene.
enum Source {
    Stored(Box<Frames>),
    Again { world: Box<World>, last: u64, path: PathBuf, has_begun: bool, events: Vec<Happened> },
}

impl Source {
    fn of(recorded: &Recorded) -> Result<Source, ReadError> {
        if recorded.settings.frames != Recording::Thin {
            return Ok(Source::Stored(Box::new(Frames::open(recorded)?)));
        }
        let world = Box::new(super::replay::world(recorded, recorded.scene.clone())?);
        Ok(Source::Again {
            world,
            last: recorded.last(),
            path: recorded.path.clone(),
            has_begun: false,
            events: Vec::new(),
        })
    }

    fn next(&mut self) -> Result<Option<Frame>, ReadError> {
        match self {
            Source::Stored(frames) => frames.next(),
            Source::Again { world, last, path, has_begun, events } => {
                if std::mem::replace(has_begun, true) {
                    if world.steps_taken() >= *last {
                        return Ok(None);
                    }
                    super::replay::whole(world.step(), path)?;
                    events.extend(world.report().events.iter().map(|event| Happened::of(world.scene(), event)));
                }
                let surfaces = world.bodies().map(|body| {
                    let positions = (0..body.vertex_count()).map(|i| body.local_position(i).as_vec3()).collect();
                    Some(Surface { positions, kind: Kind::Local })
                });
                let surfaces = surfaces.collect();
                let centres = world.bodies().map(|body| Some(body.centre().as_vec3())).collect();
                Ok(Some(Frame { step: world.steps_taken(), time: world.time(), surfaces, centres }))
            }
        }
    }

    fn events(self, recorded: &Recorded) -> Vec<Happened> {
        match self {
            Source::Stored(_) => recorded.events.clone(),
            Source::Again { events, .. } => events,
        }
    }
}

/// Goes through the instants that two recordings have in common.
fn walk(
    recorded: [&Recorded; 2],
    mut look: impl FnMut([&Frame; 2]) -> Result<(), SinkError>,
) -> Result<Result<[Vec<Happened>; 2], SinkError>, ReadError> {
    let [mut first, mut second] = [Source::of(recorded[0])?, Source::of(recorded[1])?];
    let (mut a, mut b) = (first.next()?, second.next()?);
    while let (Some(frame_a), Some(frame_b)) = (&a, &b) {
        if (frame_a.time - frame_b.time).abs() <= SAME_TIME {
            if let Err(error) = look([frame_a, frame_b]) {
                return Ok(Err(error));
            }
            (a, b) = (first.next()?, second.next()?);
        } else if frame_a.time < frame_b.time {
            a = first.next()?;
        } else {
            b = second.next()?;
        }
    }
    // events of what is run again are known when it has run to its end
    while a.is_some() && matches!(first, Source::Again { .. }) {
        a = first.next()?;
    }
    while b.is_some() && matches!(second, Source::Again { .. }) {
        b = second.next()?;
    }
    Ok(Ok([first.events(recorded[0]), second.events(recorded[1])]))
}

/// Compares two recordings; `tolerance` [radii] is what does not matter.
///
/// # Errors
/// One of them cannot be read, or they are not of the same bodies.
pub fn diff(recorded: [&Recorded; 2], tolerance: f64) -> Result<Difference, ReadError> {
    let [a, b] = recorded;
    same_bodies(a, b)?;
    let mut bodies: Vec<Option<Worst>> = vec![None; a.scene.bodies.len()];
    let (mut instants, mut first_beyond) = (0, None);
    let events = walk(recorded, |frames| {
        instants += 1;
        let mut worst: Option<Worst> = None;
        for (index, body) in bodies.iter_mut().enumerate() {
            let Some(here) = difference(recorded, frames, index) else { continue };
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
    let has_bits = a.scene.dt == b.scene.dt;
    let mut common = (a.first.max(b.first)..=a.last().min(b.last())).filter(|_| has_bits);
    // events after the shorter one's end are no difference
    let end = (a.last() as f64 * a.scene.dt).min(b.last() as f64 * b.scene.dt);
    let events = events.map(|events| events.map(|list| list.into_iter().filter(|e| e.time <= end).collect::<Vec<_>>()));
    Ok(Difference {
        instants,
        first_bits: common.find(|&step| a.checksum(step) != b.checksum(step)),
        has_bits,
        bodies,
        first_beyond,
        events: events.map(|[first, second]| happenings::compare(&first, &second)).unwrap_or_default(),
        run_again: recorded.map(|recorded| recorded.settings.frames == Recording::Thin),
    })
}

/// Writes both side by side.
///
/// # Errors
/// One of them cannot be read; within: the file cannot be written.
pub fn save(
    recorded: [&Recorded; 2],
    difference: &Difference,
    tolerance: f64,
    path: &std::path::Path,
) -> Result<Result<Option<Saved>, SinkError>, ReadError> {
    let scene = &recorded[0].scene;
    let index = |worst: &Worst| scene.bodies.iter().position(|body| body.name == worst.body);
    let mut bodies: Vec<usize> = difference.bodies.iter().filter_map(index).collect();
    if bodies.is_empty() {
        bodies = (0..scene.bodies.len()).collect();
    }
    let plan = Plan {
        labels: recorded.map(|recorded| {
            let name = recorded.path.file_name().unwrap_or_default().to_string_lossy();
            format!("{name} ({}, Δt = {} s)", recorded.scene.integrator, recorded.scene.dt)
        }),
        largest: difference.bodies.iter().map(|worst| worst.recorded.distance(worst.found)).fold(0.0, f64::max),
        bodies,
        tolerance,
    };
    let mut comparison = match Comparison::new(scene, &plan, path) {
        Ok(comparison) => comparison,
        Err(error) => return Ok(Err(error)),
    };
    for change in &difference.events {
        let time = change.time();
        comparison.event(Instant { step: (time / scene.dt).ceil().max(0.0) as u64, time }, &change.to_string());
    }
    let walked = walk(recorded, |frames| {
        let at = Instant { step: frames[0].step, time: frames[0].time };
        comparison.frame(scene, at, tolerance, |index| {
            let side = |side: usize| frames[side].world_positions(&recorded[side].scene, index);
            [side(0), side(1)]
        })
    })?;
    Ok(walked.and_then(|_| comparison.finish()))
}

/// The worst vertex of a body at an instant; `None` without a difference.
fn difference(recorded: [&Recorded; 2], frames: [&Frame; 2], index: usize) -> Option<Worst> {
    let local = |side: usize| frames[side].local_positions(&recorded[side].scene, index);
    let centre = |side: usize| frames[side].centre(&recorded[side].scene, index);
    let shift = centre(1) - centre(0);
    let (first, second) = (local(0)?, local(1)?);
    let body: &crate::scene::Body = body(&recorded[0].scene, index)?;
    let noise = (0..2).map(|side| frames[side].noise(&recorded[side].scene, index)).fold(0.0, f64::max);
    let mut worst: Option<Worst> = None;
    let mut vertices = 0;
    for (vertex, (&x, &y)) in first.iter().zip(&second).enumerate() {
        let (recorded, found) = (x, y + shift);
        if recorded.distance(found) <= noise {
            continue;
        }
        vertices += 1;
        let difference = recorded.distance(found) / body.radius;
        if worst.as_ref().is_none_or(|worst| !(difference <= worst.difference)) {
            let (step, time, name) = (frames[0].step, frames[0].time, body.name.clone());
            worst = Some(Worst { step, time, body: name, vertex, recorded, found, difference, vertices });
        }
    }
    worst.map(|worst| Worst { vertices, ..worst })
}

fn body(scene: &Scene, index: usize) -> Option<&crate::scene::Body> {
    scene.bodies.get(index)
}

/// Two recordings can be compared if they have the same bodies with the same vertices.
fn same_bodies(a: &Recorded, b: &Recorded) -> Result<(), ReadError> {
    let [first, second] =
        [a, b].map(|recorded| recorded.scene.bodies.iter().map(|body| (&body.name, &body.shape)).collect::<Vec<_>>());
    if first == second {
        return Ok(());
    }
    let what = if first.len() != second.len() {
        format!("{} bodies, and that in {} {}", second.len(), a.path.display(), first.len())
    } else {
        let name = first.iter().zip(&second).find(|(a, b)| a != b).map_or("", |(_, (name, _))| name.as_str());
        format!("a body \"{name}\" where that in {} has another one", a.path.display())
    };
    Err(ReadError::Unsupported {
        path: b.path.clone(),
        what: format!("has another scene: \"{}\" has {what}", b.scene.name),
    })
}

impl Frame {
    /// Where the centre of a body is [scene unit].
    fn centre(&self, scene: &Scene, index: usize) -> DVec3 {
        match (self.centres.get(index).copied().flatten(), body(scene, index)) {
            (Some(centre), _) => centre.as_dvec3(),
            (None, Some(body)) => body.path.position(self.time).as_vec3().as_dvec3(), // as others are recorded
            (None, None) => DVec3::ZERO,
        }
    }

    /// What is lost of the surface of a body by how it was recorded, beside its own single precision [scene unit].
    fn noise(&self, scene: &Scene, index: usize) -> f64 {
        let (Some(Some(surface)), Some(body)) = (self.surfaces.get(index), body(scene, index)) else { return 0.0 };
        match surface.kind {
            Kind::Local => 0.0,
            Kind::World => {
                let far = self.centre(scene, index).abs().max_element() + 2.0 * body.radius;
                2.0 * f64::from(f32::EPSILON) * far
            }
            Kind::Resting => DEFORMED * body.radius,
        }
    }

    /// Where the vertices of a body are, from its centre [scene unit].
    fn local_positions(&self, scene: &Scene, index: usize) -> Option<Vec<DVec3>> {
        let surface = self.surfaces.get(index)?.as_ref()?;
        let origin = if surface.kind == Kind::World { self.centre(scene, index) } else { DVec3::ZERO };
        Some(surface.positions.iter().map(|position| position.as_dvec3() - origin).collect())
    }
}
