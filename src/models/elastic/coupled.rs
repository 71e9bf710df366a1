//! Scenes with free bodies: all bodies are stepped together, since they act on each other and each needs the others'
//! centres at the same instants.
//!
//! A free body consists of its nodes, none of which is held. Their positions s are relative to the mass centre c, which
//! is integrated separately:
//!
//! ```text
//! c″ = f̄ + g + R/M        s″ = f − f̄ + internal accelerations,   f̄ = Σ m f/M
//! ```
//!
//! where f is the external acceleration of a node, and R the reaction, at the centre, to the forces of the body's
//! sphere on others. Internal forces thus never move the centre, not even by rounding, and a falling body is undeformed
//! to the bit.
//!
//! # Lattice
//! Velocity Verlet with common steps for all bodies. The centres move on parabolas that are known before a step is
//! taken; phase changes are located on them, and steps end there. Springs and dampers act along the line between two
//! nodes, spheres along the line to a centre, so momentum and angular momentum are conserved.
//!
//! # Finite elements
//! Linear elements are not invariant under rotation, so the body is co-rotated as a whole: displacements are measured
//! in axes Q that rotate with it, the best fit to its nodes at the middle of a step (Müller et al., Meshless
//! Deformations Based on Shape Matching, 2005; Terzopoulos and Witkin, Physically based models with rigid and
//! deformable components, 1988, use such axes, too). Axes per element would handle larger deformations, but A in
//! [`fem`](crate::models::fem), and so the factor that makes the method fast, would change in every step. The price: a
//! body bent by tens of degrees swells at the bend.
//!
//! Linear forces exert a second-order torque about the displaced nodes, which would rotate an isolated body. A rigid
//! rotation at the end of each step removes it, so that only external torques change the angular momentum. If a pair
//! changes its phase within a step, spheres act in proportion to time, because the factor requires a fixed step.

use std::borrow::Cow;

use glam::{DMat3, DQuat, DVec3};

use super::{
    Elastic, PARALLEL_NODES,
    act::{ActingSphere, Instantaneous, StepContext},
    body::{Body, Contact, Finite, MAX_SPRINGS, Matter, OF_LIMIT, Springs},
    note_phase,
};
use crate::{
    interrupt::is_raised,
    model::{
        influence::{Weight, acceleration},
        phase::Phase,
        shape_matching::{best_rotation, moment, outer, resistance, solve},
    },
    models::lattice::Scheme,
    observe::{PairEvent, StepFailure},
    parallel,
    scene::{
        FreeMotion, Integrator, Model, Path, Plane, Scene,
        path::{Bounds, Given, Kinematics},
    },
    sim::{
        Event,
        events::{PairPaths, Search},
        terms::{self, carry},
        work::{Tally, Work},
    },
};

/// Upper limit on phase changes in a step; more would take forever.
const MAX_CHANGES: usize = 1000;
/// Work for finding the phase changes of a step [units of a step's work]: a second or two.
const MAX_SEARCH: u64 = 1_000_000_000;

/// The rigid motion of a free body.
#[derive(Clone, Debug)]
pub struct Free {
    /// Mass centre [scene unit].
    pub centre: DVec3,
    /// Velocity of the centre [scene unit/s].
    pub velocity: DVec3,
    /// Acceleration of the centre [scene unit/s²].
    acceleration: DVec3,
    /// The rotation Q that best fits the nodes.
    pub rotation: DQuat,
    /// Angular velocity of Q [rad/s].
    pub spin: DVec3,
    /// When Q was fitted [s].
    fitted: f64,
    /// Positions of the nodes relative to the centre [scene unit], `[node_count]`; finite elements only.
    positions: Vec<DVec3>,
    /// Velocities of the nodes relative to the centre [scene unit/s], `[node_count]`; finite elements only.
    velocities: Vec<DVec3>,
}

/// External forces on a body.
#[derive(Clone, Debug, Default)]
pub struct ExternalForces {
    /// f̄ [scene unit/s²].
    mean: DVec3,
    /// Σ m f of each sphere, by its body or force point [mass · scene unit/s²].
    pub pulls: Vec<(u32, DVec3)>,
    /// Accelerations of the nodes minus their mean [scene unit/s²], `[node_count]`.
    loads: Vec<DVec3>,
    /// Node positions at which they acted, relative to the centre [scene unit], `[node_count]`.
    places: Vec<DVec3>,
}

impl ExternalForces {
    /// Allocated memory [bytes].
    pub fn memory(&self) -> usize {
        (self.loads.capacity() + self.places.capacity()) * size_of::<DVec3>()
    }
}

