//! Diagrams as SVG files: shapes, text and ticks.

use std::fmt::Write as _;

use crate::colors::hex;
pub use crate::colors::{GREEN, ORANGE, Rgb, SKY_BLUE, VERMILION};

/// Colour of text and outlines.
pub const INK: Rgb = [34, 34, 34];
/// Colour of axes and notes.
pub const GREY: Rgb = [110, 110, 110];
/// Okabe and Ito's blue, for a light background.
pub const BLUE: Rgb = [0, 114, 178];
/// Okabe and Ito's reddish purple, for a light background.
pub const PURPLE: Rgb = [204, 121, 167];

/// Where a text stands relative to its position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Anchor {
    /// It begins there.
    Start,
    /// Its middle is there.
    Middle,
    /// It ends there.
    End,
}

/// A diagram being drawn. Positions are in pixels, from the upper left corner.
pub struct Svg {
    text: String,
}

impl Svg {
    /// An empty diagram on a white background.
    pub fn new([width, height]: [f64; 2]) -> Svg {
        let text = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\" \
             font-family=\"sans-serif\">\n<desc>meldscope</desc>\n<rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n"
        );
        Svg { text }
    }

    /// The file.
    pub fn finish(mut self) -> String {
        self.text.push_str("</svg>\n");
        self.text
    }

    /// Draws with another origin, turned by an angle in degrees.
    pub fn group(&mut self, [x, y]: [f64; 2], degrees: f64, draw: impl FnOnce(&mut Svg)) {
        let _ = writeln!(self.text, "<g transform=\"translate({x:.1} {y:.1}) rotate({degrees})\">");
        draw(self);
        self.text.push_str("</g>\n");
    }

    /// Writes a line of text, with its baseline at `y`.
    pub fn write(&mut self, [x, y]: [f64; 2], size: f64, color: Rgb, anchor: Anchor, what: &str) {
        let anchor = match anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let color = hex(color);
        let _ = write!(
            self.text,
            "<text x=\"{x:.1}\" y=\"{y:.1}\" font-size=\"{size}\" fill=\"{color}\" text-anchor=\"{anchor}\">"
        );
        for c in what.chars() {
            match c {
                '<' => self.text.push_str("&lt;"),
                '>' => self.text.push_str("&gt;"),
                '&' => self.text.push_str("&amp;"),
                c if c.is_control() => self.text.push('\u{fffd}'),
                c => self.text.push(c),
            }
        }
        self.text.push_str("</text>\n");
    }

    /// Draws a path in SVG's notation, as an outline or filled.
    pub fn path(&mut self, commands: &str, paint: Paint) {
        let (fill, stroke, width) = match paint {
            Paint::Fill(color) => (hex(color), "none".to_owned(), 0.0),
            Paint::Stroke(color, width) => ("none".to_owned(), hex(color), width),
            Paint::Both { fill, stroke, width } => (hex(fill), hex(stroke), width),
        };
        let _ = writeln!(
            self.text,
            "<path fill=\"{fill}\" stroke=\"{stroke}\" stroke-width=\"{width}\" stroke-linecap=\"round\" \
             stroke-linejoin=\"round\" d=\"{commands}\"/>"
        );
    }

    /// Draws a line through some points.
    pub fn line(&mut self, points: &[[f64; 2]], color: Rgb, width: f64) {
        self.path(&through(points), Paint::Stroke(color, width));
    }

    /// Draws a rectangle.
    pub fn rectangle(&mut self, [x, y]: [f64; 2], [width, height]: [f64; 2], paint: Paint) {
        self.path(&format!("M{x:.1} {y:.1}h{width:.1}v{height:.1}h{:.1}z", -width), paint);
    }

    /// Draws a circle.
    pub fn circle(&mut self, [x, y]: [f64; 2], radius: f64, paint: Paint) {
        let (left, across) = (x - radius, 2.0 * radius);
        let arcs = format!("a{radius} {radius} 0 1 0 {across} 0a{radius} {radius} 0 1 0 {} 0z", -across);
        self.path(&format!("M{left:.1} {y:.1}{arcs}"), paint);
    }
}

/// How a shape is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Paint {
    /// Filled.
    Fill(Rgb),
    /// As an outline of this width [px].
    Stroke(Rgb, f64),
    /// Filled, with an outline.
    Both {
        /// Colour of the inside.
        fill: Rgb,
        /// Colour of the outline.
        stroke: Rgb,
        /// Width of the outline [px].
        width: f64,
    },
}

/// A path through some points, in SVG's notation.
pub fn through(points: &[[f64; 2]]) -> String {
    let mut text = String::new();
    for ([x, y], command) in points.iter().zip(std::iter::once('M').chain(std::iter::repeat('L'))) {
        let _ = write!(text, "{command}{x:.1} {y:.1}");
    }
    text
}

/// Round numbers within a range, ascending: about six on a linear axis; on a logarithmic one, powers of ten, and twice and
/// five times these if the range has less than three decades.
pub fn ticks([low, high]: [f64; 2], is_logarithmic: bool) -> Vec<f64> {
    if !(low < high) {
        return if low == high { vec![low] } else { Vec::new() };
    }
    let values: Vec<f64> = if is_logarithmic {
        let decades = low.log10().floor() as i32..=high.log10().ceil() as i32;
        let multiples: &[f64] = if high / low < 1e3 { &[1.0, 2.0, 5.0] } else { &[1.0] };
        decades.flat_map(|decade| multiples.iter().map(move |multiple| multiple * 10f64.powi(decade))).collect()
    } else {
        let rough = (high - low) / 6.0;
        let power = 10f64.powf(rough.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0].map(|multiple| multiple * power).into_iter().find(|step| *step >= rough);
        let step = step.unwrap_or(rough);
        let first = (low / step).ceil() as i64;
        (0..16).map(|k| (first + k) as f64 * step).collect()
    };
    let rounding = |end: f64| 1e-9 * if is_logarithmic { end } else { high - low };
    values.into_iter().filter(|tick| (low - rounding(low)..=high + rounding(high)).contains(tick)).collect()
}
