//! Simulation of bodies made of cells: the common part of lattices and finite elements.
//!
//! A body on a path follows it, held at the nodes of its core (those within half a radius of its centre). Its other
//! nodes are masses in body axes, moved by internal forces, and by the same accelerations as a vertex of the
//! oscillators at the same position: influence spheres by phase (3.4), (3.5), pushes, carry. Planes act on the vertices
//! of the surface, each of which distributes its force to the nodes of its cell.
//!
//! Only the core is held, rather than every node by a spring of its own, so that deformations travel through the body
//! and torn-off parts are not pulled back. No node of a free body is held: see `coupled`.
//!
//! If all bodies are on paths, phases change at the same times as those of the oscillators, to the bit: a [`World`] of
//! the same bodies without forces finds the events.

mod act;
mod body;
mod coupled;
mod observe;
#[cfg(test)]
mod tests;

use std::{
    collections::{BTreeMap, HashMap},
    sync::Arc,
    time::{Duration, Instant as Clock},
};

use super::{Unsupported, cells::Cells};
use crate::{
    geometry::{Shape, Sphere},
    interrupt::is_raised,
    model::phase::Phase,
    observe::{BodyEvent, Instant, PairEvent, StepFailure},
    parallel,
    scene::{self, Integrator, Model, Motion, Path, Rotation, Scene, TearMode},
    sim::{
        Options, World, memory,
        reach::{Ball, Grid},
    },
    text::bytes,
};
use act::StepContext;
use body::Body;
pub use observe::{all_scalars, schema};

/// The core of a body that is held [radii].
const CORE: f64 = 0.5;
/// The kinds of events of single bodies, each with when it happens.
pub const KINDS: [(&str, &str); 3] = [CUT_CELL, SPLIT_NODE, WOULD_TEAR];
const CUT_CELL: (&str, &str) = ("cut cell", "An overstretched spring of a lattice is cut, with its cell.");
const SPLIT_NODE: (&str, &str) = ("split node", "An overloaded node of a lattice is split.");
const WOULD_TEAR: (&str, &str) =
    ("would tear", "The tension of a finite element exceeds `tear_stress`; nothing tears.");
/// With fewer nodes than this, a second thread does not pay off.
const PARALLEL_NODES: usize = 128;

/// The bodies of a scene, made of cells.
pub struct Elastic {
    scene: Scene,
    options: Options,
    /// The bodies without forces, to find phase changes; `None` with free bodies.
    world: Option<World>,
    bodies: Vec<Body>,
    /// Memory of data shared by bodies [bytes].
    shared: usize,
    /// Phases at the end of the last step, of pairs that are not apart.
    phases: BTreeMap<[u32; 2], Phase>,
    /// Broad phase: bounds of each body and of its influence sphere.
    grid: Grid,
    step: u64,
    events: Vec<PairEvent>,
    /// Tear events of the last step, including those of bodies that only would have torn.
    tears: Vec<BodyEvent>,
    failure: Option<StepFailure>,
    timings: [Duration; 3],
}

