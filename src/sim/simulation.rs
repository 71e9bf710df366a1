//! [`World`] as a [`Simulation`]: the only interface that recorder, replay, check and diff use.

use std::{mem::take, sync::atomic::AtomicBool};

use glam::DVec3;

use super::{
    StepReport, World,
    frames::{add_coupled_forces, add_forces, pair_frame},
    free::{Conserved, Forces, Ledger, Snapshot},
    observe::{Energy, EnergySum},
    report::Stage,
    stages,
    terms::{Cause, Surroundings},
    world::States,
};
use crate::{
    model::{
        PairLaw,
        phase::{Phase, Thresholds},
    },
    observe::{
        BodyFrame, Frame, Instant, MotionFrame, NearPair, PairEvent, Schema, Simulation, StageFrame, StepFailure,
        StepSummary, Want, between,
        colors::{self, Rgb},
        schema::{
            self, BodySchema, OwnLevels, OwnSurfaces, PhaseSchema, PlaneSchema, ScalarOf, ScalarSchema, TermSchema,
            Threshold,
        },
    },
    scene::{Body, Integrator, Model, Motion, Plane, Scene},
};

/// The smallest range of a plot, see [`ScalarSchema::least_range`]: 1e-9 of the momentum of all bodies at the speed
/// that the strongest influence gives a vertex over a radius.
pub fn least_range(scene: &Scene, plot: &str) -> f64 {
    const SHARE: f64 = 1e-9;
    let radius = scene.bodies.iter().map(|body| body.radius).fold(0.0, f64::max);
    let mass: f64 = scene.bodies.iter().filter(|body| body.path().is_none()).map(|body| body.mass).sum();
    let momentum = mass * (strongest_pull(scene, radius) * radius).sqrt();
    match plot {
        MOMENTUM => SHARE * momentum,
        ANGULAR_MOMENTUM => SHARE * momentum * radius,
        _ => 0.0,
    }
}

/// All phases in order of depth, deepest last.
const PHASES: [Phase; 3] = [Phase::Apart, Phase::Merged, Phase::Core];

/// Label of a vertex, by what influence spheres do to it.
const LABELS: [&str; 5] = ["out of reach", "attracted", "repelled", "attracted and repelled", "in a core"];

/// The label of a vertex, given which kinds of sphere act on it: attraction, repulsion of bodies apart, core.
pub fn label([is_attracted, is_repelled, is_in_core]: [bool; 3]) -> u8 {
    match (is_attracted, is_repelled, is_in_core) {
        (_, _, true) => 4,
        (is_attracted, is_repelled, _) => u8::from(is_attracted) + 2 * u8::from(is_repelled),
    }
}

/// A scalar over time and its source. Each entry of the tables below becomes a plot.
struct Scalar {
    name: &'static str,
    label: &'static str,
    plot: &'static str,
    value: ScalarValue,
    is_smooth: bool,
}

enum ScalarValue {
    State(fn(&StateNumbers<'_>) -> f64),
    SumOfSteps(fn(&StepReport) -> f64),
    MaxOfSteps(fn(&StepReport) -> f64),
}

/// The input for scalars of the state.
struct StateNumbers<'a> {
    scene: &'a Scene,
    /// Number of bodies that are undeformed, or that rest on or against each other.
    resting: usize,
    energy: Energy,
    bodies: &'a [BodyFrame],
    /// Zero unless the scene is coupled.
    conserved: Conserved,
    ledger: Ledger,
    /// Energy at t = 0 [mass · scene unit²/s²].
    first_energy: f64,
}

/// The scalars of a scene.
fn scalars(scene: &Scene) -> impl Iterator<Item = &'static Scalar> {
    let is_coupled = scene.is_coupled();
    let is_accounted_for = is_coupled && scene.integrator == Integrator::Exponential;
    let parts = if is_coupled { CONSERVED } else { PARTS };
    SCALARS.iter().chain(parts).chain(LEDGER.iter().filter(move |_| is_accounted_for))
}

