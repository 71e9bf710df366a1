//! Checks that triangles are the surface of a body: closed, manifold, consistently oriented, outward.

use std::{
    collections::{HashMap, hash_map::Entry},
    f64::consts::TAU,
};

use glam::DVec3;
use rustc_hash::FxBuildHasher;

use super::Soup;
use crate::{
    disjoint_sets::DisjointSets,
    geometry::{
        mesh::solid_angle,
        union::{Aabb, Budget, self_contact},
    },
};

/// Work limit of the search for self-contact: per triangle, and at least. A sphere takes 10 to 20 per triangle.
const WORK: [u64; 2] = [60, 30_000_000];

/// Why triangles are not the surface of a body. Positions are those of the file.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Flaw {
    /// There are no triangles.
    #[error("it has no triangles")]
    Empty,
    /// A coordinate is not finite or too large.
    #[error("vertex {vertex} (counted from 0) is at {position}: coordinates must be numbers up to 1e15")]
    NotFinite {
        /// Index of the vertex in the file.
        vertex: usize,
        /// Position of the vertex.
        position: DVec3,
    },
    /// Edges of one triangle only.
    #[error(
        "it is not closed: at {count} of its edges there is one triangle only, the first from {from} to {to}; fill its holes"
    )]
    Open {
        /// Number of such edges.
        count: usize,
        /// One end of the first …
        from: DVec3,
        /// … and the other end.
        to: DVec3,
    },
    /// Edges of two triangles that run along them in the same direction.
    #[error(
        "its triangles are not consistently oriented: at {count} of its edges one is inside out, the first from {from} to {to}; make \
             normals consistent"
    )]
    Inconsistent {
        /// Number of such edges.
        count: usize,
        /// One end of the first …
        from: DVec3,
        /// … and the other end.
        to: DVec3,
    },
    /// Edges of more than two triangles.
    #[error(
        "it touches itself: at {count} of its edges more than two triangles meet, the first from {from} to {to}; separate \
         the parts that meet there, or merge them"
    )]
    Crowded {
        /// Number of such edges.
        count: usize,
        /// One end of the first …
        from: DVec3,
        /// … and the other end.
        to: DVec3,
    },
    /// Vertices at which parts of the surface meet without a common edge.
    #[error(
        "it touches itself at {count} of its vertices, the first at {position}; separate the parts that meet there"
    )]
    Pinched {
        /// Number of such vertices.
        count: usize,
        /// Position of the first.
        position: DVec3,
    },
    /// Vertices whose triangles have no area.
    #[error("the triangles about {count} of its vertices have no area, the first at {position}; remove such vertices")]
    Massless {
        /// Number of such vertices.
        count: usize,
        /// Position of the first.
        position: DVec3,
    },
    /// Triangles that meet without being neighbours.
    #[error(
        "it crosses or touches itself: the triangles about {first} and {second} meet there; separate the parts, or merge them"
    )]
    Meets {
        /// Centre of one triangle …
        first: DVec3,
        /// … and of the other.
        second: DVec3,
    },
    /// A separate piece is inside another without being its cavity, or inside out on its own.
    #[error(
        "its separate piece at {position} is inside another and not a cavity of that, or inside out: flip its normals, or \
         remove it"
    )]
    Nested {
        /// A vertex of the piece.
        position: DVec3,
    },
    /// Too many triangles are near each other.
    #[error("its {triangles} triangles are too close to each other to check whether they cross; simplify it")]
    Tangled {
        /// Number of triangles of the mesh.
        triangles: usize,
    },
    /// The triangles enclose nothing.
    #[error("it encloses no volume: it is flat, or a part of it is inside out")]
    Flat,
    /// The triangles are oriented inwards.
    #[error("it is inside out: it encloses a volume of {volume:.3e}; flip its normals")]
    InsideOut {
        /// The signed volume.
        volume: f64,
    },
}

