//! The frames of moving bodies during a step, evaluated once per step and shared.

use glam::DVec3;
use rayon::prelude::*;

use crate::{
    scene::{
        Material, Path, Response, Scene,
        path::{Bounds, Kinematics, Turns},
    },
    sim::{events::PairPaths, numerics::nodes::SAMPLES, span::Span, terms},
};

/// With fewer moving bodies than this, a second thread does not pay off.
const PARALLEL_TRACKS: usize = 256;
/// Mover index of a body that never moves.
const STILL: u32 = u32::MAX;

/// The tracks of all bodies, and of the force points, which follow them.
#[derive(Clone)]
pub struct Tracks {
    /// The path of each body.
    paths: Vec<Path>,
    /// Number of bodies.
    bodies: usize,
    /// The bodies that move, ascending.
    movers: Vec<Mover>,
    /// Motion bounds of each body, contiguous because neighbours look each other up in every step.
    motion_bounds: Vec<MotionBounds>,
    /// Index in `movers` of each body, or [`STILL`].
    of_body: Vec<u32>,
    /// The acceleration that the vertices of a body that never moves share [scene unit/s²].
    uniform_still: DVec3,
}

/// Bounds of a body's motion and extent during a step.
#[derive(Clone, Copy, Debug)]
pub struct MotionBounds {
    /// Its centre at the start of the step [scene unit].
    pub centre: DVec3,
    /// A bound on the distance that it moves from there within the step, divided by the step length [scene unit/s].
    pub speed: f64,
    /// Its radius [scene unit].
    pub radius: f64,
    /// The radius of its influence sphere [scene unit].
    pub sphere: f64,
}

impl MotionBounds {
    /// Those of a body or force point that is at `centre`, before a step.
    fn new(scene: &Scene, source: usize, centre: DVec3) -> MotionBounds {
        let (radius, sphere) = (scene.source_radius(source), scene.source_sphere_radius(source));
        MotionBounds { centre, speed: 0.0, radius, sphere }
    }

    /// Lower bound of the distance of two centres within `h` [s], allowing for rounding [scene unit].
    #[inline]
    pub fn nearest(&self, other: &MotionBounds, h: f64) -> f64 {
        let distance = self.centre.distance(other.centre);
        let far = self.centre.abs().max_element() + other.centre.abs().max_element() + distance;
        distance - (self.speed + other.speed) * h - 8.0 * f64::EPSILON * far
    }
}

/// A body's motion at each of a step's [`SAMPLES`].
#[derive(Clone, Copy, Debug)]
pub struct Samples {
    /// Its centre [scene unit].
    pub positions: [DVec3; 5],
    /// The acceleration that all its vertices share [scene unit/s²].
    pub uniform: [DVec3; 5],
}

/// A moving body during a step.
#[derive(Clone)]
pub struct Mover {
    /// Index of the body.
    pub body: u32,
    /// Whether something may happen between the body and its neighbours in the step, for [`Tracks::watch`].
    pub is_watched: bool,
    turns: Turns,
    /// The constants of its oscillators.
    material: Material,
    /// Upper bound of the distance between any two positions of its centre [scene unit].
    extent: f64,
    /// Whether the body stands still in the step.
    stands_still: bool,
    /// Whether it stands still and did so in the step before: nothing changes for its neighbours.
    pub is_idle: bool,
    /// Whether derivatives of the motion jump somewhere.
    has_breaks: bool,
    /// The body's motion over the step.
    samples: Samples,
    /// Bounds of the motion over the step.
    pub bounds: Bounds,
    /// A bound on the sum of the jumps of the velocity in the step, including one at its start [scene unit/s].
    pub kicks: f64,
}

/// The material of a force point, and of a body that never moves: no motion of its own acts on it.
const RIGID: Material = Material { omega: 0.0, damping: 0.0, response: Response::Rigid };