/// A smooth scalar of the state.
const fn smooth(
    name: &'static str,
    label: &'static str,
    plot: &'static str,
    value: fn(&StateNumbers<'_>) -> f64,
) -> Scalar {
    Scalar { name, label, plot, value: ScalarValue::State(value), is_smooth: true }
}

/// The parts of the energy of bodies on paths, in units of scene unit²/s².
const PARTS: &[Scalar] = &[
    smooth("energy_vibration", "kinetic [unit²/s²]", DEFORMED, |state| state.energy.kinetic),
    smooth("energy_elastic", "elastic", DEFORMED, |state| state.energy.elastic),
    // in its own plot: it is thousands of times as large, mostly from vertices that no sphere reaches
    smooth("energy_influence", "influence", "Energy", |state| state.energy.influence),
];

const DEFORMED: &str = "Energy of deformation";
/// The plots of what free bodies conserve.
pub const MOMENTUM: &str = "Momentum";
pub const ANGULAR_MOMENTUM: &str = "Angular momentum";

/// Conserved quantities of free bodies. Energies are in units of mass · scene unit²/s².
const CONSERVED: &[Scalar] = &[
    smooth("energy_kinetic", "kinetic", "Energy", |state| state.conserved.kinetic),
    smooth("energy_spin", "spin", "Energy", |state| state.conserved.spin),
    smooth("energy_vibration", "vibration", "Energy", |state| state.conserved.vibration),
    smooth("energy_elastic", "elastic", "Energy", |state| state.conserved.elastic),
    smooth("energy_influence", "influence", "Energy", |state| state.conserved.influence),
    smooth("energy_gravity", "gravity", "Energy", |state| state.conserved.gravity),
    smooth("energy_plane", "planes", "Energy", |state| state.conserved.plane),
    smooth("momentum_x", "momentum x [mass·unit/s]", MOMENTUM, |state| state.conserved.momentum.x),
    smooth("momentum_y", "momentum y", MOMENTUM, |state| state.conserved.momentum.y),
    smooth("momentum_z", "momentum z", MOMENTUM, |state| state.conserved.momentum.z),
    smooth("angular_momentum_x", "about the origin, x [mass·unit²/s]", ANGULAR_MOMENTUM, |state| {
        state.conserved.angular_momentum.x
    }),
    smooth("angular_momentum_y", "y", ANGULAR_MOMENTUM, |state| state.conserved.angular_momentum.y),
    smooth("angular_momentum_z", "z", ANGULAR_MOMENTUM, |state| state.conserved.angular_momentum.z),
];

/// Energy brought to free bodies since t = 0 by cause, and the remainder when all causes are subtracted: the
/// integrator's error.
const LEDGER: &[Scalar] = &[
    smooth("brought_by_events", "by events", BROUGHT, |state| state.ledger.events),
    smooth("brought_by_cores", "by gradual cores", BROUGHT, |state| state.ledger.core),
    smooth("brought_by_damping", "by damping", BROUGHT, |state| state.ledger.damping),
    smooth("brought_by_friction", "by friction", BROUGHT, |state| state.ledger.friction),
    smooth("brought_by_pushes", "by pushes", BROUGHT, |state| state.ledger.pushes),
    smooth("brought_by_paths", "by bodies on paths", BROUGHT, |state| state.ledger.prescribed),
    smooth("brought_by_rest", "by coming to rest", BROUGHT, |state| state.ledger.rest),
    smooth("unaccounted_energy", "not accounted for [mass·unit²/s²]", "Energy not accounted for", |state| {
        state.conserved.energy() - state.first_energy - state.ledger.total()
    }),
];

const BROUGHT: &str = "Energy brought since t = 0";

const SCALARS: &[Scalar] = &[
    Scalar {
        name: "energy",
        label: "energy [unit²/s²]",
        plot: "Energy",
        value: ScalarValue::State(|state| state.energy.total()),
        is_smooth: true,
    },
    Scalar {
        name: "max_displacement",
        label: "largest displacement [radii]",
        plot: "Displacement",
        value: ScalarValue::State(|state| {
            let bodies = state.bodies.iter().zip(&state.scene.bodies);
            bodies.map(|(now, body)| now.max_displacement / body.radius).fold(0.0, f64::max)
        }),
        is_smooth: true,
    },
    Scalar {
        name: "reached_vertices",
        label: "vertices inside a sphere",
        plot: "Counts",
        value: ScalarValue::State(|state| state.energy.reached_vertices as f64),
        is_smooth: false,
    },
    Scalar {
        name: "substeps",
        label: "steps of the integrator",
        plot: "Counts",
        value: ScalarValue::SumOfSteps(|report| report.substeps as f64),
        is_smooth: false,
    },
    Scalar {
        name: "estimated_error",
        label: "estimated error of the step [radii]",
        plot: "Estimated error",
        value: ScalarValue::MaxOfSteps(|report| report.error),
        is_smooth: false,
    },
    Scalar {
        name: "sleeping_bodies",
        label: "bodies at rest",
        plot: "Counts",
        value: ScalarValue::State(|state| state.resting as f64),
        is_smooth: false,
    },
];

impl Simulation for World {
    fn schema(&self) -> Schema {
        schema(self.scene())
    }

    fn overrides(&self, steps: Option<u64>) -> String {
        self.scene().overrides(steps)
    }

    fn steps_taken(&self) -> u64 {
        World::steps_taken(self)
    }

    fn time(&self) -> f64 {
        World::time(self)
    }

    fn step(&mut self) {
        World::step(self);
    }

    fn summary(&self, summary: &mut StepSummary) {
        let (report, is_coupled) = (self.report(), self.coupled.is_some());
        summary.at = Instant { step: report.step, time: report.time };
        summary.events.clear();
        summary.events.extend(
            report
                .events
                .iter()
                .map(|event| PairEvent { energy: is_coupled.then_some(event.energy), ..PairEvent::from(event) }),
        );
        summary.timings.clear();
        summary.timings.extend(report.timings);
        summary.scalars.clear();
        summary.scalars.extend(scalars(self.scene()).map(|scalar| match scalar.value {
            ScalarValue::State(_) => 0.0,
            ScalarValue::SumOfSteps(value) | ScalarValue::MaxOfSteps(value) => value(report),
        }));
        summary.shortfall = report.shortfall;
        summary.warning = report.strain.as_ref().map(ToString::to_string);
        summary.failure = report.failure.as_ref().map(StepFailure::from);
    }

    fn interrupt(&self) -> Option<&'static AtomicBool> {
        self.options().interrupt
    }

    fn memory(&self) -> Option<u64> {
        Some(World::memory(self) as u64)
    }

    fn account(&self) -> Option<String> {
        let (now, ledger) = (self.conserved()?.energy(), self.ledger());
        let head = format!("energy of free bodies: {:.4} at the start, {now:.4} at the end", self.first_energy);
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
            ("coming to rest", ledger.rest),
        ];
        let brought = brought.into_iter().filter(|&(_, energy)| energy != 0.0);
        let brought: Vec<String> = brought.map(|(name, energy)| format!("{name} {energy:+.4}")).collect();
        let left = now - self.first_energy - ledger.total();
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
        let snapshot = self.snapshot().filter(|_| want.forces || want.scalars);
        let mut energy = (want.scalars && snapshot.is_none())
            .then(|| EnergySum::new(scene, self.energy_of_distant_pairs(), self.phases()));
        let (mut surroundings, mut forces) = (Surroundings::default(), Forces::default());
        for ((index, body), now) in self.bodies().enumerate().zip(&mut frame.bodies) {
            (now.centre, now.rotation) = (body.centre(), body.rotation());
            now.motion = body
                .scene()
                .path()
                .is_none()
                .then(|| MotionFrame { velocity: body.centre_velocity(), spin: body.angular_velocity() });
            if body.is_at_rest() {
                now.rest();
            } else {
                let mut states =
                    States { displacement: take(&mut now.displacements), velocity: take(&mut now.velocities) };
                body.states_into(&mut states);
                (now.displacements, now.velocities) = (states.displacement, states.velocity);
                now.displaced(self.bodies[index].rest());
            }
            now.clear_forces();
            if !(want.forces || want.scalars) {
                continue;
            }
            if let Some(snapshot) = &snapshot {
                if want.forces && !(now.is_at_rest && snapshot.is_idle(index)) {
                    add_coupled_forces(self, snapshot, index, &mut forces, now);
                }
                continue;
            }
            self.surroundings_into(index, &mut surroundings);
            if let Some(energy) = energy.as_mut().filter(|_| !(now.is_at_rest && surroundings.sources.is_empty())) {
                energy.add(&self.seen(index, [&now.displacements, &now.velocities], &surroundings));
            }
            if want.forces && !(now.is_at_rest && surroundings.is_idle()) {
                add_forces(self, index, &surroundings, now);
            }
        }
        frame.scalars.clear();
        if want.scalars {
            let conserved = snapshot.as_ref().map(Snapshot::conserved).unwrap_or_default();
            let of_coupled = snapshot.as_ref().map(|snapshot| Energy::of(&conserved, snapshot.reached()));
            let state = StateNumbers {
                scene,
                energy: energy.map(|energy| energy.sum).or(of_coupled).unwrap_or_default(),
                bodies: &frame.bodies,
                resting: match &self.coupled {
                    Some(coupled) => self.body_count() - coupled.awake_count(),
                    None => frame.bodies.iter().filter(|body| body.is_at_rest).count(),
                },
                conserved,
                ledger: self.ledger(),
                first_energy: self.first_energy,
            };
            frame.scalars.extend(scalars(scene).map(|scalar| match scalar.value {
                ScalarValue::State(value) => value(&state),
                ScalarValue::SumOfSteps(_) | ScalarValue::MaxOfSteps(_) => 0.0,
            }));
        }
    }

    fn near(&self, pairs: &mut Vec<NearPair>) {
        pairs.clear();
        pairs.extend(self.pairs().map(|pair| {
            let (a, b) = (self.body(pair.a), self.body(pair.b));
            NearPair {
                a: pair.a,
                b: pair.b,
                phase: pair.phase as usize,
                apart: b.centre() - a.centre(),
                rate: b.centre_velocity() - a.centre_velocity(),
            }
        }));
    }

    fn apart(&self, a: usize, b: usize, time: f64) -> Option<DVec3> {
        apart_on_paths(self.scene(), a, b, time)
    }

    fn stages(&self, before: &Frame) -> Vec<StageFrame> {
        stages::inside(before, self)
    }

    fn within(&self, before: &Frame, time: f64, bodies: &[usize], frame: &mut Frame) {
        let is_exact = self.scene().integrator == Integrator::Exponential;
        if is_exact && self.coupled.is_none() && stages::within(before, self, time, bodies, frame) {
            return;
        }
        let written = if is_exact { stages::within_coupled(before, self, time, bodies, frame) } else { Vec::new() };
        let others: Vec<usize> = bodies.iter().copied().filter(|body| !written.contains(body)).collect();
        if !others.is_empty() {
            let mut after = Frame::default();
            self.observe(Want::default(), &mut after);
            between(&Simulation::schema(self), [before, &after], time, &others, frame);
        }
        for &index in bodies.iter().filter(|&&index| self.scene().bodies[index].path().is_some()) {
            frame.bodies[index].centre = self.path(index).position(time);
        }
    }

    fn framing(&self, only_affected_bodies: bool) -> Vec<(DVec3, f64)> {
        framing(self.scene(), only_affected_bodies)
    }
}

