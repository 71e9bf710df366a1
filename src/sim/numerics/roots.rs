//! Roots of functions of one variable. [`root`] finds the only root in an interval, by bracketed secants.
//! [`first_fall`] finds the first time at which a function falls through zero within an interval, using bounds on its
//! second derivative: no fall is missed, however briefly the function is below zero.
//!
//! [`first_fall`] skips intervals that cannot contain a root. Those on which the function is monotone are solved by
//! Newton's method with bisection where a step leaves the bracket, and others are halved.

/// Number of Newton steps before bisecting. Far from the origin, rounding turns positions into a staircase on which
/// Newton steps are too small.
const MAX_NEWTON: u32 = 32;

/// A function of time whose second derivative is bounded.
pub trait Falling {
    /// Newton's method ends with a step of this size or smaller. If zero, it ends when it no longer moves, at the first
    /// instant after the fall.
    const LAST_STEP: f64;

    /// Value and slope at `t`.
    fn at(&self, t: f64) -> (f64, f64);

    /// Bounds on the function between `start` and `end`, from its value and slope at `middle`; `None` ends the search.
    fn sample(&self, start: f64, middle: f64, end: f64) -> Option<Sample>;

    /// Whether the function was above zero by more than rounding before the interval.
    fn was_above(&self) -> bool {
        false
    }
}

/// Bounds on a function in an interval.
pub struct Sample {
    /// Value in the middle.
    pub value: f64,
    /// Slope in the middle.
    pub slope: f64,
    /// A bound on the absolute second derivative.
    pub curvature: f64,
    /// Whether the function is too far from zero for a root.
    pub is_clear: bool,
    /// Whether the function is within rounding of zero throughout.
    pub is_unresolved: bool,
    /// Largest value that counts as zero where the function is unresolved.
    pub rounding: f64,
    /// Start of Newton's method.
    pub guess: f64,
}

/// The first time between `start` and `end` at which a function falls through zero; `start` if it has fallen already.
pub fn first_fall<F: Falling>(f: &F, start: f64, end: f64) -> Option<f64> {
    let half = 0.5 * (end - start);
    let middle = start + half;
    let sample = f.sample(start, middle, end)?;
    if sample.is_clear {
        return (sample.value < 0.0).then_some(start);
    }
    // unresolved, or too short to halve: check whether it falls from above zero to zero
    if sample.is_unresolved || middle <= start || middle >= end {
        let (before, after) = (f.at(start).0, f.at(end).0);
        return ((f.was_above() || before > sample.rounding) && after <= sample.rounding).then_some(end);
    }
    // the slope does not change sign: at most one root, and only if the function falls
    if sample.slope.abs() > sample.curvature * half {
        return if sample.slope < 0.0 { fall(f, start, end, sample.guess) } else { None };
    }
    first_fall(f, start, middle).or_else(|| first_fall(f, middle, end))
}

/// The root of a function that falls throughout `[low, high]`; `low` if it has already fallen there.
fn fall<F: Falling>(f: &F, mut low: f64, mut high: f64, guess: f64) -> Option<f64> {
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
        let is_newton = newton > low && newton < high && tries < MAX_NEWTON;
        t = if is_newton { newton } else { low + 0.5 * (high - low) };
    }
    Some(high)
}

/// The root in `[low, high]` of a function that is negative at `high`, to about the last bit; `low` if the function is
/// not positive there.
pub fn root(low: f64, high: f64, mut at: impl FnMut(f64) -> f64) -> f64 {
    let (above, below) = (at(low), at(high));
    if above <= 0.0 { low } else { between([low, high], [above, below], at) }
}

/// Like [`root`], with given values at the ends: positive at `low`, negative at `high`. They need not be the function's
/// own; only their signs matter (regula falsi, Illinois variant).
pub fn between([mut low, mut high]: [f64; 2], [mut above, mut below]: [f64; 2], mut at: impl FnMut(f64) -> f64) -> f64 {
    let mut side = 0;
    for _ in 0..200 {
        let middle = 0.5 * (low + high);
        if high - low <= 4.0 * f64::EPSILON * (low.abs() + high.abs()) || middle <= low || middle >= high {
            break;
        }
        let guess = (low * below - high * above) / (below - above);
        let t = if guess > low && guess < high { guess } else { middle };
        let value = at(t);
        if value == 0.0 {
            return t;
        }
        if value > 0.0 {
            (low, above) = (t, value);
            if side == 1 {
                below *= 0.5;
            }
            side = 1;
        } else {
            (high, below) = (t, value);
            if side == -1 {
                above *= 0.5;
            }
            side = -1;
        }
    }
    0.5 * (low + high)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn roots_are_found_to_the_last_bit() {
        assert!((root(0.0, 2.0, |x| 2.0 - x * x) - std::f64::consts::SQRT_2).abs() < 1e-15);
        assert!((root(0.0, 1.0, |x| 1e-9 - x * x * x) - 1e-3).abs() < 1e-15);
        assert_eq!(root(1.0, 2.0, |_| -1.0), 1.0);
        // zero at the start and positive right after it: the given value has that sign
        assert!((between([0.0, 1.0], [1.0, -0.7], |x| x * (0.3 - x)) - 0.3).abs() < 1e-15);
    }
}
