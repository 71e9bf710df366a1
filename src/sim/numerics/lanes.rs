//! SIMD scalars and vectors for several vertices side by side: one operation is one instruction for all of them.
//!
//! Every operation acts per lane, with IEEE 754 rounding and without fusing. A vertex's result is bit-identical on
//! every instruction set and does not depend on the other lanes.

use std::ops::{Add, Div, Mul, Sub};

use glam::DVec3;
use pulp::Simd;

pub use super::arrays::LANES;
use super::arrays::Vectors;
use crate::model::influence::Real;

#[cfg(test)]
mod tests;

/// A number per lane, in `W` independent registers.
#[derive(Clone, Copy)]
pub struct Reals<S: Simd, const W: usize> {
    simd: S,
    v: [S::f64s; W],
}

impl<S: Simd, const W: usize> Reals<S, W> {
    /// Number of lanes.
    pub const COUNT: usize = W * S::F64_LANES;

    /// The same number in all lanes.
    #[inline(always)]
    pub fn splat(simd: S, value: f64) -> Reals<S, W> {
        Reals { simd, v: [simd.splat_f64s(value); W] }
    }

    /// Loads numbers from an array, from `first` on; the array must be long enough.
    #[inline(always)]
    pub fn load(simd: S, array: &[f64], first: usize) -> Reals<S, W> {
        let mut v = [simd.splat_f64s(0.0); W];
        let (full, _) = S::as_simd_f64s(&array[first..first + W * S::F64_LANES]);
        v.copy_from_slice(&full[..W]);
        Reals { simd, v }
    }

    /// Stores the numbers into an array, from `first` on.
    #[inline(always)]
    pub fn store(self, array: &mut [f64], first: usize) {
        let (full, _) = S::as_mut_simd_f64s(&mut array[first..first + W * S::F64_LANES]);
        full[..W].copy_from_slice(&self.v);
    }

    /// Square root of each lane.
    #[inline(always)]
    pub fn sqrt(self) -> Reals<S, W> {
        let mut v = self.v;
        for v in &mut v {
            *v = self.simd.sqrt_f64s(*v);
        }
        Reals { v, ..self }
    }

    /// Absolute value of each lane.
    #[inline(always)]
    pub fn abs(self) -> Reals<S, W> {
        let mut v = self.v;
        for v in &mut v {
            *v = self.simd.abs_f64s(*v);
        }
        Reals { v, ..self }
    }

    /// True in lanes that are less than those of `other`; false where either is NaN.
    #[inline(always)]
    pub fn below(self, other: Reals<S, W>) -> Mask<S, W> {
        let mut m = [self.simd.less_than_f64s(self.v[0], other.v[0]); W];
        for w in 1..W {
            m[w] = self.simd.less_than_f64s(self.v[w], other.v[w]);
        }
        Mask { simd: self.simd, m }
    }

    /// True in lanes that are less than or equal to those of `other`; false where either is NaN.
    #[inline(always)]
    pub fn at_most(self, other: Reals<S, W>) -> Mask<S, W> {
        let mut m = [self.simd.less_than_or_equal_f64s(self.v[0], other.v[0]); W];
        for w in 1..W {
            m[w] = self.simd.less_than_or_equal_f64s(self.v[w], other.v[w]);
        }
        Mask { simd: self.simd, m }
    }

    /// The larger of the two, or the first if either is NaN.
    #[inline(always)]
    pub fn larger(self, other: Reals<S, W>) -> Reals<S, W> {
        self.below(other).select(other, self)
    }

    /// The larger of the two; NaN if either is.
    #[inline(always)]
    pub fn larger_or_nan(self, other: Reals<S, W>) -> Reals<S, W> {
        self.below(other).or(other.at_most(other).negated()).select(other, self)
    }

    /// The smaller of the two, or the first if either is NaN.
    #[inline(always)]
    pub fn smaller(self, other: Reals<S, W>) -> Reals<S, W> {
        other.below(self).select(other, self)
    }
}

impl<S: Simd, const W: usize> Real for Reals<S, W> {
    #[inline(always)]
    fn constant(self, value: f64) -> Reals<S, W> {
        Reals::splat(self.simd, value)
    }
}

/// An operator on the lanes of two numbers, by the instruction for a register.
macro_rules! operator {
    ($Operator:ident, $name:ident, $of_registers:ident) => {
        impl<S: Simd, const W: usize> $Operator for Reals<S, W> {
            type Output = Reals<S, W>;

            #[inline(always)]
            fn $name(self, other: Reals<S, W>) -> Reals<S, W> {
                let mut v = self.v;
                for w in 0..W {
                    v[w] = self.simd.$of_registers(v[w], other.v[w]);
                }
                Reals { v, ..self }
            }
        }
    };
}

operator!(Add, add, add_f64s);
operator!(Sub, sub, sub_f64s);
operator!(Mul, mul, mul_f64s);
operator!(Div, div, div_f64s);

/// The same number in all lanes.
impl<S: Simd, const W: usize> Mul<f64> for Reals<S, W> {
    type Output = Reals<S, W>;

    #[inline(always)]
    fn mul(self, other: f64) -> Reals<S, W> {
        self * Reals::splat(self.simd, other)
    }
}

/// A boolean per lane.
#[derive(Clone, Copy)]
pub struct Mask<S: Simd, const W: usize> {
    simd: S,
    m: [S::m64s; W],
}

