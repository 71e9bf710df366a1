//! A smooth seam: fairing of the crease along which two surfaces meet.
//!
//! The crease of a union is as sharp as its bodies' angle. Within a distance of the seam, its short edges are collapsed,
//! its long ones split, and its vertices moved towards the means of their neighbours, by weights that end at that
//! distance. What is beyond keeps its position to the bit. Moving the vertices along their normals, by the same
//! weights, then restores the volume.

use std::{cmp::Reverse, collections::BinaryHeap};

use glam::DVec3;

/// Blend distance, unless a scene says otherwise [radii].
pub const BLEND: f64 = 0.25;

/// Shortest edge at the seam [blend distances].
const SHORTEST: f64 = 0.12;
/// Longest edge within [`DENSE`] of the seam [blend distances].
const LONGEST: f64 = 0.7;
/// Distance from the seam within which long edges are split [blend distances].
const DENSE: f64 = 0.7;
/// Number of times that long edges are split.
const SPLITS: usize = 2;
/// Number of times that vertices are moved towards the means of their neighbours.
const ROUNDS: usize = 12;
/// Fraction of the way to the mean of its neighbours that a vertex at the seam is moved.
const STEP: f64 = 0.6;
/// Shortest edge at the seam of a sharp surface, which is otherwise left as it is [radii].
const SHORTEST_SHARP: f64 = 1e-5;

/// A closed surface with a seam.
#[derive(Clone, Debug, Default)]
pub struct Seamed<T> {
    /// Positions of the vertices [scene unit], `[vertex_count]`.
    pub positions: Vec<DVec3>,
    /// What the caller knows of each vertex, `[vertex_count]`.
    pub labels: Vec<T>,
    /// Vertices of each triangle, counter-clockwise from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Index of the seam that each vertex is on; `None` elsewhere, `[vertex_count]`.
    pub on_seam: Vec<Option<u32>>,
}

/// The nearest seam of a vertex.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Near {
    /// Index of the seam.
    pub seam: u32,
    /// Distance to it along edges [scene unit].
    pub distance: f64,
}

impl<T: Copy> Seamed<T> {
    /// Smooths the surface within `blend` radii of its seams, whose radii are given [scene unit]. 0 leaves it sharp, and
    /// only removes edges at the seam that are too short to be drawn. The label of a new vertex is made of that of the
    /// nearer end of the edge that it splits.
    pub fn fair(&mut self, blend: f64, radii: &[f64], of_new: impl Fn(T) -> T) {
        let reach = |seam: u32| blend * radii[seam as usize];
        let longest = radii.iter().copied().fold(0.0, f64::max);
        let mut near = self.distances(None, blend * longest);
        let mut band: Vec<u32> = Vec::new();
        let is_near =
            |near: &[Option<Near>], v: u32| near[v as usize].is_some_and(|near| near.distance <= reach(near.seam));
        band.extend(
            (0..self.triangles.len() as u32).filter(|&t| self.triangles[t as usize].iter().any(|&v| is_near(&near, v))),
        );
        let shortest = |seam: u32| f64::max(SHORTEST * blend, SHORTEST_SHARP) * radii[seam as usize];
        let removed = self.collapse(&band, shortest);
        if blend > 0.0 {
            band.retain(|&t| !removed[t as usize]);
            for _ in 0..SPLITS {
                if !self.split(&mut band, &mut near, reach, &of_new) {
                    break;
                }
            }
            self.relax(&band, blend * longest, reach);
        }
        let mut number = 0;
        self.triangles.retain(|_| {
            number += 1;
            !removed.get(number - 1).copied().unwrap_or(false)
        });
        self.compact();
    }

    /// The nearest seam of every vertex within `most` [scene unit], along the edges of some triangles (`None`: all).
    pub fn distances(&self, band: Option<&[u32]>, most: f64) -> Vec<Option<Near>> {
        let beside = Beside::new(self.positions.len(), &self.triangles, band);
        let mut near: Vec<Option<Near>> = vec![None; self.positions.len()];
        let mut queue = BinaryHeap::new();
        for (v, seam) in self.on_seam.iter().enumerate() {
            if let Some(seam) = *seam {
                near[v] = Some(Near { seam, distance: 0.0 });
                queue.push((Reverse(0), v as u32));
            }
        }
        while let Some((Reverse(bits), v)) = queue.pop() {
            let Some(Near { seam, distance }) = near[v as usize] else { continue };
            if distance.to_bits() != bits {
                continue; // a shorter way was found
            }
            for &t in beside.triangles(v) {
                for &to in &self.triangles[t as usize] {
                    let distance = distance + self.positions[v as usize].distance(self.positions[to as usize]);
                    if distance <= most && near[to as usize].is_none_or(|known| distance < known.distance) {
                        near[to as usize] = Some(Near { seam, distance });
                        queue.push((Reverse(distance.to_bits()), to));
                    }
                }
            }
        }
        near
    }