/// The centre of a body and its velocity.
#[derive(Clone, Copy, Debug, Default)]
struct Place {
    centre: DVec3,
    velocity: DVec3,
}

impl Free {
    /// A body at t = 0, with its nodes at their rest positions.
    pub fn new(motion: &FreeMotion, rest: &[DVec3], has_nodes: bool) -> Free {
        let FreeMotion { from, velocity, spin, .. } = *motion;
        let own = |of: &dyn Fn(&DVec3) -> DVec3| if has_nodes { rest.iter().map(of).collect() } else { Vec::new() };
        Free {
            centre: from,
            velocity,
            acceleration: DVec3::ZERO,
            rotation: DQuat::IDENTITY,
            spin,
            fitted: 0.0,
            positions: own(&|l| *l),
            velocities: own(&|l| spin.cross(*l)),
        }
    }

    /// Allocated memory [bytes].
    pub fn memory(&self) -> usize {
        (self.positions.capacity() + self.velocities.capacity()) * size_of::<DVec3>()
    }

    /// Q at time `t` [s] if it goes on turning as it did at the start of the step.
    fn turned(&self, t: f64) -> DQuat {
        let turn = self.spin * (t - self.fitted);
        let angle = turn.length();
        if angle == 0.0 {
            return self.rotation;
        }
        let (sin, cos) = libm::sincos(0.5 * angle);
        DQuat::from_xyzw(turn.x * sin / angle, turn.y * sin / angle, turn.z * sin / angle, cos) * self.rotation
    }

    /// Upper bound of the distance that the centre moves within some time [scene unit].
    pub fn farthest(&self, time: f64) -> f64 {
        (self.velocity.length() + 0.5 * time * self.acceleration.length()) * time
    }

    /// Its motion from `start` to `end` [s], seen from the centre of another body if one is given.
    fn path(&self, from: Option<&Free>, start: f64, end: f64) -> Path {
        let own = [self.centre, self.velocity, self.acceleration];
        let other = from.map_or([DVec3::ZERO; 3], |other| [other.centre, other.velocity, other.acceleration]);
        let [centre, velocity, acceleration] = std::array::from_fn(|k| own[k] - other[k]);
        let at = move |t: f64| Kinematics {
            position: centre + (velocity + acceleration * (0.5 * (t - start))) * (t - start),
            velocity: velocity + acceleration * (t - start),
            acceleration,
        };
        let speed = velocity.length() + acceleration.length() * (end - start);
        Path::Given(Given::new(Bounds { speed, acceleration: acceleration.length() }, at))
    }

    /// c + c′τ + ½c″τ² after τ [s].
    fn after(&self, time: f64) -> DVec3 {
        self.centre + (self.velocity + self.acceleration * (0.5 * time)) * time
    }
}

/// The input for the external forces on nodes, at an instant or averaged.
struct Loads<'a> {
    now: &'a Instantaneous,
    weight: Weight,
    contact: Contact<'a>,
    directions: &'a [DVec3],
    held: &'a [bool],
    rotation: Option<DQuat>,
}

