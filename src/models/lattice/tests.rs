use std::f64::consts::FRAC_PI_2;

use super::*;
use crate::{models::cells::boundary, scene::TearMode};

impl Motion {
    /// Σ m u [mass · scene unit/s].
    fn momentum(&self, masses: &[f64]) -> DVec3 {
        self.velocities.iter().zip(masses).map(|(u, m)| *u * *m).sum()
    }

    /// Σ ½ m u² [mass · scene unit²/s²].
    fn kinetic_energy(&self, masses: &[f64]) -> f64 {
        self.velocities.iter().zip(masses).map(|(u, m)| 0.5 * m * u.length_squared()).sum()
    }
}

/// No external accelerations.
fn nothing(_: f64, _: &[DVec3], accelerations: &mut [DVec3]) {
    accelerations.fill(DVec3::ZERO);
}

/// A bar of `cells` along z in a grid of `across` along [−1, 1], of density 1, with ω = 1 for a bar of length 1, held
/// at its lowest nodes or free.
fn bar(across: u32, cells: [u32; 3], damping: f64, is_held: bool) -> Lattice {
    let cells = Cells::block(across, cells);
    let held = cells.nodes.iter().map(|node| is_held && node.z == -1.0).collect();
    let mass = cells.cell_count() as f64 * cells.size().powi(3);
    Lattice::new(&cells, 1.0, mass, held, |density| Constants::of(1.0, damping, 1.0, density), None).unwrap()
}

/// Pseudo-random numbers in [−1, 1], the same in every run.
fn noise(seed: u64) -> impl FnMut() -> f64 {
    let mut state = seed;
    move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as f64 / f64::from(1u32 << 30) - 1.0
    }
}

fn shaken(lattice: &Lattice, by: f64) -> Motion {
    let (mut motion, mut next) = (Motion::at_rest(lattice), noise(7));
    for (position, velocity) in motion.positions.iter_mut().zip(&mut motion.velocities) {
        *position += DVec3::new(next(), next(), next()) * by;
        *velocity += DVec3::new(next(), next(), next()) * by;
    }
    motion
}

#[test]
fn a_cell_has_28_springs_and_shares_those_on_its_faces() {
    assert_eq!(bar(4, [1, 1, 1], 0.0, false).spring_count(), 28);
    assert_eq!(bar(4, [1, 1, 2], 0.0, false).spring_count(), 2 * 28 - 6);
    let lattice = bar(4, [3, 3, 3], 0.0, false);
    let of = |length: f64| {
        let like = |spring: &Spring| (spring.rest / lattice.size - length).abs() < 1e-9;
        lattice.springs().filter(like).map(|spring| spring.stiffness).fold(0.0, f64::max) / lattice.stiffness
    };
    let [edge, face, space] = [1.0, 2f64.sqrt(), 3f64.sqrt()].map(of);
    assert!((edge - 2.0).abs() < 1e-14 && (face - 1.0).abs() < 1e-14 && (space - 0.375).abs() < 1e-14);
    assert!(shaken(&lattice, 0.0).positions == lattice.rest);
    let (still, mut forces) = (vec![DVec3::ZERO; lattice.node_count()], Vec::new());
    lanes::Lanes::default().pull(&lattice.groups, lattice.damping, &lattice.rest, &still, &mut forces);
    assert_eq!(forces, still, "a lattice at rest is exactly at rest");
}

/// SIMD evaluation gives the same forces as scalar evaluation, also where nodes were split.
#[test]
fn simd_springs_equal_scalar_springs() {
    let mut lattice = bar(8, [3, 4, 5], 0.4, false);
    for _ in 0..2 {
        let motion = shaken(&lattice, 0.1);
        let (mut forces, mut drags, mut sums) = (Vec::new(), Vec::new(), Vec::new());
        lattice.forces(&motion.positions, &motion.velocities, &mut forces, &mut drags);
        let (positions, velocities) = (&motion.positions, &motion.velocities);
        let largest = lanes::Lanes::default().pull(&lattice.groups, lattice.damping, positions, velocities, &mut sums);
        for ((sum, force), drag) in sums.iter().zip(&forces).zip(&drags) {
            assert!(sum.distance(*force + *drag) < 1e-13, "{sum} {force} {drag}");
        }
        let strain = |spring: Spring| positions[spring.a as usize].distance(positions[spring.b as usize]) / spring.rest;
        assert!((lattice.springs().map(strain).fold(0.0, f64::max) - largest).abs() < 1e-14);
        assert_eq!(lattice.springs().count(), lattice.spring_count());
        let before = lattice.spring_count();
        assert!(!lattice.split(&motion.positions, 0.05).is_empty() && lattice.spring_count() > before);
    }
}

