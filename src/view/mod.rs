//! How this crate's own simulations present themselves: titles, colours, plots, arrow scales, cameras. [`World`] as a
//! [`Simulation`], the only interface that recorder, replay, check and diff use.
//!
//! | contents | module |
//! | --- | --- |
//! | scalars over time | [`scalars`] |
//! | names and colours of force terms and phases | [`terms`] |
//! | lengths of arrows | [`scales`] |
//! | what a camera should have in view | [`camera`] |
//! | the stages inside a step, on request | [`stages`] |
//! | parts of the world as frames | `frames` |

pub mod camera;
mod frames;
pub mod scalars;
pub mod scales;
pub mod stages;
pub mod terms;

use std::{mem::take, sync::atomic::AtomicBool};

use glam::DVec3;

use crate::{
    colors,
    model::{PairLaw, THESIS_IN_ENGLISH, influence::Influence, phase::Phase},
    observe::{
        BodyFrame, Frame, Instant, MotionFrame, NearPair, PairEvent, Schema, Shortfall, Simulation, StageFrame,
        StepFailure, StepSummary, Want,
        schema::{
            BodySchema, OwnLevels, OwnSurfaces, PhaseSchema, PlaneSchema, PointSchema, Scheduled, SchemaChange,
            SphereAt, Threshold,
        },
    },
    parallel,
    scene::{Body, Edit, Integrator, Model, Numbers, PairLaws, Plane, Point, ROUNDING, Scene},
    sim::{
        self, BodyView, Cause, Energy, Event, Failure, Stage, States, World,
        free::{Forces, Snapshot},
        terms::{Surroundings, oscillator},
    },
    text::{change, short},
};
use camera::{framing, up};
pub(crate) use frames::pair_frame;
use frames::{add_coupled_forces, add_forces};
use scalars::{ScalarValue, StateNumbers, scalars};
use scales::{arrow_scale, net_force_scale};
use terms::{LABELS, label, law, level, phase_color, term};

/// With fewer vertices than this to observe, a second thread does not pay off.
const PARALLEL_VERTICES: usize = 8192;

/// Writes the report of a world's last step to an empty summary.
pub(crate) fn summarise(world: &World, summary: &mut StepSummary) {
    let (report, is_coupled) = (world.report(), world.scene().is_coupled());
    summary.at = Instant { step: report.step, time: report.time };
    summary.events.extend(
        report
            .events
            .iter()
            .map(|event| PairEvent { energy: is_coupled.then_some(event.energy), ..PairEvent::from(event) }),
    );
    summary.timings.extend(report.timings);
    summary.scalars.extend(scalars(world.scene()).map(|scalar| match scalar.value {
        ScalarValue::State(_) => 0.0,
        ScalarValue::SumOfSteps(value) | ScalarValue::MaxOfSteps(value) => value(report),
    }));
    let shortfall = |found: sim::Shortfall| Shortfall { body: found.body, error: found.error, allowed: found.allowed };
    summary.shortfall = report.shortfall.map(shortfall);
    let fallback = || report.fallback.as_ref().map(ToString::to_string);
    summary.warning = report.strain.as_ref().map(ToString::to_string).or_else(fallback);
    summary.failure = report.failure.as_ref().map(StepFailure::from);
}

/// Writes the state of a body to its frame, without forces.
fn observe_state(body: BodyView<'_>, now: &mut BodyFrame) {
    (now.centre, now.rotation) = (body.centre(), body.rotation());
    let motion = || MotionFrame { velocity: body.centre_velocity(), spin: body.angular_velocity() };
    now.motion = body.scene().path().is_none().then(motion);
    if body.is_at_rest() {
        now.rest();
    } else {
        let mut states = States { displacement: take(&mut now.displacements), velocity: take(&mut now.velocities) };
        body.states_into(&mut states);
        (now.displacements, now.velocities) = (states.displacement, states.velocity);
        now.displaced(body.rest_shape());
    }
    now.clear_forces();
}

impl Simulation for World {
    fn schema(&self) -> Schema {
        schema(self.scene())
    }

    fn overrides(&self, steps: Option<u64>) -> Result<String, String> {
        self.scene().overrides_after(self.edits_entered(), steps)
    }

    fn steps_taken(&self) -> u64 {
        World::steps_taken(self)
    }

    fn time(&self) -> f64 {
        World::time(self)
    }

    fn step(&mut self, summary: &mut StepSummary) {
        let _ = World::step(self);
        summarise(self, summary);
    }

