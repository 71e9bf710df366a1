//! Metaballs (2.2.3): a body is a density around its centre; the surface is the level set of the total density of all
//! bodies at a threshold. Blinn: *A Generalization of Algebraic Surface Drawing* (1982); Nishimura et al. (1985).
//!
//! | contents | module |
//! | --- | --- |
//! | the density of a ball | [`density`] |
//! | when two balls are joined | [`contact`] |
//! | the surface as a mesh, its volume, the distance between two balls | [`surface`] |
//!
//! A lone ball is the sphere of its body's radius; the support of its density is the influence sphere. Bodies follow their
//! paths. Nothing else moves: a metaball has no mass, so material, strengths, core and `[surface]` have no effect, neither have
//! pushes, planes, force points and gravity ([`Schema::warnings`] lists those in a scene), and free bodies are rejected.
//!
//! # Two criteria for merging
//! The scene's thresholds on the centre distance give `merge` and `split` events, at the same times as for the
//! oscillators. The surface has its own criterion: it joins when the density at the saddle between two centres reaches
//! the threshold. These instants are `touch` and `part` events, found to rounding.
//!
//! # The mesh of a body
//! Each vertex is on the ray of its rest position, where the density first falls below the threshold, or where another
//! ball becomes denser: the bodies' meshes divide the volume of merged balls between them. This mesh is drawn for a
//! single body; merged bodies are drawn by the surface of their group.

pub mod contact;
pub mod density;
pub mod surface;
#[cfg(test)]
mod tests;

use std::{
    collections::BTreeMap,
    mem::replace,
    time::{Duration, Instant as Clock},
};

use glam::DVec3;

use super::{Unsupported, key_of};
use crate::{
    colors,
    disjoint_sets::DisjointSets,
    geometry::Rest,
    hash,
    model::influence::Weight,
    observe::{
        BodyFrame, Frame, Instant, NearPair, Schema, Simulation, StepSummary, SurfaceEvent, Want,
        schema::{OwnSurfaces, ScalarOf, ScalarSchema, TermSchema},
        surface::Finding,
    },
    scene::{Body, Integrator, Model, Path, Scene},
    sim::{Options, World, numerics::roots::root},
    view,
};
use contact::are_one;
use density::{Ball, Kernel, density_of};
use surface::LevelSet;

/// Upper limit on the number of balls, as any two may interact.
const MAX_BODIES: usize = 2000;
/// Upper limit on the bisections of a step in which a pair joins or separates.
const MAX_HALVINGS: u32 = 200;
/// Within a step, a pair is sampled once per this much relative motion [smaller radius], evenly in time, …
const FAR: f64 = 0.1;
/// … at most so often.
const MAX_SAMPLES: f64 = 256.0;
/// Number of samples on the ray of a vertex, within the support of its body.
const SAMPLES: u32 = 24;
/// Metaballs on their paths.
pub struct Metaballs {
    scene: Scene,
    /// The density of each body.
    kernels: Vec<Kernel>,
    /// The paths, and the phases given by the thresholds on q.
    world: World,
    /// Current centres of the bodies [scene unit].
    centres: Vec<DVec3>,
    /// Known pairs, and whether their surfaces are joined.
    ones: BTreeMap<[usize; 2], bool>,
    /// Pairs that joined or separated in the last step.
    contacts: Vec<SurfaceEvent>,
    /// Time spent finding them.
    finding: Duration,
}

impl Metaballs {
    /// The scene at t = 0.
    ///
    /// # Errors
    /// A message: metaballs do not support a part of the scene, or it is too large for this machine.
    pub fn new(scene: &Scene, options: Options) -> Result<Metaballs, String> {
        let kernels = kernels(scene).map_err(|error| error.to_string())?;
        let world = World::with_options(scene.without_forces(), options).map_err(|error| error.to_string())?;
        let mut balls = Metaballs {
            scene: scene.clone(),
            kernels,
            world,
            centres: Vec::new(),
            ones: BTreeMap::new(),
            contacts: Vec::new(),
            finding: Duration::ZERO,
        };
        balls.centres = balls.centres_at(0.0);
        for pair in balls.near() {
            let is_one = balls.are_one(pair, &balls.centres);
            balls.ones.insert(pair, is_one);
        }
        Ok(balls)
    }

