//! What geometry says of a pair of bodies: how far apart or how deep in each other, by how much, and with what neck.

use glam::DVec3;

use super::{
    Body, Budget, Seam, UnionError,
    distance::Tree,
    surface::{Origin, Union},
    union,
};

/// What geometry says of a pair of bodies, beside what thresholds say.
#[derive(Clone, Debug, PartialEq)]
pub struct PairMeasures {
    /// Least distance of the surfaces; where the bodies overlap, minus the greatest depth [scene unit].
    pub gap: f64,
    /// Volume of the intersection [scene unit³].
    pub overlap: f64,
    /// Radius of the circle whose area is the seam's vector area [scene unit]: 0 where there is no seam.
    pub neck: f64,
    /// Length of the seam [scene unit].
    pub perimeter: f64,
    /// Where the surfaces meet, with vertices numbered as in the union of the two.
    pub seams: Vec<Seam>,
}

/// Measures two bodies.
///
/// The depth is the greatest distance of a point of either surface, inside the other body, to that body's surface, among
/// the vertices, the middles of edges and of what is left of cut ones, and the centres of triangles; of bodies that
/// intersect themselves, to whichever sheet is nearest.
///
/// # Errors
///
/// Those of [`union`], which it is computed from.
pub fn pair_measures(a: &Body, b: &Body, budget: &Budget) -> Result<PairMeasures, UnionError> {
    let bodies = [a.clone(), b.clone()];
    let united = union(&bodies, budget)?;
    let volume = |body: usize| -> Result<f64, UnionError> {
        if bodies[body].slack > 0.0 {
            return Ok(bodies[body].volume());
        }
        // What is inside twice counts once.
        Ok(union(&bodies[body..=body], budget)?.volume)
    };
    let overlap =
        if bodies.iter().all(|body| body.slack > 0.0) { united.taken } else { volume(0)? + volume(1)? - united.volume };
    let vector_area: DVec3 = united.seams.iter().map(|seam| seam.vector_area).sum();
    Ok(PairMeasures {
        gap: gap_of(&united),
        overlap: overlap.max(0.0),
        neck: (vector_area.length() / std::f64::consts::PI).sqrt(),
        perimeter: united.seams.iter().map(|seam| seam.length).sum(),
        seams: united.seams,
    })
}

/// The gap alone: the least distance of two surfaces or minus the greatest depth [scene unit], as in [`PairMeasures`].
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

/// Raises `deepest` to the greatest depth in `other` of what the union leaves out of a body's surface.
fn deepen(united: &Union, body: usize, other: &Tree, deepest: &mut f64) {
    let mesh = &united.bodies[body];
    // From one point to another the depth changes by no more than their distance.
    let mut last: Option<(DVec3, f64)> = None;
    let mut sample = |at: DVec3| {
        if last.is_none_or(|(other, depth)| depth + other.distance(at) > *deepest) {
            let depth = other.depth(at);
            last = Some((at, depth));
            *deepest = deepest.max(depth);
        }
    };
    for &t in &united.removed[body] {
        let [a, b, c] = mesh.topology.triangles[t as usize].map(|v| mesh.position(v));
        [a, b, c, (a + b) / 2.0, (b + c) / 2.0, (c + a) / 2.0, (a + b + c) / 3.0].into_iter().for_each(&mut sample);
    }
    // Between what cuts an edge and what cuts it next, or its ends.
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
