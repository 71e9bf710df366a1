//! Times of unions, compared with `manifold-rust` in its exact mode in the same run.

use std::time::Instant;

use glam::DVec3;
use meldscope::geometry::union::{Body, Budget, Topology, union};

use super::{
    fuzz,
    scenes::{Shape, sphere},
};

/// Each union is computed for at least this total time [s], and at least [`MIN_RUNS`] times; the shortest time is
/// reported.
const SECONDS: f64 = 1.0;
const MIN_RUNS: u32 = 3;

/// Prints a table.
pub fn print() {
    let (coarse, fine) = (sphere(12, 24), sphere(72, 141));
    // not aligned with the axes, like moving bodies
    let line = |count: u32| -> Vec<DVec3> {
        (0..count).map(|i| f64::from(i) * 1.6 * DVec3::new(0.96, 0.224, 0.168)).collect()
    };
    let at = |i: u32, factor: f64| (f64::from(i) * factor).fract() - 0.5;
    let heap: Vec<DVec3> =
        (0..64).map(|i| DVec3::new(at(i, 0.754877666), at(i, 0.569840291), at(i, 0.438579))).collect();
    println!("spheres                  union, ms  manifold-rust, ms   ratio    goal");
    for (name, shape, centres, goal) in [
        ("two of 266 vertices", &coarse, line(2), 15.0),
        ("two of 10,000 vertices", &fine, line(2), 50.0),
        ("a chain of 300", &coarse, line(300), 20.0),
        ("64 in one place", &coarse, heap, 1.0),
    ] {
        let shapes: Vec<Shape> = centres.iter().map(|&centre| shape.clone().at(centre)).collect();
        let own = own(&shapes);
        let oracle = best(|| drop(fuzz::exact(&shapes)));
        println!("{name:<24} {:>9.3} {:>18.3} {:>7.1} {goal:>7.1}", 1e3 * own, 1e3 * oracle, oracle / own);
    }
    let near = own(&centres_of_two().map(|at| coarse.clone().at(at)));
    let refined = refined_away(&coarse);
    let far = own(&[refined.clone(), mirrored(&refined).at(centres_of_two()[1])]);
    println!(
        "{} times the vertices, all additional ones away from the overlap: {:+.0} %",
        refined.positions.len() / coarse.positions.len(),
        100.0 * (far / near - 1.0)
    );
}

fn centres_of_two() -> [DVec3; 2] {
    [DVec3::ZERO, DVec3::X * 1.6]
}

/// The sphere with the triangles on its negative side, along x, split.
fn refined_away(shape: &Shape) -> Shape {
    let mut shape = shape.clone();
    while shape.positions.len() < 2500 {
        let mut middles = std::collections::HashMap::new();
        let is_split = |positions: &[DVec3], a: u32, b: u32| positions[a as usize].x.max(positions[b as usize].x) < 0.3;
        let mut triangles = Vec::new();
        for [a, b, c] in std::mem::take(&mut shape.triangles) {
            let mut middle = |a: u32, b: u32| {
                is_split(&shape.positions, a, b).then(|| {
                    *middles.entry([a.min(b), a.max(b)]).or_insert_with(|| {
                        let sum = shape.positions[a as usize] + shape.positions[b as usize];
                        shape.positions.push(sum.normalize());
                        shape.positions.len() as u32 - 1
                    })
                })
            };
            match [middle(a, b), middle(b, c), middle(c, a)] {
                [Some(ab), Some(bc), Some(ca)] => {
                    triangles.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
                }
                [Some(ab), None, None] => triangles.extend([[a, ab, c], [ab, b, c]]),
                [None, Some(bc), None] => triangles.extend([[a, b, bc], [a, bc, c]]),
                [None, None, Some(ca)] => triangles.extend([[a, b, ca], [ca, b, c]]),
                _ => triangles.push([a, b, c]), // two edges are never split without the third
            }
        }
        shape.triangles = triangles;
    }
    shape
}

/// The mirror image along x.
fn mirrored(shape: &Shape) -> Shape {
    let positions = shape.positions.iter().map(|p| DVec3::new(-p.x, p.y, p.z)).collect();
    let triangles = shape.triangles.iter().map(|&[a, b, c]| [a, c, b]).collect();
    Shape { positions, triangles }
}

/// Time of a union from positions, with known topologies [s].
fn own(shapes: &[Shape]) -> f64 {
    let topologies: Vec<Topology> =
        shapes.iter().filter_map(|s| Topology::new(s.positions.len(), &s.triangles).ok()).collect();
    best(|| {
        let bodies: Vec<Body> =
            shapes.iter().zip(&topologies).filter_map(|(s, t)| Body::new(t, &s.positions).ok()).collect();
        drop(union(&bodies, &Budget::default()));
    })
}

/// The shortest time of several calls [s].
fn best(mut work: impl FnMut()) -> f64 {
    let (begin, mut best, mut count) = (Instant::now(), f64::INFINITY, 0);
    while count < MIN_RUNS || begin.elapsed().as_secs_f64() < SECONDS {
        let start = Instant::now();
        work();
        best = best.min(start.elapsed().as_secs_f64());
        count += 1;
    }
    best
}
