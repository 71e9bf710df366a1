//! Hash of the exact state of a world, so that two runs can be compared step by step.
//!
//! The hash covers the stored state, even where it is from an earlier step: so observation does not change the hash,
//! and its cost scales with the bodies that are stepped. Bodies and pairs are hashed separately and their hashes added,
//! so that unchanged ones need not be hashed again. Every instruction set gives the same hash because it gives the same
//! state, except for the sign of zero, which has no effect and is ignored.

use pulp::{Arch, Simd, WithSimd, bytemuck};

use super::{
    arrays::LANES,
    body::Active,
    deformation::{DISPLACEMENT, Deformation, FreeVertices, VELOCITY},
    free::Body,
    pairs::Pair,
    state::State,
};
use crate::{
    model::phase::Phase,
    observe::checksum::{SEED, bits, mix},
};

/// The sum of the hashes of bodies; a body at rest adds nothing.
pub(super) fn of_bodies(arch: Arch, bodies: &[Active]) -> u64 {
    arch.dispatch(Bodies(bodies))
}

/// The hash of a world, from the number of steps taken and the sum of the hashes of all stored states.
pub(super) fn of_world(step: u64, sum: u64) -> u64 {
    mix(mix(step.wrapping_add(SEED)).wrapping_add(sum))
}

/// The sum of the hashes of bodies.
struct Bodies<'a>(&'a [Active]);

impl WithSimd for Bodies<'_> {
    type Output = u64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> u64 {
        // not a closure, which would not inherit the target features
        let mut sum = 0u64;
        for active in self.0 {
            sum = sum.wrapping_add(active.hash(simd));
        }
        sum
    }
}

/// A hash of a pair in a phase; 0 if it is apart, like pairs that are not listed.
pub(super) fn of_pair(a: u32, b: u32, phase: Phase) -> u64 {
    let phase = match phase {
        Phase::Apart => return 0,
        Phase::Merged => 1,
        Phase::Core => 2,
    };
    mix(mix(u64::from(a) << 32 | u64::from(b)).wrapping_add(phase))
}

/// A hash of the state of a body of a coupled scene, and of `others`, further words of its state.
pub(super) fn of_body(arch: Arch, index: u32, body: &Body, others: [u64; 3]) -> u64 {
    arch.dispatch(Coupled { index, body, others })
}

struct Coupled<'a> {
    index: u32,
    body: &'a Body,
    others: [u64; 3],
}

impl WithSimd for Coupled<'_> {
    type Output = u64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> u64 {
        let Coupled { index, body, others: [first, second, third] } = self;
        let Body { centre, velocity, rotation, spin, x, u, .. } = body;
        let mut lanes = Lanes::new(simd);
        lanes.add(&[x.len() as u64, first, second, third], |word| word);
        for vector in [centre, velocity, spin] {
            lanes.add(&vector.to_array(), bits);
        }
        lanes.add(&rotation.to_array(), bits);
        for vectors in [x, u] {
            for axis in 0..3 {
                lanes.add(vectors, |vector| bits(vector[axis]));
            }
        }
        mix(lanes.hash().wrapping_add(mix(SEED.wrapping_add(u64::from(index)))))
    }
}

impl Active {
    /// A hash of the stored state of a body; 0 for one at rest.
    #[inline(always)]
    fn hash<S: Simd>(&self, simd: S) -> u64 {
        if self.is_at_rest() {
            return 0;
        }
        let mut lanes = Lanes::new(simd);
        let State { x, u } = self.state.common.carried;
        let [a, b, c, d, e, f] = [x.x, x.y, x.z, u.x, u.y, u.z].map(bits);
        lanes.add(&[self.state.common_as_of, self.state.deformation.hash_of_kept(simd), a, b, c, d, e, f], |word| word);
        for pushed in &self.state.common.pushed {
            lanes.add(&[pushed.x, pushed.u], bits);
        }
        let active_set = &self.state.deformation.active_set;
        if let Some((end, whole)) = active_set.blocks.all().split_last() {
            let last = (active_set.vertices.len() - 1) % LANES + 1;
            for v in [DISPLACEMENT, VELOCITY] {
                for axis in 0..3 {
                    for block in whole {
                        lanes.add_numbers(&block.0[v][axis]);
                    }
                    lanes.add_first(&end.0[v][axis], last);
                }
            }
        }
        mix(lanes.hash().wrapping_add(mix(SEED.wrapping_add(u64::from(self.body)))))
    }
}

impl Deformation {
    /// A hash of the part that is constant from step to step, cached until it changes: the free vertices, and the
    /// indices of the active ones.
    #[inline(always)]
    fn hash_of_kept<S: Simd>(&self, simd: S) -> u64 {
        if let Some(hash) = self.hash_of_kept.known() {
            return hash;
        }
        let FreeVertices { vertices, as_of, blocks, .. } = &self.free_vertices;
        let mut lanes = Lanes::new(simd);
        lanes.add(&[self.active_set.vertices.len() as u64, vertices.len() as u64, *as_of], |word| word);
        for list in [&self.active_set.vertices, vertices] {
            lanes.add(list, u64::from);
        }
        for v in [DISPLACEMENT, VELOCITY] {
            for axis in 0..3 {
                for (block, vertices) in blocks.all().iter().zip(vertices.chunks(LANES)) {
                    lanes.add(&block.0[v][axis][..vertices.len()], bits);
                }
            }
        }
        self.hash_of_kept.get(|| lanes.hash())
    }
}

