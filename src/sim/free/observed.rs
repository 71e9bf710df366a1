//! Forces in the current state, by cause, for observation. The formulas are those of the solver.

use glam::{DMat3, DVec3};

use super::{
    super::terms::Cause,
    body::Body,
    conserved::Conserved,
    field::{Field, Pair},
    force::{Contact, Seen, Sphere},
};
use crate::geometry::Vectors;

/// Forces on a body, by cause.
#[derive(Clone, Debug, Default)]
pub struct Forces {
    /// Accelerations of the vertices [scene unit/s²], `[vertex_count]`, by [`Cause`]; empty where a cause does not act.
    /// Those of [`Cause::Net`] are the sum of the others.
    pub by_cause: [Vectors; Cause::ALL.len()],
    /// Index of the body whose sphere acts, by cause; `None` if there is none or more than one.
    pub sources: [Option<u32>; Cause::ALL.len()],
    /// Force at the centre, M c″ [mass · scene unit/s²]; zero for a body on a path.
    pub force: DVec3,
    /// Torque about the centre, Σ m s×f [mass · scene unit²/s²]; zero for a body on a path or of fixed rotation.
    pub torque: DVec3,
}

/// Bodies at an instant.
#[derive(Clone, Debug)]
pub struct Snapshot<'a> {
    bodies: Vec<&'a Body>,
    pairs: Vec<Pair>,
    field: Field,
    time: f64,
    pairs_of: Vec<Vec<u32>>,
}

