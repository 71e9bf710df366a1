//! One step of coupled bodies: exponential collocation.
//!
//! Cubics through the values at the four Lobatto nodes interpolate the acceleration of a vertex beyond its oscillator,
//! the acceleration of a centre, the torque on a body and the angular velocity of a frame. With the exact flow of the
//! oscillator, this is exponential collocation (Hochbruck & Ostermann 2005): the spring is not approximated. All these
//! quantities depend on each other and are corrected until they converge.
//!
//! If a vertex crosses the rim of a sphere or a plane within the step, the force on it has a kink: `split` advances this
//! vertex alone, over parts of the step on which its force is smooth, and the body takes what the force does to it.
//!
//! The error of a step is estimated from the residuals, forces less their cubics, at three midpoints between the nodes.
//! They determine the terms of degree four to six, whose effect on the end is integrated.
//!
//! Angular momentum is a state variable, with the torque as its rate, and determines the angular velocity of a frame.
//! Where reactions equal actions at every node, momentum and angular momentum are conserved to rounding, whatever the
//! error of the step.

use glam::{DMat3, DQuat, DVec3};
use pulp::Arch;

use super::{
    body::{Body, Sums},
    field::{Driven, Field, Paths},
    force::{Acting, View},
    kernels::{
        self, Active, AddResidual, Finish, Gather, Gathered, Kernel, LargestErrors, Move, Moved, PlaceAll, Reach,
        Start, Sum, SumActive, WIDTH,
    },
    passive::{Linear, Maxima, Moments, Scaled},
    split::{By, Motion, Piece, Split},
};
use crate::{
    model::{
        oscillator::Oscillator,
        shape_matching::{
            Inner, cross_matrix, frame_drive, moment, outer, resistance, rotation_by, rotation_vector_rate, solve,
        },
    },
    sim::numerics::{
        bernstein::Curve,
        dense::{BALLISTIC, Dense, at_samples, ballistic, early, early_ballistic, residual},
        lagrange::{combine, combine_matrices, cubic},
        larger,
        nodes::{MIDPOINTS, NODES, SAMPLES},
    },
};

/// Index of the sample in the middle of the step.
pub const MIDDLE: usize = 4;

/// Position and velocity of a body's centre at an instant of a step.
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
    /// Upper bound of |s| of any vertex [scene unit].
    pub extent: f64,
    /// Upper bound of |u| of any vertex [scene unit/s].
    pub speed: f64,

    /// Mean acceleration f̄, without the pieces that begin or end in the step [scene unit/s²].
    pub mean: DVec3,
    /// Σ m a×f, without these pieces.
    pub turning: DVec3,
    /// Σ m s×f, without these pieces.
    pub spinning: DVec3,
    /// Acceleration of the centre, without these pieces [scene unit/s²].
    pub acceleration: DVec3,
    /// Torque about [`Span::origin`], without these pieces.
    pub torque: DVec3,
    /// Acceleration that all vertices share: −f̄, or that of a body on a path [scene unit/s²].
    pub common: DVec3,
    /// Matrix D of the acceleration D l of a vertex with rest position l [1/s²].
    pub drive: DMat3,
}

/// The reaction on a sphere by the vertices that it acts on, without the pieces that begin or end in the step.
#[derive(Clone, Copy, Debug)]
pub struct Reaction {
    /// The body whose sphere it is.
    pub source: u32,
    /// −Σ m f at each sample [mass · scene unit/s²].
    pub force: [DVec3; 5],
    /// −Σ m f·r′ of the vertices at the nodes, only for vertices of bodies on paths: for the ledger.
    pub power: [f64; 4],
}

/// The force of a plane or a push on a vertex on which it acts throughout the step.
#[derive(Clone, Copy, Debug)]
pub struct Held {
    /// Index of the plane or push.
    pub contact: u32,
    /// Index of the vertex among the active ones.
    pub vertex: u32,
    /// Acceleration of the vertex at the nodes [scene unit/s²].
    pub g: [DVec3; 4],
}

