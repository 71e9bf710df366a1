//! A body made of cells, and its step.

use std::{
    collections::HashMap,
    sync::{Arc, atomic::AtomicBool},
};

use glam::{DMat3, DVec3};

use super::{
    CORE,
    act::{Instantaneous, Part, StepContext, steep},
    coupled::{ExternalForces, Free, is_coupled},
};
use crate::{
    geometry::{Mesh, Shape, Vectors},
    interrupt::is_raised,
    models::{
        cells::{Cells, boundary},
        fem::{self, Elasticity, Element, Stepper, Unfactored},
        lattice::{self, Constants, Lattice, Scheme},
    },
    observe::{SpringFrame, StepFailure},
    scene::{Integrator, Model, Motion, Plane, Push, Scene, TearMode},
    sim::reach::Ball,
    text::bytes,
};

/// Length of explicit steps over the limit of their stability: stretched springs are stiffer than at rest.
pub const OF_LIMIT: f64 = 0.7;
/// Upper limit on the springs that a body evaluates in a step; more would take forever.
pub const MAX_SPRINGS: f64 = 2e8;
/// Upper limit on the cells of finite elements that a body evaluates in a step; they take far longer than springs.
const MAX_CELLS: f64 = 1e7;
/// Springs evaluated between two checks of the interrupt.
const SPRINGS_PER_CHECK: u64 = 1 << 22;
/// A body whose nodes are farther away than this has diverged [radii].
const DIVERGED: f64 = 1e6;

/// The material model of a body.
pub enum Matter {
    /// Masses and springs.
    Lattice(Box<Springs>),
    /// Finite elements.
    Fem(Box<Finite>),
}

/// A lattice and its motion.
pub struct Springs {
    pub lattice: Lattice,
    pub motion: lattice::Motion,
}

/// Finite elements and their motion.
pub struct Finite {
    pub element: Arc<Element>,
    pub stepper: Arc<Stepper>,
    pub motion: fem::Motion,
    /// Number of implicit steps in a step of the scene.
    pub divided: u64,
    pub forces: Vec<DVec3>,
    /// Whether each node is held.
    pub held: Vec<bool>,
    /// Whether each cell would have torn.
    torn: Vec<bool>,
}

impl Finite {
    /// Takes an implicit step of a body on a path with the forces that are set, and updates the displacements and
    /// velocities of its nodes.
    pub fn step(&mut self, x: &mut [DVec3], u: &mut [DVec3]) {
        let Finite { element, stepper, motion, forces, .. } = self;
        stepper.step(element, motion, forces);
        for (i, &node) in element.free.iter().enumerate() {
            (x[node as usize], u[node as usize]) = (motion.displacements[i], motion.velocities[i]);
        }
    }
}

/// Statistics of a body's last step, and of the run so far.
#[derive(Clone, Debug, Default)]
pub struct Statistics {
    /// Steps of the integrator in the last step.
    pub substeps: u64,
    /// The longest stable step of the integrator in the last step [s]; infinite if there is none.
    pub step_limit: f64,
    /// The largest strain of a spring in the last step [–].
    pub strain: f64,
    /// The largest tension in the last step [mass/(scene unit · s²)].
    pub tension: f64,
    /// Fraction of the volume that is lost [–].
    pub lost: f64,
    /// Nodes split so far.
    pub split: u64,
    /// Cells cut, or that would have torn, so far.
    pub torn: u64,
    /// Time and position of the first tear [s, scene unit].
    pub first: Option<(f64, DVec3)>,
}

/// A body made of cells.
pub struct Body {
    pub index: usize,
    pub surface: Surface,
    pub radius: f64,
    pub matter: Matter,
    /// Rest positions of the nodes [scene unit], `[node_count]`.
    pub rest: Vec<DVec3>,
    /// Directions of the rest positions [–], `[node_count]`.
    pub directions: Vec<DVec3>,
    /// Rigid motion of a free body, of which no node is held; `None` on a path.
    pub free: Option<Free>,
    /// External forces of the last step, in a scene with free bodies.
    pub acted: ExternalForces,
    /// Displacements of the nodes [scene unit], `[node_count]`; for a free body relative to the rotated rest shape.
    pub x: Vec<DVec3>,
    /// Velocities of the displacements [scene unit/s], `[node_count]`.
    pub u: Vec<DVec3>,
    /// Whether all displacements and velocities are zero.
    pub is_at_rest: bool,
    /// Distance of the farthest node from the centre [scene unit].
    pub extent: f64,
    /// Largest speed of a node relative to the centre [scene unit/s].
    pub speed: f64,
    pub pushes: Vec<Push>,
    /// The bodies whose spheres can reach it in this step, ascending.
    pub sources: Vec<u32>,
    /// The bodies near it, including those whose phase may change, ascending.
    pub near: Vec<u32>,
    /// Its entry in the broad phase.
    pub placed: Option<Ball>,
    pub reach: f64,
    pub spread: f64,
    /// Mesh of a body that has torn.
    pub torn: Option<Arc<Mesh>>,
    pub statistics: Statistics,
    /// Positions at which it tore in the last step, or would have torn [scene unit].
    pub tears: Vec<DVec3>,
    pub failure: Option<StepFailure>,
    breaks: Vec<f64>,
    pub now: Instantaneous,
}

