//! A sparse subset of many numbers, with the rank of each.

/// Ascending numbers below a limit: a bit for each number, and a count of those below each 64-bit word.
#[derive(Default)]
pub struct Ranks {
    bits: Vec<u64>,
    below: Vec<u32>,
}

impl Ranks {
    pub fn new(limit: u32, ascending: &[u32]) -> Ranks {
        let mut bits = vec![0u64; limit as usize / 64 + 1];
        for &number in ascending {
            bits[number as usize / 64] |= 1 << (number % 64);
        }
        let mut below = Vec::with_capacity(bits.len());
        let mut count = 0;
        for word in &bits {
            below.push(count);
            count += word.count_ones();
        }
        Ranks { bits, below }
    }

    /// The rank of a number; `None` if it is not in the subset.
    #[inline]
    pub fn of(&self, number: u32) -> Option<usize> {
        let (word, bit) = (*self.bits.get(number as usize / 64)?, 1 << (number % 64));
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