impl Loads<'_> {
    /// Writes accelerations to `into`, for a free body minus their mean.
    fn act(&self, positions: &[DVec3], velocities: &[DVec3], into: &mut [DVec3], acted: &mut ExternalForces) {
        into.fill(self.now.uniform);
        acted.pulls.clear();
        // nodes that are no longer part of a free body have no mass
        let mass =
            |node: usize| if self.rotation.is_some() && self.held[node] { 0.0 } else { self.contact.masses[node] };
        for &ActingSphere { source, centre, strength, radius, .. } in &self.now.spheres {
            let mut sum = DVec3::ZERO;
            for (node, (into, position)) in into.iter_mut().zip(positions).enumerate() {
                let to_centre = centre - *position;
                if to_centre.length_squared() < radius * radius {
                    let pull = acceleration(self.weight, strength, radius, to_centre);
                    *into += pull;
                    sum += pull * mass(node);
                }
            }
            acted.pulls.push((source, sum));
        }
        let turned = self.rotation.unwrap_or_default().inverse();
        for &(direction, strength) in &self.now.pushes {
            let towards = turned * direction;
            for (into, facing) in into.iter_mut().zip(self.directions) {
                *into += direction * (strength * f64::max(0.0, -facing.dot(towards)));
            }
        }
        self.contact.accelerate(positions, velocities, into);
        acted.mean = DVec3::ZERO;
        if self.rotation.is_some() {
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
}

impl Elastic {
    /// Takes a step of a scene with free bodies.
    pub(super) fn take_coupled(&mut self, start: f64, end: f64) -> Result<(), StepFailure> {
        for body in &mut self.bodies {
            body.statistics.substeps = 0;
            body.statistics.strain = 0.0;
            body.tears.clear();
            body.failure = None;
        }
        match self.scene.model {
            Model::Fem => self.take_implicit(start, end)?,
            _ => {
                let Elastic { scene, phases, step, .. } = &*self;
                let around = StepContext { scene, phases, events: &[], start, end, step: *step + 1 };
                let mut breaks = vec![start, end];
                around.add_all_jumps(&mut breaks);
                for (number, ends) in breaks.windows(2).enumerate() {
                    self.take_explicit([ends[0], ends[1]], number == 0)?;
                }
            }
        }
        let Elastic { scene, bodies, phases, step, .. } = self;
        let around = StepContext { scene, phases, events: &[], start, end, step: *step + 1 };
        bodies.iter_mut().for_each(|body| body.finish(&around));
        match bodies.iter_mut().find_map(|body| body.failure.take()) {
            Some(failure) if failure.is_whole_step() => {
                self.failure = Some(failure);
                Ok(())
            }
            Some(failure) => Err(failure),
            None => Ok(()),
        }
    }

    /// Positions of the centres some time after `t` [s], in a part of a step without jumps; those of force points follow.
    fn places(&self, t: f64, ahead: f64, part: [f64; 2]) -> Vec<Place> {
        let on_path = |path: &Path| match path.is_held() {
            // a centre with position jumps stays in place throughout the part
            true => Place { centre: path.position(part[0] + 0.5 * (part[1] - part[0])), velocity: DVec3::ZERO },
            false => Place { centre: path.position(t + ahead), velocity: path.at(t + ahead).velocity },
        };
        let of = |(body, described): (&Body, &crate::scene::Body)| match (&body.free, described.path()) {
            (Some(free), _) => Place { centre: free.after(ahead), velocity: free.velocity + free.acceleration * ahead },
            (None, path) => path.map_or(Place::default(), on_path),
        };
        let points = self.scene.points.iter().map(|point| on_path(&point.path));
        self.bodies.iter().zip(&self.scene.bodies).map(of).chain(points).collect()
    }

    fn take_explicit(&mut self, part: [f64; 2], is_first: bool) -> Result<(), StepFailure> {
        let [start, end] = part;
        let step = self.step + 1;
        self.find_sources(start, end);
        let Elastic { scene, bodies, phases, .. } = self;
        let around = StepContext { scene, phases, events: &[], start, end, step };
        let mut is_known = is_first && !around.jumps_at(start);
        let (mut limit, mut stiffest, mut springs) = (f64::INFINITY, 0, 0);
        for body in bodies.iter_mut() {
            let planes = near(&scene.planes, body.placed.unwrap_or_default().centre, body.reach);
            let planes = planes.iter().map(|plane| plane.stiffness).sum::<f64>() * body.surface.contact;
            let outside = around.stiffness(body.index, &body.sources) + planes;
            let Matter::Lattice(of) = &mut body.matter else { continue };
            let Springs { lattice, motion } = &mut **of;
            if let Some(path) = scene.bodies[body.index].path() {
                let kick = carry::kick(&scene.bodies[body.index].material, path, start);
                if kick != DVec3::ZERO {
                    motion.kick(kick);
                    is_known = false;
                }
            }
            body.statistics.step_limit = lattice.step_limit(outside);
            springs += lattice.spring_count();
            if body.statistics.step_limit < limit {
                (limit, stiffest) = (body.statistics.step_limit, body.index);
            }
        }
        is_known &= bodies.iter().all(Body::is_known);
        let count = match scene.integrator {
            Integrator::Verlet => 1.0,
            _ => ((end - start) / (OF_LIMIT * limit)).ceil().max(1.0),
        };
        if count * springs as f64 > MAX_SPRINGS {
            return Err(StepFailure::NotTaken(format!(
                "too much to do in step {step} (from t = {start:.6} s on): the springs of body \"{}\" need steps below {limit:.1e} s, {count:.0} per \
                step of the scene, for all bodies; lower `omega`, `damping` or `cells` in [lattice]",
                scene.bodies[stiffest].name
            )));
        }
        let mut t = start;
        for number in 1..=count as u64 {
            let to = if number == count as u64 { end } else { start + (end - start) * (number as f64 / count) };
            while t < to {
                self.check_interrupt()?;
                self.find_sources(t, to);
                if !is_known {
                    self.pull_all(t, 0.0, part, true);
                }
                let change = self.changes([t, to], part, true)?.pop();
                let until = change.map_or(to, |change| change.time);
                if until > t {
                    self.pull_all(t, until - t, part, false);
                }
                is_known = change.is_none();
                if let Some(change) = change {
                    self.record(change);
                }
                t = until;
            }
        }
        Ok(())
    }

    /// Evaluates the forces on all bodies at `t` [s] if `is_start`; otherwise takes a step of velocity Verlet of length
    /// `h` from there, and evaluates them at its end.
    fn pull_all(&mut self, t: f64, h: f64, part: [f64; 2], is_start: bool) {
        let places = self.places(t, h, part);
        let Elastic { scene, bodies, phases, step, .. } = self;
        let around = StepContext { scene, phases, events: &[], start: part[0], end: part[1], step: *step + 1 };
        let centres: Vec<DVec3> = places.iter().map(|place| place.centre).collect();
        let at = f64::min(t + h, part[1]);
        for_each_body(bodies, |body| {
            if is_start {
                body.forget();
            }
            body.pull(&around, at, h, u64::from(!is_start), &places, &centres);
        });
        if !is_start {
            for free in bodies.iter_mut().filter_map(|body| body.free.as_mut()) {
                (free.centre, free.velocity) = (free.after(h), free.velocity + free.acceleration * (0.5 * h));
            }
        }
        self.accelerate_centres();
        if !is_start {
            for free in self.bodies.iter_mut().filter_map(|body| body.free.as_mut()) {
                free.velocity += free.acceleration * (0.5 * h);
            }
        }
    }

    /// Updates c″ = f̄ + g + R/M of free bodies from the last external forces.
    fn accelerate_centres(&mut self) {
        let mut reactions = vec![DVec3::ZERO; self.bodies.len() + self.scene.points.len()];
        for body in &self.bodies {
            body.acted.pulls.iter().for_each(|&(source, pull)| reactions[source as usize] -= pull);
        }
        let free_fall = terms::free_fall(&self.scene);
        for (body, reaction) in self.bodies.iter_mut().zip(reactions) {
            let mass = body.free_mass();
            if let Some(free) = &mut body.free {
                let back = if mass > 0.0 { reaction / mass } else { DVec3::ZERO };
                free.acceleration = body.acted.mean + free_fall + back;
            }
        }
    }

    fn take_implicit(&mut self, start: f64, end: f64) -> Result<(), StepFailure> {
        let divided = self.bodies.iter().find_map(Body::divided).unwrap_or(1);
        let at = |step: u64| start + (end - start) * (step as f64 / divided as f64);
        for number in 0..divided {
            self.check_interrupt()?;
            let (ends, h) = ([at(number), at(number + 1)], (end - start) / divided as f64);
            self.find_sources(ends[0], ends[1]);
            for body in &mut self.bodies {
                let described = &self.scene.bodies[body.index];
                if let Some(path) = described.path() {
                    body.kick(carry::kick(&described.material, path, ends[0]));
                }
            }
            // only velocities determine the middle, not the accelerations of the last step
            self.bodies
                .iter_mut()
                .filter_map(|body| body.free.as_mut())
                .for_each(|free| free.acceleration = DVec3::ZERO);
            let middle = self.places(ends[0], 0.5 * h, ends);
            let mut changes: Vec<PairEvent> = Vec::new();
            for is_last in [false, true] {
                let Elastic { scene, bodies, phases, step, .. } = self;
                let around =
                    StepContext { scene, phases, events: &changes, start: ends[0], end: ends[1], step: *step + 1 };
                let centres: Vec<DVec3> = middle.iter().map(|place| place.centre).collect();
                for_each_body(bodies, |body| body.load(&around, ends, h, &middle, &centres));
                self.accelerate_centres();
                if is_last {
                    break;
                }
                changes = self.changes(ends, ends, false)?;
                if changes.is_empty() {
                    break;
                }
            }
            for_each_body(&mut self.bodies, |body| body.step_implicit(ends[0], h));
            for free in self.bodies.iter_mut().filter_map(|body| body.free.as_mut()) {
                (free.centre, free.velocity) = (free.after(h), free.velocity + free.acceleration * h);
            }
            changes.into_iter().for_each(|change| self.record(change));
        }
        self.bodies.iter_mut().for_each(|body| body.statistics.substeps = divided);
        Ok(())
    }

    fn check_interrupt(&self) -> Result<(), StepFailure> {
        match is_raised(self.options.interrupt) {
            true => Err(StepFailure::Interrupted(format!("interrupted in step {}", self.step + 1))),
            false => Ok(()),
        }
    }

    /// Records a phase change.
    fn record(&mut self, event: PairEvent) {
        note_phase(&mut self.phases, &event);
        self.events.push(event);
    }

    /// The known motion of a centre from `start` to `end` [s], in a part of a step without jumps.
    fn path_within(&self, body: usize, [start, end]: [f64; 2], part: [f64; 2]) -> Cow<'_, Path> {
        match (&self.bodies[body].free, self.scene.bodies[body].path()) {
            (Some(free), _) => Cow::Owned(free.path(None, start, end)),
            (None, Some(path)) if path.is_held() => {
                Cow::Owned(Path::Fixed(path.position(part[0] + 0.5 * (part[1] - part[0]))))
            }
            (None, Some(path)) => Cow::Borrowed(path),
            (None, None) => Cow::Owned(Path::Fixed(DVec3::ZERO)),
        }
    }

    /// The phase changes on the known motion of the centres, in order of time; only the first if `only_first`.
    fn changes(&self, [start, end]: [f64; 2], part: [f64; 2], only_first: bool) -> Result<Vec<PairEvent>, StepFailure> {
        let mut pairs: Vec<[u32; 2]> = self.phases.keys().copied().collect();
        for body in &self.bodies {
            let index = body.index as u32;
            pairs.extend(body.near.iter().filter(|&&other| other > index).map(|&other| [index, other]));
        }
        pairs.sort_unstable();
        pairs.dedup();
        let mut found: Vec<PairEvent> = Vec::new();
        let work = Work::limited(MAX_SEARCH, self.options.interrupt);
        let tally = Tally::new(&work, None);
        for pair in pairs {
            let [a, b] = pair.map(|body| body as usize);
            let radii = self.scene.bodies[a].radius + self.scene.bodies[b].radius;
            let [one, other] = match (&self.bodies[a].free, &self.bodies[b].free) {
                // they may be fast, but hardly move relative to each other
                (Some(one), Some(other)) => {
                    [Cow::Owned(Path::Fixed(DVec3::ZERO)), Cow::Owned(other.path(Some(one), start, end))]
                }
                _ => [a, b].map(|body| self.path_within(body, [start, end], part)),
            };
            let between = PairPaths { a: &one, b: &other, radii };
            let thresholds = self.scene.law(a, b).thresholds;
            let search = Search { paths: between, thresholds: &thresholds, work: &tally };
            let mut phase = self.phases.get(&pair).copied().unwrap_or(Phase::Apart);
            let mut from = start;
            while let Some((time, to)) = search.first_change(phase, from, end) {
                let event = Event {
                    time,
                    step: self.step + 1,
                    a: pair[0],
                    b: pair[1],
                    q: between.q(time),
                    rate: between.rate(time),
                    from: phase,
                    to,
                    energy: 0.0,
                };
                found.push(PairEvent::from(&event));
                (from, phase) = (time, to);
                if found.len() + self.events.len() > MAX_CHANGES {
                    let [a, b] = pair.map(|body| &self.scene.bodies[body as usize].name);
                    return Err(StepFailure::NotTaken(format!(
                        "too much to do in step {} (from t = {start:.6} s on): bodies \"{a}\" and \"{b}\" change their phase again and again; set \
                         core_width, or move merge_at, split_at and core_at apart",
                        self.step + 1
                    )));
                }
                if only_first {
                    break;
                }
            }
            if tally.is_over() {
                self.check_interrupt()?;
                let [a, b] = pair.map(|body| &self.scene.bodies[body as usize].name);
                return Err(StepFailure::NotTaken(format!(
                    "too much to do in step {} (from t = {start:.6} s on): bodies \"{a}\" and \"{b}\" move too fast to find when they change \
                     phase; lower their velocities",
                    self.step + 1
                )));
            }
        }
        found.sort_by(|x, y| x.time.total_cmp(&y.time).then((x.a, x.b).cmp(&(y.a, y.b))));
        if only_first {
            found.truncate(1);
        }
        Ok(found)
    }
}

