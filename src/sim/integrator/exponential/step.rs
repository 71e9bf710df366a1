//! One step: forces at its nodes, and exponential collocation of several vertices side by side.

use glam::DVec3;
use pulp::Simd;

use super::{
    course::Course,
    weights::{BEND_ASIDE, Mode, Weights},
};
use crate::{
    model::influence::Weight,
    scene::{Material, path::Bounds},
    sim::{
        numerics::{
            control::{
                ASIDE, CROSSING, MAX_CORRECTIONS, NEGLIGIBLE, OF_BOUND, PASSING, PASSING_WENDLAND, RESIDUAL, RESOLVED,
                ROUNDING, SKEW_ASIDE, TURN, TURN_WIDTH,
            },
            dense::Dense,
            lagrange::{combine, quartic, quartic_through},
            lanes::{LANES, Mask, Reals, Vector},
            nodes::SAMPLES,
        },
        state::State,
        terms::Sphere,
    },
};

/// Index of the sample at `ASIDE`.
const ASIDE_SAMPLE: usize = 5;

/// An instant of a step.
#[derive(Clone, Debug, Default)]
pub struct Moment {
    /// Centres of the spheres relative to the centre of the body, shifted by the shared motion of all vertices
    /// [scene unit], so that a vertex's remaining displacement is its own.
    pub centres: Vec<DVec3>,
    /// Acceleration that all vertices share [scene unit/s²].
    pub uniform: DVec3,
    /// Shared response of all vertices to that acceleration [scene unit].
    pub carried: DVec3,
}

/// A step: its weights, and its influences at the samples.
#[derive(Clone, Debug, Default)]
pub struct Step {
    /// Start of the step [s].
    pub start: f64,
    /// Length of the step [s].
    pub h: f64,
    /// Weights for this length.
    pub weights: Weights,
    /// The influences at the four nodes, in the middle, and at `ASIDE`.
    pub moments: [Moment; 6],
    /// Bounds on the motion of each sphere's centre relative to the shared motion of the vertices.
    pub relative: Vec<Bounds>,
    /// Whether the quartic through the five moments is as good as the paths themselves: its residual causes a force whose
    /// effect on the displacement is negligible. That residual is smaller than the cubic's by the ratio of the step length
    /// to the oscillator's time scale; it is also known from the sample at `ASIDE`.
    pub smooth: bool,
    /// Effect of rounding of times and positions on the force at any of the moments [scene unit/s²]. Smaller
    /// differences carry no information, and halving the step does not reduce them.
    pub noise: f64,
    /// Amplitude of the shared motion's own oscillation in a step too long to resolve it, otherwise 0
    /// [scene unit].
    pub ringing: f64,
}

/// The influence of a sphere on several vertices side by side.
#[derive(Clone, Copy, Debug)]
pub struct Pull {
    /// Index of the sphere in the course.
    pub sphere: usize,
    /// Its strength on each vertex [1/s²]; 0 where the vertex is outside of it.
    pub strength: [f64; LANES],
    /// Whether the weight is cut off at the rim wherever the vertex is sampled. Otherwise the vertex is inside
    /// throughout and the linear weight continues smoothly beyond the rim, so that the step has no kink.
    pub cut: bool,
}

/// A vertex, and its constant acceleration in a step.
#[derive(Clone, Copy, Debug)]
pub struct Vertex {
    /// Rest position l [scene unit].
    pub rest: DVec3,
    /// Its constant acceleration [scene unit/s²].
    pub local: DVec3,
}

/// The result of a step for a vertex.
#[derive(Clone, Copy, Debug)]
pub struct Outcome {
    /// State at the end.
    pub end: State,
    /// Forces at the four nodes [scene unit/s²].
    pub forces: [DVec3; 4],
    /// Difference of the force in the middle from the cubic through the forces at the nodes [scene unit/s²].
    pub bend: DVec3,
    /// Estimated error of the displacement caused by the step [scene unit].
    pub error: f64,
    /// The part of it that a shorter step would reduce: the rest is that of the iteration, which the tolerance bounds.
    pub bent: f64,
}

/// Vertices that take a step together, and the influences on them.
pub struct Group<'a, S: Simd, const W: usize> {
    /// The instruction set.
    pub simd: S,
    /// The body's course.
    pub course: &'a Course<'a>,
    /// The step.
    pub step: &'a Step,
    /// Their rest positions.
    pub rest: Vector<S, W>,
    /// Their constant accelerations.
    pub local: Vector<S, W>,
    /// The spheres that contain them.
    pub pulls: &'a [Pull],
}

