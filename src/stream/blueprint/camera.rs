//! Cameras of views in space.

use glam::DVec3;

use crate::geometry::bounds;
use crate::sdk::{
    blueprint::{archetypes::EyeControls3D, components::Eye3DKind},
    components::{Position3D, Vector3D},
};

/// Spheres (centre and radius) to keep in view, and the aspect ratio of the view.
pub type Framing<'a> = (&'a [(DVec3, f64)], f64);

/// Minimum aspect ratios of views in a 16:9 window.
pub const WIDE: f64 = 1.45;
pub const NARROW: f64 = 1.2;

/// A camera in front of the spheres (centre and radius), slightly to one side and above, with all of them in view.
/// Flat arrangements, and those that are `laid_out` on the ground, are viewed from higher up. Where possible, no sphere of
/// `others` hides one of `wanted`.
pub fn camera_past(
    spheres: &[(DVec3, f64)],
    wanted: &[(DVec3, f64)],
    others: &[(DVec3, f64)],
    (aspect, laid_out): (f64, bool),
) -> EyeControls3D {
    let [low, high] = bounds(spheres.iter().copied());
    let (middle, extent) = (0.5 * (low + high), high - low);
    let is_flat = laid_out || extent.z < 0.2 * f64::min(extent.x, extent.y);
    let first = DVec3::new(-0.2, -1.0, if is_flat { 1.0 } else { 0.4 }).normalize(); // towards the eye
    let mut best = (eye(spheres, middle, first, aspect), hidden(eye(spheres, middle, first, aspect), wanted, others));
    // a smaller gain does not justify turning away from the default direction
    const WORTH: f64 = 0.02;
    for height in [0.4, 0.9, 1.6, -0.3] {
        for twelfth in [0, 1, 11, 2, 10, 3, 9, 4, 8, 5, 7, 6] {
            if best.1 <= WORTH {
                break;
            }
            let angle = std::f64::consts::TAU * f64::from(twelfth) / 12.0 - 0.2;
            let back = DVec3::new(angle.sin(), -angle.cos(), height).normalize();
            let from = eye(spheres, middle, back, aspect);
            let hidden = hidden(from, wanted, others);
            if hidden + WORTH < best.1 {
                best = (from, hidden);
            }
        }
    }
    EyeControls3D::new()
        .with_kind(Eye3DKind::Orbital)
        .with_position(Position3D::from(best.0.as_vec3()))
        .with_look_target(Position3D::from(middle.as_vec3()))
        .with_eye_up(Vector3D::from(glam::Vec3::Z))
}

/// The nearest eye position in direction `back` from the middle that has all spheres in view.
fn eye(spheres: &[(DVec3, f64)], middle: DVec3, back: DVec3, aspect: f64) -> DVec3 {
    /// Half the viewer's vertical field of view, 55°.
    const HALF_HEIGHT: f64 = 0.5205;
    /// Free margin on either side [half heights of the view].
    const MARGIN: f64 = 0.02;

    let half_width = (aspect - MARGIN) * HALF_HEIGHT;
    let right = DVec3::Z.cross(back).normalize();
    let up = back.cross(right);
    // The distance at which a sphere at `centre` just fits between the planes of the view frustum.
    let distance = |centre: DVec3, radius: f64| {
        let offset = centre - middle;
        let fits = |sideways: f64, half: f64| (sideways.abs() + radius * half.hypot(1.0)) / half;
        offset.dot(back) + f64::max(fits(offset.dot(right), half_width), fits(offset.dot(up), HALF_HEIGHT))
    };
    middle + back * spheres.iter().map(|&(centre, radius)| distance(centre, radius)).fold(0.0, f64::max)
}

/// How much `others` hide the spheres `wanted` from an eye; 0 if not at all. Each other sphere counts by its overlap as
/// a fraction of the smaller one's width.
fn hidden(eye: DVec3, wanted: &[(DVec3, f64)], others: &[(DVec3, f64)]) -> f64 {
    let mut sum = 0.0;
    for &(centre, radius) in wanted {
        let distance = eye.distance(centre);
        let towards = (centre - eye) / distance;
        for &(other, other_radius) in others {
            let depth = (other - eye).dot(towards);
            if depth <= -other_radius || depth >= distance {
                continue;
            }
            // apparent half width of the wanted sphere at the depth of the other
            let width = radius * (depth / distance).max(0.0);
            let apart = (other - eye - depth * towards).length();
            sum += ((other_radius + width - apart) / (2.0 * f64::min(other_radius, width))).clamp(0.0, 1.0);
        }
    }
    sum
}