/// Any affine strain has the energy of the isotropic solid with λ = μ, E = 5μ/2, whatever its direction.
#[test]
fn a_lattice_is_an_isotropic_solid() {
    let lattice = bar(8, [2, 3, 4], 0.0, false);
    let (mut next, volume) = (noise(3), 24.0 * lattice.size.powi(3));
    for _ in 0..20 {
        let a = [(); 6].map(|()| 1e-6 * next());
        let strain = glam::DMat3::from_cols(
            DVec3::new(a[0], a[3], a[4]),
            DVec3::new(a[3], a[1], a[5]),
            DVec3::new(a[4], a[5], a[2]),
        );
        let positions: Vec<_> = lattice.rest.iter().map(|&l| l + strain * l).collect();
        let mu = 0.4 * lattice.young();
        let trace = a[0] + a[1] + a[2];
        let square: f64 = (0..3).map(|i| strain.col(i).length_squared()).sum();
        let expected = volume * (0.5 * mu * trace * trace + mu * square);
        let found = lattice.energy(&positions);
        assert!((found / expected - 1.0).abs() < 1e-5, "{found} {expected}");
    }
}

/// Springs and dampers conserve momentum; without dampers, energy is conserved to the order of the scheme.
#[test]
fn momentum_and_energy_are_kept() {
    let free = bar(8, [2, 2, 3], 0.4, false);
    let mut motion = shaken(&free, 0.02);
    let turning = |motion: &Motion| -> DVec3 {
        let of = motion.positions.iter().zip(&motion.velocities).zip(&free.masses);
        of.map(|((r, u), m)| r.cross(*u) * *m).sum()
    };
    let (momentum, moment) = (motion.momentum(&free.masses), turning(&motion));
    free.advance(&mut motion, Scheme::Verlet, 0.2 * free.step_limit(0.0), 500, &mut nothing);
    assert!(motion.momentum(&free.masses).distance(momentum) < 1e-15);
    assert!(turning(&motion).distance(moment) < 1e-6, "dampers act along springs, but at a predicted velocity");

    let free = bar(8, [2, 2, 3], 0.0, false);
    let drift = |per_limit: f64, count: u64| {
        let mut motion = shaken(&free, 0.02);
        let energy = |motion: &Motion| free.energy(&motion.positions) + motion.kinetic_energy(&free.masses);
        let first = energy(&motion);
        let mut worst: f64 = 0.0;
        for _ in 0..count {
            free.advance(&mut motion, Scheme::Verlet, per_limit * free.step_limit(0.0), 1, &mut nothing);
            worst = worst.max((energy(&motion) / first - 1.0).abs());
        }
        worst
    };
    let [coarse, fine] = [drift(0.2, 400), drift(0.1, 800)];
    assert!(coarse < 0.02 && (3.0..5.5).contains(&(coarse / fine)), "{coarse} {fine}: second order");
}

/// The limit is exact for a single free cell, with and without dampers.
#[test]
fn steps_are_stable_up_to_the_limit() {
    let grows = |lattice: &Lattice, per_limit: f64| {
        let mut motion = shaken(lattice, 1e-9);
        lattice.advance(&mut motion, Scheme::Verlet, per_limit * lattice.step_limit(0.0), 3000, &mut nothing);
        let mean = motion.momentum(&lattice.masses) / lattice.masses.iter().sum::<f64>();
        !motion.velocities.iter().all(|u| u.distance(mean) < 1e-7)
    };
    for damping in [0.0, 0.01, 0.1, 0.5, 5.0] {
        let cell = bar(4, [1, 1, 1], damping, false);
        assert!(!grows(&cell, 0.99) && grows(&cell, 1.01), "κ = {damping}");
        let lattice = bar(12, [3, 4, 5], damping, true);
        assert!(!grows(&lattice, 0.99), "κ = {damping}");
    }
}

