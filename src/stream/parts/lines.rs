//! Lines in 3D between the centres of pairs within reach, coloured by phase and labelled with q, and with them the names of
//! bodies.

use super::{
    FrameView,
    labels::{Labels, Names},
    pairs::told_q,
    ranking::is_ranked,
    recent::Recent,
};
use crate::{
    observe::{BodyFrame, PairEvent, PairFrame, Schema},
    sdk::{self, LineStrips3D},
    stream::{
        chunks::{Chunks, TrackId},
        columns::Cell,
        contract::PAIR_LINES,
        extract::Float3,
        palette::color,
        settings::Settings,
    },
};

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

impl Lines {
    /// Shows at most as many pairs as the settings allow.
    pub fn new(schema: &Schema, settings: &Settings, chunks: &mut Chunks) -> Lines {
        let style = LineStrips3D::update_fields()
            .with_radii([sdk::Radius::new_ui_points(1.5)])
            .with_show_labels(!is_ranked(schema));
        chunks.log_static(PAIR_LINES.path, &style);
        let components =
            [LineStrips3D::descriptor_strips(), LineStrips3D::descriptor_colors(), LineStrips3D::descriptor_labels()];
        let track = chunks.track(PAIR_LINES.path, components);
        Lines {
            track,
            max_lines: settings.pairs,
            only: settings.only.clone(),
            rows: LineRows::default(),
            has_begun: false,
            names: Names::new(schema, chunks),
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
        let q = |pair: &PairFrame| told_q(view.schema, [pair.a, pair.b], pair.q, view.at.time);
        let label = |pair: &PairFrame| format!("{} q = {}", view.schema.pair_name(pair.a, pair.b), q(pair));
        let middle = |a: usize, b: usize| 0.5 * (view.frame.bodies[a].centre + view.frame.bodies[b].centre);
        let mut labels_in_space = Labels::new(view);
        for point in &view.schema.points {
            if let Some((centre, reach)) = point.sphere.at(view.at.time) {
                labels_in_space.take(centre + reach * view.schema.up, &point.label);
            }
        }
        if let Some(names) = &mut self.names {
            names.log(view, recent.as_flattened(), &mut labels_in_space, chunks);
        }
        let mut labelled = 0;
        // the ranking has q of more than a few pairs, which would hide the bodies
        for index in 0..if is_ranked(view.schema) { 0 } else { self.closest.len() } {
            let pair = self.closest[index];
            let mut has_room = || labels_in_space.take(middle(pair.a, pair.b), &label(&pair));
            if !recent.contains(&[pair.a, pair.b]) && has_room() {
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