/// Centre of body `b` as seen from that of body `a` [scene unit], if both are on paths.
pub fn apart_on_paths(scene: &Scene, a: usize, b: usize, time: f64) -> Option<DVec3> {
    Some(scene.bodies[b].path()?.position(time) - scene.bodies[a].path()?.position(time))
}

/// What a camera should have in view, see [`Simulation::framing`].
pub fn framing(scene: &Scene, only_affected_bodies: bool) -> Vec<(DVec3, f64)> {
    if only_affected_bodies { affected_bodies(scene) } else { all_spheres(scene) }
}

/// Colour of a phase: the colour of the force that it causes.
pub fn phase_color(phase: Phase) -> Rgb {
    match phase {
        Phase::Apart => colors::SKY_BLUE,
        Phase::Merged => colors::ORANGE,
        Phase::Core => colors::PURPLE,
    }
}

/// The schema of a scene's world. Other models of the same scene start from it and override what differs.
pub fn schema(scene: &Scene) -> Schema {
    let bodies = scene.bodies.iter().map(|body| BodySchema {
        name: body.name.clone(),
        radius: body.radius,
        reach: scene.influence.sphere_radius(body.radius),
        shape: body.shape.label(),
        mesh: body.shape.mesh(),
        is_free: body.path().is_none(),
        mass: body.mass,
        color: body.color,
        can_tear: false,
    });
    let bodies = bodies.collect();
    let thresholds = [
        ("merge_at", "merge at", Phase::Merged),
        ("split_at", "split at", Phase::Apart),
        ("core_at", "core at", Phase::Core),
    ];
    let thresholds = thresholds.into_iter().filter_map(|(name, label, phase)| {
        let lowest = scene.laws().filter_map(|law| level(&law, phase)).reduce(f64::min)?;
        let level = level(&scene.common_law().of_pair(true), phase).unwrap_or(lowest);
        Some(Threshold { name, label, level, color: phase_color(phase) })
    });
    let own_levels = if scene.has_one_law() {
        OwnLevels::default()
    } else {
        let (pairs, common) = (scene.pairs.clone(), scene.common_law());
        let is_free: Vec<bool> = scene.bodies.iter().map(|body| body.path().is_none()).collect();
        OwnLevels::new(move |threshold, a, b| {
            let law = pairs.of(a, b).unwrap_or(common).of_pair(is_free[a] || is_free[b]);
            level(&law, *[Phase::Merged, Phase::Apart, Phase::Core].get(threshold)?)
        })
    };
    Schema {
        name: scene.name.clone(),
        source: scene.source.clone(),
        run: scene.run_settings(),
        model: Model::Oscillators.name().to_owned(),
        integrator: scene.integrator.name().to_owned(),
        dt: scene.dt,
        steps: scene.steps(),
        tolerance: scene.tolerance,
        law: law(scene),
        blend: scene.blend,
        bodies,
        terms: Cause::of(scene.is_coupled()).map(|cause| term(scene, cause)).collect(),
        labels: LABELS.into(),
        arrow_scale: arrow_scale(scene),
        planes: scene
            .planes
            .iter()
            .map(|&Plane { normal, offset, friction, .. }| PlaneSchema { normal, offset, friction })
            .collect(),
        net_force_scale: net_force_scale(scene),
        phases: PHASES
            .map(|phase| PhaseSchema {
                name: phase.name(),
                color: phase_color(phase),
                is_joined: phase != Phase::Apart,
            })
            .into(),
        thresholds: thresholds.collect(),
        own_levels,
        surfaces: OwnSurfaces::default(),
        scalars: scalars(scene)
            .map(|&Scalar { name, label, plot, ref value, is_smooth }| {
                let of = match value {
                    ScalarValue::State(_) => ScalarOf::State,
                    ScalarValue::SumOfSteps(_) => ScalarOf::SumOfSteps,
                    ScalarValue::MaxOfSteps(_) => ScalarOf::MaxOfSteps,
                };
                // energies jump with the phase: each phase has its own potential
                let (jumps, least_range) = (name.starts_with("energy"), least_range(scene, plot));
                ScalarSchema { name, label, plot, of, is_smooth, jumps, least_range }
            })
            .collect(),
        stages: Stage::ALL.map(Stage::name).into(),
        warnings: scene.warnings(),
    }
}

