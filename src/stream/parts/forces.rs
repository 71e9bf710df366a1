//! Forces as arrows: one batch per force term, only at vertices on which it acts; and net force and torque on free bodies, an
//! arrow for each at the centre.

use std::{
    collections::{BTreeMap, btree_map::Entry},
    sync::Arc,
};

use glam::DVec3;

use super::{FrameView, heat::Displacements, vertices};
use crate::{
    colors,
    observe::{NetForce, Schema, schema::BodySchema, surface::Group},
    sdk::{self, AnnotationContext, Arrows3D},
    stream::{
        chunks::{Chunks, TrackId},
        columns::Cell,
        contract::{FORCE, FORCES},
        extract::{Arrows, Extractor, Float3},
        palette::{Rgb, color},
        settings::Entities,
    },
};

/// Upper limit on the number of named pairs.
const MAX_SOURCES: usize = 256;

/// Acceleration of a body by a net force [scene unit/s²].
type NetAcceleration = fn(&NetForce, &BodySchema) -> DVec3;

/// The two kinds of arrows of net forces: name of the entity, colour, and value in a frame.
pub const NET_KINDS: [(&str, Rgb, NetAcceleration); 2] = [
    ("net_force", colors::MAGENTA, |net, _| net.force / net.mass),
    ("torque", colors::YELLOW, |net, body| net.torque / (net.mass * body.radius)),
];
/// Length of the longest arrow of a net force [largest radius]: in an impact, net forces are ten times as strong as before and after
/// it.
pub const LONGEST_NET: f64 = 2.0;

/// Force arrows.
pub struct Forces {
    terms: Vec<KindArrows>,
    /// Of each of [`NET_KINDS`]; none if no body is free.
    net: Vec<KindArrows>,
    /// Scratch storage, reused.
    origins: Vec<Float3>,
    /// Values of each body's vertices; for bodies at rest only if each body has its own entity.
    pub vertices: Vec<vertices::VertexNumbers>,
    /// The largest displacements of the frame.
    pub displacements: Displacements,
    at_rest: Vec<bool>,
    includes_resting: bool,
    sources: Sources,
}

struct KindArrows {
    track: TrackId,
    has_source: bool,
    /// The arrows of the frame. Reused.
    arrows: Arrows,
}

impl Forces {
    /// Logs static data.
    pub fn new(schema: &Schema, entities: Entities, chunks: &mut Chunks) -> Forces {
        chunks.log_static(FORCES.path, &AnnotationContext::new([OTHERS]));
        let mut kind = |name, rgb, is_at_centre, has_source: bool| {
            let entity = FORCE.of(&[name]);
            let style = Arrows3D::update_fields()
                .with_colors([color(rgb)])
                .with_radii([sdk::Radius::new_ui_points(if is_at_centre { 2.5 } else { 1.2 })])
                .with_show_labels(false);
            chunks.log_static(&entity, &style);
            let mut components = vec![Arrows3D::descriptor_origins(), Arrows3D::descriptor_vectors()];
            components.extend(has_source.then(Arrows3D::descriptor_class_ids));
            let track = chunks.track(&entity, components);
            KindArrows { track, has_source, arrows: Arrows::default() }
        };
        let terms =
            schema.terms.iter().map(|term| kind(term.name, term.color, term.is_uniform, term.has_source)).collect();
        let is_free = schema.bodies.iter().any(|body| body.is_free);
        let net = NET_KINDS.iter().filter(|_| is_free).map(|&(name, rgb, _)| kind(name, rgb, true, false)).collect();
        let count = schema.bodies.len();
        Forces {
            terms,
            net,
            origins: Vec::new(),
            vertices: vec![vertices::VertexNumbers::default(); count],
            displacements: Displacements::default(),
            at_rest: vec![false; count],
            includes_resting: entities == Entities::Body,
            sources: Sources::default(),
        }
    }

