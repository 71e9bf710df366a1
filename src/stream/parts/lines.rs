//! Lines in 3D between the centres of pairs within reach, coloured by phase and labelled with q; and the names of bodies.

use glam::DVec3;

use super::{FrameView, Labels, MAX_LABELS, recent::Recent};
use crate::{
    observe::{BodyFrame, PairEvent, PairFrame, Schema},
    sdk::{self, LineStrips3D, Points3D},
    stream::{
        chunks::{Chunks, TrackId},
        columns::Cell,
        contract::{NAMES, PAIR_LINES},
        extract::Float3,
        palette::{self, color},
        settings::Settings,
    },
};

/// Upper limit on the number of labelled pairs: the highlighted one, then the closest. More labels would cover each
/// other and the bodies.
const MAX_LABELLED: usize = 3;
/// Upper limit on the number of bodies with names.
pub const MAX_NAMED: usize = 32;

/// Pair lines.
pub struct Lines {
    track: TrackId,
    /// Upper limit on the number of lines; the closest pairs are shown.
    max_lines: usize,
    /// The only pairs with lines, as `A~B`; empty: all.
    only: Vec<String>,
    /// The lines of the frame. Reused.
    rows: LineRows,
    /// Whether there is a row already: the first one is logged even if there are no lines.
    has_begun: bool,
    /// Names of bodies, unless there are too many.
    names: Option<Names>,
    recent: Recent,
    /// Scratch storage, reused.
    closest: Vec<PairFrame>,
}

#[derive(Default)]
struct LineRows {
    segments: Vec<[Float3; 2]>,
    colors: Vec<u32>,
    labels: Vec<String>,
}

/// The names of bodies for which there is room, each on the side away from its neighbours: labels at the centres would
/// cover each other. Of several variants, the first one's, and the names of all variants.
struct Names {
    places: TrackId,
    texts: TrackId,
    /// The bodies that were named last, ascending; `None` if nothing is logged yet.
    named: Option<Vec<usize>>,
}

impl Lines {
    /// Shows at most as many pairs as the settings allow.
    pub fn new(schema: &Schema, settings: &Settings, chunks: &mut Chunks) -> Lines {
        let has_labels = schema.bodies.len() <= MAX_LABELS;
        let style =
            LineStrips3D::update_fields().with_radii([sdk::Radius::new_ui_points(1.5)]).with_show_labels(has_labels);
        chunks.log_static(PAIR_LINES.path, &style);
        let components =
            [LineStrips3D::descriptor_strips(), LineStrips3D::descriptor_colors(), LineStrips3D::descriptor_labels()];
        let track = chunks.track(PAIR_LINES.path, components);
        let has_names = !schema.variants.is_empty() || (2..=MAX_NAMED).contains(&schema.bodies.len());
        Lines {
            track,
            max_lines: settings.pairs,
            only: settings.only.clone(),
            rows: LineRows::default(),
            has_begun: false,
            names: has_names.then(|| Names::new(chunks)),
            recent: Recent::new(schema, chunks),
            closest: Vec::new(),
        }
    }

    /// Adds the events of a step, each with the bodies of its pair after the step.
    pub fn events(&mut self, schema: &Schema, events: &[PairEvent], pairs: &[[BodyFrame; 2]], chunks: &mut Chunks) {
        self.recent.events(schema, events, pairs, chunks);
    }

    /// Logs changed values.
    pub fn log(&mut self, view: FrameView<'_>, chunks: &mut Chunks) {
        let LineRows { segments, colors, labels } = &mut self.rows;
        let is_shown =
            |pair: &&PairFrame| self.only.is_empty() || self.only.contains(&view.schema.pair_name(pair.a, pair.b));
        self.closest.clear();
        self.closest.extend(view.frame.pairs.iter().filter(is_shown));
        self.closest.sort_by(|x, y| x.q.total_cmp(&y.q));
        self.closest.truncate(self.max_lines);
        // the viewer labels the first lines, as many as there are labels; highlighted pairs have theirs there
        self.recent.forget_old();
        let recent: Vec<[usize; 2]> = self.recent.pairs().collect();
        let label = |pair: &PairFrame| format!("{} q = {:.3}", view.schema.pair_name(pair.a, pair.b), pair.q);
        let middle = |a: usize, b: usize| 0.5 * (view.frame.bodies[a].centre + view.frame.bodies[b].centre);
        let mut labels_in_space = Labels::new(view);
        if let Some(names) = &mut self.names {
            names.log(view, recent.as_flattened(), &mut labels_in_space, chunks);
        }
        let most = MAX_LABELLED.saturating_sub(recent.len());
        let mut labelled = 0;
        for index in 0..self.closest.len() {
            let pair = self.closest[index];
            let mut has_room = || labels_in_space.take(middle(pair.a, pair.b), &label(&pair));
            if !recent.contains(&[pair.a, pair.b]) && labelled < most && has_room() {
                self.closest[labelled..=index].rotate_right(1);
                labelled += 1;
            }
        }
        let centre = |i: usize| view.frame.bodies[i].centre.as_vec3().to_array();
        segments.clear();
        segments.extend(self.closest.iter().map(|pair| [centre(pair.a), centre(pair.b)]));
        colors.clear();
        colors.extend(self.closest.iter().map(|pair| color(view.schema.phases[pair.phase].color).to_u32()));
        labels.clear();
        labels.extend(self.closest[..labelled].iter().map(label));
        if labelled == 1 && self.closest.len() > 1 {
            labels.push(String::new()); // the viewer would take a single label for that of all lines
        }
        let cells: [&dyn Cell; _] = [segments, colors, labels];
        if !std::mem::replace(&mut self.has_begun, true) || chunks.has_changed(self.track, &cells) {
            chunks.push(self.track, view.at, &cells);
        }
        self.recent.log(view, chunks);
    }
}

