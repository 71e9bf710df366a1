//! What a frame is made of: each part knows its entities, what was last logged to them, and logs what has changed.
//!
//! | entities | where |
//! | --- | --- |
//! | `/world/bodies/NAME`, `…/surface` | [`bodies`] |
//! | `/world/resting/SHAPE`, `/world/deforming/surface` | [`batch`] |
//! | `/world/influence` | [`spheres`] |
//! | `/world/forces/TERM` | [`forces`] |
//! | `/pairs/A~B/…`, `/events` | [`pairs`] |
//! | `/world/pairs` | [`lines`] |
//! | single vertices, on the entities of their surfaces | [`vertices`] |
//! | `/diagnostics/…`, `/timings/…` | [`numbers`] |

pub mod batch;
pub mod bodies;
pub mod forces;
pub mod lines;
pub mod numbers;
pub mod pairs;
pub mod spheres;
pub mod vertices;

use super::instant::Instant;
use crate::observe::{BodyFrame, Frame, Schema, schema::BodySchema};

/// More bodies than this go without their names in the picture.
const MOST_LABELS: usize = 8;

/// What is logged of a frame.
#[derive(Clone, Copy)]
pub struct Look<'a> {
    /// What is simulated.
    pub schema: &'a Schema,
    /// The state on screen: everything that is logged is of this instant.
    pub frame: &'a Frame,
    /// When that is.
    pub at: Instant,
}

impl<'a> Look<'a> {
    fn bodies(self) -> impl Iterator<Item = (&'a BodySchema, &'a BodyFrame)> {
        self.schema.bodies.iter().zip(&self.frame.bodies)
    }
}
