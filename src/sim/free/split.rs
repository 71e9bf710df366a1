//! Vertices on which a contact begins or ceases to act within a step.
//!
//! Such a vertex crosses the rim of a sphere or a plane, or turns towards or away from a push, and the force on it has a
//! kink. It is advanced alone, over the legs between these instants and the nodes of the step: by the same exponential
//! collocation, but only as far as its contacts deviate it from the motion that it shares with the other vertices. On
//! each leg its force is smooth. What the force does to the body and to the owner of the sphere is integrated over the
//! legs as well.

use glam::{DMat3, DVec3};
use smallvec::SmallVec;

use super::{
    body::Body,
    field::{Field, Paths},
    force::{Acting, Contact, Seen, Sphere, View, influence, see},
    step::{Course, Place, Span},
};
use crate::{
    model::{
        influence::Weight,
        oscillator::Oscillator,
        shape_matching::{Plane, cross_matrix, resistance, solve},
    },
    sim::numerics::{
        bernstein::{Crossings, Curve},
        control::{MAX_CORRECTIONS, NEGLIGIBLE, RESIDUAL, RESIDUAL_AT_ONCE, STANDING},
        dense::Dense,
        lagrange::{CubicIntegrals, combine, combine_matrices, cubic},
        nodes::NODES,
    },
};

/// Initial capacity for legs: a vertex hardly ever has more, so later steps do not allocate.
const MOST_LEGS: usize = 8;

/// A contact that acts on a split vertex, over a leg.
#[derive(Clone, Copy, Debug)]
pub struct Touch {
    pub by: By,
    /// Acceleration of the vertex at the nodes of the leg [scene unit/s²].
    pub g: [DVec3; 4],
    /// Velocity of the vertex at the nodes of the leg [scene unit/s].
    pub velocity: [DVec3; 4],
    /// The centre of the sphere at the nodes of the leg.
    pub source: [Place; 4],
}

/// What a contact is with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum By {
    /// The sphere of this body.
    Sphere(u32),
    /// The plane of this index.
    Plane(u32),
    /// The push of this index.
    Push(u32),
}

/// A part of a step in which no contact of a vertex begins or ends.
#[derive(Clone, Debug, Default)]
pub struct Leg {
    /// Start, as a fraction of the step.
    pub from: f64,
    /// End, as a fraction of the step.
    pub to: f64,
    pub touches: SmallVec<[Touch; 1]>,
    /// What the contacts do to the body.
    pub piece: Piece,
    start: Deviation,
    /// What drives each column of the deviation, at the nodes of the leg.
    drive: [[DVec3; 4]; 4],
    /// Response from the start of the leg to its nodes after the first; without contacts to its end alone.
    weights: [Dense; 3],
}

/// How a contact deviates its vertex, in the first column, and how the rotation that it causes deviates all vertices
/// per rest position, in the others.
#[derive(Clone, Copy, Debug, Default)]
pub struct Deviation {
    x: [DVec3; 4],
    u: [DVec3; 4],
}

/// A vertex that is advanced alone.
#[derive(Clone, Debug, Default)]
pub struct Split {
    /// Its index among the active vertices.
    pub vertex: u32,
    passages: Passages,
    /// The first ones are in use.
    legs: Vec<Leg>,
    used: usize,
    end: Deviation,
}

/// A force that acts on a body over a leg.
#[derive(Clone, Copy, Debug, Default)]
pub struct Piece {
    /// Start, as a fraction of the step.
    pub from: f64,
    /// End, as a fraction of the step.
    pub to: f64,
    /// Length of the step [s].
    h: f64,
    /// Contribution to the acceleration of the centre, at the nodes of the leg [scene unit/s²].
    acceleration: [DVec3; 4],
    /// Contribution to the torque about [`Span::origin`], at the nodes of the leg.
    torque: [DVec3; 4],
    /// Contribution to Ω_Q′, at the nodes of the leg [rad/s²].
    turn: [DVec3; 4],
    /// What it has caused at its end.
    end: Effect,
}

/// What a force has caused by an instant.
#[derive(Clone, Copy, Debug, Default)]
pub struct Effect {
    pub centre: DVec3,
    pub velocity: DVec3,
    pub momentum: DVec3,
    /// Of Ω_Q [rad/s].
    pub frame_spin: DVec3,
    /// Of the rotation vector of the frame [rad].
    pub turned: DVec3,
}

