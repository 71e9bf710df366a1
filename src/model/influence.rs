//! The effect of an influence sphere on a vertex: (3.3), (3.4), (3.5).

use std::ops::{Add, Mul, Sub};

use glam::DVec3;

/// The weight W of a vertex at distance z·r_e from the centre of an influence sphere, by its shape inside the sphere.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Weight {
    /// (3.3): `1 − z`. Has a kink at the rim, z = 1.
    #[default]
    Linear,
    /// Wendland C2: `(1 − z)⁴(4z + 1)`. Same support, smooth at the rim (Wendland 1995).
    Wendland,
}

/// How the strength of a source depends on the sizes of the two bodies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scaling {
    /// The strength times `min(1, R_i / R_j)`, where R_i is the radius of the body acted on. No effect for equal sizes.
    Relative,
    /// The strength unchanged, as in the thesis.
    Absolute,
}

impl Scaling {
    /// The factor on the strength of a source of radius `source` on a body of radius `radius` [–].
    pub fn factor(self, radius: f64, source: f64) -> f64 {
        match self {
            Scaling::Absolute => 1.0,
            Scaling::Relative => f64::min(1.0, radius / source),
        }
    }
}

/// The influence law of a scene: all parameters of (3.3)–(3.5) that are common to all bodies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Influence {
    /// Strength α of attraction (3.4) [1/s²].
    pub alpha: f64,
    /// Strength β of repulsion (3.5) [1/s²].
    pub beta: f64,
    /// Radius of an influence sphere over the radius R that belongs to it, r_e / R [–]: of force points, and of bodies
    /// whose own `reach` is not given.
    pub reach: f64,
    /// The shape of the weight (3.3).
    pub weight: Weight,
    /// Dependence of the strength on the sizes.
    pub scaling: Scaling,
    /// Whether pairs that are apart repel (β) or do nothing.
    pub apart_repels: bool,
}

impl Influence {
    /// The factor on the strength of a source [–], from the radii of the body acted on and of the source [scene unit].
    pub fn scale(&self, radius: f64, source_radius: f64) -> f64 {
        self.scaling.factor(radius, source_radius)
    }

    /// The radius r_e of an influence sphere that belongs to a radius R, for this reach [scene unit].
    pub fn sphere_radius(&self, radius: f64) -> f64 {
        self.reach * radius
    }
}

/// What a weight is computed with: a number, or a number in each SIMD lane.
pub trait Real: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Mul<f64, Output = Self> {
    /// A constant, of the same kind as this number.
    fn constant(self, value: f64) -> Self;
}

impl Real for f64 {
    #[inline(always)]
    fn constant(self, value: f64) -> f64 {
        value
    }
}

impl Weight {
    /// W(z) inside the sphere, z ≤ 1 [–]; beyond it, the continuation of the polynomial.
    #[inline(always)]
    pub fn inside<R: Real>(self, z: R) -> R {
        let one = z.constant(1.0);
        let y = one - z;
        match self {
            Weight::Linear => y, // (3.3)
            Weight::Wendland => (y * y) * (y * y) * (z * 4.0 + one),
        }
    }

    /// ∫ z W dz from 0 to z ≤ 1 [–]: `z²/2 − z³/3` for the linear weight; for Wendland's, the integral of
    /// `z(1 − z)⁴(4z + 1)`, which is `z²/2 − 5z⁴/2 + 4z⁵ − 5z⁶/2 + 4z⁷/7`.
    #[inline(always)]
    pub fn potential<R: Real>(self, z: R) -> R {
        let number = |value: f64| z.constant(value);
        let z2 = z * z;
        match self {
            Weight::Linear => z2 * (number(1.0 / 2.0) - z * (1.0 / 3.0)),
            Weight::Wendland => {
                let inner = number(-2.5) + z * (number(4.0) + z * (number(-2.5) + z * (4.0 / 7.0)));
                z2 * (number(0.5) + z2 * inner)
            }
        }
    }

    /// W(z) for z = r / r_e ≥ 0 [–]; (3.3) for [`Weight::Linear`].
    #[inline]
    pub fn at(self, z: f64) -> f64 {
        if z >= 1.0 { 0.0 } else { self.inside(z) }
    }

    /// |dW/dz| at the centre, z = 0 [–]: the force `(c − r) W` turns there like |x| x.
    pub fn slope_at_centre(self) -> f64 {
        match self {
            Weight::Linear => 1.0,
            Weight::Wendland => 0.0, // 1 − 10 z² + …
        }
    }

    /// The largest value of `z·W(z)` [–]: bounds the acceleration of one source by `s·r_e` times this.
    pub fn max_pull(self) -> f64 {
        match self {
            Weight::Linear => 0.25, // at z = 1/2
            // d/dz z(1−z)⁴(4z+1) = (1−z)³(1 + 3z − 24z²) = 0 at z = (3 + √105)/48
            Weight::Wendland => {
                let z = (3.0 + 105f64.sqrt()) / 48.0;
                z * self.at(z)
            }
        }
    }
}

/// (3.4) and (3.5): the acceleration of a vertex by one influence sphere [scene unit/s²].
///
/// `to_centre` is c_j − r_i, from the vertex to the centre of the sphere; `sphere_radius` its r_e; `strength` is
/// signed: see [`PairLaw::strength`](super::PairLaw::strength). Zero outside the sphere and at its centre.
#[inline]
pub fn acceleration(weight: Weight, strength: f64, sphere_radius: f64, to_centre: DVec3) -> DVec3 {
    let z = to_centre.length() / sphere_radius;
    to_centre * (strength * weight.at(z))
}
