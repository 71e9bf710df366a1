use std::collections::HashMap;

use super::*;
use crate::geometry::{Sphere, Vectors, shape::Solid as _};

fn sphere(across: u32) -> Cells {
    Cells::cover(&Sphere { stacks: 12, slices: 24 }.mesh(), across, None).unwrap()
}

/// A box, with two triangles per side.
fn cuboid(low: DVec3, high: DVec3) -> (Vectors, Vec<[u32; 3]>) {
    let surface = boundary(&[[0, 1, 2, 3, 4, 5, 6, 7]; 1], &[[0, 1, 2, 3, 4, 5, 6, 7]; 1], |_| true);
    let corners = surface.vertices.iter().map(|&(node, _)| low + corner(node as usize) * (high - low)).collect();
    (corners, surface.triangles)
}

impl BoundaryMesh {
    /// The enclosed volume with the vertices at the given positions.
    pub fn volume(&self, place: impl Fn(usize) -> DVec3) -> f64 {
        let of = |corners: &[u32; 3]| {
            let [a, b, c] = corners.map(|i| place(i as usize));
            a.cross(b).dot(c) / 6.0
        };
        self.triangles.iter().map(of).sum()
    }
}

#[test]
fn cells_cover_a_sphere() {
    let mesh = Sphere { stacks: 12, slices: 24 }.mesh();
    for across in [1, 2, 3, 6, 7, 16] {
        let cells = sphere(across);
        // everything within the polyhedron is covered, and nothing far from it
        let h = cells.size();
        for (k, place) in cells.places.iter().enumerate() {
            let low = DVec3::from_array(place.map(f64::from)) * h - 1.0;
            let nearest = DVec3::ZERO.clamp(low, low + h).length();
            assert!(nearest <= 1.0, "{across}: cell {k} is off the sphere");
        }
        let volume = cells.cell_count() as f64 * h.powi(3);
        assert!(volume > 0.95 * 4.18879 && volume < 4.18879 * (1.0 + 1.5 * h).powi(3), "{across}: {volume}");
        for (embedded, position) in cells.embedded.iter().zip(mesh.positions().iter()) {
            let found = embedded.mean(&cells.corners[embedded.cell as usize], &cells.nodes);
            assert!(found.distance(position) < 1e-14, "{across}: {found} {position}");
            assert!((embedded.weights.iter().sum::<f64>() - 1.0).abs() < 1e-14);
            assert!(embedded.weights.iter().all(|weight| (-1e-8..1.0 + 1e-8).contains(weight)));
        }
        assert!((cells.shares().iter().sum::<f64>() - 1.0).abs() < 1e-13);
        assert_eq!(cells, sphere(across));
    }
    let cells = sphere(crate::scene::cells::ACROSS);
    assert!((250..350).contains(&cells.node_count()), "{} nodes", cells.node_count());
}

/// The volume of the cells converges to that of the body from above.
#[test]
fn the_covered_volume_converges() {
    let volume = |across| sphere(across).cell_count() as f64 * (2.0 / f64::from(across)).powi(3);
    let beyond: Vec<f64> = [8, 16, 32].map(|across| volume(across) - 4.09).into();
    assert!(beyond[0] > 1.7 * beyond[1] && beyond[1] > 1.7 * beyond[2] && beyond[2] > 0.0, "{beyond:?}");
}

/// Where the surface lies in faces of cells, the cells outside are not part of the body and those inside are.
#[test]
fn a_box_along_the_grid_is_covered_exactly() {
    let high = DVec3::new(2.0, 2.0, 1.0) / 3.0; // at distance 1
    let (corners, triangles) = cuboid(-high, high);
    let mesh = Mesh::round(corners, triangles);
    let cells = Cells::cover(&mesh, 6, None).unwrap();
    assert_eq!(cells.cell_count(), 4 * 4 * 2);
}