    fn centres_at(&self, time: f64) -> Vec<DVec3> {
        self.scene.bodies.iter().map(|body| path(body).position(time)).collect()
    }

    /// The pairs whose surfaces may be joined now.
    fn near(&self) -> Vec<[usize; 2]> {
        self.world.pairs().map(|pair| [pair.a, pair.b]).collect()
    }

    fn around(&self, group: &[usize], centres: &[DVec3]) -> Vec<Ball> {
        around(centres.len(), |body| self.ball(body, centres), group)
    }

    fn are_one(&self, pair: [usize; 2], centres: &[DVec3]) -> bool {
        are_one(&self.around(&pair, centres))
    }

    /// Like [`Metaballs::are_one`] at a time; where the distance of the two tells, the others are not looked at.
    fn are_one_at(&self, pair: [usize; 2], time: f64) -> bool {
        let [one, other] = pair.map(|body| path(&self.scene.bodies[body]).position(time));
        let [one_ball, other_ball] = pair.map(|body| self.ball(body, &self.centres));
        let distance = one.distance(other);
        if distance <= one_ball.radius + other_ball.radius {
            true
        } else if distance >= one_ball.support() + other_ball.support() {
            false
        } else if time == self.world.time() {
            self.are_one(pair, &self.centres)
        } else {
            self.are_one(pair, &self.centres_at(time))
        }
    }

    /// Finds the pairs that joined or separated in the step that began at `start`.
    fn find_contacts(&mut self, start: f64) {
        self.contacts.clear();
        let (end, step) = (self.world.time(), self.world.steps_taken());
        if self.scene.bodies.iter().all(|body| path(body).is_still(start, end)) {
            return;
        }
        let centres = self.centres_at(end);
        let before = replace(&mut self.centres, centres);
        let mut ones: BTreeMap<[usize; 2], bool> = BTreeMap::new();
        let known = self.ones.iter().filter(|(_, is_one)| **is_one).map(|(pair, _)| *pair);
        let met = self.world.report().events.iter().map(|event| [event.a as usize, event.b as usize]);
        let pairs: Vec<[usize; 2]> = self.near().into_iter().chain(known).chain(met).collect();
        for pair in pairs {
            if ones.contains_key(&pair) {
                continue;
            }
            let was = self.ones.get(&pair).copied().unwrap_or(false);
            // visits that are shorter than the step are found where the centres are nearest or farthest, and on long
            // ways
            let [a, b] = pair;
            let near =
                |centres: &[DVec3]| NearPair { a, b, phase: 0, apart: centres[b] - centres[a], rate: DVec3::ZERO };
            let (from, to, ends) = (near(&before), near(&self.centres), [start, end]);
            let [turn, _] = from.extremum(&to, &self.world, ends, was);
            let smaller = f64::min(self.scene.bodies[a].radius, self.scene.bodies[b].radius);
            let count = (from.path_length(&to, &self.world, ends) / (FAR * smaller)).min(MAX_SAMPLES) as u32;
            let mut times: Vec<f64> =
                (1..=count).map(|k| start + f64::from(k) / f64::from(count + 1) * (end - start)).collect();
            times.extend([turn, end]);
            times.retain(|time| start < *time && *time <= end);
            times.sort_by(f64::total_cmp);
            let (mut known, mut since) = (was, start);
            for time in times {
                let is_one = self.are_one_at(pair, time);
                if is_one != known {
                    self.find_contact(pair, known, [since, time], step);
                }
                (known, since) = (is_one, time);
            }
            ones.insert(pair, known);
        }
        self.ones = ones;
        self.contacts.sort_by(|x, y| x.time.total_cmp(&y.time).then((x.a, x.b).cmp(&(y.a, y.b))));
    }

    /// Adds the event in which a pair, one or not at the first of two times in the step, becomes the other by the second.
    fn find_contact(&mut self, pair: [usize; 2], was: bool, [mut low, mut high]: [f64; 2], step: u64) {
        for _ in 0..MAX_HALVINGS {
            let middle = 0.5 * (low + high);
            if middle <= low || middle >= high {
                break;
            }
            if self.are_one(pair, &self.centres_at(middle)) == was { low = middle } else { high = middle }
        }
        let [a, b] = pair;
        let [one, other] = pair.map(|body| path(&self.scene.bodies[body]).position(high));
        let q = one.distance(other) / (self.scene.bodies[a].radius + self.scene.bodies[b].radius);
        let what = if was { Finding::Part } else { Finding::Touch };
        self.contacts.push(SurfaceEvent { what, time: high, step, a, b, q });
    }