fn for_each_body(bodies: &mut [Body], of: impl Fn(&mut Body) + Sync + Send) {
    let nodes: usize = bodies.iter().map(Body::node_count).sum();
    parallel::over(nodes >= PARALLEL_NODES, bodies, |_, body| of(body));
}

impl Body {
    /// Number of implicit steps in a step of the scene, for finite elements.
    fn divided(&self) -> Option<u64> {
        match &self.matter {
            Matter::Fem(finite) => Some(finite.divided),
            Matter::Lattice(_) => None,
        }
    }

    /// Mass of the nodes that are still part of the body.
    pub fn free_mass(&self) -> f64 {
        (0..self.node_count()).filter(|&node| !self.is_held(node)).map(|node| self.masses()[node]).sum()
    }

    /// Positions of a free body's nodes relative to its centre [scene unit], and velocities relative to it [scene
    /// unit/s].
    pub fn state(&self) -> Option<[&[DVec3]; 2]> {
        let free = self.free.as_ref()?;
        Some(match &self.matter {
            Matter::Lattice(springs) => [&springs.motion.positions, &springs.motion.velocities],
            Matter::Fem(_) => [&free.positions, &free.velocities],
        })
    }

    /// Starts a free lattice with its spin.
    pub fn start(&mut self) {
        if let (Matter::Lattice(springs), Some(free)) = (&mut self.matter, &self.free) {
            let Springs { lattice, motion } = &mut **springs;
            motion.velocities = lattice.rest.iter().map(|l| free.spin.cross(*l)).collect();
        }
        if self.free.is_some() {
            self.fit();
            self.measure();
            self.is_at_rest = self.speed == 0.0;
        }
    }

