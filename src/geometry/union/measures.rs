//! Geometric measures of a pair of bodies: distance or depth, overlap, and neck.

use glam::DVec3;

use super::{
    Body, Budget, Seam, UnionError,
    distance::Tree,
    surface::{Origin, Union},
    union,
};

/// Geometric measures of a pair of bodies, independent of thresholds.
#[derive(Clone, Debug, PartialEq)]
pub struct PairMeasures {
    /// Smallest distance of the surfaces; where the bodies overlap, minus the greatest depth [scene unit].
    pub gap: f64,
    /// Volume of the intersection [scene unit³].
    pub overlap: f64,
    /// Radius of the circle that has the area of the seam's vector area [scene unit]; 0 without a seam.
    pub neck: f64,
    /// Length of the seam [scene unit].
    pub perimeter: f64,
    /// Where the surfaces meet; vertices are numbered as in the union of the two.
    pub seams: Vec<Seam>,
}

/// Measures two bodies.
///
/// The depth is the greatest distance of a sample point on either surface, inside the other body, to that body's
/// surface. Sample points are the vertices, the midpoints of edges and of what remains of cut edges, and the centres of
/// triangles. For bodies that intersect themselves, the distance is to the nearest sheet.
///
/// # Errors
///
/// Those of [`union`], from which the measures are computed.
pub fn pair_measures(a: &Body, b: &Body, budget: &Budget) -> Result<PairMeasures, UnionError> {
    let bodies = [a.clone(), b.clone()];
    measures_of(&union(&bodies, budget)?, budget)
}

/// [`pair_measures`] of two bodies whose union is known. A union of another number of bodies has an infinite gap.
///
/// # Errors
///
/// Those of [`union`], which measures each body that intersects itself.
pub fn measures_of(united: &Union, budget: &Budget) -> Result<PairMeasures, UnionError> {
    let bodies = united.bodies;
    let volume = |body: usize| -> Result<f64, UnionError> {
        if bodies[body].slack > 0.0 {
            return Ok(bodies[body].volume());
        }
        // Volume that is inside twice counts once.
        Ok(union(&bodies[body..=body], budget)?.volume)
    };
    let overlap = if bodies.len() != 2 {
        0.0
    } else if bodies.iter().all(|body| body.slack > 0.0) {
        united.taken
    } else {
        volume(0)? + volume(1)? - united.volume
    };
    let vector_area: DVec3 = united.seams.iter().map(|seam| seam.vector_area).sum();
    Ok(PairMeasures {
        gap: gap_of(united),
        overlap: overlap.max(0.0),
        neck: (vector_area.length() / std::f64::consts::PI).sqrt(),
        perimeter: united.seams.iter().map(|seam| seam.length).sum(),
        seams: united.seams.clone(),
    })
}

/// The gap alone: the smallest distance of two surfaces or minus the greatest depth [scene unit], as in
/// [`PairMeasures`].
///
/// # Errors
///
/// Those of [`union`].
pub fn gap(a: &Body, b: &Body, budget: &Budget) -> Result<f64, UnionError> {
    let bodies = [a.clone(), b.clone()];
    Ok(gap_of(&union(&bodies, budget)?))
}

fn gap_of(united: &Union) -> f64 {
    let [a, b] = united.bodies else { return f64::INFINITY };
    let trees = [Tree::new(a), Tree::new(b)];
    let is_apart = united.seams.is_empty() && (0..2).all(|body| !united.is_inside(body));
    if is_apart {
        return trees[0].distance(&trees[1]);
    }
    let mut deepest = 0.0f64;
    for (body, tree) in [(0, &trees[1]), (1, &trees[0])] {
        deepen(united, body, tree, &mut deepest);
    }
    -deepest
}

/// Raises `deepest` to the greatest depth in `other` of the part of a body's surface that the union leaves out.
fn deepen(united: &Union, body: usize, other: &Tree, deepest: &mut f64) {
    let mesh = &united.bodies[body];
    let topology = mesh.topology;
    let mut hint = 0;
    let mut sample = |at: DVec3| {
        if let Some(depth) = other.depth_beyond(at, *deepest, &mut hint) {
            *deepest = deepest.max(depth);
        }
    };
    let removed = &united.removed[body];
    // What is still on the union is not inside.
    let first = united.first_vertex[body];
    let mut kept: Vec<u32> = united.new_triangles.iter().flat_map(|triangle| triangle.corners).collect();
    kept.sort_unstable();
    kept.dedup();
    let is_lost = |v: u32| kept.binary_search(&(v + first)).is_err();
    // Vertices first: they find most of the depth, and what is known not to be deeper costs little.
    let mut vertices: Vec<u32> = removed.iter().flat_map(|&t| topology.triangles[t as usize]).collect();
    vertices.sort_unstable();
    vertices.dedup();
    vertices.iter().filter(|&&v| is_lost(v)).for_each(|&v| sample(mesh.position(v)));
    let mut edges: Vec<u32> = removed.iter().flat_map(|&t| topology.triangle_edges[t as usize]).collect();
    edges.sort_unstable();
    edges.dedup();
    for edge in edges {
        let ends = topology.edges[edge as usize];
        if ends.iter().all(|&v| is_lost(v)) {
            let [a, b] = ends.map(|v| mesh.position(v));
            sample((a + b) / 2.0);
        }
    }
    for &t in removed {
        let [a, b, c] = topology.triangles[t as usize].map(|v| mesh.position(v));
        sample((a + b + c) / 3.0);
    }
    // Between one cut of an edge and the next, or the edge's ends.
    let mut cuts: Vec<([u32; 2], f64)> = (united.new_vertices.iter())
        .filter_map(|vertex| match vertex.origin {
            Origin::Edge { body: of, edge, at, .. } if of as usize == body => Some((edge, at)),
            _ => None,
        })
        .collect();
    cuts.sort_by(|x, y| x.0.cmp(&y.0).then(x.1.total_cmp(&y.1)));
    for cuts in cuts.chunk_by(|x, y| x.0 == y.0) {
        let [a, b] = cuts[0].0.map(|v| mesh.positions[v as usize]);
        let mut from = 0.0;
        for to in cuts.iter().map(|cut| cut.1).chain([1.0]) {
            sample(a + (b - a) * ((from + to) / 2.0));
            from = to;
        }
    }
}
