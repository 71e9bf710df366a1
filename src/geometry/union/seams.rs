//! Seams: the curves along which the surfaces of two bodies meet on a union.

use glam::DVec3;

/// A line along which the surfaces of two bodies meet.
#[derive(Clone, Debug, PartialEq)]
pub struct Seam {
    /// The two bodies, ascending.
    pub bodies: [u32; 2],
    /// Vertices along the seam, numbered as in [`super::Union::first_vertex`]; on the first body's surface the union is on the
    /// left.
    pub vertices: Vec<u32>,
    /// Whether the seam returns to its first vertex. A seam that ends on a third body does not.
    pub is_closed: bool,
    /// Length of the seam [scene unit].
    pub length: f64,
    /// Vector area of a closed seam [scene unit²]: that of any surface bounded by it. For a flat loop it is the area
    /// times the normal, towards the side of the first body.
    pub vector_area: DVec3,
}

/// Joins edges between vertices at `position` [scene unit] into seams.
pub(super) fn seams(position: impl Fn(u32) -> DVec3, mut edges: Vec<([u32; 2], u32, u32)>) -> Vec<Seam> {
    edges.sort_unstable();
    let mut seams = Vec::new();
    for pair in edges.chunk_by(|a, b| a.0 == b.0) {
        let mut used = vec![false; pair.len()];
        let mut arrivals: Vec<u32> = pair.iter().map(|e| e.2).collect();
        arrivals.sort_unstable();
        // open seams first, from their starts; the remaining ones are closed
        let has_beginning = |e: &([u32; 2], u32, u32)| arrivals.binary_search(&e.1).is_err();
        let starts = (0..pair.len()).filter(|&i| has_beginning(&pair[i])).chain(0..pair.len());
        for start in starts {
            if used[start] {
                continue;
            }
            let mut vertices = Vec::new();
            let mut at = start;
            let last = loop {
                used[at] = true;
                vertices.push(pair[at].1);
                let next = pair.partition_point(|e| e.1 < pair[at].2);
                let next = (next..pair.len()).take_while(|&i| pair[i].1 == pair[at].2).find(|&i| !used[i]);
                match next {
                    Some(next) => at = next,
                    None => break pair[at].2,
                }
            };
            let is_closed = last == vertices[0];
            if !is_closed {
                vertices.push(last);
            }
            seams.push(measured(&position, pair[0].0, vertices, is_closed));
        }
    }
    seams
}

fn measured(position: &impl Fn(u32) -> DVec3, bodies: [u32; 2], vertices: Vec<u32>, is_closed: bool) -> Seam {
    let origin = position(vertices[0]);
    let (mut length, mut vector_area) = (0.0, DVec3::ZERO);
    let mut from = DVec3::ZERO;
    let closing = is_closed.then_some(vertices[0]);
    for &v in vertices[1..].iter().chain(&closing) {
        let to = position(v) - origin;
        length += from.distance(to);
        vector_area += 0.5 * from.cross(to);
        from = to;
    }
    Seam { bodies, vertices, is_closed, length, vector_area: if is_closed { vector_area } else { DVec3::ZERO } }
}