/// A bar held at one end oscillates lengthwise at ω = (π/2L) √(E/ρ). The error decreases with the size of the cells,
/// which is the thickness of the bar.
#[test]
fn a_bar_has_the_frequency_of_its_closed_form() {
    let error = |across: u32| {
        let lattice = bar(across, [1, 1, across / 2], 0.0, true); // of length 1
        let mut motion = Motion::at_rest(&lattice);
        let shape = |rest: &DVec3| (FRAC_PI_2 * (rest.z + 1.0)).sin();
        for (position, rest) in motion.positions.iter_mut().zip(&lattice.rest) {
            let z = rest.z + 1.0;
            let slope = 1e-6 * FRAC_PI_2 * (FRAC_PI_2 * z).cos();
            let middle = DVec3::new(-1.0 + 0.5 * lattice.size, -1.0 + 0.5 * lattice.size, 0.0);
            // with lateral contraction
            let side = if z > 0.0 { (*rest - middle) * DVec3::new(1.0, 1.0, 0.0) } else { DVec3::ZERO };
            *position += DVec3::Z * (1e-6 * shape(rest)) - 0.25 * slope * side;
        }
        let amplitude = |motion: &Motion| -> f64 {
            let of = motion.positions.iter().zip(&lattice.rest).zip(&lattice.masses);
            of.map(|((r, l), m)| m * (r.z - l.z) * shape(l)).sum()
        };
        // ω is 1, so crossings are half a period apart
        let h = 1e-3 * FRAC_PI_2;
        let (mut before, mut crossed) = (amplitude(&motion), Vec::new());
        let mut step = 0;
        while crossed.len() < 2 {
            lattice.advance(&mut motion, Scheme::Verlet, h, 1, &mut nothing);
            step += 1;
            let now = amplitude(&motion);
            if before * now < 0.0 {
                crossed.push(h * (f64::from(step) - now / (now - before)));
            }
            before = now;
        }
        std::f64::consts::PI / (crossed[1] - crossed[0]) - 1.0
    };
    let [coarse, middle, fine] = [8, 16, 32].map(error);
    assert!(coarse.abs() > 1.5 * middle.abs() && middle.abs() > 1.5 * fine.abs(), "{coarse:e} {middle:e} {fine:e}");
    assert!(fine.abs() < 5e-3, "{fine:e}");
}

/// A chain of cells hangs from its lowest nodes, with gravity along +z: each section carries exactly the weight beyond
/// it, and the chain is longer by ρgL²/2E, up to the effect of holding its end.
#[test]
fn a_hanging_chain_is_in_balance() {
    let weight = 1e-4;
    let lengthening = |across: u32| {
        let lattice = bar(across, [1, 1, across / 2], 1.2, true);
        let mut motion = Motion::at_rest(&lattice);
        let mut fall = |_: f64, _: &[DVec3], a: &mut [DVec3]| a.fill(DVec3::Z * weight);
        let h = 0.5 * lattice.step_limit(0.0);
        lattice.advance(&mut motion, Scheme::Verlet, h, (60.0 / h) as u64, &mut fall);
        let (mut forces, mut drags) = (Vec::new(), Vec::new());
        lattice.forces(&motion.positions, &motion.velocities, &mut forces, &mut drags);
        for section in 1..=across / 2 {
            let height = f64::from(section) * lattice.size - 1.0 - 0.5 * lattice.size;
            // the force of the springs across the section: the sum of the spring forces on all nodes beyond it
            let below = (0..lattice.node_count()).filter(|&i| lattice.rest[i].z > height);
            let (pull, mass) = below.fold((0.0, 0.0), |(f, m), i| (f + forces[i].z, m + lattice.masses[i]));
            assert!((pull / (mass * weight) + 1.0).abs() < 1e-6, "{section}: {pull} {mass}");
        }
        let end = (0..lattice.node_count()).filter(|&i| lattice.rest[i].z > -1e-9);
        let mean: f64 = end.map(|i| 0.25 * (motion.positions[i].z - lattice.rest[i].z)).sum();
        mean / (0.5 * weight / lattice.young()) - 1.0
    };
    let [coarse, fine] = [8, 16].map(lengthening);
    assert!(coarse.abs() < 0.1 && fine.abs() < 0.6 * coarse.abs(), "{coarse} {fine}");
}

