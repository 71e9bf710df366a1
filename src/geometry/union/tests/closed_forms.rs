//! Unions with known volume, area or Euler characteristic.

use std::f64::consts::PI;

use super::{shapes::*, *};

#[test]
fn two_spheres_make_a_lens_and_its_seam_a_circle() {
    let d = 1.2;
    let mut last = [f64::INFINITY; 3];
    for (stacks, slices) in [(12, 24), (24, 48), (48, 96)] {
        let shapes = [sphere(stacks, slices), sphere(stacks, slices).at(DVec3::X * d)];
        let union = unite(&shapes);
        assert_eq!(union.eulers(), [2]);
        let [seam] = &union.seams[..] else { panic!("{} seams", union.seams.len()) };
        assert!(seam.is_closed && seam.bodies == [0, 1]);
        let exact = [2.0 * 4.0 / 3.0 * PI - lens_volume(d), 2.0 * PI * 0.8, PI * 0.64];
        let found = [union.volume, seam.length, seam.vector_area.length()];
        for k in 0..3 {
            let error = (found[k] - exact[k]).abs() / exact[k];
            assert!(error < 0.45 * last[k], "{error} after {} at {stacks} stacks", last[k]);
            last[k] = error;
        }
        assert!(seam.vector_area.x < 0.0, "towards the first body");
    }
    assert!(last[0] < 2e-3 && last[1] < 1e-3 && last[2] < 2e-3, "{last:?}");
}

#[test]
fn bodies_apart_and_inside_each_other() {
    let s = sphere(6, 12);
    let apart = unite(&[s.clone(), s.clone().at(DVec3::X * 3.0)]);
    assert_eq!(apart.eulers(), [2, 2]);
    assert_eq!(apart.mesh.positions.len(), 2 * s.positions.len());
    let nested = unite(&[s.clone(), s.clone().scaled(0.5), s.clone().scaled(0.3).at(DVec3::X * 0.2)]);
    assert_eq!(nested.eulers(), [2]);
    assert_eq!(nested.mesh.positions, s.positions);
    assert!(unite(&[]).mesh.positions.is_empty());
    assert_eq!(unite(std::slice::from_ref(&s)).mesh.triangles.len(), s.triangles.len());
}

#[test]
fn boxes_that_cross_have_the_volume_of_inclusion_and_exclusion() {
    let long = |axis: usize| {
        let mut shape = cube();
        shape.positions.iter_mut().for_each(|p| p[axis] *= 3.0);
        shape
    };
    // three bars in a cross, with their sides in the same planes: 3 · 24 − 3 · 8 + 8
    let cross = unite(&[long(0), long(1), long(2)]);
    assert!((cross.volume - 56.0).abs() < 1e-6, "{}", cross.volume);
    assert_eq!(cross.eulers(), [2]);
    assert!((cross.area - (6.0 * 4.0 + 12.0 * 2.0 * 4.0)).abs() < 1e-6, "{}", cross.area);
    // a bar through a plate: two seams, and no handle
    let mut plate = cube().scaled(2.0);
    plate.positions.iter_mut().for_each(|p| p.z *= 0.1);
    let pierced = unite(&[plate, long(2)]);
    assert_eq!(pierced.eulers(), [2]);
    assert_eq!(pierced.seams.len(), 2);
    assert!((pierced.volume - (6.4 + 24.0 - 4.0 * 0.4)).abs() < 1e-9);
}

#[test]
fn a_ring_of_spheres_has_a_handle_and_a_lattice_many() {
    let ring: Vec<Shape> = (0..8)
        .map(|i| {
            let (y, x) = (f64::from(i) * PI / 4.0).sin_cos();
            sphere(6, 12).at(DVec3::new(x, y, 0.0) * 0.95 / (PI / 8.0).sin())
        })
        .collect();
    assert_eq!(unite(&ring).eulers(), [0]);
    let lattice: Vec<Shape> = (0..27)
        .map(|i| sphere(6, 12).at(1.9 * DVec3::new(f64::from(i % 3), f64::from(i / 3 % 3), f64::from(i / 9))))
        .collect();
    // a graph of 27 nodes and 54 links: χ of its thickened surface is 2 (27 − 54)
    assert_eq!(unite(&lattice).eulers(), [-54]);
}

