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

mod edit;
mod error;
mod grid;
mod meshes;
mod pairs;
mod point;
pub(crate) mod reader;

use std::{collections::HashMap, fs::File, io, io::Read as _, ops::RangeInclusive};

use glam::DVec3;
use toml::de::DeTable;

use super::{
    Body, FreeMotion, Integrator, Material, Model, Motion, Path, Plane, Push, Response, Scene, TearMode, cells,
    keys::{self, ANY, LARGEST, SMALLEST, Section, color},
    path::Spline,
};
use crate::{
    geometry::Shape,
    model::{ForFree, PairLaw, influence::Influence, phase::Thresholds},
    text::did_you_mean,
};
use error::one_line;
pub use error::{Place, SceneError};
pub use meshes::Watch;
pub(super) use meshes::{Files, Meshes};
use reader::{Source, Table, Value};

/// See the [limits](self#limits).
pub(super) const MAX_STEPS: f64 = 1e12;
const LARGEST_FILE: u64 = 32 << 20;

/// The arrays of tables of a scene, written `[[body]]`, except for meshes.
pub(super) const ARRAYS: [&str; 7] = ["body", "grid", "pair", "plane", "point", "push", "edit"];

/// Limit on the planes of a scene.
pub(super) const MAX_PLANES: usize = 1000;

/// A key of the [table](keys), found when the program is built.
macro_rules! key {
    ($group:ident.$name:ident) => {
        const { $crate::scene::keys::find(&$crate::scene::keys::$group, stringify!($name)) }
    };
}
pub(super) use key;

impl Scene {
    /// The range of numbers that must be positive: radii, steps, tolerances, and so on.
    pub const POSITIVE: RangeInclusive<f64> = SMALLEST..=LARGEST;

    /// Maximum size of a scene's text [bytes].
    pub const LARGEST_TEXT: u64 = LARGEST_FILE;

