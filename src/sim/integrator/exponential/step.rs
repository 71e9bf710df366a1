//! One step: what acts at its nodes, and exponential collocation of a few vertices side by side.

use glam::DVec3;
use pulp::Simd;

use super::{
    course::Course,
    lanes::{LANES, Mask, Reals, Vector},
    weights::{Dense, Weights, quartic, quartic_through},
};
use crate::{
    model::influence::Weight,
    scene::{Material, path::Bounds},
    sim::{
        nodes,
        state::{Common, Pushed, State},
        terms::{Sphere, Weighted},
    },
};

/// Corrections after which a step that has not settled is given up.
const MOST_SWEEPS: usize = 6;
/// Paths are taken as the quartic through a step's looks only if the cubic through its nodes is as near as this in the
/// middle [radii]; see [`Step::smooth`].
const SMOOTH: f64 = 1e-7;
/// Most spheres whose rims are located; those beyond are cut off where they are found.
pub const RIMS: usize = 64;

/// An instant of a step.
#[derive(Clone, Debug, Default)]
pub struct Moment {
    /// Centres of the spheres relative to the centre of the body, shifted by what carries all vertices alike
    /// [scene unit]: what is left of a vertex there is its own.
    pub centres: Vec<DVec3>,
    /// What is the same for all vertices [scene unit/s²].
    pub uniform: DVec3,
    /// Response of all vertices to that.
    pub carried: DVec3,
    /// Response to each push [scene unit].
    pub pushed: Vec<f64>,
}

/// A step: its weights, and what acts at its nodes and in its middle.
#[derive(Clone, Debug, Default)]
pub struct Step {
    /// Where it starts [s].
    pub start: f64,
    /// How long it is [s].
    pub h: f64,
    /// Of that length.
    pub weights: Weights,
    /// At the four nodes, and in the middle.
    pub moments: [Moment; 5],
    /// Bounds of the motion of the centre of each sphere relative to the vertices' common motion.
    pub relative: Vec<Bounds>,
    /// Whether the quartic through the five moments is as good as the paths themselves: what it leaves out makes a force
    /// of which the displacement does not see what counts. It leaves out less than the cubic does, by as much as the
    /// step is short for the oscillator.
    pub smooth: bool,
    /// What rounding of times and positions does to the force at any of the moments [scene unit/s²]: of a smaller
    /// difference nothing can be told, and halving the step does not make it smaller.
    pub noise: f64,
}

/// How much of its time passes in a step in which a force may change by itself, see [`Group::roughness`].
const SMOOTHNESS: f64 = 0.5;
/// What is left of a number after a few roundings, of its size.
const ROUNDING: f64 = 8.0 * f64::EPSILON;

/// The influence of a sphere on vertices side by side.
#[derive(Clone, Copy, Debug)]
pub struct Pull {
    /// Index of the sphere in the course.
    pub sphere: usize,
    /// Its strength on each vertex [1/s²]; 0 where the vertex is outside of it.
    pub strength: [f64; LANES],
    /// Whether the weight ends at the rim wherever the vertex is found. Otherwise the vertex is inside throughout, and the
    /// linear weight goes on smoothly beyond the rim: the step then has no kink in it.
    pub cut: bool,
}

/// A vertex, and what acts on it all through a step.
#[derive(Clone, Copy, Debug)]
pub struct Vertex {
    /// Rest position l [scene unit].
    pub rest: DVec3,
    /// Which spheres it is inside of, a bit each, if that is known and is to be taken as it is throughout the step;
    /// otherwise the weight is cut off at the rim where the vertex is found.
    pub inside: Option<u64>,
}

impl Vertex {
    /// Where it rests, moved by what pushes have done to it, given the responses to them [scene unit].
    pub fn rest_at(&self, course: &Course<'_>, pushed: &[f64]) -> DVec3 {
        let moved = course
            .weighted
            .iter()
            .zip(pushed)
            .map(|(push, x)| push.direction * (course.facing(push.direction, self.rest) * x));
        self.rest + moved.sum::<DVec3>()
    }
}

