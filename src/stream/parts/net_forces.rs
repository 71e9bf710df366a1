//! Net force and torque on free bodies: an arrow for each at the centre.

use glam::DVec3;

use super::FrameView;
use crate::{
    colors,
    observe::{NetForce, Schema, schema::BodySchema},
    sdk::{self, Arrows3D},
    stream::{
        chunks::{Chunks, TrackId},
        contract::FORCE,
        extract::Float3,
        palette::{Rgb, color},
    },
};

/// The arrow of a body [scene unit/s²].
type Arrow = fn(&NetForce, &BodySchema) -> DVec3;

/// The two kinds of arrows: name of the entity, colour, and its value in a frame as an acceleration [scene unit/s²].
pub const KINDS: [(&str, Rgb, Arrow); 2] = [
    ("net_force", colors::WHITE, |net, body| net.force / body.mass),
    ("torque", colors::YELLOW, |net, body| net.torque / (body.mass * body.radius)),
];

/// The arrows, with the last logged values.
pub struct NetForces {
    tracks: [TrackId; KINDS.len()],
    last: [Rows; KINDS.len()],
}

/// Length of the longest arrow [radii]: in an impact, net forces are ten times as strong as before and after it.
pub const LONGEST: f64 = 2.0;

/// Origins and vectors.
type Rows = (Vec<Float3>, Vec<Float3>);

impl NetForces {
    /// Logs static data; `None` if no body is free.
    pub fn new(schema: &Schema, chunks: &mut Chunks) -> Option<NetForces> {
        if !schema.bodies.iter().any(|body| body.is_free) {
            return None;
        }
        let tracks = KINDS.map(|(name, rgb, _)| {
            let entity = FORCE.of(&[name]);
            let style = Arrows3D::update_fields()
                .with_colors([color(rgb)])
                .with_radii([sdk::Radius::new_ui_points(2.5)])
                .with_show_labels(false);
            chunks.log_static(&entity, &style);
            chunks.track(&entity, [Arrows3D::descriptor_origins(), Arrows3D::descriptor_vectors()])
        });
        Some(NetForces { tracks, last: Default::default() })
    }

    /// Logs changed values.
    pub fn log(&mut self, view: FrameView<'_>, chunks: &mut Chunks) {
        for ((track, last), (.., acceleration)) in self.tracks.iter().zip(&mut self.last).zip(KINDS) {
            let (mut origins, mut vectors) = Rows::default();
            for (body, now) in view.bodies() {
                let Some(net) = &now.net_force else { continue };
                let vector = view.schema.net_force_scale * acceleration(net, body);
                let vector = vector.clamp_length_max(LONGEST * body.radius).as_vec3().to_array();
                if vector != [0.0; 3] {
                    origins.push(now.centre.as_vec3().to_array());
                    vectors.push(vector);
                }
            }
            if *last != (origins.clone(), vectors.clone()) {
                chunks.push(*track, view.at, &[&origins, &vectors]);
                *last = (origins, vectors);
            }
        }
    }
}
