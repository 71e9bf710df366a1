//! Carry: the inertial response of a body's vertices to its own motion.

use std::f64::consts::TAU;

use glam::DVec3;

use super::{Cause, On, Term};
use crate::{
    scene::{
        Material, Path, Response,
        path::{Bounds, Kinematics},
    },
    sim::{span::Span, state::State, track::Track},
};

pub struct Carry;

/// The jump of the velocities of a body's vertices at time `t` due to the jump of its centre's velocity [scene unit/s]:
/// the vertices keep their world velocity, unless the body is rigid. A centre that jumps between positions takes the
/// vertices along. At t = 0 every velocity is zero.
pub fn kick(material: &Material, track: Track<'_>, t: f64) -> DVec3 {
    match material.response {
        Response::Inertial | Response::World if t > 0.0 => -track.kick(t),
        _ => DVec3::ZERO,
    }
}

impl Term for Carry {
    fn uniform(material: &Material, motion: &Kinematics) -> Option<(Cause, DVec3)> {
        let carry = match material.response {
            Response::Rigid => DVec3::ZERO,
            Response::Inertial => motion.acceleration,
            Response::World => motion.acceleration + 2.0 * material.damping * motion.velocity,
        };
        (carry != DVec3::ZERO).then_some((Cause::Carry, -carry))
    }

    fn own_bound<P>(on: &On<'_, P>, span: Span) -> f64 {
        let material = on.material;
        let Some(mover) = on.tracks.of(on.index as usize) else { return 0.0 };
        let Bounds { speed, acceleration } = mover.bounds;
        // a velocity jump acts on a vertex like the same change spread over the step
        let kicked = || if mover.kicks > 0.0 { acceleration + mover.kicks / span.length() } else { acceleration };
        match material.response {
            Response::Rigid => 0.0,
            Response::Inertial => kicked(),
            Response::World => kicked() + 2.0 * material.damping * speed,
        }
    }
}

/// The steady-state response of the vertices of a body that follows a sine. The transient is a free oscillation, so
/// both are known in closed form at any time.
#[derive(Clone, Copy, Debug)]
pub struct Steady {
    amplitude: DVec3,
    rate: f64,
    phase: f64,
    /// The response to sin θ is `sine` sin θ + `cosine` cos θ [–].
    sine: f64,
    cosine: f64,
}

impl Steady {
    /// The response of a body, if carry acts on it and it oscillates more than once in `h` [s], so that steps do
    /// not resolve the motion.
    pub fn of(material: &Material, track: Track<'_>, h: f64) -> Option<Steady> {
        let Some(Path::Sine { amplitude, frequency, phase, .. }) = track.path() else { return None };
        if frequency.abs() * h <= 1.0 || material.response == Response::Rigid {
            return None;
        }
        // x″ + 2κx′ + ω²x = −carry with e^iθ for sin θ: X = F/D, D = ω² − r² + 2iκr, F = r², less 2iκr for `world`
        let rate = TAU * frequency;
        let drag = 2.0 * material.damping * rate;
        let from_drag = if material.response == Response::World { drag } else { 0.0 };
        let (real, imaginary) = (material.omega * material.omega - rate * rate, drag);
        let square = real * real + imaginary * imaginary;
        let force = rate * rate;
        let sine = (force * real - from_drag * imaginary) / square;
        let cosine = -(force * imaginary + from_drag * real) / square;
        // there is none at undamped resonance
        let is_some = sine.abs() + cosine.abs() < 1e3;
        is_some.then_some(Steady { amplitude: *amplitude, rate, phase: *phase, sine, cosine })
    }

    /// The response at time `t` [s].
    pub fn at(&self, t: f64) -> State {
        let Steady { amplitude, rate, phase, sine, cosine } = *self;
        let (sin, cos) = libm::sincos(rate * t + phase);
        State { x: amplitude * (sine * sin + cosine * cos), u: amplitude * (rate * (sine * cos - cosine * sin)) }
    }

    /// The largest |x| of the response [scene unit].
    pub fn largest(&self) -> f64 {
        self.amplitude.length() * (self.sine.abs() + self.cosine.abs())
    }
}

#[cfg(test)]
mod tests {
    use crate::{Scene, sim::World};

    fn world(response: &str, frequency: f64, phase: f64, steps_per_period: f64) -> World {
        let dt = 1.0 / (60.0 * steps_per_period);
        let path =
            format!("center = [0.3, 0, 0], amplitude = [0.2, 0.1, 0], frequency = {frequency:?}, phase = {phase:?}");
        let text = format!(
            "dt = {dt:?}\nduration = 1.0\n[material]\nresponse = \"{response}\"\n[[body]]\nname = \"a\"\nradius = 1.0\nmotion = {{ sine = {{ {path} }} }}\n\
             [[push]]\nbody = \"a\"\ndirection = [0, 1, 0]\nstrength = 20.0\nstart = 0.1\nduration = 0.05\n"
        );
        World::new(Scene::parse(&text, "sine.toml").unwrap()).unwrap()
    }

    /// The closed form for a body that oscillates many times in a step agrees with short steps.
    #[test]
    fn motion_too_fast_for_steps_is_known_in_closed_form() {
        for response in ["inertial", "world"] {
            for phase in [0.0, 1.0, std::f64::consts::FRAC_PI_2] {
                let (mut long, mut short) = (world(response, 130.0, phase, 1.0), world(response, 130.0, phase, 128.0));
                let (mut moved, mut error): (f64, f64) = (0.0, 0.0);
                for _ in 0..30 {
                    long.step();
                    for _ in 0..128 {
                        short.step();
                    }
                    for i in [0, 100, 200] {
                        let [x, y] = [&long, &short].map(|world| world.body(0).displacement(i));
                        (moved, error) = (moved.max(y.length()), error.max(x.distance(y)));
                    }
                }
                assert!(moved > 0.2 && error < 1e-6 * moved, "{response}, {phase}: {error:e} of {moved}");
            }
        }
    }
}
