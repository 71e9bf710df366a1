//! Voxelisation: the cubes of a grid that a closed mesh covers.

use std::sync::atomic::AtomicBool;

use glam::DVec3;

use crate::{geometry::Mesh, interrupt::is_raised};

/// Boxes are tested at this size, so that cells that the surface only touches are not part of the body.
const SHRINK: f64 = 1.0 - 1e-9;
/// Lines through the centres of cells are shifted by this fraction of a cell, off the vertices and edges of meshes
/// aligned with the grid.
const SHIFT: [f64; 2] = [7.34e-7, 4.12e-7];

/// Whether each of the `across`³ grid cells over [−1, 1]³ overlaps the body, in ascending order of z, y, x. `None` if
/// interrupted.
pub fn cover(mesh: &Mesh, across: u32, interrupt: Option<&AtomicBool>) -> Option<Vec<bool>> {
    let n = across as usize;
    let scale = 0.5 * f64::from(across);
    let mut inside = vec![false; n * n * n];
    // change of the winding number from the cell below, along z
    let mut change = vec![0i32; n * n * n];
    for &corners in mesh.triangles() {
        if is_raised(interrupt) {
            return None;
        }
        let points = corners.map(|i| (mesh.positions().get(i as usize) + 1.0) * scale);
        let [a, b, c] = points;
        let (low, high) = (a.min(b).min(c), a.max(b).max(c));
        let first = |axis: usize| low[axis].floor().clamp(0.0, n as f64 - 1.0) as usize;
        let last = |axis: usize| high[axis].floor().clamp(0.0, n as f64 - 1.0) as usize;
        for k in first(2)..=last(2) {
            for j in first(1)..=last(1) {
                for i in first(0)..=last(0) {
                    let centre = DVec3::new(i as f64 + 0.5, j as f64 + 0.5, k as f64 + 0.5);
                    let at = (k * n + j) * n + i;
                    inside[at] = inside[at] || overlaps(points.map(|point| point - centre));
                }
            }
        }
        for j in first(1)..=last(1) {
            for i in first(0)..=last(0) {
                let [x, y] = [i as f64 + 0.5 + SHIFT[0], j as f64 + 0.5 + SHIFT[1]];
                if let Some((z, sign)) = crossing(points, corners, x, y) {
                    // the first cell whose centre is above
                    let k = (z + 0.5).floor().max(0.0) as usize;
                    if k < n {
                        change[(k * n + j) * n + i] += sign;
                    }
                }
            }
        }
    }
    for column in 0..n * n {
        let mut winding = 0;
        for k in 0..n {
            winding += change[k * n * n + column];
            inside[k * n * n + column] |= winding != 0;
        }
    }
    Some(inside)
}

/// The height at which the line along z through (x, y) crosses a triangle, and the change of the winding number there.
/// The side of an edge is decided consistently for both of its triangles.
fn crossing([a, b, c]: [DVec3; 3], corners: [u32; 3], x: f64, y: f64) -> Option<(f64, i32)> {
    let side = |(p, i): (DVec3, u32), (q, j): (DVec3, u32)| {
        let of = |p: DVec3, q: DVec3| (q.x - p.x) * (y - p.y) - (q.y - p.y) * (x - p.x);
        if i < j { of(p, q) >= 0.0 } else { !(of(q, p) >= 0.0) }
    };
    let ends = [(a, corners[0]), (b, corners[1]), (c, corners[2])];
    let sides = [0, 1, 2].map(|k| side(ends[k], ends[(k + 1) % 3]));
    if sides != [sides[0]; 3] {
        return None;
    }
    let normal = (b - a).cross(c - a);
    let z = a.z - (normal.x * (x - a.x) + normal.y * (y - a.y)) / normal.z;
    // counter-clockwise seen from above: the outside is above
    z.is_finite().then_some((z, if sides[0] { -1 } else { 1 }))
}

/// Whether a triangle overlaps the cube of side 1 about the origin: no axis separates them (Akenine-Möller, Fast 3D
/// triangle-box overlap testing, 2001).
fn overlaps(points: [DVec3; 3]) -> bool {
    let half = 0.5 * SHRINK;
    let [a, b, c] = points;
    let separates = |axis: DVec3| {
        let [p, q, r] = points.map(|point| point.dot(axis));
        let reach = half * (axis.x.abs() + axis.y.abs() + axis.z.abs());
        p.min(q).min(r) > reach || p.max(q).max(r) < -reach
    };
    let edges = [b - a, c - b, a - c];
    let units = [DVec3::X, DVec3::Y, DVec3::Z];
    !(units.into_iter().any(separates)
        || separates(edges[0].cross(edges[1]))
        || edges.into_iter().any(|edge| units.into_iter().any(|unit| separates(unit.cross(edge)))))
}
