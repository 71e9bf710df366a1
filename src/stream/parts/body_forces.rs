//! The resultant force on each body by each cause: arrows at the centre, plots, and a ranking of the strongest; of more than
//! a few bodies, a ranking of bodies, and a plot of the strongest on any of them.

use glam::DVec3;

use super::{
    FrameView,
    ranking::{self, Mark, Ranking, Row, is_ranked},
};
use crate::{
    colors::SILVER,
    observe::{
        BodyFrame, Schema,
        schema::{BodySchema, TermSchema},
    },
    sdk::{self, Arrows3D, Scalars, SeriesLines},
    stream::{
        chunks::{Chunks, TrackId},
        contract::{BODY_FORCE, RANKED_FORCES, RESULTANTS, STRONGEST},
        extract::Float3,
        palette::color,
        series::{Interpolation, LineId, Series},
    },
    text::significant,
};

/// Upper limit on the number of bodies with plots: of more, one would not find a tab.
pub const MOST_BODIES: usize = 16;

/// Length of the longest arrow [largest radius]: it ends outside of its body.
const LONGEST: f64 = 1.5;

/// A force that is weaker is left out of the ranking [strongest force].
const WEAK: f64 = 0.04;

/// Arrows, and plots, each from the first frame in which its force acts.
pub struct BodyForces {
    /// By body and term; none if there are too many bodies.
    lines: Vec<Vec<Option<LineId>>>,
    /// The strongest forces; of more than a few bodies, the net forces on them.
    ranking: Ranking,
    /// The lines of the strongest on any body, if there are more than a few.
    strongest: Option<TrackId>,
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
        BodyForces {
            lines: vec![vec![None; terms]; bodies],
            ranking: Ranking::new(RANKED_FORCES.path, chunks),
            strongest: is_ranked(schema).then(|| {
                let causes = || schema.terms.iter().filter(|term| is_plotted(term));
                let lines = SeriesLines::update_fields()
                    .with_names(causes().map(|term| term.label))
                    .with_colors(causes().map(|term| color(term.color)));
                chunks.log_static(STRONGEST.path, &lines);
                chunks.track(STRONGEST.path, [Scalars::descriptor_scalars()])
            }),
            has_acted: vec![false; terms],
            arrows,
        }
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
        let of_bodies = of_bodies(view.schema, &resultants);
        let labelled = ranking::labelled(view, of_bodies.iter().map(|of| of.body));
        let labels: Vec<&OfBody> = of_bodies.iter().filter(|of| labelled.contains(&of.body)).collect();
        let now = ResultantRows::of(view, &resultants, &labels);
        chunks.push_changed(self.arrows, view.at, &[&now.origins, &now.vectors, &now.colors, &now.labels]);
        let rows = match is_ranked(view.schema) {
            true => rows_of_bodies(view.schema, &of_bodies),
            false => rows_of_causes(view.schema, resultants.clone()),
        };
        self.ranking.log(rows.into_iter(), "no force acts on any body", view.at, chunks);
        let Some(track) = &self.strongest else { return };
        let strongest = |number: usize| {
            let of_term = resultants.iter().filter(|(_, term, _)| *term == number);
            of_term.map(|(.., acceleration)| acceleration.length()).fold(0.0, f64::max)
        };
        let causes = (0..view.schema.terms.len()).filter(|&number| is_plotted(&view.schema.terms[number]));
        chunks.push_changed(*track, view.at, &[&causes.map(strongest).collect::<Vec<f64>>()]);
    }
}

/// Whether there is a line of the strongest on any body.
fn is_plotted(term: &TermSchema) -> bool {
    term.can_act && !term.is_sum
}

/// What acts on a body as a whole.
struct OfBody {
    body: usize,
    /// The strength of all together [scene unit/s²], if the schema has a sum of its terms.
    net: Option<f64>,
    /// The strongest cause.
    strongest: Resultant,
}

impl OfBody {
    fn strongest(&self) -> f64 {
        self.strongest.2.length()
    }

    /// By which bodies are ranked.
    fn strength(&self) -> f64 {
        self.net.unwrap_or_else(|| self.strongest())
    }

    fn label(&self, schema: &Schema) -> String {
        let cause = format!("{} {}", schema.terms[self.strongest.1].name, significant(self.strongest()));
        let net = self.net.map_or(String::new(), |net| format!("net {}, ", significant(net)));
        format!("{}: {net}{cause}", schema.bodies[self.body].name)
    }
}

