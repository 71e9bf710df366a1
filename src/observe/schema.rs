//! The schema of a simulation: everything about it that does not change during a run.

use std::{collections::BTreeMap, fmt, sync::Arc};

use glam::{DQuat, DVec3};

use super::{event::PairEvent, surface::Surfaces};
use crate::{
    colors::Rgb,
    geometry::{Mesh, Rest, fairing},
    text::change,
};

/// The schema of a simulation. Frames refer to its entries by index.
#[derive(Clone, Debug)]
pub struct Schema {
    /// Name of the scene, of its recording and of its default output file.
    pub name: String,
    /// The text from which the simulation was created. A recording contains it, so that the run can be reproduced.
    pub source: String,
    /// Further settings needed to reproduce the run, as lines of TOML. A recording contains these too.
    pub run: String,
    /// Name of the soft-body model, as one word; may be empty if the simulation has only one.
    pub model: String,
    /// Name of the integrator, as one word.
    pub integrator: String,
    /// Step Δt [s], > 0.
    pub dt: f64,
    /// Number of steps that the scene asks for.
    pub steps: u64,
    /// Acceptable error [radii per unit of scene time].
    pub tolerance: f64,
    /// Description of the interaction between bodies, as Markdown.
    pub law: String,
    /// The work that the simulation follows, for the panel; empty if there is none.
    pub credit: &'static str,
    /// Distance from a seam within which merged surfaces are smoothed [radii of the smaller body]; 0 for sharp seams.
    pub blend: f64,
    /// The bodies: at least one, with unique names.
    pub bodies: Vec<BodySchema>,
    /// The variants of one scene that run side by side, if it is several: each has as many bodies, one variant's after the
    /// other's.
    pub variants: Vec<VariantSchema>,
    /// The direction that views show upwards: the positive or negative direction of an axis.
    pub up: DVec3,
    /// Planes that bodies cannot pass.
    pub planes: Vec<PlaneSchema>,
    /// Length per acceleration of the net force arrows of free bodies [scene unit per scene unit/s²].
    pub net_force_scale: f64,
    /// Influence spheres without a body.
    pub points: Vec<PointSchema>,
    /// Later influence spheres and planes, in order of time; none if they do not change.
    pub changes: Vec<SchemaChange>,
    /// What the scene says about instants of a run, in order of time; none at the start.
    pub scheduled: Vec<Scheduled>,
    /// Force terms that accelerate vertices, in any order.
    pub terms: Vec<TermSchema>,
    /// Texts of [`BodyFrame::labels`](super::BodyFrame::labels). The first one is for vertices on which no force acts.
    pub labels: Vec<&'static str>,
    /// Arrow length per acceleration [scene unit per scene unit/s²], except of terms with their own.
    pub arrow_scale: f64,
    /// Phases of a pair, from the weakest interaction to the strongest.
    pub phases: Vec<PhaseSchema>,
    /// Kinds of events of pairs.
    pub events: Vec<EventSchema>,
    /// Levels of q at which a pair changes phase. At the first level, it leaves its first phase.
    pub thresholds: Vec<Threshold>,
    /// Levels for pairs with their own thresholds.
    pub own_levels: OwnLevels,
    /// The surfaces of groups, if they are not the unions of their bodies.
    pub surfaces: OwnSurfaces,
    /// Scalars plotted over time.
    pub scalars: Vec<ScalarSchema>,
    /// Scalars of the state that each body has: see [`Frame::body_scalars`](super::Frame::body_scalars).
    pub body_scalars: Vec<ScalarSchema>,
    /// Scalars of the state that each pair of [`Frame::pairs`](super::Frame::pairs) has: see
    /// [`Frame::pair_scalars`](super::Frame::pair_scalars).
    pub pair_scalars: Vec<ScalarSchema>,
    /// Stages of a step whose duration is measured, in order.
    pub stages: Vec<&'static str>,
    /// Warnings about the scene, one sentence each.
    pub warnings: Vec<String>,
}

/// One of several variants of a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct VariantSchema {
    /// Its name, as one word. The names of its bodies begin with it and a hyphen.
    pub name: &'static str,
    /// Where its name stands [scene unit].
    pub heading: DVec3,
}

