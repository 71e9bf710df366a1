//! The scene file: parses text to a [`Scene`] that is valid by construction, or to one [`SceneError`] that says where
//! the text is wrong and what was expected there.
//!
//! # Limits
//! Numbers are at most 10¹⁵ in magnitude, and those that must be positive (radius, dt, reach …) at least 10⁻¹², as must
//! be the time between keys. Within these limits, no product, quotient or square that the simulation computes comes
//! near the range of a double, so nothing downstream checks for overflow. They leave 27 orders of magnitude, more than
//! double precision resolves. `duration / dt` is at most 10¹², so that step numbers are exact and times are accurate to
//! a millionth of a step; a ring has at most 65,535 vertices, so that a vertex index fits 32 bits. A file has at most
//! 32 MiB.

mod error;
mod grid;
mod meshes;
mod pairs;
mod point;
pub(crate) mod reader;

use std::ops::RangeInclusive;
use std::{collections::HashMap, fs::File, io, io::Read as _};

use glam::DVec3;
use toml::de::DeTable;

use super::{
    Body, FreeMotion, Integrator, Material, Model, Motion, Path, Plane, Push, Response, Rotation, Scene, TearMode,
    cells, path::Spline,
};
use crate::{
    geometry::{Shape, fairing, shape::Parameter},
    model::{
        ForFree, PairLaw,
        influence::{Influence, Scaling, Weight},
        phase::Thresholds,
    },
    text::did_you_mean,
};
use error::one_line;
pub use error::{Place, SceneError};
pub use meshes::Watch;
pub(super) use meshes::{Files, Meshes};
use reader::{Choice, Integer, Keys, Kind, Number, Source, Table, Text, Value, Vector, is_body_name};

/// See the [limits](self#limits).
const LARGEST: f64 = 1e15;
const SMALLEST: f64 = 1e-12;
const MAX_STEPS: f64 = 1e12;
const LARGEST_FILE: u64 = 32 << 20;

/// Limit on the planes of a scene.
const MAX_PLANES: usize = 1000;
const POSITIVE: Number = Number { min: SMALLEST, max: LARGEST };
const NON_NEGATIVE: Number = Number { min: 0.0, max: LARGEST };
const ANY: Number = Number { min: -LARGEST, max: LARGEST };
/// Blending by more than half a radius would also change the surface away from the seam.
const BLEND: Number = Number { min: 0.0, max: 0.5 };
/// Fewer than two cells have no free nodes.
const CELLS: Integer = Integer { min: 2, max: cells::MOST_ACROSS };
/// At zero, springs at rest would tear; springs that may stretch a thousandfold never tear.
const STRAIN: Number = Number { min: 1e-3, max: 1e3 };
/// Excludes the limits at which an isotropic material becomes incompressible or shear-rigid, where the stiffness is
/// unbounded.
const POISSON: Number = Number { min: -0.9, max: 0.49 };
/// The length of a direction does not matter.
const FINITE: Number = Number { min: f64::MIN, max: f64::MAX };

static SCENE: Keys = Keys {
    home: "at the top of the file",
    form: "a table",
    names: &[
        "name",
        "dt",
        "duration",
        "integrator",
        "tolerance",
        "gravity",
        "model",
        "material",
        "influence",
        "lattice",
        "fem",
        "surface",
        "mesh",
        "body",
        "grid",
        "pair",
        "plane",
        "point",
        "push",
    ],
};
static MATERIAL: Keys =
    Keys { home: "in [material]", form: "a table, written [material]", names: &["omega", "damping", "response"] };
static INFLUENCE: Keys = Keys {
    home: "in [influence]",
    form: "a table, written [influence]",
    names: &["alpha", "beta", "reach", "weight", "scaling", "merge_at", "split_at", "core_at", "core_width", "apart"],
};
static LATTICE: Keys =
    Keys { home: "in [lattice]", form: "a table, written [lattice]", names: &["cells", "tear", "limit"] };
static FEM: Keys =
    Keys { home: "in [fem]", form: "a table, written [fem]", names: &["cells", "young", "poisson", "tear_stress"] };