impl<S: Simd, const W: usize> Mask<S, W> {
    /// False in all lanes.
    #[inline(always)]
    pub fn none(simd: S) -> Mask<S, W> {
        let zero = Reals::splat(simd, 0.0);
        zero.below(zero)
    }

    /// Takes `yes` in lanes that are true, `no` in the others.
    #[inline(always)]
    pub fn select(self, yes: Reals<S, W>, no: Reals<S, W>) -> Reals<S, W> {
        let mut v = no.v;
        for w in 0..W {
            v[w] = self.simd.select_f64s(self.m[w], yes.v[w], v[w]);
        }
        Reals { simd: self.simd, v }
    }

    /// Takes `yes` in lanes that are true, `no` in the others.
    #[inline(always)]
    pub fn select_vector(self, yes: Vector<S, W>, no: Vector<S, W>) -> Vector<S, W> {
        Vector { x: self.select(yes.x, no.x), y: self.select(yes.y, no.y), z: self.select(yes.z, no.z) }
    }

    /// True where either mask is.
    #[inline(always)]
    pub fn or(self, other: Mask<S, W>) -> Mask<S, W> {
        let mut m = self.m;
        for w in 0..W {
            m[w] = self.simd.or_m64s(m[w], other.m[w]);
        }
        Mask { m, ..self }
    }

    /// True where both masks are.
    #[inline(always)]
    pub fn and(self, other: Mask<S, W>) -> Mask<S, W> {
        let mut m = self.m;
        for w in 0..W {
            m[w] = self.simd.and_m64s(m[w], other.m[w]);
        }
        Mask { m, ..self }
    }

    /// True where the mask is false.
    #[inline(always)]
    pub fn negated(self) -> Mask<S, W> {
        let mut m = self.m;
        for m in &mut m {
            *m = self.simd.not_m64s(*m);
        }
        Mask { m, ..self }
    }

    /// Whether any lane is true.
    #[inline(always)]
    pub fn any(self) -> bool {
        let mut any = false;
        for m in self.m {
            any |= self.simd.first_true_m64s(m) < S::F64_LANES;
        }
        any
    }
}

/// A vector per lane.
#[derive(Clone, Copy)]
pub struct Vector<S: Simd, const W: usize> {
    /// The x coordinates.
    pub x: Reals<S, W>,
    /// The y coordinates.
    pub y: Reals<S, W>,
    /// The z coordinates.
    pub z: Reals<S, W>,
}

impl<S: Simd, const W: usize> Vector<S, W> {
    /// The same vector in all lanes.
    #[inline(always)]
    pub fn splat(simd: S, DVec3 { x, y, z }: DVec3) -> Vector<S, W> {
        Vector { x: Reals::splat(simd, x), y: Reals::splat(simd, y), z: Reals::splat(simd, z) }
    }

    /// Loads vectors from an array, from `first` on; the array must be long enough.
    #[inline(always)]
    pub fn load(simd: S, array: &Vectors, first: usize) -> Vector<S, W> {
        let load = |axis: &[f64]| Reals::load(simd, axis, first);
        Vector { x: load(&array.x), y: load(&array.y), z: load(&array.z) }
    }

    /// Loads vectors from a block, from `lane` on.
    #[inline(always)]
    pub fn of_block<const N: usize>(simd: S, [x, y, z]: &[[f64; N]; 3], lane: usize) -> Vector<S, W> {
        let load = |axis: &[f64]| Reals::load(simd, axis, lane);
        Vector { x: load(x), y: load(y), z: load(z) }
    }

    /// Stores the vectors into a block, from `lane` on.
    #[inline(always)]
    pub fn into_block<const N: usize>(self, [x, y, z]: &mut [[f64; N]; 3], lane: usize) {
        self.x.store(x, lane);
        self.y.store(y, lane);
        self.z.store(z, lane);
    }

    /// |v|² of each lane.
    #[inline(always)]
    pub fn length_squared(self) -> Reals<S, W> {
        self.dot(self)
    }

    /// The scalar product of each lane.
    #[inline(always)]
    pub fn dot(self, other: Vector<S, W>) -> Reals<S, W> {
        self.x * other.x + self.y * other.y + self.z * other.z
    }
}

impl<S: Simd, const W: usize> Add for Vector<S, W> {
    type Output = Vector<S, W>;

    #[inline(always)]
    fn add(self, other: Vector<S, W>) -> Vector<S, W> {
        Vector { x: self.x + other.x, y: self.y + other.y, z: self.z + other.z }
    }
}

impl<S: Simd, const W: usize> Sub for Vector<S, W> {
    type Output = Vector<S, W>;

    #[inline(always)]
    fn sub(self, other: Vector<S, W>) -> Vector<S, W> {
        Vector { x: self.x - other.x, y: self.y - other.y, z: self.z - other.z }
    }
}

impl<S: Simd, const W: usize> Mul<Reals<S, W>> for Vector<S, W> {
    type Output = Vector<S, W>;

    #[inline(always)]
    fn mul(self, by: Reals<S, W>) -> Vector<S, W> {
        Vector { x: self.x * by, y: self.y * by, z: self.z * by }
    }
}

/// The same number in all lanes.
impl<S: Simd, const W: usize> Mul<f64> for Vector<S, W> {
    type Output = Vector<S, W>;

    #[inline(always)]
    fn mul(self, by: f64) -> Vector<S, W> {
        self * Reals::splat(self.x.simd, by)
    }
}