/// Rejects what the model does not support.
///
/// # Errors
/// [`Unsupported`], naming the body and the key.
pub fn check(scene: &Scene) -> Result<(), Unsupported> {
    let unsupported =
        |body: Option<&scene::Body>, what: &str, remedy: &str| Err(Unsupported::new(scene, body, what, remedy));
    for body in &scene.bodies {
        if let Motion::Free(motion) = &body.motion {
            if motion.rotation == Rotation::Fixed {
                let what = "rotation = \"fixed\": the nodes of a body determine its rotation";
                return unsupported(Some(body), what, "remove the key rotation, or choose model = \"oscillators\"");
            }
            if body.force.is_some() {
                let what = "a force set by a program";
                return unsupported(Some(body), what, "remove it, or choose model = \"oscillators\"");
            }
            if scene.integrator == Integrator::Euler {
                let what = "integrator = \"euler\" with motion = { free = … }";
                return unsupported(Some(body), what, "choose \"verlet\", or \"exponential\", the default");
            }
        }
        if body.material.omega == 0.0 {
            let what = "omega = 0: its stiffness is derived from omega";
            return unsupported(Some(body), what, "give it an omega above 0");
        }
    }
    let (scheme, remedy) = match scene.model {
        Model::Fem => (
            "finite elements take implicit steps",
            "remove the key integrator: with \"exponential\", the default, the model uses its own scheme",
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
        return unsupported(None, &format!("integrator = \"{}\": {scheme}", scene.integrator), remedy);
    }
    Ok(())
}

/// The bodies of a scene without forces, with as few vertices as possible.
fn rigid(scene: &Scene) -> Scene {
    let mut rigid = Scene { integrator: Integrator::Exponential, ..scene.without_forces() };
    rigid.bodies.iter_mut().for_each(|body| body.shape = Shape::Sphere(Sphere { stacks: 2, slices: 3 }));
    rigid
}

impl Elastic {
    /// The scene at rest.
    ///
    /// # Errors
    /// A message: the model does not support the scene, it needs too much memory, or building was interrupted.
    pub fn new(scene: Scene, options: Options) -> Result<Elastic, String> {
        check(&scene).map_err(|error| error.to_string())?;
        let across = match scene.model {
            Model::Fem => scene.fem.cells,
            _ => scene.lattice.cells,
        };
        let left = memory_for_factors(&scene, across)?;
        let interrupted = || "interrupted while the bodies were built".to_owned();
        let is_coupled = coupled::is_coupled(&scene);
        let (mut world, mut phases) = (None, BTreeMap::new());
        if is_coupled {
            phases = first_phases(&scene);
        } else {
            let rigid = World::with_options(rigid(&scene), options).map_err(|error| error.to_string())?;
            let joined = rigid.pairs().filter(|pair| pair.phase != Phase::Apart);
            phases.extend(joined.map(|pair| ([pair.a as u32, pair.b as u32], pair.phase)));
            world = Some(rigid);
        }
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
        let mut shared = body::Shared::new(left, &scene, is_coupled.then_some(contact));
        let mut bodies = Vec::with_capacity(scene.bodies.len());
        for (index, body) in scene.bodies.iter().enumerate() {
            if is_raised(options.interrupt) {
                return Err(interrupted());
            }
            let Some(cells) = covered.get(&body.shape).map(Arc::clone) else { continue };
            bodies.push(Body::new(&scene, index, cells, &mut shared, options.interrupt)?);
        }
        let shared = covered.values().map(|cells| cells.memory()).sum::<usize>() + shared.memory();
        drop(covered);
        Ok(Elastic {
            scene,
            options,
            world,
            bodies,
            shared,
            phases,
            grid: Grid::default(),
            step: 0,
            events: Vec::new(),
            tears: Vec::new(),
            failure: None,
            timings: [Duration::ZERO; 3],
        })
    }

    /// The time after a number of steps [s].
    fn time_of(&self, step: u64) -> f64 {
        step as f64 * self.scene.dt
    }

    /// The path of a body.
    fn path(&self, body: usize) -> Option<&Path> {
        self.scene.bodies[body].path()
    }

    fn take_step(&mut self) {
        if self.failure.as_ref().is_some_and(|failure| !failure.is_whole_step()) {
            return;
        }
        let (start, end) = (self.time_of(self.step), self.time_of(self.step + 1));
        let begun = Clock::now();
        self.failure = None;
        self.events.clear();
        self.tears.clear();
        if self.world.is_none() {
            if let Err(failure) = self.take_coupled(start, end) {
                self.failure = Some(failure);
                return;
            }
            self.timings = [Duration::ZERO, Duration::ZERO, begun.elapsed()];
            self.end_step(end);
            return;
        }
        if let Some(world) = &mut self.world {
            let report = world.step();
            self.events.extend(report.events.iter().map(PairEvent::from));
            self.failure = report.failure.as_ref().map(StepFailure::from);
        }
        if self.failure.is_some() {
            return;
        }
        let found = Clock::now();
        self.find_sources(start, end);
        let reached = Clock::now();

        let Elastic { scene, bodies, phases, events, options, step, .. } = self;
        let around = StepContext { scene, phases, events, start, end, step: *step + 1 };
        let nodes: usize = bodies.iter().filter(|body| !body.sleeps(&around)).map(Body::node_count).sum();
        let jumps = around.jumps_at(start) || events.iter().any(|event| event.time == start);
        parallel::over(nodes >= PARALLEL_NODES, bodies, |_, body| body.advance(&around, jumps, options.interrupt));
        // that of the first body, whichever thread finished first
        self.failure = bodies.iter_mut().find_map(|body| body.failure.take());
        if self.failure.as_ref().is_some_and(|failure| !failure.is_whole_step()) {
            return;
        }
        self.events.iter().for_each(|event| note_phase(&mut self.phases, event));
        self.timings = [reached - found, found - begun, reached.elapsed()];
        self.end_step(end);
    }

    /// Counts the step that ends at `time`, and collects its tear events.
    fn end_step(&mut self, time: f64) {
        self.step += 1;
        let (name, _) = match (self.scene.model, self.scene.lattice.tear) {
            (Model::Fem, _) => WOULD_TEAR,
            (_, TearMode::Split) => SPLIT_NODE,
            _ => CUT_CELL,
        };
        let step = self.step;
        let of = |body: &Body| {
            let body_event = move |index| move |&place: &_| BodyEvent { name, time, step, body: index, place };
            body.tears.iter().map(body_event(body.index)).collect::<Vec<_>>()
        };
        self.tears.extend(self.bodies.iter().filter(|body| !body.tears.is_empty()).flat_map(of));
    }

    /// Finds the bodies and force points whose spheres can reach each body within a step.
    fn find_sources(&mut self, start: f64, end: f64) {
        let Elastic { scene, bodies, grid, world, .. } = self;
        // if phases are found here, search as far as the largest threshold
        let farthest =
            if world.is_none() { scene.laws().map(|law| law.thresholds.split_at).fold(0.0, f64::max) } else { 0.0 };
        for (body, described) in bodies.iter_mut().zip(&scene.bodies) {
            let (centre, spread, jumps) = match (&body.free, described.path()) {
                (Some(free), _) => (free.centre, free.farthest(end - start), false),
                (None, Some(path)) => {
                    let (centre, spread) = path.ball(start, end);
                    (centre, spread, path.is_held())
                }
                (None, None) => continue,
            };
            let extent = body.extent + body.speed * (end - start);
            // a body that jumps is in several places; jumps are rare, so a ball around all of them is good enough
            let spread = match described.path().filter(|_| jumps) {
                Some(path) => {
                    let places = path.knots().iter().filter(|&&knot| knot > start && knot <= end);
                    places.map(|&knot| path.position(knot).distance(centre)).fold(spread, f64::max)
                }
                None => spread,
            };
            let reach = described.sphere_radius().max(extent).max(farthest * described.radius);
            let ball = Ball { centre, radius: (reach + spread) * (1.0 + 1e-12) };
            body.reach = extent + spread;
            body.spread = spread;
            if body.placed != Some(ball) {
                grid.place(body.index as u32, ball);
                body.placed = Some(ball);
            }
        }
        let centres: Vec<_> = bodies.iter().map(|body| body.placed.unwrap_or_default().centre).collect();
        let spheres: Vec<f64> =
            bodies.iter().zip(&scene.bodies).map(|(body, described)| described.sphere_radius() + body.spread).collect();
        let (grid, scene) = (&*grid, &*scene);
        bodies.iter_mut().for_each(|body| {
            body.sources.clear();
            grid.touching(body.index as u32, &mut body.sources);
            if farthest > 0.0 {
                body.near.clone_from(&body.sources);
            }
            let (centre, reach) = (centres[body.index], body.reach);
            body.sources.retain(|&other| {
                let other = other as usize;
                let within = (reach + spheres[other]) * (1.0 + 1e-12);
                centre.distance_squared(centres[other]) <= within * within
            });
            let acting = scene.points_on(body.index).filter(|(_, point)| point.start <= end && start <= point.end());
            let near = acting.filter(|(_, point)| {
                let (place, spread) = point.path.ball(start, end);
                let within = reach + scene.influence.sphere_radius(point.radius) + spread;
                point.path.is_held() || !(centre.distance(place) > within * (1.0 + 1e-12))
            });
            body.sources.extend(near.map(|(source, _)| source));
        });
    }

    /// Simulated time [s].
    fn now(&self) -> Instant {
        Instant { step: self.step, time: self.time_of(self.step) }
    }
}

/// The phases of pairs that are not apart at t = 0, by their distance.
fn first_phases(scene: &Scene) -> BTreeMap<[u32; 2], Phase> {
    let centres: Vec<_> = scene.bodies.iter().map(|body| body.motion.start()).collect();
    let mut phases = BTreeMap::new();
    for (b, body) in scene.bodies.iter().enumerate() {
        for (a, other) in scene.bodies[..b].iter().enumerate() {
            let q = centres[a].distance(centres[b]) / (body.radius + other.radius);
            let phase = scene.law(a, b).thresholds.initial(q);
            if phase != Phase::Apart {
                phases.insert([a as u32, b as u32], phase);
            }
        }
    }
    phases
}

/// All phases, by their indices in events.
const PHASES: [Phase; 3] = [Phase::Apart, Phase::Merged, Phase::Core];

/// Notes the phase that a pair enters; pairs that are apart are not listed.
fn note_phase(phases: &mut BTreeMap<[u32; 2], Phase>, event: &PairEvent) {
    let pair = [event.a as u32, event.b as u32];
    match PHASES.get(event.to) {
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
