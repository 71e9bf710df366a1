//! One transform and one mesh per body.

use std::sync::Arc;

use glam::DQuat;

use super::{
    FrameView,
    merged::{HIDDEN, drawn},
    vertices::{self, Vertices, identity},
};
use crate::{
    geometry::Mesh,
    observe::{BodyFrame, Schema},
    sdk::{Mesh3D, Transform3D},
    stream::{
        chunks::{Chunks, TrackId},
        contract::{BODY, BODY_SURFACE, LIT},
        extract::{Extractor, Surface},
        light::{self, Light},
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
    transform: Transform,
    surface: TrackId,
    entity: String,
    lit: Lit,
    last: Surface,
    /// Whether `last` is the shape at rest.
    is_at_rest: bool,
    is_absent: bool,
    /// Whether the body's own mesh is drawn; `None` if not logged yet.
    is_drawn: Option<bool>,
    /// The mesh last logged, for a body that can tear.
    mesh: Option<Arc<Mesh>>,
    /// Values of single vertices, only if forces are recorded.
    vertices: Option<Vertices>,
}

/// The lit colours of a body.
struct Lit {
    track: TrackId,
    /// The rotation with which they were last computed.
    rotation: Option<DQuat>,
    /// Scratch storage, reused.
    colors: Vec<u32>,
}

impl Lit {
    /// Logs the lit colours of a surface that `has_changed`, or that has rotated so far that its lighting differs
    /// visibly.
    fn log(&mut self, view: FrameView<'_>, rotation: DQuat, surface: &Surface, has_changed: bool, chunks: &mut Chunks) {
        const VISIBLE: f64 = 0.05; // rad
        if !has_changed && self.rotation.is_some_and(|last| last.angle_between(rotation) < VISIBLE) {
            return;
        }
        self.rotation = Some(rotation);
        let light = Light::in_body(view.schema, rotation);
        self.colors.clear();
        self.colors.extend(surface.normals.iter().map(|&normal| light.white(normal)));
        chunks.push_changed(self.track, view.at, &[&self.colors]);
    }
}

/// The position of a body and, once it has rotated, its orientation.
struct Transform {
    translation: TrackId,
    /// Translation and rotation in one row: the viewer resets what a row does not contain to the identity.
    both: TrackId,
    /// Whether the body has rotated; until then no rotation is logged.
    has_rotated: bool,
}

impl Transform {
    fn new(entity: &str, chunks: &mut Chunks) -> Transform {
        let translation = chunks.track(entity, [Transform3D::descriptor_translation()]);
        // created at the start, so that its rows precede the one that marks a frame as complete
        let both = chunks.track(entity, [Transform3D::descriptor_translation(), Transform3D::descriptor_quaternion()]);
        Transform { translation, both, has_rotated: false }
    }

    fn log(&mut self, view: FrameView<'_>, now: &BodyFrame, chunks: &mut Chunks) {
        self.has_rotated |= now.rotation != DQuat::IDENTITY;
        let centre = [now.centre.as_vec3().to_array()];
        if self.has_rotated {
            chunks.push_changed(self.both, view.at, &[&centre, &[now.rotation.as_quat().to_array()]]);
        } else {
            chunks.push_changed(self.translation, view.at, &[&centre]);
        }
    }
}

impl SeparateBodies {
    /// Logs static data.
    pub fn new(schema: &Schema, detail: Detail, chunks: &mut Chunks) -> SeparateBodies {
        let bodies = schema.bodies.iter().enumerate().map(|(index, body)| {
            let (entity, surface) = (BODY.of(&[&body.name]), BODY_SURFACE.of(&[&body.name]));
            let color = palette::translucent(palette::of_body(schema, index));
            let mesh = Mesh3D::update_fields().with_albedo_factor(color);
            let triangles = body.mesh.drawn_triangles().iter().copied();
            // a static value could not change later
            chunks.log_static(&surface, &if body.can_tear { mesh } else { mesh.with_triangle_indices(triangles) });
            chunks.log_static(&surface, &light::unlit());
            let vertices = (detail != Detail::Surface).then(|| {
                if !body.can_tear {
                    chunks.log_static(&surface, &identity(&body.name, &body.mesh));
                }
                Vertices::new(&surface, chunks)
            });
            Logged {
                transform: Transform::new(&entity, chunks),
                surface: chunks
                    .track(&surface, [Mesh3D::descriptor_vertex_positions(), Mesh3D::descriptor_vertex_normals()]),
                lit: Lit { track: chunks.track(&surface, [LIT.descriptor()]), rotation: None, colors: Vec::new() },
                entity: surface,
                last: Surface::default(),
                is_at_rest: false,
                is_absent: false,
                is_drawn: None,
                mesh: None,
                vertices,
            }
        });
        SeparateBodies { bodies: bodies.collect(), next: Surface::default() }
    }

    /// Logs changed values; `numbers` are the values of each body's vertices, if they are recorded. Bodies that are
    /// part of a merged surface do not draw their own.
    pub fn log(
        &mut self,
        view: FrameView<'_>,
        is_merged: &[bool],
        numbers: &[vertices::VertexNumbers],
        extractor: &mut Extractor,
        chunks: &mut Chunks,
    ) {
        for (vertices, numbers) in self.bodies.iter_mut().map(|body| &mut body.vertices).zip(numbers) {
            if let Some(vertices) = vertices {
                vertices.log(view.at, numbers, chunks);
            }
        }
        for (index, ((body, now), track)) in view.bodies().zip(&mut self.bodies).enumerate() {
            let is_drawn = !is_merged.get(index).copied().unwrap_or(false);
            let mesh = now.mesh_of(body);
            if body.can_tear && !track.mesh.as_ref().is_some_and(|last| Arc::ptr_eq(last, mesh)) {
                let triangles = Mesh3D::update_fields().with_triangle_indices(mesh.drawn_triangles().iter().copied());
                chunks.log(&track.entity, view.at, &triangles);
                if track.vertices.is_some() {
                    chunks.log(&track.entity, view.at, &identity(&body.name, mesh));
                }
                track.mesh = Some(Arc::clone(mesh));
                track.is_drawn = None;
                track.is_at_rest = false;
            }
            if track.is_drawn != Some(is_drawn) {
                let triangles = if is_drawn { mesh.drawn_triangles() } else { HIDDEN.as_slice() };
                chunks.log(&track.entity, view.at, &drawn(triangles));
                track.is_drawn = Some(is_drawn);
            }
            track.transform.log(view, now, chunks);
            let was_at_rest = std::mem::replace(&mut track.is_at_rest, now.is_at_rest);
            let was_absent = std::mem::replace(&mut track.is_absent, now.is_absent);
            let mut has_changed = false;
            if !(was_at_rest && now.is_at_rest) || was_absent != now.is_absent {
                self.next.clear();
                self.next.append_in_body(body, now, extractor);
                has_changed = self.next != track.last;
            }
            if has_changed {
                std::mem::swap(&mut self.next, &mut track.last);
                let Surface { positions, normals } = &track.last;
                chunks.push(track.surface, view.at, &[positions, normals]);
            }
            track.lit.log(view, now.rotation, &track.last, has_changed, chunks);
        }
    }
}
