//! External accelerations of the nodes of a body.

use std::collections::BTreeMap;

use glam::DVec3;

use crate::{
    model::{
        PairLaw,
        influence::{Weight, acceleration},
        phase::Phase,
    },
    observe::PairEvent,
    scene::{Material, Path, Point, Push, Response, Scene, path::Kinematics},
    sim::{
        Cause,
        span::Span,
        terms::{self, carry},
    },
};

use super::PHASES;

/// The data of a step that all bodies share.
#[derive(Clone, Copy)]
pub struct StepContext<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Phases at the start of the step, of pairs that are not apart.
    pub phases: &'a BTreeMap<[u32; 2], Phase>,
    /// Phase changes in the step, in order of time.
    pub events: &'a [PairEvent],
    /// Start of the step [s].
    pub start: f64,
    /// End of the step [s].
    pub end: f64,
    /// Number of the step.
    pub step: u64,
}

/// A part of a step without jumps, as seen by one body.
pub struct Part<'a> {
    scene: &'a Scene,
    path: &'a Path,
    material: Material,
    /// Start of the part [s].
    pub start: f64,
    /// End of the part [s].
    pub end: f64,
    sources: Vec<Source<'a>>,
    pushes: Vec<(DVec3, f64)>,
}

/// An influence sphere that acts throughout a part, of a body or of a force point, which follow the bodies.
struct Source<'a> {
    body: u32,
    path: &'a Path,
    sphere: Sphere,
}

/// The effect of an influence sphere on a body.
#[derive(Clone, Copy)]
pub struct Sphere {
    law: PairLaw,
    phase: Phase,
    /// Scaling factor by the radii of the two bodies [–].
    scale: f64,
    radius: f64,
    /// Sum of the radii of the bodies [scene unit].
    radii: f64,
    /// Fraction of the time during which it acts [–].
    share: f64,
    /// Whether it is a force point's.
    is_of_point: bool,
}

impl Sphere {
    /// The sphere of `source` at a position relative to the body acted on.
    fn at(&self, source: u32, centre: DVec3) -> ActingSphere {
        let strength = self.law.strength(self.phase, centre.length() / self.radii) * self.scale;
        let cause = if self.is_of_point { Cause::Point } else { Cause::of_sphere(self.phase, strength) };
        ActingSphere { cause, source, centre, strength: strength * self.share, radius: self.radius }
    }
}

/// An influence sphere at an instant.
#[derive(Clone, Copy, Debug)]
pub struct ActingSphere {
    /// The cause that its force counts as.
    pub cause: Cause,
    /// The body or force point that it belongs to.
    pub source: u32,
    /// Its centre relative to that of the body acted on [scene unit].
    pub centre: DVec3,
    /// Its signed strength, in proportion to the time during which it acts [1/s²].
    pub strength: f64,
    /// Its radius [scene unit].
    pub radius: f64,
}

impl ActingSphere {
    /// The acceleration at a position relative to the centre of the body acted on [scene unit/s²].
    #[inline]
    pub fn acceleration(&self, weight: Weight, place: DVec3) -> DVec3 {
        acceleration(weight, self.strength, self.radius, self.centre - place)
    }
}

/// The sources of acceleration at an instant.
#[derive(Clone, Debug, Default)]
pub struct Instantaneous {
    /// The influence spheres.
    pub spheres: Vec<ActingSphere>,
    /// Pushes: direction and strength [scene unit/s²].
    pub pushes: Vec<(DVec3, f64)>,
    /// The acceleration that all nodes of a body on a path share [scene unit/s²].
    pub uniform: DVec3,
}

