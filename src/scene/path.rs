//! Centre paths: the position of a body's centre, prescribed for all t ≥ 0.

use std::{
    borrow::Cow,
    f64::consts::TAU,
    fmt,
    hash::Hasher,
    ops::Range,
    panic::{RefUnwindSafe, UnwindSafe},
    sync::Arc,
};

use glam::DVec3;
use rustc_hash::FxHasher;

/// A prescribed path of a centre c(t), defined for every t.
#[derive(Clone, Debug, PartialEq)]
pub enum Path {
    /// A fixed position [scene unit].
    Fixed(DVec3),
    /// `from + velocity · t` [scene unit, scene unit/s].
    Line {
        /// At t = 0.
        from: DVec3,
        /// c′.
        velocity: DVec3,
    },
    /// `center + amplitude · sin(2π · frequency · t + phase)`.
    Sine {
        /// [scene unit]
        center: DVec3,
        /// [scene unit]
        amplitude: DVec3,
        /// [1/s]
        frequency: f64,
        /// [rad]
        phase: f64,
    },
    /// Through keys: a clamped cubic spline, straight lines, or jumps.
    Keyframes(Spline),
    /// Set by a program. Scene files cannot express it, so a recording of it cannot be replayed.
    Given(Given),
}

/// A path set by a program as a function of time.
#[derive(Clone)]
pub struct Given {
    at: Arc<dyn Fn(f64) -> Kinematics + Send + Sync>,
    bounds: Bounds,
}

impl Given {
    /// The path `at(t)` = c, c′, c″ at time t [s]. The function must be continuous and deterministic; velocity and
    /// acceleration must be the derivatives of the position, and never exceed `bounds`, which limit the search for
    /// events, and steps in scenes with free bodies: loose bounds cost time. They are finite, and the speed is at least 1e-12
    /// unless both are 0.
    pub fn new(bounds: Bounds, at: impl Fn(f64) -> Kinematics + Send + Sync + 'static) -> Given {
        Given { at: Arc::new(at), bounds }
    }

    /// The bounds of its velocity and acceleration.
    pub fn bounds(&self) -> Bounds {
        self.bounds
    }
}

// a deterministic function has no state that a panic could leave half changed
impl UnwindSafe for Given {}
impl RefUnwindSafe for Given {}

impl fmt::Debug for Given {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Given").field("bounds", &self.bounds).finish_non_exhaustive()
    }
}

impl PartialEq for Given {
    /// Whether both are the same function.
    fn eq(&self, other: &Given) -> bool {
        Arc::ptr_eq(&self.at, &other.at) && self.bounds == other.bounds
    }
}

/// Position, velocity and acceleration of a centre at an instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kinematics {
    /// c [scene unit]
    pub position: DVec3,
    /// c′ [scene unit/s]
    pub velocity: DVec3,
    /// c″ [scene unit/s²]
    pub acceleration: DVec3,
}

impl Kinematics {
    /// The motion after some time [s] of constant acceleration.
    pub fn after(&self, time: f64) -> Kinematics {
        let Kinematics { position, velocity, acceleration } = *self;
        Kinematics {
            position: position + (velocity + acceleration * (0.5 * time)) * time,
            velocity: velocity + acceleration * time,
            acceleration,
        }
    }
}

/// Sine and cosine of the phase angles of a path at fixed offsets in time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turns([(f64, f64); 5]);

/// Upper bounds of a path over an interval, for root finding that cannot miss a crossing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Upper bound of |c′| [scene unit/s].
    pub speed: f64,
    /// Upper bound of |c″| [scene unit/s²].
    pub acceleration: f64,
}

impl Path {
    /// The rate at which it turns [rad/s], for a path of a program at most; 0 if it is piecewise polynomial.
    pub(crate) fn turning_rate(&self) -> f64 {
        match self {
            Path::Sine { frequency, .. } => TAU * frequency.abs(),
            Path::Given(Given { bounds, .. }) if bounds.acceleration > 0.0 => bounds.acceleration / bounds.speed,
            Path::Given(_) | Path::Fixed(_) | Path::Line { .. } | Path::Keyframes(_) => 0.0,
        }
    }

