//! The frame of a body during a step: position and motion of its centre, and rotation of its rest shape. Integrators
//! and observers use tracks only, not the motion that the scene prescribes.

use glam::{DQuat, DVec3};

use crate::scene::path::{Bounds, Kinematics, Path};

/// The frame of a body, at any time in a step.
#[derive(Clone, Copy, Debug)]
pub enum Track<'a> {
    /// A prescribed path: exact at any time, without rotation.
    Prescribed(&'a Path),
    /// Centre of a body that jumps between positions, valid between two jumps [scene unit].
    Held(DVec3),
}

impl<'a> From<&'a Path> for Track<'a> {
    fn from(path: &'a Path) -> Track<'a> {
        Track::Prescribed(path)
    }
}

impl<'a> Track<'a> {
    /// The track between two breaks [s]: after any jump at `start`, before any jump at `end`.
    #[inline]
    pub fn between(self, start: f64, end: f64) -> Track<'a> {
        match self {
            Track::Prescribed(path) if path.is_held() => Track::Held(path.position(start + 0.5 * (end - start))),
            _ => self,
        }
    }

    /// Whether the centre jumps between positions at breaks.
    pub fn is_held(self) -> bool {
        matches!(self, Track::Prescribed(path) if path.is_held())
    }

    /// The jump of the velocity at time `t` [scene unit/s].
    pub fn kick(self, t: f64) -> DVec3 {
        match self {
            Track::Prescribed(path) => path.kick(t),
            Track::Held(_) => DVec3::ZERO,
        }
    }

    /// The centre and its motion at time `t` [s]; where a derivative jumps, the right limit.
    #[inline]
    pub fn at(self, t: f64) -> Kinematics {
        match self {
            Track::Prescribed(path) => path.at(t),
            Track::Held(position) => Kinematics { position, velocity: DVec3::ZERO, acceleration: DVec3::ZERO },
        }
    }

    /// Like [`Track::at`], but the left limit at `t` [s].
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

    /// Rotation of the rest shape at time `t` [s].
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

    /// Bounds of the motion relative to another track over `[start, end]` [s]: tighter than the sum of both where the
    /// two move alike.
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

    /// Upper bound of the distance between any two positions of the centre [scene unit].
    pub fn extent(self) -> f64 {
        match self {
            Track::Prescribed(path) => path.extent(),
            Track::Held(_) => 0.0,
        }
    }

    /// The path that the centre follows exactly and for all time, if there is one.
    pub fn path(self) -> Option<&'a Path> {
        match self {
            Track::Prescribed(path) => Some(path),
            Track::Held(_) => None,
        }
    }

    /// Whether neither the centre nor its motion changes within `[start, end]` [s].
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

    /// End of the interval on which the track is defined [s]; prescribed tracks have none.
    pub fn known_until(self) -> f64 {
        match self {
            Track::Prescribed(_) | Track::Held(_) => f64::INFINITY,
        }
    }
}
