//! The map as a recording for the Rerun viewer.

use std::{cmp::Ordering, path::Path};

use super::{
    Sweep,
    classes::{self, FAILED},
    design::Axis,
    map::{MAX_DOTS, Map, Slice, boundary, missable, regions, ticks, written},
    row::Cell,
    store::{Store, StoreError},
};
use crate::{
    scene::template::Setting,
    sdk::{
        self, ApplicationId, Image, LineStrips2D, Points2D, Radius, StoreId, StoreKind, TextDocument, TimePoint,
        Timeline, components::MediaType,
    },
    stream::{
        blueprint,
        chunks::Chunks,
        contract::{ABOUT, MAP, MEASURE, RECORDING_INFO, SLICE},
        palette::{self, Rgb, color},
        settings::{application, file_stem},
        sinks::{Destinations, Saved, SinkError, Sinks},
    },
    svg::{self, INK},
    text::{counted, short, thousands},
};

/// Size of the map [px].
const WIDTH: usize = 840;
const HEIGHT: usize = 600;
/// Height of a line of text in a diagram, and how far below its point a label stands, in a window of usual size [px of the
/// map].
const LINE: f32 = 44.0;
const LABEL_BELOW: f32 = 24.0;
const AXIS: Rgb = [120, 120, 120];
/// Measures to plot, if the sweep has them.
const MEASURES: [&str; 5] = ["closest", "time_merged", "first_merge", "energy_by_events", "max_displacement"];

