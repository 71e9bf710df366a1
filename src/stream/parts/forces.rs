//! Forces as arrows: one batch a cause, only the vertices that feel it.

use rerun::Arrows3D;

use super::Look;
use crate::{
    sim::{BodyForces, Cause},
    stream::{
        chunks::{Chunks, Track},
        columns::Cell,
        extract::{Arrows, Extractor, Vector},
        palette::{self, color},
    },
};

/// What was last logged of them.
pub struct Forces {
    /// [scene unit per scene unit/s²]
    scale: f64,
    causes: [OfCause; Cause::ALL.len()],
    /// Reused.
    forces: BodyForces,
    origins: Vec<Vector>,
}

struct OfCause {
    track: Track,
    last: Arrows,
    next: Arrows,
}

impl Forces {
    /// Logs what stays the same. Arrows are `scale` long [scene unit per scene unit/s²].
    pub fn new(scale: f64, chunks: &mut Chunks) -> Forces {
        let causes = Cause::ALL.map(|cause| {
            let entity = entity(cause);
            let style = Arrows3D::update_fields()
                .with_colors([color(palette::cause(cause))])
                .with_radii([rerun::Radius::new_ui_points(1.2)]);
            chunks.log_static(&entity, &style);
            let track = chunks.track(&entity, [Arrows3D::descriptor_origins(), Arrows3D::descriptor_vectors()]);
            OfCause { track, last: Arrows::default(), next: Arrows::default() }
        });
        Forces { scale, causes, forces: BodyForces::default(), origins: Vec::new() }
    }

    /// Takes the arrows of what a frame is made from.
    pub fn extract(&mut self, look: Look<'_>, extractor: &mut Extractor) {
        self.causes.iter_mut().for_each(|cause| cause.next.clear());
        for body in look.snapshot.bodies(look.scene) {
            if body.is_at_rest() && body.surroundings().is_idle() {
                continue;
            }
            body.forces(look.scene, &mut self.forces);
            extractor.world_positions(body, &mut self.origins);
            for (cause, arrows) in Cause::ALL.into_iter().zip(&mut self.causes) {
                arrows.next.append(&self.origins, &self.forces, cause, self.scale);
            }
        }
    }

    /// Logs what has changed.
    pub fn log(&mut self, look: Look<'_>, chunks: &mut Chunks) {
        for OfCause { track, last, next } in &mut self.causes {
            if next != last {
                std::mem::swap(next, last);
                chunks.push(*track, look.at, &[Cell::Vectors(&last.origins), Cell::Vectors(&last.vectors)]);
            }
        }
    }
}

/// Where the arrows of a cause are.
pub fn entity(cause: Cause) -> String {
    format!("/world/forces/{}", cause.name())
}
