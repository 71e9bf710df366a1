//! Forces as arrows: one batch a cause, only the vertices that feel it.

use std::collections::{BTreeMap, btree_map::Entry};

use rerun::{AnnotationContext, Arrows3D};

use super::{Look, vertices};
use crate::{
    scene::Scene,
    sim::{BodyForces, Cause, snapshot::SeenBody, terms::Source},
    stream::{
        chunks::{Chunks, Track},
        columns::Cell,
        extract::{Arrows, Extractor},
        normals::Vector,
        palette::{self, color},
        settings::{Entities, arrow_scale},
    },
};

/// Says of the arrows below which bodies they are between.
const SOURCES: &str = "/world/forces";
/// More pairs than this are not told apart by their arrows.
const MOST_SOURCES: usize = 256;

/// What was last logged of them.
pub struct Forces {
    /// Length of an arrow [scene unit per scene unit/s²].
    scale: f64,
    causes: [OfCause; Cause::ALL.len()],
    /// Reused.
    forces: BodyForces,
    origins: Vec<Vector>,
    classes: Vec<u16>,
    /// What there is to say of the vertices of each body: of those at rest only if they have entities of their own.
    pub vertices: Vec<vertices::Numbers>,
    at_rest: Vec<bool>,
    of_resting: bool,
    sources: Sources,
}

struct OfCause {
    track: Track,
    last: Arrows,
    next: Arrows,
}

impl Forces {
    /// Logs what stays the same.
    pub fn new(scene: &Scene, entities: Entities, chunks: &mut Chunks) -> Forces {
        chunks.log_static(SOURCES, &AnnotationContext::new([OTHERS]));
        let causes = Cause::ALL.map(|cause| {
            let entity = entity(cause);
            let style = Arrows3D::update_fields()
                .with_colors([color(palette::cause(cause))])
                .with_radii([rerun::Radius::new_ui_points(1.2)])
                .with_show_labels(false);
            chunks.log_static(&entity, &style);
            let mut components = vec![Arrows3D::descriptor_origins(), Arrows3D::descriptor_vectors()];
            components.extend(has_source(cause).then(Arrows3D::descriptor_class_ids));
            let track = chunks.track(&entity, components);
            OfCause { track, last: Arrows::default(), next: Arrows::default() }
        });
        let count = scene.bodies.len();
        Forces {
            scale: arrow_scale(scene),
            causes,
            forces: BodyForces::default(),
            origins: Vec::new(),
            classes: Vec::new(),
            vertices: vec![vertices::Numbers::default(); count],
            at_rest: vec![false; count],
            of_resting: entities == Entities::Body,
            sources: Sources::default(),
        }
    }

    /// Takes the forces of what a frame is made from.
    pub fn extract(&mut self, look: Look<'_>, extractor: &mut Extractor) {
        self.causes.iter_mut().for_each(|cause| cause.next.clear());
        for (index, body) in look.snapshot.bodies(look.scene).enumerate() {
            let numbers = &mut self.vertices[index];
            if body.is_at_rest() && body.surroundings().is_idle() {
                if !std::mem::replace(&mut self.at_rest[index], true) {
                    numbers.clear();
                    if self.of_resting {
                        numbers.append(body, None);
                    }
                }
                continue;
            }
            self.at_rest[index] = false;
            body.forces(look.scene, &mut self.forces);
            numbers.clear();
            numbers.append(body, Some(&self.forces));
            extractor.world_positions(body, &mut self.origins);
            for (cause, arrows) in Cause::ALL.into_iter().zip(&mut self.causes) {
                self.classes.clear();
                if has_source(cause) {
                    let class = self.sources.class_of(look.scene, index, body, cause);
                    self.classes.resize(self.origins.len(), class);
                }
                arrows.next.append(&self.origins, &self.classes, &self.forces, cause, self.scale);
            }
        }
    }

    /// Logs what has changed.
    pub fn log(&mut self, look: Look<'_>, chunks: &mut Chunks) {
        self.sources.log(look.scene, chunks);
        for (cause, OfCause { track, last, next }) in Cause::ALL.into_iter().zip(&mut self.causes) {
            if next != last {
                std::mem::swap(next, last);
                let cells = [Cell::Vectors(&last.origins), Cell::Vectors(&last.vectors), Cell::Classes(&last.classes)];
                chunks.push(*track, look.at, if has_source(cause) { &cells } else { &cells[..2] });
            }
        }
    }
}

/// Whether a force comes from the influence sphere of another body.
fn has_source(cause: Cause) -> bool {
    matches!(cause, Cause::Attraction | Cause::Repulsion | Cause::Core)
}

/// The class of arrows that several bodies bring, or one that is not named.
const OTHERS: (u16, &str) = (0, "several or others");

/// Pairs of a body and the one whose sphere acts on it, as classes that the viewer names.
#[derive(Default)]
struct Sources {
    classes: BTreeMap<(usize, usize), u16>,
    logged: usize,
}

impl Sources {
    /// The class of arrows on body `index`: 0 if several bodies bring them, or more pairs are named already than fit.
    fn class_of(&mut self, scene: &Scene, index: usize, body: SeenBody<'_>, cause: Cause) -> u16 {
        let brings = |source: &&Source| source.cause() == cause;
        let mut sources = body.surroundings().sources.iter().filter(brings);
        let (Some(source), None) = (sources.next(), sources.next()) else { return 0 };
        let next = self.classes.len();
        let pair = (index, (source.body as usize).min(scene.bodies.len() - 1));
        match self.classes.entry(pair) {
            Entry::Occupied(known) => *known.get(),
            Entry::Vacant(free) if next < MOST_SOURCES => *free.insert(next as u16 + 1),
            Entry::Vacant(_) => 0,
        }
    }

    /// Names those that are new.
    fn log(&mut self, scene: &Scene, chunks: &mut Chunks) {
        if self.logged == self.classes.len() {
            return;
        }
        self.logged = self.classes.len();
        let name = |&(body, source): &(usize, usize)| {
            format!("on {} by {}", scene.bodies[body].name, scene.bodies[source].name)
        };
        let names: Vec<(u16, String)> = self.classes.iter().map(|(pair, &class)| (class, name(pair))).collect();
        let named = names.iter().map(|(class, name)| (*class, name.as_str()));
        chunks.log_static(SOURCES, &AnnotationContext::new([OTHERS].into_iter().chain(named)));
    }
}

/// Where the arrows of a cause are.
pub fn entity(cause: Cause) -> String {
    format!("/world/forces/{}", cause.name())
}
