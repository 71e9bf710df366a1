//! The keys of a scene file: the one table from which they are parsed, documented and suggested.
//!
//! A new key is a line here, and the line of [`parse`](super::parse) that reads it.

use std::{f64::consts::SQRT_2, sync::LazyLock};

use glam::DVec3;

use super::{Integrator, Model, Response, Rotation, Scene, TearMode, cells, parse::reader::is_body_name, path::Spline};
use crate::{
    geometry::{Shape, fairing, shape},
    model::{
        PairLaw,
        influence::{Scaling, Weight},
    },
};

/// A table of a file, and the keys that it accepts.
#[derive(Debug)]
pub struct Section {
    /// Its header, such as `[influence]` or `[[body]]`; or what it is the value of, such as `motion = { line = { … } }`;
    /// empty for the top of the file.
    pub header: &'static str,
    /// Where its keys belong, as the text after "belongs".
    pub home: &'static str,
    /// What is expected, as the text after "expected".
    pub form: &'static str,
    /// What it describes.
    pub about: &'static str,
    /// An example, as it would stand in a file; empty if the keys show it.
    pub example: &'static str,
    /// Its keys, in groups.
    pub keys: &'static [&'static [Key]],
    /// Further keys, each group with the section that gives the values of missing ones.
    pub shared: &'static [(&'static [Key], &'static str)],
}

impl Section {
    /// All keys, in the order in which they are listed to users.
    pub fn all(&self) -> impl Iterator<Item = &'static Key> {
        let shared = self.shared.iter().map(|(keys, _)| *keys);
        self.keys.iter().copied().chain(shared).flatten()
    }
}

/// A key of a file.
#[derive(Debug)]
pub struct Key {
    /// Its name.
    pub name: &'static str,
    /// The values that it accepts.
    pub kind: Kind,
    /// The unit of its number; empty without one.
    pub unit: &'static str,
    /// Its value if it is missing.
    pub default: Fallback,
    /// The range in which its number usually is, for a slider.
    pub usual: Option<[f64; 2]>,
    /// What it is.
    pub about: &'static str,
}