static SURFACE: Keys = Keys { home: "in [surface]", form: "a table, written [surface]", names: &["blend"] };
static BODY: Keys = Keys {
    home: "in a [[body]]",
    form: "a table, written [[body]]",
    names: &["name", "radius", "shape", "motion", "mass", "group", "color", "omega", "damping", "response"],
};
static MESH: Keys = Keys { home: "in a [[mesh]]", form: "a table, written [[mesh]]", names: &["file", "data"] };
static GRID: Keys = Keys {
    home: "in a [[grid]]",
    form: "a table, written [[grid]]",
    names: &[
        "name", "count", "spacing", "jitter", "seed", "radius", "shape", "motion", "mass", "group", "color", "omega",
        "damping", "response",
    ],
};
static PAIR: Keys = Keys {
    home: "in a [[pair]]",
    form: "a table, written [[pair]]",
    names: &["bodies", "merge_at", "split_at", "core_at", "core_width", "alpha", "beta", "apart"],
};
static PLANE: Keys = Keys {
    home: "in a [[plane]]",
    form: "a table, written [[plane]]",
    names: &["normal", "offset", "stiffness", "friction", "slip"],
};
static POINT: Keys = Keys {
    home: "in a [[point]]",
    form: "a table, written [[point]]",
    names: &["name", "motion", "radius", "act", "alpha", "beta", "bodies", "start", "duration"],
};
static PUSH: Keys = Keys {
    home: "in a [[push]]",
    form: "a table, written [[push]]",
    names: &["body", "direction", "strength", "start", "duration"],
};
static SHAPE: Keys = Keys {
    home: "in the shape of a body",
    form: "a table such as { sphere = { stacks = 12, slices = 24 } }",
    names: Shape::NAMES,
};
/// The keys of each kind of shape.
static SHAPES: [Keys; Shape::KINDS.len()] = {
    let mut all = [const { Keys { home: "", form: "", names: &[] } }; Shape::KINDS.len()];
    let mut i = 0;
    while i < all.len() {
        let kind = &Shape::KINDS[i];
        all[i] = Keys { home: kind.home, form: kind.form, names: kind.keys };
        i += 1;
    }
    all
};
static MOTION: Keys = Keys {
    home: "in the motion of a body",
    form: "a table such as { fixed = [0, 0, 0] }",
    names: &["fixed", "line", "sine", "keyframes", "free"],
};
static LINE: Keys = Keys {
    home: "in motion = { line = { … } }",
    form: "a table such as { from = [0, 0, 0], velocity = [1, 0, 0] }",
    names: &["from", "velocity"],
};
static SINE: Keys = Keys {
    home: "in motion = { sine = { … } }",
    form: "a table such as { center = [0, 0, 0], amplitude = [1, 0, 0], frequency = 0.25 }",
    names: &["center", "amplitude", "frequency", "phase"],
};

static KEYFRAMES: Keys = Keys {
    home: "in motion = { keyframes = { … } }",
    form: "a table such as { keys = [[0, 0, 0, 0], [1, 2, 0, 0]], interpolation = \"linear\" }",
    names: &["keys", "interpolation"],
};
static FREE: Keys = Keys {
    home: "in motion = { free = { … } }",
    form: "a table such as { from = [0, 0, 1], velocity = [1, 0, 0] }",
    names: &["from", "velocity", "spin", "rotation"],
};

/// Every table, to find where a misplaced key belongs.
fn all_keys() -> impl Iterator<Item = &'static Keys> {
    let bodies =
        [&SCENE, &MATERIAL, &INFLUENCE, &LATTICE, &FEM, &SURFACE, &MESH, &BODY, &GRID, &PAIR, &PLANE, &PUSH, &SHAPE];
    bodies.into_iter().chain(&SHAPES).chain([&MOTION, &LINE, &SINE, &KEYFRAMES, &FREE])
}

const RESPONSE: Choice<Response, 3> =
    Choice([("rigid", Response::Rigid), ("inertial", Response::Inertial), ("world", Response::World)]);
const WEIGHT: Choice<Weight, 2> = Choice([("linear", Weight::Linear), ("wendland", Weight::Wendland)]);
const SCALING: Choice<Scaling, 2> = Choice([("relative", Scaling::Relative), ("absolute", Scaling::Absolute)]);
const APART_REPELS: Choice<bool, 2> = Choice([("repel", true), ("none", false)]);

/// Interpolation between the keys of a path.
type Interpolation = fn(&[(f64, DVec3)]) -> Spline;
const INTERPOLATION: Choice<Interpolation, 3> =
    Choice([("spline", Spline::new), ("linear", Spline::linear), ("hold", Spline::hold)]);
const ROTATION: Choice<Rotation, 2> = Choice([("free", Rotation::Free), ("fixed", Rotation::Fixed)]);