    /// c, c′ and c″ at time `t` [s]; at a discontinuity, the values after it.
    #[inline]
    pub fn at(&self, t: f64) -> Kinematics {
        match self {
            Path::Fixed(position) => {
                Kinematics { position: *position, velocity: DVec3::ZERO, acceleration: DVec3::ZERO }
            }
            _ => self.at_moving(t),
        }
    }

    fn at_moving(&self, t: f64) -> Kinematics {
        match self {
            Path::Fixed(_) => self.at(t),
            Path::Line { from, velocity } => {
                Kinematics { position: *from + *velocity * t, velocity: *velocity, acceleration: DVec3::ZERO }
            }
            Path::Sine { center, amplitude, frequency, phase } => {
                let rate = TAU * frequency;
                let (sin, cos) = libm::sincos(rate * t + phase);
                Kinematics {
                    position: *center + *amplitude * sin,
                    velocity: *amplitude * (rate * cos),
                    acceleration: *amplitude * (-rate * rate * sin),
                }
            }
            Path::Keyframes(spline) => spline.at(t),
            Path::Given(given) => (given.at)(t),
        }
    }

    /// c, c′ and c″ just before time `t` [s]: differs from [`Path::at`] only where a derivative jumps.
    pub fn before(&self, t: f64) -> Kinematics {
        match self {
            Path::Keyframes(spline) => spline.on(spline.times.partition_point(|&key| key < t), t),
            _ => self.at(t),
        }
    }

    /// The precomputed angles of [`Path::kinematics`] for instants at the given times after any start [s].
    pub fn turns(&self, after: &[f64; 5]) -> Turns {
        match self {
            Path::Sine { frequency, .. } => Turns(after.map(|t| libm::sincos(TAU * frequency * t))),
            _ => Turns([(0.0, 1.0); 5]),
        }
    }

    /// c, c′ and c″ at five instants `start + theta · (end − start)` at once; theta = 1 is just before `end`. A sine
    /// path is rotated from its phase at `start` by precomputed angles, so that only one sine is evaluated.
    pub fn kinematics(&self, start: f64, end: f64, thetas: &[f64; 5], turns: &Turns) -> [Kinematics; 5] {
        if let Path::Sine { center, amplitude, frequency, phase } = self {
            let rate = TAU * frequency;
            let (sin, cos) = libm::sincos(rate * start + phase);
            return turns.0.map(|(turn_sin, turn_cos)| {
                let (sin, cos) = (sin * turn_cos + cos * turn_sin, cos * turn_cos - sin * turn_sin);
                Kinematics {
                    position: *center + *amplitude * sin,
                    velocity: *amplitude * (rate * cos),
                    acceleration: *amplitude * (-rate * rate * sin),
                }
            });
        }
        thetas.map(|theta| if theta == 1.0 { self.before(end) } else { self.at(start + theta * (end - start)) })
    }

    /// A bounding sphere of the path over `[start, end]` [s]: centre and radius [scene unit].
    pub fn ball(&self, start: f64, end: f64) -> (DVec3, f64) {
        let half = 0.5 * (end - start);
        let travelled = (self.position(start + half), self.bounds(start, end).speed * half);
        match self {
            Path::Sine { center, amplitude, .. } if amplitude.length() < travelled.1 => (*center, amplitude.length()),
            _ => travelled,
        }
    }

    /// Upper bound of the distance between any two points of the path [scene unit].
    pub fn extent(&self) -> f64 {
        match self {
            Path::Fixed(_) => 0.0,
            Path::Sine { amplitude, .. } => 2.0 * amplitude.length() * (1.0 + 1e-12),
            Path::Line { .. } | Path::Keyframes(_) | Path::Given(_) => f64::INFINITY,
        }
    }

    /// c at time `t` [s].
    pub fn position(&self, t: f64) -> DVec3 {
        self.at(t).position
    }

    /// Bounds of speed and acceleration over `[start, end]` [s].
    pub fn bounds(&self, start: f64, end: f64) -> Bounds {
        match self {
            Path::Fixed(_) => Bounds { speed: 0.0, acceleration: 0.0 },
            Path::Line { velocity, .. } => Bounds { speed: velocity.length(), acceleration: 0.0 },
            Path::Sine { amplitude, frequency, .. } => {
                let rate = (TAU * frequency).abs();
                let speed = amplitude.length() * rate;
                Bounds { speed, acceleration: speed * rate }
            }
            Path::Keyframes(spline) => spline.bounds(start, end),
            Path::Given(given) => given.bounds,
        }
    }

