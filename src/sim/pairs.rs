//! Pairs of bodies that can touch in a step, with the phases of those known.

use std::ops::Range;

use super::{
    Span,
    body::Body,
    events::PairPaths,
    reach::{Ball, Sweep},
};
use crate::{
    model::phase::Phase,
    scene::{Response, Scene},
};

/// Two bodies that can touch in the current step.
#[derive(Clone, Debug)]
pub(super) struct Pair {
    /// Index of one body …
    pub a: u32,
    /// … and of the other, a < b.
    pub b: u32,
    /// At the start of the step, and at its end once it is done.
    pub phase: Phase,
    /// The phase changes within the step, into the world's list of them.
    pub changes: Range<usize>,
}

/// The paths of two bodies of a scene.
pub(super) fn paths(scene: &Scene, a: u32, b: u32) -> PairPaths<'_> {
    let (a, b) = (&scene.bodies[a as usize], &scene.bodies[b as usize]);
    PairPaths { a: &a.path, b: &b.path, radii: a.radius + b.radius }
}

/// Finds the pairs; reused from step to step.
#[derive(Default)]
pub(super) struct PairFinder {
    sweep: Sweep,
    balls: Vec<Ball>,
    pull: Vec<f64>,
    found: Vec<(u32, u32)>,
    known: Vec<Pair>,
}

impl PairFinder {
    /// Makes `pairs` those that can touch, or change phase, during `span`, in ascending order; a pair that was known
    /// keeps its phase, one that is not apart stays known however far it is.
    pub fn find(&mut self, scene: &Scene, bodies: &[Body], pairs: &mut Vec<Pair>, span: Span) {
        self.find_overlapping(scene, bodies, pairs, span);

        std::mem::swap(pairs, &mut self.known);
        pairs.clear();
        let mut known = self.known.iter().peekable();
        let merged = |pair: &&Pair| pair.phase != Phase::Apart;
        for &(a, b) in &self.found {
            while let Some(pair) = known.next_if(|pair| (pair.a, pair.b) < (a, b)) {
                pairs.extend(Some(pair).filter(merged).cloned());
            }
            let phase = match known.next_if(|pair| (pair.a, pair.b) == (a, b)) {
                Some(pair) => pair.phase,
                None if span.start == 0.0 => scene.thresholds.initial(paths(scene, a, b).q(0.0)),
                None => Phase::Apart,
            };
            pairs.push(Pair { a, b, phase, changes: 0..0 });
        }
        pairs.extend(known.filter(merged).cloned());
    }

    /// Fills `found`. How far a body's vertices can get depends on who can pull them, which depends on how far they can
    /// get: begin with the neighbours known, and look again as long as new ones can pull harder.
    fn find_overlapping(&mut self, scene: &Scene, bodies: &[Body], known: &[Pair], span: Span) {
        let PairFinder { sweep, balls, pull, found, .. } = self;
        add_up_pull(scene, known.iter().map(|pair| (pair.a, pair.b)), bodies.len(), pull);
        loop {
            let assumed = std::mem::take(pull);
            balls.clear();
            balls.extend((0..bodies.len()).map(|i| ball(scene, &bodies[i], i, assumed[i], span)));
            found.clear();
            sweep.overlapping(balls, found);
            add_up_pull(scene, found.iter().copied(), bodies.len(), pull);
            if span.length() == 0.0 || pull.iter().zip(&assumed).all(|(needed, assumed)| needed <= assumed) {
                return;
            }
            for (needed, assumed) in pull.iter_mut().zip(&assumed) {
                *needed = needed.max(*assumed);
            }
        }
    }
}

/// Everything that body `index` acts on or is acted on at during `span`, if influence pulls it by up to `pull`.
fn ball(scene: &Scene, body: &Body, index: usize, pull: f64, span: Span) -> Ball {
    let this = &scene.bodies[index];
    let motion = this.path.bounds(span.start, span.end);
    let force = pull + own_force(scene, body, index, span);
    let vertices = this.radius + body.extent.after(body.oscillator, force, span.length());
    let sphere = scene.influence.sphere_radius(this.radius);
    let merging = scene.thresholds.merge_at * this.radius;
    let centre = this.path.position(span.start);
    let radius = sphere.max(vertices).max(merging) + motion.speed * span.length();
    // A pair that stands exactly on merge_at is not lost to rounding.
    let rounding = 4.0 * f64::EPSILON * (centre.abs().max_element() + radius);
    Ball { centre, radius: radius + rounding }
}

/// A bound of the acceleration of any vertex by pushes and by the body's own motion during `span` [scene unit/s²].
pub(super) fn own_force(scene: &Scene, body: &Body, index: usize, span: Span) -> f64 {
    let this = &scene.bodies[index];
    let motion = this.path.bounds(span.start, span.end);
    let carry = match this.material.response {
        Response::Rigid => 0.0,
        Response::Inertial => motion.acceleration,
        Response::World => motion.acceleration + 2.0 * this.material.damping * motion.speed,
    };
    let acting = body.pushes.iter().filter(|push| push.start < span.end && span.start < push.end());
    carry + acting.map(|push| push.strength.abs()).sum::<f64>()
}

/// A bound of the acceleration of any vertex of body `this` by the sphere of body `source`, in any phase
/// [scene unit/s²].
pub(super) fn strongest_pull(scene: &Scene, this: u32, source: u32) -> f64 {
    let (radius, source) = (scene.bodies[this as usize].radius, scene.bodies[source as usize].radius);
    let strength = [Phase::Merged, Phase::Apart, Phase::Core]
        .map(|phase| scene.influence.strength(phase, radius, source).abs())
        .into_iter()
        .fold(0.0, f64::max);
    strength * scene.influence.sphere_radius(source) * scene.influence.weight.max_pull()
}

/// Bounds of the acceleration of any vertex of each body by the influence of the pairs given [scene unit/s²].
fn add_up_pull(scene: &Scene, pairs: impl Iterator<Item = (u32, u32)>, bodies: usize, pull: &mut Vec<f64>) {
    pull.clear();
    pull.resize(bodies, 0.0);
    for (a, b) in pairs {
        pull[a as usize] += strongest_pull(scene, a, b);
        pull[b as usize] += strongest_pull(scene, b, a);
    }
}
