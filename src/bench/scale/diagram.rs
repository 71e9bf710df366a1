//! Cost against size: time of a step against the number of bodies, a line a family.

use std::ops::Range;

use plotters::{prelude::*, style::text_anchor::HPos};

use super::{Point, Report, Run, scenes::Family};
use crate::bench::{
    drawing::{Area, FONT, Failure, GREY, INK, Marker, Style, draw_labels, draw_marker, power_of_ten, ticks, write},
    machine::Machine,
};

/// All of it [px].
const SIZE: (u32, u32) = (1100, 780);
const HEADER: u32 = 108;
const FOOTER: u32 = 70;
/// Around the axes [px].
const TOP: u32 = 16;
const MARGIN: u32 = 14;
const LEFT: u32 = 84;
const RIGHT: u32 = 330;
const BOTTOM: u32 = 66;

/// Colours that the colour-blind can tell too (Okabe & Ito 2008), and shapes; the plain way is drawn in its family's colour.
fn style(family: Family, is_plain: bool) -> Style {
    let (color, marker) = match family {
        Family::Contact => (RGBColor(213, 94, 0), Marker::Polygon(&[0.0, 2.67, 5.33])),
        Family::Hundredth => (RGBColor(0, 114, 178), Marker::Polygon(&[1.0, 3.0, 5.0, 7.0])),
        Family::Rest => (RGBColor(0, 158, 115), Marker::Disc),
    };
    if is_plain { Style { color, marker: Marker::Cross, width: 1 } } else { Style { color, marker, width: 3 } }
}

/// The diagram as an SVG file.
///
/// # Errors
/// What the drawing library says; none is known.
pub fn svg(report: &Report, machine: &Machine) -> Result<String, String> {
    let mut text = String::new();
    let root = SVGBackend::with_string(&mut text, SIZE).into_drawing_area();
    let drawn = draw(&root, report, machine).and_then(|()| root.present());
    drop(root);
    drawn.map_err(|error| error.to_string())?;
    Ok(text)
}

/// A line of the diagram.
struct Line {
    name: String,
    style: Style,
    /// Numbers of bodies, and time of a step [ms].
    points: Vec<(f64, f64)>,
}

fn lines(report: &Report) -> Vec<Line> {
    let mut lines = vec![];
    let mut add = |family: Family, is_plain: bool, run: &dyn Fn(&Point) -> Option<Run>| {
        let point = |point: &Point| Some((point.bodies as f64, 1e3 * run(point)?.seconds));
        let points: Vec<_> = report.of(family).filter_map(point).filter(|(_, time)| *time > 0.0).collect();
        let name = if is_plain { format!("{}, plain", family.name()) } else { family.name().to_owned() };
        if !points.is_empty() {
            lines.push(Line { name, style: style(family, is_plain), points });
        }
    };
    for family in Family::ALL {
        add(family, false, &|point| Some(point.one.clone()));
        add(family, true, &|point| point.plain.as_ref().map(|plain| plain.run.clone()));
    }
    lines
}

fn draw<'a>(root: &Area<'a>, report: &Report, machine: &Machine) -> Result<(), Failure<'a>> {
    root.fill(&WHITE)?;
    let (header, below) = root.split_vertically(HEADER);
    let (panel, footer) = below.split_vertically(SIZE.1 - HEADER - FOOTER);
    write(&header, "Cost and size", (20, 32), 30.0, INK, HPos::Left)?;
    for (line, y) in [
        ("Time of a step against the number of bodies, 266 vertices each, on one core: down is faster.", 64),
        ("Crosses: the plain way, the thesis’s scheme with every vertex and all pairs, as far as it was followed.", 90),
    ] {
        write(&header, line, (20, y), 18.0, GREY, HPos::Left)?;
    }
    draw_panel(&panel, &lines(report))?;
    let machine = format!("{}, 1 of {} cores used; meldscope {}", machine.cpu, machine.cores, machine.version);
    for (line, y) in [("Run times: the best of 9 blocks of steps, or of 3 that take long.", 18), (machine.as_str(), 42)]
    {
        write(&footer, line, (20, y), 17.0, GREY, HPos::Left)?;
    }
    Ok(())
}

/// From the least to the largest, and as much again on either side.
fn range(values: impl Iterator<Item = f64> + Clone, room: f64) -> Range<f64> {
    let (least, most) = (values.clone().fold(f64::INFINITY, f64::min), values.fold(0.0, f64::max));
    if least <= most { least / room..most * room } else { 1.0..10.0 }
}

fn draw_panel<'a>(panel: &Area<'a>, lines: &[Line]) -> Result<(), Failure<'a>> {
    let all = lines.iter().flat_map(|line| &line.points);
    let (bodies, times) = (range(all.clone().map(|point| point.0), 1.5), range(all.map(|point| point.1), 2.0));
    let mut chart = ChartBuilder::on(panel)
        .margin_top(TOP)
        .margin_left(MARGIN)
        .margin_right(RIGHT)
        .x_label_area_size(BOTTOM)
        .y_label_area_size(LEFT)
        .build_cartesian_2d(
            bodies.clone().log_scale().with_key_points(ticks(&bodies, &[1.0])),
            times.clone().log_scale().with_key_points(ticks(&times, &[1.0])),
        )?;
    chart
        .configure_mesh()
        .x_desc("bodies")
        .y_desc("time of a step [ms]")
        .axis_desc_style((FONT, 21).into_font().color(&INK))
        .label_style((FONT, 19).into_font().color(&INK))
        .x_label_formatter(&|bodies| power_of_ten(*bodies))
        .y_label_formatter(&|time| power_of_ten(*time))
        .bold_line_style(RGBColor(214, 214, 214))
        .light_line_style(RGBColor(240, 240, 240))
        .axis_style(GREY)
        .draw()?;

    let origin = panel.get_base_pixel();
    let at = |&(bodies, time): &(f64, f64)| {
        let (x, y) = chart.backend_coord(&(bodies, time));
        (x - origin.0, y - origin.1)
    };
    let right = at(&(bodies.end, times.start)).0;
    let mut ends = vec![];
    for line in lines {
        let points: Vec<(i32, i32)> = line.points.iter().map(at).collect();
        panel.draw(&PathElement::new(points.clone(), line.style.color.stroke_width(line.style.width)))?;
        for &point in &points {
            draw_marker(panel, line.style, point)?;
        }
        if let Some(&end) = points.last() {
            ends.push((end, line.name.clone(), line.style));
        }
    }
    let height = SIZE.1 - HEADER - FOOTER;
    draw_labels(panel, right, (f64::from(TOP), f64::from(height - BOTTOM)), ends)
}