/// Data shared by bodies of one kind.
pub struct Shared {
    /// Memory left for factors [bytes].
    left: u64,
    elements: HashMap<Kind, (Arc<Element>, Arc<Stepper>, u64)>,
    /// Number of implicit steps in a step of the scene, if it is the same for all bodies.
    divided: Option<u64>,
}

/// Key of shared elements: shape, the bits of radius, mass, ω and κ, and whether the body is free.
type Kind = (Shape, [u64; 4], bool);

impl Shared {
    /// Allocated memory [bytes].
    pub fn memory(&self) -> usize {
        let of = |(element, stepper, _): &(Arc<Element>, Arc<Stepper>, u64)| element.memory() + stepper.memory();
        self.elements.values().map(of).sum()
    }

    /// No elements yet, with this much memory left for factors [bytes]; `contact` is the largest [`contact`] of all
    /// bodies if they are stepped together.
    pub fn new(left: u64, scene: &Scene, contact: Option<f64>) -> Shared {
        Shared { left, elements: HashMap::new(), divided: contact.map(|contact| divisions(scene, contact)) }
    }
}

/// Number of implicit steps in a step of the scene. The forces of spheres, of at most two at once and all force points,
/// and of planes are explicit, from the last half step. With free bodies, the effect of a heavy body on a light one
/// counts, too.
fn divisions(scene: &Scene, contact: f64) -> u64 {
    let steep = steep(scene.influence.weight);
    let strongest = steep * scene.laws().map(|law| law.alpha.max(law.beta)).fold(0.0, f64::max);
    let on_any =
        |point| (0..scene.bodies.len()).map(|body| scene.point_strength(point, body).abs()).fold(0.0, f64::max);
    let points = steep * scene.points.iter().map(on_any).sum::<f64>();
    let planes = scene.planes.iter().map(|plane| plane.stiffness).sum::<f64>() * contact;
    let of = |pick: fn(f64, f64) -> f64, start| scene.bodies.iter().map(|body| body.mass).fold(start, pick);
    let ratio = if is_coupled(scene) { of(f64::max, 0.0) / of(f64::min, f64::INFINITY) } else { 0.0 };
    // explicit forces of stiffness ω² are stable up to a step of 2/ω
    (scene.dt * ((2.0 + ratio) * strongest + points + planes).sqrt() / (2.0 * OF_LIMIT)).ceil().max(1.0) as u64
}

/// Upper bound of a body's memory without the factor [bytes]; `is_new` if no earlier body shares its elements.
pub fn max_memory(scene: &Scene, across: u32, vertices: u64, is_new: bool) -> u64 {
    let nodes = (u64::from(across) + 1).pow(3);
    let own = match scene.model {
        Model::Fem if is_new => fem::Element::most_memory(across),
        Model::Fem => 0,
        _ => Lattice::most_memory(across, scene.lattice.tear == TearMode::Split),
    };
    own + nodes * 6 * 24 + vertices * 100 + 4096
}

