//! Contact, coincidence and alignment; bodies that are inside out, self-intersecting or too small; and invariances of a
//! union.

use super::{shapes::*, *};

#[test]
fn contact_stays_apart() {
    let c = cube();
    for offset in [DVec3::X, DVec3::new(1.0, 1.0, 0.0), DVec3::ONE, DVec3::new(1.0, 0.3, 0.0)] {
        let union = unite(&[c.clone(), c.clone().at(2.0 * offset)]);
        assert_eq!(union.eulers(), [2, 2], "{offset}");
        assert_eq!(union.volume, 16.0);
    }
    // pole on pole, and equator vertex on equator vertex
    let s = sphere(12, 24);
    for offset in [DVec3::X, DVec3::Z] {
        assert_eq!(unite(&[s.clone(), s.clone().at(2.0 * offset)]).eulers(), [2, 2]);
    }
    assert_eq!(unite(&[octahedron(), octahedron().at(DVec3::X * 2.0)]).eulers(), [2, 2]);
    assert_eq!(unite(&[octahedron(), octahedron().at(DVec3::new(1.0, 1.0, 0.0))]).eulers(), [2, 2], "edge on edge");
}

#[test]
fn copies_count_once() {
    let s = sphere(12, 24);
    let copies = vec![s.clone(); 5];
    let union = unite(&copies);
    assert_eq!(union.mesh.positions, s.positions);
    assert_eq!(union.eulers(), [2]);
    // near copies, from an ulp to a millionth apart
    for by in [f64::EPSILON, 1e-12, 1e-10, 1e-9, 1e-8, 1e-6] {
        let shapes = [s.clone(), s.clone().at(DVec3::new(by, 2.0 * by, 0.0))];
        let union = unite(&shapes);
        assert!((union.volume - 4.0705).abs() < 1e-4, "{by}: {}", union.volume);
        assert_eq!(union.components.iter().filter(|c| c.volume > 1.0).count(), 1);
    }
}

#[test]
fn aligned_boxes_share_planes() {
    let c = cube();
    for offset in [DVec3::X, DVec3::new(1.0, 1.0, 0.0), DVec3::ONE, DVec3::new(0.5, 0.0, 2.0 - 1e-3)] {
        let shapes = [c.clone(), c.clone().at(offset)];
        let union = unite(&shapes);
        let expected = 16.0 - (DVec3::splat(2.0) - offset).to_array().iter().product::<f64>();
        assert!((union.volume - expected).abs() < 1e-6, "{offset}: {} for {expected}", union.volume);
        assert_eq!(union.eulers(), [2]);
    }
    // a cube in a corner of another, with three sides in common
    assert_eq!(unite(&[c.clone(), c.clone().scaled(0.5).at(DVec3::splat(0.5))]).eulers(), [2]);
    let bricks: Vec<Shape> = (0..27)
        .map(|i| c.clone().at(1.5 * DVec3::new(f64::from(i % 3), f64::from(i / 3 % 3), f64::from(i / 9))))
        .collect();
    let wall = unite(&bricks);
    assert_eq!(wall.eulers(), [2]);
    assert!((wall.volume - 125.0).abs() < 1e-5, "{}", wall.volume);
}

#[test]
fn a_body_inside_out_adds_nothing() {
    let s = sphere(12, 24);
    let with = unite(&[s.clone(), s.clone().inverted().at(DVec3::new(1.3, 0.1, 0.2))]);
    assert!(with.mesh.positions == s.positions);
    assert!(unite(&[s.clone().inverted()]).mesh.triangles.is_empty());
    // not even where bodies that are inside out overlap each other
    let shapes = [s.clone().inverted(), s.inverted().at(DVec3::X)];
    assert!(unite(&shapes).mesh.triangles.is_empty());
}

