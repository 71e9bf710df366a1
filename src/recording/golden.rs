//! What a scene should give, and whether it does.
//!
//! A golden recording is thin: the scene and a checksum of every step. So that a difference can be named, it also has
//! the events, two bytes of hash for every vertex that has moved and every step ([`VERTICES`]), which tells at which
//! vertices two states part, and every so many steps the displacements themselves, in full ([`STATES`]).

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    sync::Arc,
};

use glam::DVec3;
use rerun::{
    AnyValues,
    external::arrow::{
        array::{ArrayRef, AsArray as _, Float64Array, UInt16Array, UInt32Array},
        datatypes::{Float64Type, UInt16Type, UInt32Type},
    },
};

use super::{
    ReadError, Recorded,
    comparison::{Comparison, Plan},
    frames::Worst,
    happenings::{self, Change},
    read::Reader,
    recorded::{Happened, raw, step_of},
    replay::whole,
};
use crate::{
    scene::Scene,
    sim::{World, checksum, world::States},
    stream::{
        Recorder,
        instant::Instant,
        settings::{Frames, Settings},
        sinks::{Destinations, SinkError, Sinks},
    },
};

/// Two bytes for every vertex of every body that is not at rest, every step: `bodies` and `hashes`.
pub const VERTICES: &str = "/golden/vertices";
/// The displacements of every body that is not at rest, every [`STATE_EVERY`] steps: `bodies` and `displacements`, x, y
/// and z of each vertex [scene unit].
pub const STATES: &str = "/golden/states";
/// A third of a second of most scenes.
pub const STATE_EVERY: u64 = 20;

/// Why a golden recording could not be made.
#[derive(Debug, thiserror::Error)]
pub enum BlessError {
    /// It cannot be written.
    #[error(transparent)]
    Sink(#[from] SinkError),
    /// The scene cannot be run, or is no example to anyone.
    #[error("{0}")]
    Scene(String),
}

/// A golden recording that was made.
#[derive(Clone, Debug)]
pub struct Blessed {
    /// Hash of all its checksums.
    pub digest: u64,
    /// Its size [bytes].
    pub bytes: u64,
}

/// Makes the golden recording of a scene.
///
/// # Errors
/// The scene is too large or diverges, or the file cannot be written.
pub fn bless(scene: &Scene, path: &Path, reason: &str) -> Result<Blessed, BlessError> {
    let settings = Settings { frames: Frames::Thin, ..Settings::of(scene) };
    let mut world = World::new(scene.clone()).map_err(|error| BlessError::Scene(error.to_string()))?;
    let mut sinks = Sinks::open(&Destinations { save: Some(path.to_owned()), ..Destinations::default() })?;
    let mut recorder = Recorder::new(&world, settings);
    recorder.log_property("blessed", reason);
    recorder.log_property("counts", &counts(scene));
    let mut checksums = vec![world.checksum()];
    for step in 1..=scene.steps() {
        if let Some(failure) = &world.step().failure {
            return Err(BlessError::Scene(failure.to_string()));
        }
        recorder.observe(&world);
        recorder.log_events(&world);
        checksums.push(world.checksum());
        let awake: Vec<usize> = (0..world.body_count()).filter(|&index| !world.body(index).is_at_rest()).collect();
        let bodies = |field: ArrayRef, name: &'static str| {
            let bodies: UInt32Array = awake.iter().map(|&index| index as u32).collect::<Vec<_>>().into();
            AnyValues::default()
                .with_component_from_data("bodies", Arc::new(bodies))
                .with_component_from_data(name, field)
        };
        if !awake.is_empty() {
            let hashes: Vec<u16> = awake.iter().flat_map(|&index| vertex_hashes(&world, index)).collect();
            recorder.log(VERTICES, &world, &bodies(Arc::new(UInt16Array::from(hashes)), "hashes"));
        }
        if !awake.is_empty() && (step % STATE_EVERY == 0 || step == scene.steps()) {
            let displacements: Vec<f64> =
                awake.iter().flat_map(|&index| displacements(&world, index)).flat_map(|x| x.to_array()).collect();
            recorder.log(STATES, &world, &bodies(Arc::new(Float64Array::from(displacements)), "displacements"));
        }
        if step % 256 == 0 {
            recorder.take().into_iter().try_for_each(|message| sinks.send(message))?;
        }
    }
    recorder.finish(&world);
    recorder.take().into_iter().try_for_each(|message| sinks.send(message))?;
    let saved = sinks.finish()?.save;
    Ok(Blessed { digest: digest(&checksums), bytes: saved.map_or(0, |saved| saved.bytes) })
}

