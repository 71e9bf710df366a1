//! The map as an SVG diagram. Rectangles of one colour are joined, so that even a map of a million points is a small
//! file.

use std::fmt::Write as _;

use super::{
    classes::{self, FAILED},
    map::{Map, Slice, boundary, ramp, regions, ticks},
};
use crate::svg::{Anchor, GREY, INK, Paint, Rgb, Svg, through};

/// Size of a panel's map, and the margins around it [px].
const MAP: [f64; 2] = [560.0, 400.0];
const LEFT: f64 = 86.0;
const BELOW: f64 = 66.0;
const ABOVE: f64 = 40.0;
const RIGHT: f64 = 30.0;
const HEADER: f64 = 80.0;
const LEGEND: f64 = 250.0;
/// Characters in a line of the legend.
const LINE: usize = 30;
/// Radius of a threshold [px].
const THRESHOLD: f64 = 2.6;
/// Maximum number of panels of a diagram.
const MAX_PANELS: usize = 6;

/// Draws the maps; `about` has two lines.
pub fn svg(map: &Map, title: &str, about: &str) -> String {
    let panels = &map.slices[..map.slices.len().min(MAX_PANELS)];
    let columns = if panels.len() > 1 { 2 } else { 1 };
    let rows = panels.len().div_ceil(columns);
    let height_of_map = if map.axes.len() > 1 { MAP[1] } else { 60.0 };
    let panel = [LEFT + MAP[0] + RIGHT, ABOVE + height_of_map + BELOW];
    let beside = [panel[0] * columns as f64 + 4.0, HEADER + ABOVE];
    let bottom = legend(&mut Svg::new([0.0; 2]), map, panels, beside);
    let height = f64::max(HEADER + panel[1] * rows as f64, bottom);
    let mut svg = Svg::new([panel[0] * columns as f64 + LEGEND, height]);
    svg.write([20.0, 32.0], 24.0, INK, Anchor::Start, title);
    for (number, line) in about.lines().enumerate() {
        svg.write([20.0, 56.0 + 18.0 * number as f64], 14.0, GREY, Anchor::Start, line);
    }
    for (number, slice) in panels.iter().enumerate() {
        let x = LEFT + panel[0] * (number % columns) as f64;
        let y = HEADER + ABOVE + panel[1] * (number / columns) as f64;
        svg.group([x, y], 0.0, |svg| draw(svg, map, slice, height_of_map));
    }
    legend(&mut svg, map, panels, beside);
    svg.finish()
}

fn draw(svg: &mut Svg, map: &Map, slice: &Slice, height: f64) {
    let width = MAP[0];
    let pixel = |[x, y]: [f64; 2]| [x * width, (1.0 - y) * height];
    if map.is_grid {
        fill(svg, map, slice, height);
        let lines: String = boundary(slice).into_iter().map(|line| through(&line.map(pixel))).collect();
        if !lines.is_empty() {
            svg.path(&lines, Paint::Stroke(INK, 1.2));
        }
    } else {
        for dot in &slice.dots {
            let color = classes::color(dot.class).0;
            svg.circle(pixel(dot.at), 3.0, Paint::Fill(color));
        }
    }
    if map.range.is_some() && map.is_grid {
        // the colours say nothing about outcomes
        for (class, at) in regions(slice) {
            let (name, [x, y]) = (map.classes.name(class), pixel(at));
            let width = 9.0 * name.chars().count() as f64 + 10.0;
            svg.rectangle([x - 0.5 * width, y - 15.0], [width, 22.0], Paint::Fill([255; 3]));
            svg.write([x, y + 1.0], 15.0, INK, Anchor::Middle, &name);
        }
    }
    for &threshold in &slice.thresholds {
        svg.circle(pixel(threshold), THRESHOLD, Paint::Both { fill: INK, stroke: [255; 3], width: 0.8 });
    }
    svg.rectangle([0.0; 2], [width, height], Paint::Stroke(GREY, 1.0));
    if let Some(axis) = map.axes.first() {
        for (share, number) in ticks(axis) {
            let x = share * width;
            svg.line(&[[x, height], [x, height + 6.0]], GREY, 1.0);
            svg.write([x, height + 22.0], 14.0, INK, Anchor::Middle, &number);
        }
        svg.write([0.5 * width, height + 48.0], 17.0, INK, Anchor::Middle, &axis.label());
    }
    if let Some(axis) = map.axes.get(1) {
        for (share, number) in ticks(axis) {
            let y = (1.0 - share) * height;
            svg.line(&[[0.0, y], [-6.0, y]], GREY, 1.0);
            svg.write([-10.0, y + 5.0], 14.0, INK, Anchor::End, &number);
        }
        svg.group([-60.0, 0.5 * height], -90.0, |svg| {
            svg.write([0.0; 2], 17.0, INK, Anchor::Middle, &axis.label());
        });
    }
    svg.write([0.0, -12.0], 16.0, INK, Anchor::Start, &slice.title);
}

