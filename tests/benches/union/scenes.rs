//! Scenes of closed meshes that are hard to unite, of many kinds. A scene is a function of its number.

use std::f64::consts::{PI, TAU};

use glam::{DMat3, DVec3};

/// A closed mesh.
#[derive(Clone, Debug)]
pub struct Shape {
    pub positions: Vec<DVec3>,
    pub triangles: Vec<[u32; 3]>,
}

/// The difficulty of a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Random,
    Deformed,
    Lattice,
    Coplanar,
    Nested,
    Identical,
    UlpApart,
    Touching,
    SelfIntersecting,
    Inverted,
    NotNumbers,
}

impl Kind {
    pub const ALL: [Kind; 11] = [
        Kind::Random,
        Kind::Deformed,
        Kind::Lattice,
        Kind::Coplanar,
        Kind::Nested,
        Kind::Identical,
        Kind::UlpApart,
        Kind::Touching,
        Kind::SelfIntersecting,
        Kind::Inverted,
        Kind::NotNumbers,
    ];

    pub fn name(self) -> &'static str {
        match self {
            Kind::Random => "random",
            Kind::Deformed => "deformed",
            Kind::Lattice => "on a lattice",
            Kind::Coplanar => "coplanar",
            Kind::Nested => "nested",
            Kind::Identical => "identical",
            Kind::UlpApart => "an ulp apart",
            Kind::Touching => "touching",
            Kind::SelfIntersecting => "self-intersecting",
            Kind::Inverted => "inverted",
            Kind::NotNumbers => "NaN, ∞, huge",
        }
    }
}

/// A scene.
pub struct Scene {
    pub kind: Kind,
    pub shapes: Vec<Shape>,
}

impl Scene {
    /// Scene `number`; kinds take turns.
    pub fn new(number: u64) -> Scene {
        let kind = Kind::ALL[(number % Kind::ALL.len() as u64) as usize];
        let mut random = Random::new(number);
        let random = &mut random;
        let count = 2 + random.below(4);
        let shapes: Vec<Shape> = match kind {
            Kind::Random => {
                let extent = 0.6 + 4.0 * random.next();
                (0..count).map(|_| one(random).turned(random.rotation()).at(extent * random.in_cube())).collect()
            }
            Kind::Deformed => {
                // spheres with dents and bumps, like bodies that act on each other
                let extent = 1.5 + 2.0 * random.next();
                let bumpy = |random: &mut Random| {
                    let (stacks, slices) = SIZES[2 + random.below(3)];
                    let waves: Vec<(DVec3, f64)> =
                        (0..3).map(|_| (6.0 * random.in_cube(), 0.2 * (random.next() - 0.5))).collect();
                    let mut sphere = sphere(stacks, slices);
                    for p in &mut sphere.positions {
                        *p *= 1.0 + waves.iter().map(|(k, size)| size * k.dot(*p).sin()).sum::<f64>();
                    }
                    sphere
                };
                (0..count).map(|_| bumpy(random).at(extent * random.in_cube())).collect()
            }
            Kind::Lattice => {
                let lattice = [0.25, 0.5, 1.0][random.below(3)];
                let (shape, extent) = (one(random), 1.0 + 4.0 * random.next());
                let is_same = random.next() < 0.5;
                let on_lattice = |at: DVec3| (at / lattice).round() * lattice;
                (0..count)
                    .map(|_| {
                        let shape = if is_same { shape.clone() } else { one(random) };
                        shape.at(on_lattice(extent * random.in_cube()))
                    })
                    .collect()
            }
            Kind::Coplanar => {
                let boxes = random.next() < 0.7;
                let turn = if random.next() < 0.5 { DMat3::IDENTITY } else { random.rotation() };
                (0..count)
                    .map(|_| {
                        let shape = if boxes { cube() } else { one(random) };
                        let scale = [0.5, 1.0, 1.5][random.below(3)];
                        let mut at = 3.0 * random.in_cube();
                        at.z = scale; // all stand on one plane
                        if random.next() < 0.5 {
                            at.x = (2.0 * at.x).round() / 2.0;
                        }
                        shape.scaled(scale).at(at).turned(turn)
                    })
                    .collect()
            }
            Kind::Nested => {
                let shape = one(random);
                let at = random.in_cube();
                let off = [0.0, 1e-12, 1e-3, 0.1][random.below(4)];
                (0..count)
                    .map(|i| {
                        let scale = if random.next() < 0.2 { 1.0 } else { 1.0 / (1.0 + i as f64 * random.next()) };
                        shape.clone().scaled(scale).at(at + off * random.in_cube())
                    })
                    .collect()
            }
            Kind::Identical => {
                let (shape, other) = (one(random), one(random));
                let at = random.in_cube();
                (0..count)
                    .map(|i| if i + 1 == count && i > 1 { other.clone().at(at) } else { shape.clone().at(at) })
                    .collect()
            }
            Kind::UlpApart => {
                let shape = one(random);
                let by = f64::EPSILON * [1.0, 10.0, 1e3, 1e6][random.below(4)];
                (0..count).map(|_| shape.clone().at(by * 2.0 * random.in_cube())).collect()
            }
            Kind::Touching => {
                // poles, equators, faces, edges and corners in exact contact
                let shape = if random.next() < 0.4 { cube() } else { one(random) };
                let axes = [DVec3::X, DVec3::Y, DVec3::Z];
                let mut at = DVec3::ZERO;
                (0..count)
                    .map(|_| {
                        let placed = shape.clone().at(at);
                        at += 2.0 * axes[random.below(3)] * if random.next() < 0.5 { 1.0 } else { -1.0 };
                        if random.next() < 0.3 {
                            at += axes[random.below(3)] * [0.5, 1.0, 2.0][random.below(3)];
                        }
                        placed
                    })
                    .collect()
            }
            Kind::SelfIntersecting => {
                let shake = 0.9 * random.next() * random.next();
                let extent = 0.6 + 3.0 * random.next();
                (0..1 + random.below(3))
                    .map(|_| {
                        let (stacks, slices) = SIZES[random.below(4)];
                        let mut shape = match random.below(3) {
                            0 => sphere(stacks, slices).and(sphere(stacks, slices).at(DVec3::new(
                                2.0 * random.next(),
                                0.1,
                                0.2,
                            ))),
                            _ => sphere(stacks, slices),
                        };
                        shape.positions.iter_mut().for_each(|p| *p += shake * 2.0 * random.in_cube());
                        shape.at(extent * random.in_cube())
                    })
                    .collect()
            }
            Kind::Inverted => {
                let extent = 0.6 + 3.0 * random.next();
                (0..count)
                    .map(|i| {
                        let shape = one(random).turned(random.rotation()).at(extent * random.in_cube());
                        if i == 0 || random.next() < 0.3 { shape.inverted() } else { shape }
                    })
                    .collect()
            }
            Kind::NotNumbers => (0..count)
                .map(|_| {
                    let mut shape = one(random).at(2.0 * random.in_cube());
                    let bad = [f64::NAN, f64::INFINITY, 1e300, 1e95, 1e60, 1e-300, -0.0][random.below(7)];
                    for _ in 0..random.below(3) {
                        let (v, axis) = (random.below(shape.positions.len()), random.below(3));
                        shape.positions[v][axis] = bad;
                    }
                    if random.next() < 0.3 {
                        let scale = [1e-160, 1e-9, 1e80][random.below(3)];
                        shape.positions.iter_mut().for_each(|p| *p *= scale);
                    }
                    shape
                })
                .collect(),
        };
        Scene { kind, shapes }
    }

