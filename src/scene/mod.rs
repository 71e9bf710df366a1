//! The scene: what is simulated, as typed values.
//!
//! A scene comes from [`Scene::load`] (a file), [`Scene::parse`] (its text) or [`Scene::builtin`] (compiled in), which
//! validate it. A program may change it or build bodies of its own: [`Scene::validate`] checks the same, and a
//! [`World`](crate::World) does so before it starts. Nothing downstream checks again. Two things happen only to scenes from
//! text: bodies inside planes are moved out of them, and `[[edit]]`s are read, which a program cannot make and which hold only
//! for the scene as it was read.
//!
//! # The file
//! TOML. Units are scene units, seconds and radians; defaults are in brackets; unknown keys are errors.
//!
//! ```toml
//! name = "passing"              # [file name without extension]
//! dt = 0.0166666666             # step, s [1/60]
//! duration = 4.0                # s
//! integrator = "exponential"    # thesis | mps | euler | verlet | rk4 | exponential [exponential]
//! tolerance = 1e-6              # acceptable error of exponential, radii/s: it sets the integrator's steps [1e-6]
//! gravity = [0, 0, 0]           # acceleration of free bodies, scene unit/s² [0]
//! model = "oscillators"         # of a soft body: oscillators | metaballs | lattice | fem [oscillators]
//!
//! [material]                    # for all bodies; a body may override each key
//! omega = 12.0                  # restoring force: natural angular frequency, rad/s [12]
//! damping = 1.5                 # 1/s [1.5]
//! response = "inertial"         # to its own motion: rigid | inertial | world [inertial]
//!
//! [influence]
//! alpha = 100.0                 # attraction, 1/s² [100]
//! beta = 60.0                   # repulsion, 1/s² [60]
//! reach = 1.41421356            # radius of influence spheres, in radii of their bodies [√2]
//! weight = "linear"             # linear | wendland [linear]
//! scaling = "relative"          # relative | absolute [relative]
//! merge_at = 1.05               # q, the centre distance over the sum of the radii [1.05]
//! split_at = 1.15               # q [1.15]
//! core_at = 0.0                 # q; 0 = none [0.76 merge_at for pairs with a free body, otherwise 0]
//! core_width = 0.0              # in q: width over which the strength changes around core_at; 0 = it jumps
//!                               # [core_at / 2 for pairs with a free body, otherwise 0]
//! apart = "repel"               # repel | none [repel]
//!
//! [lattice]                     # for model = "lattice"; see crate::models::lattice
//! cells = 6                     # along the diameter of a body [6]
//! tear = "none"                 # none | cut (overstretched springs, with their cells) | split (overloaded nodes) [none]
//! limit = 0.5                   # strain at which it tears [0.5]
//!
//! [fem]                         # for model = "fem"; see crate::models::fem
//! cells = 6                     # along the diameter of a body [6]
//! young = 58.4                  # Young's modulus, mass/(scene unit·s²) [a bar one radius long has frequency omega]
//! poisson = 0.25                # Poisson's ratio [0.25]
//! tear_stress = 20.0            # tension above which tearing is reported, mass/(scene unit·s²) [none]
//!
//! [surface]
//! blend = 0.25                  # distance from a seam within which merged surfaces are smoothed, in radii; 0 = sharp [0.25]
//!
//! [[body]]
//! name = "still"                # unique
//! radius = 1.0                  # scene unit
//! shape = { sphere = { stacks = 12, slices = 24 } }     # 266 vertices [{ sphere = { stacks = 12, slices = 24 } }]
//! # or:   { mesh = "FILE" }                             # OBJ, STL, PLY, glTF or GLB, relative to this file
//! motion = { fixed = [0, 0, 0] }
//!
//! [[body]]
//! name = "passing"
//! radius = 0.8
//! omega = 9.0                   # and damping, response: of this body [as in [material]]
//! reach = 1.2                   # of this body [as in [influence]]
//! motion = { keyframes = [[0, 2.6, 0, 0], [1.5, 1.7, 0, 0], [3.0, 2.6, 0.4, 0]] }
//! # or:    { line = { from = [2.6, 0, 0], velocity = [-0.4, 0, 0] } }
//! # or:    { keyframes = { keys = [[0, 2.6, 0, 0], …], interpolation = "spline" } }   # | linear | hold [spline]
//! # or:    { sine = { center = [2, 0, 0], amplitude = [0.5, 0, 0], frequency = 0.25, phase = 0 } }
//! # or:    { free = { from = [2, 0, 0], velocity = [0, 0, 0], spin = [0, 0, 0], rotation = "free" } }   # | fixed [free]
//! mass = 0.512                  # total; only the mass ratios of free bodies matter [radius³]
//! group = "left"                # for [[pair]]; not the name of a body [none]
//! color = "#ff8800"             # [from the palette]
//!
//! [[grid]]                      # many bodies from one description: all keys of a body, and these
//! name = "drop"                 # the bodies are drop-0-0-0, drop-1-0-0 …
//! count = [10, 10, 2]           # along x, y and z; at most 1,000,000 bodies
//! spacing = [2.5, 2.5, 3.0]     # between neighbours, scene unit
//! jitter = 0.1                  # maximum random offset of each coordinate, scene unit [0]
//! seed = 1                      # of the jitter, an integer [0]
//! radius = 1.0
//! motion = { fixed = [0, 9, 0] }                        # of the first body; the others are offset from it
//!
//! [[pair]]                      # another law for some pairs; missing keys are as in [influence]
//! bodies = ["still", "left"]    # two names of bodies or groups; a pair may be in one such table only
//! merge_at = 0.9                # and split_at, core_at, core_width, alpha, beta, apart
//!
//! [[plane]]                     # acts on the vertices of all bodies
//! normal = [0, 0, 1]            # towards the free side
//! offset = 0.0                  # distance of its points from the origin along the normal, scene unit [0]
//! stiffness = 4000.0            # 1/s² [4000]; beyond (5 omega radius/depth)² vertices may turn a free body inside out
//! friction = 0.0                # [0]
//! slip = 0.01                   # speed below which friction fades, scene unit/s [0.01]
//!
//! [[point]]                     # a force point: an influence sphere without a body (3.1.2); nothing acts on it
//! name = "hand"
//! motion = { line = { from = [0, 3, 0], velocity = [0, -1, 0] } }   # any but free
//! radius = 0.5                  # scene unit; its sphere is as large as that of a body of this radius
//! act = "attract"               # attract (3.4) | repel (3.5)
//! alpha = 100.0                 # of one that attracts; beta of one that repels, 1/s² [as in [influence]]
//! bodies = ["still", "left"]    # names of bodies or groups that it acts on [all]
//! start = 0.0                   # s [0]
//! duration = 2.0                # s [for ever]
//!
//! [[push]]
//! body = "still"
//! direction = [1, 0, 0]
//! strength = 60.0               # scene unit/s²
//! start = 0.2                   # s
//! duration = 0.1                # s
//!
//! [[edit]]                      # from this instant on, other values
//! time = 1.9                    # s
//! set = { "influence.merge_at" = 1.1, "body.still.omega" = 9.0 }   # numbers of influence, material, gravity, of a
//!                               # body (omega, damping, reach), grid, pair, plane or point; keys as for --set
//!                               # an edit of material or influence leaves alone what a body or pair has of its own
//! ```
//!
//! The table of all keys, from which they are parsed, is [`keys`]; `meldscope reference scene` prints it.
//!
//! # Shapes from files
//! A mesh must be the surface of a body: closed, consistently oriented, manifold, its triangles counter-clockwise seen
//! from outside; [`crate::geometry::files`] lists what is read from each format. Vertices at the same position are
//! welded. The mesh is centred at its mass centre (the mass of a vertex is a third of the area of its triangles) and
//! scaled so that its farthest vertex is `radius` away. A surface that crosses or touches itself is rejected.
//!
//! The file may be anywhere, but must be a regular file of at most 1 GiB. Replaying a recording reads no mesh files:
//! [`Scene::source`], which recordings store, contains the meshes:
//!
//! ```toml
//! [[mesh]]
//! file = "blob.obj"             # the name that bodies use for it; no file is read
//! data = "AQQ…"                 # see crate::geometry::files::embedded
//! ```
//!
//! # Keyframes
//! A `spline` is smooth (its acceleration is continuous) and at rest at the first and the last key; therefore it
//! overshoots where keys change direction. Through 0, 1 and 1 at 0, 1 and 2 s it follows 1 + ¾ s (1 − s)² between the
//! last two, where s is the time since the second: it reaches 10/9 at 4/3 s. Where a body must stay within its keys,
//! use straight lines (`linear`) or jumps (`hold`).
//!
//! At a `linear` key the velocity of the centre jumps by some Δv, an impulse. Vertices of a body whose response is
//! `inertial` or `world` keep their world velocity: relative to the centre it jumps by −Δv. Vertices of a `rigid` body
//! are not affected. At t = 0 all velocities are zero, however the path begins. At a `hold` key the vertices move with
//! the centre; their displacements and velocities do not change. Pairs change phase at the jump, by the distance after
//! it; a jump from outside merge_at into a core is a merge and a core event at the same instant.

