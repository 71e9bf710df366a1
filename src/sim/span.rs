//! An interval of time.

/// An interval of time [s].
#[derive(Clone, Copy, Debug)]
pub(super) struct Span {
    pub start: f64,
    pub end: f64,
}

impl Span {
    pub fn length(&self) -> f64 {
        self.end - self.start
    }

    /// Whether `t` [s] is inside the interval.
    pub fn holds(&self, t: f64) -> bool {
        self.start < t && t < self.end
    }
}
