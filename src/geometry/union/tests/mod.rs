//! Tests of the union as a whole.

mod closed_forms;
mod folds;
mod random;
mod shapes;
mod ties;

use std::collections::HashMap;

use glam::DVec3;

use super::*;
use crate::disjoint_sets::DisjointSets;
use shapes::Shape;

/// The union of the shapes, as a mesh that has been checked.
fn unite(shapes: &[Shape]) -> Checked {
    try_unite(shapes, &Budget::default()).unwrap()
}

fn try_unite(shapes: &[Shape], budget: &Budget) -> Result<Checked, UnionError> {
    let topologies: Vec<Topology> =
        shapes.iter().map(|s| Topology::new(s.positions.len(), &s.triangles).unwrap()).collect();
    let bodies: Vec<Body> = topologies.iter().zip(shapes).map(|(t, s)| Body::new(t, &s.positions).unwrap()).collect();
    let union = union(&bodies, budget)?;
    let mesh = union.mesh();
    assert_closed(&mesh);

    // vertices keep their positions to the bit
    for (position, origin) in mesh.positions.iter().zip(&mesh.origins) {
        if let Origin::Vertex { body, vertex } = *origin {
            let given = shapes[body as usize].positions[vertex as usize];
            assert_eq!(position.to_array().map(f64::to_bits), given.to_array().map(f64::to_bits));
        }
    }
    // values computed from the difference match those of the mesh
    let components = mesh.components();
    let size = bodies.iter().map(|b| b.area()).sum::<f64>();
    let extent =
        bodies.iter().map(|b| b.bounds().max.abs().max(b.bounds().min.abs()).max_element()).fold(0.0, f64::max);
    let sum = |of: &dyn Fn(&Component) -> f64| components.iter().map(of).sum::<f64>();
    assert_eq!(components.iter().map(|c| c.euler).sum::<i64>(), union.euler());
    assert_eq!(components.len(), union.component_count());
    assert!(
        (sum(&|c| c.volume) - union.volume()).abs() <= 1e-11 * size * extent,
        "{} {}",
        sum(&|c| c.volume),
        union.volume()
    );
    assert!((sum(&|c| c.area) - union.area()).abs() <= 1e-10 * size);
    let kept = (0..).zip(&union.removed).flat_map(|(b, removed)| {
        let all = 0..shapes[b as usize].triangles.len() as u32;
        all.filter(|t| !removed.contains(t)).map(move |t| [b, t])
    });
    let sources = kept.chain(union.new_triangles.iter().map(|triangle| triangle.part_of)).collect();
    let (volume, area, seams, statistics) = (union.volume(), union.area(), union.seams.clone(), union.statistics);
    Ok(Checked { mesh, sources, components, volume, area, seams, statistics })
}

/// A union that is closed, manifold and oriented.
struct Checked {
    mesh: UnionMesh,
    /// The body and triangle that each triangle of the mesh equals or is part of.
    sources: Vec<[u32; 2]>,
    components: Vec<Component>,
    volume: f64,
    area: f64,
    seams: Vec<Seam>,
    statistics: Statistics,
}

impl Checked {
    fn eulers(&self) -> Vec<i64> {
        let mut eulers: Vec<i64> = self.components.iter().map(|c| c.euler).collect();
        eulers.sort_unstable();
        eulers
    }
}

/// A connected part of the surface of a union.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Component {
    /// Euler characteristic: vertices − edges + triangles = 2 − 2 × the number of handles.
    euler: i64,
    /// Enclosed volume [scene unit³]; < 0 for the surface of a void, which is subtracted from the component around it.
    volume: f64,
    /// Area [scene unit²].
    area: f64,
}

impl UnionMesh {
    /// The connected components of the surface, by their first vertex, in time proportional to the whole mesh.
    fn components(&self) -> Vec<Component> {
        let mut sets = DisjointSets::singletons(self.positions.len());
        for &[a, b, c] in &self.triangles {
            sets.join(a, b);
            sets.join(b, c);
        }
        let mut components: Vec<(Component, i64)> = Vec::new();
        let mut number: HashMap<u32, usize> = HashMap::new();
        for v in 0..self.positions.len() as u32 {
            let k = *number.entry(sets.least(v)).or_insert_with(|| {
                components.push((Component { euler: 0, volume: 0.0, area: 0.0 }, 0));
                components.len() - 1
            });
            components[k].0.euler += 1;
        }
        let origin = self.positions.first().copied().unwrap_or_default();
        for corners in &self.triangles {
            let (component, triangles) = &mut components[number[&sets.least(corners[0])]];
            let [x, y, z] = corners.map(|v| self.positions[v as usize] - origin);
            component.volume += x.dot(y.cross(z)) / 6.0;
            component.area += (y - x).cross(z - x).length() / 2.0;
            *triangles += 1;
        }
        components.into_iter().map(|(c, triangles)| Component { euler: c.euler - triangles / 2, ..c }).collect()
    }
}

/// Measures two bodies by their union.
fn pair_measures(a: &Body, b: &Body) -> PairMeasures {
    let (bodies, budget) = ([a.clone(), b.clone()], Budget::default());
    measures_of(&union(&bodies, &budget).unwrap(), [0, 1], &budget, &mut Hint::default()).unwrap()
}

