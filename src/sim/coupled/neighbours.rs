//! The neighbours of a body.

use glam::DVec3;

/// What neighbours were found for.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::sim) struct FatBounds {
    /// Where the centre was [scene unit].
    pub centre: DVec3,
    /// How far it may get from there [scene unit].
    pub skin: f64,
    /// How far vertices may be from it [scene unit].
    pub extent: f64,
}

/// A nearby body.
#[derive(Clone, Copy, Debug)]
pub(in crate::sim) struct Neighbour {
    /// Index of the body.
    pub other: u32,
    /// Index of the pair.
    pub pair: u32,
}
