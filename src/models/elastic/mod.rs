//! Simulation of bodies made of cells: the common part of lattices and finite elements.
//!
//! A body on a path follows it, held at the nodes of its core (those within half a radius of its centre). Its other
//! nodes are masses in body axes, moved by internal forces, and by the same accelerations as a vertex of the
//! oscillators at the same position: influence spheres by phase (3.4), (3.5), pushes, carry. Planes act on the vertices
//! of the surface, each of which distributes its force to the nodes of its cell.
//!
//! Only the core is held, rather than every node by a spring of its own, so that deformations travel through the body
//! and torn-off parts are not pulled back. No node of a free body is held: see `free`. How bodies are stepped: see
//! `driver`.
//!
//! If all bodies are on paths, phases change at the same times as those of the oscillators, up to rounding: both search
//! the same paths.

mod act;
mod body;
mod driver;
mod free;
mod friction;
mod observe;
#[cfg(test)]
mod tests;

use std::{
    collections::{BTreeMap, HashMap},
    sync::Arc,
    time::Duration,
};

use super::{Unsupported, cells::Cells, key_of};
use crate::{
    geometry::Shape,
    interrupt::is_raised,
    model::phase::Phase,
    observe::{BodyEvent, Instant, PairEvent, StepFailure},
    scene::{Integrator, Model, Motion, Path, Rotation, Scene, TearMode},
    sim::{Options, memory, reach::Grid},
    text::bytes,
};
use body::Body;
pub use observe::{all_scalars, schema};

/// The core of a body that is held [radii].
const CORE: f64 = 0.5;
/// The kinds of events of single bodies, each with when it happens.
pub const KINDS: [(&str, &str); 4] = [CUT_CELL, SPLIT_NODE, WOULD_TEAR, COLLAPSE];
const CUT_CELL: (&str, &str) = ("cut cell", "An overstretched spring of a lattice is cut, with its cell.");
const SPLIT_NODE: (&str, &str) = ("split node", "An overloaded node of a lattice is split.");
const WOULD_TEAR: (&str, &str) =
    ("would tear", "The tension of a finite element exceeds `tear_stress`; nothing tears.");
const COLLAPSE: (&str, &str) =
    ("collapse", "A lattice or finite-element body is squeezed to a fifth of its volume, or turned inside out.");

/// The bodies of a scene, made of cells.
pub struct Elastic {
    scene: Scene,
    options: Options,
    bodies: Vec<Body>,
    /// Whether a body is free.
    has_free: bool,
    /// The largest threshold on q [–].
    farthest: f64,
    /// Number of implicit steps in a step of the scene, for finite elements.
    divided: u64,
    /// Phases at the end of the last step, of pairs that are not apart.
    phases: BTreeMap<[u32; 2], Phase>,
    /// Broad phase: bounds of each body and of its influence sphere.
    grid: Grid,
    step: u64,
    events: Vec<PairEvent>,
    /// Tear events of the last step, including those of bodies that only would have torn; and bodies that it squeezed together.
    tears: Vec<BodyEvent>,
    failure: Option<StepFailure>,
    /// How long the last step took: finding sources, finding phase changes, and the rest.
    timings: [Duration; 3],
}

/// Rejects what the model does not support.
///
/// # Errors
/// [`Unsupported`], naming the key.
pub fn check(scene: &Scene) -> Result<(), Unsupported> {
    let unsupported = |key: &str, what: &str, remedy: &str| Err(Unsupported::new(scene, key, what, remedy));
    for body in &scene.bodies {
        if let Motion::Free(motion) = &body.motion {
            if motion.rotation == Rotation::Fixed {
                let (key, what) = (key_of(body, "motion.free.rotation"), "the nodes of a body determine its rotation");
                return unsupported(&key, what, "remove the key rotation, or choose model = \"oscillators\"");
            }
            if body.force.is_some() {
                let what = "a force set by a program";
                return unsupported(&key_of(body, "force"), what, "remove it, or choose model = \"oscillators\"");
            }
            if scene.integrator == Integrator::Euler {
                let what = format!("\"euler\" does not step a free body, as \"{}\" is", body.name);
                return unsupported("integrator", &what, "choose \"verlet\", or \"exponential\", the default");
            }
        }
        if body.material.omega == 0.0 {
            let (key, what) = (key_of(body, "omega"), "0: the stiffness is derived from omega");
            return unsupported(&key, what, "give it an omega above 0");
        }
    }
    let (scheme, remedy) = match scene.model {
        Model::Fem => (
            "finite elements take implicit steps",
            "remove the key integrator, or the option --integrator: with \"exponential\", the default, the model uses its own scheme",
        ),
        _ => (
            "a lattice takes steps of euler or verlet",
            "choose \"euler\" or \"verlet\", which step by dt, or \"exponential\", the default, with which the model divides dt",
        ),
    };
    Unsupported::edits(scene)?;
    let is_known = match scene.integrator {
        Integrator::Exponential => true,
        Integrator::Euler | Integrator::Verlet => scene.model != Model::Fem,
        _ => false,
    };
    if !is_known {
        return unsupported("integrator", &format!("\"{}\": {scheme}", scene.integrator), remedy);
    }
    Ok(())
}

