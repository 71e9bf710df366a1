//! The explicit schemes in coupled scenes, in their usual form: vertices as particles, steps of the scene's length,
//! phase changes at the ends of steps.
//!
//! The rest shape to which the springs pull is recomputed for each evaluation (shape matching, Müller et al. 2005). The
//! schemes are those of [`integrator::explicit`](crate::sim::integrator::explicit), for all vertices together because
//! they act on each other here.

use glam::{DMat3, DQuat, DVec3};
use rayon::prelude::*;

use super::{
    member::{Member, driven, kick},
    near::Near,
};
pub(super) use crate::sim::integrator::explicit::Scheme;
use crate::sim::integrator::explicit::{Instant, Part, System};
use crate::{
    model::{
        influence,
        shape_matching::{best_rotation, outer, resistance, solve},
    },
    scene::{Path, Scene},
    sim::{
        events::Event,
        free::{self, Body, Driven, Place},
        report::StepReport,
        span::Span,
        terms::{free_fall, push},
    },
};

/// A displacement beyond this counts as diverged [radii].
const MAX_DISPLACEMENT: f64 = 1e6;

/// Positions and velocities of the vertices of a body: in world coordinates for a free body, relative to the centre for
/// a body on a path.
#[derive(Clone, Debug, Default)]
struct Particles {
    r: Vec<DVec3>,
    v: Vec<DVec3>,
}

/// Accelerations of the vertices of a body.
struct Forces {
    /// F, by spheres, planes, pushes, gravity, and the reactions to the body's sphere.
    outer: Vec<DVec3>,
    /// T, by springs and damping.
    inner: Vec<DVec3>,
    /// Reactions on the spheres of other bodies, by body.
    reactions: Vec<(u32, DVec3)>,
}

/// A body's frame and its motion.
#[derive(Clone, Copy)]
struct Frame {
    centre: DVec3,
    velocity: DVec3,
    rotation: DQuat,
    spin: DVec3,
    /// The acceleration that all vertices of a body on a path share [scene unit/s²].
    uniform: DVec3,
}

impl Frame {
    fn of(scene: &Scene, index: usize, body: &Body, particles: &Particles, t: f64) -> Frame {
        if !body.is_free() {
            let Driven { place: Place { centre, velocity }, uniform } = driven(scene, index as u32, t, false);
            return Frame { centre, velocity, rotation: DQuat::IDENTITY, spin: DVec3::ZERO, uniform };
        }
        let (masses, rest) = (body.shape.masses(), body.shape.rest());
        let mean = |v: &[DVec3]| v.iter().zip(masses).map(|(&v, &m)| m * v).sum::<DVec3>() / body.mass();
        let (centre, velocity) = (mean(&particles.r), mean(&particles.v));
        let (mut rotation, mut spin) = (body.rotation, DVec3::ZERO);
        if body.turns() {
            let (mut fit, mut spread, mut momentum) = (DMat3::ZERO, DMat3::ZERO, DVec3::ZERO);
            for (((&r, &v), &m), &l) in particles.r.iter().zip(&particles.v).zip(masses).zip(rest) {
                let s = r - centre;
                fit += outer(m * s, l);
                spread += outer(m * s, s);
                momentum += m * s.cross(v - velocity);
            }
            rotation = best_rotation(fit, body.rotation);
            spin = solve(resistance(spread), momentum);
        }
        Frame { centre, velocity, rotation, spin, uniform: DVec3::ZERO }
    }
}

/// The common input of all force evaluations of a step.
struct ExplicitStep<'a> {
    scene: &'a Scene,
    members: &'a [Member],
    near: &'a Near,
    span: Span,
}