    /// Whether the forces on its nodes are known for the current positions.
    fn is_known(&self) -> bool {
        match &self.matter {
            Matter::Lattice(springs) => springs.motion.accelerations.len() == springs.lattice.node_count(),
            Matter::Fem(_) => true,
        }
    }

    fn forget(&mut self) {
        if let Matter::Lattice(springs) = &mut self.matter {
            springs.motion.accelerations.clear();
        }
    }

    /// Takes `count` steps of a lattice with the external forces at time `t`; 0 only evaluates the forces.
    fn pull(&mut self, around: &StepContext<'_>, t: f64, h: f64, count: u64, places: &[Place], centres: &[DVec3]) {
        let mut now = std::mem::take(&mut self.now);
        self.find_acting(around, [around.start, around.end], Some(t), centres, &mut now);
        let Body { matter, statistics, surface, directions, index, free, acted, radius, .. } = self;
        let Matter::Lattice(springs) = matter else { return };
        let Springs { lattice, motion } = &mut **springs;
        let place = places[*index];
        let contact = Contact {
            planes: near(&around.scene.planes, place.centre, self.extent.max(*radius)),
            surface,
            corners: &lattice.corners,
            masses: &lattice.masses,
            motion: [place.centre, place.velocity],
            step: h,
        };
        let acting = Loads {
            now: &now,
            weight: around.scene.influence.weight,
            contact,
            directions,
            held: &lattice.held,
            rotation: free.as_ref().map(|free| free.turned(t)),
        };
        let outside = |_: f64, positions: &[DVec3], velocities: &[DVec3], into: &mut [DVec3]| {
            acting.act(positions, velocities, into, acted);
        };
        let largest = lattice.advance(motion, Scheme::Verlet, h, count, outside);
        statistics.strain = statistics.strain.max(largest - 1.0);
        statistics.substeps += count;
        self.now = now;
        self.measure();
    }