const SCENE_NAME: Text = Text { form: "a name of 1 to 200 characters on one line", accepts: is_scene_name };
const BODY_NAME: Text = Text { form: "a name of 1 to 64 letters, digits, - and _", accepts: is_body_name };
const GROUP_NAME: Text = Text { form: "a name of 1 to 64 letters, digits, - and _", accepts: is_body_name };
const COLOR: Text = Text { form: "a color \"#rrggbb\"", accepts: |text| color(text).is_some() };

impl Scene {
    /// The range of numbers that must be positive: radii, steps, tolerances, and so on.
    pub const POSITIVE: RangeInclusive<f64> = SMALLEST..=LARGEST;

    /// Maximum size of a scene's text [bytes].
    pub const LARGEST_TEXT: u64 = LARGEST_FILE;

    /// Loads the scene in the file at `path`.
    ///
    /// # Errors
    /// The file cannot be read, is larger than 32 MiB, is not UTF-8, or is rejected by [`Scene::parse`].
    pub fn load(path: &std::path::Path) -> Result<Scene, SceneError> {
        Scene::load_watched(path, &|_, _| ())
    }

    /// Like [`Scene::load`], with progress for large meshes: `watch` is called with the mesh file being read and the
    /// fraction done, from 0 to 1.
    ///
    /// # Errors
    /// Those of [`Scene::load`].
    pub fn load_watched(path: &std::path::Path, watch: Watch<'_>) -> Result<Scene, SceneError> {
        let file = path.display().to_string();
        let rejected =
            |message| SceneError { file: file.clone(), place: None, key: String::new(), message, help: None };
        let shown = one_line(&file);

        let bytes = read(path).map_err(|error| {
            rejected(format!("cannot read \"{shown}\": {error}")).with_help(
                "give the path of a scene file or the name of a built-in scene (`meldscope scenes` lists them)",
            )
        })?;
        if bytes.len() as u64 > LARGEST_FILE {
            let limit = LARGEST_FILE >> 20;
            return Err(rejected(format!("\"{shown}\" is larger than {limit} MiB, the limit for scene files")));
        }
        let text = std::str::from_utf8(&bytes).map_err(|error| {
            let offset = error.valid_up_to();
            let valid = String::from_utf8_lossy(&bytes[..offset]);
            let message = format!("not UTF-8: found the byte 0x{:02x} at offset {offset}", bytes[offset]);
            SceneError { place: Some(Place::of(&valid, offset)), ..rejected(message) }
                .with_help("save the file as UTF-8")
        })?;
        Scene::parse_with_files(text, path, watch)
    }

    /// Parses `text` as [`Scene::load`] would from the file at `path`: meshes are read from files, relative to its
    /// folder.
    ///
    /// # Errors
    /// Those of [`Scene::parse`]; or a mesh cannot be read or is not the surface of a body.
    pub fn parse_beside(text: &str, path: &std::path::Path) -> Result<Scene, SceneError> {
        Scene::parse_with_files(text, path, &|_, _| ())
    }

    fn parse_with_files(text: &str, path: &std::path::Path, watch: Watch<'_>) -> Result<Scene, SceneError> {
        let file = path.display().to_string();
        let folder = path.parent().unwrap_or(std::path::Path::new(""));
        on_deep_stack(|| read_scene(&Source { text, file: &file }, &mut Meshes::beside(Files::Folder(folder, watch))))
    }

    /// Parses a built-in scene, with its mesh files.
    pub(super) fn parse_given(
        text: &str,
        file: &str,
        meshes: &'static [(&'static str, &'static str)],
    ) -> Result<Scene, SceneError> {
        on_deep_stack(|| read_scene(&Source { text, file }, &mut Meshes::beside(Files::Given(meshes))))
    }

    /// The text of the scene's file, given [`Scene::source`]: without the embedded meshes.
    pub fn without_meshes(source: &str) -> &str {
        source.find(meshes::MARK).map_or(source, |end| &source[..end])
    }

    /// Parses `text`; `file` is its name in errors. Without its folder and extension, `file` is also the name of a
    /// scene whose text gives none.
    ///
    /// # Errors
    /// The first error: not TOML, an unknown, missing or repeated key, a value of the wrong type or out of range (see
    /// the [limits](self#limits)), inconsistent values, or a mesh that is not embedded in the text (no other file is
    /// read).
    pub fn parse(text: &str, file: &str) -> Result<Scene, SceneError> {
        on_deep_stack(|| read_scene(&Source { text, file }, &mut Meshes::beside(Files::None)))
    }
}