/// The q at which a pair enters a phase [–], if there is one.
fn level(law: &PairLaw, phase: Phase) -> Option<f64> {
    let Thresholds { merge_at, split_at, core_at } = law.thresholds;
    match phase {
        Phase::Merged => Some(merge_at),
        Phase::Apart => Some(split_at),
        Phase::Core => (core_at > 0.0).then_some(core_at),
    }
}

fn term(scene: &Scene, cause: Cause) -> TermSchema {
    let (has_pairs, has_free) = (scene.bodies.len() > 1, scene.bodies.iter().any(|body| body.path().is_none()));
    let has_core = scene.laws().any(|law| level(&law, Phase::Core).is_some());
    #[allow(unreachable_patterns)] // a term without its own line gets the defaults
    let (label, color, can_act, is_shown) = match cause {
        Cause::Attraction => ("Attraction", colors::ORANGE, has_pairs, true),
        Cause::Repulsion => ("Repulsion of bodies apart", colors::SKY_BLUE, has_pairs, true),
        Cause::Core => ("Repulsion in the core", colors::PURPLE, has_pairs && has_core, true),
        Cause::Restoring => ("Restoring", colors::GREEN, true, false),
        Cause::Damping => ("Damping", colors::YELLOW, true, false),
        Cause::Push => ("Push", colors::VERMILION, !scene.pushes.is_empty(), !scene.pushes.is_empty()),
        Cause::Carry => ("Carry: its own motion", colors::SILVER, true, false),
        Cause::Gravity => ("Gravity", colors::GREY, scene.gravity != DVec3::ZERO, false),
        Cause::Plane => ("Planes: pressure and friction", colors::BLUE, !scene.planes.is_empty(), true),
        Cause::Reaction => ("Reaction to its sphere", colors::PINK, has_free && has_pairs, false),
        Cause::Net => ("Net", colors::WHITE, true, false),
        _ => (cause.name(), colors::BLUE, true, true),
    };
    let has_source = matches!(cause, Cause::Attraction | Cause::Repulsion | Cause::Core);
    let is_uniform = matches!(cause, Cause::Gravity | Cause::Reaction);
    TermSchema { name: cause.name(), label, color, has_source, can_act, is_shown, is_uniform }
}

