//! The resultant force on each body by each cause: arrows at or beside the centre, plots, and a ranking of the strongest; of
//! more than a few bodies, a ranking of bodies, and a plot of the strongest on any of them.

use glam::DVec3;

use super::{
    FrameView, MAX_LABELS,
    labels::BodyLabels,
    ranking::{self, Mark, Ranking, Row, is_ranked},
};
use crate::{
    observe::{
        BodyFrame, Schema,
        schema::{BodySchema, TermSchema},
    },
    sdk::{self, Arrows3D},
    stream::{
        chunks::{Chunks, TrackId},
        contract::{BODY_FORCE, RANKED_FORCES, RESULTANT_LABELS, RESULTANTS, STRONGEST},
        extract::Float3,
        instant::Instant,
        palette::color,
        series::{Interpolation, LineId, Series},
    },
    text::significant,
};

/// Upper limit on the number of bodies with plots of their own: of more, one would not find one.
pub const MOST_BODIES: usize = 16;

/// The length of the longest arrow [geometric mean of the radius of its body and the largest]: it ends outside of its body,
/// and that of a small body beside a large one is still in view. Among many bodies it is drawn so much longer that others
/// are seen, too.
const LONGEST: f64 = 1.5;
const LONGEST_OF_MANY: f64 = 3.0;
/// The weakest force that has an arrow [the strongest on its body] …
const WEAKEST: f64 = 0.1;
/// … if that is longer than a speck [the longest arrow].
const SPECK: f64 = 0.03;

/// Number of the bodies with the largest net forces that are labelled even if others, which are translucent, hide them.
const MAY_BE_HIDDEN: usize = 3;

/// A force that is weaker is left out of the ranking [strongest force].
const WEAK: f64 = 0.04;

/// Arrows, and plots, each from the first frame in which its force acts.
pub struct BodyForces {
    /// By body and term; none if there are too many bodies.
    lines: Vec<Vec<Option<LineId>>>,
    /// The strongest forces; of more than a few bodies, the net forces on them.
    ranking: Ranking,
    /// By term, the lines of the strongest on any body; none if there are only a few.
    strongest: Vec<Option<LineId>>,
    /// Whether a term has acted on any body.
    has_acted: Vec<bool>,
    arrows: TrackId,
    labels: BodyLabels,
}

/// The arrows of a frame.
#[derive(Default)]
struct ResultantRows {
    origins: Vec<Float3>,
    vectors: Vec<Float3>,
    colors: Vec<u32>,
}

/// What one cause does to a body as a whole.
#[derive(Clone, Copy, PartialEq)]
struct Resultant {
    body: usize,
    /// Index into the schema's terms.
    term: usize,
    /// [scene unit/s²]
    acceleration: DVec3,
}

impl Resultant {
    fn strength(&self) -> f64 {
        self.acceleration.length()
    }
}

