//! Smooth vertex normals: area-weighted sums of the normals of the adjacent triangles; of faceted meshes those of the
//! triangles.
//!
//! A mesh of rings has its triangles in bands between two rings, with the same two triangles repeated around each band.
//! A band is therefore processed by a few vectorised loops over arrays, without index lookups. Any other mesh is
//! processed triangle by triangle.

use glam::DVec3;
use pulp::{Arch, Simd, WithSimd};

use crate::geometry::{Mesh, Rings, Vectors};

/// Single-precision coordinates, as in the viewer.
pub type Float3 = [f32; 3];

/// Scratch storage, reused from body to body.
#[derive(Debug, Default)]
pub struct NormalScratch {
    /// Positions of two rings, the first of each repeated at its end.
    upper: Vectors,
    lower: Vectors,
    /// Area vectors (times two) of the triangles of a band with one vertex in the upper ring, the last one repeated at
    /// the front.
    single: Vectors,
    /// Area vectors (times two) of the triangles with two vertices in the upper ring, the last one repeated at the
    /// front.
    double: Vectors,
    /// Contribution of the band above to each vertex of a ring.
    above: Vectors,
    sum: Vectors,
}

/// Appends the unit normals of a deformed mesh, and of its copies if it is faceted; `positions` are its vertices relative to
/// its centre.
pub fn append(arch: Arch, mesh: &Mesh, positions: &Vectors, scratch: &mut NormalScratch, normals: &mut Vec<Float3>) {
    if positions.len() != mesh.vertex_count() {
        // the positions do not belong to this mesh
        normals.extend(positions.iter().map(|position| unit(position, DVec3::Z)));
    } else if let Some(facets) = mesh.facets() {
        facets.append_normals(|i| positions.get(i), positions.len(), normals);
    } else if let Some(rings) = mesh.rings() {
        arch.dispatch(All { rings, positions, scratch, normals });
    } else {
        let NormalScratch { sum, .. } = scratch;
        sum.reset(positions.len());
        for corners in mesh.triangles() {
            let [a, b, c] = corners.map(|i| positions.get(i as usize));
            let area = (b - a).cross(c - a);
            corners.iter().for_each(|&i| sum.set(i as usize, sum.get(i as usize) + area));
        }
        normals.extend(sum.iter().zip(positions.iter()).map(|(sum, position)| unit(sum, position)));
    }
}

/// The arguments of [`all`]. (A closure would be compiled for the baseline instruction set.)
struct All<'a> {
    rings: Rings,
    positions: &'a Vectors,
    scratch: &'a mut NormalScratch,
    normals: &'a mut Vec<Float3>,
}

impl WithSimd for All<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        all(self.rings, self.positions, self.scratch, self.normals);
    }
}

#[inline(always)]
fn all(rings: Rings, positions: &Vectors, scratch: &mut NormalScratch, normals: &mut Vec<Float3>) {
    let Rings { bands: stacks, vertices: n } = rings;
    let NormalScratch { upper, lower, single, double, above, sum } = scratch;
    for ring in [&mut *upper, lower, single, double] {
        ring.resize(n + 1);
    }
    for ring in [&mut *above, sum] {
        ring.resize(n);
    }
    let south = positions.len() - 1;

    load(positions, 1, upper);
    cap(positions.get(0), upper, single);
    normals.push(unit(total(single), positions.get(0)));
    for (above, single) in coordinates_mut(above).into_iter().zip(coordinates(single)) {
        let (now, before) = (&single[1..=n], &single[..n]);
        for j in 0..n {
            above[j] = now[j] + before[j];
        }
    }
    for i in 1..stacks - 1 {
        let first = 1 + (i - 1) * n;
        load(positions, first + n, lower);
        band(upper, lower, single, double);
        let sums = coordinates_mut(sum).into_iter().zip(coordinates_mut(above));
        for ((sum, above), (single, double)) in sums.zip(coordinates(single).into_iter().zip(coordinates(double))) {
            let (a, a_before, b, b_before) = (&single[1..=n], &single[..n], &double[1..=n], &double[..n]);
            let (sum, above) = (&mut sum[..n], &mut above[..n]);
            for j in 0..n {
                sum[j] = above[j] + (a[j] + b[j] + b_before[j]);
                above[j] = a[j] + a_before[j] + b_before[j];
            }
        }
        store(sum, positions, first, normals);
        std::mem::swap(upper, lower);
    }
    cap(positions.get(south), upper, single);
    let sums = coordinates_mut(sum).into_iter().zip(coordinates(above));
    for ((sum, above), single) in sums.zip(coordinates(single)) {
        // seen from the other pole, the ring runs in the opposite direction
        let (now, before) = (&single[1..=n], &single[..n]);
        for j in 0..n {
            sum[j] = above[j] - (now[j] + before[j]);
        }
    }
    store(sum, positions, south - n, normals);
    normals.push(unit(-total(single), positions.get(south)));
}

#[inline(always)]
fn coordinates(vectors: &Vectors) -> [&[f64]; 3] {
    [&vectors.x, &vectors.y, &vectors.z]
}

#[inline(always)]
fn coordinates_mut(vectors: &mut Vectors) -> [&mut [f64]; 3] {
    [&mut vectors.x, &mut vectors.y, &mut vectors.z]
}

/// Loads the ring whose vertices begin at `first`.
#[inline(always)]
fn load(positions: &Vectors, first: usize, ring: &mut Vectors) {
    let n = ring.len() - 1;
    for (ring, positions) in coordinates_mut(ring).into_iter().zip(coordinates(positions)) {
        ring[..n].copy_from_slice(&positions[first..first + n]);
        ring[n] = ring[0];
    }
}

