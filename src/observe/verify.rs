//! Checks that a simulation keeps the contract of [`observe`](super): the sentence that an implementer needs, instead of a
//! recording that is wrong somewhere.

use std::collections::HashSet;

use glam::DVec3;

use super::{
    event::{BodyEvent, Instant, PairEvent},
    frame::{BodyFrame, Frame, PairFrame, PointForce, TermFrame, Want},
    schema::{BodySchema, ScalarOf, Schema},
    simulation::{Experiment, Simulation, StepSummary},
};
use crate::geometry::{Vectors, union::Topology};

/// Upper limit on the mistakes that are reported.
const MAX_MISTAKES: usize = 20;

/// Runs an experiment twice for a number of steps, and checks everything it reports: names, lengths, indices, order,
/// finite numbers, closed meshes, that every step can be taken, and that both runs have the same checksums.
///
/// Recordings check the same of the schema and of every step, except for what takes time for each vertex; builds with
/// debug assertions check that too.
///
/// # Errors
/// What is wrong, a sentence each that names the field; the first twenty.
pub fn verify(experiment: &dyn Experiment, steps: u64) -> Result<(), Vec<String>> {
    let mut mistakes = Mistakes::default();
    let start = || experiment.start().map_err(|reason| vec![format!("the experiment does not start: {reason}")]);
    let (mut one, mut other) = (start()?, start()?);
    let (schema, of_experiment) = (one.schema(), experiment.schema());
    mistakes.schema(&schema);
    let named = |schema: &Schema| schema.bodies.iter().map(|body| body.name.clone()).collect::<Vec<_>>();
    if named(&schema) != named(&of_experiment) || schema.dt != of_experiment.dt {
        mistakes.add("the schema of the experiment is not that of its simulation".to_owned());
    }
    if !mistakes.found.is_empty() {
        return Err(mistakes.found); // frames would be compared with what is wrong
    }
    let mut frame = Frame::default();
    let mut summary = StepSummary::default();
    let mut before = Instant { step: one.steps_taken(), time: one.time() };
    one.observe(Want::ALL, &mut frame);
    mistakes.frame(&schema, &frame, Want::ALL, true);
    mistakes.instant(&*one, &frame);
    mistakes.checksums(&*one, &*other);
    while one.steps_taken() < steps && mistakes.found.is_empty() {
        summary.clear();
        one.step(&mut summary);
        other.step(&mut StepSummary::default());
        if let Some(failure) = summary.failure.as_ref().filter(|failure| !failure.is_whole_step()) {
            mistakes.add(format!("the step after {before:?} fails: {failure}"));
            break;
        }
        let now = Instant { step: one.steps_taken(), time: one.time() };
        if now.step != before.step + 1 || now.time.partial_cmp(&before.time) != Some(std::cmp::Ordering::Greater) {
            mistakes.add(format!(
                "a step leads from {before:?} to {now:?}: the step number must increase by one, and the time"
            ));
            break;
        }
        mistakes.summary(&schema, &summary);
        let events = summary.events.iter().map(|event| event.time);
        for time in events.filter(|time| !(before.time..=now.time).contains(time)) {
            mistakes
                .add(format!("summary.events in step {}: an event at t = {time:?} s is outside of the step", now.step));
        }
        one.observe(Want::ALL, &mut frame);
        mistakes.frame(&schema, &frame, Want::ALL, true);
        mistakes.instant(&*one, &frame);
        mistakes.checksums(&*one, &*other);
        before = now;
    }
    if mistakes.found.is_empty() { Ok(()) } else { Err(mistakes.found) }
}

/// Checks a schema, as [`verify`] does. The error is the first mistake.
#[cfg(feature = "viewer")]
pub(crate) fn schema(schema: &Schema) -> Result<(), String> {
    let mut mistakes = Mistakes::default();
    mistakes.schema(schema);
    mistakes.first()
}