/// The values that a key accepts.
#[derive(Clone, Copy, Debug)]
pub enum Kind {
    /// A number.
    Number(Range),
    /// An integer.
    Integer([u32; 2]),
    /// Three numbers.
    Vector(Range),
    /// Three numbers that are not all zero; their length does not matter.
    Direction,
    /// A string.
    Text(Text),
    /// One of some words.
    Word(fn() -> Vec<&'static str>),
    /// Something else: this form.
    Other(&'static str),
}

/// A closed range of numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Range {
    /// The smallest number.
    pub min: f64,
    /// The largest number.
    pub max: f64,
}

impl Range {
    /// Whether it contains a number.
    pub fn contains(&self, x: f64) -> bool {
        (self.min..=self.max).contains(&x)
    }
}

/// Strings that satisfy a condition.
#[derive(Clone, Copy, Debug)]
pub struct Text {
    /// The condition, as the text after "expected".
    pub form: &'static str,
    /// Whether a string satisfies it.
    pub accepts: fn(&str) -> bool,
}

/// The value of a key that is missing.
#[derive(Clone, Copy, Debug)]
pub enum Fallback {
    /// Nothing: the key is required.
    Required,
    /// A number.
    Number(f64),
    /// A number, which is written like this.
    Written(f64, &'static str),
    /// A vector with these equal components.
    Vector(f64),
    /// A word.
    Word(&'static str),
    /// What this says.
    Else(&'static str),
}

impl Fallback {
    /// The default as text; empty if the key is required.
    pub fn text(&self) -> String {
        match *self {
            Fallback::Required => String::new(),
            Fallback::Number(number) | Fallback::Vector(number) => number.to_string(),
            Fallback::Written(_, text) | Fallback::Word(text) | Fallback::Else(text) => text.to_owned(),
        }
    }
}

const fn key(name: &'static str, kind: Kind, default: Fallback, about: &'static str) -> Key {
    Key { name, kind, unit: "", default, usual: None, about }
}

const fn vector(name: &'static str, unit: &'static str, default: Fallback, about: &'static str) -> Key {
    Key { name, kind: Kind::Vector(ANY), unit, default, usual: None, about }
}

const fn number(
    name: &'static str,
    range: Range,
    unit: &'static str,
    usual: [f64; 2],
    default: Fallback,
    about: &'static str,
) -> Key {
    Key { name, kind: Kind::Number(range), unit, default, usual: Some(usual), about }
}

/// The key of a group with this name; a build without it fails.
#[allow(clippy::panic)] // only when the program is built
pub(crate) const fn find(keys: &'static [Key], name: &str) -> &'static Key {
    let name = name.as_bytes();
    let mut i = 0;
    while i < keys.len() {
        let known = keys[i].name.as_bytes();
        let mut same = if known.len() == name.len() { 0 } else { usize::MAX };
        while same < known.len() && known[same] == name[same] {
            same += 1;
        }
        if same == known.len() {
            return &keys[i];
        }
        i += 1;
    }
    panic!("no such key")
}

// --- ranges ---------------------------------------------------------------------------------------------------------

/// The largest magnitude of a number; see the [limits](super::parse#limits).
pub(super) const LARGEST: f64 = 1e15;
/// The smallest number that must be positive.
pub(super) const SMALLEST: f64 = 1e-12;
pub(super) const POSITIVE: Range = Range { min: SMALLEST, max: LARGEST };
pub(super) const NON_NEGATIVE: Range = Range { min: 0.0, max: LARGEST };
pub(crate) const ANY: Range = Range { min: -LARGEST, max: LARGEST };
/// The length of a direction does not matter.
pub(super) const FINITE: Range = Range { min: f64::MIN, max: f64::MAX };
/// Blending by more than half a radius would also change the surface away from the seam.
const BLEND: Range = Range { min: 0.0, max: 0.5 };
/// At zero, springs at rest would tear; springs that may stretch a thousandfold never tear.
const STRAIN: Range = Range { min: 1e-3, max: 1e3 };
/// Excludes the limits at which an isotropic material becomes incompressible or shear-rigid, where the stiffness is
/// unbounded.
const POISSON: Range = Range { min: -0.9, max: 0.49 };
/// Fewer than two cells have no free nodes.
const CELLS: Kind = Kind::Integer([2, cells::MOST_ACROSS]);

const SCENE_NAME: Text = Text { form: "a name of 1 to 200 characters on one line", accepts: is_scene_name };
const BODY_NAME: Text = Text { form: "a name of 1 to 64 letters, digits, - and _", accepts: is_body_name };
const COLOR: Text = Text { form: "a color \"#rrggbb\"", accepts: |text| color(text).is_some() };
const FILE: Text = Text { form: "the name of a file, up to 4096 characters", accepts: is_file };
const DATA: Text = Text { form: "a mesh as text", accepts: |_| true };

fn is_scene_name(name: &str) -> bool {
    (1..=200).contains(&name.chars().count()) && !name.chars().any(char::is_control)
}

/// Whether a mesh file can have this name.
pub(super) fn is_file(name: &str) -> bool {
    (1..=4096).contains(&name.len()) && !name.contains('\0')
}

/// `#rrggbb`
pub(super) fn color(text: &str) -> Option<[u8; 3]> {
    let digits =
        text.strip_prefix('#').filter(|digits| digits.len() == 6 && digits.bytes().all(|b| b.is_ascii_hexdigit()))?;
    let [_, red, green, blue] = u32::from_str_radix(digits, 16).ok()?.to_be_bytes();
    Some([red, green, blue])
}

// --- words ----------------------------------------------------------------------------------------------------------

/// Words, each with the value that it stands for.
pub(super) type Words<T, const N: usize> = [(&'static str, T); N];

/// The words alone.
pub(crate) fn words<T: Copy>(pairs: &[(&'static str, T)]) -> Vec<&'static str> {
    pairs.iter().map(|(word, _)| *word).collect()
}

pub(super) const RESPONSES: Words<Response, 3> =
    [("rigid", Response::Rigid), ("inertial", Response::Inertial), ("world", Response::World)];
pub(super) const WEIGHTS: Words<Weight, 2> = [("linear", Weight::Linear), ("wendland", Weight::Wendland)];
pub(super) const SCALINGS: Words<Scaling, 2> = [("relative", Scaling::Relative), ("absolute", Scaling::Absolute)];
pub(super) const APART_REPELS: Words<bool, 2> = [("repel", true), ("none", false)];
pub(super) const INTERPOLATIONS: Words<Interpolation, 3> =
    [("spline", Spline::new), ("linear", Spline::linear), ("hold", Spline::hold)];
/// Whether a force point attracts.
pub(super) const ACTS: Words<bool, 2> = [("attract", true), ("repel", false)];
pub(super) const ROTATIONS: Words<Rotation, 2> = [("free", Rotation::Free), ("fixed", Rotation::Fixed)];

/// Interpolation between the keys of a path.
pub(super) type Interpolation = fn(&[(f64, DVec3)]) -> Spline;

// --- the table ------------------------------------------------------------------------------------------------------

use Fallback::{Else, Number, Required, Vector, Word, Written};

const LAW: PairLaw = PairLaw::DEFAULT;

pub(super) static TOP: [Key; 7] = [
    key("name", Kind::Text(SCENE_NAME), Else("file name without extension"), "Name of the scene and of its recording."),
    number(
        "dt",
        POSITIVE,
        "s",
        [1e-3, 0.1],
        Written(1.0 / 60.0, "1/60"),
        "Step Δt; a recording has a frame after every step unless --every says otherwise.",
    ),
    number("duration", POSITIVE, "s", [0.5, 20.0], Required, "Simulated time."),
    key(
        "integrator",
        Kind::Word(|| Integrator::ALL.map(Integrator::name).to_vec()),
        Word("exponential"),
        "Method that advances the vertices in time.",
    ),
    number(
        "tolerance",
        POSITIVE,
        "radii/s",
        [1e-9, 1e-2],
        Written(Scene::DEFAULT_TOLERANCE, "1e-6"),
        "Acceptable error of the integrator exponential, per unit of scene time; it sets the integrator's steps.",
    ),
    vector(
        "gravity",
        "scene unit/s²",
        Vector(0.0),
        "Acceleration of free bodies. In views, the axis most opposed to it is up; z without it.",
    ),
    key("model", Kind::Word(|| Model::ALL.map(Model::name).to_vec()), Word("oscillators"), "Model of a soft body."),
];

/// The tables of a scene, in the order of their headers.
pub(super) static TABLES: [Key; 13] = [
    key("material", Kind::Other("a table, written [material]"), Else("none"), "Oscillators of all bodies."),
    key("influence", Kind::Other("a table, written [influence]"), Else("none"), "Law between bodies."),
    key("lattice", Kind::Other("a table, written [lattice]"), Else("none"), "Settings of the model lattice."),
    key("fem", Kind::Other("a table, written [fem]"), Else("none"), "Settings of the model fem."),
    key("surface", Kind::Other("a table, written [surface]"), Else("none"), "Surface of merged bodies."),
    key("mesh", Kind::Other("tables, written [[mesh]]"), Else("none"), "Mesh files, embedded in the scene."),
    key("body", Kind::Other("tables, written [[body]]"), Else("none"), "Soft bodies."),
    key("grid", Kind::Other("tables, written [[grid]]"), Else("none"), "Many bodies from one description."),
    key("pair", Kind::Other("tables, written [[pair]]"), Else("none"), "Laws of single pairs."),
    key(
        "plane",
        Kind::Other("tables, written [[plane]]"),
        Else("none"),
        "Planes, which act on the vertices of all bodies.",
    ),
    key(
        "point",
        Kind::Other("tables, written [[point]]"),
        Else("none"),
        "Force points: influence spheres without a body.",
    ),
    key("push", Kind::Other("tables, written [[push]]"), Else("none"), "Pushes on single bodies."),
    key("edit", Kind::Other("tables, written [[edit]]"), Else("none"), "Other values from an instant on."),
];

pub(super) static OSCILLATOR: [Key; 3] = [
    number(
        "omega",
        NON_NEGATIVE,
        "rad/s",
        [1.0, 40.0],
        Number(12.0),
        "Natural angular frequency of the restoring force.",
    ),
    number("damping", NON_NEGATIVE, "1/s", [0.0, 12.0], Number(1.5), "Damping rate of the vertices."),
    key(
        "response",
        Kind::Word(|| words(&RESPONSES)),
        Word("inertial"),
        "Response of the vertices to the motion of their own body.",
    ),
];

pub(super) static STRENGTH: [Key; 2] = [
    number(
        "alpha",
        NON_NEGATIVE,
        "1/s²",
        [0.0, 400.0],
        Number(LAW.alpha),
        "Strength with which merged bodies attract each other.",
    ),
    number(
        "beta",
        NON_NEGATIVE,
        "1/s²",
        [0.0, 400.0],
        Number(LAW.beta),
        "Strength with which bodies repel each other, apart and in their core.",
    ),
];

pub(super) static REACH: [Key; 1] = [number(
    "reach",
    POSITIVE,
    "radii",
    [1.0, 3.0],
    Written(SQRT_2, "√2"),
    "Radius of the influence sphere, in radii of its body.",
)];

pub(super) static SPHERE: [Key; 2] = [
    key(
        "weight",
        Kind::Word(|| words(&WEIGHTS)),
        Word("linear"),
        "Decrease of the influence from the centre of a sphere to its rim.",
    ),
    key(
        "scaling",
        Kind::Word(|| words(&SCALINGS)),
        Word("relative"),
        "Influence of bodies of different sizes: relative to the smaller one, or absolute as in the thesis.",
    ),
];

pub(super) static PHASES: [Key; 5] = [
    number(
        "merge_at",
        POSITIVE,
        "q",
        [0.5, 1.5],
        Number(LAW.thresholds.merge_at),
        "A pair merges when q, its centre distance over the sum of its radii, falls to this.",
    ),
    number(
        "split_at",
        POSITIVE,
        "q",
        [0.5, 1.8],
        Number(LAW.thresholds.split_at),
        "A merged pair splits when q rises to this; not below merge_at.",
    ),
    number(
        "core_at",
        NON_NEGATIVE,
        "q",
        [0.0, 1.2],
        Else("0.76 merge_at for pairs with a free body, otherwise 0"),
        "A merged pair is in its core, where it repels, while q is below this; 0: no core. Below merge_at.",
    ),
    number(
        "core_width",
        NON_NEGATIVE,
        "q",
        [0.0, 0.6],
        Else("core_at / 2 for pairs with a free body, otherwise 0"),
        "Width over which the strength changes around core_at; 0: it jumps.",
    ),
    key("apart", Kind::Word(|| words(&APART_REPELS)), Word("repel"), "What bodies that are apart do to each other."),
];

pub(super) static LATTICES: [Key; 3] = [
    key("cells", CELLS, Number(cells::ACROSS as f64), "Cells along the diameter of a body."),
    key(
        "tear",
        Kind::Word(|| TearMode::ALL.map(TearMode::name).to_vec()),
        Word("none"),
        "How a body tears: cut (overstretched springs, with their cells) or split (overloaded nodes).",
    ),
    number("limit", STRAIN, "strain", [0.05, 2.0], Number(0.5), "Strain at which it tears."),
];

pub(super) static ELEMENTS: [Key; 4] = [
    key("cells", CELLS, Number(cells::ACROSS as f64), "Cells along the diameter of a body."),
    number(
        "young",
        POSITIVE,
        "mass/(scene unit·s²)",
        [1.0, 1000.0],
        Else("a bar one radius long has frequency omega"),
        "Young's modulus.",
    ),
    number("poisson", POISSON, "", [0.0, 0.49], Number(0.25), "Poisson's ratio."),
    number(
        "tear_stress",
        POSITIVE,
        "mass/(scene unit·s²)",
        [1.0, 1000.0],
        Else("none"),
        "Tension above which tearing is reported.",
    ),
];

pub(super) static SURFACES: [Key; 1] = [number(
    "blend",
    BLEND,
    "radii",
    [0.0, 0.5],
    Number(fairing::BLEND),
    "Distance from a seam within which merged surfaces are smoothed; 0: sharp.",
)];

pub(super) static MESHES: [Key; 2] = [
    key("file", Kind::Text(FILE), Required, "Name that bodies use for the mesh; no file is read."),
    key("data", Kind::Text(DATA), Required, "The mesh, as recordings embed it."),
];

/// What is expected of `shape`.
pub(super) const SHAPE_FORM: &str = "a table such as { sphere = { stacks = 12, slices = 24 } }";
/// What is expected of `motion`.
pub(super) const MOTION_FORM: &str = "a table such as { fixed = [0, 0, 0] }";

pub(super) static BODIES: [Key; 7] = [
    key("name", Kind::Text(BODY_NAME), Required, "Name, which no other body and no group has."),
    number("radius", POSITIVE, "scene unit", [0.1, 3.0], Required, "Radius."),
    key(
        "shape",
        Kind::Other(SHAPE_FORM),
        Else("{ sphere = { stacks = 12, slices = 24 } }"),
        "Rest shape: a sphere or a closed mesh; or { mesh = \"FILE\" }: OBJ, STL, PLY, glTF or GLB, relative to the scene file.",
    ),
    key(
        "motion",
        Kind::Other(MOTION_FORM),
        Required,
        "What moves the centre: { fixed = [x, y, z] }, line, sine, keyframes, or free.",
    ),
    number(
        "mass",
        POSITIVE,
        "",
        [0.01, 100.0],
        Else("radius³"),
        "Total mass; only the ratios of masses of free bodies matter.",
    ),
    key("group", Kind::Text(BODY_NAME), Else("none"), "Group, for [[pair]]; not the name of a body."),
    key("color", Kind::Text(COLOR), Else("from the palette"), "Color of its surface."),
];

/// What is expected of `count` in a grid.
pub(super) const COUNT_FORM: &str = "an array of 3 integers of at least 1 [nx, ny, nz]";

pub(super) static GRIDS: [Key; 4] = [
    key(
        "count",
        Kind::Other(COUNT_FORM),
        Required,
        "Bodies along x, y and z: NAME-0-0-0, NAME-1-0-0 …; at most 1,000,000.",
    ),
    vector("spacing", "scene unit", Required, "Distance between neighbours along x, y and z."),
    number("jitter", NON_NEGATIVE, "scene unit", [0.0, 1.0], Number(0.0), "Maximum random offset of each coordinate."),
    key("seed", Kind::Integer([0, u32::MAX]), Number(0.0), "Seed of the jitter."),
];

/// What is expected of `bodies` in a pair.
pub(super) const SIDES_FORM: &str = "an array of two names of bodies or groups";

pub(super) static PAIRS: [Key; 1] = [key(
    "bodies",
    Kind::Other(SIDES_FORM),
    Required,
    "The two sides; a pair of bodies may be in one such table only.",
)];

pub(super) static PLANES: [Key; 5] = [
    key("normal", Kind::Direction, Required, "Direction towards the free side."),
    number(
        "offset",
        ANY,
        "scene unit",
        [-5.0, 5.0],
        Number(0.0),
        "Distance of its points from the origin along the normal.",
    ),
    number(
        "stiffness",
        NON_NEGATIVE,
        "1/s²",
        [100.0, 20_000.0],
        Number(4000.0),
        "Acceleration of a vertex per depth behind the plane; beyond (5 omega radius/depth)² vertices may turn a free body inside out.",
    ),
    number("friction", NON_NEGATIVE, "", [0.0, 1.0], Number(0.0), "Coefficient of Coulomb friction."),
    number("slip", POSITIVE, "scene unit/s", [1e-3, 0.1], Number(0.01), "Speed below which friction fades."),
];

/// What is expected of `bodies` of a force point.
pub(super) const BODIES_FORM: &str = "an array of one or more names of bodies or groups";

pub(super) static POINTS: [Key; 7] = [
    key("name", Kind::Text(BODY_NAME), Required, "Name of the point."),
    key("motion", Kind::Other(MOTION_FORM), Required, "What moves its centre; not free."),
    number("radius", POSITIVE, "scene unit", [0.1, 5.0], Required, "Radius of a body with the same influence sphere."),
    key("act", Kind::Word(|| words(&ACTS)), Required, "Whether it attracts, with alpha, or repels, with beta."),
    key("bodies", Kind::Other(BODIES_FORM), Else("all"), "Bodies on which it acts."),
    number("start", NON_NEGATIVE, "s", [0.0, 10.0], Number(0.0), "When it begins to act."),
    number("duration", NON_NEGATIVE, "s", [0.0, 10.0], Else("for ever"), "How long it acts."),
];

pub(super) static PUSHES: [Key; 5] = [
    key("body", Kind::Other("the name of a body"), Required, "Body that is pushed."),
    key("direction", Kind::Direction, Required, "Direction of the push."),
    number("strength", ANY, "scene unit/s²", [0.0, 200.0], Required, "Acceleration of the vertices that face it."),
    number("start", NON_NEGATIVE, "s", [0.0, 10.0], Required, "When it begins."),
    number("duration", NON_NEGATIVE, "s", [0.0, 2.0], Required, "How long it acts."),
];

/// What is expected of `set` in an edit.
pub(super) const EDIT_FORM: &str = "a table of keys and values such as { \"influence.merge_at\" = 1.1 }";

pub(super) static EDITS: [Key; 2] = [
    number("time", NON_NEGATIVE, "s", [0.0, 10.0], Required, "When it happens: a step of the integrator ends there."),
    key(
        "set",
        Kind::Other(EDIT_FORM),
        Required,
        "Numbers of influence, material, gravity, of a body (omega, damping, reach), grid, pair, plane or point; keys as for --set.",
    ),
];

pub(super) static MOTIONS: [Key; 5] = [
    key("fixed", Kind::Vector(ANY), Else("none"), "A fixed place."),
    key("line", Kind::Other(LINE.form), Else("none"), "A straight line."),
    key(
        "sine",
        Kind::Other(SINE.form),
        Else("none"),
        "An oscillation: center + amplitude sin(2π frequency t + phase).",
    ),
    key(
        "keyframes",
        Kind::Other(KEYS_FORM),
        Else("none"),
        "A path through keys [t, x, y, z], or a table of keys and their interpolation.",
    ),
    key("free", Kind::Other(FREE.form), Else("none"), "The forces that act on the body."),
];

pub(super) static LINES: [Key; 2] = [
    vector("from", "scene unit", Required, "Position at t = 0."),
    vector("velocity", "scene unit/s", Required, "Velocity."),
];

pub(super) static SINES: [Key; 4] = [
    vector("center", "scene unit", Required, "Centre of the oscillation."),
    vector("amplitude", "scene unit", Required, "Amplitude along each axis."),
    number("frequency", NON_NEGATIVE, "1/s", [0.0, 4.0], Required, "Frequency."),
    number("phase", ANY, "rad", [-3.2, 3.2], Number(0.0), "Phase at t = 0."),
];

/// What is expected of the keys of a path.
pub(super) const KEYS_FORM: &str = "an array of two or more keys [t, x, y, z]";

pub(super) static PATHS: [Key; 2] = [
    key("keys", Kind::Other(KEYS_FORM), Required, "Times and positions; the times increase."),
    key(
        "interpolation",
        Kind::Word(|| words(&INTERPOLATIONS)),
        Word("spline"),
        "How the centre moves between two keys: smoothly, straight, or not at all until the next one.",
    ),
];

pub(super) static FREES: [Key; 4] = [
    vector("from", "scene unit", Required, "Mass centre at t = 0; outside a plane that would throw the body out."),
    vector("velocity", "scene unit/s", Vector(0.0), "Velocity at t = 0."),
    vector("spin", "rad/s", Vector(0.0), "Angular velocity at t = 0."),
    key("rotation", Kind::Word(|| words(&ROTATIONS)), Word("free"), "Whether the rest shape turns with the vertices."),
];

/// A table with a header of its own.
macro_rules! table {
    ($name:literal, $about:literal, $keys:expr) => {
        Section {
            header: concat!("[", $name, "]"),
            home: concat!("in [", $name, "]"),
            form: concat!("a table, written [", $name, "]"),
            about: $about,
            example: "",
            keys: $keys,
            shared: &[],
        }
    };
}

/// A table that may occur any number of times.
macro_rules! tables {
    ($name:literal, $about:literal, $keys:expr, $shared:expr, $example:literal) => {
        Section {
            header: concat!("[[", $name, "]]"),
            home: concat!("in a [[", $name, "]]"),
            form: concat!("a table, written [[", $name, "]]"),
            about: $about,
            example: $example,
            keys: $keys,
            shared: $shared,
        }
    };
}

/// A table that is the value of a key.
macro_rules! inline {
    ($header:literal, $home:literal, $form:expr, $about:literal, $keys:expr) => {
        Section { header: $header, home: $home, form: $form, about: $about, example: "", keys: $keys, shared: &[] }
    };
}

pub(super) static SCENE: Section = Section {
    header: "",
    home: "at the top of the file",
    form: "a table",
    about: "A scene: TOML. Units are scene units, seconds and radians.",
    example: "",
    keys: &[&TOP, &TABLES],
    shared: &[],
};
pub(super) static MATERIAL: Section =
    table!("material", "The oscillators of all bodies; a body may override each key.", &[&OSCILLATOR]);
pub(super) static INFLUENCE: Section = table!(
    "influence",
    "The law between bodies: strengths, influence spheres, thresholds.",
    &[&STRENGTH, &REACH, &SPHERE, &PHASES]
);
pub(super) static LATTICE: Section =
    table!("lattice", "For model = \"lattice\": cubes of masses and springs.", &[&LATTICES]);
pub(super) static FEM: Section = table!("fem", "For model = \"fem\": linear finite elements.", &[&ELEMENTS]);
pub(super) static SURFACE: Section = table!("surface", "The surface of merged bodies.", &[&SURFACES]);
pub(super) static MESH: Section =
    tables!("mesh", "A mesh file, embedded in the scene as recordings do.", &[&MESHES], &[], "");
pub(super) static BODY: Section = tables!(
    "body",
    "A soft body.",
    &[&BODIES],
    &[(&OSCILLATOR, "[material]"), (&REACH, "[influence]")],
    "[[body]]
name = \"a\"
radius = 1.0
motion = { fixed = [0, 0, 0] }

[[body]]
name = \"b\"
radius = 0.8
group = \"right\"
motion = { line = { from = [2.6, 0, 0], velocity = [-0.8, 0, 0] } }"
);
pub(super) static GRID: Section = tables!(
    "grid",
    "Many bodies from one description: its motion is that of the first, from which the others are offset.",
    &[&GRIDS],
    &[(&BODIES, "[[body]]"), (&OSCILLATOR, "[material]"), (&REACH, "[influence]")],
    "[[grid]]
name = \"drop\"
count = [2, 2, 1]
spacing = [2.5, 2.5, 3.0]
radius = 1.0
motion = { fixed = [0, 9, 0] }"
);
pub(super) static PAIR: Section = tables!(
    "pair",
    "Another law for some pairs.",
    &[&PAIRS],
    &[(&STRENGTH, "[influence]"), (&PHASES, "[influence]")],
    "[[pair]]
bodies = [\"a\", \"right\"]
merge_at = 0.9"
);
pub(super) static PLANE: Section = tables!(
    "plane",
    "A plane, which acts on the vertices of all bodies that are behind it.",
    &[&PLANES],
    &[],
    "[[plane]]
normal = [0, 0, 1]
offset = -1.2"
);
pub(super) static POINT: Section = tables!(
    "point",
    "A force point: an influence sphere without a body, on which nothing acts.",
    &[&POINTS],
    &[(&STRENGTH, "[influence]")],
    "[[point]]
name = \"p\"
motion = { fixed = [0, 0, 2] }
radius = 1.0
act = \"attract\"
alpha = 40.0
bodies = [\"a\", \"right\"]
start = 0.5"
);
pub(super) static PUSH: Section = tables!(
    "push",
    "A push: the vertices that face it are accelerated.",
    &[&PUSHES],
    &[],
    "[[push]]
body = \"a\"
direction = [1, 0, 0]
strength = 60.0
start = 0.2
duration = 0.1"
);
pub(super) static EDIT: Section = tables!(
    "edit",
    "An edit: other values from an instant on.",
    &[&EDITS],
    &[],
    "[[edit]]
time = 1.5
set = { \"influence.merge_at\" = 1.1, \"body.a.omega\" = 9.0 }"
);
pub(super) static MOTION: Section = inline!(
    "motion = { … }",
    "in the motion of a body",
    MOTION_FORM,
    "What moves the centre: one of these.",
    &[&MOTIONS]
);
pub(super) static LINE: Section = inline!(
    "motion = { line = { … } }",
    "in motion = { line = { … } }",
    "a table such as { from = [0, 0, 0], velocity = [1, 0, 0] }",
    "A straight line.",
    &[&LINES]
);
pub(super) static SINE: Section = inline!(
    "motion = { sine = { … } }",
    "in motion = { sine = { … } }",
    "a table such as { center = [0, 0, 0], amplitude = [1, 0, 0], frequency = 0.25 }",
    "An oscillation.",
    &[&SINES]
);
pub(super) static KEYFRAMES: Section = inline!(
    "motion = { keyframes = { … } }",
    "in motion = { keyframes = { … } }",
    "a table such as { keys = [[0, 0, 0, 0], [1, 2, 0, 0]], interpolation = \"linear\" }",
    "A path through keys.",
    &[&PATHS]
);
pub(super) static FREE: Section = inline!(
    "motion = { free = { … } }",
    "in motion = { free = { … } }",
    "a table such as { from = [0, 0, 1], velocity = [1, 0, 0] }",
    "A body that forces move; its response is inertial.",
    &[&FREES]
);

/// The section of each kind of shape, in the order of [`Shape::KINDS`].
pub(super) static SOLIDS: LazyLock<Vec<Section>> = LazyLock::new(|| Shape::KINDS.iter().map(solid).collect());

fn solid(kind: &'static shape::Kind) -> Section {
    let key = |parameter: &shape::Parameter| {
        let kind = Kind::Integer([parameter.least, parameter.most]);
        key(parameter.name, kind, Number(f64::from(parameter.default)), parameter.about)
    };
    let header: &'static str = format!("shape = {{ {} = {{ … }} }}", kind.name).leak();
    let keys = leaked(kind.parameters.iter().map(key).collect());
    Section { header, home: kind.home, form: kind.form, about: kind.about, example: "", keys, shared: &[] }
}

/// What a body's shape can be.
pub(super) static SHAPE: LazyLock<Section> = LazyLock::new(|| {
    let file = key("mesh", Kind::Text(FILE), Else("none"), "A closed mesh from a file, relative to the scene file.");
    let kind = |kind: &shape::Kind| key(kind.name, Kind::Other(kind.form), Else("none"), kind.about);
    let keys = leaked(Shape::KINDS.iter().map(kind).chain([file]).collect());
    let about = "A rest shape: one of these.";
    let (header, home) = ("shape = { … }", "in the shape of a body");
    Section { header, home, form: SHAPE_FORM, about, example: "", keys, shared: &[] }
});

/// A group of keys that lives as long as the program.
fn leaked(keys: Vec<Key>) -> &'static [&'static [Key]] {
    let keys: &'static [Key] = keys.leak();
    vec![keys].leak()
}

/// All sections of a scene, in the order in which they are listed to users.
pub fn sections() -> impl Iterator<Item = &'static Section> {
    let tables = [
        &SCENE, &MATERIAL, &INFLUENCE, &LATTICE, &FEM, &SURFACE, &MESH, &BODY, &GRID, &PAIR, &PLANE, &POINT, &PUSH,
        &EDIT,
    ];
    let motions = [&MOTION, &LINE, &SINE, &KEYFRAMES, &FREE];
    tables.into_iter().chain([&*SHAPE]).chain(SOLIDS.iter()).chain(motions)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Scene;

    /// The lines of the example in the documentation of `scene`, by section: comments that continue are joined.
    fn documented() -> Vec<(String, Vec<String>)> {
        let docs = include_str!("mod.rs").lines().map_while(|line| line.strip_prefix("//!")).map(str::trim);
        let block = docs.skip_while(|line| *line != "```toml").skip(1).take_while(|line| *line != "```");
        let mut sections = vec![(String::new(), Vec::<String>::new())];
        for line in block.filter(|line| !line.is_empty()) {
            let (_, lines) = sections.last_mut().unwrap();
            if line.starts_with('[') {
                sections.push((line.split('#').next().unwrap().trim().to_owned(), vec![]));
            } else if let (Some(more), Some(last)) = (line.strip_prefix('#'), lines.last_mut()) {
                *last += more;
            } else {
                lines.push(line.to_owned());
            }
        }
        sections
    }

    #[test]
    fn the_documentation_has_every_key_with_its_unit_and_default() {
        let documented = documented();
        let of = |header: &str| -> Vec<&String> {
            let lines = documented.iter().filter(|(known, _)| known == header).flat_map(|(_, lines)| lines);
            lines.collect()
        };
        for section in sections().filter(|section| section.header != MESH.header) {
            let is_inline = section.header.contains('=');
            let lines = of(if is_inline { BODY.header } else { section.header });
            for key in section.keys.iter().copied().flatten() {
                if section.header.is_empty() && TABLES.iter().any(|table| table.name == key.name) {
                    let headers = [format!("[{}]", key.name), format!("[[{}]]", key.name)];
                    assert!(
                        key.name == "mesh" || documented.iter().any(|(known, _)| headers.contains(known)),
                        "{key:?}"
                    );
                    continue;
                }
                let start = format!("{} = ", key.name);
                let is_there =
                    |line: &&&String| if is_inline { line.contains(&start) } else { line.starts_with(&start) };
                let line = lines.iter().find(is_there);
                let line = line.unwrap_or_else(|| panic!("{} lacks {}", section.header, key.name));
                if !is_inline {
                    assert!(line.contains(key.unit), "{} is in {}: {line}", key.name, key.unit);
                    let default = key.default.text();
                    let is_shown = default.is_empty() || line.contains(&format!("[{default}]"));
                    assert!(is_shown, "{} is [{default}] by default: {line}", key.name);
                }
            }
            for line in lines.iter().filter(|_| !is_inline) {
                let name = line.split(" = ").next().unwrap();
                assert!(section.all().any(|key| key.name == name), "there is no {name} in {}", section.header);
            }
        }
    }

    #[test]
    fn defaults_and_usual_values_are_in_range() {
        for (section, key) in sections().flat_map(|section| section.all().map(move |key| (section.header, key))) {
            let Kind::Number(range) = key.kind else { continue };
            let usual = key.usual.unwrap_or_else(|| panic!("{section} {}: a slider needs a range", key.name));
            let default = if let Number(x) | Written(x, _) = key.default { x } else { usual[0] };
            for number in [usual[0], usual[1], default] {
                assert!((range.min..=range.max).contains(&number), "{section} {}: {number}", key.name);
            }
            assert!((usual[0]..=usual[1]).contains(&default), "{section} {}: {default}", key.name);
        }
    }

    #[test]
    fn the_examples_are_a_scene() {
        let examples: Vec<&str> = sections().map(|section| section.example).collect();
        let text = format!("duration = 2.0\n{}", examples.join("\n"));
        let scene = Scene::parse(&text, "examples.toml").unwrap_or_else(|error| panic!("{error}\n{text}"));
        assert_eq!(
            [scene.bodies.len(), scene.planes.len(), scene.points.len(), scene.pushes.len(), scene.edits.len()],
            [6, 1, 1, 1, 1]
        );
    }
}
