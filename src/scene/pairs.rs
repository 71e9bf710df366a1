//! The laws of pairs that have their own: `[[pair]]`.

use std::collections::{HashMap, hash_map::Entry};

use rustc_hash::FxBuildHasher;

use crate::model::PairLaw;

/// Which bodies one side of a `[[pair]]` names.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Members {
    /// The body of this index.
    Body(u32),
    /// All bodies of a group, counted in the order in which the bodies of the scene name them.
    Group(u32),
}

/// The laws of pairs that differ from the scene's, looked up by body or group: as small as the file that gives them,
/// however many pairs they are of.
#[derive(Clone, Debug, Default)]
pub struct PairLaws {
    laws: Vec<PairLaw>,
    /// Index of the law of two sides, the lesser one first.
    by_members: HashMap<[Members; 2], u32, FxBuildHasher>,
    /// The group of each body that is in one, `[body_count]`; empty if no group has a law.
    group_of: Vec<Option<u32>>,
}

/// Two `[[pair]]`s that give a pair different laws, by their index.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Contradiction {
    /// The one that comes first.
    pub earlier: usize,
    /// The other.
    pub later: usize,
}

impl PairLaws {
    /// The laws of all pairs of a body of one side and one of the other, by these rules; `group_of` has the group of each
    /// body.
    ///
    /// # Errors
    /// Two rules give some pair different laws.
    pub fn new(group_of: Vec<Option<u32>>, rules: &[([Members; 2], PairLaw)]) -> Result<PairLaws, Contradiction> {
        let mut laws = PairLaws { laws: rules.iter().map(|rule| rule.1).collect(), group_of, ..PairLaws::default() };
        for (index, &(sides, law)) in rules.iter().enumerate() {
            match laws.by_members.entry(sorted(sides)) {
                Entry::Vacant(place) => _ = place.insert(index as u32),
                Entry::Occupied(found) => differ(rules, *found.get() as usize, index, law)?,
            }
        }
        laws.check(rules)?;
        Ok(laws)
    }

    /// Looks for pairs that two rules with different sides are of.
    fn check(&self, rules: &[([Members; 2], PairLaw)]) -> Result<(), Contradiction> {
        // Rules of a body and a group, by the groups of both: each of those that name a body of one shares a pair with
        // each of those that name a body of the other. For either side, one rule, and one with another law.
        let mut mixed: HashMap<[u32; 2], [[Option<usize>; 2]; 2], FxBuildHasher> = HashMap::default();
        for (index, &(sides, law)) in rules.iter().enumerate() {
            let wider = |side| match side {
                Members::Body(body) => self.group_of[body as usize].map(Members::Group),
                Members::Group(_) => None,
            };
            let [a, b] = sides;
            let all = [[wider(a), Some(b)], [Some(a), wider(b)], [wider(a), wider(b)]];
            for sides in all.into_iter().filter_map(|[a, b]| Some(sorted([a?, b?]))) {
                if let Some(&other) = self.by_members.get(&sides) {
                    differ(rules, other as usize, index, law)?;
                }
            }
            let [Members::Body(body), Members::Group(group)] = sorted(sides) else { continue };
            let Some(own) = self.group_of[body as usize] else { continue };
            let [this, others] = match own.cmp(&group) {
                std::cmp::Ordering::Less => [0, 1],
                std::cmp::Ordering::Equal => [0, 0],
                std::cmp::Ordering::Greater => [1, 0],
            };
            let seen = mixed.entry([own.min(group), own.max(group)]).or_default();
            for other in seen[others].into_iter().flatten() {
                differ(rules, other, index, law)?;
            }
            match seen[this] {
                [None, _] => seen[this][0] = Some(index),
                [Some(first), None] if rules[first].1 != law => seen[this][1] = Some(index),
                _ => {}
            }
        }
        Ok(())
    }

    /// Whether all pairs have the scene's law.
    pub fn is_empty(&self) -> bool {
        self.laws.is_empty()
    }

    /// Every law that a pair can have beside the scene's.
    pub fn laws(&self) -> &[PairLaw] {
        &self.laws
    }

    /// The law of the pair of bodies `a` and `b`, in either order; `None` if it is the scene's.
    pub fn of(&self, a: usize, b: usize) -> Option<PairLaw> {
        Some(self.laws[self.index(a, b)?])
    }

    /// Its index in [`PairLaws::laws`].
    pub fn index(&self, a: usize, b: usize) -> Option<usize> {
        if self.is_empty() {
            return None;
        }
        let [sides_a, sides_b] = [a, b].map(|body| self.sides(body));
        let all = sides_a.into_iter().flatten().flat_map(|a| sides_b.into_iter().flatten().map(move |b| [a, b]));
        all.into_iter().find_map(|sides| self.by_members.get(&sorted(sides)).map(|&index| index as usize))
    }

    /// What a body can be named by.
    fn sides(&self, body: usize) -> [Option<Members>; 2] {
        let group = self.group_of.get(body).copied().flatten();
        [Some(Members::Body(body as u32)), group.map(Members::Group)]
    }

    /// What was allocated for them [bytes].
    pub fn memory(&self) -> usize {
        self.laws.capacity() * size_of::<PairLaw>()
            + self.by_members.capacity() * size_of::<([Members; 2], u32)>()
            + self.group_of.capacity() * size_of::<Option<u32>>()
    }
}

fn differ(rules: &[([Members; 2], PairLaw)], one: usize, other: usize, law: PairLaw) -> Result<(), Contradiction> {
    let (earlier, later) = (one.min(other), one.max(other));
    if rules[one].1 == law { Ok(()) } else { Err(Contradiction { earlier, later }) }
}

/// Bodies before groups.
fn sorted([a, b]: [Members; 2]) -> [Members; 2] {
    if a <= b { [a, b] } else { [b, a] }
}
