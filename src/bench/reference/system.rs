//! The equation of motion of the vertices that are solved together, and the kinks of its right-hand side.
//!
//! A kink is a place where the right-hand side or one of its derivatives jumps: the rim of an influence sphere, a plane,
//! an end of the rim of a core, and the thresholds of a pair. Which side of each kink the state is on is a
//! [`Mode`]; for a given mode the right-hand side continues smoothly beyond all kinks.

use std::ops::Range;

use glam::{DMat3, DQuat, DVec3};

use crate::{
    bench::source_path,
    geometry::Mesh,
    model::{
        PairLaw,
        influence::{Scaling, Weight},
        phase::{Phase, Transition},
        shape_matching::{Rotation, best_rotation, outer, resistance},
    },
    scene::{Body, Motion, Path, Push, Response, Scene, path::Kinematics},
};

/// A vertex.
#[derive(Clone, Copy)]
struct Particle {
    /// Rest position from the centre [scene unit].
    rest: DVec3,
    /// Direction of the rest position.
    facing: DVec3,
    mass: f64,
}

/// A body with vertices in the system.
struct Member<'a> {
    body: &'a Body,
    /// Index into the scene's bodies.
    index: usize,
    particles: Range<usize>,
}

/// Vertices that are solved together: one vertex of a body on a path, which nothing else depends on, or all vertices of
/// a scene with free bodies.
///
/// The state is the coordinates of all vertices, then their rates. The coordinates of a vertex of a free body are its
/// position; those of another, its displacement from rest.
pub(super) struct System<'a> {
    scene: &'a Scene,
    members: Vec<Member<'a>>,
    particles: Vec<Particle>,
}

/// A time interval over which forces do not jump at known times; requested instants also end intervals.
pub(super) struct Chunk<'a> {
    /// [s]
    pub(super) start: f64,
    /// [s]
    pub(super) end: f64,
    /// Whether its end is a requested instant.
    pub(super) is_sample: bool,
    /// The bodies that matter in it, by their index in the scene, and the force points, as in [`Scene::source_path`]. The
    /// first are the members of the system.
    pub(super) bodies: Vec<usize>,
    /// The pairs that matter in it.
    pub(super) links: Vec<Link>,
    /// The pushes on members in it.
    pub(super) pushes: Vec<&'a Push>,
    /// Whether some centre jumps at its start.
    pub(super) is_jump: bool,
    /// Whether vertices that are at rest stay so.
    pub(super) is_calm: bool,
}

/// A pair of bodies.
#[derive(Clone, Copy)]
pub(super) struct Link {
    /// The bodies, as indices into [`Chunk::bodies`].
    pub(super) bodies: [usize; 2],
    pub(super) law: PairLaw,
    /// The phase throughout the chunk, if the motion of both centres is known; otherwise it is found on the way.
    pub(super) phase: Option<Phase>,
}

/// The side of each kink that the state is on.
#[derive(Clone, Default)]
pub(super) struct Mode {
    pub(super) links: Vec<Side>,
    /// Whether a vertex is behind a plane, `[plane][particle]`.
    behind: Vec<Vec<bool>>,
}

/// The sides of the kinks of a pair.
#[derive(Clone)]
pub(super) struct Side {
    pub(super) phase: Phase,
    /// Of the rim of its core: within (0), in the rim (1), beyond (2).
    zone: usize,
    /// Whether a vertex of one body is inside the sphere of the other, `[body][particle of that body]`.
    inside: [Vec<bool>; 2],
}

/// A kink. Its margin is the distance [scene unit] from it, positive on the side that the mode says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Kink {
    /// A plane, for a vertex.
    Plane { plane: usize, particle: usize },
    /// The rim of an influence sphere, for a vertex of the body on this side of a link.
    Rim { link: usize, side: usize, particle: usize },
    /// An end of the rim of a core, at this q; beyond is this zone.
    Zone { link: usize, level: f64, to: usize },
    /// A threshold.
    Threshold { link: usize, transition: Transition },
}

