//! The neighbours of a body, and the fat bounds for which they are valid.

use glam::DVec3;

/// The limits within which a body's neighbours are complete.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::sim) struct FatBounds {
    /// Centre when the neighbours were found [scene unit].
    pub centre: DVec3,
    /// Largest allowed displacement of the centre from there [scene unit].
    pub skin: f64,
    /// Largest allowed distance of a vertex from the centre [scene unit].
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