    fn interrupt(&self) -> Option<&'static AtomicBool> {
        self.options().interrupt
    }

    fn account(&self) -> Option<String> {
        if self.scene().bodies.iter().all(|body| body.path().is_some()) {
            return None;
        }
        let (now, ledger) = (self.conserved()?.energy(), self.ledger());
        let head =
            format!("energy of free bodies: {} at the start, {} at the end", short(self.first_energy()), short(now));
        if self.scene().integrator != Integrator::Exponential {
            return Some(head);
        }
        let brought = [
            ("events", ledger.events),
            ("gradual cores", ledger.core),
            ("damping", ledger.damping),
            ("friction", ledger.friction),
            ("pushes", ledger.pushes),
            ("bodies on paths", ledger.prescribed),
            ("force points", ledger.points),
            ("coming to rest", ledger.rest),
            ("edits", ledger.edits),
        ];
        let noise = 1e-14 * brought.iter().map(|(_, energy)| energy.abs()).fold(0.0, f64::max);
        let brought = brought.into_iter().filter(|&(_, energy)| energy.abs() > noise);
        let brought: Vec<String> = brought.map(|(name, energy)| format!("{name} {}", change(energy))).collect();
        let left = now - self.first_energy() - ledger.total();
        let brought = if brought.is_empty() { "nothing changed it".to_owned() } else { brought.join(", ") };
        Some(format!("{head}; {brought}; not accounted for: {left:.1e}"))
    }

    fn checksum(&self) -> u64 {
        World::checksum(self)
    }

    fn observe(&self, want: Want, frame: &mut Frame) {
        let scene = self.scene();
        frame.at = Instant { step: World::steps_taken(self), time: World::time(self) };
        frame.pairs.clear();
        frame.pairs.extend(self.pairs().map(pair_frame));
        frame.bodies.resize_with(self.body_count(), BodyFrame::default);
        let snapshot = self.current().filter(|_| want.forces || want.scalars);
        let mut energy = want.scalars.then(|| self.energy_sum()).flatten();
        let (mut surroundings, mut forces) = (Surroundings::default(), Forces::default());
        let causes: Vec<Cause> = Cause::of(scene).collect();
        let moving = self.bodies().filter(|body| !body.is_at_rest());
        let is_parallel = moving.map(|body| body.rest_shape().len()).sum::<usize>() >= PARALLEL_VERTICES;
        parallel::over(is_parallel, &mut frame.bodies, |index, now| observe_state(self.body(index), now));
        let observed = if want.forces || want.scalars { frame.bodies.as_mut_slice() } else { &mut [] };
        for (index, now) in observed.iter_mut().enumerate() {
            if let Some(snapshot) = &snapshot {
                if want.forces && !(now.is_at_rest && snapshot.is_idle(index)) {
                    add_coupled_forces(self, &causes, snapshot, index, &mut forces, now);
                }
                continue;
            }
            self.surroundings_into(index, &mut surroundings);
            if let Some(energy) = energy.as_mut().filter(|_| !(now.is_at_rest && surroundings.sources.is_empty())) {
                energy.add(&self.seen(index, [&now.displacements, &now.velocities], &surroundings));
            }
            if want.forces && !(now.is_at_rest && surroundings.is_idle()) {
                add_forces(self, &causes, index, &surroundings, now);
            }
        }
        frame.scalars.clear();
        if want.scalars {
            let conserved = snapshot.as_ref().map(Snapshot::conserved).unwrap_or_default();
            let of_coupled = snapshot.as_ref().map(|snapshot| Energy::of(&conserved, snapshot.reached()));
            let mut energy = energy.map(|energy| energy.sum).or(of_coupled).unwrap_or_default();
            if snapshot.is_some() && scene.bodies.iter().all(|body| body.path().is_some()) {
                // as where there are no planes: without masses
                let moving = frame.bodies.iter().zip(&scene.bodies).filter(|(now, _)| !now.is_at_rest);
                let energies =
                    moving.map(|(now, body)| oscillator::energy(body.material, &now.displacements, &now.velocities));
                [energy.kinetic, energy.elastic] =
                    energies.fold([0.0; 2], |[kinetic, elastic], of| [kinetic + of[0], elastic + of[1]]);
            }
            let state = StateNumbers {
                scene,
                energy,
                bodies: &frame.bodies,
                resting: self.resting_count(),
                conserved,
                ledger: self.ledger(),
                first_energy: self.first_energy(),
            };
            frame.scalars.extend(scalars(scene).map(|scalar| match scalar.value {
                ScalarValue::State(value) => value(&state),
                ScalarValue::SumOfSteps(_) | ScalarValue::MaxOfSteps(_) => 0.0,
            }));
        }
    }

    fn near(&self, pairs: &mut Vec<NearPair>) {
        pairs.clear();
        pairs.extend(self.near_pairs().map(|(a, b, phase)| {
            let (one, other) = (self.body(a), self.body(b));
            let rate = other.centre_velocity() - one.centre_velocity();
            NearPair { a, b, phase: phase as usize, apart: other.centre() - one.centre(), rate }
        }));
    }

    fn reach(&self, a: usize, b: usize) -> f64 {
        self.reach_of(a, b)
    }

    fn on_path(&self, body: usize, time: f64) -> Option<[DVec3; 2]> {
        on_path(self.scene(), body, time)
    }

    fn stages(&self, before: &Frame) -> Vec<StageFrame> {
        stages::inside(before, self)
    }

    fn within(&self, before: &Frame, time: f64, bodies: &[usize], frame: &mut Frame) {
        let is_exact = self.scene().integrator == Integrator::Exponential;
        let mut first = Frame::default();
        let step = stages::step_of_solver(before, self, time, bodies, frame, &mut first);
        if let Some(step) = step.filter(|_| is_exact) {
            if stages::within(step, time, bodies, frame) {
                return;
            }
            stages::within_coupled(step, time, bodies, frame);
        }
    }

    fn framing(&self, only_affected_bodies: bool) -> Vec<(DVec3, f64)> {
        framing(self.scene(), only_affected_bodies)
    }
}

