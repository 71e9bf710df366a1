//! The law of a pair: its strengths and thresholds.

use super::{
    phase::{Phase, Thresholds},
    shape_matching::CoreRim,
};

/// The law of a pair: strengths by phase, and the thresholds between the phases.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PairLaw {
    /// Strength α of attraction [1/s²].
    pub alpha: f64,
    /// Strength β of repulsion [1/s²].
    pub beta: f64,
    /// Whether the pair repels while it is apart.
    pub apart_repels: bool,
    /// The thresholds at which the phase changes.
    pub thresholds: Thresholds,
    /// Width in q of the change of strength at the rim of the core [–]; 0 for a jump.
    pub core_width: f64,
    /// Which settings of the core apply only to pairs with a free body.
    pub for_free: ForFree,
}

/// Which settings of a [`PairLaw`] apply only to pairs with a free body; pairs of bodies on paths then have none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ForFree {
    /// Nothing: all pairs have the same core.
    #[default]
    Nothing,
    /// The width of the rim.
    Width,
    /// The core, with its width by default.
    Core,
    /// The core, with a width that the scene sets.
    CoreOfWidth,
}

impl PairLaw {
    /// The law of scenes that do not set one.
    pub const DEFAULT: PairLaw = PairLaw {
        alpha: 100.0,
        beta: 60.0,
        apart_repels: true,
        thresholds: Thresholds { merge_at: 1.05, split_at: 1.15, core_at: 0.0 },
        core_width: 0.0,
        for_free: ForFree::Nothing,
    };
    /// Where the core of a pair with a free body begins by default [merge_at].
    pub const FREE_CORE_AT: f64 = 0.76;
    /// The default width of the rim of its core [core_at].
    pub const FREE_CORE_WIDTH: f64 = 0.5;

    /// The law of a pair with or without a free body.
    pub fn of_pair(mut self, has_free: bool) -> PairLaw {
        let for_free = std::mem::take(&mut self.for_free);
        if !has_free && matches!(for_free, ForFree::Core | ForFree::CoreOfWidth) {
            self.thresholds.core_at = 0.0;
        }
        if !has_free && for_free != ForFree::Nothing {
            self.core_width = 0.0;
        }
        self
    }

    /// The gradual rim of the core in a phase, if there is one.
    pub fn rim(&self, phase: Phase) -> Option<CoreRim> {
        let PairLaw { alpha, beta, thresholds, core_width: width, .. } = *self;
        let is_gradual = width > 0.0 && phase != Phase::Apart;
        is_gradual.then_some(CoreRim { alpha, beta, core_at: thresholds.core_at, width })
    }

    /// Whether the strength is continuous at the transition between two phases.
    pub fn is_gradual(&self, from: Phase, to: Phase) -> bool {
        self.rim(from).is_some() && self.rim(to).is_some()
    }

    /// The q at which a pair in this phase enters or leaves its core without a jump of the strength [–].
    pub fn gradual_level(&self, phase: Phase) -> Option<f64> {
        self.rim(phase).map(|rim| rim.core_at).filter(|&level| level > 0.0)
    }

    /// The strength between bodies of equal size at centre distance `q` [1/s²].
    pub fn strength(&self, phase: Phase, q: f64) -> f64 {
        match (self.rim(phase), phase) {
            (Some(rim), _) => rim.strength(q),
            (None, Phase::Merged) => self.alpha,
            (None, Phase::Core) => -self.beta,
            (None, Phase::Apart) if self.apart_repels => -self.beta,
            (None, Phase::Apart) => 0.0,
        }
    }
}
