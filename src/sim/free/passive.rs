//! Vertices that nothing reaches within a step.
//!
//! Apart from its oscillator, such a vertex feels only what all vertices of its body share: a uniform acceleration, one
//! linear in its rest position l, and damping that rotates with the body. At any instant of the step, its state is
//! therefore linear in its state at the start and in l, with the same matrices for all such vertices. Sums over them
//! follow from their second moments at the start, so the cost of an iteration does not depend on their number.

use std::ops::Mul;

use glam::{DMat3, DVec3};

use super::body::Sums;
use crate::model::shape_matching::{cross_matrix, moment, outer};

/// A vector that is linear in x and u at the start of the step and in the rest position l of a vertex.
#[derive(Clone, Copy, Debug)]
pub struct Linear<F = DMat3> {
    pub by_x: F,
    pub by_u: F,
    pub by_rest: DMat3,
    pub shift: DVec3,
}

/// A [`Linear`] vector whose matrices by x and u are multiples of the identity.
pub type Scaled = Linear<f64>;

/// A matrix, or a multiple of the identity.
pub trait Factor: Copy + Mul<DVec3, Output = DVec3> + Mul<DMat3, Output = DMat3> {
    /// A matrix times the transpose of this one.
    fn transposed_after(self, matrix: DMat3) -> DMat3;
}

impl Factor for DMat3 {
    #[inline(always)]
    fn transposed_after(self, matrix: DMat3) -> DMat3 {
        matrix * self.transpose()
    }
}

impl Factor for f64 {
    #[inline(always)]
    fn transposed_after(self, matrix: DMat3) -> DMat3 {
        matrix * self
    }
}

/// The largest |x|, |u| and |l| of any vertex.
#[derive(Clone, Copy, Debug, Default)]
pub struct Maxima {
    pub x: f64,
    pub u: f64,
    pub rest: f64,
}

zero_by_default!(Linear { DMat3::ZERO => by_x by_u by_rest, DVec3::ZERO => shift });

impl Linear {
    /// x at the start.
    pub fn x() -> Linear {
        Linear { by_x: DMat3::IDENTITY, ..Linear::default() }
    }

    /// u at the start.
    pub fn u() -> Linear {
        Linear { by_u: DMat3::IDENTITY, ..Linear::default() }
    }

    pub fn add_times(&mut self, w: f64, other: &Linear) {
        self.by_x += other.by_x * w;
        self.by_u += other.by_u * w;
        self.by_rest += other.by_rest * w;
        self.shift += w * other.shift;
    }

    /// w × this vector.
    pub fn crossed(&self, w: DVec3) -> Linear {
        let w = cross_matrix(w);
        Linear { by_x: w * self.by_x, by_u: w * self.by_u, by_rest: w * self.by_rest, shift: w * self.shift }
    }

    /// Upper bound of the length of this vector for any vertex.
    pub fn bound(&self, maxima: &Maxima) -> f64 {
        size(&self.by_x) * maxima.x
            + size(&self.by_u) * maxima.u
            + (size(&self.by_rest) * maxima.rest + self.shift.length())
    }

    /// Upper bound of the distance from another vector for any vertex.
    pub fn difference(&self, other: &Linear, maxima: &Maxima) -> f64 {
        let mut difference = *self;
        difference.add_times(-1.0, other);
        difference.bound(maxima)
    }
}

/// An upper bound of the 2-norm, √(‖A‖₁ ‖A‖_∞).
fn size(a: &DMat3) -> f64 {
    let (x, y, z) = (a.x_axis.abs(), a.y_axis.abs(), a.z_axis.abs());
    let columns = x.element_sum().max(y.element_sum()).max(z.element_sum());
    // `max` drops NaN
    if columns.is_nan() { f64::NAN } else { (columns * (x + y + z).max_element()).sqrt() }
}

impl Scaled {
    pub fn linear(&self) -> Linear {
        let [by_x, by_u] = [self.by_x, self.by_u].map(|by| DMat3::from_diagonal(DVec3::splat(by)));
        Linear { by_x, by_u, by_rest: self.by_rest, shift: self.shift }
    }

    /// Upper bound of the length of this vector for any vertex. `at_start` bounds it at the start of the step, and
    /// `more` its change by the free oscillation since then.
    pub fn bound(&self, maxima: &Maxima, at_start: f64, more: f64) -> f64 {
        let Scaled { by_x, by_u, by_rest, shift } = self;
        let own = by_x.abs() * maxima.x + by_u.abs() * maxima.u;
        own.min(at_start + more) + (size(by_rest) * maxima.rest + shift.length())
    }

    /// Upper bound of the distance from another vector with the same multiples for any vertex.
    pub fn difference(&self, other: &Linear, maxima: &Maxima) -> f64 {
        size(&(self.by_rest - other.by_rest)) * maxima.rest + (self.shift - other.shift).length()
    }
}

/// Second moments Σ m p qᵀ of x, u and l at the start of the step, first moments and the mass.
#[derive(Clone, Copy, Debug)]
pub struct Moments {
    pub xx: DMat3,
    pub xu: DMat3,
    pub xl: DMat3,
    pub uu: DMat3,
    pub ul: DMat3,
    pub ll: DMat3,
    pub x: DVec3,
    pub u: DVec3,
    pub l: DVec3,
    pub mass: f64,
}

zero_by_default!(Moments { DMat3::ZERO => xx xu xl uu ul ll, DVec3::ZERO => x u l, 0.0 => mass });

