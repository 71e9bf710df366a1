//! Fairing of the crease along which two surfaces meet.
//!
//! Within a given distance of the seam, short edges are collapsed, long edges are split, and vertices are moved towards
//! the means of their neighbours, by weights that fall to zero at that distance. Farther vertices keep their position
//! to the bit. Moving the vertices along their normals, by the same weights, then restores the volume.
//!
//! Apart from one list of the triangles around each vertex, the cost is proportional to the number of vertices near the
//! seams. Displacements are in single precision, because they are only drawn; positions are in double precision.

use glam::{DVec3, Vec3A};
use rustc_hash::FxHashMap;

use super::{grouped, mesh::signed_volume};

/// Default blend distance [radii].
pub const BLEND: f64 = 0.25;

/// Shortest edge at the seam [blend distances].
const SHORTEST: f64 = 0.12;
/// Longest edge within [`DENSE`] of the seam [blend distances].
const LONGEST: f64 = 0.7;
/// Distance from the seam within which long edges are split [blend distances].
const DENSE: f64 = 0.7;
/// Number of passes that split long edges.
const SPLITS: usize = 2;
/// Number of passes that move vertices towards the means of their neighbours.
const ROUNDS: usize = 12;
/// Fraction of the way to the mean of its neighbours that a pass moves a vertex at the seam.
const STEP: f64 = 0.6;
/// Number of volume corrections: the first leaves a few thousandths of the change, the second nothing.
const CORRECTIONS: usize = 2;
/// Shortest edge at the seam of a sharp surface, which is otherwise unchanged [radii].
const SHORTEST_SHARP: f64 = 1e-5;

/// No vertex, no triangle.
const NONE: u32 = u32::MAX;

/// A closed surface with a seam.
#[derive(Clone, Debug, Default)]
pub struct Seamed<T> {
    /// Positions of the vertices [scene unit], `[vertex_count]`.
    pub positions: Vec<DVec3>,
    /// The caller's label of each vertex, `[vertex_count]`.
    pub labels: Vec<T>,
    /// Vertices of each triangle, counter-clockwise from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Index of the seam that each vertex is on; `None` elsewhere, `[vertex_count]`.
    pub on_seam: Vec<Option<u32>>,
}

/// A vertex near a seam.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Near {
    /// Index of the seam; of several, the one with the smallest distance in radii of that seam.
    pub seam: u32,
    /// Distance to the seam [radii of the seam].
    pub distance: f64,
    /// The nearest vertex of the seam.
    source: u32,
}

impl Near {
    const FAR: Near = Near { seam: NONE, distance: f64::INFINITY, source: NONE };
}

impl<T: Copy> Seamed<T> {
    /// Smooths the surface within `blend` radii of its seams, whose radii are given [scene unit]. 0 leaves the seams
    /// sharp, and only removes edges at the seam that are too short to be drawn. The label of a new vertex is derived,
    /// by `of_new`, from that of the nearer end of the edge that it splits, or from the farther end if the nearer one
    /// is on the seam. Finally, `relabel` is called for every vertex within `reach` radii of a seam.
    pub fn fair(
        &mut self,
        blend: f64,
        reach: f64,
        radii: &[f64],
        of_new: impl Fn(T) -> T,
        relabel: impl Fn(&mut T, Near),
    ) {
        let mut beside = Beside::new(self.positions.len(), &self.triangles);
        let seam: Vec<u32> = (0..self.positions.len() as u32).filter(|&v| self.on_seam[v as usize].is_some()).collect();
        let (mut near, mut visited) = self.nearest_seams(&beside, &seam, f64::max(blend, reach), radii);
        let shortest = |seam: u32| f64::max(SHORTEST * blend, SHORTEST_SHARP) * radii[seam as usize];
        let mut removed = vec![false; self.triangles.len()];
        let has_removed = self.collapse(&mut beside, &mut near, &seam, shortest, &mut removed);
        if blend > 0.0 {
            let mut band = self.band(&beside, &near, &visited, blend, &removed);
            for _ in 0..SPLITS {
                if !self.split(&mut band, &mut near, &mut visited, blend, radii, &of_new) {
                    break;
                }
            }
            self.relax(&band, &near, &visited, blend);
        }
        for &v in &visited {
            let near = near[v as usize];
            if near.distance < reach {
                relabel(&mut self.labels[v as usize], near);
            }
        }
        if has_removed {
            let mut number = 0;
            self.triangles.retain(|_| {
                number += 1;
                !removed.get(number - 1).copied().unwrap_or(false)
            });
            self.compact();
        }
    }