impl BodyForces {
    /// Starts without lines.
    pub fn new(schema: &Schema, chunks: &mut Chunks) -> BodyForces {
        let terms = schema.terms.len();
        let bodies = if schema.bodies.len() <= MOST_BODIES { schema.bodies.len() } else { 0 };
        let style = Arrows3D::update_fields().with_radii([sdk::Radius::new_ui_points(3.0)]);
        chunks.log_static(RESULTANTS.path, &style);
        let components =
            [Arrows3D::descriptor_origins(), Arrows3D::descriptor_vectors(), Arrows3D::descriptor_colors()];
        let arrows = chunks.track(RESULTANTS.path, components);
        BodyForces {
            lines: vec![vec![None; terms]; bodies],
            ranking: Ranking::new(RANKED_FORCES.path, chunks),
            strongest: vec![None; if is_ranked(schema) { terms } else { 0 }],
            has_acted: vec![false; terms],
            arrows,
            labels: BodyLabels::new(RESULTANT_LABELS.path, MAY_BE_HIDDEN, chunks),
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
                    resultants.push(Resultant { body: index, term: number, acceleration });
                }
                if let Some(line) = self.lines.get_mut(index).map(|lines| &mut lines[number]) {
                    let entity = || BODY_FORCE.of(&[&body.name, term.name]);
                    log_strength(line, entity, (term, acceleration.length()), (series, chunks), view.at);
                }
            }
        }
        let finite = resultants.iter().map(Resultant::strength).filter(|strength| strength.is_finite());
        let strongest = finite.fold(0.0, f64::max);
        let felt: Vec<Resultant> =
            resultants.iter().copied().filter(|of| of.strength() > ranking::NOISE * strongest).collect();
        let of_bodies = of_bodies(view.schema, &felt);
        let now = ResultantRows::of(view, &resultants);
        chunks.push_changed(self.arrows, view.at, &[&now.origins, &now.vectors, &now.colors]);
        let (first, others) = of_bodies.split_at(of_bodies.len().min(ranking::LABELLED));
        let mut is_idle: Vec<bool> = view.frame.bodies.iter().map(|now| !now.is_absent).collect();
        of_bodies.iter().for_each(|of| is_idle[of.body()] = false);
        let idle = (0..is_idle.len()).filter(|&body| is_idle[body]);
        // of more than a few bodies, the numbers are in the ranking: long labels would lie on other bodies
        let label = |of: &OfBody<'_>| match is_ranked(view.schema) {
            true => view.schema.bodies[of.body()].name.clone(),
            false => of.label(view.schema),
        };
        let first = first.iter().map(|of| (of.body(), label(of)));
        self.labels.log(view, [], first, others.iter().map(OfBody::body).chain(idle), chunks);
        let rows = match is_ranked(view.schema) {
            true => rows_of_bodies(view.schema, &of_bodies),
            false => rows_of_causes(view.schema, resultants.clone()),
        };
        self.ranking.log(rows.into_iter(), "no force acts on any body", view.at, chunks);
        let terms = view.schema.terms.iter().enumerate().zip(&mut self.strongest);
        for ((number, term), line) in terms {
            let strongest = resultants.iter().filter(|of| of.term == number).map(Resultant::strength);
            let strongest = (term, strongest.fold(0.0, f64::max));
            log_strength(line, || STRONGEST.of(&[term.name]), strongest, (series, chunks), view.at);
        }
    }
}

/// Logs the strength of a term to its line, which begins when the term first acts.
fn log_strength(
    line: &mut Option<LineId>,
    entity: impl FnOnce() -> String,
    (term, strength): (&TermSchema, f64),
    (series, chunks): (&mut Series, &mut Chunks),
    at: Instant,
) {
    if line.is_none() && strength > 0.0 {
        let entity = entity();
        Series::style(chunks, &entity, term.label, term.color, 1.5, Interpolation::Linear);
        *line = Some(series.line(chunks, &entity, Interpolation::Linear));
    }
    if let Some(line) = *line {
        series.log(chunks, line, strength, at);
    }
}

/// What acts on a body as a whole.
struct OfBody<'a> {
    /// By each cause, and all together.
    all: &'a [Resultant],
    strongest: &'a Resultant,
    /// All together, if the schema has a sum and it is not 0.
    net: Option<&'a Resultant>,
}

impl OfBody<'_> {
    /// That of the net force; without a sum in the schema, of the strongest cause [scene unit/s²].
    fn strength(&self, schema: &Schema) -> f64 {
        let net = self.net.map_or(0.0, Resultant::strength);
        if schema.sum_of_terms().is_some() { net } else { self.strongest.strength() }
    }

    /// Its name, the sum and the strongest cause.
    fn label(&self, schema: &Schema) -> String {
        let value = |term: usize, strength: f64| format!("{} {}", schema.terms[term].name, significant(strength));
        let net = self.net.map_or(0.0, Resultant::strength);
        let sum = schema.sum_of_terms().map_or(String::new(), |sum| value(sum, net) + ", ");
        let cause = value(self.strongest.term, self.strongest.strength());
        format!("{}: {sum}{cause}", schema.bodies[self.body()].name)
    }

    fn body(&self) -> usize {
        self.strongest.body
    }
}

/// The bodies on which a force acts, those with the largest sums first.
fn of_bodies<'a>(schema: &Schema, resultants: &'a [Resultant]) -> Vec<OfBody<'a>> {
    let sum = schema.sum_of_terms();
    let of_body = |all: &'a [Resultant]| {
        let causes = all.iter().filter(|of| Some(of.term) != sum);
        let strongest = causes.max_by(|one, other| one.strength().total_cmp(&other.strength()))?;
        Some(OfBody { all, strongest, net: all.iter().find(|of| Some(of.term) == sum) })
    };
    let mut of_bodies: Vec<OfBody> =
        resultants.chunk_by(|one, other| one.body == other.body).filter_map(of_body).collect();
    of_bodies.sort_by(|one, other| other.strength(schema).total_cmp(&one.strength(schema)));
    of_bodies
}

