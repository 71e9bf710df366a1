//! Several models of one scene as one simulation: side by side in space, aligned in time, so that one recording shows
//! and measures them all.

use std::{
    collections::HashSet,
    sync::{Arc, Mutex, atomic::AtomicBool},
    time::Instant as Clock,
};

use glam::{DQuat, DVec3};

use super::SceneRun;
use crate::{
    analysis::{surface::Merger, touch::Touches},
    colors,
    geometry::bounds,
    hash, lock,
    observe::{
        BodyEvent, BodyFrame, Experiment, Frame, Instant, NearPair, PairEvent, PairFrame, Refusal, Schema, Simulation,
        StepFailure, StepSummary, SurfaceEvent, Want,
        schema::{
            BodySchema, OwnLevels, OwnSurfaces, PointSchema, ScalarOf, ScalarSchema, SphereAt, TermSchema,
            VariantSchema,
        },
        surface::{Finding, Group, Surfaced, Surfaces},
    },
    scene::{Model, Scene},
    sim::Options,
};

/// Distance between neighbours [extents of the scene].
const SPACING: f64 = 1.1;
/// Height of the name of a model above its middle [half extents of the scene].
const ABOVE: f64 = 1.15;
/// How much of its depth a scene seems higher, seen slightly from above.
const DEPTH_SEEN: f64 = 0.4;

/// Several models of a scene. The scene's own model is included only if it is listed.
#[derive(Clone, Debug)]
pub struct SideBySide {
    /// The scene.
    pub scene: Scene,
    /// Options of each model's step.
    pub options: Options,
    /// The models, in their order in space; at least one.
    pub models: Vec<Model>,
}

impl SideBySide {
    /// All models that can run a scene.
    pub fn all(scene: &Scene, options: Options) -> SideBySide {
        let run = |model: &Model| SceneRun { scene: Scene { model: *model, ..scene.clone() }, options };
        let models = Model::ALL.into_iter().filter(|model| run(model).start().is_ok()).collect();
        SideBySide { scene: Scene { model: Model::Oscillators, ..scene.clone() }, options, models }
    }