    /// Extracts the forces of a frame with these merged surfaces.
    pub fn extract(&mut self, view: FrameView<'_>, groups: &[Arc<Group>], extractor: &mut Extractor) {
        let FrameView { schema, .. } = view;
        let longest_net = LONGEST_NET * schema.largest_radius();
        self.displacements.find(view, groups);
        let end = self.displacements.end();
        self.terms.iter_mut().chain(&mut self.net).for_each(|kind| kind.arrows.clear());
        for (index, (body, now)) in view.bodies().enumerate() {
            for (kind, (.., acceleration)) in self.net.iter_mut().zip(NET_KINDS) {
                let Some(net) = &now.net_force else { continue };
                let vector = schema.net_force_scale * acceleration(net, body);
                kind.arrows.append_one(now.centre, vector.clamp_length_max(longest_net), None, 1.0);
            }
            let numbers = &mut self.vertices[index];
            if now.is_at_rest && !now.has_forces {
                if !std::mem::replace(&mut self.at_rest[index], true) {
                    numbers.clear();
                    if self.includes_resting {
                        numbers.append(schema, body, now, end);
                    }
                }
                continue;
            }
            self.at_rest[index] = false;
            numbers.clear();
            numbers.append(schema, body, now, end);
            extractor.world_positions(body, now, &mut self.origins);
            for ((term, of_schema), kind) in now.terms.iter().zip(&schema.terms).zip(&mut self.terms) {
                let acts = of_schema.has_source && !term.accelerations.is_empty();
                let scale = schema.arrow_scale_of(of_schema);
                let class = acts.then(|| self.sources.class_of(index, term.source));
                if of_schema.is_uniform {
                    if !term.accelerations.is_empty() {
                        kind.arrows.append_one(now.centre, term.accelerations.get(0), class, scale);
                    }
                    continue;
                }
                kind.arrows.append(&self.origins, class, &term.accelerations, scale);
            }
            for force in &now.point_forces {
                let (of_schema, kind) = (&schema.terms[force.term], &mut self.terms[force.term]);
                let class = of_schema.has_source.then(|| self.sources.class_of(index, force.source));
                let scale = schema.arrow_scale_of(of_schema);
                kind.arrows.append_one(now.centre + force.place, force.acceleration, class, scale);
            }
        }
    }

    /// Logs changed values.
    pub fn log(&mut self, view: FrameView<'_>, chunks: &mut Chunks) {
        self.sources.log(view.schema, chunks);
        for KindArrows { track, has_source, arrows } in self.terms.iter().chain(&self.net) {
            let cells: [&dyn Cell; _] = [&arrows.origins, &arrows.vectors, &arrows.classes];
            chunks.push_changed(*track, view.at, if *has_source { &cells } else { &cells[..2] });
        }
    }
}

/// The class of arrows caused by several bodies, or by a pair without a name.
const OTHERS: (u16, &str) = (0, "several or others");

/// Pairs of a body and the body whose sphere acts on it, as named classes of the viewer.
#[derive(Default)]
struct Sources {
    classes: BTreeMap<(usize, usize), u16>,
    logged: usize,
}

impl Sources {
    /// The class of arrows on body `index`: 0 if several bodies cause them, or if the limit on named pairs is reached.
    fn class_of(&mut self, index: usize, source: Option<u32>) -> u16 {
        let Some(source) = source else { return 0 };
        let next = self.classes.len();
        match self.classes.entry((index, source as usize)) {
            Entry::Occupied(known) => *known.get(),
            Entry::Vacant(free) if next < MAX_SOURCES => *free.insert(next as u16 + 1),
            Entry::Vacant(_) => 0,
        }
    }

    /// Logs the names of new pairs.
    fn log(&mut self, schema: &Schema, chunks: &mut Chunks) {
        if self.logged == self.classes.len() {
            return;
        }
        self.logged = self.classes.len();
        let name = |&(body, source): &(usize, usize)| {
            format!("on {} by {}", schema.bodies[body].name, schema.bodies[source].name)
        };
        let names: Vec<(u16, String)> = self.classes.iter().map(|(pair, &class)| (class, name(pair))).collect();
        let named = names.iter().map(|(class, name)| (*class, name.as_str()));
        chunks.log_static(FORCES.path, &AnnotationContext::new([OTHERS].into_iter().chain(named)));
    }
}