/// The content of the file at `path`, up to just beyond the size limit: the file may be endless.
fn read(path: &std::path::Path) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    File::open(path)?.take(LARGEST_FILE + 1).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Calls `work` with a stack large enough for the deepest tree that the TOML parser makes: inline tables may nest 80
/// deep and keys may have 80 parts, so 6,400 tables. Dropping each uses a stack frame, several MB in total without
/// optimisation.
pub(crate) fn on_deep_stack<T: Send>(work: impl Fn() -> T + Sync) -> T {
    std::thread::scope(|scope| {
        let thread = std::thread::Builder::new().stack_size(64 << 20).spawn_scoped(scope, &work);
        match thread.map(|thread| thread.join()) {
            Ok(Ok(result)) => result,
            Ok(Err(panic)) => std::panic::resume_unwind(panic),
            Err(_) => work(), // no thread available; ordinary files do not need the deep stack
        }
    })
}

fn read_scene(source: &Source<'_>, meshes: &mut Meshes<'_>) -> Result<Scene, SceneError> {
    let scene = read_document(source, &source.document()?, meshes)?;
    Ok(Scene { source: meshes.carried_by(source.text), ..scene })
}

/// The scene of a document, which may differ from the text; [`Scene::source`] is left empty.
pub(super) fn read_document(
    source: &Source<'_>,
    document: &DeTable<'_>,
    meshes: &mut Meshes<'_>,
) -> Result<Scene, SceneError> {
    let root = Table::root(source, document, &SCENE)?;

    // tables first, so that a key below the wrong header is reported as misplaced, not as missing where it belongs
    let material = root.table("material", &MATERIAL)?;
    let influence = root.table("influence", &INFLUENCE)?;
    let lattice = root.table("lattice", &LATTICE)?;
    let fem = root.table("fem", &FEM)?;
    let surface = root.table("surface", &SURFACE)?;
    let [body_array, grid_array, pair_array, plane_array, point_array, push_array] =
        ["body", "grid", "pair", "plane", "point", "push"].map(|name| root.get(name));
    let mesh_array = root.get("mesh");
    if body_array.is_none() && grid_array.is_none() {
        return Err(root.error("body", "missing, expected at least one [[body]]".to_owned()));
    }
    let body_tables = tables(&body_array, &BODY)?;
    let grid_tables = tables(&grid_array, &GRID)?;
    let mesh_tables = tables(&mesh_array, &MESH)?;
    let pair_tables = tables(&pair_array, &PAIR)?;
    let plane_tables = tables(&plane_array, &PLANE)?;
    let point_tables = tables(&point_array, &POINT)?;
    let push_tables = tables(&push_array, &PUSH)?;

    let name = root.optional("name", SCENE_NAME)?.unwrap_or_else(|| name_from(source.file));
    let dt = root.optional("dt", POSITIVE)?.unwrap_or(1.0 / 60.0);
    let duration = root.required("duration", POSITIVE)?;
    if let Some(value) = root.get("duration").filter(|_| duration / dt > MAX_STEPS) {
        return Err(value
            .unexpected(format_args!("at most {MAX_STEPS:e} steps of dt ({dt:?} s)"))
            .with_help("shorten duration or raise dt"));
    }
    let integrator = Choice(Integrator::ALL.map(|integrator| (integrator.name(), integrator)));
    let integrator = root.optional("integrator", integrator)?.unwrap_or(Integrator::Exponential);

    let tolerance = root.optional("tolerance", POSITIVE)?.unwrap_or(Scene::DEFAULT_TOLERANCE);

    let gravity = root.optional("gravity", Vector(ANY))?.unwrap_or(DVec3::ZERO);

    let model = root.optional("model", Choice(Model::ALL.map(|model| (model.name(), model))))?.unwrap_or_default();

    let blend = surface.optional("blend", BLEND)?.unwrap_or(fairing::BLEND);

    let (lattice, fem) = (read_lattice(&lattice)?, read_fem(&fem)?);

    let thesis = Material { omega: 12.0, damping: 1.5, response: Response::Inertial };
    let material = read_material(&material, thesis)?;
    meshes.embedded(&mesh_tables)?;
    let bodies = body_tables.iter().map(|table| read_body(table, material, meshes)).collect::<Result<Vec<_>, _>>()?;
    let (mut bodies, mut from) = (bodies, body_tables.iter().collect());
    grid::read(&grid_tables, material, meshes, &mut bodies, &mut from)?;
    if bodies.is_empty() {
        let array = body_array.as_ref().or(grid_array.as_ref());
        let message = "expected at least one [[body]], found an empty array".to_owned();
        return Err(array.map_or_else(|| root.error("body", message.clone()), |array| array.error(message.clone())));
    }
    let for_free = if bodies.iter().any(|body| body.path().is_none()) { ForFree::Core } else { ForFree::Nothing };
    let law = read_law(&influence, PairLaw { for_free, ..PairLaw::DEFAULT })?;
    let influence =
        Influence { alpha: law.alpha, beta: law.beta, apart_repels: law.apart_repels, ..read_influence(&influence)? };
    let names = Names::of(&bodies, &from)?;
    let pairs = pairs::read(&pair_tables, &bodies, &names, law)?;
    if let Some(array) = plane_array.as_ref().filter(|_| plane_tables.len() > MAX_PLANES) {
        let message = format!("expected at most {MAX_PLANES} planes, found {}", plane_tables.len());
        return Err(array.error(message).with_help("every vertex of a free body is tested against every plane"));
    }
    let planes = plane_tables.iter().map(read_plane).collect::<Result<_, _>>()?;
    let points = point::read(&point_tables, &bodies, &names, &influence)?;
    let pushes = push_tables.iter().map(|push| read_push(push, &bodies, &names)).collect::<Result<_, _>>()?;
    Ok(Scene {
        name,
        dt,
        duration,
        integrator,
        model,
        lattice,
        fem,
        tolerance,
        influence,
        thresholds: law.thresholds,
        core_width: law.core_width,
        for_free: law.for_free,
        pairs,
        gravity,
        planes,
        blend,
        bodies,
        points,
        pushes,
        source: String::new(),
    })
}

