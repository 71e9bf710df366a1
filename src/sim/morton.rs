//! The order of points along a space-filling curve (Morton 1966): points next to each other in it are near each other.

use glam::DVec3;

/// Bits of a key per axis.
const BITS: u32 = 21;

/// Gives points within a box their place along the curve.
#[derive(Clone, Copy, Debug)]
pub struct Curve {
    min: DVec3,
    /// Cells per unit of length.
    scale: f64,
}

impl Curve {
    /// The curve through the smallest cube that contains `points`.
    pub fn around(points: impl Iterator<Item = DVec3>) -> Curve {
        let none = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let (min, max) = points.fold(none, |(min, max), point| (min.min(point), max.max(point)));
        Curve { min, scale: f64::from((1 << BITS) - 1) / (max - min).max_element() }
    }

    /// The place of a point along the curve. Any number for a point that isn't finite.
    pub fn place(&self, point: DVec3) -> u64 {
        let [x, y, z] = ((point - self.min) * self.scale).to_array().map(|x| spread(x as u64));
        x | y << 1 | z << 2
    }
}

/// Moves bit n to bit 3n.
fn spread(x: u64) -> u64 {
    let x = x & ((1 << BITS) - 1);
    let x = (x | x << 32) & 0x001f_0000_0000_ffff;
    let x = (x | x << 16) & 0x001f_0000_ff00_00ff;
    let x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
    let x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
    (x | x << 2) & 0x1249_2492_4924_9249
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_of_a_cell_follow_each_other() {
        let points = || (0..64).map(|i| DVec3::new(f64::from(i % 4), f64::from(i / 4 % 4), f64::from(i / 16)));
        let curve = Curve::around(points());
        let mut sorted: Vec<DVec3> = points().collect();
        sorted.sort_by_key(|&point| curve.place(point));
        for cell in sorted.chunks(8) {
            assert!(cell.iter().all(|point| (*point / 2.0).floor() == (cell[0] / 2.0).floor()), "{cell:?}");
        }
        assert_eq!(Curve::around([DVec3::ONE].into_iter()).place(DVec3::ONE), 0);
        assert_eq!(curve.place(DVec3::NAN), 0);
        assert_eq!(
            (0..BITS).map(|bit| spread(1 << bit).trailing_zeros() / 3).collect::<Vec<_>>(),
            (0..BITS).collect::<Vec<_>>()
        );
    }
}
