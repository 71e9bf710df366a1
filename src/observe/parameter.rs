//! The parameters of an experiment, and what can be varied in it.

use std::collections::BTreeMap;

use glam::DVec3;

/// A number that an experiment can be started with in place of its own.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// Its key, unique in the experiment.
    pub key: String,
    /// What it belongs to, for a heading.
    pub group: String,
    /// Its name on a page, below the heading.
    pub label: String,
    /// Its unit; empty for a pure number.
    pub unit: String,
    /// What it is, in a sentence.
    pub about: String,
    /// The experiment's own value.
    pub value: f64,
    /// Ends of the range that is usual, for a slider; other values may be valid too.
    pub range: [f64; 2],
    /// Whether it can take another value within a run: see [`Variation::branches`].
    pub can_branch: bool,
}

/// What is varied in an experiment.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Variation {
    /// Values of parameters by key, from the start.
    pub values: BTreeMap<String, f64>,
    /// Values from an instant on, in order of time.
    pub branches: Vec<Branch>,
    /// A force that acts on a body, if the experiment knows such a thing.
    pub poke: Option<Poke>,
}

/// Values that parameters take from an instant on.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "viewer", derive(serde::Deserialize, serde::Serialize), serde(deny_unknown_fields))]
pub struct Branch {
    /// The instant [s].
    pub time: f64,
    /// Values by key.
    pub values: BTreeMap<String, f64>,
}

/// A force point that acts on one body.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "viewer", derive(serde::Deserialize, serde::Serialize), serde(deny_unknown_fields))]
pub struct Poke {
    /// Name of the body.
    pub body: String,
    /// Where it is [scene unit].
    pub at: DVec3,
    /// Radius of a body with the same influence sphere [scene unit].
    pub radius: f64,
    /// Strength of its attraction; negative: of its repulsion [1/s²].
    pub strength: f64,
}

impl Variation {
    /// Whether nothing is varied.
    pub fn is_empty(&self) -> bool {
        self.values.is_empty() && self.branches.is_empty() && self.poke.is_none()
    }
}

/// Why an experiment cannot be varied like this.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{text}")]
pub struct InvalidVariation {
    /// The key that is at fault, if it is a single one.
    pub key: Option<String>,
    /// What is wrong, and what would be right.
    pub text: String,
}