impl Names {
    fn new(chunks: &mut Chunks) -> Names {
        let style = Points3D::update_fields().with_radii([sdk::Radius::new_ui_points(0.5)]).with_show_labels(true);
        chunks.log_static(NAMES.path, &style);
        Names {
            texts: chunks.track(NAMES.path, [Points3D::descriptor_labels(), Points3D::descriptor_colors()]),
            places: chunks.track(NAMES.path, [Points3D::descriptor_positions()]),
            named: None,
        }
    }

    /// Names the bodies in `first`, then those that had names, then those in front.
    fn log(&mut self, view: FrameView<'_>, first: &[usize], labels: &mut Labels, chunks: &mut Chunks) {
        let FrameView { schema, frame, at, .. } = view;
        for variant in &schema.variants {
            labels.take(variant.heading, variant.name);
        }
        let mut bodies: Vec<usize> = (0..nameable(schema)).filter(|&body| !frame.bodies[body].is_absent).collect();
        let towards_eye = view.towards_eye();
        let depth = |body: usize| -frame.bodies[body].centre.dot(towards_eye);
        let rank = |body: usize| match self.named.as_deref().unwrap_or_default().binary_search(&body) {
            _ if first.contains(&body) => 0,
            Ok(_) => 1,
            Err(_) => 2,
        };
        bodies.sort_by(|&one, &other| rank(one).cmp(&rank(other)).then(depth(one).total_cmp(&depth(other))));
        bodies.retain(|&body| labels.take(name_place(view, body), schema.plain_name(body)));
        bodies.sort_unstable();
        let headings = schema.variants.iter().map(|variant| variant.heading);
        let places = bodies.iter().map(|&body| name_place(view, body)).chain(headings);
        let places: Vec<Float3> = places.map(|place| place.as_vec3().to_array()).collect();
        if self.named.as_ref() != Some(&bodies) {
            let names = bodies.iter().map(|&body| (schema.plain_name(body), palette::of_body(schema, body)));
            let names = names.chain(schema.variants.iter().map(|variant| (variant.name, palette::SEAM)));
            let (names, colors): (Vec<String>, Vec<u32>) =
                names.map(|(name, rgb)| (name.to_owned(), color(rgb).to_u32())).unzip();
            chunks.push(self.texts, at, &[&names, &colors]);
            self.named = Some(bodies);
        }
        chunks.push_changed(self.places, at, &[&places]);
    }
}

/// Labels of the bodies that matter most at an instant, and the names of others.
pub struct BodyLabels(TrackId);

impl BodyLabels {
    /// Starts without labels.
    pub fn new(entity: &str, chunks: &mut Chunks) -> BodyLabels {
        let style = Points3D::update_fields().with_radii([sdk::Radius::new_ui_points(0.5)]).with_show_labels(true);
        chunks.log_static(entity, &style.with_colors([color(palette::SEAM)]));
        BodyLabels(chunks.track(entity, [Points3D::descriptor_positions(), Points3D::descriptor_labels()]))
    }

    /// Logs the labels of `first` for which there is room, then as many names of the rest of them and of `others`.
    pub fn log(
        &self,
        view: FrameView<'_>,
        first: impl Iterator<Item = (usize, String)>,
        others: impl Iterator<Item = usize>,
        chunks: &mut Chunks,
    ) {
        let (mut taken, mut rest) = (Labels::new(view), Vec::new());
        let (mut places, mut labels): (Vec<Float3>, Vec<String>) = (Vec::new(), Vec::new());
        let mut has_room = |body: usize, label: String| {
            let place = name_place(view, body);
            let has_room = taken.take(place, &label);
            if has_room {
                places.push(place.as_vec3().to_array());
                labels.push(label);
            }
            has_room
        };
        for (body, label) in first {
            if !has_room(body, label) {
                rest.push(body);
            }
        }
        for body in rest.into_iter().chain(others).take(MAX_NAMED) {
            has_room(body, view.schema.bodies[body].name.clone());
        }
        chunks.push_changed(self.0, view.at, &[&places, &labels]);
    }
}

/// Where the name of a body stands [scene unit]: off its centre, away from the bodies near it.
pub fn name_place(view: FrameView<'_>, index: usize) -> DVec3 {
    let (body, now) = (&view.schema.bodies[index], &view.frame.bodies[index]);
    let met = view.frame.pairs.iter().filter_map(|pair| match (pair.a == index, pair.b == index) {
        (true, _) => Some(view.frame.bodies[pair.b].centre),
        (_, true) => Some(view.frame.bodies[pair.a].centre),
        _ => None,
    });
    let away: DVec3 = met.map(|other| (now.centre - other).normalize_or_zero()).sum();
    // for bodies at the same position, every other name is on the left
    let aside = if index.is_multiple_of(2) { DVec3::NEG_X } else { DVec3::X };
    let up = view.schema.up;
    let direction = (away + 0.05 * aside).normalize_or(up);
    now.centre + body.radius * (0.9 * direction + 0.35 * up)
}

/// Number of bodies that have names, the first ones.
fn nameable(schema: &Schema) -> usize {
    Some(schema.variant_size()).filter(|&bodies| bodies <= MAX_NAMED).unwrap_or(0)
}