#[test]
fn self_intersecting_bodies_count_once() {
    let s = sphere(8, 16);
    // two components of one mesh give the same as two bodies
    let apart = [s.clone(), s.clone().at(DVec3::new(1.3, 0.2, 0.1))];
    let one = [s.clone().and(s.clone().at(DVec3::new(1.3, 0.2, 0.1)))];
    let (apart, one_union) = (unite(&apart), unite(&one));
    assert!((apart.volume - one_union.volume).abs() < 1e-12);
    assert_eq!(one_union.eulers(), [2]);
    // a hollow sphere, its inner surface inside out, with one sphere in the hollow and one through the wall
    let hollow = s.clone().and(s.clone().scaled(0.6).inverted());
    let shapes = [hollow, s.clone().scaled(0.2), s.clone().scaled(0.3).at(DVec3::X * 0.8)];
    let union = unite(&shapes);
    assert_eq!(union.components.len(), 3);
    compare_inside(&shapes, &union, 11, 200);
    for (seed, by) in [(1, 0.1), (2, 0.2), (3, 0.35), (4, 0.5)] {
        let mut random = Random::new(seed);
        let shapes = [s.clone().shaken(&mut random, by), s.clone().at(DVec3::X * 1.2).shaken(&mut random, by)];
        let union = unite(&shapes);
        assert!(union.statistics.folds > 0);
        compare_inside(&shapes, &union, seed, 200);
    }
}

#[test]
fn touching_fans_are_split() {
    // an octahedron and a tetrahedron with one vertex in common, in one mesh
    let mut shape = octahedron();
    let first = shape.positions.len() as u32;
    shape.positions.extend([DVec3::new(0.5, 0.0, 2.0), DVec3::new(-0.5, 0.5, 2.0), DVec3::new(-0.5, -0.5, 2.0)]);
    let (a, b, c) = (first, first + 1, first + 2);
    shape.triangles.extend([[0, b, a], [0, c, b], [0, a, c], [a, b, c]]);
    let union = unite(std::slice::from_ref(&shape));
    assert_eq!(union.eulers(), [2, 2]);
    let with = [shape, octahedron().scaled(0.3).at(DVec3::Z)];
    let union = unite(&with);
    assert_eq!(union.eulers(), [2]);
    compare_inside(&with, &union, 2, 100);
}

#[test]
fn bodies_too_small_to_resolve_are_left_out() {
    let shapes = [sphere(6, 12), octahedron().scaled(1e-12).at(DVec3::X * 1.5), octahedron().scaled(0.0)];
    let union = unite(&shapes);
    assert_eq!((union.eulers(), union.statistics.dropped), (vec![2], 2));
    // at any scale, and far away from the origin
    for scale in [1e-80, 1e-3, 1e3, 1e60] {
        let shapes = [sphere(6, 12), sphere(6, 12).at(DVec3::new(1.2, 0.1, 0.3))].map(|s| s.scaled(scale));
        assert_eq!(unite(&shapes).eulers(), [2], "{scale}");
    }
    let far = [sphere(6, 12), sphere(6, 12).at(DVec3::new(1.2, 0.1, 0.3))].map(|s| s.at(DVec3::splat(1e5)));
    assert_eq!(unite(&far).eulers(), [2]);
}

#[test]
fn invalid_input_is_rejected() {
    let s = octahedron();
    let topology = Topology::new(s.positions.len(), &s.triangles).unwrap();
    for bad in [f64::NAN, f64::INFINITY, -1e300] {
        let mut positions = s.positions.clone();
        positions[3].y = bad;
        assert!(matches!(Body::new(&topology, &positions), Err(BodyError::Position { vertex: 3, .. })));
    }
    assert!(matches!(Body::new(&topology, &s.positions[1..]), Err(BodyError::Count { given: 5, wanted: 6 })));

    let error = |triangles: &[[u32; 3]]| Topology::new(6, triangles).unwrap_err();
    assert!(matches!(error(&s.triangles[1..]), TopologyError::Unpaired { count: 3, .. }));
    assert!(matches!(error(&[[0, 1, 9]]), TopologyError::NoSuchVertex { vertex: 9, .. }));
    assert!(matches!(error(&[[0, 1, 1]]), TopologyError::RepeatedVertex { vertex: 1, .. }));
    assert!(matches!(error(&[[0, 1, 2], [0, 2, 1]]), TopologyError::SameTriangle { .. }));
    let twice: Vec<_> = s.triangles.iter().chain(&s.triangles).copied().collect();
    assert!(matches!(error(&twice), TopologyError::Unpaired { .. }));
}

