//! Values of single vertices, which the viewer shows when one is hovered or selected.

use std::sync::Arc;

use super::heat;

use crate::{
    geometry::Mesh,
    observe::{BodyFrame, Schema, schema::BodySchema},
    sdk::{AnyValues, arrow::array::UInt32Array, components::Text},
    stream::{
        chunks::{Chunks, TrackId},
        contract::{DISPLACEMENT, HEAT_PLACES, REACH, VERTEX, VERTEX_BODY, VERTEX_NET_FORCE},
        instant::Instant,
    },
};

/// Values of vertices. Reused.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct VertexNumbers {
    /// |x| [radii], `[drawn_vertex_count]`.
    displacement: Vec<f32>,
    /// |x″| [scene unit/s²], `[drawn_vertex_count]`.
    net: Vec<f32>,
    /// Texture coordinates of the displacement's colour.
    heat: Vec<[f32; 2]>,
    /// Description of the forces that act on the vertex.
    reach: Vec<&'static str>,
}

impl VertexNumbers {
    /// Appends the values of another set.
    pub fn extend(&mut self, of: &VertexNumbers) {
        self.displacement.extend_from_slice(&of.displacement);
        self.net.extend_from_slice(&of.net);
        self.heat.extend_from_slice(&of.heat);
        self.reach.extend_from_slice(&of.reach);
    }

    /// Appends the values of a body's vertices; `end_of_heat` is the displacement at the end of the colours [radii].
    pub fn append(&mut self, schema: &Schema, body: &BodySchema, now: &BodyFrame, end_of_heat: f64) {
        let first = self.displacement.len();
        let end = first + now.mesh_of(body).vertex_count();
        let inverse = 1.0 / body.radius;
        self.displacement.extend(now.lengths.iter().map(|length| (length * inverse) as f32));
        self.displacement.resize(end, 0.0);
        self.heat.extend(self.displacement[first..].iter().map(|&displacement| heat::place(displacement, end_of_heat)));
        match schema.sum_of_terms() {
            Some(sum) => {
                let net = now.terms.get(sum).into_iter().flat_map(|net| net.accelerations.iter());
                self.net.extend(net.map(|force| force.length() as f32));
            }
            None => {
                let acting = || now.terms.iter().filter(|term| !term.accelerations.is_empty());
                let count = if acting().next().is_some() { end - first } else { 0 };
                let net = |i: usize| acting().map(|term| term.accelerations.get(i)).sum::<glam::DVec3>();
                self.net.extend((0..count).map(|i| net(i).length() as f32));
            }
        }
        self.net.resize(end, 0.0);
        if let Some(&nothing) = schema.labels.first() {
            self.reach.extend(now.labels.iter().filter_map(|&label| schema.labels.get(usize::from(label)).copied()));
            self.reach.resize(end, nothing);
        }
        if let Some(facets) = now.mesh_of(body).facets() {
            facets.extend(&mut self.displacement, first);
            facets.extend(&mut self.net, first);
            facets.extend(&mut self.heat, first);
            if !schema.labels.is_empty() {
                facets.extend(&mut self.reach, first);
            }
        }
    }

    /// Removes all values and keeps the allocation.
    pub fn clear(&mut self) {
        self.displacement.clear();
        self.net.clear();
        self.heat.clear();
        self.reach.clear();
    }
}

/// The vertex values of an entity.
pub struct Vertices {
    numbers: TrackId,
    reach: TrackId,
}

impl Vertices {
    /// Creates the tracks.
    pub fn new(entity: &str, chunks: &mut Chunks) -> Vertices {
        let numbers = [DISPLACEMENT, VERTEX_NET_FORCE, HEAT_PLACES].map(|component| component.descriptor());
        Vertices { numbers: chunks.track(entity, numbers), reach: chunks.track(entity, [REACH.descriptor()]) }
    }

    /// Logs changed values.
    pub fn log(
        &self,
        at: Instant,
        VertexNumbers { displacement, net, heat, reach }: &VertexNumbers,
        chunks: &mut Chunks,
    ) {
        chunks.push_changed(self.numbers, at, &[displacement, net, heat]);
        chunks.push_changed(self.reach, at, &[reach]);
    }
}

/// The body and the index of each vertex of its mesh.
pub fn identity(body: &str, mesh: &Mesh) -> AnyValues {
    AnyValues::default()
        .with_component::<Text>(VERTEX_BODY.0, [body])
        .with_component_from_data(VERTEX.0, Arc::new(UInt32Array::from(indices(mesh))))
}

/// The index of each vertex that is drawn of a mesh.
pub fn indices(mesh: &Mesh) -> Vec<u32> {
    let mut indices: Vec<u32> = (0..mesh.vertex_count() as u32).collect();
    mesh.facets().into_iter().for_each(|facets| facets.extend(&mut indices, 0));
    indices
}
