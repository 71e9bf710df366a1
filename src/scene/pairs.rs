//! Laws of specific pairs: `[[pair]]`.

use std::collections::HashMap;

use rustc_hash::FxBuildHasher;

use crate::model::PairLaw;

/// The bodies named by one side of a `[[pair]]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Members {
    /// The body of this index.
    Body(u32),
    /// All bodies of a group; groups are numbered in the order in which bodies first name them.
    Group(u32),
}

/// The laws of pairs that differ from the scene's, looked up by body or group. Memory is proportional to the number of
/// rules, not of pairs.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PairLaws {
    laws: Vec<PairLaw>,
    /// Index of the law by its two sides, in ascending order.
    by_members: HashMap<[Members; 2], u32, FxBuildHasher>,
    /// The group of each body, `[body_count]`; empty if there are no rules.
    group_of: Vec<Option<u32>>,
}

/// Two `[[pair]]` tables that apply to the same pair, by index.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Overlap {
    /// The first one.
    pub earlier: usize,
    /// The second one.
    pub later: usize,
}

impl PairLaws {
    /// Builds the lookup from rules, each for all pairs of a body of one side with a body of the other. `group_of` is
    /// the group of each body, `[body_count]`; bodies with the same [`group`](super::Body::group) have the same number.
    ///
    /// # Errors
    /// Two rules apply to the same pair.
    pub fn new(group_of: Vec<Option<u32>>, rules: &[([Members; 2], PairLaw)]) -> Result<PairLaws, Overlap> {
        let overlap = |one: usize, other: usize| Overlap { earlier: one.min(other), later: one.max(other) };
        let mut laws = PairLaws { laws: rules.iter().map(|rule| rule.1).collect(), group_of, ..PairLaws::default() };
        for (index, &(sides, _)) in rules.iter().enumerate() {
            if let Some(found) = laws.by_members.insert(sorted(sides), index as u32) {
                return Err(overlap(found as usize, index));
            }
        }
        // Rules for a body and a group, by the groups of both. A rule that names a body of one group always shares a
        // pair with a rule that names a body of the other.
        let mut mixed: HashMap<[u32; 2], [Option<usize>; 2], FxBuildHasher> = HashMap::default();
        for (index, &(sides, _)) in rules.iter().enumerate() {
            let [a, b] = sorted(sides);
            let [wide_a, wide_b] = [laws.wider(a), laws.wider(b)];
            for wider in [(wide_a, Some(b)), (Some(a), wide_b), (wide_a, wide_b)] {
                if let (Some(a), Some(b)) = wider
                    && let Some(&other) = laws.by_members.get(&sorted([a, b]))
                {
                    return Err(overlap(other as usize, index));
                }
            }
            if let ([Members::Body(_), Members::Group(group)], Some(Members::Group(own))) = ([a, b], wide_a) {
                let side = usize::from(own > group);
                let seen = mixed.entry([own.min(group), own.max(group)]).or_default();
                if let Some(other) = seen[if own == group { side } else { 1 - side }] {
                    return Err(overlap(other, index));
                }
                seen[side].get_or_insert(index);
            }
        }
        Ok(laws)
    }

    /// Appends body `index`, in the group of body `like` if there is one. A group of its own has no law yet.
    pub(super) fn add_body(&mut self, index: usize, like: Option<usize>) {
        if !self.is_empty() {
            self.group_of.resize(index, None);
            self.group_of.push(like.and_then(|body| self.group_of(body)));
        }
    }

    /// Removes a body that no rule names.
    pub(super) fn remove_body(&mut self, index: usize) {
        if index < self.group_of.len() {
            self.group_of.remove(index);
        }
    }

    /// The group of a body, as a side of a rule.
    fn wider(&self, side: Members) -> Option<Members> {
        match side {
            Members::Body(body) => self.group_of(body as usize).map(Members::Group),
            Members::Group(_) => None,
        }
    }

