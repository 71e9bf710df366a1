use glam::{DMat3, DVec3};

use super::*;
use crate::{
    geometry::{Sphere, shape::Solid as _},
    models::cells::{Cells, corner},
};

const STEEL: Elasticity = Elasticity { young: 3.0, poisson: 0.3 };

impl Stepper {
    /// Solves for the equilibrium (2.1) with the factor of K: replaces forces by displacements.
    pub fn equilibrium(&self, forces: &mut [DVec3]) {
        self.factor.solve(forces);
    }
}

/// A block of cells of density 1 without damping, held where `held` holds.
fn block(across: u32, cells: [u32; 3], elasticity: Elasticity, held: impl Fn(DVec3) -> bool) -> (Cells, Element) {
    let cells = Cells::block(across, cells);
    let held: Vec<bool> = cells.nodes.iter().map(|&node| held(node)).collect();
    let mass = cells.cell_count() as f64 * cells.size().powi(3);
    let element = Element::new(&cells, 1.0, mass, &held, |_| (elasticity, 0.0), None).unwrap();
    (cells, element)
}

fn dense(element: &Element) -> Vec<Vec<f64>> {
    let n = element.free.len();
    let columns = (0..3 * n).map(|i| {
        let mut x = vec![DVec3::ZERO; n];
        x[i / 3][i % 3] = 1.0;
        let mut y = vec![DVec3::ZERO; n];
        element.forces(&x, &mut y);
        y.iter().flat_map(|y| y.to_array()).collect()
    });
    columns.collect()
}

#[test]
fn tetrahedra_fill_the_cube_with_equal_orientation() {
    let volume = |[a, b, c, d]: [usize; 4]| {
        let [a, b, c, d] = [a, b, c, d].map(corner);
        (b - a).cross(c - a).dot(d - a)
    };
    assert!(TETRAHEDRA.iter().all(|&tetrahedron| (volume(tetrahedron) - 1.0).abs() < 1e-15));
    for tetrahedron in TETRAHEDRA {
        for (i, gradient) in gradients(tetrahedron).into_iter().enumerate() {
            for (j, other) in tetrahedron.into_iter().enumerate() {
                let [at, first] = [other, tetrahedron[0]].map(corner);
                let value = gradient.dot(at - first) + f64::from(u8::from(i == 0));
                assert!((value - f64::from(u8::from(i == j))).abs() < 1e-15);
            }
        }
    }
}

/// K is symmetric and has no negative eigenvalue, and its null space consists exactly of the six rigid motions.
#[test]
fn the_null_space_of_the_stiffness_is_the_rigid_motions() {
    let (cells, element) = block(4, [2, 2, 1], STEEL, |_| false);
    let mut rows = dense(&element);
    let n = rows.len();
    for i in 0..n {
        for j in 0..n {
            assert!((rows[i][j] - rows[j][i]).abs() < 1e-15);
        }
    }
    let place = |i: usize| cells.nodes[element.free[i] as usize];
    for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
        let motions: [&dyn Fn(DVec3) -> DVec3; 2] = [&|_| axis, &|place| axis.cross(place)];
        for motion in motions {
            let x: Vec<DVec3> = (0..n / 3).map(|i| motion(place(i))).collect();
            let mut forces = vec![DVec3::ZERO; n / 3];
            element.forces(&x, &mut forces);
            assert!(forces.iter().all(|force| force.length() < 1e-14));
        }
    }
    // rank by elimination with pivoting on the diagonal, which suffices for a semidefinite matrix
    let mut rank = 0;
    loop {
        let best = (0..n).max_by(|&i, &j| rows[i][i].total_cmp(&rows[j][j])).unwrap();
        let pivot = rows[best][best];
        if pivot < 1e-10 {
            break;
        }
        rank += 1;
        let row = rows[best].clone();
        for i in 0..n {
            let factor = rows[i][best] / pivot;
            for j in 0..n {
                rows[i][j] -= factor * row[j];
            }
        }
        for i in 0..n {
            (rows[best][i], rows[i][best]) = (0.0, 0.0);
        }
    }
    assert!((0..n).all(|i| rows[i][i] > -1e-12), "not semidefinite");
    assert_eq!(rank, n - 6);
}

