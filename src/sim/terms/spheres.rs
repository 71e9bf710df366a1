//! Influence spheres of other bodies: attraction (3.4), repulsion (3.5), and repulsion in the core.

use std::collections::{BTreeMap, BTreeSet};

use glam::DVec3;

use super::{Cause, Moment, On, Phases, Surroundings, Term};
use crate::{
    geometry::Rest,
    model::{
        PairLaw, energy,
        influence::{self, Weight},
        phase::Phase,
    },
    scene::{Body, Members, Scene, path::Kinematics},
    sim::{
        neighbours::{Neighbour, PairId},
        numerics::arrays::Vectors,
        span::Span,
    },
};

/// An influence sphere that can reach a body in a part of a step.
#[derive(Clone, Copy, Debug)]
pub struct Sphere {
    /// The body or force point that it belongs to, as in [`Scene::source_path`].
    pub body: u32,
    /// Its radius r_e [scene unit].
    pub radius: f64,
    /// 1 / r_e.
    pub inverse_radius: f64,
    /// Signed strength [1/s²]: positive attracts, negative repels.
    pub strength: f64,
}

impl Sphere {
    /// The sphere of a body or a force point.
    pub fn new(body: u32, radius: f64, strength: f64) -> Sphere {
        Sphere { body, radius, inverse_radius: 1.0 / radius, strength }
    }
}

/// What an influence sphere belongs to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Origin {
    /// A body.
    Body {
        /// Its index.
        index: u32,
        /// The phase of the pair, which determines the strength.
        phase: Phase,
    },
    /// A force point.
    Point {
        /// Its index.
        index: u32,
    },
}

/// An influence sphere at an instant, seen from the body acted on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Source {
    /// What it belongs to.
    pub origin: Origin,
    /// Its centre relative to the centre of the body acted on, c_j − c_i [scene unit].
    pub centre: DVec3,
    /// Its radius r_e [scene unit].
    pub sphere_radius: f64,
    /// Signed strength [1/s²]: positive attracts, negative repels.
    pub strength: f64,
}

impl Source {
    /// The cause that its force counts as.
    pub fn cause(&self) -> Cause {
        match self.origin {
            Origin::Point { .. } => Cause::Point,
            Origin::Body { phase, .. } => Cause::of_sphere(phase, self.strength),
        }
    }

    /// Its acceleration of a vertex at a place relative to the centre of the body acted on [scene unit/s²].
    #[inline]
    pub fn acceleration(&self, weight: Weight, place: DVec3) -> DVec3 {
        influence::acceleration(weight, self.strength, self.sphere_radius, self.centre - place)
    }

    /// The body that it belongs to, if it belongs to one.
    pub fn body(&self) -> Option<u32> {
        match self.origin {
            Origin::Body { index, .. } => Some(index),
            Origin::Point { .. } => None,
        }
    }
}

pub struct Spheres;

impl Term for Spheres {
    fn at<P: Phases>(
        on: &On<'_, P>,
        moment: Moment,
        motion: &Kinematics,
        farthest: f64,
        surroundings: &mut Surroundings,
    ) {
        for neighbour in on.neighbours {
            let phase = on.phases.from(on.index, neighbour, moment.phases_at);
            let (strength, sphere_radius) =
                (on.strength(neighbour, phase), on.tracks.motion_bounds(neighbour.other).sphere);
            if strength == 0.0 {
                continue;
            }
            let centre = on.tracks.path(neighbour.other as usize).position(moment.time) - motion.position;
            if centre.length() <= sphere_radius + farthest {
                let origin = Origin::Body { index: neighbour.other, phase };
                surroundings.sources.push(Source { origin, centre, sphere_radius, strength });
            }
        }
    }

    fn over<P: Phases>(on: &On<'_, P>, near: &[Neighbour], part: Span, acting: &mut Vec<Sphere>) {
        for neighbour in near.iter().filter(|neighbour| !neighbour.is_point()) {
            let strength = on.strength(neighbour, on.phases.from(on.index, neighbour, part.start));
            let radius = on.tracks.motion_bounds(neighbour.other).sphere;
            if strength != 0.0 {
                acting.push(Sphere::new(neighbour.other, radius, strength));
            }
        }
    }

