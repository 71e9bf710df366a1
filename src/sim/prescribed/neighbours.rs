//! The neighbours of a body, and the fat bounds for which they are valid.

use smallvec::SmallVec;

/// The nearby bodies of one, ascending. A few are stored beside what is known of the body: in large scenes a step waits for
/// memory, and each list of its own is another place.
pub(in crate::sim) type Neighbours = SmallVec<[Neighbour; 3]>;

/// A nearby body, or a force point.
#[derive(Clone, Copy, Debug)]
pub(in crate::sim) struct Neighbour {
    /// Index of the other body; force points follow the bodies.
    pub other: u32,
    /// Index of the pair, or [`Neighbour::POINT`].
    pub pair: u32,
    /// Index of the pair's law in the scene.
    pub law: u32,
    /// A bound on the acceleration of any vertex of this body by the other's sphere, in any phase [scene unit/s²].
    pub pull: f64,
    /// Whether the other's sphere acts on this body in every phase of the pair.
    pub always_acts: bool,
}

impl Neighbour {
    /// In place of the index of a pair, for a force point.
    pub const POINT: u32 = u32::MAX;

    /// Whether it is a force point.
    pub fn is_point(&self) -> bool {
        self.pair == Neighbour::POINT
    }
}

/// The limits within which a body's neighbours are complete.
#[derive(Clone, Copy, Debug)]
pub(in crate::sim) struct FatBounds {
    /// Largest allowed distance of a vertex from the centre [scene unit].
    pub vertices: f64,
    /// Largest allowed displacement of the centre [scene unit].
    pub skin: f64,
    /// Time until which the centre stays within `skin` [s].
    pub until: f64,
}

impl FatBounds {
    pub const NONE: FatBounds = FatBounds { vertices: 0.0, skin: 0.0, until: f64::NEG_INFINITY };
}
