//! The bodies that are not at rest: awake ones, and those that sleep because nothing acts on them.

use super::body::{Active, Body};
use crate::scene::Scene;

/// The states of the bodies that are not at rest. Only this type moves them and sets [`Body::active`], their index
/// here.
#[derive(Clone, Default)]
pub(in crate::sim) struct ActiveSet {
    /// Awake bodies first, then sleeping ones.
    states: Vec<Active>,
    awake: usize,
}

impl ActiveSet {
    /// The bodies that are stepped.
    pub fn awake(&self) -> &[Active] {
        &self.states[..self.awake]
    }

    /// The bodies that are stepped, mutable.
    pub fn awake_mut(&mut self) -> &mut [Active] {
        &mut self.states[..self.awake]
    }

    /// All bodies of the set; lets tests put them into any state.
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

    /// Marks body `index` as awake: it is stepped from now on. `step` is the number of steps taken.
    pub fn wake(&mut self, scene: &Scene, bodies: &mut [Body], index: usize, step: u64) {
        match bodies[index].active.map(|slot| slot as usize) {
            None => self.insert(bodies, Active::new(scene, index, step)),
            Some(slot) if slot >= self.awake => {
                self.swap(bodies, slot, self.awake);
                self.awake += 1;
            }
            Some(_) => {}
        }
    }

    /// Adds a body that is not at rest, awake.
    pub fn insert(&mut self, bodies: &mut [Body], active: Active) {
        let (index, slot) = (active.body as usize, self.states.len());
        bodies[index].active = Some(slot as u32);
        self.states.push(active);
        self.swap(bodies, slot, self.awake);
        self.awake += 1;
    }

    /// Drops the state of a body: it is at rest.
    pub fn drop_state(&mut self, bodies: &mut [Body], index: usize) {
        let Some(slot) = bodies[index].active else { return };
        let mut slot = slot as usize;
        if slot < self.awake {
            self.awake -= 1;
            self.swap(bodies, slot, self.awake);
            slot = self.awake;
        }
        self.swap(bodies, slot, self.states.len() - 1);
        self.states.pop();
        bodies[index].active = None;
    }

    /// Forgets a body without a state; the indices of later ones decrease by one.
    pub fn renumber(&mut self, removed: u32) {
        let shift = |index: &mut u32| *index -= u32::from(*index > removed);
        for active in &mut self.states {
            shift(&mut active.body);
            let (references, reachable) = (&mut active.chosen.references, &mut active.bounds.reachable);
            references.retain(|reference| reference.body != removed);
            references.iter_mut().for_each(|reference| shift(&mut reference.body));
            reachable.retain(|neighbour| neighbour.other != removed);
            reachable.iter_mut().for_each(|neighbour| shift(&mut neighbour.other));
        }
    }

    /// Wakes all bodies of the set.
    pub fn wake_all(&mut self) {
        self.awake = self.states.len();
    }

    /// Puts the awake bodies to sleep for which `may_sleep` holds: they are no longer stepped. Bodies at rest drop
    /// their state.
    pub fn sleep(&mut self, bodies: &mut [Body], may_sleep: impl Fn(&[Body], &Active) -> bool) {
        for slot in (0..self.awake).rev() {
            if may_sleep(bodies, &self.states[slot]) {
                let active = &self.states[slot];
                if active.is_at_rest() {
                    self.drop_state(bodies, active.body as usize);
                } else {
                    self.awake -= 1;
                    self.swap(bodies, slot, self.awake);
                }
            }
        }
    }

    fn swap(&mut self, bodies: &mut [Body], a: usize, b: usize) {
        self.states.swap(a, b);
        for slot in [a, b] {
            bodies[self.states[slot].body as usize].active = Some(slot as u32);
        }
    }

    /// Sum of the hashes of all bodies in the set.
    pub fn hash(&self) -> u64 {
        self.states.iter().map(Active::hash).fold(0, u64::wrapping_add)
    }
}
