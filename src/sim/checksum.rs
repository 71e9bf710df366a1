//! Hash of the exact state of a world, so that two runs can be compared step by step.
//!
//! The hash covers the stored state, even where it is from an earlier step: so observation does not change the hash.
//! Bodies and pairs are hashed separately and their hashes added, so that their order does not matter. Every instruction set gives the same hash because it gives the same
//! state, except for the sign of zero, which has no effect and is ignored.

use super::{
    free::Body,
    numerics::arrays::{Blocks, LANES},
    prescribed::{
        body::Active,
        deformation::{DISPLACEMENT, Deformation, FreeVertices, VELOCITY},
    },
    state::State,
};
use crate::{
    hash::{SEED, bits, mix},
    model::phase::Phase,
};

/// The hash of a world, from the number of steps taken and the sum of the hashes of all stored states.
pub(super) fn of_world(step: u64, sum: u64) -> u64 {
    mix(mix(step.wrapping_add(SEED)).wrapping_add(sum))
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
pub(super) fn of_body(index: u32, body: &Body, others: [u64; 3]) -> u64 {
    let Body { centre, velocity, rotation, spin, x, u, .. } = body;
    let [first, second, third] = others;
    let mut lanes = Lanes::new();
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

impl Active {
    /// A hash of the stored state of a body; 0 for one at rest.
    pub(super) fn hash(&self) -> u64 {
        if self.is_at_rest() {
            return 0;
        }
        let mut lanes = Lanes::new();
        let State { x, u } = self.state.carried;
        let [a, b, c, d, e, f] = [x.x, x.y, x.z, u.x, u.y, u.z].map(bits);
        lanes.add(&[self.state.carried_as_of, self.state.deformation.hash_of_free(), a, b, c, d, e, f], |word| word);
        let active_set = &self.state.deformation.active_set;
        lanes.add_states(&active_set.blocks, &active_set.vertices);
        mix(lanes.hash().wrapping_add(mix(SEED.wrapping_add(u64::from(self.body)))))
    }
}

impl Deformation {
    /// A hash of the free vertices, and of the indices of the active ones.
    fn hash_of_free(&self) -> u64 {
        let FreeVertices { vertices, as_of, blocks, .. } = &self.free_vertices;
        let mut lanes = Lanes::new();
        lanes.add(&[self.active_set.vertices.len() as u64, vertices.len() as u64, *as_of], |word| word);
        for list in [&self.active_set.vertices, vertices] {
            lanes.add(list, u64::from);
        }
        lanes.add_states(blocks, vertices);
        lanes.hash()
    }
}

/// A hash of a sequence of numbers, in parallel lanes like the vertices: one rotation and one addition for several
/// numbers at once. Each update is one-to-one in the old state and in
/// the input.
struct Lanes([u64; LANES]);

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
impl Lanes {
    fn new() -> Lanes {
        let mut lanes = Lanes([SEED; LANES]);
        lanes.add_block(&std::array::from_fn(|lane| (lane as u64).wrapping_mul(SEED)));
        lanes
    }

    #[inline]
    fn add_block(&mut self, block: &[u64; LANES]) {
        for (state, word) in self.0.iter_mut().zip(block) {
            let [low, high] = [*state as u32, (*state >> 32) as u32].map(|half| u64::from(half.rotate_left(ROTATION)));
            *state = (high << 32 | low).wrapping_add(*word);
        }
    }

    #[inline]
    fn add<T: Copy>(&mut self, values: &[T], word: impl Fn(T) -> u64) {
        let (whole, rest) = values.as_chunks::<LANES>();
        whole.iter().for_each(|block| self.add_block(&block.map(&word)));
        if !rest.is_empty() {
            self.add_block(&std::array::from_fn(|lane| rest.get(lane).map_or(0, |&value| word(value))));
        }
    }

    /// Adds the states of `vertices`, without the padding.
    fn add_states<const N: usize>(&mut self, blocks: &Blocks<N>, vertices: &[u32]) {
        for v in [DISPLACEMENT, VELOCITY] {
            for axis in 0..3 {
                for (block, vertices) in blocks.all().iter().zip(vertices.chunks(LANES)) {
                    self.add(&block.0[v][axis][..vertices.len()], bits);
                }
            }
        }
    }

    fn hash(self) -> u64 {
        let word = |(word, factor): (u64, u64)| {
            let word = (word ^ word >> 32).wrapping_mul(factor);
            word ^ word >> 29
        };
        mix(self.0.into_iter().zip(FACTORS).map(word).fold(0, u64::wrapping_add))
    }
}

#[cfg(test)]
mod tests;
