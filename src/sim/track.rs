//! What is known of the frame of a body in the course of a step: where its centre is, how that moves, how the rest shape is
//! turned. All who step or look at a world ask this and not what the scene says of a body's motion.

use glam::{DQuat, DVec3};

use crate::scene::path::{Bounds, Kinematics, Path};

/// The frame of a body, at any time in a step.
#[derive(Clone, Copy, Debug)]
pub enum Track<'a> {
    /// Of a body on a prescribed path: exact, at any time, and never turned.
    Prescribed(&'a Path),
}

impl<'a> From<&'a Path> for Track<'a> {
    fn from(path: &'a Path) -> Track<'a> {
        Track::Prescribed(path)
    }
}

impl<'a> Track<'a> {
    /// The centre and its motion at time `t` [s]; where a derivative jumps, that after it.
    #[inline]
    pub fn at(self, t: f64) -> Kinematics {
        match self {
            Track::Prescribed(path) => path.at(t),
        }
    }

    /// The same just before `t` [s].
    pub fn before(self, t: f64) -> Kinematics {
        match self {
            Track::Prescribed(path) => path.before(t),
        }
    }

    /// The centre at time `t` [s, scene unit].
    #[inline]
    pub fn position(self, t: f64) -> DVec3 {
        match self {
            Track::Prescribed(path) => path.position(t),
        }
    }

    /// What turns the rest shape at time `t` [s].
    pub fn rotation(self, _t: f64) -> DQuat {
        match self {
            Track::Prescribed(_) => DQuat::IDENTITY,
        }
    }

    /// Bounds of the motion of the centre over `[start, end]` [s].
    pub fn bounds(self, start: f64, end: f64) -> Bounds {
        match self {
            Track::Prescribed(path) => path.bounds(start, end),
        }
    }

    /// Bounds of its motion relative to another over `[start, end]` [s]: tighter than the sum of the two where both move
    /// alike.
    pub fn relative_bounds(self, other: Track<'_>, start: f64, end: f64) -> Bounds {
        match (self, other) {
            (Track::Prescribed(path), Track::Prescribed(other)) => path.relative_bounds(other, start, end),
        }
    }

    /// Instants at which a derivative of the motion jumps [s], ascending.
    pub fn breaks(self) -> &'a [f64] {
        match self {
            Track::Prescribed(path) => path.knots(),
        }
    }

    /// A ball that the centre is in throughout `[start, end]` [s]: its centre and radius [scene unit].
    pub fn ball(self, start: f64, end: f64) -> (DVec3, f64) {
        match self {
            Track::Prescribed(path) => path.ball(start, end),
        }
    }

    /// How far apart two places of the centre can be at the most [scene unit].
    pub fn extent(self) -> f64 {
        match self {
            Track::Prescribed(path) => path.extent(),
        }
    }

    /// The path that it follows exactly for ever, if it does.
    pub fn path(self) -> Option<&'a Path> {
        match self {
            Track::Prescribed(path) => Some(path),
        }
    }

    /// Whether the centre does not move within `[start, end]` [s], nor anything about its motion changes there.
    pub fn is_still(self, start: f64, end: f64) -> bool {
        match self {
            Track::Prescribed(path) => path.is_still(start, end),
        }
    }

    /// Whether the body never moves.
    pub fn is_fixed(self) -> bool {
        match self {
            Track::Prescribed(path) => path.is_fixed(),
        }
    }

    /// Until when it is known [s]: the end of the step, unless it is prescribed.
    pub fn known_until(self) -> f64 {
        match self {
            Track::Prescribed(_) => f64::INFINITY,
        }
    }
}
