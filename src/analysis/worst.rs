//! The largest difference between two states.

use glam::DVec3;

use crate::observe::{Instant, schema::BodySchema};

/// The vertex at which two states differ most.
#[derive(Clone, Debug, PartialEq)]
pub struct Worst {
    /// The step of both states.
    pub step: u64,
    /// Simulated time of that step [s].
    pub time: f64,
    /// Name of the body.
    pub body: String,
    /// Index of the vertex in the body.
    pub vertex: usize,
    /// Its position in the first, recorded state [scene unit].
    pub recorded: DVec3,
    /// Its position in the second state [scene unit].
    pub found: DVec3,
    /// Distance between the two positions [radii of the body].
    pub difference: f64,
    /// Number of vertices that differ.
    pub vertices: usize,
}

impl Worst {
    /// The worst vertex of a body, given its vertex positions in two states. Distances up to `noise` [scene unit] do
    /// not count as a difference. NaN is worse than any number. `None` if there is no difference.
    pub fn of(
        at: Instant,
        body: &BodySchema,
        noise: f64,
        positions: impl Iterator<Item = (DVec3, DVec3)>,
    ) -> Option<Worst> {
        let (mut worst, mut largest, mut vertices) = (None, 0.0, 0);
        for (vertex, (recorded, found)) in positions.enumerate() {
            let distance = recorded.distance(found);
            if recorded == found || distance <= noise {
                continue;
            }
            vertices += 1;
            if worst.is_none() || !f64::is_nan(largest) && !(distance <= largest) {
                (worst, largest) = (Some((vertex, recorded, found)), distance);
            }
        }
        let (vertex, recorded, found) = worst?;
        let (difference, body) = (largest / body.radius, body.name.clone());
        Some(Worst { step: at.step, time: at.time, body, vertex, recorded, found, difference, vertices })
    }

    /// The worse of two differences at the same instant, with the vertex counts of both added.
    pub fn and(one: Option<Worst>, other: Option<Worst>) -> Option<Worst> {
        let (one, other) = match (one, other) {
            (Some(one), Some(other)) => (one, other),
            (one, other) => return one.or(other),
        };
        let vertices = one.vertices + other.vertices;
        let worse = if one.difference.is_nan() || other.difference <= one.difference { one } else { other };
        Some(Worst { vertices, ..worse })
    }
}