    fn jumps<P: Phases>(on: &On<'_, P>, near: &[Neighbour], span: Span, jumps: &mut Vec<f64>) {
        let first = jumps.len();
        for neighbour in near.iter().filter(|neighbour| !neighbour.is_point()) {
            on.phases.changes(on.index, neighbour, jumps);
        }
        let mut place = first;
        while place < jumps.len() {
            if span.holds(jumps[place]) {
                place += 1;
            } else {
                jumps.swap_remove(place);
            }
        }
    }
}

impl<P> On<'_, P> {
    /// The strength of a neighbour's sphere on the body in a phase of their pair [1/s²].
    pub fn strength(&self, neighbour: &Neighbour, phase: Phase) -> f64 {
        let [this, other] = [self.index, neighbour.other].map(|body| self.tracks.motion_bounds(body).radius);
        self.scene.strength(&self.scene.law_at(neighbour.law), phase, this, other)
    }
}

/// The neighbour entry for body `other`, in pair `pair`, as seen from `this`.
pub(in crate::sim) fn neighbour(scene: &Scene, this: u32, other: u32, pair: PairId) -> Neighbour {
    let law = scene.law_index(this as usize, other as usize);
    let strengths = strengths(scene, &scene.law_at(law), this, other);
    // a bound on the acceleration of any vertex, in any phase
    let source = scene.bodies[other as usize].sphere_radius();
    let pull = strengths.into_iter().fold(0.0, f64::max) * source * scene.influence.weight.max_pull();
    Neighbour { other, pair, law, pull, always_acts: !strengths.contains(&0.0) }
}

/// The strength with which the sphere of body `source` acts on body `this` in each phase of their pair, without sign
/// [1/s²].
fn strengths(scene: &Scene, law: &PairLaw, this: u32, source: u32) -> [f64; 3] {
    let [this, source] = [this, source].map(|index| scene.bodies[index as usize].radius);
    [Phase::Merged, Phase::Apart, Phase::Core].map(|phase| scene.strength(law, phase, this, source).abs())
}

/// Number of vertices whose distances are computed together.
const STRIP: usize = 64;

/// Adds Σ s Φ over a body's vertices, minus its value if all were outside every sphere, to `sum` [scene unit²/s²].
/// Returns the number of vertices inside any sphere. `displacement` is empty if all are zero.
pub fn energy_inside(rest: Rest<'_>, displacement: &Vectors, sources: &[Source], weight: Weight, sum: &mut f64) -> u64 {
    let mut count = 0;
    if sources.is_empty() {
        return count;
    }
    for first in (0..rest.len()).step_by(STRIP) {
        let n = STRIP.min(rest.len() - first);
        let mut reached = [false; STRIP];
        for source in sources {
            let mut distances = [0.0; STRIP];
            find_distances(rest, displacement, source.centre, first, &mut distances[..n]);
            let potential = |r| energy::influence_potential(weight, source.sphere_radius, r);
            for (&distance, reached) in distances[..n].iter().zip(&mut reached) {
                if distance < source.sphere_radius {
                    let inside = potential(distance) - potential(source.sphere_radius);
                    *sum += source.strength * inside;
                    *reached = true;
                }
            }
        }
        count += reached.iter().filter(|&&reached| reached).count() as u64;
    }
    count
}

/// Distances of some vertices, from `first` on, to `centre`, which is relative to the body's centre [scene unit].
fn find_distances(rest: Rest<'_>, displacement: &Vectors, centre: DVec3, first: usize, distances: &mut [f64]) {
    let n = distances.len();
    let (l, radius) = (rest.mesh.positions(), rest.radius);
    let [lx, ly, lz] = [&l.x, &l.y, &l.z].map(|axis| &axis[first..first + n]);
    let Vectors { x, y, z } = displacement;
    let [x, y, z] = [x, y, z].map(|axis| if axis.is_empty() { &[0.0; STRIP][..n] } else { &axis[first..first + n] });
    for i in 0..n {
        let dx = centre.x - (radius * lx[i] + x[i]);
        let dy = centre.y - (radius * ly[i] + y[i]);
        let dz = centre.z - (radius * lz[i] + z[i]);
        distances[i] = (dx * dx + dy * dy + dz * dz).sqrt();
    }
}

