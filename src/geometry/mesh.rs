//! A rest shape: a closed triangle mesh, centred at its mass centre.

use glam::DVec3;

use super::{facets::Facets, vectors::Vectors};

/// A closed triangle mesh, shared by all bodies of a shape at any radius: lengths are in radii, the origin is the
/// centre of mass, and the farthest vertex is at distance 1. [`Rest`] is the mesh at the scale of a body.
#[derive(Clone, Debug, PartialEq)]
pub struct Mesh {
    /// Rest positions [radii], `[vertex_count]`.
    positions: Vectors,
    /// Directions l/|l| of the rest positions [–], zero for a vertex at the centre; `None` if they equal the positions.
    directions: Option<Vectors>,
    /// Outward unit normals [–]; `None` if they equal the positions.
    normals: Option<Vectors>,
    /// Vertex indices, counter-clockwise seen from outside, `[triangle_count]`.
    triangles: Vec<[u32; 3]>,
    /// Fraction of the body's mass at each vertex [–], `[vertex_count]`; the sum is 1.
    shares: Vec<f64>,
    /// How it is drawn, if its faces are flat.
    facets: Option<Facets>,
}

/// Solid angle of a triangle seen from the origin [sr]; positive if the origin is behind it. Van Oosterom and Strackee:
/// *The Solid Angle of a Plane Triangle* (1983).
pub fn solid_angle([a, b, c]: [DVec3; 3]) -> f64 {
    let (la, lb, lc) = (a.length(), b.length(), c.length());
    2.0 * libm::atan2(a.dot(b.cross(c)), la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb)
}

/// The volume of a closed mesh, given the corners of its triangles, counter-clockwise seen from outside; of an open one that
/// between it and the origin [cubed unit of the corners].
pub fn signed_volume(corners: impl Iterator<Item = [DVec3; 3]>) -> f64 {
    corners.map(|[a, b, c]| a.dot(b.cross(c)) / 6.0).sum()
}

/// [`signed_volume`] of a mesh with these positions.
pub fn signed_volume_of(positions: &Vectors, triangles: &[[u32; 3]]) -> f64 {
    signed_volume(triangles.iter().map(|corners| corners.map(|corner| positions.get(corner as usize))))
}

impl Mesh {
    /// A general mesh, shifted to its centre of mass and scaled so that its farthest vertex is at distance 1.
    ///
    /// `triangles` are indices into `positions` [any unit], counter-clockwise seen from outside, and form a closed
    /// surface. Whether they do is checked where the mesh is used; one with an index beyond the positions weighs nothing.
    pub fn new(positions: Vectors, triangles: Vec<[u32; 3]>) -> Mesh {
        let shares = shares(&positions, &triangles);
        let centre: DVec3 = positions.iter().zip(&shares).map(|(position, share)| *share * position).sum();
        let farthest = positions.iter().map(|position| position.distance(centre)).fold(0.0, f64::max);
        let scale = if farthest > 0.0 { 1.0 / farthest } else { 1.0 };
        let positions: Vectors = positions.iter().map(|position| (position - centre) * scale).collect();
        let directions = positions.iter().map(DVec3::normalize_or_zero).collect();
        let normals = Some(normals(&positions, &triangles, &mut Vec::new()).collect());
        Mesh { positions, directions: Some(directions), normals, triangles, shares, facets: None }
    }

    /// The mesh of a body after it has torn, in the axes and unit of its first mesh [radii]: vertices are not moved or
    /// scaled. It need not be closed, and the origin need not be its centre of mass.
    pub fn version(positions: Vectors, triangles: Vec<[u32; 3]>) -> Mesh {
        let shares = shares(&positions, &triangles);
        let directions = positions.iter().map(DVec3::normalize_or_zero).collect();
        let normals = Some(normals(&positions, &triangles, &mut Vec::new()).collect());
        Mesh { positions, directions: Some(directions), normals, triangles, shares, facets: None }
    }

    /// A mesh whose vertices are all at distance 1 from its centre of mass and have their direction as normal, to
    /// rounding.
    pub fn round(directions: Vectors, triangles: Vec<[u32; 3]>) -> Mesh {
        let shares = shares(&directions, &triangles);
        Mesh { positions: directions, directions: None, normals: None, triangles, shares, facets: None }
    }

    /// The mesh with flat faces and sharp edges, instead of being drawn as a smooth surface. Nothing else changes. Not for
    /// bodies that tear.
    pub fn faceted(self) -> Mesh {
        let facets = Some(Facets::new(self.vertex_count(), &self.triangles));
        Mesh { facets, ..self }
    }