#[test]
fn a_budget_ends_the_union() {
    let mut random = Random::new(1);
    let shapes = [sphere(12, 24).shaken(&mut random, 0.5), sphere(12, 24).shaken(&mut random, 0.5)];
    let budget = Budget { work: 10_000, ..Budget::default() };
    let Err(UnionError::GaveUp { work, .. }) = try_unite(&shapes, &budget) else { panic!("it did not") };
    assert!(work > 10_000 && work < 100_000);
}

/// Candidates take most of the time of a crumpled body: if they did not count, neither a budget nor an interrupt would
/// end its union.
#[test]
fn every_candidate_is_counted() {
    let crumpled = [sphere(12, 24).shaken(&mut Random::new(1), 0.5)];
    let statistics = unite(&crumpled).statistics;
    assert!(statistics.work > 2 * statistics.tests as u64, "{statistics:?}");
}

/// The triangles by the bits of their corners' positions, each starting at its smallest corner.
fn canonical(mesh: &UnionMesh) -> Vec<[[u64; 3]; 3]> {
    let mut triangles: Vec<[[u64; 3]; 3]> = (mesh.triangles.iter())
        .map(|corners| {
            let mut bits = corners.map(|v| mesh.positions[v as usize].to_array().map(f64::to_bits));
            let least = (0..3).min_by_key(|&k| bits[k]).unwrap();
            bits.rotate_left(least);
            bits
        })
        .collect();
    triangles.sort_unstable();
    triangles
}

fn some_scenes() -> Vec<Vec<Shape>> {
    let mut random = Random::new(9);
    let crowd = (0..12).map(|_| sphere(8, 16).at(2.5 * random.in_cube())).collect();
    let folded = (0..3).map(|_| sphere(8, 16).at(2.0 * random.in_cube()).shaken(&mut random, 0.15)).collect();
    let aligned =
        (0..8).map(|i| cube().at(DVec3::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2)))).collect();
    vec![crowd, folded, aligned]
}

#[test]
fn the_order_of_bodies_does_not_matter() {
    for shapes in some_scenes() {
        let reference = canonical(&unite(&shapes).mesh);
        let reversed: Vec<Shape> = shapes.iter().rev().cloned().collect();
        let mut rotated = shapes.clone();
        rotated.rotate_left(2);
        for other in [reversed, rotated] {
            assert!(canonical(&unite(&other).mesh) == reference);
        }
    }
}

#[test]
fn the_number_of_threads_does_not_matter() {
    let big = vec![sphere(60, 120), sphere(60, 120).at(DVec3::new(0.4, 0.2, 0.1)), sphere(60, 120).at(DVec3::Z * 0.5)];
    for shapes in some_scenes().into_iter().chain([big]) {
        let meshes = [1, 2, 8].map(|threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| unite(&shapes).mesh)
        });
        assert!(meshes[0] == meshes[1] && meshes[0] == meshes[2]);
    }
}

/// Skipping buried triangles changes nothing: compared with bodies without a known ball inside, where everything is
/// cut.
#[test]
fn skipping_buried_triangles_changes_nothing() {
    let mut random = Random::new(11);
    let heap: Vec<Shape> = (0..24).map(|_| sphere(8, 16).at(0.5 * random.in_cube())).collect();
    let sizes: Vec<Shape> = (0..16)
        .map(|_| sphere(10, 20).scaled(0.2 + random.next()).shaken(&mut random, 0.02).at(random.in_cube()))
        .collect();
    let folded: Vec<Shape> = (0..10)
        .map(|i| sphere(6, 12).shaken(&mut random, if i % 3 == 0 { 0.3 } else { 0.0 }).at(0.7 * random.in_cube()))
        .collect();
    let hollow: Vec<Shape> = (0..30)
        .map(|_| sphere(8, 16).scaled(0.5).at(random.in_cube().normalize()))
        .chain([sphere(8, 16).scaled(0.7), sphere(12, 24).inverted()])
        .collect();
    for shapes in [heap, sizes, folded, hollow] {
        let topologies: Vec<Topology> =
            shapes.iter().map(|s| Topology::new(s.positions.len(), &s.triangles).unwrap()).collect();
        let bodies: Vec<Body> =
            topologies.iter().zip(&shapes).map(|(t, s)| Body::new(t, &s.positions).unwrap()).collect();
        let unknown: Vec<Body> = bodies.iter().cloned().map(Body::with_unknown_inside).collect();
        let [quick, slow] = [&bodies, &unknown].map(|bodies| union(bodies, &Budget::default()).unwrap());
        assert!(quick.mesh() == slow.mesh());
        assert_eq!([quick.volume(), quick.area()].map(f64::to_bits), [slow.volume(), slow.area()].map(f64::to_bits));
        assert_eq!(quick.component_count(), slow.mesh().components().len());
        assert!(quick.statistics.tests < slow.statistics.tests, "{:?} {:?}", quick.statistics, slow.statistics);
    }
}