/// The bodies on which a force acts, those with the largest net forces first.
fn of_bodies(schema: &Schema, resultants: &[Resultant]) -> Vec<OfBody> {
    let sum = schema.terms.iter().position(|term| term.is_sum);
    let of_body = |all: &[Resultant]| {
        let causes = all.iter().filter(|(_, term, _)| Some(*term) != sum);
        let strongest = *causes.max_by(|one, other| one.2.length_squared().total_cmp(&other.2.length_squared()))?;
        let net = sum.map(|sum| all.iter().find(|(_, term, _)| *term == sum).map_or(0.0, |(.., net)| net.length()));
        Some(OfBody { body: strongest.0, net, strongest })
    };
    let mut of_bodies: Vec<OfBody> = resultants.chunk_by(|one, other| one.0 == other.0).filter_map(of_body).collect();
    of_bodies.sort_by(|one, other| other.strength().total_cmp(&one.strength()));
    of_bodies
}

/// A bar for the net force on each body, with a dot at its strongest cause.
fn rows_of_bodies(schema: &Schema, of_bodies: &[OfBody]) -> Vec<Row> {
    let largest = of_bodies.first().map_or(0.0, OfBody::strength);
    let listed: Vec<&OfBody> =
        of_bodies.iter().filter(|of| of.strength() > WEAK * largest).take(ranking::ROWS).collect();
    let longest = listed.iter().map(|of| of.strength().max(of.strongest())).fold(0.0, f64::max);
    let net = schema.terms.iter().find(|term| term.is_sum);
    let row = |of: &OfBody| {
        let cause = schema.terms[of.strongest.1].color;
        let color = net.map_or(cause, |net| net.color);
        let mut marks = vec![(Mark::Bar(of.strength() / longest), color)];
        marks.extend(of.net.map(|_| (Mark::Dot(of.strongest() / longest), cause)));
        Row { label: of.label(schema), color, marks }
    };
    listed.into_iter().map(row).collect()
}

/// A bar for each cause on each body, and for the net forces.
fn rows_of_causes(schema: &Schema, mut resultants: Vec<Resultant>) -> Vec<Row> {
    resultants.sort_by(|one, other| other.2.length_squared().total_cmp(&one.2.length_squared()));
    let longest = resultants.first().map_or(0.0, |(.., acceleration)| acceleration.length());
    let row = |&(body, number, acceleration): &Resultant| {
        let (TermSchema { name, color, .. }, strength) = (&schema.terms[number], acceleration.length());
        let label = format!("{}: {name} {}", schema.bodies[body].name, significant(strength));
        (strength > WEAK * longest).then(|| Row {
            label,
            color: *color,
            marks: vec![(Mark::Bar(strength / longest), *color)],
        })
    };
    resultants.iter().map_while(row).take(ranking::ROWS).collect()
}

impl ResultantRows {
    /// Arrows from the centres, all on one scale, on which the longest is [`LONGEST`]. The bodies of `labelled` have their
    /// names, net forces and strongest causes as labels, on the arrow of the net force if there is one.
    fn of(view: FrameView<'_>, resultants: &[Resultant], labelled: &[&OfBody]) -> ResultantRows {
        let FrameView { schema, frame, .. } = view;
        let longest = resultants.iter().map(|(.., acceleration)| acceleration.length()).fold(0.0, f64::max);
        let scale = LONGEST * schema.largest_radius() / longest;
        let mut arrows = ResultantRows::default();
        for resultant @ &(body, number, acceleration) in resultants {
            arrows.origins.push(frame.bodies[body].centre.as_vec3().to_array());
            arrows.vectors.push((scale * acceleration).as_vec3().to_array());
            arrows.colors.push(color(schema.terms[number].color).to_u32());
            let has_net =
                |body: usize| resultants.iter().any(|(of, term, _)| *of == body && schema.terms[*term].is_sum);
            let of = labelled.iter().find(|of| of.body == body);
            let of =
                of.filter(|of| if has_net(body) { schema.terms[number].is_sum } else { of.strongest == *resultant });
            arrows.labels.push(of.map_or(String::new(), |of| of.label(schema)));
        }
        // the others have their names alone, on arrows of no length
        let is_idle = |index: usize| !resultants.iter().any(|(body, ..)| *body == index);
        let are_few = schema.bodies.len() <= ranking::LABELLED;
        let idle = view.bodies().enumerate().filter(|(index, (_, now))| are_few && !now.is_absent && is_idle(*index));
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