    /// All laws with their sides.
    pub fn rules(&self) -> impl Iterator<Item = ([Members; 2], PairLaw)> + '_ {
        self.by_members.iter().map(|(&sides, &index)| (sides, self.laws[index as usize]))
    }

    /// The group of a body, if it is in one; `None` for all bodies if there are no rules.
    pub fn group_of(&self, body: usize) -> Option<u32> {
        self.group_of.get(body).copied().flatten()
    }

    /// The groups of the first bodies; of others there is none.
    pub(super) fn groups(&self) -> &[Option<u32>] {
        &self.group_of
    }

    /// Whether every pair has the scene's law.
    pub fn is_empty(&self) -> bool {
        self.laws.is_empty()
    }

    /// All laws other than the scene's.
    pub fn laws(&self) -> &[PairLaw] {
        &self.laws
    }

    /// The same thresholds without forces.
    pub fn without_forces(&self) -> PairLaws {
        let law = |law: &PairLaw| PairLaw { alpha: 0.0, beta: 0.0, core_width: 0.0, ..*law };
        PairLaws { laws: self.laws.iter().map(law).collect(), ..self.clone() }
    }

    /// See [`Scene::drop_core_defaults`](super::Scene::drop_core_defaults).
    pub(super) fn drop_core_defaults(&mut self) {
        self.laws.iter_mut().for_each(|law| *law = law.of_pair(false));
    }

    /// The law of the pair of bodies `a` and `b`, in either order; `None` if it is the scene's.
    pub fn of(&self, a: usize, b: usize) -> Option<PairLaw> {
        Some(self.laws[self.index(a, b)?])
    }

    /// Index in [`PairLaws::laws`] of the law of the pair of bodies `a` and `b`, in either order.
    pub fn index(&self, a: usize, b: usize) -> Option<usize> {
        if self.is_empty() {
            return None;
        }
        let [sides_a, sides_b] = [a, b].map(|body| self.sides(body));
        let all = sides_a.into_iter().flatten().flat_map(|a| sides_b.into_iter().flatten().map(move |b| [a, b]));
        all.into_iter().find_map(|sides| self.by_members.get(&sorted(sides)).map(|&index| index as usize))
    }

    /// The sides of rules that a body matches.
    fn sides(&self, body: usize) -> [Option<Members>; 2] {
        [Some(Members::Body(body as u32)), self.group_of(body).map(Members::Group)]
    }
}

/// Sides in ascending order: bodies before groups.
fn sorted([a, b]: [Members; 2]) -> [Members; 2] {
    if a <= b { [a, b] } else { [b, a] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn law(alpha: f64) -> PairLaw {
        PairLaw { alpha, ..PairLaw::DEFAULT }
    }

    /// Six bodies: two in group 0, two in group 1, two in no group.
    const GROUPS: [Option<u32>; 6] = [Some(0), Some(0), Some(1), Some(1), None, None];

    fn members(side: Members) -> Vec<usize> {
        match side {
            Members::Body(body) => vec![body as usize],
            Members::Group(group) => (0..6).filter(|&body| GROUPS[body] == Some(group)).collect(),
        }
    }

    fn pairs(sides: [Members; 2]) -> std::collections::BTreeSet<(usize, usize)> {
        let [a, b] = sides.map(members);
        let all = a.iter().flat_map(|&a| b.iter().map(move |&b| (a.min(b), a.max(b))));
        all.filter(|(a, b)| a != b).collect()
    }

    fn side() -> impl Strategy<Value = Members> {
        prop_oneof![(0..6u32).prop_map(Members::Body), (0..2u32).prop_map(Members::Group)]
    }

    proptest! {
        /// Compares with a table of every pair.
        #[test]
        fn every_pair_has_at_most_one_law(rules in prop::collection::vec([side(), side()], 0..4)) {
            let rules: Vec<_> = rules.into_iter().filter(|sides| !pairs(*sides).is_empty()).collect();
            let numbered: Vec<_> = (1..).map(f64::from).map(law).zip(&rules).map(|(law, &sides)| (sides, law)).collect();
            let is_twice = |&(i, j): &(usize, usize)| !pairs(rules[i]).is_disjoint(&pairs(rules[j]));
            let twice: Vec<_> = (0..rules.len()).flat_map(|j| (0..j).map(move |i| (i, j))).filter(is_twice).collect();
            match PairLaws::new(GROUPS.to_vec(), &numbered) {
                Err(Overlap { earlier, later }) => prop_assert!(twice.contains(&(earlier, later)), "{earlier} {later}"),
                Ok(laws) => {
                    prop_assert!(twice.is_empty(), "{twice:?}");
                    for a in 0..6 {
                        for b in (0..6).filter(|&b| b != a) {
                            let expected = rules.iter().position(|&sides| pairs(sides).contains(&(a.min(b), a.max(b))));
                            prop_assert_eq!(laws.index(a, b), expected);
                        }
                    }
                }
            }
        }
    }
}