    /// How it is drawn, if its faces are flat.
    pub fn facets(&self) -> Option<&Facets> {
        self.facets.as_ref()
    }

    /// Its triangles as they are drawn: of its vertices and, if its faces are flat, their copies.
    pub fn drawn_triangles(&self) -> &[[u32; 3]] {
        self.facets.as_ref().map_or(&self.triangles, Facets::triangles)
    }

    /// Number of vertices that are drawn, with copies.
    pub fn drawn_vertex_count(&self) -> usize {
        self.vertex_count() + self.facets.as_ref().map_or(0, Facets::copy_count)
    }

    /// Number of vertices.
    pub fn vertex_count(&self) -> usize {
        self.positions.len()
    }

    /// Rest positions [radii], `[vertex_count]`.
    pub fn positions(&self) -> &Vectors {
        &self.positions
    }

    /// Directions l̂ = l/|l| of the rest positions [–], `[vertex_count]`; zero for a vertex at the centre.
    pub fn directions(&self) -> &Vectors {
        self.directions.as_ref().unwrap_or(&self.positions)
    }

    /// Outward unit normals at rest [–], `[vertex_count]`: area-weighted means of the triangles' normals.
    pub fn normals(&self) -> &Vectors {
        self.normals.as_ref().unwrap_or(&self.positions)
    }

    /// Vertex indices of each triangle, counter-clockwise seen from outside, `[triangle_count]`.
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    /// Fraction of the body's mass at each vertex [–], `[vertex_count]`: a third of the area of its triangles over the
    /// total area. The sum is 1.
    pub fn shares(&self) -> &[f64] {
        &self.shares
    }

    /// Whether every rest position is at distance 1 radius from the centre, to rounding: directions are then the
    /// positions over the radius, and need no lengths.
    pub fn is_round(&self) -> bool {
        self.directions.is_none()
    }

    /// Whether the surface encloses the centre: whether the solid angles of its triangles, seen from there, add up to a
    /// full turn.
    pub fn encloses_centre(&self) -> bool {
        let angle = |corners: &[u32; 3]| solid_angle(corners.map(|i| self.positions.get(i as usize)));
        self.is_round() || self.triangles.iter().map(angle).sum::<f64>() > std::f64::consts::TAU
    }

    /// The mesh at the scale of a body of the given radius [scene unit].
    pub fn at(&self, radius: f64) -> Rest<'_> {
        Rest { mesh: self, radius }
    }
}

/// A mesh at the scale of a body.
#[derive(Clone, Copy, Debug)]
pub struct Rest<'a> {
    /// The shape.
    pub mesh: &'a Mesh,
    /// Distance of its farthest vertex from the centre [scene unit].
    pub radius: f64,
}

impl Rest<'_> {
    /// Number of vertices.
    pub fn len(self) -> usize {
        self.mesh.vertex_count()
    }

    /// Whether there are no vertices.
    pub fn is_empty(self) -> bool {
        self.len() == 0
    }

    /// Rest position l of vertex `i`, from the centre [scene unit]; panics if out of range.
    #[inline]
    pub fn position(self, i: usize) -> DVec3 {
        self.radius * self.mesh.positions.get(i)
    }

    /// Direction l̂ of the rest position of vertex `i` [–]; panics if out of range.
    #[inline]
    pub fn direction(self, i: usize) -> DVec3 {
        self.mesh.directions().get(i)
    }
}

/// The normal of a triangle, with twice its area as length.
fn doubled_area([a, b, c]: [DVec3; 3]) -> DVec3 {
    (b - a).cross(c - a)
}

/// The triangles whose vertices all exist.
fn within(triangles: &[[u32; 3]], vertex_count: usize) -> impl Iterator<Item = &[u32; 3]> {
    triangles.iter().filter(move |corners| corners.iter().all(|&i| (i as usize) < vertex_count))
}

/// For each vertex, a third of the area of its triangles over the total area; equal fractions if the total is zero.
fn shares(positions: &Vectors, triangles: &[[u32; 3]]) -> Vec<f64> {
    let mut shares = vec![0.0; positions.len()];
    let mut total = 0.0;
    for corners in within(triangles, positions.len()) {
        let area = doubled_area(corners.map(|i| positions.get(i as usize))).length();
        corners.iter().for_each(|&i| shares[i as usize] += area);
        total += 3.0 * area;
    }
    if total > 0.0 {
        shares.iter_mut().for_each(|share| *share /= total);
    } else {
        let equal = 1.0 / shares.len().max(1) as f64;
        shares.fill(equal);
    }
    shares
}