impl Body {
    /// A body of a valid scene, at rest.
    ///
    /// # Errors
    /// A message: its factor does not fit into memory, or building was interrupted.
    pub fn new(
        scene: &Scene,
        index: usize,
        cells: Arc<Cells>,
        shared: &mut Shared,
        interrupt: Option<&'static AtomicBool>,
    ) -> Result<Body, String> {
        let described = &scene.bodies[index];
        let (radius, mass, material) = (described.radius, described.mass, described.material);
        let motion = match &described.motion {
            Motion::Free(motion) => Some(motion),
            Motion::Prescribed(_) => None,
        };
        let held = if motion.is_some() { vec![false; cells.node_count()] } else { cells.core(CORE) };
        let mesh = described.shape.mesh();
        let constants = |density| Constants::of(material.omega, material.damping, radius, density);
        let rest: Vec<DVec3> = cells.nodes.iter().map(|&node| node * radius).collect();
        let contact = contact(&cells, &mesh);
        let matter = match scene.model {
            Model::Fem => {
                let bits = [radius, mass, material.omega, material.damping].map(f64::to_bits);
                let kind = (described.shape.clone(), bits, motion.is_some());
                let (element, stepper, divided) = match shared.elements.get(&kind) {
                    Some((element, stepper, divided)) => (Arc::clone(element), Arc::clone(stepper), *divided),
                    None => {
                        let of = |density| {
                            let Constants { young, damping } = constants(density);
                            let young = scene.fem.young.unwrap_or(young);
                            (Elasticity { young, poisson: scene.fem.poisson }, damping)
                        };
                        let element = Element::new(&cells, radius, mass, &held, of, interrupt);
                        let element = element.ok_or("interrupted while the stiffness was assembled")?;
                        let divided = shared.divided.unwrap_or_else(|| divisions(scene, contact));
                        if divided as f64 * cells.cell_count() as f64 > MAX_CELLS {
                            return Err(format!(
                                "scene \"{}\": the forces on body \"{}\" would need {divided} sub-steps per step, \
                                which would take too long; lower `dt`, `alpha`, `beta` or the `stiffness` of planes",
                                scene.name, described.name
                            ));
                        }
                        let stepper = element.factor(scene.dt / divided as f64, shared.left, interrupt);
                        let stepper = stepper.map_err(|error| unfactored(scene, index, error))?;
                        shared.left = shared.left.saturating_sub(stepper.memory() as u64);
                        let (element, stepper) = (Arc::new(element), Arc::new(stepper));
                        shared.elements.insert(kind, (Arc::clone(&element), Arc::clone(&stepper), divided));
                        (element, stepper, divided)
                    }
                };
                let motion = fem::Motion::at_rest(&element);
                let torn = vec![false; cells.cell_count()];
                Matter::Fem(Box::new(Finite { element, stepper, motion, divided, forces: Vec::new(), held, torn }))
            }
            _ => {
                let lattice = Lattice::new(&cells, radius, mass, held, constants, interrupt);
                let lattice = lattice.ok_or("interrupted while the springs were built")?;
                let motion = lattice::Motion::at_rest(&lattice);
                Matter::Lattice(Box::new(Springs { lattice, motion }))
            }
        };
        let n = rest.len();
        let free = motion.map(|motion| Free::new(motion, &rest, scene.model == Model::Fem));
        let mut body = Body {
            index,
            radius,
            extent: rest.iter().map(|l| l.length()).fold(0.0, f64::max),
            directions: rest.iter().map(|l| l.normalize_or_zero()).collect(),
            rest,
            free,
            acted: ExternalForces::default(),
            x: vec![DVec3::ZERO; n],
            u: vec![DVec3::ZERO; n],
            surface: Surface { cells, mesh, mass, exposed: Vec::new(), contact },
            matter,
            is_at_rest: true,
            speed: 0.0,
            pushes: scene.pushes.iter().filter(|push| push.body == index).copied().collect(),
            sources: Vec::new(),
            near: Vec::new(),
            placed: None,
            reach: 0.0,
            spread: 0.0,
            torn: None,
            statistics: Statistics { step_limit: f64::INFINITY, ..Statistics::default() },
            tears: Vec::new(),
            failure: None,
            breaks: Vec::new(),
            now: Instantaneous::default(),
        };
        body.start();
        Ok(body)
    }

    /// Number of nodes.
    pub fn node_count(&self) -> usize {
        self.rest.len()
    }

    /// Whether it is at rest and nothing acts on it in a step.
    pub fn sleeps(&self, around: &StepContext<'_>) -> bool {
        self.is_at_rest
            && around.is_calm(self.index, &self.sources, &self.pushes)
            && self.planes(around).next().is_none()
    }