    /// Bounds of the motion relative to another path over `[start, end]` [s]: the sum of both, or less where the two
    /// move alike (otherwise, root finding would be slow for bodies that move together).
    pub fn relative_bounds(&self, other: &Path, start: f64, end: f64) -> Bounds {
        let sum = || {
            let (a, b) = (self.bounds(start, end), other.bounds(start, end));
            Bounds { speed: a.speed + b.speed, acceleration: a.acceleration + b.acceleration }
        };
        match (self, other) {
            (Path::Line { velocity: v, .. }, Path::Line { velocity: w, .. }) => {
                Path::Line { from: DVec3::ZERO, velocity: *v - *w }.bounds(start, end)
            }
            (
                Path::Sine { amplitude: v, frequency, phase, .. },
                Path::Sine { amplitude: w, frequency: other_frequency, phase: other_phase, .. },
            ) if frequency == other_frequency && phase == other_phase => {
                let amplitude = *v - *w;
                Path::Sine { center: DVec3::ZERO, amplitude, frequency: *frequency, phase: *phase }.bounds(start, end)
            }
            (Path::Keyframes(a), Path::Keyframes(b)) => a.relative_bounds(b, start, end).unwrap_or_else(sum),
            _ => sum(),
        }
    }

    /// Instants at which a derivative of the path jumps [s], ascending.
    pub fn knots(&self) -> &[f64] {
        match self {
            Path::Keyframes(spline) => &spline.times,
            _ => &[],
        }
    }

    /// The jump of the velocity at time `t` [scene unit/s]; nonzero only at the keys of straight lines.
    pub fn kick(&self, t: f64) -> DVec3 {
        match self {
            Path::Keyframes(spline)
                if spline.jumps == Jumps::Velocity
                    && spline.times.binary_search_by(|key| key.total_cmp(&t)).is_ok() =>
            {
                self.at(t).velocity - self.before(t).velocity
            }
            _ => DVec3::ZERO,
        }
    }

    /// The sum of the magnitudes of the velocity jumps in `[start, end)` [scene unit/s].
    pub fn kicks(&self, start: f64, end: f64) -> f64 {
        match self {
            Path::Keyframes(spline) if spline.jumps == Jumps::Velocity => {
                let first = spline.times.partition_point(|&key| key < start);
                let keys = spline.times[first..].iter().take_while(|&&key| key < end);
                keys.map(|&key| self.kick(key).length()).sum()
            }
            _ => 0.0,
        }
    }

    /// The path between two knots [s]: after any jump at `start`, before any jump at `end`.
    #[inline]
    pub fn between(&self, start: f64, end: f64) -> Cow<'_, Path> {
        match self.is_held() {
            true => Cow::Owned(Path::Fixed(self.position(start + 0.5 * (end - start)))),
            false => Cow::Borrowed(self),
        }
    }

    /// Whether the position of the centre jumps at the keys.
    pub fn is_held(&self) -> bool {
        matches!(self, Path::Keyframes(Spline { jumps: Jumps::Position, .. }))
    }

    /// The same path, moved by `offset` [scene unit].
    pub fn moved_by(&self, offset: DVec3) -> Path {
        match self {
            Path::Fixed(position) => Path::Fixed(*position + offset),
            Path::Line { from, velocity } => Path::Line { from: *from + offset, velocity: *velocity },
            Path::Sine { center, amplitude, frequency, phase } => {
                Path::Sine { center: *center + offset, amplitude: *amplitude, frequency: *frequency, phase: *phase }
            }
            Path::Keyframes(spline) => Path::Keyframes(spline.moved_by(offset)),
            Path::Given(given) => {
                let at = Arc::clone(&given.at);
                let moved = move |t: f64| {
                    let motion = at(t);
                    Kinematics { position: motion.position + offset, ..motion }
                };
                Path::Given(Given::new(given.bounds, moved))
            }
        }
    }

    /// Whether the centre is at rest throughout `[start, end]` [s], without jumps.
    pub fn is_still(&self, start: f64, end: f64) -> bool {
        match self {
            Path::Fixed(_) => true,
            Path::Line { .. } | Path::Sine { .. } | Path::Given(_) => false,
            Path::Keyframes(spline) => match spline.times[..] {
                [first, .., last] => end < first || last < start,
                _ => true,
            },
        }
    }

    /// Whether the centre never moves.
    pub fn is_fixed(&self) -> bool {
        matches!(self, Path::Fixed(_))
    }
}