impl Mover {
    /// A body or force point before a step.
    fn new(scene: &Scene, body: u32, path: &Path) -> Mover {
        Mover {
            body,
            is_watched: false,
            turns: path.turns(&SAMPLES.map(|theta| theta * scene.dt)),
            material: scene.bodies.get(body as usize).map_or(RIGID, |body| body.material),
            extent: path.extent(),
            stands_still: false,
            is_idle: false,
            has_breaks: !path.knots().is_empty(),
            samples: Samples { positions: [path.position(0.0); 5], uniform: [DVec3::ZERO; 5] },
            bounds: Bounds { speed: 0.0, acceleration: 0.0 },
            kicks: 0.0,
        }
    }
}

impl Tracks {
    /// The tracks of a scene, all of whose bodies are on paths, before the first step.
    pub(in crate::sim) fn new(scene: &Scene) -> Tracks {
        let sources = 0..scene.bodies.len() + scene.points.len();
        let paths: Vec<Path> = sources.clone().filter_map(|source| scene.source_path(source).cloned()).collect();
        let mut of_body = vec![STILL; paths.len()];
        let mut movers = Vec::new();
        let motion_bounds =
            sources.zip(&paths).map(|(source, path)| MotionBounds::new(scene, source, path.position(0.0))).collect();
        for (body, mover) in (0..).zip(&mut of_body) {
            let path = &paths[body as usize];
            if !path.is_fixed() {
                *mover = movers.len() as u32;
                movers.push(Mover::new(scene, body, path));
            }
        }
        let still = Kinematics { position: DVec3::ZERO, velocity: DVec3::ZERO, acceleration: DVec3::ZERO };
        let uniform_still = terms::uniform(scene, &RIGID, &still);
        Tracks { paths, bodies: scene.bodies.len(), movers, motion_bounds, of_body, uniform_still }
    }

    /// Adds the track of a body of the scene at `time` [s], before those of later ones.
    pub(in crate::sim) fn insert(&mut self, scene: &Scene, body: usize, time: f64) {
        let Some(path) = scene.source_path(body).cloned() else { return };
        self.bodies += 1;
        self.motion_bounds.insert(body, MotionBounds::new(scene, body, path.position(time)));
        let slot = self.movers.partition_point(|track| (track.body as usize) < body);
        self.movers[slot..].iter_mut().for_each(|track| track.body += 1);
        let mut own = STILL;
        if !path.is_fixed() {
            own = slot as u32;
            self.of_body.iter_mut().filter(|slot| **slot != STILL && **slot >= own).for_each(|slot| *slot += 1);
            self.movers.insert(slot, Mover::new(scene, body as u32, &path));
        }
        self.of_body.insert(body, own);
        self.paths.insert(body, path);
    }

    /// Removes the track of a body; the indices of later ones decrease by one.
    pub(in crate::sim) fn remove(&mut self, body: usize) {
        self.bodies -= 1;
        self.paths.remove(body);
        self.motion_bounds.remove(body);
        let own = self.of_body.remove(body);
        if own != STILL {
            self.movers.remove(own as usize);
            self.of_body.iter_mut().filter(|slot| **slot != STILL && **slot > own).for_each(|slot| *slot -= 1);
        }
        self.movers.iter_mut().filter(|track| track.body as usize > body).for_each(|track| track.body -= 1);
    }

    /// Evaluates the motion of all movers over a step.
    pub(in crate::sim) fn evaluate(&mut self, scene: &Scene, span: Span) {
        let paths = &self.paths;
        let evaluate = |track: &mut Mover| {
            let path = &paths[track.body as usize];
            let stands_still = path.is_still(span.start, span.end);
            track.is_idle = stands_still && track.stands_still;
            track.stands_still = stands_still;
            if track.is_idle {
                return;
            }
            let kinematics = path.kinematics(span.start, span.end, &SAMPLES, &track.turns);
            track.samples = Samples {
                positions: kinematics.map(|kinematics| kinematics.position),
                uniform: kinematics.map(|kinematics| terms::uniform(scene, &track.material, &kinematics)),
            };
            track.bounds = path.bounds(span.start, span.end);
            track.kicks = path.kicks(span.start, span.end);
        };
        each(&mut self.movers, evaluate);
        let h = span.length();
        for track in &self.movers {
            let motion_bounds = &mut self.motion_bounds[track.body as usize];
            motion_bounds.centre = track.samples.positions[0];
            let (speed, extent) = (track.bounds.speed, track.extent);
            // the extent is the tighter bound for a body that oscillates many times in a step
            motion_bounds.speed = if speed * h > extent { extent / h } else { speed };
        }
    }

