//! What a camera should have in view, and which way up.

use glam::DVec3;

use crate::{
    scene::{Body, Motion, Plane, Scene},
    sim::terms::free_fall,
};

/// What a camera should have in view, see [`Simulation::framing`](crate::observe::Simulation::framing).
pub fn framing(scene: &Scene, only_affected_bodies: bool) -> Vec<(DVec3, f64)> {
    if only_affected_bodies { affected_bodies(scene) } else { all_spheres(scene) }
}

/// The axis direction that is closest to the opposite of gravity; z without gravity.
pub fn up(scene: &Scene) -> DVec3 {
    let axes = [DVec3::Z, DVec3::NEG_Z, DVec3::Y, DVec3::NEG_Y, DVec3::X, DVec3::NEG_X];
    let against = |axis: &DVec3| scene.gravity.dot(*axis);
    axes.into_iter().min_by(|one, other| against(one).total_cmp(&against(other))).unwrap_or(DVec3::Z)
}

/// Instants within the first minute at which the camera framing samples positions [s].
fn instants(scene: &Scene) -> impl Iterator<Item = f64> {
    let duration = scene.duration.min(60.0);
    (0..=32).map(move |k| duration * f64::from(k) / 32.0)
}

/// Approximate positions of the bodies at each instant: free bodies fly until they touch a plane or come near another
/// body, and stay there.
fn positions(scene: &Scene) -> Vec<Vec<DVec3>> {
    /// With more free bodies than this, encounters are not searched for.
    const MAX_FREE: usize = 300;

    let bodies = &scene.bodies;
    let free = bodies.iter().filter(|body| body.path().is_none()).count();
    let mut stays: Vec<Option<DVec3>> = vec![None; bodies.len()];
    let mut at = |time: f64| {
        let position = |(body, stays): (&Body, &Option<DVec3>)| match (&body.motion, stays) {
            (_, Some(stays)) => *stays,
            (Motion::Prescribed(path), _) => path.position(time),
            (Motion::Free(free), _) => free.from + time * (free.velocity + 0.5 * time * free_fall(scene)),
        };
        let positions: Vec<DVec3> = bodies.iter().zip(&stays).map(position).collect();
        for (i, body) in bodies.iter().enumerate().filter(|(_, body)| body.path().is_none()) {
            let near =
                |j: usize| i != j && positions[i].distance(positions[j]) < 0.9 * (body.radius + bodies[j].radius);
            let lies = |plane: &&Plane| plane.depth(positions[i]) > -body.radius;
            if stays[i].is_none() {
                let on_plane = scene.planes.iter().find(lies);
                let lifted =
                    on_plane.map(|plane| positions[i] + (plane.depth(positions[i]) + body.radius) * plane.normal);
                let is_near = || free <= MAX_FREE && (0..bodies.len()).any(near);
                stays[i] = lifted.or_else(|| is_near().then_some(positions[i]));
            }
        }
        positions
    };
    instants(scene).map(&mut at).collect()
}

/// Every influence sphere along its path.
fn all_spheres(scene: &Scene) -> Vec<(DVec3, f64)> {
    let radius = |body: &Body| body.sphere_radius().min(2.0 * body.radius);
    let spheres =
        |centres: Vec<DVec3>| centres.into_iter().zip(&scene.bodies).map(|(centre, body)| (centre, radius(body)));
    let positions = positions(scene);
    let points = points(scene, &positions);
    positions.into_iter().flat_map(|centres| spheres(centres).collect::<Vec<_>>()).chain(points).collect()
}

