//! Pairs of bodies that can touch in a step, with the phases of those known.

use std::ops::Range;

use glam::DVec3;

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
    places: Vec<Place>,
    balls: Vec<Ball>,
    /// Bounds of the acceleration of the vertices of each body by influence, in the step before [scene unit/s²].
    pull: Vec<f64>,
    found: Vec<(u32, u32)>,
    known: Vec<Pair>,
}

impl PairFinder {
    /// Makes `pairs` those that can touch, or change phase, during `span`, in ascending order; a pair that was known
    /// keeps its phase, one that is not apart stays known however far it is.
    pub fn find(&mut self, scene: &Scene, bodies: &[Body], pairs: &mut Vec<Pair>, span: Span) {
        self.find_overlapping(scene, bodies, span);

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
    /// get. Who can at all is found among those near enough if the pull were that of the step before, starting from no
    /// pull: a sphere that cannot reach where the others can pull a vertex cannot be the first to do so, so never does.
    /// If that comes to more than before, those near enough are looked for again.
    fn find_overlapping(&mut self, scene: &Scene, bodies: &[Body], span: Span) {
        let PairFinder { sweep, places, balls, pull, found, .. } = self;
        pull.resize(bodies.len(), 0.0);
        loop {
            let assumed = std::mem::take(pull);
            places.clear();
            places.extend((0..bodies.len()).map(|i| Place::of(scene, &bodies[i], i, assumed[i], span)));
            balls.clear();
            balls.extend(scene.bodies.iter().zip(&*places).map(|(body, place)| place.ball(scene, body.radius)));
            found.clear();
            sweep.overlapping(balls, found);

            *pull = least_pull(scene, bodies, found, places, span);
            if pull.iter().zip(&assumed).all(|(needed, assumed)| needed <= assumed) {
                break;
            }
            for (needed, assumed) in pull.iter_mut().zip(&assumed) {
                *needed = needed.max(*assumed);
            }
        }
        for place in places.iter_mut() {
            place.vertices = place.vertices.max(place.swing);
        }
        found.retain(|&(a, b)| {
            let [at, other] = [a, b].map(|i| &places[i as usize]);
            let merging = scene.thresholds.merge_at * paths(scene, a, b).radii;
            let can_merge = at.nearest(other) <= merging + at.rounding(other);
            can_merge || reaches(scene, places, a, b) || reaches(scene, places, b, a)
        });
    }
}

/// The pull on each body by those among `found` that can reach it, if only those pull that can; `places` become those
/// that this leaves.
fn least_pull(scene: &Scene, bodies: &[Body], found: &[(u32, u32)], places: &mut [Place], span: Span) -> Vec<f64> {
    let mut pull = vec![0.0; bodies.len()];
    for (i, place) in places.iter_mut().enumerate() {
        place.vertices = farthest_vertex(scene, &bodies[i], i, 0.0, span);
    }
    loop {
        let mut next = vec![0.0; bodies.len()];
        for &(a, b) in found {
            for (this, source) in [(a, b), (b, a)] {
                if reaches(scene, places, this, source) {
                    next[this as usize] += strongest_pull(scene, this, source);
                }
            }
        }
        if next == pull {
            return pull;
        }
        for (i, place) in places.iter_mut().enumerate().filter(|&(i, _)| next[i] != pull[i]) {
            place.vertices = farthest_vertex(scene, &bodies[i], i, next[i], span);
        }
        pull = next;
    }
}

/// Whether the sphere of body `source` can reach vertices of body `this`.
fn reaches(scene: &Scene, places: &[Place], this: u32, source: u32) -> bool {
    let sphere = scene.influence.sphere_radius(scene.bodies[source as usize].radius);
    let [at, from] = [this, source].map(|i| &places[i as usize]);
    at.nearest(from) <= sphere + at.vertices + at.rounding(from)
}

/// How far from the centre of body `index` it can have vertices during `span` if influence pulls it by up to `pull`.
fn farthest_vertex(scene: &Scene, body: &Body, index: usize, pull: f64, span: Span) -> f64 {
    let force = pull + own_force(scene, body, index, span);
    scene.bodies[index].radius + body.extent.after(body.oscillator, force, span.length())
}

/// Where a body is during a step, and how far it gets.
#[derive(Clone, Copy, Debug)]
struct Place {
    /// Its centre at the start [scene unit].
    centre: DVec3,
    /// How far the centre can get [scene unit].
    travelled: f64,
    /// How far from the centre it can have vertices [scene unit].
    vertices: f64,
    /// How far from the centre they would swing by themselves: pairs within that stay known between two swings.
    swing: f64,
}

impl Place {
    /// Of body `index` during `span`, if influence pulls it by up to `pull` [scene unit/s²].
    fn of(scene: &Scene, body: &Body, index: usize, pull: f64, span: Span) -> Place {
        let path = &scene.bodies[index].path;
        Place {
            centre: path.position(span.start),
            travelled: path.bounds(span.start, span.end).speed * span.length(),
            vertices: farthest_vertex(scene, body, index, pull, span),
            swing: scene.bodies[index].radius + body.amplitude(),
        }
    }

    /// The nearest that two centres can come.
    fn nearest(&self, other: &Place) -> f64 {
        self.centre.distance(other.centre) - (self.travelled + other.travelled)
    }

    /// What rounding of the centres can do to that: a pair that stands exactly on a threshold is not lost to it.
    fn rounding(&self, other: &Place) -> f64 {
        let far = |place: &Place| place.centre.abs().max_element() + place.vertices.max(place.swing) + place.travelled;
        8.0 * f64::EPSILON * (far(self) + far(other))
    }

    /// Everything that the body acts on or is acted on at, or can merge in.
    fn ball(&self, scene: &Scene, radius: f64) -> Ball {
        let sphere = scene.influence.sphere_radius(radius);
        let merging = scene.thresholds.merge_at * radius;
        let reach = sphere.max(self.vertices).max(self.swing).max(merging) + self.travelled;
        Ball { centre: self.centre, radius: reach + self.rounding(self) }
    }
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