/// A piecewise polynomial per coordinate through keys, constant outside of them. Copies share the keys.
#[derive(Clone, Debug, PartialEq)]
pub struct Spline {
    times: Arc<[f64]>,
    /// Hash of the times, to distinguish splines with different times without comparing all times.
    times_hash: u64,
    /// `[keys − 1]`
    segments: Arc<[Segment]>,
    first: DVec3,
    last: DVec3,
    jumps: Jumps,
}

/// What jumps at the keys of a spline, besides its third derivative.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Jumps {
    Nothing,
    Velocity,
    Position,
}

/// `p + s (v + s (a/2 + s j/6))`, s = t − start of the segment.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Segment {
    position: DVec3,
    velocity: DVec3,
    acceleration: DVec3,
    jerk: DVec3,
}

impl Spline {
    /// The C² cubic spline through `keys` (time [s], position [scene unit]), one or more, times strictly increasing, with
    /// zero velocity at the first and the last.
    ///
    /// The accelerations M_k at the keys solve the tridiagonal system of the clamped spline, `h₋ M₋ + 2 (h₋ + h₊) M +
    /// h₊ M₊ = 6 (Δ₊ − Δ₋)`, with Δ the slope of a segment, 0 beyond the ends (de Boor, A Practical Guide to Splines,
    /// chapter IV).
    ///
    /// # Panics
    /// There is no key.
    pub fn new(keys: &[(f64, DVec3)]) -> Spline {
        let n = keys.len();
        let width = |k: usize| keys[k + 1].0 - keys[k].0;
        let slope = |k: usize| (keys[k + 1].1 - keys[k].1) / width(k);

        // forward sweep of the Thomas algorithm: M_k = rhs_k − upper_k M_{k+1}
        let mut upper = vec![0.0; n];
        let mut m = vec![DVec3::ZERO; n];
        for k in 0..n {
            let (h_before, slope_before) = if k == 0 { (0.0, DVec3::ZERO) } else { (width(k - 1), slope(k - 1)) };
            let (h_after, slope_after) = if k == n - 1 { (0.0, DVec3::ZERO) } else { (width(k), slope(k)) };
            let rhs = 6.0 * (slope_after - slope_before);
            let (eliminated, carried) =
                if k == 0 { (0.0, DVec3::ZERO) } else { (h_before * upper[k - 1], h_before * m[k - 1]) };
            let pivot = 2.0 * (h_before + h_after) - eliminated;
            upper[k] = h_after / pivot;
            m[k] = (rhs - carried) / pivot;
        }
        for k in (0..n - 1).rev() {
            m[k] = m[k] - upper[k] * m[k + 1];
        }

        let segments = (0..n - 1)
            .map(|k| Segment {
                position: keys[k].1,
                velocity: slope(k) - (2.0 * m[k] + m[k + 1]) * (width(k) / 6.0),
                acceleration: m[k],
                jerk: (m[k + 1] - m[k]) / width(k),
            })
            .collect();
        Spline::of(keys, segments, Jumps::Nothing)
    }

    /// Straight lines between `keys`, each at constant speed: the velocity jumps at the keys.
    ///
    /// # Panics
    /// There is no key.
    pub fn linear(keys: &[(f64, DVec3)]) -> Spline {
        let line = |ends: &[(f64, DVec3)]| Segment {
            position: ends[0].1,
            velocity: (ends[1].1 - ends[0].1) / (ends[1].0 - ends[0].0),
            acceleration: DVec3::ZERO,
            jerk: DVec3::ZERO,
        };
        Spline::of(keys, keys.windows(2).map(line).collect(), Jumps::Velocity)
    }

