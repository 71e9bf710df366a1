//! Plot lines. Unchanged values are left out without changing the shape of the line.

use super::{
    chunks::{Chunks, TrackId},
    instant::Instant,
    palette::{Rgb, color},
};
use crate::observe::schema::ScalarSchema;
use crate::sdk::{
    Scalars, SeriesLines,
    components::{AggregationPolicy, InterpolationMode},
};

/// Interpolation between the values of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Interpolation {
    /// Linear: for continuous quantities.
    Linear,
    /// Holds each value until the next one: for counts and thresholds.
    Step,
}

/// The plot lines of a recording.
#[derive(Default)]
pub struct Series {
    lines: Vec<Line>,
    is_whole: bool,
}

/// Handle of a plot line.
#[derive(Clone, Copy, Debug)]
pub struct LineId(usize);

struct Line {
    track: TrackId,
    shape: Interpolation,
    last: Option<Last>,
    entity: String,
    outline: Outline,
}

/// What is known of a line without its values.
#[derive(Clone, Debug, Default)]
pub struct Outline {
    /// Steps and values of some points, evenly spaced over the steps for which it has values.
    pub points: Vec<(u64, f64)>,
    /// Smallest and largest value, if there are any.
    pub range: Option<[f64; 2]>,
    /// Number of steps from one point to the next, at least.
    spacing: u64,
}

impl Outline {
    const MAX_POINTS: usize = 256;

    /// Adds a value to the line.
    pub fn add(&mut self, step: u64, value: f64) {
        let [low, high] = self.range.unwrap_or([value; 2]);
        self.range = Some([low.min(value), high.max(value)]);
        if self.points.last().is_some_and(|(last, _)| step < last + self.spacing) {
            return;
        }
        if self.points.len() == Outline::MAX_POINTS {
            halve(&mut self.points);
            self.spacing = 2 * self.spacing.max(1);
        }
        self.points.push((step, value));
    }
}

/// Drops every other element, the second first.
pub fn halve<T>(of: &mut Vec<T>) {
    let mut index = 0;
    of.retain(|_| {
        index += 1;
        index % 2 == 1
    });
}

/// The last value, when it was logged, and when it was last observed unchanged.
#[derive(Clone, Copy)]
struct Last {
    value: f64,
    logged: Instant,
    seen: Instant,
}

impl Series {
    /// Lines with a point in every frame, even if the value is unchanged. For an excerpt of a run, whose first frame
    /// has all values.
    pub fn whole() -> Series {
        Series { lines: Vec::new(), is_whole: true }
    }

    /// Sets the name and style of a line.
    pub fn style(chunks: &mut Chunks, entity: &str, name: &str, rgb: Rgb, width: f32, shape: Interpolation) {
        // of points that are less than a pixel or so apart, the viewer draws minimum and maximum: a steep line gets stairs
        let (mode, aggregation) = match shape {
            Interpolation::Linear => (InterpolationMode::Linear, AggregationPolicy::Average),
            Interpolation::Step => (InterpolationMode::StepAfter, AggregationPolicy::MinMax),
        };
        let style = SeriesLines::new()
            .with_names([name])
            .with_colors([color(rgb)])
            .with_widths([width])
            .with_interpolation_mode(mode)
            .with_aggregation_policy(aggregation);
        chunks.log_static(entity, &style);
    }

    /// Creates a line without points.
    pub fn line(&mut self, chunks: &mut Chunks, entity: &str, shape: Interpolation) -> LineId {
        let track = chunks.track(entity, [Scalars::descriptor_scalars()]);
        self.lines.push(Line { track, shape, last: None, entity: entity.to_owned(), outline: Outline::default() });
        LineId(self.lines.len() - 1)
    }

    /// Creates the line of a scalar of `owner`, a body or a pair, without points.
    pub fn scalar(
        &mut self,
        chunks: &mut Chunks,
        entity: &str,
        scalar: &ScalarSchema,
        owner: &str,
        rgb: Rgb,
    ) -> LineId {
        let shape = if scalar.is_smooth { Interpolation::Linear } else { Interpolation::Step };
        Series::style(chunks, entity, &format!("{} {owner}", scalar.label), rgb, 1.5, shape);
        self.line(chunks, entity, shape)
    }

    /// Adds a point to a line if there is a value and it has changed; without one, ends the line until the next.
    pub fn log_or_interrupt(&mut self, chunks: &mut Chunks, line: LineId, value: f64, now: Instant) {
        if value.is_nan() {
            self.interrupt(chunks, line, now);
        } else {
            self.log(chunks, line, value, now);
        }
    }

    /// Adds a point to a line if the value has changed.
    pub fn log(&mut self, chunks: &mut Chunks, LineId(line): LineId, value: f64, now: Instant) {
        let Line { track, shape, last, outline, .. } = &mut self.lines[line];
        outline.add(now.step, value);
        match last {
            Some(last) if last.value == value && !self.is_whole => last.seen = now,
            Some(last) if self.is_whole => {
                chunks.push(*track, now, &[&[value]]);
                *last = Last { value, logged: now, seen: now };
            }
            Some(Last { value: before, logged, seen }) => {
                // A linear line was flat until the value was last observed: it needs a point at that corner.
                if *shape == Interpolation::Linear && logged.step < seen.step {
                    chunks.push(*track, *seen, &[&[*before]]);
                }
                chunks.push(*track, now, &[&[value]]);
                *last = Some(Last { value, logged: now, seen: now });
            }
            None => {
                chunks.push(*track, now, &[&[value]]);
                *last = Some(Last { value, logged: now, seen: now });
            }
        }
    }

    /// Extends a line to where its value was last observed.
    pub fn extend(&mut self, chunks: &mut Chunks, LineId(line): LineId) {
        self.lines[line].extend(chunks);
    }

    /// Ends a line until its next point: extends it, and logs a gap.
    pub fn interrupt(&mut self, chunks: &mut Chunks, LineId(line): LineId, now: Instant) {
        let line = &mut self.lines[line];
        line.extend(chunks);
        if line.last.take().is_some() {
            chunks.push(line.track, now, &[&[0.0_f64; 0]]);
        }
    }

    /// The outline of a line.
    pub fn outline(&self, LineId(line): LineId) -> &Outline {
        &self.lines[line].outline
    }

    /// The entity of each line, and its outline.
    pub fn outlines(&self) -> impl Iterator<Item = (&str, &Outline)> {
        self.lines.iter().map(|line| (line.entity.as_str(), &line.outline))
    }

    /// Extends all lines to where their values were last observed.
    pub fn extend_all(&mut self, chunks: &mut Chunks) {
        self.lines.iter_mut().for_each(|line| line.extend(chunks));
    }
}

impl Line {
    fn extend(&mut self, chunks: &mut Chunks) {
        if let Some(last) = &mut self.last
            && last.logged.step < last.seen.step
        {
            chunks.push(self.track, last.seen, &[&[last.value]]);
            last.logged = last.seen;
        }
    }
}