impl Kink {
    /// Whether the force itself jumps.
    pub(super) fn is_jump(self) -> bool {
        matches!(self, Kink::Threshold { .. })
    }
}

/// What the margins of kinks depend on: positions of vertices and centres, with their velocities.
pub(super) trait Places {
    /// Position of a vertex in the world [scene unit].
    fn vertex(&self, particle: usize) -> DVec3;
    /// Position of the centre of a body, by its index in [`Chunk::bodies`] [scene unit].
    fn centre(&self, body: usize) -> DVec3;
}

/// Centres and vertices in the world at one instant. It is scratch storage too.
#[derive(Clone, Default)]
pub(super) struct World {
    pub(super) centres: Vec<DVec3>,
    pub(super) centre_rates: Vec<DVec3>,
    pub(super) vertices: Vec<DVec3>,
    pub(super) rates: Vec<DVec3>,
    reactions: Vec<DVec3>,
}

impl Places for World {
    fn vertex(&self, particle: usize) -> DVec3 {
        self.vertices[particle]
    }

    fn centre(&self, body: usize) -> DVec3 {
        self.centres[body]
    }
}

/// Vector `i` of a list of coordinates.
pub(super) fn vector(of: &[f64], i: usize) -> DVec3 {
    DVec3::from_slice(&of[3 * i..])
}

fn add(to: &mut [f64], i: usize, v: DVec3) {
    to[3 * i..3 * i + 3].iter_mut().zip(v.to_array()).for_each(|(to, v)| *to += v);
}

/// The motion of a path within a chunk; at the chunk's end, its limit from the left.
pub(super) fn on_path(path: &Path, chunk: &Chunk<'_>, t: f64) -> Kinematics {
    if t < chunk.end { path.at(t) } else { path.before(chunk.end) }
}