/// The motion of a body during a step.
#[derive(Clone, Debug, Default)]
pub struct Course {
    /// Smallest radius of the body and of those near it, to which its errors are relative [scene unit]: an error
    /// that is small for the body may be large for a smaller neighbour.
    pub smallest_radius: f64,
    pub frames: [Frame; 5],
    /// The vertices that something may reach in the step.
    pub active: Active,
    /// x and u of the inactive vertices, the others, at the samples.
    pub others: [[Linear; 2]; 5],
    /// Moments of the others at the start.
    pub moments: Moments,
    /// Moments of the active vertices at the start.
    first: Moments,
    /// Sums over the accelerations of the active vertices at the samples, including rotating damping.
    gathered: [Gathered; 5],
    /// Sums over the active vertices at the samples.
    sums: [Sums; 5],
    /// The part of the others' accelerations at the samples that depends on their states: rotating damping.
    coupling: [Linear; 5],
    /// The states of all vertices at the start.
    start: Start,
    maxima: Maxima,
    pub errors: Errors,
    residual: [(f64, f64); 3],
    residual_ballistic: [(f64, f64); 3],
    /// The vertices that are advanced alone, ascending.
    pub splits: Vec<Split>,
    /// Empty: the allocation of the next list.
    pub splits_before: Vec<Split>,
    /// Those of earlier steps, for their allocations.
    pub spare_splits: Vec<Split>,
    /// Forces on the body by individually advanced vertices, its own and those of others.
    pub pieces: Vec<Piece>,
    pub reactions: Vec<Reaction>,
    weights: [Dense; 4],
    early: [[Dense; 3]; 3],
    /// Oscillator and step length of `weights` and `early`.
    known: (Oscillator, f64),
    /// Effect of the pieces, by sample after the start.
    pub late: [LateSum; 4],
    /// The vertices that are advanced alone, with the effect of their contacts at each sample after the start.
    own: Vec<(u32, [[DVec3; 2]; 4])>,
    own_before: Vec<(u32, [[DVec3; 2]; 4])>,
    /// Motion of the centre of a free body since the start, at each sample [scene unit].
    moved: [DVec3; 5],
    /// Motion on the path at each sample.
    driven: [Driven; 5],
    /// Plane forces on other vertices of the last evaluation, sorted by plane and vertex.
    pub held: Vec<Held>,
    /// Plane forces of the previous evaluation.
    pub held_before: Vec<Held>,
    /// Pushes of the last evaluation.
    pub pushed: Vec<Held>,
    /// Buffer: vertices on which a contact begins or ceases to act.
    pub crossing: Vec<u32>,
    spheres: Vec<(DVec3, f64)>,
    planes: Vec<(DVec3, f64)>,
}

/// Effect of all pieces at a sample, see [`Course::late`].
#[derive(Clone, Copy, Debug)]
pub struct LateSum {
    centre: DVec3,
    velocity: DVec3,
    momentum: DVec3,
    /// Rotation of the frame beyond the integral of the cubic through its rates at the nodes [rad].
    turned: DVec3,
    /// Displacement and velocity of all vertices.
    pub x: DVec3,
    pub u: DVec3,
    /// Displacement and velocity per rest position.
    pub x_by_rest: DMat3,
    pub u_by_rest: DMat3,
}

zero_by_default!(LateSum { DMat3::ZERO => x_by_rest u_by_rest, DVec3::ZERO => centre velocity momentum turned x u });

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
    /// The instant of the sample [`MIDDLE`], as a fraction of the step.
    pub midpoint: f64,
    /// Weights for the motion of centres.
    pub ballistic: [Dense; 4],
    early: [[Dense; 3]; 3],
}

impl Span {
    pub fn new(start: f64, end: f64, origin: DVec3) -> Span {
        let h = end - start;
        Span { start, h, end, origin, midpoint: 0.5, ballistic: ballistic(h), early: early_ballistic(h) }
    }

    /// Vector from the reference point of angular momentum to a body's centre [scene unit].
    #[inline]
    pub fn arm(&self, centre: DVec3) -> DVec3 {
        centre - self.origin
    }

    /// The motion of a body on a path at the samples, also stored in `places`.
    pub fn driven(&self, index: usize, paths: &dyn Paths, places: &mut [Place; 5]) -> [Driven; 5] {
        let driven = std::array::from_fn(|sample| paths.at(index, self.time(sample), sample == 3));
        *places = driven.map(|driven: Driven| driven.place);
        driven
    }

    /// Time of a sample [s].
    pub fn time(&self, sample: usize) -> f64 {
        match sample {
            0 => self.start,
            3 => self.end,
            _ => self.start + self.theta(sample) * self.h,
        }
    }

    /// Time of a sample, as a fraction of the step.
    pub fn theta(&self, sample: usize) -> f64 {
        if sample == MIDDLE { self.midpoint } else { SAMPLES[sample] }
    }

    /// Moves the sample [`MIDDLE`] to midpoint `k`.
    pub fn sample_midpoint(&mut self, k: usize) {
        self.midpoint = MIDPOINTS[k];
        self.ballistic[MIDDLE - 1] = Dense::new(BALLISTIC, self.h, self.midpoint);
    }
}