    /// Number of connected components of the bodies, connected by joined pairs.
    fn components(&self) -> usize {
        let mut sets = DisjointSets::singletons(self.scene.bodies.len());
        for ([a, b], _) in self.ones.iter().filter(|(_, is_one)| **is_one) {
            sets.join(*a as u32, *b as u32);
        }
        sets.count
    }

    /// Writes the vertices of a body to its frame, given its centre and those of others.
    fn deform(&self, index: usize, centres: &[DVec3], time: f64, now: &mut BodyFrame) {
        let body = &self.scene.bodies[index];
        (now.centre, now.mesh) = (centres[index], None);
        let balls = self.around(&[index], centres);
        // a ball whose surface is not reached by any other density is a sphere
        let reaches =
            |other: &Ball| other.centre.distance(centres[index]) < (other.support() + body.radius) * (1.0 + 1e-12);
        if !balls[1..].iter().any(reaches) {
            now.rest();
            return;
        }
        let velocities = self.velocities(index, centres, time);
        let mesh = body.shape.mesh();
        let rest: Rest<'_> = mesh.at(body.radius);
        now.displacements.reset(rest.len());
        now.velocities.reset(rest.len());
        for i in 0..rest.len() {
            let direction = rest.direction(i);
            let (length, rate) = self.ray(&balls, &velocities, direction);
            let is_same = (length - body.radius).abs() <= 1e-14 * body.radius;
            let moved = if is_same { DVec3::ZERO } else { (length - body.radius) * direction };
            now.displacements.set(i, moved);
            now.velocities.set(i, rate * direction);
        }
        now.displaced(rest);
    }

    /// Velocities of a body and of those around it, in the order of [`Metaballs::around`].
    fn velocities(&self, index: usize, centres: &[DVec3], time: f64) -> Vec<DVec3> {
        let of = |body: usize| path(&self.scene.bodies[body]).at(time).velocity;
        near(centres.len(), |body| self.ball(body, centres), &[index]).map(of).collect()
    }

    fn ball(&self, body: usize, centres: &[DVec3]) -> Ball {
        Ball { centre: centres[body], radius: self.scene.bodies[body].radius, kernel: self.kernels[body] }
    }

    /// Distance of the surface along a ray from the first ball's centre [scene unit], and its rate of change
    /// [scene unit/s].
    fn ray(&self, balls: &[Ball], velocities: &[DVec3], direction: DVec3) -> (f64, f64) {
        let Some((own, others)) = balls.split_first() else { return (0.0, 0.0) };
        let densest = |at: DVec3| others.iter().map(|ball| ball.density(at)).fold(0.0, f64::max);
        let excess = |at: DVec3| density_of(balls, at) - 1.0;
        let lead = |at: DVec3| own.density(at) - densest(at);
        let place = |r: f64| own.centre + r * direction;
        let both = |r: f64| f64::min(excess(place(r)), lead(place(r)));
        let step = own.support() / f64::from(SAMPLES);
        let Some(outside) = (1..=SAMPLES).find(|&k| both(f64::from(k) * step) < 0.0) else {
            return (own.support(), 0.0);
        };
        let high = f64::from(outside) * step;
        let r = root(high - step, high, both);
        let at = place(r);
        // d/dt of F − 1 or the lead, whichever is zero there: the point moves with the centre, and along the ray
        let mut slopes: Vec<DVec3> = balls.iter().map(|ball| ball.slope(at)).collect();
        if lead(at) < excess(at) {
            let highest = densest(at);
            for (ball, slope) in balls.iter().zip(&mut slopes).skip(1) {
                *slope = if ball.density(at) == highest { -*slope } else { DVec3::ZERO };
            }
        }
        let along = slopes.iter().sum::<DVec3>().dot(direction);
        let moved = slopes.iter().zip(velocities).map(|(slope, velocity)| slope.dot(velocities[0] - *velocity));
        let rate = -moved.sum::<f64>() / along;
        (r, if rate.is_finite() { rate } else { 0.0 })
    }
}

