//! Numbers of single vertices, which the viewer shows when one is pointed at or selected.

use std::sync::Arc;

use rerun::{AnyValues, ComponentDescriptor, Points3D, components::Text, external::arrow::array::UInt32Array};

use crate::{
    sim::{BodyForces, Cause, snapshot::SeenBody},
    stream::{
        chunks::{Chunks, Track},
        columns::Cell,
        instant::Instant,
        palette,
    },
};

/// The colours of the heat map end at this displacement [radii].
pub const HOTTEST: f64 = 0.5;

/// What there is to say of some vertices; reused.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Numbers {
    /// |x| [radii], `[vertex_count]`.
    displacement: Vec<f32>,
    /// |x″| [scene unit/s²], `[vertex_count]`.
    net: Vec<f32>,
    /// The displacement as a colour.
    heat: Vec<u32>,
    /// What influence spheres do to it.
    reach: Vec<&'static str>,
}

impl Numbers {
    /// Appends others.
    pub fn extend(&mut self, of: &Numbers) {
        self.displacement.extend_from_slice(&of.displacement);
        self.net.extend_from_slice(&of.net);
        self.heat.extend_from_slice(&of.heat);
        self.reach.extend_from_slice(&of.reach);
    }

    /// Appends those of a body on which `forces` act; `None`: nothing does.
    pub fn append(&mut self, body: SeenBody<'_>, forces: Option<&BodyForces>) {
        let n = body.vertex_count();
        let first = self.displacement.len();
        let inverse = 1.0 / body.scene().radius;
        self.displacement.extend(body.displacements().iter().map(|x| (x.length() * inverse) as f32));
        self.displacement.resize(first + n, 0.0);
        let heat = |&displacement: &f32| palette::heat(f64::from(displacement) / HOTTEST);
        self.heat.extend(self.displacement[first..].iter().map(heat));
        match forces {
            Some(forces) => {
                self.net.extend(forces.of(Cause::Net).iter().map(|force| force.length() as f32));
                let feels = |cause: Cause, i: usize| {
                    let forces = forces.of(cause);
                    (forces.x[i], forces.y[i], forces.z[i]) != (0.0, 0.0, 0.0)
                };
                self.reach.extend((0..n).map(|i| {
                    match [Cause::Attraction, Cause::Repulsion, Cause::Core].map(|cause| feels(cause, i)) {
                        [false, false, false] => "out of reach",
                        [true, false, false] => "attracted",
                        [false, true, false] => "repelled",
                        [_, _, true] => "in a core",
                        [true, true, false] => "attracted and repelled",
                    }
                }));
            }
            None => {
                self.net.resize(first + n, 0.0);
                self.reach.resize(first + n, "out of reach");
            }
        }
    }

    /// Keeps the storage, holds none.
    pub fn clear(&mut self) {
        self.displacement.clear();
        self.net.clear();
        self.heat.clear();
        self.reach.clear();
    }
}

/// The vertices of an entity, and what was last logged of them.
pub struct Vertices {
    numbers: Track,
    reach: Track,
    last: Numbers,
}

impl Vertices {
    /// None yet.
    pub fn new(entity: &str, chunks: &mut Chunks) -> Vertices {
        let of_ours = ["displacement_in_radii", "net_force"].map(ComponentDescriptor::partial);
        let [displacement, net] = of_ours;
        Vertices {
            numbers: chunks.track(entity, [displacement, net, Points3D::descriptor_colors()]),
            reach: chunks.track(entity, [ComponentDescriptor::partial("reach")]),
            last: Numbers::default(),
        }
    }

    /// Logs what has changed.
    pub fn log(&mut self, at: Instant, next: &Numbers, chunks: &mut Chunks) {
        let Numbers { displacement, net, heat, reach } = next;
        if (displacement, net) != (&self.last.displacement, &self.last.net) {
            chunks.push(self.numbers, at, &[Cell::Floats(displacement), Cell::Floats(net), Cell::Colors(heat)]);
            self.last.displacement.clone_from(displacement);
            self.last.net.clone_from(net);
        }
        if *reach != self.last.reach {
            chunks.push(self.reach, at, &[Cell::Names(reach)]);
            self.last.reach.clone_from(reach);
        }
    }
}

/// Says which body a vertex is of, and its number there.
pub fn identity(body: &str, count: u64) -> AnyValues {
    AnyValues::default()
        .with_component::<Text>("body", [body])
        .with_component_from_data("vertex", Arc::new(UInt32Array::from_iter_values(0..count as u32)))
}