    /// Stays at each key until the next: the position jumps at the keys.
    ///
    /// # Panics
    /// There is no key.
    pub fn hold(keys: &[(f64, DVec3)]) -> Spline {
        let still = |ends: &[(f64, DVec3)]| Segment {
            position: ends[0].1,
            velocity: DVec3::ZERO,
            acceleration: DVec3::ZERO,
            jerk: DVec3::ZERO,
        };
        Spline::of(keys, keys.windows(2).map(still).collect(), Jumps::Position)
    }

    fn of(keys: &[(f64, DVec3)], segments: Arc<[Segment]>, jumps: Jumps) -> Spline {
        let times: Arc<[f64]> = keys.iter().map(|key| key.0).collect();
        let mut hasher = FxHasher::default();
        times.iter().for_each(|time| hasher.write_u64(time.to_bits()));
        let [first, last] = [0, keys.len() - 1].map(|key| keys[key].1);
        Spline { times, times_hash: hasher.finish(), segments, first, last, jumps }
    }

    /// Number of keys.
    pub fn key_count(&self) -> usize {
        self.times.len()
    }

    fn moved_by(&self, offset: DVec3) -> Spline {
        let moved = |segment: &Segment| Segment { position: segment.position + offset, ..*segment };
        Spline {
            segments: self.segments.iter().map(moved).collect(),
            first: self.first + offset,
            last: self.last + offset,
            ..self.clone()
        }
    }

    fn at(&self, t: f64) -> Kinematics {
        self.on(self.times.partition_point(|&key| key <= t), t)
    }

    /// The state at `t`, where `keys_passed` keys have been passed. Before the first key and after the last, it is at
    /// rest.
    fn on(&self, keys_passed: usize, t: f64) -> Kinematics {
        let still = |position| Kinematics { position, velocity: DVec3::ZERO, acceleration: DVec3::ZERO };
        match keys_passed {
            0 => still(self.first),
            n if n == self.times.len() => still(self.last),
            n => {
                let Segment { position, velocity, acceleration, jerk } = self.segments[n - 1];
                let s = t - self.times[n - 1];
                Kinematics {
                    position: position + s * (velocity + s * (acceleration / 2.0 + s * jerk / 6.0)),
                    velocity: velocity + s * (acceleration + s * jerk / 2.0),
                    acceleration: acceleration + s * jerk,
                }
            }
        }
    }

    fn bounds(&self, start: f64, end: f64) -> Bounds {
        let stretch = self.stretch(start, end);
        if self.jumps == Jumps::Position {
            return Bounds { speed: self.jump_speed(stretch, start, end), acceleration: 0.0 };
        }
        segment_bounds(&self.times, stretch, |k| self.segments[k], start, end)
    }

    /// The speed that covers the distance of all jumps in `(start, end]`, at the keys of these segments, within half of
    /// that interval [scene unit/s].
    fn jump_speed(&self, stretch: Range<usize>, start: f64, end: f64) -> f64 {
        let inside = |k: &usize| start < self.times[*k] && self.times[*k] <= end;
        let position = |k: usize| self.segments.get(k).map_or(self.last, |segment| segment.position);
        let before = |k: usize| if k == 0 { self.first } else { position(k - 1) };
        let keys = (stretch.start..stretch.end + 2).filter(|&k| k < self.times.len());
        let far: f64 = keys.filter(inside).map(|k| position(k).distance(before(k))).sum();
        if far > 0.0 { 2.0 * far / (end - start) } else { 0.0 }
    }

    /// The segments that overlap `[start, end]`.
    fn stretch(&self, start: f64, end: f64) -> Range<usize> {
        let first = self.times.partition_point(|&key| key <= start).saturating_sub(1);
        let beyond = self.times.partition_point(|&key| key <= end);
        first..beyond.min(self.times.len() - 1)
    }

