//! Golden recordings: the expected results of a scene, and comparison with them.
//!
//! A golden recording is thin: the scene, the events and a checksum of every step. To locate a difference, it also has
//! a two-byte hash for every displaced vertex at every step ([`GOLDEN_VERTICES`]), which shows at which vertices two states
//! diverge, and at regular intervals the full displacements ([`GOLDEN_STATES`]) and geometric quantities ([`GOLDEN_SURFACES`]).

use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
    sync::Arc,
};

use glam::{DQuat, DVec3};

use super::{
    ReadError, Recorded,
    comparison::{Comparison, Plan},
    events::{self, Change},
    quantities::{self, Deviation, Deviations, Values},
    read::Reader,
    recorded::{RecordedEvent, cell, numbers, start, step_of},
    replay,
};
use crate::{
    analysis::{Worst, surface::Merger},
    geometry::Vectors,
    hash,
    observe::{BodyFrame, Experiment, Frame, Run, Schema, Simulation, Want, schema::BodySchema},
    sdk::{
        self, AnyValues,
        arrow::{
            array::{ArrayRef, Float64Array, UInt16Array, UInt32Array},
            datatypes::{Float64Type, UInt16Type, UInt32Type},
        },
        components::Text,
    },
    stream::{
        Recorder,
        contract::{
            BLESSED, BODIES, COUNTS, Component, DISPLACEMENTS, FRAMES, GOLDEN_STATES, GOLDEN_SURFACES, GOLDEN_VERTICES,
            HASHES, QUANTITIES, VALUES, path_of,
        },
        settings::{Frames, Settings},
        sinks::{Complete, Destinations, SinkError, Sinks},
    },
};

/// Upper limit on the pairs whose surfaces are measured.
const MAX_PAIRS: usize = 64;
/// Differences of quantities below this count as rounding [tolerances].
const ROUNDING: f64 = 1e-3;
/// Steps between recorded states: a third of a second in most scenes.
pub const STATE_EVERY: u64 = 20;