impl Piece {
    /// A force from `from` to `to`, in a step of length `h` [s].
    pub fn new([from, to]: [f64; 2], h: f64, acceleration: [DVec3; 4], torque: [DVec3; 4], turn: [DVec3; 4]) -> Piece {
        let mut piece = Piece { from, to, h, acceleration, torque, turn, end: Effect::default() };
        piece.end = piece.effect(CubicIntegrals::whole());
        piece
    }

    fn effect(&self, up_to: &CubicIntegrals) -> Effect {
        let CubicIntegrals { once, twice } = up_to;
        let t = (self.to - self.from) * self.h;
        Effect {
            centre: t * t * combine(twice, self.acceleration),
            velocity: t * combine(once, self.acceleration),
            momentum: t * combine(once, self.torque),
            frame_spin: t * combine(once, self.turn),
            turned: t * t * combine(twice, self.turn),
        }
    }

    /// What it has caused by `theta`.
    pub fn effect_at(&self, theta: f64) -> Effect {
        if theta <= self.from {
            return Effect::default();
        }
        if theta < self.to {
            return self.effect(&CubicIntegrals::up_to((theta - self.from) / (self.to - self.from)));
        }
        let (end, since) = (&self.end, (theta - self.to) * self.h);
        Effect { centre: end.centre + since * end.velocity, turned: end.turned + since * end.frame_spin, ..*end }
    }
}

/// The motion of a body with vertices since the start of a step, without noise: not differences of states.
#[derive(Clone, Debug)]
pub struct Motion {
    /// Of the centre [scene unit].
    pub centre: Curve,
    /// Q − Q₀ times the inverse of Q₀ at the nodes after the first.
    pub turned: [DMat3; 3],
}

/// The centres of all bodies, at any instant of a step.
pub struct Around<'a> {
    pub bodies: &'a [Body],
    pub field: &'a Field,
    pub span: &'a Span,
    pub paths: &'a dyn Paths,
    pub motions: &'a [Motion],
    /// The places of the bodies with vertices at the samples.
    pub places: &'a [[Place; 5]],
    /// Displacements of a body of radius 1 below this count as converged [scene unit].
    pub small_correction: f64,
}

impl Around<'_> {
    /// The centre of a body.
    fn place(&self, body: usize, theta: f64) -> Place {
        if self.bodies[body].is_free() {
            let (moved, rate) = self.motions[body].centre.at(theta);
            return Place { centre: self.places[body][0].centre + moved, velocity: rate / self.span.h };
        }
        self.paths.at(body, self.span.start + theta * self.span.h, theta >= 1.0).place
    }
}

/// A split vertex in its surroundings: its motion without its contacts.
struct Undisturbed<'a> {
    index: usize,
    body: &'a Body,
    course: &'a Course,
    around: &'a Around<'a>,
    mass: f64,
    /// Rest position in the axes of the start, Q₀ l [scene unit], and its motion by the rotation of the frame.
    rest: DVec3,
    turned: Option<Curve>,
    /// Displacement and velocity at the start of the step.
    start: [DVec3; 2],
    /// What drives the displacement at the nodes of the step [scene unit/s²].
    drive: [DVec3; 4],
    /// The effect of the contacts of split vertices on all vertices.
    late: Option<Curve>,
    /// In the first sweep: the displacement with contacts, roughly.
    rough: Option<Curve>,
}

/// The state of a vertex without its contacts, at an instant.
#[derive(Clone, Copy, Default)]
struct State {
    /// a = Q l and its rate.
    rest: [DVec3; 2],
    place: Place,
    x: DVec3,
    u: DVec3,
}

impl State {
    /// The vertex with a deviation.
    fn seen(&self, [x, u]: [DVec3; 2]) -> Seen {
        let [a, rate] = self.rest;
        Seen { a, s: a + (self.x + x), rate: rate + (self.u + u), place: self.place, turning: DVec3::ZERO }
    }
}