/// One number for all checksums of a recording.
pub fn digest(checksums: &[u64]) -> u64 {
    checksum::sequence(checksums.iter().copied())
}

fn counts(scene: &Scene) -> String {
    let triangles: u64 = scene.bodies.iter().map(|body| body.shape.triangle_count()).sum();
    format!("{} vertices, {triangles} triangles", scene.vertex_count())
}

/// Two bytes of hash of the state of each vertex of a body.
fn vertex_hashes(world: &World, index: usize) -> Vec<u16> {
    let States { displacement, velocity } = world.body(index).states();
    let hash =
        |(x, u): (DVec3, DVec3)| checksum::sequence([x, u].into_iter().flat_map(|v| v.to_array()).map(checksum::bits));
    displacement.iter().zip(velocity.iter()).map(|state| hash(state) as u16).collect()
}

fn displacements(world: &World, index: usize) -> Vec<DVec3> {
    world.body(index).states().displacement.iter().collect()
}

/// How a scene does beside its golden recording.
#[derive(Clone, Debug)]
pub enum Outcome {
    /// Every checksum is the same.
    Identical {
        /// Steps of the scene.
        steps: u64,
        /// Its events.
        events: usize,
        /// Hash of all checksums.
        digest: u64,
        /// The text of the scene is another one, to no effect.
        is_rewritten: bool,
    },
    /// They are not.
    Different(Box<Difference>),
}

/// What differs.
#[derive(Clone, Debug)]
pub struct Difference {
    /// Golden and present number of steps, if they differ.
    pub steps: Option<[u64; 2]>,
    /// Golden and present vertices and triangles, if they differ.
    pub counts: Option<[String; 2]>,
    /// Whether the text of the scene is another one than that of the golden recording.
    pub is_rewritten: bool,
    /// The first step with another checksum.
    pub first: Option<First>,
    /// The worst vertex of all states that the golden recording has from there on, displacements from rest.
    pub worst: Option<Worst>,
    /// Whether no vertex of those differs by more than the scene's tolerance allows.
    pub is_within_tolerance: bool,
    /// What differs of the events.
    pub events: Vec<Change>,
    /// The recording of both, if it could be written, or why it could not.
    pub comparison: Option<Result<PathBuf, String>>,
}

impl Difference {
    /// Whether nothing but bits differ: values within the tolerance, the same events, vertices and triangles.
    pub fn is_tolerable(&self) -> bool {
        self.steps.is_none() && self.counts.is_none() && self.events.is_empty() && self.is_within_tolerance
    }
}

/// Where two states part.
#[derive(Clone, Debug)]
pub struct First {
    /// The step.
    pub step: u64,
    /// Its time [s].
    pub time: f64,
    /// Its checksum in the golden recording …
    pub golden: u64,
    /// … and now.
    pub found: u64,
    /// Bodies that differ, and which of their vertices do; empty if only phases do.
    pub bodies: Vec<(String, Vec<usize>)>,
    /// Where the first of these vertices is now, from its rest position [scene unit].
    pub displacement: DVec3,
}

/// Runs a scene and compares it with its golden recording; what differs is written to `comparison` to look at, if given.
///
/// # Errors
/// The golden recording cannot be read, or the scene not be run.
pub fn check(scene: &Scene, golden: &Path, comparison: Option<&Path>) -> Result<Outcome, ReadError> {
    let recorded = Recorded::open(golden)?;
    let details = |step| Details::read(golden, step);
    let counts_then = Details::counts(golden)?;
    let mut world = super::replay::world(&recorded, scene.clone())?;
    let mut events = Vec::new();
    let mut first = None;
    for step in 0..=scene.steps() {
        if step > 0 {
            let report = world.step();
            whole(report, golden)?;
            events.extend(report.events.iter().map(|event| Happened::of(scene, event)));
        }
        if let (None, Some(golden)) = (first, recorded.checksum(step))
            && world.checksum() != golden
        {
            first = Some(step);
        }
    }
    let counts_now = counts(scene);
    let is_rewritten = scene.source != recorded.scene.source;
    let steps = [recorded.last(), scene.steps()];
    let same_counts = counts_then.as_ref().is_none_or(|then| *then == counts_now);
    if first.is_none() && steps[0] == steps[1] && same_counts {
        let digest = digest(&recorded.checksums);
        return Ok(Outcome::Identical { steps: steps[1], events: events.len(), digest, is_rewritten });
    }

    let mut difference = Difference {
        steps: (steps[0] != steps[1]).then_some(steps),
        counts: counts_then.filter(|_| !same_counts).map(|then| [then, counts_now]),
        is_rewritten,
        first: None,
        worst: None,
        is_within_tolerance: true,
        events: happenings::compare(&recorded.events, &events),
        comparison: None,
    };
    if let Some(step) = first
        && difference.counts.is_none()
    {
        let details = details(step)?;
        look(scene, &recorded, &details, step, &mut difference)?;
        if let Some(path) = comparison {
            difference.comparison = Some(show(scene, &details, &difference, path).map(|()| path.to_owned()));
        }
    }
    Ok(Outcome::Different(Box::new(difference)))
}