/// Where a step leads a vertex.
#[derive(Clone, Copy, Debug)]
pub struct Outcome {
    /// State at the end.
    pub end: State,
    /// Forces at the four nodes [scene unit/s²].
    pub forces: [DVec3; 4],
    /// By how much the force in the middle differs from the cubic through those [scene unit/s²].
    pub bend: DVec3,
    /// Estimate of the error of the displacement that the step makes [scene unit].
    pub error: f64,
}

/// Vertices that take a step together, and what acts on them. Their rest positions are `SAMPLES`: one if they stay where they
/// are, five, at each look, if pushes move them.
pub struct Group<'a, S: Simd, const W: usize, const SAMPLES: usize> {
    /// The instruction set.
    pub simd: S,
    /// The body's course.
    pub course: &'a Course<'a>,
    /// The step.
    pub step: &'a Step,
    /// Rest positions, moved by the response to pushes.
    rest: [Vector<S, W>; SAMPLES],
    /// The spheres that they are inside of.
    pub pulls: &'a [Pull],
}

/// Where a step leads.
#[derive(Clone, Copy)]
pub struct Collocated<S: Simd, const W: usize> {
    /// Displacement at the end.
    pub x: Vector<S, W>,
    /// Velocity at the end.
    pub u: Vector<S, W>,
    /// Forces at the four nodes [scene unit/s²].
    pub forces: [Vector<S, W>; 4],
    /// By how much the force in the middle differs from the cubic through those [scene unit/s²].
    pub bend: Vector<S, W>,
    /// Estimate of the error of the displacement that the step makes [scene unit].
    pub error: Reals<S, W>,
}

/// `flow + Σ wᵢ fᵢ`.
#[inline(always)]
fn respond<S: Simd, const W: usize>(flow: Vector<S, W>, w: &[f64; 4], f: &[Vector<S, W>; 4]) -> Vector<S, W> {
    flow + ((f[0] * w[0] + f[1] * w[1]) + (f[2] * w[2] + f[3] * w[3]))
}