/// The result of a step for several vertices.
#[derive(Clone, Copy)]
pub struct Collocated<S: Simd, const W: usize> {
    /// Displacement at the end.
    pub x: Vector<S, W>,
    /// Velocity at the end.
    pub u: Vector<S, W>,
    /// Forces at the four nodes [scene unit/s²].
    pub forces: [Vector<S, W>; 4],
    /// Difference of the force in the middle from the cubic through the forces at the nodes [scene unit/s²].
    pub bend: Vector<S, W>,
    /// Estimated error of the displacement caused by the step [scene unit].
    pub error: Reals<S, W>,
    /// See [`Outcome::bent`].
    pub bent: Reals<S, W>,
}

/// `flow + Σ wᵢ fᵢ`, the response to the forces at the first `N` nodes.
#[inline(always)]
fn predict<S: Simd, const W: usize, const N: usize>(
    flow: Vector<S, W>,
    w: &[f64; 4],
    f: &[Vector<S, W>; 4],
) -> Vector<S, W> {
    let mut sum = f[0] * w[0];
    for node in 1..N {
        sum = sum + f[node] * w[node];
    }
    flow + sum
}

/// `flow + Σ wᵢ fᵢ`, the response to forces at the nodes.
#[inline(always)]
pub fn respond<S: Simd, const W: usize>(flow: Vector<S, W>, w: &[f64; 4], f: &[Vector<S, W>; 4]) -> Vector<S, W> {
    flow + ((f[0] * w[0] + f[1] * w[1]) + (f[2] * w[2] + f[3] * w[3]))
}

