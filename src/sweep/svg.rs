//! The map as an SVG diagram. Rectangles of one colour are joined, so that even a map of a million points is a small
//! file.

use std::fmt::Write as _;

use super::{
    bisect,
    map::{COLORS, Map, Slice, boundary, ramp, ticks},
    refine::FAILED,
};

/// Size of a panel's map, and the margins around it [px].
const MAP: [f64; 2] = [560.0, 400.0];
const LEFT: f64 = 86.0;
const BELOW: f64 = 66.0;
const ABOVE: f64 = 40.0;
const RIGHT: f64 = 30.0;
const HEADER: f64 = 62.0;
const LEGEND: f64 = 170.0;
/// Maximum number of panels of a diagram.
const MAX_PANELS: usize = 6;

/// Draws the maps.
pub fn svg(map: &Map, title: &str, about: &str) -> String {
    let panels = &map.slices[..map.slices.len().min(MAX_PANELS)];
    let columns = if panels.len() > 1 { 2 } else { 1 };
    let rows = panels.len().div_ceil(columns);
    let height_of_map = if map.axes.len() > 1 { MAP[1] } else { 60.0 };
    let panel = [LEFT + MAP[0] + RIGHT, ABOVE + height_of_map + BELOW];
    let (width, height) = (panel[0] * columns as f64 + LEGEND, HEADER + panel[1] * rows as f64);
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\" \
         font-family=\"sans-serif\" fill=\"#222\">\n<rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n"
    );
    write(&mut text, [20.0, 32.0], 24.0, "start", title);
    let _ = writeln!(text, "<g fill=\"#6e6e6e\">");
    write(&mut text, [20.0, 56.0], 15.0, "start", about);
    let _ = writeln!(text, "</g>");
    for (number, slice) in panels.iter().enumerate() {
        let x = LEFT + panel[0] * (number % columns) as f64;
        let y = HEADER + ABOVE + panel[1] * (number / columns) as f64;
        let _ = writeln!(text, "<g transform=\"translate({x} {y})\">");
        draw(&mut text, map, slice, height_of_map);
        let _ = writeln!(text, "</g>");
    }
    legend(&mut text, map, panels, [panel[0] * columns as f64 + 4.0, HEADER + ABOVE]);
    text.push_str("</svg>\n");
    text
}

fn write(text: &mut String, [x, y]: [f64; 2], size: f64, anchor: &str, what: &str) {
    let mut escaped = String::new();
    for c in what.chars() {
        match c {
            '<' => escaped.push_str("&lt;"),
            '&' => escaped.push_str("&amp;"),
            c if c.is_control() => escaped.push('\u{fffd}'),
            c => escaped.push(c),
        }
    }
    let _ = writeln!(
        text,
        "<text x=\"{x:.1}\" y=\"{y:.1}\" font-size=\"{size}\" text-anchor=\"{anchor}\">{escaped}</text>"
    );
}

fn hex([r, g, b]: [u8; 3]) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

fn draw(text: &mut String, map: &Map, slice: &Slice, height: f64) {
    let width = MAP[0];
    let pixel = |[x, y]: [f64; 2]| [x * width, (1.0 - y) * height];
    if map.is_grid {
        fill(text, map, slice, height);
        let lines = boundary(slice);
        if !lines.is_empty() {
            text.push_str("<path fill=\"none\" stroke=\"#222\" stroke-width=\"1.2\" stroke-linecap=\"round\" d=\"");
            for [from, to] in lines {
                let ([x, y], [to_x, to_y]) = (pixel(from), pixel(to));
                let _ = write!(text, "M{x:.1} {y:.1}L{to_x:.1} {to_y:.1}");
            }
            text.push_str("\"/>\n");
        }
    } else {
        for dot in &slice.dots {
            let [x, y] = pixel(dot.at);
            let color = hex(COLORS.get(dot.class as usize).copied().unwrap_or_default());
            let _ = writeln!(text, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3\" fill=\"{color}\"/>");
        }
    }
    let _ = writeln!(text, "<rect width=\"{width}\" height=\"{height}\" fill=\"none\" stroke=\"#6e6e6e\"/>");
    if let Some(axis) = map.axes.first() {
        for (share, number) in ticks(axis) {
            let x = share * width;
            let _ = writeln!(text, "<path d=\"M{x:.1} {height}v6\" stroke=\"#6e6e6e\"/>");
            write(text, [x, height + 22.0], 14.0, "middle", &number);
        }
        write(text, [0.5 * width, height + 48.0], 17.0, "middle", &axis.label());
    }
    if let Some(axis) = map.axes.get(1) {
        for (share, number) in ticks(axis) {
            let y = (1.0 - share) * height;
            let _ = writeln!(text, "<path d=\"M0 {y:.1}h-6\" stroke=\"#6e6e6e\"/>");
            write(text, [-10.0, y + 5.0], 14.0, "end", &number);
        }
        let _ = writeln!(text, "<g transform=\"translate(-60 {:.1}) rotate(-90)\">", 0.5 * height);
        write(text, [0.0, 0.0], 17.0, "middle", &axis.label());
        text.push_str("</g>\n");
    }
    write(text, [0.0, -12.0], 16.0, "start", &slice.title);
}

