//! Velocity Verlet in steps of fixed length, for islands of which the adaptive steps would be too much work.
//!
//! The vertices are particles. The springs pull them to the best fit of the rest shape (shape matching, Müller et al.
//! 2005), which is found anew in every substep. A substep drifts for half its length, kicks, and drifts for the other
//! half, so that it needs one evaluation of the forces. Its length follows from the stiffest of springs, planes and
//! spheres, for which the scheme is stable; a very narrow rim of a core, over which the strength changes, is not counted.
//! Where there are few vertices, so that substeps cost little, they are shorter than that.
//! Damping and friction act by their own exact or implicit solution, which is stable for any rate.
//!
//! Springs and reactions balance as in the equation of motion, so momentum and angular momentum are conserved to
//! rounding whatever the error of the step. A phase changes in the substep in which its threshold is passed, at the
//! interpolated time.

use glam::{DMat3, DQuat, DVec3};
use pulp::Arch;
use rayon::prelude::*;

use super::{
    super::work::Tally,
    body::Body,
    field::Paths,
    island::{Change, Failure, Island, Report, Scratch},
    kernels::{Kernel, Lane, Lanes, at, by_coordinate, replace},
    step::Place,
    verlet_kernels::{Drift, Drifted, Kick, Kicked, Pull, Spring, Support, angular_momentum, largest_change},
};
use crate::{
    model::shape_matching::{best_rotation, outer, resistance, solve},
    parallel::over,
    sim::numerics::{
        control::{GROWTH, MAX_ANGLE},
        larger,
    },
};

/// Least number of substeps.
const MIN_SUBSTEPS: f64 = 2.0;
/// Number of substeps, beyond what stability requires, where those of all islands take less than [`CHEAP_WORK`].
const CHEAP_SUBSTEPS: f64 = 32.0;
/// Work that such substeps may take in a step [units]: a few milliseconds.
const CHEAP_WORK: u64 = 200_000;
/// Largest number of substeps: what needs more is too stiff or too fast for this scheme.
const MAX_SUBSTEPS: f64 = 1000.0;
/// With fewer vertices than this, a second thread does not pay off.
const PARALLEL_VERTICES: usize = 2048;

/// A body as particles.
#[derive(Clone, Debug, Default)]
pub struct Particles {
    /// Position r of each vertex relative to [`Particles::base`] [scene unit].
    r: Vec<Lanes>,
    /// Velocity of each vertex relative to the base [scene unit/s].
    v: Vec<Lanes>,
    /// Acceleration of each vertex, without gravity, reactions, friction and damping [scene unit/s²].
    a: Vec<Lanes>,
    /// That of the substep before.
    a_before: Vec<Lanes>,
    /// Position and velocity of the reference point: the centre of a body on a path, a fixed point for a free body.
    base: Place,
    /// Centre relative to the base [scene unit].
    centre: DVec3,
    /// Velocity of the centre relative to the base [scene unit/s].
    velocity: DVec3,
    rotation: DQuat,
    /// Inertia tensor about the centre.
    inertia: DMat3,
    /// Largest distance of a vertex from the centre [scene unit].
    extent: f64,
    /// Largest speed of a vertex relative to the base at the start [scene unit/s].
    fastest: f64,
    /// Acceleration that all vertices share [scene unit/s²].
    shared: DVec3,
    pulls: Vec<Pulled>,
    /// Estimated error of the step so far [scene unit].
    error: f64,
    /// Kinetic energy lost by damping and by friction.
    lost: [f64; 2],
    /// Work of pushes.
    pushed: f64,
}

/// What the sphere of a source does to a body in a substep.
#[derive(Clone, Copy, Debug)]
struct Pulled {
    /// Index of the pair.
    pair: u32,
    source: u32,
    /// Σ m f [mass · scene unit/s²].
    force: DVec3,
    /// Σ m f·v of velocities relative to the base.
    power: f64,
    /// Σ m (Φ − Φ(r_e)), with the factor for the sizes [mass · scene unit²].
    potential: f64,
}

/// A pair in a substep.
#[derive(Clone, Copy, Debug, Default)]
struct Bond {
    /// Centre distance over the sum of the radii [–].
    q: f64,
    strength: f64,
    /// Change of the strength by changes of phase in the substep [1/s²].
    jump: f64,
    /// The first of these changes in the report that is not gradual.
    change: Option<usize>,
}