/// Pulls a bar of `layers` cells of size 1/4 apart, from its middle.
fn pull(layers: u32) -> impl Fn(f64, &[DVec3], &mut [DVec3]) + Copy {
    let middle = 0.125 * f64::from(layers) - 1.0;
    move |_, positions, accelerations| {
        for (acceleration, position) in accelerations.iter_mut().zip(positions) {
            *acceleration = DVec3::Z * (3.0 * (position.z - middle));
        }
    }
}

/// Fig. 2.2: a bar pulled apart at its ends tears in the middle, where the tension is strongest.
fn pulled(tear: TearMode, layers: u32) -> (Lattice, Motion, usize) {
    let mut lattice = bar(8, [2, 2, layers], 0.3, false);
    let mut motion = Motion::at_rest(&lattice);
    let h = 0.4 * lattice.step_limit(0.0);
    for step in 0..2000 {
        lattice.advance(&mut motion, Scheme::Verlet, h, 1, &mut pull(layers));
        let torn = match tear {
            TearMode::None => 0,
            TearMode::Cut => {
                let cut = lattice.cut(&motion.positions, 0.3);
                motion.cut(&lattice);
                cut.len()
            }
            TearMode::Split => {
                let momentum = motion.momentum(&lattice.masses);
                let originals = lattice.split(&motion.positions, 0.3);
                motion.split(&lattice, &originals);
                assert!(motion.momentum(&lattice.masses).distance(momentum) < 1e-15);
                originals.len()
            }
        };
        if torn > 0 {
            return (lattice, motion, step);
        }
    }
    (lattice, motion, usize::MAX)
}

#[test]
fn both_tear_modes_part_a_bar_in_its_middle() {
    let (cut, _, _) = pulled(TearMode::Cut, 5);
    // of five layers of cells, the middle one is lost
    assert!((cut.lost() - 0.2).abs() < 1e-12, "{}", cut.lost());
    assert!((0..20).all(|cell| cut.is_whole[cell] != (8..12).contains(&cell)));
    // of four layers, the nodes between the middle two are split
    let (mut split, mut motion, _) = pulled(TearMode::Split, 4);
    assert_eq!(split.lost(), 0.0);
    assert!((split.masses.iter().sum::<f64>() - 16.0 * split.cell_masses[0]).abs() < 1e-15);
    assert!(split.masses.iter().all(|&mass| mass > 0.0));
    // it continues to tear until it is in two parts
    let parts = |lattice: &Lattice, layers: u32| {
        let first = bar(8, [2, 2, layers], 0.3, false).corners;
        let surface = boundary(&first, &lattice.corners, |cell| lattice.is_whole[cell]);
        let edges = surface.triangles.len() as i64 * 3 / 2;
        (surface.vertices.len() as i64 - edges + surface.triangles.len() as i64) / 2
    };
    let h = 0.4 * split.step_limit(0.0);
    for _ in 0..2000 {
        split.advance(&mut motion, Scheme::Verlet, h, 1, &mut pull(4));
        let originals = split.split(&motion.positions, 0.3);
        motion.split(&split, &originals);
        if parts(&split, 4) > 1 {
            break;
        }
    }
    assert_eq!((parts(&split, 4), parts(&cut, 5)), (2, 2));
    let (whole, _, never) = pulled(TearMode::None, 5);
    assert_eq!((parts(&whole, 5), never), (1, usize::MAX));
}