/// What a scene changes at an instant, such as the start of a push.
#[derive(Clone, Debug, PartialEq)]
pub struct Scheduled {
    /// The instant [s].
    pub time: f64,
    /// What it is, in a few words.
    pub text: String,
}

impl Scheduled {
    /// How the text of an edit begins, which changes the scene itself.
    pub(crate) const EDIT: &str = "edit: ";
}

/// Influence spheres and planes from an instant on.
#[derive(Clone, Debug)]
pub struct SchemaChange {
    /// They hold in states after this instant [s].
    pub after: f64,
    /// Radius of the influence sphere of each body [scene unit].
    pub reaches: Vec<f64>,
    /// The planes, as many as before.
    pub planes: Vec<PlaneSchema>,
}

/// A force point: an influence sphere without a body.
#[derive(Clone, Debug)]
pub struct PointSchema {
    /// Its name, and what it does.
    pub label: String,
    /// Colour of its sphere.
    pub color: Rgb,
    /// Where its sphere is.
    pub sphere: SphereAt,
}

/// Centre and radius of an influence sphere at a time [s, scene unit]; none while it does not act.
#[derive(Clone)]
pub struct SphereAt(Arc<SphereOf>);

type SphereOf = dyn Fn(f64) -> Option<(DVec3, f64)> + Send + Sync;

impl SphereAt {
    /// A sphere by a function of time.
    pub fn new(of: impl Fn(f64) -> Option<(DVec3, f64)> + Send + Sync + 'static) -> SphereAt {
        SphereAt(Arc::new(of))
    }

    /// The sphere at `time` [s].
    pub fn at(&self, time: f64) -> Option<(DVec3, f64)> {
        (self.0)(time)
    }
}

impl fmt::Debug for SphereAt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("SphereAt(…)")
    }
}

/// A body of a simulation.
#[derive(Clone, Debug)]
pub struct BodySchema {
    /// Unique name; letters, digits, `-` and `_`.
    pub name: String,
    /// Distance from the centre to the farthest vertex at rest [scene unit], > 0. Errors are measured in this unit.
    pub radius: f64,
    /// Radius of the influence sphere, within which the body acts on others [scene unit]; 0 if it acts on none.
    pub reach: f64,
    /// Name of its shape: letters, digits, `-` and `_`. Bodies with the same shape name have the same mesh.
    pub shape: String,
    /// Mesh at rest, scaled to radius 1. It is drawn as a smooth surface, or with flat faces if it is
    /// [faceted](Mesh::faceted).
    pub mesh: Arc<Mesh>,
    /// Whether forces move and rotate it; otherwise its path is prescribed.
    pub is_free: bool,
    /// Total mass of its vertices, > 0; only mass ratios matter.
    pub mass: f64,
    /// Colour of its surface, if it has one of its own.
    pub color: Option<Rgb>,
    /// Whether its mesh may differ from `mesh` in some frames; see [`BodyFrame::mesh`](super::BodyFrame::mesh).
    pub can_tear: bool,
    /// Whether it comes or goes during the run; see [`BodyFrame::is_absent`](super::BodyFrame::is_absent).
    pub can_be_absent: bool,
    /// Whether frames with forces have its springs; see [`BodyFrame::springs`](super::BodyFrame::springs).
    pub has_springs: bool,
}

/// A plane that bodies cannot pass.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaneSchema {
    /// Unit normal, towards the free side.
    pub normal: DVec3,
    /// normal · r for any point r of the plane [scene unit].
    pub offset: f64,
    /// Coefficient of friction [–].
    pub friction: f64,
}

/// A force term: one cause of acceleration.
#[derive(Clone, Debug)]
pub struct TermSchema {
    /// Name of its entity: letters, digits, `-` and `_`.
    pub name: &'static str,
    /// Display name.
    pub label: &'static str,
    /// Colour of its arrows.
    pub color: Rgb,
    /// Whether other bodies cause it. If so, each arrow names its source.
    pub has_source: bool,
    /// Whether it can act in this scene.
    pub can_act: bool,
    /// Whether its arrows are visible when the recording is opened.
    pub is_shown: bool,
    /// Whether it is the sum of all others, which at most one is. Without one, the net force of a vertex is that sum.
    pub is_sum: bool,
    /// Whether it accelerates all vertices of a body equally: one arrow at the centre represents them all.
    pub is_uniform: bool,
    /// Length of its arrows per acceleration [scene unit per scene unit/s²], if it is usually much stronger or weaker
    /// than the others.
    pub arrow_scale: Option<f64>,
}