    fn runs(&self) -> impl Iterator<Item = SceneRun> + '_ {
        let run = |model: &Model| Scene { model: *model, ..self.scene.clone() };
        self.models.iter().map(move |model| SceneRun { scene: run(model), options: self.options })
    }

    /// Positions of the models, given the spheres that a camera should see of one model.
    fn places(&self, spheres: &[(DVec3, f64)]) -> Vec<Place> {
        let schemas: Vec<Schema> = self.runs().map(|run| run.schema()).collect();
        let upright = schemas.first().map_or(DQuat::IDENTITY, Schema::upright);
        let [low, high] = bounds(spheres.iter().map(|&(centre, radius)| (upright * centre, radius)));
        let (low, high) = if low.is_finite() && high.is_finite() { (low, high) } else { Default::default() };
        let extent = SPACING * (high - low);
        // two per row, rows from top to bottom as the camera sees them: from high above, if the scene is deeper than high, or
        // else from the front. All stand on the same planes.
        let is_flat = extent.z < extent.y;
        let (columns, down) = match (is_flat, self.scene.planes.is_empty()) {
            (true, _) => (2, -ABOVE * extent.y * DVec3::Y),
            (false, true) => (2, -(extent.z + DEPTH_SEEN * extent.y) * DVec3::Z),
            (false, false) => (self.models.len().max(1), DVec3::ZERO),
        };
        let top = if is_flat { extent.y * DVec3::Y } else { extent.z * DVec3::Z };
        let top = 0.5 * (low + high) + 0.5 * ABOVE * top;
        let bodies = self.scene.bodies.len();
        let place = |(k, schema)| {
            let offset = (k % columns) as f64 * extent.x * DVec3::X + (k / columns) as f64 * down;
            let back = upright.conjugate();
            Place { schema, first: k * bodies, offset: back * offset, heading: back * (top + offset) }
        };
        schemas.into_iter().enumerate().map(place).collect()
    }

    fn spheres(&self) -> Vec<(DVec3, f64)> {
        self.runs().next().and_then(|run| run.start().ok()).map(|run| run.framing(true)).unwrap_or_default()
    }

    fn combined(&self, places: &[Place]) -> Schema {
        let Some(first) = places.first().map(|place| &place.schema) else { return Schema::default() };
        let bodies = places.iter().flat_map(|place| {
            let named = |body: &BodySchema| BodySchema {
                name: format!("{}-{}", place.schema.model, body.name),
                ..body.clone()
            };
            place.schema.bodies.iter().map(named)
        });
        // arrows on all vertices of all models would hide the bodies
        let net = TermSchema { is_shown: false, is_sum: true, ..TermSchema::new("net", "Net", colors::MAGENTA) };
        let mut warnings: Vec<String> = places.iter().flat_map(|place| place.schema.warnings.clone()).collect();
        let mut seen = HashSet::new();
        warnings.retain(|warning| seen.insert(warning.clone()));
        let names: Vec<String> = self.models.iter().map(|model| format!("\"{model}\"")).collect();
        let own_levels = {
            let places = places.to_vec();
            OwnLevels::changing(move |threshold, [a, b], time| {
                let place = places.iter().find(|place| place.has(a))?;
                place.schema.level(threshold, [a - place.first, b.checked_sub(place.first)?], time)
            })
        };
        let points = places.iter().flat_map(|place| {
            let moved = |point: &PointSchema| {
                let (sphere, offset) = (point.sphere.clone(), place.offset);
                let sphere = SphereAt::new(move |time| sphere.at(time).map(|(centre, reach)| (centre + offset, reach)));
                PointSchema { sphere, ..point.clone() }
            };
            place.schema.points.iter().map(moved)
        });
        let variants = self.models.iter().zip(places);
        let variants = variants.map(|(model, place)| VariantSchema { name: model.name(), heading: place.heading });
        Schema {
            name: format!("{}-models", self.scene.name.trim_end_matches("-models")),
            run: first.run.clone() + &format!("models = [{}]\n", names.join(", ")),
            model: self.models.iter().map(|model| model.name()).collect::<Vec<_>>().join("+"),
            law: laws(places),
            bodies: bodies.collect(),
            variants: variants.collect(),
            points: points.collect(),
            terms: vec![net],
            labels: vec!["as in its own recording"],
            own_levels: if self.scene.has_one_law() { OwnLevels::default() } else { own_levels },
            surfaces: OwnSurfaces::new(OffsetSurfaces { places: places.to_vec(), mergers: mergers(places) }),
            scalars: self.models.iter().map(|model| displacement(*model)).collect(),
            stages: self.models.iter().map(|model| model.name()).collect(),
            warnings,
            ..first.clone()
        }
    }
}

/// The laws of the models: what they share once.
fn laws(places: &[Place]) -> String {
    let sentences = |place: &Place| -> Vec<String> {
        place.schema.law.split(". ").map(|sentence| sentence.trim().trim_end_matches('.').to_owned()).collect()
    };
    let laws: Vec<Vec<String>> = places.iter().map(sentences).collect();
    let is_shared = |sentence: &&String| laws.iter().all(|law| law.contains(sentence));
    let of = |name: &str, sentences: Vec<&str>| match sentences.is_empty() {
        true => String::new(),
        false => format!("**{name}**: {}.  \n", sentences.join(". ")),
    };
    let own = places.iter().zip(&laws).map(|(place, law)| {
        of(&place.schema.model, law.iter().filter(|sentence| !is_shared(sentence)).map(String::as_str).collect())
    });
    let shared = laws.iter().take(1).flatten().filter(is_shared).map(String::as_str).collect();
    own.collect::<String>() + &of("All", shared)
}