impl<'a> Snapshot<'a> {
    /// The bodies in their current state, at `time` [s].
    pub fn new(bodies: Vec<&'a Body>, pairs: Vec<Pair>, field: Field, time: f64) -> Snapshot<'a> {
        let mut pairs_of = vec![Vec::new(); bodies.len()];
        for (index, pair) in (0..).zip(&pairs) {
            pairs_of[pair.a as usize].push(index);
            pairs_of[pair.b as usize].push(index);
        }
        Snapshot { bodies, pairs, field, time, pairs_of }
    }

    /// Momentum, angular momentum and energy.
    pub fn conserved(&self) -> Conserved {
        Conserved::of(&self.bodies, &self.pairs, &self.field)
    }

    /// Number of vertices inside a sphere that acts on them.
    pub fn reached(&self) -> u64 {
        let mut reached = 0;
        for (index, pairs) in self.pairs_of.iter().enumerate().filter(|(_, pairs)| !pairs.is_empty()) {
            let mut is_reached = vec![false; self.bodies[index].shape.rest.len()];
            for &pair in pairs {
                self.sphere(index, &self.pairs[pair as usize], |i, _| is_reached[i] = true);
            }
            reached += is_reached.into_iter().filter(|&reached| reached).count() as u64;
        }
        reached
    }

    /// Whether nothing acts on a body but its own oscillators.
    pub fn is_idle(&self, index: usize) -> bool {
        let (body, field) = (self.bodies[index], &self.field);
        let extent = body.shape.extent + body.x.iter().map(|x| x.length()).fold(0.0, f64::max);
        self.pairs_of[index].is_empty()
            && field.planes.iter().all(|plane| plane.depth(body.centre) + extent < 0.0)
            && !field.pushes.iter().any(|push| push.body == index)
            && !field.forces.iter().any(|(body, _)| *body as usize == index)
            && (field.uniform.is_empty() || !body.is_free())
    }

    /// The force on the vertices of body `index` by the sphere of `source`, Σ m f [mass · scene unit/s²]; its opposite
    /// acts on the source.
    pub fn pull(&self, index: usize, source: usize) -> DVec3 {
        let pairs = self.pairs_of[index].iter().map(|&pair| self.pairs[pair as usize]);
        let of_source = pairs.filter(|pair| pair.a as usize == source || pair.b as usize == source);
        of_source.fold(DVec3::ZERO, |sum, pair| sum + self.sphere(index, &pair, |_, _| ()))
    }

    /// Computes the forces on body `index`, into `forces` (reused). `uniform` are the accelerations that
    /// all vertices of a body on a path share [scene unit/s²].
    pub fn forces(&self, index: usize, uniform: impl Iterator<Item = (Cause, DVec3)>, forces: &mut Forces) {
        let body = self.bodies[index];
        let (shape, n) = (&*body.shape, body.shape.rest.len());
        let Forces { by_cause, sources, force, torque } = forces;
        by_cause.iter_mut().for_each(Vectors::clear);
        *sources = Default::default();
        let (mut several, mut reaction) = ([false; Cause::ALL.len()], DVec3::ZERO);
        for &pair in &self.pairs_of[index] {
            let pair = &self.pairs[pair as usize];
            let other = if pair.a as usize == index { pair.b } else { pair.a };
            let cause = self.cause(pair) as usize;
            let own = &mut by_cause[cause];
            let mut acts = false;
            self.sphere(index, pair, |i, g| {
                own.resize(n);
                own.set(i, own.get(i) + g);
                acts = true;
            });
            if acts && pair.window.is_none() {
                several[cause] |= sources[cause].is_some();
                sources[cause] = Some(other);
            }
            reaction -= self.sphere(other as usize, pair, |_, _| ());
        }
        for (source, several) in sources.iter_mut().zip(several) {
            *source = source.filter(|_| !several);
        }
        self.contacts(index, by_cause);
        let axes = DMat3::from_quat(body.rotation);
        // Σ m f of external forces on vertices, and its moment
        let (mut sum, mut moment) = (DVec3::ZERO, DVec3::ZERO);
        for accelerations in by_cause.iter() {
            for (i, f) in accelerations.iter().enumerate() {
                let pull = shape.masses[i] * f;
                sum += pull;
                moment += (axes * shape.rest[i] + body.state(i).0).cross(pull);
            }
        }
        (*force, *torque) = (DVec3::ZERO, DVec3::ZERO);
        let mut add_uniform = |(cause, acceleration): (Cause, DVec3)| {
            if acceleration != DVec3::ZERO {
                by_cause[cause as usize].resize(n);
                by_cause[cause as usize].fill(acceleration);
            }
        };
        if body.is_free() {
            self.field.uniform.iter().copied().for_each(&mut add_uniform);
            add_uniform((Cause::Reaction, reaction / body.mass()));
            *force = sum + body.mass() * self.field.free_fall() + reaction;
            *torque = if body.turns() { moment } else { DVec3::ZERO };
        } else {
            uniform.for_each(add_uniform);
        }
        let (omega, damping) = (body.oscillator.omega, body.oscillator.damping);
        let (frame_spin, spin) = if body.turns() {
            let inner = body.inner(body.rotation);
            (inner.frame_spin(body.spin), inner.spin(body.spin))
        } else {
            (DVec3::ZERO, DVec3::ZERO)
        };
        for i in 0..n {
            let (x, u) = body.state(i);
            by_cause[Cause::Restoring as usize].push(-(omega * omega) * x);
            // s′ − Ω×s = u − Ω×x + (Ω_Q − Ω)×a
            let slip = (frame_spin - spin).cross(axes * shape.rest[i]) - spin.cross(x) + u;
            by_cause[Cause::Damping as usize].push(-2.0 * damping * slip);
        }
        let [terms @ .., net] = by_cause;
        net.reset(n);
        terms.iter().filter(|term| !term.is_empty()).for_each(|term| net.add_times(1.0, term));
    }

    /// The cause that the forces of a pair belong to.
    fn cause(&self, pair: &Pair) -> Cause {
        if pair.window.is_some() {
            return Cause::Point;
        }
        let (a, b) = (self.bodies[pair.a as usize], self.bodies[pair.b as usize]);
        Cause::of_sphere(pair.phase, pair.law.strength(pair.phase, a.q(b)))
    }

    /// Calls `each` with the vertices of body `index` that the other body's sphere acts on and their accelerations, and
    /// returns Σ m f.
    fn sphere(&self, index: usize, pair: &Pair, mut each: impl FnMut(usize, DVec3)) -> DVec3 {
        let source = if pair.a as usize == index { pair.b } else { pair.a };
        let (own, other) = (self.bodies[index], self.bodies[source as usize]);
        let strength = self.field.scale(own.radius, other.radius) * pair.law.strength(pair.phase, own.q(other));
        let mut sum = DVec3::ZERO;
        if strength != 0.0 {
            let places = [other.place(); 5];
            let (radius, scale) = (other.sphere_radius, self.field.scale(own.radius, other.radius));
            let (radii, law, phase) = (own.radius + other.radius, pair.law, pair.phase);
            let strength = [strength; 5];
            let sphere = Sphere { source, radius, strength, scale, radii, law, phase, places, band: 0.0 };
            self.touched(index, Contact::Sphere(&sphere), |i, g| {
                sum += own.shape.masses[i] * g;
                each(i, g);
            });
        }
        sum
    }

    /// Adds the accelerations by planes, pushes and forces set by a program.
    fn contacts(&self, index: usize, by_cause: &mut [Vectors; Cause::ALL.len()]) {
        let (field, n) = (&self.field, self.bodies[index].shape.rest.len());
        let mut add = |cause: Cause, i: usize, g: DVec3| {
            let own = &mut by_cause[cause as usize];
            own.resize(n);
            own.set(i, own.get(i) + g);
        };
        for plane in &field.planes {
            self.touched(index, Contact::Plane(plane), |i, g| add(Cause::Plane, i, g));
        }
        for push in &field.pushes {
            if push.body == index && push.acts_at(self.time) {
                self.touched(index, Contact::Push(push), |i, g| add(Cause::Push, i, g));
            }
        }
        let body = self.bodies[index];
        let given = field.given(index, self.time, body.centre, body.velocity);
        if given != DVec3::ZERO {
            (0..n).for_each(|i| add(Cause::Push, i, given));
        }
    }

    /// Calls `each` with the vertices on which a contact acts, and their accelerations.
    fn touched(&self, index: usize, contact: Contact<'_>, mut each: impl FnMut(usize, DVec3)) {
        let body = self.bodies[index];
        let place = body.place();
        if let Contact::Plane(plane) = contact
            && plane.depth(body.centre) + body.shape.extent + body.x.iter().map(|x| x.length()).fold(0.0, f64::max)
                < 0.0
        {
            return;
        }
        let (axes, turning) = (DMat3::from_quat(body.rotation), body.frame_spin());
        for i in 0..body.shape.rest.len() {
            let (a, (x, u)) = (axes * body.shape.rest[i], body.state(i));
            let seen = Seen { a, s: a + x, rate: turning.cross(a) + u, place, turning };
            if contact.depth(0, &seen).0 > 0.0 {
                each(i, contact.acceleration(self.field.weight, 0, &seen));
            }
        }
    }
}