    /// [`Path::relative_bounds`] for two splines; `None` if their keys are not at the same times.
    fn relative_bounds(&self, other: &Spline, start: f64, end: f64) -> Option<Bounds> {
        let between = |k: usize| {
            let (a, b) = (self.segments[k], other.segments[k]);
            Segment {
                position: a.position - b.position,
                velocity: a.velocity - b.velocity,
                acceleration: a.acceleration - b.acceleration,
                jerk: a.jerk - b.jerk,
            }
        };
        let are_held = [self, other].iter().any(|spline| spline.jumps == Jumps::Position);
        if are_held || self.times_hash != other.times_hash || self.times.len() != other.times.len() {
            return None;
        }
        // guards against a hash collision where it would matter; comparing all times would be slow
        let stretch = self.stretch(start, end);
        let (first, last) = (stretch.start, stretch.end.max(stretch.start));
        let is_same = stretch == other.stretch(start, end) && self.times[first..=last] == other.times[first..=last];
        is_same.then(|| segment_bounds(&self.times, stretch, between, start, end))
    }
}

/// [`Path::bounds`] of a spline with keys at `times`, from its segments there.
fn segment_bounds(
    times: &[f64],
    stretch: Range<usize>,
    segment: impl Fn(usize) -> Segment,
    start: f64,
    end: f64,
) -> Bounds {
    let mut bounds = Bounds { speed: 0.0, acceleration: 0.0 };
    for k in stretch {
        let from = f64::max(start, times[k]) - times[k];
        let to = f64::min(end, times[k + 1]) - times[k];
        if from > to {
            continue;
        }
        // acceleration is linear in t, so largest at an end; the speed changes by at most that times the elapsed time
        let Segment { velocity, acceleration, jerk, .. } = segment(k);
        let ends = [from, to].map(|s| (acceleration + s * jerk).length());
        let largest = f64::max(ends[0], ends[1]);
        let velocity = velocity + from * (acceleration + from * jerk / 2.0);
        bounds.acceleration = bounds.acceleration.max(largest);
        bounds.speed = bounds.speed.max(velocity.length() + largest * (to - from));
    }
    bounds
}

#[cfg(test)]
mod tests {
    use super::*;

    fn through(values: &[f64]) -> Vec<(f64, DVec3)> {
        values.iter().enumerate().map(|(t, &x)| (t as f64, DVec3::X * x)).collect()
    }

    /// The example of the module's documentation: between the keys at 1 s and 2 s, the position is 1 + ¾ s (1 − s)²,
    /// where s is the time since 1 s.
    #[test]
    fn a_spline_overshoots_as_documented() {
        let path = Path::Keyframes(Spline::new(&through(&[0.0, 1.0, 1.0])));
        for k in 0..=100 {
            let s = f64::from(k) / 100.0;
            let expected = 1.0 + 0.75 * s * (1.0 - s) * (1.0 - s);
            assert!((path.position(1.0 + s).x - expected).abs() < 1e-15);
        }
        assert!((path.position(4.0 / 3.0).x - 10.0 / 9.0).abs() < 1e-15);
    }

    #[test]
    fn lines_and_holds_stay_within_their_keys() {
        let (lines, holds) = (Spline::linear(&through(&[0.0, 1.0, 1.0])), Spline::hold(&through(&[0.0, 1.0, 5.0])));
        let (lines, holds) = (Path::Keyframes(lines), Path::Keyframes(holds));
        assert_eq!([0.25, 1.0, 1.5, 7.0].map(|t| lines.position(t).x), [0.25, 1.0, 1.0, 1.0]);
        assert_eq!([0.0, 1.0, 2.0].map(|t| lines.kick(t).x), [1.0, -1.0, 0.0]);
        assert_eq!(lines.kicks(0.5, 2.0), 1.0);
        assert_eq!([-1.0, 0.5, 1.0, 1.5, 2.0, 3.0].map(|t| holds.position(t).x), [0.0, 0.0, 1.0, 1.0, 5.0, 5.0]);
        assert_eq!(holds.before(1.0).position.x, 0.0);
        assert_eq!(holds.bounds(1.0, 1.5).speed, 0.0);
        for (start, end) in [(0.5, 1.5), (0.5, 1.0), (0.9, 1.1), (0.5, 4.5), (1.5, 2.5)] {
            let (centre, radius) = holds.ball(start, end);
            for k in 0..=100 {
                let t = start + (end - start) * f64::from(k) / 100.0;
                assert!(holds.position(t).distance(centre) <= radius * (1.0 + 1e-12), "{start} {end} {t}");
            }
        }
    }
}