impl Course {
    /// Begins a step from the body's state.
    pub fn begin(
        &mut self,
        arch: Arch,
        index: usize,
        body: &Body,
        span: &Span,
        paths: &dyn Paths,
        places: &mut [Place; 5],
    ) {
        if self.known != (body.oscillator, span.h) {
            self.known = (body.oscillator, span.h);
            self.weights = at_samples(body.oscillator, span.h);
            self.early = early(body.oscillator, span.h);
        }
        for (into, from) in [(&mut self.start.x, &body.x), (&mut self.start.u, &body.u)] {
            kernels::by_coordinate(from, into);
        }
        let [x, u] = [&self.start.x, &self.start.u].map(|v| kernels::largest_square(arch, v).sqrt());
        self.maxima = Maxima { x, u, rest: body.shape.extent };
        self.pieces.clear();
        self.spare_splits.append(&mut self.splits);
        self.own.clear();
        self.own_before.clear();
        self.held.clear();
        self.pushed.clear();
        self.reactions.clear();
        self.late = Default::default();
        self.others = Default::default();
        self.coupling = Default::default();
        self.others[0] = [Linear::x(), Linear::u()];
        self.frames = [Frame {
            rotation: body.rotation,
            axes: DMat3::from_quat(body.rotation),
            momentum: body.spin,
            drive: DMat3::ZERO, // the default of a matrix is the identity
            ..Frame::default()
        }; 5];
        if body.is_free() {
            *places = [Place { centre: body.centre, velocity: body.velocity }; 5];
        } else {
            self.driven = span.driven(index, paths, places);
        }
    }

    /// Finds the active vertices: those that spheres, planes or pushes may reach in the step. Allows for `wide` times
    /// the expected motion; [`Course::outgrows_selection`] reports whether that was enough.
    pub fn select(&mut self, view: View<'_>, acting: &mut Acting, wide: f64) {
        let View { body, field, span, places, arch, .. } = view;
        let Maxima { x, u, rest: extent } = self.maxima;
        let farthest = extent + x;
        // the sums are not known yet: use the inertia of the rest shape
        let turning = if body.turns() {
            let axes = self.frames[0].axes;
            let spread = axes * body.shape.spread * axes.transpose();
            solve(resistance(spread), body.spin).length()
        } else {
            0.0
        };
        let swings = self.weights.iter().map(|w| (w.xx - 1.0).abs() * x + w.xu.abs() * u).fold(0.0, f64::max);
        let own = swings + 1.5 * turning * span.h * extent;
        let margin = 0.01 * body.radius + 0.5 * field.free_fall().length() * span.h * span.h;
        let at = places[0];
        self.spheres.clear();
        for sphere in &mut acting.spheres {
            let away = |sample: usize| {
                let coasting = SAMPLES[sample] * span.h * (sphere.places[0].velocity - at.velocity);
                let (now, then) =
                    (sphere.places[sample].centre - places[sample].centre, sphere.places[0].centre - at.centre);
                (now - then).length().max(coasting.length())
            };
            sphere.band = wide * (margin + 1.2 * (own + (1..4).map(away).fold(0.0, f64::max)));
            let apart = sphere.places[0].centre - at.centre;
            if apart.length() <= sphere.radius + sphere.band + farthest {
                self.spheres.push((apart, sphere.radius + sphere.band));
            }
        }
        self.planes.clear();
        acting.plane_bands.clear();
        for plane in &field.planes {
            let away = |sample: usize| {
                let coasting = SAMPLES[sample] * span.h * plane.normal.dot(at.velocity);
                plane.normal.dot(places[sample].centre - at.centre).abs().max(coasting.abs())
            };
            let band = wide * (margin + 1.2 * (own + (1..4).map(away).fold(0.0, f64::max)));
            acting.plane_bands.push(band);
            let side = plane.depth(at.centre) + band;
            if side + farthest > 0.0 {
                self.planes.push((plane.normal, side));
            }
        }
        let Course { start, active, .. } = self;
        let shape = &*body.shape;
        let n = shape.rest.len();
        start.masses.clone_from(&shape.lanes_masses);
        active.vertices.clear();
        if !acting.pushes.is_empty() {
            active.vertices.extend(0..n as u32);
        } else if !(self.spheres.is_empty() && self.planes.is_empty()) {
            start.gap.resize(shape.lanes.len(), [0.0; WIDTH]);
            let (axes, rest) = (self.frames[0].axes, &shape.lanes);
            Reach { start, rest, axes, spheres: &self.spheres, planes: &self.planes }.find(arch);
            let gaps = start.gap.as_flattened()[..n].iter().zip(0u32..);
            active.vertices.extend(gaps.filter(|(gap, _)| !(**gap > 0.0)).map(|(_, i)| i));
        }
        active.resize();
        active.clear_forces(1..4);
        for place in 0..WIDTH * active.blocks.len() {
            let vertex = active.vertices[place.min(active.vertices.len() - 1)] as usize;
            let mass = if place < active.vertices.len() { shape.masses[vertex] } else { 0.0 };
            active.begin(place, mass, shape.rest[vertex], body.x[vertex], body.u[vertex]);
            start.masses[vertex / WIDTH][vertex % WIDTH] = 0.0;
        }
        self.moments = Moments::default();
        self.first = Moments::default();
        self.sums = Default::default();
        let frame = &mut self.frames[0];
        if body.is_free() {
            if active.len() < n {
                self.moments = Sum { start: &self.start, rest: &shape.lanes }.find(arch);
            }
            if active.len() > 0 {
                self.first = SumActive(active).find(arch);
            }
            self.sums[0] = self.first.at_start();
            frame.sums = self.moments.at_start() + self.sums[0];
        }
        frame.extent = extent + x;
        frame.speed = u;
        self.gathered = Default::default();
        self.orient(body, 0);
        self.place(arch, 0);
    }