pub mod builtin;
pub mod cells;
mod edit;
mod force;
pub mod keys;
pub mod numbers;
pub mod pairs;
pub mod parse;
pub mod path;
mod point;
mod push_out;
mod source;
pub mod template;
mod validate;
mod warnings;

use std::fmt;

use glam::DVec3;

use crate::{
    geometry::Shape,
    model::{
        ForFree, PairLaw,
        influence::Influence,
        oscillator::Oscillator,
        phase::{Phase, Thresholds},
    },
};

pub use crate::model::shape_matching::{Plane, Rotation};
pub use cells::TearMode;
pub use edit::Edit;
pub(crate) use edit::{Numbers, ROUNDING};
pub use force::Force;
pub use pairs::{Members, PairLaws};
pub use parse::SceneError;
pub use path::Path;
pub use point::Point;
pub use push_out::PushedOut;
pub use validate::InvalidScene;

/// A scene as its file describes it: bodies, the law between them, planes, force points, pushes.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Name of the scene, of its recording and of its default output file.
    pub name: String,
    /// Step Δt [s], > 0.
    pub dt: f64,
    /// Simulated time [s], > 0. See [`Scene::steps`].
    pub duration: f64,
    /// Integrator of the scene.
    pub integrator: Integrator,
    /// Model of a soft body; decides which simulation runs the scene, see [`crate::models`].
    pub model: Model,
    /// Settings of [`Model::Lattice`].
    pub lattice: cells::Lattice,
    /// Settings of [`Model::Fem`].
    pub fem: cells::Fem,
    /// Tolerance of [`Integrator::Exponential`]: the acceptable error, in radii of a vertex's body per unit of scene
    /// time [1/s], > 0.
    pub tolerance: f64,
    /// The influence law: (3.3)–(3.5) and their constants.
    pub influence: Influence,
    /// When pairs merge, split and enter their core.
    pub thresholds: Thresholds,
    /// Width in q over which the strength changes at the rim of the core [–]; 0 for a jump.
    pub core_width: f64,
    /// Which settings of the core apply only to pairs with a free body.
    pub for_free: ForFree,
    /// The laws of pairs that have their own; see [`Scene::law`].
    pub pairs: PairLaws,
    /// Acceleration of free bodies [scene unit/s²].
    pub gravity: DVec3,
    /// The planes, in the order of the file. They act on every vertex of every body.
    pub planes: Vec<Plane>,
    /// Distance from a seam within which merged surfaces are smoothed [radii of the smaller body]; 0 for sharp seams.
    pub blend: f64,
    /// The bodies: at least one, with unique names.
    pub bodies: Vec<Body>,
    /// The force points, in the order of the file.
    pub points: Vec<Point>,
    /// The pushes, in the order of the file.
    pub pushes: Vec<Push>,
    /// The edits, in order of time. A world enters them on its way; its scene is then the edited one.
    pub edits: Vec<Edit>,
    /// The text that this scene was parsed from. Recordings store it, so that the scene can be created again.
    pub source: String,
    /// Values that replace those of the text; see [`Scene::with`].
    pub set: Vec<template::Override>,
    /// The free bodies that were moved, as the file places them so deep in a plane that it would throw them out.
    pub pushed_out: Vec<PushedOut>,
}

