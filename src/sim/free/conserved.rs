//! Momentum, angular momentum and energy.

use glam::{DMat3, DVec3};

use super::{
    body::Body,
    field::{Field, Pair},
};
use crate::model::energy::influence_potential;

/// Quantities that free bodies conserve without external forces, damping and changes of a pair's strength.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Conserved {
    /// Momentum Σ M c′ [mass · scene unit/s].
    pub momentum: DVec3,
    /// Angular momentum about the world origin [mass · scene unit²/s].
    pub angular_momentum: DVec3,
    /// Kinetic energy of the centres, Σ ½ M |c′|² [mass · scene unit²/s²].
    pub kinetic: f64,
    /// Energy of rigid rotation, Σ ½ S·Ω [mass · scene unit²/s²].
    pub spin: f64,
    /// Remainder of the kinetic energy Σ ½ m |r′|² [mass · scene unit²/s²].
    pub vibration: f64,
    /// Elastic energy, Σ ½ m ω² |x|² [mass · scene unit²/s²].
    pub elastic: f64,
    /// Energy of the influence, Σ m s (Φ − Φ(r_e)) [mass · scene unit²/s²]: zero for vertices that no sphere reaches, so
    /// pairs that are far apart contribute nothing.
    pub influence: f64,
    /// Gravitational energy, −Σ M g·c [mass · scene unit²/s²].
    pub gravity: f64,
    /// Energy of contacts with planes, Σ ½ m k d² [mass · scene unit²/s²].
    pub plane: f64,
}

impl Conserved {
    /// Total energy [mass · scene unit²/s²].
    pub fn energy(&self) -> f64 {
        self.kinetic + self.spin + self.vibration + self.elastic + self.influence + self.gravity + self.plane
    }

    /// The conserved quantities of bodies in their current state. Bodies on prescribed paths contribute only the energy
    /// of the influence between them and free bodies.
    pub fn of(bodies: &[&Body], pairs: &[Pair], field: &Field) -> Conserved {
        let mut sum = Conserved::default();
        for body in bodies.iter().filter(|body| body.is_free()) {
            let (shape, mass) = (&*body.shape, body.mass());
            sum.momentum += mass * body.velocity;
            sum.kinetic += 0.5 * mass * body.velocity.length_squared();
            sum.gravity -= mass * field.free_fall().dot(body.centre);
            let axes = DMat3::from_quat(body.rotation);
            let frame_spin = body.frame_spin();
            let (mut spin, mut own, mut elastic) = (DVec3::ZERO, 0.0, 0.0);
            for i in 0..shape.rest.len() {
                let (a, m) = (axes * shape.rest[i], shape.masses[i]);
                let (x, u) = body.state(i);
                let rate = frame_spin.cross(a) + u;
                spin += m * (a + x).cross(rate);
                own += 0.5 * m * rate.length_squared();
                elastic += m * x.length_squared();
                for plane in &field.planes {
                    sum.plane += m * plane.potential(plane.depth(body.centre + (a + x)));
                }
            }
            sum.angular_momentum += mass * body.centre.cross(body.velocity) + spin;
            let rigid = if body.turns() { 0.5 * spin.dot(body.inner(body.rotation).spin(spin)) } else { 0.0 };
            sum.spin += rigid;
            sum.vibration += own - rigid;
            sum.elastic += 0.5 * body.oscillator.omega * body.oscillator.omega * elastic;
        }
        for pair in pairs {
            let (a, b) = (bodies[pair.a as usize], bodies[pair.b as usize]);
            let q = a.centre.distance(b.centre) / (a.radius + b.radius);
            sum.influence += influence(a, b, field, pair.law.strength(pair.phase, q));
        }
        sum
    }
}

/// The energy of a pair's influence at a given strength [mass · scene unit²/s²].
pub(in crate::sim) fn influence(a: &Body, b: &Body, field: &Field, strength: f64) -> f64 {
    if strength == 0.0 || (!a.is_free() && !b.is_free()) {
        return 0.0;
    }
    // s Σ m (Φ − Φ(r_e)) over the vertices of one body in the sphere of the other: zero for those out of reach
    let of = |own: &Body, source: &Body| {
        let (axes, to_source, r_e) = (DMat3::from_quat(own.rotation), source.centre - own.centre, source.sphere_radius);
        let outside = influence_potential(field.weight, r_e, r_e);
        let vertices = (0..own.shape.rest.len()).map(|i| {
            let s = axes * own.shape.rest[i] + own.state(i).0;
            own.shape.masses[i] * (influence_potential(field.weight, r_e, (to_source - s).length()) - outside)
        });
        strength * (field.scale(own.radius, source.radius) * vertices.sum::<f64>())
    };
    of(a, b) + of(b, a)
}