/// Checks what a simulation says of its last step, as [`verify`] does. The error is the first mistake.
#[cfg(feature = "viewer")]
pub(crate) fn summary(schema: &Schema, summary: &StepSummary) -> Result<(), String> {
    let mut mistakes = Mistakes::default();
    mistakes.summary(schema, summary);
    mistakes.first()
}

/// Checks a frame, as [`verify`] does, but in a build without debug assertions not every vertex. The error is the first
/// mistake.
#[cfg(feature = "viewer")]
pub(crate) fn frame(schema: &Schema, frame: &Frame, want: Want) -> Result<(), String> {
    let mut mistakes = Mistakes::default();
    mistakes.frame(schema, frame, want, cfg!(debug_assertions));
    mistakes.first()
}

/// Adds a mistake, given like the arguments of `format!`, unless what stands before the arrow is right.
macro_rules! ensure {
    ($mistakes:expr, $is_right:expr => $($mistake:tt)+) => {
        if !$is_right {
            $mistakes.add(format!($($mistake)+));
        }
    };
}

#[derive(Default)]
struct Mistakes {
    found: Vec<String>,
}

impl Mistakes {
    fn add(&mut self, mistake: String) {
        if self.found.len() < MAX_MISTAKES {
            self.found.push(mistake);
        }
    }

    #[cfg(feature = "viewer")]
    fn first(self) -> Result<(), String> {
        self.found.into_iter().next().map_or(Ok(()), Err)
    }

    fn schema(&mut self, schema: &Schema) {
        let Schema { bodies, phases, terms, .. } = schema;
        ensure!(self, schema.dt > 0.0 && schema.dt.is_finite() =>
            "schema.dt is {:?}, expected a time > 0 s", schema.dt);
        ensure!(self, !bodies.is_empty() => "schema.bodies is empty, expected at least one body");
        ensure!(self, bodies.len().is_multiple_of(schema.variants.len().max(1)) =>
            "schema.variants has {} variants, of which not all have as many bodies", schema.variants.len());
        ensure!(self, !phases.is_empty() => "schema.phases is empty, expected at least one phase");
        ensure!(self, schema.labels.len() <= 256 =>
            "schema.labels has {} labels, expected at most 256", schema.labels.len());
        self.names("bodies", bodies.iter().map(|body| body.name.as_str()), true);
        self.names("phases", phases.iter().map(|phase| phase.name), true);
        self.names("terms", terms.iter().map(|term| term.name), true);
        let sums = terms.iter().filter(|term| term.is_sum).count();
        ensure!(self, sums <= 1 => "schema.terms has {sums} terms with is_sum, expected at most one");
        self.names("events", schema.events.iter().map(|event| event.name), false);
        ensure!(self, schema.scheduled.is_sorted_by(|one, other| one.time <= other.time) =>
            "schema.scheduled is not in order of time");
        ensure!(self, schema.up.is_normalized() => "schema.up is {}, expected a vector of length 1", schema.up);
        for (index, change) in schema.changes.iter().enumerate() {
            ensure!(self, change.reaches.len() == bodies.len() =>
                "schema.changes[{index}].reaches has {} values, expected {}", change.reaches.len(), bodies.len());
            ensure!(self, change.planes.len() == schema.planes.len() =>
                "schema.changes[{index}].planes has {} planes, expected {}", change.planes.len(), schema.planes.len());
        }
        self.names("thresholds", schema.thresholds.iter().map(|threshold| threshold.name), true);
        self.names("scalars", schema.scalars.iter().map(|scalar| scalar.name), true);
        for (list, scalars) in [("body_scalars", &schema.body_scalars), ("pair_scalars", &schema.pair_scalars)] {
            self.names(list, scalars.iter().map(|scalar| scalar.name), true);
            let other = scalars.iter().position(|scalar| scalar.of != ScalarOf::State);
            ensure!(self, other.is_none() =>
                "schema.{list}[{}].of: expected ScalarOf::State", other.unwrap_or_default());
        }
        self.names("stages", schema.stages.iter().copied(), true);
        let mut closed = HashSet::new();
        for (index, body) in bodies.iter().enumerate() {
            self.body_schema(index, body);
            let mesh = &body.mesh;
            if closed.insert(std::sync::Arc::as_ptr(mesh)) && !body.can_tear {
                let topology = Topology::new(mesh.vertex_count(), mesh.triangles());
                let _ = topology.map_err(|error| self.add(format!("schema.bodies[{index}].mesh: {error}")));
            }
        }
    }