impl<'a> Undisturbed<'a> {
    fn new(index: usize, vertex: usize, course: &'a Course, around: &'a Around<'a>, is_first: bool) -> Undisturbed<'a> {
        let Course { active, frames, late, .. } = course;
        let (body, h) = (&around.bodies[index], around.span.h);
        let l = active.rest(vertex);
        let rest = frames[0].axes * l;
        let turned = body.turns().then(|| {
            let moved = around.motions[index].turned.map(|turned| turned * rest);
            let rate = |node: usize, a: DVec3| h * frames[node].frame_spin.cross(a);
            let [a, b, c] = moved;
            Curve::new(&moved, &[rate(0, rest), rate(1, rest + a), rate(2, rest + b), rate(3, rest + c)])
        });
        let x: [DVec3; 4] = std::array::from_fn(|node| active.x(node, vertex));
        let twice_damped = if body.turns() { 2.0 * body.oscillator.damping } else { 0.0 };
        let drive = std::array::from_fn(|node| {
            let frame = &frames[node];
            twice_damped * frame.spin.cross(x[node]) + (frame.common + frame.drive * l)
        });
        let rough = is_first.then(|| {
            let u = std::array::from_fn(|node| h * active.u(node, vertex));
            Curve::new(&[1, 2, 3].map(|node| x[node] - x[0]), &u)
        });
        let is_late = !is_first && !course.pieces.is_empty();
        let late = is_late.then(|| {
            let [a, b, c, _] = late;
            let x = [a, b, c].map(|late| late.x + late.x_by_rest * l);
            let [a, b, c] = [a, b, c].map(|late| h * (late.u + late.u_by_rest * l));
            Curve::new(&x, &[DVec3::ZERO, a, b, c])
        });
        let (mass, start) = (active.mass(vertex), [x[0], active.u(0, vertex)]);
        Undisturbed { index, body, course, around, mass, rest, turned, start, drive, late, rough }
    }

    /// Displacement and velocity after the response `w` to the drive from an instant on.
    fn after(&self, [x, u]: [DVec3; 2], w: &Dense, drive: [DVec3; 4]) -> [DVec3; 2] {
        [w.xx * x + w.xu * u + combine(&w.x, drive), w.ux * x + w.uu * u + combine(&w.u, drive)]
    }

    /// What drives the displacement at the nodes of a leg.
    fn drive_at(&self, theta: [f64; 4]) -> [DVec3; 4] {
        theta.map(|theta| combine(&cubic(theta), self.drive))
    }

    /// The state at `theta`, where the displacement and velocity without the effects of split vertices are `own`.
    fn at(&self, theta: f64, own: [DVec3; 2]) -> State {
        let h = self.around.span.h;
        let [mut x, mut u] = match &self.rough {
            Some(rough) => {
                let (x, rate) = rough.at(theta);
                [self.start[0] + x, rate / h]
            }
            None => own,
        };
        if let Some(late) = &self.late {
            let (more, rate) = late.at(theta);
            (x, u) = (x + more, u + rate / h);
        }
        let (moved, rate) = self.turned.as_ref().map_or_else(Default::default, |turned| turned.at(theta));
        State { rest: [self.rest + moved, rate / h], place: self.around.place(self.index, theta), x, u }
    }

    /// G⁻¹ `moment` [rad/s²] and the axes.
    fn turn(&self, theta: f64, moment: DVec3) -> (DVec3, DMat3) {
        let (w, frames) = (cubic(theta), &self.course.frames);
        let sums = combine_matrices(&w, std::array::from_fn(|node| frames[node].inner.as_));
        (solve(resistance(sums), moment), combine_matrices(&w, std::array::from_fn(|node| frames[node].axes)))
    }

    /// The acceleration of the vertex by a contact at `theta`.
    fn force(&self, by: By, theta: f64, acting: &Acting, seen: &Seen) -> DVec3 {
        let weight = self.around.field.weight;
        match by {
            By::Sphere(source) => match acting.spheres.iter().find(|sphere| sphere.source == source) {
                Some(sphere) => self.sphere(sphere, theta).acceleration(weight, seen),
                None => DVec3::ZERO,
            },
            By::Plane(n) => Contact::Plane(&self.around.field.planes[n as usize]).acceleration(weight, 0, seen),
            By::Push(n) => Contact::Push(&acting.pushes[n as usize]).acceleration(weight, 0, seen),
        }
    }

    fn sphere(&self, sphere: &Sphere, theta: f64) -> SphereAt {
        let (own, place) = (self.around.place(self.index, theta), self.around.place(sphere.source as usize, theta));
        SphereAt { place, radius: sphere.radius, strength: sphere.strength_at(own.centre.distance(place.centre)) }
    }
}

/// A sphere at an instant.
#[derive(Clone, Copy, Default)]
struct SphereAt {
    place: Place,
    radius: f64,
    strength: f64,
}

impl SphereAt {
    fn acceleration(&self, weight: Weight, seen: &Seen) -> DVec3 {
        influence((self.place.centre - seen.place.centre) - seen.s, weight, self.radius, self.strength)
    }
}

impl Deviation {
    /// The state after a leg: its free motion, and the response to what drives it at its nodes.
    fn after(&self, w: &Dense, drive: Option<&[[DVec3; 4]; 4]>, turns: bool) -> Deviation {
        let mut after = Deviation::default();
        for column in 0..if turns { 4 } else { 1 } {
            let (x, u) = (self.x[column], self.u[column]);
            (after.x[column], after.u[column]) = (w.xx * x + w.xu * u, w.ux * x + w.uu * u);
            if let Some(drive) = drive {
                after.x[column] += combine(&w.x, drive[column]);
                after.u[column] += combine(&w.u, drive[column]);
            }
        }
        after
    }

