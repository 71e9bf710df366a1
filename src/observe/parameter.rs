//! The parameters of an experiment.

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
}

/// Why an experiment cannot have these values.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{text}")]
pub struct InvalidVariation {
    /// The key that is at fault, if it is a single one.
    pub key: Option<String>,
    /// What is wrong, and what would be right.
    pub text: String,
}
