//! The numerical core that both solvers use.
//!
//! | contents | module |
//! | --- | --- |
//! | the instants of a step at which forces are sampled | [`nodes`] |
//! | polynomials through values at nodes, and their integrals | [`lagrange`] |
//! | the response of an oscillator to such forces, at any instant of a step | [`dense`] |
//! | sign changes of polynomials, without missing any | [`bernstein`] |
//! | roots of functions of time | [`roots`] |
//! | the constants that decide accuracy and step size | [`control`] |
//! | state as arrays, and arithmetic in SIMD lanes | [`arrays`], [`lanes`] |

pub mod arrays;
pub mod bernstein;
pub mod control;
pub mod dense;
pub mod lagrange;
pub mod lanes;
pub mod nodes;
pub mod roots;

/// The larger of two numbers, or NaN if either is NaN, which `f64::max` would ignore.
pub fn larger(a: f64, b: f64) -> f64 {
    if b > a || b.is_nan() { b } else { a }
}