impl<'a, S: Simd, const W: usize, const SAMPLES: usize> Group<'a, S, W, SAMPLES> {
    /// With rest positions `rest`, moved by what pushes have done to each vertex by how squarely it faces them.
    #[inline(always)]
    pub fn new(
        simd: S,
        course: &'a Course<'a>,
        step: &'a Step,
        rest: Vector<S, W>,
        pulls: &'a [Pull],
    ) -> Group<'a, S, W, SAMPLES> {
        let mut group = Group { simd, course, step, rest: [rest; SAMPLES], pulls };
        if SAMPLES > 1 {
            let none = Reals::splat(simd, 0.0);
            // the length of a rest position is the radius of a round body; it is computed for others only
            let per_length = if course.mesh.is_round() {
                Reals::splat(simd, 1.0 / course.body().radius)
            } else {
                Reals::splat(simd, 1.0) / rest.length_squared().sqrt()
            };
            for (p, push) in course.weighted.iter().enumerate() {
                let d = Vector::splat(simd, push.direction);
                let facing = none - (rest.x * d.x + rest.y * d.y + rest.z * d.z) * per_length;
                let along = d * none.larger(facing); // none of a vertex at the centre, where that is NaN
                for (look, rest) in group.rest.iter_mut().enumerate() {
                    *rest = *rest + along * step.moments[look].pushed[p];
                }
            }
        }
        group
    }

    /// Rest positions at a look, moved by the response to pushes.
    #[inline(always)]
    pub fn rest_at(&self, look: usize) -> Vector<S, W> {
        self.rest[look.min(SAMPLES - 1)]
    }

    /// F of each vertex for its displacement `x` at one of the step's moments [scene unit/s²].
    #[inline(always)]
    fn force(&self, look: usize, x: Vector<S, W>) -> Vector<S, W> {
        let moment = &self.step.moments[look];
        let (one, position) = (Reals::splat(self.simd, 1.0), self.rest_at(look) + x);
        let mut force = Vector::splat(self.simd, DVec3::ZERO);
        for pull in self.pulls {
            let to_centre = Vector::splat(self.simd, moment.centres[pull.sphere]) - position;
            let z = to_centre.length_squared().sqrt() * self.course.spheres[pull.sphere].inverse_radius;
            let inside = one - z;
            let mut weight = match self.course.weight() {
                Weight::Linear => inside, // (3.3)
                Weight::Wendland => {
                    let square = inside * inside;
                    square * square * (z * 4.0 + one)
                }
            };
            if pull.cut {
                weight = z.below(one).select(weight, Reals::splat(self.simd, 0.0));
            }
            force = force + to_centre * (Reals::load(self.simd, &pull.strength, 0) * weight);
        }
        force
    }

    /// How much of what a cubic leaves out of the force on each vertex counts [–], which goes from `start` to `end` in the step.
    ///
    /// What a quartic has beyond the cubic, Lobatto quadrature sees: to a slow oscillator it makes no difference. What is
    /// left is of the next order in what passes in the step: of the oscillator, of the influence's own oscillation,
    /// of a sphere that the vertex passes through. So only what a force that is not smooth has beyond it counts in full.
    #[inline(always)]
    fn roughness(&self, start: Vector<S, W>, end: Vector<S, W>) -> Reals<S, W> {
        let (simd, step) = (self.simd, self.step);
        let material = self.course.body().material;
        let travelled = (self.rest_at(3) + end) - (self.rest_at(0) + start);
        let zero = Reals::splat(simd, 0.0);
        let (mut stiffness, mut passed) = (zero, zero);
        for pull in self.pulls {
            let sphere = &self.course.spheres[pull.sphere];
            let moved = step.moments[3].centres[pull.sphere] - step.moments[0].centres[pull.sphere];
            let way = Vector::splat(simd, moved) - travelled;
            let way = (way.x.abs() + way.y.abs() + way.z.abs()) * sphere.inverse_radius;
            let strength = Reals::load(simd, &pull.strength, 0).abs();
            passed = passed.larger(zero.below(strength).select(way, zero)); // of the vertex' own spheres only
            stiffness = stiffness + strength;
        }
        let rate = stiffness.sqrt() + Reals::splat(simd, material.omega + 2.0 * material.damping);
        ((passed + rate * step.h) * SMOOTHNESS).smaller(Reals::splat(simd, 1.0))
    }

    /// Takes the step with all of them, so exactly that the errors it estimates are below `wanted` [scene unit] if
    /// corrections can do that.
    ///
    /// The force is taken as the cubic through its values at the four Lobatto nodes; against the exact oscillator that
    /// is exponential collocation (Hochbruck & Ostermann 2005). The forces depend on the displacements at the nodes and
    /// these on the forces: predicted from the nodes before, then corrected (Picard), once at least, which makes it of
    /// order five; corrected to the end it is of order six. Each correction leaves of the last change at most the part
    /// that the stiffness of the influence lets through. A vertex is corrected until it has settled, and no more,
    /// whatever the others need: it does not depend on its company.
    #[inline(always)]
    pub fn collocate(&self, x: Vector<S, W>, u: Vector<S, W>, wanted: f64) -> Collocated<S, W> {
        let (simd, weights) = (self.simd, &self.step.weights);
        let zero = Vector::splat(simd, DVec3::ZERO);
        // Loops, not closures: a closure is compiled for the least instruction set.
        let mut flow = [zero; 4];
        for look in 1..5 {
            let stage = weights.stage(look);
            flow[look - 1] = x * stage.xx + u * stage.xu;
        }

        let mut forces = [self.force(0, x), zero, zero, zero];
        for node in 1..4 {
            forces[node] = self.force(node, respond(flow[node - 1], &weights.nodes[node].predict, &forces));
        }
        let mut stiffness = Reals::splat(simd, 0.0);
        for pull in self.pulls {
            stiffness = stiffness + Reals::load(simd, &pull.strength, 0).abs();
        }
        // What an error of the force is in the displacement, now or after the oscillator has taken the velocity up.
        let gain = weights.gain();
        let left = stiffness * (weights.constant.abs() * gain);
        let enough = Reals::splat(simd, 0.25 * wanted);
        let mut unsettled = Reals::splat(simd, f64::INFINITY);
        let mut settled = Mask::none(simd);
        for _ in 0..MOST_SWEEPS {
            let mut change = Reals::splat(simd, 0.0);
            for node in 1..4 {
                let corrected = self.force(node, respond(flow[node - 1], &weights.nodes[node].force, &forces));
                let by = (corrected - forces[node]).length_squared();
                change = change.larger_or_nan(by);
                forces[node] = settled.select_vector(forces[node], corrected);
            }
            unsettled = settled.select(unsettled, left * change.sqrt());
            settled = settled.or(unsettled.at_most(enough));
            if !settled.negated().any() {
                break;
            }
        }

        // How far the true force in the middle is from the cubic says how much a cubic leaves out.
        let found = self.force(4, respond(flow[3], &weights.middle.force, &forces));
        let bend = found - respond(zero, &weights.polynomial, &forces);
        let noise = Reals::splat(simd, self.step.noise);
        let left_out = Reals::splat(simd, 0.0).larger_or_nan(bend.length_squared().sqrt() - noise);
        let end = respond(flow[2], &weights.nodes[3].force, &forces);
        let roughness = self.roughness(x, end);
        Collocated {
            x: end,
            u: respond(x * weights.ux + u * weights.uu, &weights.velocity, &forces),
            forces,
            bend,
            error: unsettled + left_out * roughness * (0.1 * gain),
        }
    }
}

