//! The map as a recording for the Rerun viewer.

use std::path::Path;

use super::{
    Sweep,
    classes::{self, FAILED},
    map::{MISSABLE, Map, Slice, boundary, ticks},
    row::Cell,
    store::{Store, StoreError},
};
use crate::{
    sdk::{
        self, ApplicationId, Image, LineStrips2D, Points2D, Radius, Scalars, StoreId, StoreKind, TextDocument,
        TimePoint, Timeline, components::MediaType,
    },
    stream::{
        blueprint,
        chunks::Chunks,
        contract::{ABOUT, ALONG, MAP, MEASURE, RECORDING_INFO, SLICE},
        palette::{self, color},
        series::{Interpolation, Series},
        settings::{application, file_stem},
        sinks::{Destinations, Saved, SinkError, Sinks},
    },
    text::counted,
};

/// Size of the map [px].
const WIDTH: usize = 840;
const HEIGHT: usize = 600;
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

/// Writes the recording of a map.
///
/// # Errors
/// The rows cannot be read, or the file cannot be written.
pub fn save(map: &Map, sweep: &Sweep, store: &Store, title: &str, path: &Path) -> Result<Option<Saved>, PictureError> {
    let destinations = Destinations { save: Some(path.to_owned()), ..Destinations::default() };
    let mut sinks = Sinks::open(&destinations)?;
    let id = ApplicationId::new_or_unknown(application("map"));
    let recording = StoreId::new(StoreKind::Recording, id, format!("map-{}", file_stem(&sweep.file)));
    let measures: Vec<&str> =
        MEASURES.into_iter().filter(|name| store.columns().iter().any(|column| column.name == *name)).collect();
    for message in blueprint::of_map(&measures, &recording, map.slices.len() > 1) {
        sinks.send(message)?;
    }
    let mut chunks = Chunks::new(recording);
    chunks.log_static(RECORDING_INFO.path, &sdk::RecordingInfo::new().with_name(title));
    let outcomes: Vec<String> = (0..=FAILED)
        .filter(|class| map.slices.iter().any(|slice| slice.dots.iter().any(|dot| dot.class == *class)))
        .map(|class| format!("{} **{}**", classes::color(class).1, map.classes.name(class)))
        .collect();
    let axes: Vec<String> = map.axes.iter().map(|axis| format!("**{}**", axis.label())).collect();
    let directions = ["to the right", "upwards"];
    let axes: Vec<String> =
        axes.iter().zip(directions).map(|(axis, direction)| format!("{axis} {direction}")).collect();
    let colored = match map.range {
        Some([low, high]) => format!("Map: **{}** from {low:.3} (dark) to {high:.3} (yellow). Points: ", map.color),
        None => String::new(),
    };
    let recorded = if sweep.experiment.is_none() { ": `meldscope sweep … --open ROW` records it" } else { "" };
    let about = format!(
        "**{title}**: {}; {}.  \n{colored}{}. Select a point to see its row{recorded}.  \n\
         Note: {MISSABLE}.",
        counted(map.rows, "run"),
        axes.join(", "),
        outcomes.join(", "),
    );
    chunks.log_static(ABOUT.path, &TextDocument::new(about).with_media_type(MediaType::MARKDOWN));
    log_ticks(&mut chunks, map);
    for (number, slice) in map.slices.iter().enumerate() {
        let at = match map.slices.len() {
            1 => TimePoint::STATIC,
            _ => TimePoint::from_iter([(Timeline::new_sequence(SLICE), number as i64)]),
        };
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
    }
    let points = Points2D::new(slice.dots.iter().map(|dot| pixel(dot.at)))
        .with_colors(slice.dots.iter().map(|dot| color(classes::color(dot.class).0.map(|c| c / 2))))
        .with_labels(slice.dots.iter().map(|dot| dot.label.as_str()))
        .with_show_labels(false)
        .with_radii([Radius::new_ui_points(if slice.dots.len() > 2000 { 0.8 } else { 2.0 })])
        .with_draw_order(20.0);
    chunks.row(&MAP.of(&["runs"]), at.clone(), &points);
    if slice.title.is_empty() {
        return;
    }
    let title = Points2D::new([[0.5 * WIDTH as f32, -26.0]])
        .with_labels([slice.title.as_str()])
        .with_show_labels(true)
        .with_radii([Radius::new_ui_points(0.1)]);
    chunks.row(&MAP.of(&["title"]), at.clone(), &title);
}

fn log_ticks(chunks: &mut Chunks, map: &Map) {
    let (mut positions, mut labels) = (Vec::new(), Vec::new());
    for (side, axis) in map.axes.iter().enumerate() {
        for (share, number) in ticks(axis) {
            let [x, y] = pixel(if side == 0 { [share, 0.0] } else { [0.0, share] });
            positions.push(if side == 0 { [x, y + 10.0] } else { [x - 18.0, y] });
            labels.push(number);
        }
        let [x, y] = pixel(if side == 0 { [0.5, 0.0] } else { [0.0, 0.5] });
        positions.push(if side == 0 { [x, y + 44.0] } else { [x - 70.0, y] });
        labels.push(axis.label());
    }
    let ticks = Points2D::new(positions)
        .with_labels(labels)
        .with_show_labels(true)
        .with_colors([color([120, 120, 120])])
        .with_radii([Radius::new_ui_points(0.1)]);
    chunks.log_static(&MAP.of(&["ticks"]), &ticks);
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
    let find = |axis: &super::design::Axis| design.axes.iter().position(|other| other.key == axis.key);
    let Some(first) = map.axes.first().and_then(find).filter(|_| map.is_grid) else { return Ok(()) };
    let second = map.axes.get(1).and_then(find);
    let last = second.and_then(|axis| design.axes[axis].count(0)).unwrap_or(1) - 1;
    let mut lines = vec![0, last / 2, last];
    lines.dedup();
    let columns = store.named(measures);
    let mut values: Vec<(u64, usize, Vec<Cell>)> = Vec::new();
    store.read(0..1, None, &columns, |(row, cells)| {
        let Some(place) = design.place(row).filter(|place| place.level == 0) else { return };
        let is_first =
            (0..place.index.len()).all(|axis| axis == first || Some(axis) == second || place.index[axis] == 0);
        let line = second.map_or(0, |axis| place.index[axis]);
        if let (true, Some(line)) = (is_first, lines.iter().position(|known| *known == line)) {
            values.push((place.index[first], line, cells));
        }
    })?;
    values.sort_by_key(|(index, line, _)| (*line, *index));
    for (k, measure) in measures.iter().enumerate() {
        for (line, index) in lines.iter().enumerate() {
            let entity = MEASURE.of(&[measure, &line.to_string()]);
            let name = match second {
                Some(axis) => format!("{} = {}", design.axes[axis].label(), design.axes[axis].value(0, *index)),
                None => (*measure).to_owned(),
            };
            Series::style(chunks, &entity, &name, palette::line(line), 1.5, Interpolation::Linear);
            for (at, _, cells) in values.iter().filter(|(_, known, _)| *known == line) {
                if let Some(Cell::F64(value)) = cells.get(k) {
                    let at = TimePoint::from_iter([(Timeline::new_sequence(ALONG), *at as i64)]);
                    chunks.row(&entity, at, &Scalars::single(*value));
                }
            }
        }
    }
    Ok(())
}
