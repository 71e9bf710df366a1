//! The frame of a body during a step: position and motion of its centre, and rotation of its rest shape. Integrators
//! and observers use tracks only, not the motion that the scene prescribes.

use glam::{DQuat, DVec3};

use crate::scene::path::{Bounds, Kinematics, Path};

/// The frame of a body, at any time in a step.
#[derive(Clone, Copy, Debug)]
pub enum Track<'a> {
    /// Of a body on a prescribed path: exact, at any time, and never turned.
    Prescribed(&'a Path),
    /// Of one that jumps from place to place, between two jumps [scene unit].
    Held(DVec3),
}

impl<'a> From<&'a Path> for Track<'a> {
    fn from(path: &'a Path) -> Track<'a> {
        Track::Prescribed(path)
    }
}

impl<'a> Track<'a> {
    /// The same between two breaks: what jumps at `start` has done so, what jumps at `end` has not [s].
    #[inline]
    pub fn between(self, start: f64, end: f64) -> Track<'a> {
        match self {
            Track::Prescribed(path) if path.is_held() => Track::Held(path.position(start + 0.5 * (end - start))),
            _ => self,
        }
    }

    /// Whether the centre jumps from place to place at breaks.
    pub fn is_held(self) -> bool {
        matches!(self, Track::Prescribed(path) if path.is_held())
    }

    /// By how much the velocity jumps at time `t` [scene unit/s].
    pub fn kick(self, t: f64) -> DVec3 {
        match self {
            Track::Prescribed(path) => path.kick(t),
            Track::Held(_) => DVec3::ZERO,
        }
    }

    /// The centre and its motion at time `t` [s]; where a derivative jumps, that after it.
    #[inline]
    pub fn at(self, t: f64) -> Kinematics {
        match self {
            Track::Prescribed(path) => path.at(t),
            Track::Held(position) => Kinematics { position, velocity: DVec3::ZERO, acceleration: DVec3::ZERO },
        }
    }

    /// The same just before `t` [s].
    pub fn before(self, t: f64) -> Kinematics {
        match self {
            Track::Prescribed(path) => path.before(t),
            Track::Held(position) => Kinematics { position, velocity: DVec3::ZERO, acceleration: DVec3::ZERO },
        }
    }

    /// The centre at time `t` [s, scene unit].
    #[inline]
    pub fn position(self, t: f64) -> DVec3 {
        match self {
            Track::Prescribed(path) => path.position(t),
            Track::Held(position) => position,
        }
    }

    /// What turns the rest shape at time `t` [s].
    pub fn rotation(self, _t: f64) -> DQuat {
        match self {
            Track::Prescribed(_) | Track::Held(_) => DQuat::IDENTITY,
        }
    }

    /// Bounds of the motion of the centre over `[start, end]` [s].
    pub fn bounds(self, start: f64, end: f64) -> Bounds {
        match self {
            Track::Prescribed(path) => path.bounds(start, end),
            Track::Held(_) => Bounds { speed: 0.0, acceleration: 0.0 },
        }
    }

    /// Bounds of its motion relative to another over `[start, end]` [s]: tighter than the sum of the two where both move
    /// alike.
    pub fn relative_bounds(self, other: Track<'_>, start: f64, end: f64) -> Bounds {
        match (self, other) {
            (Track::Prescribed(path), Track::Prescribed(other)) => path.relative_bounds(other, start, end),
            (Track::Held(_), track) | (track, Track::Held(_)) => track.bounds(start, end),
        }
    }

    /// Instants at which a derivative of the motion jumps [s], ascending.
    pub fn breaks(self) -> &'a [f64] {
        match self {
            Track::Prescribed(path) => path.knots(),
            Track::Held(_) => &[],
        }
    }

    /// A ball that the centre is in throughout `[start, end]` [s]: its centre and radius [scene unit].
    pub fn ball(self, start: f64, end: f64) -> (DVec3, f64) {
        match self {
            Track::Prescribed(path) => path.ball(start, end),
            Track::Held(position) => (position, 0.0),
        }
    }

    /// How far apart two places of the centre can be at the most [scene unit].
    pub fn extent(self) -> f64 {
        match self {
            Track::Prescribed(path) => path.extent(),
            Track::Held(_) => 0.0,
        }
    }

    /// The path that it follows exactly for ever, if it does.
    pub fn path(self) -> Option<&'a Path> {
        match self {
            Track::Prescribed(path) => Some(path),
            Track::Held(_) => None,
        }
    }

    /// Whether the centre does not move within `[start, end]` [s], nor anything about its motion changes there.
    pub fn is_still(self, start: f64, end: f64) -> bool {
        match self {
            Track::Prescribed(path) => path.is_still(start, end),
            Track::Held(_) => true,
        }
    }

    /// Whether the body never moves.
    pub fn is_fixed(self) -> bool {
        match self {
            Track::Prescribed(path) => path.is_fixed(),
            Track::Held(_) => true,
        }
    }

    /// Until when it is known [s]: the end of the step, unless it is prescribed.
    pub fn known_until(self) -> f64 {
        match self {
            Track::Prescribed(_) | Track::Held(_) => f64::INFINITY,
        }
    }
}