/// A phase of a pair of bodies.
#[derive(Clone, Debug)]
pub struct PhaseSchema {
    /// Name, as one word.
    pub name: &'static str,
    /// Colour of its lanes, lines and spheres.
    pub color: Rgb,
    /// Whether two bodies in this phase count as one: bodies connected by such pairs form a group, with one surface.
    pub is_joined: bool,
}

/// A kind of event of a pair.
#[derive(Clone, Copy, Debug)]
pub struct EventSchema {
    /// The name of its events: one word, or several that begin with that of a related kind.
    pub name: &'static str,
    /// When it happens, as a sentence.
    pub about: &'static str,
}

/// A level of q at which a pair changes phase.
#[derive(Clone, Debug)]
pub struct Threshold {
    /// Name of its entity.
    pub name: &'static str,
    /// Display name.
    pub label: &'static str,
    /// Level of q [–]; see [`Schema::level`].
    pub level: f64,
    /// Colour of its line.
    pub color: Rgb,
}

/// Levels of q for pairs with their own thresholds, by threshold and pair, or levels that change during the run; none by
/// default.
#[derive(Clone, Default)]
pub struct OwnLevels {
    of: Option<Arc<LevelOf>>,
    is_changing: bool,
}

type LevelOf = dyn Fn(usize, [usize; 2], f64) -> Option<f64> + Send + Sync;

impl OwnLevels {
    /// The level of a threshold, given its index and the indices of two bodies: `None` if the pair does not have it.
    pub fn new(of: impl Fn(usize, usize, usize) -> Option<f64> + Send + Sync + 'static) -> OwnLevels {
        OwnLevels { of: Some(Arc::new(move |threshold, [a, b], _| of(threshold, a, b))), is_changing: false }
    }

    /// Like [`OwnLevels::new`] for levels that also depend on the time [s].
    pub fn changing(of: impl Fn(usize, [usize; 2], f64) -> Option<f64> + Send + Sync + 'static) -> OwnLevels {
        OwnLevels { of: Some(Arc::new(of)), is_changing: true }
    }

    /// Whether levels change during the run.
    pub fn is_changing(&self) -> bool {
        self.is_changing
    }
}

impl fmt::Debug for OwnLevels {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if self.of.is_some() { "OwnLevels(…)" } else { "OwnLevels" })
    }
}

/// The surfaces of groups, if the simulation defines them; by default they are the unions of their bodies.
#[derive(Clone, Default)]
pub struct OwnSurfaces(Option<Arc<dyn Surfaces>>);

impl OwnSurfaces {
    /// Replaces the unions with these surfaces.
    pub fn new(surfaces: impl Surfaces + 'static) -> OwnSurfaces {
        OwnSurfaces(Some(Arc::new(surfaces)))
    }

    /// The definition, if there is one.
    pub fn get(&self) -> Option<&dyn Surfaces> {
        self.0.as_deref()
    }
}

impl fmt::Debug for OwnSurfaces {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if self.0.is_some() { "OwnSurfaces(…)" } else { "OwnSurfaces" })
    }
}

/// A scalar plotted over time.
#[derive(Clone, Debug)]
pub struct ScalarSchema {
    /// Name of its entity.
    pub name: &'static str,
    /// Display name with its unit.
    pub label: &'static str,
    /// Name of the plot that shows it.
    pub plot: &'static str,
    /// Whether it describes the state or a step, and how a frame aggregates it over steps.
    pub of: ScalarOf,
    /// Whether it varies continuously: its line interpolates between values instead of holding each value.
    pub is_smooth: bool,
    /// The smallest range of values that its plot shows, in its unit. Without one, a plot of a conserved quantity shows
    /// rounding errors as if they were changes.
    pub least_range: f64,
    /// Colour of its line; any if there is none.
    pub color: Option<Rgb>,
}

/// How a scalar of a frame is obtained.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ScalarOf {
    /// From the state: its value is part of the frame.
    State,
    /// From every step: a frame shows the sum over all steps since the previous frame.
    SumOfSteps,
    /// From every step: a frame shows the maximum over all steps since the previous frame.
    MaxOfSteps,
}