/// Why a golden recording could not be made.
#[derive(Debug, thiserror::Error)]
pub enum BlessError {
    /// The file cannot be written.
    #[error(transparent)]
    Sink(#[from] SinkError),
    /// The scene cannot be run, or is not suitable as a reference.
    #[error("{0}")]
    Scene(String),
}

/// A golden recording that was just made.
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
pub fn bless(scene: &dyn Experiment, path: &Path, reason: &str) -> Result<Blessed, BlessError> {
    let (blessed, file) = prepare(scene, path, reason)?;
    file.map_or(Ok(()), Complete::place)?;
    Ok(blessed)
}

/// Makes the golden recording of a scene, but does not put the file in place yet.
///
/// # Errors
/// As for [`bless`].
pub fn prepare(scene: &dyn Experiment, path: &Path, reason: &str) -> Result<(Blessed, Option<Complete>), BlessError> {
    let settings = Settings { frames: Frames::Thin, ..Settings::of(scene) };
    let simulation = scene.start().map_err(BlessError::Scene)?;
    let (schema, mut frame) = (simulation.schema(), Frame::default());
    let mut sinks = Sinks::open(&Destinations::file(path))?;
    let mut recorder = Recorder::new(&*simulation, settings).map_err(BlessError::Scene)?;
    recorder.log_property(BLESSED, reason);
    recorder.log_property(COUNTS, &counts(&schema));
    let mut merger = Merger::new(&schema, None);
    let mut checksums = vec![simulation.checksum()];
    let mut run = Run::new(simulation, Some(schema.steps));
    while run.valid_step().map_err(|failure| BlessError::Scene(failure.to_string()))? {
        let simulation = &*run.simulation;
        let step = simulation.steps_taken();
        let has_state = step.is_multiple_of(STATE_EVERY) || step == schema.steps;
        recorder.observe(simulation, &run.summary).map_err(BlessError::Scene)?;
        checksums.push(simulation.checksum());
        simulation.observe(Want::default(), &mut frame);
        let awake: Vec<usize> = (0..frame.bodies.len()).filter(|&index| is_kept(&schema, &frame, index)).collect();
        let bodies = |field: ArrayRef, component: Component| {
            let bodies: UInt32Array = awake.iter().map(|&index| index as u32).collect::<Vec<_>>().into();
            AnyValues::default()
                .with_component_from_data(BODIES.0, Arc::new(bodies))
                .with_component_from_data(component.0, field)
        };
        if !awake.is_empty() {
            let hashes = |&i: &usize| vertex_hashes(&schema.bodies[i], &frame.bodies[i]);
            let hashes: Vec<u16> = awake.iter().flat_map(hashes).collect();
            recorder.log(GOLDEN_VERTICES.path, simulation, &bodies(Arc::new(UInt16Array::from(hashes)), HASHES));
        }
        if !awake.is_empty() && has_state {
            let displacements = |&i: &usize| {
                let now = &frame.bodies[i];
                (0..schema.bodies[i].vertex_count()).flat_map(|vertex| now.displacement(vertex).to_array())
            };
            let displacements: Vec<f64> = awake.iter().flat_map(displacements).collect();
            let mut state = bodies(Arc::new(Float64Array::from(displacements)), DISPLACEMENTS);
            let free = awake.iter().filter(|&&index| schema.bodies[index].is_free);
            let frames: Vec<f64> = free.flat_map(|&i| BodyPose::of(&frame.bodies[i]).to_array()).collect();
            if !frames.is_empty() {
                state = state.with_component_from_data(FRAMES.0, Arc::new(Float64Array::from(frames)));
            }
            recorder.log(GOLDEN_STATES.path, simulation, &state);
        }
        if has_state {
            let (names, values): (Vec<String>, Vec<f64>) = surfaces(&mut merger, &schema, &frame).into_iter().unzip();
            if !names.is_empty() {
                let quantities = AnyValues::default()
                    .with_component::<Text>(QUANTITIES.0, names)
                    .with_component_from_data(VALUES.0, Arc::new(Float64Array::from(values)));
                recorder.log(GOLDEN_SURFACES.path, simulation, &quantities);
            }
        }
        if step.is_multiple_of(256) {
            recorder.take().into_iter().try_for_each(|message| sinks.send(message))?;
        }
    }
    recorder.finish();
    recorder.take().into_iter().try_for_each(|message| sinks.send(message))?;
    let (finished, file) = sinks.complete();
    let saved = finished?.save;
    Ok((Blessed { digest: digest(&checksums), bytes: saved.map_or(0, |saved| saved.bytes) }, file))
}

/// Combines all checksums of a recording into one number.
pub fn digest(checksums: &[u64]) -> u64 {
    hash::sequence(checksums.iter().copied())
}

/// The geometric quantities of a frame.
fn surfaces(merger: &mut Merger, schema: &Schema, frame: &Frame) -> Values {
    let pairs: Vec<[usize; 2]> = frame.pairs.iter().take(MAX_PAIRS).map(|pair| [pair.a, pair.b]).collect();
    quantities::of_frame(schema, merger.merge(schema, frame, &pairs), &pairs)
}

fn counts(schema: &Schema) -> String {
    let triangles: usize = schema.bodies.iter().map(|body| body.mesh.triangles().len()).sum();
    format!("{} vertices, {triangles} triangles", schema.vertex_count())
}

/// Whether a golden recording stores details of a body in this state.
fn is_kept(schema: &Schema, frame: &Frame, index: usize) -> bool {
    schema.bodies[index].is_free || !frame.bodies[index].is_at_rest
}

/// A two-byte hash of the state of each vertex of a body. For a free body, it includes the centre and rotation.
fn vertex_hashes(body: &BodySchema, now: &BodyFrame) -> Vec<u16> {
    let pose = body.is_free.then(|| BodyPose::of(now).to_array());
    let hash = |vertex: usize| {
        let velocity = if now.is_at_rest { DVec3::ZERO } else { now.velocities.get(vertex) };
        let state = [now.displacement(vertex), velocity].into_iter().flat_map(|v| v.to_array());
        hash::sequence(pose.into_iter().flatten().chain(state).map(hash::bits)) as u16
    };
    (0..body.vertex_count()).map(hash).collect()
}

/// Centre and rotation of a body.
#[derive(Clone, Copy, Debug, PartialEq)]
struct BodyPose {
    centre: DVec3,
    rotation: DQuat,
}

impl BodyPose {
    const NUMBERS: usize = 7;

