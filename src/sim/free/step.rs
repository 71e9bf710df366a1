//! One step of bodies that depend on each other: exponential collocation.
//!
//! What acts on a vertex beyond its oscillator is taken as the cubic through its values at the four Lobatto nodes, and so
//! are the acceleration of a centre, the torque on a body and the rate of a frame. Against the exact oscillator that is
//! exponential collocation (Hochbruck & Ostermann 2005); the spring is in none of what is approximated. All of it depends
//! on all of it: corrected until it has settled.
//!
//! What has a kink in the step, because a vertex crosses the rim of a sphere or of a plane, is two smooth forces, of which
//! one ends and another begins at that instant: the cubic through the smooth one counts for a part of the step, exactly.
//!
//! Angular momentum is a quantity of its own, with the torque as its rate, and the rate of a frame follows from it. So
//! where action is reaction at every node, momentum and angular momentum are kept to rounding, whatever the step's error is.

use std::mem::take;

use glam::{DMat3, DQuat, DVec3};

use super::{
    super::nodes::SAMPLES,
    body::{Body, Sums},
    field::{Driven, Paths},
    weights::{BALLISTIC, Late, Stage, cubic},
};
use crate::model::{
    oscillator::Oscillator,
    shape_matching::{Inner, cross_matrix, frame_drive, resistance, rotation_by, rotation_vector_rate, solve},
};

/// The look in the middle of it.
pub const MIDDLE: usize = 4;

/// Where a frame is at an instant of a step, for others to see.
#[derive(Clone, Copy, Debug, Default)]
pub struct Place {
    /// c [scene unit]
    pub centre: DVec3,
    /// c′ [scene unit/s]
    pub velocity: DVec3,
}

/// A frame at an instant of a step.
#[derive(Clone, Copy, Debug, Default)]
pub struct Frame {
    /// Q.
    pub rotation: DQuat,
    /// Q.
    pub axes: DMat3,
    /// From the rotation at the start, Q = exp(v) Q₀ [rad].
    pub turned: DVec3,
    /// S about the centre.
    pub momentum: DVec3,
    /// Ω_Q [rad/s].
    pub frame_spin: DVec3,
    /// Ω [rad/s].
    pub spin: DVec3,
    /// Sums over the vertices.
    pub sums: Sums,
    /// With the axes.
    pub inner: Inner,
    /// The largest |s| [scene unit] …
    pub extent: f64,
    /// … and |s′| of any vertex, or more [scene unit/s].
    pub speed: f64,

    /// f̄ without what begins or ends in the step [scene unit/s²].
    pub mean: DVec3,
    /// Σ m a×f, likewise.
    pub turning: DVec3,
    /// Σ m s×f, likewise.
    pub spinning: DVec3,
    /// Acceleration of the centre, likewise [scene unit/s²].
    pub acceleration: DVec3,
    /// Torque about the island's origin, likewise.
    pub torque: DVec3,
    /// What all vertices feel: −f̄, or −carry [scene unit/s²].
    pub common: DVec3,
    /// What they feel by their rest position [1/s²].
    pub drive: DMat3,
}

/// Displacement and velocity of the vertices at an instant of a step, and what acts on them.
#[derive(Clone, Debug, Default)]
pub struct Vertices {
    pub x: Vec<DVec3>,
    pub u: Vec<DVec3>,
    /// Without what begins or ends in the step, and without what they have in common [scene unit/s²].
    pub f: Vec<DVec3>,
}

/// A force that begins (or, with the other sign, ends) to act at an instant of the step.
#[derive(Clone, Copy, Debug)]
pub struct Piece {
    /// As a part of the step.
    pub from: f64,
    /// 1 or −1.
    pub sign: f64,
    /// What it adds to the acceleration of the centre, at the nodes [scene unit/s²] …
    pub acceleration: [DVec3; 4],
    /// … and to the torque about the island's origin.
    pub torque: [DVec3; 4],
    /// On which vertex it acts; none if it is a reaction.
    pub own: Option<Own>,
}

