//! Influence spheres, coloured by the deepest phase of their body.

use super::{FrameView, ranking::is_ranked};
use crate::{
    observe::{BodyFrame, Schema},
    sdk::{self, Ellipsoids3D, components::FillMode},
    stream::{
        chunks::{Chunks, TrackId},
        columns::Cell,
        contract::{INFLUENCE, PAIR_LINES},
        extract::Float3,
        palette::{self, Rgb, color},
        settings::Entities,
    },
};

/// Line width of wireframe spheres [points on the screen].
const LINE: f32 = 0.6;

/// Influence spheres.
pub struct SphereEntities {
    centres: TrackId,
    /// The radii.
    half_sizes: TrackId,
    colors: TrackId,
    /// In a batched scene, spheres that reach another body have a separate entity: thousands of wireframe spheres are
    /// slow to draw, and would hide them.
    reaching: Option<Reaching>,
    /// Colour of spheres that reach no other body.
    idle: Rgb,
}

/// The spheres of bodies with another body within reach, drawn with the pairs.
struct Reaching {
    track: TrackId,
    /// Whether there is a row already: the first one is logged even if no sphere reaches another body.
    has_begun: bool,
}

impl SphereEntities {
    /// Logs static data.
    pub fn new(schema: &Schema, entities: Entities, chunks: &mut Chunks) -> SphereEntities {
        let spheres = wireframe()
            .with_labels(schema.bodies.iter().map(|body| body.name.as_str()))
            // several bodies have their names beside them instead
            .with_show_labels(schema.bodies.len() == 1);
        chunks.log_static(INFLUENCE.path, &spheres);
        SphereEntities {
            centres: chunks.track(INFLUENCE.path, [Ellipsoids3D::descriptor_centers()]),
            half_sizes: chunks.track(INFLUENCE.path, [Ellipsoids3D::descriptor_half_sizes()]),
            colors: chunks.track(INFLUENCE.path, [Ellipsoids3D::descriptor_colors()]),
            reaching: (entities == Entities::Batch).then(|| Reaching::new(chunks)),
            idle: if is_ranked(schema) { palette::IDLE_SPHERE_OF_MANY } else { palette::IDLE_SPHERE },
        }
    }

    /// Logs changed values.
    pub fn log(&mut self, view: FrameView<'_>, chunks: &mut Chunks) {
        let size = |(body, now): (usize, &BodyFrame)| match now.is_absent {
            true => [0.0; 3],
            false => half_size(view.schema, body, view.at.time),
        };
        let sizes: Vec<Float3> = view.frame.bodies.iter().enumerate().map(size).collect();
        chunks.push_changed(self.half_sizes, view.at, &[&sizes]);
        let mut phases = vec![None; view.frame.bodies.len()]; // the deepest of each body
        for pair in &view.frame.pairs {
            for i in [pair.a, pair.b] {
                phases[i] = phases[i].max(Some(pair.phase));
            }
        }
        let centres: Vec<Float3> = view.frame.bodies.iter().map(|body| body.centre.as_vec3().to_array()).collect();
        chunks.push_changed(self.centres, view.at, &[&centres]);
        if let Some(reaching) = &mut self.reaching {
            reaching.log(view, &phases, chunks);
        }
        let rgb = |phase: &Option<usize>| phase.map_or(self.idle, |phase| view.schema.phases[phase].color);
        let colors: Vec<u32> = phases.iter().map(|phase| color(rgb(phase)).to_u32()).collect();
        chunks.push_changed(self.colors, view.at, &[&colors]);
    }
}

/// The style of influence spheres.
pub fn wireframe() -> Ellipsoids3D {
    Ellipsoids3D::update_fields()
        .with_fill_mode(FillMode::MajorWireframe)
        .with_line_radii([sdk::Radius::new_ui_points(LINE)])
}

/// The radius of the sphere of a body at a time [s], as a half size.
fn half_size(schema: &Schema, body: usize, time: f64) -> Float3 {
    [schema.reach(body, time) as f32; 3]
}

impl Reaching {
    fn new(chunks: &mut Chunks) -> Reaching {
        chunks.log_static(PAIR_LINES.path, &wireframe());
        let components = [
            Ellipsoids3D::descriptor_centers(),
            Ellipsoids3D::descriptor_half_sizes(),
            Ellipsoids3D::descriptor_colors(),
        ];
        Reaching { track: chunks.track(PAIR_LINES.path, components), has_begun: false }
    }

    fn log(&mut self, view: FrameView<'_>, phases: &[Option<usize>], chunks: &mut Chunks) {
        let (mut centres, mut half_sizes, mut colors): (Vec<Float3>, Vec<Float3>, Vec<u32>) = Default::default();
        for (i, phase) in phases.iter().enumerate() {
            let Some(phase) = *phase else { continue };
            centres.push(view.frame.bodies[i].centre.as_vec3().to_array());
            half_sizes.push([view.schema.reach(i, view.at.time) as f32; 3]);
            colors.push(color(view.schema.phases[phase].color).to_u32());
        }
        let cells: [&dyn Cell; _] = [&centres, &half_sizes, &colors];
        if !std::mem::replace(&mut self.has_begun, true) || chunks.has_changed(self.track, &cells) {
            chunks.push(self.track, view.at, &cells);
        }
    }
}
