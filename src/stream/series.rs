//! Lines of plots, from which values that did not change are left out without changing the line.

use rerun::{Scalars, SeriesLines, components::InterpolationMode};

use super::{
    chunks::{Chunks, TrackId},
    columns::Cell,
    instant::Instant,
    palette::{Rgb, color},
};

/// How a line gets from one value to the next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Interpolation {
    /// Straight: quantities that change all the time.
    Linear,
    /// Level until the next value: counts, thresholds.
    Step,
}

/// The lines of a recording.
#[derive(Default)]
pub struct Series {
    lines: Vec<Line>,
    is_whole: bool,
}

/// One of them.
#[derive(Clone, Copy, Debug)]
pub struct LineId(usize);

struct Line {
    track: TrackId,
    shape: Interpolation,
    last: Option<Last>,
}

/// The last value, when it was logged, and when it was last seen to be the same.
#[derive(Clone, Copy)]
struct Last {
    value: f64,
    logged: Instant,
    seen: Instant,
}

impl Series {
    /// Lines with a point in every frame, whether the value changed or not: of some frames of a run, the first has them all.
    pub fn whole() -> Series {
        Series { lines: Vec::new(), is_whole: true }
    }

    /// Names and colours a line.
    pub fn style(chunks: &mut Chunks, entity: &str, name: &str, rgb: Rgb, width: f32, shape: Interpolation) {
        let mode = match shape {
            Interpolation::Linear => InterpolationMode::Linear,
            Interpolation::Step => InterpolationMode::StepAfter,
        };
        let style = SeriesLines::new()
            .with_names([name])
            .with_colors([color(rgb)])
            .with_widths([width])
            .with_interpolation_mode(mode);
        chunks.log_static(entity, &style);
    }

    /// A new line, without a point so far.
    pub fn line(&mut self, chunks: &mut Chunks, entity: &str, shape: Interpolation) -> LineId {
        let track = chunks.track(entity, [Scalars::descriptor_scalars()]);
        self.lines.push(Line { track, shape, last: None });
        LineId(self.lines.len() - 1)
    }

    /// A point of a line, if the value changed.
    pub fn log(&mut self, chunks: &mut Chunks, LineId(line): LineId, value: f64, now: Instant) {
        let Line { track, shape, last } = &mut self.lines[line];
        match last {
            Some(last) if last.value == value && !self.is_whole => last.seen = now,
            Some(last) if self.is_whole => {
                chunks.push(*track, now, &[Cell::Scalars(&[value])]);
                *last = Last { value, logged: now, seen: now };
            }
            Some(Last { value: before, logged, seen }) => {
                // A straight line was level until the value was last seen: it needs that corner.
                if *shape == Interpolation::Linear && logged.step < seen.step {
                    chunks.push(*track, *seen, &[Cell::Scalars(&[*before])]);
                }
                chunks.push(*track, now, &[Cell::Scalars(&[value])]);
                *last = Some(Last { value, logged: now, seen: now });
            }
            None => {
                chunks.push(*track, now, &[Cell::Scalars(&[value])]);
                *last = Some(Last { value, logged: now, seen: now });
            }
        }
    }

    /// Draws a line on to where its value was last seen.
    pub fn extend(&mut self, chunks: &mut Chunks, LineId(line): LineId) {
        self.lines[line].extend(chunks);
    }

    /// Ends a line until its next point: draws it on, and logs that there is no value any more.
    pub fn interrupt(&mut self, chunks: &mut Chunks, LineId(line): LineId, now: Instant) {
        let line = &mut self.lines[line];
        line.extend(chunks);
        if line.last.take().is_some() {
            chunks.push(line.track, now, &[Cell::Scalars(&[])]);
        }
    }

    /// Draws all lines on to where their values were last seen.
    pub fn extend_all(&mut self, chunks: &mut Chunks) {
        self.lines.iter_mut().for_each(|line| line.extend(chunks));
    }
}

impl Line {
    fn extend(&mut self, chunks: &mut Chunks) {
        if let Some(last) = &mut self.last
            && last.logged.step < last.seen.step
        {
            chunks.push(self.track, last.seen, &[Cell::Scalars(&[last.value])]);
            last.logged = last.seen;
        }
    }
}
