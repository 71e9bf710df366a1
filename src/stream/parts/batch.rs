//! Many bodies in few entities: deformed bodies in one mesh, all others as instances of their shapes.

use std::sync::Arc;

use glam::DQuat;

use super::{
    FrameView,
    merged::{HIDDEN, drawn},
    vertices::{self, Vertices},
};
use crate::{
    geometry::Mesh,
    sdk::{AnyValues, InstancePoses3D, Mesh3D, Quaternion, arrow::array::UInt32Array, components::Text},
    stream::{
        chunks::{Chunks, TrackId},
        contract::{DEFORMING, LIT, RESTING, VERTEX, VERTEX_BODY},
        extract::{Extractor, Float3, Surface},
        light::{self, Light},
        palette::{self, color},
        settings::Detail,
    },
};

/// Displacement above which a body counts as deformed [radii]; below it, the body is drawn as an instance of its shape.
pub const DEFORMED: f64 = 1e-6;

/// An undeformed body: its index, radius (0 if it is absent), centre and rotation.
type Instance = (usize, f32, Float3, [f32; 4]);

/// All bodies in shared entities.
pub struct BatchedBodies {
    track: TrackId,
    deforming: Vec<usize>,
    /// The deformed bodies that are not part of a merged surface; `None` if not logged yet.
    drawn: Option<Vec<usize>>,
    /// The surfaces of the deformed bodies. Reused.
    surface: Surface,
    /// Lit colours of the deformed bodies. Reused.
    lit: Vec<u32>,
    resting: Option<Vec<Instance>>,
    /// Meshes of bodies that have torn.
    torn: Vec<Arc<Mesh>>,
    /// Whether any body has rotated yet: until then, instances have no rotations.
    has_rotated: bool,
    /// Values of single vertices, only if forces are recorded.
    vertices: Option<Vertices>,
    numbers: vertices::VertexNumbers,
}

impl BatchedBodies {
    /// Logs static data.
    pub fn new(detail: Detail, chunks: &mut Chunks) -> BatchedBodies {
        chunks.log_static(DEFORMING.path, &light::unlit());
        let components = [Mesh3D::descriptor_vertex_positions(), Mesh3D::descriptor_vertex_normals(), LIT.descriptor()];
        let track = chunks.track(DEFORMING.path, components);
        let vertices = (detail != Detail::Surface).then(|| Vertices::new(DEFORMING.path, chunks));
        let (surface, numbers) = Default::default();
        let (drawn, resting, torn, has_rotated) = (None, None, Vec::new(), false);
        let (deforming, lit) = (Vec::new(), Vec::new());
        BatchedBodies { track, deforming, drawn, surface, lit, resting, torn, has_rotated, vertices, numbers }
    }

    /// Logs changed values; `numbers` are the values of each body's vertices, if they are recorded. Bodies that are
    /// part of a merged surface count as deformed; their own surfaces are not drawn.
    pub fn log(
        &mut self,
        view: FrameView<'_>,
        is_merged: &[bool],
        numbers: &[vertices::VertexNumbers],
        extractor: &mut Extractor,
        chunks: &mut Chunks,
    ) {
        let (bodies, now) = (&view.schema.bodies, &view.frame.bodies);
        let is_merged = |i: usize| is_merged.get(i).copied().unwrap_or(false);
        let (deforming, resting): (Vec<usize>, Vec<usize>) = (0..now.len()).partition(|&i| {
            is_merged(i) || now[i].mesh.is_some() || now[i].max_displacement > DEFORMED * bodies[i].radius
        });
        self.surface.clear();
        for &i in &deforming {
            self.surface.append_in_world(&bodies[i], &now[i], extractor);
        }
        if let Some(vertices) = &mut self.vertices {
            self.numbers.clear();
            deforming.iter().filter_map(|&i| numbers.get(i)).for_each(|numbers| self.numbers.extend(numbers));
            vertices.log(view.at, &self.numbers, chunks);
        }
        let torn = || now.iter().filter_map(|now| now.mesh.as_ref());
        let is_same =
            torn().count() == self.torn.len() && torn().zip(&self.torn).all(|(now, last)| Arc::ptr_eq(now, last));
        if deforming != self.deforming || !is_same {
            self.torn = torn().cloned().collect();
            self.log_layout(view, &deforming, chunks);
            self.deforming = deforming;
            self.drawn = None;
        }
        if !self.deforming.is_empty() {
            let now_drawn: Vec<usize> = self.deforming.iter().copied().filter(|&i| !is_merged(i)).collect();
            if self.drawn.as_ref() != Some(&now_drawn) {
                self.log_drawn(view, is_merged, chunks);
                self.drawn = Some(now_drawn);
            }
        }
        let Surface { positions, normals } = &self.surface;
        if chunks.has_changed(self.track, &[positions, normals]) {
            let colors = self.deforming.iter().flat_map(|&i| {
                let count = now[i].mesh_of(&bodies[i]).drawn_vertex_count();
                std::iter::repeat_n(palette::of_body(view.schema, i), count)
            });
            let light = Light::in_world(view.schema);
            self.lit.clear();
            self.lit.extend(colors.zip(normals).map(|(rgb, &normal)| light.on(rgb, normal)));
            chunks.push(self.track, view.at, &[positions, normals, &self.lit]);
        }
        self.has_rotated |= resting.iter().any(|&i| now[i].rotation != DQuat::IDENTITY);
        let radius = |i: usize| if now[i].is_absent { 0.0 } else { bodies[i].radius as f32 };
        let instance =
            |i: usize| (i, radius(i), now[i].centre.as_vec3().to_array(), now[i].rotation.as_quat().to_array());
        let resting = resting.into_iter().map(instance).collect();
        if self.resting.is_none() {
            BatchedBodies::log_shapes(view, extractor, chunks);
        }
        if self.resting.as_ref() != Some(&resting) {
            self.log_resting(view, &resting, chunks);
            self.resting = Some(resting);
        }
    }

