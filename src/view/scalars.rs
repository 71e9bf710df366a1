//! The scalars of a scene: each entry of the tables below becomes a plot.

use super::scales::{largest_radius, strongest_pull};
use crate::{
    colors::{BROWN, GREEN, LIME, MAGENTA, ORANGE, PURPLE, Rgb, SILVER, SKY_BLUE, VERMILION, YELLOW},
    observe::{
        BodyFrame,
        schema::{ScalarOf, ScalarSchema},
    },
    scene::{Integrator, Scene},
    sim::{
        Energy, StepReport,
        free::{Conserved, Ledger},
    },
};

/// A scalar over time and its source: a function `S` of the state, or `R` of a step.
pub struct Scalar<S, R> {
    /// Its name, label and plot: see [`ScalarSchema`].
    pub name: &'static str,
    pub label: &'static str,
    pub plot: &'static str,
    pub value: ScalarValue<S, R>,
    pub is_smooth: bool,
}

/// How a scalar is obtained.
pub enum ScalarValue<S, R> {
    State(S),
    SumOfSteps(R),
    MaxOfSteps(R),
}

impl<S, R> Scalar<S, R> {
    /// Its schema in a scene.
    pub fn schema(&self, scene: &Scene) -> ScalarSchema {
        let Scalar { name, label, plot, ref value, is_smooth } = *self;
        let of = match value {
            ScalarValue::State(_) => ScalarOf::State,
            ScalarValue::SumOfSteps(_) => ScalarOf::SumOfSteps,
            ScalarValue::MaxOfSteps(_) => ScalarOf::MaxOfSteps,
        };
        let least_range = least_range(scene, plot);
        ScalarSchema { name, label, plot, of, is_smooth, least_range, color: color(name) }
    }
}

/// The colour of a kind of energy, or of what brings some, in all scenes and models.
fn color(name: &str) -> Option<Rgb> {
    Some(match name {
        "energy" | "unaccounted_energy" => SKY_BLUE,
        "energy_kinetic" | "brought_by_paths" => ORANGE,
        "energy_spin" | "brought_by_damping" => YELLOW,
        "energy_vibration" | "brought_by_pushes" => VERMILION,
        "energy_elastic" | "brought_by_events" => GREEN,
        "energy_influence" | "brought_by_cores" => PURPLE,
        "energy_gravity" | "brought_by_friction" => BROWN,
        "energy_plane" | "brought_by_rest" => SILVER,
        BY_POINTS => LIME,
        BY_EDITS => MAGENTA,
        _ => return None,
    })
}

/// A scalar of a world.
pub type OfWorld = Scalar<fn(&StateNumbers<'_>) -> f64, fn(&StepReport) -> f64>;

/// The input for scalars of the state.
pub struct StateNumbers<'a> {
    pub scene: &'a Scene,
    /// Number of bodies that are undeformed, or that rest on or against each other.
    pub resting: usize,
    pub energy: Energy,
    pub bodies: &'a [BodyFrame],
    /// Zero unless the scene is coupled.
    pub conserved: Conserved,
    pub ledger: Ledger,
    /// Energy at t = 0 [mass · scene unit²/s²].
    pub first_energy: f64,
}

/// The scalars of a scene.
pub fn scalars(scene: &Scene) -> impl Iterator<Item = &'static OfWorld> {
    let has_free = scene.bodies.iter().any(|body| body.path().is_none());
    let is_accounted_for = has_free && scene.integrator == Integrator::Exponential;
    let (first, last, momenta): (&[OfWorld], &[OfWorld], &[OfWorld]) = match (has_free, scene.is_coupled()) {
        (true, _) => (TOTAL_OF_FREE, CONSERVED, &MOMENTA),
        (false, false) => (DEFORMATION, TOTAL_ON_PATHS, &[]),
        (false, true) => (DEFORMATION, TOTAL_OF_DEFORMATION, &[]), // on planes, that of the influence is not known
    };
    let (has_points, has_edits) = (!scene.points.is_empty(), !scene.edits.is_empty());
    let occurs = move |scalar: &&OfWorld| match scalar.name {
        BY_POINTS => is_accounted_for && has_points,
        BY_EDITS => is_accounted_for && has_edits,
        _ => is_accounted_for,
    };
    [first, SCALARS, last, momenta].into_iter().flatten().chain(LEDGER.iter().filter(occurs))
}