/// Writes the area-weighted sum of the normals of each vertex's triangles to `sums` (reused).
pub fn sum_normals(positions: &Vectors, triangles: &[[u32; 3]], sums: &mut Vec<DVec3>) {
    sums.clear();
    sums.resize(positions.len(), DVec3::ZERO);
    for corners in within(triangles, positions.len()) {
        // Loops over the three, which the compiler keeps in memory, would take three times as long.
        let [a, b, c] = corners.map(|i| i as usize);
        let area = doubled_area([positions.get(a), positions.get(b), positions.get(c)]);
        sums[a] += area;
        sums[b] += area;
        sums[c] += area;
    }
}

/// For each vertex, the normalised, area-weighted sum of its triangles' normals; where these cancel, the direction from
/// the centre. `sums` is scratch storage.
fn normals(positions: &Vectors, triangles: &[[u32; 3]], sums: &mut Vec<DVec3>) -> impl ExactSizeIterator<Item = DVec3> {
    sum_normals(positions, triangles, sums);
    let unit =
        |(sum, position): (&DVec3, DVec3)| sum.try_normalize().unwrap_or_else(|| position.normalize_or(DVec3::Z));
    sums.iter().zip(positions.iter()).map(unit)
}

/// Whether triangles of a mesh hide a point, which may be the given one of its vertices, from an eye.
pub fn hides(positions: &Vectors, triangles: &[[u32; 3]], (point, vertex): (DVec3, Option<u32>), eye: DVec3) -> bool {
    within(triangles, positions.len())
        .filter(|corners| vertex.is_none_or(|vertex| !corners.contains(&vertex)))
        .any(|corners| place_of_crossing(positions, *corners, point, eye - point).is_some_and(|place| place < 1.0))
}

/// Whether a point is inside a closed mesh: a ray from it crosses an odd number of triangles.
pub fn encloses(positions: &Vectors, triangles: &[[u32; 3]], point: DVec3) -> bool {
    let crossings = within(triangles, positions.len());
    crossings.filter(|&&corners| place_of_crossing(positions, corners, point, ASKEW).is_some()).count() % 2 == 1
}

/// A direction that meets no edge of a mesh with symmetries.
const ASKEW: DVec3 = DVec3::new(0.5570, 0.7417, 0.3736);

/// Where a ray crosses a triangle, in lengths of `way`.
fn place_of_crossing(positions: &Vectors, corners: [u32; 3], from: DVec3, way: DVec3) -> Option<f64> {
    // Möller & Trumbore, Fast, minimum storage ray/triangle intersection, 1997
    let [a, b, c] = corners.map(|corner| positions.get(corner as usize));
    let (ab, ac, to) = (b - a, c - a, from - a);
    let (p, q) = (way.cross(ac), to.cross(ab));
    let determinant = ab.dot(p);
    let [u, v, t] = [to.dot(p), way.dot(q), ac.dot(q)].map(|part| part / determinant);
    (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0).then_some(t)
}

