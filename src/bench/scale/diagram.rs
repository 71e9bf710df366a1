//! Cost against scene size: step time against the number of bodies, one line per family.

use std::ops::Range;

use plotters::style::RGBColor;

use super::{Point, Report, scenes::Family};
use crate::bench::{
    drawing::{Axis, Line, Marker, Sheet, Style, TOP, draw_axes, draw_lines, power_of_ten, ticks},
    machine::Machine,
};

/// Space right of the axes [px].
const RIGHT: u32 = 330;

/// The style of a family: a colour distinguishable with any colour vision (Okabe & Ito 2008), and its own marker. The
/// naive baseline has the colour of its family.
fn style(family: Family, is_plain: bool) -> Style {
    let (color, marker) = match family {
        Family::Contact => (RGBColor(213, 94, 0), Marker::Polygon(&[0.0, 2.67, 5.33])),
        Family::Hundredth => (RGBColor(0, 114, 178), Marker::Polygon(&[1.0, 3.0, 5.0, 7.0])),
        Family::Rest => (RGBColor(0, 158, 115), Marker::Disc),
    };
    if is_plain { Style { color, marker: Marker::Cross, width: 1 } } else { Style { color, marker, width: 3 } }
}

/// Renders the diagram as an SVG file.
///
/// # Errors
/// Errors of the drawing library; none is known to occur.
pub fn svg(report: &Report, machine: &Machine) -> Result<String, String> {
    let machine = format!("{}, 1 of {} cores used; meldscope {}", machine.cpu, machine.cores, machine.version);
    let sheet = Sheet {
        size: (1100, 602),
        title: "Cost and size",
        heading: [
            "Time of a step against the number of bodies, 266 vertices each, on one core: down is faster.",
            "Crosses: the naive baseline, the thesis’s scheme with every vertex, as far as it was measured.",
        ],
        notes: &["Run times: the best of 9 blocks of steps, or of 3 long ones.", &machine],
    };
    let curves = curves(report);
    let all = curves.iter().flat_map(|curve| &curve.points);
    let (bodies, times) = (range(all.clone().map(|point| point.0), 1.5), range(all.map(|point| point.1), 2.0));
    let axis = |name, range: Range<f64>| Axis {
        name,
        ticks: ticks(&range, &[1.0]),
        range,
        grid: vec![],
        number: |&x| power_of_ten(x),
    };
    sheet.svg(|panel| {
        let axes = [axis("bodies", bodies.clone()), axis("time of a step [ms]", times.clone())];
        let at = draw_axes(panel, TOP, RIGHT, axes)?;
        let line = |Curve { family, is_plain, points }: &Curve| Line {
            name: format!("{}{}", family.name(), if *is_plain { ", plain" } else { "" }),
            style: style(*family, *is_plain),
            points: points.iter().map(|&(bodies, time)| at(bodies, time)).collect(),
        };
        draw_lines(panel, TOP, at(bodies.end, times.start).0, curves.iter().map(line).collect())
    })
}

/// A family, with skipping or as the naive baseline.
struct Curve {
    family: Family,
    is_plain: bool,
    /// Numbers of bodies, and step time [ms].
    points: Vec<(f64, f64)>,
}

fn curves(report: &Report) -> Vec<Curve> {
    let curve = |family, is_plain: bool| {
        let run = |point: &Point| -> Option<f64> {
            Some(if is_plain { point.plain.as_ref()?.run.seconds } else { point.one.seconds })
        };
        let point = |point: &Point| Some((point.bodies as f64, 1e3 * run(point)?));
        Curve {
            family,
            is_plain,
            points: report.of(family).filter_map(point).filter(|(_, time)| *time > 0.0).collect(),
        }
    };
    Family::ALL.into_iter().flat_map(|family| [curve(family, false), curve(family, true)]).collect()
}

/// The range of the values, widened by the factor `margin` on either side.
fn range(values: impl Iterator<Item = f64> + Clone, margin: f64) -> Range<f64> {
    let (min, max) = (values.clone().fold(f64::INFINITY, f64::min), values.fold(0.0, f64::max));
    if min <= max { min / margin..max * margin } else { 1.0..10.0 }
}