impl<'a> System<'a> {
    /// A vertex of a body on a path.
    pub(super) fn of_vertex(scene: &'a Scene, index: usize, mesh: &Mesh, vertex: usize) -> System<'a> {
        let body = &scene.bodies[index];
        let rest = mesh.at(body.radius);
        let particle = Particle { rest: rest.position(vertex), facing: rest.direction(vertex), mass: 0.0 };
        System { scene, members: vec![Member { body, index, particles: 0..1 }], particles: vec![particle] }
    }

    /// All vertices of a scene.
    pub(super) fn of_scene(scene: &'a Scene) -> System<'a> {
        let (mut members, mut particles) = (Vec::new(), Vec::new());
        for (index, body) in scene.bodies.iter().enumerate() {
            let mesh = body.shape.mesh();
            let first = particles.len();
            let rest = mesh.at(body.radius);
            let mean: DVec3 = (0..rest.len()).map(|i| mesh.shares()[i] * rest.position(i)).sum();
            let offset = if body.path().is_none() { mean } else { DVec3::ZERO };
            particles.extend((0..rest.len()).map(|i| Particle {
                rest: rest.position(i) - offset,
                facing: rest.direction(i),
                mass: body.mass * mesh.shares()[i],
            }));
            members.push(Member { body, index, particles: first..particles.len() });
        }
        System { scene, members, particles }
    }

    /// Number of vertices.
    pub(super) fn len(&self) -> usize {
        self.particles.len()
    }

    /// Index of the body of a vertex in the scene.
    pub(super) fn body_of(&self, particle: usize) -> usize {
        self.members.iter().find(|member| member.particles.contains(&particle)).map_or(0, |member| member.index)
    }

    /// The permitted errors of all coordinates: `tolerance` in radii for coordinates, in radii times `rate` for rates;
    /// no less than rounding allows over the time until `end`.
    pub(super) fn tolerances(&self, tolerance: f64, rate: f64, times: &[f64]) -> Vec<f64> {
        let end = times.last().copied().unwrap_or(0.0);
        let of = |member: &Member<'_>| {
            let far = match &member.body.motion {
                Motion::Prescribed(path) => {
                    times.iter().map(|&t| path.position(t).length()).fold(0.0, f64::max)
                        + path.bounds(0.0, end).speed * end
                }
                Motion::Free(free) => {
                    free.from.length() + end * (free.velocity.length() + 0.5 * end * self.scene.gravity.length())
                }
            };
            let x = f64::max(tolerance * member.body.radius, super::ROUNDING * far);
            std::iter::repeat_n(x, 3 * member.particles.len())
        };
        let x: Vec<f64> = self.members.iter().flat_map(of).collect();
        x.iter().copied().chain(x.iter().map(|x| x * rate)).collect()
    }

    /// The state at t = 0.
    pub(super) fn initial(&self) -> Vec<f64> {
        let n = 3 * self.len();
        let mut state = vec![0.0; 2 * n];
        let (coordinates, rates) = state.split_at_mut(n);
        for member in &self.members {
            let Motion::Free(free) = &member.body.motion else { continue };
            for i in member.particles.clone() {
                let rest = self.particles[i].rest;
                add(coordinates, i, free.from + rest);
                add(rates, i, free.velocity + free.spin.cross(rest));
            }
        }
        state
    }

    /// What happens to the state at the start of a chunk: where the velocity of a centre jumps, the vertices of a body
    /// that responds keep their velocities in the world.
    pub(super) fn kick(&self, chunk: &Chunk<'_>, state: &mut [f64]) {
        let (_, rates) = state.split_at_mut(3 * self.len());
        for member in self.members.iter().filter(|member| member.body.material.response != Response::Rigid) {
            let kick = member.body.path().map_or(DVec3::ZERO, |path| path.kick(chunk.start));
            if kick != DVec3::ZERO {
                member.particles.clone().for_each(|i| add(rates, i, -kick));
            }
        }
    }

    /// The sum of the pushes of a chunk on a vertex whose rest position is in direction `facing` [scene unit/s²].
    fn push(chunk: &Chunk<'_>, body: usize, facing: DVec3) -> DVec3 {
        let push = |push: &&Push| push.strength * f64::max(0.0, -facing.dot(push.direction)) * push.direction;
        chunk.pushes.iter().filter(|push| push.body == body).map(push).sum()
    }

    /// Whether the vertices are at rest, and stay so in this chunk.
    pub(super) fn is_calm(&self, chunk: &Chunk<'_>, state: &[f64]) -> bool {
        let is_pushed = |member: &Member<'_>| {
            let mut facing = self.particles[member.particles.clone()].iter().map(|particle| particle.facing);
            facing.any(|facing| System::push(chunk, member.index, facing) != DVec3::ZERO)
        };
        chunk.is_calm && state.iter().all(|&value| value == 0.0) && !self.members.iter().any(is_pushed)
    }

    /// Centres and vertices in the world.
    pub(super) fn place(&self, chunk: &Chunk<'_>, t: f64, state: &[f64], world: &mut World) {
        let (coordinates, rates) = state.split_at(3 * self.len());
        let World { centres, centre_rates, vertices, rates: velocities, .. } = world;
        [&mut *centres, &mut *centre_rates, &mut *vertices, &mut *velocities].into_iter().for_each(Vec::clear);
        for (k, &body) in chunk.bodies.iter().enumerate() {
            let (centre, rate) = match self.scene.source_path(body) {
                Some(path) => {
                    let at = on_path(path, chunk, t);
                    (at.position, at.velocity)
                }
                None => (self.mean(k, coordinates), self.mean(k, rates)),
            };
            centres.push(centre);
            centre_rates.push(rate);
        }
        for (k, member) in self.members.iter().enumerate() {
            let (centre, rate) = (centres[k], centre_rates[k]);
            for i in member.particles.clone() {
                let (x, u) = (vector(coordinates, i), vector(rates, i));
                if member.body.path().is_some() {
                    vertices.push(centre + self.particles[i].rest + x);
                    velocities.push(rate + u);
                } else {
                    vertices.push(x);
                    velocities.push(u);
                }
            }
        }
    }