/// What a [`Piece`] does to the vertex on which it acts.
#[derive(Clone, Copy, Debug)]
pub struct Own {
    pub vertex: u32,
    /// Whose sphere it is, if it is one's.
    pub source: Option<u32>,
    /// Its acceleration at the nodes [scene unit/s²].
    pub g: [DVec3; 4],
    /// What it adds to Ω_Q′, at the nodes [rad/s²].
    pub turn: [DVec3; 4],
}

/// What a sphere feels of the vertices that it acts on, without what begins or ends in the step: the mass times
/// acceleration at each look.
#[derive(Clone, Copy, Debug)]
pub struct Reaction {
    pub source: u32,
    pub force: [DVec3; 5],
}

/// What a plane does to a vertex.
#[derive(Clone, Copy, Debug)]
pub struct Held {
    pub plane: u32,
    pub vertex: u32,
    /// Its acceleration at the nodes, had it no kink there [scene unit/s²].
    pub g: [DVec3; 4],
}

/// A body's way through a step.
#[derive(Clone, Debug, Default)]
pub struct Course {
    pub frames: [Frame; 5],
    pub vertices: [Vertices; 5],
    pub pieces: Vec<Piece>,
    pub reactions: Vec<Reaction>,
    weights: [Stage; 4],
    known: (Oscillator, f64),
    /// What pieces do by each look after the start.
    late: [LateSum; 4],
    /// To which vertices they do something by themselves.
    own: Vec<(u32, [(DVec3, DVec3); 4])>,
    own_before: Vec<(u32, [(DVec3, DVec3); 4])>,
    /// Where a path is at each look.
    driven: [Driven; 5],
    /// Σ |s| of the spheres that act on the body [1/s²].
    pub stiffness: f64,
    /// What planes did to vertices when they were last looked at, by plane and vertex.
    pub held: Vec<Held>,
    /// The same before that.
    pub held_before: Vec<Held>,
}

/// See [`Course::late`].
#[derive(Clone, Copy, Debug)]
struct LateSum {
    centre: DVec3,
    velocity: DVec3,
    momentum: DVec3,
    /// By how much the frame is turned beyond what the cubic through its rates at the nodes says [rad].
    turned: DVec3,
    x: DVec3,
    u: DVec3,
    x_by_rest: DMat3,
    u_by_rest: DMat3,
}

impl Default for LateSum {
    fn default() -> LateSum {
        let none = DVec3::ZERO;
        let by_rest = DMat3::ZERO; // a matrix is the identity by default
        LateSum {
            centre: none,
            velocity: none,
            momentum: none,
            turned: none,
            x: none,
            u: none,
            x_by_rest: by_rest,
            u_by_rest: by_rest,
        }
    }
}

/// What a step of all bodies has in common.
#[derive(Clone, Debug, Default)]
pub struct Span {
    /// When it starts [s].
    pub start: f64,
    /// How long it is [s].
    pub h: f64,
    /// When it ends [s].
    pub end: f64,
    /// About which angular momentum is counted [scene unit].
    pub origin: DVec3,
    /// How centres move.
    pub ballistic: [Stage; 4],
}

impl Span {
    pub fn new(start: f64, end: f64, origin: DVec3) -> Span {
        let h = end - start;
        Span { start, h, end, origin, ballistic: Stage::looks(BALLISTIC, h) }
    }

    /// When the step looks for the n-th time [s].
    pub fn time(&self, look: usize) -> f64 {
        match look {
            0 => self.start,
            3 => self.end,
            _ => self.start + SAMPLES[look] * self.h,
        }
    }
}

/// Σ wᵢ vᵢ
#[inline]
pub fn combine(w: &[f64; 4], v: [DVec3; 4]) -> DVec3 {
    (w[0] * v[0] + w[1] * v[1]) + (w[2] * v[2] + w[3] * v[3])
}

