//! One transform and one mesh per body.

use glam::DVec3;
use rerun::{Mesh3D, Transform3D};

use super::{
    Look,
    vertices::{self, Vertices, identity},
};
use crate::{
    observe::Schema,
    stream::{
        chunks::{Chunks, TrackId},
        columns::Cell,
        extract::{Extractor, Surface},
        normals::Float3,
        palette,
        settings::Detail,
    },
};

/// All bodies, each with its own entities.
pub struct SeparateBodies {
    bodies: Vec<Logged>,
    next: Surface,
}

/// The last logged values of a body.
struct Logged {
    transform: TrackId,
    surface: TrackId,
    centre: Option<Float3>,
    last: Surface,
    /// Values of single vertices, only if forces are recorded.
    vertices: Option<Vertices>,
}

impl SeparateBodies {
    /// Logs static data.
    pub fn new(schema: &Schema, detail: Detail, chunks: &mut Chunks) -> SeparateBodies {
        let bodies = schema.bodies.iter().enumerate().map(|(index, body)| {
            let entity = format!("/world/bodies/{}", body.name);
            let surface = format!("{entity}/surface");
            let mesh = Mesh3D::update_fields()
                .with_triangle_indices(body.mesh.triangles().iter().copied())
                .with_albedo_factor(palette::translucent(palette::body(index)));
            chunks.log_static(&surface, &mesh);
            let vertices = (detail != Detail::Surface).then(|| {
                chunks.log_static(&surface, &identity(&body.name, body.vertex_count()));
                Vertices::new(&surface, chunks)
            });
            Logged {
                transform: chunks.track(&entity, [Transform3D::descriptor_translation()]),
                surface: chunks
                    .track(&surface, [Mesh3D::descriptor_vertex_positions(), Mesh3D::descriptor_vertex_normals()]),
                centre: None,
                last: Surface::default(),
                vertices,
            }
        });
        SeparateBodies { bodies: bodies.collect(), next: Surface::default() }
    }

    /// Logs what has changed; `numbers` are the values of each body's vertices, if they are recorded.
    pub fn log(
        &mut self,
        look: Look<'_>,
        numbers: &[vertices::VertexNumbers],
        extractor: &mut Extractor,
        chunks: &mut Chunks,
    ) {
        for (vertices, numbers) in self.bodies.iter_mut().map(|body| &mut body.vertices).zip(numbers) {
            if let Some(vertices) = vertices {
                vertices.log(look.at, numbers, chunks);
            }
        }
        for ((body, now), track) in look.bodies().zip(&mut self.bodies) {
            let centre = now.centre.as_vec3().to_array();
            if track.centre != Some(centre) {
                chunks.push(track.transform, look.at, &[Cell::Vectors(&[centre])]);
                track.centre = Some(centre);
            }
            if now.is_at_rest && !track.last.positions.is_empty() {
                continue;
            }
            self.next.clear();
            self.next.append(body, now, DVec3::ZERO, extractor);
            if self.next != track.last {
                std::mem::swap(&mut self.next, &mut track.last);
                let Surface { positions, normals } = &track.last;
                chunks.push(track.surface, look.at, &[Cell::Vectors(positions), Cell::Vectors(normals)]);
            }
        }
    }
}