    /// The displacement and velocity of the split vertex.
    pub fn own(&self) -> [DVec3; 2] {
        [self.x[0], self.u[0]]
    }

    /// The displacement and velocity of all vertices per rest position.
    pub fn by_rest(&self) -> [DMat3; 2] {
        [&self.x, &self.u].map(|of| DMat3::from_cols(of[1], of[2], of[3]))
    }
}

/// When a contact acts on a vertex.
#[derive(Clone, Copy, Debug)]
pub struct Passage {
    by: By,
    starts_inside: bool,
    crossings: Crossings,
}

/// The contacts that act on a vertex at any time in a step.
pub type Passages = SmallVec<[Passage; 4]>;

/// Upper limit on the [load](Split::load) of an island, about 1 GB: a step in which more contacts begin and end is not taken. If shorter ones
/// are not possible either, the island takes steps of fixed length.
pub const MAX_LOAD: u64 = 1_000_000;

impl Passage {
    fn acts_at(&self, theta: f64) -> bool {
        let passed = self.crossings.as_slice().iter().filter(|&&at| at <= theta).count();
        self.starts_inside ^ (passed % 2 == 1)
    }
}

impl Split {
    /// Starts anew with another vertex.
    pub fn restart(self, vertex: u32) -> Split {
        Split { vertex, legs: self.legs, ..Split::default() }
    }

    /// Sets when contacts act on it.
    pub fn pass(&mut self, passages: Passages) {
        self.passages = passages;
    }

    /// Memory for its contacts [at most 1 kB]: a leg for each beginning and end, and in each the contacts.
    pub fn load(&self) -> u64 {
        /// A [`Leg`] without contacts.
        const LEG: u64 = 7;

        let ends: usize = self.passages.iter().map(|passage| passage.crossings.as_slice().len()).sum();
        (1 + ends as u64) * (LEG + self.passages.len() as u64)
    }

    /// The parts of the step, in order.
    pub fn legs(&self) -> &[Leg] {
        &self.legs[..self.used]
    }

    /// The deviation by contacts at `theta`.
    pub fn at(&self, body: &Body, h: f64, theta: f64) -> Deviation {
        let Some(leg) = self.legs().iter().find(|leg| theta < leg.to) else { return self.end };
        let is_undisturbed = leg.from == 0.0 && leg.touches.is_empty();
        if theta <= leg.from || is_undisturbed {
            return leg.start;
        }
        let length = leg.to - leg.from;
        let w = Dense::new(body.oscillator, length * h, (theta - leg.from) / length);
        leg.start.after(&w, (!leg.touches.is_empty()).then_some(&leg.drive), body.turns())
    }

