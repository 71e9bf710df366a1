//! Triangulates a planar region given by directed lines, which have the region on their left.
//!
//! The result is closed for any coordinates: every line is an edge of exactly one triangle, every other edge of exactly
//! two. Coordinates affect only the quality of the triangles.

use std::{cell::RefCell, mem::take};

use glam::{DVec2, DVec3};
use rustc_hash::FxHashSet;

/// Corners of triangles from this number on are added points; those below are given points.
pub const ADDED: u32 = 1 << 31;

/// Up to this many points are searched linearly.
const FEW: usize = 24;

/// The region to triangulate, with buffers.
#[derive(Default)]
pub struct Region {
    /// Directed lines, from point to point, with the region on their left.
    pub pieces: Vec<[u32; 2]>,
    /// Points and the straight lines on which they lie. Points on a common line are not joined, because the region on
    /// the line's other side could join them, too.
    pub lines: Vec<(u32, u32)>,
    /// The points' names, ascending; below, points are numbered by their index here.
    names: Vec<u32>,
    /// The lines of each point as bits, if there are few enough lines; otherwise empty, and `first_line` is used.
    lines_as_bits: Vec<u64>,
    first_line: Vec<u32>,
    flat: Vec<DVec2>,
    /// Loop i is `looped[first_of_loop[i]..first_of_loop[i + 1]]`.
    looped: Vec<u32>,
    first_of_loop: Vec<u32>,
    pieces_by_index: Vec<[u32; 2]>,
    used: Vec<bool>,
    /// The first piece that starts at each point or a later one.
    first_from: Vec<u32>,
    scratch: RefCell<Ears>,
}

/// Buffers of ear clipping.
#[derive(Default)]
struct Ears {
    points: Vec<u32>,
    is_met: Vec<bool>,
    qualities: Vec<Option<f64>>,
}

/// Triangles of a region.
#[derive(Default)]
pub struct Filling {
    /// Names of points, or [`ADDED`] and above.
    pub triangles: Vec<[u32; 3]>,
    /// Points added where no triangulation without them was found, each as the mean of the listed points.
    pub added: Vec<Vec<u32>>,
}

/// Twice the area of a triangle, > 0 if counter-clockwise.
#[inline]
fn turn(a: DVec2, b: DVec2, c: DVec2) -> f64 {
    (b - a).perp_dot(c - a)
}

/// A monotonic function of a direction's angle, in [0, 4).
fn pseudo_angle(d: DVec2) -> f64 {
    let r = d.x / (d.x.abs() + d.y.abs()).max(f64::MIN_POSITIVE);
    if d.y < 0.0 { 3.0 + r } else { 1.0 - r }
}

impl Region {
    /// Triangulates the region in a plane with this `normal`. `None` if the lines do not form loops.
    pub fn fill(&mut self, normal: DVec3, position: impl Fn(u32) -> DVec3, filling: &mut Filling) -> Option<()> {
        self.list_points();
        // project along the axis nearest to the normal
        let axis = normal.abs().max_position();
        let (mut x, mut y) = ((axis + 1) % 3, (axis + 2) % 3);
        if normal[axis] < 0.0 {
            std::mem::swap(&mut x, &mut y);
        }
        self.flat.clear();
        self.flat.extend(self.names.iter().map(|&name| {
            let p = position(name);
            DVec2::new(p[x], p[y])
        }));
        self.trace()?;
        self.fill_loops(filling);
        Some(())
    }

    /// Numbers the points, and lists their lines.
    fn list_points(&mut self) {
        self.names.clear();
        self.first_line.clear();
        self.lines_as_bits.clear();
        let has_bits = self.lines.iter().all(|line| line.1 < u64::BITS);
        if has_bits && self.lines.len() <= FEW {
            // nearly all triangles are cut by one or two lines
            for &(name, line) in &self.lines {
                let index = self.names.iter().position(|&known| known >= name).unwrap_or(self.names.len());
                if self.names.get(index) != Some(&name) {
                    self.names.insert(index, name);
                    self.lines_as_bits.insert(index, 0);
                }
                self.lines_as_bits[index] |= 1 << line;
            }
            return;
        }
        self.lines.sort_unstable();
        self.lines.dedup();
        for (i, line) in self.lines.iter().enumerate() {
            if self.names.last() != Some(&line.0) {
                self.names.push(line.0);
                self.first_line.push(i as u32);
                if has_bits {
                    self.lines_as_bits.push(0);
                }
            }
            if let Some(bits) = self.lines_as_bits.last_mut() {
                *bits |= 1 << line.1;
            }
        }
        self.first_line.push(self.lines.len() as u32);
    }

