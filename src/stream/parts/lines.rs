//! Lines in 3D between the centres of pairs within reach, coloured by phase and labelled with q.

use rerun::LineStrips3D;

use super::{Look, MOST_LABELS};
use crate::{
    observe::{PairFrame, Schema},
    stream::{
        chunks::{Chunks, TrackId},
        columns::Cell,
        normals::Float3,
        palette::color,
    },
};

/// The entity of these lines.
pub(super) const PAIRS: &str = "/world/pairs";

/// Pair lines, with what was last logged of them.
pub struct Lines {
    track: TrackId,
    /// Upper limit on the number of lines; the closest pairs are shown.
    most: usize,
    last: Option<LineRows>,
    next: LineRows,
    /// Scratch storage, reused.
    closest: Vec<PairFrame>,
}

#[derive(Clone, Default, PartialEq)]
struct LineRows {
    segments: Vec<[Float3; 2]>,
    colors: Vec<u32>,
    labels: Vec<String>,
}

impl Lines {
    /// Shows at most `most` pairs.
    pub fn new(schema: &Schema, most: usize, chunks: &mut Chunks) -> Lines {
        let style = LineStrips3D::update_fields()
            .with_radii([rerun::Radius::new_ui_points(1.5)])
            .with_show_labels(schema.bodies.len() <= MOST_LABELS);
        chunks.log_static(PAIRS, &style);
        let components =
            [LineStrips3D::descriptor_strips(), LineStrips3D::descriptor_colors(), LineStrips3D::descriptor_labels()];
        let track = chunks.track(PAIRS, components);
        Lines { track, most, last: None, next: LineRows::default(), closest: Vec::new() }
    }

    /// Logs what has changed.
    pub fn log(&mut self, look: Look<'_>, chunks: &mut Chunks) {
        let LineRows { segments, colors, labels } = &mut self.next;
        self.closest.clear();
        self.closest.extend_from_slice(&look.frame.pairs);
        self.closest.sort_by(|x, y| x.q.total_cmp(&y.q));
        self.closest.truncate(self.most);
        let centre = |i: usize| look.frame.bodies[i].centre.as_vec3().to_array();
        segments.clear();
        segments.extend(self.closest.iter().map(|pair| [centre(pair.a), centre(pair.b)]));
        colors.clear();
        colors.extend(self.closest.iter().map(|pair| color(look.schema.phases[pair.phase].color).to_u32()));
        labels.clear();
        labels.extend(self.closest.iter().map(|pair| format!("q = {:.3}", pair.q)));
        if self.last.as_ref() != Some(&self.next) {
            let LineRows { segments, colors, labels } = &self.next;
            let cells = [Cell::Segments(segments), Cell::Colors(colors), Cell::Texts(labels)];
            chunks.push(self.track, look.at, &cells);
            let last = self.last.get_or_insert_default();
            std::mem::swap(last, &mut self.next);
        }
    }
}