    /// Advances the vertex over the step, around its motion without contacts as it is known.
    pub fn solve(&mut self, index: usize, course: &Course, acting: &Acting, around: &Around<'_>, is_first: bool) {
        let (oscillator, h) = (around.bodies[index].oscillator, around.span.h);
        let vertex = self.vertex as usize;
        let passages = std::mem::take(&mut self.passages);
        let mut ends: SmallVec<[f64; 8]> = SmallVec::from_slice(&[0.0, 1.0]);
        ends.extend(passages.iter().flat_map(|passage| passage.crossings.as_slice().iter().copied()));
        ends.sort_by(f64::total_cmp);
        let undisturbed = Undisturbed::new(index, vertex, course, around, is_first);
        let (mut deviation, mut own) = (Deviation::default(), undisturbed.start);
        let turns = around.bodies[index].turns();
        let mut from = 0.0;
        let mut used = 0;
        for &to in &ends {
            if to - from < STANDING {
                continue;
            }
            if used == self.legs.len() {
                if used == 0 {
                    self.legs.reserve_exact(MOST_LEGS);
                }
                self.legs.push(Leg::default());
            }
            let leg = &mut self.legs[used];
            let middle = 0.5 * (from + to);
            let acts: SmallVec<[By; 2]> = passages.iter().filter(|p| p.acts_at(middle)).map(|p| p.by).collect();
            let is_known = used < self.used && leg.touches.iter().map(|touch| touch.by).eq(acts.iter().copied());
            if !(is_known && [leg.from, leg.to] == [from, to]) {
                (leg.from, leg.to) = (from, to);
                for node in if acts.is_empty() { 3..4 } else { 1..4 } {
                    leg.weights[node - 1] = Dense::new(oscillator, (to - from) * h, NODES[node]);
                }
            }
            leg.start = deviation;
            let drive = undisturbed.drive_at(leg.nodes());
            if acts.is_empty() {
                leg.touches.clear();
            } else {
                let nodes = leg.weights.each_ref().map(|w| undisturbed.after(own, w, drive));
                leg.collocate(&undisturbed, acting, &acts, is_known, [own, nodes[0], nodes[1], nodes[2]]);
            }
            deviation = deviation.after(&leg.weights[2], (!acts.is_empty()).then_some(&leg.drive), turns);
            own = undisturbed.after(own, &leg.weights[2], drive);
            from = to;
            used += 1;
        }
        (self.used, self.end, self.passages) = (used, deviation, passages);
    }

    /// Estimated errors of the displacement [scene unit] and of the velocity [scene unit/s] of the vertex at the end of
    /// the step, from the residuals in the middle of its legs. Calls `react` with the owner of each sphere and the errors
    /// that act on it.
    pub fn error(
        &self,
        index: usize,
        course: &Course,
        acting: &Acting,
        around: &Around<'_>,
        mut react: impl FnMut(u32, [f64; 2]),
    ) -> [f64; 2] {
        let (oscillator, h) = (around.bodies[index].oscillator, around.span.h);
        let undisturbed = Undisturbed::new(index, self.vertex as usize, course, around, false);
        let (mut x, mut u) = (0.0, 0.0);
        let mut before: &[Touch] = &[];
        for leg in self.legs() {
            let length = leg.to - leg.from;
            let theta = leg.from + 0.5 * length;
            if leg.touches.is_empty() {
                before = &leg.touches;
                continue;
            }
            let w = Dense::new(oscillator, length * h, 0.5);
            let own = undisturbed.after(undisturbed.start, &Dense::new(oscillator, h, theta), undisturbed.drive);
            let state = undisturbed.at(theta, own);
            let seen = state.seen(leg.start.after(&w, Some(&leg.drive), false).own());
            let lasting = (1.0 - theta) * h;
            let mut residual = DVec3::ZERO;
            for touch in &leg.touches {
                let off = undisturbed.force(touch.by, theta, acting, &seen) - combine(&cubic(0.5), touch.g);
                residual += off;
                let mut begun = 0.0;
                // a contact begins where its force vanishes
                if leg.from > 0.0 && !before.iter().any(|before| before.by == touch.by) {
                    let start = touch.g[0].length();
                    let slope = (touch.g[1] - touch.g[0]).length() / (NODES[1] * length * h);
                    if slope > 0.0 {
                        begun = 0.5 * start * f64::min(start / slope, length * h);
                        u += begun;
                        x += begun * (1.0 - leg.from) * h;
                    }
                }
                if let By::Sphere(source) = touch.by {
                    let by_residual = RESIDUAL_AT_ONCE * length * h * off.length();
                    react(source, [by_residual * lasting + begun * (1.0 - leg.from) * h, by_residual + begun]);
                }
            }
            let by_residual = RESIDUAL * length * h * residual.length();
            u += by_residual;
            x += by_residual * lasting;
            before = &leg.touches;
        }
        [x, u]
    }
}

/// The contacts that act on a vertex at any time in a step of length `h` [s]; `None` if none begins or ceases to act.
pub fn passages(vertex: usize, course: &Course, acting: &Acting, view: &View<'_>) -> Option<Passages> {
    let View { field, span, places, .. } = *view;
    let seen: [Seen; 4] = std::array::from_fn(|sample| see(course, places, sample, vertex));
    let spheres = acting.spheres.iter().map(|sphere| (Contact::Sphere(sphere), By::Sphere(sphere.source)));
    let planes = (0..).zip(&field.planes).map(|(n, plane)| (Contact::Plane(plane), By::Plane(n)));
    let pushes = (0..).zip(&acting.pushes).map(|(n, push)| (Contact::Push(push), By::Push(n)));
    let mut passages = Passages::new();
    let mut any = false;
    for (contact, by) in spheres.chain(planes).chain(pushes) {
        let (starts_inside, crossings) = contact.passage(field.weight, span.h, &seen);
        any |= !crossings.as_slice().is_empty();
        if starts_inside || !crossings.as_slice().is_empty() {
            passages.push(Passage { by, starts_inside, crossings });
        }
    }
    any.then_some(passages)
}

impl Leg {
    /// Its nodes, as fractions of the step.
    fn nodes(&self) -> [f64; 4] {
        NODES.map(|node| self.from + (self.to - self.from) * node)
    }

