//! One step of coupled bodies: exponential collocation.
//!
//! The acceleration of a vertex beyond its oscillator is interpolated by the cubic through its values at the four
//! Lobatto nodes, and so are the acceleration of a centre, the torque on a body and the angular velocity of a frame.
//! Against the exact oscillator that is exponential collocation (Hochbruck & Ostermann 2005); the spring is not part of
//! what is approximated. All these quantities depend on each other and are corrected until they converge.
//!
//! A force with a kink in the step, because a vertex crosses the rim of a sphere or of a plane, is split into two
//! smooth forces, of which one ends and the other begins at that instant: the cubic through each smooth force is
//! integrated exactly over its part of the step.
//!
//! Angular momentum is a state variable of its own, with the torque as its rate, and determines the angular velocity of
//! a frame. So where reactions equal actions at every node, momentum and angular momentum are conserved to rounding,
//! whatever the step's error.

use std::mem::take;

use glam::{DMat3, DQuat, DVec3};

use super::{
    super::{integrator::exponential::weights::Dense, nodes::SAMPLES},
    body::{Body, Sums},
    crossing::Crossings,
    field::{Driven, Paths},
    weights::{BALLISTIC, Late, cubic, looks},
};
use crate::model::{
    oscillator::Oscillator,
    shape_matching::{Inner, cross_matrix, frame_drive, resistance, rotation_by, rotation_vector_rate, solve},
};

/// Index of the sample in the middle of the step.
pub const MIDDLE: usize = 4;

/// Position and velocity of a frame at an instant of a step, as other bodies see it.
#[derive(Clone, Copy, Debug, Default)]
pub struct Place {
    /// Position c of the centre [scene unit].
    pub centre: DVec3,
    /// Velocity c′ of the centre [scene unit/s].
    pub velocity: DVec3,
}

/// A body's frame at an instant of a step.
#[derive(Clone, Copy, Debug, Default)]
pub struct Frame {
    /// Rotation Q.
    pub rotation: DQuat,
    /// Rotation Q as a matrix.
    pub axes: DMat3,
    /// Rotation vector v since the start, Q = exp(v) Q₀ [rad].
    pub turned: DVec3,
    /// Angular momentum S about the centre.
    pub momentum: DVec3,
    /// Angular velocity Ω_Q of the frame [rad/s].
    pub frame_spin: DVec3,
    /// Angular velocity Ω of the rigid rotation [rad/s].
    pub spin: DVec3,
    /// Sums over the vertices that do not depend on the frame.
    pub sums: Sums,
    /// Sums over the vertices for these axes.
    pub inner: Inner,
    /// The largest |s| of any vertex [scene unit].
    pub extent: f64,
    /// An upper bound of |s′| of any vertex [scene unit/s].
    pub speed: f64,

    /// Mean acceleration f̄ without the pieces that begin or end in the step [scene unit/s²].
    pub mean: DVec3,
    /// Σ m a×f, without these pieces.
    pub turning: DVec3,
    /// Σ m s×f, without these pieces.
    pub spinning: DVec3,
    /// Acceleration of the centre, without these pieces [scene unit/s²].
    pub acceleration: DVec3,
    /// Torque about the island's origin, without these pieces.
    pub torque: DVec3,
    /// Acceleration that all vertices share: −f̄, or −carry [scene unit/s²].
    pub common: DVec3,
    /// Matrix D of the acceleration D l that depends on a vertex's rest position l [1/s²].
    pub drive: DMat3,
}

/// Displacements and velocities of the vertices at an instant of a step, and what acts on them.
#[derive(Clone, Debug, Default)]
pub struct Vertices {
    pub x: Vec<DVec3>,
    pub u: Vec<DVec3>,
    /// Accelerations without those that begin or end in the step, and without the shared one [scene unit/s²].
    pub f: Vec<DVec3>,
}

