//! What is simulated, told once: what frames have numbers for.

use std::{collections::BTreeMap, sync::Arc};

use super::{colors::Rgb, simulation::PairEvent};
use crate::geometry::{Mesh, Rest};

/// What is simulated.
#[derive(Clone, Debug)]
pub struct Schema {
    /// Name of the scene, of its recording and of its default output file.
    pub name: String,
    /// The text that the simulation was made from: a recording carries it, so that it can be made again.
    pub source: String,
    /// What it takes besides to make it again, as lines of TOML: a recording carries these, too.
    pub run: String,
    /// How steps are taken, in a word.
    pub integrator: String,
    /// Step Δt [s], > 0.
    pub dt: f64,
    /// Number of steps that the scene asks for.
    pub steps: u64,
    /// The error that does not matter [radii per unit of scene time].
    pub tolerance: f64,
    /// What acts between bodies, as Markdown for people.
    pub law: String,
    /// At least one; names are unique.
    pub bodies: Vec<BodySchema>,
    /// What accelerates vertices, by cause. The last one is the sum of all.
    pub terms: Vec<TermSchema>,
    /// How [`BodyFrame::labels`](super::BodyFrame::labels) read; the first is that of vertices on which nothing acts.
    pub labels: Vec<&'static str>,
    /// Length of an arrow per acceleration [scene unit per scene unit/s²].
    pub arrow_scale: f64,
    /// What two bodies can be to each other, the least first.
    pub phases: Vec<PhaseSchema>,
    /// The levels of q at which that changes.
    pub thresholds: Vec<Threshold>,
    /// Numbers over time.
    pub scalars: Vec<ScalarSchema>,
    /// The stages of a step of which the time is measured, in order.
    pub stages: Vec<&'static str>,
}

/// A body.
#[derive(Clone, Debug)]
pub struct BodySchema {
    /// Unique; letters, digits, `-` and `_`.
    pub name: String,
    /// How far the farthest vertex is from the centre at rest [scene unit], > 0: errors are measured in it.
    pub radius: f64,
    /// Radius of the sphere in which it acts on others [scene unit]; 0 for none.
    pub reach: f64,
    /// The name of its shape, which says the same of every body that has it: letters, digits, `-` and `_`.
    pub shape: String,
    /// The shape at rest, of radius 1.
    pub mesh: Arc<Mesh>,
}

/// A cause of acceleration.
#[derive(Clone, Debug)]
pub struct TermSchema {
    /// Of its entity: letters, digits, `-` and `_`.
    pub name: &'static str,
    /// For people.
    pub label: &'static str,
    /// Of its arrows.
    pub color: Rgb,
    /// Whether it comes from other bodies, of which arrows name the one.
    pub has_source: bool,
    /// Whether it can act in this scene at all.
    pub can_act: bool,
    /// Whether its arrows are shown from the start.
    pub is_shown: bool,
}

/// What two bodies can be to each other.
#[derive(Clone, Debug)]
pub struct PhaseSchema {
    /// A word.
    pub name: &'static str,
    /// Of its lanes, lines and spheres.
    pub color: Rgb,
}

/// A level of q at which a pair changes phase.
#[derive(Clone, Debug)]
pub struct Threshold {
    /// Of its entity.
    pub name: &'static str,
    /// For people.
    pub label: &'static str,
    /// q [–].
    pub level: f64,
    /// Of its line.
    pub color: Rgb,
}

/// A number over time.
#[derive(Clone, Debug)]
pub struct ScalarSchema {
    /// Of its entity.
    pub name: &'static str,
    /// For people, with its unit.
    pub label: &'static str,
    /// The plot in which its line is.
    pub plot: &'static str,
    /// Where it comes from.
    pub of: ScalarOf,
    /// Whether it changes all the time: its line is straight from one value to the next, and not level.
    pub is_smooth: bool,
}

