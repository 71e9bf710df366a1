//! Subsets of many numbers.

/// A set of numbers below a limit: a bit for each number.
#[derive(Clone, Debug, Default)]
pub struct Bits {
    words: Vec<u64>,
}

impl Bits {
    /// An empty set of numbers below `limit`.
    pub fn new(limit: usize) -> Bits {
        Bits { words: vec![0; limit / 64 + 1] }
    }

    /// Adds a number below the limit. Returns whether it is new.
    #[inline]
    pub fn insert(&mut self, number: u32) -> bool {
        let (word, bit) = (&mut self.words[number as usize / 64], 1 << (number % 64));
        let is_new = *word & bit == 0;
        *word |= bit;
        is_new
    }

    /// Whether the set contains a number, which may be beyond the limit.
    #[inline]
    pub fn contains(&self, number: u32) -> bool {
        self.words.get(number as usize / 64).is_some_and(|word| word & (1 << (number % 64)) != 0)
    }

    /// Whether the set is empty because its limit is 0.
    #[inline]
    pub fn is_none(&self) -> bool {
        self.words.is_empty()
    }

    /// The numbers, ascending.
    pub fn iter(&self) -> impl Iterator<Item = u32> {
        (self.words.iter().zip(0..)).flat_map(|(&word, k)| ones(word).map(move |bit| 64 * k + bit))
    }
}

/// The bits of a number that are 1, ascending.
fn ones(mut word: u64) -> impl Iterator<Item = u32> {
    std::iter::from_fn(move || {
        let bit = word.trailing_zeros();
        word &= word.wrapping_sub(1);
        (bit < u64::BITS).then_some(bit)
    })
}

/// A set of numbers below a limit, with the rank of each: a count of those below each 64-bit word.
#[derive(Default)]
pub struct Ranks {
    bits: Bits,
    below: Vec<u32>,
}

impl Ranks {
    pub fn new(limit: u32, ascending: &[u32]) -> Ranks {
        let mut bits = Bits::new(limit as usize);
        for &number in ascending {
            bits.insert(number);
        }
        let mut below = Vec::with_capacity(bits.words.len());
        let mut count = 0;
        for word in &bits.words {
            below.push(count);
            count += word.count_ones();
        }
        Ranks { bits, below }
    }

    /// The rank of a number; `None` if it is not in the subset.
    #[inline]
    pub fn of(&self, number: u32) -> Option<usize> {
        let (word, bit) = (*self.bits.words.get(number as usize / 64)?, 1 << (number % 64));
        (word & bit != 0).then(|| (self.below[number as usize / 64] + (word & (bit - 1)).count_ones()) as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_number_has_its_rank() {
        let numbers = [0, 3, 63, 64, 65, 200, 255];
        let ranks = Ranks::new(256, &numbers);
        for number in 0..300 {
            assert_eq!(ranks.of(number), numbers.iter().position(|&known| known == number), "{number}");
        }
        assert_eq!(Ranks::default().of(0), None);
    }
}