    /// The planes within reach in a step.
    fn planes<'a>(&'a self, around: &StepContext<'a>) -> impl Iterator<Item = &'a Plane> + 'a {
        let centre = self.placed.unwrap_or_default().centre;
        around.scene.planes.iter().filter(move |plane| plane.depth(centre) > -self.reach)
    }

    /// The corner nodes of each cell.
    pub fn corners(&self) -> &[[u32; 8]] {
        match &self.matter {
            Matter::Lattice(springs) => &springs.lattice.corners,
            Matter::Fem(_) => &self.surface.cells.corners,
        }
    }

    /// Takes the step; `jumps` says whether forces are discontinuous at its start.
    pub fn advance(&mut self, around: &StepContext<'_>, mut jumps: bool, interrupt: Option<&'static AtomicBool>) {
        self.statistics.substeps = 0;
        self.tears.clear();
        self.failure = None;
        let Some(path) = around.scene.bodies[self.index].path() else { return };
        if self.sleeps(around) {
            return;
        }
        let mut now = std::mem::take(&mut self.now);
        let planes: Vec<Plane> = self.planes(around).copied().collect();
        match &self.matter {
            Matter::Lattice(_) => {
                let mut breaks = std::mem::take(&mut self.breaks);
                around.breaks(self.index, &self.sources, &self.pushes, &mut breaks);
                self.statistics.step_limit = f64::INFINITY;
                self.statistics.strain = 0.0;
                for ends in breaks.windows(2) {
                    let part = around.part(path, self.index, &self.sources, &self.pushes, [ends[0], ends[1]]);
                    self.take_explicit(
                        around,
                        &part,
                        std::mem::replace(&mut jumps, true),
                        &planes,
                        &mut now,
                        interrupt,
                    );
                    if self.failure.is_some() {
                        break;
                    }
                }
                self.breaks = breaks;
                if self.failure.is_none() {
                    self.tear(around, path.position(around.end));
                }
            }
            Matter::Fem(finite) => {
                let divided = finite.divided;
                let at = |step: u64| around.start + (around.end - around.start) * (step as f64 / divided as f64);
                for step in 0..divided {
                    if is_raised(interrupt) {
                        self.failure = Some(StepFailure::Interrupted(format!("interrupted in step {}", around.step)));
                        break;
                    }
                    let part = around.mean(path, self.index, &self.sources, &self.pushes, [at(step), at(step + 1)]);
                    self.take_implicit(around, &part, &planes, &mut now);
                }
                self.statistics.substeps = divided;
                self.strain(around, path.position(around.end));
            }
        }
        self.now = now;
        self.update_state(around);
    }

    /// Advances a lattice by a part of a step; `jumps` says whether forces are discontinuous at its start.
    fn take_explicit(
        &mut self,
        around: &StepContext<'_>,
        part: &Part<'_>,
        jumps: bool,
        planes: &[Plane],
        now: &mut Instantaneous,
        interrupt: Option<&'static AtomicBool>,
    ) {
        let Body { matter, statistics, surface, directions, index, failure, .. } = self;
        let Matter::Lattice(springs) = matter else { return };
        let Springs { lattice, motion } = &mut **springs;
        let (scene, length) = (around.scene, part.end - part.start);
        let kick = part.kick();
        if jumps || kick != DVec3::ZERO {
            motion.accelerations.clear();
        }
        if kick != DVec3::ZERO {
            motion.kick(kick);
        }
        let of_planes = planes.iter().map(|plane| plane.stiffness).sum::<f64>() * surface.contact;
        let limit = lattice.step_limit(part.stiffness() + of_planes);
        statistics.step_limit = statistics.step_limit.min(limit);
        let (scheme, count) = match scene.integrator {
            Integrator::Euler => (Scheme::Euler, 1.0),
            Integrator::Verlet => (Scheme::Verlet, 1.0),
            _ => (Scheme::Verlet, (length / (OF_LIMIT * limit)).ceil().max(1.0)),
        };
        if count * lattice.spring_count() as f64 > MAX_SPRINGS {
            *failure = Some(StepFailure::NotTaken(format!(
                "too much to do in step {} (from t = {:.6} s on): the springs of body \"{}\" need steps below {limit:.1e} s, {count:.0} per step of the \
                scene; lower `omega`, `damping` or `cells` in [lattice]",
                around.step, part.start, scene.bodies[*index].name
            )));
            return;
        }
        let (count, weight) = (count as u64, scene.influence.weight);
        let h = length / count as f64;
        let chunk = (SPRINGS_PER_CHECK / (lattice.spring_count() as u64 + 1)).max(1);
        let mut done = 0;
        while done < count {
            if is_raised(interrupt) {
                *failure = Some(StepFailure::Interrupted(format!("interrupted in step {}", around.step)));
                return;
            }
            let steps = chunk.min(count - done);
            let corners = &lattice.corners;
            let outside = |t: f64, positions: &[DVec3], velocities: &[DVec3], into: &mut [DVec3]| {
                let t = part.start + (done as f64 * h + t).min(length);
                part.at(if done as f64 * h + t >= part.end { part.end } else { t }, now);
                let nodes = positions.iter().zip(directions.iter()).zip(&lattice.held);
                for (into, ((position, facing), is_held)) in into.iter_mut().zip(nodes) {
                    *into = if *is_held { DVec3::ZERO } else { now.acceleration(weight, *position, *facing) };
                }
                if !planes.is_empty() {
                    let motion = [part.centre(t), part.velocity(t)];
                    let of = Contact { planes, surface, corners, masses: &lattice.masses, motion, step: h };
                    of.accelerate(positions, velocities, into);
                }
            };
            let largest = lattice.advance(motion, scheme, h, steps, outside);
            statistics.strain = statistics.strain.max(largest - 1.0);
            done += steps;
        }
        statistics.substeps += count;
    }

    fn take_implicit(&mut self, around: &StepContext<'_>, part: &Part<'_>, planes: &[Plane], now: &mut Instantaneous) {
        self.kick(part.kick());
        let Body { matter, surface, directions, rest, x, u, .. } = self;
        let Matter::Fem(finite) = matter else { return };
        let Finite { element, stepper, motion, forces, .. } = &mut **finite;
        let scene = around.scene;
        part.averaged(now);
        forces.clear();
        let half = 0.5 * stepper.h;
        for (i, &node) in element.free.iter().enumerate() {
            let node = node as usize;
            let place = rest[node] + motion.displacements[i] + motion.velocities[i] * half;
            let acceleration = now.acceleration(scene.influence.weight, place, directions[node]);
            forces.push(acceleration * element.masses[node]);
        }
        if !planes.is_empty() {
            let middle = 0.5 * (part.start + part.end);
            let positions: Vec<DVec3> =
                rest.iter().zip(x.iter()).zip(u.iter()).map(|((l, x), u)| *l + *x + *u * half).collect();
            let motion = [part.centre(middle), part.velocity(middle)];
            let (corners, masses, step) = (&surface.cells.corners, &element.masses, stepper.h);
            let of = Contact { planes, surface, corners, masses, motion, step };
            let mut pressed = vec![DVec3::ZERO; positions.len()];
            of.accelerate(&positions, u, &mut pressed);
            for (force, &node) in forces.iter_mut().zip(&element.free) {
                *force += pressed[node as usize] * element.masses[node as usize];
            }
        }
        finite.step(x, u);
    }

    /// Adds a velocity to the nodes of finite elements [scene unit/s].
    pub fn kick(&mut self, by: DVec3) {
        let Matter::Fem(finite) = &mut self.matter else { return };
        if by != DVec3::ZERO {
            finite.motion.velocities.iter_mut().for_each(|velocity| *velocity += by);
            finite.element.free.iter().for_each(|&node| self.u[node as usize] += by);
        }
    }

    /// Tears a lattice where it is overloaded.
    pub fn tear(&mut self, around: &StepContext<'_>, centre: DVec3) {
        let settings = around.scene.lattice;
        let Body { matter, statistics, tears, rest, directions, x, u, surface, torn, radius, .. } = self;
        let Surface { cells, mesh, exposed, .. } = surface;
        let Matter::Lattice(springs) = matter else { return };
        let Springs { lattice, motion } = &mut **springs;
        let (before, limit) = (lattice.node_count(), settings.limit);
        match settings.tear {
            TearMode::Cut if statistics.strain > limit => {
                let cut = lattice.cut(&motion.positions, limit);
                motion.cut(lattice);
                statistics.torn += cut.len() as u64;
                statistics.lost = lattice.lost();
                let middle = |corners: &[u32; 8]| {
                    corners.map(|node| motion.positions[node as usize]).iter().sum::<DVec3>() * 0.125
                };
                tears.extend(cut.iter().map(|&cell| centre + middle(&lattice.corners[cell])));
            }
            // in any state of stress, the strain of a spring exceeds half of that of a bar
            TearMode::Split if statistics.strain > 0.5 * limit => {
                let split = lattice.split(&motion.positions, limit);
                motion.split(lattice, &split);
                statistics.split += split.len() as u64;
                tears.extend(split.iter().map(|&node| centre + motion.positions[node as usize]));
            }
            _ => {}
        }
        if let Some(&place) = tears.first() {
            statistics.first.get_or_insert((around.end, place));
            for node in before..lattice.node_count() {
                rest.push(lattice.rest[node]);
                directions.push(lattice.rest[node].normalize_or_zero());
            }
            let surface = boundary(&cells.corners, &lattice.corners, |cell| lattice.is_whole[cell]);
            let first = mesh.vertex_count() as u32;
            let mut positions: Vectors = mesh.positions().clone();
            exposed.clear();
            for &(node, _) in &surface.vertices {
                positions.push(rest[node as usize] / *radius);
                exposed.push(node);
            }
            let triangles = surface.triangles.iter().map(|triangle| triangle.map(|i| first + i)).collect();
            *torn = Some(Arc::new(Mesh::version(positions, triangles)));
        }
        x.resize(rest.len(), DVec3::ZERO);
        u.resize(rest.len(), DVec3::ZERO);
    }

    /// Records the cells in which a body of finite elements would tear.
    pub fn strain(&mut self, around: &StepContext<'_>, centre: DVec3) {
        let Some(limit) = around.scene.fem.tear_stress else { return };
        let Body { matter, statistics, tears, x, surface, rest, free, .. } = self;
        let Matter::Fem(finite) = matter else { return };
        let Finite { element, torn, .. } = &mut **finite;
        statistics.tension = 0.0;
        let axes = free.as_ref().map(|free| DMat3::from_quat(free.rotation));
        let turned = axes.map(|axes| x.iter().map(|x| axes.transpose() * *x).collect::<Vec<_>>());
        element.tensions(turned.as_ref().unwrap_or(x), |tension| {
            statistics.tension = statistics.tension.max(tension.stress);
            let is_torn = &mut torn[tension.cell as usize];
            if tension.stress > limit && !*is_torn {
                *is_torn = true;
                statistics.torn += 1;
                let corners = surface.cells.corners[tension.cell as usize];
                let place = corners
                    .map(|node| axes.unwrap_or(DMat3::IDENTITY) * rest[node as usize] + x[node as usize])
                    .iter()
                    .sum::<DVec3>()
                    * 0.125;
                statistics.first.get_or_insert((around.end, centre + place));
                tears.push(centre + place);
            }
        });
    }

    /// Updates the state from the nodes, and checks for divergence.
    pub fn update_state(&mut self, around: &StepContext<'_>) {
        let Body { matter, rest, x, u, free, .. } = self;
        if let (Matter::Lattice(springs), None) = (matter, &free) {
            let motion = &springs.motion;
            for (i, ((position, velocity), rest)) in
                motion.positions.iter().zip(&motion.velocities).zip(rest.iter()).enumerate()
            {
                (x[i], u[i]) = (*position - *rest, *velocity);
            }
        }
        let axes = free.as_ref().map_or(DMat3::IDENTITY, |free| DMat3::from_quat(free.rotation));
        let is_somewhere = free.as_ref().is_none_or(|free| free.centre.is_finite() && free.velocity.is_finite());
        let spinning = free.as_ref().map_or(0.0, |free| free.spin.length());
        let (mut farthest, mut fastest, mut is_at_rest) = (0.0, 0.0, spinning == 0.0);
        for ((rest, x), u) in rest.iter().zip(x.iter()).zip(u.iter()) {
            farthest = f64::max(farthest, (axes * *rest + *x).length_squared());
            fastest = f64::max(fastest, u.length_squared());
            is_at_rest &= *x == DVec3::ZERO && *u == DVec3::ZERO;
        }
        let is_finite = x.iter().zip(u.iter()).all(|(x, u)| x.is_finite() && u.is_finite());
        (self.extent, self.speed, self.is_at_rest) =
            (farthest.sqrt(), fastest.sqrt() + spinning * farthest.sqrt(), is_at_rest);
        if self.failure.is_none() && (!(is_finite && is_somewhere) || self.extent > DIVERGED * self.radius) {
            let scene = around.scene;
            self.failure = Some(StepFailure::Diverged(format!(
                "diverged at step {} (t = {:.6} s): body \"{}\", its nodes are {:e} scene units away; {} with dt = {:e} s, stable below {:.1e} s: use a \
                smaller dt, or `exponential`, with which the model divides it",
                around.step,
                around.end,
                scene.bodies[self.index].name,
                self.extent,
                scene.integrator,
                scene.dt,
                self.statistics.step_limit
            )));
        }
    }

    /// The elastic energy [mass · scene unit²/s²].
    pub fn elastic_energy(&self) -> f64 {
        match &self.matter {
            Matter::Lattice(springs) => springs.lattice.energy(&springs.motion.positions),
            Matter::Fem(finite) => finite.element.energy(&self.in_axes(&finite.element, &self.x)),
        }
    }

    /// The masses of the nodes.
    pub fn masses(&self) -> &[f64] {
        match &self.matter {
            Matter::Lattice(springs) => &springs.lattice.masses,
            Matter::Fem(finite) => &finite.element.masses,
        }
    }

    /// Accelerations by internal forces, and by internal damping [scene unit/s²]; zero for held nodes.
    pub fn internal(&self) -> [Vec<DVec3>; 2] {
        let n = self.node_count();
        match &self.matter {
            Matter::Lattice(springs) => {
                let Springs { lattice, motion } = &**springs;
                let (mut forces, mut drags) = (Vec::new(), Vec::new());
                lattice.forces(&motion.positions, &motion.velocities, &mut forces, &mut drags);
                let per_mass = |forces: Vec<DVec3>| forces.iter().zip(&motion.inverse).map(|(f, w)| *f * *w).collect();
                [per_mass(forces), per_mass(drags)]
            }
            Matter::Fem(finite) => {
                let (element, axes) = (&*finite.element, self.axes());
                let of = |values: &[DVec3], factor: f64| {
                    let mut forces = vec![DVec3::ZERO; element.free.len()];
                    element.forces(&self.in_axes(element, values), &mut forces);
                    let mut all = vec![DVec3::ZERO; n];
                    for (force, &node) in forces.iter().zip(&element.free) {
                        all[node as usize] = axes * *force * (-factor / element.masses[node as usize]);
                    }
                    all
                };
                [of(&self.x, 1.0), of(&self.u, element.damping)]
            }
        }
    }

    /// The axes of its frame.
    pub fn axes(&self) -> DMat3 {
        self.free.as_ref().map_or(DMat3::IDENTITY, |free| DMat3::from_quat(free.rotation))
    }

    /// Vectors of the free nodes in body axes, in the order of elimination.
    fn in_axes(&self, element: &Element, of: &[DVec3]) -> Vec<DVec3> {
        let back = self.axes().transpose();
        element.free.iter().map(|&node| back * of[node as usize]).collect()
    }

    /// Whether a node is held.
    pub fn is_held(&self, node: usize) -> bool {
        match &self.matter {
            Matter::Lattice(springs) => springs.motion.inverse[node] == 0.0,
            Matter::Fem(finite) => finite.held[node],
        }
    }

    /// Accelerations of the nodes by planes [scene unit/s²].
    pub fn pressed(&self, scene: &Scene, centre: DVec3, velocity: DVec3) -> Vec<DVec3> {
        let positions = self.places();
        let velocities = self.velocities();
        let mut into = vec![DVec3::ZERO; positions.len()];
        let of = Contact {
            planes: &scene.planes,
            surface: &self.surface,
            corners: self.corners(),
            masses: self.masses(),
            motion: [centre, velocity],
            step: 0.0,
        };
        of.accelerate(&positions, velocities, &mut into);
        into
    }

    /// Positions of the nodes relative to the centre [scene unit].
    pub fn places(&self) -> Vec<DVec3> {
        let axes = self.axes();
        self.rest.iter().zip(&self.x).map(|(l, x)| axes * *l + *x).collect()
    }

    /// Adds its springs to `springs`.
    pub fn add_springs(&self, springs: &mut Vec<SpringFrame>) {
        let Matter::Lattice(of) = &self.matter else { return };
        let places = self.places();
        springs.extend(of.lattice.springs().map(|spring| {
            let ends = [spring.a, spring.b].map(|node| places[node as usize]);
            SpringFrame { ends, strain: ends[0].distance(ends[1]) / spring.rest - 1.0 }
        }));
    }

    /// Velocities of the nodes relative to that of the centre [scene unit/s].
    pub fn velocities(&self) -> &[DVec3] {
        self.state().map_or(&self.u, |[_, velocities]| velocities)
    }

    /// Allocated memory, without data shared with other bodies [bytes].
    pub fn memory(&self) -> usize {
        let vectors = [&self.rest, &self.directions, &self.x, &self.u];
        let matter = match &self.matter {
            Matter::Lattice(springs) => springs.lattice.memory() + springs.motion.memory(),
            Matter::Fem(finite) => finite.motion.memory() + finite.forces.capacity() * size_of::<DVec3>(),
        };
        vectors.iter().map(|of| of.capacity() * size_of::<DVec3>()).sum::<usize>()
            + matter
            + self.free.as_ref().map_or(0, Free::memory)
            + self.acted.memory()
            + self.torn.as_ref().map_or(0, |mesh| mesh.memory())
    }
}