/// A force that begins to act at an instant of the step, or, with sign −1, ends.
#[derive(Clone, Copy, Debug)]
pub struct Piece {
    /// Time at which it begins, as a fraction of the step.
    pub from: f64,
    /// 1 if the force begins, −1 if it ends.
    pub sign: f64,
    /// Contribution to the acceleration of the centre, at the nodes [scene unit/s²].
    pub acceleration: [DVec3; 4],
    /// Contribution to the torque about the island's origin, at the nodes.
    pub torque: [DVec3; 4],
    /// The vertex on which it acts; `None` for a reaction.
    pub own: Option<Own>,
}

/// The effect of a [`Piece`] on the vertex on which it acts.
#[derive(Clone, Copy, Debug)]
pub struct Own {
    pub vertex: u32,
    /// The body whose sphere it is, if it is a sphere's.
    pub source: Option<u32>,
    /// Its acceleration at the nodes [scene unit/s²].
    pub g: [DVec3; 4],
    /// Contribution to Ω_Q′, at the nodes [rad/s²].
    pub turn: [DVec3; 4],
}

/// The reaction on a sphere by the vertices that it acts on, without the pieces that begin or end in the step: mass
/// times acceleration at each sample.
#[derive(Clone, Copy, Debug)]
pub struct Reaction {
    pub source: u32,
    pub force: [DVec3; 5],
    /// The power of the reaction if it moved with the vertices instead, at the nodes; for the ledger, and only of bodies
    /// on paths.
    pub power: [f64; 4],
}

/// The force of a plane or a push on a vertex.
#[derive(Clone, Copy, Debug)]
pub struct Held {
    /// Number of the plane or push.
    pub contact: u32,
    pub vertex: u32,
    /// Its acceleration at the nodes, without a kink [scene unit/s²].
    pub g: [DVec3; 4],
    /// Whether it acts at the start of the step.
    pub starts_inside: bool,
    /// When it begins and ends.
    pub crossings: Crossings,
}

/// The motion of a body during a step.
#[derive(Clone, Debug, Default)]
pub struct Course {
    pub frames: [Frame; 5],
    pub vertices: [Vertices; 5],
    pub pieces: Vec<Piece>,
    pub reactions: Vec<Reaction>,
    weights: [Dense; 4],
    known: (Oscillator, f64),
    /// Effect of the pieces by each sample after the start.
    late: [LateSum; 4],
    /// Vertices that pieces act on directly, with the effect at each sample after the start.
    own: Vec<(u32, [(DVec3, DVec3); 4])>,
    own_before: Vec<(u32, [(DVec3, DVec3); 4])>,
    /// State of the path at each sample.
    driven: [Driven; 5],
    /// Σ |s| over the spheres that act on the body [1/s²].
    pub stiffness: f64,
    /// Plane forces of the last evaluation, by plane and vertex.
    pub held: Vec<Held>,
    /// Plane forces of the evaluation before that.
    pub held_before: Vec<Held>,
    /// Pushes of the last evaluation.
    pub pushed: Vec<Held>,
}

/// Effect of all pieces up to a sample, see [`Course::late`].
#[derive(Clone, Copy, Debug)]
struct LateSum {
    centre: DVec3,
    velocity: DVec3,
    momentum: DVec3,
    /// Rotation of the frame beyond the integral of the cubic through its rates at the nodes [rad].
    turned: DVec3,
    x: DVec3,
    u: DVec3,
    x_by_rest: DMat3,
    u_by_rest: DMat3,
}

