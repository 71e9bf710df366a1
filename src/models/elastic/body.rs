//! A body made of cells, and its step.

use std::{
    collections::HashMap,
    sync::{Arc, atomic::AtomicBool},
};

use glam::{DMat3, DQuat, DVec3};

use super::{
    CORE,
    act::{ExternalForces, Instantaneous, StepContext, steep},
    free::Free,
    has_free,
};
use crate::{
    geometry::{Mesh, Shape, Vectors},
    model::shape_matching::outer,
    models::{
        cells::{self, Cells, TETRAHEDRA, boundary},
        fem::{self, Elasticity, Element, Stepper, Unfactored},
        lattice::{self, Constants, Lattice},
    },
    observe::{SpringFrame, StepFailure},
    scene::{Integrator, Model, Motion, Plane, Push, Scene, TearMode},
    sim::reach::Ball,
    text::{bytes, short},
};

/// Length of explicit steps over the limit of their stability: stretched springs are stiffer than at rest.
pub const OF_LIMIT: f64 = 0.7;
/// Upper limit on the cells of finite elements that a body evaluates in a step; they take far longer than springs.
const MAX_CELLS: f64 = 1e7;
/// How often finite elements that rub on a plane are solved in a step, about.
const RUBBING: f64 = 10.0;
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
    /// Motion of the free nodes in axes that rotate with the body.
    pub motion: fem::Motion,
    /// Positions of the nodes relative to the centre [scene unit], `[node_count]`.
    pub positions: Vec<DVec3>,
    /// Velocities of the nodes relative to the centre [scene unit/s], `[node_count]`.
    pub velocities: Vec<DVec3>,
    pub forces: Vec<DVec3>,
    /// Whether each node is held.
    pub held: Vec<bool>,
    /// Whether each cell would have torn.
    torn: Vec<bool>,
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
    /// External forces of the last step.
    pub acted: ExternalForces,
    /// Displacements of the nodes [scene unit], `[node_count]`; for a free body relative to the rotated rest shape.
    pub x: Vec<DVec3>,
    /// Velocities of the displacements [scene unit/s], `[node_count]`.
    pub u: Vec<DVec3>,
    /// Whether all displacements and velocities are zero.
    pub is_at_rest: bool,
    /// Whether it [has collapsed](Body::has_collapsed).
    pub is_collapsed: bool,
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
    pub now: Instantaneous,
}

/// Data shared by bodies of one kind.
pub struct Shared {
    /// Memory left for factors [bytes].
    left: u64,
    elements: HashMap<Kind, (Arc<Element>, Arc<Stepper>)>,
    /// Number of implicit steps in a step of the scene.
    pub divided: u64,
}

/// Key of shared elements: shape, the bits of radius, mass, ω and κ, and whether the body is free.
type Kind = (Shape, [u64; 4], bool);

