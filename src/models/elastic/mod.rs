//! Bodies made of cells as a simulation: what lattices and finite elements have in common.
//!
//! Every body follows its prescribed path, held at the nodes of its core (those within half a radius of its centre). Its other nodes are
//! masses in the axes of the body, moved by what is between them, and by the same accelerations as a vertex of the
//! oscillators at their place: influence spheres by phase (3.4), (3.5), pushes, carry. Planes act on the vertices of the surface,
//! each of which hands what it feels to the nodes of its cell.
//!
//! The core is held, and not every node by a spring of its own, because that is what springs and elements are for: a deformation has to
//! travel through the body, and what tears off is not pulled back. Bodies that forces move are refused.
//!
//! Phases change when those of the oscillators do, to the bit: a [`World`] of the same bodies without anything that
//! deforms them finds the events.

mod act;
mod body;
mod observe;
#[cfg(test)]
mod tests;

use std::{
    collections::{BTreeMap, HashMap},
    sync::{Arc, atomic::Ordering},
    time::{Duration, Instant as Clock},
};

use rayon::prelude::*;

use super::{Unsupported, cells::Cells};
use crate::{
    geometry::{Shape, Sphere},
    model::phase::Phase,
    observe::{BodyEvent, Instant, PairEvent, StepFailure},
    scene::{Integrator, Model, Motion, Path, Scene, TearMode},
    sim::{
        Options, World, memory,
        reach::{Ball, Grid},
    },
    text::bytes,
};
use act::Around;
use body::Body;
pub use observe::schema;

/// The core of a body that is held [radii].
const CORE: f64 = 0.5;
/// Fewer nodes than this are not worth a second thread.
const PARALLEL_NODES: usize = 128;

/// The bodies of a scene, made of cells.
pub struct Elastic {
    scene: Scene,
    options: Options,
    /// The same bodies without what deforms them: finds when phases change.
    world: World,
    bodies: Vec<Body>,
    /// The phases of pairs that are not apart, at the end of the last step.
    phases: BTreeMap<[u32; 2], Phase>,
    /// Bounds of what each body acts on and is acted on by.
    grid: Grid,
    step: u64,
    events: Vec<PairEvent>,
    /// Where bodies tore in the last step, or would have.
    tears: Vec<BodyEvent>,
    failure: Option<StepFailure>,
    timings: [Duration; 3],
}

/// Refuses what the model cannot do.
///
/// # Errors
/// [`Unsupported`], naming the body and the key.
pub fn check(scene: &Scene) -> Result<(), Unsupported> {
    let refuse = |body: Option<&str>, what: String, remedy: &str| {
        let body = body.map(str::to_owned);
        Err(Unsupported { scene: scene.name.clone(), model: scene.model, body, what, remedy: remedy.to_owned() })
    };
    for body in &scene.bodies {
        if matches!(body.motion, Motion::Free(_)) {
            let what = "motion = { free = … }, and its bodies are held by their cores".to_owned();
            return refuse(Some(&body.name), what, "give it a path, or choose model = \"oscillators\"");
        }
        if body.material.omega == 0.0 {
            let what = "omega = 0, from which its stiffness is derived".to_owned();
            return refuse(Some(&body.name), what, "give it an omega above 0");
        }
    }
    let (scheme, remedy) = match scene.model {
        Model::Fem => {
            ("steps are implicit", "leave integrator out: \"exponential\", the default, lets the model step as it does")
        }
        _ => (
            "steps are explicit",
            "choose \"euler\" or \"verlet\", which step by dt itself, or \"exponential\", the default, which lets the model divide dt",
        ),
    };
    let is_known = match scene.integrator {
        Integrator::Exponential => true,
        Integrator::Euler | Integrator::Verlet => scene.model != Model::Fem,
        _ => false,
    };
    if !is_known {
        return refuse(None, format!("integrator = \"{}\", and its {scheme}", scene.integrator), remedy);
    }
    Ok(())
}

/// The bodies of a scene without anything that deforms them, as few vertices as can be.
fn rigid(scene: &Scene) -> Scene {
    let mut rigid = Scene { integrator: Integrator::Exponential, ..scene.without_forces() };
    rigid.bodies.iter_mut().for_each(|body| body.shape = Shape::Sphere(Sphere { stacks: 2, slices: 3 }));
    rigid
}

impl Elastic {
    /// The scene at rest.
    ///
    /// # Errors
    /// The model cannot run the scene, the machine is too small for it, or it was interrupted; says which.
    pub fn new(scene: Scene, options: Options) -> Result<Elastic, String> {
        check(&scene).map_err(|error| error.to_string())?;
        let across = match scene.model {
            Model::Fem => scene.fem.cells,
            _ => scene.lattice.cells,
        };
        let room = room(&scene, across)?;
        let interrupted = || "interrupted while the bodies were built".to_owned();
        let world = World::with_options(rigid(&scene), options).map_err(|error| error.to_string())?;
        let phases = world.pairs().filter(|pair| pair.phase != Phase::Apart);
        let phases = phases.map(|pair| ([pair.a as u32, pair.b as u32], pair.phase)).collect();
        let mut covered: HashMap<Shape, Arc<Cells>> = HashMap::new();
        let mut shared = body::Shared::new(room);
        let mut bodies = Vec::with_capacity(scene.bodies.len());
        for index in 0..scene.bodies.len() {
            if options.interrupt.is_some_and(|flag| flag.load(Ordering::Relaxed)) {
                return Err(interrupted());
            }
            let shape = &scene.bodies[index].shape;
            let cells = match covered.get(shape) {
                Some(cells) => Arc::clone(cells),
                None => {
                    let cells = Cells::cover(&shape.mesh(), across, options.interrupt).ok_or_else(interrupted)?;
                    let cells = Arc::new(cells);
                    covered.insert(shape.clone(), Arc::clone(&cells));
                    cells
                }
            };
            bodies.push(Body::new(&scene, index, cells, &mut shared, options.interrupt)?);
        }
        Ok(Elastic {
            scene,
            options,
            world,
            bodies,
            phases,
            grid: Grid::default(),
            step: 0,
            events: Vec::new(),
            tears: Vec::new(),
            failure: None,
            timings: [Duration::ZERO; 3],
        })
    }