/// The surface of a body, which planes act on.
pub struct Surface {
    pub cells: Arc<Cells>,
    pub mesh: Arc<Mesh>,
    /// Mass of the body in the scene.
    pub mass: f64,
    /// Nodes of the vertices that tearing added to the mesh.
    pub exposed: Vec<u32>,
    /// Largest ratio of the effect of planes on a node to that on a vertex [–].
    pub contact: f64,
}

/// Planes and the surface of a body.
pub struct Contact<'a> {
    pub planes: &'a [Plane],
    pub surface: &'a Surface,
    /// The corner nodes of each cell.
    pub corners: &'a [[u32; 8]],
    /// The masses of the nodes.
    pub masses: &'a [f64],
    /// Position and velocity of the centre.
    pub motion: [DVec3; 2],
    /// Length of a step [s]: friction takes at least a step to stop a node.
    pub step: f64,
}

impl Contact<'_> {
    /// Adds the accelerations of the nodes: each vertex, with its share of the body's mass, distributes its force to
    /// them. The surface of a body that has torn consists of nodes.
    pub fn accelerate(&self, positions: &[DVec3], velocities: &[DVec3], into: &mut [DVec3]) {
        if self.planes.is_empty() {
            return;
        }
        let Surface { cells, mesh, mass, exposed, .. } = self.surface;
        for node in exposed.iter().map(|&node| node as usize) {
            into[node] += self.of_planes(positions[node], || velocities[node]);
        }
        if !exposed.is_empty() {
            return;
        }
        for (embedded, share) in cells.embedded.iter().zip(mesh.shares()) {
            let corners = &self.corners[embedded.cell as usize];
            let force = self.of_planes(embedded.mean(corners, positions), || embedded.mean(corners, velocities));
            if force != DVec3::ZERO {
                for (&node, &weight) in corners.iter().zip(&embedded.weights) {
                    into[node as usize] += force * (weight * share * mass / self.masses[node as usize]);
                }
            }
        }
    }

    /// The acceleration of a point of the surface by the planes, given its place and velocity relative to the centre.
    fn of_planes(&self, place: DVec3, velocity: impl Fn() -> DVec3) -> DVec3 {
        let mut sum = DVec3::ZERO;
        let min_stop = self.surface.contact * self.step;
        for plane in self.planes {
            let depth = plane.depth(place + self.motion[0]);
            if depth > 0.0 {
                let velocity = velocity() + self.motion[1];
                let slide = velocity - plane.normal * plane.normal.dot(velocity);
                let pressure = plane.stiffness * depth;
                let rate = plane.friction * pressure / (slide.length_squared() + plane.slip * plane.slip).sqrt();
                sum += plane.normal * pressure - slide * f64::min(rate, 1.0 / min_stop);
            }
        }
        sum
    }
}

