//! The resultant force on each body by each cause: arrows at the centre, and plots.

use glam::DVec3;

use super::FrameView;
use crate::{
    colors::SILVER,
    observe::{
        BodyFrame, Schema,
        schema::{BodySchema, TermSchema},
    },
    sdk::{self, Arrows3D},
    stream::{
        chunks::{Chunks, TrackId},
        contract::{BODY_FORCE, RESULTANTS},
        extract::Float3,
        palette::color,
        series::{Interpolation, LineId, Series},
    },
    text::significant,
};

/// Upper limit on the number of bodies with plots and labels: of more, one would not find a tab.
pub const MOST_BODIES: usize = 16;

/// With more bodies, labels leave out the cause.
const MOST_CAUSES: usize = 4;

/// Length of the longest arrow [largest radius]: it ends outside of its body.
const LONGEST: f64 = 1.5;

/// Arrows, and plots, each from the first frame in which its force acts.
pub struct BodyForces {
    /// By body and term; none if there are too many bodies.
    lines: Vec<Vec<Option<LineId>>>,
    /// Whether a term has acted on any body.
    has_acted: Vec<bool>,
    arrows: TrackId,
}

/// The arrows of a frame: origins, vectors, colours and labels.
#[derive(Default)]
struct ResultantRows {
    origins: Vec<Float3>,
    vectors: Vec<Float3>,
    colors: Vec<u32>,
    labels: Vec<String>,
}

/// A resultant: body, term, and acceleration [scene unit/s²].
type Resultant = (usize, usize, DVec3);

impl BodyForces {
    /// Starts without lines.
    pub fn new(schema: &Schema, chunks: &mut Chunks) -> BodyForces {
        let terms = schema.terms.len();
        let bodies = if schema.bodies.len() <= MOST_BODIES { schema.bodies.len() } else { 0 };
        let style = Arrows3D::update_fields().with_radii([sdk::Radius::new_ui_points(3.0)]).with_show_labels(true);
        chunks.log_static(RESULTANTS.path, &style);
        let components = [
            Arrows3D::descriptor_origins(),
            Arrows3D::descriptor_vectors(),
            Arrows3D::descriptor_colors(),
            Arrows3D::descriptor_labels(),
        ];
        let arrows = chunks.track(RESULTANTS.path, components);
        BodyForces { lines: vec![vec![None; terms]; bodies], has_acted: vec![false; terms], arrows }
    }

    /// Whether each term of the schema has acted on any body so far.
    pub fn have_acted(&self) -> &[bool] {
        &self.has_acted
    }

    /// Logs changed values.
    pub fn log(&mut self, view: FrameView<'_>, series: &mut Series, chunks: &mut Chunks) {
        let mut resultants: Vec<Resultant> = Vec::new();
        for (index, (body, now)) in view.bodies().enumerate() {
            for (number, term) in view.schema.terms.iter().enumerate() {
                let acceleration = resultant(number, (term, body), now);
                self.has_acted[number] |= acceleration.is_some();
                let acceleration = acceleration.unwrap_or_default();
                if acceleration != DVec3::ZERO {
                    resultants.push((index, number, acceleration));
                }
                let Some(line) = self.lines.get_mut(index).map(|lines| &mut lines[number]) else { continue };
                let strength = acceleration.length();
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
        let now = ResultantRows::of(view, &resultants, !self.lines.is_empty());
        chunks.push_changed(self.arrows, view.at, &[&now.origins, &now.vectors, &now.colors, &now.labels]);
    }
}

impl ResultantRows {
    /// Arrows from the centres, all on one scale, on which the longest is [`LONGEST`]. With `are_named`, that of the strongest cause on
    /// each body is labelled with the body, the cause and its value.
    fn of(view: FrameView<'_>, resultants: &[Resultant], are_named: bool) -> ResultantRows {
        let FrameView { schema, frame, .. } = view;
        let longest = resultants.iter().map(|(.., acceleration)| acceleration.length()).fold(0.0, f64::max);
        let scale = LONGEST * schema.largest_radius() / longest;
        let mut arrows = ResultantRows::default();
        for of_body in resultants.chunk_by(|one, other| one.0 == other.0) {
            let causes = of_body.iter().filter(|(_, term, _)| !schema.terms[*term].is_sum);
            let strongest = causes.max_by(|one, other| one.2.length_squared().total_cmp(&other.2.length_squared()));
            for resultant @ &(body, number, acceleration) in of_body {
                let term = &schema.terms[number];
                arrows.origins.push(frame.bodies[body].centre.as_vec3().to_array());
                arrows.vectors.push((scale * acceleration).as_vec3().to_array());
                arrows.colors.push(color(term.color).to_u32());
                let name = &schema.bodies[body].name;
                let value = || significant(acceleration.length());
                arrows.labels.push(match strongest == Some(resultant) && are_named {
                    // the colour says the cause, too, and long labels would cover each other
                    true if schema.bodies.len() > MOST_CAUSES => format!("{name} {}", value()),
                    true => format!("{name}: {} {}", term.name, value()),
                    false => String::new(),
                });
            }
        }
        // the others have their names alone, on arrows of no length
        let is_idle = |index: usize| !resultants.iter().any(|(body, ..)| *body == index);
        let idle = view.bodies().enumerate().filter(|(index, (_, now))| are_named && !now.is_absent && is_idle(*index));
        for (_, (body, now)) in idle {
            arrows.origins.push(now.centre.as_vec3().to_array());
            arrows.vectors.push([0.0; 3]);
            arrows.colors.push(color(SILVER).to_u32());
            arrows.labels.push(body.name.clone());
        }
        arrows
    }
}

/// The acceleration of a body by one cause [scene unit/s²]; `None` if it acts nowhere.
fn resultant(number: usize, (term, body): (&TermSchema, &BodySchema), now: &BodyFrame) -> Option<DVec3> {
    let at_vertices = now.terms.get(number).filter(|of| !of.accelerations.is_empty());
    let at_vertices = at_vertices.map(|of| match term.is_uniform {
        true => of.accelerations.get(0),
        false => now.mean_acceleration(body, of),
    });
    let at_points = now.point_forces.iter().filter(|force| force.term == number).map(|force| force.acceleration);
    at_vertices.into_iter().chain(at_points).reduce(|sum, acceleration| sum + acceleration)
}