impl Default for Schema {
    /// An empty scene at 60 steps per second.
    fn default() -> Schema {
        Schema {
            name: String::new(),
            source: String::new(),
            run: String::new(),
            model: String::new(),
            integrator: String::new(),
            dt: 1.0 / 60.0,
            steps: 0,
            tolerance: 1e-6,
            law: String::new(),
            credit: "",
            blend: fairing::BLEND,
            bodies: Vec::new(),
            variants: Vec::new(),
            up: DVec3::Z,
            planes: Vec::new(),
            points: Vec::new(),
            changes: Vec::new(),
            scheduled: Vec::new(),
            net_force_scale: 0.01,
            terms: Vec::new(),
            labels: Vec::new(),
            arrow_scale: 0.01,
            phases: Vec::new(),
            events: Vec::new(),
            thresholds: Vec::new(),
            own_levels: OwnLevels::default(),
            surfaces: OwnSurfaces::default(),
            scalars: Vec::new(),
            body_scalars: Vec::new(),
            pair_scalars: Vec::new(),
            stages: Vec::new(),
            warnings: Vec::new(),
        }
    }
}

impl BodySchema {
    /// A body on a prescribed path. `radius` is the distance of its farthest vertex, `reach` the radius of its
    /// influence sphere [scene unit].
    pub fn new(name: &str, shape: &str, mesh: Arc<Mesh>, radius: f64, reach: f64) -> BodySchema {
        let (name, shape) = (name.to_owned(), shape.to_owned());
        BodySchema {
            name,
            radius,
            reach,
            shape,
            mesh,
            is_free: false,
            mass: 1.0,
            color: None,
            can_tear: false,
            can_be_absent: false,
            has_springs: false,
        }
    }
}