    /// Collapses short edges at the seam, where that changes neither topology nor orientation. Returns which triangles
    /// are gone.
    fn collapse(&mut self, band: &[u32], shortest: impl Fn(u32) -> f64) -> Vec<bool> {
        let mut removed = vec![false; self.triangles.len()];
        let mut beside: Vec<Vec<u32>> = vec![Vec::new(); self.positions.len()];
        for &t in band {
            self.triangles[t as usize].iter().for_each(|&v| beside[v as usize].push(t));
        }
        let seam: Vec<u32> = (0..self.positions.len() as u32).filter(|&v| self.on_seam[v as usize].is_some()).collect();
        for &v in &seam {
            let Some(of) = self.on_seam[v as usize] else { continue };
            let shortest = shortest(of);
            let at = self.positions[v as usize];
            let neighbours = |v: u32, beside: &[Vec<u32>], triangles: &[[u32; 3]]| {
                let mut all: Vec<u32> = beside[v as usize]
                    .iter()
                    .flat_map(|&t| triangles[t as usize])
                    .filter(|&other| other != v)
                    .collect();
                all.sort_unstable();
                all.dedup();
                all
            };
            let around = neighbours(v, &beside, &self.triangles);
            let length = |&to: &u32| self.positions[to as usize].distance(at);
            let nearest = around.iter().copied().min_by(|a, b| length(a).total_cmp(&length(b)).then(a.cmp(b)));
            let Some(to) = nearest.filter(|to| length(to) < shortest) else { continue };
            let around_to = neighbours(to, &beside, &self.triangles);
            let common = around.iter().filter(|v| around_to.binary_search(v).is_ok()).count();
            let is_inside = |v: u32, around: &[u32]| beside[v as usize].len() == around.len();
            if common != 2
                || !is_inside(v, &around)
                || !is_inside(to, &around_to)
                || around.len().min(around_to.len()) < 4
            {
                continue;
            }
            let flips = beside[v as usize].iter().any(|&t| {
                let corners = self.triangles[t as usize];
                if corners.contains(&to) {
                    return false;
                }
                let normal = |corners: [u32; 3]| {
                    let [a, b, c] = corners.map(|v| self.positions[v as usize]);
                    (b - a).cross(c - a)
                };
                let (before, after) = (normal(corners), normal(corners.map(|x| if x == v { to } else { x })));
                let is_flat = before.length_squared() < 1e-12 * shortest.powi(4);
                after.length_squared() == 0.0 || !is_flat && before.dot(after) < 0.2 * before.length() * after.length()
            });
            if flips {
                continue;
            }
            for t in std::mem::take(&mut beside[v as usize]) {
                let corners = &mut self.triangles[t as usize];
                if corners.contains(&to) {
                    removed[t as usize] = true;
                    for other in corners.iter().filter(|&&other| other != v) {
                        beside[*other as usize].retain(|&other| other != t);
                    }
                } else {
                    *corners = corners.map(|x| if x == v { to } else { x });
                    beside[to as usize].push(t);
                }
            }
            self.on_seam[to as usize] = self.on_seam[to as usize].or(Some(of));
            self.on_seam[v as usize] = None;
        }
        removed
    }

