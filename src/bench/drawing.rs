//! What the diagrams have in common: text, markers, labels beside the ends of lines, logarithmic ticks.

use std::ops::Range;

use plotters::{
    coord::Shift,
    prelude::*,
    style::text_anchor::{HPos, Pos, VPos},
};

/// Between labels [px].
pub const LABEL_HEIGHT: f64 = 20.0;
pub const FONT: &str = "sans-serif";
pub const INK: RGBColor = RGBColor(34, 34, 34);
pub const GREY: RGBColor = RGBColor(110, 110, 110);

pub type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
pub type Failure<'a> = DrawingAreaErrorKind<<SVGBackend<'a> as DrawingBackend>::ErrorType>;

/// How a line is drawn.
#[derive(Clone, Copy)]
pub struct Style {
    /// Of line and markers.
    pub color: RGBColor,
    /// At each point.
    pub marker: Marker,
    /// Of the line [px].
    pub width: u32,
}

#[derive(Clone, Copy)]
pub enum Marker {
    Cross,
    Disc,
    /// Corners at these angles [eighths of a turn], from the top clockwise.
    Polygon(&'static [f64]),
}

/// 10⁰, 10¹ …, or what of 1, 2 and 5 times that lies in the range too if it is short.
pub fn ticks(range: &Range<f64>, multiples: &[f64]) -> Vec<f64> {
    let decades = range.start.log10().floor() as i32..=range.end.log10().ceil() as i32;
    let all = decades.flat_map(|decade| multiples.iter().map(move |multiple| multiple * 10f64.powi(decade)));
    all.filter(|&tick| tick >= 0.999 * range.start && tick <= 1.001 * range.end).collect()
}

/// Labels in a column right of the axes, each as near to the height of the end of its line as the others let it.
pub fn draw_labels<'a>(
    panel: &Area<'a>,
    right: i32,
    limits: (f64, f64),
    mut ends: Vec<((i32, i32), String, Style)>,
) -> Result<(), Failure<'a>> {
    ends.sort_by_key(|(end, ..)| (end.1, end.0));
    let wanted: Vec<f64> = ends.iter().map(|((_, y), ..)| f64::from(*y)).collect();
    for (((end, text, style), y), k) in ends.iter().zip(spread(&wanted, limits)).zip(0..) {
        let y = y.round() as i32;
        let elbow = right + 10 + 4 * (k % 3);
        panel.draw(&PathElement::new([*end, (elbow, y), (right + 28, y)], style.color.mix(0.45)))?;
        draw_marker(panel, *style, (right + 28, y))?;
        write(panel, text, (right + 40, y), 19.0, style.color, HPos::Left)?;
    }
    Ok(())
}

/// Heights, at least a label's height from each other, close to those `wanted` (ascending), within `limits`.
fn spread(wanted: &[f64], limits: (f64, f64)) -> Vec<f64> {
    // clusters of labels that touch, each as (sum of what its first label would want, labels)
    let mut clusters: Vec<(f64, usize)> = vec![];
    let first = |&(sum, labels): &(f64, usize)| {
        let height = LABEL_HEIGHT * (labels - 1) as f64;
        (sum / labels as f64).min(limits.1 - height).max(limits.0)
    };
    for &y in wanted {
        let mut cluster = (y, 1);
        while let Some(above) = clusters.pop() {
            if first(&above) + LABEL_HEIGHT * above.1 as f64 <= first(&cluster) {
                clusters.push(above);
                break;
            }
            let shift = LABEL_HEIGHT * above.1 as f64;
            cluster = (above.0 + cluster.0 - shift * cluster.1 as f64, above.1 + cluster.1);
        }
        clusters.push(cluster);
    }
    let heights = |cluster: &(f64, usize)| {
        let first = first(cluster);
        (0..cluster.1).map(move |k| first + LABEL_HEIGHT * k as f64)
    };
    clusters.iter().flat_map(heights).collect()
}

pub fn draw_marker<'a>(panel: &Area<'a>, style: Style, (x, y): (i32, i32)) -> Result<(), Failure<'a>> {
    const SIZE: f64 = 7.0;
    match style.marker {
        Marker::Disc => panel.draw(&Circle::new((x, y), 5, style.color.filled())),
        Marker::Cross => {
            for (dx, dy) in [(5, 5), (5, -5)] {
                let stroke = [(x - dx, y - dy), (x + dx, y + dy)];
                panel.draw(&PathElement::new(stroke, style.color.stroke_width(3)))?;
            }
            Ok(())
        }
        Marker::Polygon(angles) => {
            let corner = |(k, &eighths): (usize, &f64)| {
                let size = if angles.len() > 4 && k % 2 == 1 { 0.45 * SIZE } else { SIZE };
                let (sin, cos) = (eighths * std::f64::consts::FRAC_PI_4).sin_cos();
                (x + (size * sin).round() as i32, y - (size * cos).round() as i32)
            };
            let corners: Vec<_> = angles.iter().enumerate().map(corner).collect();
            panel.draw(&Polygon::new(corners, style.color.filled()))
        }
    }
}

pub fn write<'a>(
    area: &Area<'a>,
    text: &str,
    at: (i32, i32),
    size: f64,
    color: RGBColor,
    anchor: HPos,
) -> Result<(), Failure<'a>> {
    // what XML has no place for
    let text: String = text.chars().map(|c| if c.is_control() { '\u{fffd}' } else { c }).collect();
    let style = (FONT, size).into_font().color(&color).pos(Pos::new(anchor, VPos::Center));
    area.draw(&Text::new(text, at, style))
}

/// "10⁻³", or the power above
pub fn power_of_ten(x: f64) -> String {
    let exponent = (x.log10() - 1e-6).ceil() as i32;
    let raised = |c: char| match c {
        '-' => '⁻',
        '1' => '¹',
        '2' => '²',
        '3' => '³',
        digit => char::from_u32('⁰' as u32 + digit as u32 - '0' as u32).unwrap_or(digit),
    };
    if exponent == 0 {
        "1".to_owned()
    } else {
        format!("10{}", exponent.to_string().chars().map(raised).collect::<String>())
    }
}