/// Area vectors of the triangles between a pole and two adjacent vertices of a ring.
#[inline(always)]
fn cap(pole: DVec3, ring: &Vectors, areas: &mut Vectors) {
    let n = ring.len() - 1;
    for j in 0..n {
        areas.set(j + 1, (ring.get(j) - pole).cross(ring.get(j + 1) - pole));
    }
    areas.set(0, areas.get(n));
}

/// Area vectors of the triangles of quads: (north-west, south-west, south-east) and (north-west, south-east,
/// north-east).
#[inline(always)]
fn band(upper: &Vectors, lower: &Vectors, single: &mut Vectors, double: &mut Vectors) {
    let n = upper.len() - 1;
    let [ux, uy, uz] = coordinates(upper);
    let [lx, ly, lz] = coordinates(lower);
    let [nwx, nwy, nwz] = [ux, uy, uz].map(|ring| &ring[..n]);
    let [nex, ney, nez] = [ux, uy, uz].map(|ring| &ring[1..=n]);
    let [swx, swy, swz] = [lx, ly, lz].map(|ring| &ring[..n]);
    let [sex, sey, sez] = [lx, ly, lz].map(|ring| &ring[1..=n]);
    let [ax, ay, az] = coordinates_mut(single).map(|areas| &mut areas[1..=n]);
    let [bx, by, bz] = coordinates_mut(double).map(|areas| &mut areas[1..=n]);
    for j in 0..n {
        let (px, py, pz) = (swx[j] - nwx[j], swy[j] - nwy[j], swz[j] - nwz[j]);
        let (qx, qy, qz) = (sex[j] - nwx[j], sey[j] - nwy[j], sez[j] - nwz[j]);
        let (rx, ry, rz) = (nex[j] - nwx[j], ney[j] - nwy[j], nez[j] - nwz[j]);
        ax[j] = py * qz - pz * qy;
        ay[j] = pz * qx - px * qz;
        az[j] = px * qy - py * qx;
        bx[j] = qy * rz - qz * ry;
        by[j] = qz * rx - qx * rz;
        bz[j] = qx * ry - qy * rx;
    }
    for areas in [single, double] {
        areas.set(0, areas.get(n));
    }
}

fn total(areas: &Vectors) -> DVec3 {
    areas.iter().skip(1).sum()
}

/// Stores the unit normals of a ring whose vertices begin at `first`.
#[inline(always)]
fn store(sum: &mut Vectors, positions: &Vectors, first: usize, normals: &mut Vec<Float3>) {
    let [x, y, z] = coordinates_mut(sum);
    let n = x.len();
    let (y, z) = (&mut y[..n], &mut z[..n]);
    let mut are_usable = true;
    for j in 0..n {
        let squared = x[j] * x[j] + y[j] * y[j] + z[j] * z[j];
        are_usable &= (f64::MIN_POSITIVE..=f64::MAX).contains(&squared);
        let inverse = 1.0 / squared.sqrt();
        x[j] *= inverse;
        y[j] *= inverse;
        z[j] *= inverse;
    }
    if are_usable {
        normals.extend((0..n).map(|j| [x[j] as f32, y[j] as f32, z[j] as f32]));
    } else {
        normals.extend((0..n).map(|j| unit(DVec3::new(x[j], y[j], z[j]), positions.get(first + j))));
    }
}

/// Normalises a normal; where triangles cancel out, uses the direction from the centre instead.
fn unit(sum: DVec3, position: DVec3) -> Float3 {
    sum.try_normalize().unwrap_or_else(|| position.normalize_or(DVec3::Z)).as_vec3().to_array()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Sphere, shape::Solid as _};

    #[test]
    fn normals_are_sums_over_triangles() {
        for (stacks, slices) in [(2, 3), (3, 3), (2, 5), (3, 7), (12, 24)] {
            let mesh = Sphere { stacks, slices }.mesh();
            let any = Mesh::new(mesh.positions().clone(), mesh.triangles().to_vec());
            let positions: Vectors = mesh
                .positions()
                .iter()
                .enumerate()
                .map(|(i, v)| {
                    0.7 * v + 0.1 * DVec3::new((i as f64).sin(), (3.0 * i as f64).cos(), (7.0 * i as f64).sin())
                })
                .collect();
            let mut expected = vec![DVec3::ZERO; positions.len()];
            for corners in mesh.triangles() {
                let [a, b, c] = corners.map(|i| positions.get(i as usize));
                corners.iter().for_each(|&i| expected[i as usize] += (b - a).cross(c - a));
            }
            for mesh in [&mesh, &any] {
                let mut normals = Vec::new();
                append(Arch::new(), mesh, &positions, &mut NormalScratch::default(), &mut normals);
                assert_eq!(normals.len(), expected.len());
                for (normal, expected) in normals.iter().zip(&expected) {
                    let normal = DVec3::from_array(normal.map(f64::from));
                    assert!(normal.distance(expected.normalize()) < 1e-6, "{stacks}x{slices}: {normal} {expected}");
                }
            }
        }
    }

    #[test]
    fn degenerate_triangles_have_unit_normals() {
        let mesh = Sphere { stacks: 4, slices: 6 }.mesh();
        for size in [0.0, 1e-200, 1e-30, 1e200] {
            let positions: Vectors = mesh.positions().iter().map(|v| v * size).collect();
            let mut normals = Vec::new();
            append(Arch::new(), &mesh, &positions, &mut NormalScratch::default(), &mut normals);
            for normal in normals {
                let length = DVec3::from_array(normal.map(f64::from)).length();
                assert!((length - 1.0).abs() < 1e-6, "{size}: {normal:?}");
            }
        }
    }
}