/// Σ s Φ over the vertices of body `index` if all of them were outside the sphere of body `source` [scene unit²/s²].
pub fn energy_outside(scene: &Scene, index: usize, source: usize, phase: Phase) -> f64 {
    let law = scene.law(index, source);
    let (body, source) = (&scene.bodies[index], &scene.bodies[source]);
    outside_per_vertex(scene, &law, body, source, phase) * body.shape.vertex_count() as f64
}

fn outside_per_vertex(scene: &Scene, law: &PairLaw, body: &Body, source: &Body, phase: Phase) -> f64 {
    let sphere = source.sphere_radius();
    scene.strength(law, phase, body.radius, source.radius)
        * energy::influence_potential(scene.influence.weight, sphere, sphere)
}

/// Bodies of the same radius and reach to which the same laws of pairs apply.
struct Alike {
    /// The index of one of them.
    body: usize,
    bodies: f64,
    /// Number of vertices of all of them.
    vertices: f64,
}

/// Σ [`energy_outside`] over all ordered pairs of bodies as if all were apart: a constant of the scene, computed for
/// pairs of [`Alike`] bodies at once.
pub fn energy_of_distant_pairs(scene: &Scene) -> f64 {
    let named: BTreeSet<Members> = scene.pairs.rules().flat_map(|(sides, _)| sides).collect();
    let mut all: BTreeMap<(Option<Members>, [u64; 2]), Alike> = BTreeMap::new();
    for (index, body) in scene.bodies.iter().enumerate() {
        let itself = Members::Body(index as u32);
        let side = if named.contains(&itself) { Some(itself) } else { scene.pairs.group_of(index).map(Members::Group) };
        let first = Alike { body: index, bodies: 0.0, vertices: 0.0 };
        let alike = all.entry((side, [body.radius, body.reach].map(f64::to_bits))).or_insert(first);
        alike.bodies += 1.0;
        alike.vertices += body.shape.vertex_count() as f64;
    }
    let mut sum = 0.0;
    for this in all.values() {
        for source in all.values() {
            let sources = if source.body == this.body { source.bodies - 1.0 } else { source.bodies };
            if sources > 0.0 {
                let [one, other] = [this, source].map(|alike| &scene.bodies[alike.body]);
                let law = scene.law(this.body, source.body);
                sum += this.vertices * sources * outside_per_vertex(scene, &law, one, other, Phase::Apart);
            }
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Compared with the sum over all pairs, for laws of bodies, of groups, within a group and across.
    #[test]
    fn the_energy_of_distant_pairs_includes_own_laws() {
        let mut text = "duration = 1.0\n[influence]\nbeta = 40.0\n".to_owned();
        for (k, group) in ["", "g", "g", "h", "h", "h", "", ""].into_iter().enumerate() {
            let group = if group.is_empty() { String::new() } else { format!("group = \"{group}\"\n") };
            let (radius, reach) = (1.0 + 0.25 * f64::from(k as u32 % 3), 1.2 + 0.3 * f64::from(k as u32 % 2));
            text += &format!(
                "[[body]]\nname = \"b{k}\"\nradius = {radius}\nreach = {reach}\n{group}motion = {{ fixed = [{k}, 0, 0] }}\n"
            );
        }
        for (k, (a, b)) in [("g", "g"), ("g", "h"), ("b0", "h"), ("b6", "b7"), ("b3", "h")].into_iter().enumerate() {
            let apart = if k == 1 { "none" } else { "repel" };
            let beta = 50 + k;
            text += &format!("[[pair]]\nbodies = [\"{a}\", \"{b}\"]\nbeta = {beta}\napart = \"{apart}\"\n");
        }
        let scene = Scene::parse(&text, "laws.toml").unwrap();
        let n = scene.bodies.len();
        let all = (0..n).flat_map(|i| (0..n).filter(move |&j| j != i).map(move |j| (i, j)));
        let expected: f64 = all.map(|(i, j)| energy_outside(&scene, i, j, Phase::Apart)).sum();
        let found = energy_of_distant_pairs(&scene);
        assert!((found / expected - 1.0).abs() < 1e-13, "{found} {expected}");
    }
}