/// Buffers of this scheme.
#[derive(Clone, Debug, Default)]
pub struct Buffers {
    all: Vec<Particles>,
    bonds: Vec<Bond>,
    /// Reactions on the spheres [mass · scene unit/s²].
    reactions: Vec<DVec3>,
}

impl Particles {
    fn begin(&mut self, body: &Body, place: Place) {
        let axes = DMat3::from_quat(body.rotation);
        let spin = body.frame_spin();
        let velocity = if body.is_free() { body.velocity } else { DVec3::ZERO };
        let of = |vectors: &[DVec3], i: usize| vectors.get(i).copied().unwrap_or_default();
        let rest = body.shape.rest.iter().enumerate();
        let r: Vec<DVec3> = rest.clone().map(|(i, &l)| axes * l + of(&body.x, i)).collect();
        let v: Vec<DVec3> = rest.map(|(i, &l)| velocity + spin.cross(axes * l) + of(&body.u, i)).collect();
        by_coordinate(&r, &mut self.r);
        by_coordinate(&v, &mut self.v);
        // discards the data of the body that used these buffers before
        for array in [&mut self.a, &mut self.a_before] {
            array.clear();
            array.resize(self.r.len(), Lanes::default());
        }
        self.pulls.clear();
        self.inertia = DMat3::ZERO;
        if body.turns() {
            let moments = r.iter().zip(&body.shape.masses).map(|(&r, &m)| (m * r, outer(m * r, r)));
            let (first, squares) =
                moments.fold((DVec3::ZERO, DMat3::ZERO), |(first, sum), (m, square)| (first + m, sum + square));
            self.inertia = resistance(squares - outer(first, first / body.shape.mass));
        }
        self.base = if body.is_free() { Place { centre: body.centre, velocity: DVec3::ZERO } } else { place };
        (self.centre, self.velocity, self.rotation) = (DVec3::ZERO, velocity, body.rotation);
        self.extent = body.shape.extent + body.x.iter().map(|x| x.length_squared()).fold(0.0, larger).sqrt();
        self.fastest = v.iter().map(|v| v.length_squared()).fold(0.0, larger).sqrt();
        (self.error, self.lost, self.pushed) = (0.0, [0.0; 2], 0.0);
    }

    /// Writes the particles to a body as its state. Returns the largest displacement and velocity.
    fn end(&self, body: &mut Body, place: Place) -> (f64, f64) {
        let (centre, velocity) = if body.is_free() { (self.centre, self.velocity) } else { Default::default() };
        (body.centre, body.velocity) = match body.is_free() {
            true => (self.base.centre + centre, velocity),
            false => (place.centre, place.velocity),
        };
        body.set_from(self.rotation, |i| (at(&self.r, i) - centre, at(&self.v, i) - velocity))
    }

    /// Drifts for `h` [s] after damping for `damped` [s], and fits the frame.
    fn drift(&mut self, arch: Arch, body: &Body, damped: f64, h: f64) {
        let is_free = body.is_free();
        let spin = self.spin(arch, body);
        let slowed = libm::exp(-2.0 * body.oscillator.damping * damped);
        let (velocity, centre) = if is_free { (self.velocity, self.centre) } else { Default::default() };
        let Drifted { first, fit, squares, relative, power, farthest } = Drift {
            r: &mut self.r,
            v: &mut self.v,
            a: &self.a,
            rest: &body.shape.lanes,
            masses: &body.shape.lanes_masses,
            centre,
            velocity,
            spin,
            slowed,
            h,
        }
        .find(arch);
        if is_free {
            // at the mean of the velocities before the kick and after damping, like the work of other forces
            self.lost[0] += 0.5 * (1.0 - slowed) * ((1.0 + slowed) * relative - damped * power);
            let mass = body.shape.mass;
            self.centre = first / mass;
            self.extent = farthest.sqrt() + (self.centre - centre).length();
            if body.turns() {
                self.rotation = best_rotation(fit, self.rotation);
                self.inertia = resistance(squares - outer(first, self.centre));
            }
        } else {
            self.extent = farthest.sqrt();
        }
    }

    /// Adds the error of a substep of `h` [s] in which an acceleration has changed by `change` [scene unit/s²].
    fn add_error(&mut self, body: &Body, change: f64, h: f64) {
        let swing = 1.0 / body.oscillator.omega.max(2.0 * body.oscillator.damping).max(1.0);
        self.error += change * h * (h + swing) / 12.0;
    }

    /// Angular velocity of the rigid motion [rad/s].
    fn spin(&self, arch: Arch, body: &Body) -> DVec3 {
        if !body.turns() {
            return DVec3::ZERO;
        }
        let momentum = angular_momentum(arch, &self.r, &self.v, &body.shape.lanes_masses, self.centre, self.velocity);
        solve(self.inertia, momentum)
    }
}

