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
const MOST: usize = 20;

/// Runs an experiment twice for a number of steps, and checks all that it says of itself: names, lengths, indices, order,
/// finite numbers, closed meshes, and that both runs have the same checksums.
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
        mistakes.add(|| "the schema of the experiment is not that of its simulation".to_owned());
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
        if summary.failure.as_ref().is_some_and(|failure| !failure.is_whole_step()) {
            break;
        }
        let now = Instant { step: one.steps_taken(), time: one.time() };
        if now.step != before.step + 1 || now.time.partial_cmp(&before.time) != Some(std::cmp::Ordering::Greater) {
            mistakes.add(|| {
                format!("a step leads from {before:?} to {now:?}: the step number must increase by one, and the time")
            });
            break;
        }
        mistakes.summary(&schema, &summary);
        let events = summary.events.iter().map(|event| event.time);
        for time in events.filter(|time| !(before.time..=now.time).contains(time)) {
            mistakes.add(|| {
                format!("summary.events in step {}: an event at t = {time:?} s is outside of the step", now.step)
            });
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

#[derive(Default)]
struct Mistakes {
    found: Vec<String>,
}

impl Mistakes {
    fn add(&mut self, mistake: impl FnOnce() -> String) {
        if self.found.len() < MOST {
            self.found.push(mistake());
        }
    }

    fn ensure(&mut self, is_right: bool, mistake: impl FnOnce() -> String) {
        if !is_right {
            self.add(mistake);
        }
    }

    #[cfg(feature = "viewer")]
    fn first(self) -> Result<(), String> {
        self.found.into_iter().next().map_or(Ok(()), Err)
    }

    fn schema(&mut self, schema: &Schema) {
        let Schema { bodies, phases, terms, .. } = schema;
        self.ensure(schema.dt > 0.0 && schema.dt.is_finite(), || {
            format!("schema.dt is {:?}, expected a time > 0 s", schema.dt)
        });
        self.ensure(!bodies.is_empty(), || "schema.bodies is empty, expected at least one body".to_owned());
        self.ensure(bodies.len().is_multiple_of(schema.variants.len().max(1)), || {
            format!("schema.variants has {} variants, of which not all have as many bodies", schema.variants.len())
        });
        self.ensure(!phases.is_empty(), || "schema.phases is empty, expected at least one phase".to_owned());
        self.ensure(schema.labels.len() <= 256, || {
            format!("schema.labels has {} labels, expected at most 256", schema.labels.len())
        });
        self.names("bodies", bodies.iter().map(|body| body.name.as_str()), true);
        self.names("phases", phases.iter().map(|phase| phase.name), true);
        self.names("terms", terms.iter().map(|term| term.name), true);
        let sums = terms.iter().filter(|term| term.is_sum).count();
        self.ensure(sums <= 1, || format!("schema.terms has {sums} terms with is_sum, expected at most one"));
        self.names("events", schema.events.iter().map(|event| event.name), false);
        self.names("thresholds", schema.thresholds.iter().map(|threshold| threshold.name), true);
        self.names("scalars", schema.scalars.iter().map(|scalar| scalar.name), true);
        for (list, scalars) in [("body_scalars", &schema.body_scalars), ("pair_scalars", &schema.pair_scalars)] {
            self.names(list, scalars.iter().map(|scalar| scalar.name), true);
            let other = scalars.iter().position(|scalar| scalar.of != ScalarOf::State);
            self.ensure(other.is_none(), || {
                format!("schema.{list}[{}].of: expected ScalarOf::State", other.unwrap_or_default())
            });
        }
        self.names("stages", schema.stages.iter().copied(), true);
        let mut closed = HashSet::new();
        for (index, body) in bodies.iter().enumerate() {
            self.body_schema(index, body);
            let mesh = &body.mesh;
            if closed.insert(std::sync::Arc::as_ptr(mesh)) && !body.can_tear {
                let topology = Topology::new(mesh.vertex_count(), mesh.triangles());
                let _ = topology.map_err(|error| self.add(|| format!("schema.bodies[{index}].mesh: {error}")));
            }
        }
    }

    fn body_schema(&mut self, index: usize, body: &BodySchema) {
        let positive = |x: f64| x > 0.0 && x.is_finite();
        self.ensure(positive(body.radius), || {
            format!("schema.bodies[{index}].radius is {:?}, expected a length > 0", body.radius)
        });
        self.ensure(positive(body.mass), || {
            format!("schema.bodies[{index}].mass is {:?}, expected a mass > 0", body.mass)
        });
        let reach = body.reach;
        self.ensure(reach >= 0.0 && reach.is_finite(), || {
            format!("schema.bodies[{index}].reach is {reach:?}, expected a length")
        });
        self.ensure(is_plain(&body.shape), || {
            format!("schema.bodies[{index}].shape is {:?}, expected {PLAIN}", body.shape)
        });
        self.ensure(!body.can_tear || body.mesh.facets().is_none(), || {
            format!("schema.bodies[{index}].can_tear is set, but its mesh is faceted, which bodies that tear cannot be")
        });
        self.ensure(!body.mesh.triangles().is_empty(), || format!("schema.bodies[{index}].mesh has no triangles"));
    }

    fn names<'n>(&mut self, list: &str, names: impl Iterator<Item = &'n str>, must_be_plain: bool) {
        let mut seen = HashSet::new();
        for (index, name) in names.enumerate() {
            self.ensure(!must_be_plain || is_plain(name), || {
                format!("schema.{list}[{index}].name is {name:?}, expected {PLAIN}")
            });
            self.ensure(!name.trim().is_empty(), || format!("schema.{list}[{index}].name is empty"));
            self.ensure(seen.insert(name), || {
                format!("schema.{list}[{index}].name is {name:?}, as that of an earlier one")
            });
        }
    }

    fn instant(&mut self, simulation: &dyn Simulation, frame: &Frame) {
        let now = Instant { step: simulation.steps_taken(), time: simulation.time() };
        self.ensure(frame.at == now, || format!("frame.at is {:?}, but the simulation is at {now:?}", frame.at));
    }

    fn checksums(&mut self, one: &dyn Simulation, other: &dyn Simulation) {
        let same = one.checksum() == other.checksum();
        self.ensure(same, || {
            format!("two runs have different checksums after step {}: something in them is random", one.steps_taken())
        });
    }

    fn summary(&mut self, schema: &Schema, summary: &StepSummary) {
        let StepSummary { at, events, body_events, timings, scalars, shortfall, .. } = summary;
        let (count, step) = (schema.bodies.len(), at.step);
        for (index, event) in events.iter().enumerate() {
            let field = |part: &str| format!("summary.events[{index}].{part} in step {step}");
            self.pair_event(schema, event, field);
        }
        let is_ordered = events.is_sorted_by(|a, b| a.time <= b.time);
        self.ensure(is_ordered, || format!("summary.events in step {step} are not in order of time"));
        for (index, BodyEvent { body, time, place, name, .. }) in body_events.iter().enumerate() {
            let field = |part: &str| format!("summary.body_events[{index}].{part} in step {step}");
            self.ensure(*body < count, || format!("{} is {body}, but there are {count} bodies", field("body")));
            self.ensure(time.is_finite() && place.is_finite(), || format!("{} is not finite", field("time or place")));
            self.ensure(!name.trim().is_empty(), || format!("{} is empty", field("name")));
        }
        let stages = schema.stages.len();
        self.ensure(timings.len() == stages, || {
            format!("summary.timings in step {step} has {} entries, expected {stages}, one per stage", timings.len())
        });
        let numbers = schema.scalars.len();
        self.ensure(scalars.len() == numbers, || {
            format!("summary.scalars in step {step} has {} entries, expected {numbers}", scalars.len())
        });
        if let Some(shortfall) = shortfall {
            self.ensure(shortfall.body < count, || {
                format!("summary.shortfall.body in step {step} is {}, but there are {count} bodies", shortfall.body)
            });
        }
    }

    fn pair_event(&mut self, schema: &Schema, event: &PairEvent, field: impl Fn(&str) -> String) {
        let PairEvent { name, time, a, b, q, from, to, .. } = *event;
        let (count, phases) = (schema.bodies.len(), schema.phases.len());
        self.ensure(a < b && b < count, || {
            format!("{}: the pair is ({a}, {b}), expected a < b < {count}", field("a, b"))
        });
        self.ensure(from < phases && to < phases, || {
            format!("{}: the phases are {from} and {to}, but there are {phases}", field("from, to"))
        });
        self.ensure(time.is_finite() && q.is_finite(), || format!("{} is not finite", field("time or q")));
        let is_known = schema.events.iter().any(|kind| kind.name == name);
        self.ensure(is_known, || format!("{} is {name:?}, which is none of schema.events", field("name")));
    }

    /// Checks a frame; every vertex of it if `deeply` is set.
    fn frame(&mut self, schema: &Schema, frame: &Frame, want: Want, deeply: bool) {
        let (count, step) = (schema.bodies.len(), frame.at.step);
        self.ensure(frame.bodies.len() == count, || {
            format!("frame.bodies in step {step} has {} entries, expected {count}", frame.bodies.len())
        });
        for (index, (body, now)) in schema.bodies.iter().zip(&frame.bodies).enumerate() {
            let field = |part: &str| format!("frame.bodies[{index}].{part} in step {step}");
            self.body(schema, body, now, want, deeply, field);
        }
        let is_ascending = frame.pairs.is_sorted_by(|x, y| (x.a, x.b) < (y.a, y.b));
        self.ensure(is_ascending, || {
            format!("frame.pairs in step {step} are not in ascending order of their bodies, or one is there twice")
        });
        for (index, &PairFrame { a, b, q, phase }) in frame.pairs.iter().enumerate() {
            let (field, phases) =
                (|part: &str| format!("frame.pairs[{index}].{part} in step {step}"), schema.phases.len());
            self.ensure(a < b && b < count, || {
                format!("{}: the pair is ({a}, {b}), expected a < b < {count}", field("a, b"))
            });
            let absent = [a, b].into_iter().find(|&body| frame.bodies.get(body).is_some_and(|now| now.is_absent));
            self.ensure(absent.is_none(), || format!("{}: body {absent:?} is absent", field("a, b")));
            self.ensure(phase < phases, || format!("{} is {phase}, but there are {phases} phases", field("phase")));
            self.ensure(q.is_finite(), || format!("{} is {q:?}, expected a finite number", field("q")));
        }
        let scalars = if want.scalars { schema.scalars.len() } else { frame.scalars.len() };
        self.ensure(frame.scalars.len() == scalars, || {
            format!("frame.scalars in step {step} has {} entries, expected {scalars}", frame.scalars.len())
        });
        if want.scalars {
            let [of_bodies, of_pairs] = [schema.body_scalars.len(), schema.pair_scalars.len()];
            for (list, values, expected) in [
                ("body_scalars", &frame.body_scalars, count * of_bodies),
                ("pair_scalars", &frame.pair_scalars, frame.pairs.len() * of_pairs),
            ] {
                self.ensure(values.len() == expected, || {
                    format!("frame.{list} in step {step} has {} entries, expected {expected}", values.len())
                });
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
        self.ensure(!now.is_absent || body.can_be_absent, || {
            format!("{} is set, but not `can_be_absent` of the body in the schema", field("is_absent"))
        });
        self.ensure(!now.is_absent || now.is_at_rest && !now.has_forces, || {
            format!("{} is set for a body that is not at rest or has forces", field("is_absent"))
        });
        let vertices = now.mesh_of(body).vertex_count();
        let expected = if now.is_at_rest { 0 } else { vertices };
        self.ensure(now.centre.is_finite(), || {
            format!("{} is {:?}, expected finite numbers", field("centre"), now.centre)
        });
        let turn = now.rotation;
        self.ensure(turn.is_normalized(), || format!("{} is {turn:?}, expected a unit quaternion", field("rotation")));
        let form = if now.is_at_rest { "none for a body at rest: call `rest()`" } else { "one per vertex" };
        for (name, vectors) in
            [("displacements", &now.displacements), ("velocities", &now.velocities), ("positions", &now.positions)]
        {
            let length = vectors.len();
            self.ensure(length == expected, || {
                format!("{} has {length} vectors, expected {expected}, {form}", field(name))
            });
            if deeply {
                self.ensure(is_finite(vectors), || format!("{} has a number that is not finite", field(name)));
            }
        }
        self.ensure(now.lengths.len() == expected, || {
            format!("{} has {} entries, expected {expected}, {form}", field("lengths"), now.lengths.len())
        });
        if deeply {
            let is_number = now
                .springs
                .iter()
                .all(|spring| spring.strain.is_finite() && spring.ends.iter().all(|end| end.is_finite()));
            self.ensure(is_number, || format!("{} has a number that is not finite", field("springs")));
        }
        self.ensure(now.has_forces || now.point_forces.is_empty(), || {
            format!("{} has forces, but has_forces is not set", field("point_forces"))
        });
        if !want.forces || !now.has_forces {
            return;
        }
        let terms = schema.terms.len();
        self.ensure(now.terms.len() == terms, || {
            format!("{} has {} entries, expected {terms}, one per term of the schema", field("terms"), now.terms.len())
        });
        for (index, TermFrame { accelerations, source }) in now.terms.iter().enumerate() {
            let length = accelerations.len();
            let fits = length == 0 || length == vertices;
            self.ensure(fits, || {
                format!(
                    "{} has {length} vectors, expected 0 or {vertices}, one per vertex",
                    field(&format!("terms[{index}].accelerations"))
                )
            });
            self.source(schema, *source, || field(&format!("terms[{index}].source")));
            if deeply {
                self.ensure(is_finite(accelerations), || {
                    format!("{} has a number that is not finite", field(&format!("terms[{index}].accelerations")))
                });
            }
        }
        for (index, force) in now.point_forces.iter().enumerate() {
            let field = |part: &str| field(&format!("point_forces[{index}].{part}"));
            let &PointForce { term, place, acceleration, source } = force;
            self.ensure(term < terms, || format!("{} is {term}, but there are {terms} terms", field("term")));
            self.ensure(place.is_finite() && acceleration.is_finite(), || {
                format!("{} is not finite", field("place or acceleration"))
            });
            self.source(schema, source, || field("source"));
        }
        let labels = now.labels.len();
        self.ensure(labels == 0 || labels == vertices, || {
            format!("{} has {labels} entries, expected 0 or {vertices}, one per vertex", field("labels"))
        });
        let wrong = now.labels.iter().find(|&&label| usize::from(label) >= schema.labels.len());
        self.ensure(wrong.is_none(), || {
            format!("{} has the label {wrong:?}, but schema.labels has {}", field("labels"), schema.labels.len())
        });
    }
}

impl Mistakes {
    fn source(&mut self, schema: &Schema, source: Option<u32>, field: impl Fn() -> String) {
        let count = schema.bodies.len();
        self.ensure(source.is_none_or(|source| (source as usize) < count), || {
            format!("{} is {source:?}, but there are {count} bodies", field())
        });
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