    /// Writes the external forces on the body to `now`, averaged over `ends`, or at time `t` if given.
    fn find_acting(
        &self,
        around: &StepContext<'_>,
        ends: [f64; 2],
        t: Option<f64>,
        centres: &[DVec3],
        now: &mut Instantaneous,
    ) {
        now.uniform = DVec3::ZERO;
        if let Some(path) = around.scene.bodies[self.index].path() {
            let part = around.part(path, self.index, &[], &[], ends);
            match t {
                Some(t) => part.at(t, now),
                None => part.averaged(now),
            }
        }
        around.acting(self.index, &self.sources, &self.pushes, ends, centres, now);
    }

    /// Evaluates the external forces on finite elements at the middle of a step.
    fn load(&mut self, around: &StepContext<'_>, ends: [f64; 2], h: f64, places: &[Place], centres: &[DVec3]) {
        let mut now = std::mem::take(&mut self.now);
        self.find_acting(around, ends, None, centres, &mut now);
        let Body { matter, surface, directions, index, free, acted, radius, rest, x, u, .. } = self;
        let Matter::Fem(finite) = matter else { return };
        let place = places[*index];
        let contact = Contact {
            planes: near(&around.scene.planes, place.centre, self.extent.max(*radius)),
            surface,
            corners: &surface.cells.corners,
            masses: &finite.element.masses,
            motion: [place.centre, place.velocity],
            step: h,
        };
        let acting = Loads {
            now: &now,
            weight: around.scene.influence.weight,
            contact,
            directions,
            held: &finite.held,
            rotation: free.as_ref().map(|free| free.turned(ends[0] + 0.5 * (ends[1] - ends[0]))),
        };
        let (mut loads, mut middle) = (std::mem::take(&mut acted.loads), std::mem::take(&mut acted.places));
        let half = 0.5 * h;
        middle.clear();
        let velocities = match free {
            Some(free) => {
                middle.extend(free.positions.iter().zip(&free.velocities).map(|(s, u)| *s + *u * half));
                &free.velocities
            }
            None => {
                middle.extend(rest.iter().zip(x.iter()).zip(u.iter()).map(|((l, x), u)| *l + *x + *u * half));
                &*u
            }
        };
        loads.resize(middle.len(), DVec3::ZERO);
        acting.act(&middle, velocities, &mut loads, acted);
        (acted.loads, acted.places) = (loads, middle);
        self.now = now;
    }