    /// Whether an inactive vertex may have come into reach.
    pub fn outgrows_selection(&self, body: &Body, field: &Field, acting: &Acting, places: &[Place; 5]) -> bool {
        if self.active.len() == body.shape.rest.len() {
            return false;
        }
        let start = Linear::x();
        let own = |sample: usize| {
            let turned = self.frames[sample].turned.length();
            self.others[sample][0].difference(&start, &self.maxima) + turned * self.maxima.rest
        };
        let own = [0.0, own(1), own(2), own(3)];
        (1..4).any(|sample| {
            acting.spheres.iter().any(|sphere| {
                let now = sphere.places[sample].centre - places[sample].centre;
                let moved = now - (sphere.places[0].centre - places[0].centre);
                !(own[sample] + moved.length() <= sphere.band)
            }) || field.planes.iter().zip(&acting.plane_bands).any(|(plane, &band)| {
                let moved = plane.normal.dot(places[sample].centre - places[0].centre).abs();
                !(own[sample] + moved <= band)
            })
        })
    }

    /// Estimates the centre and the vertices at a node from the forces at the nodes before it; with the last node, the
    /// other two are estimated again.
    pub fn predict(&mut self, arch: Arch, body: &Body, span: &Span, node: usize, places: &mut [Place; 5]) {
        let weights = self.early[node - 1];
        let first = if node == 3 { 1 } else { node };
        self.advance(arch, body, span, [&weights, &span.early[node - 1]], first..node + 1, places);
    }

    /// Updates the centre and the vertices at the samples from the last forces at the nodes. Returns the largest change
    /// of a position, or of a velocity times the time it lasts [scene unit]. After an evaluation, the call for the end
    /// comes first: it computes the effects of pieces at all nodes.
    pub fn correct(
        &mut self,
        arch: Arch,
        body: &Body,
        span: &Span,
        samples: std::ops::Range<usize>,
        places: &mut [Place; 5],
    ) -> f64 {
        let weights = self.weights;
        match samples.end {
            4 => self.add_pieces(body, span, 1..4),
            end if end > MIDDLE => self.add_pieces(body, span, samples.clone()),
            _ => {} // computed with the end
        }
        self.advance(arch, body, span, [&weights, &span.ballistic], samples, places)
    }