/// The scalars of all scenes.
pub fn all() -> impl Iterator<Item = &'static OfWorld> {
    [TOTAL_OF_FREE, DEFORMATION, TOTAL_OF_DEFORMATION, TOTAL_ON_PATHS, SCALARS, CONSERVED, &MOMENTA, LEDGER]
        .into_iter()
        .flatten()
}

/// A smooth scalar of the state.
pub const fn smooth<S, R>(name: &'static str, label: &'static str, plot: &'static str, value: S) -> Scalar<S, R> {
    Scalar { name, label, plot, value: ScalarValue::State(value), is_smooth: true }
}

/// A scalar that jumps from step to step.
pub const fn jumping<S, R>(
    name: &'static str,
    label: &'static str,
    plot: &'static str,
    value: ScalarValue<S, R>,
) -> Scalar<S, R> {
    Scalar { name, label, plot, value, is_smooth: false }
}

/// Momentum and angular momentum by coordinate.
pub const fn momenta<S: Copy, R>([px, py, pz, lx, ly, lz]: [S; 6]) -> [Scalar<S, R>; 6] {
    [
        smooth("momentum_x", "momentum x [mass·unit/s]", MOMENTUM, px),
        smooth("momentum_y", "momentum y", MOMENTUM, py),
        smooth("momentum_z", "momentum z", MOMENTUM, pz),
        smooth("angular_momentum_x", "about the origin, x [mass·unit²/s]", ANGULAR_MOMENTUM, lx),
        smooth("angular_momentum_y", "y", ANGULAR_MOMENTUM, ly),
        smooth("angular_momentum_z", "z", ANGULAR_MOMENTUM, lz),
    ]
}

/// The energy of free bodies, and of those on paths by their masses.
const TOTAL_OF_FREE: &[OfWorld] =
    &[smooth("energy", "total [mass·unit²/s²]", OF_FREE, |state| state.energy.total())];
const OF_FREE: &str = "Energy [mass·unit²/s²] by kind";

/// The energy of the deformation of bodies on paths, which have no masses [scene unit²/s²].
const DEFORMATION: &[OfWorld] = &[
    smooth("energy_vibration", "vibration [unit²/s²]", DEFORMED, |state| state.energy.kinetic),
    smooth("energy_elastic", "elastic", DEFORMED, |state| state.energy.elastic),
];
/// The sum of these.
const TOTAL_OF_DEFORMATION: &[OfWorld] =
    &[smooth("energy", "total", DEFORMED, |state| state.energy.kinetic + state.energy.elastic)];
/// Their energy with that of the influence, which is thousands of times as large, mostly from vertices that no sphere
/// reaches. What the paths do to it is not counted.
const TOTAL_ON_PATHS: &[OfWorld] = &[
    smooth("energy", "total [unit²/s²]", ON_PATHS, |state| state.energy.total()),
    smooth("energy_influence", "influence", ON_PATHS, |state| state.energy.influence),
];
const ON_PATHS: &str = "Total with influence [unit²/s²], summed over vertices";

const DEFORMED: &str =
    "Energy of deformation [unit²/s²], summed over vertices; no balance: paths bring and take energy";
/// The plots of what free bodies conserve.
const MOMENTUM: &str = "Momentum";
const ANGULAR_MOMENTUM: &str = "Angular momentum";