/// Of a body of two pieces, either may be inside another body.
#[test]
fn a_piece_inside_touches() {
    let pieces =
        |first: f64| sphere(6, 12).scaled(0.3).at(DVec3::X * first).and(sphere(6, 12).scaled(0.3).at(DVec3::X * 3.0));
    for dumbbell in [pieces(0.0), pieces(6.0).at(-3.0 * DVec3::X)] {
        let shapes = [sphere(6, 12), dumbbell];
        let topologies = shapes.each_ref().map(|s| Topology::new(s.positions.len(), &s.triangles).unwrap());
        let [a, b] = [0, 1].map(|i| Body::new(&topologies[i], &shapes[i].positions).unwrap());
        assert_eq!([contact(&a, &b), contact(&b, &a)], [Some(Contact::Inside); 2]);
    }
}

#[test]
fn a_chain_is_one_component() {
    let chain: Vec<Shape> = (0..20).map(|i| sphere(12, 24).at(DVec3::new(1.9, 0.07, 0.03) * f64::from(i))).collect();
    let union = unite(&chain);
    assert_eq!(union.eulers(), [2]);
    assert_eq!(union.seams.len(), 19);
    compare_inside(&chain, &union, 3, 40);
}

#[test]
fn tori_link_and_merge() {
    let t = torus(1.0, 0.3, 24, 12);
    let upright = t.clone().turned(glam::DMat3::from_rotation_x(PI / 2.0));
    let linked = unite(&[t.clone(), upright.clone().at(DVec3::X)]);
    assert_eq!(linked.eulers(), [0, 0], "not touching");
    let crossed = unite(&[t.clone(), upright]);
    // two rings joined at two places: a graph of 2 nodes and 4 links
    assert_eq!(crossed.eulers(), [-4]);
    let plugged = unite(&[t, sphere(12, 24)]);
    assert_eq!(plugged.eulers(), [2]);
}

#[test]
fn a_void_has_a_negative_volume() {
    // a box of six plates
    let plates: Vec<Shape> = (0..6)
        .map(|i| {
            let mut plate = cube().scaled(1.0 + 0.01 * f64::from(i));
            plate.positions.iter_mut().for_each(|p| p[i as usize / 2] *= 0.1);
            let mut offset = DVec3::ZERO;
            offset[i as usize / 2] = if i % 2 == 0 { 0.9 } else { -0.9 };
            plate.at(offset)
        })
        .collect();
    let union = unite(&plates);
    assert_eq!(union.eulers(), [2, 2]);
    assert_eq!(union.components.iter().filter(|c| c.volume < 0.0).count(), 1);
    compare_inside(&plates, &union, 5, 200);
}

#[test]
fn a_pair_is_measured() {
    let s = sphere(48, 96);
    let topology = Topology::new(s.positions.len(), &s.triangles).unwrap();
    let measured = |d: f64| {
        // off the axes, so that no vertex is the first to touch
        let away = DVec3::new(0.7, 0.1, 0.3).normalize() * d;
        let other: Vec<DVec3> = s.positions.iter().map(|p| *p + away).collect();
        let [a, b] = [&s.positions, &other].map(|p| Body::new(&topology, p).unwrap());
        pair_measures(&a, &b)
    };
    let apart = measured(2.5);
    assert!((apart.gap - 0.5).abs() < 5e-3, "{}", apart.gap);
    assert_eq!((apart.overlap, apart.neck, apart.perimeter), (0.0, 0.0, 0.0));
    let overlapping = measured(1.6);
    // the point of a sphere nearest to the other's centre is 0.4 deep
    assert!((overlapping.gap + 0.4).abs() < 5e-3, "{}", overlapping.gap);
    assert!((overlapping.overlap - lens_volume(1.6)).abs() < 1e-2 * lens_volume(1.6));
    assert!((overlapping.neck - 0.6).abs() < 3e-3 && (overlapping.perimeter - 1.2 * PI).abs() < 1e-2);
    let same = measured(0.0);
    assert!(same.gap.abs() < 1e-3 && (same.overlap - 4.0 / 3.0 * PI).abs() < 1e-2 && same.neck == 0.0);
}

#[test]
fn the_gap_of_a_body_inside_is_its_depth() {
    let (big, small) = (cube().scaled(2.0), octahedron().scaled(0.25).at(DVec3::X));
    let topologies = [&big, &small].map(|s| Topology::new(s.positions.len(), &s.triangles).unwrap());
    let bodies =
        [Body::new(&topologies[0], &big.positions).unwrap(), Body::new(&topologies[1], &small.positions).unwrap()];
    let measures = pair_measures(&bodies[0], &bodies[1]);
    // its leftmost corner is 1.25 from the side
    assert!((measures.gap + 1.25).abs() < 1e-4, "{}", measures.gap);
    assert!((measures.overlap - 4.0 / 3.0 * 0.25f64.powi(3)).abs() < 1e-12);
}