impl Step {
    /// Sets the step up over a whole interval, with `common` at its start; an error of `wanted` [scene unit] will do.
    pub fn prepare(&mut self, course: &Course<'_>, weights: &Weights, common: &Common, wanted: f64) {
        let h = weights.h;
        self.start = course.start;
        self.set_weights(weights);
        for (look, moment) in self.moments.iter_mut().enumerate() {
            moment.uniform = if course.is_whole {
                course.look_whole(look, &mut moment.centres)
            } else {
                course.look(time_of(look, course.start, h), &mut moment.centres)
            };
        }
        let forces: [DVec3; 4] = std::array::from_fn(|node| self.moments[node].uniform);
        let State { x, u } = common.carried;
        for (look, moment) in self.moments.iter_mut().enumerate() {
            moment.pushed.clear();
            if look == 0 {
                moment.carried = x;
                moment.pushed.extend(common.pushed.iter().map(|pushed| pushed.x));
            } else {
                let stage = self.weights.stage(look);
                moment.carried = stage.xx * x + stage.xu * u + combine(&stage.force, &forces);
                let constant: f64 = stage.force.iter().sum();
                let response = |p: &Pushed, strength| stage.xx * p.x + stage.xu * p.u + constant * strength;
                let pushed = common.pushed.iter().zip(course.weighted);
                moment.pushed.extend(pushed.map(|(pushed, push)| response(pushed, push.strength)));
            }
            for centre in &mut moment.centres {
                *centre -= moment.carried;
            }
        }
        let own = self.common_bounds(course, common, |_| 1.0);
        self.relative.clear();
        self.relative.extend((0..course.spheres.len()).map(|j| {
            let Bounds { speed, acceleration } = course.relative_bounds(j, course.start, course.start + h);
            Bounds { speed: speed + own.speed, acceleration: acceleration + own.acceleration }
        }));
        let limit = self.largest_left_out(course, wanted);
        let spheres_are_smooth = (0..course.spheres.len()).all(|j| {
            let known: [DVec3; 4] = std::array::from_fn(|node| self.moments[node].centres[j]);
            let cubic = combine(&self.weights.polynomial, &known);
            (self.moments[4].centres[j] - cubic).length_squared() <= limit * limit
        });
        self.smooth = spheres_are_smooth
            && (0..course.weighted.len()).all(|p| {
                let known = (0..4).map(|node| self.weights.polynomial[node] * self.moments[node].pushed[p]);
                (self.moments[4].pushed[p] - known.sum::<f64>()).abs() <= limit
            });
        self.noise = self.rounding(course);
    }

