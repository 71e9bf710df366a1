//! Pictures of what matters most at an instant, where there is too much for names in space and lines in plots: rows, the
//! most important first, each a label and marks beside it.

use crate::{
    colors::{SILVER, VERMILION},
    observe::Schema,
    sdk::{LineStrips2D, Points2D},
    stream::{
        chunks::{Chunks, TrackId},
        contract::{RANKED_DISPLACEMENTS, RANKED_ENERGIES, RANKED_FORCES, RANKED_GROUPS, RANKED_PAIRS},
        instant::Instant,
        palette::{Rgb, color},
    },
};

/// Upper limit on the number of rows.
pub const ROWS: usize = 8;
/// Scenes with more bodies have rankings.
const FEW: usize = 3;
/// Upper limit on the number of bodies of a ranking that are labelled in space.
pub const LABELLED: usize = 5;
/// What is smaller is rounding, not a force, a displacement or an energy [largest one].
pub const NOISE: f64 = 1e-9;
/// Distance of two rows, and the widths of labels and of marks.
const PITCH: f32 = 10.0;
const LABEL: f32 = 112.0;
const WIDTH: f32 = 106.0;
/// A label hangs from its place.
const HANG: f32 = 4.0;

/// What is in view of so many rows: left, right, top and bottom.
pub fn bounds(rows: usize) -> [f64; 4] {
    [-LABEL as f64, 1.06 * WIDTH as f64, -0.8 * PITCH as f64, PITCH as f64 * (rows as f64 - 0.2)]
}

/// Whether a scene has rankings of its bodies and pairs: of few bodies, everything has its own line.
pub fn is_ranked(schema: &Schema) -> bool {
    schema.bodies.len() > FEW
}

/// A row.
pub struct Row {
    /// What stands to the left of the marks.
    pub label: String,
    /// The colour of the label.
    pub color: Rgb,
    /// What is drawn, one upon another, with colours.
    pub marks: Vec<(Mark, Rgb)>,
}

/// A mark in a row, at shares of the width.
#[derive(Clone, Copy)]
pub enum Mark {
    /// From the left end.
    Bar(f64),
    /// From the middle, to the left if negative; 1 is half of the width.
    Signed(f64),
    /// A disc.
    Dot(f64),
    /// Across the row, from the row above and to that below.
    Tick(f64),
}

impl Mark {
    /// Ends and radius of the strip in this row.
    fn strip(self, row: usize) -> ([[f32; 2]; 2], f32) {
        /// Radius of a bar, and the smallest that is seen.
        const THICK: f32 = 2.4;
        const THIN: f32 = 0.3;

        let y = row as f32 * PITCH;
        // fewer digits make a smaller file, and none are visible
        let x = |share: f64| (2.0 * WIDTH * share.clamp(0.0, 1.0) as f32).round() / 2.0;
        // the ends of a strip are round and add to its length: a bar shorter than they is thinner. The viewer draws no strip
        // without a length
        let bar = |from: f32, to: f32| {
            let inset = (0.45 * (to - from).abs()).min(THICK);
            let by = inset.copysign(to - from);
            ([[from + by, y], [to - by, y]], inset.max(THIN))
        };
        match self {
            Mark::Bar(to) => bar(0.0, x(to)),
            Mark::Signed(to) => bar(x(0.5), x(0.5 + 0.5 * to)),
            Mark::Dot(at) => ([[x(at), y], [x(at) + 0.5, y]], 2.4),
            Mark::Tick(at) => ([[x(at), y - 0.5 * PITCH], [x(at), y + 0.5 * PITCH]], 0.4),
        }
    }
}

/// A ranking that changes.
pub struct Ranking(TrackId);

impl Ranking {
    /// The ranking at this entity, without rows.
    pub fn new(entity: &str, chunks: &mut Chunks) -> Ranking {
        log_style(entity, chunks);
        let components = [
            Points2D::descriptor_labels(),
            Points2D::descriptor_colors(),
            LineStrips2D::descriptor_strips(),
            LineStrips2D::descriptor_radii(),
            LineStrips2D::descriptor_colors(),
        ];
        Ranking(chunks.track(entity, components))
    }

    /// Logs the rows if they have changed, as many as there is room for, or what the lack of rows means.
    pub fn log(&self, rows: impl Iterator<Item = Row>, none: &str, at: Instant, chunks: &mut Chunks) {
        let mut rows = rows.peekable();
        let none = rows.peek().is_none().then(|| Row { label: none.to_owned(), color: SILVER, marks: Vec::new() });
        let rows = none.into_iter().chain(rows);
        let Drawn { labels, colors, strips, radii, strip_colors } = Drawn::of(rows);
        chunks.push_changed(self.0, at, &[&labels, &colors, &strips, &radii, &strip_colors]);
    }
}

