//! Hashes for [`Simulation::checksum`](crate::observe::Simulation::checksum): equal for equal sequences of words, different for
//! different ones (barring collisions).

/// The hash of a sequence; 0 for the empty one.
pub fn sequence(words: impl IntoIterator<Item = u64>) -> u64 {
    words.into_iter().fold(0, followed_by)
}

/// The hash of a sequence extended by `next`.
pub fn followed_by(hash: u64, next: u64) -> u64 {
    mix(hash ^ mix(next.wrapping_add(SEED)))
}

/// The bits of a number, without the sign of zero.
pub fn bits(number: f64) -> u64 {
    (number + 0.0).to_bits()
}

/// An arbitrary number without a simple pattern: 2⁶⁴ over the golden ratio.
pub(crate) const SEED: u64 = 0x9e37_79b9_7f4a_7c15;

/// Makes every bit of the result depend on every bit of the input, one-to-one (the finalizer of `SplitMix64`, Steele et
/// al. 2014, in Stafford's variant 13).
#[inline(always)]
pub(crate) const fn mix(hash: u64) -> u64 {
    let hash = (hash ^ hash >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let hash = (hash ^ hash >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    hash ^ hash >> 31
}
