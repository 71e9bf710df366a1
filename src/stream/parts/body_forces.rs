//! Plots of the net force on each body by each cause.

use glam::DVec3;

use super::FrameView;
use crate::{
    observe::{Schema, frame::TermFrame, schema::TermSchema},
    stream::{
        chunks::Chunks,
        contract::BODY_FORCE,
        series::{Interpolation, LineId, Series},
    },
};

/// Upper limit on the number of bodies with plots: of more, one would not find a tab.
pub const MOST_BODIES: usize = 16;

/// The plots, each from the first frame in which its force acts.
pub struct BodyForces {
    /// By body and term; none if there are too many bodies.
    lines: Vec<Vec<Option<LineId>>>,
    /// Whether a term has acted on any body.
    has_acted: Vec<bool>,
}

impl BodyForces {
    /// Starts without lines.
    pub fn new(schema: &Schema) -> BodyForces {
        let terms = schema.terms.len();
        let bodies = if schema.bodies.len() <= MOST_BODIES { schema.bodies.len() } else { 0 };
        BodyForces { lines: vec![vec![None; terms]; bodies], has_acted: vec![false; terms] }
    }

    /// Whether each term of the schema has acted on any body so far.
    pub fn have_acted(&self) -> &[bool] {
        &self.has_acted
    }

    /// Logs changed values.
    pub fn log(&mut self, view: FrameView<'_>, series: &mut Series, chunks: &mut Chunks) {
        for now in &view.frame.bodies {
            for (has_acted, term) in self.has_acted.iter_mut().zip(&now.terms) {
                *has_acted |= !term.accelerations.is_empty();
            }
            now.point_forces.iter().for_each(|force| self.has_acted[force.term] = true);
        }
        for ((body, now), lines) in view.bodies().zip(&mut self.lines) {
            for (index, line) in lines.iter_mut().enumerate() {
                let term = &view.schema.terms[index];
                let at_vertices = now.terms.get(index).map_or(DVec3::ZERO, |of| mean(term, of));
                let at_points = now.point_forces.iter().filter(|force| force.term == index);
                let strength = (at_vertices + at_points.map(|force| force.acceleration).sum::<DVec3>()).length();
                if line.is_none() && strength > 0.0 {
                    let entity = BODY_FORCE.of(&[&body.name, term.name]);
                    Series::style(chunks, &entity, term.label, term.color, 1.5, Interpolation::Linear);
                    *line = Some(series.line(chunks, &entity, Interpolation::Linear));
                }
                if let Some(line) = *line {
                    series.log(chunks, line, strength, view.at);
                }
            }
        }
    }
}

/// The mean acceleration of the vertices of a body by one cause [scene unit/s²].
fn mean(term: &TermSchema, of: &TermFrame) -> DVec3 {
    match of.accelerations.len() {
        0 => DVec3::ZERO,
        _ if term.is_uniform => of.accelerations.get(0),
        count => (0..count).map(|i| of.accelerations.get(i)).sum::<DVec3>() / count as f64,
    }
}
