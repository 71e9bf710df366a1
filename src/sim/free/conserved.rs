//! Momentum, angular momentum and energy.

use glam::{DMat3, DVec3};

use super::{
    body::Body,
    field::{Field, Pair},
};
use crate::model::energy::influence_potential;

/// What free bodies keep where nothing from outside acts, nothing damps, and no pair changes its strength.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Conserved {
    /// Σ M c′ [mass · scene unit/s].
    pub momentum: DVec3,
    /// About the world's origin [mass · scene unit²/s].
    pub angular_momentum: DVec3,
    /// Energies, all in [mass · scene unit²/s²]: Σ ½ M |c′|² …
    pub kinetic: f64,
    /// … Σ ½ S·Ω, of rigid rotation …
    pub spin: f64,
    /// … what is left of Σ ½ m |r′|² …
    pub vibration: f64,
    /// … Σ ½ m ω² |x|² …
    pub elastic: f64,
    /// … Σ m s Φ …
    pub influence: f64,
    /// … −Σ M g·c …
    pub gravity: f64,
    /// … Σ ½ m k d².
    pub plane: f64,
}

impl Conserved {
    /// All energy.
    pub fn energy(&self) -> f64 {
        self.kinetic + self.spin + self.vibration + self.elastic + self.influence + self.gravity + self.plane
    }

    /// Of bodies as they are. Of those on prescribed paths, only what influence does to them counts.
    pub fn of(bodies: &[Body], pairs: &[Pair], field: &Field) -> Conserved {
        let mut sum = Conserved::default();
        for body in bodies.iter().filter(|body| body.is_free()) {
            let (shape, mass) = (&*body.shape, body.mass());
            sum.momentum += mass * body.velocity;
            sum.kinetic += 0.5 * mass * body.velocity.length_squared();
            sum.gravity -= mass * field.gravity.dot(body.centre);
            let axes = DMat3::from_quat(body.rotation);
            let frame_spin = body.frame_spin();
            let (mut spin, mut own, mut elastic) = (DVec3::ZERO, 0.0, 0.0);
            for i in 0..shape.rest.len() {
                let (a, m) = (axes * shape.rest[i], shape.masses[i]);
                let rate = frame_spin.cross(a) + body.u[i];
                spin += m * (a + body.x[i]).cross(rate);
                own += 0.5 * m * rate.length_squared();
                elastic += m * body.x[i].length_squared();
                for plane in &field.planes {
                    sum.plane += m * plane.potential(plane.depth(body.centre + (a + body.x[i])));
                }
            }
            sum.angular_momentum += mass * body.centre.cross(body.velocity) + spin;
            let rigid = 0.5 * spin.dot(body.inner(body.rotation).spin(spin));
            sum.spin += rigid;
            sum.vibration += own - rigid;
            sum.elastic += 0.5 * body.oscillator.omega * body.oscillator.omega * elastic;
        }
        for pair in pairs {
            let q = bodies[pair.a as usize].centre.distance(bodies[pair.b as usize].centre)
                / (bodies[pair.a as usize].radius + bodies[pair.b as usize].radius);
            sum.influence += influence(bodies, pair, field, pair.law.strength(pair.phase, q));
        }
        sum
    }
}

/// The energy of a pair at a strength [mass · scene unit²/s²].
pub(super) fn influence(bodies: &[Body], pair: &Pair, field: &Field, strength: f64) -> f64 {
    if strength == 0.0 {
        return 0.0;
    }
    let (a, b) = (&bodies[pair.a as usize], &bodies[pair.b as usize]);
    let of = |own: &Body, source: &Body| {
        let r_e = field.reach * source.radius;
        let axes = DMat3::from_quat(own.rotation);
        let apart = source.centre - own.centre;
        let potential = (0..own.x.len()).map(|i| {
            let s = axes * own.shape.rest[i] + own.x[i];
            own.shape.masses[i] * influence_potential(field.weight, r_e, (apart - s).length())
        });
        strength * field.scale(own.radius, source.radius) * potential.sum::<f64>()
    };
    of(a, b) + of(b, a)
}
