//! External accelerations of the nodes of a body.

use std::collections::BTreeMap;

use glam::{DQuat, DVec3};

use crate::{
    model::{influence::Weight, phase::Phase},
    observe::PairEvent,
    scene::{Path, Point, Push, Response, Scene, path::Kinematics},
    sim::{
        span::Span,
        terms::{Origin, Source},
    },
};

/// The motion of a centre in an interval, known in advance.
#[derive(Clone, Copy)]
pub enum Course<'a> {
    /// A path.
    Path(&'a Path),
    /// A constant acceleration, with the motion at a time [s].
    Parabola(f64, Kinematics),
}

impl Course<'_> {
    /// The motion at time `t` [s]; at `end` [s], that before any jump there.
    pub fn at(&self, t: f64, end: f64) -> Kinematics {
        match self {
            Course::Path(path) if t < end => path.at(t),
            Course::Path(path) => path.before(end),
            Course::Parabola(since, motion) => motion.after(t - since),
        }
    }
}

/// An interval in which the motion of all centres is known, and what all bodies share in it.
#[derive(Clone, Copy)]
pub struct StepContext<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// The centres of the bodies, then those of the force points.
    pub courses: &'a [Course<'a>],
    /// Phases at its start, of pairs that are not apart.
    pub phases: &'a BTreeMap<[u32; 2], Phase>,
    /// Phase changes in it, in order of time.
    pub events: &'a [PairEvent],
    /// Its start [s].
    pub start: f64,
    /// Its end [s].
    pub end: f64,
    /// Number of the step.
    pub step: u64,
}

/// What acts on a body at an instant, or on average over some time.
#[derive(Clone, Debug, Default)]
pub struct Instantaneous {
    /// The influence spheres, with strengths in proportion to the time during which they act.
    pub spheres: Vec<Source>,
    /// Pushes: direction and strength [scene unit/s²].
    pub pushes: Vec<(DVec3, f64)>,
    /// The acceleration that all nodes of a body on a path share [scene unit/s²].
    pub uniform: DVec3,
    /// Position of the centre [scene unit].
    pub centre: DVec3,
    /// The rotation of the body.
    pub rotation: DQuat,
}

/// External forces on the nodes of a body.
#[derive(Clone, Debug, Default)]
pub struct ExternalForces {
    /// f̄ of a free body, without friction [scene unit/s²].
    pub mean: DVec3,
    /// The share of friction in f̄ [scene unit/s²].
    pub rubbed: DVec3,
    /// Accelerations of the nodes by friction at the end of the last step [scene unit/s²], `[node_count]`; empty if there
    /// was none. Below `slip`, friction changes so fast with the velocity that it cannot be computed from the state.
    pub friction: Vec<DVec3>,
    /// Σ m f of each body's sphere [mass · scene unit/s²].
    pub pulls: Vec<(u32, DVec3)>,
    /// Accelerations of the nodes minus their mean [scene unit/s²], `[node_count]`; finite elements only.
    pub loads: Vec<DVec3>,
    /// Node positions at which they acted, relative to the centre [scene unit], `[node_count]`; finite elements only.
    pub places: Vec<DVec3>,
}

impl ExternalForces {
    /// Friction acted: accelerations of the nodes minus their mean, and that mean [scene unit/s²].
    pub fn rub(&mut self, friction: Vec<DVec3>, mean: DVec3) {
        self.friction = friction;
        self.friction.iter_mut().for_each(|of| *of += mean);
        self.rubbed = mean;
    }

    /// Nothing acts.
    pub fn clear(&mut self) {
        (self.mean, self.rubbed) = (DVec3::ZERO, DVec3::ZERO);
        self.friction.clear();
        self.pulls.clear();
        self.loads.clear();
        self.places.clear();
    }
}