/// A soft body: a shape whose vertices are damped oscillators about their rest positions.
#[derive(Clone, Debug)]
pub struct Body {
    /// Name of the body, unique in the scene; letters, digits, `-` and `_`.
    pub name: String,
    /// Radius R [scene unit], > 0.
    pub radius: f64,
    /// Radius of its influence sphere over R, r_e / R [–], > 0.
    pub reach: f64,
    /// Constants of the oscillators.
    pub material: Material,
    /// The rest shape, of unit radius.
    pub shape: Shape,
    /// Total mass, > 0, distributed over the vertices by surface area. Any unit; only ratios matter.
    pub mass: f64,
    /// Group of the body, if any; pairs of groups can have their own law.
    pub group: Option<String>,
    /// Colour, if the scene gives one: red, green, blue.
    pub color: Option<[u8; 3]>,
    /// What moves the centre.
    pub motion: Motion,
    /// A force set by a program, on a free body only.
    pub force: Option<Force>,
}

impl Body {
    /// A sphere of 266 vertices and this radius [scene unit], with the oscillators, mass and colour of a body in a scene
    /// file that gives nothing else.
    ///
    /// ```
    /// use glam::DVec3;
    /// use meldscope::scene::{Body, Path};
    ///
    /// let body = Body { mass: 2.0, ..Body::new("ball", 1.0, Path::Fixed(DVec3::ZERO)) };
    /// # assert_eq!(body.shape.vertex_count(), 266);
    /// ```
    pub fn new(name: impl Into<String>, radius: f64, motion: impl Into<Motion>) -> Body {
        Body {
            name: name.into(),
            radius,
            reach: std::f64::consts::SQRT_2,
            material: Material::default(),
            shape: Shape::default(),
            mass: radius * radius * radius,
            group: None,
            color: None,
            motion: motion.into(),
            force: None,
        }
    }