/// Runs a scene once more, and compares it with the details of its golden recording from `step` on.
fn look(
    scene: &Scene,
    recorded: &Recorded,
    details: &Details,
    step: u64,
    difference: &mut Difference,
) -> Result<(), ReadError> {
    let mut world = super::replay::world(recorded, scene.clone())?;
    let last = recorded.last().min(scene.steps());
    while world.steps_taken() <= last {
        if world.steps_taken() == step {
            difference.first = Some(details.part(&world, recorded.checksum(step).unwrap_or_default()));
        }
        if let Some(state) = details.states.get(&world.steps_taken()) {
            let worst = state.compare(&world);
            let allowed = tolerance(scene, world.time());
            difference.is_within_tolerance &= worst.as_ref().is_none_or(|worst| worst.difference <= allowed);
            let is_worse =
                |worst: &Worst| !difference.worst.as_ref().is_some_and(|known| known.difference >= worst.difference);
            if let Some(worst) = worst.filter(is_worse) {
                difference.worst = Some(worst);
            }
        }
        if world.steps_taken() == last {
            break;
        }
        whole(world.step(), &recorded.path)?;
    }
    Ok(())
}

/// What the scene's tolerance comes to at a time: radii per unit of scene time, for at least one of these.
fn tolerance(scene: &Scene, time: f64) -> f64 {
    scene.tolerance * time.max(1.0)
}

/// Writes both runs side by side.
fn show(scene: &Scene, details: &Details, difference: &Difference, path: &Path) -> Result<(), String> {
    let work = || -> Result<(), SinkError> {
        let Ok(mut world) = World::new(scene.clone()) else { return Ok(()) };
        let worst = difference.worst.as_ref();
        let body = |name: &str| scene.bodies.iter().position(|body| body.name == name);
        let mut bodies: Vec<usize> = worst.and_then(|worst| body(&worst.body)).into_iter().collect();
        let awake = details.states.values().flat_map(|state| state.bodies.keys().copied());
        for index in awake {
            if !bodies.contains(&index) {
                bodies.push(index);
            }
        }
        let plan = Plan {
            labels: ["the golden recording".to_owned(), "this run".to_owned()],
            largest: worst.map_or(0.0, |worst| worst.recorded.distance(worst.found)),
            bodies,
            tolerance: scene.tolerance,
        };
        let mut comparison = Comparison::new(scene, &plan, path)?;
        for change in &difference.events {
            let time = change.time();
            comparison.event(Instant { step: (time / scene.dt).ceil().max(0.0) as u64, time }, &change.to_string());
        }
        let last = details.states.keys().next_back().copied().unwrap_or(0);
        while world.steps_taken() < last.min(scene.steps()) {
            if world.step().failure.as_ref().is_some_and(|failure| !failure.is_whole_step()) {
                break;
            }
            if let Some(state) = details.states.get(&world.steps_taken()) {
                let at = Instant { step: world.steps_taken(), time: world.time() };
                comparison.frame(scene, at, tolerance(scene, world.time()), |index| {
                    let now = world.body(index);
                    let then = |vertex: usize| {
                        let displacement = state.bodies.get(&index).and_then(|x| x.get(vertex).copied());
                        now.centre() + now.rest(vertex) + displacement.unwrap_or_default()
                    };
                    [Some((0..now.vertex_count()).map(then).collect()), Some(now.positions().collect())]
                })?;
            }
        }
        comparison.finish().map(|_| ())
    };
    work().map_err(|error| error.to_string())
}

/// A state as a golden recording has it.
#[derive(Clone, Debug, Default)]
struct State {
    /// Displacements of the vertices of bodies that are not at rest [scene unit].
    bodies: BTreeMap<usize, Vec<DVec3>>,
}

impl State {
    /// The worst vertex beside a world; `None` if there is no difference.
    fn compare(&self, world: &World) -> Option<Worst> {
        let mut worst: Option<Worst> = None;
        let mut vertices = 0;
        for (index, body) in world.bodies().enumerate() {
            let golden = self.bodies.get(&index);
            if golden.is_none() && body.is_at_rest() {
                continue;
            }
            for vertex in 0..body.vertex_count() {
                let recorded = golden.and_then(|golden| golden.get(vertex).copied()).unwrap_or_default();
                let found = body.displacement(vertex);
                if recorded == found {
                    continue;
                }
                vertices += 1;
                let difference = recorded.distance(found) / body.scene().radius;
                if worst.as_ref().is_none_or(|worst| !(difference <= worst.difference)) {
                    let (step, time, name) = (world.steps_taken(), world.time(), body.name().to_owned());
                    worst = Some(Worst { step, time, body: name, vertex, recorded, found, difference, vertices });
                }
            }
        }
        worst.map(|worst| Worst { vertices, ..worst })
    }
}

