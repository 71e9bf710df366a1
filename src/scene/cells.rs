//! Bodies made of cells: `[lattice]` and `[fem]`.

/// The cells along a body's diameter of scenes that do not say: a sphere of 266 vertices gets some 300 nodes.
pub const ACROSS: u32 = 6;
/// The most cells along a diameter.
pub const MOST_ACROSS: u32 = 256;

/// Lattices of masses and springs: `[lattice]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lattice {
    /// Number of cells along a body's diameter.
    pub cells: u32,
    /// How it tears.
    pub tear: TearMode,
    /// The strain at which it does [–], > 0.
    pub limit: f64,
}

impl Default for Lattice {
    fn default() -> Lattice {
        Lattice { cells: ACROSS, tear: TearMode::None, limit: 0.5 }
    }
}

/// How a lattice tears.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TearMode {
    /// Not at all.
    #[default]
    None,
    /// Springs that are too long are cut with their cells; volume is lost.
    Cut,
    /// Nodes that are pulled too hard are split; volume is kept.
    Split,
}

impl TearMode {
    /// All of them, in the order in which they are listed to users.
    pub const ALL: [TearMode; 3] = [TearMode::None, TearMode::Cut, TearMode::Split];

    /// The name in scene files.
    pub fn name(self) -> &'static str {
        match self {
            TearMode::None => "none",
            TearMode::Cut => "cut",
            TearMode::Split => "split",
        }
    }
}

/// Finite elements: `[fem]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fem {
    /// Number of cells along a body's diameter.
    pub cells: u32,
    /// Young's modulus [mass/(scene unit · s²)], > 0; `None`: such that a bar as long as the body's radius has its ω.
    pub young: Option<f64>,
    /// Poisson's ratio [–], below 1/2.
    pub poisson: f64,
    /// The tension beyond which a body would tear [mass/(scene unit · s²)], if that is looked for.
    pub tear_stress: Option<f64>,
}

impl Default for Fem {
    fn default() -> Fem {
        Fem { cells: ACROSS, young: None, poisson: 0.25, tear_stress: None }
    }
}