impl Shared {
    /// No elements yet, with this much memory left for factors [bytes]; `contact` is the largest [`contact`] of all
    /// bodies.
    pub fn new(left: u64, scene: &Scene, contact: f64) -> Shared {
        Shared { left, elements: HashMap::new(), divided: divisions(scene, contact) }
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
    let ratio = if has_free(scene) { of(f64::max, 0.0) / of(f64::min, f64::INFINITY) } else { 0.0 };
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
    // per node, those of `Body` and of its matter
    let vectors = if scene.model == Model::Fem { 15 } else { 11 };
    // per vertex, with a contact
    own + nodes * vectors * 24 + vertices * 400 + 4096
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
        let off = if motion.is_some() { cells.mass_centre().length() } else { 0.0 };
        if off > cells::BALANCED {
            return Err(format!(
                "scene \"{}\": the cells of the free body \"{}\" have their mass centre {off:.2} R beside that of its mesh, and no \
                 densities of at least a fifth of the mean move it there; use other `cells` in [{}]",
                scene.name,
                described.name,
                scene.model.name()
            ));
        }
        let held = if motion.is_some() { vec![false; cells.node_count()] } else { cells.core(CORE) };
        let mesh = described.shape.mesh();
        let constants = |density| Constants::of(material.omega, material.damping, radius, density);
        let rest: Vec<DVec3> = cells.nodes.iter().map(|&node| node * radius).collect();
        let contact = contact(&cells, &mesh);
        let matter = match scene.model {
            Model::Fem => {
                let bits = [radius, mass, material.omega, material.damping].map(f64::to_bits);
                let kind = (described.shape.clone(), bits, motion.is_some());
                let (element, stepper) = match shared.elements.get(&kind) {
                    Some((element, stepper)) => (Arc::clone(element), Arc::clone(stepper)),
                    None => {
                        let of = |density| {
                            let Constants { young, damping } = constants(density);
                            let young = scene.fem.young.unwrap_or(young);
                            (Elasticity { young, poisson: scene.fem.poisson }, damping)
                        };
                        let element = Element::new(&cells, radius, mass, &held, of, interrupt);
                        let element = element.ok_or("interrupted while the stiffness was assembled")?;
                        let divided = shared.divided;
                        // friction takes a few solutions more
                        let has_friction = scene.planes.iter().any(|plane| plane.friction > 0.0);
                        let solutions = if has_friction { RUBBING } else { 1.0 };
                        if divided as f64 * cells.cell_count() as f64 * solutions > MAX_CELLS {
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
                        shared.elements.insert(kind, (Arc::clone(&element), Arc::clone(&stepper)));
                        (element, stepper)
                    }
                };
                Matter::Fem(Box::new(Finite {
                    motion: fem::Motion::at_rest(&element),
                    element,
                    stepper,
                    positions: rest.clone(),
                    velocities: vec![DVec3::ZERO; rest.len()],
                    forces: Vec::new(),
                    held,
                    torn: vec![false; cells.cell_count()],
                }))
            }
            _ => {
                let lattice = Lattice::new(&cells, radius, mass, held, constants, interrupt);
                let lattice = lattice.ok_or("interrupted while the springs were built")?;
                let motion = lattice::Motion::at_rest(&lattice);
                Matter::Lattice(Box::new(Springs { lattice, motion }))
            }
        };
        let n = rest.len();
        let mut body = Body {
            index,
            radius,
            extent: rest.iter().map(|l| l.length()).fold(0.0, f64::max),
            directions: rest.iter().map(|l| l.normalize_or_zero()).collect(),
            rest,
            free: motion.map(Free::new),
            acted: ExternalForces::default(),
            x: vec![DVec3::ZERO; n],
            u: vec![DVec3::ZERO; n],
            surface: Surface { cells, mesh, mass, exposed: Vec::new(), contact },
            matter,
            is_at_rest: true,
            is_collapsed: false,
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
            now: Instantaneous::default(),
        };
        body.spin();
        Ok(body)
    }

    /// Number of nodes.
    pub fn node_count(&self) -> usize {
        self.rest.len()
    }

    /// Whether it is at rest, and nothing acts on it in an interval.
    pub fn sleeps(&self, around: &StepContext<'_>) -> bool {
        self.is_at_rest
            && around.is_calm(self.index, &self.sources, &self.pushes)
            && self.planes_in_reach(around.scene).next().is_none()
    }

    /// The planes that it can reach in the interval for which its sources were found.
    pub fn planes_in_reach<'a>(&self, scene: &'a Scene) -> impl Iterator<Item = &'a Plane> + use<'a> {
        let (centre, reach) = (self.placed.unwrap_or_default().centre, self.reach);
        scene.planes.iter().filter(move |plane| plane.depth(centre) > -reach)
    }