/// An optional array of tables.
fn tables<'a>(array: &'a Option<Value<'_>>, keys: &Keys) -> Result<Vec<Table<'a>>, SceneError> {
    array.as_ref().map_or(Ok(Vec::new()), |array| array.tables(keys))
}

/// The `[material]` table, or a body; missing keys are as in `default`.
fn read_material(table: &Table<'_>, default: Material) -> Result<Material, SceneError> {
    Ok(Material {
        omega: table.optional("omega", NON_NEGATIVE)?.unwrap_or(default.omega),
        damping: table.optional("damping", NON_NEGATIVE)?.unwrap_or(default.damping),
        response: table.optional("response", RESPONSE)?.unwrap_or(default.response),
    })
}

fn read_lattice(table: &Table<'_>) -> Result<cells::Lattice, SceneError> {
    let default = cells::Lattice::default();
    let tear = Choice(TearMode::ALL.map(|tear| (tear.name(), tear)));
    Ok(cells::Lattice {
        cells: table.optional("cells", CELLS)?.unwrap_or(default.cells),
        tear: table.optional("tear", tear)?.unwrap_or(default.tear),
        limit: table.optional("limit", STRAIN)?.unwrap_or(default.limit),
    })
}

fn read_fem(table: &Table<'_>) -> Result<cells::Fem, SceneError> {
    let default = cells::Fem::default();
    Ok(cells::Fem {
        cells: table.optional("cells", CELLS)?.unwrap_or(default.cells),
        young: table.optional("young", POSITIVE)?,
        poisson: table.optional("poisson", POISSON)?.unwrap_or(default.poisson),
        tear_stress: table.optional("tear_stress", POSITIVE)?,
    })
}

/// The `[influence]` table without the keys that a `[[pair]]` can set.
fn read_influence(table: &Table<'_>) -> Result<Influence, SceneError> {
    Ok(Influence {
        alpha: PairLaw::DEFAULT.alpha,
        beta: PairLaw::DEFAULT.beta,
        reach: table.optional("reach", POSITIVE)?.unwrap_or(std::f64::consts::SQRT_2),
        weight: table.optional("weight", WEIGHT)?.unwrap_or(Weight::Linear),
        scaling: table.optional("scaling", SCALING)?.unwrap_or(Scaling::Relative),
        apart_repels: PairLaw::DEFAULT.apart_repels,
    })
}