    fn index_of(&self, name: u32) -> Option<u32> {
        if self.names.len() <= FEW {
            return self.names.iter().position(|&known| known == name).map(|i| i as u32);
        }
        self.names.binary_search(&name).ok().map(|i| i as u32)
    }

    fn at(&self, point: u32) -> DVec2 {
        self.flat[point as usize]
    }

    fn share_a_line(&self, a: u32, b: u32) -> bool {
        if !self.lines_as_bits.is_empty() {
            return self.lines_as_bits[a as usize] & self.lines_as_bits[b as usize] != 0;
        }
        let lines =
            |p: u32| &self.lines[self.first_line[p as usize] as usize..self.first_line[p as usize + 1] as usize];
        lines(a).iter().any(|x| lines(b).iter().any(|y| x.1 == y.1))
    }

    /// Joins the pieces into loops. Where several pieces leave a point, choosing the narrowest sector keeps regions
    /// apart.
    fn trace(&mut self) -> Option<()> {
        let (mut pieces, mut used) = (take(&mut self.pieces_by_index), take(&mut self.used));
        pieces.clear();
        for &[from, to] in &self.pieces {
            pieces.push([self.index_of(from)?, self.index_of(to)?]);
        }
        pieces.sort_unstable();
        used.clear();
        used.resize(pieces.len(), false);
        let mut first_from = take(&mut self.first_from);
        first_from.clear();
        for (k, piece) in pieces.iter().enumerate() {
            first_from.resize(piece[0] as usize + 1, k as u32);
        }
        first_from.resize(self.names.len() + 1, pieces.len() as u32);
        self.looped.clear();
        self.first_of_loop.clear();
        for start in 0..pieces.len() {
            if used[start] {
                continue;
            }
            self.first_of_loop.push(self.looped.len() as u32);
            let mut k = start;
            loop {
                used[k] = true;
                let [from, at] = pieces[k];
                self.looped.push(from);
                let [first, end] = [at as usize, at as usize + 1].map(|at| first_from[at] as usize);
                let count = end - first;
                let may_follow = |&next: &usize| !used[next] || next == start;
                if count == 1 {
                    k = Some(first).filter(may_follow)?;
                    if k == start {
                        break;
                    }
                    continue;
                }
                let back = pseudo_angle(self.at(from) - self.at(at));
                let mut best: Option<(f64, usize)> = None;
                for next in (first..first + count).filter(may_follow) {
                    let mut sector = back - pseudo_angle(self.at(pieces[next][1]) - self.at(at));
                    if sector <= 0.0 {
                        sector += 4.0;
                    }
                    if best.is_none_or(|b| sector < b.0) {
                        best = Some((sector, next));
                    }
                }
                k = best?.1;
                if k == start {
                    break;
                }
            }
        }
        self.first_of_loop.push(self.looped.len() as u32);
        (self.pieces_by_index, self.used, self.first_from) = (pieces, used, first_from);
        Some(())
    }

    fn fill_loops(&self, filling: &mut Filling) {
        if self.first_of_loop.len() <= 2 {
            self.clip_ears(&self.looped, &mut None, filling);
            return;
        }
        let loops = self.first_of_loop.windows(2).map(|ends| &self.looped[ends[0] as usize..ends[1] as usize]);
        let (mut outer, mut holes): (Vec<Vec<u32>>, Vec<Vec<u32>>) =
            loops.map(<[u32]>::to_vec).partition(|points| self.area(points) >= 0.0);
        if outer.is_empty() {
            std::mem::swap(&mut outer, &mut holes);
        }
        // from the right, so that each hole is connected to a loop that is already connected
        holes.sort_by(|a, b| {
            let right = |points: &[u32]| points.iter().map(|&p| self.at(p).x).fold(f64::NEG_INFINITY, f64::max);
            right(b).total_cmp(&right(a))
        });
        for hole in holes {
            self.bridge(&hole, &mut outer);
        }
        let mut edges = FxHashSet::default();
        for points in &outer {
            for k in 0..points.len() {
                edges.insert(undirected(points[k], points[(k + 1) % points.len()]));
            }
        }
        let mut edges = Some(edges);
        for points in outer {
            self.clip_ears(&points, &mut edges, filling);
        }
    }