/// Sums Σ m p qᵀ of a vector q with x, u and l at the start of the step, and Σ m q.
#[derive(Clone, Copy, Debug)]
struct With {
    x: DMat3,
    u: DMat3,
    l: DMat3,
    one: DVec3,
}

impl Moments {
    #[inline(always)]
    fn with<F: Factor>(&self, q: &Linear<F>) -> With {
        let Linear { by_x, by_u, by_rest, shift } = *q;
        let Moments { xx, xu, xl, uu, ul, ll, .. } = *self;
        let by = |x: DMat3, u: DMat3, l: DMat3, one: DVec3| {
            by_x.transposed_after(x) + by_u.transposed_after(u) + (by_rest.transposed_after(l) + outer(one, shift))
        };
        With {
            x: by(xx, xu, xl, self.x),
            u: by(xu.transpose(), uu, ul, self.u),
            l: by(xl.transpose(), ul.transpose(), ll, self.l),
            one: by_x * self.x + by_u * self.u + (by_rest * self.l + self.mass * shift),
        }
    }

    /// The sums over the vertices at the start.
    pub fn at_start(&self) -> Sums {
        let Moments { xx, xu, xl, ul, x, u, .. } = *self;
        Sums { lx: xl.transpose(), lu: ul.transpose(), xx, xu: moment(xu), x, u }
    }

    /// Σ m |q|².
    pub fn square(&self, q: &Linear) -> f64 {
        let p = product(q, &self.with(q));
        p.x_axis.x + p.y_axis.y + p.z_axis.z
    }

    /// Σ m l qᵀ and Σ m q.
    pub fn linear_sums(&self, q: &Scaled) -> (DMat3, DVec3) {
        let With { l, one, .. } = self.with(q);
        (l, one)
    }

    /// The sums over the vertices when their states are `x` and `u`.
    pub fn sums<F: Factor>(&self, x: &Linear<F>, u: &Linear<F>) -> Sums {
        let (with_x, with_u) = (self.with(x), self.with(u));
        let (xx, xu) = (product(x, &with_x), moment(product(x, &with_u)));
        Sums { lx: with_x.l, lu: with_u.l, xx, xu, x: with_x.one, u: with_u.one }
    }
}

/// Σ m p qᵀ.
fn product<F: Factor>(p: &Linear<F>, q: &With) -> DMat3 {
    p.by_x * q.x + p.by_u * q.u + (p.by_rest * q.l + outer(p.shift, q.one))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sums from moments agree with sums over the single vertices.
    #[test]
    fn sums_follow_from_moments() {
        let mut state = 1u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 53) as f64 - 0.5
        };
        let mut any = || DVec3::new(random(), random(), random());
        let vertices: Vec<(f64, [DVec3; 3])> = (0..7).map(|_| (any().x + 1.0, [any(), any(), any()])).collect();
        let mut moments = Moments::default();
        for &(m, [x, u, l]) in &vertices {
            moments.xx += outer(m * x, x);
            moments.xu += outer(m * x, u);
            moments.xl += outer(m * x, l);
            moments.uu += outer(m * u, u);
            moments.ul += outer(m * u, l);
            moments.ll += outer(m * l, l);
            moments.x += m * x;
            moments.u += m * u;
            moments.l += m * l;
            moments.mass += m;
        }
        let mut matrix = || DMat3::from_cols(any(), any(), any());
        let [p, q] = std::array::from_fn(|_| Linear {
            by_x: matrix(),
            by_u: matrix(),
            by_rest: matrix(),
            shift: matrix().x_axis,
        });
        let found = moments.sums(&p, &q);
        let mut expected = Sums::default();
        let mut square = 0.0;
        for &(m, [x, u, l]) in &vertices {
            let of = |a: &Linear| a.by_x * x + a.by_u * u + (a.by_rest * l + a.shift);
            let (now, rate) = (of(&p), of(&q));
            expected.lx += outer(m * l, now);
            expected.lu += outer(m * l, rate);
            expected.xx += outer(m * now, now);
            expected.xu += m * now.cross(rate);
            expected.x += m * now;
            expected.u += m * rate;
            square += m * now.length_squared();
        }
        for (found, expected) in [(found.lx, expected.lx), (found.lu, expected.lu), (found.xx, expected.xx)] {
            assert!(found.abs_diff_eq(expected, 1e-12), "{found} {expected}");
        }
        for (found, expected) in [(found.xu, expected.xu), (found.x, expected.x), (found.u, expected.u)] {
            assert!(found.abs_diff_eq(expected, 1e-12), "{found} {expected}");
        }
        assert!((moments.square(&p) - square).abs() < 1e-12);

        let scaled = |by_x, by_u, of: &Linear| Scaled { by_x, by_u, by_rest: of.by_rest, shift: of.shift };
        let (p, q) = (scaled(0.3, -0.7, &p), scaled(1.1, 0.2, &q));
        let (found, expected) = (moments.sums(&p, &q), moments.sums(&p.linear(), &q.linear()));
        for (found, expected) in [(found.lx, expected.lx), (found.lu, expected.lu), (found.xx, expected.xx)] {
            assert!(found.abs_diff_eq(expected, 1e-12), "{found} {expected}");
        }
        for (found, expected) in [(found.xu, expected.xu), (found.x, expected.x), (found.u, expected.u)] {
            assert!(found.abs_diff_eq(expected, 1e-12), "{found} {expected}");
        }
        let (by_l, sum) = moments.linear_sums(&p);
        assert!(by_l.abs_diff_eq(found.lx, 1e-12) && sum.abs_diff_eq(found.x, 1e-12));
    }
}