impl<S: Simd, const W: usize> Group<'_, S, W> {
    /// F of each vertex for displacement `x` at one of the step's moments [scene unit/s²].
    #[inline(always)]
    fn force(&self, sample: usize, x: Vector<S, W>) -> Vector<S, W> {
        let moment = &self.step.moments[sample];
        let (one, position) = (Reals::splat(self.simd, 1.0), self.rest + x);
        let mut force = self.local;
        for pull in self.pulls {
            let to_centre = Vector::splat(self.simd, moment.centres[pull.sphere]) - position;
            let z = to_centre.length_squared().sqrt() * self.course.spheres[pull.sphere].inverse_radius;
            let mut weight = self.course.weight().inside(z);
            if pull.cut {
                weight = z.below(one).select(weight, Reals::splat(self.simd, 0.0));
            }
            force = force + to_centre * (Reals::load(self.simd, &pull.strength, 0) * weight);
        }
        force
    }

    /// How the spheres pass each vertex that moves from `start` to `end` in the step.
    #[inline(always)]
    fn passage(&self, start: Vector<S, W>, end: Vector<S, W>) -> Passing<S, W> {
        let (simd, step) = (self.simd, self.step);
        let travelled = end - start;
        let (zero, one) = (Reals::splat(simd, 0.0), Reals::splat(simd, 1.0));
        let tiny = Reals::splat(simd, f64::MIN_POSITIVE);
        let (mut passed, mut turned, mut crosses) = (zero, zero, Mask::none(simd));
        for pull in self.pulls {
            let sphere = &self.course.spheres[pull.sphere];
            let moved = step.moments[3].centres[pull.sphere] - step.moments[0].centres[pull.sphere];
            let way = Vector::splat(simd, moved) - travelled;
            let strength = Reals::load(simd, &pull.strength, 0).abs();

            // (c − r) W(|c − r|) along a line at distance b from the centre
            let from = Vector::splat(simd, step.moments[0].centres[pull.sphere]) - self.rest - start;
            let square = way.length_squared();
            let theta = (zero - from.dot(way) / square.larger(tiny)).larger(zero).smaller(one);
            let near = square * (TURN_WIDTH * TURN_WIDTH);
            let sharpness = near / (near + (from + way * theta).length_squared()).larger(tiny);
            let slope = TURN * self.course.weight().slope_at_centre() * sphere.inverse_radius;
            turned = turned + strength * square * (sharpness * sharpness) * slope;
            // at the rim of the linear weight a step ends
            if pull.cut && self.course.weight() == Weight::Wendland {
                let rim = Reals::splat(simd, sphere.radius * sphere.radius);
                let outside = rim.below(from.length_squared()).or(rim.below((from + way).length_squared()));
                let enters = (from + way * theta).length_squared().below(rim);
                crosses = crosses.or(outside.and(enters).and(zero.below(strength)));
            }

            let way = (way.x.abs() + way.y.abs() + way.z.abs()) * sphere.inverse_radius;
            passed = passed.larger(zero.below(strength).select(way, zero)); // only the spheres that act on the vertex
        }
        Passing { passed, turned, crosses }
    }

    /// Takes the step with all vertices of the group, such that the estimated errors are below `wanted` [scene unit] if
    /// corrections can achieve that.
    ///
    /// The force is the cubic through its values at the four Lobatto nodes; against the exact oscillator that is
    /// exponential collocation (Hochbruck & Ostermann 2005). The forces depend on the displacements at the nodes and
    /// vice versa: they are predicted from the preceding nodes, then corrected (Picard iteration) at least once, which
    /// gives order five; iterated to convergence, the order is six. Each correction reduces the last change at least by
    /// a factor that depends on the stiffness of the influence. Each vertex is corrected until it has converged and no
    /// further, so its result does not depend on the other lanes.
    #[inline(always)]
    pub fn collocate(&self, x: Vector<S, W>, u: Vector<S, W>, wanted: f64) -> Collocated<S, W> {
        let (simd, weights) = (self.simd, &self.step.weights);
        let zero = Vector::splat(simd, DVec3::ZERO);
        // Loops, not closures: a closure is compiled for the baseline instruction set.
        let mut flow = [zero; 4];
        for sample in 1..5 {
            let stage = weights.stage(sample);
            flow[sample - 1] = x * stage.xx + u * stage.xu;
        }

        let mut forces = [self.force(0, x), zero, zero, zero];
        forces[1] = self.force(1, predict::<_, _, 1>(flow[0], &weights.nodes[1].predict, &forces));
        forces[2] = self.force(2, predict::<_, _, 2>(flow[1], &weights.nodes[2].predict, &forces));
        forces[3] = self.force(3, predict::<_, _, 3>(flow[2], &weights.nodes[3].predict, &forces));
        let mut stiffness = Reals::splat(simd, 0.0);
        for pull in self.pulls {
            stiffness = stiffness + Reals::load(simd, &pull.strength, 0).abs();
        }
        // Effect of a force error on the displacement, now or after the oscillator has converted the velocity.
        let gain = weights.gain();
        let left = stiffness * (OF_BOUND * weights.constant.abs() * gain);
        let enough = Reals::splat(simd, NEGLIGIBLE * wanted);
        let mut unsettled = Reals::splat(simd, f64::INFINITY);
        let mut settled = Mask::none(simd);
        for _ in 0..MAX_CORRECTIONS {
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

        // The residual of the cubic in the middle estimates the error of the cubic.
        let found = self.force(4, respond(flow[3], &weights.middle.force, &forces));
        let bend = found - respond(zero, &weights.polynomial, &forces);
        let noise = Reals::splat(simd, self.step.noise);
        let none = Reals::splat(simd, 0.0);
        let left_out = none.larger_or_nan(bend.length_squared().sqrt() - noise);
        let end = respond(flow[2], &weights.nodes[3].force, &forces);
        let Passing { passed, turned, crosses } = self.passage(x, end);
        // Depends only on what acts on each vertex, not on spheres that are near other vertices or near none.
        let Material { omega, damping, .. } = self.course.material;
        let scales = (stiffness.sqrt() + Reals::splat(simd, omega + 2.0 * damping)) * self.step.h;
        // Lobatto quadrature integrates the quartic part of the residual exactly, so it does not affect a slow oscillator.
        // The rest is of higher order in the ratio of the step to the time scales involved: of the oscillator, of the
        // influence's own oscillation, and of a sphere that the vertex passes through.
        let mut effect = left_out * (passed + scales).smaller(Reals::splat(simd, 1.0)) * RESIDUAL;
        let is_quick = Reals::splat(simd, RESOLVED).below(scales).or(crosses.and(none.below(left_out)));
        let is_near = Reals::splat(simd, wanted).below(effect * (4.0 * gain));
        // usually the force in the middle has already shown that the error is far below the tolerance
        if is_quick.or(is_near).any() {
            let stage = &weights.aside;
            let found = self.force(ASIDE_SAMPLE, respond(x * stage.xx + u * stage.xu, &stage.force, &forces));
            let quartic = respond(bend * BEND_ASIDE, &weights.polynomial_aside, &forces);
            let skew = none.larger_or_nan((found - quartic).length_squared().sqrt() - noise);
            let h = Reals::splat(simd, self.step.h);
            let material = self.course.material;
            let most = Reals::splat(simd, CROSSING);
            let share = match self.course.weight() {
                Weight::Linear => PASSING,
                Weight::Wendland => PASSING_WENDLAND,
            };
            let share = crosses.select(most, (passed * share).smaller(most));
            let all = self::left_out(simd, material, h, stiffness, [left_out, skew])
                + (left_out + skew * (1.0 / SKEW_ASIDE)) * share
                + self.ringing([x, u], &forces, stiffness);
            effect = is_quick.or(is_near).select(all, effect);
        }
        let bent = effect.larger_or_nan(turned) * (OF_BOUND * gain);
        Collocated {
            x: end,
            u: respond(x * weights.ux + u * weights.uu, &weights.velocity, &forces),
            forces,
            bend,
            error: unsettled + bent,
            bent,
        }
    }

    /// A bound on the mean force that a step leaves out because a vertex oscillates too fast for its samples
    /// [scene unit/s²]; 0 if the step is short enough.
    ///
    /// Under the cubic the exact solution is a cubic plus a free oscillation. Its amplitude follows from the state at the
    /// start; the force oscillates by that times the stiffness, and interpolation makes it up to 2.6 times as much.
    #[inline(always)]
    fn ringing(&self, [x, u]: [Vector<S, W>; 2], forces: &[Vector<S, W>; 4], stiffness: Reals<S, W>) -> Reals<S, W> {
        let Some([one, other]) = &self.step.weights.ringing else {
            return Reals::splat(self.simd, 0.0);
        };
        let one = respond(x * one.x + u * one.u, &one.force, forces).length_squared();
        let other = respond(x * other.x + u * other.u, &other.force, forces).length_squared();
        stiffness * 2.6 * ((one + other).sqrt() + Reals::splat(self.simd, self.step.ringing))
    }
}

