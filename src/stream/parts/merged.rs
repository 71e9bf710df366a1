//! The surfaces of groups: one mesh in world coordinates, and the lines along which bodies meet.

use std::sync::{Arc, atomic::AtomicBool};

use glam::DVec3;
use rerun::{AnnotationContext, AnyValues, ComponentDescriptor, LineStrips3D, Mesh3D, components::TriangleIndices};

use super::FrameView;
use crate::{
    observe::{
        Schema,
        surface::{Group, Merged, Merger, VertexOrigin},
    },
    stream::{
        chunks::{Chunks, TrackId},
        columns::Cell,
        light::{self, Light},
        normals::Float3,
        palette::{self, color},
    },
};

/// The entity of the mesh.
pub const SURFACE: &str = "/world/merged/surface";
const SEAMS: &str = "/world/merged/seams";
/// The entity that names the bodies of vertices.
const CLASSES: &str = "/world/merged";

/// Component of a body's own mesh: the triangles drawn beside merged surfaces.
pub const DRAWN: &str = "drawn_triangles";
/// The triangles of a body that is drawn as part of a merged surface. (The viewer takes an empty list as unknown
/// triangles.)
pub const HIDDEN: [[u32; 3]; 1] = [[0; 3]];

/// The component [`DRAWN`].
pub fn drawn(triangles: &[[u32; 3]]) -> AnyValues {
    AnyValues::default().with_component::<TriangleIndices>(DRAWN, triangles.iter().copied())
}

/// Merged surfaces, with what was last logged of them.
pub struct MergedEntities {
    merger: Merger,
    surface: TrackId,
    seams: TrackId,
    /// The groups that were last logged.
    last: Vec<Arc<Group>>,
    mesh: Mesh,
}

/// The mesh of all groups. Reused.
#[derive(Default)]
struct Mesh {
    triangles: Vec<[u32; 3]>,
    positions: Vec<Float3>,
    normals: Vec<Float3>,
    colors: Vec<u32>,
    lit: Vec<u32>,
    classes: Vec<u16>,
    vertices: Vec<u32>,
    seams: Vec<Vec<Float3>>,
    names: Vec<String>,
    /// Scratch storage: sums of the triangle normals around each vertex.
    sums: Vec<DVec3>,
}

impl MergedEntities {
    /// Logs static data. After an interrupt, frames show overlapping meshes.
    pub fn new(schema: &Schema, interrupt: Option<&'static AtomicBool>, chunks: &mut Chunks) -> MergedEntities {
        let components = [
            Mesh3D::descriptor_triangle_indices(),
            Mesh3D::descriptor_vertex_positions(),
            Mesh3D::descriptor_vertex_normals(),
            Mesh3D::descriptor_vertex_colors(),
            light::descriptor(),
            Mesh3D::descriptor_class_ids(),
            ComponentDescriptor::partial("vertex"),
        ];
        if schema.bodies.len() > 1 {
            let names = schema.bodies.iter().zip(1..u16::MAX).map(|(body, class)| (class, body.name.as_str()));
            chunks.log_static(CLASSES, &AnnotationContext::new(std::iter::once((0, "seam")).chain(names)));
            let style = LineStrips3D::update_fields()
                .with_radii([rerun::Radius::new_ui_points(1.0)])
                .with_colors([color(palette::SEAM)])
                .with_show_labels(false);
            chunks.log_static(SEAMS, &style);
            let clear = Mesh3D::update_fields().with_albedo_factor(palette::translucent([0xFF; 3]));
            chunks.log_static(SURFACE, &clear);
            chunks.log_static(SURFACE, &light::unlit());
        }
        MergedEntities {
            merger: Merger::new(schema, interrupt),
            surface: chunks.track(SURFACE, components),
            seams: chunks.track(SEAMS, [LineStrips3D::descriptor_strips(), LineStrips3D::descriptor_labels()]),
            last: Vec::new(),
            mesh: Mesh::default(),
        }
    }

    /// Computes the surfaces of a frame, measures `pairs`, and logs what has changed.
    pub fn log(&mut self, view: FrameView<'_>, pairs: &[[usize; 2]], chunks: &mut Chunks) {
        let merged = self.merger.merge(view.schema, view.frame, pairs);
        let is_same = self.last.len() == merged.groups.len()
            && self.last.iter().zip(&merged.groups).all(|(last, now)| Arc::ptr_eq(last, now));
        if is_same {
            return;
        }
        self.last.clone_from(&merged.groups);
        self.mesh.clear();
        for group in &merged.groups {
            self.mesh.append(view.schema, group);
        }
        let Mesh { triangles, positions, normals, colors, lit, classes, vertices, seams, names, .. } = &self.mesh;
        let cells = [
            Cell::Triangles(triangles),
            Cell::Vectors(positions),
            Cell::Vectors(normals),
            Cell::Colors(colors),
            Cell::Colors(lit),
            Cell::Classes(classes),
            Cell::Indices(vertices),
        ];
        chunks.push(self.surface, view.at, &cells);
        chunks.push(self.seams, view.at, &[Cell::Strips(seams), Cell::Texts(names)]);
    }

    /// The surfaces and measures of the last frame.
    pub fn merged(&self) -> &Merged {
        self.merger.merged()
    }
}

impl Mesh {
    fn clear(&mut self) {
        let Mesh { triangles, positions, normals, colors, lit, classes, vertices, seams, names, sums } = self;
        triangles.clear();
        positions.clear();
        normals.clear();
        colors.clear();
        lit.clear();
        classes.clear();
        vertices.clear();
        seams.clear();
        names.clear();
        sums.clear();
    }

    fn append(&mut self, schema: &Schema, group: &Group) {
        let first = self.positions.len() as u32;
        let single = |position: &DVec3| position.as_vec3().to_array();
        self.positions.extend(group.positions.iter().map(single));
        self.triangles.extend(group.triangles.iter().map(|corners| corners.map(|v| v + first)));
        group.append_normals(&mut self.sums, &mut self.normals);
        for (origin, &normal) in group.origins.iter().zip(&self.normals[first as usize..]) {
            let rgb = palette::blended(schema, origin);
            self.colors.push(color(rgb).to_u32());
            self.lit.push(Light::in_world().on(rgb, normal));
        }
        let class = |origin: &VertexOrigin| match origin.vertex {
            Some(_) => u16::try_from(origin.bodies[0] + 1).unwrap_or(0),
            None => 0,
        };
        self.classes.extend(group.origins.iter().map(class));
        self.vertices.extend(group.origins.iter().map(|origin| origin.vertex.unwrap_or(u32::MAX)));
        for seam in &group.seams {
            self.seams.push(seam.positions.iter().map(single).collect());
            self.names.push(schema.pair_name(seam.bodies[0], seam.bodies[1]));
        }
    }
}