#[inline]
fn combine_matrices(w: &[f64; 4], v: [DMat3; 4]) -> DMat3 {
    (v[0] * w[0] + v[1] * w[1]) + (v[2] * w[2] + v[3] * w[3])
}

impl Course {
    /// Sets out from the body's state; everything at the nodes is to be what it is at the start.
    pub fn begin(&mut self, index: usize, body: &Body, span: &Span, paths: &dyn Paths, places: &mut [Place; 5]) {
        if self.known != (body.oscillator, span.h) {
            self.known = (body.oscillator, span.h);
            self.weights = Stage::looks(body.oscillator, span.h);
        }
        for frame in &mut self.frames {
            frame.drive = DMat3::ZERO;
        }
        for vertices in &mut self.vertices {
            vertices.x.resize(body.x.len(), DVec3::ZERO);
            vertices.u.resize(body.x.len(), DVec3::ZERO);
            vertices.f.resize(body.x.len(), DVec3::ZERO);
        }
        self.vertices[0].x.copy_from_slice(&body.x);
        self.vertices[0].u.copy_from_slice(&body.u);
        self.pieces.clear();
        self.own.clear();
        self.own_before.clear();
        self.held.clear();
        self.late = Default::default();
        let first = &mut self.frames[0];
        *first = Frame {
            rotation: body.rotation,
            axes: DMat3::from_quat(body.rotation),
            momentum: body.spin,
            drive: DMat3::ZERO,
            ..Frame::default()
        };
        if body.is_free() {
            *places = [Place { centre: body.centre, velocity: body.velocity }; 5];
        } else {
            for look in 0..5 {
                let driven = paths.at(index, span.time(look), look == 3);
                self.driven[look] = driven;
                places[look] = Place { centre: driven.position, velocity: driven.velocity };
            }
        }
        self.sum_up(body, 0);
        self.orient(body, 0);
    }

    /// Where the centre is at the nodes, and the vertices, if what acts at the nodes is what was found last.
    pub fn follow(&mut self, body: &Body, span: &Span, looks: std::ops::Range<usize>, places: &mut [Place; 5]) -> f64 {
        let mut change: f64 = 0.0;
        std::mem::swap(&mut self.own, &mut self.own_before);
        self.add_pieces(body, span);
        let at_nodes = |what: fn(&Frame) -> DVec3| std::array::from_fn(|node| what(&self.frames[node]));
        let (acceleration, torque): ([DVec3; 4], [DVec3; 4]) = (at_nodes(|f| f.acceleration), at_nodes(|f| f.torque));
        let common: [DVec3; 4] = at_nodes(|f| f.common);
        let drive: [DMat3; 4] = std::array::from_fn(|node| self.frames[node].drive);
        let mass = body.mass();
        let start = places[0];
        let orbital = |place: &Place| mass * (place.centre - span.origin).cross(place.velocity);
        let momentum = orbital(&start) + body.spin;
        for look in looks.clone() {
            let (w, late) = (self.weights[look - 1], self.late[look - 1]);
            if body.is_free() {
                let b = &span.ballistic[look - 1];
                let place = Place {
                    centre: start.centre + (b.xu * start.velocity + (combine(&b.x, acceleration) + late.centre)),
                    velocity: start.velocity + (combine(&b.u, acceleration) + late.velocity),
                };
                change = larger(change, (place.centre - places[look].centre).length());
                places[look] = place;
                self.frames[look].momentum = momentum + (combine(&b.u, torque) + late.momentum) - orbital(&place);
            }
            // what single vertices do by themselves is added below; what changes by the rest is looked at without it
            for (vertex, late) in &self.own_before {
                self.vertices[look].x[*vertex as usize] -= late[look - 1].0;
            }
            let (x_common, u_common) = (combine(&w.x, common) + late.x, combine(&w.u, common) + late.u);
            let x_by_rest = combine_matrices(&w.x, drive) + late.x_by_rest;
            let u_by_rest = combine_matrices(&w.u, drive) + late.u_by_rest;
            let (mut x, mut u) = (take(&mut self.vertices[look].x), take(&mut self.vertices[look].u));
            let rest = &body.shape.rest[..];
            let n = rest.len();
            let [f0, f1, f2, f3] = std::array::from_fn(|node| &self.vertices[node].f[..n]);
            let (x0, u0) = (&self.vertices[0].x[..n], &self.vertices[0].u[..n]);
            let mut farthest: f64 = 0.0;
            for (i, (x, u)) in x[..n].iter_mut().zip(&mut u[..n]).enumerate() {
                let (l, f) = (rest[i], [f0[i], f1[i], f2[i], f3[i]]);
                let now = w.xx * x0[i] + w.xu * u0[i] + (combine(&w.x, f) + (x_common + x_by_rest * l));
                farthest = larger(farthest, (now - *x).length_squared());
                *x = now;
                *u = w.ux * x0[i] + w.uu * u0[i] + (combine(&w.u, f) + (u_common + u_by_rest * l));
            }
            (self.vertices[look].x, self.vertices[look].u) = (x, u);
            let vertices = &mut self.vertices[look];
            for (vertex, late) in &self.own {
                let (x, u) = late[look - 1];
                let known = self.own_before.iter().find(|(before, _)| before == vertex);
                let before = known.map_or(DVec3::ZERO, |(_, late)| late[look - 1].0);
                farthest = larger(farthest, (x - before).length_squared());
                vertices.x[*vertex as usize] += x;
                vertices.u[*vertex as usize] += u;
            }
            change = larger(change, farthest.sqrt());
            self.sum_up(body, look);
        }
        if body.turns() {
            change = larger(change, self.turn(body, span, looks));
        } else {
            for look in looks {
                self.frames[look].rotation = body.rotation;
                self.orient(body, look);
            }
        }
        change
    }

