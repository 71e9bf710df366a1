//! Charts: lines with markers, each with its name at its end.

use std::{f64::consts::FRAC_PI_4, ops::Range};

use crate::svg::{Anchor, GREY, INK, Paint, Rgb, Svg, through, ticks};

/// Size of a panel, labels included [px].
const PANEL: [f64; 2] = [900.0, 600.0];
/// Margins around the axes of a panel [px].
const LEFT: f64 = 98.0;
const RIGHT: f64 = 270.0;
const ABOVE: f64 = 46.0;
const BELOW: f64 = 66.0;
/// Height of the heading above the panels, and of a line of the notes below them [px].
const HEADING: f64 = 108.0;
const NOTE: f64 = 24.0;
/// Least vertical distance between names [px].
const NAME_HEIGHT: f64 = 20.0;

/// A chart of one or more panels.
#[derive(Clone, Debug)]
pub struct Chart {
    /// The title.
    pub title: String,
    /// Two lines that say how to read it.
    pub heading: [&'static str; 2],
    /// The panels.
    pub panels: Vec<Panel>,
    /// Lines of text below the panels.
    pub notes: Vec<String>,
}

/// A pair of axes with lines.
#[derive(Clone, Debug)]
pub struct Panel {
    /// The title.
    pub title: String,
    /// The horizontal axis and the vertical one.
    pub axes: [Axis; 2],
    /// The lines.
    pub lines: Vec<Line>,
    /// What is marked on the horizontal axis.
    pub marks: Vec<Mark>,
}

/// A value of the horizontal axis, marked by an upright line.
#[derive(Clone, Debug)]
pub struct Mark {
    /// The value.
    pub at: f64,
    /// Its name, written beside the upper end of the line.
    pub name: String,
}

/// An axis.
#[derive(Clone, Debug)]
pub struct Axis {
    /// Its quantity and unit.
    pub name: &'static str,
    /// From its lower to its upper end; values beyond are drawn at the end.
    pub range: Range<f64>,
    /// Whether its scale is logarithmic; else it is linear.
    pub is_logarithmic: bool,
}

impl Axis {
    /// A linear axis.
    pub fn linear(name: &'static str, range: Range<f64>) -> Axis {
        Axis { name, range, is_logarithmic: false }
    }

    /// A logarithmic axis that spans `values`, with a factor of `margin` on either side.
    pub fn spanning(name: &'static str, values: impl Iterator<Item = f64>, margin: f64) -> Axis {
        let (low, high) = values
            .filter(|value| value.is_finite() && *value > 0.0)
            .fold((f64::INFINITY, 0.0), |(low, high), value| (f64::min(low, value), f64::max(high, value)));
        let range = if low <= high { low / margin..high * margin } else { 0.1..10.0 };
        Axis { name, range, is_logarithmic: true }
    }

    /// The share of the axis below a value.
    fn share(&self, value: f64) -> f64 {
        let Range { start, end } = self.range;
        // NaN is drawn at the upper end, like what has diverged
        let value = if value <= end { value.max(start) } else { end };
        match self.is_logarithmic {
            true => (value / start).ln() / (end / start).ln(),
            false => (value - start) / (end - start),
        }
    }