    /// The path of the centre, if it is prescribed.
    pub fn path(&self) -> Option<&Path> {
        match &self.motion {
            Motion::Prescribed(path) => Some(path),
            Motion::Free(_) => None,
        }
    }

    /// The radius r_e of its influence sphere [scene unit].
    pub fn sphere_radius(&self) -> f64 {
        self.reach * self.radius
    }
}

/// What moves the centre of a body.
#[derive(Clone, Debug, PartialEq)]
pub enum Motion {
    /// A path, regardless of forces.
    Prescribed(Path),
    /// The forces that act on the body.
    Free(FreeMotion),
}

impl Motion {
    /// Position of the centre at t = 0 [scene unit].
    pub fn start(&self) -> DVec3 {
        match self {
            Motion::Prescribed(path) => path.position(0.0),
            Motion::Free(free) => free.from,
        }
    }

    /// The same motion, moved by `offset` [scene unit].
    pub fn moved_by(&self, offset: DVec3) -> Motion {
        match self {
            Motion::Prescribed(path) => Motion::Prescribed(path.moved_by(offset)),
            Motion::Free(free) => Motion::Free(FreeMotion { from: free.from + offset, ..*free }),
        }
    }
}

impl From<Path> for Motion {
    fn from(path: Path) -> Motion {
        Motion::Prescribed(path)
    }
}

impl From<FreeMotion> for Motion {
    fn from(free: FreeMotion) -> Motion {
        Motion::Free(free)
    }
}

/// How a free body starts, and whether it rotates. Its response is [`Response::Inertial`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FreeMotion {
    /// Mass centre at t = 0 [scene unit].
    pub from: DVec3,
    /// Velocity of the mass centre at t = 0 [scene unit/s].
    pub velocity: DVec3,
    /// Angular velocity at t = 0 [rad/s].
    pub spin: DVec3,
    /// Whether the rest shape rotates with the vertices.
    pub rotation: Rotation,
}

impl FreeMotion {
    /// A body that may rotate, at rest at `from` [scene unit].
    pub fn at(from: DVec3) -> FreeMotion {
        FreeMotion { from, velocity: DVec3::ZERO, spin: DVec3::ZERO, rotation: Rotation::Free }
    }
}