/// Appends the smooth unit normals of a deformed mesh in single precision: for each vertex, the normalised, area-weighted
/// sum of its triangles' normals; where these cancel, the direction from the origin. `sums` is scratch storage.
pub fn append_normals(
    positions: &Vectors,
    triangles: &[[u32; 3]],
    sums: &mut Vec<DVec3>,
    appended: &mut Vec<[f32; 3]>,
) {
    appended.extend(normals(positions, triangles, sums).map(|normal| normal.as_vec3().to_array()));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Shape, shape::Solid as _};

    #[test]
    fn a_closed_mesh_encloses_its_inside() {
        for kind in Shape::KINDS {
            let defaults: Vec<u32> = kind.parameters.iter().map(|parameter| parameter.default).collect();
            let mesh = (kind.make)(&defaults).mesh();
            let positions = mesh.positions();
            let place = |i: usize| {
                let angle = 2.4 * i as f64;
                DVec3::new(libm::sin(angle), libm::cos(angle), libm::sin(0.7 * angle)).normalize()
            };
            for at in (0..200).map(place).chain(positions.iter()) {
                assert!(encloses(positions, mesh.triangles(), 0.3 * at), "{} {at}", kind.name);
                assert!(!encloses(positions, mesh.triangles(), 1.8 * at), "{} {at}", kind.name);
            }
        }
    }

    #[test]
    fn every_shape_is_closed_oriented_outwards_and_centred() {
        for kind in Shape::KINDS {
            let defaults: Vec<u32> = kind.parameters.iter().map(|parameter| parameter.default).collect();
            let least: Vec<u32> = kind.parameters.iter().map(|parameter| parameter.least).collect();
            for shape in [defaults, least].map(|values| (kind.make)(&values)) {
                let mesh = shape.mesh();
                assert_eq!(mesh.vertex_count() as u64, shape.vertex_count());
                assert_eq!(mesh.triangles().len() as u64, shape.triangle_count());
                let mut edges = std::collections::HashSet::new();
                let mut volume = 0.0;
                for &[a, b, c] in mesh.triangles() {
                    let [p, q, r] = [a, b, c].map(|i| mesh.positions().get(i as usize));
                    volume += p.cross(q).dot(r) / 6.0;
                    for edge in [(a, b), (b, c), (c, a)] {
                        assert!(edges.insert(edge), "{shape:?}: edge {edge:?} runs twice the same way");
                    }
                }
                assert!(edges.iter().all(|&(a, b)| edges.contains(&(b, a))), "{shape:?}: a hole");
                assert!(volume > 0.0, "{shape:?} is inside out");
                let farthest = mesh.positions().iter().map(DVec3::length).fold(0.0, f64::max);
                assert!((farthest - 1.0).abs() < 1e-15, "{shape:?}: {farthest}");
                let centre: DVec3 = mesh.positions().iter().zip(mesh.shares()).map(|(p, m)| p * *m).sum();
                assert!(centre.length() < 1e-12, "{shape:?}: {centre}");
                assert!((mesh.shares().iter().sum::<f64>() - 1.0).abs() < 1e-12);
                for (i, direction) in mesh.directions().iter().enumerate() {
                    let position = mesh.positions().get(i);
                    assert!(position.length() == 0.0 || direction.distance(position.normalize()) < 1e-15);
                    assert!((mesh.normals().get(i).length() - 1.0).abs() < 1e-15);
                }
            }
        }
    }

    #[test]
    fn any_mesh_is_moved_to_its_centre_and_scaled() {
        let corners = [DVec3::new(4.0, 0.0, 0.0), DVec3::new(4.0, 3.0, 0.0), DVec3::new(4.0, 0.0, 5.0), DVec3::X];
        let mesh = Mesh::new(corners.into_iter().collect(), vec![[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]);
        let centre: DVec3 = mesh.positions().iter().zip(mesh.shares()).map(|(p, m)| p * *m).sum();
        assert!(centre.length() < 1e-15);
        assert!((mesh.positions().iter().map(DVec3::length).fold(0.0, f64::max) - 1.0).abs() < 1e-15);
        assert!(!mesh.is_round());
    }

    #[test]
    fn a_shape_is_built_once() {
        let [a, b] = [Shape::default(), Shape::default()].map(|shape| shape.mesh());
        assert!(std::sync::Arc::ptr_eq(&a, &b));
    }

    #[test]
    fn degenerate_triangles_have_unit_normals() {
        let mesh = crate::geometry::Sphere { stacks: 4, slices: 6 }.mesh();
        for size in [0.0, 1e-200, 1e-30, 1e200] {
            let positions: Vectors = mesh.positions().iter().map(|v| v * size).collect();
            let mut normals = Vec::new();
            append_normals(&positions, mesh.triangles(), &mut Vec::new(), &mut normals);
            assert_eq!(normals.len(), positions.len());
            for normal in normals {
                let length = DVec3::from_array(normal.map(f64::from)).length();
                assert!((length - 1.0).abs() < 1e-6, "{size}: {normal:?}");
            }
        }
    }

    /// A sphere built as a general mesh has the same normals and masses, up to the coarseness of its triangles.
    #[test]
    fn a_sphere_is_round() {
        let round = crate::geometry::Sphere { stacks: 40, slices: 80 }.mesh();
        let any = Mesh::new(round.positions().clone(), round.triangles().to_vec());
        for i in 0..round.vertex_count() {
            assert!(round.positions().get(i).distance(any.positions().get(i)) < 1e-12);
            assert!(round.normals().get(i).distance(any.normals().get(i)) < 3e-2);
            assert!((round.shares()[i] - any.shares()[i]).abs() < 1e-15);
        }
    }
}