impl StepContext<'_> {
    /// The phase of a pair at time `t` [s]; at a change, the new phase.
    fn phase(&self, a: usize, b: usize, t: f64) -> Phase {
        let pair = [a.min(b), a.max(b)];
        let changes = self.events.iter().take_while(|event| event.time <= t);
        let last = changes.filter(|event| [event.a, event.b] == pair).last();
        let before = || self.phases.get(&pair.map(|body| body as u32)).copied().unwrap_or(Phase::Apart);
        last.map_or_else(before, |event| PHASES.get(event.to).copied().unwrap_or(Phase::Apart))
    }

    /// Whether nothing in the step can act on a body at rest.
    pub fn is_calm(&self, index: usize, sources: &[u32], pushes: &[Push]) -> bool {
        let body = &self.scene.bodies[index];
        let Some(path) = body.path() else { return true };
        sources.iter().all(|&other| self.is_silent(index, other as usize))
            && pushes.iter().all(|push| push.end() <= self.start || push.start >= self.end)
            && (body.material.response == Response::Rigid || path.is_still(self.start, self.end))
    }

    /// The force point with a number as a source, if it is one.
    fn point(&self, source: u32) -> Option<&Point> {
        Some(&self.scene.points[(source as usize).checked_sub(self.scene.bodies.len())?])
    }

    /// Whether a sphere has no effect on a body throughout the step.
    fn is_silent(&self, index: usize, other: usize) -> bool {
        if self.point(other as u32).is_some() {
            return false;
        }
        let law = self.scene.law(index, other);
        let is_apart = self.phase(index, other, self.start) == Phase::Apart
            && self.events.iter().all(|event| ![[index, other], [other, index]].contains(&[event.a, event.b]));
        is_apart && law.strength(Phase::Apart, f64::INFINITY) == 0.0
    }

    /// Instants in the step at which something that acts on a body jumps [s], including its start and end, ascending.
    pub fn breaks(&self, index: usize, sources: &[u32], pushes: &[Push], breaks: &mut Vec<f64>) {
        breaks.clear();
        breaks.extend([self.start, self.end]);
        let own = self.events.iter().filter(|event| event.a == index || event.b == index);
        breaks.extend(own.map(|event| event.time));
        self.add_jumps(sources.iter().copied().chain([index as u32]), pushes, breaks);
    }

    /// Whether a path, a force point or a push jumps at time `t` [s].
    pub fn jumps_at(&self, t: f64) -> bool {
        let mut jumps = Vec::new();
        StepContext { start: t, end: t, ..*self }.add_all_jumps(&mut jumps);
        !jumps.is_empty()
    }

    /// Appends the instants in the step at which any body, force point or push jumps [s], and sorts all.
    pub fn add_all_jumps(&self, breaks: &mut Vec<f64>) {
        let all = 0..(self.scene.bodies.len() + self.scene.points.len()) as u32;
        self.add_jumps(all, &self.scene.pushes, breaks);
    }

    /// Appends the instants in the step at which one of these bodies or force points jumps, or a push [s], and sorts all.
    fn add_jumps(&self, sources: impl Iterator<Item = u32>, pushes: &[Push], breaks: &mut Vec<f64>) {
        Span { start: self.start, end: self.end }.jumps_of(self.scene, sources, breaks);
        breaks.extend(pushes.iter().flat_map(|push| [push.start, push.end()]));
        breaks.retain(|&time| (self.start..=self.end).contains(&time));
        breaks.sort_unstable_by(f64::total_cmp);
        breaks.dedup();
    }

    /// The external accelerations of a body between two breaks.
    pub fn part<'a>(
        &'a self,
        path: &'a Path,
        index: usize,
        sources: &[u32],
        pushes: &[Push],
        [start, end]: [f64; 2],
    ) -> Part<'a> {
        // a part may be as short as rounding makes it: a push that begins or ends with it acts if it does in the middle
        let middle = start + 0.5 * (end - start);
        self.over(path, index, (sources, [start; 2]), (pushes, [middle; 2]), [start, end])
    }

    /// The averages of the external accelerations of a body over a step with breaks inside.
    pub fn mean<'a>(
        &'a self,
        path: &'a Path,
        index: usize,
        sources: &[u32],
        pushes: &[Push],
        ends: [f64; 2],
    ) -> Part<'a> {
        self.over(path, index, (sources, ends), (pushes, ends), ends)
    }

    /// The external accelerations of a body over some time, by sources and pushes as they are on average over others, or at
    /// an instant.
    fn over<'a>(
        &'a self,
        path: &'a Path,
        index: usize,
        (sources, of_sources): (&[u32], [f64; 2]),
        (pushes, of_pushes): (&[Push], [f64; 2]),
        [start, end]: [f64; 2],
    ) -> Part<'a> {
        let mut part = Part {
            scene: self.scene,
            path,
            material: self.scene.bodies[index].material,
            start,
            end,
            sources: Vec::new(),
            pushes: Vec::new(),
        };
        for &other in sources {
            self.by_share(index, other, of_sources, |from, share| {
                part.sources.extend(self.source(index, other, from, share))
            });
        }
        add_pushes(pushes, of_pushes, &mut part.pushes);
        part
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

    /// Writes the average effect of spheres and pushes on a body over some time, or that at an instant, given the centres
    /// of all bodies.
    pub fn acting(
        &self,
        index: usize,
        sources: &[u32],
        pushes: &[Push],
        ends: [f64; 2],
        centres: &[DVec3],
        now: &mut Instantaneous,
    ) {
        now.spheres.clear();
        now.pushes.clear();
        for &other in sources {
            let apart = centres[other as usize] - centres[index];
            self.by_share(index, other, ends, |from, share| {
                now.spheres.extend(self.sphere(index, other, from, share).map(|sphere| sphere.at(other, apart)));
            });
        }
        add_pushes(pushes, ends, &mut now.pushes);
    }

    /// Upper bound of the spatial derivative of the accelerations by spheres [1/s²]: of a body's nodes, and of its
    /// centre, on which the reaction to its own sphere also acts.
    pub fn stiffness(&self, index: usize, sources: &[u32]) -> f64 {
        let own = self.scene.bodies[index].mass;
        let of = |&other: &u32| {
            if let Some(point) = self.point(other) {
                return 2.0 * self.scene.point_strength(point, index).abs();
            }
            let body = &self.scene.bodies[other as usize];
            let law = self.scene.law(index, other as usize);
            let scale = |to: usize, from: usize| {
                self.scene.influence.scale(self.scene.bodies[to].radius, self.scene.bodies[from].radius)
            };
            let scales = [scale(index, other as usize), scale(other as usize, index)];
            law.alpha.max(law.beta) * (2.0 * scales[0] + scales[1] * (body.mass / own))
        };
        sources.iter().map(of).sum::<f64>() * steep(self.scene.influence.weight)
    }

    fn sphere(&self, index: usize, other: u32, t: f64, share: f64) -> Option<Sphere> {
        let (scene, j) = (self.scene, other as usize);
        if let Some(point) = self.point(other) {
            let this = scene.bodies[index].radius;
            let law = PairLaw { alpha: point.strength, beta: 0.0, core_width: 0.0, ..PairLaw::DEFAULT };
            return point.acts_at(t).then(|| Sphere {
                law,
                phase: Phase::Merged,
                scale: scene.influence.scale(this, point.radius),
                radius: scene.influence.sphere_radius(point.radius),
                radii: this + point.radius,
                share,
                is_of_point: true,
            });
        }
        let [this, source] = [&scene.bodies[index], &scene.bodies[j]];
        let (law, phase) = (scene.law(index, j), self.phase(index, j, t));
        if phase == Phase::Apart && !law.apart_repels {
            return None;
        }
        Some(Sphere {
            law,
            phase,
            scale: scene.influence.scale(this.radius, source.radius),
            radius: source.sphere_radius(),
            radii: this.radius + source.radius,
            share,
            is_of_point: false,
        })
    }

    fn source(&self, index: usize, other: u32, t: f64, share: f64) -> Option<Source<'_>> {
        let path = self.scene.source_path(other as usize)?;
        Some(Source { body: other, path, sphere: self.sphere(index, other, t, share)? })
    }
}