/// The common input of a substep.
struct Substep<'a> {
    island: &'a Island,
    pairs_of: &'a [Vec<u32>],
    bonds: &'a [Bond],
    centres: &'a [Place],
    arch: Arch,
    /// The instant in the middle of it [s].
    t: f64,
    h: f64,
    is_first: bool,
}

impl Substep<'_> {
    /// Evaluates the forces on a body.
    fn pull(&self, i: usize, own: &mut Particles) {
        let Substep { island, arch, .. } = *self;
        let (body, field) = (&island.bodies[i], &island.field);
        let masses: &[Lane] = &body.shape.lanes_masses;
        std::mem::swap(&mut own.a, &mut own.a_before);
        let axes = DMat3::from_quat(own.rotation);
        let centre = if body.is_free() { own.centre } else { DVec3::ZERO };
        let omega = body.oscillator.omega;
        let rest = &body.shape.lanes[..];
        Spring { r: &own.r, a: &mut own.a, rest, axes, centre, stiffness: omega * omega }.find(arch);
        for plane in &field.planes {
            if plane.depth(own.base.centre + own.centre) + own.extent > 0.0 {
                Support {
                    r: &own.r,
                    a: &mut own.a,
                    normal: plane.normal,
                    offset: plane.depth(own.base.centre),
                    stiffness: plane.stiffness,
                }
                .find(arch);
            }
        }
        self.each_push(i, axes, |vertex, force| {
            let a = at(&own.a, vertex);
            replace(&mut own.a, vertex, a + force);
        });
        self.add_push_work(i, own);
        own.pulls.clear();
        let here = own.base.centre;
        for &pair in &self.pairs_of[i] {
            let (bond, of) = (&self.bonds[pair as usize], &island.pairs[pair as usize]);
            if bond.strength == 0.0 && bond.jump == 0.0 {
                continue;
            }
            let source = if of.a as usize == i { of.b } else { of.a };
            let other = &island.bodies[source as usize];
            let radius = other.sphere_radius;
            let to = self.centres[source as usize].centre - here;
            if (to - centre).length() > radius + own.extent {
                continue;
            }
            let scale = field.scale(body.radius, other.radius);
            let weight = field.weight;
            let strength = scale * bond.strength;
            let (r, v, a) = (&own.r[..], &own.v[..], &mut own.a[..]);
            let pulled = Pull { r, v, a, masses, centre: to, radius, strength, weight }.find(arch);
            let potential = scale * pulled.potential;
            own.pulls.push(Pulled { pair, source, force: pulled.force, power: pulled.power, potential });
        }
        if !self.is_first {
            own.add_error(body, largest_change(arch, &own.a, &own.a_before).sqrt(), self.h);
        }
    }

    /// Calls `act` with every vertex of a body that is pushed and its acceleration [scene unit/s²].
    fn each_push(&self, i: usize, axes: DMat3, mut act: impl FnMut(usize, DVec3)) {
        let pushes = self.island.field.pushes.iter();
        for push in pushes.filter(|push| push.body == i && push.acts_at(self.t)) {
            for (vertex, &l) in self.island.bodies[i].shape.rest.iter().enumerate() {
                let facing = -(axes * l).normalize_or_zero().dot(push.direction);
                act(vertex, push.direction * (push.strength * f64::max(0.0, facing)));
            }
        }
    }

    /// Adds the work of pushes on a free body in half a kick.
    fn add_push_work(&self, i: usize, own: &mut Particles) {
        let body = &self.island.bodies[i];
        if body.is_free() {
            let mut power = 0.0;
            self.each_push(i, DMat3::from_quat(own.rotation), |vertex, force| {
                power += body.shape.masses[vertex] * force.dot(at(&own.v, vertex));
            });
            own.pushed += 0.5 * self.h * power;
        }
    }

    /// Kicks, and drifts for `drift` [s].
    fn move_on(&self, i: usize, own: &mut Particles, drift: f64) {
        let Substep { island, arch, .. } = *self;
        let body = &island.bodies[i];
        let field = &island.field;
        let near: smallvec::SmallVec<[_; 4]> = field
            .planes
            .iter()
            .filter(|plane| plane.friction != 0.0 && plane.depth(own.base.centre + own.centre) + own.extent > 0.0)
            .map(|plane| (*plane, plane.depth(own.base.centre)))
            .collect();
        let Kicked { momentum, rubbed } = Kick {
            r: &own.r,
            v: &mut own.v,
            a: &own.a,
            masses: &body.shape.lanes_masses,
            shared: own.shared,
            moving: own.base.velocity,
            planes: &near,
            h: self.h,
        }
        .find(arch);
        if body.is_free() {
            own.lost[1] += rubbed;
            own.velocity = momentum / body.shape.mass;
        }
        self.add_push_work(i, own);
        own.drift(arch, body, self.h, drift);
    }
}