/// How spheres pass vertices in a step.
struct Passing<S: Simd, const W: usize> {
    /// The largest distance that one that acts moves relative to the vertex [its radii].
    passed: Reals<S, W>,
    /// The force turns where the vertex passes a centre, and the samples may all miss it: a bound on the mean force that the
    /// cubic leaves out there [scene unit/s²].
    turned: Reals<S, W>,
    /// Whether the vertex crosses a rim within the step, where a derivative of the force jumps.
    crosses: Mask<S, W>,
}

/// The mean force that a step leaves out [scene unit/s²], given the residual of the cubic in the middle and that of the
/// quartic at `ASIDE`.
///
/// With q = 80 θ(θ − 1)(θ² − θ + 1/5) the residual is a q + b (θ − ½) q and higher terms. The weights of the end
/// state are S(h − s) and S′(h − s), which are at most 1 after division by the gain: so the two terms count at most
/// as ∫|q| = 0.45 and ∫|(θ − ½) q| = 0.14. Both are orthogonal to constants, and q to linear functions. What is
/// left of S = t − κ t² …, S′ = 1 − 2κ t + (4κ² − ω²) t²/2 … and of the influence's response to the error within
/// the step are ½ ∫θ² q = 0.02 and ∫θ (θ − ½) q = 0.04 times the powers of h that come with them. Each higher pair
/// of terms is smaller by some z²/30 in z time scales of the motion, but not orthogonal; the last factor accounts
/// for them.
#[inline(always)]
pub fn left_out<S: Simd, const W: usize>(
    simd: S,
    Material { omega, damping, .. }: Material,
    h: Reals<S, W>,
    stiffness: Reals<S, W>,
    [bend, skew]: [Reals<S, W>; 2],
) -> Reals<S, W> {
    let square = h * h;
    let influence = stiffness * square;
    let z_squared = influence + square * (omega * omega + 4.0 * damping * damping);
    let even = (z_squared * 0.02).smaller(Reals::splat(simd, 0.45));
    let odd = influence * 0.02 + h * (0.04 * (omega + 2.0 * damping));
    let odd = odd.smaller(Reals::splat(simd, 0.14));
    let both = bend * even + skew * odd * (1.0 / SKEW_ASIDE);
    both * (z_squared * 0.25 + Reals::splat(simd, 1.0)).smaller(Reals::splat(simd, 2.0))
}

