//! Shared parts of the diagrams: a sheet, logarithmic axes, lines with markers and with labels at their ends.

use std::{io, ops::Range};

use plotters::{
    coord::Shift,
    prelude::*,
    style::text_anchor::{HPos, Pos, VPos},
};

/// Space above axes without a title, and below them [px].
pub const TOP: u32 = 16;
const BOTTOM: u32 = 66;
/// Space left of the axes, and left of the title of the vertical axis [px].
pub const LEFT: u32 = 84;
const MARGIN: u32 = 14;
/// Height of the heading above the panels, and of a line of the notes below them [px].
const HEADER: u32 = 108;
const NOTE: u32 = 24;
/// Vertical distance between labels [px].
const LABEL_HEIGHT: f64 = 20.0;
const FONT: &str = "sans-serif";
pub const INK: RGBColor = RGBColor(34, 34, 34);
pub const GREY: RGBColor = RGBColor(110, 110, 110);

pub type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
pub type Failure = DrawingAreaErrorKind<io::Error>;

/// A diagram with its heading and notes.
pub struct Sheet<'t> {
    /// Size of the area between heading and notes [px].
    pub size: (u32, u32),
    pub title: &'t str,
    pub heading: [&'t str; 2],
    pub notes: &'t [&'t str],
}

impl Sheet<'_> {
    /// Renders the diagram as an SVG file.
    ///
    /// # Errors
    /// Errors of the drawing library; none is known to occur.
    pub fn svg(&self, draw: impl FnOnce(&Area<'_>) -> Result<(), Failure>) -> Result<String, String> {
        let mut text = String::new();
        let (width, height) = self.size;
        let size = (width, HEADER + height + NOTE * self.notes.len() as u32 + TOP);
        let root = SVGBackend::with_string(&mut text, size).into_drawing_area();
        let drawn = self.draw(&root, draw).and_then(|()| root.present());
        drop(root);
        drawn.map_err(|error| error.to_string())?;
        Ok(text)
    }

    fn draw(&self, root: &Area<'_>, draw: impl FnOnce(&Area<'_>) -> Result<(), Failure>) -> Result<(), Failure> {
        root.fill(&WHITE)?;
        let (header, below) = root.split_vertically(HEADER);
        let (panels, footer) = below.split_vertically(self.size.1);
        write(&header, self.title, (20, 32), 30.0, INK)?;
        for (line, y) in self.heading.into_iter().zip([64, 90]) {
            write(&header, line, (20, y), 18.0, GREY)?;
        }
        for (line, k) in self.notes.iter().zip(0..) {
            write(&footer, line, (20, 18 + NOTE as i32 * k), 17.0, GREY)?;
        }
        draw(&panels)
    }
}

/// A logarithmic axis of a panel.
pub struct Axis<'t> {
    pub name: &'t str,
    pub range: Range<f64>,
    /// Numbered ticks, with grid lines.
    pub ticks: Vec<f64>,
    /// Grid lines without a number.
    pub grid: Vec<f64>,
    pub number: fn(&f64) -> String,
}

impl<'t> Axis<'t> {
    /// Run times in ms, with a margin on either side of all `times`.
    pub fn of_run_times(times: impl Iterator<Item = f64> + Clone) -> Axis<'t> {
        const MARGIN: f64 = 1.5;
        let times = times.filter(|&time| time > 0.0);
        let (min, max) = (times.clone().fold(f64::INFINITY, f64::min), times.fold(0.0, f64::max));
        let range = if min <= max { min / MARGIN..max * MARGIN } else { 0.1..10.0 };
        let multiples: &[f64] = if range.end / range.start < 1000.0 { &[1.0, 2.0, 5.0] } else { &[1.0] };
        Axis {
            name: "run time [ms]",
            ticks: ticks(&range, multiples),
            grid: ticks(&range, &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]),
            range,
            number: f64::to_string,
        }
    }

    /// Powers of ten.
    pub fn of_errors(name: &'t str, range: Range<f64>) -> Axis<'t> {
        let number = |&error: &f64| power_of_ten(error);
        Axis { name, ticks: ticks(&range, &[1.0]), range, grid: vec![], number }
    }
}

/// A range that contains `errors` and a tenth of a radius, with a margin.
pub fn error_range(errors: impl Iterator<Item = f64> + Clone) -> Range<f64> {
    errors.clone().fold(1e-1, f64::min) / 4.0..errors.fold(1e-1, f64::max) * 2.5
}