    /// The mass-weighted mean over the vertices of a member.
    pub(super) fn mean(&self, member: usize, of: &[f64]) -> DVec3 {
        let member = &self.members[member];
        let sum: DVec3 = member.particles.clone().map(|i| self.particles[i].mass * vector(of, i)).sum();
        sum / member.body.mass
    }

    /// Whether a body of a chunk is free.
    pub(super) fn is_free(&self, chunk: &Chunk<'_>, body: usize) -> bool {
        self.scene.source_path(chunk.bodies[body]).is_none()
    }

    /// The path of a body of a chunk that is on one.
    pub(super) fn path_of(&self, chunk: &Chunk<'_>, body: usize) -> &'a Path {
        source_path(self.scene, chunk.bodies[body])
    }

    /// The path of the body of a vertex, if it is on one, and the rest position of the vertex.
    pub(super) fn prescribed(&self, particle: usize) -> Option<(&'a Path, DVec3)> {
        let member = self.members.iter().find(|member| member.particles.contains(&particle))?;
        member.body.path().map(|path| (path, self.particles[particle].rest))
    }

    // --- the equation of motion -------------------------------------------------------------------------------------

    /// Writes the rate of the state, in a mode.
    pub(super) fn slope(
        &self,
        chunk: &Chunk<'_>,
        mode: &Mode,
        t: f64,
        state: &[f64],
        world: &mut World,
        slope: &mut [f64],
    ) {
        let n = 3 * self.len();
        self.place(chunk, t, state, world);
        slope[..n].copy_from_slice(&state[n..]);
        let accelerations = &mut slope[n..];
        accelerations.fill(0.0);
        for (k, member) in self.members.iter().enumerate() {
            self.own(chunk, k, member, mode, t, state, world, accelerations);
        }
        world.reactions.clear();
        world.reactions.resize(chunk.bodies.len(), DVec3::ZERO);
        for (link, side) in chunk.links.iter().zip(&mode.links) {
            self.attract(chunk, link, side, world, accelerations);
        }
        for (k, member) in self.members.iter().enumerate().filter(|(_, member)| member.body.path().is_none()) {
            let all = self.scene.gravity + world.reactions[k] / member.body.mass;
            member.particles.clone().for_each(|i| add(accelerations, i, all));
        }
    }

    /// Springs, damping, carry, pushes and planes.
    #[expect(clippy::too_many_arguments, reason = "the parts of one sum, which share nothing else")]
    fn own(
        &self,
        chunk: &Chunk<'_>,
        k: usize,
        member: &Member<'_>,
        mode: &Mode,
        t: f64,
        state: &[f64],
        world: &World,
        accelerations: &mut [f64],
    ) {
        let (coordinates, rates) = state.split_at(3 * self.len());
        let body = member.body;
        let (omega, damping) = (body.material.omega, body.material.damping);
        let (centre, velocity) = (world.centres[k], world.centre_rates[k]);
        let (turn, spin, carry) = match &body.motion {
            Motion::Prescribed(path) => {
                let acceleration = on_path(path, chunk, t).acceleration;
                let carry = match body.material.response {
                    Response::Rigid => DVec3::ZERO,
                    Response::Inertial => acceleration,
                    Response::World => acceleration + 2.0 * damping * velocity,
                };
                (DMat3::IDENTITY, DVec3::ZERO, carry)
            }
            Motion::Free(free) => {
                let (turn, spin) = match free.rotation {
                    Rotation::Fixed => (DMat3::IDENTITY, DVec3::ZERO),
                    Rotation::Free => self.turn(member, centre, velocity, world),
                };
                (turn, spin, DVec3::ZERO)
            }
        };
        for i in member.particles.clone() {
            let Particle { rest, facing, .. } = self.particles[i];
            let mut sum = if body.path().is_some() {
                -omega * omega * vector(coordinates, i) - 2.0 * damping * vector(rates, i) - carry
            } else {
                let (s, rate) = (world.vertices[i] - centre, world.rates[i] - velocity);
                -omega * omega * (s - turn * rest) - 2.0 * damping * (rate - spin.cross(s))
            };
            if !chunk.pushes.is_empty() {
                sum += System::push(chunk, member.index, turn * facing);
            }
            for (plane, behind) in self.scene.planes.iter().zip(&mode.behind) {
                if behind[i] {
                    let depth = plane.offset - plane.normal.dot(world.vertices[i]);
                    let v = world.rates[i];
                    let along = v - plane.normal.dot(v) * plane.normal;
                    let slip = (along.length_squared() + plane.slip * plane.slip).sqrt();
                    sum += plane.stiffness * depth * (plane.normal - plane.friction / slip * along);
                }
            }
            add(accelerations, i, sum);
        }
    }

    /// The rotation that fits the vertices of a member best, and their mean angular velocity.
    fn turn(&self, member: &Member<'_>, centre: DVec3, velocity: DVec3, world: &World) -> (DMat3, DVec3) {
        let (mut fit, mut spread, mut momentum) = (DMat3::ZERO, DMat3::ZERO, DVec3::ZERO);
        for i in member.particles.clone() {
            let Particle { rest, mass, .. } = self.particles[i];
            let (s, rate) = (world.vertices[i] - centre, world.rates[i] - velocity);
            fit += outer(mass * s, rest);
            spread += outer(mass * s, s);
            momentum += mass * s.cross(rate);
        }
        (polar(fit), resistance(spread).inverse() * momentum)
    }

    /// (3.4) and (3.5), and the reactions.
    fn attract(&self, chunk: &Chunk<'_>, link: &Link, side: &Side, world: &mut World, accelerations: &mut [f64]) {
        let strength = self.strength(chunk, link, side, world);
        if strength == 0.0 {
            return;
        }
        for (one, source) in [(0, 1), (1, 0)] {
            let (own, other) = (link.bodies[one], link.bodies[source]);
            let Some(member) = self.members.get(own) else { continue };
            let (radius, of_source) = (member.body.radius, self.scene.source_radius(chunk.bodies[other]));
            let scale = match self.scene.influence.scaling {
                Scaling::Absolute => 1.0,
                Scaling::Relative => (radius / of_source).min(1.0),
            };
            let reach = self.scene.source_sphere_radius(chunk.bodies[other]);
            let mut pull = DVec3::ZERO;
            for (i, _) in member.particles.clone().zip(&side.inside[one]).filter(|(_, inside)| **inside) {
                let to_centre = world.centres[other] - world.vertices[i];
                let z = to_centre.length() / reach;
                // beyond the rim, where a step may sample before it is shortened, the inside law continues
                let weight = match self.scene.influence.weight {
                    Weight::Linear => 1.0 - z,
                    Weight::Wendland => (1.0 - z).powi(4) * (4.0 * z + 1.0),
                };
                let force = scale * strength * weight * to_centre;
                add(accelerations, i, force);
                pull += self.particles[i].mass * force;
            }
            world.reactions[other] -= pull;
        }
    }

    /// The strength of a pair, as if of equal size [1/s²]: α attracts, −β repels.
    fn strength(&self, chunk: &Chunk<'_>, link: &Link, side: &Side, world: &World) -> f64 {
        let law = &link.law;
        match (law.rim(side.phase), side.phase) {
            (Some(rim), _) => match side.zone {
                0 => -law.beta,
                1 => {
                    let [a, b] = link.bodies;
                    let q = world.centres[a].distance(world.centres[b]) / self.radii(chunk, link);
                    let z = (q - rim.core_at) / rim.width + 0.5;
                    (law.alpha + law.beta) * z * z * (3.0 - 2.0 * z) - law.beta
                }
                _ => law.alpha,
            },
            (None, Phase::Merged) => law.alpha,
            (None, Phase::Core) => -law.beta,
            (None, Phase::Apart) => {
                if law.apart_repels {
                    -law.beta
                } else {
                    0.0
                }
            }
        }
    }

    /// The sum of the radii of a pair [scene unit].
    fn radii(&self, chunk: &Chunk<'_>, link: &Link) -> f64 {
        link.bodies.iter().map(|&body| self.scene.source_radius(chunk.bodies[body])).sum()
    }

    // --- kinks ------------------------------------------------------------------------------------------------------

    /// q of a pair.
    pub(super) fn q(&self, chunk: &Chunk<'_>, link: &Link, world: &World) -> f64 {
        let [a, b] = link.bodies;
        world.centres[a].distance(world.centres[b]) / self.radii(chunk, link)
    }

    /// The mode of a state at the start of a chunk; `known` is that at the end of the chunk before.
    pub(super) fn mode(&self, chunk: &Chunk<'_>, world: &World, known: Option<(&Chunk<'_>, &Mode)>) -> Mode {
        let before = |link: &Link| {
            let (earlier, mode) = known?;
            let names = |chunk: &Chunk<'_>, link: &Link| link.bodies.map(|body| chunk.bodies[body]);
            let wanted = names(chunk, link);
            let at = earlier.links.iter().position(|link| names(earlier, link) == wanted)?;
            mode.links.get(at)
        };
        let behind = |plane: usize| {
            let side = |i: usize| {
                let kink = Kink::Plane { plane, particle: i };
                let was = known.and_then(|(_, mode)| mode.behind.get(plane)).map(|behind| behind[i]);
                self.side(chunk, kink, world, was)
            };
            (0..self.len()).map(side).collect()
        };
        let side = |link: (usize, &Link)| {
            let (index, link) = link;
            let before = before(link);
            let phase = link.phase.or(before.map(|before| before.phase));
            let phase = phase.unwrap_or_else(|| link.law.thresholds.initial(self.q(chunk, link, world)));
            self.sides_of(chunk, index, phase, world, before)
        };
        Mode {
            links: chunk.links.iter().enumerate().map(side).collect(),
            behind: (0..self.scene.planes.len()).map(behind).collect(),
        }
    }

