//! The bodies near a body, and for how long the list is valid.

/// Another body that is near this one.
#[derive(Clone, Copy, Debug)]
pub(super) struct Neighbour {
    /// Index of the other body.
    pub other: u32,
    /// Index of the pair.
    pub pair: u32,
    /// Where the law of the pair is among those of the scene.
    pub law: u32,
    /// A bound of the acceleration of any vertex of this body by the other's sphere, in any phase [scene unit/s²].
    pub pull: f64,
}

/// What a body's fat bounds allow for.
#[derive(Clone, Copy, Debug)]
pub(super) struct FatBounds {
    /// Largest distance of its vertices from its centre [scene unit].
    pub vertices: f64,
    /// How far its centre may move [scene unit].
    pub skin: f64,
    /// Time until which its centre stays within the bounds [s].
    pub until: f64,
}

impl FatBounds {
    pub const NONE: FatBounds = FatBounds { vertices: 0.0, skin: 0.0, until: f64::NEG_INFINITY };
}