/// Asserts that every edge has one triangle on either side and every vertex one fan.
fn assert_closed(mesh: &UnionMesh) {
    let mut next: HashMap<(u32, u32), u32> = HashMap::new();
    let mut count = vec![0; mesh.positions.len()];
    for corners in &mesh.triangles {
        for k in 0..3 {
            let (a, b, c) = (corners[k], corners[(k + 1) % 3], corners[(k + 2) % 3]);
            assert_ne!(a, b);
            assert_eq!(next.insert((a, b), c), None, "two triangles run along the edge {a} {b}");
            count[a as usize] += 1;
        }
    }
    let mut seen = vec![false; mesh.positions.len()];
    for corners in &mesh.triangles {
        for k in 0..3 {
            let (v, start) = (corners[k], corners[(k + 1) % 3]);
            assert!(next.contains_key(&(start, v)), "the edge {v} {start} is open");
            if std::mem::replace(&mut seen[v as usize], true) {
                continue;
            }
            let (mut at, mut around) = (start, 0);
            loop {
                at = next[&(v, at)];
                around += 1;
                assert!(around <= count[v as usize]);
                if at == start {
                    break;
                }
            }
            assert_eq!(around, count[v as usize], "several fans at vertex {v}");
        }
    }
    assert!(seen.iter().all(|s| *s), "a vertex of no triangle");
    assert!(mesh.positions.iter().all(|p| p.is_finite()));
}

/// The generalized winding number of a mesh about a point: solid angle over 4π (Jacobson et al. 2013; Van Oosterom and
/// Strackee 1983).
fn winding_number(positions: &[DVec3], triangles: &[[u32; 3]], point: DVec3) -> f64 {
    let angle = |corners: &[u32; 3]| {
        let [a, b, c] = corners.map(|v| positions[v as usize] - point);
        let (la, lb, lc) = (a.length(), b.length(), c.length());
        2.0 * a.dot(b.cross(c)).atan2(la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb)
    };
    triangles.iter().map(angle).sum::<f64>() / (4.0 * std::f64::consts::PI)
}

/// Asserts that the winding number of the union matches those of the bodies, at points near and far.
fn compare_inside(shapes: &[Shape], union: &Checked, seed: u64, samples: usize) {
    let mut random = shapes::Random::new(seed);
    let bounds = Aabb::of(shapes.iter().flat_map(|s| s.positions.iter().copied()));
    for _ in 0..samples {
        let mut at = bounds.min + (bounds.max - bounds.min) * (DVec3::splat(0.5) + 0.6 * random.in_cube());
        let all: Vec<DVec3> = shapes.iter().flat_map(|s| s.positions.iter().copied()).collect();
        if random.next() < 0.5 {
            let [a, b] = [0; 2].map(|_| all[(random.next() * all.len() as f64) as usize]);
            // beside the line between them, which may lie in a surface
            at = a + (b - a) * random.next() * 0.3 + 1e-3 * a.distance(b) * random.in_cube();
        }
        let windings: Vec<f64> = shapes.iter().map(|s| winding_number(&s.positions, &s.triangles, at)).collect();
        // on a surface, the winding number is undefined
        if windings.iter().any(|w| (w - w.round()).abs() > 1e-6) {
            continue;
        }
        let expected = windings.iter().any(|w| w.round() >= 1.0);
        let found = winding_number(&union.mesh.positions, &union.mesh.triangles, at);
        if (found - found.round()).abs() > 1e-6 {
            continue;
        }
        assert_eq!(found.round() as i64, i64::from(expected), "at {at}, windings {windings:?}");
    }
}

/// The measures of two bodies take the volume of each counted once. That of a body whose surface is not seen from its
/// centre is its own volume if the union of the two has found that it does not intersect itself.
#[test]
fn the_volume_of_a_body_counts_once() {
    let dented = |by: f64| {
        let mut shape = shapes::sphere(12, 24);
        for at in shape.positions.iter_mut().filter(|at| at.x > 0.0 && at.y * at.y + at.z * at.z < 0.3) {
            at.x -= by;
        }
        shape
    };
    // a dent, one that comes out at the back, and one body inside out
    for (first, is_simple) in [(dented(1.0), true), (dented(2.0), false), (dented(1.0).inverted(), false)] {
        let shapes = [first, shapes::sphere(12, 24).at(DVec3::new(1.2, 0.1, 0.05))];
        let topologies = [0, 1].map(|k| Topology::new(shapes[k].positions.len(), &shapes[k].triangles).unwrap());
        let bodies = [0, 1].map(|k| Body::new(&topologies[k], &shapes[k].positions).unwrap());
        let alone = [0, 1].map(|k| union(&bodies[k..=k], &Budget::default()).unwrap().volume());
        let united = union(&bodies, &Budget::default()).unwrap();
        assert!(bodies[0].slack() <= 0.0 && bodies[1].slack() > 0.0);
        assert_eq!((united.is_simple(0), united.is_simple(1)), (is_simple, true));
        assert_eq!(bodies[0].volume() == alone[0], is_simple);
        let measures = measures_of(&united, [0, 1], &Budget::default(), &mut Hint::default()).unwrap();
        assert_eq!(measures.overlap, (alone[0] + alone[1] - united.volume()).max(0.0));
    }
}