    /// The nearest seam of every vertex within `reach` radii, and these vertices. The nearest vertex of a seam is
    /// propagated from vertex to vertex, as in vector distance transforms (Danielsson, *Euclidean Distance Mapping*,
    /// 1980), so that the distance is straight and not along edges. The final distance is to the edges of the seam at
    /// that vertex.
    fn nearest_seams(&self, beside: &Beside, seam: &[u32], reach: f64, radii: &[f64]) -> (Vec<Near>, Vec<u32>) {
        let mut near = vec![Near::FAR; self.positions.len()];
        let mut visited = seam.to_vec();
        for &v in seam {
            if let Some(seam) = self.on_seam[v as usize] {
                near[v as usize] = Near { seam, distance: 0.0, source: v };
            }
        }
        let inverse: Vec<f64> = radii.iter().map(|radius| 1.0 / (radius * radius)).collect();
        let mut queue = visited.clone();
        let mut is_queued = vec![false; self.positions.len()];
        let mut at = 0;
        // distances are squared in this loop
        while let Some(&v) = queue.get(at) {
            at += 1;
            is_queued[v as usize] = false;
            let Near { seam, source, .. } = near[v as usize];
            let (from, inverse) = (self.positions[source as usize], inverse[seam as usize]);
            for to in beside.next(v) {
                let distance = self.positions[to as usize].distance_squared(from) * inverse;
                let known = &mut near[to as usize];
                if distance < known.distance && distance <= reach * reach {
                    if known.source == NONE {
                        visited.push(to);
                    }
                    *known = Near { seam, distance, source };
                    if !is_queued[to as usize] {
                        is_queued[to as usize] = true;
                        queue.push(to);
                    }
                }
            }
        }
        // refine to the distance from the edges of the seam at its nearest vertex
        for &v in &visited {
            let Near { seam, distance, source } = near[v as usize];
            if distance == 0.0 {
                continue;
            }
            let (at, from) = (self.positions[v as usize], self.positions[source as usize]);
            let to_edges = beside.next(source).filter(|&end| self.on_seam[end as usize] == Some(seam));
            let squared = to_edges
                .map(|end| {
                    let along = self.positions[end as usize] - from;
                    let share = ((at - from).dot(along) / along.length_squared()).clamp(0.0, 1.0);
                    at.distance_squared(from + along * share) * inverse[seam as usize]
                })
                .fold(distance, f64::min);
            near[v as usize].distance = squared.sqrt();
        }
        (near, visited)
    }

