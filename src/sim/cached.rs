//! Hashes that are kept until what they cover has changed.

use std::sync::OnceLock;

/// A hash, or a sum of hashes, that is computed when it is first requested. Whoever changes what it covers either gives
/// the difference or lets it be forgotten.
#[derive(Clone, Debug, Default)]
pub struct Cached(OnceLock<u64>);

impl Cached {
    /// The hash, computed by `hash` if it is not known.
    pub fn get(&self, hash: impl FnOnce() -> u64) -> u64 {
        *self.0.get_or_init(hash)
    }

    /// The hash, if it is known.
    pub fn known(&self) -> Option<u64> {
        self.0.get().copied()
    }

    /// What it covers has changed.
    pub fn forget(&mut self) {
        self.0.take();
    }

    /// A sum has lost the summand `before` and got the summand `after`.
    pub fn exchange(&mut self, before: impl FnOnce() -> u64, after: impl FnOnce() -> u64) {
        if let Some(sum) = self.0.get_mut() {
            *sum = sum.wrapping_sub(before()).wrapping_add(after());
        }
    }
}