impl ExplicitStep<'_> {
    fn frames(&self, all: &[Particles], t: f64) -> Vec<Frame> {
        let of = |(index, particles): (usize, &Particles)| {
            Frame::of(self.scene, index, &self.members[index].body, particles, t)
        };
        all.par_iter().enumerate().map(of).collect()
    }

    /// The forces at an instant, including damping if `is_damped`.
    fn forces(&self, all: &[Particles], t: f64, is_damped: bool) -> Vec<Forces> {
        let frames = self.frames(all, t);
        let indexed = all.par_iter().enumerate();
        let mut forces: Vec<Forces> =
            indexed.map(|(index, particles)| self.forces_on(index, particles, &frames, t, is_damped)).collect();
        let mut reactions = vec![DVec3::ZERO; all.len()];
        for &(source, force) in forces.iter().flat_map(|forces| &forces.reactions) {
            reactions[source as usize] += force;
        }
        for (index, ((forces, member), reaction)) in forces.iter_mut().zip(self.members).zip(reactions).enumerate() {
            if member.body.is_free() {
                let Frame { centre, velocity, .. } = frames[index];
                let given = self.scene.bodies[index].force.as_ref();
                let given = given.map_or(DVec3::ZERO, |force| force.acceleration(t, centre, velocity));
                let shared = free_fall(self.scene) + given + reaction / member.body.mass();
                forces.outer.iter_mut().for_each(|force| *force += shared);
            }
        }
        forces
    }

    fn forces_on(&self, index: usize, particles: &Particles, frames: &[Frame], t: f64, is_damped: bool) -> Forces {
        let ExplicitStep { scene, members, near, span } = *self;
        let (member, frame) = (&members[index], &frames[index]);
        let (body, is_free) = (&member.body, member.body.is_free());
        let axes = DMat3::from_quat(frame.rotation);
        let mut sources: Vec<(u32, f64, f64, DVec3)> = member
            .neighbours
            .iter()
            .filter_map(|neighbour| {
                let (pair, source) = (near.get(neighbour.pair), &members[neighbour.other as usize].body);
                let apart = frames[neighbour.other as usize].centre - frame.centre;
                let q = apart.length() / (body.radius + source.radius);
                let scale = scene.influence.scaling.factor(body.radius, source.radius);
                let strength = scale * pair.law.strength(pair.phase, q);
                let radius = source.sphere_radius;
                (strength != 0.0).then_some((neighbour.other, strength, radius, apart))
            })
            .collect();
        let bodies = sources.len();
        let windows_at = span.inside(t);
        let points = scene.points_on(index).filter(|(_, point)| point.acts_at(windows_at)).map(|(source, point)| {
            let (radius, apart) = (scene.influence.sphere_radius(point.radius), point.path.position(t) - frame.centre);
            (source, scene.point_strength(point, index), radius, apart)
        });
        sources.extend(points);
        let mut reactions: Vec<(u32, DVec3)> = sources.iter().map(|source| (source.0, DVec3::ZERO)).collect();
        let (mut outer, mut inner) = (Vec::with_capacity(particles.r.len()), Vec::with_capacity(particles.r.len()));
        let (omega, damping) = (body.oscillator.omega, if is_damped { body.oscillator.damping } else { 0.0 });
        for (i, (&r, &v)) in particles.r.iter().zip(&particles.v).enumerate() {
            let (s, rate) = if is_free { (r - frame.centre, v - frame.velocity) } else { (r, v) };
            let a = axes * body.shape.rest()[i];
            let mut force = frame.uniform;
            for ((_, strength, radius, apart), reaction) in sources.iter().zip(&mut reactions) {
                let pull = influence::acceleration(scene.influence.weight, *strength, *radius, *apart - s);
                force += pull;
                reaction.1 -= body.shape.masses()[i] * pull;
            }
            for plane in &scene.planes {
                let depth = plane.depth(frame.centre + s);
                if depth > 0.0 {
                    force += plane.acceleration(depth, frame.velocity + rate);
                }
            }
            for push in push::acting(&member.pushes, windows_at) {
                force += push.acceleration(a.normalize_or_zero());
            }
            outer.push(force);
            inner.push(-(omega * omega) * (s - a) - 2.0 * damping * (rate - frame.spin.cross(s)));
        }
        reactions.truncate(bodies); // nothing acts on a force point
        Forces { outer, inner, reactions }
    }
}

impl System for ExplicitStep<'_> {
    type State = Vec<Particles>;
    type Forces = Vec<Vec<DVec3>>;

    fn forces(&self, at: Instant, all: &Vec<Particles>, part: Part) -> Vec<Vec<DVec3>> {
        let Span { start, end } = self.span;
        let t = match at {
            Instant::Start => start,
            Instant::Middle => start + 0.5 * (end - start),
            Instant::End => end,
        };
        let of_part = |Forces { mut outer, inner, .. }| match part {
            Part::Outer => outer,
            Part::Inner => inner,
            Part::All | Part::Undamped => {
                add(&mut outer, 1.0, &inner);
                outer
            }
        };
        self.forces(all, t, part != Part::Undamped).into_iter().map(of_part).collect()
    }

    fn kick(&self, all: &mut Vec<Particles>, forces: &Vec<Vec<DVec3>>, dt: f64) {
        all.iter_mut().zip(forces).for_each(|(body, forces)| add(&mut body.v, dt, forces));
    }

    fn drift(&self, all: &mut Vec<Particles>, velocities: &Vec<Particles>, dt: f64) {
        all.iter_mut().zip(velocities).for_each(|(body, of)| add(&mut body.r, dt, &of.v));
    }

    fn move_on(&self, all: &mut Vec<Particles>, dt: f64) {
        all.iter_mut().for_each(|Particles { r, v }| add(r, dt, v));
    }

    /// Damping acts only on the motion relative to the rigid motion.
    fn damp(&self, all: &mut Vec<Particles>, dt: f64) {
        let frames = self.frames(all, self.span.end);
        for ((particles, frame), member) in all.iter_mut().zip(frames).zip(self.members) {
            let slowed = 1.0 / (1.0 + member.body.oscillator.damping * dt);
            for (&r, v) in particles.r.iter().zip(&mut particles.v) {
                let rigid = match member.body.is_free() {
                    true => frame.velocity + frame.spin.cross(r - frame.centre),
                    false => DVec3::ZERO,
                };
                *v = rigid + slowed * (*v - rigid);
            }
        }
    }
}

