//! One number for the exact state of a world, so that two runs can be compared step by step.

use rapidhash::v3::{RapidSecrets, rapidhash_v3_inline};

use super::{World, arrays::Vectors};
use crate::model::phase::Phase;

impl World {
    /// A hash of the exact state: number of steps taken, the bits of what is kept of every body that is not at rest, and
    /// every pair that is not apart.
    ///
    /// Equal runs have equal checksums on every machine, whatever is looked at or recorded; different states differ but
    /// for one chance in 2⁶⁴.
    pub fn checksum(&self) -> u64 {
        let mut hash = combine(0, self.step);
        for active in self.actives.iter().filter(|active| !active.is_at_rest()) {
            hash = combine(hash, u64::from(active.body));
            hash = combine(hash, active.common_as_of);
            let common = &active.common;
            for state in [common.carried.x, common.carried.u] {
                hash = combine(hash, bits(&state.to_array()));
            }
            for pushed in &common.pushed {
                hash = combine(hash, bits(&[pushed.x, pushed.u]));
            }
            let (front, swinging) = (&active.deformation.front, &active.deformation.swinging);
            for vectors in [&front.displacement, &front.velocity, &swinging.displacement, &swinging.velocity] {
                let Vectors { x, y, z } = vectors;
                for axis in [x, y, z] {
                    hash = combine(hash, bits(axis));
                }
            }
        }
        for pair in self.pairs.all(&self.bodies).filter(|pair| pair.phase != Phase::Apart) {
            let core = u64::from(pair.phase == Phase::Core);
            hash = combine(hash, u64::from(pair.a) << 32 | u64::from(pair.b));
            hash = combine(hash, core);
        }
        hash
    }
}

/// The hash of a sequence that goes on with `next`.
fn combine(hash: u64, next: u64) -> u64 {
    rapid(bytemuck::cast_slice(&[hash.to_le(), next.to_le()]))
}

/// The hash of the bits of numbers. (On a big-endian machine it would be another one, which a replay says.)
fn bits(numbers: &[f64]) -> u64 {
    rapid(bytemuck::cast_slice(numbers))
}

/// Unrolled for long inputs; nobody chooses states to make them collide.
fn rapid(bytes: &[u8]) -> u64 {
    const SECRETS: RapidSecrets = RapidSecrets::seed(0);
    rapidhash_v3_inline::<true, false, false>(bytes, &SECRETS)
}
