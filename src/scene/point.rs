//! Force points (3.1.2): influence spheres without a body.

use super::{Path, Scene};

/// A force point: an influence sphere on a path of its own. It attracts or repels vertices like the sphere of a body, but
/// has no phases and no mass, and nothing acts on it.
#[derive(Clone, Debug, PartialEq)]
pub struct Point {
    /// Name of the point, unique among the points of a scene.
    pub name: String,
    /// What moves its centre.
    pub path: Path,
    /// Radius R of a body with the same influence sphere [scene unit], > 0.
    pub radius: f64,
    /// Signed strength on a body of at least its size [1/s²]: α if it attracts (3.4), −β if it repels (3.5).
    pub strength: f64,
    /// Indices of the bodies that it acts on, ascending; `None` for all.
    pub bodies: Option<Vec<u32>>,
    /// When it begins to act [s], ≥ 0.
    pub start: f64,
    /// How long it acts [s], ≥ 0; infinite if for ever. It acts during [start, start + duration).
    pub duration: f64,
}

impl Point {
    /// When it ceases to act, exclusive [s].
    pub fn end(&self) -> f64 {
        self.start + self.duration
    }

    /// Removes a body from those that it acts on; the indices of later bodies decrease by one.
    pub(crate) fn remove_body(&mut self, index: usize) {
        if let Some(bodies) = &mut self.bodies {
            bodies.retain(|&body| body as usize != index);
            bodies.iter_mut().filter(|body| **body as usize > index).for_each(|body| *body -= 1);
        }
    }

    /// Whether it acts at `t` [s].
    pub fn acts_at(&self, t: f64) -> bool {
        self.start <= t && t < self.end()
    }

    /// Whether it acts on a body, at any time.
    pub fn acts_on(&self, body: usize) -> bool {
        self.bodies.as_ref().is_none_or(|bodies| bodies.binary_search(&(body as u32)).is_ok())
    }
}

impl Scene {
    /// The path of what has an influence sphere: of a body, or of a force point, which follow the bodies. `None` for a
    /// free body.
    pub fn source_path(&self, source: usize) -> Option<&Path> {
        match source.checked_sub(self.bodies.len()) {
            None => self.bodies[source].path(),
            Some(point) => Some(&self.points[point].path),
        }
    }

    /// The radius of a body, or of a force point, which follow the bodies [scene unit].
    pub fn source_radius(&self, source: usize) -> f64 {
        match source.checked_sub(self.bodies.len()) {
            None => self.bodies[source].radius,
            Some(point) => self.points[point].radius,
        }
    }

    /// The radius r_e of the influence sphere of a body, or of a force point, which follow the bodies [scene unit].
    pub fn source_sphere_radius(&self, source: usize) -> f64 {
        match source.checked_sub(self.bodies.len()) {
            None => self.bodies[source].sphere_radius(),
            Some(point) => self.influence.sphere_radius(self.points[point].radius),
        }
    }

    /// The force points that act on a body at some time, with their numbers as sources, which follow the bodies.
    pub fn points_on(&self, body: usize) -> impl Iterator<Item = (u32, &Point)> + '_ {
        let numbered = (self.bodies.len() as u32..).zip(&self.points);
        numbered.filter(move |(_, point)| point.strength != 0.0 && point.acts_on(body))
    }

    /// Signed strength with which a force point acts on a body while it acts [1/s²].
    pub fn point_strength(&self, point: &Point, body: usize) -> f64 {
        point.strength * self.influence.scale(self.bodies[body].radius, point.radius)
    }
}