/// The surface with vertices at equal positions welded, without the triangles that this collapses, and without unused
/// vertices. `watch` is called with the fraction done, from 0 to 1.
///
/// # Errors
/// The triangles are not the surface of a body.
pub fn closed(soup: Soup, watch: &dyn Fn(f64)) -> Result<Soup, Flaw> {
    let soup = welded(soup)?;
    watch(0.2);
    check_edges(&soup)?;
    watch(0.4);
    let mut areas = vec![0.0; soup.positions.len()];
    let mut volume = 0.0;
    let origin = soup.positions.first().copied().ok_or(Flaw::Empty)?;
    for &corners in &soup.triangles {
        let [a, b, c] = corners.map(|corner| soup.positions[corner as usize] - origin);
        let area = (b - a).cross(c - a).length();
        corners.iter().for_each(|&corner| areas[corner as usize] += area);
        volume += a.dot(b.cross(c)) / 6.0;
    }
    let massless = || (0..areas.len()).filter(|&vertex| !(areas[vertex] > 0.0));
    if let Some(first) = massless().next() {
        return Err(Flaw::Massless { count: massless().count(), position: soup.positions[first] });
    }
    if volume == 0.0 {
        return Err(Flaw::Flat);
    }
    if !(volume > 0.0) {
        return Err(Flaw::InsideOut { volume });
    }
    let Soup { positions, triangles } = &soup;
    let budget = Budget { work: WORK[1].max(WORK[0] * triangles.len() as u64), ..Budget::default() };
    match self_contact(positions, triangles, &budget, &|share| watch(0.4 + 0.6 * share)) {
        Ok(None) => Ok(soup),
        Ok(Some(two)) => {
            let middle = |t: u32| {
                let corners = triangles[t as usize].map(|corner| positions[corner as usize] / 3.0);
                corners.into_iter().sum()
            };
            Err(Flaw::Meets { first: middle(two[0]), second: middle(two[1]) })
        }
        Err(_) => Err(Flaw::Tangled { triangles: triangles.len() }),
    }
}

/// Checks, apart from [`closed`], that no part of space is enclosed twice: a piece inside another is a cavity, one inside that is solid again. Of a
/// surface with very many pieces, this is not known, and no flaw.
pub fn check_nesting(soup: &Soup) -> Result<(), Flaw> {
    /// Upper limit on the work [comparisons with a box]: less than a second.
    const MOST: u64 = 1 << 28;
    /// The solid angle of a triangle takes as long as so many comparisons.
    const ANGLE: u64 = 16;

    let Soup { positions, triangles } = soup;
    let mut sets = DisjointSets::singletons(positions.len());
    for &[a, b, c] in triangles {
        sets.join(a, b);
        sets.join(a, c);
    }
    if sets.count == 1 {
        return Ok(());
    }
    let corners = |t: u32| triangles[t as usize].map(|corner| positions[corner as usize]);
    let mut order: Vec<u32> = (0..triangles.len() as u32).collect();
    order.sort_by_key(|&t| sets.least(triangles[t as usize][0]));
    let pieces: Vec<&[u32]> =
        order.chunk_by(|&s, &t| sets.least(triangles[s as usize][0]) == sets.least(triangles[t as usize][0])).collect();
    let bounds: Vec<Aabb> = pieces.iter().map(|piece| Aabb::of(piece.iter().flat_map(|&t| corners(t)))).collect();
    let mut work = 0;
    for (index, own) in pieces.iter().enumerate() {
        let [at, ..] = corners(own[0]);
        let volume =
            own.iter().map(|&t| corners(t).map(|corner| corner - at)).map(|[a, b, c]| a.dot(b.cross(c))).sum::<f64>();
        let mut around = 0.0;
        work += pieces.len() as u64;
        for (_, (_, piece)) in
            bounds.iter().zip(&pieces).enumerate().filter(|(other, (bounds, _))| *other != index && bounds.contains(at))
        {
            work += ANGLE * piece.len() as u64;
            if work > MOST {
                return Ok(());
            }
            let angles = piece.iter().map(|&t| solid_angle(corners(t).map(|corner| corner - at)));
            around += angles.sum::<f64>() / (2.0 * TAU);
        }
        if work > MOST {
            return Ok(());
        }
        if around.round() != if volume > 0.0 { 0.0 } else { 1.0 } {
            return Err(Flaw::Nested { position: at });
        }
    }
    Ok(())
}

