//! Numbers with a reliable sign: f64 with an error bound and, where that is inconclusive, exact sums.

use glam::DVec3;

/// The number type of the predicates.
pub trait Number: Sized {
    /// Six times the signed volume of a tetrahedron: > 0 if `d` is in front of the triangle, that is, sees it
    /// counter-clockwise.
    fn orientation(a: DVec3, b: DVec3, c: DVec3, d: DVec3) -> Self;
    /// Exactly 0.
    fn zero() -> Self;
    /// The product.
    fn times(&self, other: &Self) -> Self;
    /// The difference.
    fn minus(&self, other: &Self) -> Self;
    /// Whether it is positive; `None` if that is unknown or the number is zero.
    fn is_positive(&self) -> Option<bool>;
}

/// A value and a bound on its error.
#[derive(Clone, Copy, Debug)]
pub struct Bounded {
    /// The computed value.
    pub value: f64,
    /// Bound on the distance of the true value from the computed one.
    pub error: f64,
}

/// Bound on the rounding error of an operation, relative to its result: 2⁻⁵³ plus a margin for the bound's own
/// rounding.
const ROUNDING: f64 = 1.2e-16;

/// Error of an orientation over its permanent: (7 + 56 ε) ε with ε = 2⁻⁵³ (Shewchuk 1997, `o3derrboundA`), rounded up.
const ORIENTATION: f64 = 8e-16;

impl Number for Bounded {
    #[inline]
    fn orientation(a: DVec3, b: DVec3, c: DVec3, d: DVec3) -> Self {
        Plane::new(a, b, c).side(d)
    }

    fn zero() -> Self {
        Bounded { value: 0.0, error: 0.0 }
    }

    #[inline]
    fn times(&self, other: &Self) -> Self {
        let value = self.value * other.value;
        let error = self.value.abs() * other.error
            + other.value.abs() * self.error
            + self.error * other.error
            + value.abs() * ROUNDING;
        Bounded { value, error: error * (1.0 + 8.0 * ROUNDING) }
    }

    #[inline]
    fn minus(&self, other: &Self) -> Self {
        let value = self.value - other.value;
        Bounded { value, error: (self.error + other.error + value.abs() * ROUNDING) * (1.0 + 8.0 * ROUNDING) }
    }

    #[inline]
    fn is_positive(&self) -> Option<bool> {
        (self.value.abs() > self.error).then_some(self.value > 0.0)
    }
}

/// The plane of a triangle, for many points.
#[derive(Clone, Copy, Debug)]
pub struct Plane {
    origin: DVec3,
    normal: DVec3,
    /// Componentwise bound on the magnitudes from which the normal was computed.
    permanent: DVec3,
}

impl Plane {
    /// The plane through three points.
    #[inline]
    pub fn new(a: DVec3, b: DVec3, c: DVec3) -> Plane {
        let (x, y) = (b - a, c - a);
        let (first, second) =
            (DVec3::new(x.y * y.z, x.z * y.x, x.x * y.y), DVec3::new(x.z * y.y, x.x * y.z, x.y * y.x));
        Plane { origin: a, normal: first - second, permanent: first.abs() + second.abs() }
    }

    /// The orientation of the triangle and `d`.
    #[inline]
    pub fn side(&self, d: DVec3) -> Bounded {
        let z = d - self.origin;
        Bounded { value: self.normal.dot(z), error: self.permanent.dot(z.abs()) * ORIENTATION }
    }
}

/// An exact number: a sum of non-overlapping f64, ascending in magnitude, none of them 0 (Shewchuk, *Adaptive Precision
/// Floating-Point Arithmetic and Fast Robust Geometric Predicates*, 1997).
///
/// Exact unless something under- or overflows, which [`super::placement`] prevents.
#[derive(Clone, Debug, Default)]
pub struct Expansion(Vec<f64>);

/// a + b = sum + rest, exactly.
#[inline]
fn two_sum(a: f64, b: f64) -> (f64, f64) {
    let sum = a + b;
    let b_virtual = sum - a;
    (sum, (a - (sum - b_virtual)) + (b - b_virtual))
}

