//! Bodies made of cells: `[lattice]` and `[fem]`.

/// Default number of cells along a body's diameter: a sphere of 266 vertices gets about 300 nodes.
pub const ACROSS: u32 = 6;
/// The largest number of cells along a diameter.
pub const MOST_ACROSS: u32 = 256;

/// Lattices of masses and springs: `[lattice]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lattice {
    /// Number of cells along a body's diameter.
    pub cells: u32,
    /// How a body tears.
    pub tear: TearMode,
    /// Strain at which a body tears [–], > 0.
    pub limit: f64,
}

impl Default for Lattice {
    fn default() -> Lattice {
        Lattice { cells: ACROSS, tear: TearMode::None, limit: 0.5 }
    }
}

named! {
    /// How a lattice tears.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
    pub enum TearMode {
        /// It does not tear.
        #[default]
        None = "none",
        /// Overstretched springs are cut with their cells; volume is lost.
        Cut = "cut",
        /// Overloaded nodes are split; volume is kept.
        Split = "split",
    }
}

/// Finite elements: `[fem]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fem {
    /// Number of cells along a body's diameter.
    pub cells: u32,
    /// Young's modulus [mass/(scene unit · s²)], > 0; `None`: such that a bar one radius long has the body's ω.
    pub young: Option<f64>,
    /// Poisson's ratio [–], below 1/2.
    pub poisson: f64,
    /// Tension above which tearing is reported [mass/(scene unit · s²)], if at all.
    pub tear_stress: Option<f64>,
}

impl Default for Fem {
    fn default() -> Fem {
        Fem { cells: ACROSS, young: None, poisson: 0.25, tear_stress: None }
    }
}