/// The spheres of force points where they act on bodies, and these bodies.
fn points(scene: &Scene, positions: &[Vec<DVec3>]) -> Vec<(DVec3, f64)> {
    let mut spheres = Vec::new();
    for (time, centres) in instants(scene).zip(positions) {
        for point in scene.points.iter().filter(|point| (point.start..point.end()).contains(&time)) {
            let (centre, reach) = (point.path.position(time), scene.influence.sphere_radius(point.radius));
            let bodies = scene.bodies.iter().zip(centres).enumerate().filter(|(index, _)| point.acts_on(*index));
            let bodies = bodies.map(|(_, (body, at))| (*at, body.radius));
            let reached: Vec<_> = bodies.filter(|(at, radius)| at.distance(centre) < reach + radius).collect();
            spheres.extend((!reached.is_empty()).then_some((centre, reach)));
            spheres.extend(reached);
        }
    }
    spheres
}

/// The bodies that something acts on, where they are then; all spheres if there are none.
fn affected_bodies(scene: &Scene) -> Vec<(DVec3, f64)> {
    /// With more bodies than this, pairs are not examined.
    const MAX_BODIES: usize = 1000;
    /// Size of a body including its displacements [radii].
    const SIZE: f64 = 1.15;
    /// A body larger than this is shown only in part [radii of the other].
    const MAX_SHOWN: f64 = 3.0;

    let bodies = &scene.bodies;
    let positions = positions(scene);
    let mut acted_on = points(scene, &positions);
    for push in &scene.pushes {
        let body = &bodies[push.body];
        let centre = match &body.motion {
            Motion::Prescribed(path) => path.position(push.start),
            Motion::Free(free) => free.from,
        };
        acted_on.push((centre, SIZE * body.radius));
    }
    let pairs_of = if bodies.len() > MAX_BODIES { 0 } else { bodies.len() };
    let movers: Vec<usize> = (0..pairs_of).filter(|&i| bodies[i].path().is_none_or(|path| !path.is_fixed())).collect();
    let all: Vec<usize> = (0..pairs_of).collect();
    let mut is_whole = vec![false; pairs_of];
    for (k, centres) in positions.into_iter().enumerate() {
        is_whole.fill(false);
        // pairs of fixed bodies are examined only at the first instant
        for &b in if k == 0 { &all } else { &movers } {
            for a in (0..pairs_of).filter(|&a| a != b) {
                let reach = |from: usize, to: usize| bodies[from].sphere_radius() + bodies[to].radius;
                if centres[a].distance(centres[b]) >= f64::max(reach(a, b), reach(b, a)) {
                    continue;
                }
                for (i, other) in [(a, b), (b, a)] {
                    if is_whole[i] {
                        continue; // with all that other pairs show of it
                    }
                    // of a body that is much larger than the other, only the side towards the other
                    let radius = f64::min(bodies[i].radius, MAX_SHOWN * bodies[other].radius);
                    is_whole[i] = radius == bodies[i].radius;
                    let towards = (centres[other] - centres[i]).normalize_or_zero();
                    acted_on.push((centres[i] + (bodies[i].radius - radius) * towards, SIZE * radius));
                }
            }
        }
    }
    if acted_on.is_empty() { all_spheres(scene) } else { acted_on }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::bounds;

    #[test]
    fn a_body_is_framed_once_at_each_instant_however_many_reach_it() {
        let text = "duration = 0.05\n[influence]\nreach = 20.0\n[[grid]]\nname = 'g'\nradius = 1.0\ncount = [5, 5, 5]\n\
                    spacing = [2.5, 2.5, 2.5]\nshape = { sphere = { stacks = 2, slices = 3 } }\n\
                    motion = { line = { from = [0, 0, 0], velocity = [1, 0, 0] } }\n";
        let scene = Scene::parse(text, "crowd.toml").unwrap();
        let spheres = framing(&scene, true);
        assert_eq!(spheres.len(), instants(&scene).count() * scene.bodies.len());
        let centres = scene.bodies.iter().filter_map(|body| Some(body.path()?.position(0.0)));
        let [low, high] = bounds(centres.map(|centre| (centre, 1.15)));
        let [lowest, highest] = bounds(spheres.into_iter());
        assert!(lowest == low && (highest - high).distance(DVec3::new(0.05, 0.0, 0.0)) < 1e-12, "{lowest} {highest}");
    }
}