    /// The sides of a pair in a phase.
    pub(super) fn sides_of(
        &self,
        chunk: &Chunk<'_>,
        index: usize,
        phase: Phase,
        world: &World,
        known: Option<&Side>,
    ) -> Side {
        let link = &chunk.links[index];
        let q = self.q(chunk, link, world);
        let zone = link.law.rim(phase).map_or(2, |rim| rim.ends().iter().filter(|&&end| q > end).count());
        let inside = [0, 1].map(|one| {
            let Some(member) = self.members.get(link.bodies[one]) else { return Vec::new() };
            let side = |(k, i): (usize, usize)| {
                let kink = Kink::Rim { link: index, side: one, particle: i };
                self.side(chunk, kink, world, known.and_then(|side| side.inside[one].get(k).copied()))
            };
            member.particles.clone().enumerate().map(side).collect()
        });
        Side { phase, zone, inside }
    }

    /// Whether a vertex is inside a sphere or behind a plane. At the kink itself, which it may just have crossed or be
    /// about to cross: the side that it was on if that is known, otherwise the side to which it moves.
    fn side(&self, chunk: &Chunk<'_>, kink: Kink, world: &World, known: Option<bool>) -> bool {
        let value = self.inner(chunk, kink, world);
        if value.abs() > super::AT_KINK * self.scale(chunk, kink) {
            return value > 0.0;
        }
        known.unwrap_or_else(|| self.inner_rate(chunk, kink, world) > 0.0)
    }