    /// How far the cubics may be off in the middle [scene unit], see [`Step::smooth`].
    fn largest_left_out(&self, course: &Course<'_>, wanted: f64) -> f64 {
        let Material { omega, damping, .. } = course.body().material;
        let stiffness: f64 = course.spheres.iter().map(|sphere| sphere.strength.abs()).sum();
        let seen = stiffness * self.weights.gain() * f64::min(1.0, (omega + 2.0 * damping) * self.h);
        f64::min(SMOOTH * course.body().radius, 0.25 * wanted / seen)
    }

    /// See [`Step::noise`].
    fn rounding(&self, course: &Course<'_>) -> f64 {
        let force = |look: usize| self.moments[look].uniform;
        let mut changes = DVec3::ZERO;
        for look in 1..5 {
            changes = changes.max((force(look) - force(0)).abs());
        }
        let of_times = force(0).length() + changes.length() * (1.0 + self.end() / self.h);
        let place = |body: usize| match course.is_whole {
            true => course.tracks.kinematics(course.scene, body, 0).position,
            false => course.track(body).position(self.start),
        };
        let place = |body: usize| place(body).abs().element_sum();
        let own = place(course.index);
        let of_sphere = |sphere: &Sphere| sphere.strength.abs() * (sphere.radius + own + place(sphere.body as usize));
        ROUNDING * (of_times + course.spheres.iter().map(of_sphere).sum::<f64>())
    }

    /// What all vertices do alike at the end of the step, from what they did at its start.
    pub fn advance_common(&self, course: &Course<'_>, common: &mut Common) {
        let Weights { ux, uu, velocity, nodes, .. } = &self.weights;
        let forces: [DVec3; 4] = std::array::from_fn(|node| self.moments[node].uniform);
        let State { x, u } = common.carried;
        common.carried = State { x: self.moments[3].carried, u: *ux * x + *uu * u + combine(velocity, &forces) };
        for (p, (pushed, push)) in common.pushed.iter_mut().zip(course.weighted).enumerate() {
            // a constant unit force adds S(h) to the velocity, as a unit of velocity does to the displacement
            let u = ux * pushed.x + uu * pushed.u + nodes[3].xu * push.strength;
            *pushed = Pushed { x: self.moments[3].pushed[p], u };
        }
    }

    /// Bounds of the speed and the acceleration that vertices have by what all do alike within the step, if they are
    /// `facing` pushes so squarely.
    fn common_bounds(&self, course: &Course<'_>, common: &Common, facing: impl Fn(&Weighted) -> f64) -> Bounds {
        let material = course.body().material;
        let uniform = self.moments.iter().map(|moment| moment.uniform.length()).fold(0.0, f64::max);
        let weighted: f64 = course.weighted.iter().map(|weighted| facing(weighted) * weighted.strength.abs()).sum();
        let momentum = common.momentum(material.omega, course.weighted.iter().map(facing));
        let speed = momentum + (uniform + weighted) * self.h;
        Bounds { speed, acceleration: (material.omega + 2.0 * material.damping) * speed + uniform + weighted }
    }

    /// The error that taking what is the same for all vertices as a cubic makes [scene unit]; see [`Group::collocate`].
    pub fn uniform_error(&self) -> f64 {
        let weights = &self.weights;
        let forces: [DVec3; 4] = std::array::from_fn(|node| self.moments[node].uniform);
        let gain = weights.gain();
        let left_out = (self.moments[4].uniform - combine(&weights.polynomial, &forces)).length();
        // not `f64::max`, which would lose NaN
        let beyond = if left_out <= self.noise { 0.0 } else { left_out - self.noise };
        0.1 * beyond * gain
    }

    /// Sets the step up over a part of an interval, of which `whole` is the step.
    pub fn prepare_part(&mut self, course: &Course<'_>, whole: &Step, common: &Common, start: f64, weights: &Weights) {
        self.start = start;
        self.set_weights(weights);
        for look in 0..5 {
            self.look_within(course, whole, common, look);
        }
        self.bound_within(course, whole);
        self.noise = whole.noise;
    }