/// Fills the cells of the points with one path per colour. A rectangle is a run of equal points, extended over equal
/// runs above it.
fn fill(text: &mut String, map: &Map, slice: &Slice, height: f64) {
    let [columns, rows] = slice.size;
    let x = |k: usize| slice.edges[0][k] * MAP[0];
    let y = |k: usize| (1.0 - slice.edges[1][k]) * height;
    // open rectangles are (first column, column past the last, first row, colour)
    let mut paths: Vec<([u8; 3], String)> = Vec::new();
    let mut open: Vec<(usize, usize, usize, [u8; 3])> = Vec::new();
    let mut close = |(from, to, row, color): (usize, usize, usize, [u8; 3]), end: usize| {
        let index = paths.iter().position(|(known, _)| *known == color).unwrap_or_else(|| {
            paths.push((color, String::new()));
            paths.len() - 1
        });
        if let Some((_, path)) = paths.get_mut(index) {
            let _ = write!(path, "M{:.1} {:.1}H{:.1}V{:.1}H{:.1}z", x(from), y(row), x(to), y(end), x(from));
        }
    };
    for row in 0..rows {
        let mut next = Vec::new();
        let mut from = 0;
        while from < columns {
            let color = map.color(slice, row * columns + from);
            let run = (from..columns).take_while(|&k| map.color(slice, row * columns + k) == color).count();
            next.push((from, from + run, row, color));
            from += run;
        }
        for old in open {
            match next.iter_mut().find(|new| (new.0, new.1, new.3) == (old.0, old.1, old.3)) {
                Some(new) => new.2 = old.2,
                None => close(old, row),
            }
        }
        open = next;
    }
    open.into_iter().for_each(|old| close(old, rows));
    for (color, path) in paths {
        let color = hex(color);
        // the stroke covers the seams between rectangles
        let _ = writeln!(text, "<path fill=\"{color}\" stroke=\"{color}\" stroke-width=\"0.4\" d=\"{path}\"/>");
    }
}

fn legend(text: &mut String, map: &Map, panels: &[Slice], [x, y]: [f64; 2]) {
    let mut y = y;
    match map.range {
        Some([low, high]) => {
            write(text, [x, y + 4.0], 15.0, "start", &map.color);
            for k in 0..32 {
                let color = hex(ramp(k as f64 / 31.0));
                let at = y + 16.0 + (31 - k) as f64 * 6.0;
                let _ =
                    writeln!(text, "<rect x=\"{x:.1}\" y=\"{at:.1}\" width=\"22\" height=\"6.4\" fill=\"{color}\"/>");
            }
            for (value, at) in [(high, 22.0), (low, 208.0)] {
                write(text, [x + 30.0, y + at + 4.0], 14.0, "start", &format!("{value:.3}"));
            }
            write(text, [x, y + 244.0], 14.0, "start", "line: where the");
            write(text, [x, y + 262.0], 14.0, "start", "outcome changes");
        }
        None => {
            for class in 0..=FAILED {
                if panels
                    .iter()
                    .any(|slice| slice.classes.contains(&class) || slice.dots.iter().any(|dot| dot.class == class))
                {
                    let color = hex(COLORS[class as usize]);
                    let _ = writeln!(
                        text,
                        "<rect x=\"{x:.1}\" y=\"{:.1}\" width=\"20\" height=\"20\" fill=\"{color}\" stroke=\"#6e6e6e\"/>",
                        y - 4.0
                    );
                    write(text, [x + 30.0, y + 11.0], 16.0, "start", bisect::name(class));
                    y += 32.0;
                }
            }
        }
    }
}
