//! Force points (3.1.2): influence spheres on paths of their own, which attract (3.4) or repel (3.5) for a time.

use super::{Moment, On, Origin, Phases, Source, Sphere, Surroundings, Term};
use crate::{
    scene::{Point, Scene, path::Kinematics},
    sim::{neighbours::Neighbour, span::Span},
};

pub struct Points;

impl Term for Points {
    fn at<P: Phases>(
        on: &On<'_, P>,
        moment: Moment,
        motion: &Kinematics,
        farthest: f64,
        surroundings: &mut Surroundings,
    ) {
        for neighbour in on.points {
            let (index, point) = on.point(neighbour);
            let centre = point.path.position(moment.time) - motion.position;
            let sphere_radius = on.tracks.motion_bounds(neighbour.other).sphere;
            if point.acts_at(moment.windows_at) && centre.length() <= sphere_radius + farthest {
                let (origin, strength) = (Origin::Point { index }, on.scene.point_strength(point, on.index as usize));
                surroundings.sources.push(Source { origin, centre, sphere_radius, strength });
            }
        }
    }

    fn over<P: Phases>(on: &On<'_, P>, near: &[Neighbour], part: Span, acting: &mut Vec<Sphere>) {
        for neighbour in near.iter().filter(|neighbour| neighbour.is_point()) {
            let (_, point) = on.point(neighbour);
            if point.acts_at(part.start) {
                let radius = on.tracks.motion_bounds(neighbour.other).sphere;
                let strength = on.scene.point_strength(point, on.index as usize);
                acting.push(Sphere::new(neighbour.other, radius, strength));
            }
        }
    }

    fn jumps<P: Phases>(on: &On<'_, P>, near: &[Neighbour], span: Span, jumps: &mut Vec<f64>) {
        let points = near.iter().filter(|neighbour| neighbour.is_point()).map(|neighbour| on.point(neighbour).1);
        jumps.extend(points.flat_map(|point| [point.start, point.end()]).filter(|&t| span.holds(t)));
    }
}

impl<'a, P> On<'a, P> {
    /// The force point that a neighbour is, with its index.
    fn point(&self, neighbour: &Neighbour) -> (u32, &'a Point) {
        let index = neighbour.other - self.scene.bodies.len() as u32;
        (index, &self.scene.points[index as usize])
    }
}

/// The force points that act on a body of the scene at some time.
pub(in crate::sim) fn neighbours(scene: &Scene, body: usize) -> Box<[Neighbour]> {
    let max_pull = scene.influence.weight.max_pull();
    let neighbour = |(other, point): (u32, &Point)| {
        let pull = scene.point_strength(point, body).abs() * scene.influence.sphere_radius(point.radius) * max_pull;
        Neighbour { other, pair: Neighbour::POINT, law: u32::MAX, pull, always_acts: true }
    };
    scene.points_on(body).map(neighbour).collect()
}