impl Default for LateSum {
    fn default() -> LateSum {
        let none = DVec3::ZERO;
        let by_rest = DMat3::ZERO; // the default of a matrix is the identity
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

/// The parameters of a step that all bodies share.
#[derive(Clone, Debug, Default)]
pub struct Span {
    /// Start of the step [s].
    pub start: f64,
    /// Length of the step [s].
    pub h: f64,
    /// End of the step [s].
    pub end: f64,
    /// Reference point of angular momentum [scene unit].
    pub origin: DVec3,
    /// Weights for the motion of centres.
    pub ballistic: [Dense; 4],
}

impl Span {
    pub fn new(start: f64, end: f64, origin: DVec3) -> Span {
        let h = end - start;
        Span { start, h, end, origin, ballistic: looks(BALLISTIC, h) }
    }

    /// Time of sample number `look` [s].
    pub fn time(&self, look: usize) -> f64 {
        match look {
            0 => self.start,
            3 => self.end,
            _ => self.start + SAMPLES[look] * self.h,
        }
    }
}

/// Σ wᵢ vᵢ.
#[inline(always)]
pub fn combine(w: &[f64; 4], v: [DVec3; 4]) -> DVec3 {
    (w[0] * v[0] + w[1] * v[1]) + (w[2] * v[2] + w[3] * v[3])
}

#[inline(always)]
fn combine_matrices(w: &[f64; 4], v: [DMat3; 4]) -> DMat3 {
    (v[0] * w[0] + v[1] * w[1]) + (v[2] * w[2] + v[3] * w[3])
}

impl Course {
    /// Starts a step from the body's state; all nodes are initialised with the values at the start.
    pub fn begin(&mut self, index: usize, body: &Body, span: &Span, paths: &dyn Paths, places: &mut [Place; 5]) {
        if self.known != (body.oscillator, span.h) {
            self.known = (body.oscillator, span.h);
            self.weights = looks(body.oscillator, span.h);
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
        self.pushed.clear();
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

    /// Updates the centre and the vertices at the samples from the forces last found at the nodes.
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
            // single-vertex effects are added below; the change of the rest is measured without them
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

    /// Computes the rotations at samples and the frame's angular velocities there, which depend on each other. Returns
    /// how far this moves points on the frame [scene unit].
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

    /// Computes the sums over the vertices at a sample.
    fn sum_up(&mut self, body: &Body, look: usize) {
        let (frame, Vertices { x, u, .. }) = (&mut self.frames[look], &self.vertices[look]);
        frame.sums = Sums::of(&body.shape, x, u);
        let largest = |v: &[DVec3]| v.iter().map(|v| v.length_squared()).fold(0.0, larger).sqrt();
        frame.extent = body.shape.extent + largest(x);
        frame.speed = largest(u);
    }

    /// Updates what depends on the rotation at a sample.
    fn orient(&mut self, body: &Body, look: usize) {
        let frame = &mut self.frames[look];
        frame.axes = DMat3::from_quat(frame.rotation);
        frame.inner = frame.sums.inner(&body.shape, frame.axes);
        if body.turns() {
            frame.frame_spin = frame.inner.frame_spin(frame.momentum);
            frame.spin = frame.inner.spin(frame.momentum);
        }
    }

    /// Updates the body at a sample for the forces on its vertices and for `reaction`, the force on its sphere.
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

    /// The initial guess: gravity and the path alone.
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

    /// Adds the effects of pieces at each sample.
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

    /// Response at node 1 + i to an acceleration of a vertex at node 1 + j, `[i][j]`: in x [s²] and in u [s]. The
    /// acceleration acts from the start if `starts` is set, and toggles at each of `crossings`.
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

    /// The residuals of the cubics through the nodes in the middle of the step.
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

    /// Commits the end of the step as the body's state.
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

/// Residuals in the middle of a step, see [`Course::bends`].
#[derive(Clone, Copy, Debug, Default)]
pub struct Bends {
    /// Largest residual of the force on any vertex [scene unit/s²].
    pub force: f64,
    /// Residual of the acceleration of the centre [scene unit/s²].
    pub acceleration: f64,
    /// Residual of the frame's angular velocity [rad/s].
    pub spin: f64,
}

/// The larger of two numbers; NaN if either is NaN.
#[inline]
pub fn larger(a: f64, b: f64) -> f64 {
    if b > a || b.is_nan() { b } else { a }
}
