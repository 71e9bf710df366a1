//! The effect of an influence sphere on a vertex: (3.3), (3.4), (3.5).

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
    /// Radius of an influence sphere over the radius of its body, r_e / R [–].
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
        match self.scaling {
            Scaling::Absolute => 1.0,
            Scaling::Relative => f64::min(1.0, radius / source_radius),
        }
    }

    /// The radius r_e of the influence sphere of a body [scene unit].
    pub fn sphere_radius(&self, radius: f64) -> f64 {
        self.reach * radius
    }
}

impl Weight {
    /// W(z) for z = r / r_e ≥ 0 [–]; (3.3) for [`Weight::Linear`].
    #[inline]
    pub fn at(self, z: f64) -> f64 {
        if z >= 1.0 {
            return 0.0;
        }
        let y = 1.0 - z;
        match self {
            Weight::Linear => y,
            Weight::Wendland => (y * y) * (y * y) * (4.0 * z + 1.0),
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