    /// Like [`Course::correct`], with these weights for vertices and centres.
    fn advance(
        &mut self,
        arch: Arch,
        body: &Body,
        span: &Span,
        [weights, ballistic]: [&[Dense]; 2],
        samples: std::ops::Range<usize>,
        places: &mut [Place; 5],
    ) -> f64 {
        // time over which an error in velocity acts: an oscillator turns it into a displacement; a centre keeps it, so count one
        // second
        let swing = 1.0 / body.oscillator.omega.max(2.0 * body.oscillator.damping).max(1.0);
        let mut change: f64 = 0.0;
        let nodes: [&Frame; 4] = std::array::from_fn(|node| &self.frames[node]);
        let (acceleration, torque) = (nodes.map(|f| f.acceleration), nodes.map(|f| f.torque));
        let (common, drive) = (nodes.map(|f| f.common), nodes.map(|f| f.drive));
        let is_coupled = body.turns() && body.oscillator.damping != 0.0;
        let mass = body.mass();
        let start = places[0];
        let orbital = |place: &Place| mass * span.arm(place.centre).cross(place.velocity);
        let momentum = orbital(&start) + body.spin;
        for sample in samples.clone() {
            let (w, late) = (&weights[sample - 1], self.late[sample - 1]);
            if body.is_free() {
                let b = &ballistic[sample - 1];
                self.moved[sample] = b.xu * start.velocity + (combine(&b.x, acceleration) + late.centre);
                let place = Place {
                    centre: start.centre + self.moved[sample],
                    velocity: start.velocity + (combine(&b.u, acceleration) + late.velocity),
                };
                change = larger(change, (place.centre - places[sample].centre).length());
                change = larger(change, (place.velocity - places[sample].velocity).length());
                places[sample] = place;
                self.frames[sample].momentum = momentum + (combine(&b.u, torque) + late.momentum) - orbital(&place);
            }
            let (x_common, u_common) = (combine(&w.x, common) + late.x, combine(&w.u, common) + late.u);
            let x_by_rest = combine_matrices(&w.x, drive) + late.x_by_rest;
            let u_by_rest = combine_matrices(&w.u, drive) + late.u_by_rest;
            let x = Scaled { by_x: w.xx, by_u: w.xu, by_rest: x_by_rest, shift: x_common };
            let u = Scaled { by_x: w.ux, by_u: w.uu, by_rest: u_by_rest, shift: u_common };
            let mut others = [x.linear(), u.linear()];
            if is_coupled {
                for node in 0..4 {
                    others[0].add_times(w.x[node], &self.coupling[node]);
                    others[1].add_times(w.u[node], &self.coupling[node]);
                }
            }
            let are_others = self.active.len() < body.shape.rest.len();
            if is_coupled {
                change = larger(change, others[0].difference(&self.others[sample][0], &self.maxima));
                change = larger(change, swing * others[1].difference(&self.others[sample][1], &self.maxima));
            } else if are_others {
                change = larger(change, x.difference(&self.others[sample][0], &self.maxima));
                change = larger(change, swing * u.difference(&self.others[sample][1], &self.maxima));
            }
            self.others[sample] = others;

            // effects on single vertices are added below; the change of the rest is measured without them
            let active = &mut self.active;
            for (vertex, late) in &self.own_before {
                let [x, u] = late[sample - 1];
                active.shift(sample, *vertex as usize, -x, -u);
            }
            let (common, by_rest) = ([x_common, u_common], [x_by_rest, u_by_rest]);
            let mut moved = match active.len() {
                0 => Moved::default(),
                _ => Move { active, sample, weights: w, common, by_rest }.find(arch),
            };
            let [mut far, mut fast] = moved.changes;
            let mut sums = Sums::default();
            for (vertex, late) in &self.own {
                let [x, u] = late[sample - 1];
                let known = self.own_before.iter().find(|(before, _)| before == vertex);
                let [x_before, u_before] = known.map_or([DVec3::ZERO; 2], |(_, late)| late[sample - 1]);
                far = larger(far, (x - x_before).length_squared());
                fast = larger(fast, (u - u_before).length_squared());
                let (vertex, active) = (*vertex as usize, &mut self.active);
                let (m, before) = (active.mass(vertex), [active.x(sample, vertex), active.u(sample, vertex)]);
                active.shift(sample, vertex, x, u);
                let (after, l) = ([before[0] + x, before[1] + u], m * active.rest(vertex));
                sums.lx += outer(l, x);
                sums.lu += outer(l, u);
                sums.xx += outer(m * x, after[0]) + outer(m * before[0], x);
                sums.xu += m * (x.cross(after[1]) + before[0].cross(u));
                sums.x += m * x;
                sums.u += m * u;
                moved.largest = [0, 1].map(|k| larger(moved.largest[k], after[k].length_squared()));
            }
            change = larger(larger(change, far.sqrt()), swing * fast.sqrt());
            if body.turns() || (sample == 3 && body.is_free()) {
                let linear = |q: &Scaled, w: &[f64; 4]| {
                    let (by_l, sum) = self.first.linear_sums(q);
                    let [a, b, c, d, _] = &self.gathered;
                    let by_force = combine_matrices(w, [a.by_rest, b.by_rest, c.by_rest, d.by_rest]);
                    (by_l + by_force, sum + combine(w, [a.force, b.force, c.force, d.force]))
                };
                if self.active.len() > 0 {
                    let ((lx, mean_x), (lu, mean_u)) = (linear(&x, &w.x), linear(&u, &w.u));
                    self.sums[sample] = Sums { lx, lu, xx: moved.xx, xu: moved.xu, x: mean_x, u: mean_u } + sums;
                }
                self.frames[sample].sums = self.sums[sample];
                if are_others {
                    let sums =
                        if is_coupled { self.moments.sums(&others[0], &others[1]) } else { self.moments.sums(&x, &u) };
                    self.frames[sample].sums = sums + self.sums[sample];
                }
            }
            let [mut far, mut fast] = moved.largest.map(f64::sqrt);
            if is_coupled {
                // the smaller of two bounds of the others
                let ([x, u], [x0, u0], maxima) = (&others, &self.others[0], &self.maxima);
                far = larger(far, x.bound(maxima).min(maxima.x + x.difference(x0, maxima)));
                fast = larger(fast, u.bound(maxima).min(maxima.u + u.difference(u0, maxima)));
            } else if are_others {
                let maxima = &self.maxima;
                let way_x = (w.xx - 1.0).abs() * maxima.x + w.xu.abs() * maxima.u;
                let way_u = w.ux.abs() * maxima.x + (w.uu - 1.0).abs() * maxima.u;
                far = larger(far, x.bound(maxima, maxima.x, way_x));
                fast = larger(fast, u.bound(maxima, maxima.u, way_u));
            }
            let frame = &mut self.frames[sample];
            (frame.extent, frame.speed) = (body.shape.extent + far, fast);
        }
        if body.turns() {
            change = larger(change, self.turn(body, ballistic, samples.clone()));
        } else {
            for sample in samples.clone() {
                self.frames[sample].rotation = body.rotation;
                self.orient(body, sample);
            }
        }
        for sample in samples {
            self.place(arch, sample);
        }
        change
    }