    /// Most often it has them from before, and they are many.
    fn set_weights(&mut self, weights: &Weights) {
        self.h = weights.h;
        if self.weights.h != weights.h || self.weights.oscillator != weights.oscillator {
            self.weights = *weights;
        }
    }

    /// The same for a vertex on which nothing acts: only where the spheres are at the start and at the end.
    pub fn prepare_ends(&mut self, course: &Course<'_>, whole: &Step, common: &Common, start: f64, h: f64) {
        self.start = start;
        self.h = h;
        for look in [0, 3] {
            self.look_within(course, whole, common, look);
        }
        self.bound_within(course, whole);
    }

    fn look_within(&mut self, course: &Course<'_>, whole: &Step, common: &Common, look: usize) {
        let t = time_of(look, self.start, self.h);
        let moment = &mut self.moments[look];
        if whole.smooth {
            whole.interpolate((t - whole.start) / whole.h, moment);
            return;
        }
        course.look(t, &mut moment.centres);
        let common = LookUp { course, whole, common }.common_at(t);
        moment.carried = common.carried.x;
        moment.pushed.clear();
        moment.pushed.extend(common.pushed.iter().map(|pushed| pushed.x));
        for centre in &mut moment.centres {
            *centre -= moment.carried;
        }
    }

    /// Where spheres are and what pushes have done at `theta` of this step, by the quartics through its five moments.
    fn interpolate(&self, theta: f64, moment: &mut Moment) {
        let [w0, w1, w2, w3, w4] = quartic(theta);
        let [m0, m1, m2, m3, m4] = &self.moments;
        moment.centres.clear();
        for j in 0..self.relative.len() {
            let (a, b, c) = (w0 * m0.centres[j], w1 * m1.centres[j], w2 * m2.centres[j]);
            moment.centres.push((a + b) + (c + w3 * m3.centres[j]) + w4 * m4.centres[j]);
        }
        moment.pushed.clear();
        for p in 0..m0.pushed.len() {
            let (a, b, c) = (w0 * m0.pushed[p], w1 * m1.pushed[p], w2 * m2.pushed[p]);
            moment.pushed.push((a + b) + (c + w3 * m3.pushed[p]) + w4 * m4.pushed[p]);
        }
    }

    fn bound_within(&mut self, course: &Course<'_>, whole: &Step) {
        self.relative.clear();
        if whole.smooth {
            self.relative.extend_from_slice(&whole.relative);
            return;
        }
        let (start, end) = (self.start, self.start + self.h);
        let over_whole = |j| course.relative_bounds(j, whole.start, whole.end());
        self.relative.extend((0..course.spheres.len()).map(|j| {
            // what the whole step's bounds have beyond the paths' is the common motion's
            let (paths, all, own) = (over_whole(j), whole.relative[j], course.relative_bounds(j, start, end));
            Bounds {
                speed: own.speed + (all.speed - paths.speed).max(0.0),
                acceleration: own.acceleration + (all.acceleration - paths.acceleration).max(0.0),
            }
        }));
    }

    /// Where the step ends [s].
    pub fn end(&self) -> f64 {
        self.start + self.h
    }
}

/// When a step looks for the n-th time [s].
fn time_of(look: usize, start: f64, h: f64) -> f64 {
    if look == 3 { start + h } else { start + nodes::SAMPLES[look] * h }
}

/// `Σ wᵢ vᵢ`
fn combine(w: &[f64; 4], v: &[DVec3; 4]) -> DVec3 {
    (w[0] * v[0] + w[1] * v[1]) + (w[2] * v[2] + w[3] * v[3])
}

/// Whether the weight has a kink at the rim that has to be stepped around.
pub fn has_kink(weight: Weight) -> bool {
    weight == Weight::Linear
}

/// Where spheres are relative to vertices at any instant of an interval, and what it takes to tell.
#[derive(Clone, Copy)]
pub struct LookUp<'a> {
    /// The body's course.
    pub course: &'a Course<'a>,
    /// The step over all of the interval.
    pub whole: &'a Step,
    /// What all vertices do alike at its start.
    pub common: &'a Common,
}

