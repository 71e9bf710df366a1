//! The work-precision diagram: error against run time, a line an integrator, a panel a scene.

use std::ops::Range;

use plotters::{prelude::*, style::text_anchor::HPos};

use super::{Measurement, Report, Scheme};
use crate::{
    bench::{
        drawing::{
            Area, FONT, Failure, GREY, INK, Marker, Style, draw_labels, draw_marker, power_of_ten, ticks, write,
        },
        machine::Machine,
    },
    scene::Integrator,
};

/// A panel, labels included [px].
const PANEL: (u32, u32) = (900, 620);
/// Above and below the panels [px].
const HEADER: u32 = 108;
const FOOTER: u32 = 88;
/// Around the axes of a panel [px].
const LEFT: u32 = 84;
const RIGHT: u32 = 246;
/// Left of the title of the vertical axis [px].
const MARGIN: u32 = 14;
/// Errors are drawn down to this, or to what the reference resolves [radii].
const FLOOR: f64 = 1e-12;
const TOP: u32 = 46;
const BOTTOM: u32 = 66;
/// Colours that the colour-blind can tell too (Okabe & Ito 2008), and shapes.
fn style(scheme: Scheme) -> Style {
    let (color, marker, width) = match scheme {
        Scheme::Fixed(Integrator::Thesis) => (RGBColor(213, 94, 0), Marker::Cross, 3),
        Scheme::Fixed(Integrator::Mps) => (RGBColor(230, 159, 0), Marker::Polygon(&[4.0, 1.33, 6.67]), 2),
        Scheme::Fixed(Integrator::Euler) => (RGBColor(204, 121, 167), Marker::Polygon(&[1.0, 3.0, 5.0, 7.0]), 2),
        Scheme::Fixed(Integrator::Verlet) => (RGBColor(86, 180, 233), Marker::Polygon(&[0.0, 2.0, 4.0, 6.0]), 2),
        Scheme::Fixed(Integrator::Rk4) => (RGBColor(0, 114, 178), Marker::Polygon(&[0.0, 2.67, 5.33]), 2),
        Scheme::Fixed(Integrator::Exponential) => (RGBColor(0, 158, 115), Marker::Disc, 3),
        Scheme::Controlled { .. } => {
            (RGBColor(0, 0, 0), Marker::Polygon(&[0.0, 0.8, 1.6, 2.4, 3.2, 4.0, 4.8, 5.6, 6.4, 7.2]), 2)
        }
    };
    Style { color, marker, width }
}

/// The diagram as an SVG file.
///
/// # Errors
/// What the drawing library says; none is known.
pub fn svg(reports: &[Report], machine: &Machine) -> Result<String, String> {
    let mut text = String::new();
    let columns = if reports.len() > 1 { 2 } else { 1 };
    let rows = reports.len().div_ceil(columns);
    let size = (PANEL.0 * columns as u32, HEADER + PANEL.1 * rows as u32 + FOOTER);
    let root = SVGBackend::with_string(&mut text, size).into_drawing_area();
    let drawn = draw(&root, reports, machine, (rows, columns)).and_then(|()| root.present());
    drop(root);
    drawn.map_err(|error| error.to_string())?;
    Ok(text)
}

fn draw<'a>(
    root: &Area<'a>,
    reports: &[Report],
    machine: &Machine,
    (rows, columns): (usize, usize),
) -> Result<(), Failure<'a>> {
    root.fill(&WHITE)?;
    let (header, below) = root.split_vertically(HEADER);
    let (panels, footer) = below.split_vertically(PANEL.1 * rows as u32);
    let names: Vec<&str> = reports.iter().map(|report| report.scene.as_str()).collect();
    let title = if let [only] = names.as_slice() {
        format!("Work and precision: {only}")
    } else {
        "Work and precision".to_owned()
    };
    write(&header, &title, (20, 32), 30.0, INK, HPos::Left)?;
    for (line, y) in [
        (
            "Down is more exact, left is faster. From point to point the step is halved, a ring marks the scene’s own.",
            64,
        ),
        (
            "Stars: the scene’s own step, divided where a tolerance asks for it, which is tightened from star to star.",
            90,
        ),
    ] {
        write(&header, line, (20, y), 18.0, GREY, HPos::Left)?;
    }

    let errors = error_range(reports);
    for (panel, report) in panels.split_evenly((rows, columns)).iter().zip(reports) {
        draw_panel(panel, report, errors.clone(), reports.len() > 1)?;
    }

    for (line, y) in [
        ("Error: the largest over time and vertices, against an independent solution.", 18),
        ("Run time: of the steps alone, on one thread; median of 5 runs or more.", 42),
        (machine.to_string().as_str(), 66),
    ] {
        write(&footer, line, (20, y), 17.0, GREY, HPos::Left)?;
    }
    Ok(())
}