    /// The rotations at looks and the rates of the frame there: each follows from the other. Returns by how far that moves
    /// what is on the frame [scene unit].
    fn turn(&mut self, body: &Body, span: &Span, looks: std::ops::Range<usize>) -> f64 {
        const ROUNDS: usize = 3;
        let mut change: f64 = 0.0;
        for _ in 0..ROUNDS {
            let rates: [DVec3; 4] = std::array::from_fn(|node| {
                rotation_vector_rate(self.frames[node].turned, self.frames[node].frame_spin)
            });
            for look in looks.clone() {
                let turned = combine(&span.ballistic[look - 1].u, rates) + self.late[look - 1].turned;
                let frame = &mut self.frames[look];
                change = larger(change, (turned - frame.turned).length() * body.shape.extent);
                frame.turned = turned;
                frame.rotation = rotation_by(turned) * body.rotation;
                self.orient(body, look);
            }
        }
        change
    }

    /// Sums over the vertices at a look.
    fn sum_up(&mut self, body: &Body, look: usize) {
        let (frame, Vertices { x, u, .. }) = (&mut self.frames[look], &self.vertices[look]);
        frame.sums = Sums::of(&body.shape, x, u);
        let largest = |v: &[DVec3]| v.iter().map(|v| v.length_squared()).fold(0.0, larger).sqrt();
        frame.extent = body.shape.extent + largest(x);
        frame.speed = largest(u);
    }

    /// What follows from the rotation at a look.
    fn orient(&mut self, body: &Body, look: usize) {
        let frame = &mut self.frames[look];
        frame.axes = DMat3::from_quat(frame.rotation);
        frame.inner = frame.sums.inner(&body.shape, frame.axes);
        if body.turns() {
            frame.frame_spin = frame.inner.frame_spin(frame.momentum);
            frame.spin = frame.inner.spin(frame.momentum);
        }
    }