    /// Finds the forces on the vertex at the nodes of the leg, and what follows from them. `own`: displacement and
    /// velocity there without the effects of split vertices.
    fn collocate(
        &mut self,
        undisturbed: &Undisturbed<'_>,
        acting: &Acting,
        acts: &[By],
        is_known: bool,
        own: [[DVec3; 2]; 4],
    ) {
        let Undisturbed { body, course, around, .. } = *undisturbed;
        let (field, h) = (around.field, around.span.h);
        let length = (self.to - self.from) * h;
        let theta = self.nodes();
        let states: [State; 4] = std::array::from_fn(|n| undisturbed.at(theta[n], own[n]));
        let sphere = |&by: &By| match by {
            By::Sphere(source) => {
                acting.spheres.iter().find(|sphere| sphere.source == source).map_or_else(Default::default, |sphere| {
                    std::array::from_fn(|n| {
                        let place = around.place(source as usize, theta[n]);
                        let strength = sphere.strength_at(states[n].place.centre.distance(place.centre));
                        SphereAt { place, radius: sphere.radius, strength }
                    })
                })
            }
            _ => [SphereAt::default(); 4],
        };
        let spheres: SmallVec<[[SphereAt; 4]; 2]> = acts.iter().map(sphere).collect();
        let force = |c: usize, n: usize, seen: &Seen| match acts[c] {
            By::Sphere(_) => spheres[c][n].acceleration(field.weight, seen),
            by => undisturbed.force(by, theta[n], acting, seen),
        };
        if !is_known {
            let touch = |&by: &By| Touch {
                by,
                g: Default::default(),
                velocity: Default::default(),
                source: Default::default(),
            };
            self.touches.clear();
            self.touches.extend(acts.iter().map(touch));
        }
        let small_correction = NEGLIGIBLE * around.small_correction * course.smallest_radius;
        // effect of a change of force on the displacement, now or after the oscillator has turned the velocity into one
        let Oscillator { omega, damping } = body.oscillator;
        let gain = length / omega.max(2.0 * damping).max(1.0);
        let responses: [[(f64, f64); 3]; 3] =
            std::array::from_fn(|i| std::array::from_fn(|j| (self.weights[i].x[j + 1], self.weights[i].u[j + 1])));
        let is_rough = undisturbed.rough.is_some(); // it includes the contacts
        let [x0, u0] = self.start.own();
        let mut all = states.map(|state| state.seen(Default::default()));
        for correction in 0..MAX_CORRECTIONS {
            if !is_rough {
                let sum: [DVec3; 4] = std::array::from_fn(|n| self.touches.iter().map(|touch| touch.g[n]).sum());
                all[0] = states[0].seen([x0, u0]);
                for (n, w) in (1..4).zip(&self.weights) {
                    let x = w.xx * x0 + w.xu * u0 + combine(&w.x, sum);
                    let u = w.ux * x0 + w.uu * u0 + combine(&w.u, sum);
                    all[n] = states[n].seen([x, u]);
                }
            }
            let mut change: f64 = 0.0;
            for (c, touch) in self.touches.iter_mut().enumerate() {
                let mut found: [DVec3; 4] = std::array::from_fn(|n| force(c, n, &all[n]));
                if let By::Plane(n) = touch.by
                    && !is_rough
                    && (correction > 0 || is_known)
                {
                    found = hold(&field.planes[n as usize], &touch.g, &found, &all, &responses);
                }
                for n in 0..4 {
                    change = change.max((found[n] - touch.g[n]).length());
                }
                touch.g = found;
            }
            if is_rough || !(change * gain > small_correction) {
                break;
            }
        }
        for (touch, sphere) in self.touches.iter_mut().zip(&spheres) {
            touch.velocity = all.map(|seen| seen.place.velocity + seen.rate);
            touch.source = sphere.map(|sphere| sphere.place);
        }
        let sum: [DVec3; 4] = std::array::from_fn(|n| self.touches.iter().map(|touch| touch.g[n]).sum());
        self.drive[0] = sum;
        let mass = undisturbed.mass;
        let acceleration = sum.map(|sum| mass / body.mass() * sum);
        let torque = std::array::from_fn(|n| (around.span.arm(all[n].place.centre) + all[n].s).cross(mass * sum[n]));
        let mut turn = [DVec3::ZERO; 4];
        if body.turns() {
            for n in 0..4 {
                let (rate, axes) = undisturbed.turn(theta[n], all[n].a.cross(mass * sum[n]));
                let spread = cross_matrix(-rate) * axes;
                turn[n] = rate;
                for (column, of) in [spread.x_axis, spread.y_axis, spread.z_axis].into_iter().enumerate() {
                    self.drive[column + 1][n] = of;
                }
            }
        }
        self.piece = Piece::new([self.from, self.to], h, acceleration, torque, turn);
    }
}

/// The force of a plane on a vertex at the nodes depends on the displacement that it causes. Returns the result of one
/// Newton step from the guess `before`, which led to `found`: for a stiff plane or sharp friction, plain iteration
/// diverges. A force acts mostly on its own vertex; its effect on others is left to the sweeps.
///
/// `responses[i][j]`: response at node 1 + i, in x [s²] and in u [s], to an acceleration of the vertex at node 1 + j.
pub fn hold(
    plane: &Plane,
    before: &[DVec3; 4],
    found: &[DVec3; 4],
    seen: &[Seen; 4],
    responses: &[[(f64, f64); 3]; 3],
) -> [DVec3; 4] {
    // (1 − J W) change = found − before, at the nodes after the first. The pressure depends on the motion along the normal
    // alone, which friction does not change: three equations for the one, then six for the other.
    let normal = plane.normal;
    let sides: [DVec3; 2] = normal.any_orthonormal_pair().into();
    let residual: [DVec3; 3] = std::array::from_fn(|i| found[i + 1] - before[i + 1]);
    let derivatives: [(DMat3, DMat3); 3] = std::array::from_fn(|i| {
        let at = &seen[i + 1];
        plane.derivatives(plane.depth(at.place.centre + at.s), at.place.velocity + at.rate)
    });
    let by_depth = derivatives.map(|(by_position, _)| by_position * normal);
    let one = |i: usize, j: usize| if i == j { 1.0 } else { 0.0 };
    let pressing =
        std::array::from_fn(|i| std::array::from_fn(|j| one(i, j) - normal.dot(by_depth[i]) * responses[i][j].0));
    let pressure = solve_equations(pressing, residual.map(|residual| normal.dot(residual)));
    let pressed: [f64; 3] = std::array::from_fn(|i| (0..3).map(|j| responses[i][j].0 * pressure[j]).sum());
    let rest: [DVec3; 3] = std::array::from_fn(|i| residual[i] + pressed[i] * by_depth[i]);
    let mut aside: [f64; 6] = std::array::from_fn(|row| sides[row % 2].dot(rest[row / 2]));
    if plane.friction != 0.0 {
        let by_slide = derivatives.map(|(_, by_velocity)| sides.map(|side| by_velocity * side));
        let sliding = std::array::from_fn(|row| {
            std::array::from_fn(|column| {
                let by_side = sides[row % 2].dot(by_slide[row / 2][column % 2]);
                one(row, column) - by_side * responses[row / 2][column / 2].1
            })
        });
        aside = solve_equations(sliding, aside);
    }
    std::array::from_fn(|node| match node {
        0 => found[0],
        node => {
            let [a, b] = [2 * node - 2, 2 * node - 1].map(|row| aside[row]);
            before[node] + (pressure[node - 1] * normal + (a * sides[0] + b * sides[1]))
        }
    })
}

/// Solves linear equations (Gaussian elimination with pivoting).
#[inline]
fn solve_equations<const N: usize>(mut a: [[f64; N]; N], mut b: [f64; N]) -> [f64; N] {
    for p in 0..N {
        let pivot = (p + 1..N).fold(p, |best, i| if a[i][p].abs() > a[best][p].abs() { i } else { best });
        if pivot != p {
            a.swap(p, pivot);
            b.swap(p, pivot);
        }
        let (above, below) = a.split_at_mut(p + 1);
        let (row, known) = (&above[p], b[p]);
        let scale = 1.0 / row[p];
        for (other, right) in below.iter_mut().zip(&mut b[p + 1..]) {
            let factor = other[p] * scale;
            for column in p + 1..N {
                other[column] -= factor * row[column];
            }
            *right -= factor * known;
        }
    }
    for p in (0..N).rev() {
        let known: f64 = (p + 1..N).map(|column| a[p][column] * b[column]).sum();
        b[p] = (b[p] - known) / a[p][p];
    }
    b
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    /// The change solves the equations of all nine components: (1 − J W) change = found − before.
    #[test]
    fn forces_of_planes_are_held_by_a_newton_step() {
        let mut random = Random::new(7);
        let mut draw = |low: f64, high: f64| low + (high - low) * random.unit();
        for number in 0..200 {
            let mut vector = |size: f64| DVec3::new(draw(-size, size), draw(-size, size), draw(-size, size));
            let normal = vector(1.0).normalize();
            let (before, found) = ([(); 4].map(|()| vector(3.0)), [(); 4].map(|()| vector(3.0)));
            let place = Place { centre: vector(0.1), velocity: vector(0.5) };
            let seen =
                [(); 4].map(|()| Seen { s: vector(0.3), rate: vector(2.0), a: DVec3::X, place, turning: DVec3::ZERO });
            let responses = [(); 3].map(|()| [(); 3].map(|()| (draw(-1e-3, 1e-3), draw(-1e-2, 1e-2))));
            let friction = if number % 3 == 0 { 0.0 } else { draw(0.1, 1.0) };
            let plane = Plane { normal, offset: 0.2, stiffness: draw(1.0, 2000.0), friction, slip: 0.1 };
            let held = hold(&plane, &before, &found, &seen, &responses);
            assert_eq!(held[0], found[0]);
            for i in 0..3 {
                let at = &seen[i + 1];
                let (by_position, by_velocity) =
                    plane.derivatives(plane.depth(place.centre + at.s), place.velocity + at.rate);
                let change = |node: usize| held[node] - before[node];
                let caused = (0..3).map(|j| {
                    let (x, u) = responses[i][j];
                    by_position * (x * change(j + 1)) + by_velocity * (u * change(j + 1))
                });
                let sum: DVec3 = change(i + 1) - caused.sum::<DVec3>();
                let residual = found[i + 1] - before[i + 1];
                let largest = held.iter().map(|held| held.length()).fold(10.0, f64::max);
                assert!(sum.distance(residual) < 1e-13 * largest, "scene {number}: {sum} instead of {residual}");
            }
        }
    }
}