    /// The time after so many steps [s].
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
        let report = self.world.step();
        self.events.clear();
        self.tears.clear();
        self.events.extend(report.events.iter().map(PairEvent::from));
        if let Some(failure) = &report.failure {
            self.failure = Some(failure.into());
            return;
        }
        let found = Clock::now();
        self.find_sources(start, end);
        let reached = Clock::now();

        let Elastic { scene, bodies, phases, events, options, step, .. } = self;
        let around = Around { scene, phases, events, start, end, step: *step + 1 };
        let nodes: usize = bodies.iter().filter(|body| !body.sleeps(&around)).map(Body::node_count).sum();
        let advance = |body: &mut Body| body.advance(&around, options.interrupt);
        if nodes >= PARALLEL_NODES && bodies.len() > 1 {
            bodies.par_iter_mut().for_each(advance);
        } else {
            bodies.iter_mut().for_each(advance);
        }
        // the first body's, whichever thread was first
        self.failure = bodies.iter_mut().find_map(|body| body.failure.take());
        if self.failure.as_ref().is_some_and(|failure| !failure.is_whole_step()) {
            return;
        }
        for event in &self.events {
            let pair = [event.a as u32, event.b as u32];
            match PHASES.get(event.to) {
                None | Some(Phase::Apart) => _ = self.phases.remove(&pair),
                Some(&phase) => _ = self.phases.insert(pair, phase),
            }
        }
        self.step += 1;
        let name = match (self.scene.model, self.scene.lattice.tear) {
            (Model::Fem, _) => "would tear",
            (_, TearMode::Split) => "split node",
            _ => "cut cell",
        };
        let (time, step) = (end, self.step);
        let of = |body: &Body| {
            let body_event = move |index| move |&place: &_| BodyEvent { name, time, step, body: index, place };
            body.tears.iter().map(body_event(body.index)).collect::<Vec<_>>()
        };
        self.tears.extend(self.bodies.iter().filter(|body| !body.tears.is_empty()).flat_map(of));
        let done = Clock::now();
        self.timings = [reached - found, found - begun, done - reached];
    }

    /// Finds the bodies whose spheres can reach each body within a step.
    fn find_sources(&mut self, start: f64, end: f64) {
        let Elastic { scene, bodies, grid, .. } = self;
        for (body, described) in bodies.iter_mut().zip(&scene.bodies) {
            let Some(path) = described.path() else { continue };
            let (centre, spread) = path.ball(start, end);
            let (jumps, extent) = (path.is_held(), body.extent + body.speed * (end - start));
            // one that jumps is in two places; there are few of them, so that a ball around both will do
            let spread = if jumps {
                let places = path.knots().iter().filter(|&&knot| knot > start && knot <= end);
                places.map(|&knot| path.position(knot).distance(centre)).fold(spread, f64::max)
            } else {
                spread
            };
            let reach = scene.influence.sphere_radius(described.radius).max(extent);
            let ball = Ball { centre, radius: (reach + spread) * (1.0 + 1e-12) };
            body.reach = extent + spread;
            body.spread = spread;
            if body.placed != Some(ball) {
                grid.place(body.index as u32, ball);
                body.placed = Some(ball);
            }
        }
        let centres: Vec<_> = bodies.iter().map(|body| body.placed.unwrap_or_default().centre).collect();
        let spheres: Vec<f64> = bodies
            .iter()
            .zip(&scene.bodies)
            .map(|(body, described)| scene.influence.sphere_radius(described.radius) + body.spread)
            .collect();
        let grid = &*grid;
        bodies.iter_mut().for_each(|body| {
            body.sources.clear();
            grid.touching(body.index as u32, &mut body.sources);
            let (centre, reach) = (centres[body.index], body.reach);
            body.sources.retain(|&other| {
                let other = other as usize;
                let within = (reach + spheres[other]) * (1.0 + 1e-12);
                centre.distance_squared(centres[other]) <= within * within
            });
        });
    }

    /// When the simulation is [s].
    fn now(&self) -> Instant {
        Instant { step: self.step, time: self.time_of(self.step) }
    }
}

/// All phases in the order in which events number them.
const PHASES: [Phase; 3] = [Phase::Apart, Phase::Merged, Phase::Core];

/// What is left for the factors of finite elements when a scene is built [bytes].
///
/// # Errors
/// The scene needs more memory than there is.
fn room(scene: &Scene, across: u32) -> Result<u64, String> {
    let mut shapes = std::collections::HashSet::new();
    let mut kinds = std::collections::HashSet::new();
    let (mut needed, mut of_bodies) = (0u64, 0u64);
    for body in &scene.bodies {
        let vertices = body.shape.vertex_count();
        if shapes.insert(&body.shape) {
            needed = needed.saturating_add(Cells::most_memory(across, vertices));
        }
        let is_new = kinds.insert((
            &body.shape,
            [body.radius, body.mass, body.material.omega, body.material.damping].map(f64::to_bits),
        ));
        of_bodies = of_bodies.saturating_add(body::most_memory(scene, across, vertices, is_new));
    }
    needed = needed.saturating_add(of_bodies);
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