/// Position and velocity of the centre of a body [scene unit], if it is on a path.
pub fn on_path(scene: &Scene, body: usize, time: f64) -> Option<[DVec3; 2]> {
    let now = scene.bodies[body].path()?.at(time);
    Some([now.position, now.velocity])
}

/// The edits of a scene, and the starts and ends of pushes and force points.
fn scheduled(scene: &Scene) -> Vec<Scheduled> {
    let edits = scene.edits.iter().map(|edit| (edit.time, format!("{}{}", Scheduled::EDIT, edit.set.join(", "))));
    let pushes = scene.pushes.iter().flat_map(|push| {
        let what = format!("push on {}", scene.bodies[push.body].name);
        [(push.start, format!("{what} begins")), (push.end(), format!("{what} ends"))]
    });
    let points = scene.points.iter().flat_map(|point| {
        let what = format!("force point {}", point.name);
        [(point.start, format!("{what} begins to act")), (point.end(), format!("{what} no longer acts"))]
    });
    let all = edits.chain(pushes).chain(points).map(|(time, text)| Scheduled { time, text });
    let mut all: Vec<Scheduled> = all.filter(|of| of.time > 0.0 && of.time.is_finite()).collect();
    all.sort_by(|one, other| one.time.total_cmp(&other.time));
    all
}

/// A value by time: from the start, and from the instants of edits on.
struct Versions<T> {
    first: T,
    later: Vec<(Edit, T)>,
    dt: f64,
}

impl<T> Versions<T> {
    /// The values that follow from the numbers of a scene and of its edits.
    fn new(scene: &Scene, first: T, of: impl Fn(&Numbers) -> T) -> Versions<T> {
        let later = scene.edits.iter().map(|edit| (edit.clone(), of(edit.numbers())));
        Versions { first, later: later.collect(), dt: scene.dt }
    }

    fn at(&self, time: f64) -> &T {
        let last = self.later.iter().rev().find(|(edit, _)| edit.has_begun(time, self.dt));
        last.map_or(&self.first, |(_, value)| value)
    }
}

/// The force points, with what edits make of them.
fn points(scene: &Scene) -> Vec<PointSchema> {
    let schema = |(index, point): (usize, &Point)| {
        let sphere = |point: &Point, influence: &Influence| (point.clone(), influence.sphere_radius(point.radius));
        let first = sphere(point, &scene.influence);
        let versions = Versions::new(scene, first, |numbers| sphere(&numbers.points[index], &numbers.influence));
        let sphere = SphereAt::new(move |time| {
            let (point, radius) = versions.at(time);
            point.acts_at(time).then(|| (point.path.position(time), *radius))
        });
        let act = if point.strength < 0.0 { "repels" } else { "attracts" };
        PointSchema { label: format!("{} {act}", point.name), color: colors::LIME, sphere }
    };
    scene.points.iter().enumerate().map(schema).collect()
}

/// The levels of pairs, if they differ or change.
fn own_levels(scene: &Scene) -> OwnLevels {
    let is_free: Vec<bool> = scene.bodies.iter().map(|body| body.path().is_none()).collect();
    let of = move |(pairs, common): &(PairLaws, PairLaw), threshold: usize, [a, b]: [usize; 2]| {
        let law = pairs.of(a, b).unwrap_or(*common).of_pair(is_free[a] || is_free[b]);
        level(&law, *[Phase::Merged, Phase::Apart, Phase::Core].get(threshold)?)
    };
    let first = (scene.pairs.clone(), scene.common_law());
    if scene.edits.iter().any(|edit| (edit.numbers().pairs.clone(), edit.numbers().common_law()) != first) {
        let versions = Versions::new(scene, first, |numbers| (numbers.pairs.clone(), numbers.common_law()));
        return OwnLevels::changing(move |threshold, pair, time| of(versions.at(time), threshold, pair));
    }
    match scene.has_one_law() {
        true => OwnLevels::default(),
        false => OwnLevels::new(move |threshold, a, b| of(&first, threshold, [a, b])),
    }
}