impl Island {
    /// Like [`Island::advance_with`], by this scheme; in this step, `vertices` of all islands are advanced by it.
    pub(in crate::sim) fn advance_in_fixed_steps(
        &mut self,
        scratch: &mut Scratch,
        end: f64,
        vertices: u64,
        paths: &dyn Paths,
        work: &Tally<'_>,
        report: &mut Report,
    ) -> Result<(), Failure> {
        self.begin(scratch, end, paths);
        while self.time < end {
            let stop = self.enter(scratch, end, paths, report)?;
            self.coast(scratch, stop, vertices, paths, work, report)?;
        }
        self.step_lengths.fill(self.step_length);
        self.finish(scratch, paths, report)
    }

    /// Number of substeps to `end` [s], and the body that is the stiffest.
    fn count_substeps(&self, scratch: &Scratch, end: f64) -> (f64, usize) {
        let span = end - self.time;
        let mut stiffest = (0.0, 0);
        let (mut fastest, mut smallest) = (0.0, f64::INFINITY);
        for (i, body) in self.bodies.iter().enumerate().take(scratch.pairs_of.len()) {
            let all = &scratch.verlet.all[i];
            let speed = body.velocity.length();
            let reach = all.extent + 1.5 * span * speed + self.field.free_fall().length() * span * span;
            let mut stiffness = body.oscillator.omega * body.oscillator.omega;
            let planes = self.field.planes.iter().filter(|plane| plane.depth(body.centre) + reach > 0.0);
            stiffness += planes.map(|plane| plane.stiffness).sum::<f64>();
            for &pair in &scratch.pairs_of[i] {
                let pair = &self.pairs[pair as usize];
                let other = &self.bodies[if pair.a as usize == i { pair.b } else { pair.a } as usize];
                let strength = f64::max(pair.law.alpha.abs(), pair.law.beta.abs());
                stiffness += strength * self.field.scale(body.radius, other.radius);
                if body.is_free() && other.mass() > 0.0 {
                    // the reaction on its sphere, by the share of the other body's vertices in it
                    let across = body.sphere_radius / other.radius;
                    let share = f64::min(1.0, across * across);
                    let scale = self.field.scale(other.radius, body.radius);
                    stiffness += strength * scale * share * other.mass() / body.mass();
                }
            }
            if !(stiffness <= stiffest.0) {
                stiffest = (stiffness, i);
            }
            fastest = larger(fastest, all.fastest + all.base.velocity.length());
            smallest = f64::min(smallest, body.radius);
        }
        let by_angle = span * f64::sqrt(stiffest.0) / MAX_ANGLE;
        let by_way = span * fastest / (MAX_ANGLE * smallest);
        (larger(MIN_SUBSTEPS, larger(by_angle, by_way).ceil()), stiffest.1)
    }