    fn ticks(&self) -> Vec<f64> {
        ticks([self.range.start, self.range.end], self.is_logarithmic)
    }
}

/// A line with a marker at each point.
#[derive(Clone, Debug)]
pub struct Line {
    /// Its name, written at its end.
    pub name: String,
    /// How it is drawn.
    pub style: Style,
    /// Its points.
    pub points: Vec<[f64; 2]>,
    /// Index of the point with a ring around it.
    pub ringed: Option<usize>,
}

/// How a line is drawn.
#[derive(Clone, Copy, Debug)]
pub struct Style {
    /// Its colour.
    pub color: Rgb,
    /// The marker at its points.
    pub marker: Marker,
    /// Its width [px].
    pub width: f64,
}

/// A shape at a point.
#[derive(Clone, Copy, Debug)]
pub enum Marker {
    /// Nothing.
    None,
    /// Two crossed strokes.
    Cross,
    /// A disc.
    Disc,
    /// A polygon with corners at these angles [eighths of a turn], clockwise from the top.
    Polygon(&'static [f64]),
    /// A star with five points.
    Star,
}

/// A triangle that stands on its base.
pub const TRIANGLE: Marker = Marker::Polygon(&[0.0, 2.67, 5.33]);
/// A triangle that stands on its tip.
pub const TIP: Marker = Marker::Polygon(&[4.0, 1.33, 6.67]);
/// A square.
pub const SQUARE: Marker = Marker::Polygon(&[1.0, 3.0, 5.0, 7.0]);
/// A square that stands on a corner.
pub const DIAMOND: Marker = Marker::Polygon(&[0.0, 2.0, 4.0, 6.0]);

impl Chart {
    /// The chart as an SVG file.
    pub fn svg(&self) -> String {
        let columns = self.panels.len().clamp(1, 2);
        let rows = self.panels.len().div_ceil(columns);
        let below = HEADING + PANEL[1] * rows as f64;
        let mut svg = Svg::new([PANEL[0] * columns as f64, below + NOTE * (self.notes.len() + 1) as f64]);
        svg.write([20.0, 42.0], 30.0, INK, Anchor::Start, &self.title);
        for (line, y) in self.heading.iter().zip([70.0, 96.0]) {
            svg.write([20.0, y], 18.0, GREY, Anchor::Start, line);
        }
        for (number, panel) in self.panels.iter().enumerate() {
            let corner = [number % columns, number / columns].map(|index| index as f64);
            svg.group([PANEL[0] * corner[0], HEADING + PANEL[1] * corner[1]], 0.0, |svg| panel.draw(svg));
        }
        for (number, note) in self.notes.iter().enumerate() {
            svg.write([20.0, below + NOTE * (number + 1) as f64], 17.0, GREY, Anchor::Start, note);
        }
        svg.finish()
    }
}

impl Panel {
    fn draw(&self, svg: &mut Svg) {
        let (right, bottom) = (PANEL[0] - RIGHT, PANEL[1] - BELOW);
        let [x, y] = &self.axes;
        let pixel = |[a, b]: [f64; 2]| [LEFT + x.share(a) * (right - LEFT), bottom - y.share(b) * (bottom - ABOVE)];
        let on_grid = |point: [f64; 2]| pixel(point).map(f64::round);
        svg.write([LEFT, 0.6 * ABOVE], 24.0, INK, Anchor::Start, &self.title);
        for tick in x.ticks() {
            let [at, _] = on_grid([tick, y.range.start]);
            svg.line(&[[at, ABOVE], [at, bottom]], [214; 3], 1.0);
            svg.write([at, bottom + 24.0], 19.0, INK, Anchor::Middle, &written(tick));
        }
        for tick in y.ticks() {
            let [_, at] = on_grid([x.range.start, tick]);
            svg.line(&[[LEFT, at], [right, at]], [214; 3], 1.0);
            svg.write([LEFT - 8.0, at + 6.0], 19.0, INK, Anchor::End, &written(tick));
        }
        svg.line(&[[LEFT, ABOVE], [LEFT, bottom], [right, bottom]], GREY, 1.0);
        svg.write([0.5 * (LEFT + right), bottom + 52.0], 21.0, INK, Anchor::Middle, x.name);
        svg.group([26.0, 0.5 * (ABOVE + bottom)], -90.0, |svg| {
            svg.write([0.0, 0.0], 21.0, INK, Anchor::Middle, y.name);
        });

        for (number, mark) in self.marks.iter().enumerate() {
            let [at, _] = on_grid([mark.at, y.range.start]);
            svg.line(&[[at, ABOVE], [at, bottom]], GREY, 1.5);
            // each name below the one before; only beside the last line is there room on the right
            let height = ABOVE + NAME_HEIGHT * (number + 1) as f64;
            let is_last = self.marks.iter().all(|other| other.at <= mark.at);
            let (beside, anchor) = if is_last { (at + 6.0, Anchor::Start) } else { (at - 6.0, Anchor::End) };
            svg.write([beside, height], 17.0, GREY, anchor, &mark.name);
        }

        let mut lines: Vec<(&Line, Vec<[f64; 2]>)> =
            self.lines.iter().map(|line| (line, line.points.iter().map(|&point| pixel(point)).collect())).collect();
        lines.retain(|(_, points)| !points.is_empty());
        for (line, points) in &lines {
            svg.line(points, line.style.color, line.style.width);
            points.iter().for_each(|&point| line.style.mark(svg, point));
            if let Some(&point) = line.ringed.and_then(|index| points.get(index)) {
                svg.circle(point, 11.0, Paint::Stroke(line.style.color, 2.0));
            }
        }
        let end = |points: &[[f64; 2]]| points.last().copied().unwrap_or_default();
        lines.sort_by(|(_, a), (_, b)| f64::total_cmp(&end(a)[1], &end(b)[1]));
        let wanted: Vec<f64> = lines.iter().map(|(_, points)| end(points)[1]).collect();
        for ((line, points), y) in lines.iter().zip(spread(&wanted, bottom)) {
            let pale = line.style.color.map(|channel| channel / 2 + 127);
            svg.line(&[end(points), [right + 16.0, y], [right + 28.0, y]], pale, 1.0);
            line.style.mark(svg, [right + 28.0, y]);
            svg.write([right + 40.0, y + 6.0], 19.0, line.style.color, Anchor::Start, &line.name);
        }
    }
}

impl Style {
    fn mark(self, svg: &mut Svg, [x, y]: [f64; 2]) {
        const SIZE: f64 = 7.0;
        let corner = |eighths: f64, size: f64| {
            let (sin, cos) = (eighths * FRAC_PI_4).sin_cos();
            [x + size * sin, y - size * cos]
        };
        let fill = |svg: &mut Svg, corners: &[[f64; 2]]| {
            svg.path(&(through(corners) + "z"), Paint::Fill(self.color));
        };
        match self.marker {
            Marker::None => {}
            Marker::Disc => svg.circle([x, y], 5.0, Paint::Fill(self.color)),
            Marker::Cross => {
                for eighths in [1.0, 3.0] {
                    svg.line(&[corner(eighths, SIZE), corner(eighths + 4.0, SIZE)], self.color, 3.0);
                }
            }
            Marker::Polygon(angles) => {
                fill(svg, &angles.iter().map(|&eighths| corner(eighths, SIZE)).collect::<Vec<_>>());
            }
            Marker::Star => {
                let corners = (0..10).map(|k| corner(0.8 * f64::from(k), SIZE * if k % 2 == 0 { 1.0 } else { 0.45 }));
                fill(svg, &corners.collect::<Vec<_>>());
            }
        }
    }
}

/// Heights at or below those `wanted` (ascending) that are a name's height apart, moved up as far as `bottom` requires.
fn spread(wanted: &[f64], bottom: f64) -> Vec<f64> {
    let mut heights: Vec<f64> = Vec::with_capacity(wanted.len());
    for &y in wanted {
        heights.push(heights.last().map_or(y, |above| f64::max(y, above + NAME_HEIGHT)));
    }
    let mut limit = bottom;
    for height in heights.iter_mut().rev() {
        *height = f64::min(*height, limit);
        limit = *height - NAME_HEIGHT;
    }
    heights
}

/// A number of a tick: as a power of ten, or plainly.
fn written(tick: f64) -> String {
    let exponent = tick.log10().round();
    if tick <= 0.0 || (1e-2..1e4).contains(&tick) || (tick / 10f64.powf(exponent) - 1.0).abs() > 1e-6 {
        // a multiple of a tenth is not a decimal number to the last bit
        return format!("{}", (1e6 * tick).round() / 1e6 + 0.0).replace('-', "−");
    }
    let raised = |c: char| match c {
        '-' => '⁻',
        digit => ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'][digit.to_digit(10).unwrap_or(0) as usize],
    };
    format!("10{}", exponent.to_string().chars().map(raised).collect::<String>())
}