    /// Corrects the rotations at samples for the frame's angular velocities, which depend on them. Returns the largest
    /// displacement of a rest position by this [scene unit].
    fn turn(&mut self, body: &Body, ballistic: &[Dense], samples: std::ops::Range<usize>) -> f64 {
        let rates: [DVec3; 4] =
            std::array::from_fn(|node| rotation_vector_rate(self.frames[node].turned, self.frames[node].frame_spin));
        let mut moved = 0.0;
        for sample in samples {
            let turned = combine(&ballistic[sample - 1].u, rates) + self.late[sample - 1].turned;
            let frame = &mut self.frames[sample];
            moved = larger(moved, (turned - frame.turned).length() * body.shape.extent);
            frame.turned = turned;
            frame.rotation = rotation_by(turned) * body.rotation;
            self.orient(body, sample);
        }
        moved
    }

    /// Places the active vertices at a sample.
    fn place(&mut self, arch: Arch, sample: usize) {
        if self.active.len() == 0 {
            return;
        }
        PlaceAll { active: &mut self.active, sample, axes: self.frames[sample].axes }.find(arch);
    }

    /// Sums the forces on the active vertices at a sample, then adds the part of the damping that is not in −2κ x′.
    pub fn gather(&mut self, arch: Arch, body: &Body, sample: usize) {
        if !body.is_free() {
            return;
        }
        let frame = &mut self.frames[sample];
        let twice_damped = 2.0 * body.oscillator.damping * frame.spin;
        if self.active.len() > 0 {
            let mut gathered = Gather { active: &mut self.active, sample, turning: twice_damped }.find(arch);
            let Gathered { force, by_rest, spinning } = gathered;
            (frame.mean, frame.turning, frame.spinning) = (force / body.mass(), moment(frame.axes * by_rest), spinning);
            let damping = cross_matrix(twice_damped);
            gathered.force += damping * self.sums[sample].x;
            gathered.by_rest += self.sums[sample].lx * damping.transpose();
            self.gathered[sample] = gathered;
        }
        if body.turns() && body.oscillator.damping != 0.0 {
            self.coupling[sample] = self.others[sample][0].crossed(twice_damped);
        }
    }

    /// Updates the quantities that depend on the rotation at a sample.
    fn orient(&mut self, body: &Body, sample: usize) {
        let frame = &mut self.frames[sample];
        frame.axes = DMat3::from_quat(frame.rotation);
        frame.inner = frame.sums.inner(&body.shape, frame.axes);
        if body.turns() {
            frame.frame_spin = frame.inner.frame_spin(frame.momentum);
            frame.spin = frame.inner.spin(frame.momentum);
        }
    }

    /// Updates the body at a sample for the forces on its vertices and for `reaction`, the force on its sphere.
    pub fn drive(&mut self, body: &Body, sample: usize, free_fall: DVec3, reaction: DVec3, place: &Place, span: &Span) {
        let mass = body.mass();
        let frame = &mut self.frames[sample];
        if !body.is_free() {
            frame.common = self.driven[sample].uniform;
            return;
        }
        frame.acceleration = frame.mean + (free_fall + reaction / mass);
        frame.torque = frame.spinning + span.arm(place.centre).cross(mass * frame.acceleration);
        frame.common = -frame.mean;
        if body.turns() {
            let Frame { inner, turning, spin, frame_spin, .. } = *frame;
            let damping = body.oscillator.damping;
            let rate = inner.frame_spin_rate(turning, damping, spin, frame_spin);
            frame.drive = frame_drive(frame.axes, damping, spin, frame_spin, rate);
        }
    }