    fn area(&self, points: &[u32]) -> f64 {
        let origin = self.at(points[0]);
        (0..points.len()).map(|k| turn(origin, self.at(points[k]), self.at(points[(k + 1) % points.len()]))).sum()
    }

    fn is_inside(&self, point: DVec2, points: &[u32]) -> bool {
        let mut inside = false;
        for k in 0..points.len() {
            let (a, b) = (self.at(points[k]), self.at(points[(k + 1) % points.len()]));
            if (a.y > point.y) != (b.y > point.y) && point.x < (b.x - a.x) * (point.y - a.y) / (b.y - a.y) + a.x {
                inside = !inside;
            }
        }
        inside
    }

    /// Connects a hole to the loop around it, by a bridge to the nearest visible point.
    fn bridge(&self, hole: &[u32], outer: &mut [Vec<u32>]) {
        let from = (0..hole.len()).max_by(|&a, &b| self.at(hole[a]).x.total_cmp(&self.at(hole[b]).x)).unwrap_or(0);
        let start = self.at(hole[from]);
        let around = (0..outer.len())
            .filter(|&o| self.is_inside(start, &outer[o]))
            .min_by(|&a, &b| self.area(&outer[a]).total_cmp(&self.area(&outer[b])))
            .unwrap_or(0);
        let points = &outer[around];
        let mut order: Vec<usize> = (0..points.len()).collect();
        order.sort_by(|&a, &b| {
            let distance = |k: usize| self.at(points[k]).distance_squared(start);
            distance(a).total_cmp(&distance(b)).then(a.cmp(&b))
        });
        let may_join = |k: usize| !self.share_a_line(points[k], hole[from]);
        let is_in_sight = |k: usize| {
            let end = self.at(points[k]);
            let blocks = |points: &[u32], to: u32| {
                (0..points.len()).any(|m| {
                    let (a, b) = (points[m], points[(m + 1) % points.len()]);
                    if a == to || b == to || a == hole[from] || b == hole[from] {
                        return false;
                    }
                    let (a, b) = (self.at(a), self.at(b));
                    turn(start, end, a) * turn(start, end, b) < 0.0 && turn(a, b, start) * turn(a, b, end) < 0.0
                })
            };
            let (before, after) =
                (self.at(points[(k + points.len() - 1) % points.len()]), self.at(points[(k + 1) % points.len()]));
            let (left_of_in, left_of_out) = (turn(before, end, start) >= 0.0, turn(end, after, start) >= 0.0);
            let opens =
                if turn(before, end, after) >= 0.0 { left_of_in && left_of_out } else { left_of_in || left_of_out };
            opens && may_join(k) && !blocks(points, points[k]) && !blocks(hole, points[k])
        };
        let to = (order.iter().copied().find(|&k| is_in_sight(k)))
            .or_else(|| order.iter().copied().find(|&k| may_join(k)))
            .unwrap_or(order[0]);
        let mut bridged = points[..=to].to_vec();
        bridged.extend((0..=hole.len()).map(|k| hole[(from + k) % hole.len()]));
        bridged.extend_from_slice(&points[to..]);
        outer[around] = bridged;
    }