    /// All planes if it may reach one of them from a position of its centre, otherwise none.
    pub(super) fn planes<'a>(&self, scene: &'a Scene, centre: DVec3) -> &'a [Plane] {
        let reach = 1.5 * self.reach.max(self.extent);
        let is_near = scene.planes.iter().any(|plane| plane.depth(centre) > -reach);
        if is_near { &scene.planes } else { &[] }
    }

    /// The corner nodes of each cell.
    pub fn corners(&self) -> &[[u32; 8]] {
        match &self.matter {
            Matter::Lattice(springs) => &springs.lattice.corners,
            Matter::Fem(_) => &self.surface.cells.corners,
        }
    }

    /// Positions of the nodes relative to the centre [scene unit], and velocities relative to it [scene unit/s].
    pub fn state(&self) -> [&[DVec3]; 2] {
        match &self.matter {
            Matter::Lattice(springs) => [&springs.motion.positions, &springs.motion.velocities],
            Matter::Fem(finite) => [&finite.positions, &finite.velocities],
        }
    }

    /// Whether it has less than a fifth of its volume at rest, or most of it is inside out.
    pub fn has_collapsed(&self) -> bool {
        const LEFT: f64 = 0.2;
        let places = [self.state()[0], &self.rest];
        // the linear map that fits the nodes best says whether the cells have to be summed up
        let [now, at_rest] = places.map(|places| self.moment_of(places).determinant());
        if now >= LEFT * at_rest {
            return false;
        }
        let [now, at_rest] = places.map(|places| self.volume(places));
        now < LEFT * at_rest
    }

    /// A multiple of its volume with its nodes at these positions: the mean over the cells that are left, by their shares of its
    /// mass.
    fn volume(&self, places: &[DVec3]) -> f64 {
        let is_left = |cell: usize| match &self.matter {
            Matter::Lattice(springs) => springs.lattice.is_whole[cell],
            Matter::Fem(_) => true,
        };
        let cells = self.corners().iter().zip(&self.surface.cells.weights).enumerate();
        let volumes = cells.filter(|(cell, _)| is_left(*cell)).flat_map(|(_, (corners, share))| {
            TETRAHEDRA.map(|of| {
                let [a, b, c, d] = of.map(|corner| places[corners[corner] as usize]);
                share * (b - a).cross(c - a).dot(d - a) / 6.0
            })
        });
        volumes.sum()
    }

    /// Σ m p lᵀ of these positions of its nodes that are not held: its polar decomposition gives the axes that fit best.
    pub fn moment_of(&self, places: &[DVec3]) -> DMat3 {
        let nodes = places.iter().zip(&self.rest).zip(self.masses()).zip(self.held()).filter(|(_, held)| !**held);
        nodes.fold(DMat3::ZERO, |fit, (((place, l), m), _)| fit + outer(*place * *m, *l))
    }

    /// Adds a velocity to the nodes that are not held [scene unit/s].
    pub fn kick(&mut self, by: DVec3) {
        if by == DVec3::ZERO {
            return;
        }
        self.is_at_rest = false;
        self.forget();
        match &mut self.matter {
            Matter::Lattice(springs) => springs.motion.kick(by),
            Matter::Fem(finite) => finite.element.free.iter().for_each(|&node| finite.velocities[node as usize] += by),
        }
    }

    /// Writes the external accelerations of the nodes, but for friction, to `into`, for a free body minus their mean, given
    /// their positions.
    pub fn act(
        &self,
        scene: &Scene,
        now: &Instantaneous,
        positions: &[DVec3],
        into: &mut [DVec3],
        acted: &mut ExternalForces,
    ) {
        into.fill(now.uniform);
        acted.pulls.clear();
        let (masses, held, is_free) = (self.masses(), self.held(), self.free.is_some());
        // nodes that are no longer part of a free body have no mass
        let mass = |node: usize| if is_free && held[node] { 0.0 } else { masses[node] };
        for sphere in &now.spheres {
            let mut sum = DVec3::ZERO;
            for (node, (into, position)) in into.iter_mut().zip(positions).enumerate() {
                let to_centre = sphere.centre - *position;
                if to_centre.length_squared() < sphere.sphere_radius * sphere.sphere_radius {
                    let pull = sphere.acceleration(scene.influence.weight, *position);
                    *into += pull;
                    sum += pull * mass(node);
                }
            }
            acted.pulls.extend(sphere.body().map(|body| (body, sum)));
        }
        let turned = now.rotation.inverse();
        for &(direction, strength) in &now.pushes {
            let towards = turned * direction;
            for (into, facing) in into.iter_mut().zip(&self.directions) {
                *into += direction * (strength * f64::max(0.0, -facing.dot(towards)));
            }
        }
        self.contacts(scene, now.centre, positions, |contact| contact.accelerate(masses, None, into));
        (acted.mean, acted.rubbed) = (DVec3::ZERO, DVec3::ZERO);
        if is_free {
            let (mut sum, mut all) = (DVec3::ZERO, 0.0);
            for (node, into) in into.iter().enumerate() {
                sum += *into * mass(node);
                all += mass(node);
            }
            if all > 0.0 && sum != DVec3::ZERO {
                acted.mean = sum / all;
                into.iter_mut().for_each(|into| *into -= acted.mean);
            }
        }
    }

    /// Tears a lattice where it is overloaded.
    pub fn tear(&mut self, around: &StepContext<'_>, centre: DVec3) {
        let settings = around.scene.lattice;
        let Body { matter, statistics, tears, rest, directions, surface, torn, radius, .. } = self;
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
    }

    /// Records the cells in which a body of finite elements would tear.
    pub fn strain(&mut self, around: &StepContext<'_>, centre: DVec3) {
        let Some(limit) = around.scene.fem.tear_stress else { return };
        let Body { matter, statistics, tears, x, surface, rest, free, .. } = self;
        let Matter::Fem(finite) = matter else { return };
        let Finite { element, torn, .. } = &mut **finite;
        let axes = free.as_ref().map(|free| DMat3::from_quat(free.rotation));
        let turned = axes.map(|axes| x.iter().map(|x| axes.transpose() * *x).collect::<Vec<_>>());
        element.tensions(turned.as_ref().unwrap_or(x), |cell, stress| {
            statistics.tension = statistics.tension.max(stress);
            let is_torn = &mut torn[cell];
            if stress > limit && !*is_torn {
                *is_torn = true;
                statistics.torn += 1;
                let corners = surface.cells.corners[cell];
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

    /// Updates what follows from the nodes, and checks for divergence.
    pub fn update_state(&mut self, around: &StepContext<'_>) {
        let mut is_finite = self.free.as_ref().is_none_or(|free| free.centre.is_finite() && free.velocity.is_finite());
        if !self.is_at_rest {
            self.measure();
            let is_still = self.free.as_ref().is_none_or(|free| free.spin == DVec3::ZERO);
            self.is_at_rest = is_still && self.x.iter().chain(&self.u).all(|v| *v == DVec3::ZERO);
            is_finite &= self.state().into_iter().flatten().all(|v| v.is_finite());
        }
        if self.failure.is_none() && (!is_finite || self.extent > DIVERGED * self.radius) {
            let scene = around.scene;
            let remedy = match scene.integrator {
                Integrator::Exponential => "use weaker pushes and forces, or a smaller dt".to_owned(),
                _ => format!(
                    "stable below {:.1e} s: use a smaller dt, or `exponential`, which divides it",
                    self.statistics.step_limit
                ),
            };
            self.failure = Some(StepFailure::Diverged(format!(
                "diverged at step {} (t = {:.6} s): body \"{}\", its nodes are {} scene units away; {} with dt = {} s; {remedy}",
                around.step,
                around.end,
                scene.bodies[self.index].name,
                short(self.extent),
                scene.integrator,
                short(scene.dt),
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

    /// The rotation of its frame.
    pub fn rotation(&self) -> DQuat {
        self.free.as_ref().map_or(DQuat::IDENTITY, |free| free.rotation)
    }

    /// The axes of its frame.
    pub fn axes(&self) -> DMat3 {
        DMat3::from_quat(self.rotation())
    }

    /// Vectors of the free nodes in body axes, in the order of elimination.
    fn in_axes(&self, element: &Element, of: &[DVec3]) -> Vec<DVec3> {
        let back = self.axes().transpose();
        element.free.iter().map(|&node| back * of[node as usize]).collect()
    }

    /// Whether each node is held.
    pub fn held(&self) -> &[bool] {
        match &self.matter {
            Matter::Lattice(springs) => &springs.lattice.held,
            Matter::Fem(finite) => &finite.held,
        }
    }

    /// Adds its springs to `springs`.
    pub fn add_springs(&self, springs: &mut Vec<SpringFrame>) {
        let Matter::Lattice(of) = &self.matter else { return };
        let [places, _] = self.state();
        springs.extend(of.lattice.springs().map(|spring| {
            let ends = [spring.a, spring.b].map(|node| places[node as usize]);
            SpringFrame { ends, strain: ends[0].distance(ends[1]) / spring.rest - 1.0 }
        }));
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