/// Draws two axes, inset from the top and the right end of `panel` [px]. Returns the mapping from a data point to its
/// position on the panel [px].
pub fn draw_axes(
    panel: &Area<'_>,
    top: u32,
    right: u32,
    [x, y]: [Axis<'_>; 2],
) -> Result<impl Fn(f64, f64) -> (i32, i32), Failure> {
    let scale = |axis: Axis<'_>| axis.range.log_scale().with_key_points(axis.ticks).with_light_points(axis.grid);
    let ((x_name, x_number), (y_name, y_number)) = ((x.name, x.number), (y.name, y.number));
    let mut chart = ChartBuilder::on(panel)
        .margin_top(top)
        .margin_left(MARGIN)
        .margin_right(right)
        .x_label_area_size(BOTTOM)
        .y_label_area_size(LEFT)
        .build_cartesian_2d(scale(x), scale(y))?;
    chart
        .configure_mesh()
        .x_desc(x_name)
        .y_desc(y_name)
        .axis_desc_style((FONT, 21).into_font().color(&INK))
        .label_style((FONT, 19).into_font().color(&INK))
        .x_label_formatter(&x_number)
        .y_label_formatter(&y_number)
        .bold_line_style(RGBColor(214, 214, 214))
        .light_line_style(RGBColor(240, 240, 240))
        .axis_style(GREY)
        .draw()?;
    let origin = panel.get_base_pixel();
    Ok(move |x, y| {
        let (x, y) = chart.backend_coord(&(x, y));
        (x - origin.0, y - origin.1)
    })
}

/// A line of a diagram, in panel coordinates [px].
pub struct Line {
    pub name: String,
    pub style: Style,
    pub points: Vec<(i32, i32)>,
}

/// The style of a line.
#[derive(Clone, Copy)]
pub struct Style {
    /// Colour of the line and its markers.
    pub color: RGBColor,
    /// Shape of the marker at each point.
    pub marker: Marker,
    /// Width of the line [px].
    pub width: u32,
}

#[derive(Clone, Copy)]
pub enum Marker {
    Cross,
    Disc,
    /// A polygon with corners at these angles [eighths of a turn], clockwise from the top.
    Polygon(&'static [f64]),
}

/// The given multiples of powers of ten within `range`.
pub fn ticks(range: &Range<f64>, multiples: &[f64]) -> Vec<f64> {
    let decades = range.start.log10().floor() as i32..=range.end.log10().ceil() as i32;
    let all = decades.flat_map(|decade| multiples.iter().map(move |multiple| multiple * 10f64.powi(decade)));
    all.filter(|&tick| tick >= 0.999 * range.start && tick <= 1.001 * range.end).collect()
}

/// Draws lines with markers, and their names in a column right of the axes, which end at `right`. Each name is placed
/// as close to the end of its line as the other names allow.
pub fn draw_lines(panel: &Area<'_>, top: u32, right: i32, mut lines: Vec<Line>) -> Result<(), Failure> {
    lines.retain(|line| !line.points.is_empty());
    for Line { points, style, .. } in &lines {
        panel.draw(&PathElement::new(points.clone(), style.color.stroke_width(style.width)))?;
        points.iter().try_for_each(|&point| draw_marker(panel, *style, point))?;
    }
    let end = |line: &Line| line.points.last().copied().unwrap_or_default();
    lines.sort_by_key(|line| (end(line).1, end(line).0));
    let wanted: Vec<f64> = lines.iter().map(|line| f64::from(end(line).1)).collect();
    let limits = (f64::from(top), f64::from(panel.dim_in_pixel().1 - BOTTOM));
    for ((line, y), k) in lines.iter().zip(spread(&wanted, limits)).zip(0..) {
        let y = y.round() as i32;
        let elbow = right + 10 + 4 * (k % 3);
        panel.draw(&PathElement::new([end(line), (elbow, y), (right + 28, y)], line.style.color.mix(0.45)))?;
        draw_marker(panel, line.style, (right + 28, y))?;
        write(panel, &line.name, (right + 40, y), 19.0, line.style.color)?;
    }
    Ok(())
}

/// Heights close to those `wanted` (ascending), within `limits`, and at least a label's height apart.
fn spread(wanted: &[f64], limits: (f64, f64)) -> Vec<f64> {
    // clusters of touching labels, each as (sum over its labels of the first label's height that each wants, labels)
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

fn draw_marker(panel: &Area<'_>, style: Style, (x, y): (i32, i32)) -> Result<(), Failure> {
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

/// Writes a line of text that starts at a point and is vertically centred on it.
pub fn write(area: &Area<'_>, text: &str, at: (i32, i32), size: f64, color: RGBColor) -> Result<(), Failure> {
    // characters that XML does not allow
    let text: String = text.chars().map(|c| if c.is_control() { '\u{fffd}' } else { c }).collect();
    let style = (FONT, size).into_font().color(&color).pos(Pos::new(HPos::Left, VPos::Center));
    area.draw(&Text::new(text, at, style))
}

/// A power of ten as "10⁻³".
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