    /// Splits long edges near the seam; returns whether there were any.
    fn split(
        &mut self,
        band: &mut Vec<u32>,
        near: &mut Vec<Option<Near>>,
        reach: impl Fn(u32) -> f64,
        of_new: impl Fn(T) -> T,
    ) -> bool {
        // the two triangles of every edge: (edge, triangle), ascending
        let mut edges: Vec<([u32; 2], u32)> = band.iter().flat_map(|&t| self.edges(t).map(|edge| (edge, t))).collect();
        edges.sort_unstable();
        let mut middles: Vec<([u32; 2], u32)> = Vec::new();
        for group in edges.chunk_by(|a, b| a.0 == b.0) {
            let [a, b] = group[0].0;
            let (Some(first), Some(second)) = (near[a as usize], near[b as usize]) else { continue };
            let closer = if second.distance < first.distance { second } else { first };
            let reach = reach(closer.seam);
            let (p, q) = (self.positions[a as usize], self.positions[b as usize]);
            if group.len() != 2 || closer.distance > DENSE * reach || p.distance(q) <= LONGEST * reach {
                continue;
            }
            middles.push(([a, b], self.positions.len() as u32));
            let is_on_seam = self.on_seam[a as usize].is_some() && self.on_seam[b as usize].is_some();
            self.positions.push((p + q) / 2.0);
            let nearer = if second.distance < first.distance { b } else { a };
            self.labels.push(of_new(self.labels[nearer as usize]));
            self.on_seam.push(if is_on_seam { Some(closer.seam) } else { None });
            let distance = if is_on_seam { 0.0 } else { (first.distance + second.distance) / 2.0 };
            near.push(Some(Near { distance, ..closer }));
        }
        if middles.is_empty() {
            return false;
        }
        let middle = |a: u32, b: u32| {
            let place = middles.binary_search_by_key(&[a.min(b), a.max(b)], |middle| middle.0);
            place.ok().map(|place| middles[place].1)
        };
        for i in 0..band.len() {
            let t = band[i] as usize;
            let [a, b, c] = self.triangles[t];
            let mut put = |parts: &[[u32; 3]]| {
                self.triangles[t] = parts[0];
                band.extend((0..parts.len() - 1).map(|k| (self.triangles.len() + k) as u32));
                self.triangles.extend(&parts[1..]);
            };
            match [middle(a, b), middle(b, c), middle(c, a)] {
                [None, None, None] => {}
                [Some(ab), Some(bc), Some(ca)] => put(&[[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]),
                parts => {
                    // turned so that the first edge is split and the last is not
                    let k = (0..3).find(|&k| parts[k].is_some() && parts[(k + 2) % 3].is_none()).unwrap_or(0);
                    let turned = [a, b, c];
                    let (x, y, z) = (turned[k], turned[(k + 1) % 3], turned[(k + 2) % 3]);
                    let Some(xy) = parts[k] else { continue };
                    match parts[(k + 1) % 3] {
                        None => put(&[[x, xy, z], [xy, y, z]]),
                        Some(yz) => {
                            let length =
                                |v: u32, w: u32| self.positions[v as usize].distance(self.positions[w as usize]);
                            if length(x, yz) < length(xy, z) {
                                put(&[[xy, y, yz], [x, xy, yz], [x, yz, z]]);
                            } else {
                                put(&[[xy, y, yz], [x, xy, z], [xy, yz, z]]);
                            }
                        }
                    }
                }
            }
        }
        true
    }

    /// Moves vertices near the seam towards the means of their neighbours, and restores the volume.
    fn relax(&mut self, band: &[u32], most: f64, reach: impl Fn(u32) -> f64) {
        let near = self.distances(Some(band), most);
        let mut edges: Vec<([u32; 2], u32)> = band.iter().flat_map(|&t| self.edges(t).map(|edge| (edge, t))).collect();
        edges.sort_unstable();
        // vertices at the rim of the band have neighbours beyond it
        let mut is_at_rim = vec![false; self.positions.len()];
        for group in edges.chunk_by(|a, b| a.0 == b.0) {
            if group.len() != 2 {
                group[0].0.iter().for_each(|&v| is_at_rim[v as usize] = true);
            }
        }
        let mut moved: Vec<(u32, f64)> = Vec::new();
        let mut number = vec![u32::MAX; self.positions.len()];
        for (v, near) in near.iter().enumerate() {
            let Some(Near { seam, distance }) = *near else { continue };
            let share = 1.0 - distance / reach(seam);
            if share > 0.0 && !is_at_rim[v] {
                number[v] = moved.len() as u32;
                moved.push((v as u32, share * share * (3.0 - 2.0 * share)));
            }
        }
        let mut neighbours: Vec<Vec<u32>> = vec![Vec::new(); moved.len()];
        for group in edges.chunk_by(|a, b| a.0 == b.0) {
            let [a, b] = group[0].0;
            for (v, other) in [(a, b), (b, a)] {
                if let Some(list) = neighbours.get_mut(number[v as usize] as usize) {
                    list.push(other);
                }
            }
        }
        let before = self.volume(band);
        let mut next: Vec<DVec3> = Vec::with_capacity(moved.len());
        for _ in 0..ROUNDS {
            next.clear();
            next.extend(moved.iter().zip(&neighbours).map(|(&(v, weight), neighbours)| {
                let at = self.positions[v as usize];
                let sum: DVec3 = neighbours.iter().map(|&other| self.positions[other as usize]).sum();
                at + (sum / neighbours.len() as f64 - at) * (STEP * weight)
            }));
            for (&(v, _), &position) in moved.iter().zip(&next) {
                self.positions[v as usize] = position;
            }
        }
        // the volume changes by the weighted area for every unit of length along the normals
        for _ in 0..3 {
            let mut areas = vec![DVec3::ZERO; moved.len()];
            for &t in band {
                let corners = self.triangles[t as usize];
                let [a, b, c] = corners.map(|v| self.positions[v as usize]);
                let area = (b - a).cross(c - a) / 6.0;
                for v in corners {
                    if let Some(sum) = areas.get_mut(number[v as usize] as usize) {
                        *sum += area;
                    }
                }
            }
            let rate: f64 = areas.iter().zip(&moved).map(|(area, (_, weight))| weight * area.length()).sum();
            let by = (before - self.volume(band)) / rate;
            if !by.is_finite() {
                break;
            }
            for (area, &(v, weight)) in areas.iter().zip(&moved) {
                self.positions[v as usize] += area.normalize_or_zero() * (by * weight);
            }
        }
    }

    /// Volume between some triangles and a fixed point [scene unit³].
    fn volume(&self, band: &[u32]) -> f64 {
        let origin = band.first().map_or(DVec3::ZERO, |&t| self.positions[self.triangles[t as usize][0] as usize]);
        let of = |&t: &u32| {
            let [a, b, c] = self.triangles[t as usize].map(|v| self.positions[v as usize] - origin);
            a.dot(b.cross(c)) / 6.0
        };
        band.iter().map(of).sum()
    }

    /// The edges of a triangle, each from its lower vertex to its higher one.
    fn edges(&self, triangle: u32) -> [[u32; 2]; 3] {
        let [a, b, c] = self.triangles[triangle as usize];
        [[a, b], [b, c], [c, a]].map(|[a, b]| [a.min(b), a.max(b)])
    }

    /// Removes vertices that no triangle has.
    fn compact(&mut self) {
        let mut number = vec![u32::MAX; self.positions.len()];
        self.triangles.iter().flatten().for_each(|&v| number[v as usize] = 0);
        let mut count = 0;
        for v in 0..number.len() {
            if number[v] == 0 {
                number[v] = count;
                let to = count as usize;
                self.positions[to] = self.positions[v];
                self.labels[to] = self.labels[v];
                self.on_seam[to] = self.on_seam[v];
                count += 1;
            }
        }
        self.positions.truncate(count as usize);
        self.labels.truncate(count as usize);
        self.on_seam.truncate(count as usize);
        for corners in &mut self.triangles {
            *corners = corners.map(|v| number[v as usize]);
        }
    }
}

/// The triangles about each vertex.
struct Beside {
    first: Vec<u32>,
    triangles: Vec<u32>,
}

impl Beside {
    fn new(vertices: usize, triangles: &[[u32; 3]], band: Option<&[u32]>) -> Beside {
        let all: Vec<u32>;
        let band = match band {
            Some(band) => band,
            None => {
                all = (0..triangles.len() as u32).collect();
                &all
            }
        };
        let mut first = vec![0; vertices + 2];
        for &t in band {
            triangles[t as usize].iter().for_each(|&v| first[v as usize + 2] += 1);
        }
        for v in 2..first.len() {
            first[v] += first[v - 1];
        }
        let mut list = vec![0; 3 * band.len()];
        for &t in band {
            for &v in &triangles[t as usize] {
                let place = &mut first[v as usize + 1];
                list[*place as usize] = t;
                *place += 1;
            }
        }
        Beside { first, triangles: list }
    }

    fn triangles(&self, v: u32) -> &[u32] {
        &self.triangles[self.first[v as usize] as usize..self.first[v as usize + 1] as usize]
    }
}