impl Simulation for Metaballs {
    fn schema(&self) -> Schema {
        schema(&self.scene)
    }

    fn overrides(&self, steps: Option<u64>) -> Result<String, String> {
        self.scene.overrides(steps)
    }

    fn steps_taken(&self) -> u64 {
        self.world.steps_taken()
    }

    fn time(&self) -> f64 {
        self.world.time()
    }

    fn step(&mut self, summary: &mut StepSummary) {
        let start = self.world.time();
        self.contacts.clear();
        if self.world.step().failure.is_none() {
            let clock = Clock::now();
            self.find_contacts(start);
            self.finding = clock.elapsed();
        }
        view::summarise(&self.world, summary);
        let paths = summary.timings.iter().sum();
        summary.timings.clear();
        summary.timings.extend([paths, self.finding]);
        summary.scalars.clear();
        summary.scalars.resize(SCALARS.len(), 0.0);
        summary.shortfall = None;
    }

    fn interrupt(&self) -> Option<&'static std::sync::atomic::AtomicBool> {
        self.world.options().interrupt
    }

    fn checksum(&self) -> u64 {
        let centres = self.centres.iter().flat_map(|centre| centre.to_array()).map(hash::bits);
        let ones = self.ones.iter().filter(|(_, is_one)| **is_one);
        let ones = ones.map(|([a, b], _)| (*a as u64) << 32 | *b as u64);
        hash::sequence(std::iter::once(World::checksum(&self.world)).chain(centres).chain(ones))
    }

    fn observe(&self, want: Want, frame: &mut Frame) {
        let time = self.world.time();
        frame.at = Instant { step: self.world.steps_taken(), time };
        self.world.observe(Want::default(), frame);
        for (index, now) in frame.bodies.iter_mut().enumerate() {
            self.deform(index, &self.centres, time, now);
            now.clear_forces();
        }
        frame.scalars.clear();
        if want.scalars {
            let bodies = frame.bodies.iter().zip(&self.scene.bodies);
            let largest = bodies.map(|(now, body)| now.max_displacement / body.radius).fold(0.0, f64::max);
            let ones = self.ones.values().filter(|is_one| **is_one).count();
            frame.scalars.extend([largest, self.components() as f64, ones as f64]);
        }
    }

    fn within(&self, before: &Frame, time: f64, bodies: &[usize], frame: &mut Frame) {
        frame.at = Instant { step: before.at.step + 1, time };
        frame.bodies.resize_with(self.scene.bodies.len(), BodyFrame::default);
        let centres = self.centres_at(time);
        for (now, centre) in frame.bodies.iter_mut().zip(&centres) {
            now.centre = *centre; // all contribute to the density
        }
        bodies.iter().for_each(|&body| self.deform(body, &centres, time, &mut frame.bodies[body]));
    }

    fn near(&self, pairs: &mut Vec<NearPair>) {
        self.world.near(pairs);
    }

    fn reach(&self, a: usize, b: usize) -> f64 {
        self.world.reach(a, b)
    }

    fn on_path(&self, body: usize, time: f64) -> Option<[DVec3; 2]> {
        self.world.on_path(body, time)
    }

    fn contacts(&self) -> Option<&[SurfaceEvent]> {
        Some(&self.contacts)
    }

    fn framing(&self, only_what_happens: bool) -> Vec<(DVec3, f64)> {
        self.world.framing(only_what_happens)
    }
}

/// Name, plot and label of each scalar.
pub const SCALARS: [[&str; 3]; 3] = [
    ["max_displacement", "Displacement", "largest displacement [radii]"],
    ["components", COUNTS, "pieces of the surface"],
    ["pairs_in_one", COUNTS, "pairs that are one surface"],
];
const COUNTS: &str = "Counts";

/// The schema of a scene's metaballs.
pub fn schema(scene: &Scene) -> Schema {
    let oscillators = view::schema(scene);
    let net =
        TermSchema { can_act: false, is_shown: false, is_sum: true, ..TermSchema::new("net", "Net", colors::MAGENTA) };
    let mut warnings = oscillators.warnings;
    warnings.extend(idle(scene));
    Schema {
        model: Model::Metaballs.name().to_owned(),
        integrator: "exact".to_owned(),
        law: format!(
            "Density f(r) = (1 − r²/r_e²)³ about each centre, r_e: radius of its influence sphere; on the surface, the sum \
             equals the density of a lone ball at its radius. No dynamics. {}",
            oscillators.law
        ),
        terms: vec![net],
        labels: vec!["no force"],
        scalars: SCALARS.map(scalar).into(),
        stages: vec!["paths", "contacts"],
        surfaces: kernels(scene)
            .map_or_else(|_| OwnSurfaces::default(), |kernels| OwnSurfaces::new(LevelSet { kernels })),
        warnings,
        ..oscillators
    }
}