/// The scalar of a model.
fn displacement(model: Model) -> ScalarSchema {
    let (name, label) = match model {
        Model::Oscillators => ("displacement_of_oscillators", "oscillators"),
        Model::Metaballs => ("displacement_of_metaballs", "metaballs"),
        Model::Lattice => ("displacement_of_lattice", "lattice"),
        Model::Fem => ("displacement_of_fem", "fem"),
    };
    ScalarSchema { plot: "Largest displacement [radii]", ..ScalarSchema::new(name, label, ScalarOf::State) }
}

/// The position of a model.
#[derive(Clone, Debug)]
struct Place {
    schema: Schema,
    /// Index of its first body.
    first: usize,
    offset: DVec3,
    /// Where its name stands.
    heading: DVec3,
}

impl Place {
    fn has(&self, body: usize) -> bool {
        (self.first..self.first + self.schema.bodies.len()).contains(&body)
    }

    /// The part of a frame that belongs to this model, as if it were alone.
    fn alone(&self, frame: &Frame) -> Frame {
        let bodies = frame.bodies.iter().skip(self.first).take(self.schema.bodies.len());
        let back = |body: &BodyFrame| BodyFrame { centre: body.centre - self.offset, ..body.clone() };
        let pairs = frame.pairs.iter().filter(|pair| self.has(pair.a) && self.has(pair.b));
        Frame {
            at: frame.at,
            bodies: bodies.map(back).collect(),
            pairs: pairs.map(|pair| PairFrame { a: pair.a - self.first, b: pair.b - self.first, ..*pair }).collect(),
            ..Frame::default()
        }
    }
}

impl Place {
    /// A group of this model, moved to the model's position.
    fn moved(&self, group: &Group) -> Group {
        let mut moved = group.clone();
        moved.bodies.iter_mut().for_each(|body| *body += self.first);
        moved.positions.iter_mut().for_each(|at| *at += self.offset);
        for origin in &mut moved.origins {
            origin.bodies = origin.bodies.map(|body| body + self.first as u32);
        }
        for seam in &mut moved.seams {
            seam.bodies = seam.bodies.map(|body| body + self.first);
            seam.positions.iter_mut().for_each(|at| *at += self.offset);
        }
        moved
    }
}

fn mergers(places: &[Place]) -> Vec<Mutex<Merger>> {
    places.iter().map(|place| Mutex::new(Merger::new(&place.schema, None))).collect()
}

/// The surfaces of the models, each as defined by its own schema.
struct OffsetSurfaces {
    places: Vec<Place>,
    mergers: Vec<Mutex<Merger>>,
}

impl Surfaces for OffsetSurfaces {
    fn merge(&self, _: &Schema, frame: &Frame, pairs: &[[usize; 2]], _: Option<&AtomicBool>) -> Surfaced {
        let mut all = Surfaced { groups: Vec::new(), pairs: vec![None; pairs.len()] };
        for (place, merger) in self.places.iter().zip(&self.mergers) {
            let asked: Vec<usize> =
                (0..pairs.len()).filter(|&k| pairs[k].iter().all(|&body| place.has(body))).collect();
            let own: Vec<[usize; 2]> = asked.iter().map(|&k| pairs[k].map(|body| body - place.first)).collect();
            let mut merger = lock(merger);
            let merged = merger.merge(&place.schema, &place.alone(frame), &own);
            all.groups.extend(merged.groups.iter().map(|group| Some(place.moved(group))));
            all.groups.extend((0..merged.overlapping).map(|_| None));
            asked.iter().zip(&merged.pairs).for_each(|(&k, measures)| all.pairs[k] = *measures);
        }
        all
    }
}

impl Experiment for SideBySide {
    fn schema(&self) -> Schema {
        self.combined(&self.places(&self.spheres()))
    }

