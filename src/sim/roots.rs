//! Finds the first time at which a function falls through zero within an interval, using bounds of its second
//! derivative: none is missed, however short the visit below zero.
//!
//! Intervals that cannot contain a root are skipped, those on which the function is monotone are solved by Newton's
//! method with bisection where a step leaves the bracket, and others are halved.

/// Far from the origin rounded positions have stairs, on which Newton's steps are too small: after this many, bisect.
const MOST_NEWTON: u32 = 32;

/// A function of time whose second derivative is bounded.
pub(super) trait Falling {
    /// Newton's method ends with a step of this size or smaller; zero: when it no longer moves, with the first instant
    /// after the fall.
    const LAST_STEP: f64;

    /// Its value and its slope at `t`.
    fn at(&self, t: f64) -> (f64, f64);

    /// What is known of it between `start` and `end` from its value and slope in the `middle`; `None` ends the search.
    fn sample(&self, start: f64, middle: f64, end: f64) -> Option<Sample>;

    /// Whether it was above zero by more than rounding before the interval.
    fn was_above(&self) -> bool {
        false
    }
}

/// What is known of a function in an interval.
pub(super) struct Sample {
    /// Its value in the middle.
    pub value: f64,
    /// Its slope there.
    pub slope: f64,
    /// A bound of its second derivative.
    pub curvature: f64,
    /// Whether it is too far from zero for a root.
    pub is_clear: bool,
    /// Whether all of it is too close to zero to tell more.
    pub is_unresolved: bool,
    /// Up to this value it counts as zero where it is not resolved.
    pub rounding: f64,
    /// Where Newton's method starts.
    pub guess: f64,
}

/// The first time between `start` and `end` at which a function falls through zero; `start` if it has fallen already.
pub(super) fn first_fall<F: Falling>(f: &F, start: f64, end: f64) -> Option<f64> {
    let half = 0.5 * (end - start);
    let middle = start + half;
    let sample = f.sample(start, middle, end)?;
    if sample.is_clear {
        return (sample.value < 0.0).then_some(start);
    }
    // too close to zero, or too short: does it come to stand on zero, from above?
    if sample.is_unresolved || middle <= start || middle >= end {
        let (before, after) = (f.at(start).0, f.at(end).0);
        return ((f.was_above() || before > sample.rounding) && after <= sample.rounding).then_some(end);
    }
    // its slope keeps its sign: at most one root, and only if it falls
    if sample.slope.abs() > sample.curvature * half {
        return if sample.slope < 0.0 { root(f, start, end, sample.guess) } else { None };
    }
    first_fall(f, start, middle).or_else(|| first_fall(f, middle, end))
}

/// The root of a function that falls throughout `[low, high]`; `low` only if it has fallen already there.
fn root<F: Falling>(f: &F, mut low: f64, mut high: f64, guess: f64) -> Option<f64> {
    if f.at(high).0 > 0.0 {
        return None;
    }
    if f.at(low).0 <= 0.0 {
        return Some(low);
    }
    let mut t = if guess > low && guess < high { guess } else { low + 0.5 * (high - low) };
    let mut tries = 0;
    while low < t && t < high {
        tries += 1;
        let (value, slope) = f.at(t);
        if value == 0.0 {
            return Some(t);
        }
        if value > 0.0 {
            low = t;
        } else {
            high = t;
        }
        let newton = t - value / slope;
        if (newton - t).abs() <= F::LAST_STEP {
            let is_before = F::LAST_STEP == 0.0 && t == low;
            return Some(if is_before { t.next_up() } else { newton.clamp(low, high) });
        }
        let is_newton = newton > low && newton < high && tries < MOST_NEWTON;
        t = if is_newton { newton } else { low + 0.5 * (high - low) };
    }
    Some(high)
}
