//! Energy ledger of free bodies: the work done by each cause.
//!
//! The solution of a step gives the powers at its nodes. They are integrated like the forces: by Lobatto quadrature,
//! and from the instant of the kink if a force begins or ends within the step. The energy of
//! [`Conserved`](super::Conserved) minus [`Ledger::total`] is therefore constant to within the error of the steps.

use std::ops::AddAssign;

use glam::DVec3;
use pulp::Arch;

use super::{
    body::Body,
    field::{Field, Pair},
    kernels::{Kernel, Potential, Slipping},
    split::{By, Touch},
    step::{Course, Place},
};
use crate::{
    model::shape_matching::{Plane, cross_matrix},
    sim::numerics::nodes::NODES,
};

/// Energy added to free bodies by each cause; negative if removed [mass · scene unit²/s²].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ledger {
    /// Phase changes at which the strength of a pair jumps: Σ m Δs (Φ − Φ(r_e)).
    pub events: f64,
    /// Gradual changes of a pair's strength at the rim of its core: ∫ Σ m (ds/dt) (Φ − Φ(r_e)) dt.
    pub core: f64,
    /// Damping of vertices, −∫ 2κ Σ m |s′ − Ω×s|² dt.
    pub damping: f64,
    /// Friction on planes, ∫ Σ m f·r′ dt.
    pub friction: f64,
    /// Pushes, and forces set by a program, ∫ Σ m f·r′ dt.
    pub pushes: f64,
    /// Bodies on prescribed paths: work of the motion of their spheres, and of their vertices on spheres of free
    /// bodies.
    pub prescribed: f64,
    /// Force points: work of the motion of their spheres, and Σ m Δs (Φ − Φ(r_e)) where they begin or cease to act.
    pub points: f64,
    /// Kinetic energy removed from bodies when they come to rest.
    pub rest: f64,
    /// Edits of the scene, and changes of a world by a program.
    pub edits: f64,
}

impl Ledger {
    /// The entry for the motion of a body on a path, or of a force point.
    pub(super) fn of_source(&mut self, source: u32, field: &Field) -> &mut f64 {
        if source < field.first_point { &mut self.prescribed } else { &mut self.points }
    }

    /// Energy added by all causes together [mass · scene unit²/s²].
    pub fn total(&self) -> f64 {
        let Ledger { events, core, damping, friction, pushes, prescribed, points, rest, edits } = *self;
        events + core + damping + friction + pushes + prescribed + points + rest + edits
    }
}

impl AddAssign for Ledger {
    fn add_assign(&mut self, other: Ledger) {
        let Ledger { events, core, damping, friction, pushes, prescribed, points, rest, edits } = other;
        self.events += events;
        self.core += core;
        self.damping += damping;
        self.friction += friction;
        self.pushes += pushes;
        self.prescribed += prescribed;
        self.points += points;
        self.rest += rest;
        self.edits += edits;
    }
}

/// The bodies of an island and the step just completed.
#[derive(Clone, Copy)]
pub(super) struct Done<'a> {
    pub bodies: &'a [Body],
    pub pairs: &'a [Pair],
    pub field: &'a Field,
    pub courses: &'a [Course],
    pub places: &'a [[Place; 5]],
    /// Start and length of the step [s].
    pub start: f64,
    pub h: f64,
    pub arch: Arch,
}