    fn start(&self) -> Result<Box<dyn Simulation>, String> {
        let places = self.places(&self.spheres());
        let parts = self.runs().zip(&places).map(|(run, place)| {
            let simulation = run.start()?;
            let touches = simulation.contacts().is_none().then(|| Touches::new(&*simulation));
            Ok(Part { simulation, touches, place: place.clone() })
        });
        let parts = parts.collect::<Result<Vec<_>, String>>()?;
        if parts.is_empty() {
            return Err("there is no model to run".to_owned());
        }
        let (schema, scene) = (self.combined(&places), self.scene.clone());
        Ok(Box::new(SideBySideRun { schema, scene, parts, contacts: Vec::new(), frame: Frame::default() }))
    }

    fn read(&self, name: &str, text: &str, run: &toml::Table) -> Result<Arc<dyn Experiment>, Refusal> {
        super::read(name, text, run)
    }
}

/// Models stepped together.
struct SideBySideRun {
    schema: Schema,
    scene: Scene,
    parts: Vec<Part>,
    /// Touch and part events of the last step.
    contacts: Vec<SurfaceEvent>,
    /// Scratch storage, reused.
    frame: Frame,
}

struct Part {
    simulation: Box<dyn Simulation>,
    /// Finds touch and part events, if the model does not find them itself.
    touches: Option<Touches>,
    place: Place,
}

impl Simulation for SideBySideRun {
    fn schema(&self) -> Schema {
        self.schema.clone()
    }

    fn overrides(&self, steps: Option<u64>) -> Result<String, String> {
        self.scene.overrides(steps)
    }

    fn steps_taken(&self) -> u64 {
        self.parts.first().map_or(0, |part| part.simulation.steps_taken())
    }

    fn time(&self) -> f64 {
        self.parts.first().map_or(0.0, |part| part.simulation.time())
    }

    fn step(&mut self, summary: &mut StepSummary) {
        self.contacts.clear();
        for Part { simulation, touches, place } in &mut self.parts {
            let (start, mut one) = (Clock::now(), StepSummary::default());
            simulation.step(&mut one);
            summary.timings.push(start.elapsed());
            let mut found = Vec::new();
            if let Some(touches) = touches {
                simulation.observe(Want::default(), &mut self.frame);
                touches.step(&**simulation, &self.frame, &[], &mut found);
            }
            let own = simulation.contacts().unwrap_or(&found).iter();
            let own = own.filter(|event| matches!(event.what, Finding::Touch | Finding::Part));
            let shifted =
                |event: &SurfaceEvent| SurfaceEvent { a: event.a + place.first, b: event.b + place.first, ..*event };
            self.contacts.extend(own.map(shifted));
            let shifted = |event: &BodyEvent| BodyEvent {
                body: event.body + place.first,
                place: event.place + place.offset,
                ..*event
            };
            summary.body_events.extend(one.body_events.iter().map(shifted));
            let shifted =
                |event: &PairEvent| PairEvent { a: event.a + place.first, b: event.b + place.first, ..*event };
            summary.events.extend(one.events.iter().map(shifted));
            summary.scalars.push(0.0);
            let named = |why: &String| format!("{}: {why}", place.schema.model);
            let failure = one.failure.take().map(|failure| match &failure {
                StepFailure::Diverged(why) => StepFailure::Diverged(named(why)),
                StepFailure::NotTaken(why) => StepFailure::NotTaken(named(why)),
                StepFailure::Interrupted(why) => StepFailure::Interrupted(named(why)),
            });
            summary.failure = summary.failure.take().or(failure);
        }
        summary.at = Instant { step: self.steps_taken(), time: self.time() };
        summary.events.sort_by(|x, y| x.time.total_cmp(&y.time).then((x.a, x.b).cmp(&(y.a, y.b))));
        summary.body_events.sort_by(|x, y| x.time.total_cmp(&y.time).then(x.body.cmp(&y.body)));
        self.contacts.sort_by(|x, y| x.time.total_cmp(&y.time).then((x.a, x.b).cmp(&(y.a, y.b))));
    }