    fn of(now: &BodyFrame) -> BodyPose {
        BodyPose { centre: now.centre, rotation: now.rotation }
    }

    fn from_array([x, y, z, i, j, k, w]: [f64; BodyPose::NUMBERS]) -> BodyPose {
        BodyPose { centre: DVec3::new(x, y, z), rotation: DQuat::from_xyzw(i, j, k, w) }
    }

    fn to_array(self) -> [f64; BodyPose::NUMBERS] {
        let ([x, y, z], [i, j, k, w]) = (self.centre.to_array(), self.rotation.to_array());
        [x, y, z, i, j, k, w]
    }

    /// World position of a vertex at rest [scene unit].
    fn at_rest(self, l: DVec3) -> DVec3 {
        self.centre + self.rotation * l
    }
}

/// The result of comparing a scene with its golden recording.
#[derive(Clone, Debug)]
pub enum GoldenOutcome {
    /// Every checksum is equal.
    Identical {
        /// Number of steps of the scene.
        steps: u64,
        /// Number of events.
        events: usize,
        /// Hash of all checksums.
        digest: u64,
        /// Whether the text of the scene has changed, without effect on the results.
        is_rewritten: bool,
        /// Whether it is a golden recording, not any other.
        is_golden: bool,
    },
    /// Something differs.
    Different(Box<GoldenDifference>),
}

/// The differences between a scene and its golden recording.
#[derive(Clone, Debug)]
pub struct GoldenDifference {
    /// In words, what a golden recording without an end lacks.
    pub cut_short: Option<String>,
    /// Golden and current number of steps, if they differ.
    pub steps: Option<[u64; 2]>,
    /// Golden and current vertices and triangles, if they differ.
    pub counts: Option<[String; 2]>,
    /// Whether the text of the scene differs from that of the golden recording.
    pub is_rewritten: bool,
    /// The model and the integrator of the golden recording and now, if they differ.
    pub methods: Option<[String; 2]>,
    /// Whether it is a golden recording: any other has no states, to tell where and by how much they differ.
    pub is_golden: bool,
    /// The first step whose checksums differ.
    pub first: Option<First>,
    /// The first body that is elsewhere or has another size, if no checksum differs.
    pub moved: Option<Moved>,
    /// The worst vertex of all later states of the golden recording; its positions are displacements from rest, or
    /// world positions if the body is free.
    pub worst: Option<Worst>,
    /// Whether there are such states, and no vertex of them differs by more than the scene's tolerance.
    pub is_within_tolerance: bool,
    /// Differences between the events.
    pub events: Vec<Change>,
    /// Differences between geometric quantities, if the golden recording has them.
    pub surfaces: Vec<Deviation>,
    /// Path of the comparison recording, or why it could not be written; `None` if none was requested.
    pub comparison: Option<Result<PathBuf, String>>,
}

impl GoldenDifference {
    /// Whether the difference is only in rounding: values within the tolerance; the same events, vertices and
    /// triangles.
    pub fn is_tolerable(&self) -> bool {
        self.cut_short.is_none()
            && self.steps.is_none()
            && self.counts.is_none()
            && self.moved.is_none()
            && self.events.is_empty()
            && self.is_within_tolerance
            && self.surfaces.iter().all(|deviation| deviation.excess <= 1.0)
    }
}

/// A body that is elsewhere or has another size than with the golden recording's own scene. No checksum shows it if the
/// body rests on its path.
#[derive(Clone, Debug)]
pub struct Moved {
    /// Step number.
    pub step: u64,
    /// Its name.
    pub body: String,
    /// Golden and current radius and centre [scene unit].
    pub places: [(f64, DVec3); 2],
}

/// The first step at which two states differ.
#[derive(Clone, Debug)]
pub struct First {
    /// Step number.
    pub step: u64,
    /// Simulated time of the step [s].
    pub time: f64,
    /// Checksum in the golden recording.
    pub golden: u64,
    /// Checksum of the current run.
    pub found: u64,
    /// Bodies that differ, with the indices of the vertices that do; empty if only phases differ.
    pub bodies: Vec<(String, Vec<usize>)>,
    /// Current displacement of the first of these vertices from its rest position [scene unit].
    pub displacement: DVec3,
}

/// Runs a scene and compares it with its golden recording. If `comparison` is given, a recording that shows the
/// differences is written there.
///
/// # Errors
/// The golden recording cannot be read, or the scene cannot be run.
pub fn check(scene: &dyn Experiment, golden: &Path, comparison: Option<&Path>) -> Result<GoldenOutcome, ReadError> {
    let recorded = Recorded::open_as(golden, &|name, text, run| scene.read(name, text, run))?;
    let simulation = start(scene, golden)?;
    let schema = simulation.schema();
    let mut run = Run::again(simulation, schema.steps);
    let mut events = Vec::new();
    let mut first = None;
    let golden_surfaces = read_surfaces(golden)?;
    let (mut merger, mut frame) = (Merger::new(&schema, None), Frame::default());
    let mut deviations = Deviations::new(schema.tolerance, ROUNDING);
    loop {
        let simulation = &*run.simulation;
        let step = simulation.steps_taken();
        if let (None, Some(golden)) = (first, recorded.checksum(step))
            && simulation.checksum() != golden
        {
            first = Some(step);
        }
        if let Some(quantities) = golden_surfaces.get(&step) {
            simulation.observe(Want::default(), &mut frame);
            let found = surfaces(&mut merger, &schema, &frame);
            for (entity, &golden) in quantities {
                let found = found.get(entity).copied().unwrap_or(f64::NAN);
                deviations.compare(entity, step, frame.at.time, [golden, found]);
            }
        }
        if !replay::step(&mut run, golden)? {
            break;
        }
        events.extend(run.summary.events.iter().map(|event| RecordedEvent::of(&schema, event)));
    }
    let surfaces = deviations.finish();
    let counts_now = counts(&schema);
    let is_rewritten = schema.source != recorded.schema.source;
    let steps = [recorded.last(), schema.steps];
    let other_counts = recorded.counts.clone().filter(|then| *then != counts_now);
    let is_golden = recorded.blessed.is_some();
    // the end of a file that is cut short may lack events
    let cut_short = recorded.cut_short();
    let changes = if cut_short.is_some() { Vec::new() } else { events::compare(&recorded.events, &events) };
    let is_same = first.is_none() && steps[0] == steps[1] && other_counts.is_none() && cut_short.is_none();
    let is_same = is_same && changes.is_empty() && surfaces.is_empty();
    let moved = if is_same && is_rewritten { first_moved(scene, &recorded)? } else { None };
    if is_same && moved.is_none() {
        let (steps, events, digest) = (steps[1], events.len(), digest(&recorded.checksums));
        return Ok(GoldenOutcome::Identical { steps, events, digest, is_rewritten, is_golden });
    }

    let mut difference = GoldenDifference {
        cut_short,
        steps: (steps[0] != steps[1]).then_some(steps),
        counts: other_counts.map(|then| [then, counts_now]),
        is_rewritten,
        methods: Some([recorded.schema.method(), schema.method()]).filter(|[then, now]| then != now),
        is_golden,
        first: None,
        moved,
        worst: None,
        is_within_tolerance: is_golden,
        events: changes,
        surfaces,
        comparison: None,
    };
    if let Some(step) = first
        && difference.counts.is_none()
    {
        let details = Details::read(&recorded, step)?;
        compare_details(start(scene, golden)?, &schema, &recorded, &details, step, &mut difference)?;
        if let Some(path) = comparison.filter(|_| is_golden) {
            let shown = show(start(scene, golden)?, &schema, &details, &difference, path);
            difference.comparison = Some(shown.map(|()| path.to_owned()).map_err(|error| error.to_string()));
        }
    }
    Ok(GoldenOutcome::Different(Box::new(difference)))
}

/// Runs a scene beside that of its golden recording, up to the first step at which a body is elsewhere or has another size.
fn first_moved(scene: &dyn Experiment, recorded: &Recorded) -> Result<Option<Moved>, ReadError> {
    let simulations = [recorded.start()?, start(scene, &recorded.path)?];
    let schemas = simulations.each_ref().map(|simulation| simulation.schema());
    let mut runs = simulations.map(|simulation| Run::again(simulation, schemas[0].steps));
    let mut frames = [Frame::default(), Frame::default()];
    loop {
        for (run, frame) in runs.iter().zip(&mut frames) {
            run.simulation.observe(Want::default(), frame);
        }
        let place = |side: usize, body: usize| (schemas[side].bodies[body].radius, frames[side].bodies[body].centre);
        let bodies = 0..schemas[0].bodies.len().min(schemas[1].bodies.len());
        let places = |body: usize| [0, 1].map(|side| place(side, body));
        if let Some(body) = bodies.into_iter().find(|&body| places(body)[0] != places(body)[1]) {
            let (step, name) = (frames[1].at.step, schemas[1].bodies[body].name.clone());
            return Ok(Some(Moved { step, body: name, places: places(body) }));
        }
        for run in &mut runs {
            if !replay::step(run, &recorded.path)? {
                return Ok(None);
            }
        }
    }
}

/// The geometric quantities of a golden recording, by step.
fn read_surfaces(path: &Path) -> Result<BTreeMap<u64, Values>, ReadError> {
    let mut surfaces: BTreeMap<u64, Values> = BTreeMap::new();
    let mut reader = Reader::open(path)?;
    while let Some(chunk) = reader.next(|entity| GOLDEN_SURFACES.is(entity))? {
        for row in 0..chunk.num_rows() {
            let damaged = |what: String| ReadError::Damaged { path: path.to_owned(), at: None, what };
            let step = u64::try_from(step_of(&chunk, row).map_err(damaged)?).unwrap_or(0);
            let values = numbers::<Float64Type>(&chunk, VALUES, row).unwrap_or_default();
            let names = cell::<sdk::datatypes::Utf8>(&chunk, &QUANTITIES.descriptor(), row);
            let names = names.iter().map(|name| name.as_str().to_owned());
            surfaces.entry(step).or_default().extend(names.zip(values));
        }
    }
    Ok(surfaces)
}

/// Runs a scene again and compares it with the details of its golden recording from `step` on.
fn compare_details(
    simulation: Box<dyn Simulation>,
    schema: &Schema,
    recorded: &Recorded,
    details: &Details,
    step: u64,
    difference: &mut GoldenDifference,
) -> Result<(), ReadError> {
    let last = recorded.last().min(schema.steps);
    let (mut run, mut frame) = (Run::again(simulation, last), Frame::default());
    let steps: BTreeSet<u64> = details.states.keys().copied().chain([step]).collect();
    difference.is_within_tolerance &= !details.states.is_empty();
    for now in steps.into_iter().take_while(|now| *now <= last) {
        replay::go_to(now, &mut run, &recorded.path)?;
        run.simulation.observe(Want::default(), &mut frame);
        if now == step {
            let sums = [recorded.checksum(step).unwrap_or_default(), run.simulation.checksum()];
            difference.first = Some(details.first_difference(schema, &frame, sums));
        }
        if let Some(state) = details.states.get(&now) {
            let worst = state.compare(schema, &frame);
            let allowed = tolerance(schema, frame.at.time);
            difference.is_within_tolerance &= worst.as_ref().is_none_or(|worst| worst.difference <= allowed);
            let is_worse =
                |worst: &Worst| !difference.worst.as_ref().is_some_and(|known| known.difference >= worst.difference);
            if let Some(worst) = worst.filter(is_worse) {
                difference.worst = Some(worst);
            }
        }
    }
    Ok(())
}

/// The scene's tolerance accumulated up to a time: radii per unit of scene time, for at least one unit.
fn tolerance(schema: &Schema, time: f64) -> f64 {
    schema.tolerance * time.max(1.0)
}

/// Writes a recording that shows both runs.
fn show(
    simulation: Box<dyn Simulation>,
    schema: &Schema,
    details: &Details,
    difference: &GoldenDifference,
    path: &Path,
) -> Result<(), SinkError> {
    let worst = difference.worst.as_ref();
    let mut bodies: Vec<usize> = worst.and_then(|worst| schema.body(&worst.body)).into_iter().collect();
    for &index in details.states.values().flat_map(|state| state.bodies.keys()) {
        if !bodies.contains(&index) {
            bodies.push(index);
        }
    }
    let plan = Plan {
        changes: &difference.events,
        common: [0.0, f64::INFINITY],
        second: schema,
        labels: ["the golden recording".to_owned(), "this run".to_owned()],
        listed: worst.map(|worst| (worst.clone(), "largest")).into_iter().collect(),
        bodies,
        pairs: Vec::new(),
        tolerance: schema.tolerance,
    };
    let mut comparison = Comparison::new(schema, &simulation.framing(false), &plan, path)?;
    let (mut frame, mut local) = (Frame::default(), Vectors::default());
    let mut run = Run::again(simulation, schema.steps);
    for (&step, state) in details.states.iter().take_while(|(step, _)| **step <= schema.steps) {
        if replay::go_to(step, &mut run, path).is_err() {
            break;
        }
        run.simulation.observe(Want::default(), &mut frame);
        comparison.frame(schema, frame.at, tolerance(schema, frame.at.time), [&[]; 2], |index| {
            let (body, now) = (&schema.bodies[index], &frame.bodies[index]);
            now.local_positions(now.rest_of(body), &mut local);
            let found = local.iter().map(|position| now.centre + position).collect();
            let pose = state.poses.get(&index).copied().unwrap_or(BodyPose::of(now));
            let rest = |vertex| pose.at_rest(body.rest().position(vertex));
            let then =
                (0..body.vertex_count()).map(|vertex| rest(vertex) + state.displacement(index, vertex)).collect();
            [Some(then), Some(found)]
        })?;
    }
    comparison.finish().map(|_| ())
}

/// A state as stored in a golden recording.
#[derive(Clone, Debug, Default)]
struct GoldenState {
    /// Displacements of the vertices of bodies that are free or not at rest [scene unit].
    bodies: BTreeMap<usize, Vec<DVec3>>,
    /// Centres and rotations of free bodies.
    poses: BTreeMap<usize, BodyPose>,
}

impl GoldenState {
    fn displacement(&self, index: usize, vertex: usize) -> DVec3 {
        self.bodies.get(&index).and_then(|golden| golden.get(vertex).copied()).unwrap_or_default()
    }