/// A bar for the sum on each body, with a dot at each cause.
fn rows_of_bodies(schema: &Schema, of_bodies: &[OfBody<'_>]) -> Vec<Row> {
    let sum = schema.sum_of_terms();
    let largest = |of: &OfBody<'_>| of.strength(schema).max(of.strongest.strength());
    let longest = of_bodies.iter().map(largest).fold(0.0, f64::max);
    // also those on which large forces balance
    let listed = of_bodies.iter().filter(|of| largest(of) > WEAK * longest).take(ranking::ROWS);
    let row = |of: &OfBody<'_>| {
        let color_of = |of: &Resultant| schema.terms[of.term].color;
        let share = |of: &Resultant| of.strength() / longest;
        let net = of.net.map(|net| (Mark::Bar(share(net)), color_of(net)));
        let causes = of.all.iter().filter(|cause| Some(cause.term) != sum && cause.strength() > WEAK * longest);
        let causes = causes.map(|cause| (Mark::Dot(share(cause)), color_of(cause)));
        let color = sum.map_or(color_of(of.strongest), |sum| schema.terms[sum].color);
        Row { label: of.label(schema), color, marks: net.into_iter().chain(causes).collect() }
    };
    listed.map(row).collect()
}

/// A bar for each cause on each body, and for the sums.
fn rows_of_causes(schema: &Schema, mut resultants: Vec<Resultant>) -> Vec<Row> {
    resultants.sort_by(|one, other| other.strength().total_cmp(&one.strength()));
    let longest = resultants.first().map_or(0.0, Resultant::strength);
    let row = |of: &Resultant| {
        let TermSchema { name, color, .. } = &schema.terms[of.term];
        let label = format!("{}: {name} {}", schema.bodies[of.body].name, significant(of.strength()));
        Row { label, color: *color, marks: vec![(Mark::Bar(of.strength() / longest), *color)] }
    };
    resultants.iter().take_while(|of| of.strength() > WEAK * longest).take(ranking::ROWS).map(row).collect()
}

impl ResultantRows {
    /// Arrows from the centres, those of sums from beside them, all on the scale on which the longest is [`longest`].
    fn of(view: FrameView<'_>, resultants: &[Resultant]) -> ResultantRows {
        /// How far the sum starts beside the centre, so that a parallel cause does not hide it [radii].
        const BESIDE: f64 = 0.12;

        let FrameView { schema, frame, .. } = view;
        let largest = schema.largest_radius();
        // how long an arrow is on the scale 1
        let length = |of: &Resultant| of.strength() / (schema.bodies[of.body].radius * largest).sqrt();
        let longest_length = resultants.iter().map(length).fold(0.0, f64::max);
        let scale = longest(schema) / longest_length;
        let mut strongest = vec![0.0f64; schema.bodies.len()];
        resultants.iter().for_each(|of| strongest[of.body] = strongest[of.body].max(of.strength()));
        let is_shown =
            |of: &&Resultant| of.strength() > WEAKEST * strongest[of.body] && length(of) > SPECK * longest_length;
        let mut arrows = ResultantRows::default();
        for &Resultant { body, term, acceleration } in resultants.iter().filter(is_shown) {
            let beside = match schema.sum_of_terms() == Some(term) {
                true => BESIDE * schema.bodies[body].radius * acceleration.cross(view.back).normalize_or_zero(),
                false => DVec3::ZERO,
            };
            arrows.origins.push((frame.bodies[body].centre + beside).as_vec3().to_array());
            arrows.vectors.push((scale * acceleration).as_vec3().to_array());
            arrows.colors.push(color(schema.terms[term].color).to_u32());
        }
        arrows
    }
}

/// [`LONGEST`], or [`LONGEST_OF_MANY`].
pub fn longest(schema: &Schema) -> f64 {
    if schema.bodies.len() > MAX_LABELS { LONGEST_OF_MANY } else { LONGEST }
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