impl StepContext<'_> {
    /// The phase of a pair at time `t` [s]; at a change, the new phase.
    fn phase(&self, a: usize, b: usize, t: f64) -> Phase {
        let pair = [a.min(b), a.max(b)];
        let changes = self.events.iter().take_while(|event| event.time <= t);
        let last = changes.filter(|event| [event.a, event.b] == pair).last();
        let before = || self.phases.get(&pair.map(|body| body as u32)).copied().unwrap_or(Phase::Apart);
        last.map_or_else(before, |event| Phase::ALL.get(event.to).copied().unwrap_or(Phase::Apart))
    }

    /// Whether nothing in the interval can deform a body at rest.
    pub fn is_calm(&self, index: usize, sources: &[u32], pushes: &[Push]) -> bool {
        let body = &self.scene.bodies[index];
        let is_still = |path: &Path| body.material.response == Response::Rigid || path.is_still(self.start, self.end);
        sources.iter().all(|&other| self.is_silent(index, other))
            && pushes.iter().all(|push| push.end() <= self.start || push.start >= self.end)
            && body.path().is_none_or(is_still)
    }

    /// The force point with a number as a source, if it is one.
    fn point(&self, source: u32) -> Option<&Point> {
        Some(&self.scene.points[(source as usize).checked_sub(self.scene.bodies.len())?])
    }

    /// Whether a sphere has no effect on a body throughout the interval.
    fn is_silent(&self, index: usize, source: u32) -> bool {
        let other = source as usize;
        self.point(source).is_none()
            && self.phase(index, other, self.start) == Phase::Apart
            && self.events.iter().all(|event| ![[index, other], [other, index]].contains(&[event.a, event.b]))
            && self.scene.law(index, other).strength(Phase::Apart, f64::INFINITY) == 0.0
    }

    /// Instants in the interval at which something that acts on a body jumps [s], including its start and end, ascending.
    pub fn breaks(&self, index: usize, sources: &[u32], pushes: &[Push]) -> Vec<f64> {
        let own = self.events.iter().filter(|event| event.a == index || event.b == index);
        let own = own.map(|event| event.time).filter(|&time| time > self.start && time < self.end);
        let jumps = self.jumps(sources.iter().copied().chain([index as u32]), pushes);
        let mut breaks: Vec<f64> = [self.start, self.end].into_iter().chain(own).chain(jumps).collect();
        breaks.sort_unstable_by(f64::total_cmp);
        breaks.dedup();
        breaks
    }

    /// Instants in the interval at which any body, force point or push jumps [s], its ends included.
    pub fn all_jumps(&self) -> Vec<f64> {
        self.jumps(0..(self.scene.bodies.len() + self.scene.points.len()) as u32, &self.scene.pushes)
    }

    /// Instants in the interval at which one of these bodies or force points jumps, or a push [s], its ends included.
    fn jumps(&self, sources: impl Iterator<Item = u32>, pushes: &[Push]) -> Vec<f64> {
        let mut jumps = Vec::new();
        Span { start: self.start, end: self.end }.jumps_of(self.scene, sources, &mut jumps);
        let of_pushes = pushes.iter().flat_map(|push| [push.start, push.end()]);
        jumps.extend(of_pushes.filter(|time| (self.start..=self.end).contains(time)));
        jumps
    }

    /// Calls `found` for each interval in which a pair stays in one phase, or in which a force point acts, with its start
    /// [s] and its fraction of the time; once if the two ends are one instant.
    fn by_share(&self, index: usize, other: u32, [start, end]: [f64; 2], mut found: impl FnMut(f64, f64)) {
        if end <= start {
            return found(start, 1.0);
        }
        if let Some(point) = self.point(other) {
            let (from, to) = (point.start.max(start), point.end().min(end));
            if to > from {
                found(from, (to - from) / (end - start));
            }
            return;
        }
        let pair = [index.min(other as usize), index.max(other as usize)];
        let changes = self.events.iter().filter(|event| [event.a, event.b] == pair);
        let mut from = start;
        for to in changes.map(|event| event.time).filter(|time| (start..end).contains(time)).chain([end]) {
            if to > from {
                found(from, (to - from) / (end - start));
                from = to;
            }
        }
    }

    /// Writes the effect of spheres and pushes on a body, as they act on average over some time, or at an instant if the
    /// two ends are the same, with all centres where they are at time `t` [s].
    pub fn acting(
        &self,
        index: usize,
        sources: &[u32],
        pushes: &[Push],
        ends: [f64; 2],
        t: f64,
        now: &mut Instantaneous,
    ) {
        let place = |source: usize| self.courses[source].at(t, ends[1]).position;
        let own = place(index);
        now.spheres.clear();
        for &other in sources {
            let apart = place(other as usize) - own;
            self.by_share(index, other, ends, |from, share| {
                now.spheres.extend(self.sphere(index, other, from, share, apart));
            });
        }
        now.pushes.clear();
        let [start, end] = ends;
        now.pushes.extend(pushes.iter().filter_map(|push| {
            let share = if end > start {
                (push.end().min(end) - push.start.max(start)) / (end - start)
            } else {
                f64::from(push.acts_at(start))
            };
            (share > 0.0).then_some((push.direction, push.strength * share))
        }));
    }

    /// Upper bound of the derivative of the accelerations by spheres with respect to positions [1/s²]: of a body's nodes,
    /// and of its centre if it is free, on which the reaction to its own sphere also acts.
    pub fn stiffness(&self, index: usize, sources: &[u32]) -> f64 {
        let bodies = &self.scene.bodies;
        let is_free = |body: usize| bodies[body].path().is_none();
        let of = |&source: &u32| {
            let other = source as usize;
            // the distance to a centre changes with the node, and with either centre if that is free
            let ways = |is_free: bool| if is_free { 2.0 } else { 1.0 };
            if let Some(point) = self.point(source) {
                return self.scene.point_strength(point, index).abs() * ways(is_free(index));
            }
            let law = self.scene.law(index, other);
            let scale = |to: usize, from: usize| self.scene.influence.scale(bodies[to].radius, bodies[from].radius);
            let of_nodes = scale(index, other) * ways(is_free(index) || is_free(other));
            let mass = if is_free(index) { bodies[other].mass / bodies[index].mass } else { 0.0 };
            law.alpha.max(law.beta) * (of_nodes + scale(other, index) * mass)
        };
        sources.iter().map(of).sum::<f64>() * steep(self.scene.influence.weight)
    }

    /// The sphere of a body or force point as it acts on a body from time `t` [s] on, given its position relative to that
    /// body's and the fraction of the time during which it acts.
    fn sphere(&self, index: usize, source: u32, t: f64, share: f64, centre: DVec3) -> Option<Source> {
        let influence = self.scene.influence;
        let (origin, strength, sphere_radius) = match self.point(source) {
            Some(point) if !point.acts_at(t) => return None,
            Some(point) => {
                let origin = Origin::Point { index: source - self.scene.bodies.len() as u32 };
                (origin, self.scene.point_strength(point, index), influence.sphere_radius(point.radius))
            }
            None => {
                let (one, other) = (&self.scene.bodies[index], &self.scene.bodies[source as usize]);
                let (law, phase) = (self.scene.law(index, source as usize), self.phase(index, source as usize, t));
                if phase == Phase::Apart && !law.apart_repels {
                    return None;
                }
                let strength = law.strength(phase, centre.length() / (one.radius + other.radius))
                    * influence.scale(one.radius, other.radius);
                (Origin::Body { index: source, phase }, strength, other.sphere_radius())
            }
        };
        Some(Source { origin, centre, sphere_radius, strength: strength * share })
    }
}

/// The motion on a path in the middle of some time [s], but its velocity and acceleration on average, which includes
/// jumps of the velocity inside.
pub fn mean_motion(path: &Path, [start, end]: [f64; 2]) -> Kinematics {
    let (first, last) = (path.at(start), path.before(end));
    let mean = |of: DVec3| if path.is_held() { DVec3::ZERO } else { of / (end - start) };
    Kinematics {
        position: path.position(start + 0.5 * (end - start)),
        velocity: mean(last.position - first.position),
        acceleration: mean(last.velocity - first.velocity),
    }
}

/// Bound on |∂(c − r) W|: 1 for the linear weight, less than 2 for Wendland's.
pub fn steep(weight: Weight) -> f64 {
    if weight == Weight::Linear { 1.0 } else { 2.0 }
}
