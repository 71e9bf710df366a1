//! Lines of plots, from which values that did not change are left out without changing the line.

use std::collections::BTreeMap;

use rerun::{Scalars, SeriesLines, components::InterpolationMode};

use super::{
    chunks::{Chunks, Instant},
    palette::{Rgb, color},
};

/// How a line gets from one value to the next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// Straight: quantities that change all the time.
    Linear,
    /// Level until the next value: counts, thresholds.
    Step,
}

/// The lines of a recording, by entity.
#[derive(Default)]
pub struct Series {
    lines: BTreeMap<String, Line>,
}

struct Line {
    shape: Shape,
    value: f64,
    /// When the value was last logged, and when it was last seen to be the same.
    logged: Instant,
    seen: Instant,
}

impl Series {
    /// Names and colours a line.
    pub fn style(chunks: &mut Chunks, entity: &str, name: &str, rgb: Rgb, width: f32, shape: Shape) {
        let mode = match shape {
            Shape::Linear => InterpolationMode::Linear,
            Shape::Step => InterpolationMode::StepAfter,
        };
        let style = SeriesLines::new()
            .with_names([name])
            .with_colors([color(rgb)])
            .with_widths([width])
            .with_interpolation_mode(mode);
        chunks.log_static(entity, &style);
    }

    /// A point of a line, if the value changed.
    pub fn log(&mut self, chunks: &mut Chunks, entity: &str, shape: Shape, value: f64, now: Instant) {
        match self.lines.get_mut(entity) {
            Some(line) if line.value == value => line.seen = now,
            Some(line) => {
                // A straight line was level until the value was last seen: it needs that corner.
                if line.shape == Shape::Linear && line.logged.step < line.seen.step {
                    chunks.log(entity, line.seen, &Scalars::single(line.value));
                }
                chunks.log(entity, now, &Scalars::single(value));
                *line = Line { shape, value, logged: now, seen: now };
            }
            None => {
                chunks.log(entity, now, &Scalars::single(value));
                self.lines.insert(entity.to_owned(), Line { shape, value, logged: now, seen: now });
            }
        }
    }

    /// Draws a line on to where its value was last seen.
    pub fn extend(&mut self, chunks: &mut Chunks, entity: &str) {
        if let Some(line) = self.lines.get_mut(entity) {
            line.extend(chunks, entity);
        }
    }

    /// Ends a line until its next point: draws it on, and logs that there is no value any more.
    pub fn interrupt(&mut self, chunks: &mut Chunks, entity: &str, now: Instant) {
        self.extend(chunks, entity);
        if self.lines.remove(entity).is_some() {
            chunks.log(entity, now, &Scalars::new([0.0; 0]));
        }
    }

    /// Draws all lines on to where their values were last seen.
    pub fn extend_all(&mut self, chunks: &mut Chunks) {
        for (entity, line) in &mut self.lines {
            line.extend(chunks, entity);
        }
    }
}

impl Line {
    fn extend(&mut self, chunks: &mut Chunks, entity: &str) {
        if self.logged.step < self.seen.step {
            chunks.log(entity, self.seen, &Scalars::single(self.value));
            self.logged = self.seen;
        }
    }
}