    /// A length that margins of a kink can be compared with [scene unit].
    pub(super) fn scale(&self, chunk: &Chunk<'_>, kink: Kink) -> f64 {
        match kink {
            Kink::Plane { particle, .. } => self.scene.bodies[self.body_of(particle)].radius,
            Kink::Rim { link, side, .. } => self.scene.source_radius(chunk.bodies[chunk.links[link].bodies[1 - side]]),
            Kink::Zone { link, .. } | Kink::Threshold { link, .. } => self.radii(chunk, &chunk.links[link]),
        }
    }

    /// How far the state is inside a sphere, behind a plane, beyond the end of a core's rim or a threshold, in the
    /// sense in which q falls [scene unit].
    fn inner(&self, chunk: &Chunk<'_>, kink: Kink, places: &impl Places) -> f64 {
        match kink {
            Kink::Plane { plane, particle } => {
                let plane = &self.scene.planes[plane];
                plane.offset - plane.normal.dot(places.vertex(particle))
            }
            Kink::Rim { link, side, particle } => {
                let source = chunk.links[link].bodies[1 - side];
                let reach = self.scene.source_sphere_radius(chunk.bodies[source]);
                reach - places.centre(source).distance(places.vertex(particle))
            }
            Kink::Zone { link, level, .. } | Kink::Threshold { link, transition: Transition { level, .. } } => {
                let [a, b] = chunk.links[link].bodies;
                level * self.radii(chunk, &chunk.links[link]) - places.centre(a).distance(places.centre(b))
            }
        }
    }