/// Patch test: interior nodes follow an affine displacement of the boundary nodes exactly, and stress is uniform.
#[test]
fn the_patch_test_is_passed() {
    let cells = Cells::block(8, [3, 4, 3]);
    let size = cells.size();
    let top = DVec3::new(3.0, 4.0, 3.0) * size - 1.0;
    let inside = |node: DVec3| node.cmpgt(DVec3::NEG_ONE + 1e-9).all() && node.cmplt(top - 1e-9).all();
    let held = vec![false; cells.node_count()];
    let all = Element::new(&cells, 1.0, 1.0, &held, |_| (STEEL, 0.0), None).unwrap();
    let held: Vec<bool> = cells.nodes.iter().map(|&node| !inside(node)).collect();
    let element = Element::new(&cells, 1.0, 1.0, &held, |_| (STEEL, 0.0), None).unwrap();
    let gradient = DMat3::from_cols(DVec3::new(0.3, -0.2, 0.7), DVec3::new(0.1, 0.4, -0.6), DVec3::new(0.2, 0.5, -0.1));
    let affine = |node: DVec3| gradient * node + DVec3::new(0.1, 0.2, 0.3);
    // forces on the interior nodes due to displacements of the boundary
    let mut number = vec![usize::MAX; cells.node_count()];
    all.free.iter().enumerate().for_each(|(i, &node)| number[node as usize] = i);
    let boundary: Vec<DVec3> = all
        .free
        .iter()
        .map(|&node| if held[node as usize] { affine(cells.nodes[node as usize]) } else { DVec3::ZERO })
        .collect();
    let mut forces = vec![DVec3::ZERO; boundary.len()];
    all.forces(&boundary, &mut forces);
    let mut x: Vec<DVec3> = element.free.iter().map(|&node| -forces[number[node as usize]]).collect();
    element.factor(f64::INFINITY, u64::MAX, None).unwrap().equilibrium(&mut x);
    let mut displacements: Vec<DVec3> = cells.nodes.iter().map(|&node| affine(node)).collect();
    for (found, &node) in x.iter().zip(&element.free) {
        assert!(found.distance(displacements[node as usize]) < 1e-12, "{found}");
        displacements[node as usize] = *found;
    }
    let expected = largest_eigenvalue(STEEL.stress(gradient));
    all.tensions(&displacements, |_, stress| assert!((stress - expected).abs() < 1e-11));
}

#[test]
fn the_largest_eigenvalue_of_a_rotated_diagonal_is_found() {
    for values in [DVec3::new(3.0, -1.0, 0.5), DVec3::new(2.0, 2.0, -4.0), DVec3::splat(-1.5), DVec3::ZERO] {
        let turn = DMat3::from_quat(glam::DQuat::from_euler(glam::EulerRot::XYZ, 0.3, 1.2, -0.7));
        let matrix = turn * DMat3::from_diagonal(values) * turn.transpose();
        assert!((largest_eigenvalue(matrix) - values.max_element()).abs() < 1e-7, "{values}");
    }
}

/// A cantilever with a transverse end load deflects by FL³/3EI + FL/κGA (Timoshenko, κ = 10(1 + ν)/(12 + 11ν)). Linear
/// tetrahedra are too stiff; the error decreases with the square of their size.
#[test]
fn a_cantilever_converges_to_beam_theory() {
    let elasticity = Elasticity { young: 1.0, poisson: 0.0 };
    let error = |across: u32| {
        // 1/2 × 1/2 × 2, along x; without Poisson's ratio, holding the end does not hinder it
        let side = across / 4;
        let (cells, element) = block(across, [across, side, side], elasticity, |node| node.x == -1.0);
        let is_end = |node: &u32| cells.nodes[*node as usize].x > 1.0 - 1e-9;
        // shear distributed over the section by faces: a constant distribution is enough for the end deflection
        let mut forces: Vec<DVec3> = element.free.iter().map(|_| DVec3::ZERO).collect();
        let (mut area, mut ends) = (0.0, Vec::new());
        for (i, node) in element.free.iter().enumerate().filter(|(_, node)| is_end(node)) {
            let place = cells.nodes[*node as usize];
            let low = |x: f64| if (-1.0 + 1e-9..=-0.5 - 1e-9).contains(&x) { 1.0 } else { 0.5 };
            let share = low(place.y) * low(place.z);
            forces[i] = DVec3::Z * share;
            area += share;
            ends.push((i, share));
        }
        forces.iter_mut().for_each(|force| *force *= 1e-3 / area);
        element.factor(f64::INFINITY, u64::MAX, None).unwrap().equilibrium(&mut forces);
        let deflection: f64 = ends.iter().map(|&(i, share)| forces[i].z * share).sum::<f64>() / area;
        let (length, depth): (f64, f64) = (2.0, 0.5);
        let bending = 1e-3 * length.powi(3) / (3.0 * depth.powi(4) / 12.0);
        let shear = 1e-3 * length / (10.0 / 12.0 * 0.5 * depth * depth);
        1.0 - deflection / (bending + shear)
    };
    let [coarse, middle, fine] = [8, 16, 32].map(error);
    assert!(coarse > 0.0 && coarse / middle > 2.2 && middle / fine > 2.8, "{coarse} {middle} {fine}");
    assert!(fine < 0.06, "{fine}");
}