impl Done<'_> {
    /// The ledger of the step.
    pub fn ledger(self) -> Ledger {
        let mut ledger = Ledger::default();
        for (i, body) in self.bodies.iter().enumerate().take(self.courses.len()) {
            if body.is_free() {
                ledger.damping += self.damping(i);
                ledger.friction += self.friction(i);
                ledger.pushes += self.pushes(i) + self.given(i);
            }
            ledger.prescribed += self.prescribed(i, |source| source < self.field.first_point);
            ledger.points += self.prescribed(i, |source| source >= self.field.first_point);
        }
        ledger.core = self.pairs.iter().map(|pair| self.core(pair)).sum();
        ledger
    }

    /// ∫ P dt over the step, for a power without kinks.
    fn over(self, power: [f64; 4]) -> f64 {
        self.h / 12.0 * ((power[0] + power[3]) + 5.0 * (power[1] + power[2]))
    }

    /// Σ ∫ m P dt over the contacts of vertices that are advanced alone; `power` is P at the nodes of a leg.
    fn over_touches(self, index: usize, power: impl Fn(&Touch) -> Option<[f64; 4]>) -> f64 {
        let course = &self.courses[index];
        let mut work = 0.0;
        for split in &course.splits {
            let mass = course.active.mass(split.vertex as usize);
            for leg in split.legs() {
                for power in leg.touches.iter().filter_map(&power) {
                    work += mass * (leg.to - leg.from) * self.over(power);
                }
            }
        }
        work
    }

    /// Velocity r′ of an active vertex at a node [scene unit/s].
    fn velocity(self, body: usize, node: usize, vertex: usize) -> DVec3 {
        let (frame, active) = (&self.courses[body].frames[node], &self.courses[body].active);
        let a = frame.axes * active.rest(vertex);
        self.places[body][node].velocity + (frame.frame_spin.cross(a) + active.u(node, vertex))
    }

    fn damping(self, index: usize) -> f64 {
        let (body, course) = (&self.bodies[index], &self.courses[index]);
        let rate = 2.0 * body.oscillator.damping;
        if rate == 0.0 {
            return 0.0;
        }
        self.over(std::array::from_fn(|node| {
            let (frame, active) = (&course.frames[node], &course.active);
            // s′ − Ω×s = u − Ω×x + (Ω_Q − Ω)×a
            let slip = cross_matrix(frame.frame_spin - frame.spin) * frame.axes;
            let [x, mut others] = course.others[node];
            others.add_times(-1.0, &x.crossed(frame.spin));
            others.by_rest += slip;
            let slipping = Slipping { active, node, spin: frame.spin, slip }.find(self.arch);
            -rate * (course.moments.square(&others) + slipping)
        }))
    }

    fn friction(self, index: usize) -> f64 {
        let (active, planes) = (&self.courses[index].active, &self.field.planes);
        let along = |plane: &Plane, g: DVec3| g - plane.normal.dot(g) * plane.normal;
        let rough = self.courses[index].held.iter().filter(|held| planes[held.contact as usize].friction != 0.0);
        let work = rough.map(|held| {
            let (plane, vertex) = (&planes[held.contact as usize], held.vertex as usize);
            let power = |node: usize| along(plane, held.g[node]).dot(self.velocity(index, node, vertex));
            active.mass(vertex) * self.over(std::array::from_fn(power))
        });
        let split = self.over_touches(index, |touch| match touch.by {
            By::Plane(plane) => {
                let plane = &planes[plane as usize];
                Some(std::array::from_fn(|node| along(plane, touch.g[node]).dot(touch.velocity[node])))
            }
            _ => None,
        });
        work.sum::<f64>() + split
    }

    fn pushes(self, index: usize) -> f64 {
        let active = &self.courses[index].active;
        let work = self.courses[index].pushed.iter().map(|held| {
            let vertex = held.vertex as usize;
            let power = |node: usize| held.g[node].dot(self.velocity(index, node, vertex));
            active.mass(vertex) * self.over(std::array::from_fn(power))
        });
        let split = self.over_touches(index, |touch| {
            matches!(touch.by, By::Push(_)).then(|| std::array::from_fn(|node| touch.g[node].dot(touch.velocity[node])))
        });
        work.sum::<f64>() + split
    }

    /// Work of forces set by a program.
    fn given(self, index: usize) -> f64 {
        if self.field.forces.is_empty() {
            return 0.0;
        }
        self.over(std::array::from_fn(|node| {
            let Place { centre, velocity } = self.places[index][node];
            let given = self.field.given(index, self.start + NODES[node] * self.h, centre, velocity);
            self.bodies[index].mass() * given.dot(velocity)
        }))
    }

    /// Work in pairs of a free body and one on a path, by the forces on the vertices of body `index`, of those sources that
    /// are `selected`.
    fn prescribed(self, index: usize, selected: impl Fn(u32) -> bool) -> f64 {
        let (body, course) = (&self.bodies[index], &self.courses[index]);
        let counts = |source: u32| selected(source) && self.bodies[source as usize].is_free() != body.is_free();
        let mut work = 0.0;
        for reaction in course.reactions.iter().filter(|reaction| counts(reaction.source)) {
            work += self.over(std::array::from_fn(|node| {
                if body.is_free() {
                    -reaction.force[node].dot(self.places[reaction.source as usize][node].velocity)
                } else {
                    reaction.power[node]
                }
            }));
        }
        work + self.over_touches(index, |touch| match touch.by {
            By::Sphere(source) if counts(source) => Some(std::array::from_fn(|node| match body.is_free() {
                true => touch.g[node].dot(touch.source[node].velocity),
                false => -touch.g[node].dot(touch.velocity[node]),
            })),
            _ => None,
        })
    }

    fn core(self, pair: &Pair) -> f64 {
        let Some(rim) = pair.law.rim(pair.phase) else { return 0.0 };
        let (a, b) = (pair.a as usize, pair.b as usize);
        if !self.bodies[a].is_free() && !self.bodies[b].is_free() {
            return 0.0;
        }
        let radii = self.bodies[a].radius + self.bodies[b].radius;
        self.over(std::array::from_fn(|node| {
            let (at, to) = (self.places[a][node], self.places[b][node]);
            let apart = to.centre - at.centre;
            let distance = apart.length();
            let slope = rim.slope(distance / radii);
            if slope == 0.0 {
                return 0.0;
            }
            // q′ [1/s]
            let rate = apart.dot(to.velocity - at.velocity) / (distance * radii);
            let of = |own: usize, source: usize| {
                if own >= self.courses.len() {
                    return 0.0; // no vertices here
                }
                let (course, place) = (&self.courses[own], &self.places[own][node]);
                let to_source = self.places[source][node].centre - place.centre;
                let own = &self.bodies[own];
                let (field, source) = (self.field, &self.bodies[source]);
                let (active, weight, radius) = (&course.active, field.weight, source.sphere_radius);
                let potential = Potential { active, node, weight, radius, apart: to_source };
                field.scale(own.radius, source.radius) * potential.find(self.arch)
            };
            slope * rate * (of(a, b) + of(b, a))
        }))
    }
}