    fn body_schema(&mut self, index: usize, body: &BodySchema) {
        let positive = |x: f64| x > 0.0 && x.is_finite();
        ensure!(self, positive(body.radius) =>
            "schema.bodies[{index}].radius is {:?}, expected a length > 0", body.radius);
        ensure!(self, positive(body.mass) => "schema.bodies[{index}].mass is {:?}, expected a mass > 0", body.mass);
        let reach = body.reach;
        ensure!(self, reach >= 0.0 && reach.is_finite() =>
            "schema.bodies[{index}].reach is {reach:?}, expected a length");
        ensure!(self, is_plain(&body.shape) => "schema.bodies[{index}].shape is {:?}, expected {PLAIN}", body.shape);
        ensure!(self, !body.can_tear || body.mesh.facets().is_none() =>
            "schema.bodies[{index}].can_tear is set, but its mesh is faceted, which bodies that tear cannot be");
        ensure!(self, !body.mesh.triangles().is_empty() => "schema.bodies[{index}].mesh has no triangles");
    }

    fn names<'n>(&mut self, list: &str, names: impl Iterator<Item = &'n str>, must_be_plain: bool) {
        let mut seen = HashSet::new();
        for (index, name) in names.enumerate() {
            ensure!(self, !must_be_plain || is_plain(name) =>
                "schema.{list}[{index}].name is {name:?}, expected {PLAIN}");
            ensure!(self, !name.trim().is_empty() => "schema.{list}[{index}].name is empty");
            ensure!(self, seen.insert(name) => "schema.{list}[{index}].name is {name:?}, as that of an earlier one");
        }
    }

    fn instant(&mut self, simulation: &dyn Simulation, frame: &Frame) {
        let now = Instant { step: simulation.steps_taken(), time: simulation.time() };
        ensure!(self, frame.at == now => "frame.at is {:?}, but the simulation is at {now:?}", frame.at);
    }

    fn checksums(&mut self, one: &dyn Simulation, other: &dyn Simulation) {
        let same = one.checksum() == other.checksum();
        ensure!(self, same =>
            "two runs have different checksums after step {}: something in them is random", one.steps_taken());
    }

    fn summary(&mut self, schema: &Schema, summary: &StepSummary) {
        let StepSummary { at, events, body_events, timings, scalars, shortfall, .. } = summary;
        let (count, step) = (schema.bodies.len(), at.step);
        for (index, event) in events.iter().enumerate() {
            let field = |part: &str| format!("summary.events[{index}].{part} in step {step}");
            self.pair_event(schema, event, field);
        }
        let is_ordered = events.is_sorted_by(|a, b| a.time <= b.time);
        ensure!(self, is_ordered => "summary.events in step {step} are not in order of time");
        for (index, BodyEvent { body, time, place, name, .. }) in body_events.iter().enumerate() {
            let field = |part: &str| format!("summary.body_events[{index}].{part} in step {step}");
            ensure!(self, *body < count => "{} is {body}, but there are {count} bodies", field("body"));
            ensure!(self, time.is_finite() && place.is_finite() => "{} is not finite", field("time or place"));
            ensure!(self, !name.trim().is_empty() => "{} is empty", field("name"));
        }
        let stages = schema.stages.len();
        ensure!(self, timings.len() == stages =>
            "summary.timings in step {step} has {} entries, expected {stages}, one per stage", timings.len());
        let numbers = schema.scalars.len();
        ensure!(self, scalars.len() == numbers =>
            "summary.scalars in step {step} has {} entries, expected {numbers}", scalars.len());
        if let Some(shortfall) = shortfall {
            ensure!(self, shortfall.body < count =>
                "summary.shortfall.body in step {step} is {}, but there are {count} bodies", shortfall.body);
        }
    }

    fn pair_event(&mut self, schema: &Schema, event: &PairEvent, field: impl Fn(&str) -> String) {
        let PairEvent { name, time, a, b, q, from, to, .. } = *event;
        let (count, phases) = (schema.bodies.len(), schema.phases.len());
        ensure!(self, a < b && b < count => "{}: the pair is ({a}, {b}), expected a < b < {count}", field("a, b"));
        ensure!(self, from < phases && to < phases =>
            "{}: the phases are {from} and {to}, but there are {phases}", field("from, to"));
        ensure!(self, time.is_finite() && q.is_finite() => "{} is not finite", field("time or q"));
        let is_known = schema.events.iter().any(|kind| kind.name == name);
        ensure!(self, is_known => "{} is {name:?}, which is none of schema.events", field("name"));
    }

    /// Checks a frame; every vertex of it if `deeply` is set.
    fn frame(&mut self, schema: &Schema, frame: &Frame, want: Want, deeply: bool) {
        let (count, step) = (schema.bodies.len(), frame.at.step);
        ensure!(self, frame.bodies.len() == count =>
            "frame.bodies in step {step} has {} entries, expected {count}", frame.bodies.len());
        for (index, (body, now)) in schema.bodies.iter().zip(&frame.bodies).enumerate() {
            let field = |part: &str| format!("frame.bodies[{index}].{part} in step {step}");
            self.body(schema, body, now, want, deeply, field);
        }
        let is_ascending = frame.pairs.is_sorted_by(|x, y| (x.a, x.b) < (y.a, y.b));
        ensure!(self, is_ascending =>
            "frame.pairs in step {step} are not in ascending order of their bodies, or one is there twice");
        for (index, &PairFrame { a, b, q, phase, .. }) in frame.pairs.iter().enumerate() {
            let (field, phases) =
                (|part: &str| format!("frame.pairs[{index}].{part} in step {step}"), schema.phases.len());
            ensure!(self, a < b && b < count => "{}: the pair is ({a}, {b}), expected a < b < {count}", field("a, b"));
            let absent = [a, b].into_iter().find(|&body| frame.bodies.get(body).is_some_and(|now| now.is_absent));
            ensure!(self, absent.is_none() => "{}: body {absent:?} is absent", field("a, b"));
            ensure!(self, phase < phases => "{} is {phase}, but there are {phases} phases", field("phase"));
            ensure!(self, q.is_finite() => "{} is {q:?}, expected a finite number", field("q"));
        }
        let scalars = if want.scalars { schema.scalars.len() } else { frame.scalars.len() };
        ensure!(self, frame.scalars.len() == scalars =>
            "frame.scalars in step {step} has {} entries, expected {scalars}", frame.scalars.len());
        if want.scalars {
            let [of_bodies, of_pairs] = [schema.body_scalars.len(), schema.pair_scalars.len()];
            for (list, values, expected) in [
                ("body_scalars", &frame.body_scalars, count * of_bodies),
                ("pair_scalars", &frame.pair_scalars, frame.pairs.len() * of_pairs),
            ] {
                ensure!(self, values.len() == expected =>
                    "frame.{list} in step {step} has {} entries, expected {expected}", values.len());
            }
        }
    }

    fn body(
        &mut self,
        schema: &Schema,
        body: &BodySchema,
        now: &BodyFrame,
        want: Want,
        deeply: bool,
        field: impl Fn(&str) -> String,
    ) {
        ensure!(self, !now.is_absent || body.can_be_absent =>
            "{} is set, but not `can_be_absent` of the body in the schema", field("is_absent"));
        ensure!(self, !now.is_absent || now.is_at_rest && !now.has_forces =>
            "{} is set for a body that is not at rest or has forces", field("is_absent"));
        let vertices = now.mesh_of(body).vertex_count();
        let expected = if now.is_at_rest { 0 } else { vertices };
        ensure!(self, now.centre.is_finite() => "{} is {:?}, expected finite numbers", field("centre"), now.centre);
        let turn = now.rotation;
        ensure!(self, turn.is_normalized() => "{} is {turn:?}, expected a unit quaternion", field("rotation"));
        let form = if now.is_at_rest { "none for a body at rest: call `rest()`" } else { "one per vertex" };
        for (name, vectors) in
            [("displacements", &now.displacements), ("velocities", &now.velocities), ("positions", &now.positions)]
        {
            let length = vectors.len();
            ensure!(self, length == expected => "{} has {length} vectors, expected {expected}, {form}", field(name));
            if deeply {
                ensure!(self, is_finite(vectors) => "{} has a number that is not finite", field(name));
            }
        }
        ensure!(self, now.lengths.len() == expected =>
            "{} has {} entries, expected {expected}, {form}", field("lengths"), now.lengths.len());
        if deeply {
            let is_number = now
                .springs
                .iter()
                .all(|spring| spring.strain.is_finite() && spring.ends.iter().all(|end| end.is_finite()));
            ensure!(self, is_number => "{} has a number that is not finite", field("springs"));
        }
        ensure!(self, now.has_forces || now.point_forces.is_empty() =>
            "{} has forces, but has_forces is not set", field("point_forces"));
        if !want.forces || !now.has_forces {
            return;
        }
        let terms = schema.terms.len();
        ensure!(self, now.terms.len() == terms =>
            "{} has {} entries, expected {terms}, one per term of the schema", field("terms"), now.terms.len());
        for (index, TermFrame { accelerations, source, mean }) in now.terms.iter().enumerate() {
            let length = accelerations.len();
            let fits = length == 0 || length == vertices;
            ensure!(self, fits =>
                "{} has {length} vectors, expected 0 or {vertices}, one per vertex",
                field(&format!("terms[{index}].accelerations")));
            self.source(schema, *source, || field(&format!("terms[{index}].source")));
            if deeply {
                ensure!(self, mean.is_none_or(DVec3::is_finite) =>
                    "{} is not finite", field(&format!("terms[{index}].mean")));
                ensure!(self, is_finite(accelerations) =>
                    "{} has a number that is not finite", field(&format!("terms[{index}].accelerations")));
            }
        }
        for (index, force) in now.point_forces.iter().enumerate() {
            let field = |part: &str| field(&format!("point_forces[{index}].{part}"));
            let &PointForce { term, place, acceleration, source } = force;
            ensure!(self, term < terms => "{} is {term}, but there are {terms} terms", field("term"));
            ensure!(self, place.is_finite() && acceleration.is_finite() =>
                "{} is not finite", field("place or acceleration"));
            self.source(schema, source, || field("source"));
        }
        let labels = now.labels.len();
        ensure!(self, labels == 0 || labels == vertices =>
            "{} has {labels} entries, expected 0 or {vertices}, one per vertex", field("labels"));
        let wrong = now.labels.iter().find(|&&label| usize::from(label) >= schema.labels.len());
        ensure!(self, wrong.is_none() =>
            "{} has the label {wrong:?}, but schema.labels has {}", field("labels"), schema.labels.len());
    }
}

impl Mistakes {
    fn source(&mut self, schema: &Schema, source: Option<u32>, field: impl Fn() -> String) {
        let count = schema.bodies.len();
        ensure!(self, source.is_none_or(|source| (source as usize) < count) =>
            "{} is {source:?}, but there are {count} bodies", field());
    }
}

const PLAIN: &str = "letters, digits, - and _";

/// Whether a name can be part of the path of an entity and of `A~B`.
fn is_plain(name: &str) -> bool {
    !name.is_empty() && name.chars().all(|c| c.is_alphanumeric() || matches!(c, '-' | '_'))
}

fn is_finite(vectors: &Vectors) -> bool {
    (0..vectors.len()).all(|i| DVec3::is_finite(vectors.get(i)))
}