impl Step {
    /// Prepares the step over a whole interval, with the shared response `carried` at its start and an acceptable error of `wanted`
    /// [scene unit].
    pub fn prepare(&mut self, course: &Course<'_>, weights: &Weights, carried: State, wanted: f64) {
        let h = weights.h;
        self.start = course.start;
        self.set_weights(weights);
        if course.is_whole {
            self.sample_whole(course);
        } else {
            for (sample, moment) in self.moments[..5].iter_mut().enumerate() {
                moment.uniform = course.sample(time_of(sample, course.start, h), &mut moment.centres);
            }
        }
        let forces = self.uniforms();
        let State { x, u } = carried;
        self.ringing = self.shared_ringing(carried);
        for (sample, moment) in self.moments[..5].iter_mut().enumerate() {
            if sample == 0 {
                moment.carried = x;
            } else {
                let stage = self.weights.stage(sample);
                moment.carried = stage.xx * x + stage.xu * u + combine(&stage.force, forces);
            }
            for centre in &mut moment.centres {
                *centre -= moment.carried;
            }
        }
        let mut aside = std::mem::take(&mut self.moments[ASIDE_SAMPLE]);
        aside.sample(Trajectories { course, whole: self, carried }, self.start + ASIDE * h);
        self.moments[ASIDE_SAMPLE] = aside;
        let own = self.carried_bounds(course, carried);
        self.relative.clear();
        self.relative.extend((0..course.spheres.len()).map(|j| {
            let Bounds { speed, acceleration } = course.relative_bounds(j, course.start, course.start + h);
            Bounds { speed: speed + own.speed, acceleration: acceleration + own.acceleration }
        }));
        let limits = self.largest_left_out(course, wanted);
        self.smooth =
            (0..course.spheres.len()).all(|j| self.is_smooth(limits, |sample| self.moments[sample].centres[j]));
        self.noise = self.rounding(course);
    }

    /// Samples a whole step, for which the tracks hold samples.
    fn sample_whole(&mut self, course: &Course<'_>) {
        let own = course.tracks.samples(course.index);
        for (moment, uniform) in self.moments.iter_mut().zip(own.uniform) {
            moment.uniform = uniform;
            moment.centres.clear();
        }
        for sphere in course.spheres {
            let other = course.tracks.samples(sphere.body as usize);
            for ((moment, own), other) in self.moments.iter_mut().zip(own.positions).zip(other.positions) {
                moment.centres.push(other - own);
            }
        }
    }

    /// Whether a position is well interpolated by the quartic through five samples, see [`Step::smooth`].
    #[inline(always)]
    fn is_smooth(&self, limits: [f64; 2], at: impl Fn(usize) -> DVec3) -> bool {
        let known = [at(0), at(1), at(2), at(3)];
        let is_small = |residual: DVec3, limit: f64| residual.length_squared() <= limit * limit;
        let of_cubic = |sample: usize, w: &[f64; 4]| is_small(at(sample) - combine(w, known), limits[0]);
        let Weights { polynomial, polynomial_aside, .. } = self.weights;
        if of_cubic(4, &polynomial) && of_cubic(ASIDE_SAMPLE, &polynomial_aside) {
            return true;
        }
        let [w0, w1, w2, w3, middle] = quartic(ASIDE);
        is_small(at(ASIDE_SAMPLE) - combine(&[w0, w1, w2, w3], known) - middle * at(4), limits[1])
    }

    /// Acceptable residuals [scene unit] of the cubics in the middle, and of the quartics at `ASIDE`; see
    /// [`Step::smooth`].
    fn largest_left_out(&self, course: &Course<'_>, wanted: f64) -> [f64; 2] {
        let Material { omega, damping, .. } = course.material;
        let stiffness: f64 = course.spheres.iter().map(|sphere| sphere.strength.abs()).sum();
        let seen = stiffness * self.weights.gain();
        let of_cubic = seen * f64::min(1.0, (omega + 2.0 * damping) * self.h);
        [of_cubic, seen].map(|seen| NEGLIGIBLE * wanted / seen)
    }

