//! The bodies that are not at rest: those that are stepped, and those that nothing acts on.

use std::sync::OnceLock;

use pulp::Arch;

use super::{
    body::{Active, Body},
    checksum,
};
use crate::scene::Scene;

/// The states of the bodies that are not at rest. It alone moves them and says in [`Body::active`] where they are, so that it
/// knows when what it remembers of them for the checksum no longer holds.
pub(super) struct ActiveSet {
    /// First those that are awake, then those that sleep.
    states: Vec<Active>,
    awake: usize,
    arch: Arch,
    /// Sum of the hashes of those that sleep, once it was asked for.
    hash_of_sleeping: OnceLock<u64>,
}

impl ActiveSet {
    /// None.
    pub fn new(arch: Arch) -> ActiveSet {
        ActiveSet { states: Vec::new(), awake: 0, arch, hash_of_sleeping: OnceLock::new() }
    }

    /// Those that are stepped.
    pub fn awake(&self) -> &[Active] {
        &self.states[..self.awake]
    }

    /// Those that are stepped.
    pub fn awake_mut(&mut self) -> &mut [Active] {
        &mut self.states[..self.awake]
    }

    /// All of them, in whatever state tests want them.
    #[cfg(test)]
    pub fn all_mut(&mut self) -> &mut [Active] {
        &mut self.states
    }

    /// The state of a body, if it is not at rest.
    pub fn get(&self, body: &Body) -> Option<&Active> {
        self.states.get(body.active? as usize)
    }

    /// Whether a body is stepped.
    pub fn is_awake(&self, body: &Body) -> bool {
        body.active.is_some_and(|slot| (slot as usize) < self.awake)
    }

    /// From here on body `index` is stepped; `step` is the number of steps taken.
    pub fn wake(&mut self, scene: &Scene, bodies: &mut [Body], index: usize, step: u64) {
        let slot = bodies[index].active.map_or(self.states.len(), |slot| slot as usize);
        if slot == self.states.len() {
            self.states.push(Active::new(scene, index, bodies[index].pushes.len(), step));
            bodies[index].active = Some(slot as u32);
        }
        if slot >= self.awake {
            if let Some(&sum) = self.hash_of_sleeping.get() {
                self.hash_of_sleeping = OnceLock::from(sum.wrapping_sub(self.hash_of(slot)));
            }
            self.swap(bodies, slot, self.awake);
            self.awake += 1;
        }
    }

    /// From here on those that are awake and for which `may_sleep` holds are not stepped; those at rest need no state.
    pub fn sleep(&mut self, bodies: &mut [Body], may_sleep: impl Fn(&[Body], &Active) -> bool) {
        for slot in (0..self.awake).rev() {
            if may_sleep(bodies, &self.states[slot]) {
                self.sleep_one(bodies, slot);
            }
        }
    }

    fn sleep_one(&mut self, bodies: &mut [Body], slot: usize) {
        self.awake -= 1;
        self.swap(bodies, slot, self.awake);
        if let Some(&sum) = self.hash_of_sleeping.get() {
            self.hash_of_sleeping = OnceLock::from(sum.wrapping_add(self.hash_of(self.awake)));
        }
        if self.states[self.awake].is_at_rest() {
            self.swap(bodies, self.awake, self.states.len() - 1);
            if let Some(active) = self.states.pop() {
                bodies[active.body as usize].active = None;
            }
        }
    }

    fn swap(&mut self, bodies: &mut [Body], a: usize, b: usize) {
        self.states.swap(a, b);
        for slot in [a, b] {
            bodies[self.states[slot].body as usize].active = Some(slot as u32);
        }
    }

    /// The sum of the hashes of all of them.
    pub fn hash(&self) -> u64 {
        let (awake, asleep) = self.states.split_at(self.awake);
        let asleep = self.hash_of_sleeping.get_or_init(|| checksum::of_bodies(self.arch, asleep));
        checksum::of_bodies(self.arch, awake).wrapping_add(*asleep)
    }

    fn hash_of(&self, slot: usize) -> u64 {
        checksum::of_bodies(self.arch, std::slice::from_ref(&self.states[slot]))
    }

    /// What was allocated for them [bytes].
    pub fn memory(&self) -> usize {
        self.states.iter().map(Active::memory).sum::<usize>() + self.states.capacity() * size_of::<Active>()
    }
}