/// The largest ratio of the mass of the vertices that act on a node to the mass of that node [–].
pub fn contact(cells: &Cells, mesh: &Mesh) -> f64 {
    let mut sums = vec![0.0; cells.node_count()];
    for (embedded, share) in cells.embedded.iter().zip(mesh.shares()) {
        for (&node, &weight) in cells.corners[embedded.cell as usize].iter().zip(&embedded.weights) {
            sums[node as usize] += weight.abs() * share;
        }
    }
    sums.iter().zip(cells.shares()).map(|(sum, share)| sum / share).fold(0.0, f64::max)
}

fn unfactored(scene: &Scene, index: usize, error: Unfactored) -> String {
    let name = &scene.bodies[index].name;
    match error {
        Unfactored::Interrupted => "interrupted while the stiffness was factored".to_owned(),
        Unfactored::TooLarge { bytes: needed } => format!(
            "scene \"{}\" is too large for this machine: the factored stiffness of body \"{name}\" takes more than {}; lower `cells` in \
             [fem]",
            scene.name,
            bytes(needed)
        ),
        Unfactored::Singular => format!(
            "scene \"{}\": the stiffness of body \"{name}\" cannot be factored in double precision; move `poisson` in [fem] away from \
             its limits, or lower `young`",
            scene.name
        ),
    }
}
