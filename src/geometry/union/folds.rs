//! Where a body may intersect itself.
//!
//! Seen from a point about which its winding number is 1, a closed surface shows its inner side once more than its outer
//! side in every direction. Where two parts of the surface meet, they lie in the same direction, so at least one triangle
//! there shows its outer side: a body intersects itself only in the directions of such triangles. A body that is dented
//! or drawn out has a few of them; one without any does not intersect itself, as [`Body`]'s slack tells.

use glam::DVec3;

use super::body::Body;

/// Number of directions in which the winding number is tried.
const DIRECTIONS: usize = 8;
/// Most triangles that may show their outer side, or nearly so. With more, everything is suspected.
const MOST_TURNED: usize = 64;
/// Smallest cosine of the angle of a cone.
const WIDEST: f64 = 0.05;
/// Bound on rounding in the comparison of cones.
const ROUNDING: f64 = 1e-7;

/// A cone about directions from the centre.
#[derive(Clone, Copy)]
struct Cone {
    axis: DVec3,
    cosine: f64,
    sine: f64,
}

impl Cone {
    /// A cone that contains these unit vectors, and so everything between them if it is narrower than a half-space.
    fn about(directions: [DVec3; 3]) -> Cone {
        let axis = (directions[0] + directions[1] + directions[2]).normalize_or_zero();
        let cosine = directions.iter().map(|direction| axis.dot(*direction)).fold(1.0, f64::min);
        Cone { axis, cosine, sine: (1.0 - cosine * cosine).max(0.0).sqrt() }
    }

    /// Whether two cones meet if each is wider by half of a small angle.
    #[inline]
    fn meets(&self, other: &Cone, margin: f64) -> bool {
        self.axis.dot(other.axis) + margin >= self.cosine * other.cosine - self.sine * other.sine
    }
}

/// The triangles that may intersect others of the same body, `[triangle_count]`, if every vertex is displaced by at most
/// `displaced` [scene unit]; `None` if these may be all. For a connected body. If none of these triangles meet, the body
/// encloses its centre, with its outer side outwards.
pub fn suspects(body: &Body, displaced: f64) -> Option<Vec<bool>> {
    let topology = body.topology;
    if topology.components.len() != 1 || !(1e-30..1e30).contains(&body.radius) {
        return None;
    }
    let at: Vec<DVec3> = (0..topology.fan_count() as u32).map(|v| body.position(v) - body.centre).collect();
    // as in `Body::slack`
    let least = 6.0 * body.radius * displaced;
    let mut nearest = f64::INFINITY;
    let (mut turned, mut is_turned) = (Vec::new(), vec![false; topology.triangles.len()]);
    for (corners, t) in topology.triangles.iter().zip(0u32..) {
        let [a, b, c] = corners.map(|v| at[v as usize]);
        nearest = nearest.min(a.length_squared()).min(b.length_squared()).min(c.length_squared());
        let (ab, bc, ca) = (b - a, c - b, a - c);
        let volume = a.dot(ab.cross(-ca));
        let longest = ab.length_squared().max(bc.length_squared()).max(ca.length_squared());
        if !(volume > 0.0 && volume * volume > least * least * longest) {
            turned.push(t);
            is_turned[t as usize] = true;
        }
    }
    // directions change by at most twice the displacement over the distance, for each of two cones
    let margin = 8.0 * displaced / nearest.sqrt() + ROUNDING;
    if turned.len() > MOST_TURNED
        || margin.is_nan()
        || margin > 1e-3
        || winding(body, &at, &is_turned, displaced) != Some(1)
    {
        return None;
    }
    let directions: Vec<DVec3> = at.iter().map(|at| at.normalize_or_zero()).collect();
    let cone = |t: u32| Cone::about(topology.triangles[t as usize].map(|v| directions[v as usize]));
    let turned: Vec<Cone> = turned.into_iter().map(cone).collect();
    if turned.iter().any(|cone| cone.cosine < WIDEST) {
        return None; // it may contain the centre
    }
    let is_suspect = |t: u32| {
        let cone = cone(t);
        cone.cosine < WIDEST || turned.iter().any(|turned| turned.meets(&cone, margin))
    };
    Some((0..topology.triangles.len() as u32).map(is_suspect).collect())
}

/// The winding number about the centre: the signed count of triangles in a direction in which displacements and rounding
/// do not matter. `None` if none of those tried is such a direction.
fn winding(body: &Body, at: &[DVec3], is_turned: &[bool], displaced: f64) -> Option<i32> {
    let triangles = &body.topology.triangles;
    let of = |direction: DVec3| {
        let bound = direction.length() * body.radius * (4.0 * displaced + 1e-13 * body.radius);
        let mut winding = 0;
        for (corners, &is_turned) in triangles.iter().zip(is_turned) {
            let [a, b, c] = corners.map(|v| at[v as usize]);
            let beside = [a.cross(b), b.cross(c), c.cross(a)].map(|normal| direction.dot(normal));
            if beside.iter().any(|&side| side > bound) && beside.iter().any(|&side| side < -bound) {
                continue;
            }
            if is_turned {
                return None;
            }
            // seen from its inner side: either in this direction, in the opposite one, or undecided
            if beside.iter().all(|&side| side > bound) {
                winding += 1;
            } else if !beside.iter().all(|&side| side < -bound) {
                return None;
            }
        }
        Some(winding)
    };
    let step = triangles.len().div_ceil(DIRECTIONS).max(1);
    let straight = (0..triangles.len()).filter(|&t| !is_turned[t]);
    straight.step_by(step).find_map(|t| {
        let [a, b, c] = triangles[t].map(|v| at[v as usize]);
        of(a + b + c)
    })
}
