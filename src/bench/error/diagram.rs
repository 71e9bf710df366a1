//! The work-precision diagram: error against run time, one panel per scene, one line per integrator, and one for error
//! control in an [earlier version](before). The last panel shows actual against requested errors, one line per scene.

use std::ops::Range;

use plotters::{
    element::{Circle, PathElement},
    style::{Color as _, RGBColor},
};

use super::{Measurement, Report, Scheme, before};
use crate::{
    bench::{
        drawing::{
            Area, Axis, Failure, GREY, INK, LEFT, Line, Marker, Sheet, Style, draw_axes, draw_lines, error_range,
            power_of_ten, write,
        },
        machine::Machine,
    },
    scene::Integrator,
};

/// Size of a panel, labels included [px].
const PANEL: (u32, u32) = (900, 620);
/// Margins around the axes of a panel [px].
const TOP: u32 = 46;
const RIGHT: u32 = 246;
/// The smallest error drawn, unless the reference resolves less [radii].
const FLOOR: f64 = 1e-12;

/// A style per scheme: colours distinguishable with any colour vision (Okabe & Ito 2008), and distinct markers.
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

/// Renders the diagram as an SVG file.
///
/// # Errors
/// Errors of the drawing library; none is known to occur.
pub fn svg(reports: &[Report], machine: &Machine) -> Result<String, String> {
    let has_control = reports.iter().any(|report| report.allowed_and_actual().len() > 1);
    let panels = reports.len() + usize::from(has_control);
    let columns = usize::min(panels, 2);
    let rows = panels.div_ceil(columns);
    let title = match reports {
        [only] => format!("Work and precision: {}", only.scene),
        _ => "Work and precision".to_owned(),
    };
    let mut notes = vec![
        "Error: the largest over time and vertices, relative to an independent solution.".to_owned(),
        "Run time: of the steps alone, on one thread; median of 5 runs or more.".to_owned(),
        machine.to_string(),
    ];
    if reports.iter().any(|report| !before::curve(report).is_empty()) {
        let note = format!(
            "Grey: the stars’ curve at commit {}, with run times scaled by those of rk4 at the scene’s own step.",
            before::COMMIT
        );
        notes.insert(2, note);
    }
    let sheet = Sheet {
        size: (PANEL.0 * columns as u32, PANEL.1 * rows as u32),
        title: &title,
        heading: [
            "Lower is more accurate, left is faster. Each point halves the step of the previous one; a ring marks the scene’s own.",
            "Stars: steps as long as the tolerance permits; each star has a tighter tolerance.",
        ],
        notes: &notes.iter().map(String::as_str).collect::<Vec<_>>(),
    };
    // the same range for all panels, so that they can be compared
    let errors: Vec<f64> = reports
        .iter()
        .flat_map(|report| report.measurements.iter().filter_map(|it| Some(it.error?.max(floor(report)))))
        .collect();
    let errors = error_range(errors.into_iter());
    sheet.svg(|panels| {
        let panels = panels.split_evenly((rows, columns));
        for (panel, report) in panels.iter().zip(reports) {
            draw_panel(panel, report, errors.clone(), columns > 1)?;
        }
        match panels.get(reports.len()) {
            Some(panel) if has_control => draw_control(panel, reports),
            _ => Ok(()),
        }
    })
}