/// Why a map could not be written.
#[derive(Debug, thiserror::Error)]
pub enum PictureError {
    /// The rows cannot be read.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The recording cannot be written.
    #[error(transparent)]
    Sink(#[from] SinkError),
}

/// Writes the recording of a map; `open` is the command that records a run.
///
/// # Errors
/// The rows cannot be read, or the file cannot be written.
pub fn save(
    map: &Map,
    sweep: &Sweep,
    store: &Store,
    title: &str,
    open: &str,
    path: &Path,
) -> Result<Option<Saved>, PictureError> {
    let destinations = Destinations::file(path);
    let mut sinks = Sinks::open(&destinations)?;
    let id = ApplicationId::new_or_unknown(application("map"));
    let recording = StoreId::new(StoreKind::Recording, id, format!("map-{}", file_stem(&sweep.file)));
    let mut measures: Vec<&str> =
        MEASURES.into_iter().filter(|name| store.columns().iter().any(|column| column.name == *name)).collect();
    measures.sort_by_key(|name| *name != map.color); // the first is in front
    for message in blueprint::of_map(&measures, &recording, [WIDTH as f64, HEIGHT as f64]) {
        sinks.send(message)?;
    }
    let mut chunks = Chunks::new(recording);
    chunks.log_static(RECORDING_INFO.path, &sdk::RecordingInfo::new().with_name(title));
    let outcomes: String = (0..=FAILED)
        .filter(|class| map.slices.iter().any(|slice| slice.shows(*class)))
        .map(|class| {
            let about = map.classes.about(class);
            let about = if about.is_empty() { String::new() } else { format!(": {about}") };
            format!("- {} **{}**{about}\n", classes::color(class).1, map.classes.name(class))
        })
        .collect();
    let axes: Vec<String> = map.axes.iter().map(|axis| format!("**{}**", axis.label())).collect();
    let directions = ["to the right", "upwards"];
    let axes: Vec<String> =
        axes.iter().zip(directions).map(|(axis, direction)| format!("{axis} {direction}")).collect();
    let colored = match map.range {
        Some([low, high]) => {
            format!("Map: **{}** from {low:.3} (dark) to {high:.3} (yellow). Points:\n", map.color)
        }
        None => String::new(),
    };
    let lines = if map.is_grid { "Lines are midway between runs of different outcome. " } else { "" };
    let dots = match map.slices.iter().any(|slice| !slice.thresholds.is_empty()) {
        true => "Black points: where it changes, bisected to 1e-9. ",
        false => "",
    };
    let recorded = if sweep.experiment.is_none() { format!(", and record it: `{open}`") } else { String::new() };
    let is_cut = map.slices.iter().any(Slice::is_cut);
    let cut = if is_cut { format!(" (the first {} of a map)", thousands(MAX_DOTS as u64)) } else { String::new() };
    let undecided = map.about_undecided().map_or(String::new(), |text| format!("{text}. "));
    let about = format!(
        "**{title}**: {}; {}. Point at a run{cut} to see its row{recorded}\n\n{colored}{outcomes}\n{lines}{dots}{undecided}Note: \
         {}.",
        counted(map.rows, "run"),
        axes.join(", "),
        missable(&sweep.design),
    );
    chunks.log_static(ABOUT.path, &TextDocument::new(about).with_media_type(MediaType::MARKDOWN));
    log_ticks(&mut chunks, map);
    for (number, slice) in map.slices.iter().enumerate() {
        let at = TimePoint::from_iter([(Timeline::new_sequence(SLICE), number as i64)]);
        log_slice(&mut chunks, map, slice, &at);
    }
    log_along(&mut chunks, map, sweep, store, &measures)?;
    for message in chunks.take() {
        sinks.send(message)?;
    }
    Ok(sinks.finish()?.save)
}

/// Position on the image [px], given fractions of the axes.
fn pixel([x, y]: [f64; 2]) -> [f32; 2] {
    [(x * WIDTH as f64) as f32, ((1.0 - y) * HEIGHT as f64) as f32]
}

fn log_slice(chunks: &mut Chunks, map: &Map, slice: &Slice, at: &TimePoint) {
    if map.is_grid {
        let index = |side: usize, share: f64| {
            slice.edges[side].partition_point(|edge| *edge <= share).clamp(1, slice.size[side]) - 1
        };
        let columns: Vec<usize> = (0..WIDTH).map(|x| index(0, (x as f64 + 0.5) / WIDTH as f64)).collect();
        let mut pixels = Vec::with_capacity(3 * WIDTH * HEIGHT);
        for y in 0..HEIGHT {
            let row = index(1, 1.0 - (y as f64 + 0.5) / HEIGHT as f64);
            for column in &columns {
                pixels.extend(map.color(slice, row * slice.size[0] + column));
            }
        }
        chunks.row(&MAP.of(&["regions"]), at.clone(), &Image::from_rgb24(pixels, [WIDTH as u32, HEIGHT as u32]));
        let lines: Vec<[[f32; 2]; 2]> =
            boundary(slice).into_iter().map(|[from, to]| [pixel(from), pixel(to)]).collect();
        let lines =
            LineStrips2D::new(lines).with_colors([color([30, 30, 30])]).with_radii([Radius::new_ui_points(0.9)]);
        chunks.row(&MAP.of(&["boundary"]), at.clone(), &lines.with_draw_order(10.0));
        let regions = regions(slice);
        let place = |at: [f64; 2]| {
            let [x, y] = pixel(at);
            [x, y - LABEL_BELOW]
        };
        let names = Points2D::new(regions.iter().map(|&(_, at)| place(at)))
            .with_labels(regions.iter().map(|&(class, _)| map.classes.name(class)))
            .with_show_labels(true)
            .with_colors([color([255; 3])])
            .with_radii([Radius::new_ui_points(0.1)])
            .with_draw_order(40.0);
        chunks.row(&MAP.of(&["names"]), at.clone(), &names);
    }
    // on areas of their own colour they would not be seen
    let shade = if map.range.is_none() { 2 } else { 1 };
    let points = Points2D::new(slice.dots.iter().map(|dot| pixel(dot.at)))
        .with_colors(slice.dots.iter().map(|dot| color(classes::color(dot.class).0.map(|c| c / shade))))
        .with_labels(slice.dots.iter().map(|dot| dot.label.as_str()))
        .with_show_labels(false)
        .with_radii([Radius::new_ui_points(if slice.dots.len() > 2000 { 0.8 } else { 2.0 })])
        .with_draw_order(20.0);
    chunks.row(&MAP.of(&["runs"]), at.clone(), &points);
    if !slice.thresholds.is_empty() {
        let thresholds = Points2D::new(slice.thresholds.iter().map(|&at| pixel(at)))
            .with_colors([color(INK)])
            .with_radii([Radius::new_ui_points(2.5)])
            .with_draw_order(30.0);
        chunks.row(&MAP.of(&["thresholds"]), at.clone(), &thresholds);
    }
    if slice.title.is_empty() {
        return;
    }
    let title = Points2D::new([[0.75 * WIDTH as f32, -50.0]])
        .with_labels([slice.title.as_str()])
        .with_show_labels(true)
        .with_radii([Radius::new_ui_points(0.1)]);
    chunks.row(&MAP.of(&["title"]), at.clone(), &title);
}

fn log_ticks(chunks: &mut Chunks, map: &Map) {
    let of = |side: usize| map.axes.get(side).map_or_else(Vec::new, ticks);
    let label = |side: usize| map.axes.get(side).map_or_else(String::new, Axis::label);
    log_axes(chunks, &MAP.of(&["ticks"]), [of(0), of(1)], [&label(0), &upwards(&label(1))]);
}

/// The name of a vertical axis that stands above it.
fn upwards(name: &str) -> String {
    if name.is_empty() { String::new() } else { format!("↑ {name}") }
}

/// Logs the ticks of two axes with their numbers, below and on the left, and the names of the axes, the second one on top.
fn log_axes(chunks: &mut Chunks, entity: &str, ticks: [Vec<(f64, String)>; 2], names: [&str; 2]) {
    /// Length of a tick [px].
    const TICK: f32 = 7.0;

    let [[left, bottom], [right, top]] = [[0.0, 0.0], [1.0, 1.0]].map(pixel);
    let mut lines = vec![vec![[left, top], [left, bottom], [right, bottom]]];
    let (mut positions, mut labels) = (Vec::new(), Vec::new());
    for (side, ticks) in ticks.into_iter().enumerate() {
        for (share, number) in ticks {
            let [x, y] = pixel(if side == 0 { [share, 0.0] } else { [0.0, share] });
            lines.push(vec![[x, y], if side == 0 { [x, y + TICK] } else { [x - TICK, y] }]);
            positions.push(if side == 0 { [x, y + 12.0] } else { [x - 42.0, y - LABEL_BELOW] });
            labels.push(number);
        }
    }
    let above = names[1].split('\n').count();
    // one line near its axis, several in the middle of the view, which they fill
    let at = [if above > 1 { 0.47 * right } else { 0.25 * right }, top - 8.0 - above as f32 * LINE];
    for (name, at) in names.into_iter().zip([[0.5 * right, bottom + 56.0], at]) {
        if !name.is_empty() {
            positions.push(at);
            labels.push(name.to_owned());
        }
    }
    let ticks = Points2D::new(positions)
        .with_labels(labels)
        .with_show_labels(true)
        .with_colors([color(AXIS)])
        .with_radii([Radius::new_ui_points(0.1)]);
    chunks.log_static(entity, &ticks);
    let lines = LineStrips2D::new(lines).with_colors([color(AXIS)]).with_radii([Radius::new_ui_points(0.8)]);
    chunks.log_static(entity, &lines);
}

/// A value in few digits.
fn brief(value: &Setting) -> String {
    match value {
        Setting::Number(number) => written(short(*number).parse().unwrap_or(*number)),
        Setting::Text(_) => value.to_string(),
    }
}

/// Logs measures along the first axis, for three values of the second and the first value of all others.
fn log_along(
    chunks: &mut Chunks,
    map: &Map,
    sweep: &Sweep,
    store: &Store,
    measures: &[&str],
) -> Result<(), StoreError> {
    let design = &sweep.design;
    let find = |axis: &Axis| design.axes.iter().position(|other| other.key == axis.key);
    let Some(first) = map.axes.first().and_then(find).filter(|_| map.is_grid) else { return Ok(()) };
    let second = map.axes.get(1).and_then(find);
    let last = second.and_then(|axis| design.axes[axis].count(0)).unwrap_or(1) - 1;
    let mut lines = vec![0, last / 2, last];
    lines.dedup();
    let columns = store.named(measures);
    // values of the measures by line and place along the axis
    let mut values: Vec<(usize, f64, Vec<Cell>)> = Vec::new();
    store.read(0..1, None, &columns, |(row, cells)| {
        let Some(place) = design.place(row).filter(|place| place.level == 0) else { return };
        let is_first =
            (0..place.index.len()).all(|axis| axis == first || Some(axis) == second || place.index[axis] == 0);
        let line = lines.iter().position(|known| *known == second.map_or(0, |axis| place.index[axis]));
        let Setting::Number(at) = design.axes[first].value(0, place.index[first]) else { return };
        if let (true, Some(line)) = (is_first, line) {
            values.push((line, design.axes[first].share(at), cells));
        }
    })?;
    values.sort_by(|x, y| (x.0, x.1).partial_cmp(&(y.0, y.1)).unwrap_or(Ordering::Equal));
    for (k, (measure, column)) in measures.iter().zip(columns.iter().skip(1)).enumerate() {
        let known = |cells: &[Cell]| match cells.get(k) {
            Some(Cell::Float(value)) if value.is_finite() => Some(*value),
            _ => None,
        };
        let all = || values.iter().filter_map(|(.., cells)| known(cells));
        let [low, high] = [all().fold(f64::INFINITY, f64::min), all().fold(f64::NEG_INFINITY, f64::max)];
        let share = |value: f64| if high > low { (value - low) / (high - low) } else { 0.5 };
        // what each line has at its right end
        let mut ends: Vec<(f32, usize)> = Vec::new();
        for line in 0..lines.len() {
            // a run without a value interrupts the line
            let of_line: Vec<&(usize, f64, Vec<Cell>)> = values.iter().filter(|(of, ..)| *of == line).collect();
            let parts = of_line.split(|(.., cells)| known(cells).is_none()).filter(|part| !part.is_empty());
            let parts: Vec<Vec<[f32; 2]>> = parts
                .map(|part| {
                    part.iter().map(|(_, at, cells)| pixel([*at, share(known(cells).unwrap_or(low))])).collect()
                })
                .collect();
            ends.extend(parts.last().and_then(|part| part.last()).map(|[_, y]| (*y, line)));
            let lines = LineStrips2D::new(parts)
                .with_colors([color(palette::line(line))])
                .with_radii([Radius::new_ui_points(1.2)]);
            chunks.log_static(&MEASURE.of(&[measure, &line.to_string()]), &lines);
        }
        let mut above = column.about.replacen(", ", ",\n", 1);
        if let Some(axis) = second.map(|axis| &design.axes[axis]) {
            above += &format!("\nnumbers at the right: {}", axis.label());
            // labels of lines that end close together stand one above the other
            ends.sort_by(|x, y| y.0.total_cmp(&x.0));
            let mut lowest = f32::INFINITY;
            for (y, line) in ends {
                lowest = f32::min(y, lowest - LINE);
                let label = Points2D::new([[WIDTH as f32 + 44.0, lowest - LABEL_BELOW]])
                    .with_labels([brief(&axis.value(0, lines[line]))])
                    .with_show_labels(true)
                    .with_colors([color(palette::line(line))])
                    .with_radii([Radius::new_ui_points(0.1)]);
                chunks.log_static(&MEASURE.of(&[measure, &line.to_string()]), &label);
            }
        }
        let heights = svg::ticks([low, high], false).into_iter().map(|value| (share(value), written(value)));
        let across = ticks(&design.axes[first]);
        log_axes(
            chunks,
            &MEASURE.of(&[measure, "ticks"]),
            [across, heights.collect()],
            [&design.axes[first].label(), &upwards(&above)],
        );
    }
    Ok(())
}