    /// The rate of [`System::inner`] [scene unit/s].
    fn inner_rate(&self, chunk: &Chunk<'_>, kink: Kink, world: &World) -> f64 {
        let approach = |[p, q]: [DVec3; 2], [v, w]: [DVec3; 2]| -(p - q).normalize_or_zero().dot(v - w);
        match kink {
            Kink::Plane { plane, particle } => -self.scene.planes[plane].normal.dot(world.rates[particle]),
            Kink::Rim { link, side, particle: i } => {
                let source = chunk.links[link].bodies[1 - side];
                approach([world.centres[source], world.vertices[i]], [world.centre_rates[source], world.rates[i]])
            }
            Kink::Zone { link, .. } | Kink::Threshold { link, .. } => {
                let [a, b] = chunk.links[link].bodies;
                approach([world.centres[a], world.centres[b]], [world.centre_rates[a], world.centre_rates[b]])
            }
        }
    }

    /// Whether the mode says that [`System::inner`] is positive.
    fn is_inner(mode: &Mode, kink: Kink, first: usize) -> bool {
        match kink {
            Kink::Plane { plane, particle } => mode.behind[plane][particle],
            Kink::Rim { link, side, particle } => mode.links[link].inside[side][particle - first],
            Kink::Zone { link, to, .. } => to > mode.links[link].zone,
            Kink::Threshold { transition, .. } => !transition.falling,
        }
    }

    fn first_particle(&self, chunk: &Chunk<'_>, kink: Kink) -> usize {
        match kink {
            Kink::Rim { link, side, .. } => self.members[chunk.links[link].bodies[side]].particles.start,
            _ => 0,
        }
    }

    /// The margin of a kink [scene unit].
    pub(super) fn margin(&self, chunk: &Chunk<'_>, mode: &Mode, kink: Kink, places: &impl Places) -> f64 {
        let is_inner = System::is_inner(mode, kink, self.first_particle(chunk, kink));
        let inner = self.inner(chunk, kink, places);
        if is_inner { inner } else { -inner }
    }

    /// The rate of the margin of a kink [scene unit/s].
    pub(super) fn margin_rate(&self, chunk: &Chunk<'_>, mode: &Mode, kink: Kink, world: &World) -> f64 {
        let is_inner = System::is_inner(mode, kink, self.first_particle(chunk, kink));
        let rate = self.inner_rate(chunk, kink, world);
        if is_inner { rate } else { -rate }
    }