    /// The worst vertex compared with another state; `None` if there is no difference.
    fn compare(&self, schema: &Schema, frame: &Frame) -> Option<Worst> {
        let bodies = schema.bodies.iter().zip(&frame.bodies).enumerate();
        let moved = bodies.filter(|(index, (_, now))| self.bodies.contains_key(index) || !now.is_at_rest);
        let worst = moved.map(|(index, (body, now))| {
            let poses = self.poses.get(&index).map(|&then| (then, BodyPose::of(now)));
            let states = (0..body.vertex_count()).map(|vertex| {
                let [then, found] = [self.displacement(index, vertex), now.displacement(vertex)];
                let Some((golden, current)) = poses else { return (then, found) };
                let l = body.rest().position(vertex);
                (golden.at_rest(l) + then, current.at_rest(l) + found)
            });
            Worst::of(frame.at, body, 0.0, states)
        });
        worst.fold(None, Worst::and)
    }
}

/// The details of a golden recording that locate a difference at a step.
#[derive(Default)]
struct Details {
    /// Vertex hashes of bodies that are free or not at rest, at that step.
    hashes: BTreeMap<usize, Vec<u16>>,
    /// States from that step on.
    states: BTreeMap<u64, GoldenState>,
}

impl Details {
    fn read(recorded: &Recorded, step: u64) -> Result<Details, ReadError> {
        let (schema, path) = (&recorded.schema, &recorded.path);
        let mut details = Details::default();
        let mut reader = Reader::open(path)?;
        while let Some(chunk) = reader.next(|entity| GOLDEN_VERTICES.is(entity) || GOLDEN_STATES.is(entity))? {
            let is_states = GOLDEN_STATES.is(&path_of(&chunk));
            for row in 0..chunk.num_rows() {
                let damaged = |what: String| ReadError::Damaged { path: path.to_owned(), at: None, what };
                let at = u64::try_from(step_of(&chunk, row).map_err(damaged)?).unwrap_or(0);
                let Some(bodies) = numbers::<UInt32Type>(&chunk, BODIES, row) else { continue };
                let sizes = bodies.iter().filter_map(|&index| {
                    let body = schema.bodies.get(index as usize)?;
                    Some((index as usize, body.vertex_count()))
                });
                let mut first = 0;
                if is_states && at >= step {
                    let values = numbers::<Float64Type>(&chunk, DISPLACEMENTS, row).unwrap_or_default();
                    let frames = numbers::<Float64Type>(&chunk, FRAMES, row).unwrap_or_default();
                    let state = details.states.entry(at).or_default();
                    let free = sizes.clone().map(|(index, _)| index).filter(|&index| schema.bodies[index].is_free);
                    let poses = frames.as_chunks::<{ BodyPose::NUMBERS }>().0;
                    state.poses.extend(free.zip(poses.iter().copied().map(BodyPose::from_array)));
                    for (index, count) in sizes {
                        let own: &[f64] = values.get(3 * first..3 * (first + count)).unwrap_or_default();
                        let vectors = own.as_chunks::<3>().0.iter().map(|&x| DVec3::from_array(x));
                        state.bodies.insert(index, vectors.collect());
                        first += count;
                    }
                } else if !is_states && at == step {
                    let values = numbers::<UInt16Type>(&chunk, HASHES, row).unwrap_or_default();
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

    /// Describes the first difference: the vertices that differ at the step, with its checksums in the golden recording
    /// and now.
    fn first_difference(&self, schema: &Schema, frame: &Frame, [golden, found]: [u64; 2]) -> First {
        let differing = |(index, now): (usize, &BodyFrame)| {
            let all = 0..schema.bodies[index].vertex_count();
            let vertices: Vec<usize> = match (self.hashes.get(&index), is_kept(schema, frame, index)) {
                (None, false) => Vec::new(),
                (Some(then), true) => {
                    let now = vertex_hashes(&schema.bodies[index], now);
                    all.filter(|&vertex| then.get(vertex) != now.get(vertex)).collect()
                }
                _ => all.collect(),
            };
            (index, vertices)
        };
        let bodies = frame.bodies.iter().enumerate().map(differing).filter(|(_, vertices)| !vertices.is_empty());
        let bodies: Vec<(usize, Vec<usize>)> = bodies.collect();
        let first = bodies.first().and_then(|(index, vertices)| Some((*index, *vertices.first()?)));
        First {
            step: frame.at.step,
            time: frame.at.time,
            golden,
            found,
            displacement: first.map_or(DVec3::ZERO, |(index, vertex)| frame.bodies[index].displacement(vertex)),
            bodies: bodies.into_iter().map(|(index, vertices)| (schema.bodies[index].name.clone(), vertices)).collect(),
        }
    }
}