fn add(to: &mut [DVec3], factor: f64, what: &[DVec3]) {
    to.iter_mut().zip(what).for_each(|(to, &what)| *to += factor * what);
}

impl Particles {
    fn of(body: &Body) -> Particles {
        let axes = DMat3::from_quat(body.rotation);
        let (from, velocity) = if body.is_free() { (body.centre, body.velocity) } else { Default::default() };
        let spin = body.frame_spin();
        let of = |vectors: &[DVec3], i: usize| vectors.get(i).copied().unwrap_or_default();
        let rest = body.shape.rest().iter().enumerate();
        let (r, v) = rest
            .map(|(i, &l)| {
                let a = axes * l;
                (from + (a + of(&body.x, i)), velocity + (spin.cross(a) + of(&body.u, i)))
            })
            .unzip();
        Particles { r, v }
    }

    /// Writes the particles to a body as its state. Returns the largest displacement and velocity.
    fn end(&self, frame: &Frame, body: &mut Body) -> (f64, f64) {
        (body.centre, body.velocity) = (frame.centre, frame.velocity);
        let (centre, velocity) = if body.is_free() { (frame.centre, frame.velocity) } else { Default::default() };
        body.set_from(frame.rotation, |i| (self.r[i] - centre, self.v[i] - velocity))
    }
}

/// Takes one step. Returns the first body whose state is invalid afterwards.
pub(super) fn step(
    scheme: Scheme,
    scene: &Scene,
    members: &mut [Member],
    near: &mut Near,
    span: Span,
    report: &mut StepReport,
) -> Option<usize> {
    let particles = |(index, member): (usize, &Member)| {
        let mut particles = Particles::of(&member.body);
        // fixed steps do not resolve events within a step: velocity jumps of a path act at its start
        let knots = scene.bodies[index].path().map_or(&[][..], Path::knots);
        let knots = span.among(knots).iter().filter(|&&t| t < span.end);
        let kick: DVec3 = knots.map(|&t| kick(scene, index as u32, t)).sum();
        if kick != DVec3::ZERO {
            particles.v.iter_mut().for_each(|v| *v += kick);
        }
        particles
    };
    let before: Vec<Particles> = members.par_iter().enumerate().map(particles).collect();
    let step = ExplicitStep { scene, members: &*members, near: &*near, span };
    let after = scheme.advance(&step, &before, span.length());
    let frames = step.frames(&after, span.end);
    let mut diverged = None;
    for (i, ((member, particles), frame)) in members.iter_mut().zip(&after).zip(&frames).enumerate() {
        let (x, u) = particles.end(frame, &mut member.body);
        (member.extent, member.speed) = (member.body.shape.extent() + x, u);
        if !(x < MAX_DISPLACEMENT * member.body.radius && u.is_finite()) && diverged.is_none() {
            diverged = Some(i);
        }
    }
    report.substeps = members.len() as u64;
    enter_phases(members, near, span.end, report);
    diverged
}

/// Changes the phases of pairs that have passed a threshold, at the end of the step.
fn enter_phases(members: &[Member], near: &mut Near, time: f64, report: &mut StepReport) {
    for (i, member) in (0..).zip(members) {
        for neighbour in member.neighbours.iter().filter(|neighbour| neighbour.other > i) {
            let (a, b) = (&member.body, &members[neighbour.other as usize].body);
            let (q, rate) = a.q_and_rate(b);
            for _ in 0..2 {
                let pair = *near.get(neighbour.pair);
                let passed = pair.law.thresholds.transitions(pair.phase).find(|way| way.is_passed(q));
                let Some(way) = passed else { break };
                let free::Pair { a, b, phase: from, .. } = pair;
                let event = Event { time, step: report.step, a, b, q, rate, from, to: way.to, energy: 0.0 };
                report.events.push(event);
                near.enter(neighbour.pair, way.to);
            }
        }
    }
}