    /// Computes the effects of pieces at these samples.
    fn add_pieces(&mut self, body: &Body, span: &Span, samples: std::ops::Range<usize>) {
        std::mem::swap(&mut self.own, &mut self.own_before);
        self.late[samples.start - 1..samples.end - 1].fill(LateSum::default());
        self.own.clear();
        if self.pieces.is_empty() && self.splits.is_empty() {
            return;
        }
        // the angular velocity of the frame by pieces, at the nodes
        let mut rates = [DVec3::ZERO; 4];
        for piece in self.pieces.iter().filter(|_| body.turns()) {
            for (rate, node) in rates.iter_mut().zip(NODES).skip(1) {
                *rate += piece.effect_at(node).frame_spin;
            }
        }
        for sample in samples.clone() {
            let theta = span.theta(sample);
            let late = &mut self.late[sample - 1];
            for piece in &self.pieces {
                let effect = piece.effect_at(theta);
                late.centre += effect.centre;
                late.velocity += effect.velocity;
                late.momentum += effect.momentum;
                late.turned += effect.turned;
            }
            late.turned -= combine(&span.ballistic[sample - 1].u, rates);
        }
        for split in &self.splits {
            let mut own = [[DVec3::ZERO; 2]; 4];
            for sample in samples.clone() {
                let deviation = split.at(body, span.h, span.theta(sample));
                own[sample - 1] = deviation.own();
                if !body.is_free() {
                    continue;
                }
                let [x, u] = own[sample - 1];
                let share = self.active.mass(split.vertex as usize) / body.mass();
                let late = &mut self.late[sample - 1];
                late.x -= share * x;
                late.u -= share * u;
                let [x, u] = deviation.by_rest();
                late.x_by_rest += x;
                late.u_by_rest += u;
            }
            self.own.push((split.vertex, own));
        }
    }

    /// The motion of the body since the start of the step.
    pub fn motion(&self, span: &Span, places: &[Place; 5]) -> Motion {
        let [_, a, b, c, _] = self.moved;
        let centre = Curve::new(&[a, b, c], &[0, 1, 2, 3].map(|node| span.h * places[node].velocity));
        let turned = [1, 2, 3].map(|node| {
            let turn = rotation_by(self.frames[node].turned);
            let across = cross_matrix(DVec3::new(turn.x, turn.y, turn.z));
            (across * turn.w + across * across) * 2.0
        });
        Motion { centre, turned }
    }

    /// `[i][j]`: response at node 1 + i, in x [s²] and in u [s], to an acceleration of a vertex at node 1 + j.
    pub fn responses(&self) -> [[(f64, f64); 3]; 3] {
        std::array::from_fn(|i| std::array::from_fn(|j| (self.weights[i].x[j + 1], self.weights[i].u[j + 1])))
    }

    /// Moves the sample [`MIDDLE`] to midpoint `k`; the first one begins the estimate of errors.
    pub fn sample_midpoint(
        &mut self,
        index: usize,
        body: &Body,
        span: &Span,
        k: usize,
        paths: &dyn Paths,
        places: &mut [Place; 5],
    ) {
        if k == 0 {
            self.errors = Errors::default();
            self.active.clear_errors();
            self.residual = residual(body.oscillator, span.h);
            self.residual_ballistic = residual(BALLISTIC, span.h);
        }
        self.weights[MIDDLE - 1] = Dense::new(body.oscillator, span.h, span.midpoint);
        if !body.is_free() {
            let t = span.time(MIDDLE);
            self.driven[MIDDLE] = paths.at(index, t, false);
            places[MIDDLE] = self.driven[MIDDLE].place;
        }
    }

    /// Adds the effects of the residuals at midpoint `k` to the errors.
    pub fn add_residuals(&mut self, arch: Arch, span: &Span, k: usize) {
        let w = cubic(span.midpoint);
        let nodes: [&Frame; 4] = std::array::from_fn(|node| &self.frames[node]);
        let middle = &self.frames[MIDDLE];
        let acceleration = middle.acceleration - combine(&w, nodes.map(|f| f.acceleration));
        let torque = middle.torque - combine(&w, nodes.map(|f| f.torque));
        let common = middle.common - combine(&w, nodes.map(|f| f.common));
        let drive = middle.drive - combine_matrices(&w, nodes.map(|f| f.drive));
        let mut others = self.coupling[MIDDLE];
        for node in 0..4 {
            others.add_times(-w[node], &self.coupling[node]);
        }
        others.shift += common;
        others.by_rest += drive;
        let effect = self.residual[k];
        self.errors.x.add_times(effect.0, &others);
        self.errors.u.add_times(effect.1, &others);
        AddResidual { active: &mut self.active, weights: w, common, by_rest: drive, effect }.find(arch);
        let (centre, velocity) = self.residual_ballistic[k];
        self.errors.centre += centre * acceleration;
        self.errors.velocity += velocity * acceleration;
        self.errors.momentum += velocity * torque;
        let spin = middle.frame_spin - combine(&w, nodes.map(|f| f.frame_spin));
        self.errors.turn += velocity * spin;
    }