#[test]
fn rigid_motions_move_the_union() {
    let mut random = Random::new(4);
    let shapes: Vec<Shape> = (0..4).map(|_| sphere(12, 24).at(2.0 * random.in_cube())).collect();
    let reference = unite(&shapes);
    for _ in 0..4 {
        let (turn, offset) = (random.rotation(), 5.0 * random.in_cube());
        let moved: Vec<Shape> = shapes.iter().map(|s| s.clone().turned(turn).at(offset)).collect();
        let union = unite(&moved);
        assert_eq!(union.eulers(), reference.eulers());
        assert_eq!(union.mesh.positions.len(), reference.mesh.positions.len());
        assert!((union.volume - reference.volume).abs() < 1e-11 * reference.volume);
        assert!((union.area - reference.area).abs() < 1e-9 * reference.area, "{} {}", union.area, reference.area);
    }
}

#[test]
fn the_cost_follows_the_overlap() {
    // a third sphere that barely overlaps the others, coarse or with nine times the vertices
    let work = |stacks: u32| {
        let far: Vec<Shape> = vec![
            sphere(12, 24),
            sphere(12, 24).at(DVec3::new(1.9, 0.1, 0.1)),
            sphere(stacks, 2 * stacks).at(-DVec3::X * 1.99),
        ];
        unite(&far).statistics.work
    };
    assert!(work(60) < 2 * work(20), "{} {}", work(20), work(60));
}

#[test]
fn vertices_lie_on_their_origins() {
    for shapes in some_scenes() {
        let union = unite(&shapes);
        let corner = |[body, triangle]: [u32; 2], k: usize| {
            let shape = &shapes[body as usize];
            shape.positions[shape.triangles[triangle as usize][k] as usize]
        };
        let off_plane = |p: DVec3, of: [u32; 2]| {
            let [a, b, c] = [0, 1, 2].map(|k| corner(of, k));
            let normal = (b - a).cross(c - a);
            normal.dot(p - a).abs() / (normal.length() * (b - a).length().max((c - a).length()))
        };
        for (position, origin) in union.mesh.positions.iter().zip(&union.mesh.origins) {
            match *origin {
                Origin::Vertex { body, vertex } => {
                    assert_eq!(*position, shapes[body as usize].positions[vertex as usize])
                }
                Origin::Edge { body, edge: [from, to], at, through, triangle } => {
                    let [a, b] = [from, to].map(|v| shapes[body as usize].positions[v as usize]);
                    assert_eq!(*position, a + (b - a) * at);
                    assert!(off_plane(*position, [through, triangle]) < 1e-7);
                }
                // planes at small angles have an ill-conditioned intersection, but the point is on all of them
                Origin::Triangles(all) => assert!(all.iter().all(|of| off_plane(*position, *of) < 1e-6)),
                Origin::Within { body, triangle } => assert!(off_plane(*position, [body, triangle]) < 1e-6),
            }
        }
        for (corners, source) in union.mesh.triangles.iter().zip(&union.sources) {
            for v in corners {
                assert!(off_plane(union.mesh.positions[*v as usize], *source) < 1e-6);
            }
        }
    }
}
