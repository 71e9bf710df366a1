//! The springs of bodies that are made of them, coloured by strain.

use super::FrameView;
use crate::{
    observe::{BodyFrame, Schema},
    sdk::{self, LineStrips3D},
    stream::{
        chunks::{Chunks, TrackId},
        contract::SPRINGS,
        extract::Float3,
        palette::{self, color},
    },
};

/// Line width [points on the screen].
const LINE: f32 = 1.5;

/// The springs.
pub struct Springs {
    /// Those of each body, in the order of the schema; `None` if the body has none.
    tracks: Vec<Option<TrackId>>,
    /// Those of a body in the frame. Reused.
    rows: Rows,
}

#[derive(Default)]
struct Rows {
    strips: Vec<[Float3; 2]>,
    colors: Vec<u32>,
}

impl Springs {
    /// Logs static data; `None` if no body has springs.
    pub fn new(schema: &Schema, chunks: &mut Chunks) -> Option<Springs> {
        if !schema.bodies.iter().any(|body| body.has_springs) {
            return None;
        }
        let mut track = |name: &str| {
            let entity = SPRINGS.of(&[name]);
            let style = LineStrips3D::update_fields().with_radii([sdk::Radius::new_ui_points(LINE)]);
            chunks.log_static(&entity, &style);
            let components = [LineStrips3D::descriptor_strips(), LineStrips3D::descriptor_colors()];
            chunks.track(&entity, components)
        };
        let tracks = schema.bodies.iter().map(|body| body.has_springs.then(|| track(&body.name)));
        Some(Springs { tracks: tracks.collect(), rows: Rows::default() })
    }

    /// Logs changed values.
    pub fn log(&mut self, view: FrameView<'_>, chunks: &mut Chunks) {
        for (track, now) in self.tracks.iter().zip(&view.frame.bodies) {
            let Some(track) = *track else { continue };
            self.rows.set(now);
            chunks.push_changed(track, view.at, &[&self.rows.strips, &self.rows.colors]);
        }
    }
}

impl Rows {
    fn set(&mut self, now: &BodyFrame) {
        self.strips.clear();
        self.strips
            .extend(now.springs.iter().map(|spring| spring.ends.map(|end| (now.centre + end).as_vec3().to_array())));
        self.colors.clear();
        self.colors.extend(now.springs.iter().map(|spring| color(palette::strain(spring.strain)).to_u32()));
    }
}