impl Elastic {
    /// The scene at rest.
    ///
    /// # Errors
    /// A message: a program has given the scene a value that no scene file could have, the model does not support it, it needs
    /// too much memory, or building was interrupted.
    pub fn new(scene: Scene, options: Options) -> Result<Elastic, String> {
        scene.validate().map_err(|error| error.to_string())?;
        check(&scene).map_err(|error| error.to_string())?;
        let across = match scene.model {
            Model::Fem => scene.fem.cells,
            _ => scene.lattice.cells,
        };
        let left = memory_for_factors(&scene, across)?;
        let interrupted = || "interrupted while the bodies were built".to_owned();
        let mut covered: HashMap<&Shape, Arc<Cells>> = HashMap::new();
        let mut contact = 0.0;
        for body in &scene.bodies {
            if is_raised(options.interrupt) {
                return Err(interrupted());
            }
            if !covered.contains_key(&body.shape) {
                let mesh = body.shape.mesh();
                let cells = Cells::cover(&mesh, across, options.interrupt).ok_or_else(interrupted)?;
                contact = f64::max(contact, body::contact(&cells, &mesh));
                covered.insert(&body.shape, Arc::new(cells));
            }
        }
        let mut shared = body::Shared::new(left, &scene, contact);
        let mut bodies = Vec::with_capacity(scene.bodies.len());
        for (index, body) in scene.bodies.iter().enumerate() {
            if is_raised(options.interrupt) {
                return Err(interrupted());
            }
            let Some(cells) = covered.get(&body.shape).map(Arc::clone) else { continue };
            bodies.push(Body::new(&scene, index, cells, &mut shared, options.interrupt)?);
        }
        let divided = shared.divided;
        drop(covered);
        let mut elastic = Elastic {
            has_free: has_free(&scene),
            farthest: scene.laws().map(|law| law.thresholds.split_at).fold(0.0, f64::max),
            divided,
            scene,
            options,
            bodies,
            phases: BTreeMap::new(),
            grid: Grid::default(),
            step: 0,
            events: Vec::new(),
            tears: Vec::new(),
            failure: None,
            timings: [Duration::ZERO; 3],
        };
        elastic.find_sources(0.0, 0.0);
        for [a, b] in elastic.near_each_other() {
            let [i, j] = [a, b].map(|body| body as usize);
            let q =
                elastic.centre(i).distance(elastic.centre(j)) / (elastic.bodies[i].radius + elastic.bodies[j].radius);
            let phase = elastic.scene.law(i, j).thresholds.initial(q);
            if phase != Phase::Apart {
                elastic.phases.insert([a, b], phase);
            }
        }
        Ok(elastic)
    }

    /// The time after a number of steps [s].
    fn time_of(&self, step: u64) -> f64 {
        step as f64 * self.scene.dt
    }

    /// The path of a body.
    fn path(&self, body: usize) -> Option<&Path> {
        self.scene.bodies[body].path()
    }

    /// Counts the step that ends at `time`, and collects its tear events.
    fn end_step(&mut self, time: f64) {
        self.step += 1;
        let (name, _) = match (self.scene.model, self.scene.lattice.tear) {
            (Model::Fem, _) => WOULD_TEAR,
            (_, TearMode::Split) => SPLIT_NODE,
            _ => CUT_CELL,
        };
        for index in 0..self.bodies.len() {
            let centre = self.centre(index);
            let body = &mut self.bodies[index];
            let step = self.step;
            let event = |name, place| BodyEvent { name, time, step, body: index, place };
            self.tears.extend(body.tears.iter().map(|&place| event(name, place)));
            let has_collapsed = !body.is_at_rest && body.has_collapsed();
            if has_collapsed && !body.is_collapsed {
                self.tears.push(event(COLLAPSE.0, centre));
            }
            body.is_collapsed = has_collapsed;
        }
    }

    /// Simulated time [s].
    fn now(&self) -> Instant {
        Instant { step: self.step, time: self.time_of(self.step) }
    }
}

/// Whether a body of a scene is free.
fn has_free(scene: &Scene) -> bool {
    scene.bodies.iter().any(|body| body.path().is_none())
}

/// Notes the phase that a pair enters; pairs that are apart are not listed.
fn note_phase(phases: &mut BTreeMap<[u32; 2], Phase>, event: &PairEvent) {
    let pair = [event.a as u32, event.b as u32];
    match Phase::ALL.get(event.to) {
        None | Some(Phase::Apart) => _ = phases.remove(&pair),
        Some(&phase) => _ = phases.insert(pair, phase),
    }
}

/// Memory that is left for the factors of finite elements [bytes].
///
/// # Errors
/// The scene needs more memory than is available.
fn memory_for_factors(scene: &Scene, across: u32) -> Result<u64, String> {
    let mut shapes = std::collections::HashSet::new();
    let mut kinds = std::collections::HashSet::new();
    let (mut needed, mut for_bodies) = (0u64, 0u64);
    for body in &scene.bodies {
        let vertices = body.shape.vertex_count();
        if shapes.insert(&body.shape) {
            needed = needed.saturating_add(Cells::most_memory(across, vertices));
        }
        let is_new = kinds.insert((
            &body.shape,
            [body.radius, body.mass, body.material.omega, body.material.damping].map(f64::to_bits),
            body.path().is_none(),
        ));
        for_bodies = for_bodies.saturating_add(body::max_memory(scene, across, vertices, is_new));
    }
    needed = needed.saturating_add(for_bodies);
    let available = memory::available();
    if needed / 9 * 10 > available {
        return Err(format!(
            "scene \"{}\" is too large for this machine: {} bodies of up to {across}³ cells need about {}, and {} are available; lower \
             `cells` in [{}], or use fewer bodies",
            scene.name,
            scene.bodies.len(),
            bytes(needed),
            bytes(available),
            scene.model
        ));
    }
    Ok(available / 10 * 9 - needed.min(available / 10 * 9))
}