    /// What follows for the body at a look from the forces on its vertices, and from `reaction`, what its sphere feels.
    pub fn drive(&mut self, body: &Body, look: usize, gravity: DVec3, reaction: DVec3, place: &Place, origin: DVec3) {
        let mass = body.mass();
        let frame = &mut self.frames[look];
        if !body.is_free() {
            frame.common = -self.driven[look].carry;
            return;
        }
        frame.acceleration = frame.mean + (gravity + reaction / mass);
        frame.torque = frame.spinning + (place.centre - origin).cross(mass * frame.acceleration);
        frame.common = -frame.mean;
        if body.turns() {
            let Frame { inner, turning, spin, frame_spin, .. } = *frame;
            let damping = body.oscillator.damping;
            let rate = inner.frame_spin_rate(turning, damping, spin, frame_spin);
            frame.drive = frame_drive(frame.axes, damping, spin, frame_spin, rate);
        }
    }

    /// The first guess: nothing acts but gravity and what a path says.
    pub fn guess(&mut self, body: &Body, gravity: DVec3) {
        for look in 0..4 {
            self.vertices[look].f.fill(DVec3::ZERO);
            let frame = &mut self.frames[look];
            (frame.acceleration, frame.torque, frame.drive) = (DVec3::ZERO, DVec3::ZERO, DMat3::ZERO);
            frame.common = DVec3::ZERO;
            if body.is_free() {
                frame.acceleration = gravity;
            } else {
                frame.common = -self.driven[look].carry;
            }
        }
        let first = self.frames[0];
        for frame in &mut self.frames[1..] {
            (frame.turned, frame.frame_spin) = (DVec3::ZERO, first.frame_spin);
        }
    }

    /// What pieces do by each look.
    fn add_pieces(&mut self, body: &Body, span: &Span) {
        self.late = Default::default();
        self.own.clear();
        let per_mass = 1.0 / body.mass();
        for piece in &self.pieces {
            let centre: [Late; 4] =
                std::array::from_fn(|look| Late::new(BALLISTIC, span.h, piece.from, SAMPLES[look + 1]));
            for (late, weights) in self.late.iter_mut().zip(&centre) {
                late.centre += piece.sign * combine(&weights.x, piece.acceleration);
                late.velocity += piece.sign * combine(&weights.u, piece.acceleration);
                late.momentum += piece.sign * combine(&weights.u, piece.torque);
            }
            let Some(own) = &piece.own else { continue };
            let mass = body.shape.masses[own.vertex as usize];
            let mut alone = [(DVec3::ZERO, DVec3::ZERO); 4];
            // Q l × … of all vertices: −[turn]× Q
            let turn: [DMat3; 4] = std::array::from_fn(|node| cross_matrix(own.turn[node]) * self.frames[node].axes);
            let rates: [DVec3; 3] = std::array::from_fn(|node| combine(&centre[node].u, own.turn));
            for look in 0..4 {
                let w = Late::new(body.oscillator, span.h, piece.from, SAMPLES[look + 1]);
                let (x, u) = (piece.sign * combine(&w.x, own.g), piece.sign * combine(&w.u, own.g));
                alone[look] = (x, u);
                if !body.is_free() {
                    continue;
                }
                let late = &mut self.late[look];
                late.x -= mass * per_mass * x;
                late.u -= mass * per_mass * u;
                if body.turns() {
                    late.x_by_rest -= combine_matrices(&w.x, turn) * piece.sign;
                    late.u_by_rest -= combine_matrices(&w.u, turn) * piece.sign;
                    let seen = combine(&span.ballistic[look].u, [DVec3::ZERO, rates[0], rates[1], rates[2]]);
                    late.turned += piece.sign * (combine(&centre[look].x, own.turn) - seen);
                }
            }
            match self.own.iter_mut().find(|(vertex, _)| *vertex == own.vertex) {
                Some((_, known)) => {
                    for (known, alone) in known.iter_mut().zip(alone) {
                        known.0 += alone.0;
                        known.1 += alone.1;
                    }
                }
                None => self.own.push((own.vertex, alone)),
            }
        }
    }