/// Constants of the damped oscillator (3.2), and the response of a body to its own motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Natural angular frequency ω of the restoring force [rad/s], ≥ 0 (thesis: w).
    pub omega: f64,
    /// Damping rate κ [1/s], ≥ 0 (thesis: k).
    pub damping: f64,
    /// The effect of the body's own motion on its vertices.
    pub response: Response,
}

impl Material {
    /// The oscillators of its vertices.
    #[inline]
    pub fn oscillator(&self) -> Oscillator {
        Oscillator { omega: self.omega, damping: self.damping }
    }
}

impl Default for Material {
    /// That of scene files which give none.
    fn default() -> Material {
        Material { omega: 12.0, damping: 1.5, response: Response::Inertial }
    }
}

/// Response of a body to its own motion: the `carry` that is subtracted from the acceleration in body coordinates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Response {
    /// Carry 0: the rest shape moves along, without inertia.
    Rigid,
    /// Carry c″: the body wobbles when its centre accelerates.
    Inertial,
    /// Carry c″ + 2κ c′: damping acts on world velocity, as (3.8) reads in world coordinates.
    World,
}

/// A push (Fig. 4.1): vertices that face it accelerate along `direction` by `strength · max(0, −l̂·direction)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Push {
    /// Index into [`Scene::bodies`].
    pub body: usize,
    /// Direction of the push, a unit vector.
    pub direction: DVec3,
    /// Strength of the push [scene unit/s²].
    pub strength: f64,
    /// Start of the push [s], ≥ 0.
    pub start: f64,
    /// Duration of the push [s], ≥ 0; it acts during [start, start + duration).
    pub duration: f64,
}

impl Push {
    /// The end of the push, exclusive [s].
    pub fn end(&self) -> f64 {
        self.start + self.duration
    }

    /// Whether it acts at `t` [s].
    pub fn acts_at(&self, t: f64) -> bool {
        self.start <= t && t < self.end()
    }
}

named! {
    /// Time integration schemes; see [`crate::sim::integrator`] for what each does.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
    pub enum Integrator {
        /// (3.6)–(3.10) exactly as printed: advances the position twice per step and converges to the wrong equation.
        Thesis = "thesis",
        /// The prediction–correction that the thesis builds on: consistent, first order.
        Mps = "mps",
        /// Semi-implicit (symplectic) Euler, first order.
        Euler = "euler",
        /// Velocity Verlet with symmetric damping, second order.
        Verlet = "verlet",
        /// Classical Runge–Kutta, fourth order between phase switches.
        Rk4 = "rk4",
        /// Exact oscillator flow with φ-functions for the force: fifth order, with error control and located jumps.
        Exponential = "exponential",
    }
}

impl fmt::Display for Integrator {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

named! {
    /// Models of a soft body: the thesis's own, and those discussed in its chapter 2; see [`crate::models`].
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
    pub enum Model {
        /// The thesis's model: every vertex is a damped oscillator about its rest position.
        #[default]
        Oscillators = "oscillators",
        /// A density around each centre, with a level set as the surface (2.2.3).
        Metaballs = "metaballs",
        /// Cubes of masses and springs (2.1.1, 2.2.2).
        Lattice = "lattice",
        /// Linear finite elements (2.1.2).
        Fem = "fem",
    }
}

impl fmt::Display for Model {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl Scene {
    /// The tolerance of scenes that do not set one [1/s].
    pub const DEFAULT_TOLERANCE: f64 = 1e-6;

    /// Number of steps: `round(duration / dt)`.
    pub fn steps(&self) -> u64 {
        (self.duration / self.dt).round() as u64 // saturates
    }

    /// The same scene without any force: pairs on the same paths, with the same thresholds, change phase at the same
    /// times, and nothing else happens.
    pub fn without_forces(&self) -> Scene {
        let influence = Influence { alpha: 0.0, beta: 0.0, ..self.influence };
        let rigid =
            |body: &Body| Body { material: Material { response: Response::Rigid, ..body.material }, ..body.clone() };
        Scene {
            influence,
            core_width: 0.0,
            pairs: self.pairs.without_forces(),
            gravity: DVec3::ZERO,
            planes: Vec::new(),
            points: Vec::new(),
            pushes: Vec::new(),
            bodies: self.bodies.iter().map(rigid).collect(),
            ..self.clone()
        }
    }