    /// See [`Step::noise`].
    fn rounding(&self, course: &Course<'_>) -> f64 {
        let force = |sample: usize| self.moments[sample].uniform;
        let mut changes = DVec3::ZERO;
        for sample in 1..5 {
            changes = changes.max((force(sample) - force(0)).abs());
        }
        let of_times = force(0).length() + changes.length() * (1.0 + self.end() / self.h);
        let position = |body: usize| match course.is_whole {
            true => course.tracks.motion_bounds(body as u32).centre,
            false => course.path(body).position(self.start),
        };
        let distance = |body: usize| position(body).abs().element_sum();
        let own = distance(course.index);
        let of_sphere =
            |sphere: &Sphere| sphere.strength.abs() * (sphere.radius + own + distance(sphere.body as usize));
        ROUNDING * (of_times + course.spheres.iter().map(of_sphere).sum::<f64>())
    }

    /// The shared response of all vertices at the end of the step, given that at its start.
    pub fn carried_at_end(&self, State { x, u }: State) -> State {
        let Weights { ux, uu, velocity, .. } = &self.weights;
        let forces = self.uniforms();
        State { x: self.moments[3].carried, u: *ux * x + *uu * u + combine(velocity, forces) }
    }

    /// The acceleration that all vertices share, at the nodes.
    fn uniforms(&self) -> [DVec3; 4] {
        std::array::from_fn(|node| self.moments[node].uniform)
    }

    /// Bounds on the speed and the acceleration of the shared motion within the step.
    fn carried_bounds(&self, course: &Course<'_>, carried: State) -> Bounds {
        let Material { omega, damping, .. } = course.material;
        let uniform = self.moments[..5].iter().map(|moment| moment.uniform.length()).fold(0.0, f64::max);
        let speed = carried.momentum(omega) + uniform * self.h;
        Bounds { speed, acceleration: (omega + 2.0 * damping) * speed + uniform }
    }

    /// The error caused by interpolating the shared acceleration by a cubic [scene unit]; see [`Group::collocate`].
    pub fn uniform_error(&self) -> f64 {
        let weights = &self.weights;
        let forces = self.uniforms();
        let gain = weights.gain();
        let left_out = (self.moments[4].uniform - combine(&weights.polynomial, forces)).length();
        // not `f64::max`, which would drop NaN
        let beyond = if left_out <= self.noise { 0.0 } else { left_out - self.noise };
        RESIDUAL * beyond * gain
    }

    /// See [`Step::ringing`].
    fn shared_ringing(&self, State { x, u }: State) -> f64 {
        let Some(modes) = &self.weights.ringing else { return 0.0 };
        let forces = self.uniforms();
        let of_mode = |mode: &Mode| (mode.x * x + mode.u * u + combine(&mode.force, forces)).length();
        modes.iter().map(of_mode).sum()
    }

    /// Prepares the step over a part of an interval.
    pub fn prepare_part(&mut self, of: Trajectories<'_>, start: f64, weights: &Weights) {
        self.start = start;
        self.set_weights(weights);
        self.ringing = if self.weights.ringing.is_some() { of.whole.ringing } else { 0.0 };
        for sample in 0..self.moments.len() {
            of.sample_at(time_of(sample, start, self.h), &mut self.moments[sample]);
        }
        self.bound_within(of.course, of.whole);
        self.noise = of.whole.noise;
    }

    /// Sets the weights, which are usually set already: copying them is expensive.
    fn set_weights(&mut self, weights: &Weights) {
        self.h = weights.h;
        let of = |weights: &Weights| (weights.h, weights.oscillator);
        if of(&self.weights) != of(weights) {
            self.weights = *weights;
        }
    }

    /// Like [`Step::prepare_part`], for a vertex on which nothing acts: only the positions of the spheres at the start
    /// and at the end.
    pub fn prepare_ends(&mut self, of: Trajectories<'_>, start: f64, h: f64) {
        self.start = start;
        self.h = h;
        for sample in [0, 3] {
            of.sample_at(time_of(sample, start, h), &mut self.moments[sample]);
        }
        self.bound_within(of.course, of.whole);
    }