/// Where a sphere is relative to a vertex without its own displacement, in the course of a step.
pub enum Apart<'a> {
    /// The coefficients of a polynomial in the time since the step's start over its length.
    Quartic([DVec3; 5]),
    /// By the paths.
    Exact(ExactPath<'a>),
}

/// [`Apart`] where no polynomial will do.
pub struct ExactPath<'a> {
    look: LookUp<'a>,
    vertex: &'a Vertex,
    sphere: usize,
}

impl<'a> LookUp<'a> {
    /// Of the course's sphere number `sphere` and a vertex, in the course of a part of the interval.
    pub fn apart(self, vertex: &'a Vertex, sphere: usize, start: f64, h: f64) -> Apart<'a> {
        let whole = self.whole;
        if !whole.smooth {
            return Apart::Exact(ExactPath { look: self, vertex, sphere });
        }
        let known = std::array::from_fn(|look| {
            let moment = &whole.moments[look];
            moment.centres[sphere] - vertex.rest_at(self.course, &moment.pushed)
        });
        let mut c = quartic_through(&known);
        if start != whole.start || h != whole.h {
            // the same polynomial in the part's time: from theta₀ on (Horner), and slower
            let (from, slower) = ((start - whole.start) / whole.h, h / whole.h);
            for low in 0..4 {
                for k in (low..4).rev() {
                    c[k] += from * c[k + 1];
                }
            }
            let mut power = 1.0;
            for c in &mut c {
                *c *= power;
                power *= slower;
            }
        }
        Apart::Quartic(c)
    }

    /// Bounds of the motion of a sphere's centre relative to a vertex, without its own displacement: tighter than those
    /// for all vertices by what pushes do to those that face them more squarely.
    pub fn bounds(&self, vertex: &Vertex, all: Bounds) -> Bounds {
        let LookUp { course, whole, common } = *self;
        let squarely = whole.common_bounds(course, common, |_| 1.0);
        let own = whole.common_bounds(course, common, |push| course.facing(push.direction, vertex.rest));
        // with room for the rounding of what is taken off
        let less = |all: f64, squarely: f64, own: f64| all - (squarely - own) + 1e-9 * squarely;
        Bounds {
            speed: all.speed.min(less(all.speed, squarely.speed, own.speed)),
            acceleration: all.acceleration.min(less(all.acceleration, squarely.acceleration, own.acceleration)),
        }
    }

    /// What all vertices do alike at `t` [s], and the velocities of the responses to pushes.
    fn common_at(&self, t: f64) -> Common {
        let LookUp { course, whole, common } = *self;
        if t <= whole.start {
            return common.clone();
        }
        let h = whole.h;
        let dense = Dense::new(course.oscillator(), h, (t - whole.start) / h);
        let forces: [DVec3; 4] = std::array::from_fn(|node| whole.moments[node].uniform);
        let constant: (f64, f64) = (dense.x.iter().sum(), dense.u.iter().sum());
        let respond = |p: &Pushed, strength: f64| Pushed {
            x: dense.xx * p.x + dense.xu * p.u + constant.0 * strength,
            u: dense.ux * p.x + dense.uu * p.u + constant.1 * strength,
        };
        Common {
            carried: dense.state(common.carried, &forces, DVec3::ZERO),
            pushed: common.pushed.iter().zip(course.weighted).map(|(p, push)| respond(p, push.strength)).collect(),
        }
    }
}

impl ExactPath<'_> {
    /// Position [scene unit] and velocity [scene unit/s] at `t` [s].
    pub fn at(&self, t: f64) -> (DVec3, DVec3) {
        let course = self.look.course;
        let (own, other) = (course.track(course.index).at(t), course.sphere_track(self.sphere).at(t));
        let common = self.look.common_at(t);
        let (mut x, mut u) = (self.vertex.rest + common.carried.x, common.carried.u);
        for (push, pushed) in course.weighted.iter().zip(&common.pushed) {
            let along = push.direction * course.facing(push.direction, self.vertex.rest);
            (x, u) = (x + along * pushed.x, u + along * pushed.u);
        }
        (other.position - own.position - x, other.velocity - own.velocity - u)
    }
}