impl Expansion {
    fn difference(a: f64, b: f64) -> Self {
        let mut sum = Expansion::default();
        sum.add(a);
        sum.add(-b);
        sum
    }

    /// Adds one f64.
    fn add(&mut self, term: f64) {
        let mut carry = term;
        let mut kept = 0;
        for i in 0..self.0.len() {
            let (sum, rest) = two_sum(carry, self.0[i]);
            carry = sum;
            if rest != 0.0 {
                self.0[kept] = rest;
                kept += 1;
            }
        }
        self.0.truncate(kept);
        if carry != 0.0 {
            self.0.push(carry);
        }
    }

    fn plus(mut self, other: &Self) -> Self {
        for &term in &other.0 {
            self.add(term);
        }
        self
    }
}

impl Number for Expansion {
    fn orientation(a: DVec3, b: DVec3, c: DVec3, d: DVec3) -> Self {
        let [x, y, z] = [b, c, d].map(|p| [0, 1, 2].map(|k| Expansion::difference(p[k], a[k])));
        let minor = |i: usize, j: usize| x[i].times(&y[j]).minus(&x[j].times(&y[i]));
        minor(1, 2).times(&z[0]).plus(&minor(2, 0).times(&z[1])).plus(&minor(0, 1).times(&z[2]))
    }

    fn zero() -> Self {
        Expansion::default()
    }

    fn times(&self, other: &Self) -> Self {
        let mut product = Expansion::default();
        for &a in &self.0 {
            for &b in &other.0 {
                let high = a * b;
                // the rounding error of a product is an f64, which a fused multiply-add computes, in hardware or not
                product.add(a.mul_add(b, -high));
                product.add(high);
            }
        }
        product
    }

    fn minus(&self, other: &Self) -> Self {
        let mut difference = self.clone();
        for &term in &other.0 {
            difference.add(-term);
        }
        difference
    }

    fn is_positive(&self) -> Option<bool> {
        self.0.last().map(|&largest| largest > 0.0)
    }
}

/// An expression of which only the sign is needed.
pub trait Polynomial {
    /// Its value.
    fn value<N: Number>(&self) -> N;

    /// Whether it is positive, with certainty; `None` if it is 0.
    #[inline]
    fn is_positive(&self) -> Option<bool> {
        self.value::<Bounded>().is_positive().or_else(|| self.exactly_positive())
    }

    /// Like `is_positive`, for cases where the bound is known to be inconclusive.
    #[cold]
    fn exactly_positive(&self) -> Option<bool> {
        self.value::<Expansion>().is_positive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn expansions_are_exact() {
        let big = Expansion::difference(1e16, -1.0);
        let square = big.times(&big); // 1e32 + 2e16 + 1
        let rest = square.minus(&Expansion(vec![1e32])).minus(&Expansion(vec![2e16]));
        // 1e32 is not a power of two: its f64 has an error, which is exactly this.
        let off = 1e16f64.mul_add(1e16, -1e32);
        assert_eq!(rest.minus(&Expansion(vec![off])).0, [1.0]);
        assert_eq!(big.minus(&big).is_positive(), None);
    }

    #[test]
    fn an_orientation_that_rounding_hides_has_its_sign() {
        // Four points in a plane, one of them moved by one ulp to either side.
        let plane = |x: f64, y: f64| 0.1 * x + 0.7 * y + 1.0 / 3.0;
        let point = |x: f64, y: f64| DVec3::new(x, y, plane(x, y));
        let (a, b, c) = (point(0.1, 0.2), point(0.9, 0.3), point(0.4, 0.8));
        let mut last = None;
        let mut changes = 0;
        for ulps in -40i64..=40 {
            let d = point(0.55, 0.45);
            let d = DVec3::new(d.x, d.y, f64::from_bits((d.z.to_bits() as i64 + ulps) as u64));
            let exact = Expansion::orientation(a, b, c, d).is_positive();
            let bounded = Bounded::orientation(a, b, c, d).is_positive();
            assert!(bounded.is_none() || bounded == exact);
            changes += u32::from(last.is_some() && last != Some(exact));
            last = Some(exact);
        }
        assert_eq!(changes, 1, "the sign changes once");
    }
}