/// The mass centre of the nodes is that of the body, also where some cells of a linear density would weigh nothing.
#[test]
fn cells_of_lopsided_bodies_are_balanced() {
    let ring: String = (0..12)
        .map(|k| libm::sincos(f64::from(k) * std::f64::consts::TAU / 12.0))
        .map(|(sin, cos)| format!("v {cos} {sin} 0\n"))
        .collect();
    let sides: String = (0..12)
        .map(|k| format!("f {} {} 13\nf {} {} 14\n", k + 1, (k + 1) % 12 + 1, (k + 1) % 12 + 1, k + 1))
        .collect();
    for (name, apex) in
        [("cone", [0.0, 0.0, 1.5]), ("pointed", [0.0, 0.0, 2.0]), ("tall", [0.0, 0.0, 4.0]), ("wry", [0.9, 0.3, 2.0])]
    {
        let [x, y, z] = apex;
        let text = format!("{ring}v {x} {y} {z}\nv 0 0 0\n{sides}");
        let file = crate::geometry::files::from_content("m.obj", &text).unwrap().mesh;
        let mesh = file.mesh();
        for across in [4, 6, 7, 12] {
            let cells = Cells::cover(mesh, across, None).unwrap();
            let (off, mean) = (cells.mass_centre().length(), 1.0 / cells.cell_count() as f64);
            let [total, least] =
                [cells.weights.iter().sum(), cells.weights.iter().copied().fold(f64::INFINITY, f64::min)];
            assert!(
                (total - 1.0).abs() < 1e-12 && least >= 0.2 * mean * (1.0 - 1e-12),
                "{name}, {across}: {total} {least}"
            );
            assert!(off < 2e-12, "{name}, {across}: {off}");
        }
    }
}

/// A torus knot is covered without filling its hole: χ of the boundary is at most that of a torus.
#[test]
fn cells_keep_the_shape_of_a_mesh() {
    let scene = crate::Scene::builtin("mesh").unwrap();
    let knot = scene.bodies.iter().find(|body| body.name.contains("knot")).unwrap_or(&scene.bodies[0]);
    let cells = Cells::cover(&knot.shape.mesh(), 64, None).unwrap();
    let surface = boundary(&cells.corners, &cells.corners, |_| true);
    let mut edges = HashMap::new();
    for &[a, b, c] in &surface.triangles {
        [(a, b), (b, c), (c, a)].iter().for_each(|&edge| *edges.entry(edge).or_insert(0) += 1);
    }
    assert!(edges.iter().all(|(&(a, b), &count)| edges.get(&(b, a)) == Some(&count)), "not closed");
    let sides = surface.triangles.len() as i64 * 3 / 2;
    let chi = surface.vertices.len() as i64 - sides + surface.triangles.len() as i64;
    assert!(chi <= 0, "{chi}: the hole is filled");
    let h = cells.size();
    let volume = surface.volume(|i| cells.nodes[surface.vertices[i].0 as usize]);
    assert!((volume - cells.cell_count() as f64 * h.powi(3)).abs() < 1e-12);
}

/// Cells that touch at an edge or a corner do not share vertices there.
#[test]
fn the_boundary_is_manifold_where_cells_touch_at_an_edge() {
    let cells = Cells::block(8, [2, 2, 2]);
    for mask in 1u32..256 {
        let surface = boundary(&cells.corners, &cells.corners, |cell| mask >> cell & 1 == 1);
        let mut edges = std::collections::HashSet::new();
        for &[a, b, c] in &surface.triangles {
            assert!([(a, b), (b, c), (c, a)].iter().all(|&edge| edges.insert(edge)), "{mask:b}");
        }
        assert!(edges.iter().all(|&(a, b)| edges.contains(&(b, a))), "{mask:b}");
        let volume = surface.volume(|i| cells.nodes[surface.vertices[i].0 as usize]);
        assert!((volume - f64::from(mask.count_ones()) * cells.size().powi(3)).abs() < 1e-14);
    }
}

#[test]
fn every_part_of_a_body_is_held() {
    let cells = sphere(6);
    let held = cells.core(0.5);
    assert_eq!(held.iter().filter(|&&held| held).count(), 19);
    // two parts off the centre: each is held by its cell nearest to it
    let apart = Cells::of(8, vec![[0, 0, 0], [1, 0, 0], [6, 7, 7], [7, 7, 7]]);
    let held = apart.core(0.5);
    assert_eq!(held.iter().filter(|&&held| held).count(), 16);
    assert!(apart.corners[1].iter().chain(&apart.corners[2]).all(|&node| held[node as usize]));
}