/// Bound on |∂(c − r) W|: 1 for the linear weight, less than 2 for Wendland's.
pub fn steep(weight: Weight) -> f64 {
    if weight == Weight::Linear { 1.0 } else { 2.0 }
}

/// Appends pushes averaged over a time interval; those that act at its start if the two ends are one instant.
fn add_pushes(pushes: &[Push], [start, end]: [f64; 2], into: &mut Vec<(DVec3, f64)>) {
    into.extend(pushes.iter().filter_map(|push| {
        let share = if end > start {
            (push.end().min(end) - push.start.max(start)) / (end - start)
        } else {
            f64::from(push.acts_at(start))
        };
        (share > 0.0).then_some((push.direction, push.strength * share))
    }));
}

impl Part<'_> {
    /// The accelerations at time `t` in the part [s], into `now`.
    pub fn at(&self, t: f64, now: &mut Instantaneous) {
        let centre = self.centre(t);
        now.uniform = terms::uniform(self.scene, &self.material, &self.motion(t));
        now.pushes.clear();
        now.pushes.extend_from_slice(&self.pushes);
        now.spheres.clear();
        let of = |source: &Source<'_>| source.sphere.at(source.body, self.place(source.path, t) - centre);
        now.spheres.extend(self.sources.iter().map(of));
    }

    /// The motion of the centre at time `t` in the part [s]; the left limit at its end.
    pub fn motion(&self, t: f64) -> Kinematics {
        if t == self.end { self.path.before(t) } else { self.path.at(t) }
    }

    /// Like [`Part::at`], but averaged over the part: the acceleration of its own motion is the change of velocity,
    /// including jumps inside; for that at its start there is [`Part::kick`].
    pub fn averaged(&self, now: &mut Instantaneous) {
        let middle = 0.5 * (self.start + self.end);
        self.at(middle, now);
        let (first, last) = (self.path.at(self.start), self.path.before(self.end));
        let length = self.end - self.start;
        let still = Kinematics { velocity: DVec3::ZERO, acceleration: DVec3::ZERO, ..first };
        let mean = Kinematics {
            velocity: (last.position - first.position) / length,
            acceleration: (last.velocity - first.velocity) / length,
            ..first
        };
        let motion = if self.path.is_held() { &still } else { &mean };
        now.uniform = terms::uniform(self.scene, &self.material, motion);
    }

    /// Jump of the nodes' velocities at the start of the part [scene unit/s]. At t = 0 every velocity is zero.
    pub fn kick(&self) -> DVec3 {
        carry::kick(&self.material, self.path, self.start)
    }

    /// The velocity of the centre at time `t` [scene unit/s].
    pub fn velocity(&self, t: f64) -> DVec3 {
        self.path.at(t).velocity
    }

    /// The position of the centre at time `t` [scene unit].
    pub fn centre(&self, t: f64) -> DVec3 {
        self.place(self.path, t)
    }

    /// The position on a path at time `t` [scene unit]; on one with position jumps, that throughout the part.
    fn place(&self, path: &Path, t: f64) -> DVec3 {
        path.position(if path.is_held() { 0.5 * (self.start + self.end) } else { t })
    }

    /// Upper bound of the derivative of the accelerations by spheres [1/s²].
    pub fn stiffness(&self) -> f64 {
        let of = |Source { sphere, .. }: &Source<'_>| sphere.law.alpha.abs().max(sphere.law.beta) * sphere.scale;
        self.sources.iter().map(of).sum::<f64>() * steep(self.scene.influence.weight)
    }
}

impl Instantaneous {
    /// The acceleration at a position relative to the centre, for a rest position in direction `facing` [scene
    /// unit/s²].
    #[inline]
    pub fn acceleration(&self, weight: Weight, place: DVec3, facing: DVec3) -> DVec3 {
        let mut sum = self.uniform;
        for &ActingSphere { centre, strength, radius, .. } in &self.spheres {
            let to_centre = centre - place;
            if to_centre.length_squared() < radius * radius {
                sum += acceleration(weight, strength, radius, to_centre);
            }
        }
        for &(direction, strength) in &self.pushes {
            sum += direction * (strength * f64::max(0.0, -facing.dot(direction)));
        }
        sum
    }
}