/// Actual against requested errors.
fn draw_control(panel: &Area<'_>, reports: &[Report]) -> Result<(), Failure> {
    const COLORS: [RGBColor; 6] = [
        RGBColor(0, 158, 115),
        RGBColor(0, 114, 178),
        RGBColor(213, 94, 0),
        RGBColor(204, 121, 167),
        RGBColor(230, 159, 0),
        RGBColor(86, 180, 233),
    ];
    let all = || reports.iter().flat_map(Report::allowed_and_actual);
    let floor = |actual: f64| actual.max(FLOOR);
    let allowed =
        all().fold(1.0..0.0, |range, (allowed, _)| f64::min(range.start, allowed)..f64::max(range.end, allowed));
    let actual = all().fold(allowed.clone(), |range, (_, actual)| {
        f64::min(range.start, floor(actual))..f64::max(range.end, floor(actual))
    });
    let (allowed, actual) = (allowed.start / 2.0..allowed.end * 2.0, actual.start / 4.0..actual.end * 4.0);
    let axes = [("error allowed by the tolerance [radii]", &allowed), ("actual error [radii]", &actual)];
    let at = draw_axes(panel, TOP, RIGHT, axes.map(|(name, range)| Axis::of_errors(name, range.clone())))?;
    write(panel, "Requested and actual error", (LEFT as i32, TOP as i32 / 2), 24.0, INK)?;
    for (share, name) in [(1.0, "as allowed"), (0.01, "a hundredth")] {
        let inside = |x: f64| (x * share).clamp(actual.start, actual.end) / share;
        let [from, to] = [allowed.start, allowed.end].map(|x| at(inside(x), inside(x) * share));
        panel.draw(&PathElement::new([from, to], GREY))?;
        write(panel, name, (from.0 + 8, from.1 - 14), 16.0, GREY)?;
    }
    let right = at(allowed.end, actual.start).0;
    let line = |(index, report): (usize, &Report)| Line {
        name: report.scene.clone(),
        style: Style { color: COLORS[index % COLORS.len()], marker: Marker::Disc, width: 2 },
        points: report.allowed_and_actual().into_iter().map(|(allowed, actual)| at(allowed, floor(actual))).collect(),
    };
    draw_lines(panel, TOP, right, reports.iter().enumerate().map(line).collect())
}

/// Smaller errors are drawn at this value [radii].
fn floor(report: &Report) -> f64 {
    f64::max(FLOOR, report.resolution())
}

fn draw_panel(panel: &Area<'_>, report: &Report, errors: Range<f64>, is_titled: bool) -> Result<(), Failure> {
    let before = before::curve(report);
    let times = report.measurements.iter().map(|it| it.seconds).chain(before.iter().map(|&(seconds, _)| seconds));
    let time_axis = Axis::of_run_times(times.map(|seconds| 1e3 * seconds));
    let times = time_axis.range.clone();
    let at = draw_axes(panel, TOP, RIGHT, [time_axis, Axis::of_errors("largest error [radii]", errors.clone())])?;
    if is_titled {
        let title = format!("{} ({} vertices)", report.scene, report.vertices);
        write(panel, &title, (LEFT as i32, TOP as i32 / 2), 24.0, INK)?;
    }
    let right = at(times.end, errors.start).0;
    let floor = floor(report);
    if errors.start < floor {
        let (left, y) = at(times.start, floor);
        panel.draw(&PathElement::new([(left, y), (right, y)], GREY))?;
        write(panel, &format!("{} and smaller", power_of_ten(floor)), (left + 8, y + 12), 16.0, GREY)?;
    }

    let position = |seconds: f64, error: f64| at(1e3 * seconds, error.clamp(floor.max(errors.start), errors.end));
    let point = |it: &Measurement| position(it.seconds, it.error.unwrap_or(errors.end));
    let line = |measurements: &[Measurement]| {
        let scheme = measurements.first()?.scheme;
        let is_thesis = scheme == Scheme::Fixed(Integrator::Thesis);
        let name = match scheme.family() {
            name if measurements.iter().any(|it| it.error.is_none()) => format!("{name} (out of bounds)"),
            name if is_thesis && report.thesis_stagnation().is_some() => format!("{name} (no convergence)"),
            name => name.to_owned(),
        };
        Some(Line { name, style: style(scheme), points: measurements.iter().map(point).collect() })
    };
    let families = report.measurements.chunk_by(|a, b| a.scheme.family() == b.scheme.family());
    let earlier = Line {
        name: format!("exponential, {}", before::COMMIT),
        style: Style { color: GREY, ..style(Scheme::Controlled { tolerance: report.tolerance }) },
        points: before.iter().map(|&(seconds, error)| position(seconds, error)).collect(),
    };
    draw_lines(panel, TOP, right, families.filter_map(line).chain([earlier]).collect())?;
    for it in report.measurements.iter().filter(|it| report.is_at_own_step(it)) {
        if matches!(it.scheme, Scheme::Fixed(_)) {
            panel.draw(&Circle::new(point(it), 11, style(it.scheme).color.stroke_width(2)))?;
        }
    }
    Ok(())
}
