//! Closed meshes to unite.

use std::f64::consts::{PI, TAU};

use glam::{DMat3, DVec3};

#[derive(Clone, Debug)]
pub struct Shape {
    pub positions: Vec<DVec3>,
    pub triangles: Vec<[u32; 3]>,
}

impl Shape {
    pub fn at(mut self, offset: DVec3) -> Shape {
        self.positions.iter_mut().for_each(|p| *p += offset);
        self
    }

    pub fn scaled(mut self, by: f64) -> Shape {
        self.positions.iter_mut().for_each(|p| *p *= by);
        self
    }

    pub fn turned(mut self, by: DMat3) -> Shape {
        self.positions.iter_mut().for_each(|p| *p = by * *p);
        self
    }

    pub fn inverted(mut self) -> Shape {
        self.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        self
    }

    pub fn shaken(mut self, random: &mut Random, by: f64) -> Shape {
        self.positions.iter_mut().for_each(|p| *p += by * 2.0 * random.in_cube());
        self
    }

    /// Combines two meshes into one.
    pub fn and(mut self, other: Shape) -> Shape {
        let first = self.positions.len() as u32;
        self.positions.extend(other.positions);
        self.triangles.extend(other.triangles.iter().map(|t| t.map(|v| v + first)));
        self
    }
}

/// A sphere as in scenes: poles, and rings between them.
pub fn sphere(stacks: u32, slices: u32) -> Shape {
    let mut positions = vec![DVec3::Z];
    for i in 1..stacks {
        let (sin, cos) = (PI * f64::from(i) / f64::from(stacks)).sin_cos();
        for j in 0..slices {
            let (y, x) = (TAU * f64::from(j) / f64::from(slices)).sin_cos();
            positions.push(DVec3::new(sin * x, sin * y, cos));
        }
    }
    positions.push(DVec3::NEG_Z);
    let ring = |i: u32, j: u32| 1 + (i - 1) * slices + j % slices;
    let south = positions.len() as u32 - 1;
    let mut triangles = Vec::new();
    for j in 0..slices {
        triangles.push([0, ring(1, j), ring(1, j + 1)]);
        triangles.push([ring(stacks - 1, j), south, ring(stacks - 1, j + 1)]);
        for i in 1..stacks - 1 {
            let [nw, ne, sw, se] = [ring(i, j), ring(i, j + 1), ring(i + 1, j), ring(i + 1, j + 1)];
            triangles.extend([[nw, sw, se], [nw, se, ne]]);
        }
    }
    Shape { positions, triangles }
}

pub fn octahedron() -> Shape {
    sphere(2, 4)
}

pub fn cube() -> Shape {
    let positions = (0..8)
        .map(|i| DVec3::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2 & 1)) * 2.0 - DVec3::ONE)
        .collect();
    let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = faces.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    Shape { positions, triangles }
}

/// A torus about the z axis.
pub fn torus(major: f64, minor: f64, around: u32, across: u32) -> Shape {
    let mut positions = Vec::new();
    for i in 0..around {
        let (sin, cos) = (TAU * f64::from(i) / f64::from(around)).sin_cos();
        for j in 0..across {
            let (z, x) = (TAU * f64::from(j) / f64::from(across)).sin_cos();
            let r = major + minor * x;
            positions.push(DVec3::new(r * cos, r * sin, minor * z));
        }
    }
    let at = |i: u32, j: u32| (i % around) * across + j % across;
    let mut triangles = Vec::new();
    for i in 0..around {
        for j in 0..across {
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    Shape { positions, triangles }
}

/// Volume of the intersection of two unit spheres whose centres are `distance` apart.
pub fn lens_volume(distance: f64) -> f64 {
    PI * (2.0 - distance).powi(2) * (distance * distance + 4.0 * distance) / (12.0 * distance)
}

pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Random {
        let mut random = Random(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1);
        // Discard the first outputs, which are small for small seeds.
        for _ in 0..10 {
            random.next();
        }
        random
    }

    /// A random number in [0, 1).
    pub fn next(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    pub fn below(&mut self, n: usize) -> usize {
        (self.next() * n as f64) as usize
    }

    /// A random vector in [−½, ½)³.
    pub fn in_cube(&mut self) -> DVec3 {
        DVec3::new(self.next(), self.next(), self.next()) - DVec3::splat(0.5)
    }

    pub fn rotation(&mut self) -> DMat3 {
        let axis = self.in_cube().normalize_or(DVec3::X);
        DMat3::from_axis_angle(axis, TAU * self.next())
    }
}
