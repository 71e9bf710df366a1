//! SIMD evaluation of springs.
//!
//! On a cubic lattice, consecutive nodes have consecutive neighbours: the springs of a row of nodes in one direction
//! read two contiguous ranges of every array, and a group of them takes a few instructions. Springs at split nodes,
//! whose indices are not consecutive, form separate groups.
//!
//! Sums have a fixed order for any register width: group by group, and in each group first all forces on first nodes,
//! then all forces on second nodes. There are no fused multiply-adds. Results are therefore bit-identical for every
//! instruction set.

use glam::DVec3;
use pulp::{Arch, Simd, WithSimd};

use super::Spring;

/// Number of springs in a group.
pub const GROUP: usize = 8;

/// Springs between the nodes a, a + 1, … and b, b + 1, …; unused ones have no stiffness.
#[derive(Clone, Debug, PartialEq)]
pub struct Group {
    a: u32,
    b: u32,
    /// Rest lengths [scene unit].
    rest: [f64; GROUP],
    /// Inverse squares of the rest lengths.
    per_square: [f64; GROUP],
    /// Stiffnesses [mass/s²].
    stiffness: [f64; GROUP],
}

impl Group {
    /// The springs of the group.
    pub fn springs(&self) -> impl Iterator<Item = Spring> + '_ {
        let with = (0..GROUP as u32).zip(self.rest.iter().zip(&self.stiffness)).filter(|(_, of)| *of.1 > 0.0);
        with.map(|(k, (&rest, &stiffness))| Spring { a: self.a + k, b: self.b + k, rest, stiffness })
    }
}

/// Adds groups of springs, in ascending order of their nodes.
pub fn group(mut springs: Vec<Spring>, groups: &mut Vec<Group>) {
    let first = groups.len();
    springs.sort_unstable_by_key(|spring| (spring.b - spring.a, spring.a));
    for run in springs.chunk_by(|x, y| (x.a + 1, x.b + 1) == (y.a, y.b)) {
        for some in run.chunks(GROUP) {
            let none = [0.0; GROUP];
            let mut group = Group { a: some[0].a, b: some[0].b, rest: none, per_square: none, stiffness: none };
            for (k, spring) in some.iter().enumerate() {
                (group.rest[k], group.per_square[k]) = (spring.rest, 1.0 / (spring.rest * spring.rest));
                group.stiffness[k] = spring.stiffness;
            }
            groups.push(group);
        }
    }
    groups[first..].sort_unstable_by_key(|group| (group.a, group.b));
}

/// Positions, velocities and forces by coordinate; reused.
#[derive(Clone, Debug, Default)]
pub struct Lanes {
    positions: [Vec<f64>; 3],
    velocities: [Vec<f64>; 3],
    forces: [Vec<f64>; 3],
}

impl Lanes {
    /// Writes the forces of springs and dampers on the nodes [mass · scene unit/s²] to `forces`; returns the largest
    /// ratio of a spring's length to its rest length [–]. `damping` is damping over stiffness [s].
    pub fn pull(
        &mut self,
        groups: &[Group],
        damping: f64,
        positions: &[DVec3],
        velocities: &[DVec3],
        forces: &mut Vec<DVec3>,
    ) -> f64 {
        let room = positions.len() + GROUP; // the last group reads beyond the last node
        for (lanes, vectors) in [(&mut self.positions, positions), (&mut self.velocities, velocities)] {
            for (axis, lane) in lanes.iter_mut().enumerate() {
                lane.clear();
                lane.extend(vectors.iter().map(|vector| vector[axis]));
                lane.resize(room, 0.0);
            }
        }
        for lane in &mut self.forces {
            lane.clear();
            lane.resize(room, 0.0);
        }
        let largest = Arch::new().dispatch(Pull { lanes: self, groups, damping });
        let [x, y, z] = &self.forces;
        forces.clear();
        forces.extend(x.iter().zip(y).zip(z).take(positions.len()).map(|((&x, &y), &z)| DVec3::new(x, y, z)));
        largest.sqrt()
    }
}

struct Pull<'a> {
    lanes: &'a mut Lanes,
    groups: &'a [Group],
    damping: f64,
}

impl WithSimd for Pull<'_> {
    /// The largest squared ratio of length to rest length.
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f64 {
        let Pull { lanes: Lanes { positions, velocities, forces }, groups, damping } = self;
        let (zero, damping) = (simd.splat_f64s(0.0), simd.splat_f64s(damping));
        let width = S::F64_LANES;
        let at = |lane: &[f64], first: usize| S::as_simd_f64s(&lane[first..first + width]).0[0];
        let mut largest = zero;
        let mut pulls = [[0.0; GROUP]; 3];
        for Group { a, b, rest, per_square, stiffness } in groups {
            let (a, b) = (*a as usize, *b as usize);
            for k in (0..GROUP).step_by(width) {
                let apart = |of: &[f64]| simd.sub_f64s(at(of, b + k), at(of, a + k));
                let [x, y, z] = [apart(&positions[0]), apart(&positions[1]), apart(&positions[2])];
                let [u, v, w] = [apart(&velocities[0]), apart(&velocities[1]), apart(&velocities[2])];
                let dot = |p: [S::f64s; 3], q: [S::f64s; 3]| {
                    let xy = simd.add_f64s(simd.mul_f64s(p[0], q[0]), simd.mul_f64s(p[1], q[1]));
                    simd.add_f64s(xy, simd.mul_f64s(p[2], q[2]))
                };
                let square = dot([x, y, z], [x, y, z]);
                let length = simd.sqrt_f64s(square);
                // (k (d − L) + γk d′)/d with d′ = d·d_t/d, as k ((d − L) d + γ d·d_t)/d²
                let stretch = simd.mul_f64s(simd.sub_f64s(length, at(rest, k)), length);
                let drag = simd.mul_f64s(damping, dot([x, y, z], [u, v, w]));
                let stiffness = at(stiffness, k);
                let tension = simd.div_f64s(simd.mul_f64s(stiffness, simd.add_f64s(stretch, drag)), square);
                // a spring of zero length has no direction, and unused lanes are not springs
                let is_spring = simd.and_m64s(simd.less_than_f64s(zero, stiffness), simd.less_than_f64s(zero, square));
                for (pull, along) in pulls.iter_mut().zip([x, y, z]) {
                    let force = simd.select_f64s(is_spring, simd.mul_f64s(tension, along), zero);
                    S::as_mut_simd_f64s(&mut pull[k..k + width]).0[0] = force;
                }
                let strain = simd.select_f64s(is_spring, simd.mul_f64s(square, at(per_square, k)), zero);
                largest = simd.max_f64s(largest, strain);
            }
            for (sums, pull) in forces.iter_mut().zip(&pulls) {
                for k in (0..GROUP).step_by(width) {
                    let sum = &mut sums[a + k..a + k + width];
                    let sum = &mut S::as_mut_simd_f64s(sum).0[0];
                    *sum = simd.add_f64s(*sum, at(pull, k));
                }
                for k in (0..GROUP).step_by(width) {
                    let sum = &mut sums[b + k..b + k + width];
                    let sum = &mut S::as_mut_simd_f64s(sum).0[0];
                    *sum = simd.sub_f64s(*sum, at(pull, k));
                }
            }
        }
        simd.reduce_max_f64s(largest)
    }
}
