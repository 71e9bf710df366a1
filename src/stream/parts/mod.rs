//! What a frame is made of: each part knows its entities, what was last logged to them, and logs what has changed.
//!
//! | entities | where |
//! | --- | --- |
//! | `/world/bodies/NAME`, `…/surface` | [`bodies`] |
//! | `/world/resting/SHAPE`, `/world/deforming/surface` | [`batch`] |
//! | `/world/influence` | [`spheres`] |
//! | `/world/forces/CAUSE` | [`forces`] |
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
use crate::{scene::Scene, sim::Snapshot};

/// More bodies than this go without their names in the picture.
const MOST_LABELS: usize = 8;

/// What a frame is made from.
#[derive(Clone, Copy)]
pub struct Look<'a> {
    /// The scene that is simulated.
    pub scene: &'a Scene,
    /// The state on screen: everything in a frame is of this instant.
    pub snapshot: &'a Snapshot,
    /// When that is.
    pub at: Instant,
}