fn scalar([name, plot, label]: [&'static str; 3]) -> ScalarSchema {
    ScalarSchema { plot, is_smooth: plot != COUNTS, ..ScalarSchema::new(name, label, ScalarOf::State) }
}

/// Warnings about parts of a scene that have no effect here.
fn idle(scene: &Scene) -> Option<String> {
    let given = [
        (!scene.points.is_empty(), "[[point]]"),
        (!scene.pushes.is_empty(), "[[push]]"),
        (!scene.planes.is_empty(), "[[plane]]"),
        (scene.gravity != DVec3::ZERO, "gravity"),
        (scene.influence.weight != Weight::Linear, "influence.weight"),
        (scene.integrator != Integrator::Exponential, "integrator"),
        (scene.tolerance != Scene::DEFAULT_TOLERANCE, "tolerance"),
    ];
    let given: Vec<&str> = given.into_iter().filter(|(is_given, _)| *is_given).map(|(_, name)| name).collect();
    (!given.is_empty())
        .then(|| format!("metaballs have no dynamics: this model ignores {} of the scene", given.join(", ")))
}

/// The density of a scene's balls.
///
/// # Errors
/// The scene has something that metaballs do not support.
fn kernels(scene: &Scene) -> Result<Vec<Kernel>, Unsupported> {
    check(scene)?;
    Ok(scene.bodies.iter().filter_map(|body| Kernel::new(body.reach)).collect())
}

/// Rejects what metaballs do not support.
///
/// # Errors
/// [`Unsupported`], naming the key.
pub fn check(scene: &Scene) -> Result<(), Unsupported> {
    if scene.bodies.len() > MAX_BODIES {
        let what = format!("it has {} bodies, and the limit is {MAX_BODIES}", scene.bodies.len());
        return Err(Unsupported::new(scene, "body", what, "use fewer"));
    }
    for body in &scene.bodies {
        if body.path().is_none() {
            let (key, what) = (key_of(body, "motion.free"), "a density has no mass, so forces cannot move it");
            return Err(Unsupported::new(scene, key, what, "give it a path, or choose model = \"oscillators\""));
        }
        if !body.shape.mesh().is_round() {
            let what = "the density is that of a ball, which this shape is not";
            let remedy = "use shape = { sphere … }, or choose model = \"lattice\", \"fem\" or \"oscillators\"";
            return Err(Unsupported::new(scene, key_of(body, "shape"), what, remedy));
        }
        if Kernel::new(body.reach).is_none() {
            let what = format!("{}: a density that ends within the ball has no surface", body.reach);
            return Err(Unsupported::new(scene, key_of(body, "reach"), what, "give a reach above 1"));
        }
    }
    Unsupported::edits(scene)
}

fn path(body: &Body) -> &Path {
    const STILL: &Path = &Path::Fixed(DVec3::ZERO);
    body.path().unwrap_or(STILL) // free bodies are rejected
}

/// The bodies of a group, followed by all others whose supports reach theirs, in ascending order.
fn near<'a>(count: usize, ball: impl Fn(usize) -> Ball + 'a, group: &'a [usize]) -> impl Iterator<Item = usize> + 'a {
    let touches = move |body: usize| {
        let other = ball(body);
        let reach = |of: &Ball| other.support() + of.support();
        group.iter().map(|&own| ball(own)).any(|of| other.centre.distance_squared(of.centre) < reach(&of) * reach(&of))
    };
    group.iter().copied().chain((0..count).filter(move |body| !group.contains(body) && touches(*body)))
}

/// The balls of a group, followed by all others whose supports reach theirs.
fn around(count: usize, ball: impl Fn(usize) -> Ball, group: &[usize]) -> Vec<Ball> {
    near(count, &ball, group).map(&ball).collect()
}
