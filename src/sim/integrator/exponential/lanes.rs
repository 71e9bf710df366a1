//! Vectors of several vertices side by side, so that one operation on a coordinate is one for all of them.

use std::ops::{Add, Sub};

use glam::DVec3;

/// A vector for each of `N` vertices, stored by coordinate. Every operation is that of its coordinates, lane by lane:
/// the same bits for any `N` and any instruction set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lanes<const N: usize>(pub [[f64; N]; 3]);

impl<const N: usize> Lanes<N> {
    /// The zero vector in all lanes.
    pub const ZERO: Lanes<N> = Lanes([[0.0; N]; 3]);

    /// One vector a lane.
    pub fn from_fn(vector: impl Fn(usize) -> DVec3) -> Lanes<N> {
        let mut lanes = Lanes::ZERO;
        for lane in 0..N {
            let DVec3 { x, y, z } = vector(lane);
            (lanes.0[0][lane], lanes.0[1][lane], lanes.0[2][lane]) = (x, y, z);
        }
        lanes
    }

    /// The same vector in all lanes.
    pub fn splat(DVec3 { x, y, z }: DVec3) -> Lanes<N> {
        Lanes([[x; N], [y; N], [z; N]])
    }

    /// The vector of one lane.
    pub fn lane(&self, lane: usize) -> DVec3 {
        DVec3::new(self.0[0][lane], self.0[1][lane], self.0[2][lane])
    }

    /// |v|² of each.
    #[inline(always)]
    pub fn length_squared(&self) -> [f64; N] {
        let [x, y, z] = &self.0;
        let mut squares = [0.0; N];
        for i in 0..N {
            squares[i] = x[i] * x[i] + y[i] * y[i] + z[i] * z[i];
        }
        squares
    }

    /// Adds to each vector another one times a number of its own.
    #[inline(always)]
    pub fn add_scaled(&mut self, other: &Lanes<N>, by: &[f64; N]) {
        for axis in 0..3 {
            for i in 0..N {
                self.0[axis][i] += other.0[axis][i] * by[i];
            }
        }
    }

    /// `a x + b u + Σ wᵢ fᵢ`, in that order.
    #[inline(always)]
    pub fn combine(a: f64, x: &Lanes<N>, b: f64, u: &Lanes<N>, w: &[f64; 4], f: &[Lanes<N>; 4]) -> Lanes<N> {
        let mut sum = Lanes::ZERO;
        for axis in 0..3 {
            for i in 0..N {
                let flow = a * x.0[axis][i] + b * u.0[axis][i];
                let forces = w[0] * f[0].0[axis][i] + w[1] * f[1].0[axis][i];
                sum.0[axis][i] = flow + (forces + (w[2] * f[2].0[axis][i] + w[3] * f[3].0[axis][i]));
            }
        }
        sum
    }

    #[inline(always)]
    fn zip(mut self, other: &Lanes<N>, f: impl Fn(f64, f64) -> f64) -> Lanes<N> {
        for axis in 0..3 {
            for i in 0..N {
                self.0[axis][i] = f(self.0[axis][i], other.0[axis][i]);
            }
        }
        self
    }
}

impl<const N: usize> Add for Lanes<N> {
    type Output = Lanes<N>;

    #[inline(always)]
    fn add(self, other: Lanes<N>) -> Lanes<N> {
        self.zip(&other, |a, b| a + b)
    }
}

impl<const N: usize> Sub for Lanes<N> {
    type Output = Lanes<N>;

    #[inline(always)]
    fn sub(self, other: Lanes<N>) -> Lanes<N> {
        self.zip(&other, |a, b| a - b)
    }
}