impl From<(&'static str, Rgb)> for PhaseSchema {
    /// A phase in which the bodies remain separate.
    fn from((name, color): (&'static str, Rgb)) -> PhaseSchema {
        PhaseSchema { name, color, is_joined: false }
    }
}

impl From<(&'static str, &'static str)> for EventSchema {
    fn from((name, about): (&'static str, &'static str)) -> EventSchema {
        EventSchema { name, about }
    }
}

impl From<(&'static str, f64, Rgb)> for Threshold {
    fn from((name, level, color): (&'static str, f64, Rgb)) -> Threshold {
        Threshold { name, label: name, level, color }
    }
}

/// An event and its pair in words. After a name of several words stands a colon: the pair could seem to belong to it.
pub(crate) fn titled(event: &str, pair: &str) -> String {
    let colon = if event.contains(' ') { ":" } else { "" };
    format!("{event}{colon} {pair}")
}

impl TermSchema {
    /// A force term that can always act and is visible.
    pub fn new(name: &'static str, label: &'static str, color: Rgb) -> TermSchema {
        TermSchema {
            name,
            label,
            color,
            has_source: false,
            can_act: true,
            is_shown: true,
            is_sum: false,
            is_uniform: false,
            arrow_scale: None,
        }
    }
}

impl ScalarSchema {
    /// A scalar with a plot of its own.
    pub fn new(name: &'static str, label: &'static str, of: ScalarOf) -> ScalarSchema {
        ScalarSchema { name, label, plot: label, of, is_smooth: of == ScalarOf::State, least_range: 0.0, color: None }
    }
}

impl Schema {
    /// Total number of vertices of all bodies.
    pub fn vertex_count(&self) -> u64 {
        self.bodies.iter().map(|body| body.vertex_count() as u64).sum()
    }

    /// The model; `None` for the default (oscillators, or a simulation's only model), which messages omit.
    pub fn non_default_model(&self) -> Option<&str> {
        Some(self.model.as_str()).filter(|model| !["", "oscillators"].contains(model))
    }

    /// The model and the integrator for a message, such as " with lattice, euler"; empty if they have no names.
    pub fn method(&self) -> String {
        let names = [self.non_default_model().unwrap_or_default(), &self.integrator];
        let names: Vec<&str> = names.into_iter().filter(|name| !name.is_empty()).collect();
        if names.is_empty() { String::new() } else { format!(" with {}", names.join(", ")) }
    }

    /// Number of bodies of a variant; of all, if there are no variants.
    pub fn variant_size(&self) -> usize {
        (self.bodies.len() / self.variants.len().max(1)).max(1)
    }

    /// The name of a body within its variant.
    pub fn plain_name(&self, body: usize) -> &str {
        let name = self.bodies[body].name.as_str();
        let variant = self.variants.get(body / self.variant_size());
        variant.and_then(|variant| name.strip_prefix(variant.name)?.strip_prefix('-')).unwrap_or(name)
    }

    /// The rotation from the axes of the scene to those of views, in which z is up; the identity if it is in both.
    pub fn upright(&self) -> DQuat {
        DQuat::from_rotation_arc(self.up, DVec3::Z)
    }

    /// The place at this height [scene unit] straight above or below another.
    pub fn raised(&self, place: DVec3, height: f64) -> DVec3 {
        place + (height - place.dot(self.up)) * self.up
    }

    /// The largest radius of a body [scene unit].
    pub fn largest_radius(&self) -> f64 {
        self.bodies.iter().map(|body| body.radius).fold(0.0, f64::max)
    }

    /// The index of the body with this name.
    pub fn body(&self, name: &str) -> Option<usize> {
        self.bodies.iter().position(|body| body.name == name)
    }

    /// The index of the term that is the sum of the others, if there is one.
    pub fn sum_of_terms(&self) -> Option<usize> {
        self.terms.iter().position(|term| term.is_sum)
    }

    /// Name of a pair: `A~B`, in the order of the bodies.
    pub fn pair_name(&self, a: usize, b: usize) -> String {
        format!("{}~{}", self.bodies[a].name, self.bodies[b].name)
    }

    /// Arrow length per acceleration of a term [scene unit per scene unit/s²].
    pub fn arrow_scale_of(&self, term: &TermSchema) -> f64 {
        term.arrow_scale.unwrap_or(self.arrow_scale)
    }

    /// The change that holds at `time` [s], if any.
    fn change(&self, time: f64) -> Option<&SchemaChange> {
        self.changes.iter().rev().find(|change| change.after < time)
    }

    /// Radius of a body's influence sphere at `time` [s, scene unit].
    pub fn reach(&self, body: usize, time: f64) -> f64 {
        self.change(time).map_or(self.bodies[body].reach, |change| change.reaches[body])
    }

    /// The planes at `time` [s].
    pub fn planes(&self, time: f64) -> &[PlaneSchema] {
        self.change(time).map_or(&self.planes, |change| &change.planes)
    }

    /// The level of threshold `index` for a pair at `time` [s, –]; `None` if the pair does not have this threshold.
    pub fn level(&self, index: usize, [a, b]: [usize; 2], time: f64) -> Option<f64> {
        match &self.own_levels.of {
            Some(own) => own(index, [a, b], time),
            None => self.thresholds.get(index).map(|threshold| threshold.level),
        }
    }

    /// Describes an event in words: kind, pair, exact time, q, and the first affected step.
    pub fn describe(&self, event: &PairEvent) -> String {
        let pair = self.pair_name(event.a, event.b);
        let energy = event.energy.filter(|&energy| energy != 0.0);
        let energy = energy.map_or_else(String::new, |energy| format!(", energy {}", change(energy)));
        let PairEvent { name, time, q, step, .. } = event;
        format!("{} at t = {time:.9} s, q = {q:.6}, step {step}{energy}", titled(name, &pair))
    }

    /// The words that select events of pairs: the first word of each kind.
    pub fn event_words(&self) -> Vec<&'static str> {
        let mut words: Vec<_> = self.events.iter().filter_map(|event| event.name.split(' ').next()).collect();
        words.dedup();
        words
    }

    /// The distinct shapes, by name.
    pub fn shapes(&self) -> BTreeMap<&str, &Mesh> {
        self.bodies.iter().map(|body| (body.shape.as_str(), &*body.mesh)).collect()
    }
}

impl BodySchema {
    /// Number of vertices of the body.
    pub fn vertex_count(&self) -> usize {
        self.mesh.vertex_count()
    }

    /// Rest positions of its vertices.
    pub fn rest(&self) -> Rest<'_> {
        self.mesh.at(self.radius)
    }
}
