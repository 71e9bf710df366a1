//! Handles of bodies, which stay valid while other bodies come and go.

use super::{report::EditError, world::World};

/// A body of a world, whatever is added or removed beside it. The handle of a body that has been removed is not that of
/// another one, unless the world was [restored](World::restore) to a time before the body was added. It means nothing in
/// another world.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct BodyHandle {
    slot: u32,
    generation: u32,
}

/// What names a body of a world: its [handle](BodyHandle), or its index in the order of the scene, which changes when an
/// earlier body is removed.
pub trait BodyId: Copy {
    /// The index of the body.
    ///
    /// # Errors
    /// There is no such body.
    fn index_in(self, world: &World) -> Result<usize, EditError>;
}

impl BodyId for usize {
    fn index_in(self, world: &World) -> Result<usize, EditError> {
        if self < world.body_count() { Ok(self) } else { Err(EditError::NoBody(self)) }
    }
}

impl BodyId for BodyHandle {
    fn index_in(self, world: &World) -> Result<usize, EditError> {
        world.index_of(self).ok_or(EditError::Stale)
    }
}

/// The handles of the bodies of a world.
#[derive(Clone, Debug, Default)]
pub(super) struct Handles {
    /// Generation of each slot, and the index of its body.
    slots: Vec<(u32, Option<u32>)>,
    /// The slot of each body.
    slot_of: Vec<u32>,
    unused: Vec<u32>,
}

impl Handles {
    /// Those of as many bodies.
    pub fn new(count: usize) -> Handles {
        let indices = 0..count as u32;
        Handles {
            slots: indices.clone().map(|index| (0, Some(index))).collect(),
            slot_of: indices.collect(),
            unused: Vec::new(),
        }
    }

    /// The handle of the body at an index.
    pub fn of(&self, index: usize) -> Option<BodyHandle> {
        let slot = *self.slot_of.get(index)?;
        Some(BodyHandle { slot, generation: self.slots[slot as usize].0 })
    }

    /// The index of a body.
    pub fn index(&self, handle: BodyHandle) -> Option<usize> {
        let &(generation, index) = self.slots.get(handle.slot as usize)?;
        index.filter(|_| generation == handle.generation).map(|index| index as usize)
    }

    /// Adds a last body.
    pub fn push(&mut self) -> BodyHandle {
        let index = self.slot_of.len() as u32;
        let slot = self.unused.pop().unwrap_or(self.slots.len() as u32);
        if slot as usize == self.slots.len() {
            self.slots.push((0, None));
        }
        let (generation, of_slot) = &mut self.slots[slot as usize];
        *of_slot = Some(index);
        self.slot_of.push(slot);
        BodyHandle { slot, generation: *generation }
    }

    /// Removes a body; the indices of later ones decrease by one.
    pub fn remove(&mut self, index: usize) {
        let slot = self.slot_of.remove(index);
        let (generation, of_slot) = &mut self.slots[slot as usize];
        *of_slot = None;
        // a slot whose generations are used up is never used again
        if let Some(next) = generation.checked_add(1) {
            *generation = next;
            self.unused.push(slot);
        }
        for &slot in &self.slot_of[index..] {
            if let (_, Some(index)) = &mut self.slots[slot as usize] {
                *index -= 1;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn handles_stay_valid_and_are_never_used_again() {
        let mut handles = Handles::new(3);
        let [a, b, c] = [0, 1, 2].map(|index| handles.of(index).unwrap());
        handles.remove(1);
        assert_eq!([a, b, c].map(|handle| handles.index(handle)), [Some(0), None, Some(1)]);
        let d = handles.push();
        assert_eq!([a, b, c, d].map(|handle| handles.index(handle)), [Some(0), None, Some(1), Some(2)]);
        assert_eq!(handles.of(2), Some(d));
        handles.remove(0);
        handles.remove(1);
        assert_eq!([a, b, c, d].map(|handle| handles.index(handle)), [None, None, Some(0), None]);
        assert_eq!(handles.of(1), None);
    }
}
