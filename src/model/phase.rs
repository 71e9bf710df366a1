//! Pair phases: which of (3.4) and (3.5) acts between two bodies, as a state machine on their distance.
//!
//! The thesis switches "according to the distance between the objects" without giving the distance. Here the
//! switch is on `q`, the centre distance over the sum of the radii, with hysteresis:
//!
//! ```text
//! apart  → merged   when q falls to merge_at        merged → apart   when q rises to split_at
//! merged → core     when q falls below core_at      core   → merged  when q rises to core_at
//! ```

use std::fmt;

/// The state of a pair of bodies, determined by the distance of their centres with hysteresis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Phase {
    /// Repels by (3.5), or does nothing.
    Apart,
    /// Attracts by (3.4).
    Merged,
    /// Overlaps deeply: repels by (3.5), so that the bodies swell instead of shrinking.
    Core,
}

impl Phase {
    /// All phases, the deepest last, by their indices in events.
    pub const ALL: [Phase; 3] = [Phase::Apart, Phase::Merged, Phase::Core];

    /// The name used in recordings and messages.
    pub fn name(self) -> &'static str {
        match self {
            Phase::Apart => "apart",
            Phase::Merged => "merged",
            Phase::Core => "core",
        }
    }
}

impl fmt::Display for Phase {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// The distances at which a pair changes phase, each as `q`: centre distance over the sum of the radii [–].
///
/// Invariant, established by the scene parser: `core_at < merge_at ≤ split_at`, all finite, `core_at ≥ 0`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Thresholds {
    /// An apart pair merges when q falls to this [–].
    pub merge_at: f64,
    /// A merged pair splits when q rises to this [–].
    pub split_at: f64,
    /// A merged pair enters its core when q falls below this [–]; 0 if there is no core.
    pub core_at: f64,
}

/// A transition out of a phase: the level of `q`, the direction in which it is crossed, and the phase that follows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transition {
    /// The threshold, in q [–].
    pub level: f64,
    /// Whether q falls through the level (true) or rises through it (false).
    pub falling: bool,
    /// The phase that follows.
    pub to: Phase,
}

impl Transition {
    /// Whether its level lies strictly behind a pair at distance `q`.
    pub fn is_passed(&self, q: f64) -> bool {
        if self.falling { q < self.level } else { q > self.level }
    }
}

impl Thresholds {
    /// The phase of a pair that starts at distance `q`.
    pub fn initial(&self, q: f64) -> Phase {
        if q < self.core_at {
            Phase::Core
        } else if q <= self.merge_at {
            Phase::Merged
        } else {
            Phase::Apart
        }
    }

    /// The phase that a pair in `phase` enters at distance `q` after a jump of q or of the thresholds.
    pub fn next(&self, phase: Phase, q: f64) -> Option<Phase> {
        let Thresholds { merge_at, split_at, core_at } = *self;
        match phase {
            Phase::Apart => (q <= merge_at).then_some(Phase::Merged),
            Phase::Merged if q < core_at => Some(Phase::Core),
            Phase::Merged => (q >= split_at && q > merge_at).then_some(Phase::Apart),
            Phase::Core => (q >= core_at).then_some(Phase::Merged),
        }
    }

    /// The transitions out of `phase`. Without a core (`core_at` = 0) the second transition out of `Merged` is absent.
    pub fn transitions(&self, phase: Phase) -> impl Iterator<Item = Transition> + use<> {
        let fall = |level, to| Some(Transition { level, falling: true, to });
        let rise = |level, to| Some(Transition { level, falling: false, to });
        let core = self.core_at > 0.0;
        match phase {
            Phase::Apart => [fall(self.merge_at, Phase::Merged), None],
            Phase::Merged => {
                [rise(self.split_at, Phase::Apart), if core { fall(self.core_at, Phase::Core) } else { None }]
            }
            Phase::Core => [rise(self.core_at, Phase::Merged), None],
        }
        .into_iter()
        .flatten()
    }
}