    /// Selects the bodies that move for which `may` holds. For most, nothing changes relative to their neighbours.
    pub(in crate::sim) fn watch(&mut self, may: impl Fn(&Mover) -> bool + Sync + Send) {
        let bodies = self.bodies;
        each(&mut self.movers, |track| track.is_watched = (track.body as usize) < bodies && may(track));
    }

    /// The bodies that are watched, ascending.
    pub(in crate::sim) fn watched(&self) -> impl Iterator<Item = u32> + '_ {
        self.movers.iter().filter(|track| track.is_watched).map(|track| track.body)
    }

    /// The motion bounds of a body over the step.
    #[inline]
    pub fn motion_bounds(&self, body: u32) -> &MotionBounds {
        &self.motion_bounds[body as usize]
    }

    /// The mover of a body, if it moves.
    pub fn of(&self, body: usize) -> Option<&Mover> {
        self.movers.get(self.of_body[body] as usize)
    }

    /// The path of a body.
    pub fn path(&self, body: usize) -> &Path {
        &self.paths[body]
    }

    /// The paths of a pair of bodies, lower index first.
    pub fn pair(&self, i: u32, j: u32) -> PairPaths<'_> {
        let [a, b] = [i.min(j), i.max(j)].map(|body| body as usize);
        let radii = self.motion_bounds[a].radius + self.motion_bounds[b].radius;
        PairPaths { a: self.path(a), b: self.path(b), radii }
    }

    /// A body's motion at the step's [`SAMPLES`].
    #[inline]
    pub fn samples(&self, body: usize) -> Samples {
        let still = || Samples { positions: [self.motion_bounds[body].centre; 5], uniform: [self.uniform_still; 5] };
        self.of(body).map_or_else(still, |track| track.samples)
    }

    /// Instants at which a derivative of a body's motion jumps [s], ascending.
    #[inline]
    pub fn breaks(&self, body: u32) -> &[f64] {
        match self.of(body as usize) {
            Some(track) if track.has_breaks => self.paths[body as usize].knots(),
            _ => &[],
        }
    }

    /// Bounds of a body's motion over the step, if it moves.
    pub fn bounds(&self, body: usize) -> Option<Bounds> {
        self.of(body).map(|track| track.bounds)
    }
}

/// Applies `work` to all movers, on several threads if that pays off.
fn each(movers: &mut [Mover], work: impl Fn(&mut Mover) + Sync + Send) {
    if movers.len() < PARALLEL_TRACKS {
        movers.iter_mut().for_each(work);
    } else {
        movers.par_iter_mut().with_min_len(PARALLEL_TRACKS / 4).for_each(work);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Evaluating all samples at once equals evaluating each, to rounding.
    #[test]
    fn tracks_follow_their_paths() {
        for name in ["two", "three", "crowd", "size_ratio"] {
            let mut scene = Scene::builtin(name).unwrap();
            // so that velocities count
            scene.bodies.iter_mut().for_each(|body| body.material.response = crate::scene::Response::World);
            let mut tracks = Tracks::new(&scene);
            for step in 0..scene.steps() {
                let span = Span { start: step as f64 * scene.dt, end: (step + 1) as f64 * scene.dt };
                tracks.evaluate(&scene, span);
                for track in &tracks.movers {
                    let path = scene.bodies[track.body as usize].path().unwrap();
                    for (sample, theta) in SAMPLES.into_iter().enumerate() {
                        let (t, is_end) = (span.start + theta * scene.dt, theta == 1.0);
                        let exact = if is_end { path.before(span.end) } else { path.at(t) };
                        let Samples { positions, uniform } = track.samples;
                        let (position, carry) = (exact.position, terms::uniform(&scene, &track.material, &exact));
                        assert!(positions[sample].distance(position) < 1e-14 * position.length().max(1.0));
                        assert!(uniform[sample].distance(carry) < 1e-12 * carry.length().max(1.0));
                    }
                }
            }
        }
    }
}
