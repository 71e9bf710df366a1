//! Disjoint sets of integers, with the usual forest and path halving.

/// A partition of the integers below a count. The least element of a set represents it, so that results do not depend
/// on the order in which sets are joined.
#[derive(Clone, Default)]
pub(crate) struct DisjointSets {
    parent: Vec<u32>,
    /// Number of sets.
    pub count: usize,
}

impl DisjointSets {
    /// Sets of one element each.
    pub fn singletons(count: usize) -> DisjointSets {
        let mut sets = DisjointSets::default();
        sets.add(count);
        sets
    }

    /// Makes sets of one element each.
    pub fn reset(&mut self, count: usize) {
        self.parent.clear();
        self.count = 0;
        self.add(count);
    }

    /// Adds elements, each a set of its own, and returns the first.
    pub fn add(&mut self, count: usize) -> u32 {
        let first = self.parent.len() as u32;
        self.parent.extend(first..first + count as u32);
        self.count += count;
        first
    }

    /// The least element of the set of an element.
    pub fn least(&mut self, mut element: u32) -> u32 {
        while self.parent[element as usize] != element {
            self.parent[element as usize] = self.parent[self.parent[element as usize] as usize];
            element = self.parent[element as usize];
        }
        element
    }

    /// Joins the sets of two elements.
    pub fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.least(a), self.least(b));
        if a != b {
            self.parent[a.max(b) as usize] = a.min(b);
            self.count -= 1;
        }
    }

    /// The least element of the set of every element.
    pub fn all_least(&mut self) -> Vec<u32> {
        (0..self.parent.len() as u32).map(|element| self.least(element)).collect()
    }
}
