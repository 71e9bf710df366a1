//! Trails: the paths that the centres of free bodies have taken. Every frame adds one segment for each; the viewer
//! shows those of the last seconds together.

use super::FrameView;
use crate::{
    observe::Schema,
    sdk::{self, LineStrips3D},
    stream::{
        chunks::{Chunks, TrackId},
        contract::TRAILS,
        extract::Float3,
        palette::{self, color},
    },
};

/// Length of the trails in the layout [s].
pub const SECONDS: f64 = 3.0;

/// The trails, with the last positions of the bodies.
pub struct Trails {
    track: TrackId,
    bodies: Vec<usize>,
    last: Vec<Float3>,
    were_absent: Vec<bool>,
    segments: Vec<[Float3; 2]>,
}

impl Trails {
    /// The trails of all free bodies; `None` if there are none.
    pub fn new(schema: &Schema, chunks: &mut Chunks) -> Option<Trails> {
        let bodies: Vec<usize> = (0..schema.bodies.len()).filter(|&i| schema.bodies[i].is_free).collect();
        if bodies.is_empty() {
            return None;
        }
        let style = LineStrips3D::update_fields()
            .with_colors(bodies.iter().map(|&i| color(palette::of_body(schema, i))))
            .with_radii([sdk::Radius::new_ui_points(1.2)]);
        chunks.log_static(TRAILS.path, &style);
        let track = chunks.track(TRAILS.path, [LineStrips3D::descriptor_strips()]);
        Some(Trails { track, bodies, last: Vec::new(), were_absent: Vec::new(), segments: Vec::new() })
    }

    /// Adds the segments since the last frame.
    pub fn log(&mut self, view: FrameView<'_>, chunks: &mut Chunks) {
        let centre = |&i: &usize| view.frame.bodies[i].centre.as_vec3().to_array();
        let now: Vec<Float3> = self.bodies.iter().map(centre).collect();
        let are_absent: Vec<bool> = self.bodies.iter().map(|&i| view.frame.bodies[i].is_absent).collect();
        if !self.last.is_empty() && self.last != now {
            self.segments.clear();
            let ends = self.last.iter().zip(&now).zip(self.were_absent.iter().zip(&are_absent));
            // a body that has just come has not moved to where it is
            self.segments.extend(ends.map(|((&from, &to), (was, is))| [if *was || *is { to } else { from }, to]));
            chunks.push(self.track, view.at, &[&self.segments]);
        }
        (self.last, self.were_absent) = (now, are_absent);
    }
}
