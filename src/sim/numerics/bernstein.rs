//! Locates the zeros of a quantity within a step: rims of spheres and planes, thresholds of pairs.
//!
//! A polynomial of degree seven interpolates the quantity and its rate at the four nodes. In the Bernstein basis, a
//! polynomial has no more roots than its coefficients have sign changes. Bisection until there is at most one change
//! misses no crossing, however short the visit.

use std::sync::LazyLock;

use glam::DVec3;

use super::{nodes::NODES, roots::between};

/// Largest number of crossings found in a step.
pub const MOST: usize = 7;

/// `[i][k]`: weight in Bernstein coefficient i of datum k of (values at the nodes, rates at the nodes). Coefficients 0 and
/// 7 are the first and the last value.
pub type Basis = [[f64; 8]; 8];

/// The weights of all polynomials.
pub fn basis() -> &'static Basis {
    &BASIS
}

static BASIS: LazyLock<Basis> = LazyLock::new(|| {
    // Row k of the system expresses datum k in the Bernstein coefficients; invert by Gauss–Jordan.
    const CHOOSE: [f64; 8] = [1.0, 7.0, 21.0, 35.0, 35.0, 21.0, 7.0, 1.0];
    let mut a = [[0.0; 16]; 8];
    for (k, row) in a.iter_mut().enumerate() {
        let (t, is_rate) = (NODES[k % 4], k >= 4);
        let s = 1.0 - t;
        let power = |x: f64, n: i32| if n < 0 { 0.0 } else { (0..n).fold(1.0, |p, _| p * x) };
        for i in 0..8 {
            let n = i as i32;
            row[i] = if is_rate {
                CHOOSE[i]
                    * (f64::from(n) * power(t, n - 1) * power(s, 7 - n)
                        - f64::from(7 - n) * power(t, n) * power(s, 6 - n))
            } else {
                CHOOSE[i] * power(t, n) * power(s, 7 - n)
            };
        }
        row[8 + k] = 1.0;
    }
    for p in 0..8 {
        let pivot = (p..8).max_by(|&i, &j| a[i][p].abs().total_cmp(&a[j][p].abs())).unwrap_or(p);
        a.swap(p, pivot);
        let scale = 1.0 / a[p][p];
        for value in &mut a[p] {
            *value *= scale;
        }
        let row = a[p];
        for (_, other) in a.iter_mut().enumerate().filter(|&(i, _)| i != p) {
            let factor = other[p];
            for (value, own) in other.iter_mut().zip(row) {
                *value -= factor * own;
            }
        }
    }
    std::array::from_fn(|i| std::array::from_fn(|k| a[i][8 + k]))
});

/// `[k][i]`: coefficient of θᵏ of datum i of (values at the nodes but the first, rates at the nodes), for a quantity that
/// starts at zero.
static POWERS: LazyLock<[[f64; 7]; 8]> = LazyLock::new(|| {
    const CHOOSE: [f64; 8] = [1.0, 7.0, 21.0, 35.0, 35.0, 21.0, 7.0, 1.0];
    // the k-th difference of the Bernstein coefficients times the binomial coefficient
    let mut rows = [[0.0; 7]; 8];
    let mut differences = *BASIS;
    for (k, row) in rows.iter_mut().enumerate() {
        row.copy_from_slice(&differences[0].map(|value| CHOOSE[k] * value)[1..]);
        for i in 0..7 - k {
            for datum in 0..8 {
                differences[i][datum] = differences[i + 1][datum] - differences[i][datum];
            }
        }
    }
    rows
});

/// A vector over a step that starts at zero, with time from 0 to 1: the polynomial through its values and rates at the
/// nodes. Exact to rounding relative to its largest value.
#[derive(Clone, Copy, Debug)]
pub struct Curve([DVec3; 7]);

impl Curve {
    /// Interpolates values at the nodes after the first and rates at all nodes; rates are per step length.
    pub fn new(values: &[DVec3; 3], rates: &[DVec3; 4]) -> Curve {
        let rows = &*POWERS;
        Curve(std::array::from_fn(|k| {
            let row = &rows[k + 1];
            let of_values = row[0] * values[0] + row[1] * values[1] + row[2] * values[2];
            of_values + ((row[3] * rates[0] + row[4] * rates[1]) + (row[5] * rates[2] + row[6] * rates[3]))
        }))
    }

    /// The value at `theta` and its rate, per step length.
    pub fn at(&self, theta: f64) -> (DVec3, DVec3) {
        let (mut value, mut rate) = (DVec3::ZERO, DVec3::ZERO);
        for coefficient in self.0.iter().rev() {
            rate = rate * theta + value;
            value = value * theta + *coefficient;
        }
        // the coefficients are those from θ on
        (value * theta, rate * theta + value)
    }
}

/// A quantity over a step, with time from 0 to 1.
#[derive(Clone, Copy, Debug)]
pub struct Polynomial([f64; 8]);

/// Zero crossings in a step, in order.
#[derive(Clone, Copy, Debug, Default)]
pub struct Crossings {
    count: usize,
    at: [f64; MOST],
}

impl Crossings {
    /// Times of the crossings, as fractions of the step.
    pub fn as_slice(&self) -> &[f64] {
        &self.at[..self.count]
    }

    fn push(&mut self, at: f64) {
        if self.count < MOST {
            self.at[self.count] = at;
            self.count += 1;
        }
    }
}