impl Pair {
    /// A hash of the pair and its phase; 0 if it is apart, like pairs that are not listed.
    pub fn hash(&self) -> u64 {
        of_pair(self.a, self.b, self.phase)
    }
}

/// A hash of a sequence of numbers, in parallel lanes like the vertices: one rotation and one addition for several
/// numbers at once, which costs little compared with computing them. Each update is one-to-one in the old state and in
/// the input.
struct Lanes<S: Simd> {
    simd: S,
    /// The first `LANES / S::U64_LANES` are used.
    state: [S::u64s; LANES],
}

/// Number of bits by which the two halves of a number are rotated. Among odd numbers, it is one of those for which a
/// bit takes the longest to return near its original position.
const ROTATION: u32 = 15;
/// One odd factor per lane, so that lanes cannot be swapped and changes in several lanes cannot cancel.
const FACTORS: [u64; LANES] = {
    let mut factors = [0; LANES];
    let mut lane = 0;
    while lane < LANES {
        factors[lane] = mix(SEED.wrapping_add(lane as u64)) | 1;
        lane += 1;
    }
    factors
};
/// Masks: ones for a whole block, then zeros for another.
const MASKS: [f64; 2 * LANES] = {
    let mut masks = [0.0; 2 * LANES];
    let mut lane = 0;
    while lane < LANES {
        masks[lane] = f64::from_bits(u64::MAX);
        lane += 1;
    }
    masks
};

impl<S: Simd> Lanes<S> {
    const REGISTERS: usize = LANES / S::U64_LANES;

    #[inline(always)]
    fn new(simd: S) -> Lanes<S> {
        let mut lanes = Lanes { simd, state: [simd.splat_u64s(SEED); LANES] };
        lanes.add_block(&std::array::from_fn(|lane| (lane as u64).wrapping_mul(SEED)));
        lanes
    }

    #[inline(always)]
    fn rotate(&self, words: S::u64s) -> S::u64s {
        let simd = self.simd;
        if S::U64_LANES == 1 {
            let word: u64 = bytemuck::cast(words);
            let [low, high] = [word as u32, (word >> 32) as u32].map(|half| u64::from(half.rotate_left(ROTATION)));
            return bytemuck::cast(high << 32 | low);
        }
        let halves: S::u32s = bytemuck::cast(words);
        let left = simd.wrapping_dyn_shl_u32s(halves, simd.splat_u32s(ROTATION));
        let right = simd.wrapping_dyn_shr_u32s(halves, simd.splat_u32s(32 - ROTATION));
        bytemuck::cast(simd.or_u32s(left, right))
    }

    #[inline(always)]
    fn add_block(&mut self, block: &[u64; LANES]) {
        let (words, _) = S::as_simd_u64s(block);
        for register in 0..Self::REGISTERS {
            self.state[register] = self.simd.add_u64s(self.rotate(self.state[register]), words[register]);
        }
    }

    #[inline(always)]
    fn add<T: Copy>(&mut self, values: &[T], word: impl Fn(T) -> u64) {
        for block in values.chunks(LANES) {
            self.add_block(&std::array::from_fn(|lane| block.get(lane).map_or(0, |&value| word(value))));
        }
    }

    #[inline(always)]
    fn add_numbers(&mut self, numbers: &[f64; LANES]) {
        let simd = self.simd;
        let zero = simd.splat_f64s(0.0);
        let (numbers, _) = S::as_simd_f64s(numbers);
        for register in 0..Self::REGISTERS {
            let words = bytemuck::cast(simd.add_f64s(numbers[register], zero));
            self.state[register] = simd.add_u64s(self.rotate(self.state[register]), words);
        }
    }

    /// Adds the first `count` numbers of the last block; the rest is padding.
    #[inline(always)]
    fn add_first(&mut self, numbers: &[f64; LANES], count: usize) {
        let simd = self.simd;
        let zero = simd.splat_f64s(0.0);
        let ((numbers, _), (masks, _)) =
            (S::as_simd_f64s(numbers), S::as_simd_f64s(&MASKS[LANES - count..2 * LANES - count]));
        for register in 0..Self::REGISTERS {
            let words = bytemuck::cast(simd.and_f64s(simd.add_f64s(numbers[register], zero), masks[register]));
            self.state[register] = simd.add_u64s(self.rotate(self.state[register]), words);
        }
    }

    #[inline(always)]
    fn hash(self) -> u64 {
        let mut words = [0u64; LANES];
        let (registers, _) = S::as_mut_simd_u64s(&mut words);
        registers.copy_from_slice(&self.state[..Self::REGISTERS]);
        let mut hash = 0u64;
        for (lane, word) in words.into_iter().enumerate() {
            let word = (word ^ word >> 32).wrapping_mul(FACTORS[lane]);
            hash = hash.wrapping_add(word ^ word >> 29);
        }
        mix(hash)
    }
}

#[cfg(test)]
mod tests;