    /// The estimated error of the step for this body [scene unit].
    pub fn error(&self, arch: Arch, body: &Body, field: &Field) -> f64 {
        let planes = self.held.iter().map(|held| (held.contact, held.vertex));
        let split = self.splits.iter().flat_map(|split| {
            let touches = split.legs().iter().flat_map(|leg| &leg.touches);
            touches.filter_map(|touch| match touch.by {
                By::Plane(plane) => Some((plane, split.vertex)),
                _ => None,
            })
        });
        let (mut contact, mut touching) = (0.0, 0.0);
        for (plane, vertex) in planes.chain(split) {
            contact = larger(contact, field.planes[plane as usize].stiffness);
            touching += self.active.mass(vertex as usize);
        }
        let touching = f64::min(touching, body.mass());
        let Errors { x, u, centre, velocity, momentum, turn, split, split_all } = self.errors;
        let swing = 1.0 / body.oscillator.omega.max(2.0 * body.oscillator.damping).max(1.0);
        let [far, fast] = LargestErrors(&self.active).find(arch).map(f64::sqrt);
        let gain = 1.0 + swing * contact.sqrt();
        let vertex = gain * larger(far, x.bound(&self.maxima)) + swing * larger(fast, u.bound(&self.maxima));
        let mut error = larger(vertex, gain * split.0 + swing * split.1) + velocity.length();
        error += centre.length() * (1.0 + (contact * touching / body.mass()).sqrt());
        error += split_all;
        if body.turns() {
            let spin = solve(resistance(self.frames[3].inner.as_), momentum);
            error += (turn.length() + spin.length()) * body.shape.extent;
        }
        error
    }

    /// Commits the end of the step as the body's state, and fits the frame to the vertices without moving them. Returns
    /// the largest displacement and velocity.
    pub fn end(&mut self, arch: Arch, body: &mut Body, places: &[Place; 5]) -> Maxima {
        let frame = &self.frames[3];
        (body.centre, body.velocity) = (places[3].centre, places[3].velocity);
        (body.rotation, body.spin) = (frame.rotation, frame.momentum);
        let mut others = self.others[3];
        let mut fit = [Linear::default(); 2];
        if body.is_free() {
            (fit, body.rotation) = body.refit(&frame.sums);
            others.iter_mut().zip(&fit).for_each(|(others, fit)| others.add_times(1.0, fit));
        }
        let [x, u] = &others;
        Finish { start: &mut self.start, rest: &body.shape.lanes, x, u }.find(arch);
        for (place, &vertex) in self.active.vertices.iter().enumerate() {
            let (vertex, l) = (vertex as usize, self.active.rest(place));
            let x = self.active.x(3, place) + (fit[0].by_rest * l + fit[0].shift);
            let u = self.active.u(3, place) + (fit[1].by_rest * l + fit[1].shift);
            kernels::replace(&mut self.start.x, vertex, x);
            kernels::replace(&mut self.start.u, vertex, u);
        }
        let maxima = [(&mut body.x, &mut self.start.x), (&mut body.u, &mut self.start.u)].map(|(into, from)| {
            // padding lanes do not count
            (into.len()..WIDTH * from.len()).for_each(|i| kernels::replace(from, i, DVec3::ZERO));
            kernels::by_vertex(from, into);
            kernels::largest_square(arch, from).sqrt()
        });
        let [x, u] = maxima;
        Maxima { x, u, rest: body.shape.extent }
    }
}

/// Estimated errors at the end of a step, as far as all vertices share them.
#[derive(Clone, Copy, Debug, Default)]
pub struct Errors {
    x: Linear,
    u: Linear,
    centre: DVec3,
    velocity: DVec3,
    momentum: DVec3,
    /// Rotation of the frame [rad].
    turn: DVec3,
    /// The largest of x and of u of a vertex that is advanced alone.
    split: (f64, f64),
    /// Σ m/M of these errors: of the centre, and of its velocity in a second.
    split_all: f64,
}

impl Errors {
    /// Adds the error of a vertex that is advanced alone, with `share` of the body's mass.
    pub fn add_split(&mut self, [x, u]: [f64; 2], share: f64) {
        self.split = (larger(self.split.0, x), larger(self.split.1, u));
        self.add_reaction([x, u], share);
    }

    /// Adds the error of a force on a sphere of the body, with the ratio of the vertex's mass to the body's.
    pub fn add_reaction(&mut self, [x, u]: [f64; 2], share: f64) {
        self.split_all += share * (x + u);
    }
}
