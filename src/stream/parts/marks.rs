//! Events as markers in every plot: at q in the plots of q, on the axis in all others.

use crate::{
    analysis::approach::Approach,
    colors::{GREY, SILVER},
    observe::{PairEvent, Schema, schema::Scheduled},
    sdk::{Scalars, SeriesPoints, TextLog, components::MarkerShape},
    stream::{
        chunks::Chunks,
        contract::{Entity, MARKS_AT_Q, MARKS_OF_DRAWN, MARKS_ON_AXIS, SCHEDULED},
        instant::Instant,
        palette::{Rgb, color},
    },
};

/// The kinds of events that have been marked, whose styles are logged.
#[derive(Debug, Default)]
pub struct Marks {
    styled: Vec<(&'static str, Rgb)>,
    count: usize,
}

/// With more events than this, their marks on the axis are small: they would hide the curves there.
const FEW: usize = 40;

/// The name of all marks: one for each kind would fill the legends, and cover the curves.
const NAME: &str = "phase changes";
/// Shape and size of the marks of events on lines of q.
const AT_Q: (MarkerShape, f32) = (MarkerShape::Diamond, 5.0);

impl Marks {
    /// Logs the markers of an event; `is_plotted`: whether its pair has a plot of q.
    pub fn log(&mut self, schema: &Schema, event: &PairEvent, is_plotted: bool, chunks: &mut Chunks) {
        let rgb = schema.phases[event.to].color;
        let markers = [(&MARKS_ON_AXIS, MarkerShape::Up, 5.0), (&MARKS_AT_Q, AT_Q.0, AT_Q.1)];
        self.count += 1;
        if !self.styled.iter().any(|(name, _)| *name == event.name) {
            self.styled.push((event.name, rgb));
            for (parent, shape, size) in markers {
                chunks.log_static(&entity(parent, event.name), &style(NAME, rgb, shape, size));
            }
        }
        let at = Instant { step: event.step, time: event.time };
        for ((parent, ..), value) in markers.into_iter().zip([Some(0.0), is_plotted.then_some(event.q)]) {
            let Some(value) = value else { continue };
            chunks.log(&entity(parent, event.name), at, &Scalars::new([value]));
        }
    }
}

impl Marks {
    /// Ends a run: of many events, the marks on the axis become small.
    pub fn finish(&self, chunks: &mut Chunks) {
        for &(event, rgb) in self.styled.iter().filter(|_| self.count > FEW) {
            chunks.log_static(&entity(&MARKS_ON_AXIS, event), &style(NAME, rgb, MarkerShape::Up, 2.0));
        }
    }
}

fn entity(family: &Entity, event: &str) -> String {
    let name: String = event.chars().map(|c| if c.is_alphanumeric() { c } else { '_' }).collect();
    family.of(&[&name])
}

/// The style of markers.
pub fn style(name: &str, rgb: Rgb, shape: MarkerShape, size: f32) -> SeriesPoints {
    let style = SeriesPoints::new().with_names([name]).with_colors([color(rgb)]);
    style.with_markers([shape]).with_marker_sizes([size])
}

/// Marks the events of the pairs whose lines are drawn, in the order of time.
pub fn log_events(schema: &Schema, events: &[&PairEvent], chunks: &mut Chunks) {
    let mut styled = Vec::new();
    for event in events {
        let of_kind = entity(&MARKS_OF_DRAWN, event.name);
        if !styled.contains(&event.name) {
            styled.push(event.name);
            let rgb = schema.phases[event.to].color;
            chunks.log_static(&of_kind, &style(NAME, rgb, AT_Q.0, AT_Q.1));
        }
        chunks.log(&of_kind, Instant { step: event.step, time: event.time }, &Scalars::new([event.q]));
    }
}

/// Marks where pairs came closest that stayed in their first phase, on their lines of q.
pub fn log_near_misses(family: &Entity, schema: &Schema, approaches: &[&Approach], chunks: &mut Chunks) {
    if approaches.is_empty() {
        return;
    }
    let entity = family.of(&["near_miss"]);
    chunks.log_static(&entity, &style("near miss", SILVER, MarkerShape::Circle, 5.0));
    let mut approaches = approaches.to_vec();
    approaches.sort_by(|x, y| x.time.total_cmp(&y.time));
    for Approach { q, time, .. } in approaches {
        // the end of a step, but for rounding, is in it
        let at = Instant { step: (time / schema.dt - 1e-9).ceil() as u64, time: *time };
        chunks.log(&entity, at, &Scalars::new([*q]));
    }
}

/// Lists what the scene changes within a step; `is_plotted`: whether to mark it in plots, too.
pub fn log_scheduled(step: u64, scheduled: &[Scheduled], is_plotted: bool, chunks: &mut Chunks) {
    /// Upper limits on the number of lines of a step, and of characters of a line.
    const MOST: usize = 64;
    const LONGEST: usize = 200;

    for (number, Scheduled { time, text }) in scheduled.iter().take(MOST).enumerate() {
        let at = Instant { step, time: *time };
        let end = text.char_indices().nth(LONGEST).map_or(text.len(), |(end, _)| end);
        let cut = if end < text.len() { " …" } else { "" };
        let more = match scheduled.len().checked_sub(MOST) {
            Some(more @ 1..) if number + 1 == MOST => format!(", and {more} more"),
            _ => String::new(),
        };
        let line = TextLog::new(format!("{}{cut} at t = {time:.6} s, step {step}{more}", &text[..end]));
        chunks.log(SCHEDULED.path, at, &line.with_level("scene").with_color(color(SILVER)));
        if is_plotted && number == 0 {
            chunks.log(&MARKS_ON_AXIS.of(&["scheduled"]), at, &Scalars::new([0.0]));
        }
    }
}

/// Logs the style of the marks of what the scene changes.
pub fn log_style_of_scheduled(chunks: &mut Chunks) {
    let style = style("scene changes", SILVER, MarkerShape::Square, 4.0);
    chunks.log_static(&MARKS_ON_AXIS.of(&["scheduled"]), &style);
}

/// Marks the ends of a run in every plot, so that all of them show the same range of time; `level` is any plotted q, if
/// there is one.
pub fn log_ends(ends: [Instant; 2], level: Option<f64>, chunks: &mut Chunks) {
    for (family, value) in [(&MARKS_ON_AXIS, Some(0.0)), (&MARKS_AT_Q, level)] {
        let Some(value) = value else { continue };
        let entity = family.of(&["ends"]);
        chunks.log_static(&entity, &style(NAME, GREY, MarkerShape::Plus, 3.0));
        for at in ends {
            chunks.log(&entity, at, &Scalars::new([value]));
        }
    }
}