    /// Logs the shapes of bodies at rest.
    fn log_shapes(view: FrameView<'_>, extractor: &mut Extractor, chunks: &mut Chunks) {
        let light = Light::in_world(view.schema);
        for (shape, mesh) in view.schema.shapes() {
            let normals = extractor.normals(mesh, mesh.positions());
            // shared by all instances: the light rotates with a rotated instance
            let lit: Vec<u32> = normals.iter().map(|&normal| light.white(normal)).collect();
            let lit = light::unlit().with_component_from_data(LIT.0, Arc::new(UInt32Array::from(lit)));
            chunks.log(&RESTING.of(&[shape]), view.at, &lit);
            let positions = vertices::indices(mesh).into_iter().map(|i| mesh.positions().get(i as usize).as_vec3());
            let mesh = Mesh3D::new(positions)
                .with_vertex_normals(normals)
                .with_triangle_indices(mesh.drawn_triangles().iter().copied())
                .with_albedo_factor(palette::opaque(palette::RESTING));
            chunks.log(&RESTING.of(&[shape]), view.at, &mesh);
        }
    }

    /// Logs the triangles, and the body to which each vertex belongs.
    fn log_layout(&self, view: FrameView<'_>, deforming: &[usize], chunks: &mut Chunks) {
        let (mut first, mut triangles, mut colors, mut names, mut indices) = (0, vec![], vec![], vec![], vec![]);
        for &i in deforming {
            let body = &view.schema.bodies[i];
            let mesh = view.frame.bodies[i].mesh_of(body);
            let count = mesh.drawn_vertex_count();
            triangles.extend(mesh.drawn_triangles().iter().map(|t| t.map(|v| v + first)));
            colors.extend(std::iter::repeat_n(color(palette::of_body(view.schema, i)), count));
            names.extend(std::iter::repeat_n(body.name.as_str(), count));
            indices.extend(vertices::indices(mesh));
            first += count as u32;
        }
        let mesh = Mesh3D::update_fields().with_triangle_indices(triangles).with_vertex_colors(colors);
        chunks.log(DEFORMING.path, view.at, &mesh);
        let identity = body_names(&names).with_component_from_data(VERTEX.0, Arc::new(UInt32Array::from(indices)));
        chunks.log(DEFORMING.path, view.at, &identity);
    }

    /// Logs the triangles that are drawn.
    fn log_drawn(&self, view: FrameView<'_>, is_merged: impl Fn(usize) -> bool, chunks: &mut Chunks) {
        let (mut first, mut triangles) = (0, HIDDEN.to_vec());
        for &i in &self.deforming {
            let mesh = view.frame.bodies[i].mesh_of(&view.schema.bodies[i]);
            if !is_merged(i) {
                triangles.extend(mesh.drawn_triangles().iter().map(|t| t.map(|v| v + first)));
            }
            first += mesh.drawn_vertex_count() as u32;
        }
        chunks.log(DEFORMING.path, view.at, &drawn(&triangles));
    }

    /// Logs the instances of the shapes whose instances have changed.
    fn log_resting(&self, view: FrameView<'_>, resting: &[Instance], chunks: &mut Chunks) {
        for shape in view.schema.shapes().keys() {
            let of_shape = |list: &[Instance]| -> Vec<Instance> {
                list.iter().copied().filter(|&(i, ..)| view.schema.bodies[i].shape == *shape).collect()
            };
            let instances = of_shape(resting);
            if self.resting.as_ref().is_some_and(|last| of_shape(last) == instances) {
                continue;
            }
            let bodies = || instances.iter().map(|&(i, ..)| &view.schema.bodies[i]);
            let mut poses = InstancePoses3D::update_fields()
                .with_translations(instances.iter().map(|&(_, _, centre, _)| centre))
                .with_scales(instances.iter().map(|&(_, radius, ..)| [radius; 3]));
            if self.has_rotated {
                poses = poses.with_quaternions(instances.iter().map(|&(.., rotation)| Quaternion::from_xyzw(rotation)));
            }
            let names: Vec<&str> = bodies().map(|body| body.name.as_str()).collect();
            chunks.log(&RESTING.of(&[shape]), view.at, &poses);
            chunks.log(&RESTING.of(&[shape]), view.at, &body_names(&names));
        }
    }
}

/// The body of each vertex or instance, shown when it is selected.
fn body_names(names: &[&str]) -> AnyValues {
    AnyValues::default().with_component::<Text>(VERTEX_BODY.0, names.iter().copied())
}