    /// Whether a text is that of a sweep, not of a scene.
    pub fn is_sweep(text: &str) -> bool {
        on_deep_stack(|| DeTable::parse(text).is_ok_and(|document| is_of_sweep(document.get_ref())))
    }

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
        let rejected = |message| SceneError::plain(&file, message);
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
        parse_beside(Scene::text_of(&bytes, path)?, path, watch)
    }

    /// The text of a scene file.
    ///
    /// # Errors
    /// It is not UTF-8, or has a NUL, as UTF-16 does.
    pub fn text_of<'a>(bytes: &'a [u8], path: &std::path::Path) -> Result<&'a str, SceneError> {
        let (offset, what) = match std::str::from_utf8(bytes).map(|text| (text, text.find('\0'))) {
            Ok((text, None)) => return Ok(text),
            Ok((_, Some(nul))) => (nul, "no text, or UTF-16"),
            Err(error) => (error.valid_up_to(), "not UTF-8"),
        };
        let valid = String::from_utf8_lossy(&bytes[..offset]);
        let message = format!("{what}: found the byte 0x{:02x} at offset {offset}", bytes[offset]);
        let place = Some(Place::of(&valid, offset));
        Err(SceneError { place, ..SceneError::plain(&path.display().to_string(), message) }
            .with_help("save the file as UTF-8"))
    }

    /// Parses `text` as [`Scene::load`] would from the file at `path`: meshes are read from files, relative to its
    /// folder.
    ///
    /// # Errors
    /// Those of [`Scene::parse`]; or a mesh cannot be read or is not the surface of a body.
    pub fn parse_beside(text: &str, path: &std::path::Path) -> Result<Scene, SceneError> {
        parse_beside(text, path, &|_, _| ())
    }

    /// Parses a built-in scene, with its mesh files.
    pub(super) fn parse_given(
        text: &str,
        file: &str,
        meshes: &'static [(&'static str, &'static str)],
    ) -> Result<Scene, SceneError> {
        parse(text, file, Files::Given(meshes))
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
        parse(text, file, Files::None)
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

/// Parses a text as that of the file at `path`.
fn parse_beside(text: &str, path: &std::path::Path, watch: Watch<'_>) -> Result<Scene, SceneError> {
    let folder = path.parent().unwrap_or(std::path::Path::new(""));
    parse(text, &path.display().to_string(), Files::Folder(folder, watch))
}

/// Parses a text; `file` is its name in errors, and `files` are the meshes that it may name.
fn parse(text: &str, file: &str, files: Files<'_>) -> Result<Scene, SceneError> {
    on_deep_stack(|| {
        let (source, mut meshes) = (Source { text, file }, Meshes::beside(files));
        let scene = read_document(&source, &source.document()?, &mut meshes)?;
        Ok(Scene { source: meshes.carried_by(text), ..scene })
    })
}

fn is_of_sweep(document: &DeTable<'_>) -> bool {
    document.get("axis").is_some() && document.get("body").is_none() && document.get("grid").is_none()
}

/// The scene of a document, which may differ from the text; [`Scene::source`] is left empty.
pub(super) fn read_document(
    source: &Source<'_>,
    document: &DeTable<'_>,
    meshes: &mut Meshes<'_>,
) -> Result<Scene, SceneError> {
    if is_of_sweep(document) {
        let file = source.file;
        let help = format!("`{} sweep {file}` runs it", crate::text::program());
        return Err(SceneError::plain(file, format!("{file} is a sweep, not a scene")).with_help(&help));
    }
    let root = Table::root(source, document, &keys::SCENE)?;

    // tables first, so that a key below the wrong header is reported as misplaced, not as missing where it belongs
    let material = root.table("material", &keys::MATERIAL)?;
    let influence = root.table("influence", &keys::INFLUENCE)?;
    let lattice = root.table("lattice", &keys::LATTICE)?;
    let fem = root.table("fem", &keys::FEM)?;
    let surface = root.table("surface", &keys::SURFACE)?;
    let [body_array, grid_array, pair_array, plane_array, point_array, push_array, edit_array] =
        ARRAYS.map(|name| root.get(name));
    let mesh_array = root.get("mesh");
    if body_array.is_none() && grid_array.is_none() {
        return Err(root.error("body", "missing, expected at least one [[body]]".to_owned()));
    }
    let body_tables = tables(&body_array, &keys::BODY)?;
    let grid_tables = tables(&grid_array, &keys::GRID)?;
    let mesh_tables = tables(&mesh_array, &keys::MESH)?;
    let pair_tables = tables(&pair_array, &keys::PAIR)?;
    let plane_tables = tables(&plane_array, &keys::PLANE)?;
    let point_tables = tables(&point_array, &keys::POINT)?;
    let push_tables = tables(&push_array, &keys::PUSH)?;
    let edit_tables = tables(&edit_array, &keys::EDIT)?;

    let name = root.given_text(key!(TOP.name))?.unwrap_or_else(|| name_from(source.file));
    let dt = root.number(key!(TOP.dt))?;
    let duration = root.number(key!(TOP.duration))?;
    if let Some(value) = root.get("duration").filter(|_| duration / dt > MAX_STEPS) {
        return Err(value
            .unexpected(format_args!("at most {MAX_STEPS:e} steps of dt ({dt:?} s)"))
            .with_help("shorten duration or raise dt"));
    }
    let integrator =
        root.word(key!(TOP.integrator), &Integrator::ALL.map(|integrator| (integrator.name(), integrator)))?;
    let tolerance = root.number(key!(TOP.tolerance))?;
    let gravity = root.vector(key!(TOP.gravity))?;
    let model = root.word(key!(TOP.model), &Model::ALL.map(|model| (model.name(), model)))?;
    let blend = surface.number(key!(SURFACES.blend))?;

    let (lattice, fem) = (read_lattice(&lattice)?, read_fem(&fem)?);

    let material = Material {
        omega: material.number(key!(OSCILLATOR.omega))?,
        damping: material.number(key!(OSCILLATOR.damping))?,
        response: material.word(key!(OSCILLATOR.response), &keys::RESPONSES)?,
    };
    meshes.embedded(&mesh_tables)?;
    let inherited = Inherited { material, reach: influence.number(key!(REACH.reach))? };
    let bodies = body_tables.iter().map(|table| read_body(table, inherited, meshes)).collect::<Result<Vec<_>, _>>()?;
    let (mut bodies, mut from) = (bodies, body_tables.iter().collect());
    grid::read(&grid_tables, inherited, meshes, &mut bodies, &mut from)?;
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
    let mut scene = Scene {
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
        edits: Vec::new(),
        source: String::new(),
        set: Vec::new(),
        pushed_out: Vec::new(),
    };
    scene.push_out();
    let edits = edit::read(source, document, meshes, &edit_tables, &scene)?;
    Ok(Scene { edits, ..scene })
}

/// An optional array of tables.
fn tables<'a>(array: &'a Option<Value<'_>>, section: &Section) -> Result<Vec<Table<'a>>, SceneError> {
    array.as_ref().map_or(Ok(Vec::new()), |array| array.tables(section))
}

fn read_lattice(table: &Table<'_>) -> Result<cells::Lattice, SceneError> {
    Ok(cells::Lattice {
        cells: table.integer(key!(LATTICES.cells))?,
        tear: table.word(key!(LATTICES.tear), &TearMode::ALL.map(|tear| (tear.name(), tear)))?,
        limit: table.number(key!(LATTICES.limit))?,
    })
}

fn read_fem(table: &Table<'_>) -> Result<cells::Fem, SceneError> {
    Ok(cells::Fem {
        cells: table.integer(key!(ELEMENTS.cells))?,
        young: table.given_number(key!(ELEMENTS.young))?,
        poisson: table.number(key!(ELEMENTS.poisson))?,
        tear_stress: table.given_number(key!(ELEMENTS.tear_stress))?,
    })
}

/// The `[influence]` table without the keys that a `[[pair]]` can set.
fn read_influence(table: &Table<'_>) -> Result<Influence, SceneError> {
    Ok(Influence {
        alpha: PairLaw::DEFAULT.alpha,
        beta: PairLaw::DEFAULT.beta,
        reach: table.number(key!(REACH.reach))?,
        weight: table.word(key!(SPHERE.weight), &keys::WEIGHTS)?,
        scaling: table.word(key!(SPHERE.scaling), &keys::SCALINGS)?,
        apart_repels: PairLaw::DEFAULT.apart_repels,
    })
}

/// The `[influence]` table, or a `[[pair]]`; missing keys are as in `default`. With a default core for free bodies, it
/// follows `merge_at`.
fn read_law(table: &Table<'_>, default: PairLaw) -> Result<PairLaw, SceneError> {
    let Thresholds { merge_at, split_at, .. } = default.thresholds;
    let alpha = table.given_number(key!(STRENGTH.alpha))?.unwrap_or(default.alpha);
    let beta = table.given_number(key!(STRENGTH.beta))?.unwrap_or(default.beta);
    let apart_repels = table.given_word(key!(PHASES.apart), &keys::APART_REPELS)?.unwrap_or(default.apart_repels);
    let merge_at = table.given_number(key!(PHASES.merge_at))?.unwrap_or(merge_at);
    let split_at = table.given_number(key!(PHASES.split_at))?.unwrap_or(split_at);
    let own_core_at = table.given_number(key!(PHASES.core_at))?;
    let core_width = table.given_number(key!(PHASES.core_width))?;
    let core_at = own_core_at.unwrap_or(match default.for_free {
        ForFree::Core | ForFree::CoreOfWidth => PairLaw::FREE_CORE_AT * merge_at,
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
        ForFree::Core if own_core_at.is_none() && core_width.is_none() => ForFree::Core,
        ForFree::Core | ForFree::CoreOfWidth if own_core_at.is_none() => ForFree::CoreOfWidth,
        ForFree::Core | ForFree::Width if core_width.is_none() && core_at > 0.0 => ForFree::Width,
        _ => ForFree::Nothing,
    };
    let core_width = core_width.unwrap_or(match for_free {
        ForFree::Core | ForFree::Width => PairLaw::FREE_CORE_WIDTH * core_at,
        ForFree::Nothing if core_at == 0.0 => 0.0,
        ForFree::Nothing | ForFree::CoreOfWidth => default.core_width,
    });
    let thresholds = Thresholds { merge_at, split_at, core_at };
    Ok(PairLaw { alpha, beta, apart_repels, thresholds, core_width, for_free })
}

fn read_plane(table: &Table<'_>) -> Result<Plane, SceneError> {
    Ok(Plane {
        normal: read_direction(table, key!(PLANES.normal))?,
        offset: table.number(key!(PLANES.offset))?,
        stiffness: table.number(key!(PLANES.stiffness))?,
        friction: table.number(key!(PLANES.friction))?,
        slip: table.number(key!(PLANES.slip))?,
    })
}

/// A nonzero vector, normalised.
fn read_direction(table: &Table<'_>, key: &keys::Key) -> Result<DVec3, SceneError> {
    let direction = table.vector(key)?;
    match table.get(key.name) {
        Some(value) if direction == DVec3::ZERO => {
            Err(value.error("expected a direction, found the zero vector".to_owned()))
        }
        _ => Ok(unit(direction)),
    }
}

/// The values of bodies that have none of their own.
#[derive(Clone, Copy)]
struct Inherited {
    material: Material,
    reach: f64,
}

/// A `[[body]]`, or the common description of the bodies of a `[[grid]]`.
fn read_body(table: &Table<'_>, inherited: Inherited, meshes: &mut Meshes<'_>) -> Result<Body, SceneError> {
    let Inherited { material, reach } = inherited;
    let name = table.text(key!(BODIES.name))?;
    let radius = table.number(key!(BODIES.radius))?;
    let material = Material {
        omega: table.given_number(key!(OSCILLATOR.omega))?.unwrap_or(material.omega),
        damping: table.given_number(key!(OSCILLATOR.damping))?.unwrap_or(material.damping),
        response: table.given_word(key!(OSCILLATOR.response), &keys::RESPONSES)?.unwrap_or(material.response),
    };
    Ok(Body {
        name,
        radius,
        reach: table.given_number(key!(REACH.reach))?.unwrap_or(reach),
        material,
        shape: read_shape(table, meshes)?,
        mass: table.given_number(key!(BODIES.mass))?.unwrap_or(radius * radius * radius),
        group: table.given_text(key!(BODIES.group))?,
        color: table.given_text(key!(BODIES.color))?.as_deref().and_then(color),
        force: None,
        motion: read_motion(table, |free| {
            check_response(table, &free, &material)?;
            Ok(Motion::Free(read_free(&free.into_table(&keys::FREE)?)?))
        })?,
    })
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
                let line = first.line();
                let whose = match again.text() == Some(body.name.as_str()) {
                    true => format!("the body at line {line} has this one"),
                    false => format!("the body or grid at line {line} has the name \"{}\" of one of them", body.name),
                };
                let expected = format!("a name that no other body has ({whose})");
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
    let table = shape.clone().into_table(&keys::SHAPE)?;
    let names: Vec<&'static str> = Shape::KINDS.iter().map(|kind| kind.name).chain(["mesh"]).collect();
    let given = match given(&table, &names)[..] {
        [] => Shape::KINDS[0].name,
        [only] => only,
        ref several => return Err(not_one(&shape, &names, several)),
    };
    let mut kinds = Shape::KINDS.iter().zip(&*keys::SOLIDS);
    let Some((kind, section)) = kinds.find(|(kind, _)| kind.name == given) else {
        return meshes.shape(&table.present(given, keys::SHAPE_FORM)?);
    };
    let table = table.present(kind.name, section.form)?.into_table(section)?;
    let parameters = section.all().map(|key| table.integer(key)).collect::<Result<Vec<_>, SceneError>>()?;
    Ok((kind.make)(&parameters))
}

/// Those of some keys that a table has.
fn given(table: &Table<'_>, names: &[&'static str]) -> Vec<&'static str> {
    names.iter().copied().filter(|name| table.get(name).is_some()).collect()
}