    fn account(&self) -> Option<String> {
        let of = |part: &Part| Some(format!("{}: {}", part.place.schema.model, part.simulation.account()?));
        let all: Vec<String> = self.parts.iter().filter_map(of).collect();
        (!all.is_empty()).then(|| all.join("\n"))
    }

    fn interrupt(&self) -> Option<&'static AtomicBool> {
        self.parts.first()?.simulation.interrupt()
    }

    fn checksum(&self) -> u64 {
        hash::sequence(self.parts.iter().map(|part| part.simulation.checksum()))
    }

    fn observe(&self, want: Want, frame: &mut Frame) {
        frame.at = Instant { step: self.steps_taken(), time: self.time() };
        frame.bodies.clear();
        frame.pairs.clear();
        frame.scalars.clear();
        for Part { simulation, place, .. } in &self.parts {
            let mut one = Frame::default();
            simulation.observe(Want { forces: want.forces, scalars: false }, &mut one);
            let bodies = one.bodies.iter().zip(&place.schema.bodies);
            let largest = bodies.map(|(now, body)| now.max_displacement / body.radius).fold(0.0, f64::max);
            frame.scalars.extend(want.scalars.then_some(largest));
            for mut now in one.bodies {
                now.centre += place.offset;
                now.terms.drain(..now.terms.len().saturating_sub(1));
                now.labels.clear();
                frame.bodies.push(now);
            }
            let shifted = |pair: &PairFrame| PairFrame { a: pair.a + place.first, b: pair.b + place.first, ..*pair };
            frame.pairs.extend(one.pairs.iter().map(shifted));
        }
    }

    fn within(&self, before: &Frame, time: f64, bodies: &[usize], frame: &mut Frame) {
        for Part { simulation, place, .. } in &self.parts {
            let own: Vec<usize> =
                bodies.iter().filter(|&&body| place.has(body)).map(|body| body - place.first).collect();
            if own.is_empty() {
                continue;
            }
            let mut one = place.alone(frame);
            simulation.within(&place.alone(before), time, &own, &mut one);
            for (index, mut now) in one.bodies.into_iter().enumerate() {
                now.centre += place.offset;
                frame.bodies[place.first + index] = now;
            }
        }
    }

    fn near(&self, pairs: &mut Vec<NearPair>) {
        pairs.clear();
        let mut own = Vec::new();
        for Part { simulation, place, .. } in &self.parts {
            simulation.near(&mut own);
            pairs.extend(own.iter().map(|pair| NearPair { a: pair.a + place.first, b: pair.b + place.first, ..*pair }));
        }
    }

    fn reach(&self, a: usize, b: usize) -> f64 {
        let part = self.parts.iter().find(|part| part.place.has(a));
        part.map_or(f64::INFINITY, |Part { simulation, place, .. }| simulation.reach(a - place.first, b - place.first))
    }

    fn on_path(&self, body: usize, time: f64) -> Option<[DVec3; 2]> {
        let Part { simulation, place, .. } = self.parts.iter().find(|part| part.place.has(body))?;
        let [position, velocity] = simulation.on_path(body - place.first, time)?;
        Some([position + place.offset, velocity])
    }

    fn contacts(&self) -> Option<&[SurfaceEvent]> {
        Some(&self.contacts)
    }

    /// Only what happens: with all of their paths in view, the bodies of several models would be tiny.
    fn framing(&self, _: bool) -> Vec<(DVec3, f64)> {
        let of = |Part { simulation, place, .. }: &Part| {
            let offset = place.offset;
            let spheres = simulation.framing(true).into_iter().map(move |(centre, radius)| (centre + offset, radius));
            spheres.chain([(place.heading, 0.0)])
        };
        self.parts.iter().flat_map(of).collect()
    }
}