impl Polynomial {
    /// Interpolates values and rates at the nodes; rates are per step length.
    pub fn new(values: &[f64; 4], rates: &[f64; 4]) -> Polynomial {
        let mut b = BASIS.map(|row| {
            let of_values = (row[0] * values[0] + row[1] * values[1]) + (row[2] * values[2] + row[3] * values[3]);
            let of_rates = (row[4] * rates[0] + row[5] * rates[1]) + (row[6] * rates[2] + row[7] * rates[3]);
            of_values + of_rates
        });
        (b[0], b[7]) = (values[0], values[3]); // equal except for rounding
        Polynomial(b)
    }

    /// The same quantity with its start set to exactly zero.
    pub fn starting_at_zero(mut self) -> Polynomial {
        self.0[0] = 0.0;
        self
    }

    /// Whether the quantity is positive at the start, or immediately after it if it is zero there.
    pub fn starts_positive(&self) -> bool {
        self.0.iter().find(|value| **value != 0.0).is_some_and(|&value| value > 0.0)
    }

    /// The rate at `theta`, per step length.
    pub fn rate_at(&self, theta: f64) -> f64 {
        let (left, right) = split(&self.0, theta);
        if theta > 0.5 { 7.0 * (left[7] - left[6]) / theta } else { 7.0 * (right[1] - right[0]) / (1.0 - theta) }
    }

    /// The sign changes. A quantity that starts at zero has the sign that it takes immediately afterwards.
    pub fn crossings(&self) -> Crossings {
        let mut found = Crossings::default();
        search(&self.0, 0.0, 1.0, 0, &mut found);
        found
    }
}

/// The coefficients before and after `theta` (de Casteljau).
fn split(b: &[f64; 8], theta: f64) -> ([f64; 8], [f64; 8]) {
    let (mut left, mut right, mut row) = ([0.0; 8], [0.0; 8], *b);
    for i in 0..8 {
        left[i] = row[0];
        right[7 - i] = row[7 - i];
        for k in 0..7 - i {
            row[k] += theta * (row[k + 1] - row[k]);
        }
    }
    (left, right)
}

/// The value at `theta` (de Casteljau).
fn value(b: &[f64; 8], theta: f64) -> f64 {
    let mut row = *b;
    for count in (1..8).rev() {
        for k in 0..count {
            row[k] += theta * (row[k + 1] - row[k]);
        }
    }
    row[0]
}

fn sign_changes(b: &[f64; 8]) -> usize {
    let (mut last, mut changes) = (0.0, 0);
    for &value in b {
        if value != 0.0 {
            changes += usize::from(last * value < 0.0);
            last = value.signum();
        }
    }
    changes
}

fn search(b: &[f64; 8], start: f64, end: f64, depth: u32, found: &mut Crossings) {
    const MAX_DEPTH: u32 = 40;
    match sign_changes(b) {
        0 => {}
        1 => found.push(start + (end - start) * only_root(b)),
        _ if depth == MAX_DEPTH => {
            // too close to be distinguished: one crossing if the sign differs after them
            if b[0] * b[7] < 0.0 {
                found.push(0.5 * (start + end));
            }
        }
        _ => {
            let (left, right) = split(b, 0.5);
            let middle = 0.5 * (start + end);
            search(&left, start, middle, depth + 1, found);
            // a root exactly in the middle is the end of one half and the start of the other
            if right[0] == 0.0 && left[6] * right[1] < 0.0 {
                found.push(middle);
            }
            search(&right, middle, end, depth + 1, found);
        }
    }
}

/// The root of a polynomial that has exactly one, to rounding.
fn only_root(b: &[f64; 8]) -> f64 {
    if b[7] == 0.0 {
        return 1.0;
    }
    let first = b.iter().find(|value| **value != 0.0).map_or(0.0, |value| value.abs());
    let side = if b[7] > 0.0 { -1.0 } else { 1.0 };
    between([0.0, 1.0], [first, side * b[7]], |t| side * value(b, t))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn course(f: impl Fn(f64) -> f64, rate: impl Fn(f64) -> f64) -> Polynomial {
        Polynomial::new(&NODES.map(&f), &NODES.map(&rate))
    }

    #[test]
    fn polynomials_of_degree_seven_are_exact() {
        let c = course(|t| 2.0 + t.powi(7) - 3.0 * t.powi(4), |t| 7.0 * t.powi(6) - 12.0 * t.powi(3));
        for i in 0..=10 {
            let t = f64::from(i) / 10.0;
            assert!((value(&c.0, t) - (2.0 + t.powi(7) - 3.0 * t.powi(4))).abs() < 1e-13);
        }
    }

    #[test]
    fn every_crossing_is_found() {
        let roots = [0.1, 0.1001, 0.5, 0.93];
        let f = |t: f64| roots.iter().map(|r| t - r).product::<f64>();
        let rate =
            |t: f64| (0..4).map(|i| (0..4).filter(|&j| j != i).map(|j| t - roots[j]).product::<f64>()).sum::<f64>();
        let found = course(f, rate).crossings();
        assert_eq!(found.as_slice().len(), 4);
        for (found, root) in found.as_slice().iter().zip(roots) {
            assert!((found - root).abs() < 1e-10, "{found} {root}");
        }
    }

    #[test]
    fn touching_zero_is_no_crossing() {
        assert!(course(|t| (t - 0.3) * (t - 0.3) + 1e-9, |t| 2.0 * (t - 0.3)).crossings().as_slice().is_empty());
        assert!(course(|t| t * (1.0 + t), |t| 1.0 + 2.0 * t).starting_at_zero().crossings().as_slice().is_empty());
    }
}