    /// Sphere positions at `theta` of this step, interpolated by the quartics through its five moments.
    fn interpolate(&self, theta: f64, moment: &mut Moment) {
        let [w0, w1, w2, w3, w4] = quartic(theta);
        let [m0, m1, m2, m3, m4, _] = &self.moments;
        moment.centres.clear();
        for j in 0..self.relative.len() {
            let (a, b, c) = (w0 * m0.centres[j], w1 * m1.centres[j], w2 * m2.centres[j]);
            moment.centres.push((a + b) + (c + w3 * m3.centres[j]) + w4 * m4.centres[j]);
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
            // the excess of the whole step's bounds over those of the paths is due to the shared motion
            let (paths, all, own) = (over_whole(j), whole.relative[j], course.relative_bounds(j, start, end));
            Bounds {
                speed: own.speed + (all.speed - paths.speed).max(0.0),
                acceleration: own.acceleration + (all.acceleration - paths.acceleration).max(0.0),
            }
        }));
    }

    /// End of the step [s].
    pub fn end(&self) -> f64 {
        self.start + self.h
    }
}

impl Moment {
    /// Sets the moment to time `t` [s].
    fn sample(&mut self, trajectories: Trajectories<'_>, t: f64) {
        self.uniform = trajectories.course.sample(t, &mut self.centres);
        self.carried = trajectories.carried_at(t).x;
        for centre in &mut self.centres {
            *centre -= self.carried;
        }
    }
}

/// Time of a sample of a step [s].
fn time_of(sample: usize, start: f64, h: f64) -> f64 {
    match sample {
        3 => start + h,
        ASIDE_SAMPLE => start + ASIDE * h,
        _ => start + SAMPLES[sample] * h,
    }
}

/// Whether the weight has a kink at the rim, at which a step must end.
pub fn has_kink(weight: Weight) -> bool {
    weight == Weight::Linear
}

/// Positions of spheres relative to vertices at any instant of an interval, and the data for computing them.
#[derive(Clone, Copy)]
pub struct Trajectories<'a> {
    /// The body's course.
    pub course: &'a Course<'a>,
    /// The step over all of the interval.
    pub whole: &'a Step,
    /// The shared response of all vertices at the interval's start.
    pub carried: State,
}

/// Position of a sphere during a step relative to a vertex, without the vertex's own displacement.
pub enum Apart<'a> {
    /// Coefficients of a polynomial in the time since the step's start over the step's length.
    Quartic([DVec3; 5]),
    /// Evaluated from the paths.
    Exact(ExactPath<'a>),
}

/// [`Apart`] where a polynomial is not accurate enough.
pub struct ExactPath<'a> {
    trajectories: Trajectories<'a>,
    vertex: &'a Vertex,
    sphere: usize,
}

impl<'a> Trajectories<'a> {
    /// The position of sphere `sphere` relative to a vertex, over a part of the interval.
    pub fn apart(self, vertex: &'a Vertex, sphere: usize, start: f64, h: f64) -> Apart<'a> {
        let whole = self.whole;
        if !whole.smooth {
            return Apart::Exact(ExactPath { trajectories: self, vertex, sphere });
        }
        let known = std::array::from_fn(|sample| whole.moments[sample].centres[sphere] - vertex.rest);
        let mut c = quartic_through(&known);
        if start != whole.start || h != whole.h {
            // the same polynomial in the time of the part: shifted by theta₀ (Horner) and rescaled
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

    /// Sets a moment to time `t` [s] of the interval.
    pub fn sample_at(self, t: f64, moment: &mut Moment) {
        let whole = self.whole;
        if whole.smooth {
            whole.interpolate((t - whole.start) / whole.h, moment);
        } else {
            moment.sample(self, t);
        }
    }

    /// The shared response of all vertices at `t` [s].
    fn carried_at(&self, t: f64) -> State {
        let Trajectories { course, whole, carried } = *self;
        let forces = whole.uniforms();
        if t <= whole.start || (carried.is_zero() && forces == [DVec3::ZERO; 4]) {
            return carried;
        }
        Dense::new(course.oscillator(), whole.h, (t - whole.start) / whole.h).state(carried, &forces)
    }
}

impl ExactPath<'_> {
    /// Position [scene unit] and velocity [scene unit/s] at `t` [s].
    pub fn at(&self, t: f64) -> (DVec3, DVec3) {
        let course = self.trajectories.course;
        let (own, other) = (course.path(course.index).at(t), course.sphere_path(self.sphere).at(t));
        let State { x, u } = self.trajectories.carried_at(t);
        let x = self.vertex.rest + x;
        (other.position - own.position - x, other.velocity - own.velocity - u)
    }
}