fn planes(planes: &[Plane]) -> Vec<PlaneSchema> {
    planes.iter().map(|&Plane { normal, offset, friction, .. }| PlaneSchema { normal, offset, friction }).collect()
}

/// What edits change of influence spheres and planes.
fn changes(scene: &Scene) -> Vec<SchemaChange> {
    let is_other = |numbers: &Numbers| {
        let is_other_reach = |(body, reach): (&Body, &f64)| body.reach != *reach;
        scene.bodies.iter().zip(&numbers.reaches).any(is_other_reach)
            || planes(&numbers.planes) != planes(&scene.planes)
    };
    if !scene.edits.iter().any(|edit| is_other(edit.numbers())) {
        return Vec::new();
    }
    let change = |edit: &Edit| SchemaChange {
        after: edit.time + ROUNDING * scene.dt,
        reaches: scene.bodies.iter().zip(&edit.numbers().reaches).map(|(body, reach)| reach * body.radius).collect(),
        planes: planes(&edit.numbers().planes),
    };
    scene.edits.iter().map(change).collect()
}

fn body_schema(body: &Body) -> BodySchema {
    BodySchema {
        name: body.name.clone(),
        radius: body.radius,
        reach: body.sphere_radius(),
        shape: body.shape.label(),
        mesh: body.shape.mesh(),
        is_free: body.path().is_none(),
        mass: body.mass,
        color: body.color,
        can_be_absent: false,
        can_tear: false,
        has_springs: false,
    }
}

/// The schema of a scene's world. Other models of the same scene start from it and override what differs.
pub fn schema(scene: &Scene) -> Schema {
    let bodies = scene.bodies.iter().map(body_schema).collect();
    let thresholds = [
        ("merge_at", "merge at", Phase::Merged),
        ("split_at", "split at", Phase::Apart),
        ("core_at", "core at", Phase::Core),
    ];
    let thresholds = thresholds.into_iter().filter_map(|(name, label, phase)| {
        let lowest = scene.lowest_level(|law| level(law, phase))?;
        let level = level(&scene.common_law().of_pair(true), phase).unwrap_or(lowest);
        Some(Threshold { name, label, level, color: phase_color(phase) })
    });
    Schema {
        own_levels: own_levels(scene),
        name: scene.name.clone(),
        source: scene.source.clone(),
        run: scene.run_settings(),
        model: Model::Oscillators.name().to_owned(),
        integrator: scene.integrator.name().to_owned(),
        dt: scene.dt,
        steps: scene.steps(),
        tolerance: scene.tolerance,
        law: law(scene),
        credit: THESIS_IN_ENGLISH,
        blend: scene.blend,
        bodies,
        terms: Cause::of(scene).map(|cause| term(scene, cause)).collect(),
        labels: LABELS.into(),
        arrow_scale: arrow_scale(scene),
        up: up(scene),
        planes: planes(&scene.planes),
        points: points(scene),
        changes: changes(scene),
        scheduled: scheduled(scene),
        net_force_scale: net_force_scale(scene),
        phases: Phase::ALL
            .map(|phase| PhaseSchema {
                name: phase.name(),
                color: phase_color(phase),
                is_joined: phase != Phase::Apart,
            })
            .into(),
        events: crate::sim::events::KINDS.map(Into::into).into(),
        thresholds: thresholds.collect(),
        surfaces: OwnSurfaces::default(),
        scalars: scalars(scene).map(|scalar| scalar.schema(scene)).collect(),
        stages: Stage::ALL.map(Stage::name).into(),
        warnings: scene.warnings(),
        ..Schema::default()
    }
}

impl From<&Event> for PairEvent {
    /// The observer's view of an event, without the energy.
    fn from(event: &Event) -> PairEvent {
        PairEvent {
            name: event.name(),
            time: event.time,
            step: event.step,
            a: event.a as usize,
            b: event.b as usize,
            q: event.q,
            rate: event.rate,
            from: event.from as usize,
            to: event.to as usize,
            energy: None,
        }
    }
}

impl From<&Failure> for StepFailure {
    fn from(failure: &Failure) -> StepFailure {
        let words = failure.to_string();
        match failure {
            Failure::Diverged(_) => StepFailure::Diverged(words),
            Failure::Overworked(_) | Failure::Edit { .. } => StepFailure::NotTaken(words),
            Failure::Interrupted { .. } => StepFailure::Interrupted(words),
        }
    }
}