fn welded(soup: Soup) -> Result<Soup, Flaw> {
    let mut index_of = vec![u32::MAX; soup.positions.len()];
    let mut known: HashMap<[u64; 3], u32, FxBuildHasher> = HashMap::default();
    let mut welded = Soup::default();
    for corners in soup.triangles {
        let mut triangle = [0; 3];
        for (index, corner) in triangle.iter_mut().zip(corners) {
            let vertex = corner as usize;
            if index_of[vertex] == u32::MAX {
                let position = soup.positions[vertex] + DVec3::ZERO; // −0 is 0
                if !(position.abs().max_element() <= 1e15 && position.is_finite()) {
                    return Err(Flaw::NotFinite { vertex, position });
                }
                index_of[vertex] = match known.entry(position.to_array().map(f64::to_bits)) {
                    Entry::Occupied(known) => *known.get(),
                    Entry::Vacant(new) => {
                        welded.positions.push(position);
                        *new.insert(welded.positions.len() as u32 - 1)
                    }
                };
            }
            *index = index_of[vertex];
        }
        let [a, b, c] = triangle;
        if a != b && b != c && c != a {
            welded.triangles.push(triangle);
        }
    }
    // drop vertices that have lost all their triangles
    let mut number = vec![u32::MAX; welded.positions.len()];
    let mut kept = Soup::default();
    for triangle in &welded.triangles {
        kept.triangles.push(triangle.map(|corner| {
            let number = &mut number[corner as usize];
            if *number == u32::MAX {
                kept.positions.push(welded.positions[corner as usize]);
                *number = kept.positions.len() as u32 - 1;
            }
            *number
        }));
    }
    if kept.triangles.is_empty() { Err(Flaw::Empty) } else { Ok(kept) }
}

/// A side of a triangle: its ends, lower first, and its triangle.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Side {
    ends: [u32; 2],
    /// Index of the triangle times four, plus the corner that it begins at.
    from: u32,
    is_forward: bool,
}

fn check_edges(soup: &Soup) -> Result<(), Flaw> {
    let mut sides = Vec::with_capacity(3 * soup.triangles.len());
    for (index, triangle) in (0..).zip(&soup.triangles) {
        for corner in 0..3 {
            let (from, to) = (triangle[corner], triangle[(corner + 1) % 3]);
            let ends = [from.min(to), from.max(to)];
            sides.push(Side { ends, from: 4 * index + corner as u32, is_forward: from < to });
        }
    }
    sides.sort_unstable();
    let (mut open, mut inconsistent, mut crowded) = ((0, None), (0, None), (0, None));
    // for each side, by triangle and corner, the opposite side in the other triangle
    let mut across = vec![u32::MAX; 4 * soup.triangles.len()];
    for edge in sides.chunk_by(|a, b| a.ends == b.ends) {
        let found = match edge {
            [a, b] if a.is_forward != b.is_forward => {
                (across[a.from as usize], across[b.from as usize]) = (b.from, a.from);
                continue;
            }
            [_] => &mut open,
            [_, _] => &mut inconsistent,
            _ => &mut crowded,
        };
        found.0 += 1;
        found.1.get_or_insert(edge[0].ends.map(|end| soup.positions[end as usize]));
    }
    drop(sides);
    if let (count, Some([from, to])) = open {
        return Err(Flaw::Open { count, from, to });
    }
    if let (count, Some([from, to])) = crowded {
        return Err(Flaw::Crowded { count, from, to });
    }
    if let (count, Some([from, to])) = inconsistent {
        return Err(Flaw::Inconsistent { count, from, to });
    }

    // a walk around each vertex, from triangle to triangle, must reach all of its triangles
    let mut valence = vec![0_u32; soup.positions.len()];
    let mut some = vec![u32::MAX; soup.positions.len()];
    for (index, triangle) in (0..).zip(&soup.triangles) {
        for (corner, &vertex) in (0..).zip(triangle) {
            valence[vertex as usize] += 1;
            some[vertex as usize] = 4 * index + corner;
        }
    }
    let mut pinched = (0, None);
    for (vertex, (&first, &count)) in some.iter().zip(&valence).enumerate() {
        let (mut side, mut round) = (first, 0);
        loop {
            round += 1;
            // the previous side of the triangle ends at the vertex; its opposite side begins there
            let before = 4 * (side / 4) + (side % 4 + 2) % 3;
            side = across[before as usize];
            if side == first || round > count {
                break;
            }
        }
        if round != count {
            pinched.0 += 1;
            pinched.1.get_or_insert(soup.positions[vertex]);
        }
    }
    match pinched {
        (count, Some(position)) => Err(Flaw::Pinched { count, position }),
        _ => Ok(()),
    }
}