fn law(scene: &Scene) -> String {
    let (influence, thresholds) = (&scene.influence, &scene.thresholds);
    format!(
        "α = {}/s², β = {}/s², spheres {:.3} R. Merge at q = {}, split at {}{}; q: centre distance over the sum of the radii.{}",
        influence.alpha,
        influence.beta,
        influence.reach,
        thresholds.merge_at,
        thresholds.split_at,
        if thresholds.core_at > 0.0 { format!(", core below {}", thresholds.core_at) } else { String::new() },
        match scene.pairs.laws().len() {
            0 => String::new(),
            1 => " One `[[pair]]` has another law.".to_owned(),
            n => format!(" {n} `[[pair]]`s have other laws."),
        },
    )
}

/// Length per acceleration of net force arrows: about a radius for gravity or for a quarter of the strongest influence,
/// whichever is larger.
fn net_force_scale(scene: &Scene) -> f64 {
    let radius = scene.bodies.iter().map(|body| body.radius).fold(0.0, f64::max);
    schema::arrow_scale(2.5 * radius, f64::max(scene.gravity.length(), 0.25 * strongest_pull(scene, radius)))
}

/// The strongest influence on any vertex [scene unit/s²], for the largest radius.
fn strongest_pull(scene: &Scene, radius: f64) -> f64 {
    let strength = scene.laws().map(|law| law.alpha.max(law.beta)).fold(0.0, f64::max);
    strength * scene.influence.sphere_radius(radius) * scene.influence.weight.max_pull()
}

