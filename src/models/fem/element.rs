//! Linear tetrahedra in a cube, and the stiffness of the cube.

use glam::{DMat3, DVec3};

use crate::{
    model::shape_matching::outer,
    models::cells::{TETRAHEDRA, corner},
};

/// Young's modulus and Poisson's ratio of an isotropic material.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Elasticity {
    /// Young's modulus E [mass/(scene unit · s²)], > 0.
    pub young: f64,
    /// Poisson's ratio ν [–], −1 < ν < 1/2.
    pub poisson: f64,
}

impl Elasticity {
    /// Lamé's λ and μ [mass/(scene unit · s²)].
    pub fn lame(self) -> [f64; 2] {
        let Elasticity { young, poisson } = self;
        [young * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson)), 0.5 * young / (1.0 + poisson)]
    }

    /// σ = λ tr(ε) 1 + 2μ ε, for the symmetric part ε of a gradient.
    pub fn stress(self, gradient: DMat3) -> DMat3 {
        let [lambda, mu] = self.lame();
        let trace = gradient.x_axis.x + gradient.y_axis.y + gradient.z_axis.z;
        DMat3::from_diagonal(DVec3::splat(lambda * trace)) + (gradient + gradient.transpose()) * mu
    }
}

/// The gradients of the shape functions of a tetrahedron in a cube of side 1, given its corners.
pub fn gradients(tetrahedron: [usize; 4]) -> [DVec3; 4] {
    let [a, b, c, d] = tetrahedron.map(corner);
    // rows of the inverse of [b − a, c − a, d − a]
    let inverse = DMat3::from_cols(b - a, c - a, d - a).inverse().transpose();
    let [p, q, r] = [inverse.x_axis, inverse.y_axis, inverse.z_axis];
    [-(p + q + r), p, q, r]
}

/// The stiffness matrix of a cube of side 1 as 3×3 blocks: a displacement of corner j exerts a force of −block (i, j)
/// times it on corner i. For a cube of side h, it is h times that.
pub fn cube_stiffness(elasticity: Elasticity) -> [[DMat3; 8]; 8] {
    let [lambda, mu] = elasticity.lame();
    let mut sum = [[DMat3::ZERO; 8]; 8];
    for tetrahedron in TETRAHEDRA {
        let gradients = gradients(tetrahedron);
        for (i, p) in tetrahedron.into_iter().zip(gradients) {
            for (j, q) in tetrahedron.into_iter().zip(gradients) {
                // V (λ p qᵀ + μ q pᵀ + μ p·q 1)
                let block = outer(p, q) * lambda + outer(q, p) * mu + DMat3::from_diagonal(DVec3::splat(mu * p.dot(q)));
                sum[i][j] += block * (1.0 / 6.0);
            }
        }
    }
    sum
}

/// The largest eigenvalue of a symmetric matrix, in closed form (Smith, Eigenvalues of a symmetric 3 × 3 matrix, 1961).
pub fn largest_eigenvalue(matrix: DMat3) -> f64 {
    let mean = (matrix.x_axis.x + matrix.y_axis.y + matrix.z_axis.z) / 3.0;
    let deviator = matrix - DMat3::from_diagonal(DVec3::splat(mean));
    let square = (0..3).map(|i| deviator.col(i).length_squared()).sum::<f64>() / 6.0;
    let p = square.sqrt();
    if !(p > 0.0) {
        return mean;
    }
    let half = (0.5 * (deviator * (1.0 / p)).determinant()).clamp(-1.0, 1.0);
    mean + 2.0 * p * libm::cos(libm::acos(half) / 3.0)
}
