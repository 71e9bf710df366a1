//! What a page asks for, and why it does not get it.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::observe::{self, Variation};

/// What a page asks for: a variation of the experiment, and the step that it shows.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Change {
    /// Values of parameters by key.
    pub values: BTreeMap<String, f64>,
    /// Values from an instant on.
    pub branches: Vec<Branch>,
    /// A force point that acts on a body.
    pub poke: Option<Poke>,
    /// The step under the time cursor.
    pub cursor: u64,
    /// The page that asks; it knows the change already.
    pub page: String,
}

/// See [`observe::Branch`].
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Branch {
    /// The instant [s].
    pub time: f64,
    /// Values by key.
    pub values: BTreeMap<String, f64>,
}

/// See [`observe::Poke`].
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Poke {
    /// Name of the body.
    pub body: String,
    /// Where it is [scene unit].
    pub at: [f64; 3],
    /// Its radius [scene unit].
    pub radius: f64,
    /// Strength of its attraction [1/s²].
    pub strength: f64,
}

impl Change {
    /// What it varies.
    pub fn variation(&self) -> Variation {
        let branch = |Branch { time, values }: &Branch| observe::Branch { time: *time, values: values.clone() };
        let poke = |Poke { body, at, radius, strength }: &Poke| observe::Poke {
            body: body.clone(),
            at: (*at).into(),
            radius: *radius,
            strength: *strength,
        };
        Variation {
            values: self.values.clone(),
            branches: self.branches.iter().map(branch).collect(),
            poke: self.poke.as_ref().map(poke),
        }
    }
}

/// Why a change has no run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Problem {
    /// The key that is at fault, if it is a single one.
    pub key: Option<String>,
    /// What is wrong, and what would be right.
    pub text: String,
}

impl Problem {
    /// A problem of no single key.
    pub fn new(text: impl Into<String>) -> Problem {
        Problem { key: None, text: text.into() }
    }
}