/// What a golden recording has besides checksums, as far as it concerns a step.
#[derive(Default)]
struct Details {
    /// Hashes of the vertices of bodies that are not at rest, at that step.
    hashes: BTreeMap<usize, Vec<u16>>,
    /// States from that step on.
    states: BTreeMap<u64, State>,
}

impl Details {
    fn counts(path: &Path) -> Result<Option<String>, ReadError> {
        let mut reader = Reader::open(path)?;
        while let Some(chunk) = reader.next(|entity| entity == "/__properties/meldscope")? {
            if let Some(text) = super::recorded::cell::<rerun::datatypes::Utf8>(&chunk, "counts", 0).first() {
                return Ok(Some(text.as_str().to_owned()));
            }
        }
        Ok(None)
    }

    fn read(path: &Path, step: u64) -> Result<Details, ReadError> {
        let scene = Recorded::open(path)?.scene;
        let mut details = Details::default();
        let mut reader = Reader::open(path)?;
        while let Some(chunk) = reader.next(|entity| entity == VERTICES || entity == STATES)? {
            let is_states = chunk.entity_path().to_string() == STATES;
            for row in 0..chunk.num_rows() {
                let damaged = |what: String| ReadError::Damaged { path: path.to_owned(), at: None, what };
                let at = u64::try_from(step_of(&chunk, row).map_err(damaged)?).unwrap_or(0);
                let bodies = raw(&chunk, "bodies", row);
                let bodies = bodies.as_ref().and_then(|bodies| bodies.as_primitive_opt::<UInt32Type>());
                let Some(bodies) = bodies else { continue };
                let sizes = bodies.values().iter().filter_map(|&index| {
                    let body = scene.bodies.get(index as usize)?;
                    Some((index as usize, body.shape.vertex_count() as usize))
                });
                let mut first = 0;
                if is_states && at >= step {
                    let values = raw(&chunk, "displacements", row);
                    let values = values.as_ref().and_then(|values| values.as_primitive_opt::<Float64Type>());
                    let values = values.map(|values| values.values().as_ref()).unwrap_or_default();
                    let state = details.states.entry(at).or_default();
                    for (index, count) in sizes {
                        let own: &[f64] = values.get(3 * first..3 * (first + count)).unwrap_or_default();
                        let vectors = own.as_chunks::<3>().0.iter().map(|&x| DVec3::from_array(x));
                        state.bodies.insert(index, vectors.collect());
                        first += count;
                    }
                } else if !is_states && at == step {
                    let values = raw(&chunk, "hashes", row);
                    let values = values.as_ref().and_then(|values| values.as_primitive_opt::<UInt16Type>());
                    let values = values.map(|values| values.values().as_ref()).unwrap_or_default();
                    for (index, count) in sizes {
                        let own: &[u16] = values.get(first..first + count).unwrap_or_default();
                        details.hashes.insert(index, own.to_vec());
                        first += count;
                    }
                }
            }
        }
        Ok(details)
    }

    /// Which vertices of a world differ at the step.
    fn part(&self, world: &World, golden: u64) -> First {
        let mut bodies: Vec<(usize, Vec<usize>)> = Vec::new();
        for (index, body) in world.bodies().enumerate() {
            let vertices: Vec<usize> = match (self.hashes.get(&index), body.is_at_rest()) {
                (None, true) => Vec::new(),
                (Some(then), false) => {
                    let now = vertex_hashes(world, index);
                    (0..body.vertex_count()).filter(|&vertex| then.get(vertex) != now.get(vertex)).collect()
                }
                _ => (0..body.vertex_count()).collect(),
            };
            if !vertices.is_empty() {
                bodies.push((index, vertices));
            }
        }
        let first = bodies.first().and_then(|(index, vertices)| Some((*index, *vertices.first()?)));
        First {
            step: world.steps_taken(),
            time: world.time(),
            golden,
            found: world.checksum(),
            displacement: first.map_or(DVec3::ZERO, |(index, vertex)| world.body(index).displacement(vertex)),
            bodies: bodies
                .into_iter()
                .map(|(index, vertices)| (world.body(index).name().to_owned(), vertices))
                .collect(),
        }
    }
}