/// The `[influence]` table, or a `[[pair]]`; missing keys are as in `default`. With a default core for free bodies, it
/// follows `merge_at`.
fn read_law(table: &Table<'_>, default: PairLaw) -> Result<PairLaw, SceneError> {
    let Thresholds { merge_at, split_at, .. } = default.thresholds;
    let alpha = table.optional("alpha", NON_NEGATIVE)?.unwrap_or(default.alpha);
    let beta = table.optional("beta", NON_NEGATIVE)?.unwrap_or(default.beta);
    let apart_repels = table.optional("apart", APART_REPELS)?.unwrap_or(default.apart_repels);
    let merge_at = table.optional("merge_at", POSITIVE)?.unwrap_or(merge_at);
    let split_at = table.optional("split_at", POSITIVE)?.unwrap_or(split_at);
    let own_core_at = table.optional("core_at", NON_NEGATIVE)?;
    let core_width = table.optional("core_width", NON_NEGATIVE)?;
    let core_at = own_core_at.unwrap_or(match default.for_free {
        ForFree::Core => PairLaw::FREE_CORE_AT * merge_at,
        ForFree::Width | ForFree::Nothing => default.thresholds.core_at,
    });

    let by_default = |name| if table.get(name).is_some() { "" } else { " by default" };
    let merge_at_is = format!("merge_at ({merge_at:?}{})", by_default("merge_at"));
    if split_at < merge_at {
        if let Some(value) = table.get("split_at") {
            return Err(value.unexpected(format_args!("a number of at least {merge_at_is}")));
        }
        if let Some(value) = table.get("merge_at") {
            let expected = format_args!("a number of at most split_at ({split_at:?} by default)").to_string();
            return Err(value.unexpected(expected).with_help("give split_at, too"));
        }
    }
    if core_at >= merge_at {
        if let Some(value) = table.get("core_at") {
            return Err(value.unexpected(format_args!("a number below {merge_at_is}")));
        }
        if let Some(value) = table.get("merge_at") {
            let expected = format_args!("a number above core_at ({core_at:?} by default)").to_string();
            return Err(value.unexpected(expected).with_help("give core_at, too"));
        }
    }
    if core_at == 0.0
        && let (Some(value), Some(true)) = (table.get("core_width"), core_width.map(|width| width > 0.0))
    {
        return Err(value.unexpected("0 where there is no core").with_help("give core_at, too"));
    }
    let for_free = match default.for_free {
        ForFree::Core if own_core_at.is_none() => ForFree::Core,
        ForFree::Core | ForFree::Width if core_width.is_none() && core_at > 0.0 => ForFree::Width,
        _ => ForFree::Nothing,
    };
    let core_width = core_width.unwrap_or(match for_free {
        ForFree::Core | ForFree::Width => PairLaw::FREE_CORE_WIDTH * core_at,
        ForFree::Nothing if core_at == 0.0 => 0.0,
        ForFree::Nothing => default.core_width,
    });
    let thresholds = Thresholds { merge_at, split_at, core_at };
    Ok(PairLaw { alpha, beta, apart_repels, thresholds, core_width, for_free })
}

fn read_plane(table: &Table<'_>) -> Result<Plane, SceneError> {
    Ok(Plane {
        normal: read_direction(table, "normal")?,
        offset: table.optional("offset", ANY)?.unwrap_or(0.0),
        stiffness: table.optional("stiffness", NON_NEGATIVE)?.unwrap_or(4000.0),
        friction: table.optional("friction", NON_NEGATIVE)?.unwrap_or(0.0),
        slip: table.optional("slip", POSITIVE)?.unwrap_or(0.01),
    })
}

/// A nonzero vector, normalised.
fn read_direction(table: &Table<'_>, name: &'static str) -> Result<DVec3, SceneError> {
    let direction = table.required(name, Vector(FINITE))?;
    match table.get(name) {
        Some(value) if direction == DVec3::ZERO => {
            Err(value.error("expected a direction, found the zero vector".to_owned()))
        }
        _ => Ok(unit(direction)),
    }
}

/// A `[[body]]`, or the common description of the bodies of a `[[grid]]`.
fn read_body(table: &Table<'_>, material: Material, meshes: &mut Meshes<'_>) -> Result<Body, SceneError> {
    let name = table.required("name", BODY_NAME)?;
    let radius = table.required("radius", POSITIVE)?;
    let material = read_material(table, material)?;
    Ok(Body {
        name,
        radius,
        material,
        shape: read_shape(table, meshes)?,
        mass: table.optional("mass", POSITIVE)?.unwrap_or(radius * radius * radius),
        group: table.optional("group", GROUP_NAME)?,
        color: table.optional("color", COLOR)?.as_deref().and_then(color),
        force: None,
        motion: read_motion(table, |free| {
            check_response(table, &free, &material)?;
            Ok(Motion::Free(read_free(&free.into_table(&FREE)?)?))
        })?,
    })
}

/// `#rrggbb`
fn color(text: &str) -> Option<[u8; 3]> {
    let digits =
        text.strip_prefix('#').filter(|digits| digits.len() == 6 && digits.bytes().all(|b| b.is_ascii_hexdigit()))?;
    let [_, red, green, blue] = u32::from_str_radix(digits, 16).ok()?.to_be_bytes();
    Some([red, green, blue])
}

