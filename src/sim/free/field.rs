//! What acts on bodies.

use glam::DVec3;

use crate::model::{
    influence::{Scaling, Weight},
    phase::{Phase, Thresholds},
    shape_matching::{CoreRim, Plane},
};

/// What acts beyond pairs, and what all pairs have in common.
#[derive(Clone, Debug)]
pub struct Field {
    /// Acceleration of free bodies [scene unit/s²].
    pub gravity: DVec3,
    /// On every vertex of every body.
    pub planes: Vec<Plane>,
    /// On single bodies.
    pub pushes: Vec<Push>,
    /// r_e / R [–].
    pub reach: f64,
    /// The shape of the influence (3.3).
    pub weight: Weight,
    /// Dependence of strengths on sizes.
    pub scaling: Scaling,
    /// Instants at which a derivative of a path jumps [s], ascending.
    pub breaks: Vec<f64>,
}

impl Default for Field {
    fn default() -> Field {
        Field {
            gravity: DVec3::ZERO,
            planes: Vec::new(),
            pushes: Vec::new(),
            reach: std::f64::consts::SQRT_2,
            weight: Weight::Linear,
            scaling: Scaling::Relative,
            breaks: Vec::new(),
        }
    }
}

/// A push (Fig. 4.1) of the vertices of a body that face it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Push {
    /// Index of the body.
    pub body: u32,
    /// Unit vector.
    pub direction: DVec3,
    /// [scene unit/s²]
    pub strength: f64,
    /// [s]; it acts during [start, end).
    pub start: f64,
    /// [s]
    pub end: f64,
}

/// Two bodies that can touch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair {
    /// Index of one body …
    pub a: u32,
    /// … and of the other.
    pub b: u32,
    /// What they do to each other now.
    pub phase: Phase,
    /// When that changes, and how strong it is.
    pub law: PairLaw,
}

/// What a pair does by its phase.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PairLaw {
    /// α [1/s²].
    pub alpha: f64,
    /// β [1/s²].
    pub beta: f64,
    /// Whether it repels while it is apart.
    pub apart_repels: bool,
    /// When its phase changes.
    pub thresholds: Thresholds,
    /// Over how much of q the strength changes about the rim of the core [–]; 0: it jumps.
    pub core_width: f64,
}

impl PairLaw {
    /// How the strength changes about the rim of the core in a phase, if it does so gradually.
    pub fn rim(&self, phase: Phase) -> Option<CoreRim> {
        let PairLaw { alpha, beta, thresholds, core_width: width, .. } = *self;
        let is_gradual = width > 0.0 && phase != Phase::Apart;
        is_gradual.then_some(CoreRim { alpha, beta, core_at: thresholds.core_at, width })
    }

    /// The strength between bodies of the same size, `q` apart [1/s²].
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

impl Field {
    /// By how much the strength of a pair differs for the body of size `radius`, the other being of size `source`.
    pub fn scale(&self, radius: f64, source: f64) -> f64 {
        match self.scaling {
            Scaling::Absolute => 1.0,
            Scaling::Relative => f64::min(1.0, radius / source),
        }
    }

    /// The next instant after `t` at which something jumps, whatever bodies do [s].
    pub(super) fn next_break(&self, t: f64) -> f64 {
        let edges = self.pushes.iter().flat_map(|push| [push.start, push.end]);
        edges.chain(self.breaks.iter().copied()).filter(|&edge| edge > t).fold(f64::INFINITY, f64::min)
    }
}

/// Where a body on a prescribed path is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Driven {
    /// c [scene unit]
    pub position: DVec3,
    /// c′ [scene unit/s]
    pub velocity: DVec3,
    /// What the body feels of its own motion, by its response [scene unit/s²].
    pub carry: DVec3,
}

/// Where bodies on prescribed paths are.
pub trait Paths: Sync {
    /// At `t` [s]; just before it, should something jump there, if `before`.
    fn at(&self, body: usize, t: f64, before: bool) -> Driven;
}

/// For bodies of which none has one.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoPaths;

impl Paths for NoPaths {
    fn at(&self, _: usize, _: f64, _: bool) -> Driven {
        Driven::default()
    }
}

impl<F: Fn(usize, f64, bool) -> Driven + Sync> Paths for F {
    fn at(&self, body: usize, t: f64, before: bool) -> Driven {
        self(body, t, before)
    }
}