/// A table, the value `of` a key, should have exactly one of some keys.
fn not_one(of: &Value<'_>, names: &[&str], given: &[&str]) -> SceneError {
    let found = if given.is_empty() { "none".to_owned() } else { given.join(" and ") };
    of.error(format!("expected exactly one of {}, found {found}", names.join(", ")))
}

/// The motion of a body or of a force point; `free` reads `motion = { free = … }`.
fn read_motion<T: From<Path>>(
    owner: &Table<'_>,
    free: impl FnOnce(Value<'_>) -> Result<T, SceneError>,
) -> Result<T, SceneError> {
    let motion = owner.present("motion", keys::MOTION_FORM)?;
    let table = motion.clone().into_table(&keys::MOTION)?;
    let names: Vec<_> = keys::MOTIONS.iter().map(|key| key.name).collect();
    let given = given(&table, &names);
    let [kind] = given[..] else { return Err(not_one(&motion, &names, &given)) };
    let value = table.present(kind, keys::MOTION_FORM)?;
    Ok(match kind {
        "fixed" => Path::Fixed(value.vector(ANY)?).into(),
        "line" => {
            let line = value.into_table(&keys::LINE)?;
            let (from, velocity) = (line.vector(key!(LINES.from))?, line.vector(key!(LINES.velocity))?);
            Path::Line { from, velocity }.into()
        }
        "sine" => {
            let sine = value.into_table(&keys::SINE)?;
            let path = Path::Sine {
                center: sine.vector(key!(SINES.center))?,
                amplitude: sine.vector(key!(SINES.amplitude))?,
                frequency: sine.number(key!(SINES.frequency))?,
                phase: sine.number(key!(SINES.phase))?,
            };
            path.into()
        }
        "keyframes" => Path::Keyframes(read_keyframes(&value)?).into(),
        _ => free(value)?,
    })
}

fn read_free(table: &Table<'_>) -> Result<FreeMotion, SceneError> {
    Ok(FreeMotion {
        from: table.vector(key!(FREES.from))?,
        velocity: table.vector(key!(FREES.velocity))?,
        spin: table.vector(key!(FREES.spin))?,
        rotation: table.word(key!(FREES.rotation), &keys::ROTATIONS)?,
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
    let table = value.clone().into_table(&keys::KEYFRAMES)?;
    let keys = read_keys(&table.present("keys", keys::KEYS_FORM)?)?;
    let interpolation: keys::Interpolation = table.word(key!(PATHS.interpolation), &keys::INTERPOLATIONS)?;
    Ok(interpolation(&keys))
}

fn read_keys(value: &Value<'_>) -> Result<Vec<(f64, DVec3)>, SceneError> {
    let items = value.items().filter(|items| items.len() >= 2);
    let items = items.ok_or_else(|| value.unexpected(keys::KEYS_FORM))?;
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
        direction: read_direction(table, key!(PUSHES.direction))?,
        strength: table.number(key!(PUSHES.strength))?,
        start: table.number(key!(PUSHES.start))?,
        duration: table.number(key!(PUSHES.duration))?,
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

/// The default name of a scene: the stem of its file, reduced to valid characters.
fn name_from(file: &str) -> String {
    let stem = std::path::Path::new(file).file_stem().unwrap_or_default().to_string_lossy();
    let name: String = stem.chars().filter(|c| !c.is_control()).take(200).collect();
    if name.is_empty() { "scene".to_owned() } else { name }
}