    /// Whether each body is a valid solid: neither inverted nor self-intersecting.
    pub fn is_of_solids(&self) -> bool {
        !matches!(self.kind, Kind::SelfIntersecting | Kind::Inverted | Kind::NotNumbers)
    }

    /// The scene with every body slightly displaced, so that nothing touches exactly.
    pub fn shifted(&self, seed: u64, by: f64) -> Scene {
        let mut random = Random::new(seed);
        let shapes = self.shapes.iter().map(|shape| shape.clone().at(by * random.in_cube())).collect();
        Scene { kind: self.kind, shapes }
    }
}

/// Stacks and slices of spheres.
const SIZES: [(u32, u32); 5] = [(2, 3), (3, 5), (4, 4), (6, 12), (12, 24)];

fn one(random: &mut Random) -> Shape {
    let (stacks, slices) = SIZES[random.below(20).min(random.below(5))];
    match random.below(8) {
        0 => cube(),
        1 => torus(1.0, 0.4, 3 + slices / 2, 3 + stacks / 2),
        _ => sphere(stacks, slices),
    }
}

impl Shape {
    pub fn at(mut self, offset: DVec3) -> Shape {
        self.positions.iter_mut().for_each(|p| *p += offset);
        self
    }

    /// Signed volume.
    pub fn volume(&self) -> f64 {
        let of = |corners: &[u32; 3]| {
            let [a, b, c] = corners.map(|v| self.positions[v as usize]);
            a.dot(b.cross(c)) / 6.0
        };
        self.triangles.iter().map(of).sum()
    }

    fn scaled(mut self, by: f64) -> Shape {
        self.positions.iter_mut().for_each(|p| *p *= by);
        self
    }

    fn turned(mut self, by: DMat3) -> Shape {
        self.positions.iter_mut().for_each(|p| *p = by * *p);
        self
    }

    fn inverted(mut self) -> Shape {
        self.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        self
    }

    fn and(mut self, other: Shape) -> Shape {
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

fn cube() -> Shape {
    let at = |i: u32, k: u32| f64::from(i >> k & 1) * 2.0 - 1.0;
    let positions = (0..8).map(|i| DVec3::new(at(i, 0), at(i, 1), at(i, 2))).collect();
    let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = faces.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    Shape { positions, triangles }
}

/// A torus about the z axis.
fn torus(major: f64, minor: f64, around: u32, across: u32) -> Shape {
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

/// Random numbers (xorshift).
struct Random(u64);

impl Random {
    fn new(seed: u64) -> Random {
        let mut random = Random(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1);
        // discard the first outputs, which are small for small seeds
        for _ in 0..10 {
            random.next();
        }
        random
    }

    /// In [0, 1).
    fn next(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    fn below(&mut self, n: usize) -> usize {
        (self.next() * n as f64) as usize
    }

    /// In [−½, ½)³.
    fn in_cube(&mut self) -> DVec3 {
        DVec3::new(self.next(), self.next(), self.next()) - DVec3::splat(0.5)
    }

    fn rotation(&mut self) -> DMat3 {
        let axis = self.in_cube().normalize_or(DVec3::X);
        DMat3::from_axis_angle(axis, TAU * self.next())
    }
}