    /// How what acts on a vertex at node 1 + j moves it at node 1 + i, `[i][j]`: in x [s²] and in u [s]. It acts from the start
    /// if it `starts`, and begins and ends to act at each of `crossings`.
    pub fn responses(&self, oscillator: Oscillator, h: f64, starts: bool, crossings: &[f64]) -> [[(f64, f64); 3]; 3] {
        std::array::from_fn(|i| {
            let stage = &self.weights[i];
            let mut all: [(f64, f64); 3] =
                std::array::from_fn(|j| if starts { (stage.x[j + 1], stage.u[j + 1]) } else { (0.0, 0.0) });
            let mut sign = if starts { -1.0 } else { 1.0 };
            for &from in crossings {
                let late = Late::new(oscillator, h, from, SAMPLES[i + 1]);
                for (j, weight) in all.iter_mut().enumerate() {
                    weight.0 += sign * late.x[j + 1];
                    weight.1 += sign * late.u[j + 1];
                }
                sign = -sign;
            }
            all
        })
    }

    /// G at a node, for [`Own::turn`].
    pub fn turn_of(&self, node: usize, moment: DVec3) -> DVec3 {
        solve(resistance(self.frames[node].inner.as_), moment)
    }

    /// How much what is found in the middle of the step differs from the cubics through the nodes.
    pub fn bends(&self, body: &Body) -> Bends {
        let w = cubic(0.5);
        let nodes: [&Frame; 4] = std::array::from_fn(|node| &self.frames[node]);
        let middle = &self.frames[MIDDLE];
        let active = |piece: &&Piece| piece.from < 0.5;
        let mut acceleration = middle.acceleration - combine(&w, nodes.map(|f| f.acceleration));
        let mut common = middle.common - combine(&w, nodes.map(|f| f.common));
        let mut drive = middle.drive - combine_matrices(&w, nodes.map(|f| f.drive));
        let mut pieces = Vec::new();
        for piece in self.pieces.iter().filter(active) {
            acceleration -= piece.sign * combine(&w, piece.acceleration);
            let Some(own) = &piece.own else { continue };
            let g = piece.sign * combine(&w, own.g);
            pieces.push((own.vertex, g));
            if body.is_free() {
                common += body.shape.masses[own.vertex as usize] / body.mass() * g;
            }
            if body.turns() {
                let turn: [DMat3; 4] =
                    std::array::from_fn(|node| cross_matrix(own.turn[node]) * self.frames[node].axes);
                drive += combine_matrices(&w, turn) * piece.sign;
            }
        }
        let mut force: f64 = 0.0;
        let [v0, v1, v2, v3, v4] = &self.vertices;
        for i in 0..v0.f.len() {
            let mut bend = v4.f[i] - combine(&w, [v0.f[i], v1.f[i], v2.f[i], v3.f[i]]);
            for (vertex, g) in &pieces {
                if *vertex as usize == i {
                    bend -= *g;
                }
            }
            bend += common + drive * body.shape.rest[i];
            force = larger(force, bend.length());
        }
        let spin = middle.frame_spin - combine(&w, nodes.map(|f| f.frame_spin));
        Bends { force, acceleration: acceleration.length(), spin: spin.length() }
    }

    /// Makes the end of the step the body's state.
    pub fn end(&mut self, body: &mut Body, places: &[Place; 5]) {
        let frame = &self.frames[3];
        body.centre = places[3].centre;
        body.velocity = places[3].velocity;
        body.rotation = frame.rotation;
        body.spin = frame.momentum;
        body.x.copy_from_slice(&self.vertices[3].x);
        body.u.copy_from_slice(&self.vertices[3].u);
        if body.is_free() {
            body.refit();
        }
    }
}

/// See [`Course::bends`].
#[derive(Clone, Copy, Debug, Default)]
pub struct Bends {
    /// Of the force on any vertex [scene unit/s²].
    pub force: f64,
    /// Of the acceleration of the centre [scene unit/s²].
    pub acceleration: f64,
    /// Of the rate of the frame [rad/s].
    pub spin: f64,
}

/// The larger; NaN is larger than anything.
#[inline]
pub fn larger(a: f64, b: f64) -> f64 {
    if b > a || b.is_nan() { b } else { a }
}
