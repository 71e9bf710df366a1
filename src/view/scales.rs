//! Lengths of arrows.

use crate::{
    scene::{Body, Scene},
    sim::terms::free_fall,
    text::round_numbers,
};

/// Length per acceleration of net force arrows: about a radius for gravity or for a quarter of the strongest influence,
/// whichever is larger.
pub fn net_force_scale(scene: &Scene) -> f64 {
    let radius = largest_radius(scene);
    arrow_length(2.5 * radius, f64::max(free_fall(scene).length(), 0.25 * strongest_pull(scene, radius)))
}

/// Like [`net_force_scale`], for reactions: what acts on a heavy body accelerates a light one by up to the ratio
/// of their masses, by its root usually.
pub fn reaction_scale(scene: &Scene) -> f64 {
    let radius = largest_radius(scene);
    let heaviest = scene.bodies.iter().map(|body| body.mass).fold(0.0, f64::max);
    let free = scene.bodies.iter().filter(|body| body.path().is_none());
    let lightest = free.map(|body| body.mass).fold(heaviest, f64::min);
    arrow_length(2.5 * radius, 0.25 * strongest_pull(scene, radius) * (heaviest / lightest).sqrt())
        .min(net_force_scale(scene))
}

/// The largest radius of a body [scene unit].
pub fn largest_radius(scene: &Scene) -> f64 {
    scene.bodies.iter().map(|body| body.radius).fold(0.0, f64::max)
}

/// The strongest influence on any vertex [scene unit/s²], of the largest body, whose radius is given, and of force points.
pub fn strongest_pull(scene: &Scene, radius: f64) -> f64 {
    let pull = |strength: f64, sphere_radius: f64| strength.abs() * sphere_radius * scene.influence.weight.max_pull();
    let strength = scene.laws().map(|law| law.alpha.max(law.beta)).fold(0.0, f64::max);
    let points = scene.points.iter().map(|point| pull(point.strength, scene.influence.sphere_radius(point.radius)));
    let largest = scene.bodies.iter().filter(|body| body.radius == radius).map(Body::sphere_radius);
    points.fold(pull(strength, largest.fold(0.0, f64::max)), f64::max)
}

/// Length of an arrow per acceleration [scene unit per scene unit/s²]. The strongest influence or push on the largest
/// body gets an arrow of about 0.4 of its radius.
pub fn arrow_scale(scene: &Scene) -> f64 {
    let radius = largest_radius(scene);
    let pull = strongest_pull(scene, radius);
    arrow_length(radius, scene.pushes.iter().map(|push| push.strength.abs()).fold(pull, f64::max))
}

/// Like [`arrow_scale`], for the arrows of planes, which are far stronger than anything else in an impact: a vertex that
/// is a tenth of the largest radius behind the stiffest plane gets an arrow of about 0.4 of that radius. `None` without
/// planes.
pub fn plane_scale(scene: &Scene) -> Option<f64> {
    let radius = largest_radius(scene);
    let stiffest = scene.planes.iter().map(|plane| plane.stiffness).fold(0.0, f64::max);
    (stiffest > 0.0).then(|| arrow_length(radius, 0.1 * radius * stiffest).min(arrow_scale(scene)))
}

/// Arrow length per acceleration [scene unit per scene unit/s²]: 1, 2 or 5 times a power of ten, chosen so that the
/// arrow of the `strongest` acceleration [scene unit/s²] is about 0.4 `radius` long.
fn arrow_length(radius: f64, strongest: f64) -> f64 {
    let wanted = 0.4 * radius / strongest;
    if !(wanted.is_finite() && wanted > 0.0) {
        return 0.01;
    }
    let [least, two, five, _] = round_numbers(wanted);
    [five, two].into_iter().find(|length| *length <= wanted * 1.0001).unwrap_or(least)
}