/// Errors that are smaller are drawn here [radii].
fn floor(report: &Report) -> f64 {
    f64::max(FLOOR, report.resolution())
}

/// The same for all panels, so that they can be compared.
fn error_range(reports: &[Report]) -> Range<f64> {
    let errors = |report: &Report| {
        let floor = floor(report);
        report.measurements.iter().filter_map(move |it| Some(it.error?.max(floor))).collect::<Vec<f64>>()
    };
    let errors: Vec<f64> = reports.iter().flat_map(errors).collect();
    let smallest = errors.iter().copied().fold(1e-1, f64::min);
    let largest = errors.iter().copied().fold(1e-1, f64::max);
    smallest / 4.0..largest * 2.5
}

/// In ms, half as much again on either side.
fn time_range(report: &Report) -> Range<f64> {
    let times = || report.measurements.iter().map(|it| 1e3 * it.seconds).filter(|time| *time > 0.0);
    let (least, most) = (times().fold(f64::INFINITY, f64::min), times().fold(0.0, f64::max));
    if least <= most { least / 1.5..most * 1.5 } else { 0.1..10.0 }
}

fn draw_panel<'a>(panel: &Area<'a>, report: &Report, errors: Range<f64>, is_titled: bool) -> Result<(), Failure<'a>> {
    let times = time_range(report);
    let time_ticks = ticks(&times, if times.end / times.start < 1000.0 { &[1.0, 2.0, 5.0] } else { &[1.0] });
    let time_grid = ticks(&times, &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]);
    let error_ticks = ticks(&errors, &[1.0]);
    let mut chart = ChartBuilder::on(panel)
        .margin_top(TOP)
        .margin_left(MARGIN)
        .margin_right(RIGHT)
        .x_label_area_size(BOTTOM)
        .y_label_area_size(LEFT)
        .build_cartesian_2d(
            times.clone().log_scale().with_key_points(time_ticks).with_light_points(time_grid),
            errors.clone().log_scale().with_key_points(error_ticks),
        )?;
    chart
        .configure_mesh()
        .x_desc("run time [ms]")
        .y_desc("largest error [radii]")
        .axis_desc_style((FONT, 21).into_font().color(&INK))
        .label_style((FONT, 19).into_font().color(&INK))
        .x_label_formatter(&|time| time.to_string())
        .y_label_formatter(&|error| power_of_ten(*error))
        .bold_line_style(RGBColor(214, 214, 214))
        .light_line_style(RGBColor(240, 240, 240))
        .axis_style(GREY)
        .draw()?;
    if is_titled {
        let title = format!("{} ({} vertices)", report.scene, report.vertices);
        write(panel, &title, (LEFT as i32, TOP as i32 / 2), 24.0, INK, HPos::Left)?;
    }

    let origin = panel.get_base_pixel();
    let at = |time: f64, error: f64| {
        let (x, y) = chart.backend_coord(&(time, error));
        (x - origin.0, y - origin.1)
    };
    let right = at(times.end, errors.start).0;
    let floor = floor(report);
    if errors.start < floor {
        let (left, y) = at(times.start, floor);
        panel.draw(&PathElement::new([(left, y), (right, y)], GREY))?;
        let text = format!("{} and smaller", power_of_ten(floor));
        write(panel, &text, (left + 8, y + 12), 16.0, GREY, HPos::Left)?;
    }

    let mut ends = vec![];
    for line in report.measurements.chunk_by(|a, b| a.scheme.family() == b.scheme.family()) {
        let Some(first) = line.first() else { continue };
        let style = style(first.scheme);
        let point = |it: &Measurement| {
            let error = it.error.unwrap_or(errors.end).clamp(floor.max(errors.start), errors.end);
            at(1e3 * it.seconds, error)
        };
        let points: Vec<(i32, i32)> = line.iter().map(point).collect();
        panel.draw(&PathElement::new(points.clone(), style.color.stroke_width(style.width)))?;
        for (measurement, &point) in line.iter().zip(&points) {
            draw_marker(panel, style, point)?;
            if report.is_at_own_step(measurement) && matches!(measurement.scheme, Scheme::Fixed(_)) {
                panel.draw(&Circle::new(point, 11, style.color.stroke_width(2)))?;
            }
        }
        let is_thesis = first.scheme == Scheme::Fixed(Integrator::Thesis);
        let text = match first.scheme.family() {
            name if line.iter().any(|it| it.error.is_none()) => format!("{name} (out of bounds)"),
            name if is_thesis && report.thesis_stands_still().is_some() => format!("{name} (no convergence)"),
            name => name.to_owned(),
        };
        if let Some(&end) = points.last() {
            ends.push((end, text, style));
        }
    }
    draw_labels(panel, right, (f64::from(TOP), f64::from(PANEL.1 - BOTTOM)), ends)
}
