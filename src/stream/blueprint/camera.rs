//! Cameras of views in space.

use glam::{DQuat, DVec3};

use crate::geometry::bounds;
use crate::observe::Schema;
use crate::sdk::{
    blueprint::{archetypes::EyeControls3D, components::Eye3DKind},
    components::{Position3D, Vector3D},
};

/// Spheres (centre and radius) to keep in view, and the aspect ratio of the view.
pub type Framing<'a> = (&'a [(DVec3, f64)], f64);

/// How a scene stands before the camera.
#[derive(Clone, Copy, Debug, Default)]
pub struct Arrangement {
    /// Whether variants of the scene lie one behind the other.
    pub laid_out: bool,
    /// The rotation to axes in which z is up.
    pub upright: DQuat,
}

impl Arrangement {
    /// That of a scene.
    pub fn of(schema: &Schema) -> Arrangement {
        let depths: Vec<f64> = schema.variants.iter().map(|variant| (schema.upright() * variant.heading).y).collect();
        let rounding = 1e-9 * schema.largest_radius();
        let laid_out = depths.windows(2).any(|pair| (pair[0] - pair[1]).abs() > rounding);
        Arrangement { laid_out, upright: schema.upright() }
    }

    /// From these spheres, in upright axes, towards the eye, unless one hides another; normalized.
    fn usual_direction(self, spheres: &[(DVec3, f64)]) -> DVec3 {
        /// Where nothing else is better: slightly to one side and above.
        const USUAL: DVec3 = DVec3::new(-0.2, -1.0, 0.4);
        /// Arrangements lower than this are flat [smaller width].
        const FLAT: f64 = 0.35;

        // places of labels have no radius
        let [low, high] = bounds(spheres.iter().copied().filter(|(_, radius)| *radius > 0.0));
        let extent = high - low;
        let is_flat = self.laid_out || extent.z < FLAT * f64::min(extent.x, extent.y);
        if is_flat { USUAL.with_z(1.0) } else { USUAL }.normalize()
    }
}

/// The usual place of the eye before these spheres (centre and radius), and the direction from them towards it, normalized.
pub fn usual_eye(spheres: &[(DVec3, f64)], arrangement: Arrangement) -> [DVec3; 2] {
    let upright = arrangement.upright;
    let spheres: Vec<_> = spheres.iter().map(|&(centre, radius)| (upright * centre, radius)).collect();
    let back = arrangement.usual_direction(&spheres);
    let at = if spheres.is_empty() { back } else { eye(&spheres, back, WIDE) };
    [at, back].map(|vector| upright.conjugate() * vector)
}

/// Minimum aspect ratios of views in a 16:9 window.
pub const WIDE: f64 = 1.45;
pub const NARROW: f64 = 1.2;

/// A camera in front of the spheres (centre and radius), slightly to one side and above, with all of them in view.
/// Flat arrangements, and those that are `laid_out` on the ground, are viewed from higher up. Where possible, no sphere of
/// `others` hides one of `wanted`. `upright` rotates to axes in which z is up.
pub fn camera_past(
    spheres: &[(DVec3, f64)],
    wanted: &[(DVec3, f64)],
    others: &[(DVec3, f64)],
    aspect: f64,
    arrangement: Arrangement,
) -> EyeControls3D {
    let upright = arrangement.upright;
    let turned = [spheres, wanted, others].map(|spheres| -> Vec<(DVec3, f64)> {
        spheres.iter().map(|&(centre, radius)| (upright * centre, radius)).collect()
    });
    let [spheres, wanted, others] = turned.each_ref().map(Vec::as_slice);
    let [low, high] = bounds(spheres.iter().copied());
    let middle = 0.5 * (low + high);
    let first = arrangement.usual_direction(spheres);
    // all views look in the same direction
    let loss = |back| hidden(eye(spheres, back, WIDE), wanted, others) + foreshortening(wanted, back);
    let (mut best, mut least) = (first, loss(first));
    // a smaller gain does not justify turning away from the default direction
    const WORTH: f64 = 0.02;
    for height in [0.4, 0.9, 1.6, -0.3] {
        for twelfth in [0, 1, 11, 2, 10, 3, 9, 4, 8, 5, 7, 6] {
            if least <= WORTH {
                break;
            }
            let angle = std::f64::consts::TAU * f64::from(twelfth) / 12.0 - 0.2;
            let back = DVec3::new(angle.sin(), -angle.cos(), height).normalize();
            let here = loss(back);
            if here + WORTH < least {
                (best, least) = (back, here);
            }
        }
    }
    let (from, back) = (eye(spheres, best, aspect), best);
    let target = from - (from - middle).dot(back) * back;
    EyeControls3D::new()
        .with_kind(Eye3DKind::Orbital)
        .with_position(Position3D::from((upright.conjugate() * from).as_vec3()))
        .with_look_target(Position3D::from((upright.conjugate() * target).as_vec3()))
        .with_eye_up(Vector3D::from((upright.conjugate() * DVec3::Z).as_vec3()))
}

/// The nearest eye position from which a camera that looks against direction `back` has all spheres in view.
fn eye(spheres: &[(DVec3, f64)], back: DVec3, aspect: f64) -> DVec3 {
    /// Half the viewer's vertical field of view, 55°.
    const HALF_HEIGHT: f64 = 0.5205;
    /// Free margin on either side [half heights of the view].
    const MARGIN: f64 = 0.04;

    let right = DVec3::Z.cross(back).normalize();
    let up = back.cross(right);
    // the planes of the view frustum that face each other touch a sphere each, and meet at the eye
    let fit = |sideways: DVec3, half: f64| {
        let slant = half.hypot(1.0);
        let reach = |sideways: DVec3| {
            let of = |&(centre, radius): &(DVec3, f64)| centre.dot(sideways) + half * centre.dot(back) + radius * slant;
            spheres.iter().map(of).fold(f64::NEG_INFINITY, f64::max)
        };
        let [one, other] = [reach(sideways), reach(-sideways)];
        (0.5 * (one - other), 0.5 * (one + other) / half)
    };
    let (x, of_width) = fit(right, (aspect - MARGIN) * HALF_HEIGHT);
    let (y, of_height) = fit(up, (1.0 - MARGIN) * HALF_HEIGHT);
    x * right + y * up + f64::max(of_width, of_height) * back
}

/// How much of the cosine between the axis of a pair of spheres and the direction towards the eye is too much: the seam
/// of a pair is seen from the side.
fn foreshortening(pair: &[(DVec3, f64)], back: DVec3) -> f64 {
    /// The largest cosine at which the axis is seen well.
    const MOST: f64 = 0.35;

    let [(one, _), (other, _)] = pair else { return 0.0 };
    ((*other - *one).normalize_or_zero().dot(back).abs() - MOST).max(0.0)
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