/// Length of an arrow per acceleration [scene unit per scene unit/s²]. The strongest influence or push on the largest
/// body gets an arrow of about 0.4 of its radius.
pub fn arrow_scale(scene: &Scene) -> f64 {
    let radius = scene.bodies.iter().map(|body| body.radius).fold(0.0, f64::max);
    let pull = strongest_pull(scene, radius);
    schema::arrow_scale(radius, scene.pushes.iter().map(|push| push.strength.abs()).fold(pull, f64::max))
}

/// Instants within the first minute at which the camera framing samples positions [s].
fn instants(scene: &Scene) -> impl Iterator<Item = f64> {
    let duration = scene.duration.min(60.0);
    (0..=32).map(move |k| duration * f64::from(k) / 32.0)
}

/// Approximate positions of the bodies at each instant: free bodies fly until they touch a plane or come near another
/// body, and stay there.
fn positions(scene: &Scene) -> Vec<Vec<DVec3>> {
    /// With more free bodies than this, encounters are not searched for.
    const MAX_FREE: usize = 300;

    let bodies = &scene.bodies;
    let free = bodies.iter().filter(|body| body.path().is_none()).count();
    let mut stays: Vec<Option<DVec3>> = vec![None; bodies.len()];
    let mut at = |time: f64| {
        let position = |(body, stays): (&Body, &Option<DVec3>)| match (&body.motion, stays) {
            (_, Some(stays)) => *stays,
            (Motion::Prescribed(path), _) => path.position(time),
            (Motion::Free(free), _) => free.from + time * (free.velocity + 0.5 * time * scene.gravity),
        };
        let positions: Vec<DVec3> = bodies.iter().zip(&stays).map(position).collect();
        for (i, body) in bodies.iter().enumerate().filter(|(_, body)| body.path().is_none()) {
            let near =
                |j: usize| i != j && positions[i].distance(positions[j]) < 0.9 * (body.radius + bodies[j].radius);
            let lies = |plane: &&Plane| plane.depth(positions[i]) > -body.radius;
            if stays[i].is_none() {
                let on_plane = scene.planes.iter().find(lies);
                let lifted =
                    on_plane.map(|plane| positions[i] + (plane.depth(positions[i]) + body.radius) * plane.normal);
                let is_near = || free <= MAX_FREE && (0..bodies.len()).any(near);
                stays[i] = lifted.or_else(|| is_near().then_some(positions[i]));
            }
        }
        positions
    };
    instants(scene).map(&mut at).collect()
}

