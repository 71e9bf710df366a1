//! Hashes that are cached until what they cover changes.

use std::sync::OnceLock;

/// A hash, or a sum of hashes, that is computed on first request. Code that changes what it covers must call either
/// [`Cached::exchange`] or [`Cached::forget`].
#[derive(Clone, Debug, Default)]
pub struct Cached(OnceLock<u64>);

impl Cached {
    /// The hash, computed by `hash` if it is not cached.
    pub fn get(&self, hash: impl FnOnce() -> u64) -> u64 {
        *self.0.get_or_init(hash)
    }

    /// The hash, if it is cached.
    pub fn known(&self) -> Option<u64> {
        self.0.get().copied()
    }

    /// Drops the cached hash, because what it covers has changed.
    pub fn forget(&mut self) {
        self.0.take();
    }

    /// Replaces the summand `before` by `after` in a cached sum.
    pub fn exchange(&mut self, before: impl FnOnce() -> u64, after: impl FnOnce() -> u64) {
        if let Some(sum) = self.0.get_mut() {
            *sum = sum.wrapping_sub(before()).wrapping_add(after());
        }
    }
}
