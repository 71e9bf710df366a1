//! One transform and one mesh a body.

use glam::DVec3;
use rerun::{Mesh3D, Transform3D};

use super::Look;
use crate::{
    scene::Scene,
    stream::{
        chunks::{Chunks, Track},
        columns::Cell,
        extract::{Extractor, Surface, Vector},
        palette,
    },
};

/// All bodies, each with entities of its own.
pub struct Bodies {
    bodies: Vec<Body>,
    next: Surface,
}

/// What was last logged of a body.
struct Body {
    transform: Track,
    surface: Track,
    centre: Option<Vector>,
    last: Surface,
}

impl Bodies {
    /// Logs what stays the same.
    pub fn new(scene: &Scene, chunks: &mut Chunks) -> Bodies {
        let bodies = scene.bodies.iter().enumerate().map(|(index, body)| {
            let entity = format!("/world/bodies/{}", body.name);
            let surface = format!("{entity}/surface");
            let mesh = Mesh3D::update_fields()
                .with_triangle_indices(body.shape.triangles())
                .with_albedo_factor(palette::translucent(palette::body(index)));
            chunks.log_static(&surface, &mesh);
            Body {
                transform: chunks.track(&entity, [Transform3D::descriptor_translation()]),
                surface: chunks
                    .track(&surface, [Mesh3D::descriptor_vertex_positions(), Mesh3D::descriptor_vertex_normals()]),
                centre: None,
                last: Surface::default(),
            }
        });
        Bodies { bodies: bodies.collect(), next: Surface::default() }
    }

    /// Logs what has changed.
    pub fn log(&mut self, look: Look<'_>, extractor: &mut Extractor, chunks: &mut Chunks) {
        for (body, track) in look.snapshot.bodies(look.scene).zip(&mut self.bodies) {
            let centre = body.centre().as_vec3().to_array();
            if track.centre != Some(centre) {
                chunks.push(track.transform, look.at, &[Cell::Vectors(&[centre])]);
                track.centre = Some(centre);
            }
            if body.is_at_rest() && !track.last.positions.is_empty() {
                continue;
            }
            self.next.clear();
            self.next.append(body, DVec3::ZERO, extractor);
            if self.next != track.last {
                std::mem::swap(&mut self.next, &mut track.last);
                let Surface { positions, normals } = &track.last;
                chunks.push(track.surface, look.at, &[Cell::Vectors(positions), Cell::Vectors(normals)]);
            }
        }
    }
}