    /// The law of the pair of bodies `a` and `b`, in either order.
    ///
    /// # Panics
    /// It may if there are no such bodies.
    pub fn law(&self, a: usize, b: usize) -> PairLaw {
        self.law_at(self.law_index(a, b))
    }

    /// The law of all pairs that do not have their own; see [`PairLaw::of_pair`].
    pub fn common_law(&self) -> PairLaw {
        edit::common_law(&self.influence, self.thresholds, self.core_width, self.for_free)
    }

    /// Every law that a pair can have.
    pub fn laws(&self) -> impl Iterator<Item = PairLaw> + '_ {
        let all = std::iter::once(self.common_law()).chain(self.pairs.laws().iter().copied());
        all.flat_map(|law| {
            let others = (law.for_free != ForFree::Nothing).then(|| law.of_pair(false));
            std::iter::once(law.of_pair(true)).chain(others)
        })
    }

    /// Whether all pairs have the same law.
    pub fn has_one_law(&self) -> bool {
        let on_paths = self.bodies.iter().filter(|body| body.path().is_some()).count();
        self.pairs.is_empty() && (self.for_free == ForFree::Nothing || on_paths < 2)
    }

    /// Whether a pair has a free body.
    pub(super) fn has_free(&self, a: usize, b: usize) -> bool {
        [a, b].into_iter().any(|body| self.bodies[body].path().is_none())
    }

    /// A number that stands for a pair's law; see [`Scene::law_at`].
    pub fn law_index(&self, a: usize, b: usize) -> u32 {
        let own = self.pairs.index(a, b).map_or(0, |index| index as u32 + 1);
        2 * own + u32::from(self.has_free(a, b))
    }

    /// The law with the number [`Scene::law_index`].
    #[inline]
    pub fn law_at(&self, index: u32) -> PairLaw {
        let own = (index / 2).checked_sub(1);
        own.map_or_else(|| self.common_law(), |own| self.pairs.laws()[own as usize]).of_pair(index % 2 == 1)
    }

    /// Takes back what pairs with a free body have of a core by default: recordings made before there were such defaults
    /// replay as they were made.
    pub(crate) fn drop_core_defaults(&mut self) {
        let law = self.common_law().of_pair(false);
        (self.thresholds, self.core_width, self.for_free) = (law.thresholds, law.core_width, law.for_free);
        self.pairs.drop_core_defaults();
    }

    /// Signed strength s with which a source acts on a body in a given phase of their pair [1/s²]: positive attracts
    /// (3.4), negative repels (3.5).
    ///
    /// `radius` is the radius of the body acted on and `source_radius` that of the source [scene unit]. Ignores
    /// [`Scene::core_width`]: only coupled scenes have cores with a gradual rim.
    pub fn strength(&self, law: &PairLaw, phase: Phase, radius: f64, source_radius: f64) -> f64 {
        law.strength(phase, law.thresholds.merge_at) * self.influence.scale(radius, source_radius)
    }

    /// Whether the scene needs the coupled solver: there is a free body, a plane, or a core with a gradual rim, now or
    /// after an edit.
    pub fn is_coupled(&self) -> bool {
        self.is_coupled_without(self.bodies.len())
    }

    /// Whether it is coupled if it has not this body.
    pub(crate) fn is_coupled_without(&self, index: usize) -> bool {
        let mut others = self.bodies.iter().enumerate().filter(|(other, _)| *other != index);
        !self.planes.is_empty()
            || others.any(|(_, body)| body.path().is_none())
            || self.laws().any(|law| law.core_width > 0.0)
            || self.becomes_coupled()
    }

    /// Total number of vertices of all bodies.
    pub fn vertex_count(&self) -> u64 {
        self.bodies.iter().map(|body| body.shape.vertex_count()).sum()
    }
}
