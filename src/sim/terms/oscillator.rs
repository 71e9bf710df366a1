//! The vertices' own oscillators (3.2). Integrators use their exact flow or write them out, so they contribute nothing
//! to the forces on a body; this file computes their share for observation.

use super::{Cause, Term};
use crate::{model::energy, scene::Material, sim::numerics::arrays::Vectors};

pub struct Springs;

impl Term for Springs {}

/// The accelerations by springs and damping, as multiples of the displacements and velocities [scene unit/s²].
pub fn accelerations<'a>(
    material: Material,
    displacement: &'a Vectors,
    velocity: &'a Vectors,
) -> [(Cause, f64, &'a Vectors); 2] {
    let Material { omega, damping, .. } = material;
    [(Cause::Restoring, -(omega * omega), displacement), (Cause::Damping, -2.0 * damping, velocity)]
}

/// Kinetic and elastic energy of a body's vertices, per unit of vertex mass [scene unit²/s²].
pub fn energy(material: Material, displacement: &Vectors, velocity: &Vectors) -> [f64; 2] {
    [energy::kinetic(sum_of_squares(velocity)), energy::elastic(material.omega, sum_of_squares(displacement))]
}

/// Σ |v|², in eight parallel sums so that the loop vectorises.
fn sum_of_squares(vectors: &Vectors) -> f64 {
    const LANES: usize = 8;
    let n = vectors.len();
    let (x, y, z) = (&vectors.x[..n], &vectors.y[..n], &vectors.z[..n]);
    let mut sums = [0.0; LANES];
    for first in (0..n / LANES * LANES).step_by(LANES) {
        let [x, y, z] = [x, y, z].map(|axis| &axis[first..first + LANES]);
        for lane in 0..LANES {
            sums[lane] += x[lane] * x[lane] + y[lane] * y[lane] + z[lane] * z[lane];
        }
    }
    let rest = (n / LANES * LANES..n).map(|i| x[i] * x[i] + y[i] * y[i] + z[i] * z[i]);
    sums.iter().sum::<f64>() + rest.sum::<f64>()
}