    /// Takes a step of finite elements from `t` [s] with the forces evaluated before.
    fn step_implicit(&mut self, t: f64, h: f64) {
        let Body { matter, free, acted, rest, x, u, .. } = self;
        let Matter::Fem(finite) = matter else { return };
        let Some(Free { positions, velocities, rotation, fitted, .. }) = free else {
            let Finite { element, forces, .. } = &mut **finite;
            let masses = &element.masses;
            forces.clear();
            forces.extend(element.free.iter().map(|&node| acted.loads[node as usize] * masses[node as usize]));
            finite.step(x, u);
            return;
        };
        let Finite { element, stepper, motion, forces, .. } = &mut **finite;
        let masses = &element.masses;
        let is_at_rest = acted.loads.iter().chain(velocities.iter()).all(|v| *v == DVec3::ZERO) && positions == rest;
        if is_at_rest {
            return;
        }
        // L + h Σ m s×f, where the forces act
        let momentum = |positions: &[DVec3], velocities: &[DVec3]| -> DVec3 {
            positions.iter().zip(velocities).zip(masses).map(|((s, u), m)| s.cross(*u) * *m).sum()
        };
        let expected = momentum(positions, velocities) + momentum(&acted.places, &acted.loads) * h;
        let mut fit = DMat3::ZERO;
        for ((place, l), m) in acted.places.iter().zip(rest.iter()).zip(masses) {
            fit += outer(*place * *m, *l);
        }
        (*rotation, *fitted) = (best_rotation(fit, *rotation), t + 0.5 * h);
        let axes = DMat3::from_quat(*rotation);
        let back = axes.transpose();
        forces.clear();
        for (i, &node) in element.free.iter().enumerate() {
            let node = node as usize;
            motion.displacements[i] = back * positions[node] - rest[node];
            motion.velocities[i] = back * velocities[node];
            forces.push(back * acted.loads[node] * masses[node]);
        }
        stepper.step(element, motion, forces);
        for (i, &node) in element.free.iter().enumerate() {
            let node = node as usize;
            positions[node] = axes * (motion.displacements[i] + rest[node]);
            velocities[node] = axes * motion.velocities[i];
        }
        // remove the mean, which is only rounding errors
        let all: f64 = masses.iter().sum();
        for of in [&mut *positions, &mut *velocities] {
            let mean = of.iter().zip(masses).map(|(v, m)| *v * *m).sum::<DVec3>() / all;
            of.iter_mut().for_each(|v| *v -= mean);
        }
        let mut spread = DMat3::ZERO;
        for (s, m) in positions.iter().zip(masses) {
            spread += outer(*s * *m, *s);
        }
        let turn = solve(resistance(spread), expected - momentum(positions, velocities));
        if turn.is_finite() {
            positions.iter().zip(velocities.iter_mut()).for_each(|(s, u)| *u += turn.cross(*s));
        }
    }

    /// Updates the distance of the farthest node and the speed of the fastest.
    fn measure(&mut self) {
        let Some([positions, velocities]) = self.state() else { return };
        let largest = |of: &[DVec3]| of.iter().map(|v| v.length_squared()).fold(0.0, f64::max).sqrt();
        (self.extent, self.speed) = (largest(positions), largest(velocities));
    }

