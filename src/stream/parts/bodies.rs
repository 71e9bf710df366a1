//! One transform and one mesh a body.

use glam::DVec3;
use rerun::{Mesh3D, Transform3D};

use super::{
    Look,
    vertices::{self, Vertices, identity},
};
use crate::{
    scene::Scene,
    stream::{
        chunks::{Chunks, Track},
        columns::Cell,
        extract::{Extractor, Surface},
        normals::Vector,
        palette,
        settings::Detail,
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
    /// Only with forces.
    vertices: Option<Vertices>,
}

impl Bodies {
    /// Logs what stays the same.
    pub fn new(scene: &Scene, detail: Detail, chunks: &mut Chunks) -> Bodies {
        let bodies = scene.bodies.iter().enumerate().map(|(index, body)| {
            let entity = format!("/world/bodies/{}", body.name);
            let surface = format!("{entity}/surface");
            let mesh = Mesh3D::update_fields()
                .with_triangle_indices(body.shape.mesh().triangles().iter().copied())
                .with_albedo_factor(palette::translucent(palette::body(index)));
            chunks.log_static(&surface, &mesh);
            let vertices = (detail != Detail::Surface).then(|| {
                chunks.log_static(&surface, &identity(&body.name, body.shape.vertex_count()));
                Vertices::new(&surface, chunks)
            });
            Body {
                transform: chunks.track(&entity, [Transform3D::descriptor_translation()]),
                surface: chunks
                    .track(&surface, [Mesh3D::descriptor_vertex_positions(), Mesh3D::descriptor_vertex_normals()]),
                centre: None,
                last: Surface::default(),
                vertices,
            }
        });
        Bodies { bodies: bodies.collect(), next: Surface::default() }
    }

    /// Logs what has changed; `numbers` are those of the vertices of each body, if they are wanted.
    pub fn log(
        &mut self,
        look: Look<'_>,
        numbers: &[vertices::Numbers],
        extractor: &mut Extractor,
        chunks: &mut Chunks,
    ) {
        for (vertices, numbers) in self.bodies.iter_mut().map(|body| &mut body.vertices).zip(numbers) {
            if let Some(vertices) = vertices {
                vertices.log(look.at, numbers, chunks);
            }
        }
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