/// The factor inverts the multiplication by the matrix, for a sphere with a held core.
#[test]
fn the_factor_solves_the_system() {
    let cells = Cells::cover(&Sphere { stacks: 12, slices: 24 }.mesh(), 6, None).unwrap();
    let element = Element::new(&cells, 1.0, 1.0, &cells.core(0.5), |_| (STEEL, 0.01), None).unwrap();
    let n = element.free.len();
    let expected: Vec<DVec3> = (0..n).map(|i| DVec3::new((i % 7) as f64, (i % 5) as f64, -((i % 3) as f64))).collect();
    let mut x = vec![DVec3::ZERO; n];
    element.forces(&expected, &mut x);
    let stepper = element.factor(f64::INFINITY, u64::MAX, None).unwrap();
    stepper.equilibrium(&mut x);
    assert!(x.iter().zip(&expected).all(|(x, y)| x.distance(*y) < 1e-10));
    // the order of elimination pays off: in node order, the factor would be banded
    let blocks = stepper.factor.blocks.len();
    assert!(blocks < n * n / 8, "{blocks} blocks for {n} nodes");
    assert!(matches!(element.factor(1.0, 1000, None), Err(Unfactored::TooLarge { .. })));
    let free = Element::new(&cells, 1.0, 1.0, &vec![false; cells.node_count()], |_| (STEEL, 0.0), None).unwrap();
    let flag = AtomicBool::new(true);
    assert!(matches!(free.factor(1.0, u64::MAX, Some(&flag)), Err(Unfactored::Interrupted)));
}

/// Without damping, the midpoint rule conserves energy for any step; with damping, energy decreases. Any step is
/// stable, and a constant load leads to the equilibrium (2.1).
#[test]
fn steps_conserve_energy_and_reach_equilibrium() {
    let cells = Cells::block(6, [2, 2, 4]);
    let held: Vec<bool> = cells.nodes.iter().map(|node| node.z == -1.0).collect();
    for (damping, h) in [(0.0, 0.01), (0.0, 10.0), (0.3, 0.1), (0.3, 100.0)] {
        let element = Element::new(&cells, 1.0, 1.0, &held, |_| (STEEL, damping), None).unwrap();
        let stepper = element.factor(h, u64::MAX, None).unwrap();
        let mut motion = Motion::at_rest(&element);
        let count = motion.velocities.len();
        for (i, velocity) in motion.velocities.iter_mut().enumerate() {
            *velocity = DVec3::new((i % 3) as f64 - 1.0, (i % 4) as f64, (i % 5) as f64 - 2.0);
        }
        let energy = |motion: &Motion| {
            let kinetic = element.free.iter().zip(&motion.velocities);
            let kinetic: f64 = kinetic.map(|(&node, u)| 0.5 * element.masses[node as usize] * u.length_squared()).sum();
            kinetic + element.energy(&motion.displacements)
        };
        let mut last = energy(&motion);
        for _ in 0..100 {
            stepper.step(&element, &mut motion, &mut vec![DVec3::ZERO; count]);
            let now = energy(&motion);
            assert!(now <= last * (1.0 + 1e-10) && (damping > 0.0 || now > last * (1.0 - 1e-10)), "{h}: {last} {now}");
            last = now;
        }
        if damping > 0.0 && h < 1.0 {
            let load = |i: usize| DVec3::new(0.0, 1e-3, 2e-3 * (i % 2) as f64);
            for _ in 0..8000 {
                let mut forces: Vec<DVec3> = (0..count).map(load).collect();
                stepper.step(&element, &mut motion, &mut forces);
            }
            let mut expected: Vec<DVec3> = (0..count).map(load).collect();
            element.factor(f64::INFINITY, u64::MAX, None).unwrap().equilibrium(&mut expected);
            assert!(motion.displacements.iter().zip(&expected).all(|(x, y)| x.distance(*y) < 1e-9));
        }
    }
}