    /// Ends a step: tears, fits the rest shape, updates displacements.
    fn finish(&mut self, around: &StepContext<'_>) {
        let centre = match (&self.free, around.scene.bodies[self.index].path()) {
            (Some(free), _) => free.centre,
            (None, Some(path)) => path.position(around.end),
            (None, None) => DVec3::ZERO,
        };
        let before = self.statistics.torn;
        match &self.matter {
            Matter::Lattice(_) => self.tear(around, centre),
            Matter::Fem(_) => {}
        }
        if self.statistics.torn != before {
            self.recentre();
        }
        self.fit();
        if let Some(free) = &mut self.free {
            free.fitted = around.end;
        }
        if matches!(self.matter, Matter::Fem(_)) {
            self.strain(around, centre);
        }
        self.update_state(around);
    }

    /// Moves the centre of a lattice to the mass centre of its remaining nodes.
    fn recentre(&mut self) {
        let mass = self.free_mass();
        let Body { matter, free: Some(free), .. } = self else { return };
        let Matter::Lattice(springs) = matter else { return };
        let Springs { lattice, motion } = &mut **springs;
        let mean = |of: &[DVec3]| -> DVec3 {
            let left = of.iter().zip(&lattice.masses).zip(&lattice.held).filter(|(_, held)| !**held);
            left.map(|((v, m), _)| *v * *m).sum::<DVec3>() / mass
        };
        let [place, velocity] = [mean(&motion.positions), mean(&motion.velocities)];
        if mass > 0.0 {
            motion.positions.iter_mut().for_each(|s| *s -= place);
            motion.velocities.iter_mut().for_each(|u| *u -= velocity);
            free.centre += place;
            free.velocity += velocity;
            motion.accelerations.clear();
        }
    }

    /// Updates the rotation and spin of a free body, and its displacements from the rotated rest shape.
    fn fit(&mut self) {
        let Some([positions, velocities]) = self.state() else { return };
        let is_still = velocities.iter().all(|u| *u == DVec3::ZERO) && positions == self.rest;
        let masses = self.masses();
        let Some(Free { rotation, .. }) = self.free else { return };
        let (mut rotation, mut spin) = (rotation, DVec3::ZERO);
        if !is_still {
            let held = |node: usize| self.is_held(node);
            let nodes = || (0..positions.len()).filter(|&node| !held(node));
            let mut fit = DMat3::ZERO;
            nodes().for_each(|i| fit += outer(positions[i] * masses[i], self.rest[i]));
            rotation = best_rotation(fit, rotation);
            let axes = DMat3::from_quat(rotation);
            let [mut spread, mut turning] = [DMat3::ZERO; 2];
            for i in nodes() {
                let a = axes * self.rest[i] * masses[i];
                spread += outer(a, positions[i]);
                turning += outer(a, velocities[i]);
            }
            // G Ω_Q = Σ m a×s′
            spin = solve(resistance(spread), moment(turning));
            if !spin.is_finite() {
                spin = DVec3::ZERO;
            }
        }
        let axes = DMat3::from_quat(rotation);
        let placed = positions.iter().zip(&self.rest).map(|(s, l)| if is_still { DVec3::ZERO } else { *s - axes * *l });
        let x: Vec<DVec3> = placed.collect();
        let u: Vec<DVec3> = velocities.iter().zip(&self.rest).map(|(u, l)| *u - spin.cross(axes * *l)).collect();
        (self.x, self.u) = (x, u);
        if let Some(free) = &mut self.free {
            (free.rotation, free.spin) = (rotation, spin);
        }
    }

    /// Angular momentum of a free body about its centre [mass · scene unit²/s].
    pub fn angular_momentum(&self) -> DVec3 {
        let Some([positions, velocities]) = self.state() else { return DVec3::ZERO };
        let of = positions.iter().zip(velocities).zip(self.masses()).enumerate();
        of.filter(|(node, _)| !self.is_held(*node)).map(|(_, ((s, u), m))| s.cross(*u) * *m).sum()
    }
}

/// All planes if a body may reach one of them, otherwise none.
fn near(planes: &[Plane], centre: DVec3, extent: f64) -> &[Plane] {
    let is_near = planes.iter().any(|plane| plane.depth(centre) > -1.5 * extent);
    if is_near { planes } else { &[] }
}

/// Whether the bodies of a scene must be stepped together.
pub fn is_coupled(scene: &Scene) -> bool {
    scene.bodies.iter().any(|body| body.path().is_none())
}