    /// Clips the best ear repeatedly. `edges` are the edges in use, needed for loops in which points occur more than
    /// once; in a simple loop no edge can repeat.
    fn clip_ears(&self, points: &[u32], edges: &mut Option<FxHashSet<[u32; 2]>>, filling: &mut Filling) {
        let scratch = &mut *self.scratch.borrow_mut();
        let Ears { points: left, is_met, qualities } = scratch;
        left.clear();
        left.extend_from_slice(points);
        let points = left;
        qualities.clear();
        if edges.is_none() && points.len() > 3 {
            is_met.clear();
            is_met.resize(self.names.len(), false);
            if points.iter().any(|&p| std::mem::replace(&mut is_met[p as usize], true)) {
                let all = 0..points.len();
                *edges = Some(all.map(|k| undirected(points[k], points[(k + 1) % points.len()])).collect());
            }
        }
        let name = |p: u32| self.names[p as usize];
        while points.len() > 3 {
            let n = points.len();
            if qualities.is_empty() {
                qualities.extend((0..n).map(|k| self.quality(points, k, edges)));
            }
            let best = |qualities: &[Option<f64>]| {
                let mut best: Option<(f64, usize)> = None;
                for (k, quality) in qualities.iter().enumerate() {
                    if let Some(quality) = *quality
                        && best.is_none_or(|b| quality > b.0)
                    {
                        best = Some((quality, k));
                    }
                }
                best
            };
            let mut ear = best(qualities);
            if ear.is_none_or(|e| e.0 <= 0.0) {
                // obstacles may be gone by now
                qualities.clear();
                qualities.extend((0..n).map(|k| self.quality(points, k, edges)));
                ear = best(qualities);
            }
            let Some((_, k)) = ear else {
                self.fan_out(points, filling);
                return;
            };
            let (before, after) = (points[(k + n - 1) % n], points[(k + 1) % n]);
            if edges.as_ref().is_some_and(|edges| edges.contains(&undirected(before, after))) {
                // the edge has been used elsewhere since
                qualities[k] = None;
                continue;
            }
            filling.triangles.push([name(before), name(points[k]), name(after)]);
            if let Some(edges) = edges {
                edges.insert(undirected(before, after));
            }
            points.remove(k);
            qualities.remove(k);
            let n = points.len();
            if n > 3 {
                for k in [(k + n - 1) % n, k % n] {
                    qualities[k] = self.quality(points, k, edges);
                }
            }
        }
        if let [a, b, c] = points[..] {
            filling.triangles.push([name(a), name(b), name(c)]);
        }
    }

    /// Quality of the triangle from clipping a corner, in (0, √3/6]; reduced by 1, and so ≤ 0, if it is inverted or
    /// contains a point; `None` if its new edge is not allowed.
    fn quality(&self, points: &[u32], k: usize, edges: &Option<FxHashSet<[u32; 2]>>) -> Option<f64> {
        let n = points.len();
        let [a, b, c] = [points[(k + n - 1) % n], points[k], points[(k + 1) % n]];
        let is_used = || edges.as_ref().is_some_and(|edges| edges.contains(&undirected(a, c)));
        if a == c || a == b || b == c || self.share_a_line(a, c) || is_used() {
            return None;
        }
        let [pa, pb, pc] = [a, b, c].map(|p| self.at(p));
        let area = turn(pa, pb, pc);
        let sides = pa.distance_squared(pb) + pb.distance_squared(pc) + pc.distance_squared(pa);
        let quality = area / sides.max(f64::MIN_POSITIVE);
        let is_in = |p: DVec2| turn(pa, pb, p) >= 0.0 && turn(pb, pc, p) >= 0.0 && turn(pc, pa, p) >= 0.0;
        let is_free = area > 0.0 && !points.iter().any(|&p| p != a && p != b && p != c && is_in(self.at(p)));
        Some(if is_free { quality } else { quality - 1.0 })
    }

    /// Triangulates a loop without an admissible ear: triangles about a new point or, with points that occur more than
    /// once, about a ring of new points.
    fn fan_out(&self, points: &[u32], filling: &mut Filling) {
        let name = |p: u32| self.names[p as usize];
        let n = points.len();
        let centre = ADDED + filling.added.len() as u32;
        filling.added.push(points.iter().map(|&p| name(p)).collect());
        let repeats = (0..n).any(|k| points[..k].contains(&points[k]));
        if repeats {
            for &point in points {
                // halfway to the centre
                let mut mean: Vec<u32> = points.iter().map(|&p| name(p)).collect();
                mean.extend(std::iter::repeat_n(name(point), n));
                filling.added.push(mean);
            }
        }
        for k in 0..n {
            let (a, b) = (name(points[k]), name(points[(k + 1) % n]));
            if repeats {
                let (inner_a, inner_b) = (centre + 1 + k as u32, centre + 1 + ((k + 1) % n) as u32);
                filling.triangles.extend([[a, b, inner_b], [a, inner_b, inner_a], [centre, inner_a, inner_b]]);
            } else {
                filling.triangles.push([centre, a, b]);
            }
        }
    }
}

fn undirected(a: u32, b: u32) -> [u32; 2] {
    [a.min(b), a.max(b)]
}