    /// Advances to `end` [s], before which nothing jumps; `of_all` vertices take such steps.
    fn coast(
        &mut self,
        scratch: &mut Scratch,
        end: f64,
        of_all: u64,
        paths: &dyn Paths,
        work: &Tally<'_>,
        report: &mut Report,
    ) -> Result<(), Failure> {
        let (start, arch) = (self.time, scratch.arch);
        let stepped = scratch.courses.len();
        let vertices: usize = self.bodies[..stepped].iter().map(|body| body.shape.rest.len()).sum();
        let is_parallel = vertices >= PARALLEL_VERTICES;
        scratch.verlet.all.resize_with(stepped, Particles::default);
        let first: Vec<Place> = (0..self.bodies.len()).map(|i| self.place(i, start, false, paths)).collect();
        over(is_parallel, &mut scratch.verlet.all, |i, own| own.begin(&self.bodies[i], first[i]));
        let (count, stiffest) = self.count_substeps(scratch, end);
        let substep_work = (3 * vertices + 16 * stepped) as u64;
        let cheap = f64::min(CHEAP_SUBSTEPS, (CHEAP_WORK / (3 * of_all).max(substep_work).max(1)) as f64);
        let count = larger(count, cheap);
        let h = (end - start) / count;
        if !(count <= MAX_SUBSTEPS) {
            return Err(Failure::Unresolved { body: stiffest, time: start, step: h });
        }
        let Scratch { verlet: Buffers { all, bonds, reactions }, pairs_of, .. } = scratch;
        bonds.clear();
        bonds.extend(self.pairs.iter().map(|pair| Bond {
            q: first[pair.a as usize].centre.distance(first[pair.b as usize].centre)
                / (self.bodies[pair.a as usize].radius + self.bodies[pair.b as usize].radius),
            ..Bond::default()
        }));
        let mut centres = first;
        // the first half of the first drift; damping acts within kicks
        over(is_parallel, all, |i, own| own.drift(arch, &self.bodies[i], 0.0, 0.5 * h));
        let (mut k, mut t_before) = (0.0, start);
        while k < count {
            let t = start + (k + 0.5) * h;
            let contacts: u64 = all.iter().zip(&self.bodies).map(|(own, b)| (own.pulls.len() * b.x.len()) as u64).sum();
            let pushes = self.field.pushes.iter().filter(|push| push.acts_at(t));
            let pushes: u64 = pushes.map(|push| 3 * self.bodies[push.body].x.len() as u64).sum();
            let pushes = pushes + self.field.pushes.len() as u64;
            if !work.spend(substep_work + contacts + pushes + self.pairs.len() as u64) {
                return Err(self.stopped());
            }
            for (i, body) in self.bodies.iter().enumerate() {
                let at = if body.is_free() {
                    Place { centre: all[i].base.centre + all[i].centre, velocity: all[i].velocity }
                } else {
                    self.place(i, t, false, paths)
                };
                centres[i] = at;
                if let Some(own) = all.get_mut(i)
                    && !body.is_free()
                {
                    own.base = at;
                }
                let way = &mut self.ways[i];
                way.centre = larger(way.centre, at.centre.distance(way.from));
                if let Some(own) = all.get(i) {
                    way.extent = larger(way.extent, own.extent);
                }
            }
            self.change_phases(bonds, &centres, [t_before, t], report);
            let substep = Substep { island: self, pairs_of, bonds, centres: &centres, arch, t, h, is_first: k == 0.0 };
            over(is_parallel, all, |i, own| substep.pull(i, own));
            reactions.clear();
            reactions.resize(self.bodies.len(), DVec3::ZERO);
            for pulled in all.iter().flat_map(|own| &own.pulls) {
                reactions[pulled.source as usize] -= pulled.force;
                let bond = &bonds[pulled.pair as usize];
                if let Some(change) = bond.change {
                    let energy = bond.jump * pulled.potential;
                    report.ledger.events += energy;
                    report.changes[change].energy += energy;
                }
            }
            self.add_work(all, &centres, 0.5 * h, t, report);
            for (i, own) in all.iter_mut().enumerate() {
                let body = &self.bodies[i];
                let shared = if body.is_free() {
                    let given = self.field.given(i, t, centres[i].centre, centres[i].velocity);
                    self.field.free_fall() + given + reactions[i] / body.mass()
                } else {
                    paths.at(i, t, false).uniform
                };
                if k > 0.0 {
                    own.add_error(body, shared.distance(own.shared), h);
                }
                own.shared = shared;
            }
            k += 1.0;
            let drift = if k < count { h } else { 0.5 * h };
            let substep = Substep { island: self, pairs_of, bonds, centres: &centres, arch, t, h, is_first: false };
            over(is_parallel, all, |i, own| substep.move_on(i, own, drift));
            // powers are those in the middle of the kick
            for (own, (body, place)) in all.iter().zip(self.bodies.iter().zip(&mut centres)) {
                if body.is_free() {
                    place.velocity = own.velocity;
                }
            }
            self.add_work(all, &centres, 0.5 * h, t, report);
            t_before = t;
        }
        let mut worst = (0.0, 0);
        for (i, (own, body)) in all.iter().zip(&self.bodies).enumerate() {
            if body.is_free() {
                report.ledger.damping -= own.lost[0];
                report.ledger.friction -= own.lost[1];
                report.ledger.pushes += own.pushed;
            }
            // the first substep has no predecessor
            let error = own.error * count / (count - 1.0) / body.radius;
            if !(error <= worst.0) {
                worst = (error, i);
            }
        }
        let (error, body) = worst;
        if !error.is_finite() {
            return Err(Failure::Unresolved { body, time: start, step: h });
        }
        let last: Vec<Place> = (0..self.bodies.len()).map(|i| self.place(i, end, true, paths)).collect();
        let finish = |((body, way), (i, own)): ((&mut Body, &mut super::Way), (usize, &Particles))| {
            (way.displacement, way.speed) = own.end(body, last[i]);
            way.centre = larger(way.centre, body.centre.distance(way.from));
            way.extent = larger(way.extent, own.extent);
        };
        let (own_bodies, others) = self.bodies.split_at_mut(stepped);
        if is_parallel {
            let bodies = own_bodies.par_iter_mut().zip(self.ways.par_iter_mut());
            bodies.zip(all.par_iter().enumerate()).for_each(finish);
        } else {
            own_bodies.iter_mut().zip(&mut self.ways).zip(all.iter().enumerate()).for_each(finish);
        }
        for (body, place) in others.iter_mut().zip(&last[stepped..]) {
            (body.centre, body.velocity) = (place.centre, place.velocity);
        }
        self.time = end;
        self.step_length = h;
        report.steps += count as u64;
        report.body_steps += count as u64 * stepped as u64;
        report.error += GROWTH * error;
        if report.shortest.is_none_or(|(shortest, _)| h < shortest) {
            report.shortest = Some((h, body as u32));
        }
        Ok(())
    }