/// Fills the cells of the points with one path per colour. A rectangle is a run of equal points, extended over equal
/// runs above it.
fn fill(svg: &mut Svg, map: &Map, slice: &Slice, height: f64) {
    let [columns, rows] = slice.size;
    let x = |k: usize| slice.edges[0][k] * MAP[0];
    let y = |k: usize| (1.0 - slice.edges[1][k]) * height;
    // open rectangles are (first column, column past the last, first row, colour)
    let mut paths: Vec<(Rgb, String)> = Vec::new();
    let mut open: Vec<(usize, usize, usize, Rgb)> = Vec::new();
    let mut close = |(from, to, row, color): (usize, usize, usize, Rgb), end: usize| {
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
        // the outline covers the seams between rectangles
        svg.path(&path, Paint::Both { fill: color, stroke: color, width: 0.4 });
    }
}

/// Draws the legend; returns where it ends.
fn legend(svg: &mut Svg, map: &Map, panels: &[Slice], [x, mut y]: [f64; 2]) -> f64 {
    let has_thresholds = panels.iter().any(|slice| !slice.thresholds.is_empty());
    if let Some([low, high]) = map.range {
        svg.write([x, y + 4.0], 15.0, INK, Anchor::Start, &map.color);
        for k in 0..32 {
            let at = y + 16.0 + f64::from(31 - k) * 6.0;
            svg.rectangle([x, at], [22.0, 6.4], Paint::Fill(ramp(f64::from(k) / 31.0)));
        }
        for (value, at) in [(high, 26.0), (0.5 * (low + high), 119.0), (low, 212.0)] {
            svg.write([x + 30.0, y + at], 14.0, INK, Anchor::Start, &format!("{value:.3}"));
        }
        y = explain(svg, [x, y + 236.0], &map.about_color) + 14.0;
    } else {
        let is_shown = |class: &u8| panels.iter().any(|slice| slice.shows(*class));
        for class in (0..=FAILED).filter(is_shown) {
            let paint = Paint::Both { fill: classes::color(class).0, stroke: GREY, width: 1.0 };
            svg.rectangle([x, y - 4.0], [20.0, 20.0], paint);
            svg.write([x + 30.0, y + 11.0], 16.0, INK, Anchor::Start, &map.classes.name(class));
            y = explain(svg, [x + 30.0, y + 28.0], map.classes.about(class)) + 10.0;
        }
    }
    if map.is_grid {
        svg.line(&[[x, y + 6.0], [x + 20.0, y + 6.0]], INK, 1.2);
        y = explain(svg, [x + 30.0, y + 11.0], "midway between runs of different outcome") + 6.0;
    }
    if has_thresholds {
        svg.circle([x + 10.0, y + 6.0], THRESHOLD, Paint::Fill(INK));
        y = explain(svg, [x + 30.0, y + 11.0], "where it changes, bisected to 1e-9") + 6.0;
    }
    if let Some(text) = map.about_undecided() {
        y = explain(svg, [x, y + 11.0], &text);
    }
    y
}

/// Writes a small text in lines; returns where the next one would be.
fn explain(svg: &mut Svg, [x, mut y]: [f64; 2], text: &str) -> f64 {
    if text.is_empty() {
        return y;
    }
    let mut line = String::new();
    for word in text.split(' ') {
        if !line.is_empty() && line.chars().count() + 1 + word.chars().count() > LINE {
            svg.write([x, y], 13.0, GREY, Anchor::Start, &line);
            (y, line) = (y + 16.0, String::new());
        }
        line = if line.is_empty() { word.to_owned() } else { format!("{line} {word}") };
    }
    svg.write([x, y], 13.0, GREY, Anchor::Start, &line);
    y + 16.0
}