    /// Collapses short edges at the seam where that changes neither topology nor orientation, and marks the removed
    /// triangles. Returns whether there are any.
    fn collapse(
        &mut self,
        beside: &mut Beside,
        near: &mut [Near],
        seam: &[u32],
        shortest: impl Fn(u32) -> f64,
        removed: &mut [bool],
    ) -> bool {
        let mut has_removed = false;
        let (mut star, mut star_to) = (Vec::new(), Vec::new());
        for &v in seam {
            let Some(of) = self.on_seam[v as usize] else { continue };
            let (shortest, at) = (shortest(of), self.positions[v as usize]);
            beside.star(v, &self.triangles, removed, &mut star);
            let length = |&(_, to): &(u32, u32)| self.positions[to as usize].distance_squared(at);
            let nearest = star.iter().min_by(|a, b| length(a).total_cmp(&length(b)).then(a.1.cmp(&b.1)));
            let Some(&(_, to)) = nearest.filter(|nearest| length(nearest) < shortest * shortest) else { continue };
            beside.star(to, &self.triangles, removed, &mut star_to);
            let is_around_to = |v: u32| star_to.iter().any(|&(_, other)| other == v);
            let common = star.iter().filter(|&&(_, other)| is_around_to(other)).count();
            if common != 2 || star.len().min(star_to.len()) < 4 {
                continue;
            }
            let flips = star.iter().any(|&(t, _)| {
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
            for &(t, _) in &star {
                let corners = &mut self.triangles[t as usize];
                if corners.contains(&to) {
                    removed[t as usize] = true;
                } else {
                    *corners = corners.map(|x| if x == v { to } else { x });
                }
            }
            beside.merge(v, to);
            has_removed = true;
            if self.on_seam[to as usize].is_none() {
                self.on_seam[to as usize] = Some(of);
                near[to as usize] = Near { seam: of, distance: 0.0, source: to };
            }
            self.on_seam[v as usize] = None;
            near[v as usize] = Near::FAR;
        }
        has_removed
    }

    /// The triangles with a vertex within `blend` radii of a seam, each once.
    fn band(&self, beside: &Beside, near: &[Near], visited: &[u32], blend: f64, removed: &[bool]) -> Vec<u32> {
        let mut band = Vec::new();
        let mut is_in = vec![false; self.triangles.len()];
        for &v in visited.iter().filter(|&&v| near[v as usize].distance < blend) {
            beside.each(v, removed, |t| {
                if !std::mem::replace(&mut is_in[t as usize], true) {
                    band.push(t);
                }
            });
        }
        band
    }

    /// Splits long edges near the seam; returns whether there were any.
    fn split(
        &mut self,
        band: &mut Vec<u32>,
        near: &mut Vec<Near>,
        visited: &mut Vec<u32>,
        blend: f64,
        radii: &[f64],
        of_new: impl Fn(T) -> T,
    ) -> bool {
        let mut middles: FxHashMap<[u32; 2], u32> = FxHashMap::default();
        for &t in band.iter() {
            let corners = self.triangles[t as usize];
            for k in 0..3 {
                // in one of the two triangles of each edge, the lower vertex comes first
                let (a, b) = (corners[k], corners[(k + 1) % 3]);
                let (first, second) = (near[a as usize], near[b as usize]);
                // if both ends are within the blend, both triangles are in the band
                if a > b || !(first.distance < blend && second.distance < blend) {
                    continue;
                }
                let (nearer, farther, closer) =
                    if second.distance < first.distance { (b, a, second) } else { (a, b, first) };
                let (p, q) = (self.positions[a as usize], self.positions[b as usize]);
                let longest = LONGEST * blend * radii[closer.seam as usize];
                if closer.distance > DENSE * blend || p.distance_squared(q) <= longest * longest {
                    continue;
                }
                middles.insert([a, b], self.positions.len() as u32);
                let is_on_seam = self.on_seam[a as usize].is_some() && self.on_seam[b as usize].is_some();
                // a vertex on the seam may have the label of either side, one beside it only that of its own side
                let like = if self.on_seam[nearer as usize].is_some() { farther } else { nearer };
                visited.push(self.positions.len() as u32);
                self.positions.push((p + q) / 2.0);
                self.labels.push(of_new(self.labels[like as usize]));
                self.on_seam.push(is_on_seam.then_some(closer.seam));
                let distance = if is_on_seam { 0.0 } else { (first.distance + second.distance) / 2.0 };
                near.push(Near { distance, ..closer });
            }
        }
        if middles.is_empty() {
            return false;
        }
        let middle = |a: u32, b: u32| middles.get(&[a.min(b), a.max(b)]).copied();
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
                    // rotated so that the first edge is split and the last is not
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
    fn relax(&mut self, band: &[u32], near: &[Near], visited: &[u32], blend: f64) {
        // all triangles about a vertex that moves are in the band, and each adds one neighbour: the next vertex
        let mut number = vec![NONE; self.positions.len()];
        let mut moved: Vec<(u32, f64)> = Vec::with_capacity(visited.len());
        for &v in visited {
            let share = 1.0 - near[v as usize].distance / blend;
            if share > 0.0 {
                number[v as usize] = moved.len() as u32;
                moved.push((v, share * share * (3.0 - 2.0 * share)));
            }
        }
        // all vertices that do not move share one entry, which has no displacement
        let fixed = moved.len() as u32;
        let corners: Vec<[u32; 3]> =
            band.iter().map(|&t| self.triangles[t as usize].map(|v| number[v as usize].min(fixed))).collect();
        let next = corners.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]).filter(|&(v, _)| v < fixed);
        let (first, neighbours) = grouped(moved.len(), next);
        let mut means = vec![DVec3::ZERO; moved.len()];
        for (&t, numbers) in band.iter().zip(&corners) {
            let at = self.triangles[t as usize].map(|v| self.positions[v as usize]);
            for k in (0..3).filter(|&k| numbers[k] < fixed) {
                means[numbers[k] as usize] += at[(k + 1) % 3] - at[k];
            }
        }
        // the same origin for all volumes: the volume of an open band depends on it
        let origin = band.first().map_or(DVec3::ZERO, |&t| self.positions[self.triangles[t as usize][0] as usize]);
        let before = self.volume(band, origin);
        let count = |v: usize| (first[v + 1] - first[v]) as f32;
        // the initial vector to the mean of the neighbours, and the fraction of it to move
        let own: Vec<(Vec3A, f32)> = (means.iter().zip(&moved).enumerate())
            .map(|(v, (sum, (_, weight)))| (Vec3A::from(sum.as_vec3()) / count(v).max(1.0), (STEP * weight) as f32))
            .collect();
        let mut displaced = vec![Vec3A::ZERO; moved.len() + 1];
        let mut next = displaced.clone();
        for _ in 0..ROUNDS {
            for (v, &(to_mean, step)) in own.iter().enumerate() {
                let beside = &neighbours[first[v] as usize..first[v + 1] as usize];
                let sum = beside.iter().fold(Vec3A::ZERO, |sum, &other| sum + displaced[other as usize]);
                let at = displaced[v];
                next[v] = at + (sum / count(v).max(1.0) - at + to_mean) * step;
            }
            std::mem::swap(&mut displaced, &mut next);
        }
        for (&(v, _), by) in moved.iter().zip(&displaced) {
            self.positions[v as usize] += by.as_dvec3();
        }
        // the volume changes by the weighted area per unit of displacement along the normals
        for _ in 0..CORRECTIONS {
            let mut areas = means;
            areas.fill(DVec3::ZERO);
            let mut volume = 0.0;
            for (&t, numbers) in band.iter().zip(&corners) {
                let [a, b, c] = self.triangles[t as usize].map(|v| self.positions[v as usize] - origin);
                let area = (b - a).cross(c - a) / 6.0;
                volume += a.dot(area);
                for &v in numbers.iter().filter(|&&v| v < fixed) {
                    areas[v as usize] += area;
                }
            }
            let rate: f64 = areas.iter().zip(&moved).map(|(area, (_, weight))| weight * area.length()).sum();
            let by = (before - volume) / rate;
            if !by.is_finite() {
                break;
            }
            for (area, &(v, weight)) in areas.iter().zip(&moved) {
                self.positions[v as usize] += area.normalize_or_zero() * (by * weight);
            }
            means = areas;
        }
    }

    /// Signed volume between some triangles and a point [scene unit³].
    fn volume(&self, band: &[u32], origin: DVec3) -> f64 {
        signed_volume(band.iter().map(|&t| self.triangles[t as usize].map(|v| self.positions[v as usize] - origin)))
    }

    /// Removes vertices that no triangle has.
    fn compact(&mut self) {
        let mut number = vec![NONE; self.positions.len()];
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
    /// Each triangle about a vertex, and the vertex after that one in it. In a closed surface, these are all neighbours.
    around: Vec<(u32, u32)>,
    /// Linked list of the vertices merged into each vertex.
    merged: Vec<u32>,
}

impl Beside {
    fn new(vertices: usize, triangles: &[[u32; 3]]) -> Beside {
        let of_triangle = |(&[a, b, c], t): (&[u32; 3], u32)| [(a, (t, b)), (b, (t, c)), (c, (t, a))];
        let (first, around) = grouped(vertices, triangles.iter().zip(0..).flat_map(of_triangle));
        Beside { first, around, merged: vec![NONE; vertices] }
    }

    fn of(&self, v: u32) -> std::ops::Range<usize> {
        self.first[v as usize] as usize..self.first[v as usize + 1] as usize
    }

    /// The neighbours of a vertex before any merge.
    fn next(&self, v: u32) -> impl Iterator<Item = u32> {
        self.around[self.of(v)].iter().map(|&(_, next)| next)
    }

    /// Visits the triangles about a vertex and about those merged into it, except removed ones.
    fn each(&self, v: u32, removed: &[bool], mut call: impl FnMut(u32)) {
        let mut from = v;
        while from != NONE {
            self.around[self.of(from)].iter().filter(|&&(t, _)| !removed[t as usize]).for_each(|&(t, _)| call(t));
            from = self.merged[from as usize];
        }
    }

    /// Like [`Beside::each`], collecting each triangle with the vertex after `v` in it.
    fn star(&self, v: u32, triangles: &[[u32; 3]], removed: &[bool], star: &mut Vec<(u32, u32)>) {
        star.clear();
        self.each(v, removed, |t| {
            let corners = triangles[t as usize];
            let k = if corners[0] == v {
                1
            } else if corners[1] == v {
                2
            } else {
                0
            };
            star.push((t, corners[k]));
        });
    }

    /// Merges `v` into `to`, which takes over its triangles.
    fn merge(&mut self, v: u32, to: u32) {
        let mut last = to;
        while self.merged[last as usize] != NONE {
            last = self.merged[last as usize];
        }
        self.merged[last as usize] = v;
    }
}