/// Every influence sphere along its path.
fn all_spheres(scene: &Scene) -> Vec<(DVec3, f64)> {
    let radius = |body: &Body| scene.influence.sphere_radius(body.radius).min(2.0 * body.radius);
    let spheres =
        |centres: Vec<DVec3>| centres.into_iter().zip(&scene.bodies).map(|(centre, body)| (centre, radius(body)));
    positions(scene).into_iter().flat_map(|centres| spheres(centres).collect::<Vec<_>>()).collect()
}

/// The bodies that something acts on, where they are then; all spheres if there are none.
fn affected_bodies(scene: &Scene) -> Vec<(DVec3, f64)> {
    /// With more bodies than this, pairs are not examined.
    const MAX_BODIES: usize = 1000;
    /// Size of a body including its displacements [radii].
    const SIZE: f64 = 1.15;
    /// A body larger than this is shown only in part [radii of the other].
    const MAX_SHOWN: f64 = 3.0;

    let bodies = &scene.bodies;
    let mut acted_on = Vec::new();
    for push in &scene.pushes {
        let body = &bodies[push.body];
        let centre = match &body.motion {
            Motion::Prescribed(path) => path.position(push.start),
            Motion::Free(free) => free.from,
        };
        acted_on.push((centre, SIZE * body.radius));
    }
    let pairs_of = if bodies.len() > MAX_BODIES { 0 } else { bodies.len() };
    let movers: Vec<usize> = (0..pairs_of).filter(|&i| bodies[i].path().is_none_or(|path| !path.is_fixed())).collect();
    let all: Vec<usize> = (0..pairs_of).collect();
    for (k, centres) in positions(scene).into_iter().enumerate() {
        // pairs of fixed bodies are examined only at the first instant
        for &b in if k == 0 { &all } else { &movers } {
            for a in (0..pairs_of).filter(|&a| a != b) {
                let reach =
                    |from: usize, to: usize| scene.influence.sphere_radius(bodies[from].radius) + bodies[to].radius;
                if centres[a].distance(centres[b]) < f64::max(reach(a, b), reach(b, a)) {
                    // of a body that is much larger than the other, only the side towards the other
                    let shown = |i: usize, other: usize| {
                        let radius = f64::min(bodies[i].radius, MAX_SHOWN * bodies[other].radius);
                        let towards = (centres[other] - centres[i]).normalize_or_zero();
                        (centres[i] + (bodies[i].radius - radius) * towards, SIZE * radius)
                    };
                    acted_on.extend([shown(a, b), shown(b, a)]);
                }
            }
        }
    }
    if acted_on.is_empty() { all_spheres(scene) } else { acted_on }
}
