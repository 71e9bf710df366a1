//! Random bodies, including every degenerate kind.

use proptest::prelude::*;

use super::{shapes::*, *};

/// Bodies with many combinations of properties: alike or not, on a lattice or not, in a plane or not; boxes, rings,
/// several components, inside out; shaken until they intersect themselves; an ulp apart; rotated and far away.
fn scene(seed: u64) -> Vec<Shape> {
    let mut random = Random::new(seed);
    let sizes = [(2, 3), (3, 5), (4, 4), (6, 12), (12, 24)];
    let lattice = [0.0, 0.25, 0.5, 1.0][random.below(4)];
    let (one_size, one_radius, flat) = (random.next() < 0.5, random.next() < 0.6, random.next() < 0.4);
    let (size, extent, kind) = (sizes[random.below(5)], 0.6 + 5.0 * random.next(), random.below(10));
    let mut shapes: Vec<(Shape, f64)> = (0..2 + random.below(4))
        .map(|_| {
            let mut centre = extent * random.in_cube();
            if lattice > 0.0 {
                centre = (centre / lattice).round() * lattice;
            }
            if flat {
                centre.z = 0.0;
            }
            let (stacks, slices) = if one_size { size } else { sizes[random.below(5)] };
            let radius = if one_radius { 1.0 } else { 0.1 + random.next() };
            let shape = match kind {
                0 => cube(),
                1 => torus(1.0, 0.4, 3 + slices / 2, 3 + stacks / 2),
                2 if random.next() < 0.5 => cube(),
                3 => sphere(stacks, slices).and(sphere(stacks, slices).at(DVec3::X * 2.0 * random.next())),
                _ => sphere(stacks, slices),
            };
            let shape = if random.next() < 0.1 { shape.inverted() } else { shape };
            (shape.scaled(radius).at(centre), radius)
        })
        .collect();
    let shake = 0.4 * random.next() * random.next();
    match random.below(5) {
        0 => shapes.iter_mut().for_each(|s| s.0 = s.0.clone().shaken(&mut random, shake * s.1)),
        1 => {
            let (turn, offset) = (random.rotation(), random.in_cube() * [0.0, 100.0, 1e6][random.below(3)]);
            shapes.iter_mut().for_each(|s| s.0 = s.0.clone().turned(turn).at(offset));
        }
        2 => {
            let by = f64::EPSILON * [1.0, 100.0, 1e6][random.below(3)];
            shapes.iter_mut().for_each(|s| s.0 = s.0.clone().at(by * random.in_cube()));
        }
        _ => {}
    }
    shapes.into_iter().map(|s| s.0).collect()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 96, failure_persistence: None, ..ProptestConfig::default() })]

    /// Closed, manifold, oriented, untouched vertices to the bit (all in `unite`); inside where a body is.
    #[test]
    fn any_bodies_have_a_union(seed in 0u64..1 << 40) {
        let shapes = scene(seed);
        let union = unite(&shapes);
        compare_inside(&shapes, &union, seed, 24);
    }

    /// Arbitrary coordinates: no panic, and any result is closed.
    #[test]
    fn any_numbers_are_accepted_or_rejected(
        coordinates in prop::collection::vec(prop_oneof![any::<f64>(), -2.0..2.0, Just(0.0), Just(f64::NAN)], 36),
        scale in prop_oneof![Just(1.0), Just(1e-200), Just(1e80)],
    ) {
        let shape = octahedron();
        let topology = Topology::new(6, &shape.triangles).unwrap();
        let positions: Vec<DVec3> = coordinates.chunks(3).map(|c| DVec3::from_slice(c) * scale).collect();
        let bodies: Result<Vec<Body>, _> = positions.chunks(6).map(|p| Body::new(&topology, p)).collect();
        if let Ok(bodies) = bodies
            && let Ok(union) = union(&bodies, &Budget { work: 1_000_000, ..Budget::default() })
        {
            assert_closed(&union.mesh());
        }
    }

    #[test]
    fn flat_and_pointed_bodies_are_accepted(seed in 0u64..1 << 40) {
        let mut random = Random::new(seed);
        let shapes: Vec<Shape> = (0..3).map(|_| {
            let mut shape = sphere(4, 8);
            let flat = [0.0, 1e-12, 1e-3][random.below(3)];
            let axis = random.below(3);
            shape.positions.iter_mut().for_each(|p| p[axis] *= flat);
            if random.next() < 0.5 {
                let to = shape.positions[random.below(26)];
                for _ in 0..8 {
                    let at = random.below(26);
                    shape.positions[at] = to;
                }
            }
            shape.at(random.in_cube())
        }).collect();
        unite(&shapes);
    }
}