    /// Adds the work of half a kick, `h` [s] at `t` [s], at which the centres have these velocities: of changing strengths, of
    /// spheres on paths and force points, and of forces set by a program.
    fn add_work(&self, all: &[Particles], centres: &[Place], h: f64, t: f64, report: &mut Report) {
        for (i, own) in all.iter().enumerate() {
            let (body, place) = (&self.bodies[i], centres[i]);
            if body.is_free() && !self.field.forces.is_empty() {
                let given = self.field.given(i, t, place.centre, place.velocity);
                report.ledger.pushes += h * body.mass() * given.dot(place.velocity);
            }
            for pulled in &own.pulls {
                let (source, to) = (&self.bodies[pulled.source as usize], centres[pulled.source as usize]);
                let pair = &self.pairs[pulled.pair as usize];
                if source.is_free() != body.is_free() {
                    let (path, power) = match body.is_free() {
                        true => (pulled.source, pulled.force.dot(to.velocity)),
                        false => (i as u32, -(pulled.power + pulled.force.dot(place.velocity))),
                    };
                    *report.ledger.of_source(path, &self.field) += h * power;
                }
                if let Some(rim) = pair.law.rim(pair.phase).filter(|_| source.is_free() || body.is_free()) {
                    let radii = body.radius + source.radius;
                    let apart = to.centre - place.centre;
                    let rate = apart.normalize_or_zero().dot(to.velocity - place.velocity) / radii;
                    report.ledger.core += h * rim.slope(apart.length() / radii) * rate * pulled.potential;
                }
            }
        }
    }

    /// Changes the phases of pairs that passed a threshold between two instants [s], and sets the strengths.
    fn change_phases(&mut self, bonds: &mut [Bond], centres: &[Place], [before, t]: [f64; 2], report: &mut Report) {
        for (index, (bond, pair)) in bonds.iter_mut().zip(&mut self.pairs).enumerate() {
            let (a, b) = (centres[pair.a as usize], centres[pair.b as usize]);
            let radii = self.bodies[pair.a as usize].radius + self.bodies[pair.b as usize].radius;
            let (apart, velocity) = (a.centre - b.centre, a.velocity - b.velocity);
            let q = apart.length() / radii;
            let rate = apart.normalize_or_zero().dot(velocity) / radii;
            let old = bond.q;
            *bond = Bond { q, ..Bond::default() };
            for _ in 0..2 {
                let passed = pair.transitions().find(|way| way.is_passed(q));
                let Some(way) = passed else { break };
                let share = ((way.level - old) / (q - old)).clamp(0.0, 1.0);
                let time = before + if share.is_finite() { share * (t - before) } else { 0.0 };
                if !pair.law.is_gradual(pair.phase, way.to) {
                    bond.jump += pair.law.strength(way.to, q) - pair.law.strength(pair.phase, q);
                    bond.change.get_or_insert(report.changes.len());
                }
                let from = pair.phase;
                report.changes.push(Change { time, pair: index, q: way.level, rate, from, to: way.to, energy: 0.0 });
                pair.phase = way.to;
            }
            // the kick is half before the change and half after it
            bond.strength = pair.law.strength(pair.phase, q) - 0.5 * bond.jump;
        }
    }
}