/// The names of a scene, resolved to bodies and groups.
struct Names {
    bodies: HashMap<String, u32>,
    groups: HashMap<String, u32>,
}

impl Names {
    /// # Errors
    /// Two bodies have the same name, or a body has the name of a group.
    fn of(bodies: &[Body], tables: &[&Table<'_>]) -> Result<Names, SceneError> {
        let mut names = Names { bodies: HashMap::with_capacity(bodies.len()), groups: HashMap::new() };
        for (index, (body, table)) in (0..).zip(bodies.iter().zip(tables)) {
            let Some(first) = names.bodies.insert(body.name.clone(), index) else { continue };
            if let (Some(first), Some(again)) = (tables[first as usize].get("name"), table.get("name")) {
                let expected =
                    format!("a name that no other body has (the body at line {} has this one)", first.line());
                return Err(again.unexpected(expected));
            }
        }
        for (body, table) in bodies.iter().zip(tables) {
            let Some(group) = &body.group else { continue };
            if let (Some(&other), Some(value)) = (names.bodies.get(group), table.get("group")) {
                let line = tables[other as usize].get("name").map_or(0, |name| name.line());
                return Err(
                    value.unexpected(format_args!("a name that no body has (the body at line {line} has this one)"))
                );
            }
            let next = names.groups.len() as u32;
            names.groups.entry(group.clone()).or_insert(next);
        }
        Ok(names)
    }
}

fn read_shape(body: &Table<'_>, meshes: &mut Meshes<'_>) -> Result<Shape, SceneError> {
    let Some(shape) = body.get("shape") else { return Ok(Shape::default()) };
    let table = shape.clone().into_table(&SHAPE)?;
    let mut given = Shape::KINDS.iter().zip(&SHAPES).filter(|(kind, _)| table.get(kind.name).is_some());
    let file = table.get("mesh");
    let kind = given.next();
    if given.next().is_some() || kind.is_some() && file.is_some() {
        return Err(shape.unexpected(SHAPE.form));
    }
    if let Some(file) = file {
        return meshes.shape(&file);
    }
    let (kind, keys) = kind.unwrap_or((&Shape::KINDS[0], &SHAPES[0]));
    let table = table.present(kind.name, keys.form)?;
    let table = table.into_table(keys)?;
    let parameters = kind.keys.iter().zip(kind.parameters).map(|(key, parameter)| {
        let Parameter { least: min, most: max, default } = *parameter;
        Ok(table.optional(key, Integer { min, max })?.unwrap_or(default))
    });
    Ok((kind.make)(&parameters.collect::<Result<Vec<_>, SceneError>>()?))
}

/// The motion of a body or of a force point; `free` reads `motion = { free = … }`.
fn read_motion<T: From<Path>>(
    owner: &Table<'_>,
    free: impl FnOnce(Value<'_>) -> Result<T, SceneError>,
) -> Result<T, SceneError> {
    let motion = owner.present("motion", MOTION.form)?;
    let table = motion.clone().into_table(&MOTION)?;
    let given: Vec<_> = MOTION.names.iter().copied().filter(|name| table.get(name).is_some()).collect();
    let [kind] = given[..] else {
        let found = if given.is_empty() { "none".to_owned() } else { given.join(" and ") };
        return Err(motion.error(format!("expected exactly one of {}, found {found}", MOTION.names.join(", "))));
    };
    let value = table.present(kind, MOTION.form)?;
    Ok(match kind {
        "fixed" => Path::Fixed(Vector(ANY).read(&value)?).into(),
        "line" => {
            let line = value.into_table(&LINE)?;
            let (from, velocity) = (line.required("from", Vector(ANY))?, line.required("velocity", Vector(ANY))?);
            Path::Line { from, velocity }.into()
        }
        "sine" => {
            let sine = value.into_table(&SINE)?;
            let path = Path::Sine {
                center: sine.required("center", Vector(ANY))?,
                amplitude: sine.required("amplitude", Vector(ANY))?,
                frequency: sine.required("frequency", NON_NEGATIVE)?,
                phase: sine.optional("phase", ANY)?.unwrap_or(0.0),
            };
            path.into()
        }
        "keyframes" => Path::Keyframes(read_keyframes(&value)?).into(),
        _ => free(value)?,
    })
}

fn read_free(table: &Table<'_>) -> Result<FreeMotion, SceneError> {
    Ok(FreeMotion {
        from: table.required("from", Vector(ANY))?,
        velocity: table.optional("velocity", Vector(ANY))?.unwrap_or(DVec3::ZERO),
        spin: table.optional("spin", Vector(ANY))?.unwrap_or(DVec3::ZERO),
        rotation: table.optional("rotation", ROTATION)?.unwrap_or(Rotation::Free),
    })
}

/// A free body is moved by the forces on its vertices, so only the inertial response makes sense.
fn check_response(body: &Table<'_>, motion: &Value<'_>, material: &Material) -> Result<(), SceneError> {
    if material.response == Response::Inertial {
        return Ok(());
    }
    match body.get("response") {
        Some(value) => Err(value.unexpected("\"inertial\", the response of every free body")),
        None => Err(motion
            .error("expected a body whose response is \"inertial\", found another one in [material]".to_owned())
            .with_help("give the body response = \"inertial\", the response of every free body")),
    }
}

fn read_keyframes(value: &Value<'_>) -> Result<Spline, SceneError> {
    if !value.is_table() {
        return Ok(Spline::new(&read_keys(value)?));
    }
    let table = value.clone().into_table(&KEYFRAMES)?;
    let keys = read_keys(&table.present("keys", KEYS)?)?;
    let interpolation = table.optional("interpolation", INTERPOLATION)?.unwrap_or(Spline::new);
    Ok(interpolation(&keys))
}

const KEYS: &str = "an array of two or more keys [t, x, y, z]";

fn read_keys(value: &Value<'_>) -> Result<Vec<(f64, DVec3)>, SceneError> {
    let items = value.items().filter(|items| items.len() >= 2);
    let items = items.ok_or_else(|| value.unexpected(KEYS))?;
    let mut keys: Vec<(f64, DVec3)> = Vec::with_capacity(items.len());
    for item in items {
        let [t, x, y, z] = item.numbers(ANY, "a key [t, x, y, z]")?;
        if let Some(&(previous, _)) = keys.last()
            && t - previous < SMALLEST
        {
            let expected = format!("a time at least {SMALLEST:e} after that of the previous key ({previous:?})");
            return Err(item
                .error(format!("expected {expected}, found {t:?}"))
                .with_help("the times of keys must increase"));
        }
        keys.push((t, DVec3::new(x, y, z)));
    }
    Ok(keys)
}

fn read_push(table: &Table<'_>, bodies: &[Body], names: &Names) -> Result<Push, SceneError> {
    let body = table.present("body", "the name of a body")?;
    let index = body.text().and_then(|name| names.bodies.get(name)).ok_or_else(|| {
        let known = || bodies.iter().map(|body| body.name.as_str());
        unknown_name(&body, "the name of a body", known)
    })?;
    Ok(Push {
        body: *index as usize,
        direction: read_direction(table, "direction")?,
        strength: table.required("strength", ANY)?,
        start: table.required("start", NON_NEGATIVE)?,
        duration: table.required("duration", NON_NEGATIVE)?,
    })
}

/// The error for a value that is not one of the `known` names.
fn unknown_name<'n, I: Iterator<Item = &'n str>>(
    value: &Value<'_>,
    expected: &str,
    known: impl Fn() -> I,
) -> SceneError {
    let hint = value.text().map_or(String::new(), |name| did_you_mean(name, known()));
    let listed: Vec<&str> = known().take(8).collect();
    let more = if known().nth(8).is_some() { ", …" } else { "" };
    let found = value.found();
    value.error(format!("expected {expected}, found {found}{hint} (bodies: {}{more})", listed.join(", ")))
}

/// `vector` / |`vector`| for any finite nonzero `vector`. It is first scaled near 1 by a power of two, which is exact,
/// because its squared length could overflow or underflow.
fn unit(vector: DVec3) -> DVec3 {
    let (_, exponent) = libm::frexp(vector.abs().max_element());
    let scaled = DVec3::from_array(vector.to_array().map(|x| libm::ldexp(x, -exponent)));
    scaled / scaled.length()
}

fn is_scene_name(name: &str) -> bool {
    (1..=200).contains(&name.chars().count()) && !name.chars().any(char::is_control)
}

/// The default name of a scene: the stem of its file, reduced to valid characters.
fn name_from(file: &str) -> String {
    let stem = std::path::Path::new(file).file_stem().unwrap_or_default().to_string_lossy();
    let name: String = stem.chars().filter(|c| !c.is_control()).take(200).collect();
    if name.is_empty() { "scene".to_owned() } else { name }
}
