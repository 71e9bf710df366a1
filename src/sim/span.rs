//! An interval of time, and the instants in it at which something jumps.

use crate::scene::{Path, Scene};

/// An interval of time [s].
#[derive(Clone, Copy, Debug)]
pub(crate) struct Span {
    pub start: f64,
    pub end: f64,
}

impl Span {
    /// The instant of a step at which its explicit forces at `t` [s] see what begins and ends: what does so at an end of the
    /// step, but for rounding, does not jump within it.
    pub fn inside(self, t: f64) -> f64 {
        const ROUNDING: f64 = 1e-9;

        let margin = ROUNDING * self.length();
        t.max(self.start + margin).min(self.end - margin)
    }

    pub fn length(&self) -> f64 {
        self.end - self.start
    }

    /// Whether `t` [s] is inside the interval.
    pub fn holds(&self, t: f64) -> bool {
        self.start < t && t < self.end
    }

    /// The part of some ascending instants [s] that lies in the interval, its ends included.
    pub fn among<'a>(&self, times: &'a [f64]) -> &'a [f64] {
        let times = &times[times.partition_point(|&t| t < self.start)..];
        &times[..times.partition_point(|&t| t <= self.end)]
    }

    /// Appends the instants in the interval, its ends included, at which the path of one of these bodies or force points
    /// jumps, or such a point begins or ceases to act [s]. Force points follow the bodies.
    pub fn jumps_of(&self, scene: &Scene, sources: impl IntoIterator<Item = u32>, jumps: &mut Vec<f64>) {
        for source in sources {
            let path = scene.source_path(source as usize);
            jumps.extend_from_slice(self.among(path.map_or(&[], Path::knots)));
            if let Some(point) = (source as usize).checked_sub(scene.bodies.len()) {
                let point = &scene.points[point];
                jumps.extend([point.start, point.end()].into_iter().filter(|t| (self.start..=self.end).contains(t)));
            }
        }
    }
}
