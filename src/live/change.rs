//! What a page asks for, and why it does not get it.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::observe::{Branch, Poke, Variation};

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

impl Change {
    /// What it varies.
    pub fn variation(&self) -> Variation {
        Variation { values: self.values.clone(), branches: self.branches.clone(), poke: self.poke.clone() }
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