/// Where a number comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ScalarOf {
    /// The state: it is in the frame.
    State,
    /// Each step: a frame shows the sum over the steps since the one before.
    SumOfSteps,
    /// Each step: a frame shows the largest of them.
    MaxOfSteps,
}

impl Default for Schema {
    /// Of nothing, at 60 steps a second.
    fn default() -> Schema {
        Schema {
            name: String::new(),
            source: String::new(),
            run: String::new(),
            integrator: String::new(),
            dt: 1.0 / 60.0,
            steps: 0,
            tolerance: 1e-6,
            law: String::new(),
            bodies: Vec::new(),
            terms: Vec::new(),
            labels: Vec::new(),
            arrow_scale: 0.01,
            phases: Vec::new(),
            thresholds: Vec::new(),
            scalars: Vec::new(),
            stages: Vec::new(),
        }
    }
}

impl BodySchema {
    /// A body whose farthest vertex is at `radius`, and which acts on others within `reach` [scene unit].
    pub fn new(name: &str, shape: &str, mesh: Arc<Mesh>, radius: f64, reach: f64) -> BodySchema {
        BodySchema { name: name.to_owned(), radius, reach, shape: shape.to_owned(), mesh }
    }
}

impl From<(&'static str, Rgb)> for PhaseSchema {
    fn from((name, color): (&'static str, Rgb)) -> PhaseSchema {
        PhaseSchema { name, color }
    }
}

impl From<(&'static str, f64, Rgb)> for Threshold {
    fn from((name, level, color): (&'static str, f64, Rgb)) -> Threshold {
        Threshold { name, label: name, level, color }
    }
}

impl TermSchema {
    /// A cause that can always act, and is shown.
    pub fn new(name: &'static str, label: &'static str, color: Rgb) -> TermSchema {
        TermSchema { name, label, color, has_source: false, can_act: true, is_shown: true }
    }
}

impl ScalarSchema {
    /// A number in a plot of its own.
    pub fn new(name: &'static str, label: &'static str, of: ScalarOf) -> ScalarSchema {
        ScalarSchema { name, label, plot: label, of, is_smooth: of == ScalarOf::State }
    }
}

impl Schema {
    /// Number of vertices of all bodies.
    pub fn vertex_count(&self) -> u64 {
        self.bodies.iter().map(|body| body.vertex_count() as u64).sum()
    }

    /// The name of a pair: `A~B`, in the order of the bodies.
    pub fn pair_name(&self, a: usize, b: usize) -> String {
        format!("{}~{}", self.bodies[a].name, self.bodies[b].name)
    }

    /// An event in words: what, which pair, exactly when, at which q, felt by which step.
    pub fn describe(&self, event: &PairEvent) -> String {
        let pair = self.pair_name(event.a, event.b);
        format!("{} {pair} at t = {:.9} s, q = {:.6}, step {}", event.name, event.time, event.q, event.step)
    }

    /// The different shapes, by name.
    pub fn shapes(&self) -> BTreeMap<&str, &Mesh> {
        self.bodies.iter().map(|body| (body.shape.as_str(), &*body.mesh)).collect()
    }
}

impl BodySchema {
    /// Number of vertices.
    pub fn vertex_count(&self) -> usize {
        self.mesh.vertex_count()
    }

    /// Where its vertices are at rest.
    pub fn rest(&self) -> Rest<'_> {
        self.mesh.at(self.radius)
    }
}

/// Length of an arrow per acceleration [scene unit per scene unit/s²]: 1, 2 or 5 times a power of ten, such that the
/// `strongest` [scene unit/s²] is drawn about 0.4 of `radius` long.
pub fn arrow_scale(radius: f64, strongest: f64) -> f64 {
    let wanted = 0.4 * radius / strongest;
    if !(wanted.is_finite() && wanted > 0.0) {
        return 0.01;
    }
    let decade = 10f64.powf(wanted.log10().floor());
    let step = [5.0, 2.0, 1.0].into_iter().find(|step| step * decade <= wanted * 1.0001).unwrap_or(1.0);
    step * decade
}
