//! The parts of a frame. Each part owns its entities, keeps the values last logged to them, and logs
//! changes.
//!
//! | entities | module |
//! | --- | --- |
//! | `/world/bodies/NAME`, `…/surface` | [`bodies`] |
//! | `/world/resting/SHAPE`, `/world/deforming/surface` | [`batch`] |
//! | `/world/influence` | [`spheres`] |
//! | `/world/forces/CAUSE`, `…/net_force`, `…/torque` | [`forces`] |
//! | `/forces/NAME/CAUSE`, `/strongest/…`, `/world/resultants/…` | [`body_forces`] |
//! | `/ranking/pairs` | [`changes`] |
//! | style of `/ranking/…` and `/timings/ranking` | [`ranking`] |
//! | `/world/merged/surface`, `/world/merged/seams` | [`merged`] |
//! | `/groups/A/…`, `/volume/…` | [`groups`] |
//! | `/world/trails` | [`trails`] |
//! | `/stages/moves` | [`moves`] |
//! | `/world/planes/N` | [`planes`] |
//! | `/world/points` | [`points`] |
//! | `/world/springs/NAME` | [`springs`] |
//! | `/pairs/A~B/…`, `/events` | [`pairs`] |
//! | `/legend/…`, `/largest`, `/displacement` | [`heat`] |
//! | `/touching/MODEL` | [`touching`] |
//! | `/marks/…` | [`marks`] |
//! | `/world/pairs` | [`lines`] |
//! | `/world/names`, and labels of bodies | [`labels`] |
//! | `/world/recent`, `/recent/pair` | [`recent`] |
//! | `/largest`, `/stages/furthest`, and `/world/worst` of a comparison | [`callout`] |
//! | values of single vertices, on the entities of their surfaces | [`vertices`] |
//! | `/diagnostics/…`, `/timings/…` | [`numbers`] |

pub mod batch;
pub mod bodies;
pub mod body_forces;
pub mod callout;
pub mod changes;
pub mod forces;
pub mod groups;
pub mod heat;
pub mod labels;
pub mod lines;
pub mod marks;
pub mod merged;
pub mod moves;
pub mod numbers;
pub mod pairs;
pub mod planes;
pub mod points;
pub mod ranking;
pub mod recent;
pub mod spheres;
pub mod springs;
pub mod touching;
pub mod trails;
pub mod vertices;

use glam::DVec3;

use super::{
    blueprint::camera::{Arrangement, usual_eye},
    focus,
    instant::Instant,
};
use crate::geometry::bounds;
use crate::observe::{BodyFrame, Frame, Schema, schema::BodySchema};

/// With more bodies, the last event's pair is drawn alone too, and only the bodies that matter most are labelled.
const MAX_LABELS: usize = 8;

/// The input of a part: the frame to be logged.
#[derive(Clone, Copy)]
pub struct FrameView<'a> {
    /// The schema of the simulation.
    pub schema: &'a Schema,
    /// The state to be logged.
    pub frame: &'a Frame,
    /// The instant of that state.
    pub at: Instant,
    /// About where the camera is [scene unit].
    pub eye: DVec3,
    /// From the bodies towards the camera, normalized.
    pub back: DVec3,
}

impl<'a> FrameView<'a> {
    /// A view of a state alone.
    pub fn of(schema: &'a Schema, frame: &'a Frame, at: Instant) -> FrameView<'a> {
        FrameView::in_run(schema, frame, at, &[])
    }

    /// A view of a state in a run within these spheres (centre and radius), which are in view unless the bodies would be much
    /// smaller than alone.
    pub fn in_run(schema: &'a Schema, frame: &'a Frame, at: Instant, whole: &[(DVec3, f64)]) -> FrameView<'a> {
        let mut view = FrameView { schema, frame, at, eye: DVec3::ZERO, back: DVec3::ZERO };
        let present = view.bodies().filter(|(_, now)| !now.is_absent && now.centre.is_finite());
        let mut spheres: Vec<(DVec3, f64)> = present.map(|(body, now)| (now.centre, body.radius)).collect();
        if focus::width(whole) <= focus::WIDER * focus::width(&spheres) {
            spheres.extend(whole);
        }
        [view.eye, view.back] = usual_eye(&spheres, Arrangement::of(schema));
        view
    }

    pub(in crate::stream) fn bodies(self) -> impl Iterator<Item = (&'a BodySchema, &'a BodyFrame)> {
        self.schema.bodies.iter().zip(&self.frame.bodies)
    }

    /// The least and the largest corner of the box around the undeformed bodies [scene unit].
    pub fn bounds(self) -> [DVec3; 2] {
        let present = self.bodies().filter(|(_, now)| !now.is_absent);
        bounds(present.map(|(body, now)| (now.centre, body.radius)))
    }

    /// The height of the top of that box [scene unit].
    fn top(self) -> f64 {
        self.bounds().map(|corner| corner.dot(self.schema.up)).into_iter().fold(f64::NEG_INFINITY, f64::max)
    }
}