    /// Crosses a kink. The phase of a pair changes with all that depends on it.
    pub(super) fn cross(&self, chunk: &Chunk<'_>, mode: &mut Mode, kink: Kink, world: &World) {
        match kink {
            Kink::Plane { plane, particle } => mode.behind[plane][particle] ^= true,
            Kink::Rim { link, side, particle } => {
                let first = self.first_particle(chunk, kink);
                mode.links[link].inside[side][particle - first] ^= true;
            }
            Kink::Zone { link, to, .. } => mode.links[link].zone = to,
            Kink::Threshold { link, transition } => {
                let before = mode.links[link].clone();
                mode.links[link] = self.sides_of(chunk, link, transition.to, world, Some(&before));
            }
        }
    }

    /// Calls `with` with each kink that the state may cross between two instants `h` [s] apart, in a mode.
    pub(super) fn each_kink_near(
        &self,
        chunk: &Chunk<'_>,
        mode: &Mode,
        [from, to]: [&World; 2],
        h: f64,
        mut with: impl FnMut(Kink),
    ) {
        // how far two points can come closer: twice what their velocities at both ends say
        let far = |v: [DVec3; 2], w: [DVec3; 2]| 2.0 * h * (v[0].distance(w[0]) + v[1].distance(w[1]));
        for plane in 0..self.scene.planes.len() {
            for particle in 0..self.len() {
                let kink = Kink::Plane { plane, particle };
                let margins = [from, to].map(|world| self.margin(chunk, mode, kink, world));
                let still = [DVec3::ZERO; 2];
                if margins[0].min(margins[1]) <= far([from.rates[particle], to.rates[particle]], still) {
                    with(kink);
                }
            }
        }
        for (index, (link, side)) in chunk.links.iter().zip(&mode.links).enumerate() {
            let [a, b] = link.bodies;
            let centres = far([from.centre_rates[a], to.centre_rates[a]], [from.centre_rates[b], to.centre_rates[b]]);
            let mut of_pair = |kink: Kink| {
                let margins = [from, to].map(|world| self.margin(chunk, mode, kink, world));
                if margins[0].min(margins[1]) <= centres {
                    with(kink);
                }
            };
            if link.phase.is_none() {
                for transition in link.law.thresholds.transitions(side.phase) {
                    of_pair(Kink::Threshold { link: index, transition });
                }
            }
            if let Some(rim) = link.law.rim(side.phase) {
                let [inner, outer] = rim.ends();
                let zone = side.zone;
                // leaving a zone downwards or upwards
                if zone > 0 {
                    of_pair(Kink::Zone { link: index, level: if zone == 1 { inner } else { outer }, to: zone - 1 });
                }
                if zone < 2 {
                    of_pair(Kink::Zone { link: index, level: if zone == 0 { inner } else { outer }, to: zone + 1 });
                }
            }
            if side.phase == Phase::Apart && !link.law.apart_repels {
                continue;
            }
            for one in [0, 1] {
                let Some(member) = self.members.get(link.bodies[one]) else { continue };
                let source = link.bodies[1 - one];
                for particle in member.particles.clone() {
                    let kink = Kink::Rim { link: index, side: one, particle };
                    let margins = [from, to].map(|world| self.margin(chunk, mode, kink, world));
                    let of_source = [from.centre_rates[source], to.centre_rates[source]];
                    if margins[0].min(margins[1]) <= far([from.rates[particle], to.rates[particle]], of_source) {
                        with(kink);
                    }
                }
            }
        }
    }
}

/// The rotation of the polar decomposition, by Newton's iteration (Higham 1986): X ← ½ (X + X⁻ᵀ). For a body that is
/// turned inside out, where that leads to a reflection, the rotation that fits best.
fn polar(fit: DMat3) -> DMat3 {
    if !(fit.determinant() > 0.0) {
        return DMat3::from_quat(best_rotation(fit, DQuat::IDENTITY));
    }
    let mut x = fit;
    for _ in 0..60 {
        let next = (x + x.inverse().transpose()) * 0.5;
        let change = next - x;
        let far = [change.x_axis, change.y_axis, change.z_axis].map(DVec3::length).into_iter().fold(0.0, f64::max);
        x = next;
        if !(far > 1e-15) {
            break;
        }
    }
    x
}