/// Logs a ranking that is the same at any instant.
pub fn log_static(entity: &str, rows: impl Iterator<Item = Row>, chunks: &mut Chunks) {
    let drawn = Drawn::of(rows);
    log_style(entity, chunks);
    chunks.log_static(entity, &Points2D::update_fields().with_labels(drawn.labels).with_colors(drawn.colors));
    let marks = LineStrips2D::update_fields().with_strips(drawn.strips).with_radii(drawn.radii);
    chunks.log_static(entity, &marks.with_colors(drawn.strip_colors));
}

/// Whether an entity is a ranking that changes.
pub fn is_one(entity: &str) -> bool {
    let all = [&RANKED_FORCES, &RANKED_DISPLACEMENTS, &RANKED_GROUPS, &RANKED_PAIRS, &RANKED_ENERGIES];
    all.iter().any(|ranking| ranking.is(entity))
}

/// What stands in a ranking without rows, while there is nothing else at its entity.
pub fn note(text: &str) -> Points2D {
    let labels = std::iter::once(text).chain(std::iter::repeat_n("", ROWS - 1));
    Points2D::update_fields().with_labels(labels).with_colors([color(VERMILION)])
}

fn log_style(entity: &str, chunks: &mut Chunks) {
    let places = (0..ROWS).map(|row| [-0.5 * LABEL, row as f32 * PITCH - HANG]);
    let labels = Points2D::update_fields().with_positions(places).with_radii([0.0]).with_show_labels(true);
    chunks.log_static(entity, &labels);
    chunks.log_static(entity, &LineStrips2D::update_fields().with_show_labels(false));
}

/// Leaves out what equals the last value before it.
fn repeat_last<T: PartialEq>(values: &mut Vec<T>) {
    while let [.., before, last] = values.as_slice()
        && before == last
    {
        values.pop();
    }
}

/// Rows as components.
struct Drawn {
    labels: Vec<String>,
    colors: Vec<u32>,
    strips: Vec<[[f32; 2]; 2]>,
    radii: Vec<f32>,
    strip_colors: Vec<u32>,
}

impl Drawn {
    fn of(rows: impl Iterator<Item = Row>) -> Drawn {
        let (mut labels, mut colors) = (Vec::new(), Vec::new());
        let (mut strips, mut radii, mut strip_colors) = (Vec::new(), Vec::new(), Vec::new());
        for (number, row) in rows.take(ROWS).enumerate() {
            for (mark, rgb) in row.marks {
                let (strip, radius) = mark.strip(number);
                let rgb = color(rgb).to_u32();
                let goes_on = |(above, of): (&[[f32; 2]; 2], &u32)| above[1] == strip[0] && *of == rgb;
                match strips.iter().zip(&strip_colors).position(goes_on) {
                    Some(above) => strips[above][1] = strip[1],
                    None => {
                        strips.push(strip);
                        radii.push(radius);
                        strip_colors.push(rgb);
                    }
                }
            }
            labels.push(row.label);
            colors.push(color(row.color).to_u32());
        }
        labels.resize(ROWS, String::new()); // the viewer would repeat a single one
        colors.resize(ROWS, 0); // it draws a point without a label, too
        // but the last of these, for which a file need not have more
        repeat_last(&mut colors);
        repeat_last(&mut radii);
        repeat_last(&mut strip_colors);
        Drawn { labels, colors, strips, radii, strip_colors }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The viewer draws round ends beyond the strip: what is seen is as long as the value, also if it is small.
    #[test]
    fn bars_are_as_long_as_their_values() {
        let seen = |mark: Mark| {
            let ([[from, _], [to, _]], radius) = mark.strip(0);
            assert!(from != to);
            let ends = [from.min(to) - radius, from.max(to) + radius];
            ends.map(|end| f64::from(end / WIDTH))
        };
        for (mark, expected) in [
            (Mark::Bar(1.0), [0.0, 1.0]),
            (Mark::Bar(0.25), [0.0, 0.25]),
            (Mark::Bar(0.02), [0.0, 0.02]),
            (Mark::Signed(0.5), [0.5, 0.75]),
            (Mark::Signed(-0.01), [0.495, 0.5]),
        ] {
            let found = seen(mark);
            assert!(found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 3e-3), "{found:?}");
        }
    }
}