/// Conserved quantities of free bodies. Energies are in units of mass · scene unit²/s².
const CONSERVED: &[OfWorld] = &[
    smooth("energy_kinetic", "kinetic", OF_FREE, |state| state.conserved.kinetic),
    smooth("energy_spin", "spin", OF_FREE, |state| state.conserved.spin),
    smooth("energy_vibration", "vibration", OF_FREE, |state| state.conserved.vibration),
    smooth("energy_elastic", "elastic", OF_FREE, |state| state.conserved.elastic),
    smooth("energy_influence", "influence", OF_FREE, |state| state.conserved.influence),
    smooth("energy_gravity", "gravity", OF_FREE, |state| state.conserved.gravity),
    smooth("energy_plane", "planes", OF_FREE, |state| state.conserved.plane),
];

const MOMENTA: [OfWorld; 6] = momenta([
    |state| state.conserved.momentum.x,
    |state| state.conserved.momentum.y,
    |state| state.conserved.momentum.z,
    |state| state.conserved.angular_momentum.x,
    |state| state.conserved.angular_momentum.y,
    |state| state.conserved.angular_momentum.z,
]);

/// Energy added to free bodies since t = 0 by cause, and the remainder when all causes are subtracted: the
/// integrator's error.
const LEDGER: &[OfWorld] = &[
    smooth("brought_by_events", "by events", BROUGHT, |state| state.ledger.events),
    smooth("brought_by_cores", "by gradual cores", BROUGHT, |state| state.ledger.core),
    smooth("brought_by_damping", "by damping", BROUGHT, |state| state.ledger.damping),
    smooth("brought_by_friction", "by friction", BROUGHT, |state| state.ledger.friction),
    smooth("brought_by_pushes", "by pushes", BROUGHT, |state| state.ledger.pushes),
    smooth("brought_by_paths", "by bodies on paths", BROUGHT, |state| state.ledger.prescribed),
    smooth(BY_POINTS, "by force points", BROUGHT, |state| state.ledger.points),
    smooth(BY_EDITS, "by edits", BROUGHT, |state| state.ledger.edits),
    smooth("brought_by_rest", "by coming to rest", BROUGHT, |state| state.ledger.rest),
    smooth("unaccounted_energy", "not accounted for [mass·unit²/s²]", UNACCOUNTED, |state| {
        state.conserved.energy() - state.first_energy - state.ledger.total()
    }),
];

/// Only in scenes with force points.
const BY_POINTS: &str = "brought_by_points";
/// Only in scenes with edits.
const BY_EDITS: &str = "brought_by_edits";
const BROUGHT: &str = "Energy added since t = 0 [mass·unit²/s²], by cause";
const UNACCOUNTED: &str = "Energy not accounted for [mass·unit²/s²]";

const SCALARS: &[OfWorld] = &[
    smooth("max_displacement", "largest displacement [radii]", "Displacement", |state| {
        let bodies = state.bodies.iter().zip(&state.scene.bodies);
        bodies.map(|(now, body)| now.max_displacement / body.radius).fold(0.0, f64::max)
    }),
    jumping(
        "reached_vertices",
        "vertices inside a sphere",
        "Counts",
        ScalarValue::State(|state| state.energy.reached_vertices as f64),
    ),
    jumping("substeps", "steps of the integrator", "Counts", ScalarValue::SumOfSteps(|report| report.substeps as f64)),
    jumping(
        "estimated_error",
        "estimated error of the step [radii]",
        "Estimated error",
        ScalarValue::MaxOfSteps(|report| report.error),
    ),
    jumping("sleeping_bodies", "bodies at rest", "Counts", ScalarValue::State(|state| state.resting as f64)),
];

/// The smallest range of a plot, see [`ScalarSchema`]: 1e-9 of the momentum of all
/// bodies at the speed that the strongest influence gives a vertex over a radius.
fn least_range(scene: &Scene, plot: &str) -> f64 {
    const SHARE: f64 = 1e-9;
    let radius = largest_radius(scene);
    let mass: f64 = scene.bodies.iter().filter(|body| body.path().is_none()).map(|body| body.mass).sum();
    let momentum = mass * (strongest_pull(scene, radius) * radius).sqrt();
    match plot {
        MOMENTUM => SHARE * momentum,
        ANGULAR_MOMENTUM => SHARE * momentum * radius,
        _ => 0.0,
    }
}
